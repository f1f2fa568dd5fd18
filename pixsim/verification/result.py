"""The result of `pixsim accuracy`."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.arguments import checks_arguments
from pixsim.show.document import plain_text
from pixsim.show.pages import Figures, plain, rows_csv
from pixsim.show.render import notebook, write
from pixsim.studies.budget import Calibration, Effect, ProbeDesign
from pixsim.verification.ladders import METRICS, Metric, Rung
from pixsim.verification.orders import Order, beaten_by, fit_order
from pixsim.verification.solvers import Solved
from pixsim.verification.stability import ExtremeCase
from pixsim.viewer.setting import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

USUAL_SENSORS = 8  # of a study: differences that their mean does not resolve do not matter


@dataclass(frozen=True)
class Accuracy:
    """The errors of a scene's results against run time, their error budget, and extreme cases with known answers.

    name : of the scene
    reference : what the errors are measured against, in words
    analytic : whether it is a formula
    shipped : the default settings
    rungs : settings that differ from the default in one, each with its time and errors
    stage_seconds : wall time in s of each stage of a first result
    calibration : effects of the sources of error on ΔE
    budget : source of error -> its effect on mean ΔE and on the optimum of one result
    cases : extreme cases
    solvers : of the photodiode's discharge
    header : of the irradiance with the default settings
    design : what is probed
    settings : as given
    notes : reductions made to limit the time
    seconds : wall time in s
    """

    name: str
    reference: str
    analytic: bool
    shipped: Rung
    rungs: tuple[Rung, ...] = field(repr=False)
    stage_seconds: dict[str, float]
    calibration: Calibration
    budget: dict[str, Effect]
    cases: tuple[ExtremeCase, ...] = field(repr=False)
    solvers: tuple[Solved, ...] = field(repr=False)
    header: dict[str, Any] = field(repr=False)
    design: ProbeDesign = field(repr=False)
    settings: Run = field(repr=False)
    notes: tuple[str, ...]
    seconds: float

    @checks_arguments
    def ladder(self, name: str) -> list[Rung]:
        """Return the measured rungs of a ladder, sorted by value.

        name : of the ladder, one of `names`
        """
        return sorted((rung for rung in self.rungs if rung.ladder == name and not rung.left_out), key=lambda rung: rung.value)

    @property
    def names(self) -> list[str]:
        """Names of the ladders."""
        return list(dict.fromkeys(rung.ladder for rung in self.rungs))

    @checks_arguments
    def order(self, name: str, metric: Metric) -> Order | None:
        """Return the order of convergence of a ladder; None if its settings are not numbers, or too few of its errors fall.

        name : of the ladder
        metric : which error
        """
        if name in ("methods", "sampler"):
            return None
        rungs = [rung for rung in self.ladder(name) if "pinhole" not in rung.setting and "planned" not in rung.setting]
        errors, spread = [getattr(rung, metric) for rung in rungs], [rung.spread for rung in rungs]
        return fit_order([rung.value for rung in rungs], errors, spread if any(spread) else None)

    @checks_arguments
    def rivals(self, metric: Metric) -> list[Rung]:
        """Return the measured render settings, the default ones first; the ladders of seeds and raster have other references.

        metric : which error
        """
        others = [rung for rung in self.rungs if not (rung.left_out or rung.shipped) and rung.ladder not in ("seeds", "raster")]
        return [rung for rung in (self.shipped, *others) if math.isfinite(getattr(rung, metric))]

    @checks_arguments
    def beaten(self, metric: Metric) -> Rung | None:
        """Return the setting that is clearly faster, and more accurate beyond the standard error of eight sensors; or None.

        metric : which error
        """
        rivals = self.rivals(metric)
        if not rivals or rivals[0] is not self.shipped:
            return None
        sensor = self.calibration.sensor
        visible = {"error_delta_e": sensor.delta_e, "error_optimum_um": sensor.optimum_um}.get(metric, 0.0)
        margin = visible / math.sqrt(USUAL_SENSORS) if math.isfinite(visible) else 0.0
        index = beaten_by(0, [rung.seconds for rung in rivals], [getattr(rung, metric) for rung in rivals], margin)
        return None if index is None else rivals[index]

    def as_dict(self) -> dict[str, Any]:
        """Return the results as in summary.json."""
        return {
            "scene": self.name,
            "assumption": self.settings.pixel.assumption,
            "reference": self.reference,
            "analytic": self.analytic,
            "shipped": plain(asdict(self.shipped)),
            "ladders": {name: [plain(asdict(rung)) for rung in self.rungs if rung.ladder == name] for name in self.names},
            "orders": {
                name: {metric: asdict(order) for metric in METRICS if (order := self.order(name, metric))} for name in self.names
            },
            "shipped_on_front": {metric: self.beaten(metric) is None for metric in METRICS if self.rivals(metric)},
            "stage_seconds": self.stage_seconds,
            "error_budget": {name: plain(asdict(effect)) for name, effect in self.budget.items()},
            "stability": [plain(case.as_dict()) for case in self.cases],
            "solvers": [plain(asdict(row)) for row in self.solvers],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return a row for each rung of the ladders as CSV, and write it to `path` if given."""
        return rows_csv([vars(rung) for rung in self.rungs], path)

    @checks_arguments
    def write(self, folder: str | os.PathLike[str], figures: Figures = "svg") -> Path:
        """Write report.html, ladders.csv, stability.csv, solvers.csv, summary.json, figures/ (*.svg, *.csv) and provenance.json.

        folder : created if missing
        figures : "pdf" writes a PDF beside each SVG

        Returns the path of report.html. Raises PixsimError if the folder cannot be written, or holds a file of such a name that
        pixsim did not write.
        """
        from pixsim.verification.report import accuracy_document

        return write(accuracy_document(self), Path(folder), figures=figures)

    def plot(self) -> Figure:
        """Return a Matplotlib figure of error against wall time, with the Pareto front."""
        from pixsim.verification.report import work_precision

        return work_precision(self).figure

    def _repr_html_(self) -> str:
        from pixsim.verification.report import accuracy_document

        return notebook(accuracy_document(self))

    def __repr__(self) -> str:
        from pixsim.verification.report import answer

        return f"<Accuracy of {self.name}: {plain_text(answer(self).head)}>"
