"""Processes that tests start: the limit that ends one that hangs, and a study that a signal ends at a known place."""

from __future__ import annotations

# Only what hangs takes so long: no result depends on how fast the machine is.
HANG_S = 600

# The command, which sends itself a signal when it begins the evaluation with that number. A shell's background jobs ignore
# Ctrl-C, and so would their children.
SIGNALLED = """
import signal
from pixsim.cli import command
from pixsim.viewer.score import ImagingChain

signal.signal(signal.SIGINT, signal.default_int_handler)
view, begun = ImagingChain.view, []

def counted(self, frame):
    begun.append(frame)
    if len(begun) == {count}:
        signal.raise_signal({signal})
    return view(self, frame)

ImagingChain.view = counted
command()
"""


def signalled(signal: int, count: int) -> str:
    """`SIGNALLED` as a script for `python -c`."""
    return SIGNALLED.format(signal=int(signal), count=count)
