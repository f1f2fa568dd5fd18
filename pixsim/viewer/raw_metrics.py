"""Metrics of the raw frame, from its expected signal and its closed-form variance: none of them needs a drawn frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.photodiode import saturation_level_e
from pixsim.viewer.display import white_cd_per_m2
from pixsim.viewer.judges.information_density import folded_spectrum, information_bits_per_mm2, natural_spectrum
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
NOTHING_SEEN = 0.0  # of NIIRS: interpretability is precluded
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


def range_e(chain: ImagingChain, time_s: float) -> tuple[float, float]:
    """Return the ends of the signals that neither the well nor the codes clip, in electrons."""
    p = chain.physics
    dark_e = p.dark_current_e_per_s * time_s
    top_e = (p.top_code_dn - p.black_level_dn) / p.dn_per_e - dark_e  # `frame_mean_dn` is linear
    return -p.black_level_dn / p.dn_per_e - dark_e, min(saturation_level_e(time_s, p) - dark_e, top_e)


def clips(chain: ImagingChain, signal_e: Array, time_s: float) -> NDArray[np.bool_]:
    """Return which pixels of an expected signal are at an end of the well or of the codes."""
    empty_e, full_e = range_e(chain, time_s)
    return np.logical_or(signal_e >= full_e, signal_e <= empty_e)


def within_range_e(chain: ImagingChain, signal_e: Array, time_s: float) -> Array:
    """Return an expected signal, clipped as the well and the codes clip it."""
    return np.clip(signal_e, *range_e(chain, time_s))


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
    for signal_e in (with_e, without_e):
        ends = np.array([signal_e.min(), signal_e.max()])
        if clips(chain, ends, time_s).any():
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
    return f"light of the scene without its target: {setting('metric.detectability.without')}, or without=… of evaluate and sweep"


DETECTABILITY = Metric(
    name="detectability",
    title="detectability d′",
    unit="",
    better="more",
    judges="raw frame",
    source="Barrett & Myers, Foundations of Image Science (2004), 13.2.12; seen at 5: Rose, J. Opt. Soc. Am. 38 (1948) 196",
    unseen="unknown positions of the target, clutter, noise cut off at code 0, corrections of the frame, and the display",
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


def _information(judged: Judged) -> tuple[float, float]:
    """Return that of the mean level of the pixels that do not clip, for their share of the sensor."""
    chain, time_s = judged.chain, judged.frame.integration_s
    axis, power, folded = scene_power(chain, judged.options.information)
    signal_e = chain.signal_e_per_s * time_s
    told = ~clips(chain, signal_e, time_s)
    if not told.any():
        return 0.0, 0.0
    mean_e = float(signal_e[told].mean())
    noise = float(variance_of_pixels_e2(chain, mean_e, time_s)) * (1e-3 * chain.physics.read_pitch_um) ** 2
    bits = float(told.mean()) * information_bits_per_mm2(axis, mean_e**2 * power, noise, mean_e**2 * folded)
    return bits, bits * (chain.facts.camera.image_distance_mm * math.radians(1.0)) ** 2


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
    if path_um := max(map(abs, judged.chain.moving.path_um)):  # before the first zero of a long path, which the table may leave out
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
    darker_e, brighter_e = (chain.white_e_per_s * time_s * reflectance for reflectance in sorted(options.reflectances))
    if clips(chain, np.array(brighter_e), time_s):
        return (NOTHING_SEEN,)
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
    lacks=grey,
    needs_light=True,
)
