"""Output: a command replaces and removes only what pixsim wrote; devices and pipes get the content
and stay; nothing goes through a link of others; files of results state their schema.
"""

import hashlib
import json
import os
import stat
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command

from pixsim import PixsimError, SpectralImage
from pixsim.base.files import (
    FILE_LIST,
    FILE_LIST_OF_1_1,
    UNCHANGED_NS,
    check_replaceable,
    digest_of,
    output_folder,
    publishing,
    read_file_list,
    write_json,
    write_new,
)
from pixsim.base.locks import LOCK
from pixsim.base.schema import KEY, SCHEMA, json_text
from pixsim.base.tables import write_text
from pixsim.base.toml import SETTINGS_HEAD, read_toml, settings_table_text
from pixsim.light.exr import write_exr
from pixsim.optics.exchange import write_npz
from pixsim.scene.charts import write_chart
from pixsim.sensor.raw import RawFrame, write_frame
from pixsim.studies.table import CHECK, COLUMNS, Store, check_replaceable_results


def publish(folder: Path, **texts: str) -> None:
    """Publish files `name`.txt, or of another stated suffix; an underscore is a folder."""
    with output_folder(folder) as place, publishing(place) as unfinished:
        for name, text in texts.items():
            path = unfinished / f"{name.replace('_', '/')}{'' if '.' in name else '.txt'}"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != FILE_LIST)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def state(folder: Path) -> dict[str, bytes | bool]:
    return {path.name: path.is_file() and path.read_bytes() for path in folder.iterdir()}


def test_publishing_again_replaces_files_of_pixsim_and_leaves_all_others(tmp_path: Path) -> None:
    """Also those that a user has changed; files of an earlier command stay, and are known, but for
    the table beside a frame that is replaced.
    """
    (tmp_path / "mine.txt").write_text("mine")
    publish(tmp_path, a="1", figures_b="2", figures_c="3", **{"a.knees.csv": "6"})
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
    ("name", "kind", "named"),
    [
        ("c.txt", "9", "c.txt"),  # not listed
        (FILE_LIST, '{"files": ["a.txt"]}', FILE_LIST),  # of another program
        (FILE_LIST, "nothing", "a.txt"),
        ("a.txt", "folder", "a.txt"),
        ("a.txt", "dangling link", "a.txt"),
    ],
)
def test_check_replaceable_file_of_another_program_raises(
    name: str, kind: str, named: str, tmp_path: Path
) -> None:
    """Also at the end of a command, before anything is moved: a file may have come meanwhile."""
    publish(tmp_path, a="1", b="2")
    path = tmp_path / name
    path.unlink(missing_ok=True)
    if kind == "folder":
        path.mkdir()
    elif kind == "dangling link":
        path.symlink_to(tmp_path / "gone")
    elif kind != "nothing":
        path.write_text(kind)
    before = state(tmp_path)
    with pytest.raises(PixsimError, match=rf"holds .*{named}.*Choose another with --out"):
        check_replaceable(tmp_path, ["a.txt", "c.txt"])
    with pytest.raises(PixsimError, match=named):
        publish(tmp_path, a="new", c="new")
    assert state(tmp_path) == before


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
    replace, moves = os.replace, iter([None, KeyboardInterrupt])

    def fails(path: Path, target: str | Path, **options: int) -> None:
        if str(target).endswith(".txt") and next(moves):
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


# --- Onto what is no regular file
# ---------------------------------------------------------------------------------------------------

LIGHT = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))
FRAME = RawFrame(np.array([[64, 1023]]), black_level_dn=64.0, bits=10)
WRITERS: dict[str, Callable[[Path], object]] = {
    "chart.exr": lambda path: write_chart(path, np.ones((2, 3), np.float32)),
    "light.exr": lambda path: write_exr(path, LIGHT),
    "light.npz": lambda path: write_npz(path, LIGHT),
    **{
        f"raw{suffix}": lambda path: write_frame(path, FRAME)
        for suffix in (".exr", ".npz", ".png", ".tiff")
    },
    "table.csv": lambda path: write_text(path, "a\r\n1\r\n"),
    "new.toml": lambda path: write_new(path, "a = 1\n"),
}
OF_ALL = pytest.mark.parametrize("name", WRITERS)
NEEDS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root makes devices")


def expected(name: str, folder: Path) -> bytes:
    """The content of the file that a writer makes."""
    folder.mkdir()
    WRITERS[name](folder / name)
    return without_time((folder / name).read_bytes())


def without_time(content: bytes) -> bytes:
    """A zip archive states when it was written, in steps of 2 s."""
    return (
        content if content[:2] != b"PK" else content[:10] + content[14 : content.index(b"PK\1\2")]
    )


@OF_ALL
def test_a_named_pipe_gets_the_content_and_stays(name: str, tmp_path: Path) -> None:
    pipe = tmp_path / name
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        content = pool.submit(pipe.read_bytes)
        WRITERS[name](pipe)
        assert without_time(content.result(60)) == expected(name, tmp_path / "file")
    assert (stat.S_ISFIFO(pipe.lstat().st_mode), os.listdir(tmp_path / "file")) == (True, [name])


@NEEDS_ROOT
@OF_ALL
def test_a_device_stays(name: str, tmp_path: Path) -> None:
    """Also one that a link leads to; a node of our own, which leads nowhere."""
    device, link = tmp_path / name, tmp_path / "links" / name
    os.mknod(device, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
    link.parent.mkdir()
    link.symlink_to(device)
    for path in (device, link):
        WRITERS[name](path)
    assert stat.S_ISCHR(device.lstat().st_mode)
    assert device.lstat().st_rdev == os.makedev(1, 3)
    assert (link.is_symlink(), {*os.listdir(tmp_path)}) == (True, {name, "links"})


@NEEDS_ROOT
def test_a_disk_is_refused(tmp_path: Path) -> None:
    os.mknod(tmp_path / "x.exr", 0o600 | stat.S_IFBLK, os.makedev(240, 250))  # of no driver
    with pytest.raises(PixsimError, match=r"x\.exr', a device; allowed: a file, a pipe"):
        WRITERS["light.exr"](tmp_path / "x.exr")
    assert stat.S_ISBLK((tmp_path / "x.exr").lstat().st_mode)


@OF_ALL
@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_of_the_user_is_followed_once(name: str, is_there: bool, tmp_path: Path) -> None:
    content = expected(name, tmp_path / "file")
    elsewhere, link = tmp_path / "elsewhere" / name, tmp_path / name
    elsewhere.parent.mkdir()
    link.symlink_to(elsewhere)
    if is_there and name != "new.toml":  # which is never replaced
        elsewhere.write_bytes(b"before")
    WRITERS[name](link)
    assert (link.is_symlink(), without_time(elsewhere.read_bytes())) == (True, content)
    assert os.listdir(elsewhere.parent) == [name]


@pytest.mark.parametrize(
    ("name", "way"),
    [
        *((name, "a link to a link") for name in WRITERS),
        *(("table.csv", way) for way in ("/dev/fd/{}", "/proc/self/fd/{}", "a relative link")),
    ],
)
def test_a_stream_of_this_process_gets_the_content_where_it_stands(
    name: str, way: str, tmp_path: Path
) -> None:
    """/dev/stdout of `command > file` is such a one: the file is the shell's, and may hold
    something already.
    """
    content = expected(name, tmp_path / "file")
    second, first = tmp_path / "links" / name, tmp_path / name
    second.parent.mkdir()
    second.symlink_to(first if way == "a link to a link" else Path("..", name))
    with (tmp_path / "shell").open("wb", buffering=0) as file:
        file.write(b"before")
        first.symlink_to(f"/dev/fd/{file.fileno()}")
        WRITERS[name](Path(way.format(file.fileno())) if "{}" in way else second)
        file.write(b"after")
    whole = (tmp_path / "shell").read_bytes()
    assert (whole[:6], whole[-5:], first.is_symlink()) == (b"before", b"after", True)
    assert without_time(whole[6:-5]) == content


def test_a_command_says_what_a_reader_that_is_gone_has_not_taken(tmp_path: Path) -> None:
    pipe = tmp_path / "x.exr"
    os.mkfifo(pipe)
    threading.Thread(target=lambda: pipe.open("rb").close()).start()
    assert_refused(
        *command("chart flat --width 512 --height 512 -o", pipe), ["x.exr", "Broken pipe"]
    )
    assert stat.S_ISFIFO(pipe.lstat().st_mode)


# --- Below an output folder
# ---------------------------------------------------------------------------------------------------


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A folder of the user that no output belongs to."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "a.txt").write_text("mine")
    return folder


@pytest.mark.parametrize("linked", ["figures", "figures/a.txt", FILE_LIST, LOCK])
def test_publishing_never_goes_through_a_link_in_the_folder(
    linked: str, theirs: Path, tmp_path: Path
) -> None:
    link = tmp_path / "out" / linked
    link.parent.mkdir(parents=True)
    link.symlink_to(theirs if linked == "figures" else theirs / "a.txt")
    with pytest.raises(PixsimError, match=r"output folder"):
        publish(tmp_path / "out", figures_a="new")
    assert (contents(theirs), link.is_symlink()) == ({"a.txt": "mine"}, True)
    if linked != LOCK:
        with pytest.raises(
            PixsimError, match=f"which holds .*{linked}.*, not written by this command"
        ):
            check_replaceable(tmp_path / "out", ["figures/a.txt"])  # before anything is computed


def test_publishing_into_a_linked_folder_works(theirs: Path, tmp_path: Path) -> None:
    """Folders of results are often links to a scratch disk."""
    (tmp_path / "out").symlink_to(theirs)
    for text in ("first", "new"):
        publish(tmp_path / "out", figures_a=text)
    assert (tmp_path / "out").is_symlink()
    assert contents(theirs) == {"a.txt": "mine", "figures/a.txt": "new"}


@pytest.mark.parametrize("kind", ["pipe", "content"])
def test_a_lock_that_is_not_pixsims_is_neither_waited_for_nor_removed(
    kind: str, tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / LOCK) if kind == "pipe" else (tmp_path / LOCK).write_text("mine")
    with (
        pytest.raises(PixsimError, match=r"'\.pixsim\.lock' is not a lock of pixsim"),
        output_folder(tmp_path),
    ):
        pass
    assert (tmp_path / LOCK).exists()


def row(key: str) -> list[str]:
    return [key, *["1"] * (len(Store(Path()).columns) - 1)]


def test_each_change_of_a_study_keeps_its_own_backup(theirs: Path, tmp_path: Path) -> None:
    """Nor does a backup go through a link: an edited file of rows would become the content of any
    other file.
    """
    (tmp_path / "results.csv.old").symlink_to(theirs / "a.txt")
    results, befores = Store(tmp_path / "results.csv"), []
    for key in ("first", "second", "first"):
        results.write([row(key)])
        befores.append(results.path.read_text())
        results.resume(lambda row: False)
    assert contents(theirs) == {"a.txt": "mine"}
    backups = [tmp_path / f"results.csv.old{number}" for number in (2, 3)]
    assert [path.read_text() for path in backups] == befores[:2]
    assert not (tmp_path / "results.csv.old4").exists(), "the same content is there already"


def test_rows_are_not_appended_through_a_link(theirs: Path, tmp_path: Path) -> None:
    (tmp_path / "results.csv").symlink_to(theirs / "a.txt")
    results = Store(tmp_path / "results.csv")
    with pytest.raises(PixsimError, match=r"results.csv', a link; allowed: the rows of a study"):
        check_replaceable_results(results.path)
    for write in (results.add, results.write):
        with pytest.raises(PixsimError, match=r"results\.csv"):
            write([row("key")])
    assert contents(theirs) == {"a.txt": "mine"}


# --- The schema of files of results
# ---------------------------------------------------------------------------------------------------


def test_json_files_state_the_schema(tmp_path):
    write_json(tmp_path / "score.json", {"mean_delta_e": 1.5})
    assert json.loads((tmp_path / "score.json").read_text()) == {KEY: SCHEMA, "mean_delta_e": 1.5}
    assert KEY not in json.loads(json_text({"$schema": "https://json-schema.org/draft/2020-12"}))


def test_rows_without_a_check_are_kept_apart_and_computed_again(tmp_path):
    """As those of release 1.1, whose rows ended with the last metric. Keys tell rows of other
    versions that have a check.
    """
    results = Store(tmp_path / "results.csv")
    results.write(row(f"key{number}") for number in range(3))
    lines = [line.rsplit(",", 2)[0] for line in results.path.read_text().splitlines()]
    results.path.write_text("\n".join(lines) + "\n")
    before = results.path.read_bytes()
    with pytest.warns(
        UserWarning, match=r"another version of pixsim.*results.csv.old.*computed again"
    ):
        assert results.resume(lambda row: True) == []
    assert (tmp_path / "results.csv.old").read_bytes() == before
    assert results.path.read_text().splitlines() == [",".join([*COLUMNS, KEY, CHECK])]


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
    publish(tmp_path, a="1")
    check_replaceable(tmp_path, ["a.txt"])
    content = json.loads((tmp_path / FILE_LIST).read_text())
    (tmp_path / FILE_LIST).write_text(json.dumps(content | {KEY: stated}))
    with pytest.raises(PixsimError, match=r"output folder.*schema.*Use the version of pixsim"):
        check_replaceable(tmp_path, ["a.txt"])
