"""Closed forms of pixels, silicon, noise, readout, exposure and motion: a row each."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.claims import Claim
from helpers.closed_forms import charge_to_e, constant_diode_charge_e, spice_ff
from scipy.constants import e as electron, k as boltzmann
from scipy.integrate import quad
from scipy.stats import logistic, norm

from pixsim import Camera, Correction, Exposure, Pixel
from pixsim.light.spectral import d65, luminous_weight, photons_per_joule
from pixsim.sensor.camera_data import _TYPICAL_NM, _TypicalFilters, camera_sensitivities, cameras
from pixsim.sensor.code_moments import moments_of_codes
from pixsim.sensor.colour import Layout, channel_map
from pixsim.sensor.correction import _rounding_e, outliers, residual_variance_e2, without_defects
from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, diffusion_mtf
from pixsim.sensor.dynamic_range import levels_of_light_e, makers_range_db, readout_snr_db
from pixsim.sensor.flicker import burst_modulation, clipped_light
from pixsim.sensor.integration import diffusion_of, first_edge_um, pixel_count, pixels_on
from pixsim.sensor.mismatch import (
    E_PER_FC,
    DarkSpread,
    dark_current_of_geometry_e_per_s,
    follower_offset_e,
    prnu_of_area,
)
from pixsim.sensor.motion import (
    ImageMotion,
    LightSpectrum,
    _SlantedSpectrum,
    border_with_motion_um,
    motion_in_frame,
    motion_margin_um,
    shifted_rows,
    velocity_um_per_s,
)
from pixsim.sensor.motion_options import NO_MOTION, Motion
from pixsim.sensor.noise import signal_at_snr_e, variance_e2, variances_e2, without_source
from pixsim.sensor.photodiode import (
    charge_from_total_e,
    collected_charge_e,
    default_diode,
    diode_of,
    linear_limit_e,
    stored_signal_e,
)
from pixsim.sensor.pixel import (
    WELL_REFERENCE_S,
    PixelPhysics,
    derive,
    diode_full_v,
    fill_factor_law,
    junction_charge_fc,
    junction_ff,
    mean_junction_ff,
    photodiode_capacitances_ff,
    pitch_for_fill_factor_um,
    reset_noise_e,
    response_curve,
    silicon_curve,
    smallest_pitch_um,
    spread_registration,
)
from pixsim.sensor.reading import Adc, Readout, dark_spread_e, least_black_level_dn, with_merge
from pixsim.sensor.readout import (
    _draw_summed_codes,
    frame_mean_dn,
    frame_variance_dn2,
    integration_time_s,
    quantise,
    with_shared_time,
)
from pixsim.sensor.saturation import (
    CLIP_REACH,
    _node_counts,
    clipped_moments,
    full_well_for_e,
    level_moments,
    saturation_capacity_e,
)
from pixsim.sensor.technology import load_technology, with_fill_factor_law

T035 = load_technology("0.35um")
SIGNAL_E, TIME_S = 15_000.0, 0.1
# Each number is a different one, so that a term with another's factor shows.
NOISY = {
    "technology": "none",
    "pitch_um": 2.0,
    "full_well_e": 40_000.0,
    "quantum_efficiency": 0.5,
    "dark_current_e_per_s": 60_000.0,
    "read_noise_e": 30.0,
    "read_noise_after_gain_e": 80.0,
    "row_noise_e": 20.0,
    "prnu": 0.02,
    "dsnu": 0.3,
    "offset_fpn": 0.004,
    "column_fpn": 0.002,
    "bits": 14,
    "black_level_dn": 1000.0,
}
DARK_E = 6000.0
HOT = {"hot_pixel_fraction": 0.03, "hot_pixel_median": 5.0, "hot_pixel_spread": 0.4}
# Mean current of hot pixels over that of the others, and the others' over the mean of all.
HOT_MEAN = 5 * math.exp(0.4**2 / 2)
ORDINARY = 1 / (0.97 + 0.03 * HOT_MEAN)


def physics(**over) -> PixelPhysics:
    return derive(Pixel(**NOISY | over))


def readout(*, exposure: Exposure | None = None, **over) -> Readout:
    return Readout.of(physics(**over), exposure)


def maker_db(reading: Readout, integration_s: float) -> float:
    return makers_range_db(reading, integration_s, rounding=False)


def snr_db(reading: Readout, charge_e: float, integration_s: float) -> float:
    return float(readout_snr_db(reading, charge_e, integration_s, rounding=False))


def pixel_035(**options) -> PixelPhysics:
    return derive(Pixel(pitch_um=6.5, **options), T035)


SPREADS = [
    Claim("PRNU falls with the side", lambda: prnu_of_area(0.02, 4.0), 0.01, rtol=1e-14),
    Claim(
        "5 mV µm on 0.25 µm² are 10 mV, on 1.6 fF 100 e-",
        lambda: follower_offset_e(5.0, 0.25, electron * 1e19),
        100.0,
        rtol=1e-12,
    ),
    Claim(
        "1 nA/cm² on 4 µm² and as much per edge of a square of 2 µm",
        lambda: dark_current_of_geometry_e_per_s(1.0, 1e-4, 4.0, 8.0),
        4e-17 / electron * 3,
        rtol=1e-13,
    ),
    Claim(
        "10 % at 11 times the ordinary current leave the others half",
        lambda: DarkSpread(0.0, 0.1, 11.0, 0.0).ordinary_mean,
        0.5,
        rtol=1e-14,
    ),
    Claim(
        "variance with hot pixels",
        lambda: DarkSpread(0.3, 0.03, 5.0, 0.4).variance,
        ORDINARY**2 * (0.97 * 1.09 + 0.03 * 25 * math.exp(2 * 0.4**2)) - 1,
        rtol=1e-12,
    ),
    Claim("deviation without hot pixels", lambda: DarkSpread(0.3).deviation, 0.3, rtol=1e-14),
    Claim(
        "deviation with hot pixels",
        lambda: DarkSpread(0.0, 0.1, 11.0).deviation,
        math.sqrt(0.9 * 0.25 + 0.1 * 30.25 - 1),
        rtol=1e-12,
    ),
]


def charge_key(kelvin: float, **more: float) -> str:
    return pixel_035(
        temperature_k=kelvin, stack={"height_um": 3.0, "index": 1.5} | more
    ).charge.content_hash


def diffusing(kelvin: float) -> float:
    """MTF of charge at 50 cy/mm and 850 nm."""
    stack = {
        "microlens": "none",
        "height_um": 3.0,
        "depletion_um": 1.0,
        "diffusion_length_um": 20.0,
    }
    mtf = diffusion_of(
        derive(Pixel(technology="4t-fsi", pitch_um=5.0, temperature_k=kelvin, stack=stack))
    )
    return float(mtf(np.array([50.0]), 850.0)[0])


SILICON = [
    Claim(
        "ranges of measured cameras and of typical filters, nm",
        lambda: sorted({entry.range_nm for entry in cameras()}),
        [(360.0, 1000.0), (380.0, 780.0)],
    ),
    Claim(
        "filters with logistic edges and a leak on 3 µm of silicon below 0.1 µm that is dead",
        lambda: _TypicalFilters(
            "", {"X": ((0.8, 500, 10, 600, 20), (0.5, 800, 15, 9e3, 1))}, 3.0, 0.1, 0.02
        ).responses()[:, 0],
        (
            filtered := _TYPICAL_NM
            * np.exp(-0.1 * absorption_per_um(_TYPICAL_NM))
            * (1 - np.exp(-3.0 * absorption_per_um(_TYPICAL_NM)))
            * (
                0.02
                + 0.98
                * 0.8
                * logistic.cdf((_TYPICAL_NM - 500) / 10)
                * logistic.cdf((600 - _TYPICAL_NM) / 20)
                + 0.98 * 0.5 * logistic.cdf((_TYPICAL_NM - 800) / 15)
            )
        )
        / filtered.max(),
        rtol=1e-12,
    ),
    Claim(
        "absorption lengths of Green (2008), µm",
        lambda: 1 / absorption_per_um([550.0, 700.0, 850.0]),
        [1.565, 5.291, 18.73],
        rtol=1e-3,
        why="published digits",
    ),
    Claim(
        "between its points the logarithm is linear",
        lambda: absorption_per_um(555.0) ** 2,
        float(absorption_per_um(550.0) * absorption_per_um(560.0)),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"temperature coefficient of Green at {nm:g} nm, {kelvin:g} K",
            lambda nm=nm, kelvin=kelvin: absorption_per_um(nm, kelvin) / absorption_per_um(nm),
            (kelvin / 300) ** (300 * per_k),
            rtol=1e-12,
        )
        for nm, per_k in ((450.0, 28e-4), (850.0, 46e-4), (1090.0, 165e-4))
        for kelvin in (260.0, 300.0, 330.0)
    ),
    Claim("MTF, depleted throughout", lambda: diffusion_mtf(100.0, 0.5, 1e3, 20.0), 1.0, 1e-14),
    Claim("MTF, absorbed at the surface", lambda: diffusion_mtf(100.0, 1e6, 0.0, 20.0), 1.0, 1e-6),
    Claim("MTF, nothing walks", lambda: diffusion_mtf(100.0, 0.5, 1.0, 1e-9), 1.0, 1e-8),
    Claim(
        "MTF of fine detail is the share of the depletion region",
        lambda: diffusion_mtf(1e9, 0.5, 1.0, 20.0),
        (1 - math.exp(-0.5)) / (1 - math.exp(-0.5) + math.exp(-0.5) * 10.0 / 11.0),
        rtol=1e-6,
        why="L = 1.6e-7 µm is left",
    ),
    Claim(
        "MTF of light that is hardly absorbed is (L_D + L)/(L_D + L_n)",
        lambda: diffusion_mtf(50.0, 1e-12, 1.0, 20.0),
        (1.0 + 1 / math.hypot(0.1 * math.pi, 0.05)) / 21.0,
        rtol=1e-9,
    ),
    *(
        Claim(
            f"charge diffuses at {kelvin:g} K as silicon absorbs, whose 300 K stand for 27 °C",
            lambda kelvin=kelvin: diffusing(kelvin),
            float(diffusion_mtf(50.0, absorption_per_um(850.0, kelvin / 1.0005), 1.0, 20.0)),
            rtol=1e-12,
        )
        for kelvin in (300.15, 330.165)
    ),
    Claim(
        "temperature changes the key of charge that diffuses, and of no other",
        lambda: [
            charge_key(300.15, **more) == charge_key(330.0, **more)
            for more in ({}, {"depletion_um": 1.0, "diffusion_length_um": 20.0})
        ],
        [1, 0],
    ),
    Claim(
        "charge of a square of two pixels that does not spread",
        lambda: diffused_shares(2.2, 4.4, 0.64, 1e3, 20.0),
        np.outer([0, 0.25, 0.5, 0.25, 0], [0, 0.25, 0.5, 0.25, 0]),
        atol=1e-6,
        why="the square's edge on a pixel's",
    ),
    Claim(
        "charge of light absorbed at the surface stays",
        lambda: diffused_shares(2.2, 1.3, 1e9, 0.0, 20.0)[2, 2],
        1.0,
        atol=1e-8,
        why="1/α reaches further",
    ),
    Claim(
        "QE of 0.65 at 525 nm elsewhere, of 5 µm of silicon",
        lambda: derive(
            Pixel(**NOISY | {"quantum_efficiency": 0.65, "quantum_efficiency_nm": 525})
        ).quantum_efficiency([525.0, 700.0, 850.0, 940.0, 1000.0]),
        [0.65, 0.404, 0.155, 0.058, 0.021],
        rtol=0.02,
        why="worked out by hand from Green's table, two digits",
    ),
    Claim(
        "of 3 and 12 µm at 850 nm",
        lambda: [
            physics(
                quantum_efficiency=0.65,
                quantum_efficiency_nm=525,
                quantum_efficiency_depth_um=depth_um,
            ).quantum_efficiency(850.0)
            for depth_um in (3.0, 12.0)
        ],
        [0.105, 0.308],
        rtol=0.01,
        why="three digits by hand",
    ),
    Claim(
        "beyond the table of absorption: all light, and none",
        lambda: physics(quantum_efficiency=0.65, quantum_efficiency_nm=525).quantum_efficiency(
            [200.0, 300.0, 1300.0]
        ),
        np.array([1.0, 1.0, 0.0]) * 0.65 / (1 - math.exp(-5 * 0.8311)),
        rtol=1e-3,
        why="four digits of α",
    ),
]


LAMP = {"flicker_hz": 100.0, "flicker_depth": 0.6}
FLICKER = [
    *(
        Claim(
            f"light of modulation {modulation:g} clipped at {limit:g}",
            lambda limit=limit, modulation=modulation: clipped_light(limit, modulation),
            # The mean over all phases.
            quad(
                lambda phase, m=modulation, top=limit: min(1 + m * math.cos(phase), top) / math.pi,
                0,
                math.pi,
                limit=200,
            )[0],
            atol=1e-6,
            why="quadrature at the kink",
        )
        for limit, modulation in ((0.9, 0.6), (1.3, 0.6), (1.0, 1.0), (0.3, 0.6), (1.7, 0.6))
    ),
    Claim(
        "a lamp of 100 Hz keeps sinc(0.2) of its depth in 2 ms",
        lambda: burst_modulation(Exposure(frames=4, **LAMP), 0.008),
        0.6 * math.sin(0.2 * math.pi) / (0.2 * math.pi),
        rtol=1e-12,
    ),
    Claim(
        "a single exposure and steady light have no modulation in a burst",
        lambda: [
            burst_modulation(Exposure(**LAMP), 0.008),
            burst_modulation(Exposure(frames=4, **LAMP).steady, 0.008),
            burst_modulation(Exposure(frames=4).steady, 0.008),
        ],
        [0.0, 0.0, 0.0],
    ),
]


def code_moments(level: float, sigma: float, top: int) -> tuple[float, float]:
    """Mean and variance of round(N(level, σ)) clipped to 0 … top, from the definition."""
    codes = np.arange(top + 1.0)
    share = np.diff(norm.cdf(np.r_[-np.inf, codes[:-1] + 0.5, np.inf], level, sigma))
    mean = float(codes @ share)
    return mean, float((codes - mean) ** 2 @ share)


def code_slope(level: float, sigma: float, top: int) -> float:
    step = 1e-4
    above, _ = code_moments(level + step, sigma, top)
    below, _ = code_moments(level - step, sigma, top)
    return (above - below) / (2 * step)


def peak_of_clipped_variance_e(well_e: float) -> float:
    """Mean of a normal signal of that variance whose variance peaks where it clips at a well."""
    mean_e = np.linspace(0.7, 1.05, 200_001) * well_e
    x = (well_e - mean_e) / np.sqrt(mean_e)
    first = -norm.pdf(x) + x * norm.sf(x)
    second = norm.cdf(x) - x * norm.pdf(x) + x**2 * norm.sf(x)
    return float(mean_e[np.argmax(mean_e * (second - first**2))])


WELL_AND_AREA = "full_well_e", "photodiode_area_um2"
MEASURED = {
    "technology": "0.35um",
    "pitch_um": 6.5,
    "saturation_capacity_e": 1000.0,
    "prnu_um": 0.3,
}
SHEET_WITHOUT_WELL = {
    "technology": "none",
    "pitch_um": 4.0,
    "quantum_efficiency": 0.5,
    "dark_current_e_per_s": 5.0,
    "read_noise_e": 30.0,
    "bits": 12,
}


def capacity_again_e(**fields) -> float:
    """Saturation capacity of a pixel's well, ADC and noise, which were solved for a stated one."""
    reading = Readout.of(derive(Pixel(**fields)))
    return saturation_capacity_e(
        reading.full_well_e,
        reading.adc_range_e if "gain_e_per_dn" in fields else None,
        math.hypot(reading.physics.reset_noise_e, reading.read_noise_e),
        reading.prnu,
        math.hypot(
            reading.physics.offset_fpn_e, reading.physics.number("column_fpn") * reading.full_well_e
        ),
    )


LEVELS = np.linspace(-20.0, 20.0, 41)
FIRST, SECOND = clipped_moments(LEVELS, 3.0, 0.0)
CODES = [
    Claim(
        f"{name} of codes at {level:g} ± {sigma:g} of 0 … {top}",
        lambda part=part, level=level, sigma=sigma, top=top: moments_of_codes(
            np.array([level]), np.array([sigma]), top
        )[part][0],
        expected,
        rtol=tolerance,
        why="1/(24 σ²) of integrals in place of sums; a difference of 1e-4" if sigma > 8 else "",
    )
    for level, sigma, top, tolerance in (
        (0.3, 0.7, 255, 1e-6),
        (-2.0, 3.0, 255, 1e-6),
        (254.2, 1.1, 255, 1e-6),
        (7.0, 6.0, 15, 1e-6),
        (3.0, 20.0, 1023, 2e-3),
        (1010.0, 20.0, 1023, 2e-3),
        (20.0, 20.0, 60, 4e-3),
    )
    for part, (name, expected) in enumerate(
        zip(
            ("mean", "variance", "slope"),
            (*code_moments(level, sigma, top), code_slope(level, sigma, top)),
            strict=True,
        )
    )
] + [
    Claim(
        "half to even, clipped to 10 bits",
        lambda: quantise(np.array([-1e9, -0.5, 0.5, 1.5, 2.5, 2.5000001, 1022.5, 1e12]), 10),
        [0, 0, 0, 2, 2, 3, 1022, 1023],
    ),
    Claim(
        "moments of a normal level clipped at its mean",
        lambda: np.ravel(clipped_moments(np.zeros(1), 3.0, 0.0)),
        [-3 / math.sqrt(2 * math.pi), 4.5],
        rtol=1e-14,
    ),
    Claim(
        "far below the clip a normal level, far above it the clip",
        lambda: clipped_moments(np.array([-50.0, 50.0]), 3.0, 2.0),
        [[-50.0, 2.0], [2509.0, 4.0]],
        rtol=1e-14,
    ),
    Claim(
        "moments of a clipped level move with the clip",
        lambda: clipped_moments(LEVELS + 7.0, 3.0, 7.0),
        np.array([FIRST + 7.0, SECOND + 14.0 * FIRST + 49.0]),
        rtol=1e-12,
        atol=1e-12,
    ),
    Claim(
        "the nearest level that counts as far from the clip joins the others",
        lambda: [
            np.diff(
                clipped_moments(
                    100.0 + side * CLIP_REACH * np.array([2.999997, 3.000003]), 3.0, 100.0
                )[0]
            )[0]
            for side in (-1, 1)
        ],
        [0.0, 0.0],
        atol=1e-4,
        why="2e-6 of 24",
    ),
    *(
        Claim(
            f"saturation capacity of a well of {well_e:g} e-: the peak of the clipped variance",
            lambda well_e=well_e: saturation_capacity_e(well_e, None, 0.0, 0.0, 0.0),
            peak_of_clipped_variance_e(well_e),
            atol=0.1 * math.sqrt(well_e),
            why="the kink of the clip lies between two of 65 nodes",
        )
        for well_e in (500.0, 300_000.0)
    ),
    # μ times the mean gain of pixels below the well, 1 + 0.6 z from 0 to W/μ.
    Claim(
        "saturation capacity of a PRNU of 60 %, far above shot noise",
        lambda: saturation_capacity_e(1e5, None, 2.0, 0.6, 0.0),
        1e5
        * (share := np.linspace(0.3, 1.0, 7001))[
            np.argmax(
                share
                * (
                    norm.cdf((1 / share - 1) / 0.6)
                    - norm.cdf(-1 / 0.6)
                    + 0.6 * (norm.pdf(1 / 0.6) - norm.pdf((1 / share - 1) / 0.6))
                )
            )
        ],
        rtol=5e-3,
        why="shot noise beside a flat peak",
    ),
    Claim(
        "nodes of gains and offsets are no wider apart than the noise, 1000 in all, 37 and 19 or more",
        lambda: [_node_counts(*sigmas) for sigmas in ((50.0, 0.0), (0.0, 30.0), (0.0, 1.0))],
        [(500, 1), (37, round(300 * math.sqrt(1000 / (37 * 300)))), (37, 19)],
    ),
    Claim(
        "an ADC that clips first takes the place of the well",
        lambda: saturation_capacity_e(1e5, 9000.0, 2.0, 0.0, 0.0),
        saturation_capacity_e(9000.0, None, 2.0, 0.0, 0.0),
        rtol=1e-3,
        why="nodes of the kink",
    ),
    Claim(
        "no well gives 10 000 e- where the ADC ends at 9000: it is left out",
        lambda: full_well_for_e(10_000.0, 9000.0, 2.0, 0.0, 0.0),
        full_well_for_e(10_000.0, None, 2.0, 0.0, 0.0),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"a full well has the saturation capacity of {capacity_e:g} e- that it was solved for",
            lambda capacity_e=capacity_e, range_e=range_e, noise=noise: saturation_capacity_e(
                full_well_for_e(capacity_e, range_e, *noise), range_e, *noise
            ),
            capacity_e,
            rtol=1e-4,
            why="as the search promises",
        )
        for capacity_e, range_e, noise in (
            (300.0, None, (2.3, 0.0, 0.0)),
            (10_500.0, None, (6.8, 0.005, 2.0)),
            (32_691.0, None, (30.0, 0.05, 0.0)),
            (10_000.0, 20_000.0, (2.0, 0.0, 0.0)),  # the ADC ends far above
            (1.0, None, (30.0, 0.3, 10.0)),  # a variance with several peaks
            (2e5, None, (5.0, 0.2, 0.0)),
        )
    ),
    *(
        Claim(
            f"a pixel has the stated saturation capacity, {name}",
            lambda fields=fields: capacity_again_e(**fields) / fields["saturation_capacity_e"],
            1.0,
            rtol=2e-4,
            why="1e-4 as the search promises, and nodes of the kink",
        )
        for name, fields in (
            (
                "with the reset noise of its well",
                {
                    "technology": "0.35um",
                    "pitch_um": 6.5,
                    "saturation_capacity_e": 1000.0,
                    "reset_noise_factor": 3.0,
                },
            ),
            ("with the PRNU of its area", MEASURED),
            (
                "with an ADC that ends at it, above the black level of its noise",
                SHEET_WITHOUT_WELL
                | {"saturation_capacity_e": 9000.0, "gain_e_per_dn": 2.35, "dsnu_e": 20.0},
            ),
        )
    ),
    Claim(
        "a well of 6.5 µm, measured with the PRNU of its area, grows with the photodiode",
        lambda: np.diff(
            [
                np.divide(*(getattr(derive(Pixel(**fields)), name) for name in WELL_AND_AREA))
                for fields in (MEASURED, MEASURED | {"pitch_um": 13.0, "data_sheet_pitch_um": 6.5})
            ]
        ),
        [0.0],
        atol=1e-9,
    ),
    Claim(
        "and without a limit by the ADC where the black level of its noise ends it before",
        lambda: (
            derive(
                Pixel(
                    **SHEET_WITHOUT_WELL,
                    saturation_capacity_e=9000.0,
                    gain_e_per_dn=2.3,
                    dsnu_e=20.0,
                )
            ).full_well_e
        ),
        full_well_for_e(9000.0, None, 30.0, 0.0, 20.0),
        rtol=1e-12,
    ),
    Claim(
        "below the top: shot noise, read noise and the spread of gains",
        lambda: level_moments(
            5000.0,
            20.0,
            1e6,
            lambda charge: charge,
            noise_e=7.0,
            gain_spread=0.01,
            offset_spread_e=3.0,
        ),
        [5020.0, 5069.0],
        rtol=1e-4,
        why="a quadrature that ends at 5 σ",
    ),
]

PITCHES_UM = {"0.5um": 8.7, "0.35um": 6.5, "0.25um": 5.3, "0.18um": 3.9}


def of_process(name: str, **options) -> PixelPhysics:
    return derive(Pixel(technology=name, pitch_um=PITCHES_UM[name], **options))


def well_charge_e(name: str) -> float:
    """Charge of the swing, by quadrature of SPICE's capacitance."""
    junction = load_technology(name).junction
    diode = diode_of(of_process(name))
    return charge_to_e(diode, junction.reset_voltage_v - junction.voltage_swing_v)


CIRCUITS = {"area_um2": 2.0}
STACK = {"height_um": 6.0, "index": 1.5, "microlens": "square"}
SHEET = {
    "pitch_um": 3.0,
    "full_well_e": 1e4,
    "read_noise_e": 2,
    "dark_current_e_per_s": 5,
    "quantum_efficiency": 0.5,
}


def of_area(physics: PixelPhysics) -> list[float]:
    return [
        physics.fill_factor,
        physics.photodiode_area_um2,
        physics.full_well_e,
        physics.dark_current_e_per_s,
        physics.reset_noise_e,
    ]


LAYOUT = [
    *(
        Claim(
            f"fill factors of Chen et al. (2000), law {law}",
            lambda law=law: fill_factor_law([5.3, 6.5, 15.0], with_fill_factor_law(T035, law)),
            [0.05, 0.30, 0.73],
            atol=tolerance,
            why="two parameters through three points",
        )
        for law, tolerance in (("technology", 0.011), ("inset", 0.03), ("inset_unlimited", 0.03))
    ),
    *(
        Claim(
            f"pitch of 5 % at {name}",
            lambda name=name: pitch_for_fill_factor_um(0.05, load_technology(name)),
            pitch_um,
            atol=0.01,
            why="the digits of the fit",
        )
        for name, pitch_um in (("0.5um", 7.57), ("0.35um", 5.3), ("0.25um", 3.79), ("0.18um", 2.73))
    ),
    *(
        Claim(
            f"the pitch of a fill factor inverts the law {law}, with {area_um2:g} µm² of circuits",
            lambda process=process, area_um2=area_um2: (
                fill_factor_law(
                    pitch_um := pitch_for_fill_factor_um(0.4, process, area_um2), process
                )
                * (1 - area_um2 / pitch_um**2)
            ),
            0.4,
            rtol=1e-12,
        )
        for law in ("technology", "inset")
        for process in [with_fill_factor_law(T035, law)]
        for area_um2 in (0.0, 30.0)
    ),
    Claim(
        "circuits of readings take their share of the fill factor, and what follows from it",
        lambda: of_area(of_process("0.35um", readout={"area_um2": 8.0})),
        of_area(
            of_process("0.35um", fill_factor=float(fill_factor_law(6.5, T035)) * (1 - 8 / 6.5**2))
        ),
        rtol=1e-12,
    ),
    Claim(
        "numbers of a sheet follow the area beside the circuits, (p² - a)/(m² - a)",
        lambda: (
            derive(
                Pixel(**SHEET | {"pitch_um": 4.0, "data_sheet_pitch_um": 3.0}, readout=CIRCUITS)
            ).full_well_e
        ),
        1e4 * (16 - 2) / (9 - 2),
        rtol=1e-12,
    ),
    Claim(
        "a process measured its efficiency without them, a sheet with them",
        lambda: [
            physics.efficiency_stack.fill_factor / physics.stack.fill_factor
            for physics in (
                derive(Pixel(technology="4t-bsi", pitch_um=1.4, readout={"area_um2": 0.49})),
                derive(Pixel(**SHEET | {"stack": STACK}, readout=CIRCUITS)),
            )
        ],
        [1 / (1 - 0.49 / 1.4**2), 1.0],
        rtol=1e-12,
    ),
    Claim(
        "no photodiode at the smallest pitch, the limit at large ones",
        lambda: fill_factor_law([smallest_pitch_um(T035), 1e6], T035),
        [0.0, T035.fill_factor_limit],
        atol=1e-9,
        why="(p0/p)²",
    ),
    *(
        Claim(
            f"mean capacitance over the swing, grading {grading:g}",
            lambda grading=grading: mean_junction_ff(2.0, 0.85, grading, 2.2, 1.0),
            quad(lambda v, m=grading: 2.0 * (1 + v / 0.85) ** -m, 1.0, 2.2)[0] / 1.2,
            rtol=1e-11,
        )
        for grading in (0.0, 0.382, 0.9)
    ),
    *(
        Claim(
            f"charge of a junction from {high_v:g} to {low_v:g} V, PB {built_in_v:g}, M {grading:g}",
            lambda high=high_v, low=low_v, pb=built_in_v, m=grading: junction_charge_fc(
                high, high - low, 3.0, pb, m
            ),
            quad(
                lambda v, pb=built_in_v, m=grading: float(junction_ff(v, 3.0, pb, m)),
                low_v,
                high_v,
                points=[-built_in_v / 2] if low_v < -built_in_v / 2 < high_v else None,
                epsrel=1e-12,
            )[0],
            rtol=1e-11,
        )
        for built_in_v, grading in ((0.4, 0.1), (0.851, 0.594))
        for high_v, low_v in ((2.2, 1.0), (2.2, -0.7), (-0.45, -0.9))
    ),
    Claim(
        "SPICE's tangent beyond FC·PB",
        lambda: junction_ff(np.array([-0.21, -0.4, -0.8]), 1.0, 0.4, 0.1),
        (1 - 0.5 * 1.1 + 0.1 * np.array([0.21, 0.4, 0.8]) / 0.4) / 0.5**1.1,
        rtol=1e-13,
    ),
    *(
        Claim(
            f"capacitance at reset of {name}",
            lambda name=name: photodiode_capacitances_ff(
                of_process(name).photodiode_area_um2, load_technology(name).junction
            )[1],
            float(spice_ff(diode_of(of_process(name)), diode_of(of_process(name)).reset_voltage_v)),
            rtol=1e-12,
        )
        for name in PITCHES_UM
    ),
    *(
        Claim(
            f"full well of {name} is the charge of its swing",
            lambda name=name: of_process(name).full_well_e,
            well_charge_e(name),
            rtol=1e-10,
        )
        for name in PITCHES_UM
    ),
    *(
        Claim(
            f"the bias falls by the swing of {name} in a full well",
            lambda name=name: diode_of(of_process(name)).drop_v(of_process(name).full_well_e),
            load_technology(name).numbers["voltage_swing_v"],
            rtol=1e-12,
        )
        for name in PITCHES_UM
    ),
    *(
        Claim(
            f"down to forward bias {name} holds {ratio:g} swings",
            lambda name=name: (
                of_process(name, well_limit="diode").full_well_e / of_process(name).full_well_e
            ),
            ratio,
            atol=0.005,
            why="the digits of the table in `diode_full_v`",
        )
        for name, ratio in (("0.5um", 2.69), ("0.35um", 2.27), ("0.25um", 2.59), ("0.18um", 2.88))
    ),
    Claim(
        "without a diode current full is where the tangent begins",
        lambda: diode_full_v(diode_of(pixel_035(well_limit="diode", dark_current_e_per_s=0))),
        -0.5 * T035.numbers["pb_v"],
    ),
    Claim(
        "√(n kTC) of 1 pF at 300 K: 402 e-, and half of the variance by soft reset",
        lambda: [reset_noise_e(1000.0, 300.0), reset_noise_e(1000.0, 300.0, 0.5)],
        math.sqrt(boltzmann * 300 * 1e-12) / electron * np.array([1, math.sqrt(0.5)]),
        rtol=1e-12,
    ),
    Claim(
        "paper: 2.6 fF + 0.22 fF/µm² and 1 V",
        lambda: pixel_035(capacitance="paper").full_well_e,
        (2.6 + 0.22 * pixel_035().photodiode_area_um2) * 1e-15 / electron,
        rtol=1e-12,
    ),
    Claim(
        "dark current of 1 nA/cm², three doublings warmer",
        lambda: pixel_035(temperature_k=324.15).dark_current_e_per_s,
        8e-17 / electron * pixel_035().photodiode_area_um2,
        rtol=1e-12,
    ),
    Claim(
        "dark current of area and perimeter, doubling together",
        lambda: (
            derive(
                Pixel(pitch_um=6.5, temperature_k=316.15),
                T035.with_numbers({"dark_current_perimeter_pa_per_cm": 2.0}, "test"),
            ).dark_current_e_per_s
        ),
        4
        / electron
        * (
            1e-17 * pixel_035().photodiode_area_um2
            + 2e-12 * 4 * pixel_035().photodiode_side_um * 1e-4
        ),
        rtol=1e-12,
    ),
    Claim(
        "offsets of followers, A_Vt/√(W L) over the swing of 1.2 V",
        lambda: pixel_035(a_vt_mv_um=8.0, follower_area_um2=0.5).offset_fpn_e,
        8e-3 / math.sqrt(0.5) / 1.2 * pixel_035().full_well_e,
        rtol=1e-12,
    ),
    Claim(
        "reset noise goes with the root of a stated well",
        lambda: pixel_035(full_well_e=2e5).reset_noise_e ** 2 / 2e5,
        pixel_035().reset_noise_e ** 2 / pixel_035().full_well_e,
        rtol=1e-12,
    ),
    Claim(
        "a stated well over the swing of 1.2 V is the capacitance",
        lambda: pixel_035(full_well_e=1e5).capacitance_ff,
        1e5 * electron / 1.2 * 1e15,
        rtol=1e-12,
    ),
    Claim(
        "a stated well scales the capacitance, and offsets with it",
        lambda: pixel_035(a_vt_mv_um=8.0, follower_area_um2=0.5, full_well_e=1e5).offset_fpn_e,
        8e-3 / math.sqrt(0.5) / 1.2 * 1e5,
        rtol=1e-12,
    ),
    Claim(
        "PRNU of 0.03 µm over the side of the photodiode",
        lambda: physics(fill_factor=0.25, pitch_um=4.0, prnu=None, prnu_um=0.03).prnu,
        0.015,
        rtol=1e-14,
    ),
    # Worked out by hand before the code; reset noise freezes at the reset voltage (11.45 fF), where
    # the mean over the swing (12.22 fF) would give 44.4 e- and 66.2 dB.
    *(
        Claim(
            f"0.35 µm at 6.5 µm, {capacitance}: {name}",
            lambda name=name, capacitance=capacitance: getattr(
                pixel_035(capacitance=capacitance), name
            ),
            expected,
            atol=tolerance,
            why="half a unit of the last digit",
        )
        for name, capacitance, expected, tolerance in (
            ("fill_factor", "mosis", 0.309, 0.002),
            ("photodiode_area_um2", "mosis", 13.1, 0.05),
            ("capacitance_ff", "mosis", 12.2, 0.05),
            ("capacitance_ff", "paper", 5.5, 0.05),
            ("full_well_e", "mosis", 91e3, 600),
            ("full_well_e", "paper", 34e3, 500),
            ("reset_noise_e", "mosis", 43.0, 0.5),
            ("reset_noise_e", "paper", 30.0, 0.5),
        )
    ),
    *(
        Claim(
            f"0.35 µm at {pitch_um:g} µm, {capacitance}: DR at 30 ms and SNR of a fifth of the well",
            lambda pitch_um=pitch_um, capacitance=capacitance: decibels(pitch_um, capacitance),
            [range_db, snr_db],
            atol=0.05,
            why="one digit; Fig. 2a of Chen et al. (2000) has 35 to 70 dB",
        )
        for pitch_um, capacitance, range_db, snr_db in (
            (6.5, "mosis", 66.5, 42.2),
            (6.5, "paper", 61.1, 37.8),
            (5.3, "paper", 58.4, 35.1),
            (15.0, "paper", 69.5, 46.3),
        )
    ),
    *(
        Claim(
            f"full well of {name} at the pitch of its sensor",
            lambda name=name, pitch_um=pitch_um: (
                derive(Pixel(technology=name, pitch_um=pitch_um)).full_well_e
            ),
            well_e,
            rtol=0.05,
            why="the density was divided by a rounded fill factor",
        )
        for name, pitch_um, well_e in (("4t-bsi", 1.4, 6000.0), ("4t-fsi", 6.0, 25_000.0))
    ),
]


DIODE = default_diode()
SHALLOW = replace(DIODE, reset_voltage_v=0.1)
CHARGES_E = np.logspace(-9, 20, 30)
CURRENTS_E_PER_S = np.logspace(-3, 17, 41)[:, None]
TIMES_S = np.array([1e-9, 1e-6, 1e-3, 0.03, 1.0, 60.0, 3600.0, 36000.0])


def level_share(name: str, share, **options) -> np.ndarray:
    """Signal level after 30 ms of a charge, both as shares of the full well."""
    reading = Readout.of(of_process(name, conversion="junction", **options))
    return (
        stored_signal_e(np.asarray(share) * reading.full_well_e, 0.03, reading)
        / reading.full_well_e
    )


def zero_bias_v(name: str) -> float:
    """Open-circuit bias of the light that discharges a photodiode to 0 V in the reference time."""
    diode = diode_of(of_process(name, well_limit="diode"))
    light_e_per_s = charge_to_e(diode, 0.0) / WELL_REFERENCE_S
    return -diode.thermal_v * math.log1p(light_e_per_s / diode.saturation_current_e_per_s)


ENDLESS = Readout.of(pixel_035(well_limit="diode", dark_current_e_per_s=0))
SHARES = np.array([0.0, 0.5, 1.0, 2.0, 1e6])
PHOTODIODES = [
    Claim(
        "the bias inverts the charge into deep forward bias",
        lambda: DIODE.charge_e(DIODE.reset_voltage_v, DIODE.drop_v(CHARGES_E)),
        CHARGES_E,
        rtol=1e-12,
    ),
    Claim(
        "open-circuit bias -V_T ln(1 + i/I_s) of dim light, and where the ratio overflows",
        lambda: [
            DIODE.open_circuit_v(1e-12),
            replace(DIODE, saturation_current_e_per_s=5e-324).open_circuit_v(1e17),
        ],
        -DIODE.thermal_v
        * np.array([1e-12 / DIODE.saturation_current_e_per_s, math.log(1e17) - math.log(5e-324)]),
        rtol=1e-6,
    ),
    Claim(
        "open-circuit bias without light, and without a diode current",
        lambda: [
            DIODE.open_circuit_v(0.0),
            replace(DIODE, saturation_current_e_per_s=0.0).open_circuit_v(1.0),
        ],
        [0.0, -math.inf],
    ),
    Claim(
        "a junction whose capacitance does not fall is constant",
        lambda: [replace(DIODE, mj=0.0, mjsw=0.0).constant, DIODE.constant],
        [1, 0],
    ),
    Claim(
        "a soft well has lost a millionth of it just beyond its linear limit",
        lambda: [
            charge_e - charge_from_total_e(np.array(charge_e / 0.03), np.array(0.03), DIODE) > 0.09
            for charge_e in linear_limit_e(DIODE, 9e4, 0.03) * np.array([1 - 1e-7, 1 + 1e-7])
        ],
        [0, 1],
    ),
    Claim(
        "dim pixels beside full ones keep their charge",
        lambda: stored_signal_e(
            np.array([1.0, 1e3, 1e6]), 0.03, Readout.of(pixel_035(well_limit="diode"))
        )[:2],
        [1.0, 1e3],
        rtol=2e-6,
        why="1e-6 of the well, at the end of the linear range",
    ),
    Claim("kT/q at 27 °C", lambda: DIODE.thermal_v, boltzmann * 300.15 / electron, rtol=1e-12),
    Claim(
        "the diode current is the dark current",
        lambda: DIODE.saturation_current_e_per_s,
        1e-17 / electron * pixel_035().photodiode_area_um2,
        rtol=1e-12,
    ),
    *(
        Claim(
            f"charge of {current:g} e-/s to {above:g} V_T above its open circuit, in the time ∫C dV/i",
            lambda current=current, bias_v=bias_v: collected_charge_e(
                current,
                E_PER_FC
                * quad(
                    lambda v: (
                        spice_ff(DIODE, v)
                        / (
                            current
                            - DIODE.saturation_current_e_per_s * math.expm1(-v / DIODE.thermal_v)
                        )
                    ),
                    bias_v,
                    DIODE.reset_voltage_v,
                    points=[v for v in DIODE.knees_v if v > bias_v],
                    epsabs=0,
                    epsrel=1e-13,
                )[0],
                DIODE,
            ),
            charge_to_e(DIODE, bias_v),
            rtol=1e-13,
            why="rounding; half of Newton's steps leave 5e-11",
        )
        for current in (1e3, 1e7, 1e10)
        for above in (20.0, 2.0, 0.3, 1e-3)
        for bias_v in (DIODE.open_circuit_v(current) + above * DIODE.thermal_v,)
    ),
    # As of a dark pixel's share below the mean: less than I_s e^(-V_0/V_T) collects nothing.
    Claim(
        "a negative photocurrent slows the discharge",
        lambda: charge_from_total_e(
            SHALLOW.saturation_current_e_per_s * np.array([0.0, 1e-3, 1.0]),
            np.full(3, 1e5),
            SHALLOW,
        ),
        [0.0, 0.0, charge_to_e(SHALLOW, 0.0)],
        rtol=1e-9,
    ),
    Claim(
        "charge of light in single precision, far from forward bias: all of it",
        lambda: collected_charge_e(np.float32([0.0, 1e6]), 0.03),
        0.03 * (np.array([0.0, 1e6]) + DIODE.saturation_current_e_per_s),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"charge of a constant capacitance at {kelvin:g} K: 20 decades of light, 1 ns to 10 h",
            lambda kelvin=kelvin: collected_charge_e(
                CURRENTS_E_PER_S,
                TIMES_S,
                diode_of(pixel_035(capacitance="paper", temperature_k=kelvin)),
            ),
            constant_diode_charge_e(
                CURRENTS_E_PER_S,
                TIMES_S,
                diode_of(pixel_035(capacitance="paper", temperature_k=kelvin)),
            ),
            rtol=1e-12,
            why="rounding; half of Newton's steps leave 7e-11 at 300 K",
        )
        for kelvin in (77.0, 300.15, 400.0)
    ),
    *(
        Claim(
            f"full bias of {name}: that of light which discharges it to 0 V in 30 ms",
            lambda name=name: diode_full_v(diode_of(of_process(name, well_limit="diode"))),
            zero_bias_v(name),
            rtol=1e-9,
            why="rounding of the charge",
        )
        for name in PITCHES_UM
    ),
    *(
        Claim(
            f"well and mean capacitance of {name} down to there",
            lambda name=name: [
                of_process(name, well_limit="diode").full_well_e,
                of_process(name, well_limit="diode").capacitance_ff,
            ],
            charge_to_e(diode_of(of_process(name, well_limit="diode")), zero_bias_v(name))
            * np.array(
                [
                    1.0,
                    electron
                    * 1e15
                    / (diode_of(of_process(name)).reset_voltage_v - zero_bias_v(name)),
                ]
            ),
            rtol=1e-9,
            why="rounding of the charge",
        )
        for name in PITCHES_UM
    ),
    Claim(
        "a stated well scales the capacitance at every bias",
        lambda: diode_of(pixel_035(full_well_e=5e5)).capacitance_ff(1.3),
        5e5 / pixel_035().full_well_e * float(spice_ff(diode_of(pixel_035()), 1.3)),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"the capacitance of {name} bends the response by {bend:g} of the well, half way up",
            lambda name=name: (
                level_share(name, np.linspace(0, 1, 201)) - np.linspace(0, 1, 201)
            ).max(),
            bend,
            atol=1e-4,
            why="the digits of the calculation by hand",
        )
        for name, bend in (
            ("0.5um", 0.0161),
            ("0.35um", 0.0175),
            ("0.25um", 0.0193),
            ("0.18um", 0.0099),
        )
    ),
    Claim(
        "and leaves both ends",
        lambda: level_share("0.35um", [0.0, 1.0, 1.3]),
        [0.0, 1.0, 1.0],
        atol=1e-6,
        why="the table",
    ),
    Claim(
        "a well without a diode current is linear up to any charge",
        lambda: linear_limit_e(diode_of(ENDLESS.physics), ENDLESS.full_well_e, 0.1),
        math.inf,
    ),
    Claim(
        "and holds more than its full well",
        lambda: stored_signal_e(SHARES * ENDLESS.full_well_e, 0.1, ENDLESS) / ENDLESS.full_well_e,
        SHARES,
        rtol=1e-12,
    ),
    Claim(
        "a constant capacitance is linear",
        lambda: level_share("0.35um", np.linspace(0, 1.3, 14), capacitance="paper"),
        np.minimum(np.linspace(0, 1.3, 14), 1.0),
        rtol=1e-14,
    ),
]


def decibels(pitch_um: float, capacitance) -> list[float]:
    reading = Readout.of(derive(Pixel(pitch_um=pitch_um, capacitance=capacitance)))
    return [maker_db(reading, 0.03), snr_db(reading, 0.2 * reading.full_well_e, 0.03)]


def sensitivity_e_per_lx_s_um2(reading, cut_nm: float | None) -> float:
    """Sensitivity under D65 on the photodiode, by a sum in steps of 1 nm."""
    nm = np.arange(360.0, 831.0)
    efficiency = pixel_035(response=reading, infrared_cut_nm=cut_nm).quantum_efficiency(nm)
    illuminance_lx = (luminous_weight(nm, 1.0) * d65(nm)).sum()
    return float((efficiency * photons_per_joule(nm) * d65(nm)).sum() / illuminance_lx * 1e-12)


ENERGY_NM, ENERGY = camera_sensitivities("Canon_EOS_R5")
RESPONSE = [
    *(
        Claim(
            f"e-/(lx s µm²) under D65, {reading}, cut {cut_nm}",
            lambda reading=reading, cut_nm=cut_nm: sensitivity_e_per_lx_s_um2(reading, cut_nm),
            expected,
            rtol=0.02,
            why="another calculation, with other steps and observer",
        )
        for reading, cut_nm, expected in (
            ("literal", None, 430.0),
            ("literal", 720.0, 380.0),
            ("scaled", None, 3846.0),
            ("scaled", 720.0, 3499.0),
        )
    ),
    Claim(
        "A/W scaled to a peak of 0.37",
        lambda: response_curve([400, 450, 500, 550, 600, 700, 800, 850], "scaled", 0.37),
        [0.156, 0.233, 0.364, 0.359, 0.357, 0.221, 0.072, 0.0],
        atol=1e-3,
        why="stated digits; two are 0.0009 off the file",
    ),
    Claim(
        "A/W at 600 nm, from the file: (hc/qλ) r over that of 510 nm",
        lambda: response_curve(600.0, "scaled", 0.37),
        0.37 * (0.0411 / 600) / (0.0363 / 510),
        rtol=1e-12,
    ),
    Claim(
        "literal values, and half way between two of them",
        lambda: response_curve([400, 560, 565, 590, 800], "literal", 0.37),
        [0.0120, 0.0392, 0.03985, 0.0415, 0.0111],
        rtol=1e-12,
    ),
    Claim(
        "the curve goes with the peak",
        lambda: response_curve([500.0], "literal", 0.74) / response_curve([500.0], "literal", 0.37),
        [2.0],
        rtol=1e-12,
    ),
    Claim(
        "generic silicon at its peak",
        lambda: silicon_curve(np.arange(350.0, 1050.0), 0.6).max(),
        0.6,
        rtol=1e-3,
        why="steps of 1 nm",
    ),
    Claim(
        "a table ends in darkness, and an infrared filter cuts",
        lambda: physics(
            quantum_efficiency=[[400, 0.2], [900, 0.6]], infrared_cut_nm=800
        ).quantum_efficiency([399.0, 650.0, 800.0, 801.0]),
        [0.0, 0.4, 0.52, 0.0],
        rtol=1e-12,
    ),
    Claim(
        "GSENSE400BSI: 1 e-/s at 0 °C doubles each 9.884 K, 0.03 at -50 °C",
        lambda: [
            physics(
                dark_current_e_per_s=None,
                dark_current={"e_per_s": 1.0, "at_c": 0.0, "doubling_k": 9.884},
                temperature_k=273.15 + at_c,
            ).dark_current_e_per_s
            for at_c in (0.0, -50.0, 9.884)
        ],
        [1.0, 0.03, 2.0],
        rtol=1e-3,
        why="four digits of the law",
    ),
    Claim(
        "well, dark current and gain of a sheet of 2 µm at 6 µm: 9 times",
        lambda: [
            getattr(readout(data_sheet_pitch_um=2.0, pitch_um=6.0, gain_e_per_dn=2.0), name)
            for name in ("full_well_e", "dark_current_e_per_s", "adc_range_e", "read_noise_e")
        ],
        [9 * 40_000.0, 9 * 60_000.0, 9 * 2.0 * (2**14 - 1001), 30.0],
        rtol=1e-12,
    ),
    Claim(
        "relative responses are to energy: QE = S/λ, the largest at the stated peak",
        lambda: (
            physics(
                quantum_efficiency=None,
                colour={"sensitivities": "Canon_EOS_R5", "peak_quantum_efficiency": 0.4},
            )
            .channels[0]
            .quantum_efficiency(ENERGY_NM)
        ),
        ENERGY[:, 0] / ENERGY_NM * 0.4 / (ENERGY / ENERGY_NM[:, None]).max(),
        rtol=1e-12,
    ),
]


DN_PER_E = (2**14 - 1 - 1000) / 40_000
TEMPORAL_E2 = 30.0**2 + 80.0**2 + 20.0**2
FIXED_E2 = (0.02 * SIGNAL_E) ** 2 + (0.3 * DARK_E) ** 2 + 160.0**2 + 80.0**2
QUIET_SHEET = {
    "dark_current_e_per_s": 5000.0,
    "read_noise_e": 20.0,
    "full_well_e": 20_000.0,
    "row_noise_e": 0.0,
    "read_noise_after_gain_e": 0.0,
}


def unstated(gain_db: float = 0.0, silent: tuple[str, ...] = (), **over) -> float:
    """Black level of a data sheet, which states none, with 20 e- of noise and 15 e- of offsets."""
    offsets = {"offset_fpn": None, "column_fpn": None, "dsnu_e": 15.0}
    sheet = QUIET_SHEET | offsets | {"black_level_dn": None} | over
    return readout(**sheet).with_silent(silent).at(Exposure(gain_db=gain_db)).adc.black_level_dn


HOT_E2 = DARK_E**2 * (ORDINARY**2 * (0.97 * 1.09 + 0.03 * 25 * math.exp(0.32)) - 1)
EMVA = readout(
    read_noise_e=None,
    read_noise_after_gain_e=None,
    row_noise_e=None,
    temporal_dark_noise_e=6.8,
    prnu=None,
    prnu_percent=0.5,
    offset_fpn=None,
    column_fpn=None,
    dsnu_e=1.9,
)
BINNED = Readout.of(
    derive(
        Pixel.model_validate(
            NOISY
            | HOT
            | {
                "quantum_efficiency": None,
                "colour": {
                    "pattern": "quad_rggb",
                    "binning": True,
                    "sensitivities": "Nikon_D5100",
                    "peak_quantum_efficiency": 0.5,
                },
            }
        )
    )
)
READING = [
    *(
        Claim(
            f"an ADC of 4000 codes and 2 e-/DN, by its {words}",
            lambda adc=adc: [adc.codes_dn, adc.full_scale_e, adc.dn_per_e, adc.top_code_dn],
            [4000.0, 8000.0, 0.5, 4095],
            rtol=1e-14,
        )
        for words, adc in (
            ("gain", Adc(12, 95.0, gain_e_per_dn=2.0)),
            ("span", Adc(12, 95.0, span_e=8000.0)),
        )
    ),
    Claim(
        "DR and SNR of Chen et al. (2000), eqs. (1) and (2): 19 000/√1400 and 86",
        lambda: [
            maker_db(readout(**QUIET_SHEET), 0.2),
            snr_db(readout(**QUIET_SHEET), 8600.0, 0.2),
        ],
        [20 * math.log10(19_000 / math.sqrt(1400)), 20 * math.log10(86)],
        rtol=1e-12,
    ),
    Claim(
        "SNR without light, and of shot noise alone",
        lambda: [
            snr_db(readout(**QUIET_SHEET), 0.0, 0.1),
            snr_db(readout(**QUIET_SHEET | {"read_noise_e": 0.0}), 100.0, 0.0),
        ],
        [-math.inf, 20.0],
        rtol=1e-12,
    ),
    Claim(
        "a burst of 4 has four wells and twice the noise",
        lambda: maker_db(readout().burst(4), 0.0) - maker_db(readout(), 0.0),
        20 * math.log10(2),
        atol=1e-9,
        why="rounding",
    ),
    Claim(
        "DR without noise",
        lambda: maker_db(readout(**QUIET_SHEET | {"read_noise_e": 0.0}), 0.0),
        math.inf,
    ),
    Claim(
        "20 dB and 4 exposures: range, gain, saturation, black and top code",
        lambda: [
            getattr(readout(exposure=Exposure(gain_db=20.0, frames=4)), name)
            for name in ("adc_range_e", "dn_per_e", "saturation_e", "black_level_dn", "top_code_dn")
        ],
        [4000.0, 10 * DN_PER_E, 16_000.0, 4000.0, 4 * (2**14 - 1)],
        rtol=1e-12,
    ),
    Claim(
        "noise floor: read noise behind the amplifier falls with the gain",
        lambda: [readout().noise_floor_e, readout(exposure=Exposure(gain_db=12.0)).noise_floor_e],
        [math.sqrt(TEMPORAL_E2), math.sqrt(30.0**2 + (80.0 / 10**0.6) ** 2 + 20.0**2)],
        rtol=1e-12,
    ),
    Claim(
        "noise floor and offsets of 8 exposures",
        lambda: [readout().burst(8).noise_floor_e, readout().burst(8).offset_e],
        [math.sqrt(8 * TEMPORAL_E2), 8 * math.hypot(160.0, 80.0)],
        rtol=1e-12,
    ),
    Claim(
        "σ_d, PRNU and DSNU of EMVA 1288 are what the pixel has",
        lambda: [
            getattr(EMVA, name)
            for name in ("noise_floor_e", "prnu", "offset_e", "read_noise_after_gain_e")
        ],
        [6.8, 0.005, 1.9, 0.0],
        rtol=1e-12,
    ),
    *(
        Claim(
            f"the gain stated as {next(iter(words))}",
            lambda words=words: [readout(**words).dn_per_e, readout(**words).saturation_e],
            [0.5, 2.0 * (2**14 - 1001)],
            rtol=1e-12,
        )
        for words in (
            {"gain_e_per_dn": 2.0},
            {"dn_per_e": 0.5},
            {"adc_full_scale_e": 2.0 * (2**14 - 1001)},
        )
    ),
    Claim(
        "four binned pixels: wells and dark currents add up, spreads halve, noise stays",
        lambda: (
            [
                getattr(BINNED, name)
                for name in ("full_well_e", "dark_current_e_per_s", "adc_range_e", "prnu")
            ]
            + [BINNED.dark_spread.dsnu, BINNED.noise_floor_e]
        ),
        [160_000.0, 240_000.0, 160_000.0, 0.01, 0.15, math.sqrt(TEMPORAL_E2)],
        rtol=1e-12,
    ),
    # 6 √(20² + 15²) over 20 e-/DN are 8 codes, of which a black level takes 7 of 15 at most.
    Claim(
        "full well of a stated capacity, which an ADC of 4 bits with a black level limits",
        lambda: (
            derive(
                Pixel(
                    technology="none",
                    pitch_um=2.0,
                    quantum_efficiency=0.5,
                    dark_current_e_per_s=0.0,
                    read_noise_e=20.0,
                    dsnu_e=15.0,
                    prnu=0.0,
                    saturation_capacity_e=90.0,
                    gain_e_per_dn=20.0,
                    bits=4,
                )
            ).full_well_e
        ),
        full_well_for_e(90.0, 160.0, 20.0, 0.0, 15.0),
        rtol=1e-12,
    ),
    Claim(
        "a sum is hot if one of its pixels is",
        lambda: [BINNED.dark_spread.hot_fraction, BINNED.dark_spread.hot_median],
        [1 - 0.97**4, (5.0 + 3) / 4],
        rtol=1e-12,
    ),
    Claim(
        "mean of a frame",
        lambda: frame_mean_dn(SIGNAL_E, TIME_S, readout()),
        1000 + DN_PER_E * (SIGNAL_E + DARK_E),
        rtol=1e-12,
    ),
    Claim(
        "variance of a frame, over frames and over sensors too",
        lambda: [
            frame_variance_dn2(SIGNAL_E, TIME_S, readout(), fixed_pattern=False),
            frame_variance_dn2(SIGNAL_E, TIME_S, readout()),
        ],
        DN_PER_E**2 * (SIGNAL_E + DARK_E + TEMPORAL_E2 + np.array([0.0, FIXED_E2])) + 1 / 12,
        rtol=1e-12,
    ),
    Claim(
        "mean and variance of 8 exposures: 8 times noise and rounding, offsets 8 times as large",
        lambda: [
            frame_mean_dn(SIGNAL_E, TIME_S, readout().burst(8)),
            frame_variance_dn2(SIGNAL_E, TIME_S, readout().burst(8)),
        ],
        [
            8000 + DN_PER_E * (SIGNAL_E + DARK_E),
            DN_PER_E**2
            * (
                SIGNAL_E
                + DARK_E
                + 8 * TEMPORAL_E2
                + (0.02 * SIGNAL_E) ** 2
                + (0.3 * DARK_E) ** 2
                + 64 * (160.0**2 + 80.0**2)
            )
            + 8 / 12,
        ],
        rtol=1e-12,
    ),
    # Of 2.5 e- and 3 e- of noise in each, 5 e-/DN; 1/12 DN² of each but the last is a normal value.
    Claim(
        "codes of eight exposures that are drawn at once scatter as their sum",
        lambda: _draw_summed_codes(
            [np.full((500, 500), 2.5)],
            np.zeros((1, 1)),
            np.zeros((8, 1, 1)),
            readout(**QUIET_SHEET | {"read_noise_e": 3.0, "gain_e_per_dn": 5.0}),
            np.random.default_rng(1),
        ).var(),
        8 * (11.5 / 25 + 1 / 12),
        rtol=0.014,
        why="5 standard errors of 250 000 values",
    ),
    Claim(
        "levels of light from the darkest to the largest, in equal ratios",
        lambda: levels_of_light_e(with_merge(readout()), TIME_S, 2.0, 8e3)[0][[0, 150, -1]],
        [2.0, math.sqrt(2.0 * 8e3), 8e3],
        rtol=2e-9,
        why="just below the largest",
    ),
    Claim(
        "variance by source",
        lambda: list(variances_e2(readout(**HOT), light_e=SIGNAL_E, dark_e=DARK_E).values()),
        [0.0, 7300.0, 400.0, 90_000.0, HOT_E2, 160.0**2, 80.0**2],
        rtol=1e-12,
    ),
    Claim(
        "without row noise, and without offsets of columns",
        lambda: [
            variance_e2(without_source(readout(), name), light_e=SIGNAL_E, dark_e=DARK_E)
            for name in ("row noise", "column FPN", "PRNU", "DSNU")
        ],
        TEMPORAL_E2 + FIXED_E2 - np.array([400.0, 6400.0, 300.0**2, 1800.0**2]),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"{electrons:g} e- have their SNR with a noise of 20 e- and a PRNU of {prnu:g}",
            lambda electrons=electrons, prnu=prnu: signal_at_snr_e(
                electrons / math.sqrt(electrons + 400 + (prnu * electrons) ** 2), 400.0, prnu
            ),
            electrons,
            rtol=1e-10,
        )
        for electrons in (3.0, 1e4)
        for prnu in (0.0, 0.005)
    ),
    Claim(
        "no light has an SNR of 200 with a PRNU of 1 %",
        lambda: float(math.isnan(signal_at_snr_e(200.0, 0.0, 0.01))),
        1.0,
    ),
    *(
        Claim(
            f"the dark spread that a clip at 0 DN sees, {words}",
            lambda more=more: dark_spread_e(readout(**more), TIME_S),
            math.sqrt(
                DARK_E * part + (0.3 * DARK_E * part) ** 2 + TEMPORAL_E2 + 160.0**2 + 80.0**2
            ),
            rtol=1e-12,
        )
        for words, more, part in (("", {}, 1.0), ("but hot pixels", HOT, ORDINARY))
    ),
    *(
        Claim(
            f"automatic exposure at {gain_db:g} dB with an ADC of {adc_e:g} e-",
            lambda gain_db=gain_db, adc_e=adc_e: integration_time_s(
                Exposure(max_integration_s=9.0, well_target=0.9, gain_db=gain_db),
                readout(adc_full_scale_e=adc_e),
                2e5,
            ),
            0.9 * min(40_000, adc_e / 10 ** (gain_db / 20)) / 2.6e5,
            rtol=1e-12,
        )
        for gain_db, adc_e in ((0.0, 4e4), (12.0, 8e4), (12.0, 4e5))
    ),
    *(
        Claim(
            f"time of 8 exposures, {frame_time}: stated, to the target, and the longest",
            lambda frame_time=frame_time: [
                integration_time_s(exposure, readout(), rate)
                for exposure, rate in (
                    (Exposure(integration_s=0.01, frames=8, frame_time=frame_time), 1e9),
                    (Exposure(frames=8, frame_time=frame_time), 1e7),
                    (Exposure(frames=8, frame_time=frame_time), 0.0),
                    (with_shared_time(Exposure(frames=8, frame_time=frame_time), 0.3), 1e3),
                )
            ],
            [times * 0.01, 8 * 0.95 * 40_000 / 1.006e7, times * 0.1, 0.3],
            rtol=1e-12,
        )
        for frame_time, times in (("shared", 1), ("each", 8))
    ),
    *(
        Claim(
            f"the black level leaves 6 σ and a code, {name} at {gain_db:g} dB",
            lambda more=more, gain_db=gain_db: least_black_level_dn(
                readout(
                    exposure=Exposure(gain_db=gain_db),
                    **QUIET_SHEET | {"offset_fpn": 0.0, "column_fpn": 0.0, "dsnu": 0.0} | more,
                ),
                0.2,
            ),
            expected,
        )
        # 6 √(400 + 1000) is 224.5 e-: over 2 e-/DN, or of 16383 codes for the range and this.
        for name, more, gain_db, expected in (
            ("2 e-/DN", {"gain_e_per_dn": 2.0}, 0.0, math.ceil(224.5 / 2) + 1),
            ("2 e-/DN", {"gain_e_per_dn": 2.0}, 20.0, math.ceil(2245 / 2) + 1),
            ("of the well", {}, 0.0, math.ceil(224.4994 * 16383 / 20_224.4994) + 1),
            ("of the well", {}, 20.0, math.ceil(224.4994 * 16383 / 2224.4994) + 1),
        )
    ),
    Claim(
        "the black level of each of four exposures, in a quarter of their time",
        lambda: least_black_level_dn(
            readout(
                **QUIET_SHEET
                | {"offset_fpn": 0.0, "column_fpn": 0.0, "dsnu": 0.0, "gain_e_per_dn": 2.0}
            ).burst(4),
            0.8,
        ),
        math.ceil(224.5 / 2) + 1,
    ),
    *(
        Claim(f"black level of a data sheet that states none, {name}", level_dn, expected)
        # 6 √(20² + 15²) is 150 e-: over 2 e-/DN and a code, of the range and this, half of 15.
        for name, level_dn, expected in (
            ("2 e-/DN", lambda: unstated(gain_e_per_dn=2.0), 76),
            ("2 e-/DN at 20 dB", lambda: unstated(20.0, gain_e_per_dn=2.0), 751),
            ("of the well", unstated, math.ceil(150 * 16383 / 20_150) + 1),
            ("4 bits", lambda: unstated(bits=4, gain_e_per_dn=2.0), 7),
            ("that is silent", lambda: unstated(20.0, ("read noise",), gain_e_per_dn=2.0), 751),
            ("without noise", lambda: unstated(read_noise_e=0.0, dsnu_e=0.0), 0),
            ("stated as 0", lambda: unstated(black_level_dn=0.0), 0),
            ("0.35 µm in its place", lambda: Readout.of(pixel_035()).adc.black_level_dn, 0),
        )
    ),
]
# Temporal variance of a dark pixel, with rounding.
DARK_PIXEL_E2 = TEMPORAL_E2 + DARK_E + 1 / 12 / DN_PER_E**2
OFFSETS_E2 = 160.0**2 + (0.3 * DARK_E) ** 2
FLAT_E = 0.6 * 40_000 - DARK_E
PART = SIGNAL_E / FLAT_E


def residual(**correction) -> list[float]:
    terms = residual_variance_e2(SIGNAL_E, TIME_S, readout(), Correction(**correction))
    return [float(term) for term in (terms.temporal, terms.offsets, terms.flat, terms.gain)]


SQUARE = np.arange(30.0).reshape(5, 6)


def defect_map(*places: tuple[int, int]) -> np.ndarray:
    defects = np.zeros(SQUARE.shape, bool)
    defects[tuple(np.transpose(places))] = True
    return defects


CORRECTIONS = [
    Claim(
        "residual without correction",
        residual,
        [SIGNAL_E + DARK_PIXEL_E2, OFFSETS_E2 + 80.0**2, 0.0, (0.02 * SIGNAL_E) ** 2],
        rtol=1e-12,
    ),
    Claim(
        "residual of 4 dark frames and 8 dark rows",
        lambda: residual(dark_frames=4, column_clamp=8),
        [SIGNAL_E + DARK_PIXEL_E2 * 9 / 8, DARK_PIXEL_E2 * 9 / 8 / 4, 0.0, (0.02 * SIGNAL_E) ** 2],
        rtol=1e-12,
    ),
    Claim(
        "residual of 16 flat frames at 0.6 of saturation",
        lambda: residual(flat_frames=16, flat_level=0.6),
        [
            SIGNAL_E + DARK_PIXEL_E2,
            (1 - PART) ** 2 * (OFFSETS_E2 + 80.0**2),
            PART**2 * (FLAT_E + DARK_PIXEL_E2) / 16,
            0.0,
        ],
        rtol=1e-12,
    ),
    Claim(
        "residual of 8 dark rows alone: offsets of columns are gone",
        lambda: residual(column_clamp=8)[1],
        OFFSETS_E2 * 9 / 8,
        rtol=1e-12,
    ),
    Claim(
        "dark frames and dark rows measure the dark level, flat frames do not",
        lambda: [
            Correction(**{frames: 1}).removes_dark_level
            for frames in ("dark_frames", "column_clamp", "flat_frames")
        ],
        [1, 1, 0],
    ),
    Claim(
        "a defect is the mean of its 8 neighbours, at a corner of 3, in a hole of the next ring",
        lambda: [
            without_defects(np.where(defects, 1e6, SQUARE), defects)[place]
            for place, defects in (
                ((2, 2), defect_map((2, 2))),
                ((0, 0), defect_map((0, 0))),
                ((2, 2), defect_map(*((row, column) for row in (1, 2, 3) for column in (1, 2, 3)))),
            )
        ],
        [14.0, 14 / 3, 14.0],
        rtol=1e-12,
    ),
    Claim(
        "outliers are beyond 6 σ, by the median deviation, and none of equal values",
        lambda: [outliers(np.array([0.0] * 9 + [value]), 0.1).sum() for value in (0.0, 0.59, 0.61)],
        [0, 0, 1],
    ),
    Claim(
        "of which 0.6745 σ is the median",
        lambda: [
            outliers(np.array([0.0, 1.0, 2.0, 3.0, 2.0 + value]), 0.1).sum()
            for value in (6 / 0.67448 * 0.999, 6 / 0.67448 * 1.001)
        ],
        [0, 1],
    ),
    Claim(
        "rounding leaves 1/√12 LSB in a frame, and a third of it in a mean of nine",
        lambda: _rounding_e(readout(gain_e_per_dn=2.0), 9),
        2 / math.sqrt(12 * 9),
        rtol=1e-12,
    ),
]

THIN = Camera(die_mm=0.4, object_distance_m=0.5, focal_length_mm=4.0)
ROLLING = Exposure(integration_s=1e-3, shutter="rolling", line_time_us=10.0)
FAST = Motion(image_um_per_s=(0.0, -4e3))


# Six half periods on 40 samples, and four on 30.
PHASE_DOWN = math.pi * 6 / 40 * (np.arange(40)[:, None] + 0.5)
PHASE = math.pi * 4 / 30 * (np.arange(30) + 0.5)


def slow_wave(shift: float) -> np.ndarray:
    """Three periods on 200 samples, which go on by reflection."""
    return np.cos(math.pi * 6 * (np.arange(200) + 0.5 - shift) / 200)


def margin_um(motion: Motion, exposure: Exposure) -> float:
    return motion_margin_um(motion, exposure, THIN, [(2.5, 1), (5.0, 2)])


SPECTRUM = np.random.default_rng(7).normal(size=(6, 7))


def products_along(path_cells: tuple[float, float]) -> list[np.ndarray]:
    """Return `SPECTRUM` times the mean of cos · cos and of sin · sin along a path, the latter from
    the second row on.
    """
    down = np.arange(6)[:, None] / 12 * path_cells[0]
    across = np.arange(7) / 14 * path_cells[1]
    plus, minus = np.sinc(down + across), np.sinc(down - across)
    sines = np.roll(SPECTRUM * (minus - plus) / 2, -1, axis=0)
    return [SPECTRUM * (plus + minus) / 2, sines * (np.arange(6)[:, None] < 5)]


MOTION = [
    *(
        Claim(
            f"a wave averaged along {path_cells}: each of its two waves keeps its sinc",
            lambda path_cells=path_cells: LightSpectrum(
                1 + np.cos(PHASE_DOWN) * np.cos(PHASE)
            ).blurred(path_cells),
            1
            + np.sinc(6 / 80 * path_cells[0] + 4 / 60 * path_cells[1])
            * np.cos(PHASE_DOWN + PHASE)
            / 2
            + np.sinc(6 / 80 * path_cells[0] - 4 / 60 * path_cells[1])
            * np.cos(PHASE_DOWN - PHASE)
            / 2,
            atol=1e-12,
        )
        for path_cells in ((3.0, -2.0), (7.3, 4.0), (5.0, 0.0), (0.0, 6.0), (0.0, 0.0))
    ),
    *(
        Claim(
            f"a spectrum averaged along a path of {length:g} in the direction {direction}",
            lambda direction=direction, length=length: _SlantedSpectrum.of(
                SPECTRUM, direction
            ).averaged(length),
            products_along((length * direction[0], length * direction[1])),
            atol=1e-12,
        )
        for direction in ((1.0, 0.4), (-0.3, 1.0), (1.0, -1.0), (6 / 7, 1.0))  # the last: a = b
        for length in (0.01, 3.7)
    ),
    Claim(
        "a velocity [x, y] in the time of a frame, and of a line, down and across",
        lambda: [
            motion_in_frame((3.0, -2.0), 0.5, ROLLING).path_um,
            motion_in_frame((3.0, -2.0), 0.5, ROLLING).row_um,
            motion_in_frame((3.0, -2.0), 0.5, Exposure()).row_um,
        ],
        [(-1.0, 1.5), (-2e-5, 3e-5), (0.0, 0.0)],
        rtol=1e-12,
    ),
    Claim(
        "rows of a slow wave displaced by 0, 1 and -0.3 samples",
        lambda: shifted_rows(np.tile(slow_wave(0.0), (3, 1)), np.array([0.0, 1.0, -0.3])),
        [slow_wave(0.0), slow_wave(1.0), slow_wave(-0.3)],
        atol=1e-12,
    ),
    Claim(
        "three exposures of a burst are a third of the path apart",
        lambda: [
            part.path_um + part.shift_um
            for part in motion_in_frame((6.0, 3.0), 1.0, ROLLING).subexposures(3)
        ],
        [(1.0, 2.0, -1.0, -2.0), (1.0, 2.0, 0.0, 0.0), (1.0, 2.0, 1.0, 2.0)],
        atol=1e-14,
    ),
    Claim("the longer axis", lambda: ImageMotion((-3.0, 2.0)).longest_um, 3.0),
    *(
        Claim(
            f"velocity on the sensor of {name}",
            lambda motion=motion: velocity_um_per_s(motion, THIN, 2.5),
            expected,
            rtol=1e-12,
        )
        for name, motion, expected in (
            ("the image", Motion(image_um_per_s=(5.0, -7.0)), (5.0, -7.0)),
            ("pixels", Motion(pixels_per_s=(2.0, 4.0)), (5.0, 10.0)),
            (
                "objects at 0.5 m",
                Motion(velocity_mm_per_s=(10.0, 0.0)),
                (1e4 * THIN.magnification, 0.0),
            ),
            (
                "objects at 3 m",
                Motion(velocity_mm_per_s=(0.0, 3.0), distance_m=3.0),
                (0.0, THIN.image_distance_mm),
            ),
            ("nothing", NO_MOTION, (0.0, 0.0)),
        )
    ),
    Claim(
        "margin: half of the longest path, that of the last row too, as stated, or none",
        lambda: [
            margin_um(FAST, Exposure(integration_s=1e-3)),
            margin_um(FAST, ROLLING),
            margin_um(Motion(image_um_per_s=(4e3, 0.0), margin_um=50.0), ROLLING),
            margin_um(NO_MOTION, ROLLING),
        ],
        [2.0, 4e3 / 2 * (1e-3 + 160 * 1e-5), 50.0, 0.0],
        rtol=1e-12,
    ),
    Claim(
        "border and margin add up",
        lambda: border_with_motion_um(3.0, FAST, ROLLING, THIN, [(2.5, 1)]),
        3.0 + 4e3 / 2 * (1e-3 + 160 * 1e-5),
        rtol=1e-12,
    ),
]

GRID = [
    Claim(
        "places of repeats are Sobol's points, in two dimensions",
        lambda: [spread_registration(repeat) for repeat in range(4)],
        [(0.0, 0.0), (0.5, 0.5), (0.25, 0.75), (0.75, 0.25)],
    ),
    Claim(
        "all repeats are shifted with the registration of the first one, x and y",
        lambda: (
            np.subtract(
                derive(Pixel()).registered(3, (0.2, 0.3)).pixel.registration,
                derive(Pixel()).registered(3).pixel.registration,
            )
            % 1
        ),
        [0.2, 0.3],
        rtol=1e-12,
    ),
    Claim(
        "whole pixels on 20 µm, centred and with a border at 0.3 from the centre",
        lambda: [pixel_count(20.0, 3.0), pixel_count(20.0, 3.0, 0.3), pixel_count(20.0, 3.0, 0.9)],
        [6, 6, 6],
    ),
    Claim(
        "an exact fit is not lost by rounding",
        lambda: [pixel_count(512 * 5.3, 5.3), pixel_count(512 * 5.3, 5.3, 0.0)],
        [512, 512],
    ),
    Claim(
        "the first pixel of 6 centred ones, and of those with a border at 0.3 and 0.9",
        lambda: [first_edge_um(20.0, 6, 3.0, place) for place in (None, 0.3, 0.9)],
        [1.0, 10 + 0.3 * 3 - 9, 10 + 0.9 * 3 - 12],
        rtol=1e-12,
    ),
    Claim("rows and columns", lambda: pixels_on((7.0, 10.0), 2.0), (3, 5)),
    Claim(
        "a border at the centre leaves 1.5 µm one whole pixel only at 0.5",
        lambda: pixels_on((1.5, 3.5), 1.0, (0.5, 0.0)),
        (1, 2),
    ),
    Claim(
        "values of the channels at their places, of a mosaic and of planes",
        lambda: np.concatenate(
            [
                channel_map(np.arange(3.0), Layout(("RG", "GB")), (3, 3)),
                channel_map(np.arange(3.0), Layout(("RGB",), True), (3, 3)),
            ]
        ),
        [[0, 1, 0], [1, 2, 1], [0, 1, 0], [0, 0, 0], [1, 1, 1], [2, 2, 2]],
    ),
    Claim("shares of channels", lambda: Layout(("RG", "GB")).shares, [0.25, 0.5, 0.25]),
    Claim(
        "peaks of the channels of a camera, nm",
        lambda: [entry.peak_nm for entry in cameras() if entry.name == "Canon_EOS_R5"],
        [[ENERGY_NM[channel.argmax()] for channel in ENERGY.T]],
    ),
    Claim(
        "pitch of four pixels that are read as one",
        lambda: (
            derive(
                Pixel(
                    technology="4t-bsi",
                    pitch_um=1.2,
                    colour={
                        "pattern": "quad_rggb",
                        "binning": True,
                        "sensitivities": "Canon_EOS_R5",
                        "peak_quantum_efficiency": 0.5,
                    },
                )
            ).read_pitch_um
        ),
        2.4,
        rtol=1e-12,
    ),
]

CLAIMS = [
    *SPREADS,
    *SILICON,
    *FLICKER,
    *CODES,
    *LAYOUT,
    *PHOTODIODES,
    *RESPONSE,
    *READING,
    *CORRECTIONS,
    *MOTION,
    *GRID,
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()
