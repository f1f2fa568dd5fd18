"""The document of two compared results: verdicts, pictures of two runs with a wipe between them,
differences, and the settings that differ.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import UNKNOWN, estimate, rounded, with_error
from pixsim.base.errors import one_line
from pixsim.base.files import FILE_LIST
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.report.outline import outline_document, run_outline
from pixsim.report.pictures import whole_picture
from pixsim.report.run import STATISTICS_WORDS, RunFiles, run_page
from pixsim.report.verdicts import draw_differences, pair_cells, pair_sentence
from pixsim.report.wording import DELTA_E as DELTA_E_WORDS
from pixsim.sensor.labels import file_label
from pixsim.show.document import Answer, Block, Document, DocumentTable, Fact, Link, Slider, Strong
from pixsim.show.figures import literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.pictures import light_of_png
from pixsim.show.presenter import Presenter
from pixsim.show.render import PAGE
from pixsim.show.sentences import setting_value
from pixsim.studies.paired import Pairs
from pixsim.studies.prepare import Job
from pixsim.studies.two_results import PlacedDifference, ResultsComparison, Source, StoredResult
from pixsim.viewer.metrics import PIXEL_STATISTICS, Metric
from pixsim.viewer.setting import Run

DATA_FILE = "summary.json"
_MAX_VALUE = 200  # characters of a setting's value
_PLURALS = {"run": "runs", "study": "studies", "comparison": "comparisons"}


def results_document(result: ResultsComparison) -> Document:
    """Return the answer of `pixsim compare` of two results: a sentence for each metric, and tables
    of all differences and of the settings that differ.
    """
    sentences = verdicts(result)
    content = {
        "names": list(result.names),
        "verdicts": sentences,
        "differences": [_difference_data(placed) for placed in result.differences],
        "light_delta_e": result.light_delta_e,
        "different_settings": {
            name: list(values) for name, values in result.different_settings.items()
        },
        "only_in_one": result.only_in_one,
    }
    frames = _frames_rows(result) if result.a.kind == "run" else []
    head = ("mean of the frames", *result.names)
    frames_tables = [DocumentTable("frames", head, frames, stacks=True)] if frames else []
    return Document(
        command="compare",
        kind=f"two {_PLURALS[result.a.kind]}",
        title=" against ".join(result.names),
        data=result_data(content, settings={"results": list(result.names)}, notes=[]),
        answers=[Answer((Strong(sentence),), named=True) for sentence in sentences],
        lead=(
            _differences_table(result),
            *_facts(result),
            *_settings_that_differ(result),
            *frames_tables,
        ),
        about=(DELTA_E_WORDS,) if "delta_e" in result.a.metrics else (),
        data_file=DATA_FILE,
    )


def results_page(result: ResultsComparison, raw_suffixes: Sequence[str] = ()) -> Document:
    """Return the document of two results with its page, and with the pages and files of runs that
    were made for it.

    raw_suffixes : further formats of the raw frames of these runs
    """
    document = results_document(result)
    files = RunFiles(raw_suffixes=tuple(raw_suffixes))
    parts: dict[str, Document] = {}
    links: list[Block] = []
    for stored in (result.a, result.b):
        if stored.run is not None:
            folder = folder_name(stored.name)
            parts[folder] = run_page(stored.run, files)
            links.append(Fact((Link(f"the page of {stored.name}", f"{folder}/{PAGE}"),)))
    sliders = [_slider(result)] if result.a.kind == "run" else []
    return replace(document, lead=(*sliders, *document.lead, *links), parts=parts)


def results_file_names(jobs: Mapping[str, Job[Run]], raw_suffixes: Sequence[str]) -> set[str]:
    """Return the names of all files of a comparison of two results but the list of them.

    jobs : of runs that are made, by their names
    """
    files = RunFiles(raw_suffixes=tuple(raw_suffixes))
    runs = {f"{folder_name(name)}/{file}" for name in jobs for file in files.names(1)}
    return {PAGE, DATA_FILE} | {file for file in runs if not file.endswith(f"/{FILE_LIST}")}


def results_outline_document(
    sources: Mapping[str, Source], jobs: Mapping[str, Job[Run]], out: Path
) -> Document:
    """Return the answer of a dry run: what would be run of two results.

    jobs : of runs that are made, by their names
    out : folder that would be written
    """
    outlines = {name: run_outline(job) for name, job in jobs.items()}
    lines: list[Block] = []
    for name, outline in outlines.items():
        lines += [Fact(name), *outline_document("run", outline, out / folder_name(name)).terminal]
    lines += [Fact(f"{name}: a result that exists") for name in sources if name not in jobs]
    return Document("compare", "dry run", " against ".join(sources), outlines, lines)


def folder_name(name: str) -> str:
    """Return a name of a result as that of a folder."""
    return file_label(name).replace("/", "-")


def _results_csv(result: ResultsComparison) -> str:
    """Return a row for each metric and place as CSV."""
    rows = (_difference_data(placed) for placed in result.differences)
    return rows_csv(
        [{name: "" if value is None else value for name, value in row.items()} for row in rows]
    )


@figure(
    "differences",
    "Differences of the second result from the first one by the first metric, with 95 % intervals.",
)
def _differences_plate(result: ResultsComparison) -> Drawing:
    """Draw the difference by the first metric at each place."""
    metric = result.differences[0].difference.metric
    placed_differences = [
        placed for placed in result.differences if placed.difference.metric.name == metric.name
    ]
    labels = [
        ", ".join(f"{name} {value}" for name, value in placed.place.items())
        for placed in placed_differences
    ]
    differences = [placed.difference for placed in placed_differences]
    drawing = new_figure(6.0, 0.8 + 0.4 * len(differences))
    axes = drawing.add_subplot()
    draw_differences(axes, differences, labels)
    axes.set_xlabel(literal(f"{metric.words}: {result.names[1]} − {result.names[0]}"))
    halves = [
        difference.half_width if difference.has_interval else np.nan for difference in differences
    ]
    return drawing, {
        "place": labels,
        "difference": [difference.difference for difference in differences],
        "half_width": halves,
    }


# --- the answer, and numbers for programs


def _difference_data(placed: PlacedDifference) -> dict[str, Any]:
    """Return the numbers of a difference for JSON: of single frames without an interval, of frames
    that are no pairs without a probability.
    """
    difference = placed.difference
    has_interval = difference.has_interval
    return {
        **placed.place,
        "metric": difference.metric.name,
        "a": float(difference.a.mean()),
        "b": float(difference.b.mean()),
        "pairs": difference.a.size if isinstance(difference, Pairs) else None,
        "difference": difference.difference,
        "interval": list(difference.interval) if has_interval else None,
        "probability_a_better": difference.probability_a_better if has_interval else None,
    }


def verdicts(result: ResultsComparison) -> list[str]:
    """Return one sentence for each metric: which result is better, by how much; or at how many
    places.
    """
    by_metric: dict[str, list[PlacedDifference]] = {}
    for placed in result.differences:
        by_metric.setdefault(placed.difference.metric.name, []).append(placed)
    sentences = []
    for placed_differences in by_metric.values():
        difference = placed_differences[0].difference
        error = result.light_error_of(difference.metric)
        signs = [placed.difference.sign(error or 0.0) for placed in placed_differences]
        counts = (signs.count(1), signs.count(-1), signs.count(0))
        first, other, neither = (f"{count} of {len(signs)}" for count in counts)
        places = (
            f"{result.names[0]} is better at {first} places, {result.names[1]} at {other}, neither"
            f" clearly at {neither}"
        )
        sentences.append(
            pair_sentence(difference, error)
            if len(signs) == 1
            else f"{difference.metric.words}: {places}"
        )
    return sentences


# --- tables and pictures


def _slider(result: ResultsComparison) -> Slider:
    """Return the slider with the picture of the first run on the left, and that of the other one,
    or an ideal image, on the right.
    """
    first, other = result.names
    images = [_light_of(stored, "image") for stored in (result.a, result.b)]
    ideals = [_light_of(stored, "ideal") for stored in (result.a, result.b)]
    pictures = [whole_picture(images[1], other)]
    if np.array_equal(ideals[0], ideals[1]):
        pictures.append(whole_picture(ideals[0], "ideal image"))
    else:
        pictures += [
            whole_picture(ideal, f"ideal image of {name}")
            for ideal, name in zip(ideals, result.names, strict=True)
        ]
    left = whole_picture(images[0], first)
    return Slider(
        "slider", "", left, tuple(pictures), f"the picture of {first}", "the chosen picture"
    )


def _light_of(stored: StoredResult, name: str) -> Array:
    """Return a picture of a run: its image, or the ideal one."""
    if stored.run is not None:
        return np.asarray(getattr(stored.run.score, name))
    assert stored.path is not None
    return light_of_png(stored.path / f"{name}.png")


def _differences_table(result: ResultsComparison) -> DocumentTable:
    """Return the table of the metrics of both results, with all differences."""
    labels = list(dict.fromkeys(name for placed in result.differences for name in placed.place))
    first, other = result.names
    head = (
        *labels,
        "metric",
        first,
        other,
        f"{other} − {first}",
        "95 % interval",
        f"probability that {first} is better",
        "frames",
    )
    rows = []
    for placed in result.differences:
        difference = placed.difference
        cells = pair_cells(difference, result.light_error_of(difference.metric))
        values = [
            _mean_cell(stored, difference.metric, numbers)
            for stored, numbers in ((result.a, difference.a), (result.b, difference.b))
        ]
        frames = f"{difference.a.size} and {difference.b.size}"
        if isinstance(difference, Pairs):
            frames = f"{difference.a.size} pair{'s' * (difference.a.size > 1)}"
        place = [str(placed.place.get(name, "")) for name in labels]
        rows.append((*place, _metric_label(difference.metric), *values, *cells, frames))
    rows += _rows_of_one(result, len(head) - 3)

    # Single frames have no intervals, and frames that are no pairs no probabilities.
    columns = [number for number in range(len(head)) if any(row[number] for row in rows)]
    return DocumentTable(
        "metrics",
        [head[number] for number in columns],
        [tuple(row[number] for number in columns) for row in rows],
        words=tuple(range(1, len(labels) + 1)),
    )


def _rows_of_one(result: ResultsComparison, empty: int) -> Iterator[tuple[str, ...]]:
    """Yield a row of the table for each metric that only one of two runs has.

    empty : number of cells after the values
    """
    if result.a.kind != "run":
        return
    for metric in {**result.a.metrics, **result.b.metrics}.values():
        if metric.name not in result.a.metrics or metric.name not in result.b.metrics:
            values = [_run_mean(stored, metric) for stored in (result.a, result.b)]
            yield (_metric_label(metric), *values, *[""] * empty)


def _run_mean(stored: StoredResult, metric: Metric) -> str:
    """Return the mean of a metric of a run, with half of its 95 % interval; a dash without one."""
    if metric.name not in stored.metrics:
        return UNKNOWN
    column = metric.columns[0]
    return _mean_cell(stored, metric, np.array([row[column] for row in stored.rows.values()]))


def _mean_cell(stored: StoredResult, metric: Metric, values: Array) -> str:
    """Return the mean of a metric, with half of its 95 % interval where it has one."""
    mean = float(values.mean())
    half = stored.half_width(metric, values)
    return estimate(mean) if math.isnan(half) else with_error(mean, half)


def _metric_label(metric: Metric) -> str:
    return f"{metric.name} ({metric.unit})" if metric.unit else metric.name


def _frames_rows(result: ResultsComparison) -> list[tuple[str, str, str]]:
    """Return the numbers of two runs' frames that differ, as means: exposure, electrons, …"""
    rows = []
    for name in PIXEL_STATISTICS:
        first, other = (
            rounded(float(np.mean([row[name] for row in stored.rows.values()])), 4)
            for stored in (result.a, result.b)
        )
        if first != other:
            rows.append((STATISTICS_WORDS[name], first, other))
    return rows


def _settings_that_differ(result: ResultsComparison) -> Iterator[Block]:
    """Yield the table of the settings that differ, or that none does."""
    different = result.different_settings
    if not different:
        yield Fact("all settings are the same")
        return
    rows = [
        (one_line(name, _MAX_VALUE), *_setting_texts(name.rpartition(".")[2], values))
        for name, values in different.items()
    ]
    head = ("setting that differs", *result.names)
    yield DocumentTable("settings that differ", head, rows, words=None, stacks=True)


def _setting_texts(name: str, values: tuple[Any, Any]) -> list[str]:
    """Return the values of a setting in words: files without their folders, unless only these
    differ.

    name : of the setting, without its table
    """
    files = [
        Path(value).name if isinstance(value, str) and os.sep in value else value
        for value in values
    ]
    return [_setting_text(name, value) for value in (values if files[0] == files[1] else files)]


def _setting_text(name: str, value: Any) -> str:
    if value is None:
        return "not stated"
    if isinstance(value, list) and all(isinstance(part, str) for part in value):
        value = ", ".join(value)
    return one_line(str(setting_value(value, name)), _MAX_VALUE)


def _facts(result: ResultsComparison) -> Iterator[Fact]:
    """Yield what a reader should know of the differences: of their frames and their light."""
    difference = result.differences[0].difference
    if not difference.has_interval:
        yield Fact("single frames have no interval: more sensors of each have (--repeats 8)")
    else:
        frames = "the frames are pairs with the same random numbers: ± is the 95 % interval"
        if not isinstance(difference, Pairs):
            frames = (
                "the random numbers differ, so that the frames are no pairs: ± of a difference is"
                " the root of the sum of the squares of both 95 % intervals"
            )
        error = result.light_delta_e
        light = "an unknown error of it" if error is None else f"{estimate(error, 2)} at most"
        yield Fact(f"{frames}; the sentence on ΔE adds the errors of the light, {light}")
    if not result.sees_one_light:
        yield Fact(f"the light differs: ΔE is against the ideal image of the same {result.a.kind}")
    if result.only_in_one:
        yield Fact(f"{result.only_in_one} rows are in only one of the results")


PRESENTER = Presenter(
    document=results_document,
    figure=_differences_plate,
    csv=_results_csv,
    page=lambda result, _: results_page(result),
)
