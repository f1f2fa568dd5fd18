"""Which variant of Mitsuba runs here: libraries of LLVM that are too old, broken, missing or usable,
and a graphics card with a driver of the tests.

No card is needed here: tests/references compares pictures of a real one.
"""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import ANY, Mock

import numpy as np
import pytest
from helpers.edits import VARIANT
from helpers.processes import HANG_S
from helpers.tiny import lit_sensors, tiny

import pixsim
from pixsim.scene import renderer
from pixsim.scene.convergence import render_until
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.job import TraceJob
from pixsim.scene.plan import make_render_plan
from pixsim.scene.trial import Trial
from pixsim.scene.variants import graphics, variant


@pytest.fixture
def fresh(monkeypatch):
    """Clear the cache of `choose`; the variable is set, since another test may have imported
    Dr.Jit.
    """
    monkeypatch.setenv(variant.LLVM_VARIABLE, "of a test")
    variant.choose.cache_clear()
    yield monkeypatch
    variant.choose.cache_clear()


# --- LLVM ---


SOURCE = """void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) {{
    *a = {}; if (b) *b = 0; if (c) *c = 0;
}}"""


def compiled(source: str, library: Path) -> str:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    line = ["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", library]
    subprocess.run(line, input=source, text=True, check=True)
    return str(library)


def fake_llvm(folder: Path, major: int) -> str:
    """Build a library that reports this version of LLVM."""
    return compiled(SOURCE.format(major), folder / f"libLLVM-{major}.so")


@pytest.mark.parametrize(
    ("stated", "systems", "wheels", "expected"),
    [
        ([17], [16, 19], [21], "DRJIT_LIBLLVM_PATH, LLVM 17"),
        ([], [16, 19], [21], "system, LLVM 19"),
        ([], [16], [21], "karellen-llvm-core, LLVM 21"),
        ([], [16], [], "no LLVM 17 or newer was found"),
    ],
)
def test_order_of_choice_is_variable_system_wheel(
    stated: list[int], systems: list[int], wheels: list[int], expected: str, tmp_path, fresh
) -> None:
    paths = [[fake_llvm(tmp_path, major) for major in majors] for majors in (systems, wheels)]
    fresh.setattr(variant, "_system_candidates", lambda: paths[0])
    fresh.setattr(variant, "_wheel_candidates", lambda: paths[1])
    fresh.setenv(variant.LLVM_VARIABLE, fake_llvm(tmp_path, stated[0]) if stated else "")
    assert variant.find_llvm()[1] == expected


def test_choice_does_not_count_as_the_users_later(
    tmp_path: Path, fresh: pytest.MonkeyPatch
) -> None:
    """`choose` sets the variable for Dr.Jit, which was not imported here."""
    system = fake_llvm(tmp_path, 19)
    fresh.setattr(variant, "_system_candidates", lambda: [system])
    fresh.setenv(variant.LLVM_VARIABLE, "")
    fresh.delitem(sys.modules, "drjit", raising=False)
    first = variant.choose()
    assert os.environ[variant.LLVM_VARIABLE] == system
    variant.choose.cache_clear()
    assert variant.choose() == first


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("", r"cannot be loaded \(no library"),
        ("broken.so", r"cannot be loaded \(no library"),
        ("nowhere.so", r"cannot be loaded \(no such"),
        ("libLLVM-16.so", "version 16; allowed: LLVM 17 or newer"),
        ("libLLVM-15.so", "version 15 or older; allowed: LLVM 17 or newer"),
    ],
)
def test_unusable_library_of_the_user_is_refused(
    name: str, words: str, tmp_path: Path, fresh: pytest.MonkeyPatch
) -> None:
    """Else Mitsuba aborts the process at the first render or quietly takes another library."""
    fake_llvm(tmp_path, 16)
    compiled("int other;", tmp_path / "libLLVM-15.so")  # which has no LLVMGetVersion
    (tmp_path / "broken.so").write_text("not a library", encoding="utf-8")
    fresh.setenv(variant.LLVM_VARIABLE, str(tmp_path / name))
    with pytest.raises(pixsim.PixsimError, match=f"DRJIT_LIBLLVM_PATH.*{words}"):
        pixsim.load_scene("flat")


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
@pytest.mark.skipif(
    not variant._wheel_candidates(), reason=f"{variant.LLVM_WHEEL} is not installed"
)
def test_chosen_llvm_is_the_one_that_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(variant.LLVM_VARIABLE, raising=False)
    line = [sys.executable, "-c", RENDER]
    done = subprocess.run(line, capture_output=True, text=True, timeout=HANG_S, check=True)
    name, path, mapped = done.stdout.splitlines()
    assert name == "llvm_ad_spectral"
    assert os.path.realpath(path) in mapped
    assert variant.llvm_version(path) >= 17


def test_without_llvm_scalar_renders_with_a_note(fresh: pytest.MonkeyPatch) -> None:
    fresh.setattr(variant, "find_llvm", lambda: (None, "no LLVM 17 or newer was found"))
    hint = "no LLVM 17.*pip install karellen-llvm-core"
    with pytest.warns(UserWarning, match=f"scalar_spectral, since {hint}"):
        assert variant.choose().variant == "scalar_spectral"
    with pytest.raises(pixsim.PixsimError, match=hint):
        variant.choose("llvm_ad_spectral")


def test_render_after_a_scalar_one_takes_llvm(fresh: pytest.MonkeyPatch) -> None:
    """Dr.Jit reads the path of LLVM only when it is imported, which the scalar render does."""
    fresh.delenv(variant.LLVM_VARIABLE)
    fresh.delitem(sys.modules, "drjit", raising=False)
    fresh.setattr(variant, "candidates", lambda: [("libLLVM.so", variant.SYSTEM)])
    fresh.setattr(variant, "_cached_version", lambda _: 19)
    assert variant.choose("scalar_spectral").reason == "requested"
    fresh.setitem(sys.modules, "drjit", sys)
    assert variant.choose("llvm_ad_spectral").reason == "system, LLVM 19"


def test_llvm_after_drjit_is_taken_or_refused(fresh: pytest.MonkeyPatch) -> None:
    """It was imported before its LLVM was checked, which may abort."""
    fresh.delenv(variant.LLVM_VARIABLE)
    fresh.setitem(sys.modules, "drjit", sys)
    with pytest.raises(
        pixsim.PixsimError, match="Mitsuba was imported before its LLVM was checked"
    ):
        variant.choose("llvm_ad_spectral")


# --- A machine without a card ---


PROCESSORS = variant.ChosenVariant("llvm_ad_spectral", "lib", "system, LLVM 19")


@pytest.fixture
def with_llvm(fresh: pytest.MonkeyPatch) -> None:
    fresh.setattr(variant, "_for_processors", lambda _: (PROCESSORS, ""))


@pytest.mark.usefixtures("with_llvm")
@pytest.mark.parametrize(
    ("device", "fault"),
    # A device without its library, as in containers that get the devices alone
    [("none", graphics.NO_CARD), ("nvidiactl", "cannot be loaded (nowhere.so)")],
)
def test_machine_without_card_or_driver_starts_nothing(
    device: str, fault: str, fresh: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / device).touch()
    fresh.setattr(graphics, "NODES", (str(tmp_path / "nvidiactl"),))
    fresh.setenv(graphics.DRIVER_VARIABLE, "nowhere.so")
    fresh.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("started a process"))
    assert fault in str(graphics.graphics_trial().fault)
    chosen = variant.choose()
    assert chosen == replace(PROCESSORS, reason=chosen.reason)
    assert fault in chosen.reason


# --- A driver ---


# Numbers that a real driver would report are read from the environment.
FAKE_DRIVER = r"""
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
static int of(const char *name, int otherwise) { const char *text = getenv(name); return text ? atoi(text) : otherwise; }
int cuDriverGetVersion(int *version) { *version = of("FAKE_CUDA", 12080); return 0; }
int cuInit(unsigned flags) {
    if (of("FAKE_DIES", 0)) raise(SIGSEGV);
    if (of("FAKE_HANGS", 0)) sleep(1000);
    return of("FAKE_INIT", 0);
}
int cuGetErrorName(int code, const char **name) { *name = "CUDA_ERROR_NO_DEVICE"; return code != 100; }
int cuDeviceGetCount(int *count) { *count = of("FAKE_COUNT", 1); return 0; }
int cuDeviceGet(int *device, int number) { *device = number; return 0; }
int cuDeviceGetName(char *name, int size, int device) { strncpy(name, "NVIDIA of a test", size); return 0; }
int cuDeviceGetAttribute(int *value, int attribute, int device) {
    *value = of("FAKE_CAPABILITY", 89) / (attribute == 75 ? 10 : 1) % 10;
    return attribute != 75 && attribute != 76;
}
int cuDeviceTotalMem_v2(size_t *bytes, int device) { *bytes = (size_t) of("FAKE_GIB", 8) << 30; return 0; }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    files = importlib.metadata.files("drjit") or ()
    (drjit,) = (file.locate() for file in files if file.name == "libdrjit-core.so")
    names = set(re.findall(rb"\0(cu[A-Z]\w+)(?=\0)", Path(drjit).read_bytes()))
    others = (
        f"int {name}(void) {{ return 999; }}"  # or Dr.Jit would not start it
        for name in sorted(map(bytes.decode, names))
        if f"int {name}(" not in FAKE_DRIVER
    )
    source = "\n".join([FAKE_DRIVER, *others])
    return compiled(source, tmp_path_factory.mktemp("driver") / "libcuda.so.1")


@pytest.fixture
def driver(library: str, monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """A machine with the tests' driver, and some library in the place of OptiX."""
    monkeypatch.setenv(graphics.DRIVER_VARIABLE, library)
    monkeypatch.setenv("DRJIT_LIBOPTIX_PATH", library)
    return monkeypatch


START = {
    "drjit": "import drjit",
    "pixsim": (
        "import os, pixsim; from pixsim.scene import mitsuba; from pixsim.scene.variants import"
        " graphics as g; before = os.environ[g.DRIVER_VARIABLE];"
        " mitsuba.import_mitsuba('scalar_spectral'); assert os.environ[g.DRIVER_VARIABLE] == before"
    ),
}


@pytest.mark.skipif(sys.platform != "linux", reason="the driver of the tests is for Linux")
@pytest.mark.parametrize(("which", "code"), [("drjit", -11), ("pixsim", 0)])
def test_processes_that_render_without_card_do_not_start_driver(
    which: str, code: int, driver: pytest.MonkeyPatch
):
    """Dr.Jit starts it when it is imported, in each process, and a driver that fails then ends the
    process.
    """
    driver.setenv("FAKE_DIES", "1")
    done = subprocess.run(
        [sys.executable, "-c", START[which]], capture_output=True, text=True, timeout=HANG_S
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_card_that_fails_to_start_fails_its_trial(driver: pytest.MonkeyPatch, tmp_path: Path):
    """All of Dr.Jit, with a driver that shows a card which then fails: the process that would trace
    dies, and no other.
    """
    job = TraceJob("cuda_ad_spectral", '<scene version="3.0.0"/>', (None,), 0, {}, None, ())
    with pytest.raises(
        pixsim.PixsimError,
        match=r"the graphics card or its driver ended Mitsuba's process \(SIGABRT\)",
    ):
        ChildTracer(job, lambda: time.monotonic() + HANG_S).sample_count("independent", 4)


# --- The trial and the choice ---


PICTURE, DIES = Trial(None, 5.0), Trial("ends with signal 6 (SIGABRT)", 1.0)


@pytest.fixture
def trials(tmp_path: Path, library: str, monkeypatch: pytest.MonkeyPatch) -> Mock:
    """The trials of a machine with a card, whose results the test decides."""
    (tmp_path / "nvidiactl").touch()
    trial_render = Mock(return_value=PICTURE)
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(graphics.DRIVER_VARIABLE, library)
    monkeypatch.setattr(graphics, "NODES", (str(tmp_path / "nvidiactl"),))
    monkeypatch.setattr(graphics, "trial_render", trial_render)
    return trial_render


@pytest.mark.parametrize(("picture", "fault"), [(PICTURE, "None"), (DIES, "ends with signal 6")])
def test_trial_is_taken_once(picture: Trial, fault: str, trials: Mock) -> None:
    """Its result holds, whatever a second trial would find; the doctor takes a second one."""
    trials.return_value = picture
    with pytest.warns(UserWarning, match="the graphics card"):
        first = graphics.graphics_trial()
    assert fault in str(first.fault)
    trials.return_value = PICTURE
    assert graphics.graphics_trial() == first
    trials.assert_called_once_with("cuda_ad_spectral", limit_s=ANY)
    assert 0 < trials.call_args.kwargs["limit_s"] < 600
    assert graphics.graphics_trial(again=True).fault is None
    assert trials.call_count == 2


@pytest.mark.parametrize(
    ("name", "value"), [("PIXSIM_CACHE_GIB", "0"), ("PIXSIM_CACHE_DIR", "/dev/null/there")]
)
def test_without_cache_nothing_is_tried(
    trials: Mock, name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or each process would try, and each worker of a study; `pixsim doctor` does."""
    monkeypatch.setenv(name, value)
    assert graphics.graphics_trial() == graphics.GraphicsTrial(graphics.NOT_CACHED, tried=False)
    trials.assert_not_called()
    assert graphics.graphics_trial(again=True).fault is None


@pytest.mark.usefixtures("trials", "with_llvm")
def test_choose_prefers_card_and_reads_on_processors() -> None:
    with pytest.warns(UserWarning, match="passed"):
        chosen = variant.choose()
    assert (chosen.variant, chosen.processors) == ("cuda_ad_spectral", PROCESSORS)
    assert chosen.reading == variant.choose("cuda_ad_spectral").reading == "llvm_ad_spectral"
    assert variant.choose("llvm_ad_spectral") == PROCESSORS


# --- Renders ---


CHOSEN = variant.ChosenVariant(
    "cuda_ad_spectral", None, "of a test", variant.ChosenVariant(VARIANT, None, "of a test")
)


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], None]:
    """Children trace on processors in place of a card, or their card fails."""

    def tracer(job: TraceJob, works: bool) -> InProcessTracer:
        assert job.variant == "cuda_ad_spectral"
        in_process = InProcessTracer(replace(job, variant=VARIANT))
        if not works:
            in_process.trace = Mock(side_effect=pixsim.PixsimError("the card fails."))
        return in_process

    return lambda works: monkeypatch.setattr(
        renderer, "ChildTracer", lambda job, ends_at_s: tracer(job, works)
    )


def small_scene():
    return pixsim.load_scene("flat", variant=VARIANT, resolution=8, spp=4)


def light(choice: variant.ChosenVariant) -> pixsim.SpectralImage:
    return pixsim.render(replace(small_scene(), choice=choice))


def test_packaged_scene_is_traced_in_child(card: Callable[[bool], None]) -> None:
    card(True)
    images = [light(choice) for choice in (CHOSEN, variant.choose(VARIANT))]
    assert [image.header["variant"] for image in images] == ["cuda_ad_spectral", VARIANT]
    np.testing.assert_array_equal(images[0].illuminance_lx(), images[1].illuminance_lx())


def test_failing_card_ends_the_render(card: Callable[[bool], None]):
    card(False)
    with pytest.raises(
        pixsim.PixsimError, match=r"the card fails\. To render without .*--variant scalar_spectral"
    ):
        light(CHOSEN)


def test_rows_of_a_study_are_of_one_variant(card: Callable[[bool], None]) -> None:
    """A study that goes on where another variant traces evaluates anew, though the pictures are
    equal here.
    """
    card(True)
    choices = CHOSEN, variant.choose(VARIANT), CHOSEN
    sensors = [lit_sensors(tiny(), light(choice), small_scene().camera()) for choice in choices]
    first, other, again = (set(sensor.keys(6.0, 2)) for (sensor,) in sensors)
    assert first.isdisjoint(other)
    assert first == again


def test_cached_renders_are_of_one_variant(
    card: Callable[[bool], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Renders of a card and of the processors have separate entries, which are found again."""
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    counts = []
    for works, choice in ((True, CHOSEN), (False, variant.choose(VARIANT)), (False, CHOSEN)):
        card(works)
        scene = replace(small_scene(), choice=choice)
        job = (scene, scene.camera(), make_render_plan(scene), [pixsim.Pixel(pitch_um=100.0)])
        image = render_until(*job, pixsim.Exposure(), render_noise=10.0, use_cache=True).image
        assert image.header["variant"] == choice.variant
        counts.append(len(list((tmp_path / "render").glob("*"))))
    assert 0 < counts[0] < counts[1] == counts[2]
