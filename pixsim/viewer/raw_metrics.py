"""Metrics of the raw frame, from its expected signal and its closed-form variance: none of them needs a drawn frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.sensor.integration import M2_PER_UM2, electrons_per_joule, split_by_veil
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.photodiode import saturation_level_e
from pixsim.viewer.display import white_cd_per_m2
from pixsim.viewer.judges.information_density import folded_spectrum, information_bits_per_mm2, natural_spectrum, neq
from pixsim.viewer.judges.interpretability import niirs, relative_edge_response
from pixsim.viewer.judges.linear_observer import detectability
from pixsim.viewer.judges.sharpness import mtf50
from pixsim.viewer.judges.snr_illuminance import snr10_lx
from pixsim.viewer.metrics import Metric, MetricContext, NoNumberError
from pixsim.viewer.mtf import mtf_terms, of_sensor

if TYPE_CHECKING:
    from pixsim.viewer.judged import Judged
    from pixsim.viewer.metric_options import Information
    from pixsim.viewer.score import ImagingChain

LEAST_SIGMA_DN = 0.5  # below it quantisation is no noise, and no observer is linear in it
FARTHEST = 1e12  # of d′, and of what a target lacks
COARSE_DN = 8.0  # deviation above which sums over codes are integrals within 1/(24 σ²), 7e-4
FARTHEST_SIGMAS = 6.0  # from code 0, which cuts off no noise farther away
CODE_POINTS = 1025  # of a table: a slope between two of them errs by 3e-3 of its change
LEAST = 1e-9  # of deviations, in DN
POINTS = 65  # frequencies on an axis of the Nyquist square
ORDERS = 2  # of aliases
LENSES = ("lens", "real lens")
RADIAL = (*LENSES, "diffusion")  # terms of the MTF; the others are products of both axes
TABLE_POINTS = 1025
HIGHEST_CY_PER_PX = 4.0  # of the table of the MTF: the corner of the second aliases is at 3.5


def variance_of_pixels_e2(chain: ImagingChain, signal_e: Array | float, time_s: float) -> Array:
    """Return the variance that a pixel has alone, with its fixed pattern and the quantisation, in the shape of the signal."""
    p = chain.physics
    dark_e = p.dark_current_e_per_s * time_s
    alone = variance_e2(p, signal_e + dark_e, light_e=signal_e, dark_e=dark_e, along="pixel")
    return np.asarray(alone + p.rounding_variance_dn2 / p.dn_per_e**2)


def full_e(chain: ImagingChain, time_s: float) -> float:
    """Return the signal at which the well is full, or the codes end, in electrons."""
    p = chain.physics
    dark_e = p.dark_current_e_per_s * time_s
    top_e = (p.top_code_dn - p.black_level_dn) / p.dn_per_e - dark_e  # `frame_mean_dn` is linear
    return min(saturation_level_e(time_s, p) - dark_e, top_e)


def clips(chain: ImagingChain, signal_e: Array, time_s: float) -> NDArray[np.bool_]:
    """Return which pixels of an expected signal are at the end of the well or of the codes."""
    return np.asarray(signal_e >= full_e(chain, time_s))


class CodesOf0(NamedTuple):
    """What becomes of signals near code 0, which cuts off their noise; electrons, (n,) each.

    signal_e : rising
    mean_e : expected codes less black level and dark charge
    variance_e2 : of a pixel alone, with its fixed pattern
    slope : change of the mean with the signal, and with an offset
    """

    signal_e: Array
    mean_e: Array
    variance_e2: Array
    slope: Array

    def at(self, signal_e: Array, variance_e2: Array | float) -> list[Array]:
        """Return mean, variance and slope at signals (...); beyond the last one they are the signal, `variance_e2` and 1."""
        near, beyond = signal_e < self.signal_e[-1], (signal_e, variance_e2, 1.0)
        known = (np.interp(signal_e, self.signal_e, each) for each in (self.mean_e, self.variance_e2, self.slope))
        return [np.where(near, *pair) for pair in zip(known, beyond, strict=True)]


def moments_of_codes(level_dn: Array, sigma_dn: Array) -> tuple[Array, Array, Array]:
    """Return mean and variance of the codes of normal levels, (n,) each, and the change of the mean with the level.

    A code is the level rounded, 0 or more: its mean is Σ P(level > j - ½) over j = 1, 2, …, its mean square Σ (2j - 1) P, exactly.
    The sums are integrals if the deviation is many codes.
    """
    reach = level_dn / sigma_dn
    density = np.exp(-(reach**2) / 2) / math.sqrt(2 * math.pi)
    mean, slope = level_dn * ndtr(reach) + sigma_dn * density, np.asarray(ndtr(reach))
    square = (level_dn**2 + sigma_dn**2) * slope + level_dn * sigma_dn * density + slope / 12
    fine = sigma_dn <= COARSE_DN
    if fine.any():
        level, sigma = level_dn[fine, None], sigma_dn[fine, None]
        j = np.arange(1.0, math.ceil(float((level + FARTHEST_SIGMAS * sigma).max())) + 1)
        away = (level - j + 0.5) / sigma
        above = ndtr(away)
        mean[fine], square[fine] = above.sum(axis=1), ((2 * j - 1) * above).sum(axis=1)
        slope[fine] = (np.exp(-(away**2) / 2) / (math.sqrt(2 * math.pi) * sigma)).sum(axis=1)
    return mean, square - mean**2, slope


def codes_of_0(chain: ImagingChain, time_s: float, darkest_e: float) -> CodesOf0 | None:
    """Return what becomes of signals near code 0; None if the noise of the darkest one does not reach it.

    Each exposure of a burst is cut off by itself.
    """
    count, p = chain.physics.exposures, chain.physics.burst(1)
    dark_e = p.dark_current_e_per_s * time_s / count
    ground_e = dark_e + p.black_level_dn / p.dn_per_e  # above code 0, of no signal in an exposure

    def variances_e2(signal_e: Array | float) -> tuple[Array, Array]:
        """Return the variance of an exposure before it is rounded, and its part that all exposures share."""
        fixed = variance_e2(p, light_e=signal_e, dark_e=dark_e, along="pixel", is_temporal=False)
        return np.asarray(variance_e2(p, signal_e + dark_e + fixed, along="pixel", is_temporal=True)), np.asarray(fixed)

    def reach(signal_e: float) -> float:
        return ground_e + signal_e - FARTHEST_SIGMAS * math.sqrt(variances_e2(signal_e)[0])

    if reach(darkest_e / count) > 0:
        return None

    def compute() -> CodesOf0:
        # Shot noise and PRNU grow with the signal: twice as far until the noise no longer reaches code 0.
        end_e, most_e = FARTHEST_SIGMAS * math.sqrt(variances_e2(0.0)[0]) or 1.0, full_e(chain, time_s) / count
        while reach(end_e) < 0 and end_e < most_e:
            end_e *= 2
        signal_e = np.linspace(0.0, end_e, CODE_POINTS)
        whole_e2, fixed_e2 = variances_e2(signal_e)
        level_dn, sigma_dn = p.dn_per_e * (ground_e + signal_e), np.maximum(p.dn_per_e * np.sqrt(whole_e2), LEAST)
        mean_dn, variance_dn2, slope = moments_of_codes(level_dn, sigma_dn)
        shared_e2 = (count - 1) * slope**2 * fixed_e2  # between the exposures, to first order
        alone_e2 = variance_dn2 / p.dn_per_e**2
        return CodesOf0(count * signal_e, count * (mean_dn / p.dn_per_e - ground_e), count * (alone_e2 + shared_e2), slope)

    return chain.facts.kept(("codes of 0", time_s, p.gain_db, count, *chain.pixel_key), compute)


def expected_e(chain: ImagingChain, signal_e: Array, time_s: float) -> Array:
    """Return the expected electrons of a frame, as the well and the codes clip them."""
    near_0 = codes_of_0(chain, time_s, float(signal_e.min()))
    expected = signal_e if near_0 is None else near_0.at(signal_e, 0.0)[0]
    return np.minimum(expected, full_e(chain, time_s))


def _d_prime(chain: ImagingChain, time_s: float) -> float:
    """Return d′ of the ideal linear observer in the frames of a chain."""
    assert chain.without_e_per_s is not None
    p, with_e, without_e = chain.physics, chain.signal_e_per_s * time_s, chain.without_e_per_s * time_s
    difference = with_e - without_e
    # The mean variance of both: that of the mean signal, and of what grows with the square of it half of the difference squared.
    spread = float(np.mean(variance_e2(p, light_e=1.0, along="pixel"))) - float(np.mean(variance_e2(p, along="pixel")))
    variance = variance_of_pixels_e2(chain, (with_e + without_e) / 2, time_s)
    variance += spread / 4 * difference**2
    unrounded_dn2 = p.dn_per_e**2 * float(variance.min()) - p.rounding_variance_dn2
    sigma_dn = math.sqrt(max(unrounded_dn2, 0.0) / p.exposures)  # of an exposure, before it is rounded
    if sigma_dn < LEAST_SIGMA_DN:
        got = f"noise of {sigma_dn:.2g} DN in pixels of {p.pitch_um:g} µm, which the ADC rounds away"
        hint = "Take more bits (pixel.bits) or more gain (exposure.gain_db)."
        allowed = f"at least {LEAST_SIGMA_DN:g} DN, so that rounding is noise"
        raise NoNumberError(str(invalid("the metric detectability", got, allowed, hint)))
    near_0 = codes_of_0(chain, time_s, min(float(with_e.min()), float(without_e.min())))
    if near_0 is not None:
        first, second = (near_0.at(each, variance) for each in (with_e, without_e))
        _, variance, slope = np.add(first, second) / 2
        # An offset of a row or a column comes through by the slope.
        difference, variance = (first[0] - second[0]) / slope, variance / slope**2
    for signal_e in (with_e, without_e):
        if clips(chain, signal_e.max(), time_s):
            variance[clips(chain, signal_e, time_s)] = np.inf
    of_lines = [float(np.mean(variance_e2(p, along=along))) for along in ("column", "row")]
    return detectability(difference, variance, column_variance=of_lines[0], row_variance=of_lines[1])


def _detectability(judged: Judged) -> tuple[float, float, float]:
    options = judged.options.detectability
    each = [_d_prime(chain, judged.time_s(chain)) for chain in judged.chains(options.registrations)]
    mean = float(np.mean(each))
    return mean, min(each), min(options.threshold / mean, FARTHEST) if mean else FARTHEST


def needs_target(asked: MetricContext) -> str:
    """Return what a metric of a target lacks."""
    if asked.has_without:
        return ""
    stated = setting("metric.detectability.without")
    return f"light of the scene without its target: {stated}, or without=… of evaluate, sweep and study"


DETECTABILITY = Metric(
    name="detectability",
    title="detectability d′",
    unit="",
    better="more",
    judges="raw frame",
    source="Barrett & Myers, Foundations of Image Science (2004), 13.2.12; seen at 5: Rose, J. Opt. Soc. Am. 38 (1948) 196",
    unseen="unknown positions of the target, clutter, corrections of the frame, and the display",
    columns=("detectability", "least_detectability", "contrast_factor_at_threshold"),
    bounds=(0.0, FARTHEST),
    compute=_detectability,
    worst=("least_detectability",),
    lacks=needs_target,
    needs_light=True,
)


OF_TARGETS = "detectability", "npwe"  # that ask for the light of the scene without its target


def has_target(metrics: Sequence[str]) -> bool:
    """Return whether some metrics, by their names, ask for the light of the scene without its target."""
    return any(name in metrics for name in OF_TARGETS)


def grey(asked: MetricContext) -> str:
    """Return what a metric of monochrome sensors lacks."""
    return "a pixel without colour filters (pixel.colour)" if asked.is_colour else ""


def grey_at_a_distance(asked: MetricContext) -> str:
    """Return what a metric of the ground lacks, seen by monochrome sensors."""
    stated = f"the distance of the ground: {setting('camera.object_distance_m')}, or {setting('metric.niirs.ground_distance_m')}"
    return grey(asked) or ("" if asked.has_distance else stated)


def sensor_terms(chain: ImagingChain) -> tuple[Array, dict[str, Array]]:
    """Return frequencies in cycles/mm on the sensor, and the MTF of each term up to it along an axis; the same for all frames."""

    def compute() -> tuple[Array, dict[str, Array]]:
        facts, physics = chain.facts, chain.physics
        along = np.linspace(0.0, HIGHEST_CY_PER_PX * 1e3 / physics.read_pitch_um, TABLE_POINTS)
        return along, of_sensor(mtf_terms(facts.mean, facts.camera, physics, chain.screen.display, along))

    return chain.facts.kept(("terms", *chain.pixel_key), compute)


def sensor_mtf(chain: ImagingChain, across: Array, down: Array, *, with_lens: bool = True) -> Array:
    """Return the MTF from scene to sensor at frequencies along x and y, which broadcast, in cycles/mm on the sensor.

    Blur by the lens and by diffusion is taken as that of the axis in all directions.

    Motion counts as a path of its own direction.

    with_lens : whether the lens counts, and not the pixel alone
    """
    along, terms = sensor_terms(chain)
    path_mm = 1e-3 * np.array(chain.moving.path_um)
    found: Array = (
        np.sinc(path_mm[0] * down + path_mm[1] * across)
        if path_mm.any()
        else np.ones(np.broadcast_shapes(across.shape, down.shape))
    )
    for name, values in terms.items():
        if not with_lens and name in LENSES:
            continue
        at = (np.hypot(across, down),) if name in RADIAL else (np.abs(across), np.abs(down))
        for frequency in at:
            found = found * np.interp(frequency, along, values, right=0.0)
    return found


def scene_power(chain: ImagingChain, options: Information) -> tuple[Array, Array, Array]:
    """Return frequencies of an axis (n,), and what pixels see of the scene's spectrum and of its aliases, (n, n), in mm².

    Over the squared mean signal: the same for all frames.
    """

    def compute() -> tuple[Array, Array, Array]:
        pitch_um = chain.physics.read_pitch_um
        axis = np.linspace(-500.0 / pitch_um, 500.0 / pitch_um, POINTS)
        corner = options.corner_cy_per_mm or 1 / chain.facts.camera.die_mm
        level = options.contrast**2 / (2 * math.pi * math.log(2))  # of an octave: 2π C ln 2
        of_scene = options.spectrum == "scene"

        def power(down: Array, across: Array) -> Array:
            radius = np.hypot(down, across)
            # The scene's own picture is one behind the lens.
            own = np.interp(radius, *chain.facts.spectrum, right=0.0) if of_scene else natural_spectrum(radius, level, corner)
            return np.asarray(own * sensor_mtf(chain, across, down, with_lens=not of_scene) ** 2)

        return axis, power(axis[:, None], axis), folded_spectrum(power, axis, pitch_um, ORDERS)

    return chain.facts.kept(("power", options.content_hash, chain.moving.path_um, *chain.pixel_key), compute)


class Veiled(NamedTuple):
    """What veiling glare makes of the light that pixels see: all of it, 1 and 0, without.

    kept : share of the picture's own electrons that does not stray
    stray : share of what strays in the mean of what pixels see
    """

    kept: float
    stray: float


def veiled(chain: ImagingChain) -> Veiled:
    """Return what veiling glare makes of the light of a chain."""
    facts, physics = chain.facts, chain.physics
    if not facts.camera.veiling_glare:
        return Veiled(1.0, 0.0)

    def compute() -> Veiled:
        light, weight = facts.mean, electrons_per_joule(physics, facts.mean)
        (of_kept,), (stray,) = split_by_veil(light, facts.camera, [weight])
        own, kept = (M2_PER_UM2 * float((each * light.mean_spectrum()).sum()) for each in (weight, of_kept))
        return Veiled(kept / own, stray / (kept + stray)) if own else Veiled(1.0, 0.0)

    return chain.facts.kept(("veil", *chain.pixel_key), compute)


def level_e(chain: ImagingChain, mean_e: float, time_s: float) -> tuple[float, float]:
    """Return the part of a mean level with which codes change, and the variance of a pixel at it, as code 0 leaves both."""
    variance_e2 = variance_of_pixels_e2(chain, mean_e, time_s)
    near_0 = codes_of_0(chain, time_s, mean_e)
    if near_0 is None:
        return mean_e, float(variance_e2)
    _, variance_e2, slope = near_0.at(np.array(mean_e), variance_e2)
    return float(slope) * mean_e, float(variance_e2)


def _information(judged: Judged) -> tuple[float, float]:
    """Return that of the mean level of the pixels that do not clip, for their share of the sensor."""
    chain, time_s = judged.chain, judged.frame.integration_s
    axis, power, folded = scene_power(chain, judged.options.information)
    signal_e = chain.signal_e_per_s * time_s
    told = ~clips(chain, signal_e, time_s)
    if not told.any():
        return 0.0, 0.0
    mean_e, variance_e2 = level_e(chain, float(signal_e[told].mean()), time_s)
    if judged.options.information.spectrum == "natural":  # the scene's own picture has its veil
        mean_e *= 1 - veiled(chain).stray
    noise = variance_e2 * (1e-3 * chain.physics.read_pitch_um) ** 2
    bits = float(told.mean()) * information_bits_per_mm2(axis, mean_e**2 * power, noise, mean_e**2 * folded)
    return bits, bits * (chain.facts.camera.image_distance_mm * math.radians(1.0)) ** 2


def neq_along(chain: ImagingChain, time_s: float) -> tuple[Array, Array]:
    """Return frequencies along an axis up to Nyquist, in cycles/mm, and the NEQ of the mean level there, in mm⁻².

    Signal, noise and MTF are those of the metric information, of the pixels that do not clip; NaN where all of them do.
    """
    frequency, signal_e = np.linspace(0.0, 500.0 / chain.physics.read_pitch_um, POINTS), chain.signal_e_per_s * time_s
    told = ~clips(chain, signal_e, time_s)
    if not told.any():
        return frequency, np.full(POINTS, np.nan)
    mean_e, variance_e2 = level_e(chain, float(signal_e[told].mean()), time_s)
    noise = variance_e2 * (1e-3 * chain.physics.read_pitch_um) ** 2
    return frequency, neq(np.abs(sensor_mtf(chain, frequency, np.zeros(1))), noise, mean_e * (1 - veiled(chain).stray))


INFORMATION = Metric(
    name="information",
    title="information",
    unit="bit/mm²",
    better="more",
    judges="raw frame",
    source="Fales & Huck, Information Sciences 57-58 (1991) 245: ½∬ log₂(1 + S|T|²/(N + A))",
    unseen="what is in the picture: noise of the mean level counts everywhere, offsets of whole rows and columns nowhere; "
    "and corrections of the frame",
    columns=("information", "information_bits_per_deg2"),
    bounds=(0.0, 1e15),
    compute=_information,
    lacks=grey,
    needs_light=True,
)


def _mtf_along(chain: ImagingChain, along: Array | None = None) -> tuple[Array, Array]:
    """Return frequencies in cycles/mm, and the MTF from scene to sensor along the axis of the longer path of what moves."""
    along = sensor_terms(chain)[0] if along is None else along
    down, across = map(abs, chain.moving.path_um)
    return along, np.abs(sensor_mtf(chain, along, np.zeros(1)) if across >= down else sensor_mtf(chain, np.zeros(1), along))


def _mtf50(judged: Judged) -> tuple[float]:
    along, mtf = _mtf_along(judged.chain)
    if path_um := judged.chain.moving.longest_um:  # before the first zero of a long path, which the table may leave out
        along, mtf = _mtf_along(judged.chain, np.linspace(0.0, min(float(along[-1]), 1e3 / path_um), TABLE_POINTS))
    found = mtf50(along, mtf)
    return (float(along[-1]) if found is None else found,)


MTF50 = Metric(
    name="mtf50",
    title="MTF50 on the sensor",
    unit="cy/mm",
    better="more",
    judges="raw frame",
    source="ISO 12233: the frequency at which the response of lens and pixel has fallen to one half",
    unseen="noise, aliases and the display",
    columns=("mtf50_cy_per_mm",),
    bounds=(0.0, 1e7),
    compute=_mtf50,
    lacks=grey,
    has_optimum=False,
    needs_light=True,
)


def _snr10_lx(judged: Judged) -> tuple[float]:
    chain, options, physics = judged.chain, judged.options.snr10_lx, judged.chain.physics
    across = max(1.0, (chain.screen.dot_um or physics.read_pitch_um) / physics.read_pitch_um)
    found = snr10_lx(
        chain.white_e_per_s * options.integration_s,
        white_cd_per_m2(chain.facts.mean, chain.screen.display),
        reflectance=options.reflectance,
        dark_variance_e2=float(variance_of_pixels_e2(chain, 0.0, options.integration_s))
        # A dot is the mean of as many offsets of rows, and of columns, as pixels along its side, not as pixels.
        + across * sum(float(np.mean(variance_e2(physics, along=along))) for along in ("column", "row")),
        prnu=physics.prnu,
        pixels_per_dot=across**2,
        snr=options.snr,
        saturation_e=physics.saturation_e,
    )
    if found is None:
        got = f"pixels of {physics.pitch_um:g} µm, which have it in no light"
        allowed = f"pixels that reach an SNR of {options.snr:g} per dot"
        raise NoNumberError(str(invalid("the metric snr10_lx", got, allowed, "Lower metric.snr10_lx.snr.")))
    return (found,)


SNR10_LX = Metric(
    name="snr10_lx",
    title="illuminance for the SNR wanted, 10 unless it is set",
    unit="lx",
    better="less",
    judges="shown picture",
    source="Alakarhu, International Image Sensor Workshop (2007), per dot of the display",
    unseen="sharpness, colour, corrections and development of the frame, and all levels but one",
    columns=("snr10_lx",),
    bounds=(0.0, 1e15),
    compute=_snr10_lx,
    lacks=grey,
    has_optimum=False,
    needs_light=True,
)


def _niirs(judged: Judged) -> tuple[float]:
    chain, options, time_s = judged.chain, judged.options.niirs, judged.frame.integration_s
    physics, camera = chain.physics, chain.facts.camera
    along, mtf = _mtf_along(chain)
    rer = relative_edge_response(along * 1e-3 * physics.read_pitch_um, mtf)
    veil = veiled(chain)
    stray_e = veil.stray * float(chain.signal_e_per_s.mean()) * time_s
    white_e = veil.kept * chain.white_e_per_s * time_s
    darker_e, brighter_e = (white_e * reflectance + stray_e for reflectance in sorted(options.reflectances))
    if brighter_e >= (most_e := full_e(chain, time_s)):
        got = f"{brighter_e:.3g} e- of the brighter surface in pixels of {physics.pitch_um:g} µm, full at {most_e:.3g} e-"
        allowed = "surfaces that the frame tells apart"
        raise NoNumberError(str(invalid("the metric niirs", got, allowed, "Expose it for less time.")))
    noise_e2 = float(variance_of_pixels_e2(chain, brighter_e, time_s))
    noise_e2 += sum(float(np.mean(variance_e2(physics, along=along))) for along in ("column", "row"))
    distance_m = options.ground_distance_m
    reduction = 1 / abs(camera.magnification) if distance_m is None else 1e3 * distance_m / camera.image_distance_mm
    ground_m = 1e-6 * physics.read_pitch_um * reduction
    return (niirs(rer, ground_m, (brighter_e - darker_e) / math.sqrt(noise_e2)),)


NIIRS = Metric(
    name="niirs",
    title="NIIRS",
    unit="",
    better="more",
    judges="raw frame",
    source="General Image Quality Equation 5, NGA (2015)",
    unseen="aliases, clipping, corrections, haze; fitted to pictures from above of 0.2 to 1.3 relative edge response",
    columns=("niirs",),
    bounds=(-1e3, 1e3),
    compute=_niirs,
    lacks=grey_at_a_distance,
    needs_light=True,
)
