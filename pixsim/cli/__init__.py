"""The `pixsim` command: options in, messages and files out. The only place that prints or exits.

Results go to stdout, everything else to stderr. Exit codes: 0 done, 2 input that cannot be used, 130 interrupted.
"""

from __future__ import annotations

import signal
import sys
import warnings

from cyclopts.exceptions import CycloptsError
from pydantic import ValidationError

# Errors name the commands in this order.
# isort: off
from pixsim.cli.base import app as app
from pixsim.cli.render import run as run
from pixsim.cli.render import plan as plan
from pixsim.cli.studies import study as study
from pixsim.cli.worth import accuracy as accuracy
from pixsim.cli.datasheet import datasheet as datasheet
from pixsim.cli.edges import sfr as sfr
from pixsim.cli.charts import chart as chart
from pixsim.cli.caches import cache as cache

# isort: on
from pixsim.errors import PixsimError
from pixsim.messages import explain

OK, UNUSABLE_INPUT, INTERRUPTED, TERMINATED = 0, 2, 130, 143


def main() -> None:
    """Run the command; one message and an exit code for whatever the user can mend."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # else worker processes are orphaned
    warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}", file=sys.stderr)
    try:
        app(exit_on_error=False, print_error=False)
    except (PixsimError, ValidationError) as error:
        print(f"pixsim: {explain(error)}", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except CycloptsError as error:
        print(f"pixsim: {error}\nTry 'pixsim --help'.", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except BrokenPipeError:  # the reader, as head, has seen enough
        sys.stderr.close()
        sys.exit(OK)
    except OSError as error:
        print(f"pixsim: {error.filename or 'system'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except KeyboardInterrupt:
        print("pixsim: interrupted; what was finished is kept, and the same command goes on from there", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(OK)
