"""A comparison of sensors: its document, and its output files: all of them, or none."""

from __future__ import annotations

import os
import shlex
from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, replace
from functools import reduce
from itertools import product
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.digits import difference_cells, exposure_time, rounded
from pixsim.base.files import KNEES_SUFFIX, check_replaceable
from pixsim.base.machine import processors
from pixsim.base.schema import result_data
from pixsim.base.tables import columns_of
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.run import colour_rows
from pixsim.report.score import judged_by_delta_e
from pixsim.report.settings import (
    DEFAULTS,
    Row,
    scene_rows,
    settings_blocks,
    settings_table,
    settings_tables,
)
from pixsim.report.uncertainty import pair_words
from pixsim.report.verdicts import (
    better_cases_words,
    common_words,
    doubts,
    draw_differences,
    mean_words,
    notes,
    pair_cells,
    requested_metrics,
    sensor_words,
    shared_stages,
    verdict_parts,
)
from pixsim.report.wording import DELTA_E, part_words
from pixsim.scene.convergence import Pilot
from pixsim.scene.guard.dictionary import stated_file
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.raw import write_frame
from pixsim.show.document import (
    Answer,
    Block,
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Listed,
    Pictures,
    Plot,
    Section,
    Slider,
    Strong,
    Text,
    headline,
)
from pixsim.show.figures import literal, new_figure
from pixsim.show.pages import Drawing, figure, figure_files
from pixsim.show.pictures import (
    Picture,
    delta_e_png,
    display_codes,
    factor_for,
    light_png,
    reduced,
    scale,
    scale_end,
    window_at,
    worst_window,
)
from pixsim.show.presenter import Presenter
from pixsim.show.render import PAGE
from pixsim.show.sentences import setting_value
from pixsim.studies.comparison import ComparedSensor, Comparison, DisplayDifference
from pixsim.studies.design import BASE, Case, frame_cost
from pixsim.studies.dry_run import PAGE_S, START_S, Cost, pilot_of, render_bytes, render_seconds
from pixsim.studies.files import scene_copy, scene_table, settings_text, stated_settings
from pixsim.studies.paired import Pairs, mean_interval
from pixsim.studies.run import check_raw
from pixsim.studies.sensors import SENSOR_TABLES, ComparisonJob, SensorGroup, pixels_of
from pixsim.studies.settings import Condition, paths_of
from pixsim.studies.table import ROWS_FILE
from pixsim.studies.uncertainty import FEW_SENSORS
from pixsim.viewer.display import white_light
from pixsim.viewer.metrics import DELTA_E as DELTA_E_METRIC, Metric
from pixsim.viewer.screen import LightLevel
from pixsim.viewer.setting import Run, stage_words
from pixsim.viewer.settings_file import scene_options

_JSON_FILE = "compare.json"
_SCORES = "scores"
_FIGURE_WIDTH_IN = 6.0
_FIGURE_BORDER_IN = 0.8
ROW_IN = 0.4


def _cost_of(job: ComparisonJob) -> Cost:
    """Estimate the renders and frames of all sensors."""
    repeats = job.repeats + (
        0 if job.types is None else FEW_SENSORS * len(job.types.sample.quantiles)
    )
    seconds = START_S + PAGE_S
    largest_bytes = 0.0
    cores = processors().usable
    pilot: Pilot | None = None
    for group in job.groups:
        for case in group.cases:
            request = group.request(case, group.film_width)
            pilot = pilot or pilot_of(case, request)
            frame = frame_cost(
                case.camera, case.settings.pixel.pitch_um, group.display, *case.further_displays
            )
            seconds += (
                render_seconds(
                    request.plan,
                    request.shape,
                    cores,
                    pilot,
                    frame.seconds,
                    case.settings.max_seconds,
                )
                + repeats * frame.seconds / cores
            )
            largest_bytes = max(
                largest_bytes, render_bytes(request.plan, request.shape) + frame.memory_bytes
            )
    sensors = sum(len(group.cases) for group in job.groups)
    return Cost(sensors, repeats * sensors, seconds, largest_bytes, 1)


def _case_data(case: Case[Run]) -> dict[str, Any]:
    """Return the camera and the pixels of a sensor, as in compare.json."""
    return {
        "camera": case.camera.model_dump(),
        "fov_deg": case.camera.fov_deg,
        "pixels": list(pixels_of(case)),
        "pixel": case.settings.pixel.model_dump(),
    }


def comparison_outline_document(job: ComparisonJob, out: Path) -> Document:
    """Return the answer of a dry run, with an estimate of time and memory; nothing is written.

    out : folder that would be written
    """
    group = job.shown
    first = job.shown.first
    scene = first.scene.with_resolution(group.film_width)
    height, across = scene.film_shape(first.camera, scene.for_camera(first.camera))
    types = None if job.types is None else job.types.sample
    cost = _cost_of(job)
    data = {
        "scene": group.scene,
        "match": job.match,
        "repeats": job.repeats,
        **group.as_dict(),
        "film": {"samples": [height, across]},
        "display": group.display.model_dump(),
        "sensors": {case.sensor: _case_data(case) for case in group.cases},
        "cases": [{"at": case.at} for case in job.combinations],
        "sensor_types": 0 if types is None else len(types.quantiles),
        "estimate": asdict(cost),
    }

    facts = ["; ".join(common_words(job)), f"film of {across} × {height} samples for all"]
    facts += [f"case {case.words}" for case in job.combinations if case.words]
    if types is not None:
        facts.append(f"{len(types.quantiles)} sensor types, over {', '.join(types.inputs)}")
    facts += [f"{out}: nothing is written now", f"cost: {cost}"]

    rows = [(case.sensor, sensor_words(case)) for case in group.cases]
    sensors = DocumentTable("sensors", (), rows, words=None)
    return Document("compare", "dry run", group.scene, data, lead=(sensors, *map(Fact, facts)))


# --- files


def comparison_files(job: ComparisonJob, raw_suffixes: Sequence[str] = ()) -> set[str]:
    """Return the names of all files of a comparison but the list of them.

    raw_suffixes : of the first raw frame of each sensor, where it is written
    """
    figures = [_SCORES, *[NAME] * job.shown.first.settings.noise_budget]
    names = {PAGE, _JSON_FILE, SETTINGS_FILE, *figure_files(figures)}
    for sensor in job.names:
        names |= {f"sensors/{sensor}.toml"} | {
            f"pictures/{picture}_{sensor}.png" for picture in ("image", "ideal", "delta_e")
        }
        beside = [KNEES_SUFFIX] * bool(raw_suffixes)
        names |= {f"raw/{sensor}{suffix}" for suffix in (*raw_suffixes, *beside)}
    return names


def check_output(
    job: ComparisonJob, folder: str | os.PathLike[str], raw_suffixes: Sequence[str]
) -> None:
    """Raise PixsimError if the folder holds a file of a comparison's name that pixsim did not
    write, or if a format holds too few bits for a raw frame.
    """
    for case in job.shown.cases:
        check_raw(case.settings, raw_suffixes)
    check_replaceable(folder, comparison_files(job, raw_suffixes))


def _settings_files(job: ComparisonJob) -> dict[str, str]:
    """Return settings.toml and a file for each sensor, as name -> text; their command makes the
    same numbers again.

    They state what was stated, and leave open what pixsim chose, such as a display: the command
    chooses the same again.
    """
    study = job.study if job.study is not None and job.study.has_cases else None
    files = [f"sensors/{name}.toml" for name in job.names]
    command = _repeating_command(job, files, has_study=study is not None)

    # Where dots and samples a degree are both stated, no other display is shown.
    first = job.base[0]
    chosen = {"dots", "samples_per_deg"} - first.display.model_fields_set
    display = first.display.model_dump(mode="json", exclude_none=True, exclude=chosen)
    scene = job.shown.first.scene
    parameters = scene_table(scene.path.parent, first.scene.parameters)
    tables: dict[str, Any] = {name: {} for name in SENSOR_TABLES}
    tables["display"] = display
    tables["scene"] = scene_options(job.file, parameters)
    if study:
        cases = study.model_dump(mode="json", include={"axis", "condition", "detail"})
        tables |= {name: value for name, value in cases.items() if value}
        tables["name"] = study.name
    texts = {SETTINGS_FILE: settings_text(first, command, **tables)}

    # The files of the sensors have their own tables only.
    shared: dict[str, Any] = {
        name: {} for name in type(first).model_fields if name not in SENSOR_TABLES
    }
    sensor_command = f"(in the folder above) {command}"
    spreads = [{}] * len(files) if job.types is None else job.types.spreads
    for file, settings, spread in zip(files, job.base, spreads, strict=True):
        texts[file] = settings_text(settings, sensor_command, {"": spread}, **shared)
    return texts


def _repeating_command(job: ComparisonJob, files: Sequence[str], has_study: bool) -> str:
    """Return the command that makes the same numbers again, in the folder of the comparison.

    files : of the sensors
    has_study : whether settings.toml is a study with axes or conditions
    """
    words = ["pixsim", "compare", *files]
    words += ["--study" if has_study else "--config", SETTINGS_FILE]
    if len(job.matches) == 1:
        words += ["--match", job.match]
    words += ["--repeats", str(job.repeats)]
    if job.types is not None:
        option = "--sobol" if job.types.total else "--uncertainty"
        words += [option, str(job.types.requested_draws)]
    if job.sensor:
        words += ["--sensor", job.sensor]
    if job.variant:
        words += ["--variant", job.variant]
    return shlex.join(words)


# --- the page


def _shared_words(result: Comparison) -> list[str]:
    """Return what all sensors have in common, with the light on the part of a target."""
    part = part_words(result.sensors[0].light.image.header)
    return [*common_words(result.job), *[part] * bool(part)]


def comparison_document(result: Comparison, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim compare`, without the sections of its page and other files.

    warned : notes that a reader of the terminal has seen
    """
    answers = [_answer(result, other) for other in result.names[1:]]
    common = Fact("; ".join(_shared_words(result)))
    new_notes = [note for note in notes(result) if note not in warned]
    return Document(
        command="compare",
        kind="comparison of sensors",
        title=" against ".join(result.names),
        data=data(result),
        answers=answers,
        lead=(Plot(lambda: _scores_plate(result)), *facts(result), common, *new_notes),
        about=(DELTA_E,) if judged_by_delta_e(result.job.base[0]) else (),
        data_file=_JSON_FILE,
    )


def comparison_page(result: Comparison, raw_suffixes: Sequence[str] = ()) -> Document:
    """Return the document of a comparison with its page and all other files.

    raw_suffixes : of the first raw frame of each sensor, to write it
    """

    def write_frames(folder: Path) -> None:
        if raw_suffixes:
            (folder / "raw").mkdir()
        for sensor in result.sensors:
            for suffix in raw_suffixes:
                write_frame(folder / f"raw/{sensor.name}{suffix}", sensor.score.frame)

    end = scale_end(max(sensor.score.statistics()["p99_delta_e"] for sensor in result.sensors))
    pictures = dict[str, bytes]()
    for sensor in result.sensors:
        score = sensor.score
        where = picture_axes(sensor.light.image, sensor.score.border_um)
        pictures[f"pictures/image_{sensor.name}.png"] = light_png(score.image)
        pictures[f"pictures/ideal_{sensor.name}.png"] = light_png(score.ideal)
        pictures[f"pictures/delta_e_{sensor.name}.png"] = delta_e_png(score.delta_e, where, end)
    return replace(
        comparison_document(result),
        lead=(_slider(result), *facts(result), *notes(result)),
        sections=_sections(result, end),
        writers=(write_frames,),
        files={**pictures, **_settings_files(result.job), **scene_copy(result.job.shown.scene)},
    )


def _comparison_csv(result: Comparison) -> str:
    """Return the evaluations of all sensors as CSV."""
    return result.table.to_csv()


def _answer(result: Comparison, other: str) -> Answer:
    """Return the answer for a later sensor by the first metric; with axes where which is better.

    The headline has the largest of what turns it or makes it unsure; what else does stands below.
    """
    metric = requested_metrics(result.job)[0]
    if len(result.cases) > 1:
        return Answer((Strong(better_cases_words(result, other)),), named=True)
    sentence, *warnings = verdict_parts(result, other, metric)
    warnings += doubts(result) if metric.is_delta_e else []
    answer = headline([(Strong(sentence),), *warnings[:1]])
    return Answer(answer.head, (*answer.below, *warnings[1:]), named=True)


def facts(result: Comparison) -> Iterator[Block]:
    """Yield a table of the sensors, the answers of cases and sensor types, and the answers by the
    other metrics.
    """
    first, *further = requested_metrics(result.job)
    yield _sensors_table(result, first)
    answers = [
        f"{case.case.words or BASE}: {'; '.join(verdict_parts(case, other, first))}"
        for case in result.cases
        for other in result.names[1:]
        if len(result.cases) > 1
    ]
    metric_names = {metric.name for metric in (first, *further)}
    answers += [
        pair_words(distribution)
        for distribution in result.uncertainty
        if distribution.metric.name in metric_names
    ]
    answers += [
        "; ".join(verdict_parts(result, other, metric))
        for metric in further
        for other in result.names[1:]
    ]
    if answers:
        yield Listed(answers)


def _sensors_table(result: Comparison, metric: Metric) -> DocumentTable:
    """Return a row for each sensor: its mean, its pixels, lens and exposure, and numbers of its
    first frame.
    """
    condition = result.shown.first.condition
    shared = shared_stages(result.shown)
    unit = metric.unit and f" ({metric.unit})"
    mean = "mean ΔE" if metric.is_delta_e else f"{metric.words}{unit}"
    numbers = ("mean electrons", "full well", "saturated (%)")
    rows = []
    for sensor in result.sensors:
        statistics = sensor.score.statistics()
        stages = [stage for stage in stage_words(sensor.case.settings) if stage not in shared]
        exposure = ", ".join([exposure_time(statistics["integration_s"]), *stages])
        electrons = (rounded(statistics[name], 3) for name in ("mean_electrons_e", "full_well_e"))
        saturated = rounded(100 * statistics["saturated_fraction"], 2)
        rows.append(
            (
                sensor.name,
                mean_words(result, sensor.name, metric),
                sensor_words(sensor.case),
                exposure,
                *electrons,
                saturated,
            )
        )
    head = (
        "sensor",
        mean,
        "pixels and lens",
        f"exposure{condition and f' in {condition}'}",
        *numbers,
    )
    return DocumentTable("sensors", head, rows, words=(2,), stacks=True, wide=len(numbers))


@figure(
    _SCORES,
    "Difference of the first metric of each later sensor from that of the first one, with its 95 %"
    " interval, at each value of the axes. The film's error is not in it. The table has each"
    " frame.",
)
def _scores_plate(result: Comparison) -> Drawing:
    """Draw the differences of the later sensors from the first one by the first metric.

    Its table has the number of each frame, under conditions their weighted mean.
    """
    metric = requested_metrics(result.job)[0]
    frames: list[dict[str, Any]] = []
    pairs: dict[str, Pairs] = {}
    for case in result.cases:
        for name in result.names:
            for repeat, value in enumerate(case.frames(name, metric).tolist()):
                frames.append(
                    {
                        "case": case.case.words,
                        "sensor": name,
                        "repeat": repeat,
                        metric.columns[0]: value,
                    }
                )
        for other in result.names[1:]:
            pairs[", ".join(filter(None, (case.case.words, other)))] = case.pairs(other, metric)

    drawing = new_figure(_FIGURE_WIDTH_IN, _FIGURE_BORDER_IN + ROW_IN * len(pairs))
    axes = drawing.add_subplot()
    draw_differences(axes, list(pairs.values()), list(pairs))
    label = "mean ΔE" if metric.is_delta_e else metric.title
    axes.set_xlabel(literal(f"{label} above that of {result.names[0]}"))
    return drawing, columns_of(frames)


# --- numbers for programs


def numbers(result: Comparison) -> dict[str, Any]:
    """Return the numbers that answer the question, as in compare.json."""
    first, *others = result.names
    displays = {
        other: [
            _display_data(difference, (first, other))
            for difference in result.display_differences(other)
        ]
        for other in others
    }
    matches = {
        match: {other: result.pairs(other, match=match).difference for other in others}
        for match in result.job.matches
    }
    metric = requested_metrics(result.job)[0]
    verdicts = {other: "; ".join(verdict_parts(result, other, metric)) for other in others}
    return _differences_data(result) | {
        "displays": displays,
        "matches": matches,
        "verdicts": verdicts,
    }


def _differences_data(result: Comparison, condition: str | None = None) -> dict[str, Any]:
    """Return the mean ΔE of the sensors and their differences, in the mean or under a condition, as
    in compare.json.
    """
    pairs = {other: result.pairs(other, condition=condition) for other in result.names[1:]}
    return {
        "scores": {
            name: list(mean_interval(result.frames(name, condition=condition)))
            for name in result.names
        },
        "difference": {other: pair.difference for other, pair in pairs.items()},
        "interval_delta_e": {other: list(pair.interval) for other, pair in pairs.items()},
        "probability_a_better": {other: pair.probability_a_better for other, pair in pairs.items()},
        "film_delta_e": {other: result.film_of_pair(other, condition=condition) for other in pairs},
    }


def data(result: Comparison) -> dict[str, Any]:
    """Return compare.json.

    With conditions the answers are by the weighted mean, and all else is of the condition whose
    pictures are shown.
    """
    job = result.job
    group = result.shown
    content: dict[str, Any] = {
        "names": list(result.names),
        "match": job.match,
        "repeats": job.repeats,
        "scene": stated_file(group.scene),
    }
    if job.study is not None:
        content["study"] = {"name": job.study.name}

    sensor_settings = [stated_settings(run) for run in job.base]
    shared: dict[str, Any] = {
        "settings": {"sensors": dict(zip(result.names, sensor_settings, strict=True))},
        "notes": notes(result),
        "cases": [{"at": case.case.at} | numbers(case) for case in result.cases],
        "table": ROWS_FILE,
    }
    if len(result.cases) > 1:
        verdicts = {other: better_cases_words(result, other) for other in result.names[1:]}
        return result_data(content | {"verdicts": verdicts}, **shared)

    sensors = {}
    for sensor in result.sensors:
        delta_e = result.delta_e[sensor.name].tolist()
        sensors[sensor.name] = _sensor_data(sensor) | {"delta_e": delta_e}
    content |= {
        **_further_data(result),
        **numbers(result),
        **group.as_dict(),
        "scored_dots": list(result.sensors[0].score.delta_e.shape),
        "display": group.display.model_dump(),
        "seed": group.first.settings.seed,
        "sensors": sensors,
    }
    return result_data(content, **shared)


def _further_data(result: Comparison) -> dict[str, Any]:
    """Return the entries of compare.json for conditions, pairs of more than two sensors, further
    metrics and sensor types, where a comparison has them.
    """
    entries: dict[str, Any] = {}
    conditions = [group for group in result.groups() if group.first.condition]
    if conditions:
        entries["shown_condition"] = result.shown.first.condition
        entries["conditions"] = {
            group.first.condition: _condition_data(result, group) for group in conditions
        }
    if len(result.names) > 2:
        entries["pairs"] = {other: _pair_data(result, other) for other in result.names[1:]}
    if result.further_metrics:
        entries["metrics"] = {
            metric.name: _metric_data(result, metric) for metric in result.further_metrics
        }
    if result.uncertainty:
        entries["uncertainty"] = _uncertainty_data(result)
    return entries


def _uncertainty_data(result: Comparison) -> dict[str, Any]:
    """Return the distributions over sensor types of each pair: by ΔE, and in it by other
    metrics.
    """
    by_delta_e = [pair for pair in result.uncertainty if pair.metric.is_delta_e]
    entries = {pair.names[1]: pair.as_dict() for pair in by_delta_e}
    for pair in result.uncertainty:
        if not pair.metric.is_delta_e:
            metrics = entries[pair.names[1]].setdefault("metrics", {})
            metrics[pair.metric.name] = pair.as_dict()
    return entries


def _condition_data(result: Comparison, group: SensorGroup) -> dict[str, Any]:
    """Return the entry of a condition in compare.json: its weight, frames and differences."""
    condition = group.first.condition
    delta_e = {name: result.frames(name, condition=condition).tolist() for name in result.names}
    return {"weight": group.weight, "delta_e": delta_e, **_differences_data(result, condition)}


def _pair_data(result: Comparison, other: str) -> dict[str, Any]:
    """Return the entry of a pair in compare.json: the means of the first sensor and another
    one, and what only these two share.
    """
    pairs = result.pairs(other)
    scores = {result.names[0]: list(mean_interval(pairs.a)), other: list(mean_interval(pairs.b))}
    group = next(group for group in result.groups_of_pair(other) if group.weight)
    return {"scores": scores, **group.as_dict()}


def _metric_data(result: Comparison, metric: Metric) -> dict[str, Any]:
    """Return the entry of a further metric in compare.json, from the frames of all sensors on one
    display.
    """
    first, *others = result.names
    frames = {name: result.frames(name, metric) for name in result.names}
    return {
        "scores": {name: list(mean_interval(values)) for name, values in frames.items()},
        "probability_a_better": {
            other: Pairs((first, other), frames[first], frames[other], metric).probability_a_better
            for other in others
        },
    }


def _sensor_data(sensor: ComparedSensor) -> dict[str, Any]:
    """Return the entry of a sensor in compare.json; `statistics` are of its first frame, as in
    score.json.
    """
    case = sensor.case
    settings = sensor.case.settings
    score = sensor.score
    light = sensor.light
    return {
        **_case_data(case),
        "file": case.file,
        "statistics": score.statistics(),
        "assumption": settings.pixel.assumption,
        "exposure": settings.exposure.model_dump(),
        "border_um": list(score.border_um),
        "film": None if light.film is None else light.film.as_dict(),
        "render_noise": None if light.noise is None else asdict(light.noise),
        "dark": sensor.dark,
        "causes": [cause.as_dict() for cause in sensor.causes],
        **({} if sensor.colour is None else {"colour": sensor.colour}),
        **({} if sensor.budget is None else {"noise_budget": sensor.budget.as_dict()}),
        "white_spectrum": white_light(light.image)[1],
        "irradiance": light.image.header,
    }


def _display_data(display: DisplayDifference, names: tuple[str, str]) -> dict[str, Any]:
    """Return the entry of a display in compare.json. `better` is None where neither is surely
    better.
    """
    return asdict(display) | {
        "interval_delta_e": list(display.interval_delta_e),
        "better": {1: names[0], -1: names[1]}.get(display.sign),
    }


# --- sections of the page


_PAIRED = (
    "Intervals and probabilities are those of Student's t for {} pairs of frames, each of another"
    " pair of individual sensors."
)


def _slider(result: Comparison) -> Slider:
    """Return the slider with the picture of the first sensor on the left, and of another one, or
    the ideal image, on the right.
    """
    first, *others = [
        Picture(display_codes(reduced(sensor.score.image)), sensor.name)
        for sensor in result.sensors
    ]
    ideal = Picture(display_codes(reduced(result.sensors[0].score.ideal)), "ideal image")
    heading = f"Pictures in {result.shown.words}" if result.shown.words else ""
    return Slider(
        "slider",
        heading,
        first,
        (*others, ideal),
        f"the picture of {first.name}",
        "the chosen picture",
    )


def _sections(result: Comparison, scale_end_delta_e: float) -> Iterator[Section]:
    """Yield the sections of the page.

    scale_end_delta_e : of the colour scale of the ΔE maps
    """
    job = result.job
    sensors = result.sensors
    tables = [_differences(result, metric) for metric in requested_metrics(job)]
    yield Section(
        "differences",
        "Differences",
        [*tables, Plot(lambda: _scores_plate(result)), _PAIRED.format(job.repeats)],
    )
    if judged_by_delta_e(job.base[0]):
        yield _detail(result, scale_end_delta_e)
    colour_tables = [
        DocumentTable(
            f"colours of {sensor.name}",
            (),
            colour_rows(sensor.colour, sensor.score.out_of_gamut),
            sensor.name,
            words=None,
        )
        for sensor in sensors
        if sensor.colour
    ]
    yield Section("colour", "Colour", colour_tables, folded=True)
    yield budgets_section(
        {sensor.name: sensor.budget for sensor in sensors if sensor.budget is not None}
    )
    yield Section("shared", "What the sensors share", [Listed(_shared_words(result))])
    yield Section("settings", "Settings", _settings(result))


def _detail(result: Comparison, end: float) -> Section:
    """Return the section with a detail of each sensor's picture: where the errors differ most, or
    as chosen in the settings.

    end : of the colour scale of the ΔE maps
    """
    study, (first, *others) = result.job.study, result.sensors
    rows, columns = first.score.delta_e.shape
    window = worst_window([np.abs(other.score.delta_e - first.score.delta_e) for other in others])
    title = "Where the errors differ most"
    if study is not None and study.detail:
        window = window_at(study.detail, (rows, columns))
        title = "The detail chosen in the settings"
    details = [
        Section(
            "",
            sensor.name,
            [
                Pictures(
                    (crops(sensor.score, window, f"the picture of {sensor.name}", end),),
                    title.lower(),
                )
            ],
        )
        for sensor in result.sensors
    ]
    sizes = size_words(factor_for(first.score.image), result.shown.display.samples_per_deg)
    return Section("detail", title, (*details, DeltaEScale(scale(end)), sizes), together=True)


def _differences(result: Comparison, metric: Metric) -> DocumentTable:
    """Return the differences of each pair by a metric: at values of axes, in the mean and in each
    condition.

    Those of ΔE are also by each match, and on each display.
    """
    first, *others = result.names
    rows: list[tuple[str, ...]] = []

    def add_row(
        where: Sequence[str], other: str, cells: tuple[str, ...], film_delta_e: float | None
    ) -> None:
        labels = (", ".join(filter(None, where)), f"{other} − {first}")
        film_cells = []
        if metric.is_delta_e:
            film_cells.append("unknown" if film_delta_e is None else rounded(film_delta_e, 2))
        rows.append((*labels, *cells, *film_cells))

    matches = result.job.matches if metric.is_delta_e else result.job.matches[:1]
    for case, other in product(result.cases, others):
        conditions = [group.first.condition for group in case.groups() if group.first.condition]
        mean = "weighted mean" if conditions else ""
        for match, condition in product(matches, (None, *conditions)):
            pairs = case.pairs(other, metric, match=match, condition=condition)
            film_delta_e: float | None = 0.0
            if metric.is_delta_e:
                film_delta_e = case.film_of_pair(other, match, condition)
            where = [case.case.words, condition or mean, f"match {match}"]
            add_row(where, other, pair_cells(pairs, film_delta_e), film_delta_e)

        for display in case.display_differences(other)[1:] if metric.is_delta_e else ():
            cells = difference_cells(
                display.difference, display.interval_delta_e, display.film_delta_e or 0.0
            )
            where = [case.case.words, f"{display.dots} dots"]
            add_row(where, other, (*cells, ""), display.film_delta_e)

    head = (
        "case",
        "sensors",
        "mean",
        "95 % interval",
        f"probability that {first} is better",
        *(["film's error, at most"] if metric.is_delta_e else []),
    )
    name = "mean ΔE" if metric.is_delta_e else metric.title
    caption = "" if requested_metrics(result.job) == (DELTA_E_METRIC,) else name
    return DocumentTable(f"differences of {name}", head, rows, caption, words=(1,), stacks=True)


def _settings(result: Comparison) -> list[Block]:
    """Return the settings of each sensor side by side, then the common settings, and the settings
    of each condition.
    """
    group = result.shown
    study = result.job.study
    is_coloured = any(case.settings.pixel.colour for case in group.cases)
    scene = _scene_rows(result)

    shared: list[DocumentTable] = []
    values: dict[str, dict[str, Text]] = {}  # setting -> sensor -> value
    changed: set[str] = set()
    for case in group.cases:
        pixel = case.settings.pixel
        from_data_sheet = pixel.technology == NO_TECHNOLOGY
        tables = settings_tables(
            scene, case.settings, case.camera, pixel, is_coloured, from_data_sheet
        )
        shared = shared or [table for table in tables if table.name not in SENSOR_TABLES]
        for table in tables:
            if table.name not in SENSOR_TABLES:
                continue
            for name, value, _, source in table.rows:
                setting = f"{table.name}.{name}"
                values.setdefault(setting, {})[case.sensor] = value
                if source not in DEFAULTS:
                    changed.add(setting)

    if study is not None:
        shared += [_condition_table(condition) for condition in study.condition]

    sensor_rows = [
        (setting, *(texts.get(sensor, "") for sensor in result.names))
        for setting, texts in values.items()
        if setting in changed
    ]
    differing = DocumentTable(
        "settings of the sensors", ("setting", *result.names), sensor_rows, words=None
    )
    return [differing, *settings_blocks(shared)]


def _scene_rows(result: Comparison) -> list[Row]:
    """Return the rows of the settings of the scene, with the seed."""
    group = result.shown
    light = result.sensors[0].light.image
    exposures_s = [sensor.score.frame.integration_s for sensor in result.sensors]
    level = LightLevel.of(light, group.display, exposures_s)
    rows = scene_rows(light, group.first.settings.scene.parameters, level)
    seed = group.first.settings.seed
    rows.append(("seed", seed, "of all random numbers", "set" if seed else "default"))
    return rows


def _condition_table(condition: Condition) -> DocumentTable:
    """Return the table of the settings that a condition sets."""
    rows = []
    for path in paths_of(condition.set):
        value = reduce(getitem, path, condition.set)
        rows.append((".".join(path), setting_value(value, path[-1]), "", "set"))
    return settings_table(f"condition {condition.name}", rows)


PRESENTER = Presenter(
    document=comparison_document,
    figure=_scores_plate,
    csv=_comparison_csv,
    page=lambda result, _: comparison_page(result),
)
