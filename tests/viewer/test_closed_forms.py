"""Kernels of the viewer against closed forms, published numbers and colour-science."""

import math
from pathlib import Path

import colour
import numpy as np
import pytest
from helpers.chains import imaging
from helpers.claims import Claim
from helpers.closed_forms import blurred_grating_lab, grating
from scipy.integrate import dblquad, quad
from scipy.special import erf, gamma, ndtr

from pixsim import Camera, Develop, Display, Pixel, SpectralImage, metrics, optics
from pixsim.light.spectral import d65
from pixsim.light.standard import illuminant
from pixsim.sensor.integration import diffusion_of
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.viewer import (
    adaptation,
    causes,
    colour_matrix,
    demosaic,
    develop,
    display as displays,
    mtf as mtf_module,
    scielab,
    screen,
    sharpening,
    tone,
)
from pixsim.viewer.dark_clip import clip_note, clips_dark, dark_clip
from pixsim.viewer.delta_e_statistics import delta_e_statistics
from pixsim.viewer.denoising import anscombe, wiener
from pixsim.viewer.denoising.variance_table import VarianceTable
from pixsim.viewer.metric_kernels.information_density import radial_spectrum
from pixsim.viewer.scene_light import LightFacts
from pixsim.viewer.without_effect import _pictures

DATA = Path(__file__).parents[1] / "data"
D65 = np.array([95.047, 100.0, 108.883])
LAMP_A = np.array([109.85, 100.0, 35.585])
DISPLAY = Display()
RAMP = np.linspace(0.0, 1.0, 257)[None]
CAMERA = Camera(f_number=2.8, transmittance=0.9, object_distance_m=0.1)
WHITE_NOISE = np.ones(3)
# 100 e- of read noise, 16 bits, no black level and no dark charge: half of the dark codes are 0.
DARK = Readout.of(
    derive(
        Pixel(
            technology="none",
            pitch_um=3.75,
            full_well_e=10500,
            read_noise_e=100,
            dark_current_e_per_s=0,
            quantum_efficiency=0.62,
            bits=16,
            black_level_dn=0,
        )
    )
)
CLIP = dark_clip(DARK, 0.03, 1e4)
LOGARITHM = VarianceTable(np.linspace(-5, 150, 40001), (1 + np.linspace(-5, 150, 40001) / 10) ** 2)
CELLS = np.array([-2.0, -1.0, 0.5, 3.0, 7.0, 9.0, 10.0])
GREY_CURVE = np.linspace(0.0, 2.0, 2001)
PITCH_MM = 0.005
NYQUIST = 0.5 / PITCH_MM
BARS = np.broadcast_to(np.tile([1.0, -1.0], 16), (32, 32))
FIELD = SpectralImage([550.0], 10.0, 2.0, data=np.ones((16, 16, 1)), header={"diffraction": False})
SHEET = {
    "technology": "none",
    "pitch_um": 4.0,
    "full_well_e": 2e4,
    "read_noise_e": 4.0,
    "dark_current_e_per_s": 0.0,
    "quantum_efficiency": 0.6,
}
PIXEL = Pixel(**SHEET, fill_factor=1.0)
STACK = {"height_um": 6.0, "index": 1.5, "microlens": "square", "crosstalk": 0.05}
STACKED = Pixel(**SHEET, stack=STACK)


def csf(frequency: float) -> float:
    """Contrast sensitivity of IEEE 1858 and ISO 15739."""
    return 75 * frequency**0.8 * math.exp(-0.2 * frequency) / 34.05


def gaussian_npwe() -> float:
    """d′ of a Gaussian of 0.1° in white noise of 0.3 on 32 dots a degree.

    ∫ f^2.6 e^(-a f²) 2πf df = π Γ(2.3)/a^2.3, and likewise of f^5.2.
    """
    decay = 1.3 / 32
    target = (2 * math.pi * 0.1) ** 2
    peak = (2 * math.pi * 0.1**2) ** 2
    signal = peak * math.pi * gamma(2.3) / (target + 2 * decay) ** 2.3
    noise = peak * math.pi * gamma(3.6) / (target + 4 * decay) ** 3.6 * 0.3**2 / 32.0**2
    return signal / math.sqrt(noise)


def gaussian_target() -> np.ndarray:
    """The Gaussian of `gaussian_npwe` on 8° of dots."""
    place_deg = (np.arange(256) - 128) / 32.0
    return np.exp(-(place_deg**2 + place_deg[:, None] ** 2) / (2 * 0.1**2))


def natural_bits(y: float, x: float) -> float:
    """Information of a natural scene behind square pixels at one frequency."""
    mtf = np.sinc(x * PITCH_MM) * np.sinc(y * PITCH_MM)
    return 0.5 * math.log2(1 + mtf**2 / (x**2 + y**2 + 400) / 1e-5)


def natural_information(count: int) -> float:
    """The same by the kernel, on `count` frequencies of a quadrant."""
    axis = np.linspace(0, NYQUIST, count)
    mtf = np.sinc(axis * PITCH_MM)[:, None] * np.sinc(axis * PITCH_MM)
    spectrum = metrics.natural_spectrum(np.hypot(axis[:, None], axis), 1.0, 20.0)
    return metrics.information_bits_per_mm2(axis, spectrum * mtf**2, 1e-5)


D65_NM = np.arange(405.0, 700.0, 10.0)
D65_LIGHT = SpectralImage(D65_NM, 10.0, 2.0, factors=(d65(D65_NM), np.ones((1, 4, 4))))
D65_LM_PER_W = float(D65_LIGHT.luminous_weight() @ d65(D65_NM) / (10.0 * d65(D65_NM).sum()))
OPENING = {"height_um": 6.0, "index": 1.5, "microlens": "none"}
BARE = Pixel(**SHEET, stack=OPENING | {"depletion_um": 1.0, "diffusion_length_um": 8.0})
COLOURS_NM = np.array([450.0, 700.0])
TWO_COLOURS = SpectralImage(
    COLOURS_NM, 10.0, 2.0, data=np.ones((16, 16, 2)), header={"diffraction": False}
)
CY_PER_MM = np.array([0.0, 60.0, 90.0])
BEHIND_LENS = np.stack(
    [nm * optics.diffraction_otf(CY_PER_MM, nm, CAMERA.effective_f_number) for nm in COLOURS_NM]
)
DIFFUSED = np.stack([diffusion_of(derive(BARE))(CY_PER_MM, nm) for nm in COLOURS_NM])
MEAN_ERROR = colour_matrix._MeanError(
    *(
        np.random.default_rng(n).uniform(size=size)
        for n, size in enumerate(((4, 2), (2, 3), (4, 1)))
    ),
    np.array([[0.4, 0.3, 0.2], [0.5, 0.5, 0.5], [0.002, 0.2, 0.7], [1.0, 0.9, 0.8]]),
    np.array([[[0.3, 0.1, 0.0], [0.1, 0.2, 0.0], [0.0, 0.0, 0.5]]]) * np.ones((4, 1, 1)) / 1e3,
)
COVARIANCE = np.array([[1e-18, 3e-10, 2e-7], [3e-10, 1.0, 500.0], [2e-7, 500.0, 1e6]])
NEAR_THRESHOLD = scielab.xyz_to_lab(
    216 / 24389 * (1 + np.linspace(-1e-6, 1e-6, 41))[:, None] * D65, D65
)
DISPLAYS = [
    Claim(
        "electrons of a plate of 50 cd/m² in D65, and of its radiance",
        lambda: displays.white_rate(
            imaging(CAMERA, PIXEL, display=Display(white_w_per_m2_sr=50.0 / D65_LM_PER_W)),
            D65_LIGHT,
        ),
        displays.white_rate(
            imaging(CAMERA, PIXEL, display=Display(white_cd_per_m2=50.0)), D65_LIGHT
        ),
        rtol=1e-9,
    ),
    Claim("grey is D65", lambda: displays.to_xyz(np.array([[0.5]])), [[D65 / 2]], rtol=1e-12),
    Claim("primaries sum to white", lambda: displays.XYZ_FROM_RGB.sum(axis=1), D65, rtol=1e-14),
    Claim(
        "grey primaries are grey",
        lambda: displays.rgb_to_xyz(np.full((1, 2, 3), 0.25)),
        [[D65 / 4, D65 / 4]],
        rtol=1e-14,
    ),
    Claim(
        "luminances of sRGB",
        lambda: displays.rgb_to_xyz(np.eye(3))[:, 1],
        [21.26, 71.52, 7.22],
        atol=0.01,
        why="IEC 61966-2-1 prints four digits",
    ),
    Claim(
        "chromaticities of sRGB",
        lambda: displays.XYZ_FROM_RGB[:2].T / displays.XYZ_FROM_RGB.sum(axis=0)[:, None],
        [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]],
        rtol=1e-12,
    ),
    Claim(
        "light of XYZ inverts",
        lambda: displays.RGB_FROM_XYZ @ displays.XYZ_FROM_RGB,
        np.eye(3),
        atol=1e-14,
    ),
    Claim(
        "irradiance over radiance on axis",
        lambda: displays.on_axis_sr(CAMERA),
        0.9 * math.pi / (1 + 4 * 2.8**2 * (1 + CAMERA.magnification) ** 2),
        rtol=1e-12,
    ),
    Claim(
        "white of a stated luminance",
        lambda: displays.white_lx(FIELD, CAMERA, Display(white_cd_per_m2=50.0)),
        50 * displays.on_axis_sr(CAMERA),
        rtol=1e-12,
    ),
    Claim(
        "light with 0.1 lm/W and more has a luminance, faint light and bright light",
        lambda: [
            displays.has_luminance(
                SpectralImage(
                    [550.0, 930.0],
                    10.0,
                    2.0,
                    data=np.ones((4, 4, 2)),
                    header={"lamp_w_per_m2_sr_nm": [scale * lm_per_w / 679, scale]},
                )
            )
            for scale in (1e-4, 1e4)
            for lm_per_w in (0.09, 0.19)
        ],
        [0, 1, 0, 1],
    ),
    Claim(
        "means of a spline through x³ - 5x² + 2x + 1 at 0 to 7, constant beyond them",
        lambda: displays.average_axis(
            np.tile(np.polyval([1, -5, 2, 1], np.arange(8.0)), (2, 1)),
            2.0,
            1.0,
            2 * (CELLS + 1),
            3,
            1,
        ),
        [
            np.diff(
                np.polyval([1 / 4, -5 / 3, 1, 1, 0], np.clip(CELLS, 0, 7))
                + np.minimum(CELLS, 0)
                + 113 * np.maximum(CELLS - 7, 0)
            )
            / np.diff(CELLS)
        ]
        * 2,
        rtol=1e-12,
        atol=1e-12,
    ),
    Claim(
        "repeats of odd numbers of rows or columns are registered half a pixel from even ones",
        lambda: [
            np.subtract(
                *(
                    imaging(CAMERA, PIXEL)
                    .changed(is_run=True)
                    .registered(2, um)
                    .physics.registration
                    for um in (array_um, (32.0, 32.0))
                )
            )
            % 1
            for array_um in ((28.0, 32.0), (32.0, 28.0))
        ],
        [[0.5, 0.0], [0.0, 0.5]],
        atol=1e-15,
    ),
    Claim(
        "edges of pixels of which one begins a quarter behind the middle",
        lambda: displays.pixel_edges_um(12.0, 3, 3.0, 0.25),
        [0.75, 3.75, 6.75, 9.75],
        atol=1e-12,
    ),
    Claim(
        "edges of centred pixels",
        lambda: displays.pixel_edges_um(10.0, 3, 3.0),
        [0.5, 3.5, 6.5, 9.5],
        atol=1e-12,
    ),
    *(
        Claim(
            f"interpolation at the Nyquist frequency, {name}",
            lambda name=name: displays.interpolation_mtf([0.0, 50.0, 100.0], 10.0, name),
            [1.0, expected, 0.0],
            atol=1e-15,
        )
        # sinc x to the degree plus one, over the samples of the B-spline: 1, 1, 1/3, 2/15.
        for name, expected in (
            ("nearest", 2 / math.pi),
            ("linear", (2 / math.pi) ** 2),
            ("cubic", (2 / math.pi) ** 4 * 3),
            ("quintic", (2 / math.pi) ** 6 * 7.5),
        )
    ),
    *(
        Claim(
            f"out of the gamut: {rgb}",
            lambda rgb=rgb: displays.out_of_gamut_share(np.array([[rgb, [0.5, 0.5, 0.5]]])) * 2,
            expected,
        )
        for rgb, expected in (
            ([1.0, 0.0, 0.5], 0.0),
            ([-1e-12, 1.0, 1.0], 0.0),
            ([1.5, 1.5, 1.5], 0.0),  # brighter than white is no matter of the gamut
            ([1.01, 1.0, 1.0], 0.0),
            ([-0.01, 0.5, 0.5], 1.0),
            ([1.1, 0.2, 0.2], 1.0),
            ([1.1, 0.6, 0.6], 1.0),
            ([3.0, 3.0, -0.1], 1.0),
        )
    ),
    Claim(
        "share of dots beyond white",
        lambda: screen.fraction_beyond_white(np.array([[1.0, 1 + 1e-7], [1 + 1e-5, 0.2]])),
        0.25,
    ),
    Claim(
        "whites are rounded up to two digits, but for rounding",
        lambda: [
            screen._rounded_up(white, 2) for white in (730.1, 730.0000001, 730.0, 9.96e-5, 1.01)
        ],
        [740.0, 730.0, 730.0, 1e-4, 1.1],
        rtol=1e-14,
    ),
    Claim(
        "MTF of lens, photodiode, interpolation and dot",
        lambda: np.stack(
            list(
                mtf_module.mtf_terms(
                    imaging(CAMERA, PIXEL), FIELD, np.array([30.0]), 2.0, 5.0
                ).values()
            )
        )[:, 0],
        [
            float(optics.diffraction_otf(30.0, 550.0, CAMERA.effective_f_number)),
            *(np.sinc(0.15), np.sinc(0.12), np.sinc(0.12) ** 2, np.sinc(0.06)),
        ],
        rtol=1e-4,
        why="a band of 10 nm in place of one wavelength",
    ),
    Claim(
        "MTF of light that four neighbours share",
        lambda: mtf_module._crosstalk_mtf(
            np.array([[0.0, 0.2, 0.0], [0.2, 1.2, 0.2], [0.0, 0.2, 0.0]]),
            4.0,
            np.array([0.0, 62.5, 125.0]),
        ),
        [1, 1 - 0.2, 1 - 0.4],
        atol=1e-15,
        why="1 - 2c(1 - cos 2πfp) of shares c = 0.1 of all",
    ),
    Claim(
        "aperture of a pixel with a microlens: its pitch",
        lambda: mtf_module.mtf_terms(imaging(CAMERA, STACKED), FIELD, np.array([60.0]))[
            "microlens"
        ],
        [np.sinc(0.24)],
        rtol=1e-9,
    ),
    Claim(
        "dots of a whole picture of 32 µm, 8 across",
        lambda: mtf_module.mtf_terms(
            imaging(CAMERA, PIXEL, display=Display(dots=8)), FIELD, np.array([60.0])
        )["dot"],
        [np.sinc(0.24)],
        rtol=1e-12,
    ),
    Claim(
        "diffusion of two colours, weighted by their light behind the lens",
        lambda: mtf_module.mtf_terms(imaging(CAMERA, BARE), TWO_COLOURS, CY_PER_MM)["diffusion"],
        (BEHIND_LENS * DIFFUSED).sum(axis=0) / BEHIND_LENS.sum(axis=0),
        rtol=1e-9,
    ),
    Claim(
        "the newest 32 of 40 tables of a light are kept",
        lambda: [
            [facts.cached(n, lambda computed=computed: computed) for n in (*range(39, 7, -1), 7)]
            for facts in [LightFacts(FIELD, BARS)]
            for computed in [[facts.cached(n, lambda: 0) for n in range(40)].count(0)]
        ],
        [[0] * 32 + [40]],
    ),
    Claim(
        "the spectrum of a picture is relative to its mean",
        lambda: LightFacts(FIELD, 10 * (2 + BARS), None).spectrum,
        radial_spectrum((2 + BARS) / 2, 2.0),
        atol=1e-12,
    ),
    *(
        Claim(
            "pictures of two spectra of the light in which settings are tried: black, a ramp with the"
            " slope 1, white behind a slanted edge, and a target of one spectrum alone",
            lambda: np.stack(_pictures(24)),
            [[target, (1 - is_target) * (1 - share) * light], [share * light, (1 - share) * light]],
            atol=1e-15,
        )
        for x, y in [np.meshgrid((np.arange(24) + 0.5) / 24, (np.arange(24) + 0.5) / 24)]
        for light in [np.where(x > 0.65 + 0.1 * y, 1.0, np.clip(x - 0.15, 0.0, 0.6))]
        for share in [np.where(y < 0.5, 0.4, 0.6)]
        for is_target in [(abs(x - 0.5) < 0.12) & (abs(y - 0.5) < 0.2)]
        for target in [np.where(is_target, light, share * light)]
    ),
    Claim(
        "terms of the display are not on the sensor",
        lambda: list(
            mtf_module.terms_to_sensor({"lens": 0.5, "interpolation": 0.2, "dot": 0.1}).values()
        ),
        [0.5],
    ),
]
COLOURS = [
    *(
        Claim(
            f"adaptation of colour-science: {name}",
            lambda name=name: adaptation.adaptation_matrix(LAMP_A, D65, name.lower()),
            colour.adaptation.matrix_chromatic_adaptation_VonKries(LAMP_A, D65, name),
            atol=1e-12,
            why="rounding: both have the published four digits",
        )
        for name in ("Bradford", "CAT02")
    ),
    Claim(
        "no adaptation keeps chromaticities",
        lambda: adaptation.adaptation_matrix(LAMP_A / 50, D65, "none"),
        50 * np.eye(3),
        rtol=1e-15,
    ),
    Claim(
        "white of the chart under A",
        lambda: (
            100
            * colour_matrix.chart_xyz(
                colour_matrix.STANDARD_NM, illuminant("A", colour_matrix.STANDARD_NM)
            )[1]
        ),
        LAMP_A,
        atol=5e-3,
        why="CIE 15 sums in steps of 1 nm, not 5",
    ),
    Claim(
        "CIELAB's f and its slope in the dark, where L* is (29/3)³ Y, below black, and in light",
        lambda: colour_matrix._f_and_slope(np.array([8e-3, -0.01, 0.01, 0.18])),
        [
            [
                *(((29 / 3) ** 3 * light + 16) / 116 for light in (8e-3, -0.01)),
                *(light ** (1 / 3) for light in (0.01, 0.18)),
            ],
            [*2 * [(29 / 3) ** 3 / 116], *(light ** (-2 / 3) / 3 for light in (0.01, 0.18))],
        ],
        rtol=1e-14,
    ),
    Claim(
        "slope of the mean error of patches with noise",
        lambda: (
            np.array(
                [MEAN_ERROR(step, 0.3)[0] - MEAN_ERROR(-step, 0.3)[0] for step in 1e-5 * np.eye(6)]
            )
            / 2e-5
        ),
        MEAN_ERROR(np.zeros(6), 0.3)[1],
        rtol=1e-7,
        why="finite differences",
    ),
    Claim(
        "channels are independent whose least singular value is 1.5e-6 of the largest",
        lambda: [
            colour_matrix.fit_matrix(
                np.diag([3.0, 3.0, 4.5e-6]), np.eye(3), D65, "least_squares"
            ).shape[0],
            develop.check_separable(np.diag([3.0, 3.0, 4.5e-6]), "D65") is None,
        ],
        [3, 1],
    ),
    Claim(
        "a root of a covariance, also of channels with noise of 1e-9 and 1e3",
        lambda: colour_matrix._root(COVARIANCE).T @ colour_matrix._root(COVARIANCE) / COVARIANCE,
        np.ones((3, 3)),
        rtol=1e-12,
    ),
    Claim(
        "metamerism index",
        lambda: colour_matrix.metamerism_index(np.array([1.0, 3.0])),
        100 - 5.5 * 2,
    ),
    Claim(
        "S-CIELAB of a coloured grating",
        lambda: scielab.filtered_lab((grating(3) * D65)[None], white_xyz=D65, samples_per_deg=23.0)[
            0
        ],
        blurred_grating_lab(23.0, 3),
        atol=1e-10,
    ),
    Claim(
        "CIELAB of float32 has 1024 lines for each of the 255 exponents of finite numbers",
        lambda: scielab._f_lines(216 / 24389, 841 / 108).size,
        255 * 1024,
    ),
    Claim(
        "CIELAB of 18 % grey",
        lambda: scielab.xyz_to_lab(0.18 * D65, D65),
        [116 * 0.18 ** (1 / 3) - 16, 0, 0],
        atol=1e-12,
    ),
    *(
        Claim(
            f"equal steps of luminance make equal ones of L* across CIELAB's threshold, {formula}",
            lambda formula=formula: np.diff(
                np.log(scielab.delta_e(NEAR_THRESHOLD[:-1], NEAR_THRESHOLD[1:], formula))
            ),
            np.zeros(39),
            atol=1e-4,
            why="steps of 5e-8 of the threshold",
        )
        for formula in ("1976", "1994", "2000")
    ),
    Claim(
        "CIELAB below the cube root",
        lambda: scielab.xyz_to_lab(1e-3 * D65, D65)[0],
        (29 / 3) ** 3 * 1e-3,
        rtol=1e-12,
    ),
    Claim(
        "ΔE 1994 of a chroma of 10",
        lambda: scielab.delta_e([50.0, 10.0, 0.0], [51.0, 12.0, 0.0], "1994"),
        math.hypot(1, 2 / 1.45),
        rtol=1e-12,
    ),
    Claim(
        "ΔE 1994 is not symmetric",
        lambda: scielab.delta_e([51.0, 12.0, 0.0], [50.0, 10.0, 0.0], "1994"),
        math.hypot(1, 2 / 1.54),
        rtol=1e-12,
    ),
    Claim(
        "black to white",
        lambda: causes.lightness_range(np.array([[0.0, 1.0]])),
        [0, 100],
        atol=1e-12,
    ),
    Claim(
        "luminance of a lightness",
        lambda: [causes._luminance_of_lightness(lightness) for lightness in (4.0, 50.0)],
        [4 * 27 / 24389, (66 / 116) ** 3],
        rtol=1e-12,
    ),
    Claim(
        "lightness of the primary with most contrast",
        lambda: causes.lightness_range(np.array([[[0.5, 0.0, 0.5], [0.5, 0.18, 0.5]]])),
        [0, 116 * 0.18 ** (1 / 3) - 16],
        atol=1e-12,
    ),
    Claim(
        "luminance of primaries",
        lambda: tone.luminance_of(np.ones((3, 1, 1)) * np.array([1.0, 0.0, 2.0])[:, None, None]),
        [[(displays.XYZ_FROM_RGB[1] @ [1, 0, 2]) / 100]],
        rtol=1e-14,
    ),
    Claim(
        "statistics of ΔE",
        lambda: delta_e_statistics(np.arange(101.0).reshape(1, -1)),
        [50, 50, 90, 99, 100],
        rtol=1e-14,
    ),
    *(
        Claim(
            f"statistics of ΔE of {name}",
            lambda delta_e=delta_e: delta_e_statistics(delta_e),
            [delta_e.mean(), *np.percentile(delta_e, (50, 90, 99)), delta_e.max()],
            rtol=1e-6,
            why="float32",
        )
        for name, delta_e in {
            "random numbers, between whose ranks percentiles lie": np.random.default_rng(
                9
            ).exponential(size=(7, 11)),
            "one dot": np.full((1, 1), 3.0),
            "equal pictures": np.zeros((4, 4)),
            "equal pictures in float32": np.zeros((4, 4), np.float32),
        }.items()
    ),
]
DEVELOPMENT = [
    Claim(
        "Reinhard et al. (2002), equation 4",
        lambda: tone.reinhard([-0.5, 1.0, 4.0], 4.0),
        [-0.5, 0.53125, 1],
    ),
    Claim(
        "Reinhard's slope at black", lambda: tone.reinhard(1e-9, 4.0), 1e-9, rtol=2e-9, why="next term"
    ),
    Claim(
        "grey light and primaries of one luminance are toned by one factor",
        lambda: [
            tone.toned(RAMP, Develop(tone_curve="reinhard", tone_white=4.0), DISPLAY),
            *tone.toned(
                np.stack([RAMP] * 3), Develop(tone_curve="reinhard", tone_white=4.0), DISPLAY
            ),
        ],
        [tone.reinhard(RAMP, 4.0)] * 4,
        rtol=1e-6,
        why="digits of the display's primaries",
    ),
    Claim(
        "the display's own gamma is no tone curve",
        lambda: tone.toned(RAMP, Develop(tone_curve="gamma", tone_gamma=DISPLAY.gamma), DISPLAY),
        RAMP,
        atol=1e-12,
    ),
    Claim(
        "sRGB at half of its values",
        lambda: tone.toned(np.array([[0.21404114, 0.002]]), Develop(tone_curve="srgb"), DISPLAY),
        [[0.5**2.2, (12.92 * 0.002) ** 2.2]],
        rtol=1e-7,
        why="IEC 61966-2-1: value 0.5 is light of 0.21404114",
    ),
    Claim(
        "a table is straight between its rows",
        lambda: tone.toned(
            np.array([[0.05, 0.2, 0.6, 3.0]]),
            Develop(tone_curve=[[0, 0], [0.1, 0], [0.3, 0.5], [0.9, 1]]),
            Display(gamma=2.0),
        ),
        [[0, 0.25**2, 0.75**2, 1]],
        rtol=1e-14,
    ),
    Claim(
        "products of the weights of pixels behind a filter of three taps are its taps",
        lambda: demosaic._filtered_products(None, "linear", 3, (0.25, 0.5, 0.25)),
        [0.5, 0.25, 0.0],
    ),
    # Weights of a dot of d pixels are its box behind a B-spline, whose products are
    # ∫ (d - |t|) β(t + lag) dt/d² with the B-spline of twice the order.
    *(
        Claim(
            f"products of the weights of pixels in a dot of 2.6 pixels, {interpolation}",
            lambda interpolation=interpolation: demosaic._dot_products(2.6, interpolation, 5),
            [
                quad(
                    lambda t, spline=spline, lag=lag: (2.6 - abs(t)) * spline(abs(t + lag)) / 2.6**2,
                    -2.6,
                    2.6,
                    points=[-2, -1, 0, 1, 2],
                )[0]
                for lag in range(5)
            ],
            atol=1e-10,
            why="quadrature",
        )
        for interpolation, spline in (
            ("nearest", lambda t: max(1 - t, 0)),
            ("linear", lambda t: (max(2 - t, 0) ** 3 - 4 * max(1 - t, 0) ** 3) / 6),
        )
    ),
    Claim(
        "Gaussian of the unsharp mask",
        lambda: sharpening.gaussian_taps(0.5) / sharpening.gaussian_taps(0.5).max(),
        np.exp(-2 * np.arange(-2, 3) ** 2.0),
        rtol=1e-14,
    ),
    Claim(
        "unsharp mask at 1/12 cycle a pixel",
        lambda: sharpening.unsharp_response(1 / 12, 2.0, 1.0),
        1 + 2 * (1 - math.exp(-2 * (math.pi / 12) ** 2)),
        rtol=1e-3,
        why="the Gaussian ends at 4 σ",
    ),
    Claim(
        "noise behind a wide unsharp mask",
        lambda: sharpening.noise_gain(1.5, 500.0),
        2.5,
        rtol=1e-5,
        why="1/σ² is left of the blur's noise",
    ),
    *(
        Claim(
            f"white noise behind {method}, {phase}",
            lambda method=method, phase=phase: np.diag(
                demosaic.demosaic_covariance(phase, method, WHITE_NOISE)
            ),
            expected,
            atol=1e-14,
        )
        for method, expected in (
            ("bilinear", [9 / 16, 5 / 8, 9 / 16]),
            ("malvar2004", [63 / 64, 25 / 32, 63 / 64]),
        )
        for phase in ("rggb", "gbrg")
    ),
    Claim(
        "noise of large dots is that of n²/4, n²/2 and n²/4 samples",
        lambda: np.diag(demosaic.demosaic_covariance("rggb", "bilinear", WHITE_NOISE, 400.0)) * 400**2,
        [4, 2, 4],
        rtol=0.01,
        why="pixels that the edge of a dot cuts",
    ),
    Claim(
        "offsets of columns behind bilinear",
        lambda: np.diag(demosaic.demosaic_column_covariance("rggb", "bilinear", WHITE_NOISE)),
        [0.75, 0.6875, 0.75],
        atol=1e-14,
    ),
    Claim(
        "offsets of columns fall with the width of a dot",
        lambda: demosaic.demosaic_column_covariance("rggb", "bilinear", WHITE_NOISE, 200.0) * 200,
        [[2, 1, 0], [1, 1, 1], [0, 1, 2]],
        atol=0.03,
        why="columns that the edge of a dot cuts; R takes every other column, B the others",
    ),
    Claim(
        "offsets of rows of one channel",
        lambda: demosaic.demosaic_row_covariance(["C"], "interpolate", [3.0]),
        [[9.0]],
    ),
    Claim("Anscombe (1948)", lambda: anscombe.forward(100.0, 9.0), 2 * math.sqrt(109.375)),
    Claim(
        "variance behind Anscombe's transform",
        lambda: anscombe.moments([20.0, 1e3, 1e6], 9.0)[1],
        [1, 1, 1],
        atol=0.02,
        why="from 20 electrons on (Mäkitalo & Foi 2013)",
    ),
    Claim(
        "moments without electrons",
        lambda: anscombe.moments(0.0, 0.0),
        [2 * math.sqrt(3 / 8), 0],
        atol=1e-14,
    ),
    Claim(
        "noise of 1 + z/10 becomes that of 10 ln(1 + z/10) of variance 1, which is inverted",
        lambda: LOGARITHM.inverse(
            quad(lambda z: 10 * math.log(2 + z / 5) * math.exp(-(((z - 50) / 6) ** 2) / 2), 2, 98)[0]
            / (6 * math.sqrt(2 * math.pi))
        ),
        50.0,
        rtol=1e-7,
        why="nodes and steps of the table",
    ),
    Claim(
        "values of noise of 1 + z/10 from -5 on",
        lambda: LOGARITHM.forward(np.array([-5.0, 0.0, 50.0])),
        10 * np.log([1.0, 2.0, 12.0]),
        atol=1e-6,
        why="steps of the table",
    ),
    Claim(
        "Wiener's filter",
        lambda: wiener.response(np.array([[3.0, 0.0]]), np.array([[1.0, 0.0]])),
        [[0.75, 1]],
    ),
    Claim(
        "error that Wiener's filter leaves",
        lambda: wiener.mean_square_error(np.array([[3.0, 4.0]]), np.array([[1.0, 4.0]])),
        (0.75 + 2) / 2,
    ),
    Claim("clipping at 0 DN: mean", lambda: CLIP["too_bright_e"], 100 / math.sqrt(2 * math.pi),
          rtol=1e-6, why="next term 1/24σ²"),
    Claim(
        "clipping at 0 DN: share",
        lambda: CLIP["at_zero_fraction"],
        0.5 + 0.5 / CLIP["spread_dn"] / math.sqrt(2 * math.pi),
        rtol=1e-6,
        why="half of the codes, and the density of half a code; next term (½/σ)²/6",
    ),
    Claim(
        "clipping at 0 DN of 200 e- of dark charge µ: σφ(µ/σ) - µΦ(-µ/σ), σ² = 100² + µ",
        lambda: dark_clip(DARK.with_physics(dark_current_e_per_s=200 / 0.03), 0.03, 1e4)[
            "too_bright_e"
        ],
        math.sqrt(10_200 / 2 / math.pi) * math.exp(-(200**2) / 2 / 10_200)
        - 100 * math.erfc(200 / math.sqrt(2 * 10_200)),
        rtol=1e-6,
        why="next term 1/24σ²",
    ),
    Claim("clipping at 0 DN: spread", lambda: CLIP["spread_e"], 100.0, rtol=1e-12),
    Claim(
        "clipping at 0 DN in four exposures: each clips, and their noise adds up by squares",
        lambda: [
            dark_clip(DARK.burst(4), 0.12, 4e4)[name] / CLIP[name]
            for name in ("spread_e", "spread_dn", "too_bright_e", "at_zero_fraction", "lightness")
        ],
        [2, 2, 4, 1, 1],
        rtol=1e-12,
    ),
    Claim(
        "dark pixels clip from 0.05 DN, and from a hundredth of their spread on",
        lambda: [
            int(clips_dark({"too_bright_e": excess_e, "spread_e": 20.0, "spread_dn": spread_dn}))
            for spread_dn, excess_e in ((10.0, 0.199), (10.0, 0.201), (2.0, 0.499), (2.0, 0.501))
        ],
        [0, 1, 0, 1],
    ),
    Claim(
        "a black level is at most half of the codes",
        lambda: [
            int("set pixel" in str(clip_note(CLIP | {"least_black_level_dn": dn}, {"bits": 10})))
            for dn in (511, 512)
        ],
        [1, 0],
    ),
    Claim(
        "clipping at 0 DN: lightness",
        lambda: [CLIP["lightness"], dark_clip(DARK, 0.03, 1.0)["lightness"]],
        [(29 / 3) ** 3 * 0.01 / math.sqrt(2 * math.pi), 100],
        rtol=1e-6,
        why="next term; no display shows more than white",
    ),
]  # fmt: skip
JUDGES = [
    Claim(
        "Rose (1948): a disc",
        lambda: metrics.detectability(np.where(BARS > 0, 3.0, 0.0), np.array(144.0)),
        3 * math.sqrt(512) / 12,
        rtol=1e-14,
    ),
    Claim(
        "bars along noisy columns, across them, along noisy rows",
        lambda: [
            metrics.detectability(BARS, np.array(4.0), column_variance=5.0),
            metrics.detectability(BARS.T, np.array(4.0), column_variance=5.0),
            metrics.detectability(BARS, np.array(4.0), row_variance=5.0),
        ],
        [math.sqrt(1024 / (4 + 32 * 5)), 16, 16],
        rtol=1e-12,
    ),
    Claim(
        "one frequency: the eye weakens target and noise alike",
        lambda: metrics.npwe(
            np.cos(2 * np.pi * 5 * np.arange(64) / 64) * np.full((64, 1), 0.1),
            np.array(0.3**2 / 30.0**2),
            30.0,
        ),
        0.1 * math.sqrt(64 * 64 / 2) / 0.3,
        rtol=1e-12,
    ),
    Claim(
        "NPWE of a Gaussian target",
        lambda: metrics.npwe(gaussian_target(), np.array(0.3**2 / 32.0**2), 32.0),
        gaussian_npwe(),
        rtol=1e-3,
        why="a sum over 8° of f^2.6, which bends at 0",
    ),
    Claim(
        "nobody sees uniform light", lambda: metrics.npwe(np.ones((8, 8)), np.array(1.0), 30.0), 0.0
    ),
    *(
        Claim(
            f"information of white spectra, {name}",
            lambda axis=axis: metrics.information_bits_per_mm2(axis, 3.0, 0.7, 0.5),
            0.5 / PITCH_MM**2 * math.log2(1 + 3 / 1.2),
            rtol=1e-12,
        )
        for name, axis in {
            "square": np.linspace(-NYQUIST, NYQUIST, 33),
            "square, even": np.linspace(-NYQUIST, NYQUIST, 34),
            "quadrant": np.linspace(0, NYQUIST, 17),
            "not equidistant": NYQUIST * np.linspace(0, 1, 17) ** 2,
            "DFT": np.fft.fftfreq(32, PITCH_MM),
            "DFT, odd": np.fft.fftfreq(33, PITCH_MM),
            "DFT, shifted": np.fft.fftshift(np.fft.fftfreq(32, PITCH_MM)),
        }.items()
    ),
    Claim(
        "information of a natural scene",
        lambda: natural_information(401),
        4 * dblquad(natural_bits, 0, NYQUIST, 0, NYQUIST, epsabs=1e-4)[0],
        rtol=1e-5,
        why="trapezia of 0.25 cy/mm at a corner of 20 cy/mm",
    ),
    Claim(
        "NEQ of shot noise is the quanta",
        lambda: metrics.neq(np.array([1.0, 0.5, 0.0]), 400 * PITCH_MM**2, 400.0),
        400 / PITCH_MM**2 * np.array([1, 0.25, 0]),
        rtol=1e-14,
    ),
    # A cosine of half-waves along 64 dots, which reflection at the borders continues: it has CSF ·
    # dL*/dY · a/√2, at order/2 cycles in 64/40 degrees.
    *(
        Claim(
            f"visual noise of {order} half-waves of 1e-5 on 0.2 of white",
            lambda order=order: metrics.visual_noise(
                np.tile(0.2 + 1e-5 * np.cos(np.pi * order * (np.arange(64) + 0.5) / 64), (64, 1)),
                40.0,
            ),
            116 / 3 * 0.2 ** (-2 / 3) * 1e-5 / math.sqrt(2) * csf(order / 2 / 64 * 40.0),
            rtol=1e-6,
            why="first order of the amplitude",
        )
        for order in (4, 40)
    ),
    Claim(
        "visual noise of 12 half-waves of 1e-5 in the dark, where L* is (29/3)³ Y",
        lambda: metrics.visual_noise(
            np.tile(0.004 + 1e-5 * np.cos(np.pi * 12 * (np.arange(64) + 0.5) / 64), (64, 1)), 40.0
        ),
        (29 / 3) ** 3 * 1e-5 / math.sqrt(2) * csf(12 / 2 / 64 * 40.0),
        rtol=1e-12,
    ),
    Claim(
        "light for an SNR of 10 of shot noise: 100 e-, and a quarter for four pixels a dot",
        lambda: [
            metrics.snr10_lx(4000.0, 1000.0, reflectance=0.18, pixels_per_dot=pixels)
            for pixels in (0.25, 1.0, 4.0)
        ],
        np.array([25, 25, 6.25]) * math.pi / 0.18,
        rtol=1e-12,
    ),
    Claim(
        "pixels of 100 and 110 e- with a contrast of 5 to 15 %, by the noise of either",
        lambda: metrics.contrast_detection_probability(
            [100.0, 100.0], 0.1, [5.0, 0.0], [0.0, 5.0]
        ),
        [ndtr(5 / 5.75) - ndtr(-5 / 5.25), erf(1 / math.sqrt(2))],
        rtol=1e-12,
    ),
    Claim(
        "2 of 12 pairs with a contrast of 5 to 15 %, none of which has a darker pixel without light",
        lambda: metrics.contrast_detection_share([100, 0, -5], [[104, 106], [112, 116]], 0.1),
        1 / 6,
        rtol=1e-14,
    ),
    Claim(
        "acutance without blur: share of the CSF below Nyquist",
        lambda: metrics.acutance(np.array([0.0, 11.5]), np.ones(2)),
        quad(csf, 0, 11.5)[0] / quad(csf, 0, np.inf)[0],
        rtol=1e-8,
        why="quadrature",
    ),
    Claim(
        "acutance of a Gaussian MTF",
        lambda: metrics.acutance(
            np.linspace(0, 40, 4001), np.exp(-((np.linspace(0, 40, 4001) / 12) ** 2))
        ),
        quad(lambda f: math.exp(-((f / 12) ** 2)) * csf(f), 0, 40)[0] / quad(csf, 0, np.inf)[0],
        rtol=1e-6,
        why="straight between 0.01 cy/deg",
    ),
    Claim(
        "MTF50 of a Gaussian",
        lambda: metrics.mtf50(GREY_CURVE, np.exp(-(GREY_CURVE**2))),
        math.sqrt(math.log(2)),
        rtol=1e-6,
        why="straight between 0.001",
    ),
    Claim("NIIRS, example of the NGA", lambda: metrics.niirs(0.35, 0.52832, 50.0), 5.015,
          atol=5e-4, why="NGA (2015) prints 5.015"),
    Claim(
        "NIIRS at half of the distance",
        lambda: metrics.niirs(0.5, 0.25, 30.0) - metrics.niirs(0.5, 0.5, 30.0),
        3.32 * math.log10(2),
        rtol=1e-12,
    ),
    Claim(
        "edge response of a Gaussian blur of 0.7 px",
        lambda: metrics.relative_edge_response(
            2 * GREY_CURVE, np.exp(-2 * (np.pi * 0.7 * 2 * GREY_CURVE) ** 2)
        ),
        erf(0.5 / 0.7 / math.sqrt(2)),
        rtol=1e-5,
        why="straight between 0.002 cycles a pixel",
    ),
]  # fmt: skip


@pytest.mark.parametrize("claim", [*DISPLAYS, *COLOURS, *DEVELOPMENT, *JUDGES], ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


@pytest.mark.parametrize("name", ["constant_offset", "edge_vs_blurred_edge", "dark_noise"])
def test_maps_of_the_first_public_code(name: str) -> None:
    """S-CIELAB of X. Zhang & B. A. Wandell (1996) under Octave: maps of ΔE 1976 to rounding."""
    with np.load(DATA / f"scielab/{name}.npz") as file:
        white = file["white_xyz"]
        pair = [file[f"{part}_over_white"] * white for part in ("reference", "test")]
        view = {"white_xyz": white, "samples_per_deg": float(file["samples_per_deg"])}
        expected = file["delta_e_1976"]
    np.testing.assert_allclose(
        scielab.delta_e_map(*pair, **view, filters="zhang1996"), expected, rtol=0, atol=1e-9
    )
