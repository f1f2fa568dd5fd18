"""Comparison with the paper: closed forms, and rows that agree if and only if the evidence does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.chains import imaging
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

import pixsim
from pixsim.light.spectral import SpectralImage, d65
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens, without_lens
from pixsim.optics.diffraction import diffraction_otf
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.charts import DIE_MM, csf_contrast, csf_frequency_lp_per_mm
from pixsim.sensor.diffusion import absorption_per_um, diffusion_mtf
from pixsim.sensor.pixel import derive, fill_factor_law
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import load_technology
from pixsim.studies.claims import (
    FIGURE_2_INTEGRATION_S,
    Evidence,
    Finding,
    Interval,
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
    threshold_contrast,
)
from pixsim.studies.curve import Curve
from pixsim.studies.design import pixel_of
from pixsim.studies.files import load_study
from pixsim.studies.lights import Light
from pixsim.studies.merit import (
    detail_terms,
    mpe30_lx_s,
    mtf50_cy_per_mm,
    scene_to_display_mtf,
    sensitivity_e_per_lx_s_um2,
    study_mtf_terms,
    system_mtf,
)
from pixsim.studies.optimum import fit_curve
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Study
from pixsim.viewer.mtf import mtf_terms

Array = np.ndarray
# Dots of a hand-made map: whole numbers of the six frequency and the eight contrast bins.
ROWS, COLUMNS = 240, 120
ROW_RATIO = 100 ** (1 / ROWS)  # of the contrasts of neighbouring rows: they span 1 to 100
CONTRAST = csf_contrast((np.arange(ROWS) + 0.5) / ROWS)[:, None]
LOG_FREQUENCY = np.log(csf_frequency_lp_per_mm((np.arange(COLUMNS) + 0.5) / COLUMNS))[None, :]
ISO = 3.0


@dataclass(frozen=True)
class Known(StudyResult):
    """A study whose ΔE maps are given: pitch -> one map a sensor."""

    given: Mapping[float, list[Array]] = field(default_factory=dict)

    def shown_scores(self, technology: str, pitch_um: float, repeats: int) -> list[SimpleNamespace]:
        assert technology == "0.35um"
        return [
            SimpleNamespace(delta_e=item, border_um=(0.0, 0.0))
            for item in self.given[pitch_um][:repeats]
        ]


def lit(
    wavelength_nm: Array,
    band_width_nm: float,
    spectrum: Array,
    camera: Camera | None = None,
    **more: object,
) -> Known:
    """A study in a given light."""
    flat = SpectralImage(
        wavelength_nm, band_width_nm, 5.3, factors=(spectrum[None], np.ones((1, 4, 4)))
    )
    return Known(Study(name="known", iso_delta_e=ISO), (), Light(flat, camera or Camera()), **more)


def daylight(longest_nm: float = 800.0) -> Known:
    nm = np.arange(400.0, longest_nm + 1, 5.0)
    return lit(nm, 5.0, 1e-3 * d65(nm))


# --- powers, noise and light
# ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [0.5, 1.2, -2.0])
def test_growth_exponent_of_power_law(exponent: float) -> None:
    pitch_um = np.geomspace(5.3, 15.0, 7)
    assert growth_exponent(pitch_um, 20 * np.log10(3.7 * pitch_um**exponent)) == pytest.approx(
        exponent, abs=1e-12
    )


def test_dr_and_snr_db_match_hand_calculation() -> None:
    """By hand, C = 2.6 + 0.22 A fF and 1 V: DR 58.4 to 69.5 dB and SNR 35.1 to 46.3 dB; half a unit
    of the last digit.
    """
    dr, snr = dr_and_snr_db(np.array([5.3, 15.0]), "paper")
    assert dr == pytest.approx([58.4, 69.5], abs=0.05)
    assert snr == pytest.approx([35.1, 46.3], abs=0.05)
    # A shot-limited SNR grows as √charge, and the charge here as C.
    area = np.array([derive(Pixel(pitch_um=p)).photodiode_area_um2 for p in (5.3, 15.0)])
    shot_db = 10 * np.log10((2.6 + 0.22 * area[1]) / (2.6 + 0.22 * area[0]))
    assert np.ptp(snr) == pytest.approx(
        shot_db, abs=0.6
    )  # reset noise holds the small pixel back by 0.5 dB


@pytest.mark.parametrize(
    ("response", "all_of_it", "cut_at_720"), [("literal", 430, 380), ("scaled", 3846, 3499)]
)
def test_sensitivity_of_daylight(response: str, all_of_it: float, cut_at_720: float) -> None:
    """Worked out apart from pixsim, D65 times the response file; 2 % for its coarser bands."""
    for cut, expected in ((None, all_of_it), (720.0, cut_at_720)):
        physics = derive(Pixel(response=response, infrared_cut_nm=cut))
        assert sensitivity_e_per_lx_s_um2(daylight(), physics) == pytest.approx(expected, rel=0.02)


def test_sensitivity_is_independent_of_amount_and_form() -> None:
    result, physics = daylight(), derive(Pixel())
    spectra, pictures = result.irradiance.factors
    expected = sensitivity_e_per_lx_s_um2(result, physics)
    for picture in (5 * pictures, pictures * np.linspace(0, 1, 4)):
        for form in (
            {"factors": (spectra, picture)},
            {"data": spectra[0] * picture[0, :, :, None]},
        ):
            image = SpectralImage(result.irradiance.wavelength_nm, 5.0, 5.3, **form)
            other = replace(result, light=replace(result.light, image=image))
            assert sensitivity_e_per_lx_s_um2(other, physics) == pytest.approx(
                expected, rel=1e-6
            )  # float32 pictures


@pytest.mark.parametrize(("pitch_um", "integration_s"), [(5.3, 0.03), (8.0, 0.03), (15.0, 0.1)])
def test_mpe30_gives_30_db(pitch_um: float, integration_s: float) -> None:
    result, readout = daylight(), Readout.of(derive(Pixel(pitch_um=pitch_um, read_noise_e=12.0)))
    exposure_lx_s = mpe30_lx_s(result, readout.physics, integration_s)
    signal_e = (
        exposure_lx_s
        * sensitivity_e_per_lx_s_um2(result, readout.physics)
        * readout.physics.photodiode_area_um2
    )
    assert readout.snr_db(signal_e, integration_s) == pytest.approx(30.0, abs=1e-9)


# --- sharpness
# --------------------------------------------------------------------------------------------------------

SLOW = Camera(f_number=4.0)
ONE_LINE = np.array([550.0])
# nm: no lens in air is fast enough to make diffraction vanish, but a wavelength can be short enough
X_RAYS = np.array([0.01])


@pytest.mark.parametrize("pitch_um", [6.0, 12.0])
def test_mtf50_without_diffraction_is_photodiodes(pitch_um: float) -> None:
    """sinc(x) = ½ at x = 0.603355."""
    result, physics = (
        lit(X_RAYS, 0.001, np.ones(1), SLOW),
        derive(Pixel(pitch_um=pitch_um, quantum_efficiency=0.5)),
    )
    side_mm = 1e-3 * physics.photodiode_side_um
    assert mtf50_cy_per_mm(result, physics) * side_mm == pytest.approx(
        0.603355, rel=1e-4
    )  # at 0.01 nm the lens still takes 1e-5
    mtf = system_mtf(result, physics, np.array([0.0, 0.25, 0.5]) / side_mm)
    assert mtf == pytest.approx([1.0, 2**1.5 / np.pi, 2 / np.pi], rel=1e-4)


def test_mtf50_of_small_photodiode_is_lens() -> None:
    """(2/π)(acos x - x√(1-x²)) = ½ at x = 0.403973."""
    speck = derive(Pixel(fill_factor=1e-4))  # 65 nm wide: 2e-4 at that frequency
    actual = mtf50_cy_per_mm(lit(ONE_LINE, 10.0, np.ones(1), SLOW), speck)
    cutoff_cy_per_mm = 1e6 / (550.0 * SLOW.effective_f_number)
    assert actual / cutoff_cy_per_mm == pytest.approx(0.403973, rel=1e-3)


def test_system_mtf_weighs_wavelengths_by_electrons() -> None:
    """Equal power and QE: photons, so electrons, are as λ."""
    nm = np.array([450.0, 650.0])
    result, speck = (
        lit(nm, 10.0, np.ones(2), SLOW),
        derive(Pixel(fill_factor=1e-8, quantum_efficiency=0.3)),
    )
    frequency = np.linspace(0, 400, 9)
    item = [diffraction_otf(frequency, one, SLOW.effective_f_number) for one in nm]
    np.testing.assert_allclose(
        system_mtf(result, speck, frequency), (450 * item[0] + 650 * item[1]) / 1100, atol=1e-7
    )


def test_white_of_the_chart_is_display_white_at_any_luminance() -> None:
    display = load_study("chen2000").display.model_copy(update={"dots": 64})
    ideals = []
    for luminance_cd_per_m2 in (100.0, 1000.0):
        scene = pixsim.load_scene("csf", resolution=64, luminance_cd_per_m2=luminance_cd_per_m2)
        ideals.append(
            pixsim.evaluate(
                pixsim.render(scene, Camera()), Camera(), Pixel(pitch_um=42.4), display=display
            ).ideal
        )
    assert ideals[0] == pytest.approx(
        ideals[1], abs=0.02
    )  # two codes of 8 bits at white; a fixed white gives a tenth of it


LINE_555_NM = np.where(np.arange(65) == 31, 1.0, 0.0)


def chen2000(spectrum: Array | None = None) -> tuple[Known, Pixel]:
    """The paper's study in daylight, or in light of a spectrum from 400 to 720 nm, (65,), and its
    pixel of 6.5 µm.
    """
    study, nm = load_study("chen2000"), np.arange(400.0, 721.0, 5.0)
    factors = (d65(nm) if spectrum is None else spectrum)[None], np.ones((1, 4, 4))
    light = SpectralImage(nm, 5.0, 1e3 * DIE_MM / 4, factors=factors)
    return Known(study, (), Light(light, Camera())), pixel_of(study, "0.35um", 6.5)


def test_study_mtf_terms_at_33_lp_per_mm() -> None:
    """By hand: f/4 at 555 nm; sinc of a side of √0.3106 · 6.5 µm; sinc² of 6.5 µm; sinc of a dot of
    5.3 µm.
    """
    result, pixel = chen2000(LINE_555_NM)
    at = np.array(33.0)
    terms = study_mtf_terms(result, derive(pixel), at)
    expected = {"lens": 0.906, "photodiode": 0.977, "interpolation": 0.858, "dot": 0.950}
    assert {name: round(float(item), 3) for name, item in terms.items()} == expected
    # Products of numbers of three digits.
    assert float(system_mtf(result, derive(pixel), at)) == pytest.approx(0.906 * 0.977, abs=1e-3)
    assert float(scene_to_display_mtf(result, derive(pixel), at)) == pytest.approx(
        0.906 * 0.977 * 0.858 * 0.950, abs=2e-3
    )
    # Silicon sees the red of daylight, which is diffracted more; about 0.25 % of contrast for 10
    # nm.
    assert 0.895 < float(study_mtf_terms(chen2000()[0], derive(pixel), at)["lens"]) < 0.905


STACK = {"height_um": 8.0, "index": 1.5, "shift": "optimal"}


def test_mtf_terms_of_a_stack() -> None:
    """Under a microlens the pitch's sinc and the transform of the crosstalk; a bare pixel's opening
    where it meets the photodiode.

    At Nyquist, crosstalk c of four neighbours leaves 1 - c along an axis: c/4 each, of which two
    are up and down.
    """
    result, pixel = chen2000(LINE_555_NM)
    nyquist = np.array([0.0, 1e3 / 13.0])
    plain = study_mtf_terms(result, derive(pixel), nyquist)

    def terms(**stack: object) -> dict[str, Array]:
        return study_mtf_terms(
            result,
            derive(pixel.model_copy(update={"stack": StackOptions(**STACK | stack)})),
            nyquist,
        )

    lens, shared = terms(microlens="square"), terms(microlens="square", crosstalk=0.2)
    assert list(lens) == ["lens", "microlens", "crosstalk", "interpolation", "dot"]
    np.testing.assert_allclose(lens["microlens"], [1, 2 / np.pi], atol=1e-12)
    np.testing.assert_array_equal(lens["lens"], plain["lens"])
    assert 0.9 < lens["crosstalk"][1] < 1
    assert lens["crosstalk"][0] == pytest.approx(1, abs=1e-15)
    assert shared["crosstalk"][1] / lens["crosstalk"][1] == pytest.approx(
        1 - 0.2, abs=0.01
    )  # (1 - c) + c/4 (2 cos π + 2)
    bare = terms()
    assert list(bare)[:3] == ["lens", "opening", "crosstalk"]
    low = terms(height_um=1e-3)
    np.testing.assert_allclose(low["opening"], plain["photodiode"], atol=1e-5)  # h NA/n w = 2e-5
    assert bare["opening"][1] > low["opening"][1] + 0.005  # what meets is narrower
    diffused = terms(depletion_um=1.0, diffusion_length_um=10.0)["diffusion"]
    np.testing.assert_allclose(
        diffused, diffusion_mtf(nyquist, absorption_per_um(555.0), 1.0, 10.0), rtol=1e-12
    )
    stacked = derive(
        pixel.model_copy(update={"stack": StackOptions(**STACK, microlens="square", crosstalk=0.2)})
    )
    product = math.prod(float(shared[name][1]) for name in ("lens", "microlens", "crosstalk"))
    assert float(system_mtf(result, stacked, nyquist)[1]) == pytest.approx(product, rel=1e-12)
    asked = imaging(result.camera, stacked.pixel, display=result.study.display)
    _, _, sensor_terms, _ = detail_terms(asked, result.irradiance)
    assert list(sensor_terms) == ["lens", "microlens", "crosstalk"]


def test_terms_of_detail_are_those_of_a_frequency_of_the_picture() -> None:
    result, pixel = chen2000()
    light, camera, display = result.irradiance, result.camera, result.study.display
    asked = imaging(camera, pixel, display=display)
    half_nyquist = 1e3 / (4 * 6.5)
    frequency, name, sensor_terms, display_terms = detail_terms(asked, light)
    assert (frequency, name) == (half_nyquist, "half the Nyquist frequency of 6.5 µm pixels")
    assert sensor_terms | display_terms == mtf_terms(asked, light, np.array(half_nyquist))
    assert list(display_terms) == ["interpolation", "dot"]
    light.header.update({"scene": "csf.xml"})
    frequency, name, *_ = detail_terms(asked, light)
    assert (round(frequency, 1), name) == (33.3, "the highest frequency of the chart")
    *_, of_pixels = detail_terms(
        asked.changed(display=display.model_copy(update={"raster": "one_to_one"})), light
    )
    assert of_pixels == {}


def test_mtf_terms_name_the_real_lens() -> None:
    """With the MTF of its aberrations, in place of diffraction."""
    result, pixel = chen2000()
    camera = camera_with_lens(
        Camera(object_distance_m=5.0),
        CameraOptions(),
        LensOptions(file="singlet", focal_length_mm=12.0),
    )
    light, display = result.irradiance, result.study.display
    light.header.update({LENS_HEADER: asdict(Tiling(300.0, 80.0, 0.0))})
    asked = imaging(camera, pixel, display=display)
    terms = mtf_terms(asked, light, np.array(30.0))
    thin = mtf_terms(asked.changed(camera=without_lens(camera)), light, np.array(30.0))
    assert list(terms) == ["real lens", *list(thin)[1:]]
    assert 0.01 < float(terms["real lens"]) < 0.7 * float(thin["lens"])


def test_mtf_terms_dark_picture_uses_equal_light() -> None:
    (dark, pixel), (even, _) = (chen2000(np.full(65, level)) for level in (0.0, 1.0))
    actual = [study_mtf_terms(result, derive(pixel), np.array(33.0)) for result in (dark, even)]
    assert actual[0] == actual[1]


# --- maps
# -------------------------------------------------------------------------------------------------------------


def test_frequency_contrast_table_bin_centres() -> None:
    """The mean of log frequency (contrast) over a bin is the log of its middle, as bins are of
    equal ratio.
    """
    over_frequency = np.repeat(LOG_FREQUENCY, ROWS, axis=0)
    np.testing.assert_allclose(
        np.exp(by_frequency(over_frequency)[0]),
        csf_frequency_lp_per_mm(frequency_places()),
        rtol=1e-9,
    )
    places, contrast, table = frequency_contrast_table(over_frequency)
    frequency = csf_frequency_lp_per_mm(places)
    np.testing.assert_allclose(np.exp(table), np.tile(frequency, (8, 1)), rtol=1e-9)
    over_contrast = np.repeat(np.log(CONTRAST), COLUMNS, axis=1)
    np.testing.assert_allclose(
        np.exp(frequency_contrast_table(over_contrast)[2]), np.tile(contrast[:, None], 6), rtol=1e-9
    )
    # 1 to 33.3 lp/mm in six, 0.951 downwards in eight equal ratios.
    assert frequency[[0, -1]] == pytest.approx([(100 / 3) ** (1 / 12), (100 / 3) ** (11 / 12)])
    assert contrast[[0, -1]] == pytest.approx(
        [975 / 1025 * 0.01 ** (15 / 16), 975 / 1025 * 0.01 ** (1 / 16)]
    )


def map_of(thresholds: list[float]) -> Array:
    """ΔE in proportion to contrast, that reaches ISO at a given contrast in each frequency bin."""
    return ISO * CONTRAST / np.repeat(thresholds, COLUMNS // 6)[None, :]


def test_threshold_contrast_to_one_row() -> None:
    expected = np.array([0.03, 0.1, 0.3, 0.5, 0.7, 0.9])
    actual = threshold_contrast(map_of(expected.tolist()), ISO)
    # The first row above the level, so up to one row late; smoothing an exponential over 4 rows
    # raises it by 0.3 %, and near the last row, where nothing is left to smooth with, lowers it by
    # up to a row.
    assert (actual >= 0.995 * expected).all()
    assert (actual[:-1] <= ROW_RATIO * expected[:-1]).all()
    assert actual[-1] <= ROW_RATIO**2 * expected[-1]
    assert np.isinf(threshold_contrast(map_of([0.5, 2.0] * 3), ISO)).tolist() == [False, True] * 3


def test_threshold_contrast_takes_first_crossing() -> None:
    bump = np.exp(-((np.log(CONTRAST / 0.1) / 0.5) ** 2))  # passes ½ at 0.1 e^±0.416
    actual = threshold_contrast(np.repeat(bump, COLUMNS, axis=1), 0.5)
    # A Gaussian of σ² = ½ 0.5² in log contrast smoothed by 4 rows is wider and lower: it passes ½
    # 0.5 % nearer.
    assert actual == pytest.approx(
        np.full(6, 0.1 * np.exp(-0.5 * np.sqrt(np.log(2)))), rel=ROW_RATIO - 1 + 0.005
    )


def test_prominent_maxima_as_of_scipy() -> None:
    """Of smooth and rough curves, with zeros around them, as a density has, and without."""
    rng = np.random.default_rng(5)
    found = set()
    for smoothing, padding, prominence in product((0.5, 2.0, 8.0), (0, 20), (0.02, 0.1, 0.5)):
        values = np.pad(gaussian_filter1d(rng.random(300), smoothing), padding)
        expected = len(find_peaks(values, prominence=prominence * values.max())[0])
        assert prominent_maxima(values, prominence * values.max()) == expected
        found.add(expected)
    assert len(found) > 6
    assert prominent_maxima(np.array([0.0, 1.0, 1.0, 0.9, 1.0, 0.0]), 0.5) == 1, (
        "a plateau, and a shallow valley"
    )


def test_modes_of_known_distributions() -> None:
    rng = np.random.default_rng(1)
    one = rng.normal(1.0, 0.3, (256, 256))
    assert modes(one) == 1
    assert modes(rng.gamma(2.0, 0.4, (256, 256))) == 1, "a long tail"
    assert modes(rng.exponential(0.5, (256, 256))) == 1, "the mode may be at zero"
    apart = np.where(rng.random((256, 256)) < 0.3, 1.0, 0.0)
    assert modes(one + 1.5 * apart) == 2, "5 σ apart"
    assert modes(one + 0.3 * apart) == 1, "1 σ apart: the sum of the two has one maximum"


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
    fill_factor = np.clip(fill_factor_law(pitch_um, load_technology(technology)), 0, 1)
    best_fit = fit_curve(pitch_um, delta_e)
    return Curve(
        technology,
        FEATURE_UM[technology],
        pitch_um,
        fill_factor,
        {"mean_delta_e": delta_e},
        best_fit,
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
    given = {pitch: [item + comb, item - comb] for pitch, item in maps.items()}
    curves = {name: curve_of(name, optima_um[name], best[name]) for name in optima_um}
    return Evidence(lit(ONE_LINE, 10.0, np.ones(1), given=given), curves)


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


def moved(given: Evidence, technology: str, **best: object) -> Evidence:
    """With another optimum of one technology."""
    curve = given.curves[technology]
    other = replace(curve, fit=replace(curve.fit, optimum=replace(curve.optimum, **best)))
    return Evidence(given.result, given.curves | {technology: other})


def table(given: Evidence) -> dict[str, Finding]:
    return {row.statement: row for row in findings(given)}


def test_findings_good_evidence_agrees() -> None:
    rows = findings(evidence())
    assert sorted(row.statement for row in rows) == sorted(STATEMENTS)
    # 5 to 73 % of 5.3 to 15 µm are areas as pitch^4.6, not the pitch^1 that √pitch would take.
    assert {row.statement for row in rows if not row.agrees} == GROWTH
    assert all(row.given and row.found for row in rows)
    assert all(asdict(row).keys() == {"statement", "given", "found", "agrees"} for row in rows)


RATIO_FALLS = {
    "0.5um": 13.0,
    "0.35um": 6.5,
    "0.25um": 4.4,
    "0.18um": 3.0,
}  # 26, 18.6, 17.6 and 16.7 features
GROWS = {"0.5um": 6.0, "0.35um": 6.5, "0.25um": 7.0, "0.18um": 7.5}
TOO_LARGE = {"0.5um": 10.0, "0.35um": 9.0, "0.25um": 6.6, "0.18um": 4.8}  # 25.7 and 26.7 features
FLIPS = {
    "optimum at 9 µm": ({"optima_um": TOO_LARGE}, {OPTIMUM, ITS_FILL_FACTOR}),
    "optima grow": ({"optima_um": GROWS}, {SHRINKS}),
    "faster than technology": ({"optima_um": RATIO_FALLS}, {SLOWER}),
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


@pytest.mark.parametrize("flip", FLIPS)
def test_findings_contrary_evidence_flips_one_row(flip: str) -> None:
    change, against = FLIPS[flip]
    rows = table(evidence(**change))
    assert rows.keys() == STATEMENTS, "a row that does not agree stays in"
    assert {name for name, row in rows.items() if not row.agrees} == GROWTH | against


def test_findings_numbers_are_the_evidence() -> None:
    rows = table(evidence())
    assert rows[OPTIMUM].found.startswith("6.50 µm (95 %: 6.45 to 6.55 µm)")
    assert rows[ITS_FILL_FACTOR].found == "31 %"  # the law's 31.0 %
    assert rows[SHRINKS].found == "8.60, 6.50, 5.00, 3.90 at 0.5, 0.35, 0.25, 0.18 µm"
    assert rows[SLOWER].found == "17.2, 18.6, 20.0, 21.7 at 0.5, 0.35, 0.25, 0.18 µm"
    # The middles of the six bins are (100/3)^(1/12) to (100/3)^(11/12) lp/mm; the thresholds above
    # cross between 3 and 4.
    assert rows[CROSS].found == "6 µm better at 1.3, 2.4, 4.3 lp/mm, 5.3 µm at 7.7, 14, 25 lp/mm"
    assert rows[SIX].found == "better at 2.4, 4.3, 7.7, 14, 25 lp/mm, worse at no frequency"
    for um, agrees in (
        (6.05, False),
        (6.15, True),
        (6.85, True),
        (6.95, False),
    ):  # about 6.5 µm is within 0.4 µm
        assert table(moved(evidence(), "0.35um", pitch_um=um))[OPTIMUM].agrees is agrees


def test_findings_single_step_back_is_no_trend() -> None:
    """17.2, 18.6, 17.2, 21.7 features and 0.45, 0.5, 0.48, 0.6: both rise on the whole, and fall at
    one step.
    """
    rows = table(evidence(OPTIMA_UM | {"0.25um": 4.3}, BEST | {"0.25um": 0.48}))
    for statement in (SLOWER, WORSE):
        assert not rows[statement].agrees
    assert rows[SHRINKS].agrees


def test_findings_minimum_at_end_is_no_trend() -> None:
    given = evidence()
    for technology in given.curves:
        rows = table(moved(given, technology, inside=False))
        assert rows[OPTIMUM].agrees == (technology != "0.35um")
        for statement in (SHRINKS, SLOWER, WORSE):
            assert not rows[statement].agrees


# Intervals ±0.3 and ±0.4 at the ends: the whole rise has to exceed 0.5.
A, B, C = (0.7, 1.3), (1.0, 1.2), (1.2, 2.0)


@pytest.mark.parametrize(
    ("values", "intervals", "agrees"),
    [
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
    ],
)
def test_rise_verdicts(
    values: tuple[float, ...], intervals: tuple[Interval, ...], agrees: bool
) -> None:
    assert rise(values, intervals) is agrees


def test_findings_trend_uses_right_interval_ends() -> None:
    """Optima that shrink: the largest process's may be as small as its interval allows, the
    smallest's as large.
    """
    given = evidence()

    for technology, interval_um, agrees in (
        ("0.5um", (8.0, None), True),  # 8.6 to 3.9 µm
        ("0.5um", (None, 9.0), False),
        ("0.5um", (3.8, 9.0), False),  # 4.8 µm of uncertainty, 4.7 µm of trend
        ("0.18um", (None, 4.0), True),
        ("0.18um", (3.8, None), False),
    ):
        assert table(moved(given, technology, interval_um=interval_um))[SHRINKS].agrees is agrees


def test_findings_follow_study_process() -> None:
    """Half of the fill factor, another law, another dark current: the rows are those of the
    study.
    """
    given = evidence()

    def rows(**study: object) -> dict[str, Finding]:
        own = Study.model_validate({"name": "known", "iso_delta_e": ISO} | study)
        return table(Evidence(replace(given.result, study=own), given.curves))

    name = "Fill factor at 15 µm"
    half = rows(process={"0.35um": {"fill_factor_limit": 0.413}})
    assert (half[name].found, half[name].agrees) == ("36.5 %", False)  # 72.9 / 2
    other = rows(pixel={"fill_factor_law": "inset_unlimited"})["Fill factor at 6.5 µm"]
    assert not other.agrees
    # ((p - s)² - (p0 - s)²)/p² with s = 4.9 F and p0 = 14.54 F, as printed to 0.1 %.
    assert float(other.found.removesuffix("%")) == pytest.approx(
        100 * (4.785**2 - 3.374**2) / 42.25, abs=0.05
    )
    dark = Study(name="known", process={"0.35um": {"dark_current_na_per_cm2": 30.0}})
    packaged, hot = (
        dr_and_snr_db(np.array([6.5]), "paper", reference_process(item))
        for item in (Study(name="known"), dark)
    )
    physics = derive(Pixel(capacitance="paper"))
    dark_e = physics.dark_current_e_per_s * FIGURE_2_INTEGRATION_S
    # Equation (1) of the paper with thirty times the dark charge.
    by_hand = (physics.full_well_e - 30 * dark_e) / np.sqrt(physics.reset_noise_e**2 + 30 * dark_e)
    assert hot[0] == pytest.approx(20 * np.log10(by_hand), abs=1e-9)
    assert hot[0] < packaged[0] - 1


def test_findings_omit_rows_without_data() -> None:
    """One technology says nothing about scaling; without 0.35 µm there is no optimum to compare."""
    assert table(evidence({"0.35um": 6.5})).keys() == STATEMENTS - {SHRINKS, SLOWER, WORSE}
    others = table(evidence({"0.25um": 5.0, "0.18um": 3.9})).keys()
    assert not {OPTIMUM, ITS_FILL_FACTOR, EIGHT, SIX, CROSS, UNIMODAL, MAX_VALUE} & others
    assert {SHRINKS, SLOWER, WORSE} <= others


def test_evidence_maps_are_mean_of_eight_sensors() -> None:
    maps = [np.full((ROWS, COLUMNS), float(n)) for n in range(10)]
    result = lit(ONE_LINE, 10.0, np.ones(1), given=dict.fromkeys(THRESHOLDS, maps))
    assert all((item == 3.5).all() for item in Evidence(result, {}).maps.values())
    assert FIGURE_2_INTEGRATION_S == 0.030  # stated in the paper's Figure 2
