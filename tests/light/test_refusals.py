"""What the room of light refuses: arrays that do not fit each other, and files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage, Spectrum
from pixsim.light.standard import illuminant

DATA = np.ones((2, 2, 1))
PLANES = np.ones((1, 2, 2))
EXR = struct.pack("<II", 20000630, 2)


def image(**options: object) -> SpectralImage:
    return SpectralImage([550.0], 10.0, 1.0, **({"data": DATA} | options))


def spectrum(nodes: list[float], values: list[float]) -> Spectrum:
    return Spectrum(np.array(nodes, float), np.array(values, float))


REFUSALS = [
    ("neither", lambda: image(data=None), "either data or factors"),
    ("both", lambda: image(factors=(np.ones(1), PLANES)), "not both"),
    ("two axes", lambda: image(data=np.ones((2, 2))), "data: got"),
    ("bands first", lambda: image(data=np.ones((1, 4, 4))), "moveaxis"),
    ("factors", lambda: image(data=None, factors=(np.ones((2, 1)), PLANES)), "factors: got"),
    ("nodes", lambda: image(within=([[550.0]], [[0.5, 0.5]])), "within: got"),
    ("rows of nodes", lambda: image(within=(np.ones((2, 1)), np.ones((2, 1)))), "within: got"),
    ("widths", lambda: SpectralImage([550.0], [1.0, 2.0], 1.0, data=DATA), "band_width_nm: got"),
    ("no bands", lambda: SpectralImage([], 10.0, 1.0, data=DATA), "wavelength_nm: got"),
    ("margin", lambda: image(margin=1), "margin: got 1"),
    ("planes", lambda: image().with_planes(np.ones((2, 2, 2), np.float32)), "planes: got"),
    ("a second band", lambda: image().band(1), "index: got 1"),
    ("weights", lambda: image().weighted(np.ones(2)), "weight: got"),
    ("no columns", lambda: image().box_reduced(0), "columns: got 0"),
    ("finer columns", lambda: image().box_reduced(3), "columns: got 3"),
    ("negative", lambda: image(data=-DATA).validate(), "irradiance: got .* 0 or more"),
    ("infinite", lambda: image(data=np.inf * DATA).validate(), "irradiance: got .* finite"),
    ("one node", lambda: spectrum([500], [1]), "two nodes or more"),
    ("falling nodes", lambda: spectrum([500, 400], [1, 0]), "increasing order"),
    ("values", lambda: spectrum([400, 500], [1, 2, 3]), "two nodes or more"),
    ("no number", lambda: spectrum([400, 500], [1, np.nan]), "NaN or infinity"),
    ("beyond float32", lambda: spectrum([400, 500], [1, 1e31]), "values up to"),
    ("illuminant", lambda: illuminant("LED-B4", [550.0]), "illuminant: .*'LED-B3'"),
]
FILES = [
    ("no EXR", b"not an EXR", "does not start like"),
    ("damaged", EXR + b"\xff" * 400, "damaged"),
    ("cut", EXR + b"channels\0chlist\0", "damaged"),
    ("deep", struct.pack("<II", 20000630, 2 | 0x800) + b"\0", "deep"),
    ("several parts", struct.pack("<II", 20000630, 2 | 0x1000) + b"\0", "parts"),
    ("no channels", EXR + b"\0", "without channels"),
    ("absent", None, "does not exist"),
]


@pytest.mark.parametrize(
    ("call", "words"), [row[1:] for row in REFUSALS], ids=[r[0] for r in REFUSALS]
)
def test_arguments_that_do_not_fit_each_other(call, words: str) -> None:
    with pytest.raises(PixsimError, match=words):
        call()


@pytest.mark.parametrize(
    ("content", "words"), [row[1:] for row in FILES], ids=[r[0] for r in FILES]
)
def test_files_that_are_no_light(content: bytes | None, words: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "image.exr").write_bytes(content)
    with pytest.raises(PixsimError, match=f"EXR file: got .*{words}"):
        pixsim.read_exr(tmp_path / "image.exr")


@pytest.mark.parametrize("place", ["no/such/folder/image.exr", "a_file/image.exr", "a_folder"])
def test_paths_that_cannot_be_written_leave_files(place: str, tmp_path: Path) -> None:
    (tmp_path / "a_file").write_text("unchanged")
    (tmp_path / "a_folder").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(PixsimError, match="output file: got"):
        pixsim.write_exr(tmp_path / place, image())
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "a_file").read_text() == "unchanged"
