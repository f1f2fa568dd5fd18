"""A comparison of sensors: its document, and its output files: all of them, or none."""

from __future__ import annotations

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
from pixsim.base.files import check_replaceable
from pixsim.base.machine import processors
from pixsim.base.records import Record
from pixsim.base.toml import SETTINGS_FILE, settings_table_text, whole_path
from pixsim.light.curves import RESPONSES
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.run import colour_rows
from pixsim.report.settings import record_rows, scene_rows, settings_table
from pixsim.report.wording import DELTA_E, map_words
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.show.document import (
    Answer,
    Block,
    DeltaEScale,
    Document,
    Fact,
    Link,
    Listed,
    Map,
    Note,
    Pictures,
    Section,
    Slider,
    Strong,
    Table,
)
from pixsim.show.pictures import Picture, delta_e_png, display_codes, factor_for, light_png, reduced, scale, scale_end, worst_window
from pixsim.show.render import PAGE
from pixsim.show.sentences import rounded, setting_value, span
from pixsim.studies.averages import Averaged, Compared
from pixsim.studies.comparison import Comparison
from pixsim.studies.comparison_cases import ComparedCases
from pixsim.studies.condition import Condition
from pixsim.studies.cost import PAGE_S, START_S, Cost, frame_cost, render_bytes, render_seconds
from pixsim.studies.light_level import LightLevel
from pixsim.studies.lineup import OF_A_SENSOR, SHARED, ComparisonJob, Lineup, pixels_of
from pixsim.studies.pair_uncertainty import PairUncertainty
from pixsim.studies.sensor_types import TYPES_FILE
from pixsim.studies.settings_text import scene_table, settings_text
from pixsim.studies.study_settings import Study
from pixsim.studies.uncertainty import FEW_SENSORS
from pixsim.studies.varied import paths_of
from pixsim.studies.verdicts import answers, conditions_line, facts, sensor_words, shown_probability
from pixsim.viewer.develop_options import TONE_CURVES
from pixsim.viewer.setting import Run

JSON_FILE = "compare.json"
ROWS_FILES = {
    "results.csv": "mean ΔE of each frame, with which an interrupted comparison goes on",
    TYPES_FILE: "the same of the sensor types of --uncertainty",
}


def comparison_outline(prepared: ComparisonJob) -> dict[str, Any]:
    """Return what a comparison would do, with an estimate of time and memory; nothing is rendered or written."""
    lineup = prepared.shown
    first = lineup.cases[0]
    lineups = dict.fromkeys(each for group in (prepared.lineups, *prepared.pairs) for each in group)
    repeats = prepared.repeats + (0 if prepared.types is None else FEW_SENSORS * len(prepared.types.sample.quantiles))
    costs = [_cost_of(each, repeats) for each in lineups]
    cost = Cost(
        renders=sum(each.renders for each in costs),
        evaluations=sum(each.evaluations for each in costs),
        seconds=START_S + PAGE_S + sum(each.seconds for each in costs),
        memory_bytes=max(each.memory_bytes for each in costs),
        jobs=1,
    )
    scene = first.scene.with_resolution(lineup.film_width)
    more = prepared.of_study
    if prepared.types is not None:
        more["uncertainty"] = {"draws": len(prepared.types.sample.quantiles), "inputs": list(prepared.types.sample.inputs)}
    return more | {
        "scene": lineup.scene,
        "match": prepared.match,
        "repeats": prepared.repeats,
        **lineup.as_dict(),
        "film": {"samples": list(scene.film_shape(first.camera, scene.for_camera(first.camera)))},
        "display": lineup.settings.display.model_dump(),
        "sensors": {
            sensor.name: {
                "camera": sensor.camera.model_dump(),
                "fov_deg": sensor.camera.fov_deg,
                "pixels": list(pixels_of(sensor)),
                "pixel": sensor.settings.pixel.model_dump(),
            }
            for sensor in lineup.cases
        },
        "estimate": asdict(cost),
    }


def _cost_of(lineup: Lineup, repeats: int) -> Cost:
    """Estimate the renders and frames of the sensors under one condition."""
    seconds, largest = 0.0, 0.0
    for sensor in lineup.cases:
        demand = lineup.demand(sensor, lineup.film_width)
        frame = frame_cost(sensor.camera, sensor.settings.pixel.pitch_um, *lineup.different_displays)
        cores = processors().usable
        seconds += render_seconds(demand.plan, demand.shape, cores) + repeats * frame.seconds / cores
        largest = max(largest, render_bytes(demand.plan, demand.shape) + frame.memory_bytes)
    return Cost(len(lineup.cases), repeats * len(lineup.cases), seconds, largest, 1)


def comparison_outline_document(places: Sequence[tuple[ComparisonJob, Path]], has_cases: bool) -> Document:
    """Return the answer of a dry run.

    places : what is prepared, and the folder that would be written
    has_cases : whether they are cases of a comparison
    """
    shown = [comparison_outline(prepared) for prepared, _ in places]
    blocks = [block for (prepared, out), own in zip(places, shown, strict=True) for block in _outline_blocks(prepared, own, out)]
    return Document("compare", "dry run", shown[0]["scene"], {"cases": shown} if has_cases else shown[0], lead=blocks)


def _outline_blocks(prepared: ComparisonJob, shown: dict[str, Any], out: Path) -> Iterator[Block]:
    """Yield what a comparison would do."""
    lineup, (height, across) = prepared.shown, shown["film"]["samples"]
    yield Table("sensors", (), [(sensor.name, sensor_words(sensor)) for sensor in lineup.cases], words=None)
    yield Fact(conditions_line(prepared))
    yield Fact(f"film of {across} × {height} samples for all{f', in {lineup.condition}' if prepared.conditions else ''}")
    if "uncertainty" in shown:
        yield Fact(f"{shown['uncertainty']['draws']} sensor types, over {', '.join(shown['uncertainty']['inputs'])}")
    yield Fact("the film's error is measured by the renders and part of each ±; render noise stands beside the answer if too large")
    yield Fact(f"{out}: nothing is written now")
    yield Fact(f"cost: {Cost(**shown['estimate'])}")


# --- files ------------------------------------------------------------------------------------------------------------------------


def comparison_files(prepared: ComparisonJob) -> dict[str, str]:
    """Return the names of all files of a comparison, with their descriptions; provenance.json comes with them."""
    files = {
        JSON_FILE: "all numbers and settings, for programs",
        SETTINGS_FILE: "settings of all sensors; its first lines have the command that makes the same numbers again",
    }
    for sensor in prepared.shown.cases:
        files |= {
            f"sensors/{sensor.name}.toml": f"pixel, camera and exposure of {sensor.name}, as its file and the options have them",
            f"pictures/image_{sensor.name}.png": f"image of {sensor.name}, as shown",
            f"pictures/ideal_{sensor.name}.png": f"image of an ideal camera with the response of {sensor.name}",
            f"pictures/delta_e_{sensor.name}.png": f"S-CIELAB ΔE map of {sensor.name}, with axes",
        }
    return files


def check_output(prepared: ComparisonJob, folder: str | os.PathLike[str]) -> None:
    """Raise PixsimError if the folder holds a file of a comparison's name that pixsim did not write."""
    check_replaceable(folder, {PAGE, *comparison_files(prepared)})


def settings_files(prepared: ComparisonJob) -> dict[str, str]:
    """Return settings.toml and a file for each sensor, as name -> text; their command makes the same numbers again.

    They state what was stated, and leave open what pixsim chose, such as a display: the command chooses the same again.
    """
    files = [f"sensors/{sensor.name}.toml" for sensor in prepared.shown.cases]
    words = ["pixsim", "compare", *files]
    words += [] if prepared.conditions else ["--scene", whole_path(prepared.shown.scene)]
    words += ["--study" if prepared.conditions else "--config", SETTINGS_FILE]
    words += ["--match", prepared.match, "--repeats", str(prepared.repeats)]
    words += [] if prepared.types is None else ["--uncertainty", str(prepared.types.asked)]
    for option, value in (("--sensor", prepared.shown.sensor), ("--variant", prepared.shown.variant)):
        words += [option, value] if value else []
    command = shlex.join(words)
    if prepared.conditions and prepared.study is not None:
        texts = {SETTINGS_FILE: settings_table_text(_study_table(prepared, prepared.study), command)}
    else:
        first = prepared.base[0]
        chosen = {"dots"} - first.display.model_fields_set
        scene = scene_table(prepared.shown.cases[0].scene.path.parent, first.scene)
        display = first.display.model_dump(mode="json", exclude_none=True, exclude=chosen)
        text = settings_text(first, command, scene=scene, display=display, camera={}, lens={}, pixel={}, exposure={})
        texts = {SETTINGS_FILE: text}
    spreads = [{}] * len(files) if prepared.types is None else prepared.types.spreads
    for file, own, spread in zip(files, prepared.base, spreads, strict=True):
        texts[file] = settings_text(own, f"(in the folder above) {command}", {"": spread}, **_all_but_sensor(own))
    return texts


def _all_but_sensor(own: Run) -> dict[str, Any]:
    """Return empty tables in place of all that is not a sensor's own."""
    return {name: {} for name in type(own).model_fields if name not in OF_A_SENSOR}


def _study_table(prepared: ComparisonJob, study: Study) -> dict[str, Any]:
    """Return the tables of a study that makes the same conditions: what all sensors share, and the conditions."""
    first = prepared.base[0]
    shared = first.model_dump(mode="json", exclude_unset=True, include=set(SHARED) - set(OF_A_SENSOR))
    scenes = [part.cases[0].scene.path.parent for part in prepared.conditions]
    scene = {"file": whole_path(study.scene.file), "parameters": scene_table(scenes[0], first.scene)}
    conditions = [
        condition.model_dump(mode="json") | {"set": _whole_settings(condition, folder)}
        for condition, folder in zip(study.condition, scenes, strict=True)
    ]
    return {"name": study.name} | shared | {"scene": scene, "condition": conditions}


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
    """Return the answer of `pixsim compare` for one case, without the sections of its page and other files.

    warned : notes that a reader of the terminal has seen
    """
    return Document(
        command="compare",
        kind="comparison of sensors",
        title=" against ".join(result.names),
        data=result.as_dict(),
        answers=answers(result),
        lead=(*facts(result), *(Note(note) for note in result.notes if note not in warned)),
        about=(f"{DELTA_E} The mean over the picture is compared.",),
        data_file=JSON_FILE,
        sources=[Path(sensor.file) for sensor in result.prepared.shown.cases],
    )


def comparison_page(result: Comparison, folder: str | os.PathLike[str]) -> Document:
    """Return the document of a comparison with its page and all other files.

    folder : that will be written, which may hold `ROWS_FILES`
    """
    end = scale_end(max(compared.score.statistics()["p99_delta_e"] for compared in result.sensors))
    pictures = dict[str, bytes]()
    for each in result.sensors:
        score, where = each.score, picture_axes(each.irradiance, each.score.border_um)
        pictures[f"pictures/image_{each.name}.png"] = light_png(score.image)
        pictures[f"pictures/ideal_{each.name}.png"] = light_png(score.ideal)
        pictures[f"pictures/delta_e_{each.name}.png"] = delta_e_png(score.delta_e, where, end)
    rows_files = [name for name in ROWS_FILES if Path(folder, name).is_file()]
    sections = _sections(result, pictures, end, rows_files)
    return replace(comparison_document(result), sections=sections, files={**pictures, **settings_files(result.prepared)})


PAIRED = (
    "Intervals and probabilities are those of Student's t for {} pairs of frames, each of another pair of individual sensors. They "
    "tell how sure the simulation is of the mean ΔE of a sensor type, not how often one frame is better than another. The error "
    "that the film's samples may cause is the same in every frame: it is stated beside them, and it is a part of each ±."
)
UNKNOWN_TYPES = (
    "Sensor types are drawn from the ranges of the technologies and from [pixel.uncertainty] of the data sheets. All have the same "
    "random numbers; the film's error is not in these numbers."
)
MATRIX = (
    "The matrix leads from the channels to the display's light. The larger its noise gains, the more of a sensor's noise is seen "
    "as colour."
)
DETAIL = "The detail where the errors of the sensors differ most: the ideal image, the sensor's picture, and its errors."
CASES = (
    "Each case is a comparison of its own, with its own display and film. Neither sensor is called better where that depends on "
    "the display."
)


def _sections(result: Comparison, pngs: Mapping[str, bytes], end: float, rows_files: Sequence[str]) -> Iterator[Section]:
    """Yield the sections of the page.

    pngs : name -> picture
    end : of the colour scale of the ΔE maps
    rows_files : of `ROWS_FILES`, those that are there
    """
    prepared, shown, names = result.prepared, result.shown, result.names
    lineup, first, in_shown = shown.lineup, shown.sensors[0], Averaged(((1.0, shown),))
    where = f" in {lineup.condition}" if result.conditions else ""
    maps = [compared.score.delta_e for compared in result.sensors]
    window = worst_window([np.abs(other - maps[0]) for other in maps[1:]])
    better = f"probability that {names[0]} is better"
    pair_head = ("difference of mean ΔE", "mean", "95 % interval", better, "film's error, at most")
    others, of = names[1:], "the detail with the largest differences"
    yield Section("conditions", "Conditions", _condition_blocks(result, pair_head) if result.conditions else ())
    pictures = [_picture(compared.score.image, compared.name) for compared in result.sensors]
    slider = Slider(
        *("slider", f"The whole picture of {names[0]} and of another", pictures[0]),
        (*pictures[1:], _picture(first.score.ideal, "ideal image")),
        *(f"the picture of {names[0]}", "the chosen picture"),
    )
    sizes = size_words(factor_for(first.score.image), lineup.settings.display.samples_per_deg)
    yield Section("pictures", "Pictures", (sizes, slider), together=True)
    details = [
        Section("", each.name, (Pictures((crops(each.score, window, f"the picture of {each.name}", end),), of),))
        for each in result.sensors
    ]
    yield Section("detail", "The largest differences, 1:1", (DETAIL, *details, DeltaEScale(scale(end))), together=True)
    head = (
        *("sensor", "mean ΔE", "99th percentile", "pixels", "pitch (µm)", "lens", "exposure (ms)", "mean electrons", "full well"),
        *("saturated", "film's error (ΔE)"),
    )
    sensors = [_row(compared, in_shown.shown_mean(compared.name)) for compared in shown.sensors]
    pairs = Table("differences of mean ΔE", pair_head, [_pair(result, other) for other in others])
    of_sensors = Table("numbers of each sensor", head, sensors)
    words = PAIRED.format(prepared.repeats)
    yield Section("numbers", f"Numbers{where}", [of_sensors, words] if result.conditions else [of_sensors, pairs, words])
    types = ("difference of mean ΔE", "sensor types", f"{better} (95 % interval)", "5 %", "median", "95 %", "unknown")
    unknown = Table("differences over sensor types", types, map(_unknown, result.uncertainty), words=(6,))
    yield Section("unknown", "What is not known of the sensors", [UNKNOWN_TYPES, unknown] if result.uncertainty else ())
    yield Section("displays", "Displays", _display_blocks(result))
    colours = [(c.name, colour_rows(c.colour, c.score.out_of_gamut)) for c in shown.sensors if c.colour]
    tables = [Table(f"colours of {name}", (), rows, name, words=None) for name, rows in colours]
    yield Section("colour", f"Colour{where}", [MATRIX, *tables] if tables else ())
    yield Section("maps", "Maps of the errors", [_map(compared, pngs, end) for compared in result.sensors])
    rest = f"Noise and non-uniformities that a data sheet does not state are zero. Seed {lineup.settings.seed}."
    yield Section("settings", "Settings", [*_settings(result), rest])
    files = comparison_files(prepared) | {name: words for name, words in ROWS_FILES.items() if name in rows_files}
    listed = [(Link(name, name), f": {words}") for name, words in (files | {"provenance.json": "versions and wall times"}).items()]
    yield Section("files", "Files in this folder", [Listed(listed)])


def _condition_blocks(result: Comparison, pair_head: tuple[str, ...]) -> Iterator[Block]:
    """Yield mean ΔE of each sensor and differences in each condition, then of the weighted mean."""
    others = result.names[1:]
    parts: list[tuple[str, str, Averaged, list[tuple[str, ...]]]] = []
    for number, (lineup, part) in enumerate(zip(result.prepared.conditions, result.conditions, strict=True)):
        pairs = [_pair(result.pair(other).conditions[number], other) for other in others]
        parts.append((lineup.condition, f"{lineup.weight:.3g}", part, pairs))
    parts.append(("weighted mean", "", result, [_pair(result, other) for other in others]))
    means = [(name, weight, *(part.shown_mean(sensor) for sensor in part.names)) for name, weight, part, _ in parts]
    head = ("condition", "weight")
    yield Table("mean ΔE of each sensor in each condition", (*head, *(f"mean ΔE of {name}" for name in result.names)), means)
    differences = [(name, weight, *pair) for name, weight, _, pairs in parts for pair in pairs]
    yield Table("differences in each condition", (*head, *pair_head), differences)
    yield (
        "Frame number k has the same random seeds in all conditions. The weighted mean is taken of each frame number, before its "
        "interval. The pictures, numbers and maps below are those of the condition ",
        Strong(result.shown.lineup.condition),
        ".",
    )


def _display_blocks(result: Comparison) -> Iterator[Block]:
    """Yield the differences on each display."""
    names = result.names
    mean = "; the weighted mean over the conditions" if result.conditions else ""
    yield (
        "Frames do not depend on the display. The same frames are scored on the stated display, and on displays with half and with "
        f"twice its dots{mean}. Which sensor is better depends on the display where it is another one there."
    )
    head = ("dots across", "width of the picture", "difference of mean ΔE", "95 % interval", "film's error, at most", "better")
    for other in names[1:]:
        name = f"{other} − {names[0]}"
        yield Table(f"difference on each display: {name}", head, _display_rows(result, other), name, words=(5,))


def cases_document(result: ComparedCases) -> Document:
    """Return the answer of `pixsim compare` over the values of axes: that of each case is in its folder."""
    rows = [((Link(case.words or case.folder, f"{case.folder}/{PAGE}"),), words) for case, own in result.answers for words in own]
    table = Table("the answer in each case", ("case", "answer"), rows, words=None)
    return Document(
        command="compare",
        kind="comparison of sensors",
        title=" against ".join(result.names),
        data=result.as_dict(),
        answers=[Answer((Strong(line),), named=line.startswith(result.names)) for line in map(result.headline, result.names[1:])],
        about=(CASES,),
        sections=(Section("cases", "Cases", (table,), brief=True),),
        data_file=JSON_FILE,
    )


def _picture(luminance: Array, name: str) -> Picture:
    return Picture(display_codes(reduced(luminance)), name)


def _map(compared: Compared, pngs: Mapping[str, bytes], end: float) -> Map:
    """Return the ΔE map of a sensor."""
    found = compared.score.statistics()
    words = map_words(f"{compared.name}, first frame: ", found["mean_delta_e"], found["p99_delta_e"], end)
    return Map(pngs[f"pictures/delta_e_{compared.name}.png"], words)


def _row(compared: Compared, mean: str) -> tuple[str, ...]:
    """Return a sensor's row of the page's table of numbers.

    mean : its mean ΔE
    """
    statistics = compared.score.statistics()
    (rows, columns), pixel = pixels_of(compared.sensor), compared.sensor.settings.pixel
    return (
        compared.name,
        mean,
        f"{statistics['p99_delta_e']:.3g}",
        f"{columns} × {rows}",
        f"{pixel.pitch_um:g}",
        compared.sensor.camera.lens_words,
        f"{1e3 * statistics['integration_s']:.3g}",
        rounded(statistics["mean_electrons_e"], 4),
        rounded(statistics["full_well_e"], 4),
        f"{100 * statistics['saturated_fraction']:.2g} %",
        "unknown" if compared.film_delta_e is None else f"{compared.film_delta_e:.1g}",
    )


def _pair(result: Averaged, other: str) -> tuple[str, ...]:
    """Return a row of the page's table of differences."""
    film, better = result.film_delta_e[other], shown_probability(result.probability_a_better[other])
    mean, interval, error = difference_cells(result.difference[other], result.interval_delta_e[other], film)
    return f"{other} − {result.names[0]}", mean, interval, better, error


def difference_cells(difference: float, interval: tuple[float, float], film: float | None) -> tuple[str, str, str]:
    """Return a difference, its 95 % interval, and the largest error that the film may cause."""
    return f"{difference:+.4f}", span(*interval, "+.4f"), "unknown" if film is None else f"{film:.2g}"


def _unknown(found: PairUncertainty) -> tuple[str, ...]:
    """Return a row of the page's table of what is not known of the sensors."""
    better, ends, metric = found.probability_a_better, found.difference.quantiles, found.metric
    form, judge = (".4f", "") if metric.is_delta_e else (".4g", f", {metric.words}{metric.unit and f' ({metric.unit})'}")
    return (
        f"{found.names[1]} − {found.names[0]}{judge}",
        str(better.draws),
        str(better),
        *(f"{ends[name]:+{form}}" for name in ("p05", "p50", "p95")),
        found.matters,
    )


def _display_rows(result: Comparison, other: str) -> list[tuple[str, ...]]:
    """Return the rows of the page's table of a difference on each display."""
    better = {1: result.names[0], -1: other, 0: "not told apart"}
    samples_per_deg = result.shown.lineup.settings.display.samples_per_deg
    rows: list[tuple[str, ...]] = []
    for difference in result.display_differences(other):
        numbers = difference_cells(difference.difference, difference.interval_delta_e, difference.film_delta_e)
        words = "hidden by the film's error" if difference.is_hidden_by_film else better[difference.sign]
        rows.append((str(difference.dots), f"{difference.dots / samples_per_deg:.3g}°", *numbers, words))
    return rows


def _settings(result: Comparison) -> Iterator[Table]:
    """Yield the settings of all sensors, then each sensor's own, then what each condition sets."""
    prepared, lineup, first = result.prepared, result.shown.lineup, result.shown.sensors[0]
    display, coloured = lineup.settings.display, any(compared.sensor.settings.pixel.colour for compared in result.sensors)
    light = LightLevel.of(first.irradiance, display, [compared.score.frame.integration_s for compared in result.sensors])
    yield settings_table("scene", scene_rows(first.irradiance, first.sensor.settings.scene, light))
    yield settings_table("display", record_rows("display", display, False, coloured=coloured))
    if coloured or lineup.settings.develop.words:
        yield settings_table("develop", record_rows("develop", lineup.settings.develop, False, coloured=coloured))
    for compared in result.sensors:
        sensor = compared.sensor
        pixel, exposure = sensor.settings.pixel, sensor.settings.exposure
        sheet = pixel.technology == NO_TECHNOLOGY
        records: dict[str, Record] = {"camera": sensor.camera, "pixel": pixel, "exposure": exposure}
        for name, record in records.items():
            yield settings_table(f"{sensor.name}: {name}", record_rows(name, record, sheet))
    for each in () if prepared.study is None else prepared.study.condition:
        values = [(path, reduce(getitem, path, each.set)) for path in paths_of(each.set)]
        rows = [(".".join(path), setting_value(value, path[-1]), "", "set") for path, value in values]
        yield settings_table(f"condition {each.name}", rows)
