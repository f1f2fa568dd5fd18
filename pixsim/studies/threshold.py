"""The value of a parameter of the scene at which a target is just seen: its contrast, its size or the light, in one run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import scipy  # whose parts are imported when they are used

from pixsim.base.caller import parameter, setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.progress import Progress
from pixsim.scene.scene import Scene
from pixsim.studies.budget import without_warnings
from pixsim.studies.cases import Job
from pixsim.studies.oversampling import Demand, Light, without_target
from pixsim.studies.preparation import loaded_scene, scene_with_view
from pixsim.viewer.judged import Judged, Judging
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.raw_metrics import DETECTABILITY
from pixsim.viewer.score import make_imaging_chain
from pixsim.viewer.setting import Run

SOUGHT = "metric.detectability.solve_for"
WITHIN = 1e-3  # relative, of the value that is found
WIDEST_STEP = math.log(8.0)  # of a value's logarithm, on the way to the threshold
SLOWEST = 2.2  # of the logarithm of a value, that of d′ is half or more: it grows at least as the root of the light
MAX_STEPS, MOST_RENDERS = 9, 16
LEAST = 1e-6  # in place of a d′ of 0


@dataclass(frozen=True)
class Threshold:
    """Where a target is just seen.

    parameter : of the scene
    threshold : d′ at which it is seen
    value : of the parameter, at which d′ is the threshold; None if none was found
    tried : values from the first one on, before they lay on both sides of the threshold
    reason : why none was found; empty if one was, or if the last value tried is not enough
    """

    parameter: str
    threshold: float
    value: float | None
    tried: tuple[float, ...]
    reason: str = ""

    @property
    def words(self) -> str:
        """What a run says of it."""
        if self.value is not None:
            return f"{self.threshold:g} is reached at {self.parameter} = {self.value:.4g}"
        tried = " to ".join(f"{each:.4g}" for each in (min(self.tried), max(self.tried)))
        return f"{self.threshold:g} is not reached at {self.parameter} of {tried}" + (f": {self.reason}" if self.reason else "")

    def as_dict(self) -> dict[str, Any]:
        """Return it as in score.json."""
        return {"parameter": self.parameter, "detectability": self.threshold, "value": self.value, "why_not": self.reason}


def start_of(settings: Run, source: Scene | object) -> float | None:
    """Return the value of the parameter that a run looks for, with which it starts; None if it looks for none.

    Raises PixsimError for light that is given, and for a parameter without a number.
    """
    name = settings.metric.detectability.solve_for
    if name is None or DETECTABILITY.name not in settings.metrics:
        return None
    if not isinstance(source, Scene):
        raise invalid(setting(SOUGHT), f"'{name}' for light that is given", "a parameter of a scene, which is rendered again")
    stated = settings.scene.get(name, source.text().defaults.get(name))
    try:
        start = float(stated) if stated is not None else math.nan
    except ValueError:
        start = math.nan
    if not math.isfinite(start) or not start:
        got = f"'{name}', of which the value {stated} is stated" if stated is not None else f"'{name}', of which no value is stated"
        allowed = f"a parameter of {source.path.name} with a number other than 0, from which the search starts"
        raise invalid(setting(SOUGHT), got, allowed, f"As contrast, size_mm or lux: {parameter('lux', '100')}.")
    return start


def threshold_of(job: Job[Run], demand: Demand, light: Light, d_prime: float, progress: Progress | None = None) -> Threshold:
    """Return where d′ of the target is the threshold, from scenes that are rendered again on the film of the run.

    d′ rises with a size, a contrast and the light, between their root and their square: the search goes on from value to value
    until the threshold lies between two of them, and then closes in on it.

    job : a run that asks for it
    demand, light : of the run
    d_prime : of the run
    """
    settings, options, case = job.settings, job.settings.metric.detectability, job.cases[0]
    name, start = options.solve_for, start_of(settings, case.scene)
    assert name is not None
    assert start is not None
    judging = Judging(metrics_named([DETECTABILITY.name]), settings.metric)
    of_sensor = settings.pixel, settings.exposure, settings.display, False, settings.correction, settings.develop
    across = light.image.shape[1]
    load = partial(
        loaded_scene,
        str(case.scene.path),
        resolution=None,
        display=settings.display,
        variant=case.scene.choice.variant,
        sensor=job.sensor,
    )

    at: dict[float, float] = {}  # logarithm of d′ over the threshold, by that of the value over the first one

    def excess(away: float) -> float:
        if away not in at:
            scene = scene_with_view(load(parameters=settings.scene | {name: start * math.exp(away)}), job.view)
            scene = scene.with_resolution(across)
            image, _ = demand.render(scene, demand.plan_of(scene))
            without = without_target(replace(demand, scene=scene), across)
            chain = make_imaging_chain(image, demand.camera, *of_sensor, judging=judging, without=without)
            found = DETECTABILITY.compute(Judged(chain, chain.capture("threshold", settings.seed), judging))[0]
            at[away] = math.log(max(found, LEAST) / options.threshold)
            if progress:
                progress(len(at) / MOST_RENDERS)
        return at[away]

    away, tried, limit, value, reason = 0.0, [start], math.inf, None, ""
    at[away] = math.log(max(d_prime, LEAST) / options.threshold)
    with without_warnings():
        while len(tried) < MAX_STEPS and (min(at.values()) > 0 or max(at.values()) < 0):
            step = -min(max(SLOWEST * at[away], -WIDEST_STEP), WIDEST_STEP)
            step = math.copysign(min(abs(step), abs(limit - away) / 2), step)  # towards what the scene cannot be, half way
            tried.append(start * math.exp(away + step))
            try:
                excess(away + step)
                away += step
            except PixsimError as error:
                limit, reason = away + step, str(error)
        if min(at.values()) <= 0 <= max(at.values()):
            low = max((each for each in at if at[each] <= 0), key=at.__getitem__)
            high = min((each for each in at if at[each] >= 0), key=at.__getitem__)
            value, reason = start * math.exp(low if low == high else scipy.optimize.brentq(excess, low, high, xtol=WITHIN)), ""
    return Threshold(name, options.threshold, value, tuple(tried), reason)
