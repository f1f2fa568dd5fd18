"""Metrics of the shown picture beside ΔE."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from pixsim.base.arrays import Array, stream
from pixsim.base.digits import percent
from pixsim.base.errors import invalid
from pixsim.sensor.correction import correct
from pixsim.sensor.readout import (
    Frame,
    MergedFrame,
    capture_from_rates,
    sample_sensor,
    with_shared_time,
)
from pixsim.viewer.chain import ExpectedFrame
from pixsim.viewer.develop_steps import noise_of_expected_e2
from pixsim.viewer.dot_noise import RawNoise, expected_noise_power
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.metric_kernels.non_prewhitening import npwe
from pixsim.viewer.metric_kernels.sharpness import acutance
from pixsim.viewer.metric_kernels.visible_noise import visual_noise
from pixsim.viewer.metrics import Metric, MetricContext, NoNumberError
from pixsim.viewer.mtf import mtf_terms
from pixsim.viewer.raw_metrics import (
    code_moments,
    code_tables,
    expected_e,
    full_e,
    requires_monochrome,
    requires_target,
    variance_of_pixels_e2,
)
from pixsim.viewer.score import Score
from pixsim.viewer.sharpening import unsharp_response

GREY = 0.18  # of white: the patch of visual noise
_FEW_FULL = 0.01  # of the patch's pixels: the noise of more of them is cut off where it shows
POINTS = 257
_FLIP_PACKAGE = "flip_evaluator"


def _acutance(under_test: FrameUnderTest) -> tuple[float]:
    frame = under_test.expected
    imaging = under_test.imaging
    development = under_test.development
    display = imaging.display
    develop = imaging.develop
    screen = development.screen
    pitch_um = development.readout.physics.read_pitch_um
    mm_per_deg = 1e-3 * display.samples_per_deg * (screen.dot_um or pitch_um)
    frequency = np.linspace(0.0, display.samples_per_deg / 2, POINTS)
    on_sensor = frequency / mm_per_deg

    def compute() -> float:
        terms = mtf_terms(
            imaging, frame.light.mean, on_sensor, screen.dot_um, frame.image_motion.longest_um
        )
        if develop.sharpens:
            cy_per_px = 1e-3 * pitch_um * on_sensor
            terms["sharpening"] = unsharp_response(
                cy_per_px, develop.sharpen_amount, development.sharpen_px
            )
        return acutance(frequency, np.abs(np.prod(list(terms.values()), axis=0)))

    sharpened = develop.sharpen_amount, development.sharpen_px if develop.sharpens else 0.0
    key = (
        "acutance",
        display.content_hash,
        *sharpened,
        frame.image_motion.path_um,
        *imaging.pixel_key,
    )
    return (frame.light.cached(key, compute),)


ACUTANCE = Metric(
    name="acutance",
    title="acutance",
    unit="",
    better="more",
    judges="shown picture",
    source="CPIQ, IEEE 1858: ∫MTF·CSF/∫CSF, the numerator to the Nyquist frequency of the display",
    unseen="noise, noise reduction, aliases, tone curves and what is in the picture",
    columns=("acutance",),
    bounds=(0.0, 10.0),
    compute=_acutance,
    requirement=requires_monochrome,
    needs_light=True,
)


def _visual_noise(under_test: FrameUnderTest) -> tuple[float]:
    """Show a frame of a uniform patch, of the same sensor settings and exposure, in a stream of its
    own.
    """
    development = under_test.development
    imaging = under_test.imaging
    time_s = under_test.frame.integration_s
    correction = imaging.correction
    if imaging.develop.denoise == "wiener_bound":
        got = "develop.denoise = 'wiener_bound', which knows that the patch is uniform"
        allowed = "noise reduction that does not know the picture"
        hint = "Use 'nlm' or 'wavelet'."
        raise NoNumberError(str(invalid("the metric visual_noise", got, allowed, hint)))
    uniform: Array = np.full(under_test.frame.shape, GREY * development.white_e_per_s)
    flat_field = development.flat_field
    if flat_field is not None and (development.shading is not None or correction.flat_frames):
        uniform *= flat_field  # by which the picture is divided

    key = (*under_test.stream, "visual noise")
    rows, columns = uniform.shape
    sensor = sample_sensor(development.readout, (rows, columns), stream(*key, "sensor"))
    exposure = with_shared_time(development.exposure.steady, time_s)
    frame = capture_from_rates(uniform, sensor, exposure, stream(*key, "frame"))
    if correction.is_on:
        frame = correct(frame, sensor, correction, stream(*key, "correction"), flat_field, None)
    if frame.saturated_fraction > _FEW_FULL:
        got = (
            f"{percent(frame.saturated_fraction)} of the pixels of"
            f" {development.readout.physics.pitch_um:g} µm full"
        )
        allowed = (
            f"at most {percent(_FEW_FULL)} in a patch of {percent(GREY)} of white, whose noise"
            " shows"
        )
        hint = "Shorten the exposure."
        raise NoNumberError(str(invalid("the metric visual_noise", got, allowed, hint)))
    light = development.light(frame)
    return (visual_noise(light, imaging.display.samples_per_deg),)


VISUAL_NOISE = Metric(
    name="visual_noise",
    title="visual noise",
    unit="",
    better="less",
    judges="shown picture",
    source="ISO 15739:2013, annex B, of an even patch of 18 % of white",
    unseen="sharpness, and noise of other levels",
    columns=("visual_noise",),
    bounds=(0.0, 1e4),
    compute=_visual_noise,
    requirement=requires_monochrome,
)


def _npwe(under_test: FrameUnderTest) -> tuple[float, float]:
    """Compare the shown light of expected frames of each registration, in the expected spectrum of
    their noise.

    A tone curve is not linear: the noise of this frame says by how much the curve changes it in the
    band of the target. That is the ratio of two periodograms of the same noise, with and without
    the curve, which scatters much less than either of them.
    """
    develop = under_test.imaging.develop
    if develop.denoises:
        got = (
            f"develop.denoise = '{develop.denoiser}', whose effect on a frame differs from its"
            " effect on the mean"
        )
        hint = "Use ΔE, or detectability."
        raise NoNumberError(str(invalid("the metric npwe", got, "linear development", hint)))
    count = under_test.options.detectability.registrations
    tone_factor = 1.0
    values = []
    for number, frame in enumerate(under_test.registrations(count)):
        development = frame.development
        samples_per_deg = development.screen.display.samples_per_deg
        with_target, difference = _expected_light(under_test.frame, frame)
        if number == 0 and develop.tone and difference.any():
            light = development.light_before_tone(under_test.frame)
            noise = _periodogram(light - with_target)
            toned_noise = _periodogram(development.toned(light) - development.toned(with_target))
            toned = npwe(difference, toned_noise, samples_per_deg)
            linear = npwe(difference, noise, samples_per_deg)
            if math.isfinite(toned) and 0 < linear < math.inf:  # else codes hide all noise
                tone_factor = toned / linear
        power = expected_noise_power(development, _raw_noise(frame, frame.signal_e))
        values.append(tone_factor * npwe(difference, power, samples_per_deg))
    return float(np.mean(values)), min(values)


def _expected_light(drawn: Frame, frame: ExpectedFrame) -> tuple[Array, Array]:
    """Return the expected light of the dots before the tone curve, and behind it what the target
    changes, (H, W) each.

    drawn : a frame of the same sensor settings
    """
    development = frame.development
    assert frame.background_e is not None
    with_target, background = (
        development.light_before_tone(_as_drawn(drawn, frame, expected_e(frame, signal_e)))
        for signal_e in (frame.signal_e, frame.background_e)
    )
    return with_target, np.asarray(
        development.toned(with_target) - development.toned(background), float
    )


def _periodogram(noise: Array) -> Array:
    """Return the squared spectrum of noise around its mean, (H, W), in any unit."""
    return np.asarray(np.abs(np.fft.fft2(noise - noise.mean(dtype=float))) ** 2)


def _raw_noise(frame: ExpectedFrame, signal_e: Array) -> RawNoise:
    """Return the noise of an expected frame behind its corrections, relative to the scene's white.

    Near the ends of the well and of the codes it is what these leave.

    signal_e : (rows, columns) of light, before anything clips
    """
    readout = frame.readout
    time_s = frame.integration_s
    development = frame.development
    correction = frame.imaging.correction
    level_e = np.minimum(signal_e, full_e(readout, time_s))
    pixel_e2, column_e2, row_e2 = noise_of_expected_e2(level_e, readout, time_s, correction)
    tables = code_tables(frame, signal_e)
    if tables:
        unclipped_e2 = variance_of_pixels_e2(readout, level_e, time_s)
        clipped = code_moments(tables, signal_e, unclipped_e2)
        pixel_e2 = np.maximum(pixel_e2 - (unclipped_e2 - clipped.variance_e2), 0.0)
        offset_factor = float(np.mean(np.square(clipped.offset_slope)))
        column_e2 = column_e2 * offset_factor
        row_e2 = row_e2 * offset_factor

    white_e = np.full(signal_e.shape, frame.white_e)
    if development.shading is not None:
        white_e *= development.shading
    if development.flat_field is not None and correction.flat_frames:
        white_e *= development.flat_field
    line_factor = float(np.mean(white_e**-2))
    return RawNoise(
        pixel=pixel_e2 / white_e**2, column=column_e2 * line_factor, row=row_e2 * line_factor
    )


def _as_drawn(drawn: Frame, frame: ExpectedFrame, electrons: Array) -> Frame:
    """Return expected electrons (rows, columns) as a frame, corrected as the one that was drawn."""
    flat_field = frame.development.flat_field
    corrected = electrons
    if flat_field is not None and frame.imaging.correction.flat_frames:
        corrected = electrons / flat_field
    codes: dict[str, Any] = {}
    if not isinstance(drawn, MergedFrame):
        codes["dn"] = np.zeros(electrons.shape, np.int32)
    return replace(
        drawn,
        **codes,
        mean_e=electrons,
        corrected_e=corrected.astype(np.float32),
        integration_s=frame.integration_s,
        registration=frame.readout.physics.registration,
        saturated=None,
    )


def _requires_target_and_monochrome(context: MetricContext) -> str:
    return requires_monochrome(context) or requires_target(context)


NPWE = Metric(
    name="npwe",
    title="detectability by eye d′",
    unit="",
    better="more",
    judges="shown picture",
    source=(
        "non-prewhitening observer with an eye filter: Burgess, J. Opt. Soc. Am. A 11 (1994) 1237"
    ),
    unseen=(
        "the codes of the display, unknown positions of the target, clutter, and noise of the eye"
        " itself"
    ),
    columns=("npwe", "least_npwe"),
    bounds=(0.0, 1e12),
    compute=_npwe,
    worst=("least_npwe",),
    requirement=_requires_target_and_monochrome,
    needs_light=True,
)


def _requires_flip(context: MetricContext) -> str:
    return (
        "" if find_spec(_FLIP_PACKAGE) else "the package of its authors: pip install 'pixsim[flip]'"
    )


def _flip(score: Score) -> tuple[float]:
    import flip_evaluator

    pictures = []
    for picture in (score.ideal, score.image):
        rgb = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
        pictures.append(np.ascontiguousarray(rgb, np.float32))
    # The shown light is linear, and its primaries are those of sRGB: the package need not decode
    # it.
    _, mean, _ = flip_evaluator.evaluate(
        *pictures, "LDR", False, False, True, {"ppd": score.display.samples_per_deg}
    )
    return (float(mean),)


FLIP = Metric(
    name="flip",
    title="mean FLIP",
    unit="",
    better="less",
    judges="shown picture",
    source=(
        "Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3 (2020) 15; flip-evaluator,"
        " the package of its authors"
    ),
    unseen=(
        "what nobody sees who flips between the two pictures: it was fitted to rendered pictures,"
        " at 67 dots per degree"
    ),
    columns=("mean_flip",),
    bounds=(0.0, 1.0),
    compute=_flip,
    requirement=_requires_flip,
    needs_frame=False,
)
