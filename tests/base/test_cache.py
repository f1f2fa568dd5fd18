"""The cache returns what was stored, or computes it again."""

from __future__ import annotations

import errno
import json
import math
import multiprocessing
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.processes import HANG_S

from pixsim.base import cache
from pixsim.base.files import FOLDER_VARIABLE, private_folder
from pixsim.base.locks import UNFINISHED, unfinished
from pixsim.scene import charts

NOT_ROOT = pytest.mark.skipif(os.geteuid() == 0, reason="root can write to any folder")


@pytest.fixture
def small(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(8 / 1024))  # 8 MiB
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def read(values: dict) -> dict:
    return {"number": float(values["number"])}


def cached(number: float = 1.0, key: str = "key") -> tuple[dict, int]:
    """The result of `load_or_compute`, and the number of computations."""
    compute = Mock(return_value={"number": number})
    return cache.load_or_compute("kind", key, read, compute, dict), compute.call_count


def test_load_or_compute_computes_once(folder):
    assert cached(1.5) == ({"number": 1.5}, 1)
    assert cached(2.5) == ({"number": 1.5}, 0)
    assert cached(2.5, "other") == ({"number": 2.5}, 1)
    assert [str(cached(math.nan, "nan")) for _ in range(2)] == [
        "({'number': nan}, 1)",
        "({'number': nan}, 0)",
    ]
    assert sorted(path.name for path in (folder / "kind").iterdir()) == [
        "key.json",
        "nan.json",
        "other.json",
    ]


@pytest.mark.parametrize(
    "content",
    [
        *(
            b"",
            b'{"number": 1',
            b"[]",
            b"3",
            b"null",
            b'{"other": 1}',
            b'{"number": "many"}',
            b'{"number": null}',
            b"\x00",
        ),
        *(b"\xff\xfe\x80", b"[" * 100_000, b"[1]", b"NaN", b"9" * 10_000),
    ],
    ids=lambda content: repr(content[:20]),
)
def test_load_or_compute_damaged_entry_warns_and_recomputes(folder, content):
    cached(1.5)
    (folder / "kind/key.json").write_bytes(content)
    with pytest.warns(UserWarning, match="damaged"):
        assert cached(2.5) == ({"number": 2.5}, 1)
    assert cached(3.5) == ({"number": 2.5}, 0)


@pytest.mark.parametrize("is_file", [True, pytest.param(False, marks=NOT_ROOT)])
def test_load_or_compute_unwritable_folder_warns_once(folder, is_file):
    folder.touch() if is_file else folder.mkdir(0o500)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert cached(1.5) == ({"number": 1.5}, 1)
    (warning,) = caught
    assert re.search(rf"cannot be written .*set {FOLDER_VARIABLE}", str(warning.message))


def test_load_or_compute_failure_leaves_no_file(folder):
    with pytest.raises(ValueError, match="no result"):
        cache.load_or_compute("kind", "key", read, Mock(side_effect=ValueError("no result")), dict)
    assert not list(folder.rglob("*"))


def write_many(name: str, barrier) -> int:
    os.environ[FOLDER_VARIABLE] = name
    warnings.simplefilter("error")
    barrier.wait()
    for number in range(40):
        assert cached(float(number), f"key{number}")[0] == {"number": float(number)}
    return 0


def test_load_or_compute_two_processes_share_entries(folder):
    context = multiprocessing.get_context("fork")
    barrier = context.Barrier(2)
    processes = [context.Process(target=write_many, args=(str(folder), barrier)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(HANG_S)
    assert [process.exitcode for process in processes] == [0, 0]
    for number in range(40):
        head, value = (folder / f"kind/key{number}.json").read_text(encoding="utf-8").split("\n")
        assert (head[:-65], json.loads(value)) == (
            f"pixsim cache kind/key{number}",
            {"number": number},
        )


def test_folder_follows_xdg(monkeypatch, tmp_path):
    monkeypatch.delenv(FOLDER_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "pixsim"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache.folder() == tmp_path / "home/.cache/pixsim"


# --- Arrays
# ------------------------------------------------------------------------------------------------------------

CONTENT = {
    "picture": np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    "codes": np.arange(5, dtype=np.uint16),
    "number": np.float64(1 / 3),
}


def assert_is_content(arrays: cache.Arrays | None) -> None:
    assert arrays is not None
    assert arrays.keys() == CONTENT.keys()
    for name, values in CONTENT.items():
        assert arrays[name].dtype == np.asarray(values).dtype
        np.testing.assert_array_equal(arrays[name], values)


def test_arrays_round_trip_is_exact(folder):
    assert cache.arrays("kind", "key") is None
    cache.store_arrays("kind", "key", CONTENT)
    assert_is_content(cache.arrays("kind", "key"))
    assert cache.arrays("kind", "other") is None
    assert [path.name for path in folder.rglob("*.npz")] == ["key.npz"]
    assert not list(folder.rglob(".*")), "partial files"


def test_arrays_damaged_file_is_rejected(folder):
    """Truncated files, and a bit flipped in every third byte."""
    cache.store_arrays("kind", "key", CONTENT)
    path = folder / "kind/key.npz"
    whole = path.read_bytes()
    damaged = [whole[:length] for length in range(0, len(whole), 37)]
    damaged += [
        whole[:at] + bytes([whole[at] ^ (1 << at % 8)]) + whole[at + 1 :]
        for at in range(0, len(whole), 3)
    ]
    for content in damaged:
        path.write_bytes(content)
        with pytest.warns(UserWarning, match="damaged"):
            assert cache.arrays("kind", "key") is None
    cache.store_arrays("kind", "key", CONTENT)
    assert_is_content(cache.arrays("kind", "key"))


def test_texture_with_a_changed_byte_is_written_again(folder):
    """OpenEXR would read most of them without a word."""
    texels = np.linspace(0, 1, 64, dtype=np.float32).reshape(8, 8)
    path = charts.texture_file(["ramp"], lambda: texels)
    whole = path.read_bytes()
    for place in np.random.default_rng(5).integers(0, len(whole), 300).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        assert charts.texture_file(["ramp"], lambda: texels).read_bytes() == whole
    path.with_suffix(".json").unlink()
    make = Mock(return_value=texels)
    charts.texture_file(["ramp"], make)
    assert make.call_count == 1, "without its digest a file is not believed"


def test_clear_skips_files_of_other_users(small, monkeypatch):
    for number in range(12):
        cache.store_arrays("kind", f"{number:02d}", big(1))
    unlink = Path.unlink

    def fail(path: Path, missing_ok: bool = False) -> None:
        if path.name < "08":
            raise PermissionError(13, "Permission denied")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", fail)
    assert cache.clear() > 0
    assert {entry.path.stem for entry in cache.entries()} <= {
        f"{number:02d}" for number in range(8)
    }


def test_clear_keeps_kernels_unless_named(folder):
    cache.store_arrays("kind", "key", CONTENT)
    (folder / "kernels").mkdir()
    kernel, other = folder / f"kernels/{'0a' * 16}.llvm.v6.bin", folder / "kernels/notes.txt"
    for path in (kernel, other):
        path.write_bytes(b"kernel")
    assert [entry.kind for entry in cache.entries()] == ["kind"]
    cache.clear()
    assert kernel.exists()
    assert (cache.clear("kernels"), kernel.exists(), other.exists()) == (6, False, True)


def big(mib: float) -> cache.Arrays:
    return {"zeros": np.zeros(int(mib * 2**20), np.uint8)}


def test_trim_removes_least_recently_used(small):
    for number in range(12):
        cache.store_arrays("kind", f"{number:02d}", big(1))
        os.utime(small / f"kind/{number:02d}.npz", (number, number))
        if number > 0:
            assert cache.arrays("kind", "00") is not None, "just used, but removed"
    cache.trim()
    remaining = [entry.path.stem for entry in cache.entries()]
    assert sum(entry.size_bytes for entry in cache.entries()) <= 8 * 2**20
    assert sorted(remaining) == ["00", "06", "07", "08", "09", "10", "11"], (
        "7 of a little more than 1 MiB fit into 8 MiB"
    )


def test_store_arrays_trims_automatically(small):
    for number in range(40):
        cache.store_arrays("kind", f"{number}", big(1))
        assert sum(entry.size_bytes for entry in cache.entries()) <= 9.5 * 2**20


def test_store_arrays_skips_large_entry(small):
    cache.store_arrays("kind", "small", big(1.9))
    cache.store_arrays("kind", "large", big(2.1))
    assert [entry.path.stem for entry in cache.entries()] == ["small"]


def test_limit_zero_disables_cache(folder, monkeypatch):
    cache.store_arrays("kind", "key", CONTENT)
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    assert cache.arrays("kind", "key") is None
    cache.store_arrays("kind", "other", CONTENT)
    assert cached(1.5) == ({"number": 1.5}, 1)
    assert cached(2.5) == ({"number": 2.5}, 1)
    assert [entry.path.stem for entry in cache.entries()] == ["key"]


def test_trim_removes_partial_files_of_ended_processes(folder):
    cache.store_arrays("kind", "key", CONTENT)
    with unfinished(folder / "kind", is_folder=False) as running:
        for name in (f"{UNFINISHED}0123abcd", ".notes"):
            (folder / "kind" / name).write_bytes(b"half")
        cache.trim()
        assert sorted(path.name for path in (folder / "kind").iterdir()) == sorted(
            [".notes", "key.npz", running.name]
        )
    assert len(cache.entries()) == 1


def add_foreign(kind: Path) -> dict[str, bytes]:
    """Files of a user beside entries, also with their endings; one of them is a copy of an
    entry.
    """
    np.savez(kind / "measured.npz", a=np.ones(3))
    contents = {
        "notes.txt": b"mine",
        "data.json": b'{"a": 1}',
        "chart.exr": b"\x76\x2f\x31\x01mine",
    }
    contents |= {
        "measured.npz": (kind / "measured.npz").read_bytes(),
        "copy.json": (kind / "key.json").read_bytes(),
    }
    for name, content in contents.items():
        (kind / name).write_bytes(content)
        os.utime(kind / name, (1, 1))  # the first ones that would be removed
    return contents


@pytest.mark.parametrize("how", ["clear", "clear kind", "trim"])
def test_only_entries_are_removed(folder, how, monkeypatch, tmp_path):
    """Not what lies beside them, what a link leads to, or what a linked folder holds."""
    cached(1.0)
    cache.store_arrays("other", "key", CONTENT)
    contents = add_foreign(folder / "kind")
    mine = tmp_path / "mine"
    (folder / "kind").rename(mine)  # with an entry, and under the name of its kind
    (folder / "kind").symlink_to(mine)
    (folder / "other/linked.json").symlink_to(mine / "key.json")
    (folder / "other/notes").mkdir()
    if how == "trim":
        monkeypatch.setenv(cache.LIMIT_VARIABLE, "1e-9")
        cache.trim()
    else:
        cache.clear("kind" if how == "clear kind" else None)
    assert {name: (mine / name).read_bytes() for name in contents} == contents
    assert (mine / "key.json").exists()
    assert sorted(path.name for path in (folder / "other").iterdir()) == ["key.npz"] * (
        how == "clear kind"
    ) + ["linked.json", "notes"]


def test_entries_are_removed_beside_other_files(folder):
    cached(1.0)
    contents = add_foreign(folder / "kind")
    assert cache.clear() == len(contents["copy.json"])
    assert sorted(path.name for path in (folder / "kind").iterdir()) == sorted(contents)


def test_a_folder_that_cannot_be_listed_is_passed_over(folder, monkeypatch):
    """It is that of another user who shares the cache, or another process has just removed it; as
    root none is refused.
    """
    cached(1.0)
    cache.store_arrays("theirs", "key", CONTENT)
    listed = Path.iterdir

    def refused(path: Path) -> Iterator[Path]:
        if path.name == "theirs":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", refused)
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "1e-9")
    assert [entry.kind for entry in cache.entries()] == ["kind"]
    assert cache.trim() > 0
    assert (folder / "theirs/key.npz").exists()


@pytest.mark.parametrize(
    "change", ["of another key", "of another kind", "behind a link", "in a linked folder"]
)
def test_only_an_entry_of_its_own_label_is_read(folder, change, tmp_path):
    """A file of another key would be another result in silence; a link may lead to any file."""
    cached(1.0, "other")
    cache.load_or_compute("another", "key", read, lambda: {"number": 2.0}, dict)
    source = folder / {
        "of another key": "kind/other.json",
        "of another kind": "another/key.json",
    }.get(change, "kind/key.json")
    cached(3.0)
    if change == "in a linked folder":
        (folder / "kind").rename(tmp_path / "theirs")
        (folder / "kind").symlink_to(tmp_path / "theirs")
    elif change == "behind a link":
        source.rename(tmp_path / "theirs.json")
        source.symlink_to(tmp_path / "theirs.json")
    else:
        (folder / "kind/key.json").write_bytes(source.read_bytes())
    before = {path: path.read_bytes() for path in tmp_path.rglob("theirs*/*.json")}
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        assert cached(4.0) == ({"number": 4.0}, 1)
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(
    "fault", [None, "can be written by others", "belongs to another user", "is a link or a file"]
)
def test_kernels_are_used_only_from_a_folder_of_ones_own(folder, fault, tmp_path, monkeypatch):
    before = os.umask(0)
    try:
        if fault == "is a link or a file":
            folder.mkdir()
            (tmp_path / "theirs").mkdir()
            (folder / "kernels").symlink_to(tmp_path / "theirs")
        elif fault is not None:
            private_folder("kernels")
        if fault == "can be written by others":
            (folder / "kernels").chmod(0o770)
        elif fault == "belongs to another user" and os.geteuid() == 0:
            os.chown(folder / "kernels", 12345, -1)
        elif fault == "belongs to another user":
            pytest.skip("only root can give a folder away")
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = private_folder("kernels")
    finally:
        os.umask(before)
    assert ["not a folder that only you can write" in str(warning.message) for warning in told] == [
        True
    ] * (fault is not None)
    assert (found == folder / "kernels") == (fault is None)
    assert (found.stat().st_mode & 0o777, found.stat().st_uid) == (0o700, os.geteuid())


def test_version_fingerprint_depends_on_sources(monkeypatch, tmp_path):
    package = tmp_path / "pixsim"
    (package / "data").mkdir(parents=True)
    monkeypatch.setattr(cache, "PACKAGE", package)

    def fingerprint() -> str:
        cache.version_fingerprint.cache_clear()
        cache._digest_of_sources.cache_clear()
        return cache.version_fingerprint()

    fingerprints = []
    for name, text in (
        ("__init__.py", "a"),
        ("__init__.py", "b"),
        ("data/t.toml", "a"),
        ("data/q.csv", "1"),
        ("notes.txt", ""),
    ):
        (package / name).write_text(text, encoding="utf-8")
        fingerprints.append(fingerprint())
    assert len(set(fingerprints[:4])) == 4
    assert fingerprints[4] == fingerprints[3], "a text file is not a source"
    monkeypatch.setattr(cache, "VERSION", "99")
    assert fingerprint() not in fingerprints
    cache.version_fingerprint.cache_clear()
    cache._digest_of_sources.cache_clear()
