"""Settings without effect in a study: the rule of a frame, at both ends of the pixel sizes, and on the list of sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pixsim.base.errors import PixsimError
from pixsim.base.records import Record
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.studies.design import Case
from pixsim.studies.settings import Study
from pixsim.studies.sizes import imaging_of, metrics_of, study_pitches_um
from pixsim.viewer.without_effect import TABLES, CommandFacts, Default, GivenSettings, record_with


def cases_to_try(cases: Sequence[Case[Study]]) -> list[int]:
    """Return the numbers of cases in which settings are tried: those that differ from the first in one axis, and the last.

    A product of axes may have thousands; each of its values is in one of these.
    """
    first = cases[0]
    chosen = [
        number
        for number, case in enumerate(cases)
        if sum(case.at[name] != value for name, value in first.at.items()) + (case.condition != first.condition) <= 1
    ]
    return list(dict.fromkeys([*chosen, len(cases) - 1]))


@dataclass(frozen=True)
class GivenSizes(GivenSettings):
    """Settings of one technology of a study, at its largest pixel size.

    study : as the user set it
    smallest : the same settings at the smallest size
    """

    study: Study | None = None
    technology: str = ""
    smallest: GivenSettings | None = None

    def without_effect(self) -> list[str]:
        """Return the names of the settings that do nothing at both ends of the sizes, nor to their list."""
        names = super().without_effect()
        if self.smallest is not None:
            of_frames = tuple(name for name in names if not name.startswith("pitch."))
            acting = {*of_frames} - {*replace(self.smallest, names=of_frames).without_effect()}
            names = [name for name in names if name not in acting]
        return [name for name in names if not self._moves_sizes(name)]

    def _acts(self, name: str) -> bool:
        return not name.startswith("pitch.") and super()._acts(name)

    def _moves_sizes(self, name: str) -> bool:
        assert self.study is not None
        try:
            sizes_um = study_pitches_um(self.study, self.technology)
            other = record_with(self.study, name.split("."), Default)
            return study_pitches_um(other, self.technology).tolist() != sizes_um.tolist()
        except PixsimError:  # without it the settings are refused
            return True


# A study of a data sheet takes it from the sheet's pitch; the range and the display that follow from it are stated in `complete`.
OF_THE_SHEET = "pitch.own_um"


def settings_of_technology(given: Case[Study], complete: Case[Study], technology: str) -> GivenSizes:
    """Return the settings of one technology in one case.

    given : as the user set it
    complete : the same, with what the user left open
    """
    study = given.settings
    tables: dict[str, Record] = {table: getattr(study, table) for table in TABLES}
    tables |= {"pixel": study.options_of(technology), "pitch": study.pitch}
    facts = CommandFacts(
        settings=study,
        picture=complete.picture,
        judges_run=False,
        adds_sensors=bool(study.target_ci_um) or (study.refine and study.pitch.values_um is None),
        may_refine=not study.target_ci_um and study.pitch.values_um is None,
    )
    ends = []
    for pitch_um in study_pitches_um(complete.settings, technology)[[-1, 0]].tolist():
        imaging = imaging_of(complete.settings, complete.camera, technology, pitch_um)
        ends.append(GivenSettings.of(imaging.changed(metrics=metrics_of(study)), tables, facts))
    largest, smallest = ends
    names = tuple(name for name in largest.names if technology != NO_TECHNOLOGY or name != OF_THE_SHEET)
    return GivenSizes(largest.imaging, names, facts, study, technology, smallest)
