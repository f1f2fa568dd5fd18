"""Whether Mitsuba can trace on an NVIDIA graphics card here: a small picture is tried once in a
child process, and remembered.

A driver may abort or hang, so that only the child process that traces on the card starts it.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pixsim.base import cache, machine
from pixsim.base.hashes import content_hash
from pixsim.base.notes import Note, warn
from pixsim.scene.trial import trial_render

CUDA = "cuda_ad_spectral"
NODES = ("/dev/nvidiactl", "/dev/dxg")  # devices of the NVIDIA driver, and of a card in WSL 2
DRIVER_VARIABLE = "DRJIT_LIBCUDA_PATH"
_DRIVER = "libcuda.so.1"
_DRIVER_FILES = Path(
    "/proc/driver/nvidia"
)  # its version and its cards, which can be read without starting it
# Variables that change what the driver shows of its cards, or which driver it is.
_DRIVER_SETTINGS = (
    "CUDA_VISIBLE_DEVICES",
    "CUDA_DEVICE_ORDER",
    "NVIDIA_DRIVER_CAPABILITIES",
    "LD_LIBRARY_PATH",
    DRIVER_VARIABLE,
    "DRJIT_LIBOPTIX_PATH",
)
_PICTURE_S = 90.0  # the first picture on a card compiles everything
KIND = "cards"
NO_CARD = "there is no NVIDIA card (no /dev/nvidiactl)"
_NEEDS = (
    "Mitsuba needs a driver for CUDA 12.2 (535) or newer, but not 12.7 (565), with libnvoptix.so.1,"
    " and compute capability 7.5"
)
NOT_CACHED = (
    f"the cache cannot store the result of a trial; --variant {CUDA} uses the card without one"
)


@dataclass(frozen=True)
class GraphicsTrial:
    """The outcome of a trial of the graphics card.

    fault : why the card is not used, or None if it works
    tried : whether something was rendered on it
    """

    fault: str | None
    tried: bool = True


@contextmanager
def without_driver() -> Iterator[None]:
    """Keep Dr.Jit from starting the driver while it is imported for the first time.

    Else it takes memory of every card in each process, also for LLVM, and ends the process if that
    fails.
    """
    if sys.platform != "linux" or "drjit" in sys.modules:
        yield
        return
    before = {name: value for name, value in os.environ.items() if name == DRIVER_VARIABLE}
    os.environ[DRIVER_VARIABLE] = ""  # then it finds no functions of a driver, and says nothing
    try:
        yield
    finally:
        del os.environ[DRIVER_VARIABLE]
        os.environ.update(before)


def no_card_reason() -> str | None:
    """Return why no card can be tried here, or None if one can. It takes a few system calls, and
    no process.
    """
    if not any(os.path.exists(node) for node in NODES):
        return NO_CARD
    driver = os.environ.get(DRIVER_VARIABLE) or _DRIVER
    try:
        ctypes.CDLL(driver)  # which does not start it
    except OSError:
        return f"the library of the NVIDIA driver cannot be loaded ({driver})"
    return None


def graphics_trial(again: bool = False) -> GraphicsTrial:
    """Return whether the graphics card works, from the cache or a trial.

    again : take a new trial in any case
    """
    if fault := no_card_reason():
        return GraphicsTrial(fault, tried=False)
    has_cache = cache.limit_bytes() > 0 and cache.can_hold(KIND)
    if not again and not has_cache:  # each process, and each worker of a study, would try
        return GraphicsTrial(NOT_CACHED, tried=False)

    # The trial is repeated when the driver, a card or a setting of them changes.
    settings = [os.environ.get(name) for name in _DRIVER_SETTINGS]
    paths = (_DRIVER_FILES / "version", *sorted(_DRIVER_FILES.glob("gpus/*/information")))
    files = [machine.text_of(path) for path in paths]
    key = content_hash([files, settings, cache.version_fingerprint("mitsuba", "drjit")])
    if not again:
        cached = cache.value_of(KIND, key, lambda content: GraphicsTrial(content["fault"]))
        if cached is not None:
            return cached

    fault = trial_render(CUDA, limit_s=_PICTURE_S).fault
    trial = GraphicsTrial(fault and f"its trial render fails: {fault.removesuffix('.')} ({_NEEDS})")
    if has_cache:
        cache.store_value(KIND, key, {"fault": trial.fault})
    if not again:
        passed = (
            "the graphics card passed its trial: scenes are traced on it from now on, unless"
            " --variant is given"
        )
        failed = f"the graphics card is not used: {trial.fault}; `pixsim doctor` tries it again"
        warn(Note("machine", words=failed if fault else passed))
    return trial
