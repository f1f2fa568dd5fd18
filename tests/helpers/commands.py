"""Run `pixsim` in this process or in a new one, and check the message of invalid input."""

from __future__ import annotations

import io
import os
import re
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


SIGN_OF_LIFE = re.compile(r"^\[\d+ s\] .*\n", re.MULTILINE)  # of pixsim.base.progress.Lines


def command(line: str, *words: object) -> tuple[int, str, str]:
    """Run `pixsim LINE` with further arguments in this process: exit code, stdout, and stderr without its signs of life."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(warnings, "showwarning", warnings.showwarning)  # main() sets it
        patch.setattr(verbosity, "__dict__", vars(verbosity).copy())
        with pytest.raises(SystemExit) as end:
            cli.main([*shlex.split(line), *map(str, words)])
    return end.value.code, out.getvalue(), SIGN_OF_LIFE.sub("", err.getvalue())


def process(line: str, *words: object, folder: Path | None = None, **changes: str | None) -> subprocess.CompletedProcess[str]:
    """Run the installed command, with the arguments of `command`, in a new process.

    changes : variables of the environment; None removes one
    """
    environment = {name: value for name, value in (os.environ | changes).items() if value is not None}
    run = [COMMAND, *shlex.split(line), *map(str, words)]
    return subprocess.run(run, capture_output=True, text=True, timeout=HANG_S, cwd=folder, env=environment)


def assert_refused(code: int, out: str, err: str, texts: list[str]) -> None:
    """Exit code 2 and one message on stderr that contains the texts."""
    assert (code, out) == (2, ""), err
    assert err.startswith("pixsim: ")
    assert "Traceback" not in err
    assert not [text for text in texts if text.lower() not in err.lower()], err
    assert len(err.splitlines()) <= 2, "one message (and a hint at --help)"
