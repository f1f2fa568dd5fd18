"""The pixel sizes of a study."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from pixsim.base.records import Record, as_list
from pixsim.light.quantities import Fraction
from pixsim.sensor.quantities import Pitch

MOST_PITCHES = 1000  # of a study: a curve of its optimum needs some dozen
PITCH_RATIO = 4.0  # of the largest to the data sheet's pitch, and of that to the smallest, by default


class PitchRange(Record):
    """Pitches at equal ratios, from that of `min_fill_factor` (or `min_um`) to `max_um`; or the list `values_um`."""

    min_fill_factor: Fraction = Field(0.05, description="fill factor of the smallest pixel size")
    min_um: Pitch | None = Field(None, description="smallest pixel size, in place of min_fill_factor")
    max_um: Pitch = Field(15.0, description="largest pixel size")
    count: Annotated[int, Field(ge=5, le=MOST_PITCHES)] = Field(24, description="number of pixel sizes")
    values_um: Annotated[tuple[Pitch, ...], Field(max_length=MOST_PITCHES), BeforeValidator(as_list)] | None = Field(
        None, description="list of pixel sizes, in place of min, max and count"
    )
    own_um: Pitch | None = Field(
        None,
        description="pixel size of the sensor itself, from whose data sheet an open range, the display's dots and the chart follow "
        "(absent: data_sheet_pitch_um)",
    )

    @property
    def largest_um(self) -> float:
        """The largest pixel size; it determines the part of the frame that a study scores."""
        return self.max_um if self.values_um is None else max(self.values_um)
