"""Files and page of what is not known: the distribution of each optimum over sensor types, and which inputs matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pixsim.base.files import write_json
from pixsim.base.headline import headline_lines
from pixsim.show.pages import Drawn, write_figures
from pixsim.show.render import write_page
from pixsim.studies.result import StudyResult
from pixsim.studies.uncertainty import NORMAL_95, UncertaintyResult, distribution_plate, indices_plate

PAGE = "uncertainty.html"
MOST_RESULTS = 20  # technologies × values × conditions with a section of the page


def uncertainty_files() -> set[str]:
    """Return the names of all files that `write_uncertainty` may write."""
    kinds = [f"uncertainty_{kind}_{number}" for number in range(1, MOST_RESULTS + 1) for kind in ("distribution", "indices")]
    figures = {f"figures/{kind}.{suffix}" for kind in kinds for suffix in ("svg", "csv")}
    return {PAGE, "uncertainty.json", *figures, *(f"sensor_types_{number}.csv" for number in range(1, MOST_RESULTS + 1))}


def write_uncertainty(folder: Path, result: StudyResult) -> None:
    """Write uncertainty.html, uncertainty.json, a table of the sensor types and the figures of each optimum to a new folder."""
    sections: list[tuple[UncertaintyResult, Sequence[Drawn], list[tuple[str, str]]]] = []
    summary: list[dict[str, Any]] = []
    study, total = result.study, result.uncertainty[0].total
    for number, each in enumerate(result.uncertainty[:MOST_RESULTS], 1):
        plates = [distribution_plate(each)] if total else [distribution_plate(each), indices_plate(each)]
        drawn = write_figures(folder, [replace(plate, name=f"{plate.name}_{number}").drawn() for plate in plates])
        each.to_csv(folder / f"sensor_types_{number}.csv")
        content = each.as_dict()
        if total:
            del content["first_order"]
            content["indices"] = each.total_indices
        summary.append(content)
        sections.append((each, drawn, verdict_rows(each)))
    write_json(folder / "uncertainty.json", {"study": study.name, "results": summary})
    page = {"study": study, "sections": sections, "summary": summary, "total": total}
    write_page(folder / PAGE, "uncertainty.html.j2", page)


def verdict_rows(found: UncertaintyResult) -> list[tuple[str, str]]:
    """Return each statement with the probability that it holds and its 95 % interval, as text."""
    return [(name, f"{each.probability:.2f} ({each.low:.2f} to {each.high:.2f})") for name, each in found.verdicts.items()]


def uncertainty_lines(found: Sequence[UncertaintyResult]) -> list[str]:
    """Return the distributions and the probabilities of all verdicts as lines of text."""
    lines = []
    for each in found:
        ends = [each.optimum.quantiles[name] for name in ("p05", "p50", "p95")]
        low, middle, high = ("beyond the sizes tried" if end is None else f"{end:.2f} µm" for end in ends)
        name = f"{each.label}: " if each.label else ""
        types = f"{len(each.outcomes)} sensor types"
        own = f"each is known to ±{NORMAL_95 * each.optimum.own_sd:.2g} µm by its own 95 % interval" if each.optimum.own_sd else ""
        lines += headline_lines([f"{name}optimum of {types}: median {middle}, nine tenths from {low} to {high}", own])
        lines += [f"{name}probability that {statement}: {words}" for statement, words in verdict_rows(each)]
    return lines
