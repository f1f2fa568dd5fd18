"""Quantities of pixels and sensors, with their bounds."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field

from pixsim.base.bounds import Bounds

Pitch = Annotated[float, Field(ge=1e-3, le=1e6)]  # 1 nm ... 1 m
Seconds = Annotated[float, Field(ge=1e-15, le=1e9)]  # 1 fs ... 30 years
WELL_RANGE_E = (1.0, 1e18)  # at least one electron
Well = Annotated[float, Field(ge=WELL_RANGE_E[0], le=WELL_RANGE_E[1])]
Current = Annotated[float, Field(ge=0, le=1e18)]  # 0.16 A
NoiseElectrons = Annotated[float, Field(ge=0, le=1e12)]
ResetFactor = Annotated[float, Field(ge=0, le=100)]
# A normal distribution clipped at zero no longer has a mean of 1 at larger spreads (3e-5 off at
# 0.3).
GainSpread = Annotated[float, Field(ge=0, le=0.3)]
DarkSpread = Annotated[
    float, Field(ge=0, le=100)
]  # of the mean: at 100 a few hot pixels have all the dark current
OffsetSpread = Annotated[float, Field(ge=0, le=1)]
AreaMismatch = Annotated[float, Field(ge=0, le=1e3)]  # of the gain, µm: 1 % at 1 µm² is 0.01
VoltageMismatch = Annotated[float, Field(ge=0, le=1e6)]  # mV·µm, a few in CMOS
GateArea = Annotated[float, Field(ge=1e-6, le=1e6)]
HotMedian = Annotated[float, Field(ge=1, le=1e6)]
HotSpread = Annotated[
    float, Field(ge=0, le=3)
]  # at 3 the mean is 90 times the median: no frame has enough pixels for it
Doubling = Annotated[float, Field(ge=1, le=1e6)]
StackHeight = Annotated[float, Field(ge=1e-3, le=1e4)]  # 1 nm ... 10 mm
RefractiveIndex = Annotated[float, Field(ge=1, le=10)]
AbsorbedWavelength = Annotated[
    float, Field(ge=300, le=1200)
]  # where the absorption of silicon is tabulated
AbsorptionDepth = Annotated[
    float, Field(ge=0.1, le=1e4)
]  # beyond them there is no photodiode, and no wafer
SiliconDepth = Annotated[float, Field(ge=0, le=1e4)]
DiffusionLength = Annotated[float, Field(ge=1e-3, le=1e6)]
Crosstalk = Annotated[
    float, Field(ge=0, le=0.8)
]  # at 0.8 a pixel has no more of its light than each of its neighbours
HalfPitch = Annotated[
    float, Field(ge=-5e5, le=5e5)
]  # of the largest pitch: a lens that is displaced further is the neighbour's
GainDb = Annotated[float, Field(ge=0, le=60)]
# Of functions alone.
MAX_CODE_BITS = 31  # codes are stored in 32 bits with a sign
FrameBits = Annotated[int, Field(ge=1, le=32)]
Aspect = Annotated[float, Field(ge=1e-6, le=1e6)]
SaturatedFraction = Annotated[float, Bounds(0, 1, unknown=True)]


def _rising(knees: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
    """Return knees. Raises ValueError unless they are two or more that rise, with at most one code
    for each linear DN.
    """
    if len(knees) < 2 or any(
        high[0] - low[0] < high[1] - low[1] or low[1] >= high[1] for low, high in pairwise(knees)
    ):
        raise ValueError(
            f"got companding of {len(knees)} knees; allowed: at least two pairs [linear DN, code],"
            " rising, with at most one code for each linear DN"
        )
    return knees


_Level = Annotated[int, Field(ge=0, lt=2**24)]
# Linear DN and code of companding.
Knees = Annotated[tuple[tuple[_Level, _Level], ...], Field(max_length=64), AfterValidator(_rising)]
