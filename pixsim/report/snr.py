"""The SNR of a pixel that is read several times, as a figure and a table."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import rounded
from pixsim.show.document import Block, DocumentTable, Plot, Section
from pixsim.show.figures import LEGEND_LINE, LINE_STYLES, finish, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.studies.merit import SnrCurve

SNR = "snr_against_light"  # name of the figure
_LOWEST_DB = -10.0


@figure(
    SNR,
    "SNR by temporal noise against the light: of each reading alone up to its limit, and of their"
    " merge. Vertical lines: where the merge changes its readings, with the SNR that this costs.",
)
def _snr_plate(curve: SnrCurve) -> Drawing:
    """Draw the SNR of readings and of their merge against charge and luminance."""
    drawing = new_figure(8.6, 4.2)
    axes = drawing.subplots()
    axes.set_xscale("log")
    factor = curve.cd_per_m2_per_e
    table: dict[str, Array] = {"charge_e": curve.charge_e}
    if factor is not None:
        table["luminance_cd_per_m2"] = factor * curve.charge_e
        scales = partial(np.multiply, factor), partial(np.multiply, 1 / factor)
        axes.secondary_xaxis("top", functions=scales).set_xlabel("luminance on axis (cd/m²)")
    table["merged_db"] = curve.merged_db
    table |= {f"{name}_db": snr_db for name, snr_db in curve.readings_db.items()}

    axes.plot(curve.charge_e, curve.merged_db, lw=3.5, color="0.8", label="merged")
    names = list(curve.readings_db)
    for name, line_style in zip(names, LINE_STYLES, strict=False):
        label = f"reading {literal(name)}"
        axes.plot(curve.charge_e, curve.readings_db[name], lw=1.4, label=label, **line_style.stroke)
    for (charge_e, drop_db), line_style in zip(
        curve.switches_e, LINE_STYLES[len(names) :], strict=False
    ):
        label = f"switch at {rounded(charge_e, 3)} e⁻: −{rounded(drop_db, 2)} dB"
        axes.axvline(charge_e, lw=0.9, label=label, **line_style.stroke)

    axes.set_ylim(_LOWEST_DB)
    finish(axes, "light in a frame (e⁻ of the first collector)", "SNR (dB)", "best", LEGEND_LINE)
    return drawing, table


def _range_rows(curve: SnrCurve) -> Iterator[tuple[str, ...]]:
    """Yield the ranges of each threshold; a range and the next one have a gap between them."""
    for result in curve.ranges:
        lengths = "none", ""
        if result.ranges_e:
            lengths = rounded(result.total_db, 3), rounded(result.contiguous_db, 3)
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
