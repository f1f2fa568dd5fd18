"""Comparisons of the same sensors at each value of a study's axes, and at which values which one is better."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.show.document import Answer, Table
from pixsim.show.figures import LOOKS, literal, new_figure, own_style
from pixsim.show.render import cell_of
from pixsim.studies.averages import Averaged
from pixsim.studies.axis import Axis
from pixsim.studies.cases import BASE, Case, case_words, cases_of, combinations, values_at, with_range_ends
from pixsim.studies.comparison import FIGURE_BORDER_IN, FIGURE_WIDTH_IN, ROW_IN, Comparison
from pixsim.studies.lineup import ComparisonJob
from pixsim.studies.study_file import study_of
from pixsim.studies.study_settings import Study
from pixsim.studies.varied import MAX_CASE_NAME
from pixsim.studies.verdicts import match_words, whole_verdict
from pixsim.viewer.merging import merge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

StatedStudy = Study | str | os.PathLike[str] | None  # itself, the name of a packaged one, or a TOML file

BETWEEN = 0.15  # rows between the sensors of one case


def cases_of_comparison(study: StatedStudy) -> tuple[tuple[Axis, ...], list[Case[Study]]]:
    """Return the axes of a study, and a study without axes for each combination of their values; none without axes.

    A combination's settings are those of a condition, or of each of the study's conditions.

    Raises PixsimError for an invalid study.
    """
    if study is None:
        return (), []
    if not (plan := with_range_ends(study_of(study)[1])).axis:
        return (), []
    cases_of(plan)  # that its values are allowed
    own = plan.stated
    cases = []
    for chosen, alone in combinations(plan.axis):
        table: dict[str, Any] = {}
        for point in chosen.values():
            table = merge(table, point.table)
        at = values_at(plan.axis, chosen)
        conditions = [each.model_dump(mode="json") | {"set": merge(table, each.set)} for each in plan.condition]
        if table and not conditions:
            name = case_words(at, "", alone).replace(",", ";")[:MAX_CASE_NAME].strip()
            conditions = [{"name": name, "set": table}]
        cases.append(Case(Study.model_validate(own | {"condition": conditions}), at, "", alone))
    return plan.axis, cases


def prepare_cases(
    study: StatedStudy, prepare: Callable[..., ComparisonJob]
) -> tuple[tuple[Axis, ...], list[Case[Study]], list[ComparisonJob]]:
    """Return `cases_of_comparison`, and a comparison that is prepared for each case, or the only one.

    prepare : prepares one, of a `study`, which is its argument

    Raises PixsimError for invalid input.
    """
    axes, cases = cases_of_comparison(study)
    studies: list[StatedStudy] = [case.settings for case in cases]
    return axes, cases, [prepare(study=own) for own in studies or [study]]


def folders_of(out: str | os.PathLike[str] | None, cases: Sequence[Case[Study]]) -> list[Path | None]:
    """Return the folder of each comparison: for each case one in `out`, or `out` of the only one; None for none."""
    if out is None:
        return [None] * max(1, len(cases))
    return [Path(out) / case.folder for case in cases] or [Path(out)]


@dataclass(frozen=True)
class ComparedCases:
    """Comparisons of the same sensors at each value of the axes of a study.

    axes : of the study
    results : each case with its comparison; the cases have other light or other settings
    """

    axes: tuple[Axis, ...]
    results: tuple[tuple[Case[Study], Comparison], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return self.results[0][1].names

    def headline(self, other: str) -> str:
        """Return at which values the first sensor is better, and at which another one, and under which match.

        other : name of the other one
        """
        return f"{self._verdict(other)} {match_words(self.results[0][1].prepared.match)}"

    def _verdict(self, other: str) -> str:
        """Return at which values the first sensor is better, and at which another one."""
        names = {1: self.names[0], -1: other, 0: "neither"}
        signs = [(case, sign_of(result, other)) for case, result in self.results]
        found = {sign for _, sign in signs}
        if found == {0}:
            return f"neither {self.names[0]} nor {other} is surely better in any of {len(signs)} cases"
        if len(found) == 1:
            better, worse = (self.names[0], other) if found == {1} else (other, self.names[0])
            return f"{better} is better than {worse} in all {len(signs)} cases"
        parts: list[str] = []
        for sign, name in names.items():
            if where := [case.words or BASE for case, own in signs if own == sign]:
                parts.append(f"{name}{' is better' if not parts and sign else ''} at {'; '.join(where)}")
        return ", ".join(parts)

    @property
    def answers(self) -> list[tuple[Case[Study], list[str]]]:
        """Each case with its answer for each later sensor; the match of all cases is that of the headline."""
        return [(case, [whole_verdict(own, other, None) for other in self.names[1:]]) for case, own in self.results]

    def as_dict(self) -> dict[str, Any]:
        """Return compare.json."""
        return {
            "names": list(self.names),
            "verdicts": {other: self.headline(other) for other in self.names[1:]},
            "cases": [
                {"at": case.at, "folder": case.folder}
                | {"verdicts": {other: whole_verdict(result, other, result.prepared.match) for other in self.names[1:]}}
                | result.answers()
                for case, result in self.results
            ],
        }

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure of the differences from the first sensor: a row for each case, with their 95 % intervals."""
        figure = new_figure(FIGURE_WIDTH_IN, FIGURE_BORDER_IN + ROW_IN * len(self.results))
        axes = figure.add_subplot()
        for number, (other, look) in enumerate(zip(self.names[1:], LOOKS, strict=False)):
            rows = np.arange(len(self.results)) + (number - (len(self.names) - 2) / 2) * BETWEEN
            means = np.array([own.difference[other] for _, own in self.results])
            low, high = np.array([own.interval_delta_e[other] for _, own in self.results]).T
            error = [means - low, high - means]
            axes.errorbar(means, rows, xerr=error, fmt=look.marker, color=look.colour, capsize=4, label=literal(f"{other}"))
        axes.axvline(0.0, color="0.5", lw=0.8)
        axes.set_yticks(range(len(self.results)), [literal(case.words or BASE) for case, _ in self.results])
        axes.set_ylim(len(self.results) - 0.5, -0.5)  # the first case is on top
        axes.set_xlabel(f"mean ΔE above that of {literal(self.names[0])}, with its 95 % interval")
        if len(self.names) > 2:
            axes.legend(frameon=False)
        return figure

    def _repr_html_(self) -> str:
        others = self.names[1:]
        head = ("case", *(f"{self.names[0]} and {other}" for other in others))
        rows = [(case.words or BASE, *answers) for case, answers in self.answers]
        return cell_of(map(Answer, map(self.headline, others)), self.plot(), Table("cases", head, rows))

    def __repr__(self) -> str:
        return f"<ComparedCases {'; '.join(map(self.headline, self.names[1:]))}>"


def sign_of(result: Averaged, other: str) -> int:
    """Return 1 if the first sensor is surely better, -1 if the other one is; 0 if neither is, or if that depends on the display."""
    stated, *on_others = result.display_differences(other)
    return 0 if any(difference.sign == -stated.sign for difference in on_others) else stated.sign
