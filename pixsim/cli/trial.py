"""Checks that may abort or hang (LLVM, Mitsuba, graphics driver), run in child processes with a time limit.

The child writes JSON lines to a pipe of its own, apart from the output of libraries. Lines before an abort are used.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from pixsim.base.errors import PixsimError
from pixsim.scene import variant as variants

Line = dict[str, Any]
TRIED_SCENE, TRIED_RESOLUTION = "csf", 64
POINTS = 16  # of the chart, along each side of a cell
START = "import sys; sys.path[:] = {path!r}; from pixsim.cli.trial import main; main({fd}, {kind!r}, *{arguments!r})"


@dataclass(frozen=True)
class Trial:
    """Output, duration and exit status of a child process."""

    lines: list[Line]
    seconds: float
    returncode: int | None  # None: stopped at the time limit
    last_error: str  # last line of stderr

    @property
    def facts(self) -> Line:
        """All lines merged into one."""
        return {name: value for line in self.lines for name, value in line.items()}

    @property
    def fault(self) -> str | None:
        """How the child failed; None if it succeeded."""
        if self.returncode is None:
            return f"hangs: stopped after {self.seconds:.0f} s"
        if not self.returncode:
            return None
        if self.returncode < 0:
            name = next((number.name for number in signal.Signals if number == -self.returncode), "unknown")
            failure = f"dies of signal {-self.returncode} ({name})"
        else:
            failure = "fails"
        return failure + (f": {self.last_error}" if self.last_error else "")


def attempt(kind: str, *arguments: str, limit_s: float) -> Trial:
    """Run one of TRIALS in a new process with the same module path."""
    reading, writing = os.pipe()
    code = START.format(path=sys.path, fd=writing, kind=kind, arguments=arguments)
    start = time.perf_counter()
    with os.fdopen(reading, encoding="utf-8") as pipe:
        try:
            child = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, pass_fds=(writing,),
                text=True, errors="replace",
            )  # fmt: skip
        finally:
            os.close(writing)
        with child:
            try:
                _, errors = child.communicate(timeout=limit_s)
                returncode: int | None = child.returncode
            except subprocess.TimeoutExpired:
                child.kill()
                _, errors = child.communicate()
                returncode = None
        lines = [json.loads(line) for line in pipe if line.endswith("\n")]
    messages = [line.strip() for line in errors.splitlines() if line.strip()]
    return Trial(lines, time.perf_counter() - start, returncode, messages[-1] if messages else "")


def libraries() -> Iterator[Line]:
    """Check each libLLVM; a line with its path comes first, in case the library aborts the process."""
    candidates = [*variants.candidates(), *((path, variants.BY_HAND) for path in variants.found_by_hand())]
    for path, origin in candidates:
        yield {"judging": path, "origin": origin}
        library = variants.Library(path, origin, variants.llvm_version(path))
        yield {"path": path, "origin": origin, "version": library.version, "fault": library.fault}


def imports(*modules: str) -> Iterator[Line]:
    """Import each module and report its exception."""
    for name in modules:
        yield {"importing": name}
        try:
            import_module(name)
        except Exception as error:  # a broken package may raise anything
            text = " ".join(str(error).split())
            yield {"module": name, "error": f"{type(error).__name__}: {text}"}


def driver() -> Iterator[Line]:
    """CUDA version of the NVIDIA driver and number of devices, or the fault."""
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        yield {"fault": "no NVIDIA driver (libcuda.so.1 not found)"}
        return
    if code := cuda.cuInit(0):
        yield {"fault": f"the NVIDIA driver has no usable device (cuInit: {code})"}
        return
    count, version = ctypes.c_int(), ctypes.c_int()
    cuda.cuDeviceGetCount(ctypes.byref(count))
    cuda.cuDriverGetVersion(ctypes.byref(version))
    yield {"fault": None, "devices": count.value, "cuda": f"{version.value // 1000}.{version.value % 1000 // 10}"}


def render(variant: str = "") -> Iterator[Line]:
    """Render a small image of the packaged chart and compare its illuminance with the closed form."""
    import numpy as np

    import pixsim
    from pixsim.scene.mitsuba import import_mitsuba

    start = time.perf_counter()
    try:
        scene = pixsim.load_scene(TRIED_SCENE, variant=variant or None, resolution=TRIED_RESOLUTION)
        mitsuba = import_mitsuba(scene.choice.variant)
        yield {"variant": scene.choice.variant, "llvm": scene.choice.llvm_path, "reason": scene.choice.reason}
        loaded = time.perf_counter()
        illuminance_lx = pixsim.render(scene).illuminance_lx()
    except PixsimError as error:
        yield {"refused": str(error)}
        return
    expected = closed_form_lx(scene.camera(), TRIED_RESOLUTION)
    yield {
        "start_s": loaded - start, "render_s": time.perf_counter() - loaded,
        "mean_lx": float(illuminance_lx.mean()), "expected_lx": float(expected.mean()),
        "mean_error": float(illuminance_lx.mean() / expected.mean() - 1),
        "rms_error": float(np.sqrt(np.mean((illuminance_lx / expected - 1) ** 2))),
        "threads": int(import_module("drjit").thread_count()),
        "compiled_in": list(mitsuba.variants()), "mapped_llvm": variants.mapped(),
    }  # fmt: skip


def closed_form_lx(camera: Any, resolution: int) -> Any:
    """Illuminance on the sensor, (H, W) lx, from the formula of the chart and Foote's factor, without Mitsuba or textures."""
    import numpy as np

    from pixsim import optics
    from pixsim.scene import charts

    x = (np.arange(resolution * POINTS) + 0.5) / (resolution * POINTS)
    chart = charts.csf_value(x, x[:, None], camera.die_mm)
    cells = chart.reshape(resolution, POINTS, resolution, POINTS).mean(axis=(1, 3))
    pitch_um = 1e3 * camera.die_mm / resolution
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    factor = optics.field_factor(cells.shape, pitch_um, *lens) * camera.transmittance
    return charts.LUMINANCE_CD_PER_M2[1] * cells * factor


TRIALS: dict[str, Callable[..., Iterator[Line]]] = {trial.__name__: trial for trial in (libraries, imports, driver, render)}


def main(fd: int, kind: str, *arguments: str) -> None:
    """Entry point of the child: write each line as soon as it is available."""
    with os.fdopen(fd, "w", encoding="utf-8", buffering=1) as pipe:
        for line in TRIALS[kind](*arguments):
            pipe.write(json.dumps(line) + "\n")
