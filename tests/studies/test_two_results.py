"""Two results that exist: their frames are paired, or it is said what differs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
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


def test_a_run_does_not_replace_the_rows_of_a_study(tmp_path: Path) -> None:
    """Nor where the folder's list has results.csv of an earlier run; a run replaces its own
    rows.
    """
    run = pixsim.run("csf", pixel={"pitch_um": 20.0}, camera={"die_mm": 1.28}, **SMALL)
    for _ in range(2):
        run.write(tmp_path)
    run_rows = (tmp_path / ROWS_FILE).read_bytes()
    study = pixsim.study(tiny(), tmp_path, jobs=1)
    study.write(tmp_path)
    study_rows = (tmp_path / ROWS_FILE).read_bytes()
    with pytest.raises(PixsimError, match=r"holds results\.csv, not written by this command"):
        run.write(tmp_path)
    assert ((tmp_path / ROWS_FILE).read_bytes(), (tmp_path / f"{ROWS_FILE}.old").read_bytes()) == (
        study_rows,
        run_rows,
    )


def test_runs_of_one_light_are_paired_frame_by_frame(
    folders: dict[str, Path], tmp_path: Path
) -> None:
    """In Python and by the command, which writes a report where a folder is named."""
    names = ("quiet", "noisy")
    result = pixsim.compare_results(*(folders[name] for name in names))
    (delta_e,) = [each.pairs for each in result.differences if each.pairs.metric.is_delta_e]
    values = [[float(row["mean_delta_e"]) for row in rows(folders[name])] for name in names]
    np.testing.assert_array_equal(delta_e.differences, np.subtract(values[1], values[0]))
    assert delta_e.sign() == 1, "the quiet one is better"
    paths = [folders[name] for name in names]
    _, out, _ = command("compare --json --out", tmp_path / "out", *paths)
    expected = json.loads(json.dumps(result.as_dict()))["differences"]
    assert json.loads(out)["differences"] == expected
    summary = json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))
    assert summary["verdicts"] == result.as_dict()["verdicts"]


def test_errors_of_both_films_are_part_of_the_error_of_a_difference(
    folders: dict[str, Path],
) -> None:
    """The limit of a difference is the sum of both limits."""
    result = pixsim.compare_results(folders["quiet"], folders["noisy"])
    a = replace(result.a, film_delta_e=100.0)
    wide = replace(result, a=a, b=replace(result.b, film_delta_e=200.0))
    assert wide.film_delta_e == 300.0
    assert "cannot be told apart" in wide.as_dict()["verdicts"][0]


def test_studies_are_paired_at_each_size(folders: dict[str, Path]) -> None:
    result = pixsim.compare_results(folders["study"], folders["noisier"])
    assert [each.place["pitch_um"] for each in result.differences] == TINY["pitch"]["values_um"]
    assert {each.pairs.a.size for each in result.differences} == {2}
    assert result.to_csv().count("\n") == 1 + len(result.differences)


def version(folder: Path) -> None:
    files = json.loads((folder / FILE_LIST).read_text(encoding="utf-8"))
    files["versions"]["pixsim"] = "1.0.3"
    (folder / FILE_LIST).write_text(json.dumps(files), encoding="utf-8")


def edit(folder: Path) -> None:
    text = (folder / ROWS_FILE).read_text(encoding="utf-8")
    (folder / ROWS_FILE).write_text(text.replace(",0,", ",3,", 1), encoding="utf-8")


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "another version": (version, "pixsim 1.0.3"),
    "an edited row": (edit, "a row that changed"),
    "no rows": (lambda folder: (folder / ROWS_FILE).unlink(), "without results.csv"),
    "no score": (lambda folder: (folder / "score.json").unlink(), "without score.json"),
    "a list": (lambda folder: (folder / "score.json").write_bytes(b"[1]"), "damaged"),
    "an empty score": (lambda folder: (folder / "score.json").write_bytes(b"{}"), "damaged"),
    "half a score": (lambda folder: (folder / "score.json").write_bytes(b"{"), "damaged"),
    "no text": (lambda folder: (folder / ROWS_FILE).write_bytes(b"key,a\n\xff\n"), "0xff"),
}


@pytest.mark.parametrize(("damage", "text"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_result_is_named(
    damage: Callable[[Path], object], text: str, folders: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copytree(folders["quiet"], tmp_path, dirs_exist_ok=True)
    damage(tmp_path)
    with pytest.raises(PixsimError, match=text):
        pixsim.compare_results(folders["quiet"], tmp_path)


@pytest.mark.parametrize(
    ("name", "text"), [("other", "random streams"), ("study", "a run and a study")]
)
def test_results_without_pairs_are_refused(name: str, text: str, folders: dict[str, Path]) -> None:
    with pytest.raises(PixsimError, match=text):
        pixsim.compare_results(folders["quiet"], folders[name])
