"""What S-CIELAB takes: colours as triples of finite numbers, a white above 0, names that it knows."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from pixsim.errors import refuse

Floats = npt.NDArray[np.float64]


def checked_triples(name: str, values: npt.ArrayLike, dimensions: int | None = None) -> Floats:
    array = np.asarray(values, np.float64)
    if array.ndim != (dimensions or max(array.ndim, 1)) or array.shape[-1] != 3 or array.size == 0:
        allowed = "(H, W, 3), not empty" if dimensions else "(..., 3), not empty"
        raise refuse(f"{name}, shape", array.shape, allowed, "Move the three values last, y and x before them.")
    if not is_finite(array):
        finite = np.isfinite(array)
        first = np.argwhere(~finite)[0]
        got = f"{array[tuple(first)]} at {first.tolist()} ({np.count_nonzero(~finite)} such of {array.size})"
        raise refuse(name, got, "finite numbers", "Mend them where they arise: a filter would spread them.")
    return array


def is_finite(values: Floats) -> bool:
    """NaN goes through both extremes: two readings, and no array of truths."""
    return math.isfinite(values.min()) and math.isfinite(values.max())


def checked_pair(dimensions: int | None = None, **arrays: npt.ArrayLike) -> tuple[Floats, Floats]:
    first, second = (checked_triples(name, values, dimensions) for name, values in arrays.items())
    if first.shape != second.shape:
        shapes = f"shapes {first.shape} and {second.shape}"
        raise refuse(" and ".join(arrays), shapes, "equal ones", "Resample one image to the raster of the other.")
    return first, second


def checked_white(white_xyz: npt.ArrayLike) -> Floats:
    white = np.asarray(white_xyz, np.float64)
    if white.shape != (3,) or not (np.isfinite(white).all() and (white > 0).all()):
        mend = "Give X, Y, Z in the image's unit; D65 is (95.047, 100, 108.883) times its luminance over 100."
        raise refuse("white_xyz", white.tolist(), "three finite numbers above 0", mend)
    return white


def check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise refuse(name, repr(value), ", ".join(map(repr, allowed)))
