"""Studies of colour filters: the monochrome case is that of a study without them, and what the
errors are made of adds up.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import COARSE, toml_of
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged
from pixsim.report.maps import Grid, axis_plates
from pixsim.report.study_facts import study_notes
from pixsim.scene.colour_chart import modulation, write_colour_chart
from pixsim.studies.design import cases_of, physics_of
from pixsim.studies.files import load_study
from pixsim.studies.merit import noise_budgets
from pixsim.studies.result import CasesResult
from pixsim.studies.settings import Study
from pixsim.viewer.merging import merge
from pixsim.viewer.scielab import XYZ_FROM_OPPONENT
from pixsim.viewer.screen import check_one_ideal

SMALL: dict[str, Any] = {
    **{
        "name": "filters",
        "technologies": ["4t-bsi"],
        "repeats": 2,
        "resolution": COARSE,
        "camera": {"die_mm": 0.2},
    },
    **{
        "pixel": {"stack": {"enabled": False}},
        "display": {"dots": 24},
        "pitch": {"values_um": [2.0, 2.5, 3.0, 4.0, 6.0]},
    },
}
FEW_PIXELS: dict[str, Any] = {"camera": {"die_mm": 0.1}}
TOO_SMALL_UM = [0.45, 0.5, 0.55, 0.6]  # for these filters
CAMERA = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
PIXELS = {
    "none": {"bits": 10},
    "RGGB": {"colour": CAMERA},
    "quad": {"colour": CAMERA | {"pattern": "quad_rggb", "binning": True}},
}
FILTERS = {
    "name": "filters",
    "values": [{"label": name, "set": {"pixel": pixel}} for name, pixel in PIXELS.items()],
}


def small(**over: Any) -> Study:
    return Study.model_validate(merge(SMALL, over))


STACKS = {
    "name": "stack",
    "values": [
        {"label": name, "set": {"pixel": {"stack": {"enabled": name == "deep"}}}}
        for name in ("open", "deep")
    ],
}
LENSES = {"name": "f", "set": "camera.f_number", "values": [2.8, 4.0]}


def rows_of(folder: Path, filters: str | None = None) -> list[dict[str, str]]:
    with (folder / "results.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if filters is None or row["filters"] == filters]
    return [
        {name: value for name, value in row.items() if name not in ("key", "filters", "check")}
        for row in rows
    ]


@pytest.mark.filterwarnings("ignore:.*black level")
def test_study_of_filters(tmp_path: Path) -> None:
    pixsim.study(small(), out=tmp_path / "plain", jobs=1)
    result = pixsim.study(
        small(axis=[FILTERS], noise_budget=True), out=tmp_path / "filters", jobs=1
    )
    assert rows_of(tmp_path / "filters", "none") == rows_of(tmp_path / "plain")
    assert len(rows_of(tmp_path / "filters", "RGGB")) == len(rows_of(tmp_path / "plain"))
    budgets = noise_budgets(result)
    assert [label.split(", ")[1] for label in budgets] == ["none", "RGGB", "quad"]
    for budget in budgets.values():
        assert sum(budget.parts.values()) == pytest.approx(budget.mean_delta_e, abs=1e-9)
    assert ["mosaic" in budget.delta_e for budget in budgets.values()] == [False, True, True]
    score = result.case(filters="RGGB").scores("4t-bsi", 2.5, 1)[0]
    quad = result.case(filters="quad")
    (curve,), frame = quad.curves, quad.scores("4t-bsi", 2.5, 1)[0].frame
    dark, size = quad.dark(curve), curve.pitch_um.tolist().index(2.5)
    assert dark["spread_dn"][size] / dark["spread_e"][size] == pytest.approx(
        frame.dn_per_e, rel=1e-12
    )  # of four pixels together
    assert score.image.shape == (*score.delta_e.shape, 3)
    assert (
        np.ptp(score.ideal, axis=2).max() < 0.02
    )  # a grey chart is grey in colour: to a code of the display


@pytest.mark.filterwarnings(
    "ignore:.*black level", "ignore:.*Fresnel", "ignore:.*, lens .*left out"
)
def test_sizes_whose_colours_mix_are_left_out(tmp_path: Path) -> None:
    """With the reason beside them; the other sizes have the numbers of a study that never had them,
    also when it is resumed.
    """
    pixel = {"colour": CAMERA, "stack": {"enabled": True}}
    kept = [1.2, 2.0, 2.5, 3.0, 4.0]

    def run(folder: str, *more_um: float, **settings: Any) -> pixsim.StudyResult:
        study = small(pixel=pixel, pitch={"values_um": [*more_um, *kept]}, **FEW_PIXELS, **settings)
        return pixsim.study(study, out=tmp_path / folder, jobs=1)

    run("alone")
    for _ in range(2):
        with pytest.warns(
            UserWarning, match=r"4t-bsi: 0.45, 0.6 µm left out: pixels of 0.6 µm: .*noise gains of"
        ):
            result = run("mixed", 0.45, 0.6)
        (curve,) = result.curves
        assert curve.pitch_um.tolist() == kept
        assert [pitch_um for pitch_um, _ in curve.left_out] == [0.45, 0.6]
        assert list(result.as_dict()["curves"][0]["left_out"]) == ["0.45", "0.6"]
        assert rows_of(tmp_path / "mixed") == rows_of(tmp_path / "alone")
    result = run("axis", 0.45, axis=[LENSES])
    assert [curve.pitch_um.tolist() for curve in result.curves] == [kept, kept]


def test_budget_of_a_colour_study_is_that_of_its_first_frame(tmp_path: Path) -> None:
    """One for its one curve, of the frame in results.csv."""
    pixel = {"black_level_dn": 64, "bits": 12, "colour": CAMERA}
    ((label, budget),) = noise_budgets(
        pixsim.study(small(pixel=pixel, noise_budget=True), out=tmp_path, jobs=1)
    ).items()
    rows = {
        f"{float(row['pitch_um']):.3g} µm": row for row in rows_of(tmp_path) if row["repeat"] == "0"
    }
    assert budget.mean_delta_e == pytest.approx(
        float(rows[label.split(", ")[-1]]["mean_delta_e"]), abs=1e-9
    )
    assert budget.parts["crosstalk and shading"] == 0.0


STACKED: dict[str, Any] = {"colour": CAMERA, "stack": {"enabled": True}}


@pytest.mark.filterwarnings("ignore:.*Fresnel")
@pytest.mark.parametrize(
    ("largest_um", "axis", "words"),
    [
        (2.0, [], "4t-bsi: 1 of 5 pixel sizes are possible, and a curve needs 3. pixels of 0.6 µm"),
        (
            0.65,
            [{"name": "f", "set": "camera.f_number", "values": [4.0]}],
            "4t-bsi, f 4: none of its",
        ),
    ],
    ids=["few", "case"],
)
def test_study_without_possible_sizes_names_the_case(
    tmp_path: Path, largest_um: float, axis: list[Any], words: str
) -> None:
    sizes = {"values_um": [*TOO_SMALL_UM, largest_um]}
    study = small(pixel=STACKED, pitch=sizes, axis=axis, resolution=64, **FEW_PIXELS)
    with pytest.raises(PixsimError, match=f"{words}.*noise gains"):
        pixsim.study(study, out=tmp_path / "out", jobs=1)


@pytest.mark.filterwarnings("ignore:.*Fresnel", "ignore:.*black level")
@pytest.mark.parametrize(
    ("largest_um", "reason"),
    [
        # One that is possible is as none, and takes a study of three sizes more.
        pytest.param(
            2.0,
            "1 of 5 pixel sizes are possible, and a curve needs 3. pixels of 0.6 µm",
            marks=pytest.mark.slow,
        ),
        (0.65, "0 of 5 pixel sizes are possible"),
    ],
)
def test_cases_with_too_few_possible_sizes_are_left_out_with_the_reason(
    tmp_path: Path, largest_um: float, reason: str
) -> None:
    """By TOML on the command line and in Python: the others have their curves, figures and
    pages.
    """
    own = {
        "pixel": {"colour": CAMERA},
        "pitch": {"values_um": [*TOO_SMALL_UM, largest_um]},
        "axis": [STACKS, LENSES],
    }
    table = merge(SMALL, own | FEW_PIXELS)
    study = Study.model_validate(table)
    with pytest.warns(
        UserWarning, match=rf"a case is left out: 4t-bsi, deep, f 4: {re.escape(reason)}"
    ):
        result = pixsim.study(study, out=tmp_path / "python", jobs=1)
    assert [curve.at for curve in result.curves] == [
        {"stack": "open", "f": f_number} for f_number in (2.8, 4.0)
    ]
    assert [text.partition(":")[0] for text in result.left_out] == [
        f"4t-bsi, deep, f {f_number}" for f_number in (2.8, 4)
    ]
    assert result.as_dict()["left_out"] == list(result.left_out)
    assert len(study_notes(result)) >= 2
    assert len(axis_plates(result)) == 5
    if largest_um > 1:  # nothing of the page depends on the reason
        text = "".join(f"{name} = {toml_of(value)}\n" for name, value in table.items())
        (tmp_path / "study.toml").write_text(text, encoding="utf-8")
        code, _, err = command(
            f"study {tmp_path / 'study.toml'} --out {tmp_path / 'files'} --jobs 1"
        )
        assert code == 0, err
        assert re.sub(r"\s+", " ", err).count("a case is left out: 4t-bsi, deep") == 2
        assert rows_of(tmp_path / "files") == rows_of(tmp_path / "python")
        page = (tmp_path / "files" / "report.html").read_text(encoding="utf-8")
        assert "a case is left out: 4t-bsi, deep, f 4" in page


def test_figures_leave_a_gap_where_a_case_is_left_out() -> None:
    """A line or panel without any case is not drawn."""
    study = small(axis=[STACKS, LENSES | {"values": [2.8, 4.0, 5.6]}])

    def lines(is_there: Callable[[dict[str, Any]], bool]) -> dict[str, list[Any]]:
        curves = [
            SimpleNamespace(technology="4t-bsi", at=case.at, condition="", alone="")
            for case in cases_of(study)
        ]
        parts = [SimpleNamespace(curves=(curve,)) for curve in curves if is_there(curve.at)]
        grid = Grid(cast("CasesResult", SimpleNamespace(study=study, parts=parts)))
        panels, _ = grid.panels(grid.scales[1])
        return {
            panel.label: [curve and curve.at["f"] for curve in panel.rows[0]] for panel in panels
        }

    assert lines(lambda at: at != {"stack": "deep", "f": 4.0}) == {
        "open": [2.8, 4.0, 5.6],
        "deep": [2.8, None, 5.6],
    }
    assert lines(lambda at: at["stack"] == "open") == {"open": [2.8, 4.0, 5.6]}


def test_packaged_study_of_filters_is_possible() -> None:
    """All cases have possible pixels, of files beside the study."""
    study = load_study("colour")
    assert Path(packaged("data/studies")["colour"]).is_file()
    cases = cases_of(study)
    assert len(cases) == 10
    channels = [len(physics_of(case.settings, "4t-bsi", 2.0).channels) for case in cases[::2]]
    assert channels == [1, 3, 3, 3, 3]


def test_monochrome_and_colour_sensors_have_one_ideal_in_a_grey_scene_only() -> None:
    grey, red = (np.full((4, 4, 3), rgb) for rgb in ((0.5, 0.5, 0.5), (0.6, 0.5, 0.5)))
    check_one_ideal(["mono"], {"rgb": grey})
    check_one_ideal([], {"in red": red, "also": red})
    with pytest.raises(
        PixsimError,
        match=r"sensors: got mono without colour filters and rgb, in red with.*Take a grey scene",
    ):
        check_one_ideal(["mono"], {"rgb": grey, "in red": red})


@pytest.fixture(scope="module")
def red_green(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coloured chart of few cycles."""
    path = tmp_path_factory.mktemp("chart") / "redgreen.xml"
    write_colour_chart(
        path, modulation(-XYZ_FROM_OPPONENT[:, 1]), "red-green", width=256, height=64, die_mm=0.2
    )
    return path


def test_study_does_not_compare_monochrome_and_colour_in_a_coloured_scene(
    red_green: Path, tmp_path: Path
) -> None:
    """Nor does it evaluate anything: the error comes before."""
    coarse = {
        "resolution": 32,
        "render_noise": 1e3,
        "pitch": {"values_um": [4.0, 5.0, 6.0, 7.0, 8.0]},
    }
    study = small(
        **coarse, scene={"file": str(red_green)}, axis=[FILTERS | {"values": FILTERS["values"][:2]}]
    )
    with pytest.raises(
        PixsimError,
        match=(
            r"4t-bsi, none without colour filters and 4t-bsi, RGGB with them, in a coloured scene"
        ),
    ):
        pixsim.study(study, out=tmp_path, jobs=1)


@pytest.mark.slow  # test_compare compares, and a run and a study have the colours
@pytest.mark.filterwarnings("ignore:.*Fresnel")
def test_comparison_in_colour(red_green: Path, tmp_path: Path) -> None:
    """From the command to the page: the better filters win, with the white of the chart, pictures
    in colour, and their matrices.
    """
    for name, more in (("quiet", {}), ("noisy", {"read_noise_e": 60.0})):
        pixel = {
            "technology": "4t-bsi",
            "pitch_um": 2.0,
            "black_level_dn": 64,
            "colour": CAMERA,
        } | more
        text = f"camera = {{ die_mm = 0.2 }}\npixel = {toml_of(pixel)}\n"
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    files = f"{tmp_path / 'quiet.toml'} {tmp_path / 'noisy.toml'}"
    options = (
        "--resolution 64 --display.dots 32 --render-noise 1 --repeats 2 --jobs 1"
        " --exposure.integration-s 0.002 --json"
    )
    code, out, err = command(
        f"compare {files} --scene {red_green} {options} --out", tmp_path / "out"
    )
    assert code == 0, err
    found = json.loads(out)
    assert found["difference"]["noisy"] > 0.3
    for sensor in found["sensors"].values():
        assert sensor["white_spectrum"] == "the scene's own white, of its lamps red, green, blue"
        assert sensor["colour"]["ideal_is_coloured"]
        assert sensor["colour"]["layout"] == "RG/GB"
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    for words in ("noise gains of the matrix", "white, of its lamps red, green, blue"):
        assert words in page
    ideal = np.asarray(Image.open(tmp_path / "out/pictures/ideal_quiet.png"), float)
    assert np.ptp(ideal, axis=2).max() > 60  # of 255: the lowest lines change between red and green
    monochrome = command(
        f"compare {files} 4t-bsi --scene {red_green} {options} --out", tmp_path / "mixed"
    )
    assert monochrome[0] == 2
    assert (
        "4t-bsi without colour filters and quiet, noisy with them, in a coloured scene"
        in monochrome[2]
    )


def test_run_in_colour_writes_coloured_pictures(tmp_path: Path) -> None:
    options = (
        "--pixel.technology 4t-bsi --pixel.pitch-um 20 --pixel.colour.matrix RG,GB"
        " --pixel.colour.sensitivities Nikon_D810"
    )
    options += (
        " --pixel.colour.peak-quantum-efficiency 0.5 --display.dots 64 --resolution 48"
        " --render-noise 1e4"
    )
    options += " --develop.demosaic malvar2004 --variant scalar_spectral --json"
    code, out, err = command(f"run macbeth {options} --out", tmp_path / "run")
    assert code == 0, err
    assert '"layout": "RG/GB"' in out
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "RG/GB" in page
    assert "sensitivity metamerism index under this lamp" in page
    for name in ("ideal.png", "image.png"):
        codes = np.asarray(Image.open(tmp_path / "run" / name), float)
        assert codes.shape[2] == 3
        red = codes[
            int(0.62 * len(codes)), int(0.42 * codes.shape[1])
        ]  # the third patch of the third row
        assert red[0] > 2 * max(red[1:])
