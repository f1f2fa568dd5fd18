"""Motion in an exposure, and a rolling shutter: blur, place and light of pictures whose moved form
is known.
"""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.tiny import tiny
from scipy.optimize import brentq
from scipy.special import erf

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import diffraction_otf, square_aperture_mtf
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import MovingPicture, integrate_pixels
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion, LightSpectrum, motion_in_frame
from pixsim.sensor.motion_options import NO_MOTION, Motion
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import capture, make_sensor
from pixsim.studies.design import border_on_um
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Study
from pixsim.studies.sweep import sweep
from pixsim.viewer.display_options import Display
from pixsim.viewer.evaluate import evaluate
from pixsim.viewer.setting import Run, stage_words


def moved(
    picture: np.ndarray,
    moving: ImageMotion,
    pitch_um: float = 2.0,
    sample_um: float = 1.0,
    side_um: float = 1.6,
) -> np.ndarray:
    """Integrals of a moving picture over pixels."""
    return integrate_pixels(
        picture,
        sample_um,
        pitch_um,
        side_um,
        moving_picture=MovingPicture(LightSpectrum(picture), moving),
    )


def wave(shape: tuple[int, int], cycles: tuple[float, float]) -> np.ndarray:
    """Cell means of 1 + cos cos, of whole half periods, which goes on beyond its borders by
    reflection.
    """
    lines = []
    for count, number in zip(shape, cycles, strict=True):
        angle = math.pi * number / count
        lines.append(np.cos(angle * (np.arange(count) + 0.5)) * np.sinc(number / count / 2))
    return 1 + 0.5 * np.multiply.outer(*lines)


def contrast(pixels: np.ndarray, still: np.ndarray) -> float:
    """Contrast of pixels over that of others of the same phase."""
    away = still - still.mean()
    return float((away * (pixels - pixels.mean())).sum() / (away**2).sum())


# Paths from a thousandth of a pixel of 2 µm to a thousand, and frequencies up to 0.3 cycles a
# pixel.
@pytest.mark.parametrize("half_periods", [3, 40, 300])
@pytest.mark.parametrize("path_um", [2e-3, 0.7, 2.0, 13.3, 210.0, 2000.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_contrast_of_a_wave_is_sinc(path_um: float, half_periods: int, axis: int) -> None:
    shape = (1000, 40) if axis == 0 else (40, 1000)
    picture = wave(shape, (half_periods, 0) if axis == 0 else (0, half_periods))
    still = integrate_pixels(picture, 1.0, 2.0, 1.6, moving_picture=None)
    found = contrast(
        moved(picture, ImageMotion((path_um, 0.0) if axis == 0 else (0.0, path_um))),
        moved(picture, NO_IMAGE_MOTION),
    )
    assert found == pytest.approx(np.sinc(half_periods / 2000 * path_um), abs=1e-6)
    # The spline of light that may move is that of light that stands still, but for its ends at the
    # borders.
    np.testing.assert_allclose(
        moved(picture, NO_IMAGE_MOTION)[5:-5, 5:-5], still[5:-5, 5:-5], rtol=1e-4
    )


# From a thousandth of a pixel to a thousand; waves whose fronts lie along the path; a path that is
# slanted by rounding only.
@pytest.mark.parametrize(
    "path",
    [(2e-3, 1e-3), (17.0, -9.0), (12.0, 12.0), (12.0, 12.0 + 1e-9), (2000.0, -900.0), (5.0, 1e-13)],
)
@pytest.mark.parametrize("cycles", [(30.0, 24.0), (160.0, 120.0)])
def test_contrast_along_a_slanted_path_is_sinc_of_both_axes(
    path: tuple[float, float], cycles: tuple[float, float]
) -> None:
    """cos a cos b along (u, v) is (cos(a + b) + cos(a - b))/2, each of which keeps the sinc of its
    own frequency along the path.
    """
    shape = (400, 300)
    picture = wave(shape, cycles)
    down, across = (
        cycle / 2 / count * length for cycle, count, length in zip(cycles, shape, path, strict=True)
    )
    found = contrast(moved(picture, ImageMotion(path)), moved(picture, NO_IMAGE_MOTION))
    assert found == pytest.approx((np.sinc(down + across) + np.sinc(down - across)) / 2, abs=1e-6)


def test_fronts_along_a_slanted_path_keep_their_contrast() -> None:
    """And those across it lose the most."""
    rows, columns = np.indices((300, 300))
    for sign, kept in ((-1, np.sinc(0.0)), (1, np.sinc(2 * 12.0 / 40))):
        slanted = 1 + 0.5 * np.cos(2 * math.pi * (rows + sign * columns) / 40)
        inside = np.s_[20:-20, 20:-20]  # the front is broken at the borders, where it is reflected
        ratio = contrast(
            moved(slanted, ImageMotion((12.0, 12.0)))[inside],
            moved(slanted, NO_IMAGE_MOTION)[inside],
        )
        assert ratio == pytest.approx(kept, abs=2e-4)


@pytest.mark.parametrize(
    "moving",
    [
        ImageMotion((0.0, 7.7)),
        ImageMotion((5.2, 0.0)),
        ImageMotion((4.1, -6.3)),
        ImageMotion((30.0, 30.0), (0.0, 0.1)),
    ],
)
def test_light_is_conserved(moving: ImageMotion) -> None:
    """Pixels that fill the picture have all light of a spot that stays inside."""
    rows, columns = np.indices((240, 200))
    picture = 1 + 5 * np.exp(-((rows - 118) ** 2 + (columns - 101) ** 2) / 50)
    whole = integrate_pixels(
        picture, 1.0, 2.0, 2.0, moving_picture=MovingPicture(LightSpectrum(picture), moving)
    )
    assert whole.sum() == pytest.approx(picture.sum(), rel=1e-9)


def test_point_in_the_dark_becomes_its_path() -> None:
    """A cell at 40 to 41 µm, moved by ± 3 µm, lights pixels 18 to 21 of 2 µm, and the light of none
    is below zero.
    """
    picture = np.full((60, 80), 1e-6)
    picture[30, 40] = 1.0
    whole = integrate_pixels(
        picture,
        1.0,
        2.0,
        2.0,
        moving_picture=MovingPicture(LightSpectrum(picture), ImageMotion((0.0, 6.0))),
    )
    assert whole.min() >= 0
    assert whole.sum() == pytest.approx(picture.sum(), rel=0.05)  # the ring that is cut off
    assert whole[15, 18:22] == pytest.approx(
        [0.5 / 6 * 0.25 + 0.5 / 6 * 0.25, 2 / 6, 2 / 6, 1.5 / 6], abs=0.08
    )
    assert whole[15, 18:22].sum() == pytest.approx(1.0, abs=0.05)


# --- which way, and rows that see other times
# -------------------------------------------------------------------------------------

DIE = {"die_mm": 0.4, "object_distance_m": 0.5, "focal_length_mm": 4.0}
CAMERA, PIXEL = Camera(**DIE), Pixel(pitch_um=2.5, technology="4t-bsi", stack={"enabled": False})
EDGE_UM, CELL_UM = 3.0, 1.0


def picture_of(edge_at_um: float, axis: int) -> SpectralImage:
    """A soft edge, an error function in the distance from the middle: bright to the right, or
    below.
    """
    count = 400
    borders = np.arange(count + 1) * CELL_UM - count * CELL_UM / 2 - edge_at_um
    x = borders / EDGE_UM
    running = EDGE_UM * (x * (1 + erf(x)) + np.exp(-(x**2)) / math.sqrt(math.pi))  # of 1 + erf
    line = 0.2 + np.diff(running) / CELL_UM
    plane = np.tile(line, (count, 1)) if axis == 1 else np.tile(line[:, None], (1, count))
    return SpectralImage(
        [550.0], 10.0, CELL_UM, data=1e-3 * plane[..., None], header={"diffraction": False}
    )


def edge_places(mean_e: np.ndarray, axis: int) -> np.ndarray:
    """Place of the edge in each line, in µm from the middle, from how much of a line is bright."""
    lines = mean_e if axis == 1 else mean_e.T
    dark, bright = lines[:, 3:8].mean(axis=1), lines[:, -8:-3].mean(axis=1)
    share = ((lines[:, 3:-3] - dark[:, None]) / (bright - dark)[:, None]).mean(axis=1)
    count = lines.shape[1] - 6
    return (0.5 - share) * count * 2.5


def mean_e(light: SpectralImage, exposure: Exposure, motion: Motion) -> np.ndarray:
    sensor = make_sensor(PIXEL, CAMERA)
    return capture(
        light, CAMERA, sensor, exposure, motion=motion, rng=np.random.default_rng(0)
    ).mean_e


@pytest.mark.parametrize(
    "motion",
    [
        Motion(image_um_per_s=(8000.0, 0.0)),
        Motion(pixels_per_s=(3200.0, 0.0)),
        Motion(velocity_mm_per_s=(8.0 / CAMERA.magnification, 0.0)),
        Motion(velocity_mm_per_s=(8.0 / CAMERA.image_distance_mm * 3e3, 0.0), distance_m=3.0),
    ],
)
def test_rolling_shutter_skews_a_vertical_edge(motion: Motion) -> None:
    """What moves to the right at 8 µm/ms is 8 · 5e-3 µm farther in each next row of 5 µs, and in
    its place in the middle one.
    """
    exposure = Exposure(integration_s=1e-4, shutter="rolling", line_time_us=5.0)
    found = mean_e(picture_of(0.0, 1), exposure, motion)
    lines = np.arange(found.shape[0]) - (found.shape[0] - 1) / 2
    np.testing.assert_allclose(
        edge_places(found, 1), 8e-3 * 5 * lines, atol=3e-6
    )  # single precision of the light
    still = mean_e(picture_of(0.0, 1), exposure, NO_MOTION)
    np.testing.assert_allclose(edge_places(still, 1), 0.0, atol=3e-6)


def test_rolling_shutter_stretches_what_moves_along_with_it() -> None:
    """An edge at y that moves down by w is where y + w (row - middle) is: at y/(1 - w/pitch)."""
    motion = Motion(image_um_per_s=(0.0, 5e4))  # 0.25 µm in each row of 5 µs and 2.5 µm
    exposure = Exposure(integration_s=1e-5, shutter="rolling", line_time_us=5.0)
    found = edge_places(mean_e(picture_of(30.0, 0), exposure, motion), 0)
    np.testing.assert_allclose(found, 30.0 / (1 - 0.25 / 2.5), atol=2e-3)


def test_exposures_of_a_burst_follow_one_another() -> None:
    """The second of two exposures has the edge half a path farther on; both together are one
    exposure of the whole path.
    """
    motion, light = Motion(image_um_per_s=(4e4, 0.0)), picture_of(0.0, 1)
    burst = Exposure(integration_s=1e-3, frames=2)
    whole = mean_e(light, Exposure(integration_s=1e-3), motion)
    np.testing.assert_allclose(mean_e(light, burst, motion), whole, rtol=1e-9)
    score = evaluate(light, CAMERA, PIXEL, burst, Display(white_cd_per_m2=100), motion=motion)
    assert score.frame.exposures == 2
    first, second = motion_in_frame((4e4, 0.0), 1e-3, burst).subexposures(2)
    assert (first.path_um, first.shift_um, second.shift_um) == (
        (0.0, 20.0),
        (0.0, -10.0),
        (0.0, 10.0),
    )


# --- the chain
# --------------------------------------------------------------------------------------------------------------------


def test_exposure_is_metered_on_the_still_picture() -> None:
    """A bright line, blurred to a tenth of its light, is exposed as if it stood still, so that
    noise and blur trade.
    """
    light = picture_of(0.0, 1)
    bright = light.data.copy()
    bright[:, 198:202] = 0.05
    line = SpectralImage([550.0], 10.0, CELL_UM, data=bright, header={"diffraction": False})
    display = Display(white_cd_per_m2=1000, dots=100)
    frames = [
        evaluate(line, CAMERA, PIXEL, display=display, motion=motion).frame
        for motion in (None, Motion(pixels_per_s=(500.0, 0.0)))
    ]
    assert frames[0].integration_s == frames[1].integration_s
    assert frames[1].mean_e.max() < 0.9 * frames[0].mean_e.max()


def test_still_is_equal_to_the_bit() -> None:
    light, display = picture_of(0.0, 1), Display(white_cd_per_m2=100, dots=100)
    plain = evaluate(light, CAMERA, PIXEL, display=display)
    for motion in (
        NO_MOTION,
        Motion(pixels_per_s=(0.0, 0.0)),
        Motion(velocity_mm_per_s=(0.0, 0.0)),
    ):
        same = evaluate(light, CAMERA, PIXEL, display=display, motion=motion)
        np.testing.assert_array_equal(same.frame.dn, plain.frame.dn)
        np.testing.assert_array_equal(same.delta_e, plain.delta_e)


def test_mtf50_is_that_of_the_path() -> None:
    """Of a path of 40 pixels, 0.1 mm, it is where its sinc, with what lens and pixel take, is one
    half.
    """
    motion, options = (
        Motion(pixels_per_s=(4e4, 0.0)),
        {"metrics": ("mtf50", "acutance"), "display": Display(white_cd_per_m2=100)},
    )
    score = evaluate(
        picture_of(0.0, 1), CAMERA, PIXEL, Exposure(integration_s=1e-3), motion=motion, **options
    )

    def excess(frequency: float) -> float:
        still = diffraction_otf(frequency, 550.0, CAMERA.effective_f_number)
        return (
            float(
                still
                * square_aperture_mtf(frequency, derive(PIXEL).photodiode_side_um)
                * np.sinc(0.1 * frequency)
            )
            - 0.5
        )

    assert score.metrics["mtf50"] == pytest.approx(brentq(excess, 1.0, 9.0), rel=1e-3)
    still = evaluate(picture_of(0.0, 1), CAMERA, PIXEL, Exposure(integration_s=1e-3), **options)
    assert score.metrics["acutance"] < 0.9 * still.metrics["acutance"]


def test_scored_frame_leaves_half_of_the_longest_path() -> None:
    display, fast = Display(white_cd_per_m2=100, dots=400), Exposure(integration_s=1e-3)
    found = [
        evaluate(picture_of(0.0, 1), CAMERA, PIXEL, exposure, display, motion=motion).border_um[1]
        for motion, exposure in [
            (NO_MOTION, fast),
            (Motion(image_um_per_s=(4e4, 0.0)), fast),
            (Motion(image_um_per_s=(4e3, 0.0), margin_um=50.0), fast),
            (
                Motion(image_um_per_s=(0.0, -4e3)),
                Exposure(integration_s=1e-3, shutter="rolling", line_time_us=10.0),
            ),
        ]
    ]
    assert np.diff(found, prepend=found[0]).tolist() == pytest.approx(
        [0, 20, 30, 4 / 2 * (1 + 160 * 0.01) - 50], abs=1.0
    )
    study = Study(
        name="a",
        exposure=fast,
        motion=Motion(image_um_per_s=(4e4, 0.0)),
        camera=DIE,
        pitch={"max_um": 20.0},
    )
    assert border_on_um(study, CAMERA) == study.border_um + 20.0


def test_pixels_at_other_places_need_no_more_room_than_the_picture() -> None:
    """Detectability reads them, but nobody is shown them. Each dot is half a pixel wide, so that no
    room is left by rounding.
    """
    display, motion = Display(white_cd_per_m2=1000, dots=320), Motion(image_um_per_s=(4e4, 0.0))
    options = {"motion": motion, "metrics": ("detectability",), "without": picture_of(0.0, 1)}
    pixel = PIXEL.model_copy(update={"bits": 12})
    score = evaluate(
        picture_of(2.5, 1), CAMERA, pixel, Exposure(integration_s=1e-3), display, **options
    )
    assert score.border_um[1] == pytest.approx(1.5 * PIXEL.pitch_um + 20.0, abs=1e-9)
    assert score.metrics["detectability"] > 0


def test_units_of_one_velocity_leave_the_same_room() -> None:
    """Of pixels that are binned, too: pixels_per_s is about the pixels of the sensor, whose pitch
    is stated.
    """
    colour = {
        "pattern": "quad_rggb",
        "sensitivities": "Sony_ILCE-7M4",
        "peak_quantum_efficiency": 0.6,
        "binning": True,
    }
    pixel, camera, exposure = (
        Pixel(technology="4t-bsi", pitch_um=4.0, colour=colour),
        Camera(),
        Exposure(integration_s=1e-3),
    )
    each = Motion(pixels_per_s=(1e4, 0.0)), Motion(image_um_per_s=(4e4, 0.0))
    first, other = (
        imaging(camera, pixel, exposure, motion=motion).scored_border_um for motion in each
    )
    assert first == other == pytest.approx(derive(pixel).border_um + 20.0)
    # The lines of a rolling shutter are those that are read: half as many.
    rolling = exposure.model_copy(update={"shutter": "rolling", "line_time_us": 1.0})
    lines = 1e3 * camera.height_mm / 8.0
    found = imaging(
        camera, pixel, rolling, motion=Motion(image_um_per_s=(4e4, 0.0))
    ).scored_border_um
    assert found == pytest.approx(derive(pixel).border_um + 20.0 + 0.04 * lines / 2)
    study = Study(
        name="a", exposure=rolling, motion=Motion(image_um_per_s=(4e4, 0.0)), technologies=["4t-bsi"],
        pixel=pixel.model_dump(exclude_unset=True, exclude={"technology", "pitch_um"}),
        pitch={"values_um": [4.0, 5.0, 6.0, 7.0, 8.0]},
    )  # fmt: skip
    assert border_on_um(study, camera) == pytest.approx(study.border_um + 20.0 + 0.04 * lines / 2)


@pytest.mark.parametrize("margin_um", [None, 60.0])
def test_cases_that_score_other_parts_are_told(margin_um: float | None) -> None:
    axis = {"name": "time", "set": "exposure.max_integration_s", "values": [0.001, 0.01]}
    motion = {"image_um_per_s": (1e4, 0.0)} | (
        {} if margin_um is None else {"margin_um": margin_um}
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        job = prepare(tiny(axis=[axis], motion=motion))
    told = [
        str(each.message)
        for each in caught
        if "with motion.margin_um = 50 all cases score the same part" in str(each.message)
    ]
    assert len(told) == (0 if margin_um else 1)
    borders = [
        border_on_um(case.settings, case.camera) - case.settings.border_um for case in job.cases
    ]
    assert borders == pytest.approx([60.0, 60.0] if margin_um else [5.0, 50.0], rel=1e-9)


ERRORS: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any], str]] = {
    "longer than the margin": (
        {"image_um_per_s": (4e4, 0.0), "margin_um": 10.0}, {"integration_s": 1e-3}, {},
        "motion: got a path of 40 µm on the sensor in 1 ms; allowed: at most 2",
    ),
    "longer than the margin in the time of the automatic exposure": (
        {"image_um_per_s": (4e4, 0.0), "margin_um": 10.0}, {"max_integration_s": 1e-3}, {},
        "motion: got a path of 40 µm on the sensor in 1 ms; allowed: at most 2",
    ),
    "longer than the die": (
        {"image_um_per_s": (0.0, 4e5)}, {"integration_s": 1e-3}, {},
        "motion: got a path of up to 400 µm on the sensor; allowed: one that leaves something to score",
    ),
    "all pixels scored": (
        {"image_um_per_s": (4e3, 0.0)}, {"integration_s": 1e-3}, {"raster": "one_to_one"},
        "With display.raster = 'one_to_one' all pixels are scored",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_paths_without_room_are_refused(name: str) -> None:
    motion, exposure, display, words = ERRORS[name]
    shown = Display(white_cd_per_m2=100, **display)
    with pytest.raises(PixsimError, match=re.escape(words)):
        evaluate(
            picture_of(0.0, 1), CAMERA, PIXEL, Exposure(**exposure), shown, motion=Motion(**motion)
        )
    if name != "all pixels scored":
        with pytest.raises(PixsimError, match=re.escape(words)):
            sweep(
                picture_of(0.0, 1),
                [PIXEL],
                camera=CAMERA,
                exposure=Exposure(**exposure),
                display=shown,
                motion=Motion(**motion),
            )


def test_contradictions_are_refused() -> None:
    with pytest.raises(
        PixsimError, match="velocity_mm_per_s and pixels_per_s state the same quantity"
    ):
        Motion(velocity_mm_per_s=(1.0, 0.0), pixels_per_s=(0.0, 0.0))
    with pytest.raises(
        PixsimError,
        match="shutter = 'rolling' without line_time_us; allowed: with the time from row to row",
    ):
        Exposure(shutter="rolling")


def test_stages_say_what_they_do() -> None:
    assert stage_words(Run()) == []
    run = Run(
        motion=Motion(velocity_mm_per_s=(2000.0, 0.0)),
        exposure=Exposure(frames=8, shutter="rolling", line_time_us=10.0),
    )
    words = (
        "objects move by 2000, 0 mm/s",
        "rolling shutter, 10 µs a row",
        "each frame the sum of 8 exposures",
    )
    assert stage_words(run) == list(words)
    assert motion_in_frame((3.0, -2.0), 0.5, run.exposure).path_um == (-1.0, 1.5)
    assert motion_in_frame((3.0, -2.0), 0.5, run.exposure).row_um == pytest.approx(
        (-2e-5, 3e-5), rel=1e-12
    )
    assert motion_in_frame((3.0, -2.0), 0.5, Exposure()).row_um == (0.0, 0.0)
    assert Readout.of(derive(Pixel()), Exposure()).exposures == 1
    assert pixsim.Exposure is Exposure
