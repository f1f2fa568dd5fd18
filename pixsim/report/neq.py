"""The figure of noise-equivalent quanta."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

from pixsim.base.tables import Column
from pixsim.show.figures import LINE_STYLES, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.studies.merit import NeqCurve

NEQ = "neq"  # name of the figure


@figure(
    NEQ,
    "Noise-equivalent quanta, mean² · MTF²/noise: the quanta that an ideal detector would need"
    " for the same ratio of signal to noise at a frequency, along an axis up to the Nyquist"
    " frequency. Mean level and noise are those of the metric information; aliasing is not"
    " included.",
)
def neq_against_frequency(quanta: Mapping[str, NeqCurve]) -> Drawing:
    """Draw the NEQ of sensors, by their labels, up to their Nyquist frequencies."""
    drawing = new_figure(6.4, 3.6)
    axes = drawing.subplots()
    table: dict[str, Column] = {
        "sensor": [],
        "pitch_um": [],
        "frequency_cy_per_mm": [],
        "neq_per_mm2": [],
    }
    for (label, sensor), line_style in zip(quanta.items(), cycle(LINE_STYLES), strict=False):
        name = literal(f"{label}, {sensor.pitch_um:.3g} µm")
        axes.plot(
            sensor.frequency_cy_per_mm, sensor.neq_per_mm2, lw=1.5, label=name, **line_style.stroke
        )
        count = sensor.frequency_cy_per_mm.size
        columns = (
            [label] * count,
            [sensor.pitch_um] * count,
            sensor.frequency_cy_per_mm.tolist(),
            sensor.neq_per_mm2.tolist(),
        )
        for column, values in zip(table.values(), columns, strict=True):
            column += values
    axes.set(xlabel="frequency on the sensor (cy/mm)", ylabel="NEQ (mm⁻²)", xlim=(0, None))
    if any((sensor.neq_per_mm2 > 0).any() for sensor in quanta.values()):
        axes.set_yscale("log")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    return drawing, table
