"""Run a study: mean ΔE for many pixel sizes, technologies and sensors; resumable, and independent of the number of workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.arguments import checks_arguments
from pixsim.base.config import (
    FILES,
    SETTINGS_FILE,
    Uncertainty,
    checked,
    packaged,
    read_toml,
    resolve_file,
    scene_table,
    settings_text,
    sheet_uncertainty,
    spreads_of_study,
    study_layers,
    without_uncertainty,
)
from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.files import missing, output_folder
from pixsim.base.labels import label_of, labels_of
from pixsim.base.notes import collected_notes, warn
from pixsim.base.parameters import Camera, Layer, Spread, Study, content_hash, merge, owner_of, paths_of
from pixsim.base.progress import Progress, Stage
from pixsim.base.schema import KEY
from pixsim.light.spectral import SpectralImage
from pixsim.light.stored import PictureFile
from pixsim.scene.convergence import render_until
from pixsim.scene.scene import packaged_scenes
from pixsim.sensor.pixel import warn_of_disagreements, warn_of_implausible_numbers
from pixsim.sensor.technology import check_name
from pixsim.sensor.unused import warn_of_unused_settings
from pixsim.studies.allocation import next_sensors, next_where_open
from pixsim.studies.cases import Case, cases_of, check_number, with_range_ends
from pixsim.studies.elsewhere import curves_viewed
from pixsim.studies.engine import Workers, results_of, workers_for
from pixsim.studies.evaluations import Counts, Evaluations, TooFewSizesError, check_ideals, warn_of_clipped_white, warn_of_stacks
from pixsim.studies.keys import light_hash, remember_evaluated
from pixsim.studies.oversampling import FilmError, render_and_measure
from pixsim.studies.pixels import imaging_of, physics_of, technology_of
from pixsim.studies.preparation import View, choose_view, first_film, fitted_range, jobs_in_memory, largest_frame_bytes, study_plan
from pixsim.studies.result import CasesResult, Curve, StudyResult, causes_of_curve, curve_of, few
from pixsim.studies.results_file import COLUMNS, ResultsFile
from pixsim.studies.rows import NO_ROWS
from pixsim.studies.sampling import Sampling, Sizes, first_sampling, largest_pixel_um, study_pitches_um
from pixsim.studies.series import Series, most_channels, scenes_of, series_of
from pixsim.studies.sight import Sight, clearest
from pixsim.studies.unused import StudyConfiguration
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import SceneCache, Seen, white_header

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene
    from pixsim.studies.budget import Settled
    from pixsim.studies.sensor_types import Asked

Light = tuple[SpectralImage, Camera, FilmError]
FEW_CASES = 64  # of a study whose curves with an open end get more sizes and sensors


def read_study(name: str | os.PathLike[str]) -> Layer:
    """Return the table of a packaged study by name, or of a TOML file; the files that it names may lie next to it.

    A file with a `base` has all values of that study but those that it sets itself, and its random streams.
    """
    path = study_path(name)
    table: dict[str, Any] = {}
    for file in with_bases(path):
        own = {key: value for key, value in _study_table(file).items() if key != "base"}
        if table:
            if "name" not in own:
                raise invalid("name", f"none in '{file}'", "a name of its own for a study with a base", 'Write name = "my-study".')
            own.setdefault("streams", table.get("streams", table.get("name")))
        table = merge(table, own)
    return Layer(table, str(path))


def study_path(name: str | os.PathLike[str]) -> Path:
    """Return the file of a study: of a packaged one by its name. Raises PixsimError for another name."""
    known = packaged("data/studies")
    path = known.get(str(name)) or Path(name)
    if path.suffix != ".toml" and not path.is_file():
        got = f"'{name}'" if path.parent == Path() else missing(path)
        raise invalid("study", got, f"a TOML file, or one of {', '.join(known)}", did_you_mean(str(name), known))
    return path


def with_bases(path: Path) -> list[Path]:
    """Return the files of a study: the base of its base and so on, then its own. Raises PixsimError for a circle of bases."""
    files = [path]
    while "base" in (table := read_toml(files[0])):
        base = table["base"]
        if not isinstance(base, str):
            raise invalid("base", repr(base), "the name of a packaged study, or a TOML file", f"Change it in '{files[0]}'.")
        above = study_path(resolve_file(files[0], base))
        if above.resolve() in [file.resolve() for file in files]:
            raise invalid("base", f"'{above}', which is based on itself", "a study without such a circle", f"See '{files[0]}'.")
        files.insert(0, above)
    return files


def _study_table(path: Path) -> dict[str, Any]:
    """Return the table of one file, with whole paths of the files next to it. Raises PixsimError if it is no study."""
    table = read_toml(path)
    if "name" not in table and isinstance(pixel := table.get("pixel"), dict) and "pitch_um" in pixel:
        hint = f"Pass it to a study: pixsim study pixel-size --config {path}"
        raise invalid("study", f"'{path}', the file of a sensor", "the file of a study, which has a name", hint)
    if old := [name for name in ("vary", "ranges") if name in table]:
        raise invalid(
            old[0], f"'{path}', with the spelling of an earlier version", "[[axis]] with alone = true", new_spelling(table)
        )
    for part in (table, table.get("quick", {})):
        if isinstance(part, dict):
            _resolve_files(part, path)
    if isinstance(pixel := table.get("pixel"), dict):
        table["pixel"], _ = without_uncertainty(pixel, str(path))
    if isinstance(sensors := table.get("sensors"), dict):
        table["sensors"] = sensors | {name: pixel for name, (pixel, _) in _sheets_of(sensors, path).items()}
    return table


def new_spelling(table: Mapping[str, Any]) -> str:
    """Return how a [[vary]] or an entry of [ranges], the first of a table, is written as an axis."""
    vary, ranges = table.get("vary"), table.get("ranges")
    if isinstance(vary, list) and vary and isinstance(vary[0], dict):
        return f'Write [[axis]] name = "{vary[0].get("name", "")}", alone = true, values = [...], with the entries of settings.'
    name, number = next(iter(ranges.items())) if isinstance(ranges, dict) and ranges else ("name", "dark_current_na_per_cm2")
    return f'Write [[axis]] name = "{name}", range_of = "{number}", alone = true.'


def _sheets_of(sensors: dict[str, Any], path: Path) -> dict[str, tuple[dict[str, Any], dict[str, Spread]]]:
    """Return the data sheets of a study's file, each without its table `uncertainty`, and that table."""
    tables = {name: pixel for name, pixel in sensors.items() if isinstance(pixel, dict)}
    return {name: without_uncertainty(pixel, f"{path}: sensors.{name}") for name, pixel in tables.items()}


def uncertainty_of(name: str | os.PathLike[str], config: Sequence[str | os.PathLike[str]] = ()) -> dict[str, dict[str, Spread]]:
    """Return [pixel.uncertainty] of a study's file and of sensor files, of which later ones take precedence, for `''`.

    And that of each data sheet whose numbers stand in the study's file, by its name.
    """
    files = with_bases(study_path(name))
    own = {number: spread for path in (*files, *map(Path, config)) for number, spread in sheet_uncertainty(path).items()}
    tables = [(file, read_toml(file).get("sensors")) for file in files]
    sheets = {
        name: found for file, sensors in tables if isinstance(sensors, dict) for name, found in _sheets_of(sensors, file).items()
    }
    return {"": own} | {name: spreads for name, (_, spreads) in sheets.items()}


def _resolve_files(table: dict[str, Any], path: Path) -> None:
    """Replace file names in a study's table by their paths, for files that lie next to the study's file.

    Also in the settings of its axes and conditions.
    """
    if isinstance(names := table.get("technologies"), list):
        table["technologies"] = [resolve_file(path, name) for name in names]
    if isinstance(processes := table.get("process"), dict):
        table["process"] = {resolve_file(path, name): numbers for name, numbers in processes.items()}
    values = [value for axis in _tables(table.get("axis")) for value in _resolved_values(axis, path)]
    settings = [each.get("set") for each in (*_tables(values), *_tables(table.get("condition")))]
    for part in (table, *_tables(settings)):
        for *above, name in FILES:
            node: Any = part
            for key in above:
                node = node.get(key) if isinstance(node, dict) else None
            if isinstance(node, dict) and name in node:
                node[name] = resolve_file(path, node[name])


def _tables(value: Any) -> list[dict[str, Any]]:
    """Return the tables of a list; none of anything else, which is refused later."""
    return [each for each in value if isinstance(each, dict)] if isinstance(value, list) else []


def _resolved_values(axis: dict[str, Any], path: Path) -> list[Any]:
    """Return the values of an axis, after replacing the file names among them, if its setting is a file."""
    values, dotted = axis.get("values"), axis.get("set")
    if not isinstance(values, list):
        return []
    if isinstance(dotted, str) and tuple(dotted.split(".")) in FILES:
        values[:] = [resolve_file(path, value) for value in values]
    return values


def load_study(
    name: str | os.PathLike[str],
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    scene: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Study:
    """Return a packaged study by name, or one from a TOML file. Raises PixsimError listing all of its errors.

    config : one or more TOML files with a sensor, its camera, exposure and display, as for `pixsim run`; later files take
        precedence. The well and dark current of a data sheet scale with the photodiode's area.
    parameters : of the scene; they override those of the study
    pixel : fields of the pixels, each in its unit, which override those of the study and the files; a data sheet may stand here
        instead of in a file, with its pitch_um
    scene : XML file or name of a packaged scene
    settings : other fields of `Study`, tables as dicts: camera={"f_number": 2.8}, pitch={"min_um": 2.0}, window_mm=1.0
    """
    paths = [config] if isinstance(config, str | os.PathLike) else config
    options = {name: dict(value) if isinstance(value, Mapping) else value for name, value in settings.items()}
    of_scene = {"file": None if scene is None else str(scene), "parameters": dict(parameters) if parameters else None}
    options |= {"scene": {name: value for name, value in of_scene.items() if value is not None}} if scene or parameters else {}
    options |= {"pixel": dict(pixel)} if pixel else {}
    return checked_study(study_layers(read_study(name), [Path(path) for path in paths], options), options)


def checked_study(layers: Sequence[Layer], options: Mapping[str, Any] | None = None) -> Study:
    """Return a study from its table and overriding options; its `quick` table is checked too, even if unused.

    options : among the layers; a warning names those that an axis or the conditions override
    """
    study: Study = checked(Study, layers)
    given = {name: value for name, value in (options or {}).items() if name not in ("axis", "condition")}
    for path in paths_of(given):
        if owner := owner_of(study, path):
            warn(f"{'.'.join(path)} is not used: {owner} sets it")
    if study.quick:
        full = [Layer({key: value for key, value in layer.table.items() if key != "quick"}, layer.source) for layer in layers]
        quick = [Layer(layer.table["quick"], f"{layer.source} [quick]") for layer in layers if "quick" in layer.table]
        checked(Study, [*full, *quick])
    return study


def repeated_settings(prepared: Prepared, chosen: Study, image: SpectralImage, asked: Asked | None = None) -> str:
    """Return the text of settings.toml, from which `pixsim study` makes the same numbers again.

    chosen : the study as it was run, with the settings for its tolerance
    image : its render
    asked : about its unknown numbers
    """
    from pixsim.scene.convergence import without_clock

    scene, kept = prepared.scene, without_clock(prepared.study, chosen, image)
    file = kept.scene.file
    of_scene = {
        "file": file if file in packaged_scenes() else str(scene.path),
        "parameters": scene_table(scene.path.parent, kept.scene.parameters),
    }
    camera = scene.camera(kept.camera, kept.lens).options.model_dump(exclude_none=True)
    spreads = spreads_of_study(kept, prepared.uncertainty)
    return settings_text(kept, repeating_command(prepared.variant, asked), spreads, scene=of_scene, camera=camera)


def repeating_command(variant: str | None, asked: Asked | None = None) -> str:
    """Return the command that repeats a study in the folder of its settings.toml."""
    words = f"pixsim study {SETTINGS_FILE}" + (f" --variant {variant}" if variant else "")
    if asked is None:
        return words
    sizes = "".join(f" --smaller-than {size!r}" for size in asked.smaller_than_um)
    return f"{words} --{'sobol' if asked.total else 'uncertainty'} {asked.draws}{sizes}"


def next_round(study: Study, curves: Sequence[Curve], sampling: Sampling, refine: bool = True) -> Sampling:
    """Return the sampling after a round of additions to each curve; unchanged at a limit.

    A curve whose interval misses `target_ci_um` gets sizes and sensors where they narrow it most. Without a target, so does one
    whose interval has an open end (`next_where_open`), unless the sizes are a list of the user's.

    refine : whether curves without a target may have additions

    The choice depends on the curves alone, so it is the same on any workers and in a resumed study.
    """
    chosen = dict(sampling)
    for curve in curves:
        sensors = sampling[curve.technology]
        sizes, most = len(study_pitches_um(study, curve.technology)), max(study.repeats, study.max_repeats)
        if study.target_ci_um is None:
            if not (refine and study.refine) or study.pitch.values_um is not None:
                continue
            more = next_where_open(curve.fit, sensors, sizes * study.repeats, most)
        elif curve.optimum.half_width_um <= study.target_ci_um:
            continue
        else:
            more = next_sensors(curve.fit, sensors, most)
        if study.max_evaluations is None:
            within = sum(more.values()) <= sizes * most
        else:
            evaluations = sum(sum(counts.values()) for counts in (chosen | {curve.technology: more}).values())
            within = evaluations <= study.max_evaluations
        if within:
            chosen[curve.technology] = more
    return chosen


def check_technologies(study: Study) -> None:
    """Raise PixsimError for an unknown technology, one that a study has twice, or numbers of one that it does not have."""
    processes: dict[str, str] = {}
    for name in study.process:
        if name not in study.technologies:
            raise invalid("process", f"'{name}'", f"technologies of the study: {', '.join(study.technologies)}")
    for name in study.technologies:
        check_name(name)
        sheet = study.sensors[name].model_dump() if name in study.sensors else None
        content = content_hash([technology_of(study, name).content, sheet])
        if content in processes:
            kind = "process" if sheet is None else "data sheet"
            raise invalid("technologies", f"{name} and {processes[content]}, which are the same {kind}", f"each {kind} once")
        processes[content] = name


def check_pitches(study: Study) -> None:
    """Raise PixsimError for an impossible pitch or limit, before anything is computed.

    Of a study without axes.
    """
    for technology in study.technologies:
        pitches_um, process = study_pitches_um(study, technology).tolist(), technology_of(study, technology)
        try:  # what a pixel is derived from grows or falls with its pitch: sizes between two possible ones are possible
            smallest, largest = (physics_of(study, technology, pitches_um[end], process).pixel for end in (0, -1))
        except PixsimError:
            for pitch_um in pitches_um:  # the message is that of the first impossible one
                physics_of(study, technology, pitch_um, process)
            raise
        warn_of_disagreements(largest, process)
        # A study tries unusual sizes, whose wells outgrow a given gain or do not fill its range: only the smallest and the largest
        # tell of a unit.
        warn_of_implausible_numbers(smallest, process, pitches_um[-1])
    first = sum(sum(sensors.values()) for sensors in first_sampling(study).values())
    if study.max_evaluations is not None and study.max_evaluations < first:
        expected = f"at least {first}, with which the study starts"
        raise invalid("max_evaluations", study.max_evaluations, expected, "Raise it, or lower repeats or pitch.count.")


def scene_for(study: Study, variant: str | None = None, known: dict[str, Scene] | None = None) -> tuple[Scene, Camera]:
    """Return the study's scene and the camera of its window. Raises PixsimError for invalid input.

    known : scenes by their settings, to which this one is added
    """
    from pixsim.scene.scene import load_scene

    known = {} if known is None else known
    key = content_hash([study.scene.model_dump(mode="json"), study.resolution])
    if key not in known:
        parameters: dict[str, Any] = dict(study.scene.parameters)
        loaded = load_scene(study.scene.file, variant=variant, **parameters)
        known[key] = loaded.with_resolution(study.resolution) if study.resolution else loaded
    scene = known[key]
    return scene, scene.camera(study.camera, study.lens).window(study.window_mm)


@dataclass(frozen=True)
class Prepared:
    """A study with everything that it left open, found and checked before anything is rendered.

    study : with its pixel sizes, display and chart
    scene, camera : of the study; the camera is that of the window
    view : display and chart that pixsim chose for the sensor of a data sheet
    variant : of Mitsuba; None means the fastest that works
    uncertainty : of the study's [pixel] and data sheets, as its files state it
    cases : the cases of a study with axes or conditions, and what each of them leaves open; empty for another study
    """

    study: Study
    scene: Scene
    camera: Camera
    view: View
    variant: str | None = None
    cases: tuple[tuple[Case, Prepared], ...] = ()
    uncertainty: Uncertainty = field(default_factory=dict)

    @property
    def parts(self) -> tuple[tuple[Case, Prepared], ...]:
        """The cases of any study; one without axes is its own only case."""
        return self.cases or ((Case(self.study), self),)

    @property
    def evaluations(self) -> int:
        """Number of evaluations that the study starts with."""
        return sum(sum(sum(sensors.values()) for sensors in first_sampling(case.study).values()) for case, _ in self.parts)


def prepare(study: Study, variant: str | None = None, quick: bool = False) -> Prepared:
    """Choose what a study leaves open, and check everything that can be checked before a render.

    quick : use the values of the study's `quick` table

    Raises PixsimError for invalid input, and warns of a range of sizes that had to be shortened.
    """
    has_quick = study.quick or any(axis.quick for axis in study.axis)
    if quick and not has_quick:
        if "quick" in study.model_fields_set:  # `study_layers` leaves out of it what files and options set
            warn(f"the [quick] table of the study {study.name} changes nothing: what it sets was given otherwise")
        else:
            warn(f"the study {study.name} has no [quick] table: running it in full")
    study = with_range_ends(study.quickened if quick else study)
    if not (study.axis or study.condition):
        made = _prepare(study, variant)
        warn_of_unused([(study, made.study)])
        return made
    # Display and chart are those of the study itself, so that all of its cases are comparable.
    if study.tolerance_delta_e:
        hint = "Leave it out, or run the study for one case."
        raise invalid("tolerance_delta_e", study.tolerance_delta_e, "no tolerance in a study with axes or conditions", hint)
    if taken := [axis.name for axis in study.axis if axis.name in (*COLUMNS, KEY)]:
        raise invalid("axis", f"name = '{taken[0]}', a column of every study", "another name")
    scenes: dict[str, Scene] = {}
    own = _without_axes(study)
    scene, camera = scene_for(own, variant)
    view = _chosen_view(own, scene, camera)
    prepared: list[tuple[Case, Prepared]] = []
    cases = cases_of(study)
    for case in cases:
        with _named(case):
            seen = (
                view if _same_chart(case.study, own) or scene_for(case.study, variant, scenes)[0].shows_csf else view.without_chart
            )
            part = _prepare(_with_view(case.study, seen), variant, view, scenes)
        prepared.append((replace(case, study=part.study), part))
    warn_of_unused([(case.study, part.study) for case, (_, part) in zip(cases, prepared, strict=True)])
    # A chart that not all cases have stays chosen: settings.toml cannot state its end for all of them.
    kept = view if all(_same_chart(case.study, own) for case, _ in prepared) else view.without_chart
    return Prepared(_with_view(study, kept), view.scene(scene), camera, view, variant, tuple(prepared))


def warn_of_unused(cases: Sequence[tuple[Study, Study]]) -> None:
    """Warn of the settings that no case of a study uses, and of those that none uses in one of its technologies.

    cases : each as the user set it, and with what it left open
    """
    sensors: dict[str, list[StudyConfiguration]] = {}
    for given, complete in cases:
        for technology in given.technologies:
            pixel = physics_of(complete, technology, float(study_pitches_um(complete, technology).max()))
            sensors.setdefault(technology, []).append(StudyConfiguration.of_technology(given, pixel, technology))
    warn_of_unused_settings(dict(zip(labels_of(list(sensors)), sensors.values(), strict=True)))


def _same_chart(first: Study, second: Study) -> bool:
    """Return whether two studies show the same scene with the same chart."""
    files = [(study.scene.file, study.scene.parameters.get("chart")) for study in (first, second)]
    return files[0] == files[1]


def _without_axes(study: Study) -> Study:
    """Return the study with its own settings alone; an axis over technologies leaves the first of them."""
    table = study.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition", "quick"})
    for axis in study.axis:
        if "technologies" in axis.points[0].table:
            table |= axis.points[0].table
    return Study.model_validate(table)


@contextmanager
def _named(case: Case) -> Iterator[None]:
    """Name the case in an error."""
    try:
        yield
    except PixsimError as error:
        raise PixsimError(f"{case.words or 'base'}: {error}") from None


def _chosen_view(study: Study, scene: Scene, camera: Camera) -> View:
    return View() if study.own_um is None else choose_view(study.own_um, camera, study.display, scene)


def _with_view(study: Study, view: View) -> Study:
    """Return the study with the display and the chart of a view, except for what an axis or a condition sets of them."""
    display = study.display if "dots" in study.display.model_fields_set else view.display(study.display)
    of_scene = study.scene.model_copy(update={"parameters": view.parameters({}) | study.scene.parameters})
    return study.model_copy(update={"display": display, "scene": of_scene})


def _prepare(study: Study, variant: str | None, view: View | None = None, scenes: dict[str, Scene] | None = None) -> Prepared:
    """Return `prepare` of a study without axes.

    view : of the study whose case it is, which its settings have already; None means to choose it
    scenes : of the other cases, by their settings; it is added to
    """
    check_technologies(study)
    scene, camera = scene_for(study, variant, {} if scenes is None else scenes)
    study = fitted_range(study, camera)
    if view is None:
        view = _chosen_view(study, scene, camera)
        study, scene = _with_view(study, view), view.scene(scene)
    check_pitches(study)
    for technology in study.technologies:
        largest_um = float(study_pitches_um(study, technology).max())
        dot_edges_um(camera.die_um, largest_um, study.display, study.border_um)
    return Prepared(study, scene, camera, view, variant)


def render_for(
    study: Study, variant: str | None = None, progress: Progress | None = None, settled: Settled | None = None, words: str = ""
) -> Light:
    """Return the study's irradiance, the camera that it was rendered with, and the error of its film.

    Its noise is adequate for the largest pixel that the study allows, the least noisy one, and its film for the smallest
    photodiode. Neither depends on the pitches that are added, so a row does not depend on the others.

    words : of the case, for an error
    """
    scene, camera = scene_for(study, variant)
    first = study.technologies[0]
    largest, tried = physics_of(study, first, largest_pixel_um(study, first)), measured_pixels(study, camera)
    coloured = study.options_of(first).colour is not None
    scene, plan = first_film(study, scene, camera)
    for note in plan.warnings:
        warn(note)
    plan_of = partial(study_plan, camera=camera, study=study)
    pitches_um = study_pitches_um(study, first).tolist() if coloured else []
    larger = [imaging_of(study, camera, first, pitch_um) for pitch_um in pitches_um]
    try:
        made = render_and_measure(
            scene, plan, study, largest, tried, plan_of=plan_of, settled=settled, progress=progress, larger=larger
        )
    except AlikeChannelsError as error:
        where = ", ".join(filter(None, (label_of(first), words)))
        raise AlikeChannelsError(f"{where}: none of its pixel sizes is possible. {error}") from None
    made.image.header.update(white_header(seen_by_all(study, made.image, camera), study.display))
    return made.image, camera, made.film


def seen_by_all(study: Study, image: SpectralImage, camera: Camera) -> list[Seen]:
    """Return a picture as the smallest pixels of each technology of a study see it, for the white that all of them share."""
    smallest = [physics_of(study, name, float(study_pitches_um(study, name).min())) for name in study.technologies]
    return [Seen(image, camera, physics, study.border_um) for physics in smallest]


def measured_pixels(study: Study, camera: Camera) -> list[Imaging]:
    """Return the pixels for which the error of the film is measured: the smallest, a middle and the largest of the study."""
    first = study.technologies[0]
    pitches_um = study_pitches_um(study, first)
    return [imaging_of(study, camera, first, float(pitches_um[place])) for place in (0, pitches_um.size // 2, -1)]


def render_all(
    cases: Sequence[Case],
    variant: str | None,
    stage: Stage,
    workers: Workers,
    settled: Settled | None = None,
    *,
    store: Callable[[SpectralImage], SpectralImage],
) -> list[Light | str]:
    """Return the light of each case; cases that differ in nothing that it depends on share one.

    In its place stands the reason why none of a case's pixel sizes is possible.
    Where Mitsuba traces no rays, which would take all processors by itself, the workers make them.

    store : returns an image that need not stay in memory, where there are several lights
    """
    keys = [light_hash(case.study) for case in cases]
    studies = {key: case.study for case, key in zip(cases, keys, strict=True)}
    words = {key: case.words for case, key in zip(reversed(cases), reversed(keys), strict=True)}
    lights: dict[str, Light | str] = {}
    if len(studies) == 1:
        lights = {key: _light_or_reason(study, variant, stage("render"), settled, words[key]) for key, study in studies.items()}
    elif first_film(cases[0].study, *scene_for(cases[0].study, variant))[1].exact:
        lights = _computed_lights(studies, words, variant, stage("render"), workers, store)
    else:
        for key, study in studies.items():
            progress = stage(f"render {len(lights) + 1} of {len(studies)}")
            lights[key] = _stored(_light_or_reason(study, variant, progress, words=words[key]), store)
    return [lights[key] for key in keys]


def _computed_lights(
    studies: Mapping[str, Study],
    words: Mapping[str, str],
    variant: str | None,
    progress: Progress,
    workers: Workers,
    store: Callable[[SpectralImage], SpectralImage],
) -> dict[str, Light | str]:
    """Return the lights of charts whose film cells are computed.

    Of the films that show the same, the clearest is measured; if it is surely fine enough, so are the others.
    """
    seen: dict[str, tuple[SpectralImage, Camera]] = {}
    sights: dict[str, Sight] = {}
    calls = [((*each, variant), _nothing) for each in studies.items()]
    for done, (key, found) in enumerate(results_of(_see_task, calls, workers), 1):
        if found is not None:
            image, camera, sights[key] = found
            seen[key] = store(image), camera
        progress(done / (2 * len(studies)))
    measured_in = {key: key for key in studies} | clearest(sights)
    lights: dict[str, Light | str] = {}
    left = [key for key in studies if measured_in[key] == key]
    while left:
        for key, light in results_of(_render_task, [((key, studies[key], variant, words[key]), _nothing) for key in left], workers):
            lights[key] = _stored(light, store)
            progress((len(studies) + len(lights)) / (2 * len(studies)))
        for key, of in measured_in.items():
            measured = lights[of]
            if key not in lights and not isinstance(measured, str) and measured[2].surely_met:
                lights[key] = *seen[key], measured[2].for_other_noise
        left = [key for key in studies if key not in lights]
    return lights


def _nothing() -> None:
    """Return what render tasks share."""


def _see_task(task: tuple[str, Study, str | None], _: None) -> tuple[str, tuple[SpectralImage, Camera, Sight] | None]:
    """Return the key of a task, and its light on the first film of `render_for`, with its camera and what pixels see of it.

    None in place of the light if it takes samples, or if the film may be too coarse.
    """
    key, study, variant = task
    scene, camera = scene_for(study, variant)
    scene, plan = first_film(study, scene, camera)
    if not plan.exact:
        return key, None
    image, _noise = render_until(scene, camera, plan, [], study.exposure, study.seed, render_noise=study.render_noise)
    image.header.update(white_header(seen_by_all(study, image, camera), study.display))
    sight = Sight.of(image, measured_pixels(study, camera), plan.chart)
    return key, (image, camera, sight) if sight else None


def _render_task(task: tuple[str, Study, str | None, str], _: None) -> tuple[str, Light | str]:
    """Return the key of a task, and its light or the reason why there is none."""
    key, study, variant, words = task
    return key, _light_or_reason(study, variant, words=words)


def _light_or_reason(study: Study, variant: str | None, *args: Any, **options: Any) -> Light | str:
    """Return `render_for`, or the reason why none of the study's pixel sizes is possible."""
    try:
        return render_for(study, variant, *args, **options)
    except AlikeChannelsError as error:
        return str(error)


def _stored(light: Light | str, store: Callable[[SpectralImage], SpectralImage]) -> Light | str:
    """Return a light whose image need not stay in memory; a reason as it is."""
    return light if isinstance(light, str) else (store(light[0]), *light[1:])


def evaluate_cases(
    cases: Sequence[Case],
    lights: Sequence[Light],
    view: View,
    results: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
) -> tuple[list[StudyResult | str], Counts]:
    """Evaluate missing rows of results.csv, add pitches and sensors until the target interval is met, and fit the optima.

    Returns the result of each case, or the reason why too few of its pixel sizes are possible, and how much was computed.
    """
    caches: dict[str, SceneCache] = {}
    lit: list[SceneCache] = []
    series: list[Series] = []
    members: list[range] = []  # of each case, the numbers of its series
    for case, (irradiance, camera, _) in zip(cases, lights, strict=True):
        # The header states everything that a render depends on, so that cases of other pixels may have equal ones.
        of_light = [irradiance.header, irradiance.shape, irradiance.pitch_um, camera.model_dump()]
        key = content_hash([*of_light, case.study.display.content_hash])
        scenes = caches.setdefault(key, scenes_of(case.study, irradiance, camera))
        scenes.channels = max(scenes.channels, most_channels(case.study))
        lit.append(scenes)
        of_case = series_of(case.study, scenes, case.columns, case.words)
        members.append(range(len(series), len(series) + len(of_case)))
        series += of_case
    under: dict[tuple[str, str], list[Series]] = {}  # of one scene and condition
    for case, numbers in zip(cases, members, strict=True):
        under.setdefault((case.study.scene.file, case.condition), []).extend(series[number] for number in numbers)
    for together in under.values():
        check_ideals(together)
    evaluations = Evaluations(series, results, workers, len(cases))
    case_of = [place for place, numbers in enumerate(members) for _ in numbers]
    samplings = [sizes for case in cases for sizes in first_sampling(case.study).values()]
    smallest_um = [min(sizes) for sizes in samplings]
    rows = [NO_ROWS for _ in series]
    curves: dict[int, Curve] = {}
    fitted: list[Sizes] = [{} for _ in series]  # of these curves
    left_out: list[dict[float, str]] = [{} for _ in series]
    impossible: dict[int, str] = {}
    rounds = any(case.study.target_ci_um is not None for case in cases)
    with evaluations.resumed(samplings):
        for group in evaluations.groups(members) if rounds else [range(len(cases))]:
            changed = set(group)
            while changed:
                # Cases that have met their target stay, so that their lights are not prepared again.
                wanted = [sizes if case_of[number] in changed else {} for number, sizes in enumerate(samplings)]
                missing = {number: len(members[number]) for number in changed}
                changed = set()
                with closing(evaluations.rows(wanted, progress())) as found_rows:
                    for number, rows[number] in found_rows:  # the workers go on while a curve is fitted
                        place = case_of[number]
                        missing[place] -= 1
                        left_out[number] |= evaluations.left_out(number, samplings[number])
                        try:
                            samplings[number] = evaluations.possible(number, samplings[number])
                            if fitted[number] != samplings[number]:
                                curves[number] = curve_of(cases[place].study, series[number].name, rows[number])
                            fitted[number] = samplings[number]
                        except TooFewSizesError as error:
                            impossible[number] = str(error)
                        if missing[place] or not impossible.keys().isdisjoint(members[place]):
                            continue
                        technologies = {series[own].name: own for own in members[place]}
                        more = next_round(
                            cases[place].study,
                            [curves[own] for own in technologies.values()],
                            {name: samplings[own] for name, own in technologies.items()},
                            len(cases) <= FEW_CASES,
                        )
                        for name, own in technologies.items():
                            if more[name] != samplings[own]:
                                changed.add(place)
                            samplings[own] = more[name]
            evaluations.end_group()
        evaluations.finish(rows)
    if all(each.stored for each in series):
        remember_evaluated([case.study for case in cases])
    found: list[StudyResult | str] = []
    left_of_cases = [{series[number].name: left_out[number] for number in numbers if left_out[number]} for numbers in members]
    reasons = [next((impossible[number] for number in numbers if number in impossible), "") for numbers in members]
    warn_of_left_out(cases, [{} if reason else left for left, reason in zip(left_of_cases, reasons, strict=True)])
    for case, numbers, reason, scenes, (irradiance, camera, film) in zip(cases, members, reasons, lit, lights, strict=True):
        if reason:
            found.append(reason)
            continue
        for number in numbers:
            warn_of_clipped_white(series[number], smallest_um[number])
        for number in numbers:
            warn_of_stacks(series[number], smallest_um[number])
        complete = tuple(
            replace(
                curves[number],
                at=case.at,
                condition=case.condition,
                alone=case.alone,
                left_out=tuple(left_out[number].items()),
                causes=causes_of_curve(series[number], curves[number], smallest_um[number]),
            )
            for number in numbers
        )
        found.append(StudyResult(case.study, complete, irradiance, camera, film=film, view=view.as_dict(), lights=scenes))
    return found, evaluations.counts


def warn_of_left_out(cases: Sequence[Case], left_out: Sequence[Mapping[str, Mapping[float, str]]]) -> None:
    """Warn of the pixel sizes that a study leaves out of each of its cases."""
    notes = []
    for case, own in zip(cases, left_out, strict=True):
        for name, sizes in own.items():
            which = ", ".join(filter(None, (label_of(name), case.words)))
            listed = ", ".join(f"{pitch_um:g}" for pitch_um in sorted(sizes))
            notes.append(f"{which}: {listed} µm left out: {sizes[max(sizes)]}")
    for note in few([notes]):
        warn(note)


def warn_of_idle_axes(study: Study, found: Sequence[StudyResult]) -> None:
    """Warn of each axis whose values all give the same mean ΔE, bit for bit: something else decides on its setting.

    All cases have the same random numbers, so that equal settings give equal numbers.
    """
    curves = [curve for result in found for curve in result.curves]
    for axis in study.axis:
        groups: dict[tuple[object, ...], list[bytes]] = {}
        for curve in curves:
            is_base = axis.alone and not curve.alone
            if curve.alone == (axis.name if axis.alone else "") or is_base:
                others = () if axis.alone else [(name, value) for name, value in curve.at.items() if name != axis.name]
                content = curve.pitch_um.tobytes() + curve.delta_e.tobytes()
                groups.setdefault((curve.technology, curve.condition, *others), []).append(content)
        if any(len(group) > 1 for group in groups.values()) and all(len(set(group)) == 1 for group in groups.values()):
            settings = ", ".join(dict.fromkeys(".".join(path) for path in axis.paths))
            why = f"its values are the study's own, or other settings or a data sheet decide in place of {settings}"
            warn(f"the axis {axis.name} changes nothing: {why}")


@checks_arguments
def study(
    plan: Study | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    scene: str | os.PathLike[str] | None = None,
    quick: bool = False,
    jobs: int | None = None,
    scheduler: Any = None,
    variant: str | None = None,
    progress: Stage | None = None,
    agreed: bool = False,
    uncertainty: int | None = None,
    sobol: int | None = None,
    smaller_than_um: Sequence[float] = (),
    **settings: Any,
) -> StudyResult:
    """Run a study, or resume an interrupted one, with its rows in `out`/results.csv.

    plan : a Study, the name of a packaged one, or a TOML file
    out : folder, created if missing
    config : one or more TOML files with a sensor, its camera, exposure and display for a named study; later ones take precedence
    parameters : of the scene, each in its unit; they override those of a named study
    pixel : fields of the pixels (`PixelOptions`), as {"response": "scaled"}, each in its unit; they override a named study's. A
        data sheet may stand here instead of in a file, with its pitch_um
    scene : XML file or name of a packaged scene, which overrides a named study's
    quick : use the values of the study's `quick` table
    jobs : processes; None means one per core. The results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers replace local processes;
        on the same kind of processor their results are bitwise equal
    variant : Mitsuba variant; None means the fastest that works
    progress : returns a callback for each named stage
    agreed : whether a study with axes or sensor types may take more than 100 000 evaluations
    uncertainty : number of sensor types to draw from the ranges of technologies and [pixel.uncertainty] of `config`, for the
        result's `uncertainty`; None means none
    sobol : in its place, number of points for total indices, which take sobol × (inputs + 2) sensor types
    smaller_than_um : sizes; the probability that the optimum is smaller is reported
    settings : other fields of `Study`, which override a named study's; tables as dicts: camera={"f_number": 2.8},
        pitch={"min_um": 2.0}, exposure={…}, display={…}, seed=3, window_mm=1.0, axis=[{"name": "lens", "set":
        "camera.f_number", "values": [2.0, 4.0]}], condition=[…]

    Raises PixsimError for invalid input, before anything is rendered, and if `out` holds a results.csv of another program.

    >>> import tempfile
    >>> tiny = {"name": "tiny", "repeats": 2, "pitch": {"values_um": [20, 28, 40, 56, 80]}, "display": {"dots": 64}}
    >>> tiny |= {"scene": {"file": "csf", "parameters": {"resolution": 64, "spp": 4}}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = study(Study.model_validate(tiny), folder, jobs=1)
    >>> result.curves[0].delta_e.shape, bool(result.curves[0].delta_e.mean(axis=1).argmin() == 0)  # (pitches, sensors)
    ((5, 2), True)
    """
    given = {"config": config, "parameters": parameters, "pixel": pixel, "scene": scene} | settings
    if isinstance(plan, Study) and (names := [name for name, value in given.items() if value]):
        hint = "Set these values in the Study instead."
        raise invalid(", ".join(names), "with a Study", "the name or the file of a study", hint)
    with collected_notes():  # also of what is found before the study begins
        chosen = plan if isinstance(plan, Study) else load_study(plan, config, parameters, pixel, scene, **settings)
        files = [config] if isinstance(config, str | os.PathLike) else config
        spreads = uncertainty_of(plan, files) if isinstance(plan, str | os.PathLike) else {}
        from pixsim.studies.sensor_types import asked_of

        asked = asked_of(uncertainty, sobol, smaller_than_um, spreads)
        prepared = replace(prepare(chosen, variant, quick=quick), uncertainty=spreads)
        return run_prepared(prepared, out, jobs=jobs, scheduler=scheduler, progress=progress, agreed=agreed, asked=asked)


def run_prepared(
    prepared: Prepared,
    out: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: Any = None,
    progress: Stage | None = None,
    agreed: bool = False,
    asked: Asked | None = None,
) -> StudyResult:
    """Run a prepared study; the other arguments are those of `study`.

    asked : about its unknown numbers
    """
    from pixsim.scene.convergence import RenderNoise

    check_number(len(prepared.cases), prepared.evaluations, agreed)
    if asked is not None:
        from pixsim.studies.sensor_types import check_types

        check_types(prepared.study, [case.study for case, _ in prepared.parts], asked, agreed)

    chosen, variant = prepared.study, prepared.variant
    stage = progress or (lambda _: lambda *_: None)
    settled: Settled | None = None
    if jobs is None and scheduler is None:
        jobs = jobs_in_memory(max(largest_frame_bytes(case.study, part.camera) for case, part in prepared.parts))
    with collected_notes() as notes, ExitStack() as stack:
        ResultsFile(Path(out) / "results.csv").check_replaceable()
        workers, folder = stack.enter_context(workers_for(jobs, scheduler)), stack.enter_context(output_folder(out))
        if chosen.tolerance_delta_e and not prepared.cases:
            stage("calibrate")
            from pixsim.studies.budget import settled_study

            chosen, settled = settled_study(chosen, prepared.scene, prepared.camera)
            prepared = replace(prepared, study=chosen)
        lights = render_all(
            [case for case, _ in prepared.parts], variant, stage, workers, settled, store=PictureFile(folder).stored
        )
        reasons = [light for light in lights if isinstance(light, str)]
        lit = [(case, light) for (case, _), light in zip(prepared.parts, lights, strict=True) if not isinstance(light, str)]
        found: list[StudyResult] = []
        if lit:
            cases = [replace(case, study=case.study.model_copy(update={"resolution": light[0].shape[1]})) for case, light in lit]
            of_cases = cases, [light for _, light in lit], prepared.view, folder / "results.csv", workers
            made, counts = evaluate_cases(*of_cases, lambda: stage("evaluate"))
            reasons += [each for each in made if isinstance(each, str)]
            found = [each for each in made if isinstance(each, StudyResult)]
        if not found:
            raise PixsimError(reasons[0])
        for note in few([[f"a case is left out: {reason}" for reason in reasons]]):
            warn(note)
        warn_of_idle_axes(chosen, found)
        curves = found[0].curves
        if not prepared.cases and chosen.own_um is not None and chosen.display.raster == "fixed_size":
            curves = curves_viewed(found[0], prepared.view, workers, stage("on other displays"))
        findings: tuple[tuple[Any, ...], ...] = ()
        if prepared.cases and chosen.paper:
            from pixsim.studies.claims import findings_of_cases

            findings = findings_of_cases(found, workers, stage("paper's statements"))
    first, budget = found[0], None
    irradiance = first.irradiance
    settings_toml = repeated_settings(prepared, chosen if prepared.cases else first.study, irradiance, asked)
    if settled is not None:
        noise, sensors = RenderNoise(**irradiance.header["render_noise"]), int(first.curves[0].sensors.min())
        budget = settled.budget(noise, irradiance.header["bound_e"], sensors)
    final = replace(first, warned=tuple(notes), curves=curves, settings_toml=settings_toml, budget=budget)
    if prepared.cases:
        names = dict.fromkeys(curve.technology for part in found for curve in part.curves)
        final = CasesResult(
            chosen,
            tuple(curve for name in names for part in found for curve in part.curves if curve.technology == name),
            irradiance,
            first.camera,
            film=first.film,
            view=first.view,
            settings_toml=settings_toml,
            warned=tuple(notes),
            lights=first.lights,
            parts=tuple(found),
            counts=counts,
            left_out=tuple(reasons),
            findings=findings,
        )
    if asked is None:
        return final
    from pixsim.studies.sensor_types import draw_types

    with collected_notes(), workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        unknown = draw_types(final, asked, folder, workers, lambda: stage("sensor types"))
    return replace(final, uncertainty=tuple(unknown))
