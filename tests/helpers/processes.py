"""Time limit of child processes, and a study that a signal ends at a known evaluation."""

from __future__ import annotations

# Far above any run time, so that no result depends on the speed of the machine.
HANG_S = 600

# The command, which sends itself a signal at the start of an evaluation. Background jobs of a shell ignore Ctrl-C, and so would
# their children.
SIGNALLED = """
import signal
from pixsim.cli import command
from pixsim.studies import oversampling
from pixsim.viewer.score import ImagingChain

signal.signal(signal.SIGINT, signal.default_int_handler)
score_frame, started = ImagingChain.score_frame, []
measure_film = oversampling.measure_film

def counted(self, frame):
    started.append(frame)
    if len(started) == {count}:
        signal.raise_signal({signal})
    return score_frame(self, frame)

def uncounted(*arguments, **options):
    ImagingChain.score_frame = score_frame
    error = measure_film(*arguments, **options)
    ImagingChain.score_frame = counted
    return error

ImagingChain.score_frame = counted
oversampling.measure_film = uncounted
command()
"""


def signalled(signal: int, count: int) -> str:
    """`SIGNALLED` as a script for `python -c`."""
    return SIGNALLED.format(signal=int(signal), count=count)
