"""Which Mitsuba variant runs: libraries that are too old, broken, missing or fine, each in a process of its own."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from helpers.processes import HANG_S

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.scene import variant

OLD_SYSTEM_LLVM = [
    str(path)
    for pattern in ("lib/*-linux-gnu/libLLVM-1[1-6].so*", "lib64/libLLVM-1[1-6].so*")
    for path in sorted(Path("/usr").glob(pattern))
]


def wheel_installed() -> bool:
    try:
        return bool(importlib.metadata.version(variant.LLVM_WHEEL))
    except importlib.metadata.PackageNotFoundError:
        return False


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh process that has no LLVM chosen for it but by `environment`."""
    clean = {key: value for key, value in os.environ.items() if key != variant.LLVM_VARIABLE}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, env=clean | environment, capture_output=True, text=True, timeout=HANG_S)


@pytest.fixture
def fresh(monkeypatch):
    """`choose` anew; the variable is set, since without it Dr.Jit, imported by another test, would settle the matter."""
    monkeypatch.setenv(variant.LLVM_VARIABLE, "of a test")
    variant.choose.cache_clear()
    yield monkeypatch
    variant.choose.cache_clear()


# --- Judging a library ---


def test_a_library_without_a_version_is_too_old():
    name = ctypes.util.find_library("m")  # stands for LLVM 15, which has no LLVMGetVersion either
    if name is None:
        pytest.skip("no libm to load")
    assert variant.llvm_version(name) == 0


def test_what_is_no_library_has_no_version(tmp_path):
    (tmp_path / "libLLVM.so").write_text("not a library")
    assert variant.llvm_version(str(tmp_path / "libLLVM.so")) is None
    assert variant.llvm_version(str(tmp_path / "nowhere.so")) is None


@pytest.mark.skipif(not OLD_SYSTEM_LLVM, reason="no LLVM 11 to 16 on this system")
def test_an_old_system_llvm_is_too_old():
    for path in OLD_SYSTEM_LLVM:
        version = variant.llvm_version(path)
        assert version is not None
        assert version < variant.OLDEST_LLVM


def fake_llvm(folder: Path, major: int) -> str:
    """A library that says that it is this version of LLVM."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    source = f"void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) {{ *a = {major}; if (b) *b = 0; if (c) *c = 0; }}"
    library = folder / f"libLLVM-{major}.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", library], input=source, text=True, check=True)
    return str(library)


@pytest.mark.parametrize(("major", "usable"), [(16, False), (17, True), (21, True)])
def test_the_oldest_usable_version_is_17(tmp_path, fresh, major, usable):
    library = fake_llvm(tmp_path, major)
    assert variant.llvm_version(library) == major
    fresh.setenv(variant.LLVM_VARIABLE, library)
    if usable:
        assert variant.choose() == variant.Choice("llvm_ad_spectral", library, f"{variant.LLVM_VARIABLE}, LLVM {major}")
    else:
        with pytest.raises(PixsimError, match=r"which is version 16; allowed: LLVM 17 or newer\. Unset it"):
            variant.choose()


# --- The order of choice ---


def test_the_variable_comes_before_the_system_and_the_system_before_the_wheel(tmp_path, fresh):
    old, own, system, wheel = (fake_llvm(tmp_path, major) for major in (16, 18, 19, 21))
    fresh.setattr(variant, "_system_candidates", lambda: [old, system])
    fresh.setattr(variant, "_wheel_candidates", lambda: [wheel])
    fresh.setenv(variant.LLVM_VARIABLE, own)
    assert variant.find_llvm() == (own, "DRJIT_LIBLLVM_PATH, LLVM 18")
    fresh.delenv(variant.LLVM_VARIABLE)
    assert variant.find_llvm() == (system, "system, LLVM 19")
    fresh.setattr(variant, "_system_candidates", lambda: [old])
    assert variant.find_llvm() == (wheel, "karellen-llvm-core, LLVM 21")
    fresh.setattr(variant, "_wheel_candidates", lambda: [])
    assert variant.find_llvm() == (None, "no LLVM 17 or newer was found")


def test_a_choice_is_the_same_however_often_it_is_made(tmp_path, fresh):
    """`choose` sets the variable for Dr.Jit: that must not look like the user's own choice the next time."""
    system = fake_llvm(tmp_path, 19)
    fresh.setattr(variant, "_system_candidates", lambda: [system])
    fresh.setenv(variant.LLVM_VARIABLE, "")
    fresh.delitem(sys.modules, "drjit", raising=False)  # else too late to choose, after another test
    first = variant.choose()
    assert os.environ[variant.LLVM_VARIABLE] == system
    variant.choose.cache_clear()
    assert variant.choose("llvm_ad_spectral") == variant.choose() == first
    assert first.reason == "system, LLVM 19"


def test_newer_libraries_come_first_and_links_once(tmp_path):
    for name in ("libLLVM-9.so.1", "libLLVM-21.so", "libLLVM.so.18.1"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-9.so.1")
    found = variant._newest_first(tmp_path.iterdir())
    assert [Path(path).name for path in found] == ["libLLVM-21.so", "libLLVM.so.18.1", "libLLVM-9.so.1"]


def test_what_is_installed_by_hand_is_found_but_not_taken(tmp_path, fresh):
    library = fake_llvm(tmp_path, 19)
    fresh.setenv(variant.LLVM_VARIABLE, "")
    fresh.setenv("LD_LIBRARY_PATH", str(tmp_path))
    fresh.setattr(variant, "_system_candidates", lambda: [])
    fresh.setattr(variant, "_wheel_candidates", lambda: [])
    assert os.path.realpath(library) in variant.found_by_hand()
    assert variant.find_llvm()[0] is None
    fresh.setattr(variant, "_system_candidates", lambda: [os.path.realpath(library)])
    assert os.path.realpath(library) not in variant.found_by_hand()


# --- The user's variable ---


@pytest.mark.parametrize("kind", ["too old", "no library", "missing", "folder"])
def test_an_unusable_library_in_the_variable_stops_with_a_message(tmp_path, kind):
    (tmp_path / "broken.so").write_text("not a library")
    old = ctypes.util.find_library("m")
    path, message = {
        "too old": (OLD_SYSTEM_LLVM[0] if OLD_SYSTEM_LLVM else old, "which is version 15 or older"),
        "no library": (str(tmp_path / "broken.so"), "which cannot be loaded (no library for this machine)"),
        "missing": (str(tmp_path / "nowhere.so"), "which cannot be loaded (no such file)"),
        "folder": (str(tmp_path), "which cannot be loaded (it is a folder)"),
    }[kind]
    if path is None:
        pytest.skip("no library to load")
    command = ["pixsim", "run", "flat", "-D", "resolution=8", "--out", str(tmp_path / "out")]
    code = "import sys; sys.argv = sys.argv[1:]; from pixsim.cli import main; main()"
    done = python(code, *command, **{variant.LLVM_VARIABLE: path})
    # Without the judgement Mitsuba aborts the process at the first render (signal 6) or quietly takes another library.
    assert done.returncode == 2, done.stderr
    assert f"DRJIT_LIBLLVM_PATH: got '{path}', {message}; allowed: LLVM 17 or newer." in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


# --- What is taken by itself ---

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
def test_with_the_wheel_an_llvm_that_works_is_loaded():
    done = python(RENDER)
    assert done.returncode == 0, done.stderr
    name, path, mapped = done.stdout.splitlines()
    assert name == "llvm_ad_spectral"
    assert os.path.realpath(path) in mapped
    assert variant.llvm_version(path) >= 17


def test_without_llvm_the_slow_variant_says_how_to_get_the_fast_one(fresh):
    fresh.setattr(variant, "find_llvm", lambda: (None, "no LLVM 17 or newer was found"))
    with pytest.warns(UserWarning, match=r"scalar_spectral, since no LLVM 17.*pip install karellen-llvm-core"):
        scene = pixsim.load_scene("flat", resolution=8)
    assert scene.choice.variant == "scalar_spectral"
    assert pixsim.render(scene).illuminance_lx().max() > 0
    with pytest.raises(PixsimError, match=r"got 'llvm_ad_spectral', but no LLVM 17.*pip install karellen-llvm-core"):
        pixsim.load_scene("flat", variant="llvm_ad_spectral")


def test_scalar_needs_no_llvm_and_no_warning(fresh):
    fresh.setattr(variant, "find_llvm", lambda: pytest.fail("looked for an LLVM"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert variant.choose("scalar_spectral").variant == "scalar_spectral"


@pytest.mark.parametrize("name", ["scalar_rgb", "llvm", ""])
def test_another_variant_is_refused(name):
    with pytest.raises(PixsimError, match=rf"variant: got '{name}'; allowed: llvm_ad_spectral, scalar_spectral"):
        variant.choose(name)


# --- Dr.Jit was there first, and may have found an LLVM that aborts ---


def test_after_drjit_a_render_still_works():
    done = python("import drjit" + RENDER)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "scalar_spectral"


def test_after_drjit_no_variant_is_swapped_in_silence():
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
