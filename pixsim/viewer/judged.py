"""What metrics judge: a frame with the chain that made it, and with its score, which is computed if a metric asks for it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from pixsim.base.errors import invalid
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.readout import Frame, integration_time_s
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metrics import DELTA_E, Metric, MetricContext, NoNumberError

if TYPE_CHECKING:
    from pixsim.viewer.score import FrameScore, ImagingChain, Score


@dataclass(frozen=True)
class Judging:
    """What is asked of the judges of frames.

    metrics : in the order of their columns
    options : of the metrics
    repeats : frames that share the registrations of a pixel size
    """

    metrics: tuple[Metric, ...] = (DELTA_E,)
    options: MetricOptions = METRIC_OPTIONS
    repeats: int = 1

    @property
    def needs_light(self) -> bool:
        """Whether a metric asks for the light of the scene."""
        return any(metric.needs_light for metric in self.metrics)

    @property
    def content(self) -> tuple[object, ...]:
        """What the numbers depend on: the settings of those metrics that have some, and the code of the user's functions."""
        own = {metric.name: getattr(self.options, metric.name, None) for metric in self.metrics}
        tables = {name: None if options is None else options.model_dump(mode="json") for name, options in own.items()}
        return tables, [metric.code for metric in self.metrics], self.repeats if self.needs_light else 0

    def check(self, asked: MetricContext) -> None:
        """Raise PixsimError for a metric that means nothing in a configuration."""
        for metric in self.metrics:
            if lacking := metric.lacking(asked):
                others = ", ".join(each.name for each in self.metrics if not each.lacking(asked))
                allowed = f"{lacking}; or other metrics" + (f", as {others}" if others else "")
                raise invalid("metrics", f"'{metric.name}'", allowed)


DELTA_E_ONLY = Judging()


@dataclass(frozen=True)
class Judged:
    """A frame that metrics judge.

    chain : from the light to frames
    frame : of the chain
    judging : what is asked
    number : of the frame among those of its pixel size
    stream : key of random streams for metrics that draw frames of their own
    """

    chain: ImagingChain
    frame: Frame
    judging: Judging = DELTA_E_ONLY
    number: int = 0
    stream: tuple[object, ...] = ()

    @property
    def options(self) -> MetricOptions:
        """Settings of the metrics."""
        return self.judging.options

    @cached_property
    def score(self) -> FrameScore:
        """The picture of the frame, and its S-CIELAB difference."""
        return self.chain.score_frame(self.frame)

    @property
    def mm_per_deg(self) -> float:
        """Length on the sensor that the viewer sees under a degree; of a metric in the scene's field, one of the lens."""
        screen = self.chain.screen
        return 1e-3 * screen.display.samples_per_deg * (screen.dot_um or self.chain.physics.read_pitch_um)

    def chains(self, count: int) -> Iterator[ImagingChain]:
        """Yield the chain, and those of further registrations, of which all frames of a pixel size together have `count`."""
        yield self.chain
        repeats = self.judging.repeats
        if self.chain.screen.display.raster == "fixed_size":  # else the array is centred
            yield from (self.chain.registered(self.number + k * repeats) for k in range(1, math.ceil(count / repeats)))

    def time_s(self, chain: ImagingChain) -> float:
        """Return the integration time of a chain, which depends on its brightest pixel."""
        if chain is self.chain:
            return self.frame.integration_s
        return integration_time_s(chain.exposure, chain.physics, float(chain.signal_e_per_s.max()))

    def statistics(self, lacking: dict[str, str] | None = None) -> dict[str, float]:
        """Return the numbers of a row: of the pixel, of the frame, and of each metric by its columns.

        lacking : as of `numbers_of`
        """
        found = self.score.gamut if any(metric.name == DELTA_E.name for metric in self.judging.metrics) else {}
        return frame_statistics(self.chain.physics, self.frame) | numbers_of(self.judging.metrics, self, lacking) | found


def numbers_of(metrics: Sequence[Metric], judged: Judged | Score, lacking: dict[str, str] | None = None) -> dict[str, float]:
    """Return the numbers of some metrics by their columns; of a Score alone, those of metrics that need no frame.

    lacking : gets the reason, by the metric's name, why one has no number, which is NaN then; None raises a NoNumberError
    """
    found: dict[str, float] = {}
    for metric in metrics:
        given = judged if metric.needs_frame or not isinstance(judged, Judged) else judged.score
        try:
            found |= metric.values(given)
        except NoNumberError as error:
            if lacking is None:
                raise
            lacking[metric.name] = str(error)
            found |= dict.fromkeys(metric.columns, math.nan)
    return found


def frame_statistics(physics: PixelPhysics, frame: Frame) -> dict[str, float]:
    """Return the numbers of a row that no metric gives: of the pixel and of the frame."""
    p = physics
    return {
        "pitch_um": p.pitch_um,
        "fill_factor": p.fill_factor,
        "full_well_e": p.full_well_e,
        "integration_s": frame.integration_s,
        "saturated_fraction": frame.saturated_fraction,
        "mean_electrons_e": float(frame.mean_e.mean()),
    }
