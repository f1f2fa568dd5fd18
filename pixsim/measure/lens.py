"""Data of a traced lens: first-order data, spots, PSFs, MTFs and curves over the field, and its
layout.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.bounds import Positive
from pixsim.base.caller import setting
from pixsim.base.digits import f_stop
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, collected_notes
from pixsim.base.progress import Stage
from pixsim.base.result import Result
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffraction_otf
from pixsim.optics.field_blur import (
    UM_PER_NM,
    ChannelWavefronts,
    fit_wavefronts,
    periodic_psf,
    psf_window,
)
from pixsim.optics.ghosts import Ghost
from pixsim.optics.glass import AIR
from pixsim.optics.lens import FirstOrder, Lens, load_lens
from pixsim.optics.lens_waves import pupil_rays
from pixsim.optics.quantities import FNumberOrPinhole, Reflectance
from pixsim.optics.ray_trace import sag_and_slope

FIELDS = 9  # from the axis to the largest, of spots, PSFs and MTFs
_CURVE_FIELDS = 33
_SPOT_RINGS = 6  # of rays: 1, 6, 12 … in each
_FREQUENCIES = (10.0, 30.0, 60.0)  # lp/mm
_MTF_POINTS = 61
MTF_LINES = ("tangential", "sagittal")
_PSF_SPOTS = 6  # rms radii along a side of a PSF
_PSF_SAMPLES = 3  # of the width λN along a side
_MAX_SAMPLES = 160  # of a PSF along a side, where aberrations make it large
MAX_FINE_WAVES = 3000  # samples along a side, on which waves interfere
# λN along a side; the PSF of waves would take seconds, and the PSF of rays differs little.
_MAX_WIDTHS = 300
GRID, LINE_BINS = 81, 4096  # of rays across the stop, and of their line spread functions
_RAYS_AIMED = 1e-4  # of the stop's radius, a hundredth of their distance
# Rays of such a grid times surfaces, about a second: 81 across for three wavelengths and 28
# surfaces.
_MAX_TRACED = 5e6
# Of the cross-section: shares of the largest field, and heights of its rays in the stop.
_CUT_FIELDS = (0.0, 0.7, 1.0)
_CUT_HEIGHTS = (-1.0, -0.5, 0.0, 0.5, 1.0)
_CUT_EDGE = 1.05  # of the rays' heights, for a surface without a size
CUT_POINTS = 81  # of a surface
_BEFORE_LENS = 0.15  # of its length: a piece of the parallel light in front


@dataclass(frozen=True)
class Spot:
    """Rays of one field in the image plane.

    x_um, y_um : (wavelengths, rays) from the chief ray of the primary wavelength; NaN for rays that
        do not get through
    """

    x_um: Array
    y_um: Array

    @property
    def rms_um(self) -> float:
        """Root mean square distance from the centroid of all rays."""
        x, y = (part[np.isfinite(part)] for part in (self.x_um, self.y_um))
        return float(np.sqrt(x.var() + y.var())) if x.size else math.nan


@dataclass(frozen=True)
class LensData(Result):
    """First-order data, spots, PSFs, MTFs and curves over the field of a traced lens.

    lens : as it is traced
    wavelength_nm : (n,) of equal weight
    field_deg : (F,) of spots, PSFs and MTFs
    spots : one of each field
    psfs : (n, n) of each field; the chief ray of the primary wavelength in the middle
    psf_pitch_um : of the squares over which PSFs are means
    dark : (F,), whether no light reaches the image of a field: its spot and MTF are NaN, its PSF 0
    geometric : whether aberrations are so large that PSFs and MTFs follow from rays, times the
        limit of diffraction
    frequency_lp_per_mm : (n,)
    mtf : (F, 2, n), tangential and sagittal
    curve_deg : (n,) of the curves over the field
    curves : name -> values (n,)
    pitch_um : of the pixel whose Nyquist frequency is looked at
    notes : of how the file was read
    reflectance : of coated surfaces in air, or None for bare glass
    """

    lens: Lens
    wavelength_nm: Array
    field_deg: Array
    spots: Sequence[Spot]
    psfs: Sequence[Array]
    psf_pitch_um: float
    dark: NDArray[np.bool_]
    geometric: bool
    frequency_lp_per_mm: Array
    mtf: Array
    curve_deg: Array
    curves: dict[str, Array]
    pitch_um: float | None
    notes: Sequence[Note] = ()
    reflectance: float | None = None

    @cached_property
    def first(self) -> list[FirstOrder]:
        """First-order data of each wavelength."""
        return [self.lens.first_order(float(nm)) for nm in self.wavelength_nm]

    @cached_property
    def rms_waves(self) -> Array:
        """(F,) rms wavefront without piston and tilt, relative to the primary wavelength; NaN
        without light.
        """
        return np.where(self.dark, np.nan, _rms_wavefronts(self.lens, self.field_deg))

    @cached_property
    def ghosts(self) -> list[Ghost]:
        """Light on the axis that two surfaces reflect, at the primary wavelength, the largest share
        first.
        """
        return self.lens.ghosts(self.lens.primary_nm, self.reflectance)

    @property
    def focused_ghost(self) -> Ghost | None:
        """The ghost with the smallest blur, or None without two surfaces that reflect."""
        return min(self.ghosts, key=lambda ghost: ghost.blur_mm, default=None)

    @property
    def primary(self) -> FirstOrder:
        """First-order data at the primary wavelength."""
        return self.lens.first_order(self.lens.primary_nm)

    @property
    def airy_um(self) -> float:
        """Radius of the first dark ring of diffraction on the axis, at the primary wavelength."""
        return 1.22e-3 * self.lens.primary_nm * self.lens.working_f_number

    @property
    def diffraction_mtf(self) -> Array:
        """MTF of a lens without aberrations on the axis, for the wavelengths together, (n,)."""
        return _diffraction_mtf(
            self.frequency_lp_per_mm, self.wavelength_nm, self.lens.working_f_number
        )

    @property
    def mtf50_lp_per_mm(self) -> Array:
        """First of the frequencies at which the lower MTF, tangential or sagittal, is below one
        half, (F,); inf if none is.

        NaN without light.
        """
        below = self.mtf.min(axis=1) < 0.5
        first = np.where(below.any(axis=1), self.frequency_lp_per_mm[below.argmax(axis=1)], np.inf)
        return np.where(self.dark, np.nan, first)

    @property
    def loss_percent(self) -> float:
        """Light on the axis that uncoated surfaces would reflect, in %."""
        return 100 * (1 - self.lens.fresnel_transmittance(self.lens.primary_nm))

    def axial_colour(self) -> tuple[Array, Array]:
        """Return wavelengths in nm and the paraxial focus of an object at infinity in µm from the
        focus of the primary one, (m,).
        """
        low = self.wavelength_nm.min()
        high = self.wavelength_nm.max()
        nm = np.linspace(low, high, _CURVE_FIELDS) if high > low else np.array([low])
        foci_mm = [self.lens.first_order(float(line)).back_focal_length_mm for line in nm]
        return nm, 1e3 * (np.array(foci_mm) - self.primary.back_focal_length_mm)

    @property
    def asked_lp_per_mm(self) -> tuple[float, ...]:
        """Frequencies of the tables: 10, 30 and 60 lp/mm, and the pixel's Nyquist frequency."""
        return _table_frequencies(self.pitch_um)

    def mtf_at(self, frequency_lp_per_mm: float) -> Array:
        """Return the tangential and sagittal MTF at one frequency of the tables, (F, 2), 1 for full
        contrast.
        """
        index = int(np.argmin(np.abs(self.frequency_lp_per_mm - frequency_lp_per_mm)))
        return np.asarray(self.mtf[:, :, index])

    @property
    def height_mm(self) -> Array:
        """Image heights of the fields, (F,)."""
        return np.asarray(self.lens.chief_ray(self.field_deg, self.lens.primary_nm).height_mm)

    def __repr__(self) -> str:
        first = self.primary
        return (
            f"<LensData {self.lens.prescription.name}: f = {first.focal_length_mm:.5g} mm,"
            f" {f_stop(first.f_number)}>"
        )


def _table_frequencies(pitch_um: float | None) -> tuple[float, ...]:
    """Return the frequencies of the tables in lp/mm."""
    return _FREQUENCIES if pitch_um is None else tuple(sorted({*_FREQUENCIES, 500 / pitch_um}))


def lens_data(
    lens: Lens,
    wavelength_nm: Sequence[float] | None = None,
    pitch_um: float | None = None,
    notes: Sequence[Note] = (),
    reflectance: float | None = None,
) -> LensData:
    """Trace a lens, and return its data over the field.

    wavelength_nm : of equal weight, by default as in its file
    pitch_um : of a pixel whose Nyquist frequency is looked at
    notes : of how the file was read
    reflectance : of coated surfaces in air, or None for bare glass

    Raises PixsimError if a wavelength is outside the range of a glass, or if chief rays do not
    reach the image.
    """
    wavelengths_nm = np.array(wavelength_nm or lens.prescription.wavelengths_nm)
    primary_nm = lens.primary_nm
    max_field_deg = lens.max_field_deg
    field_deg = np.linspace(0.0, max_field_deg, FIELDS) if max_field_deg else np.zeros(1)
    curve_deg = np.linspace(0.0, max_field_deg, _CURVE_FIELDS) if max_field_deg else np.zeros(1)
    illumination = lens.projected_solid_angle_sr(curve_deg, primary_nm)
    dark = np.asarray(illumination[:: (_CURVE_FIELDS - 1) // (FIELDS - 1)] <= 0)
    if dark[0]:
        raise invalid(
            f"lens '{lens.prescription.name}'",
            "no light on the axis",
            "light on the axis",
            "Check its clear apertures and semi-diameters.",
        )

    spots = [
        _spot(lens, float(angle), wavelengths_nm, bool(is_dark))
        for angle, is_dark in zip(field_deg, dark, strict=True)
    ]

    # Frequencies up to the highest of the tables, or on to the cutoff.
    listed_lp_per_mm = _table_frequencies(pitch_um)
    shortest_nm = float(wavelengths_nm.min())
    f_number = lens.working_f_number
    cutoff_lp_per_mm = float(cutoff_cy_per_mm(shortest_nm, f_number))
    highest_listed_lp_per_mm = max(listed_lp_per_mm)
    highest_lp_per_mm = max(
        1.1 * highest_listed_lp_per_mm, min(cutoff_lp_per_mm, 1.5 * highest_listed_lp_per_mm, 150.0)
    )
    steps_lp_per_mm = np.linspace(0.0, highest_lp_per_mm, _MTF_POINTS)
    frequency_lp_per_mm = np.unique(np.concatenate([steps_lp_per_mm, listed_lp_per_mm]))

    # A field with too little light for a ray is dark too.
    dark = dark | np.array([math.isnan(spot.rms_um) for spot in spots])
    lit_deg = field_deg[~dark]
    side_um = _PSF_SPOTS * max(
        spot.rms_um for spot, is_dark in zip(spots, dark, strict=True) if not is_dark
    )
    geometric = side_um > _MAX_WIDTHS * 1e-3 * shortest_nm * f_number
    psf_pitch_um = min(
        max(1e-3 * shortest_nm * f_number / _PSF_SAMPLES, side_um / _MAX_SAMPLES),
        500 / min(highest_lp_per_mm, 1.05 * cutoff_lp_per_mm),
    )
    if not geometric:
        psfs = _point_spreads(lens, lit_deg, wavelengths_nm, psf_pitch_um, side_um)
        geometric = not psfs
    if geometric:
        psf_pitch_um = side_um / _MAX_SAMPLES
        psfs, mtf = ray_spreads(lens, lit_deg, wavelengths_nm, psf_pitch_um, frequency_lp_per_mm)
    else:
        mtf = np.empty((len(psfs), 2, frequency_lp_per_mm.size))
        for psf, (tangential_mtf, sagittal_mtf) in zip(psfs, mtf, strict=True):
            tangential_mtf[:] = line_mtf(psf.sum(axis=1), psf_pitch_um, frequency_lp_per_mm)
            sagittal_mtf[:] = line_mtf(psf.sum(axis=0), psf_pitch_um, frequency_lp_per_mm)

    # Dark fields in rising order, so that each is put at its place.
    for index in np.flatnonzero(dark):
        psfs.insert(int(index), np.zeros_like(psfs[0]))
        mtf = np.insert(mtf, index, np.nan, axis=0)
    # There samples of the PSF would repeat lower frequencies.
    mtf[..., frequency_lp_per_mm > cutoff_lp_per_mm] = 0.0
    curves = _field_curves(lens, curve_deg, wavelengths_nm, illumination)
    return LensData(
        lens=lens,
        wavelength_nm=wavelengths_nm,
        field_deg=field_deg,
        spots=spots,
        psfs=psfs,
        psf_pitch_um=psf_pitch_um,
        dark=dark,
        geometric=geometric,
        frequency_lp_per_mm=frequency_lp_per_mm,
        mtf=mtf,
        curve_deg=curve_deg,
        curves=curves,
        pitch_um=pitch_um,
        notes=notes,
        reflectance=reflectance,
    )


def _field_curves(
    lens: Lens, field_deg: Array, wavelength_nm: Array, illumination: Array
) -> dict[str, Array]:
    """Return curves over the field by name, (n,) each.

    illumination : (n,) of the fields, in any unit
    """
    primary = lens.primary_nm
    chief = lens.chief_ray(field_deg, primary)
    tangential_mm, sagittal_mm = lens.foci_mm(field_deg, primary)
    ends_nm = np.array([wavelength_nm.min(), wavelength_nm.max()])
    end_heights_mm = lens.chief_ray(field_deg[:, None], ends_nm).height_mm
    curves = {
        "image_height_mm": chief.height_mm,
        "chief_ray_angle_deg": chief.angle_deg,
        "distortion": lens.distortion(field_deg),
        "relative_illumination": illumination / illumination[0],
        "tangential_focus_mm": tangential_mm,
        "sagittal_focus_mm": sagittal_mm,
        "lateral_colour_um": 1e3 * (end_heights_mm[:, 1] - end_heights_mm[:, 0]),
    }
    return {name: np.asarray(values) for name, values in curves.items()}


def _spot(lens: Lens, field_deg: float, wavelength_nm: Array, is_dark: bool) -> Spot:
    """Return the rays of a field in the image plane; NaN for all of them if the field is dark."""
    x, y = spot_points()
    waves = lens.wavefront(field_deg, wavelength_nm, x, y)
    is_traced = waves.passed & np.isfinite(waves.opd_waves) & (not is_dark)
    off_mm = waves.chief_y_mm[:, None] - lens.chief_ray(field_deg, lens.primary_nm).height_mm
    return Spot(
        np.where(is_traced, 1e3 * waves.x_mm, np.nan),
        np.where(is_traced, 1e3 * (waves.y_mm + off_mm), np.nan),
    )


def spot_points() -> tuple[Array, Array]:
    """Return points of the stop of about equal areas, (rays,) each."""
    radii = [np.zeros(1)]
    angles = [np.zeros(1)]
    for ring in range(1, _SPOT_RINGS + 1):
        points = 6 * ring
        radii.append(np.full(points, ring / _SPOT_RINGS))
        angles.append((np.arange(points) + 0.5) / (3 * ring) * np.pi)

    radius = np.concatenate(radii)
    radius *= _SPOT_RINGS / (_SPOT_RINGS + 0.5)  # a ring is the middle of its area
    angle = np.concatenate(angles)
    return radius * np.cos(angle), radius * np.sin(angle)


def _rms_wavefronts(lens: Lens, field_deg: Array) -> Array:
    """Return the rms wavefront at the primary wavelength without piston and tilt, (F,), in
    waves.
    """
    x, y = spot_points()
    waves = lens.wavefront(field_deg, lens.primary_nm, x, y)
    rms_waves = []
    for opd, passed, cosines in zip(waves.opd_waves, waves.passed, waves.cosines, strict=True):
        is_traced = passed & np.isfinite(opd)
        basis = np.column_stack([np.ones(int(is_traced.sum())), cosines[is_traced]])
        if len(basis) <= basis.shape[1]:
            rms_waves.append(math.nan)
            continue
        coefficients = np.linalg.lstsq(basis, opd[is_traced], rcond=None)[0]
        rms_waves.append(float(np.std(opd[is_traced] - basis @ coefficients)))

    return np.array(rms_waves)


def _point_spreads(
    lens: Lens, field_deg: Array, wavelength_nm: Array, pitch_um: float, side_um: float
) -> list[Array]:
    """Return the PSF of each field, means over squares of `pitch_um`, with the chief ray in the
    middle of y upwards, (n, n).

    The list is empty if the cone of light at the image plane is much wider than by the f-number, as
    far from a focus.

    side_um : at least, of the square that a PSF lies in
    """
    heights = 1e3 * np.asarray(lens.chief_ray(field_deg, lens.primary_nm).height_mm)
    rays = pupil_rays(lens, field_deg, wavelength_nm)
    fronts = [
        fit_wavefronts(float(nm), heights, traced_rays)
        for nm, traced_rays in zip(wavelength_nm, rays, strict=True)
    ]
    light = ChannelWavefronts(fronts, np.full(len(fronts), 1 / len(fronts)))
    psfs = []
    for height in heights:
        window = psf_window(light, 0.0, float(height), pitch_um, math.ceil(side_um / pitch_um))
        diameters = [2 * float(front.at(float(height))[:2].max()) for front in fronts]
        widest_per_nm = max(
            diameter / front.wavelength_nm
            for diameter, front in zip(diameters, fronts, strict=True)
        )
        if 2 * window * pitch_um / UM_PER_NM * widest_per_nm > MAX_FINE_WAVES:
            return []
        psfs.append(np.fft.fftshift(periodic_psf(light, 0.0, float(height), pitch_um, window)))

    return psfs


def ray_spreads(
    lens: Lens, field_deg: Array, wavelength_nm: Array, pitch_um: float, frequency_lp_per_mm: Array
) -> tuple[list[Array], Array]:
    """Return PSFs of rays, as `_point_spreads` does, and MTFs (F, 2, n), times the limit of
    diffraction.
    """
    rays = GRID**2 * field_deg.size * wavelength_nm.size * len(lens.prescription.surfaces)
    grid = np.linspace(-1, 1, round(GRID * min(1.0, math.sqrt(_MAX_TRACED / rays))))
    grid_x, grid_y = np.meshgrid(grid, grid)
    is_in_stop = np.hypot(grid_x, grid_y) <= 1
    x = grid_x[is_in_stop]
    y = grid_y[is_in_stop]
    limit = _diffraction_mtf(frequency_lp_per_mm, wavelength_nm, lens.working_f_number)
    edges = (np.arange(_MAX_SAMPLES + 2) - (_MAX_SAMPLES + 1) / 2) * pitch_um
    psfs = []
    mtf = []
    for angle in field_deg:
        waves = lens.wavefront(angle, wavelength_nm, x, y, _RAYS_AIMED)
        is_traced = waves.passed & np.isfinite(waves.opd_waves)
        off_mm = waves.chief_y_mm[:, None] - lens.chief_ray(angle, lens.primary_nm).height_mm
        x_um = 1e3 * waves.x_mm[is_traced]
        y_um = 1e3 * (waves.y_mm + off_mm)[is_traced]
        counts = np.histogram2d(y_um, x_um, [edges, edges])[0]
        psfs.append(counts / max(y_um.size, 1))
        lines = []
        for values in (y_um, x_um):
            half_width_um = max(float(np.abs(values).max(initial=0.0)), pitch_um) * (1 + 1e-9)
            line, _ = np.histogram(values, LINE_BINS, (-half_width_um, half_width_um))
            lines.append(
                line_mtf(line.astype(float), 2 * half_width_um / LINE_BINS, frequency_lp_per_mm)
                * limit
            )

        mtf.append(lines)

    return psfs, np.array(mtf)


def _diffraction_mtf(frequency_lp_per_mm: Array, wavelength_nm: Array, f_number: float) -> Array:
    """Return the MTF of diffraction (n,), the mean over the wavelengths."""
    otfs = [diffraction_otf(frequency_lp_per_mm, float(nm), f_number) for nm in wavelength_nm]
    return np.asarray(np.mean(otfs, axis=0))


def line_mtf(line: Array, pitch_um: float, frequency_lp_per_mm: Array) -> Array:
    """Return the MTF (n,) of a line spread function: the modulus of its Fourier transform, 1 at
    frequency 0.
    """
    position_mm = (np.arange(line.size) - line.size // 2) * pitch_um * 1e-3
    turning = np.exp(-2j * np.pi * frequency_lp_per_mm[:, None] * position_mm)
    return np.asarray(np.abs(turning @ line) / line.sum())


@dataclass(frozen=True)
class _CrossSection:
    """A lens cut along the y-z plane, and rays at the primary wavelength, in mm from the first
    vertex.

    length_mm : from there to the image plane
    surfaces : (z, y) of each surface, from its lower to its upper edge
    glass_behind : whether there is glass behind each surface
    stop : z of the stop's edges, and the stop's radius
    rays : field angle in degrees -> rays that clear apertures do not stop, each by its height in
        the stop as a fraction of the stop's radius, its z and its y
    """

    length_mm: float
    surfaces: Sequence[tuple[Array, Array]]
    glass_behind: Sequence[bool]
    stop: tuple[float, float]
    rays: dict[float, list[tuple[float, Array, Array]]]


def cross_section(lens: Lens) -> _CrossSection:
    """Return a lens cut along the y-z plane, with rays through the centre of the stop, its edges
    and halfway between.
    """
    surfaces = lens.prescription.surfaces
    heights = np.array(_CUT_HEIGHTS)
    vertices = np.cumsum([0.0, *(surface.thickness_mm for surface in surfaces)])
    length_mm = float(vertices[-1])
    shares = _CUT_FIELDS if lens.max_field_deg else _CUT_FIELDS[:1]
    fields = [share * lens.max_field_deg for share in shares]
    paths = [lens.ray_points(angle, lens.primary_nm, 0 * heights, _CUT_HEIGHTS) for angle in fields]
    reached = np.nanmax(np.abs([path[:, :-1, 1] for path in paths]), axis=(0, 1))
    outlines = []
    for surface, vertex, max_height in zip(surfaces, vertices, reached, strict=False):
        edge = surface.semi_diameter_mm or _CUT_EDGE * float(max_height)
        y = np.linspace(-edge, edge, CUT_POINTS)
        with np.errstate(invalid="ignore"):
            sag, _ = sag_and_slope(surface, np.square(y))
        outlines.append((vertex + sag, y))

    stop = lens.prescription.stop
    stop_radius_mm = lens.stop_semi_diameter_mm
    stop_sag, _ = sag_and_slope(surfaces[stop], np.array(stop_radius_mm**2))
    stop_z_mm = float(vertices[stop] + float(stop_sag))

    rays: dict[float, list[tuple[float, Array, Array]]] = {}
    for angle, path in zip(fields, paths, strict=True):
        waves = lens.wavefront(angle, lens.primary_nm, np.zeros(heights.size), _CUT_HEIGHTS)
        passed = waves.passed[0]
        z = path[passed, :, 2]
        y = path[passed, :, 1]
        if math.isinf(lens.object_distance_mm):
            start_mm = _BEFORE_LENS * length_mm
            z = np.column_stack([z[:, 0] - start_mm, z])
            y = np.column_stack([y[:, 0] - start_mm * math.tan(math.radians(angle)), y])

        rays[angle] = list(zip(heights[passed].tolist(), z, y, strict=True))

    glass_behind = [surface.glass != AIR for surface in surfaces]
    return _CrossSection(length_mm, outlines, glass_behind, (stop_z_mm, stop_radius_mm), rays)


_MIN_ARGUMENT = 1e-6  # of an argument, in its unit; its reciprocal is the most
_MAX_WAVELENGTHS = 24  # as in design programs
_MANY_TO_TRACE = 150  # surfaces times wavelengths, which take more than about 5 s


def lens(
    file: str | os.PathLike[str],
    *,
    focal_length_mm: float | None = None,
    f_number: FNumberOrPinhole | None = None,
    field_deg: float | None = None,
    refocus: Literal["paraxial", "axis", "field"] | None = None,
    focus_nm: Positive | None = None,
    object_distance_m: float | None = None,
    wavelength_nm: Sequence[Positive] = (),
    pitch_um: Positive | None = None,
    configuration: int | None = None,
    semi_diameters: Literal["ignore", "clip"] = "ignore",
    vignetting_factors: Literal["use", "ignore"] | None = None,
    glass_catalogues: Sequence[str | os.PathLike[str]] = (),
    unknown_glass: Literal["error", "model"] = "error",
    reflectance: Reflectance | None = None,
    progress: Stage | None = None,
) -> LensData:
    """Trace a lens: first-order data, spots, PSF and MTF, distortion, field curvature, illumination
    and chief ray angles.

    The lens is as in its file unless the arguments change it.

    file : a packaged lens by its name (cooke_triplet, double_gauss, phone, singlet), or a `.toml`
        or `.zmx` file
    focal_length_mm : scale the whole lens to it
    f_number : stop the lens down
    field_deg : largest field angle that is looked at
    refocus : move the image plane to the paraxial focus, or to the least rms wavefront on the axis
        or over the field. By default it is the file's plane, or axis if an object distance or
        `focus_nm` is given
    focus_nm : wavelength of that focus, by default all of the file
    object_distance_m : of the object from the entrance pupil
    wavelength_nm : of equal weight, by default all of the file
    pitch_um : of a pixel, whose Nyquist frequency joins 10, 30 and 60 lp/mm
    configuration, semi_diameters, vignetting_factors, glass_catalogues, unknown_glass : as in
        `load_lens`
    reflectance : share of the light that coated surfaces in air reflect, for light that two of them
        reflect; by default bare glass
    progress : returns a callback for each named stage

    Raises PixsimError for invalid input, and for what pixsim does not trace.

    >>> data = lens("cooke_triplet", f_number=8.0, pitch_um=5.0)
    >>> round(float(data.primary.f_number), 3), 100.0 in data.asked_lp_per_mm
    (8.0, True)
    """
    positive = [
        ("focal_length_mm", focal_length_mm),
        ("f_number", f_number),
        ("object_distance_m", object_distance_m),
        ("focus_nm", focus_nm),
        ("pitch_um", pitch_um),
        *(("wavelength_nm", nm) for nm in wavelength_nm),
    ]
    for name, value in positive:
        if value is not None and not _MIN_ARGUMENT <= value <= 1 / _MIN_ARGUMENT:
            raise invalid(
                setting(name),
                f"{value:g}",
                f"a number above 0, {_MIN_ARGUMENT:g} to {1 / _MIN_ARGUMENT:g}",
            )

    if len(wavelength_nm) > _MAX_WAVELENGTHS:
        raise invalid(
            setting("wavelength_nm"),
            f"{len(wavelength_nm)} wavelengths",
            f"at most {_MAX_WAVELENGTHS}",
        )

    if field_deg is not None and not (field_deg == 0 or 1e-6 <= field_deg < 90):
        raise invalid(
            setting("field_deg"), f"{field_deg:g}", "0, or at least 1e-6 and below 90 degrees"
        )
    if reflectance is not None and not 0 <= reflectance < 1:
        raise invalid(
            setting("reflectance"), f"{reflectance:g}", "a number of at least 0 and below 1"
        )
    with collected_notes() as notes:
        file_lens = load_lens(
            file, configuration, semi_diameters, vignetting_factors, glass_catalogues, unknown_glass
        )
        changed_lens = _changed_lens(
            file_lens, focal_length_mm, f_number, field_deg, refocus, object_distance_m, focus_nm
        )

    if progress:
        surfaces = len(changed_lens.prescription.surfaces)
        wavelengths = len(wavelength_nm or changed_lens.prescription.wavelengths_nm)
        is_slow = surfaces * wavelengths > _MANY_TO_TRACE
        progress(f"trace {surfaces} surfaces at {wavelengths} wavelengths" if is_slow else "trace")

    return lens_data(changed_lens, wavelength_nm, pitch_um, tuple(notes), reflectance)


def _changed_lens(
    lens: Lens,
    focal_length_mm: float | None,
    f_number: float | None,
    field_deg: float | None,
    refocus: Literal["paraxial", "axis", "field"] | None,
    object_distance_m: float | None,
    focus_nm: float | None = None,
) -> Lens:
    """Return a lens with the options of `pixsim lens`; None leaves a property as it is.

    Raises PixsimError as the methods of `Lens` do.
    """
    if focal_length_mm is not None:
        factor = focal_length_mm / lens.first_order(lens.primary_nm).focal_length_mm
        lens = replace(lens.scaled(factor), object_distance_mm=factor * lens.object_distance_mm)
    if f_number is not None:
        lens = lens.stopped_down(f_number)
    if field_deg is not None:
        lens = lens.with_same_rays(max_field_deg=field_deg)
    if refocus is not None or object_distance_m is not None or focus_nm is not None:
        distance = lens.object_distance_mm if object_distance_m is None else 1e3 * object_distance_m
        lens = lens.refocused(refocus or "axis", distance, wavelength_nm=focus_nm)
    return lens
