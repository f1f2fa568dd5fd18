"""Frames as they leave the sensor: bursts against the same exposures taken one by one, correction
against closed forms of its residuals, and files read back as the same numbers.

Statistical gates are 5 standard errors with fixed seeds: 6e-7 false alarms each, with another seed.
A burst that loses 1 % of an exposure's variance, or 0.2 of its electrons, is outside of them.
"""

import json
import math
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.claims import check
from helpers.statistics import check_mean, seeded
from helpers.tiff import tiff
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import pixsim
from pixsim import Correction, Exposure, Pixel, cli
from pixsim.base.arrays import Array, stream
from pixsim.sensor.colour import Layout
from pixsim.sensor.correction import correct, residual_variance_e2
from pixsim.sensor.pixel import derive
from pixsim.sensor.raw import (
    BLACK_LEVEL_TAG,
    ENCODING,
    FACTS,
    SUFFIXES,
    WHITE_LEVEL_TAG,
    RawFrame,
    read_frame,
    read_picture,
    saturated_of,
    write_frame,
)
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, Sensor, capture_from_rates, sample_sensor

COUNT = 8
BURST_S = 0.04
BURST_SHAPE = (500, 100)  # rows are independent but for the offsets of columns
BURST = Exposure(integration_s=BURST_S, frames=COUNT)
SINGLE = Exposure(integration_s=BURST_S / COUNT)
SHEET = {
    "pitch_um": 2.0,
    "full_well_e": 8000,
    "read_noise_e": 3.0,
    "dark_current_e_per_s": 500,
    "quantum_efficiency": 0.5,
    "bits": 12,
    "black_level_dn": 100.0,
    "gain_e_per_dn": 2.0,
    "prnu": 0.01,
    "dsnu": 0.2,
    "dsnu_e": 4.0,
    "row_noise_e": 2.0,
}
NO_SPREAD = {"prnu": 0.0, "dsnu": 0.0}


def reading(**over) -> Readout:
    return Readout.of(derive(Pixel(**SHEET | over)))


def taken(
    readout: Readout,
    mean_e: float,
    exposure: Exposure = BURST,
    shape: tuple[int, int] = BURST_SHAPE,
    seed: int = 2,
) -> Frame:
    """A frame of uniform light, which has this mean in the time of a burst."""
    return capture_from_rates(
        np.full(shape, mean_e / BURST_S),
        sample_sensor(readout, shape, seeded(1)),
        exposure,
        seeded(seed),
    )


# Far from all ends; in the dark without a black level; near the well; near the top code; with noise
# far below a code; and a soft well that is full in each exposure.
PLACES: dict[str, tuple[Readout, float]] = {
    "between": (reading(), 8000.0),
    "dark, clipped": (reading(black_level_dn=0.0), 0.0),
    "at the well": (reading(bits=14, **NO_SPREAD), COUNT * 7850.0),
    "at the top code": (reading(gain_e_per_dn=1.0), COUNT * 3970.0),
    "coarse codes": (
        reading(gain_e_per_dn=60.0, black_level_dn=20.3, bits=10, prnu=0.0, row_noise_e=0.0),
        80.0,
    ),
    "soft well": (
        Readout.of(derive(Pixel(pitch_um=6.5, black_level_dn=40.0))),
        1.1 * COUNT * derive(Pixel(pitch_um=6.5)).full_well_e,
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_burst_is_the_sum_of_its_exposures(name: str) -> None:
    readout, mean_e = PLACES[name]
    burst = taken(readout, mean_e).dn
    total = sum(
        taken(readout, mean_e, SINGLE, seed=3 + number).dn.astype(int) for number in range(COUNT)
    )
    # Of the same sensor, so that the fixed pattern cancels in the difference.
    check_mean("difference of means", (burst - total).mean(axis=1), 0.0)
    burst_spread, total_spread = (
        ((dn - dn.mean(axis=0)) ** 2).mean(axis=1) for dn in (burst, total)
    )
    check_mean("difference of variances", burst_spread - total_spread, 0.0)


@pytest.mark.parametrize(
    "more",
    [
        {},
        {
            "colour": {
                "pattern": "quad_rggb",
                "binning": True,
                "sensitivities": "Nikon_D5100",
                "peak_quantum_efficiency": 0.5,
            }
        },
    ],
    ids=["pixels", "binned"],
)
def test_saturated_pixels_are_those_full_in_any_exposure(more: dict) -> None:
    """Row k is 40 standard deviations above the well in exposure k alone, the last two never; the
    sum is below half of all wells.
    """
    sheet = {"technology": "4t-bsi", "pitch_um": 2.0, "bits": 14, "prnu": 0.0}
    readout = Readout.of(derive(Pixel.model_validate(sheet | {"dark_current_e_per_s": 0.0} | more)))
    well_e = readout.full_well_e
    sensor = sample_sensor(readout, (COUNT + 2, 40), seeded(1))
    signals = [np.full(sensor.shape, 0.3 * well_e / BURST_S) for _ in range(COUNT)]
    for number, signal in enumerate(signals):
        signal[number] = (well_e + 40 * math.sqrt(well_e)) / BURST_S
    exposure = Exposure(integration_s=BURST_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    rows = np.broadcast_to(np.arange(COUNT + 2)[:, None] < COUNT, frame.dn.shape)
    np.testing.assert_array_equal(frame.saturated, rows)
    assert frame.saturated_fraction == COUNT / (COUNT + 2)
    assert frame.dn.max() < COUNT * 2**14 / 2


@pytest.mark.parametrize(("wells", "share"), [(0.95, 0.0), (1.2, 1.0)])
def test_soft_well_is_full_at_its_full_well(wells: float, share: float) -> None:
    """At 95 % of the well it has lost light, which `saturated_fraction` counts, but is full from
    99 % on; both are more than 10 standard deviations of shot noise away.
    """
    sheet = {"bits": 14, "adc_full_scale_e": 4e5, "well_limit": "diode"}
    readout = Readout.of(derive(Pixel(pitch_um=6.5, black_level_dn=40.0, **sheet, **NO_SPREAD)))
    assert 0.03 * math.sqrt(readout.full_well_e) > 10
    frame = taken(readout, COUNT * wells * readout.full_well_e, shape=(50, 50))
    assert (frame.saturated.mean(), frame.saturated_fraction) == (share, 1.0)


def test_defect_between_saturated_pixels_is_saturated() -> None:
    """A hot pixel, full in each exposure, is replaced by its neighbours: it is saturated if one of
    them is.
    """
    sensor = sample_sensor(reading(dark_current_e_per_s=50.0, **NO_SPREAD), (40, 40), seeded(1))
    hot = np.ones(sensor.shape)
    hot[[10, 30], [10, 30]] = 1e5
    sensor = replace(sensor, dark_gain=hot)
    signals = [np.full(sensor.shape, 2e4) for _ in range(COUNT)]
    signals[3][10, 11] = 1e7
    exposure = Exposure(integration_s=BURST_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    corrected = correct(frame, sensor, Correction(dark_frames=4, defects=True), seeded(3))
    places = [np.argwhere(pixels).tolist() for pixels in (frame.saturated, corrected.saturated)]
    assert places == [[[10, 10], [10, 11], [30, 30]], [[10, 10], [10, 11]]]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_raw_file_has_the_sum_and_its_saturated_pixels(suffix: str, tmp_path: Path) -> None:
    """The codes of a single exposure tell which are saturated, and no file states them."""
    sensor = sample_sensor(reading(prnu=0.0), (70, 90), seeded(1))
    rates = seeded(9).uniform(0, 2 * COUNT * 8000 / BURST_S, (70, 90))
    frame = capture_from_rates(rates, sensor, BURST, seeded(2))
    assert 0.3 < frame.saturated.mean() < 0.7
    path = tmp_path / f"raw{suffix}"
    write_frame(path, frame)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, frame.dn)
    np.testing.assert_array_equal(stored.saturated, frame.saturated)
    assert (stored.black_level_dn, stored.white_level_dn) == (COUNT * 100.0, COUNT * 4095.0)
    assert stored.bits == 15
    write_frame(tmp_path / f"again{suffix}", stored)
    assert (tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()
    write_frame(path, capture_from_rates(rates, sensor, SINGLE, seeded(2)))
    assert read_frame(path).saturated is None


@pytest.mark.parametrize("stated", ["yes", "AAAA", "eJw=", "", None, 3, [1]])
def test_text_that_is_no_saturated_pixels_is_left_out(stated: object) -> None:
    assert saturated_of({"saturated": stated}, (8, 9)) is None


SHAPE = (200, 250)
TIME_S = 0.02
# A pixel in which each kind of noise is visible, in a linear range: no clipping at 0 DN, no
# saturation.
NOISY = {
    "pitch_um": 6.0,
    "full_well_e": 20000.0,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 5e4,
    "quantum_efficiency": 0.5,
    "prnu": 0.02,
    "dsnu": 0.05,
    "offset_fpn": 0.003,
    "column_fpn": 0.002,
    "bits": 14,
    "black_level_dn": 800.0,
}
CLEAN = dict.fromkeys(
    ("read_noise_e", "dark_current_e_per_s", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0.0
)

PLAIN = Exposure(integration_s=TIME_S)


def sensor_of(shape: tuple[int, int] = SHAPE, **over) -> Sensor:
    return sample_sensor(Readout.of(derive(Pixel(**NOISY | over))), shape, seeded(0))


def corrected_e(
    sensor: Sensor,
    signal_e,
    correction: Correction,
    exposure: Exposure = PLAIN,
    balance: Array | None = None,
    shading: Array | None = None,
) -> Array:
    """Corrected electrons of a picture with a mean signal."""
    frame = capture_from_rates(
        np.broadcast_to(signal_e, sensor.shape) / TIME_S, sensor, exposure, stream("picture", 0)
    )
    return correct(frame, sensor, correction, stream("correction", 0), shading, balance).estimate_e


@pytest.mark.parametrize("signal_e", [0.0, 8000.0, 15000.0])
@pytest.mark.parametrize(
    "frames",
    [
        {"dark_frames": 4},
        {"flat_frames": 8, "flat_level": 0.6},
        {"dark_frames": 4, "flat_frames": 4},
        {"column_clamp": 16},
        {"column_clamp": 8, "dark_frames": 4, "flat_frames": 8},
    ],
)
def test_correction_leaves_the_closed_form(frames: dict, signal_e: float) -> None:
    """Mean over columns, which are independent, of the squared residual; 5 standard errors: 6e-7
    false alarms each. 4 % of a variance is outside, and what a column shares 20 %. The closed form
    is of first order: PRNU² and 1/L beside 1 are 4e-4.
    """
    sensor = sensor_of()
    correction = Correction(**frames)
    squares = (corrected_e(sensor, signal_e, correction) - signal_e) ** 2
    expected = residual_variance_e2(signal_e, TIME_S, sensor.readout, correction).total
    check_mean("residual", squares.mean(axis=0) / expected, 1.0)


@pytest.mark.parametrize("frames", [{"dark_frames": 4}, {"dark_frames": 4, "flat_frames": 4}])
@pytest.mark.parametrize("burst", [1, 4])
def test_correction_at_gain_leaves_the_closed_form(frames: dict, burst: int) -> None:
    """Dark and flat frames have the gain and the exposures of the picture, whatever those of the
    sensor: at 0 dB the read noise would be 300 e-, and the flat level beyond the ADC's range.
    """
    noise = {"read_noise_after_gain_e": 300.0, "column_fpn": 0.0, "black_level_dn": 4000.0}
    sensor = sensor_of(**noise, dark_current_e_per_s=2e3)
    correction = Correction(**frames)
    exposure = Exposure(integration_s=TIME_S, gain_db=20.0, frames=burst)
    electrons = corrected_e(sensor, 700.0, correction, exposure)
    amplified = replace(sensor, readout=sensor.readout.at(exposure))
    np.testing.assert_array_equal(corrected_e(amplified, 700.0, correction, exposure), electrons)
    expected = residual_variance_e2(700.0, TIME_S, amplified.readout, correction).total
    check_mean("residual", (electrons - 700.0).ravel() ** 2 / expected, 1.0)


def test_dark_frames_remove_a_clipped_dark_level() -> None:
    """Without a black level half of the dark noise is clipped, which brightens black; dark frames
    have the same mean.
    """
    sensor = sensor_of(black_level_dn=0.0, dark_current_e_per_s=0.0, offset_fpn=0.01)
    assert corrected_e(sensor, 0.0, Correction(flat_frames=1)).mean() > 40.0
    check_mean("dark", corrected_e(sensor, 0.0, Correction(dark_frames=4)), 0.0)


def test_dark_rows_do_not_change_the_noise_of_other_frames() -> None:
    """With rows that have no noise the results are equal."""
    quiet = sensor_of((20, 30), **CLEAN | {"prnu": 0.02, "black_level_dn": 100})
    plain, clamped = (
        corrected_e(quiet, 5000.0, Correction(flat_frames=2, **clamp))
        for clamp in ({}, {"column_clamp": 3})
    )
    np.testing.assert_allclose(plain, clamped, rtol=1e-6)


def test_defects_are_found_in_dark_and_flat_frames() -> None:
    """A hot pixel in dark frames, a dead one in flat frames; sound pixels are outliers with a
    probability of 2e-9.
    """
    sensor = sensor_of(dsnu=0.0)
    sensor.gain[10, 10] = 0.0
    sensor.offset_e[50, 60] += 3000.0
    plain, mended = (
        corrected_e(sensor, 5000.0, Correction(dark_frames=4, flat_frames=4, defects=defects))
        for defects in (False, True)
    )
    assert plain[10, 10] < 1000 < 4500 < mended[10, 10] < 5500
    assert set(map(tuple, np.argwhere(plain != mended).tolist())) == {(10, 10), (50, 60)}


# --- Colour

COLOUR = {
    "quantum_efficiency": None,
    "bits": 16,
    "colour": {
        "quantum_efficiencies": {key: [[nm, 0.5] for nm in range(400, 701, 10)] for key in "RGB"}
    },
}


def balance_of(sensor: Sensor, levels: list[float]) -> Array:
    return np.array(levels)[sensor.readout.physics.layout.numbers(sensor.shape)]


def test_flat_frames_leave_the_balance_of_the_channels_and_no_shading() -> None:
    """Corrected electrons keep each channel's own level, of a pixel on axis: within 1 %, 5 standard
    errors of 3600 gains of 10 % (6e-7 false alarms); and that PRNU is gone. The brightest pixel,
    not one on axis, has the level of the flat frames: with 0.94 of the well they would be clipped.
    """
    sensor = sensor_of((60, 60), **CLEAN | COLOUR | {"prnu": 0.1})
    balance = balance_of(sensor, [0.5, 1.0, 0.7])
    shading = np.linspace(0.75, 1.25, 60) * np.ones((60, 1))
    light_e = 10_000.0 * balance * shading
    electrons = corrected_e(
        sensor,
        light_e,
        Correction(flat_frames=400, flat_level=0.75),
        balance=balance,
        shading=shading,
    )
    for level in (0.5, 1.0, 0.7):
        ratio = electrons[balance == level] / (10_000.0 * level)
        check("level", ratio.mean(), 1.0, atol=0.01, why="the mean of 3600 gains")
        assert ratio.std() < 0.05


def test_defects_are_replaced_by_pixels_of_their_own_colour() -> None:
    """A dead red pixel among green and blue ones, and weak ones in shading that is far stronger; in
    blue light of 2 % of green's, noise that is seven times as large relative to white, there are no
    other defects. The signal of 4 % is not divided by its response, that of 6 % is.
    """
    sensor = sensor_of((80, 80), **CLEAN | COLOUR | {"prnu": 0.01})
    places = [6, 20, 30, 32]
    sensor.gain[places, places] = 0.0, 0.7, 0.04, 0.06
    balance = balance_of(sensor, [0.25, 1.0, 0.02])
    plain, mended = (
        corrected_e(
            sensor,
            8000.0 * balance * (shading := np.linspace(0.6, 1.0, 80) * np.ones((80, 1))),
            Correction(flat_frames=20, defects=defects),
            balance=balance,
            shading=shading,
        )
        for defects in (False, True)
    )
    assert mended[6, 6] == pytest.approx(2000.0, rel=0.1)
    assert plain[places[2:], places[2:]] == pytest.approx([80.0, 2000.0], rel=0.5)
    assert np.argwhere(plain != mended).tolist() == [[place, place] for place in places]


CODES = np.array([[0, 1, 2, 4095], [64, 1000, 4094, 63], [7, 8, 9, 10]], np.int32)
CELL = [[256.0, 257.0], [258.0, 256.0]]


def coded_frame(dn: np.ndarray = CODES, bits: int = 12) -> Frame:
    return Frame(dn, np.zeros(dn.shape), 1 / 60, 0.37, 64.25, 3.0, 5.3, bits, 1 / 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("written", "facts"),
    [
        (coded_frame(), (64.25, 4095.0, 12, 5.3, 0.37, 1 / 60, 1 / 3)),
        (RawFrame(CODES), (None,) * 7),
        (RawFrame(CODES[:, :3], black_level_dn=np.tile(CELL, (2, 2))[:3, :3]), None),
    ],
)
def test_numbers_and_facts_are_read_back(suffix: str, written, facts, tmp_path: Path) -> None:
    """And written again, they make the same file."""
    path = tmp_path / f"raw{suffix}"
    write_frame(path, written)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, written.dn)
    assert stored.dn.dtype == np.min_scalar_type(written.dn.max())
    if facts is None:
        np.testing.assert_array_equal(stored.black_level_dn, written.black_level_dn)
        assert "black_level_dn=256…258" in repr(stored)
    else:
        assert tuple(getattr(stored, name) for name in FACTS) == facts
    write_frame(tmp_path / f"again{suffix}", stored)
    assert (tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()


def test_the_smallest_cell_of_black_levels_is_stored(tmp_path: Path) -> None:
    write_frame(
        tmp_path / "raw.npz", RawFrame(CODES[:, :3], black_level_dn=np.tile(CELL, (2, 2))[:3, :3])
    )
    with np.load(tmp_path / "raw.npz") as file:
        np.testing.assert_array_equal(file["black_level_dn"], CELL)


LARGEST = {".npz": 2**32 - 1, ".exr": 2**24 - 1}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_no_format_holds_another_number(suffix: str, tmp_path: Path) -> None:
    """Of 16 bits 70000 would be 4464, and float32 rounds 2²⁴ + 1: refused, without a file."""
    path = tmp_path / f"raw{suffix}"
    for value in (-1, 1.7, np.nan, np.inf, 1e30, 2**32, 2**24 + 1, 2**24, 2**16, 2**16 - 1, 0):
        frame = RawFrame(np.array([[1, value]]))
        if 0 <= value <= LARGEST.get(suffix, 2**16 - 1) and value % 1 == 0:
            write_frame(path, frame)
            np.testing.assert_array_equal(read_frame(path).dn, frame.dn)
            path.unlink()
        else:
            with pytest.raises(pixsim.PixsimError, match=r"whole numbers|up to .* bits"):
                write_frame(path, frame)
        assert not list(tmp_path.iterdir()), value


@pytest.mark.parametrize(
    ("name", "written", "words"),
    [
        ("a.npz", RawFrame(np.ones(3)), r"\(rows, columns\)"),
        ("a.npz", RawFrame(np.ones((0, 3))), r"\(rows, columns\)"),
        ("a.npz", RawFrame(CODES, white_level_dn=np.inf), "white_level_dn"),
        (
            "a.npz",
            RawFrame(
                np.full((40, 40), 9),
                black_level_dn=np.random.default_rng(1).uniform(0, 9, (40, 40)),
            ),
            "16 × 16",
        ),
        ("a.dat", RawFrame(CODES), r"\.exr, \.tiff, \.tif, \.png, \.npz"),
    ],
)
def test_frames_that_cannot_be_written_leave_no_file(
    name: str, written: RawFrame, words: str, tmp_path: Path
) -> None:
    with pytest.raises(pixsim.PixsimError, match=words):
        write_frame(tmp_path / name, written)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a.npz", np.array([[0.5]]), "whole numbers from 0 to"),
        ("a.npz", np.array(["a"]), "whole numbers, "),
        ("a.npz", np.zeros((2, 3, 3)), "red, green and blue"),
        ("a.png", np.zeros((4, 4, 3), np.uint8), "mode RGB"),
        ("a.tiff", np.zeros((4, 4), np.uint8), "mode L"),
        ("a.dat", None, r"\.npz"),
        ("a.png", None, "does not exist"),
    ],
)
def test_files_that_are_no_frames_are_refused(
    name: str, array: np.ndarray | None, words: str, tmp_path: Path
) -> None:
    if array is not None and name == "a.npz":
        np.savez(tmp_path / name, dn=array)
    elif array is not None:
        Image.fromarray(array).save(tmp_path / name)
    with pytest.raises(pixsim.PixsimError, match=words):
        read_frame(tmp_path / name)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_truncated_file_is_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    write_frame(path, coded_frame(np.arange(4096, dtype=np.int32).reshape(64, 64)))
    whole = path.read_bytes()
    for length in range(0, len(whole) - 40, len(whole) // 20):
        path.write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            read_frame(path)


def test_other_programs_read_the_numbers_and_the_facts(tmp_path: Path) -> None:
    for suffix in SUFFIXES:
        write_frame(tmp_path / f"raw{suffix}", coded_frame())
    with Image.open(tmp_path / "raw.png") as image:
        np.testing.assert_array_equal(np.asarray(image), CODES)
        stated = {"black_level_dn": "64.25", "white_level_dn": "4095.0", "unit": "DN"}
        assert stated.items() <= image.text.items()
    with Image.open(tmp_path / "raw.tiff") as image:
        np.testing.assert_array_equal(np.asarray(image), CODES)
        assert (image.tag_v2[BLACK_LEVEL_TAG], image.tag_v2[WHITE_LEVEL_TAG]) == (64.25, 4095)
        assert json.loads(image.tag_v2[270])["integration_s"] == 1 / 60
    with np.load(tmp_path / "raw.npz") as file:
        np.testing.assert_array_equal(file["dn"], CODES)
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, CODES)
        assert file.header()["unit"] == "DN"


def test_facts_of_other_programs_may_be_anything(tmp_path: Path) -> None:
    metadata = PngInfo()
    metadata.add_text("black_level_dn", "many")
    metadata.add_text("bits", "nan")
    path = tmp_path / "odd.png"
    Image.fromarray(CODES.astype(np.uint16)).save(path, pnginfo=metadata)
    assert [getattr(read_frame(path), name) for name in FACTS] == [None] * 7
    np.savez(tmp_path / "one.npz", picture=CODES)
    np.testing.assert_array_equal(read_frame(tmp_path / "one.npz").dn, CODES)


@pytest.mark.parametrize(
    ("facts", "saturated", "at_top"),
    [
        ({"bits": 12}, None, 1 / 12),
        ({"white_level_dn": 4000.0}, None, 2 / 12),
        ({"saturated_fraction": 0.5}, 0.5, None),
    ],
)
def test_fraction_at_the_top_code_is_counted(
    facts: dict[str, float], saturated: float | None, at_top: float | None, tmp_path: Path
) -> None:
    np.savez(tmp_path / "raw.npz", dn=CODES, **facts)
    stored = read_frame(tmp_path / "raw.npz")
    assert (stored.saturated_fraction, stored.top_code_fraction) == (saturated, at_top)


def test_formats_of_16_bits_are_refused_for_frames_of_more(tmp_path: Path, capsys) -> None:
    with pytest.raises(SystemExit):
        cli.main(["run", "csf", "--pixel.bits", "20", "--raw", "png", "--out", f"{tmp_path}/deep"])
    assert "--raw: got tiff or png for frames of 20 bits" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# --- TIFF/EP, DNG and PNG of other programs


@pytest.mark.parametrize(
    ("layout", "size", "pattern"),
    [
        ("GR/BG", (2, 2), (1, 0, 2, 1)),
        ("RGB/GGR", (2, 3), (0, 1, 2, 1, 1, 0)),
        ("RC/CB", None, None),
        ("R+G+B", None, None),
    ],
)
def test_tiff_states_its_mosaic_as_other_programs_do(
    layout: str, size, pattern, tmp_path: Path
) -> None:
    """Tags 33421 and 33422 of TIFF/EP: rows and columns, then 0 for red, 1 for green, 2 for blue;
    none for other colours.
    """
    write_frame(
        tmp_path / "raw.tiff",
        RawFrame(np.arange(36).reshape(6, 6), bits=8, layout=Layout.parse(layout)),
    )
    with Image.open(tmp_path / "raw.tiff") as picture:
        tags = picture.tag_v2
    stated = tags.get(33422)
    assert (tags.get(33421), stated if stated is None else tuple(stated)) == (size, pattern)
    assert str(read_frame(tmp_path / "raw.tiff").layout) == layout


@pytest.mark.parametrize("deflate", [False, True])
def test_mosaic_of_tiff_ep_is_read(deflate: bool, tmp_path: Path) -> None:
    """Photometric interpretation 32803, with its tags; cut off anywhere, it is refused."""
    path = tmp_path / "raw.tif"
    values = np.arange(8 * 6).reshape(8, 6, 1).astype("<u2")
    tags = {"t33421": (3, [2, 2]), "t33422": (1, [1, 2, 0, 1]), "t50714": (3, [64] * 4)}
    tiff(path, values, 32803, deflate=deflate, **tags)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, values[..., 0])
    assert (str(stored.layout), stored.black_level_dn) == ("GB/RG", 64.0)
    whole = path.read_bytes()
    (directory,) = struct.unpack("<I", whole[4:8])
    for length in range(0, directory + 12 * 10, 21):  # of fourteen entries
        path.write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            read_frame(path)


@pytest.mark.parametrize("photometric", [1, 32803])
def test_black_levels_of_each_place_of_the_cell_are_read(photometric: int, tmp_path: Path) -> None:
    tiff(
        tmp_path / "raw.tif",
        np.full((8, 6, 1), 300, "<u2"),
        photometric,
        **{"t50713": (3, [2, 2]), "t50714": (3, [256, 257, 258, 256])},
    )
    np.testing.assert_array_equal(
        read_frame(tmp_path / "raw.tif").black_level_dn, np.tile(CELL, (4, 3))
    )


@pytest.mark.parametrize("size", [{}, {"t50713": (3, [2, 3])}])
def test_black_levels_that_fit_no_cell_are_named(size: dict, tmp_path: Path) -> None:
    tags = {"t50714": (3, [1, 2, 3, 4])} | size
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), 1, **tags)
    with pytest.warns(UserWarning, match="black levels whose cell"):
        assert read_frame(tmp_path / "raw.tif").black_level_dn is None


@pytest.mark.parametrize(("gamma", "encoding"), [(1.0, None), (2.2, "TransferFunction")])
def test_transfer_function_of_a_tiff_is_an_encoding(
    gamma: float, encoding: str | None, tmp_path: Path
) -> None:
    curve = np.rint(65535 * np.linspace(0, 1, 256) ** gamma).astype(int).tolist()
    tiff(tmp_path / "picture.tif", np.full((8, 6, 1), 9, "<u2"), 1, t301=(3, curve))
    _, metadata = read_picture(tmp_path / "picture.tif", "picture", SUFFIXES)
    assert metadata.get(ENCODING) == encoding


DEEP = np.random.default_rng(1).integers(0, 65536, (7, 5, 4))


@pytest.mark.parametrize("count", [3, 4])
def test_deep_rgb_of_a_tiff_is_read_to_the_last_bit(count: int, tmp_path: Path) -> None:
    path = tmp_path / "deep.tif"
    tiff(path, DEEP[..., :count].astype("<u2"), 2, **({"t338": (3, [2])} if count == 4 else {}))
    np.save(tmp_path / "deep.npy", DEEP[..., :count])
    for file in ("deep.npy", "deep.tif"):
        values, _ = read_picture(tmp_path / file, "picture", (".npy", ".tif"), in_colour=True)
        np.testing.assert_array_equal(values, DEEP[..., :3])
    with pytest.raises(pixsim.PixsimError, match="red, green and blue"):
        read_frame(path)


@pytest.mark.parametrize(("count", "colour_type"), [(3, 2), (4, 6)])
@pytest.mark.parametrize("encoding", [None, "srgb"])
def test_deep_rgb_of_a_png_is_read_to_the_last_bit(
    count: int, colour_type: int, encoding: str | None, tmp_path: Path
) -> None:
    rows = b"".join(b"\0" + row.tobytes() for row in DEEP[..., :count].astype(">u2"))
    chunks = {
        b"IHDR": struct.pack(">2I5B", 5, 7, 16, colour_type, 0, 0, 0),
        **({b"sRGB": bytes(1)} if encoding else {}),
        b"IDAT": zlib.compress(rows),
        b"IEND": b"",
    }
    body = b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks.items()
    )
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    values, metadata = read_picture(tmp_path / "deep.png", "picture", SUFFIXES, in_colour=True)
    np.testing.assert_array_equal(values, DEEP[..., :3])
    assert metadata.get(ENCODING) == encoding


@pytest.mark.parametrize(
    ("kind", "channels", "photometric", "tags", "words"),
    [
        ("<f4", 3, 2, {}, "Pillow does not read"),
        ("<u2", 3, 2, {"planar": True}, "a plane for each colour"),
        ("<u1", 1, 32803, {}, "Pillow does not read"),
        ("<u2", 1, 32803, {"t50829": (3, [1, 2, 7, 6])}, "ActiveArea"),
        ("<u2", 1, 0, {}, "WhiteIsZero"),
    ],
)
def test_other_tiffs_are_refused(
    kind: str, channels: int, photometric: int, tags: dict, words: str, tmp_path: Path
) -> None:
    tiff(tmp_path / "a.tif", np.full((8, 6, channels), 9, kind), photometric, **tags)
    with pytest.raises(pixsim.PixsimError, match=words):
        read_picture(tmp_path / "a.tif", "picture", SUFFIXES, in_colour=True)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.tif", {}),
        ("a.tif", {"big_tiff": True}),
        ("a.tif", {"compression": "tiff_adobe_deflate"}),
        ("a.png", {}),
    ],
)
def test_the_first_of_several_pages_is_read(name: str, options: dict, tmp_path: Path) -> None:
    pages = [Image.fromarray(np.full((8, 6), 100 + page, np.uint16)) for page in range(3)]
    pages[0].save(tmp_path / name, save_all=True, append_images=pages[1:], **options)
    with pytest.warns(UserWarning, match="several pages"):
        assert (read_frame(tmp_path / name).dn == 100).all()
