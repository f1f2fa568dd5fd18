"""The noise-equivalent quanta of sensors against frequency, beside the metric information of a run and of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle

from pixsim.base.arrays import Array
from pixsim.show.figures import LOOKS, new_figure, own_style
from pixsim.show.pages import Column, Plate
from pixsim.studies.result import StudyResult
from pixsim.studies.run import RunResult
from pixsim.viewer.chain import ExpectedFrame, make_chain
from pixsim.viewer.raw_metrics import INFORMATION, neq_along

NEQ = "neq"  # name of the figure


@dataclass(frozen=True)
class Quanta:
    """The NEQ of a sensor.

    pitch_um : of its pixels
    frequency_cy_per_mm : along an axis of the sensor, (n,)
    neq_per_mm2 : there, (n,)
    """

    pitch_um: float
    frequency_cy_per_mm: Array
    neq_per_mm2: Array

    @classmethod
    def of(cls, frame: ExpectedFrame) -> Quanta:
        """Return that of such frames."""
        return cls(frame.physics.pitch_um, *neq_along(frame))


def quanta_of_run(result: RunResult) -> dict[str, Quanta]:
    """Return the NEQ of a run's sensor by its name; nothing without the metric information."""
    if INFORMATION.name not in result.settings.metrics:
        return {}
    return {result.settings.pixel.technology: Quanta.of(result.chain.expected(result.score.frame.integration_s))}


def quanta_of_study(result: StudyResult) -> dict[str, Quanta]:
    """Return the NEQ of each sensor of a study, at its best size by information, by its label; nothing without that metric."""
    found: dict[str, Quanta] = {}
    for curve in result.curves if INFORMATION.name in result.study.metrics else ():
        series = result.series[curve.technology]
        best = curve.optima.get(INFORMATION.name, curve.optimum)
        chain = make_chain(series.imaging.at(best.pitch_um).registered(0), series.light())
        found[curve.label] = Quanta.of(chain.expected(chain.integration_s))
    return found


@own_style()
def neq_against_frequency(quanta: Mapping[str, Quanta]) -> Plate:
    """Draw the NEQ of sensors, by their labels, up to their Nyquist frequencies."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    table: dict[str, Column] = {"sensor": [], "pitch_um": [], "frequency_cy_per_mm": [], "neq_per_mm2": []}
    for (label, each), look in zip(quanta.items(), cycle(LOOKS), strict=False):
        axes.plot(each.frequency_cy_per_mm, each.neq_per_mm2, lw=1.5, label=f"{label}, {each.pitch_um:.3g} µm", **look.stroke)
        count = each.frequency_cy_per_mm.size
        columns = [label] * count, [each.pitch_um] * count, each.frequency_cy_per_mm.tolist(), each.neq_per_mm2.tolist()
        for column, values in zip(table.values(), columns, strict=True):
            column += values
    axes.set(xlabel="frequency on the sensor (cy/mm)", ylabel="NEQ (mm⁻²)", xlim=(0, None))
    if any((each.neq_per_mm2 > 0).any() for each in quanta.values()):
        axes.set_yscale("log")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    caption = (
        "Noise-equivalent quanta, mean² · MTF²/noise: the quanta that an ideal detector would need for the same ratio of signal to "
        "noise at a frequency, along an axis up to the Nyquist frequency. Mean level and noise are those of the judge information; "
        "aliases are not in it."
    )
    return Plate(NEQ, caption, figure, table)
