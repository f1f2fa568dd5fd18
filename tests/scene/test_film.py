"""The film's shape and size: as the die, for what the pixel, the lens and the display need, within
its limits.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from helpers.edits import edited, load

import pixsim
from pixsim.base.arrays import Array
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.thin_lens import field_factor
from pixsim.scene.charts import csf_contrast
from pixsim.scene.film import (
    BLOCK,
    MAX_ACROSS,
    MAX_BYTES,
    details_across,
    film_bytes,
    film_memory_bytes,
    fitting_width,
    largest_film,
)
from pixsim.scene.plan import make_plan, make_render_plan
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display

LANDSCAPE, PORTRAIT = Camera(die_height_mm=1.8), Camera(die_mm=1.8, die_height_mm=2.7136)


@cache
def chart_on(name: str, camera: Camera, width: int = 96) -> Array:
    """Illuminance of a packaged chart on a die, without the fall-off of the lens, over its largest
    value.
    """
    image = pixsim.render(load(name, spp=16).with_resolution(width), camera)
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    picture = image.illuminance_lx() / field_factor(image.shape, image.pitch_um, *lens)
    return picture / picture.max()


@pytest.mark.parametrize("camera", [LANDSCAPE, PORTRAIT])
def test_film_has_shape_of_die(camera):
    scene = load("csf").with_resolution(96)
    height, width = scene.film_shape(camera, scene.for_camera(camera))
    assert width == 96
    assert height == math.ceil(96 * camera.height_mm / camera.die_mm)
    assert load("csf").camera(CameraOptions(die_height_mm=1.8)) == LANDSCAPE


def test_film_shape_of_xml_without_die_height(tmp_path):
    path = edited(
        tmp_path, "csf", ('name="height" value="$resolution"', 'name="height" value="256"')
    )
    scene = load(path)
    camera = scene.camera()
    assert camera.die_height_mm == pytest.approx(camera.die_mm / 4)  # the film is 1024 × 256
    assert (
        scene.film_shape(camera, scene.parse())
        == scene.film_shape(Camera(), scene.parse())
        == (256, 1024)
    )
    assert scene.with_resolution(100).film_shape(Camera(), scene.parse()) == (25, 100)
    square = scene.camera(CameraOptions(die_height_mm=2.7136))
    assert scene.film_shape(square, scene.parse()) == (1024, 1024)


@pytest.mark.parametrize("camera", [pytest.param(LANDSCAPE, marks=pytest.mark.slow), PORTRAIT])
@pytest.mark.parametrize("name", ["csf", "flat", "slanted_edge", "siemens_star"])
def test_packaged_charts_fill_die_of_any_shape(name, camera):
    """Every border is lit: the darkest texel of the charts has 2.4 % of the brightest."""
    picture = chart_on(name, camera)
    assert (
        min(picture[0].min(), picture[-1].min(), picture[:, 0].min(), picture[:, -1].min()) > 0.02
    )
    if name == "flat":
        np.testing.assert_allclose(picture, 1, rtol=1e-3)
    if name != "siemens_star":  # its texture is continued beyond its border
        assert make_render_plan(load(name).with_resolution(96), camera).film.chart is not None


@pytest.mark.parametrize("camera", [LANDSCAPE, PORTRAIT])
def test_csf_contrast_axis_is_stretched_over_die(camera):
    """The contrast at fractions of the height is that of the chart's formula, in the coarse
    gratings on the left.
    """
    picture, rows = chart_on("csf", camera)[:, :32], np.array([0.25, 0.5, 0.75, 0.95])
    expected = csf_contrast(rows)
    swing = np.ptp(picture[(rows * picture.shape[0]).astype(int)], axis=1)
    np.testing.assert_allclose(
        swing / swing[-1], expected / expected[-1], rtol=0.15
    )  # half a row is 2.4 %


@pytest.mark.parametrize("camera", [pytest.param(LANDSCAPE, marks=pytest.mark.slow), PORTRAIT])
def test_slanted_edge_keeps_angle(camera):
    picture = chart_on("slanted_edge", camera, 192)
    # Position of the edge in each row, from the share of light cells.
    place = ((picture.max() - picture) / (picture.max() - picture.min())).sum(axis=1)
    slope = np.polyfit(np.arange(place.size), place, 1)[0]
    assert math.degrees(math.atan(abs(slope))) == pytest.approx(5, abs=0.1)


@pytest.mark.parametrize("camera", [LANDSCAPE, pytest.param(PORTRAIT, marks=pytest.mark.slow)])
def test_siemens_star_is_round_and_whole(camera):
    """Its disc has 90 % of the shorter side, and half of it is dark."""
    picture = chart_on("siemens_star", camera, 192)
    dark = (1 - picture) / (1 - 0.025)
    down, across = dark.sum(axis=1), dark.sum(axis=0)
    spread = [
        math.sqrt(np.average((np.arange(sums.size) + 0.5 - sums.size / 2) ** 2, weights=sums))
        for sums in (down, across)
    ]
    radius = 0.45 * min(picture.shape)
    np.testing.assert_allclose(spread, radius / 2, rtol=0.02)  # of a disc: r/2 along each axis
    assert dark.sum() == pytest.approx(math.pi * radius**2 / 2, rel=0.02)


# --- The size ---


def test_details_across_is_what_limits():
    camera, display = Camera(die_mm=2.4, f_number=2.8, focal_length_mm=4.0), Display(dots=512)
    assert details_across(camera, 3.75, display, 3.75) == (640.0, "photodiodes")  # 2400/3.75
    assert details_across(camera, 20.0, display, 20.0) == (512.0, "dots of the display")
    assert details_across(camera, 0.5, display, 0.5) == (1024.0, "half dots of the display")
    slow, name = details_across(camera.model_copy(update={"f_number": 16.0}), 0.5, display, 0.5)
    assert slow == pytest.approx(
        2 * 2.4 / (550e-6 * 16.0), rel=0.01
    )  # two samples for each period of 1/(λN)
    assert name == "half periods of the lens's cut-off"
    assert details_across(camera, 0.5, display, 0.5, chart_details=90.0) == (
        90.0,
        "details of the chart",
    )
    one_to_one = Display(raster="one_to_one")
    assert details_across(camera, 2.0, one_to_one, 3.0)[0] == pytest.approx(2400 / 2.0)


@pytest.mark.parametrize("planes", [1, 12, 48, 300])
@pytest.mark.parametrize("ratio", [1.0, 0.667, 1.5])
def test_largest_film_within_limits(planes, ratio):
    width = largest_film(ratio, planes)
    assert width <= MAX_ACROSS
    assert film_bytes(width**2 * ratio, planes) <= MAX_BYTES
    wider = width + BLOCK
    assert wider > MAX_ACROSS or film_bytes(wider**2 * ratio, planes) > MAX_BYTES


@pytest.mark.parametrize(
    ("columns", "rows"),
    [(2448, 2048), (9568, 6380), (1936, 1216), (4096, 2160), (1000, 1000), (2048, 2448)],
)
def test_fitting_width_ends_within_one_pixel_of_die(columns, rows):
    """The film covers the die, and no row of pixels more, for films of at least half a sample a
    pixel.
    """
    ratio = rows / columns
    for needed in (columns / 2, columns * 0.8, columns, 2 * columns):
        width = fitting_width(ratio, needed, MAX_ACROSS)
        assert min(needed, MAX_ACROSS) * 0.85 <= width <= MAX_ACROSS
        height = math.ceil(width * ratio - 1e-6)
        assert rows <= height / width * columns * (1 + 1e-9) < rows + 1


@pytest.mark.parametrize(
    ("pixels", "pitch_um"),
    [
        ((620, 413), 4.5),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (((413, 620), 4.5), ((640, 481), 3.75))
        ),
    ],
)
def test_render_film_gives_pixels_of_die(pixels, pitch_um):
    columns, rows = pixels
    camera = Camera(die_mm=columns * pitch_um / 1e3, die_height_mm=rows * pitch_um / 1e3)
    scene = load("csf", spp=4)
    pixel = Pixel(pitch_um=pitch_um, technology="4t-bsi")
    plan = make_plan(scene, camera, pixel, display=Display(dots=columns))
    light = pixsim.render(
        scene.with_resolution(fitting_width(rows / columns, 300, MAX_ACROSS)), camera
    )
    assert pixsim.evaluate(light, camera, pixel).frame.dn.shape == (rows, columns)
    assert pixsim.make_sensor(pixel, camera).shape == (rows, columns)
    assert plan.film.resolution is None  # 90 periods need no more than the film of the scene


def test_plan_display_raises_film_of_unknown_scene():
    pixel, camera = Pixel(pitch_um=6.5), Camera()
    scene = load("line_lamp", resolution=64)
    plan = make_plan(scene, camera, pixel, display=Display(dots=100))
    side_um = pixsim.derive(pixel).photodiode_side_um
    details = min(2 * 100, 2713.6 / side_um)
    assert plan.film.resolution == BLOCK * math.ceil(2 * details / BLOCK)
    (decision,) = (decision for decision in plan.decisions if decision.subject == "oversampling")
    assert f"not 64 as in the scene: {details:.4g} half dots of the display" in decision.reason
    assert (
        make_plan(scene, camera, pixel).film.resolution is None
    )  # without a display the scene's film stays
    assert (
        make_plan(
            scene.with_resolution(64), camera, pixel, display=Display(dots=100)
        ).film.resolution
        is None
    )
    finer = load("line_lamp", resolution=2000)
    assert make_plan(finer, camera, pixel, display=Display(dots=100)).film.resolution is None


def test_chart_details_of_known_charts():
    """Twice the highest frequency of the CSF chart; a sine in the texture; one for a uniform
    field.
    """
    chart = make_render_plan(load("csf"), Camera()).film.chart
    assert chart is not None
    assert (
        1 < chart.details / (2 * 33.3 * 2.7136) < 1.4
    )  # a sweep that ends at 33.3 lp/mm has a little above
    flat = make_render_plan(load("flat"), Camera()).film.chart
    assert flat is not None
    assert flat.details == 1


@pytest.mark.parametrize(
    ("width", "planes", "measured_gib"),
    [
        (512, 1, 0.41),
        (8192, 1, 1.31),
        (8192, 12, 1.68),
    ],  # tests/benchmarks: `csf` and `macbeth`, with the program
)
def test_memory_of_a_film_is_that_of_its_planes(
    width: int, planes: int, measured_gib: float
) -> None:
    gib = film_memory_bytes(width**2, planes) / (1 << 30)
    assert 0.9 * measured_gib < gib < 2.1 * measured_gib
    assert film_memory_bytes(width**2, 100 * planes) < film_memory_bytes(width**2, planes) + 1.1 * (
        1 << 30
    )
