"""Sharpness: the MTF of an edge without noise, where it falls to one half, and acutance, its mean
as the eye weights it.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from scipy.special import gammainc

from pixsim.base.arrays import Array, NotNegativeArray, NotNegatives
from pixsim.base.bounds import FINITE, NOT_NEGATIVE, Axes, Bounds
from pixsim.base.errors import invalid

# Contrast sensitivity 75 ν^0.8 e^(-0.2 ν)/34.05, ν in cy/deg, of IEEE 1858 and ISO 15739:2013,
# annex B: 3 at its peak, 4 cy/deg. G. M. Johnson & M. D. Fairchild, "A top down description of
# S-CIELAB and CIEDE2000", Color Res. Appl. 28 (2003) 425.
_CSF_SCALE = 75 / 34.05
_CSF_POWER = 0.8
_CSF_DECAY = 0.2
STEEPEST_DEG = 45.0

Frequencies = Annotated[Array, NOT_NEGATIVE, Axes(1)]


def curve_from_0(name: str, frequency: Array, mtf: Array) -> tuple[Array, Array]:
    """Return an MTF (n,) and its frequencies from 0, where it is 1 if another one is first.

    Raises PixsimError if there is not one MTF for each frequency, or these do not rise.
    """
    if mtf.shape != frequency.shape:
        raise invalid(
            f"{name} and mtf", f"shapes {frequency.shape} and {mtf.shape}", "equal shapes"
        )
    if frequency[0]:
        frequency = np.append(0.0, frequency)
        mtf = np.append(1.0, mtf)
    if frequency.size < 2 or np.diff(frequency).min() <= 0:
        raise invalid(
            name,
            f"{frequency.size} numbers from {frequency[0]:g}",
            "increasing numbers, at least one of them above 0",
        )
    return np.asarray(frequency, float), np.asarray(mtf, float)


def first_crossing(frequency: Array, sfr: Array, level: float) -> float | None:
    """Return the frequency at which a curve first falls to a level, by linear interpolation; a
    curve that does not has None.
    """
    below = np.flatnonzero(sfr < level)
    if not below.size or below[0] == 0:
        return None
    right = int(below[0])
    left = right - 1
    return float(
        frequency[left]
        + (sfr[left] - level) / (sfr[left] - sfr[right]) * (frequency[right] - frequency[left])
    )


def mtf50(frequency: Frequencies, mtf: NotNegativeArray) -> float | None:
    """Return the frequency at which an MTF first falls to one half, in its unit, linear between
    frequencies, or None if it does not.

    frequency : (n,) rising, in any unit
    mtf : (n,) 1 at frequency 0

    Raises PixsimError if the frequencies do not rise, or the shapes differ.
    """
    return first_crossing(*curve_from_0("frequency", frequency, mtf), 0.5)


def luminance_csf(frequency_cy_per_deg: Array) -> Array:
    """Return the eye's contrast sensitivity for luminance, (...) as the frequencies, relative."""
    return (
        _CSF_SCALE * frequency_cy_per_deg**_CSF_POWER * np.exp(-_CSF_DECAY * frequency_cy_per_deg)
    )


def acutance(frequency_cy_per_deg: Frequencies, mtf: NotNegativeArray) -> float:
    """Return ∫ MTF · CSF/∫ CSF, a number from 0 to 1 for a picture that is not sharpened. CPIQ,
    IEEE 1858.

    The CSF is 75 ν^0.8 e^(-0.2 ν)/34.05. The upper integral ends at the last frequency, which is to
    be the display's Nyquist frequency, the lower one is over all frequencies. Exact for an MTF that
    is straight between the frequencies.

    frequency_cy_per_deg : (n,) rising
    mtf : (n,) of all from the scene to the display, 1 at frequency 0

    Raises PixsimError if the frequencies do not rise, or the shapes differ.

    >>> acutance(np.array([0.0, 1e3]), np.ones(2))
    1.0
    """
    frequency, mtf = curve_from_0("frequency_cy_per_deg", frequency_cy_per_deg, mtf)
    shape = _CSF_POWER + 1
    # Of the CSF in each interval, and its first moment.
    share = np.diff(gammainc(shape, _CSF_DECAY * frequency))
    moment = np.diff(gammainc(shape + 1, _CSF_DECAY * frequency)) * shape / _CSF_DECAY
    slope = np.diff(mtf) / np.diff(frequency)
    return float((mtf[:-1] * share + slope * (moment - frequency[:-1] * share)).sum())


def edge_mtf(
    picture: Annotated[Array, FINITE, Axes(2)],
    angle_deg: Annotated[float, Bounds(-STEEPEST_DEG, STEEPEST_DEG)],
    frequency_cy_per_px: NotNegatives,
) -> Array:
    """Return the MTF of a straight edge without noise, (...) as the frequencies, 0 to 1.

    All samples in the order of their distance from the edge are one edge spread function, as in ISO
    12233, without its bins: the Fourier transform of its slope, straight between the samples, is
    summed as it is. A slanted edge shows frequencies beyond Nyquist; an upright one has a sample a
    pixel. The edge is known, not measured: `pixsim.edge_response` measures one in noise.

    picture : (H, W) with the edge, flat on either side of it
    angle_deg : of the edge from the vertical, clockwise with row 0 on top, as in the packaged
        `slanted_edge`
    frequency_cy_per_px : along the normal of the edge

    Raises PixsimError if both sides are equally bright.
    """
    frequency = np.asarray(frequency_cy_per_px, float)
    angle = math.radians(angle_deg)
    rows, columns = (np.arange(count, dtype=float) for count in picture.shape)

    # The edge spread function: samples in the order of their distance from the edge.
    distance_px = (math.cos(angle) * columns + math.sin(angle) * rows[:, None]).ravel()
    order = np.argsort(distance_px, kind="stable")
    distance_px = distance_px[order]
    rise = np.diff(np.asarray(picture, float).ravel()[order])
    middle_px = (distance_px[1:] + distance_px[:-1]) / 2
    width_px = np.diff(distance_px)
    total = float(rise.sum())
    if not total:
        raise invalid("picture", "no step from one side to the other", "an edge between two levels")

    def modulus(cy_per_px: float) -> float:
        weight = rise * np.sinc(cy_per_px * width_px)
        phase = 2 * np.pi * cy_per_px * middle_px
        real = float((weight * np.cos(phase)).sum())
        imaginary = float((weight * np.sin(phase)).sum())
        return math.hypot(real, imaginary) / abs(total)

    moduli = [modulus(cy_per_px) for cy_per_px in frequency.ravel().tolist()]
    return np.array(moduli).reshape(frequency.shape)
