"""What pairs and stacks of frames tell: means, temporal and spatial variances (EMVA 1288, sections 6.6 and 8.1)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pixsim.errors import refuse
from pixsim.spectral import Array

Frames = NDArray[np.int32]


@dataclass(frozen=True)
class Pair:
    """What two frames of the same light tell.

    mean_dn : of both. variance_dn2 : temporal. frame_variance_dn2 : of the pixels of one frame, fixed pattern included.
    """

    mean_dn: float
    variance_dn2: float
    frame_variance_dn2: float


def pair(first: Frames, second: Frames) -> Pair:
    """Mean and temporal variance from two frames (EMVA 1288, section 6.6), blind to the fixed pattern and to a drift."""
    a, b = first.astype(float), second.astype(float)
    variance = float(np.mean((a - b) ** 2)) / 2 - (a.mean() - b.mean()) ** 2 / 2
    return Pair(float((a.mean() + b.mean()) / 2), float(variance), float((a.var(ddof=1) + b.var(ddof=1)) / 2))


@dataclass(frozen=True)
class Stack:
    """Mean and temporal variance of each pixel over frames of the same light.

    mean_dn, variance_dn2 : (rows, columns)
    """

    frames: int
    mean_dn: Array = field(repr=False)
    variance_dn2: Array = field(repr=False)

    @property
    def temporal_dn2(self) -> float:
        return float(self.variance_dn2.mean())

    @property
    def spatial_dn2(self) -> float:
        """Variance of the mean image, less what the temporal noise leaves in it (EMVA 1288, section 8.1)."""
        return float(self.mean_dn.var(ddof=1)) - self.temporal_dn2 / self.frames


def stack(frames: Iterable[Frames]) -> Stack:
    """PixsimError for fewer than two frames."""
    count, total, squares = 0, np.zeros((), np.int64), np.zeros((), np.int64)
    for each in frames:
        wide = each.astype(np.int64)  # sums of 24-bit codes squared stay exact up to 2^15 frames
        count, total, squares = count + 1, total + wide, squares + wide * wide
    if count < 2:
        raise refuse("frames of a stack", count, "2 or more")
    sum_of_squares = (count * squares - total * total).astype(float) / count
    return Stack(count, np.asarray(total / count), np.asarray(sum_of_squares / (count - 1)))


@dataclass(frozen=True)
class Series:
    """(n,) means and variances of pairs of frames, over what was varied (photons, seconds)."""

    at: Array = field(repr=False)
    mean_dn: Array = field(repr=False)
    variance_dn2: Array = field(repr=False)
    frame_variance_dn2: Array = field(repr=False)


def series(at: Array, pairs: list[Pair]) -> Series:
    columns = ("mean_dn", "variance_dn2", "frame_variance_dn2")
    return Series(np.asarray(at, float), *(np.array([getattr(each, name) for each in pairs]) for name in columns))
