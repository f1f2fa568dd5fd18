"""What lies between the surface of a pixel and its photodiode."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field

from pixsim.base.records import Record, as_list
from pixsim.sensor.quantities import (
    Crosstalk,
    DiffusionLength,
    HalfPitch,
    RefractiveIndex,
    SiliconDepth,
    StackHeight,
)

MICROLENSES = Literal["none", "square"]
SHIFTS = Literal["none", "optimal"]
_StackShift = Annotated[tuple[HalfPitch, HalfPitch], BeforeValidator(as_list)]


class StackOptions(Record):
    """What lies between the surface of a pixel and its photodiode, and how light and charge go
    astray there.

    Values of None come from the technology. Without any of them, a pixel collects the light that
    falls on its photodiode, from every direction alike.
    """

    ALTERNATIVES: ClassVar = (
        (("shift",), ("shift_um",)),
        (("crosstalk",), ("depletion_um", "diffusion_length_um")),
    )

    enabled: bool = Field(
        True,
        description=(
            "false: no stack at all, whatever the technology or the other values here state"
        ),
    )
    height_um: StackHeight | None = Field(
        None,
        description=(
            "height of the microlens or opening above the photodiode; the same at every pitch"
        ),
    )
    index: RefractiveIndex | None = Field(None, description="refractive index between them")
    microlens: MICROLENSES | None = Field(
        None,
        description=(
            "'square', a lens over the whole pixel; 'none', an opening as wide as the photodiode"
            " (absent: none)"
        ),
    )
    shift: SHIFTS | None = Field(
        None,
        description=(
            "shift of lenses or openings towards the axis: 'none', or 'optimal', so that chief rays"
            " land on the centres of photodiodes (absent: none)"
        ),
    )
    shift_um: _StackShift | None = Field(
        None, description="in place of shift: the same x and y for all pixels"
    )
    refraction: Literal["exact", "paraxial"] | None = Field(
        None,
        description=(
            "refraction at the surface: 'exact', or 'paraxial', tangents taken for sines (absent:"
            " exact)"
        ),
    )
    depletion_um: SiliconDepth | None = Field(
        None,
        description=(
            "front-side illuminated pixel, with diffusion_length_um: depth of the depletion region"
        ),
    )
    diffusion_length_um: DiffusionLength | None = Field(
        None,
        description=(
            "front-side illuminated pixel, with depletion_um: diffusion length of electrons below"
            " the depletion region"
        ),
    )
    crosstalk: Crosstalk | None = Field(
        None,
        description=(
            "in place of diffusion: share of a pixel's charge that its four neighbours collect"
            " together"
        ),
    )
