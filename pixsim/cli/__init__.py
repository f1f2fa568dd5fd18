"""The `pixsim` command: options in, messages and files out. The only place that prints or exits.

Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 something unexpected, or a problem that doctor found, 2
input that cannot be used, 130 interrupted.
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
from pixsim.cli import commands as commands  # they join the app when imported
from pixsim.cli.options import app, keep_helpers_files_together, manner

OK, UNEXPECTED, UNUSABLE_INPUT, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143


def main(tokens: Sequence[str] | None = None) -> None:
    """Run the command; one message and an exit code for whatever the user can mend.

    tokens : the words after `pixsim`; None takes those of the process
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # else worker processes are orphaned
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files may be no UTF-8
            stream.reconfigure(errors="backslashreplace")
    words = manner.take(sys.argv[1:] if tokens is None else tokens)
    keep_helpers_files_together()
    warnings.showwarning = lambda message, *_, **__: manner.note(f"warning: {message}")
    try:
        app(words, exit_on_error=False, print_error=False)
    except (PixsimError, ValidationError) as error:
        end(explain(error), UNUSABLE_INPUT)
    except CycloptsError as error:
        end(f"{error}\nTry 'pixsim --help'.", UNUSABLE_INPUT)
    except BrokenPipeError:  # the reader, as head, has seen enough
        sys.stderr.close()
        sys.exit(OK)
    except OSError as error:
        end(f"{error.filename or 'system'}: {error.strerror or error}", UNUSABLE_INPUT)
    except MemoryError:
        end("the system is out of memory; a coarser film (-D resolution=512), larger pixels or fewer --jobs take less", UNEXPECTED)
    except KeyboardInterrupt:
        end("interrupted; what was finished is kept, and the same command goes on from there", INTERRUPTED)
    except Exception as error:
        end(f"unexpected {type(error).__name__}: {error}\nThis is a mistake of pixsim's. --verbose tells where.", UNEXPECTED)
    sys.exit(OK)


def command() -> NoReturn:
    """`main` as a process: it ends at once. Dr.Jit takes a fifth of a second to take itself down, with nothing left to do."""
    try:
        main()
    except SystemExit as ending:
        if "drjit" in sys.modules and "joblib" not in sys.modules and isinstance(ending.code, int):
            with suppress(OSError, ValueError):  # a reader that has gone
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(ending.code)
        raise
    sys.exit(OK)


def end(message: str, code: int) -> NoReturn:
    if manner.verbose:
        traceback.print_exc()
    print(f"pixsim: {message}", file=sys.stderr)
    sys.exit(code)
