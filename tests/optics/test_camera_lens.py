"""Real lenses in a camera: against their rays, the thin lens that stands for them, and the closed
forms of a thin real lens.
"""

import math
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from helpers.blur import point_spread
from scipy.interpolate import CubicSpline

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Tiling,
    camera_blur,
    camera_distortion,
    camera_psfs,
    camera_with_lens,
    channel_wavefronts,
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
from tests.scene.test_real_lens import THIN


def with_lens(
    file: str,
    die_mm: float,
    distance_m: float = 5.0,
    given: CameraOptions | None = None,
    **options: object,
) -> Camera:
    camera = Camera(die_mm=die_mm, object_distance_m=distance_m, transmittance=0.8)
    return camera_with_lens(camera, given or CameraOptions(), LensOptions(file=file, **options))


def lens_from_prescription(camera: Camera) -> Lens:
    assert camera.lens is not None
    return traced_lens(camera.lens, camera.object_distance_m)


def test_lens_of_the_users_that_is_scaled_to_the_die_is_told(tmp_path: Path) -> None:
    """A lens that is bought has one focal length; the default, which fits it to the die, would be
    another lens.
    """
    file = tmp_path / "mine.toml"
    file.write_text(THIN, encoding="utf-8")
    focal_mm = load_lens_focal(tmp_path)
    with pytest.warns(
        UserWarning,
        match=rf"of {focal_mm:.5g} mm is scaled so .*lens\.focal_length_mm = {focal_mm:.5g} ",
    ):
        scaled = with_lens(str(file), 10.0)
    assert scaled.lens is not None
    assert not math.isclose(scaled.lens.focal_length_mm, focal_mm, rel_tol=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with_lens(str(file), 10.0, focal_length_mm=focal_mm)
        with_lens("cooke_triplet", 10.0)


@pytest.mark.parametrize("file", ["singlet", "cooke_triplet"])
def test_thin_lens_of_a_camera_has_the_real_ones_light_on_the_axis_and_its_chief_rays(
    file: str,
) -> None:
    camera = with_lens(file, 10.0, focal_length_mm=40.0)
    lens = lens_from_prescription(camera)
    nm = lens.primary_nm
    assert lens.first_order(nm).focal_length_mm == pytest.approx(40.0, rel=1e-9)
    factor = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    assert factor == pytest.approx(float(lens.projected_solid_angle_sr(0.0, nm)), rel=1e-9)
    assert camera.image_distance_mm == pytest.approx(lens.paraxial_height_mm, rel=1e-9)
    assert camera.transmittance == 0.8  # the glass has no losses of its own
    rows = np.array(camera.chief_ray_angle)
    field = lens.field_of_height(4.0, nm)
    assert np.interp(4.0, rows[:, 0], rows[:, 1]) == pytest.approx(
        float(lens.chief_ray(field, nm).angle_deg), abs=1e-3
    )
    assert np.interp(4.0, rows[:, 0], rows[:, 2]) == pytest.approx(
        float(lens.relative_illumination(field)), abs=3e-5
    )
    assert rows[-1, 0] >= math.hypot(10.0, 10.0) / 2


def test_largest_field_reaches_the_corner_unless_a_focal_length_is_given() -> None:
    own = load_lens("cooke_triplet")
    camera = with_lens("cooke_triplet", 20.0, 1e4)
    height_mm = float(
        lens_from_prescription(camera).chief_ray(own.max_field_deg, own.primary_nm).height_mm
    )
    assert height_mm == pytest.approx(
        math.hypot(20.0, 20.0) / 2, rel=3e-3
    )  # the file's plane and the best focus differ a little


def test_f_number_stops_down_and_the_widest_is_named() -> None:
    camera = with_lens("cooke_triplet", 10.0, given=CameraOptions(f_number=8.0))
    assert camera.lens is not None
    assert camera.lens.f_number == 8.0
    assert camera.f_number == pytest.approx(8.0, rel=0.01)
    with pytest.raises(
        PixsimError,
        match=r"camera\.f_number: got 2; allowed: at least 4\.99998, the widest of 'cooke_triplet'",
    ):
        with_lens("cooke_triplet", 10.0, given=CameraOptions(f_number=2.0))


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (
            CameraOptions(focal_length_mm=4.0),
            r"camera\.focal_length_mm: .*Set lens\.focal_length_mm",
        ),
        (CameraOptions(chief_ray_angle=((0.0, 0.0), (9.0, 3.0))), r"camera\.chief_ray_angle: "),
    ],
)
def test_what_the_lens_states_is_refused_beside_it(given: CameraOptions, match: str) -> None:
    with pytest.raises(PixsimError, match=match):
        with_lens("singlet", 4.0, given=given)


@pytest.mark.parametrize("f_number", [1.000000005, 3.857109995, 9.999999996])
def test_a_lens_is_its_own_widest_at_any_scale(f_number: float, tmp_path: Path) -> None:
    """Its f-number in nine digits is not below the widest, whatever the digits."""
    file = tmp_path / "thin.toml"
    own = THIN.replace("value_mm = 0.1", f"value_mm = {load_lens_focal(tmp_path) / f_number:.17g}")
    file.write_text(own, encoding="utf-8")
    camera = with_lens(str(file), 1.0, focal_length_mm=20.0, refocus="paraxial")
    assert camera.lens is not None
    assert camera.lens.f_number == pytest.approx(f_number, rel=1e-8)


def load_lens_focal(tmp_path: Path) -> float:
    file = tmp_path / "wide.toml"
    file.write_text(THIN, encoding="utf-8")
    return load_lens(file).first_order(550.0).focal_length_mm


def test_options_without_a_file_are_refused() -> None:
    with pytest.raises(PixsimError, match=r"refocus without file"):
        LensOptions(refocus="field")


def test_a_changed_file_is_seen(tmp_path: Path) -> None:
    from importlib import resources

    text = (resources.files("pixsim") / "data/lenses/singlet.toml").read_text(encoding="utf-8")
    file = tmp_path / "own.toml"
    file.write_text(text, encoding="utf-8")
    camera = with_lens(str(file), 4.0)
    file.write_text(text.replace("thickness_mm = ", "thickness_mm = 1", 1), encoding="utf-8")
    traced_lens.cache_clear()
    with pytest.raises(PixsimError, match="has changed since"):
        lens_from_prescription(camera)


def test_settings_and_cameras_without_a_lens_are_written_as_before() -> None:
    assert "lens" not in Camera().model_dump()
    assert Run().model_dump()["lens"] == {}
    camera = with_lens("singlet", 4.0)
    assert (
        camera_with_lens(
            Camera(**camera.options.over(Camera()).model_dump()),
            camera.options,
            camera.lens_options,
        )
        == camera
    )


def test_points_lie_where_the_chief_rays_arrive() -> None:
    """A spot at v tan θ of a picture without distortion, in any direction, is at the chief ray's
    height in the picture.
    """
    camera = with_lens("double_gauss", 24.0, focal_length_mm=45.0)
    distortion, lens = camera_distortion(camera), lens_from_prescription(camera)
    assert distortion is not None
    cells, pitch_um = 240, 100.0
    y, x = np.indices((cells, cells)) - (cells - 1) / 2
    for field, azimuth in ((8.0, 20.0), (14.0, 230.0)):
        widening = distortion.widening
        at = camera.image_distance_mm * math.tan(math.radians(field)) * 1e3 / (pitch_um * widening)
        turn = math.radians(azimuth)
        spot = np.exp(-((x - at * math.cos(turn)) ** 2 + (y - at * math.sin(turn)) ** 2) / 18)
        moved = distortion.applied(spot, pitch_um, widening)
        found = np.array([(moved * axis).sum() / moved.sum() for axis in (x, y)])
        height_um = 1e3 * float(lens.chief_ray(field, lens.primary_nm).height_mm)
        assert abs(height_um / pitch_um - at) > 0.5  # cells
        np.testing.assert_allclose(
            found, height_um / pitch_um * np.array([math.cos(turn), math.sin(turn)]), atol=0.02
        )
        back = distortion.removed(moved, pitch_um)
        found = np.array([(back * axis).sum() / back.sum() for axis in (x, y)])
        straight = at * widening * distortion.image_scale
        np.testing.assert_allclose(
            found, straight * np.array([math.cos(turn), math.sin(turn)]), atol=0.03
        )


def test_a_picture_without_distortion_keeps_the_scale_of_the_lens_on_the_axis() -> None:
    """Also where the plane of best focus is not the paraxial one: near the axis, points stay where
    they are.
    """
    distortion = camera_distortion(with_lens("double_gauss", 24.0, focal_length_mm=45.0))
    assert distortion is not None
    assert abs(distortion.image_scale - 1) > 5e-4
    straight_mm = distortion.image_scale * distortion.undistorted_mm
    moved = np.abs(straight_mm[1:] / distortion.height_mm[1:] - 1)
    # Distortion grows with the square of the height: 1/100 of that at a tenth of it.
    tenth = np.flatnonzero(distortion.height_mm[1:] <= 0.1 * distortion.height_mm[-1])
    assert tenth.size > 1
    assert moved[tenth].max() < 0.015 * moved[-1]


@pytest.mark.parametrize("file", ["phone", "double_gauss"])
@pytest.mark.parametrize("turn_deg", [0.0, 45.0, 90.0], ids=["radial", "diagonal", "tangential"])
@pytest.mark.parametrize("frequency", [0.125, 0.24])
def test_waves_through_distortion_have_their_means_over_film_cells(
    file: str, turn_deg: float, frequency: float
) -> None:
    """Against quadrature over the cells, within the stated error; cells of the phone's source are
    up to 13 % larger or smaller.

    Frequencies in cycles per cell. Values between cells instead of means over other cells would be
    1.2 % off at the second.
    """
    die_mm, rows, columns = {"phone": 2.7, "double_gauss": 24.0}[file], 48, 800
    pitch_um = die_mm * 1e3 / columns
    camera = camera_with_lens(
        Camera(die_mm=die_mm, die_height_mm=rows * pitch_um * 1e-3, object_distance_m=5.0),
        CameraOptions(),
        LensOptions(file=file),
    )
    distortion, turn = camera_distortion(camera), math.radians(turn_deg)
    assert distortion is not None
    source = CubicSpline(
        *(
            np.concatenate([-at[:0:-1], at])
            for at in (distortion.height_mm, distortion.undistorted_mm)
        )
    )
    y, x = np.arange(rows)[:, None] - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2

    def wave(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(2j * np.pi * frequency * (x * math.cos(turn) + y * math.sin(turn)))

    node, weight = (part / 2 for part in np.polynomial.legendre.leggauss(4))
    truth = np.zeros((rows, columns), complex)
    for a, u in zip(node, weight, strict=True):
        for b, v in zip(node, weight, strict=True):
            radius = np.hypot(y + a, x + b)
            grown = source(radius * pitch_um * 1e-3) / (radius * pitch_um * 1e-3)
            truth += u * v * wave((y + a) * grown, (x + b) * grown)
    of_cells = distortion.widening * frequency * np.array([math.cos(turn), math.sin(turn)])
    picture = wave(y * distortion.widening, x * distortion.widening) * np.prod(np.sinc(of_cells))
    moved = distortion.applied(picture.real, pitch_um, distortion.widening)
    moved = moved + 1j * distortion.applied(picture.imag, pitch_um, distortion.widening)
    inside = slice(12, -12), slice(12, -12)
    rms = float(
        np.sqrt(np.mean(np.abs(moved - truth)[inside] ** 2) / np.mean(np.abs(truth)[inside] ** 2))
    )
    at = frequency * np.array([math.sin(turn), math.cos(turn)])
    stated = float(moved_error(distortion, pitch_um, at)[0, 1])
    assert stated / 20 < rms < stated
    assert stated < 0.012
    if frequency > 0.2:
        assert (
            moved_error(distortion, pitch_um, np.array([0.3]))[0, 0] == 0
        )  # beyond half of the Nyquist frequency


def test_distortion_does_not_limit_a_picture_by_what_is_far_away() -> None:
    """An edge of two levels rings as one beside a bright and a black patch in the corner does."""
    camera = with_lens("double_gauss", 24.0, focal_length_mm=45.0)
    distortion = camera_distortion(camera)
    assert distortion is not None
    edge = np.where(np.arange(120) < 75, 1.0, 10.0) * np.ones((120, 1))
    patched = edge.copy()
    patched[:4, :4], patched[:4, 4:8] = 1000.0, 0.0
    one, other = (distortion.applied(each, 200.0, distortion.widening) for each in (edge, patched))
    np.testing.assert_allclose(other[60:], one[60:], atol=1e-9)
    assert one.min() < 0.9
    assert one.max() > 10.1


def test_film_is_widened_for_distortion_and_seen_by_a_thin_lens() -> None:
    camera = with_lens("double_gauss", 24.0, focal_length_mm=45.0)
    seen, distortion = rendered_camera(camera), camera_distortion(camera)
    assert distortion is not None
    assert seen.lens is None
    assert seen.die_mm / camera.die_mm == distortion.widening
    corner = float(distortion.undistorted_mm[-1] / distortion.height_mm[-1])
    assert 1 < corner <= distortion.widening < 1.02 * corner
    assert rendered_camera(without_lens(camera)) == without_lens(camera)


def traced_centroid_um(lens: Lens, field_deg: float, nm: float) -> tuple[float, float]:
    """Height of the chief ray, and how much further out the mean of all rays lies, with equal light
    in all directions.
    """
    radius, turn = np.linspace(0, 1, 61)[:, None], np.arange(96) * (2 * np.pi / 96)
    x, y = radius * np.sin(turn), radius * np.cos(turn)
    waves = lens.wavefront(np.array([field_deg]), np.array([nm]), x.ravel(), y.ravel())
    cosines = waves.cosines[0].reshape(*x.shape, 2)
    outwards = np.gradient(cosines, radius[:, 0], axis=0, edge_order=2)
    order = 1j * np.fft.fftfreq(turn.size, 1 / turn.size)[:, None]
    around = np.fft.ifft(order * np.fft.fft(cosines, axis=1), axis=1).real
    area = np.abs(outwards[..., 0] * around[..., 1] - outwards[..., 1] * around[..., 0])
    light = area * np.where(
        radius == 1, 1, np.where(np.arange(61)[:, None] % 2, 4, 2)
    )  # Simpson's rule; at radius 0 it is 0
    return 1e3 * float(waves.chief_y_mm[0]), 1e3 * float(
        (light * waves.y_mm[0].reshape(x.shape)).sum() / light.sum()
    )


@pytest.mark.parametrize(
    ("file", "field", "nm", "within"),
    [
        ("singlet", 5.0, 550.0, 0.1),
        ("cooke_triplet", 10.0, 550.0, 0.03),
        ("phone", 6.0, 450.0, 0.03),
        ("phone", 12.0, 450.0, 0.06),
    ],
)
def test_a_points_picture_has_the_centroid_of_the_traced_spot_in_every_direction(
    file: str, field: float, nm: float, within: float
) -> None:
    """The singlet's rays miss by 60 µm of 50 mm: what counts as equal light in all directions
    differs by 12 % of its centroid.

    At 12° the phone lens's centroid is within 1 µm of the chief ray, of which the polynomials'
    slopes at the rim leave 0.04 µm.
    """
    focal_mm, die_mm, pitch_um = {
        "singlet": (50.0, 16.0, 3.0),
        "cooke_triplet": (50.0, 26.0, 1.5),
        "phone": (4.0, 3.2, 1.5),
    }[file]
    camera = with_lens(file, die_mm, 1e4, focal_length_mm=focal_mm, refocus="paraxial")
    lens = lens_from_prescription(camera)
    chief_um, spot_um = traced_centroid_um(lens, field, nm)
    assert (spot_um > 0) == (file != "singlet")
    height_um = 1e3 * float(lens.chief_ray(field, lens.primary_nm).height_mm)
    wanted_um = chief_um - height_um + spot_um  # with lateral colour against the primary wavelength
    light = channel_wavefronts(camera, np.array([nm]), np.ones(1), Tiling(0.0, 0.0, 0.0))
    cells = 129
    offsets = (np.arange(cells) - cells // 2) * pitch_um
    for azimuth in np.radians([0, 45, 90, 135, 180, 225, 270, 315]):
        outwards = np.array([math.cos(azimuth), math.sin(azimuth)])
        psf = point_spread(light, *(height_um * outwards), pitch_um, cells)
        found_um = (
            np.array([(psf.kernel * offsets).sum(), (psf.kernel * offsets[:, None]).sum()])
            / psf.kernel.sum()
        )
        assert found_um @ outwards == pytest.approx(wanted_um, abs=within * abs(spot_um))
        assert abs(found_um[0] * outwards[1] - found_um[1] * outwards[0]) < 0.005 * abs(spot_um)


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


def test_lateral_colour_of_a_point_is_that_of_the_traced_rays(tmp_path: Path) -> None:
    """Light of two wavelengths from one point of the scene lies where the chief rays of both
    arrive, in any direction.
    """
    file = tmp_path / "own.toml"
    file.write_text(STOP_IN_FRONT, encoding="utf-8")
    camera = with_lens(str(file), 10.0, 1e4, focal_length_mm=40.0)
    lens, field = lens_from_prescription(camera), 8.0
    heights_um = 1e3 * np.asarray(lens.chief_ray(field, np.array([450.0, 550.0, 650.0])).height_mm)
    assert heights_um[2] - heights_um[0] > 80  # µm, ten cells
    cells, pitch_um = 65, 8.0
    offsets, tiling = (
        (np.arange(cells) - cells // 2) * pitch_um,
        Tiling(800.0, cells * pitch_um, 0.0),
    )
    for nm, height_um in zip((450.0, 650.0), heights_um[[0, 2]], strict=True):
        psfs = camera_psfs(camera, (1250, 1250), pitch_um, tiling, np.array([nm]), np.ones(1))
        chief_um, spot_um = traced_centroid_um(lens, field, nm)
        assert chief_um == pytest.approx(height_um, rel=1e-12)
        wanted_um = chief_um - heights_um[1] + spot_um
        for turn in np.radians([0.0, 130.0, 225.0]).tolist():
            outwards = np.array([math.cos(turn), math.sin(turn)])
            x_um, y_um = heights_um[1] * outwards
            kernel = psfs.at([(x_um, y_um)], pitch_um, cells)[0].kernel.astype(float)
            # Where coarse detail lands: the first moment misses the light beyond the cells, more of
            # it on one side.
            period_um = cells * pitch_um / 2
            phases = [
                np.angle((kernel * np.exp(-2j * np.pi * at / period_um)).sum())
                for at in (offsets, offsets[:, None])
            ]
            found_um = -np.array(phases) / (2 * np.pi) * period_um
            assert found_um @ outwards == pytest.approx(wanted_um, abs=0.01 * pitch_um)
            assert abs(found_um[0] * outwards[1] - found_um[1] * outwards[0]) < 0.01 * pitch_um


def test_interpolated_wavefronts_are_the_traced_ones_between_the_nodes() -> None:
    camera = with_lens("cooke_triplet", 24.0, focal_length_mm=50.0)
    (front,), (finer,) = (
        fitted_wavefronts(camera, (550.0,), 17),
        fitted_wavefronts(camera, (550.0,), 33),
    )
    middles = front.height_um[:-1] + np.diff(front.height_um) / 2
    for middle, exact in zip(middles, finer.numbers[1::2], strict=True):
        found = front.at(float(middle))
        np.testing.assert_allclose(found[:2], exact[:2], rtol=1e-5)
        assert np.abs(found[3:30] - exact[3:30]).max() < 2e-3  # waves


def test_lens_on_another_die_sees_the_same_field() -> None:
    camera = with_lens("cooke_triplet", 24.0, 2.0)
    other = lens_on_die(camera, Camera(die_mm=6.0), same_view=True)
    assert other.fov_deg == pytest.approx(camera.fov_deg, rel=1e-6)
    assert other.lens is not None
    assert camera.lens is not None
    assert other.lens.focal_length_mm == pytest.approx(camera.lens.focal_length_mm / 4, rel=0.05)
    assert lens_on_die(camera, camera) == camera


def test_a_die_beyond_the_image_circle_is_dark_there() -> None:
    """US 7,535,658 has no rays beyond some field: the share of the die that stays dark is stated,
    and has no light.

    The pupil there, of which no light comes, is that of the outermost light.
    """
    camera = with_lens("phone", 12.0, 1.0, focal_length_mm=5.2)
    heights, _ = field_angles(camera.lens, 1.0, math.hypot(12.0, 12.0) / 2)  # type: ignore[arg-type]
    assert camera.relative_illumination is not None
    assert heights[-1] < 6
    assert dark_share(camera) == pytest.approx(1 - math.pi * heights[-1] ** 2 / 144, abs=0.02)
    found = camera_pupil(camera).at([1e3 * heights[-1], 6000.0], [0.0, 6000.0])
    assert np.isfinite(found.chief_cosines).all()
    np.testing.assert_allclose(*np.linalg.norm(found.chief_cosines, axis=-1), rtol=1e-12)


def test_few_wavelengths_have_the_moments_of_the_bands() -> None:
    bands = np.arange(400.0, 701.0, 10.0)
    weight = np.exp(-(((bands - 560) / 60) ** 2))
    nm, share = few_wavelengths(bands, weight, 4)
    for power in range(8):  # Gauss's quadrature of 4 nodes is exact up to degree 7
        exact = (weight * (bands - 550) ** power).sum() / weight.sum()
        assert (share * (nm - 550) ** power).sum() == pytest.approx(
            exact, rel=1e-4, abs=1e-5 * 150**power
        )
    nm, share = few_wavelengths(np.array([450.0, 550.0, 650.0]), np.array([0.0, 2.0, 0.0]), 4)
    assert (nm.tolist(), share.tolist()) == ([550.0], [1.0])


def test_blur_of_a_lens_preserves_an_even_scene_and_is_remembered() -> None:
    camera = with_lens("singlet", 6.0)
    tiling = Tiling(1000.0, 300.0, 0.0)
    bands, weight = np.array([500.0, 600.0]), np.ones(2)
    blur = camera_blur(camera, (96, 96), 62.5, tiling, bands, weight)
    np.testing.assert_allclose(
        blur.blurred(np.ones((96, 96))), 1.0, rtol=1e-6
    )  # in single precision
    assert camera_blur(camera, (96, 96), 62.5, tiling, bands, weight) is blur


def test_mtf_of_a_lens_is_that_of_diffraction_where_it_is_stopped_down_and_far_below_it_over_a_large_die() -> (
    None
):
    """Its rms over the die: of a tiny die on the axis of a slow lens that of the thin lens."""
    frequency, ones = np.linspace(0, 45, 10), np.ones(1)
    plane = {"data": np.ones((50, 50, 1)), "header": {LENS_HEADER: asdict(Tiling(20.0, 40.0, 0.0))}}
    image = SpectralImage([550.0], 10.0, 2.0, **plane)
    slow = with_lens("singlet", 0.1, given=CameraOptions(f_number=32.0), focal_length_mm=12.0)
    found = lens_mtf(image, slow, ones, frequency)
    np.testing.assert_allclose(
        found, diffraction_otf(frequency, 550.0, slow.effective_f_number), atol=5e-3
    )
    fast = with_lens("singlet", 2.7, focal_length_mm=12.0)
    worse = lens_mtf(image, fast, ones, frequency)
    assert worse is not None
    assert worse[0] == pytest.approx(1, abs=1e-12)
    assert 0.01 < worse[6] < 0.7 * diffraction_otf(30.0, 550.0, fast.effective_f_number)
    thin = SpectralImage([550.0], 10.0, 2.0, data=np.ones((50, 50, 1)))
    assert lens_mtf(thin, without_lens(fast), ones, frequency) is None
