"""Which assumption decides: a study repeated with one assumption moved at a time over its plausible range."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pixsim.config import merge
from pixsim.engine import workers_for
from pixsim.evaluations import Progress
from pixsim.files import output_folder
from pixsim.parameters import Camera, PitchRange, Record, Study, content_hash
from pixsim.spectral import SpectralImage
from pixsim.sweep import Curve, StudyResult, load_study, refuse_bad_pitches, render_for, scene_for, sweep_pitches


class Setting(Record):
    """One value of an assumption: a label, and what it changes in the study."""

    label: str
    set: dict[str, Any]


class Variation(Record):
    """An assumption and the values that it may plausibly have."""

    name: str
    settings: Annotated[tuple[Setting, ...], Field(min_length=1)]


class Sensitivity(Record):
    """A base study and the assumptions to move, one at a time."""

    name: Annotated[str, Field(pattern=r"^[\w.\-]+$")]
    title: str = ""
    base: str = Field("chen2000", description="a packaged study or a TOML file")
    technologies: Annotated[tuple[str, ...], Field(min_length=1)] = ("0.35um",)
    repeats: Annotated[int, Field(ge=2, le=10000)] = 8
    pitch: PitchRange = PitchRange(count=14)
    vary: Annotated[tuple[Variation, ...], Field(min_length=1)]
    quick: dict[str, Any] = Field(default_factory=dict, description="replaces the above under --quick")

    def base_study(self) -> Study:
        """The base with this record's technologies, sensors and pitches. All cases share its random streams."""
        own = {"technologies": self.technologies, "repeats": self.repeats, "pitch": self.pitch.model_dump()}
        table = load_study(self.base).model_dump(mode="json", exclude={"pitch", "quick"})
        return Study.model_validate(table | own | {"paper": False, "target_ci_um": None})


@dataclass(frozen=True)
class Case:
    """One setting and what came out of it."""

    variation: str
    label: str
    curves: tuple[Curve, ...] = field(repr=False)

    @property
    def first(self) -> Curve:
        return self.curves[0]

    def scaling(self) -> dict[str, bool] | None:
        """How the optima move along the technologies as given (largest first), or None for a single one."""
        if len(self.curves) < 2:
            return None
        size = np.array([curve.optimum.pitch_um for curve in self.curves])
        ratio = size / [curve.feature_size_um for curve in self.curves]
        best = [curve.optimum.mean_delta_e for curve in self.curves]
        return {
            "optimum_shrinks_at_every_step": bool((np.diff(size) < 0).all()),
            "slower_than_technology": bool(ratio[-1] > ratio[0]),
            "best_delta_e_gets_worse": bool(best[-1] > best[0]),
        }

    def as_dict(self) -> dict[str, Any]:
        return {
            "variation": self.variation,
            "label": self.label,
            "scaling": self.scaling(),
            "technologies": [
                {
                    "technology": curve.technology,
                    "optimum": curve.optimum.as_dict(),
                    "optimum_fill_factor": curve.optimum_fill_factor,
                }
                for curve in self.curves
            ],
        }


@dataclass(frozen=True)
class SensitivityResult:
    """The base case and all others, in the order of the file."""

    sensitivity: Sensitivity
    base: StudyResult
    cases: tuple[Case, ...]

    @property
    def base_case(self) -> Case:
        return Case("base", self.sensitivity.base, self.base.curves)

    def by_variation(self) -> dict[str, list[Case]]:
        """Variation -> its cases; the widest range of the first technology's optimum comes first."""
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            groups.setdefault(case.variation, []).append(case)

        def width(cases: list[Case]) -> float:
            sizes = [case.first.optimum.pitch_um for case in (*cases, self.base_case)]
            return max(sizes) - min(sizes)

        return dict(sorted(groups.items(), key=lambda item: -width(item[1])))

    def as_dict(self) -> dict[str, Any]:
        """summary.json."""
        return {
            "sensitivity": self.sensitivity.model_dump(mode="json", exclude={"quick"}),
            "base": self.base.as_dict() | {"scaling": self.base_case.scaling()},
            "cases": [case.as_dict() for case in self.cases],
        }


def cases_of(sensitivity: Sensitivity) -> Iterator[tuple[str, str, Study]]:
    """(variation, label, study) of every setting."""
    base = sensitivity.base_study().model_dump(mode="json")
    for variation in sensitivity.vary:
        for setting in variation.settings:
            yield variation.name, setting.label, Study.model_validate(merge(base, setting.set))


def run_sensitivity(
    sensitivity: Sensitivity,
    out: str | os.PathLike[str],
    *,
    quick: bool = False,
    jobs: int | None = None,
    scheduler: Any = None,
    variant: str | None = None,
    progress: Callable[[str], Progress] | None = None,
) -> SensitivityResult:
    """Run the base and every case; each keeps its rows in `out`/cases/, so an interrupted run goes on.

    Raises PixsimError or ValidationError for input that cannot be used, before anything is rendered.
    """
    if quick:
        table = merge(sensitivity.model_dump(mode="json", exclude={"quick"}), sensitivity.quick)
        sensitivity = Sensitivity.model_validate(table)
    base = sensitivity.base_study()
    cases = list(cases_of(sensitivity))
    for each in (base, *(study for _, _, study in cases)):
        refuse_bad_pitches(each)
        scene_for(each, variant)
    stage = progress or (lambda _: lambda *_: None)
    renders: dict[str, tuple[SpectralImage, Camera]] = {}

    def run(study: Study, name: str) -> StudyResult:
        light = study.model_dump(mode="json", include={"scene", "camera", "seed", "tolerance_e", "render_noise", "max_seconds"})
        key = content_hash(
            [light, study.exposure.model_dump(), study.pixel.model_dump(), study.technologies[0], study.pitch.max_um]
        )
        if key not in renders:
            renders[key] = render_for(study, variant, stage("render"))
        results = folder / "cases" / f"{name}.csv"
        return sweep_pitches(study, *renders[key], results, workers, lambda: stage(name))

    with workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        (folder / "cases").mkdir(exist_ok=True)
        first = run(base, "base")
        done = [
            Case(variation, label, run(study, file_name(number, variation, label)).curves)
            for number, (variation, label, study) in enumerate(cases)
        ]
    return SensitivityResult(sensitivity, first, tuple(done))


def file_name(number: int, variation: str, label: str) -> str:
    """Numbered, since different labels may clean to the same name."""
    return re.sub(r"[^\w.\-]+", "_", f"{number:02d}-{variation}-{label}")
