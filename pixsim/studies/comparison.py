"""The result of a comparison of sensors."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.show.document import joined, plain_text
from pixsim.show.figures import literal, new_figure, own_style
from pixsim.show.render import cell_of
from pixsim.studies.averages import Averaged, Compared
from pixsim.studies.lineup import ComparisonJob, pixels_of
from pixsim.studies.pair_uncertainty import PairUncertainty
from pixsim.studies.paired import mean_interval
from pixsim.studies.verdicts import answers, facts, probability_first_is_better, whole_verdict
from pixsim.viewer.display import white_light

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_WIDTH_IN, FIGURE_BORDER_IN, ROW_IN = 6.0, 0.8, 0.4


@dataclass(frozen=True)
class Comparison(Averaged):
    """Sensors in one scene. The first one is a, each later one is b.

    A difference of a and b is that of the two alone, with their own chart, field, dots and border. So it does not depend on the
    other sensors. The mean ΔE of three sensors and more (`delta_e`, `scores`) are those on one display for all. Under conditions,
    both are weighted means, and the sensors are those of the first condition of weight above 0.

    parts : all sensors under each condition, with its weight
    prepared : what was compared: scene, cameras, display and seeds
    pairs : the first sensor and each other one alone
    notes : warnings, and black levels that clip dark noise
    uncertainty : of each pair, what is known of its difference over sensor types by each metric, if they were asked for
    """

    prepared: ComparisonJob = field(repr=False)
    pairs: tuple[Averaged, ...] = field(repr=False)
    notes: tuple[str, ...] = ()
    uncertainty: tuple[PairUncertainty, ...] = field(default=(), repr=False)

    @checks_arguments
    def pair(self, other: str) -> Averaged:
        """Return the comparison of the first sensor and another one alone.

        other : name of the other one
        """
        return self.pairs[self.names.index(other) - 1]

    def as_dict(self) -> dict[str, Any]:
        """Return compare.json. With conditions the answers are those of the weighted mean, and the rest is `shown`."""
        prepared, first, lineup = self.prepared, self.sensors[0], self.shown.lineup
        more = prepared.of_study
        for condition, part in zip(prepared.conditions, self.conditions, strict=True):
            delta_e = {name: values.tolist() for name, values in part.delta_e.items()}
            more["conditions"][condition.condition] |= part.answers() | {"delta_e": delta_e}
        if len(self.pairs) > 1:
            more["pairs"] = {other: _pair_as_dict(self.pair(other)) for other in self.names[1:]}
        if self.judged:
            more["metrics"] = {
                name: {
                    "scores": {sensor: list(mean_interval(each)) for sensor, each in values.items()},
                    "probability_a_better": {other: probability_first_is_better(name, values, other) for other in self.names[1:]},
                }
                for name, values in self.judged.items()
            }
        if self.uncertainty:
            more["uncertainty"] = {each.names[1]: each.as_dict() for each in self.uncertainty if each.metric.is_delta_e}
            for each in self.uncertainty:
                if not each.metric.is_delta_e:
                    more["uncertainty"][each.names[1]].setdefault("metrics", {})[each.metric.name] = each.as_dict()
        return more | {
            "names": list(self.names),
            "verdicts": {other: whole_verdict(self, other, prepared.match) for other in self.names[1:]},
            **self.answers(),
            "match": prepared.match,
            "repeats": prepared.repeats,
            "scene": lineup.scene,
            **lineup.as_dict(),
            "scored_dots": list(first.score.delta_e.shape),
            "display": lineup.settings.display.model_dump(),
            "seed": lineup.settings.seed,
            "notes": list(self.notes),
            "sensors": {
                sensor.name: _summary_of(sensor) | {"delta_e": self.delta_e[sensor.name].tolist()} for sensor in self.sensors
            },
        }

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure of mean ΔE: a row for each sensor, with its frames and the 95 % interval of their mean."""
        figure = new_figure(FIGURE_WIDTH_IN, FIGURE_BORDER_IN + ROW_IN * len(self.sensors))
        axes = figure.add_subplot()
        for row, (name, (low, mean, high)) in enumerate(self.scores.items()):
            axes.plot(self.delta_e[name], np.full(self.prepared.repeats, row), "o", color="tab:gray", alpha=0.5, markersize=4)
            axes.errorbar([mean], [row], xerr=[[mean - low], [high - mean]], fmt="D", color=f"C{row}", capsize=5, markersize=5)
        axes.set_yticks(range(len(self.sensors)), [literal(name) for name in self.names])
        axes.set_ylim(len(self.sensors) - 0.5, -0.5)  # the first sensor is on top
        axes.set_xlim(0.0, 1.05 * max(float(values.max()) for values in self.delta_e.values()) or 1.0)
        axes.set_xlabel("mean ΔE: each frame (grey), and the mean with its 95 % interval")
        return figure

    def _repr_html_(self) -> str:
        lineup = self.shown.lineup
        made = f"{lineup.scene}, seed {lineup.settings.seed}"
        return cell_of(answers(self), self.plot(), *facts(self), made, *self.notes)

    def __repr__(self) -> str:
        return f"<Comparison {plain_text(joined(each.head for each in answers(self)))}>"


def _pair_as_dict(pair: Averaged) -> dict[str, Any]:
    """Return what compare.json has of the first sensor and another one alone, beside their difference."""
    return {"scores": {name: list(score) for name, score in pair.scores.items()}, **pair.shown.lineup.as_dict()}


def _summary_of(compared: Compared) -> dict[str, Any]:
    """Return a sensor's entry of compare.json; `statistics` are those of its first frame, as in score.json."""
    sensor, settings, score = compared.sensor, compared.sensor.settings, compared.score
    return {
        "file": sensor.file,
        "pixels": list(pixels_of(sensor)),
        "statistics": score.statistics(),
        "camera": sensor.camera.model_dump(),
        "fov_deg": sensor.camera.fov_deg,
        "pixel": settings.pixel.model_dump(),
        "assumption": settings.pixel.assumption,
        "exposure": settings.exposure.model_dump(),
        "border_um": list(score.border_um),
        "film": compared.film.as_dict(),
        "render_noise": asdict(compared.noise),
        "dark": compared.dark,
        "causes": [cause.as_dict() for cause in compared.causes],
        **({} if compared.colour is None else {"colour": compared.colour}),
        "white_spectrum": white_light(compared.irradiance)[1],
        "irradiance": compared.irradiance.header,
    }
