"""What a shell, an impatient user or a full machine does to a command: one message, a known exit
code, nothing half or left.
"""

import errno
import fcntl
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.commands import COMMAND, assert_refused, command
from helpers.processes import HANG_S
from helpers.tiny import tiny_toml

from pixsim.base.errors import UnwritableError
from pixsim.base.files import (
    FILE_LIST,
    FOLDER_VARIABLE,
    output_folder,
    publishing,
    read_file_list,
    replacing,
)
from pixsim.base.locks import LOCK, UNFINISHED, temporary_folder, unfinished
from pixsim.report.commands.study import reported_saved_rows
from pixsim.studies.table import COLUMNS, Store

SMALL = "--resolution 48 --display.dots 48"
EDGE = 1 / (1 + np.exp(60 + np.arange(128)[:, None] * 0.1 - np.arange(128)))
LINES = {
    "run": f"run csf {SMALL} --out out",
    "study": "study tiny.toml --jobs 2 --out out",
    "datasheet": "datasheet 0.35um --out out",
    "accuracy": "accuracy csf --quick -D resolution=32 --out out",
    "compare": (
        f"compare 0.35um 4t-bsi {SMALL} --pixel.pitch-um 40 --jobs 2 --repeats 300 --out out"
    ),
}
WORDS = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "the terminal was closed",
}
GONE_S = 5.0  # for processes to notice that their parent has ended
proc = pytest.mark.skipif(
    not Path("/proc/self/status").is_file(), reason="processes are looked up in /proc"
)


def started(line: str, folder: Path, **streams: object) -> subprocess.Popen[str]:
    """A command, or the lines of a script, as the leader of its own process group, whose temporary
    files go to `folder`/tmp.

    `run` and `datasheet` are started by the installed `pixsim`, the others by `python -m pixsim`.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **streams}
    installed = line.startswith(("run", "datasheet"))
    words = [*([COMMAND] if installed else [sys.executable, "-m", "pixsim"]), *shlex.split(line)]
    if "\n" in line:
        (folder / "script.py").write_text(line, encoding="utf-8")
        words = [sys.executable, "script.py"]
    (folder / "tmp").mkdir(exist_ok=True)
    environment = os.environ | {"TMPDIR": str(folder / "tmp"), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(words, cwd=folder, env=environment, start_new_session=True, **pipes)


def takes_signals(pid: int) -> bool:
    """Whether a process has a handler for SIGTERM, which Python itself has not; or has ended."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True
    (mask,) = re.findall(r"SigCgt:\s*(\w+)", text)
    return bool(int(mask, 16) >> (signal.SIGTERM - 1) & 1)


def processes_of(group: int) -> list[str]:
    """Command lines of the living processes of a group."""
    command_lines = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has just ended
            state, _, process_group = stat.read_text().rpartition(")")[2].split()[:3]
            if int(process_group) == group and state != "Z":
                command_lines.append(stat.with_name("cmdline").read_text().replace("\0", " "))
    return command_lines


def wait_for(condition: object, longest_s: float = HANG_S) -> None:
    end = time.monotonic() + longest_s
    while not condition():
        assert time.monotonic() < end, f"not within {longest_s:g} s"
        time.sleep(0.002)


def notes_of(stderr: str) -> list[str]:
    """Lines of stderr without signs of life."""
    return [line for line in stderr.splitlines() if not line.startswith("[")]


def interrupt(
    name: str, number: signal.Signals, of_group: bool, delay_s: float, folder: Path
) -> None:
    """Send a signal to a command after a delay, and check that nothing half is left."""
    (folder / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    process = started(LINES[name], folder)
    wait_for(lambda: takes_signals(process.pid))
    time.sleep(delay_s)
    (os.killpg if of_group else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=HANG_S)
    seen = (
        f"{name}, {number.name} to the {'group' if of_group else 'process'} after {delay_s:.3f} s:"
        f" {process.returncode}\n{err}{out}"
    )
    written = {str(path.relative_to(folder / "out")) for path in (folder / "out").rglob("*")}
    if FILE_LIST in written:  # it had moved its files
        assert written >= set(read_file_list(folder / "out")["files"]), seen
    elif process.returncode == 0:  # it had ended
        assert "report.html" in written, seen
    else:
        assert (process.returncode, out) == (128 + number, ""), seen
        assert len(notes_of(err)) == 1, seen
        assert notes_of(err)[0].startswith(f"pixsim: {WORDS[number]}"), seen
        assert written <= {"results.csv"}, seen
    assert not list((folder / "tmp").iterdir()), seen
    wait_for(lambda: not processes_of(process.pid), GONE_S)


def moments(
    count: int, longest_s: float, seed: int
) -> list[tuple[str, signal.Signals, bool, float]]:
    """Random commands, signals, receivers and times: every second one during the imports, which
    take half a second.
    """
    source = random.Random(seed)
    return [
        (
            list(LINES)[number % len(LINES)],
            source.choice([signal.SIGINT, signal.SIGTERM]),
            source.random() < 0.5,
            source.random() * (0.5 if number % 8 < 4 else longest_s),
        )
        for number in range(count)
    ]


@proc
@pytest.mark.parametrize(
    ("name", "number", "of_group", "delay_s"),
    [
        moments(8, 1.5, seed=1)[0],
        # What is wrong during a twentieth of these times is met with a probability of 95 %: 1 -
        # 0.95⁶⁰.
        *(pytest.param(*moment, marks=pytest.mark.slow) for moment in moments(60, 3.0, seed=2)),
    ],
)
def test_command_interrupted_at_random_moment(name, number, of_group, delay_s, tmp_path) -> None:
    interrupt(name, number, of_group, delay_s, tmp_path)


FINISHED = """import os, signal, joblib
from pixsim.cli.process import interruption, leave
class Late:
    def __del__(self, send=os.kill, own=os.getpid(), number=signal.{number}):
        send(own, number)
late = Late()
interruption.guard()
interruption.begin()
leave(3)
"""


# one handler takes them all
@pytest.mark.parametrize(
    "number",
    ["SIGTERM", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGINT", "SIGHUP"))],
)
def test_signal_after_the_command_keeps_its_exit_code(number: str, tmp_path: Path) -> None:
    """Python clears its modules after it has taken away its handlers: a signal ended the process
    then, with everything written.
    """
    process = started(FINISHED.format(number=number), tmp_path)
    assert (*process.communicate(timeout=HANG_S), process.returncode) == ("", "", 3)


@proc
@pytest.mark.slow
def test_command_closed_terminal_or_nohup(tmp_path: Path) -> None:
    interrupt("run", signal.SIGHUP, False, 0.1, tmp_path)
    ignoring = started(
        "cache", tmp_path, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)
    )
    wait_for(lambda: takes_signals(ignoring.pid))
    os.kill(ignoring.pid, signal.SIGHUP)
    ignoring.communicate(timeout=HANG_S)
    assert ignoring.returncode == 0


STARTING = """import os, signal
from joblib.externals.loky.{module} import {owner} as owner
from pixsim.cli.process import interruption
from pixsim.studies.engine import Workers, results_of

def task(number, shared):
    return number

def interrupted(*args, **others):
    made = original(*args, **others) if "{when}" == "after" else None
    signal.raise_signal(signal.SIGTERM)
    return made if "{when}" == "after" else original(*args, **others)

if __name__ == "__main__":
    original = owner.{name}
    owner.{name} = interrupted
    interruption.guard()
    interruption.begin()
    try:
        list(results_of(task, [(number, dict) for number in range(4)], Workers(2)))
    except KeyboardInterrupt:
        interruption.finish()
        print("interrupted")
"""


@proc
@pytest.mark.parametrize(
    ("module", "owner", "name", "when"),
    [
        ("backend", "fork_exec", "fork_exec", "after"),  # a worker runs that has not got its data
        (
            "process_executor",
            "ProcessPoolExecutor",
            "_start_executor_manager_thread",
            "before",
        ),  # nobody would end the workers
    ],
)
def test_signal_while_workers_start_ends_them(
    module: str, owner: str, name: str, when: str, tmp_path: Path
) -> None:
    """A worker that joblib does not know printed a traceback, or stayed."""
    process = started(STARTING.format(module=module, owner=owner, name=name, when=when), tmp_path)
    assert (*process.communicate(timeout=HANG_S), process.returncode) == ("interrupted\n", "", 0)
    wait_for(lambda: not processes_of(process.pid), GONE_S)
    assert not list((tmp_path / "tmp").iterdir())


COMMAND_THAT_TURNS_SIGNALS = """
import signal, sys, time
from pixsim import cli
from pixsim.report import inventory

def imports(*_):
    sys.path.append("")
    import dropping  # raises the signal and catches everything
    time.sleep(600)

def turns(*_):
    try:
        signal.raise_signal({number})
    except BaseException:
        raise ImportError("initialization failed")

def drops(*_):
    try:
        signal.raise_signal({number})
    except BaseException:
        return {{"kinds": {{}}, "folder": "", "size_bytes": 0, "limit_bytes": 0}}

signal.signal(signal.SIGINT, signal.default_int_handler)
inventory.cache_summary = {way}
sys.argv = ["pixsim", "cache", "--quiet"]
cli.command()
"""


@pytest.mark.parametrize(
    ("way", "number"),
    [
        # an import that drops it is one of the functions that do
        pytest.param("imports", signal.SIGINT, marks=pytest.mark.slow),
        ("turns", signal.SIGTERM),
        ("drops", signal.SIGINT),
    ],  # one handler takes both signals
)
def test_interruption_is_not_turned_into_another_error(
    way: str, number: signal.Signals, tmp_path: Path
) -> None:
    """As libraries in C++ do, above all while they are imported."""
    dropping = (
        f"import signal\ntry:\n    signal.raise_signal({number})\nexcept BaseException:\n    pass\n"
    )
    (tmp_path / "dropping.py").write_text(dropping, encoding="utf-8")
    process = started(COMMAND_THAT_TURNS_SIGNALS.format(number=int(number), way=way), tmp_path)
    _, err = process.communicate(timeout=HANG_S)
    assert (process.returncode, err) == (128 + number, f"pixsim: {WORDS[number]}\n")


COMMAND_WITH_A_SIGNAL = """
import os, pathlib, signal, sys
from pixsim import cli
from pixsim.base import files
from pixsim.cli import options
from pixsim.scene import charts

def interrupted(*args, **others):
    if {owner} is not os or pathlib.Path(args[1]).name == "report.html":
        signal.raise_signal(signal.SIGTERM)
    return original(*args, **others)

original = getattr({owner}, "{name}")
setattr({owner}, "{name}", interrupted)
sys.argv = ["pixsim", *"{line}".split()]
cli.command()
"""
SFR, SFR_FILES = "sfr edge.npy --out out", {"report.html", "summary.json", FILE_LIST}


@pytest.mark.parametrize(
    ("line", "place", "files", "code"),
    [
        # before the first file is moved, while files are moved, while the result is printed
        pytest.param(SFR, "files.resolved", set(), 143, marks=pytest.mark.slow),
        pytest.param(SFR, "os.replace", SFR_FILES, 143, marks=pytest.mark.slow),
        pytest.param(SFR, "options.printable", SFR_FILES, 0, marks=pytest.mark.slow),
        ("template sensor -o out/sensor.toml", "pathlib.Path.write_text", set(), 143),
        ("chart siemens_star --width 16 --height 16 -o out/star.exr", "charts.writing", set(), 143),
    ],
)
def test_signal_beside_files_leaves_all_or_none(
    line: str, place: str, files: set[str], code: int, tmp_path: Path
) -> None:
    owner, _, name = place.rpartition(".")
    (tmp_path / "out").mkdir()
    np.save(tmp_path / "edge.npy", EDGE)
    process = started(COMMAND_WITH_A_SIGNAL.format(owner=owner, name=name, line=line), tmp_path)
    out, err = process.communicate(timeout=HANG_S)
    assert (process.returncode, bool(out)) == (code, code == 0), err
    assert ("pixsim: terminated" in notes_of(err)) is (code != 0)
    written = {
        path.relative_to(tmp_path / "out").as_posix()
        for path in (tmp_path / "out").rglob("*")
        if path.is_file()
    }
    assert written >= files if files else not written
    if files:
        assert written == {FILE_LIST, *read_file_list(tmp_path / "out")["files"]}
    assert not list((tmp_path / "tmp").iterdir())


# --- Killed
# --------------------------------------------------------------------------------------------------------------


LASTING = """
import time
from pixsim.base.files import output_folder
from pixsim.studies.engine import Workers, results_of

def wait(task, shared):
    time.sleep(600)

if __name__ == "__main__":
    with output_folder("out"):
        list(results_of(wait, [(task, dict) for task in range(4)], Workers(2)))
"""


@proc
@pytest.mark.parametrize(
    "delay_s", [0.0, *(pytest.param(delay_s, marks=pytest.mark.slow) for delay_s in (0.3, 1.0))]
)
def test_killed_process_leaves_no_workers_and_next_command_cleans_up(
    delay_s: float, tmp_path: Path, monkeypatch
) -> None:
    """Killed while its workers start, and while they work."""
    process = started(LASTING, tmp_path)
    wait_for(lambda: sum("popen_loky" in line for line in processes_of(process.pid)) == 2)
    time.sleep(delay_s)
    process.kill()
    killed_s = time.monotonic()
    process.communicate(timeout=HANG_S)  # until the last worker has closed the pipes
    wait_for(lambda: not processes_of(process.pid))
    assert time.monotonic() - killed_s < GONE_S
    (left,) = (tmp_path / "tmp").iterdir()
    assert left.name.startswith(UNFINISHED)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [LOCK]
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    with output_folder(tmp_path / "out"):
        assert not left.exists()
    assert not list((tmp_path / "out").iterdir())


KILLED = """
import os, signal
from pathlib import Path
from pixsim.base.files import output_folder, publishing, replacing
with output_folder("out") as out, replacing(out / "a.txt") as part, publishing(out) as folder:
    part.write_text("half")
    (folder / "b.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@proc
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 12))]
)
@pytest.mark.slow
def test_study_killed_at_random_moments_keeps_rows_and_whole_files_and_goes_on(
    seed: int, tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    source, out = random.Random(seed), tmp_path / "out"
    for delay_s in (source.uniform(0, 3), source.uniform(1, 4)):
        process = started(LINES["study"], tmp_path)
        with suppress(subprocess.TimeoutExpired):
            process.wait(delay_s)
        process.kill()
        process.communicate(timeout=HANG_S)
        wait_for(lambda group=process.pid: not processes_of(group), GONE_S)
        left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
        complete = {LOCK, FILE_LIST, "results.csv", *read_file_list(out).get("files", ())}
        assert {name for name in left if not name.startswith(UNFINISHED)} <= complete, delay_s
        if "report.html" in left:
            assert (out / "report.html").read_text(encoding="utf-8").endswith("</html>"), delay_s
    assert command(f"study {tmp_path / 'tiny.toml'} --jobs 1 --out {out}")[0] == 0
    assert command(f"study {tmp_path / 'tiny.toml'} --jobs 1 --out {tmp_path / 'whole'}")[0] == 0
    assert (out / "results.csv").read_bytes() == (tmp_path / "whole/results.csv").read_bytes()
    names, whole_names = (
        {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
        for folder in (out, tmp_path / "whole")
    )
    assert names == whole_names


def test_output_folder_removes_leftovers_of_killed_process_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, check=False, timeout=HANG_S)
    out = tmp_path / "out"
    names = sorted(re.sub(r"[0-9a-f]{8}", "#", path.name) for path in out.iterdir())
    assert names == [f"{UNFINISHED}#", f"{UNFINISHED}#", LOCK]
    others = [".pixsim-notes", ".pixsim-0123abcde", "a.pixsim-0123abcd"]
    for name in others:
        (out / name).touch()
    (out / ".pixsim-0123abcd").symlink_to(tmp_path)
    (tmp_path / f"{UNFINISHED}mine").mkdir()
    with unfinished(out, is_folder=False) as living, temporary_folder() as temporary:
        for folder in (out, tmp_path / "other"):
            with output_folder(folder):
                pass
        assert temporary.exists()
        names = sorted(path.name for path in out.iterdir())
        assert names == sorted([*others, ".pixsim-0123abcd", living.name])
    assert not temporary.exists()
    assert {path.name for path in tmp_path.iterdir()} >= {"out", f"{UNFINISHED}mine"}


# --- Two at the same time
# ------------------------------------------------------------------------------------------------


@contextmanager
def in_use(folder: Path) -> Iterator[None]:
    """A folder that another thread has locked, as another process would: the system does not tell
    them apart.
    """
    locked, end = threading.Event(), threading.Event()

    def hold() -> None:
        with output_folder(folder):
            locked.set()
            end.wait(HANG_S)

    thread = threading.Thread(target=hold)
    thread.start()
    assert locked.wait(HANG_S)
    try:
        yield
    finally:
        end.set()
        thread.join()


@pytest.mark.parametrize("line", [*LINES.values(), "sfr edge.npy --out out"])
def test_command_refuses_folder_in_use(line: str, here: Path) -> None:
    (here / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    np.save("edge.npy", EDGE)
    with in_use(here / "out"):
        before = sorted(path.name for path in (here / "out").rglob("*"))
        assert_refused(
            *command(line), ["output folder: got 'out', in use by another process", "--out"]
        )
        assert sorted(path.name for path in (here / "out").rglob("*")) == before == [LOCK]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_without_locks_nothing_is_refused_or_removed(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fcntl, "flock", Mock(side_effect=OSError(number, os.strerror(number))))
    left = tmp_path / ".pixsim-0123abcd"
    left.mkdir()
    with (
        in_use(tmp_path),
        output_folder(tmp_path),
        output_folder(tmp_path),
        replacing(tmp_path / "a.txt") as part,
    ):
        part.write_text("a")
    assert {path.name for path in tmp_path.iterdir()} == {left.name, "a.txt"}


def test_replacing_at_the_same_time_gives_one_of_the_whole_files(tmp_path: Path) -> None:
    """With the permissions of a new file."""
    barrier = threading.Barrier(8)

    def write(letter: str) -> None:
        for _ in range(20):
            with replacing(tmp_path / "a.txt") as part, part.open("w") as file:
                barrier.wait(HANG_S)
                file.write(letter * 1000)
                file.flush()
                file.write(letter * 1000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, "abcdefgh"))
    text = (tmp_path / "a.txt").read_text()
    assert text == text[0] * 2000
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    (tmp_path / "usual.txt").touch()
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "usual.txt").stat().st_mode


# --- Streams, folders, disks
# -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("closed", "full", "line", "code"),
    [
        # the next has it closed beside the others
        pytest.param((0,), (), "--version", 0, marks=pytest.mark.slow),
        ((0, 1, 2), (), "schema study", 0),
        ((0, 1, 2), (), "schema nothing", 2),
        ((), (1,), "cache", 2),
        ((), (2,), "schema nothing", 2),
    ],
)
def test_closed_streams_are_like_dev_null_and_a_full_one_is_said(
    closed: tuple[int, ...], full: tuple[int, ...], line: str, code: int, tmp_path: Path
) -> None:
    def change_streams() -> None:
        for number in closed:
            os.close(number)
        for number in full:
            os.dup2(os.open("/dev/full", os.O_WRONLY), number)

    process = started(line, tmp_path, preexec_fn=change_streams)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == code, err
    assert "Traceback" not in err
    assert bool(out) == (code == 0 and 1 not in closed)
    assert bool(err) == (code != 0 and 2 not in (*closed, *full))
    if 1 in full:
        assert re.fullmatch("pixsim: .*No space left on device.*\n", err)


def test_command_no_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a user that the system does not know."""
    for name in (FOLDER_VARIABLE, "XDG_CACHE_HOME", "DRJIT_CACHE_DIR", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(
        Path,
        "home",
        lambda: (_ for _ in ()).throw(RuntimeError("Could not determine home directory.")),
    )
    assert command("--version")[0] == 0
    assert_refused(
        *command("cache"), [FOLDER_VARIABLE, "no home folder", f"export {FOLDER_VARIABLE}="]
    )


@pytest.mark.parametrize("line", ["cache", f"run flat {SMALL}", "study chen2000 --quick"])
def test_command_deleted_current_folder(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert_refused(*command(line), ["current folder: got a folder that no longer exists", "cd ~"])


def test_said_what_is_kept_counts_evaluations(tmp_path: Path) -> None:
    row, results = dict.fromkeys(COLUMNS, "1"), Store(tmp_path / "results.csv")
    words = (
        f"3 finished evaluations are kept in '{tmp_path}', and the same command continues from them"
    )
    with (
        pytest.raises(UnwritableError, match=rf"^a full disk\. {re.escape(words)}\.$"),
        reported_saved_rows(tmp_path),
    ):
        raise UnwritableError(
            results.write([(row | {"key": key}).values() for key in "abc"]) or "a full disk."
        )
    with (
        pytest.raises(KeyboardInterrupt, match=f"^{re.escape(words)}$"),
        reported_saved_rows(tmp_path),
    ):
        raise KeyboardInterrupt(results.add([]) or os.utime(results.path, ns=(0, 0)))
    # Rows that the study has not rewritten may be of other settings.
    with pytest.raises(KeyboardInterrupt, match=r"^$"), reported_saved_rows(tmp_path):
        raise KeyboardInterrupt


@pytest.mark.parametrize("has_name", [True, False])
def test_publishing_full_disk_names_file_and_what_is_kept(has_name: bool, tmp_path: Path) -> None:
    """Writers that know the name, and those that do not: then the folder is named."""
    with publishing(tmp_path) as folder:
        (folder / "a.txt").write_text("before")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    place = tmp_path / "figures/b.txt" if has_name else tmp_path
    pattern = (
        rf"'{place}' cannot be written \(No space left on device\)\. The files .* before are"
        r" unchanged\."
    )

    def write(folder: Path) -> None:
        (folder / "a.txt").write_text("after")
        name = [str(folder / "figures/b.txt")] if has_name else []
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), *name)

    with pytest.raises(UnwritableError, match=pattern), publishing(tmp_path) as folder:
        write(folder)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
