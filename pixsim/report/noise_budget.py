"""Noise budgets of pixels as one table and one figure: of a run, and of the best sizes of a
study.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.digits import rounded
from pixsim.base.tables import Column, columns_of
from pixsim.show.document import DocumentTable, Plot, Section
from pixsim.show.figures import COLOURS, finish, literal, new_figure
from pixsim.show.pages import Drawing, figure

if TYPE_CHECKING:
    from pixsim.viewer.noise_budget import NoiseBudget

NAME = "noise_budget"  # of the figure
_REMAINDER = "remainder"
RENDER = "render"
_ALL_CAUSES = "all causes"
MEASURED = "measured"
_ORDER = (
    "Each cause is switched off in the order of the table, and stays off. Variances add; parts of"
    " the mean ΔE depend on the order."
)
_MAX_SIZES = 6  # pixels in one figure
_BAR_IN = 0.28
_MARGIN_IN = 1.1
LEGEND_IN = 0.5


def _budget_numbers(budget: NoiseBudget) -> dict[str, tuple[float, float]]:
    """Return noise in electrons and mean ΔE of each cause of a budget, and of its sums; NaN for
    what it does not have.
    """
    undefined = float("nan")
    causes = {
        cause: (budget.electrons_e.get(cause, undefined), delta_e)
        for cause, delta_e in budget.delta_e.items()
    }
    return causes | {
        RENDER: (budget.render_e, undefined),
        _REMAINDER: (undefined, budget.remainder_delta_e),
        _ALL_CAUSES: (budget.total_e, budget.mean_delta_e),
        MEASURED: (budget.measured_e, budget.mean_delta_e),
    }


def _budget_columns(budgets: Mapping[str, NoiseBudget]) -> dict[str, Column]:
    """Return budgets by the words of their pixels as columns, a row for each cause of each pixel,
    and for its sums.
    """
    rows: list[dict[str, float | str | None]] = []
    for label, budget in budgets.items():
        for cause, (noise_e, delta_e) in _budget_numbers(budget).items():
            part = budget.part_of(cause) if cause in budget.delta_e or cause == _REMAINDER else ""
            rows.append(
                {
                    "pixel": label,
                    "cause": cause,
                    "part": part,
                    "noise_e": noise_e,
                    "delta_e": delta_e,
                }
            )
    return columns_of(rows)


def _budget_table(budgets: Mapping[str, NoiseBudget]) -> DocumentTable:
    """Return the table of a page: causes down, electrons and ΔE of each pixel across, with the mean
    ΔE of each kind of causes.
    """
    kinds = {
        cause: budget.part_of(cause)
        for budget in budgets.values()
        for cause in (*budget.delta_e, _REMAINDER)
    }
    numbers = [_budget_numbers(budget) for budget in budgets.values()]
    undefined = float("nan"), float("nan")
    rows: list[tuple[str, ...]] = []

    def add_row(words: str, *values: tuple[float, float]) -> None:
        cells: list[str] = []
        for noise_e, delta_e in values:
            cells += [rounded(noise_e, 3), f"{delta_e:z.3f}"]
        rows.append((words, *("" if cell == "nan" else cell for cell in cells)))

    # Each kind of causes, one cause a row, and their sum.
    for kind in dict.fromkeys(kinds.values()):
        kind_causes = [cause for cause in kinds if kinds[cause] == kind]
        for cause in kind_causes:
            add_row(cause, *(budget_values.get(cause, undefined) for budget_values in numbers))
        if len(kind_causes) > 1:
            sums = [(float("nan"), budget.parts[kind]) for budget in budgets.values()]
            add_row(f"{kind}, together", *sums)

    for cause in (_ALL_CAUSES, MEASURED, RENDER):
        if any(budget_values[cause][0] for budget_values in numbers):
            add_row(cause, *(budget_values[cause] for budget_values in numbers))

    units = ("noise (e-)", "mean ΔE")
    if len(budgets) == 1:
        return DocumentTable("noise budget", ("cause", *units), rows)
    heads = [f"{label}\n{unit}" for label in budgets for unit in units]
    return DocumentTable("noise budget", ("cause\n", *heads), rows)


@figure(
    "noise_budget",
    "Noise in electrons, and parts of the mean ΔE, by cause, each switched off from above to below,"
    " of up to six pixels. The table has all pixels.",
)
def _budget_plate(budgets: Mapping[str, NoiseBudget]) -> Drawing:
    """Draw what each cause takes off the mean ΔE, and the electrons of each cause of noise, as
    bars.
    """
    drawn_budgets = dict(list(budgets.items())[:_MAX_SIZES])
    count = len(drawn_budgets)
    causes = list(
        dict.fromkeys(cause for budget in drawn_budgets.values() for cause in budget.delta_e)
    )
    height_in = _MARGIN_IN + _BAR_IN * len(causes) + LEGEND_IN * (count > 1)
    figure = new_figure(8.6, height_in)
    panels = figure.subplots(1, 2, sharey=True)

    height = 0.8 / count
    for number, (label, budget) in enumerate(drawn_budgets.items()):
        at = np.arange(len(causes)) + (number - (count - 1) / 2) * height
        colour = COLOURS[number % len(COLOURS)]
        for axes, values in zip(panels, (budget.electrons_e, budget.delta_e), strict=True):
            widths = [values.get(cause, 0.0) for cause in causes]
            axes.barh(at, widths, height, color=colour, label=literal(label))

    panels[0].set_yticks(range(len(causes)), causes)
    panels[0].invert_yaxis()
    finish(panels[0], "noise (e- rms)", "", None)
    finish(panels[1], "part of the mean ΔE", "", None)
    if count > 1:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8
        )
    return figure, _budget_columns(budgets)


def budgets_section(budgets: Mapping[str, NoiseBudget]) -> Section:
    """Return the section of a page on noise budgets; empty without them."""
    blocks = (
        (_budget_table(budgets), Plot(lambda: _budget_plate(budgets)), _ORDER) if budgets else ()
    )
    return Section("causes", "Noise budget", blocks, brief=True)
