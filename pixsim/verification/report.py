"""The document of `pixsim accuracy`: error against run time, and extreme cases."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING

from pixsim.base.digits import number
from pixsim.base.tables import Column, plain, rows_csv
from pixsim.show.document import (
    Answer,
    Block,
    Document,
    DocumentTable,
    Fact,
    Listed,
    Plot,
    Section,
    Strong,
    Text,
    VerdictText,
    made_with,
)
from pixsim.show.figures import LOOKS, new_figure, own_style, plain_powers
from pixsim.show.pages import Plate, figure_files
from pixsim.viewer.score import shown_mean

if TYPE_CHECKING:
    from pixsim.verification.ladder import Accuracy

FIGURES = ("work_precision",)
FILES = ("report.html", "summary.json", "ladder.csv", "stability.csv", *figure_files(FIGURES))


def accuracy_document(accuracy: Accuracy) -> Document:
    """Return the answer of `pixsim accuracy`."""
    header = accuracy.header
    made = f"{header['scene']} (hash {header['scene_hash']}), {header['variant']}, in {accuracy.seconds:.0f} s."
    cases = (
        f"{stability_words(accuracy)}. Each row is the worst element of its sweep; the last column gives the source of "
        "the expected value and the reason for the limit.",
        case_table(accuracy),
    )
    return Document(
        command="accuracy",
        kind="accuracy and run time",
        title=f"Accuracy and run time of {accuracy.name}",
        data=accuracy.as_dict(),
        answers=(answer(accuracy),),
        lead=facts(accuracy),
        sections=(
            Section("errors", "Error against run time", [Plot(partial(work_precision, accuracy))]),
            Section("ladder", "Films", (ladder_table(accuracy), "The last one is that of the default settings."), brief=True),
            Section("extremes", "Extreme cases with known answers", cases),
            Section("made", "Reproducibility", (made, made_with())),
        ),
        files={"ladder.csv": accuracy.to_csv(), "stability.csv": rows_csv([plain(case.as_dict()) for case in accuracy.cases])},
    )


def answer(accuracy: Accuracy) -> Answer:
    """Return the error of the default settings and their run time."""
    rung = accuracy.rungs[-1]
    words = f"mean ΔE {shown_mean(rung.mean_delta_e, rung.light, rung.light_limit)}"
    if accuracy.reference:
        words = f"{number(rung.error_delta_e)} of mean ΔE"
    return Answer(("Default settings: ", Strong(words), f", in {rung.seconds:.2g} s (render and score)"))


def facts(accuracy: Accuracy) -> Iterator[Block]:
    """Yield what follows the error of the default settings."""
    yield Fact(f"reference: {accuracy.reference_words}" if accuracy.reference else accuracy.reference_words)
    yield Fact(f"stability: {stability_words(accuracy)}")
    if failed := [case for case in accuracy.cases if not case.passed]:
        yield Listed(f"{case.room}, {case.name}: error {case.error:.1e}, limit {case.allowed:.1e}" for case in failed)
    yield from map(Fact, filter(None, (accuracy.settings.pixel.assumption,)))


def stability_words(accuracy: Accuracy) -> str:
    """Return how many of the extreme cases are right, as text."""
    return f"{sum(case.passed for case in accuracy.cases)} of {len(accuracy.cases)} extreme cases meet their known answers"


@own_style()
def work_precision(accuracy: Accuracy) -> Plate:
    """Plot error against wall time of each film: measured, and as pixsim states it."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    seconds = [rung.seconds for rung in accuracy.rungs]
    columns = {"measured": "error_delta_e", "stated": "stated_delta_e"}
    table: dict[str, Column] = {"across": [rung.across for rung in accuracy.rungs], "seconds": seconds}
    for (label, name), look in zip(columns.items(), LOOKS, strict=False):
        errors = [float(getattr(rung, name)) for rung in accuracy.rungs]
        table[name] = errors
        if any(error > 0 for error in errors):
            axes.plot(seconds, errors, label=label, ms=6, **look.line)  # a logarithmic axis leaves out what is not above 0
    for rung in accuracy.rungs:
        height = rung.error_delta_e if rung.error_delta_e > 0 else rung.stated_delta_e
        if height > 0:
            axes.annotate(f"{rung.across}", (rung.seconds, height), xytext=(5, 4), textcoords="offset points", fontsize=8)
    axes.set(xscale="log", yscale="log", xlabel="seconds of render and score", ylabel="error of mean ΔE")
    plain_powers(axes.xaxis)
    axes.grid(which="major", alpha=0.25)
    axes.legend(fontsize=8, frameon=False)
    caption = (
        "Error of mean ΔE against run time, for films of the samples across that are written beside the points. Stated: the film's "
        f"error and that of the render noise, as pixsim run gives them. Measured against a reference: {accuracy.reference_words}."
    )
    return Plate("work_precision", caption, figure, table)


def ladder_table(accuracy: Accuracy) -> DocumentTable:
    """Return the time and the errors of each film."""
    rows = [
        (
            f"{rung.across}",
            f"{rung.seconds:.2g}",
            f"{rung.mean_delta_e:.4f}",
            number(rung.error_delta_e),
            *(number(math.nan if error is None else error) for error in (rung.light.film_delta_e, rung.light.noise_delta_e)),
        )
        for rung in accuracy.rungs
    ]
    head = ("samples across", "s", "mean ΔE", "error", "stated of the film", "stated of render noise")
    return DocumentTable("ladder", head, rows, words=None)


def case_table(accuracy: Accuracy) -> DocumentTable:
    """Return the extreme cases, below the part of the computation that they test."""
    rows: list[tuple[Text, ...]] = []
    for room, cases in groupby(accuracy.cases, attrgetter("room")):
        rows += [(room,)] if room else []
        for case in cases:
            values = f"{case.expected:.6g}", f"{case.got:.6g}", number(case.error), number(case.allowed)
            met = VerdictText("met" if case.passed else f"NOT met {case.warned}", case.passed)
            rows.append((case.name, *values, (met,), case.source))
    head = ("case", "expected", "got", "error", "limit", "verdict", "source")
    return DocumentTable("extreme cases", head, rows, words=(5, 6))
