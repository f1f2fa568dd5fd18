"""Rules of the plan: edits of packaged scenes, closed forms, and real renders."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import END, FOLDER, decision, edited, left_out, lens_sr, load, render_plan
from scipy.ndimage import map_coordinates
from scipy.special import j1

import pixsim
from pixsim import optics
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_channels
from pixsim.scene import rules
from pixsim.scene.contents import blur_um
from pixsim.scene.film import PATH_SAMPLES
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


# --- Rules that apply ---


def test_lone_chart_is_recognised():
    plan = render_plan("slanted_edge")
    assert left_out(plan) == RULES - {"diffraction", "texture samples"}
    assert plan.samples.integrator == {"type": "path", "max_depth": 1}
    assert (plan.samples.lens, plan.light.passes, plan.light.full_passes) == ("perspective", 1, 12)
    assert plan.samples.spp == plan.samples.full_spp == 16
    assert plan.light.bands.width_nm.size == 48


def test_plan_uniform_chart_leaves_out_diffraction():
    plan = make_plan(load("flat"))
    assert left_out(plan) >= RULES | {"oversampling"}
    assert (plan.film.resolution, plan.samples.spp, plan.film.diffraction) == (64, 4, False)


def test_decide_bounces_parallel_boards_need_one():
    for name in ("macbeth", "line_lamp"):
        plan = render_plan(name)
        assert left_out(plan) == {"spectral rank", "spectrum tables", "bounces", "lens samples"}
        assert plan.samples.integrator == {"type": "direct"}


def test_decide_bounces_disk_equals_rectangle(tmp_path):
    plan = render_plan(edited(tmp_path, "flat", ('type="rectangle"', 'type="disk"')))
    assert left_out(plan) == {
        "spectral rank",
        "bounces",
        "lens samples",
    }  # but a disc does not fill the film
    assert plan.film.chart is None


def test_decide_bounces_depth_2_is_direct(tmp_path):
    ball = shape(
        "sphere", '<scale value="0.02"/><translate z="0.8"/>', '<bsdf type="roughconductor"/>'
    )
    for depth, integrator in ((DEPTH, {"type": "direct"}), (DEPTH.replace("2", "3"), None)):
        plan = render_plan(
            edited(
                tmp_path, "macbeth", (PATH, f'<integrator type="path">{depth}</integrator>'), ball
            )
        )
        assert plan.samples.integrator == integrator


def test_plan_equal_lamp_spectra_are_one_light(tmp_path):
    second = (
        '<emitter type="point"><point name="position" x="0" y="1" z="0"/><spectrum name="intensity"'
        ' filename="{}"/></emitter>'
    )
    for lamp, lights in (("$lamp", 1), ("spectra/a.spd", 2)):
        assert (
            len(render_plan(edited(tmp_path, "macbeth", (END, second.format(lamp)))).light.lamps)
            == lights
        )


# --- Rules that do not apply ---

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
KEPT = {
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
        for bsdf in ("conductor", "roughplastic", "dielectric")
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
    "a board facing the board from the back of its matrix": (
        "macbeth",
        [shape("rectangle", CONTROLLED_FIELDS + BEHIND)],
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


@pytest.mark.parametrize("name", KEPT)
def test_plan_rules_do_not_apply(name, folder):
    scene, edits, stored = KEPT[name]
    before, plan = packaged_plan(scene), render_plan(edited(folder, scene, *edits))
    assert not left_out(plan) & stored
    assert stored - {"texture samples"} <= left_out(before) | {"diffraction"}, (
        "the edit makes no difference"
    )
    light, samples = plan.light, plan.samples
    done = {
        "lens samples": samples.lens == "thinlens",
        "bounces": samples.integrator is None,
        "diffraction": plan.film.diffraction,
    }
    done |= {
        "spectral rank": light.passes == light.full_passes,
        "texture samples": samples.spp * light.passes >= samples.full_spp,
    }
    assert [rule for rule in stored if not done[rule]] == []
    if scene == "flat" and "diffraction" in stored:
        assert make_plan(load(folder / "flat.xml")).film.resolution is None


def test_plan_coloured_lamp_keeps_all_bands(folder):
    scene = load(
        edited(folder, "csf", (RAW, ""), ('value="charts/csf.exr"', 'value="coloured.exr"')),
        resolution=16,
    )
    plan = make_render_plan(scene)
    assert "spectral rank" not in left_out(plan)
    assert plan.light.passes == plan.light.full_passes == 12
    assert plan.light.lamps[0].lamp.spectrum is None
    image = pixsim.render(scene)
    left, right = (
        image.data[4:12, where].mean(axis=(0, 1), dtype=float)
        for where in (slice(1, 6), slice(10, 15))
    )
    nm = image.wavelength_nm
    # sRGB's red over its blue, 1 to 0.05, is spread over wavelengths by Mitsuba: 8 and more at
    # these.
    assert (left / right)[(nm > 600) & (nm < 640)].min() > 5
    assert (right / left)[(nm > 420) & (nm < 470)].min() > 5


def test_plan_projector_slide_is_separate_light(folder):
    scene, edits, _ = KEPT["a spot with a coloured slide"]
    plan = render_plan(edited(folder, scene, *edits))
    assert [light.lamp.spectrum is None for light in plan.light.lamps] == [False, True]
    assert len(plan.light.lamps[1].fit.pulses) == plan.light.bands.width_nm.size


@pytest.mark.parametrize("plugin", ["volpath", "direct", "volpathmis"])
def test_decide_bounces_other_integrator_stays(plugin, tmp_path):
    plan = render_plan(edited(tmp_path, "macbeth", (PATH, f'<integrator type="{plugin}"/>')))
    assert "bounces" not in left_out(plan)
    assert plan.samples.integrator is None
    assert f"'{plugin}'" in decision(plan, "bounces").reason


@pytest.mark.parametrize(
    ("depth", "integrator"), [(0, None), (1, None), (-1, {"type": "path", "max_depth": 1})]
)
def test_decide_bounces_minimal_depth_stays(depth, integrator, tmp_path):
    assert (
        render_plan(
            edited(tmp_path, "csf", (DEPTH, DEPTH.replace("2", str(depth))))
        ).samples.integrator
        == integrator
    )


def test_decide_bounces_hidden_emitters_stay_hidden(tmp_path):
    hidden = (DEPTH, f'{DEPTH}<boolean name="hide_emitters" value="true"/>')
    path = edited(tmp_path, "csf", hidden)
    assert render_plan(path).samples.integrator == {
        "type": "path",
        "max_depth": 1,
        "hide_emitters": True,
    }
    with pytest.raises(PixsimError, match="hide_emitters"):
        pixsim.render(load(path, resolution=8))


def test_plan_user_parameters_stay():
    plan = render_plan("slanted_edge", spp=9)
    assert (plan.samples.spp, plan.samples.full_spp) == (9, 9)
    assert "texture samples" not in left_out(plan)
    assert make_plan(load("flat", resolution=128)).film.resolution is None
    assert "oversampling" not in left_out(make_plan(load("flat", resolution=128)))
    assert make_plan(load("flat", spp=4)).film.resolution == 64


@pytest.mark.parametrize("name", ["csf", "flat", "macbeth", "still_life"])
def test_plan_full_leaves_out_nothing(name):
    plan = make_plan(load(name), full=True)
    assert left_out(plan) == set()
    assert (plan.samples.lens, plan.samples.integrator) == ("thinlens", None)
    assert (plan.film.resolution, plan.film.diffraction) == (None, True)
    assert (plan.samples.spp, plan.light.passes) == (plan.samples.full_spp, plan.light.full_passes)
    assert not plan.light.factored


def test_decide_samples_passes_share_samples():
    """With 4 samples multijitter correlates the dimensions of a path: the still life is 0.8 % too
    dark, 10 standard errors.
    """
    plan = render_plan("still_life")
    assert plan.light.passes > 4
    assert (plan.samples.spp, plan.samples.full_spp) == (16, 64)
    assert render_plan("still_life", spp=8).samples.spp == 8
    many = make_render_plan(load("still_life"), tolerance_e=1e-4)
    assert many.light.passes > 16
    assert many.samples.spp == 16


# --- Focus ---


def test_decide_lens_blur_limit_scales_with_photodiode(tmp_path):
    pixel = pixsim.Pixel(pitch_um=6.5, fill_factor=0.25)  # a photodiode of 3.25 µm
    camera = pixsim.Camera()
    most_um = rules.BLUR_SHARE * rules.TOLERANCE_E / rules.BLURRED_EDGE * 3.25
    # 2a |d - 1|/d · v/u in µm, solved for the distance.
    per_m = 2e3 * camera.aperture_radius_m * camera.image_distance_mm
    for times, lens in ((0.95, "perspective"), (1.05, "thinlens")):
        depth_m = 1 / (1 - times * most_um / per_m)
        assert blur_um(camera, depth_m) == pytest.approx(times * most_um, rel=1e-9)
        scene = load(
            edited(tmp_path, "csf", moved_chart(f'<translate z="{depth_m!r}"/>'), bigger(1.1))
        )
        plan = make_render_plan(scene, pixel=pixel)
        assert plan.samples.lens == lens
        bound = times * rules.BLUR_SHARE * rules.TOLERANCE_E if lens == "perspective" else 0.0
        assert decision(plan, "lens samples").bound_e == pytest.approx(bound, rel=1e-6)


def test_decide_lens_blurred_edge_matches_bound():
    # Light beyond a straight edge across a disc of diameter 1: ∫ of the share of the disc beyond t,
    # t from 0 to ½.
    t = (np.arange(100000) + 0.5) / 200000
    share = (np.arccos(2 * t) - 2 * t * np.sqrt(1 - 4 * t**2)) / np.pi
    # An edge loses it on one side and has it on the other.
    assert 2 * share.mean() / 2 == pytest.approx(rules.BLURRED_EDGE, rel=1e-6)


def test_render_unfocused_chart_is_blurred_by_disc(tmp_path):
    """A sinusoid through a uniform disc of diameter c keeps 2 J₁(πfc)/(πfc) of its contrast."""
    cycles = 8.0
    at = (np.arange(2048) + 0.5) / 2048
    wave = 0.5 * (1 + 0.8 * np.sin(2 * np.pi * cycles * at))
    pixsim.write_chart(tmp_path / "sine.exr", np.tile(wave.astype(np.float32), (2, 1)))
    camera = pixsim.Camera(f_number=0.8, object_distance_m=0.1, die_mm=1.0)
    half = camera.chart_half_width_m
    tangent = half / 0.1
    result = {}
    for depth in (0.1, 0.2):
        wide = (HALF, f'x="{tangent * depth!r}" y="{3 * tangent * depth!r}"')
        path = edited(tmp_path, "csf", moved_chart(f'<translate z="{depth!r}"/>'), wide)
        scene = load(path, chart=str(tmp_path / "sine.exr"), resolution=32, spp=64)
        image = pixsim.render(scene, camera)
        row = (image.illuminance_lx() / lens_sr(image, camera)).mean(axis=0)[8:24]
        assert (make_render_plan(scene, camera).samples.lens == "thinlens") == (depth != 0.1)
        x = 2 * np.pi * cycles * (np.arange(8, 24) + 0.5) / 32
        mean, sine, cosine = np.linalg.lstsq(
            np.stack([np.ones(16), np.sin(x), np.cos(x)], axis=1), row, rcond=None
        )[0]
        result[depth] = np.hypot(sine, cosine) / mean
    c_mm = 1e-3 * blur_um(camera, 0.2)
    u = np.pi * cycles * c_mm  # cycles a mm, for the die is 1 mm wide at any depth
    expected = abs(2 * j1(u) / u)
    assert result[0.1] == pytest.approx(0.8 * np.sinc(cycles / 32), rel=0.01)
    # 32 × 16 cells of 64 samples: 2 % of noise in the contrast that is left.
    assert 0.05 < expected < 0.9, "the case does not test the bound"
    assert result[0.2] / result[0.1] == pytest.approx(expected, abs=0.03)


# --- Errors ---

TEXTURED = '<texture type="{}" name="radiance">{}</texture>'


@pytest.mark.parametrize("picture", ["checkerboard", "bitmap"])
def test_lone_chart_coloured_picture_is_not_uniform(picture, tmp_path):
    import matplotlib.image

    matplotlib.image.imsave(tmp_path / "photo.png", np.random.default_rng(0).random((8, 8, 3)))
    inside = "" if picture == "checkerboard" else '<string name="filename" value="photo.png"/>'
    text = (FOLDER / "flat.xml").read_text(encoding="utf-8")
    emitter = text[text.index('<texture type="d65"') : text.index("</emitter>")]
    plan = make_plan(load(edited(tmp_path, "flat", (emitter, TEXTURED.format(picture, inside)))))
    assert plan.film.chart is None
    assert plan.film.diffraction
    assert plan.film.resolution is None
    assert plan.samples.spp == 16


def test_plan_dark_lamp_is_ignored(tmp_path):
    lamps = "".join(
        f'<emitter type="point"><point name="position" x="{x}" y="0" z="0"/><texture type="d65"'
        f' name="intensity"><float name="scale" value="{scale}"/></texture></emitter>'
        for x, scale in ((0.2, 1e-9), (-0.2, 1.0))
    )
    image = pixsim.render(load(edited(tmp_path, "macbeth", (END, lamps)), resolution=8))
    bare = pixsim.render(load("macbeth", resolution=8))
    assert image.illuminance_lx().mean() > 2 * bare.illuminance_lx().mean()


def test_plan_scene_without_light_raises(tmp_path):
    text = (FOLDER / "macbeth.xml").read_text(encoding="utf-8")
    lamp = text[
        text.index('<emitter type="directional"') : text.index("</emitter>") + len("</emitter>")
    ]
    scene = load(edited(tmp_path, "macbeth", (lamp, "")))
    with pytest.raises(PixsimError, match="no emitter with light"):
        make_plan(scene)


@pytest.mark.parametrize(
    ("name", "edit", "message"),
    [
        (
            "macbeth",
            (PATH, '<integrator type="ptracer"/>'),
            "integrator: got 'ptracer' in line .*; allowed: path, ",
        ),
        (
            "macbeth",
            (PATH, '<integrator type="aov"><string name="aovs" value="d:depth"/></integrator>'),
            "got 'aov'",
        ),
        ("macbeth", (END, '<medium type="homogeneous" id="fog"/>'), "volpath"),
        (
            "csf",
            (
                '<film type="hdrfilm">',
                '<film type="hdrfilm"><integer name="crop_width" value="8"/>',
            ),
            "an uncropped film",
        ),
        (
            "csf",
            ('<film type="hdrfilm">', '<medium type="homogeneous"/><film type="hdrfilm">'),
            "volpath|camera in a medium",
        ),
        (
            "still_life",
            (
                '<float name="int_ior" value="1.5"/>',
                '<spectrum name="int_ior" value="400:1.6,700:1.5"/>',
            ),
            "dispersive",
        ),
    ],
)
def test_check_supported_unsupported_features_raise(name, edit, message, tmp_path):
    with pytest.raises(PixsimError, match=message):
        load(edited(tmp_path, name, edit))


def test_check_textures_maps_may_be_raw(tmp_path):
    """A normal map has three channels of any values: it is neither light nor reflectance."""
    import matplotlib.image

    matplotlib.image.imsave(tmp_path / "normals.png", np.full((4, 4, 3), (0.5, 0.5, 1.0)))
    bump = (
        '<bsdf type="normalmap"><texture type="bitmap" name="normalmap"><boolean name="raw"'
        ' value="true"/><string name="filename" value="normals.png"/></texture><bsdf'
        ' type="diffuse"/></bsdf>'
    )
    ball = shape("sphere", '<scale value="0.02"/><translate z="0.8"/>', bump)
    scene = load(edited(tmp_path, "macbeth", ball), resolution=8)
    assert pixsim.render(scene).illuminance_lx().min() > 0


def test_load_scene_included_parameters_are_known(tmp_path):
    (tmp_path / "more.xml").write_text(
        '<scene version="3.0.0"><default name="depth" value="3"/>'
        '<integrator type="path"><integer name="max_depth" value="$depth"/></integrator></scene>',
        encoding="utf-8",
    )
    path = edited(tmp_path, "macbeth", (PATH, '<include filename="more.xml"/>'))
    assert load(path, depth=2).parameters == {"depth": "2"}
    with pytest.raises(PixsimError, match="Did you mean 'depth'"):
        load(path, dept=2)


def test_plan_unknown_contents_state_reason(tmp_path):
    """Inside a band of 10 nm the spectrum of an unknown surface has no bound."""
    ball = shape("sphere", '<scale value="0.02"/><translate z="0.8"/>', '<bsdf type="principled"/>')
    assert not render_plan(edited(tmp_path, "macbeth", ball)).bounded
    assert render_plan("macbeth").bounded


def test_decide_samples_paths_have_minimum(tmp_path):
    """With 4 samples, Mitsuba's default, multijitter makes paths up to 1 % too dark."""
    few = edited(
        tmp_path,
        "still_life",
        ('<default name="spp" value="64"/>', '<default name="spp" value="4"/>'),
    )
    assert render_plan(few).samples.spp == 16
    assert render_plan(few, spp=4).samples.spp == 4  # asked for


SIZE = 128


def chart_of(texels: np.ndarray, film: int) -> rules.Chart:
    return rules.Chart(texels, (texels.shape[0] / film, texels.shape[1] / film), (film, film))


# --- What a lone chart needs: cell means ---


def test_chart_picture_is_cell_means():
    """Means of the interpolation, linear (1) or of nearest texels (0), by the midpoint rule; the
    chart covers 12 of 24 rows.
    """
    texels, points = np.random.default_rng(0).uniform(0, 1, (24, 36)), 4096
    modes = (
        ("edge", "nearest", 1),
        ("wrap", "grid-wrap", 1),
        ("symmetric", "reflect", 1),
        ("edge", "nearest", 0),
    )
    for beyond, mode, order in modes:
        for covered, shape in (
            ((24, 36), (6, 9)),
            ((24, 36), (5, 7)),
            ((12, 18), (6, 9)),
            ((24, 36), (40, 50)),
        ):
            per_sample = covered[0] / shape[0], covered[1] / shape[1]
            picture = rules.Chart(texels, per_sample, shape, beyond, nearest=order == 0).picture()
            for row, column in ((0, 0), (shape[0] - 1, shape[1] - 1), (2, 3)):
                at = []
                for place, n, cover, size in zip(
                    (row, column), texels.shape, covered, per_sample, strict=True
                ):
                    at.append(
                        (n - cover) / 2 + size * (place + (np.arange(points) + 0.5) / points) - 0.5
                    )
                # Along one axis at a time: interpolation and mean separate.
                places = np.meshgrid(at[0], np.arange(36), indexing="ij")
                rows = map_coordinates(texels, places, order=order, mode=mode).mean(axis=0)
                truth = map_coordinates(rows, [at[1]], order=order, mode=mode).mean()
                error = 1e-6 if order else 2e-3  # of a step between two of 4096 points
                assert picture[row, column] == pytest.approx(truth, rel=error), (
                    beyond,
                    covered,
                    shape,
                    row,
                    column,
                )


# 1024 stratified samples leave a noise of 1e-4, and three times as much in the worst of 1160 cells;
# of steps of 0.9 next to 0.1, one side of which a cell's samples take for the other by 1024^-¾,
# 5e-3.
NOISE = {"bilinear": 1e-3, "nearest": 1e-2}


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
    sampled = make_plan(scene.with_parameters(spp=1024), camera)
    assert (exact.samples.exact, sampled.samples.exact) == (True, False)
    one, other = (
        pixsim.render(scene, camera, plan=plan).illuminance_lx() for plan in (exact, sampled)
    )
    assert one.shape == other.shape == (29, 40)
    np.testing.assert_allclose(one, other, rtol=NOISE[filter_type])


def test_exact_cells_only_where_they_are_exact(tmp_path):
    """Samples that the user asks for, --full, and a chart that is out of focus or not seen are
    sampled.
    """
    display, camera = pixsim.Display(), pixsim.Camera()
    scene = load("csf").with_resolution(64)
    plan = make_plan(scene, camera, display=display)
    assert plan.samples.exact
    assert any("exact mean" in decision.reason for decision in plan.decisions)
    assert not make_plan(
        load("csf", spp=4).with_resolution(64), camera, display=display
    ).samples.exact
    assert not make_plan(scene, camera, display=display, full=True).samples.exact
    assert not make_plan(
        load("still_life").with_resolution(64), camera, display=display
    ).samples.exact
    assert not make_plan(
        load("csf", focus_distance=2).with_resolution(64), camera, display=display
    ).samples.exact
    path = edited(tmp_path, "csf", ('name="max_depth" value="2"', 'name="max_depth" value="0"'))
    assert not make_plan(
        pixsim.load_scene(path).with_resolution(64), camera, display=display
    ).samples.exact


# --- Diffraction ---

NM = 550.0


@pytest.mark.parametrize("contrast", [0.01, 0.5])
@pytest.mark.parametrize("half_periods", [3, 40, 127])
def test_diffraction_effect_sinusoid_matches_otf(half_periods, contrast):
    """1 + c cos changes by c (1 - OTF) cos, relatively most where the sinusoid is darkest.

    With a texel for each sample, linear interpolation gives a cell's mean weights of 1/8, 6/8 and
    1/8.
    """
    n, pitch_um, f_number = 128, 2.0, 4.0
    wave = contrast * np.cos(np.pi * half_periods * (np.arange(n) + 0.5) / n)
    frequency = half_periods / (2 * n * pitch_um * 1e-3)
    x = np.arccos(frequency * 550e-6 * f_number)
    otf = (2 * x - np.sin(2 * x)) / np.pi
    result = rules.diffraction_effect(
        chart_of(np.tile(1 + wave, (n, 1)), n), pitch_um, NM, f_number
    )
    shown = wave * (3 + np.cos(np.pi * half_periods / n)) / 4
    assert result == pytest.approx((np.abs(shown) / (1 + shown)).max() * (1 - otf), rel=1e-5)
    if contrast == 0.01:
        assert result == pytest.approx(np.abs(shown).max() * (1 - otf), rel=0.02)


def test_diffraction_effect_flat_field_is_zero():
    for texels in (np.ones((64, 64)), np.ones((1, 1))):
        assert (
            rules.diffraction_effect(rules.Chart(texels, (1.0, 1.0), (64, 64)), 1.0, NM, 8.0) == 0.0
        )


def test_diffraction_effect_large_film_keeps_detail():
    """Stripes two samples wide on a film of 1024; a film of a quarter would be grey."""
    stripes = np.tile(np.arange(1024) // 2 % 2 + 1.0, (4, 1))
    chart = rules.Chart(stripes, (4 / 1024, 1.0), (1024, 1024))
    wide = rules.diffraction_effect(chart, 2.65, NM, 4.0)
    narrow = rules.diffraction_effect(
        rules.Chart(stripes[:, :256], (4 / 256, 1.0), (256, 256)), 2.65, NM, 4.0
    )
    assert wide > 0.05
    assert wide == pytest.approx(narrow, rel=1e-4)  # the OTF comes from a table


def test_decide_diffraction_soft_chart_is_left_out(tmp_path: Path):
    """The lens changes half a period over the die by less than a tenth of the tolerance, a hundred
    by more.
    """
    for half_periods, stored in ((1, False), (100, True)):
        wave = 0.5 + 0.03 * np.cos(np.pi * half_periods * (np.arange(1024) + 0.5) / 1024)
        pixsim.write_chart(tmp_path / "soft.exr", np.tile(wave.astype(np.float32), (2, 1)))
        plan = render_plan("csf", chart=str(tmp_path / "soft.exr"), resolution=128)
        assert plan.film.diffraction == stored
    cutoff = optics.cutoff_cy_per_mm(830.0, pixsim.Camera().effective_f_number)
    assert (
        4 / np.pi * 0.03 / 0.47 / (2 * 2.7136) / cutoff < 1e-4
    )  # by the OTF's slope at 0, 4/π over the cut-off


def test_chart_picture_part_equals_whole():
    chart = rules.Chart(np.random.default_rng(3).uniform(0.1, 1, (40, 30)), (2.0, 1.5), (12, 16))
    for part in (np.s_[3:9, 2:16], np.s_[:, 5:6], np.s_[0:1, :]):
        np.testing.assert_allclose(chart.picture(part), chart.picture()[part], rtol=1e-12)


def test_diffraction_effect_large_film_uses_steepest_part(monkeypatch):
    """With detail in one corner, the tested part contains it and has nearly the effect of the whole
    film.
    """
    texels = np.full((64, 512), 0.5)
    texels[40:60, 448:496] += 0.2 * np.sin(np.arange(48) * 0.8)
    chart = rules.Chart(texels, (0.5, 0.5), (128, 1024))
    lens = 1.0, NM, 4.0
    whole = rules.diffraction_effect(chart, *lens)
    shapes = []
    real = rules.diffract
    monkeypatch.setattr(
        rules,
        "diffract",
        lambda picture, *rest: shapes.append(picture.shape) or real(picture, *rest),
    )
    monkeypatch.setattr(rules, "TRIED_SIDE", 128)
    monkeypatch.setattr(rules, "BORDER", 8)
    assert rules.diffraction_effect(chart, *lens, whole / 2) == pytest.approx(whole, rel=0.02)
    assert shapes == [(128, 128)]
    assert rules.diffraction_effect(chart, *lens, whole * 1.1) == whole, (
        "what is left out is proved on the whole film"
    )
    assert shapes[1:] == [(128, 128), (128, 1024)]


# --- A film finer than the scene's ---


def test_decide_samples_finer_film_shares_samples_of_chart():
    """The samples on the die stay those of the scene, down to two for each cell, which stratify
    it.
    """
    scene = load("csf")
    own = render_plan("csf")
    for width, spp in ((1024, own.samples.spp), (2048, 4), (8192, 2)):
        plan = make_render_plan(scene.with_resolution(width))
        assert (plan.samples.spp, plan.samples.sampler) == (spp, "multijitter"), width
    assert (
        make_render_plan(load("csf", spp=16).with_resolution(4096)).samples.spp == 16
    )  # asked for
    assert make_render_plan(scene.with_resolution(4096), full=True).samples.spp == 16


def test_decide_samples_finer_film_of_paths_is_independent():
    """Below 16 samples, multijitter would make paths too dark."""
    scene = load("still_life")
    for width, spp, sampler in (
        (512, 16, "multijitter"),
        (1024, 4, "independent"),
        (4096, 4, "independent"),
    ):
        plan = make_render_plan(scene.with_resolution(width))
        assert (plan.samples.spp, plan.samples.sampler) == (spp, sampler), width


def test_make_plan_film_of_paths_stays_within_samples():
    """Two renders of the film that is chosen take at most the limit of samples, on any shape of
    die.
    """
    pixel, display = pixsim.Pixel(pitch_um=6.5), pixsim.Display(dots=2048)
    for height_mm in (5.0, 10.0):
        camera = pixsim.Camera(die_mm=10.0, die_height_mm=height_mm)
        plan = make_plan(load("still_life"), camera, pixel, display=display)
        assert plan.film.resolution is not None
        samples = (
            2 * plan.film.resolution**2 * height_mm / 10 * plan.samples.spp * plan.light.passes
        )
        # A film may be narrower by an eighth to end where the die ends: (8/9)² = 0.79, and its
        # width a multiple of four.
        assert 0.78 * PATH_SAMPLES < samples <= 1.01 * PATH_SAMPLES


@pytest.mark.slow
def test_render_independent_few_samples_are_unbiased():
    """Four independent samples have the mean of 25 stratified ones; multijitter with four is 0.8 %
    darker, 8 standard errors.
    """
    scene = load("still_life", resolution=96)
    finer = scene.with_resolution(192)
    plan, strata = make_render_plan(finer), make_render_plan(scene)
    assert (plan.samples.spp, plan.samples.sampler, strata.samples.sampler) == (
        4,
        "independent",
        "multijitter",
    )
    few = pixsim.render(finer, plan=plan).illuminance_lx().mean()
    many = (
        pixsim.render(scene, plan=replace(strata, samples=replace(strata.samples, spp=25)), seed=1)
        .illuminance_lx()
        .mean()
    )
    assert few == pytest.approx(many, rel=4e-3)
