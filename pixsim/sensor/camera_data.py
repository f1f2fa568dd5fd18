"""Measured sensitivities of 52 cameras, packaged in `pixsim/data/camera_sensitivities`.

From rawtoaces-data of the Academy Software Foundation, Apache-2.0; LICENSE and NOTICE lie beside the files, and index.csv has the
origin of each. They are relative responses to energy, of the whole camera with its infrared filter, 380 to 780 nm in steps of 5 nm.
"""

from __future__ import annotations

import csv
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.errors import did_you_mean, invalid

FOLDER = Path(str(resources.files("pixsim") / "data/camera_sensitivities"))
OWN_SCALES = "ratio between channels lost"  # in the notes of cameras whose channels were scaled one by one


@lru_cache
def _notes() -> dict[str, str]:
    """Name of each camera -> notes about its data."""
    with (FOLDER / "index.csv").open(encoding="utf-8", newline="") as file:
        return {Path(row["file"]).stem: row["notes"] for row in csv.DictReader(file)}


def camera_names() -> tuple[str, ...]:
    """Return the names of the packaged cameras, in alphabetical order."""
    return tuple(sorted(_notes(), key=str.lower))


@checks_arguments
def camera_sensitivities(name: str) -> tuple[Array, Array]:
    """Return the wavelengths in nm, (B,), and the relative responses to energy of R, G and B, (B, 3), of a packaged camera.

    name : such as Nikon_D5100, one of `camera_names`

    Raises PixsimError for another name.

    >>> wavelength_nm, responses = camera_sensitivities("Canon_EOS_R5")
    >>> responses.max(axis=0).round(2).tolist()
    [0.69, 1.0, 0.83]
    """
    table = np.loadtxt(_file(name), delimiter=",", skiprows=1)
    return table[:, 0], table[:, 1:]


@checks_arguments
def has_common_scale(name: str) -> bool:
    """Return whether the channels of a packaged camera have one scale.

    Without, each channel is relative to its own maximum. White balance, and the colour matrix after it, do not depend on the ratio
    of the channels; the noise before white balance does. Raises PixsimError for a name that `camera_names` has not.
    """
    _file(name)
    return OWN_SCALES not in _notes()[name]


def _file(name: str) -> Path:
    """The file of a packaged camera."""
    if name not in _notes():
        hint = did_you_mean(name, _notes()) or did_you_mean(name.replace(" ", "_"), _notes())
        raise invalid("camera", f"'{name}'", ", ".join(camera_names()), hint)
    return FOLDER / f"{name}.csv"
