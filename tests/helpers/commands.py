"""`pixsim LINE` in this process, and what a refusal looks like."""

from __future__ import annotations

import io
import shlex
import warnings
from contextlib import redirect_stderr, redirect_stdout

import pytest

from pixsim import cli


def command(line: str) -> tuple[int, str, str]:
    """`pixsim LINE` in this process: exit code, stdout, stderr."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        words = shlex.split(line)
        patch.setattr(warnings, "showwarning", warnings.showwarning)  # main() sets it
        with pytest.raises(SystemExit) as end:
            cli.main(words)
    return end.value.code, out.getvalue(), err.getvalue()


def assert_refused(code: int, out: str, err: str, wanted: list[str]) -> None:
    assert (code, out) == (2, ""), err
    assert err.startswith("pixsim: ")
    assert "Traceback" not in err
    assert not [text for text in wanted if text.lower() not in err.lower()], err
    assert len(err.splitlines()) <= 2, "one message (and a hint where help is)"
