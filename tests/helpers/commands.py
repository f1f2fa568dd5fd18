"""`pixsim LINE` in this process or in one of its own, and what a refusal looks like."""

from __future__ import annotations

import io
import os
import shlex
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from helpers.processes import HANG_S

from pixsim import cli
from pixsim.cli.options import verbosity

COMMAND = Path(sys.executable).with_name("pixsim")


def command(line: str, *words: object) -> tuple[int, str, str]:
    """`pixsim LINE`, and words that are taken as they are, in this process: exit code, stdout, stderr."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(warnings, "showwarning", warnings.showwarning)  # main() sets it
        patch.setattr(verbosity, "__dict__", vars(verbosity).copy())
        with pytest.raises(SystemExit) as end:
            cli.main([*shlex.split(line), *map(str, words)])
    return end.value.code, out.getvalue(), err.getvalue()


def process(line: str, *words: object, folder: Path | None = None, **changes: str | None) -> subprocess.CompletedProcess[str]:
    """The installed command, as `command` takes it, in a process of its own, which HANG_S ends where it hangs.

    changes : of the environment; None removes a variable
    """
    environment = {name: value for name, value in (os.environ | changes).items() if value is not None}
    run = [COMMAND, *shlex.split(line), *map(str, words)]
    return subprocess.run(run, capture_output=True, text=True, timeout=HANG_S, cwd=folder, env=environment)


def assert_refused(code: int, out: str, err: str, wanted: list[str]) -> None:
    assert (code, out) == (2, ""), err
    assert err.startswith("pixsim: ")
    assert "Traceback" not in err
    assert not [text for text in wanted if text.lower() not in err.lower()], err
    assert len(err.splitlines()) <= 2, "one message (and a hint where help is)"
