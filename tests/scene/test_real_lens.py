"""Scenes through real lenses: what the plan leaves out, the light and the blur of the picture, and
what a user is told.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.edits import VARIANT

from pixsim import evaluate, load_scene, render
from pixsim.base.digits import percent
from pixsim.light.spectral import RINGS, photons_per_joule
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Tiling,
    camera_distortion,
    choose_tiling,
    dark_share,
    ideal_light,
    traced_lens,
    without_lens,
)
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.scene.plan import make_render_plan
from pixsim.scene.real_lens import SEEN_NM, real_lens_warnings
from pixsim.scene.scene import Scene
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import diffracted_rate, ideal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import integration_time_s
from pixsim.viewer.display_options import Display

PIXEL = Pixel(pitch_um=6.5)
THIN = """
name = "thin"
units = "mm"
object_distance_mm = inf
stop_surface = 1
[aperture]
type = "entrance_pupil_diameter"
value_mm = 0.1
[fields]
type = "angle_deg"
max_deg = 1.0
angles_deg = [0.0, 1.0]
[wavelengths]
unit = "um"
values = [0.55]
weights = [1.0]
primary = 0.55
[[surface]]
curvature_per_mm = 0.1
thickness_mm = 1e-5
glass = "SCHOTT:N-BK7"
conic = 0.0
clips = false
[[surface]]
curvature_per_mm = -0.1
thickness_mm = 10.0
glass = "air"
conic = 0.0
clips = false
"""


def through(
    lens: str,
    die_mm: float,
    resolution: int = 96,
    scene: str = "csf",
    distance_m: float = 0.0,
    **options: object,
):
    loaded = load_scene(scene, resolution=resolution, variant=VARIANT)
    given = CameraOptions(
        die_mm=die_mm, **({"object_distance_m": distance_m} if distance_m else {})
    )
    camera = loaded.camera(given, LensOptions(file=lens, **options))
    return loaded, camera


@pytest.fixture(scope="module")
def singlet():
    scene, camera = through("singlet", 6.0)
    plan = make_render_plan(scene, camera, PIXEL)
    image = render(scene, camera, plan=plan)
    image.header[LENS_HEADER] |= {"spacing_um": 1500.0}  # few tiles, for time
    return scene, camera, plan, image


def test_plan_states_the_tiles_and_their_error(singlet) -> None:
    _, camera, plan, image = singlet
    (decision,) = [decision for decision in plan.decisions if decision.subject == "real lens"]
    assert decision.kept
    assert "'singlet' at" in decision.reason
    assert "tiles across with PSFs of" in decision.reason
    assert 0 < plan.film.tiling.cut_error <= plan.film.tiling.error < 1
    assert 0 <= plan.film.tiling.lacking < 0.1
    assert (
        f"which lack up to {percent(plan.film.tiling.lacking, 1)} of the light" in decision.reason
    )
    assert image.header[LENS_HEADER]["error"] == plan.film.tiling.error
    assert image.header[RINGS]  # so that what the distortion's spline rings below zero is no error
    assert Camera(**image.header["camera"]) == camera


def test_films_with_two_samples_across_a_photodiode_have_one_tiling() -> None:
    """Photodiodes average what finer films add: what one of these would choose itself is no
    larger.
    """
    scene, camera = through("cooke_triplet", 0.5, 64)
    camera = camera.model_copy(update={"die_mm": 0.1, "die_height_mm": 0.1})
    films = [scene.with_resolution(across) for across in (64, 128, 256)]
    first, finer, finest = (
        make_render_plan(film, camera, PIXEL, tolerance_e=3e-3).film.tiling for film in films
    )
    aperture_um = derive(PIXEL).aperture_side_um
    assert aperture_um / 2 >= 100 / 64
    assert first == finer == finest
    own = choose_tiling(camera, (256, 256), 100 / 256, (550.0,), (1.0,), aperture_um, 0.03)
    same = choose_tiling(camera, (64, 64), 100 / 64, (550.0,), (1.0,), aperture_um, 0.03)
    assert own.psf_um <= same.psf_um * 1.05  # what a finer film needs, the coarser one has
    assert max(own.error, same.error) <= 0.03


def test_light_that_does_not_fit_a_film_cell_or_a_psf_is_told() -> None:
    """Rays of a singlet at f/5 and 96 mm miss by half a millimetre: more than cells of 250 µm, on
    which no waves are followed.
    """
    scene, camera = through("singlet", 24.0, 96, "flat", refocus="paraxial")
    plan = make_render_plan(scene, camera, PIXEL)
    assert plan.film.tiling.psf_um == 0
    assert plan.film.tiling.error > 0.5
    lens = traced_lens(camera.lens, camera.object_distance_m)
    y, x = np.indices((41, 41)) / 20 - 1
    inside = np.hypot(x, y) <= 1
    light = derive(PIXEL).quantum_efficiency(SEEN_NM) * photons_per_joule(SEEN_NM)
    nm = float(np.average(SEEN_NM, weights=light))
    field = lens.field_of_height(0.97 * math.hypot(12, 12), lens.primary_nm)
    waves = lens.wavefront(np.array([field]), np.array([nm]), x[inside], y[inside])
    outside = np.maximum(np.abs(waves.x_mm[0]), np.abs(waves.y_mm[0])) > 0.125
    assert plan.film.tiling.lacking == pytest.approx(outside.mean(), abs=0.1)
    (told,) = [note for note in plan.warnings if "the film is too coarse" in note]
    assert f"up to {percent(plan.film.tiling.error, 1)} of the picture's contrast" in told
    assert "Take a finer film" in told
    cut = replace(plan.film.tiling, psf_um=445.0, error=0.1, cut_error=0.09, lacking=0.5)
    (told,) = [note for note in real_lens_warnings(camera, cut, 1e-3) if "blur" in note]
    assert (
        "up to 10.0 % of the picture's contrast, above 1.0 %: its PSFs of 445 µm lack up to 50.0 %"
        " of the light" in told
    )
    assert not [
        note
        for note in real_lens_warnings(camera, replace(cut, error=0.01), 1e-3)
        if "blur" in note
    ]


def test_picture_has_the_traced_fall_off_and_the_glass_is_not_counted_twice() -> None:
    scene, camera = through("double_gauss", 24.0, 33, "flat")
    image = render(scene, camera, plan=make_render_plan(scene, camera, PIXEL))
    lens = traced_lens(camera.lens, camera.object_distance_m)
    picture = image.factors[1][0]
    corner_mm = math.hypot(16, 16) * 24.0 / 33
    field = lens.field_of_height(corner_mm, lens.primary_nm)
    assert picture[0, 0] / picture[16, 16] == pytest.approx(
        float(lens.relative_illumination(field)), rel=1e-3
    )
    rate = diffracted_rate(image, camera, derive(PIXEL))
    sharp = ideal_rate(image, derive(PIXEL))
    np.testing.assert_allclose(
        rate, sharp, rtol=0.02
    )  # an even scene has nothing to blur but its fall-off


def test_blur_lowers_contrast_most_in_the_corners(singlet) -> None:
    _, camera, _, image = singlet
    physics = derive(PIXEL)
    dots = np.zeros(image.shape, np.float32)
    places = [(47, 47), (47, 80), (80, 80)]
    for place in places:
        dots[place] = 1.0
    rate = diffracted_rate(image.with_planes(dots[None]), camera, physics)
    peaks = [rate[place] / rate.max() for place in places]
    assert peaks[0] == 1
    assert 1 > 1.05 * peaks[1] > 1.05**2 * peaks[2]


@pytest.mark.slow  # the next but one has the blur
def test_score_through_a_simple_lens_is_worse_than_through_a_thin_one(singlet) -> None:
    scene, camera, _, image = singlet
    thin = without_lens(camera)
    real = evaluate(image, camera, PIXEL)
    ideal = evaluate(render(scene, thin, plan=make_render_plan(scene, thin, PIXEL)), thin, PIXEL)
    assert real.mean_delta_e > 1.1 * ideal.mean_delta_e


@pytest.mark.usefixtures("some_tiles")
def test_ideal_image_has_the_distortion_unless_asked_otherwise() -> None:
    scene, camera = through("phone", 4.8, 96)
    image = render(scene, camera, plan=make_render_plan(scene, camera, PIXEL))
    assert ideal_light(image, camera) is image
    straight = camera.model_copy(
        update={"lens": camera.lens.model_copy(update={"ideal": "undistorted"})}
    )
    moved = ideal_light(image, straight)
    shift = camera_distortion(camera).largest_mm * 1e3 / image.pitch_um
    assert shift > 1
    assert np.abs(moved.factors[1] - image.factors[1]).max() > 0.05


def test_a_thin_enough_lens_is_left_out_and_the_picture_is_the_thin_lens_s_bit_for_bit(
    tmp_path: Path,
) -> None:
    file = tmp_path / "thin.toml"
    file.write_text(THIN, encoding="utf-8")
    scene, camera = through(str(file), 0.1, 32, focal_length_mm=10.0)
    plan = make_render_plan(scene, camera, PIXEL)
    (decision,) = [decision for decision in plan.decisions if decision.subject == "real lens"]
    assert not decision.kept
    assert 0 < decision.bound_e < 5e-4
    thin = without_lens(camera)
    assert (thin.focal_length_mm, thin.f_number) == (camera.focal_length_mm, camera.f_number)
    image, other = (
        render(scene, camera, plan=plan),
        render(scene, thin, plan=make_render_plan(scene, thin, PIXEL)),
    )
    assert np.array_equal(image.factors[1], other.factors[1])
    assert LENS_HEADER not in image.header
    assert RINGS not in image.header
    physics = derive(PIXEL)
    assert np.array_equal(
        diffracted_rate(image, camera, physics), diffracted_rate(other, thin, physics)
    )


def test_thin_real_lens_has_the_absolute_irradiance_of_foote_times_its_transmittance(
    tmp_path: Path,
) -> None:
    """From the axis to 20 degrees, of a luminance that is known: traced, rendered and weighted as
    any real lens.
    """
    file = tmp_path / "thin.toml"
    file.write_text(THIN, encoding="utf-8")
    scene = load_scene("flat", resolution=33, luminance_cd_per_m2=1000)
    camera = scene.camera(
        CameraOptions(die_mm=5.2, transmittance=0.8),
        LensOptions(file=str(file), focal_length_mm=10.0),
    )
    plan = make_render_plan(scene, camera, PIXEL, exact=True)
    plan = replace(plan, film=replace(plan.film, tiling=Tiling(2000.0, 0.0, 0.0)))
    image = render(scene, camera, plan=plan)
    y, x = (np.indices(image.shape) - 16) * 5.2 / 33
    tangent = np.hypot(x, y) / camera.image_distance_mm
    assert tangent.max() == pytest.approx(math.tan(math.radians(20)), rel=0.05)
    wanted = 0.8 * 1000 * irradiance_factor(camera.f_number, tangent, camera.magnification)
    np.testing.assert_allclose(
        image.illuminance_lx() / wanted, image.illuminance_lx()[16, 16] / wanted[16, 16], rtol=1e-4
    )
    assert image.illuminance_lx()[16, 16] == pytest.approx(
        wanted[16, 16], rel=2e-3
    )  # the bands of D65 in luminance


@pytest.mark.slow
def test_the_brightest_pixel_sets_the_exposure_and_what_lies_beyond_the_circle_is_dark(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "pixsim.scene.real_lens.choose_tiling", lambda *_: Tiling(6000.0, 750.0, 0.005)
    )
    scene, camera = through("phone", 12.0, 32, "flat", focal_length_mm=5.2, distance_m=1.0)
    plan = make_render_plan(scene, camera, PIXEL)
    share = dark_share(camera)
    assert any(
        f"{percent(share, 1)} of the die lies beyond the image circle of 'phone'" in note
        for note in plan.warnings
    )
    image = render(scene, camera, plan=plan)
    assert float((image.factors[1][0] == 0).mean()) == pytest.approx(share, abs=0.03)
    pixel = Pixel(pitch_um=100.0, infrared_cut_nm=720.0)
    thin = without_lens(camera)
    readout, times = Readout.of(derive(pixel)), []
    for light, seen in (
        (image, camera),
        (render(scene, thin, plan=make_render_plan(scene, thin, pixel)), thin),
    ):
        chain = imaging_chain(light, seen, pixel, Exposure(), Display(dots=48))
        times.append(integration_time_s(Exposure(), readout, float(chain.signal_e_per_s.max())))
        assert chain.capture("x").integration_s == pytest.approx(times[-1], rel=1e-6)
    assert times[0] == pytest.approx(
        times[1], rel=0.02
    )  # as much light on the axis, in spite of the dark corners
    assert image.illuminance_lx().mean() < 0.6 * image.illuminance_lx().max()


def test_camera_stands_in_the_entrance_pupil() -> None:
    """Points on a line through its middle are one point of the picture at any distance, but for 5 %
    by its aberrations.
    """
    camera = through("cooke_triplet", 20.0, distance_m=0.5)[1]
    lens = traced_lens(camera.lens, camera.object_distance_m)
    seen = replace(lens, object_distance_mm=2 * lens.object_distance_mm)
    field = 10.0
    near, far = (float(one.chief_ray(field, one.primary_nm).height_mm) for one in (lens, seen))
    vertex_mm = lens.first_order(lens.primary_nm).entrance_pupil_from_first_vertex_mm
    moved = math.degrees(
        math.atan(math.tan(math.radians(field)) * (1 + vertex_mm / seen.object_distance_mm / 2))
    )
    other = float(seen.chief_ray(moved, seen.primary_nm).height_mm)
    assert abs(near - far) < 0.05 * abs(near - other)  # on a line through the first vertex


def test_plans_without_a_real_lens_say_nothing_of_it() -> None:
    scene = load_scene("csf", resolution=32)
    plan = make_render_plan(scene, scene.camera(), PIXEL)
    assert plan.film.tiling is None
    assert "real lens" not in [decision.subject for decision in plan.decisions]


DEPTHS = """
<scene version="3.0.0">
    <default name="resolution" value="32"/>
    <default name="spp" value="16"/>
    <integrator type="path"/>
    <sensor type="thinlens" id="camera">
        <float name="fov" value="40"/>
        <float name="aperture_radius" value="0.001"/>
        <float name="focus_distance" value="0.1"/>
        <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="pixel_format" value="rgb"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"><spectrum name="radiance" value="1"/></emitter>
    <shape type="sphere"><point name="center" x="0" y="0" z="NEAR"/><float name="radius" value="0.0002"/></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="0.3"/><rotate y="1" angle="180"/><translate z="FAR"/></transform>
    </shape>
</scene>
"""


def scene_of_depths(tmp_path: Path, near_m: float, far_m: float) -> Scene:
    file = tmp_path / "depths.xml"
    file.write_text(
        DEPTHS.replace("NEAR", f"{near_m}").replace("FAR", f"{far_m}"), encoding="utf-8"
    )
    return load_scene(file)


@pytest.fixture
def some_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans take a moment where their tiles do not matter."""
    monkeypatch.setattr(
        "pixsim.scene.real_lens.choose_tiling", lambda *_: Tiling(500.0, 20.0, 0.005)
    )


@pytest.mark.usefixtures("some_tiles")
@pytest.mark.parametrize("full", [False, True])
def test_plan_says_that_the_error_out_of_focus_is_not_known(full: bool, tmp_path: Path) -> None:
    """Of a scene with depth, and not of a chart in focus."""
    deep, chart = scene_of_depths(tmp_path, 0.08, 0.2), load_scene("csf", resolution=32)
    for scene, is_deep in ((deep, True), (chart, False)):
        camera = scene.camera(CameraOptions(die_mm=4.8), LensOptions(file="singlet"))
        plan = make_render_plan(scene, camera, PIXEL, full=full)
        assert (
            "defocus of the lens" in [decision.subject for decision in plan.decisions]
        ) == is_deep
        assert any("its error is not known" in note for note in plan.warnings) == is_deep


@pytest.mark.slow  # test_integration has each colour by the PSF of its own light
def test_bands_of_a_scene_with_several_spectra_are_blurred_in_groups(singlet) -> None:
    """Light stored by bands is blurred group by group of bands, each at its mean wavelength: like
    that of one spectrum.
    """
    _, camera, _, image = singlet
    physics = derive(PIXEL)
    whole = diffracted_rate(image, camera, physics)
    by_bands = type(image)(
        image.wavelength_nm,
        image.band_width_nm,
        image.pitch_um,
        data=image.data,
        within=image.within,
        header=image.header,
    )
    found = diffracted_rate(by_bands, camera, physics)
    assert np.sqrt(np.mean((found - whole) ** 2)) < 0.01 * whole.std()
