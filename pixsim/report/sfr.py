"""The page of a slanted edge: its MTF50, its SFR against frequency, and its edge spread."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pixsim.base.schema import result_data
from pixsim.base.tables import Column, table_csv
from pixsim.measure.sfr import COVERAGE, NYQUIST_CY_PER_PX, EdgeResponse
from pixsim.show.document import Answer, Document, Plot, Section
from pixsim.show.figures import COLOURS, new_figure
from pixsim.show.pages import FIGURE_SUFFIXES, Drawing, figure
from pixsim.show.presenter import Presenter

FILES = (*(f"{name}.{suffix}" for name in ("sfr", "edge_spread") for suffix in FIGURE_SUFFIXES), "summary.json", "report.html")
MAX_SFR_SHOWN = 3.0


def sfr_document(edge: EdgeResponse) -> Document:
    """Return the page of a slanted edge: its MTF50 and its SFR, the notes, its edge spread."""
    data = sfr_data(edge)
    response, *edge_and_interval = sfr_parts(data)
    answer = Answer(response, ("; ".join(edge_and_interval),))
    return Document(
        command="sfr",
        kind="response to an edge",
        title="Spatial frequency response",
        data=data,
        terminal=(answer,),
        answers=(answer,),
        lead=(Plot(lambda: sfr_plate(edge)), *edge.notes),
        sections=(Section("edge", "The edge", (Plot(lambda: edge_plate(edge)),)),),
        figures=".",
    )


def sfr_data(edge: EdgeResponse) -> dict[str, Any]:
    """Return summary.json: frequencies in cy/px, and in cy/mm if the pitch is known."""
    mtf50 = edge.mtf50_cy_per_px
    mtf50_interval = edge.mtf50_interval_cy_per_px
    at_nyquist = edge.at(NYQUIST_CY_PER_PX)
    data: dict[str, Any] = {
        "mtf50_cy_per_px": mtf50,
        "mtf50_interval_cy_per_px": list(mtf50_interval),
        "sfr_at_nyquist": at_nyquist[0],
        "sfr_at_nyquist_interval": list(at_nyquist[1:]),
        "interval_coverage": COVERAGE,
        "channel": edge.channel,
        "channel_nyquist_cy_per_px": edge.nyquist_cy_per_px,
        "sfr_at_channel_nyquist": edge.at(edge.nyquist_cy_per_px)[0],
        "highest_frequency_cy_per_px": float(edge.frequency_cy_per_px[-1]),
        "angle_deg": edge.angle_deg,
        "contrast": edge.contrast,
        "edge_degree": edge.edge_degree,
        "edge_sagitta_px": edge.edge_sagitta_px,
        "half_window_px": edge.half_window_px,
        "rows_used": edge.rows_used,
        "pitch_um": edge.pitch_um,
    }
    if edge.pitch_um is not None:
        px_per_mm = 1e3 / edge.pitch_um
        data["mtf50_cy_per_mm"] = None if mtf50 is None else mtf50 * px_per_mm
        data["mtf50_interval_cy_per_mm"] = [None if bound is None else bound * px_per_mm for bound in mtf50_interval]
        data["nyquist_cy_per_mm"] = NYQUIST_CY_PER_PX * px_per_mm
    settings = {"channel": edge.channel, "pitch_um": edge.pitch_um, "half_window_px": edge.half_window_px}
    return result_data(data, settings=settings, notes=edge.notes, table="sfr.csv")


def sfr_parts(data: Mapping[str, Any]) -> list[str]:
    """Return the response, the edge, and what the interval is of.

    data : of `sfr_data`
    """
    channel = "" if data["channel"] is None else f"{data['channel']}: "
    line = f"edge at {data['angle_deg']:.2f}°"
    if data["edge_degree"] > 1:
        line += f" (bowed by {data['edge_sagitta_px']:.2g} px, degree {data['edge_degree']})"
    return [
        f"{channel}{_mtf50_words(data)}, {_nyquist_words(data)}",
        f"{line}, ±{data['half_window_px']:g} px, {data['rows_used']} lines, contrast {data['contrast']:.2f}",
        f"in brackets {100 * data['interval_coverage']:.0f} % by the picture's noise",
    ]


def _mtf50_words(data: Mapping[str, Any]) -> str:
    last = f"{data['highest_frequency_cy_per_px']:g}"
    bounds = data["mtf50_interval_cy_per_px"]
    low, high = (f"above {last}" if bound is None else f"{bound:.3f}" for bound in bounds)
    if data["mtf50_cy_per_px"] is None:
        return f"MTF50 above {last} cy/px" + ("" if bounds[0] is None else f" (from {low})")
    on_sensor = "" if data["pitch_um"] is None else f" ({data['mtf50_cy_per_mm']:.1f} cy/mm)"
    return f"MTF50 {data['mtf50_cy_per_px']:.3f} [{low}, {high}] cy/px{on_sensor}"


def _nyquist_words(data: Mapping[str, Any]) -> str:
    low, high = data["sfr_at_nyquist_interval"]
    words = f"{data['sfr_at_nyquist']:.3f} [{low:.3f}, {high:.3f}] at Nyquist"
    if data["channel"] is None:
        return words
    channel_nyquist = data["channel_nyquist_cy_per_px"]
    if channel_nyquist == NYQUIST_CY_PER_PX:
        return f"{words} of the sensor and of the channel (0.5 cy/px)"
    at_channel = f"{data['sfr_at_channel_nyquist']:.3f} at the channel's own ({channel_nyquist:g} cy/px)"
    return f"{words} of the sensor (0.5 cy/px), {at_channel}"


def sfr_table(edge: EdgeResponse) -> dict[str, Column]:
    """Return the SFR and its interval at each frequency."""
    low, high = edge.sfr_interval
    columns = {"frequency_cy_per_px": edge.frequency_cy_per_px, "sfr": edge.sfr, "sfr_low": low, "sfr_high": high}
    if edge.pitch_um is not None:
        columns["frequency_cy_per_mm"] = edge.frequency_cy_per_mm(edge.pitch_um)
    return {name: values.tolist() for name, values in columns.items()}


@figure("sfr", "Edge-based spatial frequency response (ISO 12233), with its 95 % interval by the noise of the picture.")
def sfr_plate(edge: EdgeResponse) -> Drawing:
    """Plot the SFR against frequency, with the Nyquist frequency and the MTF50."""
    figure = new_figure(5.2, 3.4)
    axes = figure.subplots()
    scale, unit = (1.0, "cycles/pixel") if edge.pitch_um is None else (1e3 / edge.pitch_um, "cycles/mm on the sensor")
    frequency = edge.frequency_cy_per_px * scale
    axes.fill_between(frequency, *edge.sfr_interval, color=COLOURS[0], alpha=0.25, lw=0)
    axes.plot(frequency, edge.sfr, color=COLOURS[0], lw=1.5)

    nyquist = NYQUIST_CY_PER_PX * scale
    top = max(1.03, min(1.05 * float(edge.sfr.max()), MAX_SFR_SHOWN))
    axes.axvline(nyquist, color="0.6", lw=1, ls="--")
    axes.annotate("Nyquist", (nyquist, top), ha="center", va="bottom", color="0.35", annotation_clip=False)
    if (mtf50 := edge.mtf50_cy_per_px) is not None:
        point = mtf50 * scale, 0.5
        axes.plot(*point, "o", ms=5, color=COLOURS[1])
        axes.annotate(f"MTF50 {point[0]:.3g}", point, xytext=(12, 12), textcoords="offset points", color=COLOURS[1])

    axes.set(xlabel=f"frequency along the normal of the edge ({unit})", ylabel="e-SFR")
    axes.set_xlim(0, frequency[-1])
    axes.set_ylim(0, top)
    return figure, sfr_table(edge)


@figure("edge_spread", "Edge spread function: means of pixels at the same distance from the edge, along its normal.")
def edge_plate(edge: EdgeResponse) -> Drawing:
    """Plot the edge spread function."""
    figure = new_figure(5.2, 3.0)
    axes = figure.subplots()
    axes.plot(edge.distance_px, edge.edge_spread, color=COLOURS[0], lw=1.2)
    axes.set(xlabel="distance from the edge along its normal (pixels)", ylabel="mean of bins (above black)")
    axes.set_xlim(-edge.half_window_px, edge.half_window_px)
    return figure, {"distance_px": edge.distance_px, "mean": edge.edge_spread}


PRESENTER = Presenter(document=sfr_document, figure=sfr_plate, csv=lambda edge: table_csv(sfr_table(edge)))
