"""How results show themselves: figures for `.plot()`, HTML for a notebook's cell, tables for `.to_csv()`."""

from __future__ import annotations

import csv
import html
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.curve_plates import delta_e_against_pitch
from pixsim.figures import new_figure, svg_text
from pixsim.files import data_uri, replacing
from pixsim.pictures import DELTA_E_SHOWN, VIEWING_GAMMA
from pixsim.wording import interval_words, within_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pixsim.score import Score
    from pixsim.study_result import StudyResult

PANEL_IN = 3.1  # width of each picture of a score


def score_figure(score: Score) -> Figure:
    """The ideal picture, the sensor's, and the ΔE map on the fixed scale, one dot of the display a sample."""
    figure = new_figure(3 * PANEL_IN + 0.6, PANEL_IN + 0.3)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for each, picture, title in zip(axes, (score.ideal, score.image), ("ideal", "sensor"), strict=False):
        each.imshow(np.clip(picture, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        each.set_title(title)
    shown = axes[2].imshow(score.delta_e, cmap="viridis", vmin=0, vmax=DELTA_E_SHOWN, interpolation="nearest")
    axes[2].set_title(f"S-CIELAB ΔE, mean {score.mean_delta_e:.3f}")
    figure.colorbar(shown, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
    for each in axes:
        each.set_xlabel("display dots")
    return figure


def study_figure(result: StudyResult) -> Figure:
    """Mean ΔE against pixel size, a curve for each technology."""
    return delta_e_against_pitch(result, result.curves).figure


def score_html(score: Score) -> str:
    rows = [(name, f"{value:.6g}") for name, value in score.statistics().items()]
    title = f"{score.physics.pitch_um:g} µm pixels, mean ΔE {score.mean_delta_e:.3f}"
    return _cell(title, ("", ""), rows, score_figure(score))


def study_html(result: StudyResult) -> str:
    head = ("technology", "optimal pixel size (µm)", "95 % interval", "mean ΔE", "within 1 % of it")
    rows = []
    for curve in result.curves:
        best = curve.optimum
        size = f"{best.pitch_um:.2f}" if best.inside else f"none between {curve.pitch_um.min():.4g} and {curve.pitch_um.max():.4g}"
        within = within_words(best.within_1_percent_um, curve)
        rows.append((curve.label, size, interval_words(curve), f"{best.mean_delta_e:.3f}", within))
    return _cell(result.study.title or result.study.name, head, rows, study_figure(result))


def _cell(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], figure: Figure) -> str:
    """A title, a table and a figure, every string escaped; the figure as an image of its own, whose ids meet no others."""

    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    top = line(head, "th") if any(head) else ""
    image = data_uri("image/svg+xml", svg_text(figure).encode())
    return (
        f"<div><strong>{html.escape(title)}</strong><table>{top}{body}</table>"
        f'<img alt="{html.escape(title)}" style="max-width:100%" src="{image}"></div>'
    )


def study_rows(result: StudyResult) -> list[dict[str, Any]]:
    """A row for each technology, pitch and sensor."""
    return [
        {
            "technology": curve.technology,
            "pitch_um": float(pitch_um),
            "repeat": repeat,
            "fill_factor": float(curve.fill_factor[place]),
        }
        | {name: float(values[place, repeat]) for name, values in curve.statistics.items()}
        for curve in result.curves
        for place, pitch_um in enumerate(curve.pitch_um)
        for repeat in range(int(curve.sensors[place]))
    ]


def csv_text(rows: list[dict[str, Any]], path: str | os.PathLike[str] | None) -> str:
    """The rows as CSV, numbers to their last digit; written to a path where there is one."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows({name: repr(value) if isinstance(value, float) else value for name, value in row.items()} for row in rows)
    if path is not None:
        with replacing(Path(path)) as unfinished:
            unfinished.write_text(text.getvalue(), encoding="utf-8", newline="")
    return text.getvalue()
