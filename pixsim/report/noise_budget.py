"""Noise budgets of pixels as one table and one figure: of a run, and of the best sizes of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.digits import rounded
from pixsim.base.tables import Column
from pixsim.show.document import DocumentTable, Plot, Section
from pixsim.show.figures import COLOURS, finish, new_figure
from pixsim.show.pages import Drawing, figure

if TYPE_CHECKING:
    from pixsim.viewer.noise_budget import NoiseBudget

NAME = "noise_budget"  # of the figure
ORDER = (
    "Each cause is switched off in the order of the table, and stays off. Variances add: the electrons of all causes of noise are "
    "those of the frame, where nothing clips. Parts of the mean ΔE depend on the order: of faults that hide one another, the one "
    "that is switched off later takes off more, and one that is nearly nothing may be below 0, by the random numbers of another "
    "draw. The ideal picture has the render's noise, too."
)
SHOWN = 6  # pixels in one figure
BAR_IN, MARGIN_IN = 0.28, 1.1


def budget_columns(budgets: Mapping[str, NoiseBudget]) -> dict[str, Column]:
    """Return budgets by the words of their pixels as columns, a row for each cause of each pixel, and for its sums."""
    rows: list[tuple[str, str, str, float, float]] = []
    nothing = float("nan")
    for label, budget in budgets.items():
        for cause, noise_e, delta_e in budget.rows():
            rows.append((label, cause, budget.part_of(cause), nothing if noise_e is None else noise_e, delta_e))
        rows.append((label, "render", "", budget.render_e, nothing))
        rows.append((label, "remainder", budget.part_of("remainder"), nothing, budget.remainder_delta_e))
        rows.append((label, "all causes", "", budget.total_e, budget.mean_delta_e))
        rows.append((label, "measured", "", budget.measured_e, budget.mean_delta_e))
    names = "pixel", "cause", "part", "noise_e", "delta_e"
    return {name: [row[at] for row in rows] for at, name in enumerate(names)}


def parts_table(budgets: Mapping[str, NoiseBudget]) -> DocumentTable:
    """Return the table of the mean ΔE by kinds of causes, a row for each pixel, without kinds that are 0 for all of them."""
    parts = {label: budget.parts for label, budget in budgets.items()}
    kinds = [kind for kind in next(iter(parts.values())) if any(delta_e[kind] for delta_e in parts.values())]
    rows = []
    for label, delta_e in parts.items():
        values = [budgets[label].mean_delta_e, *(delta_e[kind] for kind in kinds)]
        rows.append((label, *(f"{value:z.3f}" for value in values)))
    return DocumentTable("parts of the mean ΔE", ("pixel", "mean ΔE", *kinds), tuple(rows))


def budget_table(budgets: Mapping[str, NoiseBudget]) -> DocumentTable:
    """Return the table of a page: causes down, electrons and ΔE of each pixel across."""
    all_of, several = budgets.values(), len(budgets) > 1
    causes = dict.fromkeys(cause for budget in all_of for cause in budget.delta_e)

    def row(words: str, *values: tuple[float | None, float | None]) -> tuple[str, ...]:
        shown = (("" if e is None else rounded(e, 3), "" if delta_e is None else f"{delta_e:.4f}") for e, delta_e in values)
        return words, *(cell for pair in shown for cell in pair)

    rows = [row(cause, *((each.electrons_e.get(cause), each.delta_e.get(cause)) for each in all_of)) for cause in causes]
    rows.append(row("remainder", *((None, each.remainder_delta_e) for each in all_of)))
    rows.append(row("all causes", *((each.total_e, each.mean_delta_e) for each in all_of)))
    rows.append(row("measured", *((each.measured_e, None) for each in all_of)))
    if any(each.render_e for each in all_of):
        rows.append(row("render, beside them", *((each.render_e, None) for each in all_of)))
    heads = (f"{label}\n{unit}" if several else unit for label in budgets for unit in ("noise (e-)", "mean ΔE"))
    return DocumentTable("noise budget", ("cause\n" if several else "cause", *heads), tuple(rows))


@figure(
    "noise_budget",
    "Noise in electrons, and parts of the mean ΔE, by cause, each switched off from above to below, of up to six pixels. The "
    "table has all pixels.",
)
def budget_plate(budgets: Mapping[str, NoiseBudget]) -> Drawing:
    """Draw what each cause takes off the mean ΔE, and the electrons of each cause of noise, as bars."""
    shown = dict(list(budgets.items())[:SHOWN])
    causes = list(dict.fromkeys(cause for budget in shown.values() for cause in budget.delta_e))
    figure = new_figure(8.6, MARGIN_IN + BAR_IN * len(causes))
    noise, delta_e = figure.subplots(1, 2, sharey=True)
    height = 0.8 / len(shown)
    for number, (label, budget) in enumerate(shown.items()):
        at = np.arange(len(causes)) + (number - (len(shown) - 1) / 2) * height
        style = {"height": height, "color": COLOURS[number % len(COLOURS)], "label": label}
        noise.barh(at, [budget.electrons_e.get(cause, 0.0) for cause in causes], **style)
        delta_e.barh(at, [budget.delta_e.get(cause, 0.0) for cause in causes], **style)
    noise.set_yticks(range(len(causes)), causes)
    noise.invert_yaxis()
    finish(noise, "noise (e- rms)", "", None)
    finish(delta_e, "part of the mean ΔE", "", None)
    if len(shown) > 1:
        delta_e.legend(frameon=False, fontsize=8)
    return figure, budget_columns(budgets)


def budgets_section(budgets: Mapping[str, NoiseBudget]) -> Section:
    """Return the section of a page on noise budgets; empty without them."""
    blocks = (parts_table(budgets), budget_table(budgets), Plot(lambda: budget_plate(budgets)), ORDER) if budgets else ()
    return Section("causes", "Noise budget", blocks, brief=True)
