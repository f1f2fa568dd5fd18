"""Sensitivity analysis: one assumption changes at a time, with all else, random streams included, unchanged."""

from __future__ import annotations

import csv
import io
import json
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.paper_table import claims_table, counts, tornado_table
from helpers.browser import BROWSER, assert_fits, assert_prints
from helpers.commands import command
from helpers.tiny import PITCHES_UM, rows, tiny_toml

import pixsim
from pixsim.base.config import packaged, read_toml
from pixsim.sensor.readout import Frame
from pixsim.sensor.technology import load_technology
from pixsim.show.pages import Plate
from pixsim.studies.claims import Evidence, findings, scaling_rows
from pixsim.studies.evaluations import study_pitches_um
from pixsim.studies.optimum import fit_curve
from pixsim.studies.result import Curve, StudyResult
from pixsim.studies.sensitivity import (
    Case,
    Sensitivity,
    SensitivityResult,
    cases_of,
    file_name,
    moves_of,
    run_sensitivity,
    tornado,
    turned_words,
    write_sensitivity_report,
)
from pixsim.studies.study import check_pitches, load_study

BASE_TOML = tiny_toml(
    repeats=4,
    seed=1,
    target_ci_um=0.5,
    technologies=["0.35um", "0.25um"],
    pixel={"prnu": 0.02},
    pitch={"values_um": [4.0, 5, 6, 7, 8]},
)
SENSITIVITY_TOML = """
name = "tiny-sensitivity"
base = "tiny.toml"
repeats = 2
pitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0] }
[[vary]]
name = "PRNU"
settings = [{ label = "2 %", set.pixel.prnu = 0.02 }]
[[vary]]
name = "light"
settings = [
    { label = "half", set.scene.parameters.luminance_cd_per_m2 = 50.0 },
    { label = "f/2.8", set.camera.f_number = 2.8 },
]
"""
SENSITIVITY = tomllib.loads(SENSITIVITY_TOML)


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
def done(desk: Path) -> tuple[SensitivityResult, Path]:
    return run_sensitivity(Sensitivity.model_validate(SENSITIVITY), desk / "one", jobs=1), desk / "one"


def cases(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "cases").iterdir()}


def test_run_sensitivity_base_equals_study(done: tuple[SensitivityResult, Path], desk: Path) -> None:
    """Same rows as the study run alone with these pitches and sensors, so its random streams too."""
    base = load_study("tiny.toml").model_dump(mode="json")
    own = {"technologies": ["0.35um"], "repeats": 2, "pitch": {"values_um": PITCHES_UM}}
    pixsim.study(pixsim.Study.model_validate(base | own), desk / "alone", jobs=1)
    assert rows(done[1] / "cases/base.csv") == rows(desk / "alone/results.csv")
    assert len(rows(desk / "alone/results.csv")) == 12


def test_run_sensitivity_setting_of_base_is_unchanged(done: tuple[SensitivityResult, Path]) -> None:
    result, folder = done
    same, half, fast = result.cases
    assert rows(next((folder / "cases").glob("*-PRNU-2_.csv"))) == rows(folder / "cases/base.csv")
    assert same.reference.optimum == result.base_case.reference.optimum
    base = result.base_case.reference.delta_e
    np.testing.assert_array_equal(same.reference.delta_e, base)
    # The smallest pixel lacks light: half of it makes more noise, 2 (4/2.8)² less.
    assert (half.reference.delta_e[0] > 1.05 * base[0]).all()
    assert (fast.reference.delta_e[0] < 0.95 * base[0]).all()


def test_run_sensitivity_resumes_lost_case(done: tuple[SensitivityResult, Path], evaluations: list[Frame]) -> None:
    result, folder = done
    before = cases(folder)
    again = run_sensitivity(result.sensitivity, folder, jobs=1)
    assert evaluations == []
    assert again.as_dict() == result.as_dict()
    next((folder / "cases").glob("*-light-half.csv")).unlink()
    run_sensitivity(result.sensitivity, folder, jobs=1)
    assert len(evaluations) == 12
    assert cases(folder) == before


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sensitivity_command_two_workers_same_result(done: tuple[SensitivityResult, Path]) -> None:
    result, folder = done
    code, message, _ = command("study sensitivity.toml --out command --jobs 2")
    assert code == 0
    base, light, prnu, report = message.splitlines()
    best = result.base_case.reference.optimum
    low, high = best.interval_um
    assert base.startswith(f"base: 0.35um: optimal pixel size {best.pitch_um:.2f} µm (95 %: {low:.2f} to {high:.2f} µm)")
    assert light.startswith("light: ")
    assert prnu.startswith(f"PRNU: {best.pitch_um:.2f} to {best.pitch_um:.2f} µm")
    out = Path("command")
    assert report == f"report: {out / 'report.html'}"
    if BROWSER:
        page, here = out.resolve() / "report.html", Path("browser").resolve()
        here.mkdir()
        assert_fits(page, here)
        assert_prints(page, here, range(1, 4), ["one assumption varied", "f/2.8"], ["All cases"])
    names = {"cases", "figures", "settings.toml", "summary.json", "provenance.json", "report.html"}
    assert {path.name for path in out.iterdir()} == names
    assert {path.name for path in (out / "figures").iterdir()} == {"tornado.svg", "tornado.csv"}
    assert cases(out) == cases(folder), "the rows depend on the number of workers"
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == json.loads(json.dumps(result.as_dict()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("set.pixel.prnuu = 0.01", "pixel.prnuu"),
        ("set.display.wite_cd_per_m2 = 1", "display.wite_cd_per_m2"),
        ("set.pixel.bits = 0", "pixel.bits"),
        ("set.scene.parameters.luminance = 3.0", "luminance"),
    ],
)
def test_run_sensitivity_invalid_setting_raises_before_render(
    change: str, message: str, desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pixsim.scene.renderer.render", lambda *_, **__: pytest.fail("rendered"))
    (desk / "wrong.toml").write_text(SENSITIVITY_TOML.replace("set.camera.f_number = 2.8", change), encoding="utf-8")
    code, _, complaint = command("study wrong.toml --out wrong")
    assert code == 2
    assert message in complaint
    assert not (desk / "wrong").exists()


# --- statements on scaling, and the chart -----------------------------------------------------------------------------


def curve(feature_um: float, optimum_um: float, best: float) -> Curve:
    pitch_um = np.geomspace(0.8, 2.0, 14) * optimum_um
    delta_e = np.repeat((best + 0.5 * np.log(pitch_um / optimum_um) ** 2)[:, None], 2, axis=1)
    fill_factor = np.linspace(0.1, 0.7, 14)
    statistics = {"mean_delta_e": delta_e, "integration_s": np.full(delta_e.shape, 0.03)}
    return Curve(f"{feature_um}um", feature_um, pitch_um, fill_factor, statistics, fit_curve(pitch_um, delta_e))


FEATURE_UM = (0.35, 0.25, 0.18)


def case(sizes_um: list[float], best: list[float], variation: str = "v", label: str = "l") -> Case:
    curves = tuple(map(curve, FEATURE_UM, sizes_um, best))
    return Case(variation, label, curves, tuple(scaling_rows(curves)))


SHRINKS, SLOWER = "The optimum shrinks with technology", "… but slower than the technology"
WORSE = "The best mean ΔE gets worse as technology shrinks"
PAPER = [6.5, 5.2, 4.1], [0.5, 0.55, 0.6]  # 18.6, 20.8 and 22.8 features


def synthetic() -> SensitivityResult:
    """Optima of the first technology 6.5 (base); narrow 6.4; wide 6 to 8; one-sided 7."""
    moved = [("narrow", "a", 6.4), ("wide", "b", 6.0), ("one-sided", "c", 7.0), ("wide", "d", 8.0)]
    settings = {"name": "x", "settings": [{"label": "y", "set": {}}]}
    sensitivity = Sensitivity.model_validate({"name": "synthetic", "vary": [settings]})
    light = pixsim.SpectralImage([550.0], 10.0, 5.3, data=np.ones((2, 2, 1)))
    base = StudyResult(
        pixsim.Study(name="base", display=pixsim.Display(white_cd_per_m2=1000.0)), case(*PAPER).curves, light, pixsim.Camera()
    )
    actual = tuple(case([size, *PAPER[0][1:]], PAPER[1], *names) for *names, size in moved)
    alone = replace(case([12.0, *PAPER[0][1:]], PAPER[1], "narrow", "0.35um"), alone="0.35um")
    base_case = Case("base", sensitivity.base, base.curves, tuple(scaling_rows(base.curves)))
    return SensitivityResult(sensitivity, base, base_case, (*actual, alone))


def test_turning_lists_changed_verdicts() -> None:
    """At 8 µm, 22.9 features of 0.35 µm, the optimum no longer shrinks slower: 20.8 and 22.8 follow. At 12 µm neither."""
    result = synthetic()
    turning = {name: [item.label for item in result.turning(name)] for name in (SHRINKS, SLOWER, WORSE)}
    assert turning == {SHRINKS: [], SLOWER: ["d", "0.35um"], WORSE: []}
    claims = {row["statement"]: row for row in result.as_dict()["claims"]}
    assert claims[SLOWER]["agrees"] is True
    turned_by = claims[SLOWER]["turned_by"]
    assert turned_by == [{"variation": "wide", "label": "d"}, {"variation": "narrow", "label": "0.35um"}]
    assert turned_words([(item["variation"], item["label"]) for item in turned_by]) == "wide (d); narrow (0.35um)"
    assert turned_words([("a", "1"), ("b", "2"), ("a", "3")]) == "a (1, 3); b (2)"


def test_paper_table_of_synthetic_result() -> None:
    """`tests/benchmarks/paper_table.py`: against the verdicts of the study, which may differ from the base's."""
    summary = json.loads(json.dumps(synthetic().as_dict()))
    rows = [{"statement": SLOWER, "given": "g", "found": "f", "agrees": agrees, "why": "w"} for agrees in (True, False)]
    yes, no = claims_table(rows[:1], summary["cases"])[-1], claims_table(rows[1:], summary["cases"])[-1]
    assert yes == f"| {SLOWER} | g | f | yes | 2 of 5: wide (d); narrow (0.35um) |"
    assert no == f"| {SLOWER} | g | f | **does not agree**: w | 3 of 5: narrow (a); wide (b); one-sided (c) |"
    head = ["| the paper says | given | pixsim finds | agrees |", "|---|---|---|---|"]
    assert claims_table(rows[:1], []) == [*head, f"| {SLOWER} | g | f | yes |"]
    lines = ["".join(line.split("|")[1:3]) for line in tornado_table(summary["base"], summary["cases"])[2:]]
    assert lines == [" wide  6.00 to 8.00 ", " one-sided  6.50 to 7.00 ", " narrow  6.40 to 6.50 "]
    *_, every = counts([{"statement": name, "agrees": True} for name in (SHRINKS, SLOWER, WORSE)], summary["cases"])
    assert every == "3 of 5 have every verdict of the table"


# --- numbers of the technologies over their ranges --------------------------------------------------------------------

RANGED = SENSITIVITY | {
    "name": "ranged",
    "base": "paper.toml",
    "technologies": ["0.35um", "0.25um"],
    "vary": SENSITIVITY["vary"][:1],
    "ranges": {"dark current": "dark_current_na_per_cm2", "peak": "peak_quantum_efficiency"},
}


@pytest.fixture(scope="module")
def ranged(desk: Path) -> tuple[SensitivityResult, Path]:
    """So noisy a render that its number of runs depends on no sensor: the base's is that of every study."""
    text = BASE_TOML.replace("target_ci_um = 0.5", "paper = true")
    (desk / "paper.toml").write_text(text, encoding="utf-8")
    return run_sensitivity(Sensitivity.model_validate(RANGED), desk / "ranged", jobs=1), desk / "ranged"


def test_moves_of_cover_both_ends(ranged: tuple[SensitivityResult, Path]) -> None:
    """The measured 0.37 of 0.35 µm has no range, so that the peak moves in one technology only; its upper end is 0.37."""
    assert [(item.variation, item.label, item.alone) for item in ranged[0].cases[1:]] == [
        ("dark current", "all low", ""),
        ("dark current", "0.35um 0.333", "0.35um"),
        ("dark current", "0.25um 1", "0.25um"),
        ("dark current", "all high", ""),
        ("dark current", "0.35um 3", "0.35um"),
        ("dark current", "0.25um 9", "0.25um"),
        ("peak", "0.25um 0.2", ""),
        ("peak", "0.25um 0.37", ""),
    ]


@pytest.mark.parametrize(
    ("label", "process"),
    [
        ("all high", {"0.35um": {"dark_current_na_per_cm2": 3.0}, "0.25um": {"dark_current_na_per_cm2": 9.0}}),
        ("0.35um 0.333", {"0.35um": {"dark_current_na_per_cm2": 0.333}}),
        ("0.25um 0.2", {"0.25um": {"peak_quantum_efficiency": 0.2}}),
    ],
)
def test_assemble_case_equals_whole_study(
    label: str, process: dict[str, dict[str, float]], ranged: tuple[SensitivityResult, Path], desk: Path
) -> None:
    """Put together from single technologies, it has the curves and the verdicts of the whole study, made apart."""
    result = ranged[0]
    (actual,) = [item for item in result.cases if item.label == label]
    study = result.sensitivity.base_study().model_copy(update={"process": process})
    whole = pixsim.study(study, desk / f"whole {label}", jobs=1)
    for mine, theirs in zip(actual.curves, whole.curves, strict=True):
        assert mine.technology == theirs.technology
        np.testing.assert_array_equal(mine.delta_e, theirs.delta_e)
        assert mine.optimum == theirs.optimum
    assert list(actual.rows) == findings(Evidence(whole, {item.technology: item for item in whole.curves}))
    assert len(actual.rows) == 17, "every statement of the paper"


def test_assemble_reuses_unchanged_technology(ranged: tuple[SensitivityResult, Path]) -> None:
    """Base and one setting with two technologies, then one technology for each number and end."""
    result, folder = ranged
    technologies = [{row["technology"] for row in rows(path)} for path in sorted((folder / "cases").glob("*.csv"))]
    assert sorted(map(len, technologies)) == [1] * 6 + [2] * 2
    (alone,) = [item for item in result.cases if item.label == "0.25um 9"]
    assert alone.curves[0] is result.base.curves[0]
    assert alone.rows[: len(alone.rows) - 3] == result.base_case.rows[: len(alone.rows) - 3]


def test_write_sensitivity_report_lists_turning_cases(ranged: tuple[SensitivityResult, Path], desk: Path) -> None:
    result = ranged[0]
    (desk / "page").mkdir()
    path = write_sensitivity_report(result, desk / "page", {})
    summary = json.loads((desk / "page/summary.json").read_text(encoding="utf-8"))
    page = path.read_text(encoding="utf-8")
    for row in summary["claims"]:
        turning = [item for item in result.cases if item.agrees[row["statement"]] != row["agrees"]]
        assert row["turned_by"] == [{"variation": item.variation, "label": item.label} for item in turning]
        assert f"{len(turning)} of {len(result.cases)}" in page
    assert "settings that change the verdict" in page


def test_moves_of_unknown_number_raises(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.renderer.render", lambda *_, **__: pytest.fail("rendered"))
    wrong = Sensitivity.model_validate(SENSITIVITY | {"ranges": {"dark": "dark_current"}})
    with pytest.raises(pixsim.PixsimError, match=r"ranges\.dark: got 'dark_current'; allowed: .*Did you mean 'dark_current_na"):
        run_sensitivity(wrong, desk / "wrong", jobs=1)


def test_tornado_bars_match_table() -> None:
    plate: Plate = tornado(synthetic())
    header, *table = csv.reader(io.StringIO(plate.csv))
    assert len(table) == 3 * 6
    named = [dict(zip(header, row, strict=True)) for row in table]
    sizes = [float(row["optimum_um"]) for row in named if row["technology"] == "0.35um"]
    assert sizes == pytest.approx([6.5, 6.4, 6.0, 7.0, 8.0, 12.0], rel=5e-4)
    left = plate.figure.axes[0]
    bars = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in left.patches]
    np.testing.assert_allclose(bars, [(6.0, 8.0), (6.5, 7.0), (6.4, 6.5)], rtol=2e-4)
    assert [label.get_text() for label in left.get_yticklabels()] == ["wide", "one-sided", "narrow"]


# --- packaged studies -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped() -> Sensitivity:
    return Sensitivity.model_validate(read_toml(packaged("data/studies")["chen2000-sensitivity"]))


def test_packaged_cases_are_valid_and_distinct(shipped: Sensitivity) -> None:
    base = shipped.base_study()
    actual = list(cases_of(shipped))
    for variation, label, study in actual:
        check_pitches(study)
        assert study.model_dump(exclude={"quick"}) != base.model_dump(exclude={"quick"}), f"{variation}, {label} is the base"
        assert (study.seed, study.name) == (base.seed, base.name), "its random streams are others"
        assert study.technologies == ("0.5um", "0.35um", "0.25um", "0.18um")
    assert len({file_name(0, variation, label) for variation, label, _ in actual}) == len(actual), "labels read alike"
    assert len({study.content_hash for *_, study in actual}) == len(actual), "two cases are the same"


# Assumptions that the paper does not state, with their plausible range; None: any value other than the base's.
ASSUMED = {
    "camera.f_number": (2.8, 8.0), "pixel.response": None, "pixel.quantum_efficiency": None, "pixel.offset_fpn": (0.001, 0.01),
    "pixel.prnu": None, "pixel.bits": (8, 12), "display.samples_per_deg": (15.0, 45.0), "display.raster": None,
    "display.delta_e": ("1976", "2000"), "display.filters": None, "pixel.fill_factor_law": None, "pixel.capacitance": None,
    "scene.parameters.luminance_cd_per_m2": None,
}  # fmt: skip


@pytest.mark.parametrize("name", ASSUMED)
def test_packaged_cases_cover_assumptions(name: str, shipped: Sensitivity) -> None:
    def value(study: pixsim.Study) -> object:
        here: object = study.model_dump(mode="json")
        for part in name.split("."):
            here = here.get(part)
        return here

    values = {value(study) for study in (shipped.base_study(), *(study for *_, study in cases_of(shipped)))}
    assert len(values) > 1
    if ASSUMED[name]:
        given = values - {None}  # None: the technology's own
        assert (min(given), max(given)) == ASSUMED[name]


def test_packaged_base_is_chen2000(shipped: Sensitivity) -> None:
    """The settings that change a verdict stand next to the verdicts of chen2000, which must be those of the base."""
    assert shipped.base_study().model_dump(exclude={"quick"}) == load_study("chen2000").model_dump(exclude={"quick"})


def test_packaged_moves_cover_every_process(shipped: Sensitivity) -> None:
    moves = moves_of(shipped)
    assert {item.number for item in moves} == {
        *("dark_current_na_per_cm2", "dsnu", "column_fpn"),
        *("peak_quantum_efficiency", "node_capacitance_ff", "voltage_swing_v"),
    }
    assert len(moves) == 6 * 2 * 4 - 2, "all but the measured peak at 0.35 µm"
    base = shipped.base_study()
    for item in moves:
        check_pitches(item.study(base))
        low, high = load_technology(item.technology).ranges[item.number]
        assert item.value == (low, high)[item.end]


def test_packaged_quick_table_is_valid() -> None:
    table = read_toml(packaged("data/studies")["chen2000-sensitivity"])
    quick = Sensitivity.model_validate(table | table["quick"])
    assert quick.technologies == ("0.35um",)
    assert len(quick.technologies) < len(Sensitivity.model_validate(table).technologies)


def test_packaged_modern_study_has_pinned_photodiodes() -> None:
    study = load_study("modern")
    assert len(study.technologies) >= 2
    for item in (study, study.quickened):
        check_pitches(item)
        assert not item.paper
    for name in study.technologies:
        technology = load_technology(name)
        assert (technology.junction, technology.reset_noise_factor) == (None, 0.0)
        assert technology.full_well_e_per_um2 > 0
        pitches_um = study_pitches_um(study, name)
        pixels = [pixsim.derive(pixsim.Pixel(technology=name, pitch_um=pitch)) for pitch in pitches_um]
        # A given well grows with the photodiode; no kTC noise at any size.
        wells = [pixel.full_well_e / pixel.photodiode_area_um2 for pixel in pixels]
        assert wells == pytest.approx([technology.full_well_e_per_um2] * len(wells))
        assert {pixel.reset_noise_e for pixel in pixels} == {0.0}
