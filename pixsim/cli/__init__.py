"""The `pixsim` command: options in, messages and files out. Only this package prints or exits.

Results go to stdout, everything else to stderr. Exit codes: 0 success, 1 unexpected error or a
problem that `doctor` reports, 2 invalid input, 130 interrupted, 143 terminated, 129 terminal
closed.

Little is imported here, so that `command` takes Ctrl-C before `main` imports the rest.
"""

from __future__ import annotations

import errno
import gc
import os
import sys

from pixsim.base.children import leave_current_folder
from pixsim.cli.process import discard_output, interruption, leave, open_closed_streams

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

OK = 0
_UNEXPECTED = 1
_INVALID_INPUT = 2


def command() -> NoReturn:
    """Run `main` as a process of its own."""
    leave_current_folder()  # before anything else is imported
    interruption.guard()
    # 7 % of `pixsim run` with a filled cache (0.07 s of processor time); `stages` enables it
    gc.disable()
    # Pydantic looks for them in all installed packages
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        open_closed_streams()
        main()
    except SystemExit as request:
        leave(request.code if isinstance(request.code, int) else OK)
    except KeyboardInterrupt:  # while `main` reported another error
        print(f"pixsim: {interruption.words}", file=sys.stderr)
        leave(interruption.exit_code)


def main(tokens: Sequence[str] | None = None) -> NoReturn:
    """Run the command; errors of the user become one message and an exit code.

    tokens : the arguments after `pixsim`. None takes the arguments of the process
    """
    try:
        from cyclopts.exceptions import CycloptsError
        from pydantic import ValidationError

        from pixsim.base.errors import PixsimError
        from pixsim.base.lazy import ignore_matplotlibrc
        from pixsim.base.problems import explain
        from pixsim.cli.commands import run_command
    except ImportError as error:
        end(broken(error), _UNEXPECTED)
    ignore_matplotlibrc()
    try:
        run_command(sys.argv[1:] if tokens is None else tokens)
    except (PixsimError, ValidationError) as error:
        end(explain(error), _INVALID_INPUT)
    except CycloptsError as error:
        from pixsim.cli.mistakes import refusal

        end(refusal(error), _INVALID_INPUT)
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            end(
                "the limit of open files is too low; raise it with `ulimit -n 1024`, or give"
                " --jobs 1",
                _INVALID_INPUT,
            )
        if not isinstance(error, BrokenPipeError):
            end(f"{error.filename or 'system'}: {error.strerror or error}", _INVALID_INPUT)
        discard_output()  # the reader, such as `head`, has closed the pipe
    except MemoryError:
        end(
            "the system is out of memory; use a coarser film (--resolution 512), larger pixels or"
            " fewer --jobs",
            _UNEXPECTED,
        )
    except ImportError as error:
        end(broken(error), _UNEXPECTED)
    except KeyboardInterrupt as raised:  # a command that keeps something says so in its text
        end("; ".join([interruption.words, *map(str, raised.args)]), interruption.exit_code)
    except Exception as error:
        end(
            f"unexpected {type(error).__name__}: {error}\nThis is a bug in pixsim. --verbose shows"
            " where it occurred.",
            _UNEXPECTED,
        )
    interruption.finish()
    sys.exit(OK)


def broken(error: ImportError) -> str:
    return (
        f"a package is missing or broken ({error}). Install pixsim again: pip install"
        " --force-reinstall pixsim"
    )


def end(message: str, code: int) -> NoReturn:
    from pixsim.base.errors import printable

    interruption.finish()
    options = sys.modules.get("pixsim.cli.options")  # whose import may have failed
    try:
        if options and options.verbosity.verbose:
            import traceback

            print(printable(traceback.format_exc()), file=sys.stderr)
        print(printable(f"pixsim: {message}"), file=sys.stderr, flush=True)
    except OSError:  # a full disk, a reader that is gone
        discard_output()
    sys.exit(code)
