"""Metrics of the raw frame, from its expected signal and its closed-form variance: none of them needs a drawn frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.photodiode import saturation_level_e
from pixsim.sensor.readout import frame_mean_dn
from pixsim.viewer.display import white_cd_per_m2
from pixsim.viewer.judges.information_density import folded_spectrum, information_bits_per_mm2, natural_spectrum
from pixsim.viewer.judges.interpretability import niirs, relative_edge_response
from pixsim.viewer.judges.linear_observer import detectability
from pixsim.viewer.judges.sharpness import mtf50
from pixsim.viewer.judges.snr_illuminance import snr10_lx
from pixsim.viewer.metrics import Asked, Metric
from pixsim.viewer.mtf import mtf_terms, of_sensor

if TYPE_CHECKING:
    from pixsim.viewer.judged import Judged
    from pixsim.viewer.score import ImagingChain

LEAST_SIGMA_DN = 0.5  # below it quantisation is no noise, and no observer is linear in it
POINTS = 65  # frequencies on an axis of the Nyquist square
ORDERS = 2  # of aliases
LENSES = ("lens", "real lens")
RADIAL = (*LENSES, "diffusion")  # terms of the MTF; the others are products of both axes
TABLE_POINTS = 2049


def variance_of_pixels_e2(chain: ImagingChain, signal_e: Array | float, time_s: float) -> Array:
    """Return the variance that a pixel has alone, with its fixed pattern and the quantisation, in the shape of the signal."""
    p = chain.physics
    dark_e = p.dark_current_e_per_s * time_s
    alone = variance_e2(p, signal_e + dark_e, light_e=signal_e, dark_e=dark_e, along="pixel")
    return np.asarray(alone + 1 / (12 * p.dn_per_e**2))


def clips(chain: ImagingChain, signal_e: Array, time_s: float) -> NDArray[np.bool_]:
    """Return which pixels of an expected signal are at an end of the well or of the codes."""
    p = chain.physics
    mean_dn = frame_mean_dn(signal_e, time_s, p)
    full = signal_e + p.dark_current_e_per_s * time_s >= saturation_level_e(time_s, p)
    return np.any([full, mean_dn >= 2**p.pixel.bits - 1, mean_dn <= 0], axis=0)


def _d_prime(chain: ImagingChain, time_s: float) -> float:
    """Return d′ of the ideal linear observer in the frames of a chain."""
    assert chain.without_e_per_s is not None
    p, levels = chain.physics, (chain.signal_e_per_s * time_s, chain.without_e_per_s * time_s)
    variance = (variance_of_pixels_e2(chain, levels[0], time_s) + variance_of_pixels_e2(chain, levels[1], time_s)) / 2
    sigma_dn = p.dn_per_e * math.sqrt(float(variance.min()))
    if sigma_dn < LEAST_SIGMA_DN:
        got = f"noise of {sigma_dn:.2g} DN, which the ADC rounds away"
        hint = "Take more bits (pixel.bits), or fewer electrons per code."
        raise invalid("the metric detectability", got, f"at least {LEAST_SIGMA_DN:g} DN, so that rounding is noise", hint)
    variance[clips(chain, levels[0], time_s) | clips(chain, levels[1], time_s)] = np.inf
    of_lines = [float(np.mean(variance_e2(p, along=along))) for along in ("column", "row")]
    return detectability(levels[0] - levels[1], variance, column_variance=of_lines[0], row_variance=of_lines[1])


def _detectability(judged: Judged) -> tuple[float, float]:
    options = judged.options.detectability
    each = [_d_prime(chain, judged.time_s(chain)) for chain in judged.chains(options.registrations)]
    return float(np.mean(each)), min(each)


def _needs_target(asked: Asked) -> str:
    return "" if asked.has_without else "light of the scene without its target: metric.detectability.without"


DETECTABILITY = Metric(
    name="detectability",
    title="detectability d′",
    unit="",
    better="more",
    judges="raw frame",
    source="Barrett & Myers, Foundations of Image Science (2004), 13.2.12; seen at 5: Rose, J. Opt. Soc. Am. 38 (1948) 196",
    unseen="unknown positions of the target, clutter, corrections of the frame, and what becomes of it on a display",
    columns=("detectability", "least_detectability"),
    bounds=(0.0, 1e12),
    compute=_detectability,
    lacks=_needs_target,
    needs_light=True,
)


def _grey(asked: Asked) -> str:
    return "a pixel without colour filters (pixel.colour)" if asked.is_colour else ""


def sensor_mtf(chain: ImagingChain, across: Array, down: Array, *, with_lens: bool = True) -> Array:
    """Return the MTF from scene to sensor at frequencies along x and y, which broadcast, in cycles/mm on the sensor.

    Blur by the lens and by diffusion is taken as that of the axis in all directions.

    with_lens : whether the lens counts, and not the pixel alone
    """
    facts, physics = chain.facts, chain.physics
    highest = math.sqrt(2) * float(max(np.abs(across).max(), np.abs(down).max()))
    along = np.linspace(0.0, highest, TABLE_POINTS)
    terms = of_sensor(mtf_terms(facts.mean, facts.camera, physics, chain.screen.display, along))
    found: Array = np.ones(np.broadcast_shapes(across.shape, down.shape))
    for name, values in terms.items():
        if not with_lens and name in LENSES:
            continue
        at = (np.hypot(across, down),) if name in RADIAL else (np.abs(across), np.abs(down))
        for frequency in at:
            found = found * np.interp(frequency, along, values)
    return found


def _information(judged: Judged) -> tuple[float, float]:
    chain, options, time_s = judged.chain, judged.options.information, judged.frame.integration_s
    pitch_um = chain.physics.read_pitch_um
    mean_e = float(chain.signal_e_per_s.mean()) * time_s
    noise = float(variance_of_pixels_e2(chain, mean_e, time_s)) * (1e-3 * pitch_um) ** 2
    axis = np.linspace(-500.0 / pitch_um, 500.0 / pitch_um, POINTS)
    corner = options.corner_cy_per_mm or 1 / chain.facts.camera.die_mm
    level = (options.contrast * mean_e) ** 2 / (2 * math.pi * math.log(2))  # of an octave: 2π C ln 2

    of_scene = options.spectrum == "scene"
    facts = chain.facts

    def power(down: Array, across: Array) -> Array:
        radius = np.hypot(down, across)
        # The scene's own picture is one behind the lens.
        own = mean_e**2 * np.interp(radius, *facts.spectrum, right=0.0) if of_scene else natural_spectrum(radius, level, corner)
        return np.asarray(own * sensor_mtf(chain, across, down, with_lens=not of_scene) ** 2)

    folded = folded_spectrum(power, axis, pitch_um, ORDERS)
    bits = information_bits_per_mm2(axis, power(axis[:, None], axis), noise, folded)
    return bits, bits * (facts.camera.image_distance_mm * math.radians(1.0)) ** 2


INFORMATION = Metric(
    name="information",
    title="information",
    unit="bit/mm²",
    better="more",
    judges="raw frame",
    source="Fales & Huck, Information Sciences 57-58 (1991) 245: ½∬ log₂(1 + S|T|²/(N + A))",
    unseen="what is in the picture: noise of the mean level counts everywhere, and offsets of whole rows and columns nowhere",
    columns=("information", "information_bits_per_deg2"),
    bounds=(0.0, 1e15),
    compute=_information,
    lacks=_grey,
    needs_light=True,
)


def _mtf_along(chain: ImagingChain, frequency: Array) -> Array:
    return sensor_mtf(chain, frequency, np.zeros(1))


def _mtf50(judged: Judged) -> tuple[float]:
    highest = 2e3 / judged.chain.physics.aperture_side_um  # beyond the aperture's second zero
    frequency = np.linspace(0.0, highest, TABLE_POINTS)
    found = mtf50(frequency, np.abs(_mtf_along(judged.chain, frequency)))
    return (highest if found is None else found,)


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
    lacks=_grey,
    has_optimum=False,
    needs_light=True,
)


def _snr10_lx(judged: Judged) -> tuple[float]:
    chain, options, physics = judged.chain, judged.options.snr10_lx, judged.chain.physics
    dot_um = chain.screen.dot_um or physics.read_pitch_um
    found = snr10_lx(
        chain.white_e_per_s * options.integration_s,
        white_cd_per_m2(chain.facts.mean, chain.screen.display),
        reflectance=options.reflectance,
        dark_variance_e2=float(variance_of_pixels_e2(chain, 0.0, options.integration_s))
        + sum(float(np.mean(variance_e2(physics, along=along))) for along in ("column", "row")),
        prnu=physics.prnu,
        pixels_per_dot=(dot_um / physics.read_pitch_um) ** 2,
        snr=options.snr,
        saturation_e=physics.saturation_e,
    )
    if found is None:
        got = f"pixels of {physics.pitch_um:g} µm, which have it in no light"
        raise invalid(
            "the metric snr10_lx", got, f"pixels that reach an SNR of {options.snr:g} per dot", "Lower metric.snr10_lx.snr."
        )
    return (found,)


SNR10_LX = Metric(
    name="snr10_lx",
    title="illuminance for an SNR of 10",
    unit="lx",
    better="less",
    judges="shown picture",
    source="Alakarhu, International Image Sensor Workshop (2007), per dot of the display",
    unseen="sharpness, colour, and all levels but one",
    columns=("snr10_lx",),
    bounds=(0.0, 1e15),
    compute=_snr10_lx,
    lacks=_grey,
    has_optimum=False,
    needs_light=True,
)


def _niirs(judged: Judged) -> tuple[float]:
    chain, options, time_s = judged.chain, judged.options.niirs, judged.frame.integration_s
    physics, camera = chain.physics, chain.facts.camera
    frequency = np.linspace(0.0, 4e3 / physics.read_pitch_um, TABLE_POINTS)
    rer = relative_edge_response(frequency * 1e-3 * physics.read_pitch_um, np.abs(_mtf_along(chain, frequency)))
    darker_e, brighter_e = (chain.white_e_per_s * time_s * reflectance for reflectance in sorted(options.reflectances))
    noise_e2 = float(variance_of_pixels_e2(chain, brighter_e, time_s))
    noise_e2 += sum(float(np.mean(variance_e2(physics, along=along))) for along in ("column", "row"))
    ground_m = options.ground_m or 1e-6 * physics.read_pitch_um / abs(camera.magnification)
    return (niirs(rer, ground_m, (brighter_e - darker_e) / math.sqrt(noise_e2)),)


NIIRS = Metric(
    name="niirs",
    title="NIIRS",
    unit="",
    better="more",
    judges="raw frame",
    source="General Image Quality Equation 5, NGA (2015)",
    unseen="aliases, motion and haze; fitted to pictures from above of 0.2 to 1.3 relative edge response",
    columns=("niirs",),
    bounds=(-1e3, 1e3),
    compute=_niirs,
    lacks=_grey,
    needs_light=True,
)
