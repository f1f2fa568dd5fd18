"""Two results side by side: the differences of their metrics, and the settings that differ.

Each is read from the folder of a run, a study or a comparison, or is a run that is made from a
settings file. Frames of the same random streams are pairs, whatever differs in their light.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import read_text, version_of_files
from pixsim.base.layers import listed
from pixsim.base.progress import Progress, Stage, no_stage
from pixsim.base.result import Result
from pixsim.base.schema import KEY, check_not_newer, json_text
from pixsim.base.toml import SETTINGS_FILE, read_toml
from pixsim.base.version import VERSION
from pixsim.studies.files import tables_of_python
from pixsim.studies.paired import MIN_PAIRS, Difference, Pairs, Unpaired, mean_interval
from pixsim.studies.prepare import Job
from pixsim.studies.run import RunResult, prepare, run_prepared
from pixsim.studies.settings import has_study_settings, paths_of
from pixsim.studies.table import CHECK, COLUMNS, MAX_BYTES, ROWS_FILE, is_as_written
from pixsim.viewer.metric_registry import METRICS
from pixsim.viewer.metrics import PIXEL_STATISTICS, Metric, columns_of_metrics
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import FILES, run_settings, scene_options

Source: TypeAlias = RunResult | str | os.PathLike[str]
_MAKE_AGAIN = "Make it again, with its settings.toml."
RESULTS = {"score.json": "run", "summary.json": "study", "compare.json": "comparison"}
# Entries of a header of light that depend on the pixels.
_PIXEL_HEADER_KEYS = {"plan", "bound_e", "spare_e", "render_noise"}
_REPEATS = 8  # sensors of each run that is made, for the interval of its means
_DELTA_E_INTERVAL, METRIC_INTERVALS = "interval_delta_e", "metric_intervals"  # of score.json


@dataclass(frozen=True)
class StoredResult:
    """A result, from its files or from memory.

    name : of its folder, of its settings file, or of its scene
    kind : "run", "study" or "comparison"
    lights : header of each light, by the case or the sensor that sees it
    film_delta_e : largest error of a mean ΔE that the film may cause, of all lights; 0 of light
        that was given, NaN if unknown
    noise_delta_e : likewise, by the noise of the render; 0 if it was not measured
    streams : what its random streams begin with
    metric_names : of the metrics that were asked for; of a comparison all
    settings : all, by their dotted names; files by their whole paths
    intervals : 95 % interval of the mean of each metric of a run of several sensors, by its name
    rows : of results.csv, by the place of each: labels, size of a study's pixels, repeat, and dots
        where there are several
    path : of the folder; None without files
    run : the run itself, if it was not read from files
    """

    name: str
    kind: str
    lights: Mapping[str, Mapping[str, Any]] = field(repr=False)
    film_delta_e: float
    noise_delta_e: float
    streams: tuple[object, ...]
    metric_names: tuple[str, ...]
    settings: Mapping[str, Any] = field(repr=False)
    intervals: Mapping[str, tuple[float, float]] = field(repr=False)
    rows: Mapping[tuple[object, ...], Mapping[str, float]] = field(repr=False)
    path: Path | None = None
    run: RunResult | None = field(default=None, repr=False)

    @property
    def metrics(self) -> dict[str, Metric]:
        """The metrics that were asked for, by their names; of a comparison all that have columns.

        Metrics of the user's are not among them: it is not known whether less or more is better.
        """
        columns = next(iter(self.rows.values()))
        return {
            name: METRICS[name]
            for name in self.metric_names
            if name in METRICS and METRICS[name].columns[0] in columns
        }

    @property
    def by_place(self) -> dict[tuple[object, ...], dict[object, Mapping[str, float]]]:
        """The rows of each place by their repeats."""
        places: dict[tuple[object, ...], dict[object, Mapping[str, float]]] = {}
        for (*place, repeat), row in self.rows.items():
            places.setdefault(tuple(place), {})[repeat] = row
        return places

    def half_width(self, metric: Metric, values: Array) -> float:
        """Return half of the 95 % interval of a mean, NaN of a single frame.

        values : the metric's number in each frame, (frames,)
        """
        if metric.name in self.intervals:
            low, high = self.intervals[metric.name]
        elif values.size >= MIN_PAIRS:
            low, _, high = mean_interval(values)
        else:
            return math.nan
        return (high - low) / 2


# --- from a folder


def _read_folder(name: str, path: Path) -> StoredResult:
    """Return the result in a folder. Raises PixsimError for another folder, and for one of another
    version of pixsim.
    """
    files = [name for name in RESULTS if (path / name).is_file()]
    allowed = f"the folder of a run, a study or a comparison, with {ROWS_FILE}"
    if not files:
        got = f"'{path}' without {', '.join(RESULTS)}"
        raise invalid("results", got, f"{allowed}; or settings of a run with its scene")
    if (version := version_of_files(path)) != VERSION:
        if version:
            got = f"'{path}', from pixsim {version}"
        else:
            got = f"'{path}', from an unknown version of pixsim"
        raise invalid("results", got, f"results of pixsim {VERSION}", _MAKE_AGAIN)
    if not (path / ROWS_FILE).is_file():
        hint = (
            "Comparisons and studies write it to their --out folder, and so do runs since"
            " pixsim 2.0."
        )
        raise invalid("results", f"'{path}' without {ROWS_FILE}", allowed, hint)
    data_file = path / files[0]
    kind = RESULTS[files[0]]
    settings_file = path / SETTINGS_FILE
    stated = read_toml(settings_file) if settings_file.is_file() else {}
    try:
        rows = _rows_of(path / ROWS_FILE, kind)
        if not rows:
            raise invalid("results", f"'{path / ROWS_FILE}' without rows", allowed)
        content = json.loads(read_text(data_file, "results", "JSON", MAX_BYTES))
        check_not_newer(f"'{data_file}'", content.get("schema"))
        return _stored(name, kind, content, rows, stated, path=path)
    except PixsimError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise invalid(
            "results",
            f"'{data_file}', which is damaged",
            f"the file of a {kind} as pixsim wrote it",
            _MAKE_AGAIN,
        ) from None


def _stored(
    name: str,
    kind: str,
    content: Mapping[str, Any],
    rows: Mapping[tuple[object, ...], Mapping[str, float]],
    stated: Mapping[str, Any],
    **source: Any,
) -> StoredResult:
    """Return a result from the content of its JSON file.

    stated : tables of its settings.toml, whose paths begin in its folder
    source : its path, or the run
    """
    entries, streams = _light_entries_and_streams(content, kind)
    headers = {light: entry["irradiance"] for light, entry in entries.items()}
    noises = [(header.get("render_noise") or {}).get("delta_e") for header in headers.values()]
    settings = content["settings"]
    intervals = dict(content.get(METRIC_INTERVALS, {}))
    if _DELTA_E_INTERVAL in content and kind == "run":
        intervals["delta_e"] = content[_DELTA_E_INTERVAL]
    return StoredResult(
        name=name,
        kind=kind,
        lights=headers,
        film_delta_e=_largest_film_error(entries.values()),
        noise_delta_e=float(max(filter(None, noises), default=0.0)),
        streams=streams,
        metric_names=tuple(map(str, settings.get("metrics", METRICS))),
        settings=_with_whole_paths(
            _by_dotted_name(settings), _by_dotted_name(stated), source.get("path")
        ),
        intervals={
            name: (float(low), float(high))
            for name, (low, high) in intervals.items()
            if low is not None
        },
        rows=rows,
        **source,
    )


def _light_entries_and_streams(
    content: Mapping[str, Any], kind: str
) -> tuple[dict[str, Mapping[str, Any]], tuple[object, ...]]:
    """Return the entry of each light of a result, with the error of its film, by the light's name;
    and the beginning of the keys of its random streams.
    """
    if kind == "run":
        return {"": content}, ("evaluate", content["seed"])
    if kind == "comparison":
        return dict(content.get("sensors", {})), ("compare", content.get("seed"))
    study = content["study"]
    cases = {
        json.dumps([case["at"], case.get("condition")], sort_keys=True): case
        for case in content.get("cases", [])
        if "irradiance" in case
    }
    return cases or {"": content}, (study.get("streams") or study["name"], study.get("seed", 0))


def _largest_film_error(entries: Iterable[Mapping[str, Any]]) -> float:
    """Return the largest error of a mean ΔE by the film; 0 if no light was rendered, NaN if one is
    unknown.
    """
    errors = [film["delta_e"] for entry in entries if (film := entry.get("film"))]
    return math.nan if None in errors else float(max(errors, default=0.0))


def _by_dotted_name(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of nested tables by their dotted names."""
    values: dict[str, Any] = {}
    for path in paths_of(tables):
        value: Any = tables
        for name in path:
            value = value[name]
        if value != {}:
            values[".".join(path)] = value
    return values


def _with_whole_paths(
    settings: Mapping[str, Any], stated: Mapping[str, Any], folder: Path | None
) -> dict[str, Any]:
    """Return settings with the whole paths of the files that they name.

    stated : of settings.toml, whose paths begin at `folder`; None means the working directory
    """
    names = {".".join(path) for path in FILES} & settings.keys()
    paths: dict[str, str] = {}
    for name in names:
        text = stated.get(name, settings[name])
        if isinstance(text, str):
            path = (folder or Path()) / text
            paths[name] = os.path.realpath(path) if path.is_file() else text
    return {**settings, **paths}


def _rows_of(path: Path, kind: str) -> dict[tuple[object, ...], dict[str, float]]:
    """Return the numbers of the rows of results.csv by their places."""
    first_number = PIXEL_STATISTICS[0]
    rows: dict[tuple[object, ...], dict[str, float]] = {}
    header_line, *lines = read_text(
        path, "results", "the rows of a study", MAX_BYTES
    ).splitlines() or [""]
    reader = csv.DictReader([header_line, *lines])
    names = list(reader.fieldnames or ())
    if names[:3] != list(COLUMNS[:3]) or first_number not in names:
        raise invalid("results", f"'{path}'", "the rows of a study")
    if not all(is_as_written(line, header_line) for line in lines):
        raise invalid(
            "results",
            f"'{path}', with a row that changed after pixsim wrote it",
            "rows as pixsim wrote them",
            _MAKE_AGAIN,
        )

    labels = names[names.index("repeat") + 1 : names.index(first_number)]
    numbers = [name for name in names[names.index(first_number) :] if name not in (KEY, CHECK)]
    for row in reader:
        place: list[object] = [(name, row[name]) for name in labels]
        # The sensor of a run is what is compared; the sizes of a comparison are those of its
        # sensors.
        place += [] if kind == "run" else [("technology", row["technology"])]
        place += [("pitch_um", float(row["pitch_um"]))] if kind == "study" else []
        rows[*place, ("repeat", int(row["repeat"]))] = {
            name: float(row[name] or "nan") for name in numbers
        }
    return rows


# --- from memory


def _stored_run(name: str, run: RunResult) -> StoredResult:
    """Return a run that is in memory."""
    numbers = [*PIXEL_STATISTICS, *columns_of_metrics(run.table.metrics)]
    columns = run.table.columns
    rows: dict[tuple[object, ...], dict[str, float]] = {
        (("repeat", int(repeat)),): {name: float(columns[name][row]) for name in numbers}
        for row, repeat in enumerate(columns["repeat"])
    }
    content = json.loads(json_text(run.as_dict()))
    return _stored(name, "run", content, rows, {}, run=run)


# --- the comparison


@dataclass(frozen=True)
class PlacedDifference:
    """Difference of a metric at a place that two results have in common.

    place : labels, and size of a study's pixels
    """

    place: Mapping[str, Any]
    difference: Difference


@dataclass(frozen=True)
class ResultsComparison(Result):
    """Two results with their differences.

    a, b : the results
    differences : of each metric at each place that both have
    """

    a: StoredResult
    b: StoredResult
    differences: tuple[PlacedDifference, ...]

    @property
    def names(self) -> tuple[str, str]:
        """Names of both."""
        return self.a.name, self.b.name

    @property
    def only_in_one(self) -> int:
        """Number of rows that one of them has alone; of frames that are no pairs, of places."""
        first: Collection[object] = self.a.rows.keys()
        other: Collection[object] = self.b.rows.keys()
        if self.a.streams != self.b.streams:
            first, other = self.a.by_place.keys(), self.b.by_place.keys()
        return len(set(first) ^ set(other))

    @property
    def sees_one_light(self) -> bool:
        """Whether both have the same light, apart from what depends on their pixels."""
        return _light_texts(self.a) == _light_texts(self.b)

    @property
    def light_delta_e(self) -> float | None:
        """Largest error of a difference of mean ΔE by the light, or None if it is unknown.

        It is the sum of the film errors of both and, of different lights, of their render noise.
        """
        error = self.a.film_delta_e + self.b.film_delta_e
        if not self.sees_one_light:
            error += self.a.noise_delta_e + self.b.noise_delta_e
        return None if math.isnan(error) else error

    def light_error_of(self, metric: Metric) -> float | None:
        """Return the error of the light in the difference of a metric, None if it is unknown.

        metric : ΔE, or another, whose error by the light is not measured and taken as 0
        """
        return self.light_delta_e if metric.is_delta_e else 0.0

    @property
    def different_settings(self) -> dict[str, tuple[Any, Any]]:
        """The settings that differ, by their dotted names: the values of a and b, None where one
        does not state it.
        """
        names = sorted({*self.a.settings, *self.b.settings})
        pairs = {name: (self.a.settings.get(name), self.b.settings.get(name)) for name in names}
        return {name: pair for name, pair in pairs.items() if not _are_equal(*pair)}

    def __repr__(self) -> str:
        return (
            f"<ResultsComparison {' and '.join(self.names)}: {len(self.differences)} differences>"
        )


def _light_texts(result: StoredResult) -> dict[str, str]:
    """Return the header of each light as JSON, in which a NaN equals itself, without entries that
    depend on the pixels.
    """
    return {
        name: json.dumps(
            {key: value for key, value in header.items() if key not in _PIXEL_HEADER_KEYS},
            sort_keys=True,
        )
        for name, header in result.lights.items()
    }


def _are_equal(first: Any, second: Any) -> bool:
    """Return whether two values of a setting are equal; a parameter of a scene may be a number as
    text.
    """
    try:
        return float(first) == float(second)
    except (TypeError, ValueError, OverflowError):
        return bool(first == second)


def compare_results(
    a: RunResult | str | os.PathLike[str],
    b: RunResult | str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    repeats: Count | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    progress: Stage | None = None,
    **settings: object,
) -> ResultsComparison:
    """Compare two results, whatever differs between them: two runs, two studies or two comparisons.

    a, b : folders that pixsim wrote; runs in memory; or TOML files with the settings of a run and
        its scene, as settings.toml of a run, which are run
    config : further settings files for the runs of TOML files
    parameters : of the scenes of these runs, each in its unit
    repeats : sensors of each of these runs. None means 8
    sensor, variant : of these runs, as in `pixsim.run`
    progress : returns a callback for each named stage
    settings : other tables and fields of `Run` for these runs: exposure={…}, seed=3

    Frames of equal random streams are pairs. Of others, the difference of the means has the root
    of the sum of the squares of both intervals.

    Raises PixsimError for results of different kinds or of another version of pixsim, and for
    settings beside results that exist.
    """
    options = tables_of_python(settings)
    if table := scene_options(None, parameters):
        options["scene"] = table
    sources = named_sources(a, b)
    jobs = prepared_runs(
        sources, listed(config), options, repeats=repeats, sensor=sensor, variant=variant
    )
    return compared(sources, jobs, progress or no_stage)


def named_sources(a: Source, b: Source) -> dict[str, Source]:
    """Return two results by their names: of a folder, of a settings file, or of a scene; with as
    many of the folders above it as make a difference.

    Raises PixsimError for one result twice.
    """
    parts = _name_parts(a), _name_parts(b)
    for count in range(1, max(map(len, parts)) + 1):
        first, other = ("/".join(names[-count:]) for names in parts)
        if first != other:
            return {first: a, other: b}
    if isinstance(a, RunResult) and isinstance(b, RunResult):
        return {f"first {first}": a, f"second {other}": b}
    raise invalid("results", f"'{a}' twice", "two results")


def _name_parts(source: Source) -> tuple[str, ...]:
    if isinstance(source, RunResult):
        return (Path(source.prepared.file).stem,)
    path = Path(source).resolve()
    if path.name == SETTINGS_FILE:
        return path.parent.parts
    return path.with_suffix("").parts if path.suffix == ".toml" else path.parts


def are_results(names: Sequence[str]) -> bool:
    """Return whether two results are named: one of them by its folder, or both by settings files of
    runs with their scene.
    """
    paths = [Path(name) for name in names]
    is_any_folder = any(path.is_dir() for path in paths)
    return len(paths) == 2 and (is_any_folder or all(map(_is_run_file, paths)))


def _is_run_file(path: Path) -> bool:
    """Return whether a file has the settings of a run and its scene, as settings.toml of a run."""
    if path.suffix != ".toml" or not path.is_file():
        return False
    table = read_toml(path)
    scene = table.get("scene")
    return isinstance(scene, dict) and "file" in scene and not has_study_settings(table)


def prepared_runs(
    sources: Mapping[str, Source],
    config: Sequence[str | os.PathLike[str]],
    options: Mapping[str, Any],
    *,
    repeats: int | None,
    **prepare_options: Any,
) -> dict[str, Job[Run]]:
    """Return the prepared runs of the settings files among two results, by their names.

    config, options : settings files, and tables and fields of `Run`, over each of these files
    prepare_options : other keywords of `pixsim.studies.run.prepare`

    Raises PixsimError for invalid input, also for settings beside a result that exists.
    """
    files = {
        name: source
        for name, source in sources.items()
        if not isinstance(source, RunResult) and _is_run_file(Path(source))
    }
    stated = {"config": config, "repeats": repeats, **prepare_options, **options}
    names = [name for name, value in stated.items() if value]
    if names and len(files) < len(sources):
        allowed = "none beside a result that exists: it stays as it is"
        raise invalid("settings", ", ".join(names), allowed)
    return {
        name: prepare(
            run_settings([file, *config], options), repeats=repeats or _REPEATS, **prepare_options
        )
        for name, file in files.items()
    }


def compared(
    sources: Mapping[str, Source], jobs: Mapping[str, Job[Run]], progress: Stage
) -> ResultsComparison:
    """Return the comparison of two results, by their names.

    jobs : of `prepared_runs`, which are run
    """
    results = []
    for name, source in sources.items():
        if isinstance(source, RunResult):
            results.append(_stored_run(name, source))
        elif name in jobs:
            stage = partial(_stage_of_run, progress, name)
            results.append(_stored_run(name, run_prepared(jobs[name], progress=stage)))
        else:
            results.append(_read_folder(name, Path(source)))
    first, other = results
    if first.kind != other.kind:
        raise invalid(
            "results", f"a {first.kind} and a {other.kind}", "two results of the same kind"
        )
    differences = tuple(_differences(first, other))
    if not differences:
        allowed = "the same cases, sizes and sensors"
        raise invalid("results", "two results without a row in common", allowed)
    return ResultsComparison(first, other, differences)


def _stage_of_run(stage: Stage, name: str, words: str) -> Progress:
    """Return the callback of a stage of a run, which names the run."""
    return stage(f"{name}: {words}")


def _differences(first: StoredResult, other: StoredResult) -> Iterator[PlacedDifference]:
    """Yield the difference of each metric at each place that two results have in common."""
    names = first.name, other.name
    is_paired = first.streams == other.streams
    other_places = other.by_place
    for metric in (metric for name, metric in first.metrics.items() if name in other.metrics):
        for place, rows in first.by_place.items():
            other_rows = other_places.get(place, {})
            repeats = rows.keys() & other_rows.keys() if is_paired else rows.keys()
            a = _numbers(rows, metric, repeats)
            b = _numbers(other_rows, metric, repeats if is_paired else other_rows.keys())
            if not (a.size and b.size and np.isfinite(a).all() and np.isfinite(b).all()):
                continue
            difference: Difference = Pairs(names, a, b, metric)
            if not is_paired:
                halves = first.half_width(metric, a), other.half_width(metric, b)
                difference = Unpaired(names, a, b, metric, half_widths=halves)
            yield PlacedDifference(dict(place), difference)  # type: ignore[arg-type]


def _numbers(
    rows: Mapping[object, Mapping[str, float]], metric: Metric, repeats: Collection[object]
) -> Array:
    """Return the first number of a metric in some rows, in their order, (repeats,)."""
    column = metric.columns[0]
    return np.array([row[column] for repeat, row in rows.items() if repeat in repeats])
