"""The tornado chart of a sensitivity study, its table and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixsim.curve_plates import interval_columns
from pixsim.figures import COLOURS, literal, new_figure
from pixsim.files import versions, write_json
from pixsim.pages import write_page
from pixsim.plates import Column, Plate
from pixsim.report import write_plates
from pixsim.sensitivity import Case, SensitivityResult, turned_words
from pixsim.wording import interval_words


def tornado(result: SensitivityResult) -> Plate:
    """Range of the optimum and of the best mean ΔE of each assumption, widest first."""
    groups = result.by_variation()
    reference = result.base_case.reference
    base = reference.optimum
    figure = new_figure(9.5, 0.42 * len(groups) + 1.4)
    left, right = figure.subplots(1, 2, sharey=True)
    for row, cases in enumerate(groups.values()):
        optima = [(case.label, case.reference.optimum) for case in cases]
        draw_bar(left, row, base.pitch_um, [(label, best.pitch_um, best.inside) for label, best in optima])
        draw_bar(right, row, base.mean_delta_e, [(label, best.mean_delta_e, True) for label, best in optima])
    for axes, at, label in ((left, base.pitch_um, "optimal pixel size (µm)"), (right, base.mean_delta_e, "best mean ΔE")):
        axes.axvline(at, color="0.2", lw=1)
        axes.set_xlabel(f"{label}, {literal(reference.label)}")
        axes.grid(axis="x", alpha=0.25)
        axes.use_sticky_edges = False
        axes.margins(x=0.15, y=0.03)
    left.set_yticks(range(len(groups)), list(groups))
    left.invert_yaxis()
    caption = (
        f"Each assumption moved alone from the base ({base.pitch_um:.2f} µm, ΔE {base.mean_delta_e:.3f}: vertical lines) over its "
        "plausible range. The wider the bar, the more it decides. A hollow point: the optimum is at the end of the pitches."
    )
    return Plate("tornado", caption, figure, case_table(result))


def draw_bar(axes: Any, row: int, base: float, points: list[tuple[str, float, bool]]) -> None:
    """A bar from the lowest to the highest value, the base among them, with a labelled point for each setting."""
    values = [base, *(value for _, value, _ in points)]
    axes.barh(row, max(values) - min(values), left=min(values), height=0.55, color=COLOURS[0], alpha=0.25)
    for index, (label, value, solid) in enumerate(sorted(points, key=lambda point: point[1])):
        axes.plot(value, row, "o", ms=4, color=COLOURS[0], mfc=COLOURS[0] if solid else "white")
        axes.annotate(label, (value, row), textcoords="offset points", xytext=(0, 5 if index % 2 else -10), fontsize=7, ha="center")


def case_table(result: SensitivityResult) -> dict[str, Column]:
    """One row for each case and technology."""
    rows = [(case, curve) for case in (result.base_case, *result.cases) for curve in case.curves]
    return {
        "variation": [case.variation for case, _ in rows],
        "setting": [case.label for case, _ in rows],
        "technology": [curve.technology for _, curve in rows],
        "optimum_um": [curve.optimum.pitch_um for _, curve in rows],
        **interval_columns([curve for _, curve in rows]),
        "optimum_fill_factor": [curve.optimum_fill_factor for _, curve in rows],
        "mean_delta_e": [curve.optimum.mean_delta_e for _, curve in rows],
        "inside": [str(curve.optimum.inside) for _, curve in rows],
    }


def differing(case: Case, base: Case) -> list[str]:
    """The statements of the paper whose verdict is not the base's."""
    return [statement for statement, agrees in case.agrees.items() if agrees != base.agrees.get(statement, agrees)]


def write_sensitivity_report(result: SensitivityResult, folder: Path, seconds: dict[str, float]) -> Path:
    """Write summary.json, figures/tornado.svg and .csv, provenance.json and report.html; returns the report's path."""
    plate = tornado(result)
    ((_, image, data),) = write_plates(folder, [plate])
    write_json(folder / "summary.json", result.as_dict())
    provenance = {"versions": versions(), "seconds": seconds}
    write_json(folder / "provenance.json", provenance)
    page = {
        "interval": interval_words,
        "sensitivity": result.sensitivity,
        "plate": plate,
        "image": image,
        "data": data,
        "claims": [
            (row, len(turning), turned_words([(case.variation, case.label) for case in turning]))
            for row, turning in ((row, result.turning(row.statement)) for row in result.base_rows)
        ],
        "cases": [(case, differing(case, result.base_case)) for case in (result.base_case, *result.cases)],
        "header": result.base.irradiance.header,
        "provenance": provenance,
    }
    return write_page(folder / "report.html", "sensitivity.html.j2", page)
