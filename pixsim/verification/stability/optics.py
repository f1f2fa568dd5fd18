"""Extreme lenses: f/0.5 to f/1000, fields up to 80°, and cut-off frequencies far outside the range of the grid."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal, localcontext
from functools import cache

import numpy as np

from pixsim.base.arrays import Array
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffract, diffraction_otf
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.verification.stability import ExtremeCase, compare, flat

F_NUMBERS = (0.5, 0.7, 1.0, 1.4, 4.0, 22.0, 180.0, 1000.0)
FIELDS_DEG = (0.0, 1e-6, 0.1, 5.0, 20.0, 45.0, 60.0, 75.0, 80.0)
MAGNIFICATIONS = (0.0, -1e-9, -0.01, -0.5, -1.0, -2.0)
SWEEP = "f/0.5 to f/1000, 0 to 80°, magnification 0 to -2"
DIGITS = 50
SHAPES = ((1, 1), (1, 2), (1, 33), (7, 1), (24, 40))
PITCH_UM = 1.0
NM = np.array([360.0, 550.0, 830.0])
SHARES = np.array([0.2, 0.5, 0.3])
ROUNDED = 4e-15  # at most 20 roundings of 1.1e-16 in a well-conditioned formula
TRANSFORMED = 1e-14  # rounding of a cosine transform and its inverse, relative to the brightest sample
TABLE = 1e-7  # three times the error 3e-8 of linear interpolation in the OTF table of pixsim.optics


def cases() -> Iterator[ExtremeCase]:
    yield from _irradiance()
    yield from _otf()
    yield from _pictures()


def _irradiance() -> Iterator[ExtremeCase]:
    n, field, m = (grid.ravel() for grid in np.meshgrid(F_NUMBERS, np.tan(np.radians(FIELDS_DEG)), MAGNIFICATIONS))
    got = irradiance_factor(n, field, m)
    lens = 0.5 / (n * (1 + np.abs(m)))
    integral = [solid_angle_integral(*arguments) for arguments in zip(lens, field, strict=True)]
    yield compare(f"E/L of a lens, {SWEEP}", integral, got, 1e-13, "∫ cos θ₁ cos θ₂/r² over the lens, by quadrature (1e-14)")
    digits = [foote_in_digits(*arguments) for arguments in zip(n, field, m, strict=True)]
    yield compare(f"E/L of a lens in {DIGITS} digits, {SWEEP}", digits, got, ROUNDED, f"Foote 1915 in {DIGITS} digits; rounding")
    on_axis = np.pi / (1 + 4 * (n * (1 + np.abs(m))) ** 2)
    source = "π sin²α; rounding"
    yield compare("E/L on the axis, f/0.5 to f/1000, magnification 0 to -2", on_axis, irradiance_factor(n, 0.0, m), ROUNDED, source)
    slow = np.array([1e5, 1e9, 1e50, 1e150])[:, None]
    angles = np.radians(FIELDS_DEG)
    limit = np.pi * np.cos(angles) ** 4 / (4 * slow * slow)
    source = "π cos⁴θ/4N²; the next term is 1/4N² = 2.5e-11 of it"
    yield compare("E/L of slow lenses, f/1e5 to f/1e150, 0 to 80°", limit, irradiance_factor(slow, np.tan(angles)), 1e-10, source)
    lens = np.array([1.0, 0.5, 1e-2, 5e-4])
    powers = [power_on_the_plane(0.5 / diameter) for diameter in lens]
    source = "conservation: the flux from the lens, πL · its area, reaches the plane; quadrature 1e-14"
    yield compare("flux from a lens on the whole plane behind it, f/0.5 to f/1000", np.pi * lens**2, powers, 1e-13, source)


@cache
def gauss(count: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss-Legendre quadrature on [0, 1]."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, weight / 2


def solid_angle_integral(tan_alpha: float, tan_field: float) -> float:
    """∫ cos θ₁ cos θ₂/r² over a disc of radius tan α at distance 1, seen tan θ off its axis."""
    share, weight = gauss(60)  # the trapezoidal rule in angle converges exponentially for periodic functions
    radius = tan_alpha * share
    angle = 2 * np.pi * np.arange(128) / 128
    distance2 = 1 + radius[:, None] ** 2 + tan_field**2 - 2 * radius[:, None] * tan_field * np.cos(angle)
    return float((tan_alpha * weight * radius * (1 / distance2**2).mean(axis=1)).sum() * 2 * np.pi)


def foote_in_digits(f_number: float, tan_field: float, magnification: float) -> float:
    """Foote's formula as published, in 50 digits, of which it loses 16 at f/1000 off the axis."""
    with localcontext() as context:
        context.prec = DIGITS
        a = (1 / (2 * Decimal(f_number) * (1 + abs(Decimal(magnification))))) ** 2
        t = Decimal(tan_field) ** 2
        root = (t * t + 2 * t * (1 - a) + (1 + a) ** 2).sqrt()
        pi = Decimal("3.14159265358979323846264338327950288419716939937511")
        return float(pi / 2 * (1 - (1 + t - a) / root))


def power_on_the_plane(f_number: float) -> float:
    """∫ E/L over the plane at distance 1, over π: ∫ E/L dT with T = tan²θ = s/(1-s)."""
    s, weight = gauss(200)
    return float((weight * irradiance_factor(f_number, np.sqrt(s / (1 - s))) / (1 - s) ** 2).sum())


def _otf() -> Iterator[ExtremeCase]:
    nm, steps = np.array([360.0, 555.0, 830.0]), np.array([[1.0], [1 + 1e-15], [2.0], [1e200]])
    beyond = [diffraction_otf(steps * cutoff_cy_per_mm(nm, n), nm, n) for n in (0.5, 4.0, 1000.0, 1e100)]
    yield compare("OTF at the cut-off and up to 1e200 times it, f/0.5 to f/1e100", 0.0, beyond, 0.0, "exactly 0")
    extremes = (1e-30, 1e-20, 0.5, 1e300, 1e308, np.inf)
    name = "OTF of a uniform field, cut-off from 1.8e33 cy/mm to 0"
    yield compare(name, 1.0, [diffraction_otf(0.0, 550.0, f_number) for f_number in extremes], 0.0, "exactly 1 at frequency 0")
    below = np.concatenate([np.geomspace(1e-16, 0.5, 60), 1 - np.geomspace(1e-300, 0.5, 60)])
    x = 1 - below
    overlap, otf = [pupil_overlap(gap) for gap in 1 - x], diffraction_otf(x, 1e6, 1.0)  # a cut-off of 1 cy/mm
    source = "overlap of two pupils by quadrature; rounding of terms near 1"
    yield compare("OTF from 0 to just below the cut-off", overlap, otf, ROUNDED, source, scale=1.0)


def pupil_overlap(gap: float) -> float:
    """Overlap of two unit discs over π: (4/π) ∫ √(1-u²) du from 1 - gap to 1, with u = 1 - gap s²."""
    s, weight = gauss(60)
    return float(4 / np.pi * 2 * gap**1.5 * (weight * s**2 * np.sqrt(2 - gap * s**2)).sum())


def _pictures() -> Iterator[ExtremeCase]:
    pictures = [np.random.default_rng(number).uniform(0, 2, shape) for number, shape in enumerate(SHAPES)]

    def blurred(f_number: float) -> list[Array]:
        return [diffract(picture, PITCH_UM, NM, SHARES, f_number) for picture in pictures]

    every = [0.5, 4.0, 1e3, 1e6, 1e300, np.inf]
    means, got = [picture.mean() for picture in pictures], [picture.mean() for n in every for picture in blurred(n)]
    name, source = "mean of pictures of 1×1 to 24×40 samples behind f/0.5 to a pinhole", "conservation of energy"
    yield compare(name, np.tile(means, len(every)), got, TRANSFORMED, f"{source}; rounding of the transform")
    even = np.tile(flat([np.full(picture.shape, picture.mean()) for picture in pictures]), 4)
    seen = flat([picture for n in (1e6, 1e100, 1e306, np.inf) for picture in blurred(n)])
    name, source = "pictures of which the lens passes only the mean, f/1e6 to a pinhole", "cut-off below the lowest frequency"
    yield compare(name, even, seen, TRANSFORMED, f"{source}; rounding of the transform")
    seen = flat([picture for n in (1e-12, 1e-20, 1e-30) for picture in blurred(n)])
    name, source = "pictures with a cut-off far above the grid, 1e15 to 1e33 cy/mm", "unchanged: the OTF is 1 - 4f/(π cut-off)"
    allowed = TRANSFORMED + 4 / np.pi * 1e3 / 1e15
    yield compare(name, np.tile(flat(pictures), 3), seen, allowed, f"{source}, f up to 1e3 cy/mm", scale=2.0)
    orders = range(1, 32, 3)
    wave = np.cos(np.pi * np.array(orders)[:, None] * (np.arange(32) + 0.5) / 32)
    at_cutoff = [_wave_behind(row, k, share) for share in (1.0, 0.5) for k, row in zip(orders, wave, strict=True)]
    otf = np.repeat([0.0, 2 / 3 - np.sqrt(3) / (2 * np.pi)], len(orders))
    source = "0 and 2/3 - √3/2π; interpolation in the OTF table"
    yield compare("contrast of a grating at the cut-off and at half of it", otf, at_cutoff, TABLE, source, scale=1.0)


def _wave_behind(wave: Array, order: int, share: float) -> float:
    """Contrast transfer of a grating of a given order, with a lens whose cut-off is frequency/share."""
    frequency_cy_per_mm = order / (2 * wave.size * PITCH_UM * 1e-3)
    f_number = share * 1e6 / (550.0 * frequency_cy_per_mm)
    left = diffract(wave[None, :], PITCH_UM, np.array([550.0]), np.ones(1), f_number)[0]
    return float((left * wave).sum() / (wave * wave).sum())
