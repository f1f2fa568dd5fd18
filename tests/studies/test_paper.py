"""Comparison with the paper: closed forms, rows that agree if and only if the evidence does, and
what another study over it, whose axes are moved alone, does to these statements.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.claims import Claim
from helpers.tiny import COARSE, PITCHES_UM, keys, tiny, tiny_toml
from scipy import ndimage, signal

import pixsim
from pixsim.light.spectral import SpectralImage, d65
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens, without_lens
from pixsim.optics.diffraction import diffraction_otf
from pixsim.optics.lens_options import LensOptions
from pixsim.report.axes import verdict_words
from pixsim.scene.charts import DIE_MM, csf_contrast, csf_frequency_lp_per_mm
from pixsim.sensor.diffusion import absorption_per_um, diffusion_mtf
from pixsim.sensor.dynamic_range import readout_snr_db
from pixsim.sensor.pixel import derive, fill_factor_law
from pixsim.sensor.reading import Readout
from pixsim.sensor.stack_options import StackOptions
from pixsim.studies.claims import (
    FIGURE_2_INTEGRATION_S,
    Evidence,
    Finding,
    by_frequency,
    dr_and_snr_db,
    findings,
    frequency_contrast_table,
    frequency_places,
    growth_exponent,
    modes,
    prominent_maxima,
    reference_process,
    rise,
    scaling_rows,
    threshold_contrast,
    verdicts,
)
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.design import cases_of, pixel_of, with_range_ends
from pixsim.studies.files import load_study
from pixsim.studies.lights import Light
from pixsim.studies.merit import (
    csf_range_lp_per_mm,
    detail_terms,
    mpe30_lx_s,
    mtf50_cy_per_mm,
    scene_to_display_mtf,
    sensitivity_e_per_lx_s_um2,
    study_mtf_terms,
    system_mtf,
)
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import check_pitches
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis, Study
from pixsim.viewer.mtf import mtf_terms

Array = np.ndarray
# Dots of a hand-made map: whole numbers of the six frequency and the eight contrast bins.
ROWS, COLUMNS = 240, 120
ROW_RATIO = 100 ** (1 / ROWS)  # of the contrasts of neighbouring rows: they span 1 to 100
CONTRAST = csf_contrast((np.arange(ROWS) + 0.5) / ROWS)[:, None]
ISO = 3.0


@dataclass(frozen=True)
class MapStudy(StudyResult):
    """A study of stated ΔE maps: pitch -> one map a sensor."""

    maps: Mapping[float, list[Array]] = field(default_factory=dict)

    def shown_scores(self, technology: str, pitch_um: float, repeats: int) -> list[SimpleNamespace]:
        assert technology == "0.35um"
        return [
            SimpleNamespace(delta_e=item, border_um=(0.0, 0.0))
            for item in self.maps[pitch_um][:repeats]
        ]


def lit(
    wavelength_nm: Array,
    band_width_nm: float,
    spectrum: Array,
    camera: Camera | None = None,
    **more: object,
) -> MapStudy:
    """A study in a light."""
    flat = SpectralImage(
        wavelength_nm, band_width_nm, 5.3, factors=(spectrum[None], np.ones((1, 4, 4)))
    )
    return MapStudy(
        Study(name="known", iso_delta_e=ISO), (), Light(flat, camera or Camera()), **more
    )


DAYLIGHT_NM = np.arange(400.0, 801.0, 5.0)


def daylight() -> MapStudy:
    return lit(DAYLIGHT_NM, 5.0, 1e-3 * d65(DAYLIGHT_NM))


SLOW = Camera(f_number=4.0)
ONE_LINE = np.array([550.0])
# nm: no lens in air is fast enough to make diffraction vanish, but a wavelength can be short enough
X_RAYS = np.array([0.01])
PAPER = derive(pixsim.Pixel(capacitance="paper"))
HOT_E = 30 * PAPER.dark_current_e_per_s * FIGURE_2_INTEGRATION_S
PAPER_NM = np.arange(400.0, 721.0, 5.0)
LINE_555_NM = np.where(PAPER_NM == 555.0, 1.0, 0.0)
EQUAL = np.ones(1)


def chen2000(spectrum: Array | None = None) -> tuple[MapStudy, pixsim.Pixel]:
    """The paper's study in daylight, or in light of a spectrum from 400 to 720 nm, (65,), and its
    pixel of 6.5 µm.
    """
    study = load_study("chen2000")
    factors = (d65(PAPER_NM) if spectrum is None else spectrum)[None], np.ones((1, 4, 4))
    light = SpectralImage(PAPER_NM, 5.0, 1e3 * DIE_MM / 4, factors=factors)
    return MapStudy(study, (), Light(light, Camera())), pixel_of(study, "0.35um", 6.5)


def snr_at_mpe30_db(pitch_um: float, integration_s: float) -> float:
    result = daylight()
    physics = derive(pixsim.Pixel(pitch_um=pitch_um, read_noise_e=12.0))
    exposure_lx_s = mpe30_lx_s(result, physics, integration_s)
    e_per_lx_s = sensitivity_e_per_lx_s_um2(result, physics) * physics.photodiode_area_um2
    signal_e = exposure_lx_s * e_per_lx_s
    return float(readout_snr_db(Readout.of(physics), signal_e, integration_s, rounding=False))


def sensitivity(response: str = "literal", cut_nm: float | None = None, **form) -> float:
    """Electrons per lx·s and µm² of daylight, or of another form of it."""
    light = form or {"factors": (SPECTRA, PICTURES)}
    image = SpectralImage(DAYLIGHT_NM, 5.0, 5.3, **light)
    result = replace(daylight(), light=Light(image, Camera()))
    return sensitivity_e_per_lx_s_um2(
        result, derive(pixsim.Pixel(response=response, infrared_cut_nm=cut_nm))
    )


def mtf_of_detail(mtf: Callable[..., Array] = study_mtf_terms, frequency_cy_per_mm=33.0):
    result, pixel = chen2000(LINE_555_NM)
    return mtf(result, derive(pixel), np.array(frequency_cy_per_mm))


LARGE = derive(pixsim.Pixel(pitch_um=12.0, quantum_efficiency=0.5))
LARGE_SIDE_MM = 1e-3 * LARGE.photodiode_side_um
PITCH_UM = np.geomspace(5.3, 15.0, 7)
SPECTRA, PICTURES = daylight().irradiance.factors
TWO_NM = np.array([450.0, 650.0])
FREQUENCY = np.linspace(0, 400, 9)
OTFS = [diffraction_otf(FREQUENCY, nm, SLOW.effective_f_number) for nm in TWO_NM]
CLAIMS = [
    *(
        Claim(
            f"the exponent of a power law of {exponent} is found",
            lambda exponent=exponent: growth_exponent(
                PITCH_UM, 20 * np.log10(3.7 * PITCH_UM**exponent)
            ),
            exponent,
            atol=1e-12,
        )
        for exponent in (0.5, -2.0)
    ),
    Claim(
        "DR and SNR of C = 2.6 + 0.22 A fF at 1 V",
        lambda: dr_and_snr_db(np.array([5.3, 15.0]), "paper"),
        [[58.4, 69.5], [35.1, 46.3]],
        atol=0.05,
        why="half a unit of the last digit, by hand",
    ),
    *(
        Claim(
            f"sensitivity in daylight, response {response}, cut at {cut_nm} nm",
            lambda response=response, cut_nm=cut_nm: sensitivity(response, cut_nm),
            expected,
            rtol=0.02,
            why="D65 times the response file, in coarser bands",
        )
        for response, cut_nm, expected in (
            ("literal", None, 430),
            ("literal", 720.0, 380),
            ("scaled", None, 3846),
            ("scaled", 720.0, 3499),
        )
    ),
    Claim(
        "sensitivity is independent of the amount of light and of its place",
        lambda: [
            sensitivity(factors=(SPECTRA, 5 * PICTURES)),
            sensitivity(factors=(SPECTRA, PICTURES * np.linspace(0, 1, 4))),
            sensitivity(data=SPECTRA[0] * PICTURES[0, :, :, None]),
        ],
        [sensitivity()] * 3,
        rtol=1e-6,
        why="pictures in float32",
    ),
    *(
        Claim(
            f"the MPE gives 30 dB at {pitch_um} µm in {integration_s} s",
            lambda pitch_um=pitch_um, integration_s=integration_s: snr_at_mpe30_db(
                pitch_um, integration_s
            ),
            30.0,
            atol=1e-9,
        )
        for pitch_um, integration_s in ((5.3, 0.03), (15.0, 0.1))
    ),
    Claim(
        "without diffraction MTF50 is that of the photodiode: sinc x = ½ at x = 0.603355",
        lambda: mtf50_cy_per_mm(lit(X_RAYS, 0.001, EQUAL, SLOW), LARGE) * LARGE_SIDE_MM,
        0.603355,
        rtol=1e-4,
        why="at 0.01 nm the lens still takes 1e-5",
    ),
    Claim(
        "without diffraction the MTF is sinc of the photodiode's side",
        lambda: system_mtf(
            lit(X_RAYS, 0.001, EQUAL, SLOW), LARGE, np.array([0.0, 0.25, 0.5]) / LARGE_SIDE_MM
        ),
        [1.0, 2**1.5 / np.pi, 2 / np.pi],
        rtol=1e-4,
        why="at 0.01 nm the lens still takes 1e-5",
    ),
    Claim(
        "MTF50 of a speck is the lens's: (2/π)(acos x - x√(1-x²)) = ½ at x = 0.403973",
        lambda: mtf50_cy_per_mm(
            lit(ONE_LINE, 10.0, EQUAL, SLOW), derive(pixsim.Pixel(fill_factor=1e-4))
        ),
        0.403973 * 1e6 / (550.0 * SLOW.effective_f_number),
        rtol=1e-3,
        why="the speck of 65 nm takes 2e-4",
    ),
    Claim(
        "wavelengths of equal power and QE weigh as photons: as λ",
        lambda: system_mtf(
            lit(TWO_NM, 10.0, np.ones(2), SLOW),
            derive(pixsim.Pixel(fill_factor=1e-8, quantum_efficiency=0.3)),
            FREQUENCY,
        ),
        (450 * OTFS[0] + 650 * OTFS[1]) / 1100,
        atol=1e-7,
    ),
    Claim(
        "terms at 33 lp/mm: f/4 at 555 nm; sides of √0.3106 · 6.5 µm, 6.5 µm (sinc²) and 5.3 µm",
        lambda: list(mtf_of_detail().values()),
        [0.906, 0.977, 0.858, 0.950],
        atol=5e-4,
        why="three digits, by hand",
    ),
    Claim(
        "to the sensor: lens times photodiode",
        lambda: mtf_of_detail(system_mtf),
        0.906 * 0.977,
        atol=1e-3,
        why="products of three digits",
    ),
    Claim(
        "to the display: all terms",
        lambda: mtf_of_detail(scene_to_display_mtf),
        0.906 * 0.977 * 0.858 * 0.950,
        atol=2e-3,
        why="products of three digits",
    ),
    Claim(
        "silicon sees the red of daylight, which is diffracted more",
        lambda: study_mtf_terms(chen2000()[0], derive(chen2000()[1]), np.array(33.0))["lens"],
        0.90,
        atol=0.005,
        why="0.25 % of contrast for 10 nm",
    ),
    Claim(
        "a dark picture takes equal light",
        lambda: list(
            study_mtf_terms(
                chen2000(np.zeros(65))[0], derive(pixsim.Pixel(pitch_um=6.5)), np.array(33.0)
            ).values()
        ),
        list(
            study_mtf_terms(
                chen2000(np.ones(65))[0], derive(pixsim.Pixel(pitch_um=6.5)), np.array(33.0)
            ).values()
        ),
    ),
]


NYQUIST = np.array([0.0, 1e3 / 13.0])


def stack_term(name: str, **stack: object) -> Array:
    """A term of a pixel of 6.5 µm with a stack, at 0 and at its Nyquist frequency."""
    result, pixel = chen2000(LINE_555_NM)
    options = StackOptions(**{"height_um": 8.0, "index": 1.5, "shift": "optimal"} | stack)
    physics = derive(pixel.model_copy(update={"stack": options}))
    return study_mtf_terms(result, physics, NYQUIST)[name]


STACK_CLAIMS = [
    Claim(
        "the MTF of a microlens is that of its aperture, the pitch",
        lambda: stack_term("microlens", microlens="square"),
        [1, 2 / np.pi],
        atol=1e-12,
    ),
    Claim(
        "at Nyquist, crosstalk c of four neighbours leaves 1 - c: (1 - c) + c/4 (2 cos π + 2)",
        lambda: (
            stack_term("crosstalk", microlens="square", crosstalk=0.2)
            / stack_term("crosstalk", microlens="square")
        ),
        [1.0, 0.8],
        atol=0.01,
        why="what the stack itself leaves",
    ),
    Claim(
        "the opening of a low stack is the photodiode",
        lambda: stack_term("opening", height_um=1e-3),
        mtf_of_detail(frequency_cy_per_mm=NYQUIST)["photodiode"],
        atol=1e-5,
        why="h NA/n w = 2e-5",
    ),
    Claim(
        "charge diffuses as of its kernel",
        lambda: stack_term("diffusion", depletion_um=1.0, diffusion_length_um=10.0),
        diffusion_mtf(NYQUIST, absorption_per_um(555.0), 1.0, 10.0),
        rtol=1e-12,
    ),
]


def test_terms_of_detail_are_those_of_a_frequency_of_the_picture() -> None:
    """Half the Nyquist frequency, or the highest of the chart."""
    result, pixel = chen2000()
    setup = imaging(result.camera, pixel, display=result.study.display)
    frequency, _, sensor_terms, display_terms = detail_terms(setup, result.irradiance)
    assert frequency == 1e3 / (4 * 6.5)
    assert sensor_terms | display_terms == mtf_terms(setup, result.irradiance, np.array(frequency))
    assert detail_terms(setup, chart_light())[0] == pytest.approx(33.3, abs=0.05)


def test_mtf_terms_name_the_real_lens() -> None:
    """With the MTF of its aberrations, in place of diffraction."""
    result, pixel = chen2000()
    options = LensOptions(file="singlet", focal_length_mm=12.0)
    camera = camera_with_lens(Camera(object_distance_m=5.0), CameraOptions(), options)
    result.irradiance.header.update({LENS_HEADER: asdict(Tiling(300.0, 80.0, 0.0))})
    real, thin = (
        mtf_terms(
            imaging(each, pixel, display=result.study.display), result.irradiance, np.array(30.0)
        )
        for each in (camera, without_lens(camera))
    )
    assert 0.01 < float(real["real lens"]) < 0.7 * float(thin["lens"])


# --- maps
# -------------------------------------------------------------------------------------------------------------


def map_of(thresholds: list[float]) -> Array:
    """ΔE in proportion to contrast, that reaches ISO at a contrast in each frequency bin."""
    return ISO * CONTRAST / np.repeat(thresholds, COLUMNS // 6)[None, :]


def chart_light() -> SpectralImage:
    light = chen2000()[0].irradiance
    light.header.update({"scene": "csf.xml"})
    return light


OVER_FREQUENCY = np.tile(
    np.log(csf_frequency_lp_per_mm((np.arange(COLUMNS) + 0.5) / COLUMNS)), (ROWS, 1)
)
OVER_CONTRAST = np.repeat(np.log(CONTRAST), COLUMNS, axis=1)
BIN_LP_PER_MM = (100 / 3) ** (np.arange(1, 12, 2) / 12)
THRESHOLD = np.array([0.03, 0.1, 0.3, 0.5, 0.7, 0.9])
MAP_CLAIMS = [
    Claim(
        "bins of frequency are of equal ratio, from 1 to 33.3 lp/mm",
        lambda: csf_frequency_lp_per_mm(frequency_contrast_table(OVER_FREQUENCY)[0]),
        BIN_LP_PER_MM,
        rtol=1e-9,
    ),
    Claim(
        "bins of contrast are of equal ratio, downwards from 0.951",
        lambda: np.sort(frequency_contrast_table(OVER_CONTRAST)[1]),
        975 / 1025 * 0.01 ** (np.arange(15, 0, -2) / 16),
        rtol=1e-9,
    ),
    Claim(
        "the mean of log frequency over a bin is the log of its middle",
        lambda: np.exp(frequency_contrast_table(OVER_FREQUENCY)[2]),
        np.tile(BIN_LP_PER_MM, (8, 1)),
        rtol=1e-9,
    ),
    Claim(
        "the mean of log contrast over a bin is the log of its middle",
        lambda: np.exp(frequency_contrast_table(OVER_CONTRAST)[2][:, 0]),
        frequency_contrast_table(OVER_CONTRAST)[1],
        rtol=1e-9,
    ),
    Claim(
        "the mean over contrast has the same bins of frequency",
        lambda: np.exp(by_frequency(OVER_FREQUENCY)[0]),
        csf_frequency_lp_per_mm(frequency_places()),
        rtol=1e-9,
    ),
    Claim(
        "the threshold of a map in proportion to contrast is that at which it reaches the level",
        lambda: threshold_contrast(map_of(THRESHOLD.tolist()), ISO),
        THRESHOLD,
        rtol=ROW_RATIO**2 - 1,
        why="up to a row late; near the last row smoothing lowers it by up to another row",
    ),
    Claim(
        "a map that does not reach the level has no threshold",
        lambda: threshold_contrast(map_of([2.0] * 6), ISO),
        [np.inf] * 6,
    ),
    Claim(
        "the threshold of a bump is its first crossing: ½ at 0.1 e^-0.416",
        lambda: threshold_contrast(
            np.repeat(np.exp(-((np.log(CONTRAST / 0.1) / 0.5) ** 2)), COLUMNS, axis=1), 0.5
        ),
        np.full(6, 0.1 * np.exp(-0.5 * np.sqrt(np.log(2)))),
        rtol=ROW_RATIO - 1 + 0.005,
        why="a row late; smoothed by 4 rows, the Gaussian passes ½ 0.5 % nearer",
    ),
    Claim(
        "a tenth of the width on both sides leaves the chart's frequencies from .1 to .9",
        lambda: csf_range_lp_per_mm(chart_light(), (0.0, 100 * DIE_MM)) or (),
        [(100 / 3) ** 0.1, (100 / 3) ** 0.9],
        rtol=1e-9,
    ),
    Claim(
        "maps are the mean of eight sensors",
        lambda: Evidence(
            lit(
                ONE_LINE,
                10.0,
                EQUAL,
                maps={
                    size: [np.full((ROWS, COLUMNS), float(n)) for n in range(10)]
                    for size in THRESHOLDS
                },
            ),
            {},
        ).maps[8.0],
        np.full((ROWS, COLUMNS), 3.5),
    ),
    Claim(
        "thirty times the dark current makes thirty times the dark charge in equation (1)",
        lambda: dr_and_snr_db(
            np.array([6.5]),
            "paper",
            reference_process(
                Study(name="known", process={"0.35um": {"dark_current_na_per_cm2": 30.0}})
            ),
        )[0],
        [
            20
            * np.log10((PAPER.full_well_e - HOT_E) / np.hypot(PAPER.reset_noise_e, np.sqrt(HOT_E)))
        ],
        atol=1e-9,
    ),
]


RNG = np.random.default_rng(1)
BELL = RNG.normal(1.0, 0.3, (256, 256))
APART = np.where(RNG.random((256, 256)) < 0.3, 1.0, 0.0)
DISTRIBUTIONS = {
    "a bell": (BELL, 1),
    "a long tail": (RNG.gamma(2.0, 0.4, (256, 256)), 1),
    "a mode at zero": (RNG.exponential(0.5, (256, 256)), 1),
    "two, 5 σ apart": (BELL + 1.5 * APART, 2),
    "two, 1 σ apart: their sum has one maximum": (BELL + 0.3 * APART, 1),
}
MODE_CLAIMS = [
    *(
        Claim(
            f"prominent maxima as of SciPy, smooth over {smoothing}, {padding} zeros, {prominence}",
            lambda curve=curve, prominence=prominence: prominent_maxima(
                curve, prominence * curve.max()
            ),
            len(signal.find_peaks(curve, prominence=prominence * curve.max())[0]),
        )
        for smoothing in (0.5, 2.0, 8.0)
        for padding in (0, 20)  # around it, as a density has them
        for prominence in (0.02, 0.1, 0.5)
        for curve in [
            np.pad(
                ndimage.gaussian_filter1d(np.random.default_rng(5).random(300), smoothing), padding
            )
        ]
    ),
    *(
        Claim(f"modes of {name}", lambda values=values: modes(values), count)
        for name, (values, count) in DISTRIBUTIONS.items()
    ),
]

# Intervals ±0.3 and ±0.4 at the ends: the whole rise has to exceed 0.5.
A, B, C = (0.7, 1.3), (1.0, 1.2), (1.2, 2.0)
RISES = [
    Claim(
        f"whether {values} rise within {intervals}",
        lambda values=values, intervals=intervals: int(rise(values, intervals)),
        int(agrees),
    )
    for values, intervals, agrees in (
        ((1.0, 1.2, 1.6), (A, B, C), True),  # the whole rise, 0.6, exceeds its 95 % interval, ±0.5
        ((1.0, 1.2, 1.4), (A, B, (1.0, 2.0)), False),  # 0.4 is within ±0.5
        ((1.0, 1.0, 1.6), (A, B, C), True),  # a step that neither rises nor falls
        ((1.0, 1.7, 1.6), (A, B, C), False),
        ((1.6, 1.5, 1.0), (A, B, C), False),
        ((1.0, 1.0, 1.0), ((1.0, 1.0),) * 3, False),
        ((1.0, 1.2, 1.6), (A, B, (None, 2.0)), False),
        ((1.0, 1.2, 1.6), ((0.7, None), B, C), False),
        ((1.0, 1.2, 1.6), ((0.7, None), B, (None, 2.0)), False),
        # Of the ends that the rise does not depend on, none matters; a value with no interval at
        # all is not known.
        ((1.0, 1.2, 1.6), ((None, 1.3), (None, 1.2), (1.2, None)), True),
        ((1.0, 1.2, 1.6), (A, (None, None), C), False),
    )
]


@pytest.mark.parametrize(
    "claim", [*CLAIMS, *STACK_CLAIMS, *MAP_CLAIMS, *MODE_CLAIMS, *RISES], ids=str
)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# --- the table
# --------------------------------------------------------------------------------------------------------

FEATURE_UM = {"0.5um": 0.5, "0.35um": 0.35, "0.25um": 0.25, "0.18um": 0.18}
OPTIMA_UM = {
    "0.5um": 8.6,
    "0.35um": 6.5,
    "0.25um": 5.0,
    "0.18um": 3.9,
}  # 17.2, 18.6, 20.0 and 21.7 features
BEST = {"0.5um": 0.45, "0.35um": 0.5, "0.25um": 0.55, "0.18um": 0.6}
# Contrast at which each frequency bin reaches the iso level, as Figure 6 orders them: 15 < 8 < 6;
# 5.3 crosses 6.
THRESHOLDS = {
    15.0: [0.80, 0.75, 0.70, 0.60, 0.50, 0.30],
    8.0: [2.00, 0.90, 0.80, 0.70, 0.60, 0.40],
    6.0: [2.00, 0.94, 0.90, 0.80, 0.70, 0.60],
    5.3: [0.70, 0.75, 0.80, 0.85, 0.90, 2.00],
}


def curve_of(technology: str, optimum_um: float, best: float) -> Curve:
    """A parabola in log pitch with its minimum at `optimum_um`, the same for two sensors."""
    pitch_um = np.geomspace(0.85, 1.8, 16) * optimum_um
    delta_e = np.repeat((best + 0.5 * np.log(pitch_um / optimum_um) ** 2)[:, None], 2, axis=1)
    fill_factor = np.clip(fill_factor_law(pitch_um, pixsim.load_technology(technology)), 0, 1)
    return Curve(
        technology,
        FEATURE_UM[technology],
        pitch_um,
        fill_factor,
        {"mean_delta_e": delta_e},
        fit_curve(pitch_um, delta_e),
    )


def evidence(
    optima_um: Mapping[str, float] = OPTIMA_UM,
    best: Mapping[str, float] = BEST,
    thresholds: Mapping[float, list[float]] | None = None,
    second_mode: float = 0.0,
    at_low_contrast: float = 0.0,
) -> Evidence:
    maps = {pitch: map_of(item) for pitch, item in (THRESHOLDS | dict(thresholds or {})).items()}
    # Errors of 8 µm from 0 to twice `at_low_contrast` in the third contrast bin of eight, at the
    # highest frequencies.
    maps[8.0][60:90, -20:] += at_low_contrast * np.linspace(0, 2, 600).reshape(30, 20)
    # In the first sensor every other dot is worse by `second_mode`, in the second better: their
    # mean is the map.
    comb = second_mode * (np.indices((ROWS, COLUMNS)).sum(axis=0) % 2)
    sensor_maps = {pitch: [item + comb, item - comb] for pitch, item in maps.items()}
    curves = {name: curve_of(name, optima_um[name], best[name]) for name in optima_um}
    return Evidence(lit(ONE_LINE, 10.0, np.ones(1), maps=sensor_maps), curves)


reference = cache(evidence)


# 5 to 73 % of 5.3 to 15 µm are areas as pitch^4.6, not the pitch^1 that √pitch would take.
GROWTH = {"DR grows roughly as √pitch", "SNR at 20 % well grows roughly as √pitch"}
OPTIMUM, ITS_FILL_FACTOR = "Optimal pixel size at 0.35 µm", "Its fill factor"
EIGHT, SIX = "Iso-ΔE = 3: 8 µm is better than 15 µm", "Iso-ΔE = 3: 6 µm is better than 8 µm"
CROSS, UNIMODAL, MAX_VALUE = (
    "Iso-ΔE = 3: 6 and 5.3 µm cross",
    "Distribution of ΔE (8 µm)",
    "Largest errors (8 µm)",
)
SHRINKS, SLOWER = "The optimum shrinks with technology", "… but slower than the technology"
WORSE = "The best mean ΔE gets worse as technology shrinks"
STATEMENTS = {
    *(f"Fill factor at {size} µm" for size in ("5.3", "6.5", "15")),
    *(f"{name} from 5.3 to 15 µm (Fig. 2a)" for name in ("DR", "SNR at 20 % well")),
    *(
        GROWTH
        | {OPTIMUM, ITS_FILL_FACTOR, EIGHT, SIX, CROSS, UNIMODAL, MAX_VALUE, SHRINKS, SLOWER, WORSE}
    ),
}


def table(data: Evidence) -> dict[str, Finding]:
    return {row.statement: row for row in findings(data)}


FLIPS = {
    "none": ({}, set()),
    # 25.7 and 26.7 features of 0.35 and 0.25 µm
    "optimum at 9 µm": ({"optima_um": {"0.5um": 10.0, "0.35um": 9.0, "0.25um": 6.6, "0.18um": 4.8}}, {OPTIMUM, ITS_FILL_FACTOR}),
    "optima grow": ({"optima_um": {"0.5um": 6.0, "0.35um": 6.5, "0.25um": 7.0, "0.18um": 7.5}}, {SHRINKS}),
    # 26, 18.6, 17.6 and 16.7 features
    "faster than technology": ({"optima_um": {"0.5um": 13.0, "0.35um": 6.5, "0.25um": 4.4, "0.18um": 3.0}}, {SLOWER}),
    # 17.2, 18.6, 26.4, 21.7
    "one optimum out of order": ({"optima_um": OPTIMA_UM | {"0.25um": 6.6}}, {SHRINKS, SLOWER}),
    "errors shrink with technology": ({"best": dict(zip(BEST, (0.6, 0.55, 0.5, 0.45), strict=True))}, {WORSE}),
    "15 µm wins at one frequency": ({"thresholds": {15.0: [0.80, 0.75, 0.70, 0.60, 0.50, 0.45]}}, {EIGHT}),
    "8 µm is 15 µm": ({"thresholds": {15.0: THRESHOLDS[8.0]}}, {EIGHT}),
    "8 µm wins at the lowest frequency": ({"thresholds": {6.0: [0.5, *THRESHOLDS[6.0][1:]]}}, {SIX, CROSS}),
    "5.3 µm is worse everywhere": ({"thresholds": {5.3: [0.2] * 6}}, {CROSS}),
    "5.3 µm is better everywhere": ({"thresholds": {5.3: [2.0, 0.945, 0.93, 0.92, 0.91, 0.9]}}, {CROSS}),
    "they cross the other way": ({"thresholds": {5.3: [2.0, 2.0, 2.0, 0.5, 0.4, 0.3]}}, {CROSS}),
    "errors at low frequencies": (
        {"thresholds": {8.0: [0.30, 0.90, 0.92, 0.93, 0.60, 0.40], 15.0: [0.2] * 6, 6.0: [2.0] * 6}},
        {MAX_VALUE, CROSS},
    ),
    # so 8 µm reaches ΔE 3 there
    "errors at low contrast": ({"at_low_contrast": 10.0}, {MAX_VALUE, EIGHT}),
    "two kinds of errors": ({"second_mode": 4.0}, {UNIMODAL}),
}  # fmt: skip


@pytest.mark.parametrize(("change", "against"), FLIPS.values(), ids=FLIPS)
def test_findings_contrary_evidence_flips_one_row(change: dict, against: set[str]) -> None:
    rows = table(evidence(**change))
    assert rows.keys() == STATEMENTS, "a row that does not agree stays in"
    assert {name for name, row in rows.items() if not row.agrees} == GROWTH | against


@pytest.mark.parametrize(
    ("technology", "change", "statement", "agrees"),
    [
        # about 6.5 µm: within 0.4 µm
        ("0.35um", {"pitch_um": 6.05}, OPTIMUM, False),
        ("0.35um", {"pitch_um": 6.15}, OPTIMUM, True),
        ("0.35um", {"pitch_um": 6.85}, OPTIMUM, True),
        ("0.35um", {"pitch_um": 6.95}, OPTIMUM, False),
        # a minimum at an end is no optimum, and no part of a trend
        ("0.35um", {"inside": False}, OPTIMUM, False),
        ("0.25um", {"inside": False}, OPTIMUM, True),
        *(
            (name, {"inside": False}, trend, False)
            for name in FEATURE_UM
            for trend in (SHRINKS, SLOWER, WORSE)
        ),
        # Optima that shrink, 8.6 to 3.9 µm: the largest process's may be as small as its interval
        # allows, the smallest's as large.
        ("0.5um", {"interval_um": (8.0, None)}, SHRINKS, True),
        ("0.5um", {"interval_um": (None, 9.0)}, SHRINKS, False),
        # 4.8 µm of uncertainty, 4.7 µm of trend
        ("0.5um", {"interval_um": (3.8, 9.0)}, SHRINKS, False),
        ("0.18um", {"interval_um": (None, 4.0)}, SHRINKS, True),
        ("0.18um", {"interval_um": (3.8, None)}, SHRINKS, False),
    ],
)
def test_findings_of_another_optimum(
    technology: str, change: dict, statement: str, agrees: bool
) -> None:
    curve = reference().curves[technology]
    other = replace(curve, fit=replace(curve.fit, optimum=replace(curve.optimum, **change)))
    rows = table(Evidence(reference().result, reference().curves | {technology: other}))
    assert rows[statement].agrees is agrees


def test_findings_numbers_are_the_evidence() -> None:
    """The law's fill factor of 31.0 %; the middles of the six bins are (100/3)^(1/12) to
    (100/3)^(11/12) lp/mm, and the thresholds above cross between 3 and 4.
    """
    rows = table(reference())
    assert {name: rows[name].found for name in (ITS_FILL_FACTOR, SLOWER, CROSS)} == {
        ITS_FILL_FACTOR: "31 %",
        SLOWER: "17.2, 18.6, 20.0, 21.7 at 0.5, 0.35, 0.25, 0.18 µm",
        CROSS: "6 µm better at 1.3, 2.4, 4.3 lp/mm, 5.3 µm at 7.7, 14, 25 lp/mm",
    }


@pytest.mark.parametrize(
    ("size", "settings", "percent"),
    [
        ("15", {"process": {"0.35um": {"fill_factor_limit": 0.413}}}, 36.45),  # half of 72.9
        # ((p - s)² - (p0 - s)²)/p² with s = 4.9 F and p0 = 14.54 F
        (
            "6.5",
            {"pixel": {"fill_factor_law": "inset_unlimited"}},
            100 * (4.785**2 - 3.374**2) / 42.25,
        ),
    ],
)
def test_findings_follow_study_process(size: str, settings: dict, percent: float) -> None:
    """Half of the fill factor, and another law, as printed to 0.1 %."""
    study = Study.model_validate({"name": "known", "iso_delta_e": ISO} | settings)
    data = Evidence(replace(reference().result, study=study), reference().curves)
    row = table(data)[f"Fill factor at {size} µm"]
    assert float(row.found.removesuffix("%")) == pytest.approx(percent, abs=0.06)
    assert not row.agrees


def test_findings_omit_rows_without_data() -> None:
    """One technology says nothing about scaling; without 0.35 µm there is no optimum to compare."""
    scaling = {SHRINKS, SLOWER, WORSE}
    assert table(evidence({"0.35um": 6.5})).keys() == STATEMENTS - scaling
    others = table(evidence({"0.25um": 5.0, "0.18um": 3.9})).keys()
    assert others & (scaling | {OPTIMUM, ITS_FILL_FACTOR, EIGHT, CROSS, UNIMODAL}) == scaling


# A chart whose cells are computed, on few dots; every pitch that the paper's statements need.
BASE_TOML = tiny_toml(
    repeats=4,
    seed=1,
    technologies=["0.35um", "0.25um"],
    paper=True,
    pixel={"prnu": 0.02},
    pitch={"values_um": [4.0, 5, 6, 7, 8]},
    camera={"die_mm": 0.7},
    display={"dots": 32},
    resolution=COARSE,
)
SENSITIVITY_TOML = """
name = "tiny-sensitivity"
repeats = 2
pitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0] }
[[axis]]
name = "PRNU"
set = "pixel.prnu"
values = [0.02]
alone = true
[[axis]]
name = "light"
values = [
    { label = "half", set.scene.parameters.luminance_cd_per_m2 = 50.0 },
    { label = "f/2.8", set.camera.f_number = 2.8 },
]
alone = true
[[axis]]
name = "dark current"
range_of = "dark_current_na_per_cm2"
alone = true
"""


PEAK = Axis.model_validate({"name": "peak", "range_of": "peak_quantum_efficiency", "alone": True})


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both files."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "tiny.toml").write_text(BASE_TOML, encoding="utf-8")
    (folder / "sensitivity.toml").write_text(SENSITIVITY_TOML, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def done(desk: Path):
    return pixsim.study(desk / "tiny.toml", desk / "one", config=desk / "sensitivity.toml", jobs=1)


def case(result, axis: str, value: float | str) -> StudyResult:
    (part,) = [
        part
        for part in result.parts
        if part.curves[0].alone == axis and part.curves[0].at[axis] == value
    ]
    return part


def test_range_of_covers_both_ends_in_all_and_alone(desk: Path) -> None:
    """The measured 0.37 of 0.35 µm has no range, so that the peak moves in one technology only; its
    upper end is 0.37. The random streams are those of the base.
    """
    study = load_study(desk / "tiny.toml", desk / "sensitivity.toml")
    study = with_range_ends(study.model_copy(update={"axis": (*study.axis, PEAK)}))
    assert (study.name, study.stream_name, study.repeats) == ("tiny-sensitivity", "tiny", 2)
    assert {axis.name: [point.label for point in axis.points] for axis in study.axis[2:]} == {
        "dark current": ["all low", "0.35um 0.333", "0.25um 1", "all high", "0.35um 3", "0.25um 9"],
        "peak": ["0.25um 0.2", "0.25um 0.37"],
    }
    (high,) = [each for each in cases_of(study) if each.words == "dark current: all high"]
    assert high.settings.process == {
        "0.35um": {"dark_current_na_per_cm2": 3.0},
        "0.25um": {"dark_current_na_per_cm2": 9.0},
    }


def axes(number: str, **process: float) -> tuple[Axis, ...]:
    axis = {"name": "d", "range_of": number, "alone": True}
    return with_range_ends(tiny(process={"0.35um": process}, axis=[axis])).axis


def test_range_of_leaves_out_what_has_no_range_and_an_end_that_is_set() -> None:
    """The peak of 0.35 µm is measured."""
    with pytest.warns(UserWarning, match="no technology of the study has a range"):
        assert axes("peak_quantum_efficiency") == ()
    low, high = pixsim.load_technology("0.35um").ranges["dsnu"]
    points = [point.label for axis in axes("dsnu", dsnu=low) for point in axis.points]
    assert points == [f"0.35um {high:g}"]


def test_base_case_equals_the_base_study(done, desk: Path) -> None:
    """Same rows as the base run alone with these pitches and sensors: the random streams are its
    own.
    """
    over = {"repeats": 2, "pitch": {"values_um": PITCHES_UM}}
    alone = pixsim.study(desk / "tiny.toml", desk / "a", jobs=1, **over)
    for curve, expected in zip(done.parts[0].curves, alone.curves, strict=True):
        np.testing.assert_array_equal(curve.delta_e, expected.delta_e)
    assert set(keys(desk / "a")) < set(keys(desk / "one"))


def test_setting_of_the_base_changes_nothing(done) -> None:
    """The smallest pixel lacks light: half of it makes more noise, 2 (4/2.8)² less."""
    base = done.parts[0].curves[0].delta_e
    np.testing.assert_array_equal(case(done, "PRNU", 0.02).curves[0].delta_e, base)
    assert (case(done, "light", "half").curves[0].delta_e[0] / base[0]).min() > 1.05
    assert (case(done, "light", "f/2.8").curves[0].delta_e[0] / base[0]).max() < 0.95


def test_statements_of_a_case_are_those_of_the_study_alone(done, desk: Path) -> None:
    """All of the paper. The rows of its process are shared between cases that do not change it."""
    part = case(done, "dark current", "all high")
    whole = pixsim.study(part.study.model_copy(update={"streams": "tiny"}), desk / "whole", jobs=1)
    rows = findings(Evidence(whole, {curve.technology: curve for curve in whole.curves}))
    assert list(done.findings[done.parts.index(part)]) == rows
    assert len(rows) == 17
    unchanged = done.parts.index(case(done, "dark current", "0.25um 9"))
    assert done.findings[unchanged][:-3] == done.findings[0][:-3]


# --- verdicts


def test_verdicts_list_the_cases_that_turn_them() -> None:
    """Optima of 6.5 µm at 0.35 µm (base); narrow 6.4 and 12; wide 6 and 8: 18.6 features, and 20.8
    and 22.8 of the others.

    At 8 µm, 22.9 features, the optimum no longer shrinks slower. At 12 µm neither.
    """
    base = lit(ONE_LINE, 10.0, EQUAL)
    parts = []
    for axis, label, size_um in (
        ("", "base", 6.5),
        ("narrow", "a", 6.4),
        ("narrow", "e", 12.0),
        ("wide", "b", 6.0),
        ("wide", "d", 8.0),
    ):
        values = {"narrow": "base", "wide": "base"} | ({axis: label} if axis else {})
        optima_um = {"0.35um": size_um, "0.25um": 5.2, "0.18um": 4.1}
        curves = tuple(
            replace(curve_of(name, optimum_um, BEST[name]), case=CaseLabels(values, alone=axis))
            for name, optimum_um in optima_um.items()
        )
        parts.append(StudyResult(base.study, curves, base.light))
    by_technology = tuple(part.curves[place] for place in range(3) for part in parts)
    rows = tuple(tuple(scaling_rows(part.curves)) for part in parts)
    result = CasesResult(base.study, by_technology, base.light, parts=tuple(parts), findings=rows)
    by_statement = {verdict.finding.statement: verdict for verdict in verdicts(result)}
    words = {name: verdict_words(verdict) for name, verdict in by_statement.items()}
    assert sorted(words.values()) == ["", "", "narrow: e; wide: d"]
    assert words[SLOWER] == "narrow: e; wide: d"
    assert by_statement[SLOWER].finding.agrees


# --- the packaged analysis


def test_packaged_cases_are_valid_and_distinct() -> None:
    """All 89 settings of the table in docs/paper.md, each for all four technologies; the base is
    chen2000, as its verdicts.
    """
    cases = list(cases_of(with_range_ends(load_study("chen2000-sensitivity"))))
    assert len(cases) == len({each.settings.content_hash for each in cases}) == 90
    assert len({each.folder for each in cases}) == 90, "labels read alike"
    for study in (each.settings for each in cases):
        check_pitches(study)
        assert (study.seed, study.stream_name, study.technologies) == (2000, "chen2000", (*BEST,))
    chen2000 = load_study("chen2000")
    names = {"name": "chen2000", "streams": None, "title": chen2000.title}
    assert cases[0].settings.model_dump() | names == chen2000.model_dump()
