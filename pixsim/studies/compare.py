"""Compare image sensors in one scene: mean ΔE of each, the differences from the first, and how sure these are.

All sensors see the same field, on one display, in the same light. The first sensor and each other one are compared as if no third
one were there, under a range of viewing (`pixsim.studies.viewing`). Both frames of a pair have the random seeds of its number.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.special import stdtr, stdtrit

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.config import checked, packaged, settings_layer, sheet_uncertainty, warn_of_mixed_sensors
from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.files import missing, output_folder
from pixsim.base.headline import MOST_WORDS, NOT_CONVERGED, with_headline
from pixsim.base.labels import file_label, labels_of
from pixsim.base.notes import collected_notes, warn
from pixsim.base.parameters import (
    NO_TECHNOLOGY,
    REGISTERED_BORDER,
    Camera,
    CameraOptions,
    Condition,
    Display,
    Exposure,
    Layer,
    Pixel,
    Record,
    Run,
    Study,
)
from pixsim.base.progress import Progress, Stage
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera_lens import lens_on_die
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.scene.plan import Plan, make_plan
from pixsim.sensor.collection import warn_of_stack_limits
from pixsim.sensor.integration import check_pixel_count, pixels_on
from pixsim.sensor.pixel import derive, implausible_numbers, sheet_disagreements
from pixsim.sensor.technology import check_name
from pixsim.sensor.unused import Configuration, warn_of_unused_settings
from pixsim.show.figures import literal, new_figure, own_style
from pixsim.show.pages import html_cell
from pixsim.studies.budget import without_warnings
from pixsim.studies.circumstances import Circumstances, circumstances_of
from pixsim.studies.cost import VIEWED_S_PER_DOT, Cost, dots_on, frame_cost, jobs_in_memory
from pixsim.studies.engine import Workers, workers_for, workers_here
from pixsim.studies.evaluations import Evaluations
from pixsim.studies.oversampling import FilmError, FilmSteps, Rendered, film_steps, render_and_measure
from pixsim.studies.preparation import ALLOWED_DOTS, View, choose_view
from pixsim.studies.result import NO_VISIBLE_DELTA_E
from pixsim.studies.results_file import ResultsFile
from pixsim.studies.rows import NO_ROWS
from pixsim.studies.sampling import Sizes
from pixsim.studies.series import Series
from pixsim.studies.viewing import OF_VIEWING, Viewed, Viewing, ViewingRange, range_words, where_words
from pixsim.viewer.causes import Cause, causes_of, lightness_range
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display import dot_edges_um, white_light
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.light_error import LightError, with_error
from pixsim.viewer.score import (
    ImagingChain,
    PreparedScene,
    SceneCache,
    Score,
    Seen,
    check_one_ideal,
    clip_words,
    clips_dark,
    dark_clip,
    warn_of_clipping,
    white_header,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pixsim.scene.convergence import RenderNoise
    from pixsim.scene.scene import Scene

Match = Literal["view", "lens", "own"]
CONFIDENCE = 0.95
FIGURE_WIDTH_IN, FIGURE_BORDER_IN, ROW_IN = 6.0, 0.8, 0.4
SURE = 0.999  # probabilities beyond it are not shown in more digits
SENSORS = (2, 8)  # of a comparison; the page shows each in full
REPEATS = (2, 10_000)
OF_A_SENSOR = ("camera", "lens", "pixel", "exposure")  # tables that each file has of its own; the others are those of the first
# Limits by the clock and calibrations differ between sensors: neither their film nor their noise would be the same.
NOT_COMPARED = {
    "tolerance_delta_e": "the film's error is measured and stated; --repeats and --render-noise make results surer",
    "max_seconds": "a number of samples limits each render; --render-noise changes it",
}
ALIKE = 1e-9  # relative difference of two fields of view that is rounding
DIGITS = 12  # of a chart's frequency on another sensor, so that settings.toml gives the same one again
# Of the film's error on the chosen display, grown with mean ΔE: of 48 viewings of six comparisons, 46 errors are within it.
ELSEWHERE = 2.0
FEW_SECONDS = 3.0  # of all frames: processes take a second to start


# --- the statistics of paired frames ----------------------------------------------------------------------------------------


@checks_arguments
def mean_interval(values: Array) -> tuple[float, float, float]:
    """Return the lower end, the mean and the upper end of the 95 % interval of an expected value, from values (n,), n > 1.

    Student's t; for paired frames the values are their differences.

    >>> mean_interval(np.array([1.0, 2.0, 3.0]))  # 2 ± 4.303/√3
    (-0.48..., 2.0, 4.48...)
    """
    mean, error = _mean_and_error(values)
    half = float(stdtrit(values.size - 1, (1 + CONFIDENCE) / 2)) * error
    return mean - half, mean, mean + half


@checks_arguments
def probability_above_zero(differences: Array) -> float:
    """Return the probability that the expected difference is above 0, from differences (n,), n > 1, of paired frames.

    It is that of Student's t: F(t; n - 1), with t the mean over its standard error. It is the posterior probability for normal
    differences of unknown mean and variance (uniform in mean and in log σ), and above 0.975 exactly where the 95 % interval is
    above 0. It tells how sure the simulation is of the means. It is not the share of frames that one sensor wins. Without any
    scatter it is 0, 0.5 or 1.

    >>> round(probability_above_zero(np.array([1.0, 2.0, 3.0])), 3)  # t = 3.46 with 2 degrees of freedom
    0.963
    """
    mean, error = _mean_and_error(differences)
    if error == 0.0:
        return 0.5 * (1.0 + float(np.sign(mean)))
    return float(stdtr(differences.size - 1, mean / error))


def _mean_and_error(values: Array) -> tuple[float, float]:
    """Return the mean of values (n,) and its standard error."""
    if values.ndim != 1 or values.size < REPEATS[0]:
        raise invalid("values", f"an array of shape {values.shape}", "a list of at least 2 numbers")
    mean = float(values.mean())
    return mean, float(values.std(ddof=1)) / math.sqrt(values.size)


# --- the cameras: one field of view for all ----------------------------------------------------------------------------------


@checks_arguments
def matched_cameras(cameras: Sequence[Camera], match: Match, window_mm: float | None = None) -> tuple[Camera, ...]:
    """Return cameras that see one field: the central part that all have in common, after `match`.

    cameras : of each sensor, with its whole die; the first is the reference
    match : 'view': the lens of the reference, its focal length scaled such that the image distance v = f(1 + |m|) goes with the
        width of the die: equal field of view, f-number and object distance; 'lens': the lens of the reference; 'own': each its own
    window_mm : width of a central part of the reference's die that limits the field; None takes all of it

    Raises PixsimError if a camera forms no image.

    >>> wide, tall = Camera(die_mm=8.0, die_height_mm=6.0, focal_length_mm=8.0), Camera(die_mm=4.0)
    >>> first, second = matched_cameras([wide, tall], "view")
    >>> [round(camera.fov_deg, 9) for camera in (first, second)], second.die_height_mm
    ([52.765926..., 52.765926...], 3.0)
    """
    reference = cameras[0]
    if match == "view":
        seen = [reference, *(_with_view_of(reference, camera) for camera in cameras[1:])]
    elif match == "lens":
        seen = [lens_on_die(reference, camera) for camera in cameras]  # cropped below to a field that all of them have
    else:
        seen = list(cameras)
    seen[0] = seen[0].window(window_mm)
    width = min(camera.die_mm / camera.image_distance_mm for camera in seen)
    height = min(camera.height_mm / camera.image_distance_mm for camera in seen)
    return tuple(_cropped(camera, width, height) for camera in seen)


def _with_view_of(reference: Camera, camera: Camera) -> Camera:
    """Return a camera with the die of `camera` and the field of view of `reference`: 1/f = 1/u + 1/v, with v as the width."""
    if reference.lens is not None:
        return lens_on_die(reference, camera, same_view=True)
    v_mm, u_mm = reference.image_distance_mm * camera.die_mm / reference.die_mm, 1e3 * reference.object_distance_m
    lens = {"focal_length_mm": u_mm * v_mm / (u_mm + v_mm)}
    if camera.die_mm == reference.die_mm:  # without rounding
        lens = {}
    die = {"die_mm": camera.die_mm, "die_height_mm": camera.die_height_mm}
    seen = Camera(**reference.model_dump(exclude={"chief_ray_angle"}) | lens | die)
    if reference.chief_ray_angle is None:
        return seen
    grown = camera.die_mm / reference.die_mm  # the same lens, made larger or smaller
    rows = tuple((grown * height_mm, *rest) for height_mm, *rest in reference.chief_ray_angle)
    return seen.model_copy(update={"chief_ray_angle": rows})  # it need reach only the field that is cropped from this one


def _cropped(camera: Camera, width: float, height: float) -> Camera:
    """Return the lens on a central part of the die, whose sides are given as multiples of the image distance."""
    v_mm = camera.image_distance_mm
    if camera.die_mm <= width * v_mm * (1 + ALIKE) and camera.height_mm <= height * v_mm * (1 + ALIKE):
        return camera
    die = {"die_mm": min(camera.die_mm, width * v_mm), "die_height_mm": min(camera.height_mm, height * v_mm)}
    return Camera(**camera.model_dump() | die)


# --- what is compared, before anything is rendered -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Contestant:
    """A sensor of a comparison, with the camera through which it sees the common field.

    name : stem of its file, unique in the comparison
    source : its file, or the name of a packaged technology
    scene : with its chart, whose frequencies on the sensor go with the die
    """

    name: str
    source: str
    camera: Camera
    pixel: Pixel
    exposure: Exposure
    scene: Scene

    @property
    def own(self) -> dict[str, Any]:
        """Its own settings, as tables of `Run`."""
        return {"camera": self.camera.options, "lens": self.camera.lens_options, "pixel": self.pixel, "exposure": self.exposure}

    @property
    def pixels(self) -> tuple[int, int]:
        """Rows and columns of pixels that see the common field."""
        return pixels_on(self.camera.die_um, self.pixel.pitch_um)


@dataclass(frozen=True)
class Prepared:
    """A comparison with everything that it left open, found and checked before anything is rendered.

    scene : file, or name of a packaged scene
    settings : what all sensors share, and the first one's camera, pixel and exposure
    view : display and chart that pixsim chose for data sheets, from the sensor with the most pixels
    finest : name of that sensor
    border : width of the border that is not scored, as a fraction of the width of the field
    viewing : displays on which the frames are scored; the first one is that of `settings`
    base : settings of each sensor, as the files and options have them without a condition
    circumstances : the study under whose conditions the sensors are compared, if any
    condition, weight : name and share of the condition; an empty name without conditions
    conditions : the comparison under each condition of the study; the other fields are those of the first one of weight above 0
    pairs : of three sensors and more, the comparison of the first one with each other one alone
    """

    scene: str
    settings: Run
    match: Match
    repeats: int
    sensors: tuple[Contestant, ...]
    view: View
    finest: str
    border: float
    viewing: ViewingRange
    base: tuple[Run, ...]
    sensor_id: str | None = None
    variant: str | None = None
    circumstances: Circumstances | None = None
    condition: str = ""
    weight: float = 1.0
    conditions: tuple[Prepared, ...] = ()
    pairs: tuple[Prepared, ...] = ()

    @property
    def parts(self) -> tuple[Prepared, ...]:
        """The comparison under each condition; one without conditions is its own only part."""
        return self.conditions or (self,)

    def plan(self, sensor: Contestant, scene: Scene) -> Plan:
        """Return the plan of a sensor's render on the film of `scene`."""
        options: dict[str, Any] = {"display": self.settings.display, "tolerance_e": self.settings.tolerance_e}
        return make_plan(scene, sensor.camera, sensor.pixel, exposure=sensor.exposure, **options)

    def settings_of(self, sensor: Contestant) -> Run:
        """Return the settings with those of a sensor."""
        return self.settings.model_copy(update=sensor.own)

    @cached_property
    def film_width(self) -> int:
        """Samples across the first film, the most that any of the sensors needs: with one film, all see the same picture."""
        widths = []
        for sensor in self.sensors:
            plan = self.plan(sensor, sensor.scene)
            shape = sensor.scene.film_shape(sensor.camera, sensor.scene.for_camera(sensor.camera))
            widths.append(plan.resolution or shape[1])
        return max(widths)

    @property
    def scored_dots(self) -> tuple[int, int]:
        """Rows and columns of the display's dots that are shown and scored."""
        camera = self.sensors[0].camera
        rows, columns = dot_edges_um(camera.die_um, self.sensors[0].pixel.pitch_um, self.settings.display, self.border_um(camera))
        return rows.size - 1, columns.size - 1

    @property
    def displays(self) -> dict[Viewing, Display]:
        """The displays on which the frames are scored, that of the settings first."""
        own = self.settings.display
        chosen = Viewing(own.dots, own.samples_per_deg)
        return {viewing: viewing.display(own) for viewing in (chosen, *self.viewing.viewings)}

    def border_um(self, camera: Camera) -> float:
        """Return the width of the border on a camera's die."""
        return self.border * camera.die_um[1]

    def cost_of_frame(self, sensor: Contestant) -> Cost:
        """Estimate a frame of a sensor, and its ΔE under all viewings."""
        cost = frame_cost(sensor.camera, sensor.pixel.pitch_um, self.settings.display)
        displays = [each.display(self.settings.display) for each in dict.fromkeys(self.viewing.viewings[1:])]
        dots = sum(dots_on(sensor.camera, display) for display in displays)
        return replace(cost, seconds=cost.seconds + dots * VIEWED_S_PER_DOT)


def sensor_layer(file: str) -> Layer:
    """Return the table of a sensor: a TOML file with [pixel], such as a data sheet; or a technology, by its file or name."""
    known = packaged("data/technologies")
    if file not in known:
        path = Path(file)
        if path.suffix != ".toml":
            got = f"'{file}'" if path.parent == Path() or os.path.lexists(path) else missing(path)
            raise invalid("sensor", got, f"a TOML file, or one of {', '.join(known)}", did_you_mean(file, known))
        layer = settings_layer(path)
        if "pixel" in layer.table:
            if unsure := sheet_uncertainty(path):
                warn(f"{path.name}: [pixel.uncertainty] of {', '.join(unsure)} is not used: only studies draw sensor types")
            return layer
        if tables := [name for name in layer.table if name in Run.model_fields]:
            got = f"'{file}' with {', '.join(tables)}, but no table [pixel]"
            hint = "`pixsim template sensor -o my_sensor.toml` writes one with every field."
            raise invalid("sensor", got, "the file of a data sheet, or of a technology", hint)
    return Layer({"pixel": {"technology": file}}, file)


def read_sensors(
    files: Sequence[str], lens: Layer, config: Sequence[Layer], options: dict[str, Any], condition: Layer | None = None
) -> list[Run]:
    """Return the settings of each file, with those of all sensors over them.

    lens : [camera] for files that state none of it
    config, options, condition : for all sensors; each takes precedence over the one before it, and over a sensor's own file

    Raises PixsimError that lists every problem of a file.
    """
    runs: list[Run] = []
    for file in files:
        own = sensor_layer(file)
        warn_of_mixed_sensors([own, *config])
        run: Run = checked(Run, [lens, own, *config, Layer(options), *([condition] if condition else [])])
        for name, reason in NOT_COMPARED.items():
            if getattr(run, name) is not None:
                raise invalid(name, f"{getattr(run, name):g}", f"no value for a comparison: {reason}")
        first = runs[0] if runs else run
        if unused := [n for n in own.table if n not in OF_A_SENSOR and getattr(run, n, None) != getattr(first, n, None)]:
            warn(
                f"{file}: only {', '.join(f'[{name}]' for name in OF_A_SENSOR)} are used, not {', '.join(unused)}: the first file's"
            )
        runs.append(run)
    return runs


def check_files(files: Sequence[str]) -> None:
    """Raise PixsimError for too few or too many sensors, and for one that is given twice."""
    low, high = SENSORS
    if not low <= len(files) <= high:
        hint = "" if files else "For example: pixsim compare a.toml b.toml"
        raise invalid("sensors", f"{len(files)} ({', '.join(files)})" if files else "none", f"{low} to {high} files", hint)
    for file in files:
        check_name(file, "sensor")
    real = [os.path.realpath(file) if Path(file).is_file() else file for file in files]
    for number, file in enumerate(real):
        if file in real[:number]:
            got = f"'{files[number]}' twice"
            raise invalid("sensors", got, "different files", "A copy of the file may have other numbers, or the same.")


@contextmanager
def named(part: str) -> Iterator[None]:
    """Name the sensor, or the condition if there is one, in an error about its settings."""
    try:
        yield
    except PixsimError as error:
        raise PixsimError(f"{part}: {error}" if part else str(error)) from None


def prepare(
    files: Sequence[str | os.PathLike[str]],
    scene: str | os.PathLike[str] | None = None,
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match,
    repeats: int,
    config: Sequence[Path] = (),
    options: dict[str, Any] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
) -> Prepared:
    """Choose what a comparison leaves open, and check everything that can be checked before a render.

    config, options : settings for all sensors, as tables; they take precedence over those of the study, but not of its conditions

    Raises PixsimError for invalid input.
    """
    sources = [str(file) for file in files]
    check_files(sources)
    if not REPEATS[0] <= repeats <= REPEATS[1]:
        raise invalid("repeats", repeats, f"{REPEATS[0]} to {REPEATS[1]} pairs of frames")
    layers, options = [settings_layer(path) for path in config], options or {}
    names = labels_of([file_label(source) for source in sources])
    of_study = None if study is None else circumstances_of(study, scene)
    if of_study is not None:
        of_study.warn_of_unused(options)
        layers = [of_study.shared, *layers]
    lens = Layer({}) if of_study is None else of_study.lens
    base = read_sensors(sources, lens, layers, options)
    under: list[tuple[Condition | None, list[Run]]] = [(None, base)]
    if of_study is not None and of_study.conditions:
        under = [(each, read_sensors(sources, lens, layers, options, of_study.layer_of(each))) for each in of_study.conditions]
    own_scene = "csf" if scene is None else scene

    def made(*chosen: int) -> Prepared:
        """Return the comparison of some of the sensors, as if there were no others."""

        def of_chosen(condition: Condition | None, runs: Sequence[Run], common: Prepared | None) -> Prepared:
            file = own_scene
            if of_study is not None:
                file = of_study.scene if condition is None else of_study.scene_of(condition)
            found: dict[str, Any] = {"match": match, "repeats": repeats, "sensor": sensor, "variant": variant}
            of_sensors = [names[number] for number in chosen], [sources[number] for number in chosen]
            part = _prepare(*of_sensors, [runs[number] for number in chosen], file, common, **found)
            return replace(part, circumstances=of_study, base=tuple(base[number] for number in chosen))

        if under[0][0] is None:
            return of_chosen(*under[0], None)
        conditions = [condition for condition, _ in under if condition is not None]
        total = sum(condition.weight for condition in conditions)
        shown = next(place for place, condition in enumerate(conditions) if condition.weight)
        parts: dict[int, Prepared] = {}
        for place in (shown, *(other for other in range(len(conditions)) if other != shown)):
            condition = conditions[place]
            with named(f"condition {condition.name}"):
                part = of_chosen(condition, under[place][1], parts.get(shown))
            parts[place] = replace(part, condition=condition.name, weight=condition.weight / total)
        return replace(parts[shown], conditions=tuple(part for _, part in sorted(parts.items())))

    whole = made(*range(len(sources)))
    warn_of_unused(sources, [runs for _, runs in under], match)
    if len(sources) == SENSORS[0]:
        return whole
    with without_warnings():  # those of all sensors are shown
        return replace(whole, pairs=tuple(made(0, other) for other in range(1, len(sources))))


def warn_of_unused(sources: Sequence[str], conditions: Sequence[Sequence[Run]], match: Match) -> None:
    """Warn of the settings that a comparison uses in none of its conditions, with the sensors that set them.

    conditions : settings of each sensor under each condition

    The display, the correction and the development are those of the first sensor; so is the lens, unless each has its own.
    """
    names = labels_of([file_label(source) for source in sources])
    found: dict[str, list[Configuration]] = {name: [] for name in names}
    for runs in conditions:
        for name, run in zip(names, runs, strict=True):
            shared = {table: getattr(runs[0], table) for table in ("correction", "develop", "display")}
            lens_of = names[0] if match != "own" and run is not runs[0] else ""
            if lens_of:  # what is the first one's too is used
                shared |= {table: differing(getattr(run, table), getattr(runs[0], table)) for table in ("camera", "lens")}
            given = Configuration.of(run.model_copy(update=shared), derive(run.pixel))
            found[name].append(replace(given, lens_of=lens_of))
    warn_of_unused_settings(found)


def differing(record: Record, other: Record) -> Record:
    """Return the fields of a record that another one of its kind has with another value, as one that sets no others."""
    fields = {name: value for name, value in record if value != getattr(other, name)}
    return type(record).model_construct(set(fields), **fields)


def _prepare(
    names: Sequence[str],
    sources: Sequence[str],
    runs: Sequence[Run],
    scene: str | os.PathLike[str],
    common: Prepared | None,
    *,
    match: Match,
    repeats: int,
    sensor: str | None,
    variant: str | None,
) -> Prepared:
    """Return `prepare` of one condition.

    runs : settings of each sensor
    common : another condition, whose displays and chart this one takes where it leaves them open, so that both can be averaged
    """
    from pixsim.scene.scene import load_scene

    settings = runs[0]
    stated = [name for name in OF_VIEWING if name in settings.display.model_fields_set]
    if settings.display.raster != "fixed_size":
        got = f"'{settings.display.raster}', which gives each sensor a display of its own"
        raise invalid("display.raster", got, "'fixed_size': one display for all sensors")
    if Path(scene).suffix.lower() in (".exr", ".npz", ".hdr"):
        raise invalid("--scene", f"'{scene}', a picture", "a Mitsuba scene, which each sensor sees through its own lens")
    loaded = load_scene(scene, variant=variant, sensor=sensor, **settings.scene)
    loaded = loaded.with_resolution(settings.resolution) if settings.resolution else loaded
    whole = _whole_cameras(names, loaded, runs)
    if settings.window_mm is not None:
        whole[0].window(settings.window_mm)
    cameras = matched_cameras(whole, match, settings.window_mm)
    for name, camera, run in zip(names, cameras, runs, strict=True):
        with named(name):
            derive(run.pixel)
            check_pixel_count(pixels_on(camera.die_um, run.pixel.pitch_um), run.pixel.pitch_um)
    sizes = [math.prod(pixels_on(camera.die_um, run.pixel.pitch_um)) for camera, run in zip(cameras, runs, strict=True)]
    finest = int(np.argmax(sizes))
    view = View()
    if any(run.pixel.technology == NO_TECHNOLOGY for run in runs):
        view = choose_view(runs[finest].pixel.pitch_um, cameras[finest], settings.display, loaded)
    if common is not None:
        view = view.as_chosen(common.view)
    parameters = dict(settings.scene)
    if view.max_lp_per_mm is not None:
        parameters[MAX_LP_PER_MM] = on_other_die(view.max_lp_per_mm, cameras[finest], cameras[0])
    settings = settings.model_copy(update={"display": view.display(settings.display), "scene": parameters})
    border = REGISTERED_BORDER * max(run.pixel.pitch_um / camera.die_um[1] for camera, run in zip(cameras, runs, strict=True))
    given = parameters.get(MAX_LP_PER_MM, loaded.parameters.get(MAX_LP_PER_MM))
    contestants = []
    for name, source, camera, run in zip(names, sources, cameras, runs, strict=True):
        of_sensor = loaded
        if given is not None:
            highest = on_other_die(float(given), cameras[0], camera)
            of_sensor = loaded.with_parameters(**{MAX_LP_PER_MM: repr(highest)})
        with named(name):
            dot_edges_um(camera.die_um, run.pixel.pitch_um, settings.display, border * camera.die_um[1])
        contestants.append(Contestant(name, source, camera, run.pixel, run.exposure, of_sensor))
    viewing = _viewing(contestants, settings.display, stated, border)
    if common is not None:
        viewing = common.viewing.under(settings.display, stated)
    own: dict[str, Any] = {"view": view, "finest": names[finest], "border": border, "viewing": viewing, "base": tuple(runs)}
    return Prepared(str(scene), settings, match, repeats, tuple(contestants), **own, sensor_id=sensor, variant=variant)


def _viewing(sensors: Sequence[Contestant], display: Display, stated: Sequence[str], border: float) -> ViewingRange:
    """Return the range of viewing around a display, without displays that have no dot within the border."""
    low, high = ALLOWED_DOTS
    wished = ViewingRange.of(display, stated, [min(max(sensor.pixels[1], low), high) for sensor in sensors])

    def is_possible(viewing: Viewing) -> bool:
        die_um, pitch_um = sensors[0].camera.die_um, sensors[0].pixel.pitch_um
        try:
            dot_edges_um(die_um, pitch_um, viewing.display(display), border * die_um[1])
        except PixsimError:
            return False
        return True

    return replace(wished, viewings=tuple(each for each in wished.viewings if each == wished.chosen or is_possible(each)))


def _whole_cameras(names: Sequence[str], scene: Scene, runs: Sequence[Run]) -> list[Camera]:
    """Return each file's own camera. A file without a die, such as a technology's, has that of the first file which states one."""
    die = next(
        (each.model_dump(include={"die_mm", "die_height_mm"}) for each in (run.camera for run in runs) if each.die_mm is not None),
        None,
    )
    cameras = []
    for name, run in zip(names, runs, strict=True):
        each = run.camera
        own = each if die is None or each.die_mm is not None else CameraOptions(**die | each.model_dump(exclude_none=True))
        with named(name):
            cameras.append(scene.camera(own, run.lens))
    return cameras


def on_other_die(lp_per_mm: float, camera: Camera, other: Camera) -> float:
    """Return the frequency on another sensor of detail that has `lp_per_mm` on the first, in the same field of view."""
    return lp_per_mm if camera.die_mm == other.die_mm else float(f"{lp_per_mm * camera.die_mm / other.die_mm:.{DIGITS}g}")


# --- the result ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Compared:
    """A sensor's part of a comparison.

    irradiance : light on the sensor, before diffraction
    score : of its first frame
    viewed : (viewings, repeats) mean ΔE of each frame, in the order of `ViewingRange.viewings`
    dark : effect of clipping dark pixels at 0 DN, as `pixsim.viewer.score.dark_clip`
    white_e : mean electrons of the scene's white on axis in its first frame
    steps : on this film and on coarser ones, for the film's error of a difference
    colour : channels, matrix and noise gains, as in score.json; None for a monochrome sensor
    """

    sensor: Contestant
    irradiance: SpectralImage = field(repr=False)
    noise: RenderNoise
    film: FilmError
    score: Score = field(repr=False)
    viewed: Array = field(repr=False)
    dark: dict[str, float] = field(repr=False)
    white_e: float
    steps: FilmSteps = field(repr=False)
    colour: dict[str, Any] | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of its mean ΔE beside its noise and blur, the largest first."""
        time_s = self.score.frame.integration_s
        lightness = lightness_range(self.score.ideal)
        return causes_of(self.irradiance.header, self.score.physics, self.white_e, time_s, lightness)

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each frame on the chosen display, (repeats,)."""
        return np.asarray(self.viewed[0])

    @property
    def film_delta_e(self) -> float | None:
        """Largest error of mean ΔE that the film may cause; None if it is unknown."""
        error = self.film.largest_delta_e
        return None if math.isnan(error) else error


@dataclass(frozen=True)
class Comparison:
    """Sensors in one scene. The first one is a, each later one is b.

    A difference of a and b is that of the two alone, with their own chart, field, dots and border. So it does not depend on the
    other sensors. The mean ΔE of three sensors and more (`delta_e`, `scores`) are those on one display for all.

    prepared : what was compared: scene, cameras, display and seeds
    sensors : of each file, in their order
    notes : warnings, and black levels that clip dark noise
    conditions : the comparison under each condition of a study; then `delta_e`, and all that follows from it, are the weighted mean
        over them, and the sensors are those of the first condition of weight above 0
    pairs : of three sensors and more, the comparison of the first one with each other one alone
    """

    prepared: Prepared = field(repr=False)
    sensors: tuple[Compared, ...] = field(repr=False)
    notes: tuple[str, ...] = ()
    conditions: tuple[Comparison, ...] = field(default=(), repr=False)
    pairs: tuple[Comparison, ...] = field(default=(), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def shown(self) -> Comparison:
        """The comparison whose pictures are shown: this one, or that under the first condition of weight above 0."""
        return next((part for part in self.conditions if part.prepared.weight), self)

    @property
    def counted(self) -> list[tuple[float, Comparison]]:
        """The weight and the comparison of each condition of weight above 0."""
        return [(part.prepared.weight, part) for part in self.conditions if part.prepared.weight]

    @checks_arguments
    def pair(self, other: str) -> Comparison:
        """Return the comparison of the first sensor and another one alone.

        other : name of the other one
        """
        return self.pairs[self.names.index(other) - 1] if self.pairs else self

    @property
    def viewed(self) -> dict[str, Array]:
        """Mean ΔE of each frame of each sensor under each viewing, (viewings, repeats).

        With conditions, that of frame k is the weighted mean over the frames k of all conditions. They have the same seeds, so that
        the scatter of these means holds what the conditions' frames have in common.
        """
        if not self.conditions:
            return {sensor.name: sensor.viewed for sensor in self.sensors}
        weighted = [(weight, part.viewed) for weight, part in self.counted]
        return {name: np.sum([weight * own[name] for weight, own in weighted], axis=0) for name in self.names}

    @property
    def delta_e(self) -> dict[str, Array]:
        """Mean ΔE of each frame of each sensor on the chosen display, (repeats,)."""
        return {name: np.asarray(values[0]) for name, values in self.viewed.items()}

    @property
    def scores(self) -> dict[str, tuple[float, float, float]]:
        """Mean ΔE of each sensor between the ends of its 95 % interval: (low, mean, high)."""
        return {name: mean_interval(values) for name, values in self.delta_e.items()}

    @property
    def differences(self) -> dict[str, Array]:
        """ΔE(b) - ΔE(a) of each pair of frames on the chosen display, (repeats,), of each later sensor."""
        of_pairs = {other: self.pair(other).delta_e for other in self.names[1:]}
        return {other: own[other] - own[self.names[0]] for other, own in of_pairs.items()}

    @property
    def difference(self) -> dict[str, float]:
        """Mean ΔE(b) - ΔE(a) of each later sensor: above 0, a is better."""
        return {name: float(values.mean()) for name, values in self.differences.items()}

    @property
    def interval_delta_e(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each difference, from its pairs of frames; the film's error is not in it (`film_delta_e`)."""
        return {name: mean_interval(values)[::2] for name, values in self.differences.items()}

    @property
    def probability_a_better(self) -> dict[str, float]:
        """Probability that the expected ΔE of a is below that of b: `probability_above_zero`."""
        return {name: probability_above_zero(values) for name, values in self.differences.items()}

    @property
    def film_delta_e(self) -> dict[str, float | None]:
        """Largest error of each difference that the film may cause; None if it is unknown."""
        return {other: self.pair(other).film_between(self.names[0], other) for other in self.names[1:]}

    @checks_arguments
    def film_between(self, one: str, other: str) -> float | None:
        """Return the largest error (ΔE) of the difference of two sensors that the film may cause; None if it is unknown.

        Both sensors see the same film, so that it is less than the errors of both together. Those of conditions add up, by weight.

        one, other : names of the sensors
        """
        if self.conditions:
            return sum_if_known([(weight, part.film_between(one, other)) for weight, part in self.counted])
        steps = {sensor.name: sensor.steps for sensor in self.sensors}
        error = steps[one].error_of_difference(steps[other])
        return None if math.isnan(error) else error

    @checks_arguments
    def views(self, other: str) -> tuple[Viewed, ...]:
        """Return the difference of the first sensor and another one under each viewing, the chosen one first.

        other : name of the other one
        """
        return self.pair(other).views_between(self.names[0], other)

    @checks_arguments
    def views_between(self, one: str, other: str) -> tuple[Viewed, ...]:
        """Return the difference of two sensors under each viewing of all, the chosen one first.

        The film's error is measured on the chosen display. On others twice it is taken, and more where mean ΔE is larger.

        one, other : names of the sensors
        """
        viewed, film = self.viewed, self.film_between(one, other)
        first, second = viewed[one], viewed[other]
        mean = np.maximum(first.mean(axis=1), second.mean(axis=1))
        grown = np.append(1.0, ELSEWHERE * np.maximum(mean[1:] / mean[0], 1.0) if mean[0] else np.full(mean.size - 1, ELSEWHERE))
        views = []
        for number, (viewing, values) in enumerate(zip(self.prepared.viewing.viewings, second - first, strict=True)):
            numbers = float(values.mean()), mean_interval(values)[::2], probability_above_zero(values)
            error = None if film is None else film * float(grown[number])
            views.append(Viewed(viewing, self.prepared.viewing.holds(viewing), *numbers, error))
        return tuple(views)

    @property
    def ranking(self) -> tuple[tuple[str, ...], ...]:
        """The sensors by their mean ΔE, the best first, in groups; all of them on one display.

        Each one of a group is surely better than each one of a later group, under all viewings of the range. Within a group, the
        order depends on the viewing, or is not sure.
        """
        means = {name: float(values.mean()) for name, values in self.delta_e.items()}
        order = sorted(means, key=lambda name: means[name])
        better = {
            (one, other)
            for place, one in enumerate(order)
            for other in order[place + 1 :]
            if all(view.sign > 0 for view in self.views_between(one, other) if view.inside)
        }
        cuts = [
            place
            for place in range(1, len(order))
            if all((one, other) in better for one in order[:place] for other in order[place:])
        ]
        return tuple(tuple(order[first:last]) for first, last in pairwise([0, *cuts, len(order)]))

    @property
    def film_of_sensors(self) -> dict[str, float | None]:
        """Largest error of each sensor's mean ΔE that the film may cause; None if it is unknown."""
        parts = self.counted or [(1.0, self)]
        own = [(weight, {sensor.name: sensor.film_delta_e for sensor in part.sensors}) for weight, part in parts]
        return {name: sum_if_known([(weight, errors[name]) for weight, errors in own]) for name in self.names}

    @property
    def unconverged(self) -> str:
        """Causes beside the sensors, and renders with more noise than their target, in words, the largest first; empty for none.

        The film's error is in each ±.
        """
        found: list[tuple[float, str]] = []
        for part, sensor in ((one, sensor) for one in self.conditions or (self,) for sensor in one.sensors):
            where = f" in {part.prepared.condition}" if self.conditions else ""
            found += [(cause.delta_e, f"{sensor.name}{where}: {cause.words}") for cause in sensor.causes]
            errors = LightError.of(sensor.irradiance.header).errors(float(sensor.delta_e.mean()))
            found += [(size, f"{NOT_CONVERGED}: {words}") for size, words in errors]
        found.sort(key=lambda one: -one[0])
        # Of several renders, the one with the most noise.
        noisiest = next((words for _, words in found if words.startswith(NOT_CONVERGED)), "")
        return "; ".join(dict.fromkeys(words for _, words in found if not words.startswith(NOT_CONVERGED) or words == noisiest))

    @checks_arguments
    def shown_mean(self, name: str) -> str:
        """Return a mean ΔE as text, with its uncertainty: half of the 95 % interval, and the film's error.

        name : of a sensor
        """
        low, mean, high = self.scores[name]
        return shown_delta_e(mean, (high - low) / 2, self.film_of_sensors[name])

    def answers(self) -> dict[str, Any]:
        """Return the numbers that answer the question, as in compare.json."""
        views = {other: self.views(other) for other in self.names[1:]}
        return {
            "scores": {name: list(score) for name, score in self.scores.items()},
            "difference": self.difference,
            "interval_delta_e": {name: list(ends) for name, ends in self.interval_delta_e.items()},
            "probability_a_better": self.probability_a_better,
            "film_delta_e": self.film_delta_e,
            "views": {other: [view.as_dict((self.names[0], other)) for view in own] for other, own in views.items()},
        }

    def as_dict(self) -> dict[str, Any]:
        """Return compare.json. With conditions the answers are those of the weighted mean, and the rest is `shown`."""
        prepared, first = self.prepared, self.sensors[0]
        settings = prepared.settings
        more: dict[str, Any] = {}
        if (of_study := prepared.circumstances) is not None:
            more["study"] = {"name": of_study.name, "not_used": list(of_study.not_used)}
        if self.conditions:
            more["shown_condition"] = self.shown.prepared.condition
            more["conditions"] = {
                part.prepared.condition: {"weight": part.prepared.weight}
                | part.answers()
                | {"delta_e": {name: values.tolist() for name, values in part.delta_e.items()}}
                for part in self.conditions
            }
        if self.pairs:
            more["ranking"] = [list(group) for group in self.ranking]
            more["pairs"] = {other: _pair_as_dict(self.pair(other)) for other in self.names[1:]}
        return more | {
            "names": list(self.names),
            "verdicts": {other: headline(self, other) for other in self.names[1:]},
            **self.answers(),
            "match": prepared.match,
            "repeats": prepared.repeats,
            "scene": prepared.scene,
            "scored_dots": list(first.score.delta_e.shape),
            "fov_deg": first.sensor.camera.fov_deg,
            "chosen": prepared.view.as_dict() | {"finest": prepared.finest},
            "display": settings.display.model_dump(),
            "viewing": prepared.viewing.as_dict(),
            "seed": settings.seed,
            "notes": list(self.notes),
            "sensors": {
                sensor.name: _summary_of(sensor) | {"delta_e": self.delta_e[sensor.name].tolist()} for sensor in self.sensors
            },
        }

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure of mean ΔE: a row for each sensor, with its frames and the 95 % interval of their mean."""
        figure = new_figure(FIGURE_WIDTH_IN, FIGURE_BORDER_IN + ROW_IN * len(self.sensors))
        axes = figure.add_subplot()
        for row, (name, (low, mean, high)) in enumerate(self.scores.items()):
            axes.plot(self.delta_e[name], np.full(self.prepared.repeats, row), "o", color="tab:gray", alpha=0.5, markersize=4)
            axes.errorbar([mean], [row], xerr=[[mean - low], [high - mean]], fmt="D", color=f"C{row}", capsize=5, markersize=5)
        axes.set_yticks(range(len(self.sensors)), [literal(name) for name in self.names])
        axes.set_ylim(len(self.sensors) - 0.5, -0.5)  # the first sensor is on top
        axes.set_xlim(0.0, 1.05 * max(float(values.max()) for values in self.delta_e.values()) or 1.0)
        axes.set_xlabel("mean ΔE: each frame (grey), and the mean with its 95 % interval")
        return figure

    def _repr_html_(self) -> str:
        rows = [(sensor.name, f"{sensor.sensor.pixel.pitch_um:g}", self.shown_mean(sensor.name)) for sensor in self.sensors]
        title = "; ".join(headlines(self))
        counted = ", ".join(f"{part.prepared.condition} ({weight:g})" for weight, part in self.counted)
        over = f"; the mean over the conditions {counted}" if counted else ""
        prepared = self.prepared
        notes = [f"{prepared.scene}: {prepared.repeats} pairs of frames, seed {prepared.settings.seed}{over}", *self.notes]
        return html_cell(title, ("sensor", "pixel size (µm)", "mean ΔE (95 % and the film's error)"), rows, self.plot(), notes)

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {self.shown_mean(name)}" for name in self.names)
        conditions = f" under {len(self.conditions)} conditions" if self.conditions else ""
        words = f"mean ΔE {shown}, {self.prepared.repeats} pairs{conditions}"
        return f"<Comparison {'; '.join(filter(None, (words, self.unconverged)))}>"


def shown_delta_e(value: float, half: float, film: float | None) -> str:
    """Return a ΔE and its uncertainty as text: half of the 95 % interval and the film's error, to two digits, one above 0.01.

    film : the film's error; None is stated as unknown

    >>> shown_delta_e(0.12345, 0.0021, 0.0), shown_delta_e(0.12345, 0.001, 0.02)
    ('0.1235 ± 0.0021 ΔE', '0.12 ± 0.02 ΔE')
    """
    unknown = " and the film's error, which is unknown" if film is None else ""
    return f"{with_error(value, half + (film or 0.0))} ΔE{unknown}"


def shown_probability(probability: float) -> str:
    """Return a probability as text: .93, > .999, < .001.

    >>> [shown_probability(p) for p in (0.5, 0.93, 0.99961, 1.0, 0.0)]
    ['.5', '.93', '> .999', '> .999', '< .001']
    """
    if probability > SURE:
        return "> .999"
    if probability < 1 - SURE:
        return "< .001"
    return f"{probability:.3f}".rstrip("0").removeprefix("0")


def verdict(result: Comparison, other: str) -> str:
    """Return `verdict_parts` as one text."""
    return "; ".join(verdict_parts(result, other))


def verdict_parts(result: Comparison, other: str) -> list[str]:
    """Return the answer for the first sensor and another: which is better, by how much, how sure that is, and where it holds.

    Neither is called better if half of the difference's 95 % interval and the film's error exceed it together. One is called
    better without a condition only if it is so under all viewings of the range.
    """
    names, views = (result.names[0], other), result.views(other)
    chosen, *_ = inside = [view for view in views if view.inside]
    words = _verdict_on(chosen, names)
    if len(inside) == 1 or all(view.difference == 0 for view in inside):
        return [words]
    signs = {view.sign for view in inside}
    if signs == {0}:
        return [words, "nor elsewhere in the range of viewing"]
    if len(signs) == 1:
        sizes = sorted(abs(view.difference) for view in inside)
        return [words, f"in the whole range of viewing by {sizes[0]:.2g} to {sizes[-1]:.2g} ΔE"]
    where, on_chosen = where_words(inside, names), f"on {chosen.viewing}, {words}"
    depends = f"which is better depends on the viewing: {where}"
    if len(depends.split()) <= MOST_WORDS:
        return [depends, on_chosen]
    return [f"which of {names[0]} and {names[1]} is better depends on the viewing", on_chosen, where]


def elsewhere_note(result: Comparison, other: str) -> str:
    """Return whether a verdict on a display that the user stated turns on others; empty if none was stated."""
    names, views = (result.names[0], other), result.views(other)
    if all(view.inside for view in views):
        return ""
    stated, signs = {view.sign for view in views if view.inside}, {view.sign for view in views}
    others = f"on other displays ({range_words([view.viewing for view in views])})"
    if signs == stated and len(signs) == 1:
        return f"{names[0]} and {names[1]}: the verdict is the same {others}"
    return f"{names[0]} and {names[1]}: the verdict depends on the display that was stated; {others}: {where_words(views, names)}"


def ranking_words(result: Comparison) -> str:
    """Return the order of three sensors and more, the best first."""
    groups = [
        group[0]
        if len(group) == 1
        else f"{', '.join(group[:-1])} and {group[-1]} (whose order depends on the viewing or is not sure)"
        for group in result.ranking
    ]
    return f"ranking, the best first, all on one display: {'; then '.join(groups)}"


def _verdict_on(view: Viewed, names: tuple[str, str]) -> str:
    """Return which of two sensors is better under one viewing, by how much, and how sure that is."""
    first, other = names
    better, worse = (first, other) if view.difference >= 0 else (other, first)
    above = view.probability_a_better
    of_better = shown_probability(above if view.difference >= 0 else 1 - above)
    size = shown_delta_e(abs(view.difference), view.half_delta_e, view.film_delta_e)
    if view.difference == 0:
        return f"{first} and {other} have the same mean ΔE in every pair of frames"
    if abs(view.difference) <= view.half_delta_e:
        return f"{first} and {other} cannot be told apart: {better} is better by {size} (probability {of_better})"
    if not view.sign:
        return f"{first} and {other} cannot be told apart: {better} is better by {size}, within the error of the film"
    visible = "" if abs(view.difference) >= NO_VISIBLE_DELTA_E else f", no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE)"
    return f"{better} is better than {worse} by {size} (probability {of_better}){visible}"


def _winner(result: Comparison, other: str) -> str | None:
    """Return the sensor that is visibly better, the other of two or the first; empty for no visible difference, None if unsure."""
    difference, (low, high) = result.difference[other], result.interval_delta_e[other]
    if abs(difference) < NO_VISIBLE_DELTA_E:
        return ""
    better = result.names[0] if difference > 0 else other
    return better if abs(difference) > (high - low) / 2 + (result.film_delta_e[other] or 0.0) else None


def conditions_disagree(result: Comparison, other: str) -> bool:
    """Return whether two conditions, or one and the weighted mean, have different answers for the first sensor and another."""
    pair = result.pair(other)
    return len({_winner(part, other) for part in (pair, *(part for _, part in pair.counted))} - {None}) > 1


def headline(result: Comparison, other: str) -> str:
    """Return the answer for the first sensor and another; each condition's and then the weighted mean's where these disagree."""
    pair = result.pair(other)
    if not conditions_disagree(pair, other):
        return "; ".join(filter(None, (verdict(pair, other), pair.unconverged)))
    words = ["the conditions disagree", *_answers_of_conditions(pair, other), f"weighted mean: {verdict(pair, other)}"]
    return "; ".join(filter(None, (*words, pair.unconverged)))


def _answers_of_conditions(pair: Comparison, other: str) -> list[str]:
    return [f"{part.prepared.condition} (weight {weight:.3g}): {verdict(part, other)}" for weight, part in pair.counted]


def answer(result: Comparison, other: str) -> list[str]:
    """Return `headline` as of `with_headline`: first who is better, on the weighted mean, then the largest cause of that."""
    pair = result.pair(other)
    first, *others = verdict_parts(pair, other)
    found = pair.unconverged.split("; ") if pair.unconverged else []
    causes = [words for words in found if not words.startswith(NOT_CONVERGED)]
    begin = [first]
    if conditions_disagree(pair, other):
        begin, others = ["the conditions disagree", f"weighted mean: {first}"], [*others, *_answers_of_conditions(pair, other)]
    return with_headline([*begin, *causes, *others], next((words for words in found if words.startswith(NOT_CONVERGED)), ""))


def answers(result: Comparison) -> list[list[str]]:
    """Return the answer for each later sensor, and the order of three and more, each as of `with_headline`."""
    found = [answer(result, other) for other in result.names[1:]]
    return found + ([with_headline(ranking_words(result).split("; "))] if result.pairs else [])


def headlines(result: Comparison) -> list[str]:
    """Return the answers, each as one text."""
    return [*(headline(result, other) for other in result.names[1:]), *([ranking_words(result)] if result.pairs else [])]


def sum_if_known(parts: Sequence[tuple[float, float | None]]) -> float | None:
    """Return the sum of weights × numbers; None if one of them is."""
    known = [weight * value for weight, value in parts if value is not None]
    return sum(known) if len(known) == len(parts) else None


def _pair_as_dict(result: Comparison) -> dict[str, Any]:
    """Return what compare.json has of the first sensor and another one alone, beside their difference."""
    prepared = result.shown.prepared
    return {
        "scores": {name: list(score) for name, score in result.scores.items()},
        "fov_deg": prepared.sensors[0].camera.fov_deg,
        "scored_dots": list(prepared.scored_dots),
        "chosen": prepared.view.as_dict() | {"finest": prepared.finest},
        "viewing": prepared.viewing.as_dict(),
    }


def _summary_of(compared: Compared) -> dict[str, Any]:
    """Return a sensor's entry of compare.json; `statistics` are those of its first frame, as in score.json."""
    sensor, score = compared.sensor, compared.score
    return {
        "file": sensor.source,
        "pixels": list(sensor.pixels),
        "statistics": score.statistics(),
        "camera": sensor.camera.model_dump(),
        "fov_deg": sensor.camera.fov_deg,
        "pixel": sensor.pixel.model_dump(),
        "assumption": sensor.pixel.assumption,
        "exposure": sensor.exposure.model_dump(),
        "border_um": list(score.border_um),
        "film": compared.film.as_dict(),
        "render_noise": asdict(compared.noise),
        "dark": compared.dark,
        "causes": [cause.as_dict() for cause in compared.causes],
        **({} if compared.colour is None else {"colour": compared.colour}),
        "white_spectrum": white_light(compared.irradiance)[1],
        "irradiance": compared.irradiance.header,
    }


# --- the way from the files to the result ---------------------------------------------------------------------------------------


@checks_arguments
def compare(
    files: Sequence[str | os.PathLike[str]],
    scene: str | os.PathLike[str] | None = None,
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match = "view",
    repeats: int = 8,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    jobs: int | None = None,
    scheduler: Any = None,
    progress: Stage | None = None,
    out: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Comparison:
    """Compare two or more sensors in one scene, by the mean ΔE of their pictures on one display.

    files : of the sensors: TOML files with a table [pixel], such as data sheets; files of technologies, or names of packaged ones.
        The first is the reference
    scene : XML file or name of a packaged scene; None means that of the study, or csf
    study : a Study without axes, the name of a packaged one, or a TOML file. Its scene, display, exposure and conditions hold for
        all sensors, and its lens for files that state none. Under conditions, the result is that of the weighted mean over them,
        and has `conditions`. Its pixels, technologies and pixel sizes are not used
    match : 'view': the same field of view, f-number and object distance, those of the first file's camera; 'lens': the same focal
        length; 'own': each file's own camera. Only the central field that all have in common is compared
    repeats : pairs of frames; frames of one number have the same seeds
    config : one or more TOML files with settings of all sensors, which take precedence over the sensors' own files
    parameters : of the scene, each in its unit
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant; None means the fastest that works
    jobs : processes; None means one per core, where they are worth it. The results do not depend on it
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers replace local processes
    progress : returns a callback for each named stage
    out : folder whose results.csv keeps the mean ΔE of each frame, so that an interrupted comparison goes on; None keeps nothing
    settings : tables and fields of `Run` for all sensors: camera={"f_number": 2.8}, exposure={…}, display={…}, seed=3. They take
        precedence over the study, but not over its conditions

    Raises PixsimError for invalid input, before anything is rendered.

    >>> small = {"display": {"dots": 32}, "resolution": 64, "pixel": {"pitch_um": 60.0}}
    >>> result = compare(["0.35um", "4t-bsi"], repeats=2, jobs=1, camera={"die_mm": 2.7}, **small)
    >>> sorted(result.scores), result.difference["4t-bsi"] < 0  # a quieter pixel
    (['0.35um', '4t-bsi'], True)
    """
    paths = [config] if isinstance(config, str | os.PathLike) else config
    options = {name: dict(value) if isinstance(value, Mapping) else value for name, value in settings.items()}
    options |= {"scene": dict(parameters)} if parameters else {}
    given: dict[str, Any] = {"config": [Path(path) for path in paths], "options": options}
    with collected_notes():  # also of what is found before the comparison begins
        prepared = prepare(files, scene, study=study, match=match, repeats=repeats, sensor=sensor, variant=variant, **given)
        return run_prepared(prepared, jobs=jobs, scheduler=scheduler, progress=progress, out=out)


def run_prepared(
    prepared: Prepared,
    *,
    jobs: int | None = None,
    scheduler: Any = None,
    progress: Stage | None = None,
    out: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Run a prepared comparison; the other arguments are those of `compare`."""
    stage = progress or (lambda _: lambda *_: None)
    with collected_notes() as notes, ExitStack() as stack:
        folder = None if out is None else stack.enter_context(output_folder(out))
        results = None if folder is None else folder / "results.csv"
        if results is not None:
            ResultsFile(results).check_replaceable()
        if jobs is not None or scheduler is not None:
            workers: Workers | None = stack.enter_context(workers_for(jobs, scheduler))
        else:
            workers = None
        whole = lit_parts(prepared, stage)
        pairs = [lit_pair(pair, whole, stage) for pair in prepared.pairs]
        lit = dict.fromkeys(each for parts in (whole, *pairs) for each in parts)
        evaluate_all(list(lit), results, workers, stage("sense and score"))
        result = comparison_of(prepared, whole)
        with without_warnings():
            of_pairs = tuple(comparison_of(pair, parts) for pair, parts in zip(prepared.pairs, pairs, strict=True))
        result = replace(result, pairs=of_pairs)
        elsewhere = [elsewhere_note(result, other) for other in result.names[1:]]
    return replace(result, notes=(*notes, *result.notes, *filter(None, elsewhere)))


@dataclass(eq=False)
class Lit:
    """A comparison under one condition with the light of its sensors, and then with the mean ΔE of their frames.

    made, series : of each sensor
    viewed : (viewings, repeats) mean ΔE of each sensor, by its name
    """

    prepared: Prepared
    made: list[Rendered]
    series: list[Series]
    viewed: dict[str, Array] = field(default_factory=dict)

    @property
    def sizes(self) -> list[Sizes]:
        """The pixel size of each sensor, and its frames."""
        return [{sensor.pixel.pitch_um: self.prepared.repeats} for sensor in self.prepared.sensors]

    @cached_property
    def compared(self) -> dict[str, Compared]:
        """Each sensor's part of the comparison, by its name."""
        found = {}
        for sensor, light, series in zip(self.prepared.sensors, self.made, self.series, strict=True):
            chain = first_chain(series)
            score = chain.simulate(*series.stream, 0)
            time_s = score.frame.integration_s
            white_e = chain.white_e_per_s * time_s
            found[sensor.name] = Compared(
                sensor,
                light.image,
                light.noise,
                light.film,
                score,
                self.viewed[sensor.name],
                dark_clip(score.physics, time_s, white_e),
                white_e,
                steps_of(self.prepared, sensor, light),
                None if chain.rendition is None else chain.colour_facts(time_s),
            )
        return found


def first_chain(series: Series) -> ImagingChain:
    """Return the imaging chain of a sensor's first frame."""
    return series.imaging.chain(series.light(), series.imaging.registered(0))


def lit_parts(prepared: Prepared, stage: Stage) -> list[Lit]:
    """Return a comparison under each of its conditions, with the light of its sensors."""
    parts = []
    for part in prepared.parts:
        with named(f"condition {part.condition}" if part.condition else ""):
            parts.append(lit_part(part, partial(_stage_of, stage, part.condition) if part.condition else stage))
    return parts


def lit_part(prepared: Prepared, stage: Stage, pair: str = "") -> Lit:
    """Return a comparison under one condition with the light of its sensors.

    pair : names of its sensors, if they are compared as if there were no others
    """
    made = render_all(prepared, stage)
    lights = zip(prepared.sensors, made, strict=True)
    series = [series_of_sensor(prepared, sensor, light.image, pair) for sensor, light in lights]
    chains = {each.name: first_chain(each) for each in series}
    grey = [name for name, chain in chains.items() if chain.rendition is None]
    check_one_ideal(grey, {name: chain.screen.ideal for name, chain in chains.items() if chain.rendition is not None})
    return Lit(prepared, made, series)


def lit_pair(prepared: Prepared, whole: Sequence[Lit], stage: Stage) -> list[Lit]:
    """Return the comparison of two of the sensors alone under each condition: that of all of them, if it is the same."""
    one, other = prepared.sensors
    pair = f"{one.name} and {other.name}"
    found = []
    for part, of_all in zip(prepared.parts, whole, strict=True):
        if is_alike(part, of_all):
            found.append(of_all)
            continue
        words = f"{pair}: {part.condition}" if part.condition else pair
        condition = f"condition {part.condition}" if part.condition else ""
        with without_warnings(), named(f"{pair} alone"), named(condition):
            found.append(lit_part(part, partial(_stage_of, stage, words), pair))
    return found


def is_alike(prepared: Prepared, of_all: Lit) -> bool:
    """Return whether the comparison of two sensors is the same among more: field, chart, film and displays."""
    among = of_all.prepared
    alike = ("settings", "border", "viewing", "film_width")
    if any(getattr(prepared, name) != getattr(among, name) for name in alike):
        return False
    # Another sensor may have asked for a finer film.
    return all(sensor in among.sensors for sensor in prepared.sensors) and of_all.made[0].image.shape[1] == among.film_width


def comparison_of(prepared: Prepared, parts: Sequence[Lit]) -> Comparison:
    """Return the comparison of evaluated sensors; its notes are those on causes, black levels and assumptions.

    parts : under each of its conditions
    """
    comparisons = [_under_condition(part, lit) for part, lit in zip(prepared.parts, parts, strict=True)]
    if not prepared.conditions:
        return comparisons[0]
    shown = next(part for part in comparisons if part.prepared.weight)
    return replace(shown, prepared=prepared, conditions=tuple(comparisons), notes=_notes_of(comparisons))


def _under_condition(prepared: Prepared, lit: Lit) -> Comparison:
    """Return the comparison of the sensors under one condition."""
    compared = tuple(lit.compared[sensor.name] for sensor in prepared.sensors)
    notes = [f"{each.name}: {cause}" for each in compared for cause in each.causes]
    for each in compared:
        pixel = each.sensor.pixel
        notes += [f"{each.name}: {clip_words(each.dark, pixel.model_dump())}"] if clips_dark(each.dark) else []
        notes += [f"{each.name}: {pixel.assumption}"] if pixel.assumption else []
    return Comparison(prepared, compared, tuple(notes))


def _stage_of(stage: Stage, part: str, name: str) -> Progress:
    return stage(f"{part}: {name}")


def _notes_of(parts: Sequence[Comparison]) -> tuple[str, ...]:
    """Return the notes of all conditions; those that not all have name theirs."""
    of_all = [note for note in parts[0].notes if all(note in part.notes for part in parts)]
    return *of_all, *(f"{part.prepared.condition}: {note}" for part in parts for note in part.notes if note not in of_all)


def render_all(prepared: Prepared, stage: Stage) -> list[Rendered]:
    """Return the light of every sensor on one film, fine enough for all."""
    width = prepared.film_width
    while True:
        made: list[Rendered] = []
        for sensor in prepared.sensors:
            light = render_one(prepared, sensor, width, stage(f"render {sensor.name}"))
            if light.image.shape[1] > width:  # its film had to be finer: the others take that one too
                width = light.image.shape[1]
                break
            made.append(light)
        else:
            pairs = list(zip(prepared.sensors, made, strict=True))
            seen = [Seen(light.image, s.camera, derive(s.pixel), prepared.border_um(s.camera)) for s, light in pairs]
            white = white_header(seen, prepared.settings.display)
            for light in made:
                light.image.header |= white
            return made


def render_one(prepared: Prepared, sensor: Contestant, width: int, progress: Progress) -> Rendered:
    """Return the light of a sensor on a film of so many samples across, or more if the film's error asks for them."""
    scene = sensor.scene.with_resolution(width)
    with named(sensor.name):
        plan = prepared.plan(sensor, scene)
        for note in plan.warnings:
            warn(note)
        settings = prepared.settings_of(sensor)

        def plan_of(scene: Scene) -> Plan:
            return prepared.plan(sensor, scene)

        measured = [Imaging.of(settings, sensor.camera)]
        return render_and_measure(scene, plan, settings, sensor.pixel, measured, plan_of=plan_of, progress=progress)


def series_of_sensor(prepared: Prepared, sensor: Contestant, image: SpectralImage, pair: str = "") -> Series:
    """Return the series of a sensor, which show and score the same part of the scene as those of the others.

    Its random streams do not name the sensor, so that equal sensors give equal frames.

    pair : of `lit_part`
    """
    with named(sensor.name):
        settings = prepared.settings
        shared = settings.display, settings.correction, settings.develop
        imaging = Imaging(sensor.camera, sensor.pixel, sensor.exposure, *shared, None, prepared.border_um(sensor.camera), True)
        for text in (*sheet_disagreements(sensor.pixel), *implausible_numbers(sensor.pixel)):
            warn(f"{sensor.name}: {text}")
        first, *others = prepared.displays.values()
        scenes = SceneCache(image, sensor.camera, first, len(imaging.physics.channels), single=True, others=others)
        columns = {"pair": pair, "condition": prepared.condition}
        series = Series(sensor.name, imaging, scenes, ("compare", settings.seed), False, columns, prepared.condition, False)
        light = series.light()
        assert isinstance(light, PreparedScene)
        warn_of_clipping(light.beyond_white)
        warn_of_stack_limits(imaging.physics, sensor.camera, image.wavelength_nm)
        return series


def steps_of(prepared: Prepared, sensor: Contestant, light: Rendered) -> FilmSteps:
    """Return a sensor's mean ΔE on its film and on coarser ones, in the same parts of the scene as those of the others."""
    with without_warnings():  # the result itself warns
        imaging = Imaging.of(prepared.settings_of(sensor), sensor.camera)
        return film_steps(light.image, imaging, light.plan.chart, prepared.border_um(sensor.camera) / REGISTERED_BORDER)


def evaluate_all(parts: Sequence[Lit], results: Path | None, workers: Workers | None, progress: Progress) -> None:
    """Evaluate the frames of all sensors under all conditions, and note the mean ΔE of each frame under each viewing.

    results : the file of the rows, from which an interrupted comparison goes on; None for none
    workers : None takes as many processes as are worth it
    """
    series, sizes = [each for part in parts for each in part.series], [each for part in parts for each in part.sizes]
    told_by = [name for name in series[0].columns if any(each.columns[name] for each in series)]
    series = [replace(each, columns={name: each.columns[name] for name in told_by}) for each in series]
    if workers is None:
        costs = [(part.prepared.repeats, part.prepared.cost_of_frame(sensor)) for part in parts for sensor in part.prepared.sensors]
        in_all_s = sum(repeats * cost.seconds for repeats, cost in costs)
        workers = workers_here(1 if in_all_s < FEW_SECONDS else jobs_in_memory(max(cost.memory_bytes for _, cost in costs)))
    evaluations = Evaluations(series, results, workers, len(parts))
    rows = [NO_ROWS for _ in series]
    with evaluations.resumed(sizes):
        for number, own in evaluations.rows(sizes, progress):
            rows[number] = own
            for reason in evaluations.left_out(number, sizes[number]).values():
                raise AlikeChannelsError(f"{series[number].label}: {reason}")
        evaluations.finish(rows)
    left = iter(rows)
    for part in parts:
        places = [list(part.prepared.displays).index(viewing) for viewing in part.prepared.viewing.viewings]
        for each in part.series:
            values = np.array([float(row["mean_delta_e"]) for row in next(left)])
            part.viewed[each.name] = values.reshape(part.prepared.repeats, -1).T[places]
