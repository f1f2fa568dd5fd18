"""Narrow and missing light: lines of 1 nm at any wavelength, dark bands, and light outside the sensor's response."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.light import spectral
from pixsim.light.spectral import HIGH_NM, LOW_NM, SpectralImage, Spectrum, photons_per_joule, photopic_efficiency
from pixsim.optics.camera import Camera
from pixsim.scene.bands import Bands, Response, Witness, fit, place_bands
from pixsim.sensor.integration import electrons_per_joule, mean_signal_rate
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.verification.stability import ExtremeCase, compare
from pixsim.viewer.display import white_rate
from pixsim.viewer.display_options import Display

# Integer and fractional wavelengths, borders of bands, ends of the response (400 and 800 nm) and of the range.
CENTRES_NM = (360.0, 360.2, 361.0, 365.0, 365.5, 393.7, 400.0, 400.3, 447.31,
              532.0, 555.03, 632.8, 700.0, 799.7, 800.0, 829.3, 830.0)  # fmt: skip
LINE = "360 to 830 nm, on and off the borders of bands"
SURFACES = np.zeros((0, 471))  # none
BANDS_TOLERANCE = 2.5e-4  # error of the bands in a render with default tolerance
LUMINANCE_TOLERANCE = 1e-3
SUMMED = 1e-13  # rounding of a running sum over up to 15 040 cells
GRID_NM = np.arange(LOW_NM, HIGH_NM + 0.05, 0.1)  # every table has its nodes here
PITCH_UM = 10.0
HC_J_M = spectral.PLANCK_J_S * spectral.LIGHT_SPEED_M_PER_S
CAMERA = Camera()


def cases() -> Iterator[ExtremeCase]:
    yield from _lines()
    yield from _missing_light()
    yield from _blind()


def line(centre_nm: float, width_nm: float = 1.0) -> Spectrum:
    """A triangular line of 1 W m⁻² with full width `width_nm` at half maximum."""
    return Spectrum(np.array([centre_nm - width_nm, centre_nm, centre_nm + width_nm]), np.array([0.0, 1 / width_nm, 0.0]))


def power_in_range(centre_nm: float) -> float:
    """Power of a triangular line, 1 nm wide, within 360-830 nm, in closed form."""

    def below(nm: float) -> float:
        u = min(max(nm - centre_nm, -1.0), 1.0)
        return (1 + u) ** 2 / 2 if u < 0 else 1 - (1 - u) ** 2 / 2

    return below(HIGH_NM) - below(LOW_NM)


def response_to(lamp: Spectrum, response: Response) -> float:
    """∫ lamp · response by Gauss quadrature between the nodes of both."""
    low, high = max(LOW_NM, lamp.nodes_nm[0]), min(HIGH_NM, lamp.nodes_nm[-1])
    inside = GRID_NM[(low < GRID_NM) & (high > GRID_NM)]
    nodes = np.unique(np.concatenate([[low, high], inside, np.clip(lamp.nodes_nm, low, high)]))
    x, weight = np.polynomial.legendre.leggauss(3)
    half = np.diff(nodes)[:, None] / 2
    at = nodes[:-1, None] + half * (1 + x)
    return float((half * weight * lamp.at(at) * response(at)).sum())


def image_of(lamp: Spectrum, bands: Bands) -> SpectralImage:
    """A uniform field of 8×8 samples with the lamp's spectrum, W m⁻² nm⁻¹."""
    factors, within = (lamp.cell_means(bands.edges_nm), np.ones((1, 8, 8))), (bands.nodes_nm, bands.shares)
    return SpectralImage(bands.wavelength_nm, bands.width_nm, 2 * PITCH_UM, factors=factors, within=within, header={})


def _lines() -> Iterator[ExtremeCase]:
    physics = derive(Pixel(pitch_um=PITCH_UM))
    flat = derive(Pixel(pitch_um=PITCH_UM, quantum_efficiency=0.5))

    def electrons(nm: Array) -> Array:
        return physics.quantum_efficiency(nm) * photons_per_joule(nm)

    witnesses = [Witness(electrons), Witness(photopic_efficiency)]
    placed = [(line(nm), place_bands([line(nm)], SURFACES, witnesses, BANDS_TOLERANCE)) for nm in CENTRES_NM]
    images = [image_of(*lamp_and_bands) for lamp_and_bands in placed]
    power = [power_in_range(nm) for nm in CENTRES_NM]
    light = [float((image.mean_spectrum() * image.band_width_nm).sum()) for image in images]
    yield compare(f"power of a 1 nm line in its bands, {LINE}", power, light, SUMMED, "area of the triangle within 360-830 nm")
    fits = [(fit(lamp, bands, SURFACES, witnesses, BANDS_TOLERANCE), bands) for lamp, bands in placed]
    got = [math.nan if pulses is None else float((pulses.spectra.sum(axis=0) * bands.width_nm).sum()) for pulses, bands in fits]
    yield compare(f"power of a 1 nm line in one pulse of the renderer, {LINE}", power, got, SUMMED, "the same area")
    expected, got = [response_to(lamp, electrons) for lamp, _ in placed], [_electrons(image, physics) for image in images]
    name, source = "electrons from a 1 nm line, QE of the 0.35 µm process", "∫ QE λ/hc E dλ, by quadrature; tolerance of the bands"
    yield compare(f"{name}, {LINE}", expected, got, BANDS_TOLERANCE, source)
    expected = [spectral.LUMINOUS_EFFICACY_LM_PER_W * response_to(lamp, photopic_efficiency) for lamp, _ in placed]
    got, source = [image.illuminance_lx()[0, 0] for image in images], "683.002 ∫ ȳ E dλ, by quadrature; tolerance of the bands"
    yield compare(f"illuminance of a 1 nm line, {LINE}", expected, got, LUMINANCE_TOLERANCE, source)
    lasers = [nm for nm in CENTRES_NM if LOW_NM + 1 < nm < HIGH_NM - 1 and nm not in (400.0, 800.0)]  # no step within the line
    thin = [line(nm, 0.01) for nm in lasers]
    images = [image_of(lamp, place_bands([lamp], SURFACES, witnesses, BANDS_TOLERANCE)) for lamp in thin]
    expected = [0.5 * nm * 1e-9 / HC_J_M for nm in lasers]
    got, source = ([_electrons(image, flat) for image in images], "QE λ/hc · power; wavelength to half a cell of 1/32 nm")
    yield compare("electrons from a laser 0.01 nm wide, QE 0.5, 361 to 829 nm", expected, got, 1 / 64 / LOW_NM, source)
    each_pixel = (electrons(np.array(lasers)) * (physics.photodiode_area_um2 * 1e-12))[:, None, None]
    rates = [mean_signal_rate(image, CAMERA, physics) for image in images]
    source = "QE(λ) λ/hc · power · photodiode area in every pixel; tolerance of the bands"
    yield compare("electrons of every pixel from a laser, with diffraction", each_pixel, rates, BANDS_TOLERANCE, source)


def _electrons(image: SpectralImage, physics: PixelPhysics) -> float:
    return float((electrons_per_joule(physics, image) * image.mean_spectrum()).sum())


def _missing_light() -> Iterator[ExtremeCase]:
    physics = derive(Pixel(pitch_um=PITCH_UM))
    nm = np.arange(365.0, 826.0, 10.0)
    for name, lit in (("every second band dark", np.arange(nm.size) % 2 == 0), ("one band lit of 47", nm == 555.0)):
        spectrum = np.where(lit, 0.02, 0.0)
        qe = physics.quantum_efficiency(nm)
        per_band = 0.02 * 10 * qe * nm * 1e-9 / HC_J_M
        wanted = math.fsum(per_band[lit]) * physics.photodiode_area_um2 * 1e-12
        rates = [mean_signal_rate(image, CAMERA, physics) for image in _even_images(nm, spectrum)]
        source = "sum over the lit bands; rounding of irradiance to float32, 6e-8"
        yield compare(f"electrons of every pixel, {name}", wanted, rates, 1e-7, source)
    dark = place_bands([line(555.0) * 0.0], SURFACES, [Witness(photopic_efficiency)], BANDS_TOLERANCE)
    yield compare("shares of light in the bands of a lamp that is off", 1.0, dark.shares.sum(axis=1), 1e-15, "sum of 1")
    amounts = [10.0**k for k in (-30, -12, 0, 12, 30)]
    bright = [_electrons(_even_images(nm, np.full(nm.size, amount))[0], physics) for amount in amounts]
    name = "electrons against irradiance, 1e-30 to 1e30 W m⁻² nm⁻¹"
    yield compare(name, [bright[2] * amount for amount in amounts], bright, 1e-14, "proportional; rounding")


def _even_images(nm: Array, spectrum: Array) -> list[SpectralImage]:
    """The same uniform field as a spectrum times a picture, and as full data."""
    shape = (8, 6)
    factored = SpectralImage(nm, 10.0, 2 * PITCH_UM, factors=(spectrum, np.ones((1, *shape))))
    return [factored, SpectralImage(nm, 10.0, 2 * PITCH_UM, data=np.broadcast_to(spectrum, (*shape, nm.size)))]


def _blind() -> Iterator[ExtremeCase]:
    nm = np.arange(365.0, 826.0, 10.0)
    outside = {
        "below and above the response, 400-800 nm": (Pixel(pitch_um=PITCH_UM), (nm < 400) | (nm > 800)),
        "beyond the infrared cut": (Pixel(pitch_um=PITCH_UM, technology="4t-bsi", infrared_cut_nm=650.0), nm > 655),
    }
    for name, (pixel, lit) in outside.items():
        images = _even_images(nm, np.where(lit, 0.02, 0.0))
        physics = derive(pixel)
        rates = [mean_signal_rate(image, CAMERA, physics) for image in images]
        yield compare(f"electrons of every pixel, light only {name}", 0.0, rates, 0.0, "exactly 0")
    physics = derive(Pixel(pitch_um=PITCH_UM))
    refused = [_is_refused(_even_images(nm, np.where(lit, 0.02, 0.0))[0], physics) for lit in (nm < 400, nm < 0)]
    source = "raises PixsimError instead of dividing by 0"
    yield compare("white outside the sensor's response, or without light", 1.0, refused, 0.0, source)


def _is_refused(image: SpectralImage, physics: PixelPhysics) -> float:
    try:
        white_rate(image, CAMERA, physics, Display(white_cd_per_m2=1000.0))
    except PixsimError:
        return 1.0
    return 0.0
