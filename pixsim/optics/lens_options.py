"""Options of the lens: veiling glare and fall-off, and a real lens in place of the thin one, with
its file, reading and focus.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from pixsim.base.records import Record
from pixsim.light.curves import Share
from pixsim.light.quantities import Wavelength
from pixsim.optics.chief_rays import RelativeIllumination
from pixsim.optics.quantities import FNumber, FocalLength, OutsideLight

_THIN_LENS_FIELDS = ("focal_length_mm", "chief_ray_angle")  # of [camera], which a real lens states


def replaced_by_lens(base: dict[str, Any], over: dict[str, Any]) -> list[str]:
    """Return the fields of [camera] in `base` that a real lens in `over` replaces."""
    lens = over.get("lens")
    camera = base.get("camera")
    replacing_camera = over.get("camera")
    if not (isinstance(lens, dict) and lens.get("file") and isinstance(camera, dict)):
        return []
    return [
        name
        for name in _THIN_LENS_FIELDS
        if camera.get(name) is not None
        and not (isinstance(replacing_camera, dict) and replacing_camera.get(name) is not None)
    ]


def as_file_names(value: object) -> object:
    """Return file names from a list, or from a text with commas, as on the command line."""
    if not isinstance(value, str):
        return value
    return [part.strip() for part in value.split(",") if part.strip()]


# Fields of any lens, with the fields of the camera that hold them.
ANY_LENS_FIELDS = {
    "veiling_glare": "veiling_glare",
    "veiling_glare_outside": "veiling_glare_outside",
    "relative_illumination": "fall_off",
}
# How a lens's file is read, where it leaves a choice.
READING_OPTIONS = (
    "configuration",
    "semi_diameters",
    "vignetting_factors",
    "glass_catalogues",
    "unknown_glass",
)


class PrescriptionOptions(Record):
    """A real lens, traced from its prescription, in place of the thin lens of the camera."""

    file: str | None = Field(
        None,
        description=(
            "prescription: a .toml or .zmx file, or the name of a packaged lens (absent:"
            " an ideal thin lens)"
        ),
    )
    focal_length_mm: FocalLength | None = Field(
        None,
        description=(
            "focal length to which the whole lens is scaled (absent: its largest field reaches the"
            " corner of the die)"
        ),
    )
    refocus: Literal["paraxial", "axis", "field"] = Field(
        "axis",
        description=(
            "focus on the object: 'paraxial'; 'axis', least rms wavefront there; 'field', least on"
            " average over the die"
        ),
    )
    focus_nm: Wavelength | None = Field(
        None,
        description=(
            "wavelength of that focus, such as 850 for infrared light (absent: the wavelengths of"
            " the file)"
        ),
    )
    ideal: Literal["distorted", "undistorted"] = Field(
        "distorted",
        description="ideal image: 'distorted' as the lens does at one wavelength, or 'undistorted'",
    )
    configuration: Annotated[int, Field(ge=1, lt=10**6)] | None = Field(
        None,
        description=(
            "configuration of a .zmx file, from 1: a focal length of a zoom, or a focus (absent:"
            " the active one)"
        ),
    )
    semi_diameters: Literal["ignore", "clip"] = Field(
        "ignore",
        description=(
            "semi-diameters that a .zmx file fixes without an aperture: 'ignore', or 'clip' rays at"
            " refracting surfaces"
        ),
    )
    vignetting_factors: Literal["use", "ignore"] | None = Field(
        None,
        description=(
            "vignetting factors of a .zmx file: 'use' or 'ignore' (absent: use, unless apertures"
            " stop rays)"
        ),
    )
    glass_catalogues: Annotated[tuple[str, ...], BeforeValidator(as_file_names)] = Field(
        (),
        description=(
            "your own Zemax glass catalogues, such as my.agf; they precede pixsim's table"
        ),
    )
    unknown_glass: Literal["error", "model"] = Field(
        "error",
        description=(
            "a glass that no catalogue has: an 'error', or the 'model' of the n_d and V_d that the"
            " file states"
        ),
    )

    @model_serializer(mode="wrap")
    def _nothing_without_file(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the settings that are written and hashed: without a real lens none of its fields,
        and no option of reading at its default.
        """
        prescription_fields = PrescriptionOptions.model_fields
        fields = type(self).model_fields
        if self.file is None:
            unused = set(prescription_fields)
        else:
            unused = {
                name
                for name in READING_OPTIONS
                if getattr(self, name) == prescription_fields[name].default
            }

        if self.focus_nm is None:
            unused.add("focus_nm")
        unused |= {
            name
            for name in fields
            if name in ANY_LENS_FIELDS and getattr(self, name) == fields[name].default
        }
        return {name: value for name, value in handler(self).items() if name not in unused}

    @model_validator(mode="after")
    def _has_a_file(self) -> Self:
        prescription_fields = PrescriptionOptions.model_fields
        if self.file is None and (
            set_fields := [
                name for name in prescription_fields if name in self.model_fields_set - {"file"}
            ]
        ):
            raise ValueError(
                f"{', '.join(set_fields)} without file; allowed: with the lens's prescription in"
                " lens.file"
            )
        return self


class LensOptions(PrescriptionOptions):
    """Veiling glare and fall-off of the lens, and a real lens in place of the camera's thin one."""

    veiling_glare: Share | None = Field(
        None,
        description=(
            "share of the light of the whole field that falls uniformly on the sensor (ISO 9358,"
            " ISO 18844): a number of at least 0 and below 1, or a CSV file with wavelength in nm"
            " and share"
            " (absent: none)"
        ),
    )
    veiling_glare_outside: OutsideLight | None = Field(
        None,
        description=(
            "light from outside the rendered field that strays into it, relative to what strays"
            " from within (absent: none)"
        ),
    )
    relative_illumination: RelativeIllumination | None = Field(
        None,
        description=(
            "CSV file of image_height_mm and relative_illumination, in place of the fall-off of the"
            " thin lens"
        ),
    )


class TracedLens(PrescriptionOptions):
    """The real lens of a camera: the file is scaled to the focal length and stopped down.

    f_number : as engraved: focal length over entrance pupil
    field_mm : half diagonal of the die, for refocus = "field"
    content : hash of the file
    """

    file: str
    focal_length_mm: FocalLength
    f_number: FNumber
    field_mm: Annotated[float, Field(ge=1e-6, le=1e3)]  # of the smallest and the largest die
    content: str
