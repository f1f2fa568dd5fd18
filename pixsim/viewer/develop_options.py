"""How the camera makes a picture of a frame with colour filters."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from pixsim.base.errors import invalid
from pixsim.base.records import Record, as_list
from pixsim.sensor.colour_options import BAYER, binned_cell, channels_of
from pixsim.sensor.pixel_options import PixelOptions

Gain = Annotated[float, Field(ge=1e-6, le=1e6)]


def _as_gains(value: object) -> object:
    return value if value == "known" else as_list(value)


class Develop(Record):
    """How the camera makes a picture of a frame with colour filters; a monochrome frame needs none of it."""

    white_balance: Annotated[Literal["known"] | tuple[Gain, ...], BeforeValidator(_as_gains)] = Field(
        "known",
        description="'known': by the electrons that the scene's white gives in each channel; or a gain for each channel, in the "
        "order R, G, B and then the other letters of the unit cell, of which only the ratios count",
    )
    demosaic: Literal["bilinear", "malvar2004", "menon2007", "interpolate"] | None = Field(
        None,
        description="interpolation between pixels of one colour: three methods for Bayer's unit cell, and 'interpolate', a mean "
        "weighted by distance, for any (absent: bilinear for Bayer's unit cell, else interpolate)",
    )
    matrix: Literal["least_squares", "least_delta_e", "noise_aware"] = Field(
        "least_delta_e",
        description="fit of the matrix from camera to XYZ, for patches 1-18 of ISO 17321 under the scene's lamp: 'least_squares' "
        "of XYZ; 'least_delta_e', least mean ΔE with an exact white; 'noise_aware', that with the noise of this exposure",
    )


DEVELOP = Develop()


def check_develop(develop: Develop, pixel: PixelOptions) -> None:
    """Raise PixsimError if a frame of a pixel cannot be developed so."""
    colour = pixel.colour
    if colour is None:
        return
    channels = channels_of(colour.cell)
    if develop.demosaic in ("bilinear", "malvar2004", "menon2007") and not colour.is_bayer:
        cell = "stacked channels" if colour.is_stacked else f"the unit cell {', '.join(colour.cell)}"
        hint = "For 'quad_rggb', set pixel.colour.binning = true." if binned_cell(colour.cell) else ""
        allowed = f"'{develop.demosaic}' for the unit cells {', '.join(BAYER)}; 'interpolate' for any other"
        raise invalid("develop.demosaic", f"'{develop.demosaic}' for {cell}", allowed, hint)
    if develop.white_balance != "known" and len(develop.white_balance) != len(channels):
        got = f"{len(develop.white_balance)} gains for {len(channels)} channels"
        raise invalid("develop.white_balance", got, f"'known', or a gain for each of {', '.join(channels)}")
