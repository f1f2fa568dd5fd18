"""Which Mitsuba variant can run here, judged before Mitsuba is imported.

Mitsuba 3.9 with LLVM 15 or 16 loads and then aborts the process at the first render. `LLVMGetVersion` is missing below
LLVM 16, so a candidate is judged with ctypes alone. Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported, not later.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pixsim.base.errors import invalid

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_WHEEL = "karellen-llvm-core"
SYSTEM, BY_HAND = "system", "installed by hand"  # where a library is from, beside the variable and the wheel
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
    """Major version of a libLLVM, 0 where it is too old to tell, None where it cannot be loaded.

    Loaded with ctypes, which never aborts where Mitsuba would.
    """
    try:
        get_version = ctypes.CDLL(path).LLVMGetVersion
    except OSError:
        return None
    except AttributeError:
        return 0
    major = ctypes.c_uint()
    get_version(ctypes.byref(major), None, None)
    return int(major.value)


@dataclass(frozen=True)
class Library:
    """A file that may be a libLLVM: where it is from, and its version as `llvm_version` tells it."""

    path: str
    origin: str
    version: int | None

    @property
    def fault(self) -> str | None:
        """Why Mitsuba cannot use it, None where it can."""
        if self.version is None:
            path = Path(self.path)
            why = "it is a folder" if path.is_dir() else "no library for this machine" if path.exists() else "no such file"
            return f"cannot be loaded ({why})"
        return f"is version {self.version or '15 or older'}" if self.version < OLDEST_LLVM else None


def candidates() -> Iterator[tuple[str, str]]:
    """Path and origin of each libLLVM that may be taken, in the order of choice; nothing is loaded."""
    if asked := os.environ.get(LLVM_VARIABLE):
        yield asked, LLVM_VARIABLE
    yield from ((path, SYSTEM) for path in _system_candidates())
    yield from ((path, LLVM_WHEEL) for path in _wheel_candidates())


def found_by_hand() -> list[str]:
    """Libraries where people put them themselves; they are taken through the variable only."""
    homes = [Path("/usr/local/lib"), *Path("/usr/local").glob("llvm*/lib"), *Path("/opt").glob("*/lib"), Path(sys.prefix) / "lib"]
    homes += [Path(each) / "lib" for each in (os.environ.get("CONDA_PREFIX"),) if each]
    homes += [Path(each) for each in os.environ.get("LD_LIBRARY_PATH", "").split(":") if each]
    taken = {os.path.realpath(path) for path, origin in candidates() if origin != LLVM_VARIABLE}
    return [path for path in _newest_first(found for home in homes for found in home.glob("libLLVM*.so*")) if path not in taken]


def mapped() -> list[str]:
    """Each libLLVM in this process, as by Dr.Jit; none where the system does not tell."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    return sorted({"/" + line.partition("/")[2] for line in lines if "libLLVM" in line})


def _newest_first(paths: Iterable[Path]) -> list[str]:
    """Without links to the same file; by the numbers in the names, so that 21 comes before 9."""
    files = {str(path.resolve()) for path in paths}
    return sorted(files, key=lambda path: ([int(number) for number in re.findall(r"\d+", Path(path).name)], path), reverse=True)


def _system_candidates() -> list[str]:
    found = [path for pattern in SYSTEM_PATTERNS for path in Path("/usr").glob(pattern)]
    return _newest_first([*found, *_known_to_the_loader()])


def _known_to_the_loader() -> list[Path]:
    """What /etc/ld.so.conf leads to, as `ldconfig` lists it."""
    ldconfig = shutil.which("ldconfig", path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    if ldconfig is None:
        return []
    try:
        listed = subprocess.run([ldconfig, "-p"], capture_output=True, text=True, errors="replace", timeout=5).stdout
    except (OSError, subprocess.SubprocessError):
        return []
    return [Path(path) for path in re.findall(r"^\s*libLLVM\S* .* => (/.+)$", listed, re.MULTILINE)]


def _wheel_candidates() -> list[str]:
    try:
        files = importlib.metadata.files(LLVM_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return _newest_first(Path(str(file.locate())) for file in files if file.name.startswith("libLLVM.so."))


_reasons: dict[str, str] = {}  # of libraries that `choose` put into the variable itself: not the user's choice


def find_llvm() -> tuple[str | None, str]:
    """A usable libLLVM and where it comes from: the user's variable, the system, the wheel; else None and why.

    PixsimError where the user's variable names one that would abort the process.
    """
    asked = os.environ.get(LLVM_VARIABLE)
    if asked in _reasons:
        return asked, _reasons[asked]
    for path, origin in candidates():
        library = Library(path, origin, llvm_version(path))
        if library.fault is None:
            return path, f"{origin}, LLVM {library.version}"
        if origin == LLVM_VARIABLE:
            mend = f"Unset it and install the wheel: pip install {LLVM_WHEEL}."
            raise invalid(LLVM_VARIABLE, f"'{path}', which {library.fault}", f"LLVM {OLDEST_LLVM} or newer", mend)
    return None, f"no LLVM {OLDEST_LLVM} or newer was found"


@lru_cache
def choose(asked: str | None = None) -> Choice:
    """Choose a variant (or check the one asked for) and set the way for it; call before Mitsuba is imported.

    Falls back to `scalar_spectral` with a warning that says how to get the fast one. PixsimError for an unknown variant,
    or for an LLVM variant without a usable LLVM.
    """
    if asked is not None and asked not in VARIANTS:
        raise invalid("variant", f"'{asked}'", ", ".join(VARIANTS))
    if asked in ("scalar_spectral", "cuda_ad_spectral"):
        return Choice(asked, None, "asked for")
    if "drjit" in sys.modules and not os.environ.get(LLVM_VARIABLE):
        # Too late to choose a library: scalar never touches one.
        mend = "import pixsim.scene.renderer before mitsuba and drjit, or set " + LLVM_VARIABLE
        if asked is not None:
            raise invalid("variant", f"'{asked}' after Mitsuba was imported", "scalar_spectral", f"Or {mend}.")
        why = "Mitsuba was imported before its LLVM was judged"
        warnings.warn(f"rendering with scalar_spectral, since {why}; {mend}", stacklevel=2)
        return Choice("scalar_spectral", None, "Mitsuba was imported before pixsim could judge its LLVM")
    path, reason = find_llvm()
    if path is not None:
        os.environ[LLVM_VARIABLE] = path
        _reasons[path] = reason
        return Choice("llvm_ad_spectral", path, reason)
    mend = f"for renders several times faster: pip install {LLVM_WHEEL} (or pixsim[llvm])"
    if asked is not None:
        raise invalid("variant", f"'{asked}', but {reason}", f"LLVM {OLDEST_LLVM} or newer", f"Install one, {mend}.")
    warnings.warn(f"rendering with scalar_spectral, since {reason}; {mend}", stacklevel=2)
    return Choice("scalar_spectral", None, reason)
