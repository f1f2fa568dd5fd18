"""Quantities of lenses and dies, with their bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

FocalLength = Annotated[float, Field(ge=1e-4, le=1e6)]  # 0.1 µm ... 1 km
FNumber = Annotated[float, Field(ge=1e-6, le=1e6)]  # the lower limit depends on the magnification, up to `LARGEST_MAGNIFICATION`
DieWidth = Annotated[float, Field(ge=1e-5, le=1000)]  # 10 nm ... 1 m
Distance = Annotated[float, Field(ge=1e-6, le=1e18)]  # 1 µm ... 100 light years
