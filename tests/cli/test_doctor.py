"""The doctor on machines that lack something, or whose Mitsuba aborts, hangs or renders wrongly."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.commands import process
from helpers.processes import HANG_S

from pixsim.base import machine
from pixsim.cli import doctor
from pixsim.cli.doctor import NOTE, OK, PROBLEM, Diagnosis, doctor_document
from pixsim.optics.camera import Camera
from pixsim.scene import trial
from pixsim.scene.variants import graphics, variant
from pixsim.show import render

OLD_LLVM = [
    str(path)
    for major in (14, 15)
    for path in sorted(Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{major}.so.1"))
]
HIDES_THE_WHEEL = """
from importlib import metadata
def hidden(function):
    def without(name, *more):
        if name == "karellen-llvm-core":
            raise metadata.PackageNotFoundError(name)
        return function(name, *more)
    return without
metadata.files, metadata.version = hidden(metadata.files), hidden(metadata.version)
"""


@dataclass(frozen=True)
class Visit:
    """Result of `pixsim doctor --json`."""

    code: int
    err: str
    result: dict[str, Any]

    def about(self, subject: str) -> dict[str, Any]:
        (match,) = (finding for finding in self.result["findings"] if finding["subject"] == subject)
        return match

    @property
    def problems(self) -> list[str]:
        return [
            finding["subject"] for finding in self.result["findings"] if finding["mark"] == PROBLEM
        ]


def visit(line: str = f"doctor --json --limit-s {HANG_S}", **changes: str | None) -> Visit:
    done = process(line, **{variant.LLVM_VARIABLE: None} | changes)
    assert done.returncode in (0, 1), done.stderr  # negative: ended by a signal
    assert "Traceback" not in done.stderr
    return Visit(done.returncode, done.stderr, json.loads(done.stdout))


def before(folder: Path) -> dict[str, str]:
    """Environment in which modules in a folder take precedence."""
    return {
        "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    }


def written(root: Path, files: dict[str, str]) -> Path:
    """Write files to a folder and return it."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return root


# --- This machine ---


SUBJECTS = (
    "pixsim",
    "Python",
    "packages",
    "LLVM",
    "graphics card",
    "test render",
    "processors",
    "memory",
    "cache",
    "results",
)


@pytest.mark.slow  # a test render in a new process; the findings are tested one by one
def test_doctor_working_machine_has_no_problems():
    visited = visit()
    assert (visited.code, visited.result["ok"], visited.problems) == (0, True, [])
    assert tuple(finding["subject"] for finding in visited.result["findings"]) == SUBJECTS
    facts = visited.about("test render")["facts"]
    assert abs(facts["mean_lx"] / facts["expected_lx"] - 1) < trial.MAX_MEAN_ERROR
    assert facts["seconds"] > 0
    versions = visited.about("packages")["facts"]
    assert {"mitsuba", "drjit", "numpy", "scipy", "colour-science", "openexr"} <= {
        name.lower() for name in versions
    }
    # The library that the render used is the one that is said to be in use.
    assert visited.about("LLVM")["facts"]["path"] == facts["llvm"]


def test_closed_form_lx_matches_hand_calculation():
    """Calculated by hand: mean 0.5125 of 1000 cd/m², π/(1 + 4·16·1.00387²) sr on the axis at f/4, f
    = 3.86 mm, 1 m.
    """
    camera = Camera()
    illuminance_lx = trial.closed_form_lx(camera, 16)
    magnification = 3.86e-3 / (1 - 3.86e-3)
    on_axis = np.pi / (1 + 64 * (1 + magnification) ** 2)
    assert illuminance_lx[7:9, 7:9].mean() / (512.5 * on_axis) == pytest.approx(
        1, abs=0.1
    )  # contrast 0.1 there
    cos4 = np.cos(np.arctan(camera.die_mm / 2 / camera.image_distance_mm)) ** 4
    assert illuminance_lx[:, 0].mean() < illuminance_lx[:, 7:9].mean()
    assert cos4 < illuminance_lx.mean() / (512.5 * on_axis) < 1


# --- LLVM ---


@pytest.mark.slow
def test_doctor_old_libraries_no_home_no_cache_gives_notes(tmp_path: Path):
    """With the libraries of this system only; the wheel is hidden."""
    hidden = written(tmp_path / "hidden", {"sitecustomize.py": HIDES_THE_WHEEL})
    lacking = before(hidden) | {"HOME": None, "PIXSIM_CACHE_DIR": "/dev/null/there"}
    visited = visit(**lacking)
    if visited.about("LLVM")["facts"]["path"] is not None:
        pytest.skip("this system has a usable LLVM")
    assert (visited.code, visited.problems) == (0, [])
    assert visited.about("test render")["facts"]["variant"] == "scalar_spectral"
    assert [visited.about(subject)["mark"] for subject in ("LLVM", "cache")] == [NOTE] * 2
    assert "karellen-llvm-core" in visited.about("LLVM")["mend"]
    picture = visit(
        f"run flat --resolution 8 --display.dots 8 --json --out '{tmp_path / 'out'}'", **lacking
    )
    assert picture.code == 0
    assert "rendering with scalar_spectral, since no LLVM 17" in picture.err


def test_llvm_invalid_variable_is_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`test_find_llvm_unusable_variable_raises` has all kinds."""
    monkeypatch.setenv(variant.LLVM_VARIABLE, str(tmp_path / "gone"))
    finding = doctor._llvm()
    assert finding.mark == PROBLEM
    assert re.search("DRJIT_LIBLLVM_PATH: .*no such file.* Unset it", finding.found)


# --- Mitsuba that fails, aborts, hangs, or is wrong ---


@pytest.mark.parametrize(
    ("text", "limit_s", "fault"),
    [
        (
            "raise ImportError('libfoo.so.3 is not there')",
            HANG_S,
            "fails: ImportError: libfoo.so.3 is not there",
        ),
        (
            f"import time; time.sleep({HANG_S})",
            2,
            r"hangs: stopped after 2 s; a machine under load may need longer: --limit-s 6",
        ),
    ],
    ids=["import", "hang"],
)
def test_render_broken_mitsuba_is_problem(
    text: str, limit_s: float, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(written(tmp_path / "broken", {"mitsuba.py": text}))
    finding = doctor._test_render(limit_s)
    assert finding.mark == PROBLEM
    assert re.fullmatch(fault, finding.found)
    assert finding.mend == "pip install --force-reinstall mitsuba drjit"


@pytest.mark.slow  # a whole visit; its part: test_render_broken_mitsuba_is_problem
def test_doctor_survives_aborting_mitsuba(tmp_path: Path):
    visited = visit(**before(written(tmp_path / "broken", {"mitsuba.py": "import os; os.abort()"})))
    assert (visited.code, visited.problems) == (1, ["test render"])
    assert "dies of signal 6 (SIGABRT)" in visited.about("test render")["found"]


def test_fault_wrong_image_is_reported():
    expected_lx = np.array([[1.0, 2.0], [3.0, 4.0]])
    noise = np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert trial.picture_fault(expected_lx + 1e-3 * noise, expected_lx) is None
    for wrong_lx in (0.99 * expected_lx, expected_lx + 0.2 * noise, np.nan * expected_lx):
        assert "wrong" in str(trial.picture_fault(wrong_lx, expected_lx))


def test_graphics_card_gives_finding():
    """A card that does not work is a note with its reason; no card at all is fine."""
    works = doctor._graphics(graphics.GraphicsTrial(None))
    assert (works.mark, works.found) == (OK, "works, and traces by default")
    fault = "its trial render fails: dies of signal 6 (SIGABRT)"
    fails = doctor._graphics(graphics.GraphicsTrial(fault))
    assert (fails.mark, fails.found) == (NOTE, f"not used: {fault}")
    absent = doctor._graphics(graphics.GraphicsTrial(graphics.NO_CARD, tried=False))
    assert (absent.mark, absent.found) == (OK, f"not used: {graphics.NO_CARD}")


# --- The machine ---


VERSION_2 = {
    "proc/self/cgroup": "0::/a/b\n",
    "sys/fs/cgroup/a/cpu.max": "150000 100000\n",
    "sys/fs/cgroup/a/b/cpu.max": "max 100000\n",
    "sys/fs/cgroup/memory.max": "max\n",
    "sys/fs/cgroup/a/b/memory.max": "536870912\n",
}
VERSION_1 = {
    "proc/self/cgroup": "5:cpu,cpuacct:/job\n4:memory:/job\n0::/\n",
    "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us": "150000",
    "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us": "100000",
    "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712",
    "sys/fs/cgroup/memory/job/memory.limit_in_bytes": "536870912",
}


@pytest.mark.parametrize("files", [VERSION_2, VERSION_1], ids=["version 2", "version 1"])
def test_machine_container_limits_apply(files: dict[str, str], tmp_path: Path):
    root = written(
        tmp_path, files | {"proc/meminfo": "MemTotal: 4194304 kB\nMemAvailable: 2097152 kB\n"}
    )
    assert machine.processors(root).granted == 1.5
    assert machine.processors(root).usable == 1
    assert machine.memory(root) == machine.Memory(4 << 30, 2 << 30, 512 << 20)
    assert machine.memory(root).usable == 512 << 20


def test_machine_unknown_limits_are_none(tmp_path: Path):
    assert machine.processors(tmp_path).granted is None
    assert machine.memory(tmp_path) == machine.Memory(None, None, None)
    broken = written(
        tmp_path,
        {
            "proc/self/cgroup": "0::/\n",
            "sys/fs/cgroup/cpu.max": "max",
            "sys/fs/cgroup/memory.max": "",
        },
    )
    assert machine.processors(broken).granted is None
    assert machine.memory(broken).usable is None


def test_check_folder_leaves_no_files(tmp_path: Path):
    fault, free = machine.check_folder(tmp_path / "a" / "b")
    assert fault is None
    assert free
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    assert machine.check_folder(tmp_path / "file" / "b")[0] == "Not a directory"


@pytest.mark.parametrize(
    ("name", "value", "mark", "fix"),
    [
        ("PIXSIM_CACHE_GIB", "lots", PROBLEM, None),
        ("PIXSIM_CACHE_GIB", "0", OK, None),
        ("PIXSIM_CACHE_DIR", "/dev/null/there", NOTE, "export PIXSIM_CACHE_DIR=FOLDER"),
    ],
)
def test_cache_settings_give_mark_and_fix(
    name: str, value: str, mark: str, fix: str | None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv(name, value)
    finding = doctor._cache()
    assert (finding.mark, finding.mend) == (mark, fix)


def test_cache_without_home_is_problem(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("PIXSIM_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(
        Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory."))
    )
    assert (doctor._cache().mark, doctor._cache().mend) == (PROBLEM, None)


# --- The report ---


def test_report_wraps_text_but_not_commands():
    mend = "export A=" + "x" * 200
    bad = Diagnosis("bad", PROBLEM, "word " * 60, mend)
    findings = [Diagnosis("good", OK, "text"), bad, Diagnosis("c", NOTE, "-")]
    lines = render.text(doctor_document(findings), 80).splitlines()
    assert lines[0].split() == ["ok", "good", "text"]
    assert lines[1].split()[:3] == ["problem", "bad", "word"]
    assert any(line.strip() == f"to fix it: {mend}" for line in lines)
    assert max(len(line) for line in lines if mend not in line) <= 80
    assert lines[-1] == "pixsim does not work on this machine"
    assert (
        render.text(doctor_document(findings[::2])).splitlines()[-1]
        == "renders work on this machine"
    )
