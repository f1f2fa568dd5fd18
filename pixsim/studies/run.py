"""Run a scene, or a picture of another program, through one sensor: from settings to mean ΔE and
the estimate of its error.

Where a target is just seen is found by running the case in the light of other values of the scene.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count
from pixsim.base.caller import parameter, setting
from pixsim.base.digits import estimate
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, collected_notes, suppressed_warnings, warn
from pixsim.base.progress import Progress, Stage, no_stage, share_of, watched
from pixsim.base.result import Result
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.exchange import camera_of_light, read_with_camera
from pixsim.scene.guard.dictionary import stated_file
from pixsim.scene.plan import Plan
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import collecting_area_um2
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.raw import BITS_OF_PICTURES
from pixsim.sensor.readout import Frame
from pixsim.studies.design import Case, metrics_of, warn_of_reviews
from pixsim.studies.engine import Workers
from pixsim.studies.evaluate import FirstFrame, RenderedCase, evaluate_points
from pixsim.studies.files import scene_of_python
from pixsim.studies.film_error import light_error_and_limit
from pixsim.studies.lights import Light, rendered_light
from pixsim.studies.paired import NOISE_SENSORS, mean_interval, spread_interval
from pixsim.studies.prepare import (
    Job,
    choose_view,
    file_of_scene,
    is_picture,
    loaded_scene,
    scene_with_view,
    sensor_case,
    warn_of_default_sensor,
    with_view,
)
from pixsim.studies.table import Table
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.display import white_rate
from pixsim.viewer.evaluate import reviewed
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_registry import metric_names, metrics_named
from pixsim.viewer.metrics import DELTA_E, MetricRequest, NoNumberError, columns_with_numbers
from pixsim.viewer.noise_budget import NoiseBudget, noise_budget
from pixsim.viewer.raw_metrics import DETECTABILITY
from pixsim.viewer.requirements import Requirement, RequirementCheck, requirement_of
from pixsim.viewer.scene_light import (
    PreparedScene,
    SceneCache,
    SceneLight,
    prepare_scene,
    registered_in,
)
from pixsim.viewer.score import Cause, FrameScore, LightError, Score, exceeded
from pixsim.viewer.screen import warn_of_clipping, white_header
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.without_effect import UserSettings, warn_of_settings_without_effect

# --- where a target is just seen ------------------------------------------------------------------

_SOLVE_FOR = "metric.detectability.solve_for"
WITHIN = 1e-3  # relative error of a parameter's value at the threshold
_MAX_STEP = math.log(8.0)  # of a value's logarithm, on the way to the threshold
# Steps of a value's logarithm, over the logarithm of d′ that is missing: d′ grows at least as the
# root of the light.
_STEP_FACTOR = 2.2
_MAX_STEPS = 9  # on the way to a value on the other side of the threshold
MAX_RENDERS = 24  # of the whole search
# Steps beyond the last value that is seen, up to 512 times as much: a target may be too bright.
_UPWARD_STEPS = 3
_MIN_D_PRIME = 1e-6  # in place of a d′ of 0


@dataclass(frozen=True)
class Threshold:
    """Where a target is just seen.

    parameter : of the scene
    threshold : d′ at which it is seen
    value : of the parameter, from which on d′ is the threshold or more; or None
    upper_value : beyond which d′ is below the threshold again, as where light fills the pixels; or
        None
    tried : values from the first one on, before they lay on both sides of the threshold
    reason : why there is no value; empty if there is one, or if the last value tried is too small
    """

    parameter: str
    threshold: float
    value: float | None
    tried: tuple[float, ...]
    reason: str = ""
    upper_value: float | None = None


def _start_value(settings: Run, source: Scene | object) -> float | None:
    """Return the value from which the search of a run for its threshold starts.

    Returns None for a run that solves for no parameter.

    Raises PixsimError for light of another program, and for a parameter without a number.
    """
    name = settings.metric.detectability.solve_for
    if name is None or DETECTABILITY.name not in settings.metrics:
        return None
    if not isinstance(source, Scene):
        raise invalid(
            setting(_SOLVE_FOR),
            f"'{name}' for a picture from another program",
            "a parameter of a scene that pixsim renders",
        )
    stated = settings.scene.parameters.get(name, source.text().defaults.get(name))
    try:
        start = float(stated) if stated is not None else math.nan
    except ValueError:
        start = math.nan
    if not math.isfinite(start) or not start:
        value = "no value" if stated is None else f"the value {stated}"
        got = f"'{name}', whose value is {value}"
        allowed = (
            f"a parameter of {source.path.name} with a number other than 0, from which the search"
            " starts"
        )
        hint = f"For example contrast, size_mm or lux: {parameter('lux', '100')}."
        raise invalid(setting(_SOLVE_FOR), got, allowed, hint)
    return start


def _threshold_of(
    job: Job[Run],
    light: Light,
    d_prime: float,
    d_prime_in: Callable[[SceneLight], float],
    progress: Progress | None = None,
) -> Threshold:
    """Return where d′ of the target is the threshold, from scenes that are rendered again on the
    film of the run.

    d′ rises with a size, a contrast and the light, between their root and their square, until
    pixels are full; then it falls. The search climbs from the first value until d′ is the threshold
    or more, goes on from there to both sides until it is less, and closes in on the values between.

    job : a run that solves for a parameter
    light : of the run
    d_prime : of the run
    d_prime_in : returns d′ of the run's sensor in another light
    """
    settings = job.settings
    options = settings.metric.detectability
    case = job.cases[0]
    name = options.solve_for
    start = _start_value(settings, case.scene)
    assert name is not None
    assert start is not None

    request = job.request
    film_width = light.image.shape[1]
    load = partial(
        loaded_scene,
        str(case.scene.path),
        resolution=None,
        display=settings.display,
        variant=case.scene.choice.variant,
        sensor=job.sensor,
    )

    render_number = count(1)

    def excess(shift: float) -> float:
        """Return log(d′ / threshold) at log(value / first value) = `shift`."""
        parameters = settings.scene.parameters | {name: start * math.exp(shift)}
        scene = scene_with_view(load(parameters=parameters), job.view).with_resolution(film_width)
        rendered = request.render(scene, request.plan_of(scene))
        if progress:
            progress(min(next(render_number) / MAX_RENDERS, 1.0))
        return logarithm(d_prime_in(SceneLight(rendered.image, rendered.background)))

    def logarithm(d_prime: float) -> float:
        return math.log(max(d_prime, _MIN_D_PRIME) / options.threshold)

    with suppressed_warnings():
        search = Search(excess, {0.0: logarithm(d_prime)})
        low, high = search.positive_range()

    reason = ""
    if low is None and high is None:
        best = search.best
        largest = options.threshold * math.exp(search.values[best])
        reason = search.failure or f"d′ is at most {largest:.3g}, at {start * math.exp(best):.4g}"
    return Threshold(
        parameter=name,
        threshold=options.threshold,
        value=None if low is None else start * math.exp(low),
        tried=tuple(start * math.exp(shift) for shift in search.tried),
        reason=reason,
        upper_value=None if high is None else start * math.exp(high),
    )


class Search:
    """Where a function that rises, and may fall beyond a maximum, is 0 or more, from few of its
    values.

    function : of a logarithm; it raises PixsimError for an argument that is impossible
    values : argument -> value, of one argument at least
    """

    def __init__(self, function: Callable[[float], float], values: dict[float, float]) -> None:
        self.function = function
        self.values = values
        self.tried = list(values)
        # Impossible arguments, by the direction.
        self.limits = {-1: -math.inf, 1: math.inf}
        self.failure = ""

    @property
    def best(self) -> float:
        """The argument with the greatest value so far; the lowest one of several."""
        return max(self.values, key=lambda argument: (self.values[argument], -argument))

    def positive_range(self) -> tuple[float | None, float | None]:
        """Return the ends of the range in which the function is 0 or more.

        An end that no step reaches is None.
        """
        self.climb()
        if self.values[self.best] < 0:
            return None, None
        return self.end(-1, _MAX_STEPS), self.end(1, _UPWARD_STEPS)

    def climb(self) -> None:
        """Evaluate the function until it is 0 or more somewhere.

        It goes up first, then down from where the function falls, and then closes in on the
        maximum.
        """
        for _ in range(_MAX_STEPS):
            best = self.best
            lower = [argument for argument in self.values if argument < best]
            upper = [argument for argument in self.values if argument > best]
            if self.values[best] >= 0:
                return
            if not upper:
                self.step(best, 1, min(-_STEP_FACTOR * self.values[best], _MAX_STEP))
            elif not lower:
                self.step(best, -1, _MAX_STEP)
            else:
                lower_gap = best - max(lower)
                upper_gap = min(upper) - best
                direction = 1 if upper_gap >= lower_gap else -1
                self.step(best, direction, max(lower_gap, upper_gap) / 2)

    def end(self, direction: int, steps: int) -> float | None:
        """Return the argument at which the function crosses 0, beyond all arguments with a value of
        0 or more.

        Returns None if no step crosses 0.

        direction : 1 or -1
        steps : largest number of steps
        """
        for number in range(steps + 1):
            positive = [argument for argument, value in self.values.items() if value >= 0]
            inner = max(positive) if direction > 0 else min(positive)
            outside = [argument for argument in self.values if (argument - inner) * direction > 0]
            if outside:
                outer = min(outside, key=lambda argument: abs(argument - inner))
                return float(scipy.optimize.brentq(self.evaluate, outer, inner, xtol=WITHIN))
            is_bright = direction > 0
            if not self.values[inner] and not is_bright:
                return inner
            if number == steps or (is_bright and self.limits[1] < math.inf):
                break
            length = _MAX_STEP if is_bright else min(_STEP_FACTOR * self.values[inner], _MAX_STEP)
            self.step(inner, direction, length)
        return None

    def step(self, argument: float, direction: int, length: float) -> None:
        """Evaluate the function a step farther in a direction.

        The step goes at most half way to an argument that is impossible.
        """
        argument += direction * min(length, abs(self.limits[direction] - argument) / 2)
        self.tried.append(argument)
        try:
            self.evaluate(argument)
        except PixsimError as error:
            self.limits[direction] = argument
            self.failure = str(error)

    def evaluate(self, argument: float) -> float:
        """Return the value at an argument, which is computed once."""
        if argument not in self.values:
            self.values[argument] = self.function(argument)
        return self.values[argument]


_METRICS_OF_TARGET = (DETECTABILITY.name, DELTA_E.name)  # where the user states none
MAX_FRAMES = 999  # the numbers in the names of their files have three digits
_MAX_REPEATS = 10_000
_BEFORE_FRAME = 0.8  # of the work of "sense and score"
LIGHT_FILE = "light.exr"  # of light that was in memory, once it is written


# --- what is run, before anything is rendered -----------------------------------------------------


def prepare(
    settings: Run,
    *,
    light: SpectralImage | None = None,
    full: bool = False,
    repeats: int = 1,
    frames: int = 1,
    sensor: str | None = None,
    variant: str | None = None,
    units: str | None = None,
    warns_of_unused_settings: bool = True,
) -> Job[Run]:
    """Choose what a run leaves open, and check everything that can be checked before a render.

    settings : with the file of the scene, or of a picture of another program
    light : in memory, in place of them; it has the name `LIGHT_FILE`
    full : simulate every effect, also those that the plan finds too small to matter
    repeats, frames : number of sensors of the kind, and of frames of the first one
    sensor, variant, units : of the scene, and of the picture
    warns_of_unused_settings : whether to warn of settings that have no effect

    Raises PixsimError for invalid input.
    """
    pitch_um = settings.pixel.pitch_um
    if not 1 <= frames <= MAX_FRAMES:
        hint = f"For more, call run with another {setting('seed')}: another sensor."
        raise invalid(setting("frames"), frames, f"1 to {MAX_FRAMES}", hint)
    if not 1 <= repeats <= _MAX_REPEATS:
        raise invalid(setting("repeats"), repeats, f"1 to {_MAX_REPEATS} sensors")
    scene: Scene | None = None
    picture: SpectralImage | None = None
    file = LIGHT_FILE if light is not None else file_of_scene(settings)
    if light is not None:
        picture = light
        whole = camera_of_light(light, settings.camera, settings.lens)
    elif is_picture(file):
        _check_scene_options(file, settings, sensor, variant)
        picture, whole = read_with_camera(file, settings.camera, units, settings.lens)
    else:
        if units:
            allowed = "a picture (.exr, .npz, .hdr); the units of a render are known"
            raise invalid(setting("units"), f"'{file}', a scene", allowed)
        scene = loaded_scene(
            file,
            settings.scene.parameters,
            settings.resolution,
            settings.display,
            variant=variant,
            sensor=sensor,
        )
        whole = scene.camera(settings.camera, settings.lens)
        if scene.shows_target and "metrics" not in settings.model_fields_set:
            settings = settings.model_copy(update={"metrics": _METRICS_OF_TARGET})
        warn_of_default_sensor(scene, [settings.camera], settings.pixel)
    _start_value(settings, scene)
    if warns_of_unused_settings:
        imaging = Imaging.of(settings, whole).changed(metrics=metrics_of(settings))
        stated = UserSettings.from_setting(imaging, settings, picture=picture)
        warn_of_settings_without_effect({"": [stated]})

    camera = whole.window(settings.window_mm)
    is_data_sheet = settings.pixel.technology == NO_TECHNOLOGY
    view = choose_view(pitch_um, camera, settings.display, scene) if is_data_sheet else {}
    complete = with_view(settings, view).model_copy(update={"camera": whole.options})
    light_source = picture if scene is None else scene_with_view(scene, view)
    assert light_source is not None

    case = Case(
        complete, resolved=(light_source, camera), stream=("evaluate", settings.seed), frames=frames
    )
    case = sensor_case(case, repeats=repeats, units=units, without_shortcuts=full, is_run=True)
    assert case.imaging is not None
    case = replace(case, sensor=case.imaging.technology.name)
    warn_of_reviews([(case.sensor, case, None)])
    job = Job(
        cases=(case,),
        stated=settings,
        complete=complete,
        file=file,
        source=light_source,
        view=view,
        sensor=sensor,
        variant=variant,
        units=units,
    )
    if scene is not None:
        job.request  # noqa: B018 – raises an error if the scene has no plan
    return job


def _check_scene_options(file: str, settings: Run, sensor: str | None, variant: str | None) -> None:
    """Raise PixsimError for settings that only a scene has, beside a picture."""
    values = {"-D ([scene])": settings.scene.parameters, "--sensor": sensor, "--variant": variant}
    for name in ("tolerance_delta_e", "resolution", "window_mm"):
        option = name.removesuffix("_mm").replace("_", "-")
        values[f"--{option} ({name})"] = getattr(settings, name)
    stated = ", ".join(words for words, value in values.items() if value)
    if stated:
        hint = "Remove them from the scene's settings file, too."
        raise invalid(stated, f"'{file}', a picture", "a Mitsuba scene, or none of these", hint)


# --- the result -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class RenderedRun:
    """A run with its light. The fields are described at `RunResult`."""

    prepared: Job[Run] = field(repr=False)
    irradiance: SpectralImage = field(repr=False)
    rendered: Light | None = field(default=None, repr=False)
    plan: Plan | None = field(default=None, repr=False)
    warned: tuple[Note, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RunResult(RenderedRun, Result):
    """A scene as one sensor sees it, with its score.

    prepared : what was run: source, settings and camera
    irradiance : light on the sensor, before diffraction
    rendered, plan : the light as it was rendered, with its errors, and the plan of that, or None
        for light of another program
    warned : warnings meanwhile
    chain : from the light to frames and scores of further sensors of the kind
    score : of the first frame of the first sensor, with its pictures
    table : of the first frame of each sensor, without the bias by the noise of the render
    table_at_first : the same of further sensors at the first one's registration, or None if all
        sensors have it
    keys : of the rows of the table, hashes of all that they depend on
    threshold : where the target is just seen, if the settings ask for it
    """

    chain: ImagingChain = field(repr=False)
    score: FrameScore = field(repr=False)
    table: Table = field(repr=False)
    table_at_first: Table | None = field(default=None, repr=False)
    keys: tuple[str, ...] = field(default=(), repr=False)
    threshold: Threshold | None = field(default=None, repr=False)

    @cached_property
    def statistics(self) -> tuple[dict[str, float], ...]:
        """Numbers of the pixel, the frame and the metrics, of the first frame of each sensor."""
        first = self.score.statistics()
        first |= {name: value for name, value in self.table[0].items() if name in first}
        rows = ({name: row[name] for name in first if name in row} for row in self.table[1:])
        return first, *rows

    @property
    def settings(self) -> Run:
        """The complete settings, with the values that pixsim chose."""
        return self.prepared.settings

    @property
    def camera(self) -> Camera:
        """The camera, of the window."""
        return self.prepared.camera

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each sensor, (sensors,)."""
        return np.asarray(self.table.columns["mean_delta_e"])

    @property
    def mean_delta_e(self) -> float:
        """Mean ΔE, over all sensors."""
        return float(self.delta_e.mean())

    @property
    def interval_delta_e(self) -> tuple[float, float] | None:
        """95 % interval of the expected mean ΔE of such sensors, or None for one sensor.

        The errors of the light are not in it: all sensors see the same light.
        """
        return self.interval(self.delta_e, "mean_delta_e")

    @property
    def is_spread(self) -> bool:
        """Whether the sensors' registrations are spread, so that intervals hold for all
        registrations and not for one.
        """
        return self.table_at_first is not None

    def interval(self, values: Array, column: str) -> tuple[float, float] | None:
        """Return the 95 % interval of the expected value of a number over such sensors.

        Returns None for a single sensor. The interval is that of `spread_interval`, or Student's t
        where all sensors have one registration.

        values : (sensors,) the number of each sensor
        column : name of the number among `statistics`
        """
        if values.size == 1:
            return None
        if self.table_at_first is None:
            return mean_interval(values)[::2]
        at_first = np.append(self.table.columns[column][:1], self.table_at_first.columns[column])
        return spread_interval(values, at_first)[::2]

    @property
    def judged(self) -> dict[str, Array]:
        """Metrics beside ΔE by their names, of each sensor, (sensors,)."""
        others = [
            metric for metric in metrics_named(self.settings.metrics) if metric is not DELTA_E
        ]
        return {metric.name: np.asarray(self.table.columns[metric.columns[0]]) for metric in others}

    @property
    def requirement_checks(self) -> tuple[RequirementCheck, ...]:
        """Whether the result meets each requirement of its settings."""
        return tuple(self._check(requirement_of(text)) for text in self.settings.require or ())

    def _check(self, requirement: Requirement) -> RequirementCheck:
        (metric,) = metrics_named([requirement.metric])
        values = self.delta_e if metric is DELTA_E else self.judged[metric.name]
        mean = float(values.mean())
        low, high = self.interval(values, metric.columns[0]) or (mean, mean)
        if metric is DELTA_E:
            error_delta_e = sum(exceeded(self.light, self.light_limit).values())
            if math.isnan(error_delta_e):  # it is unknown
                error_delta_e = math.inf
            low, high = low - error_delta_e, high + error_delta_e
        return RequirementCheck(requirement, mean, (low, high))

    @cached_property
    def white_e(self) -> float:
        """Mean electrons of the scene's white on axis in the first frame, of a pixel without a
        stack.
        """
        readout = self.score.readout
        area_um2 = collecting_area_um2(self.irradiance, self.camera, readout.physics)
        rate = white_rate(
            self.chain.imaging.changed(display=self.settings.display), self.irradiance
        )
        return rate * area_um2 * readout.bin_side**2 * self.score.frame.integration_s

    @cached_property
    def dark(self) -> dict[str, float]:
        """Effect of clipping dark pixels at 0 DN, as `pixsim.viewer.dark_clip.dark_clip`."""
        return dark_clip(self.score.readout, self.score.frame.integration_s, self.white_e)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of the mean ΔE beside the sensor's noise and blur, the largest first."""
        frame = self.score.frame
        return causes_of(
            self.chain.imaging,
            self.irradiance.header,
            white_e=self.white_e,
            integration_s=frame.integration_s,
            lightness=lightness_range(self.score.ideal),
            saturated_fraction=frame.saturated_fraction,
        )

    @property
    def film(self) -> dict[str, Any] | None:
        """The film and its error as in score.json, or None for light of another program."""
        return self.rendered.film.as_dict() if self.rendered and self.rendered.film else None

    @property
    def light(self) -> LightError:
        """The errors of the light."""
        return self._light_and_limit[0]

    @property
    def light_limit(self) -> LightError:
        """Largest tolerated errors of the light."""
        return self._light_and_limit[1]

    @property
    def _light_and_limit(self) -> tuple[LightError, LightError]:
        return light_error_and_limit(
            self.irradiance.header, self.rendered.film if self.rendered else None
        )

    @cached_property
    def noise_budget(self) -> NoiseBudget | None:
        """Electrons and ΔE of the first sensor's frame by cause, if the settings ask for it."""
        if not self.settings.noise_budget:
            return None
        return noise_budget(self.chain, self.irradiance, "evaluate", self.settings.seed)

    @property
    def colour(self) -> dict[str, Any] | None:
        """Channels, matrix and noise gains of a colour sensor, as in score.json.

        None for a sensor without colour filters.
        """
        if self.chain.colour_chart is None:
            return None
        return self.chain.development.colour_facts(self.score.frame.integration_s)

    @property
    def notes(self) -> list[Note]:
        """Remarks on the score: its causes, warnings, and a black level that clips dark noise."""
        return [Note.restored(**note) for note in self.as_dict()["notes"]]

    def further_frames(self) -> Iterator[Frame]:
        """Yield the frames of the first sensor after its first one, which is scored."""
        return self.chain.further_frames(self.prepared.frames, "evaluate", self.settings.seed)

    def __repr__(self) -> str:
        metric = metrics_named(self.settings.metrics)[0]
        value = f"{metric.name} {estimate(self.table.columns[metric.columns[0]].mean())}"
        source = stated_file(self.prepared.file)
        pixels = f"{self.score.physics.pitch_um:g} µm pixels"
        return f"<RunResult {source}: {value}, {pixels}, {self.delta_e.size} sensors>"


# --- the way from the settings to the result ------------------------------------------------------


def run(
    scene: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    repeats: Count = 1,
    frames: int = 1,
    full: bool = False,
    sensor: str | None = None,
    variant: str | None = None,
    units: str | None = None,
    progress: Stage | None = None,
    metrics: Sequence[str | Callable[[Score], float]] = (),
    **settings: object,
) -> RunResult:
    """Render a scene, capture it with one sensor and score the image, with the errors of its light,
    as `pixsim run` does.

    scene : XML file, dictionary as `load_scene` takes it, or name of a packaged scene; or a
        spectral image of another program (.exr, .npz, .hdr). None takes that of `config`; a scene
        drops the parameters of one there
    config : one or more TOML files with a sensor, its camera, exposure and display, and a scene, as
        settings.toml of a run; later ones take precedence
    parameters : of the scene, each in its unit
    pixel : fields of the pixel (`PixelOptions`), each in its unit, which override the fields of the
        files
    repeats : number of sensors of the kind, each at another registration with the picture; of
        several, the result has `interval_delta_e`. Pictures belong to the first sensor, which is
        centred
    frames : number of frames of the first sensor, for the result's `further_frames`; the first is
        scored
    full : leave out no effect, whatever the plan says of its size
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant. None means the fastest that works
    units : of an image whose file does not state them, such as W.m^-2.nm^-1
    progress : returns a callback for each named stage
    metrics : names of further metrics, or functions of a `Score`, each a number in its own unit
    settings : other tables and fields of `Run`: camera={"f_number": 2.8}, exposure={…},
        display={…}, seed=3, window_mm=1.0

    Raises PixsimError for invalid input, before anything is rendered.

    >>> result = run("csf", pixel={"pitch_um": 42.4}, resolution=64, display={"dots": 32})
    >>> result.score.frame.pixels, result.mean_delta_e < 0.5  # two pixels a dot of the display
    ((64, 64), True)
    """
    if metrics:
        settings["metrics"] = metric_names(metrics)
    settings["scene"] = scene_of_python(scene, parameters)
    with collected_notes():  # also those of the preparation
        if pixel:
            settings["pixel"] = pixel
        prepared = prepare(
            run_settings(config, settings),
            full=full,
            repeats=repeats,
            frames=frames,
            sensor=sensor,
            variant=variant,
            units=units,
        )
        return run_prepared(prepared, progress=progress)


def run_prepared(prepared: Job[Run], *, progress: Stage | None = None) -> RunResult:
    """Render a prepared run, and score it.

    progress : returns a callback for each named stage
    """
    stage = progress or no_stage
    return score_run(render_run(prepared, stage), stage)


def render_run(prepared: Job[Run], stage: Stage) -> RenderedRun:
    """Return a run with its light, whose header states the white of the display."""
    with collected_notes() as notes:
        image = prepared.cases[0].picture
        rendered = None
        plan = None
        if image is None:
            rendered, plan = rendered_light(prepared.request, stage("render"))
            image = rendered.image
        image.header |= white_header([(Imaging.of(prepared.settings, prepared.camera), image)])
    return RenderedRun(prepared, image, rendered, plan, tuple(notes))


def score_run(
    rendered_run: RenderedRun,
    stage: Stage,
    prepare: Callable[[Imaging, SceneLight], PreparedScene] = prepare_scene,
) -> RunResult:
    """Return the scores of a run in its light, with the pictures of its first frame.

    stage : returns a callback for a named stage
    prepare : `prepare_scene`, or a function that caches what it returns
    """
    job = rendered_run.prepared
    image = rendered_run.irradiance
    light = rendered_run.rendered
    settings = job.settings
    case = job.cases[0]
    with collected_notes() as notes:
        scored = stage("sense and score")
        background = case.background if light is None else light.background
        with watched(share_of(scored, 0.0, _BEFORE_FRAME)):
            rendered = _rendered_case(case, SceneLight(image, background), prepare)

        first: list[FirstFrame] = []
        evaluating = share_of(scored, _BEFORE_FRAME, 1.0)
        table = evaluate_points([rendered], None, progress=lambda: evaluating, first_frame=first)
        table = _without_bias(table, light)
        for reason in table.impossible.values():
            raise AlikeChannelsError(reason)
        chain, frame = first[0]
        score = _with_metrics(frame.score, settings.metrics, table)
        for reason in dict.fromkeys(table.reasons.values()):
            warn(Note("undefined_metric", words=reason))

        # Sensors at one registration separate the noise from the spread of registrations.
        table_at_first = None
        if job.repeats > 1:
            second_imaging = registered_in(rendered.imaging, rendered.light(), 1)
            if second_imaging != rendered.imaging:
                table_at_first = _without_bias(
                    evaluate_points(_sensors_at_first(rendered), None, Workers()), light
                )

    threshold = None
    if light is not None and _start_value(settings, case.scene) is not None:
        d_prime = float(table.columns["detectability"][0])
        threshold = _threshold_of(
            job, light, d_prime, partial(_d_prime_in, case), stage("look for the threshold")
        )
    result = RunResult(
        prepared=job,
        irradiance=image,
        rendered=light,
        plan=rendered_run.plan,
        warned=tuple(dict.fromkeys([*rendered_run.warned, *notes])),
        chain=chain,
        score=score,
        table=table,
        table_at_first=table_at_first,
        keys=tuple(rendered.keys(settings.pixel.pitch_um, job.repeats)),
        threshold=threshold,
    )
    return replace(result, score=replace(score, light=result.light))


def _rendered_case(
    case: Case[Run], light: SceneLight, prepare: Callable[[Imaging, SceneLight], PreparedScene]
) -> RenderedCase:
    """Return the case of a run in its light, with the white of that light.

    prepare : `prepare_scene`, or a function that caches what it returns

    Warns for each note of the review, and of what the display clips.
    """
    assert case.imaging is not None
    imaging = reviewed(case.imaging, light)
    prepared = prepare(imaging, light)
    warn_of_clipping(prepared.beyond_white, light.irradiance.header, imaging.display)
    return RenderedCase(replace(case, imaging=imaging), SceneCache(imaging, light), prepared)


def _d_prime_in(case: Case[Run], light: SceneLight) -> float:
    """Return d′ of the first sensor of a case in a light. Raises NoNumberError if it has none."""
    assert case.imaging is not None
    imaging = case.imaging.changed(metrics=MetricRequest((DETECTABILITY,), case.settings.metric))
    case = replace(case, imaging=imaging, sizes=dict.fromkeys(case.sizes, 1))
    table = evaluate_points([_rendered_case(case, light, prepare_scene)], None, Workers())
    for reason in table.reasons.values():
        raise NoNumberError(reason)
    return float(table.columns[DETECTABILITY.columns[0]][0])


def _without_bias(table: Table, light: Light | None) -> Table:
    """Return the rows of a light without the bias of their metrics by the noise of its render."""
    bias = light.noise.bias if light is not None and light.noise is not None else {}
    columns = {
        name: values - bias[name] if name in bias else values
        for name, values in table.columns.items()
    }
    return replace(table, columns=columns)


def _sensors_at_first(rendered: RenderedCase) -> list[RenderedCase]:
    """Return further sensors at the registration of the first one, one in each case."""
    case = rendered.case
    streams = [
        (*case.stream, "at the first registration", number) for number in range(1, NOISE_SENSORS)
    ]
    sizes = dict.fromkeys(case.sizes, 1)
    sensors = [
        replace(case, stream=stream, group=number, sizes=sizes)
        for number, stream in enumerate(streams)
    ]
    return [replace(rendered, case=sensor) for sensor in sensors]


def _with_metrics(score: FrameScore, names: Sequence[str], table: Table) -> FrameScore:
    """Return the score of a run's first frame with the numbers of its metrics, of the first row of
    the table.

    names : of the metrics

    Raises NoNumberError if none of them has a number.
    """
    undefined = table.undefined.get(0, {})
    if undefined and set(names) <= undefined.keys():
        raise NoNumberError(next(iter(undefined.values())))
    numbers = {name: float(values[0]) for name, values in table.columns.items()}
    others = [metric for metric in metrics_named(names) if metric is not DELTA_E]
    further = {name: numbers[name] for name in columns_with_numbers(others, numbers)}
    first = {
        metric.name: numbers.get(metric.columns[0], score.mean_delta_e)
        for metric in metrics_named(names)
    }
    return replace(score, metrics=first, further=further)


def check_raw(settings: Run, suffixes: Sequence[str]) -> None:
    """Raise PixsimError for raw frames of too many bits for their format."""
    bits = (settings.exposure.frames * (2**settings.pixel.bits - 1)).bit_length()
    if bits > BITS_OF_PICTURES and {".tiff", ".png"} & set(suffixes):
        got = f"tiff or png for frames of {bits} bits"
        raise invalid("--raw", got, f"at most {BITS_OF_PICTURES} bits; use npz for more")
