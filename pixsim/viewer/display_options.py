"""The display, its viewer and the colour-difference metric."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pixsim.base.problems import Words
from pixsim.base.records import Record
from pixsim.light.quantities import Fraction
from pixsim.optics.camera import SIZES

Luminance = Annotated[float, Field(ge=1e-12, le=1e15)]  # the disc of the sun: 1.6e9

Radiance = Annotated[float, Field(ge=1e-15, le=1e12)]


class Display(Record):
    """A monochrome CRT or LCD, its viewer, and the colour-difference metric."""

    ALTERNATIVES: ClassVar = ((("white",), ("white_cd_per_m2",), ("white_w_per_m2_sr",)),)

    raster: Literal["fixed_size", "one_to_one"] = Field(
        "fixed_size",
        description=(
            "'fixed_size': the die fills `dots` dots of the display; 'one_to_one': one pixel is"
            " one dot"
        ),
    )
    dots: Annotated[int, Field(ge=8, le=4096), Words(also=("pixels", *SIZES))] = Field(
        512, description="display dots across the die, for fixed_size"
    )
    samples_per_deg: Annotated[float, Field(ge=1e-3, le=1e5)] = Field(
        23.0, description="display dots per degree of visual angle; 23 is 72 dpi at 18 inches"
    )
    interpolation: Literal["linear", "nearest", "cubic"] = Field(
        "linear", description="interpolation between pixel centres, before the mean over each dot"
    )
    gamma: Annotated[float, Field(ge=0.01, le=100)] = Field(
        2.2, description="exponent of the display: luminance = counts^gamma"
    )
    bits: Annotated[int, Field(ge=1, le=16)] = Field(
        8, description="bits of the display's digital counts"
    )
    white_cd_per_m2: Luminance | None = Field(
        None,
        description=(
            "scene luminance shown as display white (absent: white of the scene's emissive chart)"
        ),
    )
    white_w_per_m2_sr: Radiance | None = Field(
        None,
        description=(
            "scene radiance shown as display white, of light that nobody sees, such as infrared"
            " (absent: white of the scene's emissive chart)"
        ),
    )
    white: Literal["diffuser"] | None = Field(
        None,
        description=(
            "'diffuser': display white is a white plate at the object's distance that faces the"
            " lens, in the light of the scene; of an emissive chart texel value 1 (absent: a"
            " luminance or radiance, as above, or what the scene states)"
        ),
    )
    diffuser_reflectance: Fraction = Field(
        1.0,
        description=(
            "reflectance of the white plate of display.white = 'diffuser'; 1 is the perfect"
            " diffuser"
        ),
    )
    shading_correction: bool = Field(
        True,
        description=(
            "divide by the mean collection of the pixels' stack over the field, relative to that on"
            " axis, unless flat frames do it"
        ),
    )
    filters: Literal["published", "zhang1996"] = Field(
        "published", description="S-CIELAB filters: as published, or as in the code of Zhang (1996)"
    )
    delta_e: Literal["1976", "1994", "2000"] = Field(
        "1976", description="colour difference formula: CIE 1976, 1994 or 2000"
    )
    adaptation: Literal["bradford", "cat02", "none"] = Field(
        "bradford",
        description=(
            "of coloured pictures: how the white of the scene becomes that of the display, ideal"
            " and sensor alike"
        ),
    )
