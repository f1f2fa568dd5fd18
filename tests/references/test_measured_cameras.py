"""Cameras that others measured: a phone's in an integrating sphere and behind its lens, an
industrial CCD's, and a small camera's.

Sources and gates, two-sided:

- Phone, Sony IMX363: Lyu, Goossens, Wandell and Farrell (2022), "Accurate smartphone camera
  simulation using 3D scenes". The
  packaged sensor `imx363` has the paper's numbers. In 15 frames of an integrating sphere a crop of
  10 × 10 pixels of one channel,
  320.7 DN above black, has a variance of 57.8 ± 2 DN² over frames and pixels. A crop's variance is
  sampled: T temporal and P fixed
  DN² give [2 T² n(F-1) + 2 (T + F P)² (n-1)]/(nF-1)², 2.2² DN⁴. 400 simulated crops have the closed
  form within 4.5 standard
  errors of their mean (false alarms: 7e-6, with another seed), 0.8 %. The measured one lies within
  2 of one crop's (5 %, of which
  the measurement is the only draw: it has no other seed).
- Standard deviations of even patches lie in the bands of the paper's figure, black level of 64
  included.
- A lens given by the OpticStudio table of the paper has its five numbers in the rendered light,
  within 0.03 % of the axis, the
  error of taking light between film cells of 35 µm. The measured fall-off is deeper:
  docs/measured_cameras.md states by how much.
- Industrial CCD, 12 bits: reference set 001 of the EMVA 1288 group (tests/data/cameras). A pixel
  with the published results, K, η,
  σ_d, PRNU, DSNU and dark current, has the measured temporal variance at each measured mean within
  5 %: the camera's own slope
  falls from 4 % above K, a fit from 0 to 70 % of saturation, to 2 % below it. A pair of frames of
  400 × 400 pixels has 0.4 % of
  sampling error. Its mean is that of the measurement within 1.6 %, the camera's nonlinearity, and
  the variance peaks within one
  exposure.
- Raspberry Pi HQ camera, Sony IMX477: the gain and noise of J. Hogan (2020), packaged as `imx477`,
  against the noise profile that
  Raspberry Pi measured on patches of other units, libcamera's src/ipa/rpi/vc4/data/imx477.json
  (BSD-2-Clause, commit
  10e4e5ba1e230d44d2b88cd4fe20572738b484bd): σ = 2.767 √mean in 16-bit codes. Within 5 % from 50 to
  2400 DN of 12 bits: 1 % for a
  gain of two digits, and up to 3.5 % since a profile through zero has no read noise, but a steeper
  slope.

The gates fail for a sensor without PRNU, with the gain of another, and for a table that is read
against the square of its heights.
"""

from __future__ import annotations

import csv
import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import scipy.interpolate
from references.gates import not_met, row

import pixsim
from pixsim.base.arrays import Array, stream
from pixsim.measure.estimators import pair
from pixsim.measure.experiment import make_experiment
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.viewer.settings_file import run_settings

DATA = Path(__file__).parents[1] / "data/cameras"
LYU, EMVA, HOGAN = "Lyu et al. (2022)", "EMVA 1288, reference set 001", "Hogan (2020), libcamera"

# --- A phone ---

MEAN_DN, MEASURED_DN2, FRAMES, CROP, CROPS = 320.7, 57.8, 15, 10, 20
PARTS_DN2 = {
    "shot": 54.7,
    "PRNU": 3.0,
    "read": 0.25,
    "quantisation": 0.08,
}  # of the paper's numbers, to their digits
BANDS = {
    90: (1.7, 2.7),
    200: (4.5, 6.0),
    400: (7.0, 9.0),
    650: (9.0, 12.5),
}  # standard deviation at a mean, both in DN
OPTIC_STUDIO = {0.7056: 0.93386, 1.4112: 0.79160, 2.1168: 0.62330, 2.8224: 0.47913, 3.528: 0.35863}
ERRORS = 4.5  # standard errors, 7e-6 false alarms


def phone() -> Pixel:
    """The packaged sensor."""
    return run_settings("imx363", {}).pixel


def frames_of_sphere(pixel: Pixel, mean_dn: float, frames: int, side: int, seed: int = 0) -> Array:
    """Frames of one green channel in even light, (frames, side, side) DN above black: lens, filters
    and ADC as in `capture`.

    side : of the channel's pixels, of which the mosaic has every second one
    """
    camera = Camera(focal_length_mm=4.38, f_number=1.73, die_mm=2e-3 * side * pixel.pitch_um)
    light = pixsim.SpectralImage(
        [530.0], 10.0, 2 * pixel.pitch_um, data=np.full((side, side, 1), 1e-3)
    )
    sensor = pixsim.make_sensor(pixel, camera, seed=seed)
    green = np.s_[0::2, 1::2]
    found = pixsim.capture(
        light, camera, sensor, pixsim.Exposure(integration_s=1e-3), rng=stream("sphere")
    )
    rate = found.mean_e[green] / found.integration_s
    assert np.ptp(rate) < 1e-6 * rate.mean(), "the light is even"
    exposure = pixsim.Exposure(
        integration_s=mean_dn / Readout.of(pixsim.derive(pixel)).dn_per_e / float(rate.mean())
    )
    taken = (
        pixsim.capture(light, camera, sensor, exposure, rng=stream("sphere", seed, index)).dn
        for index in range(frames)
    )
    return np.stack([dn[green] for dn in taken]) - pixel.black_level_dn


def parts_dn2(pixel: Pixel, mean_dn: float) -> dict[str, float]:
    """Variance of even light over frames and pixels, by cause."""
    gain_dn_per_e, percent, dark_e = pixel.dn_per_e, pixel.prnu_percent, pixel.temporal_dark_noise_e
    assert gain_dn_per_e is not None
    assert percent is not None
    assert dark_e is not None
    read_dn, pattern_dn = gain_dn_per_e * dark_e, percent / 100 * mean_dn
    return {
        "shot": gain_dn_per_e * mean_dn,
        "PRNU": pattern_dn**2,
        "read": read_dn**2,
        "quantisation": 1 / 12,
    }


def error_of_crop_dn2(parts: dict[str, float], pixels: int = CROP**2) -> float:
    """Standard error of the variance of one crop, over its frames and pixels."""
    fixed = parts["PRNU"]
    temporal = sum(parts.values()) - fixed
    between = 2 * (temporal + FRAMES * fixed) ** 2 * (pixels - 1)
    return math.sqrt(2 * temporal**2 * pixels * (FRAMES - 1) + between) / (pixels * FRAMES - 1)


@lru_cache(maxsize=4)
def crop_variances_dn2(pixel_json: str) -> Array:
    """Variance of each of 20 × 20 crops over frames and pixels."""
    dn = frames_of_sphere(Pixel.model_validate_json(pixel_json), MEAN_DN, FRAMES, CROP * CROPS)
    crops = dn.reshape(FRAMES, CROPS, CROP, CROPS, CROP)
    return np.asarray(crops.var(axis=(0, 2, 4), ddof=1))


def sphere_rows(pixel: Pixel) -> list[dict[str, object]]:
    parts = parts_dn2(pixel, MEAN_DN)
    found, error = crop_variances_dn2(pixel.model_dump_json()), error_of_crop_dn2(parts)
    limit = ERRORS * error / CROPS / sum(parts.values())
    return [
        row(
            f"phone in an integrating sphere, variance of {found.size} crops / closed form of {sum(parts.values()):.2f} DN² - 1",
            LYU, -round(limit, 4), round(limit, 4), found.mean() / sum(parts.values()) - 1, "{:.4f}",
        ),
        row(
            f"… measured {MEASURED_DN2} DN² - simulated, in standard errors of a crop of 10 × 10, {error:.1f} DN²",
            LYU, -2, 2, (MEASURED_DN2 - found.mean()) / error, "{:.2f}",
        ),
    ]  # fmt: skip


def band_rows(pixel: Pixel) -> list[dict[str, object]]:
    table = []
    for level_dn, (low, high) in BANDS.items():
        dn = frames_of_sphere(pixel, level_dn - pixel.black_level_dn, 2, 100)
        name = f"… standard deviation of an even patch at {level_dn} DN, black included, DN"
        table.append(row(name, LYU, low, high, dn.std(), "{:.2f}"))
    return table


def phone_camera() -> Camera:
    """The paper's lens and die, with its table of relative illumination."""
    settings = run_settings("imx363", {})
    camera, lens = settings.camera, settings.lens
    assert camera.die_mm is not None
    return Camera(
        focal_length_mm=camera.focal_length_mm, f_number=camera.f_number, die_mm=camera.die_mm,
        die_height_mm=camera.die_height_mm, fall_off=lens.relative_illumination,
    )  # fmt: skip


def illumination(camera: Camera) -> Array:
    """Rendered light of an even scene at the heights of the table, along the diagonal of the die,
    over that on the axis.
    """
    light = pixsim.render(pixsim.load_scene("flat", resolution=160, spp=4), camera, seed=0)
    lux = light.illuminance_lx()
    y, x = ((np.arange(count) + 0.5 - count / 2) * 1e-3 * light.pitch_um for count in lux.shape)
    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    shares = np.linspace(
        0.0, 2 * y[-1] / camera.height_mm, 200
    )  # of the diagonal, up to the last row; beyond it, half a cell
    points = np.stack([shares * camera.height_mm / 2, shares * camera.die_mm / 2], axis=-1)
    on_diagonal = scipy.interpolate.RegularGridInterpolator((y, x), lux)(points)
    spline = scipy.interpolate.CubicSpline(shares * corner_mm, on_diagonal)
    return np.asarray(spline(list(OPTIC_STUDIO)) / spline(0.0))


def fall_off_rows(camera: Camera) -> list[dict[str, object]]:
    found = illumination(camera) - np.array([*OPTIC_STUDIO.values()])
    return [
        row(
            "phone's lens, relative illumination at 0.71 to 3.53 mm - OpticStudio",
            LYU,
            -0.0003,
            0.0003,
            found,
        )
    ]


# --- An industrial CCD ---

CCD_RESULTS = {
    "K": 0.280769280926,
    "QE": 0.451356082834,
    "sigma_d": 10.8980275235,
    "PRNU": 0.432704411062,
    "DSNU": 0.551787767644,
}
DARK_E_PER_S, SATURATED_AT, CCD_PIXELS, CCD_SIDE = 28.4074312749, 36, 640 * 480, 400
VARIANCE_GATE, MEAN_GATE, FROM_SHARE = (
    0.05,
    0.016,
    0.02,
)  # of the mean at saturation: below, the light is not known well


def ccd() -> Pixel:
    """A pixel with the published results; the pitch is any, since the light is known by pixel."""
    _, light = ccd_measured()
    return Pixel(
        pitch_um=7.4, full_well_e=20_000.0, dn_per_e=CCD_RESULTS["K"], bits=12, black_level_dn=float(light["dark_dn"].mean()),
        temporal_dark_noise_e=CCD_RESULTS["sigma_d"], quantum_efficiency=CCD_RESULTS["QE"], prnu_percent=CCD_RESULTS["PRNU"],
        dsnu_e=CCD_RESULTS["DSNU"], dark_current_e_per_s=DARK_E_PER_S,
    )  # fmt: skip


@lru_cache(maxsize=1)
def ccd_measured() -> tuple[Array, dict[str, Array]]:
    """Photons of each exposure, and the means and temporal variances in light and in the dark, DN
    and DN².
    """
    with (DATA / "emva_ccd_12bit.csv").open(encoding="utf-8", newline="") as file:
        table = [
            {name: int(value) for name, value in line.items()} for line in csv.DictReader(file)
        ]

    def column(name: str, per_pixel: int) -> Array:
        return np.array([line[name] for line in table]) / (per_pixel * CCD_PIXELS)

    measured = {"mean_dn": column("bright_sum", 2), "dark_dn": column("dark_sum", 2)}
    measured |= {"variance_dn2": column("bright_pvar", 4), "dark_dn2": column("dark_pvar", 4)}
    return np.array([line["photons"] for line in table], float), measured


def ccd_simulated(pixel: Pixel, photons: Array) -> tuple[Array, Array]:
    """Mean above black and temporal variance of a pair of simulated frames in each light, DN and
    DN².
    """
    experiment = make_experiment(pixel, wavelength_nm=550.0, shape=(CCD_SIDE, CCD_SIDE))
    pairs = [
        pair(*experiment.frames(2, count, "ccd", index))
        for index, count in enumerate(photons.tolist())
    ]
    black_dn = experiment.readout.adc.black_level_dn  # 6 σ of the dark at least
    return np.array([each.mean_dn - black_dn for each in pairs]), np.array(
        [each.variance_dn2 for each in pairs]
    )


def ccd_rows(pixel: Pixel, exposures: slice = slice(None)) -> list[dict[str, object]]:
    photons, measured = ccd_measured()
    signal_dn = measured["mean_dn"] - measured["dark_dn"]
    inner = np.arange(photons.size) < SATURATED_AT
    inner &= signal_dn > FROM_SHARE * signal_dn[SATURATED_AT]
    photons, inner, signal_dn = photons[exposures], inner[exposures], signal_dn[exposures]
    measured = {name: values[exposures] for name, values in measured.items()}
    # The photons that give the measured mean, so that variances are compared at equal means.
    of_mean = signal_dn[inner] / CCD_RESULTS["K"] / CCD_RESULTS["QE"]
    simulated_dn, variance_dn2 = ccd_simulated(pixel, photons)
    _, at_mean_dn2 = ccd_simulated(pixel, of_mean)
    dark_dn2 = float(measured["dark_dn2"].mean())
    simulated_dark = ccd_simulated(pixel, np.zeros(1))[1]
    off = (measured["variance_dn2"][inner] - dark_dn2) / (at_mean_dn2 - simulated_dark) - 1
    of_signal = signal_dn[inner] / simulated_dn[inner] - 1
    peaks = int(np.argmax(measured["variance_dn2"])) - int(np.argmax(variance_dn2))
    curve = f"CCD, measured / simulated variance at the same mean - 1, {int(inner.sum())} exposures"
    return [
        row(curve, EMVA, -VARIANCE_GATE, VARIANCE_GATE, off, "{:.3f}"),
        row("… measured / simulated signal - 1", EMVA, -MEAN_GATE, MEAN_GATE, of_signal, "{:.4f}"),
        row(
            "… measured / simulated variance in the dark - 1",
            EMVA,
            -0.02,
            0.02,
            dark_dn2 / simulated_dark - 1,
            "{:.4f}",
        ),
        row(
            "… peak of the variance, measured - simulated, exposures", EMVA, -1, 1, peaks, "{:.0f}"
        ),
    ]


# --- A Raspberry Pi camera ---

PROFILE, CODES_16_OF_12 = 2.767, 16.0  # σ/√mean in 16-bit codes
PROFILE_DN, PROFILE_GATE = (50.0, 200.0, 800.0, 2400.0), 0.05


def pi_camera() -> Pixel:
    return run_settings("imx477", {}).pixel


def profile_rows(pixel: Pixel) -> list[dict[str, object]]:
    offs = []
    for mean_dn in PROFILE_DN:
        dn = frames_of_sphere(pixel, mean_dn, 2, 200)
        offs.append(
            PROFILE * math.sqrt(mean_dn * CODES_16_OF_12) / CODES_16_OF_12 / float(dn.std()) - 1
        )
    name = "Pi HQ camera, measured noise profile / simulated σ - 1, 50 to 2400 DN"
    return [row(name, HOGAN, -PROFILE_GATE, PROFILE_GATE, offs, "{:.3f}")]


def rows() -> list[dict[str, object]]:
    of_phone = [*sphere_rows(phone()), *band_rows(phone()), *fall_off_rows(phone_camera())]
    return [*of_phone, *ccd_rows(ccd()), *profile_rows(pi_camera())]


@pytest.mark.parametrize("cause", PARTS_DN2)
def test_closed_form_has_the_parts_of_the_paper(cause: str) -> None:
    assert parts_dn2(phone(), MEAN_DN)[cause] == pytest.approx(
        PARTS_DN2[cause], abs=0.005 if PARTS_DN2[cause] < 1 else 0.05
    )


def test_integrating_sphere_has_the_measured_variance() -> None:
    assert not not_met(sphere_rows(phone()))


def test_spread_of_crops_is_the_stated_sampling_error() -> None:
    """4.5 standard errors of a standard deviation of 400 crops, 16 %."""
    found = crop_variances_dn2(phone().model_dump_json())
    assert found.std(ddof=1) == pytest.approx(
        error_of_crop_dn2(parts_dn2(phone(), MEAN_DN)), rel=ERRORS / math.sqrt(2 * found.size)
    )


def test_even_patches_lie_in_the_published_bands() -> None:
    assert not not_met(band_rows(phone()))


def test_lens_of_a_table_has_the_illumination_of_optic_studio() -> None:
    assert not not_met(fall_off_rows(phone_camera()))


def test_ccd_has_the_measured_transfer_curve() -> None:
    assert not not_met(ccd_rows(ccd()))


def test_table_of_the_ccd_is_that_of_the_published_results() -> None:
    """K and R of the standard's own fit, through the origin from 0 to 70 % of saturation, to the
    digits of the publication.
    """
    photons, measured = ccd_measured()
    fitted = photons <= 0.7 * photons[SATURATED_AT]
    signal = (measured["mean_dn"] - measured["dark_dn"])[fitted]
    variance = (measured["variance_dn2"] - measured["dark_dn2"])[fitted]
    assert signal @ variance / (signal @ signal) == pytest.approx(CCD_RESULTS["K"], rel=1e-10)
    assert signal @ photons[fitted] / (photons[fitted] @ photons[fitted]) == pytest.approx(
        0.126726922819, rel=1e-10
    )
    assert int(np.argmax(measured["variance_dn2"])) == SATURATED_AT


def test_pi_camera_has_the_noise_profile_that_others_measured() -> None:
    assert not not_met(profile_rows(pi_camera()))


# --- The gates fail ---


def test_another_pixel_fails() -> None:
    without = phone().model_copy(update={"prnu_percent": 0.0})
    found = crop_variances_dn2(without.model_dump_json()).mean()
    expected = sum(parts_dn2(phone(), MEAN_DN).values())
    assert abs(found - expected) > ERRORS * error_of_crop_dn2(parts_dn2(phone(), MEAN_DN)) / CROPS
    assert not_met(band_rows(phone().model_copy(update={"dn_per_e": 0.25})))
    few = slice(2, SATURATED_AT, 8)
    assert not not_met(ccd_rows(ccd(), few))
    assert not_met(ccd_rows(ccd().model_copy(update={"dn_per_e": 1.06 * CCD_RESULTS["K"]}), few))
    assert not_met(profile_rows(pi_camera().model_copy(update={"dn_per_e": 0.55})))
    heights = tuple(
        (height**2 / max(OPTIC_STUDIO), light) for height, light in OPTIC_STUDIO.items()
    )
    assert not_met(
        fall_off_rows(phone_camera().model_copy(update={"fall_off": ((0.0, 1.0), *heights)}))
    )
