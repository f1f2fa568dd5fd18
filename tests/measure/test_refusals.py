"""What measurements refuse: devices and pictures that would mislead, by their cause."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.edges import DARK, PIXEL_NOISE, SIDE, distances, gaussian_edge, mosaic
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_channels
from pixsim.measure import datasheet, estimators
from pixsim.measure.datasheet import make_datasheet
from pixsim.measure.experiment import make_experiment
from pixsim.measure.sfr import edge_response
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel

CASES = Path(__file__).parents[1] / "data/cases/sfr"
COARSE: dict[str, Any] = {"full_well_e": 1e12, "bits": 8, "prnu": 0, "read_noise_e": 0}
NM = range(400, 701, 20)
CURVES = {
    letter: [[nm, 0.5 if first <= nm else 0.0] for nm in NM]
    for letter, first in zip("RGB", (600, 500, 400), strict=True)
}
COLOUR = Pixel(
    technology="4t-bsi",
    pitch_um=3.0,
    bits=14,
    stack={"enabled": False},
    colour={"quantum_efficiencies": CURVES},
)
FRAMES = np.zeros((5, 3, 4), np.int32)
WAVES = np.sign(np.sin(np.arange(SIDE)[:, None] / 20))
RGB = np.concatenate([gaussian_edge()] * 3)
CALLS: list[tuple[str, Callable[[], object], str]] = [
    *((f"{bits} bits", lambda bits=bits: make_experiment(Pixel(bits=bits)), r"pixel\.bits: .*black level") for bits in (1, 2)),
    ("noise", lambda: make_experiment(Pixel(bits=12, read_noise_e=1e7)), r"pixel\.bits: .*black level"),
    ("gain", lambda: make_experiment(Pixel(bits=12), Exposure(gain_db=60)), r"exposure\.gain_db: got 60"),
    ("infrared", lambda: make_experiment(Pixel(), wavelength_nm=900), "wavelength_nm: got 900"),
    ("a long time", lambda: make_experiment(Pixel(), Exposure(integration_s=1000)), r"integration_s: got 1000"),
    *((f"shape {shape}", lambda shape=shape: make_experiment(Pixel(), shape=shape), "shape: got") for shape in ((2, 2), (0, 5), (3, 2))),
    ("coarse codes", lambda: make_datasheet(Pixel.model_validate(COARSE), shape=(4, 4)), r"pixel\.bits: .*hides the noise"),
    ("no red", lambda: make_datasheet(COLOUR, wavelength_nm=550.0, shape=(20, 20), stack_frames=2), "wavelength_nm: got 550; .* channel R"),
    ("one frame", lambda: estimators.stack(FRAMES[:1]), "frames of a stack: got 1"),
    ("five frames", lambda: estimators.noise_15739(FRAMES), "frames: got 5"),
    ("two pixels", lambda: pixsim.datasheet("0.35um", pixel=Pixel()), "file: got with a Pixel"),
    ("two technologies", lambda: pixsim.datasheet("0.35um", pixel={"technology": "4t-bsi"}), "give only one"),
    ("three problems", lambda: pixsim.datasheet(pixel={"bits": 2.5}, exposure={"gain": 6}), r"bits: got 2.5; .*\n.*exposure.gain"),
    ("contrast", lambda: edge_response(100 + PIXEL_NOISE[:64, :64]), "contrast"),
    ("noisy step", lambda: edge_response(DARK + 30 * (distances(5.0, 64, 64) > 0) + 40 * PIXEL_NOISE[:64, :64]), "step of"),
    ("upright", lambda: edge_response(gaussian_edge(0.0)), "from the rows or columns"),
    ("along rows", lambda: edge_response(gaussian_edge(90.4)), "columns, over"),
    ("small", lambda: edge_response(gaussian_edge()[:20]), "at least 24 pixels per side"),
    ("small mosaic", lambda: edge_response(gaussian_edge()[:40], layout="RG/GB", channel="G"), "for one channel of a mosaic"),
    ("no green", lambda: edge_response(gaussian_edge(), channel="G"), "stands out as green"),
    ("three channels", lambda: edge_response(np.zeros((64, 64, 3))), "one channel of numbers"),
    ("denormal", lambda: edge_response(1e-310 * gaussian_edge()), "largest value of"),
    ("huge", lambda: edge_response(1e300 * gaussian_edge()), "largest value of"),
    ("NaN", lambda: edge_response(np.where(distances(5.0) > 150, np.nan, gaussian_edge())), "NaN or infinite"),
    ("no polynomial", lambda: edge_response(DARK + 900.0 * (distances(5.0) > 4 * WAVES)), "of a polynomial of degree 5"),
    ("few lines", lambda: edge_response(DARK + 900.0 * (distances(5.0) > 6 * WAVES)), "an edge in 189 of 320 lines"),
    ("45°", lambda: edge_response(gaussian_edge(45.0)), "bins without a pixel"),
    ("at the side", lambda: edge_response(gaussian_edge(5.0)[:, 155:215]), "on either side"),
    ("saturated", lambda: edge_response(gaussian_edge(), saturation=999.0), "saturated"),
    ("outside", lambda: edge_response(gaussian_edge(), region=(0, 0, 321, 100)), "within 0,0,320,320"),
    ("three numbers", lambda: edge_response(gaussian_edge(), region=(0, 0, 100)), "region: got 0,0,100"),
    ("planes", lambda: edge_response(RGB, layout="R+G+B"), "one channel"),
    ("two thirds", lambda: edge_response(RGB[1:], layout="R+G+B", channel="G"), "layout: got"),
    *(
        (f"mosaic {layout}", lambda layout=layout: edge_response(mosaic(layout, gaussian_edge()) + 5 * PIXEL_NOISE), "looks like a colour mosaic")
        for layout in ("RG/GB", "RRGG/RRGG/GGBB/GGBB", "GBGGRG/RGRBGB/GBGGRG/GRGGBG/BGBRGR/GRGGBG")
    ),
    ("a long focus", lambda: pixsim.lens("singlet", focal_length_mm=1e7), "focal_length_mm: got"),
    ("many wavelengths", lambda: pixsim.lens("singlet", wavelength_nm=[550.0] * 25), "25 wavelengths"),
    ("a steep field", lambda: pixsim.lens("singlet", field_deg=90.0), "field_deg: got 90"),
    ("a mirror", lambda: pixsim.lens("singlet", reflectance=1.0), "reflectance: got"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "words"), [row[1:] for row in CALLS], ids=[row[0] for row in CALLS]
)
def test_values(call: Callable[[], object], words: str) -> None:
    with pytest.raises(PixsimError, match=words):
        call()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("ex1.6.png", "exactly 4095 above black, while the other"),
        ("ex1.6.png --saturation 4095", "49.9 % saturated"),
        ("mild.tif", "looks like a colour mosaic"),
        ("mild.tif --channel R", "--layout RG/GB"),
        ("mild.tif --channel 2,0", "from 0,0 to 1,1"),
        ("mild.tif --channel G --layout rggb", "capital letters"),
        ("mosaic_tagged.tif", "--channel G"),
        ("mosaic_tagged.tif --channel X", "R, G, B, luminance"),
        ("rgb16.tif --channel 0,1", "R, G, B, luminance"),
        ("rgb16.tif --layout RG/GB", "a mosaic"),
        ("ex1.0.png --black 5000 --saturation 4095", "more than the black level"),
        ("none.exr", "does not exist"),
        ("edge.jpg", ".png"),
        ("two.npz", "a single array"),
        ("grey8.png", "linear in light"),
        ("text.npy", "readable"),
        ("text.png", "readable"),
        ("rgb.exr", "one channel of digital numbers"),
        ("edge.npy --region 1,2,3", "x0,y0,x1,y1"),
        ("edge.npy --pitch-um -1", "above 0"),
        ("edge.npy --black-level-dn 2000", "black level is right"),
    ],
)
def test_pictures_of_edges(tmp_path: Path, line: str, words: str) -> None:
    edge = gaussian_edge()
    np.save(tmp_path / "edge.npy", edge)
    np.savez(tmp_path / "two.npz", a=edge, b=edge)
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(tmp_path / "grey8.png")
    for name in ("text.npy", "text.png"):
        (tmp_path / name).write_text("not a picture")
    write_channels(tmp_path / "rgb.exr", {"R": edge, "G": edge}, {})
    folder = CASES if (CASES / line.split()[0]).exists() else tmp_path
    assert_refused(*command(f"sfr {folder}/{line} --out {tmp_path}/o"), [words])
    assert not (tmp_path / "o").exists()


def test_bad_folder_is_refused_before_a_data_sheet_is_measured(tmp_path: Path, monkeypatch) -> None:
    fail = lambda *_, **__: pytest.fail("measured before the check of the folder")  # noqa: E731
    monkeypatch.setattr(datasheet, "make_datasheet", fail)
    (tmp_path / "file").touch()
    assert_refused(*command(f"datasheet 0.35um --out {tmp_path / 'file'}"), ["--out"])
