"""One frame under test, and the values of its metrics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from pixsim.base.lazy import cached_property
from pixsim.sensor.readout import Frame
from pixsim.viewer.chain import ExpectedFrame, ImagingChain
from pixsim.viewer.development import Development
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.metrics import Metric, NoNumberError
from pixsim.viewer.score import FrameScore, Score, frame_statistics


@dataclass(frozen=True)
class FrameUnderTest:
    """A frame that metrics are computed of.

    development : how the frame becomes a picture
    registrations : yields the expected frames of this pixel size, this frame first, at so
        many registrations under all frames of the size together; where dots are pixels, of this
        frame alone. Only for light that metrics ask for
    stream : key of random streams for metrics that draw frames of their own
    """

    frame: Frame
    development: Development
    registrations: Callable[[int], Iterator[ExpectedFrame]] = field(repr=False)
    stream: tuple[object, ...] = ()

    @classmethod
    def of(
        cls, chain: ImagingChain, frame: Frame, number: int = 0, stream: tuple[object, ...] = ()
    ) -> FrameUnderTest:
        """Return the record of a frame of a chain.

        number : of the frame among the frames of its pixel size
        stream : as the field, without the number
        """

        def registrations(count: int) -> Iterator[ExpectedFrame]:
            yield chain.expected(frame.integration_s)
            repeats = chain.imaging.metrics.repeats
            others = (
                math.ceil(count / repeats) if chain.screen.display.raster == "fixed_size" else 1
            )
            for step in range(1, others):
                other = chain.registered(number + step * repeats)
                yield other.expected(other.integration_s)

        return cls(frame, chain.development, registrations, (*stream, number))

    @property
    def imaging(self) -> Imaging:
        """Settings of the frame."""
        return self.development.imaging

    @property
    def options(self) -> MetricOptions:
        """Settings of the metrics."""
        return self.imaging.metrics.options

    @cached_property
    def expected(self) -> ExpectedFrame:
        """Expectation of the frame, without noise."""
        return next(self.registrations(1))

    @cached_property
    def score(self) -> FrameScore:
        """The picture of the frame, and its S-CIELAB difference; computed if a metric asks for
        it.
        """
        return self.development.score(self.frame)

    def statistics(self, missing: dict[str, str] | None = None) -> dict[str, float]:
        """Return the numbers of a row: of the pixel, of the frame, and of each metric by its
        columns.

        missing : gets the reason, by the metric's name, why one has no number
        """
        metrics = self.imaging.metrics.chosen
        numbers = frame_statistics(self.development.readout, self.frame) | numbers_of(
            metrics, self, missing
        )
        return (
            numbers | self.score.gamut if any(metric.is_delta_e for metric in metrics) else numbers
        )


def numbers_of(
    metrics: Sequence[Metric],
    under_test: FrameUnderTest | Score,
    missing: dict[str, str] | None = None,
) -> dict[str, float]:
    """Return the numbers of metrics by their columns.

    under_test : a frame, or a Score alone, of which metrics that need no frame have numbers

    missing : gets the reason, by the metric's name, why one has no number, which is NaN then. None
        raises a NoNumberError
    """
    numbers: dict[str, float] = {}
    for metric in metrics:
        try:
            if isinstance(under_test, FrameUnderTest) and not metric.needs_frame:
                numbers |= metric.values(under_test.score)
            else:
                numbers |= metric.values(under_test)
        except NoNumberError as error:
            if missing is None:
                raise
            missing[metric.name] = str(error)
            numbers |= dict.fromkeys(metric.columns, math.nan)
    return numbers
