"""The cache returns what was stored, or computes it again; it removes its own entries only."""

import errno
import json
import math
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterator
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
REFUSED = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
CONTENT = {
    "picture": np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    "codes": np.arange(5, dtype=np.uint16),
    "number": np.float64(1 / 3),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def read(values: dict) -> dict:
    return {"number": float(values["number"])}


def cached(number: float = 1.0, key: str = "key", kind: str = "kind") -> tuple[dict, int]:
    """The result of `load_or_compute`, and the number of computations."""
    compute = Mock(return_value={"number": number})
    return cache.load_or_compute(kind, key, read, compute, dict), compute.call_count


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def store_zeros(key: str, mib: float = 1.0) -> None:
    cache.store_arrays("kind", key, {"zeros": np.zeros(int(mib * 2**20), np.uint8)})


# --- What is read
# --------------------------------------------------------------------------------------------------


def test_load_or_compute_computes_once(folder):
    assert (cached(1.5), cached(2.5)) == (({"number": 1.5}, 1), ({"number": 1.5}, 0))
    assert cached(2.5, "other") == ({"number": 2.5}, 1)
    assert [cached(math.nan, "nan")[1] for _ in range(2)] == [1, 0]
    assert names(folder / "kind") == ["key.json", "nan.json", "other.json"]


def test_arrays_round_trip_is_exact(folder):
    assert cache.arrays("kind", "key") is None
    cache.store_arrays("kind", "key", CONTENT)
    arrays = cache.arrays("kind", "key")
    assert {name: values.dtype for name, values in arrays.items()} == {
        name: values.dtype for name, values in CONTENT.items()
    }
    np.testing.assert_equal(arrays, CONTENT)
    assert names(folder / "kind") == ["key.npz"]


def damaged(content: bytes) -> Iterator[bytes]:
    """Truncated contents, contents with a bit flipped in every third byte, and others."""
    yield from (content[:length] for length in range(0, len(content), 37))
    for place in range(0, len(content), 3):
        yield content[:place] + bytes([content[place] ^ (1 << place % 8)]) + content[place + 1 :]
    yield from (b"[" * 100_000, b'{"number": 1}', b"\xff\xfe\x80")


@pytest.mark.parametrize(
    ("name", "store", "load"),
    [
        ("key.json", lambda: cached(0.13211), lambda: cache.value_of("kind", "key", read)),
        (
            "key.npz",
            lambda: cache.store_arrays("kind", "key", CONTENT),
            lambda: cache.arrays("kind", "key"),
        ),
    ],
    ids=["json", "arrays"],
)
def test_damaged_entry_is_no_entry(
    name: str, store: Callable[[], object], load: Callable[[], object], folder: Path
) -> None:
    store()
    for wrong in damaged((folder / "kind" / name).read_bytes()):
        (folder / "kind" / name).write_bytes(wrong)
        with pytest.warns(UserWarning, match="damaged"):
            assert load() is None
    store()
    assert load() is not None


def test_texture_with_a_changed_byte_is_written_again(folder):
    """OpenEXR would read most of them without a word."""
    texels = np.linspace(0, 1, 64, dtype=np.float32).reshape(8, 8)
    path = charts.texture_file(["ramp"], lambda: texels)
    content = path.read_bytes()
    for place in np.random.default_rng(5).integers(0, len(content), 100).tolist():
        path.write_bytes(content[:place] + bytes([content[place] ^ 4]) + content[place + 1 :])
        assert charts.texture_file(["ramp"], lambda: texels).read_bytes() == content
    path.with_suffix(".json").unlink()
    make = Mock(return_value=texels)
    charts.texture_file(["ramp"], make)
    assert make.call_count == 1, "without its digest a file is not believed"


@pytest.mark.parametrize(
    "place", ["kind/other.json", "another/key.json", "a link", "a linked folder"]
)
def test_only_an_entry_of_its_own_label_is_read(folder, place, tmp_path):
    """A file of another key would be another result in silence; a link may lead to any file."""
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for number, key, kind in (
        (3.0, "key", "kind"),
        (1.0, "other", "kind"),
        (2.0, "key", "another"),
    ):
        cached(number, key, kind)
    path = folder / "kind/key.json"
    if "link" in place:
        moved = path if place == "a link" else path.parent
        moved.rename(theirs / moved.name)
        moved.symlink_to(theirs / moved.name)
    else:
        path.write_bytes((folder / place).read_bytes())
    before = {path: path.read_bytes() for path in theirs.rglob("*.json")}
    with warnings.catch_warnings(action="ignore"):
        assert cached(4.0) == ({"number": 4.0}, 1)
    assert {path: path.read_bytes() for path in before} == before


def test_version_fingerprint_depends_on_sources_and_packages(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "PACKAGE", tmp_path)
    monkeypatch.setattr(cache, "_digest_of_sources", cache._digest_of_sources.__wrapped__)
    fingerprint = cache.version_fingerprint.__wrapped__
    fingerprints = [fingerprint()]
    for name, text in (("a.py", "a"), ("a.py", "b"), ("t.toml", "a"), ("q.csv", "1")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        fingerprints.append(fingerprint())
    (tmp_path / "notes.txt").touch()  # no source
    assert fingerprint() == fingerprints[-1]
    monkeypatch.setattr(cache, "VERSION", "99")
    fingerprints.append(fingerprint())
    for package in ("numpy", "scipy", "mitsuba", "drjit"):
        monkeypatch.setattr(cache, "version_of", lambda name, other=package: name * (name != other))
        fingerprints.append(fingerprint("mitsuba", "drjit"))
    assert len(set(fingerprints)) == len(fingerprints) == 10


# --- What is written
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_file", [True, pytest.param(False, marks=NOT_ROOT)])
def test_a_folder_that_cannot_be_written_is_a_warning(folder, is_file):
    folder.touch() if is_file else folder.mkdir(0o500)
    with pytest.warns(UserWarning, match=rf"cannot be written .*set {FOLDER_VARIABLE}") as caught:
        assert cached(1.5) == ({"number": 1.5}, 1)
    assert len(caught) == 1


def test_load_or_compute_failure_leaves_no_file(folder):
    with pytest.raises(ValueError, match="no result"):
        cache.load_or_compute("kind", "key", read, Mock(side_effect=ValueError("no result")), dict)
    assert not list(folder.rglob("*"))


FORK = multiprocessing.get_context("fork")
BOTH = FORK.Barrier(2)


def write_many(_: int) -> None:
    warnings.simplefilter("error")
    BOTH.wait(HANG_S)
    for number in range(40):
        assert cached(float(number), f"key{number}")[0] == {"number": float(number)}


def test_two_processes_share_entries(folder):
    with FORK.Pool(2) as pool:
        pool.map_async(write_many, range(2), chunksize=1).get(HANG_S)
    for number in range(40):
        head, value = (folder / f"kind/key{number}.json").read_text(encoding="utf-8").split("\n")
        assert head.startswith(f"pixsim cache kind/key{number} ")
        assert json.loads(value) == {"number": number}


@pytest.mark.parametrize(
    ("variable", "below"), [("XDG_CACHE_HOME", "pixsim"), ("HOME", ".cache/pixsim")]
)
def test_folder_follows_xdg(variable, below, monkeypatch, tmp_path):
    for name in (FOLDER_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    assert cache.folder() == tmp_path / below


def test_limit_zero_disables_cache(folder, monkeypatch):
    cache.store_arrays("kind", "key", CONTENT)
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    assert cache.arrays("kind", "key") is None
    assert (cached(1.5), names(folder / "kind")) == (({"number": 1.5}, 1), ["key.npz"])


def test_kernels_are_used_only_from_a_folder_of_ones_own(folder, tmp_path):
    """They are code."""
    kernels = private_folder("kernels")
    assert (kernels, kernels.stat().st_mode & 0o777) == (folder / "kernels", 0o700)

    def assert_not_used() -> None:
        with pytest.warns(UserWarning, match="not a folder that only you can write"):
            other = private_folder("kernels")
        assert other != kernels
        assert (other.stat().st_mode & 0o777, other.stat().st_uid) == (0o700, os.geteuid())

    kernels.chmod(0o770)
    assert_not_used()
    kernels.chmod(0o700)
    if os.geteuid() == 0:  # only root can give a folder away
        os.chown(kernels, 12345, -1)
        assert_not_used()
    kernels.rename(tmp_path / "theirs")
    kernels.symlink_to(tmp_path / "theirs")
    assert_not_used()


# --- What is removed
# --------------------------------------------------------------------------------------------------


def test_the_least_recently_used_are_removed_beyond_the_limit(folder, monkeypatch):
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(8 / 1024))  # 8 MiB
    for number in range(12):
        store_zeros(f"{number:02d}")
        os.utime(folder / f"kind/{number:02d}.npz", (number, number))
        assert number == 0 or cache.arrays("kind", "00") is not None, "just used, but removed"
        size = sum(entry.size_bytes for entry in cache.entries())
        assert size <= 9.5 * 2**20, "it stays near its limit"
    cache.trim()
    # 7 of a little more than 1 MiB fit into 8 MiB
    assert names(folder / "kind") == [f"{n:02d}.npz" for n in (0, 6, 7, 8, 9, 10, 11)]
    cache.clear()
    store_zeros("small", 1.9)
    store_zeros("large", 2.1)  # it would displace all others
    assert names(folder / "kind") == ["small.npz"]


def test_trim_removes_partial_files_of_ended_processes(folder):
    cache.store_arrays("kind", "key", CONTENT)
    with unfinished(folder / "kind", is_folder=False) as running:
        for name in (f"{UNFINISHED}0123abcd", ".notes"):
            (folder / "kind" / name).write_bytes(b"half")
        cache.trim()
        assert names(folder / "kind") == sorted([".notes", "key.npz", running.name])
    assert len(cache.entries()) == 1


def test_clear_removes_one_kind_or_all_but_kernels(folder):
    """Mitsuba manages kernels itself: they are removed if they are named."""
    for kind in ("one", "other"):
        cached(kind=kind)
    kernel = folder / f"kernels/{'0a' * 16}.llvm.v6.bin"
    kernel.parent.mkdir()
    for path in (kernel, kernel.with_name("notes.txt")):
        path.write_bytes(b"kernel")
    assert cache.clear("one") > 0
    assert [entry.kind for entry in cache.entries()] == ["other"]
    cache.clear()
    assert (cache.entries(), kernel.exists()) == ([], True)
    assert (cache.clear("kernels"), names(folder / "kernels")) == (len(b"kernel"), ["notes.txt"])


@pytest.mark.parametrize("how", ["clear", "clear kind", "trim"])
def test_only_entries_are_removed(folder, how, monkeypatch, tmp_path):
    """Not what lies beside them, what a link leads to, or what a linked folder holds."""
    cached(1.0)
    cached(1.0, kind="other")
    entry = (folder / "kind/key.json").read_bytes()
    # Files of a user beside entries, also with their endings; one is a copy of an entry.
    contents = {
        "notes.txt": b"mine",
        "data.json": b'{"a": 1}',
        "chart.exr": b"\x76\x2f\x31\x01mine",
        "measured.npz": b"PK\x03\x04mine",
        "copy.json": entry,
    }
    for kind in ("kind", "other"):
        for name, content in contents.items():
            (folder / kind / name).write_bytes(content)
            os.utime(folder / kind / name, (1, 1))  # the first ones that would be removed
    mine = tmp_path / "mine"
    (folder / "kind").rename(mine)  # with an entry, and under the name of its kind
    (folder / "kind").symlink_to(mine)
    (folder / "other/linked.json").symlink_to(mine / "key.json")
    if how == "trim":
        monkeypatch.setenv(cache.LIMIT_VARIABLE, "1e-9")
        cache.trim()
    else:
        cache.clear("kind" if how == "clear kind" else None)
    assert {path.name: path.read_bytes() for path in mine.iterdir()} == {
        "key.json": entry
    } | contents
    remaining = [*contents, "linked.json"]
    assert names(folder / "other") == sorted(remaining + ["key.json"] * (how == "clear kind"))


def test_files_of_other_users_are_passed_over(folder, monkeypatch):
    """A folder that cannot be listed, and files that cannot be removed; as root none is refused."""
    for kind in ("kind", "theirs", "closed"):
        cached(kind=kind)
    listed, unlink = Path.iterdir, Path.unlink

    def list_folder(path: Path) -> Iterator[Path]:
        if path.name == "closed":
            raise REFUSED
        return listed(path)

    def remove(path: Path, **options: bool) -> None:
        if path.parent.name == "theirs":
            raise REFUSED
        unlink(path, **options)

    monkeypatch.setattr(Path, "iterdir", list_folder)
    monkeypatch.setattr(Path, "unlink", remove)
    assert [entry.kind for entry in cache.entries()] == ["kind", "theirs"]
    assert cache.clear() > 0
    assert [entry.kind for entry in cache.entries()] == ["theirs"]
    assert (folder / "closed/key.json").exists()
    assert cache.is_entry(folder / "theirs/key.json")
    monkeypatch.setattr(Path, "open", Mock(side_effect=REFUSED))
    assert not cache.is_entry(folder / "theirs/key.json")
