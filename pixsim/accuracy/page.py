"""A survey on disk: CSV tables, figures, summary.json and one HTML file that opens offline."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pixsim.accuracy.lines import SHORT, accuracy_lines, errors_told, number, verdict
from pixsim.accuracy.plots import plates_of
from pixsim.accuracy.result import METRICS, Accuracy
from pixsim.files import output_folder, replacing, versions, write_json
from pixsim.pages import write_page
from pixsim.report import write_plates


def write_accuracy(found: Accuracy, out: Path) -> Path:
    """Write everything into a folder; returns the report's path."""
    plates = plates_of(found)
    with output_folder(out) as folder:
        shown = write_plates(folder, plates)
        rungs = [vars(each) for each in found.rungs]
        write_table(folder / "ladders.csv", rungs)
        write_table(folder / "stability.csv", [case.as_dict() for case in found.cases])
        if found.solvers:
            write_table(folder / "solvers.csv", [each.as_dict() for each in found.solvers])
        write_json(folder / "summary.json", found.as_dict())
        metrics = [metric for metric in METRICS if found.rivals(metric)]
        orders = [(name, metric, found.order(name, metric)) for name in found.names for metric in METRICS]
        page = {
            "found": found,
            "errors": errors_told(found),
            "verdicts": [(METRICS[metric], verdict(found, metric), found.beaten(metric)) for metric in metrics],
            "orders": [(name, SHORT[metric], order) for name, metric, order in orders if order],
            "number": number,
            "plates": shown,
            "lines": accuracy_lines(found),
            "versions": versions(),
        }
        return write_page(folder / "report.html", "accuracy.html.j2", page)


def write_table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)
