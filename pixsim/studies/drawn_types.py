"""Sensor types of a study and of a comparison: which numbers of their sensors are not known, and values drawn for these.

A type of a study's sensor is a case of the study, with numbers of its own. The types of all sensors of a comparison are drawn
together. What is made of the draws is in `pixsim.studies.uncertainty`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pixsim.base.arguments import checks_arguments
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.toml import whole_path
from pixsim.sensor.labels import file_label, labels_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.spread import Spread, Uncertainty, sheet_uncertainty
from pixsim.sensor.technology import load_technology
from pixsim.studies.design import Case, check_number
from pixsim.studies.files import spreads_of_study
from pixsim.studies.settings import Study
from pixsim.studies.sizes import technology_of
from pixsim.studies.uncertainty import (
    LEAST_DRAWS,
    MOST_DRAWS,
    MOST_EVALUATIONS,
    Sample,
    Unknown,
    drawn_metrics,
    sample_types,
    sobol_points,
    unknowns_of_process,
    unknowns_of_sheet,
)
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.setting import Run

MOST_VALUES = 5  # of the axis of a study whose sensor types are drawn


@dataclass(frozen=True)
class Asked:
    """What is asked about the unknown numbers.

    draws : sensor types; rounded up to a power of two
    total : whether the draws are those of total indices, draws × (inputs + 2)
    smaller_than_um : pixel sizes; the probability that the optimum is smaller is reported
    uncertainty : of the study's own [pixel] and data sheets, as its files state it
    """

    draws: int
    total: bool = False
    smaller_than_um: tuple[float, ...] = ()
    uncertainty: Uncertainty = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not LEAST_DRAWS <= self.draws <= MOST_DRAWS:
            raise invalid(
                setting("sobol" if self.total else "uncertainty"), self.draws, f"{LEAST_DRAWS} to {MOST_DRAWS} sensor types"
            )

    def sample(self, study: Study) -> Sample:
        """Return the sensor types. Raises PixsimError if nothing is unknown."""
        make = sobol_points if self.total else sample_types
        return make(unknowns_of_study(study, self.uncertainty), self.draws, study.seed)


def asked_of(uncertainty: int | None, sobol: int | None, smaller_than_um: Sequence[float], spreads: Uncertainty) -> Asked | None:
    """Return what is asked about the unknown numbers; None if nothing is.

    uncertainty, sobol : sensor types to draw, or those of total indices
    smaller_than_um : as in `Asked`
    spreads : `Asked.uncertainty`

    Raises PixsimError for both numbers of types, and for sizes without any.
    """
    if uncertainty is not None and sobol is not None:
        raise invalid(setting("uncertainty"), f"with {setting('sobol')}", "one of the two")
    draws = uncertainty if sobol is None else sobol
    if draws is not None:
        return Asked(draws, sobol is not None, tuple(smaller_than_um), spreads)
    if smaller_than_um:
        got = f"without {setting('uncertainty')}"
        raise invalid(setting("smaller_than_um"), got, f"{setting('uncertainty', 'N')} beside it")
    return None


@checks_arguments
def unknowns_of_study(study: Study, uncertainty: Mapping[str, Mapping[str, Spread]] | None = None) -> list[Unknown]:
    """Return all numbers of a study's sensors that are not known: of [pixel], its data sheets, and its technologies.

    uncertainty : of the study's own [pixel] by the name '', and of data sheets; that of others stands in their files

    Numbers that the study or a data sheet gives in place of a technology's are known, unless their own uncertainty is given.

    Raises PixsimError for a file that is damaged, and as `unknowns_of_sheet`.
    """
    spreads = spreads_of_study(study, uncertainty or {})
    unknowns = unknowns_of_sheet(study.pixel, spreads[""])
    for name in study.technologies:
        if name in study.sensors:
            unknowns += unknowns_of_sheet(study.sensors[name], spreads[name], name)
        unknowns += unknowns_of_process(study.options_of(name), technology_of(study, name), name, study.process.get(name, {}))
    return unknowns


def check_axes(study: Study) -> None:
    """Raise PixsimError for axes with which sensor types cannot be drawn."""
    if any(axis.alone for axis in study.axis) or len(study.axis) > 1 or any(len(axis.points) > MOST_VALUES for axis in study.axis):
        got = ", ".join(f"{axis.name} with {len(axis.points)} values" for axis in study.axis)
        raise invalid(setting("uncertainty"), f"a study with the axes {got}", f"at most one axis of at most {MOST_VALUES} values")


def check_types(study: Study, cases: Sequence[Study], asked: Asked, agreed: bool) -> tuple[int, int]:
    """Return the number of sensor types of a study and of their evaluations at most, for all metrics.

    cases : of the study
    agreed : whether they may be very many

    Raises PixsimError for axes with which types cannot be drawn, if nothing is unknown, and for too many evaluations.
    """
    check_axes(study)
    types = len(asked.sample(cases[0]).quantiles)
    evaluations = types * MOST_EVALUATIONS * sum(len(case.technologies) * len(drawn_metrics(case)) for case in cases)
    check_number(types, evaluations, agreed)
    return types, evaluations


@dataclass(frozen=True)
class Types:
    """The sensor types of a comparison.

    asked : as given; the sample has a power of two of them
    spreads : [pixel.uncertainty] of each sensor's file
    sample : drawn for all sensors, whose names are the technologies of its unknowns
    total : whether they are the points of total indices
    """

    asked: int
    spreads: tuple[Mapping[str, Spread], ...]
    sample: Sample
    total: bool = False

    @classmethod
    def of(cls, asked: Asked, sensors: Sequence[Case[Run]]) -> Types:
        """Draw sensor types. Raises PixsimError if nothing is unknown."""
        spreads = tuple(sheet_uncertainty(Path(each.file)) if Path(each.file).is_file() else {} for each in sensors)
        files = list(dict.fromkeys(whole_path(each.settings.pixel.technology) for each in sensors))
        processes = dict(zip(files, labels_of([file_label(file) for file in files]), strict=True))
        unknowns: list[Unknown] = []
        for each, own in zip(sensors, spreads, strict=True):
            name, pixel = each.sensor, each.settings.pixel
            unknowns += unknowns_of_sheet(pixel, own, name)
            if pixel.technology != NO_TECHNOLOGY:
                process = processes[whole_path(pixel.technology)]
                of_process = unknowns_of_process(pixel, load_technology(pixel.technology), name)
                unknowns += [replace(unknown, process=process) for unknown in of_process]
        make = sobol_points if asked.total else sample_types
        return cls(asked.draws, spreads, make(unknowns, asked.draws, sensors[0].settings.seed), asked.total)

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
