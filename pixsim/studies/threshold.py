"""The value of a parameter of the scene at which a target is just seen: its contrast, its size or the light, in one run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import Any

import scipy  # whose parts are imported when they are used

from pixsim.base.caller import parameter, setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.notes import without_warnings
from pixsim.base.progress import Progress
from pixsim.scene.scene import Scene
from pixsim.studies.lights import Light, without_target
from pixsim.studies.prepare import Job, loaded_scene, scene_with_view
from pixsim.viewer.raw_metrics import DETECTABILITY
from pixsim.viewer.scene_light import SceneLight
from pixsim.viewer.setting import Run

SOUGHT = "metric.detectability.solve_for"
WITHIN = 1e-3  # relative, of the value that is found
WIDEST_STEP = math.log(8.0)  # of a value's logarithm, on the way to the threshold
SLOWEST = 2.2  # of the logarithm of a value, that of d′ is half or more: it grows at least as the root of the light
MAX_STEPS, MOST_RENDERS = 9, 24  # on the way to a value on the other side of the threshold; of the whole search
UPWARD_STEPS = 3  # from the last value that is seen, up to 512 times as much: beyond it a target may be too bright
LEAST = 1e-6  # in place of a d′ of 0


@dataclass(frozen=True)
class Threshold:
    """Where a target is just seen.

    parameter : of the scene
    threshold : d′ at which it is seen
    value : of the parameter, from which on d′ is the threshold or more; None if none was found
    upper_value : beyond which d′ is below the threshold again, as of light that fills the pixels; None if none was found
    tried : values from the first one on, before they lay on both sides of the threshold
    reason : why none was found; empty if one was, or if the last value tried is not enough
    """

    parameter: str
    threshold: float
    value: float | None
    tried: tuple[float, ...]
    reason: str = ""
    upper_value: float | None = None

    @property
    def words(self) -> str:
        """What a run says of it."""
        reached = f"{self.threshold:g} is reached at {self.parameter}"
        match self.value, self.upper_value:
            case float(low), float(high):
                return f"{reached} of {low:.4g} to {high:.4g}"
            case float(low), None:
                return f"{reached} = {low:.4g}"
            case None, float(high):
                return f"{reached} up to {high:.4g}"
        tried = " to ".join(f"{each:.4g}" for each in (min(self.tried), max(self.tried)))
        return f"{self.threshold:g} is not reached at {self.parameter} of {tried}" + (f": {self.reason}" if self.reason else "")

    def as_dict(self) -> dict[str, Any]:
        """Return it as in score.json."""
        return {
            "parameter": self.parameter,
            "detectability": self.threshold,
            "value": self.value,
            "upper_value": self.upper_value,
            "why_not": self.reason,
        }


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


def threshold_of(
    job: Job[Run], light: Light, d_prime: float, d_prime_in: Callable[[SceneLight], float], progress: Progress | None = None
) -> Threshold:
    """Return where d′ of the target is the threshold, from scenes that are rendered again on the film of the run.

    d′ rises with a size, a contrast and the light, between their root and their square, until pixels are full; then it falls. The
    search climbs from the first value until d′ is the threshold or more, goes on from there to both sides until it is less, and
    closes in on the values between.

    job : a run that asks for it
    light : of the run
    d_prime : of the run
    d_prime_in : returns d′ of the run's sensor in another light
    """
    settings, options, case = job.settings, job.settings.metric.detectability, job.cases[0]
    name, start = options.solve_for, start_of(settings, case.scene)
    assert name is not None
    assert start is not None
    request, across = job.request, light.image.shape[1]
    load = partial(
        loaded_scene,
        str(case.scene.path),
        resolution=None,
        display=settings.display,
        variant=case.scene.choice.variant,
        sensor=job.sensor,
    )

    number = count(1)

    def excess(away: float) -> float:
        """Return the logarithm of d′ over the threshold, at a logarithm of the value over the first one."""
        scene = scene_with_view(load(parameters=settings.scene | {name: start * math.exp(away)}), job.view)
        scene = scene.with_resolution(across)
        image, _ = request.render(scene, request.plan_of(scene))
        background = without_target(replace(request, scene=scene), across)
        if progress:
            progress(min(next(number) / MOST_RENDERS, 1.0))
        return logarithm(d_prime_in(SceneLight(image, background)))

    def logarithm(d_prime: float) -> float:
        return math.log(max(d_prime, LEAST) / options.threshold)

    with without_warnings():
        search = Search(excess, {0.0: logarithm(d_prime)})
        low, high = search.seen()

    values = [start * math.exp(away) for away in search.tried]
    reason = ""
    if low is None and high is None:
        best = search.best
        if search.at[best] >= 0:
            reason = "d′ is above it at all of them"
        elif min(search.at) < best < max(search.at):
            most = options.threshold * math.exp(search.at[best])
            reason = f"d′ is at most {most:.3g}, at {start * math.exp(best):.4g}"
        else:
            reason = search.why_not
    value, upper_value = (None if away is None else start * math.exp(away) for away in (low, high))
    return Threshold(name, options.threshold, value, tuple(values), reason, upper_value)


class Search:
    """Where a function that rises, and may fall beyond a maximum, is 0 or more, from few of its values.

    function : of a logarithm; it raises PixsimError for what cannot be
    at : its values that are known, of one argument at least
    """

    def __init__(self, function: Callable[[float], float], at: dict[float, float]) -> None:
        self.function = function
        self.at = at
        self.tried = list(at)
        self.limits = {-1: -math.inf, 1: math.inf}  # what cannot be, by the direction
        self.why_not = ""

    @property
    def best(self) -> float:
        """Where its greatest value so far is; the lowest argument of several."""
        return max(self.at, key=lambda away: (self.at[away], -away))

    def seen(self) -> tuple[float | None, float | None]:
        """Return the ends of the range in which it is 0 or more; None for an end that was not found."""
        self.climb()
        if self.at[self.best] < 0:
            return None, None
        return self.end(-1, MAX_STEPS), self.end(1, UPWARD_STEPS)

    def climb(self) -> None:
        """Evaluate until it is 0 or more somewhere: up first, down from where it falls, then around its maximum."""
        for _ in range(MAX_STEPS):
            best = self.best
            lower, upper = ([away for away in self.at if (away - best) * sign > 0] for sign in (-1, 1))
            if self.at[best] >= 0:
                return
            if not upper:
                self.step(best, 1, min(-SLOWEST * self.at[best], WIDEST_STEP))
            elif not lower:
                self.step(best, -1, WIDEST_STEP)
            else:
                gaps = best - max(lower), min(upper) - best
                self.step(best, 1 if gaps[1] >= gaps[0] else -1, max(gaps) / 2)

    def end(self, direction: int, steps: int) -> float | None:
        """Return where it crosses 0 beyond all arguments at which it is more, in a direction; None if it does in no step."""
        for number in range(steps + 1):
            inner = direction * max(direction * away for away in self.at if self.at[away] >= 0)
            outside = [away for away in self.at if (away - inner) * direction > 0]
            if outside:
                outer = min(outside, key=lambda away: abs(away - inner))
                return float(scipy.optimize.brentq(self.evaluate, outer, inner, xtol=WITHIN))
            is_bright = direction > 0
            if not self.at[inner] and not is_bright:
                return inner
            if number == steps or (is_bright and self.limits[1] < math.inf):
                break
            self.step(inner, direction, WIDEST_STEP if is_bright else min(SLOWEST * self.at[inner], WIDEST_STEP))
        return None

    def step(self, away: float, direction: int, length: float) -> None:
        """Evaluate it farther in a direction; towards what cannot be, half way."""
        away += direction * min(length, abs(self.limits[direction] - away) / 2)
        self.tried.append(away)
        try:
            self.evaluate(away)
        except PixsimError as error:
            self.limits[direction], self.why_not = away, str(error)

    def evaluate(self, away: float) -> float:
        """Return its value, which is computed once."""
        if away not in self.at:
            self.at[away] = self.function(away)
        return self.at[away]
