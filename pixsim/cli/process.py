"""The process of a command: requests to end it (Ctrl-C, SIGTERM, a closed terminal), and closed
standard streams.

It imports nothing but modules that Python has loaded by then, so that it is in place before
anything else is imported.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import time
from contextlib import suppress

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn

_SIGNAL_WORDS = {
    "SIGINT": "interrupted",
    "SIGTERM": "terminated",
    "SIGHUP": "the terminal was closed",
}
# Windows has no SIGHUP
_WORDS_OF_SIGNAL = {
    getattr(signal, name): words for name, words in _SIGNAL_WORDS.items() if hasattr(signal, name)
}
_IS_TIMED = hasattr(signal, "setitimer")  # else (Windows) nothing is raised later
# the exit code of a shell for a process that a signal ended, less the signal's number
NOT_MET = 3  # exit code where a result does not meet a requirement
_SIGNAL_EXIT = 128
# for the clean-up after a signal; another one after that ends the process at once
_PATIENCE_S = 5.0
_WAIT_S = 0.02  # before another try to raise
_LONGEST_WAIT_S = 3.0
_IMPORTING = "<frozen importlib._bootstrap>"  # file name of Python's import, in its frames
_ENTERING = ("__enter__", "__exit__", "enter_context")


class _Interruption:
    """The first signal that asks this process to end, and what follows from it.

    Before the command begins, the process ends at once: nothing is written, nothing else runs.
    Afterwards a KeyboardInterrupt is raised, so that everything opened is closed. It is not raised
    while Python imports a module, since libraries in C++ turn it into other errors, nor while a
    context manager is entered or left, as workers are: resources that were opened are then always
    closed. From `end_or_raise` on, when the result is printed, it is not raised.
    """

    received: int | None = None  # number of the signal that ends the command
    _first_s: float | None = None  # when the first signal came
    _begun = _done = False

    def guard(self) -> None:
        """Take the signals, except those that whoever started this process has set to be ignored
        (nohup, background jobs).
        """
        for number in _WORDS_OF_SIGNAL:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._receive)
        if _IS_TIMED:
            signal.signal(signal.SIGALRM, self._raise)
        sys.unraisablehook = self._unraisable
        atexit.register(self._ignore)  # the first one registered runs last

    def begin(self) -> None:
        """The command begins: from now on a signal raises KeyboardInterrupt."""
        self._begun = True
        self._done = False
        self._first_s = None

    def end_or_raise(self) -> None:
        """The command has ended but for its result, which is printed. Raises KeyboardInterrupt if a
        signal has come before.
        """
        self._done = True
        if self.received is not None:
            _raise_after(0)
            raise KeyboardInterrupt

    def finish(self) -> None:
        """The command has ended: a signal does not disturb the clean-up of the process."""
        self._done = True
        _raise_after(0)

    @property
    def words(self) -> str:
        """What happened, for a message; Python itself may have raised KeyboardInterrupt."""
        return _WORDS_OF_SIGNAL[signal.Signals(self.received or signal.SIGINT)]

    @property
    def exit_code(self) -> int:
        return _SIGNAL_EXIT + (self.received or signal.SIGINT)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if self._first_s is None:
            self._first_s = now_s
        if now_s - self._first_s > _PATIENCE_S:
            self.received = number
            self._leave()
        elif not self._done and self.received is None:
            self.received = number
            if self._begun:
                self._raise(number, frame)
            else:
                self._leave()

    def _raise(self, _: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, or try again soon."""
        waited_s = time.monotonic() - (self._first_s or 0.0)
        if self._done:
            return
        if _IS_TIMED and waited_s < _LONGEST_WAIT_S and _must_wait(frame):
            _raise_after(_WAIT_S)
        else:
            raise KeyboardInterrupt

    def _unraisable(self, failure: sys.UnraisableHookArgs) -> None:
        """Raise again later what Python can only print, since it was raised in a finalizer or a
        callback.
        """
        if (
            _IS_TIMED
            and isinstance(failure.exc_value, KeyboardInterrupt)
            and self.received is not None
        ):
            _raise_after(_WAIT_S)
        else:
            sys.__unraisablehook__(failure)

    @staticmethod
    def _ignore() -> None:
        """Ignore signals while Python clears its modules, 0.2 s: it takes our handlers away first,
        and its own would end the process as if the command had not ended.
        """
        for number in _WORDS_OF_SIGNAL:
            signal.signal(number, signal.SIG_IGN)

    def _leave(self) -> NoReturn:
        with suppress(OSError):
            os.write(2, f"pixsim: {self.words}\n".encode())
        os._exit(self.exit_code)


def _raise_after(seconds: float) -> None:
    """Let `Interruption._raise` be called after a time, or no more (0)."""
    if _IS_TIMED:
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _must_wait(frame: FrameType | None) -> bool:
    """Whether a module is imported, or a context manager entered or left, in a frame or those that
    called it.
    """
    while frame is not None:
        code = frame.f_code
        if code.co_filename == _IMPORTING or (
            code.co_name in _ENTERING and code.co_filename.endswith("contextlib.py")
        ):
            return True
        frame = frame.f_back
    return False


interruption = _Interruption()


def open_closed_streams() -> None:
    """Open /dev/null in place of a closed standard stream: otherwise the next file that is opened
    would take its place.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            # It takes the lowest number, which is this one
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            stream = open(  # noqa: SIM115
                number, mode, encoding="utf-8", errors="backslashreplace", closefd=False
            )
            setattr(sys, name, stream)


def discard_output() -> None:
    """Send pending output to /dev/null: the reader has closed the pipe, or the disk is full."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # ValueError: a stream without a file
            try:
                stream.flush()
            except (OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)


def leave(code: int) -> NoReturn:
    """End the process; at once where that is safe, since the clean-up of the modules takes up to
    0.2 s and has no effect.
    """
    interruption.finish()
    discard_output()
    if "joblib" not in sys.modules:
        atexit._run_exitfuncs()
        discard_output()
        os._exit(code)
    sys.exit(code)
