"""Metrics of the shown picture beside ΔE."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.arrays import Array, stream
from pixsim.base.errors import invalid
from pixsim.sensor.readout import lasting
from pixsim.viewer.develop_steps import noise_of_expected_e2
from pixsim.viewer.dot_noise import RawNoise, expected_noise_power
from pixsim.viewer.judges.non_prewhitening import npwe
from pixsim.viewer.judges.sharpness import acutance
from pixsim.viewer.judges.visible_noise import visual_noise
from pixsim.viewer.metrics import Metric, MetricContext, NoNumberError
from pixsim.viewer.mtf import mtf_terms
from pixsim.viewer.raw_metrics import code_moments, code_tables, expected_e, full_e, grey, needs_target, variance_of_pixels_e2
from pixsim.viewer.sharpening import unsharp_response

if TYPE_CHECKING:
    from pixsim.sensor.readout import Frame
    from pixsim.viewer.judged import Judged
    from pixsim.viewer.score import ImagingChain, Score

GREY = 0.18  # of white: the patch of visual noise
FEW_FULL = 0.01  # of the patch's pixels: the noise of more of them is cut off where it shows
POINTS = 257
FLIP_PACKAGE = "flip_evaluator"


def _acutance(judged: Judged) -> tuple[float]:
    chain = judged.chain
    display, facts = chain.screen.display, chain.facts
    frequency = np.linspace(0.0, display.samples_per_deg / 2, POINTS)
    on_sensor = frequency / judged.mm_per_deg

    def compute() -> float:
        of_chain = chain.physics, display, on_sensor, chain.screen.dot_um, chain.moving.longest_um
        terms = mtf_terms(facts.mean, facts.camera, *of_chain)
        if chain.develop.sharpens:
            cy_per_px = 1e-3 * chain.physics.read_pitch_um * on_sensor
            terms["sharpening"] = unsharp_response(cy_per_px, chain.develop.sharpen_amount, chain.sharpen_px)
        return acutance(frequency, np.abs(np.prod(list(terms.values()), axis=0)))

    sharpened = chain.develop.sharpen_amount, chain.sharpen_px if chain.develop.sharpens else 0.0
    return (facts.kept(("acutance", display.content_hash, *sharpened, chain.moving.path_um, *chain.pixel_key), compute),)


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
    lacks=grey,
    needs_light=True,
)


def _visual_noise(judged: Judged) -> tuple[float]:
    """Show a frame of an even patch, of the same sensor settings and exposure, in a stream of its own."""
    chain, time_s = judged.chain, judged.frame.integration_s
    if chain.develop.denoise == "wiener_bound":
        got, hint = "develop.denoise = 'wiener_bound', which knows that its patch is even", "Take 'nlm' or 'wavelet'."
        raise NoNumberError(str(invalid("the metric visual_noise", got, "noise reduction that does not know the picture", hint)))
    even = np.full(chain.signal_e_per_s.shape, GREY * chain.white_e_per_s)
    if chain.even is not None and (chain.shading is not None or chain.correction.flat_frames):
        even *= chain.even  # by which the picture is divided
    patch = replace(chain, signal_e_per_s=even, exposure=lasting(chain.exposure.steady, time_s))
    key = (*judged.stream, judged.number, "visual noise")
    frame = patch.capture_with(stream(*key, "sensor"), stream(*key, "frame"), stream(*key, "correction"))
    if frame.saturated_fraction > FEW_FULL:
        full = f"{frame.saturated_fraction:.0%} of the pixels of {chain.physics.pitch_um:g} µm full"
        allowed = f"at most {FEW_FULL:.0%} in a patch of {GREY:.0%} of white, whose noise shows"
        raise NoNumberError(str(invalid("the metric visual_noise", full, allowed, "Expose it for less time.")))
    return (visual_noise(patch.light(frame), chain.screen.display.samples_per_deg),)


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
    lacks=grey,
)


def _npwe(judged: Judged) -> tuple[float, float]:
    """Compare the shown light of expected frames of each registration, in the expected spectrum of their noise.

    A tone curve is not linear: the noise of this frame says by how much the curve changes it in the band of the target. That is
    the ratio of two periodograms of the same noise, with and without the curve, which scatters much less than either of them.
    """
    if judged.chain.develop.denoises:
        got = f"develop.denoise = '{judged.chain.develop.denoiser}', which does other things to a frame than to its mean"
        raise NoNumberError(str(invalid("the metric npwe", got, "development that is linear", "Take ΔE, or detectability.")))
    change, values = 1.0, []
    for chain in judged.chains(judged.options.detectability.registrations):
        with_target, difference = _expected_light(judged, chain)
        samples_per_deg, time_s = chain.screen.display.samples_per_deg, judged.time_s(chain)
        power = expected_noise_power(chain, raw_noise(chain, chain.signal_e_per_s * time_s, time_s))
        if chain is judged.chain and chain.develop.tone and difference.any():
            light = chain.light_before_tone(judged.frame)
            curved = npwe(difference, _periodogram(chain.toned(light) - chain.toned(with_target)), samples_per_deg)
            straight = npwe(difference, _periodogram(light - with_target), samples_per_deg)
            if math.isfinite(curved) and 0 < straight < math.inf:  # else codes hide all noise
                change = curved / straight
        values.append(change * npwe(difference, power, samples_per_deg))
    return float(np.mean(values)), min(values)


def _expected_light(judged: Judged, chain: ImagingChain) -> tuple[Array, Array]:
    """Return the expected light of the dots before the tone curve, and behind it what the target changes, (H, W) each."""
    assert chain.without_e_per_s is not None
    time_s = judged.time_s(chain)
    with_target, without = (
        chain.light_before_tone(_expected_frame(judged.frame, chain, expected_e(chain, rate * time_s, time_s), time_s))
        for rate in (chain.signal_e_per_s, chain.without_e_per_s)
    )
    return with_target, np.asarray(chain.toned(with_target) - chain.toned(without), float)


def _periodogram(noise: Array) -> Array:
    """Return the squared spectrum of noise around its mean, (H, W), in any unit."""
    return np.asarray(np.abs(np.fft.fft2(noise - noise.mean(dtype=float))) ** 2)


def raw_noise(chain: ImagingChain, signal_e: Array, time_s: float) -> RawNoise:
    """Return the noise of an expected frame behind its corrections, relative to the scene's white.

    Near the ends of the well and of the codes it is what these leave.

    signal_e : (rows, columns) of light, before anything clips
    """
    physics, correction = chain.physics, chain.correction
    level_e = np.minimum(signal_e, full_e(chain, time_s))
    pixel, column, row = noise_of_expected_e2(level_e, physics, time_s, correction)
    tables = code_tables(chain, time_s, signal_e)
    if tables:
        unclipped = variance_of_pixels_e2(chain, level_e, time_s)
        clipped = code_moments(tables, signal_e, unclipped)
        pixel = np.maximum(pixel - (unclipped - clipped.variance_e2), 0.0)
        of_offsets = float(np.mean(np.square(clipped.offset_slope)))
        column, row = column * of_offsets, row * of_offsets
    white_e = chain.white_e_per_s * time_s * np.ones(signal_e.shape)
    if chain.shading is not None:
        white_e *= chain.shading
    if chain.even is not None and correction.flat_frames:
        white_e *= chain.even
    pixel = pixel / white_e**2
    of_lines = float(np.mean(white_e**-2))
    return RawNoise(pixel, column * of_lines, row * of_lines)


def _expected_frame(frame: Frame, chain: ImagingChain, electrons: Array, time_s: float) -> Frame:
    """Return a frame of a chain with expected electrons (rows, columns) in place of its own, corrected as it is."""
    corrected = electrons / chain.even if chain.even is not None and chain.correction.flat_frames else electrons
    return replace(
        frame,
        dn=np.zeros(electrons.shape, np.int32),
        mean_e=electrons,
        corrected_e=corrected.astype(np.float32),
        integration_s=time_s,
        registration=chain.physics.registration,
        saturated=None,
    )


def _needs_target_in_grey(asked: MetricContext) -> str:
    return grey(asked) or needs_target(asked)


NPWE = Metric(
    name="npwe",
    title="detectability by eye d′",
    unit="",
    better="more",
    judges="shown picture",
    source="non-prewhitening observer with an eye filter: Burgess, J. Opt. Soc. Am. A 11 (1994) 1237",
    unseen="the codes of the display, unknown positions of the target, clutter, and noise of the eye itself",
    columns=("npwe", "least_npwe"),
    bounds=(0.0, 1e12),
    compute=_npwe,
    worst=("least_npwe",),
    lacks=_needs_target_in_grey,
    needs_light=True,
)


def _needs_flip(asked: MetricContext) -> str:
    return "" if find_spec(FLIP_PACKAGE) else "the package of its authors: pip install 'pixsim[flip]'"


def _flip(score: Score) -> tuple[float]:
    import flip_evaluator

    pair = []
    for picture in (score.ideal, score.image):
        of_primaries = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
        pair.append(np.ascontiguousarray(of_primaries, np.float32))
    # The shown light is linear, and its primaries are those of sRGB: the package need not decode it.
    _, mean, _ = flip_evaluator.evaluate(*pair, "LDR", False, False, True, {"ppd": score.display.samples_per_deg})
    return (float(mean),)


FLIP = Metric(
    name="flip",
    title="mean FLIP",
    unit="",
    better="less",
    judges="shown picture",
    source="Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3 (2020) 15; flip-evaluator, the package of its authors",
    unseen="what nobody sees who flips between the two pictures: it was fitted to rendered pictures, at 67 dots per degree",
    columns=("mean_flip",),
    bounds=(0.0, 1.0),
    compute=_flip,
    lacks=_needs_flip,
    needs_frame=False,
)
