"""Information per area of the sensor: what the spectra of a scene, of noise and of aliases leave of
it.

Spectra are two-sided, in signal² mm²: independent noise of variance σ² in each pixel has σ² pitch².

C. L. Fales & F. O. Huck, "An information theory of image gathering", Information Sciences 57 (1991)
245.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array, Finites, NotNegatives, Positives, values_of
from pixsim.base.bounds import FINITE, Axes, Bounds, NotNegative, Positive, check_broadcast
from pixsim.base.errors import invalid

_UM_PER_MM = 1e3
WITHIN = 1e-6  # of a cell: places of frequencies
MAX_ORDERS = 64
MIN_CELLS = 8
Axis = Annotated[Array, FINITE, Axes(1)]


def _axis_weights(frequency: Array) -> Array:
    """Return the width of the cell of each frequency of an axis (n,), as `information_bits_per_mm2`
    takes them, in their unit.

    The ends of a sorted axis have half a cell (trapezium), the ends of `np.fft.fftfreq` a whole
    cell.

    Raises PixsimError for another axis.
    """
    ordered = np.sort(frequency)
    steps = np.diff(ordered)
    if frequency.size > 1 and steps.min() > 0:
        first = float(ordered[0])
        last = float(ordered[-1])
        step = float(steps[0])
        tolerance = WITHIN * step
        is_even = frequency.size % 2 == 0
        is_sorted = bool((frequency == ordered).all())
        is_fft_order = not is_sorted and bool((frequency == np.fft.ifftshift(ordered)).all())

        # -Nyquist stands for both ends of an even number; an odd one has its ends half a cell
        # inside.
        asymmetry = first + last + step if is_even else first + last
        is_fft = is_fft_order or (is_sorted and is_even)
        if is_fft and abs(asymmetry) <= tolerance and np.ptp(steps) <= tolerance:
            return np.full(frequency.size, step)

        is_symmetric = abs(first + last) <= tolerance
        if is_sorted and (first == 0 or is_symmetric):
            trapezium = (np.append(0.0, steps) + np.append(steps, 0.0)) / 2
            return trapezium * (2 if first == 0 else 1)
    hint = (
        "Use np.linspace(-1, 1, n) / (2 * pitch_mm), np.linspace(0, 1, n) / (2 * pitch_mm) or"
        " np.fft.fftfreq(n, pitch_mm)."
    )
    got = f"{frequency.size} from {frequency.min():g} to {frequency.max():g}"
    raise invalid(
        "frequency_cy_per_mm",
        got,
        "increasing frequencies from -Nyquist or 0 to the Nyquist frequency",
        hint,
    )


def information_bits_per_mm2(
    frequency_cy_per_mm: Axis, signal: NotNegatives, noise: Positives, folded: NotNegatives = 0.0
) -> float:
    """Return the information in bits per mm² of sensor, ½ ∬ log₂(1 + signal/(noise + folded)), over
    the Nyquist square.

    Exact for constant spectra; Fales & Huck (1991). Per square degree of field it is (focal length
    in mm · π/180)² times that.

    frequency_cy_per_mm : (n,) of either axis: rising from minus the Nyquist frequency 1/(2 pitch)
        to it, both included; or from 0 to it, a quadrant that stands for all four; or as
        `np.fft.fftfreq(n, pitch)` has them
    signal : S |T|² of the scene's spectrum and the MTF T, (n, n) along y and x, or a number, in
        signal² mm²
    noise : of everything that is no signal, fixed pattern too, likewise
    folded : aliases of the scene, `folded_spectrum`, likewise

    Raises PixsimError if the axis does not end at the Nyquist frequency in one of these ways, or a
    shape is another one.

    >>> square = np.linspace(-100.0, 100.0, 33)  # of 5 µm pixels: ½ · 200² mm⁻² · log₂(1 + 3)
    >>> information_bits_per_mm2(square, 3.0, 1.0)
    40000.0
    """
    weights = _axis_weights(frequency_cy_per_mm)
    count = frequency_cy_per_mm.size
    for name, values in (("signal", signal), ("noise", noise), ("folded", folded)):
        if np.shape(values) not in ((), (count, count)):
            raise invalid(
                name,
                f"an array of shape {np.shape(values)}",
                f"({count}, {count}), like the frequencies, or a number",
            )
    with np.errstate(over="ignore"):
        ratio = np.asarray(signal, float) / (np.asarray(noise, float) + folded)
    bits = np.broadcast_to(np.log1p(ratio) / math.log(2), (count, count))
    along_y = (bits * weights).sum(axis=1)
    return float((along_y * weights).sum() / 2)


def natural_spectrum(
    frequency_cy_per_mm: Finites, level: NotNegative, corner_cy_per_mm: Positive
) -> Array:
    """Return the spectrum C/(f² + f₀²) of natural scenes, (...) as the frequencies, in the unit of
    C times mm².

    D. J. Field, J. Opt. Soc. Am. A 4 (1987) 2379, found 1/f²; a corner, the reciprocal of the
    largest things, bounds it.

    frequency_cy_per_mm : |f|, `np.hypot` of both axes
    level : C, the signal in any unit, squared; frequencies up to f have the variance π C ln(1 +
        f²/f₀²)
    corner_cy_per_mm : f₀, on the sensor
    """
    with np.errstate(over="ignore"):
        return np.asarray(
            level / (np.asarray(frequency_cy_per_mm, float) ** 2 + corner_cy_per_mm**2)
        )


def radial_spectrum(
    picture: Annotated[Array, FINITE, Axes(2)], pitch_um: Positive
) -> tuple[Array, Array]:
    """Return the spectrum of a picture over all directions: frequencies (n,) in cy/mm, and power
    (n,), its unit squared times mm².

    A periodogram without the mean, behind Hann's window (P. D. Welch, IEEE Trans. Audio
    Electroacoust. 15 (1967) 70), averaged in rings as wide as the window resolves: the logarithm of
    a raw one is biased. The blur of the cells, of which the samples are means, is undone.

    picture : (H, W) expected light, means over square cells
    pitch_um : of the cells

    Raises PixsimError for a picture of less than 8 cells along an axis.
    """
    if min(picture.shape) < MIN_CELLS:
        raise invalid(
            "picture",
            f"an array of shape {picture.shape}",
            f"{MIN_CELLS} cells or more along each axis",
        )
    pitch_mm = pitch_um / _UM_PER_MM
    largest = float(np.abs(picture).max()) or 1.0

    # The picture without its weighted mean, in units of its largest value, behind the window.
    window_y, window_x = (np.hanning(count + 2)[1:-1] for count in picture.shape)
    window = window_y[:, None] * window_x
    values = np.asarray(picture, float) / largest
    values = (values - float((values * window).sum() / window.sum())) * window

    along_y = np.fft.fftfreq(picture.shape[0])
    along_x = np.fft.rfftfreq(picture.shape[1])
    blur = np.sinc(along_y)[:, None] * np.sinc(along_x)
    periodogram = np.abs(np.fft.rfft2(values) / blur) ** 2
    power = periodogram * (pitch_mm * largest) ** 2 / float((window**2).sum())

    # Rings: half a ring, whatever its rounding, counts up.
    ring_px = 2 / min(picture.shape)
    ring = (np.hypot(along_y[:, None], along_x) / ring_px + 0.5 + WITHIN).astype(int)
    inside = (ring > 0) & (ring * ring_px <= 0.5 + WITHIN)
    # Most frequencies stand for their negative, too, in the half of the plane that is left out.
    multiplicity = np.where((along_x == 0) | (along_x == 0.5), 1.0, 2.0)
    count = np.bincount(ring[inside], np.broadcast_to(multiplicity, ring.shape)[inside])
    total = np.bincount(ring[inside], (power * multiplicity)[inside])
    frequency_cy_per_mm = np.arange(1, count.size) * ring_px / pitch_mm
    return frequency_cy_per_mm, total[1:] / count[1:]


def folded_spectrum(
    power: Callable[[Array, Array], Array],
    frequency_cy_per_mm: Axis,
    pitch_um: Positive,
    orders: Annotated[int, Bounds(1, MAX_ORDERS)] = 2,
) -> Array:
    """Return the aliases Σ P(f + k/pitch), k ≠ 0, of a spectrum that pixels sample, (n, n) in the
    unit of the power.

    They are noise to the spectrum at f itself. Fales & Huck (1991).

    power : function of two arrays that broadcast, (n, 1) and (n,), frequencies along y and x in
        cy/mm: S |T|², also beyond Nyquist
    frequency_cy_per_mm : (n,) of either axis, in any order
    pitch_um : of the pixels
    orders : how many multiples of 1/pitch on either side of 0, in both axes

    Raises PixsimError if the function fails, or returns another shape.
    """
    count = frequency_cy_per_mm.size
    folded = np.zeros((count, count))
    for j, i in product(range(-orders, orders + 1), repeat=2):
        if i or j:
            along_y = frequency_cy_per_mm[:, None] + j * _UM_PER_MM / pitch_um
            along_x = frequency_cy_per_mm + i * _UM_PER_MM / pitch_um
            folded += values_of("power", power, folded.shape, along_y, along_x)
    return folded


def neq(mtf: Finites, noise_power: Positives, mean: NotNegative) -> Array:
    """Return the noise-equivalent quanta, mean² |T|²/N, per unit area; it has the shape to which
    MTF and noise broadcast.

    The quanta that an ideal detector would need for the same ratio of signal to noise at a
    frequency. Of mm⁻² for noise in mm². R. Shaw, J. Photogr. Sci. 11 (1963) 199; ICRU Report 54
    (1996).

    mtf, noise_power : broadcast together; noise power in signal² mm², as in
        `information_bits_per_mm2`
    mean : of the signal, in its unit

    Raises PixsimError if the shapes do not broadcast.
    """
    check_broadcast(mtf=np.shape(mtf), noise_power=np.shape(noise_power))
    with np.errstate(over="ignore"):
        return np.asarray((np.asarray(mtf, float) * mean) ** 2 / np.asarray(noise_power, float))
