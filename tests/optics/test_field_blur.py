"""Blur that varies over the field, against closed forms, superposition point by point, and
conservation of light.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from helpers.blur import point_spread
from helpers.claims import Claim, check
from scipy.integrate import quad
from scipy.special import j0, jv

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.optics.diffraction import diffraction_otf
from pixsim.optics.field_blur import (
    BAND_END,
    OUTLINE_ANGLES,
    ChannelWavefronts,
    FieldBlur,
    PupilRays,
    RadialPsfs,
    distinct_tiles,
    farthest_tile_um,
    field_blur,
    fit_wavefronts,
    least_squares,
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
from pixsim.optics.lens import lens_from_prescription
from pixsim.optics.lens_waves import pupil_rays
from pixsim.optics.prescription import Prescription, Surface
from pixsim.optics.thin_lens import thin_lens_pupil

NM = 550.0
F_NUMBER = 8.0
PITCH_UM = 2.0  # cells of a film that resolve all that this lens passes
COARSE_UM = 4.0  # cells that do not resolve what a lens of f/4 passes
Waves = Callable[[Array, Array, float], Array]


def thin_lens_light(
    f_number: float, heights_mm: Array, waves: Waves, shift_um: float = 0.0
) -> ChannelWavefronts:
    """Return the light of a thin lens 1 mm from its image, whose OPD is a function of coordinates
    on the lens, in radii, and of the tangent of the field.
    """
    radius = np.sqrt((np.arange(16) + 1) / 16)[:, None]  # the last ring is the rim
    angle = np.arange(48) * (2 * np.pi / 48)
    u = (radius * np.sin(angle)).ravel()
    v = (radius * np.cos(angle)).ravel()
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


def aberrated(u: Array, v: Array, tangent: float) -> Array:
    """Return spherical aberration, coma, astigmatism and field curvature, in waves."""
    square = u**2 + v**2
    coma = 1.5 * tangent * v * square
    return 0.3 * square**2 + coma + 6 * tangent**2 * v**2 - 4 * tangent**2 * square


@pytest.fixture(scope="module")
def light() -> ChannelWavefronts:
    return thin_lens_light(F_NUMBER, np.linspace(0, 0.4, 17), aberrated)


@pytest.fixture(scope="module")
def sharp_light() -> ChannelWavefronts:
    return thin_lens_light(4.0, np.linspace(0, 0.6, 17), aberrated)


def otf_along(psf: Array, pitch_um: float) -> tuple[Array, Array, Array]:
    """Return frequencies in cycles/mm, and the OTF along columns and along rows."""
    half = len(psf) // 2
    spectrum = np.fft.fft2(psf)[:half, :half]
    return np.fft.rfftfreq(len(psf), pitch_um * 1e-3)[:half], spectrum[0], spectrum[:, 0]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# Kernels


def veil_between(z: Array) -> float:
    near, far = veil_mtf(z / (2 * np.pi * 40e-3), 40.0) / z
    return near - far


TURNS = np.linspace(-0.5, 0.5, 101, dtype=np.float32)
FAST = np.array([1.0, 1.5, 300.0, 1e15], np.float32)
CLAIMS = [
    # The MTF of light beyond a radius r is z F(z), F' = -J0(z)/z². SciPy before 1.17 is wrong
    # beyond z = 20.
    *(
        Claim(
            f"a veil falls as the cube of the distance, from {z:g}",
            lambda z=z: veil_between(np.array([z, 1.4 * z])),
            quad(lambda z: j0(z) / z**2, z, 1.4 * z, epsabs=1e-12)[0],
            atol=1e-10,
            why="quadrature",
        )
        for z in (0.5, 5.0, 19.0, 21.0, 60.0)
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
        lambda: mean_of_phase(FAST),
        np.zeros(4),
        atol=0.01,
        why="aberrations of many waves",
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_least_squares_are_those_of_lapack() -> None:
    rng = np.random.default_rng(3)
    u, v = rng.uniform(-0.7, 0.7, (2, 280))
    terms = np.array([u**a * v**b for a, b in powers()])
    values = rng.normal(size=280)
    coefficients, residuals = least_squares(terms, values)
    right = np.linalg.lstsq(terms.T, values, rcond=None)[0]
    check("residuals", residuals, values - right @ terms, atol=1e-10, why="rounding")
    check("fit", coefficients @ terms, right @ terms, atol=1e-9, why="rounding")
    twice, _ = least_squares(terms[[1, 1]], terms[1])
    check("one of two equal terms", twice, [1.0, 0.0], atol=1e-12, why="rounding")


def test_every_term_of_a_wavefront_is_in_the_pupil() -> None:
    """Phases of the pupil function are those of Σ c u^a v^b: a term left out is 0.1 at the rim."""
    exponents = powers()
    coefficients = np.random.default_rng(3).normal(0, 0.05, len(exponents))
    numbers = np.concatenate([[0.1, 0.1, 0.0], coefficients, np.ones(OUTLINE_ANGLES)])
    amplitude, area = pupil_function(numbers, NM, 0.0, 0.1 / 40)
    u, v = ((np.arange(n) - n // 2) / 40 for n in amplitude.shape)
    u = u[:, None]
    waves = sum(c * u**a * v**b for c, (a, b) in zip(coefficients, exponents, strict=True))
    left = np.angle(amplitude * np.exp(2j * np.pi * waves))[np.hypot(u, v) < 0.95]
    check("phases", left, np.zeros(left.shape), atol=1e-4, why="single precision")
    check("area of a disc", area, np.pi * 40**2, rtol=1e-4, why="shares of samples")


def test_psfs_reach_as_far_as_tiles_and_points_amid_them() -> None:
    for cells, spacing, psf_cells in (
        (128, 5, 9),
        (96, 8, 17),
        (9, 8, 3),
        (40, 4, 33),
        (1024, 43, 65),
    ):
        reach_um = farthest_tile_um((cells, cells), 1.0, spacing, psf_cells)
        tiles = distinct_tiles((cells + psf_cells - 1,) * 2, spacing)
        corner = (cells / 2 + 1.5 * spacing) * math.sqrt(2)  # around a corner that is amid tiles
        assert max(corner, *(math.hypot(*place) * spacing for place in tiles)) <= reach_um


@pytest.mark.parametrize("slope", [0.0, 2.0])
def test_error_of_a_picture_is_the_worst_mixture_of_its_frequencies(slope: float) -> None:
    """An error of 1 % at one frequency, in pictures of which every part ends there or beyond."""
    exact = np.ones((32, 17), complex)
    approximate = exact.copy()
    approximate[0, 3] += 0.01
    fy = np.fft.fftfreq(32)[:, None]
    fx = np.fft.rfftfreq(32)
    frequency = np.hypot(fy, fx)
    column = np.arange(17)
    weight = np.where((column > 0) & (column < 16), 2.0, 1.0) * (np.sinc(fy) * np.sinc(fx)) ** 2
    weight = weight / np.maximum(frequency, 1 / 32) ** slope
    below = (frequency > 0) & (frequency < 3 / 32)
    least = weight[below].sum() + weight[0, 3]  # the order among equal frequencies is that of rows
    worst = 0.01 * math.sqrt(weight[0, 3] / least)
    bound = picture_error(approximate, exact, 1.0, 1.0, slope)
    check("bound", bound, worst, rtol=1e-9, why="rounding")
    check(
        "of half the area",
        picture_error(
            np.array([approximate, exact]), np.array([exact, exact]), 1.0, 1.0, slope, [0.5, 0.5]
        ),
        worst * math.sqrt(0.5),
        rtol=1e-9,
        why="rounding",
    )


# PSFs


def test_traced_thin_lens_has_the_diffraction_otf_with_cut_offs_that_fall_as_cosines() -> None:
    """Equiconvex, f = 1 mm, f/100, 10 nm thick, stop at the lens: from its rays to its OTF, with
    0.006 waves of astigmatism. Radially the pupil is seen cos³ as wide, sagittally cos.
    """
    glass = constant_glass("n = 1.5", 1.5)
    surfaces = Surface(1.0, 1e-5, glass), Surface(-1.0, 1.0)
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
            wanted = diffraction_otf(frequency, NM, effective / cosine**power) + 0j
            check(name, otf, wanted, atol=1e-3, why="astigmatism")


def hopkins(frequency: Array, w20: float) -> Array:
    """Return the OTF of a defocused circular pupil; frequency 2 is the cut-off. H. H. Hopkins,
    Proc. R. Soc. A 231 (1955) 91, eq. (25).
    """
    a = 4 * np.pi * w20 * frequency
    beta = np.arccos(frequency / 2)
    n = np.arange(1, 60)[:, None]
    bessel = np.sin(2 * n * beta) / n * (jv(2 * n - 1, a) - jv(2 * n + 1, a))
    first = beta * jv(1, a) + 0.5 * np.sum((-1.0) ** (n + 1) * bessel, axis=0)
    m = np.arange(60)[:, None]
    bessel = np.sin((2 * m + 1) * beta) / (2 * m + 1) * (jv(2 * m, a) - jv(2 * m + 2, a))
    second = np.sum((-1.0) ** m * bessel, axis=0)
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
    assert 200.0 <= psfs.max_height_um < 232.0
    radius_um = psfs.max_height_um if height_um is None else height_um
    place = radius_um * math.cos(azimuth), radius_um * math.sin(azimuth)
    whole = np.roll(periodic_psf(sharp_light, *place, COARSE_UM, 240), (16, 16), (0, 1))[:33, :33]
    assert rms(psfs.at([place], COARSE_UM, 33)[0].kernel - whole) < 5e-4 * rms(whole)
    for far, pitch_um, words in ((300.0, 4.0, "from the axis: got 300"), (0.0, 3.9, "got 3.9 µm")):
        with pytest.raises(PixsimError, match=words):
            psfs.at([(far, 0.0)], pitch_um, 33)


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


def test_transform_of_a_psf_is_that_of_its_film_cells_on_any_window(
    sharp_light: ChannelWavefronts,
) -> None:
    psfs = radial_psfs(sharp_light, 1.0, 33, 50.0, 400.0)
    window = np.fft.irfft2(psfs.transform([(200.0, 100.0)], 1.0, (150, 121))[0], (150, 121))
    kernel = psfs.at([(200.0, 100.0)], 1.0, 33)[0].kernel
    middle = np.roll(window, (16, 16), axis=(0, 1))[:33, :33]
    check("cells", middle, kernel.astype(float), atol=1e-3 * kernel.max(), why="tails")
    point = np.zeros((150, 121))
    point[40, 50] = 1.0
    (spread,) = psfs.blurred([(point, 1.0)], 200.0, 100.0)
    check("a point", spread, np.roll(window, (40, 50), axis=(0, 1)), atol=1e-12, why="rounding")
    fine = np.random.default_rng(2).random((160, 120))
    films = [(fine, 1.0), (fine.reshape(80, 2, 60, 2).mean(axis=(1, 3)), 2.0)]
    for film, blurred in zip(films, psfs.blurred(films, 200.0, 100.0), strict=True):
        (alone,) = psfs.blurred([film], 200.0, 100.0)
        check("two films of one spectrum", blurred, alone, atol=1e-6, why="float32")


# Pictures


def random_dots(side: int) -> Array:
    return (np.random.default_rng(3).random((256, 256)) < 1 / 250).astype(float)[:side, :side]


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
    side, near = 128, 32
    dots = random_dots(side)
    points = np.random.default_rng(5).integers(near, side - near, (4, 2))

    def psf_of(source: Array) -> Array:
        y_um, x_um = (source - (side - 1) / 2) * COARSE_UM
        return periodic_psf(sharp_light, x_um, y_um, COARSE_UM, 160)

    exact = []
    for point in points:
        corner = point - near
        part = dots[corner[0] : corner[0] + 2 * near + 1, corner[1] : corner[1] + 2 * near + 1]
        sources = np.argwhere(part) + corner
        inside = np.roll(psf_of(point), (near, near), (0, 1))[: 2 * near + 1, : 2 * near + 1].sum()
        value = sum(float(psf_of(source)[tuple(point - source)]) for source in sources)
        exact.append(value + dots.mean() * (1 - inside))
    pictures = {}
    for spacing in (32, 16, 8, 4):
        blur = blur_of_tiles(sharp_light, dots.shape, COARSE_UM, spacing, 33)
        pictures[spacing] = blur.blurred(dots) * blur.flat_field
    contrast = pictures[4].std()
    parts = [rms(pictures[spacing] - pictures[4]) / contrast for spacing in (32, 16, 8)]
    totals = [rms(picture[tuple(points.T)] - exact) / contrast for picture in pictures.values()]
    assert min(math.log2(parts[0] / parts[1]), math.log2(parts[1] / parts[2])) > 1.8, parts
    assert max(totals[1:]) < 0.001, totals
    assert parts[0] < tile_bound(sharp_light, side, 32)
    assert parts[1] < tile_bound(sharp_light, side, 16) < tile_bound(sharp_light, side, 32)


def test_mirrors_do_not_change_the_blur(light: ChannelWavefronts) -> None:
    """Tiles of one octant serve all of them."""
    picture = random_dots(97)
    blur = blur_of_tiles(light, picture.shape, PITCH_UM, 16, 17)
    blurred = np.array(blur.blurred(picture))
    for turned in (np.flipud, np.fliplr, np.transpose):
        got = turned(blur.blurred(turned(picture)))
        check(turned.__name__, got, blurred, atol=2e-6, why="single precision")


@pytest.mark.parametrize("shape", [(96, 96), (97, 97), (65, 128), (65, 97)])
def test_light_is_preserved_before_it_leaves_the_picture(
    shape: tuple[int, int], light: ChannelWavefronts
) -> None:
    picture = np.random.default_rng(1).random(shape)
    blur = blur_of_tiles(light, shape, PITCH_UM, 16, 17)
    spread, tails = blur.superposed(np.pad(picture, blur.cells // 2))
    check("light", spread.sum() + tails.sum(), picture.sum(), rtol=1e-9, why="conserved")
    assert 0.01 < tails.sum() / picture.sum() < blur.tail_share < 0.1
    flat = np.ones(shape)
    check("a uniform scene", blur.blurred(flat), flat, rtol=1e-6, why="single precision")


@pytest.fixture(scope="module")
def coma_blur() -> FieldBlur:
    coma = thin_lens_light(
        F_NUMBER, np.linspace(0, 0.4, 9), lambda u, v, t: 4.0 * t * v * (u**2 + v**2)
    )
    return blur_of_tiles(coma, (161, 161), PITCH_UM, 20, 65)


@pytest.mark.parametrize(("x", "y"), [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (1, -1)])
def test_point_is_shifted_along_its_field_by_the_mean_slope_of_the_wavefront(
    x: int, y: int, coma_blur: FieldBlur
) -> None:
    """Coma W = c t v (u² + v²) sends light outwards by the mean of λ ∂W/∂(cosine), c t λ/NA."""
    picture = np.zeros((161, 161))
    picture[80 + 40 * y, 80 + 40 * x] = 1.0
    blurred = coma_blur.superposed(np.pad(picture, 32))[0][64:-64, 64:-64]
    axis = np.arange(161)
    mean = np.array([(blurred * axis).sum(), (blurred * axis[:, None]).sum()]) / blurred.sum()
    outwards = np.array([x, y]) / math.hypot(x, y)
    wanted_um = 4.0 * math.hypot(x, y) * 40 * PITCH_UM * 1e-3 * NM * 1e-3 * 2 * F_NUMBER
    moved_um = (mean - 80 - 40 * np.array([x, y])) * PITCH_UM
    check("shift", moved_um, wanted_um * outwards, atol=0.03 * wanted_um, why="tails")
