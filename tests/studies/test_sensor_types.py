"""Sensor types of a study and of a comparison: each has the rows of its own numbers, and their
shares and probabilities are those of closed forms.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.sheets import sheet as noisy_sheet
from helpers.tiny import COARSE, TINY, rows, toml_of

import pixsim
from pixsim.base.toml import SETTINGS_FILE
from pixsim.sensor.readout import Frame
from pixsim.sensor.spread import Spread
from pixsim.studies.compare import scatter_variances
from pixsim.studies.engine import Workers
from pixsim.studies.files import load_study, uncertainty_of
from pixsim.studies.prepare import UncertaintyRequest
from pixsim.studies.settings import Study
from pixsim.studies.study import draw_types
from pixsim.studies.uncertainty import MAX_TYPE_EVALUATIONS, TYPES_FILE, sample_of, settings_of
from pixsim.viewer.merging import merge

NAMES = ["0.35um", "0.25um"]
SMALL = TINY | {
    "technologies": NAMES,
    "camera": {"die_mm": 0.2},
    "display": {"dots": 16},
    "pitch": {"min_fill_factor": 0.05, "count": 5, "max_um": 12.0},
}
DRAWS = 8
FILE = "types_information.csv"
# A sensor that is described by its numbers, and one of them that is known within a range.
SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}


def written(**over: Any) -> str:
    return "".join(f"{name} = {toml_of(value)}\n" for name, value in merge(SMALL, over).items())


def sheet(path: Path, **more: Any) -> Path:
    path.write_text(f"pixel = {toml_of(SHEET | more)}\n", encoding="utf-8")
    return path


# --- of a study


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """The types of both technologies by information."""
    folder = tmp_path_factory.mktemp("types")
    study = Study.model_validate(merge(SMALL, {"metrics": ["information"]}))
    options = {"uncertainty": DRAWS, "smaller_than_um": (1.0, 20.0)}
    return pixsim.study(study, folder, jobs=1, **options), folder


def test_rows_of_a_type_are_those_of_a_study_with_its_numbers(
    done: tuple[Any, Path], tmp_path: Path
) -> None:
    """With the same random streams, around the optimum of the metric."""
    result, folder = done
    sample = UncertaintyRequest(DRAWS).sample(result.study)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    places = [("3", "0.25um")]
    drawn = [row for row in rows(folder / FILE) if (row["draw"], row["technology"]) in places]
    pitches_um = [float(row["pitch_um"]) for row in drawn]
    assert 5 <= len(drawn) <= MAX_TYPE_EVALUATIONS

    process = settings_of(result.study, unknowns, sample.draws[3])["process"]["0.25um"]
    over = {"technologies": ["0.25um"], "metrics": ["information"], "process": {"0.25um": process}}
    over |= {"pitch": {"values_um": [*sorted(set(pitches_um)), 12.0]}}
    curve = pixsim.study(Study.model_validate(merge(SMALL, over)), tmp_path, jobs=1).curves[0]
    values = curve.statistics["information"][np.searchsorted(curve.pitch_um, pitches_um)]
    expected = [each[int(row["repeat"])] for each, row in zip(values, drawn, strict=True)]
    np.testing.assert_allclose([float(row["information"]) for row in drawn], expected, rtol=1e-9)


def test_verdicts_are_shares_of_the_types(done: tuple[Any, Path]) -> None:
    """By information more is better; both technologies together have 1."""
    first, second = done[0].uncertainty
    share = np.mean(first.table["information"] > second.table["information"])
    assert first.verdicts["0.35um is better than 0.25um"].probability == share
    assert second.verdicts["0.25um is better than 0.35um"].probability == 1 - share
    assert first.verdicts["the optimum is smaller than 1 µm"].probability == 0.0


def test_drawing_again_computes_nothing(done: tuple[Any, Path], evaluations: list[Frame]) -> None:
    result, folder = done
    before = (folder / FILE).read_bytes()
    request = UncertaintyRequest(DRAWS, smaller_than_um=(1.0, 20.0))
    again = draw_types(result, request, folder, Workers(), lambda: None)
    assert evaluations == []
    assert (folder / FILE).read_bytes() == before
    assert [each.as_dict() for each in again] == [each.as_dict() for each in result.uncertainty]


def test_sobol_in_python_has_the_indices_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command takes the rows of the study in Python; that in settings.toml draws the same
    types.
    """
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(written(technologies=["4t-bsi"]), encoding="utf-8")
    sheet(Path("sheet.toml"), uncertainty={"read_noise_e": {"sd": 5.0}})
    options = {"config": "sheet.toml", "jobs": 1, "sobol": 8, "smaller_than_um": [6.0]}
    (result,) = pixsim.study("s.toml", "out", **options).uncertainty
    assert result.draws == 8 * (1 + 2)
    before = Path("out", TYPES_FILE).read_bytes()
    line = "--sobol 8 --smaller-than 6.0"
    command(f"study s.toml --config sheet.toml {line} --jobs 1 --out out")
    assert Path("out", TYPES_FILE).read_bytes() == before
    summary = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert summary["uncertainty"] == [json.loads(json.dumps(result.as_dict()))]
    settings = Path("out/settings.toml").read_text(encoding="utf-8").splitlines()
    assert settings[1] == f"# pixsim study settings.toml {line}"


@pytest.fixture
def sheets(tmp_path: Path) -> tuple[Path, list[str]]:
    """A study of two sheets and two technologies, whose [pixel] has an uncertain PRNU."""
    spreads = {"dsnu": {"sd": 0.02}, "read_noise_e": {"range": [15.0, 25.0]}}
    sheet(tmp_path / "a.toml", dsnu=0.2, uncertainty=spreads)
    sheet(tmp_path / "b.toml", dsnu=0.2, prnu=0.02, read_noise_e=18.0, uncertainty=spreads)
    text = written(technologies=["a.toml", "b.toml", *NAMES], resolution=COARSE)
    text += "pixel = { prnu = 0.01, uncertainty = { prnu = { sd = 0.001 } } }\n"
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    return tmp_path / "s.toml", [str(tmp_path / "a.toml"), str(tmp_path / "b.toml")]


def test_sheets_have_separate_draws(sheets: tuple[Path, list[str]]) -> None:
    """Also of quantities with one draw in all technologies: each sensor was measured on its own."""
    path, files = sheets
    sample = UncertaintyRequest(512, uncertainty=uncertainty_of(path)).sample(load_study(path))
    names = [f"{file} {number}" for file in files for number in ("dsnu", "read_noise_e")]
    assert {*names, "prnu"} <= sample.inputs.keys()
    assert len(sample.inputs["dsnu"]) == 2, "of both technologies"
    drawn = np.array([[draw[name] for name in names] for draw in sample.draws])
    # Independent normals correlate by 1/√512; Sobol' points by less.
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 3 / np.sqrt(512)
    inputs = sample_of(sample, files[1]).inputs
    assert inputs.keys() == {"prnu", *names[2:]}, "of one sheet, and of [pixel]"


def test_settings_keep_the_uncertainty_of_sheets_that_change(
    sheets: tuple[Path, list[str]], tmp_path: Path
) -> None:
    path, files = sheets
    over = {"technologies": files, "pitch": {"values_um": [4, 5, 6, 7, 8]}}
    result = pixsim.study(path, tmp_path / "out", jobs=1, **over)
    (tmp_path / "settings.toml").write_text(result.settings_toml, encoding="utf-8")
    sheet(Path(files[0]), uncertainty={"full_well_e": {"sd": 3.0}})
    spreads = {"dsnu": Spread(sd=0.02), "read_noise_e": Spread(range=(15.0, 25.0))}
    expected = {"": {"prnu": Spread(sd=0.001)}} | dict.fromkeys(files, spreads)
    assert uncertainty_of(tmp_path / "settings.toml") == expected
    assert load_study(tmp_path / "settings.toml").sensors == result.study.sensors


def test_dry_run_counts_the_time_of_sensor_types(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 types take eight times as long as 8, beside the study itself."""
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(written(technologies=["0.35um"]), encoding="utf-8")
    seconds = [
        json.loads(command(f"study s.toml --dry-run --json{more}")[1])["estimate"]["seconds"]
        for more in ("", " --uncertainty 8", " --uncertainty 64")
    ]
    assert seconds[2] - seconds[0] == pytest.approx(8 * (seconds[1] - seconds[0]), rel=1e-9)
    assert seconds[1] > seconds[0]


# --- of a comparison

DIM = {"luminance_cd_per_m2": 0.05}  # so that read noise decides
PAIR = {"display": {"dots": 32}, "resolution": COARSE, "repeats": 3, "jobs": 1, "parameters": DIM}


def unsure(path: Path, low_e: float, high_e: float) -> Path:
    """A data sheet with a uniform range of its read noise."""
    spread = f"read_noise_e = {{ range = [{low_e}, {high_e}], distribution = 'uniform' }}"
    return noisy_sheet(path, (low_e + high_e) / 2, more=f"[pixel.uncertainty]\n{spread}\n")


@pytest.mark.parametrize(
    ("range_a", "range_b", "expected"),
    [((10.0, 30.0), (20.0, 40.0), 0.875), ((30.0, 40.0), (10.0, 20.0), 0.0)],
)
def test_probability_is_that_of_less_read_noise(
    range_a: tuple[float, float], range_b: tuple[float, float], expected: float, tmp_path: Path
) -> None:
    """With equal random numbers, mean ΔE grows with read noise: a is better where its read noise is
    smaller. The share of 64 draws is within two standard errors.
    """
    files = [unsure(tmp_path / "a.toml", *range_a), unsure(tmp_path / "b.toml", *range_b)]
    (result,) = pixsim.compare(files, uncertainty=64, **PAIR).uncertainty
    noise_e = np.array([list(draw.values()) for draw in result.sample.draws])
    np.testing.assert_array_equal(result.differences > 0, noise_e[:, 0] < noise_e[:, 1])
    better = result.probability_a_better
    assert better.probability == np.mean(noise_e[:, 0] < noise_e[:, 1])
    assert better.probability == pytest.approx(expected, abs=2 * np.sqrt(expected / 8 / 64))
    assert better.low <= expected <= better.high
    # Differences are nearly linear in both numbers: all shares together are the variance.
    total = sum(share["first"].share for share in result.shares.values())
    assert total == pytest.approx(1.0, abs=0.1)


def test_scatter_variances_are_those_of_noise_that_types_do_not_share() -> None:
    """Of 2000 types in two frames: a noise of 0.3 leaves a variance of 0.045 in their mean, which
    2000 squares tell to 3.2 %.

    What differs between types, or between frames by the same amount for all types, is not scatter.
    """
    rng = np.random.default_rng(0)
    shared = rng.normal(5.0, 2.0, (2000, 1)) + np.array([1.0, -3.0])
    noise = 0.3 * rng.standard_normal((2000, 2))
    assert scatter_variances(shared + noise).mean() == pytest.approx(0.045, rel=4 * 0.032)
    np.testing.assert_allclose(scatter_variances(shared), np.zeros(2000), atol=1e-24)


def test_conditions_average_the_types_of_a_pair(tmp_path: Path) -> None:
    """Differences are weighted means; under a condition that states the uncertain number, these two
    sensors are alike.
    """
    files = [noisy_sheet(tmp_path / "a.toml", 25.0), unsure(tmp_path / "b.toml", 10.0, 30.0)]
    settings = {
        "long": {"exposure": {"max_integration_s": 0.1}},
        "short": {"exposure": {"max_integration_s": 0.02}},
        "set": {"pixel": {"read_noise_e": 5.0}},
    }
    weights = {"long": 3.0, "short": 1.0, "set": 4.0}
    conditions = [
        {"name": name, "weight": weights[name], "set": settings[name]} for name in weights
    ]
    study = Study.model_validate({"name": "three", "condition": conditions})
    differences = [
        pixsim.compare(files, uncertainty=8, **PAIR | over).uncertainty[0].differences
        for over in ({"study": study}, settings["long"], settings["short"])
    ]
    expected = 0.375 * differences[1] + 0.125 * differences[2]
    np.testing.assert_allclose(differences[0], expected, rtol=1e-9)


def test_a_pair_without_an_unknown_number_has_no_types(tmp_path: Path) -> None:
    files = [noisy_sheet(tmp_path / "a.toml", 25.0), unsure(tmp_path / "b.toml", 10.0, 30.0)]
    files += [noisy_sheet(tmp_path / "c.toml", 9.0)]
    result = pixsim.compare(files, uncertainty=8, **PAIR)
    assert [pair.names for pair in result.uncertainty] == [("a", "b")]
    assert [note.id for note in result.notes if "a and c" in note] == ["no_effect"]


def test_types_are_judged_by_each_metric(tmp_path: Path) -> None:
    """In its own direction: the sensor with less read noise has more information, and sees a target
    better.
    """
    files = [unsure(tmp_path / "a.toml", 10.0, 20.0), unsure(tmp_path / "b.toml", 25.0, 35.0)]
    target = {"size_um": 100.0, "contrast": -0.1, "luminance_cd_per_m2": 0.5}
    options = PAIR | {"scene": "target", "parameters": target, "uncertainty": 8}
    result = pixsim.compare(files, metrics=["information", "detectability"], **options)
    assert {pair.metric.name for pair in result.uncertainty} >= {"information", "detectability"}
    for pair in result.uncertainty:
        assert pair.metric.is_delta_e or pair.probability_a_better.probability == 1.0


def test_sensors_of_one_technology_share_its_numbers(tmp_path: Path) -> None:
    """What is not known of a process moves two equal sensors alike: they stay equal in every
    type.
    """
    files = [tmp_path / "a.toml", tmp_path / "b.toml"]
    for file in files:
        file.write_text("[camera]\ndie_mm = 0.5\n[pixel]\npitch_um = 10.0\n", encoding="utf-8")
    (result,) = pixsim.compare(files, uncertainty=8, **PAIR).uncertainty
    members = list(result.sample.inputs.values())
    assert {tuple(unknown.technology for unknown in each) for each in members} == {("a", "b")}
    assert np.array_equal(result.differences, np.zeros(8))
    assert result.probability_a_better.probability == 0.5


def test_an_interrupted_comparison_of_types_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, evaluations: list[Frame]
) -> None:
    """The line of settings.toml takes up a table of types that was cut off, and finds the same."""
    monkeypatch.chdir(tmp_path)
    unsure(Path("a.toml"), 10.0, 30.0)
    noisy_sheet(Path("b.toml"), 25.0)
    small = f"--display.dots 32 --resolution {COARSE} --repeats 2 -D luminance_cd_per_m2=1"
    command(f"compare a.toml b.toml --uncertainty 8 --jobs 1 {small} --out first")
    monkeypatch.chdir("first")
    first = json.loads(Path("compare.json").read_text(encoding="utf-8"))["uncertainty"]
    whole = Path(TYPES_FILE).read_bytes()
    lines = whole.splitlines(keepends=True)
    Path(TYPES_FILE).write_bytes(b"".join(lines[:9]))
    settings = Path(SETTINGS_FILE).read_text(encoding="utf-8").splitlines()
    (repeat,) = [line for line in settings if "pixsim compare" in line]
    evaluations.clear()
    command(repeat.removeprefix("# pixsim ") + " --jobs 1 --out .")
    assert len(evaluations) < len(lines) - 1, "not all again"
    assert Path(TYPES_FILE).read_bytes() == whole
    again = json.loads(Path("compare.json").read_text(encoding="utf-8"))["uncertainty"]
    assert again == first
