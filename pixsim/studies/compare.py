"""Compare image sensors in one scene: mean ΔE of each, the differences from the first, and how sure these are.

All sensors see the same field, on one display, in the same light. The first sensor and each other one are compared as if no third
one were there, on the stated display and on two others (`pixsim.studies.displays`). Both frames of a pair have the random seeds of
its number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from pixsim.base.arguments import Count, Jobs, checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.files import output_folder
from pixsim.base.layers import listed, plain_tables
from pixsim.base.notes import collected_notes, warn, without_warnings
from pixsim.base.progress import Progress, Stage, no_stage
from pixsim.scene.plan import Plan
from pixsim.sensor.infrared import light_notes
from pixsim.sensor.pixel_options import BORDER_PIXELS
from pixsim.sensor.unit_slips import unit_slips
from pixsim.studies.averages import Averaged, Compared, Observed
from pixsim.studies.cases import Case, named
from pixsim.studies.comparison import Comparison
from pixsim.studies.comparison_cases import ComparedCases, folders_of, prepare_cases
from pixsim.studies.engine import Workers, workers_for
from pixsim.studies.evaluations import check_ideals, rows_of
from pixsim.studies.film_error import kept_steps
from pixsim.studies.lights import Light, rendered_light
from pixsim.studies.lineup import ComparisonJob, Lineup, prepare
from pixsim.studies.matched_cameras import Match
from pixsim.studies.pair_uncertainty import PairUncertainty, Types, series_of_types
from pixsim.studies.results_file import ResultsFile
from pixsim.studies.rows import Row
from pixsim.studies.sensor_types import TYPES_FILE, sample_of
from pixsim.studies.series import Series, metrics_of
from pixsim.studies.study_settings import Study
from pixsim.studies.uncertainty import FEW_SENSORS
from pixsim.viewer.chain import make_chain
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.develop_options import of_python
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_registry import names_of
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.scene_light import PreparedScene, SceneCache, SceneLight
from pixsim.viewer.score import Score
from pixsim.viewer.screen import warn_of_clipping, white_header
from pixsim.viewer.setting import Run


@checks_arguments
def compare(
    files: Sequence[str | os.PathLike[str]],
    scene: str | os.PathLike[str] | None = None,
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match = "view",
    repeats: Count = 8,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    jobs: Jobs | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    out: str | os.PathLike[str] | None = None,
    uncertainty: int | None = None,
    metrics: Sequence[str | Callable[[Score], float]] = (),
    **settings: object,
) -> Comparison | ComparedCases:
    """Compare two or more sensors in one scene, by the mean ΔE of their pictures on one display.

    files : of the sensors: TOML files with a table [pixel], such as data sheets; files of technologies, or names of packaged ones.
        The first is the reference
    scene : XML file or name of a packaged scene; None means that of the study, or csf
    study : a Study, the name of a packaged one, or a TOML file. Its scene, display, exposure and conditions hold for all sensors,
        and its lens for files that state none. Under conditions, the result is that of the weighted mean over them, and has
        `conditions`. With axes, it is a comparison at each of their values. Its pixels, technologies and pixel sizes are not used
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
    out : folder whose results.csv keeps the mean ΔE of each frame, so that an interrupted comparison goes on; with axes, a folder
        in it for each value. None keeps nothing
    uncertainty : sensor types to draw from the ranges of technologies and [pixel.uncertainty] of data sheets, for the result's
        `uncertainty`; rounded up to a power of two. None means none
    metrics : names of further metrics, or functions of a `Score`, each a number in its own unit; the verdict is that of ΔE
    settings : tables and fields of `Run` for all sensors: camera={"f_number": 2.8}, exposure={…}, display={…}, seed=3. They take
        precedence over the study, but not over its conditions

    Raises PixsimError for invalid input, before anything is rendered.

    >>> small = {"display": {"dots": 32}, "resolution": 64, "pixel": {"pitch_um": 60.0}}
    >>> result = compare(["0.35um", "4t-bsi"], repeats=2, jobs=1, camera={"die_mm": 2.7}, **small)
    >>> sorted(result.scores), result.difference["4t-bsi"] < 0  # a quieter pixel
    (['0.35um', '4t-bsi'], True)
    """
    if metrics:
        settings["metrics"] = names_of(metrics)
    options = plain_tables(of_python(settings))
    options |= {"scene": dict(parameters)} if parameters else {}
    with collected_notes():  # also of what is found before the comparison begins
        prepared_by = partial(
            prepare,
            files,
            scene,
            match=match,
            repeats=repeats,
            config=[Path(path) for path in listed(config)],
            options=options,
            sensor=sensor,
            variant=variant,
            uncertainty=uncertainty,
        )
        axes, cases, prepared = prepare_cases(study, prepared_by)
        folders = folders_of(out, cases)
        results = [
            run_prepared(each, jobs=jobs, scheduler=scheduler, progress=progress, out=folder)
            for each, folder in zip(prepared, folders, strict=True)
        ]
        return ComparedCases(axes, tuple(zip(cases, results, strict=True))) if cases else results[0]


def run_prepared(
    prepared: ComparisonJob,
    *,
    jobs: int | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    out: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Run a prepared comparison; the other arguments are those of `compare`."""
    stage = progress or no_stage
    with collected_notes() as notes, ExitStack() as stack:
        folder = None if out is None else stack.enter_context(output_folder(out))
        files = {name: None if folder is None else folder / name for name in ("results.csv", TYPES_FILE)}
        for file in filter(None, files.values()):
            ResultsFile(file).check_replaceable()
        if jobs is not None or scheduler is not None:
            workers: Workers | None = stack.enter_context(workers_for(jobs, scheduler))
        else:
            workers = None
        whole = [lit_lineup(lineup, stage, prepared.repeats) for lineup in prepared.lineups]
        pairs = [lit_pair(pair, whole, stage, prepared.repeats) for pair in prepared.pairs]
        lit = list(dict.fromkeys(each for parts in (whole, *pairs) for each in parts))
        observed = observed_in(lit, prepared.repeats, files["results.csv"], workers, stage("sense and score"))
        parts = weighted_parts(prepared.lineups, whole, observed)
        found_notes = _notes_of([part for _, part in parts])
        of_pairs = tuple(Averaged(weighted_parts(*pair, observed)) for pair in zip(prepared.pairs, pairs, strict=True))
        result = Comparison(parts, prepared, of_pairs)
        if prepared.types is not None:
            drawn = differences_of_types(prepared.types, result, pairs, files[TYPES_FILE], workers, stage("sensor types"))
            result = replace(result, uncertainty=tuple(drawn))
    return replace(result, notes=(*notes, *found_notes))


@dataclass(frozen=True, eq=False)
class Lit:
    """A lineup with the light of its sensors.

    lights, series : of each sensor, its light with the plan of its film, and what its frames depend on
    """

    lineup: Lineup
    lights: list[tuple[Light, Plan]]
    series: list[Series]


def weighted_parts(
    lineups: Sequence[Lineup], lit: Sequence[Lit], observed: Mapping[Lit, Observed]
) -> tuple[tuple[float, Observed], ...]:
    """Return the sensors of each lineup with its weight.

    lit : their light, perhaps among more sensors
    """
    found = []
    for lineup, each in zip(lineups, lit, strict=True):
        own = {sensor.name for sensor in lineup.cases}
        found.append((lineup.weight, Observed(lineup, tuple(one for one in observed[each].sensors if one.name in own))))
    return tuple(found)


def lit_lineup(lineup: Lineup, stage: Stage, repeats: int, pair: str = "") -> Lit:
    """Return a lineup with the light of its sensors.

    repeats : frames of each sensor
    pair : names of its sensors, if they are compared as if there were no others
    """

    def part(name: str) -> Progress:
        return stage(": ".join(filter(None, (pair, lineup.condition, name))))

    with named(f"condition {lineup.condition}" if lineup.condition else ""):
        lights = lights_on_one_film(lineup, part)
        sensors = zip(lineup.cases, lights, strict=True)
        series = [series_of_sensor(lineup, sensor, light, repeats, pair) for sensor, (light, _) in sensors]
        check_ideals(series)
    return Lit(lineup, lights, series)


def lit_pair(lineups: Sequence[Lineup], whole: Sequence[Lit], stage: Stage, repeats: int) -> list[Lit]:
    """Return two of the sensors alone under each condition, with their light: that of all of them, if it is the same."""
    found = []
    for lineup, of_all in zip(lineups, whole, strict=True):
        if lineup is of_all.lineup or is_alike(lineup, of_all):
            found.append(of_all)
            continue
        pair = " and ".join(sensor.name for sensor in lineup.cases)
        with without_warnings(), named(f"{pair} alone"):
            found.append(lit_lineup(lineup, stage, repeats, pair))
    return found


def is_alike(lineup: Lineup, of_all: Lit) -> bool:
    """Return whether the comparison of two sensors is the same among more: field, chart, film and displays."""
    among = of_all.lineup
    alike = ("border", "displays", "film_width")
    if any(getattr(lineup, name) != getattr(among, name) for name in alike):
        return False
    # Another sensor may have asked for a finer film.
    return all(sensor in among.cases for sensor in lineup.cases) and of_all.lights[0][0].image.shape[1] == among.film_width


def _notes_of(parts: Sequence[Observed]) -> tuple[str, ...]:
    """Return the notes of all conditions; those that not all have name theirs."""
    notes = [part.notes for part in parts]
    of_all = [note for note in notes[0] if all(note in own for own in notes)]
    named_notes = zip(parts, notes, strict=True)
    return *of_all, *(f"{part.lineup.condition}: {note}" for part, own in named_notes for note in own if note not in of_all)


def lights_on_one_film(lineup: Lineup, stage: Stage) -> list[tuple[Light, Plan]]:
    """Return the light of every sensor on one film, fine enough for all, with the plan of that film."""
    width = lineup.film_width
    while True:
        lights: list[tuple[Light, Plan]] = []
        for sensor in lineup.cases:
            with named(sensor.name):
                lights.append(rendered_light(lineup.demand(sensor, width), stage(f"render {sensor.name}")))
            if (across := lights[-1][0].image.shape[1]) > width:  # its film had to be finer: the others take that one too
                width = across
                break
        else:
            images = [light.image for light, _ in lights]
            display = lineup.settings.display
            seen = [
                (Imaging.of(each.settings, each.camera).changed(display=display, border_um=lineup.border_um(each.camera)), image)
                for each, image in zip(lineup.cases, images, strict=True)
            ]
            # Of a plate each light says what it holds: one that ends at 830 nm has less of an infrared lamp.
            of_all = {} if display.white else white_header(seen)
            for pair_seen in seen:
                pair_seen[1].header |= white_header([pair_seen]) if display.white else of_all
            return lights


def series_of_sensor(lineup: Lineup, sensor: Case[Run], light: Light, repeats: int, pair: str = "") -> Series:
    """Return the series of a sensor, which show and score the same part of the scene as those of the others.

    Its random streams do not name the sensor, so that equal sensors give equal frames.

    repeats, pair : of `lit_lineup`
    """
    with named(sensor.name):
        border_um, pixel = lineup.border_um(sensor.camera), sensor.settings.pixel
        asked = lineup.settings.model_copy(update={"metrics": tuple(dict.fromkeys((DELTA_E.name, *lineup.settings.metrics)))})
        first, *others = lineup.different_displays
        imaging = Imaging.of(sensor.settings, sensor.camera).changed(
            display=first, border_um=border_um, single=True, metrics=metrics_of(asked, repeats)
        )
        for note in unit_slips(pixel):
            warn(f"{sensor.name}: {note}")
        scenes = SceneCache(imaging, SceneLight(light.image, light.without), len(imaging.physics.channels), others)
        columns = {"pair": pair, "condition": lineup.condition}
        series = Series(sensor.name, imaging, scenes, ("compare", sensor.settings.seed), False, columns, lineup.condition, False)
        prepared = series.light()
        assert isinstance(prepared, PreparedScene)
        warn_of_clipping(prepared.beyond_white, light.image.header, imaging.display)
        for note in light_notes(imaging.physics, sensor.camera, light.image):
            warn(note)
        return series


def observed_of(lit: Lit, rows: Sequence[Sequence[Row]]) -> Observed:
    """Return what the frames of all sensors of a lineup show.

    rows : of each sensor
    """
    lineup, found = lit.lineup, []
    places = [lineup.different_displays.index(display) for display in lineup.displays]
    for sensor, (light, plan), series, own in zip(lineup.cases, lit.lights, lit.series, rows, strict=True):
        on_displays = {
            metric.name: numbers_in(own, metric.columns[0]).reshape(-1, len(series.displays)).T[places]
            for metric in series.imaging.metrics.chosen
        }
        chain = make_chain(series.imaging.registered(0), series.light())
        score = chain.simulate(*series.stream, 0)
        time_s = score.frame.integration_s
        with without_warnings():  # the result itself warns
            of_run = Imaging.of(sensor.settings, sensor.camera)
            steps = kept_steps(light.image, of_run, plan.chart, lineup.border_um(sensor.camera) / BORDER_PIXELS)
        compared = Compared(
            sensor,
            light.image,
            light.noise,
            light.film,
            score,
            on_displays.pop(DELTA_E.name),
            dark_clip(score.physics, time_s, chain.white_e_per_s * time_s),
            chain.white_e_per_s * time_s,
            steps,
            None if chain.rendition is None else chain.development.colour_facts(time_s),
            {name: values[0] for name, values in on_displays.items()},
        )
        found.append(compared)
    return Observed(lineup, tuple(found))


def observed_in(
    parts: Sequence[Lit], repeats: int, results: Path | None, workers: Workers | None, progress: Progress
) -> dict[Lit, Observed]:
    """Return what the frames of all sensors under all conditions show.

    results : the file of the rows, from which an interrupted comparison goes on; None for none
    workers : None takes as many processes as are worth it
    """
    rows = iter(rows_of([each for part in parts for each in part.series], repeats, results, workers, progress))
    return {part: observed_of(part, [next(rows) for _ in part.series]) for part in parts}


def numbers_in(rows: Sequence[Row], column: str) -> Array:
    """Return the numbers of a column of rows, (rows,)."""
    return np.array([float(row[column]) for row in rows])


def differences_of_types(
    types: Types, result: Comparison, pairs: Sequence[Sequence[Lit]], file: Path | None, workers: Workers | None, progress: Progress
) -> list[PairUncertainty]:
    """Evaluate the sensor types of both sensors of each pair under all conditions, and return the differences of each pair.

    Those of ΔE come first for each pair, then those of further metrics. Warns of pairs without an unknown number.

    result : with the sensors as they are
    pairs : the light of each pair
    file : as `results` of `observed_in`
    """
    uncertain: list[tuple[Averaged, Sequence[Lit]]] = []
    for pair, lineups in zip(result.pairs, pairs, strict=True):
        if sample_of(types.sample, *pair.names).inputs:
            uncertain.append((pair, lineups))
        else:
            warn(f"{' and '.join(pair.names)}: no number of these two is unknown, so that nothing is drawn for them")
    base_series = {
        (lineup, series.name): series
        for pair, lineups in uncertain
        for lineup in lineups
        for series in lineup.series
        if series.name in pair.names
    }
    drawn_series = [drawn for series in base_series.values() for drawn in series_of_types(series, types)]
    rows = rows_of(drawn_series, FEW_SENSORS, file, workers, progress)
    metrics = drawn_series[0].imaging.metrics.chosen

    values: dict[tuple[str, Lit, str], Array] = {}  # (types, frames) of a metric, of a sensor in a light
    for metric in metrics:
        table = np.array([numbers_in(series_rows, metric.columns[0]) for series_rows in rows])
        blocks = table.reshape(len(base_series), -1, FEW_SENSORS)
        values |= {(metric.name, *place): block for place, block in zip(base_series, blocks, strict=True)}

    uncertainties = []
    for (pair, lineups), metric in product(uncertain, metrics):
        first, other = pair.names
        change = np.zeros(len(types.sample.quantiles))
        scatter = np.zeros((change.size, FEW_SENSORS))
        for (weight, _), lineup in zip(pair.parts, lineups, strict=True):
            if weight:
                a, b = (values[metric.name, lineup, name] for name in pair.names)
                change += weight * (b.mean(axis=1) - a.mean(axis=1))
                scatter += weight * (b - a)

        frames = pair.delta_e if metric.is_delta_e else pair.judged[metric.name]
        differences = frames[other] - frames[first]
        as_is = float(differences[:FEW_SENSORS].mean())
        drawn_differences = float(differences.mean()) + (change - as_is)
        uncertainties.append(PairUncertainty((first, other), types, drawn_differences, scatter_variances(scatter), metric))
    return uncertainties


def scatter_variances(differences: Array) -> Array:
    """Return the variance of the mean of each type's frames that their common noise leaves, (types,).

    differences : (types, frames), in which all types have the same random numbers. What is left beside the means of types and of
        frames is the interaction of a two-way analysis of variance.
    """
    types, frames = differences.shape
    interaction = differences - differences.mean(axis=1, keepdims=True) - differences.mean(axis=0) + differences.mean()
    freedom = (frames - 1) * (types - 1) / types
    return np.asarray((interaction**2).sum(axis=1) / (freedom * frames))
