"""Try what may abort or hang (LLVM, Mitsuba, graphics driver) in a child process with a time limit.

`scene.variants.checks` is what the child does.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

from pixsim.base.children import safe_variables
from pixsim.base.digits import percent

Line = dict[str, Any]
START = "import sys; sys.path[:] = {path!r}; from pixsim.scene.variants.checks import main; main({fd}, {kind!r}, *{arguments!r})"
MAX_MEAN_ERROR, MAX_RMS_ERROR = 1e-3, 1e-2  # of the illuminance of the test render, normally 1e-5 and 4e-3


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
    """Run one of the checks in a new process with the same module path."""
    reading, writing = os.pipe()
    code = START.format(path=sys.path, fd=writing, kind=kind, arguments=arguments)
    start = time.perf_counter()
    with os.fdopen(reading, encoding="utf-8") as pipe:
        try:
            child = subprocess.Popen(
                [sys.executable, "-P", "-c", code], env=os.environ | safe_variables(),
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


def picture_fault(trial: Trial) -> str | None:
    """Why a trial render gave no image or a wrong one; None if it is correct."""
    if reason := trial.fault or trial.facts.get("refused"):
        return str(reason)
    if (mean := trial.facts.get("mean_error")) is None:
        return "gives no result"
    rms = trial.facts["rms_error"]
    if abs(mean) <= MAX_MEAN_ERROR and rms <= MAX_RMS_ERROR:  # False for NaN
        return None
    size = f"{percent(mean, 2)} (mean), {percent(rms, 2)} (RMS)"
    return f"its image is wrong: the illuminance differs from the closed form by {size}"
