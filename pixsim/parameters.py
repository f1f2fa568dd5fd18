"""Everything a user can set: frozen records, checked when made, with a content hash out.

Lengths on the sensor are in µm, the die and the focal length in mm, distances in m; every name ends in its unit.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from pixsim import bounds
from pixsim.config import merge
from pixsim.pixel_record import DATA_SHEET, NO_TECHNOLOGY
from pixsim.pixel_record import Pixel as Pixel
from pixsim.pixel_record import PixelOptions as PixelOptions
from pixsim.record import Record as Record
from pixsim.record import content_hash as content_hash

FASTEST_WORKING_F_NUMBER = 0.5
Part = Annotated[float, Field(ge=0, le=1)]  # of a length


class Camera(Record):
    """A thin lens in air and a die behind it, focused on a plane.

    With u the object distance: magnification m = f/(u - f), image distance v = f(1 + m), aperture radius f/2N.

    >>> camera = Camera(focal_length_mm=50.0, object_distance_m=0.1)  # twice the focal length away: life size
    >>> camera.magnification, camera.image_distance_mm, camera.working_f_number
    (1.0, 100.0, 8.0)
    >>> round(camera.effective_f_number, 4)  # what diffraction sees
    8.0156
    """

    focal_length_mm: bounds.FocalLength = Field(3.86, description="focal length")
    f_number: bounds.FNumber = Field(4.0, description="f-number as engraved: focal length over entrance pupil diameter")
    die_mm: bounds.DieWidth = Field(2.7136, description="width of the die; 512 pixels of 5.3 µm by default")
    object_distance_m: bounds.Distance = Field(1.0, description="from the lens to the plane in focus")
    transmittance: bounds.Fraction = Field(1.0, description="of the lens")

    @model_validator(mode="after")
    def _in_front_of_the_focus(self) -> Self:
        if self.focal_length_mm >= 1e3 * self.object_distance_m:
            raise ValueError(
                f"focal_length_mm = {self.focal_length_mm:g} is not shorter than object_distance_m = "
                f"{self.object_distance_m:g} ({1e3 * self.object_distance_m:g} mm): no real image forms. "
                "Move the object away or take a shorter lens"
            )
        if self.working_f_number < FASTEST_WORKING_F_NUMBER:
            raise ValueError(
                f"f_number = {self.f_number:g} is faster than a thin lens in air can be: the working f-number, "
                f"N (1 + |m|) = {self.working_f_number:g}, must be at least {FASTEST_WORKING_F_NUMBER:g}"
            )
        return self

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
        """N_w = N(1 + |m|), the ratio of image distance to aperture: 1/(2 tan α), with α the half angle of the cone of light."""
        return self.f_number * (1 + self.magnification)

    @property
    def effective_f_number(self) -> float:
        """N_e = 1/(2 sin α), the f-number of diffraction, a ratio: 1/(2 NA) with NA = sin α on the sensor's side.

        Light and blur have one pupil (Abbe's sine condition): irradiance goes with sin²α, the cut-off frequency with 2 sin α/λ.
        """
        return math.hypot(self.working_f_number, 0.5)

    @property
    def fov_deg(self) -> float:
        """Full horizontal field of view."""
        return math.degrees(2 * math.atan(self.die_mm / (2 * self.image_distance_mm)))

    @property
    def aperture_radius_m(self) -> float:
        """f/2N, half of the entrance pupil's diameter."""
        return 1e-3 * self.focal_length_mm / (2 * self.f_number)

    @property
    def chart_half_width_m(self) -> float:
        """Half width, in the plane in focus, of a chart that fills the die."""
        return self.die_mm / 2 * self.object_distance_m / self.image_distance_mm

    @classmethod
    def from_lens_geometry(cls, fov_deg: float, aperture_radius_m: float, focus_distance_m: float, die_mm: float) -> Camera:
        """The camera behind a renderer's thin lens: v from field of view and die, then 1/f = 1/u + 1/v."""
        v_mm = die_mm / (2 * math.tan(math.radians(fov_deg) / 2))
        u_mm = 1e3 * focus_distance_m
        f_mm = u_mm * v_mm / (u_mm + v_mm)
        return cls(
            focal_length_mm=f_mm,
            f_number=f_mm / (2e3 * aperture_radius_m),
            die_mm=die_mm,
            object_distance_m=focus_distance_m,
        )


class CameraOptions(Record):
    """Camera fields that replace what the scene says; None leaves the scene's own."""

    focal_length_mm: bounds.FocalLength | None = Field(None, description=Camera.model_fields["focal_length_mm"].description)
    f_number: bounds.FNumber | None = Field(None, description=Camera.model_fields["f_number"].description)
    die_mm: bounds.DieWidth | None = Field(None, description=Camera.model_fields["die_mm"].description)
    object_distance_m: bounds.Distance | None = Field(None, description=Camera.model_fields["object_distance_m"].description)
    transmittance: bounds.Fraction | None = Field(None, description=Camera.model_fields["transmittance"].description)

    def over(self, camera: Camera) -> Camera:
        """The camera with what is given here in place of its own."""
        return Camera.model_validate(camera.model_dump() | self.model_dump(exclude_none=True))


class Exposure(Record):
    """Manual where `integration_s` is given, else automatic: the brightest pixel's mean at `well_target` of the well."""

    integration_s: bounds.Seconds | None = Field(None, description="manual")
    max_integration_s: bounds.Seconds = Field(0.1, description="automatic: never longer")
    well_target: bounds.Fraction = Field(0.95, description="automatic: the brightest pixel's mean, of the full well")


class Display(Record):
    """A grey CRT or LCD, its viewer, and the metric."""

    raster: Literal["fixed_size", "one_to_one"] = Field(
        "fixed_size", description="the die fills `dots` display dots, or one pixel is one dot"
    )
    dots: Annotated[int, Field(ge=8, le=4096)] = Field(512, description="across the die, for fixed_size")
    samples_per_deg: Annotated[float, Field(ge=1e-3, le=1e5)] = Field(
        23.0, description="display dots per degree of visual angle; 72 dpi at 18 inch"
    )
    interpolation: Literal["linear", "nearest", "cubic"] = Field(
        "linear", description="between pixel centres, before averaging over dots"
    )
    gamma: Annotated[float, Field(ge=0.01, le=100)] = Field(2.2, description="light = counts^gamma")
    bits: Annotated[int, Field(ge=1, le=16)] = Field(8, description="of the digital counts")
    white_cd_per_m2: bounds.Luminance | None = Field(
        None, description="scene luminance shown as display white; None: that of texel value 1 of an emissive chart"
    )
    filters: Literal["published", "zhang1996"] = Field("published", description="of S-CIELAB")
    delta_e: Literal["1976", "1994", "2000"] = Field("1976", description="colour difference formula")


class Effort(Record):
    """How much work a result may cost, and how wrong it may be for that."""

    tolerance_e: Annotated[float, Field(gt=0, lt=1)] = Field(
        1e-3, description="relative error of the mean electrons that all that is left out may cost together"
    )
    tolerance_delta_e: Annotated[float, Field(ge=1e-9, le=1e3)] | None = Field(
        None, description="error of mean ΔE; picks film, render noise, tolerance_e and sensors by a short, cached calibration"
    )
    render_noise: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        0.2, description="noise of the render, as a fraction of the sensor's temporal noise"
    )
    max_seconds: bounds.Seconds = Field(
        120.0, description="of rendering; if they end it, a warning says so, and what noise was reached"
    )


class PitchRange(Record):
    """Pitches at equal ratios, from the pitch with `min_fill_factor` (or `min_um`) to `max_um`; or the list `values_um`."""

    min_fill_factor: bounds.Fraction = Field(0.05, description="of the smallest pixel that is tried")
    min_um: bounds.Pitch | None = Field(None, description="the smallest pixel that is tried, in place of its fill factor")
    max_um: bounds.Pitch = Field(15.0, description="the largest pixel that is tried, centre to centre")
    count: Annotated[int, Field(ge=5, le=1000)] = Field(24, description="pixel sizes that are tried")
    values_um: tuple[bounds.Pitch, ...] | None = Field(None, description="these pixel sizes in place of the others")

    @property
    def largest_um(self) -> float:
        """The largest pixel of the range as it is stated; the frame that a study scores follows from it."""
        return self.max_um if self.values_um is None else max(self.values_um)


class StudyScene(Record):
    """What a study looks at."""

    file: str = Field("csf", description="an XML file or the name of a packaged scene")
    parameters: dict[str, float | int | str] = Field(default_factory=dict, description="set <default> parameters")


class Study(Effort):
    """Mean ΔE for many pitches, technologies and individual sensors."""

    name: Annotated[
        str,
        Field(pattern=r"^\w[\w.\-]*$", max_length=100, description="letters, digits, dots and dashes; random streams depend on it"),
    ]
    title: str = Field("", description="of the report")
    seed: Annotated[int, Field(ge=0)] = Field(0, description="of the render, the sensors and their noise")
    technologies: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        ("0.35um",), description="packaged technologies, or paths of TOML files; each is a curve"
    )
    process: dict[str, dict[str, float]] = Field(
        default_factory=dict, description="technology -> number of its file -> value in this study, in the number's unit"
    )
    pitch: PitchRange = Field(PitchRange(), description="pixel sizes that are tried")
    repeats: Annotated[int, Field(ge=2, le=10000)] = Field(8, description="individual sensors for each pitch")
    target_ci_um: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None,
        description="add pixel sizes near the optimum, and sensors, until half of the length of every optimum's 95 % interval is "
        "at most this",
    )
    max_repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        32, description="at most so many sensors at one pixel size, for target_ci_um"
    )
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None,
        description="at most so many frames in all, for target_ci_um; None: as many for each technology as max_repeats at each of "
        "the first pixel sizes would take",
    )
    iso_delta_e: Annotated[float, Field(gt=0, le=1e6)] = Field(3.0, description="level of the iso-ΔE curves")
    detail: tuple[Part, Part] | None = Field(
        None,
        description="of the picture, from its left and its top (0 to 1): centre of the detail that the report shows of all sizes",
    )
    paper: bool = Field(False, description="compare with the statements of Chen et al. (2000); needs the csf scene and 0.35um")
    scene: StudyScene = Field(StudyScene(), description="what is looked at")
    camera: CameraOptions = Field(CameraOptions(), description="over what the scene says")
    pixel: PixelOptions = Field(PixelOptions(), description="of every pixel, but for its process and size")
    exposure: Exposure = Field(Exposure(), description="of every frame")
    display: Display = Field(Display(), description="and viewer, and metric")
    sources: dict[str, str] = Field(default_factory=dict, description="dotted name -> where its value comes from")
    quick: dict[str, Any] = Field(default_factory=dict, description="replaces the above under --quick")

    @model_validator(mode="after")
    def _paper_needs_its_scene(self) -> Self:
        if self.paper and (self.scene.file != "csf" or "chart" in self.scene.parameters or "0.35um" not in self.technologies):
            raise ValueError("paper = true compares with Chen et al. (2000): it needs scene.file = 'csf' and technology '0.35um'")
        return self

    @model_validator(mode="after")
    def _data_sheets_are_scaled(self) -> Self:
        """A well that is the same at every pitch would make small pixels far too good."""
        if NO_TECHNOLOGY in self.technologies:
            if len(self.technologies) > 1:
                raise ValueError(f"technologies: '{NO_TECHNOLOGY}' is the data sheet of [pixel]; give it alone, or none of it")
            if missing := [name for name in ("data_sheet_pitch_um", *DATA_SHEET) if getattr(self.pixel, name) is None]:
                raise ValueError(f"technologies = ['{NO_TECHNOLOGY}'] needs a data sheet in [pixel]; missing: {', '.join(missing)}")
            if self.pitch.min_um is None and self.pitch.values_um is None:
                raise ValueError("a data sheet tells no fill factors: give pitch.min_um, or pitch.values_um")
        return self

    @cached_property
    def quickened(self) -> Study:
        """This study with its `quick` table merged in; numbers of technologies that the table leaves out go with them."""
        table = merge(self.model_dump(exclude={"quick"}, mode="json"), self.quick)
        table["process"] = {name: own for name, own in table["process"].items() if name in table["technologies"]}
        return Study.model_validate(table)


class Run(Effort):
    """The options of `pixsim run`, as tables."""

    seed: Annotated[int, Field(ge=0)] = Field(0, description="of the render, the sensor and its noise")
    scene: dict[str, float | int | str] = Field(default_factory=dict, description="set <default> parameters, as -D does")
    camera: CameraOptions = Field(CameraOptions(), description="over what the scene says")
    pixel: Pixel = Field(Pixel(), description="of the sensor")
    exposure: Exposure = Field(Exposure(), description="of the frame")
    display: Display = Field(Display(), description="and viewer, and metric")


def pixel_of(study: Study, technology: str, pitch_um: float) -> Pixel:
    """A pixel of a study: its options, in a technology, by name or path, at a pitch."""
    return Pixel.model_validate(study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})
