"""Blur that varies over the field, against closed forms, superposition point by point and
conservation of light; real lenses in a camera, against their rays, the thin lens that stands for
them, and the closed forms of a thin real lens.
"""

import math
import re
import warnings
from collections.abc import Callable
from dataclasses import asdict, astuple, replace
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.blur import point_spread
from helpers.claims import Claim, check
from scipy import integrate, interpolate, ndimage, signal, special

from pixsim import PixsimError, SpectralImage, optics
from pixsim.base.toml import packaged
from pixsim.optics import camera_lens
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Distortion,
    Tiling,
    _area_shares,
    _binned_cells,
    _blur_error,
    _chosen_tiling,
    _cut_psf,
    _distortion_error,
    _stated_tiling,
    _TestPoints,
    _tiling_without_blur,
    _with_fewest_tiles,
    band_groups,
    camera_blur,
    camera_distortion,
    camera_psfs,
    camera_with_lens,
    channel_wavefronts,
    choose_tiling,
    dark_share,
    few_wavelengths,
    field_angles,
    fitted_wavefronts,
    ideal_light,
    lens_mtf,
    lens_on_die,
    moved_error,
    rendered_camera,
    thin_lens_error,
    traced_lens,
    without_lens,
)
from pixsim.optics.camera_light import camera_pupil
from pixsim.optics.field_blur import (
    BAND_END,
    OUTLINE_ANGLES,
    ChannelWavefronts,
    FieldBlur,
    FittedWavefronts,
    Psf,
    PupilRays,
    RadialPsfs,
    _band_weight,
    _cubic_weights,
    _share_inside,
    _spline_values,
    _tile_psfs,
    _turned_window_cells,
    cutoff_per_um,
    distinct_tiles,
    farthest_tile_um,
    field_blur,
    fit_wavefronts,
    least_squares,
    max_psf_cells,
    mean_of_phase,
    periodic_psf,
    picture_error,
    powers,
    psf_transform,
    psf_window,
    psfs_between_tiles,
    pupil_function,
    radial_psfs,
    resolving_um,
    veil_mtf,
)
from pixsim.optics.glass import constant_glass
from pixsim.optics.lens import Lens, Outline, lens_from_prescription, load_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.lens_waves import _near, _sphere_cosines, pupil_rays
from pixsim.optics.prescription import Prescription, Surface
from pixsim.optics.thin_lens import irradiance_factor, thin_lens_pupil

# Blur of wavefronts

NM = 550.0
F_NUMBER = 8.0
COARSE_UM = 4.0  # cells that do not resolve what a lens of f/4 passes


def thin_lens_light(
    f_number: float,
    heights_mm: np.ndarray,
    waves: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    shift_um: float = 0.0,
) -> ChannelWavefronts:
    """Return the light of a thin lens 1 mm from its image, whose OPD is a function of coordinates
    on the lens, in radii, and of the tangent of the field.
    """
    radius = np.sqrt((np.arange(16) + 1) / 16)[:, None]  # the last ring is the rim
    angle = np.arange(48) * (2 * np.pi / 48)
    u, v = np.array([radius * np.sin(angle), radius * np.cos(angle)]).reshape(2, -1)
    fronts = []
    for tangent in heights_mm.tolist():
        outline, _ = thin_lens_pupil(f_number, tangent, 90.0).boundary(
            np.linspace(0, 2 * np.pi, 721)
        )
        # A point of the lens on the side of the image point sends its ray at a smaller angle.
        slopes = np.stack([u, v], -1) * 0.5 / f_number + [0.0, tangent]
        cosines = slopes / np.sqrt(1 + np.square(slopes).sum(-1, keepdims=True))
        opd = waves(u, v, tangent) + 0 * u
        fronts.append(PupilRays(cosines, opd, outline, (1e3 + shift_um) * tangent))
    return ChannelWavefronts([fit_wavefronts(NM, 1e3 * heights_mm, fronts)], np.ones(1))


def aberrated(u: np.ndarray, v: np.ndarray, tangent: float) -> np.ndarray:
    """Return spherical aberration, coma, astigmatism and field curvature, in waves."""
    square = u**2 + v**2
    return (
        0.3 * square**2
        + 1.5 * tangent * v * square
        + 6 * tangent**2 * v**2
        - 4 * tangent**2 * square
    )


@pytest.fixture(scope="module")
def sharp_light() -> ChannelWavefronts:
    return thin_lens_light(4.0, np.linspace(0, 0.6, 17), aberrated)


def otf_along(psf: np.ndarray, pitch_um: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies in cycles/mm, and the OTF along columns and along rows."""
    half = len(psf) // 2
    spectrum = np.fft.fft2(psf)[:half, :half]
    return np.fft.rfftfreq(len(psf), pitch_um * 1e-3)[:half], spectrum[0], spectrum[:, 0]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# Kernels


TURNS = np.linspace(-0.5, 0.5, 101, dtype=np.float32)
HEIGHTS_MM = np.linspace(0, 1, 33)


def spline_between_cells(frequency: float, shift: float) -> complex:
    """Return a wave, of whole periods in 40 cells, between its cells by SciPy's spline of degree 5,
    relative to the wave.
    """
    wave = np.exp(2j * np.pi * frequency * np.arange(40))
    return ndimage.shift(wave, -shift, order=5, mode="grid-wrap")[0] * np.exp(
        -2j * np.pi * frequency * shift
    )


def softening(cy_per_mm: np.ndarray, nm: float) -> np.ndarray:
    return np.exp(-((cy_per_mm * nm * 1e-4) ** 2))


def ideal_light_at(f_number: float) -> ChannelWavefronts:
    return thin_lens_light(f_number, np.zeros(1), lambda u, v, _: 0 * u)


def softened_otf() -> np.ndarray:
    """Return the OTF of 550 and 650 nm through an f/200 and a transfer that differs for them."""
    (front,) = ideal_light_at(200.0).fronts
    light = ChannelWavefronts(
        [front, replace(front, wavelength_nm=650.0)], np.array([0.3, 0.7]), softening
    )
    return np.array(otf_along(periodic_psf(light, 0.0, 0.0, 20.0, 400), 20.0)[1:])


def otf_error(pitch_um: float) -> float:
    """Return `picture_error` of the OTF of f/16 for that of f/8, on 128 cells."""
    frequency = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(128)) / (1e-3 * pitch_um)
    f16, f8 = (
        optics.diffraction_otf(frequency, NM, math.hypot(1, 2 * n) / 2) + 0j for n in (16.0, 8.0)
    )
    return picture_error(f16, f8, pitch_um, 5.0)


def is_usable(**fields: float) -> bool:
    """Return whether a tiling is accepted for a picture of 8 × 64 cells of 2 µm."""
    image = SpectralImage([550.0], 10.0, 2.0, data=np.ones((8, 64, 1)))
    try:
        return bool(
            _stated_tiling({"spacing_um": 128.0, "psf_um": 8.0, "error": 0.0} | fields, image)
        )
    except PixsimError:
        return False


# Numbers of a wavefront that are cubic in the height, as odd and even ones are.
def numbers_at(height_um: float, shrinking: float = 0.0) -> np.ndarray:
    even, odd = 1 - shrinking * height_um**2, height_um - 0.1 * height_um**3
    waves = TERM_WAVES * np.where(powers()[:, 1] % 2, odd, even)
    outline = 1 + 0.05 * odd * np.cos(PHI) + 0.1 * even * np.sin(PHI)
    return np.r_[0.1 * even, 0.2 * even, odd, waves, outline]


def wavefronts_at(heights_um: list[float], shrinking: float = 0.0) -> FittedWavefronts:
    numbers = [numbers_at(height_um, shrinking) for height_um in heights_um]
    return FittedWavefronts(NM, np.array(heights_um), np.array(numbers), 0.0)


# Those that are fitted to rays through half of the stop, with the outline in any order.
def fitted_numbers(side: int) -> np.ndarray:
    half, lateral_um, waves, outline = np.split(numbers_at(1.0), [2, 3, -OUTLINE_ANGLES])
    rim = np.stack([-side * np.sin(PHI), np.cos(PHI)], -1)
    u, v = np.concatenate([radius * rim for radius in np.sqrt(np.arange(1, 17) / 16)]).T * [
        [-1],
        [1],
    ]
    rays = PupilRays(
        np.stack([half[0] * u, half[1] * v + 0.3], -1),
        waves @ [u**a * v**b for a, b in powers()],
        RNG.permutation(half * rim * outline[:, None] + [0.0, 0.3]),
        7.0 + float(lateral_um[0]),
    )
    return fit_wavefronts(NM, np.array([7.0]), [rays]).numbers[0]


def residual_of_rays(count: int) -> float:
    return fit_wavefronts(
        NM,
        np.zeros(1),
        [PupilRays(RNG.uniform(-1, 1, (count, 2)), np.zeros(count), np.ones((4, 2)), 0.0)],
    ).residual_waves


# Coordinates of samples around the middle, in the frame of a field: radial + 1j sagittal.
def in_its_field(shape: tuple[int, ...], step: float, azimuth: float) -> np.ndarray:
    turned = step * np.exp(-1j * azimuth)
    return np.add.outer(
        *(
            turned * unit * (np.arange(n) - (n - 1) / 2)
            for n, unit in zip(shape, (1j, 1), strict=True)
        )
    )


# The largest phase that the closed form of a wavefront leaves within 0.93 of an elliptic pupil: a
# term left out is 0.1 at the rim.
def left_phase(azimuth: float) -> float:
    numbers = np.r_[0.1, 0.06, 3.0, TERM_WAVES, np.ones(OUTLINE_ANGLES)]
    amplitude, _ = pupil_function(numbers, NM, azimuth, 0.1 / 40)
    field = in_its_field(amplitude.shape, 0.1 / 40, azimuth)
    u, v = field.imag / 0.1, field.real / 0.06
    waves = sum(c * u**a * v**b for c, (a, b) in zip(TERM_WAVES, powers(), strict=True))
    left = np.angle(amplitude * np.exp(2j * np.pi * (waves + field.real * 3e3 / NM)))
    return float(np.abs(left[np.hypot(u, v) < 0.93]).max())


# The rms error at the edge of an elliptic pupil that lies 0.3 of its half width outwards, or within
# it, against means over 15 × 15 points; the phase rises outwards by so many waves a sample.
def pupil_error(is_edge: bool, azimuth: float, rise: float) -> float:
    numbers = np.r_[0.1, 0.06, rise * 16 * NM * 1e-2, 0 * TERM_WAVES, MOVED]
    got, _ = pupil_function(numbers, NM, azimuth, 0.1 / 16)
    field = in_its_field(tuple(15 * n for n in got.shape), 0.1 / 240, azimuth)
    is_inside = np.hypot(field.imag / 0.1, field.real / 0.06 - 0.3) < 1
    share, wanted = (
        points.reshape(len(got), 15, -1, 15).mean((1, 3))
        for points in (is_inside, is_inside * np.exp(-2j * np.pi * rise * 160 * field.real))
    )
    return rms(np.abs(got - wanted)[(share > 0) & (share < 1) if is_edge else share == 1])


def quadratic(z: np.ndarray) -> np.ndarray:
    return 3 + (z**2 * (4.5 - 1.5j)).real + 0.5 * np.abs(z) ** 2


# The errors of a picture that is moved, against Gauss's quadrature over its cells, which come from
# (0.95 + c r²) r, with the same scale beyond an end; it is level where a cell comes from, or on the
# axis.
def moved_quadratic_errors(cubic: float, end_mm: float, cell: complex = 0.0) -> np.ndarray:
    height_mm = np.linspace(0, end_mm, 129)
    z_mm = 20e-3 * np.add.outer(1j * np.arange(-19.5, 20), np.arange(-31.5, 32))
    level_mm = 20e-3 * cell * (0.95 + cubic * abs(20e-3 * cell) ** 2)
    got = Distortion(height_mm, 0.95 * height_mm + cubic * height_mm**3).applied(
        quadratic(1.1 * z_mm - level_mm) + 22e-3**2 / 12, 20.0, 1.1
    )
    node, weight = (part / 2 for part in np.polynomial.legendre.leggauss(4))
    wanted = sum(
        share
        * quadratic(place * (0.95 + cubic * np.minimum(np.abs(place), end_mm) ** 2) - level_mm)
        for step, share in zip(
            np.add.outer(1j * node, node).flat, np.outer(weight, weight).flat, strict=True
        )
        for place in [z_mm + 20e-3 * step]
    )
    return np.where(np.abs(np.abs(z_mm) - end_mm) > 0.03, np.abs(got - wanted), 0)


def points_on(camera: Camera, heights_um: np.ndarray, bins: int = 1) -> _TestPoints:
    points = _TestPoints(camera, (10, 10), 20.0, np.ones(1), np.ones(1), 30.0)
    vars(points).update(bins=bins, area_shares=[1.0], heights_um=heights_um)
    return points


# Tiles of 4 cells, whose PSFs of 5 cells have no symmetry but that of a round lens.
def blur_of_random_psfs(shape: tuple[int, int]) -> FieldBlur:
    return FieldBlur(
        shape,
        2.0,
        4,
        {
            (x, y): Psf((rng.uniform(0.7, 0.9) * kernel / kernel.sum()).astype(np.float32))
            for rng in [np.random.default_rng(6)]
            for x, y in distinct_tiles(shape, 4)
            for part in [rng.random((5, 5))]
            for upright in [part + (y == 0) * part[::-1]]
            for even in [upright + (x == 0) * upright[:, ::-1]]
            for kernel in [even + (x == y) * even.T]
        },
    )


# The weights of all tiles over a picture, (H, W), and their PSFs in its axes.
def tiles_of(blur: FieldBlur) -> list[tuple[np.ndarray, np.ndarray]]:
    down, across = (
        _cubic_weights(np.arange(-9, 10)[:, None] - (np.arange(n) - (n - 1) / 2) / 4)
        for n in blur.shape
    )
    return [
        (np.outer(row, column), kernel[:: 1 if y >= 0 else -1, :: 1 if x >= 0 else -1])
        for (y, row), (x, column) in product(enumerate(down, -9), enumerate(across, -9))
        if row.any() and column.any()
        for places in [((abs(x), abs(y)), (abs(y), abs(x)))]
        for kernel in [
            blur.psfs[places[0]].kernel if places[0] in blur.psfs else blur.psfs[places[1]].kernel.T
        ]
    ]


PHI = np.linspace(0, np.pi, OUTLINE_ANGLES)
MOVED = 0.3 * np.cos(PHI) + np.sqrt(1 - np.square(0.3 * np.sin(PHI)))  # a disc's outline
TERM_WAVES = np.random.default_rng(5).normal(0, 0.05, len(powers()))
OTF_CY_PER_MM = np.arange(200) / 8.0
F16 = Camera(focal_length_mm=1.0, f_number=16.0, object_distance_m=1e6)
MOVED = 0.3 * np.cos(PHI) + np.sqrt(1 - np.square(0.3 * np.sin(PHI)))
RNG = np.random.default_rng(3)
U, V = RNG.uniform(-0.7, 0.7, (2, 280))
TERMS = np.array([U**a * V**b for a, b in powers()])
VALUES = RNG.normal(size=280)
TILES = blur_of_random_psfs((9, 17))
PLACES = SimpleNamespace(at=lambda places_um, *_: places_um)  # in place of their PSFs
KERNELS = [
    # The MTF of light beyond a radius r is z F(z), F' = -J0(z)/z². SciPy before 1.17 is wrong
    # beyond z = 20.
    *(
        Claim(
            f"a veil falls as the cube of the distance, from {z:g}",
            lambda z=z: np.subtract(
                *veil_mtf(np.array([z, 1.4 * z]) / (2 * np.pi * 40e-3), 40.0) / [z, 1.4 * z]
            ),
            integrate.quad(lambda z: special.j0(z) / z**2, z, 1.4 * z, epsabs=1e-12)[0],
            atol=1e-10,
            why="quadrature",
        )
        for z in (0.5, 5.0, 19.0, 21.0, 60.0)
    ),
    Claim(
        "least squares leave what LAPACK's do",
        lambda: least_squares(TERMS, VALUES)[1],
        VALUES - np.linalg.lstsq(TERMS.T, VALUES, rcond=None)[0] @ TERMS,
        atol=1e-10,
    ),
    Claim(
        "and fit as these",
        lambda: least_squares(TERMS, VALUES)[0] @ TERMS,
        np.linalg.lstsq(TERMS.T, VALUES, rcond=None)[0] @ TERMS,
        atol=1e-9,
    ),
    Claim(
        "the second of two equal terms has no coefficient",
        lambda: least_squares(TERMS[[1, 1]], TERMS[1])[0],
        [1.0, 0.0],
        atol=1e-12,
    ),
    *(
        Claim(
            f"PSFs reach as far as tiles and points amid them: {cells} cells, {spacing} apart",
            lambda cells=cells, spacing=spacing, psf_cells=psf_cells: max(
                farthest_tile_um((cells, cells), 0.7, spacing, psf_cells),
                0.7 * (cells / 2 + 1.5 * spacing) * math.sqrt(2),  # around a corner amid tiles
                *(
                    math.hypot(*place) * spacing * 0.7
                    for place in distinct_tiles((cells + psf_cells - 1,) * 2, spacing)
                ),
            ),
            math.sqrt(2) * (math.ceil((cells + psf_cells - 2) / 2 / spacing) + 1.5) * spacing * 0.7,
            rtol=1e-12,
        )
        for cells, spacing, psf_cells in (
            (128, 5, 9),
            (96, 8, 17),
            (9, 8, 3),
            (40, 4, 33),
            (1024, 43, 65),
        )
    ),
    Claim(
        "the mean of a phase is its sinc",
        lambda: mean_of_phase(TURNS),
        np.sinc(TURNS),
        atol=1e-5,
        why="the series",
    ),
    Claim(
        "and nothing where it turns faster",
        lambda: mean_of_phase(np.array([1.0, 1.5, 300.0, 1e15], np.float32)),
        np.zeros(4),
        atol=0.01,
        why="aberrations of many waves",
    ),
    Claim(
        "waves a quarter of a cell between cells have the error of SciPy's spline",
        lambda: moved_error(
            Distortion(HEIGHTS_MM, (1 - 1e-6) * HEIGHTS_MM), 1e-3 / 0.25, np.array([0.0, 0.2])
        )[0, 1],
        abs(spline_between_cells(0.2, 0.25) - 1),
        rtol=3e-5,
        why="images beyond the fourth, and a scale of 1 - 1e-6",
    ),
    # Cells 1/m as large, m² = 1/q, cost (πf)⁴ (1 - q)(3 - 7q)/360 by the series of their means:
    # those at the corner, where m is 0.9, and on the axis none.
    Claim(
        "cells of another size cost the fourth power of the frequency",
        lambda: moved_error(
            Distortion(HEIGHTS_MM, HEIGHTS_MM - HEIGHTS_MM**3 / 30), 1e9, np.array([0.0, 0.03])
        )[0, 1],
        (0.03 * np.pi) ** 4 * (1 - 0.81**-1) * (3 - 7 * 0.81**-1) / 360,
        rtol=0.03,
        why="the next term, (2πf)²",
    ),
    *(
        Claim(
            f"waves of {f} in cells of another size, corrected by five samples",
            lambda f=f: moved_error(
                Distortion(HEIGHTS_MM, HEIGHTS_MM - HEIGHTS_MM**3 / 30), 1e9, np.array([0.0, f])
            )[0, 1],
            abs(1 - np.sinc(f / 0.9) * (1 + (1 - 0.9**-2) / 24 * curvature.real) / np.sinc(f)),
            rtol=1e-6,
            why="a radial scale of 0.9 in the corner",
        )
        for f in (0.1, 0.2)
        for wave in [np.exp(2j * np.pi * f * np.arange(-2, 3))]
        for curvature in [wave @ np.array([-1, 16, -30, 16, -1]) / 12]
    ),
    Claim(
        "a picture that is as much larger as its film costs nothing",
        lambda: moved_error(Distortion(HEIGHTS_MM, 1.2 * HEIGHTS_MM), 9.0, np.array([0.0, 0.2])),
        np.zeros((2, 2)),
        atol=1e-12,
    ),
    Claim(
        "a transfer behind the lens multiplies the OTF of each wavelength",
        softened_otf,
        [
            sum(
                share
                * optics.diffraction_otf(OTF_CY_PER_MM, nm, math.hypot(1, 400) / 2)
                * softening(OTF_CY_PER_MM, nm)
                for share, nm in ((0.3, 550.0), (0.7, 650.0))
            )
        ]
        * 2,
        atol=1e-3,
        why="samples of the pupil",
    ),
    Claim(
        "diffraction of f/16 in place of f/8 on fine and coarse films: the error of its OTF",
        lambda: [
            _blur_error(F16, ideal_light_at(8.0), pitch_um, 5.0) for pitch_um in (0.1, 1.0, 4.0)
        ],
        [otf_error(pitch_um) for pitch_um in (1.0, 1.0, 4.0)],
        rtol=3e-3,
        why="frequencies of another window",
    ),
    Claim(
        "cells of errors are at most a quarter of the period of the cut-off",
        lambda: [_binned_cells(ideal_light_at(8.0), pitch_um) for pitch_um in (0.1, 0.5, 2.0)],
        np.maximum(1, np.floor(0.25 * 550e-3 * math.hypot(1, 16) / 2 / np.array([0.1, 0.5, 2.0]))),
    ),
    *(
        Claim(
            f"wavefronts are cubic between heights and up to one step beyond: {height_um:g}",
            lambda height_um=height_um, shrinking=shrinking: wavefronts_at(
                [0.0, 1.0, 2.0, 3.0, 4.0], shrinking
            ).at(height_um),
            numbers_at(wanted_um, shrinking),
            atol=1e-12,
        )
        for height_um, wanted_um, shrinking in (
            (0.4, 0.4, 0.01),
            (2.7, 2.7, 0.01),
            (4.5, 4.5, 0.01),
            (9.0, 5.0, 0.0162),
            (9.0, 4.0, 0.0166),  # where half widths are less than 0.8 of the last ones
        )
    ),
    *(
        Claim(
            "rays on Vogel's spiral miss by the slopes of the wavefront",
            lambda: wavefronts_at([1.0]).misses_um(0.0),
            [0, 0.9]
            + NM
            * 1e-3
            / np.array([0.1, 0.2])
            * np.transpose(
                sum(
                    wave * np.array([a * u ** max(a - 1, 0) * v**b, b * u**a * v ** max(b - 1, 0)])
                    for wave, (a, b) in zip(numbers_at(1.0)[3:], powers(), strict=False)
                )
            ),
            rtol=1e-9,
            atol=1e-12,
        )
        for radius, turn in [
            (np.sqrt((np.arange(200) + 0.5) / 200), np.arange(200) * np.pi * (3 - math.sqrt(5)))
        ]
        for u, v in [(radius * np.sin(turn), radius * np.cos(turn))]
    ),
    *(
        Claim(
            f"a wavefront is fitted to rays through half of the stop: {side}",
            lambda side=side: fitted_numbers(side),
            numbers_at(1.0),
            atol=1e-10,
        )
        for side in (1, -1)
    ),
    Claim("two rays for each coefficient are enough", lambda: residual_of_rays(2 * 49), 0.0),
    *(
        Claim(
            "terms of any size are fitted",
            lambda sizes=sizes: sizes[:, 0] * least_squares(sizes * TERMS, VALUES)[0] @ TERMS,
            np.linalg.lstsq(TERMS.T, VALUES, rcond=None)[0] @ TERMS,
            atol=1e-9,
        )
        for sizes in [10.0 ** -np.arange(len(TERMS))[:, None]]
    ),
    Claim(
        "area of a square beside an edge",
        lambda: _share_inside(np.linspace(-0.9, 0.9, 19)[:, None], np.array([0, 0.1, 0.5, 1])),
        np.mean(
            [
                np.clip(np.linspace(-0.4, 1.4, 19)[:, None] + np.array([0, 0.1, 0.5, 1]) * t, 0, 1)
                for t in (np.arange(500) - 249.5) / 500
            ],
            axis=0,
        ),
        atol=1e-5,
        why="500 lines",
    ),
    *(
        Claim(
            f"phases of a pupil at {azimuth}",
            lambda azimuth=azimuth: left_phase(azimuth),
            0.0,
            atol=2e-6,
            why="single precision",
        )
        for azimuth in (0.0, 0.6, -2.7)
    ),
    *(
        Claim(
            f"a pupil at {azimuth}, whose phases rise by {rise}: {'its edge' if is_edge else 'inside'}",
            lambda azimuth=azimuth, rise=rise, is_edge=is_edge: pupil_error(is_edge, azimuth, rise),
            0.0,
            atol=atol,
            why="straight edges, the middle of triangles, and points",
        )
        for azimuth in (0.0, 0.6, -2.7)
        for rise in (0.0, 0.05)
        for is_edge, atol in ((True, 0.011), (False, 1.5e-3))
    ),
    *(
        Claim(
            f"area of a pupil of half widths {half}, moved by 0.3 of them: πab",
            lambda half=half: pupil_function(
                np.r_[half, 0.0, 0 * TERM_WAVES, MOVED], NM, 0.4, 0.1 / 80
            )[1],
            np.pi * 80**2 * half[1] / half[0],
            rtol=3e-5,
            why="chords of 1°, and samples",
        )
        for half in ((0.1, 0.1), (0.1, 0.06))
    ),
    Claim(
        "cut-off 2 NA/λ, films that hold it, and PSFs of at most 320 samples of the pupil",
        lambda: [
            cutoff_per_um(ideal_light_at(8.0)),
            cutoff_per_um(ChannelWavefronts([wavefronts_at([0.0, 1.0])], np.ones(1))),
            resolving_um(ideal_light_at(8.0)),
            *(max_psf_cells(ideal_light_at(8.0), pitch_um) for pitch_um in (1.0, 200.0, 320.0)),
        ],
        [
            1 / (NM * 1e-3 * math.hypot(8.0, 0.5)),
            2 * 0.2 / (NM * 1e-3),
            1.6 * (1 - BAND_END) / 2 * NM * 1e-3 * math.hypot(8.0, 0.5),
            *(939, 3, 0),  # of 940.4, 4.7 and 2.9
        ],
        rtol=1e-12,
    ),
    Claim(
        "windows of 64 samples of the pupil, or of 1.5 PSFs",
        lambda: [psf_window(ideal_light_at(8.0), 0.0, 0.0, 1.0, cells) for cells in (33, 241)],
        [2 * 144, 2 * 192],  # fast, from 282.1 and 361.5
    ),
    Claim(
        "a raised cosine at the end of the film's band",
        lambda: _band_weight(np.array([0.0, 0.44, 0.46, 0.5, -0.525, 0.56, 3.0])),
        [1, 1, (1 + math.sin(0.4 * np.pi)) / 2, 0.5, (1 - math.sin(0.25 * np.pi)) / 2, 0, 0],
        atol=1e-12,
    ),
    *(
        Claim(
            "cubics between equidistant samples",
            lambda places=places, powers=powers: (
                np.arange(-4.0, 8.0) ** powers
                @ _cubic_weights(np.arange(-4.0, 8.0)[:, None] - places)
            ),
            places**powers,
            atol=1e-12,
        )
        for places, powers in [(np.array([0.0, 0.3, 1.5, 2.9]), np.arange(4)[:, None])]
    ),
    *(
        Claim(
            "cubic splines have SciPy's values",
            lambda table=table, places=places: _spline_values(table, *places),
            [
                ndimage.map_coordinates(part, place + 1, order=3, prefilter=False, mode="nearest")
                for part, place in zip(table, np.swapaxes(places, 0, 1), strict=True)
            ],
            atol=2e-6,
            why="single precision",
        )
        for table, places in [
            (
                RNG.normal(size=(2, 7, 6, 2)).astype(np.float32).view(np.complex64)[..., 0],
                RNG.uniform(0, 5, (2, 2, 40)),
            )
        ]
    ),
    *(
        Claim(
            f"light and tails of a picture of {blur.shape} are those tile by tile",
            lambda blur=blur, picture=picture: np.concatenate(
                [np.ravel(part) for part in blur.superposed(picture)]
            ),
            np.concatenate(
                [
                    np.ravel(
                        sum(signal.convolve2d(picture * weights, psf) for weights, psf in tiles)
                    ),
                    np.ravel(picture * sum(weights * (1 - psf.sum()) for weights, psf in tiles)),
                ]
            ),
            atol=1e-6,
            why="single precision",
        )
        for shape in ((12, 17), (11, 17), (26, 10))
        for blur, picture in [(blur_of_random_psfs(shape), RNG.random(shape))]
        for tiles in [tiles_of(blur)]
    ),
    *(
        Claim(
            f"all light of a picture of {shape} is in its blur or in tails",
            lambda blur=blur, picture=picture: sum(map(np.sum, blur.superposed(picture))),
            picture.sum(),
            rtol=1e-9,
            why="conserved",
        )
        for shape in ((12, 17), (13, 13))
        for blur, picture in [(blur_of_random_psfs(shape), RNG.random(shape))]
    ),
    Claim(
        "the largest share of light beyond a PSF",
        lambda: TILES.tail_share,
        max(1 - psf.kernel.sum(dtype=float) for psf in TILES.psfs.values()),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"a margin of {margin} samples has the light that it reflects",
            lambda margin=margin, picture=picture: TILES._spread(
                np.pad(picture, margin, "symmetric"), margin
            ),
            TILES._spread(picture),
            atol=1e-12,
        )
        for picture in [
            VALUES[:65].reshape(5, 13)[np.ix_([0, 0, 2, 4, 4], [0, 0, *range(2, 11), 12, 12])]
        ]
        for margin in (1, 2, 4)
    ),
    *(
        Claim(
            "light farther away than half a PSF does not count",
            lambda picture=picture: TILES._spread(picture, 4),
            TILES._spread(picture[2:-2, 2:-2], 2),
            atol=1e-12,
        )
        for picture in [VALUES[:273].reshape(13, 21)]
    ),
    *(
        Claim(
            f"a uniform picture of {shape} stays uniform",
            lambda shape=shape: blur_of_random_psfs(shape).blurred(np.ones(np.subtract(shape, 4))),
            np.ones(np.subtract(shape, 4)),
            atol=1e-6,
            why="single precision",
        )
        for shape in ((9, 17), (12, 17), (12, 12), (13, 10), (28, 30))
    ),
    *(
        Claim(
            f"cosines of {rows} and {columns} half periods in a veil have its MTF",
            lambda cosine=cosine: TILES._with_tails_as_veil(1 + cosine, cosine),
            1 + cosine + cosine * veil_mtf(frequency, 10 / math.sqrt(np.pi)),
            atol=1.5e-7,
            why="a table",
        )
        for rows, columns in ((2, 3), (8, 15))
        for frequency in [np.hypot(rows / 9, columns / 17) / (2 * 2e-3)]
        for down in [np.cos(rows * np.pi * np.arange(0.5, 9) / 9)]
        for cosine in [np.outer(down, np.cos(columns * np.pi * np.arange(0.5, 17) / 17))]
    ),
    *(
        Claim(
            "and that of large PSFs at a low frequency, where it falls linearly",
            lambda cosine=cosine: FieldBlur(
                (1, 257), 2.0, 4, {(0, 0): Psf(np.ones((129, 129), np.float32))}
            )._with_tails_as_veil(0 * cosine, cosine),
            cosine * veil_mtf(np.array(1 / (2 * 257 * 2e-3)), 2 * 129 / math.sqrt(np.pi)),
            atol=2e-5,
            why="16384 frequencies",
        )
        for cosine in [np.cos(np.pi * np.arange(0.5, 257) / 257)[None]]
    ),
    *(
        Claim(
            "transform of two PSFs with their tails",
            lambda pair=pair: psf_transform(pair, 2.0, 24),
            sum(
                weight * (down.T @ psf.kernel @ across + (1 - psf.kernel.sum()) * veil)
                for weight, psf in pair
            ),
            atol=1e-6,
            why="single precision",
        )
        for fy, fx in [(np.fft.fftfreq(24), np.fft.rfftfreq(24))]
        for down, across in [
            [np.exp(-2j * np.pi * np.outer(np.arange(-2, 3), f)) for f in (fy, fx)]
        ]
        for veil in [veil_mtf(np.hypot(fy[:, None], fx) / 2e-3, 10 / math.sqrt(np.pi))]
        for pair in [list(zip((0.3, 0.7), TILES.psfs.values(), strict=False))]
    ),
    Claim(
        "tiles around a place stand for it as cubics, and lie 1.5 of 5 cells of 0.7 µm beside it",
        lambda: [
            f(around)
            for around in [psfs_between_tiles(PLACES, 7.0, -3.0, 0.7, 5, 9)]
            for f in (
                lambda tiles: sum(weight * x**2 * y for weight, (x, y) in tiles),
                lambda tiles: sum(weight * x * y**3 for weight, (x, y) in tiles),
                lambda tiles: max(x for _, (x, _) in tiles),
                lambda tiles: min(y for _, (_, y) in tiles),
            )
        ],
        [-147.0, -189.0, 7 + 1.5 * 3.5, -3 - 1.5 * 3.5],
        rtol=1e-12,
    ),
    Claim(
        "tiles lie where their places are",
        lambda: list(_tile_psfs(PLACES, 0.7, 5, 9, [(0, 1), (3, 2)]).values()),
        [[0.0, 3.5], [10.5, 7.0]],
        rtol=1e-12,
    ),
    *(
        Claim(
            f"means of a quadratic picture over moved cells, within {end_mm} mm and beyond",
            lambda cubic=cubic, end_mm=end_mm: moved_quadratic_errors(cubic, end_mm)[
                13:-13, 13:-13
            ].max(),
            0.0,
            atol=atol,
            why="the border of the picture, and fourth derivatives",
        )
        for cubic, end_mm, atol in ((0.0, 0.7, 1e-7), (0.03, 0.7, 1e-5), (0.1, 0.25, 1e-5))
    ),
    *(
        Claim(
            f"means over cells around {cell}, where a picture is level and its cells are not square",
            lambda cell=cell: moved_quadratic_errors(0.1, 0.7, cell)[
                int(cell.imag + 19.5), int(cell.real + 31.5)
            ],
            0.0,
            atol=2e-8,
            why="fourth derivatives",
        )
        for cell in (17.5 - 5.5j, 17.5 + 5.5j, 11.5 + 6.5j)
    ),
    Claim(
        "the largest shift, and the picture that fills the die",
        lambda: [
            Distortion(2 * HEIGHTS_MM, 2 * HEIGHTS_MM + HEIGHTS_MM**3 / 5).widening,
            Distortion(2 * HEIGHTS_MM, 2 * HEIGHTS_MM + HEIGHTS_MM**3 / 5).largest_mm,
            Distortion(2 * HEIGHTS_MM, 2 * HEIGHTS_MM - HEIGHTS_MM**3 / 5).widening,
        ],
        [1.1, 0.2, 1.0],
        rtol=1e-12,
    ),
    Claim(
        "cells of tiles and of PSFs",
        lambda: [Tiling(10.6, psf_um, 0.0).cells(2.0) for psf_um in (1.0, 33.0, 35.0)],
        [(5, 3), (5, 17), (5, 19)],
    ),
    Claim(
        "a die beyond a disc of light of 0.7 mm",
        lambda: dark_share(
            Camera(
                die_mm=2.0,
                die_height_mm=1.6,
                chief_ray_angle=((0, 0, 1), (0.7, 5, 0.5), (0.7 + 1e-6, 5, 0), (1.3, 5, 0)),
            )
        ),
        1 - np.pi * 0.49 / 3.2,
        atol=1e-4,
        why="512 × 512 cells",
    ),
    *(
        Claim(
            "rays of a disc on a coarse film have its transform, and its light in other cells",
            lambda disc=disc: astuple(
                _tiling_without_blur(
                    points_on(with_lens("singlet", 0.2, focal_length_mm=12.0), np.zeros(1)), disc
                )
            ),
            [200.0, 0.0, error, error, 4, 17, error, 4 * (turn - math.sin(2 * turn) / 2) / np.pi],
            rtol=6e-3,
            why="200 rays",
        )
        for turn in [math.acos(10 / 12)]
        for frequency in [np.hypot(np.fft.fftfreq(32, 20)[:, None], np.fft.rfftfreq(32, 20))]
        for z in [np.maximum(2 * np.pi * 12 * frequency, 1e-9)]
        for error in [picture_error(1 + 0j * z, 2 * special.j1(z) / z + 0j, 20.0, 30.0)]
        for square in [(powers().sum(axis=1) == 2) & (powers()[:, 1] != 1)]
        for numbers in [
            np.r_[0.1, 0.1, 0.0, square * 0.6 * 12e3 / 12 / NM, np.ones(OUTLINE_ANGLES)]
        ]
        for disc in [
            ChannelWavefronts([FittedWavefronts(NM, np.zeros(1), numbers[None], 0.0)], np.ones(1))
        ]
    ),
    Claim(
        "a thin lens in place of a real one errs by distortion and blur on the axis",
        lambda: [
            thin_lens_error(camera, 2.0, np.array([NM]), np.ones(1), 4.0)
            - 1e3 * camera_distortion(camera).largest_mm / 4.0
            - _blur_error(camera, light, 2.0, 4.0)
            for camera in [with_lens("singlet", 0.02, focal_length_mm=12.0)]
            for light in [
                channel_wavefronts(camera, np.array([NM]), np.ones(1), Tiling(0.0, 0.0, 0.0))
            ]
        ],
        [0.0],
        atol=2e-8,
        why="the fall-off",
    ),
    Claim(
        "points of a die of 3 to 2 lie on its diagonal",
        lambda: points_on(Camera(die_mm=3.0, die_height_mm=2.0), np.array([0.0, 1300.0])).places_um,
        np.outer([0, 100 * math.sqrt(13)], [3.0, 2.0]),
        rtol=1e-9,
    ),
    *(
        Claim(
            "the middle of a PSF is cut",
            lambda psf=psf: _cut_psf(np.fft.rfft2(psf), 5).kernel,
            np.roll(psf, (2, 2), axis=(0, 1))[:5, :5],
            atol=1e-6,
            why="single precision",
        )
        for psf in [RNG.random((8, 8))]
    ),
    Claim(
        "PSFs along a radius: points up to two beyond the farthest, 1.5 windows of 1.5 PSFs",
        lambda: [
            (psfs := radial_psfs(ideal_light_at(8.0), 4.0, 151, 16.0, 50.0)).point_count,
            psfs.max_height_um,
            psfs.pitch_um,
            psfs.period_um,
            psfs.last_frequency,
        ],
        # A window of 384 cells of 2.5 µm, from 362.4; the band's corner is at 1.1/√2 of 360 steps.
        [3 + 3, 64.0, 4.0, 576 * 2.5, 281 + 2],
        rtol=1e-12,
    ),
    *(
        Claim(
            "rays within 1.5 of an outline, which is wider to one side",
            lambda outline=outline, rays=rays: 1 * _near(outline, 0, rays),
            np.repeat([1, 0], 90),
        )
        for turn in [(np.arange(90) + 0.5) * (2 * np.pi / 90) - np.pi / 2]
        for radius in [0.1 + 0.04 * np.cos(turn)]
        for outline in [Outline(np.full((1, 2), 0.1), radius[None], np.zeros(1))]
        for rim in [np.c_[radius * np.cos(turn), radius * np.sin(turn)]]
        for rays in [0.1 + np.concatenate([1.49 * rim, 1.51 * rim])]
    ),
    *(
        Claim(
            f"points of a sphere {side * 4:g} mm from the image, from whichever ray leaves them",
            lambda waves=waves, side=side: _sphere_cosines(waves, 0, side * 4.0),
            cosines,
            atol=1e-12,
        )
        for side in (-1, 1)
        for cosines in [RNG.uniform(-0.3, 0.3, (20, 2))]
        for off in [np.c_[RNG.uniform(-0.5, 0.5, (20, 2)), np.zeros(20)]]
        for point in [5.0 * np.c_[side * cosines, side * np.sqrt(1 - np.square(cosines).sum(1))]]
        for ray in [side * (point - off) / np.linalg.norm(point - off, axis=1)[:, None]]
        for waves in [
            SimpleNamespace(
                cosines=ray[None, :, :2],
                x_mm=off[None, :, 0],
                y_mm=off[None, :, 1],
                chief_y_mm=[3.0],
            )
        ]
    ),
    Claim(
        "PSFs of two points from tile to tile serve for a film, and up to four tiles beyond the die",
        lambda: [
            (psfs.step_um, psfs.max_height_um > math.hypot(560.0, 560.0))
            for psfs in [
                camera_psfs(
                    with_lens("singlet", 0.2, focal_length_mm=12.0),
                    (20, 20),
                    10.0,
                    Tiling(100.0, 60.0, 0.0),
                    np.array([NM]),
                    np.ones(1),
                )
            ]
        ],
        [(50.0, 1)],
    ),
    Claim(
        "distortion errs by the frequency in film cells, of which one of the grid has two",
        lambda: [
            _distortion_error(points, np.ones((6, 16, 9), complex))
            / picture_error(1 + moved[:, :9] + 0j, np.ones((16, 9), complex), 40.0, 30.0)
            for camera in [with_lens("singlet", 3.0, focal_length_mm=12.0)]
            for moved in [moved_error(camera_distortion(camera), 20.0, np.fft.fftfreq(16) / 2)]
            for points in [points_on(camera, np.zeros(1), 2)]
        ],
        [1.0],
        rtol=1e-9,
    ),
    Claim(
        "a lens is in focus over the field of its die",
        lambda: (
            lens_in(with_lens("singlet", 4.0, focal_length_mm=20.0, refocus="field")).image_scale_mm
            - (lens := load_lens("singlet"))
            .scaled(20 / lens.first_order(lens.primary_nm).focal_length_mm)
            .refocused("field", 5e3, math.degrees(math.atan(math.hypot(4.0, 4.0) / 2 / 20)), None)
            .image_scale_mm
        ),
        0.0,
        atol=1e-4,
        why="its f-number in nine digits",
    ),
    *(
        Claim(
            "the error of a thin lens's diffraction is the largest up to the corner",
            lambda light=light: _blur_error(F16, light, 1.0, 5.0),
            max(
                picture_error(
                    optics.diffraction_otf(1e3 * frequency, NM, F16.effective_f_number) + 0j,
                    np.fft.rfft2(periodic_psf(light, x_um, 0.0, 1.0, 320)),
                    1.0,
                    5.0,
                )
                for x_um in (0.0, 280.0, 400.0)
            ),
            rtol=3e-3,
            why="frequencies of another window",
        )
        for light in [thin_lens_light(8.0, np.linspace(0, 0.4, 9), aberrated)]
        for frequency in [np.hypot(np.fft.fftfreq(320)[:, None], np.fft.rfftfreq(320))]
    ),
    Claim(
        "distortion of a film that is too coarse for waves errs as it does elsewhere",
        lambda: [
            _tiling_without_blur(points_on(camera, np.zeros(1)), sharp).error
            / picture_error(1 + moved[:, :17] + 0j, np.ones((32, 17), complex), 20.0, 30.0)
            for camera in [with_lens("singlet", 3.0, focal_length_mm=12.0)]
            for moved in [moved_error(camera_distortion(camera), 20.0, np.fft.fftfreq(32))]
            for numbers in [np.r_[0.1, 0.1, 0.0, 0 * TERM_WAVES, np.ones(OUTLINE_ANGLES)]]
            for front in [FittedWavefronts(NM, np.zeros(1), numbers[None], 0.0)]
            for sharp in [ChannelWavefronts([front], np.ones(1))]
        ],
        [1.0],
        rtol=1e-9,
    ),
    Claim(
        "an error of 1 % at the Nyquist frequency along rows is that of 32 of 32² - 1 frequencies",
        lambda: picture_error(
            1 + 0.01 * (np.arange(17) == 16) * np.ones((32, 1)) + 0j,
            np.ones((32, 17), complex),
            1.0,
            1e-9,
        ),
        0.01 * math.sqrt(32 / 1023),
        rtol=1e-9,
    ),
    Claim(
        "PSFs of 9 coarse cells: all of 36 frequencies that have no Nyquist frequency",
        lambda: radial_psfs(ideal_light_at(8.0), 40.0, 9, 16.0, 50.0).last_frequency,
        17,
    ),
    Claim(
        "odd windows of turned PSFs, fast ones with 48 cells around these",
        lambda: [_turned_window_cells(cells) for cells in (33, 35)],
        [81, 99],
    ),
    *(
        Claim(
            "a film whose Nyquist frequency is just beyond a lens's cut-off shows its OTF",
            lambda pitch_um=pitch_um: otf_along(
                periodic_psf(ideal_light_at(8.0), 0.0, 0.0, pitch_um, 400), pitch_um
            )[1],
            sum(
                _band_weight(f) * optics.diffraction_otf(1e3 * f / pitch_um, NM, math.hypot(8, 0.5))
                for f in (frequency, 1 - frequency)
            ),
            atol=1e-3,
            why="samples of the pupil",
        )
        for pitch_um in [0.48 * NM * 1e-3 * math.hypot(8, 0.5)]
        for frequency in [np.arange(200) / 400]
    ),
    Claim(
        "the memory of a PSF is its coefficients from -1 to the last frequency, both ways",
        lambda: (
            (psfs := radial_psfs(ideal_light_at(8.0), COARSE_UM, 33, 16.0, 50.0)).spline(0).nbytes
            / (psfs.last_frequency + 2) ** 2
        ),
        8.0,  # complex64
    ),
    Claim(
        "tilings of a header are at most twice as fine as those that are chosen",
        lambda: [
            is_usable(**fields)
            for fields in (
                {"spacing_um": 1.0},
                {"spacing_um": 0.99},
                {"psf_um": 516.0},
                {"psf_um": 517.0},
                {"wavelengths": 12},
                {"wavelengths": 13},
                {"nodes": 4},
                {"nodes": 3},
                {"nodes": 65},
                {"nodes": 66},
            )
        ],
        [1, 0] * 5,
    ),
]


@pytest.mark.parametrize("slope", [0.0, 2.0])
def test_error_of_a_picture_is_the_worst_mixture_of_its_frequencies(slope: float) -> None:
    """An error of 1 % at one frequency, in pictures of which every part ends there or beyond."""
    exact, fy, fx = (
        np.ones((32, 17), complex),
        np.fft.fftfreq(32, 2.0)[:, None],
        np.fft.rfftfreq(32, 2.0),
    )
    approximate = exact + 0.01 * (fy == 0) * (fx == 3 / 64)
    frequency = np.hypot(fy, fx)
    weight = np.where(np.isin(np.arange(17), [0, 16]), 1.0, 2.0)
    weight = weight * (np.sinc(2.6 * fy) * np.sinc(2.6 * fx)) ** 2
    weight = weight / np.maximum(frequency, 1 / 64) ** slope
    below = (frequency > 0) & (frequency < 3 / 64)
    # The order among equal frequencies is that of rows.
    worst = 0.01 * math.sqrt(weight[0, 3] / (weight[below].sum() + weight[0, 3]))
    both = np.array([approximate, exact])
    for name, bound, wanted in (
        ("bound", picture_error(approximate, exact, 2.0, 2.6, slope), worst),
        (
            "of half the area",
            picture_error(both, 0 * both + 1, 2.0, 2.6, slope, [0.5, 0.5]),
            worst * math.sqrt(0.5),
        ),
    ):
        check(name, bound, wanted, rtol=1e-9, why="rounding")


# PSFs


def test_traced_thin_lens_has_the_diffraction_otf_with_cut_offs_that_fall_as_cosines() -> None:
    """Equiconvex, f = 1 mm, f/100, 10 nm thick, stop at the lens: from its rays to its OTF, with
    0.006 waves of astigmatism. Radially the pupil is seen cos³ as wide, sagittally cos.
    """
    surfaces = Surface(1.0, 1e-5, constant_glass("n = 1.5", 1.5)), Surface(-1.0, 1.0)
    lens = lens_from_prescription(
        Prescription("thin", "", "", surfaces, 0, "f_number", 100.0, "angle_deg", 20.0, (NM,), NM)
    )
    fields = np.linspace(0, 20, 5)
    (rays,) = pupil_rays(lens, fields, np.array([NM]))
    heights_um = np.array([front.height_um for front in rays])
    traced = ChannelWavefronts([fit_wavefronts(NM, heights_um, rays)], np.ones(1))
    for height_um, cosine in zip(heights_um.tolist(), np.cos(np.radians(fields)), strict=True):
        frequency, along, across = otf_along(periodic_psf(traced, height_um, 0.0, 12.0, 400), 12.0)
        effective = math.hypot(1, 200.0) / 2
        for name, otf, power in (("radial", along, 3), ("sagittal", across, 1)):
            wanted = optics.diffraction_otf(frequency, NM, effective / cosine**power) + 0j
            check(name, otf, wanted, atol=1e-3, why="astigmatism")


def hopkins(frequency: np.ndarray, w20: float) -> np.ndarray:
    """Return the OTF of a defocused circular pupil; frequency 2 is the cut-off. H. H. Hopkins,
    Proc. R. Soc. A 231 (1955) 91, eq. (25).
    """
    a = 4 * np.pi * w20 * frequency
    beta = np.arccos(frequency / 2)
    n, m = np.arange(1, 60)[:, None], np.arange(60)[:, None]
    even = np.sin(2 * n * beta) / n * (special.jv(2 * n - 1, a) - special.jv(2 * n + 1, a))
    odd = special.jv(2 * m, a) - special.jv(2 * m + 2, a)
    first = beta * special.jv(1, a) + 0.5 * np.sum((-1.0) ** (n + 1) * even, axis=0)
    second = np.sum((-1.0) ** m * np.sin((2 * m + 1) * beta) / (2 * m + 1) * odd, axis=0)
    half = a * frequency / 2
    return 4 / (np.pi * a) * (np.cos(half) * first - np.sin(half) * second)


@pytest.mark.parametrize("w20", [0.25, 1.0, 2.0])
def test_defocus_has_the_otf_of_hopkins(w20: float) -> None:
    defocused = thin_lens_light(200.0, np.zeros(1), lambda u, v, _: w20 * (u**2 + v**2))
    frequency, otf, _ = otf_along(periodic_psf(defocused, 0.0, 0.0, 20.0, 900), 20.0)
    reduced = 2 * frequency * NM * 1e-6 * math.hypot(1, 400.0) / 2
    inside = (reduced > 0) & (reduced < 2)
    wanted = hopkins(reduced[inside], w20) + 0j
    check("OTF", otf[inside], wanted, atol=1e-4, why="samples of the pupil")


def test_psf_is_seen_through_a_low_pass_that_ends_softly() -> None:
    """The raised cosine's response in closed form, convolved with a PSF whose samples resolve
    it. A band that breaks off would leave 7 % outside of the middle.
    """
    shifted = thin_lens_light(4.0, np.linspace(0, 0.4, 9), aberrated, shift_um=9.0)
    place = 250.0, 120.0
    fine = np.fft.fftshift(periodic_psf(shifted, *place, COARSE_UM / 8, 768))
    psf = np.fft.fftshift(periodic_psf(shifted, *place, COARSE_UM, 96))
    away = (np.arange(96)[:, None] - 48) - (np.arange(768) - 384) / 8  # in cells
    with np.errstate(divide="ignore", invalid="ignore"):
        through = np.sinc(away) * np.cos(np.pi * BAND_END * away) / (1 - (2 * BAND_END * away) ** 2)
    through[np.isclose(np.abs(away), 1 / (2 * BAND_END))] = np.pi / 4 * np.sinc(1 / (2 * BAND_END))
    wanted = through @ fine @ through.T
    norm = rms(wanted)
    assert rms((psf - wanted)[24:-24, 24:-24]) < 6e-4 * norm, "what repeats from beyond the window"
    wanted[32:65, 32:65] = 0
    assert rms(wanted) < 4e-3 * norm


@pytest.mark.parametrize(
    ("height_um", "azimuth"), [(0.0, 0.0), (3.0, 0.4), (100.0, 0.8), (200.0, 2.1), (None, -2.5)]
)
def test_turned_and_interpolated_psfs_are_those_of_their_own_pupils(
    height_um: float | None, azimuth: float, sharp_light: ChannelWavefronts
) -> None:
    """Between the distances that are computed, at any azimuth, and at the end of what is known."""
    psfs = radial_psfs(sharp_light, COARSE_UM, 33, 16.0, 200.0)
    radius_um = psfs.max_height_um if height_um is None else height_um
    place = radius_um * math.cos(azimuth), radius_um * math.sin(azimuth)
    whole = np.roll(periodic_psf(sharp_light, *place, COARSE_UM, 240), (16, 16), (0, 1))[:33, :33]
    assert rms(psfs.at([place], COARSE_UM, 33)[0].kernel - whole) < 5e-4 * rms(whole)
    for call, words in (
        (lambda: psfs.at([(300.0, 0.0)], 4.0, 33), "from the axis: got 300"),
        (lambda: psfs.at([(0.0, 0.0)], 3.9, 33), "got 3.9 µm"),
        (lambda: residual_of_rays(97), "wavefront: got 97 rays"),
    ):
        with pytest.raises(PixsimError, match=words):
            call()


def test_psfs_that_hold_all_that_the_lens_passes_serve_for_every_film(
    sharp_light: ChannelWavefronts,
) -> None:
    """A film ten times finer than the lens has the PSFs of the coarsest film that shows all of
    it; beyond a window light folds back.
    """
    resolving = resolving_um(sharp_light)
    psfs = radial_psfs(sharp_light, resolving / 10, 301, 50.0, 400.0)
    assert psfs.pitch_um == 0.0
    for pitch_um, cells in ((resolving / 4, 121), (resolving / 1.5, 45), (2 * resolving, 15)):
        kernel = psfs.at([(210.0, 90.0)], pitch_um, cells)[0].kernel
        right = point_spread(sharp_light, 210.0, 90.0, pitch_um, cells).kernel
        check("kernel", kernel, right, atol=2e-3 * right.max(), why="interpolation")
        check("light", kernel.sum(), right.sum(), atol=0.01, why="tails")


@pytest.mark.parametrize(
    "place", [(200.0, 100.0), (-200.0, 100.0), (200.0, -100.0), (-200.0, -100.0)]
)
def test_transform_of_a_psf_is_that_of_its_film_cells_on_any_window(
    place: tuple[float, float], sharp_light: ChannelWavefronts
) -> None:
    psfs = radial_psfs(sharp_light, 1.0, 33, 50.0, 400.0)
    window = np.fft.irfft2(psfs.transform([place], 1.0, (150, 121))[0], (150, 121))
    kernel = psfs.at([place], 1.0, 33)[0].kernel
    middle = np.roll(window, (16, 16), axis=(0, 1))[:33, :33]
    check("cells", middle, kernel.astype(float), atol=1e-3 * kernel.max(), why="tails")
    point = np.zeros((150, 121))
    point[40, 50] = 1.0
    (spread,) = psfs.blurred([(point, 1.0)], *place)
    check("a point", spread, np.roll(window, (40, 50), axis=(0, 1)), atol=1e-7, why="float32")
    fine = np.random.default_rng(2).random((160, 120))
    films = [(fine, 1.0), (fine.reshape(80, 2, 60, 2).mean(axis=(1, 3)), 2.0)]
    for film, blurred in zip(films, psfs.blurred(films, *place), strict=True):
        (alone,) = psfs.blurred([film], *place)
        check("two films of one spectrum", blurred, alone, atol=1e-6, why="float32")


# Pictures


def psfs_for(
    light: ChannelWavefronts, shape: tuple[int, int], pitch_um: float, spacing: int, cells: int
) -> RadialPsfs:
    farthest_um = farthest_tile_um(shape, pitch_um, spacing, cells)
    return radial_psfs(light, pitch_um, cells, spacing * pitch_um / 2, farthest_um)


def blur_of_tiles(
    light: ChannelWavefronts, shape: tuple[int, int], pitch_um: float, spacing: int, cells: int
) -> FieldBlur:
    psfs = psfs_for(light, shape, pitch_um, spacing, cells)
    return field_blur(psfs, shape, pitch_um, spacing, cells)


def tile_bound(light: ChannelWavefronts, side: int, spacing: int) -> float:
    """Return the bound for the error of tiles, from places on the way to the corner."""
    psfs = psfs_for(light, (side, side), COARSE_UM, spacing, 33)
    places = [(part * side / 2 * COARSE_UM,) * 2 for part in (0.25, 0.5, 0.7, 0.8)]
    window = max(psf_window(light, *place, COARSE_UM, 33) for place in places)
    exact = [np.fft.rfft2(periodic_psf(light, *place, COARSE_UM, window)) for place in places]
    tiles = [
        psf_transform(psfs_between_tiles(psfs, *place, COARSE_UM, spacing, 33), COARSE_UM, window)
        for place in places
    ]
    share = [0.2, 0.3, 0.3, 0.2]
    return picture_error(np.array(tiles), np.array(exact), COARSE_UM, COARSE_UM, share=share)


def test_error_of_tiles_falls_with_their_number(sharp_light: ChannelWavefronts) -> None:
    """Against superposition of whole PSFs from their own pupils, on a film that does not resolve
    the lens; all light counts, also that beyond the PSFs.

    The part of the tiles falls with the fourth power of their number, as cubic windows have it;
    what a PSF lacks stays. Four points tell their RMS, half of the gate, to 35 %.
    """
    side, near = 128, 24
    dots = 1.0 * (np.random.default_rng(3).random((256, 256)) < 1 / 250)[:side, :side]
    points = np.random.default_rng(5).integers(near, side - near, (4, 2))

    def psf_of(source: np.ndarray) -> np.ndarray:
        y_um, x_um = (source - (side - 1) / 2) * COARSE_UM
        return periodic_psf(sharp_light, x_um, y_um, COARSE_UM, 160)

    exact = []
    for point in points:
        rows, columns = (slice(at - near, at + near + 1) for at in point)
        sources = np.argwhere(dots[rows, columns]) + point - near
        inside = np.roll(psf_of(point), (near, near), (0, 1))[: 2 * near + 1, : 2 * near + 1].sum()
        value = sum(float(psf_of(source)[tuple(point - source)]) for source in sources)
        exact.append(value + dots.mean() * (1 - inside))
    blurs = [
        blur_of_tiles(sharp_light, dots.shape, COARSE_UM, spacing, 33) for spacing in (32, 16, 8, 4)
    ]
    *coarse, finest = (blur.blurred(dots) * blur.flat_field for blur in blurs)
    contrast = finest.std()
    parts = [rms(picture - finest) / contrast for picture in coarse]
    totals = [rms(picture[tuple(points.T)] - exact) / contrast for picture in (*coarse, finest)]
    assert min(math.log2(parts[0] / parts[1]), math.log2(parts[1] / parts[2])) > 1.8, parts
    assert max(totals[1:]) < 0.001, totals
    bounds = [tile_bound(sharp_light, side, spacing) for spacing in (32, 16)]
    assert parts[0] < bounds[0]
    assert parts[1] < bounds[1] < bounds[0]


# Real lenses in a camera

SINGLET = packaged("data/lenses")["singlet"].read_text()
NO_OPTIONS = CameraOptions()


def with_lens(
    file: str | Path,
    die_mm: float,
    distance_m: float = 5.0,
    options: CameraOptions = NO_OPTIONS,
    **lens: object,
) -> Camera:
    camera = Camera(die_mm=die_mm, object_distance_m=distance_m, transmittance=0.8)
    return camera_with_lens(camera, options, LensOptions(file=str(file), **lens))


def lens_in(camera: Camera) -> Lens:
    return traced_lens(camera.lens, camera.object_distance_m)


def unit_vector(deg: float) -> np.ndarray:
    return np.array([math.cos(math.radians(deg)), math.sin(math.radians(deg))])


GAUSS, STRAIGHT = (
    with_lens("double_gauss", 24.0, focal_length_mm=45.0, ideal=ideal)
    for ideal in ("distorted", "undistorted")
)


# Closed forms


BANDS = np.arange(400.0, 701.0, 10.0)
BELL = np.exp(-(((BANDS - 560) / 60) ** 2))
RANDOM = np.r_[0.0, np.random.default_rng(1).uniform(1, 2, 60), 0.0]


def moments(nm: np.ndarray, share: np.ndarray) -> np.ndarray:
    return (share * ((nm - 550) / 150) ** np.arange(8)[:, None]).sum(axis=1) / share.sum()


WAVELENGTHS = [
    Claim(
        "the largest field reaches the corner unless a focal length is stated",
        lambda: (
            lens_in(with_lens("cooke_triplet", 20.0, 1e4))
            .chief_ray(load_lens("cooke_triplet").max_field_deg, 550.0)
            .height_mm
        ),
        math.hypot(20.0, 20.0) / 2,
        rtol=3e-3,
        why="the file's plane and the best focus differ a little",
    ),
    Claim(
        "few wavelengths have the moments of the bands, by Gauss's quadrature to degree 7",
        lambda: moments(*few_wavelengths(BANDS, BELL, 4)),
        moments(BANDS, BELL),
        atol=1e-5,
        why="nodes in pm",
    ),
    Claim(
        "waves of a coarse film are followed for nine cells of 60 µm: the error is above 0.01",
        lambda: (
            (
                tiling := choose_tiling(
                    with_lens("singlet", 6.0, focal_length_mm=20.0),
                    (100, 100),
                    60.0,
                    (550.0,),
                    (1.0,),
                    60.0,
                    0.01,
                )
            ).psf_um,
            min(tiling.cut_error, 0.01),
            max(tiling.cut_error, tiling.error) - tiling.error,
        ),
        [9 * 60.0, 0.01, 0.0],
    ),
    Claim(
        "one band is one wavelength",
        lambda: np.ravel(few_wavelengths(BANDS[[5, 15, 25]], np.array([0.0, 2.0, 0.0]), 4)),
        [550.0, 1.0],
    ),
    Claim(
        "the middle of a die, nearer to the axis than to 0.5 mm, is a disc of a quarter",
        lambda: _area_shares(Camera(die_mm=2.0, die_height_mm=1.0), np.array([0.0, 500.0])),
        [np.pi / 32, 1 - np.pi / 32],
        atol=2e-3,
        why="64 points a side",
    ),
    Claim("groups of bands are whole", lambda: np.sum(band_groups(RANDOM, 6), axis=0), RANDOM > 0),
    Claim(
        "and of equal weight",
        lambda: np.array(band_groups(RANDOM, 6)) @ RANDOM,
        np.full(6, RANDOM.sum() / 6),
        atol=2.0,
        why="one band",
    ),
    Claim(
        "a lens of a tenth of the size has a tenth of the image circle",
        lambda: np.divide(
            *(
                field_angles(
                    with_lens("phone", mm, mm / 10, focal_length_mm=0.52 * mm).lens,
                    mm / 10,
                    mm / math.sqrt(2),
                )[0][-1]
                for mm in (1.0, 10.0)
            )
        ),
        0.1,
        rtol=1e-6,
        why="the aim of chief rays",
    ),
]


@pytest.mark.parametrize("claim", [*WAVELENGTHS, *KERNELS], ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# The thin lens that stands for a real one


@pytest.mark.parametrize("file", ["singlet", "cooke_triplet"])
def test_thin_lens_has_the_real_ones_light_on_the_axis_and_its_chief_rays(file: str) -> None:
    camera = with_lens(file, 10.0, focal_length_mm=40.0)
    lens = lens_in(camera)
    nm = lens.primary_nm
    heights_mm, angles_deg, shares = np.array(camera.chief_ray_angle).T
    foote = irradiance_factor(
        camera.f_number, heights_mm / camera.image_distance_mm, camera.magnification
    )
    field = lens.field_of_height(4.0, nm)
    angle = float(lens.chief_ray(field, nm).angle_deg)
    for name, got, wanted, atol in (
        ("focal length", lens.first_order(nm).focal_length_mm, 40.0, 1e-8),
        ("light", foote[0], lens.projected_solid_angle_sr(0.0, nm), 1e-10),
        ("image distance", camera.image_distance_mm, lens.paraxial_height_mm, 1e-8),
        ("losses", camera.transmittance, 0.8, 0.0),
        ("distortion up to there", camera_distortion(camera).height_mm[-1], heights_mm[-1], 0.0),
        ("a corner, and 1e-6", heights_mm[-1], math.hypot(5.0, 5.0) * (1 + 1e-6), 7e-7),
        ("chief ray", np.interp(4.0, heights_mm, angles_deg), angle, 1e-3),
        (
            "direction",
            camera_pupil(camera).at(0.0, -4e3).chief_cosines[1],
            -math.sin(math.radians(angle)),
            1e-7,
        ),
        (
            "errors of distortion and fall-off",
            thin_lens_error(camera, 2.0, np.array([nm]), np.ones(1), 4.0),
            1e3 * camera_distortion(camera).largest_mm / 4.0
            + np.abs(shares * foote[0] / foote - 1)[:-1].max(),
            1e-9,
        ),
        (
            "fall-off",
            np.interp(4.0, heights_mm, shares),
            float(lens.relative_illumination(field)),
            3e-5,
        ),
    ):
        check(name, got, wanted, atol=atol, why="a table of 129 rows, or rounding")


def test_lens_of_a_user_that_is_scaled_to_the_die_is_noted(tmp_path: Path) -> None:
    """A lens that is bought has one focal length."""
    (tmp_path / "mine.toml").write_text(SINGLET)
    lens = load_lens("singlet")
    end_mm = float(lens.chief_ray(lens.max_field_deg, lens.primary_nm).height_mm)
    with pytest.warns(UserWarning, match=r"is scaled so .*lens\.focal_length_mm = "):
        with_lens(tmp_path / "mine.toml", 1.0101 * math.sqrt(2) * end_mm)
    with warnings.catch_warnings(action="error"):
        with_lens(tmp_path / "mine.toml", 1.0099 * math.sqrt(2) * end_mm)
        with_lens(tmp_path / "mine.toml", 10.0, focal_length_mm=20.0)
        with_lens("cooke_triplet", 10.0)


def test_f_number_stops_down_and_the_widest_is_named() -> None:
    camera = with_lens("cooke_triplet", 10.0, options=CameraOptions(f_number=8.0))
    assert camera.lens.f_number == 8.0
    check("f-number on the axis", camera.f_number, 8.0, rtol=0.01, why="sine for tangent")
    with pytest.raises(PixsimError, match=r"camera\.f_number: got 2; .*4\.99998"):
        with_lens("cooke_triplet", 10.0, options=CameraOptions(f_number=2.0))


@pytest.mark.parametrize("pupil_mm", [9.123456785, 3.857109995, 4.999999996])
def test_lens_is_its_own_widest_at_any_scale(pupil_mm: float, tmp_path: Path) -> None:
    """Its f-number in nine digits is not below the widest, whatever the digits."""
    (tmp_path / "thin.toml").write_text(re.sub("value_mm = .*", f"value_mm = {pupil_mm}", SINGLET))
    camera = with_lens(tmp_path / "thin.toml", 1.0, focal_length_mm=20.0, refocus="paraxial")
    first = load_lens(tmp_path / "thin.toml").first_order(587.56)
    assert camera.lens.f_number == pytest.approx(first.f_number, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (CameraOptions(focal_length_mm=4.0), r"camera\.focal_length_mm"),
        (CameraOptions(chief_ray_angle=((0.0, 0.0), (9.0, 3.0))), r"camera\.chief_ray_angle"),
    ],
)
def test_what_the_lens_states_is_refused_beside_it(options: CameraOptions, words: str) -> None:
    with pytest.raises(PixsimError, match=words):
        with_lens("singlet", 4.0, options=options)
    camera = with_lens("singlet", 4.0)
    with pytest.raises(PixsimError, match="for light that came through the lens"):
        options.over(camera)
    image = SpectralImage([550.0], 10.0, 2.0, data=np.ones((8, 8, 1)), header={LENS_HEADER: {}})
    with pytest.raises(PixsimError, match="Render the scene again"):
        camera_lens.image_tiling(image, camera)


def test_changed_file_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(SINGLET)
    camera = with_lens(file, 4.0, focal_length_mm=20.0)
    file.write_text(SINGLET.replace("thickness_mm = ", "thickness_mm = 1", 1))
    traced_lens.cache_clear()
    with pytest.raises(PixsimError, match="has changed since"):
        lens_in(camera)


def test_options_make_the_camera_again() -> None:
    assert "lens" not in Camera().model_dump()
    camera = with_lens("singlet", 4.0)
    assert camera == camera_with_lens(
        camera.options.over(Camera()), camera.options, camera.lens_options
    )


def test_lens_on_another_die_sees_the_same_field() -> None:
    camera = with_lens("singlet", 24.0, 2.0)
    other = lens_on_die(camera, Camera(die_mm=6.0), same_view=True)
    check("field", other.fov_deg, camera.fov_deg, rtol=1e-6, why="four steps")
    assert 4 * other.lens.focal_length_mm == pytest.approx(camera.lens.focal_length_mm, rel=0.05)
    assert lens_on_die(camera, camera) == camera
    assert lens_on_die(camera, Camera(die_mm=12.0)).fov_deg < camera.fov_deg


def test_die_beyond_the_image_circle_is_dark_there() -> None:
    """US 7,535,658 has no rays beyond some field. The pupil there is that of the outermost light."""
    camera = with_lens("phone", 10.0, 1.0, focal_length_mm=5.2)
    heights_mm, _ = field_angles(camera.lens, 1.0, math.hypot(10.0, 10.0) / 2)
    assert heights_mm[-1] < 6
    check(
        "dark share",
        dark_share(camera),
        1 - math.pi * heights_mm[-1] ** 2 / 100,
        atol=0.02,
        why="the pupil shrinks before",
    )
    pupil = camera_pupil(camera).at([1e3 * heights_mm[-1], 5000.0], [0.0, 5000.0])
    last, beyond = np.linalg.norm(pupil.chief_cosines, axis=-1)
    check("chief ray", beyond, last, rtol=1e-12, why="the same pupil")


def test_blur_from_the_cache_is_the_one_that_was_stored() -> None:
    camera = with_lens("singlet", 0.2, focal_length_mm=12.0)
    light = camera, (20, 20), 10.0, Tiling(100.0, 60.0, 0.0), np.array([500.0, 600.0]), np.ones(2)
    picture = np.zeros((20, 20))
    picture[4, 6] = 1.0
    blurred = camera_blur(*light).blurred(picture)
    camera_lens._BLURS.clear()
    np.testing.assert_array_equal(camera_blur(*light).blurred(picture), blurred)


# Distortion


@pytest.mark.parametrize(("field", "azimuth"), [(8.0, 20.0), (14.0, 230.0)])
def test_points_lie_where_the_chief_rays_arrive(field: float, azimuth: float) -> None:
    """A spot at v tan θ of a picture without distortion is at the chief ray's height, and back."""
    distortion = camera_distortion(GAUSS)
    lens = lens_in(GAUSS)
    y, x = np.indices((240, 240)) - 119.5
    radius = GAUSS.image_distance_mm * math.tan(math.radians(field)) * 10 / distortion.widening
    direction = unit_vector(azimuth)
    spot = np.exp(-((x - radius * direction[0]) ** 2 + (y - radius * direction[1]) ** 2) / 18)
    moved = distortion.applied(spot, 100.0, distortion.widening)
    image = SpectralImage(
        [550.0],
        10.0,
        100.0,
        data=moved[..., None],
        header={LENS_HEADER: asdict(Tiling(1e3, 1e3, 0.0))},
    )
    back = ideal_light(image, STRAIGHT).planes[0].astype(float)
    height = 10 * float(lens.chief_ray(field, lens.primary_nm).height_mm)
    straight = radius * distortion.widening * distortion.image_scale
    assert abs(height - radius) > 0.5  # cells
    for name, picture, wanted, atol in (
        ("distorted", moved, height, 0.02),
        ("and back", back, straight, 0.03),
    ):
        mean = np.array([(picture * x).sum(), (picture * y).sum()]) / picture.sum()
        check(name, mean, wanted * direction, atol=atol, why="a spot of 3 cells")


def test_picture_without_distortion_keeps_the_scale_of_the_lens_on_the_axis() -> None:
    """Also where the plane of best focus is not the paraxial one. Distortion grows with the square
    of the height: 1/100 of that at the corner is left at a tenth of it.
    """
    distortion = camera_distortion(GAUSS)
    assert abs(distortion.image_scale - 1) > 5e-4
    heights_mm = distortion.height_mm[1:]
    moved = np.abs(distortion.image_scale * distortion.undistorted_mm[1:] / heights_mm - 1)
    near = heights_mm <= 0.1 * heights_mm[-1]
    assert near.sum() > 1
    assert moved[near].max() < 0.015 * moved[-1]


@pytest.mark.parametrize(
    ("file", "die_mm", "turn_deg", "frequency"),
    [
        ("phone", 2.7, 0.0, 0.125),
        *(("phone", 2.7, turn_deg, 0.24) for turn_deg in (0.0, 45.0, 90.0)),
        ("double_gauss", 24.0, 45.0, 0.125),
        ("double_gauss", 24.0, 90.0, 0.24),
    ],
)
def test_waves_through_distortion_have_their_means_over_film_cells(
    file: str, die_mm: float, turn_deg: float, frequency: float
) -> None:
    """Against quadrature over the cells, within the stated error; cells of the phone's source are
    up to 13 % larger or smaller. Frequencies in cycles per cell.
    """
    rows = 36
    columns = 800
    pitch_mm = die_mm / columns
    camera = Camera(die_mm=die_mm, die_height_mm=rows * pitch_mm, object_distance_m=5.0)
    distortion = camera_distortion(camera_with_lens(camera, NO_OPTIONS, LensOptions(file=file)))
    tables = np.array([distortion.height_mm, distortion.undistorted_mm])
    source = interpolate.CubicSpline(*np.hstack([-tables[:, :0:-1], tables]))
    direction = unit_vector(turn_deg)
    y = np.arange(rows)[:, None] - (rows - 1) / 2
    x = np.arange(columns) - (columns - 1) / 2

    def wave(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(2j * np.pi * frequency * (x * direction[0] + y * direction[1]))

    node, weight = (part / 2 for part in np.polynomial.legendre.leggauss(4))
    truth = np.zeros((rows, columns), complex)
    for row, column in np.ndindex(4, 4):
        places = y + node[row], x + node[column]
        radius_mm = np.hypot(*places) * pitch_mm
        growth = source(radius_mm) / radius_mm
        truth += weight[row] * weight[column] * wave(*(place * growth for place in places))
    widening = distortion.widening
    picture = wave(y * widening, x * widening) * np.prod(np.sinc(widening * frequency * direction))
    real, imaginary = (
        distortion.applied(part, 1e3 * pitch_mm, widening) for part in (picture.real, picture.imag)
    )
    inner = np.s_[12:-12, 12:-12]
    error = rms(abs(real + 1j * imaginary - truth)[inner]) / rms(abs(truth)[inner])
    stated = float(moved_error(distortion, 1e3 * pitch_mm, frequency * direction[::-1])[0, 1])
    assert stated / 20 < error < stated < 0.012
    assert moved_error(distortion, 1e3 * pitch_mm, np.array([0.3]))[0, 0] == 0, "beyond the film"


def test_distortion_does_not_limit_a_picture_by_what_is_far_away() -> None:
    """An edge of two levels rings as the same beside a bright and a black patch does."""
    distortion = camera_distortion(GAUSS)
    edge = np.where(np.arange(120) < 75, 1.0, 10.0) * np.ones((120, 1))
    plain = distortion.applied(edge, 200.0, distortion.widening)
    edge[:4, :4] = 1000.0
    edge[:4, 4:8] = 0.0
    beside = distortion.applied(edge, 200.0, distortion.widening)
    check("far from the patches", beside[60:], plain[60:], atol=1e-9, why="a spline's reach")
    assert plain.min() < 0.9
    assert plain.max() > 10.1


def test_film_is_widened_for_distortion_and_seen_by_a_thin_lens() -> None:
    distortion = camera_distortion(GAUSS)
    for real in (GAUSS, GAUSS.model_copy(update={"die_height_mm": 16.0})):
        camera = rendered_camera(real)
        assert camera.lens is None
        assert camera.die_um == pytest.approx(
            np.array(real.die_um) * camera_distortion(real).widening
        )
    corner = distortion.undistorted_mm[-1] / distortion.height_mm[-1]
    assert 1 < corner <= distortion.widening < 1.02 * corner
    assert rendered_camera(without_lens(GAUSS)) == without_lens(GAUSS)


# Blur


def traced_centroid_um(lens: Lens, field_deg: float, nm: float) -> tuple[float, float]:
    """Return the height of the chief ray, and how much further out the mean of all rays lies, with
    equal light in all directions: Simpson's rule along the radius.
    """
    radius = np.linspace(0, 1, 61)[:, None]
    turn = np.arange(96) * (2 * np.pi / 96)
    points = np.array([radius * np.sin(turn), radius * np.cos(turn)]).reshape(2, -1)
    waves = lens.wavefront(np.array([field_deg]), np.array([nm]), *points)
    cosines = waves.cosines[0].reshape(61, 96, 2)
    outwards = np.gradient(cosines, radius[:, 0], axis=0, edge_order=2)
    order = 1j * np.fft.fftfreq(turn.size, 1 / turn.size)[:, None]
    around = np.fft.ifft(order * np.fft.fft(cosines, axis=1), axis=1).real
    area = np.abs(outwards[..., 0] * around[..., 1] - outwards[..., 1] * around[..., 0])
    light = area * np.where(radius == 1, 1, np.where(np.arange(61)[:, None] % 2, 4, 2))
    mean_mm = np.average(waves.y_mm[0].reshape(61, 96), weights=light)
    return 1e3 * float(waves.chief_y_mm[0]), 1e3 * float(mean_mm)


@pytest.mark.parametrize(
    ("file", "focal_mm", "die_mm", "pitch_um", "field", "nm", "within"),
    [
        ("singlet", 50.0, 16.0, 3.0, 5.0, 550.0, 0.1),
        ("cooke_triplet", 50.0, 26.0, 1.5, 10.0, 550.0, 0.03),
        ("cooke_triplet", 50.0, 26.0, 1.5, 10.0, 450.0, 0.03),
        ("phone", 4.0, 3.2, 1.5, 6.0, 450.0, 0.03),
        ("phone", 4.0, 3.2, 1.5, 12.0, 450.0, 0.06),
    ],
)
def test_picture_of_a_point_has_the_centroid_of_the_traced_spot(
    file, focal_mm, die_mm, pitch_um, field, nm, within
) -> None:
    """In every direction, with lateral colour against the primary wavelength. The singlet's rays
    miss by 60 µm of 50 mm: what counts as equal light in all directions differs by 12 % of its
    centroid. At 12° the phone lens's polynomials leave 0.04 µm at the rim.
    """
    camera = with_lens(file, die_mm, 1e4, focal_length_mm=focal_mm, refocus="paraxial")
    lens = lens_in(camera)
    chief_um, spot_um = traced_centroid_um(lens, field, nm)
    height_um = 1e3 * float(lens.chief_ray(field, lens.primary_nm).height_mm)
    light = channel_wavefronts(camera, np.array([nm]), np.ones(1), Tiling(0.0, 0.0, 0.0))
    offsets = (np.arange(129) - 64) * pitch_um
    for azimuth in (0, 45, 135, 180, 270):
        outwards = unit_vector(azimuth)
        kernel = point_spread(light, *(height_um * outwards), pitch_um, 129).kernel
        centroid = np.array([kernel.sum(axis=0), kernel.sum(axis=1)]) @ offsets / kernel.sum()
        wanted = (chief_um - height_um + spot_um) * outwards
        check("centroid", centroid, wanted, atol=within * abs(spot_um), why="see above")


def test_interpolated_wavefronts_are_the_traced_ones_between_the_nodes() -> None:
    camera = with_lens("cooke_triplet", 26.0, 1e4, focal_length_mm=50.0, refocus="paraxial")
    front, finer = (fitted_wavefronts(camera, (550.0,), nodes)[0] for nodes in (17, 33))
    middles = front.height_um[:-1] + np.diff(front.height_um) / 2
    numbers = np.array([front.at(float(middle)) for middle in middles])
    check("half widths", numbers[:, :2], finer.numbers[1::2, :2], rtol=1e-5, why="a spline")
    check("waves", numbers[:, 3:30], finer.numbers[1::2, 3:30], atol=2e-3, why="a spline")


def test_each_part_of_a_tiling_has_its_share_of_the_tolerance(monkeypatch) -> None:
    """Wavelengths and nodes a fifth each, PSFs two fifths, of a thin lens with a defocus that grows
    with the wavelength and the fourth power of the field.
    """

    front = cache(
        lambda nm, *heights_mm: replace(
            thin_lens_light(
                8.0,
                np.array(heights_mm) / 20,
                lambda u, v, t: ((nm - 550) / 5e4 + 100 * t**4) * (u**2 + v**2),
            ).fronts[0],
            wavelength_nm=nm,
            height_um=1e3 * np.array(heights_mm),
            residual_waves=1e-3,
        )
    )
    for name, value in {
        "_wavefronts": lambda _, bands_nm, height_mm: [front(nm, *height_mm) for nm in bands_nm],
        "fitted_wavefronts": lambda _, bands_nm, nodes: [
            front(nm, *np.linspace(0, 3 * math.sqrt(2), nodes)) for nm in bands_nm
        ],
        "_with_fewest_tiles": lambda _, tiling, __, error, ___: replace(tiling, error=error),
        "_WAVELENGTH_COUNTS": (1, 2),
        "_NODE_COUNTS": (3, 5),
        "_PSF_SIDES": (9, 9, 17),
    }.items():
        monkeypatch.setattr(camera_lens, name, value)
    camera = with_lens("singlet", 6.0, focal_length_mm=20.0)
    nm, weight = np.linspace(400.0, 700.0, 31), np.ones(31)
    points = _TestPoints(camera, (400, 400), 4.0, nm, weight, 8.0)
    lights = [
        points.traced_light(1),
        points.traced_light(2),
        channel_wavefronts(camera, nm, weight, Tiling(0.0, 0.0, 0.0, wavelengths=1, nodes=3)),
    ]
    window = points.window(lights[1], 33)
    exact, two, interpolated = (points.transforms(light, window) for light in lights)
    chosen = [
        _chosen_tiling(points, side * tolerance)
        for tolerance in (
            _chosen_tiling(points, math.inf).cut_error / 0.4,
            points.error(interpolated, exact) / 0.2,
            points.error(exact, two) / 0.2,
            0.0,
        )
        for side in (1 + 1e-6, 1 - 1e-6)
    ]
    for name, got, wanted, rtol in (
        (
            "places",
            lights[0].fronts[0].height_um,
            3e3 * math.sqrt(2) * np.array([0, 0.25, 0.5, 0.7, 0.86, 0.97]),
            1e-5,  # the traced circle
        ),
        (
            "wavelengths, nodes, cells",
            [(tiling.wavelengths, tiling.nodes, tiling.psf_um / 4) for tiling in chosen],
            [(1, 3, 9), (1, 3, 17), (1, 3, 17), (1, 5, 17), (1, 5, 17), *[(2, 5, 17)] * 3],
            0.0,
        ),
        (
            "error that stays",
            chosen[0].error,
            2e-3 * math.pi + points.error(exact, two) + _distortion_error(points, exact),
            1e-9,
        ),
    ):
        check(name, got, wanted, rtol=rtol, why="the fewest")


def test_tiling_has_the_fewest_tiles_within_the_tolerance(monkeypatch) -> None:
    """Their error falls with the cube of their number, beside one of 2e-4 that stays: (100 cells of
    1000)³ for 24 tiles on 2400 cells. Two points of six tell that few are too few.
    """
    points = _TestPoints(Camera(die_mm=6.0), (1200, 2400), 2.5, np.ones(1), np.ones(1), 5.0)
    vars(points).update(bins=2, heights_um=4e3 * np.array([0.0, 0.25, 0.5, 0.7, 0.86, 0.97]))
    exact = np.ones((6, 8, 5), complex)
    cells_at_points: list[int] = []
    for name, value in {
        "camera_psfs": lambda *_: None,
        "psfs_between_tiles": lambda *args: cells_at_points.append(args[-1]) or args[-2],
        "psf_transform": lambda spacing, *_: exact[0] * (1 + (2 * spacing / 1000) ** 3),
        "choose_tiling": lambda _, **arguments: arguments["aperture_um"],
    }.items():
        monkeypatch.setattr(camera_lens, name, value)
    check(
        "odd cells of twice the size, with as many on each side; dots of two samples",
        [
            points.grid_cells(9),
            points.grid_cells(33),
            camera_lens.image_tiling(
                SpectralImage([550.0], 10.0, 2.5, data=np.ones((8, 8, 1))),
                with_lens("singlet", 6.0),
            ),
        ],
        [5, 17, 5.0],
        why="exact",
    )
    got = []
    for tolerance in (1.3e-3, 1.1e-3, 3.3e-4, 2.2e-4, 1e-5):
        tiling = _with_fewest_tiles(points, Tiling(0.0, 165.0, 0.0), exact, 2e-4, tolerance)
        got.append((tiling.spacing_um / 2.5, tiling.error, tiling.worst, sum(cells_at_points) / 33))
        cells_at_points.clear()
    check(
        "spacing, errors and points that were computed",
        got,
        [
            (spacing, 2e-4 + (spacing / 1000) ** 3, 2e-4 + (spacing / 1000) ** 3, computed)
            for spacing, computed in (
                (100, 6),
                (75, 6 + 6),
                (50, 2 + 6),
                (38, 2 + 2 + 6),
                (38, 2 + 6),
            )
        ],
        rtol=1e-9,
        why="rounding",
    )


def test_mtf_of_a_slow_lens_is_that_of_diffraction_and_of_a_fast_one_far_below() -> None:
    """Its rms over the die: of a tiny die on the axis of a slow lens that of the thin lens."""
    frequency = np.linspace(0, 45, 10)
    image = SpectralImage(
        [550.0],
        10.0,
        2.0,
        data=np.ones((50, 50, 1)),
        header={LENS_HEADER: asdict(Tiling(20.0, 40.0, 0.0))},
    )
    slow = with_lens("singlet", 0.1, options=CameraOptions(f_number=32.0), focal_length_mm=12.0)
    otf = optics.diffraction_otf(frequency, 550.0, slow.effective_f_number)
    check("f/32", lens_mtf(image, slow, np.ones(1), frequency), otf, atol=5e-3, why="waves")
    fast = with_lens("singlet", 2.7, focal_length_mm=12.0)
    heights_um = np.linspace(0, 1350 * math.sqrt(2), 9)
    means = _area_shares(fast, heights_um) @ [
        np.abs(np.fft.rfft2(periodic_psf(light, x_um, 0.0, 1.0, 256))[[0, 0, 8], [0, 8, 0]]) ** 2
        for light in [
            channel_wavefronts(fast, np.array([550.0]), np.ones(1), Tiling(20.0, 40.0, 0.0))
        ]
        for x_um in heights_um
    ]
    mtf = lens_mtf(image, fast, np.ones(1), np.array([0.0, 8e3 / 256]))
    check("squares", mtf**2, [1, means[1:].mean()], atol=1e-3, why="lines between frequencies")
    assert lens_mtf(image, without_lens(fast), np.ones(1), frequency) is None
