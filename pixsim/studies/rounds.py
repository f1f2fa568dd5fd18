"""Which further points the table of a study asks for: new sizes and sensors, which narrow the optimum's interval most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixsim.studies.evaluate import LitCase
from pixsim.studies.optimum import FittedCurve, Posterior, noise_scale, rise_variance
from pixsim.studies.result import Curve, TooFewSizesError, curve_of
from pixsim.studies.settings import Study
from pixsim.studies.sizes import Sampling, Sizes, study_pitches_um
from pixsim.studies.table import DOTS, Table

ROUND = 4  # additions chosen together from one fitted curve
SENSORS_PER_ADDITION = 2  # so that a new pitch shows its own scatter; an existing pitch gets the same number more
# Pitches beyond each end of the interval that are candidates too. The slope at a minimum is measured best somewhat away from
# it: with one such pitch, a tenth of simulated studies stop improving.
BEYOND = 2
MAX_OPEN = 48  # evaluations that a study without a target adds to a curve whose interval has an open end
# A study without a target adds sizes near the best one, one at a time, until half the interval is that short over the size
NEAR_BEST = 0.01
MAX_NEAR_BEST = 8  # of them
MIN_BETWEEN = 0.5  # share of the interval's variance that is due to the curve between the sizes, from which sizes are added
MIN_RATIO = 1.002  # between neighbouring pitches
DIGITS = 4  # of a new pitch, as of a study's first pitches


def next_sensors(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """Return the sensors of each pitch, {µm: sensors}, after a round of additions; unchanged if none is possible.

    Each addition is the one that most lowers the variance of the curve's rise from its minimum to both ends of the interval:
    the interval contains the pitches where that rise is uncertain. The variance of a Gaussian process does not depend on the
    measured values, so it is known before they are measured.

    fit : of the present pitches
    max_sensors : at one pitch
    """
    chosen = dict(sensors)
    for _ in range(ROUND):
        options = additions(fit, chosen, max_sensors)
        if not options:
            break
        pitch_um = min(options, key=lambda pitch: predicted_variance(fit, chosen | {pitch: options[pitch]}))
        chosen[pitch_um] = options[pitch_um]
    return dict(sorted(chosen.items()))


def next_where_open(fit: FittedCurve, sensors: dict[float, int], started: int, max_sensors: int) -> dict[float, int]:
    """Return `next_sensors` for a curve whose interval has an open end; unchanged for others, and at the limit of `MAX_OPEN`.

    A curve that is least at an end of the range has a third of that limit: it may well go on beyond.

    started : evaluations before any was added
    """
    if None not in fit.optimum.interval_um:
        return sensors
    more = next_sensors(fit, sensors, max_sensors)
    limit = started + (MAX_OPEN if fit.optimum.inside else MAX_OPEN // 3)
    return more if sum(more.values()) <= limit else sensors


def next_near_best(fit: FittedCurve, sensors: dict[float, int], sizes: int) -> dict[float, int]:
    """Return the sensors of each pitch after one more near the best, where the interval is long for want of sizes; else unchanged.

    The new pitch, of one sensor, lies in the widest gap between pitches that the interval reaches: at the minimum of the fitted
    curve, but not in the outer quarters of the gap.

    sizes : pitches before any was added
    """
    best = fit.optimum
    low_um, high_um = best.interval_um
    if low_um is None or high_um is None or best.between_sizes_share < MIN_BETWEEN:
        return sensors
    if high_um - low_um <= 2 * NEAR_BEST * best.pitch_um or len(sensors) >= sizes + MAX_NEAR_BEST:
        return sensors

    pitches_um = np.array(sorted(sensors))
    first = max(0, int(np.searchsorted(pitches_um, low_um, side="right")) - 1)
    last = min(pitches_um.size - 1, int(np.searchsorted(pitches_um, high_um)))
    places = fit.places_of(pitches_um)
    left = first + int(np.argmax(np.diff(places[first : last + 1])))
    if pitches_um[left + 1] < MIN_RATIO**2 * pitches_um[left]:
        return sensors

    quarter = (places[left + 1] - places[left]) / 4
    minimum = fit.places_of(np.array([best.pitch_um]))[0]
    is_inside = places[left] < minimum < places[left + 1]
    place = np.clip(minimum, places[left] + quarter, places[left + 1] - quarter) if is_inside else places[left] + 2 * quarter
    pitch_um = round(float(fit.pitches_at(np.array([place]))[0]), DIGITS)
    return dict(sorted((sensors | {pitch_um: 1}).items()))


def additions(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """Return the candidate additions, {µm: new number of sensors}: pitches up to `BEYOND` outside the interval, and midpoints."""
    pitches_um = np.array(sorted(sensors))
    low, high = fit.optimum.interval_um
    first = 0 if low is None else max(0, int(np.searchsorted(pitches_um, low)) - BEYOND)
    stop = pitches_um.size if high is None else int(np.searchsorted(pitches_um, high, side="right")) + BEYOND
    near = pitches_um[first:stop]
    more = {um: min(sensors[um] + SENSORS_PER_ADDITION, max_sensors) for um in near.tolist() if sensors[um] < max_sensors}
    halfway = np.round(fit.pitches_at((fit.places_of(near[:-1]) + fit.places_of(near[1:])) / 2), DIGITS)
    for left, middle, right in zip(near[:-1].tolist(), halfway.tolist(), near[1:].tolist(), strict=True):
        if middle >= MIN_RATIO * left and right >= MIN_RATIO * middle:
            more[middle] = min(SENSORS_PER_ADDITION, max_sensors)
    return more


def predicted_variance(fit: FittedCurve, sensors: dict[float, int]) -> float:
    """Return the variance, summed over both ends of the interval, of the curve's rise from its minimum with so many sensors."""
    pitches_um = np.array(sorted(sensors))
    u = fit.places_of(pitches_um)
    mean = np.interp(u, fit.places, fit.delta_e) / fit.scale
    counts = np.array([sensors[um] for um in pitches_um.tolist()])
    best = fit.likeliest
    noise = np.array([fit.loud.get(um, fit.noise) for um in pitches_um.tolist()])
    design = replace(best.design, u=u, noise=noise * noise_scale(mean, fit.logarithmic), sensors=counts)
    low, high = fit.optimum.interval_um
    ends = np.array([pitches_um[0] if low is None else low, fit.optimum.pitch_um, pitches_um[-1] if high is None else high])
    fit_of_design = Posterior(design, best.stiffness, best.residual, np.zeros(u.size), best.ripple)
    return rise_variance(fit_of_design, fit.places_of(ends))


# --- the rounds of a study --------------------------------------------------------------------------------------------------------


def next_round(study: Study, curves: Sequence[Curve], sampling: Sampling, refine: bool = True) -> Sampling:
    """Return the sampling after a round of additions to each curve; unchanged at a limit.

    A curve whose interval misses `target_ci_um` gets sizes and sensors where they narrow it most. Without a target, so does one
    whose interval has an open end (`next_where_open`), and one whose interval is long for want of sizes near the best
    (`next_near_best`), unless the sizes are a list of the user's.

    refine : whether curves without a target may have additions

    The choice depends on the curves alone, so it is the same on any workers and in a resumed study.
    """
    chosen = dict(sampling)
    for curve in curves:
        sensors = sampling[curve.technology]
        told = {um: sensors[um] for um in curve.pitch_um[curve.told].tolist() if um in sensors}
        sizes, most = len(study_pitches_um(study, curve.technology)), max(study.repeats, study.max_repeats)
        if study.target_ci_um is None:
            if not (refine and study.refine) or study.pitch.values_um is not None:
                continue
            more = next_where_open(curve.fit, told, sizes * study.repeats, most)
            more = next_near_best(curve.fit, told, sizes) if more == told else more
        elif curve.optimum.half_width_um <= study.target_ci_um:
            continue
        else:
            more = next_sensors(curve.fit, told, most)
        more = more if len(told) == len(sensors) else dict(sorted((sensors | more).items()))
        if study.max_evaluations is None:
            within = sum(more.values()) <= sizes * most
        else:
            evaluations = sum(sum(counts.values()) for counts in (chosen | {curve.technology: more}).values())
            within = evaluations <= study.max_evaluations
        if within:
            chosen[curve.technology] = more
    return chosen


@dataclass
class Rounds:
    """The curves of a study's cases, and which further points they ask for, from the tables of its points alone.

    cases : in their light
    is_refined : whether curves without a target may have additions
    """

    cases: Sequence[LitCase]
    is_refined: bool
    _curves: dict[tuple[int, bytes], Curve | str] = field(default_factory=dict, init=False, repr=False)

    def curve(self, number: int, table: Table) -> Curve | str:
        """Return the curve of a case, or why it has none; it is fitted once for the same points."""
        key = number, b"".join(table.columns[name].tobytes() for name in ("pitch_um", "repeat"))
        if key not in self._curves:
            case = self.cases[number].case
            try:
                self._curves[key] = curve_of(case.settings, case.sensor, on_first_display(table), label=self.cases[number].label)
            except TooFewSizesError as error:
                self._curves[key] = str(error)
        return self._curves[key]

    def more(self, tables: Mapping[int, Table]) -> dict[int, Sizes]:
        """Return the sizes and sensors of the cases of a group, with further ones; the same where none are needed.

        tables : of each case
        """
        sizes = {number: sizes_of(table) for number, table in tables.items()}
        curves = {number: self.curve(number, table) for number, table in tables.items()}
        fitted = {number: curve for number, curve in curves.items() if isinstance(curve, Curve)}
        if len(fitted) < len(curves):
            return sizes
        possible = {number: sizes_of(table.possible) for number, table in tables.items()}
        names = {number: self.cases[number].case.sensor for number in tables}
        study = self.cases[min(tables)].case.settings
        sampling = {names[number]: possible[number] for number in tables}
        chosen = next_round(study, list(fitted.values()), sampling, self.is_refined)
        for number, name in names.items():
            if chosen[name] != possible[number]:
                sizes[number] = dict(sorted((sizes[number] | chosen[name]).items()))
        return sizes


def on_first_display(table: Table) -> Table:
    """Return the evaluations of a case on its stated display, which has all repeats."""
    return table.take(table.columns[DOTS] == table.columns[DOTS][0]) if DOTS in table.columns else table


def sizes_of(table: Table) -> Sizes:
    """Return the pixel sizes of a case and the number of sensors of each, from its points."""
    sizes: Sizes = {}
    for pitch_um, repeat in zip(table.columns["pitch_um"].tolist(), table.columns["repeat"].tolist(), strict=True):
        sizes[pitch_um] = max(sizes.get(pitch_um, 0), repeat + 1)
    return sizes
