"""Sensitivity analysis: a study with another over it, whose axes are moved alone, and what they do
to the paper's statements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import COARSE, PITCHES_UM, keys, tiny, tiny_toml

import pixsim
from pixsim.report.axes import verdict_words
from pixsim.sensor.technology import load_technology
from pixsim.studies.claims import Evidence, findings, scaling_rows, verdicts
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.design import cases_of, with_range_ends
from pixsim.studies.files import load_study
from pixsim.studies.lights import Light
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import check_pitches
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis

# A chart whose cells are computed, on few dots; every pitch that the paper's statements need.
BASE_TOML = tiny_toml(
    repeats=4,
    seed=1,
    technologies=["0.35um", "0.25um"],
    paper=True,
    pixel={"prnu": 0.02},
    pitch={"values_um": [4.0, 5, 6, 7, 8]},
    camera={"die_mm": 0.7},
    display={"dots": 32},
    resolution=COARSE,
)
SENSITIVITY_TOML = """
name = "tiny-sensitivity"
repeats = 2
pitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0] }
[[axis]]
name = "PRNU"
set = "pixel.prnu"
values = [0.02]
alone = true
[[axis]]
name = "light"
values = [
    { label = "half", set.scene.parameters.luminance_cd_per_m2 = 50.0 },
    { label = "f/2.8", set.camera.f_number = 2.8 },
]
alone = true
[[axis]]
name = "dark current"
range_of = "dark_current_na_per_cm2"
alone = true
[[axis]]
name = "peak"
range_of = "peak_quantum_efficiency"
alone = true
"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A working folder with both files."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "tiny.toml").write_text(BASE_TOML, encoding="utf-8")
    (folder / "sensitivity.toml").write_text(SENSITIVITY_TOML, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture(scope="module")
def done(desk: Path) -> Any:
    return pixsim.study("tiny.toml", desk / "one", config="sensitivity.toml", jobs=1)


def case(result: Any, axis: str, value: float | str) -> StudyResult:
    (part,) = [
        part
        for part in result.parts
        if part.curves[0].alone == axis and part.curves[0].at[axis] == value
    ]
    return part


def test_range_of_covers_both_ends_in_all_and_alone(desk: Path) -> None:
    """The measured 0.37 of 0.35 µm has no range, so that the peak moves in one technology only; its
    upper end is 0.37. The random streams are those of the base.
    """
    study = with_range_ends(load_study("tiny.toml", "sensitivity.toml"))
    assert (study.name, study.stream_name, study.repeats) == ("tiny-sensitivity", "tiny", 2)
    labels = {axis.name: [point.label for point in axis.points] for axis in study.axis[2:]}
    assert labels == {
        "dark current": ["all low", "0.35um 0.333", "0.25um 1", "all high", "0.35um 3", "0.25um 9"],
        "peak": ["0.25um 0.2", "0.25um 0.37"],
    }
    (high,) = [each for each in cases_of(study) if each.words == "dark current: all high"]
    ends = {"0.35um": 3.0, "0.25um": 9.0}
    assert high.settings.process == {
        name: {"dark_current_na_per_cm2": end} for name, end in ends.items()
    }


def axes(number: str, **process: float) -> tuple[Axis, ...]:
    axis = {"name": "d", "range_of": number, "alone": True}
    return with_range_ends(tiny(process={"0.35um": process}, axis=[axis])).axis


def test_range_of_leaves_out_what_has_no_range_and_an_end_that_is_set() -> None:
    """The peak of 0.35 µm is measured."""
    with pytest.warns(UserWarning, match="no technology of the study has a range"):
        assert axes("peak_quantum_efficiency") == ()
    low, high = load_technology("0.35um").ranges["dsnu"]
    (axis,) = axes("dsnu", dsnu=low)
    assert [point.label for point in axis.points] == [f"0.35um {high:g}"]


def test_base_case_equals_the_base_study(done: Any, desk: Path) -> None:
    """Same rows as the base run alone with these pitches and sensors: the random streams are its
    own.
    """
    over = {"repeats": 2, "pitch": {"values_um": PITCHES_UM}}
    alone = pixsim.study("tiny.toml", desk / "a", jobs=1, **over)
    for curve, expected in zip(done.parts[0].curves, alone.curves, strict=True):
        np.testing.assert_array_equal(curve.delta_e, expected.delta_e)
    assert set(keys(desk / "a")) < set(keys(desk / "one"))


def test_setting_of_the_base_changes_nothing(done: Any) -> None:
    """The smallest pixel lacks light: half of it makes more noise, 2 (4/2.8)² less."""
    base = done.parts[0].curves[0].delta_e
    np.testing.assert_array_equal(case(done, "PRNU", 0.02).curves[0].delta_e, base)
    assert (case(done, "light", "half").curves[0].delta_e[0] / base[0]).min() > 1.05
    assert (case(done, "light", "f/2.8").curves[0].delta_e[0] / base[0]).max() < 0.95


def test_unchanged_technology_is_computed_once(done: Any, desk: Path) -> None:
    """Base, half and f/2.8 with two technologies, and each end in each technology: 12 pixels of a
    technology each.
    """
    assert (done.counts.cases, done.counts.evaluations_made) == (12, 12 * 6 * 2)
    alone = case(done, "dark current", "0.25um 9").curves
    np.testing.assert_array_equal(alone[0].delta_e, done.parts[0].curves[0].delta_e)
    assert (alone[1].delta_e != done.parts[0].curves[1].delta_e).any()
    again: Any = pixsim.study("tiny.toml", desk / "one", config="sensitivity.toml", jobs=1)
    assert again.counts.evaluations_made == 0
    assert again.as_dict() | {"counts": None} == done.as_dict() | {"counts": None}


def test_statements_of_a_case_are_those_of_the_study_alone(done: Any, desk: Path) -> None:
    """The rows of the paper's process are shared between cases that do not change it."""
    part = case(done, "dark current", "all high")
    study = part.study.model_copy(update={"streams": "tiny"})
    whole = pixsim.study(study, desk / "whole", jobs=1)
    statements = done.findings[done.parts.index(part)]
    curves = {curve.technology: curve for curve in whole.curves}
    assert list(statements) == findings(Evidence(whole, curves))
    assert len(statements) == 17, "every statement of the paper"
    unchanged = done.parts.index(case(done, "dark current", "0.25um 9"))
    assert done.findings[unchanged][:-3] == done.findings[0][:-3]


# --- verdicts


def curve(feature_um: float, optimum_um: float, best: float) -> Curve:
    pitch_um = np.geomspace(0.8, 2.0, 14) * optimum_um
    delta_e = np.repeat((best + 0.5 * np.log(pitch_um / optimum_um) ** 2)[:, None], 2, axis=1)
    statistics = {"mean_delta_e": delta_e, "integration_s": np.full(delta_e.shape, 0.03)}
    fill_factor = np.linspace(0.1, 0.7, 14)
    fit = fit_curve(pitch_um, delta_e)
    return Curve(f"{feature_um}um", feature_um, pitch_um, fill_factor, statistics, fit)


SLOWER = "… but slower than the technology"


def synthetic() -> StudyResult:
    """Optima of the first technology 6.5 (base); narrow 6.4 and 12; wide 6 and 8."""
    moved = [("", "base", 6.5), ("narrow", "a", 6.4), ("narrow", "e", 12.0)]
    moved += [("wide", "b", 6.0), ("wide", "d", 8.0)]
    image = pixsim.SpectralImage([550.0], 10.0, 5.3, data=np.ones((2, 2, 1)))
    light = Light(image, pixsim.Camera())
    study = pixsim.Study(name="synthetic", display=pixsim.Display(white_cd_per_m2=1000.0))
    parts = []
    for axis, value, size_um in moved:
        values: dict[str, Any] = {"narrow": "base", "wide": "base"} | (
            {axis: value} if axis else {}
        )
        # 18.6, 20.8 and 22.8 features
        curves = map(curve, (0.35, 0.25, 0.18), (size_um, 5.2, 4.1), (0.5, 0.55, 0.6))
        labelled = (replace(each, case=CaseLabels(values, alone=axis)) for each in curves)
        parts.append(StudyResult(study, tuple(labelled), light))
    by_technology = tuple(part.curves[place] for place in range(3) for part in parts)
    rows = tuple(tuple(scaling_rows(part.curves)) for part in parts)
    return CasesResult(study, by_technology, light, parts=tuple(parts), findings=rows)


def test_verdicts_list_the_cases_that_turn_them() -> None:
    """At 8 µm, 22.9 features of 0.35 µm, the optimum no longer shrinks slower: 20.8 and 22.8
    follow. At 12 µm neither.
    """
    by_statement = {verdict.finding.statement: verdict for verdict in verdicts(synthetic())}
    words = [verdict_words(verdict) for verdict in by_statement.values()]
    assert sorted(words) == ["", "", "narrow: e; wide: d"]
    assert verdict_words(by_statement[SLOWER]) == "narrow: e; wide: d"
    assert by_statement[SLOWER].finding.agrees


# --- the packaged analysis


def test_packaged_cases_are_valid_and_distinct() -> None:
    """All 89 settings of the table in docs/paper.md, each for all four technologies; the base is
    chen2000, as its verdicts.
    """
    cases = list(cases_of(with_range_ends(load_study("chen2000-sensitivity"))))
    assert len(cases) == len({each.settings.content_hash for each in cases}) == 90
    assert len({each.folder for each in cases}) == 90, "labels read alike"
    for each in cases:
        check_pitches(each.settings)
        assert (each.settings.seed, each.settings.stream_name) == (2000, "chen2000")
        assert each.settings.technologies == ("0.5um", "0.35um", "0.25um", "0.18um")
    chen2000 = load_study("chen2000")
    names = {"name": "chen2000", "streams": None, "title": chen2000.title}
    assert cases[0].settings.model_dump() | names == chen2000.model_dump()
