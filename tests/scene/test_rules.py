"""Rules of the plan: edits of packaged scenes, closed forms, and real renders."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import END, decision, edited, left_out, lens_sr, load, render_plan
from scipy.ndimage import map_coordinates
from scipy.special import j1

import pixsim
from pixsim.light.exr import write_channels
from pixsim.scene import rules
from pixsim.scene.contents import blur_um
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import Plan, make_plan, make_render_plan

RULES = {"spectral rank", "bounces", "lens samples", "texture samples", "diffraction"}
HALF, AWAY = 'x="$chart_half_width" y="$chart_half_height"', '<translate z="$focus_distance"/>'
SIDE = 'x="$chart_half_side" y="$chart_half_side"'  # of the slanted edge
PATH = '<integrator type="path"/>'
DEPTH = '<integer name="max_depth" value="2"/>'
RAW = '<boolean name="raw" value="true"/>'
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


def moved_chart(transform: str) -> tuple[str, str]:
    return AWAY, transform


ALONE, DETAIL, MATT = (
    {"spectral rank", "bounces"},
    {"texture samples", "diffraction"},
    {"bounces", "lens samples"},
)
FILM = '<translate z="$focus_distance"/>'
NEAR, FOG, BEHIND = (
    '<scale value="0.05"/><translate z="0.8"/>',
    '<scale value="0.1"/><translate z="0.8"/>',
    '<translate z="-0.1"/>',
)
CONTROLLED_FIELDS = '<rotate y="1" angle="180"/><scale z="-1"/>'
ENVIRONMENT = '<emitter type="envmap"><string name="filename" value="coloured.exr"/></emitter>'
BOTH_SIDES = [
    (BSDF, f'<bsdf type="twosided">{BSDF}'),
    ("</bsdf>\n    </shape>\n</scene>", "</bsdf></bsdf></shape></scene>"),
]
INSIDE = (
    '<bsdf type="null"/><medium type="homogeneous" name="interior"><rgb name="albedo" value="0.9,'
    ' 0.2, 0.1"/></medium>'
)
SLIDE = (
    '<texture type="bitmap" name="texture"><string name="filename" value="coloured.exr"/></texture>'
)


def shining(plugin: str, name: str = "radiance", more: str = "") -> str:
    return f'<emitter type="{plugin}">{NEUTRAL_LAMP.format(name)}{more}</emitter>'


# name: (scene, edits, the rules that must not fire)
NOT_APPLIED = {
    "chart out of focus": (
        "slanted_edge",
        [moved_chart('<translate z="1.3"/>'), bigger(1.5, SIDE)],
        RULES - ALONE,
    ),
    "uniform chart out of focus": ("flat", [moved_chart('<translate z="0.9"/>')], RULES - ALONE),
    "tilted chart": (
        "flat",
        [moved_chart(f'<rotate x="1" angle="20"/>{FILM}'), bigger(1.5)],
        RULES - ALONE,
    ),
    "chart smaller than the film": ("flat", [bigger(0.9)], DETAIL),
    "chart beside the axis": (
        "slanted_edge",
        [bigger(2, SIDE), moved_chart(f'<translate x="0.3"/>{FILM}')],
        DETAIL,
    ),
    "chart turned on its side": (
        "flat",
        [bigger(2), moved_chart(f'<rotate z="1" angle="30"/>{FILM}')],
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
    "an environment map": ("macbeth", [(END, ENVIRONMENT)], {"lens samples"}),
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


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a picture whose left half is red and whose right half is blue."""
    import OpenEXR

    texels = np.zeros((8, 8, 3), np.float32)
    texels[:, :4], texels[:, 4:] = (1, 0.05, 0.05), (0.05, 0.05, 1)
    top = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(top, {"RGB": texels}) as file:
        file.write(str(tmp_path / "coloured.exr"))
    return tmp_path


@cache
def packaged_plan(scene: str) -> Plan:
    return render_plan(scene)


@pytest.mark.parametrize("name", NOT_APPLIED)
def test_plan_rules_do_not_apply(name: str, folder: Path) -> None:
    scene, edits, left_in = NOT_APPLIED[name]
    plan = render_plan(edited(folder, scene, *edits))
    assert not left_out(plan) & left_in
    # The edit makes a difference.
    before = left_out(packaged_plan(scene)) | {"diffraction"}
    assert left_in - {"texture samples"} <= before

    light = plan.light
    samples = plan.samples
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
HIDDEN = f'{DEPTH}<boolean name="hide_emitters" value="true"/>'


def with_depth(depth: int) -> tuple[str, str]:
    return DEPTH, f'<integer name="max_depth" value="{depth}"/>'


def with_integrator(integrator: str) -> tuple[str, str]:
    return PATH, f'<integrator type="{integrator}"/>'


def path_of_depth(depth: int) -> tuple[str, str]:
    return PATH, f'<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>'


# name: (scene, edits, parameters and width of the film, what the plan has)
APPLIED: dict[str, tuple[str, list[tuple[str, str]], dict[str, Any], dict[str, Any]]] = {
    "a chart": ("slanted_edge", [], {}, {"left_out": MATT_RULES, "integrator": PATH_1, "lens": "perspective", "spp": 16}),
    "a uniform chart": ("flat", [], {}, {"left_out": RULES, "resolution": 64, "spp": 4, "diffraction": False}),
    "boards that face one way": ("macbeth", [], {}, {"left_out": MATT_RULES, "integrator": {"type": "direct"}, "bounded": True}),
    "a disc": ("flat", [('type="rectangle"', 'type="disk"')], {}, {"left_out": MATT_RULES, "resolution": None}),
    "one bounce": ("macbeth", [path_of_depth(2), GLOSSY], {}, {"integrator": {"type": "direct"}}),
    "two bounces": ("macbeth", [path_of_depth(3), GLOSSY], {}, {"integrator": None}),
    "one lamp spectrum": ("macbeth", [(END, LAMP.format("$lamp"))], {}, {"lamps": 1}),
    "two lamp spectra": ("macbeth", [(END, LAMP.format("spectra/a.spd"))], {}, {"lamps": 2}),
    **{
        f"the scene's {plugin}": ("macbeth", [with_integrator(plugin)], {}, {"integrator": None})
        for plugin in ("volpath", "direct")
    },
    "no light": ("csf", [with_depth(0)], {}, {"integrator": None}),
    "lamps alone": ("csf", [with_depth(1)], {}, {"integrator": None}),
    "any depth": ("csf", [with_depth(-1)], {}, {"integrator": PATH_1}),
    "hidden emitters": ("csf", [(DEPTH, HIDDEN)], {}, {"integrator": PATH_1 | {"hide_emitters": True}}),
    "stated samples": ("slanted_edge", [], {"spp": 9}, {"spp": 9, "full_spp": 9, "left_out": MATT_RULES}),
    "a stated film": ("flat", [], {"resolution": 128}, {"resolution": None}),
    "passes share samples": ("still_life", [], {}, {"spp": 16, "full_spp": 64, "sampler": "multijitter"}),
    "stated samples of paths": ("still_life", [], {"spp": 8}, {"spp": 8}),
    # With 4 samples multijitter would make paths up to 1 % too dark.
    "few samples of paths": ("still_life", [('name="spp" value="64"', 'name="spp" value="4"')], {}, {"spp": 16}),
    # On a finer film the samples on the die stay those of the scene, down to two a cell.
    "a chart on its film": ("csf", [], {"width": 1024}, {"spp": 16, "sampler": "multijitter"}),
    "a chart on a finer film": ("csf", [], {"width": 2048}, {"spp": 4, "sampler": "multijitter"}),
    "a chart on the finest film": ("csf", [], {"width": 8192}, {"spp": 2, "sampler": "multijitter"}),
    "stated samples on a finer film": ("csf", [], {"width": 4096, "spp": 16}, {"spp": 16}),
    "paths on a finer film": ("still_life", [], {"width": 1024}, {"spp": 4, "sampler": "independent"}),
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
    width = parameters.get("width")
    stated = {key: value for key, value in parameters.items() if key != "width"}
    scene = load(edited(folder, scene_name, *edits), **stated)
    plan = make_plan(scene.with_resolution(width) if width else scene)
    facts = vars(plan.samples) | vars(plan.film)
    facts |= {"left_out": left_out(plan) & RULES, "lamps": len(plan.light.lamps)}
    facts["bounded"] = plan.bounded
    assert {key: facts[key] for key in expected} == expected


@pytest.mark.parametrize("name", ["csf", "flat", "macbeth", "still_life"])
def test_plan_full_leaves_out_nothing(name: str) -> None:
    plan = make_plan(load(name), full=True)
    assert left_out(plan) == set()
    assert (plan.samples.lens, plan.samples.integrator) == ("thinlens", None)
    assert (plan.samples.spp, plan.light.passes) == (plan.samples.full_spp, plan.light.full_passes)


def test_plan_coloured_lamp_keeps_all_bands(folder: Path) -> None:
    """sRGB's red over its blue, 1 to 0.05, is spread over wavelengths by Mitsuba: 8 and more at
    these.
    """
    picture = ('value="charts/csf.exr"', 'value="coloured.exr"')
    scene = load(edited(folder, "csf", (RAW, ""), picture), resolution=16)
    light = make_render_plan(scene).light
    assert light.passes == light.full_passes == 12
    image = pixsim.render(scene)
    left, right = (image.data[4:12, part].mean(axis=(0, 1)) for part in np.s_[1:6, 10:15])
    nm = image.wavelength_nm
    assert (left / right)[(nm > 600) & (nm < 640)].min() > 5
    assert (right / left)[(nm > 420) & (nm < 470)].min() > 5


# --- Focus ---


@pytest.mark.parametrize(("times", "lens"), [(0.95, "perspective"), (1.05, "thinlens")])
def test_blur_limit_scales_with_the_photodiode(times: float, lens: str, tmp_path: Path) -> None:
    """2a |d - 1|/d · v/u in µm, solved for the distance, of a photodiode of 3.25 µm."""
    pixel = pixsim.Pixel(pitch_um=6.5, fill_factor=0.25)
    camera = pixsim.Camera()
    allowed_e = times * rules.BLUR_SHARE * rules.TOLERANCE_E
    blur_m = allowed_e / rules.BLURRED_EDGE * 3.25
    depth_m = 1 / (1 - blur_m / (2e3 * camera.aperture_radius_m * camera.image_distance_mm))
    moved = moved_chart(f'<translate z="{depth_m!r}"/>')
    plan = make_render_plan(load(edited(tmp_path, "csf", moved, bigger(1.1))), pixel=pixel)
    assert plan.samples.lens == lens
    bound_e = allowed_e if lens == "perspective" else 0.0
    assert decision(plan, "lens samples").bound_e == pytest.approx(bound_e, rel=1e-6)


def test_render_unfocused_chart_is_blurred_by_disc(tmp_path: Path) -> None:
    # A sinusoid through a uniform disc of diameter c keeps 2 J₁(πfc)/(πfc) of its contrast.
    #
    # The die is 1 mm wide, with 8 cycles at any depth; 32 × 16 cells of 64 samples leave 2 % of
    # noise in the contrast.
    phase = 2 * np.pi * 8 * (np.arange(2048) + 0.5) / 2048
    wave = 0.5 * (1 + 0.8 * np.sin(phase)).astype(np.float32)
    pixsim.write_chart(tmp_path / "sine.exr", np.tile(wave, (2, 1)))
    camera = pixsim.Camera(f_number=0.8, object_distance_m=0.1, die_mm=1.0)
    basis = 2 * np.pi * 8 * (np.arange(8, 24) + 0.5) / 32
    waves = np.stack([np.ones(16), np.sin(basis), np.cos(basis)], axis=1)
    contrasts = []
    for depth_m in (0.1, 0.2):
        half_m = camera.chart_half_width_m / 0.1 * depth_m
        wide = (HALF, f'x="{half_m!r}" y="{3 * half_m!r}"')
        path = edited(tmp_path, "csf", moved_chart(f'<translate z="{depth_m!r}"/>'), wide)
        scene = load(path, chart=str(tmp_path / "sine.exr"), resolution=32, spp=64)
        image = pixsim.render(scene, camera)
        row = (image.illuminance_lx() / lens_sr(image, camera)).mean(axis=0)[8:24]
        mean, sine, cosine = np.linalg.lstsq(waves, row, rcond=None)[0]
        contrasts.append(np.hypot(sine, cosine) / mean)
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
    beyond: Any, mode: str, order: int, covered: tuple[int, int], shape: tuple[int, int]
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


def test_chart_picture_part_equals_whole():
    chart = rules.Chart(np.random.default_rng(3).uniform(0.1, 1, (40, 30)), (2.0, 1.5), (12, 16))
    for part in (np.s_[3:9, 2:16], np.s_[:, 5:6], np.s_[0:1, :]):
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
    rng = np.random.default_rng(5)
    write_channels(
        tmp_path / "chart.exr", {"Y": rng.uniform(0.1, 1, (12, 10)).astype(np.float32)}, {}
    )
    text = (
        packaged_scenes()["csf"]
        .read_text()
        .replace('<scale y="-1"/>', f'<scale x="{flip[0]}" y="{-flip[1]}"/>')
    )
    text = text.replace(
        '<translate y="1"/>', f'<translate x="{(1 - flip[0]) / 2}" y="{(1 + flip[1]) / 2}"/>'
    )
    text = text.replace(
        '"clamp"/>', f'"{wrap_mode}"/><string name="filter_type" value="{filter_type}"/>'
    )
    text = text.replace('<scale x="$chart', f'<scale x="{mirrored}"/><scale x="$chart')
    (tmp_path / "scene.xml").write_text(text)
    scene = pixsim.load_scene(
        tmp_path / "scene.xml", chart=str(tmp_path / "chart.exr"), chart_half_width=0.5
    ).with_resolution(40)
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
    ("scene", "edits", "parameters", "full"),
    [
        ("csf", [], {"spp": 4}, False),
        ("csf", [], {}, True),
        ("still_life", [], {}, False),
        ("csf", [], {"focus_distance": 2}, False),
        ("csf", [(DEPTH, DEPTH.replace("2", "0"))], {}, False),
    ],
)
def test_exact_cells_only_where_they_are_exact(
    scene: str, edits: list[tuple[str, str]], parameters: dict[str, Any], full: bool, tmp_path: Path
) -> None:
    """Samples that the user asks for, --full, and a chart that is out of focus or not seen are
    sampled.
    """
    display = pixsim.Display()
    path = edited(tmp_path, scene, *edits)
    film = load(path, **parameters).with_resolution(64)
    plan = make_plan(film, pixsim.Camera(), display=display, full=full)
    assert not plan.samples.exact
    chart = load("csf").with_resolution(64)
    assert make_plan(chart, pixsim.Camera(), display=display).samples.exact


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
