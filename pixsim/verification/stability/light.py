"""Light from zero to far beyond saturation: electrons and codes against closed forms and exact sums over counts."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm, poisson

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.sensor import readout as sensors
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import mean_signal_rate
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.verification.stability import QUIET, ROUNDING, ExtremeCase, compare, compare_drawn

STORED = 2e-7  # the irradiance is stored in float32
LUMINANCES_CD_PER_M2 = 10.0 ** np.arange(-9, 13)
ELECTRON_MEANS = np.array([1e-6, 1e-3, 1.0, 30.0, 1e4, 0.99e9, 1.01e9, 1e12, 1e15])
# One band at 555 nm, where the closed form needs no table: 683.002 lm/W by definition, λ/hc photons per joule.
GREEN_NM, WIDTH_NM, LM_PER_W = 555.0, 10.0, 683.002
PHOTONS_PER_J = 555e-9 / (6.62607015e-34 * 299792458.0)
PITCH_UM, TIME_S = 5.0, 0.01
CAMERA = Camera(die_mm=0.08)
# Shot noise alone, QE 0.5, fill factor 0.5, one code per electron up to 2^16 - 1.
CLEAN = QUIET | {"quantum_efficiency": 0.5, "fill_factor": 0.5, "full_well_e": 65_535, "bits": 16, "pitch_um": PITCH_UM}


def cases() -> Iterator[ExtremeCase]:
    for group in (_shot_noise, _levels, _automatic_exposure, _contrast, _darkness, _saturation):
        yield from group()


def scene(picture: Array, luminance_cd_per_m2: float, diffraction: bool = False) -> SpectralImage:
    """A picture in green light behind `CAMERA` without fall-off; 1 is the given luminance."""
    radiance = luminance_cd_per_m2 / LM_PER_W / WIDTH_NM
    spectrum = [[radiance * float(irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))]]
    header = {"diffraction": diffraction}
    return SpectralImage([GREEN_NM], WIDTH_NM, 1e3 * CAMERA.die_mm / picture.shape[1], factors=(spectrum, [picture]), header=header)


def electrons(luminance_cd_per_m2: ArrayLike, time_s: float = TIME_S) -> Array:
    """Mean electrons of a pixel of `CLEAN`: L · π sin²α · A · t · λ/hc · QE / K(λ)."""
    sin2 = 1 / (1 + 4 * (CAMERA.f_number * (1 + CAMERA.magnification)) ** 2)
    watts = np.asarray(luminance_cd_per_m2, float) / LM_PER_W * math.pi * sin2 * 0.5 * (PITCH_UM * 1e-6) ** 2
    return np.asarray(watts * PHOTONS_PER_J * 0.5 * time_s)


def captured(image: SpectralImage, physics: PixelPhysics, exposure: Exposure) -> sensors.Frame:
    rate = mean_signal_rate(image, CAMERA, physics)
    sensor = sensors.sample_sensor(physics, rate.shape, np.random.default_rng(0))
    return sensors.capture_from_rates(rate, sensor, exposure, np.random.default_rng(1))


def _shot_noise() -> Iterator[ExtremeCase]:
    n = 200_000
    means, variances = [], []
    for seed, mean_e in enumerate(ELECTRON_MEANS):
        counts = sensors.shot_noise(np.full(n, mean_e), np.random.default_rng(seed))
        means.append((counts.mean() - mean_e) / math.sqrt(mean_e / n))
        # The fourth moment of a Poisson count is m + 3m², so its sample variance has the standard error √((m + 2m²)/n).
        variances.append((np.mean((counts - mean_e) ** 2) - mean_e) / math.sqrt((mean_e + 2 * mean_e**2) / n))
    name = "electrons 1e-6 … 1e15, 200 000 pixels each: {}, in standard errors"
    # A mean of 1e-6 gives 0.2 electrons in all pixels together; three or more exceed the limit.
    rare = ", 1e-3 at a mean of 1e-6"
    yield compare_drawn(name.format("mean"), 0.0, means, 1.0, "the Poisson mean", rare)
    yield compare_drawn(name.format("variance"), 0.0, variances, 1.0, "the Poisson variance is the mean", rare)
    counts = sensors.shot_noise(np.full(n, 3.0), np.random.default_rng(77))
    shares = np.array([np.mean(counts == k) for k in range(12)])
    exact = poisson.pmf(np.arange(12), 3.0)
    error = np.sqrt(exact * (1 - exact) / n)
    yield compare_drawn("shares of 0 … 11 electrons at a mean of 3", exact, shares, error, "exp(-3) 3^k / k!", ", each of 12")


def _levels() -> Iterator[ExtremeCase]:
    """A uniform field from 1e-9 to 1e12 cd/m²."""
    physics = derive(Pixel(**CLEAN))
    exposure = Exposure(integration_s=TIME_S)
    frames = [captured(scene(np.ones((16, 16)), luminance), physics, exposure) for luminance in LUMINANCES_CD_PER_M2]
    expected = electrons(LUMINANCES_CD_PER_M2)
    got = [frame.mean_e[7, 7] for frame in frames]
    yield compare("mean electrons of a uniform field of 1e-9 … 1e12 cd/m²", expected, got, STORED, "L π sin²α A t QE λ/hc; float32")
    # Counts beyond the full well read the top code: E min(n, well) = Σ_{k<well} P(n > k) for Poisson counts.
    clipped = np.array([poisson.sf(np.arange(65_535), mean_e).sum() for mean_e in expected])
    spread = np.sqrt(np.minimum(expected, 65_535) / 256) + 1e-9
    name, source = "mean code of a uniform field, one code per electron", "Σ min(n, well) P(n) over Poisson counts"
    yield compare_drawn(name, clipped, [f.dn.mean() for f in frames], spread, source, ", each of 22")


def _automatic_exposure() -> Iterator[ExtremeCase]:
    physics = derive(Pixel(**CLEAN | {"full_well_e": 1000}))  # filled by 1e-9 cd/m² in 25 years
    exposure = Exposure(max_integration_s=1e9, well_target=0.95)
    frames = [captured(scene(np.ones((16, 16)), luminance), physics, exposure) for luminance in LUMINANCES_CD_PER_M2]
    source = "well_target; rounding of one product"
    full = [frame.mean_e.max() / 1000 for frame in frames]
    yield compare("automatic exposure: brightest pixel over full well, 1e-9 … 1e12 cd/m²", 0.95, full, ROUNDING, source)
    times = [frame.integration_s for frame in frames]
    expected = 0.95 * 1000 / electrons(LUMINANCES_CD_PER_M2, 1.0)
    source = "well_target · full well / electrons per second; float32"
    yield compare("automatic exposure: integration time", expected, times, STORED, source)
    exposure = Exposure(max_integration_s=0.1)
    capped = [captured(scene(np.ones((16, 16)), luminance), physics, exposure) for luminance in (0.0, 1e-9, 1.0)]
    times = [frame.integration_s for frame in capped]
    yield compare("automatic exposure: maximum integration time for dim or no light", 0.1, times, 0.0, "exactly max_integration_s")


def _contrast() -> Iterator[ExtremeCase]:
    """A bright and a dark half in one picture, 1e10 : 1."""
    halves = np.repeat([[1.0, 1e-10]], [8, 8], axis=1) * np.ones((16, 1))
    physics = derive(Pixel(**CLEAN | {"full_well_e": 1e15}))
    signal = captured(scene(halves, 1e12), physics, Exposure(integration_s=1.0)).mean_e
    got = [signal[:, :5].max(), signal[:, :5].min(), signal[:, 11:].max(), signal[:, 11:].min()]
    expected = electrons(np.array([1e12, 1e12, 1e2, 1e2]), 1.0)
    # The rounding of the quintic spline is 1e-16 of the bright half's charge, which is 1e-6 of the dark half's.
    source = "luminance of each half; 1e10 · rounding of the running sum"
    yield compare("1e10 : 1 in one picture: both halves, 3 pixels from the edge", expected, got, 3e-5, source)
    whole = derive(Pixel(**CLEAN | {"full_well_e": 1e15, "fill_factor": 1.0}))
    both = [captured(scene(halves, 1e12, blur), whole, Exposure(integration_s=1.0)).mean_e.sum() for blur in (False, True)]
    name = "1e10 : 1 with diffraction, FF 1: all electrons"
    yield compare(name, both[0], both[1], ROUNDING, "conservation: OTF(0) = 1; rounding of a transform")
    blurred = captured(scene(halves, 1e12, diffraction=True), physics, Exposure(integration_s=1.0)).mean_e
    yield compare("1e10 : 1 with diffraction: minimum electrons of a pixel", 0.0, min(blurred.min(), 0.0), 0.0, "not negative")
    # Averaged over its rings, the Airy pattern decays as λN/(π³ r³), so a bright strip at distances a to b gives
    # (2 λN/π³)(1/a - 1/b). Mirrored at the borders, the bright strips are 80 µm wide and repeat every 160 µm.
    n_w, at_um = CAMERA.f_number * (1 + CAMERA.magnification), 6 * PITCH_UM
    strips = [at_um + 160 * k for k in range(1000)] + [80 - at_um + 160 * k for k in range(1000)]
    tail = 2e-3 * GREEN_NM * n_w / math.pi**3 * sum(1 / near - 1 / (near + 80) for near in strips)
    got = blurred[:, 13:15].mean() / electrons(1e12, 1.0)
    source = "Airy tails of the bright strips and their mirror images; accurate to ring width over distance, 5 %"
    yield compare("1e10 : 1 with diffraction: light 6 pixels inside the dark half", tail, got, 0.1, source)


def _darkness() -> Iterator[ExtremeCase]:
    black = captured(scene(np.zeros((16, 16)), 1.0), derive(Pixel(**CLEAN | {"black_level_dn": 7})), Exposure())
    yield compare("total darkness, no noise: every code", 7.0, black.dn, 0.0, "exactly the black level")
    physics = derive(Pixel(**CLEAN | {"read_noise_e": 40.0, "black_level_dn": 1000, "full_well_e": 64_535}))
    sensor = sensors.sample_sensor(physics, (400, 500), np.random.default_rng(3))
    dn = sensors.read_out(np.zeros(sensor.shape), TIME_S, sensor, np.random.default_rng(4))
    codes = np.arange(2**16)
    edges = norm.cdf((codes[:, None] + [-0.5, 0.5] - 1000) / 40)
    share = np.diff(edges, axis=1)[:, 0]
    mean = float((share * codes).sum())
    variance = float((share * (codes - mean) ** 2).sum())
    name, source = "total darkness, read noise 40 e-: {}", "exact sum over codes of a rounded normal, σ² + 1/12"
    yield compare_drawn(name.format("mean"), mean, dn.mean(), math.sqrt(variance / dn.size), source)
    yield compare_drawn(name.format("variance"), variance, dn.var(), variance * math.sqrt(2 / dn.size), source)


def _saturation() -> Iterator[ExtremeCase]:
    for bits in (1, 8, 24):
        frame = captured(scene(np.ones((16, 16)), 1e12), derive(Pixel(**CLEAN | {"bits": bits})), Exposure(integration_s=10.0))
        yield compare(f"everything saturated, {bits} bits: every code", 2**bits - 1, frame.dn, 0.0, "exactly the top code")
    yield compare("everything saturated: fraction of saturated pixels", 1.0, frame.saturated_fraction, 0.0, "all pixels")
