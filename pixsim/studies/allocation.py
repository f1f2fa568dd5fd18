"""Where more evaluations narrow the interval of the optimum most: other pitches, or more sensors of the present ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixsim.studies.optimum import FittedCurve, Posterior

ROUND = 4  # additions that are chosen together, from one curve
SENSORS_AN_ADDITION = 2  # of a new pitch, so that it tells its own scatter; the same number more of a present one
# Pitches beyond either end of the interval that may have more. The slope of a curve at its minimum is measured best somewhat
# away from it: with one such pitch a tenth of simulated studies stick where they are.
BEYOND = 2
MIN_RATIO = 1.002  # between neighbouring pitches
DIGITS = 4  # of a pitch, as those that a study begins with


def next_sensors(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """Sensors of each pitch, {µm: sensors}, after a round of additions to the present ones; the same where none is possible.

    Each addition is the one that most lowers the variance of what the curve rises by from its minimum to both ends of the
    interval: what that rise leaves open is what the interval holds. The variance of a Gaussian process does not depend on
    what will be measured, so that the choice can be made before it is.

    fit : of the present pitches
    max_sensors : at one pitch
    """
    chosen = dict(sensors)
    for _ in range(ROUND):
        options = additions(fit, chosen, max_sensors)
        if not options:
            break
        pitch_um = min(options, key=lambda each: rise_variance(fit, chosen | {each: options[each]}))
        chosen[pitch_um] = options[pitch_um]
    return dict(sorted(chosen.items()))


def additions(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """What one addition may make of a pitch, {µm: sensors}: within the interval and `BEYOND`, and halfway between those."""
    pitches_um = np.array(sorted(sensors))
    low, high = fit.optimum.interval_um
    first = 0 if low is None else max(0, int(np.searchsorted(pitches_um, low)) - BEYOND)
    stop = pitches_um.size if high is None else int(np.searchsorted(pitches_um, high, side="right")) + BEYOND
    near = pitches_um[first:stop]
    more = {each: min(sensors[each] + SENSORS_AN_ADDITION, max_sensors) for each in near.tolist() if sensors[each] < max_sensors}
    halfway = np.round(fit.pitches_at((fit.places_of(near[:-1]) + fit.places_of(near[1:])) / 2), DIGITS)
    for left, middle, right in zip(near[:-1].tolist(), halfway.tolist(), near[1:].tolist(), strict=True):
        if middle >= MIN_RATIO * left and right >= MIN_RATIO * middle:
            more[middle] = min(SENSORS_AN_ADDITION, max_sensors)
    return more


def rise_variance(fit: FittedCurve, sensors: dict[float, int]) -> float:
    """Variance of the curve at both ends of the interval over that at its minimum, were so many sensors measured."""
    pitches_um = np.array(sorted(sensors))
    u = fit.places_of(pitches_um)
    mean = np.interp(u, fit.places_of(fit.pitch_um), fit.delta_e) / fit.scale
    counts = np.array([sensors[each] for each in pitches_um.tolist()])
    best = fit.likeliest
    design = replace(best.design, u=u, noise=fit.noise * mean**2, sensors=counts)
    low, high = fit.optimum.interval_um
    ends = np.array([pitches_um[0] if low is None else low, fit.optimum.pitch_um, pitches_um[-1] if high is None else high])
    covariance = Posterior(design, best.stiffness, best.residual, np.zeros(u.size)).covariance(fit.places_of(ends))
    rises = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
    return float(sum(contrast @ covariance @ contrast for contrast in rises))
