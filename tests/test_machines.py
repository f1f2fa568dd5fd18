"""The machine around a command: it may lack something, none of its other code is run, and tests
leave it as it was.
"""

import errno
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import types
from collections.abc import Sequence
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from helpers import systems
from helpers.commands import COMMAND, command, process
from helpers.machine import changes, files_below
from helpers.processes import HANG_S
from helpers.tiny import tiny_toml

import pixsim
from pixsim.base.notes import MachineWarning
from pixsim.scene import mitsuba
from pixsim.studies.engine import Workers, processes_work, results_of

# --- What a machine lacks: a result or a message, never a hang or a traceback
# ---------------------------------------------------------------------------------------------------


def double(task: int, _: None) -> tuple[int, int]:
    return 2 * task, os.getpid()


def test_without_shared_memory_one_process_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose /dev/shm is missing or cannot be written, where no lock of processes
    can be made.
    """

    def fails(*_) -> None:
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


# whole processes; test_without_what_windows_lacks_all_is_imported_and_light_evaluated is a machine that lacks something
@pytest.mark.slow
def test_few_open_files_are_a_message(tmp_path: Path) -> None:
    """The limit that the command starts with does for one process, but not for workers."""
    (tmp_path / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    done = subprocess.run(
        [COMMAND, "study", "tiny.toml", "--jobs", "2", "--out", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=HANG_S,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (24, 24)),
    )
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or "ulimit -n" in done.stderr


def rendered(answers) -> None:
    try:
        pixsim.render(
            pixsim.load_scene("flat", resolution=8, spp=4, variant="scalar_spectral"),
            pixsim.Camera(),
        )
    except pixsim.PixsimError as error:
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


def python(
    *words: str | Path, folder: Path, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )


@pytest.mark.slow
def test_without_what_windows_lacks_all_is_imported_and_light_evaluated(tmp_path: Path) -> None:
    """The number is that of this machine; files, which need locks of folders, are refused with what
    to do.
    """
    done = python(systems.__file__, systems.WINDOWS, ON_WINDOWS, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    number, refused, *_ = done.stdout.splitlines()
    here: dict = {}
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


# test_without_what_windows_lacks_all_is_imported_and_light_evaluated lacks more
@pytest.mark.slow
def test_without_what_macos_lacks_light_is_run_into_a_folder(tmp_path: Path) -> None:
    hidden = systems.missing("os", systems.MACOS)
    assert {"sched_getaffinity", "memfd_create", "posix_fallocate", "O_PATH"} <= hidden
    done = python(systems.__file__, systems.MACOS, ON_MACOS, folder=tmp_path)
    assert (done.returncode, done.stdout.startswith("mean ΔE ")) == (0, True), done.stderr
    code, here, _ = command(
        "run --pixel.pitch-um 8 --display.dots 8 --out", tmp_path / "here", LIGHT
    )
    assert code == 0
    assert done.stdout.splitlines()[:2] == here.splitlines()[:2]
    assert (tmp_path / "out/raw.exr").read_bytes() == (tmp_path / "here/raw.exr").read_bytes()


# --- Foreign code: nothing in the current folder is run, by a command, its workers, or any other
# process that it starts
# ---------------------------------------------------------------------------------------------------

HOME = str(Path(pixsim.__file__).parents[1])
SMALL = "--resolution 32 --display.dots 32 --render-noise 10"
# A child renders the scene, and workers evaluate it.
COMPARE = f"compare 0.35um 0.25um --scene own.xml --jobs 2 --repeats 2 {SMALL} --out compare"


CODE = "open({log!r}, 'a').write({name!r} + '\\n')\nraise ImportError('of the current folder')\n"
SCRIPT = '#!/bin/sh\necho {name} >> "{log}"\n'
PROGRAMS = (
    "nvidia-smi",
    "ldconfig",
    "fc-list",
    "lscpu",
    "gcc",
    "cc",
    "ld",
    "uname",
    "python",
    "python3",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A current folder with files that commands take."""
    place = tmp_path / "theirs"
    place.mkdir()
    (place / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    shutil.copytree(Path(HOME, "scenes/charts"), place / "charts")
    scene = Path(HOME, "scenes/flat.xml").read_text(encoding="utf-8")
    (place / "own.xml").write_text(
        f"{scene}<!-- not pixsim's: a child renders it -->", encoding="utf-8"
    )
    return place


def plant(folder: Path, names: Sequence[str]) -> Path:
    """Put a module of each name, and programs, into a folder; return the file where they write
    their names when they are run.
    """
    log = folder.parent / "log"
    for name in names:
        (folder / f"{name}.py").write_text(CODE.format(log=str(log), name=name), encoding="utf-8")
    for name in PROGRAMS:
        (folder / name).write_text(SCRIPT.format(log=log, name=name), encoding="utf-8")
        (folder / name).chmod(0o755)
    return log


@pytest.mark.slow
def test_no_module_of_the_current_folder_is_run(folder: Path) -> None:
    """Of any name of the standard library and of the packages that are installed; by a child that
    renders, and by workers.
    """
    names = {*sys.stdlib_module_names, *packages_distributions(), "sitecustomize", "usercustomize"}
    log = plant(folder, [name for name in names if name.isidentifier()])
    done = process(COMPARE, folder=folder, PYTHONPATH=HOME)
    assert done.returncode == 0, done.stderr
    assert not log.exists(), log.read_text()


WITH_WORKERS = """
from pixsim.base.children import leave_current_folder
leave_current_folder()  # the first thing that a command does
import operator
from pixsim.studies.engine import Workers, results_of
print(sorted(results_of(operator.add, [(task, int) for task in (1, 2, 3)], Workers(2))))
"""


# test_no_module_of_the_current_folder_is_run has the claim
@pytest.mark.slow
def test_empty_parts_of_variables_are_not_the_current_folder(folder: Path) -> None:
    """Of PYTHONPATH and PATH; but for what Python itself imports before the first line of a
    command.
    """
    log = plant(
        folder,
        ["joblib", "multiprocessing", "numpy", "scipy", "pydantic", "matplotlib", "mitsuba", "PIL"],
    )
    variables = {"PYTHONPATH": f":{HOME}:", "PATH": f":{os.environ['PATH']}"}
    assert process("plan flat", folder=folder, **variables).returncode == 0
    done = python("-P", "-c", WITH_WORKERS, folder=folder, environment=os.environ | variables)
    assert (done.stdout, log.exists()) == ("[1, 2, 3]\n", False), done.stderr


SCRIPT_OF_USER = """
import os
import mine
from pixsim.studies.engine import Workers, results_of

if __name__ == "__main__":
    names = "PATH", "PYTHONPATH", "PYTHONSAFEPATH"
    before = [os.environ.get(name) for name in names]
    print(sorted(results_of(mine.double, [(task, lambda: None) for task in (1, 2, 3)], Workers(2))))
    print([os.environ.get(name) for name in names] == before, "PYTHONSAFEPATH" in os.environ)
"""


def test_a_users_own_modules_reach_the_workers(folder: Path, tmp_path: Path) -> None:
    """Those beside the script; and the variables of its process are afterwards as before."""
    (tmp_path / "mine.py").write_text(
        "def double(task, _):\n    return 2 * task\n", encoding="utf-8"
    )
    (tmp_path / "script.py").write_text(SCRIPT_OF_USER, encoding="utf-8")
    log = plant(folder, ["joblib", "multiprocessing", "numpy"])
    environment = os.environ | {"PYTHONPATH": HOME}
    environment.pop("PYTHONSAFEPATH", None)
    done = python(tmp_path / "script.py", folder=folder, environment=environment)
    assert (done.stdout, log.exists()) == ("[2, 4, 6]\nTrue False\n", False), done.stderr


# --- The tests leave the machine as it was, which `machine_as_it_was` sees after each module
# ---------------------------------------------------------------------------------------------------


def test_home_and_temporary_files_are_of_the_run(own_places: tuple[Path, Path]) -> None:
    assert (Path.home(), Path(tempfile.gettempdir())) == own_places
    assert not changes(files_below(own_places[0]), files_below(own_places[0]))


def test_changes_name_each_file(tmp_path: Path) -> None:
    """New, gone, written, replaced by another of the same content, and of other permissions; in
    folders, too.
    """
    written, gone, replaced, opened = (
        tmp_path / name for name in ("below/written", "gone", "replaced", "open")
    )
    written.parent.mkdir()
    for path in (written, gone, replaced, opened, tmp_path / "same"):
        path.write_text("a")
        os.utime(path, ns=(1, 1))
    before = files_below(tmp_path)
    written.write_text("b")
    gone.rename(tmp_path / "new")
    replaced.unlink()
    replaced.symlink_to("same")
    opened.chmod(0o777)
    assert changes(before, files_below(tmp_path)) == [
        "below/written has changed",
        "gone is gone",
        "new is new",
        "open has changed",
        "replaced has changed",
    ]
