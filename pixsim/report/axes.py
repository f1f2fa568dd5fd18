"""The report of a study with axes or conditions: its compromises and maps, and a whole report of its first cases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

from pixsim.base.config import SETTINGS_FILE
from pixsim.base.files import check_replaceable, output_folder, publishing, versions, write_json
from pixsim.base.headline import headline_lines, with_headline
from pixsim.base.parameters import Study
from pixsim.report.maps import alone_groups, alone_plate, axis_plates, plate_names
from pixsim.report.study import PARTS_FILE, parts_rows, report_files, write_pages
from pixsim.report.wording import (
    compromise_lines,
    film_words,
    interval_text,
    no_difference_words,
    optimum_line,
    optimum_parts,
    study_light_lines,
    study_lines,
    study_view_line,
)
from pixsim.show.figures import LOOKS, literal, new_figure, own_style
from pixsim.show.pages import Column, Plate, table_csv, write_figures
from pixsim.show.render import write_page
from pixsim.studies.cases import Case, cases_of
from pixsim.studies.claims import verdicts
from pixsim.studies.conditions import Compromise, Regret
from pixsim.studies.engine import Workers
from pixsim.studies.optimum import Optimum, mean_and_ci95
from pixsim.studies.oversampling import FilmError
from pixsim.studies.parts import parts_table
from pixsim.studies.result import CasesResult, alike_words, fresnel_column, interval_words, within_words
from pixsim.studies.unconverged import study_unconverged_lines

SHOWN_CASES = 4  # with a report of their own
SHOWN_COMPROMISES = 6  # with a figure of their own
LINES_SHOWN = 12  # optima that the terminal and the head of the page list


def shown_cases(cases: Sequence[Case]) -> list[Case]:
    """Return the cases with a report of their own: the first combination of values under each condition, at most 4."""
    return [case for case in cases if (case.at, case.alone) == (cases[0].at, cases[0].alone)][:SHOWN_CASES]


@own_style()
def conditions_plate(found: Compromise, number: int) -> Plate:
    """Plot mean ΔE against pitch in each condition, its weighted mean, and the pixel sizes that suit all conditions."""
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    table: dict[str, list[float | str]] = {name: [] for name in ("condition", "weight", "pitch_um", "mean_delta_e", "ci95_delta_e")}
    for curve, weight, look in zip(found.curves, found.weights, cycle(LOOKS[:2] + LOOKS[3:]), strict=False):
        mean, ci95 = mean_and_ci95(curve.delta_e)
        axes.errorbar(curve.pitch_um, mean, ci95, fmt=look.marker, ms=4, lw=1, capsize=2, color=look.colour)
        best = f"{curve.optimum.pitch_um:.2f} µm" if curve.optimum.inside else "best at an end"
        label = f"{literal(curve.condition)} ({100 * weight:.0f} %): {best}"
        axes.plot(curve.fit.pitch_um, curve.fit.delta_e, lw=1.5, label=label, **look.stroke)
        if curve.optimum.inside:
            axes.plot(curve.optimum.pitch_um, curve.optimum.mean_delta_e, "v", ms=9, mfc="white", mec=look.colour, mew=1.5)
        for values in zip(curve.pitch_um.tolist(), mean.tolist(), ci95.tolist(), strict=True):
            for name, value in zip(table, (curve.condition, weight, *values), strict=True):
                table[name].append(value)
    if found.weighted is not None and found.best is not None:
        label = f"weighted mean: {found.best.pitch_um:.2f} µm"
        axes.plot(found.weighted.pitch_um, found.weighted.delta_e, lw=2.2, label=label, **LOOKS[2].stroke)
        axes.plot(found.best.pitch_um, found.best.mean_delta_e, "*", ms=12, color=LOOKS[2].colour)
    if found.regret is not None:
        at_um = found.regret.pitch_um
        axes.axvline(at_um, color="0.4", ls=":", lw=1.5, label=f"least worst regret: {at_um:.2f} µm")
    axes.set(xlabel="pixel size (µm)", ylabel="mean ΔE, S-CIELAB")
    axes.set_ylim(0, axes.get_ylim()[1] * 1.1)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    return Plate(f"conditions_{number}", conditions_caption(found), figure, dict(table))


def conditions_caption(found: Compromise) -> str:
    """Return what the figure of a compromise shows, with its numbers."""
    names = ", ".join(curve.condition for curve in found.curves)
    if found.best is None or found.regret is None:
        return f"{found.label}: {names} share too few pixel sizes for one that suits all. Mean ΔE in each condition."
    best_of = [(curve.condition, curve.optimum) for curve in found.curves]
    own = "; ".join(f"{name}: {best.pitch_um:.2f} µm" if best.inside else f"{name}: at an end" for name, best in best_of)
    return (
        f"For {names} together ({found.label}), {found.best.pitch_um:.2f} µm has the least weighted mean ΔE (star), "
        f"{found.regret.pitch_um:.2f} µm the least worst regret (dotted line): at most {found.regret.delta_e:.3f} ΔE over the best "
        f"of each condition, in {found.regret.condition}. The best of each condition (triangles): {own}. Points: means over "
        "sensors with their 95 % intervals."
    )


def conditions_table(found: Sequence[Compromise]) -> dict[str, Column]:
    """Return a table with a row for each condition and each compromise of all combinations."""
    table: dict[str, list[float | str]] = {}

    def add(pixel: str, of: str, weight: float | str, size: Optimum | Regret, delta_e: float | str, regret: float | str) -> None:
        low, high = ("" if end is None else end for end in size.interval_um)
        row: dict[str, float | str] = {"pixel": pixel, "pixel_of": of, "weight": weight, "pitch_um": size.pitch_um}
        row |= {"interval_low_um": low, "interval_high_um": high, "mean_delta_e": delta_e, "worst_regret_delta_e": regret}
        for name, value in row.items():
            table.setdefault(name, []).append(value)

    for each in found:
        for curve, weight in zip(each.curves, each.weights, strict=True):
            add(each.label, curve.condition, weight, curve.optimum, curve.optimum.mean_delta_e, "")
        if each.best is not None:
            worst = max(each.regrets_at(each.best.pitch_um).values())
            add(each.label, "least weighted mean ΔE", "", each.best, each.best.mean_delta_e, worst)
        if each.regret is not None:
            add(each.label, "least worst regret", "", each.regret, "", each.regret.delta_e)
    return dict(table)


def optima_table(result: CasesResult) -> dict[str, Column]:
    """Return a table with the optimum of each technology, combination and condition."""
    table: dict[str, list[float | str]] = {}
    for curve in result.curves:
        best = curve.optimum
        row: dict[str, Any] = (
            {"technology": curve.technology} | curve.at | ({"condition": curve.condition} if curve.condition else {})
        )
        row |= {"optimum_um": best.pitch_um, "interval_low_um": best.interval_um[0], "interval_high_um": best.interval_um[1]}
        row |= {"inside": str(best.inside), "mean_delta_e": best.mean_delta_e}
        for name, value in row.items():
            table.setdefault(name, []).append("" if value is None else value)
    return dict(table) | fresnel_column(result.curves, [curve.optimum.pitch_um for curve in result.curves])


def axes_lines(result: CasesResult, compromises: Sequence[Compromise]) -> list[str]:
    """Return the result as lines of text: compromises and optima, of very many the first ones, then axes that are moved alone."""
    answers = [compromise_lines(found) for found in compromises]
    answers += [headline_lines(optimum_parts(curve)) for curve in result.curves if not curve.alone]
    lines = [line for answer in answers[:LINES_SHOWN] for line in answer]
    if len(answers) > LINES_SHOWN:
        lines.append(f"and {len(answers) - LINES_SHOWN} more: optima.csv")
    lines += alone_lines(result)
    lines += [*study_lines(result), *film_lines(result)]
    return lines


def alone_lines(result: CasesResult) -> list[str]:
    """Return how far each axis that is moved alone moves the optimum, widest first, for the panels of its figure."""
    names = [axis.name for axis in result.study.axis if axis.alone]
    groups = alone_groups(result, names)[0] if names else []
    lines = []
    for group in groups:
        found = []
        for name in names:
            optima = [group.base.optimum, *(curve.optimum for curve in group.moved[name])]
            sizes, least = [best.pitch_um for best in optima], [best.mean_delta_e for best in optima]
            end = "" if all(best.inside for best in optima) else " (an end of the sizes tried)"
            text = f"{min(sizes):.2f} to {max(sizes):.2f} µm{end}, least mean ΔE {min(least):.3f} to {max(least):.3f}"
            found.append((max(sizes) - min(sizes), f"{', '.join(filter(None, (group.label, name)))} alone: {text}"))
        lines += [line for _, line in sorted(found, key=lambda each: -each[0])]
    return lines


def axes_summary(result: CasesResult, compromises: Sequence[Compromise]) -> dict[str, Any]:
    """Return the result as in summary.json."""
    more = {"compromises": [found.as_dict() for found in compromises], "claims": [each.as_dict() for each in verdicts(result)]}
    return result.as_dict() | {name: values for name, values in more.items() if values}


def film_lines(result: CasesResult) -> list[str]:
    """Return a line on each film of the cases, with its largest error."""
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
    files = {f"figures/{name}.{suffix}" for name in plates for suffix in ("svg", "csv")}
    own = {f"{case.folder}/{name}" for case in shown_cases(cases) for name in report_files(case.study)}
    return {"report.html", "summary.json", SETTINGS_FILE, "optima.csv", "conditions.csv", PARTS_FILE, *files, *own}


def write_axes_report(
    result: CasesResult,
    folder: Path,
    seconds: dict[str, float],
    workers: Workers,
    more: Callable[[Path], None] | None = None,
    *,
    compromises: Sequence[Compromise],
) -> Path:
    """Write the report of a study with axes or conditions, with a folder for each of its first cases.

    more : writes further files to the new folder
    compromises : `compromises_of` the study

    Returns the path of report.html. Raises PixsimError if the folder cannot be written, or holds a file of such a name that
    pixsim did not write.
    """
    study = result.study
    shown = shown_cases(
        [Case(part.study, curve.at, curve.condition, curve.alone) for part in result.parts for curve in part.curves[:1]]
    )
    parts = result.parts[: len(shown)]
    summary = axes_summary(result, compromises)
    with output_folder(folder):
        check_replaceable(folder, axes_files(study))
        with publishing(folder, "study", {"seconds": seconds}) as unfinished:
            (unfinished / SETTINGS_FILE).write_text(result.settings_toml, encoding="utf-8")
            for case, part in zip(shown, parts, strict=True):
                own = unfinished / case.folder
                own.mkdir()
                write_pages(part, own, seconds, workers)
            plates = {
                "conditions": [conditions_plate(found, number + 1) for number, found in enumerate(compromises[:SHOWN_COMPROMISES])],
                "maps": axis_plates(result),
                "alone": [plate] if (plate := alone_plate(result)) else [],
            }
            drawn = {name: write_figures(unfinished, [plate.drawn() for plate in group]) for name, group in plates.items()}
            (unfinished / "optima.csv").write_text(table_csv(optima_table(result)), encoding="utf-8")
            if compromises:
                (unfinished / "conditions.csv").write_text(table_csv(conditions_table(compromises)), encoding="utf-8")
            if parts_of_error := parts_table(result):
                (unfinished / PARTS_FILE).write_text(table_csv(parts_of_error), encoding="utf-8")
            write_json(unfinished / "summary.json", summary)
            page = {
                "study": study,
                "interval": interval_words,
                "interval_text": interval_text,
                "no_difference": no_difference_words,
                "within": within_words,
                "alike": alike_words,
                "first": [with_headline(optimum_parts(curve)) for curve in result.parts[0].curves],
                "curves": result.curves,
                "compromises": compromises,
                "plates": drawn,
                "claims": [(each.finding, len(each.turned_by), each.words) for each in verdicts(result)],
                "cases": [(case, optimum_line(part.curves[0])) for case, part in zip(shown, parts, strict=True)],
                "shown": study_view_line(result),
                "films": film_lines(result),
                "unconverged": study_unconverged_lines(result),
                "lens": study_light_lines(result),
                "error_parts": parts_rows(parts_of_error),
                "notes": result.notes,
                "counts": result.counts,
                "header": result.irradiance.header,
                "provenance": {"versions": versions(), "seconds": seconds},
            }
            write_page(unfinished / "report.html", "axes.html.j2", page)
            if more:
                more(unfinished)
    return folder / "report.html"
