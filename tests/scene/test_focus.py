"""A scene of which nothing is in focus: the depths that a camera sees, in closed form, and what is
said of them.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import VARIANT, lens_xml, scene_file, sensor_xml

from pixsim import evaluate, load_scene, render
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_defocus import DEPTHS, depth_of_disc_m, finite_or_none, signed_disc_um
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.pixel_notes import focus_notes
from pixsim.sensor.pixel_options import Pixel

# A plane 0.3 m away, a part of the picture wide, turned about the vertical axis.
EYE = '<transform name="to_world"><lookat origin="0, 0, -0.3" target="0, 0, 0" up="0, 1, 0"/></transform>'
PLANE = """<default name="degrees" value="0"/><default name="half_width" value="1"/>
    <integrator type="direct"/><emitter type="directional"><vector name="direction" value="0, 0, 1"/>
        <spectrum name="irradiance" value="1"/></emitter>
    <shape type="rectangle"><transform name="to_world"><scale x="$half_width" y="1"/>
        <rotate y="1" angle="180"/><rotate y="1" angle="$degrees"/></transform></shape>"""
GLASS = """<shape type="rectangle">
    <transform name="to_world"><scale x="0.02" y="1"/><rotate y="1" angle="180"/><translate z="-0.1"/></transform>
    <bsdf type="thindielectric"/>
</shape>"""
HALF_M = 0.3 * math.tan(math.radians(10.0))  # of the view at the plane


def plane_file(folder: Path, more: str = "", focus_m: float = 0.3) -> Path:
    sensor = sensor_xml(lens_xml(20, 0.002, focus_m) + EYE, size=(32, 32), spp=16)
    return scene_file(folder, sensor, PLANE, more)


def renderer_of(path: Path, variant: str | None = VARIANT, **parameters: float) -> Renderer:
    scene = load_scene(path, variant=variant, **parameters)
    return Renderer(scene, scene.camera(), make_render_plan(scene, full=True), 0)


def test_depths_of_a_tilted_plane_are_those_of_its_equation(tmp_path: Path) -> None:
    """A ray of slope t along x meets a plane that is turned by θ about the vertical at 0.3 m / (1 ±
    t tan θ).
    """
    renderer = renderer_of(plane_file(tmp_path), degrees=30.0)
    depths_m = InProcessTracer(renderer.job).depths(8)[:, :, 0]
    slopes = HALF_M / 0.3 * (2 * (np.arange(8) + 0.5) / 8 - 1)
    expected_m = np.sort(0.3 / (1 + slopes * math.tan(math.radians(30.0))))
    expected_m = np.broadcast_to(expected_m, (8, 8))
    np.testing.assert_allclose(np.sort(depths_m, axis=1), expected_m, rtol=1e-5)  # float32


@pytest.mark.parametrize("variant", [VARIANT, None])
def test_depths_are_infinite_beyond_shapes_and_unknown_behind_glass(
    variant: str | None, tmp_path: Path
) -> None:
    """The plane fills the middle half of the picture, and glass its middle: what lies behind it may
    be in focus.
    """
    glass = GLASS.replace("0.02", str(HALF_M / 6))
    renderer = renderer_of(plane_file(tmp_path, glass), variant, half_width=HALF_M / 2)
    expected_m = [math.inf, math.inf, 0.3, math.nan, math.nan, 0.3, math.inf, math.inf]
    for tracer in (InProcessTracer(renderer.job), ChildTracer(renderer.job)):
        np.testing.assert_allclose(tracer.depths(8)[4, :, 0], expected_m, rtol=1e-6)
    assert renderer.depths_m == []


@pytest.mark.parametrize(("sky", "farthest_m"), [("", 0.3), ('<emitter type="sunsky"/>', math.inf)])
def test_a_picture_at_infinity_is_seen_beyond_all_shapes(
    sky: str, farthest_m: float, tmp_path: Path
) -> None:
    renderer = renderer_of(plane_file(tmp_path, sky), half_width=0.01)
    assert renderer.depths_m == pytest.approx([0.3, 0.3, farthest_m], rel=1e-6)


def light_of(depths_m: list[float]) -> SpectralImage:
    header = {DEPTHS: finite_or_none(depths_m)} if depths_m else {}
    return SpectralImage([550.0], 10.0, 5.0, data=np.ones((4, 4, 1)), header=header)


@pytest.mark.parametrize(
    "lens", [None, LensOptions(file="singlet", focal_length_mm=16.0)], ids=["thin", "real"]
)
def test_note_begins_where_the_least_disc_is_two_pixels(
    lens: LensOptions | None, tmp_path: Path
) -> None:
    """With foreground and background further off; and not where depths are not known."""
    scene = load_scene(plane_file(tmp_path), variant=VARIANT)
    camera = scene.camera(CameraOptions(die_mm=2.0, f_number=8.0), lens)
    for side_um in (-3.0, 3.0):
        for pixels, count in ((1.99, 0), (2.01, 1)):
            sharpest_m = depth_of_disc_m(camera, side_um * pixels)
            assert signed_disc_um(camera, sharpest_m) == pytest.approx(side_um * pixels, rel=1e-9)
            notes = focus_notes(3.0, camera, light_of([0.2, sharpest_m, math.inf]))
            assert len(notes) == count
    assert not focus_notes(3.0, camera, light_of([]))


@pytest.mark.parametrize(
    ("focus_m", "distance_m", "count"), [(0.3, None, 0), (0.3, 0.4, 1), (300.0, None, 1)]
)
def test_scene_out_of_focus_is_said(
    focus_m: float, distance_m: float | None, count: int, tmp_path: Path
) -> None:
    """By an option, or by an XML in mm."""
    scene = load_scene(plane_file(tmp_path, focus_m=focus_m), variant=VARIANT)
    camera = scene.camera(CameraOptions(object_distance_m=distance_m))
    light = render(scene, camera)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evaluate(light, camera, Pixel(pitch_um=8.0))
    notes = [str(warning.message) for warning in caught]
    assert sum("scene is at 0.3 m" in note for note in notes) == count
