"""A condition of a study: one of the circumstances in which the pixel is used."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pixsim.base.records import Record
from pixsim.studies.varied import CaseName, ConditionSettings


class Condition(Record):
    """One of the circumstances in which the pixel is used, such as day or night."""

    name: CaseName = Field(description="name in columns and results", examples=['name = "night"'])
    weight: Annotated[float, Field(ge=0, le=1e9)] = Field(1.0, description="share of this condition; all are normalised to 1")
    set: ConditionSettings = Field(
        description="settings, as set.exposure.max_integration_s = 0.033", examples=["set.exposure.max_integration_s = 0.033"]
    )
