"""The document of a study with axes or conditions: its regrets and maps, and a whole document of
its first cases.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.digits import span
from pixsim.base.tables import Column, columns_of, table_csv
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.curve import delta_e_against_pitch, optima_table, optimum_line
from pixsim.report.maps import (
    axis_plates,
    case_columns,
    one_at_a_time_groups,
    one_at_a_time_plate,
    optimum_columns,
    plate_names,
)
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.regret import REGRETS, condition_regrets_data, regrets_plate, regrets_tables
from pixsim.report.study import (
    ANSWERS_OF_PAGE,
    StudyDrawing,
    agrees,
    document_of,
    plot_of,
    report_files,
    study_data,
    study_document,
    study_drawing,
    study_page,
    with_files_of_study,
)
from pixsim.report.wording import film_words, rendered_words
from pixsim.show.document import Block, Document, DocumentTable, Fact, Link, Listed, Plot, Section
from pixsim.show.pages import Figures, figure_files
from pixsim.show.presenter import Presenter
from pixsim.studies.claims import Verdict, verdicts
from pixsim.studies.design import BASE, Case, cases_of
from pixsim.studies.engine import Workers
from pixsim.studies.merit import noise_budgets
from pixsim.studies.regret import Regrets, condition_regrets
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Study
from pixsim.viewer.display import white_light

_REGRETS_FILE = "regrets.csv"
_CASES_EXPLAINED = (
    "All pixel sizes see the same die in all cases, which have the same random numbers: they differ"
    " by their settings only. The regret of a pixel size in a condition is its value there over"
    " that of the best size for that condition, less 1."
)
_MAX_CASE_REPORTS = 4  # with a report of their own
_MAX_REGRET_FIGURES = 6  # with a figure of their own


def _reported_cases(cases: Sequence[Case[Study]]) -> list[Case[Study]]:
    """Return the cases with a report of their own: the first combination of values under each
    condition, at most 4.
    """
    first = cases[0]
    same_values = [
        case for case in cases if (case.at, case.one_at_a_time) == (first.at, first.one_at_a_time)
    ]
    return same_values[:_MAX_CASE_REPORTS]


def regrets_columns(all_regrets: Sequence[Regrets]) -> dict[str, Column]:
    """Return a table with a row for each condition and each weighted mean, of all combinations and
    metrics.
    """
    names = list(
        dict.fromkeys(criterion.name for regrets in all_regrets for criterion in regrets.criteria)
    )
    rows = []
    for regrets in all_regrets:
        for criterion, regrets_at_best in zip(
            regrets.criteria, regrets.matrix.tolist(), strict=True
        ):
            optimum = criterion.optimum
            low_um, high_um = optimum.interval_um
            row = {
                "pixel": regrets.label,
                "metric": criterion.metric.name,
                "best_of": criterion.name,
                "weight": criterion.weight,
                "pitch_um": optimum.pitch_um,
                "interval_low_um": low_um,
                "interval_high_um": high_um,
                "between_sizes_share": optimum.between_sizes_share,
                "value": optimum.value,
            }
            row |= {f"regret_at_{name}": None for name in names}
            for other, regret in zip(regrets.criteria, regrets_at_best, strict=True):
                row[f"regret_at_{other.name}"] = regret
            rows.append(row)
    return columns_of(rows)


def optima_columns(result: CasesResult) -> dict[str, Column]:
    """Return a table with the optimum of each technology, combination and condition."""
    return case_columns(result, result.curves, list(result.curves[0].at)) | optimum_columns(
        result.curves
    )


def _axes_document(
    result: CasesResult, regrets: Sequence[Regrets], warned: Collection[str] = ()
) -> Document:
    """Return the answer of `pixsim study` with axes or conditions, without the figures of its page.

    regrets : `condition_regrets` of the study
    warned : notes that a reader of the terminal has seen
    """
    one_at_a_time = _one_at_a_time_table(result)
    films = [part.film for part in result.parts if part.film is not None]
    worst = max(films, key=lambda film: film.largest_delta_e, default=None)
    facts: list[Block] = [one_at_a_time] if one_at_a_time.rows else []
    if worst is not None:
        facts.append(Fact(film_words(worst.as_dict())))
    data = _cases_data(result, regrets) | {"counts": asdict(result.counts)}
    return replace(document_of(result, data, regrets, facts, warned), kind="study of several cases")


def _one_at_a_time_table(result: CasesResult) -> DocumentTable:
    """Return how far each axis that is moved alone moves the optimum and its value, widest
    first.
    """
    rows = []
    names = [axis.name for axis in result.study.axis if axis.alone]
    for group in one_at_a_time_groups(result, names) if names else []:
        for name in names:
            optima = [group.base.optimum, *(curve.optimum for curve in group.moved[name])]
            sizes_um = sorted(best.pitch_um for best in optima)
            values = sorted(best.value for best in optima)
            label = ", ".join(filter(None, (group.label, name)))
            texts = span(sizes_um[0], sizes_um[-1], ".2f"), span(values[0], values[-1], ".4g")
            rows.append((sizes_um[-1] - sizes_um[0], (label, *texts)))
    rows.sort(key=lambda row: -row[0])
    head = ("alone", "optimum (µm)", result.curves[0].metric.best)
    return DocumentTable("one at a time", head, [row for _, row in rows], words=None)


def _cases_data(result: CasesResult, regrets: Sequence[Regrets]) -> dict[str, Any]:
    """Return the result as in summary.json."""
    all_findings = result.findings or [()] * len(result.parts)
    cases: list[dict[str, Any]] = []
    for part, findings in zip(result.parts, all_findings, strict=True):
        first = part.curves[0]
        labels: dict[str, Any] = {
            "condition": first.condition,
            "alone": first.alone,
            "film": part.film and part.film.as_dict(),
            "agrees": {row.statement: row.agrees for row in findings},
        }
        case = {"at": first.at} | {name: value for name, value in labels.items() if value}
        case["irradiance"] = part.irradiance.header
        case["white_spectrum"] = white_light(part.irradiance)[1]
        cases.append(case)

    content = {
        "left_out": list(result.left_out),
        "regrets": [condition_regrets_data(metric_regrets) for metric_regrets in regrets],
        "claims": [verdict.as_dict() for verdict in verdicts(result)],
    }
    return study_data(result, content, cases=cases)


def axes_files(study: Study) -> set[str]:
    """Return the names of all files that the report may have."""
    plates = plate_names(study)
    plates += [f"{REGRETS}_{number + 1}" for number in range(_MAX_REGRET_FIGURES)]
    if study.noise_budget:
        plates.append(NAME)

    case_files = {
        f"{case.folder}/{name}"
        for case in _reported_cases(cases_of(study))
        for name in report_files(case.settings)
    }
    return {
        "report.html",
        "summary.json",
        SETTINGS_FILE,
        "optima.csv",
        _REGRETS_FILE,
        *figure_files(plates),
        *case_files,
    }


def study_report(result: StudyResult, workers: Workers, drawing: StudyDrawing) -> Document:
    """Return the document of any study with its page and all other files; the first cases of one
    with axes have their own.

    It is reproducible byte for byte, and does not depend on the workers.

    workers : processes that make pictures
    drawing : thread that draws figures
    """
    draw = partial(study_page, workers=workers, drawing=drawing)
    if not isinstance(result, CasesResult):
        return with_files_of_study(draw(result, budgets=noise_budgets(result)), result)
    cases = _reported_cases(
        [
            Case(part.study, curve.at, curve.condition, curve.alone)
            for part in result.parts
            for curve in part.curves[:1]
        ]
    )
    parts = list(zip(cases, result.parts[: len(cases)], strict=True))
    pages = {case.folder: draw(part) for case, part in parts}
    page = _axes_page(result, condition_regrets(result.study, result.curves), parts)
    return with_files_of_study(replace(page, parts=pages), result)


def _axes_page(
    result: CasesResult,
    regrets: Sequence[Regrets],
    parts: Sequence[tuple[Case[Study], StudyResult]],
) -> Document:
    """Return the document of a study with axes or conditions, with its page.

    parts : cases with a page of their own
    """
    first, *others = _axes_plots(result, regrets)  # the first answers what was asked
    tables = [table for metric_regrets in regrets for table in regrets_tables(metric_regrets)]
    regrets_link = (Link("The same with all digits (CSV)", _REGRETS_FILE),)
    optima_link = (Link("The same with all digits (CSV)", "optima.csv"),)
    case_links = []
    for case, part in parts:
        words = case.words or "the study's own settings"
        link = Link(words, f"{case.folder}/report.html")
        case_links.append((link, f": {optimum_line(part.curves[0])}"))

    rendered = rendered_words(result.irradiance.header)
    computation = (
        f"{_CASES_EXPLAINED} {result.counts}. Study seed {result.study.seed}; first render:"
        f" {rendered}."
    )
    files = {"optima.csv": table_csv(optima_columns(result))}
    if regrets:
        files[_REGRETS_FILE] = table_csv(regrets_columns(regrets))

    document = _axes_document(result, regrets)
    return replace(
        document,
        answers=tuple(document.answers)[:ANSWERS_OF_PAGE],
        lead=(first, *tuple(document.lead)[1:]),
        sections=(
            Section("axes", "Along the axes and over the conditions", others),
            Section(
                "regrets", "Regrets of the conditions", [*tables, regrets_link] if regrets else ()
            ),
            Section("cases", "Cases with pictures", [Listed(case_links)]),
            Section("optima", "Optima", [optima_table(result.curves), optima_link]),
            Section("claims", "The paper's statements", _claims(result)),
            budgets_section(noise_budgets(result)),
            Section("made", "How this was computed", [computation], folded=True),
        ),
        files=files,
    )


def _axes_plots(result: CasesResult, regrets: Sequence[Regrets]) -> list[Plot]:
    """Return the figures of the axes, of axes moved one at a time, and of regrets; the curves of
    all cases where there are none.
    """
    plates = axis_plates(result)
    tornado_plate = one_at_a_time_plate(result)
    if tornado_plate is not None:
        plates.append(tornado_plate)

    pitch_um = np.unique(np.concatenate([curve.pitch_um for curve in result.curves]))
    for number, metric_regrets in enumerate(regrets[:_MAX_REGRET_FIGURES], 1):
        plates.append(regrets_plate(metric_regrets, pitch_um).named(f"{REGRETS}_{number}"))

    plates = plates or [delta_e_against_pitch(result.curves)]
    return [plot_of(plate) for plate in plates]


def _claims(result: CasesResult) -> list[Block]:
    """Return the paper's statements, and the cases that change a verdict, if they are compared."""
    rows = []
    for verdict in verdicts(result):
        finding = verdict.finding
        changed = f"{len(verdict.turned_by)} of {result.counts.cases - 1}"
        if verdict.turned_by:
            changed += f": {verdict_words(verdict)}"
        rows.append(
            (finding.statement, finding.given, finding.found, agrees(finding.agrees), changed)
        )
    head = (
        "statement of the paper",
        "paper",
        "first case",
        "agrees",
        "cases that change the verdict",
    )
    table = DocumentTable("the paper's statements", head, rows, words=None, stacks=True)
    return [table] if rows else []


def verdict_words(verdict: Verdict) -> str:
    """Return the cases with the opposite verdict as text."""
    return "; ".join(curve.words or BASE for curve in verdict.turned_by)


def result_document(result: StudyResult, warned: Collection[str] = ()) -> Document:
    """Return the answer of any study, without the figures and pictures of its page.

    warned : notes that a reader of the terminal has seen
    """
    if isinstance(result, CasesResult):
        return _axes_document(result, condition_regrets(result.study, result.curves), warned)
    return study_document(result, warned)


def _result_page(result: StudyResult, figures: Figures) -> Document:
    """Return the document of any study with its page and all other files."""
    with study_drawing(figures) as drawing:
        page = study_report(result, Workers(), drawing)
        drawing.wait()
    return page


def _result_csv(result: StudyResult) -> str:
    """Return a row for each evaluation as CSV."""
    assert result.table is not None
    return result.table.to_csv()


PRESENTER = Presenter(
    document=result_document,
    figure=lambda result: delta_e_against_pitch(result.curves),
    csv=_result_csv,
    page=_result_page,
)
