"""Sensor types of a study: each has the rows of a study of its own numbers, and what they say of
the optimum is reported.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, needs_browser
from helpers.commands import assert_refused, command
from helpers.tiny import COARSE, TINY, rows, toml_of

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.uncertainty import uncertainty_blocks
from pixsim.sensor.spread import Spread
from pixsim.show.document import Answer
from pixsim.studies.engine import Workers
from pixsim.studies.files import load_study, uncertainty_of
from pixsim.studies.prepare import UncertaintyRequest, check_axes, unknowns_of_study
from pixsim.studies.settings import Study
from pixsim.studies.study import draw_types
from pixsim.studies.uncertainty import MAX_TYPE_EVALUATIONS, TYPES_FILE, sample_of, settings_of
from pixsim.viewer.merging import merge

SMALL = TINY | {
    "technologies": ["0.35um", "0.25um"], "camera": {"die_mm": 0.5}, "display": {"dots": 32},
    "pitch": {"min_fill_factor": 0.05, "count": 5, "max_um": 15.0},
}  # fmt: skip
DRAWS = 8


def small(**over: Any) -> Study:
    return Study.model_validate(merge(SMALL, over))


def written(**over: Any) -> str:
    return "".join(f"{name} = {toml_of(value)}\n" for name, value in merge(SMALL, over).items())


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, list[Any], Path]:
    """By two metrics: the types of both technologies by ΔE, and those by information."""
    folder = tmp_path_factory.mktemp("types")
    asked = small(metrics=["delta_e", "information"])
    result = pixsim.study(asked, folder, jobs=1, uncertainty=DRAWS, smaller_than_um=(1.0, 20.0))
    return result, list(result.uncertainty), folder


@pytest.mark.parametrize(
    ("file", "column", "metrics"),
    [
        (TYPES_FILE, "mean_delta_e", ["delta_e"]),
        ("types_information.csv", "information", ["delta_e", "information"]),
    ],
)
def test_draw_types_rows_are_those_of_a_study_with_its_numbers(
    file: str, column: str, metrics: list[str], done: tuple[Any, list[Any], Path], tmp_path: Path
) -> None:
    """With the same random streams, and around the optimum of the metric; ΔE has the rows that it
    has alone.
    """
    result, _, folder = done
    sample = UncertaintyRequest(DRAWS).sample(result.study)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    drawn = [
        row for row in rows(folder / file) if (row["draw"], row["technology"]) == ("3", "0.25um")
    ]
    pitches = sorted({float(row["pitch_um"]) for row in drawn})
    assert 5 <= len(drawn) <= MAX_TYPE_EVALUATIONS
    own = {"pitch": {"values_um": [*pitches, 15.0]}, "technologies": ["0.25um"], "metrics": metrics}
    settings = settings_of(result.study, unknowns, sample.draws[3])
    table = merge(merge(SMALL, settings), own) | {
        "process": {"0.25um": settings["process"]["0.25um"]}
    }
    curve = pixsim.study(Study.model_validate(table), tmp_path, jobs=1).curves[0]
    expected = dict(zip(curve.pitch_um.tolist(), curve.statistics[column].tolist(), strict=True))
    for row in drawn:
        assert float(row[column]) == pytest.approx(
            expected[float(row["pitch_um"])][int(row["repeat"])], rel=1e-9
        )


@pytest.mark.parametrize("name", [TYPES_FILE, "types_information.csv"])
def test_rows_of_types_of_another_program_are_refused_before_anything_is_rendered(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(PixsimError, match=rf"results: got '.*{name}', not written by pixsim"):
        pixsim.study(small(metrics=["delta_e", "information"]), tmp_path, jobs=1, uncertainty=DRAWS)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "mine")]


def test_draw_types_by_each_metric(done: tuple[Any, list[Any], Path]) -> None:
    """Around its own optimum, in its own direction."""
    found = done[1]
    first, second = of_information = found[2:]
    assert [each.label for each in found] == ["0.35um", "0.25um"] * 2
    assert [each.as_dict().get("metric") for each in found] == [
        None,
        None,
        "information",
        "information",
    ]
    assert [each.draws for each in found] == [DRAWS] * 4
    better = np.mean(first.table["information"] > second.table["information"])
    assert first.verdicts["0.35um is better than 0.25um"].probability == better
    block = uncertainty_blocks(of_information)[0]
    assert isinstance(block, Answer)
    assert block.head.startswith("0.35um: optimum by information of 8 sensor types: median ")


def test_draw_types_verdicts_are_complementary(done: tuple[Any, list[Any], Path]) -> None:
    first, second = done[1][:2]
    better = (
        first.verdicts["0.35um is better than 0.25um"].probability,
        second.verdicts["0.25um is better than 0.35um"].probability,
    )
    assert sum(better) == 1.0
    assert first.verdicts["the optimum is smaller than 1 µm"].probability == 0.0
    at_the_largest = ~first.table["inside"] & (first.table["optimum_um"] > 3)
    assert (
        first.verdicts["the optimum is smaller than 20 µm"].probability == 1 - at_the_largest.mean()
    )


def test_draw_types_again_computes_nothing(
    done: tuple[Any, list[Any], Path], evaluations: list[Any]
) -> None:
    result, found, folder = done
    before = (folder / TYPES_FILE).read_bytes()
    again = draw_types(
        result,
        UncertaintyRequest(DRAWS, smaller_than_um=(1.0, 20.0)),
        folder,
        Workers(),
        lambda: None,
    )
    assert evaluations == []
    assert (folder / TYPES_FILE).read_bytes() == before
    assert [each.as_dict() for each in again] == [each.as_dict() for each in found]


def test_sample_of_has_the_inputs_of_a_technology(done: tuple[Any, list[Any], Path]) -> None:
    sample = UncertaintyRequest(DRAWS).sample(done[0].study)
    own = sample_of(sample, "0.25um")
    assert {name for name in sample.inputs if not name.startswith("0.35um ")} == set(own.inputs)
    assert {"dsnu", "dark_current_na_per_cm2"} <= set(own.inputs), (
        "both technologies share these draws"
    )
    assert own.quantiles.shape == (DRAWS, len(own.inputs))


def test_check_axes_more_than_one_small_axis_raises() -> None:
    axis = {"name": "lens", "set": "camera.f_number", "values": [2, 3, 4, 5, 6]}
    check_axes(small(axis=[axis]))
    for axes in (
        [axis | {"values": [2, 3, 4, 5, 6, 7]}],
        [axis, {"name": "b", "set": "pixel.prnu", "values": [0]}],
        [axis | {"alone": True}],
    ):
        with pytest.raises(
            PixsimError, match=r"uncertainty: .*at most one axis of at most 5 values"
        ):
            check_axes(small(axis=axes))


# A sensor that is described by its numbers, and one of them that is known within a range.
SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}
NOISE = {"uncertainty": {"read_noise_e": {"sd": 5.0}}}


def sheet(path: Path, **more: Any) -> Path:
    path.write_text(f"pixel = {toml_of(SHEET | more)}\n", encoding="utf-8")
    return path


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a study of one technology on few dots, so that 24 types take a second,
    and such a sheet.
    """
    monkeypatch.chdir(tmp_path)
    few = {"technologies": ["4t-bsi"], "camera": {"die_mm": 0.2}, "display": {"dots": 16}}
    (tmp_path / "s.toml").write_text(written(**few), encoding="utf-8")
    return sheet(tmp_path / "sheet.toml", **NOISE).parent


def test_dry_run_counts_the_time_of_sensor_types(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 types take eight times as long as 8, beside the study itself."""
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(written(technologies=["0.35um"]), encoding="utf-8")
    seconds = []
    for more in ("", " --uncertainty 8", " --uncertainty 64"):
        code, out, err = command(f"study s.toml --jobs 1 --dry-run --json{more}")
        assert code == 0, err
        seconds.append(json.loads(out)["estimate"]["seconds"])
    assert seconds[2] - seconds[0] == pytest.approx(8 * (seconds[1] - seconds[0]), rel=1e-9)
    assert seconds[1] > seconds[0]


@pytest.mark.slow  # the draws are those above; test_uncertainty has the numbers of sheets
def test_study_command_uncertainty_of_a_data_sheet(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = command(
        "study s.toml --config sheet.toml --uncertainty 8 --smaller-than 6 --jobs 1 --out out"
        " --json"
    )
    assert code == 0, err
    assert "8 sensor types, at most 192 evaluations" in err
    (own,) = json.loads(out)["uncertainty"]
    assert list(own["inputs"]) == ["read_noise_e"]
    assert own["verdicts"]["the optimum is smaller than 6 µm"]["draws"] == 8
    assert (
        json.loads(Path("out/summary.json").read_text(encoding="utf-8"))["uncertainty"][0]["draws"]
        == 8
    )
    assert "Sensor types: " in Path("out/report.html").read_text(encoding="utf-8")
    assert (
        Path("out/sensor_types_1.csv")
        .read_text(encoding="utf-8")
        .startswith("draw,read_noise_e,optimum_um,")
    )
    # The command in settings.toml draws the same types, without the sheet.
    monkeypatch.chdir("out")
    line = Path("settings.toml").read_text(encoding="utf-8").splitlines()[1]
    assert line == "# pixsim study settings.toml --uncertainty 8 --smaller-than 6.0"
    code, _, err = command(f"{line.removeprefix('# pixsim ')} --jobs 1 --out again")
    assert code == 0, err
    for name in ("settings.toml", "sensor_types_1.csv"):
        assert Path("again", name).read_bytes() == Path(name).read_bytes()


def test_sobol_in_python_has_the_indices_of_the_command(desk: Path) -> None:
    """The command takes the rows of the study in Python, and finds nothing else to evaluate in
    them.
    """
    (found,) = pixsim.study(
        "s.toml", "out", config="sheet.toml", jobs=1, sobol=8, smaller_than_um=[6.0]
    ).uncertainty
    assert found.draws == 8 * (1 + 2)
    before = Path("out", TYPES_FILE).read_bytes()
    code, _, err = command(
        "study s.toml --config sheet.toml --sobol 8 --smaller-than 6 --jobs 1 --out out"
    )
    assert code == 0, err
    assert Path("out", TYPES_FILE).read_bytes() == before
    (written_one,) = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))["uncertainty"]
    assert written_one == json.loads(json.dumps(found.as_dict()))
    assert {
        kind for inputs in found.shares.values() for kinds in inputs.values() for kind in kinds
    } == {"first", "total"}
    with pytest.raises(PixsimError, match=r"uncertainty: got with sobol; allowed: one of the two"):
        pixsim.study("s.toml", "none", config="sheet.toml", sobol=8, uncertainty=8)
    assert not Path("none").exists()


def test_settings_keep_the_uncertainty_of_sheets_that_change(tmp_path: Path) -> None:
    """Of the study's own [pixel] and of data sheets among the technologies, whose files state
    something else by then.
    """
    of_noise = {"read_noise_e": {"range": [15.0, 25.0]}}
    sheets = [sheet(tmp_path / "a.toml", uncertainty=of_noise), sheet(tmp_path / "b.toml", bits=8)]
    text = written(
        technologies=["a.toml", "b.toml", "4t-bsi"],
        pitch={"values_um": [4, 5, 6, 7, 8]},
        resolution=COARSE,
    )
    text += "pixel = { prnu = 0.01, uncertainty = { prnu = { sd = 0.001 } } }\n"
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    result = pixsim.study(tmp_path / "s.toml", tmp_path / "out", jobs=1)
    (tmp_path / "settings.toml").write_text(result.settings_toml, encoding="utf-8")
    for path in sheets:
        sheet(path, uncertainty={"full_well_e": {"sd": 3.0}})
    spreads = uncertainty_of(tmp_path / "settings.toml")
    own, of_sheet = {"prnu": Spread(sd=0.001)}, {"read_noise_e": Spread(range=(15.0, 25.0))}
    assert spreads == {"": own, str(sheets[0]): of_sheet, str(sheets[1]): {}}
    found = unknowns_of_study(load_study(tmp_path / "settings.toml"), spreads)
    assert [unknown.name for unknown in found if unknown.is_data_sheet] == [
        "prnu",
        f"{sheets[0]} read_noise_e",
    ]


def test_sheets_have_separate_draws(tmp_path: Path) -> None:
    """Also of quantities with one draw in all technologies: each sensor was measured on its own."""
    for name, noise_e in (("a", 2.0), ("b", 3.0)):
        spreads = {"dsnu": {"sd": 0.02}, "read_noise_e": {"sd": 0.2}}
        sheet(tmp_path / f"{name}.toml", dsnu=0.2, read_noise_e=noise_e, uncertainty=spreads)
    (tmp_path / "s.toml").write_text(
        written(technologies=["a.toml", "b.toml", "0.35um", "0.25um"]), encoding="utf-8"
    )
    study = load_study(tmp_path / "s.toml")
    sample = UncertaintyRequest(512).sample(study)
    names = [
        f"{tmp_path / name}.toml {number}" for name in "ab" for number in ("dsnu", "read_noise_e")
    ]
    assert names == list(sample.inputs)[:4]
    assert len(sample.inputs["dsnu"]) == 2, "of both technologies"
    drawn = np.array([[draw[name] for name in names] for draw in sample.draws])
    # Independent normals correlate by 1/√512; Sobol' points by less.
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 3 / np.sqrt(512)
    assert [
        each.technology
        for unknowns in sample_of(sample, str(tmp_path / "b.toml")).inputs.values()
        for each in unknowns
    ] == [str(tmp_path / "b.toml")] * 2


def test_settings_of_own_pixel_are_those_of_sheets_that_take_them_over(tmp_path: Path) -> None:
    sheet(tmp_path / "a.toml")
    sheet(tmp_path / "b.toml", prnu=0.02)
    text = (
        written(technologies=["a.toml", "b.toml"])
        + "pixel = { prnu = 0.01, uncertainty = { prnu = { sd = 0.001 } } }\n"
    )
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    study, spreads = load_study(tmp_path / "s.toml"), uncertainty_of(tmp_path / "s.toml")
    table = settings_of(study, unknowns_of_study(study, spreads), {"prnu": 0.012})
    assert table == {
        "pixel": {"prnu": 0.012},
        "sensors": {str(tmp_path / "a.toml"): {"prnu": 0.012}},
    }


def test_uncertainty_beside_an_option_out_of_its_range_raises(tmp_path: Path) -> None:
    path = sheet(tmp_path / "sheet.toml", uncertainty={"read_noise_e": {"range": [15.0, 25.0]}})
    spreads = uncertainty_of("pixel-size", [path])
    unknowns_of_study(load_study("pixel-size", path, pixel={"read_noise_e": 16.0}), spreads)
    other = load_study("pixel-size", path, pixel={"read_noise_e": 3.0})
    with pytest.raises(
        PixsimError,
        match=(
            r"pixel.uncertainty.read_noise_e: got range = \[15, 25\]; allowed: a range that holds 3"
        ),
    ):
        unknowns_of_study(other, spreads)


@pytest.mark.slow
@needs_browser
def test_uncertainty_page_fits_screens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(written(technologies=["0.35um", "0.25um"]), encoding="utf-8")
    code, _, err = command("study s.toml --uncertainty 16 --smaller-than 6 --jobs 1 --out out")
    assert code == 0, err
    assert_fits(tmp_path / "out/report.html", tmp_path)
    assert_prints(
        tmp_path / "out/report.html",
        tmp_path,
        range(4, 20),
        ["smaller than 6", "0.25um is better"],
        [],
    )


@pytest.mark.parametrize(
    ("line", "texts"),
    [
        ("--uncertainty 8 --sobol 8", ["--uncertainty", "one of the two"]),
        ("--smaller-than 6", ["--smaller-than", "--uncertainty N"]),
        ("--uncertainty 0", ["uncertainty", "8 to 65536"]),
        ("--sobol 4", ["sobol: got 4; allowed: 8 to"]),
        ("--uncertainty 8", ["unknowns", "[pixel.uncertainty]"]),
        (
            "--uncertainty 8 --axis camera.f_number=2,3,4,5,6,8",
            ["--uncertainty", "at most 5 values"],
        ),
    ],
)
def test_study_command_uncertainty_invalid_is_refused(
    line: str, texts: list[str], desk: Path
) -> None:
    sheet(desk / "sheet.toml")
    assert_refused(*command(f"study s.toml --config sheet.toml --jobs 1 --out out {line}"), texts)
    assert not Path("out").exists()
