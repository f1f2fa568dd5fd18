"""A case with everything that it left open, found and checked before anything is rendered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic

from pixsim.base.parameters import Camera
from pixsim.studies.cases import Case, Settings

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene


@dataclass(frozen=True)
class Prepared(Generic[Settings]):
    """A case whose scene and camera are found.

    case : its settings are complete: with pixel sizes, display and chart
    scene : with its chart
    camera : of the window, or of the part of the field that all sensors of a comparison see
    """

    case: Case[Settings]
    scene: Scene
    camera: Camera

    @property
    def settings(self) -> Settings:
        """The complete settings."""
        return self.case.settings

    @property
    def name(self) -> str:
        """Name of its sensor in a comparison."""
        return self.case.sensor


def loaded_scene(
    file: str,
    parameters: Mapping[str, float | int | str],
    resolution: int | None,
    *,
    variant: str | None = None,
    sensor: str | None = None,
) -> Scene:
    """Return a scene with its parameters, on a film of `resolution` samples across if that is set.

    Raises PixsimError as `pixsim.load_scene`.
    """
    from pixsim.scene.scene import load_scene

    scene = load_scene(file, variant=variant, sensor=sensor, **parameters)
    return scene.with_resolution(resolution) if resolution else scene
