"""Sensitivity analysis: a study with another over it, whose axes are moved alone, and what they do
to the paper's statements.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.paper_table import claims_table, counts, tornado_table
from helpers.browser import BROWSER, assert_fits, assert_prints
from helpers.commands import command
from helpers.tiny import COARSE, PITCHES_UM, rows, tiny, tiny_toml

import pixsim
from pixsim.base.schema import SCHEMA
from pixsim.report.axes import cases_data, verdict_words
from pixsim.sensor.technology import load_technology
from pixsim.studies.claims import Evidence, findings, scaling_rows, verdicts
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.design import Case, cases_of, study_pitches_um, with_range_ends
from pixsim.studies.files import load_study
from pixsim.studies.lights import Light
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import check_pitches, prepare
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
).replace('"spp" = 4, ', "")
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
def done(desk: Path) -> tuple[StudyResult, Path]:
    return pixsim.study("tiny.toml", desk / "one", config="sensitivity.toml", jobs=1), desk / "one"


def case(result: StudyResult, axis: str, value: float | str) -> StudyResult:
    (part,) = [
        part
        for part in result.parts
        if part.curves[0].alone == axis and part.curves[0].at[axis] == value
    ]
    return part


# --- a study over another
# ---------------------------------------------------------------------------------------------


def test_study_over_another_has_its_values_and_streams(desk: Path) -> None:
    base, own = load_study("tiny.toml"), load_study("tiny.toml", "sensitivity.toml")
    assert (own.name, own.stream_name, base.stream_name) == ("tiny-sensitivity", "tiny", "tiny")
    assert (own.repeats, base.repeats) == (2, 4)
    same = base.model_copy(
        update={
            name: getattr(own, name) for name in ("name", "streams", "repeats", "pitch", "axis")
        }
    )
    assert same == own


# --- numbers of the technologies over their ranges
# --------------------------------------------------------------------


def test_range_of_covers_both_ends_in_all_and_alone(desk: Path) -> None:
    """The measured 0.37 of 0.35 µm has no range, so that the peak moves in one technology only; its
    upper end is 0.37.
    """
    study = with_range_ends(load_study("tiny.toml", "sensitivity.toml"))
    labels = {
        axis.name: [point.label for point in axis.points]
        for axis in study.axis
        if axis.name in ("dark current", "peak")
    }
    assert labels == {
        "dark current": ["all low", "0.35um 0.333", "0.25um 1", "all high", "0.35um 3", "0.25um 9"],
        "peak": ["0.25um 0.2", "0.25um 0.37"],
    }
    (high,) = [case for case in cases_of(study) if case.words == "dark current: all high"]
    assert high.settings.process == {
        "0.35um": {"dark_current_na_per_cm2": 3.0},
        "0.25um": {"dark_current_na_per_cm2": 9.0},
    }
    assert {case.one_at_a_time for case in cases_of(study)} == {
        "",
        "PRNU",
        "light",
        "dark current",
        "peak",
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"range_of": "dark_current"},
            (
                "axis dark current: range_of: got 'dark_current'; allowed: .*Did you mean"
                " 'dark_current_na"
            ),
        ),
        ({"values": [1]}, "range_of and values both state the values"),
        ({"set": "pixel.dsnu"}, "range_of and set both state the values"),
        ({"alone": False}, "range_of without alone = true"),
    ],
)
def test_range_of_invalid_raises_before_render(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prepare(tiny(axis=[{"name": "dark current", "range_of": "dsnu", "alone": True} | change]))


def test_range_of_leaves_out_what_has_no_range_and_keeps_what_the_study_has_set_to_an_end() -> None:
    """The peak of 0.35 µm is measured."""

    def axes(number: str, **process: object) -> tuple[Axis, ...]:
        return with_range_ends(
            tiny(
                process={"0.35um": process}, axis=[{"name": "d", "range_of": number, "alone": True}]
            )
        ).axis

    with pytest.warns(
        UserWarning, match="axis d is not used: no technology of the study has a range"
    ):
        assert axes("peak_quantum_efficiency") == ()
    low, high = load_technology("0.35um").ranges["dsnu"]
    (axis,) = axes("dsnu", dsnu=low)
    assert [point.label for point in axis.points] == [f"0.35um {high:g}"]


# --- a result
# ---------------------------------------------------------------------------------------------------------


def test_base_case_equals_the_base_study(done: tuple[StudyResult, Path], desk: Path) -> None:
    """Same rows as the base run alone with these pitches and sensors: the random streams are its
    own.
    """
    base = load_study("tiny.toml").model_dump(mode="json", exclude_unset=True)
    alone = pixsim.study(
        pixsim.Study.model_validate(base | {"repeats": 2, "pitch": {"values_um": PITCHES_UM}}),
        desk / "a",
        jobs=1,
    )
    for mine, theirs in zip(done[0].parts[0].curves, alone.curves, strict=True):
        np.testing.assert_array_equal(mine.delta_e, theirs.delta_e)
    own = {row["key"] for row in rows(desk / "a")}
    assert len(own) == 24
    assert own <= {row["key"] for row in rows(done[1])}


def test_setting_of_the_base_changes_nothing(done: tuple[StudyResult, Path]) -> None:
    result, _ = done
    base = result.parts[0].curves[0].delta_e
    np.testing.assert_array_equal(case(result, "PRNU", 0.02).curves[0].delta_e, base)
    # The smallest pixel lacks light: half of it makes more noise, 2 (4/2.8)² less.
    assert (case(result, "light", "half").curves[0].delta_e[0] > 1.05 * base[0]).all()
    assert (case(result, "light", "f/2.8").curves[0].delta_e[0] < 0.95 * base[0]).all()


def test_unchanged_technology_is_computed_once(done: tuple[StudyResult, Path]) -> None:
    """Base, half and f/2.8 with two technologies, and each end in each technology: 12 pixels of a
    technology each.
    """
    result, folder = done
    assert result.counts is not None
    assert result.counts.cases == 12
    assert result.counts.evaluations_made == 12 * (2 + 2 + 2 + 2 + 2 + 2)
    alone = case(result, "dark current", "0.25um 9")
    np.testing.assert_array_equal(alone.curves[0].delta_e, result.parts[0].curves[0].delta_e)
    assert (alone.curves[1].delta_e != result.parts[0].curves[1].delta_e).any()
    again = pixsim.study("tiny.toml", folder, config="sensitivity.toml", jobs=1)
    assert again.counts is not None
    assert again.counts.evaluations_made == 0
    assert again.as_dict() | {"counts": None} == result.as_dict() | {"counts": None}


@pytest.mark.parametrize("value", ["all high", "0.35um 0.333"])
def test_statements_of_a_case_are_those_of_the_study_alone(
    value: str, done: tuple[StudyResult, Path], desk: Path
) -> None:
    """The rows of the paper's process are shared between cases that do not change it."""
    result, _ = done
    part = case(result, "dark current", value)
    whole = pixsim.study(
        part.study.model_copy(update={"streams": "tiny"}), desk / f"whole {value}", jobs=1
    )
    own = result.findings[result.parts.index(part)]
    assert list(own) == findings(Evidence(whole, {item.technology: item for item in whole.curves}))
    assert len(own) == 17, "every statement of the paper"
    assert (
        result.findings[result.parts.index(case(result, "dark current", "0.25um 9"))][:-3]
        == result.findings[0][:-3]
    )


@pytest.mark.slow
def test_sensitivity_command_two_workers_same_result(
    done: tuple[StudyResult, Path], desk: Path
) -> None:
    code, message, _ = command("study tiny.toml --config sensitivity.toml --out command --jobs 2")
    assert code == 0
    out, lines = desk / "command", message.splitlines()
    assert lines[0].startswith("0.35um: ")
    assert any(line.strip().startswith("0.35um, PRNU") for line in lines), "\n".join(lines)
    assert rows(out) == rows(done[1]), "the rows depend on the number of workers"
    expected = json.loads(json.dumps({"schema": SCHEMA} | cases_data(done[0], [])))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary.pop("counts")["cases"] == len(done[0].parts)
    assert summary == expected
    page = (out / "report.html").read_text(encoding="utf-8")
    for verdict in verdicts(done[0]):
        assert f"{len(verdict.turned_by)} of 11" in page
    if BROWSER:
        here = desk / "browser"
        here.mkdir()
        assert_fits(out / "report.html", here)
        assert_prints(out / "report.html", here, range(1, 9), ["f/2.8"], ["Optima"])


# --- verdicts
# ---------------------------------------------------------------------------------------------------------


def curve(feature_um: float, optimum_um: float, best: float) -> Curve:
    pitch_um = np.geomspace(0.8, 2.0, 14) * optimum_um
    delta_e = np.repeat((best + 0.5 * np.log(pitch_um / optimum_um) ** 2)[:, None], 2, axis=1)
    fill_factor = np.linspace(0.1, 0.7, 14)
    statistics = {"mean_delta_e": delta_e, "integration_s": np.full(delta_e.shape, 0.03)}
    return Curve(
        f"{feature_um}um",
        feature_um,
        pitch_um,
        fill_factor,
        statistics,
        fit_curve(pitch_um, delta_e),
    )


FEATURE_UM = (0.35, 0.25, 0.18)
SHRINKS, SLOWER = "The optimum shrinks with technology", "… but slower than the technology"
WORSE = "The best mean ΔE gets worse as technology shrinks"
PAPER = [6.5, 5.2, 4.1], [0.5, 0.55, 0.6]  # 18.6, 20.8 and 22.8 features


def synthetic() -> StudyResult:
    """Optima of the first technology 6.5 (base); narrow 6.4 and 12; wide 6 and 8; one-sided 7."""
    moved = [
        ("", "base", 6.5),
        ("narrow", "a", 6.4),
        ("narrow", "e", 12.0),
        ("wide", "b", 6.0),
        ("wide", "d", 8.0),
    ]
    moved += [("one-sided", "c", 7.0)]
    image = pixsim.SpectralImage([550.0], 10.0, 5.3, data=np.ones((2, 2, 1)))
    light = Light(image, pixsim.Camera())
    study = pixsim.Study(name="synthetic", display=pixsim.Display(white_cd_per_m2=1000.0))
    names = list(dict.fromkeys(axis for axis, _, _ in moved if axis))
    parts = []
    for axis, value, size_um in moved:
        at: dict[str, Any] = dict.fromkeys(names, "base") | ({axis: value} if axis else {})
        own = map(curve, FEATURE_UM, [size_um, *PAPER[0][1:]], PAPER[1])
        parts.append(
            StudyResult(
                study, tuple(replace(each, case=CaseLabels(at, alone=axis)) for each in own), light
            )
        )
    curves = tuple(part.curves[place] for place in range(3) for part in parts)
    rows = tuple(tuple(scaling_rows(part.curves)) for part in parts)
    return CasesResult(study, curves, light, parts=tuple(parts), findings=rows)


def test_verdicts_list_the_cases_that_turn_them() -> None:
    """At 8 µm, 22.9 features of 0.35 µm, the optimum no longer shrinks slower: 20.8 and 22.8
    follow. At 12 µm neither.
    """
    found = {each.finding.statement: each for each in verdicts(synthetic())}
    words = {name: verdict_words(verdict) for name, verdict in found.items()}
    assert words == {SHRINKS: "", SLOWER: "narrow: e; wide: d", WORSE: ""}
    assert found[SLOWER].finding.agrees
    assert found[SLOWER].as_dict()["turned_by"][1]["alone"] == "wide"


def test_paper_table_of_synthetic_result() -> None:
    """`tests/benchmarks/paper_table.py`: against the verdicts of the study, which may differ from
    the first case's.
    """
    result = synthetic()
    cases = [
        {
            "alone": part.curves[0].alone,
            "at": part.curves[0].at,
            "agrees": {row.statement: row.agrees for row in own},
        }
        for part, own in zip(result.parts, result.findings, strict=True)
    ]
    rows = [
        {"statement": SLOWER, "given": "g", "found": "f", "agrees": agrees}
        for agrees in (True, False)
    ]
    yes, no = claims_table(rows[:1], cases)[-1], claims_table(rows[1:], cases)[-1]
    assert yes == f"| {SLOWER} | g | f | yes | 2 of 5: narrow (e); wide (d) |"
    assert (
        no == f"| {SLOWER} | g | f | **does not agree** | 3 of 5: narrow (a); wide (b); one-sided"
        " (c) |"
    )
    head = ["| the paper says | given | pixsim finds | agrees |", "|---|---|---|---|"]
    assert claims_table(rows[:1], []) == [*head, f"| {SLOWER} | g | f | yes |"]
    curves = [
        {"technology": each.technology, "alone": each.alone, "optimum": each.optimum.as_dict()}
        for each in result.curves
    ]
    lines = ["".join(line.split("|")[1:3]) for line in tornado_table(curves)[2:]]
    assert lines == [" narrow  6.40 to 12.00 ", " wide  6.00 to 8.00 ", " one-sided  6.50 to 7.00 "]
    *_, every = counts(
        [{"statement": name, "agrees": True} for name in (SHRINKS, SLOWER, WORSE)], cases
    )
    assert every == "3 of 5 have every verdict of the table"


# --- the packaged analysis
# --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped() -> list[Case[pixsim.Study]]:
    """The base and its cases."""
    return list(cases_of(with_range_ends(load_study("chen2000-sensitivity"))))


def test_packaged_cases_are_valid_and_distinct(shipped: list[Case[pixsim.Study]]) -> None:
    """All 89 settings of the table in docs/paper.md, each for all four technologies; the base is
    chen2000, as its verdicts.
    """
    base, *moved = shipped
    assert len(moved) == 89
    for case in moved:
        check_pitches(case.settings)
        assert (case.settings.seed, case.settings.stream_name) == (2000, "chen2000"), (
            "its random streams are others"
        )
        assert case.settings.technologies == ("0.5um", "0.35um", "0.25um", "0.18um")
    assert len({case.folder for case in moved}) == len(moved), "labels read alike"
    assert len({case.settings.content_hash for case in shipped}) == len(shipped), (
        "two cases are the same"
    )
    own, chen2000 = (study.model_dump() for study in (base.settings, load_study("chen2000")))
    assert own | {"name": "chen2000", "streams": None, "title": chen2000["title"]} == chen2000
    assert load_study("chen2000-sensitivity", quick=True).technologies == ("0.35um",)


# Assumptions that the paper does not state, with their plausible range; None: any value other than
# the base's.
ASSUMED = {
    "camera.f_number": (2.8, 8.0), "pixel.response": None, "pixel.quantum_efficiency": None, "pixel.offset_fpn": (0.001, 0.01),
    "pixel.prnu": None, "pixel.bits": (8, 12), "display.samples_per_deg": (15.0, 45.0), "display.raster": None,
    "display.delta_e": ("1976", "2000"), "display.filters": None, "pixel.fill_factor_law": None, "pixel.capacitance": None,
    "scene.parameters.luminance_cd_per_m2": None,
}  # fmt: skip


def test_packaged_cases_cover_assumptions(shipped: list[Case[pixsim.Study]]) -> None:
    tables = [case.settings.model_dump(mode="json") for case in shipped]
    for name, span in ASSUMED.items():
        values = {functools.reduce(dict.__getitem__, name.split("."), table) for table in tables}
        assert len(values) > 1, name
        given = values - {None}  # None: the technology's own
        assert span is None or (min(given), max(given)) == span, name


def test_packaged_ranges_cover_every_process() -> None:
    moves = [
        (number, value, technology, point.label)
        for axis in with_range_ends(load_study("chen2000-sensitivity")).axis
        for point in axis.points
        for technology, numbers in point.table.get("process", {}).items()
        for number, value in numbers.items()
    ]
    assert {number for number, *_ in moves} == {
        *("dark_current_na_per_cm2", "dsnu", "column_fpn"),
        *("peak_quantum_efficiency", "node_capacitance_ff", "voltage_swing_v"),
    }
    assert len(moves) == 2 * (6 * 2 * 4 - 2), (
        "all together and alone, but the measured peak at 0.35 µm"
    )
    for number, value, technology, label in moves:
        assert value in load_technology(technology).ranges[number]
        assert label in ("all low", "all high", f"{technology} {value:g}")


def test_packaged_modern_study_has_pinned_photodiodes() -> None:
    study = load_study("modern")
    assert len(study.technologies) >= 2
    for item in (study, load_study("modern", quick=True)):
        check_pitches(item)
        assert not item.paper
    for name in study.technologies:
        technology = load_technology(name)
        assert (technology.junction, technology.reset_noise_factor) == (None, 0.0)
        assert technology.full_well_e_per_um2 > 0
        pitches_um = study_pitches_um(study, name)
        pixels = [
            pixsim.derive(pixsim.Pixel(technology=name, pitch_um=pitch)) for pitch in pitches_um
        ]
        # A given well grows with the photodiode; no kTC noise at any size.
        wells = [pixel.full_well_e / pixel.photodiode_area_um2 for pixel in pixels]
        assert wells == pytest.approx([technology.full_well_e_per_um2] * len(wells))
        assert {pixel.reset_noise_e for pixel in pixels} == {0.0}
