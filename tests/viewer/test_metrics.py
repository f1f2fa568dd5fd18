"""Metrics of frames against closed forms and drawn frames, and their kernels by a second way. Closed
forms of the kernels stand in test_closed_forms.py.
"""

import math
import warnings
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.claims import Claim
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from pixsim import (
    Camera,
    Correction,
    Develop,
    Display,
    Exposure,
    Motion,
    Pixel,
    PixsimError,
    SpectralImage,
    evaluate,
    make_chart,
    metrics as kernels,
    optics,
)
from pixsim.sensor.code_moments import moments_of_codes
from pixsim.sensor.colour_options import ColourOptions
from pixsim.sensor.motion import ImageMotion
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import read_out, sample_sensor
from pixsim.viewer.adaptation import RESPONSES
from pixsim.viewer.chain import ExpectedFrame, ImagingChain
from pixsim.viewer.display import average_axis
from pixsim.viewer.dot_noise import RawNoise, expected_noise_power
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.metric_registry import METRICS, metrics_named
from pixsim.viewer.metrics import MetricRequest, NoNumberError
from pixsim.viewer.raw_metrics import (
    MAX_D_PRIME,
    _check_rounding,
    _ClippedExposure,
    _CodeTable,
    _d_prime,
    _line_variance_e2,
    _mtf_along,
    bottom_table,
    code_moments,
    code_tables,
    contrast_factor,
    full_e,
    neq_along,
    sensor_mtf,
    top_table,
    variance_of_pixels_e2,
)
from pixsim.viewer.shown_metrics import _expected_light, _raw_noise

CELL_UM = 2.0
WHITE_CD_PER_M2 = 100.0
TIME_S = 0.02
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
DISPLAY = Display(white_cd_per_m2=WHITE_CD_PER_M2, dots=64)
FRAME = {"camera": CAMERA, "exposure": Exposure(integration_s=TIME_S), "display": DISPLAY}
ONE_REGISTRATION = {"detectability": {"registrations": 1}}


def light(picture: np.ndarray | float, cell_um: float = CELL_UM, **header) -> SpectralImage:
    """Return light of one narrow band, without diffraction."""
    side = round(400 / cell_um)
    return SpectralImage(
        [550.0],
        10.0,
        cell_um,
        data=np.float32(2e-4 * picture * np.ones((side, side)))[..., None],
        header={"diffraction": False} | header,
    )


UNIFORM = light(1.0)


def with_disc(contrast: float, radius_px: float = 20.0, **header) -> SpectralImage:
    y, x = np.mgrid[:200, :200] - 99.5
    return light(1.0 + contrast * (np.hypot(y, x) < 2 * radius_px), **header)


def request(name: str, repeats: int = 1, **options) -> MetricRequest:
    return MetricRequest(metrics_named([name]), MetricOptions(**options), repeats)


def chain_of(
    image: SpectralImage = UNIFORM,
    pixel: Pixel = PIXEL,
    background: SpectralImage | None = None,
    metrics: MetricRequest | None = None,
    **settings,
) -> ImagingChain:
    metrics = metrics or request("information")
    with warnings.catch_warnings(action="ignore"):  # of an ADC that ends below the well
        return imaging_chain(
            image, pixel=pixel, metrics=metrics, background=background, **FRAME | settings
        )


def numbers_of(chain: ImagingChain, name: str) -> tuple[float, ...]:
    return METRICS[name].compute(FrameUnderTest.of(chain, chain.capture("a")))


def evaluated(image: SpectralImage, name: str, **settings) -> dict[str, float]:
    """Return the columns of one metric of a frame."""
    settings = FRAME | {"pixel": PIXEL} | settings
    with warnings.catch_warnings(action="ignore"):
        return evaluate(image, metrics=[name], **settings).further


def fixed_e2(chain: ImagingChain) -> float:
    """Variance of a pixel without light: 4 e- of read noise, and rounding."""
    return 16.0 + 1 / (12 * chain.readout.dn_per_e**2)


def d_prime_of_signal_and_noise(image: SpectralImage, prnu: float) -> float:
    """Return √Σ Δ²/σ² over the pixels, of their expected electrons; σ² is the mean of both."""
    target_e, background_e = (TIME_S * chain_of(scene).signal_e_per_s for scene in (image, UNIFORM))
    square_e2 = (target_e**2 + background_e**2) / 2
    variance_e2 = (target_e + background_e) / 2 + prnu**2 * square_e2 + fixed_e2(chain_of())
    return math.sqrt(float(((target_e - background_e) ** 2 / variance_e2).sum()))


@cache
def information(contrast: float) -> dict[str, float]:
    return evaluated(
        UNIFORM, "information", metric=MetricOptions(information={"contrast": contrast})
    )


def bits(contrast: float, column: str = "information") -> float:
    return information(contrast)[column]


def niirs_from(**options: float) -> float:
    return evaluated(UNIFORM, "niirs", metric=MetricOptions(niirs=options))["niirs"]


def stated_disc() -> ImagingChain:
    return chain_of(
        with_disc(-0.05, parameters={"contrast": "-0.5"}),
        background=UNIFORM,
        metrics=request("detectability", **ONE_REGISTRATION),
    )


UNIFORM_E = TIME_S * float(chain_of().signal_e_per_s.mean())
UNIFORM_SHARE = UNIFORM_E / chain_of().readout.saturation_e


def information_and_neq(share: float) -> list[float]:
    """Return both for pixels that are full to a share."""
    chain = chain_of(exposure=Exposure(integration_s=share * TIME_S / UNIFORM_SHARE))
    return [
        numbers_of(chain, "information")[0],
        neq_along(chain.expected(chain.integration_s))[1][1],
    ]


def small_pixel(fields: dict) -> Pixel:
    return PIXEL.model_copy(update=SMALL_WELL | fields)


def exposure_of(fields: dict) -> _ClippedExposure:
    return _ClippedExposure(chain_of(pixel=small_pixel(fields)).readout, TIME_S)


STATED = PIXEL.model_dump(exclude_unset=True)
OPENING = {"height_um": 6.0, "index": 1.5, "microlens": "none", "shift": "none"}
SPARSE = STATED | {"pitch_um": 100.0, "fill_factor": 0.01}
SHORTER = {"kind": "staggered", "ratio": 4.0, "count": 3}
LINED = {
    **{"prnu": 0.01, "row_noise_e": 8.0, "column_fpn": 12.0 / 20_000},
    **{"dark_current_e_per_s": 5e3, "dsnu": 0.2},  # 100 ± 20 e-
}


@cache
def shorter_table() -> _CodeTable:
    pixel = Pixel(**STATED | {"readout": SHORTER, "dark_current_e_per_s": 1e5})
    return top_table(chain_of(pixel=pixel).expected(TIME_S), 1e6)


SMALL_WELL = {"full_well_e": 2000.0, "read_noise_e": 3.0}
ADC_AT_END_E_PER_DN = 2000.0 / (2**12 - 1 - 64)
SOFT_WELL = {
    "technology": "0.35um",
    "well_limit": "diode",
    "fill_factor": None,
    "pitch_um": 6.0,
    "full_well_e": None,
}
QUIET_3T = SOFT_WELL | {"bits": 16, "reset_noise_factor": 0.0, "offset_fpn": 0.0}
ENDS: dict[str, dict] = {
    "well": {"gain_e_per_dn": 1.3 * ADC_AT_END_E_PER_DN},
    "ADC": {"gain_e_per_dn": ADC_AT_END_E_PER_DN, "full_well_e": 4000.0},
    "well and ADC": {},
}
NEAR_0 = {"black_level_dn": 0.0, "prnu": 0.02, "offset_fpn": 2e-4}


def burst_frame(**fields: float) -> ExpectedFrame:
    """Return a frame of four exposures, whose codes begin at the dark and end beyond the well."""
    chain = chain_of(pixel=PIXEL.model_copy(update=NEAR_0 | {"gain_e_per_dn": 6.0} | fields))
    return replace(chain, readout=chain.readout.burst(4)).expected(TIME_S)


# Four times the charge of an exposure, less its 10 e- of dark charge.
FAINT = burst_frame(prnu=0.0, offset_fpn=0.0, dark_current_e_per_s=2e3)
FAINT_E = 4 * ((6**2 + math.sqrt(6**4 + 4 * 6**2 * 4**2)) / 2 - 10)
BRIGHT_E = 4 * (((math.sqrt(6**2 + 4 * 20_000) - 6) / 2) ** 2 - 10)


@cache
def full_table() -> _CodeTable:
    return top_table(burst_frame(dark_current_e_per_s=1e5, prnu=0.1), 8e4)


def noise_of_lines(end: dict) -> np.ndarray:
    """Return the noise of rows and of columns, of 20 e- each, over that and the mean square of the
    slopes of codes, in uniform light that fills the range.
    """
    fields = SMALL_WELL | end | {"row_noise_e": 20.0}
    fields["column_fpn"] = 20.0 / fields["full_well_e"]
    chain = chain_of(pixel=PIXEL.model_copy(update=fields))
    frame = chain.expected(2000.0 / float(chain.signal_e_per_s.max()))
    noise = _raw_noise(frame, frame.signal_e)
    slope = code_moments(code_tables(frame, frame.signal_e), frame.signal_e, 0.0).offset_slope
    return np.array([noise.row, noise.column]) * (frame.white_e / 20) ** 2 / np.mean(slope**2)


def slope_ratios(fields: dict) -> list[np.ndarray]:
    """Return slopes for the signal, and for an offset of codes, over quotients of the mean code at
    the same noise, below a well of 2000 e- and above it.
    """
    charge_e = np.array([1900.0, 2000.0, 2050.0])
    pixel = PIXEL.model_copy(update=SMALL_WELL | fields)

    def moments(signal_e: float = 0.0, offset_e: float = 0.0) -> tuple[np.ndarray, ...]:
        exposure = _ClippedExposure(chain_of(pixel=pixel).readout, TIME_S)
        exposure.black_e += offset_e
        exposure.top_e -= offset_e
        mean_dn, *others = exposure._moments_of_well(charge_e + signal_e, np.sqrt(charge_e))
        return mean_dn / exposure.readout.dn_per_e, *others

    _, _, signal_slope, offset_slope = moments()
    return [
        signal_slope / (moments(0.1)[0] - moments(-0.1)[0]) * 0.2,
        offset_slope / (moments(0.0, 0.1)[0] - moments(0.0, -0.1)[0]) * 0.2,
    ]


STEPS = np.linspace(-6, 6, 20_001)
LAW = np.exp(-(STEPS**2) / 2) / np.exp(-(STEPS**2) / 2).sum()


def drawn_moments(exposure: _ClippedExposure, charge_e: float) -> list[float]:
    """Return mean and variance in DN of the codes of a charge with a deviation of 40 e-, by its law
    in steps.
    """
    mean_dn, variance_dn2, _ = moments_of_codes(
        exposure.readout.dn_per_e
        * (
            exposure.black_e
            + stored_signal_e(charge_e + 40 * STEPS, exposure.time_s, exposure.readout)
        ),
        np.full(STEPS.size, exposure.readout.dn_per_e * math.sqrt(exposure.read_e2)),
        exposure.readout.top_code_dn,
        coarse_dn=0.0,
    )
    return [LAW @ mean_dn, LAW @ (variance_dn2 + (mean_dn - LAW @ mean_dn) ** 2)]


# An exposure of four: 10 e- of dark charge, 4 e- of read noise and of offsets.
PART = _ClippedExposure(
    chain_of(
        pixel=PIXEL.model_copy(
            update={"prnu": 0.01, "dsnu": 0.5, "offset_fpn": 2e-4, "dark_current_e_per_s": 2e3}
        )
    ).readout.burst(4),
    TIME_S,
)
DN_E = 20_000 / (4095 - 64)  # of `PIXEL`
DOT_PX = 400 / 64 / 4.0  # across
LINE_NOISE = {"row_noise_e": 8.0, "column_fpn": 12.0 / 20_000}  # 8 and 12 e-
WIDE = SpectralImage([550.0], 10.0, CELL_UM, data=UNIFORM.data[:100], header=UNIFORM.header)
# Of 9 × 19 pixels of 20 µm, whose borders lie 1/4 and 3/4 of a pixel beside the axis.
REGISTERED = chain_of(
    WIDE,
    Pixel(
        **PIXEL.model_dump(exclude_unset=True) | {"pitch_um": 20.0, "registration": (0.25, 0.75)}
    ),
    develop=Develop(sharpen_amount=0.5, sharpen_radius_px=1.5),
    display=DISPLAY.model_copy(update={"dots": 27}),
)


def noise_of_pictures(edges_um: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the spectrum of noise of 4, 2 and 3 in the pixels, columns and rows of `REGISTERED`,
    by the sharpened picture of each on the dots.
    """
    (down, soft_down), (across, soft_across) = (
        [average_axis(picture, 20.0, first_um, edges, 1, 0) for picture in (np.eye(count), blur)]
        for edges, count, first_um in zip(edges_um, (9, 19), (5.0, 15.0), strict=True)
        for blur in [gaussian_filter1d(np.eye(count), 1.5, axis=0, mode="mirror")]
    )
    pixels = 1.5 * np.einsum("ky,lx->yxkl", down, across)
    pixels -= 0.5 * np.einsum("ky,lx->yxkl", soft_down, soft_across)
    noise = [
        2 * pixels.reshape(-1, 9, 21),
        2**0.5 * pixels.sum(axis=0),
        3**0.5 * pixels.sum(axis=1),
    ]
    return np.square(np.abs(np.fft.fft2(np.concatenate(noise)))).sum(axis=0) / (9 * 21)


DARKER = "a target cannot be darker than black"
CLAIMS = [
    Claim(
        "an exposure of a burst has a quarter of its time and dark charge, and the noise of one",
        lambda: [
            *(PART.time_s, PART.dark_e, PART.black_e, PART.top_e, PART.well_e, PART.clip_e),
            *(PART.offset_fpn_e2, PART.read_e2, PART.charge_e2(1000.0)),
        ],
        [
            *(TIME_S / 4, 10.0, 64 * DN_E, 20_000, 20_000, 20_000),
            *(4**2, 4**2 + 4**2, 1000 + 10 + 10**2 + 5**2),
        ],
        rtol=1e-12,
    ),
    Claim(
        "four exposures far from their ends: shot noise adds up, PRNU, DSNU and offsets linearly",
        lambda: [
            np.ravel(number)[0] for number in PART.table(np.array([5000.0, 6000.0]), 5000.0, 6000.0)
        ],
        [
            20_000,
            20_000,
            4 * (5010 + 4**2 + DN_E**2 / 12) + 4**2 * (50**2 + 5**2 + 4**2),
            *(1, 1, 20_000, 24_000),
        ],
        rtol=1e-7,
        why="Gauss-Legendre nodes over 12 deviations",
    ),
    *(
        Claim(
            f"between the signals of a table at the {end} the mean code is off by 2e-5 of its noise",
            lambda signal_e=signal_e, fields=ENDS[end] | {"dark_current_e_per_s": 1e4}: (
                code_moments(
                    [top_table(chain_of(pixel=small_pixel(fields)).expected(TIME_S), 1e5)],
                    signal_e,
                    0.0,
                ).mean_e
                - exposure_of(fields).moments(signal_e)[0]
            ),
            np.full(501, -200.0),
            atol=2e-5 * math.sqrt(2000),
            why="straight between a thousand signals",
        )
        for signal_e in [np.linspace(1700.0, 2000.0, 501)]
        for end in ("well", "ADC")
    ),
    Claim(
        "a table in electrons of light of which a quarter is read",
        lambda: [*_CodeTable(*[1.0] * 7).scaled_by_response(0.25)],
        [4, 4, 16, 1, 1, 4, 4],
    ),
    *(
        Claim(
            f"6 σ reach the end of the {end}, and leave it, where c ± 6 √(c + σ²) is that",
            lambda end=end, read_e2=read_e2, root=root: [
                [
                    exposure_of(ENDS[end] | {"dark_current_e_per_s": 1e4}).reaches_top(
                        factor * ((root - 3) ** 2 - read_e2 - 200)
                    ),
                    exposure_of(ENDS[end] | {"dark_current_e_per_s": 1e4}).is_certain(
                        factor * ((root + 3) ** 2 - read_e2 - 200)
                    ),
                ]
                for factor in (1 - 1e-9, 1 + 1e-9)
            ],
            [[0, 0], [1, 1]],
        )
        for end, read_e2, root in (("well", 0.0, 2009**0.5), ("ADC", 9.0, 2018**0.5))
    ),
    *(
        Claim(
            f"moments of codes are those of the law of the charge, {name}",
            lambda fields=fields, charge_e=charge_e: np.divide(
                np.ravel(
                    exposure_of(fields)._moments_of_well(np.array([charge_e]), np.array([40.0]))[:2]
                ),
                drawn_moments(exposure_of(fields), charge_e),
            ),
            [1.0, 1.0],
            rtol=1e-6,
            why="nodes, and steps of 6e-4",
        )
        for name, fields, charge_e in (
            ("at a well", {"bits": 16, "gain_e_per_dn": 0.05}, 1990.0),
            ("at a well and the top code", {"bits": 16}, 1970.0),
            ("at a soft well", QUIET_3T, 1.25e5),
            ("at a top code below a soft well", QUIET_3T | {"gain_e_per_dn": 0.02}, 1300.0),
            ("at a top code below the well", {"bits": 16, "gain_e_per_dn": 0.03}, 1950.0),
        )
    ),
    *(
        Claim(
            f"{name}, less its dark charge",
            lambda fields=fields: full_e(
                Readout.of(derive(Pixel(**STATED | {"dark_current_e_per_s": 1e5} | fields))), TIME_S
            ),
            expected,
            rtol=1e-12,
        )
        for name, fields, expected in (
            ("a well that ends below the codes", {"gain_e_per_dn": 6.0}, 20_000 - 2000),
            ("a well that dark charge fills", {"dark_current_e_per_s": 1e9}, 0.0),
            (
                "the well of an exposure shorter by 16, in light of the longest",
                {"readout": SHORTER},
                16 * 20_000 - 2000,
            ),
            (
                "the well of the darkest of three photodiodes, in light of the first",
                {
                    "readout": {
                        "collector": [
                            {"name": "a"},
                            {"name": "b", "response": 0.25},
                            {"name": "c", "response": 0.05, "dark_current_e_per_s": 1e4},
                        ],
                        "reading": [{"name": name, "collector": name} for name in "abc"],
                    }
                },
                20 * (20_000 - 200),
            ),
        )
    ),
    Claim(
        "NEQ of q²/(q + 16 + rounding) a pixel, times the squared MTF of the lens and sinc ½",
        lambda: np.ravel(np.stack(neq_along(chain_of().expected(TIME_S)))[:, [0, -1]]),
        [
            *(0.0, 125.0),
            *(
                UNIFORM_E**2 / (UNIFORM_E + fixed_e2(chain_of())) / 0.004**2 * mtf**2
                for mtf in (
                    1.0,
                    optics.diffraction_otf(125.0, 550.0, CAMERA.effective_f_number) * 2 / math.pi,
                )
            ),
        ],
        rtol=1e-4,
        why="a band of 10 nm in place of one wavelength",
    ),
    Claim(
        "from 0.1 % below the well to 0.1 % above, a tenth of the noise, some per cent are lost",
        lambda: np.divide(*[information_and_neq(share) for share in (1.001, 0.999)]),
        [0.9, 0.9],
        atol=0.1,
        why="some per cent",
    ),
    Claim(
        "10 % above the well no information is left, and no NEQ",
        lambda: np.nan_to_num(information_and_neq(1.1), nan=-1.0),
        [0.0, -1.0],
    ),
    Claim(
        "a path of 8 µm down and 4 µm across blurs by both",
        lambda: (
            [
                sensor_mtf(
                    replace(chain_of().expected(TIME_S), image_motion=ImageMotion(path_um)),
                    np.array([20.0]),
                    np.array([10.0]),
                )[0]
                for path_um in ((0.0, 0.0), (8.0, 4.0))
            ]
            @ np.array([-np.sinc(0.008 * 10 + 0.004 * 20), 1.0])
        ),
        0.0,
        atol=1e-12,
    ),
    Claim(
        "the corner of a natural spectrum is a cycle across the die",
        lambda: (
            numbers_of(
                chain_of(metrics=request("information", information={"corner_cy_per_mm": 1 / 0.4})),
                "information",
            )[0]
            / bits(0.15)
        ),
        1.0,
        rtol=1e-12,
    ),
    # √n µ/√(µ + σ²) of dots of n pixels, of a wall of reflectance ½; in lines of √n pixels each.
    *(
        Claim(
            f"illuminance at which a dot has an SNR of 10, with lines of {lines}",
            lambda lines=lines: evaluated(
                UNIFORM,
                "snr10_lx",
                metric=MetricOptions(snr10_lx={"reflectance": 0.5, "integration_s": TIME_S}),
                pixel=PIXEL.model_copy(update=lines),
            )["snr10_lx"],
            (1 + math.sqrt(1 + 4 * DOT_PX**2 / 100 * (fixed_e2(chain_of()) + lines_e2 * DOT_PX)))
            / (2 * DOT_PX**2 / 100)
            / (TIME_S * chain_of().white_e_per_s)
            * (math.pi * WHITE_CD_PER_M2 / 0.5),
            rtol=1e-9,
        )
        for lines, lines_e2 in (({}, 0), (LINE_NOISE, 8**2 + 12**2))
    ),
    # With the shading of openings that are not shifted it would be 4.4.
    *(
        Claim(
            f"visual noise has no shading that is corrected, {correction}",
            lambda correction=correction: evaluated(
                light(1e4),
                "visual_noise",
                pixel=Pixel(
                    **STATED
                    | {"fill_factor": 0.5, "bits": 16, "read_noise_e": 0, "full_well_e": 1e9}
                    | {"stack": OPENING}
                ),
                camera=CAMERA.model_copy(update={"focal_length_mm": 0.5}),
                display=DISPLAY.model_copy(update={"white_cd_per_m2": 1e4 * WHITE_CD_PER_M2}),
                correction=correction,
            )["visual_noise"],
            0.031,
            rtol=0.05,
            why="one frame",
        )
        for correction in (None, Correction(flat_frames=10))
    ),
    Claim(
        "flat frames leave no shading in expected light, of which a target of 0.2 has a sixth",
        lambda: [
            [np.ptp(shown), np.abs(difference - shown / 6).max()]
            for chain in [
                chain_of(
                    light(1.2),
                    Pixel(**STATED | {"stack": OPENING, "fill_factor": 0.5}),
                    UNIFORM,
                    request("npwe"),
                    camera=CAMERA.model_copy(update={"focal_length_mm": 0.5}),
                    correction=Correction(flat_frames=1),
                )
            ]
            for shown, difference in [_expected_light(chain.capture("a"), chain.expected(TIME_S))]
        ],
        [[0.0, 0.0]],
        atol=1e-6,
        why="float32 of the light",
    ),
    Claim(
        "contrasts of uniform light have the noise of pixels and lines",
        lambda: (
            evaluated(
                UNIFORM, "contrast_detection_probability", pixel=PIXEL.model_copy(update=LINE_NOISE)
            )["contrast_detection_probability"]
            / kernels.contrast_detection_probability(
                UNIFORM_E,
                0.1,
                *np.sqrt(UNIFORM_E * np.array([1, 1.1]) + fixed_e2(chain_of()) + 208),
            )
        ),
        1.0,
        rtol=1e-6,
        why="float32 of the light",
    ),
    *(
        Claim(
            f"white noise of pixels and lines is white noise of {name}",
            lambda display=display: (
                expected_noise_power(
                    chain_of(WIDE, display=DISPLAY.model_copy(update=display)).development,
                    RawNoise(np.full((50, 100), 4.0), column=2.0, row=3.0),
                )
                * DISPLAY.samples_per_deg**2
            ),
            4 / side**2
            + 2 / side * rows * (np.arange(rows)[:, None] == 0)
            + 3 / side * columns * (np.arange(columns) == 0),
            rtol=1e-9,
        )
        for name, display, side, rows, columns in (
            ("pixels that are shown", {"raster": "one_to_one"}, 1, 50, 100),
            ("dots of 2 × 2", {"dots": 50, "interpolation": "nearest"}, 2, 23, 48),
        )
    ),
    Claim(
        "noise of sharpened pixels and lines on dots is that of the picture of each",
        lambda: (
            expected_noise_power(
                REGISTERED.development, RawNoise(np.full((9, 19), 4.0), column=2.0, row=3.0)
            )
            / noise_of_pictures(REGISTERED.screen.dot_edges_um)
            * DISPLAY.samples_per_deg**2
        ),
        np.ones((9, 21)),
        rtol=1e-9,
    ),
    Claim(
        "further frames of a sensor, beside the first",
        lambda: [len([*chain_of().further_frames(count, "a")]) for count in (1, 3)],
        [0, 2],
    ),
    *(
        Claim(
            "acutance of a sharpened picture",
            lambda: numbers_of(
                chain_of(
                    metrics=request("acutance"),
                    develop=Develop(sharpen_amount=0.5, sharpen_radius_px=1.5),
                ),
                "acutance",
            ),
            [
                kernels.acutance(
                    cy_per_deg,
                    optics.diffraction_otf(cy_per_mm, 550.0, CAMERA.effective_f_number)
                    * np.sinc(0.004 * cy_per_mm) ** 3  # aperture and linear interpolation
                    * np.sinc(0.4 / 64 * cy_per_mm)
                    * (1.5 - 0.5 * np.exp(-2 * (np.pi * 1.5 * 0.004 * cy_per_mm) ** 2)),
                )
            ],
            rtol=1e-4,
            why="a band of 10 nm in place of one wavelength; the mask ends at 4 σ",
        )
        for cy_per_deg in [np.linspace(0.0, DISPLAY.samples_per_deg / 2, 257)]
        for cy_per_mm in [cy_per_deg / (DISPLAY.samples_per_deg * 400 / 64 / 1e3)]
    ),
    *(
        Claim(
            f"detectability is the signal over the noise, of a PRNU of {prnu:g}",
            lambda contrast=contrast, prnu=prnu: (
                evaluated(
                    with_disc(contrast),
                    "detectability",
                    without=UNIFORM,
                    metric=MetricOptions(**ONE_REGISTRATION),
                    pixel=PIXEL.model_copy(update={"prnu": prnu}),
                )["detectability"]
                / d_prime_of_signal_and_noise(with_disc(contrast), prnu)
            ),
            1.0,
            rtol=1e-9,
        )
        for contrast, prnu in ((-0.05, 0.0), (-0.5, 0.05))
    ),
    Claim(
        "the full half of a sensor has no information",
        lambda: (
            evaluated(light(np.where(np.arange(200) < 100, 1.0, 1e3)), "information")["information"]
            / bits(0.15)
        ),
        0.5,
        rtol=1e-9,
    ),
    *(
        Claim(
            f"information at a {name} contrast, of {contrast}",
            lambda contrast=contrast, name=name, other=other: (
                bits(contrast, f"information_{name}_contrast") / bits(other)
            ),
            1.0,
            rtol=1e-9,
        )
        # A third; three times it, but at most 1 or itself.
        for contrast, name, other in (
            (0.15, "low", 0.05),
            (0.15, "high", 0.45),
            (0.6, "high", 1.0),
            (2.0, "high", 2.0),
        )
    ),
    *(
        Claim(
            f"{name} sees nothing where {cause} fills the wells",
            lambda name=name, image=image, without=without, pixel=pixel: evaluated(
                image, name, pixel=pixel, without=without
            )[name],
            0.0,
        )
        for name in ("npwe", "detectability")
        for cause, image, without, pixel in (
            ("light", light(300 * with_disc(0.1).data[..., 0] / 2e-4), light(300.0), PIXEL),
            (
                "dark charge",
                with_disc(0.1),
                UNIFORM,
                PIXEL.model_copy(update={"dark_current_e_per_s": 1e9}),
            ),
        )
    ),
    Claim(
        "three repeats take six registrations, each of them once",
        lambda: [
            frame.readout.physics.registration
            for chain in [chain_of(metrics=request("information", 3))]
            for number in range(3)
            for frame in list(
                FrameUnderTest.of(chain, chain.capture("a"), number).registrations(6)
            )[1:]
        ],
        [derive(PIXEL).registered(number).registration for number in (3, 4, 5)],
    ),
    Claim(
        "values of what a study minimises",
        lambda: [
            METRICS[name].from_loss(METRICS[name].loss(np.array([0.5, 4.0])))
            for name in ("detectability", "delta_e")
        ],
        [[0.5, 4.0], [0.5, 4.0]],
    ),
    Claim(
        "NIIRS of the plane in focus, and at ten times its distance",
        lambda: [
            niirs_from(ground_distance_m=factor * CAMERA.object_distance_m) - niirs_from()
            for factor in (1, 10)
        ],
        [0, -3.32],
        atol=1e-9,
    ),
    Claim(
        "the ADC ends at its codes above black of 2 e-, less the dark charge",
        lambda: full_e(
            chain_of(
                pixel=PIXEL.model_copy(update={"gain_e_per_dn": 2.0, "dark_current_e_per_s": 1e4})
            ).readout,
            TIME_S,
        ),
        2 * (4095 - 64) - 1e4 * TIME_S,
        rtol=1e-12,
    ),
    *(
        Claim(
            f"slopes of codes at a well are those of their mean, {fields}",
            lambda fields=fields: slope_ratios(fields),
            np.ones((2, 3)),
            rtol=2e-3,
            why="differences of 0.1 e-",
        )
        for fields in (ENDS["well"], {}, {"bits": 8})
    ),
    *(
        Claim(
            f"rows and columns have the noise that codes at the {end} leave of 20 e-",
            lambda end=end: noise_of_lines(ENDS[end]),
            [1.0, 1.0],
            rtol=1e-6,
            why="float32 of the white",
        )
        for end in ("well", "ADC")
    ),
    Claim(
        "pixels that are full for sure have codes of their well, in read noise up to the top code",
        lambda: np.ravel(
            _ClippedExposure(
                chain_of(
                    pixel=PIXEL.model_copy(
                        update=ENDS["ADC"] | {"full_well_e": 2040.0, "read_noise_e": 40.0}
                    )
                ).readout,
                TIME_S,
            ).moments(np.array([6000.0]))[:2]
        ),
        np.ravel(
            moments_of_codes(
                np.array([64 + 2040 / ADC_AT_END_E_PER_DN]),
                np.array([40 / ADC_AT_END_E_PER_DN]),
                4095,
            )[:2]
        )
        * [ADC_AT_END_E_PER_DN, ADC_AT_END_E_PER_DN**2]
        - [64 * ADC_AT_END_E_PER_DN, 0.0],
        rtol=1e-9,
    ),
    Claim(
        "tables of a burst hold from their first signal, or up to their last",
        lambda: [
            top_table(burst_frame(), 8e4).low_e / top_table(burst_frame(), 8e4).signal_e[0],
            bottom_table(burst_frame(), 0.0).high_e / bottom_table(burst_frame(), 0.0).signal_e[-1],
        ],
        [1.0, 1.0],
    ),
    Claim(
        "a table of the shortest of three exposures is in electrons of the longer, up to its well",
        lambda: [
            shorter_table().low_e / shorter_table().signal_e[0],
            shorter_table().mean_e[0] / shorter_table().signal_e[0],
            shorter_table().variance_e2[0] - 16 * shorter_table().signal_e[0],
            shorter_table().mean_e[-1],
        ],
        [1.0, 1.0, 16**2 * (4.0**2 + 125 + DN_E**2 / 12), 16 * (20_000 - 125)],
        rtol=1e-4,
        why="the well and the top code cut off some of the noise at both ends",
    ),
    *(
        Claim(
            f"noise of pixels and of lines of 1000 e- {name}",
            lambda fields=fields: [
                part(Readout.of(derive(Pixel(**STATED | LINED | fields))), 1000.0, TIME_S)
                for part in (variance_of_pixels_e2, _line_variance_e2)
            ],
            [1000 + 16 + 10**2 + 100 + 20**2 + DN_E**2 / 12, 8**2 + 12**2],
            rtol=1e-6,
            why="noise that has a reading at its limit",
        )
        for name, fields in (
            ("of one reading", {}),
            ("that the longest of three exposures takes", {"readout": SHORTER}),
        )
    ),
    Claim(
        "full exposures of a burst have their wells less their dark charge",
        lambda: [full_table().mean_e[-1], *full_table().signal_slope[[0, 1, -1]]],
        [4 * 20_000 - 1e5 * TIME_S, 1.0, 1.0, 0.0],
        rtol=1e-6,
        why="rounding of codes",
    ),
    Claim(
        "tables are made where 6 σ of an exposure, c = 6 √(c + 4²) and w - 6 √c, reach its ends",
        lambda: [
            [
                bottom_table(FAINT, factor * FAINT_E) is None,
                top_table(FAINT, factor * BRIGHT_E) is None,
            ]
            for factor in (1 - 1e-9, 1 + 1e-9)
        ],
        [[0, 1], [1, 0]],
    ),
    Claim(
        "a blurred target of a contrast of -0.5, which is -0.05 in the light, ends at twice as much",
        lambda: [
            contrast_factor(stated_disc().expected(TIME_S), 5.0 / factor)[1] == DARKER
            for factor in (1.9, 2.1)
        ],
        [0, 1],
    ),
    *(
        Claim(
            f"MTF50 is where lens, pixel and a motion of {um_per_s} leave a half",
            lambda um_per_s=um_per_s: [
                optics.diffraction_otf(frequency, 550.0, CAMERA.effective_f_number)
                * np.sinc(0.004 * frequency)
                * np.sinc(1e-3 * TIME_S * max(um_per_s) * frequency)
                for frequency in numbers_of(
                    chain_of(
                        metrics=request("mtf50"),
                        motion=Motion(image_um_per_s=um_per_s),
                        border_um=40.0,
                    ),
                    "mtf50",
                )
            ],
            [0.5],
            atol=1e-4,
            why="straight between the frequencies of the table",
        )
        for um_per_s in ((0.0, 0.0), (400.0, 0.0), (0.0, 400.0))
    ),
    Claim(
        "MTF50 of apertures of a tenth of the pitch: more than 4 cycles a pixel, the table's end",
        lambda: numbers_of(chain_of(pixel=Pixel(**SPARSE), metrics=request("mtf50")), "mtf50"),
        [40.0],
        rtol=1e-12,
    ),
    Claim(
        "codes far from both ends have no table",
        lambda: [
            int(table is None)
            for table in (
                top_table(chain_of().expected(TIME_S), 15_000.0),
                bottom_table(chain_of().expected(TIME_S), 0.0),
            )
        ],
        [1, 1],
    ),
]


# --- a target in the raw frame


@pytest.mark.parametrize(
    ("lines", "axis"), [({"column_fpn": 320.0 / 20_000}, 1), ({"row_noise_e": 320.0}, 0)]
)
def test_line_noise_hides_bars_along_its_lines_alone(lines: dict[str, float], axis: int) -> None:
    """Offsets of 20 times the noise: of 100 pixels each, bars along them lose √(1 + 100 · 400),
    others nothing. Shot noise and rounding are 4 % of the variance.
    """

    def d_prime(picture: np.ndarray, **fields: float) -> float:
        pixel = PIXEL.model_copy(update={"read_noise_e": 16.0} | fields)
        chain = chain_of(
            light(picture), pixel, light(0.9), request("detectability"),
            exposure=Exposure(integration_s=1e-4),  # 10 e- of light
        )  # fmt: skip
        return _d_prime(chain.expected(1e-4))

    bars = np.tile(np.repeat([1.0, 0.8], 4), (200, 25))
    losses = [d_prime(picture) / d_prime(picture, **lines) for picture in (bars.T, bars)]
    assert losses[axis] == pytest.approx(math.sqrt(1 + 100 * 400), rel=0.05)
    assert losses[1 - axis] == pytest.approx(1, rel=1e-6)


def test_detectability_is_the_mean_over_registrations_and_the_worst() -> None:
    """A target of one pixel is shared by up to four; 16 registrations are the default, over all
    frames of a size.
    """
    chain = chain_of(
        with_disc(0.5, 1.0), background=UNIFORM, metrics=request("detectability", repeats=4)
    )
    drawn = chain.capture("a")
    under_tests = [FrameUnderTest.of(chain, drawn, number) for number in range(4)]
    all_frames = [list(under_test.registrations(16)) for under_test in under_tests]
    places = {frame.readout.physics.registration for frames in all_frames for frame in frames[1:]}
    assert len(places) == 12
    d_prime = [_d_prime(frame) for frame in all_frames[0]]
    np.testing.assert_allclose(
        METRICS["detectability"].compute(under_tests[0]),
        [np.mean(d_prime), min(d_prime), 5 / np.mean(d_prime)],
        rtol=1e-12,
    )
    assert min(d_prime) < 0.995 * np.mean(d_prime)


@pytest.mark.parametrize(
    ("contrast", "background", "factor", "reason"),
    [
        (-0.05, 1.0, None, ""),
        (0.05, 1.0, None, ""),
        (1.0, 15.0, None, "pixels are full with the target"),
        (-0.05, 400.0, None, "pixels are full without the target"),
        (0.0, 1.0, None, "the target changes no pixel"),
        # 1 % of the mean below 0 is noise of a render.
        (-0.05, 1.0, 20.19, ""),
        (-0.05, 1.0, 20.21, DARKER),
        (0.05, 1.0, (0.999 / UNIFORM_SHARE - 1) / 0.05, ""),
        (0.05, 1.0, (1.001 / UNIFORM_SHARE - 1) / 0.05, "pixels are full with that much contrast"),
    ],
)
def test_contrast_factor_is_the_threshold_over_d_prime(
    contrast: float, background: float, factor: float | None, reason: str
) -> None:
    """Of the target's own d′, or of that of a stated factor. Where no picture clips and no light is
    negative; else 1e12, and the reason.
    """
    options = {"detectability": {"registrations": 1, "threshold": 7.0}}
    image, without = (
        light(background * scene.data[..., 0] / 2e-4) for scene in (with_disc(contrast), UNIFORM)
    )
    chain = chain_of(image, background=without, metrics=request("detectability", **options))
    d_prime, _, column = numbers_of(chain, "detectability")
    if factor is not None:
        d_prime = 7.0 / factor
    expected = pytest.approx(MAX_D_PRIME if reason else 7.0 / d_prime)
    assert contrast_factor(chain.expected(TIME_S), d_prime) == (expected, reason)
    assert factor is not None or column == expected


# --- codes at both ends


@pytest.mark.parametrize(
    ("fields", "subexposures"),
    [
        (NEAR_0 | {"read_noise_e": 4.0}, 1),
        (NEAR_0 | {"read_noise_e": 25.0, "bits": 9}, 1),
        (NEAR_0 | {"read_noise_e": 20.0}, 4),
        (SMALL_WELL | ENDS["ADC"], 1),
        (SMALL_WELL | {"black_level_dn": 1000, "gain_e_per_dn": 2000.0 / 3095, "full_well_e": 4000.0}, 1),
        (SMALL_WELL | ENDS["well"], 4),
        (SMALL_WELL | {"bits": 7, "black_level_dn": 4.0}, 1),
        (SMALL_WELL | {"read_noise_e": 40.0, "offset_fpn": 0.01, "prnu": 0.02}, 1),
        (SMALL_WELL | SOFT_WELL, 1),
        (SMALL_WELL | {"bits": 16, "prnu": 0.02}, 4),
    ],
    ids=["0", "0, few bits", "0, burst", "ADC", "ADC of a high black level", "burst at the well", "few bits", "noisy",
         "soft well", "burst with PRNU"],
)  # fmt: skip
def test_codes_at_their_ends_have_the_moments_of_frames(fields: dict, subexposures: int) -> None:
    """Up to 8 times the noise from code 0, or from 90 to 110 % of the upper end.

    Means within 4 standard errors of 90 000 pixels (6e-5 of seeds fail) and 0.5 % of the noise,
    variances within 5 % or 0.1 % of that without the ends: both for the skewness of few electrons.
    """
    rng = np.random.default_rng(45)
    chain = chain_of(pixel=PIXEL.model_copy(update=fields))
    chain = replace(chain, readout=chain.readout.burst(subexposures))
    readout = chain.readout
    frame = chain.expected(TIME_S)
    if "black_level_dn" in fields and fields["black_level_dn"] == 0:
        levels_e = subexposures * fields["read_noise_e"] * np.array([0.0, 0.5, 1.0, 3.0, 8.0])
        table = bottom_table(frame, 0.0)
    else:
        levels_e = readout.saturation_e * np.array([0.9, 0.97, 1.0, 1.02, 1.1])
        table = top_table(frame, readout.saturation_e)
    assert table is not None
    sensor = sample_sensor(readout, (300, 300), rng)
    for level_e in levels_e:
        drawn_dn = read_out(np.full(sensor.shape, level_e), TIME_S, sensor, rng)
        drawn_e = (drawn_dn - readout.black_level_dn) / readout.dn_per_e
        drawn_e -= readout.dark_current_e_per_s * TIME_S
        unclipped_e2 = variance_of_pixels_e2(readout, level_e, TIME_S)
        moments = code_moments([table], np.array(level_e), unclipped_e2)
        assert drawn_e.mean() == pytest.approx(
            float(moments.mean_e), abs=(4 / 300 + 5e-3) * math.sqrt(unclipped_e2)
        )
        assert drawn_e.var() == pytest.approx(
            float(moments.variance_e2), rel=0.05, abs=1e-3 * unclipped_e2
        )


@pytest.mark.parametrize(("end", "share"), [("well", 0.99), ("ADC", 0.9), ("ADC", 1.01)])
def test_detectability_where_codes_clip_has_their_moments(end: str, share: float) -> None:
    """The ideal observer of the mean codes, of the mean of both variances, and of offsets of columns
    by their slopes.
    """
    fields = SMALL_WELL | ENDS[end] | {"prnu": 0.01}
    fields["column_fpn"] = 3.0 / fields["full_well_e"]
    chain = chain_of(
        with_disc(-0.05), PIXEL.model_copy(update=fields), UNIFORM, request("detectability")
    )
    scale = share * 2000.0 / float(chain.background_e_per_s.max())
    frame = chain.expected(scale)
    tables = code_tables(frame, frame.signal_e, frame.background_e)
    unclipped_e2 = variance_of_pixels_e2(chain.readout, frame.background_e, scale)
    target, background = (
        code_moments(tables, signal_e, unclipped_e2)
        for signal_e in (frame.signal_e, frame.background_e)
    )
    expected = kernels.detectability(
        target.mean_e - background.mean_e,
        (target.variance_e2 + background.variance_e2) / 2,
        column_variance=9.0,
        offset_slopes=np.stack([target.offset_slope, background.offset_slope]),
    )
    assert _d_prime(frame) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("columns_e", [0.0, 5.0])
def test_pixels_with_certain_codes_count_nothing(columns_e: float) -> None:
    """Half of the pixels are at five times the ADC's end: d′ is that of the other half."""
    chain = chain_of(
        UNIFORM,
        PIXEL.model_copy(update=SMALL_WELL | ENDS["ADC"] | {"column_fpn": columns_e / 4000.0}),
        UNIFORM,
        request("detectability"),
    )

    def d_prime(width: int) -> float:
        target_e, background_e = (
            np.repeat([levels_e], 10, axis=1)[:, :width] * np.ones((20, 1))
            for levels_e in ([950.0, 9900.0], [1000.0, 10000.0])
        )
        rates = replace(
            chain, signal_e_per_s=target_e / TIME_S, background_e_per_s=background_e / TIME_S
        )
        return _d_prime(rates.expected(TIME_S))

    assert d_prime(20) == pytest.approx(d_prime(10), rel=1e-9)


# --- a target on the display


LINES = {"column_fpn": 1.5e-3, "row_noise_e": 30.0, "prnu": 0.01}  # 30 e- each
NOISY: dict[str, tuple[dict, dict, dict]] = {
    "sharpened lines": (LINES, {}, {"develop": Develop(sharpen_amount=1.0)}),
    "cubic": ({"pitch_um": 11.0}, {"interpolation": "cubic"}, {}),
    "pixels": ({"row_noise_e": 30.0}, {"raster": "one_to_one"}, {}),
    "corrected": (
        LINES | {"stack": OPENING, "fill_factor": 0.5},
        {},
        {
            "camera": CAMERA.model_copy(update={"focal_length_mm": 0.5}),
            "correction": Correction(dark_frames=2, flat_frames=2, column_clamp=4),
        },
    ),
    "code 0": (
        {"black_level_dn": 0, "read_noise_e": 150.0},
        {},
        {"exposure": Exposure(integration_s=4e-4)},
    ),
    "sRGB": ({}, {}, {"develop": Develop(tone_curve="srgb")}),
}


@pytest.mark.parametrize("case", NOISY)
def test_npwe_has_the_noise_of_frames(case: str) -> None:
    """d′ in the mean spectrum of the noise of many sensors and frames.

    Noise of whole lines lies in about 5 frequencies of the target's band: 100 exponentials give d′
    to 1/√(5 · 100)/2 = 2.2 %; white noise lies in some 40 of them: 40 to 1.25 %. The gate is 3.6 σ,
    a false alarm in 3000; a source that is left out is 10 % and more.
    """
    fields, of_display, settings = NOISY[case]
    count, share = (100, 0.022) if "row_noise_e" in fields else (40, 0.0125)
    display = DISPLAY.model_copy(update={"dots": 32} | of_display)
    pixel = Pixel(**STATED | fields)
    metrics = request("npwe", **ONE_REGISTRATION)
    chain = chain_of(with_disc(0.2, 25.0), pixel, UNIFORM, metrics, display=display, **settings)
    frames = [chain.capture("many", number) for number in range(count)]
    pictures = np.array([chain.development.light(frame) for frame in frames], float)
    spectra = np.abs(np.fft.fft2(pictures - pictures.mean(axis=0))) ** 2
    scale = count / (count - 1) / pictures[0].size / display.samples_per_deg**2
    _, difference = _expected_light(frames[0], chain.expected(frames[0].integration_s))
    expected = kernels.npwe(difference, scale * spectra.mean(axis=0), display.samples_per_deg)
    assert numbers_of(chain, "npwe")[0] == pytest.approx(expected, rel=3.6 * share)


# --- information, NEQ and MTF


def test_information_of_a_flat_spectrum() -> None:
    """½∬ log₂(1 + S|T|²/(N + A)); 5e-3 for a mean over points in place of Simpson's rule."""
    # With as much power in aliases as noise has.
    chain = chain_of(
        metrics=request("information", information={"corner_cy_per_mm": 3e4, "contrast": 10.0})
    )
    frame = chain.expected(TIME_S)
    mean_e = TIME_S * float(chain.signal_e_per_s.mean())
    noise = (mean_e + fixed_e2(chain)) * 0.004**2
    white = (10 * mean_e) ** 2 / (2 * math.pi * math.log(2)) / 3e4**2
    axis = np.linspace(-125.0, 125.0, 251)

    def power(i: int, j: int) -> np.ndarray:
        return white * sensor_mtf(frame, axis + 250.0 * i, axis[:, None] + 250.0 * j) ** 2

    folded = sum(power(i, j) for i in range(-2, 3) for j in range(-2, 3) if i or j)
    expected = 0.5 * 250.0**2 * float(np.log2(1 + power(0, 0) / (noise + folded)).mean())
    bits, bits_per_deg2, *_ = numbers_of(chain, "information")
    assert bits == pytest.approx(expected, rel=5e-3)
    assert bits_per_deg2 == pytest.approx(
        bits * (CAMERA.image_distance_mm * math.pi / 180) ** 2, rel=1e-12
    )


def test_information_of_the_scene_does_not_depend_on_the_film() -> None:
    """In cells of 2 and 4 µm, within 1 %; it has no other contrasts. Black has none."""
    wave = np.random.default_rng(3).normal(size=(200, 200))
    frequency = np.hypot(np.fft.fftfreq(200)[:, None], np.fft.rfftfreq(200))
    smooth = np.fft.irfft2(np.fft.rfft2(wave) * np.exp(-((60 * frequency) ** 2) / 8))
    picture = 1 + 0.2 * smooth / smooth.std()
    coarse = picture.reshape(100, 2, 100, 2).mean(axis=(1, 3))
    metric = MetricOptions(information={"spectrum": "scene"})
    fine, other, black = (
        evaluated(image, "information", metric=metric)
        for image in (light(picture), light(coarse, 2 * CELL_UM), light(0.0))
    )
    assert other["information"] == pytest.approx(fine["information"], rel=0.01)
    assert list(fine) == ["information", "information_bits_per_deg2"]
    assert set(black.values()) == {0.0}


def test_veil_is_noise_and_no_signal() -> None:
    """With the glare g, and s times as much from outside, pixels see 1 + g s times the light, and
    (1 - g) of it are signal.
    """
    camera = CAMERA.model_copy(update={"veiling_glare": 0.2, "veiling_glare_outside": 3.0})
    chain = chain_of(camera=camera)
    plain_e = TIME_S * float(chain_of().signal_e_per_s.mean())
    pixels_e = plain_e * (1 + 0.2 * 3.0)
    assert TIME_S * float(chain.signal_e_per_s.mean()) == pytest.approx(pixels_e, rel=1e-6)
    expected = (plain_e * (1 - 0.2)) ** 2 / (pixels_e + fixed_e2(chain)) / 0.004**2
    assert neq_along(chain.expected(TIME_S))[1][0] == pytest.approx(expected, rel=1e-6)
    inside = camera.model_copy(update={"veiling_glare_outside": 0.0})
    bits = [numbers_of(chain_of(camera=c), "information")[0] for c in (CAMERA, inside, camera)]
    assert bits[0] > bits[1] > bits[2]


@pytest.mark.parametrize("tilt_deg", [5.0, 85.0])
def test_sensor_mtf_is_that_of_a_slanted_edge(tilt_deg: float) -> None:
    """Of the expected signal behind lens and pixels, along both axes; its sampled edge spread errs
    by less than 0.02.
    """
    y, x = np.mgrid[:1000, :1000] + 0.5
    edge = (x - 500 + math.tan(math.radians(5.0)) * (y - 500) > 0).astype(float)
    picture = 0.2 + 0.6 * edge.reshape(200, 5, 200, 5).mean(axis=(1, 3))
    turned = np.transpose if tilt_deg > 45 else np.asarray
    chain = chain_of(light(turned(picture), diffraction=True))
    frequency = np.linspace(0.0, 0.45, 10)
    along = frequency * 1e3 / 4.0
    tilt = math.radians(tilt_deg)
    np.testing.assert_allclose(
        kernels.edge_mtf(turned(chain.signal_e_per_s[10:-10, 10:-10]), 5.0, frequency),
        sensor_mtf(chain.expected(TIME_S), along * math.cos(tilt), along * math.sin(tilt)),
        atol=0.02,
    )


# --- visual noise, SNR, NIIRS


@pytest.mark.parametrize("glare", [0.0, 0.2])
def test_niirs_of_two_surfaces_in_a_veil(glare: float) -> None:
    """GIQE-5 of their difference, 1 - g of that without, with the noise of the veil and of lines."""
    camera = CAMERA.model_copy(update={"veiling_glare": glare, "object_distance_m": 1000.0})
    pixel = PIXEL.model_copy(update=LINE_NOISE)
    chain = chain_of(camera=camera, metrics=request("niirs"), pixel=pixel)
    plain = chain_of(camera=camera.without_veil)
    white_e = TIME_S * plain.white_e_per_s * (1 - glare)
    veil_e = glare * TIME_S * float(plain.signal_e_per_s.mean())
    snr = 0.08 * white_e / math.sqrt(0.15 * white_e + veil_e + fixed_e2(chain) + 8**2 + 12**2)
    along, mtf = _mtf_along(chain.expected(TIME_S))
    expected = kernels.niirs(
        kernels.relative_edge_response(along * 0.004, mtf),
        1e-6 * 4.0 / abs(camera.magnification),
        snr,
    )
    assert numbers_of(chain, "niirs") == (pytest.approx(expected, rel=1e-6),)


# --- what a configuration has to have


CHANNELS = {
    name: [[nm, 0.5 * (low <= nm < low + 100)] for nm in range(400, 701, 20)]
    for name, low in {"B": 400, "G": 500, "R": 600}.items()
}
VISIBLE = range(400, 701, 20)
OF_COLOUR = "delta_e", "detectability", "flip", "contrast_detection_probability"
# Pattern, bands, metrics that are defined, and the reason why others are not.
SITUATIONS: dict[str, tuple[str, range, set[str], str]] = {
    "grey": ("", VISIBLE, set(METRICS), ""),
    "mosaic": ("rggb", VISIBLE, {*OF_COLOUR}, "without colour filters"),
    "stacked": ("stacked", VISIBLE, {*OF_COLOUR}, "without colour filters"),
    "no target": ("", VISIBLE, set(METRICS) - {"detectability", "npwe"}, "without its target"),
    "infrared": ("", range(840, 901, 20), set(), "both the sensor and the eye"),
}


@pytest.mark.parametrize("situation", SITUATIONS)
def test_every_metric_has_a_number_or_says_what_it_needs(situation: str) -> None:
    pattern, nm, defined, reason = SITUATIONS[situation]
    here = set(METRICS) - (set() if find_spec("flip_evaluator") else {"flip"})
    colour = ColourOptions(quantum_efficiencies=CHANNELS, pattern=pattern) if pattern else None
    fields = {"quantum_efficiency": None, "colour": colour} if pattern else {}
    disc = 1.0 + 0.1 * (np.hypot(*(np.mgrid[:100, :100] - 49.5)) < 20.0)
    image, without = (
        SpectralImage(nm, 20.0, 4.0, data=np.float32(2e-5 * plane)[..., None] * np.ones(len(nm)))
        for plane in (disc, np.ones((100, 100)))
    )
    settings = FRAME | {"pixel": PIXEL.model_copy(update=fields)}
    target = {} if situation == "no target" else {"without": without}
    if names := defined & here:
        score = evaluate(image, metrics=sorted(names), **settings, **target)
        assert names == {
            name
            for name, value in score.metrics.items()
            if np.clip(value, *METRICS[name].bounds) == value and math.isfinite(value)
        }
    for name in here - defined:
        beside = target if name in ("detectability", "npwe") else {}
        with pytest.raises(PixsimError, match=reason):
            evaluate(image, metrics=[name], **settings, **beside)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("npwe", {"develop": Develop(denoise="wavelet")}),
        ("npwe", {"develop": Develop(denoise="wiener_bound")}),
        ("visual_noise", {"develop": Develop(denoise="wiener_bound")}),
        ("visual_noise", {"exposure": Exposure(integration_s=20.0)}),
        ("niirs", {"exposure": Exposure(integration_s=20.0)}),
        ("detectability", {"pixel": PIXEL.model_copy(update={"bits": 6, "black_level_dn": 4.0})}),
        ("snr10_lx", {"pixel": PIXEL.model_copy(update={"prnu": 0.5})}),
    ],
    ids=str,
)
def test_undefined_metric_is_nan_beside_others(name: str, settings: dict) -> None:
    """And alone it is an error, of the same reason."""
    if name in ("npwe", "detectability"):
        settings = settings | {"without": UNIFORM}
    with pytest.raises(NoNumberError, match=f"the metric {name}: got"):
        evaluated(with_disc(0.05), name, **settings)
    settings = FRAME | {"pixel": PIXEL, "metrics": ["delta_e", name]} | settings
    with pytest.warns(UserWarning, match=f"the metric {name}: got"):
        score = evaluate(with_disc(0.05), **settings)
    assert [math.isnan(score.metrics[metric]) for metric in ("delta_e", name)] == [False, True]


WHITE = np.array([95.047, 100.0, 108.883])
PITCH_MM = 0.005
DFT = np.fft.fftfreq(32, PITCH_MM)


def difference_and_variance(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return both in 64ths, exact in binary."""
    rng = np.random.default_rng(np.random.SeedSequence(44))
    return np.round(64 * rng.normal(size=shape)) / 64, np.round(
        64 * rng.uniform(0.5, 3.0, shape)
    ) / 64


# --- kernels: observers


@pytest.mark.parametrize(
    ("shape", "column_variance", "row_variance", "has_slopes", "decades"),
    [
        *(
            (shape, *variances, has_slopes, 0.0)
            for shape, *variances in (
                ((20, 20), 0.0, 0.0),
                ((20, 20), 2.0, 0.01),
                ((40, 10), 2.0, 0.5),
                ((8, 50), 0.0, 3.0),
            )
            for has_slopes in (False, True)
        ),
        ((24, 36), 3e3, 3e3, False, 4 * np.random.default_rng(8).uniform(-0.5, 0.5, (24, 36))),
        # Each row shares a column with the next one alone: offsets go through all of them.
        (
            (40, 41),
            1e4,
            1e4,
            False,
            9.0 * (np.abs(np.mgrid[:40, :41][1] - np.mgrid[:40, :41][0] - 0.5) > 1)
            + np.random.default_rng(8).uniform(-2.0, 2.0, (40, 41)),
        ),
    ],
)
def test_detectability_is_that_of_the_dense_covariance(
    shape: tuple[int, int],
    column_variance: float,
    row_variance: float,
    has_slopes: bool,
    decades: float | np.ndarray,
) -> None:
    """√(Δᵀ K⁻¹ Δ); with slopes of the offsets K is the mean of both pictures' covariances. Also of
    variances of four decades, offsets 30 times the largest of them, and a chain of pixels.
    """
    difference, variance = difference_and_variance(shape)
    rng = np.random.default_rng(7)
    slopes = np.ones((2, *shape))
    if has_slopes:  # of two rows 0
        slopes = rng.uniform(0.0, 1.0, slopes.shape) * (np.arange(shape[0]) // 2 != 1)[:, None]
    variance = variance * 10.0**decades
    row, column = np.divmod(np.arange(variance.size), shape[1])
    lines = column_variance * (column[:, None] == column) + row_variance * (row[:, None] == row)
    covariance = np.diag(variance.ravel())
    for slope in slopes.reshape(2, -1):
        covariance += lines * np.outer(slope, slope) / 2
    delta = difference.ravel()
    options: dict = {"offset_slopes": slopes} if has_slopes else {}
    options |= {"column_variance": column_variance, "row_variance": row_variance}
    assert kernels.detectability(difference, variance, **options) == pytest.approx(
        math.sqrt(delta @ np.linalg.solve(covariance, delta)), rel=1e-9
    )


@pytest.mark.parametrize(("column_variance", "row_variance"), [(1e12, 1e-3), (1e12, 1e12)])
def test_detectability_with_offsets_far_above_the_noise(
    column_variance: float, row_variance: float
) -> None:
    """By elimination in fractions, which rounds nothing; floating point could not invert it."""
    difference, variance = difference_and_variance((4, 6))
    places = list(np.ndindex(4, 6))
    matrix = [
        [
            Fraction(column_variance) * (a[1] == b[1])
            + Fraction(row_variance) * (a[0] == b[0])
            + Fraction(variance[a]) * (a == b)
            for b in places
        ]
        for a in places
    ]
    values = [Fraction(value) for value in difference.ravel().tolist()]
    squared = Fraction(0)
    for pivot, row in enumerate(matrix):
        squared += values[pivot] ** 2 / row[pivot]
        for below in range(pivot + 1, len(values)):
            factor = matrix[below][pivot] / row[pivot]
            values[below] -= factor * values[pivot]
            matrix[below] = [
                low - factor * high for low, high in zip(matrix[below], row, strict=True)
            ]
    offsets = {"column_variance": column_variance, "row_variance": row_variance}
    assert kernels.detectability(difference, variance, **offsets) == pytest.approx(
        math.sqrt(squared), rel=1e-10
    )


def test_pixels_of_infinite_variance_count_nothing() -> None:
    """A frame with a lost row and column is the smaller frame, however large their difference."""
    difference, variance = difference_and_variance((9, 12))
    lost = variance.copy()
    lost[3] = lost[:, 7] = np.inf
    smaller = [
        np.delete(np.delete(values, 3, axis=0), 7, axis=1) for values in (difference, variance)
    ]
    offsets = {"column_variance": 2.0, "row_variance": 0.3}
    difference[3] = 1e9
    assert kernels.detectability(difference, lost, **offsets) == pytest.approx(
        kernels.detectability(*smaller, **offsets), rel=1e-12
    )
    assert kernels.detectability(difference, np.full(lost.shape, np.inf)) == 0.0


def test_template_has_the_signal_and_noise_of_npwe() -> None:
    """And NPWE never exceeds the ideal observer."""
    y, x = np.ogrid[-16:17, -16:17]
    target = np.where(np.hypot(y, x) <= 4, 0.1, 0.0)
    template = kernels.npwe_template(target, 25.0)
    d_prime = kernels.npwe(target, np.array(0.2**2 / 25.0**2), 25.0)
    assert d_prime == pytest.approx(
        (template * target).sum() / (0.2 * math.sqrt((template**2).sum())), rel=1e-12
    )
    assert d_prime < kernels.detectability(target, np.array(0.2**2))


# --- kernels: spectra


def natural(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A natural scene behind square pixels without gaps."""
    mtf = np.sinc(x * PITCH_MM) * np.sinc(y * PITCH_MM)
    return kernels.natural_spectrum(np.hypot(y, x), 1.0, 20.0) * mtf**2


def test_information_falls_with_aliases_and_with_noise() -> None:
    axis = np.linspace(-100.0, 100.0, 33)
    signal = natural(axis[:, None], axis)
    folded = kernels.folded_spectrum(natural, axis, 1e3 * PITCH_MM)
    clean, aliased, noisy = (
        kernels.information_bits_per_mm2(axis, signal, noise, aliases)
        for noise, aliases in ((1e-5, 0.0), (1e-5, folded), (2e-5, folded))
    )
    assert 0.5 * clean < noisy < aliased < 0.99 * clean


def test_folded_spectrum_of_a_gaussian_by_poissons_sum() -> None:
    """Σ_k P(f + k/p) = p s √π Σ_n e^(-(π n p s)²) cos(2π n p f), in each axis."""

    def power(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(-(y**2 + x**2) / 90.0**2)

    n = np.arange(-8, 9)[:, None]
    terms = np.exp(-((np.pi * n * PITCH_MM * 90) ** 2)) * np.cos(2 * np.pi * n * PITCH_MM * DFT)
    series = PITCH_MM * 90 * math.sqrt(math.pi) * terms.sum(axis=0)
    np.testing.assert_allclose(
        kernels.folded_spectrum(power, DFT, 1e3 * PITCH_MM, orders=4),
        series[:, None] * series - power(DFT[:, None], DFT),
        rtol=1e-10,
        atol=1e-14,
    )


def random_light(size: int, width_mm: float) -> np.ndarray:
    """Return means over cells of one piece of light: waves of spectrum C/(f² + f₀²) up to 60 cy/mm,
    one in each 2 × 2.
    """
    rng = np.random.default_rng(44)
    grid = np.mgrid[-60:60:2.0, -60:60:2.0] + 2.0 * rng.random((2, 60, 60))
    fy, fx = grid.reshape(2, -1)
    frequency = np.hypot(fy, fx)
    power = kernels.natural_spectrum(frequency, 1.0, 20.0) * (frequency < 60.0)
    amplitude = 2.0 * np.sqrt(2 * power) * np.exp(2j * np.pi * rng.random(fy.size))
    place_mm = ((np.arange(size) + 0.5) / size * width_mm)[:, None]
    along_y, along_x = (
        np.sinc(f * width_mm / size) * np.exp(2j * np.pi * f * place_mm) for f in (fy, fx)
    )
    return ((amplitude * along_y) @ along_x.T).real


def test_radial_spectrum_is_that_of_random_light_on_any_film() -> None:
    """Of two films to 1 %. Each ring has about 2π f Δf · 1.2 mm² places of error 1: the mean of 38
    is 1 within 1.5 %, and 5 % is 3 of that.
    """
    (_, coarse), (frequency, power) = (
        kernels.radial_spectrum(random_light(n, 1.5), 1.5e3 / n) for n in (192, 288)
    )
    band = (frequency > 5.0) & (frequency < 55.0)
    np.testing.assert_allclose(power[: coarse.size][band[: coarse.size]],
                               coarse[band[: coarse.size]], rtol=1e-2)  # fmt: skip
    ratio = power / kernels.natural_spectrum(frequency, 1.0, 20.0)
    assert ratio[band].mean() == pytest.approx(1.0, abs=0.05)
    assert (power[frequency > 62.0] < 1e-5 * power[0]).all()


# --- kernels: visible noise


CHROMA = (
    (((109.1413, 0.00038, 3.4244), (93.5971, 0.00367, 2.1677)), 202.7384),
    (((7.0328, 4e-6, 4.2582), (40.691, 0.10391, 1.6487)), 40.691),
)


@pytest.mark.parametrize("adapted", [[1, 0, 0], [0, 0, 1], [2, 1, 0.5]])
def test_visual_noise_of_a_coloured_wave(adapted: list[float]) -> None:
    """Of the adapted observer X alone is C₁ alone, Z alone is C₂ alone, and the last is all three:
    each behind its own filter, and the change of L*, u* and v* to first order.
    """
    bradford = RESPONSES["bradford"]
    cones = np.diag(bradford.sum(axis=1) / (bradford @ WHITE)) @ bradford
    opponent = np.array([[0, 1, 0], [1, -1, 0], [0, 0.4, -0.4]]) @ np.linalg.inv(bradford) @ cones
    step = np.linalg.solve(np.linalg.inv(bradford) @ cones, adapted) * 1e-6
    cy_per_deg = 17 / 2 / 64 * 40.0
    gains = [
        75 * cy_per_deg**0.8 * math.exp(-0.2 * cy_per_deg) / 34.05,
        *(
            sum(w * math.exp(-d * cy_per_deg**p) for w, d, p in terms) / scale
            for terms, scale in CHROMA
        ),
    ]
    seen = np.linalg.solve(opponent, gains * (opponent @ step))
    grey = 0.2 * WHITE
    weights = np.array([1.0, 15.0, 3.0])
    total = grey @ weights
    chroma = [
        factor * (seen[i] / total - grey[i] * (seen @ weights) / total**2)
        for i, factor in ((0, 4.0), (1, 9.0))
    ]
    change = abs(116 / 3 * 0.2 ** (-2 / 3) * seen[1] / WHITE[1]) + 13 * (
        116 * np.cbrt(0.2) - 16
    ) * (0.852 * abs(chroma[0]) + 0.323 * abs(chroma[1]))
    wave = np.cos(np.pi * 17 * (np.arange(64) + 0.5) / 64)[None, :, None] * np.ones((64, 1, 1))
    assert kernels.visual_noise(grey + wave * step, 40.0) == pytest.approx(
        change / math.sqrt(2), rel=1e-4
    )


# --- kernels: edges, curves, visible noise and SNR as rows


def edge(angle_deg: float, rise: float) -> np.ndarray:
    """Return an edge behind a Gaussian blur of 0.5 px, clockwise with row 0 on top."""
    angle = math.radians(angle_deg)
    place = np.arange(96) - 47.5
    return 0.2 + rise * ndtr((math.cos(angle) * place + math.sin(angle) * place[:, None]) / 0.5)


def snr_of_dot(lux: float) -> float:
    """Return √n µ/√(µ + σ² + (PRNU µ)²) of `NOISY_DOT` in a light."""
    mean_e = lux * 0.9 / math.pi * 4.0
    return math.sqrt(2.5) * mean_e / math.sqrt(mean_e + 80.0 + (0.02 * mean_e) ** 2)


def has_number(value: float | None) -> int:
    return int(value is not None)


FREQUENCY = np.linspace(0.0, 20.0, 2001)
FALLING = 1 - FREQUENCY / 30
EDGE_CY_PER_PX = np.linspace(0.0, 1.0, 21)
GREY_NOISE = 0.2 + np.random.default_rng(44).normal(0.0, 0.01, (32, 48))
NOISY_DOT = {"reflectance": 0.9, "prnu": 0.02, "pixels_per_dot": 2.5}
KERNEL_CLAIMS = [
    *(
        Claim(
            f"edge of {angle_deg}° behind a Gaussian, also beyond the Nyquist frequency",
            lambda angle_deg=angle_deg, rise=rise: kernels.edge_mtf(
                edge(angle_deg, rise), angle_deg, EDGE_CY_PER_PX
            ),
            np.exp(-2 * (np.pi * 0.5 * EDGE_CY_PER_PX) ** 2),
            atol=1e-4,
            why="straight between samples",
        )
        for angle_deg, rise in ((5.0, 0.7), (-5.0, 0.7), (12.0, -0.1))
    ),
    Claim(
        "an upright edge that rises within a pixel",
        lambda: kernels.edge_mtf(np.tile([0.2, 0.2, 0.9, 0.9], (3, 1)), 0.0, EDGE_CY_PER_PX),
        np.sinc(EDGE_CY_PER_PX),
        atol=1e-14,
    ),
    Claim(
        "MTF50 is on the chord",
        lambda: kernels.mtf50(np.arange(4.0), np.array([1.0, 0.8, 0.4, 0.3])),
        1.75,
        rtol=1e-14,
    ),
    Claim(
        "the chart's edge has 5° clockwise",
        lambda: kernels.edge_mtf(make_chart("slanted_edge", 64, 64).astype(float), 5.0, 0.5),
        2 / np.pi,
        atol=0.01,
        why="64 rows; the other way they would smear the edge over 11.2 px",
    ),
    *(
        Claim(
            f"aliases of equal power of {orders} orders",
            lambda orders=orders: kernels.folded_spectrum(
                lambda y, x: 1.0 + 0 * y + 0 * x, DFT, 5.0, orders=orders
            ),
            np.full((32, 32), (2 * orders + 1) ** 2 - 1),
        )
        for orders in (1, 3)
    ),
    Claim(
        "rings are 2 of 24 cells wide, up to the Nyquist frequency",
        lambda: kernels.radial_spectrum(GREY_NOISE[:24], 5.0)[0],
        np.arange(1, 7) / 12 / PITCH_MM,
        rtol=1e-14,
    ),
    Claim(
        "the mean of a picture has no power",
        lambda: (
            kernels.radial_spectrum(GREY_NOISE + 5, 5.0)[1]
            / kernels.radial_spectrum(GREY_NOISE, 5.0)[1]
        ),
        np.ones(8),
        rtol=1e-9,
    ),
    *(
        Claim(
            f"information of white spectra at frequencies with an error of 0.7e-6 of a cell, {name}",
            lambda axis=axis: kernels.information_bits_per_mm2(axis, 3.0, 1.0),
            4e12,
            rtol=1e-6,
            why="the error",
        )
        # Frequencies that differ far more than 1.
        for name, axis in {
            "square": np.append(np.arange(-1e6, 9.9e5, 1e5), 1e6 + 0.07),
            "DFT": np.fft.fftfreq(32, 5e-7) + 0.35e-6 * 1e6 / 16,
            "DFT, odd": np.fft.fftfreq(33, 5e-7) + 0.35e-6 * 2e6 / 33,
        }.items()
    ),
    *(
        Claim(
            f"{name} of a curve that does not begin at 0, where it is 1",
            lambda judge=judge: judge(FREQUENCY[1:], FALLING[1:]) / judge(FREQUENCY, FALLING),
            1.0,
            rtol=1e-12,
        )
        for name, judge in (
            ("acutance", kernels.acutance),
            ("MTF50", kernels.mtf50),
            ("edge response", kernels.relative_edge_response),
        )
    ),
    Claim(
        "a curve that stays high has no MTF50",
        lambda: has_number(kernels.mtf50(np.array([0.0, 1.0]), np.array([1.0, 0.6]))),
        0,
    ),
    *(
        Claim(
            f"grey noise as colours in a white of {white.tolist()}",
            lambda white=white: (
                kernels.visual_noise(GREY_NOISE[..., None] * white, 30.0, white_xyz=white)
                / kernels.visual_noise(GREY_NOISE, 30.0)
            ),
            1.0,
            rtol=1e-9,
        )
        for white in (WHITE, np.ones(3))
    ),
    Claim(
        "noise of a turned picture is as visible",
        lambda: kernels.visual_noise(GREY_NOISE.T, 30.0) / kernels.visual_noise(GREY_NOISE, 30.0),
        1.0,
        rtol=1e-9,
    ),
    Claim(
        "light for an SNR of 10",
        lambda: snr_of_dot(kernels.snr10_lx(4e3, 1e3, dark_variance_e2=80.0, **NOISY_DOT)),
        10.0,
        rtol=1e-12,
    ),
    Claim(
        "PRNU or a small well keeps the SNR below 10",
        lambda: [
            has_number(kernels.snr10_lx(4e3, 1e3, **NOISY_DOT | {"prnu": 0.16})),
            has_number(kernels.snr10_lx(4e3, 1e3, reflectance=0.9, saturation_e=99.0)),
            has_number(kernels.snr10_lx(4e3, 1e3, reflectance=0.9, saturation_e=101.0)),
        ],
        [0, 0, 1],
    ),
]


@pytest.mark.parametrize("claim", [*CLAIMS, *KERNEL_CLAIMS], ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


@pytest.mark.parametrize("exposures", [1, 4])
@pytest.mark.parametrize(("sigma_dn", "is_refused"), [(0.45, True), (0.55, False)])
def test_rounding_is_noise_from_half_a_code_of_noise_in_each_exposure(
    exposures: int, sigma_dn: float, is_refused: bool
) -> None:
    """The variance of a sum has that of each exposure, and LSB²/12 for its rounding."""
    readout = Readout.of(derive(Pixel(technology="4t-bsi", pitch_um=3.0))).burst(exposures)
    variance_e2 = exposures * (sigma_dn**2 + 1 / 12) / readout.dn_per_e**2
    with pytest.raises(NoNumberError) if is_refused else nullcontext():
        _check_rounding(METRICS["detectability"], readout, variance_e2)
