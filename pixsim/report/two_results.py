"""The document of two compared results: verdicts, differences and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.report.verdicts import draw_differences, pair_cells, pair_sentence
from pixsim.show.document import Answer, Document, DocumentTable, Fact, Strong
from pixsim.show.figures import literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.presenter import Presenter
from pixsim.studies.compare import ResultPairs, ResultsComparison
from pixsim.studies.paired import MIN_PAIRS


def results_document(result: ResultsComparison) -> Document:
    """Return the answer of `pixsim compare` of two folders: a sentence for each metric, and a table
    of all differences.
    """
    sentences = verdicts(result)
    if result.only_in_one:
        unpaired = [Fact(f"{result.only_in_one} rows are in only one of the results")]
    else:
        unpaired = []
    content = {
        "names": list(result.names),
        "verdicts": sentences,
        "differences": [_pair_data(pair) for pair in result.differences],
        "film_delta_e": result.film_delta_e,
        "only_in_one": result.only_in_one,
    }
    return Document(
        command="compare",
        kind="two results",
        title=" against ".join(result.names),
        data=result_data(content, settings={"folders": list(result.names)}, notes=[]),
        answers=[Answer((Strong(sentence),), named=True) for sentence in sentences],
        lead=(_differences_table(result), *unpaired),
    )


def results_csv(result: ResultsComparison) -> str:
    """Return a row for each metric and place as CSV."""
    rows = (_pair_data(pair) for pair in result.differences)
    return rows_csv(
        [{name: "" if value is None else value for name, value in row.items()} for row in rows]
    )


@figure(
    "differences",
    "Differences of the second result from the first one by the first metric, with 95 % intervals.",
)
def _differences_plate(result: ResultsComparison) -> Drawing:
    """Draw the difference by the first metric at each place."""
    metric = result.differences[0].pairs.metric
    differences = [pair for pair in result.differences if pair.pairs.metric.name == metric.name]
    labels = [
        ", ".join(f"{name} {value}" for name, value in pair.place.items()) for pair in differences
    ]
    pairs = [pair.pairs for pair in differences]
    drawing = new_figure(6.0, 0.8 + 0.4 * len(pairs))
    axes = drawing.add_subplot()
    draw_differences(axes, pairs, labels)
    axes.set_xlabel(literal(f"{metric.words}: {result.names[1]} − {result.names[0]}"))
    halves = [pair.half_width if pair.a.size >= MIN_PAIRS else np.nan for pair in pairs]
    return drawing, {
        "place": labels,
        "difference": [pair.difference for pair in pairs],
        "half_width": halves,
    }


def _pair_data(pair: ResultPairs) -> dict[str, Any]:
    """Return the numbers of a pair for JSON, without interval and probability for one pair of
    frames.
    """
    pairs = pair.pairs
    is_single = pairs.a.size < MIN_PAIRS
    return {
        **pair.place,
        "metric": pairs.metric.name,
        "pairs": pairs.a.size,
        "difference": pairs.difference,
        "interval": None if is_single else list(pairs.interval),
        "probability_a_better": None if is_single else pairs.probability_a_better,
    }


def verdicts(result: ResultsComparison) -> list[str]:
    """Return one sentence for each metric: which result is better, by how much; or at how many
    places.
    """
    by_metric: dict[str, list[ResultPairs]] = {}
    for pair in result.differences:
        by_metric.setdefault(pair.pairs.metric.name, []).append(pair)
    sentences = []
    for differences in by_metric.values():
        pairs = differences[0].pairs
        film = result.film_error_of(pairs.metric)
        signs = [pair.pairs.sign(film or 0.0) for pair in differences]
        counts = (signs.count(1), signs.count(-1), signs.count(0))
        first, other, neither = (f"{count} of {len(signs)}" for count in counts)
        places = (
            f"{result.names[0]} is better at {first} places, {result.names[1]} at {other}, neither"
            f" clearly at {neither}"
        )
        sentences.append(
            pair_sentence(pairs, film) if len(signs) == 1 else f"{pairs.metric.words}: {places}"
        )
    return sentences


def _differences_table(result: ResultsComparison) -> DocumentTable:
    """Return the table of all differences."""
    labels = list(dict.fromkeys(name for pair in result.differences for name in pair.place))
    first, other = result.names
    head = (
        *labels,
        "metric",
        f"{other} − {first}",
        "95 % interval",
        f"probability that {first} is better",
        "pairs",
    )
    rows = []
    for pair in result.differences:
        place = [str(pair.place.get(name, "")) for name in labels]
        film = result.film_error_of(pair.pairs.metric)
        rows.append(
            (*place, pair.pairs.metric.name, *pair_cells(pair.pairs, film), str(pair.pairs.a.size))
        )
    return DocumentTable("differences", head, rows, words=tuple(range(1, len(labels) + 1)))


PRESENTER = Presenter(document=results_document, figure=_differences_plate, csv=results_csv)
