"""What traces a job: this process or, for scenes that may crash Mitsuba or hold it, a child of it that can be killed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.own_tracer import OwnTracer
from pixsim.scene.job import TraceJob


class Tracer(Protocol):
    """What traces a job."""

    def sample_count(self, sampler: str, samples: int) -> int:
        """Return the samples that a sampler takes where `samples` are asked for."""

    def trace(self, scene: int, film: dict[str, Any], sampler: str, spp: int, seed: int) -> NDArray[np.float32]:
        """Return a picture (rows, columns, channels) of a scene of the job; `film` describes the plugin."""

    def trace_together(self, scene: int, rows: tuple[int, int], sampler: str, spp: int, seed: int) -> NDArray[np.float32]:
        """Return rows of the pictures of all pulses of a scene's `Passes`, (rows, columns, pulses); `spp` of each pass."""

    def depths(self, side: int) -> NDArray[np.float32]:
        """Return depths along the optical axis in m at (side, side, 1) places of the film, seen from the middle of the lens.

        They are infinite beyond all shapes, and NaN where a surface shows something at another depth: behind it, or in a mirror.
        """


def tracer_of(job: TraceJob, in_this_process: bool, ends_at_s: Callable[[], float | None] = lambda: None) -> Tracer:
    """Return what traces a job: this process, or a child of it, which can be killed and whose crash ends nothing else.

    ends_at_s : as of `ChildTracer`
    """
    return OwnTracer(job) if in_this_process else ChildTracer(job, ends_at_s)
