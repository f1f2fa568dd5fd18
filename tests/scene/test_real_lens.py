"""Scenes through real lenses: what the plan leaves out, the light and the blur of the picture, and what a user is told."""

import math
from pathlib import Path

import numpy as np
import pytest

from pixsim import evaluate, load_scene, render
from pixsim.base.parameters import Camera, CameraOptions, LensOptions, Pixel
from pixsim.optics.camera_lens import LENS_HEADER, distortion_of, ideal_light, traced_lens, without_lens
from pixsim.scene.plan import make_render_plan
from pixsim.sensor.integration import diffracted_rate, ideal_rate
from pixsim.sensor.pixel import derive

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


def through(lens: str, die_mm: float, resolution: int = 96, scene: str = "csf", **options: object):
    loaded = load_scene(scene, resolution=resolution)
    camera = loaded.camera(CameraOptions(die_mm=die_mm), LensOptions(file=lens, **options))
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
    assert 0 < plan.tiling.error < 1
    assert image.header[LENS_HEADER]["error"] == plan.tiling.error
    assert Camera(**image.header["camera"]) == camera


def test_picture_has_the_traced_fall_off_and_the_glass_is_not_counted_twice() -> None:
    scene, camera = through("double_gauss", 24.0, 33, "flat")
    image = render(scene, camera, plan=make_render_plan(scene, camera, PIXEL))
    lens = traced_lens(camera.lens, camera.object_distance_m)
    picture = image.factors[1][0]
    corner_mm = math.hypot(16, 16) * 24.0 / 33
    field = lens.field_of_height(corner_mm, lens.primary_nm)
    assert picture[0, 0] / picture[16, 16] == pytest.approx(float(lens.relative_illumination(field)), rel=1e-3)
    rate = diffracted_rate(image, camera, derive(PIXEL))
    sharp = ideal_rate(image, derive(PIXEL))
    np.testing.assert_allclose(rate, sharp, rtol=0.02)  # an even scene has nothing to blur but its fall-off


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


def test_score_through_a_simple_lens_is_worse_than_through_a_thin_one(singlet) -> None:
    scene, camera, _, image = singlet
    thin = without_lens(camera)
    real = evaluate(image, camera, PIXEL)
    ideal = evaluate(render(scene, thin, plan=make_render_plan(scene, thin, PIXEL)), thin, PIXEL)
    assert real.mean_delta_e > 1.1 * ideal.mean_delta_e


def test_ideal_image_has_the_distortion_unless_asked_otherwise() -> None:
    scene, camera = through("phone", 4.8, 96)
    image = render(scene, camera, plan=make_render_plan(scene, camera, PIXEL))
    assert ideal_light(image, camera) is image
    straight = camera.model_copy(update={"lens": camera.lens.model_copy(update={"ideal": "undistorted"})})
    moved = ideal_light(image, straight)
    shift = distortion_of(camera).largest_mm * 1e3 / image.pitch_um
    assert shift > 1
    assert np.abs(moved.factors[1] - image.factors[1]).max() > 0.05


def test_a_thin_enough_lens_is_left_out_and_the_picture_is_the_thin_lens_s_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "thin.toml"
    file.write_text(THIN, encoding="utf-8")
    scene, camera = through(str(file), 0.1, 32, focal_length_mm=10.0)
    plan = make_render_plan(scene, camera, PIXEL)
    (decision,) = [decision for decision in plan.decisions if decision.subject == "real lens"]
    assert not decision.kept
    assert 0 < decision.bound_e < 5e-4
    thin = without_lens(camera)
    assert (thin.focal_length_mm, thin.f_number) == (camera.focal_length_mm, camera.f_number)
    image, other = render(scene, camera, plan=plan), render(scene, thin, plan=make_render_plan(scene, thin, PIXEL))
    assert np.array_equal(image.factors[1], other.factors[1])
    assert LENS_HEADER not in image.header
    physics = derive(PIXEL)
    assert np.array_equal(diffracted_rate(image, camera, physics), diffracted_rate(other, thin, physics))


def test_plans_without_a_real_lens_say_nothing_of_it() -> None:
    scene = load_scene("csf", resolution=32)
    plan = make_render_plan(scene, scene.camera(), PIXEL)
    assert plan.tiling is None
    assert "real lens" not in [decision.subject for decision in plan.decisions]


def test_scenes_with_depth_are_told_what_is_wrong() -> None:
    scene, camera = through("singlet", 6.0, 32, "still_life")
    plan = make_render_plan(scene, camera, PIXEL)
    assert any("thin lens's defocus" in note for note in plan.warnings)


def test_bands_of_a_scene_with_several_spectra_are_blurred_in_groups(singlet) -> None:
    """Light stored by bands is blurred group by group of bands, each at its mean wavelength: like that of one spectrum."""
    _, camera, _, image = singlet
    physics = derive(PIXEL)
    whole = diffracted_rate(image, camera, physics)
    by_bands = type(image)(
        image.wavelength_nm, image.band_width_nm, image.pitch_um, data=image.data, within=image.within, header=image.header
    )
    found = diffracted_rate(by_bands, camera, physics)
    assert np.sqrt(np.mean((found - whole) ** 2)) < 0.01 * whole.std()
