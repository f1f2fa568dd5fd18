"""The document of a study with axes or conditions: its regrets and maps, and a whole document of its first cases."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.schema import result_data
from pixsim.base.tables import Column, columns_of, table_csv
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.curve import curve_data, delta_e_against_pitch, optima_data, optima_table, optimum_line
from pixsim.report.maps import alone_groups, alone_plate, axis_plates, case_columns, optimum_columns, plate_names
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.regret import REGRETS, condition_regrets_data, regrets_plate, regrets_tables
from pixsim.report.study import (
    ANSWERS_OF_PAGE,
    agrees,
    document_of,
    plot_of,
    report_files,
    study_document,
    study_page,
    with_files_of_study,
)
from pixsim.report.study_facts import study_notes
from pixsim.report.wording import DELTA_E, film_words, rendered_words
from pixsim.show.document import Block, Document, DocumentTable, Fact, Link, Listed, Plot, Section, made_with, pairs
from pixsim.show.pages import Figures, Plate, figure_files
from pixsim.show.presenter import PageOptions, Presenter
from pixsim.studies.claims import Verdict, verdicts
from pixsim.studies.design import BASE, Case, cases_of
from pixsim.studies.engine import Workers
from pixsim.studies.film_error import FilmError
from pixsim.studies.merit import noise_budgets
from pixsim.studies.regret import Regrets, condition_regrets
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Study
from pixsim.studies.table import ROWS_FILE
from pixsim.viewer.display import white_light

REGRETS_FILE = "regrets.csv"
SHOWN_CASES = 4  # with a report of their own
SHOWN_REGRETS = 6  # with a figure of their own


def shown_cases(cases: Sequence[Case[Study]]) -> list[Case[Study]]:
    """Return the cases with a report of their own: the first combination of values under each condition, at most 4."""
    return [case for case in cases if (case.at, case.alone) == (cases[0].at, cases[0].alone)][:SHOWN_CASES]


def regrets_columns(found: Sequence[Regrets]) -> dict[str, Column]:
    """Return a table with a row for each condition and each weighted mean, of all combinations and metrics."""
    names = list(dict.fromkeys(criterion.name for regrets in found for criterion in regrets.criteria))
    rows = []
    for regrets in found:
        for criterion, at_best in zip(regrets.criteria, regrets.matrix.tolist(), strict=True):
            low_um, high_um = criterion.optimum.interval_um
            row = {"pixel": regrets.label, "metric": criterion.metric.name, "best_of": criterion.name, "weight": criterion.weight}
            row |= {"pitch_um": criterion.optimum.pitch_um, "interval_low_um": low_um, "interval_high_um": high_um}
            row |= {"between_sizes_share": criterion.optimum.between_sizes_share, "value": criterion.optimum.value}
            row |= {f"regret_at_{name}": None for name in names}
            row |= {f"regret_at_{other.name}": value for other, value in zip(regrets.criteria, at_best, strict=True)}
            rows.append(row)
    return columns_of(rows)


def optima_columns(result: CasesResult) -> dict[str, Column]:
    """Return a table with the optimum of each technology, combination and condition."""
    return case_columns(result, result.curves, list(result.curves[0].at)) | optimum_columns(result.curves)


def axes_document(result: CasesResult, regrets: Sequence[Regrets], warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim study` with axes or conditions, without the figures of its page.

    regrets : `condition_regrets` of the study
    warned : notes that a reader of the terminal has seen
    """
    data = cases_data(result, regrets) | {"counts": asdict(result.counts)}
    facts = map(Fact, [*alone_words(result), *film_of_cases(result)])
    return replace(document_of(result, data, regrets, [*facts], warned), kind="study of several cases")


def alone_words(result: CasesResult) -> list[str]:
    """Return how far each axis that is moved alone moves the optimum, widest first, for the panels of its figure."""
    names = [axis.name for axis in result.study.axis if axis.alone]
    groups = alone_groups(result, names) if names else []
    lines = []
    for group in groups:
        found = []
        for name in names:
            optima = [group.base.optimum, *(curve.optimum for curve in group.moved[name])]
            sizes, values, metric = [best.pitch_um for best in optima], [best.value for best in optima], group.base.metric
            form = ".3f" if metric.is_delta_e else ".4g"
            end = "" if all(best.inside for best in optima) else " (an end of the sizes tried)"
            text = f"{min(sizes):.2f} to {max(sizes):.2f} µm{end}, {metric.best} {min(values):{form}} to {max(values):{form}}"
            found.append((max(sizes) - min(sizes), f"{', '.join(filter(None, (group.label, name)))} alone: {text}"))
        lines += [line for _, line in sorted(found, key=lambda each: -each[0])]
    return lines


def cases_data(result: CasesResult, regrets: Sequence[Regrets]) -> dict[str, Any]:
    """Return the result as in summary.json."""
    cases: list[dict[str, Any]] = []
    for part, findings in zip(result.parts, result.findings or [()] * len(result.parts), strict=True):
        first = part.curves[0]
        labels: dict[str, Any] = {"condition": first.condition, "alone": first.alone}
        labels |= {"film": part.film and part.film.as_dict(), "agrees": {row.statement: row.agrees for row in findings}}
        light = {"irradiance": part.irradiance.header, "white_spectrum": white_light(part.irradiance)[1]}
        cases.append({"at": first.at} | {name: value for name, value in labels.items() if value} | light)
    further = {
        "left_out": list(result.left_out),
        "regrets": [condition_regrets_data(found) for found in regrets],
        "claims": [verdict.as_dict() for verdict in verdicts(result)],
    }
    settings = result.study.model_dump(mode="json")
    content = {
        "study": settings,
        "chosen": result.view,
        "curves": [curve_data(curve) | {"dark": result.part_of(curve).dark(curve)} for curve in result.curves],
        **{name: values for name, values in further.items() if values},
    }
    optima = [optimum for curve in result.curves for optimum in optima_data(curve)]
    return result_data(content, settings=settings, notes=study_notes(result), cases=cases, table=ROWS_FILE, optima=optima)


def film_of_cases(result: CasesResult) -> list[str]:
    """Return words on each film of the cases, with its largest error."""
    worst: dict[tuple[int, int], FilmError] = {}
    for part in result.parts:
        if part.film is not None:
            shape = part.film.shape
            worst[shape] = max(worst.get(shape, part.film), part.film, key=lambda film: film.largest_delta_e)
    return [film_words(film.as_dict()) for film in worst.values()]


def axes_files(study: Study) -> set[str]:
    """Return the names of all files that the report may have."""
    cases = cases_of(study)
    plates = [*plate_names(study), *(f"{REGRETS}_{number + 1}" for number in range(SHOWN_REGRETS))]
    own = {f"{case.folder}/{name}" for case in shown_cases(cases) for name in report_files(case.settings)}
    plates += [NAME] * study.noise_budget
    return {"report.html", "summary.json", SETTINGS_FILE, "optima.csv", REGRETS_FILE, *figure_files(plates), *own}


def study_report(
    result: StudyResult,
    regrets: Sequence[Regrets],
    seconds: dict[str, float],
    workers: Workers | None = None,
    figures: Figures = "svg",
) -> Document:
    """Return the document of any study with its page and all other files; the first cases of one with axes have their own.

    Only the wall times in the page vary: everything else is reproducible byte for byte, and does not depend on the workers.

    regrets : `condition_regrets` of the study
    seconds : stage -> wall time in s
    workers : processes that draw the figures; None means this process
    figures : "pdf" draws a PDF beside each SVG
    """
    draw = partial(study_page, seconds=seconds, workers=workers or Workers(), figures=figures)
    if not isinstance(result, CasesResult):
        return with_files_of_study(draw(result, budgets=noise_budgets(result)), result)
    cases = shown_cases(
        [Case(part.study, curve.at, curve.condition, curve.alone) for part in result.parts for curve in part.curves[:1]]
    )
    parts = list(zip(cases, result.parts[: len(cases)], strict=True))
    pages = {case.folder: draw(part) for case, part in parts}
    return with_files_of_study(replace(axes_page(result, regrets, seconds, parts), parts=pages), result)


def axes_page(
    result: CasesResult, regrets: Sequence[Regrets], seconds: dict[str, float], parts: Sequence[tuple[Case[Study], StudyResult]]
) -> Document:
    """Return the document of a study with axes or conditions, with its page.

    parts : cases with a page of their own
    """
    pitch_um = np.unique(np.concatenate([curve.pitch_um for curve in result.curves]))
    alone = alone_plate(result)
    plots = {
        "maps": [plot_of(plate) for plate in axis_plates(result)],
        "alone": [plot_of(alone)] if alone else [],
        "regrets": [
            Plot(partial(_numbered_regrets, found, pitch_um, number)) for number, found in enumerate(regrets[:SHOWN_REGRETS], 1)
        ],
        "curves": [Plot(lambda: delta_e_against_pitch(result.curves))],
    }
    first = next(drawn for drawn in plots.values() if drawn).pop(0)  # the figure that answers what was asked

    tables = [table for found in regrets for table in regrets_tables(found)]
    brief, header = axes_document(result, regrets), result.irradiance.header
    listed = [
        (Link(case.words or "the study's own settings", f"{case.folder}/report.html"), f": {optimum_line(part.curves[0])}")
        for case, part in parts
    ]
    best = (Link("The same with all digits (CSV)", "optima.csv"),)
    all_regrets = (Link("The same with all digits (CSV)", REGRETS_FILE),)
    made = f"{result.counts}. Study seed {result.study.seed}; first render: {rendered_words(header)}."
    return replace(
        brief,
        answers=tuple(brief.answers)[:ANSWERS_OF_PAGE],
        data=cases_data(result, regrets),
        lead=(first, *brief.lead),
        sections=(
            Section("maps", "Along the axes", plots["maps"]),
            Section("alone", "One at a time", plots["alone"]),
            Section("regrets", "Regrets of the conditions", [*tables, all_regrets, *plots["regrets"]] if regrets else ()),
            Section("cases", "Cases with pictures", [Listed(listed)]),
            Section("optima", "Optima", [optima_table(result.curves), best]),
            Section("claims", "The paper's statements", _claims(result)),
            budgets_section(noise_budgets(result)),
            Section("made", "How this was computed", [*_about(result), made, made_with(pairs("seconds", seconds, 2))], folded=True),
        ),
        files={
            "optima.csv": table_csv(optima_columns(result)),
            **({REGRETS_FILE: table_csv(regrets_columns(regrets))} if regrets else {}),
        },
    )


def _numbered_regrets(regrets: Regrets, pitch_um: Array, number: int) -> Plate:
    return regrets_plate(regrets, pitch_um).named(f"{REGRETS}_{number}")


def _about(result: CasesResult) -> list[str]:
    """Return what the numbers of the page mean."""
    texts = [
        f"All pixel sizes see the same die under each of the {result.counts.cases} cases. All cases have the same random numbers, "
        "so that they differ by their settings only. The regret of a pixel size in a condition is its value there over that of the "
        "best size for that condition, less 1."
    ]
    return [*texts, DELTA_E] if result.curves[0].has_delta_e else texts


def _claims(result: CasesResult) -> list[Block]:
    """Return the paper's statements, and the cases that change a verdict, if they are compared."""
    rows = []
    for each in verdicts(result):
        found, turned = each.finding, len(each.turned_by)
        changed = f"{turned} of {result.counts.cases - 1}{f': {verdict_words(each)}' if turned else ''}"
        rows.append((found.statement, found.given, found.found, agrees(found.agrees), changed))
    head = ("statement of the paper", "paper", "first case", "agrees", "cases that change the verdict")
    table = DocumentTable("the paper's statements", head, rows, words=None, stacks=True)
    return [table] if rows else []


def verdict_words(verdict: Verdict) -> str:
    """Return the cases with the opposite verdict as text."""
    return turned_words(
        (curve.alone, curve.at[curve.alone], curve.condition) if curve.alone else ("", curve.words, "")
        for curve in verdict.turned_by
    )


def turned_words(cases: Iterable[tuple[str, float | int | str, str]]) -> str:
    """Return cases as text, the values of each axis that is moved alone together: bits (8, 12); f/8, night.

    cases : (the axis that is moved alone, or empty; its value, or the words of the case; the condition) of each
    """
    groups: dict[str, list[str]] = {}
    for axis, value, condition in cases:
        text = value if isinstance(value, str) else f"{value:.4g}"
        groups.setdefault(axis, []).append(", ".join(filter(None, (text, condition))) or BASE)
    return "; ".join(f"{axis} ({', '.join(values)})" if axis else "; ".join(values) for axis, values in groups.items()) or "none"


def result_document(result: StudyResult) -> Document:
    """Return the answer of any study, without the figures and pictures of its page."""
    if isinstance(result, CasesResult):
        return axes_document(result, condition_regrets(result.study, result.curves))
    return study_document(result)


def result_page(result: StudyResult, options: PageOptions) -> Document:
    """Return the document of any study with its page and all other files."""
    regrets = condition_regrets(result.study, result.curves)
    return study_report(result, regrets, dict(options.seconds), figures=options.figures)


def result_csv(result: StudyResult) -> str:
    """Return a row for each evaluation as CSV."""
    assert result.table is not None
    return result.table.to_csv()


PRESENTER = Presenter(
    document=result_document, figure=lambda result: delta_e_against_pitch(result.curves), csv=result_csv, page=result_page
)
