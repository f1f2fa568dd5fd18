"""Choice of a Mitsuba variant with libraries that are too old, broken, missing or usable, in
separate processes.
"""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import os
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.processes import HANG_S

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.scene.variants import variant

PLACES = "lib/*-linux-gnu", "lib64"
OLD_SYSTEM_LLVM = [
    str(path)
    for place in PLACES
    for path in sorted(Path("/usr").glob(f"{place}/libLLVM-1[1-6].so*"))
]


def wheel_installed() -> bool:
    try:
        return bool(importlib.metadata.version(variant.LLVM_WHEEL))
    except importlib.metadata.PackageNotFoundError:
        return False


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a new process whose LLVM is chosen by `environment` only."""
    clean = {key: value for key, value in os.environ.items() if key != variant.LLVM_VARIABLE}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, env=clean | environment, capture_output=True, text=True, timeout=HANG_S
    )


@pytest.fixture
def fresh(monkeypatch):
    """Clear the cache of `choose`; the variable is set, since another test may have imported
    Dr.Jit.
    """
    monkeypatch.setenv(variant.LLVM_VARIABLE, "of a test")
    variant.choose.cache_clear()
    yield monkeypatch
    variant.choose.cache_clear()


# --- Versions of libraries ---


def test_llvm_version_missing_function_is_0():
    name = ctypes.util.find_library("m")  # stands for LLVM 15, which has no LLVMGetVersion either
    if name is None:
        pytest.skip("no libm to load")
    assert variant.llvm_version(name) == 0


def test_llvm_version_other_file_raises(tmp_path):
    (tmp_path / "libLLVM.so").write_text("not a library")
    for name in ("libLLVM.so", "nowhere.so"):
        with pytest.raises(OSError, match=r"libLLVM|nowhere"):
            variant.llvm_version(str(tmp_path / name))


@pytest.mark.skipif(not OLD_SYSTEM_LLVM, reason="no LLVM 11 to 16 on this system")
def test_find_llvm_old_system_library_is_rejected():
    for path in OLD_SYSTEM_LLVM:
        assert variant.llvm_version(path) in range(variant.OLDEST_LLVM)


def fake_llvm(folder: Path, major: int) -> str:
    """Build a library that reports this version of LLVM."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    source = (
        f"void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) {{ *a = {major}; if (b) *b ="
        " 0; if (c) *c = 0; }"
    )
    library = folder / f"libLLVM-{major}.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", library],
        input=source,
        text=True,
        check=True,
    )
    return str(library)


@pytest.mark.parametrize(("major", "usable"), [(16, False), (17, True), (21, True)])
def test_find_llvm_oldest_version_is_17(tmp_path, fresh, major, usable):
    library = fake_llvm(tmp_path, major)
    assert variant.llvm_version(library) == major
    fresh.setenv(variant.LLVM_VARIABLE, library)
    if usable:
        chosen = variant.ChosenVariant(
            "llvm_ad_spectral", library, f"{variant.LLVM_VARIABLE}, LLVM {major}"
        )
        assert variant.choose("llvm_ad_spectral") == chosen
    else:
        with pytest.raises(
            PixsimError, match=r"which is version 16; allowed: LLVM 17 or newer\. Unset it"
        ):
            variant.choose()


# --- The order of choice ---


def test_find_llvm_order_is_variable_system_wheel(tmp_path, fresh):
    old, chosen, system, wheel = (fake_llvm(tmp_path, major) for major in (16, 18, 19, 21))
    fresh.setattr(variant, "_system_candidates", lambda: [old, system])
    fresh.setattr(variant, "_wheel_candidates", lambda: [wheel])
    fresh.setenv(variant.LLVM_VARIABLE, chosen)
    assert variant.find_llvm() == (chosen, "DRJIT_LIBLLVM_PATH, LLVM 18")
    fresh.delenv(variant.LLVM_VARIABLE)
    assert variant.find_llvm() == (system, "system, LLVM 19")
    fresh.setattr(variant, "_system_candidates", lambda: [old])
    assert variant.find_llvm() == (wheel, "karellen-llvm-core, LLVM 21")
    fresh.setattr(variant, "_wheel_candidates", lambda: [])
    assert variant.find_llvm() == (None, "no LLVM 17 or newer was found")


def test_choose_repeated_is_equal(tmp_path, fresh):
    """`choose` sets the variable for Dr.Jit, which must not count as the user's choice later."""
    system = fake_llvm(tmp_path, 19)
    fresh.setattr(variant, "_system_candidates", lambda: [system])
    fresh.setenv(variant.LLVM_VARIABLE, "")
    fresh.delitem(
        sys.modules, "drjit", raising=False
    )  # else too late to choose, after another test
    first = variant.choose()
    assert os.environ[variant.LLVM_VARIABLE] == system
    variant.choose.cache_clear()
    assert variant.choose() == first
    assert variant.choose("llvm_ad_spectral") == replace(first, reason="system, LLVM 19")


def test_newest_first_resolves_links(tmp_path):
    for name in ("libLLVM-9.so.1", "libLLVM-21.so", "libLLVM.so.18.1"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-9.so.1")
    result = variant._newest_first(tmp_path.iterdir())
    assert [Path(path).name for path in result] == [
        "libLLVM-21.so",
        "libLLVM.so.18.1",
        "libLLVM-9.so.1",
    ]


# --- The user's variable ---


RUN_WITH_EACH = """
import os, sys
from pixsim.cli import main
out, *paths = sys.argv[1:]
for path in paths:
    os.environ["DRJIT_LIBLLVM_PATH"] = path
    try:
        main(["run", "flat", "-D", "resolution=8", "--out", out])
    except SystemExit as end:
        print(end.code)
"""


def test_find_llvm_unusable_variable_raises(tmp_path):
    (tmp_path / "broken.so").write_text("not a library")
    old = OLD_SYSTEM_LLVM[0] if OLD_SYSTEM_LLVM else ctypes.util.find_library("m")
    faults = {
        str(tmp_path / "broken.so"): "which cannot be loaded (no library for this machine)",
        str(tmp_path / "nowhere.so"): "which cannot be loaded (no such file)",
        str(tmp_path): "which cannot be loaded (no library for this machine)",
    } | ({old: "which is version 15 or older"} if old else {})
    done = python(RUN_WITH_EACH, str(tmp_path / "out"), *faults)
    # Without the judgement Mitsuba aborts the process at the first render (signal 6) or quietly
    # takes another library.
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["2"] * len(faults)
    for path, message in faults.items():
        assert (
            f"DRJIT_LIBLLVM_PATH: got '{path}', {message}; allowed: LLVM 17 or newer."
            in done.stderr
        )
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


# --- Automatic choice ---

RENDER = """
import sys
import pixsim
scene = pixsim.load_scene("flat", resolution=8, spp=4)
assert pixsim.render(scene).illuminance_lx().max() > 0
print(scene.choice.variant)
print(scene.choice.llvm_path)
if sys.platform == "linux":
    print({line.split()[-1] for line in open("/proc/self/maps") if "libLLVM" in line})
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc/self/maps")
@pytest.mark.skipif(not wheel_installed(), reason=f"{variant.LLVM_WHEEL} is not installed")
def test_choose_with_wheel_loads_working_llvm():
    done = python(RENDER)
    assert done.returncode == 0, done.stderr
    name, path, mapped = done.stdout.splitlines()
    assert name == "llvm_ad_spectral"
    assert os.path.realpath(path) in mapped
    assert variant.llvm_version(path) >= 17


def test_choose_without_llvm_warns_with_hint(fresh):
    fresh.setattr(variant, "find_llvm", lambda: (None, "no LLVM 17 or newer was found"))
    with pytest.warns(
        UserWarning, match=r"scalar_spectral, since no LLVM 17.*pip install karellen-llvm-core"
    ):
        scene = pixsim.load_scene("flat", resolution=8)
    assert scene.choice.variant == "scalar_spectral"
    assert pixsim.render(scene).illuminance_lx().max() > 0
    with pytest.raises(
        PixsimError, match=r"got 'llvm_ad_spectral', but no LLVM 17.*pip install karellen-llvm-core"
    ):
        pixsim.load_scene("flat", variant="llvm_ad_spectral")


def test_choose_scalar_needs_no_llvm(fresh):
    fresh.setattr(variant, "find_llvm", lambda: pytest.fail("looked for an LLVM"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert variant.choose("scalar_spectral").variant == "scalar_spectral"


@pytest.mark.parametrize("name", ["scalar_rgb", "llvm", ""])
def test_choose_unknown_variant_raises(name):
    with pytest.raises(
        PixsimError, match=rf"variant: got '{name}'; allowed: llvm_ad_spectral, scalar_spectral"
    ):
        variant.choose(name)


# --- Dr.Jit imported first, perhaps with an LLVM that aborts ---


@pytest.mark.slow  # the next but one warns of it or raises
def test_choose_after_drjit_renders_scalar():
    done = python("import drjit" + RENDER)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "scalar_spectral"


def test_choose_after_drjit_warns_or_raises():
    code = """import drjit
import pixsim
try:
    print(pixsim.load_scene("flat", variant="llvm_ad_spectral").choice.variant)
except pixsim.PixsimError as error:
    print("refused:", error)
"""
    done = python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(("llvm_ad_spectral", "refused:"))
