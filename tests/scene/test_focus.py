"""A scene of which nothing is in focus: the depths that a camera sees, in closed form, and what is
said of them.
"""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import VARIANT

from pixsim import evaluate, load_scene, render
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.lens_defocus import (
    DEPTHS,
    depth_of_disc_m,
    depth_of_field_m,
    finite_or_none,
    signed_disc_um,
)
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.pixel_notes import focus_notes
from pixsim.sensor.pixel_options import Pixel

# A plane 0.3 m away, a part of the picture wide, turned about the vertical axis.
SCENE = """<scene version="3.0.0">
    <default name="focus" value="0.3"/>
    <default name="degrees" value="0"/>
    <default name="half_width" value="1"/>
    <integrator type="direct"/>
    <sensor type="thinlens">
        <float name="fov" value="20"/>
        <float name="aperture_radius" value="0.002"/>
        <float name="focus_distance" value="$focus"/>
        <transform name="to_world"><lookat origin="0, 0, -0.3" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film>
        <sampler type="multijitter"><integer name="sample_count" value="16"/></sampler>
    </sensor>
    <emitter type="directional"><vector name="direction" x="0" y="0" z="1"/><spectrum name="irradiance" value="1"/></emitter>
    <shape type="rectangle">
        <transform name="to_world">
            <scale x="$half_width" y="1"/><rotate y="1" angle="180"/><rotate y="1" angle="$degrees"/>
        </transform>
        <bsdf type="diffuse"/>
    </shape>
    <!-- more -->
</scene>
"""
GLASS = """<shape type="rectangle">
    <transform name="to_world"><scale x="0.02" y="1"/><rotate y="1" angle="180"/><translate z="-0.1"/></transform>
    <bsdf type="thindielectric"/>
</shape>"""


def scene_file(folder: Path, more: str = "") -> Path:
    path = folder / "plane.xml"
    path.write_text(SCENE.replace("<!-- more -->", more), encoding="utf-8")
    return path


def renderer_of(path: Path, variant: str | None = VARIANT, **parameters: float) -> Renderer:
    scene = load_scene(str(path), variant=variant, **parameters)
    return Renderer(scene, scene.camera(), make_render_plan(scene, full=True), 0)


def test_depths_of_a_tilted_plane_are_those_of_its_equation(tmp_path: Path) -> None:
    """A ray of slope t along x meets a plane that is turned by θ about the vertical at 0.3 m / (1 ±
    t tan θ).
    """
    depths_m = InProcessTracer(renderer_of(scene_file(tmp_path), degrees=30.0).job).depths(8)[
        :, :, 0
    ]
    slopes = math.tan(math.radians(10.0)) * (2 * (np.arange(8) + 0.5) / 8 - 1)
    expected_m = 0.3 / (1 + slopes * math.tan(math.radians(30.0)))
    turned = expected_m if depths_m[0, 0] > depths_m[0, -1] else expected_m[::-1]
    np.testing.assert_allclose(depths_m, np.broadcast_to(turned, (8, 8)), rtol=1e-5)  # float32


@pytest.mark.parametrize("variant", [VARIANT, None])
def test_depths_are_infinite_beyond_shapes_and_unknown_behind_glass(
    variant: str | None, tmp_path: Path
) -> None:
    """The plane fills the middle half of the picture, 2 · 0.3 m · tan 10° wide, and glass its
    middle.
    """
    half_m = 0.3 * math.tan(math.radians(10.0)) / 2
    renderer = renderer_of(
        scene_file(tmp_path, GLASS.replace("0.02", str(half_m / 3))), variant, half_width=half_m
    )
    for tracer in (InProcessTracer(renderer.job), ChildTracer(renderer.job)):
        row = tracer.depths(8)[4, :, 0]
        assert np.isinf(row[[0, 1, 6, 7]]).all()
        np.testing.assert_allclose(row[[2, 5]], 0.3, rtol=1e-6)
        assert np.isnan(row[[3, 4]]).all()
    assert renderer.depths_m == [], "what lies behind glass may be in focus"


def test_a_picture_at_infinity_is_seen_beyond_all_shapes(tmp_path: Path) -> None:
    sky = '<emitter type="sunsky"/>'
    assert renderer_of(scene_file(tmp_path), half_width=0.01).depths_m == pytest.approx(
        [0.3] * 3, rel=1e-6
    )
    assert renderer_of(scene_file(tmp_path, sky), half_width=0.01).depths_m == pytest.approx(
        [0.3, 0.3, math.inf], rel=1e-6
    )


@pytest.mark.parametrize(("pixel_um", "far"), [(5.0, True), (80.0, False)])
def test_depth_of_field_closed_form(pixel_um: float, far: bool) -> None:
    """u f²/(f² ± N c (u - f)), and infinity where the hyperfocal distance is nearer."""
    camera = Camera(focal_length_mm=16.0, f_number=4.0, object_distance_m=1.0)
    f2_mm2, spread_mm2 = 16.0**2, 4.0 * 1e-3 * pixel_um * (1000.0 - 16.0)
    near_m, far_m = depth_of_field_m(camera, pixel_um)
    assert near_m == pytest.approx(f2_mm2 / (f2_mm2 + spread_mm2), rel=1e-12)
    assert (
        (far_m == pytest.approx(f2_mm2 / (f2_mm2 - spread_mm2), rel=1e-12))
        if far
        else math.isinf(far_m)
    )


def light_of(depths_m: list[float]) -> SpectralImage:
    return SpectralImage(
        [550.0], 10.0, 5.0, data=np.ones((4, 4, 1)), header={DEPTHS: finite_or_none(depths_m)}
    )


LENSES = [{}, {"lens": LensOptions(file="singlet", focal_length_mm=16.0)}]


@pytest.mark.parametrize("lens", LENSES, ids=["thin", "real"])
def test_note_begins_where_the_least_disc_is_two_pixels(
    lens: dict[str, Any], tmp_path: Path
) -> None:
    """Of a thin lens and of a real one, whose focus is its camera's, with foreground and background
    further off.
    """
    camera = load_scene(str(scene_file(tmp_path)), variant=VARIANT).camera(
        CameraOptions(die_mm=2.0, f_number=8.0), **lens
    )
    for side in (-1, 1):
        for pixels, said in ((1.99, False), (2.01, True)):
            sharpest_m = depth_of_disc_m(camera, side * pixels * 3.0)
            assert abs(signed_disc_um(camera, sharpest_m)) == pytest.approx(pixels * 3.0, rel=1e-9)
            notes = focus_notes(3.0, camera, light_of([0.2, sharpest_m, math.inf]))
            assert len(notes) == said
            assert all(
                "focuses at 0.3 m, and the scene is at 0.2 m to infinity" in note for note in notes
            )
    assert not focus_notes(
        3.0, camera, SpectralImage([550.0], 10.0, 5.0, data=np.ones((4, 4, 1)))
    ), "depths are not known"


@pytest.mark.parametrize(
    ("focus", "distance", "words"),
    [
        (0.3, None, ""),
        (0.3, 0.4, "focuses at 0.4 m, and the scene is at 0.3 m"),
        (300.0, None, "focuses at 300 m, and the scene is at 0.3 m"),
    ],
    ids=["in focus", "option", "XML in mm"],
)
def test_scene_out_of_focus_is_told_by_calls_and_commands(
    focus: float, distance: float | None, words: str, tmp_path: Path
) -> None:
    path = scene_file(tmp_path)
    scene = load_scene(str(path), variant=VARIANT, focus=focus)
    light = render(scene, scene.camera(CameraOptions(object_distance_m=distance)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evaluate(
            light, scene.camera(CameraOptions(object_distance_m=distance)), Pixel(pitch_um=8.0)
        )
    notes = [str(warning.message) for warning in caught if "in focus" in str(warning.message)]
    assert len(notes) == bool(words)
    assert all(words in note for note in notes)

    option = f"--camera.object-distance-m {distance}" if distance else ""
    line = (
        f"run {path} -D focus={focus} --variant {VARIANT} --resolution 32 --pixel.pitch-um 8"
        " --display.dots 32 --render-noise 1"
    )
    code, out, err = command(f"{line} {option} --json --out {tmp_path / 'out'}")
    assert code == 0, err
    assert (f"nothing in view is in focus: the camera {words}" in " ".join(err.split())) == bool(
        words
    )
    result = json.loads(out)
    limits = finite_or_none(depth_of_field_m(Camera.model_validate(result["camera"]), 8.0))
    assert result["in_focus_m"] == result["plan"]["in_focus_m"] == limits
