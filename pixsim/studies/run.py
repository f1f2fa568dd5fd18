"""Run a scene, or a picture of another program, through one sensor: from settings to mean ΔE, and what is known of its error."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arguments import Count, checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.notes import collected_notes, warn
from pixsim.base.progress import Stage, no_stage, share_of, watched
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.exchange import camera_of_light, read_with_camera
from pixsim.optics.lens_defocus import depth_of_field_m, finite_or_none
from pixsim.scene.convergence import without_clock
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import Plan
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import check_pixel_count, collecting_area_um2, pixels_on
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.readout import Frame
from pixsim.sensor.technology import Technology, load_technology
from pixsim.show.document import pairs, plain_text
from pixsim.show.pages import plain, rows_csv
from pixsim.show.render import cell_of
from pixsim.studies.cases import Case, Job
from pixsim.studies.lights import Demand, Light, demand_of, rendered_light
from pixsim.studies.paired import mean_interval, spread_interval
from pixsim.studies.preparation import check_metrics, choose_view, is_picture, loaded_scene, scene_with_view, with_view
from pixsim.studies.sentences import run_answers
from pixsim.studies.series import metrics_of
from pixsim.studies.settings_text import scene_table
from pixsim.studies.threshold import Threshold, start_of, threshold_of
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.chain import ImagingChain, make_chain
from pixsim.viewer.dark_clip import clip_words, clips_dark, dark_clip
from pixsim.viewer.develop_options import of_python
from pixsim.viewer.display import dot_edges_um, white_light, white_rate
from pixsim.viewer.evaluate import evaluate_frame, reviewed_chain
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.light_error import Cause, LightError
from pixsim.viewer.metric_registry import metrics_named, names_of
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.noise_budget import NoiseBudget, noise_budget
from pixsim.viewer.scene_light import PreparedScene, SceneLight, prepare_scene
from pixsim.viewer.score import FrameScore, Score
from pixsim.viewer.screen import white_header
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.without_effect import GivenSettings, warn_of_settings_without_effect

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_FRAMES = 999  # the numbers in the names of their files have three digits
MAX_REPEATS = 10_000
NOISE_SENSORS = 4  # at the first sensor's registration, whose scatter is that of the noise
BEFORE_FRAME = 0.8  # of the work of "sense and score"
LIGHT_FILE = "light.exr"  # of light that was in memory, once it is written


# --- what is run, before anything is rendered ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class RunJob(Job[Run]):
    """A run that is prepared.

    source : scene, or picture of another program
    asked : settings as they were given
    full : whether no effect is left out
    repeats : number of sensors of the kind
    frames : number of frames of the first sensor
    units : of the picture, as they were given
    """

    source: str
    asked: Run
    full: bool = False
    repeats: int = 1
    frames: int = 1
    units: str | None = None

    @cached_property
    def demand(self) -> Demand:
        """What the pixel asks of the scene's light."""
        return demand_of(self.cases[0], full=self.full)

    @property
    def technology(self) -> Technology:
        """The process of the pixel, as its file has it."""
        return load_technology(self.settings.pixel.technology)

    def repeating(self, irradiance: SpectralImage) -> Run:
        """Return the settings with which `pixsim run` makes the same numbers again.

        irradiance : of this run
        """
        if self.cases[0].picture:
            return self.settings
        # Display and chart, too, may have been chosen; defaults in their place would count as given.
        of_view = {"display": self.settings.display, "scene": scene_table(self.cases[0].scene.path.parent, self.settings.scene)}
        return without_clock(self.asked, irradiance).model_copy(update=of_view)

    @property
    def whole_source(self) -> str:
        """The scene or picture, for a command in another folder."""
        if self.cases[0].picture:
            return str(Path(self.source).resolve())
        return self.source if self.source in packaged_scenes() else str(self.cases[0].scene.path)


def prepare(
    source: str | SpectralImage,
    settings: Run,
    *,
    full: bool = False,
    repeats: int = 1,
    frames: int = 1,
    sensor: str | None = None,
    variant: str | None = None,
    units: str | None = None,
    judges_settings: bool = True,
) -> RunJob:
    """Choose what a run leaves open, and check everything that can be checked before a render.

    judges_settings : whether to warn of settings that do nothing

    The other arguments are fields of `RunJob`; light in memory has the name `LIGHT_FILE`. Raises PixsimError for invalid input.
    """
    pitch_um = settings.pixel.pitch_um
    if not 1 <= frames <= MAX_FRAMES:
        hint = f"For more, call run with another {setting('seed')}: another sensor."
        raise invalid(setting("frames"), frames, f"1 to {MAX_FRAMES}", hint)
    if not 1 <= repeats <= MAX_REPEATS:
        raise invalid(setting("repeats"), repeats, f"1 to {MAX_REPEATS} sensors")
    scene: Scene | None = None
    picture: SpectralImage | None = None
    if isinstance(source, SpectralImage):
        picture, whole, source = source, camera_of_light(source, settings.camera, settings.lens), LIGHT_FILE
    elif is_picture(source):
        of_scenes = {"-D ([scene])": settings.scene, "--sensor": sensor, "--variant": variant} | {
            f"--{name.removesuffix('_mm').replace('_', '-')} ({name})": getattr(settings, name)
            for name in ("tolerance_delta_e", "resolution", "window_mm")
        }
        if stated := [words for words, value in of_scenes.items() if value]:
            hint = "Take them out of a settings file of the scene, too."
            raise invalid(", ".join(stated), f"'{source}', a picture", "a Mitsuba scene, or none of these", hint)
        picture, whole = read_with_camera(source, settings.camera, units, settings.lens)
    else:
        if units:
            allowed = "a picture (.exr, .npz, .hdr); the units of a render are known"
            raise invalid(setting("units"), f"'{source}', a scene", allowed)
        scene = loaded_scene(source, settings.scene, settings.resolution, settings.display, variant=variant, sensor=sensor)
        whole = scene.camera(settings.camera, settings.lens)
    known = scene or picture
    assert known is not None
    without = check_metrics(settings, [settings.pixel], known, units=units)
    start_of(settings, scene)
    if judges_settings:
        imaging = Imaging.of(settings, whole).changed(metrics=metrics_of(settings))
        warn_of_settings_without_effect({"": [GivenSettings.of_setting(imaging, settings, picture=picture)]})
    camera = whole.window(settings.window_mm)
    of_sheet = settings.pixel.technology == NO_TECHNOLOGY
    view = choose_view(pitch_um, camera, settings.display, scene) if of_sheet else {}
    check_pixel_count(pixels_on(camera.die_um, pitch_um), pitch_um)
    dot_edges_um(camera.die_um, pitch_um, settings.display, Imaging.of(settings, camera).scored_border_um)
    complete = with_view(settings, view).model_copy(update={"camera": whole.options})
    seen = known if scene is None else scene_with_view(scene, view)
    case = Case(complete, found=(seen, camera), without=without)
    job = RunJob(
        source=source,
        asked=settings,
        cases=(case,),
        view=view,
        full=full,
        repeats=repeats,
        frames=frames,
        sensor=sensor,
        variant=variant,
        units=units,
    )
    if scene is not None:
        job.demand  # noqa: B018 – raises an error if the scene has no plan
    return job


# --- the result ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LitRun:
    """A run whose light is known. The fields are those of `RunResult`."""

    prepared: RunJob = field(repr=False)
    irradiance: SpectralImage = field(repr=False)
    rendered: Light | None = field(default=None, repr=False)
    plan: Plan | None = field(default=None, repr=False)
    warned: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RunResult(LitRun):
    """A scene as one sensor sees it, with its score.

    prepared : what was run: source, settings and camera
    irradiance : light on the sensor, before diffraction
    rendered, plan : the light as it was rendered, with its errors, and the plan of that; None for light of another program
    warned : warnings meanwhile
    chain : from the light to frames and scores of further sensors of the kind
    score : of the first frame of the first sensor, with its pictures
    statistics : `Score.statistics` of the first frame of each sensor
    statistics_at_first : the same of `NOISE_SENSORS` sensors at the first one's registration; empty if all sensors have it
    threshold : where the target is just seen, if the settings ask for it
    """

    chain: ImagingChain = field(repr=False)
    score: FrameScore = field(repr=False)
    statistics: tuple[dict[str, float], ...] = field(repr=False)
    statistics_at_first: tuple[dict[str, float], ...] = field(default=(), repr=False)
    threshold: Threshold | None = field(default=None, repr=False)

    @property
    def settings(self) -> Run:
        """The settings, with all that was left open."""
        return self.prepared.settings

    @property
    def camera(self) -> Camera:
        """The camera, of the window."""
        return self.prepared.camera

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each sensor, (sensors,)."""
        return np.array([each["mean_delta_e"] for each in self.statistics])

    @property
    def mean_delta_e(self) -> float:
        """Mean ΔE, over all sensors."""
        return float(self.delta_e.mean())

    @property
    def interval_delta_e(self) -> tuple[float, float] | None:
        """95 % interval of the expected mean ΔE of such sensors; None of one sensor.

        The errors of the light are not in it: all sensors see the same light.
        """
        return self.interval(self.delta_e, "mean_delta_e")

    @property
    def is_spread(self) -> bool:
        """Whether the sensors' registrations are spread, so that intervals hold for all registrations and not for one."""
        return bool(self.statistics_at_first)

    def interval(self, values: Array, column: str) -> tuple[float, float] | None:
        """Return the 95 % interval of the expectation of a number of the sensors; None of one sensor.

        It is that of `spread_interval`, and by Student's t where all sensors have one registration.

        values : (sensors,)
        column : its name among `statistics`
        """
        if values.size == 1:
            return None
        if not self.is_spread:
            return mean_interval(values)[::2]
        at_first = np.array([row[column] for row in self.statistics_at_first])
        return spread_interval(values, at_first)[::2]

    @property
    def judged(self) -> dict[str, Array]:
        """Metrics beside ΔE by their names, of each sensor, (sensors,)."""
        others = [metric for metric in metrics_named(self.settings.metrics) if metric is not DELTA_E]
        return {metric.name: np.array([each[metric.columns[0]] for each in self.statistics]) for metric in others}

    @cached_property
    def white_e(self) -> float:
        """Mean electrons of the scene's white on axis in the first frame, of a pixel without a stack."""
        physics = self.score.physics
        area_um2 = collecting_area_um2(self.irradiance, self.camera, physics)
        rate = white_rate(self.chain.imaging.changed(display=self.settings.display), self.irradiance)
        return rate * area_um2 * physics.bin_side**2 * self.score.frame.integration_s

    @cached_property
    def dark(self) -> dict[str, float]:
        """Effect of clipping dark pixels at 0 DN, as `pixsim.viewer.dark_clip.dark_clip`."""
        return dark_clip(self.score.physics, self.score.frame.integration_s, self.white_e)

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
        """The film and its error, as in score.json; None for light of another program."""
        return None if self.rendered is None else self.rendered.film.as_dict()

    @property
    def light(self) -> LightError:
        """What is known of the errors of the light."""
        return LightError.of(self.irradiance.header, self.film, self.causes)

    @cached_property
    def noise_budget(self) -> NoiseBudget | None:
        """Electrons and ΔE of the first sensor's frame by cause; None where nobody asks."""
        if not self.settings.noise_budget:
            return None
        return noise_budget(self.chain, self.irradiance, "evaluate", self.settings.seed)

    @property
    def shown_mean(self) -> str:
        """Mean ΔE over all sensors as text, with its interval and the error of its light."""
        mean = self.mean_delta_e
        half = 0.0 if self.interval_delta_e is None else self.interval_delta_e[1] - mean
        return self.light.shown(mean, half)

    @property
    def assumption(self) -> str:
        """What was assumed of the technology and the lens, which nobody stated; empty for nothing."""
        of_lens = "" if self.prepared.cases[0].picture else self.prepared.asked.camera.assumption(self.camera)
        return "; ".join(filter(None, (self.settings.pixel.assumption, of_lens)))

    @property
    def colour(self) -> dict[str, Any] | None:
        """Channels, matrix and noise gains of a colour sensor, as in score.json; None for a monochrome one."""
        return None if self.chain.rendition is None else self.chain.development.colour_facts(self.score.frame.integration_s)

    @property
    def dark_notes(self) -> list[str]:
        """A note on the clipping of dark pixels at 0 DN; none if its effect is not visible, or a correction removes its mean."""
        if self.settings.correction.removes_dark_level or not clips_dark(self.dark):
            return []
        return [clip_words(self.dark, self.settings.pixel.model_dump())]

    @property
    def score_notes(self) -> list[str]:
        """Notes on the causes of the score and on clipped dark pixels, the largest first."""
        sized = [(cause.delta_e, str(cause)) for cause in self.causes]
        sized += [(self.dark["lightness"], note) for note in self.dark_notes]
        return [note for _, note in sorted(sized, key=lambda one: -one[0])]

    @property
    def notes(self) -> list[str]:
        """What a reader should know besides the score: its causes, warnings, a black level that clips dark noise."""
        return list(dict.fromkeys([*map(str, self.causes), *self.warned, *self.score_notes]))

    def further_frames(self) -> Iterator[Frame]:
        """Yield the frames of the first sensor after its first one, which is scored."""
        return self.chain.further_frames(self.prepared.frames, "evaluate", self.settings.seed)

    def as_dict(self) -> dict[str, Any]:
        """Return score.json: the results of the first sensor, then the settings, and what is known of further sensors.

        `pixels` and `scored_dots` are rows and columns; `border_um`, above and to the left, is the border that is not scored.
        `in_focus_m` are the nearest and the farthest depth with a blur disc of a pixel at most, the farthest null if infinite.
        """
        prepared, settings, score = self.prepared, self.settings, self.score
        more: dict[str, Any] = {"chosen": {**prepared.view}}
        if self.rendered is not None and self.plan is not None:
            more |= {"render_noise": asdict(self.rendered.noise), "plan": self.plan.as_dict(), "film": self.film}
            more |= {"window_mm": settings.window_mm} if settings.window_mm else {}
        if prepared.repeats > 1 and self.interval_delta_e is not None:
            more |= {"repeats": len(self.statistics), "delta_e": self.delta_e.tolist(), "sensors_mean_delta_e": self.mean_delta_e}
            more |= {"interval_delta_e": list(self.interval_delta_e)}
        if self.judged:
            more["metrics"] = plain({name: float(values.mean()) for name, values in self.judged.items()})
        if self.threshold is not None:
            more["at_threshold"] = self.threshold.as_dict()
        if (colour := self.colour) is not None:
            more |= {"develop": settings.develop.model_dump(), "colour": colour}
        elif settings.develop.words:
            more |= {"develop": settings.develop.model_dump()}
        if settings.develop.sharpens:
            more["sharpening_noise_gain"] = self.chain.development.sharpening_noise_gain
        more |= {"frames": prepared.frames} if prepared.frames > 1 else {}
        more |= {"noise_budget": self.noise_budget.as_dict()} if self.noise_budget else {}
        return {
            **plain(self.statistics[0]),
            "pixels": list(score.frame.pixels),
            "scored_dots": list(score.delta_e.shape),
            "border_um": list(score.border_um),
            "pixel": score.physics.pixel.model_dump(),
            "assumption": self.assumption,
            "white_spectrum": white_light(self.irradiance)[1],
            "irradiance": self.irradiance.header,
            "dark": self.dark,
            "causes": [cause.as_dict() for cause in self.causes],
            "camera": self.camera.model_dump(),
            "in_focus_m": finite_or_none(depth_of_field_m(self.camera, score.physics.as_read.read_pitch_um)),
            "exposure": settings.exposure.model_dump(),
            "correction": settings.correction.model_dump(),
            **({"motion": settings.motion.model_dump()} if settings.motion.is_on else {}),
            "display": settings.display.model_dump(),
            "seed": settings.seed,
            "notes": self.notes,
            **more,
        }

    def plot(self) -> Figure:
        """Return a Matplotlib figure of the ideal image, the sensor's image and the ΔE map with its scale."""
        return self.score.plot()

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return a row of `statistics` for each sensor as CSV, and write it to `path` if given."""
        return rows_csv([{"repeat": number} | own for number, own in enumerate(self.statistics)], path)

    def _repr_html_(self) -> str:
        camera = self.camera
        of_run = f"{camera.focal_length_mm:g} mm at f/{camera.f_number:g}, die of {camera.die_mm:g} mm; seed {self.settings.seed}"
        notes = [f"{self.prepared.source}: {of_run}", *self.notes]
        return cell_of(run_answers(self), self.plot(), pairs("statistics", self.statistics[0], ".6g"), *notes)

    def __repr__(self) -> str:
        return f"<RunResult {self.prepared.source}: {plain_text(run_answers(self)[0].head)}>"


# --- the way from the settings to the result -------------------------------------------------------------------------------------


@checks_arguments
def run(
    scene: str | os.PathLike[str],
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
    """Render a scene, capture it with one sensor and score the image, with the errors of its light, as `pixsim run` does.

    scene : XML file or name of a packaged scene; or a spectral image of another program (.exr, .npz, .hdr)
    config : one or more TOML files with a sensor, its camera, exposure and display; later ones take precedence
    parameters : of the scene, each in its unit
    pixel : fields of the pixel (`PixelOptions`), each in its unit, which override those of the files
    repeats : number of sensors of the kind, each at another registration with the picture; of several, the result has
        `interval_delta_e`. Pictures are those of the first, which is centred
    frames : number of frames of the first sensor, for the result's `further_frames`; the first is scored
    full : leave out no effect, whatever the plan says of its size
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant; None means the fastest that works
    units : of an image whose file does not state them, such as W.m^-2.nm^-1
    progress : returns a callback for each named stage
    metrics : names of further metrics, or functions of a `Score`, each a number in its own unit
    settings : other tables and fields of `Run`: camera={"f_number": 2.8}, exposure={…}, display={…}, seed=3, window_mm=1.0

    Raises PixsimError for invalid input, before anything is rendered.

    >>> result = run("csf", pixel={"pitch_um": 42.4}, resolution=64, display={"dots": 32})
    >>> result.score.frame.pixels, result.mean_delta_e < 0.5  # two pixels a dot of the display
    ((64, 64), True)
    """
    if metrics:
        settings["metrics"] = names_of(metrics)
    with collected_notes():  # also of what is found before the run begins
        own = {name: table for name, table in (("scene", parameters), ("pixel", pixel)) if table}
        asked = run_settings(config, of_python(settings) | own)
        prepared = prepare(
            str(scene), asked, full=full, repeats=repeats, frames=frames, sensor=sensor, variant=variant, units=units
        )
        return run_prepared(prepared, progress=progress)


def run_prepared(prepared: RunJob, *, progress: Stage | None = None) -> RunResult:
    """Run what is prepared.

    progress : returns a callback for each named stage
    """
    stage = progress or no_stage
    return score_run(light_run(prepared, stage), stage)


def light_run(prepared: RunJob, stage: Stage) -> LitRun:
    """Return a run with its light, with the white that it is shown with."""
    with collected_notes() as notes:
        image, rendered, plan = prepared.cases[0].picture, None, None
        if image is None:
            rendered, plan = rendered_light(prepared.demand, stage("render"))
            image = rendered.image
        image.header |= white_header([(Imaging.of(prepared.settings, prepared.camera), image)])
    return LitRun(prepared, image, rendered, plan, tuple(notes))


def score_run(lit: LitRun, stage: Stage, prepare: Callable[[Imaging, SceneLight], PreparedScene] = prepare_scene) -> RunResult:
    """Return the result of a run whose light is known.

    prepare : as `prepare_scene`, which may know what that did before
    """
    prepared, image, settings = lit.prepared, lit.irradiance, lit.prepared.settings
    with collected_notes() as notes:
        scored = stage("sense and score")
        imaging = Imaging.of(settings, prepared.camera).changed(metrics=metrics_of(settings), full=prepared.full, is_run=True)
        background = prepared.cases[0].without if lit.rendered is None else lit.rendered.without
        with watched(share_of(scored, 0.0, BEFORE_FRAME)):
            chain = reviewed_chain(imaging, SceneLight(image, background), prepare=prepare)
        scored(BEFORE_FRAME)
        lacking: dict[str, str] = {}
        score = evaluate_frame(chain, ("evaluate", settings.seed), lacking)
        statistics, at_first = [score.statistics()], [score.statistics()]
        sensors = prepared.repeats
        imaging, scene = chain.imaging, chain.scene
        assert scene is not None
        is_spread = sensors > 1 and imaging.registered(1, scene.array_um) != imaging

        for number in range(1, sensors):
            registered = make_chain(imaging.registered(number, scene.array_um), scene) if is_spread else chain
            statistics.append(evaluate_frame(registered, ("evaluate", settings.seed, number), lacking).statistics())
            scored(BEFORE_FRAME + (1 - BEFORE_FRAME) * number / sensors)
        if is_spread:
            for number in range(1, NOISE_SENSORS):
                key = "evaluate", settings.seed, "at the first registration", number
                at_first.append(evaluate_frame(chain, key, lacking).statistics())
        for reason in lacking.values():
            warn(reason)
    warned = tuple(dict.fromkeys([*lit.warned, *notes]))
    of_run = prepared, image, lit.rendered, lit.plan, warned
    threshold = None
    if lit.rendered is not None and start_of(settings, prepared.cases[0].scene) is not None:
        of_target = prepared.demand, lit.rendered, statistics[0]["detectability"]
        threshold = threshold_of(prepared, *of_target, stage("look for the threshold"))
    result = RunResult(
        *of_run,
        chain=chain,
        score=score,
        statistics=tuple(statistics),
        statistics_at_first=tuple(at_first) if is_spread else (),
        threshold=threshold,
    )
    return replace(result, score=replace(score, light=result.light))
