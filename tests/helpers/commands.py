"""Run `pixsim` in this process or in a new one, and check the message of invalid input."""

import copy
import functools
import io
import os
import re
import shlex
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import cyclopts
import pydantic
import pytest
from cyclopts.argument import _collection
from helpers.processes import HANG_S

from pixsim import cli
from pixsim.cli.options import verbosity

COMMAND = Path(sys.executable).with_name("pixsim")


def remembering(function: Callable) -> Callable:
    """Return a function that keeps its results, where its arguments can be keys."""
    cached = functools.cache(function)

    def quick(*arguments, **options):
        try:
            return cached(*arguments, **options)
        except TypeError:  # what cannot be a key
            return function(*arguments, **options)

    return quick


# Cyclopts builds its options and the checks of their types again for each command, and the flags
# that negate each option for each word: most of the time of many of them here.
Arguments = _collection.ArgumentCollection
quick_adapter = remembering(pydantic.TypeAdapter)
quick_groups = remembering(_collection._resolve_groups_from_callable)
arguments_of = remembering(Arguments._from_callable)
quick_negatives = remembering(cyclopts.Parameter.get_negatives)


def quick_arguments(function: Callable, *parameters, reserved=None, **groups):
    """The arguments of a command, unread: copies of those that were made for it first."""
    made = arguments_of(function, *parameters, reserved=tuple(reserved or ()), **groups)
    copies = {id(argument): copy.copy(argument) for argument in made}
    for argument in copies.values():
        argument.tokens, argument._lookup = [], argument._lookup.copy()
        argument.children = Arguments([copies[id(child)] for child in argument.children])
    return Arguments(list(copies.values()))


SIGN_OF_LIFE = re.compile(r"^\[\d+ s\] .*\n", re.MULTILINE)  # of pixsim.base.progress.Lines


def command(line: str, *words: object) -> tuple[int, str, str]:
    """Run `pixsim LINE` with further arguments in this process: exit code, stdout, and stderr
    without its signs of life.
    """
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(warnings, "showwarning", warnings.showwarning)  # main() sets it
        patch.setattr(verbosity, "__dict__", vars(verbosity).copy())
        patch.setenv(
            "COLUMNS", os.environ.get("COLUMNS", "160")
        )  # tables are as wide as the terminal, if there is one
        patch.setattr(pydantic, "TypeAdapter", quick_adapter)
        patch.setattr(_collection, "_resolve_groups_from_callable", quick_groups)
        patch.setattr(Arguments, "_from_callable", quick_arguments)
        patch.setattr(cyclopts.Parameter, "get_negatives", quick_negatives)
        with pytest.raises(SystemExit) as end:
            cli.main([*shlex.split(line), *map(str, words)])
    return end.value.code, out.getvalue(), SIGN_OF_LIFE.sub("", err.getvalue())


def output_of(line: str, *words: object) -> str:
    """Stdout of `pixsim LINE` with further arguments, which must succeed."""
    code, out, err = command(line, *words)
    assert code == 0, err
    return out


def process(
    line: str, *words: object, folder: Path | None = None, **changes: str | None
) -> subprocess.CompletedProcess[str]:
    """Run the installed command, with the arguments of `command`, in a new process.

    changes : variables of the environment; None removes one
    """
    environment = {
        name: value for name, value in (os.environ | changes).items() if value is not None
    }
    return subprocess.run(
        [COMMAND, *shlex.split(line), *map(str, words)],
        capture_output=True,
        text=True,
        timeout=HANG_S,
        cwd=folder,
        env=environment,
    )


def assert_refused(code: int, out: str, err: str, texts: list[str]) -> None:
    """Exit code 2 and one message on stderr that contains the texts."""
    assert (code, out) == (2, ""), err
    assert err.startswith("pixsim: ")
    assert "Traceback" not in err
    assert not [text for text in texts if text.lower() not in err.lower()], err
    assert len(err.splitlines()) <= 2, "one message (and a hint at --help)"
