"""Colour filters on pixels: where channels are, their quantum efficiency, and what neighbours
exchange before any noise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import diffract_sum, diffract_sums
from pixsim.sensor.camera_data import camera_sensitivities
from pixsim.sensor.collection import collected_signal
from pixsim.sensor.colour import Layout
from pixsim.sensor.colour_options import PATTERNS, channels_of
from pixsim.sensor.correction import correct
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import lights_of, mean_signal_rate
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_notes import pixel_notes
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.raw import RawFrame, read_frame, write_frame
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    capture_from_rates,
    frame_mean_dn,
    frame_variance_dn2,
    make_sensor,
    sample_sensor,
)
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.merging import merge
from pixsim.viewer.setting import Run

NM = np.arange(405.0, 700.0, 10.0)
CAMERA = Camera(die_mm=0.1)
QUIET: dict[str, Any] = {
    "prnu": 0,
    "dsnu": 0,
    "read_noise_e": 0,
    "dark_current_e_per_s": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
}
GRID = [float(nm) for nm in range(400, 701, 10)]


def bell(centre_nm: float, peak: float = 0.5) -> list[list[float]]:
    """A curve of a channel."""
    return [[nm, float(peak * np.exp(-(((nm - centre_nm) / 40) ** 2)))] for nm in GRID]


CURVES = {"R": bell(600), "G": bell(540), "B": bell(460), "W": bell(550, 0.9), "C": bell(520, 0.8)}


def of_channels(letters: str) -> dict[str, Any]:
    return {letter: CURVES[letter] for letter in letters}


def pixel(colour: dict[str, Any] | None, **fields: Any) -> Pixel:
    bare = {"stack": {"enabled": False}}
    return Pixel(**{"technology": "4t-bsi", "pitch_um": 4.0, "colour": colour} | bare | fields)


def light(rows: int = 96, columns: int = 96, seed: int = 3) -> SpectralImage:
    """A smooth picture whose colour changes over it, of two independent spectra."""
    y, x = np.mgrid[:rows, :columns] / rows
    pictures = 1 + 0.5 * np.sin(9 * x + 4 * y + seed), 1 + 0.4 * np.cos(7 * y - 3 * x)
    spectra = 1e-3 * np.exp(-(((NM - 480) / 60) ** 2)), 1e-3 * np.exp(-(((NM - 610) / 60) ** 2))
    factors = np.array(spectra), np.array(pictures, np.float32)
    return SpectralImage(NM, np.full(NM.size, 10.0), CAMERA.die_um[1] / columns, factors=factors)


def signal(colour: dict[str, Any] | None, **fields: Any) -> np.ndarray:
    return mean_signal_rate(light(), CAMERA, derive(pixel(colour, **fields)))


@pytest.mark.parametrize(
    "colour",
    [
        *({"pattern": name} for name in PATTERNS),
        {"matrix": ["RGBW", "WRGB"]},
        {"matrix": ["RB", "GG", "WW"]},
    ],
    ids=lambda colour: str(next(iter(colour.values()))),
)
@pytest.mark.parametrize("pitch_um", [4.0, 3.45], ids=["odd", "even"])
def test_each_pixel_has_the_signal_of_its_channel(colour: dict[str, Any], pitch_um: float) -> None:
    """A monochrome sensor of a channel's quantum efficiency has the same signal at the pixels of
    the channel.
    """
    letters = channels_of(colour.get("matrix") or PATTERNS[colour["pattern"]])
    given = colour | {"quantum_efficiencies": of_channels(letters)}
    found, layout = signal(given, pitch_um=pitch_um), derive(pixel(given)).layout
    alone = [
        signal(None, quantum_efficiency=CURVES[letter], pitch_um=pitch_um) for letter in letters
    ]
    rows, columns = alone[0].shape
    if layout.is_stacked:
        expected = np.concatenate(alone)
    else:
        cell = np.array([list(row) for row in layout.cell])
        which = cell[np.arange(rows)[:, None] % cell.shape[0], np.arange(columns) % cell.shape[1]]
        expected = np.select([which == letter for letter in letters], alone)
    assert (found.shape[0] // layout.planes, found.shape[1]) == (rows, columns)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_transforms_are_shared_between_channels() -> None:
    """Several channels from one forward transform a picture are what each has alone, also if one
    sees nothing of a picture.
    """
    rng = np.random.default_rng(1)
    pictures, weights = rng.random((2, 20, 30)), rng.random((2, 3, NM.size))
    weights[0, 1] = 0.0
    shape, rest = (20, 30), (2.0, NM, 4.0)
    together = diffract_sums(zip(pictures, weights, strict=True), 3, shape, *rest)
    for channel, found in enumerate(together):
        alone = diffract_sum(
            ((one, each[channel]) for one, each in zip(pictures, weights, strict=True)),
            shape,
            *rest,
        )
        np.testing.assert_allclose(found, alone, rtol=1e-13)


def test_relative_responses_are_to_energy() -> None:
    """QE = c S/λ, with the largest of all channels at the stated peak: the electrons of equal
    energy go with S.
    """
    nm, table = camera_sensitivities("Canon_EOS_R5")
    p = derive(pixel({"sensitivities": "Canon_EOS_R5", "peak_quantum_efficiency": 0.4}))
    efficiency = np.array([channel.quantum_efficiency(nm) for channel in p.channels]).T
    assert efficiency.max() == pytest.approx(0.4, rel=1e-12)
    seen = table > 0.01
    ratio = (efficiency * nm[:, None])[seen] / table[seen]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


def test_transmittances_multiply_the_pixels_own_response() -> None:
    own = pixel(None, infrared_cut_nm=650.0)
    p = derive(pixel({"transmittances": of_channels("RGB")}, infrared_cut_nm=650.0))
    for channel, letter in zip(p.channels, "RGB", strict=True):
        filters = np.interp(NM, *np.array(CURVES[letter]).T)
        np.testing.assert_allclose(
            channel.quantum_efficiency(NM), filters * derive(own).quantum_efficiency(NM), rtol=1e-12
        )
    # The pixel as a whole has the mean over its unit cell: two green pixels in four.
    mean = sum(
        share * channel.quantum_efficiency(NM)
        for share, channel in zip((0.25, 0.5, 0.25), p.channels, strict=True)
    )
    np.testing.assert_allclose(p.quantum_efficiency(NM), mean, rtol=1e-12)


def test_crosstalk_mixes_colours_before_noise() -> None:
    """Even light: a red pixel keeps 1 - c of red and gets c of green; a green one c/2 of red and of
    blue. Also at the border.
    """
    even = SpectralImage(
        NM,
        np.full(NM.size, 10.0),
        1.0,
        data=np.full((100, 100, NM.size), 1e-3),
        header={"diffraction": False},
    )
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none", "crosstalk": 0.2}
    slow = Camera(die_mm=0.1, f_number=1e3)
    channels = {}
    for crosstalk in (0.0, 0.2):
        p = derive(
            pixel(
                {"quantum_efficiencies": of_channels("RGB")}, stack=stack | {"crosstalk": crosstalk}
            )
        )
        found = mean_signal_rate(even, slow, p)
        channels[crosstalk] = (
            found[:-1:2, :-1:2],
            found[:-1:2, 1::2],
            found[1::2, :-1:2],
            found[1::2, 1::2],
        )
    red, green, _, blue = channels[0.0]
    expected = (
        0.8 * red + 0.2 * green,
        0.8 * green + 0.1 * (red + blue),
        0.8 * green + 0.1 * (red + blue),
        0.8 * blue + 0.2 * green,
    )
    for values, mixed in zip(channels[0.2], expected, strict=True):
        np.testing.assert_allclose(
            values, mixed, rtol=3e-3
        )  # openings show less of the lens off the axis


def test_neighbours_get_what_a_pixel_loses() -> None:
    """Light that stays within the array is collected once, whatever the shares of each channel."""
    rng = np.random.default_rng(4)
    light_e_per_s = np.zeros((30, 31))
    light_e_per_s[3:-3, 3:-3] = rng.random((24, 25))
    shares = rng.random((3, 5, 5))
    shares /= shares.sum(axis=(1, 2), keepdims=True)
    assert collected_signal(
        light_e_per_s, list(shares), Layout(("GR", "BG"))
    ).sum() == pytest.approx(light_e_per_s.sum(), rel=1e-12)


def binned() -> Pixel:
    colour = {"pattern": "quad_rggb", "binning": True, "quantum_efficiencies": of_channels("RGB")}
    return pixel(
        colour,
        prnu=0.02,
        dsnu=0.3,
        read_noise_e=3.0,
        dark_current_e_per_s=200.0,
        bits=14,
        black_level_dn=200,
    )


def test_binning_sums_charge_before_one_readout() -> None:
    """Mean, and variance over sensors and frames, of four pixels read as one: 4 shot noises, a
    quarter of PRNU², one read noise.
    """
    single, read = derive(binned()), Readout.of(derive(binned()))
    assert (read.physics.read_pitch_um, str(read.physics.layout)) == (2 * single.pitch_um, "RG/GB")
    colour = {"pattern": "quad_rggb", "quantum_efficiencies": of_channels("RGB")}
    alone = signal(colour, pitch_um=2.5)
    sums = alone.reshape(len(alone) // 2, 2, -1, 2).sum(axis=(1, 3))
    np.testing.assert_allclose(signal(colour | {"binning": True}, pitch_um=2.5), sums, rtol=1e-12)
    mean_e, time_s, shape = 0.4 * single.full_well_e, 0.1, (300, 300)
    rng = np.random.default_rng(5)
    dn, dark = [], single.dark_current_e_per_s
    for _ in range(4):
        frame = capture_from_rates(
            np.full(shape, 4 * mean_e / time_s),
            sample_sensor(read, shape, rng),
            Exposure(integration_s=time_s),
            rng,
        )
        dn.append(frame.dn)
    variance_e2 = (
        4 * (mean_e + dark * time_s)
        + read.noise_floor_e**2
        + 4 * (0.02 * mean_e) ** 2
        + 4 * (0.3 * dark * time_s) ** 2
    )
    variance_e2 += read.physics.offset_fpn_e**2 + read.physics.column_fpn_e**2
    assert frame_variance_dn2(4 * mean_e, time_s, read) == pytest.approx(
        variance_e2 * read.dn_per_e**2 + 1 / 12, rel=1e-12
    )
    values = np.array(dn, float)
    # 360 000 values: standard error of a mean below 1e-3 of σ·√2, of a variance 2.4e-3; 4 of each.
    sigma = float(np.sqrt(frame_variance_dn2(4 * mean_e, time_s, read)))
    assert values.mean() == pytest.approx(
        float(frame_mean_dn(4 * mean_e, time_s, read)), abs=4 * sigma / 600 + 0.02 * sigma
    )
    assert values.var() == pytest.approx(sigma**2, rel=0.012)


def test_binning_needs_charge_that_moves() -> None:
    with pytest.raises(PixsimError, match=r"binning: got true for 0.35um, a 3T pixel.*4t-bsi"):
        derive(
            Pixel(
                pitch_um=8,
                colour={
                    "pattern": "quad_rggb",
                    "binning": True,
                    "quantum_efficiencies": of_channels("RGB"),
                },
            )
        )


@pytest.mark.parametrize("suffix", [".tiff", ".png", ".exr", ".npz"])
@pytest.mark.parametrize("pattern", ["gbrg", "stacked", "quad_rggb"])
def test_raw_files_carry_the_layout(suffix: str, pattern: str, tmp_path: Path) -> None:
    p = pixel({"pattern": pattern, "quantum_efficiencies": of_channels("RGB")})
    frame = pixsim.capture(light(), CAMERA, make_sensor(p, CAMERA), rng=np.random.default_rng(1))
    write_frame(tmp_path / f"raw{suffix}", frame)
    back = read_frame(tmp_path / f"raw{suffix}")
    assert back.layout == frame.layout == Layout(PATTERNS[pattern], pattern == "stacked")
    np.testing.assert_array_equal(back.dn, frame.dn)
    write_frame(tmp_path / f"again{suffix}", back)
    assert read_frame(tmp_path / f"again{suffix}").layout == frame.layout


@pytest.mark.parametrize("text", ["RG/G", "rg/gb", "R+G/B", "", "R+", "1/2"])
def test_unknown_layout_of_a_file_is_left_out(text: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "raw.npz", dn=np.ones((2, 2), np.uint8), layout=text)
    assert read_frame(tmp_path / "raw.npz").layout is None
    with pytest.raises(ValueError, match="allowed: rows of capital letters"):
        Layout.parse(text)


def test_planes_that_do_not_divide_a_frame_are_no_layout(tmp_path: Path) -> None:
    write_frame(
        tmp_path / "raw.npz", RawFrame(np.ones((4, 2), np.uint8), layout=Layout(("RGB",), True))
    )
    assert read_frame(tmp_path / "raw.npz").layout is None


def test_flat_frames_leave_the_balance_of_the_channels() -> None:
    """Corrected electrons keep each channel's own level, and what is left of PRNU is that of the
    flat frames.
    """
    p = Readout.of(
        derive(
            pixel({"quantum_efficiencies": of_channels("RGB")}, **QUIET | {"prnu": 0.1, "bits": 16})
        )
    )
    shape, rng = (60, 60), np.random.default_rng(2)
    layout = Layout.of(p.physics.pixel)
    levels = np.array([0.5, 1.0, 0.7])[layout.numbers(shape)]
    mean_e = 0.5 * p.full_well_e * levels
    sensor = sample_sensor(p, shape, rng)
    frame = capture_from_rates(mean_e / 0.01, sensor, Exposure(integration_s=0.01), rng)
    corrected = correct(frame, sensor, Correction(flat_frames=400), rng, None, levels).electrons
    for part, mean in zip(layout.parts(corrected), layout.parts(mean_e), strict=True):
        # 900 pixels of √(shot + quantisation) noise and 400 flat frames; PRNU alone would leave 10
        # %.
        assert part.std() < 3 * np.sqrt(mean[0, 0])
        assert part.mean() == pytest.approx(mean[0, 0], rel=5e-3)


def test_defects_are_replaced_by_pixels_of_their_own_colour() -> None:
    p = derive(pixel({"quantum_efficiencies": of_channels("RGB")}, **QUIET | {"bits": 16}))
    shape, rng = (20, 20), np.random.default_rng(2)
    layout = Layout.of(p.pixel)
    mean_e = np.array([1000.0, 4000.0, 2000.0])[layout.numbers(shape)]
    sensor = sample_sensor(
        Readout.of(
            derive(
                pixel(
                    {"quantum_efficiencies": of_channels("RGB")},
                    **QUIET | {"prnu": 0.01, "bits": 16},
                )
            )
        ),
        shape,
        rng,
    )
    sensor.gain[6, 6] = 0.0  # a dead red pixel among green and blue ones
    frame = capture_from_rates(mean_e / 0.01, sensor, Exposure(integration_s=0.01), rng)
    corrected = correct(
        frame, sensor, Correction(flat_frames=20, defects=True), rng, None, mean_e / mean_e.max()
    ).electrons
    assert corrected[6, 6] == pytest.approx(1000.0, rel=0.1)


def test_sound_pixels_of_a_dim_channel_are_no_defects() -> None:
    """Each channel has its own noise in a flat frame: in blue light of 2 % of green's, seven times
    as much, relative to white.
    """
    p, shape, rng = (
        Readout.of(
            derive(pixel({"quantum_efficiencies": of_channels("RGB")}, **QUIET | {"bits": 16}))
        ),
        (80, 80),
        np.random.default_rng(2),
    )
    layout = Layout.of(p.physics.pixel)
    levels = np.array([1.0, 1.0, 0.02])[layout.numbers(shape)]
    sensor = sample_sensor(p, shape, rng)
    frame = capture_from_rates(
        0.5 * p.full_well_e * levels / 0.01, sensor, Exposure(integration_s=0.01), rng
    )
    plain, mended = (
        correct(
            frame,
            sensor,
            Correction(flat_frames=1, defects=defects),
            np.random.default_rng(5),
            None,
            levels,
        ).electrons
        for defects in (False, True)
    )
    # Of 6400 normal values, none is beyond 6 σ of its channel.
    np.testing.assert_array_equal(mended, plain)


GOOD: dict[str, Any] = {"quantum_efficiencies": of_channels("RGB")}


@pytest.mark.parametrize(
    ("colour", "message"),
    [
        (
            {},
            (
                "no response of the channels; allowed: one of sensitivities, quantum_efficiencies,"
                " transmittances"
            ),
        ),
        (
            GOOD | {"transmittances": of_channels("RGB")},
            "quantum_efficiencies and transmittances state the same quantity",
        ),
        (
            {"sensitivities": "Nikon_D5100"},
            "sensitivities are relative; give peak_quantum_efficiency",
        ),
        (
            GOOD | {"peak_quantum_efficiency": 0.5},
            "peak_quantum_efficiency beside quantum_efficiencies, which are absolute",
        ),
        (
            GOOD | {"pattern": "rggb", "matrix": ["RG", "GB"]},
            "pattern and matrix state the same quantity",
        ),
        (GOOD | {"pattern": "rgbg"}, "allowed: 'rggb', 'grbg'"),
        (GOOD | {"matrix": ["RG", "G"]}, "allowed: rows of equal length"),
        (GOOD | {"matrix": []}, "allowed: rows of equal length"),
        (GOOD | {"matrix": ["RGRGRGRGRGRG"]}, "allowed: rows of equal length, up to 8 x 8"),
        (GOOD | {"matrix": ["Rg", "GB"]}, "allowed: .* capital letters"),
        (
            GOOD | {"matrix": ["RG", "XB"]},
            "the unit cell has X, of which no response is given; allowed: R, G, B",
        ),
        (
            GOOD | {"matrix": ["RG", "GR"]},
            "channel B has no pixels in RG, GR; add it to matrix, or leave it out",
        ),
        (
            GOOD | {"binning": True},
            "binning = true with pattern of the unit cell RG, GB; allowed: binning of 2 x 2 pixels",
        ),
        (
            {"quantum_efficiencies": {"R": CURVES["R"], "G": CURVES["G"]}},
            "the unit cell has B, of which no response",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": bell(460, 1.2)}},
            "channel B with .* allowed: .* of 0 to 1",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": bell(460, -0.1)}},
            "Set negative values, .*, to 0",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": CURVES["B"][:20]}},
            "for 400 to 590 nm; allowed: at least 400 to 700 nm",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": CURVES["B"][:9] + CURVES["B"][14:]}},
            "a gap from 480 to 540 nm",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": [[400, 0.0], [700, 0.0]]}},
            "a gap from 400 to 700",
        ),
        (
            {"quantum_efficiencies": of_channels("RG") | {"B": [[nm, 0.0] for nm in GRID]}},
            "that is 0 at every wavelength",
        ),
        ({"quantum_efficiencies": of_channels("RG") | {"B": 0.5}}, "got no list of pairs for B"),
        (
            {"quantum_efficiencies": of_channels("RG") | {"blueish": CURVES["B"]}},
            "channel named 'blueish'; allowed: one letter",
        ),
        ({"quantum_efficiencies": []}, "allowed: a CSV file of wavelength in nm"),
        ({"quantum_efficiencies": "no_such.csv"}, "no_such.csv"),
        ({"sensitivities": "no_such.csv", "peak_quantum_efficiency": 0.5}, "no_such.csv"),
    ],
)
def test_bad_colour_names_what_to_mend(colour: dict[str, Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        pixel(colour)


@pytest.mark.parametrize(
    ("colour", "message"),
    [
        ({"sensitivities": "Nikon_D510", "peak_quantum_efficiency": 0.5}, "Nikon_D5100"),
        (
            {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5, "pattern": "rccb"},
            "no channel C; allowed: channels R, G and B",
        ),
    ],
)
def test_bad_camera_names_what_to_mend(colour: dict[str, Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        derive(pixel(colour))


@pytest.mark.parametrize(
    ("colour", "develop", "message"),
    [
        (
            {"matrix": ["RG", "BG"]},
            {"demosaic": "malvar2004"},
            "'malvar2004' for the unit cell RG, BG; allowed: .* rggb, grbg, gbrg, bggr",
        ),
        ({"pattern": "quad_rggb"}, {"demosaic": "bilinear"}, "set pixel.colour.binning = true"),
        ({"pattern": "stacked"}, {"demosaic": "menon2007"}, "'menon2007' for stacked channels"),
        (
            {},
            {"white_balance": [2.0, 1.0]},
            "2 gains for 3 channels; allowed: 'known', or a gain for each of R, G, B",
        ),
    ],
)
def test_frames_that_cannot_be_developed_are_refused_before_a_render(
    colour: dict[str, Any], develop: Any, message: str
) -> None:
    given = GOOD | colour
    with pytest.raises(PixsimError, match=message):
        Run(pixel=pixel(given), develop=develop)
    with pytest.raises(PixsimError, match=message):
        pixsim.evaluate(light(), CAMERA, pixel(given), develop=Develop(**develop))


FILE = "# made up\nnm;red;green;blue\n" + "\n".join(f"{nm:g};0,5;0,4;0,3" for nm in GRID)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FILE.replace("nm;red;green;blue\n", ""), None),
        (FILE, None),
        (FILE.replace("green", "red"), "two channels R"),
        (FILE.replace(";blue", ""), "2 channels in the title and 3 values"),
        (
            FILE.replace("0,5;0,4;0,3", "0,5;0,4;x", 3),
            "got no 3 numbers in line|two channels|values",
        ),
        ("nm,r\n400,0.5\n700,0.4\n", "3 values|got no 3 numbers"),
        ("", "at least|values"),
    ],
)
def test_curves_of_a_file(text: str, message: str | None, tmp_path: Path) -> None:
    path = tmp_path / "qe.csv"
    path.write_text(text, encoding="utf-8")
    if message is None:
        colour = pixel({"quantum_efficiencies": str(path)}).colour
        assert {letter: curve[3] for letter, curve in colour.curves.items()} == {
            "R": (430, 0.5),
            "G": (430, 0.4),
            "B": (430, 0.3),
        }
        return
    with pytest.raises(PixsimError, match=message):
        pixel({"quantum_efficiencies": str(path)})


def test_a_later_layer_restates_the_response_and_the_cell() -> None:
    base = {
        "pixel": {
            "colour": {
                "pattern": "rggb",
                "sensitivities": "Nikon_D5100",
                "peak_quantum_efficiency": 0.5,
            }
        }
    }
    over = {
        "pixel": {"colour": {"matrix": ["RG", "GB"], "quantum_efficiencies": of_channels("RGB")}}
    }
    assert merge(base, over) == over


def test_data_sheet_of_a_colour_sensor_needs_no_other_efficiency() -> None:
    sheet = {"pitch_um": 3.0, "full_well_e": 9000, "read_noise_e": 2, "dark_current_e_per_s": 1}
    assert Pixel(**sheet, colour=GOOD).technology == "none"
    assert Pixel(**sheet, colour={"transmittances": of_channels("RGB")}).technology == "0.35um"


def test_diffusion_and_lights_follow_the_channels() -> None:
    p: PixelPhysics = derive(pixel(GOOD))
    lights = lights_of(light(), CAMERA, p)
    assert len(lights) == 3
    assert len({one.illumination.weight for one in lights}) == 3


def test_cameras_whose_channels_lost_their_ratio_are_named() -> None:
    for camera, warned in (("Nikon_D5100", True), ("ARRI_D21", True), ("Nikon_D810", False)):
        physics = derive(pixel({"sensitivities": camera, "peak_quantum_efficiency": 0.5}))
        notes = pixel_notes(physics, CAMERA, light())
        assert (
            any(f"each channel of {camera} was scaled to its own peak" in note for note in notes)
            is warned
        )
