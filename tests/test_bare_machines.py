"""Machines that lack something: a result or a message, never a hang or a traceback."""

from __future__ import annotations

import errno
import multiprocessing
import os
import resource
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import forked
from helpers.processes import HANG_S
from helpers.tiny import tiny_toml

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.notes import MachineWarning
from pixsim.scene import mitsuba
from pixsim.studies.engine import Workers, processes_work, results_of


def double(task: int, _: None) -> tuple[int, int]:
    return 2 * task, os.getpid()


def test_without_shared_memory_one_process_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose /dev/shm is missing or cannot be written, where no lock of processes can be made."""

    def fails(*_: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setitem(sys.modules, "_multiprocessing", types.SimpleNamespace(SemLock=fails))
    processes_work.cache_clear()
    try:
        with pytest.warns(MachineWarning, match=r"/dev/shm cannot be written \(Read-only file system\): one process does all"):
            results = list(results_of(double, [(task, lambda: None) for task in range(3)], Workers(2)))
    finally:
        processes_work.cache_clear()
    assert results == [(0, os.getpid()), (2, os.getpid()), (4, os.getpid())]


@pytest.mark.parametrize("columns", ["0", "1", "-5", "wide", ""])
def test_help_has_some_columns(columns: str) -> None:
    code, out, _ = forked("run --help", COLUMNS=columns)
    assert (code, "--repeats" in out, max(map(len, out.splitlines())) >= 39) == (0, True, True)


def test_few_open_files_are_a_message(tmp_path: Path) -> None:
    """The limit that the command starts with does for one process, but not for workers."""
    (tmp_path / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    run = [Path(sys.executable).with_name("pixsim"), "study", "tiny.toml", "--jobs", "2", "--out", "out"]
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (24, 24))  # noqa: E731
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, preexec_fn=few)
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or "ulimit -n" in done.stderr


def rendered(answers: Any) -> None:
    try:
        pixsim.render(pixsim.load_scene("flat", resolution=8, spp=4, variant="scalar_spectral"), pixsim.Camera())
    except PixsimError as error:
        answers.send(str(error))


def test_a_process_forked_after_a_render_is_told_at_once() -> None:
    """Mitsuba's threads are not in it: a render there would wait for them for ever."""
    mitsuba.import_mitsuba("scalar_spectral")
    context = multiprocessing.get_context("fork")
    reading, writing = context.Pipe()
    child = context.Process(target=rendered, args=(writing,))
    child.start()
    try:
        assert reading.poll(HANG_S)
        assert "forked after a render; allowed: a process of its own" in (told := reading.recv())
        assert "get_context('spawn')" in told
    finally:
        child.kill()
        child.join()
