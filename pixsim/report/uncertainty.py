"""The document of what is not known: the distribution of each optimum over sensor types, and which inputs matter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from pixsim.show.document import Answer, Block, Document, Fact, Link, Listed, Plot, Section, Table, headline
from pixsim.show.pages import Plate, figure_files
from pixsim.show.sentences import capital, with_ends
from pixsim.studies.claims import SCALING
from pixsim.studies.result import StudyResult
from pixsim.studies.uncertainty import NORMAL_95, UncertaintyResult, distribution_plate, indices_plate, quantile_words

PAGE, DATA = "uncertainty.html", "uncertainty.json"
MOST_RESULTS = 20  # technologies × values × conditions with a section of the page
DRAWN = (
    "Numbers of the sensor that are known only within a range are drawn at random from it, all at once. Each draw is a sensor "
    "type; the study finds its optimum. All types have the same random numbers, so that they differ by their inputs only. "
)


def uncertainty_files() -> set[str]:
    """Return the names of all files of `uncertainty_document`."""
    kinds = [f"uncertainty_{kind}_{number}" for number in range(1, MOST_RESULTS + 1) for kind in ("distribution", "indices")]
    return {PAGE, DATA, *figure_files(kinds), *(f"sensor_types_{number}.csv" for number in range(1, MOST_RESULTS + 1))}


def uncertainty_document(result: StudyResult) -> Document:
    """Return what the study of sensor types finds, with a table of the types and the figures of each optimum."""
    study, found = result.study, list(enumerate(result.uncertainty[:MOST_RESULTS], 1))
    shown = uncertainty_blocks(result.uncertainty)
    return Document(
        command="study",
        kind="study with unknown inputs",
        title=f"What is not known: {study.title or study.name}",
        data={"study": study.name, "results": [_data(each) for _, each in found]},
        answers=[block for block in shown if isinstance(block, Answer)],
        lead=[block for block in shown if not isinstance(block, Answer)],
        about=((DRAWN, Link("The study itself", "report.html"), "."),),
        sections=tuple(
            Section(f"pixel-{number}", f"{capital(each.label) or 'Optimum'}{each.by}", tuple(_blocks(each, number)))
            for number, each in found
        ),
        files={f"sensor_types_{number}.csv": each.to_csv() for number, each in found},
        data_file=DATA,
        page=PAGE,
    )


def _data(found: UncertaintyResult) -> dict[str, Any]:
    """Return the result of one optimum, with total indices in place of those of the first order."""
    content = found.as_dict()
    if found.total:
        del content["first_order"]
        content["indices"] = found.total_indices
    return content


def _blocks(found: UncertaintyResult, number: int) -> list[Block]:
    """Return the figures, tables and statements of one optimum."""

    def numbered(make: Callable[[UncertaintyResult], Plate]) -> Plate:
        plate = make(found)
        return replace(plate, name=f"{plate.name}_{number}")

    makers = [distribution_plate] if found.total else [distribution_plate, indices_plate]
    blocks: list[Block] = [Plot(partial(numbered, make)) for make in makers]
    if found.verdicts:
        rows = [(name, str(probability)) for name, probability in found.verdicts.items()]
        blocks.append(Table("probabilities", ("statement", "probability that it holds (95 % interval)"), rows, words=None))
    if found.total:
        titles = {output: capital(words.partition(" (")[0]) for output, words in found.outputs.items()}
        blocks += [indices_table(titles[output], indices) for output, indices in found.total_indices.items()]
    blocks.append(Listed(f"{line}." for line in found.statements))
    return [*blocks, (Link("All sensor types (CSV)", f"sensor_types_{number}.csv"),)]


def indices_table(output: str, indices: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return the shares of an output's variance that inputs have alone and with all interactions."""
    shares = {
        name: (with_ends(index[kind]["share"], (index[kind]["low"], index[kind]["high"]), ".2f") for kind in ("first", "total"))
        for name, index in indices.items()
    }
    caption = f"{output}: shares of its variance, with 95 % intervals"
    rows = [(name, *own) for name, own in shares.items()]
    return Table(caption, ("input", "alone", "with all interactions"), rows, caption, words=None)


def uncertainty_blocks(found: Sequence[UncertaintyResult]) -> tuple[Block, ...]:
    """Return the distributions and the probabilities of all verdicts."""
    blocks: list[Block] = []
    for each in found:
        median, most = (quantile_words(each.optimum, ".2f", " µm", *names) for names in (("p50",), ("p05", "p95")))
        name = f"{each.label}: " if each.label else ""
        types = f"{len(each.outcomes)} sensor types"
        own = f"each is known to ±{NORMAL_95 * each.optimum.own_sd:.2g} µm by its own 95 % interval" if each.optimum.own_sd else ""
        blocks.append(headline([f"{name}optimum{each.by} of {types}: median {median}, nine tenths {most}", own]))
        own_verdicts = {statement: words for statement, words in each.verdicts.items() if statement not in SCALING}
        blocks += [Fact(f"{name}probability{each.by} that {statement}: {words}") for statement, words in own_verdicts.items()]
    of_all = {statement: words for each in found for statement, words in each.verdicts.items() if statement in SCALING}
    return (*blocks, *(Fact(f'probability of "{statement}": {words}') for statement, words in of_all.items()))
