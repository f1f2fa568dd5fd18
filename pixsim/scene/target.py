"""A target on a uniform background, for metrics of detectability: a disc, a bar or an edge, drawn
as exact means over texels.

Such a metric takes the light without the target from the same scene with a contrast of 0. So that
the difference is due to the target alone, the texels are the cells of the film, and a cell has the
share of the target that its area covers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pixsim.base.arrays import Array
from pixsim.base.bounds import Positive
from pixsim.base.errors import invalid
from pixsim.base.records import Record
from pixsim.optics.camera import Camera

Size = Annotated[float, Field(ge=1e-9, le=1e9)]
SIZES = ("size_mm", "size_mrad", "size_um")
_BAR_LENGTH = 5.0  # widths, as the bars of MIL-STD-150A and of the USAF chart
# Of the background: float32 holds a smaller change with an error of more than 0.6 %.
_MIN_STEP = 1e-5


class Target(Record):
    """A target in the centre of a uniform field. An edge is the border of a target that fills the
    right or the lower half.
    """

    shape: Literal["disc", "bar", "edge"] = Field(
        "disc", description="disc, bar (5 times as long as wide), or edge"
    )
    contrast: Annotated[float, Field(ge=-1, le=1e6)] = Field(
        -0.1,
        description="luminance of the target over that of the background, minus 1; 0: no target",
    )
    size_mm: Size | None = Field(
        None, description="diameter of the disc or width of the bar, in the plane in focus"
    )
    size_mrad: Size | None = Field(
        None, description="this size over the distance of that plane from the lens"
    )
    size_um: Size | None = Field(None, description="this size on the sensor")
    direction: Literal["vertical", "horizontal"] = Field(
        "vertical", description="of the bar's length, or of the edge"
    )

    @model_validator(mode="after")
    def _states_its_size_once(self) -> Self:
        sizes = [name for name in SIZES if getattr(self, name) is not None]
        if self.shape == "edge" and sizes:
            raise ValueError(
                f"{' and '.join(sizes)} with shape = 'edge', which has no size; leave it out"
            )
        if self.shape != "edge" and len(sizes) != 1:
            names = " and ".join(sizes) or "no size"
            raise ValueError(f"{names} for the target; give one of {', '.join(SIZES)}")
        if self.shape == "disc" and "direction" in self.model_fields_set:
            raise ValueError("direction with shape = 'disc', which has none; leave it out")
        return self

    @classmethod
    def from_parameters(
        cls, stated: Mapping[str, object], defaults: Mapping[str, object]
    ) -> Target:
        """Return the target of a scene's parameters, stated and default ones.

        A stated size takes the place of the default, in whatever unit that is. A shape may lack
        what a default states.

        Raises PixsimError for values that are no target.
        """
        shape = stated.get("shape", defaults.get("shape", cls.model_fields["shape"].default))
        unused = set()
        if shape == "edge" or any(name in stated for name in SIZES):
            unused |= {*SIZES}
        if shape == "disc":
            unused.add("direction")
        values = {name: value for name, value in defaults.items() if name not in unused}
        values |= stated
        return cls(**{name: values[name] for name in cls.model_fields if name in values})

    def size_in_scene_mm(self, camera: Camera) -> float:
        """Return the size in the plane in focus of a camera; 0 for an edge."""
        if self.size_um is not None:
            return self.size_um / (1e3 * camera.magnification)
        return self.size_mm or (self.size_mrad or 0.0) * camera.object_distance_m

    def texels(
        self, shape: tuple[int, int], sides_mm: tuple[Positive, Positive], size_mm: float
    ) -> NDArray[np.float32]:
        """Return the relative luminance of a field, (H, W), row 0 at the top: 1, and 1 + contrast
        where the target is.

        shape : (H, W) texels
        sides_mm : (height, width) of the field
        size_mm : of the target, as in the field

        Raises PixsimError if the target is larger than the field, or if its contrast in a texel is
        lost in float32.
        """
        down_mm, across_mm = self._ends_mm(size_mm)
        if self.shape != "edge":
            self._check_size((2 * down_mm[1], 2 * across_mm[1]), sides_mm)

        rows_mm, columns_mm = (
            np.linspace(-side / 2, side / 2, count + 1)
            for side, count in zip(sides_mm, shape, strict=True)
        )
        if self.shape == "disc":
            cover = disc_cover(rows_mm, columns_mm, size_mm / 2)
        else:
            down = _share_between(rows_mm, *down_mm)
            cover = np.outer(down, _share_between(columns_mm, *across_mm))

        step = abs(self.contrast) * float(cover.max())
        if 0 < step < _MIN_STEP:
            raise invalid(
                "contrast",
                f"{self.contrast:g}, which changes the light of no film cell by more than"
                f" {step:.2g}",
                f"0, or a change of at least {_MIN_STEP:g}, which float32 can represent",
                "The signal is linear in the contrast: choose a larger one and scale its result, or"
                " a finer film.",
            )
        return (1 + self.contrast * cover).astype(np.float32)

    def _ends_mm(self, size_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return where the target begins and ends, downwards and to the right from the middle of
        the field; of a disc its bounding box.
        """
        half_mm = size_mm / 2
        along = (-half_mm, half_mm)
        across = (-half_mm, half_mm)
        if self.shape == "edge":
            along = (-np.inf, np.inf)
            across = (0.0, np.inf)
        elif self.shape == "bar":
            along = -half_mm * _BAR_LENGTH, half_mm * _BAR_LENGTH
        return (across, along) if self.direction == "horizontal" else (along, across)

    def _check_size(
        self, target_mm: tuple[float, float], sides_mm: tuple[Positive, Positive]
    ) -> None:
        """Raise PixsimError if a target is larger than its field, both (height, width)."""
        if target_mm[0] <= sides_mm[0] and target_mm[1] <= sides_mm[1]:
            return
        got = (
            f"{target_mm[1]:.4g} × {target_mm[0]:.4g} mm in the plane in focus, in a field of"
            f" {sides_mm[1]:.4g} × {sides_mm[0]:.4g} mm"
        )
        raise invalid(
            "size of the target", got, "a target within the field", "Choose a smaller size."
        )


def _share_between(edges: Array, low: float, high: float) -> Array:
    """Return the share of each interval (n,) between edges (n + 1,) that lies between `low` and
    `high`.
    """
    return np.asarray(np.diff(np.clip(edges, low, high)) / np.diff(edges))


def disc_cover(rows: Array, columns: Array, radius: float) -> Array:
    """Return the share of each cell (H, W) that a disc around 0 covers.

    rows, columns : edges of the cells, (H + 1,) and (W + 1,), in the unit of the radius

    The area of the disc to the left of and above each corner is a closed form, and cells are its
    differences.
    """
    cover = np.zeros((rows.size - 1, columns.size - 1))

    # Cells that the disc touches
    y = np.clip(rows / radius, -1, 1)
    x = np.clip(columns / radius, -1, 1)
    down, across = (
        slice(max(np.searchsorted(edges, -1, "right") - 1, 0), np.searchsorted(edges, 1) + 1)
        for edges in (y, x)
    )
    y = y[down, None]
    x = x[across]

    def half_area(x: Array) -> Array:
        """Area between the x axis and the circle, from -1 to x."""
        return (x * np.sqrt(1 - x * x) + np.arcsin(x)) / 2 + np.pi / 4

    # The area between the x axis and the height of each corner, to the left of it: the circle is
    # lower than the corner beyond `end`.
    end = np.sqrt(1 - y * y)
    between = (
        half_area(np.minimum(x, -end))
        + np.abs(y) * (np.clip(x, -end, end) + end)
        + half_area(np.maximum(x, end))
        - half_area(end)
    )
    corner = half_area(x) + np.sign(y) * between
    areas = np.diff(np.diff(corner, axis=0), axis=1) * radius**2
    cells = np.outer(np.diff(rows[down]), np.diff(columns[across]))
    cover[down.start : down.stop - 1, across.start : across.stop - 1] = areas / cells
    return np.clip(cover, 0.0, 1.0)  # rounding
