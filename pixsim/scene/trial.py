"""A small render in a child process with a time limit: LLVM, Mitsuba and a graphics driver may abort or hang.

Its illuminance is compared with the closed form.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pixsim.base.children import safe_variables
from pixsim.base.errors import PixsimError

if TYPE_CHECKING:
    from pixsim.base.arrays import Array
    from pixsim.optics.camera import Camera

START = "import sys; sys.path[:] = {path!r}; from pixsim.scene.trial import main; main({fd}, {variant!r})"
SCENE, RESOLUTION = "csf", 64
POINTS = 16  # of the chart, along each side of a cell
MAX_MEAN_ERROR, MAX_RMS_ERROR = 1e-3, 1e-2  # of the illuminance, normally 1e-5 and 4e-3


@dataclass(frozen=True)
class Trial:
    """What a trial render wrote, its duration, and its exit status.

    facts : from `tried`, or none
    returncode : of the child; None if it was stopped at the time limit
    last_error : last line of its stderr
    """

    facts: dict[str, Any]
    seconds: float
    returncode: int | None
    last_error: str = ""

    @property
    def fault(self) -> str | None:
        """Why there is no image or a wrong one; None if it is correct."""
        if self.returncode is None:
            return f"hangs: stopped after {self.seconds:.0f} s"
        if self.returncode:
            dies = (
                f"dies of signal {-self.returncode} ({signal.Signals(-self.returncode).name})" if self.returncode < 0 else "fails"
            )
            return f"{dies}: {self.last_error}" if self.last_error else dies
        if "refused" in self.facts:
            return str(self.facts["refused"])
        mean, rms = self.facts["mean_error"], self.facts["rms_error"]
        if abs(mean) <= MAX_MEAN_ERROR and rms <= MAX_RMS_ERROR:  # False for NaN
            return None
        return f"its image is wrong: the illuminance differs from the closed form by {mean:+.2%} (mean), {rms:.2%} (RMS)"


def attempt(variant: str | None = None, *, limit_s: float) -> Trial:
    """Render in a new process with the same module path.

    variant : of Mitsuba; None takes the default
    """
    reading, writing = os.pipe()
    code = START.format(path=sys.path, fd=writing, variant=variant)
    start = time.perf_counter()
    with os.fdopen(reading, encoding="utf-8") as pipe:
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-c", code], env=os.environ | safe_variables(), timeout=limit_s,
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, pass_fds=(writing,),
                text=True, errors="replace",
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return Trial({}, time.perf_counter() - start, None)
        finally:
            os.close(writing)
        facts = json.loads(pipe.read() or "{}")
    messages = done.stderr.strip().splitlines()
    return Trial(facts, time.perf_counter() - start, done.returncode, messages[-1].strip() if messages else "")


def main(fd: int, variant: str | None) -> None:
    """Write what a trial gives to a pipe, apart from the output of libraries: the entry point of the child."""
    with os.fdopen(fd, "w", encoding="utf-8") as pipe:
        json.dump(tried(variant), pipe)


def tried(variant: str | None) -> dict[str, Any]:
    """Render a small image of the packaged chart, and compare its illuminance with the closed form."""
    import numpy as np

    import pixsim

    start = time.perf_counter()
    try:
        scene = pixsim.load_scene(SCENE, variant=variant, resolution=RESOLUTION)
        loaded = time.perf_counter()
        illuminance_lx = pixsim.render(scene).illuminance_lx()
    except PixsimError as error:
        return {"refused": str(error)}
    expected = closed_form_lx(scene.camera(), RESOLUTION)
    return {
        "variant": scene.choice.variant, "llvm": scene.choice.llvm_path, "reason": scene.choice.reason,
        "start_s": loaded - start, "render_s": time.perf_counter() - loaded,
        "mean_lx": float(illuminance_lx.mean()), "expected_lx": float(expected.mean()),
        "mean_error": float(illuminance_lx.mean() / expected.mean() - 1),
        "rms_error": float(np.sqrt(np.mean((illuminance_lx / expected - 1) ** 2))),
        "threads": int(import_module("drjit").thread_count()),
    }  # fmt: skip


def closed_form_lx(camera: Camera, resolution: int) -> Array:
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
