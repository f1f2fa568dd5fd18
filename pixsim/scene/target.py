"""A target on a uniform background, for metrics of detectability: a disc, a bar, an edge, or a gap
in a line of a pattern, drawn as exact means over texels.

Such a metric takes the light without the target from the same scene with a contrast of 0. So that
the difference is due to the target alone, the texels are the cells of the film, and a cell has the
share of the target that its area covers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pixsim.base.arrays import Array
from pixsim.base.bounds import Positive
from pixsim.base.errors import invalid
from pixsim.base.records import Record
from pixsim.light.quantities import Fraction

Size = Annotated[float, Field(ge=1e-9, le=1e9)]
Contrast = Annotated[float, Field(ge=-1, le=1e6)]
SIZES = ("size_mm", "size_mrad", "size_um")
LENGTHS = ("length_mm", "length_mrad", "length_um")
# Default lengths in widths: of a bar as those of MIL-STD-150A and of the USAF chart, and of a gap.
_LENGTH_IN_WIDTHS = {"bar": 5.0, "lines": 1.0}
_CONTRAST = -0.1
_LINE_CONTRAST = -0.5
# Of the background: float32 holds a smaller change with an error of more than 0.6 %.
_MIN_STEP = 1e-5


class Target(Record):
    """A target in the centre of a uniform field. An edge is the border of a target that fills the
    right or the lower half. Lines are a pattern whose middle one has a gap, which is the target.
    """

    shape: Literal["disc", "bar", "edge", "lines"] = Field(
        "disc",
        description=(
            "disc, bar, edge, or lines: as wide as the spaces between them, with a gap in the"
            " middle one"
        ),
    )
    contrast: Contrast | None = Field(
        None,
        description=(
            "luminance of the target over that of the field, or of the line in which it is a gap,"
            " minus 1; 0: no target (absent: -0.1; a gap is as bright as the field)"
        ),
    )
    line_contrast: Contrast | None = Field(
        None, description="luminance of lines over that of the field, minus 1 (absent: -0.5)"
    )
    reflectance: Fraction = Field(
        1.0, description="of the field: its luminance over that of a white diffuser"
    )
    size_mm: Size | None = Field(
        None, description="diameter of the disc or width of bar and lines, in the plane in focus"
    )
    size_mrad: Size | None = Field(
        None, description="this size over the distance of that plane from the lens"
    )
    size_um: Size | None = Field(None, description="this size on the sensor")
    length_mm: Size | None = Field(
        None, description="of the bar (absent: 5 widths), or of the gap in a line (absent: a width)"
    )
    length_mrad: Size | None = Field(
        None, description="this length over the distance of that plane from the lens"
    )
    length_um: Size | None = Field(None, description="this length on the sensor")
    direction: Literal["vertical", "horizontal"] = Field(
        "vertical", description="of the length of bar and lines, or of the edge"
    )

    @model_validator(mode="after")
    def _states_what_its_shape_has(self) -> Self:
        sizes = [name for name in SIZES if getattr(self, name) is not None]
        lengths = [name for name in LENGTHS if getattr(self, name) is not None]
        if self.shape != "edge" and len(sizes) != 1:
            names = " and ".join(sizes) or "no size"
            raise ValueError(f"{names} for the target; give one of {', '.join(SIZES)}")
        if len(lengths) > 1:
            raise ValueError(f"{' and '.join(lengths)} for the target; give one of them")

        has_line_contrast = self.line_contrast is not None
        absent: dict[str, Collection[str]] = {
            "size": sizes if self.shape == "edge" else (),
            "length": () if self.shape in _LENGTH_IN_WIDTHS else lengths,
            "direction": self.model_fields_set & {"direction"} if self.shape == "disc" else (),
            "lines": ("line_contrast",) if has_line_contrast and self.shape != "lines" else (),
        }
        for words, unused in absent.items():
            if unused:
                got = f"{' and '.join(unused)} with shape = '{self.shape}'"
                raise ValueError(f"{got}, which has no {words}; leave it out")
        return self

    @classmethod
    def from_parameters(
        cls, stated: Mapping[str, object], defaults: Mapping[str, object]
    ) -> Target:
        """Return the target of a scene's parameters, stated and default ones.

        A stated size or length takes the place of the default, in whatever unit that is. A shape
        may lack what a default states.

        Raises PixsimError for values that are no target.
        """
        shape = stated.get("shape", defaults.get("shape", cls.model_fields["shape"].default))
        unused = set()
        if shape == "edge" or any(name in stated for name in SIZES):
            unused |= {*SIZES}
        if shape not in _LENGTH_IN_WIDTHS or any(name in stated for name in LENGTHS):
            unused |= {*LENGTHS}
        if shape == "disc":
            unused.add("direction")
        unused.add("contrast" if shape == "lines" else "line_contrast")
        values = {name: value for name, value in defaults.items() if name not in unused}
        values |= stated
        return cls(**{name: values[name] for name in cls.model_fields if name in values})

    def lengths_in_scene_mm(self, magnification: float, distance_m: float) -> tuple[float, float]:
        """Return the size and the length in the plane in focus; 0 for what the shape does not have.

        magnification, distance_m : of that plane on the sensor, and from the lens
        """
        size_mm = self._in_scene_mm(SIZES, magnification, distance_m) or 0.0
        default_mm = _LENGTH_IN_WIDTHS.get(self.shape, 0.0) * size_mm
        return size_mm, self._in_scene_mm(LENGTHS, magnification, distance_m) or default_mm

    def _in_scene_mm(
        self, names: tuple[str, str, str], magnification: float, distance_m: float
    ) -> float | None:
        """Return a length that one of three fields states, in mm, mrad and µm on the sensor."""
        length_mm, angle_mrad, sensor_um = (getattr(self, name) for name in names)
        if sensor_um is not None:
            return float(sensor_um / (1e3 * magnification))
        return length_mm if angle_mrad is None else angle_mrad * distance_m

    @property
    def _steps(self) -> tuple[float, float]:
        """The change of luminance by lines, and by the target, over that of the field."""
        if self.shape != "lines":
            return 0.0, _CONTRAST if self.contrast is None else self.contrast
        line = _LINE_CONTRAST if self.line_contrast is None else self.line_contrast
        return line, -line if self.contrast is None else (1 + line) * self.contrast

    def texels(
        self,
        shape: tuple[int, int],
        sides_mm: tuple[Positive, Positive],
        size_mm: float,
        length_mm: float,
    ) -> NDArray[np.float32]:
        """Return the luminance of a field over that of a white diffuser, (H, W), row 0 at the top.

        It is the reflectance, times 1 + contrast where the target is.

        shape : (H, W) texels
        sides_mm : (height, width) of the field
        size_mm, length_mm : of the target, as in the field

        Raises PixsimError if the target is larger than the field, or if its contrast in a texel is
        lost in float32.
        """
        down_mm, across_mm = self.ends_mm(size_mm, length_mm)
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

        line_step, target_step = self._steps
        step = abs(target_step) * float(cover.max())
        if 0 < step < _MIN_STEP:
            raise invalid(
                "contrast",
                f"{target_step:g}, which changes the light of no film cell by more than {step:.2g}",
                f"0, or a change of at least {_MIN_STEP:g}, which float32 can represent",
                "The signal is linear in the contrast: choose a larger one and scale its result, or"
                " a finer film.",
            )
        field: Array | float = 1.0
        if self.shape == "lines":
            is_level = self.direction == "horizontal"
            lines = _share_of_lines(rows_mm if is_level else columns_mm, size_mm)
            field = 1 + line_step * (lines[:, None] if is_level else lines)
        return (self.reflectance * (field + target_step * cover)).astype(np.float32)

    def ends_mm(
        self, size_mm: float, length_mm: float
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return where the target begins and ends, downwards and to the right from the middle of
        the field; of a disc its bounding box.

        size_mm, length_mm : of the target
        """
        half_mm = size_mm / 2
        along = (-half_mm, half_mm)
        across = (-half_mm, half_mm)
        if self.shape == "edge":
            along = (-np.inf, np.inf)
            across = (0.0, np.inf)
        elif self.shape != "disc":
            along = -length_mm / 2, length_mm / 2
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


def _share_of_lines(edges: Array, width: float) -> Array:
    """Return the share of each interval (n,) between edges (n + 1,) that lies in lines, as wide as
    the spaces between them, one of them around 0.
    """
    periods = (edges + width / 2) / (2 * width)
    whole = np.floor(periods)
    covered = width * (whole + np.minimum(2 * (periods - whole), 1.0))
    return np.asarray(np.diff(covered) / np.diff(edges))


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
