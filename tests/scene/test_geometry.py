"""Where shapes stand before the lens, against thin-lens optics, brute-force rays and Mitsuba's own shapes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from helpers.edits import END, VARIANT, edited, load

import pixsim
from pixsim.scene.contents import Body, blur_um, face_one_way, find_bodies, greatest_blur_um
from pixsim.scene.mitsuba import speaking_mitsuba
from pixsim.scene.scene import sensor_node

LOOK = '<lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/>'


# --- Blur ---


@pytest.mark.parametrize("depth_m", [0.05, 0.5, 0.999, 1.0, 1.2, 7.0, 1e6])
@pytest.mark.parametrize(("focal_mm", "f_number", "focus_m"), [(3.86, 4.0, 1.0), (50.0, 1.4, 0.8)])
def test_blur_is_the_disc_of_a_thin_lens(focal_mm, f_number, focus_m, depth_m):
    camera = pixsim.Camera(focal_length_mm=focal_mm, f_number=f_number, object_distance_m=focus_m)
    sensor_mm = 1 / (1 / focal_mm - 1 / (1e3 * focus_m))
    vergence = 1 / focal_mm - 1 / (1e3 * depth_m)  # 1/v; negative where the image is virtual
    diameter_um = 1e3 * focal_mm / f_number * abs(sensor_mm * vergence - 1)
    assert blur_um(camera, depth_m) == pytest.approx(diameter_um, rel=1e-9, abs=1e-9)


def test_blur_is_infinite_at_the_lens_and_behind_it():
    camera = pixsim.Camera()
    for depth_m in (0.0, -1.0):
        assert np.isinf(blur_um(camera, depth_m))
    assert np.isinf(greatest_blur_um(camera, Body(0, None, None)))


def test_the_greatest_blur_of_a_body_is_at_one_of_its_ends():
    camera = pixsim.Camera()
    deep = box(0, 0, 1.0, (0, 0, 0.4))
    assert greatest_blur_um(camera, deep) == pytest.approx(max(blur_um(camera, 0.6), blur_um(camera, 1.4)), rel=1e-12)
    assert blur_um(camera, 0.6) > blur_um(camera, 1.4) > 0


def test_mitsuba_blurs_a_disc_as_wide(tmp_path):
    """The second moment of a uniform disc is D²/8, that of one disc convolved with another the sum."""
    radius_m, depth_m = 6e-5, 0.07
    small = ('x="$chart_half_width" y="$chart_half_width"', f'x="{radius_m}" y="{radius_m}"')
    away = ('<translate z="$focus_distance"/>', f'<translate z="{depth_m}"/>')
    scene = load(edited(tmp_path, "flat", ('type="rectangle"', 'type="disk"'), small, away), resolution=48, spp=400)
    camera = pixsim.Camera(f_number=1.0, object_distance_m=0.1, die_mm=0.16)
    image = pixsim.render(scene, camera)
    light = image.illuminance_lx()
    at = (np.arange(48) - 23.5) * image.pitch_um
    moment = (light * (at**2 + at[:, None] ** 2)).sum() / light.sum()
    own_um = 2 * radius_m / depth_m * camera.image_distance_mm * 1e3
    sample = image.pitch_um**2 / 6
    diameter_um = np.sqrt(8 * (moment - sample) - own_um**2)
    # From 6 seeds 0.8 % of noise (some 4000 rays meet the small disc): 4σ.
    assert diameter_um == pytest.approx(blur_um(camera, depth_m), rel=0.03)


# --- In view ---


def box(x: float, y: float, z: float, half: tuple[float, float, float] = (0, 0, 0)) -> Body:
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) * half + [x, y, z]
    return Body(0, corners, None)


def widest(camera: pixsim.Camera, half_m: float, z: float) -> float:
    """How far from the axis any ray of the picture is at a depth: from all over the lens to all over the plane in focus."""
    a, u = camera.aperture_radius_m, camera.object_distance_m
    start, end = np.meshgrid(np.linspace(-a, a, 201), np.linspace(-half_m, half_m, 201))
    return float(np.abs(start + (end - start) * z / u).max())


@pytest.mark.parametrize("z", [1e-4, 0.02, 0.5, 1.0, 1.5, 20.0])
@pytest.mark.parametrize("aspect", [1.0, 2.0])
@pytest.mark.parametrize("f_number", [0.6, 4.0])
def test_what_any_ray_may_meet_is_in_view(z, aspect, f_number):
    camera = pixsim.Camera(f_number=f_number)
    for axis, half_m in ((0, camera.chart_half_width_m), (1, camera.chart_half_width_m / aspect)):
        edge = widest(camera, half_m, z)
        for side, times in product((-1, 1), (0.999, 1.001)):
            at = [0.0, 0.0]
            at[axis] = side * times * edge
            assert box(*at, z).in_view(camera, aspect) == (times < 1), (axis, side, times)


def test_bodies_beside_behind_inside_and_around():
    camera = pixsim.Camera()
    assert box(0, 0, 0.5, (0.01,) * 3).in_view(camera, 1)
    assert not box(0, 0, -0.5, (0.01,) * 3).in_view(camera, 1)
    assert not box(3, 0, 0.5, (0.01,) * 3).in_view(camera, 1)
    assert box(3, 0, 0.5, (2.9, 0.01, 0.01)).in_view(camera, 1)
    assert box(0, 0, 0, (5, 5, 5)).in_view(camera, 1)  # the camera inside it
    assert box(0, 0, 0, (5, 5, 0.1)).in_view(camera, 1)  # and in a thin one, across the lens
    assert Body(0, None, None).in_view(camera, 1)  # of unknown size
    # In the penumbra: beyond the picture's edge in focus, but the blur reaches in.
    near = box(camera.chart_half_width_m * 0.05 + 0.9 * camera.aperture_radius_m * 0.95, 0, 0.05)
    assert near.in_view(camera, 1)
    assert not near.in_view(camera.model_copy(update={"f_number": 40.0}), 1)


# --- Bodies of a scene ---


def bodies_of(path, **parameters) -> list[Body]:
    scene = load(path, **parameters)
    state = scene.parse()
    return find_bodies(state, sensor_node(state, None)[1])


TURN = '<scale x="0.2" y="0.3" z="0.5"/><rotate x="1" y="2" z="0.5" angle="35"/><translate x="0.1" y="-0.2" z="0.7"/>'
SHAPES = {
    "rectangle": f'<transform name="to_world">{TURN}</transform>',
    "cube": f'<transform name="to_world">{TURN}</transform>',
    "disk": f'<transform name="to_world">{TURN}</transform>',
    "sphere": '<point name="center" x="0.1" y="0.2" z="0.3"/><float name="radius" value="0.25"/>'
    '<transform name="to_world"><scale value="0.5"/><translate z="0.7"/></transform>',
    "cylinder": '<point name="p0" x="0.1" y="0" z="0.2"/><point name="p1" x="0.3" y="0.4" z="0.5"/>'
    '<float name="radius" value="0.15"/><transform name="to_world"><rotate y="1" angle="40"/><translate z="0.7"/></transform>',
}


@pytest.mark.parametrize("plugin", SHAPES)
def test_corners_enclose_the_shape_as_mitsuba_places_it(plugin, tmp_path):
    path = edited(tmp_path, "flat", (END, f'<shape type="{plugin}" id="thing">{SHAPES[plugin]}</shape>'))
    body = bodies_of(path)[1]
    with speaking_mitsuba(VARIANT, tmp_path) as mi:
        bounds = next(each for each in mi.load_file(str(path)).shapes() if each.id() == "thing").bbox()
        low, high = np.array(bounds.min), np.array(bounds.max)
    mine = body.corners.min(axis=0), body.corners.max(axis=0)
    assert np.all(mine[0] <= low + 1e-6)
    assert np.all(mine[1] >= high - 1e-6)
    if plugin in ("rectangle", "cube", "sphere"):
        np.testing.assert_allclose(mine, (low, high), atol=1e-6)
    else:  # a square around a disc and a cube around each end: at most √2 wider
        assert np.all(mine[1] - mine[0] <= 2 * (high - low) + 1e-6)


def test_bodies_stand_in_the_frame_of_a_camera_anywhere(tmp_path):
    """The still life's glass ball, 10 cm along the axis of a camera that looks down."""
    state = load("still_life").parse()
    bodies = {state.nodes[body.node].props.id(): body for body in find_bodies(state, sensor_node(state, None)[1])}
    eye, target = np.array([0, 0.036, -0.094]), np.array([0, 0.0105, 0])
    forward = (target - eye) / np.linalg.norm(target - eye)
    across = np.array([1.0, 0, 0])  # up × forward
    frame = np.stack([across, np.cross(forward, across), forward])
    expected = frame @ (np.array([-0.0105, 0.0085, 0]) - eye)
    np.testing.assert_allclose(bodies["glass_ball"].corners.mean(axis=0), expected, atol=1e-6)
    assert np.ptp(bodies["glass_ball"].corners, axis=0).min() >= 2 * 0.0085
    np.testing.assert_allclose(bodies["table"].normal, frame @ [0, 1, 0], atol=1e-6)
    assert {"red_cube", "gold_can", "sun"} <= bodies.keys()


INSTANCE = """<shape type="shapegroup" id="group">{inside}</shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><scale value="2"/><translate x="0.1" z="3"/></transform></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><translate z="5"/></transform></shape>"""
BALL = '<shape type="sphere"><float name="radius" value="0.1"/></shape>'
CUBE = '<shape type="cube"><transform name="to_world"><scale value="0.1"/><translate y="0.4"/></transform></shape>'


def test_members_of_a_group_stand_where_its_instances_are(tmp_path):
    path = edited(tmp_path, "flat", (END, INSTANCE.format(inside=BALL + CUBE)))
    chart, first, second = bodies_of(path)
    assert chart.normal is not None
    assert first.depths_m == pytest.approx((2.8, 3.2))
    assert second.depths_m == pytest.approx((4.9, 5.1))
    np.testing.assert_allclose(first.corners.min(axis=0), [-0.1, -0.2, 2.8], atol=1e-6)
    np.testing.assert_allclose(first.corners.max(axis=0), [0.3, 1.0, 3.2], atol=1e-6)
    assert first.normal is None


def test_a_member_of_unknown_size_makes_its_instances_unknown(tmp_path):
    inside = BALL + '<shape type="ply"><string name="filename" value="charts/flat.exr"/></shape>'
    chart, *instances = bodies_of(edited(tmp_path, "flat", (END, INSTANCE.format(inside=inside))))
    assert chart.corners is not None
    assert [body.corners for body in instances] == [None, None]


# --- Which side they show ---


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, -2, 1), (1, 1, -1), (-1, 0.5, -1)])
@pytest.mark.parametrize("plugin", ["rectangle", "disk"])
def test_normals_are_those_by_which_mitsuba_shades(plugin, scale, flip, tmp_path):
    sizes = " ".join(f'{name}="{value}"' for name, value in zip("xyz", scale, strict=True))
    turn = f'<scale {sizes}/><rotate x="1" y="0.3" angle="25"/><translate z="0.7"/>'
    inside = f'<boolean name="flip_normals" value="{flip}"/><transform name="to_world">{turn}</transform>'
    path = edited(tmp_path, "flat", (END, f'<shape type="{plugin}">{inside}</shape>'), ('x="$chart_half_width"', 'x="0.0001"'))
    normal = bodies_of(path)[1].normal
    with speaking_mitsuba(VARIANT, tmp_path) as mi:
        hit = mi.load_file(str(path)).ray_intersect(mi.Ray3f([0.05, 0.03, 0], [0, 0, 1]))
        shaded = np.array(hit.sh_frame.n)
    np.testing.assert_allclose(normal, shaded, atol=1e-6)


def facing(*normals: tuple[float, float, float] | None) -> bool:
    return face_one_way([Body(0, None, None if n is None else np.array(n, float) / np.linalg.norm(n)) for n in normals])


def test_boards_that_face_one_way():
    assert facing((0, 0, -1), (0, 0, -1))
    assert facing((0.6, 0, -0.8), (0.6, 1e-8, -0.8))
    assert not facing((0, 0, -1), (0, 0, 1))
    assert not facing((0, 0, -1), (0, 1e-4, -1))  # they would see each other
    assert not facing((0, 0, -1), None)
    assert not facing()
