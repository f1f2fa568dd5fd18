"""How the camera corrects its frames."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from pixsim.base.records import Record
from pixsim.light.quantities import Fraction


class Correction(Record):
    """How the camera corrects its frames, from frames and dark rows of the same sensor; by default
    not at all.
    """

    dark_frames: Annotated[int, Field(ge=0, le=10000)] = Field(
        0,
        description=(
            "frames without light, in the picture's exposure time, whose mean is subtracted (0: the"
            " expected dark number)"
        ),
    )
    flat_frames: Annotated[int, Field(ge=0, le=10000)] = Field(
        0,
        description=(
            "frames of uniform light on the sensor, by whose mean each pixel's gain is corrected"
        ),
    )
    flat_level: Fraction = Field(
        0.5,
        description=(
            "mean signal of the flat frames, as a fraction of saturation, where the pixels' stack"
            " collects most"
        ),
    )
    column_clamp: Annotated[int, Field(ge=0, le=10000)] = Field(
        0,
        description=(
            "rows of dark pixels in every frame, whose mean in each column is subtracted from it"
        ),
    )
    defects: bool = Field(
        False,
        description=(
            "replace pixels that stand out in the dark or flat frames by the mean of their sound"
            " neighbours"
        ),
    )

    @property
    def is_on(self) -> bool:
        """Whether it does anything."""
        return bool(self.dark_frames or self.flat_frames or self.column_clamp)

    @property
    def removes_dark_level(self) -> bool:
        """Whether the mean of darkness is measured, with what clipping at 0 DN adds to it, and not
        expected.
        """
        return bool(self.dark_frames or self.column_clamp)

    @model_validator(mode="after")
    def _defects_need_frames(self) -> Self:
        if self.defects and not (self.dark_frames or self.flat_frames):
            raise ValueError(
                "defects = true without frames that show them; allowed: with dark_frames or"
                " flat_frames above 0"
            )
        return self


NO_CORRECTION = Correction()
