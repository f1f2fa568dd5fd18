"""Settings that nothing uses in a study, beside those of `pixsim.viewer.unused`: on its pixel sizes, sensors and rounds."""

from __future__ import annotations

from dataclasses import dataclass

from pixsim.base.records import Record
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.studies.study_settings import Study
from pixsim.viewer.unused import RULES, Configuration, Rule, of_fill_factor_law


@dataclass(frozen=True, kw_only=True)
class StudyConfiguration(Configuration):
    """Settings of a study that hold together, and one of its pixels."""

    study: Study

    @classmethod
    def of_technology(cls, study: Study, physics: PixelPhysics, technology: str) -> StudyConfiguration:
        """Return that of one technology of a study at any of its pixel sizes."""
        own = study.exposure, study.correction, study.develop, study.display, study.camera, study.lens
        return cls(physics, study.options_of(technology), *own, study, study=study, motion=study.motion)

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules on its settings."""
        return rules_of(self.study)

    @property
    def tables(self) -> dict[str, Record]:
        """Its tables by their names."""
        return super().tables | {"pitch": self.study.pitch}


def of_rounds(study: Study) -> str:
    if study.target_ci_um or (study.refine and study.pitch.values_um is None):
        return ""
    why = "refine = false" if not study.refine else "a list of sizes"
    return f"without target_ci_um, and with {why}, no sizes and sensors are added"


def of_refining(study: Study) -> str:
    if study.target_ci_um:
        return "target_ci_um says how far sizes and sensors are added"
    return "" if study.pitch.values_um is None else "sizes and sensors are not added to a list of sizes"


def of_listed(study: Study) -> str:
    return "pitch.values_um lists the pixel sizes" if study.pitch.values_um is not None else ""


def of_smallest(study: Study) -> str:
    if study.pitch.min_um is not None:
        return of_listed(study) or "pitch.min_um states the smallest pixel size"
    of_sheet = study.own_um is not None
    return of_listed(study) or ("the sizes of a data sheet begin at a part of its own" if of_sheet else "")


def of_own_size(study: Study) -> str:
    of_sheet = NO_TECHNOLOGY in study.technologies
    return "" if of_sheet else "it is about a study whose [pixel] is a data sheet"


def rules_of(study: Study) -> tuple[Rule, ...]:
    """Return the rules on the settings of a study."""
    # The sizes of a technology may begin where the law says.
    starts_there = study.open_range_um[0] is None and study.pitch.values_um is None
    return (
        *(rule for rule in RULES if rule.why is not of_fill_factor_law),
        Rule(("pixel.fill_factor_law",), lambda c: "" if starts_there and not c.from_sheet else of_fill_factor_law(c)),
        Rule(("max_repeats",), lambda _: of_rounds(study)),
        Rule(("max_evaluations",), lambda _: of_rounds(study)),
        Rule(("refine",), lambda _: of_refining(study)),
        Rule(("pitch.min_um", "pitch.max_um", "pitch.count"), lambda _: of_listed(study)),
        Rule(("pitch.min_fill_factor",), lambda _: of_smallest(study)),
        Rule(("pitch.own_um",), lambda _: of_own_size(study)),
    )
