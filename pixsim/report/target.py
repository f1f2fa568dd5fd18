"""Where a target is: a mark in the pictures of a run, and the pixels around it enlarged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.digits import pixel_size, rounded
from pixsim.scene.scene import Scene
from pixsim.show.document import Block, Tiles
from pixsim.show.pictures import Picture, Window
from pixsim.studies.merit import extent
from pixsim.studies.run import RunResult

# Pixels
_MIN_SIDE = 24  # of the enlarged part
_MIN_MARGIN = 8  # around a target
_LONG_SIDE = 96  # of the enlarged part, beyond which only the middle of a long target is in it
_SIGMAS = 2.0  # of the noise, beyond the darkest and the brightest light of the pixels
_ENLARGED_DOTS = 336  # side of an enlarged part on the page, at most
_FRAME_SHARE = 1 / 256  # of a picture's shorter side: width of each of the two lines of a frame


@dataclass(frozen=True)
class TargetPlace:
    """The place of a target in the middle of a run's frame.

    half_px : half of its sides in pixels, down and across; infinite for an edge
    pixel_mm : side of a pixel in the plane of the target
    """

    half_px: tuple[float, float]
    pixel_mm: float

    @property
    def _sides(self) -> tuple[float, float]:
        """The shorter and the longer side in pixels; 0 for an edge."""
        sides = [2 * half for half in self.half_px if math.isfinite(half)] or [0.0]
        return min(sides), max(sides)

    @property
    def margin(self) -> float:
        """Pixels around it."""
        return max(_MIN_MARGIN, self._sides[0] / 2)

    def side(self, shape: tuple[int, int]) -> int:
        """Return the side of the enlarged square in pixels, in a frame of so many."""
        short, long = self._sides
        largest = max(_LONG_SIDE, 2 * short)
        return min(math.ceil(max(_MIN_SIDE, min(long + 2 * self.margin, largest))), *shape)


def place_of(result: RunResult) -> TargetPlace | None:
    """Return where a run's target is, or None for a scene without one."""
    scene = result.prepared.source
    if not isinstance(scene, Scene) or not scene.shows_target or scene.target.contrast == 0:
        return None
    target = scene.target
    camera = result.camera
    ends_mm = target.ends_mm(
        *target.lengths_in_scene_mm(camera.magnification, camera.object_distance_m)
    )
    pixel_mm = result.score.frame.pitch_um / (1e3 * camera.magnification)
    down_px, across_px = (end_mm / pixel_mm for _, end_mm in ends_mm)
    return TargetPlace((down_px, across_px), pixel_mm)


def marked(picture: Picture, result: RunResult, place: TargetPlace) -> Picture:
    """Return a whole picture with a frame around the target."""
    pitch_mm = 1e-3 * result.score.frame.pitch_um
    half_side = place.side(result.score.frame.pixels) / 2
    half_mm = [
        pitch_mm * (half + place.margin if math.isfinite(half) else half_side)
        for half in place.half_px
    ]
    left, right, bottom, top = extent(result.irradiance, result.score.border_um)
    height = min(2 * half_mm[0] / (bottom - top), 1.0)
    width = min(2 * half_mm[1] / (right - left), 1.0)
    window = Window((1 - height) / 2, (1 - width) / 2, height, width)
    return replace(picture, codes=_framed(picture.codes, window))


def _framed(codes: NDArray[np.uint8], window: Window) -> NDArray[np.uint8]:
    """Return codes, (H, W) or (H, W, 3), with a frame of a black and a white line around a part."""
    codes = codes.copy()
    line = max(1, round(min(codes.shape[:2]) * _FRAME_SHARE))
    part = window.of(codes)
    inner = part[2 * line : -2 * line, 2 * line : -2 * line].copy()
    part[:] = 0
    part[line:-line, line:-line] = 255
    part[2 * line : -2 * line, 2 * line : -2 * line] = inner
    return codes


def enlarged(result: RunResult, place: TargetPlace) -> Iterator[Block]:
    """Yield the pixels around the target without noise and in the first raw frame, enlarged on one
    scale of grey, and what they are.
    """
    frame = result.score.frame
    rows, columns = frame.pixels
    side = place.side(frame.pixels)
    part = tuple(slice((count - side) // 2, (count + side) // 2) for count in (rows, columns))

    # Each channel of a colour sensor relative to its mean: filters pass different shares.
    light_e = frame.mean_e[:rows][part]
    raw_e = frame.estimate_e[:rows][part]
    level_e = np.full(light_e.shape, light_e.mean())
    if frame.layout is not None:
        channels = frame.layout.numbers(frame.shape)[:rows][part]
        for channel in np.unique(channels):
            is_channel = channels == channel
            level_e[is_channel] = light_e[is_channel].mean()
    level_e = np.maximum(level_e, np.finfo(float).tiny)
    light = light_e / level_e
    raw = raw_e / level_e

    noise = _SIGMAS * float((raw - light).std())
    low = float(light.min()) - noise
    high = float(light.max()) + noise
    times = max(1, _ENLARGED_DOTS // side)
    yield (
        f"The target enlarged, {side} × {side} pixels in the middle of the frame: each square is a"
        f" pixel of {pixel_size(frame.pitch_um)}, {rounded(place.pixel_mm, 3)} mm on the part."
        f" Black is {max(low, 0.0):.3g} and white {high:.3g} of their mean light:"
    )
    yield Tiles(
        tuple(
            Picture(np.kron(_codes(values, low, high), np.ones((times, times), np.uint8)), name)
            for values, name in ((light, "without noise"), (raw, "one raw frame"))
        ),
        "the target, enlarged",
    )


def _codes(values: Array, low: float, high: float) -> NDArray[np.uint8]:
    """Return values as codes of grey, from black at `low` to white at `high`."""
    share = (values - low) / max(high - low, np.finfo(float).tiny)
    return np.asarray(np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8))
