"""Prepared scenes that stay in memory while a user turns settings, so that only what changes is computed again."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, TypeVar

from pixsim.base.records import content_hash
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout
from pixsim.sensor.integration import ChannelLight, electrons_per_joule, lights_of
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import HEADER_OF_WHITE, PreparedScene, prepare_scene

T = TypeVar("T")
KEPT = 4  # prepared scenes, and lights behind the lens; each has some 20 MB at 1024 samples across


class KeptScenes:
    """Called as `prepare_scene`, it returns the same, and keeps the last `KEPT` scenes and lights behind the lens."""

    def __init__(self) -> None:
        self._lights: dict[Hashable, tuple[SpectralImage, tuple[ChannelLight, ...]]] = {}
        self._scenes: dict[Hashable, tuple[SpectralImage, PreparedScene]] = {}

    def __call__(
        self, irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display, full: bool = False, **more: Any
    ) -> PreparedScene:
        """Return `prepare_scene`; `more` are its further arguments."""
        pixel, read = physics.pixel, physics.as_read
        electrons = tuple(electrons_per_joule(channel, irradiance).tobytes() for channel in physics.channels)
        parts = [camera.model_dump(mode="json"), pixel.stack and pixel.stack.model_dump(mode="json"), str(Layout.of_pixels(pixel))]
        charge = physics.charge.content_hash if physics.charge else ""
        seen = id(irradiance), content_hash([*parts, charge]), electrons
        geometry = read.read_pitch_um, read.border_um, read.registration
        white = tuple(irradiance.header.get(name) for name in HEADER_OF_WHITE.values())
        asked = display.content_hash, full, white, *((name, id(value)) for name, value in more.items() if name == "without")
        key = (*seen, geometry, asked, repr({name: value for name, value in more.items() if name != "without"}))
        if key not in self._scenes:
            if seen not in self._lights:
                _keep(self._lights, seen, (irradiance, lights_of(irradiance, camera, physics)))
            lights = self._lights[seen][1]
            _keep(self._scenes, key, (irradiance, prepare_scene(irradiance, camera, physics, display, full, lights=lights, **more)))
        return self._scenes[key][1]

    def drop_all_but(self, images: list[SpectralImage]) -> None:
        """Forget what was made from other light than these images."""
        for known in (self._lights, self._scenes):
            for key in [key for key, (image, _) in known.items() if not any(image is one for one in images)]:
                del known[key]


def _keep(known: dict[Hashable, T], key: Hashable, made: T) -> None:
    """Add an entry as the last one; the first goes if there are too many."""
    while len(known) >= KEPT:
        del known[next(iter(known))]
    known[key] = made
