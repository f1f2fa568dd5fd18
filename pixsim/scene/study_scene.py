"""The scene of a study."""

from __future__ import annotations

from pydantic import Field

from pixsim.base.records import NumberOrText, Record


class StudyScene(Record):
    """The scene of a study."""

    file: str = Field("csf", description="XML file or name of a packaged scene")
    parameters: dict[str, NumberOrText] = Field(
        default_factory=dict, description="values of the scene's <default> parameters"
    )
