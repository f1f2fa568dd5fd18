"""Checks that may abort or hang (Mitsuba, graphics driver): what a child process of `scene.variants.trial` does.

It writes JSON lines to a pipe of its own, apart from the output of libraries. Lines before an abort are used.
"""

from __future__ import annotations

import ctypes
import json
import os
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TYPE_CHECKING

from pixsim.base.errors import PixsimError
from pixsim.scene.variants.graphics import NO_DRIVER, NO_OPTIX, OPTIX, OPTIX_VARIABLE, loaded_driver
from pixsim.scene.variants.trial import Line

if TYPE_CHECKING:
    from pixsim.base.arrays import Array
    from pixsim.optics.camera import Camera

TRIED_SCENE, TRIED_RESOLUTION = "csf", 64
CAPABILITY = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, _MINOR
POINTS = 16  # of the chart, along each side of a cell


def driver() -> Iterator[Line]:
    """The NVIDIA driver and the card that Dr.Jit would use, or why there is none; a fault ends the check.

    The functions of the driver that are called, and in which form, are those of the CUDA driver API.
    """
    cuda = loaded_driver()
    if cuda is None:
        yield {"fault": NO_DRIVER}
        return
    number = ctypes.c_int()
    cuda.cuDriverGetVersion(ctypes.byref(number))
    yield {"cuda": [number.value // 1000, number.value % 1000 // 10]}
    if code := cuda.cuInit(0):
        yield {"fault": f"the NVIDIA driver finds no usable card ({_name_of(cuda, code)})"}
        return
    count = ctypes.c_int()
    cuda.cuDeviceGetCount(ctypes.byref(count))
    yield {"devices": count.value}
    if count.value:
        yield _card(cuda)
    try:
        ctypes.CDLL(os.environ.get(OPTIX_VARIABLE) or OPTIX)
    except OSError:
        yield {"fault": NO_OPTIX}
        return
    yield {"fault": None}


def _name_of(cuda: ctypes.CDLL, code: int) -> str:
    """Name of an error, such as CUDA_ERROR_NO_DEVICE."""
    name = ctypes.c_char_p()
    failed = cuda.cuGetErrorName(code, ctypes.byref(name))
    return name.value.decode(errors="replace") if not failed and name.value else f"cuInit: {code}"


def _card(cuda: ctypes.CDLL) -> Line:
    """The first card, which Dr.Jit uses: its name, compute capability and memory."""
    card, size, name = ctypes.c_int(), ctypes.c_size_t(), ctypes.create_string_buffer(256)
    cuda.cuDeviceGet(ctypes.byref(card), 0)
    cuda.cuDeviceGetName(name, len(name), card)
    cuda.cuDeviceTotalMem_v2(ctypes.byref(size), card)
    capability = []
    for attribute in CAPABILITY:
        value = ctypes.c_int()
        cuda.cuDeviceGetAttribute(ctypes.byref(value), attribute, card)
        capability.append(value.value)
    return {"card": name.value.decode(errors="replace"), "memory_bytes": size.value, "capability": capability}


def render(variant: str = "") -> Iterator[Line]:
    """Render a small image of the packaged chart and compare its illuminance with the closed form."""
    import numpy as np

    import pixsim

    start = time.perf_counter()
    try:
        scene = pixsim.load_scene(TRIED_SCENE, variant=variant or None, resolution=TRIED_RESOLUTION)
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


TRIALS: dict[str, Callable[..., Iterator[Line]]] = {trial.__name__: trial for trial in (driver, render)}


def main(fd: int, kind: str, *arguments: str) -> None:
    """Entry point of the child: write each line as soon as it is available."""
    with os.fdopen(fd, "w", encoding="utf-8", buffering=1) as pipe:
        for line in TRIALS[kind](*arguments):
            pipe.write(json.dumps(line) + "\n")
