"""Time limit of child processes, and a study that a signal ends at a known evaluation."""

# Far above any run time, so that no result depends on the speed of the machine.
HANG_S = 600

# The command, which sends itself a signal at the start of an evaluation; the film of its study is
# coarse, and not measured. Background jobs of a shell ignore Ctrl-C, and so would their children.
SIGNALLED = """
import signal
from pixsim.cli import command
from pixsim.viewer.development import Development

signal.signal(signal.SIGINT, signal.default_int_handler)
score, started = Development.score, []

def counted(self, frame):
    started.append(frame)
    if len(started) == {count}:
        signal.raise_signal({signal})
    return score(self, frame)

Development.score = counted
command()
"""


def signalled(signal: int, count: int) -> str:
    """`SIGNALLED` as a script for `python -c`."""
    return SIGNALLED.format(signal=int(signal), count=count)
