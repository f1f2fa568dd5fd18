"""A real lens in a camera: the thin lens that stands for it on the axis, and its chief rays,
distortion and blur over the die.

The camera's thin lens has the real one's paraxial image distance for the object's plane and its
numerical aperture on the axis; `Camera.chief_ray_angle` has the directions of its chief rays and
its fall-off. So code for cameras serves real lenses too. Distortion and blur follow from the
trace: the scene is rendered from the middle of the entrance pupil without distortion, on a film as
large as the die and its distortion need, and then seen where the chief rays of the primary
wavelength arrive. Lateral colour is part of the blur.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from pixsim.base import cache
from pixsim.base.arrays import MIN_THREADED_NUMBERS, Array, in_threads, strips
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, warn
from pixsim.base.toml import packaged_tables
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.diffraction import white_otf
from pixsim.optics.field_blur import (
    RADIAL_STEPS,
    ChannelWavefronts,
    FieldBlur,
    FittedWavefronts,
    Psf,
    RadialPsfs,
    blur_from_arrays,
    cutoff_per_um,
    farthest_tile_um,
    field_blur,
    fit_wavefronts,
    max_psf_cells,
    periodic_psf,
    picture_error,
    psf_transform,
    psf_window,
    psfs_between_tiles,
    radial_psfs,
    resolving_um,
)
from pixsim.optics.lens import Lens, read_lens
from pixsim.optics.lens_options import READING_OPTIONS, LensOptions, TracedLens
from pixsim.optics.lens_waves import pupil_rays
from pixsim.optics.thin_lens import irradiance_factor

# Chief rays from the axis to the corner of the die, linear in between: 3e-5 of the fall-off.
_CHIEF_RAYS = 129
# The end of the image circle is approached by this factor, in so many steps.
_CIRCLE_STEP = 0.99
_CIRCLE_STEPS = 400
# Of the corner's height, so that the last row does not end before it.
_CORNER_MARGIN = 1e-6
# Of the light on the axis: towards the end of an image circle pupils shrink to nothing.
_MIN_ILLUMINATION = 0.3

# What a tiling may have: wavefronts from the axis to the corner, wavelengths of a light's blur,
# film cells along a PSF, and tiles across the longer side of the die; fewer take no less time.
_NODE_COUNTS = (17, 33, 65)
_WAVELENGTH_COUNTS = (4, 6, 8, 12)
_PSF_SIDES = (9, 17, 33, 49, 65, 97, 129)
_TILE_COUNTS = (24, 32, 48, 64)
# Film cells from tile to tile, at least: on coarser films, smaller tiles take longer than a finer
# film.
_MIN_SPACING = 8
# The error of tiles falls with this power of their number, or faster.
_TILE_ORDER = 3

# Test points, of the way to the corner of the die. Towards the corner PSFs change most: few tiles
# are too few at the first two points alone.
_TEST_HEIGHTS = (0.0, 0.25, 0.5, 0.7, 0.86, 0.97)
_FIRST_TEST_HEIGHTS = [3, 4]
# Along half a side of the die, for the share of the area for which a point stands.
_AREA_POINTS = 64
# Cells on which errors are computed, at most: of the period of the finest detail that a lens
# passes.
_PERIOD_SHARE = 0.25
# Film cells of a PSF with which the errors of wavelengths and nodes are computed.
_TEST_CELLS = 33
# Film cells, for rays on a film that is too coarse for waves.
_COARSE_WINDOW = 32
# Shares of the tolerance: for wavelengths and for nodes each, and for the tails of PSFs.
_LIGHT_SHARE = 0.2
_CUT_SHARE = 0.4
_KEY_DIGITS = 9  # of numbers on which a tiling depends
# Of the rms of a blurred picture about its mean.
_USUAL_TOLERANCE = 0.01

_ORTHOGONAL_PASSES = 2  # of Lanczos's steps, so that rounding does not add up

# In light of several spectra: groups of neighbouring bands that have one blur.
GROUPS = 6
GROUP_WAVELENGTHS = 2
LENS_HEADER = "lens_blur"  # entry of an image's header: its `Tiling`
_VIEW_STEPS = 4
_OTHER_SCALE = 0.01  # of a lens: less than focal lengths differ between pieces of one lens

# Degree, for the picture between film cells: 1.4e-3 of the contrast at half the Nyquist frequency.
_SPLINE = 5
_IMAGES = 4  # of a frequency on each side, for the error of the spline
# Derivatives of samples, to the fourth order.
_SLOPE = np.array([1, -8, 0, 8, -1]) / 12
_CURVATURE = np.array([-1, 16, -30, 16, -1]) / 12


def camera_with_lens(
    camera: Camera, camera_options: CameraOptions, lens_options: LensOptions
) -> Camera:
    """Return a camera with a real lens in place of its thin one if there is a file, and with the
    veil and fall-off of the options.

    camera : with the die and the object's distance
    camera_options : without focal length and chief rays, which the lens has; `f_number` stops the
        lens down

    Raises PixsimError for options that contradict the lens, for a lens that cannot be read, and for
    a plane without real image.
    """
    camera = camera.with_light_of(lens_options)
    if lens_options.file is None:
        return camera
    for name, allowed, hint in (
        (
            "focal_length_mm",
            "the focal length of the lens",
            "Set lens.focal_length_mm, to which the whole lens is scaled.",
        ),
        ("chief_ray_angle", "the chief rays of the lens", ""),
    ):
        if getattr(camera_options, name) is not None:
            raise invalid(
                f"camera.{name}",
                f"a value together with lens.file = '{lens_options.file}'",
                allowed,
                hint,
            )

    lens = _lens_record(camera, camera_options, lens_options)
    traced = traced_lens(lens, camera.object_distance_m)

    # The thin lens of the same image distance, and of the same numerical aperture on the axis.
    object_mm = 1e3 * camera.object_distance_m
    image_mm = traced.paraxial_height_mm
    focal_mm = object_mm * image_mm / (object_mm + image_mm)
    solid_angle_sr = float(traced.projected_solid_angle_sr(0.0, traced.primary_nm))
    squared_aperture = solid_angle_sr / math.pi
    effective_f_number = math.sqrt((1 - squared_aperture) / squared_aperture) / 2
    magnification = focal_mm / (object_mm - focal_mm)
    changes = {
        "focal_length_mm": focal_mm,
        "f_number": effective_f_number / (1 + magnification),
        "chief_ray_angle": _chief_rays(lens, camera.object_distance_m, lens.field_mm),
        "lens": lens,
    }
    return Camera(**camera.model_dump(exclude=set(changes)) | changes)


def _lens_record(
    camera: Camera, camera_options: CameraOptions, lens_options: LensOptions
) -> TracedLens:
    """Return the record of a real lens in a camera, scaled such that its largest field reaches the
    corner of the die unless its focal length is stated.

    Warns if this scales a lens of the user's, which exists in one size; packaged ones are designs.
    """
    assert lens_options.file is not None
    is_user_file = Path(lens_options.file).is_file()
    file = str(Path(lens_options.file).resolve()) if is_user_file else lens_options.file
    unscaled = read_lens(file, lens_options)
    first_order = unscaled.first_order(unscaled.primary_nm)
    field_mm = math.hypot(camera.die_mm, camera.height_mm) / 2

    focal_mm = lens_options.focal_length_mm
    if focal_mm is None:
        file_focal_mm = focal_mm = first_order.focal_length_mm
        chief_ray = unscaled.chief_ray(unscaled.max_field_deg, unscaled.primary_nm)
        farthest_mm = abs(float(chief_ray.height_mm))
        if farthest_mm:
            focal_mm = float(f"{file_focal_mm * field_mm / farthest_mm:.6g}")
        if is_user_file and abs(focal_mm / file_focal_mm - 1) > _OTHER_SCALE:
            warn(Note("lens_scaled", lens=unscaled.prescription.name, focal_mm=file_focal_mm))

    f_number = camera_options.f_number
    if f_number is None:
        f_number = float(f"{first_order.f_number:.9g}")
    return TracedLens(
        file=file,
        focal_length_mm=focal_mm,
        refocus=lens_options.refocus,
        focus_nm=lens_options.focus_nm,
        ideal=lens_options.ideal,
        f_number=f_number,
        field_mm=field_mm,
        content=content_hash(unscaled.fingerprint),
        **{name: getattr(lens_options, name) for name in READING_OPTIONS},
    )


def lens_on_die(camera: Camera, other: Camera, same_view: bool = False) -> Camera:
    """Return a camera on the die of another one, whose field its lens may not fill.

    same_view : with its lens made larger or smaller, such that the field of view goes with the
        width of the die
    """
    die = {"die_mm": other.die_mm, "die_height_mm": other.die_height_mm}
    if camera.lens is None or camera.die_um == other.die_um:
        return camera.model_copy(update=die)

    image_distance_mm = camera.image_distance_mm
    if same_view:
        image_distance_mm *= other.die_mm / camera.die_mm
    without_file = without_lens(camera).model_copy(update=die)

    # In steps, since the image distance grows only nearly as the focal length.
    scaled = camera
    focal_mm = camera.lens.focal_length_mm
    for _ in range(_VIEW_STEPS if same_view else 1):
        focal_mm = focal_mm * image_distance_mm / scaled.image_distance_mm
        options = camera.lens_options.model_copy(update={"focal_length_mm": focal_mm})
        scaled = camera_with_lens(
            without_file, CameraOptions(f_number=camera.lens.f_number), options
        )
    return scaled


@lru_cache(maxsize=16)
def traced_lens(lens: TracedLens, object_distance_m: float) -> Lens:
    """Return the lens of a camera: scaled, stopped down, and focused on the object's plane.

    Raises PixsimError if its file is another than when the camera was made.
    """
    unscaled = read_lens(lens.file, lens)
    if content_hash(unscaled.fingerprint) != lens.content:
        raise invalid(
            "lens.file",
            f"'{lens.file}', which has changed since this light was made",
            "the same prescription",
        )

    focal_mm = unscaled.first_order(unscaled.primary_nm).focal_length_mm
    scaled = unscaled.scaled(lens.focal_length_mm / focal_mm)
    try:
        scaled = scaled.stopped_down(lens.f_number)
    except PixsimError as error:
        raise PixsimError(f"camera.{error}") from None

    half_field_deg = math.degrees(math.atan(lens.field_mm / lens.focal_length_mm))
    object_mm = 1e3 * object_distance_m
    try:
        return scaled.refocused(lens.refocus, object_mm, half_field_deg, lens.focus_nm)
    except PixsimError as error:
        if lens.focus_nm is None:
            raise
        raise PixsimError(f"lens.focus_nm: {error}") from None


@lru_cache(maxsize=16)
def _chief_rays(
    traced: TracedLens, object_distance_m: float, corner_mm: float
) -> tuple[tuple[float, float, float], ...]:
    """Return image heights in mm, chief ray angles in degrees, and relative illuminations, up to
    the corner of a die.

    Beyond the image circle the illumination is 0.
    """
    lens = traced_lens(traced, object_distance_m)
    heights_mm, fields = field_angles(traced, object_distance_m, corner_mm)
    angles_deg = lens.chief_ray(fields, lens.primary_nm).angle_deg
    illumination = lens.relative_illumination(fields)
    rows = list(zip(heights_mm.tolist(), angles_deg.tolist(), illumination.tolist(), strict=True))
    rows[0] = (0.0, 0.0, 1.0)

    circle_mm, angle_deg, _ = rows[-1]
    if circle_mm < corner_mm:
        step_mm = _CORNER_MARGIN * corner_mm
        end_mm = max(corner_mm, circle_mm + 2 * step_mm) * (1 + _CORNER_MARGIN)
        rows.append((circle_mm + step_mm, angle_deg, 0.0))
        rows.append((end_mm, angle_deg, 0.0))
    return tuple(rows)


@lru_cache(maxsize=16)
def field_angles(
    traced: TracedLens, object_distance_m: float, corner_mm: float
) -> tuple[Array, Array]:
    """Return image heights in mm (n,) and their fields in degrees, from 0 to the corner of a die or
    the end of the image circle.
    """
    lens = traced_lens(traced, object_distance_m)
    nm = lens.primary_nm
    try:
        largest_deg = lens.field_of_height(corner_mm * (1 + _CORNER_MARGIN), nm)
    except PixsimError:  # the image circle ends before the corner
        largest_deg = math.degrees(math.atan(corner_mm / lens.paraxial_height_mm))

    for _ in range(_CIRCLE_STEPS):
        fields = np.linspace(0.0, largest_deg, _CHIEF_RAYS)
        try:
            heights_mm = np.asarray(lens.chief_ray(fields, nm).height_mm)
        except PixsimError:
            largest_deg *= _CIRCLE_STEP
            continue

        # Where heights fall again, light folds back.
        falls = np.append(np.diff(heights_mm), -1.0) <= 0
        last = int(np.argmax(falls))
        if last == _CHIEF_RAYS - 1:
            return heights_mm, fields
        largest_deg = float(fields[last])

    raise invalid(
        "lens.file",
        f"'{traced.file}', whose image does not reach {corner_mm:g} mm from its axis",
        "a lens whose image covers the die",
    )


def _odd_spline(positions: Array, values: Array) -> Callable[..., Array]:
    """Return the cubic spline through values of an odd function at positions from 0 on."""
    from scipy.interpolate import CubicSpline  # takes 0.3 s

    spline: Callable[..., Array] = CubicSpline(
        np.concatenate([-positions[:0:-1], positions]), np.concatenate([-values[:0:-1], values])
    )
    return spline


# The scene where the chief rays arrive


Picture = NDArray[np.float32] | Array


@dataclass(frozen=True)
class Distortion:
    """Where the points of an image would lie without distortion.

    height_mm, undistorted_mm : (n,), from the axis on; the latter in the thin lens's image
    image_scale : of a very small image on the sensor, relative to the thin lens's; not 1 out of the
        paraxial focus
    """

    height_mm: Array
    undistorted_mm: Array
    image_scale: float = 1.0

    @property
    def widening(self) -> float:
        """Side of the undistorted picture that fills the die, over the side of the die."""
        return max(1.0, float((self.undistorted_mm[1:] / self.height_mm[1:]).max()))

    @property
    def largest_mm(self) -> float:
        """Largest shift of a point."""
        return float(np.abs(self.undistorted_mm - self.height_mm).max())

    def applied(self, picture: Picture, pitch_um: float, widening: float) -> Array:
        """Return the distorted picture (H, W) of a picture without distortion.

        pitch_um : of the result; the samples of the picture are `widening` times as large
        """
        return _resampled(
            picture,
            pitch_um,
            _odd_spline(self.height_mm, self.undistorted_mm),
            float(self.height_mm[-1]),
            widening,
        )

    def removed(self, picture: Picture, pitch_um: float) -> Array:
        """Return a distorted picture, (H, W), without distortion.

        Points outside of the lens's image repeat the values at its sides. The scale of the image on
        the axis stays.
        """
        straight_mm = self.image_scale * self.undistorted_mm
        inverse = _odd_spline(straight_mm, self.height_mm)
        return _resampled(picture, pitch_um, inverse, float(straight_mm[-1]), 1.0)


def _resampled(
    picture: Picture,
    pitch_um: float,
    source_height_mm: Callable[..., Array],
    max_height_mm: float,
    widening: float,
) -> Array:
    """Return a picture whose points come from other distances from the axis.

    Its samples, and those of the source, are means over cells; cells of the source are `widening`
    times as large.

    The spline rings at edges, also below zero. That is part of what a lens and pixels see with the
    right contrast: only pixels may end at zero.

    source_height_mm : distance (n,) -> distance from which it comes, or its derivative of the order
        that is the second argument
    """
    from scipy.ndimage import map_coordinates, spline_filter  # takes 0.05 s

    y_mm, x_mm = ((np.arange(n) - (n - 1) / 2) * pitch_um * 1e-3 for n in picture.shape)
    middle_row, middle_column = ((n - 1) / 2 for n in picture.shape)
    filtered = spline_filter(np.asarray(picture, float), _SPLINE, mode="reflect")
    moved = np.empty(picture.shape)

    def move(rows: slice) -> None:
        radius_mm = np.maximum(np.hypot(x_mm, y_mm[rows, None]), 1e-12)
        inside_mm = np.minimum(radius_mm, max_height_mm)
        cells_per_mm = source_height_mm(inside_mm) / inside_mm / (widening * pitch_um * 1e-3)
        source = [y_mm[rows, None] * cells_per_mm + middle_row, x_mm * cells_per_mm + middle_column]
        map_coordinates(filtered, source, moved[rows], _SPLINE, "reflect", prefilter=False)

    in_threads(move, strips(*picture.shape), picture.size)

    # A cell of the source covers 1/m cells here. Means over one are these and (1 - 1/m²)/24 of
    # their curvature, in each direction.
    extended = np.pad(moved, len(_SLOPE) // 2, "symmetric")

    def widen(rows: slice) -> None:
        height_mm = y_mm[rows, None]
        radius_mm = np.maximum(np.hypot(x_mm, height_mm), 1e-12)
        inside_mm = np.minimum(radius_mm, max_height_mm)
        tangential = 1 - np.square(widening * inside_mm / source_height_mm(inside_mm))
        radial = 1 - np.square(widening / source_height_mm(inside_mm, 1))
        radial = np.where(radius_mm > max_height_mm, tangential, radial)

        lines = extended[rows.start : rows.stop + len(_SLOPE) - 1]
        down = _correlated(lines[:, 2:-2], _CURVATURE)
        across = _correlated(lines[2:-2].T, _CURVATURE).T
        diagonal = _correlated(_correlated(lines.T, _SLOPE).T, _SLOPE)
        outwards = (
            np.square(x_mm) * across + 2 * x_mm * height_mm * diagonal + height_mm**2 * down
        ) / np.square(radius_mm)
        moved[rows] += (tangential * (down + across) + (radial - tangential) * outwards) / 24

    in_threads(widen, strips(*picture.shape), picture.size)
    return moved


def _correlated(lines: Array, weights: Array) -> Array:
    """Return the sums of neighbouring lines (n + m - 1, columns) by weights (m,), (n, columns)."""
    count = len(lines) - len(weights) + 1
    total = np.zeros((count, lines.shape[1]))
    for first, weight in enumerate(weights.tolist()):
        total += weight * lines[first : first + count]
    return total


def moved_error(distortion: Distortion, pitch_um: float, frequency: NDArray[np.floating]) -> Array:
    """Return the error of details that `Distortion.applied` moves, relative to them, (n, n) for all
    pairs of frequencies.

    It is 0 beyond half of the film's Nyquist frequency, where the film itself is too coarse. It is
    the error of the points which lie farthest between cells of the source. The spline of degree p
    has the transform H_m = (f + m)^-(p + 1) / Σ_k (f + k)^-(p + 1) at a frequency f and its images
    f + m (M. Unser, A. Aldroubi and M. Eden, IEEE Trans. Signal Process. 41 (1993) 821); means over
    other cells are off where their size changes most.

    frequency : (n,) in cycles per film cell, -0.5 to 0.5
    """
    height_mm = distortion.height_mm[1:]
    source_mm = distortion.undistorted_mm[1:] / distortion.widening
    spline = _odd_spline(distortion.height_mm, distortion.undistorted_mm)
    tangential = source_mm / height_mm
    radial = spline(height_mm, 1) / distortion.widening
    magnification = np.concatenate([tangential, radial])
    f = np.where(frequency == 0, 1e-9, frequency)

    # Between the cells of the source, whose points are at most half a cell away.
    shift = min(0.5, 1e3 * float(np.abs(source_mm - height_mm).max()) / pitch_um)
    images = np.arange(-_IMAGES, _IMAGES + 1)
    source_frequency = f[:, None] / float(magnification.min())
    weight = (source_frequency / (source_frequency + images)) ** (_SPLINE + 1)
    phases = np.exp(2j * np.pi * images * shift)
    between = weight / weight.sum(axis=1, keepdims=True) @ phases

    # Means over cells of another size, corrected by the curvature.
    ratio = float(magnification[np.abs(magnification - 1).argmax()])
    curvature = (-30 + 32 * np.cos(2 * np.pi * f) - 2 * np.cos(4 * np.pi * f)) / 12
    cells = np.sinc(f / ratio) * (1 + (1 - ratio**-2) / 24 * curvature) / np.sinc(f)

    error = 1 + np.abs(between - 1) + np.abs(cells - 1)
    is_seen_by_film = np.hypot(frequency, frequency[:, None]) <= 0.25
    return np.asarray(is_seen_by_film * (np.outer(error, error) - 1))


@lru_cache(maxsize=16)
def camera_distortion(camera: Camera) -> Distortion | None:
    """Return the distortion of a camera's real lens over its die, or None for a thin lens."""
    if camera.lens is None:
        return None
    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    heights_mm, fields = field_angles(camera.lens, camera.object_distance_m, corner_mm)
    lens = traced_lens(camera.lens, camera.object_distance_m)
    return Distortion(
        height_mm=heights_mm,
        undistorted_mm=camera.image_distance_mm * np.tan(np.radians(fields)),
        image_scale=lens.image_scale_mm / camera.image_distance_mm,
    )


def without_lens(camera: Camera) -> Camera:
    """Return a camera whose thin lens of the same image distance and f-number stands for its real
    lens.
    """
    if camera.lens is None:
        return camera
    return camera.model_copy(update={"lens": None, "chief_ray_angle": None})


def rendered_camera(camera: Camera) -> Camera:
    """Return the thin lens through which the scene is rendered, with a film that is as large as die
    and distortion need.
    """
    distortion = camera_distortion(camera)
    if distortion is None:
        return camera
    die = {"die_mm": camera.die_mm * distortion.widening}
    if camera.die_height_mm is not None:
        die["die_height_mm"] = camera.die_height_mm * distortion.widening
    return without_lens(camera).model_copy(update=die)


# Blur


@dataclass(frozen=True)
class Tiling:
    """How the blur of a lens is computed.

    spacing_um : from the middle of a tile to the middle of the next
    psf_um : side of the PSFs; 0 on a film that is too coarse to show the blur
    error : bound for the rms error of a blurred picture, relative to its rms about the mean, for
        pictures of `picture_error`, and for the distortion of details up to half of the film's
        Nyquist frequency
    worst : the same where it is largest, for pictures with detail there only
    wavelengths : of a light's blur
    nodes : wavefronts from the axis to the corner, between which others are interpolated
    cut_error : the part of the error that the size of the PSFs leaves, with any number of tiles
    lacking : largest share of the light that falls beyond a PSF; it is spread as a veil that falls
        as 1/r³
    """

    spacing_um: float
    psf_um: float
    error: float
    worst: float = 0.0
    wavelengths: int = _WAVELENGTH_COUNTS[0]
    nodes: int = _NODE_COUNTS[0]
    cut_error: float = 0.0
    lacking: float = 0.0

    def cells(self, pitch_um: float) -> tuple[int, int]:
        """Return the spacing and the side of the PSFs, an odd number, in film cells."""
        spacing = max(1, round(self.spacing_um / pitch_um))
        half = max(1, round(self.psf_um / pitch_um / 2))
        return spacing, 2 * half + 1


@lru_cache(maxsize=16)
def fitted_wavefronts(
    camera: Camera, wavelengths_nm: tuple[float, ...], nodes: int
) -> tuple[FittedWavefronts, ...]:
    """Return the wavefronts of a camera's real lens from the axis to the corner of its die, at each
    wavelength.
    """
    farthest_mm = end_mm = _farthest_mm(camera)
    while True:
        try:
            return _wavefronts(camera, wavelengths_nm, np.linspace(0.0, end_mm, nodes))
        except PixsimError:  # the image circle of one of the wavelengths ends before
            end_mm *= _CIRCLE_STEP
            if end_mm < farthest_mm / 2:  # the error has another cause
                raise


def _farthest_mm(camera: Camera) -> float:
    """Return the height of the corner of a camera's die, or of the last light of its lens's image
    circle.
    """
    assert camera.lens is not None
    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    heights_mm, _ = field_angles(camera.lens, camera.object_distance_m, corner_mm)
    return min(float(heights_mm[-1]), _illuminated_mm(camera))


def _wavefronts(
    camera: Camera, wavelengths_nm: tuple[float, ...], height_mm: Array
) -> tuple[FittedWavefronts, ...]:
    """Return the wavefronts of a camera's real lens at distances from the axis, at each
    wavelength.
    """
    assert camera.lens is not None
    lens = traced_lens(camera.lens, camera.object_distance_m)
    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    table_mm, fields = field_angles(camera.lens, camera.object_distance_m, corner_mm)
    rays = pupil_rays(lens, _odd_spline(table_mm, fields)(height_mm), np.array(wavelengths_nm))
    return tuple(
        fit_wavefronts(nm, 1e3 * height_mm, rays_at_nm)
        for nm, rays_at_nm in zip(wavelengths_nm, rays, strict=True)
    )


def _illuminated_mm(camera: Camera) -> float:
    """Return the height up to which a real lens has more than `_MIN_ILLUMINATION` of its light on
    the axis, and up to which its blur is computed.
    """
    assert camera.relative_illumination is not None
    heights_mm, relative = camera.relative_illumination
    return max(
        height_mm
        for height_mm, illumination in zip(heights_mm, relative, strict=True)
        if illumination > _MIN_ILLUMINATION
    )


def band_groups(weight: Array, groups: int = GROUPS) -> list[NDArray[np.bool_]]:
    """Return a few groups of neighbouring bands of about equal weight, (B,) each."""
    is_seen = weight > 0
    middle = np.cumsum(weight) - weight / 2
    total = max(weight.sum(), np.finfo(float).tiny)
    group = np.minimum((middle / total * groups).astype(int), groups - 1)
    return [is_seen & (group == number) for number in np.unique(group[is_seen])]


def few_wavelengths(wavelength_nm: Array, weight: Array, count: int) -> tuple[Array, Array]:
    """Return a few wavelengths, (G,), and their shares, for the mean of a smooth function over
    bands of these weights.

    They are the nodes of Gauss's quadrature, exact for polynomials of degree 2G - 1: eigenvalues of
    the matrix of the polynomials that are orthogonal under the weights (Golub and Welsch, Math.
    Comp. 23, 221, 1969), by Lanczos's steps.
    """
    is_seen = weight > 0
    nm, which = np.unique(wavelength_nm[is_seen], return_inverse=True)
    share = np.bincount(which, weight[is_seen]) / weight[is_seen].sum()
    if nm.size <= count:
        return nm, share

    middle = (nm[-1] + nm[0]) / 2
    half = (nm[-1] - nm[0]) / 2
    position = (nm - middle) / half
    basis = [np.sqrt(share)]
    matrix = np.zeros((count, count))
    for row in range(count):
        step = position * basis[-1]
        for _ in range(_ORTHOGONAL_PASSES):
            for vector in basis:
                step = step - (vector @ step) * vector
        matrix[row, row] = basis[-1] @ (position * basis[-1])
        if row + 1 < count:
            norm = np.linalg.norm(step)
            matrix[row, row + 1] = matrix[row + 1, row] = norm
            basis.append(step / norm)

    nodes, vectors = np.linalg.eigh(matrix)
    return np.clip(np.round(middle + half * nodes, 3), nm[0], nm[-1]), vectors[0] ** 2


def _traced_wavelengths(
    camera: Camera, wavelength_nm: Array, weight: Array, count: int
) -> tuple[Array, Array]:
    """Return `few_wavelengths` of light that a lens transmits.

    Light beyond the range in which all of its glasses are known counts at the ends of that range.
    """
    assert camera.lens is not None
    lens = traced_lens(camera.lens, camera.object_distance_m)
    return few_wavelengths(np.clip(wavelength_nm, *lens.known_nm), weight, count)


_Transfer = Callable[[Array, float], Array] | None
_TransformAt = Callable[[float, float], NDArray[np.complex128]]


def channel_wavefronts(
    camera: Camera, wavelength_nm: Array, weight: Array, tiling: Tiling, transfer: _Transfer = None
) -> ChannelWavefronts:
    """Return the wavefronts of light of some bands, with weights of 0 or more, (B,) each."""
    nm, share = _traced_wavelengths(camera, wavelength_nm, weight, tiling.wavelengths)
    fronts = fitted_wavefronts(camera, tuple(nm.tolist()), tiling.nodes)
    return ChannelWavefronts(fronts, share, transfer)


def thin_lens_error(
    camera: Camera, pitch_um: float, wavelength_nm: Array, weight: Array, aperture_um: float
) -> float:
    """Return a bound for the relative error of electrons if the thin lens stands for the real one:
    three effects together.

    Distortion moves light across an edge by its shift over the side of the aperture; the fall-off
    differs from Foote's; and blur differs from the thin lens's diffraction, as `picture_error` has
    it.
    """
    distortion = camera_distortion(camera)
    rows = camera.chief_ray_angle
    assert distortion is not None
    assert rows is not None
    distortion_error = 1e3 * distortion.largest_mm / aperture_um

    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    height_mm, _, relative = np.array([row for row in rows if row[0] <= corner_mm]).T
    foote = irradiance_factor(
        camera.f_number, height_mm / camera.image_distance_mm, camera.magnification
    )
    fall_off_error = float(np.abs(relative / (foote / foote[0]) - 1).max())

    error = distortion_error + fall_off_error
    if error > 1:
        return error
    light = channel_wavefronts(camera, wavelength_nm, weight, Tiling(0.0, 0.0, 0.0))
    return error + _blur_error(camera, light, pitch_um, aperture_um)


def _blur_error(
    camera: Camera, light: ChannelWavefronts, pitch_um: float, aperture_um: float
) -> float:
    """Return the largest `picture_error`, over the field, of diffraction in place of blur."""
    grid_um = pitch_um * _binned_cells(light, pitch_um)
    cells = min(_TEST_CELLS, max_psf_cells(light, grid_um))
    wavelength_nm = np.array([front.wavelength_nm for front in light.fronts])
    corner_um = float(light.fronts[0].height_um[-1])

    worst = 0.0
    for share in (0.0, 0.7, 1.0):
        x_um = share * corner_um
        window = psf_window(light, x_um, 0.0, grid_um, cells)
        frequency_cy_per_mm = np.hypot(
            np.fft.fftfreq(window, 1e-3 * grid_um)[:, None], np.fft.rfftfreq(window, 1e-3 * grid_um)
        )
        thin = white_otf(frequency_cy_per_mm, wavelength_nm, light.share, camera.effective_f_number)
        exact = np.fft.rfft2(periodic_psf(light, x_um, 0.0, grid_um, window))
        worst = max(worst, picture_error(thin.astype(complex), exact, grid_um, aperture_um))
    return worst


def _binned_cells(light: ChannelWavefronts, pitch_um: float) -> int:
    """Return how many film cells may be one along a side where errors of a blur are computed.

    On a film much finer than the lens they all lie at low frequencies, which coarser cells hold
    too.
    """
    return max(1, math.floor(_PERIOD_SHARE / (pitch_um * cutoff_per_um(light))))


def dark_share(camera: Camera) -> float:
    """Return the share of the die's area that no light of the real lens reaches."""
    assert camera.relative_illumination is not None
    heights_mm, relative = camera.relative_illumination
    midpoints = (np.arange(_DARK_CELLS) + 0.5) / _DARK_CELLS  # of a quarter of the die
    y_mm = midpoints * camera.height_mm / 2
    x_mm = midpoints * camera.die_mm / 2
    illumination = np.interp(np.hypot(x_mm, y_mm[:, None]), heights_mm, relative)
    return float(np.mean(illumination <= 0))


_BLURS: dict[str, FieldBlur] = {}
_PSFS: dict[str, RadialPsfs] = {}
_MAX_CACHED_BLURS = 8
_MAX_CACHED_BYTES = 1 << 28
# Times the cells that resolve a lens's PSFs: with larger ones, it takes less time to compute PSFs
# for each film.
_COARSE_FILM = 3.0
_SPARE_TILES = 4  # beyond the die, for which there are PSFs
# Frequencies whose values identify a transfer behind the lens.
_TRANSFER_CY_PER_MM = np.linspace(0.0, 1000.0, 17)
_DARK_CELLS = 512


def _light_key(
    camera: Camera, tiling: Tiling, wavelength_nm: Array, weight: Array, transfer: _Transfer
) -> list[object]:
    """Return everything that the PSFs of a light depend on, except for the film."""
    nm, share = _traced_wavelengths(camera, wavelength_nm, weight, tiling.wavelengths)
    transfer_values = []
    if transfer is not None:
        transfer_values = [
            transfer(_TRANSFER_CY_PER_MM, wavelength).tolist() for wavelength in nm.tolist()
        ]
    return [
        camera.without_veil.model_dump(mode="json"),
        asdict(replace(tiling, error=0.0, worst=0.0, cut_error=0.0, lacking=0.0)),
        nm.tolist(),
        share.tolist(),
        transfer_values,
    ]


def camera_psfs(
    camera: Camera,
    shape: tuple[int, int],
    pitch_um: float,
    tiling: Tiling,
    wavelength_nm: Array,
    weight: Array,
    transfer: _Transfer = None,
) -> RadialPsfs:
    """Return the PSFs of a light for the tiles of a film, from the cache if there are any.

    Films that are not much coarser than the lens share them.
    """
    cell_um = resolving_um(channel_wavefronts(camera, wavelength_nm, weight, tiling))
    if pitch_um > _COARSE_FILM * cell_um:
        cell_um = pitch_um
    key = content_hash([*_light_key(camera, tiling, wavelength_nm, weight, transfer), cell_um])
    farthest_um = farthest_tile_um(shape, pitch_um, *tiling.cells(pitch_um))

    psfs = _PSFS.pop(key, None)
    if psfs is None or psfs.max_height_um < farthest_um:
        # The next film, whose cells end elsewhere, is to have the same PSFs.
        margin_um = tiling.psf_um + _SPARE_TILES * tiling.spacing_um
        spare_um = math.hypot(*(side_um / 2 + margin_um for side_um in camera.die_um))
        psfs = radial_psfs(
            channel_wavefronts(camera, wavelength_nm, weight, tiling, transfer),
            pitch_um=cell_um,
            cells=tiling.cells(cell_um)[1],
            step_um=tiling.spacing_um / RADIAL_STEPS,
            farthest_um=max(farthest_um, spare_um),
        )

    # The last ones used stay longest.
    while _PSFS and sum(cached.cached_bytes for cached in list(_PSFS.values())) > _MAX_CACHED_BYTES:
        _PSFS.pop(next(iter(_PSFS)), None)
    _PSFS[key] = psfs
    return psfs


def camera_blur(
    camera: Camera,
    shape: tuple[int, int],
    pitch_um: float,
    tiling: Tiling,
    wavelength_nm: Array,
    weight: Array,
    transfer: _Transfer = None,
) -> FieldBlur:
    """Return the blur of a camera's real lens, from the last blurs or the cache if it is there."""
    light_key = _light_key(camera, tiling, wavelength_nm, weight, transfer)
    key = content_hash([*light_key, shape, pitch_um, cache.version_fingerprint()])
    if key in _BLURS:
        return _BLURS[key]

    spacing, cells = tiling.cells(pitch_um)
    stored = cache.arrays("psfs", key)
    if stored is not None:
        blur = blur_from_arrays(stored, shape, pitch_um, spacing, cells)
    else:
        psfs = camera_psfs(camera, shape, pitch_um, tiling, wavelength_nm, weight, transfer)
        blur = field_blur(psfs, shape, pitch_um, spacing, cells)
        cache.store_arrays("psfs", key, blur.as_arrays())

    if len(_BLURS) >= _MAX_CACHED_BLURS:
        _BLURS.clear()
    _BLURS[key] = blur
    return blur


def image_tiling(image: SpectralImage, camera: Camera) -> Tiling | None:
    """Return how the blur of a picture is computed, from its header, or None for a thin lens.

    A picture of another program has the choice of `choose_tiling` for uniform light and
    `_USUAL_TOLERANCE`.
    """
    if camera.lens is None:
        return None
    stated = image.header.get(LENS_HEADER)
    if stated is not None:
        return _stated_tiling(stated, image)
    if "camera" in image.header and "lens" not in image.header["camera"] and "plan" in image.header:
        return None  # the plan left the real lens out

    nm = tuple(image.wavelength_nm.tolist())
    return choose_tiling(
        camera,
        shape=image.shape,
        pitch_um=image.pitch_um,
        wavelength_nm=nm,
        weight=(1.0,) * len(nm),
        aperture_um=2 * image.pitch_um,
        tolerance=_USUAL_TOLERANCE,
    )


def _stated_tiling(stated: object, image: SpectralImage) -> Tiling:
    """Return the tiling of a header. Raises PixsimError if it is damaged, or far too fine."""
    max_tiles = 2 * _TILE_COUNTS[-1]
    max_cells = 2 * _PSF_SIDES[-1]
    try:
        tiling = TypeAdapter(Tiling).validate_python(stated)
        tiles = max(image.shape) * image.pitch_um / tiling.spacing_um
        cells = tiling.psf_um / image.pitch_um
        is_usable = (
            0 < tiles <= max_tiles
            and 0 <= cells <= max(max_cells, *image.shape)
            and 1 <= tiling.wavelengths <= _WAVELENGTH_COUNTS[-1]
            and 4 <= tiling.nodes <= _NODE_COUNTS[-1]
        )
    except (ValidationError, ZeroDivisionError):
        is_usable = False
    if not is_usable:
        raise invalid(
            f"'{LENS_HEADER}' of the light's header",
            f"{stated!r:.200}",
            f"at most {max_tiles} tiles across, PSFs of {max_cells} cells, and the other entries"
            f" as pixsim.render writes them",
            "Render the scene again.",
        )
    return tiling


_MTF_HEIGHTS = 9  # along the radius of the die, for a lens's MTF
_MTF_CELLS = 65  # of PSFs for an MTF, at least


def lens_mtf(
    image: SpectralImage, camera: Camera, weight: Array, frequency_cy_per_mm: Array
) -> Array | None:
    """Return the MTF of a camera's real lens, its rms over the die and over tangential and sagittal
    lines, (...) as frequencies.

    None where a picture has a thin lens, or a film that is too coarse to show the blur.

    weight : of the image's bands, (B,), 0 or more
    """
    tiling = image_tiling(image, camera)
    if tiling is None or not tiling.psf_um:
        return None

    table_cy_per_mm, mtf = _mean_mtf(
        camera,
        wavelength_nm=tuple(image.wavelength_nm.tolist()),
        weight=tuple(np.asarray(weight, float).tolist()),
        tiling=tiling,
    )
    return np.interp(np.abs(frequency_cy_per_mm), table_cy_per_mm, mtf, right=0.0)


def _area_shares(camera: Camera, heights_um: Array) -> Array:
    """Return the shares of the die's area that are nearest to each distance from the axis, (n,)."""
    height_um, width_um = camera.die_um
    midpoints = (np.arange(_AREA_POINTS) + 0.5) / _AREA_POINTS  # of a quarter of the die
    y_um = midpoints * height_um / 2
    x_um = midpoints * width_um / 2

    distance_um = np.hypot(x_um, y_um[:, None])
    nearest = np.abs(distance_um[..., None] - heights_um).argmin(axis=-1)
    return np.bincount(nearest.ravel(), minlength=heights_um.size) / nearest.size


@lru_cache(maxsize=64)
def _mean_mtf(
    camera: Camera, wavelength_nm: tuple[float, ...], weight: tuple[float, ...], tiling: Tiling
) -> tuple[Array, Array]:
    """Return frequencies in cycles/mm up to the lens's cut-off, and the MTF of `lens_mtf` there."""
    light = channel_wavefronts(camera, np.array(wavelength_nm), np.array(weight), tiling)
    pitch_um = 0.5 / cutoff_per_um(light)
    farthest_um = min(float(front.height_um[-1]) for front in light.fronts)
    heights_um = np.linspace(0.0, farthest_um, _MTF_HEIGHTS)
    area_shares = _area_shares(camera, heights_um)

    # One window for all heights, so that their MTFs have the same frequencies.
    cells = max(_MTF_CELLS, math.ceil(tiling.psf_um / pitch_um))
    window = max(psf_window(light, x_um, 0.0, pitch_um, cells) for x_um in heights_um.tolist())

    half = window // 2
    power = np.zeros(half)
    for x_um, area_share in zip(heights_um.tolist(), area_shares.tolist(), strict=True):
        otf = np.fft.rfft2(periodic_psf(light, x_um, 0.0, pitch_um, window))
        squared_mtf = np.abs(otf) ** 2
        tangential_and_sagittal = squared_mtf[0, :half] + squared_mtf[:half, 0]
        power += area_share * tangential_and_sagittal / 2

    frequency_cy_per_mm = 1e3 * np.arange(half) / (window * pitch_um)
    return np.asarray(frequency_cy_per_mm, float), np.asarray(np.sqrt(power), float)


def ideal_light(image: SpectralImage, camera: Camera) -> SpectralImage:
    """Return the light of the ideal image: on the sensor, or without distortion where
    `LensOptions.ideal` asks for it.
    """
    distortion = camera_distortion(camera)
    if camera.lens is None or distortion is None or camera.lens.ideal == "distorted":
        return image
    if image_tiling(image, camera) is None:
        return image
    planes = [np.float32(distortion.removed(plane, image.pitch_um)) for plane in image.planes]
    return image.with_planes(np.stack(planes))


@lru_cache(maxsize=64)
def choose_tiling(
    camera: Camera,
    shape: tuple[int, int],
    pitch_um: float,
    wavelength_nm: tuple[float, ...],
    weight: tuple[float, ...],
    aperture_um: float,
    tolerance: float,
) -> Tiling:
    """Return the tiling of least work within the tolerance, or the finest tiling if none is.

    Those of the packaged lenses on the default sensor are shipped, since the search takes a fifth
    of the time of a first picture.

    shape, pitch_um : (H, W) and cells of the film
    wavelength_nm, weight : (B,), of the light
    aperture_um : side of the squares that average the picture: a photodiode, or a dot
    tolerance : of the rms of a blurred picture about its mean
    """
    key = tiling_key(camera, shape, pitch_um, wavelength_nm, weight, aperture_um, tolerance)
    shipped = packaged_tables("lens_tilings").get(key)
    if shipped is not None:
        return Tiling(**shipped)

    points = _TestPoints(
        camera, shape, pitch_um, np.array(wavelength_nm), np.array(weight), aperture_um
    )
    return cache.load_or_compute(
        "tiling",
        content_hash([key, cache.version_fingerprint()]),
        TypeAdapter(Tiling).validate_python,
        lambda: _chosen_tiling(points, tolerance),
        asdict,
    )


def tiling_key(camera: Camera, *numbers: object) -> str:
    """Return the name under which a tiling is shipped or cached, from the arguments of
    `choose_tiling`.

    It is a hash of rounded numbers, since other processors compute other last digits.
    """

    def rounded(digits: str) -> float:
        return float(f"{float(digits):.{_KEY_DIGITS}g}")

    text = json.dumps([camera.without_veil.model_dump(mode="json"), *numbers])
    return content_hash(json.loads(text, parse_float=rounded))


@dataclass(frozen=True)
class _TestPoints:
    """Image points from the axis to the corner of the die where the errors of a blur are computed.

    The attributes are the arguments of `choose_tiling`. Errors are computed on cells of `grid_um`,
    which hold all details that the lens passes: on a film much finer than the lens, each stands
    for several film cells.
    """

    camera: Camera
    shape: tuple[int, int]
    pitch_um: float
    wavelength_nm: Array
    weight: Array
    aperture_um: float

    @cached_property
    def heights_um(self) -> Array:
        """Distances of the points from the axis, (n,)."""
        height_um, width_um = self.camera.die_um
        corner_um = math.hypot(width_um, height_um) / 2
        return np.array(_TEST_HEIGHTS) * min(corner_um, 1e3 * _farthest_mm(self.camera))

    @cached_property
    def places_um(self) -> list[tuple[float, float]]:
        """The points (x, y), on a diagonal of the die."""
        height_um, width_um = self.camera.die_um
        diagonal_um = math.hypot(width_um, height_um)
        return [
            (distance_um * width_um / diagonal_um, distance_um * height_um / diagonal_um)
            for distance_um in self.heights_um.tolist()
        ]

    @cached_property
    def area_shares(self) -> list[float]:
        """Shares of the die's area for which the points stand."""
        shares: list[float] = _area_shares(self.camera, self.heights_um).tolist()
        return shares

    @cached_property
    def bins(self) -> int:
        """Film cells along a side of a cell of the grid."""
        return _binned_cells(self.traced_light(1), self.pitch_um)

    @property
    def grid_um(self) -> float:
        """Side of the cells on which errors are computed."""
        return self.bins * self.pitch_um

    def grid_cells(self, film_cells: int) -> int:
        """Return the odd number of cells of the grid along the side of a PSF of film cells."""
        return 2 * math.ceil(film_cells // 2 / self.bins) + 1

    def traced_light(self, count: int) -> ChannelWavefronts:
        """Return the light with wavefronts that are traced at the points, not interpolated.

        count : number of wavelengths
        """
        nm, share = _traced_wavelengths(self.camera, self.wavelength_nm, self.weight, count)
        fronts = _wavefronts(self.camera, tuple(nm.tolist()), 1e-3 * self.heights_um)
        return ChannelWavefronts(fronts, share)

    def window(self, light: ChannelWavefronts, cells: int) -> int:
        """Return the cells along a window that holds a PSF of so many cells at every point."""
        return max(psf_window(light, x, y, self.grid_um, cells) for x, y in self.places_um)

    def transforms_at(
        self,
        transform: _TransformAt,
        window: int,
        points: Sequence[int] = range(len(_TEST_HEIGHTS)),
    ) -> NDArray[np.complex128]:
        """Return the transforms of PSFs at points, (points, window, window // 2 + 1).

        transform : place (x, y) in µm -> transform of its PSF
        """
        transforms = np.empty((len(points), window, window // 2 + 1), complex)

        def compute(index: int) -> None:
            x_um, y_um = self.places_um[points[index]]
            transforms[index] = transform(x_um, y_um)

        in_threads(compute, range(len(points)), MIN_THREADED_NUMBERS)
        return transforms

    def transforms(self, light: ChannelWavefronts, window: int) -> NDArray[np.complex128]:
        """Return the transforms of the exact PSFs of a light at all points."""

        def transform(x_um: float, y_um: float) -> NDArray[np.complex128]:
            psf = periodic_psf(light, x_um, y_um, self.grid_um, window)
            return np.asarray(np.fft.rfft2(psf))

        return self.transforms_at(transform, window)

    def error(self, approximate: NDArray[np.complex128], exact: NDArray[np.complex128]) -> float:
        """Return `picture_error` over the area of the die."""
        return picture_error(
            approximate, exact, self.grid_um, self.aperture_um, share=self.area_shares
        )

    def worst_error(
        self, approximate: NDArray[np.complex128], exact: NDArray[np.complex128]
    ) -> float:
        """Return the largest `picture_error` of a point."""
        return max(
            picture_error(approximate_at_point, exact_at_point, self.grid_um, self.aperture_um)
            for approximate_at_point, exact_at_point in zip(approximate, exact, strict=True)
        )


def _tiling_without_blur(points: _TestPoints, light: ChannelWavefronts) -> Tiling:
    """Return the tiling of a film whose cells are too coarse for waves, with the error of leaving
    the blur of rays out.
    """
    camera = points.camera
    pitch_um = points.pitch_um
    frequency_y = np.fft.fftfreq(_COARSE_WINDOW, pitch_um)
    frequency_x = np.fft.rfftfreq(_COARSE_WINDOW, pitch_um)

    # The transform of a PSF of rays is the mean of their phases.
    exact = np.zeros((points.heights_um.size, frequency_y.size, frequency_x.size), complex)
    outside_share = np.zeros(points.heights_um.size)
    for front, share in zip(light.fronts, light.share, strict=True):
        for index, height_um in enumerate(points.heights_um.tolist()):
            misses_um = front.misses_um(height_um)
            sagittal = np.exp(-2j * np.pi * frequency_y[:, None] * misses_um[:, 0])
            radial = np.exp(-2j * np.pi * frequency_x[:, None] * misses_um[:, 1])
            exact[index] += share / len(misses_um) * (sagittal @ radial.T)

            is_outside = np.abs(misses_um).max(axis=-1) > pitch_um / 2
            outside_share[index] += share * np.mean(is_outside)

    distortion = camera_distortion(camera)
    assert distortion is not None
    relative_error = moved_error(distortion, pitch_um, frequency_y * pitch_um)
    without_blur = 1 + relative_error[:, : frequency_x.size] + 0j
    approximate = np.broadcast_to(without_blur, exact.shape)

    error = points.error(approximate, exact)
    return Tiling(
        spacing_um=1e3 * max(camera.die_mm, camera.height_mm),
        psf_um=0.0,
        error=error,
        worst=points.worst_error(approximate, exact),
        cut_error=error,
        lacking=float(outside_share.max()),
    )


def _chosen_tiling(points: _TestPoints, tolerance: float) -> Tiling:
    """Return the tiling of `choose_tiling`: wavelengths, nodes, size of PSFs and tiles in turn."""
    for wavelengths in _WAVELENGTH_COUNTS:
        light = points.traced_light(wavelengths)
        finer_light = points.traced_light(2 * wavelengths)
        max_cells = max_psf_cells(light, points.grid_um)
        if not max_cells:
            return _tiling_without_blur(points, light)

        window = points.window(finer_light, min(points.grid_cells(_TEST_CELLS), max_cells))
        exact = points.transforms(light, window)
        wavelength_error = points.error(exact, points.transforms(finer_light, window))
        if wavelength_error <= _LIGHT_SHARE * tolerance:
            break

    for nodes in _NODE_COUNTS:
        counts = Tiling(0.0, 0.0, 0.0, wavelengths=wavelengths, nodes=nodes)
        interpolated = channel_wavefronts(
            points.camera, points.wavelength_nm, points.weight, counts
        )
        node_error = points.error(points.transforms(interpolated, window), exact)
        if node_error <= _LIGHT_SHARE * tolerance:
            break

    largest_side = points.grid_cells(_PSF_SIDES[-1])
    sides = [side for side in map(points.grid_cells, _PSF_SIDES) if side < max_cells]
    for cells in [*sides, min(max_cells, largest_side)]:
        needed_window = points.window(light, cells)
        if window < needed_window:
            window = needed_window
            exact = points.transforms(light, window)

        psfs = [_cut_psf(transform, cells) for transform in exact]
        cut = np.array([psf_transform([(1.0, psf)], points.grid_um, window) for psf in psfs])
        cut_error = points.error(cut, exact)
        if cut_error <= _CUT_SHARE * tolerance:
            break

    tiling = Tiling(
        spacing_um=0.0,
        psf_um=cells * points.grid_um,
        error=0.0,
        wavelengths=wavelengths,
        nodes=nodes,
        cut_error=cut_error,
        lacking=max(0.0, *(psf.tail_share for psf in psfs)),
    )
    # Errors that no number of tiles makes smaller.
    residual_error = 2 * math.pi * max(front.residual_waves for front in light.fronts)
    fixed_error = residual_error + wavelength_error + _distortion_error(points, exact)
    return _with_fewest_tiles(points, tiling, exact, fixed_error, tolerance)


def _cut_psf(transform: NDArray[np.complex128], cells: int) -> Psf:
    """Return the middle cells of a PSF with this transform (window, window // 2 + 1)."""
    window = len(transform)
    psf = np.fft.fftshift(np.fft.irfft2(transform, (window, window)))
    middle = slice(window // 2 - cells // 2, window // 2 + cells // 2 + 1)
    return Psf(psf[middle, middle].astype(np.float32))


def _distortion_error(points: _TestPoints, exact: NDArray[np.complex128]) -> float:
    """Return the error of a picture whose details `Distortion.applied` moves."""
    distortion = camera_distortion(points.camera)
    assert distortion is not None
    window, columns = exact.shape[-2:]
    cycles_per_film_cell = np.fft.fftfreq(window) / points.bins
    relative_error = moved_error(distortion, points.pitch_um, cycles_per_film_cell)
    return points.error(exact * (1 + relative_error[:, :columns]), exact)


def _with_fewest_tiles(
    points: _TestPoints,
    tiling: Tiling,
    exact: NDArray[np.complex128],
    fixed_error: float,
    tolerance: float,
) -> Tiling:
    """Return a tiling with the fewest tiles within the tolerance, and its errors.

    tiling : with its PSFs, wavelengths and nodes
    exact : transforms of the PSFs at the points
    fixed_error : with any number of tiles
    """
    window = exact.shape[-2]
    cells = round(tiling.psf_um / points.grid_um)
    count = _TILE_COUNTS[0]
    other_heights = [
        index for index in range(len(_TEST_HEIGHTS)) if index not in _FIRST_TEST_HEIGHTS
    ]
    while True:
        spacing = max(_MIN_SPACING, round(max(points.shape) / count))
        tiling = replace(tiling, spacing_um=spacing * points.pitch_um)
        psfs = camera_psfs(
            points.camera,
            points.shape,
            points.pitch_um,
            tiling,
            points.wavelength_nm,
            points.weight,
        )

        def between_tiles(
            x_um: float, y_um: float, psfs: RadialPsfs = psfs, spacing: int = spacing
        ) -> NDArray[np.complex128]:
            weighted_psfs = psfs_between_tiles(
                psfs, x_um, y_um, points.grid_um, spacing / points.bins, cells
            )
            return psf_transform(weighted_psfs, points.grid_um, window)

        # The points where too few tiles show first decide whether the others are worth their time.
        is_finest = count == _TILE_COUNTS[-1] or spacing == _MIN_SPACING
        approximate = exact.copy()
        approximate[_FIRST_TEST_HEIGHTS] = points.transforms_at(
            between_tiles, window, _FIRST_TEST_HEIGHTS
        )
        if is_finest or fixed_error + points.error(approximate, exact) <= tolerance:
            approximate[other_heights] = points.transforms_at(between_tiles, window, other_heights)

        error = fixed_error + points.error(approximate, exact)
        if is_finest or error <= tolerance:
            worst = fixed_error + points.worst_error(approximate, exact)
            return replace(tiling, error=error, worst=worst)

        needed = count * (error / tolerance) ** (1 / _TILE_ORDER)
        count = next(
            (larger for larger in _TILE_COUNTS if larger >= needed and larger > count),
            _TILE_COUNTS[-1],
        )
