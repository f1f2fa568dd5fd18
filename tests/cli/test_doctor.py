"""The doctor on machines that lack something, or whose Mitsuba aborts, hangs or renders wrongly."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import output_of
from helpers.processes import HANG_S

from pixsim.base import machine
from pixsim.cli import doctor
from pixsim.cli.doctor import NOTE, OK, PROBLEM
from pixsim.optics.camera import Camera
from pixsim.scene import trial
from pixsim.scene.variants import graphics, variant


def written(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return root


# --- This machine ---


def test_doctor_on_this_machine_has_no_problems():
    findings = json.loads(output_of(f"doctor --json --limit-s {HANG_S}"))["findings"]
    facts_of = {finding["subject"]: finding["facts"] for finding in findings}
    facts = facts_of["test render"]
    assert facts["mean_lx"] == pytest.approx(facts["expected_lx"], rel=trial.MAX_MEAN_ERROR)
    # The library that the render used is the one that is said to be in use.
    assert facts_of["LLVM"]["path"] == facts["llvm"]


def test_closed_form_lx_matches_hand_calculation():
    """Calculated by hand: mean 0.5125 of 1000 cd/m², π/(1 + 4·16·1.00387²) sr on the axis at f/4, f
    = 3.86 mm, 1 m.
    """
    camera = Camera()
    magnification = 3.86e-3 / (1 - 3.86e-3)
    on_axis_lx = 512.5 * np.pi / (1 + 64 * (1 + magnification) ** 2)
    ratio = trial.closed_form_lx(camera, 16) / on_axis_lx
    assert ratio[7:9, 7:9].mean() == pytest.approx(1, abs=0.1)  # contrast 0.1 there
    assert ratio[:, 0].mean() < ratio[:, 7:9].mean()
    assert np.cos(np.arctan(camera.die_mm / 2 / camera.image_distance_mm)) ** 4 < ratio.mean() < 1


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
            0.5,
            r"hangs: stopped after 0\.5 s; a machine under load may need longer: --limit-s 1\.5",
        ),
    ],
    ids=["import", "hang"],
)
@pytest.mark.slow
def test_render_broken_mitsuba_is_problem(
    text: str, limit_s: float, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(written(tmp_path / "broken", {"mitsuba.py": text}))
    finding = doctor._test_render(limit_s)
    assert finding.mark == PROBLEM
    assert re.fullmatch(fault, finding.found)
    assert finding.mend == "pip install --force-reinstall mitsuba drjit"


def test_fault_wrong_image_is_reported():
    expected_lx = np.array([[1.0, 2.0], [3.0, 4.0]])
    noise = np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert trial.picture_fault(expected_lx + 1e-3 * noise, expected_lx) is None
    for wrong_lx in (0.99 * expected_lx, expected_lx + 0.2 * noise, np.nan * expected_lx):
        assert "wrong" in str(trial.picture_fault(wrong_lx, expected_lx))


CARD_FAULT = "its trial render fails: ends with signal 6 (SIGABRT)"


@pytest.mark.parametrize(
    ("trial_render", "mark", "words"),
    [
        (graphics.GraphicsTrial(None), OK, "works, and traces by default"),
        (graphics.GraphicsTrial(CARD_FAULT), NOTE, f"not used: {CARD_FAULT}"),
        (
            graphics.GraphicsTrial(graphics.NO_CARD, tried=False),
            OK,
            f"not used: {graphics.NO_CARD}",
        ),
    ],
)
def test_graphics_card_gives_finding(
    trial_render: graphics.GraphicsTrial, mark: str, words: str
) -> None:
    """A card that does not work is a note with its reason; no card at all is fine."""
    finding = doctor._graphics(trial_render)
    assert (finding.mark, finding.found) == (mark, words)


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
    processors = machine.processors(root)
    assert (processors.granted, processors.usable) == (1.5, 1)
    assert machine.memory(root) == machine.Memory(4 << 30, 2 << 30, 512 << 20)
    assert machine.memory(root).usable == 512 << 20


def test_check_folder_leaves_no_files(tmp_path: Path):
    fault, free = machine.check_folder(tmp_path / "a" / "b")
    assert (fault, bool(free), list(tmp_path.iterdir())) == (None, True, [])
    (tmp_path / "file").touch()
    answer = doctor.doctor_document([doctor._results(tmp_path / "file" / "b")])
    assert "cannot be written (Not a directory)" in str(answer.terminal)


@pytest.mark.parametrize(
    ("name", "value", "mark", "fix"),
    [
        ("PIXSIM_CACHE_GIB", "lots", PROBLEM, None),
        ("PIXSIM_CACHE_GIB", "0", OK, None),
        ("PIXSIM_CACHE_DIR", "/dev/null/there", NOTE, "export PIXSIM_CACHE_DIR=FOLDER"),
        (variant.LLVM_VARIABLE, "/dev/null/gone", PROBLEM, None),
    ],
)
def test_variables_give_mark_and_fix(
    name: str, value: str, mark: str, fix: str | None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv(name, value)
    finding = doctor._llvm() if name == variant.LLVM_VARIABLE else doctor._cache()
    assert (finding.mark, finding.mend) == (mark, fix)
