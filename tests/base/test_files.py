"""Output folders: a command replaces and removes only what pixsim wrote."""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path

import pytest

from pixsim.base.errors import PixsimError
from pixsim.base.files import (
    FILE_LIST,
    FILE_LIST_OF_1_1,
    UNCHANGED_NS,
    check_replaceable,
    digest_of,
    publishing,
    read_file_list,
)


def publish(folder: Path, **texts: str) -> None:
    """Publish files `name`.txt; an underscore in a name is a folder."""
    with publishing(folder) as unfinished:
        for name, text in texts.items():
            path = unfinished / f"{name.replace('_', '/')}.txt"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != FILE_LIST)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def test_publishing_again_replaces_files_of_pixsim_and_leaves_all_others(tmp_path: Path) -> None:
    """Also those that a user has changed; files of an earlier command stay, and are known."""
    (tmp_path / "mine.txt").write_text("mine")
    publish(tmp_path, a="1", figures_b="2", figures_c="3")
    assert contents(tmp_path) == {
        "mine.txt": "mine",
        "a.txt": "1",
        "figures/b.txt": "2",
        "figures/c.txt": "3",
    }
    (tmp_path / "a.txt").write_text("9")
    publish(tmp_path, a="4", figures_b="2")
    assert contents(tmp_path) == {
        "mine.txt": "mine",
        "a.txt": "4",
        "figures/b.txt": "2",
        "figures/c.txt": "3",
    }
    (tmp_path / "figures/b.txt").unlink()
    publish(tmp_path, d="5")
    assert read_file_list(tmp_path)["files"] == ["a.txt", "d.txt", "figures/c.txt"]


@pytest.mark.parametrize(
    "change", ["not listed", "folder", "dangling link", "foreign list", "no list"]
)
def test_check_replaceable_file_of_another_program_raises(change: str, tmp_path: Path) -> None:
    """Also at the end of a command, before anything is moved: a file may have come meanwhile."""
    publish(tmp_path, a="1", b="2")
    path = tmp_path / "a.txt"
    if change == "not listed":
        (tmp_path / "c.txt").write_text("9")
    elif change in ("folder", "dangling link"):
        path.unlink()
        path.mkdir() if change == "folder" else path.symlink_to(tmp_path / "gone")
    elif change == "foreign list":
        (tmp_path / FILE_LIST).write_text('{"files": ["a.txt"]}')
    else:
        (tmp_path / FILE_LIST).unlink()
    before = sorted(
        (path.name, path.is_file() and path.read_bytes()) for path in tmp_path.iterdir()
    )
    named = {"foreign list": FILE_LIST, "not listed": "c.txt"}.get(change, "a.txt")
    with pytest.raises(PixsimError, match=rf"holds .*{named}.*Choose another with --out"):
        check_replaceable(tmp_path, ["a.txt", "c.txt"])
    with pytest.raises(PixsimError, match=named):
        publish(tmp_path, a="new", c="new")
    assert (
        sorted((path.name, path.is_file() and path.read_bytes()) for path in tmp_path.iterdir())
        == before
    )


def test_files_of_a_folder_of_release_1_1_are_replaced(tmp_path: Path) -> None:
    """Its list is provenance.json, with digests."""
    (tmp_path / "a.txt").write_text("of 1.1")
    listing = {
        "schema": 1,
        "versions": {"pixsim": "1.1.0"},
        "files": {"a.txt": {"command": "run", "digests": ["0" * 32]}},
    }
    (tmp_path / FILE_LIST_OF_1_1).write_text(json.dumps(listing))
    publish(tmp_path, a="new")
    assert contents(tmp_path)["a.txt"] == "new"
    (tmp_path / "b.txt").write_text("mine")
    with pytest.raises(PixsimError, match=r"holds b\.txt, not written by this command"):
        publish(tmp_path, b="new")


def test_publishing_killed_between_moves_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever of the files are moved, the same command may go on."""
    publish(tmp_path, a="1", b="2")
    replace, moves = os.replace, []

    def fails(path: Path, target: str | Path, **options: int) -> None:
        if str(target).endswith(".txt"):
            moves.append(target)
            if len(moves) == 2:
                raise KeyboardInterrupt
        replace(path, target, **options)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fails)
        with pytest.raises(KeyboardInterrupt):
            publish(tmp_path, a="3", b="4", c="5")
    assert contents(tmp_path) == {"a.txt": "3", "b.txt": "2"}
    check_replaceable(tmp_path, ["a.txt", "b.txt", "c.txt"])
    publish(tmp_path, a="5", b="6", c="7")
    assert contents(tmp_path) == {"a.txt": "5", "b.txt": "6", "c.txt": "7"}


def test_publishing_failure_leaves_folder_unchanged(tmp_path: Path) -> None:
    publish(tmp_path, a="1")
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    with pytest.raises(KeyboardInterrupt), publishing(tmp_path) as unfinished:
        raise KeyboardInterrupt(unfinished.joinpath("a.txt").write_text("2"))
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before


@pytest.mark.parametrize("age", ["new", "settled"])
def test_digest_of_sees_each_change(
    age: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a file of the same size at the same place, whose digest was taken before."""
    path = tmp_path / "a.txt"
    now_ns = time.time_ns() + (3 * UNCHANGED_NS if age == "settled" else 0)
    monkeypatch.setattr("pixsim.base.files.time.time_ns", lambda: now_ns)
    digests = []
    for text in ("one", "two", "one"):
        path.write_text(text)
        if age == "settled":  # long after the last change, so at another time
            os.utime(path, ns=(now_ns - 2 * UNCHANGED_NS + len(digests),) * 2)
        digests += [digest_of(path), digest_of(path)]
    assert digests[0] == digests[1] == digests[4] == digests[5] != digests[2] == digests[3]
    assert digests[0] == hashlib.blake2b(b"one", digest_size=16).hexdigest()
