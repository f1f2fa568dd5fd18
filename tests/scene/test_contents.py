"""Contents of scenes: shapes in front of the lens, and spectra of surfaces.

Compared with thin-lens optics, brute-force rays, Mitsuba's shapes, the numbers in the XML, and
Fresnel's formula.
"""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import END, VARIANT, VARIANTS, edited, load, scene_file, sensor_xml

import pixsim
from pixsim.light.spectral import colour_matching, d65
from pixsim.scene.contents import Body, Surfaces, find_bodies, find_surfaces
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.scene import sensor_node


# --- In view ---
def box(x: float, y: float, z: float, half: tuple[float, float, float] = (0, 0, 0)) -> Body:
    return Body(0, np.array(list(product((-1.0, 1.0), repeat=3))) * half + [x, y, z], None)


@pytest.mark.parametrize("z", [1e-4, 0.02, 0.5, 1.0, 1.5, 20.0])
@pytest.mark.parametrize("aspect", [1.0, 2.0])
@pytest.mark.parametrize("f_number", [0.6, 4.0])
def test_in_view_contains_all_hit_bodies(z, aspect, f_number):
    """Up to the largest distance from the axis, at a depth, of any ray between the lens and the
    plane in focus.
    """
    camera = pixsim.Camera(f_number=f_number)
    a, u = camera.aperture_radius_m, camera.object_distance_m
    for axis, half_m in ((0, camera.chart_half_width_m), (1, camera.chart_half_width_m / aspect)):
        start, end = np.meshgrid(np.linspace(-a, a, 201), np.linspace(-half_m, half_m, 201))
        edge = np.abs(start + (end - start) * z / u).max()
        for side, times in product((-1, 1), (0.999, 1.001)):
            place = side * times * edge * np.eye(3)[axis] + [0, 0, z]
            assert box(*place).in_view(camera, aspect) == (times < 1), (axis, side, times)


@pytest.mark.parametrize(
    ("place", "half", "is_seen"),
    [
        ((0, 0, 0.5), 0.01, True),
        ((0, 0, -0.5), 0.01, False),
        ((3, 0, 0.5), 0.01, False),
        ((3, 0, 0.5), 2.9, True),
        ((0, 0, 0), 5.0, True),  # the camera inside it
    ],
)
def test_in_view_outside_behind_and_around(
    place: tuple[float, float, float], half: float, is_seen: bool
) -> None:
    assert box(*place, (half,) * 3).in_view(pixsim.Camera(), 1) == is_seen
    assert Body(0, None, None).in_view(pixsim.Camera(), 1)  # of unknown size


# --- Bodies of a scene ---
def bodies_of(path: Path) -> list[Body]:
    state = load(path).parse()
    return find_bodies(state, sensor_node(state, None)[1])


TURN = (
    '<scale x="0.2" y="0.3" z="0.5"/><rotate x="1" y="2" z="0.5" angle="35"/><translate x="0.1"'
    ' y="-0.2" z="0.7"/>'
)
SHAPES = dict.fromkeys(
    ("rectangle", "cube", "disk"), f'<transform name="to_world">{TURN}</transform>'
) | {
    "sphere": (
        '<point name="center" x="0.1" y="0.2" z="0.3"/><float name="radius" value="0.25"/>'
        '<transform name="to_world"><scale value="0.5"/><translate z="0.7"/></transform>'
    ),
    "cylinder": (
        '<point name="p0" x="0.1" y="0" z="0.2"/><point name="p1" x="0.3" y="0.4" z="0.5"/><float'
        ' name="radius" value="0.15"/><transform name="to_world"><rotate y="1"'
        ' angle="40"/><translate z="0.7"/></transform>'
    ),
}


@pytest.mark.parametrize("plugin", SHAPES)
def test_find_bodies_corners_enclose_mitsubas_shape(plugin, tmp_path):
    thing = f'<shape type="{plugin}" id="thing">{SHAPES[plugin]}</shape>'
    path = edited(tmp_path, "flat", (END, thing))
    corners = bodies_of(path)[1].corners
    with mitsuba_session(VARIANT) as mi:
        (box,) = (item.bbox() for item in mi.load_file(str(path)).shapes() if item.id() == "thing")
        low, high = np.array(box.min), np.array(box.max)
    excess = np.array([low - corners.min(axis=0), corners.max(axis=0) - high])
    assert excess.min() >= -1e-6
    # A square around a disc and a cube around each end: at most √2 wider.
    exact = plugin in ("rectangle", "cube", "sphere")
    assert np.all(excess.sum(axis=0) <= (0 if exact else high - low) + 2e-6)


def test_find_bodies_are_in_camera_frame() -> None:
    """The glass ball of the still life, seen by a camera that looks down, 10 cm along its axis."""
    state = load("still_life").parse()
    bodies = find_bodies(state, sensor_node(state, None)[1])
    by_id = {state.nodes[body.node].id: body for body in bodies}
    eye = np.array([0, 0.036, -0.094])
    forward = np.array([0, -0.0255, 0.094]) / np.hypot(0.0255, 0.094)  # to the target
    across = np.array([1.0, 0, 0])  # up × forward
    frame = np.stack([across, np.cross(forward, across), forward])
    place = frame @ (np.array([-0.0105, 0.0085, 0]) - eye)
    np.testing.assert_allclose(by_id["glass_ball"].corners.mean(axis=0), place, atol=1e-6)
    np.testing.assert_allclose(by_id["table"].normal, frame @ [0, 1, 0], atol=1e-6)


INSTANCE = """<shape type="shapegroup" id="group">{inside}</shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><scale value="2"/><translate x="0.1" z="3"/></transform></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><translate z="5"/></transform></shape>"""
BALL = '<shape type="sphere"><float name="radius" value="0.1"/></shape>'
CUBE = """<shape type="cube"><transform name="to_world"><scale value="0.1"/>
    <translate y="0.4"/></transform></shape>"""


def test_find_bodies_group_members_are_at_instances(tmp_path: Path) -> None:
    """A member of unknown size makes the size of its instances unknown."""
    path = edited(tmp_path, "flat", (END, INSTANCE.format(inside=BALL + CUBE)))
    _, first, second = bodies_of(path)
    corners = [first.corners.min(axis=0), first.corners.max(axis=0)]
    np.testing.assert_allclose(corners, [[-0.1, -0.2, 2.8], [0.3, 1.0, 3.2]], atol=1e-6)
    assert second.depths_m == pytest.approx((4.9, 5.1))
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    inside = BALL + '<shape type="obj"><string name="filename" value="one.obj"/></shape>'
    _, *instances = bodies_of(edited(tmp_path, "flat", (END, INSTANCE.format(inside=inside))))
    assert [body.corners for body in instances] == [None, None]


# --- Front sides ---
@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, -2, 1), (1, 1, -1), (-1, 0.5, -1)])
@pytest.mark.parametrize("plugin", ["rectangle", "disk"])
def test_find_bodies_normals_match_mitsuba(plugin, scale, flip, tmp_path):
    turn = f'<scale value="{str(scale)[1:-1]}"/><rotate x="1" y="0.3" angle="25"/>'
    board = f"""<shape type="{plugin}"><boolean name="flip_normals" value="{flip}"/>
        <transform name="to_world">{turn}<translate z="0.7"/></transform></shape>"""
    path = edited(tmp_path, "flat", (END, board), ('x="$chart_half_width"', 'x="0.0001"'))
    with mitsuba_session(VARIANT) as mi:
        hit = mi.load_file(str(path)).ray_intersect(mi.Ray3f([0.05, 0.03, 0], [0, 0, 1]))
        shaded = np.array(hit.sh_frame.n)
    np.testing.assert_allclose(bodies_of(path)[1].normal, shaded, atol=1e-6)


NM = np.arange(360.0, 831.0)
RAMP = '<spectrum name="{}" value="360:{}, 830:{}"/>'
RGB = '<rgb name="reflectance" value="0.2, 0.5, 0.1"/>'
GOLD = '<string name="material" value="Au"/>'


def ramp(low: float, high: float) -> np.ndarray:
    return low + (high - low) * (NM - 360) / 470


def bsdf(plugin: str, inside: str = "") -> str:
    return f'<bsdf type="{plugin}">{inside}</bsdf>'


def bitmap(raw: str) -> str:
    inside = f'<string name="filename" value="grey.exr"/><boolean name="raw" value="{raw}"/>'
    return f'<texture type="bitmap" name="reflectance">{inside}</texture>'


def table(name: str, nodes: str, values: str) -> str:
    inside = f'<string name="wavelengths" value="{nodes}"/><string name="values" value="{values}"/>'
    return f'<spectrum type="irregular" name="{name}">{inside}</spectrum>'


def surfaces_of(folder: Path, *bsdfs: str, variant: str = VARIANT) -> Surfaces:
    pixsim.write_chart(folder / "grey.exr", np.full((2, 2), 0.5, np.float32))
    (folder / "eta.spd").write_text("360 0.2\n830 1.2\n")
    (folder / "k.spd").write_text("360 3\n830 2\n")
    shapes = (f'<shape type="rectangle">{bsdf}</shape>' for bsdf in bsdfs)
    path = scene_file(folder, sensor_xml(), *shapes, '<emitter type="constant"/>')
    return find_surfaces(pixsim.load_scene(path, variant=variant).parse(), variant)


def fresnel(eta: np.ndarray, k: np.ndarray, cosine: float) -> np.ndarray:
    """Return the reflectance of a metal for unpolarised light, from complex amplitudes (Born &
    Wolf, 14.2).
    """
    index = eta + 1j * k
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return (np.abs(s) ** 2 + np.abs(p) ** 2) / 2


def coated(reflectance: np.ndarray) -> np.ndarray:
    """Return the reflectance under a coat that reflects 60 % internally: ρ(1 + 0.6 ρ + 0.36 ρ² +
    …).
    """
    return np.sum([reflectance * (0.6 * reflectance) ** bounce for bounce in range(60)], axis=0)


# --- Spectra of surfaces ---
NEUTRAL = {
    "nothing": (),
    "default diffuse": (bsdf("diffuse"),),
    "a number": (bsdf("diffuse", '<spectrum name="reflectance" value="0.3"/>'),),
    "grey": (bsdf("diffuse", '<rgb name="reflectance" value="0.2, 0.2, 0.2"/>'),),
    "a flat table": (bsdf("diffuse", RAMP.format("reflectance", 0.4, 0.4)),),
    "a raw picture": (bsdf("diffuse", bitmap("true")),),
    "a plain checkerboard": (bsdf("diffuse", '<texture type="checkerboard" name="reflectance"/>'),),
    "glass": (bsdf("dielectric"), bsdf("roughdielectric"), bsdf("thindielectric")),
    "default plastic": (bsdf("plastic"), bsdf("roughplastic")),
    "a mirror": (bsdf("conductor"), bsdf("conductor", '<string name="material" value="none"/>')),
    "a metal of one index": (
        bsdf("conductor", '<spectrum name="eta" value="0.2"/><spectrum name="k" value="3"/>'),
    ),
    "twosided": (bsdf("twosided", bsdf("diffuse")),),
    "null": (bsdf("null"),),
}
# --- Metals ---
INDEX = {
    "in the file": RAMP.format("eta", 0.2, 1.2) + RAMP.format("k", 3, 2),
    "spectra": table("eta", "360, 830", "0.2, 1.2") + table("k", "360, 830", "3, 2"),
    "tables": '<spectrum name="eta" filename="eta.spd"/><spectrum name="k" filename="k.spd"/>',
}


@pytest.mark.parametrize("form", INDEX)
@pytest.mark.parametrize("plugin", ["conductor", "roughconductor"])
@VARIANTS  # the slowest to change: Mitsuba loads itself again
def test_find_surfaces_metal_index_obeys_fresnel(
    form: str, plugin: str, variant: str, tmp_path: Path
) -> None:
    surfaces = surfaces_of(tmp_path, bsdf(plugin, INDEX[form]), variant=variant)
    expected = [fresnel(ramp(0.2, 1.2), ramp(3, 2), cosine) for cosine in (1.0, 0.7, 0.3)]
    # float32; 0.01 in eta would be 1e-3.
    np.testing.assert_allclose(surfaces.spectra, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("material", "at_450", "at_650"),
    [("Au", 0.39, 0.965), ("Cu", 0.55, 0.95), ("Ag", 0.97, 0.985), ("Al", 0.918, 0.905)],
)
def test_find_surfaces_metal_by_name(material, at_450, at_650, tmp_path):
    # Handbook reflectances at normal incidence (CRC, optical properties of metals), which differ by
    # 2 to 5 % between samples.
    metal = bsdf("conductor", f'<string name="material" value="{material}"/>')
    normal = surfaces_of(tmp_path, metal).spectra[0]
    assert normal[NM == 450] == pytest.approx(at_450, rel=0.06)
    assert normal[NM == 650] == pytest.approx(at_650, rel=0.03)


def test_find_surfaces_tinted_metal_is_product(tmp_path):
    tint = RAMP.format("specular_reflectance", 0.1, 0.9)
    plain = surfaces_of(tmp_path, bsdf("conductor", GOLD)).spectra
    tinted = surfaces_of(tmp_path, bsdf("conductor", GOLD + tint)).spectra
    # What light meets in one reflection.
    misses = np.abs(tinted[:, None] - plain * ramp(0.1, 0.9)).max(axis=2)
    np.testing.assert_allclose(misses.min(axis=0), 0, atol=1e-6)


# --- Unknown spectra and short tables ---
UNKNOWN = {
    "principled": (bsdf("principled"), "a BSDF 'principled' with unknown spectra"),
    "within another": (bsdf("twosided", bsdf("principled")), "a BSDF 'principled'"),
    "a mesh's colours": (
        bsdf(
            "diffuse",
            (
                '<texture type="mesh_attribute" name="reflectance"><string name="name"'
                ' value="vertex_c"/></texture>'
            ),
        ),
        "an unknown texture in reflectance of a diffuse",
    ),
    "a table out of order": (
        bsdf("diffuse", table("reflectance", "500, 400, 600", "1, 0, 0.5")),
        "an unknown texture in reflectance",
    ),
    "one node": (
        bsdf("diffuse", table("reflectance", "500", "1")),
        "an unknown texture in reflectance of a diffuse",
    ),
    "a picture of indices": (
        bsdf(
            "conductor",
            bitmap("true").replace('name="reflectance"', 'name="eta"') + RAMP.format("k", 3, 2),
        ),
        "an unknown refractive index of a conductor",
    ),
}


@pytest.mark.parametrize(("body", "reason"), UNKNOWN.values(), ids=UNKNOWN)
def test_find_surfaces_unknown_spectra_state_reason(body: str, reason: str, tmp_path: Path) -> None:
    result = surfaces_of(tmp_path, bsdf("diffuse", RGB), body)
    assert result.spectra is None
    assert reason in result.unknown
    assert result.products(-1).shape == (0, 471)


@pytest.mark.parametrize(
    ("nodes", "values", "short"),
    [
        ("400, 600", "0.5, 0.7", ["400-600 nm"]),
        ("300, 829", "0.5, 0.7", ["300-829 nm"]),
        ("361, 1000", "0.5, 0.7", ["361-1000 nm"]),
        ("300, 320", "0.5, 0.7", ["300-320 nm"]),
        ("400, 500, 600", "0, 0.7, 0", []),  # 0 at the ends
        ("360, 830", "0.5, 0.7", []),
        ("300, 1000", "0.5, 0.7", []),
    ],
)
def test_find_surfaces_short_tables_are_listed(nodes, values, short, tmp_path):
    result = surfaces_of(tmp_path, bsdf("diffuse", table("reflectance", nodes, values)))
    assert result.short == set(short)
    low, high = float(nodes.split(",")[0]), float(nodes.split(",")[-1])
    is_inside = (low <= NM) & (high >= NM)
    largest = result.spectra.max(axis=0, initial=0)  # no spectrum: 0 at all wavelengths
    assert not largest[~is_inside].any()  # as Mitsuba
    assert not is_inside.any() or largest[is_inside].max() > 0.5


RISING = RAMP.format("reflectance", 0.1, 0.9)
ONE = bsdf("diffuse", RISING)
CHECKERBOARD = '<texture type="checkerboard" name="reflectance">{}</texture>'
# name: (BSDFs, the spectra that light is multiplied with)
SPECTRA = {
    **{name: (bsdfs, []) for name, bsdfs in NEUTRAL.items()},
    "a table of pairs": ((ONE,), [ramp(0.1, 0.9)]),
    "a table": ((bsdf("diffuse", table("reflectance", "360, 830", "0.1, 0.9")),), [ramp(0.1, 0.9)]),
    "equal tables": ((ONE, ONE, bsdf("twosided", ONE)), [ramp(0.1, 0.9)]),
    "nested": (
        (
            bsdf("mask", f'<float name="opacity" value="0.5"/>{ONE}'),
            bsdf(
                "blendbsdf",
                f'<float name="weight" value="0.3"/>{bsdf("twosided", ONE)}{bsdf("diffuse")}',
            ),
        ),
        [ramp(0.1, 0.9)],
    ),
    "coloured glass": (
        (bsdf("dielectric", RAMP.format("specular_transmittance", 0.1, 0.9)),),
        [ramp(0.1, 0.9)],
    ),
    "a checkerboard": (
        (
            bsdf(
                "diffuse",
                CHECKERBOARD.format(
                    (RAMP.format("color0", 0.9, 0.2) + RAMP.format("color1", 0.1, 0.9))
                ),
            ),
        ),
        [ramp(0.9, 0.2), ramp(0.1, 0.9)],
    ),
    **{
        plugin: (
            (bsdf(plugin, RAMP.format("diffuse_reflectance", 0.1, 0.9)),),
            [ramp(0.1, 0.9), coated(ramp(0.1, 0.9))],
        )
        for plugin in ("plastic", "roughplastic")
    },
}


@pytest.mark.parametrize("name", SPECTRA)
def test_spectra_of_surfaces(name: str, tmp_path: Path) -> None:
    # Neutral ones are left out, equal ones count once; eight digits: the parser's floats.
    bsdfs, expected = SPECTRA[name]
    surfaces = surfaces_of(tmp_path, *bsdfs)
    assert (surfaces.unknown, surfaces.short) == ("", set())
    np.testing.assert_allclose(surfaces.spectra, np.reshape(expected, (-1, 471)), rtol=1e-6)


@pytest.mark.parametrize("count", [1, 3, 30])
@pytest.mark.parametrize("bounces", [1, 2, 3, 8, -1])
def test_products_of_surfaces(count: int, bounces: int) -> None:
    """Powers to the third, sums of light that goes to and fro, and pairs, of which at most 160 are
    taken.
    """
    single = np.random.default_rng(0).uniform(0, 1, (count, 471))
    expected = [single**power for power in range(1, (3 if bounces < 0 else min(bounces, 3)) + 1)]
    if bounces < 0:
        expected += [single / (1 - share * single) for share in (0.5, 0.8, 0.95)]
    pairs = min(count * (count - 1) // 2, 160) if bounces != 1 else 0
    rows = Surfaces(single).products(bounces)
    assert len(rows) == len(expected) * count + pairs
    if pairs:
        expected.append(single[[0, -2]] * single[[1, -1]])
    assert max([np.abs(rows - row).max(axis=1).min() for row in np.concatenate(expected)]) < 1e-12


@VARIANTS
def test_find_surfaces_rgb_is_the_published_model(variant: str, tmp_path: Path) -> None:
    # Jakob & Hanika (2019): a sigmoid ½ + x/(2√(1+x²)) of a parabola x in λ, whose inverse has no
    # other part than float32; it has the colour, to the 2 % that the model's table reaches.
    (rho,) = surfaces_of(tmp_path, bsdf("diffuse", RGB), variant=variant).spectra
    x = (2 * rho - 1) / (2 * np.sqrt(rho * (1 - rho)))
    np.testing.assert_allclose(np.polynomial.Polynomial.fit(NM, x, 2)(NM), x, atol=1e-4 * np.ptp(x))
    observer = colour_matching(NM)
    xyz = (rho * d65(NM)) @ observer / (d65(NM) @ observer[:, 1])
    np.testing.assert_allclose(np.linalg.solve(XYZ_OF_SRGB, xyz), [0.2, 0.5, 0.1], atol=0.01)


# IEC 61966-2-1: columns are the XYZ of red, green and blue
XYZ_OF_SRGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
