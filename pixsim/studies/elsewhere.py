"""The optimum of a data sheet's sensor on other displays than the chosen one, from the frames of some of its sensors."""

from __future__ import annotations

from dataclasses import replace

from pixsim.base.progress import Progress
from pixsim.sensor.integration import pixels_along
from pixsim.studies.engine import Workers
from pixsim.studies.evaluations import DEGREE, DOTS, Evaluations
from pixsim.studies.preparation import ALLOWED_DOTS
from pixsim.studies.result import Curve, StudyResult, curve_of
from pixsim.studies.series import scenes_of, series_of
from pixsim.studies.viewing import OF_VIEWING, SENSORS_VIEWED, OptimumViewed, ViewingRange
from pixsim.viewer.metrics import DELTA_E

DOTS_FACTOR = 2.0  # of the data sheet's dots to those of larger pixels, and of smaller ones to them


def viewing_of(result: StudyResult) -> ViewingRange:
    """Return the displays of a data sheet's study: half and twice the dots, or half and twice the dots per degree.

    The dots are those of the largest and the smallest pixels at most, and those of a display. Dots that pixsim did not choose are
    stated.
    """
    study, width_um = result.study, result.camera.die_um[1]
    display = study.display
    stated = [name for name in OF_VIEWING if name in display.model_fields_set and (name != "dots" or "dots" not in result.view)]
    tried_um = [float(pitch_um) for curve in result.curves for pitch_um in (curve.pitch_um[0], curve.pitch_um[-1])]
    coarse, fine = (pixels_along(width_um, pitch_um) for pitch_um in (max(tried_um), min(tried_um)))
    low = max(coarse, round(display.dots / DOTS_FACTOR), ALLOWED_DOTS[0])
    high = min(fine, round(display.dots * DOTS_FACTOR), ALLOWED_DOTS[1])
    whole = ViewingRange.of(display, stated, (low, high))
    chosen = whole.chosen
    ends = {min(low, chosen.dots), max(high, chosen.dots)}
    one_moves = [
        each
        for each in whole.viewings
        if each.dots == chosen.dots or (each.samples_per_deg == chosen.samples_per_deg and each.dots in ends)
    ]
    return replace(whole, viewings=tuple(one_moves))


def curves_viewed(result: StudyResult, workers: Workers, progress: Progress | None = None) -> tuple[Curve, ...]:
    """Return the curves of a study without axes with their optima on the displays of `viewing_of`.

    Frames that the cache has are shown again. The others are simulated, with the same random numbers.
    """
    study, viewing = result.study.model_copy(update={"metrics": (DELTA_E.name,)}), viewing_of(result)
    if not result.curves[0].judged_by_delta_e:
        return result.curves
    if not (others := viewing.viewings[1:]):
        return result.curves
    first, *more = [each.display(study.display) for each in others]
    on_first = study.model_copy(update={"display": first})
    scenes = scenes_of(on_first, result.irradiance, result.camera, more)
    series = series_of(on_first, scenes)
    evaluations = Evaluations(series, None, workers)
    samplings = [
        {float(pitch_um): min(int(count), SENSORS_VIEWED) for pitch_um, count in zip(curve.pitch_um, curve.sensors, strict=True)}
        for curve in result.curves
    ]
    viewed: dict[int, tuple[OptimumViewed, ...]] = {}
    with evaluations.resumed(samplings):
        for number, rows in evaluations.rows(samplings, progress):
            found = []
            for each in others:
                own = [row for row in rows if len(others) == 1 or (int(row[DOTS]), float(row[DEGREE])) == each]
                best = curve_of(study, series[number].name, own).optimum
                found.append(OptimumViewed(each, viewing.holds(each), best))
            viewed[number] = tuple(found)
    return tuple(replace(curve, viewed=viewed[number]) for number, curve in enumerate(result.curves))
