"""Several readings of a pixel as one estimate of its electrons: weights, variance, bias.

With Q_j the charge of collector j, of response r_j and dark charge D_j, and σ_k the noise of
reading k behind its limit, readings are x_k = Q_j + N(0, σ_k), and estimate the electrons of the
first collector by (x_k - D_j)/r_j. Their covariance is

    C_kl = [same collector] (r μ + D)/r² + [both read the capacitor] D_cap/r² + [k = l] σ_k²/r_k².

Readings of one collector share its electrons: no weights lower their shot noise. A merge chooses
weights by what is valid: x_k below its limit by some σ_k.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.sensor.colour import Layout
from pixsim.sensor.noise import Along, constant_e, variance_e2
from pixsim.sensor.reading import Reading, Readout
from pixsim.sensor.readout_options import ReadoutOptions

_REACH = 6.0  # deviations of a normal law that integrals take in
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(24)
_MIN_PASSING = 1e-12  # of full readings
_UNUSED_E2 = 1e30  # variance of readings that are not valid
_MIN_WEIGHT = 1e-12  # of a valid reading
_TABLE_LEVELS = 2048  # more levels are interpolated in a table: a third of a deviation at 1e5 e-
_TABLE_FROM = 1e-6  # of the brightest level
LINES: tuple[Along, Along] = ("column", "row")  # pixels that share an offset
_NEIGHBOURS = 3  # pixels along a side of the neighbourhood, of one channel


def _valid_below_e(readout: Readout) -> list[float]:
    """Return the charges below which readings are valid; the last one always is."""
    sigmas = readout.merge.validity_sigmas
    below_e = [reading.valid_below_e(sigmas) for reading in readout.readings[:-1]]
    return [*below_e, math.inf]


def _share_of_reading(
    charge_e: Array, reading: Reading, below_e: float, merge: ReadoutOptions
) -> NDArray[Any]:
    """Return the share, 0 to 1, that a reading has of what less sensitive ones would have, where
    all more sensitive ones are not valid.
    """
    is_valid = charge_e < below_e
    if merge.merge != "blend" or math.isinf(below_e):
        return np.asarray(is_valid)

    from_e, to_e = (
        share * reading.limit_e for share in (merge.blend_from_share, merge.blend_to_share)
    )
    return np.asarray(np.clip((to_e - charge_e) / (to_e - from_e), 0.0, 1.0) * is_valid)


def _shares(readout: Readout, charges_e: Sequence[Array]) -> list[NDArray[Any]]:
    """Return `_share_of_reading` of all readings, (...) each; the last one has a share of 1.

    charges_e : of each reading with its dark charge, (...)
    """
    return [
        _share_of_reading(charge_e, reading, below_e, readout.merge)
        for charge_e, reading, below_e in zip(
            charges_e, readout.readings, _valid_below_e(readout), strict=True
        )
    ]


def merge_weights(
    readout: Readout, charges_e: Sequence[Array], integration_s: float, pilot_e: Array | None
) -> list[Array]:
    """Return the weights of the readings, (...) each, whose sum is 1.

    charges_e : of each reading with its dark charge, (...)
    integration_s : of one exposure
    pilot_e : electrons of the first collector, for 'max_likelihood'; else None
    """
    shares = _shares(readout, charges_e)
    if pilot_e is not None:
        return _likelihood_weights(readout, shares, pilot_e, integration_s)

    weights = []
    left: Array | float = 1.0
    for share in shares:
        weights.append(left * share)
        left = left * (1.0 - share)
    return weights


def _likelihood_weights(
    readout: Readout, valid: Sequence[Array], level_e: Array, integration_s: float
) -> list[Array]:
    """Return C⁻¹1/(1ᵀC⁻¹1) of the valid readings, (...) each.

    valid : 1 or 0 for each reading, (...)
    level_e : electrons of the first collector, (...)
    """
    covariance = covariances_e2(readout, np.maximum(level_e, 0.0).ravel(), integration_s)
    matrices = np.moveaxis(covariance, 2, 0)
    for number, is_valid in enumerate(valid):
        matrices[:, number, number] += np.where(is_valid.ravel(), 0.0, _UNUSED_E2)
    solved = np.linalg.solve(matrices, np.ones((*matrices.shape[:2], 1)))[..., 0]
    weights = solved / solved.sum(axis=1, keepdims=True)
    return [weight.reshape(level_e.shape) for weight in weights.T]


def charges_of_codes_e(readout: Readout, codes: Sequence[NDArray[Any]]) -> list[Array]:
    """Return the charges of the codes of readings, with dark charge, (...) each."""
    return [
        (reading.readout.adc.levels_of(code) - reading.readout.adc.black_level_dn)
        / reading.readout.dn_per_e
        for code, reading in zip(codes, readout.readings, strict=True)
    ]


def _estimates_e(readout: Readout, charges_e: Sequence[Array], integration_s: float) -> list[Array]:
    """Return the electrons of the first collector by each reading alone, (...) each."""
    return [
        (charge_e - reading.dark_e(integration_s)) / reading.response
        for charge_e, reading in zip(charges_e, readout.readings, strict=True)
    ]


def merged_e(readout: Readout, charges_e: Sequence[Array], integration_s: float) -> Array:
    """Return the estimate of the electrons of the first collector, (rows, columns).

    charges_e : of each reading with its dark charge, (rows, columns)
    integration_s : of one exposure
    """
    estimates_e = _estimates_e(readout, charges_e, integration_s)
    if readout.merge.merge == "max_likelihood":
        weights = frame_weights(readout, charges_e, integration_s)
        return np.asarray(
            sum(weight * part_e for weight, part_e in zip(weights, estimates_e, strict=True))
        )
    return _nested(_shares(readout, charges_e), estimates_e)


def _nested(shares: Sequence[NDArray[Any]], estimates_e: Sequence[Array]) -> Array:
    """Return estimates with the share of each in what the later ones make, (...)."""
    estimate_e = estimates_e[-1]
    for share, part_e in zip(shares[-2::-1], estimates_e[-2::-1], strict=True):
        if share.dtype == bool:
            estimate_e = np.where(share, part_e, estimate_e)
        else:
            estimate_e = estimate_e + share * (part_e - estimate_e)
    return estimate_e


def frame_weights(
    readout: Readout, charges_e: Sequence[Array], integration_s: float
) -> list[Array]:
    """Return the weights of readings in a frame, (rows, columns) each, as `merged_e` has them.

    The pilot of 'max_likelihood' is the mean over neighbours of the most sensitive valid readings.
    """
    pilot_e = None
    if readout.merge.merge == "max_likelihood":
        estimates_e = _estimates_e(readout, charges_e, integration_s)
        selected_e = _nested(_shares(readout, charges_e), estimates_e)
        pilot_e = _neighbourhood_means(selected_e, readout.physics.layout)
    return merge_weights(readout, charges_e, integration_s, pilot_e)


def _neighbourhood_means(picture: Array, layout: Layout | None) -> Array:
    """Return the means over neighbours of the same channel, (rows, columns)."""
    steps = (1, 1)
    planes = 1
    if layout is not None:
        planes = layout.planes
        steps = layout.period
    means = np.empty(picture.shape)
    for plane, mean in zip(
        np.array_split(picture, planes), np.array_split(means, planes), strict=True
    ):
        for row in range(steps[0]):
            for column in range(steps[1]):
                part = slice(row, None, steps[0]), slice(column, None, steps[1])
                mean[part] = scipy.ndimage.uniform_filter(plane[part], _NEIGHBOURS, mode="nearest")
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
    covariance = np.zeros((len(readings), len(readings), level_e.size))
    for row, first in enumerate(readings):
        for column, second in enumerate(readings):
            if first.collector != second.collector:
                continue
            capacitor_e = first.capacitor_e(integration_s)
            shared_e2 = first.response * level_e + first.dark_e(integration_s) - capacitor_e
            if first.overflow and second.overflow:
                shared_e2 = shared_e2 + capacitor_e
            if row == column:
                shared_e2 = shared_e2 + first.noise_e**2
                if rounding:
                    charge_e = first.response * level_e + first.dark_e(integration_s)
                    shared_e2 = shared_e2 + first.rounding_e2(charge_e)
            covariance[row, column] = shared_e2 / (first.response * second.response)
    return covariance


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


def mean_weights(readout: Readout, level_e: Array, integration_s: float, first: int = 0) -> Array:
    """Return the weights, (K, n), that a merge of the readings from `first` on has where each has
    its mean charge; one reading alone for a merge of one.
    """
    charges_e = [
        reading.response * level_e + reading.dark_e(integration_s) for reading in readout.readings
    ]
    for number in range(first):
        charges_e[number] = np.full(level_e.shape, math.inf)
    pilot_e = level_e if readout.merge.merge == "max_likelihood" else None
    return np.stack(merge_weights(readout, charges_e, integration_s, pilot_e))


def _switch_charges_e(readout: Readout) -> list[list[float]]:
    """Return the charges of each reading at which its share has a step or a kink, rising."""
    merge = readout.merge
    shares = (merge.blend_from_share, merge.blend_to_share) if merge.merge == "blend" else ()
    ends_e = [
        sorted([below_e, *(share * reading.limit_e for share in shares)])
        for reading, below_e in zip(readout.readings, _valid_below_e(readout), strict=True)
    ]
    return [*ends_e[:-1], [math.inf]]


def switch_levels_e(readout: Readout, integration_s: float) -> list[float]:
    """Return the levels at which the merge of the mean charges changes its readings, rising.

    integration_s : of one exposure
    """
    return sorted(
        (charge_e - reading.dark_e(integration_s)) / reading.response
        for reading, charges_e in zip(readout.readings, _switch_charges_e(readout), strict=True)
        for charge_e in charges_e[: None if math.isfinite(charges_e[-1]) else -1]
    )


def _sum_e2(weights: Array, covariance: Array) -> Array:
    return np.asarray(np.einsum("kn,kln,ln->n", weights, covariance, weights))


def level_variance_e2(
    readout: Readout, level_e: Array, integration_s: float, *, rounding: bool = True
) -> Array:
    """Return the temporal variance of the estimate of levels (n,), with the weights of the mean;
    NaN beyond the limit of the last reading.

    level_e : mean electrons of light of the first collector in an exposure
    """
    weights = mean_weights(readout, level_e, integration_s)
    covariance = covariances_e2(readout, level_e, integration_s, rounding)
    last = readout.readings[-1]
    is_full = last.response * level_e + last.dark_e(integration_s) > last.limit_e
    return np.where(is_full, np.nan, _sum_e2(weights, covariance))


def merged_level(
    readout: Readout, level_e: Array, integration_s: float, *, passing: bool = True
) -> MergedLevel:
    """Return mean and variance of the estimate of levels (n,), with the choice of readings by their
    noisy charges.

    At a switch the estimate is B + a(x)(A - B): x the charge that decides, a its share, A and B
    sums of readings with it and without it. All are normal, so that one integral over x has mean
    and variance; the bias is E[a′] cov(x, A - B) (Stein, Ann. Stat. 9 (1981) 1135). Few full
    readings pass as valid, Φ(-validity_sigmas) of them, but err by all that the limit cuts off.

    passing : whether these count, which are too few for a normal law
    """
    readings = readout.readings
    below_e = _valid_below_e(readout)
    covariance = covariances_e2(readout, level_e, integration_s)
    count = len(readings)
    bias_e = np.zeros(level_e.size)
    variance_e2 = np.zeros(level_e.size)
    weights = np.zeros((count, level_e.size))
    is_open = np.ones(level_e.size, bool)
    for number, ends_e in enumerate(_switch_charges_e(readout)):
        reading = readings[number]
        sigma_e = reading.response * np.sqrt(covariance[number, number])
        charge_e = reading.response * level_e + reading.dark_e(integration_s)
        decides = is_open & (charge_e - _REACH * sigma_e < ends_e[-1])
        is_open = is_open & ~decides
        part = np.flatnonzero(decides)
        if not part.size:
            continue

        without_e = mean_weights(readout, level_e[part], integration_s, min(number + 1, count - 1))
        with_e = _weights_with(readout, level_e[part], integration_s, number, without_e)
        z, density = _normal_nodes(charge_e[part], sigma_e[part], ends_e)
        share = _share_of_reading(
            charge_e[part, None] + sigma_e[part, None] * z, reading, below_e[number], readout.merge
        )

        # Weights at each charge, their slope with it, and the variance that it leaves.
        merged = without_e[:, None, :, None] + share * (with_e - without_e)[:, None, :, None]
        part_covariance = covariance[:, :, part]
        per_sigma = part_covariance[number] / np.sqrt(part_covariance[number, number])
        slope = np.einsum("kpnm,kn->pnm", merged, per_sigma)
        total_e2 = np.einsum("kpnm,kln,lpnm->pnm", merged, part_covariance, merged)
        bias_e[part] = (density * z * slope).sum(axis=(0, 2))
        square = density * ((z**2 - 1) * slope**2 + total_e2)
        variance_e2[part] = square.sum(axis=(0, 2)) - bias_e[part] ** 2
        weights[:, part] = (density * merged).sum(axis=(1, 3))

    for number in range(count - 1 if passing else 0):
        share_passing, error_e = _passing(readout, level_e, integration_s, number, below_e[number])
        bias_e += share_passing * error_e
        variance_e2 += share_passing * error_e**2
    return MergedLevel(bias_e, variance_e2, weights)


def _passing(
    readout: Readout, level_e: Array, integration_s: float, number: int, below_e: float
) -> tuple[Array, Array]:
    """Return the share of pixels, (n,), in which a full reading passes as valid by noise and
    offsets behind its limit, and the error of the estimate there.

    number : of the reading
    below_e : charge of its codes below which it is valid
    """
    reading = readout.readings[number]
    charge_e = reading.response * level_e + reading.dark_e(integration_s)
    is_full = scipy.special.ndtr((charge_e - reading.limit_e) / np.sqrt(np.maximum(charge_e, 1.0)))

    # The last code that is valid holds charges up to half a code above it.
    black_dn = reading.readout.adc.black_level_dn
    dn_per_e = reading.readout.dn_per_e
    first_invalid_dn = math.ceil(below_e * dn_per_e + black_dn)
    end_e = (first_invalid_dn - 0.5 - black_dn) / dn_per_e
    spread_e = max(reading.spread_e, 1e-9)
    z = (end_e - reading.limit_e) / spread_e
    passing = float(scipy.special.ndtr(z))
    if passing < _MIN_PASSING:
        return np.zeros(level_e.shape), np.zeros(level_e.shape)

    density = math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
    read_e = np.array([reading.limit_e - spread_e * density / passing])
    read_e = np.minimum(read_e, np.nextafter(below_e, 0.0))  # before it was rounded
    share = float(_share_of_reading(read_e, reading, below_e, readout.merge)[0])
    without_e = mean_weights(readout, level_e, integration_s, number + 1)
    with_e = _weights_with(readout, level_e, integration_s, number, without_e)
    estimate_e = (read_e - reading.dark_e(integration_s)) / reading.response
    return passing * is_full, share * with_e[number] * np.minimum(estimate_e - level_e, 0.0)


def _weights_with(
    readout: Readout, level_e: Array, integration_s: float, number: int, others: Array
) -> Array:
    """Return the weights of the readings from `number` on, where that one is valid, (K, n).

    others : the weights where it is not
    """
    alone = np.zeros(others.shape)
    alone[number] = 1.0
    if readout.merge.merge != "max_likelihood":
        return alone
    valid = [
        np.full(level_e.shape, float(index == number)) + (others[index] > _MIN_WEIGHT)
        for index in range(len(readout.readings))
    ]
    return np.stack(_likelihood_weights(readout, valid, level_e, integration_s))


def _normal_nodes(charge_e: Array, sigma_e: Array, ends_e: Sequence[float]) -> tuple[Array, Array]:
    """Return nodes in deviations of a normal charge, (panels, n, nodes), and their weights.

    charge_e, sigma_e : mean and deviation of the charge, (n,)
    ends_e : charges at which panels end
    """
    inner = [np.clip((end_e - charge_e) / sigma_e, -_REACH, _REACH) for end_e in ends_e]
    lowest = np.full(charge_e.shape, -_REACH)
    edges = np.stack([lowest, *inner, -lowest])
    half = np.diff(edges, axis=0)[..., None] / 2
    z = edges[:-1, :, None] + half * (1 + _NODES)
    density = half * _NODE_WEIGHTS * np.exp(-(z**2) / 2)
    return z, density / density.sum(axis=(0, 2), keepdims=True)


def fixed_pattern_e2(
    readout: Readout, level_e: Array, integration_s: float, weights: Array
) -> Array:
    """Return the variance of the estimate over pixels by gain, DSNU and offsets, (n,).

    level_e : mean electrons of light of the first collector in a frame
    integration_s : of a frame
    weights : of the readings, (K, n)
    """
    readings = readout.readings
    frames = [reading.readout.burst(readout.exposures) for reading in readings]
    response = np.array([reading.response for reading in readings])[:, None]
    diodes = np.array([reading.photodiode for reading in readings])
    gain = np.array([frame.prnu for frame in frames])[:, None] * level_e
    dark = [frame.dark_spread.deviation * frame.dark_current_e_per_s for frame in frames]
    offset = [frame.offset_e for frame in frames]
    patterns_e = gain, integration_s * np.array(dark)[:, None] / response
    dark_e = np.array([reading.dark_e(integration_s) for reading in readings])[:, None]
    spread = np.array([math.hypot(*reading.gain_spreads) for reading in readings])[:, None]
    scatter_e = weights * spread * (level_e + dark_e / response)
    return np.asarray(
        (scatter_e**2).sum(axis=0)
        + sum(
            _sum_shared_e2(weights * pattern_e, diodes)
            for pattern_e in (*patterns_e, np.array(offset)[:, None] / response)
        )
    )


def _sum_shared_e2(parts_e: Array, sources: NDArray[np.int_]) -> Array:
    """Return the variance of a sum of offsets (K, n), of which those of one source (K,) are
    equal but for their size.
    """
    is_shared = (sources[:, None] == sources).astype(float)
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
    offsets_e = np.array(
        [
            constant_e(reading.readout.burst(count), along=along) / reading.response
            for reading in readout.readings
        ]
    )
    if not offsets_e.any():
        return 0.0
    # Rows have others in each reading, columns those of the photodiode.
    sources = np.arange(offsets_e.size)
    if along == "column":
        sources = np.array([reading.photodiode for reading in readout.readings])

    def at(level_e: Array) -> Array:
        weights = mean_weights(readout, level_e / count, integration_s / count)
        return _sum_shared_e2(weights * offsets_e[:, None], sources)

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
        return variance_e2 + fixed_pattern_e2(readout, level_e, integration_s, moments.weights)

    return by_level(at, signal_e)


def estimated_variance_e2(
    readout: Readout, estimate_e: Array, integration_s: float, weights: Sequence[Array]
) -> Array:
    """Return the variance of an estimate (rows, columns) by the estimate itself, as if the weights
    were not chosen by it.

    weights : of each reading, (rows, columns)
    """
    count = readout.exposures
    level_e = np.maximum(estimate_e, 0.0).ravel() / count
    covariance = covariances_e2(readout, level_e, integration_s / count)
    stacked = np.stack([weight.ravel() for weight in weights])
    return count * _sum_e2(stacked, covariance).reshape(estimate_e.shape)
