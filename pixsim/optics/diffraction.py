"""Diffraction of a circular pupil: its optical transfer function, and images blurred by it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import (
    Array,
    FiniteArray,
    Finites,
    Picture,
    PositiveArray,
    Positives,
    Row,
    dct,
    empty_planes,
    inverse_dct,
    strips,
    strips_of,
    values_of,
)
from pixsim.base.bounds import Count, NotNegative, Positive, check_broadcast
from pixsim.base.errors import invalid
from pixsim.base.mapped import release
from pixsim.optics.quantities import FNumberOrPinhole

_NM_PER_MM = 1e6
_OTF_TABLE_SIZE = 1 << 15  # frequencies; the error of linear interpolation is below 3e-8
# One for each wavelength, 80 MiB in all: more than a plan has bands, or none would stay cached.
_MAX_CACHED_TABLES = 320
_MAX_CACHED_SUMS = 256  # of sums over the wavelengths, 64 MiB in all: of 20 pictures in 6 responses


def cutoff_cy_per_mm(wavelength_nm: Positives, f_number: FNumberOrPinhole) -> Array:
    """Return the cut-off frequency 1/(λ N_e) = 2 sin α/λ of a diffraction-limited lens, in the
    shape (...) of the wavelengths.

    It is 0 for a pinhole, N_e = infinity. Goodman, Introduction to Fourier Optics, 3rd ed.

    f_number : effective, N_e = 1/(2 sin α) (`Camera.effective_f_number`), above 0; sin α is the
        numerical aperture on the sensor side, with tan α = 1/(2 N (1 + |m|)), as in
        `irradiance_factor`

    Raises PixsimError if a wavelength or the f-number is not positive.
    """
    wavelength_nm = np.asarray(wavelength_nm, float)
    with np.errstate(over="ignore", divide="ignore"):  # the cut-off may be 0 or infinite
        return _NM_PER_MM / (wavelength_nm * f_number)


def diffraction_otf(
    frequency_cy_per_mm: Finites, wavelength_nm: Positives, f_number: FNumberOrPinhole
) -> Array:
    """Return the OTF of a circular pupil, (2/π)(acos x - x√(1-x²)) with x = frequency · λ · N, zero
    beyond x = 1.

    Goodman, Introduction to Fourier Optics, 3rd ed., eq. (6-31). The OTF at frequency 0 is always
    1. It is the same over the field; in a real lens the tangential cut-off falls as cos³θ off axis.

    frequency_cy_per_mm, wavelength_nm : broadcast together; the result, 0 to 1, has their shape
    f_number : effective, N_e = 1/(2 sin α) (`Camera.effective_f_number`)

    Raises PixsimError as `cutoff_cy_per_mm` does.

    >>> cutoff = cutoff_cy_per_mm(550, 4.0)
    >>> round(float(diffraction_otf(cutoff / 2, 550, 4.0)), 6)  # 2/3 - √3/(2π)
    0.391002
    """
    frequency = np.abs(np.asarray(frequency_cy_per_mm, float))
    check_broadcast(frequency_cy_per_mm=frequency.shape, wavelength_nm=np.shape(wavelength_nm))
    with np.errstate(
        over="ignore", divide="ignore", invalid="ignore"
    ):  # 0/0 at frequency 0 of a pinhole
        x = np.where(frequency == 0, 0.0, frequency / cutoff_cy_per_mm(wavelength_nm, f_number))
    x = np.minimum(x, 1.0)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt((1 - x) * (1 + x)))


def _check_bands(wavelength_nm: Array, weight: Array) -> None:
    """Raise PixsimError if there is not one weight for each wavelength."""
    if weight.shape != wavelength_nm.shape:
        raise invalid(
            "wavelength_nm and weight",
            f"{wavelength_nm.size} and {weight.size} values",
            "arrays of equal length",
        )


def white_otf(
    frequency_cy_per_mm: FiniteArray,
    wavelength_nm: PositiveArray,
    weight: Row,
    f_number: FNumberOrPinhole,
) -> Array:
    """Return Σ weight · `diffraction_otf` over wavelengths, in the shape (...) of the frequencies.

    It is the white-light OTF if the weights add up to 1.

    wavelength_nm, weight : (B,), any unit of weight
    f_number : effective, N_e = 1/(2 sin α)

    Raises PixsimError as `cutoff_cy_per_mm` does.
    """
    _check_bands(wavelength_nm, weight)
    otf = np.zeros_like(frequency_cy_per_mm)
    seen = np.flatnonzero(weight)
    column = (-1, *[1] * otf.ndim)
    otfs = diffraction_otf(frequency_cy_per_mm, wavelength_nm[seen].reshape(column), f_number)
    otfs *= weight[seen].reshape(column)
    for part in otfs:
        otf += part
    return otf


def diffract_sum(
    pictures: Iterable[tuple[ArrayLike, Array]],
    shape: tuple[Count, Count],
    pitch_um: Positive,
    wavelength_nm: PositiveArray,
    f_number: FNumberOrPinhole | None,
    transfer: Callable[[Array, float], Array] | None = None,
) -> Array:
    """Return the sum of pictures (H, W), each convolved with its white-light PSF Σ_λ weight · PSF_λ
    of `diffraction_otf`.

    In the DCT-II basis a symmetric kernel is diagonal and reflection at the borders is exact,
    without padding. The mean is preserved. If the OTF is not small at the Nyquist frequency of the
    grid, isolated points ring, also below zero. There is one forward transform per picture and one
    inverse transform. At most two float64 planes are in memory.

    pictures : (picture (H, W), weight (B,)) pairs, in any unit
    shape : (H, W)
    pitch_um : of the samples
    wavelength_nm : (B,)
    f_number : effective, N_e = 1/(2 sin α). None: a lens without diffraction
    transfer : (frequencies in cycles/mm, wavelength in nm) -> further MTF, 1 at frequency 0, that
        multiplies the lens's

    Raises PixsimError as `cutoff_cy_per_mm` does.
    """
    one_channel = ((picture, [weight]) for picture, weight in pictures)
    return diffract_sums(one_channel, 1, shape, pitch_um, wavelength_nm, f_number, transfer)[0]


def diffract_sums(
    pictures: Iterable[tuple[ArrayLike, Sequence[Array]]],
    channels: int,
    shape: tuple[Count, Count],
    pitch_um: Positive,
    wavelength_nm: PositiveArray,
    f_number: FNumberOrPinhole | None,
    transfer: Callable[[Array, float], Array] | None = None,
) -> list[Array]:
    """Return `diffract_sum` for several channels, [(H, W)], with one forward transform per picture
    and one inverse transform per channel.

    pictures : (picture (H, W), weights [(B,)] of each channel) pairs, in any unit
    channels : their number

    Raises PixsimError as `cutoff_cy_per_mm` does.
    """
    if wavelength_nm.ndim != 1 or not wavelength_nm.size:
        raise invalid(
            "wavelength_nm", f"an array of shape {wavelength_nm.shape}", "(B,), at least one"
        )
    fy, fx = (np.arange(n) / (2 * n * pitch_um * 1e-3) for n in shape)
    highest = float(np.hypot(fx[-1], fy[-1]))
    if f_number is not None:
        highest = min(highest, float(cutoff_cy_per_mm(wavelength_nm.min(), f_number)))
    # A shorter table would have steps too small to divide by.
    lowest = 1 / (2 * max(shape) * pitch_um * 1e-3)
    table, step = _frequencies(max(highest, lowest))

    totals: dict[int, Array] = {}
    spare: Array | None = None
    for picture, weights in pictures:
        lit_channels = [channel for channel in range(channels) if np.any(weights[channel])]
        if not lit_channels:
            continue
        plane = empty_planes(*shape) if spare is None else spare
        values = np.asarray(picture)
        for rows in strips(*shape):
            plane[rows] = values[rows]
            release(values[rows])
        spectrum = dct(plane)
        spare = spectrum

        # The last new channel takes the spectrum's own memory, after all others.
        new_channels = [channel for channel in lit_channels if channel not in totals]
        if new_channels:
            for channel in new_channels[:-1]:
                totals[channel] = empty_planes(*shape)
            totals[new_channels[-1]] = spectrum
            spare = None

        otfs = {
            channel: _radial_otf(table, wavelength_nm, weights[channel], f_number, transfer)
            for channel in lit_channels
        }
        _filter(spectrum, fy / step, fx / step, otfs, totals, new_channels)

    return [
        inverse_dct(totals[channel]) if channel in totals else np.zeros(shape)
        for channel in range(channels)
    ]


def _radial_otf(
    table_cy_per_mm: Array,
    wavelength_nm: Array,
    weight: Array,
    f_number: float | None,
    transfer: Callable[[Array, float], Array] | None,
) -> Array:
    """Return Σ weight · OTF of `diffract_sum` at the frequencies of a table."""
    highest_cy_per_mm = float(table_cy_per_mm[-1])
    bands = np.flatnonzero(weight)
    if transfer is None and f_number is not None:
        return _white_table(
            highest_cy_per_mm,
            tuple(wavelength_nm[bands].tolist()),
            tuple(weight[bands].tolist()),
            f_number,
        )

    otf = np.zeros_like(table_cy_per_mm)
    for band in bands:
        nm = float(wavelength_nm[band])
        if f_number is None:
            band_otf = np.ones_like(table_cy_per_mm)
        else:
            band_otf = _otf_table(highest_cy_per_mm, nm, f_number)
        if transfer is not None:
            shape = table_cy_per_mm.shape
            band_otf = band_otf * values_of("transfer", transfer, shape, table_cy_per_mm, nm)
        otf += weight[band] * band_otf
    return otf


def _frequencies(highest_cy_per_mm: float) -> tuple[Array, float]:
    """Return the frequencies of a table from 0 to the highest, and their step."""
    table, step = np.linspace(0.0, highest_cy_per_mm, _OTF_TABLE_SIZE, retstep=True)
    return table, float(step)


@lru_cache(maxsize=_MAX_CACHED_TABLES)
def _otf_table(highest_cy_per_mm: float, wavelength_nm: float, f_number: float) -> Array:
    """Return `diffraction_otf` at the frequencies of a table; the spectra and the parts of a
    picture share it.
    """
    return diffraction_otf(_frequencies(highest_cy_per_mm)[0], wavelength_nm, f_number)


@lru_cache(maxsize=_MAX_CACHED_SUMS)
def _white_table(
    highest_cy_per_mm: float,
    wavelength_nm: tuple[float, ...],
    weight: tuple[float, ...],
    f_number: float,
) -> Array:
    """Return Σ weight · `_otf_table`; the parts of a picture share it."""
    otf = np.zeros(_OTF_TABLE_SIZE)
    for nm, share in zip(wavelength_nm, weight, strict=True):
        otf += share * _otf_table(highest_cy_per_mm, nm, f_number)
    otf.flags.writeable = False
    return otf


def _filter(
    spectrum: Array,
    y_steps: Array,
    x_steps: Array,
    otfs: dict[int, Array],
    totals: dict[int, Array],
    new: Sequence[int],
) -> None:
    """Add a spectrum (H, W) times radial tables, interpolated linearly, to totals; frequencies are
    in steps of the table.

    new : channels whose totals begin with this spectrum; the last one's total may be the spectrum
        itself
    """
    rises = {channel: np.append(np.diff(otf), 0.0) for channel, otf in otfs.items()}
    order = sorted(otfs, key=lambda channel: totals[channel] is spectrum)
    last = next(iter(otfs.values())).size - 1.0
    factor: Array | None = None
    for rows, radius in strips_of(spectrum.shape):
        np.sqrt(np.add(x_steps[None, :] ** 2, y_steps[rows, None] ** 2, out=radius), out=radius)
        np.minimum(radius, last, out=radius)
        below = radius.astype(np.int32)
        radius -= below
        for channel in order:
            if factor is None or factor.shape != radius.shape:
                factor = np.empty_like(radius)
            np.multiply(radius, rises[channel][below], out=factor)
            factor += otfs[channel][below]
            if channel in new:
                np.multiply(spectrum[rows], factor, out=totals[channel][rows])
            else:
                factor *= spectrum[rows]
                totals[channel][rows] += factor


def diffract(
    picture: Picture,
    pitch_um: Positive,
    wavelength_nm: PositiveArray,
    weight: Row,
    f_number: FNumberOrPinhole,
) -> Array:
    """Return a picture convolved with the white-light PSF of `diffraction_otf`, (H, W) in its unit;
    see `diffract_sum`.

    picture : (H, W)
    weight : (B,) relative weights of the wavelengths
    f_number : effective, N_e = 1/(2 sin α)

    Raises PixsimError if the weights add up to 0, and as `cutoff_cy_per_mm` does.
    """
    _check_bands(wavelength_nm, weight)
    total = weight.sum()
    if total == 0:
        raise invalid(
            "weight",
            "a sum of 0",
            "weights with another sum",
            "Use `diffract_sum` for weights that are not normalised.",
        )
    share = weight / total
    return diffract_sum([(picture, share)], picture.shape, pitch_um, wavelength_nm, f_number)


def square_aperture_mtf(frequency_cy_per_mm: Finites, side_um: NotNegative) -> Array:
    """Return |sin(πx)/(πx)|, x = frequency · side: the MTF of a square photodiode along one axis,
    (...) as the frequencies.

    The geometric MTF of Chen et al. (2000), section 2.2.

    >>> round(float(square_aperture_mtf(100.0, 5.0)), 6)  # Nyquist frequency of this side: 2/π
    0.63662
    """
    return np.abs(np.sinc(np.asarray(frequency_cy_per_mm, float) * side_um * 1e-3))
