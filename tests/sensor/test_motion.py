"""Light that changes in an exposure: motion, a rolling shutter and flicker, against pictures whose
moved form is known and the lamp's light over each exposure.
"""

import math
import warnings
from dataclasses import astuple, replace

import numpy as np
import pytest
from helpers.statistics import check_mean, seeded
from helpers.tiny import tiny
from scipy.integrate import quad
from scipy.special import erf

from pixsim import Camera, Display, Exposure, Pixel, PixsimError, SpectralImage
from pixsim.sensor.integration import MovingPicture, integrate_pixels
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion, LightSpectrum
from pixsim.sensor.motion_options import NO_MOTION, Motion, motion_text
from pixsim.sensor.readout import capture, capture_from_rates, make_sensor
from pixsim.studies.prepare import prepare
from pixsim.studies.sweep import sweep
from pixsim.viewer.evaluate import evaluate


def moved(
    samples: np.ndarray, motion: ImageMotion, side_um: float = 1.6, cell_um: float = 1.0
) -> np.ndarray:
    """Integrals of a moving picture over pixels of 2 cells."""
    return integrate_pixels(
        samples,
        cell_um,
        2 * cell_um,
        side_um,
        moving_picture=MovingPicture(LightSpectrum(samples), motion),
    )


def wave(shape: tuple[int, int], half_periods: tuple[float, float]) -> np.ndarray:
    """Cell means of 1 + cos cos, which goes on beyond its borders by reflection."""
    lines = []
    for count, number in zip(shape, half_periods, strict=True):
        angle = math.pi * number / count
        lines.append(np.cos(angle * (np.arange(count) + 0.5)) * np.sinc(number / count / 2))
    return 1 + 0.5 * np.multiply.outer(*lines)


def contrast(pixels: np.ndarray, still: np.ndarray) -> float:
    """Contrast of pixels over that of others of the same phase."""
    deviation = still - still.mean()
    return float((deviation * pixels).sum() / (deviation**2).sum())


# Paths from a thousandth of a pixel to a thousand, along one axis, slanted, along both diagonals,
# and slanted by rounding only; frequencies up to 0.3 cycles a pixel.
PATHS_UM = [
    (2e-3, 0.0),
    (13.3, 0.0),
    (0.0, 0.7),
    (0.0, 2000.0),
    (2e-3, 1e-3),
    (17.0, -9.0),
    (12.0, 12.0),
    (12.0, 12.0 + 1e-9),
    (5.0, 1e-13),
    (12.0, -12.0),
]
HALF_PERIODS = [(3.0, 0.0), (0.0, 240.0), (30.0, 24.0), (160.0, 120.0)]


@pytest.mark.parametrize(
    ("path_um", "half_periods"),
    [
        (path_um, HALF_PERIODS[(number + other) % 4])
        for number, path_um in enumerate(PATHS_UM)
        for other in (0, 2)
    ],
)
def test_contrast_of_a_wave_is_the_mean_of_two_sincs(
    path_um: tuple[float, float], half_periods: tuple[float, float]
) -> None:
    """cos a cos b along (u, v) is (cos(a + b) + cos(a - b))/2, each of which keeps the sinc of its
    own frequency along the path. The spline errs with the sixth power of the frequency, up to the
    borders, at which the picture is reflected; another one errs by 18 times as much there.
    """
    shape = (400, 300)
    samples = wave(shape, half_periods)
    down, across = np.array(half_periods) / 2 / shape * path_um
    still = moved(samples, NO_IMAGE_MOTION)
    lines = (
        np.cos(math.pi * number / count * np.arange(1, count, 2)) * np.sinc(0.8 * number / count)
        for number, count in zip(half_periods, shape, strict=True)
    )
    np.testing.assert_allclose(
        still,
        1.6**2 * (1 + 0.5 * np.outer(*lines)),
        rtol=0,
        atol=1e-11 + 16 * max(np.array(half_periods) / 2 / shape) ** 6,
    )
    ratio = contrast(moved(samples, ImageMotion(path_um)), still)
    assert ratio == pytest.approx((np.sinc(down + across) + np.sinc(down - across)) / 2, abs=1e-6)


@pytest.mark.parametrize(
    "motion",
    [
        ImageMotion((0.0, 7.7)),
        ImageMotion((5.2, 0.0)),
        ImageMotion((4.1, -6.3)),
        ImageMotion((30.0, 30.0), (0.0, 0.1)),
    ],
)
def test_light_is_conserved(motion: ImageMotion) -> None:
    """Pixels that fill the picture have all light of a spot that stays inside, in any unit and place."""
    rows, columns = np.indices((240, 200))
    samples = 1 + 5 * np.exp(-((rows - 118) ** 2 + (columns - 101) ** 2) / 50)
    assert moved(samples, motion, 2.0).sum() == pytest.approx(samples.sum(), rel=1e-9)
    farther = moved(samples, replace(motion, shift_um=(0.0, 4.0)))
    np.testing.assert_allclose(farther[:, 2:], moved(samples, motion)[:, :-2], rtol=1e-9)
    samples *= 1 + 0.3 * np.cos(1.3 * rows) * np.cos(1.1 * columns)  # detail up to the borders
    tripled = ImageMotion(*(tuple(3 * um for um in pair) for pair in astuple(motion)))
    np.testing.assert_allclose(
        moved(samples, tripled, 4.8, 3.0), 9 * moved(samples, motion), rtol=1e-9
    )


def test_point_in_the_dark_becomes_its_path() -> None:
    """A cell at 40 to 41 µm, moved by ±3 µm, lights pixels 18 to 21 of 2 µm, and the light of none
    is below zero; the ring that is cut off is 5 %. A pixel farther, and in another unit, it is the
    same.
    """
    samples = np.full((60, 80), 1e-6)
    samples[30, 40] = 1.0
    pixels = moved(samples, ImageMotion((0.0, 6.0)), 2.0)
    assert pixels.min() >= 0
    assert pixels.sum() == pytest.approx(samples.sum(), rel=0.05)
    np.testing.assert_allclose(pixels[15, 18:22], [0.25 / 6, 2 / 6, 2 / 6, 1.5 / 6], atol=0.08)
    np.testing.assert_allclose(
        moved(samples, ImageMotion((0.0, 18.0), shift_um=(6.0, -6.0)), 6.0, 3.0)[1:, :-1],
        9 * pixels[:-1, 1:],
        atol=1e-6,
    )


# --- Which way, and rows that see other times

CAMERA = Camera(die_mm=0.4, object_distance_m=0.5, focal_length_mm=4.0)
PIXEL = Pixel(pitch_um=2.5, technology="4t-bsi", stack={"enabled": False})
DISPLAY = Display(white_cd_per_m2=100, dots=100)


def soft_edge(edge_um: float, axis: int) -> SpectralImage:
    """An error function in the distance from the middle: bright to the right (1), or below (0)."""
    x = (np.arange(401) - 200 - edge_um) / 3.0
    running = 3.0 * (x * (1 + erf(x)) + np.exp(-(x**2)) / math.sqrt(math.pi))  # of 1 + erf
    plane = np.tile(0.2 + np.diff(running), (400, 1))
    data = 1e-3 * (plane if axis == 1 else plane.T)[..., None]
    return SpectralImage([550.0], 10.0, 1.0, data=data, header={"diffraction": False})


def mean_e(light: SpectralImage, exposure: Exposure, motion: Motion) -> np.ndarray:
    return capture(
        light, CAMERA, make_sensor(PIXEL, CAMERA), exposure, motion=motion, rng=seeded(0)
    ).mean_e


def edge_places_um(electrons: np.ndarray, axis: int) -> np.ndarray:
    """Place of the edge in each line, from the middle, by how much of a line is bright."""
    lines = electrons if axis == 1 else electrons.T
    dark = lines[:, 3:8].mean(axis=1, keepdims=True)
    bright = lines[:, -8:-3].mean(axis=1, keepdims=True)
    share = ((lines[:, 3:-3] - dark) / (bright - dark)).mean(axis=1)
    return (0.5 - share) * (lines.shape[1] - 6) * 2.5


@pytest.mark.parametrize(
    ("motion", "um_per_row"),
    [
        (Motion(image_um_per_s=(8000.0, 0.0)), 0.04),
        (Motion(pixels_per_s=(3200.0, 0.0)), 0.04),
        (Motion(velocity_mm_per_s=(8.0 / CAMERA.magnification, 0.0)), 0.04),
        (NO_MOTION, 0.0),
    ],
)
def test_rolling_shutter_skews_a_vertical_edge(motion: Motion, um_per_row: float) -> None:
    """What moves to the right at 8 µm/ms is 0.04 µm farther in each next row of 5 µs, and in its
    place in the middle one; in single precision.
    """
    exposure = Exposure(integration_s=1e-4, shutter="rolling", line_time_us=5.0)
    places_um = edge_places_um(mean_e(soft_edge(0.0, 1), exposure, motion), 1)
    rows = np.arange(places_um.size) - (places_um.size - 1) / 2
    np.testing.assert_allclose(places_um, um_per_row * rows, atol=3e-6)


def test_rolling_shutter_stretches_what_moves_along_with_it() -> None:
    """An edge at y that moves down by w is where y + w (row - middle) is: at y/(1 - w/pitch), with
    0.25 µm in each row of 5 µs and 2.5 µm.
    """
    exposure = Exposure(integration_s=1e-5, shutter="rolling", line_time_us=5.0)
    electrons = mean_e(soft_edge(30.0, 0), exposure, Motion(image_um_per_s=(0.0, 5e4)))
    np.testing.assert_allclose(edge_places_um(electrons, 0), 30.0 / (1 - 0.25 / 2.5), atol=2e-3)


# --- The chain


def test_exposure_is_metered_on_the_still_picture() -> None:
    """A bright line, blurred to a tenth of its light, is exposed as if it stood still, so that
    noise and blur trade.
    """
    light = soft_edge(0.0, 1)
    light.data[:, 198:202] = 0.05
    still, blurred = (
        evaluate(light, CAMERA, PIXEL, display=DISPLAY, motion=motion).frame
        for motion in (None, Motion(pixels_per_s=(500.0, 0.0)))
    )
    assert still.integration_s == blurred.integration_s
    assert blurred.mean_e.max() < 0.9 * still.mean_e.max()


@pytest.mark.parametrize("motion", [NO_MOTION, Motion(velocity_mm_per_s=(0.0, 0.0))])
def test_no_motion_is_equal_to_the_bit(motion: Motion) -> None:
    plain, still = (
        evaluate(soft_edge(0.0, 1), CAMERA, PIXEL, display=DISPLAY, **options)
        for options in ({}, {"motion": motion})
    )
    np.testing.assert_array_equal(still.frame.dn, plain.frame.dn)
    np.testing.assert_array_equal(still.delta_e, plain.delta_e)


@pytest.mark.parametrize(
    ("velocity", "text"),
    [
        ({"velocity_mm_per_s": (2e3, 0.0)}, "2000, 0 mm/s"),
        ({"image_um_per_s": (4.0, -1.0)}, "4, -1 µm/s"),
        ({"pixels_per_s": (0.0, 3.0)}, "0, 3 pixels/s"),
        ({"pixels_per_s": (0.0, 0.0)}, ""),
    ],
)
def test_what_moves_is_told_in_its_unit(velocity: dict, text: str) -> None:
    assert motion_text(Motion(**velocity)).partition(" by ")[2] == text


@pytest.mark.parametrize(("margin", "count"), [({}, 1), ({"margin_um": 60.0}, 0)])
def test_cases_that_score_other_parts_are_noted(margin: dict[str, float], count: int) -> None:
    axis = {"name": "time", "set": "exposure.max_integration_s", "values": [0.001, 0.01]}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        prepare(tiny(axis=[axis], motion={"image_um_per_s": (1e4, 0.0)} | margin))
    assert sum("motion.margin_um = 50" in str(warning.message) for warning in caught) == count


@pytest.mark.parametrize(
    ("motion", "exposure", "display", "words"),
    [
        (
            {"image_um_per_s": (4e4, 0.0), "margin_um": 10.0},
            {"integration_s": 1e-3},
            {},
            "path of 40 µm on the sensor in 1 ms",
        ),
        (
            {"image_um_per_s": (4e4, 0.0), "margin_um": 10.0},
            {"max_integration_s": 1e-3},
            {},
            "path of 40 µm on the sensor in 1 ms",
        ),
        ({"image_um_per_s": (0.0, 4e5)}, {"integration_s": 1e-3}, {}, "path of up to 400 µm"),
        (
            {"image_um_per_s": (4e3, 0.0)},
            {"integration_s": 1e-3},
            {"raster": "one_to_one"},
            "all pixels are scored",
        ),
    ],
)
def test_paths_without_room_are_refused(
    motion: dict, exposure: dict, display: dict, words: str
) -> None:
    settings = {
        "exposure": Exposure(**exposure),
        "display": Display(white_cd_per_m2=100, **display),
        "motion": Motion(**motion),
    }
    with pytest.raises(PixsimError, match=words):
        evaluate(soft_edge(0.0, 1), CAMERA, PIXEL, **settings)
    if not display:
        with pytest.raises(PixsimError, match=words):
            sweep(soft_edge(0.0, 1), [PIXEL], camera=CAMERA, **settings)


ROWS, HZ, DEPTH = 400, 100.0, 0.6
LAMP = {"flicker_hz": HZ, "flicker_depth": DEPTH}
STRIP = Camera(die_mm=0.01, die_height_mm=1.0, object_distance_m=0.5, focal_length_mm=4.0)
SENSOR = make_sensor(PIXEL, STRIP)
RATE = np.full(SENSOR.shape, 1e5)


def row_light(seed: int = 0, **exposure) -> np.ndarray:
    """Light of each row over that of steady light."""
    flickering = Exposure.model_validate(LAMP | exposure)
    frame = capture_from_rates(RATE, SENSOR, flickering, np.random.default_rng(seed))
    light = frame.mean_e / (RATE * frame.integration_s)
    np.testing.assert_allclose(light, np.broadcast_to(light[:, :1], light.shape), rtol=1e-12)
    return np.asarray(light[:, 0])


def test_bands_have_the_period_and_the_contrast_of_the_lamp() -> None:
    """In rows of 50 µs a lamp of 100 Hz has a period of 200 rows, 2 of them on 400; over 4 ms it
    keeps sinc(0.4) of its modulation.
    """
    bands = row_light(integration_s=0.004, shutter="rolling", line_time_us=50.0)
    expected = np.zeros(ROWS // 2 + 1)
    expected[[0, 2]] = 1.0, DEPTH * np.sinc(0.4) / 2
    np.testing.assert_allclose(np.abs(np.fft.rfft(bands)) / ROWS, expected, atol=1e-9)


@pytest.mark.parametrize("frames", [1, 3])
@pytest.mark.parametrize("row", [0, 123, 399])
def test_each_row_has_the_light_of_its_own_time(frames: int, row: int) -> None:
    """The integral of the lamp over the exposure of a row; exposures of a burst follow one another,
    and add up to it.
    """
    timing = {"integration_s": 0.007, "shutter": "rolling", "line_time_us": 31.0}
    bands = row_light(flicker_phase_deg=40.0, frames=frames, **timing)
    middle_s = (row - (ROWS - 1) / 2) * 31e-6
    lamp, _ = quad(
        lambda t: 1 + DEPTH * math.cos(2 * math.pi * HZ * t + math.radians(40.0)),
        middle_s - 0.0035,
        middle_s + 0.0035,
    )
    assert bands[row] == pytest.approx(lamp / 0.007, rel=1e-9)


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_whole_periods_are_steady_to_the_bit(shutter) -> None:
    lamp = {"flicker_hz": HZ, "flicker_depth": 1.0}
    exposure = Exposure(integration_s=0.03, shutter=shutter, line_time_us=20.0, **lamp)
    codes = [
        capture_from_rates(RATE, SENSOR, setting, np.random.default_rng(3)).dn
        for setting in (exposure, exposure.steady)
    ]
    np.testing.assert_array_equal(*codes)


def test_frames_of_a_global_shutter_differ_as_wholes() -> None:
    """By m sinc(f T) cos φ of a phase of their own: a mean of 0 and a mean square of ½; 5 standard
    errors of 200 frames are 6e-7 false alarms.
    """
    light = np.array([row_light(seed, integration_s=0.002) for seed in range(200)])
    np.testing.assert_allclose(light, np.broadcast_to(light[:, :1], light.shape), rtol=1e-12)
    cosine = (light[:, 0] - 1) / (DEPTH * np.sinc(0.2))
    assert np.abs(cosine).max() <= 1 + 1e-9
    check_mean("cosine", cosine, 0.0)
    check_mean("its square", cosine**2, 0.5)


def test_exposures_of_a_burst_saturate_by_themselves() -> None:
    """Two exposures of half a period, at its crest and its trough: the sum is that of steady light,
    and only the crest is full.
    """
    rate = np.full(SENSOR.shape, 0.8 * SENSOR.readout.saturation_e / 0.005)
    lamp = {"flicker_hz": HZ, "flicker_depth": 0.9, "flicker_phase_deg": 90.0}
    steady, flickering = (
        capture_from_rates(rate, SENSOR, exposure, np.random.default_rng(1))
        for exposure in (
            Exposure(integration_s=0.01, frames=2),
            Exposure(integration_s=0.01, frames=2, **lamp),
        )
    )
    np.testing.assert_allclose(flickering.mean_e, steady.mean_e, rtol=1e-12)
    assert (steady.saturated_fraction, flickering.saturated_fraction) == (0.0, 1.0)


def test_light_that_moves_flickers_too() -> None:
    """Along the lines nothing changes, so that both exposures see the same, each in its own
    light.
    """
    steady, flickering = (
        mean_e(soft_edge(0.0, 0), exposure, Motion(image_um_per_s=(1000.0, 0.0)))
        for exposure in (
            Exposure(integration_s=0.004, frames=2),
            Exposure(integration_s=0.004, frames=2, flicker_phase_deg=0.0, **LAMP),
        )
    )
    np.testing.assert_allclose(flickering, steady * (1 + DEPTH * np.sinc(0.4)), rtol=1e-6)
