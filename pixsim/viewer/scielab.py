"""S-CIELAB: the colour difference that a viewer at a given distance sees between two pictures.

XYZ -> three opponent channels -> the eye's blur of each -> XYZ -> CIELAB -> a difference per
sample.

A kernel even in x and y is diagonal in the DCT-II, whose basis extends the image by reflection at
its edges (half a sample outside the outermost centres). Each filter is thus one product with its
transfer function: exact, without padding. An image smaller than the kernel is reflected repeatedly.

[ZW] X. Zhang & B. A. Wandell, "A spatial extension of CIELAB for digital color-image reproduction",
    J. SID 5 (1997) 61.
[1996] the authors' first public code, SCIELAB-1996; what it computes, not its text
    (tests/data/scielab/README.md).
[CIE] CIE 15:2004, Colorimetry, 8.2.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy.fft

from pixsim.base.arrays import (
    STRIP_DOTS,
    Finites,
    Positives,
    dct,
    empty_planes,
    inverse_dct,
    strips,
    strips_of,
)
from pixsim.base.bounds import Positive
from pixsim.base.errors import invalid
from pixsim.light.standard import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT

# The public interface, as docs/reference lists it.
__all__ = [
    "colour_delta_e_map",
    "delta_e",
    "delta_e_map",
    "filtered_grey_lab",
    "filtered_lab",
    "grey_delta_e_map",
    "xyz_to_lab",
]

Floats = npt.NDArray[np.float64]
Planes = npt.NDArray[Any]  # float64, or float32 with `single`
# Largest error of a mean ΔE with `single`. Measured: 1e-4 for bars of black and white, 3e-5 for
# other pictures; 3e-3 for a dot that shows the same code.
SINGLE_DELTA_E = 1e-3


_MAX_EXPONENT = 1000  # of a power of two in float64, and of its reciprocal


def _checked_triples(
    name: str, values: npt.ArrayLike, dimensions: int | None = None, single: bool = False
) -> Planes:
    array = np.asarray(values)
    array = array if single and array.dtype == np.float32 else array.astype(np.float64, copy=False)
    if array.ndim != (dimensions or max(array.ndim, 1)) or array.shape[-1] != 3 or array.size == 0:
        allowed = "(H, W, 3), not empty" if dimensions else "(..., 3), not empty"
        raise invalid(
            f"{name}, shape",
            array.shape,
            allowed,
            "Put the three values in the last axis, after y and x.",
        )
    return array


def _checked_pair(dimensions: int | None = None, **arrays: npt.ArrayLike) -> tuple[Floats, Floats]:
    first, second = (_checked_triples(name, values, dimensions) for name, values in arrays.items())
    if first.shape != second.shape:
        shapes = f"shapes {first.shape} and {second.shape}"
        raise invalid(
            " and ".join(arrays),
            shapes,
            "equal shapes",
            "Resample one image to the raster of the other.",
        )
    return first, second


def checked_white(white_xyz: npt.ArrayLike) -> Floats:
    white = np.asarray(white_xyz, np.float64)
    if white.shape != (3,):
        hint = (
            "Give X, Y, Z in the image's unit; D65 is (95.047, 100, 108.883) times its luminance"
            " over 100."
        )
        raise invalid("white_xyz", white.tolist(), "three numbers above 0", hint)
    return white


Filters = Literal["published", "zhang1996"]
# (weight, spread in degrees) of each Gaussian exp(-r^2 / spread^2), a row per opponent channel:
# [ZW].
_PUBLISHED_GAUSSIANS = (
    ((0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)),
    ((0.531, 0.0392), (0.330, 0.494)),
    ((0.488, 0.0536), (0.371, 0.386)),
)
# (weight, full width at half maximum in degrees): [1996].
ZHANG1996_GAUSSIANS = (
    ((1.00327, 0.05), (0.114416, 0.225), (-0.117686, 7.0)),
    ((0.616725, 0.0685), (0.383275, 0.826)),
    ((0.567885, 0.092), (0.432115, 0.6451)),
)
_ZHANG1996_BUILD_SAMPLES_PER_DEG = 224  # [1996] builds its kernels at this density or more
# Kernels of [1996] are a degree long: outside this range they are one sample, or fill the memory.
_ZHANG1996_SAMPLES_PER_DEG = (1e-6, 1e6)


@dataclass(frozen=True)
class ViewingConditions:
    """A viewer's white, distance and filters, checked.

    white : XYZ divided by the power of two that brings Y to 0.5 … 1
    exponent : of that power. A power of two rounds nothing, and sums over an image neither overflow
        nor vanish in any unit.
    """

    white: tuple[float, float, float]
    exponent: int
    samples_per_deg: float
    filters: Filters

    @classmethod
    def of(
        cls, white_xyz: npt.ArrayLike, samples_per_deg: float, filters: Filters
    ) -> ViewingConditions:
        white = checked_white(white_xyz)
        low, high = _ZHANG1996_SAMPLES_PER_DEG
        if filters == "zhang1996" and not low <= samples_per_deg <= high:
            allowed = f"{low:g} to {high:g} for 'zhang1996'"
            raise invalid(
                "samples_per_deg", repr(samples_per_deg), allowed, "Or choose 'published'."
            )
        exponent = math.frexp(white[1])[1]
        x, y, z = np.ldexp(white, -exponent).tolist()
        return cls((x, y, z), exponent, float(samples_per_deg), filters)

    @property
    def constants(self) -> tuple[float, float, float]:
        """The constants of CIELAB that belong to the filters."""
        return CIE_LAB if self.filters == "published" else ZHANG1996_LAB

    @property
    def relative_from_opponent(self) -> Floats:
        """X/Xn, Y/Yn and Z/Zn from the opponent channels, (3, 3)."""
        return XYZ_FROM_OPPONENT / np.array(self.white)[:, np.newaxis]


@lru_cache(maxsize=1)  # as large as a picture
def filter_transfer(
    view: ViewingConditions, height: int, width: int, grey: bool = False, single: bool = False
) -> Planes:
    """Return the factor of each DCT-II coefficient in each opponent channel, (3, height, width),
    read-only since it is cached.

    grey : return instead the factors from relative luminance to the filtered X/Xn, Y/Yn and Z/Zn
    single : in float32
    """
    terms = _published_terms if view.filters == "published" else _zhang1996_terms
    factors = np.zeros((3, height, width))
    for channel, plane in enumerate(factors):
        along_y = terms(channel, height, view.samples_per_deg)
        along_x = terms(channel, width, view.samples_per_deg)
        for (weight, fy), (_, fx) in zip(along_y, along_x, strict=True):
            plane += (weight * fy)[:, np.newaxis] * fx
    if grey:
        opponent = (OPPONENT_FROM_XYZ * view.white).sum(axis=1)
        for rows, strip in strips_of(factors.shape):
            np.copyto(strip, factors[:, rows])
            _apply_matrix(view.relative_from_opponent * opponent, strip, factors[:, rows])
    rounded = factors.astype(_precision(single), copy=False)
    rounded.flags.writeable = False
    return rounded


def _precision(single: bool) -> type[np.floating[Any]]:
    return np.float32 if single else np.float64


def _published_terms(
    channel: int, samples: int, samples_per_deg: float
) -> list[tuple[float, Floats]]:
    """Return (weight, transfer function (samples,)) of each Gaussian along an axis: exp(-π²s²f²), f
    in cy/deg, for exp(-x²/s²).
    """
    frequency_cy_per_deg = np.arange(samples) / (2 * samples) * samples_per_deg
    gaussians = _PUBLISHED_GAUSSIANS[channel]
    gain = sum(weight for weight, _ in gaussians)
    # exp(-infinity) = 0: from so far away only the mean is visible.
    with np.errstate(over="ignore"):
        return [
            (weight / gain, np.exp(-((np.pi * s_deg * frequency_cy_per_deg) ** 2)))
            for weight, s_deg in gaussians
        ]


def _zhang1996_terms(
    channel: int, samples: int, samples_per_deg: float
) -> list[tuple[float, Floats]]:
    """Return the same for [1996]. An even kernel, wrapped at the reflected image's period of
    2·samples, has a real spectrum.
    """
    position = _centred_positions(samples_per_deg).astype(int) % (2 * samples)
    kernels = [
        (weight, zhang1996_kernel(w_deg, samples_per_deg))
        for weight, w_deg in ZHANG1996_GAUSSIANS[channel]
    ]
    wrapped = [(weight, np.bincount(position, kernel, 2 * samples)) for weight, kernel in kernels]
    return [(weight, scipy.fft.rfft(kernel).real[:samples]) for weight, kernel in wrapped]


def zhang1996_kernel(width_deg: float, samples_per_deg: float) -> Floats:
    """Return one Gaussian of [1996], one degree long. Its sum is 1 before, but not after thinning
    to the image's density.
    """
    upsampling = max(1, math.ceil(_ZHANG1996_BUILD_SAMPLES_PER_DEG / samples_per_deg))
    position = _centred_positions(samples_per_deg * upsampling)
    alpha = 2 * math.sqrt(math.log(2)) / (width_deg * samples_per_deg * upsampling - 1)
    dense = np.exp(-((alpha * position) ** 2))
    dense /= dense.sum()
    if upsampling == 1:
        return dense
    centre = _centred_positions(samples_per_deg) * upsampling
    triangle = np.maximum(0, 1 - np.abs(position - centre[:, np.newaxis]) / upsampling)
    return np.asarray((triangle * dense).sum(axis=1))


def _centred_positions(samples_per_deg: float) -> Floats:
    # A kernel has 2⌈samples_per_deg / 2⌉ - 1 samples.
    half_width = math.ceil(samples_per_deg / 2) - 1
    return np.arange(-half_width, half_width + 1.0)


Formula = Literal["1976", "1994", "2000"]
Lab = tuple[Planes, Planes, Planes]  # L*, a*, b*, each (…)
Strips = Iterator[tuple[slice, Lab]]  # rows, and planes (rows, W)
# CIELAB's f(t) is the cube root above a threshold, and slope t + 16/116 up to it, where L* is
# dark_slope Y/Yn.
CIE_LAB = (216 / 24389, 841 / 108, 24389 / 27)  # [CIE]: (6/29)^3, (29/6)^2 / 3, (29/3)^3
ZHANG1996_LAB = (0.008856, 7.787, 903.3)  # [1996]


def delta_e_map(
    reference_xyz: Finites,
    test_xyz: Finites,
    *,
    white_xyz: Positives,
    samples_per_deg: Positive,
    filters: Filters = "published",
    formula: Formula = "1976",
) -> Floats:
    """Return the S-CIELAB difference between a test image and its reference, (H, W), in units of
    ΔE. [ZW]

    Scaling both images and the white by one number changes nothing. XYZ slightly below zero, as
    noise leaves it, is not clipped: CIELAB's linear branch continues through zero without a step.

    reference_xyz, test_xyz : (H, W, 3) CIE XYZ in any unit, the same for both and for the white
    white_xyz : (3,) XYZ of the white that the viewer is adapted to
    samples_per_deg : image samples per degree of visual angle
    filters : as in `filtered_lab`
    formula : as in `delta_e`

    Raises PixsimError (a ValueError) for invalid shapes, values or names.

    >>> white = np.array([95.047, 100.0, 108.883])
    >>> light = np.ones((8, 8, 1)) * white  # uniform pictures keep their CIELAB
    >>> delta_e = delta_e_map(light, 0.5 * light, white_xyz=white, samples_per_deg=23)
    >>> round(float(delta_e.mean()), 6), round(116 * (1 - 0.5 ** (1 / 3)), 6)
    (23.930739, 23.930739)
    """
    reference, test = _checked_pair(dimensions=3, reference_xyz=reference_xyz, test_xyz=test_xyz)
    lab = partial(
        filtered_lab, white_xyz=white_xyz, samples_per_deg=samples_per_deg, filters=filters
    )
    return delta_e(lab(reference), lab(test), formula)


def filtered_lab(
    xyz: Finites,
    *,
    white_xyz: Positives,
    samples_per_deg: Positive,
    filters: Filters = "published",
    single: bool = False,
) -> Planes:
    """Return the CIELAB of an image blurred by the eye's filters, (H, W, 3), for comparison with
    many others. [ZW]

    XYZ below zero (noise, the filters' negative lobe) continues CIELAB's linear branch, so L* may
    be negative: clipping before the eye's blur would brighten noise around black on average.

    xyz : (H, W, 3)
    white_xyz : (3,), in the same unit
    samples_per_deg : image samples per degree of visual angle
    filters : "published" is [ZW] in the frequency domain, with unit gain at zero, so that a uniform
        image keeps its CIELAB; "zhang1996" is [1996], with sampled kernels and rounded Lab
        constants, up to 2 % off at 20 samples/deg
    single : compute in float32, and return it, in less than half of the time; a mean ΔE changes by
        less than `SINGLE_DELTA_E`

    Raises PixsimError (a ValueError) for invalid shapes, values or names.
    """
    view = ViewingConditions.of(white_xyz, samples_per_deg, filters)
    spectrum = _opponent_spectrum(
        _checked_triples("xyz", xyz, dimensions=3, single=single), view, single
    )
    return _assemble_strips(_iter_lab_strips(spectrum, view), spectrum)


def filtered_grey_lab(
    luminance: Finites,
    *,
    white_xyz: Positives,
    samples_per_deg: Positive,
    filters: Filters = "published",
    single: bool = False,
) -> Planes:
    """Return `filtered_lab` of a grey image, luminance (H, W) times `white_xyz`, 1 for white: (H,
    W, 3). [ZW]

    Its opponent channels are multiples of one picture, so one forward transform serves all three.
    Each is blurred differently, so grey gains chroma. The transfer functions include the conversion
    to X/Xn, Y/Yn and Z/Zn. `filtered_lab` describes `filters` and `single`.

    Raises PixsimError (a ValueError) for invalid shapes, values or names.
    """
    view = ViewingConditions.of(white_xyz, samples_per_deg, filters)
    spectrum = _grey_spectrum(luminance, view, single)
    return _assemble_strips(_iter_lab_strips(spectrum, view, grey=True), spectrum)


def grey_delta_e_map(
    reference_lab: Finites,
    luminance: Finites,
    *,
    white_xyz: Positives,
    samples_per_deg: Positive,
    filters: Filters = "published",
    single: bool = False,
) -> Floats:
    """Return `delta_e` (1976) between a filtered reference and `filtered_grey_lab` of a luminance,
    (H, W). [ZW]

    Faster than the two steps, since the CIELAB image of the second is never stored.

    reference_lab : (H, W, 3)
    luminance : (H, W) relative, 1 for white
    white_xyz, samples_per_deg, filters, single : as in `filtered_lab`

    Raises PixsimError (a ValueError) for invalid shapes, values or names.
    """
    view = ViewingConditions.of(white_xyz, samples_per_deg, filters)
    spectrum = _grey_spectrum(luminance, view, single)
    return _differences(reference_lab, _iter_lab_strips(spectrum, view, grey=True), spectrum)


def colour_delta_e_map(
    reference_lab: Finites,
    xyz: Finites,
    *,
    white_xyz: Positives,
    samples_per_deg: Positive,
    filters: Filters = "published",
    single: bool = False,
) -> Floats:
    """Return `delta_e` (1976) between a filtered reference and `filtered_lab` of an image, (H, W),
    as `grey_delta_e_map`. [ZW]

    reference_lab : (H, W, 3)
    xyz : (H, W, 3), in the unit of the white
    white_xyz, samples_per_deg, filters, single : as in `filtered_lab`

    Raises PixsimError (a ValueError) for invalid shapes, values or names.
    """
    view = ViewingConditions.of(white_xyz, samples_per_deg, filters)
    spectrum = _opponent_spectrum(
        _checked_triples("xyz", xyz, dimensions=3, single=single), view, single
    )
    return _differences(reference_lab, _iter_lab_strips(spectrum, view), spectrum)


def _differences(reference_lab: Finites, lab_strips: Strips, spectrum: Planes) -> Floats:
    """Return the distances (H, W) of a reference (H, W, 3) from strips of CIELAB, in the precision
    of `spectrum` (3, H, W).
    """
    reference = np.asarray(reference_lab, spectrum.dtype)
    shape = (*spectrum.shape[1:], 3)
    if reference.shape != shape:
        raise invalid(
            "reference_lab, shape",
            reference.shape,
            str(shape),
            "Resample one image to the raster of the other.",
        )
    reference = reference.transpose(2, 0, 1)
    difference = np.empty(spectrum.shape[1:], spectrum.dtype)
    for rows, lab in lab_strips:
        _distance(reference[:, rows], lab, difference[rows])
    return difference


def _opponent_spectrum(xyz: Planes, view: ViewingConditions, single: bool) -> Planes:
    """Return the DCT-II of the filtered opponent channels of an image (H, W, 3), (3, H, W)."""
    planes = np.moveaxis(xyz, -1, 0)
    opponent = empty_planes(*planes.shape, dtype=_precision(single))
    # A product takes a tenth of the time of `ldexp`, but its factor must be a number.
    scaled: np.ufunc = np.ldexp
    scale: float = -view.exponent
    if abs(view.exponent) < _MAX_EXPONENT:
        scaled = np.multiply
        scale = math.ldexp(1.0, -view.exponent)
    for rows, strip in strips_of(planes.shape, opponent.dtype, STRIP_DOTS):
        scaled(planes[:, rows], scale, out=strip, casting="same_kind")
        _apply_matrix(OPPONENT_FROM_XYZ, strip, opponent[:, rows])
    spectrum = dct(opponent)
    spectrum *= filter_transfer(view, *spectrum.shape[1:], single=single)
    return spectrum


def _grey_spectrum(luminance: Finites, view: ViewingConditions, single: bool) -> Planes:
    """Return the DCT-II of the filtered X/Xn, Y/Yn and Z/Zn of a grey picture, (3, H, W)."""
    grey = np.asarray(luminance)
    grey = grey if single and grey.dtype == np.float32 else grey.astype(np.float64, copy=False)
    if grey.ndim != 2 or grey.size == 0:
        raise invalid("luminance", f"shape {grey.shape}", "(H, W), not empty")
    coefficients = dct(grey.astype(_precision(single), copy=False), in_place=False)
    transfer = filter_transfer(view, *grey.shape, grey=True, single=single)
    spectrum = empty_planes(3, *grey.shape, dtype=coefficients.dtype)
    for rows in strips(len(grey), grey.shape[1], STRIP_DOTS):
        np.multiply(transfer[:, rows], coefficients[rows], out=spectrum[:, rows])
    return spectrum


def _iter_lab_strips(spectrum: Planes, view: ViewingConditions, grey: bool = False) -> Strips:
    """Yield strips of CIELAB planes, each valid until the next one, from the filtered DCT-II (3, H,
    W), which is overwritten.

    grey : the planes of the spectrum are X/Xn, Y/Yn, Z/Zn instead of the opponent channels
    """
    planes = inverse_dct(spectrum)
    for rows, strip in strips_of(planes.shape, planes.dtype, STRIP_DOTS):
        if grey:
            yield rows, _lab_planes(planes[:, rows], *view.constants)
            continue
        _apply_matrix(view.relative_from_opponent, planes[:, rows], strip)
        yield rows, _lab_planes(strip, *view.constants)


def _assemble_strips(lab_strips: Strips, spectrum: Planes) -> Planes:
    """Return an image (H, W, 3) from strips of its planes, of the shape (3, H, W) and in the
    precision of `spectrum`.
    """
    planes = np.empty(spectrum.shape, spectrum.dtype)
    for rows, lab in lab_strips:
        for plane, part in zip(planes, lab, strict=True):
            plane[rows] = part
    return np.moveaxis(planes, 0, -1)


def delta_e(lab_reference: Finites, lab_test: Finites, formula: Formula = "1976") -> Floats:
    """Return the colour difference of each sample, (...), between two CIELAB arrays (..., 3).

    lab_reference, lab_test : (..., 3)
    formula : "1976" Euclidean [CIE]; "1994" CIE 116-1995, graphic arts (kL 1, K1 .045, K2 .015),
        weighted by the chroma of the reference, hence not symmetric; "2000" CIE 142-2001, kL = kC =
        kH = 1. The last two by colour-science.

    Raises PixsimError (a ValueError) if shapes differ, values are not finite or the formula is
    unknown.

    >>> float(delta_e([50.0, 0.0, 0.0], [53.0, 4.0, 0.0]))
    5.0
    """
    reference, test = _checked_pair(lab_reference=lab_reference, lab_test=lab_test)
    if formula == "1976":
        distance = np.empty(reference.size // 3)
        x, y, z = test.reshape(-1, 3).T.copy()
        _distance(reference.reshape(-1, 3).T, (x, y, z), distance)
        return distance.reshape(reference.shape[:-1])[()]
    import colour  # takes 2.6 s, needed for these formulas only

    compare = colour.difference.delta_E_CIE2000
    if formula == "1994":
        compare = colour.difference.delta_E_CIE1994
    # Else a caller's global setting would change the result.
    with colour.domain_range_scale("reference"):
        return np.asarray(compare(reference, test), np.float64)


def _distance(first: Planes, second: Lab, out: Floats) -> None:
    """Write the Euclidean distance of planes to `out`; overwrites `second`."""
    for plane, other in zip(first, second, strict=True):
        np.square(np.subtract(plane, other, out=other), out=other)
    squared = second[0]
    squared += second[1]
    squared += second[2]
    np.sqrt(squared, out=out)


def xyz_to_lab(xyz: Finites, white_xyz: Positives) -> Floats:
    """Return the CIELAB [CIE], (..., 3), of unfiltered xyz (..., 3) under white_xyz (3,) in the
    same unit.

    Negative XYZ is treated as in `filtered_lab`. Raises PixsimError (a ValueError) for invalid
    shapes or values.
    """
    planes = np.moveaxis(_checked_triples("xyz", xyz), -1, 0)
    white = checked_white(white_xyz)
    return _lab(
        np.stack([plane / scale for plane, scale in zip(planes, white, strict=True)]), *CIE_LAB
    )


def _lab(relative: Floats, threshold: float, slope: float, dark_slope: float) -> Floats:
    """Return the CIELAB (..., 3) of planes (3, ...) of X/Xn, Y/Yn, Z/Zn."""
    lab = _lab_planes(np.array(relative).reshape(3, -1), threshold, slope, dark_slope)
    return np.stack(lab, axis=1).reshape(*relative.shape[1:], 3)


def _lab_planes(relative: Planes, threshold: float, slope: float, dark_slope: float) -> Lab:
    """Return L*, a* and b*, which overwrite the planes of X/Xn, Y/Yn, Z/Zn (3, ...).

    The linear branch is evaluated only if a sample lies at or below the threshold.
    """
    if relative.dtype == np.float32:
        for plane in relative:
            _single_f(plane, threshold, slope, out=plane)
        return _lab_of_f(relative)  # 116 f - 16 continues the dark branch of L*, to 1e-6
    linear = relative.copy() if relative.min() <= threshold else None
    f = np.cbrt(relative, out=relative)
    if linear is not None:
        np.copyto(f, slope * linear + 16 / 116, where=linear <= threshold)
    lab = _lab_of_f(f)
    if linear is not None:
        np.copyto(lab[0], dark_slope * linear[1], where=linear[1] <= threshold)
    return lab


def _lab_of_f(f: Planes) -> Lab:
    """Return 116 f(Y) - 16, 500 (f(X) - f(Y)) and 200 (f(Y) - f(Z)), which overwrite f (3, ...)."""
    x, y, z = f
    x -= y
    x *= 500
    np.subtract(y, z, out=z)
    z *= 200
    y *= 116
    y -= 16
    return y, x, z


# of the 23 of a float32's fraction: 1024 bins an octave, whose chords are within 3e-8 of a cube
# root
_F_BIN_BITS = 13


@lru_cache(maxsize=2)
def _f_lines(threshold: float, slope: float) -> npt.NDArray[np.complex64]:
    """Return CIELAB's f as a straight line in each bin of the non-negative float32 numbers: its
    slope, and i times its value at 0.

    Numbers that differ only in the last `_F_BIN_BITS` of their bits share a bin. The bits of such
    numbers, read as integers, increase with them. Below the threshold f is a line itself.
    """
    infinity = np.float32(np.inf).view(np.int32) >> _F_BIN_BITS
    edges = (np.arange(infinity + 1, dtype=np.int32) << _F_BIN_BITS).view(np.float32).astype(float)
    edges[-1] = 2.0**128  # in place of infinity
    f = np.where(edges > threshold, np.cbrt(edges), slope * edges + 16 / 116)
    slopes = np.where(edges[1:] > threshold, np.diff(f) / np.diff(edges), slope)
    at_zero = np.where(edges[1:] > threshold, f[:-1] - slopes * edges[:-1], 16 / 116)
    return (slopes + 1j * at_zero).astype(np.complex64)


def _single_f(relative: Planes, threshold: float, slope: float, out: Planes) -> None:
    """Write CIELAB's f of float32 values to `out`, with an error of about one unit in the last
    place.

    `np.cbrt` of float32 takes ten times as long, and a step of Newton's method from logarithms
    twice as long.
    """
    bins = np.empty(relative.shape, np.intp)
    # Negative numbers have negative bins, which are clipped to the first one, of the line through
    # 0.
    np.right_shift(relative.view(np.int32), _F_BIN_BITS, out=bins)
    lines = np.take(_f_lines(threshold, slope), bins, mode="clip")
    np.multiply(relative, lines.real, out=out)
    out += lines.imag


def _apply_matrix(matrix: Floats, planes: Planes, out: Planes) -> None:
    """Write a 3×3 matrix times planes (3, H, W) to `out`; not by BLAS, whose rounding depends on
    the number of threads.
    """
    np.einsum("ij,jyx->iyx", matrix.astype(planes.dtype), planes, out=out, optimize=False)
