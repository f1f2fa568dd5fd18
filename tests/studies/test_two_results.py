"""Two results that exist: their frames are paired, or it is said what differs."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiny import TINY, rows, tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.files import FILE_LIST
from pixsim.studies.table import ROWS_FILE

SMALL: dict[str, Any] = {"resolution": 48, "display": {"dots": 48}, "repeats": 3}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs of a quiet sensor, of a noisy one, and of other random numbers; and two studies."""
    above = tmp_path_factory.mktemp("results")
    dim = {"luminance_cd_per_m2": 1.0}
    for name, more in {
        "quiet": {"pixel": {"pitch_um": 20.0}},
        "noisy": {"pixel": {"pitch_um": 20.0, "read_noise_e": 9000.0}},
        "other": {"pixel": {"pitch_um": 20.0}, "seed": 9},
    }.items():
        pixsim.write_report(
            pixsim.run("csf", parameters=dim, camera={"die_mm": 1.28}, **SMALL, **more),
            above / name,
        )
    for name, more in {"study": {}, "noisier": {"pixel": {"read_noise_e": 400.0}}}.items():
        result = pixsim.study(tiny(**more), above / name, jobs=1)
        pixsim.write_report(result, above / name)
    return {path.name: path for path in above.iterdir()}


def test_a_run_writes_the_row_of_each_sensor(folders: dict[str, Path]) -> None:
    score = json.loads((folders["quiet"] / "score.json").read_text(encoding="utf-8"))
    assert [float(row["mean_delta_e"]) for row in rows(folders["quiet"])] == score["delta_e"]


def test_a_run_does_not_replace_the_rows_of_a_study(tmp_path: Path) -> None:
    """Nor where the folder's list has results.csv of an earlier run; a run replaces its own
    rows.
    """
    run = pixsim.run("csf", pixel={"pitch_um": 20.0}, camera={"die_mm": 1.28}, **SMALL)
    for _ in range(2):
        run.write(tmp_path)
    of_run = (tmp_path / ROWS_FILE).read_bytes()
    study = pixsim.study(tiny(), tmp_path, jobs=1)
    study.write(tmp_path)
    of_study = (tmp_path / ROWS_FILE).read_bytes()
    with pytest.raises(PixsimError, match=r"holds results\.csv, not written by this command"):
        run.write(tmp_path)
    assert ((tmp_path / ROWS_FILE).read_bytes(), (tmp_path / f"{ROWS_FILE}.old").read_bytes()) == (
        of_study,
        of_run,
    )


def test_runs_of_one_light_are_paired_frame_by_frame(folders: dict[str, Path]) -> None:
    result = pixsim.compare_results(folders["quiet"], folders["noisy"])
    (of_delta_e,) = [each for each in result.differences if each.pairs.metric.is_delta_e]
    values = [
        [float(row["mean_delta_e"]) for row in rows(folders[name])] for name in ("quiet", "noisy")
    ]
    np.testing.assert_array_equal(of_delta_e.pairs.differences, np.subtract(values[1], values[0]))
    assert of_delta_e.pairs.sign() == 1, "the quiet one is better"
    assert result.as_dict()["verdicts"][0].startswith("quiet is better than noisy by ")
    assert result.only_in_one == 0
    errors = [
        json.loads((folders[name] / "score.json").read_text(encoding="utf-8"))["film"]["delta_e"]
        for name in ("quiet", "noisy")
    ]
    assert result.film_delta_e == (None if None in errors else sum(errors))
    code, out, _ = command("compare --json", folders["quiet"], folders["noisy"])
    assert (code, json.loads(out)["differences"]) == (
        0,
        json.loads(json.dumps(result.as_dict()))["differences"],
    )


def test_errors_of_both_films_are_part_of_the_error_of_a_difference(
    folders: dict[str, Path],
) -> None:
    result = pixsim.compare_results(folders["quiet"], folders["noisy"])
    wide = replace(
        result, a=replace(result.a, film_delta_e=100.0), b=replace(result.b, film_delta_e=200.0)
    )
    assert wide.film_delta_e == 300.0, "the limit of a difference is the sum of both limits"
    assert wide.as_dict()["verdicts"][0].startswith("quiet and noisy cannot be told apart")


def test_comparison_of_two_results_is_written_where_a_folder_is_named(
    folders: dict[str, Path], tmp_path: Path
) -> None:
    code, out, _ = command("compare --out", tmp_path / "out", folders["quiet"], folders["noisy"])
    assert (code, out.splitlines()[-1]) == (0, f"report: {tmp_path / 'out' / 'report.html'}")
    summary = json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))
    assert summary["verdicts"][0] == out.splitlines()[0]
    assert summary["verdicts"][0] in html.unescape(
        (tmp_path / "out/report.html").read_text(encoding="utf-8")
    )


def test_studies_are_paired_at_each_size(folders: dict[str, Path]) -> None:
    result = pixsim.compare_results(folders["study"], folders["noisier"])
    assert [each.place["pitch_um"] for each in result.differences] == TINY["pitch"]["values_um"]
    assert all(each.pairs.a.size == 2 for each in result.differences)
    assert result.to_csv().count("\n") == 1 + len(result.differences)


@pytest.mark.parametrize(
    ("a", "b", "texts"),
    [
        (
            "quiet",
            "other",
            ["random streams (('evaluate', 0) and ('evaluate', 9))", "light's seed"],
        ),
        ("quiet", "study", ["a run and a study", "one kind"]),
    ],
)
def test_what_differs_is_said(a: str, b: str, texts: list[str], folders: dict[str, Path]) -> None:
    with pytest.raises(PixsimError) as error:
        pixsim.compare_results(folders[a], folders[b])
    assert not [text for text in texts if text not in str(error.value)], str(error.value)


def test_a_folder_of_another_version_is_named_as_such(
    folders: dict[str, Path], tmp_path: Path
) -> None:
    for path in folders["quiet"].iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    provenance = json.loads((tmp_path / FILE_LIST).read_text(encoding="utf-8"))
    provenance["versions"]["pixsim"] = "1.0.3"
    (tmp_path / FILE_LIST).write_text(json.dumps(provenance), encoding="utf-8")
    assert_refused(
        *command("compare", folders["quiet"], tmp_path),
        [f"'{tmp_path}', of pixsim 1.0.3", "Make it again"],
    )
    (tmp_path / FILE_LIST).write_bytes((folders["quiet"] / FILE_LIST).read_bytes())
    rows = (tmp_path / "results.csv").read_text(encoding="utf-8")
    (tmp_path / "results.csv").write_text(rows.replace(",0,", ",3,", 1), encoding="utf-8")
    assert_refused(
        *command("compare", folders["quiet"], tmp_path),
        ["with a row that changed after pixsim wrote it", "Make it again"],
    )
    (tmp_path / "results.csv").unlink()
    assert_refused(*command("compare", folders["quiet"], tmp_path), ["without results.csv"])
    (tmp_path / "score.json").unlink()
    assert_refused(
        *command("compare", folders["quiet"], tmp_path),
        ["without score.json, summary.json, compare.json"],
    )


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        (
            "score.json",
            b"[1]",
            (
                "score.json', which is damaged; allowed: the file of a run as pixsim wrote it. Make"
                " it again"
            ),
        ),
        ("score.json", b"{}", "score.json', which is damaged"),
        ("score.json", b"{", "score.json', which is damaged"),
        (
            "results.csv",
            b"key,technology,pitch_um\n\xff\n",
            "results.csv' ('utf-8' codec can't decode byte 0xff",
        ),
    ],
)
def test_a_damaged_file_of_a_result_is_named(
    name: str, content: bytes, text: str, folders: dict[str, Path], tmp_path: Path
) -> None:
    for path in folders["quiet"].iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PixsimError, match=re.escape(text)):
        pixsim.compare_results(folders["quiet"], tmp_path)
