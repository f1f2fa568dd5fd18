"""The plan: its decisions, its bound against the difference between pruned and full renders, and
its film.
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.edits import decision, edited, load
from scipy.stats import t as student

import pixsim
from pixsim import optics
from pixsim.base.arrays import Array
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.thin_lens import field_factor
from pixsim.scene.film import (
    BLOCK,
    MAX_ACROSS,
    MAX_BYTES,
    PATH_SAMPLES,
    film_bytes,
    film_memory_bytes,
    fitting_width,
    largest_film,
)
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import UNIFORM_RESOLUTION, make_plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.integration import ideal_rate, integrate_pixels
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display

PIXELS = [pixsim.Pixel(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.8)]
# Elsewhere: tests/references compares the pictures of csf, test_scenes the patches under smooth
# lamps, flat has one luminance.
CASES = {
    "target": ("target", {}),
    "macbeth laser": ("macbeth", {"lamp": "spectra/laser_532nm.spd"}),
}
# Samples and renders of the pruned and the full side, for a noise below 1 %
SPP = (16, 4)
RENDERS = (6, 5)
FILM = 24


# --- The bound ---


def places(rate: np.ndarray, name: str) -> np.ndarray:
    """Return the means of parts of a picture: of macbeth the centres of its 24 patches."""
    if name != "macbeth":
        return rate.reshape(4, FILM // 4, 4, FILM // 4).mean(axis=(1, 3)).ravel()
    rows, columns = (
        [slice(*np.rint((i + np.array([0.3, 0.7])) * FILM / n).astype(int)) for i in range(n)]
        for n in (4, 6)
    )
    return np.array([rate[row, column].mean() for row in rows for column in columns])


def sampled(case: str, full: bool) -> tuple[np.ndarray, float]:
    """Return mean electrons of independent renders, (renders, places × pixels), and the bound of
    the plan.
    """
    name, parameters = CASES[case]
    scene = load(name, resolution=FILM, spp=SPP[full], **parameters)
    plan = make_plan(scene, full=full)
    renderer = Renderer(scene, scene.camera(), plan, seed=1)
    renders = []
    for index in range(RENDERS[full]):
        image = renderer.image(*renderer.run(index))
        rates = [places(ideal_rate(image, derive(pixel)), name) for pixel in PIXELS]
        renders.append(np.concatenate(rates))
    return np.array(renders), plan.bound_e


@pytest.mark.parametrize("case", CASES)
def test_pruned_and_full_plans_agree_within_their_bound(case: str) -> None:
    # Student's t of each place, false alarm 1e-3 in total. An error of 1 % would be noticed at most
    # of the places.
    (pruned_e, pruned_bound_e), (full_e, full_bound_e) = (
        sampled(case, full) for full in (False, True)
    )
    mean_e = full_e.mean(axis=0)
    variances = [side.var(axis=0, ddof=1) / len(side) for side in (pruned_e, full_e)]
    total = sum(variances)
    freedom = sum(
        variance**2 / (len(side) - 1)
        for variance, side in zip(variances, (pruned_e, full_e), strict=True)
    )
    level = 1 - (1 - 1e-3) ** (1 / mean_e.size)
    quantile = student.ppf(1 - level / 2, np.maximum(total**2 / np.maximum(freedom, 1e-300), 1.0))
    float32 = 1e-6
    allowed = pruned_bound_e + full_bound_e + float32 + quantile * np.sqrt(total) / mean_e
    ratio = pruned_e.mean(axis=0) / mean_e
    np.testing.assert_array_less(np.abs(ratio - 1), allowed)
    for wrong in (1.01, 0.99):
        assert np.mean(np.abs(ratio * wrong - 1) > allowed) > 0.5


@pytest.mark.parametrize("name", packaged_scenes())
def test_bound_of_a_plan_is_within_its_tolerance(name: str) -> None:
    """A smaller one needs more passes and bands; the decisions have their bounds and reasons."""
    scene = load(name, resolution=64)
    counts = []
    for tolerance_e in (1e-2, 1e-4):
        plan = make_plan(scene, tolerance_e=tolerance_e)
        bounds_e = [line.bound_e for line in plan.decisions]
        assert (min(bounds_e), plan.warnings) == (0, ())
        assert sum(bounds_e) == plan.bound_e <= tolerance_e
        counts.append((plan.light.passes, plan.light.bands.width_nm.size))
        for line in plan.decisions:
            assert (bool(line.saved), bool(line.reason)) == (not line.kept, True), line
    np.testing.assert_array_equal(np.sort(counts, axis=0), counts)
    assert (counts[-1] > counts[0]) == (
        name in ("macbeth", "still_life", "line_lamp", "cornell_box", "yard")
    )


def test_unreachable_tolerance_warns() -> None:
    plan = make_plan(load("still_life"), tolerance_e=1e-6)
    (note,) = plan.warnings
    assert f"{plan.bound_e:.1e}" in note
    assert plan.bound_e > 1e-6


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("name", ["csf", "macbeth"])
def test_plan_as_a_dict_is_json_of_its_passes_and_bands(name: str, full: bool) -> None:
    plan = make_plan(load(name, resolution=64), full=full)
    table = plan.as_dict()
    assert json.loads(json.dumps(table, allow_nan=False)) == table
    assert sum(table["band_width_nm"]) == pytest.approx(470)
    passes = sum(len(light.fit.passes) for light in plan.light.lamps)
    assert table["passes"] == passes <= table["passes_full"]
    assert f"{passes} of {table['passes_full']} passes" in repr(plan)


# --- Decisions ---


@pytest.mark.parametrize("focal_length_mm", [3.86, 2.0])
def test_coarse_film_of_a_flat_field_keeps_the_fall_off(focal_length_mm: float) -> None:
    """Mean electrons of every pixel from 64 and from 1024 samples across, with the closed form of
    the fall-off. Where that is too much, the film stays as it is.
    """
    camera = pixsim.Camera(focal_length_mm=focal_length_mm)
    lens = (camera.image_distance_mm, camera.f_number, camera.magnification)
    coarse, fine = (
        integrate_pixels(
            optics.field_factor((n, n), 1e3 * camera.die_mm / n, *lens),
            1e3 * camera.die_mm / n,
            53.0,
            40.0,
        )
        for n in (UNIFORM_RESOLUTION, 1024)
    )
    bound_e = decision(make_plan(load("flat"), camera), "oversampling").bound_e
    assert 0.5 * bound_e < np.abs(coarse / fine - 1).max() < bound_e
    assert make_plan(load("flat"), camera, tolerance_e=1e-5).film.resolution is None


SLOW_LENS = pixsim.Camera(f_number=45.0)
BARE = pixsim.Pixel(pitch_um=10.0, stack={"height_um": 8.0, "index": 1.5, "shift": "optimal"})


@pytest.mark.parametrize(
    ("camera", "options", "is_computed"),
    [
        (SLOW_LENS, {}, False),
        (pixsim.Camera(f_number=1.4), {}, True),
        (SLOW_LENS, {"tolerance_e": 1e-5}, True),
    ],
)
def test_stack_is_left_out_where_it_is_one_scale_and_the_evaluation_does_it(
    camera: pixsim.Camera, options: dict[str, Any], is_computed: bool
) -> None:
    """Behind a slow lens, whose narrow cones of light meet photodiodes alike everywhere."""
    plan = make_plan(load("csf", resolution=32), camera, BARE, **options)
    line = decision(plan, "pixel stack")
    assert (line.kept, line.bound_e == 0) == (is_computed, is_computed)
    image = pixsim.render(load("csf", resolution=32), camera, plan=plan)
    assert image.header["spare_e"] == plan.spare_e
    chain = imaging_chain(image, camera, BARE, pixsim.Exposure(), pixsim.Display())
    assert chain.collection is not None
    assert chain.collection.is_scale != is_computed


@pytest.mark.parametrize(
    ("exposure", "words"),
    [
        (pixsim.Exposure(), "in 0.1 s (86 %"),
        (pixsim.Exposure(max_integration_s=1.0), "in 1 s (83 %"),
        (pixsim.Exposure(integration_s=3600), "in 3600 s (73 %"),
    ],
)
def test_saturation_is_that_of_the_longest_exposure(exposure: pixsim.Exposure, words: str) -> None:
    plan = make_plan(load("flat"), pixel=pixsim.Pixel(well_limit="diode"), exposure=exposure)
    assert words in decision(plan, "saturation").reason


# --- The film ---


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
    # Every border is lit: the darkest texel of the charts has 2.4 % of the brightest.
    picture = chart_on(name, PORTRAIT)
    for border in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert border.min() > 0.02
    chart = make_render_plan(load(name).with_resolution(96), PORTRAIT).film.chart
    assert (chart is None) == (name == "siemens_star")  # its texture goes on beyond its border


def test_siemens_star_is_round_and_whole() -> None:
    # Its disc has 90 % of the shorter side, r/2 along each axis, and half of it is dark.
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


def test_film_of_paths_stays_within_the_samples() -> None:
    # Two renders of the film that is chosen. It may be narrower by an eighth to end where the die
    # ends, (8/9)² = 0.79, and its width is a multiple of 4.
    camera = Camera(die_mm=10.0, die_height_mm=5.0)
    plan = make_plan(load("still_life"), camera, Pixel(pitch_um=6.5), display=Display(dots=2048))
    cells = plan.film.resolution**2 * 5.0 / 10
    samples = 2 * cells * plan.samples.spp * plan.light.passes
    assert 0.78 * PATH_SAMPLES < samples <= 1.01 * PATH_SAMPLES


@pytest.mark.parametrize(
    ("width", "planes", "measured_gib"), [(512, 1, 0.41), (8192, 1, 1.31), (8192, 12, 1.68)]
)
def test_memory_of_a_film_is_that_of_its_planes(
    width: int, planes: int, measured_gib: float
) -> None:
    # Measured with `csf` and `macbeth`; more planes lie in files.
    gib = film_memory_bytes(width**2, planes) / (1 << 30)
    assert 0.9 * measured_gib < gib < 2.1 * measured_gib
    assert film_memory_bytes(width**2, 100 * planes) / (1 << 30) < gib + 1.1
