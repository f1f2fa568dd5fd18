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
from pixsim.cli.doctor import NOTE, OK, PROBLEM, Diagnosis, doctor_document, requirements, satisfies
from pixsim.optics.camera import Camera
from pixsim.scene.variants import checks, graphics, trial, variant
from pixsim.show import render

OLD_LLVM = [str(path) for major in (14, 15) for path in sorted(Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{major}.so.1"))]
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

    def about(self, subject: str, room: str | None = None) -> dict[str, Any]:
        findings = self.result["findings"]
        (match,) = (finding for finding in findings if finding["subject"] == subject and room in (None, finding["room"]))
        return match

    @property
    def problems(self) -> list[str]:
        return [finding["subject"] for finding in self.result["findings"] if finding["mark"] == PROBLEM]

    @property
    def picture(self) -> dict[str, Any]:
        return next(finding for finding in self.result["findings"] if finding["room"] == "test render")


def visit(line: str = f"doctor --json --limit-s {HANG_S}", **changes: str | None) -> Visit:
    done = process(line, **{variant.LLVM_VARIABLE: None} | changes)
    assert done.returncode in (0, 1), done.stderr  # negative: ended by a signal
    assert "Traceback" not in done.stderr
    return Visit(done.returncode, done.stderr, json.loads(done.stdout))


def before(folder: Path) -> dict[str, str]:
    """Environment in which modules in a folder take precedence."""
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def written(root: Path, files: dict[str, str]) -> Path:
    """Write files to a folder and return it."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return root


# --- This machine ---


@pytest.mark.slow  # ten seconds of imports; the parts of a visit are tested one by one
def test_doctor_working_machine_has_no_problems():
    visited = visit()
    assert (visited.code, visited.result["ok"], visited.problems) == (0, True, [])
    assert visited.picture["mark"] == OK
    facts = visited.picture["facts"]
    assert abs(facts["mean_lx"] / facts["expected_lx"] - 1) < trial.MAX_MEAN_ERROR
    assert 0 < facts["render_s"] < facts["seconds"]
    groups = dict.fromkeys(finding["room"] for finding in visited.result["findings"])
    assert list(groups) == ["software", "LLVM", "Mitsuba", "machine", "folders", "optional", "test render"]
    versions = visited.about("packages")["facts"]["versions"]
    assert {"mitsuba", "drjit", "numpy", "scipy", "colour-science", "openexr"} <= set(versions)
    assert None not in versions.values()
    assert "llvm_ad_spectral" in visited.about("compiled in")["facts"]["variants"]
    assert visited.about("scalar_spectral", "Mitsuba")["mark"] == OK
    # The library that Mitsuba uses is the one that is said to be in use.
    used = [finding["facts"]["path"] for finding in visited.result["findings"] if finding["found"].endswith(", used")]
    assert used == [facts["llvm"]] * (facts["llvm"] is not None)
    assert facts["llvm"] is None or os.path.realpath(facts["llvm"]) in facts["mapped_llvm"]


def test_closed_form_lx_matches_hand_calculation():
    """Calculated by hand: mean 0.5125 of 1000 cd/m², π/(1 + 4·16·1.00387²) sr on the axis at f/4, f = 3.86 mm, 1 m."""
    camera = Camera()
    illuminance_lx = checks.closed_form_lx(camera, 16)
    magnification = 3.86e-3 / (1 - 3.86e-3)
    on_axis = np.pi / (1 + 64 * (1 + magnification) ** 2)
    assert illuminance_lx[7:9, 7:9].mean() / (512.5 * on_axis) == pytest.approx(1, abs=0.1)  # contrast 0.1 there
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
    llvm = [finding for finding in visited.result["findings"] if finding["room"] == "LLVM"]
    system = [finding for finding in llvm if finding["facts"].get("origin") == variant.SYSTEM]
    if any(finding["facts"]["fault"] is None for finding in system):
        pytest.skip("this system has a usable LLVM")
    assert (visited.code, visited.problems, visited.picture["subject"]) == (0, [], "scalar_spectral")
    assert [visited.about(subject)["mark"] for subject in ("llvm_ad_spectral", "libraries", "cache")] == [NOTE] * 3
    assert all("15 or older" in finding["found"] for finding in system if "/libLLVM-15" in finding["found"])
    assert "karellen-llvm-core" in visited.about("libraries")["mend"] or variant.LLVM_VARIABLE in visited.about("libraries")["mend"]
    picture = visit(f"run flat --resolution 8 --display.dots 8 --json --out '{tmp_path / 'out'}'", **lacking)
    assert picture.code == 0
    assert "rendering with scalar_spectral, since no LLVM 17" in picture.err


def test_llvm_invalid_variable_is_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`test_find_llvm_unusable_variable_raises` has all kinds."""
    monkeypatch.setenv(variant.LLVM_VARIABLE, str(tmp_path / "gone"))
    libraries = trial.attempt("libraries", limit_s=HANG_S)
    findings = doctor._llvm(libraries, doctor.usable_llvm(libraries))
    (finding,) = (finding for finding in findings if finding.subject == variant.LLVM_VARIABLE)
    assert (finding.mark, finding.mend) == (PROBLEM, "unset DRJIT_LIBLLVM_PATH")
    assert "no such file" in finding.found
    assert doctor.usable_llvm(libraries) is None  # no fallback: `pixsim run` raises an error


# --- Mitsuba that fails, aborts, hangs, or is wrong ---


@pytest.mark.parametrize(
    ("text", "limit_s", "fault"),
    [
        ("raise ImportError('libfoo.so.3 is not there')", HANG_S, "fails: ImportError: libfoo.so.3 is not there"),
        (f"import time; time.sleep({HANG_S})", 2, r"hangs: stopped after \d+ s"),
    ],
    ids=["import", "hang"],
)
def test_render_broken_mitsuba_is_problem(text: str, limit_s: float, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(written(tmp_path / "broken", {"mitsuba.py": text}))
    finding = doctor._test_render(trial.attempt("render", limit_s=limit_s), None)
    assert finding.mark == PROBLEM
    assert re.fullmatch(fault, finding.found)
    assert "pip install --force-reinstall 'mitsuba==3.9.*'" in str(finding.mend)


# A whole visit; its parts: test_broken_packages_uses_lines_before_abort, test_render_broken_mitsuba_is_problem.
@pytest.mark.slow
def test_doctor_survives_aborting_mitsuba(tmp_path: Path):
    visited = visit(**before(written(tmp_path / "broken", {"mitsuba.py": "import os; os.abort()"})))
    assert visited.code == 1
    assert visited.problems == ["mitsuba", "Mitsuba"]  # the package, and the test render with it
    assert "dies of signal 6 (SIGABRT)" in visited.picture["found"]
    assert visited.about("scalar_spectral")["mark"] == NOTE


def test_fault_wrong_image_is_reported():
    right = {"mean_error": 1e-5, "rms_error": 4e-3}
    judge = lambda **error: trial.picture_fault(trial.Trial([right | error], 1.0, 0, ""))  # noqa: E731
    assert judge() is None
    for wrong in ({"mean_error": -0.01}, {"rms_error": 0.1}, {"mean_error": float("nan")}, {"rms_error": float("nan")}):
        assert "wrong" in str(judge(**wrong))
    assert trial.picture_fault(trial.Trial([], 1.0, 0, "")) == "gives no result"


def test_broken_packages_uses_lines_before_abort():
    imports = trial.attempt("imports", "json", "nowhere_at_all", "antigravity_of_a_test", limit_s=HANG_S)
    assert [line["module"] for line in imports.lines if "module" in line] == ["nowhere_at_all", "antigravity_of_a_test"]
    aborting = trial.Trial([{"importing": "numpy"}, {"importing": "OpenEXR"}], 0.1, -6, "")
    required = {"numpy": ">=2.0", "openexr": ">=3.4"}
    (finding,) = doctor._broken_packages(required, {"numpy": "2.1", "openexr": "3.5"}, aborting)
    assert (finding.subject, finding.mark) == ("openexr", PROBLEM)
    assert "dies of signal 6" in finding.found


def test_graphics_card_gives_finding():
    """A card that works is the default; one that does not is a note with its reason; no card at all is fine."""

    def found(card: graphics.GraphicsTrial, taken: str) -> tuple[Diagnosis, Diagnosis]:
        right = trial.Trial([{"mean_error": 1e-5, "rms_error": 4e-3}], 1.0, 0, "")
        (of_variant,) = (f for f in doctor._variants({taken: right}, taken, card) if f.subject == "cuda_ad_spectral")
        return of_variant, doctor._graphics(card)

    of_variant, of_machine = found(graphics.GraphicsTrial(None, "NVIDIA of a test, 8.0 GiB, CUDA 12.8", 1e9), "cuda_ad_spectral")
    assert (of_variant.mark, of_variant.found) == (OK, "works and is the default")
    assert (of_machine.mark, of_machine.found) == (OK, "NVIDIA of a test, 8.0 GiB, CUDA 12.8")
    fault = "its trial render fails: dies of signal 6 (SIGABRT)"
    of_variant, of_machine = found(graphics.GraphicsTrial(fault, "NVIDIA of a test", 1e9), "llvm_ad_spectral")
    assert (of_variant.mark, of_variant.found) == (NOTE, f"does not work: {fault}")
    assert (of_machine.mark, of_machine.found) == (NOTE, f"NVIDIA of a test; not used: {fault}")
    of_variant, of_machine = found(graphics.GraphicsTrial(graphics.NO_CARD), "llvm_ad_spectral")
    assert (of_variant.mark, of_machine.mark) == (OK, OK)
    assert of_machine.found == f"none usable: {graphics.NO_CARD}"


# --- Packages ---


def test_broken_packages_missing_or_old_are_problems():
    lines = ["numpy>=2.0", "mitsuba==3.9.*", "drjit", 'dask[distributed]>=2024.8; extra == "cluster"', "rich >=14.3"]
    required = requirements(lines)
    assert required == {"numpy": ">=2.0", "mitsuba": "==3.9.*", "drjit": "", "rich": ">=14.3"}
    versions = {"numpy": "1.26.4", "mitsuba": "3.9.1", "drjit": None, "rich": "14.3"}
    findings = list(doctor._broken_packages(required, versions, trial.Trial([], 0.1, 0, "")))
    assert [(finding.subject, finding.mark) for finding in findings] == [("numpy", PROBLEM), ("drjit", PROBLEM)]
    assert findings[0].mend == doctor.pip("numpy>=2.0")


def test_software_without_metadata_is_problem():
    findings = list(doctor._software({}, trial.Trial([], 0.1, 0, "")))
    assert [(finding.subject, finding.mark) for finding in findings if finding.mark != OK] == [("pixsim", PROBLEM)]
    assert "pip install -e" in str(findings[0].mend)


def test_module_of_returns_import_name():
    names = [doctor.module_of(package) for package in ("OpenEXR", "colour-science", "pillow", "a-b", "numpy")]
    assert names == ["OpenEXR", "colour", "PIL", "a_b", "numpy"]


@pytest.mark.parametrize(
    ("version", "allowed", "expected"),
    [("2.0.0rc1", ">=2.0", True), ("1.26.4", ">=2.0", False), ("10.0", ">=9", True), ("3.9", "==3.9.*", True),
     ("3.10.0", "==3.9.*", False), ("1.0+cpu2", ">=1.0", True), ("1", "", True), ("not a version", ">=1", False)],
)  # fmt: skip
def test_satisfies_compares_versions(version: str, allowed: str, expected: bool):
    assert satisfies(version, allowed) == expected


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
    root = written(tmp_path, files | {"proc/meminfo": "MemTotal: 4194304 kB\nMemAvailable: 2097152 kB\n"})
    assert machine.processors(root).granted == 1.5
    assert machine.processors(root).usable == 1
    assert machine.memory(root) == machine.Memory(4 << 30, 2 << 30, 512 << 20)
    assert machine.memory(root).usable == 512 << 20


def test_machine_unknown_limits_are_none(tmp_path: Path):
    assert machine.processors(tmp_path).granted is None
    assert machine.memory(tmp_path) == machine.Memory(None, None, None)
    broken = written(tmp_path, {"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": "max", "sys/fs/cgroup/memory.max": ""})
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
        ("PIXSIM_CACHE_GIB", "lots", PROBLEM, "unset PIXSIM_CACHE_GIB"),
        ("PIXSIM_CACHE_GIB", "0", OK, None),
        ("PIXSIM_CACHE_DIR", "/dev/null/there", NOTE, "export PIXSIM_CACHE_DIR=FOLDER"),
    ],
)
def test_cache_settings_give_mark_and_fix(name: str, value: str, mark: str, fix: str | None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(name, value)
    finding = doctor._cache()
    assert (finding.mark, finding.mend) == (mark, fix)


def test_cache_without_home_is_problem(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("PIXSIM_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory.")))
    assert (doctor._cache().mark, doctor._cache().mend) == (PROBLEM, "export PIXSIM_CACHE_DIR=FOLDER")


# --- The report ---


def test_report_wraps_text_but_not_commands():
    fix = "export A=" + "x" * 200
    bad = Diagnosis("group", "bad", PROBLEM, "word " * 60, fix)
    findings = [Diagnosis("group", "good", OK, "text"), bad, Diagnosis("b", "c", NOTE, "-")]
    lines = render.text(doctor_document(findings), 80).splitlines()
    assert lines[:2] == ["group", "  ok       good  text"]
    assert lines[2].startswith("  problem  bad   word ")
    assert f"           to fix it: {fix}" in lines
    assert lines[-4:-1] == ["b", "  note     c     -", ""]
    assert max(len(line) for line in lines if fix not in line) <= 80
    assert lines[-1] == "pixsim does not work on this machine: 1 problem, 1 note"
    assert render.text(doctor_document(findings[::2])).splitlines()[-1] == "renders work on this machine: 0 problems, 1 note"
