"""Output folders: a command replaces and removes only what pixsim wrote."""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path

import pytest

from pixsim.base.errors import PixsimError
from pixsim.base.files import PROVENANCE, SETTLED_NS, check_replaceable, digest_of, listed_files, publishing


def publish(folder: Path, command: str = "run", keep: Path | None = None, **texts: str) -> None:
    """Publish files `name`.txt; an underscore in a name is a folder."""
    with publishing(folder, command, keep=[keep] if keep else []) as unfinished:
        for name, text in texts.items():
            path = unfinished / f"{name.replace('_', '/')}.txt"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != PROVENANCE)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def test_publishing_again_replaces_own_files_and_removes_stale_ones(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    publish(tmp_path, a="1", figures_b="2", figures_c="3")
    assert contents(tmp_path) == {"mine.txt": "mine", "a.txt": "1", "figures/b.txt": "2", "figures/c.txt": "3"}
    publish(tmp_path, a="4", figures_b="2")
    assert contents(tmp_path) == {"mine.txt": "mine", "a.txt": "4", "figures/b.txt": "2"}
    publish(tmp_path, a="4")
    assert {path.name for path in tmp_path.iterdir()} == {"mine.txt", "a.txt", PROVENANCE}, "and the empty folder"


@pytest.mark.parametrize("change", ["replaced", "folder", "dangling link", "foreign provenance", "no provenance"])
def test_check_replaceable_file_of_another_program_raises(change: str, tmp_path: Path) -> None:
    """Also at the end of a command, before anything is moved: a file may have come meanwhile."""
    publish(tmp_path, a="1", b="2")
    path = tmp_path / "a.txt"
    if change == "replaced":
        path.write_text("9")  # of the same size
    elif change in ("folder", "dangling link"):
        path.unlink()
        path.mkdir() if change == "folder" else path.symlink_to(tmp_path / "gone")
    elif change == "foreign provenance":
        (tmp_path / PROVENANCE).write_text('{"files": {"a.txt": 1}}')
    else:
        (tmp_path / PROVENANCE).unlink()
    before = sorted((path.name, path.is_file() and path.read_bytes()) for path in tmp_path.iterdir())
    named = PROVENANCE if change == "foreign provenance" else "a.txt"
    with pytest.raises(PixsimError, match=rf"holds .*{named}.*Choose another with --out"):
        check_replaceable(tmp_path, ["a.txt", "c.txt"])
    with pytest.raises(PixsimError, match=named):
        publish(tmp_path, a="new", b="new")
    assert sorted((path.name, path.is_file() and path.read_bytes()) for path in tmp_path.iterdir()) == before


def test_check_replaceable_own_or_missing_files_pass(tmp_path: Path) -> None:
    check_replaceable(tmp_path / "none", ["a.txt"])
    (tmp_path / "mine.txt").write_text("mine")
    check_replaceable(tmp_path, ["a.txt"])
    publish(tmp_path, a="1")
    check_replaceable(tmp_path, ["a.txt"])


def test_publishing_changed_stale_file_stays(tmp_path: Path) -> None:
    publish(tmp_path, a="1", b="2")
    (tmp_path / "b.txt").write_text("edited by the user")
    publish(tmp_path, a="3")
    assert contents(tmp_path) == {"a.txt": "3", "b.txt": "edited by the user"}


def test_publishing_other_command_leaves_files_and_knows_them(tmp_path: Path) -> None:
    publish(tmp_path, "run", a="1", b="2")
    publish(tmp_path, "sfr", c="3")
    assert contents(tmp_path) == {"a.txt": "1", "b.txt": "2", "c.txt": "3"}
    publish(tmp_path, "run", a="4")
    assert contents(tmp_path) == {"a.txt": "4", "c.txt": "3"}


def test_publishing_kept_file_stays_listed(tmp_path: Path) -> None:
    """A picture that a run reads may lie in the run's own folder."""
    publish(tmp_path, a="1", b="2")
    publish(tmp_path, keep=tmp_path / "b.txt", a="3")
    assert contents(tmp_path) == {"a.txt": "3", "b.txt": "2"}
    publish(tmp_path, a="3")
    assert contents(tmp_path) == {"a.txt": "3"}


def test_publishing_names_outside_folder_are_never_touched(tmp_path: Path) -> None:
    """A provenance file may come from elsewhere."""
    outside, folder = tmp_path / "outside", tmp_path / "folder"
    for path in (outside, folder):
        path.mkdir()
    publish(outside, a="1")
    (folder / "link").symlink_to(outside)
    entry = listed_files(outside)
    assert entry
    names = ["../outside/a.txt", str(outside / "a.txt"), "link/a.txt", "", "a\0b"]
    listing = {"versions": {"pixsim": "0"}, "files": dict.fromkeys(names, entry["a.txt"])}
    (folder / PROVENANCE).write_text(json.dumps(listing))
    assert listed_files(folder) == {}
    publish(folder, b="2")
    assert contents(outside) == {"a.txt": "1"}


def test_publishing_killed_between_moves_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
            publish(tmp_path, a="3", b="4")
    assert contents(tmp_path) == {"a.txt": "3", "b.txt": "2"}
    check_replaceable(tmp_path, ["a.txt", "b.txt"])
    publish(tmp_path, a="5", b="6")
    assert contents(tmp_path) == {"a.txt": "5", "b.txt": "6"}


def test_publishing_failure_leaves_folder_unchanged(tmp_path: Path) -> None:
    publish(tmp_path, a="1")
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    with pytest.raises(KeyboardInterrupt), publishing(tmp_path, "run") as unfinished:
        raise KeyboardInterrupt(unfinished.joinpath("a.txt").write_text("2"))
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before


@pytest.mark.parametrize("age", ["new", "settled"])
def test_digest_of_sees_each_change(age: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a file of the same size at the same place, whose digest was taken before."""
    path = tmp_path / "a.txt"
    now_ns = time.time_ns() + (3 * SETTLED_NS if age == "settled" else 0)
    monkeypatch.setattr("pixsim.base.files.time.time_ns", lambda: now_ns)
    found = []
    for text in ("one", "two", "one"):
        path.write_text(text)
        if age == "settled":  # long after the last change, so at another time
            os.utime(path, ns=(now_ns - 2 * SETTLED_NS + len(found),) * 2)
        found += [digest_of(path), digest_of(path)]
    assert found[0] == found[1] == found[4] == found[5] != found[2] == found[3]
    assert found[0] == hashlib.blake2b(b"one", digest_size=16).hexdigest()


def test_digest_of_unchanged_file_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    path.write_text("one")
    first = digest_of(path, alone=True)
    monkeypatch.setattr("pixsim.base.files.DIGEST_BLOCK", 0)  # nothing can be read
    assert digest_of(path, alone=True) == first
    assert digest_of(path) != first, "it may have been changed since, within a step of the clock"
