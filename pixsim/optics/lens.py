"""A real lens: what its prescription does to light, by paraxial and by real rays.

Conventions: lengths in mm; the field angle is the angle of the chief ray in object space to the
axis, in the y-z plane, light going to +y, where the image lies too. Points of the stop are (x, y)
over the height that the real axial ray from the edge of the paraxial entrance pupil has there, at
the primary wavelength: the stop is a real disc, and it is filled at every field. An object at a
finite distance is a plane; its distance counts from the paraxial entrance pupil, in which the
camera stands.

The optical path difference is W = (path of the chief ray - path of the ray)/λ, from the incident
wave to the reference sphere around the chief ray's image point, whose radius reaches to the
paraxial exit pupil on the axis (both of the primary wavelength). A transverse error is -R λ
∂W/∂(exit pupil); with waves exp(+ikz) the pupil function is exp(-2πi W).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields as dataclass_fields, replace
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pixsim.base.arrays import Array, Finites, Positives, in_threads
from pixsim.base.bounds import Bounds, Positive, check_broadcast
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.layers import Layer
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, warn
from pixsim.base.records import checked
from pixsim.optics.ghosts import Ghost, find_ghosts, reflectances
from pixsim.optics.glass import AIR, Glass
from pixsim.optics.lens_options import PrescriptionOptions
from pixsim.optics.prescription import Prescription, Vignetting, read_prescription
from pixsim.optics.pupil import Directions
from pixsim.optics.quantities import AnyDistance, FNumberOrPinhole, Reflectance
from pixsim.optics.ray_trace import (
    Rays,
    at_plane,
    intersect,
    paraxial,
    rays_from,
    refracted,
    reversed_surfaces,
    trace,
)

# Over the stop's radius: a square grid, no lengths.
_StopPoints = Annotated[ArrayLike, Bounds(-2, 2)]
_Bases = tuple[Array, Array]  # monomials odd in x, and those even in x
_MM_PER_NM = 1e-6

# Degree of the polynomial from the stop to the entrance pupil: within 1e-9 of its radius for a
# Cooke triplet at 20°; and the rays on half of the stop to which it is fitted.
_DEGREE = 11
_RINGS = 8
_SPOKES = 13
# Distance from the wanted point of the stop, over the stop's radius: 1e-7 waves at 100 waves of
# tilt.
_AIM_TOLERANCE = 1e-9
_MAX_AIM_STEPS = 30
_FIELD_STEPS = 12  # to a field whose chief ray cannot be aimed from the axis
_MAX_CACHED_INDICES = 256  # sets of wavelengths
# Rays at a time: with fewer, threads take longer to take turns than to trace; with more, memory
# runs short.
_BLOCK = 1 << 15

# Spokes of light at an image point: 1e-5 of the area if clear apertures cut corners, 1e-6 of it
# where only the stop cuts.
_SPOKES_OF_OUTLINE = 256
_SMOOTH_SPOKES = 64
_MAX_SPOKES = 4096
_OUTLINE_START = 0.1  # of 1/N, in direction cosines: a fifth of a pupil's half width
# Of the distance to the predicted edge.
_OUTLINE_STEPS = (0.7, 0.85, 1.0, 1.15)
_OUTLINE_REACH = 10.0
_MIDDLE_STEPS = 3  # each is a 20th of the one before: slivers of 1e-4 of a pupil
# Of edges in direction cosines, and of field angles in degrees.
_ROOT_STEPS = 60
_ROOT_WIDTH = 1e-12
_ROOT_VALUE = 1e-11
_EDGE_TOLERANCE = 1 + 1e-12  # of the stop's edge

_STEEPEST_DEG = 89.0
_FIELD_COUNT = 179
# Of the search for the largest field that can be traced, in tenths of a degree.
_LIMIT_FIELDS = 33
_LIMIT_PER_DEG = 10
_F_NUMBER_ROUNDING = 1e-8  # relative: an f-number in a few digits is the lens's own
_FOCUS_STEP_MM = 1e-3
# With an Airy disc of 1.3 mm: what has a larger one is afocal but for rounding.
_FAINTEST_F_NUMBER = 1000.0
# Of the focal length: the image may lie as far in front of the last surface, as within a cover
# glass.
_MAX_VIRTUAL_SHARE = 0.01


@dataclass(frozen=True)
class FirstOrder:
    """Paraxial data at one wavelength, with the object at infinity and the entrance pupil's
    diameter of the prescription.

    focal_length_mm : effective focal length
    back_focal_length_mm : from the last vertex to the paraxial focus
    entrance_pupil_diameter_mm, exit_pupil_diameter_mm : of the stop's images
    entrance_pupil_from_first_vertex_mm : positive behind the first vertex
    exit_pupil_from_image_mm : negative in front of the image plane; infinite if the lens is
        telecentric there
    f_number : focal length over entrance pupil diameter
    """

    focal_length_mm: float
    back_focal_length_mm: float
    entrance_pupil_diameter_mm: float
    entrance_pupil_from_first_vertex_mm: float
    exit_pupil_diameter_mm: float
    exit_pupil_from_image_mm: float
    f_number: float


@dataclass(frozen=True)
class ChiefRay:
    """The ray through the centre of the stop, in the image plane.

    height_mm : on the side of the image, positive for positive fields, (...)
    angle_deg : to the axis in image space, (...)
    """

    height_mm: Array
    angle_deg: Array


@dataclass(frozen=True)
class Wavefront:
    """Rays of one or more fields and wavelengths (C,) through points of the stop (P,), in the image
    plane.

    opd_waves : (C, P); NaN if the ray meets no image
    passed : (C, P), whether the ray gets through the clear apertures
    x_mm, y_mm : (C, P), from the chief ray's point
    cosines : (C, P, 2), along x and y, in image space
    stop_x, stop_y : (C, P), where the rays meet the stop, over its radius
    chief_y_mm : (C,), of the chief ray's point
    chief_cosine : (C,), its direction cosine along y
    """

    opd_waves: Array
    passed: NDArray[np.bool_]
    x_mm: Array
    y_mm: Array
    cosines: Array
    stop_x: Array
    stop_y: Array
    chief_y_mm: Array
    chief_cosine: Array


def load_lens(
    file: str | os.PathLike[str],
    configuration: int | None = None,
    semi_diameters: Literal["ignore", "clip"] = "ignore",
    vignetting_factors: Literal["use", "ignore"] | None = None,
    glass_catalogues: Sequence[str | os.PathLike[str]] = (),
    unknown_glass: Literal["error", "model"] = "error",
) -> Lens:
    """Load a lens: a packaged one by its name (cooke_triplet, double_gauss, phone, singlet), or a
    `.toml` or `.zmx` file.

    Object, image plane and scale are those of the file. Where a file leaves a choice, a warning
    says which was made.

    file : name or path
    configuration : of a .zmx file, from 1; the active one by default
    semi_diameters : whether those that a .zmx file fixes without an aperture "clip" rays at
        refracting surfaces
    vignetting_factors : of a .zmx file, "use" or "ignore"; by default they are used unless
        apertures stop rays
    glass_catalogues : AGF files, which take precedence over the packaged glasses
    unknown_glass : "model" takes the n_d and V_d that the file states for a glass that no catalogue
        has

    Raises PixsimError for a file that is missing, damaged or binary, and for what pixsim does not
    trace, as an unknown glass.

    >>> round(float(load_lens("cooke_triplet").first_order(550.0).focal_length_mm), 6)
    49.999783
    """
    settings = {
        "file": os.fspath(file),
        "configuration": configuration,
        "semi_diameters": semi_diameters,
        "vignetting_factors": vignetting_factors,
        "glass_catalogues": tuple(os.fspath(name) for name in glass_catalogues),
        "unknown_glass": unknown_glass,
    }
    return read_lens(os.fspath(file), checked(PrescriptionOptions, [Layer(settings)]))


def read_lens(file: str, options: PrescriptionOptions) -> Lens:
    """Return the lens of a file. Raises PixsimError as `load_lens` does.

    options : how to read the file; their `file` and how the lens is used are not looked at
    """
    return lens_from_prescription(read_prescription(file, options))


def lens_from_prescription(prescription: Prescription) -> Lens:
    """Return the lens of a prescription. Raises PixsimError if it makes no real image, or if its
    axial rays do not get through.

    Warns of the prescription's notes, of light that its fixed semi-diameters and vignetting factors
    would stop or do stop, and of fields that cannot be traced.
    """
    lens = _without_fields(prescription)
    notes = list(prescription.notes)
    largest_deg, limit = _largest_field(lens)
    if limit:
        notes.append(Note("lens_as_read", lens=lens._label, words=limit))
    lens = lens.with_same_rays(max_field_deg=largest_deg)
    if prescription.vignetting:
        lens = lens.with_same_rays(vignetting=_vignetting(lens, prescription.vignetting))
    for note in (*notes, *_notes_of_stopped_light(lens)):
        warn(note)
    return lens


def _without_fields(prescription: Prescription) -> Lens:
    """Return the lens of a prescription without its fields.

    Raises PixsimError as `lens_from_prescription` does.
    """
    bare = Lens(prescription, 1.0, 0.0)

    focal_mm = bare.first_order(prescription.primary_nm).focal_length_mm
    if not 0 < focal_mm < math.inf:
        kind = "afocal, with" if math.isinf(focal_mm) else "virtual, with"
        raise invalid(
            bare._label,
            f"no real image: {kind} a focal length of {focal_mm:g} mm",
            "a positive focal length, of a lens that makes a real image",
        )

    object_mm = prescription.object_distance_mm
    if math.isfinite(object_mm):
        object_mm += bare._entrance_pupil_mm
        if not object_mm > 0:
            raise invalid(
                bare._label,
                f"an entrance pupil {-object_mm:g} mm in front of the object",
                "an entrance pupil behind the object",
            )

    pupil_mm = _entrance_pupil_diameter_mm(bare, focal_mm, object_mm)
    f_number = focal_mm / pupil_mm
    if f_number > _FAINTEST_F_NUMBER:
        raise invalid(
            bare._label,
            f"no real image: afocal, with a focal length of {focal_mm:.4g} mm at f/{f_number:.4g}",
            f"an image at f/{_FAINTEST_F_NUMBER:g} or less",
        )

    lens = Lens(prescription, pupil_mm, 0.0, object_mm)
    back_mm = lens._paraxial_focus_mm() + prescription.surfaces[-1].thickness_mm
    if not -_MAX_VIRTUAL_SHARE * focal_mm <= back_mm + _trailing_air_mm(prescription) < math.inf:
        raise invalid(
            bare._label,
            f"no real image: a back focal length of {back_mm:.5g} mm",
            "a focus behind the last surface",
            "A lens that makes a virtual image needs another behind it.",
        )

    lens.stop_semi_diameter_mm  # noqa: B018 raises if the marginal ray does not reach the stop
    return lens


def _entrance_pupil_diameter_mm(bare: Lens, focal_mm: float, object_mm: float) -> float:
    """Return the diameter of the entrance pupil from the aperture that a prescription states.

    object_mm : distance of the object from the entrance pupil

    Raises PixsimError for a numerical aperture that the object's distance does not allow.
    """
    prescription = bare.prescription
    kind = prescription.aperture
    aperture = prescription.aperture_value
    if kind == "f_number" or (kind == "working_f_number" and math.isinf(object_mm)):
        return focal_mm / aperture

    if kind == "working_f_number":
        # A paraxial ray of slope 1 from the object on the axis has the object's distance as its
        # height in the pupil, and the slope in the image grows with that height.
        height = np.array([prescription.object_distance_mm])
        slope = np.array([1.0])
        indices = bare._indices(np.array([prescription.primary_nm]))
        _, image_slope = paraxial(prescription.surfaces, indices, height, slope)
        return object_mm / (aperture * abs(float(image_slope.flat[0])))

    if kind == "object_numerical_aperture":
        if not (aperture < 1 and math.isfinite(object_mm)):
            raise invalid(
                bare._label,
                f"a numerical aperture of {aperture:g}, with the object at {object_mm:g} mm",
                "below 1, for an object at a finite distance",
            )
        return 2 * object_mm * math.tan(math.asin(aperture))

    if kind == "stop_diameter":
        stop_over_pupil, _ = bare._entrance_pupil_scale(prescription.primary_nm)
        return aperture / abs(stop_over_pupil)
    return aperture


def _trailing_air_mm(prescription: Prescription) -> float:
    """Return the distance from the last surface that refracts to the last vertex."""
    distance_mm = 0.0
    for surface, in_front in pairwise(reversed(prescription.surfaces)):
        if surface.glass != AIR or in_front.glass != AIR:
            break
        distance_mm += in_front.thickness_mm
    return distance_mm


def _field_deg(lens: Lens, value: float) -> float:
    """Return the field angle of a field in the unit of the prescription. Raises PixsimError for
    image heights without a field.
    """
    kind = lens.prescription.field_of_view
    if kind == "angle_deg":
        return value
    if kind == "object_height":
        return math.degrees(math.atan(value / lens.object_distance_mm))
    if kind == "paraxial_image_height":
        return math.degrees(math.atan(value / abs(lens.paraxial_height_mm)))
    return lens.field_of_height(value, lens.primary_nm)


def _largest_field(lens: Lens) -> tuple[float, str]:
    """Return the largest field of a prescription in degrees, or the largest below it that can be
    traced, and a note on that.
    """
    stated = lens.prescription.field_value
    unit = "°" if lens.prescription.field_of_view == "angle_deg" else " mm"
    reason = ""
    try:
        wanted_deg = _field_deg(lens, stated)
    except PixsimError:  # an image height beyond the chief rays
        wanted_deg = float(lens._fields_with_chief_rays(lens.primary_nm)[0][-1])
        reason = "no chief ray has such an image height"
    else:
        if wanted_deg > _STEEPEST_DEG:
            reason = f"fields are traced below {_STEEPEST_DEG:g}°"

    limit_deg = min(wanted_deg, _STEEPEST_DEG)
    while limit_deg:
        traced_deg, step_deg = _last_traced_field(lens, limit_deg)
        if traced_deg == limit_deg:
            break
        if not traced_deg:
            return 0.0, ""  # the axis, whose failure is reported where it is traced

        lost_deg = min(traced_deg + step_deg, limit_deg)
        pupil_y_mm = lens._nearest_chief_height_mm(lost_deg, lens.primary_nm)
        where = lens._where_ray_ends(lost_deg, lens.primary_nm, 0.0, pupil_y_mm)
        reason = f"beyond, the chief ray {where}"
        limit_deg = math.floor(traced_deg * _LIMIT_PER_DEG) / _LIMIT_PER_DEG or traced_deg

    if not reason:
        return wanted_deg, ""
    return limit_deg, f"fields to {stated:g}{unit} are limited to {limit_deg:.4g}°, since {reason}"


def _last_traced_field(lens: Lens, limit_deg: float) -> tuple[float, float]:
    """Return the largest field up to a limit before the first whose chief ray is lost at one of the
    wavelengths, and the step to that one, both in degrees.
    """
    nm = np.unique(lens.prescription.wavelengths_nm)
    traced_deg = 0.0
    step_deg = limit_deg
    while step_deg > 1 / _LIMIT_PER_DEG and traced_deg < limit_deg:
        # Finer and finer, behind the last field that is traced.
        fields = np.linspace(traced_deg, min(traced_deg + step_deg, limit_deg), _LIMIT_FIELDS)
        rays, _ = lens._trace_chief_rays(np.repeat(fields, nm.size), np.tile(nm, fields.size))
        is_finite = np.isfinite(rays.path_mm[:, 0]).reshape(fields.size, nm.size)
        is_traced = is_finite.all(axis=1)

        last = fields.size - 1
        if not is_traced.all():
            last = max(int(np.argmin(is_traced)) - 1, 0)
        traced_deg = float(fields[last])
        step_deg /= _LIMIT_FIELDS - 1
    return traced_deg, step_deg


def _vignetting(
    lens: Lens, rows: tuple[Vignetting, ...]
) -> tuple[tuple[float, float, float, float], ...]:
    """Return `Lens.vignetting`: rows that act on the stop. Fields that cannot be traced are left
    out.
    """
    stop_mm = lens.stop_semi_diameter_mm
    stop_over_pupil, _ = lens._entrance_pupil_scale(lens.primary_nm)
    upright = math.copysign(1.0, stop_over_pupil)

    ellipses = []
    for row in rows:
        try:
            field_deg = _field_deg(lens, row.field_value)
        except PixsimError:
            continue
        centre_mm = upright * row.decentre * stop_mm
        ellipses.append((field_deg, centre_mm, row.across * stop_mm, row.along * stop_mm))

    if not ellipses or ellipses[0][0]:
        ellipses.insert(0, (0.0, 0.0, stop_mm, stop_mm))
    return tuple(ellipses)


def _notes_of_stopped_light(lens: Lens) -> list[Note]:
    """Return notes on light that fixed semi-diameters and vignetting factors would stop, or do
    stop.
    """
    prescription = lens.prescription
    remarks = []
    if prescription.fixed:
        remarks.append(
            f"fixed semi-diameters of {len(prescription.fixed)} surfaces stop no rays, since they"
            ' are no apertures; lens.semi_diameters = "clip" makes them stop rays'
        )
    if prescription.vignetting and lens.vignetting:
        remarks.append(
            'its vignetting factors are used; lens.vignetting_factors = "ignore" leaves them out'
        )
    if prescription.spare_vignetting:
        remarks.append(
            "its vignetting factors are not used, so that nothing is cut twice;"
            ' lens.vignetting_factors = "use" applies them all the same'
        )
    return [Note("lens_as_read", lens=lens._label, words=text) for text in remarks]


@checked_methods
@dataclass(frozen=True)
class Lens:
    """A lens that can be traced.

    prescription : surfaces and glasses
    entrance_pupil_diameter_mm : of the paraxial entrance pupil at the primary wavelength
    max_field_deg : the largest field angle for which the lens is made
    object_distance_mm : of the object plane from the entrance pupil
    vignetting : rows of what light of a field fills of the stop, an ellipse: the field in degrees,
        from the axis on, the height of its centre there, and its semi-axes across and along the
        field's direction, in mm; linear in between
    """

    prescription: Prescription
    entrance_pupil_diameter_mm: Positive
    max_field_deg: float
    object_distance_mm: AnyDistance = math.inf
    # Not in the text of a lens, which is hashed: lenses without vignetting keep their hash.
    vignetting: tuple[tuple[float, float, float, float], ...] = field(default=(), repr=False)

    def with_same_rays(self, **changes: Any) -> Lens:
        """Return the lens with other fields or other light stopped, which keeps the aimed rays in
        its caches.

        changes : fields of the lens: `max_field_deg`, `vignetting`, or a `prescription` whose
            surfaces stop other rays
        """
        changed = replace(self, **changes)
        for name in (
            "_cached_chief_heights",
            "_cached_pupil_polynomials",
            "_cached_indices",
            "stop_semi_diameter_mm",
        ):
            vars(changed)[name] = getattr(self, name)
        return changed

    @property
    def fingerprint(self) -> str:
        """A text that differs between lenses whose rays differ."""
        return repr(self) + (repr(self.vignetting) if self.vignetting else "")

    @property
    def _label(self) -> str:
        """The lens and its name, for messages."""
        return f"lens '{self.prescription.name}'"

    @cached_property
    def _cached_chief_heights(self) -> dict[tuple[float, float], float]:
        """Field and wavelength -> height of `_chief_pupil_heights_mm`."""
        return {}

    @cached_property
    def _cached_pupil_polynomials(self) -> dict[tuple[float, float], Array]:
        """Field and wavelength -> polynomials of `_pupil_polynomials`."""
        return {}

    @property
    def primary_nm(self) -> float:
        """The wavelength of first-order data, in nm."""
        return self.prescription.primary_nm

    @property
    def known_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength at which all glasses are known, in nm."""
        ranges = [glass.range_um for glass in self.prescription.glasses]
        return 1e3 * max(low for low, _ in ranges), 1e3 * min(high for _, high in ranges)

    # Paraxial

    def first_order(self, wavelength_nm: Positive) -> FirstOrder:
        """Return paraxial data at a wavelength.

        Raises PixsimError if the wavelength is outside the range of a glass.
        """
        surfaces = self.prescription.surfaces
        indices = self._indices(np.array([wavelength_nm]))
        behind = np.asarray(indices[-1])

        # A ray parallel to the axis, and one through the centre of the stop.
        height, angle = paraxial(surfaces, indices, np.array([1.0]), np.array([0.0]))
        stop = self.prescription.stop
        stop_height, stop_angle = paraxial(
            surfaces[stop:], indices[stop:], np.array([0.0]), np.array([1.0])
        )

        stop_over_pupil, pupil_from_vertex_mm = self._entrance_pupil_scale(wavelength_nm)
        with np.errstate(divide="ignore"):
            focal_mm = -1 / angle
            back_mm = -height / angle * behind
            exit_from_last_mm = -stop_height / stop_angle * behind
            exit_diameter_mm = np.abs(
                stop_over_pupil * self.entrance_pupil_diameter_mm / stop_angle
            )
        return FirstOrder(
            focal_length_mm=float(focal_mm[0]),
            back_focal_length_mm=float(back_mm.flat[0]),
            entrance_pupil_diameter_mm=self.entrance_pupil_diameter_mm,
            entrance_pupil_from_first_vertex_mm=pupil_from_vertex_mm,
            exit_pupil_diameter_mm=float(exit_diameter_mm[0]),
            exit_pupil_from_image_mm=float(exit_from_last_mm.flat[0]) - surfaces[-1].thickness_mm,
            f_number=float(np.abs(focal_mm[0])) / self.entrance_pupil_diameter_mm,
        )

    def _entrance_pupil_scale(self, wavelength_nm: float) -> tuple[float, float]:
        """Return the height in the stop over the height in the entrance pupil, and the pupil's
        distance from the first vertex in mm.

        Raises PixsimError if the entrance pupil is at infinity.
        """
        stop = self.prescription.stop
        surfaces = self.prescription.surfaces[:stop]
        indices = self._indices(np.array([wavelength_nm]))
        reduced_mm = surfaces[-1].thickness_mm / indices[stop] if surfaces else 0.0

        def height_at_stop(height: float, angle: float) -> float:
            y, n_u = paraxial(surfaces, indices, np.array([height]), np.array([angle]))
            return float((y + reduced_mm * n_u).flat[0])

        stop_over_pupil = height_at_stop(1.0, 0.0)
        if not stop_over_pupil:
            raise invalid(self._label, "an entrance pupil at infinity", "one at a finite distance")
        return stop_over_pupil, height_at_stop(0.0, 1.0) / stop_over_pupil

    def _indices(self, wavelength_nm: Array) -> list[float | Array]:
        """Return the index in front of the lens and behind each surface: 1 for air, (C, 1) for
        glasses, or numbers if C is 1.
        """
        key = wavelength_nm.tobytes()
        cached = self._cached_indices.get(key)  # once, since other threads may clear them
        if cached is not None:
            return cached

        index_of_glass: dict[Glass, float | Array] = {AIR: 1.0}
        for glass in self.prescription.glasses:
            index = glass.index(wavelength_nm)
            index_of_glass[glass] = index[:, None] if index.size > 1 else float(index[0])

        indices = [index_of_glass[surface.glass] for surface in self.prescription.surfaces]
        if len(self._cached_indices) >= _MAX_CACHED_INDICES:
            self._cached_indices.clear()
        return self._cached_indices.setdefault(key, [1.0, *indices])

    @cached_property
    def _cached_indices(self) -> dict[bytes, list[float | Array]]:
        """Wavelengths -> indices of `_indices`, which every trace asks for."""
        return {}

    # Aiming at the stop

    @cached_property
    def stop_semi_diameter_mm(self) -> float:
        """Radius of the stop in mm: where the real axial ray from the edge of the paraxial entrance
        pupil meets it.
        """
        radius_mm = self.entrance_pupil_diameter_mm / 2
        at_infinity = replace(self, object_distance_mm=math.inf)
        _, stop_y_mm = at_infinity._trace_to_stop(
            np.zeros(1), np.array([self.primary_nm]), np.zeros((1, 1)), np.array([[radius_mm]])
        )
        if not np.isfinite(stop_y_mm[0, 0]):
            where = at_infinity._where_ray_ends(0.0, self.primary_nm, 0.0, radius_mm)
            raise invalid(
                self._label, f"a marginal ray that {where}", "an aperture that lets it pass"
            )
        return float(abs(stop_y_mm[0, 0]))

    @cached_property
    def _exit_pupil_from_image_mm(self) -> float:
        """Distance of the paraxial exit pupil, where reference spheres cross the axis, from the
        image.
        """
        return self.first_order(self.primary_nm).exit_pupil_from_image_mm

    @cached_property
    def _entrance_pupil_mm(self) -> float:
        """Distance of the paraxial entrance pupil from the first vertex at the primary
        wavelength.
        """
        return self._entrance_pupil_scale(self.primary_nm)[1]

    def _rays_at_entrance_pupil(self, field_deg: Array, x_mm: Array, y_mm: Array) -> Rays:
        """Return rays at fields (C,) through points (C, P) of the entrance pupil in mm, with their
        paths from the object.

        Paths are relative to that through the centre of the entrance pupil.
        """
        angle = np.radians(field_deg)[:, None]
        z_mm = np.full((1, 1), self._entrance_pupil_mm)
        if math.isinf(self.object_distance_mm):
            rays = rays_from(x_mm, y_mm, z_mm, np.zeros((1, 1)), np.sin(angle), np.cos(angle))
            return replace(rays, path_mm=y_mm * np.sin(angle))

        object_mm = self.object_distance_mm
        object_y_mm = -object_mm * np.tan(angle)
        rise_mm = y_mm - object_y_mm
        length_mm = np.sqrt(x_mm * x_mm + rise_mm**2 + object_mm * object_mm)
        rays = rays_from(
            x_mm, y_mm, z_mm, x_mm / length_mm, rise_mm / length_mm, object_mm / length_mm
        )

        # The difference of two long paths, by the difference of their squares.
        centre_length_mm = np.sqrt(object_y_mm * object_y_mm + object_mm * object_mm)
        squares_mm2 = x_mm * x_mm + y_mm * y_mm - 2 * y_mm * object_y_mm
        return replace(rays, path_mm=squares_mm2 / (length_mm + centre_length_mm))

    def _trace_to_stop(
        self, field_deg: Array, wavelength_nm: Array, x_mm: Array, y_mm: Array
    ) -> tuple[Array, Array]:
        """Return where rays through points (C, P) of the entrance pupil meet the stop, in mm, both
        (C, P).
        """
        *in_front, stop = self.prescription.surfaces[: self.prescription.stop + 1]
        indices = self._indices(wavelength_nm)

        rays = self._rays_at_entrance_pupil(field_deg, x_mm, y_mm)
        for traced in trace(rays, in_front, indices):
            rays = traced
        if in_front:
            rays = replace(rays, z=rays.z - in_front[-1].thickness_mm)
        with np.errstate(all="ignore"):
            rays = intersect(rays, stop, indices[len(in_front)])
        return rays.x, rays.y

    def _chief_pupil_heights_mm(self, field_deg: Array, wavelength_nm: Array) -> Array:
        """Return the height in the entrance pupil of rays to the centre of the stop, (C,) in mm;
        NaN if there is none.
        """
        keys = list(zip(field_deg.tolist(), wavelength_nm.tolist(), strict=True))
        new = sorted(set(keys) - self._cached_chief_heights.keys())
        if new:
            fields = np.array([key[0] for key in new])
            wavelengths = np.array([key[1] for key in new])
            heights_mm = self._aimed_heights_mm(fields, wavelengths, np.zeros(fields.size))

            # Where a start on the axis fails, the field is approached in steps.
            is_lost = ~np.isfinite(heights_mm)
            if is_lost.any():
                start_mm = np.zeros(int(is_lost.sum()))
                for share in np.linspace(1 / _FIELD_STEPS, 1.0, _FIELD_STEPS):
                    start_mm = self._aimed_heights_mm(
                        share * fields[is_lost], wavelengths[is_lost], start_mm
                    )
                heights_mm[is_lost] = start_mm

            self._cached_chief_heights.update(zip(new, heights_mm.tolist(), strict=True))
        return np.array([self._cached_chief_heights[key] for key in keys])

    def _aimed_heights_mm(self, field_deg: Array, wavelength_nm: Array, start_mm: Array) -> Array:
        """Return the heights in the entrance pupil (C,) whose rays meet the centre of the stop, by
        the secant method; NaN where it does not converge.

        start_mm : first guess, (C,)
        """

        def stop_height_mm(height_mm: Array) -> Array:
            x_mm = np.zeros((height_mm.size, 1))
            _, y_mm = self._trace_to_stop(field_deg, wavelength_nm, x_mm, height_mm[:, None])
            return y_mm[:, 0]

        before_mm = start_mm
        height_mm = start_mm + 1e-3 * self.entrance_pupil_diameter_mm
        miss_mm = stop_height_mm(height_mm)
        miss_before_mm = stop_height_mm(before_mm)
        converged_mm = 1e-3 * _AIM_TOLERANCE * self.stop_semi_diameter_mm

        for _ in range(_MAX_AIM_STEPS):
            with np.errstate(all="ignore"):
                is_moving = (np.abs(miss_mm) > converged_mm) & (miss_mm != miss_before_mm)
                secant_mm = miss_mm * (height_mm - before_mm) / (miss_mm - miss_before_mm)
            if not is_moving.any():
                break

            before_mm = height_mm
            miss_before_mm = miss_mm
            height_mm = height_mm - np.where(is_moving, secant_mm, 0.0)
            miss_mm = stop_height_mm(height_mm)

        is_aimed = np.abs(miss_mm) <= _AIM_TOLERANCE * self.stop_semi_diameter_mm
        return np.where(is_aimed, height_mm, np.nan)

    def _pupil_polynomials(self, field_deg: Array, wavelength_nm: Array) -> Array:
        """Return polynomials (C, terms, 2) from the stop to the entrance pupil in mm, from a
        cache.
        """
        keys = list(zip(field_deg.tolist(), wavelength_nm.tolist(), strict=True))
        new = sorted(set(keys) - self._cached_pupil_polynomials.keys())
        batch_size = max(1, _BLOCK // (_RINGS * _SPOKES))
        for first in range(0, len(new), batch_size):
            batch = new[first : first + batch_size]
            fields = np.array([key[0] for key in batch])
            wavelengths = np.array([key[1] for key in batch])
            polynomials = self._fit_pupil_polynomials(fields, wavelengths)
            self._cached_pupil_polynomials.update(zip(batch, polynomials, strict=True))
        return np.stack([self._cached_pupil_polynomials[key] for key in keys])

    def _fit_pupil_polynomials(self, field_deg: Array, wavelength_nm: Array) -> list[Array]:
        """Return polynomials (terms, 2) from the stop to the entrance pupil, fitted to rays through
        points of half of the stop.
        """
        chief_mm = self._chief_pupil_heights_mm(field_deg, wavelength_nm)
        stop_x, stop_y, (odd_terms, even_terms), (odd_fit, even_fit) = _stop_samples()

        # The slopes at the chief ray give the first guess.
        step_mm = 1e-2 * self.entrance_pupil_diameter_mm
        near_x_mm = np.stack([np.full_like(chief_mm, step_mm), np.zeros_like(chief_mm)], axis=1)
        near_y_mm = np.stack([chief_mm, chief_mm + step_mm], axis=1)
        stop_x_mm, stop_y_mm = self._trace_to_stop(field_deg, wavelength_nm, near_x_mm, near_y_mm)
        slope_x = step_mm * self.stop_semi_diameter_mm / stop_x_mm[:, 0, None]
        slope_y = step_mm * self.stop_semi_diameter_mm / stop_y_mm[:, 1, None]
        inverse_jacobian = np.zeros((chief_mm.size, stop_x.size, 2, 2))
        inverse_jacobian[..., 0, 0] = slope_x
        inverse_jacobian[..., 1, 1] = slope_y

        pupil_x_mm, pupil_y_mm = self._aimed_points(
            field_deg,
            wavelength_nm,
            stop_x,
            stop_y,
            pupil_x_mm=slope_x * stop_x,
            pupil_y_mm=chief_mm[:, None] + slope_y * stop_y,
            inverse_jacobian=inverse_jacobian,
        )

        coefficients = np.zeros((chief_mm.size, even_terms.shape[1], 2))
        odd_count = odd_terms.shape[1]
        is_reached = np.isfinite(pupil_x_mm) & np.isfinite(pupil_y_mm)
        is_complete = is_reached.all(axis=1)
        # Sums that are the same for one field and for many, which matrix products are not.
        coefficients[is_complete, :odd_count, 0] = (pupil_x_mm[is_complete, None] * odd_fit).sum(
            axis=-1
        )
        coefficients[is_complete, :, 1] = (pupil_y_mm[is_complete, None] * even_fit).sum(axis=-1)

        # Some points of the stop may not be reached, as behind the rim of a lens.
        for index in np.flatnonzero(~is_complete):
            reached = is_reached[index]
            coefficients[index, :odd_count, 0] = np.linalg.lstsq(
                odd_terms[reached], pupil_x_mm[index, reached], rcond=1e-10
            )[0]
            coefficients[index, :, 1] = np.linalg.lstsq(
                even_terms[reached], pupil_y_mm[index, reached], rcond=1e-10
            )[0]
        return list(coefficients)

    def _aimed_points(
        self,
        field_deg: Array,
        wavelength_nm: Array,
        stop_x: Array,
        stop_y: Array,
        *,
        pupil_x_mm: Array,
        pupil_y_mm: Array,
        inverse_jacobian: Array,
        tolerance: float = _AIM_TOLERANCE,
    ) -> tuple[Array, Array]:
        """Return points of the entrance pupil (C, P) in mm whose rays meet points (P,) of the stop;
        NaN if there are none.

        Broyden's method (Math. Comp. 19, 577, 1965).

        pupil_x_mm, pupil_y_mm : first guess, (C, P)
        inverse_jacobian : derivatives of points of the entrance pupil by points of the stop, first
            guess, (C, P, 2, 2)
        tolerance : distance from the points of the stop, over its radius
        """
        stop_mm = self.stop_semi_diameter_mm

        def misses(pupil_x_mm: Array, pupil_y_mm: Array) -> Array:
            x_mm, y_mm = self._trace_to_stop(field_deg, wavelength_nm, pupil_x_mm, pupil_y_mm)
            return np.stack([x_mm / stop_mm - stop_x, y_mm / stop_mm - stop_y], axis=-1)

        miss = misses(pupil_x_mm, pupil_y_mm)
        for _ in range(_MAX_AIM_STEPS):
            is_moving = np.abs(miss).max(axis=-1) > tolerance / 10
            if not is_moving.any():
                break

            step = -(inverse_jacobian * miss[..., None, :]).sum(axis=-1)
            step = np.where(is_moving[..., None], step, 0.0)
            pupil_x_mm = pupil_x_mm + step[..., 0]
            pupil_y_mm = pupil_y_mm + step[..., 1]
            miss_before = miss
            miss = misses(pupil_x_mm, pupil_y_mm)

            # The rank-one update after which the inverse turns this change of the miss into this
            # step.
            predicted_step = (inverse_jacobian * (miss - miss_before)[..., None, :]).sum(axis=-1)
            row = (step[..., None] * inverse_jacobian).sum(axis=-2)
            with np.errstate(all="ignore"):
                scale = (step * predicted_step).sum(axis=-1, keepdims=True)
                update = (step - predicted_step)[..., None] * (row / scale)[..., None, :]
            is_usable = is_moving & np.isfinite(update).all(axis=(-1, -2))
            inverse_jacobian = inverse_jacobian + np.where(is_usable[..., None, None], update, 0.0)

        is_lost = ~(np.abs(miss).max(axis=-1) <= tolerance)
        return np.where(is_lost, np.nan, pupil_x_mm), np.where(is_lost, np.nan, pupil_y_mm)

    # Real rays

    def _trace_to_image(
        self, field_deg: Array, wavelength_nm: Array, x_mm: Array, y_mm: Array
    ) -> tuple[Rays, Array, Array]:
        """Return rays through points (C, P) of the entrance pupil in the image plane, and where
        they meet the stop, in mm.
        """
        surfaces = self.prescription.surfaces
        indices = self._indices(wavelength_nm)
        start = self._rays_at_entrance_pupil(field_deg, x_mm, y_mm)
        for number, rays in enumerate(trace(start, surfaces, indices)):
            if number == self.prescription.stop:
                stop_x_mm = rays.x
                stop_y_mm = rays.y
        at_image = at_plane(rays, surfaces[-1].thickness_mm, indices[-1])
        return at_image, stop_x_mm, stop_y_mm

    def _trace_chief_rays(self, field_deg: Array, wavelength_nm: Array) -> tuple[Rays, Array]:
        """Return the chief rays in the image plane, (C, 1), and their heights in the entrance pupil
        (C,); NaN if lost.
        """
        y_mm = self._chief_pupil_heights_mm(field_deg, wavelength_nm)
        x_mm = np.zeros((y_mm.size, 1))
        rays, _, _ = self._trace_to_image(field_deg, wavelength_nm, x_mm, y_mm[:, None])
        return rays, y_mm

    def _checked_chief_rays(self, field_deg: Array, wavelength_nm: Array) -> Rays:
        """Return the chief rays in the image plane, (C, 1). Raises PixsimError if one does not get
        there.
        """
        rays, pupil_heights_mm = self._trace_chief_rays(field_deg, wavelength_nm)
        is_lost = ~np.isfinite(rays.path_mm[:, 0])
        if not is_lost.any():
            return rays

        index = int(np.argmax(is_lost))
        angle_deg = float(field_deg[index])
        nm = float(wavelength_nm[index])
        pupil_y_mm = float(pupil_heights_mm[index])
        if not math.isfinite(pupil_y_mm):
            pupil_y_mm = self._nearest_chief_height_mm(angle_deg, nm)
        where = self._where_ray_ends(angle_deg, nm, 0.0, pupil_y_mm)
        allowed = "fields whose chief ray reaches the image"
        if self.prescription.field_of_view == "angle_deg":
            allowed += f"; the largest of its file is {self.prescription.field_value:g} degrees"
        got = f"{angle_deg:g}, where the chief ray {where} ({nm:g} nm)"
        raise invalid("field_deg", got, allowed)

    def _nearest_chief_height_mm(self, field_deg: float, wavelength_nm: float) -> float:
        """Return the height in the entrance pupil of the chief ray of the largest smaller field
        that has one, in mm.
        """
        for share in np.linspace(0.95, 0.0, 20):
            (height_mm,) = self._chief_pupil_heights_mm(
                np.array([share * field_deg]), np.array([wavelength_nm])
            )
            if math.isfinite(height_mm):
                return float(height_mm)
        return 0.0

    def _where_ray_ends(
        self, field_deg: float, wavelength_nm: float, pupil_x_mm: float, pupil_y_mm: float
    ) -> str:
        """Return where the ray through a point of the entrance pupil ends, for a message."""
        rays = self._rays_at_entrance_pupil(
            np.array([field_deg]), np.array([[pupil_x_mm]]), np.array([[pupil_y_mm]])
        )
        indices = self._indices(np.array([wavelength_nm]))
        surfaces = self.prescription.surfaces
        for number, surface in enumerate(surfaces):
            if number:
                rays = replace(rays, z=rays.z - surfaces[number - 1].thickness_mm)
            with np.errstate(all="ignore"):
                rays = intersect(rays, surface, indices[number])
                if not np.isfinite(rays.x).all():
                    return f"misses surface {number + 1}"
                rays = refracted(rays, surface, indices[number], indices[number + 1])
            if not np.isfinite(rays.n).all():
                return f"is totally reflected at surface {number + 1}"
        return "does not reach the stop's centre"

    def chief_ray(self, field_deg: ArrayLike, wavelength_nm: Positives) -> ChiefRay:
        """Return the ray through the centre of the stop: its height in the image plane in mm, and
        its angle, both (...).

        field_deg, wavelength_nm : broadcast together to (...)

        Raises PixsimError if a ray misses a surface or is totally reflected, which it names.
        """
        shape, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        rays = self._checked_chief_rays(fields, wavelengths)
        angle = np.degrees(np.arctan2(rays.m[:, 0], rays.n[:, 0]))
        return ChiefRay(rays.y[:, 0].reshape(shape)[()], angle.reshape(shape)[()])

    def opd_waves(
        self,
        field_deg: ArrayLike,
        wavelength_nm: Positives,
        stop_x: _StopPoints,
        stop_y: _StopPoints,
    ) -> Array:
        """Return the optical path difference in waves of its own wavelength, (...); NaN outside the
        stop.

        Rays that a clear aperture stops have one too.

        field_deg, wavelength_nm, stop_x, stop_y : broadcast together to (...); points of the stop
            over its radius

        Raises PixsimError if a ray within the stop misses a surface or is totally reflected, which
        it names.
        """
        shape, fields, wavelengths, x, y = _flattened(
            field_deg=field_deg, wavelength_nm=wavelength_nm, stop_x=stop_x, stop_y=stop_y
        )

        # Where no axis has both conditions and points, every condition has the same points.
        conditions = np.broadcast(np.asarray(field_deg), np.asarray(wavelength_nm)).shape
        points = np.broadcast(np.asarray(stop_x), np.asarray(stop_y)).shape
        outer = (1,) * (len(shape) - len(conditions)) + conditions
        inner = (1,) * (len(shape) - len(points)) + points
        if all(1 in sides for sides in zip(outer, inner, strict=True)):
            _, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
            _, x, y = _flattened(stop_x=stop_x, stop_y=stop_y)
            opd = self._opd(fields, wavelengths, x, y).reshape((*outer, *inner))
            order = [axis + part for axis in range(len(shape)) for part in (0, len(shape))]
            return np.asarray(opd.transpose(order).reshape(shape))[()]

        opd = np.empty(fields.size)
        pairs, which = np.unique(np.stack([fields, wavelengths]), axis=1, return_inverse=True)
        for index, (angle_deg, nm) in enumerate(pairs.T):
            chosen = which.ravel() == index
            opd[chosen] = self._opd(np.array([angle_deg]), np.array([nm]), x[chosen], y[chosen])[0]
        return np.asarray(opd.reshape(shape))[()]

    def _opd(self, field_deg: Array, wavelength_nm: Array, stop_x: Array, stop_y: Array) -> Array:
        """Return OPD of fields and wavelengths (C,) at points (P,) of the stop, (C, P); mirror
        images are traced once.
        """
        opd = np.full((field_deg.size, stop_x.size), np.nan)
        is_inside = np.hypot(stop_x, stop_y) <= _EDGE_TOLERANCE
        half_stop = np.abs(stop_x[is_inside]) + 1j * stop_y[is_inside]
        points, which = np.unique(half_stop, return_inverse=True)
        if not points.size:
            return opd

        traced = self.wavefront(field_deg, wavelength_nm, points.real, points.imag).opd_waves
        is_lost = ~np.isfinite(traced)
        if is_lost.any():
            condition, index = (int(part) for part in np.argwhere(is_lost)[0])
            angle_deg = field_deg[condition]
            point = points[index]
            where = self._where_aimed_ray_ends(
                angle_deg, wavelength_nm[condition], point.real, point.imag
            )
            raise invalid(
                "stop_x and stop_y",
                f"a ray at field_deg = {angle_deg:g} through ({point.real:.3g}, {point.imag:.3g})"
                f" of the stop that {where}",
                "rays that reach the image",
                "Stop the lens down, use a smaller field, or leave these points out.",
            )
        opd[:, is_inside] = traced[:, which.ravel()]
        return opd

    def _where_aimed_ray_ends(
        self, field_deg: float, wavelength_nm: float, stop_x: float, stop_y: float
    ) -> str:
        """Return where the ray to a point of the stop ends, for a message."""
        coefficients = self._pupil_polynomials(np.array([field_deg]), np.array([wavelength_nm]))
        odd_terms, even_terms = _monomials(np.array([stop_x]), np.array([stop_y]))
        pupil_x_mm = float(_polynomial_values(coefficients[..., 0], odd_terms)[0, 0])
        pupil_y_mm = float(_polynomial_values(coefficients[..., 1], even_terms)[0, 0])
        where = self._where_ray_ends(field_deg, wavelength_nm, pupil_x_mm, pupil_y_mm)
        return where if "surface" in where else "no ray in front of the lens reaches"

    def wavefront(
        self,
        field_deg: ArrayLike,
        wavelength_nm: Positives,
        stop_x: _StopPoints,
        stop_y: _StopPoints,
        aimed: float = _AIM_TOLERANCE,
    ) -> Wavefront:
        """Return rays of fields and wavelengths through points of the stop, in the image plane.

        field_deg, wavelength_nm : broadcast together, then in one line, (C,)
        stop_x, stop_y : over the stop's radius, broadcast together, then in one line, (P,)
        aimed : ratio of the distance in which rays meet their points, at most, to the stop's
            radius; a larger one takes less time

        Raises PixsimError if a chief ray does not reach the image.
        """
        _, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        _, x, y = _flattened(stop_x=stop_x, stop_y=stop_y)
        chief = self._checked_chief_rays(fields, wavelengths)
        coefficients = self._pupil_polynomials(fields, wavelengths)
        bases = _monomials(x, y)

        block_size = max(1, _BLOCK // max(x.size, 1))
        starts = range(0, max(fields.size, 1), block_size)
        blocks = [slice(first, first + block_size) for first in starts]
        wavefronts: dict[int, Wavefront] = {}

        def compute(number: int) -> None:
            block = blocks[number]
            wavefronts[number] = self._wavefront_of_block(
                fields[block],
                wavelengths[block],
                x,
                y,
                coefficients=coefficients[block],
                bases=bases,
                chief=_rays_slice(chief, block),
                tolerance=aimed,
            )

        size = fields.size * x.size * len(self.prescription.surfaces)
        in_threads(compute, range(len(blocks)), size)
        if len(blocks) == 1:
            return wavefronts[0]

        in_order = [wavefronts[number] for number in range(len(blocks))]
        names = [part.name for part in dataclass_fields(Wavefront)]
        return Wavefront(
            **{name: np.concatenate([getattr(part, name) for part in in_order]) for name in names}
        )

    def _wavefront_of_block(
        self,
        field_deg: Array,
        wavelength_nm: Array,
        stop_x: Array,
        stop_y: Array,
        *,
        coefficients: Array,
        bases: _Bases,
        chief: Rays,
        tolerance: float,
    ) -> Wavefront:
        """Return the wavefront of fields and wavelengths (C,) through points of the stop (P,).

        coefficients : of `_pupil_polynomials`, (C, terms, 2)
        bases : the monomials at the points of the stop
        chief : chief rays in the image plane, (C, 1)
        tolerance : distance from the points of the stop, over its radius
        """
        pupil_x_mm, pupil_y_mm = (
            _polynomial_values(coefficients[..., axis], basis) for axis, basis in enumerate(bases)
        )
        rays, stop_x_mm, stop_y_mm = self._trace_to_image(
            field_deg, wavelength_nm, pupil_x_mm, pupil_y_mm
        )

        # Where the polynomial is not good enough, its derivatives are.
        stop_mm = self.stop_semi_diameter_mm
        miss = np.maximum(
            np.abs(stop_x_mm / stop_mm - stop_x), np.abs(stop_y_mm / stop_mm - stop_y)
        )
        is_aimed = miss <= tolerance
        if not is_aimed.all():
            inverse_jacobian = np.empty((*pupil_x_mm.shape, 2, 2))
            for variable, slopes in enumerate(_monomial_slopes(stop_x, stop_y)):
                for axis, basis in enumerate(slopes):
                    slope = _polynomial_values(coefficients[..., axis], basis)
                    inverse_jacobian[..., axis, variable] = slope
            aimed_x_mm, aimed_y_mm = self._aimed_points(
                field_deg,
                wavelength_nm,
                stop_x,
                stop_y,
                pupil_x_mm=pupil_x_mm,
                pupil_y_mm=pupil_y_mm,
                inverse_jacobian=inverse_jacobian,
                tolerance=tolerance,
            )
            pupil_x_mm = np.where(is_aimed, pupil_x_mm, aimed_x_mm)
            pupil_y_mm = np.where(is_aimed, pupil_y_mm, aimed_y_mm)
            rays, stop_x_mm, stop_y_mm = self._trace_to_image(
                field_deg, wavelength_nm, pupil_x_mm, pupil_y_mm
            )
        return self._wavefront_at_image(rays, stop_x_mm, stop_y_mm, chief, field_deg, wavelength_nm)

    def unaimed_wavefront(
        self, field_deg: ArrayLike, wavelength_nm: Positives, x_mm: ArrayLike, y_mm: ArrayLike
    ) -> Wavefront:
        """Return rays through points of the paraxial entrance pupil at the primary wavelength, as
        programs without aiming do.

        The chief ray is the one through its centre; off the axis it does not meet the centre of the
        stop.

        field_deg, wavelength_nm : broadcast together, then in one line, (C,)
        x_mm, y_mm : broadcast together, then in one line, (P,)

        Raises PixsimError for a field of 90° and more.
        """
        _, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        _, x, y = _flattened(x_mm=x_mm, y_mm=y_mm)
        centre = np.zeros((1, 1))
        chief, _, _ = self._trace_to_image(fields, wavelengths, centre, centre)
        rays, stop_x_mm, stop_y_mm = self._trace_to_image(fields, wavelengths, x[None], y[None])
        return self._wavefront_at_image(rays, stop_x_mm, stop_y_mm, chief, fields, wavelengths)

    def _wavefront_at_image(
        self,
        rays: Rays,
        stop_x_mm: Array,
        stop_y_mm: Array,
        chief: Rays,
        field_deg: Array,
        wavelength_nm: Array,
    ) -> Wavefront:
        """Return the wavefront of rays (C, P) in the image plane, which met the stop at these
        points, against chief rays (C, 1).
        """
        off_x_mm = rays.x
        off_y_mm = rays.y - chief.y

        # From the image plane back to the reference sphere, less the radius; the radius is negative
        # if the pupil lies behind.
        pupil_from_image_mm = self._exit_pupil_from_image_mm
        radius_mm = -np.copysign(np.hypot(chief.y, pupil_from_image_mm), pupil_from_image_mm)
        back_mm = off_x_mm * rays.l + off_y_mm * rays.m
        square_mm2 = back_mm * back_mm - off_x_mm * off_x_mm - off_y_mm * off_y_mm
        if math.isfinite(pupil_from_image_mm):
            with np.errstate(all="ignore"):
                root_mm = np.copysign(np.sqrt(radius_mm * radius_mm + square_mm2), radius_mm)
                back_mm = back_mm + square_mm2 / (radius_mm + root_mm)

        index = np.asarray(self._indices(wavelength_nm)[-1])
        path_difference_mm = chief.path_mm - rays.path_mm + index * back_mm
        passed = rays.passed
        if self.vignetting:
            height = self._relative_height_at_stop(field_deg, stop_x_mm, stop_y_mm)
            passed = passed & (height <= _EDGE_TOLERANCE)
        return Wavefront(
            opd_waves=path_difference_mm / (_MM_PER_NM * wavelength_nm[:, None]),
            passed=passed,
            x_mm=off_x_mm,
            y_mm=off_y_mm,
            cosines=np.stack([rays.l, rays.m], axis=-1),
            stop_x=stop_x_mm / self.stop_semi_diameter_mm,
            stop_y=stop_y_mm / self.stop_semi_diameter_mm,
            chief_y_mm=chief.y[:, 0],
            chief_cosine=chief.m[:, 0],
        )

    # Light at a point of the image

    def _relative_height_at_stop(self, field_deg: Array, x_mm: Array, y_mm: Array) -> Array:
        """Return how far from its middle light of fields (C,) is in the stop, over what
        `vignetting` lets pass there, (C, P).
        """
        table_deg, *columns = np.array(self.vignetting).T
        centre_mm, across_mm, along_mm = (
            np.interp(np.abs(field_deg), table_deg, column)[:, None] for column in columns
        )
        centre_mm = centre_mm * np.where(field_deg < 0, -1.0, 1.0)[:, None]
        return np.asarray(np.hypot(x_mm / across_mm, (y_mm - centre_mm) / along_mm))

    def _max_relative_height(
        self,
        field_deg: Array,
        height_mm: Array,
        wavelength_nm: Array,
        cosine_x: Array,
        cosine_y: Array,
    ) -> Array:
        """Return how far from the axis light of some directions is at its widest place, over what
        may pass there, (C, P).

        1 at the edge of the stop or of a clear aperture; infinite for a ray that misses a surface
        or is totally reflected.

        field_deg, height_mm : (C,) of the image point
        cosine_x, cosine_y : (C, P), directions of the light in image space, which is traced
            backwards
        """
        surfaces = reversed_surfaces(self.prescription.surfaces)
        indices = self._indices(wavelength_nm)[::-1]
        stop = len(surfaces) - 1 - self.prescription.stop

        with np.errstate(invalid="ignore"):
            cosine_z = np.sqrt(1 - cosine_x * cosine_x - cosine_y * cosine_y)
        image_x_mm = np.zeros((1, 1))
        image_z_mm = np.full((1, 1), -self.prescription.surfaces[-1].thickness_mm)
        start = rays_from(
            image_x_mm, height_mm[:, None], image_z_mm, -cosine_x, -cosine_y, cosine_z
        )

        widest = np.zeros(cosine_x.shape)
        traced = trace(start, surfaces, indices)
        for number, (surface, rays) in enumerate(zip(surfaces, traced, strict=True)):
            limits_mm = [self.stop_semi_diameter_mm] if number == stop else []
            if surface.clips and surface.semi_diameter_mm is not None:
                limits_mm.append(surface.semi_diameter_mm)
            if limits_mm:
                widest = np.maximum(widest, np.hypot(rays.x, rays.y) / min(limits_mm))
            if number == stop and self.vignetting:
                at_stop = self._relative_height_at_stop(field_deg, rays.x, rays.y)
                widest = np.maximum(widest, at_stop)
        return np.where(np.isfinite(rays.n) & np.isfinite(widest), widest, np.inf)

    def outline(
        self, field_deg: ArrayLike, wavelength_nm: Positives, spokes: int = _SPOKES_OF_OUTLINE
    ) -> Outline:
        """Return the outline of the directions that light comes from at the chief rays' image
        points.

        The directions are those whose rays, traced backwards from that point, pass the stop and all
        clear apertures.

        field_deg, wavelength_nm : broadcast together, then in one line, (C,)
        spokes : number of points of the outline, a multiple of 4

        Raises PixsimError if a chief ray does not reach the image.
        """
        if spokes % 4 or not 0 < spokes <= _MAX_SPOKES:
            raise invalid("spokes", spokes, f"a multiple of 4, at most {_MAX_SPOKES}")
        _, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        return self._outline(fields, wavelengths, spokes)

    def _outline(self, field_deg: Array, wavelength_nm: Array, spokes: int) -> Outline:
        """Return `outline` of fields and wavelengths in one line, (C,)."""
        chief = self._checked_chief_rays(field_deg, wavelength_nm)
        height_mm = chief.y[:, 0]
        chief_cosine = chief.m[:, 0]
        centre = self._middle_of_light(field_deg, wavelength_nm, height_mm, chief_cosine)
        is_dark = np.isnan(centre)
        centre = np.where(is_dark, chief_cosine, centre)

        # The half with x > 0; the other one is its mirror image.
        angle = (np.arange(spokes // 2) + 0.5) * (2 * np.pi / spokes) - np.pi / 2
        cosine = np.cos(angle)
        sine = np.sin(angle)

        def excess(radius: Array) -> Array:
            """Return how far outside light is in the lens, below 0 where it passes."""
            count = radius.shape[1]
            cosine_x = radius * cosine[:count]
            cosine_y = centre[:, None] + radius * sine[:count]
            height = self._max_relative_height(
                field_deg, height_mm, wavelength_nm, cosine_x, cosine_y
            )
            return height - 1

        horizon = -centre[:, None] * sine + np.sqrt(1 - (centre[:, None] * cosine) ** 2)
        low, below, high, above = self._edge_brackets(excess, horizon)
        radius = np.where(is_dark[:, None], 0.0, _root(excess, low, below, high, above))
        return Outline(
            centre=np.stack([np.zeros_like(centre), centre], axis=-1),
            radius=np.concatenate([radius, radius[:, ::-1]], axis=1),
            chief_cosine=chief_cosine,
        )

    def _edge_brackets(
        self, excess: Callable[[Array], Array], horizon: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return radii (C, spokes) on both sides of the first edge of the light, and the excess
        there: low, its excess, high, its excess.

        The search goes outwards in steps to the first edge, which a small step predicts: beyond it,
        strong aspheres may let rays through again.

        excess : radii (C, 1 or spokes) -> above 0 outside of the light
        horizon : radii of directions in the image plane, (C, spokes)
        """
        low = np.zeros(horizon.shape)
        below = np.broadcast_to(np.minimum(excess(low[:, :1]), 0.0), horizon.shape)

        near = np.minimum(horizon, _OUTLINE_START / self.first_order(self.primary_nm).f_number)
        with np.errstate(all="ignore"):
            edge = -near * below / (excess(near) - below)
        edge = np.where((edge > near) & (edge < horizon), edge, near)

        high = _OUTLINE_STEPS[0] * edge
        above = excess(high)
        further = _OUTLINE_STEPS[-1] - _OUTLINE_STEPS[-2]
        far_steps = np.arange(_OUTLINE_STEPS[-1], _OUTLINE_REACH, further)[1:]
        for share in (*_OUTLINE_STEPS[1:], *far_steps):
            is_inside = (above <= 0) & (high < horizon)
            if not is_inside.any():
                break
            low = np.where(is_inside, high, low)
            below = np.where(is_inside, above, below)
            high = np.where(is_inside, np.minimum(horizon, share * edge), high)
            above = np.where(is_inside, excess(high), above)
        return low, below, high, above

    def _middle_of_light(
        self, field_deg: Array, wavelength_nm: Array, height_mm: Array, chief_cosine: Array
    ) -> Array:
        """Return a direction cosine along y from which light reaches each image point (C,); NaN
        where there is none.
        """
        grid = np.linspace(-0.95, 0.95, 21)
        waves = self.wavefront(field_deg, wavelength_nm, np.zeros(grid.size), grid)
        ray_cosines = np.where(np.isfinite(waves.opd_waves), waves.cosines[..., 1], np.nan)
        passed = np.where(waves.passed, ray_cosines, np.nan)
        middle = (np.fmin.reduce(passed, axis=1) + np.fmax.reduce(passed, axis=1)) / 2

        # The middle, where it passes; else the direction that passes best, or nearly passes.
        candidates = np.concatenate([middle[:, None], chief_cosine[:, None], ray_cosines], axis=1)
        width = self._max_relative_height(
            field_deg, height_mm, wavelength_nm, np.zeros_like(candidates), candidates
        )
        width[:, 2:] += np.where(waves.passed, 1e-3, 1.0)
        best = np.argmin(width, axis=1)
        conditions = np.arange(best.size)
        chosen = np.where(width[:, 0] < 1, middle, candidates[conditions, best])
        min_width = width[conditions, best]

        # What is left of a pupil may lie between two of the rays: the width has one minimum along a
        # line.
        spread = np.ptp(np.where(np.isfinite(ray_cosines), ray_cosines, chosen[:, None]), axis=1)
        for refinement in range(1, _MIDDLE_STEPS + 1):
            is_dark = ~(min_width < 1) & np.isfinite(chosen)
            if not is_dark.any():
                break
            step = spread / (grid.size - 1) ** refinement
            finer = (chosen[:, None] + step[:, None] * np.linspace(-1, 1, grid.size))[is_dark]
            finer_width = self._max_relative_height(
                field_deg[is_dark],
                height_mm[is_dark],
                wavelength_nm[is_dark],
                np.zeros_like(finer),
                finer,
            )
            best = np.argmin(finer_width, axis=1)
            conditions = np.arange(best.size)
            chosen[is_dark] = finer[conditions, best]
            min_width[is_dark] = finer_width[conditions, best]
        return np.where(min_width < 1, chosen, np.nan)

    def projected_solid_angle_sr(self, field_deg: ArrayLike, wavelength_nm: Positives) -> Array:
        """Return irradiance over the scene's radiance at image points, (...), in sr, without losses
        in the glass.

        It is the area, in direction cosines, of the directions at the chief ray's image point whose
        rays, traced backwards, pass the stop and all clear apertures. For a thin lens it is
        `irradiance_factor` (Foote, 1915).

        field_deg, wavelength_nm : broadcast together to (...)

        Raises PixsimError if a chief ray does not reach the image.
        """
        shape, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        has_corners = bool(self.vignetting) or any(
            surface.clips for surface in self.prescription.surfaces
        )
        spokes = _SPOKES_OF_OUTLINE if has_corners else _SMOOTH_SPOKES
        area = self._outline(fields, wavelengths, spokes).area
        return np.asarray(area.reshape(shape)[()])

    def relative_illumination(
        self, field_deg: ArrayLike, wavelength_nm: Positive | None = None
    ) -> Array:
        """Return irradiance on the image relative to the irradiance on the axis, (...), for a scene
        of uniform radiance.

        wavelength_nm : the primary one by default

        Raises PixsimError as `projected_solid_angle_sr` does.
        """
        wavelength = self.primary_nm if wavelength_nm is None else wavelength_nm
        return np.asarray(
            self.projected_solid_angle_sr(field_deg, wavelength)
            / self.projected_solid_angle_sr(0.0, wavelength)
        )

    def directions(
        self,
        field_deg: ArrayLike,
        wavelength_nm: Positives,
        azimuth_deg: Finites,
        rings: int = 24,
        spokes: int = 48,
    ) -> Directions:
        """Return the directions of the light at image points (...), as a microlens sees them.

        field_deg, wavelength_nm, azimuth_deg : broadcast together to (...); azimuths of the image
            points from the axis, from +x (columns) to +y (rows)
        rings, spokes : numbers of quadrature nodes within the outline; spokes a multiple of 4

        Raises PixsimError if no light reaches one of the points.
        """
        if not 0 < rings <= _MAX_SPOKES:
            raise invalid("rings", rings, f"1 to {_MAX_SPOKES}")
        shape, fields, wavelengths, azimuths_deg = _flattened(
            field_deg=field_deg, wavelength_nm=wavelength_nm, azimuth_deg=azimuth_deg
        )
        outline = self.outline(fields, wavelengths, spokes)

        # Gauss-Legendre in radius², equal steps in angle; the frame of the field turns with it.
        node, share = np.polynomial.legendre.leggauss(rings)
        radius = np.sqrt((1 + node) / 2)[:, None] * outline.radius[:, None, :]
        sideways = outline.centre[:, 0, None, None] + radius * np.cos(outline.angle)
        outward = outline.centre[:, 1, None, None] + radius * np.sin(outline.angle)
        sideways = sideways.reshape(azimuths_deg.size, -1)
        outward = outward.reshape(azimuths_deg.size, -1)
        weight = np.broadcast_to(share[:, None] * outline.radius[:, None, :] ** 2, radius.shape)

        cosine = np.cos(np.radians(azimuths_deg))[:, None]
        sine = np.sin(np.radians(azimuths_deg))[:, None]
        cosine_x = outward * cosine + sideways * sine
        cosine_y = outward * sine - sideways * cosine
        chief = outline.chief_cosine[:, None] * np.concatenate([cosine, sine], axis=1)
        return Directions(
            cosines=np.stack([cosine_x, cosine_y], axis=-1).reshape(*shape, -1, 2),
            weight=weight.reshape(*shape, -1),
            chief_cosines=chief.reshape(*shape, 2),
        )

    def ray_points(
        self, field_deg: float, wavelength_nm: Positive, stop_x: _StopPoints, stop_y: _StopPoints
    ) -> Array:
        """Return where rays meet the surfaces and the image plane, (P, surfaces + 1, 3), in mm from
        the first vertex: x, y, z.

        stop_x, stop_y : over the stop's radius, broadcast together, then in one line, (P,); NaN for
            rays that are lost

        Raises PixsimError if the chief ray does not reach the image.
        """
        _, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        self._checked_chief_rays(fields, wavelengths)
        _, x, y = _flattened(stop_x=stop_x, stop_y=stop_y)
        coefficients = self._pupil_polynomials(fields, wavelengths)
        pupil_x_mm, pupil_y_mm = (
            _polynomial_values(coefficients[..., axis], basis)
            for axis, basis in enumerate(_monomials(x, y))
        )

        surfaces = self.prescription.surfaces
        indices = self._indices(wavelengths)
        start = self._rays_at_entrance_pupil(fields, pupil_x_mm, pupil_y_mm)
        points = []
        vertex_mm = 0.0
        for surface, rays in zip(surfaces, trace(start, surfaces, indices), strict=True):
            points.append([rays.x[0], rays.y[0], rays.z[0] + vertex_mm])
            vertex_mm += surface.thickness_mm
        rays = at_plane(rays, surfaces[-1].thickness_mm, indices[-1])
        points.append([rays.x[0], rays.y[0], rays.z[0] + vertex_mm])
        return np.array(points).transpose(2, 0, 1)

    # What a lens designer asks for

    @cached_property
    def paraxial_height_mm(self) -> float:
        """Paraxial image height over the tangent of the field angle at the primary wavelength, in
        mm.

        The focal length for an object at infinity; for another, the magnification times the
        object's distance.
        """
        if math.isinf(self.object_distance_mm):
            return self.first_order(self.primary_nm).focal_length_mm
        indices = self._indices(np.array([self.primary_nm]))
        from_vertex_mm = self.object_distance_mm - self._entrance_pupil_mm
        _, angle = paraxial(
            self.prescription.surfaces, indices, np.array([from_vertex_mm]), np.array([1.0])
        )
        return float(-self.object_distance_mm / angle[0])

    @cached_property
    def image_scale_mm(self) -> float:
        """Chief ray's height in the image plane over the tangent of a very small field angle, at
        the primary wavelength, in mm.

        It differs from `paraxial_height_mm` where the image plane is not the paraxial focus.
        """
        indices = self._indices(np.array([self.primary_nm]))
        surfaces = self.prescription.surfaces
        at_first_vertex = -self._entrance_pupil_mm
        height, angle = paraxial(surfaces, indices, np.array([at_first_vertex]), np.array([1.0]))
        in_image_plane = height + surfaces[-1].thickness_mm / indices[-1] * angle
        return float(in_image_plane.flat[0])

    @property
    def working_f_number(self) -> float:
        """Half the reciprocal of the image's paraxial numerical aperture, at the primary
        wavelength, a number.

        The f-number for an object at infinity. Light from a nearer object converges less.
        """
        return abs(self.paraxial_height_mm) / self.entrance_pupil_diameter_mm

    def distortion(self, field_deg: ArrayLike, wavelength_nm: Positive | None = None) -> Array:
        """Return the chief ray's height over `image_scale_mm` times the field's tangent, minus 1, a
        ratio (...); 0 on the axis.

        The reference is the image of a very small field in the same plane, so that defocus is no
        distortion.

        wavelength_nm : of the chief ray, the primary one by default; the reference always has the
            primary one

        Raises PixsimError as `chief_ray` does.
        """
        angle_deg = np.asarray(field_deg, float)
        nm = self.primary_nm if wavelength_nm is None else wavelength_nm
        height_mm = self.chief_ray(angle_deg, nm).height_mm
        ideal_mm = self.image_scale_mm * np.tan(np.radians(angle_deg))
        ratio = np.divide(height_mm, ideal_mm, out=np.ones(np.shape(ideal_mm)), where=ideal_mm != 0)
        return np.asarray(ratio - 1)[()]

    def foci_mm(self, field_deg: ArrayLike, wavelength_nm: Positives) -> tuple[Array, Array]:
        """Return the tangential and the sagittal focus of rays near the chief ray, mm behind the
        image plane, both (...).

        field_deg, wavelength_nm : broadcast together to (...)

        Raises PixsimError as `chief_ray` does.
        """
        shape, fields, wavelengths = _flat_conditions(field_deg, wavelength_nm)
        # of the stop's radius: third-order aberrations shift the focus by 1e-6 of what they do at
        # its edge
        near = 1e-3
        waves = self.wavefront(
            fields, wavelengths, np.array([0.0, 0.0, near]), np.array([near, -near, 0.0])
        )

        cosine_z = np.sqrt(1 - np.square(waves.cosines).sum(axis=-1))
        slope_x = waves.cosines[..., 0] / cosine_z
        slope_y = waves.cosines[..., 1] / cosine_z
        tangential_mm = -(waves.y_mm[:, 0] - waves.y_mm[:, 1]) / (slope_y[:, 0] - slope_y[:, 1])
        sagittal_mm = -waves.x_mm[:, 2] / slope_x[:, 2]
        return (
            np.asarray(tangential_mm.reshape(shape)[()]),
            np.asarray(sagittal_mm.reshape(shape)[()]),
        )

    def field_of_height(self, height_mm: float, wavelength_nm: Positive) -> float:
        """Return the number of degrees of the field angle whose chief ray has this height in the
        image plane.

        Raises PixsimError if no field has: the point lies beyond the image circle.
        """
        fields, heights_mm = self._fields_with_chief_rays(wavelength_nm)
        target_mm = abs(height_mm)
        above = int(np.searchsorted(heights_mm, target_mm))
        if above == heights_mm.size:
            expected = f"at most {heights_mm[-1]:.4g}, where the chief rays of the lens end"
            raise invalid("height_mm", f"{height_mm:g}, beyond the image circle", expected)
        if above == 0:
            return 0.0

        nm = np.array([wavelength_nm])

        def excess_mm(field_deg: Array) -> Array:
            rays, _ = self._trace_chief_rays(field_deg, nm)
            return rays.y[:, 0] - target_mm

        bracket = slice(above - 1, above + 1)
        low, high = fields[bracket, None]
        excess_low, excess_high = heights_mm[bracket, None] - target_mm
        root_deg = _root(excess_mm, low, excess_low, high, excess_high)
        return math.copysign(float(root_deg[0]), height_mm)

    def image_circle_mm(self, wavelength_nm: Positive) -> float:
        """Return the largest image height that light reaches, in mm, to about 1 % of the field
        angle.
        """
        fields, heights_mm = self._fields_with_chief_rays(wavelength_nm)
        outline = self._outline(fields, np.full(fields.size, wavelength_nm), 32)
        illuminated_mm = heights_mm[outline.area > 0]
        return float(illuminated_mm[-1]) if illuminated_mm.size else 0.0

    def _fields_with_chief_rays(self, wavelength_nm: float) -> tuple[Array, Array]:
        """Return fields in degrees from the axis on that have a chief ray, and their image heights,
        which grow, in mm.
        """
        fields = np.linspace(0.0, _STEEPEST_DEG, _FIELD_COUNT)
        rays, _ = self._trace_chief_rays(fields, np.full(fields.size, wavelength_nm))
        growing = np.concatenate([[True], np.diff(rays.y[:, 0]) > 0])
        count = fields.size if growing.all() else int(np.argmin(growing))
        return fields[:count], rays.y[:count, 0]

    def _plain_indices(self, wavelength_nm: float) -> list[float]:
        """Return the index in front of the lens and behind each surface."""
        return [
            float(np.asarray(index).flat[0]) for index in self._indices(np.array([wavelength_nm]))
        ]

    def fresnel_transmittance(self, wavelength_nm: Positive) -> float:
        """Return the fraction of light on the axis that uncoated surfaces let through, for
        information.
        """
        return math.prod(
            4 * before * behind / (before + behind) ** 2
            for before, behind in pairwise(self._plain_indices(wavelength_nm))
        )

    def ghosts(
        self, wavelength_nm: Positive, reflectance: Reflectance | None = None
    ) -> list[Ghost]:
        """Return the light on the axis that each pair of surfaces reflects twice, the largest share
        first.

        reflectance : share of the light that coated surfaces in air reflect; bare glass by default
        """
        # The marginal ray at the first vertex.
        height_mm = self.entrance_pupil_diameter_mm / 2
        slope = 0.0
        if math.isfinite(self.object_distance_mm):
            slope = height_mm / self.object_distance_mm
            height_mm -= slope * self._entrance_pupil_mm

        indices = self._plain_indices(wavelength_nm)
        surfaces = self.prescription.surfaces
        return find_ghosts(surfaces, indices, reflectances(indices, reflectance), height_mm, slope)

    # Changed lenses

    def scaled(self, factor: Positive) -> Lens:
        """Return the lens with every length times `factor`, but the object's distance.

        factor : a ratio of lengths
        """
        ellipses = tuple(
            (field_deg, factor * centre_mm, factor * across_mm, factor * along_mm)
            for field_deg, centre_mm, across_mm, along_mm in self.vignetting
        )
        return replace(
            self,
            prescription=self.prescription.scaled(factor),
            entrance_pupil_diameter_mm=factor * self.entrance_pupil_diameter_mm,
            vignetting=ellipses,
        )

    def stopped_down(self, f_number: FNumberOrPinhole) -> Lens:
        """Return the lens with a smaller stop. Raises PixsimError, which names the widest f-number,
        for a larger one.
        """
        first_order = self.first_order(self.primary_nm)
        if not first_order.f_number * (1 - _F_NUMBER_ROUNDING) <= f_number < math.inf:
            raise invalid(
                "f_number",
                f"{f_number:g}",
                f"at least {first_order.f_number:.6g}, the widest of '{self.prescription.name}',"
                " and finite",
            )
        pupil_mm = first_order.focal_length_mm / f_number
        return replace(
            self, entrance_pupil_diameter_mm=min(pupil_mm, first_order.entrance_pupil_diameter_mm)
        )

    def refocused(
        self,
        focus: Literal["paraxial", "axis", "field"] = "axis",
        object_distance_mm: AnyDistance = math.inf,
        field_deg: float | None = None,
        wavelength_nm: Positive | None = None,
    ) -> Lens:
        """Return the lens with its image plane moved to the focus of an object plane.

        focus : "paraxial" at the primary wavelength; "axis", of least rms wavefront on the axis
            over the file's wavelengths; "field", the same over the picture up to `field_deg`,
            without the tilts, which move details and do not blur them
        object_distance_mm : of the object plane from the entrance pupil
        field_deg : half the diagonal of the picture; the lens's largest field by default
        wavelength_nm : of the focus; by default the primary one, or all of the file

        Raises PixsimError if there is no real image, if rays do not reach it, or if a glass is not
        known at the wavelength.
        """
        lens = replace(self, object_distance_mm=object_distance_mm)
        lens = lens._with_image_plane_moved(lens._paraxial_focus_mm(wavelength_nm))
        if focus == "paraxial":
            return lens

        largest_deg = 0.0
        if focus == "field":
            largest_deg = self.max_field_deg if field_deg is None else field_deg
        for _ in range(2):  # the second step corrects the first one, where it was large
            shift_mm = lens._best_focus_mm(largest_deg, wavelength_nm)
            lens = lens._with_image_plane_moved(shift_mm)
        return lens

    def _with_image_plane_moved(self, shift_mm: float) -> Lens:
        """Return the lens with its image plane moved. Raises PixsimError if it would lie in front
        of the last surface.
        """
        *others, last = self.prescription.surfaces
        image_mm = last.thickness_mm + shift_mm
        if not 0 <= image_mm < math.inf:
            raise invalid(
                "object_distance_mm",
                f"{self.object_distance_mm:g}, whose image is {image_mm:.4g} mm behind the last"
                " surface",
                "a distance with a real image",
                "Move the object away from the lens.",
            )
        surfaces = (*others, replace(last, thickness_mm=image_mm))
        return replace(self, prescription=replace(self.prescription, surfaces=surfaces))

    def _paraxial_focus_mm(self, wavelength_nm: float | None = None) -> float:
        """Return where the object plane is in focus, in mm behind the image plane."""
        surfaces = self.prescription.surfaces
        indices = self._indices(np.array([wavelength_nm or self.primary_nm]))

        # A ray parallel to the axis, or from the object's point on the axis.
        height_mm = np.array([1.0])
        angle = np.array([0.0])
        if math.isfinite(self.object_distance_mm):
            height_mm = np.array([self.object_distance_mm - self._entrance_pupil_mm])
            angle = np.array([1.0])
        height_mm, angle = paraxial(surfaces, indices, height_mm, angle)
        back_mm = -height_mm / angle * np.asarray(indices[-1]).ravel()
        return float(back_mm[0]) - surfaces[-1].thickness_mm

    def _best_focus_mm(self, largest_deg: float, wavelength_nm: float | None = None) -> float:
        """Return the shift of the image plane in mm that leaves the least mean square of the
        wavefront.

        Over points of the stop that pass, the file's wavelengths or one alone, and the picture's
        area up to a field; in it, W changes by ∂W/∂z = n (N - N_chief - (L, M - M_chief)·(chief's
        slope))/λ, and a tilt goes with the picture.
        """
        # Gauss-Legendre over the area of the picture, equal rings and angles over half of the stop.
        node, share = np.polynomial.legendre.leggauss(4)
        if not largest_deg:
            node = np.zeros(1)
            share = np.array([2.0])
        tangents = math.tan(math.radians(largest_deg)) * np.sqrt((1 + node) / 2)
        nm = self.prescription.wavelengths_nm if wavelength_nm is None else (wavelength_nm,)
        fields = np.repeat(np.degrees(np.arctan(tangents)), len(nm))
        weights = np.repeat(share / 2, len(nm))
        wavelengths = np.tile(np.array(nm), node.size)
        radius = np.sqrt((np.arange(8) + 0.5) / 8)[:, None]
        angle = (np.arange(24) + 0.5) * (np.pi / 24) - np.pi / 2
        x = (radius * np.cos(angle)).ravel()
        y = (radius * np.sin(angle)).ravel()

        waves = self.wavefront(fields, wavelengths, x, y)
        moved = self._with_image_plane_moved(_FOCUS_STEP_MM).wavefront(fields, wavelengths, x, y)
        change_waves = moved.opd_waves - waves.opd_waves

        # Least squares of W + shift ∂W/∂z, both without piston, and without tilt off the axis.
        top = bottom = 0.0
        is_passed = waves.passed & np.isfinite(waves.opd_waves) & np.isfinite(change_waves)
        for index in range(fields.size):
            passed = is_passed[index]
            cosines = waves.cosines[index, passed, 1]
            columns = [np.ones(cosines.size)]
            if largest_deg:
                columns.append(cosines)
            basis = np.stack(columns, axis=1)
            if cosines.size <= basis.shape[1]:
                continue

            opd = waves.opd_waves[index, passed]
            slope = change_waves[index, passed] / _FOCUS_STEP_MM
            both = np.stack([opd, slope], axis=1)
            both = both - basis @ np.linalg.lstsq(basis, both, rcond=None)[0]
            top += weights[index] * float((both[:, 0] * both[:, 1]).mean())
            bottom += weights[index] * float((both[:, 1] ** 2).mean())
        if not bottom:
            raise invalid(
                self._label, "no rays that reach the image", "a lens that lets light through"
            )
        return -top / bottom


@dataclass(frozen=True)
class Outline:
    """Directions of light at image points (C,): star-shaped areas of direction cosines.

    centre : (C, 2), a direction cosine of light along x and y, with the image point on +y
    radius : (C, spokes), from the centre to the edge; 0 where no light comes
    chief_cosine : (C,), of the chief ray along y
    """

    centre: Array
    radius: Array
    chief_cosine: Array

    @property
    def angle(self) -> Array:
        """Azimuths of the spokes in radians from +x towards +y, (spokes,): from -y by way of +x and
        +y round to -y.
        """
        count = self.radius.shape[1]
        return np.asarray((np.arange(count) + 0.5) * (2 * np.pi / count) - np.pi / 2)

    @property
    def area(self) -> Array:
        """Area in direction cosines, (C,), in sr."""
        return np.asarray(np.square(self.radius).mean(axis=1) * np.pi)


def _root(
    function: Callable[[Array], Array], low: Array, below: Array, high: Array, above: Array
) -> Array:
    """Return roots (...) of a function: regula falsi of Illinois; halving where it is infinite.

    low, high : brackets; where there is no sign change, an end of the last bracket is returned
    below, above : values there, at most 0 and above 0
    """
    side = np.zeros(low.shape)
    root = low
    value = below
    for _ in range(_ROOT_STEPS):
        is_open = (high - low > _ROOT_WIDTH) & (np.abs(value) > _ROOT_VALUE)
        if not is_open.any():
            break

        with np.errstate(all="ignore"):
            secant = low - below * (high - low) / (above - below)
        trial = np.where(np.isfinite(above), secant, (low + high) / 2)
        # Closed brackets stay, whatever their neighbours do.
        root = np.where(is_open, np.clip(trial, low, high), root)
        value = np.where(is_open, function(root), value)

        # The end that stays twice counts half.
        inside = is_open & (value <= 0)
        outside = is_open & ~(value <= 0)
        above = np.where(inside & (side > 0), above / 2, above)
        below = np.where(outside & (side < 0), below / 2, below)
        low = np.where(inside, root, low)
        below = np.where(inside, value, below)
        high = np.where(outside, root, high)
        above = np.where(outside, value, above)
        side = np.where(inside, 1.0, np.where(outside, -1.0, side))
    return root


def _rays_slice(rays: Rays, rows: slice) -> Rays:
    """Return some of the rays along their first axis."""
    names = [part.name for part in dataclass_fields(Rays)]
    return Rays(**{name: getattr(rays, name)[rows] for name in names})


def _flat_conditions(
    field_deg: ArrayLike, wavelength_nm: ArrayLike
) -> tuple[tuple[int, ...], Array, Array]:
    """Return the shape that fields and wavelengths broadcast to, and both in one line."""
    shape, fields, wavelengths = _flattened(field_deg=field_deg, wavelength_nm=wavelength_nm)
    is_allowed = np.abs(fields) < 90
    if not is_allowed.all():
        got = f"{fields[np.argmin(is_allowed)]:g}"
        raise invalid("field_deg", got, "above -90 and below 90 degrees")
    return shape, fields, wavelengths


def _flattened(**parts: ArrayLike) -> tuple[Any, ...]:
    """Return the shape that arguments broadcast to, and each in one line of finite numbers; their
    names are for messages.
    """
    check_broadcast(**{name: np.shape(value) for name, value in parts.items()})
    arrays = {name: np.asarray(value, float) for name, value in parts.items()}
    for name, array in arrays.items():
        is_finite = np.isfinite(array)
        if not array.size:
            raise invalid(name, "an empty array", "finite numbers, at least one")
        if not is_finite.all():
            got = f"{array.flat[np.argmin(is_finite)]:g}"
            raise invalid(name, got, "finite numbers, at least one")
    same_shape = np.broadcast_arrays(*arrays.values())
    return same_shape[0].shape, *(array.ravel() for array in same_shape)


# Of the monomials x^i y^j odd in x, and even in x.
_EXPONENTS = tuple(
    np.array([(i, j) for i in range(start, _DEGREE + 1, 2) for j in range(_DEGREE + 1 - i)]).T
    for start in (1, 0)
)


def _monomials(x: Array, y: Array) -> _Bases:
    """Return the monomials odd in x, and even in x, at points (P,), both (P, terms)."""
    powers_x = _powers(x)
    powers_y = _powers(y)
    odd_terms, even_terms = ((powers_x[i] * powers_y[j]).T for i, j in _EXPONENTS)
    return odd_terms, even_terms


def _powers(values: Array) -> Array:
    """Return the powers 0 to `_DEGREE` of values (P,), (degree + 1, P)."""
    return np.cumprod([np.ones_like(values), *[values] * _DEGREE], axis=0)


def _polynomial_values(terms: Array, basis: Array) -> Array:
    """Return polynomials (C, P) of coefficients (C, terms), of which the first are used, at the
    monomials (P, terms).
    """
    total = np.zeros((len(terms), len(basis)))
    for index, monomial in enumerate(basis.T):
        total += terms[:, index, None] * monomial
    return total


def _monomial_slopes(x: Array, y: Array) -> tuple[_Bases, _Bases]:
    """Return the derivatives of the monomials of `_monomials`, by x and by y."""
    powers_x = _powers(x)
    powers_y = _powers(y)
    by_x = [(i[:, None] * powers_x[np.maximum(i - 1, 0)] * powers_y[j]).T for i, j in _EXPONENTS]
    by_y = [(j[:, None] * powers_x[i] * powers_y[np.maximum(j - 1, 0)]).T for i, j in _EXPONENTS]
    return (by_x[0], by_x[1]), (by_y[0], by_y[1])


@cache
def _stop_samples() -> tuple[Array, Array, _Bases, _Bases]:
    """Return points of half of the stop, the monomials there, and the matrices (terms, points) that
    fit polynomials to values.
    """
    radius = np.sin(np.pi / 2 * (np.arange(_RINGS) + 1) / _RINGS)[:, None]
    angle = np.pi * (np.arange(_SPOKES) / (_SPOKES - 1) - 0.5)
    x = np.asarray((radius * np.cos(angle)).ravel())
    y = np.asarray((radius * np.sin(angle)).ravel())
    odd_terms, even_terms = _monomials(x, y)
    fits = np.asarray(np.linalg.pinv(odd_terms)), np.asarray(np.linalg.pinv(even_terms))
    return x, y, (odd_terms, even_terms), fits
