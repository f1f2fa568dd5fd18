"""The scene of a study."""

from __future__ import annotations

from pydantic import Field

from pixsim.viewer.setting import RunScene


class StudyScene(RunScene):
    """The scene of a study."""

    file: str = Field("csf", description="XML file or name of a packaged scene")
