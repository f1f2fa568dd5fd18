"""The film's shape and size: as the die, for what the pixel, the lens and the display need, within
its limits.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import edited, load

import pixsim
from pixsim.base.arrays import Array
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.thin_lens import field_factor
from pixsim.scene.film import (
    BLOCK,
    MAX_ACROSS,
    MAX_BYTES,
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


def test_siemens_star_is_round_and_whole() -> None:
    """Its disc has 90 % of the shorter side, r/2 along each axis, and half of it is dark."""
    dark = (1 - chart_on("siemens_star", LANDSCAPE, 192)) / (1 - 0.025)
    radius = 0.45 * min(dark.shape)
    assert dark.sum() == pytest.approx(math.pi * radius**2 / 2, rel=0.02)
    for axis in (0, 1):
        places = np.arange(dark.shape[axis]) + 0.5 - dark.shape[axis] / 2
        spread = np.average(places**2, weights=dark.sum(axis=1 - axis))
        assert math.sqrt(spread) == pytest.approx(radius / 2, rel=0.02)


@pytest.mark.parametrize("planes", [1, 48, 300])
@pytest.mark.parametrize("ratio", [1.0, 0.667, 1.5])
def test_largest_film_within_limits(planes: int, ratio: float) -> None:
    width = largest_film(ratio, planes)
    assert width <= MAX_ACROSS
    assert film_bytes(width**2 * ratio, planes) <= MAX_BYTES
    wider = width + BLOCK
    assert wider > MAX_ACROSS or film_bytes(wider**2 * ratio, planes) > MAX_BYTES


@pytest.mark.parametrize(
    ("columns", "rows"), [(2448, 2048), (9568, 6380), (4096, 2160), (1000, 1000), (2048, 2448)]
)
def test_fitting_width_ends_within_one_pixel_of_die(columns: int, rows: int) -> None:
    """The film covers the die, and no row of pixels more, for films of at least half a sample a
    pixel.
    """
    for needed in (columns / 2, columns * 0.8, columns, 2 * columns):
        width = fitting_width(rows / columns, needed, MAX_ACROSS)
        assert min(needed, MAX_ACROSS) * 0.85 <= width <= MAX_ACROSS
        height = math.ceil(width * rows / columns - 1e-6)
        assert rows <= height / width * columns * (1 + 1e-9) < rows + 1


def test_film_has_the_shape_of_the_die(tmp_path: Path) -> None:
    """Or that of the film in the XML, where the die has no height."""
    scene = load("csf").with_resolution(96)
    for camera in (LANDSCAPE, PORTRAIT):
        rows = math.ceil(96 * camera.height_mm / camera.die_mm)
        assert scene.film_shape(camera, scene.for_camera(camera)) == (rows, 96)

    height = ('name="height" value="$resolution"', 'name="height" value="256"')
    wide = load(edited(tmp_path, "csf", height))
    assert wide.camera().die_height_mm == pytest.approx(wide.camera().die_mm / 4)
    assert wide.film_shape(Camera(), wide.parse()) == (256, 1024)
    assert wide.with_resolution(100).film_shape(Camera(), wide.parse()) == (25, 100)
    square = wide.camera(CameraOptions(die_height_mm=2.7136))
    assert wide.film_shape(square, wide.parse()) == (1024, 1024)


@pytest.mark.parametrize("name", ["csf", "flat", "slanted_edge", "siemens_star"])
def test_packaged_charts_fill_a_die_of_any_shape(name: str) -> None:
    """Every border is lit: the darkest texel of the charts has 2.4 % of the brightest."""
    picture = chart_on(name, PORTRAIT)
    for border in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert border.min() > 0.02
    chart = make_render_plan(load(name).with_resolution(96), PORTRAIT).film.chart
    assert (chart is None) == (name == "siemens_star")  # its texture goes on beyond its border


def test_slanted_edge_keeps_its_angle() -> None:
    """By the position of the edge in each row, from the share of light cells."""
    picture = chart_on("slanted_edge", PORTRAIT, 192)
    place = ((picture.max() - picture) / np.ptp(picture)).sum(axis=1)
    slope = np.polyfit(np.arange(place.size), place, 1)[0]
    assert math.degrees(math.atan(abs(slope))) == pytest.approx(5, abs=0.1)


def test_pixels_of_a_film_are_those_of_the_die() -> None:
    camera = Camera(die_mm=620 * 4.5e-3, die_height_mm=413 * 4.5e-3)
    pixel = Pixel(pitch_um=4.5, technology="4t-bsi")
    scene = load("csf", spp=4).with_resolution(fitting_width(413 / 620, 300, MAX_ACROSS))
    light = pixsim.render(scene, camera)
    assert pixsim.evaluate(light, camera, pixel).frame.dn.shape == (413, 620)


def test_display_refines_the_film_of_an_unknown_scene() -> None:
    """Two samples for each half dot; not where the film is stated, is finer, or there is no
    display.
    """
    pixel = Pixel(pitch_um=6.5)
    scene = load("line_lamp", resolution=64)
    display = Display(dots=100)
    width = make_plan(scene, Camera(), pixel, display=display).film.resolution
    side_um = pixsim.derive(pixel).photodiode_side_um
    assert width == BLOCK * math.ceil(2 * min(2 * 100, 2713.6 / side_um) / BLOCK)
    others = [
        (scene, None),
        (scene.with_resolution(64), display),
        (load("line_lamp", resolution=2000), display),
    ]
    for other_scene, other_display in others:
        plan = make_plan(other_scene, Camera(), pixel, display=other_display)
        assert plan.film.resolution is None


@pytest.mark.parametrize(("name", "low", "high"), [("csf", 1, 1.4), ("flat", 1 / 181, 1 / 180)])
def test_details_of_a_chart(name: str, low: float, high: float) -> None:
    """Twice the highest frequency of the CSF chart, whose sweep has a little above it; one for a
    uniform field.
    """
    chart = make_render_plan(load(name), Camera()).film.chart
    assert chart is not None
    assert low < chart.details / (2 * 33.3 * 2.7136) < high


@pytest.mark.parametrize(
    ("width", "planes", "measured_gib"), [(512, 1, 0.41), (8192, 1, 1.31), (8192, 12, 1.68)]
)
def test_memory_of_a_film_is_that_of_its_planes(
    width: int, planes: int, measured_gib: float
) -> None:
    """Measured with `csf` and `macbeth` (tests/benchmarks); more planes lie in files."""
    gib = film_memory_bytes(width**2, planes) / (1 << 30)
    assert 0.9 * measured_gib < gib < 2.1 * measured_gib
    assert film_memory_bytes(width**2, 100 * planes) / (1 << 30) < gib + 1.1
