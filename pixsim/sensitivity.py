"""Which assumption decides: a study repeated with one assumption moved at a time over its plausible range."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

from pydantic import Field

from pixsim.config import merge
from pixsim.engine import Workers, results_of, workers_for
from pixsim.errors import did_you_mean, refuse
from pixsim.evaluations import Progress
from pixsim.files import output_folder
from pixsim.paper import REFERENCE_TECHNOLOGY, Evidence, Finding, reference_rows, scaling_rows
from pixsim.parameters import Camera, PitchRange, Record, Study, content_hash
from pixsim.spectral import SpectralImage
from pixsim.sweep import Curve, StudyResult, load_study, refuse_bad_pitches, render_for, scene_for, sweep_pitches
from pixsim.technology import load_technology


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
    repeats: Annotated[int, Field(ge=2, le=10000)] | None = Field(None, description="sensors for each pitch; None: the base's")
    pitch: PitchRange | None = Field(None, description="pixel sizes that are tried; None: the base's")
    vary: Annotated[tuple[Variation, ...], Field(min_length=1)]
    ranges: dict[str, str] = Field(
        default_factory=dict,
        description="name -> number of the technologies' files that goes to both ends of its range, in all and in one alone",
    )
    quick: dict[str, Any] = Field(default_factory=dict, description="replaces the above under --quick")

    def base_study(self) -> Study:
        """The base with this record's technologies, sensors and pitches. All cases share its random streams, and its target."""
        given = {"repeats": self.repeats, "pitch": self.pitch.model_dump() if self.pitch else None}
        own = {"technologies": self.technologies} | {name: each for name, each in given.items() if each is not None}
        table = load_study(self.base).model_dump(mode="json", exclude={"quick"})
        own["process"] = {name: numbers for name, numbers in table["process"].items() if name in self.technologies}
        return Study.model_validate(table | own | {"paper": table["paper"] and REFERENCE_TECHNOLOGY in self.technologies})


@dataclass(frozen=True)
class Move:
    """A number of one technology at an end of its range."""

    variation: str
    number: str
    end: int
    technology: str
    value: float

    def study(self, base: Study) -> Study:
        """The base with that technology alone."""
        table = base.model_dump(mode="json") | {"technologies": [self.technology], "paper": False}
        own = base.process.get(self.technology, {}) | {self.number: self.value}
        return Study.model_validate(table | {"process": {self.technology: own}})

    def __str__(self) -> str:
        return f"{self.technology} {self.value:g}"


@dataclass(frozen=True)
class Case:
    """One setting and what came out of it.

    curves : one for each technology
    rows : what it makes of the paper's statements; of another base, of those on scaling only
    alone : the technology that was moved while the others stayed, or nothing
    """

    variation: str
    label: str
    curves: tuple[Curve, ...] = field(repr=False)
    rows: tuple[Finding, ...] = field(default=(), repr=False)
    alone: str = ""

    @property
    def reference(self) -> Curve:
        """The curve of the paper's own process, or the first."""
        return next((curve for curve in self.curves if curve.technology == REFERENCE_TECHNOLOGY), self.curves[0])

    @property
    def agrees(self) -> dict[str, bool]:
        """Statement -> verdict."""
        return {row.statement: row.agrees for row in self.rows}

    def as_dict(self) -> dict[str, Any]:
        return {
            "variation": self.variation,
            "label": self.label,
            "alone": self.alone,
            "agrees": self.agrees,
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
    base_rows: tuple[Finding, ...]
    cases: tuple[Case, ...]

    @property
    def base_case(self) -> Case:
        return Case("base", self.sensitivity.base, self.base.curves, self.base_rows)

    def turning(self, statement: str) -> list[Case]:
        """The cases whose verdict on a statement is not the base's."""
        base = self.base_case.agrees[statement]
        # A setting may change what a statement is about, an iso level say: such a case has another statement.
        return [case for case in self.cases if case.agrees.get(statement, base) != base]

    def by_variation(self) -> dict[str, list[Case]]:
        """Variation -> its cases but those of one technology alone; the widest range of the reference's optimum comes first."""
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            if not case.alone:
                groups.setdefault(case.variation, []).append(case)

        def width(cases: list[Case]) -> float:
            sizes = [case.reference.optimum.pitch_um for case in (*cases, self.base_case)]
            return max(sizes) - min(sizes)

        return dict(sorted(groups.items(), key=lambda item: -width(item[1])))

    def as_dict(self) -> dict[str, Any]:
        """summary.json."""
        claims = [
            row.as_dict()
            | {"turned_by": [{"variation": case.variation, "label": case.label} for case in self.turning(row.statement)]}
            for row in self.base_rows
        ]
        return {
            "sensitivity": self.sensitivity.model_dump(mode="json", exclude={"quick"}),
            "base": self.base.as_dict(),
            "claims": claims,
            "cases": [case.as_dict() for case in self.cases],
        }


def cases_of(sensitivity: Sensitivity) -> Iterator[tuple[str, str, Study]]:
    """(variation, label, study) of every setting."""
    base = sensitivity.base_study().model_dump(mode="json")
    for variation in sensitivity.vary:
        for setting in variation.settings:
            yield variation.name, setting.label, Study.model_validate(merge(base, setting.set))


def moves_of(sensitivity: Sensitivity) -> list[Move]:
    """Every number of `ranges` at both ends, in each technology whose file has a range for it.

    Raises PixsimError for a number that no technology has.
    """
    processes = {name: load_technology(name) for name in sensitivity.technologies}
    moves = []
    for variation, number in sensitivity.ranges.items():
        known = dict.fromkeys(name for process in processes.values() for name in process.numbers)
        if number not in known:
            raise refuse(f"ranges.{variation}", f"'{number}'", ", ".join(known), did_you_mean(number, known))
        for end in (0, 1):
            for name, process in processes.items():
                # An A-grade number has no range, and one at the end of its range stays.
                value = process.ranges.get(number, (process.numbers.get(number),) * 2)[end]
                if value is not None and value != process.numbers[number]:
                    moves.append(Move(variation, number, end, name, value))
    return moves


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
    base, moves = sensitivity.base_study(), moves_of(sensitivity)
    moved = [move.study(base) for move in moves]
    cases = list(cases_of(sensitivity))
    for each in (base, *(study for _, _, study in cases), *moved):
        refuse_bad_pitches(each)
    for each in (base, *(study for _, _, study in cases)):
        scene_for(each, variant)
    stage = progress or (lambda _: lambda *_: None)
    renders: dict[str, tuple[SpectralImage, Camera]] = {}

    def render(study: Study) -> tuple[SpectralImage, Camera]:
        light = study.model_dump(mode="json", include={"scene", "camera", "seed", "tolerance_e", "render_noise", "max_seconds"})
        key = content_hash(
            [light, study.exposure.model_dump(), study.pixel.model_dump(), study.technologies[0], study.pitch.max_um]
        )
        if key not in renders:
            renders[key] = render_for(study, variant, stage("render"))
        return renders[key]

    def run(study: Study, name: str, light: tuple[SpectralImage, Camera]) -> StudyResult:
        result = sweep_pitches(study, *light, folder / "cases" / f"{name}.csv", workers, lambda: stage(name))
        return StudyResult(study, result.curves, *light)  # without its lights: many results stay until the end

    with workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        (folder / "cases").mkdir(exist_ok=True)
        # A process moves no light: the base's render, so that a technology that stays has the base's rows.
        results = [run(base, "base", render(base))]
        results += [run(study, file_name(n, name, label), render(study)) for n, (name, label, study) in enumerate(cases)]
        results += [
            run(study, file_name(len(cases) + n, move.variation, str(move)), render(base))
            for n, (move, study) in enumerate(zip(moves, moved, strict=True))
        ]
        rows: list[tuple[Finding, ...]] = [()] * len(results)
        if base.paper:
            rows = claims(results, workers, stage("claims"))
    return assemble(sensitivity, results, rows, moves)


def claims(results: list[StudyResult], workers: Workers, progress: Progress) -> list[tuple[Finding, ...]]:
    """What each result says of the paper's own process; nothing where it does not have it."""
    found: list[tuple[Finding, ...]] = [()] * len(results)
    with_reference = [
        (number, result)
        for number, result in enumerate(results)
        if any(c.technology == REFERENCE_TECHNOLOGY for c in result.curves)
    ]
    calls = [(number, partial(itself, result)) for number, result in with_reference]
    for done, (number, rows) in enumerate(results_of(claims_task, calls, workers), 1):
        found[number] = rows
        progress(done / len(calls))
    return found


def itself(result: StudyResult) -> StudyResult:
    """What a worker shares with no other."""
    return result


def claims_task(number: int, result: StudyResult) -> tuple[int, tuple[Finding, ...]]:
    """The rows of one result, with its number."""
    return number, tuple(reference_rows(Evidence(result, {curve.technology: curve for curve in result.curves})))


def assemble(
    sensitivity: Sensitivity, results: list[StudyResult], rows: list[tuple[Finding, ...]], moves: list[Move]
) -> SensitivityResult:
    """The cases from results and their rows, each the base's, then those of `vary`, then one for each of `moves`.

    Technologies do not depend on each other, so that a case of several that are moved is put together from those of one.
    """
    base, base_rows = results[0], rows[0]

    def trends(curves: Sequence[Curve]) -> list[Finding]:
        return scaling_rows(curves) if base.study.paper else []

    named = [(variation.name, setting.label) for variation in sensitivity.vary for setting in variation.settings]
    cases = [
        Case(*names, result.curves, (*own, *trends(result.curves)))
        for names, result, own in zip(named, results[1:], rows[1:], strict=False)
    ]
    ends: dict[tuple[str, int], list[tuple[Move, Curve, tuple[Finding, ...]]]] = {}
    for move, result, own in zip(moves, results[1 + len(named) :], rows[1 + len(named) :], strict=True):
        ends.setdefault((move.variation, move.end), []).append((move, result.curves[0], own))
    for (variation, end), group in ends.items():
        together = [(f"all {('low', 'high')[end]}", "", group)] if len(group) > 1 else []
        alone = [(str(each[0]), each[0].technology if together else "", [each]) for each in group]
        for label, technology, part in (*together, *alone):
            own_curves = {move.technology: curve for move, curve, _ in part}
            curves = tuple(own_curves.get(curve.technology, curve) for curve in base.curves)
            own_rows = next((found for move, _, found in part if move.technology == REFERENCE_TECHNOLOGY), base_rows)
            cases.append(Case(variation, label, curves, (*own_rows, *trends(curves)), technology))
    return SensitivityResult(sensitivity, base, (*base_rows, *trends(base.curves)), tuple(cases))


def turned_words(settings: Sequence[tuple[str, str]]) -> str:
    """(variation, label) of each setting that turns a verdict, by variation, for people."""
    groups: dict[str, list[str]] = {}
    for variation, label in settings:
        groups.setdefault(variation, []).append(label)
    return "; ".join(f"{variation} ({', '.join(labels)})" for variation, labels in groups.items()) or "none"


def file_name(number: int, variation: str, label: str) -> str:
    """Numbered, since different labels may clean to the same name."""
    return re.sub(r"[^\w.\-]+", "_", f"{number:02d}-{variation}-{label}")
