"""A comparison of sensors: its document, and its output files: all of them, or none."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import reduce
from itertools import product
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import difference_cells, exposure_time, probability, rounded
from pixsim.base.files import check_replaceable
from pixsim.base.machine import processors
from pixsim.base.notes import Note
from pixsim.base.records import Record
from pixsim.base.schema import result_data
from pixsim.base.toml import SETTINGS_FILE, settings_table_text, whole_path
from pixsim.light.curves import RESPONSES
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.run import colour_rows
from pixsim.report.settings import record_rows, scene_rows, settings_blocks, settings_table
from pixsim.report.uncertainty import largest_share_words, pair_words
from pixsim.report.verdicts import (
    asked_metrics,
    common_words,
    judged_by_delta_e,
    metric_mean,
    metric_verdict,
    metric_words,
    notes,
    over_cases,
    pairs_of_all,
    sensor_words,
    shared_stages,
    shown_mean,
    unconverged,
    verdict,
)
from pixsim.report.wording import DELTA_E
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.stages import stage_words
from pixsim.show.document import (
    Answer,
    Block,
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Link,
    Listed,
    Map,
    Pictures,
    Plot,
    Section,
    Slider,
    Strong,
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
from pixsim.show.presenter import PageOptions, Presenter
from pixsim.show.render import PAGE
from pixsim.show.sentences import setting_value
from pixsim.studies.comparison import ComparedSensor, Comparison, DisplayDifference
from pixsim.studies.design import BASE, frame_cost
from pixsim.studies.dry_run import PAGE_S, START_S, Cost, render_bytes, render_seconds
from pixsim.studies.files import scene_table, settings_text, without_files_of_axis
from pixsim.studies.paired import mean_interval
from pixsim.studies.sensors import OF_A_SENSOR, SHARED, ComparisonJob, SensorGroup, pixels_of
from pixsim.studies.settings import Condition, Study, paths_of
from pixsim.studies.table import ROWS_FILE
from pixsim.studies.uncertainty import FEW_SENSORS, TYPES_FILE, PairUncertainty
from pixsim.viewer.develop_options import TONE_CURVES, developed_words
from pixsim.viewer.display import white_light
from pixsim.viewer.metrics import Metric
from pixsim.viewer.screen import LightLevel
from pixsim.viewer.setting import Run

JSON_FILE = "compare.json"
SCORES = "scores"
FIGURE_WIDTH_IN, FIGURE_BORDER_IN, ROW_IN = 6.0, 0.8, 0.4
SCORES_CAPTION = (
    "The first metric of each frame of each sensor (grey), with the mean and its 95 % interval; with axes, the difference of each "
    "later sensor from the first at each of their values. The film's error is not in it."
)
ROWS_FILES = {
    ROWS_FILE: "numbers of each frame, with which an interrupted comparison goes on",
    TYPES_FILE: "the same of the sensor types of --uncertainty",
}


def comparison_outline(job: ComparisonJob) -> dict[str, Any]:
    """Return what a comparison would do, with an estimate of time and memory; nothing is rendered or written."""
    shown = job.shown
    first = shown.first
    repeats = job.repeats + (0 if job.types is None else FEW_SENSORS * len(job.types.sample.quantiles))
    costs = [_cost_of(group, repeats) for group in job.groups]
    cost = Cost(
        renders=sum(each.renders for each in costs),
        evaluations=sum(each.evaluations for each in costs),
        seconds=START_S + PAGE_S + sum(each.seconds for each in costs),
        memory_bytes=max(each.memory_bytes for each in costs),
        jobs=1,
    )
    scene = first.scene.with_resolution(shown.film_width)
    more: dict[str, Any] = {}
    if job.study is not None:
        more["study"] = {"name": job.study.name, "not_used": list(job.not_used)}
    if first.condition:
        more["conditions"] = {group.first.condition: {"weight": group.weight} for group in job.of_sensors()}
    if job.types is not None:
        more["uncertainty"] = {"draws": len(job.types.sample.quantiles), "inputs": list(job.types.sample.inputs)}
    if len(job.combinations) > 1:
        more["cases"] = [{"at": case.at} for case in job.combinations]
    return more | {
        "scene": shown.scene,
        "match": job.match,
        "repeats": job.repeats,
        **shown.as_dict(),
        "film": {"samples": list(scene.film_shape(first.camera, scene.for_camera(first.camera)))},
        "display": shown.display.model_dump(),
        "sensors": {
            case.sensor: {
                "camera": case.camera.model_dump(),
                "fov_deg": case.camera.fov_deg,
                "pixels": list(pixels_of(case)),
                "pixel": case.settings.pixel.model_dump(),
            }
            for case in shown.cases
        },
        "estimate": asdict(cost),
    }


def _cost_of(group: SensorGroup, repeats: int) -> Cost:
    """Estimate the renders and frames of the sensors under one condition."""
    seconds, largest = 0.0, 0.0
    for case in group.cases:
        request = group.request(case, group.film_width)
        frame = frame_cost(case.camera, case.settings.pixel.pitch_um, group.display, *case.others)
        cores = processors().usable
        seconds += render_seconds(request.plan, request.shape, cores) + repeats * frame.seconds / cores
        largest = max(largest, render_bytes(request.plan, request.shape) + frame.memory_bytes)
    return Cost(len(group.cases), repeats * len(group.cases), seconds, largest, 1)


def comparison_outline_document(job: ComparisonJob, out: Path) -> Document:
    """Return the answer of a dry run.

    out : folder that would be written
    """
    shown = comparison_outline(job)
    return Document("compare", "dry run", shown["scene"], shown, lead=list(_outline_blocks(job, shown, out)))


def _outline_blocks(job: ComparisonJob, shown: dict[str, Any], out: Path) -> Iterator[Block]:
    """Yield what a comparison would do."""
    height, across = shown["film"]["samples"]
    condition = job.shown.first.condition
    yield DocumentTable("sensors", (), [(case.sensor, sensor_words(case)) for case in job.shown.cases], words=None)
    yield Fact(common_words(job))
    yield Fact(f"film of {across} × {height} samples for all{f', in {condition}' if condition else ''}")
    if "cases" in shown:
        yield Fact(f"{len(shown['cases'])} cases: {'; '.join(case.words for case in job.combinations)}")
    if "uncertainty" in shown:
        yield Fact(f"{shown['uncertainty']['draws']} sensor types, over {', '.join(shown['uncertainty']['inputs'])}")
    yield Fact("the film's error is measured by the renders and part of each ±; render noise stands beside the answer if too large")
    yield Fact(f"{out}: nothing is written now")
    yield Fact(f"cost: {Cost(**shown['estimate'])}")


# --- files ------------------------------------------------------------------------------------------------------------------------


def figures_of(job: ComparisonJob) -> dict[str, str]:
    """Return the names of the figures of a comparison, with their descriptions."""
    has_budget = job.shown.first.settings.noise_budget
    return {SCORES: "the first metric of each frame"} | ({NAME: "noise and ΔE by cause"} if has_budget else {})


def comparison_files(job: ComparisonJob) -> dict[str, str]:
    """Return the names of all files of a comparison, with their descriptions; pixsim.json comes with them."""
    files = {
        JSON_FILE: "all numbers and settings, for programs",
        SETTINGS_FILE: "settings of all sensors; its first lines have the command that makes the same numbers again",
    }
    for name, words in figures_of(job).items():
        files |= {f"figures/{name}.svg": words, f"figures/{name}.csv": f"data of the figure of {words}"}
    for sensor in job.names:
        files |= {
            f"sensors/{sensor}.toml": f"pixel, camera and exposure of {sensor}, as its file and the options have them",
            f"pictures/image_{sensor}.png": f"image of {sensor}, as shown",
            f"pictures/ideal_{sensor}.png": f"image of an ideal camera with the response of {sensor}",
            f"pictures/delta_e_{sensor}.png": f"S-CIELAB ΔE map of {sensor}, with axes",
        }
    return files


def check_output(job: ComparisonJob, folder: str | os.PathLike[str]) -> None:
    """Raise PixsimError if the folder holds a file of a comparison's name that pixsim did not write."""
    check_replaceable(folder, {PAGE, *comparison_files(job), *figure_files(figures_of(job))})


def settings_files(job: ComparisonJob) -> dict[str, str]:
    """Return settings.toml and a file for each sensor, as name -> text; their command makes the same numbers again.

    They state what was stated, and leave open what pixsim chose, such as a display: the command chooses the same again.
    """
    files = [f"sensors/{name}.toml" for name in job.names]
    has_study = job.study is not None and job.study.has_cases
    words = ["pixsim", "compare", *files]
    words += [] if has_study else ["--scene", whole_path(job.shown.scene)]
    words += ["--study" if has_study else "--config", SETTINGS_FILE]
    words += ["--match", job.match] if len(job.matches) == 1 else []
    words += ["--repeats", str(job.repeats)]
    if job.types is not None:
        words += ["--sobol" if job.types.total else "--uncertainty", str(job.types.asked)]
    for option, value in (("--sensor", job.sensor), ("--variant", job.variant)):
        words += [option, value] if value else []
    command = shlex.join(words)
    if job.study is not None and has_study:
        texts = {SETTINGS_FILE: settings_table_text(_study_table(job, job.study), command)}
    else:
        first = job.base[0]
        chosen = {"dots", "samples_per_deg"} - first.display.model_fields_set  # where both are stated, no other display is shown
        scene = scene_table(job.shown.first.scene.path.parent, first.scene)
        display = first.display.model_dump(mode="json", exclude_none=True, exclude=chosen)
        text = settings_text(first, command, scene=scene, display=display, camera={}, lens={}, pixel={}, exposure={})
        texts = {SETTINGS_FILE: text}
    spreads = [{}] * len(files) if job.types is None else job.types.spreads
    for file, settings, spread in zip(files, job.base, spreads, strict=True):
        texts[file] = settings_text(settings, f"(in the folder above) {command}", {"": spread}, **_all_but_sensor(settings))
    return texts


def _all_but_sensor(settings: Run) -> dict[str, Any]:
    """Return empty tables in place of all that is not a sensor's own."""
    return {name: {} for name in type(settings).model_fields if name not in OF_A_SENSOR}


def _study_table(job: ComparisonJob, study: Study) -> dict[str, Any]:
    """Return the tables of a study that makes the same cases: what all sensors share, the axes and the conditions."""
    first = job.base[0]
    shared = first.model_dump(mode="json", exclude_unset=True, include=set(SHARED) - set(OF_A_SENSOR))
    groups = {group.first.condition: group for group in job.of_sensors()}
    scene = {"file": whole_path(study.scene.file), "parameters": scene_table(job.shown.first.scene.path.parent, first.scene)}
    conditions = [
        condition.model_dump(mode="json") | {"set": _whole_settings(condition, groups[condition.name].first.scene.path.parent)}
        for condition in study.condition
    ]
    cases: dict[str, Any] = {"condition": conditions} if conditions else {}
    cases |= {"detail": list(study.detail)} if study.detail else {}
    cases |= {"axis": [without_files_of_axis(axis.model_dump(mode="json")) for axis in study.axis]} if study.axis else {}
    return {"name": study.name} | shared | {"scene": scene} | cases


def _whole_settings(condition: Condition, folder: Path) -> dict[str, Any]:
    """Return the settings of a condition with the whole paths of their files.

    folder : of its scene
    """
    table = dict(condition.set)
    if scene := table.get("scene"):
        given = {"parameters": scene_table(folder, scene["parameters"])} if "parameters" in scene else {}
        table["scene"] = given | ({"file": whole_path(scene["file"])} if "file" in scene else {})
    others = ("lens", "veiling_glare"), ("lens", "relative_illumination"), ("develop", "tone_curve")
    for part, name in (("pixel", "quantum_efficiency"), ("camera", "chief_ray_angle"), *others):
        if isinstance(file := table.get(part, {}).get(name), str) and file not in TONE_CURVES:
            table[part] = table[part] | {name: whole_path(file)}
    if isinstance(colour := table.get("pixel", {}).get("colour"), dict):
        files = {name: whole_path(colour[name]) for name in RESPONSES if isinstance(colour.get(name), str)}
        table["pixel"] = table["pixel"] | {"colour": colour | files}
    return table


# --- the page ---------------------------------------------------------------------------------------------------------------------


def comparison_document(result: Comparison, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim compare`, without the sections of its page and other files.

    warned : notes that a reader of the terminal has seen
    """
    content = data(result)
    answers = tuple(_answer(result, other) for other in result.names[1:])
    stated = tuple(note for note in notes(result) if note not in warned)
    lead = (*facts(result), Fact(common_words(result.job)), *stated)
    made = f"{result.shown.scene}, seed {result.shown.first.settings.seed}"
    return Document(
        command="compare",
        kind="comparison of sensors",
        title=" against ".join(result.names),
        data=content,
        cell=(*answers, Plot(lambda: scores_plate(result)), *lead, made),
        answers=answers,
        lead=lead,
        about=(f"{DELTA_E} The mean over the picture is compared.",) if judged_by_delta_e(result.job) else (),
        data_file=JSON_FILE,
    )


def comparison_page(result: Comparison, folder: str | os.PathLike[str]) -> Document:
    """Return the document of a comparison with its page and all other files.

    folder : that will be written, which may hold `ROWS_FILES`
    """
    end = scale_end(max(sensor.score.statistics()["p99_delta_e"] for sensor in result.sensors))
    pictures = dict[str, bytes]()
    for sensor in result.sensors:
        score, where = sensor.score, picture_axes(sensor.light.image, sensor.score.border_um)
        pictures[f"pictures/image_{sensor.name}.png"] = light_png(score.image)
        pictures[f"pictures/ideal_{sensor.name}.png"] = light_png(score.ideal)
        pictures[f"pictures/delta_e_{sensor.name}.png"] = delta_e_png(score.delta_e, where, end)
    rows_files = [name for name in ROWS_FILES if Path(folder, name).is_file()]

    document = comparison_document(result)
    stated = [block for block in document.lead if isinstance(block, Note)]
    return replace(
        document,
        lead=(_slider(result), *facts(result), *stated),
        sections=_sections(result, pictures, end, rows_files),
        files={**pictures, **settings_files(result.job)},
    )


def comparison_csv(result: Comparison) -> str:
    """Return the evaluations of all sensors as CSV."""
    return result.table.to_csv()


def _answer(result: Comparison, other: str) -> Answer:
    """Return the answer for a later sensor by the first metric; with axes where which is better.

    The headline has the largest of what turns it or makes it unsure; what else does stands below.
    """
    metric = asked_metrics(result.job)[0]
    if len(result.cases) > 1:
        return Answer((Strong(over_cases(result, other)),), named=True)
    if metric.is_delta_e:
        first, *turns = verdict(result, other).split("; ")
        warnings = [*turns, *unconverged(result)]
    else:
        first, warnings = metric_verdict(result, other, metric), []
    developed = developed_words(result.shown.first.settings.develop, [case.settings.pixel for case in result.shown.cases])
    answer = headline([(Strong(first),), *warnings[:1]])
    return Answer(answer.head, (*answer.below, *warnings[1:], *filter(None, [developed])), named=first.startswith(result.names))


def facts(result: Comparison) -> Iterator[Block]:
    """Yield a row for each sensor, the answers of cases and sensor types, and what the other metrics say."""
    where = f" in {result.shown.first.condition}" if result.shown.first.condition else ""
    first, *others = asked_metrics(result.job)
    rows, shared = [], shared_stages(result.shown)
    for sensor in result.sensors:
        time = exposure_time(sensor.score.frame.integration_s)
        words = f"{sensor_words(sensor.case)}, exposed for {time}{where}"
        stages = [stage for stage in stage_words(sensor.case.settings) if stage not in shared]
        mean = shown_mean(result, sensor.name) if first.is_delta_e else metric_mean(result, sensor.name, first)
        rows.append((sensor.name, f"mean {mean}", ", ".join([words, *stages])))
    yield DocumentTable("sensors", (), rows, words=None)
    of_cases = [
        f"{case.case.words or BASE}: {verdict(case, other) if first.is_delta_e else metric_verdict(case, other, first)}"
        for case in result.cases
        for other in result.names[1:]
    ]
    listed = [*(of_cases if len(result.cases) > 1 else []), *map(pair_words, result.uncertainty)]
    if listed:
        yield Listed(listed)
    for metric in others:
        if metric.is_delta_e:
            yield from (Fact(f"mean ΔE: {verdict(result, other)}") for other in result.names[1:])
        else:
            yield Fact(metric_words(result, metric))


@figure(SCORES, SCORES_CAPTION)
def scores_plate(result: Comparison) -> Drawing:
    """Draw the first metric of each frame of each sensor; with axes, the differences at each of their values.

    Its table has the number of each frame, under conditions their weighted mean.
    """
    metric = asked_metrics(result.job)[0]
    label = "mean ΔE" if metric.is_delta_e else literal(metric.title)
    of_sensors = [{name: case.frames(name, metric) for name in case.names} for case in result.cases]
    rows = len(result.cases) if len(result.cases) > 1 else len(result.names)
    drawing = new_figure(FIGURE_WIDTH_IN, FIGURE_BORDER_IN + ROW_IN * rows)
    axes = drawing.add_subplot()
    if len(result.cases) > 1:
        for place, other in enumerate(result.names[1:]):
            pairs = [case.pairs(other, metric) for case in result.cases]
            error = [of_case.half_width for of_case in pairs]
            differences = [of_case.difference for of_case in pairs]
            axes.errorbar(differences, range(rows), xerr=error, fmt="D", color=f"C{place}", capsize=4)
        axes.axvline(0.0, color="0.5", lw=0.8)
        axes.set_yticks(range(rows), [literal(case.case.words or BASE) for case in result.cases])
        axes.set_xlabel(f"{label} above that of {literal(result.names[0])}, with its 95 % interval")
    else:
        (values_of,) = of_sensors
        for row, values in enumerate(values_of.values()):
            low, mean, high = mean_interval(values)
            axes.plot(values, np.full(values.size, row), "o", color="tab:gray", alpha=0.5, markersize=4)
            axes.errorbar([mean], [row], xerr=[[mean - low], [high - mean]], fmt="D", color=f"C{row}", capsize=5, markersize=5)
        axes.set_yticks(range(rows), [literal(name) for name in result.names])
        largest = max(float(values.max()) for values in values_of.values())
        if largest > 0:
            axes.set_xlim(0.0, 1.05 * largest)
        axes.set_xlabel(f"{label}: each frame (grey), and the mean with its 95 % interval")
    axes.set_ylim(rows - 0.5, -0.5)  # the first one is on top

    table: dict[str, list[Any]] = {"case": [], "sensor": [], "repeat": [], metric.columns[0]: []}
    for case, values_of in zip(result.cases, of_sensors, strict=True):
        for name, values in values_of.items():
            table["case"] += [case.case.words] * values.size
            table["sensor"] += [name] * values.size
            table["repeat"] += range(values.size)
            table[metric.columns[0]] += values.tolist()
    return drawing, table


# --- numbers for programs ---------------------------------------------------------------------------------------------------------


def numbers(result: Comparison) -> dict[str, Any]:
    """Return the numbers that answer the question, as in compare.json."""
    return {
        "scores": {name: list(score) for name, score in result.scores.items()},
        "difference": result.difference,
        "interval_delta_e": {name: list(ends) for name, ends in result.interval_delta_e.items()},
        "probability_a_better": result.probability_a_better,
        "film_delta_e": result.film_delta_e,
        "displays": {
            other: [_display_data(difference, (result.names[0], other)) for difference in result.display_differences(other)]
            for other in result.names[1:]
        },
        "matches": {
            match: {other: result.pairs(other, match=match).difference for other in result.names[1:]}
            for match in result.job.matches
        },
        "verdicts": {other: verdict(result, other) for other in result.names[1:]},
    }


def data(result: Comparison) -> dict[str, Any]:
    """Return compare.json. With conditions the answers are those of the weighted mean, and the rest is `shown`."""
    job, shown = result.job, result.shown
    stated: dict[str, Any] = {"names": list(result.names), "match": job.match, "repeats": job.repeats, "scene": shown.scene}
    if job.study is not None:
        stated["study"] = {"name": job.study.name, "not_used": list(job.not_used)}
    shared: dict[str, Any] = {
        "settings": {"sensors": dict(zip(result.names, (_settings_data(run) for run in job.base), strict=True))},
        "notes": notes(result),
        "cases": [{"at": case.case.at} | numbers(case) for case in result.cases],
        "table": ROWS_FILE,
    }
    if len(result.cases) > 1:
        stated["verdicts"] = {other: over_cases(result, other) for other in result.names[1:]}
        return result_data(stated, **shared)
    conditions = [group for group in result.groups() if group.first.condition]
    more: dict[str, Any] = {"shown_condition": shown.first.condition} if conditions else {}
    if conditions:
        more["conditions"] = {group.first.condition: _condition_data(result, group) for group in conditions}
    if len(result.names) > 2:
        more["pairs"] = {other: _pair_data(result, other) for other in result.names[1:]}
    if result.further_metrics:
        more["metrics"] = {metric.name: _metric_data(result, metric) for metric in result.further_metrics}
    if result.uncertainty:
        more["uncertainty"] = {each.names[1]: each.as_dict() for each in result.uncertainty if each.metric.is_delta_e}
        for each in result.uncertainty:
            if not each.metric.is_delta_e:
                more["uncertainty"][each.names[1]].setdefault("metrics", {})[each.metric.name] = each.as_dict()
    content = stated | {
        **more,
        **numbers(result),
        **shown.as_dict(),
        "scored_dots": list(result.sensors[0].score.delta_e.shape),
        "display": shown.display.model_dump(),
        "seed": shown.first.settings.seed,
        "sensors": {
            sensor.name: _sensor_data(sensor) | {"delta_e": result.delta_e[sensor.name].tolist()} for sensor in result.sensors
        },
    }
    return result_data(content, **shared)


def _settings_data(settings: Run) -> dict[str, Any]:
    return settings.model_dump(mode="json", exclude_none=True)


def _condition_data(result: Comparison, group: SensorGroup) -> dict[str, Any]:
    """Return what compare.json has of one condition."""
    name = group.first.condition
    frames = {sensor: result.frames(sensor, condition=name) for sensor in result.names}
    pairs = {other: result.pairs(other, condition=name) for other in result.names[1:]}
    return {
        "weight": group.weight,
        "scores": {sensor: list(mean_interval(values)) for sensor, values in frames.items()},
        "difference": {other: each.difference for other, each in pairs.items()},
        "interval_delta_e": {other: list(each.interval) for other, each in pairs.items()},
        "probability_a_better": {other: each.probability_a_better for other, each in pairs.items()},
        "film_delta_e": {other: result.film_of_pair(other, condition=name) for other in pairs},
        "delta_e": {sensor: values.tolist() for sensor, values in frames.items()},
    }


def _pair_data(result: Comparison, other: str) -> dict[str, Any]:
    """Return what compare.json has of the first sensor and another one alone, beside their difference."""
    pairs = result.pairs(other)
    scores = {result.names[0]: list(mean_interval(pairs.a)), other: list(mean_interval(pairs.b))}
    group = next(group for group in result.groups_of_pair(other) if group.weight)
    return {"scores": scores, **group.as_dict()}


def _metric_data(result: Comparison, metric: Metric) -> dict[str, Any]:
    """Return what compare.json has of a further metric."""
    return {
        "scores": {name: list(mean_interval(result.frames(name, metric))) for name in result.names},
        "probability_a_better": {other: pairs_of_all(result, other, metric).probability_a_better for other in result.names[1:]},
    }


def _sensor_data(sensor: ComparedSensor) -> dict[str, Any]:
    """Return the entry of compare.json; `statistics` are those of its first frame, as in score.json."""
    case, settings, score, light = sensor.case, sensor.case.settings, sensor.score, sensor.light
    return {
        "file": case.file,
        "pixels": list(pixels_of(case)),
        "statistics": score.statistics(),
        "camera": case.camera.model_dump(),
        "fov_deg": case.camera.fov_deg,
        "pixel": settings.pixel.model_dump(),
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
    """Return the numbers as in compare.json; `better` is None where neither is surely better."""
    return asdict(display) | {
        "interval_delta_e": list(display.interval_delta_e),
        "better": {1: names[0], -1: names[1]}.get(display.sign),
    }


# --- sections of the page -------------------------------------------------------------------------------------------------------


PAIRED = (
    "Intervals and probabilities are those of Student's t for {} pairs of frames, each of another pair of individual sensors: they "
    "are of the mean of a sensor type. Frame number k has the same random seeds in all conditions."
)
UNKNOWN_TYPES = (
    "Sensor types are drawn from the ranges of the technologies and from [pixel.uncertainty] of the data sheets. All have the same "
    "random numbers; the film's error is not in these numbers."
)
MATRIX = (
    "The matrix leads from the channels to the display's light. The larger its noise gains, the more of a sensor's noise is seen "
    "as colour."
)


def _slider(result: Comparison) -> Slider:
    """Return the picture of the first sensor beside that of another one, or the ideal image."""
    first, *others = result.sensors
    ideal = _picture(first.score.ideal, "ideal image")
    return Slider(
        id="slider",
        heading=f"Pictures in {result.shown.words}" if result.shown.words else "",
        left=_picture(first.score.image, first.name),
        others=(*(_picture(sensor.score.image, sensor.name) for sensor in others), ideal),
        left_words=f"the picture of {first.name}",
        right_words="the chosen picture",
    )


def _sections(result: Comparison, pngs: Mapping[str, bytes], end: float, rows_files: Sequence[str]) -> Iterator[Section]:
    """Yield the sections of the page.

    pngs : name -> picture
    end : of the colour scale of the ΔE maps
    rows_files : of `ROWS_FILES`, those that are there
    """
    job, group, sensors, names = result.job, result.shown, result.sensors, result.names
    where = f" in {group.words}" if group.words else ""
    tables = [_differences(result, metric) for metric in asked_metrics(job)]
    yield Section("differences", "Differences", [*tables, Plot(lambda: scores_plate(result)), PAIRED.format(job.repeats)])
    if judged_by_delta_e(job):
        yield _detail(result, end)
        yield Section("maps", "Maps of the errors", [_map(sensor, pngs) for sensor in sensors])
    yield Section("numbers", f"Numbers{where}", [_numbers(result)])
    probability = f"probability that {names[0]} is better (95 % interval)"
    types = ("difference", "sensor types", probability, "5 %", "median", "95 %", "unknown")
    unknown = DocumentTable("differences over sensor types", types, map(_unknown, result.uncertainty), words=(6,))
    yield Section("unknown", "What is not known of the sensors", [UNKNOWN_TYPES, unknown] if result.uncertainty else ())
    colours = [(sensor.name, colour_rows(sensor.colour, sensor.score.out_of_gamut)) for sensor in sensors if sensor.colour]
    coloured = [DocumentTable(f"colours of {name}", (), rows, name, words=None) for name, rows in colours]
    yield Section("colour", f"Colour{where}", [MATRIX, *coloured] if coloured else ())
    yield budgets_section({sensor.name: sensor.budget for sensor in sensors if sensor.budget is not None})
    yield Section("shared", "What the sensors share", [Listed(common_words(job).split("; "))])
    yield Section("settings", "Settings", settings_blocks(list(_settings(result))))
    files = comparison_files(job) | {name: words for name, words in ROWS_FILES.items() if name in rows_files}
    listed = [
        (Link(name, name), f": {words}")
        for name, words in (files | {"pixsim.json": "versions, wall times, names of files"}).items()
    ]
    yield Section("files", "Files in this folder", [Listed(listed)], folded=True)


def _detail(result: Comparison, end: float) -> Section:
    """Return the detail where the errors differ most, or the one that is chosen in the settings, of each sensor.

    end : of the colour scale of the ΔE maps
    """
    sensors, job = result.sensors, result.job
    maps = [sensor.score.delta_e for sensor in sensors]
    centre, shape = None if job.study is None else job.study.detail, (maps[0].shape[0], maps[0].shape[1])
    window = window_at(centre, shape) if centre else worst_window([np.abs(other - maps[0]) for other in maps[1:]])
    title = "The detail chosen in the settings" if centre else "Where the errors differ most"
    details = [
        Section("", sensor.name, [Pictures((crops(sensor.score, window, f"the picture of {sensor.name}", end),), title.lower())])
        for sensor in sensors
    ]
    sizes = size_words(factor_for(sensors[0].score.image), result.shown.display.samples_per_deg)
    return Section("detail", title, (*details, DeltaEScale(scale(end)), sizes), together=True)


def _numbers(result: Comparison) -> DocumentTable:
    """Return the numbers of each sensor in the shown group."""
    condition = result.shown.first.condition or None
    head = ["sensor", "pixels", "pitch (µm)", "lens", "exposure", "mean electrons", "full well", "saturated"]
    rows = [list(_row(sensor)) for sensor in result.sensors]
    if judged_by_delta_e(result.job):
        head[1:1] = ["mean ΔE", "99th percentile"]
        head.append("film's error (ΔE)")
        for sensor, row in zip(result.sensors, rows, strict=True):
            row[1:1] = [shown_mean(result, sensor.name, condition), f"{sensor.score.statistics()['p99_delta_e']:.3g}"]
            row.append("unknown" if math.isnan(sensor.film_delta_e) else f"{sensor.film_delta_e:.1g}")
    return DocumentTable("numbers of each sensor", head, map(tuple, rows))


def _differences(result: Comparison, metric: Metric) -> DocumentTable:
    """Return the differences of each pair by a metric: at values of axes, in the mean and in each condition.

    Those of ΔE are also by each match, and on each display.
    """
    better = f"probability that {result.names[0]} is better"
    head = ("case", "sensors", "mean", "95 % interval", better) + (("film's error, at most",) if metric.is_delta_e else ())
    rows: list[tuple[str, ...]] = []
    for case in result.cases:
        conditions = [group.first.condition for group in case.groups() if group.first.condition]
        for other in result.names[1:]:
            pair = f"{other} − {result.names[0]}"
            for match, condition in product(
                result.job.matches if metric.is_delta_e else result.job.matches[:1], (None, *conditions)
            ):
                pairs = case.pairs(other, metric, match=match, condition=condition)
                words = [case.case.words, condition or ("weighted mean" if conditions else ""), f"match {match}"]
                cells = (*difference_cells(pairs.difference, pairs.interval), probability(pairs.probability_a_better, pairs.a.size))
                film = (film_cell(case.film_of_pair(other, match, condition)),) if metric.is_delta_e else ()
                rows.append((", ".join(filter(None, words)), pair, *cells, *film))
            for display in case.display_differences(other)[1:] if metric.is_delta_e else ():
                words = [case.case.words, f"{display.dots} dots"]
                cells = (*difference_cells(display.difference, display.interval_delta_e), "")
                rows.append((", ".join(filter(None, words)), pair, *cells, film_cell(display.film_delta_e)))
    name = "mean ΔE" if metric.is_delta_e else metric.words
    return DocumentTable(f"differences of {name}", head, rows, "" if metric.is_delta_e else metric.title, words=(1,))


def _picture(luminance: Array, name: str) -> Picture:
    return Picture(display_codes(reduced(luminance)), name)


def _map(sensor: ComparedSensor, pngs: Mapping[str, bytes]) -> Map:
    """Return the ΔE map of a sensor."""
    statistics = sensor.score.statistics()
    words = f"{sensor.name}, first frame: S-CIELAB ΔE. One dot in a hundred has more than {statistics['p99_delta_e']:.3g}."
    return Map(pngs[f"pictures/delta_e_{sensor.name}.png"], words)


def _row(sensor: ComparedSensor) -> tuple[str, ...]:
    """Return a sensor's row of the page's table of numbers, without those of ΔE."""
    statistics = sensor.score.statistics()
    (rows, columns), pixel = pixels_of(sensor.case), sensor.case.settings.pixel
    return (
        sensor.name,
        f"{columns} × {rows}",
        f"{pixel.pitch_um:g}",
        sensor.case.camera.lens_words,
        exposure_time(statistics["integration_s"]),
        rounded(statistics["mean_electrons_e"], 4),
        rounded(statistics["full_well_e"], 4),
        f"{100 * statistics['saturated_fraction']:.2g} %",
    )


def film_cell(film_delta_e: float | None) -> str:
    """Return the largest error of a difference that the film may cause."""
    return "unknown" if film_delta_e is None else f"{film_delta_e:.2g}"


def _unknown(drawn: PairUncertainty) -> tuple[str, ...]:
    """Return a row of the page's table of what is not known of the sensors."""
    better, ends, metric = drawn.probability_a_better, drawn.difference.quantiles, drawn.metric
    form, judge = (".4f", "") if metric.is_delta_e else (".4g", f", {metric.words}{metric.unit and f' ({metric.unit})'}")
    return (
        f"{drawn.names[1]} − {drawn.names[0]}{judge}",
        str(better.draws),
        str(better),
        *(f"{ends[name]:+{form}}" for name in ("p05", "p50", "p95")),
        largest_share_words(drawn),
    )


def _settings(result: Comparison) -> Iterator[DocumentTable]:
    """Yield the settings of all sensors, then each sensor's own, then what each condition sets."""
    job, group, first = result.job, result.shown, result.sensors[0]
    coloured = any(sensor.case.settings.pixel.colour for sensor in result.sensors)
    times_s = [sensor.score.frame.integration_s for sensor in result.sensors]
    level = LightLevel.of(first.light.image, group.display, times_s)
    seed = group.first.settings.seed
    seed_row = ("seed", seed, "of all random numbers", "set" if seed else "default")
    yield settings_table("scene", [*scene_rows(first.light.image, first.case.settings.scene, level), seed_row])
    yield settings_table("display", record_rows("display", group.display, False, coloured=coloured))
    develop = group.first.settings.develop
    if coloured or develop.words:
        yield settings_table("develop", record_rows("develop", develop, False, coloured=coloured))
    for sensor in result.sensors:
        settings = sensor.case.settings
        sheet = settings.pixel.technology == NO_TECHNOLOGY
        records: dict[str, Record] = {"camera": sensor.case.camera, "pixel": settings.pixel, "exposure": settings.exposure}
        for name, record in records.items():
            yield settings_table(f"{sensor.name}: {name}", record_rows(name, record, sheet))
    for condition in () if job.study is None else job.study.condition:
        values = [(path, reduce(getitem, path, condition.set)) for path in paths_of(condition.set)]
        rows = [(".".join(path), setting_value(value, path[-1]), "", "set") for path, value in values]
        yield settings_table(f"condition {condition.name}", rows)


def _page(result: Comparison, options: PageOptions) -> Document:
    return comparison_page(result, options.folder)


PRESENTER = Presenter(document=comparison_document, figure=scores_plate, csv=comparison_csv, page=_page)
