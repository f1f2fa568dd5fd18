"""The table of extreme cases, whose answers are known apart from the kernels: a row each, by part
of the computation.

Columns: name, call, expected value, tolerance, its source and reason, inputs, scale, as
`KnownAnswer` describes them. A source names a closed form, a limit, a conservation law, or a
symmetry.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.random import default_rng
from numpy.typing import ArrayLike, NDArray
from scipy.stats import poisson

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage, Spectrum, photons_per_joule, photopic_efficiency
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffract, diffraction_otf
from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack, collected_shares, stack_collection
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.scene.bands import Bands, Detector, fit, place_bands
from pixsim.sensor import photodiode as diodes
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import electrons_per_joule, integrate_pixels, mean_signal_rate
from pixsim.sensor.photodiode import collected_charge_e, default_diode, diode_of
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, capture_from_rates, quantise, sample_sensor, shot_noise
from pixsim.verification.case import ANSWERS, ExtremeCase, KnownAnswer
from pixsim.viewer.display import average_axis, white_rate
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scielab import Filters, delta_e_map, filtered_grey_lab, filtered_lab, xyz_to_lab

Row = tuple[Any, ...]  # the fields of a KnownAnswer

_NO_ARGUMENTS = ((),)  # inputs of a call without arguments
SIGMAS = 5.0  # limit of random samples, in standard errors
_RANDOM_SAMPLES = "fixed seed; limit 5σ, a false-alarm rate of 6e-7 with other seeds"
_EPS = 2.2e-16  # of float64
ROUNDING = 1e-12  # of a few hundred operations in float64
_FLOAT32_ROUNDING = 2e-7  # the irradiance is stored in float32
# SI 2019, exact; independent of pixsim's constants
BOLTZMANN_J_PER_K = 1.380649e-23
ELECTRON_C = 1.602176634e-19

# --- lenses: f/0.5 to f/1e150, fields up to 80°, cut-off frequencies far outside the grid's range

# f-number, tangent of the field angle, magnification, E/L by Foote (1915) in 400 digits.
IRRADIANCES = (
    (0.5, 0.0, 0.0, 1.5707963267948966),
    (0.5, 5.7, -2.0, 0.00031320861733854355),
    (0.7, 0.4, -1e-9, 0.9204268521174798),
    (1.4, 1.0, -0.5, 0.04513645547976066),
    (22.0, 0.1, -0.01, 0.001558647160555365),
    (1000.0, 5.7, 0.0, 7.00260440246857e-10),
    (1000.0, 1e-8, -1.0, 1.963495285775165e-07),
    (1e150, 1.0, 0.0, 1.963495408493621e-301),
)
# Share of the cut-off, OTF: the overlap of two pupils.
OTFS = (
    (1e-16, 1.0),
    (0.25, 0.685037642474293),
    (0.5, 0.391002218955771),
    (0.999, 3.79549743734e-5),
    (1 - 1e-10, 1.2004e-15),
)
_FEW_ROUNDINGS = 4e-15  # at most 20 roundings of 1.1e-16 in a well-conditioned formula
# rounding of a cosine transform and its inverse, relative to the brightest sample
_TRANSFORM_ROUNDING = 1e-14


def blurred(picture: Array, f_number: float) -> Array:
    """Return a picture of 1 µm samples in three wavelengths behind a lens."""
    return diffract(
        picture, 1.0, np.array([360.0, 550.0, 830.0]), np.array([0.2, 0.5, 0.3]), f_number
    )


def _contrast_of_wave(order: int, share: float) -> float:
    """Return the contrast transfer of a grating at a share of the cut-off of a lens."""
    wave = np.cos(np.pi * order * (np.arange(32) + 0.5) / 32)
    f_number = share * 1e6 / (550.0 * order / 64e-3)
    return float(diffract(wave[None], 1.0, np.array([550.0]), np.ones(1), f_number)[0, 0] / wave[0])


def optics() -> list[Row]:
    pictures = [
        default_rng(shape).uniform(0, 2, shape) for shape in ((1, 1), (1, 33), (7, 1), (24, 40))
    ]
    return [
        (
            "E/L of a lens, f/0.5 to f/1e150, 0 to 80°, magnification 0 to -2",
            irradiance_factor,
            ANSWERS,
            _FEW_ROUNDINGS,
            "Foote's formula in 400 digits; rounding",
            IRRADIANCES,
        ),
        (
            "OTF at the cut-off and up to 1e200 times it, f/0.5 to f/1e100",
            lambda times, n: diffraction_otf(times * cutoff_cy_per_mm(550.0, n), 550.0, n),
            0.0,
            0.0,
            "exactly 0",
            product([1.0, 1 + 1e-15, 2.0, 1e200], [0.5, 4.0, 1000.0, 1e100]),
        ),
        (
            "OTF from 0 to just below the cut-off",
            lambda share: diffraction_otf(share, 1e6, 1.0),  # a cut-off of 1 cy/mm
            ANSWERS,
            _FEW_ROUNDINGS,
            "overlap of two pupils; rounding of terms near 1",
            OTFS,
            1.0,
        ),
        (
            "mean of pictures of 1×1 to 24×40 samples behind f/0.5 to a pinhole",
            lambda picture, n: blurred(picture, n).mean(),
            lambda picture, n: picture.mean(),
            _TRANSFORM_ROUNDING,
            "conservation of energy; rounding of the transform",
            product(pictures, [0.5, 4.0, 1e3, 1e6, 1e300, np.inf]),
        ),
        (
            "pictures with a cut-off far above the grid, 1e15 to 1e33 cy/mm",
            blurred,
            lambda picture, n: picture,
            2e-12,
            "unchanged: the OTF is 1 - 4f/(π cut-off), f up to 1e3 cy/mm",
            product(pictures, [1e-12, 1e-20, 1e-30]),
            2.0,
        ),
        (
            "contrast of a grating at the cut-off and at half of it",
            _contrast_of_wave,
            ANSWERS,
            1e-7,
            "0 and 2/3 - √3/2π; three times the error 3e-8 of interpolation in the OTF table",
            [
                (order, *answer)
                for order, answer in product(
                    range(1, 32, 3), [(1.0, 0.0), (0.5, 0.391002218955771)]
                )
            ],
            1.0,
        ),
    ]


# --- spectra: lines of 1 nm, dark bands, and light outside the sensor's response

# A line of 1 W m⁻², 1 nm wide: nm, W m⁻² within 360-830 nm, electrons of the 0.35 µm process per W
# m⁻² and m², and lux. Integer and fractional wavelengths, borders of bands, ends of the response
# (400 and 800 nm) and of the range.
LINES = (
    (360.0, 0.5, 0.0, 0.00139191),
    (365.5, 1.0, 0.0, 0.00504958),
    (400.0, 1.0, 1.57190e17, 0.270353),
    (400.3, 1.0, 2.37465e17, 0.278162),
    (447.31, 1.0, 5.10779e17, 22.8090),
    (555.03, 1.0, 1.00885e18, 682.958),
    (632.8, 1.0, 1.01835e18, 162.055),
    (799.7, 1.0, 2.20731e17, 0.00258494),
    (800.0, 1.0, 1.45903e17, 0.00253115),
    (829.3, 0.955, 0.0, 0.000310578),
)
BANDS_NM = np.arange(365.0, 826.0, 10.0)
_SURFACES = np.zeros((0, 471))  # none
_BANDS_TOLERANCE = 2.5e-4  # error of the bands in a render with default tolerance
_SUM_ROUNDING = 1e-13  # rounding of a running sum over up to 15 040 cells


def line(centre_nm: float) -> Spectrum:
    """Return a triangular line of 1 W m⁻² with full width 1 nm at half maximum."""
    return Spectrum(centre_nm + np.array([-1.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))


def image_of(lamp: Spectrum, bands: Bands) -> SpectralImage:
    """Return a uniform field of 8×8 samples with the lamp's spectrum, W m⁻² nm⁻¹."""
    factors = (lamp.cell_means(bands.edges_nm), np.ones((1, 8, 8)))
    within = (bands.nodes_nm, bands.shares)
    return SpectralImage(
        bands.wavelength_nm, bands.width_nm, 20.0, factors=factors, within=within, header={}
    )


def _uniform_images(spectrum: Array) -> list[SpectralImage]:
    """Return the same uniform field as a spectrum times a picture, and as full data."""
    factored = SpectralImage(BANDS_NM, 10.0, 20.0, factors=(spectrum, np.ones((1, 8, 6))))
    return [
        factored,
        SpectralImage(BANDS_NM, 10.0, 20.0, data=np.broadcast_to(spectrum, (8, 6, BANDS_NM.size))),
    ]


def _is_refused(spectrum: Array, physics: PixelPhysics) -> bool:
    try:
        imaging = Imaging(
            Camera(), physics.pixel, physics.technology, Exposure(), Display(white_cd_per_m2=1000.0)
        )
        white_rate(imaging, _uniform_images(spectrum)[0])
    except PixsimError:
        return True
    return False


def spectra() -> list[Row]:
    physics = derive(Pixel(pitch_um=10.0))
    infrared_cut = derive(Pixel(pitch_um=10.0, technology="4t-bsi", infrared_cut_nm=650.0))

    def electrons(nm: Array) -> Array:
        return physics.quantum_efficiency(nm) * photons_per_joule(nm)

    detectors = [Detector(electrons), Detector(photopic_efficiency)]
    nm, watts, electrons_e, lux = zip(*LINES, strict=True)
    lamps = [line(centre_nm) for centre_nm in nm]
    bands = [place_bands([lamp], _SURFACES, detectors, _BANDS_TOLERANCE) for lamp in lamps]
    images = [image_of(lamp, lamp_bands) for lamp, lamp_bands in zip(lamps, bands, strict=True)]

    def power_of_pulse(lamp: Spectrum, lamp_bands: Bands) -> float:
        pulses = fit(lamp, lamp_bands, _SURFACES, detectors, _BANDS_TOLERANCE)
        if pulses is None:
            return math.nan
        return float((pulses.spectra.sum(axis=0) * lamp_bands.width_nm).sum())

    lights = {  # with the electrons of a pixel per second
        "every second band dark": (physics, np.tile([0.02, 0.0], 24)[:47], 187258201.36563483),
        "light only below and above the response, 400-800 nm": (
            physics,
            np.where(abs(BANDS_NM - 600) > 200, 0.02, 0.0),
            0.0,
        ),
        "light only beyond the infrared cut": (
            infrared_cut,
            np.where(BANDS_NM > 655, 0.02, 0.0),
            0.0,
        ),
    }
    return [
        (
            "power of a 1 nm line in its bands, 360 to 830 nm",
            lambda image: (image.mean_spectrum() * image.band_width_nm).sum(),
            ANSWERS,
            _SUM_ROUNDING,
            "area of the triangle within 360-830 nm",
            zip(images, watts, strict=True),
        ),
        (
            "power of a 1 nm line in one pulse of the renderer, 360 to 830 nm",
            power_of_pulse,
            ANSWERS,
            _SUM_ROUNDING,
            "the same area",
            zip(lamps, bands, watts, strict=True),
        ),
        (
            "electrons from a 1 nm line, QE of the 0.35 µm process, 360 to 830 nm",
            lambda image: (electrons_per_joule(physics, image) * image.mean_spectrum()).sum(),
            ANSWERS,
            _BANDS_TOLERANCE,
            "∫ QE λ/hc E dλ, by quadrature; tolerance of the bands",
            zip(images, electrons_e, strict=True),
        ),
        (
            "illuminance of a 1 nm line, 360 to 830 nm",
            lambda image: image.illuminance_lx()[0, 0],
            ANSWERS,
            1e-3,
            "683.002 ∫ ȳ E dλ, by quadrature; tolerance of the bands",
            zip(images, lux, strict=True),
        ),
        *(
            (
                f"electrons of every pixel, {name}",
                mean_signal_rate,
                rate,
                1e-7,
                (
                    "sum over the lit bands; rounding of irradiance to float32, 6e-8; without light"
                    " exactly 0"
                ),
                product(_uniform_images(spectrum), [Camera()], [pixel]),
            )
            for name, (pixel, spectrum, rate) in lights.items()
        ),
        (
            "shares of light in the bands of a lamp that is off",
            lambda: place_bands(
                [line(555.0) * 0.0], _SURFACES, detectors, _BANDS_TOLERANCE
            ).shares.sum(axis=1),
            1.0,
            1e-15,
            "sum of 1",
        ),
        (
            "white outside the sensor's response, or without light",
            _is_refused,
            1.0,
            0.0,
            "raises PixsimError instead of dividing by 0",
            product([np.where(BANDS_NM < 400, 0.02, 0.0), np.zeros(47)], [physics]),
        ),
    ]


# --- light: from zero to far beyond saturation

# Parameters of a pixel with photon shot noise alone
_SHOT_NOISE_ONLY: dict[str, Any] = dict.fromkeys(
    (
        "dark_current_e_per_s",
        "read_noise_e",
        "reset_noise_factor",
        "prnu",
        "dsnu",
        "offset_fpn",
        "column_fpn",
    ),
    0,
)
_GREEN = _SHOT_NOISE_ONLY | {
    "quantum_efficiency": 0.5,
    "fill_factor": 0.5,
    "full_well_e": 65_535,
    "bits": 16,
    "pitch_um": 5.0,
}
CAMERA = Camera(die_mm=0.08)
# of a pixel of `_GREEN` for 1 cd/m²: L · π sin²α · A · λ/hc · QE / K(λ)
GREEN_E_PER_S = 1226.317856665
_LUMINANCES_CD_PER_M2 = 10.0 ** np.arange(-9, 13)
FRAME = (200, 500)  # pixels of a frame of random samples
COUNT = 100_000
BITS = range(1, 25)


def physics_of(options: dict[str, Any]) -> PixelPhysics:
    return derive(Pixel.model_validate(options))


def capture(
    rate: ArrayLike,
    options: dict[str, Any],
    shape: tuple[int, int] = FRAME,
    offset_e: float = 0.0,
    **exposure: Any,
) -> Frame:
    """Return a frame of a rate of photo-electrons per second.

    options : of a pixel
    exposure : by default of 1 s
    """
    sensor = sample_sensor(Readout.of(physics_of(options)), shape, default_rng(0))
    if offset_e:
        sensor = replace(sensor, offset_e=np.full(shape, offset_e))
    times = Exposure(**{"integration_s": 1.0} | exposure)
    return capture_from_rates(
        np.broadcast_to(np.asarray(rate, float), shape), sensor, times, default_rng(1)
    )


def _moment_errors(variance: ArrayLike, count: int, fourth_cumulant: ArrayLike = 0.0) -> Array:
    """Return the standard errors of the mean and of the variance of `count` draws, (2, ...)."""
    variance = np.asarray(variance, float)
    return np.sqrt(np.stack([variance, 2 * variance**2 + fourth_cumulant]) / count)


def moments(values: NDArray[Any], mean: float) -> Array:
    """Return the mean, and the mean square distance from a mean."""
    return np.array([values.mean(), np.mean((values - mean) ** 2)])


def _green_frame(
    luminance: ArrayLike,
    diffraction: bool = False,
    options: dict[str, Any] = _GREEN,
    **exposure: Any,
) -> Frame:
    """Return a frame of a picture in one band at 555 nm, behind `CAMERA` without fall-off; 16×16
    samples and pixels of 5 µm.
    """
    spectrum = [
        [1 / 683.002 / 10.0 * float(irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))]
    ]
    factors = spectrum, [np.broadcast_to(luminance, (16, 16))]
    image = SpectralImage([555.0], 10.0, 5.0, factors=factors, header={"diffraction": diffraction})
    rate = mean_signal_rate(image, CAMERA, physics_of(options))
    return capture(rate, options, rate.shape, **exposure)


def _bright_and_dark(diffraction: bool) -> Array:
    """Return the mean electrons of a picture whose halves have 1e12 and 1e2 cd/m²."""
    return _green_frame(
        np.repeat([1e12, 1e2], 8), diffraction, _GREEN | {"full_well_e": 1e15}
    ).mean_e


def light() -> list[Row]:
    small_well = _GREEN | {"full_well_e": 1000}  # filled by 1e-9 cd/m² in 25 years
    automatic: dict[str, Any] = {
        "options": small_well,
        "integration_s": None,
        "max_integration_s": 1e9,
        "well_target": 0.95,
    }
    return [
        (
            "electrons 1e-6 … 1e15, 200 000 pixels each: mean and variance",
            lambda seed, mean_e: moments(
                shot_noise(np.full(200_000, mean_e), default_rng(seed)), mean_e
            ),
            lambda seed, mean_e: mean_e,
            SIGMAS,
            # A mean of 1e-6 gives 0.2 electrons in all pixels together; three or more exceed the
            # limit.
            f"Poisson: both are the mean; {_RANDOM_SAMPLES}, 1e-3 at a mean of 1e-6",
            enumerate([1e-6, 1e-3, 1.0, 30.0, 1e4, 0.99e9, 1.01e9, 1e12, 1e15]),
            lambda seed, mean_e: _moment_errors(mean_e, 200_000, mean_e),
        ),
        (
            "mean electrons of a uniform field of 1e-9 … 1e12 cd/m²",
            lambda luminance: _green_frame(luminance).mean_e[7, 7],
            lambda luminance: luminance * GREEN_E_PER_S,
            _FLOAT32_ROUNDING,
            "L π sin²α A t QE λ/hc; float32",
            _LUMINANCES_CD_PER_M2,
        ),
        (
            "mean code under 0.01 … 1e9 electrons, one code per electron",
            lambda mean_e: capture(mean_e, _GREEN).dn.mean(),
            lambda mean_e: poisson.sf(np.arange(65_535), mean_e).sum(),
            SIGMAS,
            f"Σ min(n, well) P(n) over Poisson counts; {_RANDOM_SAMPLES}, each of 6",
            [0.01, 1.0, 1e3, 65_535.0, 7e4, 1e9],
            lambda mean_e: np.sqrt(min(mean_e, 65_535) / COUNT),
        ),
        (
            "automatic exposure: brightest pixel over full well, 1e-9 … 1e12 cd/m²",
            lambda luminance: _green_frame(luminance, **automatic).mean_e.max() / 1000,
            0.95,
            ROUNDING,
            "well_target; rounding of one product",
            _LUMINANCES_CD_PER_M2,
        ),
        (
            "automatic exposure: maximum integration time for dim or no light",
            lambda luminance: (
                _green_frame(luminance, integration_s=None, max_integration_s=0.1).integration_s
            ),
            0.1,
            0.0,
            "exactly max_integration_s",
            [0.0, 1e-9, 1.0],
        ),
        (
            "1e10 : 1 in one picture: both halves, 3 pixels from the edge",
            lambda: _bright_and_dark(False)[:, [0, 4, 11, 15]],
            np.array([1e12, 1e12, 1e2, 1e2]) * GREEN_E_PER_S,
            # The rounding of the quintic spline is 1e-16 of the bright half's charge, which is 1e-6
            # of the dark half's.
            3e-5,
            "luminance of each half; 1e10 · rounding of the running sum",
        ),
        (
            "1e10 : 1 with diffraction: minimum electrons of a pixel",
            lambda: min(_bright_and_dark(True).min(), 0.0),
            0.0,
            0.0,
            "not negative",
        ),
        (
            "1e10 : 1 with diffraction: light 6 pixels inside the dark half",
            lambda: _bright_and_dark(True)[:, 13:15].mean() / (1e12 * GREEN_E_PER_S),
            # Averaged over its rings, the Airy pattern decays as λN/(π³ r³), so a bright strip at
            # distances a to b gives (2 λN/π³)(1/a - 1/b). Mirrored at the borders, strips of 80 µm
            # begin at 30 + 160 k and 50 + 160 k µm.
            6.109331e-3,
            0.1,
            (
                "Airy tails of the bright strips and their mirror images; accurate to ring width"
                " over distance, 5 %"
            ),
        ),
    ]


# --- sensors: pixels of 0.3 to 100 µm, 1 to 24 bits, 77 to 400 K, gains of 0 to 60 dB

SENSOR = _SHOT_NOISE_ONLY | {"fill_factor": 0.5}
# Pitch in µm, full well of a junction of the 0.35 µm process that covers half of the pixel.
JUNCTION_WELLS_E = (
    (0.3, 14696.568501851178),
    (1.0, 19155.353434189845),
    (6.5, 133300.54166720487),
    (40.0, 3859623.8340069354),
    (100.0, 23548815.638200372),
)
_TEMPERATURES_K = (77.0, 150.0, 250.0, 300.15, 350.0, 400.0)
_NOISY_PIXELS: tuple[dict[str, Any], ...] = (
    {},
    {"technology": "4t-bsi", "pitch_um": 2.8},
    {"well_limit": "diode"},
    {"conversion": "junction"},
    {"well_limit": "diode", "conversion": "junction"},
)
SATURATED_SHARE = 0.6152809902517223
# 1000 + (2²⁴ - 1001)/2; 0.5e12 · ((2²⁴ - 1001)/1e12)² + 1/12
WIDE_DN = 8389107.5
WIDE_DN2 = 140.804028196446


def saturated_fraction(options: dict[str, Any], wells: float) -> float:
    """Return the share of saturated pixels of 100 000, in uniform light of `wells` full wells."""
    return capture(wells * physics_of(options).full_well_e, options).saturated_fraction


def _rounding_errors(bits: int) -> Array:
    """Return the mean and mean square error, in codes, of 2^18 levels over a whole number of codes,
    so that all are equally frequent.
    """
    level = min(2**bits - 1, 2**16 - 1) * (np.arange(2**18) + 0.5) / 2**18
    return moments(quantise(level, bits) - level, 0.0)


def _dark_gains(seed: int, dsnu: float) -> Array:
    """Return the mean and variance of the dark-current map of a sensor."""
    physics = physics_of(SENSOR | {"dsnu": dsnu, "dark_current_e_per_s": 1.0})
    gain = sample_sensor(Readout.of(physics), FRAME, default_rng(seed)).dark_gain
    return moments(np.asarray(gain, float), 1.0)


def sensor() -> list[Row]:
    hot = SENSOR | {"full_well_e": 1000, "bits": 10, "dark_current_e_per_s": 1e6}
    with_offset = capture(0.0, hot, (4, 4), offset_e=-400.0)
    large_well = SENSOR | {"full_well_e": 1e12, "bits": 24, "black_level_dn": 1000}
    noise = {"read_noise_e": 0.5, "read_noise_after_gain_e": 30.0}
    amplified_pixel = SENSOR | noise | {"full_well_e": 1e5, "bits": 16, "black_level_dn": 4000}

    def amplified_dn(gain_db: float, share: float, shape: tuple[int, int] = FRAME) -> NDArray[Any]:
        return capture(
            share * 1e5 / 10 ** (gain_db / 20), amplified_pixel, shape, gain_db=gain_db
        ).dn

    def amplified_variance_dn2(gain_db: float, share: float) -> float:
        gain = 10 ** (gain_db / 20)
        # 61 535 codes for 1e5 electrons
        return 0.61535**2 * (share * 1e5 * gain + (0.5 * gain) ** 2 + 30**2) + 1 / 12

    return [
        (
            "full well of a pinned photodiode, pitch 0.3 … 100 µm, FF 1e-12 … 1",
            lambda pitch_um, fill: (
                physics_of(
                    _SHOT_NOISE_ONLY
                    | {"technology": "4t-bsi", "pitch_um": pitch_um, "fill_factor": fill}
                ).full_well_e
            ),
            lambda pitch_um, fill: 3490 * fill * pitch_um**2,
            ROUNDING,
            "density · area",
            product([0.3, 6.5, 100.0], [1e-12, 1e-6, 0.5, 1.0]),
        ),
        (
            "full well of a junction, pitch 0.3 … 100 µm",
            lambda pitch_um: physics_of({"pitch_um": pitch_um, "fill_factor": 0.5}).full_well_e,
            ANSWERS,
            ROUNDING,
            "∫C dV/q over the swing with area, sidewall and node, by quadrature",
            JUNCTION_WELLS_E,
        ),
        (
            (
                "dark charge of a thousand full wells, offset -0.4 full wells: every code, and"
                " saturated pixels"
            ),
            lambda: [with_offset.dn.min(), with_offset.dn.max(), with_offset.saturated_fraction],
            [614, 614, 1],
            0.0,
            (
                "0.6 · 1023, rounded: the full well clips before the offset is added; all pixels"
                " are full"
            ),
        ),
        (
            "automatic exposure in the dark: charge over full well",
            lambda: (
                capture(0.0, hot, (2, 2), integration_s=None, max_integration_s=10.0).mean_dark_e
                / 1000
            ),
            0.95,
            ROUNDING,
            "well_target",
        ),
        (
            (
                "saturated pixels under 14 and 0.5 full wells: default pixel, pinned, diode,"
                " junction, diode and junction"
            ),
            saturated_fraction,
            lambda options, wells: wells > 1,
            0.0,
            "all and none: the full well is 30 σ of shot noise and PRNU away",
            product(_NOISY_PIXELS, [14.0, 0.5]),
        ),
        (
            "saturated pixels under one full well, default pixel",
            saturated_fraction,
            SATURATED_SHARE,
            SIGMAS,
            (
                "P(N ≥ full well) + Σ P(N = n < full well) P(noise raises n to the top code);"
                f" {_RANDOM_SAMPLES}"
            ),
            [({"prnu": 0, "dark_current_e_per_s": 0, "column_fpn": 0}, 1.0)],
            math.sqrt(SATURATED_SHARE * (1 - SATURATED_SHARE) / COUNT),
        ),
        (
            "ADC of 1 … 24 bits: mean and mean square error in codes",
            _rounding_errors,
            [0.0, 1 / 12],
            1e-8,
            "symmetry; uniform error of ± half a code; steps of the sweep",
            BITS,
            1.0,
        ),
        (
            "ADC of 1 … 24 bits: codes beyond both ends",
            lambda bits: quantise(np.array([-1e30, 1e30, 2.0**bits - 0.51]), bits),
            lambda bits: [0, 2**bits - 1, 2**bits - 1],
            0.0,
            "exactly 0 and 2^n - 1",
            BITS,
        ),
        (
            (
                "no light and no noise, one pixel, 1 … 24 bits, a quarter of the codes below black:"
                " the code"
            ),
            lambda bits: (
                capture(0.0, SENSOR | {"bits": bits, "black_level_dn": 2**bits // 4}, (1, 1)).dn
            ),
            lambda bits: 2**bits // 4,
            0.0,
            "exactly the black level",
            BITS,
        ),
        (
            "zero read noise, 24 bits: mean code and variance",
            lambda: moments(capture(0.5e12, large_well).dn, WIDE_DN),
            [WIDE_DN, WIDE_DN2],
            SIGMAS,
            f"black level + half of the codes above it; shot noise + 1/12; {_RANDOM_SAMPLES}",
            _NO_ARGUMENTS,
            _moment_errors(WIDE_DN2, COUNT),
        ),
        (
            "no light and half of the ADC's range at 0 … 60 dB: mean code and variance",
            lambda gain_db, share: moments(amplified_dn(gain_db, share), 4000 + share * 61_535),
            lambda gain_db, share: [4000 + share * 61_535, amplified_variance_dn2(gain_db, share)],
            SIGMAS,
            (
                "black level and light; (before · gain)² + after² + shot noise + 1/12, in codes;"
                f" {_RANDOM_SAMPLES}"
            ),
            product([0.0, 0.1, 6.0, 20.0, 40.0, 60.0], [0.0, 0.5]),
            lambda gain_db, share: _moment_errors(amplified_variance_dn2(gain_db, share), COUNT),
        ),
        (
            "four times the ADC's range at 6 … 60 dB: every code",
            amplified_dn,
            65535.0,
            0.0,
            "exactly the top code",
            product([6.0, 20.0, 40.0, 60.0], [4.0], [(4, 4)]),
        ),
        (
            "dark current at 77 … 400 K",
            lambda kelvin: (
                physics_of({"temperature_k": kelvin, "fill_factor": 0.5}).dark_current_e_per_s
            ),
            lambda kelvin: 1e-9 * 0.5 * 6.5e-4**2 / ELECTRON_C * 2 ** ((kelvin - 300.15) / 8),
            ROUNDING,
            "1 nA/cm² · area / q at 300.15 K, doubling every 8 K; rounding",
            _TEMPERATURES_K,
        ),
        (
            "kTC noise at 77 … 400 K",
            lambda kelvin: physics_of({"temperature_k": kelvin, "fill_factor": 0.5}).reset_noise_e,
            lambda kelvin: (
                np.sqrt(BOLTZMANN_J_PER_K * kelvin * 16.583728112310343e-15) / ELECTRON_C
            ),
            ROUNDING,
            "√(kTC)/q with C = 16.58 fF at the reset voltage, from SPICE's C(V)",
            _TEMPERATURES_K,
        ),
        (
            "DSNU 1e-9 … 1: mean and variance of the dark current",
            _dark_gains,
            lambda seed, dsnu: [1.0, dsnu**2],
            SIGMAS,
            # The fourth cumulant of a gamma variable of mean 1 is 6 s⁶; 1e-15 is the rounding of
            # values near 1.
            f"1 and DSNU²; {_RANDOM_SAMPLES}",
            enumerate([1e-9, 0.02, 0.3, 1.0]),
            lambda seed, dsnu: (
                _moment_errors(dsnu**2, COUNT, 6 * dsnu**6) + 1e-15 * np.array([1, 1e-10])
            ),
        ),
    ]


# --- stacks: 1 nm to 10 mm high, behind f/0.5 to f/10⁶

SPOT_NM = np.array([300.0, 550.0, 1200.0])
_PUPIL_ROUNDING = 1e-11  # rounding of boundaries, of a pupil


def _disc_radius_um(f_number: float, height_um: float, index: float) -> float:
    """Return the radius of the disc of light under a paraxial microlens."""
    return height_um / (index * math.hypot(1.0, 2 * f_number))


def _share_under_lens(side_um: float, f_number: float, height_um: float, index: float) -> float:
    """Return the share of the light on a pixel of 6 µm that its photodiode collects."""
    shares = stack_collection(
        6.0, side_um, height_um, index, f_number=f_number, refraction="paraxial"
    )
    return float(shares[1, 1])


def _all_shares(f_number: float, chief_ray_deg: float, microlens: bool, height_um: float) -> float:
    """Return the share of the light on a pixel that it and its neighbours collect, with photodiodes
    as wide as pixels.
    """
    shares = stack_collection(
        6.0,
        6.0,
        height_um,
        1.5,
        f_number=f_number,
        microlens=microlens,
        chief_ray_deg=chief_ray_deg,
        azimuth_deg=30.0,
    )
    return float(shares.sum())


def stacks() -> list[Row]:
    """Shares of light that photodiodes below microlenses and openings collect."""
    lenses = [*product([0.5, 1.4, 8.0, 1e3, 1e6], [4.0, 100.0, 1e4], [1.0, 1.5, 10.0])]
    shifted = Stack(6.0, 1e-3, 1e3, 1.5, microlens=True, shift_um="optimal")
    return [
        (
            "bare pixel behind a pinhole, FF 1e-12 … 1, height 1 nm … 10 mm",
            lambda fill, high_um: stack_collection(
                3.0, 3 * math.sqrt(fill), high_um, 1.5, f_number=1e12, microlens=False
            )[1, 1],
            lambda fill, high_um: fill,
            ROUNDING,
            "fill factor",
            product([1e-12, 1e-6, 0.3, 1.0], [1e-3, 1.0, 1e4]),
        ),
        (
            "small photodiodes under microlenses, f/0.5 … f/1e6, height 4 µm … 10 mm, n 1 … 10",
            lambda *lens: _share_under_lens(
                min(0.7 * _disc_radius_um(*lens), 6.0), *lens
            ),  # its corner is within the disc
            lambda *lens: min(0.7, 6 / _disc_radius_um(*lens)) ** 2 / math.pi,
            _PUPIL_ROUNDING,
            "photodiode over disc, w²/(π (h NA/n)²); rounding of boundaries",
            lenses,
        ),
        (
            "photodiodes as wide as the disc, f/0.5 … f/1e6",
            lambda *lens: _share_under_lens(2 * _disc_radius_um(*lens), *lens),
            1.0,
            _PUPIL_ROUNDING,
            "1 at N = √((h/nw)² - ¼), where the disc touches the photodiode's sides",
            [lens for lens in lenses if _disc_radius_um(*lens) < 2.95],
        ),
        (
            "photodiodes as wide as their pixels, 0 and 20°: all nine",
            _all_shares,
            1.0,
            _PUPIL_ROUNDING,
            "conservation",
            product([0.7, 4.0, 1e3], [0.0, 20.0], [True, False], [3.5, 5.0]),
        ),
        (
            "chief rays of 0 … 89°, optimal shift, 1 mm below",
            lambda: collected_shares(shifted, disc_pupil(1e-10, [0.0, 30.0, 60.0, 89.0], 40.0))[
                :, 2, 2
            ],
            1.0,
            0.0,
            "exactly 1: on the centre of 1 nm",
        ),
        (
            "diffraction of a microlens of 1 µm, 300 … 1200 nm",
            lambda: collected_shares(
                Stack(1.0, 0.4, 3.0, 1.5, microlens=True), disc_pupil(0.0), SPOT_NM
            )[:, 2, 2],
            [0.350674489265, 0.123055196522, 0.0273586031413],
            1e-7,
            "∫ sinc² by quadrature; table 2e-8",
        ),
        (
            "light beyond étendue at f/0.5, from the lowest microlens on",
            lambda fill, high_um: max(
                0.0, _share_under_lens(6 * math.sqrt(fill), 0.5, high_um, 1.5) - fill * 1.5**2 / 0.5
            ),
            0.0,
            0.0,
            "at most FF · n²/NA²",
            product([1e-6, 0.1, 0.9], [3.3852, 4.0, 1e4]),
        ),
    ]


# --- integration: ratios of pixel pitch and grid that are not integers, or but for rounding

_ALMOST_INTEGER = 1e-12
SIDE, LONG = 64, 20_000  # samples
# The rounding of a running sum of n cells is proportional to n, and the spline amplifies it:
# measured 5 to 20 eps n.
_RUNNING_SUM_ROUNDING = 50 * _EPS
_ROUNDING_OF_SUM = 4 * _EPS * SIDE  # for sums over all pixels, in which the spline's part cancels


def _random_picture(*shape: int) -> Array:
    return default_rng(shape).uniform(0.5, 1.5, shape)


def _centres_um(count: int, pitch_um: float, length_um: float) -> Array:
    return length_um / 2 + (np.arange(float(count)) - (count - 1) / 2) * pitch_um


def plane(shape: tuple[int, ...], size_um: tuple[int, int], pitch_um: float = 1.0) -> Array:
    """Return a linear picture, per µm², at centres of pixels: its value at a point is its mean over
    any rectangle centred there.
    """
    y, x = map(_centres_um, shape, (pitch_um, pitch_um), size_um)
    return 1 + (y[:, None] + 2 * x) / max(size_um)


def _integrated_plane(size_um: tuple[int, int], pitch_um: float, side_um: float) -> Array:
    """Return the means of a linear picture over photodiodes, relative to its values at their
    centres.
    """
    means = integrate_pixels(plane(size_um, size_um), 1.0, pitch_um, side_um) / side_um**2
    return means / plane(means.shape, size_um, pitch_um)


def _wave_means(count: int, pitch_um: float, side_um: float) -> Array:
    """Return the means of a grating with 2.5 periods in 64 µm over photodiodes, in closed form."""
    wave = np.cos(np.pi * 5 * _centres_um(count, pitch_um, SIDE) / SIDE)
    return 1 + wave * np.sinc(5 * side_um / (2 * SIDE))


def integration() -> list[Row]:
    picture = _random_picture(SIDE, SIDE)
    long = _random_picture(LONG, 3)
    return [
        (
            (
                "electrons of all pixels, FF 1, pitch/grid 1, 1 + 1e-12, 1/3, 4/7, 7/3, and one"
                " pixel that covers 1×1 to 64×64 samples"
            ),
            lambda samples, ratio: integrate_pixels(samples, 1.0, ratio, ratio).sum(),
            lambda samples, ratio: samples.sum(),
            _ROUNDING_OF_SUM,
            "conservation; roundings of sums",
            [
                *product([picture], [1.0, 1 + _ALMOST_INTEGER, 1 / 3, 4 / 7, SIDE]),
                (_random_picture(63, 70), 7 / 3),
                (_random_picture(1, 1), 1.0),
            ],
        ),
        (
            "every pixel, pitch/grid 1 + 1e-12 and 1 - 1e-12",
            lambda ratio: integrate_pixels(picture, 1.0, ratio, ratio),
            picture,
            4 * SIDE * _ALMOST_INTEGER,
            "limit: the samples themselves; borders move by 3.2e-11 samples along either axis",
            [1 + _ALMOST_INTEGER, 1 - _ALMOST_INTEGER],
            1.0,
        ),
        (
            "linear pictures of 64×64 to 20 000×4 samples, pitch/grid 1, 7/3, π, 1/3, 0.3",
            lambda size_um, ratio: _integrated_plane(size_um, ratio, 0.6 * ratio),
            1.0,
            _RUNNING_SUM_ROUNDING,
            "closed form; rounding of a running sum of n samples, relative to n samples",
            product([(SIDE, SIDE), (5, 60), (60, 4), (LONG, 4)], [1.0, 7 / 3, math.pi, 1 / 3, 0.3]),
            lambda size_um, ratio: max(size_um) / (0.6 * ratio),
        ),
        (
            "a photodiode of a millionth of a sample's width, linear picture",
            lambda: _integrated_plane((SIDE, SIDE), math.pi, 1e-6),
            1.0,
            _RUNNING_SUM_ROUNDING * SIDE / 1e-6,
            "limit: the value at its centre; rounding of a running sum relative to the width",
        ),
        (
            "20 000×3 samples of 0.1 µm in pixels of 0.3 µm: electrons of all",
            lambda: integrate_pixels(long, 0.1, 0.3, 0.3).sum(),
            long[1:-1].sum() * 0.01,
            4 * _EPS * LONG,
            "conservation: 6666 centred pixels exclude one sample at either end",
        ),
        (
            "a grating with a period of 26 samples, photodiodes of 0.6 π samples, pitch π",
            lambda: integrate_pixels(
                np.tile(_wave_means(SIDE, 1, 1), (SIDE, 1)), 1.0, math.pi, 0.6 * math.pi
            ),
            _wave_means(20, math.pi, 0.6 * math.pi) * (0.6 * math.pi) ** 2,
            2e-4,
            "closed form; error of the quintic spline, 0.02 %",
            _NO_ARGUMENTS,
            1.0,
        ),
        (
            "light of 64 pixels shown on 1 to 4096 dots, nearest or linear interpolation",
            lambda degree, dots: average_axis(
                picture, 1.0, 0.0, np.linspace(0.0, SIDE, dots + 1), degree, axis=0
            ).mean(axis=0),
            picture.mean(axis=0),
            _ROUNDING_OF_SUM,
            "conservation",
            product([0, 1], [1, 3, 37, 64, 200, 4096]),
        ),
    ]


# --- viewing: 0.5 to 2000 samples per degree, light from zero to 1e12 times white, tiny pictures

_DENSITIES = (0.5, 1.0, 23.0, 111.0, 224.0, 500.0, 2000.0)  # samples per degree
# Smaller than the widest Gaussian, 4.3°
_VIEWED_SHAPES = ((1, 1), (2, 1), (1, 9), (3, 5), (33, 20))
_BOTH_FILTERS = ("published", "zhang1996")
WHITE = np.array([95.047, 100.0, 108.883])
THRESHOLD = (6 / 29) ** 3  # of Y/Yn, CIE 15
# X/Xn, Y/Yn, Z/Zn and CIELAB, by the branches of CIE 15.
COLOURS = (
    ((1.0, 1.0, 1.0), (100.0, 0.0, 0.0)),
    ((0.3, 0.2, 0.9), (51.837211526538496, 42.31470121979813, -76.13716739261129)),
    ((1e-3, 2e-3, 1e-4), (1.8065925925925939, -3.893518518518518, 2.959074074074075)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
)
# Samples per degree, order, and CIELAB of the first sample of `grating` behind the filters of Zhang
# & Wandell (1997).
GRATINGS = (
    (0.5, 5, (82.01672249729, 37.088022229072, 29.53091783481)),
    (23.0, 1, (84.485053705885, 27.410936689977, 23.411444693678)),
    (23.0, 5, (83.019092640317, 18.442581906905, 10.972522651902)),
    (111.0, 1, (83.892175256107, 20.606078888139, 12.54988931691)),
    (224.0, 1, (82.505326565353, 12.329986408683, 5.0481101434928)),
    (1000000000.0, 5, (76.069261014156, 0.0, 0.0)),
)
# Rounding of transforms of values near 1 times the slope of Lab, up to 903 in L* and 500·7.8 in a*:
# 1e-15 · 4e3 · 10.
_LAB_ROUNDING = 1e-10


def _viewed_lab(
    relative: Array, samples_per_deg: float = 23.0, filters: Filters = "published"
) -> Array:
    """Return CIELAB of X/Xn, Y/Yn, Z/Zn behind the filters of the eye."""
    return filtered_lab(
        relative * WHITE, white_xyz=WHITE, samples_per_deg=samples_per_deg, filters=filters
    )


def _viewed_delta_e(relative: Array, other: Array, unit: float = 1.0, **filters: Any) -> Array:
    return delta_e_map(
        relative * WHITE * unit,
        other * WHITE * unit,
        white_xyz=WHITE * unit,
        samples_per_deg=23.0,
        **filters,
    )


def grating(order: int) -> Array:
    """Return X/Xn, Y/Yn, Z/Zn (1, 16, 3) of a grating in all three opponent channels."""
    wave = np.cos(np.pi * order * (np.arange(16) + 0.5) / 16)
    return 0.5 + wave[None, :, None] * np.array([0.3, 0.1, -0.2])


def _mirrored_lab(relative: Array, samples_per_deg: float, filters: Filters) -> Array:
    """Return CIELAB of a picture, filtered with its mirror images around it."""
    rows, columns, _ = relative.shape
    whole = np.pad(relative, ((0, rows), (0, columns), (0, 0)), mode="symmetric")
    return _viewed_lab(whole, samples_per_deg, filters)[:rows, :columns]


def viewer() -> list[Row]:
    pictures = [default_rng(shape).uniform(0.02, 1.2, (*shape, 3)) for shape in _VIEWED_SHAPES]
    grey = np.ones((4, 4, 3))
    noise = default_rng(9).uniform(-0.5, 0.5, (24, 24, 3)) * THRESHOLD
    return [
        (
            "CIELAB of uniform pictures, 0.5 to 2000 samples/deg",
            lambda colour, lab, shape, density: _viewed_lab(
                np.broadcast_to(colour, (*shape, 3)), density
            ),
            lambda colour, lab, shape, density: lab,
            _LAB_ROUNDING,
            "CIE 15: blur does not change a uniform picture; ΔE, rounding",
            [
                (*colour, *view)
                for colour, view in product(COLOURS, product(_VIEWED_SHAPES, _DENSITIES))
            ],
            1.0,
        ),
        (
            "CIELAB of coloured gratings, 0.5 to 1e9 samples/deg",
            lambda density, order: _viewed_lab(grating(order), density)[0, 0],
            ANSWERS,
            _LAB_ROUNDING,
            "Σ w exp(-π² s² f²)/Σ w of each opponent channel, closed form; ΔE, rounding",
            GRATINGS,
            1.0,
        ),
        (
            "pictures smaller than the eye's blur, both filters, 0.5 to 2000 samples/deg",
            _viewed_lab,
            _mirrored_lab,
            _LAB_ROUNDING,
            "symmetry: adding the mirror images to a picture changes nothing; ΔE, rounding",
            product(pictures, _DENSITIES, _BOTH_FILTERS),
            1.0,
        ),
        (
            "ΔE of a picture with itself: black, negative, 1e-12 and 1e12 times white",
            lambda picture, times, filters: _viewed_delta_e(
                picture * times, picture * times, filters=filters
            ),
            0.0,
            0.0,
            "exactly 0",
            product(pictures, [0, -1, 1e-12, 1e12], _BOTH_FILTERS),
        ),
        (
            "ΔE of images and white times 2^-1000 and 2^1000",
            lambda picture, unit: _viewed_delta_e(picture, 0.9 * picture[::-1, ::-1], unit),
            lambda picture, unit: _viewed_delta_e(picture, 0.9 * picture[::-1, ::-1]),
            0.0,
            "independent of the unit of XYZ, bit for bit",
            product(pictures, [2.0**-1000, 2.0**1000]),
        ),
        (
            "ΔE of black and grey of 1e-150 to 1e-3 of white",
            lambda share: _viewed_delta_e(0 * grey, share * grey),
            lambda share: (29 / 3) ** 3 * share,
            1e-12,
            "(29/3)³ Y/Yn",
            [1e-150, 1e-12, 1e-6, 1e-3],
        ),
        (
            "CIELAB of noise around black, negative XYZ included",
            lambda: _viewed_lab(-noise),
            lambda: -_viewed_lab(noise),
            _LAB_ROUNDING,
            "symmetry: CIELAB is linear through zero, without clipping; ΔE, rounding",
            _NO_ARGUMENTS,
            1.0,
        ),
        (
            "grey pictures by one transform and by three, 0.5 to 2000 samples/deg",
            lambda picture, density: filtered_grey_lab(
                picture[..., 1], white_xyz=WHITE, samples_per_deg=density
            ),
            lambda picture, density: _viewed_lab(picture[..., [1, 1, 1]], density),
            _LAB_ROUNDING,
            "identical pictures; ΔE, rounding",
            product(pictures, _DENSITIES),
            1.0,
        ),
        (
            "L* from 0.5 to 1.5 of its threshold, Y/Yn = 216/24389, and next to it",
            lambda times: xyz_to_lab(times * THRESHOLD * WHITE, WHITE)[0],
            lambda times: 8 * times if times < 1 else 24 * np.cbrt(times) - 16,
            ROUNDING,
            "CIE 15 by its two branches, without a step",
            1 + np.array([-0.5, -1e-2, -1e-4, -1e-8, -_EPS, 0.0, _EPS, 1e-8, 1e-4, 1e-2, 0.5]),
        ),
    ]


# --- photodiodes: from hours in the dark to 100 ns in forward bias, 77 to 400 K, four processes

_CURRENTS_E_PER_S = np.logspace(-3, 17, 201)
_HOURS_S = 36000.0
_DISCHARGES_S = np.array([1e-9, 1e-6, 1e-3, 0.03, 1.0, _HOURS_S])
_PROCESSES: dict[str, dict[str, Any]] = {
    "0.5um": {"technology": "0.5um", "pitch_um": 8.7},
    "0.35um": {"technology": "0.35um", "pitch_um": 6.5},
    "0.25um": {"technology": "0.25um", "pitch_um": 5.3},
    "0.18um": {"technology": "0.18um", "pitch_um": 3.9},
    "constant capacitance": {"capacitance": "paper"},
}
# By source: process, K, e-/s, s, and the charge in electrons.
CHARGES_E = {
    "closed form": (
        ("constant capacitance", 77.0, 1e-3, 1e-9, 1.0032843818270583e-12),
        ("constant capacitance", 77.0, 1e12, 1e-7, 84491.43154199269),
        ("constant capacitance", 77.0, 1e17, _HOURS_S, 87107.63453965045),
        ("constant capacitance", 300.15, 0.0, _HOURS_S, 75343.33026288537),
        ("constant capacitance", 300.15, 7e6, 0.01, 70008.19022382855),
        ("constant capacitance", 300.15, 1e12, 1e-7, 93875.83711192531),
        ("constant capacitance", 400.0, 1e-3, 1e-9, 0.004683167761739064),
        ("constant capacitance", 400.0, 7e6, 0.01, 76422.48585985567),
        ("constant capacitance", 400.0, 1e17, _HOURS_S, 103420.17697545441),
    ),
    "LSODA, an implicit solver, with a tolerance of 1e-13": (
        ("0.5um", 300.15, 1e12, 2.4e-7, 232411.27747887),
        ("0.35um", 300.15, 1e12, 2.5e-7, 245351.13283440),
        ("0.25um", 300.15, 1e12, 3.8e-7, 368954.35889524),
        ("0.18um", 300.15, 1e12, 1e-7, 98529.73953668),
        ("0.35um", 77.0, 7e6, 0.03, 202827.56606735),
        ("0.35um", 400.0, 7e6, 0.03, 185892.10424302),
    ),
    "∫C dV/q of SPICE's C(V) down to V_oc = -V_T ln(1 + i/I_s), by quadrature": (
        ("0.5um", 300.15, 0.0, 3.6e7, 167707.77639408252),
        ("0.5um", 300.15, 1e6, _HOURS_S, 188263.70950412468),
        ("0.5um", 300.15, 1e11, _HOURS_S, 224596.4430751707),
        ("0.5um", 300.15, 1e17, _HOURS_S, 280912.6295021242),
        ("0.35um", 300.15, 0.0, 3.6e7, 182613.06807338033),
        ("0.35um", 300.15, 1e6, _HOURS_S, 202324.7433576583),
        ("0.35um", 300.15, 1e11, _HOURS_S, 238365.47653420203),
        ("0.35um", 300.15, 1e17, _HOURS_S, 291989.46309839684),
        ("0.25um", 300.15, 0.0, 3.6e7, 256929.17258345024),
        ("0.25um", 300.15, 1e6, _HOURS_S, 288159.17272281554),
        ("0.25um", 300.15, 1e11, _HOURS_S, 355165.9536653456),
        ("0.25um", 300.15, 1e17, _HOURS_S, 458262.8480418944),
        ("0.18um", 300.15, 0.0, 3.6e7, 63493.554031178406),
        ("0.18um", 300.15, 1e6, _HOURS_S, 72799.82249640423),
        ("0.18um", 300.15, 1e11, _HOURS_S, 95058.09287983931),
        ("0.18um", 300.15, 1e17, _HOURS_S, 128755.59422329054),
    ),
}
# Of the tables of a photodiode's response: process and K.
TABLES = (("0.5um", 400.0), ("0.35um", 300.15), ("0.25um", 77.0), ("0.18um", 400.0))


def pixel_at(process: str, temperature_k: float, **options: Any) -> PixelPhysics:
    return physics_of(_PROCESSES[process] | {"temperature_k": temperature_k} | options)


def _collected_share(process: str) -> Array:
    """Return the share of the generated charge that a photodiode collects, below 29 000 electrons.

    So many electrons take half of the reset voltage at most. Above, the share is set to 1.
    """
    diode = diode_of(pixel_at(process, 300.15))
    generated_e = (_CURRENTS_E_PER_S[:, None] + diode.saturation_current_e_per_s) * _DISCHARGES_S
    collected_e = collected_charge_e(_CURRENTS_E_PER_S[:, None], _DISCHARGES_S, diode)
    return np.where(generated_e < 29_000, collected_e / generated_e, 1.0)


def photodiode() -> list[Row]:
    rows: list[Row] = []
    for source, answers in CHARGES_E.items():
        for process, temperature_k, current, time_s, charge_e in answers:
            name = f"{process}, {temperature_k:g} K, {current:g} e-/s for {time_s:g} s"
            inputs = [(current, time_s, diode_of(pixel_at(process, temperature_k)))]
            rows.append((name, collected_charge_e, charge_e, 1e-9, source, inputs))
    for saturation, currents in ((0.0, _CURRENTS_E_PER_S), (1e-300, _CURRENTS_E_PER_S[:90])):
        name = f"a diode current of {saturation:g} e-/s: no charge is lost"
        diode = replace(default_diode(), saturation_current_e_per_s=saturation)
        rows.append(
            (
                name,
                collected_charge_e,
                0.03 * currents,
                ROUNDING,
                "conservation of charge",
                [(currents, 0.03, diode)],
            )
        )
    for process, temperature_k in TABLES:
        # At 0.18 µm the diode loses 1e-12 even there: e^(-V/V_T) at half of the reset voltage, 0.58
        # V, over hours.
        rows.append(
            (
                f"{process}: no loss before saturation",
                _collected_share,
                1.0,
                1e-11,
                "conservation of charge",
                [process],
            )
        )
        rows += _table_rows(process, temperature_k, 1e-3, "linear")
        rows += _table_rows(process, temperature_k, _HOURS_S, "junction")
    return rows


def _table_rows(process: str, temperature_k: float, time_s: float, conversion: str) -> list[Row]:
    """Return the rows of a photodiode's table of responses, which replaces a quadrature."""
    name = f"{process}, {temperature_k:g} K, {time_s:g} s, {conversion}"
    physics = pixel_at(process, temperature_k, well_limit="diode", conversion=conversion)
    diode = diode_of(physics)
    well_e = physics.full_well_e
    is_junction = conversion == "junction"
    below_e = np.linspace(0, 1 - 1e-9, 65) * diodes.linear_limit_e(diode, well_e, time_s)

    def level_e(generated_e: Array) -> Array:
        stored_e = diodes.stored_charge_e(generated_e, time_s, diode)
        return diodes.converted_e(stored_e, well_e, diode) if is_junction else stored_e

    return [
        (
            f"table: {name}",
            lambda generated_e: diodes.stored_signal_e(generated_e, time_s, Readout.of(physics)),
            level_e,
            1e-6,
            "quadrature",
            [well_e * np.concatenate([np.linspace(0, 2, 1501), np.logspace(-4, 15, 301)])],
            well_e,
        ),
        (
            f"table is monotone: {name}",
            lambda: min(
                np.diff(diodes.level_table(diode, well_e, time_s, is_junction).level_e).min(), 0.0
            ),
            0.0,
            0.0,
            "f_t is monotone",
        ),
        (
            f"linear response below its limit: {name}",
            lambda: diodes.stored_charge_e(below_e, time_s, diode),
            below_e,
            diodes.LINEAR_WITHIN,
            "quadrature",
            _NO_ARGUMENTS,
            well_e,
        ),
    ]


TABLE = (optics, spectra, light, sensor, stacks, integration, viewer, photodiode)


def all_cases() -> list[ExtremeCase]:
    """Check the whole table."""
    return [KnownAnswer(*row).check(room.__name__) for room in TABLE for row in room()]
