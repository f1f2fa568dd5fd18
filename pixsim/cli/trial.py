"""Try things that may abort or hang a process in one of its own, with a time limit: LLVM, Mitsuba, a graphics driver.

The child writes JSON lines into a pipe of its own, so that what libraries print does not get between; the lines that it
wrote before an abort count.
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
    """What a child wrote, how long it took, and how it ended."""

    lines: list[Line]
    seconds: float
    returncode: int | None  # None: stopped at the time limit
    last_words: str

    @property
    def facts(self) -> Line:
        """All lines as one, for a child whose lines name each thing once."""
        return {name: value for line in self.lines for name, value in line.items()}

    @property
    def fault(self) -> str | None:
        """How it failed; None where it ran to its end."""
        if self.returncode is None:
            return f"hangs: it was stopped after {self.seconds:.0f} s"
        if not self.returncode:
            return None
        if self.returncode < 0:
            name = next((each.name for each in signal.Signals if each == -self.returncode), "unknown")
            how = f"dies of signal {-self.returncode} ({name})"
        else:
            how = "fails"
        return how + (f": {self.last_words}" if self.last_words else "")


def attempt(kind: str, *arguments: str, limit_s: float) -> Trial:
    """Run one of TRIALS in a fresh process that finds the same modules as this one."""
    reading, writing = os.pipe()
    code = START.format(path=sys.path, fd=writing, kind=kind, arguments=arguments)
    begin = time.perf_counter()
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
                ended: int | None = child.returncode
            except subprocess.TimeoutExpired:
                child.kill()
                _, errors = child.communicate()
                ended = None
        lines = [json.loads(line) for line in pipe if line.endswith("\n")]
    words = [line.strip() for line in errors.splitlines() if line.strip()]
    return Trial(lines, time.perf_counter() - begin, ended, words[-1] if words else "")


# --- In the child -----------------------------------------------------------------------------------------------------


def libraries() -> Iterator[Line]:
    """Each libLLVM that is found, judged; the line before a library's own names it, should it kill the process."""
    found = [*variants.candidates(), *((path, variants.BY_HAND) for path in variants.found_by_hand())]
    for path, origin in found:
        yield {"judging": path, "origin": origin}
        library = variants.Library(path, origin, variants.llvm_version(path))
        yield {"path": path, "origin": origin, "version": library.version, "fault": library.fault}


def imports(*modules: str) -> Iterator[Line]:
    """Import each module; what it raises is told."""
    for name in modules:
        yield {"importing": name}
        try:
            import_module(name)
        except Exception as error:  # whatever a broken package raises
            text = " ".join(str(error).split())
            yield {"module": name, "error": f"{type(error).__name__}: {text}"}


def driver() -> Iterator[Line]:
    """Version of the NVIDIA driver's library and the number of devices; the fault where there is none."""
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        yield {"fault": "no NVIDIA driver (libcuda.so.1 is not found)"}
        return
    if code := cuda.cuInit(0):
        yield {"fault": f"the NVIDIA driver has no device it can use (cuInit: {code})"}
        return
    count, version = ctypes.c_int(), ctypes.c_int()
    cuda.cuDeviceGetCount(ctypes.byref(count))
    cuda.cuDriverGetVersion(ctypes.byref(version))
    yield {"fault": None, "devices": count.value, "cuda": f"{version.value // 1000}.{version.value % 1000 // 10}"}


def render(variant: str = "") -> Iterator[Line]:
    """A small picture of the packaged chart: seconds, and its illuminance beside the closed form."""
    import numpy as np

    import pixsim
    from pixsim.scene.mitsuba import import_mitsuba

    begin = time.perf_counter()
    try:
        scene = pixsim.load_scene(TRIED_SCENE, variant=variant or None, resolution=TRIED_RESOLUTION)
        mitsuba = import_mitsuba(scene.choice.variant)
        yield {"variant": scene.choice.variant, "llvm": scene.choice.llvm_path, "reason": scene.choice.reason}
        loaded = time.perf_counter()
        found = pixsim.render(scene).illuminance_lx()
    except PixsimError as error:
        yield {"refused": str(error)}
        return
    expected = closed_form_lx(scene.camera(), TRIED_RESOLUTION)
    yield {
        "start_s": loaded - begin,
        "render_s": time.perf_counter() - loaded,
        "mean_lx": float(found.mean()),
        "expected_lx": float(expected.mean()),
        "mean_error": float(found.mean() / expected.mean() - 1),
        "rms_error": float(np.sqrt(np.mean((found / expected - 1) ** 2))),
        "threads": int(import_module("drjit").thread_count()),
        "compiled_in": list(mitsuba.variants()),
        "mapped_llvm": variants.mapped(),
    }


def closed_form_lx(camera: Any, resolution: int) -> Any:
    """(H, W) lx on the sensor from the chart's formula and Foote's factor; nothing of Mitsuba, and no texture, is in it."""
    import numpy as np

    from pixsim import optics
    from pixsim.scene import charts

    at = (np.arange(resolution * POINTS) + 0.5) / (resolution * POINTS)
    chart = charts.csf_value(at, at[:, None], camera.die_mm)
    cells = chart.reshape(resolution, POINTS, resolution, POINTS).mean(axis=(1, 3))
    pitch_um = 1e3 * camera.die_mm / resolution
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    factor = optics.field_factor(cells.shape, pitch_um, *lens) * camera.transmittance
    return charts.LUMINANCE_CD_PER_M2[1] * cells * factor


TRIALS: dict[str, Callable[..., Iterator[Line]]] = {each.__name__: each for each in (libraries, imports, driver, render)}


def main(fd: int, kind: str, *arguments: str) -> None:
    """In the child: write each line as soon as it is known."""
    with os.fdopen(fd, "w", encoding="utf-8", buffering=1) as pipe:
        for line in TRIALS[kind](*arguments):
            pipe.write(json.dumps(line) + "\n")
