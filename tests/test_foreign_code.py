"""Nothing in the current folder is run, by a command, its workers, or any other process that it
starts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from helpers.commands import process
from helpers.processes import HANG_S
from helpers.tiny import tiny_toml

import pixsim

HOME = str(Path(pixsim.__file__).parents[1])
SMALL = "--resolution 32 --display.dots 32 --render-noise 10"
# A child renders the scene, and workers evaluate it.
COMPARE = f"compare 0.35um 0.25um --scene own.xml --jobs 2 --repeats 2 {SMALL} --out compare"


NAMES = [
    name
    for name in sorted(
        {*sys.stdlib_module_names, *packages_distributions(), "sitecustomize", "usercustomize"}
    )
    if name.isidentifier()
]
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
    for name in ("spectra", "charts"):
        shutil.copytree(Path(HOME, "scenes", name), place / name)
    scene = Path(HOME, "scenes/line_lamp.xml").read_text(encoding="utf-8")
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


def run(line: str, folder: Path, **variables: str) -> None:
    done = process(line, folder=folder, **variables)
    assert done.returncode == 0, done.stderr


def test_no_module_of_the_current_folder_is_run(folder: Path) -> None:
    """Of any name of the standard library and of the packages that are installed; by a child that
    renders, and by workers.
    """
    log = plant(folder, NAMES)
    run(COMPARE, folder, PYTHONPATH=HOME)
    assert not log.exists(), log.read_text()


WITH_WORKERS = """
from pixsim.base.children import leave_current_folder
leave_current_folder()  # the first thing that a command does
import operator
from pixsim.studies.engine import Workers, results_of
print(sorted(results_of(operator.add, [(task, int) for task in (1, 2, 3)], Workers(2))))
"""


def test_empty_parts_of_variables_are_not_the_current_folder(folder: Path) -> None:
    """Of PYTHONPATH and PATH; but for what Python itself imports before the first line of a
    command.
    """
    log = plant(
        folder,
        ["joblib", "multiprocessing", "numpy", "scipy", "pydantic", "matplotlib", "mitsuba", "PIL"],
    )
    variables = {"PYTHONPATH": f":{HOME}:", "PATH": f":{os.environ['PATH']}"}
    run("plan flat", folder, **variables)
    command = [sys.executable, "-P", "-c", WITH_WORKERS]
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert (done.stdout, log.exists()) == ("[1, 2, 3]\n", False), done.stderr


MINE = "def double(task, _):\n    return 2 * task\n"
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
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    (tmp_path / "script.py").write_text(SCRIPT_OF_USER, encoding="utf-8")
    log = plant(folder, ["joblib", "multiprocessing", "numpy"])
    environment = {
        name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"
    } | {"PYTHONPATH": HOME}
    command = [sys.executable, tmp_path / "script.py"]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=HANG_S
    )
    assert (done.stdout, log.exists()) == ("[2, 4, 6]\nTrue False\n", False), done.stderr
