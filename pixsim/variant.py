"""Which Mitsuba variant can run here, judged before Mitsuba is imported.

Mitsuba 3.9 with LLVM 15 or 16 loads and then aborts the process at the first render. `LLVMGetVersion` is missing below
LLVM 16, so a candidate is judged with ctypes alone. Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported, not later.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import os
import sys
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pixsim.errors import refuse

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_WHEEL = "karellen-llvm-core"
OLDEST_LLVM = 17
VARIANTS = ("llvm_ad_spectral", "scalar_spectral", "cuda_ad_spectral")
SYSTEM_PATTERNS = (
    "lib/*-linux-gnu/libLLVM*.so*",
    "lib/llvm-*/lib/libLLVM*.so*",
    "lib64/libLLVM*.so*",
    "lib/libLLVM*.so*",
)


@dataclass(frozen=True)
class Choice:
    """A variant, the LLVM library behind it if any, and why it was taken."""

    variant: str
    llvm_path: str | None
    reason: str


def llvm_version(path: str) -> int | None:
    """Major version of a libLLVM, 0 where it is too old to tell, None where it cannot be loaded."""
    try:
        get_version = ctypes.CDLL(path).LLVMGetVersion
    except OSError:
        return None
    except AttributeError:
        return 0
    major = ctypes.c_uint()
    get_version(ctypes.byref(major), None, None)
    return int(major.value)


def _system_candidates() -> list[str]:
    found = {str(path.resolve()) for pattern in SYSTEM_PATTERNS for path in Path("/usr").glob(pattern)}
    named = ctypes.util.find_library("LLVM")
    return sorted(found | ({named} if named else set()), reverse=True)


def _wheel_candidates() -> list[str]:
    try:
        files = importlib.metadata.files(LLVM_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted({str(Path(str(file.locate())).resolve()) for file in files if file.name.startswith("libLLVM.so.")})


def find_llvm() -> tuple[str | None, str]:
    """A usable libLLVM and where it comes from: the user's variable, the system, the wheel; else None and why.

    PixsimError where the user's variable names one that would abort the process.
    """
    asked = os.environ.get(LLVM_VARIABLE)
    if asked:
        version = llvm_version(asked)
        if version is None or version < OLDEST_LLVM:
            got = "cannot be loaded" if version is None else f"is version {version or '15 or older'}"
            raise refuse(
                LLVM_VARIABLE,
                f"'{asked}', which {got}",
                f"LLVM {OLDEST_LLVM} or newer",
                f"Unset it and install the wheel: pip install {LLVM_WHEEL}.",
            )
        return asked, f"{LLVM_VARIABLE}, LLVM {version}"
    for origin, candidates in (("system", _system_candidates()), (LLVM_WHEEL, _wheel_candidates())):
        for path in candidates:
            version = llvm_version(path)
            if version is not None and version >= OLDEST_LLVM:
                return path, f"{origin}, LLVM {version}"
    return None, f"no LLVM {OLDEST_LLVM} or newer was found"


@lru_cache
def choose(asked: str | None = None) -> Choice:
    """Choose a variant (or check the one asked for) and set the way for it; call before Mitsuba is imported.

    Falls back to `scalar_spectral` with a warning that says how to get the fast one. PixsimError for an unknown variant,
    or for an LLVM variant without a usable LLVM.
    """
    if asked is not None and asked not in VARIANTS:
        raise refuse("variant", f"'{asked}'", ", ".join(VARIANTS))
    if asked in ("scalar_spectral", "cuda_ad_spectral"):
        return Choice(asked, None, "asked for")
    if "drjit" in sys.modules and not os.environ.get(LLVM_VARIABLE):
        # Too late to choose a library: scalar never touches one.
        mend = "import pixsim.renderer before mitsuba and drjit, or set " + LLVM_VARIABLE
        if asked is not None:
            raise refuse("variant", f"'{asked}' after Mitsuba was imported", "scalar_spectral", f"Or {mend}.")
        warnings.warn(
            f"rendering with scalar_spectral, since Mitsuba was imported before its LLVM was judged; {mend}", stacklevel=2
        )
        return Choice("scalar_spectral", None, "Mitsuba was imported before pixsim could judge its LLVM")
    path, reason = find_llvm()
    if path is not None:
        os.environ[LLVM_VARIABLE] = path
        return Choice("llvm_ad_spectral", path, reason)
    mend = f"for renders several times faster: pip install {LLVM_WHEEL} (or pixsim[llvm])"
    if asked is not None:
        raise refuse("variant", f"'{asked}', but {reason}", f"LLVM {OLDEST_LLVM} or newer", f"Install one, {mend}.")
    warnings.warn(f"rendering with scalar_spectral, since {reason}; {mend}", stacklevel=2)
    return Choice("scalar_spectral", None, reason)
