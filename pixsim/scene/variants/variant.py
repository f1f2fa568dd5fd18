"""Choose a Mitsuba variant that runs on this machine, before Mitsuba is imported.

Mitsuba 3.9 with LLVM 15 or 16 aborts the process at the first render. The LLVM version is therefore
read with ctypes first; `LLVMGetVersion` is missing below LLVM 16. Dr.Jit reads DRJIT_LIBLLVM_PATH
when it is imported, not later.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from pixsim.base import cache
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.notes import Note, warn
from pixsim.scene.variants import graphics

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_WHEEL = "karellen-llvm-core"
SYSTEM = "system"  # origin of a library, besides the variable and the wheel
_OLDEST_LLVM = 17
LLVM = "llvm_ad_spectral"
SCALAR = "scalar_spectral"
CUDA = graphics.CUDA
VARIANTS = (LLVM, SCALAR, CUDA)
UNUSABLE_HINT = "Leave out --variant; `pixsim doctor` examines LLVM and the graphics card."
_SYSTEM_PATTERNS = (  # of Debian, Fedora and Arch, in /usr
    "lib/*-linux-gnu/libLLVM*.so*",
    "lib/llvm-*/lib/libLLVM*.so*",
    "lib64/libLLVM*.so*",
    "lib64/llvm*/lib/libLLVM*.so*",
    "lib/libLLVM*.so*",
)


@dataclass(frozen=True)
class ChosenVariant:
    """A variant, its LLVM library if any, and why it was chosen.

    processors : where a graphics card traces, what reads the scene and its spectra in this process:
        the driver never runs here
    """

    variant: str
    llvm_path: str | None
    reason: str
    processors: ChosenVariant | None = None

    @property
    def reading(self) -> str:
        """The variant that reads the scene and its spectra: the one that traces, unless a graphics
        card does.
        """
        return self.variant if self.processors is None else self.processors.variant


def llvm_version(path: str) -> int:
    """Return the major version of a libLLVM; 0 if it is older than 16. Raises OSError if it cannot
    be loaded.

    It is loaded with ctypes, which does not abort where Mitsuba would.
    """
    library = ctypes.CDLL(path)
    if not hasattr(library, "LLVMGetVersion"):
        return 0
    major = ctypes.c_uint()
    library.LLVMGetVersion(ctypes.byref(major), None, None)
    return int(major.value)


def _cached_version(path: str) -> int:
    """Return `llvm_version`, cached for a library's size and time of change: loading it takes 50
    ms, in vain without a render.

    Raises OSError if it cannot be loaded, which is not cached: it may need another library that is
    missing.
    """
    if not os.path.exists(path):  # the system may find its name in a folder for libraries
        return llvm_version(path)
    file = os.stat(path)
    key = content_hash(
        [os.path.realpath(path), file.st_size, file.st_mtime_ns, cache.version_fingerprint()]
    )
    return cache.load_or_compute(
        "llvm",
        key,
        lambda content: int(content["major"]),
        lambda: llvm_version(path),
        lambda major: {"major": major},
    )


def _library_fault(path: str) -> str | None:
    """Return why Mitsuba cannot use a libLLVM, or None if it can."""
    try:
        version = _cached_version(path)
    except OSError:
        if os.path.exists(path):
            return "cannot be loaded (no library for this machine)"
        return "cannot be loaded (no such file)"
    return None if version >= _OLDEST_LLVM else f"is version {version or '15 or older'}"


def candidates() -> Iterator[tuple[str, str]]:
    """Iterate over path and origin of libLLVM candidates in the order of preference, without
    loading them.
    """
    if stated := os.environ.get(LLVM_VARIABLE):
        yield stated, LLVM_VARIABLE
    yield from ((path, SYSTEM) for path in _system_candidates())
    yield from ((path, LLVM_WHEEL) for path in _wheel_candidates())


def _newest_first(paths: Iterable[Path]) -> list[str]:
    """Resolve links and sort by the numbers in the names, so that 21 comes before 9."""
    files = {str(path.resolve()) for path in paths}
    return sorted(
        files,
        key=lambda path: ([int(number) for number in re.findall(r"\d+", Path(path).name)], path),
        reverse=True,
    )


def _system_candidates() -> list[str]:
    return _newest_first(
        path for pattern in _SYSTEM_PATTERNS for path in Path("/usr").glob(pattern)
    )


def _wheel_candidates() -> list[str]:
    try:
        files = importlib.metadata.files(LLVM_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return _newest_first(
        Path(str(file.locate())) for file in files if file.name.startswith("libLLVM.so.")
    )


_reasons: dict[str, str] = {}  # of libraries that `choose`, not the user, wrote into the variable


def find_llvm() -> tuple[str | None, str]:
    """Return a usable libLLVM and its origin (the user's variable, the system or the wheel), or
    None and the reason.

    Raises PixsimError if the user's variable names a library that would abort the process.
    """
    stated = os.environ.get(LLVM_VARIABLE)
    if stated in _reasons:
        return stated, _reasons[stated]
    for path, origin in candidates():
        fault = _library_fault(path)
        if fault is None:
            return path, f"{origin}, LLVM {_cached_version(path)}"
        if origin == LLVM_VARIABLE:
            hint = f"Unset it and install the wheel: pip install {LLVM_WHEEL}."
            raise invalid(
                LLVM_VARIABLE, f"'{path}', which {fault}", f"LLVM {_OLDEST_LLVM} or newer", hint
            )
    return None, f"no LLVM {_OLDEST_LLVM} or newer was found"


@lru_cache
def choose(requested: str | None = None) -> ChosenVariant:
    """Choose a variant, or check the requested one, and prepare its LLVM library; call before
    Mitsuba is imported.

    A graphics card that passed its trial is preferred, then LLVM. Falls back to `scalar_spectral`
    with a warning. Raises PixsimError for an unknown variant, for an LLVM variant without a usable
    LLVM, and for a CUDA variant without a driver.
    """
    if requested is not None and requested not in VARIANTS:
        hint = did_you_mean(requested, VARIANTS)
        raise invalid("variant", f"'{requested}'", ", ".join(VARIANTS), hint)
    if requested == SCALAR:
        # Dr.Jit reads the path when it is imported: the next render of this process may need it.
        if LLVM_VARIABLE not in os.environ and "drjit" not in sys.modules:
            _point_to_llvm(*find_llvm())
        return ChosenVariant(SCALAR, None, "requested")

    fault = graphics.no_card_reason() if requested == CUDA else None
    if fault:
        got = f"'{requested}', but {fault}"
        raise invalid("variant", got, "a variant that runs here", UNUSABLE_HINT)

    processors, llvm_fault = _for_processors(requested)
    if requested == CUDA:
        return ChosenVariant(CUDA, processors.llvm_path, "requested", processors)
    if requested is not None:
        return processors

    trial = graphics.graphics_trial()
    if trial.fault is None:
        reason = "the graphics card passed its trial"
        return ChosenVariant(CUDA, processors.llvm_path, reason, processors)
    if llvm_fault:
        warn(Note("machine", words=f"rendering with {SCALAR}, since {llvm_fault}"))
    return replace(processors, reason=f"{processors.reason}; no graphics card: {trial.fault}")


def _point_to_llvm(path: str | None, reason: str) -> None:
    """Write the path of a usable libLLVM, if there is one, into the variable that Dr.Jit reads."""
    if path is not None:
        os.environ[LLVM_VARIABLE] = path
        _reasons[path] = reason


def _for_processors(requested: str | None) -> tuple[ChosenVariant, str]:
    """Return LLVM, or else scalar, and in that case what it lacks for LLVM and how to get it."""
    if "drjit" in sys.modules and not os.environ.get(LLVM_VARIABLE):
        # It is too late to choose a library, and scalar_spectral needs none.
        path = None
        reason = "Mitsuba was imported before its LLVM was checked"
        hint = f"import pixsim.scene.renderer before mitsuba and drjit, or set {LLVM_VARIABLE}"
    else:
        path, reason = find_llvm()
        hint = f"for renders several times faster: pip install {LLVM_WHEEL} (or pixsim[llvm])"
    if path is not None:
        _point_to_llvm(path, reason)
        return ChosenVariant(LLVM, path, reason), ""
    if requested == LLVM:
        raise invalid(
            "variant",
            f"'{requested}', but {reason}",
            f"LLVM {_OLDEST_LLVM} or newer",
            f"To fix this, {hint}.",
        )
    return ChosenVariant(SCALAR, None, reason), f"{reason}; {hint}"
