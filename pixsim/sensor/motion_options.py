"""How fast the scene moves over the sensor."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.errors import invalid
from pixsim.base.records import Record, as_list
from pixsim.optics.quantities import Distance
from pixsim.sensor.exposure import Exposure

if TYPE_CHECKING:
    from pixsim.optics.camera import Camera

Speed = Annotated[float, Field(ge=-1e12, le=1e12)]
Velocity = Annotated[tuple[Speed, Speed], BeforeValidator(as_list)]  # of an option, as 500,0
VELOCITIES = "velocity_mm_per_s", "image_um_per_s", "pixels_per_s"


class Motion(Record):
    """Velocity of the scene's image, one for the whole picture: [x, y], x to the right and y down as the picture is shown.

    A camera that moves to the left has a scene that moves to the right. By default nothing moves.
    """

    velocity_mm_per_s: Velocity | None = Field(None, description="velocity [x, y] of the objects, in a plane that faces the lens")
    image_um_per_s: Velocity | None = Field(None, description="velocity [x, y] of the image on the sensor, in its place")
    pixels_per_s: Velocity | None = Field(None, description="velocity [x, y] of the image in pixels, in place of both")
    distance_m: Distance | None = Field(
        None, description="distance of the moving plane from the lens, for velocity_mm_per_s (absent: camera.object_distance_m)"
    )
    margin_um: Annotated[float, Field(ge=0, le=1e6)] | None = Field(
        None,
        description="width on each side of the die that is not scored, beside that of the pixels, for light that comes from beyond "
        "it: at least half of the longest path on the sensor (absent: that half). Cases with one margin score the same part",
    )

    @model_validator(mode="after")
    def _one_velocity(self) -> Self:
        given = [name for name in VELOCITIES if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"got {' and '.join(given)}; allowed: one of {', '.join(VELOCITIES)}")
        return self

    @property
    def is_on(self) -> bool:
        """Whether anything moves."""
        return any(any(getattr(self, name) or ()) for name in VELOCITIES)

    def um_per_s(self, camera: Camera, pitch_um: float) -> tuple[float, float]:
        """Return the velocity [x, y] of the image on the sensor.

        An object's is that times its image distance over its distance from the lens, as of a thin lens.

        pitch_um : of the pixels, for `pixels_per_s`
        """
        if self.velocity_mm_per_s is not None:
            scale = camera.image_distance_mm / (self.distance_m or camera.object_distance_m)  # mm/m, and µm/mm
            x, y = self.velocity_mm_per_s
        else:
            scale = 1.0 if self.image_um_per_s is not None else pitch_um
            x, y = self.image_um_per_s or self.pixels_per_s or (0.0, 0.0)
        return x * scale, y * scale

    def room_um(self, exposure: Exposure, camera: Camera, pitches_um: Iterable[float]) -> float:
        """Return the width on each side of the die that is left to light from beyond it: half of the longest path on the sensor.

        With a rolling shutter the first and the last rows see the scene displaced, too.

        pitches_um : of the largest and the smallest pixels
        """
        if not self.is_on:
            return 0.0
        if self.margin_um is not None:
            return self.margin_um
        longest_s = exposure.times * (exposure.integration_s or exposure.max_integration_s)
        rooms = []
        for pitch_um in pitches_um:
            lines = 1e3 * camera.height_mm / pitch_um
            rooms.append((longest_s + lines * exposure.line_time_s) / 2 * max(map(abs, self.um_per_s(camera, pitch_um))))
        return max(rooms)


STILL = Motion()


def border_with_room_um(border_um: float, motion: Motion, exposure: Exposure, camera: Camera, pitches_um: Iterable[float]) -> float:
    """Return the width on each side of the die that is not scored: that of pixels, and `Motion.room_um`.

    Raises PixsimError if nothing would be left to score.
    """
    room_um, least_um = motion.room_um(exposure, camera, pitches_um), 1e3 * min(camera.die_mm, camera.height_mm)
    if room_um and 2 * (border_um + room_um) >= least_um:
        got = f"a path of up to {2 * room_um:.4g} µm on the sensor" if motion.margin_um is None else f"a margin of {room_um:g} µm"
        allowed = f"one that leaves something to score, a path below {max(0.0, least_um - 2 * border_um):.4g} µm, twice its margin"
        hint = f"Shorten exposure.max_integration_s, state exposure.integration_s, or slow it down ({', '.join(VELOCITIES)})."
        raise invalid("motion", got, allowed, hint)
    return border_um + room_um


def motion_words(motion: Motion) -> str:
    """Return what moves in words; empty if nothing does."""
    units = {"velocity_mm_per_s": "objects move by {:g}, {:g} mm/s", "image_um_per_s": "the image moves by {:g}, {:g} µm/s"}
    units["pixels_per_s"] = "the image moves by {:g}, {:g} pixels/s"
    return next((units[name].format(*getattr(motion, name)) for name in VELOCITIES if any(getattr(motion, name) or ())), "")
