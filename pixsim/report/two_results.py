"""Two results that are compared: what is said of them, and their numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pixsim.base.digits import difference_cells, probability, with_error
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.show.document import Answer, Block, Document, DocumentTable, Listed, Strong
from pixsim.show.figures import literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.presenter import Presenter
from pixsim.studies.compare import ResultPairs, ResultsComparison
from pixsim.studies.paired import FEWEST_PAIRS


def results_document(result: ResultsComparison) -> Document:
    """Return the answer of `pixsim compare` of two folders: a sentence for each metric, and all differences."""
    sentences = verdicts(result)
    return Document(
        command="compare",
        kind="two results",
        title=" against ".join(result.names),
        data=results_data(result, sentences),
        answers=[Answer((Strong(sentence),)) for sentence in sentences],
        lead=tuple(_facts(result)),
    )


def results_data(result: ResultsComparison, sentences: Sequence[str]) -> dict[str, Any]:
    """Return the JSON of two results.

    sentences : of `verdicts`
    """
    content = {
        "names": list(result.names),
        "verdicts": list(sentences),
        "differences": [pair_data(pair) for pair in result.differences],
        "only_in_one": result.only_in_one,
    }
    return result_data(content, settings={"folders": list(result.names)}, notes=[])


def results_csv(result: ResultsComparison) -> str:
    """Return a row for each metric and place as CSV."""
    rows = (pair_data(pair) for pair in result.differences)
    return rows_csv([{name: "" if value is None else value for name, value in row.items()} for row in rows])


@figure("differences", "Differences of the second result from the first one by the first metric, with 95 % intervals.")
def differences_plate(result: ResultsComparison) -> Drawing:
    """Draw the difference by the first metric at each place."""
    metric = result.differences[0].pairs.metric
    pairs = [pair for pair in result.differences if pair.pairs.metric.name == metric.name]
    differences = [pair.pairs.difference for pair in pairs]
    half_widths = [pair.pairs.half_width if pair.pairs.a.size >= FEWEST_PAIRS else np.nan for pair in pairs]
    labels = [", ".join(f"{name} {value}" for name, value in pair.place.items()) for pair in pairs]

    drawing = new_figure(6.0, 0.8 + 0.4 * len(pairs))
    axes = drawing.add_subplot()
    axes.errorbar(differences, range(len(pairs)), xerr=half_widths, fmt="D", capsize=4)
    axes.axvline(0.0, color="0.5", lw=0.8)
    axes.set_yticks(range(len(pairs)), [literal(label) for label in labels])
    axes.set_ylim(len(pairs) - 0.5, -0.5)
    axes.set_xlabel(literal(f"{metric.words}: {result.names[1]} − {result.names[0]}"))
    return drawing, {"place": labels, "difference": differences, "half_width": half_widths}


def pair_data(pair: ResultPairs) -> dict[str, Any]:
    """Return the numbers for JSON; those that one pair does not tell are None."""
    pairs = pair.pairs
    is_one = pairs.a.size < FEWEST_PAIRS
    return {
        **pair.place,
        "metric": pairs.metric.name,
        "pairs": pairs.a.size,
        "difference": pairs.difference,
        "interval": None if is_one else list(pairs.interval),
        "probability_a_better": None if is_one else pairs.probability_a_better,
    }


def verdicts(result: ResultsComparison) -> list[str]:
    """Return one sentence for each metric: which result is better, by how much, and at how many places."""
    by_metric: dict[str, list[ResultPairs]] = {}
    for pair in result.differences:
        by_metric.setdefault(pair.pairs.metric.name, []).append(pair)
    return [_sentence(pairs, result.names) for pairs in by_metric.values()]


def _facts(result: ResultsComparison) -> Iterator[Block]:
    """Yield a table of all differences, and what was not paired."""
    labels = list(dict.fromkeys(name for pair in result.differences for name in pair.place))
    first, other = result.names
    head = (*labels, "metric", f"{other} − {first}", "95 % interval", f"probability that {first} is better", "pairs")
    rows = []
    for pair in result.differences:
        row = pair_data(pair)
        is_one = row["interval"] is None
        difference, interval = f"{row['difference']:+.4g}", ""
        if not is_one:
            difference, interval = difference_cells(row["difference"], tuple(row["interval"]))
        chance = "" if is_one else probability(row["probability_a_better"], row["pairs"])
        values = [str(pair.place.get(name, "")) for name in labels]
        rows.append((*values, row["metric"], difference, interval, chance, str(row["pairs"])))
    yield DocumentTable("differences", head, rows, words=tuple(range(1, len(labels) + 1)))
    if result.only_in_one:
        yield Listed([f"{result.only_in_one} rows are in one of the results only"])


def _sentence(of_metric: list[ResultPairs], names: tuple[str, str]) -> str:
    """Return which of two results is better by a metric."""
    first, metric = of_metric[0].pairs, of_metric[0].pairs.metric
    words = "mean ΔE" if metric.is_delta_e else metric.words
    if len(of_metric) == 1:
        pairs = first
        if not pairs.differences.any():
            return f"{words}: {names[0]} and {names[1]} are the same in every pair of frames"
        unit = f" {metric.unit}" if metric.unit else ""
        better = names[0] if metric.worse_by(pairs.difference, 0.0) > 0 else names[1]
        if pairs.a.size < FEWEST_PAIRS:
            return f"{words}: {better} is better by {abs(pairs.difference):.4g}{unit} in one pair of frames"
        size = with_error(abs(pairs.difference), pairs.half_width)
        worse = names[1] if better == names[0] else names[0]
        if not of_metric[0].sign:
            return f"{words}: {names[0]} and {names[1]} cannot be told apart, {better} is better by {size}{unit}"
        return f"{words}: {better} is better than {worse} by {size}{unit}"
    signs = [each.sign for each in of_metric]
    counts = [f"{name} is better at {signs.count(sign)}" for sign, name in ((1, names[0]), (-1, names[1])) if sign in signs]
    return f"{words}: {', '.join(counts) or 'neither is surely better at any'} of {len(signs)} places"


PRESENTER = Presenter(document=results_document, figure=differences_plate, csv=results_csv)
