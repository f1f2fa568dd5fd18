"""Output onto what is no regular file: devices and pipes get the content and stay; nothing goes
through a link of others.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command

from pixsim.base.errors import PixsimError
from pixsim.base.files import FILE_LIST, check_replaceable, output_folder, publishing, write_new
from pixsim.base.locks import LOCK
from pixsim.base.tables import write_text
from pixsim.light.exr import write_exr
from pixsim.light.spectral import SpectralImage
from pixsim.optics.exchange import write_npz
from pixsim.scene.charts import write_chart
from pixsim.sensor.raw import RawFrame, write_frame
from pixsim.studies.table import Store, check_replaceable_results

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
    pipe, got = tmp_path / name, []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    WRITERS[name](pipe)
    reader.join(60)
    assert without_time(got[0]) == expected(name, tmp_path / "file")
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
    assert (stat.S_ISCHR(device.lstat().st_mode), device.lstat().st_rdev) == (
        True,
        os.makedev(1, 3),
    )
    assert (link.is_symlink(), sorted(os.listdir(tmp_path))) == (True, sorted([name, "links"]))


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


@OF_ALL
def test_a_stream_of_this_process_gets_the_content_where_it_stands(
    name: str, tmp_path: Path
) -> None:
    """/dev/stdout of `command > file` is such a one: the file is the shell's, and may hold
    something already.
    """
    content = expected(name, tmp_path / "file")
    with (tmp_path / "shell").open("wb", buffering=0) as file:
        file.write(b"before")
        link = tmp_path / name
        link.symlink_to(f"/dev/fd/{file.fileno()}")
        WRITERS[name](link)
        file.write(b"after")
    before, got, after = (whole := (tmp_path / "shell").read_bytes())[:6], whole[6:-5], whole[-5:]
    assert (before, without_time(got), after, link.is_symlink()) == (
        b"before",
        content,
        b"after",
        True,
    )


@pytest.mark.parametrize(
    "way", ["/dev/fd/{}", "/proc/self/fd/{}", "link to a link", "relative link"]
)
def test_each_way_to_a_stream_of_this_process_is_one(way: str, tmp_path: Path) -> None:
    """Where the file of the shell was replaced, all that the shell wrote was lost."""
    with (tmp_path / "shell").open("wb", buffering=0) as file:
        if way.startswith("/proc") and not Path("/proc/self/fd").is_dir():
            pytest.skip("a system without /proc")
        file.write(b"before ")
        path = Path(way.format(file.fileno()))
        if "link" in way:
            path, first = tmp_path / "links/second.csv", tmp_path / "first.csv"
            path.parent.mkdir()
            path.symlink_to(first if way == "link to a link" else "../first.csv")
            first.symlink_to(f"/dev/fd/{file.fileno()}")
        write_text(path, "a\r\n1\r\n")
        file.write(b"after")
    assert (tmp_path / "shell").read_text().split() == ["before", "a", "1", "after"]


def test_a_command_says_what_a_reader_that_is_gone_has_not_taken(tmp_path: Path) -> None:
    pipe = tmp_path / "x.exr"
    os.mkfifo(pipe)
    threading.Thread(target=lambda: pipe.open("rb").close()).start()
    assert_refused(
        *command("chart flat --width 512 --height 512 -o", pipe), ["x.exr", "Broken pipe"]
    )
    assert stat.S_ISFIFO(pipe.lstat().st_mode)


# --- Below an output folder
# -----------------------------------------------------------------------------------------------


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A folder of the user that no output belongs to."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "a.csv").write_text("mine")
    return folder


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def publish(folder: Path) -> None:
    with output_folder(folder) as place, publishing(place) as unfinished:
        (unfinished / "figures").mkdir()
        (unfinished / "figures/a.csv").write_text("new")


@pytest.mark.parametrize("linked", ["figures", "figures/a.csv", FILE_LIST, LOCK])
def test_publishing_never_goes_through_a_link_in_the_folder(
    linked: str, theirs: Path, tmp_path: Path
) -> None:
    link = tmp_path / "out" / linked
    link.parent.mkdir(parents=True)
    link.symlink_to(theirs if linked == "figures" else theirs / "a.csv")
    with pytest.raises(PixsimError, match=r"output folder"):
        publish(tmp_path / "out")
    assert (contents(theirs), link.is_symlink()) == ({"a.csv": "mine"}, True)
    if linked != LOCK:
        with pytest.raises(
            PixsimError, match=f"which holds .*{linked}.*, not written by this command"
        ):
            check_replaceable(tmp_path / "out", ["figures/a.csv"])  # before anything is computed


def test_publishing_into_a_linked_folder_works(theirs: Path, tmp_path: Path) -> None:
    """Folders of results are often links to a scratch disk."""
    (tmp_path / "out").symlink_to(theirs)
    publish(tmp_path / "out")
    publish(tmp_path / "out")
    assert ((tmp_path / "out").is_symlink(), (theirs / "figures/a.csv").read_text()) == (
        True,
        "new",
    )


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


ROW = dict.fromkeys(Store(Path()).columns, "1")


def test_each_change_of_a_study_keeps_its_own_backup(theirs: Path, tmp_path: Path) -> None:
    """Nor does a backup go through a link: an edited file of rows would become the content of any
    other file.
    """
    (tmp_path / "results.csv.old").symlink_to(theirs / "a.csv")
    results, befores = Store(tmp_path / "results.csv"), []
    for key in ("first", "second"):
        results.write([(ROW | {"key": key}).values()])
        befores.append(results.path.read_text())
        results.resume(lambda row: False)
    assert contents(theirs) == {"a.csv": "mine"}
    assert [(tmp_path / f"results.csv.old{number}").read_text() for number in (2, 3)] == befores
    results.write([(ROW | {"key": "first"}).values()])
    results.resume(lambda row: False)
    assert not (tmp_path / "results.csv.old4").exists(), "the same content is there already"


def test_rows_are_not_appended_through_a_link(theirs: Path, tmp_path: Path) -> None:
    (tmp_path / "results.csv").symlink_to(theirs / "a.csv")
    results = Store(tmp_path / "results.csv")
    with pytest.raises(PixsimError, match=r"results.csv', a link; allowed: the rows of a study"):
        check_replaceable_results(results.path)
    for write in (results.add, results.write):
        with pytest.raises(PixsimError, match=r"results\.csv"):
            write([list(ROW.values())])
    assert contents(theirs) == {"a.csv": "mine"}
