"""What is to be traced: a scene, its lamps, its film's passes, as plain numbers and texts that can
be sent to another process.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import VISIBLE, Span, grid_nm

WAVELENGTHS = 4  # of a ray in Mitsuba's spectral variants
MESHES = ("ply", "obj", "serialized")  # plugins that read one


class OutOfTimeError(PixsimError):
    """A render is not done when its time ends."""


@dataclass(frozen=True)
class Lamps:
    """The emitters that shine in one scene of a job; the others are dark.

    pictures : emitter node -> (property, node of its neutral picture, or its power)
    neutral : whether an emitter becomes its picture or power, since the film's pulses have its
        spectrum
    """

    pictures: dict[int, tuple[str, int | float]]
    neutral: bool


@dataclass(frozen=True)
class Passes:
    """The passes of a light that are traced together.

    step_nm : of the grid of the range that is computed, on which the pulses are
    pulses : (index of the first node, values) of spectral responses of unit area
    groups : the pulses of each pass, 1, 2 or 4, of which some may be the same
    span : range that is computed
    """

    step_nm: float
    pulses: tuple[tuple[int, tuple[float, ...]], ...]
    groups: tuple[tuple[int, ...], ...]
    span: Span = VISIBLE

    @property
    def nodes(self) -> int:
        """Number of nodes of the grid."""
        return grid_nm(self.step_nm, self.span).size

    @property
    def lanes(self) -> NDArray[np.intp]:
        """The pulse of each of the four wavelengths of a ray, (passes, 4)."""
        return np.array([np.resize(group, WAVELENGTHS) for group in self.groups])

    @property
    def shifts(self) -> NDArray[np.float64]:
        """Shares of a pulse's area that lie between its first wavelength and each of the four,
        (passes, 4): they are stratified.
        """
        same = self.lanes[:, :, None] == self.lanes[:, None, :]
        return np.tril(same, -1).sum(axis=2) / same.sum(axis=2)

    @property
    def densities(self) -> NDArray[np.float64]:
        """The pulses on the whole grid, (pulses, nodes) nm⁻¹."""
        whole = np.zeros((len(self.pulses), self.nodes))
        for row, (first, values) in zip(whole, self.pulses, strict=True):
            row[first : first + len(values)] = values
        return whole

    def means(self, values: list[NDArray[np.float32]], spp: int) -> NDArray[np.float32]:
        """Return the mean of each pulse in each cell, (cells, pulses): the same on any number of
        threads.

        values : (cells · passes · spp,) at each of the four wavelengths
        """
        count = len(self.groups)
        sums = np.zeros((len(self.pulses), values[0].size // (count * spp)))
        numbers = np.zeros(len(self.pulses))
        for lane, lane_values in zip(self.lanes.T, values, strict=True):
            means = lane_values.reshape(-1, count, spp).mean(axis=2, dtype=np.float64)
            for pulse, mean in zip(lane, means.T, strict=True):
                sums[pulse] += mean
                numbers[pulse] += 1
        return (sums / numbers[:, None]).T.astype(np.float32)


@dataclass(frozen=True)
class AssetFile:
    """A picture, mesh or volume that a scene names.

    plugin : that reads it
    shape_index : which mesh of a serialized file
    has_light : whether its texels are light or reflectances, which must be finite and not negative
    share : the property that is a share of light and has these texels; empty for others
    """

    path: str
    digest: str
    plugin: str
    shape_index: int = 0
    has_light: bool = False
    share: str = ""


@dataclass(frozen=True)
class TraceJob:
    """A scene to trace, under one group of lamps after another.

    text : inspected XML
    lamps : of each scene. None leaves the scene's own
    sensor : node of the sensor
    lens : type of the sensor, and properties in place of the properties in `OF_THE_LENS`
    integrator : plugin and its parameters, or None for the scene's
    tables : (node, property, spectrum) of the tables of surfaces that a spectrum takes the place of
    size : (rows, columns) of the film for passes that are traced together
    passes : of each scene, or None where each pass has a film of its own
    files : that the text names
    """

    variant: str
    text: str
    lamps: tuple[Lamps | None, ...]
    sensor: int
    lens: dict[str, Any]
    integrator: dict[str, Any] | None
    tables: tuple[tuple[int, str, dict[str, Any]], ...]
    size: tuple[int, int] = (1, 1)
    passes: tuple[Passes | None, ...] = ()
    files: tuple[AssetFile, ...] = ()

    @property
    def scenes_key(self) -> tuple[object, ...]:
        """What Mitsuba's scenes and integrators depend on."""
        return self.variant, self.text, self.files, self.lamps, self.integrator, self.tables


def irregular(nodes_nm: Iterable[float], values: Iterable[float]) -> dict[str, Any]:
    """Describe a spectrum with steps of any size."""
    columns = {"wavelengths": nodes_nm, "values": values}
    return {"type": "irregular"} | {
        name: ", ".join(repr(float(number)) for number in numbers)
        for name, numbers in columns.items()
    }


def regular(low_nm: float, high_nm: float, values: Iterable[float]) -> dict[str, Any]:
    """Describe a spectrum with equal steps."""
    text = ", ".join(repr(float(value)) for value in values)
    return {"type": "regular", "wavelength_min": low_nm, "wavelength_max": high_nm, "values": text}
