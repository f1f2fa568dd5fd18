"""Extreme viewing: 0.5 to 2000 samples per degree, light from zero to 1e12 times white, tiny pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.verification.stability import ExtremeCase, compare, flat
from pixsim.viewer.scielab import CIE_LAB, Filters, delta_e, delta_e_map, filtered_grey_lab, filtered_lab, xyz_to_lab

WHITE = np.array([95.047, 100.0, 108.883])
DENSITIES = (0.5, 1.0, 23.0, 111.0, 224.0, 500.0, 2000.0)  # samples per degree
SHAPES = ((1, 1), (1, 2), (2, 1), (1, 9), (3, 5), (33, 20))  # smaller than the widest Gaussian, 4.3°
VIEWS = "0.5 to 2000 samples/deg, 1×1 to 33×20 samples"
BOTH: tuple[Filters, ...] = ("published", "zhang1996")
# S-CIELAB of Zhang & Wandell (1997), independent of pixsim's table: (weight, spread in degrees).
GAUSSIANS = (
    ((0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)),
    ((0.531, 0.0392), (0.330, 0.494)),
    ((0.488, 0.0536), (0.371, 0.386)),
)
OPPONENT = np.array([[0.2787336, 0.7218031, -0.1065520], [-0.4487736, 0.2898056, 0.0771569], [0.0859513, -0.5899859, 0.5011089]])
THRESHOLD, SLOPE = (6 / 29) ** 3, (29 / 3) ** 3  # CIE 15: of Y/Yn; L* per Y/Yn below it
# Rounding of transforms of values near 1 times the slope of Lab, up to 903 in L* and 500·7.8 in a*: 1e-15 · 4e3 · 10.
LAB_ROUNDED = 1e-10


def cases() -> Iterator[ExtremeCase]:
    pictures = [np.random.default_rng(number).uniform(0.02, 1.2, (*shape, 3)) * WHITE for number, shape in enumerate(SHAPES)]
    yield from _views(pictures)
    yield from _amounts(pictures)
    yield from _threshold()


def compare_lab(name: str, expected: ArrayLike, got: ArrayLike, source: str) -> ExtremeCase:
    """`compare` in ΔE, with a limit for rounding."""
    return compare(name, expected, got, LAB_ROUNDED, f"{source}; ΔE, rounding", scale=1.0)


def lab_of(relative: Array) -> Array:
    """CIELAB of X/Xn, Y/Yn, Z/Zn by the two branches of CIE 15."""
    f = [[t ** (1 / 3) if t > THRESHOLD else (SLOPE * t + 16) / 116 for t in one] for one in relative.reshape(-1, 3).tolist()]
    lab = np.array([(116 * y - 16, 500 * (x - y), 200 * (y - z)) for x, y, z in f])
    return lab.reshape(relative.shape)


def view(samples_per_deg: float, filters: Filters = "published", unit: float = 1.0) -> dict[str, Any]:
    return {"white_xyz": WHITE * unit, "samples_per_deg": samples_per_deg, "filters": filters}


def _views(pictures: list[Array]) -> Iterator[ExtremeCase]:
    colours = np.array([[1.0, 1.0, 1.0], [0.3, 0.2, 0.9], [1e-3, 2e-3, 1e-4], [0.0, 0.0, 0.0]])
    even = [np.broadcast_to(colour * WHITE, (*shape, 3)) for colour in colours for shape in SHAPES]
    expected = [np.broadcast_to(lab_of(colour), (*shape, 3)) for colour in colours for shape in SHAPES] * len(DENSITIES)
    seen = [filtered_lab(picture, **view(density)) for density in DENSITIES for picture in even]
    source = "CIE 15: blur does not change a uniform picture"
    yield compare_lab(f"CIELAB of uniform pictures, {VIEWS}", flat(expected), flat(seen), source)
    gratings = [(density, order) for density in DENSITIES for order in (1, 5, 15)]
    expected = [lab_of(_blurred_grating(*grating)) for grating in gratings]
    seen = [filtered_lab(_grating(order)[None] * WHITE, **view(density)) for density, order in gratings]
    source = "Σ w exp(-π² s² f²)/Σ w of each opponent channel, closed form"
    yield compare_lab("CIELAB of coloured gratings, 0.5 to 2000 samples/deg", flat(expected), flat(seen), source)
    for filters in BOTH:
        whole, part = [], []
        for density in DENSITIES:
            for picture in pictures:
                mirrored = np.concatenate([picture, picture[:, ::-1]], axis=1)
                mirrored = np.concatenate([mirrored, mirrored[::-1]], axis=0)
                part.append(filtered_lab(picture, **view(density, filters)))
                whole.append(filtered_lab(mirrored, **view(density, filters))[: picture.shape[0], : picture.shape[1]])
        name = f"pictures smaller than the eye's blur, filters '{filters}', {VIEWS}"
        source = "symmetry: adding the mirror images to a picture changes nothing"
        yield compare_lab(name, flat(whole), flat(part), source)
    far = [filtered_lab(picture, **view(1e9)).reshape(-1, 3) for picture in pictures]
    mean = [np.broadcast_to(lab_of(p.mean(axis=(0, 1)) / WHITE), lab.shape) for p, lab in zip(pictures, far, strict=True)]
    yield compare("pictures at 1e9 samples/deg", flat(mean), flat(far), LAB_ROUNDED, "their mean", 1.0)


def _grating(order: int, samples: int = 16) -> Array:
    """X/Xn, Y/Yn, Z/Zn (samples, 3) of a grating in all three opponent channels."""
    wave = np.cos(np.pi * order * (np.arange(samples) + 0.5) / samples)
    return 0.5 + wave[:, None] * np.array([0.3, 0.1, -0.2])


def _blurred_grating(samples_per_deg: float, order: int, samples: int = 16) -> Array:
    frequency_cy_per_deg = order / (2 * samples) * samples_per_deg
    gain = [
        sum(w * math.exp(-((math.pi * s * frequency_cy_per_deg) ** 2)) for w, s in channel) / sum(w for w, _ in channel)
        for channel in GAUSSIANS
    ]
    filtered = np.linalg.inv(OPPONENT) @ np.diag(gain) @ OPPONENT
    even = 0.5 * WHITE
    return (even + (_grating(order, samples) * WHITE - even) @ filtered.T) / WHITE


def _amounts(pictures: list[Array]) -> Iterator[ExtremeCase]:
    scaled = [picture * k for picture in pictures for k in (0, -1, 1e-12, 1e12)]
    same = [delta_e_map(picture, picture, **view(23.0, filters)) for filters in BOTH for picture in scaled]
    yield compare("ΔE of a picture with itself: black, negative, 1e-12 and 1e12 times white", 0.0, flat(same), 0.0, "exactly 0")
    black = [filtered_lab(np.zeros((*shape, 3)), **view(density)) for shape in SHAPES for density in DENSITIES]
    yield compare(f"CIELAB of black, XYZ = 0, {VIEWS}", 0.0, flat(black), 0.0, "exactly 0")
    pairs = list(zip(pictures, [pair[::-1, ::-1] * 0.9 for pair in pictures], strict=True))
    plain = [delta_e_map(*pair, **view(23.0)) for pair in pairs]
    for name, units, allowed in (
        ("1e-12 and 1e12", (1e-12, 1e12), LAB_ROUNDED),
        ("2^-1000 and 2^1000", (2.0**-1000, 2.0**1000), 0.0),
    ):
        scaled = [delta_e_map(a * unit, b * unit, **view(23.0, unit=unit)) for unit in units for a, b in pairs]
        source = "independent of the unit of XYZ" + ("; rounding of the images" if allowed else ", bit for bit")
        yield compare(f"ΔE of images and white times {name}", np.tile(flat(plain), 2), flat(scaled), allowed, source, 1.0)
    faint = np.array([1e-150, 1e-12, 1e-6, 1e-3])
    got = [delta_e_map(np.zeros((4, 4, 3)), np.full((4, 4, 3), k) * WHITE, **view(23.0)) for k in faint]
    yield compare("ΔE of black and grey of 1e-150 to 1e-3 of white", SLOPE * faint[:, None, None], got, 1e-12, "(29/3)³ Y/Yn")
    glare = np.array([1e3, 1e12, 1e100])
    got = [filtered_lab(np.full((4, 4, 3), k) * WHITE, **view(23.0))[..., 0] for k in glare]
    lightness = 116 * np.cbrt(glare)[:, None, None] - 16
    yield compare("L* of grey of 1e3 to 1e100 times white", lightness, got, 1e-13, "116 ∛(Y/Yn) - 16")
    noise = np.random.default_rng(9).uniform(-THRESHOLD / 2, THRESHOLD / 2, (24, 24, 3)) * WHITE
    name = "CIELAB of noise around black, negative XYZ included"
    source = "symmetry: CIELAB is linear through zero, without clipping"
    yield compare_lab(name, -filtered_lab(noise, **view(23.0)), filtered_lab(-noise, **view(23.0)), source)
    grey = [picture[..., 1] / 100 for picture in pictures]
    three = flat(filtered_lab(picture[..., None] * WHITE, **view(density)) for density in DENSITIES for picture in grey)
    one = flat(filtered_grey_lab(picture, **view(density)) for density in DENSITIES for picture in grey)
    yield compare_lab(f"grey pictures by one transform and by three, {VIEWS}", three, one, "identical pictures")


def _threshold() -> Iterator[ExtremeCase]:
    """f(t) and its slope at the threshold between the cube root and the straight line."""
    threshold = CIE_LAB[0]
    neighbours = np.array([np.nextafter(threshold, 0), threshold, np.nextafter(threshold, 1)])
    lightness = xyz_to_lab(neighbours[:, None] * WHITE, WHITE)[:, 0]
    name = "L* on either side of CIELAB's threshold, Y/Yn = 216/24389"
    yield compare(name, 8.0, lightness, 1e-14, "116 · 6/29 - 16 = 8, without a step")
    around = threshold * (1 + np.array([-0.5, -1e-2, -1e-4, -1e-8, 1e-8, 1e-4, 1e-2, 0.5]))[:, None] * np.array([1.0, 1.05, 0.95])
    got, source = xyz_to_lab(around * WHITE, WHITE), "CIE 15 by its two branches; ΔE"
    yield compare("CIELAB from 0.5 to 1.5 of its threshold", lab_of(around), got, 1e-12, source, scale=1.0)
    step = 1e-6 * threshold
    near = threshold + step * np.array([-1.0, 0.0, 1.0])
    slope = np.diff(xyz_to_lab(near[:, None] * WHITE, WHITE)[:, 0]) / step
    source = "(29/3)³ without a kink; curvature of the cube root, 3e-7"
    yield compare("slope of L* on either side of CIELAB's threshold", SLOPE, slope, 1e-5, source)
    below, above = (filtered_lab(np.full((3, 3, 3), threshold * t) * WHITE, **view(23.0)) for t in (1 - 1e-9, 1 + 1e-9))
    name = "ΔE of two greys across CIELAB's threshold, 2e-9 of it apart"
    source = "slope times distance; rounding of L* = 8, 1e-15, over 1.6e-8"
    yield compare(name, SLOPE * threshold * 2e-9, delta_e(below, above), 1e-5, source)
