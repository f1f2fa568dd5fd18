"""What is kept is what was made, whatever happened to the file in between."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import warnings
from pathlib import Path

import pytest

from pixsim import cache


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "kept"))
    return tmp_path / "kept"


def read(values: dict) -> dict:
    return {"number": float(values["number"])}


def kept(number: float = 1.0, key: str = "key") -> tuple[dict, int]:
    """What comes back, and how often it was made."""
    made = []

    def make() -> dict:
        made.append(1)
        return {"number": number}

    return cache.kept("kind", key, read, make, dict), len(made)


def test_made_once(folder):
    assert kept(1.5) == ({"number": 1.5}, 1)
    assert kept(2.5) == ({"number": 1.5}, 0)
    assert kept(2.5, "other") == ({"number": 2.5}, 1)
    assert sorted(path.name for path in (folder / "kind").iterdir()) == ["key.json", "other.json"]


@pytest.mark.parametrize(
    "text", ["", '{"number": 1', "[]", "3", "null", '{"other": 1}', '{"number": "many"}', '{"number": null}', "\x00"]
)
def test_a_damaged_entry_is_made_again_with_a_warning(folder, text):
    kept(1.5)
    (folder / "kind/key.json").write_text(text, encoding="utf-8")
    with pytest.warns(UserWarning, match="damaged"):
        assert kept(2.5) == ({"number": 2.5}, 1)
    assert kept(3.5) == ({"number": 2.5}, 0)


def test_bytes_that_are_no_text(folder):
    kept(1.5)
    (folder / "kind/key.json").write_bytes(b"\xff\xfe\x80")
    with pytest.warns(UserWarning, match="damaged"):
        assert kept(2.5) == ({"number": 2.5}, 1)


def test_nan_comes_back(folder):
    kept(math.nan)
    found, made = kept(1.0)
    assert math.isnan(found["number"])
    assert made == 0


def test_a_folder_that_cannot_be_written_is_one_warning_and_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "file"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert kept(1.5) == ({"number": 1.5}, 1)
    assert [cache.FOLDER_VARIABLE in str(each.message) for each in caught] == [True]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder(folder):
    folder.mkdir()
    folder.chmod(0o500)
    with pytest.warns(UserWarning, match="cannot be written"):
        assert kept(1.5) == ({"number": 1.5}, 1)


def test_what_cannot_be_made_leaves_nothing(folder):
    def fail() -> dict:
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        cache.kept("kind", "key", read, fail, dict)
    assert not list(folder.rglob("*"))


def write_many(name: str, barrier) -> int:
    os.environ[cache.FOLDER_VARIABLE] = name
    warnings.simplefilter("error")
    barrier.wait()
    for number in range(40):
        made, _ = kept(float(number), f"key{number}")
        assert made == {"number": float(number)}
    return 0


def test_two_processes_may_write_the_same_entries(folder):
    context = multiprocessing.get_context("fork")
    barrier = context.Barrier(2)
    processes = [context.Process(target=write_many, args=(str(folder), barrier)) for _ in range(2)]
    for each in processes:
        each.start()
    for each in processes:
        each.join(30)
    assert [each.exitcode for each in processes] == [0, 0]
    for number in range(40):
        assert json.loads((folder / f"kind/key{number}.json").read_text(encoding="utf-8")) == {"number": number}


def test_the_folder_is_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.delenv(cache.FOLDER_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "pixsim"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache.folder() == tmp_path / "home/.cache/pixsim"
