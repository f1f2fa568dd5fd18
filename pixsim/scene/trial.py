"""A small render in a child process with a time limit: LLVM, Mitsuba and a graphics driver may
abort or hang.

Its illuminance is compared with the closed form.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.children import safe_variables
from pixsim.base.errors import PixsimError

if TYPE_CHECKING:
    from pixsim.optics.camera import Camera

CODE = "import sys; sys.path[:] = {path!r}; from pixsim.scene.trial import main; main({variant!r})"
SCENE = "csf"
RESOLUTION = 64
POINTS = 16  # of the chart, along each side of a cell
# Of the illuminance, normally 1e-5 and 4e-3
MAX_MEAN_ERROR = 1e-3
_MAX_RMS_ERROR = 1e-2


@dataclass(frozen=True)
class Trial:
    """The outcome of a trial render.

    fault : why there is no picture or a wrong one, or None if it is right
    facts : that `main` writes beside the fault; empty if the child ended before
    """

    fault: str | None
    seconds: float
    facts: dict[str, Any] = field(default_factory=dict)


def trial_render(variant: str | None = None, *, limit_s: float) -> Trial:
    """Render in a new process with the same module path.

    variant : of Mitsuba. None takes the default
    """
    command = [sys.executable, "-P", "-c", CODE.format(path=sys.path, variant=variant)]
    environment = os.environ | safe_variables()
    start_s = time.perf_counter()
    try:
        done = subprocess.run(
            command,
            env=environment,
            timeout=limit_s,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        return Trial(f"hangs: stopped after {limit_s:g} s", limit_s)
    seconds = time.perf_counter() - start_s

    if done.returncode:
        fault = "fails"
        if done.returncode < 0:
            name = signal.Signals(-done.returncode).name
            fault = f"ends with signal {-done.returncode} ({name})"
        last_line = done.stderr.strip().splitlines()[-1:]
        return Trial(": ".join([fault, *last_line]), seconds)
    facts = json.loads(done.stdout.splitlines()[-1])
    return Trial(facts.pop("fault"), seconds, facts)


def main(variant: str | None) -> None:
    """Render the packaged chart in small and write its illuminance and fault as the last line of
    stdout: the entry point of the child.
    """
    import pixsim

    try:
        scene = pixsim.load_scene(SCENE, variant=variant, resolution=RESOLUTION)
        illuminance_lx = pixsim.render(scene).illuminance_lx()
    except PixsimError as error:
        sys.stdout.write(json.dumps({"fault": str(error), "refused": True}))
        return
    expected_lx = closed_form_lx(scene.camera(), RESOLUTION)
    facts: dict[str, Any] = {
        "fault": picture_fault(illuminance_lx, expected_lx),
        "variant": scene.choice.variant,
        "llvm": scene.choice.llvm_path,
    }
    facts |= {"mean_lx": float(illuminance_lx.mean()), "expected_lx": float(expected_lx.mean())}
    sys.stdout.write(json.dumps(facts | {"threads": int(import_module("drjit").thread_count())}))


def picture_fault(illuminance_lx: Array, expected_lx: Array) -> str | None:
    """Return how a picture differs from the closed form, both (H, W), or None if it is right."""
    mean = float(illuminance_lx.mean() / expected_lx.mean() - 1)
    rms = float(np.sqrt(np.mean((illuminance_lx / expected_lx - 1) ** 2)))
    if abs(mean) <= MAX_MEAN_ERROR and rms <= _MAX_RMS_ERROR:  # False for NaN
        return None
    return (
        f"its image is wrong: the illuminance differs from the closed form by {mean:+.2%} (mean),"
        f" {rms:.2%} (RMS)"
    )


def closed_form_lx(camera: Camera, resolution: int) -> Array:
    """Illuminance on the sensor, (H, W) lx, from the formula of the chart and Foote's factor,
    without Mitsuba or textures.
    """
    # Every child that traces a scene imports this module, and needs neither.
    from pixsim.optics.thin_lens import field_factor
    from pixsim.scene import charts

    x = (np.arange(resolution * POINTS) + 0.5) / (resolution * POINTS)
    chart = charts.csf_value(x, x[:, None], camera.die_mm)
    cells = chart.reshape(resolution, POINTS, resolution, POINTS).mean(axis=(1, 3))
    pitch_um = 1e3 * camera.die_mm / resolution
    factor = field_factor(
        cells.shape, pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification
    )
    return charts.LUMINANCE_CD_PER_M2[1] * cells * factor * camera.transmittance
