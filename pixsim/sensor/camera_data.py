"""Measured sensitivities of 52 cameras, packaged in `pixsim/data/camera_sensitivities`.

From rawtoaces-data of the Academy Software Foundation, Apache-2.0; LICENSE and NOTICE lie beside
the files, and index.csv has the origin of each. They are relative responses to energy, of the whole
camera with its infrared filter, 380 to 780 nm in steps of 5 nm.

Three sets of filters as industrial sensors have them are made here, since no measured ones are
free: marked as typical.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import did_you_mean, invalid
from pixsim.sensor.diffusion import absorption_per_um

FOLDER = Path(str(resources.files("pixsim") / "data/camera_sensitivities"))
_MEASURED_ORIGIN = (
    "relative responses to energy of whole cameras, from rawtoaces-data (Academy Software"
    " Foundation, Apache-2.0)"
)
_SEPARATE_SCALES = (  # in the notes of cameras whose channels were scaled one by one
    "ratio between channels lost"
)


_TYPICAL_NM = np.arange(360.0, 1001.0, 5.0)
_OPEN = 2000.0  # nm, an edge beyond all light of the table
# Channel -> the pass bands of its filter: (transmittance, rising edge, its width, falling edge, its
# width), nm. Dyes open in the infrared.
_DYES: dict[str, tuple[tuple[float, ...], ...]] = {
    "R": ((0.95, 585.0, 8.0, _OPEN, 1.0),),
    "G": ((0.88, 487.0, 10.0, 585.0, 11.0), (0.9, 810.0, 14.0, _OPEN, 1.0)),
    "B": ((0.75, 405.0, 14.0, 500.0, 11.0), (0.9, 825.0, 12.0, _OPEN, 1.0)),
}
_BLACK_DYE: tuple[tuple[float, ...], ...] = ((0.9, 790.0, 12.0, _OPEN, 1.0),)
_TYPICAL_ORIGIN = (
    "no measurement, but a model of pixsim: dye filters with logistic edges times silicon"
    " (absorption of Green 2008). Estimated confidence: peaks ±15 nm, ratio of channels ±20 %,"
    " leaks ±0.05, infrared ±30 %; without an infrared filter"
)


SOURCES = {"measured": _MEASURED_ORIGIN, "typical": _TYPICAL_ORIGIN}  # of each kind of entry


@dataclass(frozen=True)
class _TypicalFilters:
    """A set of filters on silicon, without an infrared filter.

    depth_um : of silicon that collects
    dead_um : of silicon before it that does not, as under the surface of a front-side illuminated
        pixel
    leak : of each filter outside its bands
    """

    title: str
    bands: dict[str, tuple[tuple[float, ...], ...]]
    depth_um: float
    dead_um: float
    leak: float

    def responses(self) -> Array:
        """Relative responses to energy, (B, C), at most 1: λ times filter times exp(-α dead) (1 -
        exp(-α depth)).
        """
        absorption = absorption_per_um(_TYPICAL_NM)
        silicon = np.exp(-absorption * self.dead_um) * -np.expm1(-absorption * self.depth_um)
        transmittances = [_band_transmittance(bands) for bands in self.bands.values()]
        filters = self.leak + (1 - self.leak) * np.stack(transmittances, axis=1)
        values = filters * (silicon * _TYPICAL_NM)[:, None]
        return np.asarray(values / values.max())


def _band_transmittance(bands: Sequence[tuple[float, ...]]) -> Array:
    """Transmittance of pass bands, 0 to 1."""
    transmittances = [
        peak * _edge(_TYPICAL_NM, low, rising_width) * _edge(-_TYPICAL_NM, -high, falling_width)
        for peak, low, rising_width, high, falling_width in bands
    ]
    return np.asarray(np.sum(transmittances, axis=0))


def _edge(x: Array, centre: float, width: float) -> Array:
    return np.asarray(0.5 * (1 + np.tanh((x - centre) / (2 * width))))


TYPICAL = {
    "Typical_RGB_BSI": _TypicalFilters(
        "RGB filters on a back-side illuminated CMOS sensor", _DYES, 3.0, 0.02, 0.04
    ),
    "Typical_RGB_FSI": _TypicalFilters(
        "RGB filters on a front-side illuminated CMOS sensor", _DYES, 2.5, 0.12, 0.07
    ),
    "Typical_RGB_NIR": _TypicalFilters(
        "RGB and near-infrared (N) filters on a deep back-side illuminated CMOS sensor",
        _DYES | {"N": _BLACK_DYE},
        6.0,
        0.02,
        0.05,
    ),
}


@dataclass(frozen=True)
class CameraEntry:
    """A line of the list of cameras.

    channels : the letters of its columns
    kind : measured or typical
    peak_nm : wavelength of the largest response of each channel
    notes : origin, scale and confidence
    """

    name: str
    title: str
    channels: str
    kind: str
    range_nm: tuple[float, float]
    peak_nm: tuple[float, ...]
    notes: str

    @property
    def description(self) -> str:
        """The title, and whether the scale of the channels is lost."""
        if _SEPARATE_SCALES not in self.notes:
            return self.title
        return f"{self.title}; {_SEPARATE_SCALES}"


@lru_cache
def _index() -> dict[str, dict[str, str]]:
    """Name of each measured camera -> its row of the index."""
    with (FOLDER / "index.csv").open(encoding="utf-8", newline="") as file:
        return {Path(row["file"]).stem: row for row in csv.DictReader(file)}


def cameras() -> tuple[CameraEntry, ...]:
    """Return the list of packaged cameras and typical filters, in the order of `camera_names`, the
    typical ones last.
    """
    entries = []
    for name in (*camera_names(), *TYPICAL):
        nm, values = camera_sensitivities(name)
        if name in TYPICAL:
            kind = "typical"
            title = TYPICAL[name].title
            notes = _TYPICAL_ORIGIN
        else:
            row = _index()[name]
            kind = "measured"
            title = f"{row['manufacturer']} {row['model']}"
            scale = row["notes"].partition(";")[0]
            notes = f"rawtoaces-data, {row['licence']}, {row['creator']}; {scale}"
        entry = CameraEntry(
            name=name,
            title=title,
            channels=camera_channels(name),
            kind=kind,
            range_nm=(float(nm[0]), float(nm[-1])),
            peak_nm=tuple(nm[values.argmax(axis=0)].tolist()),
            notes=notes,
        )
        entries.append(entry)
    return tuple(entries)


def camera_channels(name: str) -> str:
    """Return the letters of the channels of a packaged camera. Raises PixsimError for a name that
    is none.
    """
    if name in TYPICAL:
        return "".join(TYPICAL[name].bands)
    _file(name)  # refuses an unknown name
    return "RGB"


def camera_names() -> tuple[str, ...]:
    """Return the names of the measured cameras, in alphabetical order."""
    return tuple(sorted(_index(), key=str.lower))


def camera_sensitivities(name: str) -> tuple[Array, Array]:
    """Return the wavelengths in nm, (B,), and the relative responses to energy of R, G and B, (B,
    3), of a packaged camera.

    name : such as Nikon_D5100, one of `camera_names`; or typical filters, one of `TYPICAL`, which
        may have another channel last

    Raises PixsimError for another name.

    >>> wavelength_nm, responses = camera_sensitivities("Canon_EOS_R5")
    >>> responses.max(axis=0).round(2).tolist()
    [0.69, 1.0, 0.83]
    """
    if name in TYPICAL:
        return _TYPICAL_NM.copy(), TYPICAL[name].responses()
    table = np.loadtxt(_file(name), delimiter=",", skiprows=1)
    return table[:, 0], table[:, 1:]


def has_common_scale(name: str) -> bool:
    """Return whether the channels of a packaged camera have one scale.

    Without one, each channel is relative to its own maximum. White balance, and the colour matrix
    after it, do not depend on the ratio of the channels; the noise before white balance does.
    Raises PixsimError for a name that is not among `camera_names`.
    """
    if name in TYPICAL:
        return True
    return _file(name).is_file() and _SEPARATE_SCALES not in _index()[name]["notes"]


def _file(name: str) -> Path:
    """The file of a measured camera."""
    if name not in _index():
        names = (*camera_names(), *TYPICAL)
        hint = did_you_mean(name, names) or did_you_mean(name.replace(" ", "_"), names)
        raise invalid("camera", f"'{name}'", ", ".join(names), hint)
    return FOLDER / f"{name}.csv"
