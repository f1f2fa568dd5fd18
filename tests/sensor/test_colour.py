"""Colour filters on pixels: where channels are, what each sees, frames of mosaics and planes, and the
packaged cameras.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.statistics import seeded

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.camera_data import (
    FOLDER,
    TYPICAL,
    camera_channels,
    camera_names,
    camera_sensitivities,
    cameras,
    has_common_scale,
)
from pixsim.sensor.colour import Layout
from pixsim.sensor.colour_options import PATTERNS, channels_of
from pixsim.sensor.integration import lights_of, mean_signal_rate
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.raw import read_frame, write_frame
from pixsim.sensor.readout import make_sensor

NM = np.arange(405.0, 700.0, 10.0)
CAMERA = Camera(die_mm=0.1)
GRID = np.arange(400.0, 701.0, 10.0)


def bell(centre_nm: float, peak: float = 0.5) -> list[list[float]]:
    """A curve of a channel."""
    values = peak * np.exp(-(((GRID - centre_nm) / 40) ** 2))
    return np.stack([GRID, values], axis=1).tolist()


CURVES = {"R": bell(600), "G": bell(540), "B": bell(460), "W": bell(550, 0.9), "C": bell(520, 0.8)}
RGB = {"quantum_efficiencies": {letter: CURVES[letter] for letter in "RGB"}}


def physics(colour: dict[str, Any] | None, **fields: Any) -> PixelPhysics:
    pixel = {"technology": "4t-bsi", "pitch_um": 4.0, "stack": {"enabled": False}}
    return derive(Pixel.model_validate(pixel | {"colour": colour} | fields))


def light() -> SpectralImage:
    """A smooth picture whose colour changes over it, of two independent spectra."""
    y, x = np.mgrid[:96, :96] / 96
    pictures = 1 + 0.5 * np.sin(9 * x + 4 * y + 3), 1 + 0.4 * np.cos(7 * y - 3 * x)
    spectra = 1e-3 * np.exp(-(((NM - np.array([[480], [610]])) / 60) ** 2))
    factors = spectra, np.array(pictures, np.float32)
    return SpectralImage(NM, np.full(NM.size, 10.0), CAMERA.die_um[1] / 96, factors=factors)


def signal(colour: dict[str, Any] | None, **fields: Any) -> np.ndarray:
    return mean_signal_rate(light(), CAMERA, physics(colour, **fields))


@pytest.mark.parametrize(
    "cell",
    [
        *({"pattern": name} for name in PATTERNS),
        {"matrix": ["RGBW", "WRGB"]},
        {"matrix": ["RB", "GG", "WW"]},
    ],
    ids=lambda cell: str(next(iter(cell.values()))),
)
@pytest.mark.parametrize("pitch_um", [4.0, 3.45], ids=["odd", "even"])
def test_each_pixel_has_the_signal_of_its_channel(cell: dict[str, Any], pitch_um: float) -> None:
    """That of a monochrome sensor of the channel's quantum efficiency."""
    letters = channels_of(cell.get("matrix") or PATTERNS[cell["pattern"]])
    colour = cell | {"quantum_efficiencies": {letter: CURVES[letter] for letter in letters}}
    layout = Layout.of(physics(colour).pixel)
    alone = [
        signal(None, quantum_efficiency=CURVES[letter], pitch_um=pitch_um) for letter in letters
    ]
    expected = np.concatenate(alone)
    if not layout.is_stacked:
        rows, columns = np.indices(alone[0].shape)
        letter_cell = np.array([list(row) for row in layout.cell])
        height, width = letter_cell.shape
        at_pixel = letter_cell[rows % height, columns % width]
        expected = np.select([at_pixel == letter for letter in letters], alone)
    np.testing.assert_allclose(signal(colour, pitch_um=pitch_um), expected, rtol=1e-12)


def test_transmittances_multiply_the_response_of_the_pixel() -> None:
    """The pixel as a whole has the mean over its unit cell: two green pixels in four."""
    unfiltered = physics(None, infrared_cut_nm=650.0).quantum_efficiency(NM)
    colour = {"transmittances": RGB["quantum_efficiencies"]}
    pixel = physics(colour, infrared_cut_nm=650.0)
    efficiencies = np.array([channel.quantum_efficiency(NM) for channel in pixel.channels])
    filters = [np.interp(NM, *np.transpose(CURVES[letter])) for letter in "RGB"]
    np.testing.assert_allclose(efficiencies, filters * unfiltered, rtol=1e-12)
    mean = [0.25, 0.5, 0.25] @ efficiencies
    np.testing.assert_allclose(pixel.quantum_efficiency(NM), mean, rtol=1e-12)


def test_crosstalk_mixes_colours_before_noise() -> None:
    """Uniform light: a red pixel keeps 1 - c of red and gets c of green; a green one c/2 of red and
    of blue. Also at the border.
    """
    data = np.full((100, 100, NM.size), 1e-3)
    uniform = SpectralImage(NM, 10.0, 1.0, data=data, header={"diffraction": False})
    slow = Camera(die_mm=0.1, f_number=1e3)
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    cells = [
        mean_signal_rate(uniform, slow, physics(RGB, stack=stack | {"crosstalk": crosstalk}))
        for crosstalk in (0.0, 0.2)
    ]
    (red, green), (_, blue) = cells[0][:2, :2]
    mixed_green = 0.8 * green + 0.1 * (red + blue)
    cell = [[0.8 * red + 0.2 * green, mixed_green], [mixed_green, 0.8 * blue + 0.2 * green]]
    expected = np.tile(cell, (13, 13))[:25, :25]
    # Openings show less of the lens off the axis.
    np.testing.assert_allclose(cells[1], expected, rtol=3e-3)


def test_each_channel_is_lit_by_its_own_spectrum() -> None:
    illuminations = [channel.illumination for channel in lights_of(light(), CAMERA, physics(RGB))]
    assert len({illumination.weight for illumination in illuminations}) == 3


# --- Files


@pytest.mark.parametrize("suffix", [".tiff", ".png", ".exr", ".npz"])
@pytest.mark.parametrize("pattern", ["gbrg", "stacked", "quad_rggb"])
def test_raw_files_carry_the_layout(suffix: str, pattern: str, tmp_path: Path) -> None:
    sensor = make_sensor(physics(RGB | {"pattern": pattern}).pixel, CAMERA)
    frame = pixsim.capture(light(), CAMERA, sensor, rng=seeded(1))
    assert frame.pixels == (25, 25)
    path = tmp_path / f"raw{suffix}"
    write_frame(path, frame)
    stored = read_frame(path)
    assert stored.layout == frame.layout == Layout(PATTERNS[pattern], pattern == "stacked")
    np.testing.assert_array_equal(stored.dn, frame.dn)


@pytest.mark.parametrize("text", ["RG/G", "rg/gb", "R+G/B", "", "R+", "1/2"])
def test_unknown_layout_of_a_file_is_left_out(text: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "raw.npz", dn=np.ones((2, 2), np.uint8), layout=text)
    assert read_frame(tmp_path / "raw.npz").layout is None
    with pytest.raises(ValueError, match="allowed: rows of capital letters"):
        Layout.parse(text)


HEAD = "# made up\nnm;red;green;blue\n"
FILE = HEAD + "\n".join(f"{nm:g};0,5;0,4;0,3" for nm in GRID)


@pytest.mark.parametrize("text", [FILE, FILE.replace("nm;red;green;blue\n", "")])
def test_curves_of_a_file_with_and_without_a_title(text: str, tmp_path: Path) -> None:
    path = tmp_path / "qe.csv"
    path.write_text(text, encoding="utf-8")
    colour = physics({"quantum_efficiencies": str(path)}).pixel.colour
    values = {letter: curve[3] for letter, curve in colour.curves.items()}
    assert values == {"R": (430, 0.5), "G": (430, 0.4), "B": (430, 0.3)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FILE.replace("green", "red"), "two channels R"),
        (FILE.replace(";blue", ""), "2 channels in the title and 3 values"),
        (FILE.replace("0,5;0,4;0,3", "0,5;0,4;x", 3), "no 3 numbers in line"),
        ("nm,r\n400,0.5\n700,0.4\n", "3 values|no 3 numbers"),
        ("", "at least|values"),
    ],
)
def test_damaged_curves_are_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "qe.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        physics({"quantum_efficiencies": str(path)})


# --- The packaged cameras


def test_all_cameras_of_the_index_are_there_with_licence_and_notice() -> None:
    assert len(camera_names()) == 52
    assert {path.stem for path in FOLDER.glob("*.csv")} == {*camera_names(), "index"}
    assert "Apache License" in (FOLDER / "LICENSE").read_text(encoding="utf-8")
    assert "Academy Software Foundation" in (FOLDER / "NOTICE").read_text(encoding="utf-8")


def test_peaks_are_those_of_the_index() -> None:
    """The index was made from the source: a column or a file that was swapped would have another
    peak or peak wavelength.
    """
    with (FOLDER / "index.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        name = row["file"].removesuffix(".csv")
        nm, responses = camera_sensitivities(name)
        np.testing.assert_array_equal(nm, np.arange(380.0, 781.0, 5.0))
        peaks = [float(row[f"peak_{channel}"]) for channel in "rgb"]
        np.testing.assert_allclose(responses.max(axis=0), peaks, rtol=1e-5, err_msg=name)
        peaks_nm = [float(peak_nm) for peak_nm in row["peak_nm_rgb"].split("/")]
        assert nm[responses.argmax(axis=0)].tolist() == peaks_nm, name


def test_two_cameras_have_lost_the_ratio_of_their_channels() -> None:
    separate = {name for name in camera_names() if not has_common_scale(name)}
    assert separate == {"ARRI_D21", "Nikon_D5100"}
    for name in separate:
        assert camera_sensitivities(name)[1].max(axis=0).tolist() == [1.0, 1.0, 1.0]
    described = {entry.name for entry in cameras() if "channels lost" in entry.description}
    assert described == separate


def test_typical_filters_peak_where_measured_cameras_do() -> None:
    """Within the 15 nm that they state, of the median of the measured cameras; these have an
    infrared filter, which moves red. Dyes are clear at 900 nm: the channels are alike there.
    """
    entries = cameras()
    assert [entry.name for entry in entries] == [*camera_names(), *TYPICAL]
    medians = np.median([entry.peak_nm for entry in entries if entry.kind == "measured"], axis=0)
    for entry in entries[-len(TYPICAL) :]:
        assert "no measurement" in entry.notes
        np.testing.assert_allclose(entry.peak_nm[1:3], medians[1:], atol=15)
        assert medians[0] <= entry.peak_nm[0] <= medians[0] + 45
        nm, values = camera_sensitivities(entry.name)
        assert values.shape == (nm.size, len(camera_channels(entry.name)))
        assert values.max() == 1
        infrared = values[nm == 900][0]
        assert infrared.max() < 1.25 * infrared.min()


@pytest.mark.parametrize(
    ("name", "nm", "channel", "sign"),
    [("Typical_RGB_FSI", 420.0, 2, -1), ("Typical_RGB_NIR", 850.0, 0, 1)],
)
def test_deep_silicon_has_more_infrared_and_a_dead_layer_less_blue(
    name: str, nm: float, channel: int, sign: int
) -> None:
    wavelength_nm, back = camera_sensitivities("Typical_RGB_BSI")
    _, values = camera_sensitivities(name)
    relative = values[wavelength_nm == nm, channel] / values[wavelength_nm == 530.0, 1]
    reference = back[wavelength_nm == nm, channel] / back[wavelength_nm == 530.0, 1]
    assert sign * (relative / reference - 1) > 0.15


def test_page_lists_every_camera() -> None:
    page = (Path(__file__).parents[2] / "docs/colour.md").read_text(encoding="utf-8")
    table = page.partition("## The cameras")[2].partition("| maker")[2]
    names = re.findall(r"`(\w[\w-]+_[\w-]+)`", table)
    assert names == [entry.name for entry in cameras()]
