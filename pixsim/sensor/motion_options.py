"""How fast the scene moves over the sensor."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field

from pixsim.base.records import Record, as_list
from pixsim.optics.quantities import Distance

Speed = Annotated[float, Field(ge=-1e12, le=1e12)]
Velocity = Annotated[tuple[Speed, Speed], BeforeValidator(as_list)]  # of an option, as 500,0
VELOCITIES = "velocity_mm_per_s", "image_um_per_s", "pixels_per_s"


class Motion(Record):
    """Velocity of the scene's image, one for the whole picture: [x, y], x to the right and y down
    as the picture is shown.

    A camera that moves to the left has a scene that moves to the right. By default nothing moves.
    """

    ALTERNATIVES: ClassVar = (tuple((name,) for name in VELOCITIES),)

    velocity_mm_per_s: Velocity | None = Field(
        None, description="velocity [x, y] of the objects, in a plane that faces the lens"
    )
    image_um_per_s: Velocity | None = Field(
        None,
        description="in place of velocity_mm_per_s: velocity [x, y] of the image on the sensor",
    )
    pixels_per_s: Velocity | None = Field(
        None, description="in place of both: velocity [x, y] of the image in pixels"
    )
    distance_m: Distance | None = Field(
        None,
        description=(
            "distance of the moving plane from the lens, for velocity_mm_per_s (absent:"
            " camera.object_distance_m)"
        ),
    )
    margin_um: Annotated[float, Field(ge=0, le=1e6)] | None = Field(
        None,
        description=(
            "width on each side of the die that is not scored, in addition to that of the pixels,"
            " for light that comes from beyond it: at least half of the longest path on the sensor"
            " (absent: that half). Cases with one margin score the same part"
        ),
    )

    @property
    def is_on(self) -> bool:
        """Whether anything moves."""
        return any(any(getattr(self, name) or ()) for name in VELOCITIES)


NO_MOTION = Motion()


def motion_text(motion: Motion) -> str:
    """Return what moves in words; empty if nothing does."""
    templates = {
        "velocity_mm_per_s": "objects move by {:g}, {:g} mm/s",
        "image_um_per_s": "the image moves by {:g}, {:g} µm/s",
        "pixels_per_s": "the image moves by {:g}, {:g} pixels/s",
    }
    for name, template in templates.items():
        velocity = getattr(motion, name) or ()
        if any(velocity):
            return template.format(*velocity)
    return ""
