"""Scenes through real lenses, and out of focus: what the plan leaves out, light and blur of the
picture, light from beyond it, depths in closed form, and what a user is told.
"""

import math
import pickle
import warnings
from dataclasses import asdict, replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from helpers.edits import VARIANT, decision, lens_xml, scene_file, sensor_xml

import pixsim
from pixsim.base.arrays import Array
from pixsim.base.toml import packaged_tables
from pixsim.light.exr import read_channels, read_exr, write_channels, write_exr
from pixsim.light.spectral import RINGS, SpectralImage, photons_per_joule
from pixsim.light.stored import PictureFile
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Tiling,
    _chosen_tiling,
    _TestPoints,
    choose_tiling,
    tiling_key,
    traced_lens,
    without_lens,
)
from pixsim.optics.lens_defocus import DEPTHS, depth_of_disc_m, finite_or_none, signed_disc_um
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.real_lens import SEEN_NM, real_lens_warnings
from pixsim.scene.renderer import Renderer, mirror_margins
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import diffracted_rate, ideal_rate
from pixsim.sensor.pixel_notes import focus_notes

PIXEL = pixsim.Pixel(pitch_um=6.5)
Rendered = tuple[Scene, Camera, Plan, SpectralImage]
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
    loaded = pixsim.load_scene(scene, resolution=resolution, variant=VARIANT)
    die = CameraOptions(die_mm=die_mm, **({"object_distance_m": distance_m} if distance_m else {}))
    return loaded, loaded.camera(die, LensOptions(file=lens, **options))


@pytest.fixture(scope="module")
def singlet() -> Rendered:
    scene, camera = through("singlet", 6.0)
    # The plan's own PSFs, on a third as many tiles, and without the time of its choice
    tiling = Tiling(1500.0, 437.5, 0.021, cut_error=0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: tiling)
        plan = make_render_plan(scene, camera, PIXEL)
    return scene, camera, plan, pixsim.render(scene, camera, plan=plan)


def test_plan_states_the_tiles_and_their_error(singlet: Rendered) -> None:
    """The header says of RINGS that what the distortion's spline rings below zero is no error."""
    _, camera, plan, image = singlet
    assert decision(plan, "real lens").kept
    assert image.header[LENS_HEADER]["error"] == plan.film.tiling.error
    assert image.header[RINGS]
    assert pixsim.Camera(**image.header["camera"]) == camera


def test_corners_are_blurred_more_than_the_middle(singlet: Rendered) -> None:
    # By traced rays within cells of 62.5 µm white noise keeps 43 % of its contrast in the corners
    # and 90 % in the middle: 0.48 times as much. The lens changes by a quarter over 16 cells.
    _, camera, _, image = singlet
    noise = 1 + 0.3 * np.random.default_rng(0).standard_normal(image.planes.shape)
    rate = diffracted_rate(image.with_planes(noise), camera, pixsim.derive(PIXEL))
    corners = [rate[rows, columns] for rows in np.s_[:16, -16:] for columns in np.s_[:16, -16:]]
    middle, *others = (part.std() / part.mean() for part in (rate[32:64, 32:64], *corners))
    assert np.mean(others) / middle == pytest.approx(0.48, rel=0.25)


def test_films_with_two_samples_across_a_photodiode_have_one_tiling() -> None:
    """Photodiodes average what finer films add."""
    scene, camera = through("cooke_triplet", 0.5, 64)
    camera = camera.model_copy(update={"die_mm": 0.1, "die_height_mm": 0.1})
    assert pixsim.derive(PIXEL).aperture_side_um / 2 >= 100 / 64
    tilings = [
        make_render_plan(scene.with_resolution(across), camera, PIXEL, tolerance_e=3e-3).film.tiling
        for across in (64, 128)
    ]
    assert tilings[0] == tilings[1]
    assert 0 < tilings[0].cut_error <= tilings[0].error < 1


@pytest.mark.parametrize(
    "lens",
    [
        "double_gauss",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("cooke_triplet", "phone", "singlet")),
    ],
)
def test_shipped_tiling_is_that_of_the_search(lens: str) -> None:
    """`tests/benchmarks/lens_tilings.py` writes it again. Other processors round otherwise."""
    scene = pixsim.load_scene("csf", variant=VARIANT)
    with mock.patch("pixsim.scene.real_lens.choose_tiling", side_effect=choose_tiling) as chosen:
        pixsim.make_plan(scene, scene.camera(None, LensOptions(file=lens)))
    *film, nm, weight, aperture_um, tolerance = chosen.call_args.args
    points = _TestPoints(*film, np.array(nm), np.array(weight), aperture_um)
    shipped = packaged_tables("lens_tilings")[tiling_key(*chosen.call_args.args)]
    assert asdict(_chosen_tiling(points, tolerance)) == pytest.approx(shipped, rel=1e-6)


def test_picture_has_the_traced_fall_off_and_the_glass_is_not_counted_twice() -> None:
    """A uniform scene has nothing to blur but its fall-off."""
    scene, camera = through("double_gauss", 24.0, 33, "flat")
    image = pixsim.render(scene, camera, plan=make_render_plan(scene, camera, PIXEL))
    lens = traced_lens(camera.lens, camera.object_distance_m)
    field = lens.field_of_height(math.hypot(16, 16) * 24.0 / 33, lens.primary_nm)
    corner = image.planes[0, 0, 0] / image.planes[0, 16, 16]
    assert corner == pytest.approx(float(lens.relative_illumination(field)), rel=1e-3)
    rate = diffracted_rate(image, camera, pixsim.derive(PIXEL))
    np.testing.assert_allclose(rate, ideal_rate(image, pixsim.derive(PIXEL)), rtol=0.02)


def test_a_thin_enough_lens_is_left_out_and_the_picture_is_the_thin_lens_s_bit_for_bit(
    thin_file: str,
) -> None:
    scene, camera = through(thin_file, 0.1, 32, focal_length_mm=10.0)
    plan = make_render_plan(scene, camera, PIXEL)
    line = decision(plan, "real lens")
    assert (line.kept, 0 < line.bound_e < 5e-4) == (False, True)
    thin = without_lens(camera)
    assert (thin.focal_length_mm, thin.f_number) == (camera.focal_length_mm, camera.f_number)
    image = pixsim.render(scene, camera, plan=plan)
    other = pixsim.render(scene, thin, plan=make_render_plan(scene, thin, PIXEL))
    np.testing.assert_array_equal(image.planes, other.planes)
    assert not {LENS_HEADER, RINGS} & image.header.keys()


def test_thin_real_lens_has_the_absolute_irradiance_of_foote_times_its_transmittance(
    thin_file: str,
) -> None:
    # From the axis to 20 degrees, of a luminance that is known: traced, rendered and weighted as
    # any real lens; the bands of D65 cost 2e-3 in luminance.
    scene = pixsim.load_scene("flat", resolution=33, luminance_cd_per_m2=1000)
    lens = LensOptions(file=thin_file, focal_length_mm=10.0)
    camera = scene.camera(CameraOptions(die_mm=5.2, transmittance=0.8), lens)
    plan = make_render_plan(scene, camera, PIXEL, exact=True)
    plan = replace(plan, film=replace(plan.film, tiling=Tiling(2000.0, 0.0, 0.0)))
    lx = pixsim.render(scene, camera, plan=plan).illuminance_lx()
    y, x = (np.indices(lx.shape) - 16) * 5.2 / 33
    tangent = np.hypot(x, y) / camera.image_distance_mm
    assert tangent.max() == pytest.approx(math.tan(math.radians(20)), rel=0.05)
    factor = pixsim.optics.irradiance_factor(camera.f_number, tangent, camera.magnification)
    ratio = lx / (0.8 * 1000 * factor)
    np.testing.assert_allclose(ratio / ratio[16, 16], 1, rtol=1e-4)
    assert ratio[16, 16] == pytest.approx(1, rel=2e-3)


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("is_deep", [False, True])
def test_plan_says_that_the_error_out_of_focus_is_not_known(
    is_deep: bool, full: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a scene with depth, and not of a chart in focus."""
    # Plans take a moment where their tiles do not matter.
    monkeypatch.setattr(
        "pixsim.scene.real_lens.choose_tiling", lambda *_: Tiling(500.0, 20.0, 0.005)
    )
    deep = scene_file(tmp_path, sensor_xml(lens_xml(40, 0.001, 0.1)), DEEP)
    scene = pixsim.load_scene(deep) if is_deep else pixsim.load_scene("csf", resolution=32)
    camera = scene.camera(CameraOptions(die_mm=4.8), LensOptions(file="singlet"))
    plan = make_render_plan(scene, camera, PIXEL, full=full)
    assert ("defocus of the lens" in [line.subject for line in plan.decisions]) == is_deep
    assert any("its error is not known" in note for note in plan.warnings) == is_deep


def test_light_that_does_not_fit_a_film_cell_is_said() -> None:
    """Rays of a singlet at f/5 and 96 mm miss by half a millimetre: more than cells of 250 µm, on
    which no waves are followed.
    """
    scene, camera = through("singlet", 24.0, 96, "flat", refocus="paraxial")
    plan = make_render_plan(scene, camera, PIXEL)
    assert plan.film.tiling.psf_um == 0
    lens = traced_lens(camera.lens, camera.object_distance_m)
    y, x = np.indices((41, 41)) / 20 - 1
    inside = np.hypot(x, y) <= 1
    light = pixsim.derive(PIXEL).quantum_efficiency(SEEN_NM) * photons_per_joule(SEEN_NM)
    field = lens.field_of_height(0.97 * math.hypot(12, 12), lens.primary_nm)
    nm = np.average(SEEN_NM, weights=light)
    waves = lens.wavefront(np.array([field]), np.array([nm]), x[inside], y[inside])
    miss_mm = np.maximum(np.abs(waves.x_mm[0]), np.abs(waves.y_mm[0]))
    assert plan.film.tiling.lacking == pytest.approx((miss_mm > 0.125).mean(), abs=0.1)
    assert any("Use a finer film" in note for note in plan.warnings)


@pytest.mark.parametrize(("error", "count"), [(0.1, 1), (0.01, 0)])
def test_error_of_a_blur_is_said_above_its_tolerance(
    error: float, count: int, singlet: Rendered
) -> None:
    tiling = replace(singlet[2].film.tiling, psf_um=445.0, error=error, lacking=0.5)
    notes = real_lens_warnings(singlet[1], tiling, 1e-3)
    assert sum("445 µm lack up to 50.0 %" in note for note in notes) == count


@pytest.fixture
def thin_file(tmp_path: Path) -> str:
    (tmp_path / "thin.toml").write_text(THIN, encoding="utf-8")
    return str(tmp_path / "thin.toml")


DEEP = """<emitter type="constant"/>
    <shape type="sphere"><point name="center" x="0" y="0" z="0.08"/><float name="radius" value="0.0002"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate y="1" angle="180"/>
        <translate z="0.2"/></transform></shape>"""
CHART = """<integrator type="path"/><shape type="rectangle">
    <transform name="to_world"><scale value="HALF"/><rotate y="1" angle="180"/><translate z="1"/></transform>
    <emitter type="area"><texture type="bitmap" name="radiance">
        <string name="filename" value="chart.exr"/><boolean name="raw" value="true"/>
    </texture></emitter></shape>"""
BALL = """<shape type="sphere"><point name="center" x="0.2" y="0" z="0.9"/><float name="radius" value="0.001"/></shape>
    <emitter type="constant"><spectrum name="radiance" value="0.1"/></emitter>"""
CELLS, LARGER, DIE_MM = 48, 72, 0.48  # cells of the picture and of a larger one, of the same pitch
TILING = Tiling(120.0, 210.0, 0.0)
SINGLET = LensOptions(file="singlet", focal_length_mm=12.0)
ENDS_M = 0.0217  # half a chart that ends in the margin: 1.1 of the view at 1 m


@pytest.fixture
def margin_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: TILING)


def chart_scene(folder: Path, half_m: float, more: str = "") -> Scene:
    """A chart of random squares, much larger than the picture."""
    squares = np.kron(np.random.default_rng(2).uniform(0.1, 1.0, (40, 40)), np.ones((8, 8)))
    write_channels(folder / "chart.exr", {"Y": squares}, {})
    sensor = sensor_xml(lens_xml(5, 0.001, 1), size=(96, 96), spp=64)
    return pixsim.load_scene(scene_file(folder, sensor, CHART.replace("HALF", f"{half_m}"), more))


def rendered_cells(scene: Scene, cells: int, **options) -> tuple[SpectralImage, Camera, Plan]:
    """The light of a die of so many cells of 10 µm behind a lens of 12 mm."""
    scene = scene.with_resolution(cells)
    die = CameraOptions(die_mm=DIE_MM * cells / CELLS, object_distance_m=1.0)
    camera = scene.camera(die, SINGLET)
    plan = make_render_plan(scene, camera, PIXEL, **options)
    return pixsim.render(scene, camera, plan=plan), camera, plan


def ring(rate: Array, cells: int = 6) -> Array:
    """Return the values within some cells of the border."""
    inner = np.zeros(np.array(rate.shape) - 2 * cells, bool)
    return rate[np.pad(inner, cells, constant_values=True)]


@pytest.mark.usefixtures("margin_tiles")
@pytest.mark.parametrize("more", ["", BALL], ids=["exact cells of a chart", "samples"])
def test_border_is_that_of_a_larger_picture(tmp_path: Path, more: str) -> None:
    """Blurred with all that lies beyond it, the larger picture is brute force for the smaller one,
    up to its border; each film has its widening.
    """
    scene = chart_scene(tmp_path, 0.1, more)
    image, camera, plan = rendered_cells(scene, CELLS, exact=not more)
    larger, wide, _ = rendered_cells(scene, LARGER, exact=not more)
    assert plan.film.ends == (False, False)
    assert image.margin >= TILING.cells(image.pitch_um)[1] // 2

    middle = slice((LARGER - CELLS) // 2, (LARGER + CELLS) // 2)
    expected = diffracted_rate(larger, wide, pixsim.derive(PIXEL))[middle, middle]
    error, error_reflected = (
        rms(ring(diffracted_rate(light, camera, pixsim.derive(PIXEL)) - expected))
        for light in (image, image.with_planes(np.array(image.planes)))
    )
    assert error < 0.02 * expected.std()
    assert error_reflected > 5 * error


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.usefixtures("margin_tiles")
@pytest.mark.parametrize(("half_m", "noise_bound"), [(None, 5e-3), (ENDS_M, 2e-2)])
def test_border_by_texels_is_that_by_samples(
    half_m: float | None, noise_bound: float, tmp_path: Path
) -> None:
    """1000 cells of a chart that ends with the film, and of one that ends in its margin, at 1.1 of
    the view: rms error over the contrast.
    """
    scene = chart_scene(tmp_path, half_m) if half_m else pixsim.load_scene("csf")
    image, camera, plan = rendered_cells(scene, CELLS, exact=True)
    assert plan.film.ends == (half_m is None,) * 2  # else the margin is black, as samples have it
    assert image.margin == 12  # the reach of 21 cells, in blocks of 4
    exact = diffracted_rate(image, camera, pixsim.derive(PIXEL))
    plan = replace(plan, samples=replace(plan.samples, exact=False, spp=64))
    images = [
        pixsim.render(scene.with_resolution(CELLS), camera, seed, plan=plan) for seed in (0, 1)
    ]
    first, second = (diffracted_rate(sampled, camera, pixsim.derive(PIXEL)) for sampled in images)
    noise = rms(ring(first - second)) / np.sqrt(2)
    assert noise < noise_bound * exact.std()
    assert rms([ring(first - exact), ring(second - exact)]) == pytest.approx(noise, rel=0.15)


@pytest.mark.usefixtures("margin_tiles")
def test_a_chart_that_ends_with_the_film_goes_on_as_its_mirror_image() -> None:
    """A chart is the picture: its end is no edge of the scene, and does not darken the border."""
    image, camera, plan = rendered_cells(pixsim.load_scene("flat"), CELLS, exact=True)
    assert plan.film.ends == (True, True)
    row = diffracted_rate(image, camera, pixsim.derive(PIXEL))[CELLS // 2]
    assert row[:3].mean() / row[8:11].mean() == pytest.approx(1, abs=0.02)  # the lens's fall-off


@pytest.mark.usefixtures("margin_tiles")
@pytest.mark.parametrize(
    ("lens", "height_mm", "ends", "margin"),
    [
        (SINGLET, None, (True, True), 8),  # no more than half of the picture
        (SINGLET, 0.32, (False, True), 8),
        (None, None, (True, True), 0),
    ],
)
def test_sides_at_which_a_scene_ends_are_found_one_by_one(
    lens: LensOptions | None, height_mm: float | None, ends: tuple[bool, bool], margin: int
) -> None:
    """The chart of the slanted edge is a square; a thin lens needs no margin."""
    scene = pixsim.load_scene("slanted_edge", resolution=CELLS)
    camera = scene.camera(CameraOptions(die_mm=DIE_MM, die_height_mm=height_mm), lens)
    film = make_render_plan(scene, camera, PIXEL).film
    assert lens is None or film.ends == ends
    assert film.margin((16, 16), 10.0) == margin


@pytest.mark.parametrize("ends", [(True, True), (False, True), (True, False), (False, False)])
def test_margins_are_mirrored_where_a_scene_ends(ends: tuple[bool, bool]) -> None:
    picture = np.random.default_rng(0).random((12, 10, 2))
    rows, columns = (slice(3, -3) if end else slice(None) for end in ends)
    padding = [(3 * end, 3 * end) for end in (*ends, False)]
    expected = np.pad(picture[rows, columns], padding, "symmetric")
    mirror_margins(picture, 3, ends)
    np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize("factored", [True, False])
def test_margins_are_beside_the_picture_and_survive_files_and_copies(
    factored: bool, tmp_path: Path
) -> None:
    pictures = np.random.default_rng(4).random((2, 24, 32)).astype(np.float32)
    spectra = np.array([[1.0, 2.0, 0.5], [0.2, 0.1, 0.3]])
    data = np.moveaxis(pictures, 0, 2) @ spectra
    light: dict = {"factors": (spectra, pictures)} if factored else {"data": data}
    image = SpectralImage([450.0, 550.0, 650.0], 100.0, 5.0, margin=4, **light)
    path = tmp_path / "light.exr"
    write_exr(path, image)
    stored = PictureFile(tmp_path).stored(image)
    pickled = pickle.loads(pickle.dumps(image))
    for copy in (image, read_exr(path), pickled, stored, stored.in_memory()):
        assert (copy.margin, copy.shape) == (4, (16, 24))
        np.testing.assert_allclose(copy.data, data[4:-4, 4:-4], rtol=1e-6)
        np.testing.assert_allclose(copy.whole.data, data, rtol=1e-6)

    header = read_channels(path)[1]
    windows = [np.ravel(header[name]).tolist() for name in ("displayWindow", "dataWindow")]
    assert windows == [[0, 0, 23, 15], [-4, -4, 27, 19]]


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
    scene = pixsim.load_scene(path, variant=variant, **parameters)
    return Renderer(scene, scene.camera(), make_render_plan(scene, full=True), 0)


def test_depths_of_a_tilted_plane_are_those_of_its_equation(tmp_path: Path) -> None:
    """A ray of slope t along x meets a plane that is turned by θ about the vertical at 0.3 m / (1 ±
    t tan θ).
    """
    renderer = renderer_of(plane_file(tmp_path), degrees=30.0)
    depths_m = InProcessTracer(renderer.job).depths(8)[:, :, 0]
    slopes = HALF_M / 0.3 * (2 * (np.arange(8) + 0.5) / 8 - 1)
    expected_m = np.sort(0.3 / (1 + slopes * math.tan(math.radians(30.0))))
    np.testing.assert_allclose(np.sort(depths_m, axis=1), [expected_m] * 8, rtol=1e-5)  # float32


@pytest.mark.parametrize("variant", [VARIANT, None])
@pytest.mark.parametrize("tracer", [InProcessTracer, ChildTracer])
def test_depths_are_infinite_beyond_shapes_and_unknown_behind_glass(
    tracer: type[InProcessTracer | ChildTracer], variant: str | None, tmp_path: Path
) -> None:
    """The plane fills the middle half of the picture, and glass its middle: what lies behind it may
    be in focus.
    """
    glass = GLASS.replace("0.02", str(HALF_M / 6))
    renderer = renderer_of(plane_file(tmp_path, glass), variant, half_width=HALF_M / 2)
    expected_m = [math.inf, math.inf, 0.3, math.nan, math.nan, 0.3, math.inf, math.inf]
    np.testing.assert_allclose(tracer(renderer.job).depths(8)[4, :, 0], expected_m, rtol=1e-6)
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
@pytest.mark.parametrize(("side_um", "count"), [(-5.97, 0), (-6.03, 1), (5.97, 0), (6.03, 1)])
def test_note_begins_where_the_least_disc_is_two_pixels(
    side_um: float, count: int, lens: LensOptions | None, tmp_path: Path
) -> None:
    """With foreground and background further off; and not where depths are not known."""
    scene = pixsim.load_scene(plane_file(tmp_path), variant=VARIANT)
    camera = scene.camera(CameraOptions(die_mm=2.0, f_number=8.0), lens)
    sharpest_m = depth_of_disc_m(camera, side_um)
    assert signed_disc_um(camera, sharpest_m) == pytest.approx(side_um, rel=1e-9)
    assert len(focus_notes(3.0, camera, light_of([0.2, sharpest_m, math.inf]))) == count
    assert not focus_notes(3.0, camera, light_of([]))


@pytest.mark.parametrize(
    ("focus_m", "distance_m", "count"), [(0.3, None, 0), (0.3, 0.4, 1), (300.0, None, 1)]
)
def test_scene_out_of_focus_is_said(
    focus_m: float, distance_m: float | None, count: int, tmp_path: Path
) -> None:
    """By an option, or by an XML in mm."""
    scene = pixsim.load_scene(plane_file(tmp_path, focus_m=focus_m), variant=VARIANT)
    camera = scene.camera(CameraOptions(object_distance_m=distance_m))
    light = pixsim.render(scene, camera)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pixsim.evaluate(light, camera, pixsim.Pixel(pitch_um=8.0))
    notes = [str(warning.message) for warning in caught]
    assert sum("scene is at 0.3 m" in note for note in notes) == count
