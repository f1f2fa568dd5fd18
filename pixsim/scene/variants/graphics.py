"""Whether Mitsuba can trace on an NVIDIA graphics card here: tried once in child processes, and remembered.

A driver may abort or hang, so that only the child process that traces on the card starts it. Dr.Jit 1.5 says in its messages
what it needs: a driver for CUDA 12.2 (R535) or newer, but not 12.7 (R565), with OptiX, and a card of compute capability 7.5.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pixsim.base import cache, machine
from pixsim.base.notes import Note, warn
from pixsim.scene.variants.trial import Trial, attempt, picture_fault

CUDA = "cuda_ad_spectral"
NODES = ("/dev/nvidiactl", "/dev/dxg")  # devices of the NVIDIA driver, and of a card in WSL 2
DRIVER_VARIABLE, OPTIX_VARIABLE = "DRJIT_LIBCUDA_PATH", "DRJIT_LIBOPTIX_PATH"
DRIVERS, OPTIX = ("libcuda.so.1", "libcuda.so"), "libnvoptix.so.1"
DRIVER_PATTERNS = ("*-linux-gnu/libcuda.so.*", "wsl/lib/libcuda.so.*")  # below /usr/lib, where Dr.Jit looks too
OF_DRIVER = (
    "CUDA_VISIBLE_DEVICES",
    "CUDA_DEVICE_ORDER",
    "NVIDIA_DRIVER_CAPABILITIES",
    "LD_LIBRARY_PATH",
    DRIVER_VARIABLE,
    OPTIX_VARIABLE,
)
OLDEST_CUDA, FAULTY_CUDA, LOWEST_CAPABILITY = (12, 2), (12, 7), (7, 5)
# A kernel takes 0.4 GiB: 48 bytes a cell, by Dr.Jit's count with LLVM, of `renderer.CELLS_PER_KERNEL`; the driver takes some too.
LEAST_BYTES = 2 << 30
DRIVER_S, PICTURE_S = 20.0, 90.0  # the first picture on a card compiles everything
FAILED_S, STOPPED_S = 86400.0, 3600.0  # before a failure is tried again: a time limit may only mean that the machine was busy
KIND = "cards"

NO_CARD = "no NVIDIA card is here (no /dev/nvidiactl)"
NO_DRIVER = "the library of the NVIDIA driver is missing (libcuda.so.1)"
NO_OPTIX = f"{OPTIX} of the NVIDIA driver, which traces rays, is missing (containers need NVIDIA_DRIVER_CAPABILITIES=all)"
NOT_LINUX = "pixsim tries graphics cards on Linux only"
NOT_KEPT = f"the cache cannot keep the result of a trial; --variant {CUDA} takes the card untried"


@dataclass(frozen=True)
class GraphicsTrial:
    """Why a graphics card is not used (None if it works), the card with its memory and driver, and when it was tried."""

    fault: str | None
    card: str = ""
    tried_s: float = 0.0  # since the epoch; 0: there was nothing to try
    stopped: bool = False  # at the time limit

    @property
    def due(self) -> bool:
        """Whether a failure is old enough to be tried again."""
        age_s = time.time() - self.tried_s
        return self.fault is not None and not 0 <= age_s < (STOPPED_S if self.stopped else FAILED_S)


def loaded_driver() -> ctypes.CDLL | None:
    """Return the library of the driver as Dr.Jit looks for it, or None. It is loaded, but not started."""
    given = os.environ.get(DRIVER_VARIABLE)
    found = (str(path) for pattern in DRIVER_PATTERNS for path in sorted(Path("/usr/lib").glob(pattern), reverse=True))
    for name in (given,) if given else (*DRIVERS, *found):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


@contextmanager
def without_driver() -> Iterator[None]:
    """Keep Dr.Jit from starting the driver while it is imported for the first time.

    Else it takes memory of every card in each process, also for LLVM, and ends the process if that fails.
    """
    before = os.environ.get(DRIVER_VARIABLE)
    if sys.platform != "linux" or "drjit" in sys.modules:
        yield
        return
    os.environ[DRIVER_VARIABLE] = ""  # then it finds no functions of a driver, and says nothing
    try:
        yield
    finally:
        if before is None:
            del os.environ[DRIVER_VARIABLE]
        else:
            os.environ[DRIVER_VARIABLE] = before


def absent() -> str | None:
    """Return why there is nothing to try here; None if there is. It takes a few system calls, and no process."""
    if sys.platform != "linux":
        return NOT_LINUX
    if not any(os.path.exists(node) for node in NODES):
        return NO_CARD
    if loaded_driver() is None:
        given = os.environ.get(DRIVER_VARIABLE)
        return f"{DRIVER_VARIABLE} is '{given}', which cannot be loaded" if given else NO_DRIVER
    return None


def verdict(again: bool = False) -> GraphicsTrial:
    """Return whether the graphics card works, from the cache or a trial; `again`: in any case from a trial."""
    if fault := absent():
        return GraphicsTrial(fault)
    if not cache.limit_bytes() or machine.check_folder(cache.folder())[0]:
        return tried() if again else GraphicsTrial(NOT_KEPT)  # or each process, and each worker of a study, would try
    key = _key()
    known: list[GraphicsTrial] = []

    def compute() -> GraphicsTrial:
        known.append(tried())
        return known[0]

    for _ in range(2):
        if again and not known:
            cache.forget(KIND, key)
        verdict = cache.load_or_compute(KIND, key, _from_json, compute, asdict)
        if known or not verdict.due:
            break
        cache.forget(KIND, key)
    if known and not again:
        warn(Note("machine", words=told(known[0])))
    return verdict


def told(verdict: GraphicsTrial) -> str:
    """What a user is told of a trial."""
    if verdict.fault is None:
        return (
            f"the graphics card ({verdict.card}) passed its trial: scenes are traced on it from now on, unless --variant is given"
        )
    return f"the graphics card is not used: {verdict.fault.removesuffix('.')}; `pixsim doctor` tries it again"


def tried() -> GraphicsTrial:
    """Try the driver, then a small picture, which is compared with its closed form."""
    now = time.time()
    driver = attempt("driver", limit_s=DRIVER_S)
    card = ", ".join(_words_of(driver.facts))
    if fault := driver_fault(driver):
        return GraphicsTrial(fault, card, now, driver.returncode is None)
    picture = attempt("render", CUDA, limit_s=PICTURE_S)
    if fault := picture_fault(picture):
        return GraphicsTrial(f"its trial render fails: {fault}", card, now, picture.returncode is None)
    return GraphicsTrial(None, card, now)


def driver_fault(driver: Trial) -> str | None:
    """Return why Dr.Jit cannot use what the trial `driver` found; None if it can, as far as can be told without a render."""
    facts = driver.facts
    cuda, capability = tuple(facts.get("cuda", ())), tuple(facts.get("capability", ()))
    if cuda and cuda < OLDEST_CUDA:
        return f"its driver is for CUDA {_version(cuda)}; Mitsuba needs CUDA {_version(OLDEST_CUDA)} (driver 535) or newer"
    if cuda == FAULTY_CUDA:
        return f"its driver is for CUDA {_version(cuda)} (driver 565), with which Mitsuba does not trace; install 570 or newer"
    if driver.fault:
        return f"the check of its driver {driver.fault}"
    if facts.get("fault") and "devices" not in facts:
        return str(facts["fault"])
    if not facts.get("devices"):
        visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        return "the NVIDIA driver shows no card" + ("" if visible is None else f" (CUDA_VISIBLE_DEVICES is '{visible}')")
    if capability < LOWEST_CAPABILITY:
        needed = f"{_version(LOWEST_CAPABILITY)} (RTX 20, T4) or newer"
        return f"{facts['card']} has compute capability {_version(capability)}; Mitsuba needs {needed}"
    if facts["memory_bytes"] < LEAST_BYTES:
        least = f"{LEAST_BYTES / cache.GIB:g} GiB"
        return f"{facts['card']} has {facts['memory_bytes'] / cache.GIB:.1f} GiB of memory, and a render needs up to {least}"
    return None if facts.get("fault") is None else str(facts["fault"])


def _words_of(facts: dict[str, Any]) -> Iterator[str]:
    """Name, memory and CUDA version of a card, as far as its driver tells them."""
    if "card" in facts:
        yield from (facts["card"], f"{facts['memory_bytes'] / cache.GIB:.1f} GiB")
    if "cuda" in facts:
        yield f"CUDA {_version(tuple(facts['cuda']))}"


def _version(numbers: tuple[int, ...]) -> str:
    return ".".join(map(str, numbers))


def _key() -> str:
    """Return a hash of what decides on a verdict and can be read without the driver: its version, the cards, the libraries."""
    proc = Path("/proc/driver/nvidia")
    seen = [machine.text_of(proc / "version"), *(machine.text_of(path) for path in sorted(proc.glob("gpus/*/information")))]
    maps = machine.mapped_files("libcuda")
    libraries = [(path, os.stat(path).st_size, os.stat(path).st_mtime_ns) for path in maps if os.path.exists(path)]
    given = [os.environ.get(name) for name in OF_DRIVER]
    content = repr((seen, libraries, given, cache.version_fingerprint("mitsuba", "drjit")))
    return hashlib.blake2b(content.encode(), digest_size=16).hexdigest()


def _from_json(content: dict[str, Any]) -> GraphicsTrial:
    verdict = GraphicsTrial(**content)
    if not isinstance(verdict.fault, str | None) or not isinstance(verdict.card, str):
        raise TypeError("no verdict")
    return GraphicsTrial(verdict.fault, verdict.card, float(verdict.tried_s), bool(verdict.stopped))
