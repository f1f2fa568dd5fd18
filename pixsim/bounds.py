"""What numbers a record takes: far more than can be built, and little enough that no stage of the chain overflows.

Named by what they are; the unit is the field's own. Zero is allowed where a stage can be left out.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

SMALLEST_FRACTION = 1e-12  # of the light that a lens gathers nothing would be left


def _not_vanishing(value: float) -> float:
    if value < SMALLEST_FRACTION:
        raise ValueError(f"got {value:g}; allowed: at least {SMALLEST_FRACTION:g}, below which nothing is left")
    return value


Fraction = Annotated[float, Field(gt=0, le=1), AfterValidator(_not_vanishing)]
FocalLength = Annotated[float, Field(ge=1e-4, le=1e6)]  # 0.1 µm ... 1 km
FNumber = Annotated[float, Field(gt=0, le=1e6)]  # how fast it may be depends on the magnification
DieWidth = Annotated[float, Field(ge=1e-5, le=1000)]  # 10 nm ... 1 m
Distance = Annotated[float, Field(ge=1e-6, le=1e18)]  # 1 µm ... 100 light years
Wavelength = Annotated[float, Field(gt=0, le=1e6)]
Pitch = Annotated[float, Field(ge=1e-3, le=1e6)]  # 1 nm ... 1 m
Seconds = Annotated[float, Field(ge=1e-15, le=1e9)]  # 1 fs ... 30 years
WELL_RANGE_E = (1.0, 1e18)  # below one electron there is nothing to count
Well = Annotated[float, Field(ge=WELL_RANGE_E[0], le=WELL_RANGE_E[1])]
Current = Annotated[float, Field(ge=0, le=1e18)]  # 0.16 A
NoiseElectrons = Annotated[float, Field(ge=0, le=1e12)]
ResetFactor = Annotated[float, Field(ge=0, le=100)]
# A normal gain of more spread would have to be cut at zero so often that its mean were no longer 1 (3e-5 off at 0.3).
GainSpread = Annotated[float, Field(ge=0, le=0.3)]
DarkSpread = Annotated[float, Field(ge=0, le=100)]  # a hundred times the mean: a few hot pixels make all of it
OffsetSpread = Annotated[float, Field(ge=0, le=1)]
Luminance = Annotated[float, Field(ge=1e-12, le=1e15)]  # the sun's disc has 1.6e9
