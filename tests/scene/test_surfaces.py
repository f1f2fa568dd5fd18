"""What surfaces do to a spectrum: read from the XML, against the numbers that stand in it and Fresnel's formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.scene.contents import Surfaces, find_surfaces
from pixsim.scene.variant import choose, find_llvm

NEEDS_LLVM = pytest.mark.skipif(find_llvm()[0] is None, reason="no LLVM 17 or newer here: scalar_spectral only")
VARIANTS = pytest.mark.parametrize("variant", [pytest.param("llvm_ad_spectral", marks=NEEDS_LLVM), "scalar_spectral"])
NM = np.arange(360.0, 831.0)
RAMP = '<spectrum name="{}" value="360:{}, 830:{}"/>'
RGB = '<rgb name="reflectance" value="0.2, 0.5, 0.1"/>'
GOLD = '<string name="material" value="Au"/>'
SENSOR = """<sensor type="thinlens">
    <float name="fov" value="40"/><float name="aperture_radius" value="0.0005"/><float name="focus_distance" value="0.8"/>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
</sensor>"""


@pytest.fixture(autouse=True, scope="module")
def llvm_before_mitsuba() -> None:
    choose(None)


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


def found(folder: Path, *bsdfs: str, variant: str = "scalar_spectral") -> Surfaces:
    pixsim.write_chart(folder / "grey.exr", np.full((2, 2), 0.5, np.float32))
    (folder / "eta.spd").write_text("360 0.2\n830 1.2\n")
    (folder / "k.spd").write_text("360 3\n830 2\n")
    shapes = "".join(f'<shape type="rectangle">{each}</shape>' for each in bsdfs)
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{SENSOR}{shapes}<emitter type="constant"/></scene>')
    return find_surfaces(pixsim.load_scene(path, variant=variant).parse(), variant)


def spectra(folder: Path, *bsdfs: str, variant: str = "scalar_spectral") -> np.ndarray:
    result = found(folder, *bsdfs, variant=variant)
    assert result.unknown == ""
    assert result.spectra is not None
    assert result.spectra.shape[1] == NM.size
    return result.spectra


def fresnel(eta: np.ndarray, k: np.ndarray, cosine: float) -> np.ndarray:
    """Reflectance of a metal for unpolarised light, from complex amplitudes (Born & Wolf, 14.2)."""
    index = eta + 1j * k
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return (np.abs(s) ** 2 + np.abs(p) ** 2) / 2


def coated(reflectance: np.ndarray) -> np.ndarray:
    """Light to and fro under a coat that sends 60 % back: ρ(1 + 0.6 ρ + 0.36 ρ² + …)."""
    return np.sum([reflectance * (0.6 * reflectance) ** bounce for bounce in range(60)], axis=0)


# --- What stands in the file ---

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
    "a metal of one index": (bsdf("conductor", '<spectrum name="eta" value="0.2"/><spectrum name="k" value="3"/>'),),
    "twosided": (bsdf("twosided", bsdf("diffuse")),),
    "null": (bsdf("null"),),
}


@pytest.mark.parametrize("name", NEUTRAL)
def test_neutral_surfaces_are_left_out(name, tmp_path):
    result = found(tmp_path, *NEUTRAL[name])
    assert len(result.spectra) == 0
    assert result.products(-1).shape == (0, 471)
    assert (result.unknown, result.short) == ("", ())


STRAIGHT = {
    "diffuse": bsdf("diffuse", RAMP.format("reflectance", 0.1, 0.9)),
    "irregular": bsdf("diffuse", table("reflectance", "360, 830", "0.1, 0.9")),
    "twosided": bsdf("twosided", bsdf("diffuse", RAMP.format("reflectance", 0.1, 0.9))),
    "mask": bsdf("mask", '<float name="opacity" value="0.5"/>' + bsdf("diffuse", RAMP.format("reflectance", 0.1, 0.9))),
    "checkerboard": bsdf("diffuse", f'<texture type="checkerboard" name="reflectance">{RAMP.format("color1", 0.1, 0.9)}</texture>'),
    "coloured glass": bsdf("dielectric", RAMP.format("specular_transmittance", 0.1, 0.9)),
    "a plastic's gloss": bsdf("mask", bsdf("thindielectric", RAMP.format("specular_reflectance", 0.1, 0.9))),
}


@pytest.mark.parametrize("name", STRAIGHT)
def test_a_table_is_taken_as_it_stands(name, tmp_path):
    # Eight digits: the parser's floats.
    np.testing.assert_allclose(spectra(tmp_path, STRAIGHT[name]), [ramp(0.1, 0.9)], rtol=1e-6)


@pytest.mark.parametrize("plugin", ["plastic", "roughplastic"])
def test_plastic_multiplies_its_colour_under_the_coat(plugin, tmp_path):
    result = spectra(tmp_path, bsdf(plugin, RAMP.format("diffuse_reflectance", 0.1, 0.9)))
    np.testing.assert_allclose(result, [ramp(0.1, 0.9), coated(ramp(0.1, 0.9))], rtol=1e-6)


@VARIANTS
def test_a_colour_is_mitsubas_spectrum_of_it(variant, tmp_path):
    (seen,) = spectra(tmp_path, bsdf("diffuse", RGB), variant=variant)
    # The published model (Jakob & Hanika 2019): a sigmoid of a parabola in λ, ½ + x/(2√(1+x²)), x = c0 λ² + c1 λ + c2. Its
    # inverse is a parabola, whose third differences vanish; float32 of x: 1e-5 of its range.
    x = (2 * seen - 1) / (2 * np.sqrt(seen * (1 - seen)))
    parabola = np.polynomial.Polynomial.fit(NM, x, 2)
    assert np.abs(parabola(NM) - x).max() < 1e-4 * np.ptp(x)
    # And it has the colour: under D65 its sRGB is what was asked, to the 2 % that the model's table reaches.
    import colour

    shape = colour.SpectralShape(360, 780, 1)
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    xyz = colour.sd_to_XYZ(colour.SpectralDistribution(seen[:421], NM[:421]), cmfs, d65, method="Integration") / 100
    rgb = colour.XYZ_to_RGB(xyz, "sRGB")
    np.testing.assert_allclose(rgb, [0.2, 0.5, 0.1], atol=0.01)


def test_a_checkerboard_has_both_its_colours(tmp_path):
    inside = RAMP.format("color0", 0.9, 0.2) + RAMP.format("color1", 0.1, 0.9)
    result = spectra(tmp_path, bsdf("diffuse", f'<texture type="checkerboard" name="reflectance">{inside}</texture>'))
    np.testing.assert_allclose(result, [ramp(0.9, 0.2), ramp(0.1, 0.9)], rtol=1e-6)


def test_equal_surfaces_count_once(tmp_path):
    one = bsdf("diffuse", RAMP.format("reflectance", 0.1, 0.9))
    assert len(spectra(tmp_path, one, one, bsdf("twosided", one))) == 1


# --- Metals ---

INDEX = {
    "in the file": RAMP.format("eta", 0.2, 1.2) + RAMP.format("k", 3, 2),
    "spectra": table("eta", "360, 830", "0.2, 1.2") + table("k", "360, 830", "3, 2"),
    "tables": '<spectrum name="eta" filename="eta.spd"/><spectrum name="k" filename="k.spd"/>',
}


@VARIANTS
@pytest.mark.parametrize("given", INDEX)
@pytest.mark.parametrize("plugin", ["conductor", "roughconductor"])
def test_a_metal_by_its_index_obeys_fresnel(given, plugin, variant, tmp_path):
    result = spectra(tmp_path, bsdf(plugin, INDEX[given]), variant=variant)
    assert len(result) == 3
    for seen, cosine in zip(result, (1.0, 0.7, 0.3), strict=True):
        # float32; 0.01 in eta would be 1e-3.
        np.testing.assert_allclose(seen, fresnel(ramp(0.2, 1.2), ramp(3, 2), cosine), rtol=1e-5)
    eta, k = ramp(0.2, 1.2), ramp(3, 2)
    np.testing.assert_allclose(result[0], ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2), rtol=1e-5)


@pytest.mark.parametrize(
    ("material", "at_450", "at_650"), [("Au", 0.39, 0.965), ("Cu", 0.55, 0.95), ("Ag", 0.97, 0.985), ("Al", 0.918, 0.905)]
)
def test_a_metal_by_its_name(material, at_450, at_650, tmp_path):
    normal = spectra(tmp_path, bsdf("conductor", f'<string name="material" value="{material}"/>'))[0]
    # Handbook reflectances (CRC, optical properties of metals), which differ by 2 to 5 % between samples.
    assert normal[NM == 450] == pytest.approx(at_450, rel=0.06)
    assert normal[NM == 650] == pytest.approx(at_650, rel=0.03)


def test_a_tinted_metal_is_the_product_of_both(tmp_path):
    plain = spectra(tmp_path, bsdf("conductor", GOLD))
    tinted = spectra(tmp_path, bsdf("conductor", GOLD + RAMP.format("specular_reflectance", 0.1, 0.9)))
    for each in plain:
        # What light meets in one reflection.
        assert np.abs(tinted - each * ramp(0.1, 0.9)).max(axis=1).min() < 1e-6


def test_nested_surfaces_are_all_found(tmp_path):
    inner = bsdf("twosided", bsdf("roughconductor", GOLD)) + bsdf("diffuse", RAMP.format("reflectance", 0.1, 0.9))
    blend = bsdf("blendbsdf", '<float name="weight" value="0.3"/>' + inner)
    result = spectra(tmp_path, bsdf("blendbsdf", '<float name="weight" value="0.5"/>' + blend + bsdf("diffuse", RGB)))
    assert len(result) == 3 + 1 + 1
    gold, colour = spectra(tmp_path, bsdf("conductor", GOLD)), spectra(tmp_path, bsdf("diffuse", RGB))
    for each in (*gold, *colour, ramp(0.1, 0.9)):
        assert np.abs(result - each).max(axis=1).min() < 1e-6


# --- What is not known, what is short ---

UNKNOWN = {
    "principled": (bsdf("principled"), "a BSDF 'principled', whose spectra pixsim does not know"),
    "within another": (bsdf("twosided", bsdf("principled")), "a BSDF 'principled'"),
    "a mesh's colours": (
        bsdf("diffuse", '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_c"/></texture>'),
        "the texture of diffuse.reflectance",
    ),
    "a table out of order": (bsdf("diffuse", table("reflectance", "500, 400, 600", "1, 0, 0.5")), "the texture of diffuse.refl"),
    "one node": (bsdf("diffuse", table("reflectance", "500", "1")), "the texture of diffuse.reflectance"),
    "a picture of indices": (
        bsdf("conductor", bitmap("false").replace('name="reflectance"', 'name="eta"') + RAMP.format("k", 3, 2)),
        "the index of conductor",
    ),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_is_not_known_is_named(name, tmp_path):
    body, reason = UNKNOWN[name]
    result = found(tmp_path, bsdf("diffuse", RGB), body)
    assert result.spectra is None
    assert result.spectra is None
    assert reason in result.unknown
    assert result.products(-1).shape == (0, 471)


@pytest.mark.parametrize(
    ("nodes", "values", "short"),
    [
        ("400, 600", "0.5, 0.7", ("400-600 nm",)),
        ("300, 829", "0.5, 0.7", ("300-829 nm",)),
        ("361, 1000", "0.5, 0.7", ("361-1000 nm",)),
        ("400, 500, 600", "0, 0.7, 0", ()),  # ends at zero: nothing is cut
        ("360, 830", "0.5, 0.7", ()),
        ("300, 1000", "0.5, 0.7", ()),
        ("300, 320", "0.5, 0.7", ("300-320 nm",)),
    ],
)
def test_short_tables_are_told(nodes, values, short, tmp_path):
    result = found(tmp_path, bsdf("diffuse", table("reflectance", nodes, values)))
    assert result.short == short
    low, high = float(nodes.split(",")[0]), float(nodes.split(",")[-1])
    outside = (low > NM) | (high < NM)
    if len(result.spectra) == 0:  # 0 at all wavelengths
        assert outside.all()
    else:
        assert not result.spectra[0, outside].any()  # as Mitsuba
        assert result.spectra[0, ~outside].max() > 0.5


# --- Several surfaces ---


def surfaces(count: int) -> Surfaces:
    return Surfaces(np.random.default_rng(0).uniform(0, 1, (count, 471)))


def holds(rows: np.ndarray, wanted: np.ndarray) -> bool:
    return bool(np.abs(rows - wanted).max(axis=1).min() < 1e-12)


def test_one_surface_is_itself():
    three = surfaces(3)
    np.testing.assert_array_equal(three.products(1), three.spectra)


@pytest.mark.parametrize(("bounces", "powers", "series"), [(2, 2, 0), (3, 3, 0), (8, 3, 0), (-1, 3, 3)])
def test_products_of_what_light_may_meet(bounces, powers, series):
    three = surfaces(3)
    a, b, c = three.spectra
    rows = three.products(bounces)
    assert len(rows) == 3 * (powers + series) + 3
    for part in (0.5, 0.8, 0.95):  # light that goes to and fro, summed
        assert holds(rows, a / (1 - part * a)) == (bounces < 0)
    for wanted in (a, b, c, a * a, b * b, c * c, a * b, a * c, b * c):
        assert holds(rows, wanted)
    for each in (a, b, c):
        assert holds(rows, each**3) == (powers == 3)


def test_products_of_one_surface():
    (a,) = surfaces(1).spectra
    np.testing.assert_allclose(surfaces(1).products(2), [a, a * a], rtol=1e-15)


def test_products_of_many_surfaces_are_sampled():
    many = surfaces(30)
    rows = many.products(2)
    assert len(rows) == 30 + 30 + 160
    assert holds(rows, many.spectra[0] * many.spectra[1])
    assert holds(rows, many.spectra[28] * many.spectra[29])
    assert len(np.unique(rows.round(12), axis=0)) == len(rows)


@NEEDS_LLVM
def test_both_variants_tell_the_same(tmp_path):
    inside = RAMP.format("color0", 0.9, 0.2) + '<rgb name="color1" value="0.6, 0.1, 0.3"/>'
    bodies = [
        bsdf("diffuse", RGB),
        bsdf("roughconductor", GOLD),
        bsdf("conductor", INDEX["in the file"]),
        bsdf("plastic", RAMP.format("diffuse_reflectance", 0.1, 0.9)),
        bsdf("diffuse", f'<texture type="checkerboard" name="reflectance">{inside}</texture>'),
    ]
    one, other = (spectra(tmp_path, *bodies, variant=variant) for variant in ("scalar_spectral", "llvm_ad_spectral"))
    assert one.shape == other.shape
    # float32, through other instructions.
    assert np.abs(one - other).max() < 1e-5
