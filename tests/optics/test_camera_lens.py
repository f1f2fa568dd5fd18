"""Real lenses in a camera: against their rays, the thin lens that stands for them, and the closed
forms of a thin real lens.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from helpers.blur import point_spread
from helpers.claims import Claim, check
from scipy.interpolate import CubicSpline

from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Distortion,
    Tiling,
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
    lens_mtf,
    lens_on_die,
    moved_error,
    rendered_camera,
    traced_lens,
    without_lens,
)
from pixsim.optics.camera_light import camera_pupil
from pixsim.optics.diffraction import diffraction_otf
from pixsim.optics.lens import Lens, load_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.viewer.setting import Run

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


def distortion_in(camera: Camera) -> Distortion:
    distortion = camera_distortion(camera)
    assert distortion is not None
    return distortion


GAUSS = with_lens("double_gauss", 24.0, focal_length_mm=45.0)


# Closed forms


def corner_mm() -> float:
    """Return where the chief ray of the largest field arrives."""
    lens = load_lens("cooke_triplet")
    traced = lens_in(with_lens("cooke_triplet", 20.0, 1e4))
    return float(traced.chief_ray(lens.max_field_deg, lens.primary_nm).height_mm)


BANDS = np.arange(400.0, 701.0, 10.0)
BELL = np.exp(-(((BANDS - 560) / 60) ** 2))
POWERS = np.arange(8)[:, None]
RANDOM = np.r_[0.0, np.random.default_rng(1).uniform(1, 2, 60), 0.0]
ONE_BAND = few_wavelengths(np.array([450.0, 550.0, 650.0]), np.array([0.0, 2.0, 0.0]), 4)


def moments(nm: np.ndarray, share: np.ndarray) -> np.ndarray:
    return (share * ((nm - 550) / 150) ** POWERS).sum(axis=1) / share.sum()


CLAIMS = [
    Claim(
        "the largest field reaches the corner unless a focal length is stated",
        corner_mm,
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
    Claim("one band is one wavelength", lambda: np.ravel(ONE_BAND), [550.0, 1.0]),
    Claim("groups of bands are whole", lambda: np.sum(band_groups(RANDOM, 6), axis=0), RANDOM > 0),
    Claim(
        "and of equal weight",
        lambda: np.array(band_groups(RANDOM, 6)) @ RANDOM,
        np.full(6, RANDOM.sum() / 6),
        atol=2.0,
        why="one band",
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# The thin lens that stands for a real one


@pytest.mark.parametrize("file", ["singlet", "cooke_triplet"])
def test_thin_lens_has_the_real_ones_light_on_the_axis_and_its_chief_rays(file: str) -> None:
    camera = with_lens(file, 10.0, focal_length_mm=40.0)
    lens = lens_in(camera)
    nm = lens.primary_nm
    factor = irradiance_factor(camera.f_number, 0.0, camera.magnification)
    rows = np.array(camera.chief_ray_angle)
    field = lens.field_of_height(4.0, nm)
    angle = float(lens.chief_ray(field, nm).angle_deg)
    illumination = float(lens.relative_illumination(field))
    for name, got, wanted, atol in (
        ("focal length", lens.first_order(nm).focal_length_mm, 40.0, 1e-8),
        ("light", factor, lens.projected_solid_angle_sr(0.0, nm), 1e-10),
        ("image distance", camera.image_distance_mm, lens.paraxial_height_mm, 1e-8),
        ("losses", camera.transmittance, 0.8, 0.0),
        ("chief ray", np.interp(4.0, rows[:, 0], rows[:, 1]), angle, 1e-3),
        ("fall-off", np.interp(4.0, rows[:, 0], rows[:, 2]), illumination, 3e-5),
    ):
        check(name, got, wanted, atol=atol, why="a table of 129 rows, or rounding")
    assert rows[-1, 0] >= math.hypot(10.0, 10.0) / 2


def test_lens_of_a_user_that_is_scaled_to_the_die_is_noted(tmp_path: Path) -> None:
    """A lens that is bought has one focal length."""
    (tmp_path / "mine.toml").write_text(SINGLET)
    with pytest.warns(UserWarning, match=r"is scaled so .*lens\.focal_length_mm = "):
        with_lens(tmp_path / "mine.toml", 10.0)
    focal_mm = load_lens("singlet").first_order(587.56).focal_length_mm
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with_lens(tmp_path / "mine.toml", 10.0, focal_length_mm=focal_mm)
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
    lines = [
        f"value_mm = {pupil_mm}" if line.startswith("value_mm") else line
        for line in SINGLET.splitlines()
    ]
    (tmp_path / "thin.toml").write_text("\n".join(lines))
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
    assert Run().model_dump()["lens"] == {}
    camera = with_lens("singlet", 4.0)
    plain = camera.options.over(Camera())
    assert camera_with_lens(plain, camera.options, camera.lens_options) == camera


def test_lens_on_another_die_sees_the_same_field() -> None:
    camera = with_lens("cooke_triplet", 24.0, 2.0)
    other = lens_on_die(camera, Camera(die_mm=6.0), same_view=True)
    check("field", other.fov_deg, camera.fov_deg, rtol=1e-6, why="four steps")
    quarter = camera.lens.focal_length_mm / 4
    assert other.lens.focal_length_mm == pytest.approx(quarter, rel=0.05)
    assert lens_on_die(camera, camera) == camera
    assert lens_on_die(camera, Camera(die_mm=12.0)).fov_deg < camera.fov_deg


def test_die_beyond_the_image_circle_is_dark_there() -> None:
    """US 7,535,658 has no rays beyond some field. The pupil there is that of the outermost light."""
    camera = with_lens("phone", 12.0, 1.0, focal_length_mm=5.2)
    heights_mm, _ = field_angles(camera.lens, 1.0, math.hypot(12.0, 12.0) / 2)
    assert heights_mm[-1] < 6
    dark = 1 - math.pi * heights_mm[-1] ** 2 / 144
    check("dark share", dark_share(camera), dark, atol=0.02, why="the pupil shrinks before")
    pupil = camera_pupil(camera).at([1e3 * heights_mm[-1], 6000.0], [0.0, 6000.0])
    last, beyond = np.linalg.norm(pupil.chief_cosines, axis=-1)
    check("chief ray", beyond, last, rtol=1e-12, why="the same pupil")


# Distortion


@pytest.mark.parametrize(("field", "azimuth"), [(8.0, 20.0), (14.0, 230.0)])
def test_points_lie_where_the_chief_rays_arrive(field: float, azimuth: float) -> None:
    """A spot at v tan θ of a picture without distortion is at the chief ray's height, and back."""
    distortion = distortion_in(GAUSS)
    lens = lens_in(GAUSS)
    y, x = np.indices((240, 240)) - 119.5
    radius = GAUSS.image_distance_mm * math.tan(math.radians(field)) * 10 / distortion.widening
    direction = np.array([math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))])
    spot = np.exp(-((x - radius * direction[0]) ** 2 + (y - radius * direction[1]) ** 2) / 18)
    moved = distortion.applied(spot, 100.0, distortion.widening)
    back = distortion.removed(moved, 100.0)
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
    distortion = distortion_in(GAUSS)
    assert abs(distortion.image_scale - 1) > 5e-4
    ratio = distortion.image_scale * distortion.undistorted_mm[1:] / distortion.height_mm[1:]
    moved = np.abs(ratio - 1)
    near = distortion.height_mm[1:] <= 0.1 * distortion.height_mm[-1]
    assert near.sum() > 1
    assert moved[near].max() < 0.015 * moved[-1]


@pytest.mark.parametrize(("file", "die_mm"), [("phone", 2.7), ("double_gauss", 24.0)])
@pytest.mark.parametrize("turn_deg", [0.0, 45.0, 90.0], ids=["radial", "diagonal", "tangential"])
@pytest.mark.parametrize("frequency", [0.125, 0.24])
def test_waves_through_distortion_have_their_means_over_film_cells(
    file: str, die_mm: float, turn_deg: float, frequency: float
) -> None:
    """Against quadrature over the cells, within the stated error; cells of the phone's source are
    up to 13 % larger or smaller. Frequencies in cycles per cell.
    """
    rows = 48
    columns = 800
    pitch_mm = die_mm / columns
    camera = Camera(die_mm=die_mm, die_height_mm=rows * pitch_mm, object_distance_m=5.0)
    distortion = distortion_in(camera_with_lens(camera, NO_OPTIONS, LensOptions(file=file)))
    tables = distortion.height_mm, distortion.undistorted_mm
    source = CubicSpline(*(np.concatenate([-table[:0:-1], table]) for table in tables))
    direction = np.array([math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))])
    y = np.arange(rows)[:, None] - (rows - 1) / 2
    x = np.arange(columns) - (columns - 1) / 2

    def wave(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(2j * np.pi * frequency * (x * direction[0] + y * direction[1]))

    node, weight = (part / 2 for part in np.polynomial.legendre.leggauss(4))
    truth = np.zeros((rows, columns), complex)
    for row, column in np.ndindex(4, 4):
        radius_mm = np.hypot(y + node[row], x + node[column]) * pitch_mm
        growth = source(radius_mm) / radius_mm
        part = wave((y + node[row]) * growth, (x + node[column]) * growth)
        truth += weight[row] * weight[column] * part
    widening = distortion.widening
    means = np.prod(np.sinc(widening * frequency * direction))
    picture = wave(y * widening, x * widening) * means
    moved = distortion.applied(picture.real, 1e3 * pitch_mm, widening)
    moved = moved + 1j * distortion.applied(picture.imag, 1e3 * pitch_mm, widening)
    error = np.abs(moved - truth)[12:-12, 12:-12]
    rms = math.sqrt(np.mean(error**2) / np.mean(np.abs(truth)[12:-12, 12:-12] ** 2))
    stated = float(moved_error(distortion, 1e3 * pitch_mm, frequency * direction[::-1])[0, 1])
    assert stated / 20 < rms < stated < 0.012
    assert moved_error(distortion, 1e3 * pitch_mm, np.array([0.3]))[0, 0] == 0, "beyond the film"


def test_distortion_does_not_limit_a_picture_by_what_is_far_away() -> None:
    """An edge of two levels rings as the same beside a bright and a black patch does."""
    distortion = distortion_in(GAUSS)
    edge = np.where(np.arange(120) < 75, 1.0, 10.0) * np.ones((120, 1))
    patched = edge.copy()
    patched[:4, :4] = 1000.0
    patched[:4, 4:8] = 0.0
    plain = distortion.applied(edge, 200.0, distortion.widening)
    beside = distortion.applied(patched, 200.0, distortion.widening)
    check("far from the patches", beside[60:], plain[60:], atol=1e-9, why="a spline's reach")
    assert plain.min() < 0.9
    assert plain.max() > 10.1


def test_film_is_widened_for_distortion_and_seen_by_a_thin_lens() -> None:
    camera = rendered_camera(GAUSS)
    distortion = distortion_in(GAUSS)
    assert camera.lens is None
    assert camera.die_mm / GAUSS.die_mm == distortion.widening
    corner = float(distortion.undistorted_mm[-1] / distortion.height_mm[-1])
    assert 1 < corner <= distortion.widening < 1.02 * corner
    assert rendered_camera(without_lens(GAUSS)) == without_lens(GAUSS)


# Blur


def traced_centroid_um(lens: Lens, field_deg: float, nm: float) -> tuple[float, float]:
    """Return the height of the chief ray, and how much further out the mean of all rays lies, with
    equal light in all directions: Simpson's rule along the radius.
    """
    radius = np.linspace(0, 1, 61)[:, None]
    turn = np.arange(96) * (2 * np.pi / 96)
    x = radius * np.sin(turn)
    y = radius * np.cos(turn)
    waves = lens.wavefront(np.array([field_deg]), np.array([nm]), x.ravel(), y.ravel())
    cosines = waves.cosines[0].reshape(*x.shape, 2)
    outwards = np.gradient(cosines, radius[:, 0], axis=0, edge_order=2)
    order = 1j * np.fft.fftfreq(turn.size, 1 / turn.size)[:, None]
    around = np.fft.ifft(order * np.fft.fft(cosines, axis=1), axis=1).real
    area = np.abs(outwards[..., 0] * around[..., 1] - outwards[..., 1] * around[..., 0])
    simpson = np.where(np.arange(61)[:, None] % 2, 4, 2)
    light = area * np.where(radius == 1, 1, simpson)
    mean_mm = (light * waves.y_mm[0].reshape(x.shape)).sum() / light.sum()
    return 1e3 * float(waves.chief_y_mm[0]), 1e3 * float(mean_mm)


@pytest.mark.parametrize(
    ("file", "focal_mm", "die_mm", "pitch_um", "field", "nm", "within"),
    [
        ("singlet", 50.0, 16.0, 3.0, 5.0, 550.0, 0.1),
        ("cooke_triplet", 50.0, 26.0, 1.5, 10.0, 550.0, 0.03),
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
    for azimuth in np.radians([0, 45, 135, 180, 270]):
        outwards = np.array([math.cos(azimuth), math.sin(azimuth)])
        kernel = point_spread(light, *(height_um * outwards), pitch_um, 129).kernel
        sums = np.array([(kernel * offsets).sum(), (kernel * offsets[:, None]).sum()])
        wanted = (chief_um - height_um + spot_um) * outwards
        check("centroid", sums / kernel.sum(), wanted, atol=within * abs(spot_um), why="see above")


STOP_IN_FRONT = """
name = "stop in front"
stop_surface = 1
[aperture]
type = "f_number"
f_number = 32
[fields]
max_deg = 10
[wavelengths]
unit = "nm"
values = [450, 550, 650]
primary = 550
[[surface]]
radius_mm = inf
thickness_mm = 15
glass = "air"
[[surface]]
radius_mm = 50
thickness_mm = 3
glass = "SCHOTT:F2"
[[surface]]
radius_mm = -50
thickness_mm = 39
glass = "air"
"""


@pytest.mark.parametrize("nm", [450.0, 650.0])
def test_lateral_colour_of_a_point_is_that_of_the_traced_rays(nm: float, tmp_path: Path) -> None:
    """Where coarse detail lands: the first moment misses the light beyond the cells."""
    (tmp_path / "own.toml").write_text(STOP_IN_FRONT)
    camera = with_lens(tmp_path / "own.toml", 10.0, 1e4, focal_length_mm=40.0)
    lens = lens_in(camera)
    heights_um = 1e3 * np.asarray(lens.chief_ray(8.0, np.array([nm, 550.0])).height_mm)
    assert abs(heights_um[0] - heights_um[1]) > 25  # three cells
    tiling = Tiling(800.0, 520.0, 0.0)
    psfs = camera_psfs(camera, (1250, 1250), 8.0, tiling, np.array([nm]), np.ones(1))
    chief_um, spot_um = traced_centroid_um(lens, 8.0, nm)
    check("chief ray", chief_um, heights_um[0], rtol=1e-12, why="the same ray")
    phase = np.exp(-2j * np.pi * (np.arange(65) - 32) / 32.5)
    for turn in np.radians([0.0, 130.0, 225.0]).tolist():
        outwards = np.array([math.cos(turn), math.sin(turn)])
        kernel = psfs.at([tuple(heights_um[1] * outwards)], 8.0, 65)[0].kernel.astype(float)
        phases = np.angle([(kernel * phase).sum(), (kernel * phase[:, None]).sum()])
        wanted = (chief_um - heights_um[1] + spot_um) * outwards
        check("place", -phases / (2 * np.pi) * 260.0, wanted, atol=0.08, why="1 % of a cell")


def test_interpolated_wavefronts_are_the_traced_ones_between_the_nodes() -> None:
    camera = with_lens("cooke_triplet", 24.0, focal_length_mm=50.0)
    (front,) = fitted_wavefronts(camera, (550.0,), 17)
    (finer,) = fitted_wavefronts(camera, (550.0,), 33)
    middles = front.height_um[:-1] + np.diff(front.height_um) / 2
    numbers = np.array([front.at(float(middle)) for middle in middles])
    check("half widths", numbers[:, :2], finer.numbers[1::2, :2], rtol=1e-5, why="a spline")
    check("waves", numbers[:, 3:30], finer.numbers[1::2, 3:30], atol=2e-3, why="a spline")


def test_blur_of_a_lens_preserves_a_uniform_scene_and_is_remembered() -> None:
    camera = with_lens("singlet", 6.0)
    light = Tiling(1000.0, 300.0, 0.0), np.array([500.0, 600.0]), np.ones(2)
    blur = camera_blur(camera, (96, 96), 62.5, *light)
    flat = np.ones((96, 96))
    check("scene", blur.blurred(flat), flat, rtol=1e-6, why="single precision")
    assert camera_blur(camera, (96, 96), 62.5, *light) is blur


def test_tighter_tolerance_chooses_a_finer_tiling() -> None:
    """Its stated error is within the tolerance, where the lens allows it."""
    camera = with_lens("cooke_triplet", 6.0, focal_length_mm=20.0)
    light = (550.0,), (1.0,), 30.0
    coarse, fine = (
        choose_tiling(camera, (400, 400), 15.0, *light, error) for error in (0.05, 0.01)
    )
    assert 0 < fine.error < coarse.error <= 0.05
    assert fine.spacing_um <= coarse.spacing_um


def test_mtf_of_a_slow_lens_is_that_of_diffraction_and_of_a_fast_one_far_below() -> None:
    """Its rms over the die: of a tiny die on the axis of a slow lens that of the thin lens."""
    frequency = np.linspace(0, 45, 10)
    content = {
        "data": np.ones((50, 50, 1)),
        "header": {LENS_HEADER: asdict(Tiling(20.0, 40.0, 0.0))},
    }
    image = SpectralImage([550.0], 10.0, 2.0, **content)
    slow = with_lens("singlet", 0.1, options=CameraOptions(f_number=32.0), focal_length_mm=12.0)
    wanted = diffraction_otf(frequency, 550.0, slow.effective_f_number)
    check("f/32", lens_mtf(image, slow, np.ones(1), frequency), wanted, atol=5e-3, why="waves")
    fast = with_lens("singlet", 2.7, focal_length_mm=12.0)
    mtf = lens_mtf(image, fast, np.ones(1), frequency)
    check("at 0", mtf[0], 1.0, atol=1e-12, why="light")
    assert 0.01 < mtf[6] < 0.7 * diffraction_otf(30.0, 550.0, fast.effective_f_number)
    assert lens_mtf(image, without_lens(fast), np.ones(1), frequency) is None
