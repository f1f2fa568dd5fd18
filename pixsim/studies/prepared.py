"""Jobs: what a command runs, with everything that it left open, found and checked before anything is rendered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from pixsim.base.errors import PixsimError
from pixsim.optics.camera import Camera
from pixsim.studies.cases import Case, Settings

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Job(Generic[Settings]):
    """Cases that were found and checked: of a run, of a study, or of a comparison under one condition.

    cases : a run has one, a study those of its axes and conditions, a comparison one for each sensor
    view : display and chart that pixsim chose for the sensor of a data sheet, of `choose_view`
    sensor, variant : id of the scene's sensor, and variant of Mitsuba, as they were given
    """

    cases: tuple[Case[Settings], ...]
    view: Mapping[str, Any] = field(default_factory=dict)
    sensor: str | None = None
    variant: str | None = None

    @property
    def settings(self) -> Settings:
        """The complete settings of the first case."""
        return self.cases[0].settings

    @property
    def camera(self) -> Camera:
        """The camera of the first case."""
        return self.cases[0].camera


@contextmanager
def named(part: str) -> Iterator[None]:
    """Name a case, a sensor or a condition in an error about its settings; nothing, if there is only one."""
    try:
        yield
    except PixsimError as error:
        raise PixsimError(f"{part}: {error}" if part else str(error)) from None


def is_picture(file: str) -> bool:
    """Return whether a file holds light that was rendered before, by its name."""
    return Path(file).suffix.lower() in (".exr", ".npz", ".hdr")


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
