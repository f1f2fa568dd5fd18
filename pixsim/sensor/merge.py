"""Several readings of a pixel as one estimate of its electrons: weights, variance, bias.

With Q_j the charge of collector j, of response r_j and dark charge D_j, and σ_k the noise of
reading k behind its limit, readings are x_k = Q_j + N(0, σ_k), and estimate the electrons of the
first collector by (x_k - D_j)/r_j. Their covariance is

    C_kl = [same collector] (r μ + D)/r² + [both read the capacitor] D_cap/r² + [k = l] σ_k²/r_k².

Readings of one collector share its electrons: no weights lower their shot noise. A merge chooses
weights by what is valid: x_k below its limit by some σ_k.

Values of K readings at n levels, or in n pixels, are arrays (K, n), the most sensitive one first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.sensor.colour import Layout
from pixsim.sensor.noise import Along, constant_e, variance_e2
from pixsim.sensor.reading import Reading, Readout

_REACH = 6.0  # deviations of a normal law that integrals take in
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(24)
_MIN_PASSING = 1e-12  # of full readings
_UNUSED_E2 = 1e30  # variance of readings that are not valid
_TABLE_LEVELS = 2048  # more levels are interpolated in a table: a third of a deviation at 1e5 e-
_TABLE_FROM = 1e-6  # of the brightest level
LINES: tuple[Along, Along] = ("column", "row")  # pixels that share an offset
_NEIGHBOURS = 3  # pixels along a side of the neighbourhood, of one channel


def _numbers(readout: Readout, number: Callable[[Reading], float]) -> Array:
    """Return a number of each reading, (K, 1)."""
    return np.array([[number(reading)] for reading in readout.readings])


def _responses(readout: Readout) -> Array:
    """Return the response of each reading, (K, 1)."""
    return _numbers(readout, lambda reading: reading.response)


def _darks_e(readout: Readout, integration_s: float) -> Array:
    """Return the mean dark charge of each reading, (K, 1)."""
    return _numbers(readout, lambda reading: reading.dark_e(integration_s))


def _limits_e(readout: Readout) -> tuple[Array, Array]:
    """Return the limit of each reading, and the charge below which it is valid, (K, 1) each; the
    last one always is.
    """
    sigmas = readout.merge.validity_sigmas
    below_e = _numbers(readout, lambda reading: reading.valid_below_e(sigmas))
    below_e[-1] = math.inf
    return _numbers(readout, lambda reading: reading.limit_e), below_e


def _charges_e(readout: Readout, level_e: Array, integration_s: float) -> Array:
    """Return the mean charges of the readings with dark charge, (K, n), at levels (n,)."""
    return _responses(readout) * level_e + _darks_e(readout, integration_s)


def charges_of_codes_e(readout: Readout, codes: Sequence[NDArray[Any]]) -> Array:
    """Return the charges of the codes of readings, with dark charge, (K, n).

    codes : of each reading, (...)
    """
    charges_e = []
    for code, reading in zip(codes, readout.readings, strict=True):
        adc = reading.readout.adc
        signal_dn = adc.levels_of(code).ravel() - adc.black_level_dn
        charges_e.append(signal_dn / reading.readout.dn_per_e)
    return np.stack(charges_e)


def _shares(readout: Readout, charges_e: Array) -> NDArray[Any]:
    """Return the share, 0 to 1, that each reading has of the rest that more sensitive ones leave,
    (K, n); 1 for the last one.

    charges_e : of the readings with their dark charge, (K, n)
    """
    merge = readout.merge
    limit_e, below_e = _limits_e(readout)
    is_valid = charges_e < below_e
    if merge.merge != "blend":
        return is_valid
    from_e = merge.blend_from_share * limit_e
    to_e = merge.blend_to_share * limit_e
    share = is_valid * np.clip((to_e - charges_e) / (to_e - from_e), 0.0, 1.0)
    share[-1] = 1.0
    return np.asarray(share)


def _nested(share: NDArray[Any], parts: Array) -> Array:
    """Return parts of the readings, (K, ...), merged by their shares of the rest, (K, n)."""
    result = share[-1] * parts[-1]
    for number in reversed(range(len(share) - 1)):
        result = result + share[number] * (parts[number] - result)
    return result


def merge_weights(
    readout: Readout, charges_e: Array, integration_s: float, pilot_e: Array
) -> Array:
    """Return the weights of the readings, (K, n), whose sum is 1.

    charges_e : of the readings with their dark charge, (K, n)
    integration_s : of one exposure
    pilot_e : electrons of the first collector, (n,), for 'max_likelihood'
    """
    share = _shares(readout, charges_e)
    numbers = np.arange(len(share))
    if readout.merge.merge != "max_likelihood":
        return _nested(share, np.eye(numbers.size)[..., None])

    # C⁻¹1/(1ᵀC⁻¹1) of the valid readings.
    covariance = covariances_e2(readout, np.maximum(pilot_e, 0.0), integration_s)
    covariance[numbers, numbers] += np.where(share, 0.0, _UNUSED_E2)
    matrices = np.moveaxis(covariance, 2, 0)
    solved = np.linalg.solve(matrices, np.ones((*matrices.shape[:2], 1)))[..., 0].T
    return np.asarray(solved / solved.sum(axis=0))


def merged(
    readout: Readout,
    codes: Sequence[NDArray[Any]],
    integration_s: float,
    values: Array | None = None,
) -> Array:
    """Return values of the readings merged in a frame, (..., rows, columns).

    The pilot of 'max_likelihood' is the mean over neighbours of the most sensitive valid readings.

    codes : of each reading, (rows, columns)
    integration_s : of one exposure
    values : (K, ..., 1), or None for the estimates of the electrons of the first collector
    """
    shape = codes[0].shape
    charges_e = charges_of_codes_e(readout, codes)
    estimates_e = (charges_e - _darks_e(readout, integration_s)) / _responses(readout)
    values = estimates_e if values is None else values
    share = _shares(readout, charges_e)
    if readout.merge.merge != "max_likelihood":
        result = _nested(share, values)
    else:
        pilot_e = _neighbourhood_means(
            _nested(share, estimates_e).reshape(shape), readout.physics.layout
        )
        weights = merge_weights(readout, charges_e, integration_s, pilot_e.ravel())
        result = sum(weight * value for weight, value in zip(weights, values, strict=True))
    return result.reshape(*result.shape[:-1], *shape)


def _neighbourhood_means(picture: Array, layout: Layout | None) -> Array:
    """Return the means over neighbours of the same channel, (rows, columns)."""
    means = np.empty(picture.shape)
    parts: Iterable[tuple[Array, Array]] = [(picture, means)]
    if layout is not None:
        parts = zip(layout.parts(picture), layout.parts(means), strict=True)
    for part, mean in parts:
        mean[...] = scipy.ndimage.uniform_filter(part, _NEIGHBOURS, mode="nearest")
    return means


# --- closed forms


def covariances_e2(
    readout: Readout, level_e: Array, integration_s: float, rounding: bool = True
) -> Array:
    """Return the covariance C of the estimates of all readings, (K, K, n), at levels (n,).

    level_e : mean electrons of light of the first collector in an exposure
    integration_s : of one exposure
    """
    readings = readout.readings
    charges_e = _charges_e(readout, level_e, integration_s)
    collectors = np.array([reading.collector for reading in readings])
    is_shared = collectors[:, None] == collectors
    capacitor_e = _numbers(readout, lambda reading: reading.capacitor_e(integration_s))
    both_read_it = is_shared * np.minimum(capacitor_e, capacitor_e.T)
    covariance = is_shared[..., None] * (charges_e - capacitor_e) + both_read_it[..., None]
    for number, reading in enumerate(readings):
        covariance[number, number] += reading.noise_e**2
        if rounding:
            covariance[number, number] += reading.rounding_e2(charges_e[number])
    response = _responses(readout)
    return np.asarray(covariance / (response * response.T)[..., None])


@dataclass(frozen=True)
class MergedLevel:
    """A uniform level as its merge estimates it, over frames of pixels that are alike, (n,) each.

    bias_e : mean of the estimate, less the level
    variance_e2 : of the estimate
    weights : of each reading, (K, n), in the mean
    """

    bias_e: Array = field(repr=False)
    variance_e2: Array = field(repr=False)
    weights: Array = field(repr=False)


def mean_weights(readout: Readout, level_e: Array, integration_s: float) -> Array:
    """Return the weights, (K, n), that a merge has where each reading has its mean charge."""
    charges_e = _charges_e(readout, level_e, integration_s)
    return merge_weights(readout, charges_e, integration_s, level_e)


def _switch_charges_e(readout: Readout) -> Array:
    """Return the charges of each reading at which its share has a step or a kink, (K, 1) or (K, 3),
    rising; infinite of the last one.
    """
    merge = readout.merge
    limit_e, below_e = _limits_e(readout)
    if merge.merge != "blend":
        return below_e
    blended_e = limit_e * [merge.blend_from_share, merge.blend_to_share]
    return np.sort(np.hstack([below_e, np.where(np.isinf(below_e), math.inf, blended_e)]))


def switch_levels_e(readout: Readout, integration_s: float) -> Array:
    """Return the levels of a frame at which the merge of the mean charges changes its readings,
    (n,), rising.
    """
    count = readout.exposures
    light_e = _switch_charges_e(readout) - _darks_e(readout, integration_s / count)
    return np.sort(count * (light_e / _responses(readout))[:-1], axis=None)


def weighted_e2(weights: Array, covariance: Array) -> Array:
    """Return the variance of a weighted sum, (n,), of weights (K, n) and covariances (K, K, n)."""
    return np.asarray(np.einsum("kn,kln,ln->n", weights, covariance, weights))


def level_variance_e2(
    readout: Readout, level_e: Array, integration_s: float, *, rounding: bool = True
) -> Array:
    """Return the temporal variance of the estimate of levels (n,) of a frame, with the weights of
    the mean; NaN beyond the limit of the last reading.

    level_e : mean electrons of light of the first collector in a frame
    integration_s : of a frame
    """
    count = readout.exposures
    level_e = level_e / count
    integration_s = integration_s / count
    weights = mean_weights(readout, level_e, integration_s)
    covariance = covariances_e2(readout, level_e, integration_s, rounding)
    last = readout.readings[-1]
    is_full = last.response * level_e + last.dark_e(integration_s) > last.limit_e
    return np.where(is_full, np.nan, count * weighted_e2(weights, covariance))


def merged_level(
    readout: Readout, level_e: Array, integration_s: float, *, passing: bool = True
) -> MergedLevel:
    """Return mean and variance of the estimate of levels (n,), with the choice of readings by their
    noisy charges.

    The first reading that may be below its last switch decides; more sensitive ones are full, and
    the others have their mean charge. With weights w(z) at the charge that decides, z deviations
    from its mean, and p the covariance of all readings with z, the estimate is normal around
    w(z)·p z, so that one integral over z has its mean and variance. Few full readings pass as
    valid, Φ(-validity_sigmas) of them, but err by all that the limit cuts off.

    passing : whether these count, which are too few for a normal law
    """
    charges_e = _charges_e(readout, level_e, integration_s)
    covariance = covariances_e2(readout, level_e, integration_s)
    numbers = np.arange(len(charges_e))[:, None]
    sigmas_e = _responses(readout) * np.sqrt(np.einsum("kkn->kn", covariance))
    switches_e = _switch_charges_e(readout)
    decides = np.argmax(charges_e - _REACH * sigmas_e < switches_e[:, -1:], axis=0)
    at = decides, np.arange(level_e.size)
    z, density = _normal_nodes(charges_e[at], sigmas_e[at], switches_e[decides].T)

    # Charges and weights of all readings at each charge that decides, (K, panels, n, nodes).
    others_e = np.where(numbers < decides, math.inf, charges_e)[:, None, :, None]
    decides_e = charges_e[at][:, None] + sigmas_e[at][:, None] * z
    node_charges_e = np.where((numbers == decides)[:, None, :, None], decides_e, others_e)
    node_level_e = np.broadcast_to(level_e[:, None], z.shape)
    weights = merge_weights(
        readout, node_charges_e.reshape(len(numbers), -1), integration_s, node_level_e.ravel()
    ).reshape(node_charges_e.shape)

    per_sigma = covariance[:, at[0], at[1]] / np.sqrt(covariance[at[0], at[0], at[1]])
    slope = np.einsum("kpnm,kn->pnm", weights, per_sigma)
    total_e2 = np.einsum("kpnm,kln,lpnm->pnm", weights, covariance, weights)
    bias_e = (density * z * slope).sum(axis=(0, 2))
    square = density * ((z**2 - 1) * slope**2 + total_e2)
    variance_e2 = square.sum(axis=(0, 2)) - bias_e**2
    for number in range(len(numbers) - 1 if passing else 0):
        share, error_e = _passing(readout, level_e, integration_s, number)
        bias_e += share * error_e
        variance_e2 += share * error_e**2
    return MergedLevel(bias_e, variance_e2, (density * weights).sum(axis=(1, 3)))


def _passing(
    readout: Readout, level_e: Array, integration_s: float, number: int
) -> tuple[Array, Array]:
    """Return the share of pixels, (n,), in which a full reading passes as valid by noise and
    offsets behind its limit, and the error of the estimate there.

    number : of the reading
    """
    reading = readout.readings[number]
    adc = reading.readout.adc
    limit_e = reading.limit_e
    below_e = float(_limits_e(readout)[1][number, 0])
    charges_e = _charges_e(readout, level_e, integration_s)
    deviation_e = np.sqrt(np.maximum(charges_e[number], 1.0))
    is_full = scipy.special.ndtr((charges_e[number] - limit_e) / deviation_e)

    # The last code that is valid holds charges up to half a code above it.
    dn_per_e = reading.readout.dn_per_e
    first_invalid_dn = math.ceil(below_e * dn_per_e + adc.black_level_dn)
    end_e = (first_invalid_dn - 0.5 - adc.black_level_dn) / dn_per_e
    spread_e = max(reading.spread_e, 1e-9)
    z = (end_e - limit_e) / spread_e
    passing = float(scipy.special.ndtr(z))

    # Their mean, before it is rounded: of the tail of a normal law.
    density = math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
    read_e = limit_e - spread_e * density / max(passing, _MIN_PASSING)
    charges_e[:number] = math.inf
    charges_e[number] = min(read_e, math.nextafter(below_e, 0.0))
    weight = merge_weights(readout, charges_e, integration_s, level_e)[number]
    estimate_e = (charges_e[number] - reading.dark_e(integration_s)) / reading.response
    return passing * is_full, weight * np.minimum(estimate_e - level_e, 0.0)


def _normal_nodes(charge_e: Array, sigma_e: Array, ends_e: Array) -> tuple[Array, Array]:
    """Return nodes in deviations of a normal charge, (panels, n, nodes), and their weights.

    charge_e, sigma_e : mean and deviation of the charge, (n,)
    ends_e : charges at which panels end, (panels - 1, n)
    """
    inner = np.clip((ends_e - charge_e) / sigma_e, -_REACH, _REACH)
    edges = np.pad(inner, ((1, 0), (0, 0)), constant_values=-_REACH)
    edges = np.pad(edges, ((0, 1), (0, 0)), constant_values=_REACH)
    half = np.diff(edges, axis=0)[..., None] / 2
    z = edges[:-1, :, None] + half * (1 + _NODES)
    density = half * _NODE_WEIGHTS * np.exp(-(z**2) / 2)
    return z, density / density.sum(axis=(0, 2), keepdims=True)


def fixed_patterns_e2(
    readout: Readout, level_e: Array, integration_s: float, weights: Array
) -> tuple[Array, Array]:
    """Return the variances of the estimate over pixels by gains, and by DSNU and offsets, (n,)
    each.

    level_e : mean electrons of light of the first collector in a frame
    integration_s : of a frame
    weights : of the readings, (K, n)
    """
    parts = weights / _responses(readout)
    diodes = [reading.photodiode for reading in readout.readings]
    prnu = _numbers(readout, lambda reading: reading.readout.prnu)
    spread = _numbers(readout, lambda reading: math.hypot(*reading.gain_spreads))
    dsnu = _numbers(readout, lambda reading: reading.readout.dark_spread.deviation)
    current = _numbers(readout, lambda reading: reading.readout.dark_current_e_per_s)
    offset_e = _numbers(readout, lambda reading: reading.readout.burst(readout.exposures).offset_e)
    scatter_e = parts * spread * _charges_e(readout, level_e, integration_s)
    gains_e2 = (scatter_e**2).sum(axis=0) + _sum_shared_e2(weights * prnu * level_e, diodes)
    dark_e2 = _sum_shared_e2(parts * dsnu * current * integration_s, diodes)
    return gains_e2, dark_e2 + _sum_shared_e2(parts * offset_e, diodes)


def _sum_shared_e2(parts_e: Array, sources: Sequence[int]) -> Array:
    """Return the variance of a sum of offsets (K, n), of which those of one source, (K,), are equal
    but for their size.
    """
    is_shared = np.equal.outer(sources, sources).astype(float)
    return np.asarray(np.einsum("kn,kl,ln->n", parts_e, is_shared, parts_e))


def line_variance_e2(
    readout: Readout, signal_e: Array | float, integration_s: float, along: Along
) -> Array | float:
    """Return the variance of the offsets that the pixels of a row, or of a column, share at mean
    electrons of light (...) of a frame; of a pixel that is read once, at all of them.
    """
    if not readout.readings:
        return variance_e2(readout, along=along)
    count = readout.exposures

    def offset_e(reading: Reading) -> float:
        return constant_e(reading.readout.burst(count), along=along) / reading.response

    # Rows have others in each reading, columns those of the photodiode.
    sources = [
        reading.photodiode if along == "column" else number
        for number, reading in enumerate(readout.readings)
    ]

    def at(level_e: Array) -> Array:
        weights = mean_weights(readout, level_e / count, integration_s / count)
        return _sum_shared_e2(weights * _numbers(readout, offset_e), sources)

    return by_level(at, signal_e)


def by_level(function: Callable[[Array], Array], signal_e: Array | float) -> Array:
    """Return a function of levels (n,) at signals (...); of many, interpolated in a table."""
    signal = np.maximum(np.asarray(signal_e, float), 0.0)
    level_e = signal.ravel()
    if level_e.size <= _TABLE_LEVELS:
        return function(level_e).reshape(signal.shape)
    # Between switches the variance is linear in the level, but for squares of fixed pattern.
    brightest_e = max(float(level_e.max()), 1.0)
    level_e = np.append(0.0, np.geomspace(_TABLE_FROM * brightest_e, brightest_e, _TABLE_LEVELS))
    return np.interp(signal, level_e, function(level_e))


def merged_variance_e2(
    readout: Readout,
    signal_e: Array | float,
    integration_s: float,
    *,
    fixed_pattern: bool,
    passing: bool = True,
) -> Array:
    """Return the variance of the estimate of mean electrons of light (...) over frames and, with
    `fixed_pattern`, over sensors.

    Near a switch with the choice by noisy charges, as `merged_level`, which has `passing`; beyond
    the last limit as if nothing clipped.
    """
    count = readout.exposures

    def at(level_e: Array) -> Array:
        moments = merged_level(readout, level_e / count, integration_s / count, passing=passing)
        variance_e2 = count * moments.variance_e2
        if not fixed_pattern:
            return np.asarray(variance_e2)
        patterns_e2 = fixed_patterns_e2(readout, level_e, integration_s, moments.weights)
        return variance_e2 + sum(patterns_e2)

    return by_level(at, signal_e)
