"""The SNR of a pixel that is read several times, as a figure and a table."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from pixsim.base.digits import rounded
from pixsim.report.panels import Line, LinePanel, draw_panels
from pixsim.show.document import Block, DocumentTable, Plot, Section
from pixsim.show.figures import literal
from pixsim.show.pages import Drawing, figure
from pixsim.studies.merit import SnrCurve

SNR = "snr_against_light"  # name of the figure
_LOWEST_DB = -10.0
_BEHIND = {"marker": "", "ls": "-", "lw": 3.5, "color": "0.8", "zorder": 1}
_TOP = 0.86  # of the axes, below the names of another one


@figure(
    SNR,
    "SNR by temporal noise against the light: of each reading alone up to its limit, and of their"
    " merge. Vertical lines: where the merge changes its readings, with the SNR that this costs.",
)
def _snr_plate(curve: SnrCurve) -> Drawing:
    """Draw the SNR of readings and of their merge against charge and luminance."""
    factor = curve.cd_per_m2_per_e
    columns = {"merged": curve.merged_db, **curve.readings_db}
    table = {"charge_e": curve.charge_e}
    if factor is not None:
        table["luminance_cd_per_m2"] = factor * curve.charge_e
    table |= {f"{name}_db": snr_db for name, snr_db in columns.items()}

    lines = [
        Line("charge_e", f"{name}_db", f"reading {literal(name)}") for name in curve.readings_db
    ]
    lines.append(Line("charge_e", "merged_db", "merged", _BEHIND))
    marks = {
        f"switch at {rounded(charge_e, 3)} e⁻: −{rounded(drop_db, 2)} dB": charge_e
        for charge_e, drop_db in curve.switches_e
    }
    axes = {"xscale": "log", "ylim": (_LOWEST_DB, None)}
    light = "light in a frame (e⁻ of the first collector)"
    drawing, _ = draw_panels(table, [LinePanel(light, "SNR (dB)", lines, marks, axes)])
    if factor is not None:
        scales = partial(np.multiply, factor), partial(np.multiply, 1 / factor)
        above = drawing.axes[0].secondary_xaxis("top", functions=scales)
        above.set_xlabel("luminance on axis (cd/m²)")
        drawing.subplots_adjust(top=_TOP)
    return drawing, table


def _range_rows(curve: SnrCurve) -> Iterator[tuple[str, ...]]:
    """Yield the ranges of each threshold; a range and the next one have a gap between them."""
    for result in curve.ranges:
        lengths = ["none", ""]
        if result.ranges_e:
            lengths = [rounded(db, 3) for db in (result.total_db, result.contiguous_db)]
        ends = [
            "; ".join(
                f"{rounded(factor * low, 3)} to {rounded(factor * high, 3)}"
                for low, high in result.ranges_e
            )
            for factor in (1.0, curve.cd_per_m2_per_e)
            if factor is not None
        ]
        yield (f"{result.snr_db:g}", *lengths, *ends)


def snr_section(curve: SnrCurve | None) -> Section:
    """Return the section of a page on the SNR of several readings; empty without it."""
    blocks: tuple[Block, ...] = ()
    if curve is not None:
        head = ["SNR from\ndB", "range\ndB", "without a gap\ndB", "light\ne⁻", "luminance\ncd/m²"]
        head = head[: 4 if curve.cd_per_m2_per_e is None else None]
        table = DocumentTable("ranges of the SNR", head, _range_rows(curve), words=(3, 4))
        blocks = (table, Plot(lambda: _snr_plate(curve)))
    return Section("snr", "Signal to noise", blocks, brief=True)
