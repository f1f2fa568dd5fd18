"""How probably one sensor of a comparison is better, over sensor types whose numbers are drawn from their ranges.

The types of all sensors are drawn together, as those of a study (`pixsim.studies.uncertainty`). A type's difference is that of the
sensors as they are, plus what the type changes it in its first frames, whose random numbers are the same.
"""

from __future__ import annotations

import math
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
from pixsim.studies.indices import Share
from pixsim.studies.sensor_types import Asked, sample_of
from pixsim.studies.series import Series
from pixsim.studies.uncertainty import (
    Probability,
    ResultDistribution,
    Sample,
    Unknown,
    input_labels,
    plain_shares,
    sample_types,
    unknowns_of_process,
    unknowns_of_sheet,
)
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.scene_light import SceneCache
from pixsim.viewer.setting import Run


@dataclass(frozen=True)
class Types:
    """The sensor types of a comparison.

    asked : as given; the sample has a power of two of them
    spreads : [pixel.uncertainty] of each sensor's file
    sample : drawn for all sensors, whose names are the technologies of its unknowns
    """

    asked: int
    spreads: tuple[Mapping[str, Spread], ...]
    sample: Sample

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
        return cls(asked, spreads, sample_types(unknowns, draws, sensors[0].settings.seed))

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
            yield replace(
                imaging, pixel=drawn, technology=technology.with_numbers(process, name) if process else imaging.technology
            )


def series_of_types(base: Series, types: Types) -> list[Series]:
    """Return the series of each type of a sensor, in the same light, on the first display of the sensor's own series."""
    imaging = base.imaging
    scenes = SceneCache(imaging, base.scenes.light, len(imaging.physics.channels))
    return [
        replace(base, imaging=of_type, scenes=scenes, columns={**base.columns, "draw": str(draw)})
        for draw, of_type in enumerate(types.imagings(base.name, imaging))
    ]


@dataclass(frozen=True)
class PairUncertainty:
    """The difference of two sensors by a metric over sensor types.

    names : of the two sensors, a and b
    types : the sensor types
    differences : ΔE(b) - ΔE(a) of each, (n,), or those of another metric in its unit
    scatter_variances : of each difference by the noise of its frames, (n,)
    metric : that judges
    """

    names: tuple[str, str]
    types: Types
    differences: Array = field(repr=False)
    scatter_variances: Array = field(repr=False)
    metric: Metric = field(default=DELTA_E, repr=False)

    @cached_property
    def sample(self) -> Sample:
        """The sensor types with the inputs of these two sensors only."""
        return sample_of(self.types.sample, *self.names)

    @cached_property
    def probability_a_better(self) -> Probability:
        """Share of the types with a lower mean ΔE of a, or a better value, with its 95 % interval; an equal one counts half."""
        return Probability.of((0.5 * (1.0 + np.sign(self.metric.worse_by(self.differences, 0.0)))).tolist())

    @property
    def difference(self) -> ResultDistribution:
        """Distribution of the difference."""
        return ResultDistribution(self.differences)

    @cached_property
    def shares(self) -> dict[str, dict[str, Share]]:
        """Shares of the variance of the difference: input -> `first` -> share."""
        return self.sample.shares(self.differences, self.scatter_variances)

    @property
    def matters(self) -> str:
        """The unknown number with the largest share of the variance, in words."""
        shares = {label: self.shares[name]["first"] for name, label in input_labels(self.sample).items()}
        shares = {label: share for label, share in shares.items() if not math.isnan(share.share)}
        if not shares:
            return "no number explains the difference, which does not vary or has too few sensor types"
        name = max(shares, key=lambda label: shares[label].share)
        return f"{name} matters most, with {shares[name]} of the variance"

    @property
    def words(self) -> str:
        """Probability, quantiles and the unknown that matters most, in words."""
        first, other = self.names
        better = self.probability_a_better
        low, middle, high = (f"{value:+.2g}" for value in self.difference.quantiles.values())
        judge, unit = (
            ("", " ΔE") if self.metric.is_delta_e else (f"{self.metric.words}: ", self.metric.unit and f" {self.metric.unit}")
        )
        return (
            f"{judge}over {better.draws} sensor types {first} is better than {other} with the probability {better}; difference "
            f"{middle}{unit} in the median, nine tenths from {low} to {high}; {self.matters}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in compare.json."""
        return {
            "draws": len(self.differences),
            "asked": self.types.asked,
            "probability_a_better": asdict(self.probability_a_better),
            "difference": {"quantiles": self.difference.quantiles},
            "inputs": self.sample.stated,
            "shares": plain_shares(self.shares),
        }
