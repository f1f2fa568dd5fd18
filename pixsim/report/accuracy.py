"""The page of `pixsim accuracy`: error against run time, and extreme cases."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from pixsim.base.digits import number, within_error
from pixsim.base.schema import result_data
from pixsim.base.tables import plain, rows_csv
from pixsim.report.score import shown_mean
from pixsim.show.document import Answer, Block, Document, DocumentTable, Fact, Plot, Section, Strong
from pixsim.show.figures import LINE_STYLES, new_figure, plain_powers
from pixsim.show.pages import Drawing, figure, figure_files
from pixsim.show.presenter import Presenter
from pixsim.studies.files import stated_settings
from pixsim.verification.case import ExtremeCase
from pixsim.verification.ladder import Accuracy

FIGURES = ("work_precision",)
FILES = ("report.html", "summary.json", "ladder.csv", "stability.csv", *figure_files(FIGURES))


def accuracy_document(accuracy: Accuracy) -> Document:
    """Return the page of an accuracy: error against run time, the films, and the extreme cases."""
    header = accuracy.header
    computation = (
        f"{header['scene']} (hash {header['scene_hash']}), {header['variant']}, in"
        f" {accuracy.seconds:.0f} s."
    )
    failed = [case for case in accuracy.cases if not case.passed]
    return Document(
        command="accuracy",
        kind="accuracy and run time",
        title=f"Accuracy and run time of {accuracy.name}",
        data=_accuracy_data(accuracy),
        answers=(answer(accuracy),),
        lead=(Plot(partial(work_precision, accuracy)), *facts(accuracy)),
        sections=(
            Section(
                "failed",
                "Extreme cases that fail",
                [_cases_table(failed)] if failed else (),
                brief=True,
            ),
            Section(
                "ladder",
                "Films",
                (_ladder_table(accuracy), "The last film is that of the default settings."),
                brief=True,
            ),
            Section("made", "How this was computed", (computation,), folded=True),
        ),
        files={
            "ladder.csv": _ladder_csv(accuracy),
            "stability.csv": rows_csv([plain(case.as_dict()) for case in accuracy.cases]),
        },
    )


def _accuracy_data(accuracy: Accuracy) -> dict[str, Any]:
    """Return summary.json."""
    content = {
        "scene": accuracy.name,
        "assumption": accuracy.settings.pixel.assumption,
        "reference": None if accuracy.reference is None else plain(accuracy.reference.as_dict()),
        "ladder": [plain(rung.as_dict()) for rung in accuracy.rungs],
        "stability": [plain(case.as_dict()) for case in accuracy.cases],
        "seconds": accuracy.seconds,
    }
    settings = stated_settings(accuracy.settings)
    return result_data(content, settings=settings, notes=[], table="ladder.csv")


def _ladder_csv(accuracy: Accuracy) -> str:
    """Return a row for each rung of the ladder as CSV."""
    return rows_csv([rung.as_dict() for rung in accuracy.rungs])


def answer(accuracy: Accuracy) -> Answer:
    """Return the error of the default settings and their run time."""
    rung = accuracy.rungs[-1]
    words = f"mean ΔE {shown_mean(rung.mean_delta_e, rung.light, rung.light_limit)}"
    if accuracy.reference:
        words = f"{number(rung.error_delta_e)} of mean ΔE"
    return Answer(
        ("Default settings: ", Strong(words), f", in {rung.seconds:.2g} s (render and score)")
    )


def facts(accuracy: Accuracy) -> Iterator[Block]:
    """Yield the reference, the extreme cases and the assumption below the answer."""
    yield Fact(reference_words(accuracy))
    passed = sum(case.passed for case in accuracy.cases)
    yield Fact(
        f"stability: {passed} of {len(accuracy.cases)} extreme cases meet their known answers"
    )
    yield from map(Fact, filter(None, (accuracy.settings.pixel.assumption,)))


def reference_words(accuracy: Accuracy) -> str:
    """Return the reference of the errors in words."""
    reference = accuracy.reference
    if reference is None:
        return "no reference: no film that fits in memory is accurate enough"
    return (
        f"reference: a film of {reference.across} samples across, whose own error is at most"
        f" {reference.stated_delta_e:.2g} ΔE"
    )


@figure(
    "work_precision",
    "Error of mean ΔE against run time. Numbers beside the points: samples across the film."
    " Measured: against the reference; stated: by pixsim run, for the film and the render noise.",
)
def work_precision(accuracy: Accuracy) -> Drawing:
    """Plot error against wall time of each film: measured, and as pixsim states it."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    seconds = [rung.seconds for rung in accuracy.rungs]
    measured = [rung.error_delta_e for rung in accuracy.rungs]
    stated = [rung.stated_delta_e for rung in accuracy.rungs]
    for name, errors, line_style in zip(
        ("measured", "stated"), (measured, stated), LINE_STYLES, strict=False
    ):
        if any(error > 0 for error in errors):  # a logarithmic axis leaves out what is not above 0
            axes.plot(seconds, errors, label=name, ms=6, **line_style.line)

    for rung in accuracy.rungs:
        height = rung.error_delta_e if rung.error_delta_e > 0 else rung.stated_delta_e
        if height > 0:
            axes.annotate(
                f"{rung.across}",
                (rung.seconds, height),
                xytext=(5, 4),
                textcoords="offset points",
                fontsize=8,
            )
    axes.set(
        xscale="log", yscale="log", xlabel="seconds of render and score", ylabel="error of mean ΔE"
    )
    plain_powers(axes.xaxis)
    axes.grid(which="major", alpha=0.25)
    axes.legend(fontsize=8, frameon=False)
    across = [rung.across for rung in accuracy.rungs]
    return figure, {
        "across": across,
        "seconds": seconds,
        "error_delta_e": measured,
        "stated_delta_e": stated,
    }


def _ladder_table(accuracy: Accuracy) -> DocumentTable:
    """Return the time and the errors of each film."""
    rows = [
        (
            f"{rung.across}",
            f"{rung.seconds:.2g}",
            within_error(rung.mean_delta_e, rung.error_delta_e),
            number(rung.error_delta_e),
            *(
                number(math.nan if error is None else error)
                for error in (rung.light.film_delta_e, rung.light.noise_delta_e)
            ),
        )
        for rung in accuracy.rungs
    ]
    head = ("samples across", "s", "mean ΔE", "error", "stated film error", "stated render noise")
    return DocumentTable("ladder", head, rows, words=None)


def _cases_table(cases: Sequence[ExtremeCase]) -> DocumentTable:
    """Return extreme cases, their errors and limits."""
    rows = []
    for case in cases:
        numbers = (
            f"{case.expected:.6g}",
            f"{case.got:.6g}",
            number(case.error),
            number(case.allowed),
        )
        rows.append(
            (
                f"{case.room}, {case.name}",
                *numbers,
                " ".join(filter(None, (case.warned, case.source))),
            )
        )
    head = ("case", "expected", "got", "error", "limit", "warnings; source and reason of the limit")
    return DocumentTable("extreme cases", head, rows, words=(5,))


PRESENTER = Presenter(document=accuracy_document, figure=work_precision, csv=_ladder_csv)
