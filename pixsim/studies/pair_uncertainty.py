"""What is not known of the sensors of a comparison: how probably one of them is better, over sensor types.

The types of all sensors are drawn together, as those of a study (`pixsim.studies.uncertainty`). A type's difference is that of the
sensors as they are, plus what the type changes it in its first frames, whose random numbers are the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.toml import whole_path
from pixsim.sensor.labels import file_label, labels_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.spread import Spread, sheet_uncertainty
from pixsim.sensor.technology import load_technology
from pixsim.studies.cases import Case
from pixsim.studies.indices import FirstOrderIndices, first_order
from pixsim.studies.sensor_types import Asked, sample_of
from pixsim.studies.series import Series
from pixsim.studies.uncertainty import (
    Probability,
    ResultDistribution,
    Sample,
    Unknown,
    input_labels,
    sample_types,
    unknowns_of_process,
    unknowns_of_sheet,
)
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.score import SceneCache
from pixsim.viewer.setting import Run


@dataclass(frozen=True)
class Types:
    """The sensor types of a comparison.

    asked : as given; the sample has a power of two of them
    spreads : [pixel.uncertainty] of each sensor's file
    sample : drawn for all sensors, whose names are the technologies of its unknowns
    seed : of the draws
    """

    asked: int
    spreads: tuple[Mapping[str, Spread], ...]
    sample: Sample
    seed: int

    @classmethod
    def of(cls, draws: int, sensors: Sequence[Case[Run]]) -> Types:
        """Draw sensor types. Raises PixsimError for a number of types out of range, and if nothing is unknown."""
        asked = Asked(draws).draws
        spreads = tuple(sheet_uncertainty(Path(each.file)) if Path(each.file).is_file() else {} for each in sensors)
        files = list(dict.fromkeys(whole_path(each.settings.pixel.technology) for each in sensors))
        processes = dict(zip(files, labels_of([file_label(file) for file in files]), strict=True))
        unknowns: list[Unknown] = []
        for each, own in zip(sensors, spreads, strict=True):
            name, pixel = each.name, each.settings.pixel
            unknowns += unknowns_of_sheet(pixel, own, name)
            if pixel.technology != NO_TECHNOLOGY:
                process = processes[whole_path(pixel.technology)]
                of_process = unknowns_of_process(pixel, load_technology(pixel.technology), name)
                unknowns += [replace(unknown, process=process) for unknown in of_process]
        seed = sensors[0].settings.seed
        return cls(asked, spreads, sample_types(unknowns, draws, seed), seed)

    def imagings(self, name: str, imaging: Imaging) -> Iterator[Imaging]:
        """Yield what lies between light and score of each type of a sensor.

        name, imaging : of the sensor as it is; numbers that a condition sets are known in it
        """
        pixel = imaging.pixel
        unknowns = [each for members in self.sample.inputs.values() for each in members if each.technology == name]
        of_sheet = [each for each in unknowns if each.of_sheet and getattr(pixel, each.quantity) == each.value]
        of_process = [each for each in unknowns if not each.of_sheet and getattr(pixel, each.quantity, None) is None]
        technology = load_technology(pixel.technology)
        for draw in self.sample.draws:
            numbers = {each.quantity: draw[each.name] for each in of_sheet}
            process = {each.quantity: draw[each.name] for each in of_process}
            drawn = Pixel(**pixel.model_dump() | numbers) if numbers else pixel
            yield replace(imaging, pixel=drawn, process=technology.with_numbers(process, name) if process else imaging.process)


def series_of_types(base: Series, types: Types) -> list[Series]:
    """Return the series of each type of a sensor, in the same light, on the first display of the sensor's own series."""
    imaging = base.imaging
    of_light = base.scenes.irradiance, imaging.camera, imaging.display, len(imaging.physics.channels)
    scenes = SceneCache(
        *of_light, single=imaging.single, judging=imaging.judging, without=base.scenes.without, develop=imaging.develop
    )
    return [
        replace(base, imaging=of_type, scenes=scenes, columns={**base.columns, "draw": str(draw)})
        for draw, of_type in enumerate(types.imagings(base.name, imaging))
    ]


@dataclass(frozen=True)
class PairUncertainty:
    """What is known of the difference of two sensors by a metric when their numbers are not.

    names : of the two sensors, a and b
    types : the sensor types
    differences : ΔE(b) - ΔE(a) of each, (n,), or those of another metric in its unit
    metric : that judges
    """

    names: tuple[str, str]
    types: Types
    differences: Array = field(repr=False)
    metric: Metric = field(default=DELTA_E, repr=False)

    @cached_property
    def sample(self) -> Sample:
        """The sensor types with the inputs of these two sensors only."""
        return sample_of(self.types.sample, *self.names)

    @cached_property
    def probability_a_better(self) -> Probability:
        """Share of the types with a lower mean ΔE of a, or a better value, with its 95 % interval; an equal one counts half."""
        return Probability.of((0.5 * (1.0 + np.sign(self.metric.worse_by(self.differences, 0.0)))).tolist())

    @cached_property
    def difference(self) -> ResultDistribution:
        """Distribution of the difference."""
        return ResultDistribution.of(self.differences)

    @cached_property
    def first_order(self) -> FirstOrderIndices:
        """Share of the variance of the difference that each unknown alone explains."""
        return first_order(self.sample.quantiles, self.differences, self.sample.marginals, self.types.seed)

    @property
    def matters(self) -> str:
        """The unknown that matters most, with its share of the variance, in words; or why it is not told."""
        if self.first_order.withheld:
            return f"which unknown matters most is not told: {self.first_order.withheld}"
        name, index = max(self.first_order.indices.items(), key=lambda item: item[1].share)
        return f"{input_labels(self.sample)[name]} matters most, with {index.share:.0%} of the variance"

    @property
    def words(self) -> str:
        """Probability, quantiles and the unknown that matters most, in words."""
        first, other = self.names
        found, ends = self.probability_a_better, self.difference.quantiles
        low, middle, high = (f"{ends[name]:+.2g}" for name in ("p05", "p50", "p95"))
        judge, unit = (
            ("", " ΔE") if self.metric.is_delta_e else (f"{self.metric.words}: ", self.metric.unit and f" {self.metric.unit}")
        )
        return (
            f"{judge}over {found.draws} sensor types {first} is better than {other} with the probability {found}; difference "
            f"{middle}{unit} in the median, nine tenths from {low} to {high}; {self.matters}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in compare.json."""
        return {
            "draws": len(self.differences),
            "asked": self.types.asked,
            "probability_a_better": asdict(self.probability_a_better),
            "difference": self.difference.as_dict(),
            "inputs": self.sample.stated,
            "first_order": self.first_order.as_dict(),
        }
