"""The document of a study with axes or conditions: its compromises and maps, and a whole document of its first cases."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import cycle
from typing import Any

from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.maps import alone_groups, alone_plate, axis_plates, case_columns, optimum_columns, plate_names
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.study import agrees, document_of, plot_of, report_files, study_page, with_files_of_study
from pixsim.report.wording import DELTA_E, compromise_answer, rendered_words, weighted_words
from pixsim.show.document import Block, Document, Fact, Link, Listed, Plot, Section, Table, joined, made_with, pairs, plain_text
from pixsim.show.figures import LOOKS, literal, new_figure, own_style
from pixsim.show.pages import Column, Figures, Plate, columns_of, figure_files, table_csv
from pixsim.show.sentences import capital
from pixsim.studies.cases import Case, cases_of
from pixsim.studies.claims import verdicts
from pixsim.studies.conditions import Compromise, Regret
from pixsim.studies.engine import Workers
from pixsim.studies.film_error import FilmError
from pixsim.studies.noise_budgets import noise_budgets
from pixsim.studies.optimum import Optimum
from pixsim.studies.result import CasesResult, StudyResult, shown_mean_and_ci95
from pixsim.studies.sentences import film_words, optima_table, optimum_line
from pixsim.studies.study_settings import Study

SHOWN_CASES = 4  # with a report of their own
SHOWN_COMPROMISES = 6  # with a figure of their own


def shown_cases(cases: Sequence[Case[Study]]) -> list[Case[Study]]:
    """Return the cases with a report of their own: the first combination of values under each condition, at most 4."""
    return [case for case in cases if (case.at, case.alone) == (cases[0].at, cases[0].alone)][:SHOWN_CASES]


@own_style()
def conditions_plate(found: Compromise, number: int) -> Plate:
    """Plot the first metric against pitch in each condition, its weighted mean, and the pixel sizes that suit all conditions."""
    metric = found.metric
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    columns = ("mean_delta_e", "ci95_delta_e") if metric.is_delta_e else (metric.columns[0], f"{metric.columns[0]}_ci95")
    table: dict[str, list[float | str]] = {name: [] for name in ("condition", "weight", "pitch_um", *columns)}
    for curve, weight, look in zip(found.curves, found.weights, cycle(LOOKS[:2] + LOOKS[3:]), strict=False):
        mean, ci95 = shown_mean_and_ci95(curve)
        axes.errorbar(curve.pitch_um, mean, ci95, fmt=look.marker, ms=4, lw=1, capsize=2, color=look.colour)
        best = f"{curve.optimum.pitch_um:.2f} µm" if curve.optimum.inside else "best at an end"
        label = f"{literal(curve.condition)} ({100 * weight:.0f} %): {best}"
        axes.plot(curve.fit.pitch_um, metric.of_loss(curve.fit.delta_e), lw=1.5, label=label, **look.stroke)
        if curve.optimum.inside:
            axes.plot(curve.optimum.pitch_um, curve.optimum.value, "v", ms=9, mfc="white", mec=look.colour, mew=1.5)
        for values in zip(curve.pitch_um.tolist(), mean.tolist(), ci95.tolist(), strict=True):
            for name, value in zip(table, (curve.condition, weight, *values), strict=True):
                table[name].append(value)
    if found.weighted is not None and found.best is not None:
        label = f"weighted mean: {found.best.pitch_um:.2f} µm"
        axes.plot(found.weighted.pitch_um, metric.of_loss(found.weighted.delta_e), lw=2.2, label=label, **LOOKS[2].stroke)
        axes.plot(found.best.pitch_um, found.best.value, "*", ms=12, color=LOOKS[2].colour)
    if found.regret is not None:
        at_um = found.regret.pitch_um
        axes.axvline(at_um, color="0.4", ls=":", lw=1.5, label=f"least worst regret: {at_um:.2f} µm")
    axes.set(xlabel="pixel size (µm)", ylabel=literal(metric.label))
    axes.set_ylim(0, axes.get_ylim()[1] * 1.1)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    return Plate(f"conditions_{number}", conditions_caption(found), figure, dict(table))


def conditions_caption(found: Compromise) -> str:
    """Return what the figure of a compromise shows."""
    return (
        f"{capital(found.metric.words)} against pixel size in each condition ({found.label}), and the weighted mean. Star: its "
        "best size; dotted line: the least worst regret; triangles: the best size of each condition. Points: means over sensors "
        "with their 95 % intervals."
    )


def conditions_table(found: Sequence[Compromise]) -> dict[str, Column]:
    """Return a table with a row for each condition and each compromise of all combinations, by each metric."""
    rows: list[dict[str, float | str | None]] = []
    by_metric = [own for each in found for own in (each, *each.others.values())]
    by_delta_e = all(each.metric.is_delta_e for each in by_metric)
    numbers = ("mean_delta_e", "worst_regret_delta_e") if by_delta_e else ("value", "worst_regret")

    def add(of: str, weight: float | str, size: Optimum | Regret, value: float | str, regret: float | str) -> None:
        row: dict[str, float | str | None] = {} if by_delta_e else {"metric": each.metric.name}
        row |= {"pixel": each.label, "pixel_of": of, "weight": weight, "pitch_um": size.pitch_um}
        row |= {"interval_low_um": size.interval_um[0], "interval_high_um": size.interval_um[1]}
        rows.append(row | dict(zip(numbers, (value, regret), strict=True)))

    for each in by_metric:
        for curve, weight in zip(each.curves, each.weights, strict=True):
            add(curve.condition, weight, curve.optimum, curve.optimum.value, "")
        if each.best is not None:
            worst = max(each.regrets_at(each.best.pitch_um).values())
            add(weighted_words(each.metric), "", each.best, each.best.value, worst)
        if each.regret is not None:
            add("least worst regret", "", each.regret, "", each.regret.delta_e)
    return columns_of(rows)


def optima_columns(result: CasesResult) -> dict[str, Column]:
    """Return a table with the optimum of each technology, combination and condition."""
    return case_columns(result, result.curves, list(result.curves[0].at)) | optimum_columns(result.curves)


def axes_document(result: CasesResult, compromises: Sequence[Compromise], warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim study` with axes or conditions, without the figures of its page.

    compromises : `compromises_of` the study
    warned : notes that a reader of the terminal has seen
    """
    data = axes_summary(result, compromises) | {"counts": asdict(result.counts)}
    facts = map(Fact, [*alone_words(result), *film_of_cases(result)])
    return replace(document_of(result, data, compromises, [*facts], warned), kind="study of several cases")


def alone_words(result: CasesResult) -> list[str]:
    """Return how far each axis that is moved alone moves the optimum, widest first, for the panels of its figure."""
    names = [axis.name for axis in result.study.axis if axis.alone]
    groups = alone_groups(result, names)[0] if names else []
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


def axes_summary(result: CasesResult, compromises: Sequence[Compromise]) -> dict[str, Any]:
    """Return the result as in summary.json."""
    more = {"compromises": [found.as_dict() for found in compromises], "claims": [each.as_dict() for each in verdicts(result)]}
    return result.as_dict() | {name: values for name, values in more.items() if values}


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
    plates = [*plate_names(study), *(f"conditions_{number + 1}" for number in range(SHOWN_COMPROMISES))]
    own = {f"{case.folder}/{name}" for case in shown_cases(cases) for name in report_files(case.settings)}
    plates += [NAME] * study.noise_budget
    return {"report.html", "summary.json", SETTINGS_FILE, "optima.csv", "conditions.csv", *figure_files(plates), *own}


def study_report(
    result: StudyResult,
    compromises: Sequence[Compromise],
    seconds: dict[str, float],
    workers: Workers | None = None,
    figures: Figures = "svg",
) -> Document:
    """Return the document of any study with its page and all other files; the first cases of one with axes have their own.

    Only the wall times in the page vary: everything else is reproducible byte for byte, and does not depend on the workers.

    compromises : `compromises_of` the study
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
    return with_files_of_study(replace(axes_page(result, compromises, seconds, parts), parts=pages), result)


def axes_page(
    result: CasesResult,
    compromises: Sequence[Compromise],
    seconds: dict[str, float],
    parts: Sequence[tuple[Case[Study], StudyResult]],
) -> Document:
    """Return the document of a study with axes or conditions, with its page.

    parts : cases with a page of their own
    """
    figures = [Plot(partial(conditions_plate, found, number)) for number, found in enumerate(compromises[:SHOWN_COMPROMISES], 1)]
    others = [compromise_of_others(found) for found in compromises if found.others]
    budgets, header = noise_budgets(result), result.irradiance.header
    best = (Link("The same with all digits (CSV)", "optima.csv"),)
    made = f"{result.counts}. Study seed {result.study.seed}; first render: {rendered_words(header)}."
    listed = [
        (Link(case.words or "the study's own settings", f"{case.folder}/report.html"), f": {optimum_line(part.curves[0])}")
        for case, part in parts
    ]
    all_conditions = (Link("All conditions and compromises (CSV)", "conditions.csv"),)
    return replace(
        axes_document(result, compromises),
        data=axes_summary(result, compromises),
        about=[_about(result, compromises)],
        sections=(
            Section("conditions", "Conditions", [*figures, *others, all_conditions] if figures else ()),
            Section("maps", "Along the axes", map(plot_of, axis_plates(result))),
            Section("alone", "One at a time", [plot_of(plate) for plate in [alone_plate(result)] if plate]),
            Section("claims", "The paper's statements", _claims(result)),
            Section("optima", "Optima", [optima_table(result.curves), best]),
            budgets_section(budgets),
            Section("cases", "Cases with pictures", [Listed(listed)]),
            Section("made", "Reproducibility", [made, made_with(pairs("seconds", seconds, ".2f"))]),
        ),
        files={
            "optima.csv": table_csv(optima_columns(result)),
            **({"conditions.csv": table_csv(conditions_table(compromises))} if compromises else {}),
        },
    )


def compromise_of_others(found: Compromise) -> Block:
    """Return the pixel sizes that suit all conditions by further metrics."""
    answers = [compromise_answer(each) for each in found.others.values()]
    return Listed(plain_text(joined([answer.head, *answer.below])) for answer in answers)


def _about(result: CasesResult, compromises: Sequence[Compromise]) -> str:
    """Return what the numbers of the page mean."""
    by_delta_e = result.curves[0].judged_by_delta_e
    difference = "ΔE there over" if by_delta_e else f"{result.curves[0].metric.words} there against"
    regret = (
        f"The regret of a pixel in a condition is its {difference} that of the best pixel for that condition; with the least worst "
        "regret, it is that much at most in every condition. "
    )
    meaning = f"{DELTA_E} " if result.curves[0].has_delta_e else ""
    return (
        f"Each pixel size is simulated on the same die under each of the {result.counts.cases} cases below. {meaning}"
        f"{regret * bool(compromises)}All cases have the same random numbers, so that they differ by their settings only."
    )


def _claims(result: CasesResult) -> list[Block]:
    """Return the paper's statements, and the cases that change a verdict, if they are compared."""
    rows = []
    for each in verdicts(result):
        found, turned = each.finding, len(each.turned_by)
        changed = f"{turned} of {result.counts.cases - 1}{f': {each.words}' if turned else ''}"
        rows.append((found.statement, found.given, found.found, agrees(found.agrees), changed))
    head = ("statement of the paper", "paper", "first case", "agrees", "cases that change the verdict")
    table = Table("the paper's statements", head, rows, words=None, stacks=True)
    return [table] if rows else []
