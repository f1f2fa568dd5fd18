"""What `pixsim accuracy` found."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from pixsim.accuracy.budget import Calibration, Effect
from pixsim.accuracy.fits import Order, beaten_by, fit_order
from pixsim.accuracy.ladders import Rung
from pixsim.accuracy.probe import Setup
from pixsim.photodiode_checks import Solved
from pixsim.stability import Case

METRICS = {
    "error_e": "RMS relative error of mean electrons",
    "error_delta_e": "error of mean ΔE",
    "error_optimum_um": "error of the optimal pitch (µm)",
}
USUAL_SENSORS = 8  # of a study: what their mean cannot see does not tell settings apart


@dataclass(frozen=True)
class Discharge:
    """One solver on one discharge of the pixel's photodiode."""

    light: str
    photocurrent_e_per_s: float
    integration_s: float
    solved: Solved

    def as_dict(self) -> dict[str, Any]:
        own = {name: value for name, value in vars(self).items() if name != "solved"}
        return _plain(own | asdict(self.solved))


@dataclass(frozen=True)
class Accuracy:
    """What was measured. `notes` say what was made smaller to stay within the time."""

    name: str
    reference: str
    analytic: bool
    shipped: Rung
    rungs: tuple[Rung, ...] = field(repr=False)
    stage_seconds: dict[str, float]
    calibration: Calibration
    budget: dict[str, Effect]
    cases: tuple[Case, ...] = field(repr=False)
    solvers: tuple[Discharge, ...] = field(repr=False)
    header: dict[str, Any] = field(repr=False)
    setup: Setup = field(repr=False)
    notes: tuple[str, ...]
    seconds: float

    def ladder(self, name: str) -> list[Rung]:
        """Its rungs that were measured, by their number."""
        return sorted((each for each in self.rungs if each.ladder == name and not each.left_out), key=lambda each: each.value)

    @property
    def names(self) -> list[str]:
        return list(dict.fromkeys(each.ladder for each in self.rungs))

    def order(self, name: str, metric: str) -> Order | None:
        """Of a ladder whose settings are numbers."""
        if name in ("methods", "sampler"):
            return None
        found = [each for each in self.ladder(name) if "pinhole" not in each.setting and "planned" not in each.setting]
        errors, spread = [getattr(each, metric) for each in found], [each.spread for each in found]
        return fit_order([each.value for each in found], errors, spread if any(spread) else None)

    def rivals(self, metric: str) -> list[Rung]:
        """Measured settings of the render, the shipped one first, once: those of seeds and raster have references of their own."""
        others = [each for each in self.rungs if not (each.left_out or each.shipped) and each.ladder not in ("seeds", "raster")]
        return [each for each in (self.shipped, *others) if math.isfinite(getattr(each, metric))]

    def beaten(self, metric: str) -> Rung | None:
        """The setting that is clearly faster and nearer than the shipped one, if there is one.

        Nearer by what a study of eight sensors could see, for ΔE and the optimum.
        """
        rivals = self.rivals(metric)
        if not rivals or rivals[0] is not self.shipped:
            return None
        sensor = self.calibration.sensor
        visible = {"error_delta_e": sensor.delta_e, "error_optimum_um": sensor.optimum_um}.get(metric, 0.0)
        margin = visible / math.sqrt(USUAL_SENSORS) if math.isfinite(visible) else 0.0
        index = beaten_by(0, [each.seconds for each in rivals], [getattr(each, metric) for each in rivals], margin)
        return None if index is None else rivals[index]

    def as_dict(self) -> dict[str, Any]:
        """summary.json; JSON knows no NaN."""
        return {
            "scene": self.name,
            "reference": self.reference,
            "analytic": self.analytic,
            "shipped": _plain(asdict(self.shipped)),
            "ladders": {name: [_plain(asdict(each)) for each in self.rungs if each.ladder == name] for name in self.names},
            "orders": {
                name: {metric: asdict(order) for metric in METRICS if (order := self.order(name, metric))} for name in self.names
            },
            "shipped_on_front": {metric: self.beaten(metric) is None for metric in METRICS if self.rivals(metric)},
            "stage_seconds": self.stage_seconds,
            "error_budget": {name: _plain(asdict(each)) for name, each in self.budget.items()},
            "stability": [_plain(case.as_dict()) for case in self.cases],
            "solvers": [each.as_dict() for each in self.solvers],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in values.items()}
