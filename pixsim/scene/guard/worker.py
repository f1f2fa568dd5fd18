"""The child process of `scene.guard.child`: `python -m pixsim.scene.guard.worker`, with the numbers
of its files as arguments.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.errors import PixsimError
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.guard.loaded import check_files, limit_memory
from pixsim.scene.mitsuba import import_mitsuba

_LACKS_MEMORY = (
    "the scene needs more memory than it may use; use smaller meshes and pictures, or a coarser"
    " film"
)


Picture = NDArray[np.float32]


def answer(
    tracer: InProcessTracer | None, request: dict[str, Any]
) -> tuple[InProcessTracer, dict[str, Any], Picture | None]:
    """Return the tracer of the current job, the reply to a request, and the picture that follows
    it.
    """
    if "job" in request:
        job = request["job"]
        import_mitsuba(job.variant)
        limit_memory(job)
        highest = check_files(job)
        tracer = InProcessTracer(job)
        return tracer, {"scenes": len(tracer.loaded), "highest": highest}, None
    assert tracer is not None
    if "sampler" in request and "seed" not in request:
        return tracer, {"samples": tracer.sample_count(**request)}, None
    if "side" in request:
        picture = tracer.depths(**request)
    elif "film" in request:
        picture = tracer.trace(**request)
    else:
        picture = tracer.trace_together(**request)
    picture = np.ascontiguousarray(picture)
    return tracer, {"channels": picture.shape[2]}, picture


def _end_with_parent(life: int) -> None:
    """Let the system end this process as soon as the other end of a pipe closes, also while Mitsuba
    is at work.
    """
    import fcntl  # Windows has none

    fcntl.fcntl(life, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(life, fcntl.F_SETFL, fcntl.fcntl(life, fcntl.F_GETFL) | os.O_ASYNC | os.O_NONBLOCK)
    try:
        if os.read(life, 1) == b"":  # it is closed already
            os.kill(os.getpid(), signal.SIGKILL)
    except BlockingIOError:
        return


def main(requests: int, replies: int, life: int) -> None:
    """Answer requests until there are no more."""
    # These signals reach the parent too, which kills this process.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    _end_with_parent(life)
    warnings.simplefilter("ignore")  # the parent has given them
    tracer: InProcessTracer | None = None
    with os.fdopen(requests, "rb") as source, os.fdopen(replies, "wb") as out:
        while source.peek():
            picture: Picture | None = None
            try:
                tracer, reply, picture = answer(tracer, pickle.load(source))
            except PixsimError as error:
                reply = {"error": str(error).replace("std::bad_alloc", _LACKS_MEMORY)}
            except MemoryError:
                reply = {"error": _LACKS_MEMORY}
            except Exception as error:
                # As in `pixsim.cli.main`; without its words the parent could only report an exit
                # code.
                name = type(error).__name__
                reply = {"error": f"unexpected {name} in the process that renders: {error}"}
            out.write(json.dumps(reply).encode() + b"\n")
            if picture is not None:
                out.write(picture.data)
            out.flush()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
