"""The optimum of a data sheet's sensor on displays with half and twice the dots, from the frames of some of its sensors."""

from __future__ import annotations

from dataclasses import replace

from pixsim.base.progress import Progress
from pixsim.studies.displays import SENSORS_CHECKED, DisplayOptimum, other_displays
from pixsim.studies.engine import Workers
from pixsim.studies.evaluations import DOTS, Evaluations
from pixsim.studies.result import Curve, StudyResult, curve_of
from pixsim.studies.series import scenes_of, series_of
from pixsim.viewer.metrics import DELTA_E


def curves_on_displays(result: StudyResult, workers: Workers, progress: Progress | None = None) -> tuple[Curve, ...]:
    """Return the curves of a study without axes with their optima on `other_displays`; unchanged if ΔE does not judge them.

    Frames that the cache has are shown again. The others are simulated, with the same random numbers.
    """
    if not result.curves[0].judged_by_delta_e:
        return result.curves

    study = result.study.model_copy(update={"metrics": (DELTA_E.name,)})
    first, *more = [display for display in other_displays(study.display) if display != study.display]
    on_first = study.model_copy(update={"display": first})
    series = series_of(on_first, scenes_of(on_first, result.irradiance, result.camera, more))
    evaluations = Evaluations(series, None, workers)
    samplings = [
        {float(pitch_um): min(int(count), SENSORS_CHECKED) for pitch_um, count in zip(curve.pitch_um, curve.sensors, strict=True)}
        for curve in result.curves
    ]

    optima: dict[int, tuple[DisplayOptimum, ...]] = {}
    with evaluations.resumed(samplings):
        for number, rows in evaluations.rows(samplings, progress):
            on_displays = []
            for display in (first, *more):
                display_rows = [row for row in rows if not more or int(row[DOTS]) == display.dots]
                curve = curve_of(study, series[number].name, display_rows)
                on_displays.append(DisplayOptimum(display.dots, curve.optimum))
            optima[number] = tuple(on_displays)
    return tuple(replace(curve, on_displays=optima[number]) for number, curve in enumerate(result.curves))
