"""A comparison of sensors: its document, and its output files: all of them, or none."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import rounded, span
from pixsim.base.files import check_replaceable
from pixsim.base.machine import processors
from pixsim.base.records import Record
from pixsim.base.tables import Column
from pixsim.base.toml import SETTINGS_FILE, settings_table_text, whole_path
from pixsim.light.curves import RESPONSES
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.run import colour_rows
from pixsim.report.settings import record_rows, scene_rows, settings_table
from pixsim.report.wording import DELTA_E, map_words
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.show.document import (
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
)
from pixsim.show.pages import Plate, figure_files
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
from pixsim.show.render import PAGE
from pixsim.show.sentences import setting_value
from pixsim.studies.comparison import ComparedSensor, Comparison, common_words, sensor_words, shown_probability
from pixsim.studies.design import frame_cost
from pixsim.studies.dry_run import PAGE_S, START_S, Cost, render_bytes, render_seconds
from pixsim.studies.files import scene_table, settings_text, without_files_of_axis
from pixsim.studies.merit import LightLevel
from pixsim.studies.sensors import OF_A_SENSOR, SHARED, ComparisonJob, SensorGroup, pixels_of
from pixsim.studies.settings import Condition, Study, paths_of
from pixsim.studies.uncertainty import FEW_SENSORS, TYPES_FILE, PairUncertainty
from pixsim.viewer.develop_options import TONE_CURVES
from pixsim.viewer.setting import Run

JSON_FILE = "compare.json"
SCORES = "scores"
SCORES_CAPTION = (
    "Mean ΔE of each frame of each sensor, with the mean and its 95 % interval; with axes, the difference of each later sensor "
    "from the first at each of their values. The film's error is not in it."
)
ROWS_FILES = {
    "results.csv": "mean ΔE of each frame, with which an interrupted comparison goes on",
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
    return {SCORES: "mean ΔE of each frame"} | ({NAME: "noise and ΔE by cause"} if has_budget else {})


def comparison_files(job: ComparisonJob) -> dict[str, str]:
    """Return the names of all files of a comparison, with their descriptions; provenance.json comes with them."""
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
    return Document(
        command="compare",
        kind="comparison of sensors",
        title=" against ".join(result.names),
        data=result.as_dict(),
        answers=result.answers(),
        lead=(*result.facts(), *(note for note in result.notes if note not in warned)),
        about=(f"{DELTA_E} The mean over the picture is compared.",),
        data_file=JSON_FILE,
        sources=[Path(case.file) for case in result.shown.cases],
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
    sections = _sections(result, pictures, end, rows_files)
    return replace(comparison_document(result), sections=sections, files={**pictures, **settings_files(result.job)})


PAIRED = (
    "Intervals and probabilities are those of Student's t for {} pairs of frames, each of another pair of individual sensors. They "
    "tell how sure the simulation is of the mean ΔE of a sensor type, not how often one frame is better than another. The error "
    "that the film's samples may cause is the same in every frame: it is stated beside them, and it is a part of each ±. Frame "
    "number k has the same random seeds in all conditions, whose weighted mean is taken before its interval."
)
UNKNOWN_TYPES = (
    "Sensor types are drawn from the ranges of the technologies and from [pixel.uncertainty] of the data sheets. All have the same "
    "random numbers; the film's error is not in these numbers."
)
MATRIX = (
    "The matrix leads from the channels to the display's light. The larger its noise gains, the more of a sensor's noise is seen "
    "as colour."
)
DETAIL = "{}: the ideal image, the sensor's picture, and its errors."
WORST_DETAIL, CHOSEN_DETAIL = "The detail where the errors of the sensors differ most", "The detail chosen in the settings"


def _sections(result: Comparison, pngs: Mapping[str, bytes], end: float, rows_files: Sequence[str]) -> Iterator[Section]:
    """Yield the sections of the page.

    pngs : name -> picture
    end : of the colour scale of the ΔE maps
    rows_files : of `ROWS_FILES`, those that are there
    """
    job, group, sensors, names = result.job, result.shown, result.sensors, result.names
    first, where = sensors[0], f" in {group.words}" if group.words else ""
    maps = [sensor.score.delta_e for sensor in sensors]
    centre, shape = None if job.study is None else job.study.detail, (maps[0].shape[0], maps[0].shape[1])
    window = window_at(centre, shape) if centre else worst_window([np.abs(other - maps[0]) for other in maps[1:]])
    detail = CHOSEN_DETAIL if centre else WORST_DETAIL
    pictures = [_picture(sensor.score.image, sensor.name) for sensor in sensors]
    slider = Slider(
        *("slider", f"The whole picture of {names[0]} and of another", pictures[0]),
        (*pictures[1:], _picture(first.score.ideal, "ideal image")),
        *(f"the picture of {names[0]}", "the chosen picture"),
    )
    sizes = size_words(factor_for(first.score.image), group.display.samples_per_deg)
    figure = Plot(lambda: scores_plate(result))
    yield Section("differences", "Differences", [_differences(result), figure, PAIRED.format(job.repeats)])
    yield Section("pictures", f"Pictures{where}", (sizes, slider), together=True)
    details = [
        Section("", sensor.name, (Pictures((crops(sensor.score, window, f"the picture of {sensor.name}", end),), of),))
        for sensor in sensors
        for of in (f"{detail[0].lower()}{detail[1:]}",)
    ]
    title = "A detail, 1:1" if centre else "The largest differences, 1:1"
    yield Section("detail", title, (DETAIL.format(detail), *details, DeltaEScale(scale(end))), together=True)
    head = (
        *("sensor", "mean ΔE", "99th percentile", "pixels", "pitch (µm)", "lens", "exposure (ms)", "mean electrons", "full well"),
        *("saturated", "film's error (ΔE)"),
    )
    rows = [_row(sensor, result.shown_mean(sensor.name, condition=group.first.condition or None)) for sensor in sensors]
    yield Section("numbers", f"Numbers{where}", [DocumentTable("numbers of each sensor", head, rows)])
    probability = f"probability that {names[0]} is better (95 % interval)"
    types = ("difference", "sensor types", probability, "5 %", "median", "95 %", "unknown")
    unknown = DocumentTable("differences over sensor types", types, map(_unknown, result.uncertainty), words=(6,))
    yield Section("unknown", "What is not known of the sensors", [UNKNOWN_TYPES, unknown] if result.uncertainty else ())
    colours = [(sensor.name, colour_rows(sensor.colour, sensor.score.out_of_gamut)) for sensor in sensors if sensor.colour]
    tables = [DocumentTable(f"colours of {name}", (), rows, name, words=None) for name, rows in colours]
    yield Section("colour", f"Colour{where}", [MATRIX, *tables] if tables else ())
    yield budgets_section({sensor.name: sensor.budget for sensor in sensors if sensor.budget is not None})
    yield Section("maps", "Maps of the errors", [_map(sensor, pngs, end) for sensor in sensors])
    rest = f"Noise and non-uniformities that a data sheet does not state are zero. Seed {group.first.settings.seed}."
    yield Section("settings", "Settings", [*_settings(result), rest])
    files = comparison_files(job) | {name: words for name, words in ROWS_FILES.items() if name in rows_files}
    listed = [(Link(name, name), f": {words}") for name, words in (files | {"provenance.json": "versions and wall times"}).items()]
    yield Section("files", "Files in this folder", [Listed(listed)])


def scores_plate(result: Comparison) -> Plate:
    """Draw the mean ΔE of each frame of each sensor; with axes, the differences at each of their values.

    Its table has the mean ΔE of each frame, under conditions their weighted mean.
    """
    rows: list[tuple[str, str, int, float]] = []
    for case in result.cases:
        for name, values in case.delta_e.items():
            rows += [(case.case.words, name, repeat, float(value)) for repeat, value in enumerate(values)]
    names = "case", "sensor", "repeat", "mean_delta_e"
    table: dict[str, Column] = {name: [row[at] for row in rows] for at, name in enumerate(names)}
    return Plate(SCORES, SCORES_CAPTION, result.plot(), table)


def _differences(result: Comparison) -> DocumentTable:
    """Return the differences of each pair: at values of axes, in the mean and in each condition, by each match, on each display."""
    better = f"probability that {result.names[0]} is better"
    head = ("case", "sensors", "mean", "95 % interval", better, "film's error, at most")
    rows: list[tuple[str, ...]] = []
    for case in result.cases:
        conditions = [group.first.condition for group in case.groups() if group.first.condition]
        for other in result.names[1:]:
            pair = f"{other} − {result.names[0]}"
            for match in result.job.matches:
                for condition in (None, *conditions):
                    pairs = case.pairs(other, match=match, condition=condition)
                    film = case.film_of_pair(other, match, condition)
                    words = [case.case.words, condition or ("weighted mean" if conditions else ""), f"match {match}"]
                    cells = difference_cells(pairs.difference, pairs.interval, film)
                    chance = shown_probability(pairs.probability_a_better)
                    rows.append((", ".join(filter(None, words)), pair, *cells[:2], chance, cells[2]))
            for display in case.display_differences(other)[1:]:
                cells = difference_cells(display.difference, display.interval_delta_e, display.film_delta_e)
                words = [case.case.words, f"{display.dots} dots"]
                rows.append((", ".join(filter(None, words)), pair, *cells[:2], "", cells[2]))
    return DocumentTable("differences of mean ΔE", head, rows, words=(1,))


def _picture(luminance: Array, name: str) -> Picture:
    return Picture(display_codes(reduced(luminance)), name)


def _map(sensor: ComparedSensor, pngs: Mapping[str, bytes], end: float) -> Map:
    """Return the ΔE map of a sensor."""
    statistics = sensor.score.statistics()
    words = map_words(f"{sensor.name}, first frame: ", statistics["mean_delta_e"], statistics["p99_delta_e"], end)
    return Map(pngs[f"pictures/delta_e_{sensor.name}.png"], words)


def _row(sensor: ComparedSensor, mean: str) -> tuple[str, ...]:
    """Return a sensor's row of the page's table of numbers.

    mean : its mean ΔE
    """
    statistics = sensor.score.statistics()
    (rows, columns), pixel = pixels_of(sensor.case), sensor.case.settings.pixel
    return (
        sensor.name,
        mean,
        f"{statistics['p99_delta_e']:.3g}",
        f"{columns} × {rows}",
        f"{pixel.pitch_um:g}",
        sensor.case.camera.lens_words,
        f"{1e3 * statistics['integration_s']:.3g}",
        rounded(statistics["mean_electrons_e"], 4),
        rounded(statistics["full_well_e"], 4),
        f"{100 * statistics['saturated_fraction']:.2g} %",
        "unknown" if math.isnan(sensor.film_delta_e) else f"{sensor.film_delta_e:.1g}",
    )


def difference_cells(difference: float, interval: tuple[float, float], film: float | None) -> tuple[str, str, str]:
    """Return a difference, its 95 % interval, and the largest error that the film may cause."""
    return f"{difference:+.4f}", span(*interval, "+.4f"), "unknown" if film is None else f"{film:.2g}"


def _unknown(drawn: PairUncertainty) -> tuple[str, ...]:
    """Return a row of the page's table of what is not known of the sensors."""
    better, ends, metric = drawn.probability_a_better, drawn.difference.quantiles, drawn.metric
    form, judge = (".4f", "") if metric.is_delta_e else (".4g", f", {metric.words}{metric.unit and f' ({metric.unit})'}")
    return (
        f"{drawn.names[1]} − {drawn.names[0]}{judge}",
        str(better.draws),
        str(better),
        *(f"{ends[name]:+{form}}" for name in ("p05", "p50", "p95")),
        drawn.matters,
    )


def _settings(result: Comparison) -> Iterator[DocumentTable]:
    """Yield the settings of all sensors, then each sensor's own, then what each condition sets."""
    job, group, first = result.job, result.shown, result.sensors[0]
    coloured = any(sensor.case.settings.pixel.colour for sensor in result.sensors)
    times_s = [sensor.score.frame.integration_s for sensor in result.sensors]
    level = LightLevel.of(first.light.image, group.display, times_s)
    yield settings_table("scene", scene_rows(first.light.image, first.case.settings.scene, level))
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
