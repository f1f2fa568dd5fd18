"""Trace scenes that are not pixsim's own in a child process: it can be killed where Mitsuba crashes
or finds no end.

One child serves all renders of a process and ends with it. Requests are pickled dictionaries;
replies are lines of JSON, and the numbers of a picture follow its reply. Nothing that the child
sends is run or unpickled.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pixsim
from pixsim.base.caller import setting
from pixsim.base.children import safe_variables
from pixsim.base.errors import PixsimError, invalid
from pixsim.scene.job import OutOfTimeError, TraceJob
from pixsim.scene.textures import check_share
from pixsim.scene.variants.graphics import CUDA

_ENDED_S = 10.0  # in which a killed process ends
_MAX_REPLY = 1 << 20  # bytes of a line
MAX_CHANNELS = 256
_READ_AT_ONCE = 1 << 16
_LOOK_S = 0.5  # at most, between two looks at the child and the clock


class _ReportedError(PixsimError):
    """An error in the scene that the child reports; the child goes on."""


class _Child:
    """The child process, with its pipes."""

    def __init__(self, on_card: bool) -> None:
        self.owner = os.getpid()
        self.on_card = on_card
        self.process: subprocess.Popen[bytes] | None = None
        self.lock = threading.Lock()
        self.loaded: TraceJob | None = None
        requests, self.requests = os.pipe()
        self.replies, replies = os.pipe()
        life, self.life = os.pipe()  # its other end closes when this process ends, however it does
        descriptors = requests, replies, life
        # Python would look for modules in the current folder first, which may be a stranger's.
        command = [sys.executable, "-P", "-m", "pixsim.scene.guard.worker", *map(str, descriptors)]
        folder = str(Path(pixsim.__file__).parents[1])
        folders = (*os.environ.get("PYTHONPATH", "").split(os.pathsep), folder)
        path = os.pathsep.join(os.path.abspath(part) for part in folders if part)
        null = subprocess.DEVNULL
        try:
            self.process = subprocess.Popen(
                # All names of files are absolute; the current folder may go away while the child
                # lives.
                command,
                cwd="/",
                stdin=null,
                stdout=null,
                stderr=null,
                pass_fds=descriptors,
                env=os.environ | safe_variables() | {"PYTHONPATH": path},
            )
        except OSError as error:
            self.kill()
            hint = "Close other programs, or ask for fewer --jobs."
            raise PixsimError(
                f"a process for the scene cannot be started ({error.strerror}). {hint}"
            ) from None
        finally:
            for descriptor in descriptors:
                os.close(descriptor)
        self._read = b""

    @property
    def usable(self) -> bool:
        return (
            self.owner == os.getpid() and self.process is not None and self.process.poll() is None
        )

    def kill(self) -> None:
        """End the process and close everything; a process that was forked from the owner closes
        only its copies.
        """
        if self.process and self.owner == os.getpid():
            with suppress(OSError):
                self.process.kill()
            with suppress(OSError, subprocess.SubprocessError):
                self.process.wait(timeout=_ENDED_S)
        for name in ("requests", "replies", "life"):
            with suppress(OSError):
                os.close(getattr(self, name))
            setattr(self, name, -1)

    def ask(
        self,
        request: dict[str, Any],
        ends_at_s: float | None,
        picture: tuple[int, int] | None = None,
    ) -> Any:
        """Send a request and return its reply, or the numbers of the picture that follows it,
        (rows, columns, channels).

        picture : rows and columns of the picture that is asked for

        Raises PixsimError if the child reports an error, crashes or takes too long.
        """
        try:
            self._send(pickle.dumps(request), ends_at_s)
            reply = json.loads(self._line(ends_at_s))
            if "error" in reply:
                raise _ReportedError(str(reply["error"]))
            if picture is None:
                return reply
            return self._picture((*picture, int(reply["channels"])), ends_at_s)
        except _ReportedError:
            raise
        except PixsimError:  # no time is left
            self.kill()
            raise
        except (OSError, EOFError, ValueError, TypeError, KeyError, RecursionError):
            code = self._code()
            self.kill()
            raise _crashed(code, self.on_card) from None
        except BaseException:
            # Ctrl-C and SIGTERM too: the child may be within a kernel without an end.
            self.kill()
            raise

    def _code(self) -> int | None:
        try:
            return self.process.wait(timeout=_LOOK_S) if self.process else None
        except subprocess.TimeoutExpired:
            return None

    def _send(self, message: bytes, ends_at_s: float | None) -> None:
        left = memoryview(message)
        os.set_blocking(self.requests, False)
        while left:
            self._wait([], [self.requests], ends_at_s)
            left = left[os.write(self.requests, left[:_READ_AT_ONCE]) :]

    def _line(self, ends_at_s: float | None) -> bytes:
        while b"\n" not in self._read:
            self._wait([self.replies], [], ends_at_s)
            more = os.read(self.replies, _READ_AT_ONCE)
            if not more:
                raise EOFError
            self._read += more
            if len(self._read) > _MAX_REPLY:
                raise ValueError
        line, _, self._read = self._read.partition(b"\n")
        return line

    def _picture(self, shape: tuple[int, int, int], ends_at_s: float | None) -> NDArray[np.float32]:
        if not 1 <= shape[2] <= MAX_CHANNELS:
            raise ValueError
        values = np.empty(shape, np.float32)
        left = values.data.cast("B")
        count = min(len(self._read), len(left))
        left[:count], self._read = self._read[:count], self._read[count:]
        while count < len(left):
            self._wait([self.replies], [], ends_at_s)
            size = os.readv(self.replies, [left[count:]])
            if size == 0:
                raise EOFError
            count += size
        return values

    def _wait(self, reading: list[int], writing: list[int], ends_at_s: float | None) -> None:
        while not any(
            select.select(reading, writing, [], _LOOK_S if ends_at_s is None else _until(ends_at_s))
        ):
            if ends_at_s is not None and time.monotonic() > ends_at_s:
                got = "a limit too short for Mitsuba to finish the picture with the fewest samples"
                hint = (
                    f"Raise it, or use a coarser film ({setting('resolution')}) or a simpler scene."
                )
                raise OutOfTimeError(
                    str(invalid(setting("max_seconds"), got, "more seconds", hint))
                )


def _until(ends_at_s: float) -> float:
    """Return the time to wait, in s, before the next look at the clock."""
    return max(0.0, min(_LOOK_S, ends_at_s - time.monotonic()))


def _crashed(code: int | None, on_card: bool) -> PixsimError:
    how = "" if code is None else f" (exit code {code})"
    if code is not None and code < 0:
        with suppress(ValueError):
            how = f" ({signal.Signals(-code).name})"
    if on_card:
        return PixsimError(
            f"the graphics card or its driver ended Mitsuba's process{how}; it may lack memory for"
            " the scene."
        )
    hint = (
        "Remove parts of the scene to find the cause, or use less memory: a coarser film, smaller"
        " meshes and pictures."
    )
    return invalid(
        "scene",
        f"a scene that crashes Mitsuba{how}",
        "a scene that Mitsuba can build and render",
        hint,
    )


_child: _Child | None = None


def _usable_child(on_card: bool) -> _Child:
    """Return the child, a new one if it crashed, or if a graphics card is to trace and it started
    without, or the reverse.
    """
    global _child
    if _child is None or not _child.usable or _child.on_card != on_card:
        end_child()
        _child = _Child(on_card)
    return _child


@atexit.register
def end_child() -> None:
    """End the child of this process, if there is one."""
    global _child
    if _child is not None:
        _child.kill()
    _child = None


_starting = threading.Lock()


class ChildTracer:
    """An `InProcessTracer` whose work the child does; it loads the job again after a job of another
    renderer.

    ends_at_s : returns the time of `time.monotonic` at which the child is killed, with an
        `OutOfTimeError`. None waits for it
    """

    def __init__(self, job: TraceJob, ends_at_s: Callable[[], float | None] = lambda: None) -> None:
        self.job = job
        self.ends_at_s = ends_at_s

    def _ask(self, request: dict[str, Any], picture: tuple[int, int] | None = None) -> Any:
        with _starting:
            child = _usable_child(self.job.variant == CUDA)
        with child.lock:
            if child.loaded is not self.job:
                child.loaded = None
                reply = child.ask({"job": self.job}, self.ends_at_s())
                for file, highest in zip(self.job.files, reply["highest"], strict=True):
                    check_share(float(highest), file.share, f"'{Path(file.path).name}'")
                child.loaded = self.job
            return child.ask(request, self.ends_at_s(), picture)

    def sample_count(self, sampler: str, samples: int) -> int:
        return int(self._ask({"sampler": sampler, "samples": samples})["samples"])

    def trace(
        self, scene: int, film: dict[str, Any], sampler: str, spp: int, seed: int
    ) -> NDArray[np.float32]:
        request = {"scene": scene, "film": film, "sampler": sampler, "spp": spp, "seed": seed}
        result: NDArray[np.float32] = self._ask(request, (film["crop_height"], film["crop_width"]))
        return result

    def trace_together(
        self,
        scene: int,
        rows: tuple[int, int],
        sampler: str,
        spp: int,
        seed: int,
        block_cells: int = 1,
    ) -> NDArray[np.float32]:
        request = {"scene": scene, "rows": rows, "sampler": sampler, "spp": spp, "seed": seed}
        request["block_cells"] = block_cells
        result: NDArray[np.float32] = self._ask(request, (rows[1] - rows[0], self.job.size[1]))
        return result

    def depths(self, side: int) -> NDArray[np.float32]:
        result: NDArray[np.float32] = self._ask({"side": side}, (side, side))
        return result
