"""The `pixsim` command: options in, messages and files out. Only this package prints or exits.

Results go to stdout, everything else to stderr. Exit codes: 0 success, 1 unexpected error or a problem that `doctor` reports,
2 invalid input, 130 interrupted.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

from cyclopts.exceptions import CycloptsError
from pydantic import ValidationError

from pixsim.base.config import explain
from pixsim.base.errors import PixsimError
from pixsim.base.notes import collected_notes
from pixsim.cli import commands as commands  # importing it registers the commands
from pixsim.cli.options import app, set_cache_folders, verbosity

OK, UNEXPECTED, INVALID_INPUT, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143


def main(tokens: Sequence[str] | None = None) -> None:
    """Run the command; errors of the user become one message and an exit code.

    tokens : the arguments after `pixsim`; None takes those of the process
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # otherwise worker processes would be orphaned
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # file names may not be UTF-8
            stream.reconfigure(errors="backslashreplace")
    arguments = verbosity.parse(sys.argv[1:] if tokens is None else tokens)
    set_cache_folders()
    warnings.showwarning = lambda message, *_, **__: verbosity.note(f"warning: {message}")
    try:
        with collected_notes():  # also of the settings, before a result collects its own
            app(with_each_format(arguments), exit_on_error=False, print_error=False)
    except (PixsimError, ValidationError) as error:
        end(explain(error), INVALID_INPUT)
    except CycloptsError as error:
        end(f"{error}\nTry 'pixsim --help'.", INVALID_INPUT)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        sys.stderr.close()
        sys.exit(OK)
    except OSError as error:
        end(f"{error.filename or 'system'}: {error.strerror or error}", INVALID_INPUT)
    except MemoryError:
        end("the system is out of memory; use a coarser film (--resolution 512), larger pixels or fewer --jobs", UNEXPECTED)
    except KeyboardInterrupt as interruption:  # a command that keeps something says so in its text
        end("; ".join(["interrupted", *map(str, interruption.args)]), INTERRUPTED)
    except Exception as error:
        end(f"unexpected {type(error).__name__}: {error}\nThis is a bug in pixsim. --verbose shows where it occurred.", UNEXPECTED)
    sys.exit(OK)


def with_each_format(arguments: Sequence[str]) -> list[str]:
    """Write `--raw tiff png` as `--raw tiff --raw png`: a list that takes all that follows would take the scene too."""
    written: list[str] = []
    for argument in arguments:
        in_list = argument in commands.RAW_FORMATS and written[-2:-1] == ["--raw"]
        written += ["--raw", argument] if in_list else [argument]
    return written


def command() -> NoReturn:
    """Run `main` as a process that ends at once: the clean-up of Dr.Jit would take 0.2 s and has no effect."""
    try:
        main()
    except SystemExit as exit_request:
        if "drjit" in sys.modules and "joblib" not in sys.modules and isinstance(exit_request.code, int):
            with suppress(OSError, ValueError):  # the reader has closed the pipe
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(exit_request.code)
        raise
    sys.exit(OK)


def end(message: str, code: int) -> NoReturn:
    if verbosity.verbose:
        traceback.print_exc()
    print(f"pixsim: {message}", file=sys.stderr)
    sys.exit(code)
