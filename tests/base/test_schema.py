"""The schema of files of results: each states it, and readers say what they do with files of
another one.
"""

from __future__ import annotations

import json
import warnings

import pytest

from pixsim.base.errors import PixsimError
from pixsim.base.files import FILE_LIST, check_replaceable, publishing, write_json
from pixsim.base.schema import KEY, SCHEMA, json_text
from pixsim.base.toml import SETTINGS_HEAD, read_toml, settings_table_text
from pixsim.studies.table import CHECK, COLUMNS, Store


def row(number: int) -> dict[str, str]:
    return {"key": f"key{number}", "technology": "0.35um"} | dict.fromkeys(COLUMNS[2:], "1.5")


def test_json_files_state_the_schema(tmp_path):
    write_json(tmp_path / "score.json", {"mean_delta_e": 1.5})
    assert json.loads((tmp_path / "score.json").read_text()) == {KEY: SCHEMA, "mean_delta_e": 1.5}
    assert KEY not in json.loads(json_text({"$schema": "https://json-schema.org/draft/2020-12"}))


def test_rows_without_a_check_are_kept_apart_and_computed_again(tmp_path):
    """As those of release 1.1, whose rows ended with the last metric. Keys tell rows of other
    versions that have a check.
    """
    results = Store(tmp_path / "results.csv")
    results.write(row(number).values() for number in range(3))
    lines = [line.rsplit(",", 2)[0] for line in results.path.read_text().splitlines()]
    results.path.write_text("\n".join(lines) + "\n")
    before = results.path.read_bytes()
    with pytest.warns(
        UserWarning, match=r"of another version of pixsim.*results.csv.old.*computed again"
    ):
        assert results.resume(lambda row: True) == []
    assert (tmp_path / "results.csv.old").read_bytes() == before
    assert results.path.read_text().splitlines() == [",".join([*COLUMNS, KEY, CHECK])]


def test_rows_of_this_schema_are_resumed_without_a_word(tmp_path):
    results = Store(tmp_path / "results.csv", ["lens"])
    rows = [row(number) | {"lens": "f/4"} for number in range(3)]
    results.write([values[name] for name in results.columns] for values in rows)
    before = results.path.read_bytes()
    with warnings.catch_warnings(action="error"):
        assert list(results.resume(lambda row: True)) == ["key0", "key1", "key2"]
    assert results.path.read_bytes() == before


def test_settings_of_a_newer_schema_are_refused(tmp_path):
    path = tmp_path / "settings.toml"
    text = settings_table_text({"camera": {"f_number": 4.0}}, "pixsim run csf")
    path.write_text(text)
    assert read_toml(path) == {"camera": {"f_number": 4.0}}
    head = f"{SETTINGS_HEAD}, {KEY} "
    path.write_text(text.replace(f"{head}{SCHEMA}", f"{head}{SCHEMA + 1}"))
    with pytest.raises(PixsimError, match=f"schema {SCHEMA + 1}; allowed: up to {SCHEMA}"):
        read_toml(path)


@pytest.mark.parametrize("stated", [SCHEMA + 1, 0, True, "one", 1.5, [1]])
def test_folder_of_a_newer_version_is_refused(tmp_path, stated):
    with publishing(tmp_path) as folder:
        (folder / "a.txt").write_text("a")
    check_replaceable(tmp_path, ["a.txt"])
    content = json.loads((tmp_path / FILE_LIST).read_text())
    (tmp_path / FILE_LIST).write_text(json.dumps(content | {KEY: stated}))
    with pytest.raises(PixsimError, match=r"output folder.*schema.*Take the version of pixsim"):
        check_replaceable(tmp_path, ["a.txt"])
