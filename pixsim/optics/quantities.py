"""Quantities of lenses and dies, with their bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pixsim.base.bounds import POSITIVE_OR_INFINITE, SMALLEST, Bounds

FocalLength = Annotated[float, Field(ge=1e-4, le=1e6)]  # 0.1 µm ... 1 km
FNumber = Annotated[
    float, Field(ge=1e-6, le=1e6)
]  # the lower limit depends on the magnification, up to `MAX_MAGNIFICATION`
DIE_RANGE_MM = (1e-5, 1000.0)  # 10 nm ... 1 m
DieWidth = Annotated[float, Field(ge=DIE_RANGE_MM[0], le=DIE_RANGE_MM[1])]
Distance = Annotated[float, Field(ge=1e-6, le=1e18)]  # 1 µm ... 100 light years
Reflectance = Annotated[float, Field(ge=0, lt=1)]
OutsideLight = Annotated[
    float, Field(ge=0, le=1e6)
]  # of that from within the field: from none to the sun beside a dark picture
# Of functions alone.
FNumberOrPinhole = Annotated[float, POSITIVE_OR_INFINITE]
AnyDistance = Annotated[float, POSITIVE_OR_INFINITE]
FieldOfView = Annotated[float, Field(ge=1e-9, le=180 - 1e-9)]
UpToInfinity = Annotated[float, Bounds(SMALLEST, 1e18)]
