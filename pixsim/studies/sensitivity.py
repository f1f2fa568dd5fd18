"""Sensitivity analysis: a study repeated with one assumption at a time varied over its plausible range."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from pixsim.base.config import SETTINGS_FILE, packaged, settings_text, whole_path
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import output_folder, publishing, versions, write_json
from pixsim.base.notes import collected_notes
from pixsim.base.parameters import PitchRange, Record, Study, content_hash, merge
from pixsim.base.progress import Progress, Stage
from pixsim.sensor.technology import load_technology
from pixsim.show.figures import COLOURS, literal, new_figure
from pixsim.show.pages import Column, Plate, write_figures, write_page
from pixsim.studies.cases import Case as StudyCase
from pixsim.studies.claims import REFERENCE_TECHNOLOGY, Evidence, Finding, reference_rows, scaling_rows
from pixsim.studies.engine import Workers, results_of, workers_for
from pixsim.studies.evaluations import ResultsFile
from pixsim.studies.preparation import View
from pixsim.studies.result import Curve, StudyResult, interval_columns, interval_words
from pixsim.studies.study import (
    Light,
    check_pitches,
    check_technologies,
    evaluate_cases,
    load_study,
    prepare,
    render_for,
    repeating_command,
)


class Setting(Record):
    """One value of an assumption: a label, and the study values that it changes."""

    label: str
    set: dict[str, Any]


class Variation(Record):
    """An assumption and its plausible values."""

    name: str
    settings: Annotated[tuple[Setting, ...], Field(min_length=1)]


class Sensitivity(Record):
    """A base study and the assumptions to vary, one at a time."""

    name: Annotated[str, Field(pattern=r"^[\w.\-]+$")]
    title: str = ""
    base: str = Field("chen2000", description="a packaged study or a TOML file")
    technologies: Annotated[tuple[str, ...], Field(min_length=1)] = ("0.35um",)
    repeats: Annotated[int, Field(ge=2, le=10000)] | None = Field(None, description="sensors per pitch; None: those of the base")
    pitch: PitchRange | None = Field(None, description="pixel sizes; None: those of the base")
    vary: Annotated[tuple[Variation, ...], Field(min_length=1)]
    ranges: dict[str, str] = Field(
        default_factory=dict,
        description=(
            "name -> technology parameter that is set to both ends of its range, in all technologies together and in each alone"
        ),
    )
    quick: dict[str, Any] = Field(default_factory=dict, description="values that --quick uses instead")

    def base_study(self) -> Study:
        """Return the base study with this record's technologies, sensors and pitches; all cases share its random streams."""
        given = {"repeats": self.repeats, "pitch": self.pitch.model_dump() if self.pitch else None}
        changes = {"technologies": self.technologies} | {name: value for name, value in given.items() if value is not None}
        base = load_study(self.base)
        changes["process"] = {name: numbers for name, numbers in base.process.items() if name in self.technologies}
        changes["paper"] = base.paper and REFERENCE_TECHNOLOGY in self.technologies
        return Study.model_validate(base.model_dump(mode="json", exclude={"quick"}, exclude_unset=True) | changes)


@dataclass(frozen=True)
class Move:
    """A parameter of one technology at an end of its range."""

    variation: str
    number: str
    end: int
    technology: str
    value: float

    def study(self, base: Study) -> Study:
        """Return the base study with that technology only, and the number changed."""
        table = base.model_dump(mode="json") | {"technologies": [self.technology], "paper": False}
        numbers = base.process.get(self.technology, {}) | {self.number: self.value}
        return Study.model_validate(table | {"process": {self.technology: numbers}})

    def __str__(self) -> str:
        return f"{self.technology} {self.value:g}"


@dataclass(frozen=True)
class Case:
    """One setting and its result.

    curves : one for each technology
    rows : the paper's statements compared with it; without the paper's process, those on scaling only
    alone : the only technology that was changed, or empty
    """

    variation: str
    label: str
    curves: tuple[Curve, ...] = field(repr=False)
    rows: tuple[Finding, ...] = field(default=(), repr=False)
    alone: str = ""

    @property
    def reference(self) -> Curve:
        """The curve of the paper's process, or the first one."""
        return next((curve for curve in self.curves if curve.technology == REFERENCE_TECHNOLOGY), self.curves[0])

    @property
    def agrees(self) -> dict[str, bool]:
        """Statement -> verdict."""
        return {row.statement: row.agrees for row in self.rows}

    def differing(self, base: Case) -> list[str]:
        """Return the statements of the paper whose verdict differs from the base's."""
        return [statement for statement, agrees in self.agrees.items() if agrees != base.agrees.get(statement, agrees)]

    def as_dict(self) -> dict[str, Any]:
        names, curves = ("technology", "optimum", "optimum_fill_factor"), [curve.as_dict() for curve in self.curves]
        own = {"variation": self.variation, "label": self.label, "alone": self.alone, "agrees": self.agrees}
        return own | {"technologies": [{name: curve[name] for name in names} for curve in curves]}


@dataclass(frozen=True)
class SensitivityResult:
    """The base case and all others, in file order.

    notes : warnings while they were computed
    variant : of Mitsuba, as asked for; None means the fastest
    """

    sensitivity: Sensitivity
    base: StudyResult
    base_case: Case
    cases: tuple[Case, ...]
    notes: tuple[str, ...] = ()
    variant: str | None = None

    def turning(self, statement: str) -> list[Case]:
        """Return the cases whose verdict on a statement differs from the base's."""
        # A setting may change the statement itself, such as its iso level: such a case is not counted.
        return [case for case in self.cases if statement in case.differing(self.base_case)]

    def by_variation(self) -> dict[str, list[Case]]:
        """Return the cases of each variation but those of one technology, the widest range of the reference's optimum first."""
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            if not case.alone:
                groups.setdefault(case.variation, []).append(case)

        def width(cases: list[Case]) -> float:
            sizes = [case.reference.optimum.pitch_um for case in (*cases, self.base_case)]
            return max(sizes) - min(sizes)

        return dict(sorted(groups.items(), key=lambda item: -width(item[1])))

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in summary.json."""
        claims = [
            asdict(row)
            | {"turned_by": [{"variation": case.variation, "label": case.label} for case in self.turning(row.statement)]}
            for row in self.base_case.rows
        ]
        return {
            "sensitivity": self.sensitivity.model_dump(mode="json", exclude={"quick"}),
            "base": self.base.as_dict(),
            "claims": claims,
            "cases": [case.as_dict() for case in self.cases],
            "notes": list(self.notes),
        }


def cases_of(sensitivity: Sensitivity, base_study: Study | None = None) -> Iterator[tuple[str, str, Study]]:
    """Yield (variation, label, study) for every setting.

    base_study : with the display and chart that all cases share; None means that of the sensitivity analysis
    """
    base = (base_study or sensitivity.base_study()).model_dump(mode="json", exclude_unset=True)
    for variation in sensitivity.vary:
        for setting in variation.settings:
            yield variation.name, setting.label, Study.model_validate(merge(base, setting.set))


def moves_of(sensitivity: Sensitivity) -> list[Move]:
    """Return every number of `ranges` at both ends, for each technology whose file has a range for it.

    Raises PixsimError if no technology has a number.
    """
    processes = {name: load_technology(name) for name in sensitivity.technologies}
    moves = []
    for variation, number in sensitivity.ranges.items():
        known = dict.fromkeys(name for process in processes.values() for name in process.numbers)
        if number not in known:
            raise invalid(f"ranges.{variation}", f"'{number}'", ", ".join(known), did_you_mean(number, known))
        for end in (0, 1):
            for name, process in processes.items():
                # A number of grade A has no range; a number already at this end of its range is not a move.
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
    progress: Stage | None = None,
) -> SensitivityResult:
    """Run the base and every case, with their rows in `out`/cases/, so that an interrupted run can be resumed.

    Raises PixsimError or ValidationError for invalid input, before anything is rendered.
    """
    if quick:
        table = merge(sensitivity.model_dump(mode="json", exclude={"quick"}), sensitivity.quick)
        sensitivity = Sensitivity.model_validate(table)
    base, moves = prepare(sensitivity.base_study(), variant).study, moves_of(sensitivity)
    moved = [move.study(base) for move in moves]
    cases = [(name, label, prepare(study, variant).study) for name, label, study in cases_of(sensitivity, base)]
    for study in moved:
        check_technologies(study)
        check_pitches(study)
    studies = [base, *(study for _, _, study in cases)]
    names = ["base", *(file_name(n, name, label) for n, (name, label, _) in enumerate(cases))]
    names += [file_name(len(cases) + n, move.variation, str(move)) for n, move in enumerate(moves)]
    for name in names:
        ResultsFile(Path(out) / "cases" / f"{name}.csv").check_replaceable()
    stage = progress or (lambda _: lambda *_: None)
    renders: dict[str, Light] = {}
    of_light = {"scene", "camera", "seed", "tolerance_e", "tolerance_delta_e", "render_noise", "resolution", "max_seconds", "pitch"}

    def render(study: Study) -> Light:
        light = study.model_dump(mode="json", include=of_light)
        shown = study.display.raster, study.display.dots
        key = content_hash([light, study.exposure.model_dump(), study.pixel.model_dump(), study.technologies, shown])
        if key not in renders:
            renders[key] = render_for(study, variant, stage("render"))
        return renders[key]

    def run(study: Study, name: str, light: Light) -> StudyResult:
        rows = folder / "cases" / f"{name}.csv"
        (result,), _ = evaluate_cases([StudyCase(study)], [light], View(), rows, workers, lambda: stage(name))
        return StudyResult(study, result.curves, *light)  # without prepared scenes, since many results stay in memory

    with collected_notes() as notes, workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        (folder / "cases").mkdir(exist_ok=True)
        # A process does not change the light: with the base's render, an unchanged technology has the base's rows.
        results = [run(study, name, render(study)) for name, study in zip(names, studies, strict=False)]
        results += [run(study, name, render(base)) for name, study in zip(names[len(studies) :], moved, strict=True)]
        rows: list[tuple[Finding, ...]] = [()] * len(results)
        if base.paper:
            rows = claims(results, workers, stage("claims"))
    return replace(assemble(sensitivity, results, rows, moves), notes=tuple(sorted(notes)), variant=variant)


def claims(results: list[StudyResult], workers: Workers, progress: Progress) -> list[tuple[Finding, ...]]:
    """Return the statements on the paper's process for each result; none if the result does not have that process."""
    findings: list[tuple[Finding, ...]] = [()] * len(results)
    # Each call has its own `make`, since the calls share no data.
    calls = [
        (number, partial(StudyResult, result.study, result.curves, result.irradiance, result.camera))
        for number, result in enumerate(results)
        if any(curve.technology == REFERENCE_TECHNOLOGY for curve in result.curves)
    ]
    for done, (number, rows) in enumerate(results_of(claims_task, calls, workers), 1):
        findings[number] = rows
        progress(done / len(calls))
    return findings


def claims_task(number: int, result: StudyResult) -> tuple[int, tuple[Finding, ...]]:
    """Return the number and the rows of one result."""
    return number, tuple(reference_rows(Evidence(result, {curve.technology: curve for curve in result.curves})))


def assemble(
    sensitivity: Sensitivity, results: list[StudyResult], rows: list[tuple[Finding, ...]], moves: list[Move]
) -> SensitivityResult:
    """Return the cases from results and rows, in the order base, settings of `vary`, `moves`.

    Technologies are independent, so a case with several changed technologies is assembled from results of one each.
    """
    base, base_rows = results[0], rows[0]

    def trends(curves: Sequence[Curve]) -> list[Finding]:
        return scaling_rows(curves) if base.study.paper else []

    named = [(variation.name, setting.label) for variation in sensitivity.vary for setting in variation.settings]
    cases = [
        Case(*names, result.curves, (*findings, *trends(result.curves)))
        for names, result, findings in zip(named, results[1:], rows[1:], strict=False)
    ]
    ends: dict[tuple[str, int], list[tuple[Move, Curve, tuple[Finding, ...]]]] = {}
    for move, result, findings in zip(moves, results[1 + len(named) :], rows[1 + len(named) :], strict=True):
        ends.setdefault((move.variation, move.end), []).append((move, result.curves[0], findings))
    for (variation, end), group in ends.items():
        together = [(f"all {('low', 'high')[end]}", "", group)] if len(group) > 1 else []
        alone = [(str(member[0]), member[0].technology if together else "", [member]) for member in group]
        for label, technology, part in (*together, *alone):
            moved = {move.technology: curve for move, curve, _ in part}
            curves = tuple(moved.get(curve.technology, curve) for curve in base.curves)
            findings = next((rows for move, _, rows in part if move.technology == REFERENCE_TECHNOLOGY), base_rows)
            cases.append(Case(variation, label, curves, (*findings, *trends(curves)), technology))
    base_case = Case("base", sensitivity.base, base.curves, (*base_rows, *trends(base.curves)))
    return SensitivityResult(sensitivity, base, base_case, tuple(cases))


def turned_words(settings: Sequence[tuple[str, str]]) -> str:
    """Return settings (variation, label) as text, grouped by variation."""
    groups: dict[str, list[str]] = {}
    for variation, label in settings:
        groups.setdefault(variation, []).append(label)
    return "; ".join(f"{variation} ({', '.join(labels)})" for variation, labels in groups.items()) or "none"


def file_name(number: int, variation: str, label: str) -> str:
    """Return a file name of allowed characters, numbered so that it is unique."""
    return re.sub(r"[^\w.\-]+", "_", f"{number:02d}-{variation}-{label}")


def tornado(result: SensitivityResult) -> Plate:
    """Plot the range of the optimum and of its mean ΔE for each assumption, widest first."""
    groups = result.by_variation()
    reference = result.base_case.reference
    base = reference.optimum
    figure = new_figure(9.5, 0.42 * len(groups) + 1.4)
    left, right = figure.subplots(1, 2, sharey=True)
    for row, cases in enumerate(groups.values()):
        optima = [(case.label, case.reference.optimum) for case in cases]
        draw_bar(left, row, base.pitch_um, [(label, best.pitch_um, best.inside) for label, best in optima])
        draw_bar(right, row, base.mean_delta_e, [(label, best.mean_delta_e, True) for label, best in optima])
    for axes, at, label in ((left, base.pitch_um, "optimal pixel size (µm)"), (right, base.mean_delta_e, "best mean ΔE")):
        axes.axvline(at, color="0.2", lw=1)
        axes.set_xlabel(f"{label}, {literal(reference.label)}")
        axes.grid(axis="x", alpha=0.25)
        axes.use_sticky_edges = False
        axes.margins(x=0.15, y=0.03)
    left.set_yticks(range(len(groups)), list(groups))
    left.invert_yaxis()
    caption = (
        f"Each assumption varied alone over its plausible range; vertical lines: the base ({base.pitch_um:.2f} µm, "
        f"ΔE {base.mean_delta_e:.3f}). A wider bar means a stronger influence. Hollow point: minimum at an end of the pitches."
    )
    return Plate("tornado", caption, figure, case_table(result))


def draw_bar(axes: Any, row: int, base: float, points: list[tuple[str, float, bool]]) -> None:
    """Draw a bar from the lowest to the highest value, including the base, with a labelled point for each setting."""
    values = [base, *(value for _, value, _ in points)]
    axes.barh(row, max(values) - min(values), left=min(values), height=0.55, color=COLOURS[0], alpha=0.25)
    for index, (label, value, solid) in enumerate(sorted(points, key=lambda point: point[1])):
        axes.plot(value, row, "o", ms=4, color=COLOURS[0], mfc=COLOURS[0] if solid else "white")
        axes.annotate(label, (value, row), textcoords="offset points", xytext=(0, 5 if index % 2 else -10), fontsize=7, ha="center")


def case_table(result: SensitivityResult) -> dict[str, Column]:
    """Return a table with a row for each case and technology."""
    rows = [(case, curve) for case in (result.base_case, *result.cases) for curve in case.curves]
    return {
        "variation": [case.variation for case, _ in rows],
        "setting": [case.label for case, _ in rows],
        "technology": [curve.technology for _, curve in rows],
        "optimum_um": [curve.optimum.pitch_um for _, curve in rows],
        **interval_columns([curve for _, curve in rows]),
        "optimum_fill_factor": [curve.optimum_fill_factor for _, curve in rows],
        "mean_delta_e": [curve.optimum.mean_delta_e for _, curve in rows],
        "inside": [str(curve.optimum.inside) for _, curve in rows],
    }


FILES = ("report.html", "summary.json", SETTINGS_FILE, "figures/tornado.svg", "figures/tornado.csv")


def write_sensitivity_report(result: SensitivityResult, folder: Path, seconds: dict[str, float]) -> Path:
    """Write summary.json, figures/tornado.svg and .csv, provenance.json and report.html; return the report's path.

    Raises PixsimError if the folder cannot be written, or holds a file of such a name that pixsim did not write.
    """
    page = {
        "interval": interval_words,
        "sensitivity": result.sensitivity,
        "sensitivity_notes": result.notes,
        "claims": [
            (row, len(turning), turned_words([(case.variation, case.label) for case in turning]))
            for row, turning in ((row, result.turning(row.statement)) for row in result.base_case.rows)
        ],
        "cases": [(case, case.differing(result.base_case)) for case in (result.base_case, *result.cases)],
        "header": result.base.irradiance.header,
        "provenance": {"versions": versions(), "seconds": seconds},
    }
    name = result.sensitivity.base
    base = name if name in packaged("data/studies") else whole_path(name)
    with output_folder(folder), publishing(folder, "study", {"seconds": seconds}) as unfinished:
        text = settings_text(result.sensitivity, repeating_command(result.variant), base=base)
        (unfinished / SETTINGS_FILE).write_text(text, encoding="utf-8")
        (page["drawn"],) = write_figures(unfinished, [tornado(result).drawn()])
        write_json(unfinished / "summary.json", result.as_dict())
        write_page(unfinished / "report.html", "sensitivity.html.j2", page)
    return folder / "report.html"
