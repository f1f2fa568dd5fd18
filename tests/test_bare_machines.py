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
from helpers import systems
from helpers.commands import command
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
    """As in a container whose /dev/shm is missing or cannot be written, where no lock of processes
    can be made.
    """

    def fails(*_: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setitem(sys.modules, "_multiprocessing", types.SimpleNamespace(SemLock=fails))
    processes_work.cache_clear()
    try:
        with pytest.warns(
            MachineWarning,
            match=r"/dev/shm cannot be written \(Read-only file system\): one process does all",
        ):
            results = list(
                results_of(double, [(task, lambda: None) for task in range(3)], Workers(2))
            )
    finally:
        processes_work.cache_clear()
    assert results == [(0, os.getpid()), (2, os.getpid()), (4, os.getpid())]


def test_few_open_files_are_a_message(tmp_path: Path) -> None:
    """The limit that the command starts with does for one process, but not for workers."""
    (tmp_path / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    run = [
        Path(sys.executable).with_name("pixsim"),
        "study",
        "tiny.toml",
        "--jobs",
        "2",
        "--out",
        "out",
    ]
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (24, 24))  # noqa: E731
    done = subprocess.run(
        run, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, preexec_fn=few
    )
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or "ulimit -n" in done.stderr


def rendered(answers: Any) -> None:
    try:
        pixsim.render(
            pixsim.load_scene("flat", resolution=8, spp=4, variant="scalar_spectral"),
            pixsim.Camera(),
        )
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
        assert "forked after a render; allowed: a separate process" in (told := reading.recv())
        assert "get_context('spawn')" in told
    finally:
        child.kill()
        child.join()


EVALUATED = """
import numpy as np
import pixsim
data = 1e-3 * np.random.default_rng(0).uniform(0.5, 1.0, (32, 32, 3))
display = pixsim.Display(dots=8, white_cd_per_m2=1500.0)
light = pixsim.SpectralImage([500.0, 550.0, 600.0], 50.0, 5.0, data=data)
found = pixsim.evaluate(light, pixsim.Camera(die_mm=0.16), pixsim.Pixel(pitch_um=5.6), display=display).mean_delta_e
"""
ON_WINDOWS = f"""
import importlib, pkgutil, sys
import pixsim
names = [module.name for module in pkgutil.walk_packages(pixsim.__path__, "pixsim.") if not module.name.endswith("__main__")]
assert len(names) > 250
for name in names:
    importlib.import_module(name)
{EVALUATED}
print(found)
try:
    pixsim.write_exr("light.exr", light)
except pixsim.PixsimError as error:
    print(error)
from pixsim.cli import command
sys.argv = ["pixsim", "--help"]
command()
"""


def run_on(system: str, code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, str(systems.__file__), system, code]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=HANG_S)


def test_without_what_windows_lacks_all_is_imported_and_light_evaluated(tmp_path: Path) -> None:
    """The number is that of this machine; files, which need locks of folders, are refused with what
    to do.
    """
    done = run_on(systems.WINDOWS, ON_WINDOWS, tmp_path)
    assert done.returncode == 0, done.stderr
    number, refused, *_ = done.stdout.splitlines()
    here: dict[str, Any] = {}
    exec(EVALUATED, here)
    assert number == str(here["found"])
    assert float(number) > 0
    assert refused.startswith(
        "files: got a system whose folders cannot be opened (Windows); allowed: Linux or macOS. "
    )
    assert "WSL" in refused
    assert "Measure the SFR" in done.stdout, "--help"


LIGHT = Path(__file__).parent / "data" / "release_1_0_0" / "run" / "irradiance.exr"
ON_MACOS = f"""
import sys
from pixsim.cli import command
sys.argv = ["pixsim", "run", {str(LIGHT)!r}, "--pixel.pitch-um", "8", "--display.dots", "8", "--out", "out"]
command()
"""


def test_without_what_macos_lacks_light_is_run_into_a_folder(tmp_path: Path) -> None:
    hidden = systems.missing("os", systems.MACOS)
    assert hidden is not None
    assert {"sched_getaffinity", "memfd_create", "posix_fallocate", "O_PATH"} <= hidden
    done = run_on(systems.MACOS, ON_MACOS, tmp_path)
    assert (done.returncode, done.stdout.startswith("mean ΔE ")) == (0, True), done.stderr
    code, here, _ = command(
        "run", LIGHT, "--pixel.pitch-um", 8, "--display.dots", 8, "--out", tmp_path / "here"
    )
    assert code == 0
    assert done.stdout.splitlines()[:2] == here.splitlines()[:2]
    assert (tmp_path / "out/raw.exr").read_bytes() == (tmp_path / "here/raw.exr").read_bytes()
