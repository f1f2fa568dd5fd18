"""Metrics of a frame against closed forms, and what is asked of a configuration."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.colour_options import ColourOptions
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import read_out, sample_sensor
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.development import Development
from pixsim.viewer.display_options import Display
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.metric_kernels.interpretability import niirs, relative_edge_response
from pixsim.viewer.metric_kernels.non_prewhitening import npwe
from pixsim.viewer.metric_kernels.sharpness import edge_mtf
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metric_registry import METRICS, metrics_named
from pixsim.viewer.metrics import MetricRequest, NoNumberError, user_metric
from pixsim.viewer.raw_metrics import (
    MAX_D_PRIME,
    _d_prime,
    _mtf_along,
    bottom_table,
    code_moments,
    code_tables,
    contrast_factor,
    neq_along,
    sensor_mtf,
    top_table,
    variance_of_pixels_e2,
)
from pixsim.viewer.shown_metrics import _expected_light

CELL_UM, WHITE = 2.0, 100.0
CAMERA = Camera(die_mm=0.4, f_number=2.8)
PIXEL = Pixel(
    technology="none",
    pitch_um=4.0,
    full_well_e=20_000,
    read_noise_e=4.0,
    dark_current_e_per_s=0.0,
    quantum_efficiency=0.6,
    bits=12,
    black_level_dn=64,
    fill_factor=1.0,
)
DISPLAY = Display(white_cd_per_m2=WHITE, dots=64)
EXPOSURE = pixsim.Exposure(integration_s=0.02)


def light(picture: np.ndarray, **header: Any) -> SpectralImage:
    """Light of one narrow band, without diffraction."""
    data = np.float32(2e-4 * picture)[..., None]
    return SpectralImage([550.0], 10.0, CELL_UM, data=data, header={"diffraction": False} | header)


EVEN = light(np.ones((200, 200)))


def chain_of(
    image: SpectralImage,
    pixel: Pixel = PIXEL,
    without: SpectralImage | None = None,
    judging: MetricRequest | None = None,
) -> ImagingChain:
    judging = judging or MetricRequest(metrics_named(["information"]))
    return imaging_chain(
        image, CAMERA, pixel, EXPOSURE, DISPLAY, metrics=judging, background=without
    )


def with_disc(contrast: float, radius_px: float = 20.0) -> SpectralImage:
    y, x = np.mgrid[:200, :200] - 99.5
    return light(1.0 + contrast * (np.hypot(y, x) < 2 * radius_px))


@pytest.mark.parametrize("contrast", [0.02, -0.05])
def test_detectability_of_a_target_is_its_signal_over_the_noise(contrast: float) -> None:
    """Σ Δ²/σ² over the pixels, from their expected electrons; without offsets that rows or columns
    share. To rounding.
    """
    image = with_disc(contrast)
    found = pixsim.evaluate(
        image,
        CAMERA,
        PIXEL,
        EXPOSURE,
        DISPLAY,
        metrics=["detectability"],
        metric=MetricOptions(detectability={"registrations": 1}),
        without=EVEN,
    )
    levels = [0.02 * chain_of(each).signal_e_per_s for each in (image, EVEN)]
    gain = found.frame.dn_per_e
    variance = (levels[0] + levels[1]) / 2 + 16.0 + 1 / (12 * gain**2)
    wanted = math.sqrt(float(((levels[0] - levels[1]) ** 2 / variance).sum()))
    assert found.metrics["detectability"] == pytest.approx(wanted, rel=1e-9)
    assert found.metrics == {"detectability": found.further["detectability"]}


def test_column_noise_of_a_pixel_hides_bars_along_its_columns_alone() -> None:
    """Offsets of columns of 20 times the noise of a pixel: of 100 rows each, vertical bars lose √(1
    + 100 · 400), horizontal none.

    Bars of a whole number of pixels fill the frame, and cancel along the other axis.
    """
    bars = np.tile(np.repeat([1.0, 0.8], 4), 25)  # 2 pixels each
    own = {
        "metrics": ["detectability"],
        "metric": MetricOptions(detectability={"registrations": 1}),
    }
    found = {}
    for fpn in (0.0, 20 * 16.0 / 20_000):
        pixel = PIXEL.model_copy(update={"column_fpn": fpn, "read_noise_e": 16.0})
        dim = pixsim.Exposure(integration_s=1e-4)  # 10 e- of light: the noise is that of reading
        for name, picture in (
            ("vertical", np.tile(bars, (200, 1))),
            ("horizontal", np.tile(bars[:, None], 200)),
        ):
            without = light(np.full((200, 200), 0.9))
            found[name, bool(fpn)] = pixsim.evaluate(
                light(picture), CAMERA, pixel, dim, DISPLAY, without=without, **own
            ).metrics["detectability"]
    assert found["horizontal", True] == pytest.approx(found["horizontal", False], rel=1e-6)
    lost = found["vertical", False] / found["vertical", True]
    assert lost == pytest.approx(math.sqrt(1 + 100 * 400), rel=0.05), (
        "shot noise and rounding are 4 % of the variance"
    )
    assert found["vertical", False] == pytest.approx(found["horizontal", False], rel=1e-6)


def test_detectability_is_the_mean_over_registrations_and_the_worst() -> None:
    """A target of one pixel is shared by four where they meet on it: registrations differ, and 16
    are asked for by default.
    """
    image = with_disc(0.5, 1.0)
    judging = MetricRequest(metrics_named(["detectability"]))
    chain = chain_of(image, without=EVEN, judging=judging)
    judged = FrameUnderTest.of(chain, chain.capture("a"))
    frames = list(judged.registrations(16))
    each = [_d_prime(frame) for frame in frames]
    assert len({frame.readout.physics.registration for frame in frames}) == 16
    mean, worst, factor = METRICS["detectability"].compute(judged)
    assert (mean, worst) == (
        pytest.approx(np.mean(each), rel=1e-12),
        pytest.approx(min(each), rel=1e-12),
    )
    assert worst < 0.98 * mean
    assert factor == pytest.approx(5 / mean, rel=1e-12)


def test_npwe_is_that_of_the_expected_pictures_and_the_expected_noise() -> None:
    """Pixels of one dot have white noise on the dots, of the variance of their mean signal: d′ of
    the closed form.
    """
    image, nearest = with_disc(0.05, 25.0), DISPLAY.model_copy(update={"interpolation": "nearest"})
    pixel = PIXEL.model_copy(update={"pitch_um": 6.25, "registration": (0.0, 0.0)})  # a dot each
    judging = MetricRequest(metrics_named(["npwe"]), repeats=16)  # of this registration alone
    chain = imaging_chain(image, CAMERA, pixel, EXPOSURE, nearest, metrics=judging, background=EVEN)
    judged = FrameUnderTest.of(chain, chain.capture("a"))
    levels = [0.02 * each for each in (chain.signal_e_per_s, chain.background_e_per_s)]
    white_e = 0.02 * chain.white_e_per_s
    variance = float(levels[0].mean()) + 16.0 + 1 / (12 * chain.readout.dn_per_e**2)
    shown = (levels[0] - levels[1]) / white_e
    rows, columns = (
        slice((full - part) // 2, (full + part) // 2)
        for full, part in zip(shown.shape, chain.screen.ideal.shape, strict=True)
    )
    wanted = npwe(shown[rows, columns], np.array(variance / white_e**2 / 23.0**2), 23.0)
    # Less by rounding: the border that is left out has the same mean signal to 1e-3.
    assert METRICS["npwe"].compute(judged)[0] == pytest.approx(wanted, rel=1e-3)


LINES = {"column_fpn": 1.5e-3, "row_noise_e": 30.0, "prnu": 0.01}  # 30 e- each
FRAMES_OF_A_CAMERA = pixsim.Correction(dark_frames=2, flat_frames=2, column_clamp=4)
DISPLAYED = {
    "white": ({}, {}, {}),
    "lines": (LINES, {}, {}),
    "sharpened lines": (LINES, {}, {"develop": pixsim.Develop(sharpen_amount=1.0)}),
    "cubic": ({"pitch_um": 11.0}, {"interpolation": "cubic"}, {}),
    "corrected": (LINES, {}, {"correction": FRAMES_OF_A_CAMERA}),
    "code 0": ({"black_level_dn": 0, "read_noise_e": 150.0}, {}, {}),
    "sRGB": ({}, {}, {"develop": pixsim.Develop(tone_curve="srgb")}),
}


@pytest.mark.parametrize("case", DISPLAYED)
def test_npwe_has_the_noise_of_many_frames(case: str) -> None:
    """d′ in the mean spectrum of the noise of 400 sensors and their frames, of a picture of 1.4°;
    two seeds agree.

    Noise of whole lines lies in few frequencies, about 5 in the target's band: the means of 400
    exponentials tell d′ to 1/√(5 · 400)/2 = 1.1 %. White noise, in some 40 of them, is told to 0.4
    %. The gate is 3.6 σ, a false alarm in 3000.
    """
    of_pixel, of_display, more = DISPLAYED[case]
    pixel, display = (
        PIXEL.model_copy(update=of_pixel),
        DISPLAY.model_copy(update={"dots": 32} | of_display),
    )
    judging = MetricRequest(
        metrics_named(["npwe"]), MetricOptions(detectability={"registrations": 1})
    )
    exposure = pixsim.Exposure(integration_s=4e-4) if case == "code 0" else EXPOSURE
    chain = imaging_chain(
        with_disc(0.2, 25.0),
        CAMERA,
        pixel,
        exposure,
        display,
        metrics=judging,
        background=EVEN,
        **more,
    )
    first, second = (
        METRICS["npwe"].compute(FrameUnderTest.of(chain, chain.capture("seed", seed)))[0]
        for seed in (0, 1)
    )
    assert second == pytest.approx(first, rel=0.01 if chain.imaging.develop.tone else 1e-12)

    count = 100 if chain.imaging.correction.is_on else 400
    pictures = [
        np.asarray(chain.development.light(chain.capture("many", number)), float)
        for number in range(count)
    ]
    mean = np.mean(pictures, axis=0)
    power = np.mean([np.abs(np.fft.fft2(picture - mean)) ** 2 for picture in pictures], axis=0)
    power *= count / (count - 1) / mean.size / display.samples_per_deg**2
    drawn = chain.capture("seed", 0)
    _, difference = _expected_light(drawn, chain.expected(drawn.integration_s))
    wanted = npwe(difference, power, display.samples_per_deg)
    error = 0.011 if of_pixel.get("row_noise_e") else 0.004
    assert first == pytest.approx(wanted, rel=3.6 * error * math.sqrt(400 / count))


def test_detectability_of_clipped_pixels_is_none_and_of_rounded_noise_an_error() -> None:
    bright = light(np.full((200, 200), 300.0)), light(np.full((200, 200), 330.0))
    evaluate = partial(
        pixsim.evaluate,
        camera=CAMERA,
        exposure=EXPOSURE,
        display=DISPLAY,
        metrics=["detectability"],
    )
    assert evaluate(bright[1], pixel=PIXEL, without=bright[0]).metrics["detectability"] == 0.0
    quiet = PIXEL.model_copy(update={"bits": 6, "black_level_dn": 4.0})
    with pytest.raises(
        PixsimError,
        match=r"detectability: got noise of 0\.\d+ DN in pixels of 4 µm.*0\.5 DN.*pixel\.bits",
    ):
        evaluate(with_disc(0.1), pixel=quiet, without=EVEN)


@pytest.mark.parametrize(
    ("name", "of_full"),
    [("information", None), ("niirs", 0.15), ("visual_noise", 0.18)],
    ids=["information", "niirs", "noise"],
)
def test_frame_whose_signal_clips_tells_nothing(name: str, of_full: float | None) -> None:
    """Below the end of the well a frame tells most, whose signal is largest there. Above it there
    is no information.

    A rating or the noise of what is full has no number: beside another metric it is NaN, with the
    reason.
    """
    chain = chain_of(EVEN)
    top_e = (2**12 - 1 - 64) / chain.readout.dn_per_e
    full_s = top_e / (
        float(chain.signal_e_per_s.mean()) if of_full is None else of_full * chain.white_e_per_s
    )

    def evaluate(times: float, *names: str) -> dict[str, float]:
        exposure = pixsim.Exposure(integration_s=times * full_s)
        return pixsim.evaluate(
            EVEN, CAMERA, PIXEL, exposure=exposure, display=DISPLAY, metrics=names
        ).metrics

    dark, bright = evaluate(0.25, name)[name], evaluate(0.9, name)[name]
    assert dark > bright if name == "visual_noise" else dark < bright
    if name == "information":
        assert evaluate(1.1, name)[name] == 0.0
        return
    with pytest.raises(
        NoNumberError, match=f"the metric {name}: got .* full.*Expose it for less time"
    ):
        evaluate(1.1, name)
    with pytest.warns(UserWarning, match=f"the metric {name}: got"):
        found = evaluate(1.1, "delta_e", name)
    assert math.isnan(found[name])
    assert found["delta_e"] > 0


@pytest.mark.parametrize(
    ("bits", "read_noise_e", "exposures"),
    [(12, 4.0, 1), (9, 25.0, 1), (12, 60.0, 1), (12, 20.0, 4)],
)
def test_codes_near_0_have_the_mean_and_variance_of_frames(
    bits: int, read_noise_e: float, exposures: int
) -> None:
    """Noise of 0.6 to 12 DN around a black level of 0, of pixels with PRNU and offsets; of a burst
    of 4, too.

    Means within 4 standard errors of 360 000 pixels (6e-5 of seeds), or 0.1 % of the noise, and
    variances within 2 %: both for the skewness of a few electrons, which a normal level does not
    have.
    """
    own = {"bits": bits, "read_noise_e": read_noise_e, "black_level_dn": 0.0, "prnu": 0.02}
    own |= {"offset_fpn": 0.2 * read_noise_e / 20_000}
    chain, rng = chain_of(EVEN, PIXEL.model_copy(update=own)), np.random.default_rng(44)
    chain = replace(chain, readout=chain.readout.burst(exposures))
    table = bottom_table(chain.expected(0.02), 0.0)
    assert table is not None
    sensor = sample_sensor(chain.readout, (600, 600), rng)
    for signal_e in exposures * read_noise_e * np.array([0.0, 0.5, 1.0, 3.0, 8.0]):
        frame_e = (
            read_out(np.full(sensor.shape, signal_e), 0.02, sensor, rng) / chain.readout.dn_per_e
        )
        mean, variance, *_ = (
            float(values) for values in code_moments([table], np.array(signal_e), frame_e.var())
        )
        assert frame_e.mean() == pytest.approx(mean, abs=(4 / 600 + 1e-3) * math.sqrt(variance))
        assert frame_e.var() == pytest.approx(variance, rel=0.02)


SMALL_WELL = {"full_well_e": 2000.0, "read_noise_e": 3.0}
ADC_AT_END = 2000.0 / (2**12 - 1 - 64)  # electrons per DN
ENDS: dict[str, dict[str, Any]] = {
    "well": {"gain_e_per_dn": 1.3 * ADC_AT_END},
    "ADC": {"gain_e_per_dn": ADC_AT_END, "full_well_e": 4000.0},
    "well and ADC": {},
}


SOFT_WELL = {
    "technology": "0.35um",
    "well_limit": "diode",
    "fill_factor": None,
    "pitch_um": 6.0,
    "full_well_e": None,
}


@pytest.mark.parametrize(
    ("own", "exposures"),
    [
        *((own, 1) for own in ENDS.values()),
        (ENDS["well"], 4),
        ({"bits": 7, "black_level_dn": 4.0}, 1),
        ({"bits": 16, "prnu": 0.02}, 1),
        ({"read_noise_e": 40.0, "offset_fpn": 0.01, "prnu": 0.02}, 1),
        (SOFT_WELL, 1),
        ({"bits": 16, "prnu": 0.02}, 4),
    ],
    ids=[*ENDS, "burst", "few bits", "fine codes", "noisy", "soft well", "burst with PRNU"],
)
def test_codes_near_the_top_have_the_mean_and_variance_of_frames(
    own: dict[str, Any], exposures: int
) -> None:
    """From 90 to 110 % of the end: of the well, of the ADC, of both, of a well that is a diode; of
    a burst of 4, too.

    Means within 4 standard errors of 360 000 pixels (6e-5 of seeds) and 0.5 % of the noise,
    variances within 5 % or 0.1 % of that without the ends: both for the skewness of 2000 electrons,
    2 %, which a normal charge does not have.
    """
    update = SMALL_WELL | own
    chain, rng = chain_of(EVEN, PIXEL.model_copy(update=update)), np.random.default_rng(45)
    chain = replace(chain, readout=chain.readout.burst(exposures))
    end_e = chain.readout.saturation_e
    table = top_table(chain.expected(0.02), end_e)
    assert table is not None
    sensor = sample_sensor(chain.readout, (600, 600), rng)
    for signal_e in end_e * np.array([0.9, 0.97, 1.0, 1.02, 1.1]):
        frame_dn = read_out(np.full(sensor.shape, signal_e), 0.02, sensor, rng)
        dark_e = chain.readout.dark_current_e_per_s * 0.02
        frame_e = (frame_dn - chain.readout.black_level_dn) / chain.readout.dn_per_e - dark_e
        before_e2 = variance_of_pixels_e2(chain.readout, signal_e, 0.02)
        mean, variance, *_ = (
            float(values) for values in code_moments([table], np.array(signal_e), before_e2)
        )
        assert frame_e.mean() == pytest.approx(mean, abs=(4 / 600 + 5e-3) * math.sqrt(before_e2))
        assert frame_e.var() == pytest.approx(variance, rel=0.05, abs=1e-3 * before_e2)


@pytest.mark.parametrize("of_end", [0.9, 0.99, 1.01, 1.03])
@pytest.mark.parametrize(
    "own", [{}, {"prnu": 0.01, "column_noise_e": 3.0}], ids=["clean", "PRNU and columns"]
)
@pytest.mark.parametrize("end", ["well", "ADC"])
def test_detectability_of_what_clips_is_the_ratio_of_the_best_template_in_frames(
    end: str, own: dict[str, float], of_end: float
) -> None:
    """A disc 5 % darker than a background at 90 to 103 % of the end; 3000 frames of sensors of
    their own, with and without it.

    The template K⁻¹Δ is that of the table. Within 3 standard errors of the ratio, of the frames'
    means and variances: 4 % of seeds would fail one of the 16.
    """
    frames, side, time_s, rng = 3000, 16, 0.02, np.random.default_rng(46)
    columns_e = own.get("column_noise_e", 0.0)
    pixel = PIXEL.model_copy(update=SMALL_WELL | ENDS[end] | {"prnu": own.get("prnu", 0.0)})
    pixel = pixel.model_copy(update={"column_fpn": columns_e / pixel.full_well_e})
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    judging = MetricRequest(metrics_named(["detectability"]))
    with warnings.catch_warnings(action="ignore"):  # an ADC that ends below the well
        chain = chain_of(EVEN, pixel, EVEN, judging)
    background_e = np.full((side, side), 2000.0 * of_end)
    target_e = background_e * (1 - 0.05 * (np.hypot(y, x) < 2.5))
    chain = replace(
        chain, signal_e_per_s=target_e / time_s, background_e_per_s=background_e / time_s
    )
    expected = _d_prime(chain.expected(time_s))

    tables = code_tables(chain.expected(time_s), target_e, background_e)
    before_e2 = variance_of_pixels_e2(chain.readout, background_e, time_s)
    moments = [code_moments(tables, signal_e, before_e2) for signal_e in (target_e, background_e)]
    column = np.arange(side**2) % side
    same_column = column[:, None] == column
    covariance = np.diag(np.mean([each.variance_e2 for each in moments], axis=0).ravel())
    for slope in (each.offset_slope.ravel() for each in moments):
        covariance += columns_e**2 * same_column * np.outer(slope, slope) / 2
    template = np.linalg.solve(covariance, (moments[0].mean_e - moments[1].mean_e).ravel())

    outputs = []
    for signal_e in (target_e, background_e):
        sensor = sample_sensor(
            chain.readout, (side, side * frames), rng
        )  # frames side by side have columns of their own
        drawn = read_out(np.tile(signal_e, frames), time_s, sensor, rng) / chain.readout.dn_per_e
        outputs.append(
            np.tensordot(
                drawn.reshape(side, frames, side),
                template.reshape(side, side),
                axes=[[0, 2], [0, 1]],
            )
        )
    variance = np.mean([output.var(ddof=1) for output in outputs])
    ratio = (outputs[0].mean() - outputs[1].mean()) / math.sqrt(variance)
    of_variances = sum(
        ((output - output.mean()) ** 4).mean() / output.var() ** 2 - 1 for output in outputs
    ) / (4 * frames)
    error = math.sqrt(2 / frames + ratio**2 / 4 * of_variances)
    assert expected == pytest.approx(ratio, abs=3 * error)


def test_pixels_with_the_same_certain_code_in_both_pictures_count_nothing() -> None:
    """Half of the pixels are at five times the ADC's end, where codes have no noise at all: d′ is
    that of the other half.

    So it is with noise of columns, which the full pixels do not have.
    """
    for columns_e in (0.0, 5.0):
        update = (
            SMALL_WELL | ENDS["ADC"] | {"column_fpn": columns_e / 4000.0, "full_well_e": 4000.0}
        )
        with warnings.catch_warnings(action="ignore"):
            chain = chain_of(
                EVEN,
                PIXEL.model_copy(update=update),
                EVEN,
                MetricRequest(metrics_named(["detectability"])),
            )
        target_e, background_e = np.full((20, 20), 950.0), np.full((20, 20), 1000.0)
        target_e[:, 10:], background_e[:, 10:] = 9900.0, 10000.0
        d_prime = [
            _d_prime(
                replace(
                    chain, signal_e_per_s=part[0] / 0.02, background_e_per_s=part[1] / 0.02
                ).expected(0.02)
            )
            for part in ((target_e, background_e), (target_e[:, :10], background_e[:, :10]))
        ]
        assert d_prime[0] == pytest.approx(d_prime[1], rel=1e-9)


def test_information_and_quanta_do_not_jump_at_the_end_of_the_well() -> None:
    """From 0.1 % below the end to 0.1 % above it, a tenth of the noise: less, by a few per cent;
    far beyond it nothing is left.
    """
    chain = chain_of(EVEN)
    end_e = chain.readout.saturation_e
    found = []
    for of_end in (0.999, 1.001, 1.1):
        at = replace(
            chain,
            exposure=pixsim.Exposure(
                integration_s=of_end * end_e / float(chain.signal_e_per_s.max())
            ),
        )
        bits = METRICS["information"].compute(FrameUnderTest.of(at, at.capture("a")))[0]
        found.append((bits, float(neq_along(at.expected(at.exposure.integration_s))[1][1])))
    for below, above in zip(*found[:2], strict=True):
        assert 0.8 * below < above < below
    assert found[2][0] == 0.0
    assert math.isnan(found[2][1])


@pytest.mark.parametrize(
    ("contrast", "background", "threshold", "reason"),
    [
        (-0.05, 1.0, 5.0, ""),
        (0.05, 1.0, 5.0, ""),
        (-0.001, 0.3, 1000.0, "a target cannot be darker than black"),
        (0.001, 18.0, 1000.0, "pixels are full with that much contrast"),
        (1.0, 15.0, 5.0, "pixels are full with the target"),
        (-0.05, 400.0, 5.0, "pixels are full without the target"),
        (0.0, 1.0, 5.0, "the target changes no pixel"),
    ],
)
def test_factor_of_a_contrast_is_given_where_such_a_target_may_be(
    contrast: float, background: float, threshold: float, reason: str
) -> None:
    """5/d′ where no picture clips and no light is negative; else 1e12, and the reason."""
    options = MetricOptions(detectability={"registrations": 1, "threshold": threshold})
    judging = MetricRequest(metrics_named(["detectability"]), options)
    image, without = (
        light(background * each.data[..., 0] / 2e-4) for each in (with_disc(contrast), EVEN)
    )
    with warnings.catch_warnings(action="ignore"):  # of light that the display clips
        chain = chain_of(image, without=without, judging=judging)
    judged = FrameUnderTest.of(chain, chain.capture("a"))
    d_prime, _, column = METRICS["detectability"].compute(judged)
    factor, cause = contrast_factor(chain.expected(0.02), d_prime)
    assert cause == reason
    assert (
        column
        == factor
        == (MAX_D_PRIME if reason else pytest.approx(threshold / d_prime, rel=1e-12))
    )


def test_factor_keeps_to_the_contrast_that_a_scene_states() -> None:
    """A blurred target of -0.5 is -0.05 in the light: twice as much may be, four times as much not,
    for all that pixels show.
    """
    options = MetricOptions(detectability={"registrations": 1})
    for times, reason in ((1.9, ""), (2.1, "a target cannot be darker than black")):
        image = with_disc(-0.05)
        image.header["parameters"] = {"contrast": "-0.5"}
        chain = chain_of(
            image, without=EVEN, judging=MetricRequest(metrics_named(["detectability"]), options)
        )
        assert (
            contrast_factor(chain.expected(0.02), options.detectability.threshold / times)[1]
            == reason
        )


@pytest.mark.parametrize("black_level_dn", [0.0, 64.0])
def test_detectability_in_the_dark_is_that_of_frames(black_level_dn: float) -> None:
    """Two thirds of the pixels are at code 0, or none: difference and variance of 60 frames each,
    10 000 pixels of 1 e- or less.

    d′ of a pixel is 0.2, and known within √2/√600 000 of it, 1 %: 3 % are 3 standard errors.
    Without the cut it would be 8 % more.
    """
    pixel = PIXEL.model_copy(update={"black_level_dn": black_level_dn})
    dim = pixsim.Exposure(integration_s=2e-5)
    levels = light(np.full((200, 200), 1.0)), light(np.full((200, 200), 0.2))
    judging = MetricRequest(
        metrics_named(["detectability"]), MetricOptions(detectability={"registrations": 1})
    )
    chain = replace(chain_of(levels[0], pixel, levels[1], judging), exposure=dim)
    expected = METRICS["detectability"].compute(FrameUnderTest.of(chain, chain.capture("a")))[0]
    assert chain.background_e_per_s is not None
    drawn = [
        np.stack(
            [replace(chain, signal_e_per_s=rate).capture(name, k).dn for k in range(60)]
        ).astype(float)
        for name, rate in (("with", chain.signal_e_per_s), ("without", chain.background_e_per_s))
    ]
    d_prime = (drawn[0].mean() - drawn[1].mean()) * math.sqrt(
        drawn[0][0].size / ((drawn[0].var() + drawn[1].var()) / 2)
    )
    assert expected == pytest.approx(d_prime, rel=0.03)
    assert (0.5 < (drawn[1] == 0).mean() < 0.9) == (black_level_dn == 0)


def test_light_without_the_target_has_the_samples_of_that_with_it() -> None:
    evaluate = partial(
        pixsim.evaluate, EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["detectability"]
    )
    coarse = SpectralImage(
        [550.0], 10.0, 2 * CELL_UM, data=np.full((100, 100, 1), 2e-4), header=EVEN.header
    )
    message = (
        "without: got 100 × 100 samples of 4 µm; allowed: the samples of the light with the target,"
        " 200 × 200 samples of 2 µm"
    )
    with pytest.raises(PixsimError, match=message):
        evaluate(without=coarse)
    with pytest.raises(PixsimError, match="negative"):
        evaluate(without=light(-np.ones((200, 200))))


@pytest.mark.parametrize(
    ("name", "denoise"),
    [("npwe", "wavelet"), ("npwe", "wiener_bound"), ("visual_noise", "wiener_bound")],
)
def test_metric_behind_noise_reduction_that_it_cannot_judge_has_no_number(
    name: str, denoise: Any
) -> None:
    """A filter that adapts does other things to a frame than to its mean; the bound knows that a
    patch is even.
    """
    given: dict[str, Any] = {"without": EVEN} if name == "npwe" else {}
    given |= {"develop": pixsim.Develop(denoise=denoise)}
    with pytest.raises(
        NoNumberError, match=f"the metric {name}: got develop.denoise = '{denoise}'"
    ):
        pixsim.evaluate(with_disc(0.05), CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=[name], **given)


def test_npwe_sees_nothing_of_what_clips() -> None:
    """Light of 300 and 330 times that of `EVEN`, both far above the full well: one picture, without
    and with the target.
    """
    with_target, without = (
        light(300.0 + 30.0 * (with_disc(1.0).data[..., 0] > 3e-4)),
        light(np.full((200, 200), 300.0)),
    )
    found = pixsim.evaluate(
        with_target, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["npwe"], without=without
    )
    assert found.frame.saturated_fraction == 1.0
    assert found.metrics["npwe"] == 0.0


@pytest.mark.parametrize("curve", ["none", "srgb"])
def test_npwe_sees_nothing_where_dark_charge_fills_the_well(curve: Any) -> None:
    full = PIXEL.model_copy(update={"dark_current_e_per_s": 1e9})
    develop = pixsim.Develop(tone_curve=curve)
    with pytest.warns(UserWarning, match="the frame tells nothing: dark charge leaves no code"):
        found = pixsim.evaluate(
            with_disc(1.0),
            CAMERA,
            full,
            EXPOSURE,
            DISPLAY,
            develop=develop,
            metrics=["npwe"],
            without=EVEN,
        )
    assert found.metrics["npwe"] == 0.0


def test_pixels_that_clip_have_no_information() -> None:
    """Half of the sensor is far beyond its full well: the other half has half of what all of it has
    in its own light.
    """
    picture = np.ones((200, 200))
    picture[:, 100:] = 1e3
    half, whole = (
        pixsim.evaluate(image, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["information"]).metrics[
            "information"
        ]
        for image in (light(picture), EVEN)
    )
    assert half == pytest.approx(whole / 2, rel=1e-9)


def test_visual_noise_of_a_burst_is_that_of_its_patch_and_not_of_what_moves() -> None:
    """A uniform patch looks the same wherever the scene moves: the noise of a burst in motion is
    that of one that stands still.
    """
    exposure, found = pixsim.Exposure(integration_s=0.02, frames=3), []
    for um_per_s in (0.0, 400.0):
        settings = {"metrics": MetricRequest(metrics_named(["visual_noise"])), "border_um": 40.0}
        motion = pixsim.Motion(image_um_per_s=(um_per_s, 0.0))
        chain = imaging_chain(
            with_disc(0.5), CAMERA, PIXEL, exposure, DISPLAY, motion=motion, **settings
        )
        found += METRICS["visual_noise"].compute(FrameUnderTest.of(chain, chain.capture("a")))
    assert found[0] == found[1]


def test_visual_noise_has_no_shading_that_is_corrected() -> None:
    """Openings that are not shifted lose a good part of the light at the edge; its correction
    leaves an even patch even.
    """
    stack = {"height_um": 6.0, "index": 1.5, "microlens": "none", "shift": "none"}
    quiet = {
        "pitch_um": 4.0,
        "stack": stack,
        "fill_factor": 0.5,
        "bits": 16,
        "read_noise_e": 0.0,
        "full_well_e": 1e9,
    }
    pixel = Pixel.model_validate(PIXEL.model_dump(exclude_unset=True) | quiet)
    bright, camera = (
        light(np.full((200, 200), 1e4)),
        Camera(die_mm=0.4, f_number=2.8, focal_length_mm=0.5),
    )
    display = DISPLAY.model_copy(update={"white_cd_per_m2": 1e4 * WHITE})
    even = imaging_chain(bright, camera, pixel, EXPOSURE, display).development.flat_field
    assert even is not None
    assert np.ptp(even) > 0.5
    for correction in (None, pixsim.Correction(flat_frames=10)):
        found = pixsim.evaluate(
            bright,
            camera,
            pixel,
            EXPOSURE,
            display,
            correction=correction,
            metrics=["visual_noise"],
        )
        assert found.metrics["visual_noise"] == pytest.approx(0.031, rel=0.1), (
            "4.4 with the shading of its correction"
        )


def test_ground_distance_of_niirs_grows_with_the_pixels() -> None:
    """Of a distance of the ground as that of the plane in focus, NIIRS is what it is without one;
    10 times farther 3.32 less.
    """
    evaluate = partial(pixsim.evaluate, EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["niirs"])
    near, same, far = (
        evaluate(
            metric=MetricOptions(
                niirs={} if distance_m is None else {"ground_distance_m": distance_m}
            )
        ).metrics["niirs"]
        for distance_m in (None, CAMERA.object_distance_m, 10 * CAMERA.object_distance_m)
    )
    assert same == pytest.approx(near, abs=1e-9)
    assert far == pytest.approx(near - 3.32, abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"niirs": {"reflectances": (0.1, 0.1)}}, "niirs: reflectances.*equal"),
        ({"snr10_lx": {"reflectance": 0.0}}, "reflectance: got 0"),
    ],
)
def test_settings_of_metrics_without_a_meaning_are_refused(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(PixsimError, match=message):
        MetricOptions(**settings)


def test_black_picture_has_no_spectrum() -> None:
    found = pixsim.evaluate(
        light(np.zeros((200, 200))),
        CAMERA,
        PIXEL,
        EXPOSURE,
        DISPLAY,
        metrics=["information"],
        metric=MetricOptions(information={"spectrum": "scene"}),
    )
    assert found.metrics["information"] == 0.0


@pytest.mark.parametrize(
    ("contrast", "low", "high"), [(0.15, 0.05, 0.45), (0.6, 0.2, 1.0), (2.0, 2 / 3, 2.0)]
)
def test_information_at_other_contrasts_is_that_of_these_contrasts(
    contrast: float, low: float, high: float
) -> None:
    """A third of the contrast, and three times it but at most 1; one that is above 1 is the higher
    one itself.
    """

    def evaluate(stated: float) -> Mapping[str, float | None]:
        options = MetricOptions(information={"contrast": stated})
        return pixsim.evaluate(
            EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["information"], metric=options
        ).further

    found = evaluate(contrast)
    assert found["information_low_contrast"] == pytest.approx(
        evaluate(low)["information"], rel=1e-9
    )
    assert found["information_high_contrast"] == pytest.approx(
        evaluate(high)["information"], rel=1e-9
    )


def test_information_of_the_scene_s_own_spectrum_has_no_other_contrasts() -> None:
    """Neither in a score nor in a table of sensors."""
    more: dict[str, Any] = {
        "metrics": ["information"],
        "metric": MetricOptions(information={"spectrum": "scene"}),
    }
    score = pixsim.evaluate(with_disc(0.2), CAMERA, PIXEL, EXPOSURE, DISPLAY, **more)
    assert list(score.further) == ["information", "information_bits_per_deg2"]
    (row,) = pixsim.sweep(
        with_disc(0.2), [PIXEL], camera=CAMERA, exposure=EXPOSURE, display=DISPLAY, jobs=1, **more
    )
    assert not [name for name in row if "contrast" in name]


def test_information_of_a_flat_spectrum_is_its_closed_form() -> None:
    """½∬ log₂(1 + S|T|²/(N + A)) of an even spectrum, by the mean over points in place of Simpson's
    rule.
    """
    judging = MetricRequest(
        metrics_named(["information"]), MetricOptions(information={"corner_cy_per_mm": 1e5})
    )
    chain = chain_of(EVEN, judging=judging)
    frame = chain.expected(0.02)
    judged = FrameUnderTest.of(chain, chain.capture("a"))
    bits = METRICS["information"].compute(judged)[0]
    mean_e = 0.02 * float(chain.signal_e_per_s.mean())
    noise = (mean_e + 16.0 + 1 / (12 * chain.readout.dn_per_e**2)) * 0.004**2
    white = (
        (0.15 * mean_e) ** 2 / (2 * math.pi * math.log(2)) / 1e10
    )  # far below the corner the spectrum is even
    axis = np.linspace(-125.0, 125.0, 501)
    seen = white * sensor_mtf(frame, axis, axis[:, None]) ** 2
    folded = sum(
        white * sensor_mtf(frame, axis + 250.0 * i, axis[:, None] + 250.0 * j) ** 2
        for i in range(-2, 3)
        for j in range(-2, 3)
        if i or j
    )
    wanted = 0.5 * 250.0**2 * float(np.log2(1 + seen / (noise + folded)).mean())
    assert bits == pytest.approx(
        wanted, rel=5e-3
    )  # of the means over points in place of Simpson's rule


def test_neq_is_the_quanta_less_noise_and_blur() -> None:
    """q²/(q + 16 + quantisation) a pixel, times the squared MTF: of shot noise alone the quanta. To
    rounding.
    """
    chain = chain_of(EVEN)
    frame = chain.expected(0.02)
    frequency, neq = neq_along(frame)
    quanta = 0.02 * float(chain.signal_e_per_s.mean())
    at_0 = quanta**2 / (quanta + 16.0 + 1 / (12 * chain.readout.dn_per_e**2)) / 0.004**2
    assert frequency[[0, -1]].tolist() == [0.0, 125.0]
    np.testing.assert_allclose(
        neq, at_0 * sensor_mtf(frame, frequency, np.zeros(1)) ** 2, rtol=1e-9
    )
    lens = float(pixsim.optics.diffraction_otf(125.0, 550.0, CAMERA.effective_f_number))
    assert neq[-1] == pytest.approx(at_0 * (lens * 2 / math.pi) ** 2, rel=1e-4), (
        "and the sinc of a pixel at Nyquist"
    )
    assert np.isnan(neq_along(chain.expected(1e3))[1]).all(), "all pixels are full"


def test_veil_is_noise_and_no_signal_to_quanta_and_information() -> None:
    """An even field whose veil is the share v of what pixels see has the NEQ of (1 - v)² of its
    quanta squared. To rounding.

    With the glare g, and s times as much from outside, v = g (1 + s)/(1 + g s), and pixels see 1 +
    g s times the light.
    """
    g, outside = 0.2, 3.0
    camera = CAMERA.model_copy(update={"veiling_glare": g, "veiling_glare_outside": outside})
    plain = chain_of(EVEN)
    chain = imaging_chain(
        EVEN,
        camera,
        PIXEL,
        EXPOSURE,
        DISPLAY,
        metrics=MetricRequest(metrics_named(["information"])),
    )
    own = 0.02 * float(plain.signal_e_per_s.mean())
    of_pixels = own * (1 + g * outside)
    assert 0.02 * float(chain.signal_e_per_s.mean()) == pytest.approx(of_pixels, rel=1e-6)
    noise = of_pixels + 16.0 + 1 / (12 * chain.readout.dn_per_e**2)
    assert neq_along(chain.expected(0.02))[1][0] == pytest.approx(
        (own * (1 - g)) ** 2 / noise / 0.004**2, rel=1e-6
    )
    found = [
        pixsim.evaluate(EVEN, each, PIXEL, EXPOSURE, DISPLAY, metrics=["information"]).metrics[
            "information"
        ]
        for each in (CAMERA, camera.model_copy(update={"veiling_glare_outside": 0.0}), camera)
    ]
    assert found[0] > found[1] > found[2], "stray light from outside brings no information"


def test_veil_takes_contrast_from_the_surfaces_of_niirs() -> None:
    """Their difference is 1 - g of that without, and both have the veil's shot noise: as an SNR
    that much lower. To rounding.
    """
    g = 0.2
    camera = CAMERA.model_copy(update={"veiling_glare": g, "object_distance_m": 1000.0})
    own = camera.without_veil, camera
    found = [
        pixsim.evaluate(EVEN, each, PIXEL, EXPOSURE, DISPLAY, metrics=["niirs"]).metrics["niirs"]
        for each in own
    ]
    chain = imaging_chain(EVEN, camera.without_veil, PIXEL, EXPOSURE, DISPLAY)
    white, even = 0.02 * chain.white_e_per_s, 0.02 * float(chain.signal_e_per_s.mean())
    fixed = 16.0 + 1 / (12 * chain.readout.dn_per_e**2)
    plain = 0.08 * white / math.sqrt(0.15 * white + fixed)
    veiled = 0.08 * white * (1 - g) / math.sqrt(0.15 * white * (1 - g) + g * even + fixed)
    ground_m = 1e-6 * 4.0 / abs(camera.magnification)
    veiled_chain = imaging_chain(
        EVEN, camera, PIXEL, EXPOSURE, DISPLAY, metrics=MetricRequest(metrics_named(["niirs"]))
    )
    along, mtf = _mtf_along(veiled_chain.expected(0.02))
    rer = relative_edge_response(along * 0.004, mtf)
    assert found == pytest.approx([niirs(rer, ground_m, snr) for snr in (plain, veiled)], rel=1e-6)
    assert found[0] > found[1]


def test_information_of_a_stated_spectrum_does_not_depend_on_the_film() -> None:
    """An even field in cells of 0.8 to 4 µm: the spectrum is that of natural scenes, and the level
    the same to rounding.
    """
    found = []
    for count in (100, 200, 500):
        data = np.full((count, count, 1), 2e-4, np.float32)
        image = SpectralImage(
            [550.0], 10.0, 400.0 / count, data=data, header={"diffraction": False}
        )
        score = pixsim.evaluate(image, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["information"])
        found.append(score.metrics["information"])
    assert found == pytest.approx([found[0]] * 3, rel=1e-9)


def test_information_of_the_scene_is_that_of_another_film() -> None:
    """A picture with a spectrum of its own, in cells of 2 and 4 µm: what both show of it is the
    same within 1 %.
    """
    rng = np.random.default_rng(3)
    fine = rng.normal(size=(200, 200))
    smooth = np.fft.irfft2(
        np.fft.rfft2(fine)
        * np.exp(-((60 * np.hypot(np.fft.fftfreq(200)[:, None], np.fft.rfftfreq(200))) ** 2) / 8)
    )
    picture = 1 + 0.2 * smooth / smooth.std()
    coarse = picture.reshape(100, 2, 100, 2).mean(axis=(1, 3))
    options = MetricOptions(information={"spectrum": "scene"})
    found = []
    for cell_um, values in ((CELL_UM, picture), (2 * CELL_UM, coarse)):
        image = SpectralImage(
            [550.0],
            10.0,
            cell_um,
            data=np.float32(2e-4 * values)[..., None],
            header={"diffraction": False},
        )
        score = pixsim.evaluate(
            image, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["information"], metric=options
        )
        found.append(score.metrics["information"])
    assert found[1] == pytest.approx(found[0], rel=0.01)


def test_sensor_mtf_is_that_of_a_slanted_edge() -> None:
    """The expected signal of an edge of 5° behind the same lens and pixels. The sampled edge spread
    errs by less than 0.02.
    """
    y, x = np.mgrid[:1000, :1000] + 0.5
    fine = (x - 500 + math.tan(math.radians(5.0)) * (y - 500) > 0).astype(float)
    picture = 0.2 + 0.6 * fine.reshape(200, 5, 200, 5).mean(axis=(1, 3))
    data = np.float32(2e-4 * picture)[..., None]
    image = SpectralImage([550.0], 10.0, CELL_UM, data=data)  # with diffraction
    chain = chain_of(image)
    frequency = np.linspace(0.0, 0.45, 10)
    measured = edge_mtf(chain.signal_e_per_s[10:-10, 10:-10], 5.0, frequency)
    along = frequency * 1e3 / 4.0
    tilt = math.radians(5.0)
    modelled = sensor_mtf(chain.expected(0.02), along * math.cos(tilt), along * math.sin(tilt))
    np.testing.assert_allclose(measured, modelled, atol=0.02)


def test_snr10_is_the_light_at_which_a_dot_has_it() -> None:
    """Frames of a wall in that light: mean over deviation of a dot is 10, within 3 standard errors
    (0.3 % of seeds fail).
    """
    options = MetricOptions(snr10_lx={"reflectance": 0.5, "integration_s": 0.02})
    score = pixsim.evaluate(
        EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=["snr10_lx"], metric=options
    )
    wall_cd_per_m2 = 0.5 * score.metrics["snr10_lx"] / math.pi
    chain = chain_of(EVEN)
    mean_e = 0.02 * chain.white_e_per_s * wall_cd_per_m2 / WHITE
    area = (400 / 64 / 4.0) ** 2  # pixels a dot
    rng = np.random.default_rng(0)
    counts = 20_000
    electrons = rng.poisson(mean_e, counts) + rng.normal(
        0.0, math.sqrt(16.0 + 1 / (12 * chain.readout.dn_per_e**2)), counts
    )
    snr = math.sqrt(area) * electrons.mean() / electrons.std()
    assert snr == pytest.approx(10.0, abs=3 * 10.0 / math.sqrt(2 * counts))


def test_visual_noise_falls_with_the_root_of_the_light() -> None:
    """Shot noise alone, relative to white: twice as little in four times the light. Both are frames
    of one stream.
    """
    noiseless = PIXEL.model_copy(update={"read_noise_e": 0.0, "bits": 16})
    judging = MetricRequest(metrics_named(["visual_noise"]))
    found = []
    for time_s in (0.005, 0.02):
        chain = chain_of(EVEN, noiseless, judging=judging)
        chain = replace(chain, exposure=pixsim.Exposure(integration_s=time_s))
        chain = replace(
            chain, screen=replace(chain.screen, display=DISPLAY.model_copy(update={"bits": 16}))
        )
        found.append(
            METRICS["visual_noise"].compute(FrameUnderTest.of(chain, chain.capture("a")))[0]
        )
    assert found[0] / found[1] == pytest.approx(2.0, rel=0.1)


def test_acutance_is_highest_for_small_pixels_and_at_most_1() -> None:
    found = []
    for pitch_um in (2.0, 4.0, 8.0):
        pixel = PIXEL.model_copy(update={"pitch_um": pitch_um})
        found.append(
            pixsim.evaluate(EVEN, CAMERA, pixel, EXPOSURE, DISPLAY, metrics=["acutance"]).metrics[
                "acutance"
            ]
        )
    assert 1 > found[0] > found[1] > found[2] > 0


def mine(score: Any) -> float:
    return float(score.image.max())


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["detectabilty"], r"allowed: any of delta_e, .*Did you mean 'detectability'\? A function"),
        (
            ["sharpness"],
            r"metrics: got 'sharpness'; allowed: any of delta_e, detectability, .*Python",
        ),
        (["delta_e", "delta_e"], r"'delta_e' twice"),
        ([], r"metrics: got none"),
        ([lambda score: 1.0], r"a named function, not a lambda"),
    ],
)
def test_metrics_that_are_none_are_refused(names: list[Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        pixsim.evaluate(EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=names)


FROM_NM = {"B": 400, "G": 500, "R": 600}
CHANNELS = {
    name: [[nm, 0.5 * (low <= nm < low + 100)] for nm in range(400, 701, 20)]
    for name, low in FROM_NM.items()
}
OF_GREY = r"'{}'; allowed: a pixel without colour filters \(pixel\.colour\)"
OF_PICTURE = r"'{}'; allowed: the frame of a sensor"
OF_TARGET = r"'{}'; allowed: light of the scene without its target"
OF_LIGHT = (
    r"the scene's white: got 0 .*; allowed: light to which both the sensor and the eye respond"
)
# What is asked of a metric: settings of the pixel and bands of the light; the metrics that mean
# something; what the others say.
SITUATIONS: dict[str, tuple[dict[str, Any], range, set[str], str]] = {
    "grey": ({}, range(400, 701, 20), set(METRICS), ""),
    "mosaic": (
        {"pattern": "rggb"},
        range(400, 701, 20),
        {"delta_e", "detectability", "flip"},
        OF_GREY,
    ),
    "stacked": (
        {"pattern": "stacked"},
        range(400, 701, 20),
        {"delta_e", "detectability", "flip"},
        OF_GREY,
    ),
    "no target": ({}, range(400, 701, 20), set(METRICS) - {"detectability", "npwe"}, OF_TARGET),
    "infrared": ({}, range(840, 901, 20), set(), OF_LIGHT),
    "picture": ({}, range(0), {"delta_e", "flip"}, OF_PICTURE),
}


@pytest.mark.parametrize("situation", SITUATIONS)
@pytest.mark.parametrize("name", METRICS)
def test_every_metric_has_a_number_or_says_what_it_needs(name: str, situation: str) -> None:
    colour, nm, meant, message = SITUATIONS[situation]
    if name == "flip" and find_spec("flip_evaluator") is None:
        meant, message = (
            set(),
            "pip install" if situation != "infrared" else "pip install|" + message,
        )

    def judged() -> float:
        if situation == "picture":
            return pixsim.score_pictures(
                np.full((32, 32), 0.5), np.full((32, 32), 0.4), metrics=[name]
            ).metrics[name]
        own = (
            {"quantum_efficiency": 0.6}
            if not colour
            else {"colour": ColourOptions(quantum_efficiencies=CHANNELS, **colour)}
        )
        pixel = PIXEL.model_copy(update={"quantum_efficiency": None} | own)
        disc = 1.0 + 0.1 * (np.hypot(*(np.mgrid[:100, :100] - 49.5)) < 20.0)
        lit = [
            SpectralImage(
                nm,
                20.0,
                2 * CELL_UM,
                data=np.float32(2e-5 * each)[..., None] * np.ones(len(nm), np.float32),
            )
            for each in (disc, np.ones((100, 100)))
        ]
        without = lit[1] if name in ("detectability", "npwe") and situation != "no target" else None
        return pixsim.evaluate(
            lit[0], CAMERA, pixel, EXPOSURE, DISPLAY, metrics=[name], without=without
        ).metrics[name]

    if name in meant:
        assert math.isfinite(judged())
        return
    with pytest.raises(PixsimError, match=message.format(name)):
        judged()


@pytest.mark.parametrize("value", [math.nan, math.inf, "a", None, True, np.ones(3)])
def test_function_of_a_user_returns_a_finite_number(value: Any) -> None:
    def wrong(score: Any) -> Any:
        return value

    with pytest.raises(PixsimError, match="allowed: a function that returns one finite number"):
        pixsim.evaluate(EVEN, CAMERA, PIXEL, EXPOSURE, DISPLAY, metrics=[wrong])


def test_code_of_a_function_is_part_of_its_metric() -> None:
    def one(score: Any) -> float:
        return 1.0

    first = user_metric(one)

    def one(score: Any) -> float:  # type: ignore[no-redef]
        return 2.0

    assert first.code != user_metric(one).code
    assert user_metric(one).code == user_metric(one).code


def test_pictures_are_scored_only_if_a_metric_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[object] = []
    whole: Callable[..., Any] = Development.score
    monkeypatch.setattr(
        Development, "score", lambda self, frame: scored.append(frame) or whole(self, frame)
    )
    for names, count in ((["information", "mtf50"], 0), (["information", "delta_e"], 1)):
        judging = MetricRequest(metrics_named(names), METRIC_OPTIONS)
        chain = chain_of(EVEN, judging=judging)
        statistics = FrameUnderTest.of(chain, chain.capture("a")).statistics()
        assert len(scored) == count
        assert {"information", "information_bits_per_deg2"} <= statistics.keys()


def test_name_of_snr10_holds_for_any_snr() -> None:
    """The SNR is a setting: words of a result that state 10 would be wrong for another one."""
    assert METRICS["snr10_lx"].words == "illuminance for the SNR wanted"
