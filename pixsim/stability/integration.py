"""Pixel integration where pitch and grid do not divide each other."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pixsim.sensor import integrate_pixels
from pixsim.stability import Case, compare

SAMPLE_UM = 1.0
RATIOS = (1.0, 1 + 1e-12, 1 - 1e-12, 7 / 3, math.pi)


def cases() -> Iterator[Case]:
    picture = np.random.default_rng(0).uniform(0.5, 1.5, (64, 64))
    for ratio in RATIOS:
        got = integrate_pixels(picture, SAMPLE_UM, ratio * SAMPLE_UM, ratio * SAMPLE_UM)
        covered = got.shape[0] * ratio
        if abs(covered - 64) < 1e-9:
            yield compare(
                f"sum over contiguous photodiodes, pitch/grid = {ratio!r}", picture.sum(), got.sum(), 1e-12, "conservation"
            )
