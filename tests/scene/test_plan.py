"""The plan: its bound against the difference between pruned and full renders, its film, and its rules
by edits of packaged scenes, closed forms and real renders.
"""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.edits import END, decision, edited, left_out, lens_sr, load, render_plan
from scipy.ndimage import map_coordinates
from scipy.special import j1
from scipy.stats import ttest_ind

import pixsim
from pixsim.base.arrays import Array
from pixsim.light.exr import write_channels
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.thin_lens import field_factor
from pixsim.scene import rules
from pixsim.scene.contents import blur_um
from pixsim.scene.film import (
    BLOCK,
    MAX_ACROSS,
    MAX_BYTES,
    PATH_SAMPLES,
    film_bytes,
    fitting_width,
    largest_film,
)
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import UNIFORM_RESOLUTION, Plan, make_plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.integration import ideal_rate, integrate_pixels

PIXELS = [pixsim.Pixel(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.8)]
# Elsewhere: tests/references compares the pictures of csf, and the patches under smooth
# lamps, flat has one luminance.
CASES = {
    "target": ("target", {}),
    "macbeth laser": ("macbeth", {"lamp": "spectra/laser_532nm.spd"}),
}
# Samples and renders of the pruned and the full side, for a noise below 1 %
SPP = (16, 4)
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
    for index in range((6, 5)[full]):
        image = renderer.image(*renderer.run(index))
        rates = [places(ideal_rate(image, pixsim.derive(pixel)), name) for pixel in PIXELS]
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
    ratio = pruned_e.mean(axis=0) / mean_e
    test = ttest_ind(pruned_e, full_e, equal_var=False)
    low_e, high_e = test.confidence_interval((1 - 1e-3) ** (1 / mean_e.size))
    float32 = 1e-6
    allowed = pruned_bound_e + full_bound_e + float32 + (high_e - low_e) / 2 / mean_e
    np.testing.assert_array_less(np.abs(ratio - 1), allowed)
    for wrong in (1.01, 0.99):
        assert np.mean(np.abs(ratio * wrong - 1) > allowed) > 0.5


@cache
def plan_of(name: str, tolerance_e: float) -> Plan:
    return make_plan(load(name, resolution=64), tolerance_e=tolerance_e)


@pytest.mark.parametrize("name", packaged_scenes())
@pytest.mark.parametrize("tolerance_e", [1e-2, 1e-4])
def test_bound_of_a_plan_is_within_its_tolerance(tolerance_e: float, name: str) -> None:
    """The decisions have their bounds and reasons."""
    plan = plan_of(name, tolerance_e)
    bounds_e = [line.bound_e for line in plan.decisions]
    assert (min(bounds_e), plan.warnings) == (0, ())
    assert sum(bounds_e) == plan.bound_e <= tolerance_e
    for line in plan.decisions:
        assert (bool(line.saved), bool(line.reason)) == (not line.kept, True), line


@pytest.mark.parametrize("name", ["macbeth", "still_life", "line_lamp", "cornell_box", "yard"])
def test_a_smaller_tolerance_needs_more_passes_or_bands(name: str) -> None:
    loose, tight = (plan_of(name, tolerance_e).light for tolerance_e in (1e-2, 1e-4))
    assert tight.passes >= loose.passes
    assert tight.bands.width_nm.size >= loose.bands.width_nm.size
    assert tight.passes + tight.bands.width_nm.size > loose.passes + loose.bands.width_nm.size


def test_unreachable_tolerance_warns() -> None:
    plan = make_plan(load("still_life"), tolerance_e=1e-6)
    assert plan.bound_e > 1e-6
    assert [f"{plan.bound_e:.1e}" in note for note in plan.warnings] == [True]


# --- Decisions ---


@pytest.mark.parametrize("focal_length_mm", [3.86, 2.0])
def test_coarse_film_of_a_flat_field_keeps_the_fall_off(focal_length_mm: float) -> None:
    """Mean electrons of every pixel from 64 and from 1024 samples across, with the closed form of
    the fall-off. Where that is too much, the film stays as it is.
    """
    camera = pixsim.Camera(focal_length_mm=focal_length_mm)
    lens = (camera.image_distance_mm, camera.f_number, camera.magnification)
    coarse, fine = (
        integrate_pixels(field_factor((n, n), pitch_um, *lens), pitch_um, 53.0, 40.0)
        for n in (UNIFORM_RESOLUTION, 1024)
        for pitch_um in [1e3 * camera.die_mm / n]
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
    camera: pixsim.Camera, options: dict, is_computed: bool
) -> None:
    """Behind a slow lens, whose narrow cones of light meet photodiodes alike everywhere."""
    plan = make_plan(load("csf", resolution=32), camera, BARE, **options)
    line = decision(plan, "pixel stack")
    assert (line.kept, line.bound_e == 0) == (is_computed, is_computed)
    image = pixsim.render(load("csf", resolution=32), camera, plan=plan)
    assert image.header["spare_e"] == plan.spare_e
    chain = imaging_chain(image, camera, BARE, pixsim.Exposure(), pixsim.Display())
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

    wide = load(
        edited(tmp_path, "csf", ('name="height" value="$resolution"', 'name="height" value="256"'))
    )
    assert wide.camera().die_height_mm == pytest.approx(wide.camera().die_mm / 4)
    for scene, camera, shape in (
        (wide, Camera(), (256, 1024)),
        (wide.with_resolution(100), Camera(), (25, 100)),
        (wide, wide.camera(CameraOptions(die_height_mm=2.7136)), (1024, 1024)),
    ):
        assert scene.film_shape(camera, wide.parse()) == shape


@pytest.mark.parametrize("name", ["csf", "flat", "slanted_edge", "siemens_star"])
def test_packaged_charts_fill_a_die_of_any_shape(name: str) -> None:
    # Every border is lit: the darkest texel of the charts has 2.4 % of the brightest.
    picture = chart_on(name, PORTRAIT)
    assert min(picture[[0, -1]].min(), picture[:, [0, -1]].min()) > 0.02
    chart = make_render_plan(load(name).with_resolution(96), PORTRAIT).film.chart
    assert (chart is None) == (name == "siemens_star")  # its texture goes on beyond its border


@pytest.mark.parametrize("axis", [0, 1])
def test_siemens_star_is_round_and_whole(axis: int) -> None:
    # Its disc has 90 % of the shorter side, r/2 along each axis, and half of it is dark.
    dark = (1 - chart_on("siemens_star", LANDSCAPE, 192)) / (1 - 0.025)
    radius = 0.45 * min(dark.shape)
    assert dark.sum() == pytest.approx(math.pi * radius**2 / 2, rel=0.02)
    places = np.arange(dark.shape[axis]) + 0.5 - dark.shape[axis] / 2
    variance = np.average(places**2, weights=dark.sum(axis=1 - axis))
    assert math.sqrt(variance) == pytest.approx(radius / 2, rel=0.02)


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
@pytest.mark.parametrize("samples_per_pixel", [0.5, 0.8, 1, 2])
def test_fitting_width_ends_within_one_pixel_of_die(
    samples_per_pixel: float, columns: int, rows: int
) -> None:
    """The film covers the die, and no row of pixels more, for films of at least half a sample a
    pixel.
    """
    needed = min(columns * samples_per_pixel, MAX_ACROSS)
    width = fitting_width(rows / columns, columns * samples_per_pixel, MAX_ACROSS)
    assert needed * 0.85 <= width <= MAX_ACROSS
    height = math.ceil(width * rows / columns - 1e-6)
    assert rows <= height / width * columns * (1 + 1e-9) < rows + 1


@pytest.mark.parametrize(
    ("film", "parameters", "display", "is_refined"),
    [
        (None, {"resolution": 64}, pixsim.Display(dots=100), True),
        (None, {"resolution": 64}, None, False),
        (64, {"resolution": 64}, pixsim.Display(dots=100), False),
        (None, {"resolution": 2000}, pixsim.Display(dots=100), False),
    ],
)
def test_display_refines_the_film_of_an_unknown_scene(
    film: int | None, parameters: dict[str, int], display: pixsim.Display | None, is_refined: bool
) -> None:
    """Two samples for each half dot; not where the film is stated, is finer, or there is no
    display.
    """
    pixel = pixsim.Pixel(pitch_um=6.5)
    scene = load("line_lamp", **parameters)
    plan = make_plan(
        scene.with_resolution(film) if film else scene, Camera(), pixel, display=display
    )
    details = min(2 * 100, 2713.6 / pixsim.derive(pixel).photodiode_side_um)
    width = BLOCK * math.ceil(2 * details / BLOCK)
    assert plan.film.resolution == (width if is_refined else None)


def test_film_of_paths_stays_within_the_samples() -> None:
    # Four renders of the film that is chosen. It may be narrower by an eighth to end where the die
    # ends, (8/9)² = 0.79, and its width is a multiple of 4.
    camera = Camera(die_mm=10.0, die_height_mm=5.0)
    plan = make_plan(
        load("still_life"), camera, pixsim.Pixel(pitch_um=6.5), display=pixsim.Display(dots=2048)
    )
    cells = plan.film.resolution**2 * 5.0 / 10
    samples = 4 * cells * plan.samples.spp * plan.light.passes
    assert 0.78 * PATH_SAMPLES < samples <= 1.01 * PATH_SAMPLES


RULES = {"spectral rank", "bounces", "lens samples", "texture samples", "diffraction"}
HALF = 'x="$chart_half_width" y="$chart_half_height"'
AWAY = '<translate z="$focus_distance"/>'
SIDE = 'x="$chart_half_side" y="$chart_half_side"'  # of the slanted edge
PATH = '<integrator type="path"/>'
DEPTH = '<integer name="max_depth" value="2"/>'
BSDF = (
    '<bsdf type="diffuse">\n            <spectrum name="reflectance"'
    ' filename="spectra/macbeth/24_black_2.spd"/>'
)
NEUTRAL_LAMP = '<spectrum name="{}" value="360:1, 830:1"/>'


def bigger(times: float, half: str = HALF) -> tuple[str, str]:
    """Return an edit that makes the chart larger than the film."""
    return half, f'x="{0.350145791 * times}" y="{0.350145791 * times}"'


def shape(kind: str, transform: str, inside: str = "") -> tuple[str, str]:
    return (
        END,
        f'<shape type="{kind}"><transform name="to_world">{transform}</transform>{inside}</shape>',
    )


ALONE, DETAIL, MATT = (
    {"spectral rank", "bounces"},
    {"texture samples", "diffraction"},
    {"bounces", "lens samples"},
)
NEAR, FOG, BEHIND = (
    '<scale value="0.05"/><translate z="0.8"/>',
    '<scale value="0.1"/><translate z="0.8"/>',
    '<translate z="-0.1"/>',
)
BOTH_SIDES = [
    (BSDF, f'<bsdf type="twosided">{BSDF}'),
    ("</bsdf>\n    </shape>\n</scene>", "</bsdf></bsdf></shape></scene>"),
]
COLOURED = '<string name="filename" value="coloured.exr"/>'
SLIDE = f'<texture type="bitmap" name="texture">{COLOURED}</texture>'
INSIDE = """<bsdf type="null"/><medium type="homogeneous" name="interior">
    <rgb name="albedo" value="0.9, 0.2, 0.1"/></medium>"""


def shining(plugin: str, name: str = "radiance", more: str = "") -> str:
    return f'<emitter type="{plugin}">{NEUTRAL_LAMP.format(name)}{more}</emitter>'


# name: (scene, edits, the rules that must not fire)
NOT_APPLIED = {
    "chart out of focus": (
        "slanted_edge",
        [(AWAY, '<translate z="1.3"/>'), bigger(1.5, SIDE)],
        RULES - ALONE,
    ),
    "uniform chart out of focus": ("flat", [(AWAY, '<translate z="0.9"/>')], RULES - ALONE),
    "tilted chart": (
        "flat",
        [(AWAY, f'<rotate x="1" angle="20"/>{AWAY}'), bigger(1.5)],
        RULES - ALONE,
    ),
    "chart smaller than the film": ("flat", [bigger(0.9)], DETAIL),
    "chart beside the axis": (
        "slanted_edge",
        [bigger(2, SIDE), (AWAY, f'<translate x="0.3"/>{AWAY}')],
        DETAIL,
    ),
    "chart turned on its side": (
        "flat",
        [bigger(2), (AWAY, f'<rotate z="1" angle="30"/>{AWAY}')],
        DETAIL,
    ),
    "repeated picture": ("slanted_edge", [('<scale y="-1"/>', '<scale x="8" y="-1"/>')], DETAIL),
    "shifted picture": (
        "slanted_edge",
        [('<translate y="1"/>', '<translate x="0.4" y="1"/>')],
        DETAIL,
    ),
    "a sphere": ("macbeth", [shape("sphere", NEAR, '<bsdf type="diffuse"/>')], MATT),
    **{
        f"a patch of {bsdf}": ("macbeth", [(BSDF, f'<bsdf type="{bsdf}">')], MATT)
        for bsdf in ("conductor", "dielectric")
    },
    "a patch of principled": (
        "macbeth",
        [(BSDF, '<bsdf type="principled">')],
        MATT | {"spectral rank"},
    ),
    "an environment map": (
        "macbeth",
        [(END, f'<emitter type="envmap">{COLOURED}</emitter>')],
        {"lens samples"},
    ),
    "a sky": ("flat", [(END, '<emitter type="sunsky"/>')], DETAIL | {"lens samples"}),
    "a directional area lamp": (
        "macbeth",
        [shape("rectangle", "", shining("directionalarea"))],
        MATT,
    ),
    "an area lamp facing the board": (
        "macbeth",
        [shape("rectangle", BEHIND, shining("area"))],
        {"bounces"},
    ),
    "a board facing the board": ("macbeth", [shape("rectangle", BEHIND)], {"bounces"}),
    "a mirrored board facing the board": (
        "macbeth",
        [shape("disk", f'<scale x="-1"/>{BEHIND}')],
        {"bounces"},
    ),
    "a board that shows both sides": ("macbeth", BOTH_SIDES, {"bounces"}),
    "fog": (
        "macbeth",
        [(PATH, '<integrator type="volpath"/>'), shape("cube", FOG, INSIDE)],
        MATT | {"spectral rank"},
    ),
    "a spot with a coloured slide": (
        "macbeth",
        [(END, shining("spot", "intensity", SLIDE))],
        set(),
    ),
}


def loose_plan(path: Path | str) -> Plan:
    """Return a plan whose few bands take no time: where things stand decides."""
    return make_render_plan(load(path), pixel=pixsim.Pixel(), tolerance_e=1e-2)


packaged_plan = cache(loose_plan)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a picture whose left half is red and whose right half is blue.

    The tests share it: a spectrum is read once for each path.
    """
    folder = tmp_path_factory.mktemp("edited")
    left_share = np.repeat(np.array([[1, 0]], np.float32), 4, axis=1).repeat(8, axis=0)
    shares = {"R": left_share, "G": 0 * left_share, "B": 1 - left_share}
    planes = {name: 0.05 + np.float32(0.95) * share for name, share in shares.items()}
    write_channels(folder / "coloured.exr", planes, {})
    return folder


@pytest.mark.parametrize("name", NOT_APPLIED)
def test_plan_rules_do_not_apply(name: str, folder: Path) -> None:
    scene, edits, left_in = NOT_APPLIED[name]
    plan = loose_plan(edited(folder, scene, *edits))
    assert not left_out(plan) & left_in
    # The edit makes a difference.
    assert left_in - {"texture samples"} <= left_out(packaged_plan(scene)) | {"diffraction"}

    light, samples = plan.light, plan.samples
    done = {
        "lens samples": samples.lens == "thinlens",
        "bounces": samples.integrator is None,
        "diffraction": plan.film.diffraction,
        "spectral rank": light.passes == light.full_passes,
        "texture samples": samples.spp * light.passes >= samples.full_spp,
    }
    assert [rule for rule in left_in if not done[rule]] == []


# --- Rules that apply ---


SPHERE = '<scale value="0.02"/><translate z="0.8"/>'
LAMP = (
    '<emitter type="point"><point name="position" x="0" y="1" z="0"/><spectrum name="intensity"'
    ' filename="{}"/></emitter>'
)
GLOSSY = shape("sphere", SPHERE, '<bsdf type="roughconductor"/>')
PATH_1 = {"type": "path", "max_depth": 1}
MATT_RULES = RULES - {"diffraction", "texture samples"}


def with_integrator(plugin: str, inside: str = "") -> tuple[str, str]:
    return PATH, f'<integrator type="{plugin}">{inside}</integrator>'


# name: (scene, edits, parameters and width of the film, what the plan has)
APPLIED: dict[str, tuple[str, list[tuple[str, str]], dict, dict]] = {
    "a chart": ("slanted_edge", [], {}, {"left_out": MATT_RULES, "integrator": PATH_1, "lens": "perspective", "spp": 16}),
    "a uniform chart": ("flat", [], {}, {"left_out": RULES, "resolution": 64, "spp": 4, "diffraction": False}),
    "boards that face one way": ("macbeth", [], {}, {"left_out": MATT_RULES, "integrator": {"type": "direct"}, "bounded": True}),
    "a disc": ("flat", [('type="rectangle"', 'type="disk"')], {}, {"left_out": MATT_RULES, "resolution": None}),
    "one bounce": ("macbeth", [with_integrator("path", DEPTH), GLOSSY], {}, {"integrator": {"type": "direct"}}),
    "two bounces": ("macbeth", [with_integrator("path", DEPTH.replace("2", "3")), GLOSSY], {}, {"integrator": None}),
    "one lamp spectrum": ("macbeth", [(END, LAMP.format("$lamp"))], {}, {"lamps": 1}),
    "two lamp spectra": ("macbeth", [(END, LAMP.format("spectra/a.spd"))], {}, {"lamps": 2}),
    **{
        f"the scene's {plugin}": ("macbeth", [with_integrator(plugin)], {}, {"integrator": None})
        for plugin in ("volpath", "direct")
    },
    "no light": ("csf", [(DEPTH, DEPTH.replace("2", "0"))], {}, {"integrator": None}),
    "lamps alone": ("csf", [(DEPTH, DEPTH.replace("2", "1"))], {}, {"integrator": None}),
    "any depth": ("csf", [(DEPTH, DEPTH.replace("2", "-1"))], {}, {"integrator": PATH_1}),
    "hidden emitters": ("csf", [(DEPTH, (f'{DEPTH}<boolean name="hide_emitters" value="true"/>'))], {}, {"integrator": PATH_1 | {"hide_emitters": True}}),
    "stated samples": ("slanted_edge", [], {"spp": 9}, {"spp": 9, "full_spp": 9, "left_out": MATT_RULES}),
    "a stated film": ("flat", [], {"resolution": 128}, {"resolution": None}),
    "passes share samples": ("still_life", [], {}, {"spp": 16, "full_spp": 64, "sampler": "multijitter"}),
    "stated samples of paths": ("still_life", [], {"spp": 8}, {"spp": 8}),
    # With 4 samples multijitter would make paths up to 1 % too dark.
    "few samples of paths": ("still_life", [('name="spp" value="64"', 'name="spp" value="4"')], {}, {"spp": 16}),
    # On a finer film the samples on the die stay those of the scene, down to two a cell; paths have
    # one, since others follow.
    "a chart on its film": ("csf", [], {"width": 1024}, {"spp": 16, "sampler": "multijitter"}),
    "a chart on a finer film": ("csf", [], {"width": 2048}, {"spp": 4, "sampler": "multijitter"}),
    "a chart on the finest film": ("csf", [], {"width": 8192}, {"spp": 2, "sampler": "multijitter"}),
    "stated samples on a finer film": ("csf", [], {"width": 4096, "spp": 16}, {"spp": 16}),
    "paths on a finer film": ("still_life", [], {"width": 1024}, {"spp": 1, "sampler": "independent"}),
    "an unknown surface": ("macbeth", [shape("sphere", SPHERE, '<bsdf type="principled"/>')], {}, {"bounded": False}),
    **{
        name: (*NOT_APPLIED[name][:2], {}, {"resolution": None})
        for name in ("uniform chart out of focus", "chart smaller than the film")
    },
    "a coloured slide": (*NOT_APPLIED["a spot with a coloured slide"][:2], {}, {"lamps": 2}),
}  # fmt: skip


@pytest.mark.parametrize("name", APPLIED)
def test_plan_rules_apply(name: str, folder: Path) -> None:
    scene_name, edits, parameters, expected = APPLIED[name]
    stated = {key: value for key, value in parameters.items() if key != "width"}
    scene = load(edited(folder, scene_name, *edits), **stated)
    plan = make_plan(scene.with_resolution(parameters["width"]) if "width" in parameters else scene)
    facts = vars(plan.samples) | vars(plan.film) | {"bounded": plan.bounded}
    facts |= {"left_out": left_out(plan) & RULES, "lamps": len(plan.light.lamps)}
    assert {key: facts[key] for key in expected} == expected


@pytest.mark.parametrize("name", ["csf", "flat", "macbeth", "still_life"])
def test_plan_full_leaves_out_nothing(name: str) -> None:
    plan = make_plan(load(name), full=True)
    samples, light = plan.samples, plan.light
    assert (left_out(plan), samples.lens, samples.integrator) == (set(), "thinlens", None)
    assert (samples.spp, light.passes) == (samples.full_spp, light.full_passes)


def test_plan_coloured_lamp_keeps_all_bands(folder: Path) -> None:
    """sRGB's red over its blue, 1 to 0.05, is spread over wavelengths by Mitsuba: 8 and more at
    these.
    """
    picture = ('value="charts/csf.exr"', 'value="coloured.exr"')
    raw = ('<boolean name="raw" value="true"/>', "")
    scene = load(edited(folder, "csf", raw, picture), resolution=16)
    light = make_render_plan(scene).light
    assert light.passes == light.full_passes == 12
    image = pixsim.render(scene)
    left, right = (image.data[4:12, part].mean(axis=(0, 1)) for part in np.s_[1:6, 10:15])
    ratio, nm = left / right, image.wavelength_nm
    assert ratio[(nm > 600) & (nm < 640)].min() > 5
    assert ratio[(nm > 420) & (nm < 470)].max() < 1 / 5


# --- Focus ---


@pytest.mark.parametrize(("times", "lens"), [(0.95, "perspective"), (1.05, "thinlens")])
def test_blur_limit_scales_with_the_photodiode(times: float, lens: str, tmp_path: Path) -> None:
    """2a |d - 1|/d · v/u in µm, solved for the distance, of a photodiode of 3.25 µm."""
    pixel = pixsim.Pixel(pitch_um=6.5, fill_factor=0.25)
    camera = pixsim.Camera()
    allowed_e = times * rules.BLUR_SHARE * rules.TOLERANCE_E
    blur_m = allowed_e / rules.BLURRED_EDGE * 3.25
    depth_m = 1 / (1 - blur_m / (2e3 * camera.aperture_radius_m * camera.image_distance_mm))
    path = edited(tmp_path, "csf", (AWAY, f'<translate z="{depth_m!r}"/>'), bigger(1.1))
    plan = make_render_plan(load(path), pixel=pixel)
    assert plan.samples.lens == lens
    bound_e = allowed_e if lens == "perspective" else 0.0
    assert decision(plan, "lens samples").bound_e == pytest.approx(bound_e, rel=1e-6)


def test_render_unfocused_chart_is_blurred_by_disc(tmp_path: Path) -> None:
    # A sinusoid through a uniform disc of diameter c keeps 2 J₁(πfc)/(πfc) of its contrast.
    #
    # The die is 1 mm wide, with 8 cycles at any depth; 32 × 16 cells of 64 samples leave 2 % of
    # noise in the contrast.
    wave = 0.5 * (1 + 0.8 * np.sin(2 * np.pi * 8 * (np.arange(2048) + 0.5) / 2048))
    pixsim.write_chart(tmp_path / "sine.exr", np.tile(wave.astype(np.float32), (2, 1)))
    camera = pixsim.Camera(f_number=0.8, object_distance_m=0.1, die_mm=1.0)
    carrier = np.exp(2j * np.pi * 8 * (np.arange(8, 24) + 0.5) / 32)  # four whole cycles
    contrasts = []
    for depth_m in (0.1, 0.2):
        half_m = camera.chart_half_width_m / 0.1 * depth_m
        wide = (HALF, f'x="{half_m!r}" y="{3 * half_m!r}"')
        path = edited(tmp_path, "csf", (AWAY, f'<translate z="{depth_m!r}"/>'), wide)
        scene = load(path, chart=str(tmp_path / "sine.exr"), resolution=32, spp=64)
        image = pixsim.render(scene, camera)
        row = (image.illuminance_lx() / lens_sr(image, camera)).mean(axis=0)[8:24]
        contrasts.append(2 * abs(carrier @ row) / row.sum())
    u = np.pi * 8 * 1e-3 * blur_um(camera, 0.2)
    assert contrasts[0] == pytest.approx(0.8 * np.sinc(8 / 32), rel=0.01)
    assert contrasts[1] / contrasts[0] == pytest.approx(abs(2 * j1(u) / u), abs=0.03)


# --- What a lone chart needs: cell means ---


@pytest.mark.parametrize(
    ("beyond", "mode", "order"),
    [("edge", "nearest", 1), ("wrap", "grid-wrap", 1), ("symmetric", "reflect", 1), ("edge", "nearest", 0)],
)  # fmt: skip
@pytest.mark.parametrize(
    ("covered", "shape"), [((24, 36), (5, 7)), ((12, 18), (6, 9)), ((24, 36), (40, 50))]
)
def test_chart_picture_is_cell_means(
    beyond, mode: str, order: int, covered: tuple[int, int], shape: tuple[int, int]
) -> None:
    # Means of the interpolation, linear (1) or of nearest texels (0), by the midpoint rule along
    # one axis at a time: an error of 1e-6, or of a step between two of 4096 points.
    texels = np.random.default_rng(0).uniform(0, 1, (24, 36))
    per_cell = covered[0] / shape[0], covered[1] / shape[1]
    picture = rules.Chart(texels, per_cell, shape, beyond, nearest=order == 0).picture()
    points = (np.arange(4096) + 0.5) / 4096
    for cell in ((0, 0), (shape[0] - 1, shape[1] - 1), (2, 3)):
        down, across = (
            (n - cover) / 2 + size * (place + points) - 0.5
            for place, n, cover, size in zip(cell, texels.shape, covered, per_cell, strict=True)
        )
        places = np.meshgrid(down, np.arange(36), indexing="ij")
        rows = map_coordinates(texels, places, order=order, mode=mode).mean(axis=0)
        expected = map_coordinates(rows, [across], order=order, mode=mode).mean()
        assert picture[cell] == pytest.approx(expected, rel=1e-6 if order else 2e-3), cell


@pytest.mark.parametrize("part", [np.s_[3:9, 2:16], np.s_[:, 5:6], np.s_[0:1, :]], ids=str)
def test_chart_picture_part_equals_whole(part: tuple[slice, slice]) -> None:
    chart = rules.Chart(np.random.default_rng(3).uniform(0.1, 1, (40, 30)), (2.0, 1.5), (12, 16))
    np.testing.assert_allclose(chart.picture(part), chart.picture()[part], rtol=1e-12)


# 256 stratified samples leave a noise of 3e-4, and three times as much in the worst of 1160 cells; of
# steps of 0.9 next to 0.1, one side of which a cell's samples take for the other by 256^-¾, 1.4e-2.
NOISE = {"bilinear": 3e-3, "nearest": 3e-2}


# A wrong way of a chart is an error of a half, far above either noise: the filters share the ways.
@pytest.mark.parametrize(
    ("flip", "mirrored", "wrap_mode", "filter_type"),
    [
        ((1, 1), 1, "clamp", "nearest"), ((-1, 1), 1, "repeat", "bilinear"), ((1, -1), 1, "mirror", "bilinear"),
        ((-1, -1), -1, "clamp", "bilinear"), ((1, 1), -1, "repeat", "nearest"),
    ],
)  # fmt: skip
def test_exact_cells_equal_render(flip, mirrored, wrap_mode, filter_type, tmp_path):
    """An asymmetric chart, wider than the film, however its texels run: Mitsuba's render approaches
    the exact cells.
    """
    texels = np.random.default_rng(5).uniform(0.1, 1, (12, 10)).astype(np.float32)
    pixsim.write_chart(tmp_path / "chart.exr", texels)
    edits = [
        ('<scale y="-1"/>', f'<scale x="{flip[0]}" y="{-flip[1]}"/>'),
        ('<translate y="1"/>', f'<translate x="{(1 - flip[0]) / 2}" y="{(1 + flip[1]) / 2}"/>'),
        ('"clamp"/>', f'"{wrap_mode}"/><string name="filter_type" value="{filter_type}"/>'),
        ('<scale x="$chart', f'<scale x="{mirrored}"/><scale x="$chart'),
    ]
    chart = {"chart": str(tmp_path / "chart.exr"), "chart_half_width": 0.5}
    scene = load(edited(tmp_path, "csf", *edits), **chart).with_resolution(40)
    camera = pixsim.Camera(die_mm=2.7136, die_height_mm=1.9)
    exact = make_plan(scene, camera, display=pixsim.Display())
    sampled = make_plan(scene.with_parameters(spp=256), camera)
    assert (exact.samples.exact, sampled.samples.exact) == (True, False)
    exact_lx, sampled_lx = (
        pixsim.render(scene, camera, plan=plan).illuminance_lx() for plan in (exact, sampled)
    )
    assert exact_lx.shape == sampled_lx.shape == (29, 40)
    np.testing.assert_allclose(exact_lx, sampled_lx, rtol=NOISE[filter_type])


@pytest.mark.parametrize(
    ("scene", "edits", "parameters", "full", "is_exact"),
    [
        ("csf", [], {}, False, True),
        ("csf", [], {"spp": 4}, False, False),
        ("csf", [], {}, True, False),
        ("still_life", [], {}, False, False),
        ("csf", [], {"focus_distance": 2}, False, False),
        ("csf", [(DEPTH, DEPTH.replace("2", "0"))], {}, False, False),
    ],
)
def test_exact_cells_only_where_they_are_exact(
    scene: str, edits: list, parameters: dict, full: bool, is_exact: bool, tmp_path
) -> None:
    """Samples that the user asks for, --full, and a chart that is out of focus or not seen are
    sampled.
    """
    film = load(edited(tmp_path, scene, *edits), **parameters).with_resolution(64)
    plan = make_plan(film, pixsim.Camera(), display=pixsim.Display(), full=full)
    assert plan.samples.exact == is_exact


# --- Diffraction ---


NM = 550.0


@pytest.mark.parametrize("contrast", [0.01, 0.5])
@pytest.mark.parametrize("half_periods", [3, 40, 127])
def test_diffraction_effect_of_a_sinusoid_matches_the_otf(
    half_periods: int, contrast: float
) -> None:
    """1 + c cos changes by c (1 - OTF) cos, relatively most where the sinusoid is darkest.

    With a texel for each sample, linear interpolation gives a cell's mean weights of 1/8, 6/8 and
    1/8.
    """
    wave = contrast * np.cos(np.pi * half_periods * (np.arange(128) + 0.5) / 128)
    x = np.arccos(half_periods / (2 * 128 * 2e-3) * 550e-6 * 4)
    otf = (2 * x - np.sin(2 * x)) / np.pi
    chart = rules.Chart(np.tile(1 + wave, (128, 1)), (1.0, 1.0), (128, 128))
    effect = rules.diffraction_effect(chart, 2.0, NM, 4.0)
    cells = wave * (3 + np.cos(np.pi * half_periods / 128)) / 4
    assert effect == pytest.approx((np.abs(cells) / (1 + cells)).max() * (1 - otf), rel=1e-5)


@pytest.mark.parametrize(("half_periods", "diffraction"), [(1, False), (100, True)])
def test_diffraction_of_a_soft_chart_is_left_out(
    half_periods: int, diffraction: bool, tmp_path: Path
) -> None:
    # The lens changes half a period over the die by less than a tenth of the tolerance, 1e-4, by
    # the OTF's slope at 0; a hundred by more.
    wave = 0.5 + 0.03 * np.cos(np.pi * half_periods * (np.arange(1024) + 0.5) / 1024)
    pixsim.write_chart(tmp_path / "soft.exr", np.tile(wave.astype(np.float32), (2, 1)))
    plan = render_plan("csf", chart=str(tmp_path / "soft.exr"), resolution=128)
    assert plan.film.diffraction == diffraction


def test_diffraction_of_a_large_film_is_tried_at_its_steepest_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With detail in one corner, the tested part contains it and has nearly the effect of the whole
    film; what is left out is proved on the whole film.
    """
    texels = np.full((64, 512), 0.5)
    texels[40:60, 448:496] += 0.2 * np.sin(np.arange(48) * 0.8)
    chart = rules.Chart(texels, (0.5, 0.5), (128, 1024))
    whole = rules.diffraction_effect(chart, 1.0, NM, 4.0)
    monkeypatch.setattr(rules, "TRIED_SIDE", 128)
    monkeypatch.setattr(rules, "BORDER", 8)
    part = rules.diffraction_effect(chart, 1.0, NM, 4.0, whole / 2)
    assert whole != part == pytest.approx(whole, rel=0.02)
    assert rules.diffraction_effect(chart, 1.0, NM, 4.0, whole * 1.1) == whole
