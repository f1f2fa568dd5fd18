"""The page of a slanted edge: its MTF50, its SFR against frequency, and its edge spread."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pixsim.base.arrays import Array
from pixsim.base.digits import number, percent, with_ends, within_error
from pixsim.base.schema import result_data
from pixsim.base.tables import table_csv
from pixsim.measure.sfr import COVERAGE, NYQUIST_CY_PER_PX, EdgeResponse
from pixsim.report.panels import Line, LinePanel, draw_panels
from pixsim.show.document import Answer, Document, Plot, Section
from pixsim.show.figures import COLOURS
from pixsim.show.pages import FIGURE_SUFFIXES, Drawing, figure
from pixsim.show.presenter import Presenter

FILES = (
    *(f"{name}.{suffix}" for name in ("sfr", "edge_spread") for suffix in FIGURE_SUFFIXES),
    "summary.json",
    "report.html",
)
_MAX_SFR_AXIS = 3.0


def sfr_document(edge: EdgeResponse) -> Document:
    """Return the page of a slanted edge: its MTF50 and its SFR, the notes, its edge spread."""
    data = _sfr_data(edge)
    response, *edge_and_interval = sfr_parts(data)
    answer = Answer(response, ("; ".join(edge_and_interval),))
    return Document(
        command="sfr",
        kind="response to an edge",
        title="Spatial frequency response",
        data=data,
        terminal=(answer,),
        answers=(answer,),
        lead=(Plot(lambda: _sfr_plate(edge)), *edge.notes),
        sections=(Section("edge", "The edge", (Plot(lambda: _edge_plate(edge)),)),),
        figures=".",
    )


_ATTRIBUTES = (
    "mtf50_cy_per_px",
    "channel",
    "angle_deg",
    "contrast",
    "edge_degree",
    "edge_sagitta_px",
    "half_window_px",
    "rows_used",
    "pitch_um",
)


def _sfr_data(edge: EdgeResponse) -> dict[str, Any]:
    """Return summary.json: frequencies in cy/px, and in cy/mm if the pitch is known."""
    mtf50 = edge.mtf50_cy_per_px
    ends = edge.mtf50_interval_cy_per_px
    at_nyquist, *interval = edge.at(NYQUIST_CY_PER_PX)
    data: dict[str, Any] = {name: getattr(edge, name) for name in _ATTRIBUTES} | {
        "mtf50_interval_cy_per_px": list(ends),
        "sfr_at_nyquist": at_nyquist,
        "sfr_at_nyquist_interval": interval,
        "interval_coverage": COVERAGE,
        "channel_nyquist_cy_per_px": edge.nyquist_cy_per_px,
        "sfr_at_channel_nyquist": edge.at(edge.nyquist_cy_per_px)[0],
        "highest_frequency_cy_per_px": float(edge.frequency_cy_per_px[-1]),
    }
    if edge.pitch_um is not None:
        px_per_mm = 1e3 / edge.pitch_um
        low, high, data["mtf50_cy_per_mm"] = (
            None if value is None else value * px_per_mm for value in (*ends, mtf50)
        )
        data |= {
            "mtf50_interval_cy_per_mm": [low, high],
            "nyquist_cy_per_mm": NYQUIST_CY_PER_PX * px_per_mm,
        }
    settings = {name: data[name] for name in ("channel", "pitch_um", "half_window_px")}
    return result_data(data, settings=settings, notes=edge.notes, table="sfr.csv")


def sfr_parts(data: Mapping[str, Any]) -> list[str]:
    """Return the response, the edge, and what the intervals are of.

    data : of `_sfr_data`
    """
    if data["edge_degree"] > 1:
        bow = f" (bowed by {data['edge_sagitta_px']:.2g} px, degree {data['edge_degree']})"
    else:
        bow = ""
    at_nyquist = with_ends(data["sfr_at_nyquist"], data["sfr_at_nyquist_interval"])
    return [
        f"{data['channel'] or ''} {_mtf50_words(data)}, SFR {at_nyquist} at"
        f" Nyquist{_channel_words(data)}".lstrip(),
        (
            f"edge at {data['angle_deg']:.2f}°{bow}, ±{data['half_window_px']:g} px,"
            f" {data['rows_used']} lines, contrast {data['contrast']:.2f}"
        ),
        f"in brackets: {percent(data['interval_coverage'])} intervals from the picture's noise",
    ]


def _mtf50_words(data: Mapping[str, Any]) -> str:
    low, high = (math.inf if end is None else end for end in data["mtf50_interval_cy_per_px"])
    if data["mtf50_cy_per_px"] is None:
        return f"MTF50 above {data['highest_frequency_cy_per_px']:g} cy/px"
    mtf50 = f"MTF50 {with_ends(data['mtf50_cy_per_px'], (low, high))} cy/px"
    if not data["pitch_um"]:
        return mtf50
    half_cy_per_mm = (
        (min(high, 2 * data["mtf50_cy_per_px"] - low) - low) / 2 * 1e3 / data["pitch_um"]
    )
    return f"{mtf50} ({within_error(data['mtf50_cy_per_mm'], half_cy_per_mm)} cy/mm)"


def _channel_words(data: Mapping[str, Any]) -> str:
    nyquist = data["channel_nyquist_cy_per_px"]
    if data["channel"] is None or nyquist == NYQUIST_CY_PER_PX:
        return ""
    return (
        f" (0.5 cy/px), {number(data['sfr_at_channel_nyquist'], 3)} at the channel's ({nyquist:.3g}"
        " cy/px)"
    )


def _sfr_table(edge: EdgeResponse) -> dict[str, Array]:
    """Return the SFR and its interval at each frequency."""
    low, high = edge.sfr_interval
    columns = {
        "frequency_cy_per_px": edge.frequency_cy_per_px,
        "sfr": edge.sfr,
        "sfr_low": low,
        "sfr_high": high,
    }
    if edge.pitch_um is not None:
        columns["frequency_cy_per_mm"] = edge.frequency_cy_per_mm(edge.pitch_um)
    return columns


@figure("sfr", "SFR (ISO 12233) and its 95 % interval.")
def _sfr_plate(edge: EdgeResponse) -> Drawing:
    """Plot the SFR against frequency, with the Nyquist frequency and the MTF50."""
    table = _sfr_table(edge)
    x = "frequency_cy_per_px"
    scale = 1.0
    unit = "cycles/pixel"
    if edge.pitch_um is not None:
        x = "frequency_cy_per_mm"
        scale = 1e3 / edge.pitch_um
        unit = "cycles/mm on the sensor"
    marks = {"Nyquist": NYQUIST_CY_PER_PX * scale}
    if edge.mtf50_cy_per_px is not None:
        marks["MTF50"] = edge.mtf50_cy_per_px * scale

    limits = {
        "xlim": (0, table[x][-1]),
        "ylim": (0, max(1.03, min(1.05 * float(edge.sfr.max()), _MAX_SFR_AXIS))),
    }
    panel = LinePanel(
        f"frequency along the normal of the edge ({unit})",
        "e-SFR",
        (Line(x, "sfr", "SFR"),),
        marks,
        limits,
    )
    figure, _ = draw_panels(table, [panel])
    figure.axes[0].fill_between(
        table[x], table["sfr_low"], table["sfr_high"], color=COLOURS[0], alpha=0.25, lw=0
    )
    return figure, table


@figure("edge_spread", "Edge spread function.")
def _edge_plate(edge: EdgeResponse) -> Drawing:
    """Plot the edge spread function."""
    table = {"distance_px": edge.distance_px, "mean": edge.edge_spread}
    panel = LinePanel(
        "distance from the edge along its normal (pixels)",
        "mean of bins",
        (Line("distance_px", "mean"),),
    )
    return draw_panels(table, [panel])


def _sfr_csv(edge: EdgeResponse) -> str:
    """Return the SFR and its interval at each frequency as CSV."""
    return table_csv({name: values.tolist() for name, values in _sfr_table(edge).items()})


PRESENTER = Presenter(document=sfr_document, figure=_sfr_plate, csv=_sfr_csv)
