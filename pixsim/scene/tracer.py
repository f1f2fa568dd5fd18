"""Build a judged scene in Mitsuba and trace it: what a render does inside Mitsuba, in this process or in a child of it.

A job and its requests are of plain numbers and texts, so that they can be sent to another process.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pixsim.scene.mitsuba import children, nodes_of, parse, plain, speaking_mitsuba

SCALAR_BLOCK = 32  # fixed, since Mitsuba would choose blocks, and with them seeds, by the number of threads
OF_THE_LENS = ("focal_length", "fov_axis", "aperture_radius", "focus_distance")  # properties that the camera states


@dataclass(frozen=True)
class Lamps:
    """The emitters that shine in one scene of a job; the others are dark.

    pictures : emitter node -> (property, node of its neutral picture, or its power)
    neutral : whether an emitter becomes its picture or power, since the film's pulses have its spectrum
    """

    pictures: dict[int, tuple[str, int | float]]
    neutral: bool


@dataclass(frozen=True)
class Job:
    """A scene to trace, under one group of lamps after another.

    text : judged XML
    lamps : of each scene; None leaves the scene's own
    sensor : node of the sensor
    lens : type of the sensor, and properties in place of those in `OF_THE_LENS`
    integrator : plugin and its parameters, or None for that of the scene
    tables : (node, property, spectrum) of the tables of surfaces that a spectrum takes the place of
    """

    variant: str
    text: str
    lamps: tuple[Lamps | None, ...]
    sensor: int
    lens: dict[str, Any]
    integrator: dict[str, Any] | None
    tables: tuple[tuple[int, str, dict[str, Any]], ...]


class Tracer(Protocol):
    """What traces a job."""

    def sample_count(self, sampler: str, samples: int) -> int:
        """Return the samples that a sampler takes where `samples` are asked for."""

    def trace(self, scene: int, film: dict[str, Any], sampler: str, spp: int, seed: int) -> NDArray[np.float32]:
        """Return a picture (rows, columns, channels) of a scene of the job; `film` describes the plugin."""


class OwnTracer:
    """Traces in this process."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._sensor: tuple[Any, Any] = None, None  # the last one, and what describes it

    @property
    def _scalar(self) -> bool:
        return self.job.variant.startswith("scalar")

    @cached_property
    def loaded(self) -> list[tuple[Any, Any]]:
        """Mitsuba's scene and integrator for each group of lamps."""
        with speaking_mitsuba(self.job.variant) as mi:
            built = [self._build(mi, lamps) for lamps in self.job.lamps]
            return [(scene, self._integrator(mi, scene)) for scene in built]

    @cached_property
    def _lens(self) -> dict[str, Any]:
        """The scene's sensor with the lens of the job, without sampler and film."""
        node = parse(self.job.text, self.job.variant).nodes[self.job.sensor]
        return {key: value for key, value in plain(node) if key not in OF_THE_LENS} | self.job.lens

    def _build(self, mi: Any, lamps: Lamps | None) -> Any:
        """Build the scene, with some emitters only, each as its neutral picture or power."""
        state = parse(self.job.text, self.job.variant)
        emitters = nodes_of(state, "Emitter") if lamps else []
        dark = {index for index, _ in emitters} - (lamps.pictures.keys() if lamps else set())
        for parent in state.nodes if dark else ():
            for name, child in children(parent, state).items():
                if child in dark:
                    del parent.props[name]
        for index, node in emitters:
            if lamps and lamps.neutral and index in lamps.pictures:
                name, picture = lamps.pictures[index]
                if isinstance(picture, int):
                    node.props[name] = mi.Properties.ResolvedReference(picture)
                else:
                    node.props[name] = mi.load_dict({"type": "uniform", "value": picture})  # a plain number would be a d65
        for _, node in nodes_of(state, "Integrator"):
            if self._scalar and "block_size" not in node.props:
                node.props["block_size"] = SCALAR_BLOCK
        for index, name, table in self.job.tables:
            state.nodes[index].props[name] = mi.load_dict(table)
        config = mi.parser.ParserConfig(self.job.variant)
        mi.parser.transform_all(config, state)
        built = mi.parser.instantiate(config, state)
        return next(item for item in built if isinstance(item, mi.Scene)) if isinstance(built, list) else built

    def _integrator(self, mi: Any, scene: Any) -> Any:
        scene_integrator = None if self.job.integrator else scene.integrator()
        return scene_integrator or mi.load_dict({"type": "path", "block_size": SCALAR_BLOCK} | (self.job.integrator or {}))

    def sample_count(self, sampler: str, samples: int) -> int:
        with speaking_mitsuba(self.job.variant) as mi:
            return int(mi.load_dict({"type": sampler, "sample_count": samples}).sample_count())

    def trace(self, scene: int, film: dict[str, Any], sampler: str, spp: int, seed: int) -> NDArray[np.float32]:
        with speaking_mitsuba(self.job.variant) as mi:
            described = film, sampler, spp
            if self._sensor[1] != described:
                parts = {"sampler": {"type": sampler, "sample_count": spp}, "film": film}
                self._sensor = mi.load_dict(self._lens | parts), described
            world, integrator = self.loaded[scene]
            rendered = mi.render(world, sensor=self._sensor[0], integrator=integrator, spp=spp, seed=seed)
            return np.array(rendered, np.float32)


def regular(low_nm: float, high_nm: float, values: Any) -> dict[str, Any]:
    """Describe a spectrum with equal steps."""
    text = ", ".join(repr(float(value)) for value in values)
    return {"type": "regular", "wavelength_min": low_nm, "wavelength_max": high_nm, "values": text}
