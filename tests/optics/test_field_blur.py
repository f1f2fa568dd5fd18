"""Blur that varies over the field, against closed forms, superposition point by point, and
conservation of light.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from helpers.blur import point_spread
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
    FittedWavefronts,
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
ROUND = np.linspace(0, 2 * np.pi, 721)
RINGS, SPOKES = 16, 48


def fitted(
    f_number: float,
    heights_mm: Array,
    distance_mm: float,
    waves: Callable[[Array, Array, float], Array],
    shift_um: float = 0.0,
) -> FittedWavefronts:
    """Wavefronts of a thin lens whose OPD is a function of coordinates on the lens, in radii, and
    of the tangent of the field.
    """
    radius = np.sqrt((np.arange(RINGS) + 1) / RINGS)  # the last ring is the rim
    angle = np.arange(SPOKES) * (2 * np.pi / SPOKES)
    u, v = ((radius[:, None] * turned).ravel() for turned in (np.sin(angle), np.cos(angle)))
    fronts = []
    for height_mm in heights_mm:
        tangent = height_mm / distance_mm
        outline = thin_lens_pupil(f_number, tangent, 90.0).boundary(ROUND)[0]
        tan_alpha = 0.5 / f_number
        # The chief ray rises away from the axis; a point of the lens on that side sends its ray at
        # a smaller angle.
        slopes = np.stack([tan_alpha * u, tangent + tan_alpha * v], -1)
        cosines = slopes / np.sqrt(1 + np.square(slopes).sum(-1, keepdims=True))
        fronts.append(
            PupilRays(cosines, waves(u, v, tangent), outline, 1e3 * height_mm + shift_um * tangent)
        )
    return fit_wavefronts(NM, 1e3 * heights_mm, fronts)


def perfect(u: Array, v: Array, tangent: float) -> Array:
    return 0 * u


def otf_along(psf: Array, pitch_um: float) -> tuple[Array, Array, Array]:
    """Frequencies in cycles/mm, and the OTF along columns and along rows."""
    n = len(psf)
    spectrum = np.fft.fft2(psf)[: n // 2, : n // 2]
    return np.fft.rfftfreq(n, pitch_um * 1e-3)[: n // 2], spectrum[0], spectrum[:, 0]


@pytest.mark.parametrize("from_z", [0.5, 5.0, 19.0, 21.0, 60.0])
def test_veil_of_light_that_falls_as_the_cube_of_the_distance(from_z: float):
    """The MTF of light beyond a radius r is z F(z), F' = -J0(z)/z². SciPy before 1.17 is wrong
    beyond z = 20.
    """
    to_z, radius_um = 1.4 * from_z, 40.0
    near, far = veil_mtf(np.array([from_z, to_z]) / (2 * np.pi * radius_um * 1e-3), radius_um)
    right, error = quad(lambda z: j0(z) / z**2, from_z, to_z, epsabs=1e-12)
    assert error < 1e-11
    assert near / from_z - far / to_z == pytest.approx(right, abs=1e-10)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 35.0])
def test_perfect_lens_has_the_diffraction_otf_with_cut_offs_that_fall_as_cosines(
    degrees: float,
) -> None:
    f_number, distance_mm = 32.0, 10.0
    nodes = np.linspace(0, distance_mm * math.tan(math.radians(40)), 9)
    light = ChannelWavefronts([fitted(f_number, nodes, distance_mm, perfect)], np.ones(1))
    height_um = 1e3 * distance_mm * math.tan(math.radians(degrees))
    psf = periodic_psf(light, height_um, 0.0, 4.0, 400)
    frequency, along, across = otf_along(psf, 4.0)
    cosine, effective = math.cos(math.radians(degrees)), math.hypot(1, 2 * f_number) / 2
    # The image point looks along x: radially the pupil is seen cos³ as wide, sagittally cos.
    np.testing.assert_allclose(
        along, diffraction_otf(frequency, NM, effective / cosine**3), atol=1e-3
    )
    np.testing.assert_allclose(
        across, diffraction_otf(frequency, NM, effective / cosine), atol=1e-3
    )


def test_traced_thin_lens_has_the_diffraction_otf_with_cut_offs_that_fall_as_cosines() -> None:
    """Equiconvex, f = 1 mm, f/100, 10 nm thick, stop at the lens: from its rays to its OTF, with
    0.006 waves of astigmatism.
    """
    glass = constant_glass("n = 1.5", 1.5)
    surfaces = Surface(1.0, 1e-5, glass), Surface(-1.0, 1.0)
    lens = lens_from_prescription(
        Prescription("thin", "", "", surfaces, 0, "f_number", 100.0, "angle_deg", 20.0, (NM,), NM)
    )
    fields = np.linspace(0, 20, 5)
    (rays,) = pupil_rays(lens, fields, np.array([NM]))
    light = ChannelWavefronts(
        [fit_wavefronts(NM, np.array([one.height_um for one in rays]), rays)], np.ones(1)
    )
    for degrees, one in zip(fields.tolist(), rays, strict=True):
        frequency, along, across = otf_along(
            periodic_psf(light, one.height_um, 0.0, 12.0, 400), 12.0
        )
        cosine, effective = math.cos(math.radians(degrees)), math.hypot(1, 200.0) / 2
        np.testing.assert_allclose(
            along, diffraction_otf(frequency, NM, effective / cosine**3), atol=1e-3
        )
        np.testing.assert_allclose(
            across, diffraction_otf(frequency, NM, effective / cosine), atol=1e-3
        )


def test_every_term_of_a_wavefront_is_in_the_pupil() -> None:
    """Phases of the pupil function are those of Σ c u^a v^b, to the rounding of single
    precision.
    """
    exponents, outline = powers(), np.ones(OUTLINE_ANGLES)
    coefficients = np.random.default_rng(3).normal(0, 0.05, len(exponents))
    half, step = 0.1, 0.1 / 40
    amplitude, _ = pupil_function(
        np.concatenate([[half, half, 0.0], coefficients, outline]), NM, 0.0, step
    )
    v, reach = (
        (np.arange(amplitude.shape[1]) - amplitude.shape[1] // 2) * step / half,
        amplitude.shape[0] // 2,
    )
    u = ((np.arange(amplitude.shape[0]) - reach) * step / half)[:, None]
    waves = sum(c * u**a * v**b for c, (a, b) in zip(coefficients, exponents, strict=True))
    inside = np.hypot(u, v) < 0.95
    turned = np.angle(amplitude * np.exp(2j * np.pi * waves))[inside]
    assert np.abs(turned).max() < 1e-4  # a term left out is 0.1 at the rim


def hopkins(frequency: Array, w20: float) -> Array:
    """OTF of a defocused circular pupil; frequency 2 is the cut-off. H. H. Hopkins, Proc. R. Soc. A
    231 (1955) 91, eq. (25).
    """
    s, places = np.unique(
        frequency, return_inverse=True
    )  # of a square of frequencies an eighth differ, and each takes 240 J_n
    a = 4 * np.pi * w20 * s
    beta = np.arccos(s / 2)
    n = np.arange(1, 60)[:, None]
    sign = (-1.0) ** (n + 1)
    first = beta * jv(1, a) + 0.5 * np.sum(
        sign * np.sin(2 * n * beta) / n * (jv(2 * n - 1, a) - jv(2 * n + 1, a)), axis=0
    )
    m = np.arange(0, 60)[:, None]
    second = np.sum(
        (-1.0) ** m * np.sin((2 * m + 1) * beta) / (2 * m + 1) * (jv(2 * m, a) - jv(2 * m + 2, a)),
        axis=0,
    )
    return (4 / (np.pi * a) * (np.cos(a * s / 2) * first - np.sin(a * s / 2) * second))[places]


@pytest.mark.parametrize("w20", [0.25, 0.5, 1.0, 2.0])
def test_defocus_has_the_otf_of_hopkins(w20: float) -> None:
    f_number = 200.0
    light = ChannelWavefronts(
        [fitted(f_number, np.zeros(1), 1.0, lambda u, v, _: w20 * (u**2 + v**2))], np.ones(1)
    )
    pitch_um = 20.0
    frequency, otf, _ = otf_along(periodic_psf(light, 0.0, 0.0, pitch_um, 900), pitch_um)
    reduced = 2 * frequency * NM * 1e-6 * math.hypot(1, 2 * f_number) / 2
    inside = (reduced > 0) & (reduced < 2)
    np.testing.assert_allclose(otf.real[inside], hopkins(reduced[inside], w20), atol=1e-4)
    np.testing.assert_allclose(otf.imag, 0, atol=1e-4)


F_NUMBER, DISTANCE_MM = 8.0, 1.0
FILM, PITCH_UM, CELLS = 256, 2.0, 33  # cells are the pixels; they resolve all that this lens passes


def uneven(u: Array, v: Array, tangent: float) -> Array:
    """A lens with spherical aberration, coma, astigmatism and field curvature, in waves."""
    square = u**2 + v**2
    return (
        0.3 * square**2
        + 1.5 * tangent * v * square
        + 6 * tangent**2 * v**2
        - 4 * tangent**2 * square
    )


@pytest.fixture(scope="module")
def uneven_light() -> ChannelWavefronts:
    return ChannelWavefronts(
        [fitted(F_NUMBER, np.linspace(0, 0.4, 17), DISTANCE_MM, uneven)], np.ones(1)
    )


def superposed_at(picture: Array, points: Array) -> Array:
    """The blurred picture at cells (n, 2) by superposition: the PSF of each lit cell is a
    quadrature over the lens.
    """
    node, weight = np.polynomial.legendre.leggauss(14)
    radius, angle = np.sqrt((1 + node) / 2)[:, None], np.arange(60) * (2 * np.pi / 60)
    u, v = ((radius * turned).ravel() for turned in (np.sin(angle), np.cos(angle)))
    weight = np.repeat(weight / weight.sum() / angle.size, angle.size)
    tan_alpha, um = 0.5 / F_NUMBER, NM * 1e-3
    values = []
    for point in points:
        first = np.maximum(point - CELLS // 2, 0)
        lit = (
            np.argwhere(
                picture[first[0] : point[0] + CELLS // 2 + 1, first[1] : point[1] + CELLS // 2 + 1]
            )
            + first
        )
        source = (lit - (FILM - 1) / 2)[:, ::-1]
        outward = source / np.hypot(*source.T)[:, None]
        away_um = (point - lit)[:, ::-1] * PITCH_UM
        tangent = (np.hypot(*source.T) * PITCH_UM * 1e-3 / DISTANCE_MM)[:, None]
        radial, sagittal = tangent + tan_alpha * v, tan_alpha * u
        cosine = 1 / np.sqrt(1 + radial**2 + sagittal**2)
        along, aside = (
            (outward * away_um).sum(1),
            outward[:, 0] * away_um[:, 1] - outward[:, 1] * away_um[:, 0],
        )
        path_um = (radial * along[:, None] + sagittal * aside[:, None]) * cosine
        area = weight * cosine**4  # of directions, for each part of the lens, in units of π tan²α
        phase = np.float32(2 * np.pi * (path_um / um - uneven(u, v, tangent)))
        amplitude = (area * np.cos(phase)).sum(1) + 1j * (area * np.sin(phase)).sum(1)
        psf = (
            np.abs(amplitude) ** 2 / area.sum(1) * np.pi * tan_alpha**2 / um**2
        )  # Parseval: adds up to 1
        values.append((picture[lit[:, 0], lit[:, 1]] * psf).sum() * PITCH_UM**2)
    return np.array(values)


def random_dots() -> Array:
    return (np.random.default_rng(3).random((FILM, FILM)) < 1 / 250).astype(float)


def contrast_chart() -> Array:
    """Frequencies that rise to the right, contrast that rises downwards, as in the packaged csf
    chart, about its mean.
    """
    x, y = np.arange(FILM) / FILM, np.arange(FILM)[:, None] / FILM
    return 0.01 ** (1 - y) * np.sin(2 * np.pi * 4 * (16**x - 1) / np.log(16))


def camera_psfs(
    light: ChannelWavefronts, shape: tuple[int, int], pitch_um: float, spacing: int, cells: int
) -> RadialPsfs:
    return radial_psfs(
        light,
        pitch_um,
        cells,
        spacing * pitch_um / 2,
        farthest_tile_um(shape, pitch_um, spacing, cells),
    )


def camera_blur(
    light: ChannelWavefronts, shape: tuple[int, int], pitch_um: float, spacing: int, cells: int
) -> FieldBlur:
    return field_blur(
        camera_psfs(light, shape, pitch_um, spacing, cells), shape, pitch_um, spacing, cells
    )


def bound_of(light: ChannelWavefronts, spacing: int) -> float:
    """The bound of tiles for random dots all over the picture, from places on the way to its
    corner.
    """
    psfs = camera_psfs(light, (FILM, FILM), PITCH_UM, spacing, CELLS)
    places = [(part * FILM / 2 * PITCH_UM,) * 2 for part in (0.25, 0.5, 0.7, 0.8)]
    window = max(psf_window(light, *place, PITCH_UM, CELLS) for place in places)
    exact = np.array(
        [np.fft.rfft2(periodic_psf(light, *place, PITCH_UM, window)) for place in places]
    )
    tiles = np.array(
        [
            psf_transform(
                psfs_between_tiles(psfs, *place, PITCH_UM, spacing, CELLS), PITCH_UM, window
            )
            for place in places
        ]
    )
    return picture_error(tiles, exact, PITCH_UM, PITCH_UM, share=[0.2, 0.3, 0.3, 0.2])


SPACINGS = (64, 32)


@pytest.fixture(scope="module")
def bounds(uneven_light: ChannelWavefronts) -> list[float]:
    return [bound_of(uneven_light, spacing) for spacing in SPACINGS]


# Each point of the chart is a sum over a thousand lit cells, of the dots over four.
@pytest.mark.parametrize(
    ("picture", "count"), [(random_dots(), 64), (contrast_chart(), 16)], ids=["random dots", "csf"]
)
def test_tiles_agree_with_superposition_within_their_bound(
    picture: Array, count: int, uneven_light: ChannelWavefronts, bounds: list[float]
) -> None:
    points = np.random.default_rng(5).integers(30, FILM - 30, (count, 2))
    exact, errors = superposed_at(picture, points), []
    for spacing, bound in zip(SPACINGS, bounds, strict=True):
        blur = camera_blur(uneven_light, picture.shape, PITCH_UM, spacing, CELLS)
        reach = CELLS // 2
        found = blur.superposed(np.pad(picture, reach))[0][
            2 * reach : -2 * reach, 2 * reach : -2 * reach
        ]
        errors.append(
            np.sqrt(np.mean((found[tuple(points.T)] - exact) ** 2)) / found[30:-30, 30:-30].std()
        )
        assert errors[-1] < bound


COARSE_UM = 4.0  # cells that do not resolve what the lens of f/4 passes


@pytest.fixture(scope="module")
def sharp_light() -> ChannelWavefronts:
    return ChannelWavefronts(
        [fitted(4.0, np.linspace(0, 0.6, 17), DISTANCE_MM, uneven)], np.ones(1)
    )


def test_error_of_tiles_falls_with_their_number_on_a_film_that_does_not_resolve_the_lens(
    sharp_light: ChannelWavefronts,
) -> None:
    """All light counts, also that beyond the PSFs; superposition takes whole PSFs from their own
    pupils.

    The part of the tiles falls with the fourth power of their number, as cubic windows have it;
    what a PSF lacks stays.
    """
    side, cells, near = 128, 33, 32
    dots = random_dots()[:side, :side]
    points = np.random.default_rng(5).integers(
        near, side - near, (4, 2)
    )  # they tell their RMS, half of the gate, to 35 %

    def psf_of(source: Array) -> Array:
        y_um, x_um = (source - (side - 1) / 2) * COARSE_UM
        return periodic_psf(sharp_light, x_um, y_um, COARSE_UM, 160)

    exact = []
    for point in points:
        lit = (
            np.argwhere(
                dots[point[0] - near : point[0] + near + 1, point[1] - near : point[1] + near + 1]
            )
            + point
            - near
        )
        here = np.roll(psf_of(point), (near, near), (0, 1))[: 2 * near + 1, : 2 * near + 1].sum()
        exact.append(
            sum(float(psf_of(source)[tuple(point - source)]) for source in lit)
            + dots.mean() * (1 - here)
        )
    pictures = {}
    for spacing in (32, 16, 8, 4):
        blur = camera_blur(sharp_light, dots.shape, COARSE_UM, spacing, cells)
        pictures[spacing] = blur.blurred(dots) * blur.flat_field
    contrast = pictures[4].std()
    parts = [
        float(np.sqrt(np.mean((pictures[spacing] - pictures[4]) ** 2)) / contrast)
        for spacing in (32, 16, 8)
    ]
    totals = [
        float(np.sqrt(np.mean((found[tuple(points.T)] - exact) ** 2)) / contrast)
        for found in pictures.values()
    ]
    assert math.log2(parts[0] / parts[1]) > 1.8, parts
    assert math.log2(parts[1] / parts[2]) > 1.8, parts
    assert max(totals[1:]) < 0.001, totals


def test_a_psf_is_seen_through_a_low_pass_that_ends_softly() -> None:
    """The raised cosine's response in closed form, convolved with a PSF whose samples resolve
    it.
    """
    light = ChannelWavefronts(
        [fitted(4.0, np.linspace(0, 0.4, 9), 1.0, uneven, shift_um=9.0)], np.ones(1)
    )
    finer, window, place = 8, 96, (250.0, 120.0)
    fine = np.fft.fftshift(periodic_psf(light, *place, COARSE_UM / finer, window * finer))
    found = np.fft.fftshift(periodic_psf(light, *place, COARSE_UM, window))
    away = (np.arange(window)[:, None] - window // 2) - (
        np.arange(window * finer) - window * finer // 2
    ) / finer  # in cells
    with np.errstate(divide="ignore", invalid="ignore"):
        through = np.sinc(away) * np.cos(np.pi * BAND_END * away) / (1 - (2 * BAND_END * away) ** 2)
    through[np.isclose(np.abs(away), 1 / (2 * BAND_END))] = np.pi / 4 * np.sinc(1 / (2 * BAND_END))
    wanted = through @ fine @ through.T
    middle = slice(window // 4, -window // 4)
    norm = np.sqrt(np.sum(wanted**2))
    assert (
        np.sqrt(np.sum((found - wanted)[middle, middle] ** 2)) < 3e-4 * norm
    )  # what repeats from beyond the window
    outside = wanted.copy()
    outside[window // 2 - 16 : window // 2 + 17, window // 2 - 16 : window // 2 + 17] = 0
    assert np.sqrt(np.sum(outside**2)) < 4e-3 * norm  # a band that breaks off leaves 7 % there


def test_turned_and_interpolated_psfs_are_those_of_their_own_pupils(
    sharp_light: ChannelWavefronts,
) -> None:
    """Between the distances that are computed, at any azimuth, and at the end of what is known;
    beyond it there is none.
    """
    step_um, cells = 16.0, 33
    psfs = radial_psfs(sharp_light, COARSE_UM, cells, step_um, 200.0)
    for height_um, azimuth in (
        (0.0, 0.0),
        (3.0, 0.4),
        (100.0, 0.8),
        (200.0, 2.1),
        (psfs.max_height_um, -2.5),
    ):
        place = height_um * math.cos(azimuth), height_um * math.sin(azimuth)
        whole = np.roll(
            periodic_psf(sharp_light, *place, COARSE_UM, 240), (cells // 2, cells // 2), (0, 1)
        )
        error = psfs.at([place], COARSE_UM, cells)[0].kernel - whole[:cells, :cells]
        assert np.sqrt(np.sum(error**2)) < 5e-4 * np.sqrt(np.sum(whole**2)), (height_um, azimuth)
    assert 200.0 <= psfs.max_height_um < 200.0 + 2 * step_um
    with pytest.raises(
        PixsimError, match=r"distance of a PSF from the axis: got 300 µm; allowed: at most 2\d\d µm"
    ):
        psfs.at([(300.0, 0.0)], COARSE_UM, cells)
    with pytest.raises(
        PixsimError, match=r"film cell of a PSF: got 3\.9 µm; allowed: at least 4 µm"
    ):
        psfs.at([(0.0, 0.0)], 3.9, cells)


def test_psfs_that_hold_all_that_the_lens_passes_serve_for_every_film(
    sharp_light: ChannelWavefronts,
) -> None:
    """A film ten times finer than the lens has the PSFs of the coarsest film that shows all of
    it.
    """
    resolving = resolving_um(sharp_light)
    known = radial_psfs(sharp_light, resolving / 10, 301, 50.0, 400.0)
    assert known.pitch_um == 0.0
    for pitch_um, cells in ((resolving / 4, 121), (resolving / 1.5, 45), (2 * resolving, 15)):
        kernel = known.at([(210.0, 90.0)], pitch_um, cells)[0].kernel
        right = point_spread(sharp_light, 210.0, 90.0, pitch_um, cells).kernel
        assert np.abs(kernel - right).max() < 2e-3 * right.max()  # of the interpolation, as above
        assert kernel.sum() == pytest.approx(
            right.sum(), abs=0.01
        )  # what lies beyond the windows folds back


def test_transform_of_a_psf_is_that_of_its_film_cells_on_any_window(
    sharp_light: ChannelWavefronts,
) -> None:
    known = radial_psfs(sharp_light, 1.0, 33, 50.0, 400.0)
    window = np.fft.irfft2(known.transform([(200.0, 100.0)], 1.0, (150, 121))[0], (150, 121))
    kernel = known.at([(200.0, 100.0)], 1.0, 33)[0].kernel
    np.testing.assert_allclose(
        np.roll(window, (16, 16), axis=(0, 1))[:33, :33], kernel, atol=1e-3 * kernel.max()
    )
    point = np.zeros((150, 121))
    point[40, 50] = 1.0
    (spread,) = known.blurred([(point, 1.0)], 200.0, 100.0)
    np.testing.assert_allclose(spread, np.roll(window, (40, 50), axis=(0, 1)), atol=1e-12)
    fine = np.random.default_rng(2).random((160, 120))
    films = [(fine, 1.0), (fine.reshape(80, 2, 60, 2).mean(axis=(1, 3)), 2.0)]  # of one spectrum
    for film, found in zip(films, known.blurred(films, 200.0, 100.0), strict=True):
        np.testing.assert_allclose(found, known.blurred([film], 200.0, 100.0)[0], atol=1e-6)


def test_least_squares_are_those_of_lapack() -> None:
    rng = np.random.default_rng(3)
    u, v = rng.uniform(-0.7, 0.7, (2, 280))
    terms = np.array([u**a * v**b for a, b in powers()])
    values = rng.normal(size=280)
    coefficients, left = least_squares(terms, values)
    right = np.linalg.lstsq(terms.T, values, rcond=None)[0]
    np.testing.assert_allclose(left, values - right @ terms, atol=1e-10)
    np.testing.assert_allclose(coefficients @ terms, right @ terms, atol=1e-9)
    twice, _ = least_squares(
        np.array([terms[1], terms[1]]), terms[1]
    )  # one of two equal terms is enough
    assert twice.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("cells", "spacing", "psf_cells"),
    [(128, 5, 9), (96, 8, 17), (9, 8, 3), (40, 4, 33), (1024, 43, 65)],
)
def test_psfs_reach_as_far_as_tiles_and_points_amid_them(
    cells: int, spacing: int, psf_cells: int
) -> None:
    reach_um = farthest_tile_um((cells, cells), 1.0, spacing, psf_cells)
    tiles = [
        math.hypot(*place) * spacing
        for place in distinct_tiles((cells + psf_cells - 1,) * 2, spacing)
    ]
    corner = (cells / 2 + 1.5 * spacing) * math.sqrt(
        2
    )  # the farthest tile around a corner that is amid tiles
    assert max(*tiles, corner) <= reach_um


def test_mirrors_do_not_change_the_blur(uneven_light: ChannelWavefronts) -> None:
    """A picture mirrored or transposed is blurred as the mirrored blur: tiles of one octant serve
    all of them.
    """
    picture = random_dots()[:97, :97]
    blur = camera_blur(uneven_light, picture.shape, PITCH_UM, 16, 17)
    one = blur.blurred(picture)
    for turned in (np.flipud, np.fliplr, np.transpose):
        np.testing.assert_allclose(
            turned(blur.blurred(turned(picture))), one, atol=2e-6
        )  # in single precision


@pytest.mark.parametrize("shape", [(96, 96), (97, 97), (96, 65), (65, 128), (96, 128), (65, 97)])
def test_light_is_preserved_before_it_leaves_the_picture(
    shape: tuple[int, int], uneven_light: ChannelWavefronts
) -> None:
    picture = np.random.default_rng(1).random(shape)
    blur = camera_blur(uneven_light, shape, PITCH_UM, 16, 17)
    reach = blur.cells // 2
    full, lacked = blur.superposed(np.pad(picture, reach))
    assert full.sum() + lacked.sum() == pytest.approx(picture.sum(), rel=1e-9)
    assert 0.01 < lacked.sum() / picture.sum() < blur.tail_share < 0.1
    np.testing.assert_allclose(blur.blurred(np.ones(shape)), 1, rtol=1e-6)  # in single precision


QUADRANTS = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
COMA = 4.0


@pytest.fixture(scope="module")
def coma_blur() -> FieldBlur:
    light = ChannelWavefronts(
        [
            fitted(
                F_NUMBER, np.linspace(0, 0.4, 9), 1.0, lambda u, v, t: COMA * t * v * (u**2 + v**2)
            )
        ],
        np.ones(1),
    )
    return camera_blur(light, (161, 161), PITCH_UM, 20, 65)


@pytest.mark.parametrize(("x", "y"), QUADRANTS)
def test_a_point_is_shifted_along_its_field_by_the_mean_slope_of_the_wavefront(
    x: int, y: int, coma_blur: FieldBlur
) -> None:
    """Coma W = c t v (u² + v²) sends light outwards by the mean of λ ∂W/∂(cosine), c t λ/NA."""
    distance_mm, offset = 1.0, 40
    picture = np.zeros((161, 161))
    place = 80 + offset * y, 80 + offset * x
    picture[place] = 1.0
    blurred = coma_blur.superposed(np.pad(picture, 32))[0][64:-64, 64:-64]
    rows, columns = np.arange(161)[:, None], np.arange(161)
    found = np.array(
        [
            (blurred * axis).sum() / blurred.sum() - start
            for axis, start in zip((columns, rows), place[::-1], strict=True)
        ]
    )
    tangent = math.hypot(x, y) * offset * PITCH_UM * 1e-3 / distance_mm
    expected_um = COMA * tangent * NM * 1e-3 * 2 * F_NUMBER
    outwards = np.array([x, y]) / math.hypot(x, y)
    assert found @ outwards * PITCH_UM == pytest.approx(expected_um, rel=0.03)
    assert abs(found[0] * outwards[1] - found[1] * outwards[0]) * PITCH_UM < 0.01 * expected_um


def test_lateral_colour_moves_the_psf() -> None:
    light = ChannelWavefronts(
        [fitted(F_NUMBER, np.linspace(0, 0.4, 9), 1.0, perfect, shift_um=30.0)], np.ones(1)
    )
    kernel = point_spread(light, 0.0, 300.0, PITCH_UM, 65).kernel
    rows = np.arange(65) - 32
    assert (kernel * rows[:, None]).sum() / kernel.sum() * PITCH_UM == pytest.approx(
        30.0 * 0.3, rel=0.01
    )
    assert (kernel * rows).sum() == pytest.approx(0, abs=1e-6)


def test_psfs_act_on_means_over_cells_and_give_such_means() -> None:
    """Cells four times finer, blurred and averaged, against averages that are blurred: equal for
    all detail that the film holds.

    PSFs that are means over cells themselves would blur such means once more, by sinc² of the
    frequency times the cell.
    """
    light = ChannelWavefronts([fitted(4.0, np.linspace(0, 0.4, 9), 1.0, uneven)], np.ones(1))
    cells, finer = 120, 4
    generator = np.random.default_rng(9)
    spectrum = np.fft.rfft2(generator.standard_normal((cells * finer,) * 2))
    frequency = (
        np.hypot(np.fft.fftfreq(cells * finer)[:, None], np.fft.rfftfreq(cells * finer)) * finer
    )
    picture = np.fft.irfft2(spectrum * (frequency < 0.45))  # of 0.5, the film's Nyquist frequency

    def averaged(fine: Array) -> Array:
        return fine.reshape(cells, finer, cells, finer).mean(axis=(1, 3))

    def blurred(sharp: Array, psf: Array) -> Array:
        return np.fft.irfft2(np.fft.rfft2(sharp) * np.fft.rfft2(psf), sharp.shape)

    fine_psf = periodic_psf(light, 200.0, 100.0, PITCH_UM / finer, cells * finer)
    right = averaged(blurred(picture, fine_psf))
    found = blurred(averaged(picture), periodic_psf(light, 200.0, 100.0, PITCH_UM, cells))
    assert np.sqrt(np.mean((found - right) ** 2)) < 1e-4 * right.std()
    half = (
        finer // 2
    )  # a cell's middle lies between fine cells: the mean of both ways to divide them
    of_cells = [
        averaged(np.roll(fine_psf, (row, column), (0, 1)))
        for row in (half, half - 1)
        for column in (half, half - 1)
    ]
    twice = blurred(averaged(picture), finer**2 * np.mean(of_cells, axis=0))
    assert np.sqrt(np.mean((twice - right) ** 2)) > 0.05 * right.std()


def test_mean_of_a_phase_is_its_sinc_and_nothing_where_it_turns_faster() -> None:
    waves = np.linspace(-0.5, 0.5, 101, dtype=np.float32)
    np.testing.assert_allclose(mean_of_phase(waves), np.sinc(waves), atol=1e-5)
    fast = np.array([1.0, 1.5, 300.0, 1e15], np.float32)  # of aberrations of hundreds of waves
    np.testing.assert_allclose(mean_of_phase(fast), 0, atol=0.01)


def test_too_few_rays_are_refused() -> None:
    front = PupilRays(np.zeros((5, 2)), np.full(5, np.nan), np.zeros((5, 2)), 0.0)
    with pytest.raises(PixsimError, match="0 rays at 0 µm"):
        fit_wavefronts(NM, np.zeros(1), [front])
