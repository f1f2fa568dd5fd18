"""The camera: a thin lens and the die behind it, and the options that replace a scene's."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from pixsim.base.bounds import Positive, value_text
from pixsim.base.digits import f_stop
from pixsim.base.door import checked_methods
from pixsim.base.errors import invalid
from pixsim.base.problems import Words
from pixsim.base.records import Record
from pixsim.light.curves import Share
from pixsim.light.quantities import Fraction
from pixsim.optics.chief_rays import ChiefRayAngles, ChiefRays, RelativeIllumination
from pixsim.optics.lens_options import ANY_LENS_FIELDS, LensOptions, PrescriptionOptions, TracedLens
from pixsim.optics.quantities import (
    DIE_RANGE_MM,
    DieWidth,
    Distance,
    FieldOfView,
    FNumber,
    FocalLength,
    OutsideLight,
    UpToInfinity,
)

_FASTEST_WORKING_F_NUMBER = 0.5
MAX_MAGNIFICATION = (
    1e6  # green light is half a metre long in the image; beyond it the object lies in the focus
)
_CORNER_ROUNDING = 1e-6  # of the image height: a table may end at the corner, rounded to 1 µm


_VEIL_FIELDS = "veiling_glare", "veiling_glare_outside"  # of `Camera`
_IN_PIXELS = Words(also=("pixels",))
# Usual words for the columns and rows of a sensor, or of a display.
SIZES = "resolution", "pixel_count", "image_size", "width", "height", "columns", "rows"
PIXELS_OR_FILM = (
    "The sensor's columns and rows are pixels in [camera], as pixels = [1936, 1216]; resolution is"
    " the width of the film."
)


@checked_methods
class Camera(Record):
    """A thin lens in air and the die behind it, focused on a plane.

    With a real `lens`, the thin lens has its paraxial image distance, its numerical aperture on the
    axis, and its chief rays.

    With u the object distance: magnification m = f/(u - f), image distance v = f(1 + m), aperture
    radius f/2N.

    At twice the focal length the magnification is 1:

    >>> camera = Camera(focal_length_mm=50.0, object_distance_m=0.1)
    >>> camera.magnification, camera.image_distance_mm, camera.working_f_number
    (1.0, 100.0, 8.0)
    >>> round(camera.effective_f_number, 4)  # determines diffraction
    8.0156
    """

    focal_length_mm: FocalLength = Field(3.86, description="focal length")
    f_number: FNumber = Field(
        4.0, description="nominal f-number: focal length over the diameter of the entrance pupil"
    )
    die_mm: Annotated[DieWidth, _IN_PIXELS] = Field(2.7136, description="width of the die")
    die_height_mm: Annotated[DieWidth | None, _IN_PIXELS] = Field(
        None, description="height of the die (absent: that of a square die, die_mm)"
    )
    object_distance_m: Distance = Field(
        1.0, description="distance from the lens to the plane in focus"
    )
    transmittance: Fraction = Field(1.0, description="transmittance of the lens")
    chief_ray_angle: ChiefRays | None = Field(
        None,
        description=(
            "CSV file of image_height_mm, deg and perhaps relative_illumination: directions of the"
            " light on pixels with a stack, and the fall-off in place of the thin lens's if that"
            " column is there (absent: those of the thin lens)"
        ),
    )
    lens: TracedLens | None = Field(
        None, description="real lens, from `Scene.camera` with `LensOptions` (absent: a thin lens)"
    )
    veiling_glare: Share = Field(0.0, description="`LensOptions.veiling_glare`")
    veiling_glare_outside: OutsideLight = Field(
        0.0, description="`LensOptions.veiling_glare_outside`"
    )
    fall_off: RelativeIllumination | None = Field(
        None, description="`LensOptions.relative_illumination`"
    )

    @model_serializer(mode="wrap")
    def _without_absent_lens(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields that are written and hashed: a real lens, veil or fall-off only if
        there is one.
        """
        table: dict[str, Any] = handler(self)
        absent = {
            name
            for name in ("lens", *ANY_LENS_FIELDS.values())
            if getattr(self, name) == type(self).model_fields[name].default
        }
        return {name: value for name, value in table.items() if name not in absent}

    @model_validator(mode="after")
    def _forms_an_image(self) -> Self:
        if self.focal_length_mm >= 1e3 * self.object_distance_m:
            raise ValueError(
                f"focal_length_mm = {self.focal_length_mm:g} is not shorter than object_distance_m"
                f" = {self.object_distance_m:g} ({1e3 * self.object_distance_m:g} mm): no real"
                " image forms. Increase the object distance or use a shorter focal length"
            )

        if self.magnification > MAX_MAGNIFICATION:
            raise ValueError(
                f"got focal_length_mm = {self.focal_length_mm:g} with object_distance_m ="
                f" {self.object_distance_m:g}, which magnifies {self.magnification:g} times;"
                f" allowed: up to {MAX_MAGNIFICATION:g} times. Increase the object distance"
            )

        if self.working_f_number < _FASTEST_WORKING_F_NUMBER:
            raise ValueError(
                f"f_number = {self.f_number:g} is too small for a thin lens in air: the working"
                f" f-number, N (1 + |m|) = {self.working_f_number:g}, must be at least"
                f" {_FASTEST_WORKING_F_NUMBER:g}"
            )
        return self

    @model_validator(mode="after")
    def _chief_rays_reach_the_corner(self) -> Self:
        if self.chief_ray_angle is None:
            return self
        corner_mm = self._corner_within("chief_ray_angle", self.chief_ray_angle)
        height_mm, angle_deg = max(self._angles_within(corner_mm), key=lambda row: abs(row[1]))
        sine = math.sin(math.radians(abs(angle_deg))) + self.numerical_aperture
        if not sine < 1:
            raise ValueError(
                f"chief_ray_angle is {angle_deg:.4g} degrees at {height_mm:.4g} mm; allowed: the"
                f" sine of the angle and of the cone of light at f/{self.f_number:g} together below"
                f" 1, the horizon, not {sine:.3g}. Give smaller angles or a larger f_number"
            )

        return self

    @model_validator(mode="after")
    def _has_one_fall_off(self) -> Self:
        if self.fall_off is None:
            return self
        table = self.chief_ray_angle
        has_table = table is not None and len(table[0]) > 2
        if self.lens is not None or has_table:
            other_source = "lens.file" if self.lens else "camera.chief_ray_angle"
            raise ValueError(
                f"got lens.relative_illumination together with {other_source}, which has a"
                f" fall-off;"
                " allowed: one of them"
            )

        self._corner_within("lens.relative_illumination", self.fall_off)
        return self

    def _corner_within(self, name: str, rows: ChiefRayAngles) -> float:
        """Return the image height of the die's corner in mm.

        Raises ValueError if rows of image height end before it.
        """
        corner_mm = math.hypot(self.die_mm, self.height_mm) / 2
        farthest_mm = rows[-1][0]
        if farthest_mm < corner_mm * (1 - _CORNER_ROUNDING):
            raise ValueError(
                f"{name} ends at an image height of {farthest_mm:g} mm; allowed: up to the corner"
                f" of the die of {self.die_mm:g} × {self.height_mm:g} mm,"
                f" {math.ceil(1e4 * corner_mm) / 1e4:g} mm. Add rows up to it, or give the die_mm"
                " and die_height_mm of the sensor"
            )
        return corner_mm

    def _angles_within(self, height_mm: float) -> list[tuple[float, float]]:
        """Return (height, angle) rows up to a height, ending with the interpolated angle there."""
        rows = [(row[0], row[1]) for row in self.chief_ray_angle or ()]
        within = [row for row in rows if row[0] <= height_mm]
        if len(within) < len(rows):
            low_mm, low_deg = within[-1]
            high_mm, high_deg = rows[len(within)]
            slope = (high_deg - low_deg) * (height_mm - low_mm) / (high_mm - low_mm)
            within.append((height_mm, low_deg + slope))
        return within

    @property
    def height_mm(self) -> float:
        """Height of the die."""
        return self.die_mm if self.die_height_mm is None else self.die_height_mm

    @property
    def die_um(self) -> tuple[float, float]:
        """Height and width of the die."""
        return 1e3 * self.height_mm, 1e3 * self.die_mm

    @property
    def magnification(self) -> float:
        """|m|, image size over object size."""
        return self.focal_length_mm / (1e3 * self.object_distance_m - self.focal_length_mm)

    @property
    def image_distance_mm(self) -> float:
        """v = f(1 + |m|), from the lens to the sensor."""
        return self.focal_length_mm * (1 + self.magnification)

    @property
    def working_f_number(self) -> float:
        """N_w = N(1 + |m|), the ratio of image distance to aperture: 1/(2 tan α), with α the half
        angle of the cone of light.
        """
        return self.f_number * (1 + self.magnification)

    @property
    def effective_f_number(self) -> float:
        """N_e = 1/(2 sin α), the f-number of diffraction, a ratio: 1/(2 NA) with NA = sin α on the
        sensor's side.

        Light and blur share one pupil (Abbe's sine condition): irradiance goes with sin²α, the
        cut-off frequency with 2 sin α/λ.
        """
        return math.hypot(self.working_f_number, 0.5)

    @property
    def numerical_aperture(self) -> float:
        """NA = sin α of the cone of light on the axis, a ratio: 1/(2 N_e)."""
        return 0.5 / self.effective_f_number

    @property
    def relative_illumination(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Image heights in mm, and the illumination there relative to the axis, or None if no table
        states it.
        """
        rows = self.fall_off or self.chief_ray_angle
        if rows is None or (self.fall_off is None and len(rows[0]) < 3):
            return None
        return tuple(row[0] for row in rows), tuple(row[-1] for row in rows)

    def lights_like(self, other: Camera) -> bool:
        """Whether another camera gives the same irradiance; its directions, which only pixels with
        a stack see, may differ.
        """
        tables = {self.relative_illumination, other.relative_illumination}
        directions = {
            name: getattr(other, name) for name in ("chief_ray_angle", "fall_off", *_VEIL_FIELDS)
        }
        return len(tables) == 1 and self.model_copy(update=directions) == other

    @property
    def without_veil(self) -> Camera:
        """This camera without veiling glare, on which no render and no blur depends."""
        if not self.veiling_glare:
            return self
        return self.model_copy(update=dict.fromkeys(_VEIL_FIELDS, 0.0))

    def with_light_of(self, chosen: LensOptions) -> Camera:
        """This camera with the veil and the fall-off of options of a lens; fields without an option
        stay.

        chosen : of a lens, whose file is not looked at

        Raises PixsimError for a fall-off beside another one, or that ends before the corner of the
        die.
        """
        changes = {
            field: getattr(chosen, name)
            for name, field in ANY_LENS_FIELDS.items()
            if getattr(chosen, name) is not None
        }
        return Camera(**dict(self) | changes) if changes else self

    @property
    def options(self) -> CameraOptions:
        """Options that make this camera again, together with `lens_options`."""
        lens_fields = {"lens", *ANY_LENS_FIELDS.values()}
        if self.lens:
            lens_fields |= {"focal_length_mm", "chief_ray_angle"}
        fields = self.model_dump(exclude=lens_fields)
        if self.lens:
            fields["f_number"] = self.lens.f_number
        return CameraOptions(**fields)

    @property
    def lens_options(self) -> LensOptions:
        """Options of the real lens, if there is one, and of veil and fall-off."""
        options: dict[str, Any] = {}
        if self.lens:
            options = self.lens.model_dump(include=set(PrescriptionOptions.model_fields))
        for name, field in ANY_LENS_FIELDS.items():
            if value := getattr(self, field):
                options[name] = value
        return LensOptions(**options)

    @property
    def fov_deg(self) -> float:
        """Full horizontal field of view."""
        return math.degrees(2 * math.atan(self.die_mm / (2 * self.image_distance_mm)))

    @property
    def lens_words(self) -> str:
        """Focal length and f-number, as text."""
        return f"{self.focal_length_mm:.4g} mm {f_stop(self.f_number)}"

    @property
    def field_words(self) -> str:
        """Full angles of the field of view, across and down, as text.

        >>> camera = Camera(
        ...     focal_length_mm=50.0, die_mm=36.0, die_height_mm=24.0, object_distance_m=1e6
        ... )
        >>> camera.field_words
        '39.6° × 27°'
        """
        across, down = (
            math.degrees(2 * math.atan(side / (2 * self.image_distance_mm)))
            for side in (self.die_mm, self.height_mm)
        )
        return f"{across:.3g}° × {down:.3g}°"

    @property
    def aperture_radius_m(self) -> float:
        """f/2N, half of the entrance pupil's diameter."""
        return 1e-3 * self.focal_length_mm / (2 * self.f_number)

    @property
    def chart_half_width_m(self) -> float:
        """Half the width of a chart that fills the die, in the plane in focus."""
        return self.die_mm / 2 * self.object_distance_m / self.image_distance_mm

    @property
    def chart_half_height_m(self) -> float:
        """Half the height of a chart that fills the die, in the plane in focus."""
        return self.height_mm / 2 * self.object_distance_m / self.image_distance_mm

    def window(self, width_mm: DieWidth | None) -> Camera:
        """This lens on a central part of the die, `width_mm` wide; the camera itself for None.

        Raises PixsimError if the window is wider than the die.
        """
        if width_mm is None:
            return self
        if width_mm > self.die_mm:
            raise invalid(
                "window_mm", f"{width_mm:g}", f"at most the width of the die, {self.die_mm:g}"
            )

        height_mm = None
        if self.die_height_mm is not None:
            height_mm = self.die_height_mm * width_mm / self.die_mm
        return self.model_copy(update={"die_mm": width_mm, "die_height_mm": height_mm})

    @classmethod
    def from_lens_geometry(
        cls,
        fov_deg: FieldOfView,
        aperture_radius_m: UpToInfinity,
        focus_distance_m: UpToInfinity,
        die_mm: DieWidth,
    ) -> Camera:
        """Camera of a renderer's thin lens: v from field of view and die, then 1/f = 1/u + 1/v."""
        return cls(**values_of_lens_geometry(fov_deg, aperture_radius_m, focus_distance_m, die_mm))


def values_of_lens_geometry(
    fov_deg: float, aperture_radius_m: float, focus_distance_m: float, die_mm: float
) -> dict[str, float]:
    """Return the fields of `Camera.from_lens_geometry`, unchecked."""
    v_mm = die_mm / (2 * math.tan(math.radians(fov_deg) / 2))
    u_mm = 1e3 * focus_distance_m
    f_mm = u_mm * v_mm / (u_mm + v_mm)
    f_number = f_mm / (2e3 * aperture_radius_m)
    return {
        "focal_length_mm": f_mm,
        "f_number": f_number,
        "die_mm": die_mm,
        "object_distance_m": focus_distance_m,
    }


_DIE_DIGITS = 9  # of a die in mm: 1 pm, so that 2448 × 3.45 µm is 8.4456 mm


def _as_pixel_count(value: object) -> object:
    """Return columns and rows, from numbers or from text such as `2448x2048`.

    Raises ValueError if the value is not a pair.
    """
    pair = value
    if isinstance(value, str):
        text = value.lower().replace("×", "x").replace(",", "x").strip("[] ")
        pair = [part.strip() for part in text.split("x")]
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        is_count = isinstance(value, int)
        hint = " The number of samples across the film is resolution." if is_count else ""
        example = "1936x1216" if isinstance(value, str) else "[1936, 1216]"
        raise ValueError(f"got {value_text(value)}; allowed: columns and rows, as {example}.{hint}")
    return pair


_PixelCount = Annotated[
    tuple[Annotated[int, Field(ge=1, le=10**6)], Annotated[int, Field(ge=1, le=10**6)]],
    BeforeValidator(_as_pixel_count),
]


# Fields of `CameraOptions` that belong to a sensor, not to a lens.
DIE_FIELDS = ("die_mm", "die_height_mm", "pixels")


@checked_methods
class CameraOptions(Record):
    """Camera fields that replace the scene's; a field of None keeps the value of the scene."""

    focal_length_mm: FocalLength | None = Field(
        None, description=Camera.model_fields["focal_length_mm"].description
    )
    f_number: FNumber | None = Field(None, description=Camera.model_fields["f_number"].description)
    die_mm: Annotated[DieWidth | None, _IN_PIXELS] = Field(
        None, description=Camera.model_fields["die_mm"].description
    )
    die_height_mm: Annotated[DieWidth | None, _IN_PIXELS] = Field(
        None, description=Camera.model_fields["die_height_mm"].description
    )
    pixels: Annotated[
        _PixelCount | None, Words(also=SIZES, instead={"resolution": PIXELS_OR_FILM})
    ] = Field(
        None,
        description=(
            "columns and rows of pixels, which with pixel.pitch_um give die_mm and die_height_mm"
        ),
    )
    object_distance_m: Distance | None = Field(
        None, description=Camera.model_fields["object_distance_m"].description
    )
    transmittance: Fraction | None = Field(
        None, description=Camera.model_fields["transmittance"].description
    )
    chief_ray_angle: ChiefRays | None = Field(
        None, description=Camera.model_fields["chief_ray_angle"].description
    )

    def over(self, camera: Camera) -> Camera:
        """Return a camera with the fields that these options set.

        Raises PixsimError for `pixels` without a die (`with_die`).
        """
        if self.pixels is not None and self.die_mm is None:
            raise invalid(
                "camera.pixels",
                list(self.pixels),
                "pixels together with pixel.pitch_um, or die_mm and die_height_mm",
            )

        fixed: tuple[str, ...] = ()
        if camera.lens:
            fixed = ("focal_length_mm", "f_number", "object_distance_m", "chief_ray_angle")
        if changed := [name for name in fixed if getattr(self, name) is not None]:
            got = (
                f"camera.{changed[0]} for light that came through the lens"
                f" '{camera.lens.file if camera.lens else ''}'"
            )
            raise invalid(
                "camera",
                got,
                "the lens with which this light was rendered",
                "Render the scene with the other lens.",
            )

        return Camera(
            **camera.model_dump() | self.model_dump(exclude_none=True, exclude={"pixels"})
        )

    def with_die(self, pitch_um: Positive | None) -> CameraOptions:
        """Return these options with the die of `pixels` at a pitch (µm).

        Raises ValueError if a stated die differs by more than half a pixel, and for a die of an
        impossible size.
        """
        if self.pixels is None:
            return self
        if pitch_um is None:
            raise ValueError(
                f"camera.pixels = {list(self.pixels)} needs the pitch of the sensor"
                " (pixel.pitch_um)"
            )

        die_mm = {}
        for name, count in zip(("die_mm", "die_height_mm"), self.pixels, strict=True):
            size_mm = 1e-3 * count * pitch_um
            low_mm, high_mm = DIE_RANGE_MM
            if not low_mm <= size_mm <= high_mm:
                raise ValueError(
                    f"camera.pixels = {list(self.pixels)} of {pitch_um:g} µm are a die of"
                    f" {size_mm:.6g} mm; allowed: dies of {low_mm:g} to {high_mm:g} mm. Check"
                    " pixel.pitch_um, which is in µm"
                )
            stated_mm = getattr(self, name)
            if stated_mm is not None and abs(stated_mm - size_mm) > 0.5e-3 * pitch_um:
                raise ValueError(
                    f"camera.{name} = {stated_mm:g} differs from camera.pixels ="
                    f" {list(self.pixels)} of {pitch_um:g} µm, which are {size_mm:.6g} mm, by"
                    " more than half a pixel; give one of them"
                )

            die_mm[name] = round(size_mm, _DIE_DIGITS) if stated_mm is None else stated_mm

        return CameraOptions(**self.model_dump() | die_mm)

    def assumption(self, camera: Camera) -> str:
        """Say that the focal length behind a stated die is assumed, with the field of view that
        follows; empty if it is stated.

        camera : that these options make, of a scene
        """
        if camera.lens or self.focal_length_mm is not None or self.die_mm is None:
            return ""
        return (
            f"focal length {camera.focal_length_mm:.3g} mm assumed, as in the scene: a field of"
            f" {camera.field_words}"
        )
