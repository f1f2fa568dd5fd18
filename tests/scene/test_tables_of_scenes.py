"""What cannot be in the spectra of a scene: wavelengths in another unit, reflectances above 1."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_rows
from pixsim.scene.guard.assets import spectrum_value
from pixsim.scene.guard.inspector import open_scene
from pixsim.scene.packaged import packaged_folder
from pixsim.scene.plan import Plan, make_render_plan

CASES = Path(__file__).parents[1] / "data/cases"
SCENE = '<scene version="3.0.0"><shape type="sphere"><bsdf type="{}">{}</bsdf></shape></scene>'


def scene_of(folder: Path, inside: str, bsdf: str = "diffuse") -> Path:
    path = folder / "scene.xml"
    path.write_text(SCENE.format(bsdf, inside), encoding="utf-8")
    return path


LIT = (
    '<sensor type="thinlens"><float name="fov" value="40"/><float name="aperture_radius"'
    ' value="0.001"/><float name="focus_distance" value="1"/><film type="hdrfilm"><integer'
    ' name="width" value="8"/><integer name="height" value="8"/></film></sensor><emitter'
    ' type="constant"/>'
)


def plan(path: Path) -> Plan:
    """Return the plan of a scene, with the sensor and the lamp of `LIT` if it has none."""
    text = path.read_text(encoding="utf-8")
    if "<sensor" not in text:
        path.write_text(text.replace("</scene>", f"{LIT}</scene>"), encoding="utf-8")
    return make_render_plan(pixsim.load_scene(path, variant="scalar_spectral"))


def test_wavelengths_in_another_unit_are_named(tmp_path: Path) -> None:
    for path in (
        CASES / "31-xml-variants/spd_um.xml",
        scene_of(tmp_path, '<spectrum name="reflectance" value="0.4:.5, 0.8:.5"/>'),
    ):
        with pytest.raises(
            PixsimError, match=r"seem to be in µm\. Multiply wavelengths in µm by 1000"
        ):
            plan(path)
    angstrom = scene_of(tmp_path, '<spectrum name="reflectance" value="4000:.5, 8000:.5"/>')
    with pytest.raises(PixsimError, match="seem to be in Å"):
        plan(angstrom)
    infrared = scene_of(tmp_path, '<spectrum name="reflectance" value="850:.5, 1700:.5"/>')
    assert "850:.5" in open_scene(infrared, {}).text


def test_units_of_a_file_of_light_are_obeyed(tmp_path: Path) -> None:
    lamp = '<emitter type="constant"><spectrum name="radiance" filename="a.spd"/></emitter>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{lamp}</scene>', encoding="utf-8")
    (tmp_path / "a.spd").write_text(
        "wavelength (µm)\tradiance (mW/m^2/sr/nm)\n0,4\t25\n0,7\t5\n", encoding="latin-1"
    )
    assert 'value="400:0.025, 700:0.005"' in open_scene(tmp_path / "scene.xml", {}).text


def test_packaged_spectra_have_their_names_in_every_scene_and_its_own_files_come_first(
    tmp_path: Path,
) -> None:
    lamp = (
        '<emitter type="constant"><spectrum name="radiance"'
        ' filename="spectra/led_850nm.spd"/></emitter>'
    )
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{lamp}</scene>', encoding="utf-8")
    assert (
        spectrum_value(packaged_folder() / "spectra/led_850nm.spd")
        in open_scene(tmp_path / "scene.xml", {}).text
    )
    (tmp_path / "spectra").mkdir()
    (tmp_path / "spectra/led_850nm.spd").write_text("400 1\n500 1\n", encoding="utf-8")
    assert 'value="400:1, 500:1"' in open_scene(tmp_path / "scene.xml", {}).text


INSIDE = {
    "a number": ("diffuse", '<float name="reflectance" value="{}"/>'),
    "a table": ("diffuse", '<spectrum name="reflectance" value="360:{0}, 830:{0}"/>'),
    "a file": ("plastic", '<spectrum name="diffuse_reflectance" filename="a.spd"/>'),
    "a texture": (
        "diffuse",
        '<texture type="uniform" name="reflectance"><float name="value" value="{}"/></texture>',
    ),
    "a checkerboard": (
        "diffuse",
        (
            '<texture type="checkerboard" name="reflectance"><spectrum name="color0"'
            ' value="{}"/></texture>'
        ),
    ),
    "a regular table": (
        "diffuse",
        (
            '<spectrum type="regular" name="reflectance"><float name="wavelength_min"'
            ' value="360"/><float name="wavelength_max" value="830"/><string name="values"'
            ' value="{0}, {0}"/></spectrum>'
        ),
    ),
}


@pytest.mark.parametrize("kind", INSIDE)
def test_reflectance_above_1_is_warned_of_and_above_1_5_refused_with_its_place(
    kind: str, tmp_path: Path
) -> None:
    bsdf, inside = INSIDE[kind]

    def judge(value: float) -> None:
        (tmp_path / "a.spd").write_text(f"400 {value}\n700 {value}\n", encoding="utf-8")
        plan(scene_of(tmp_path, inside.format(value), bsdf))

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        judge(1.0)
    with pytest.warns(UserWarning, match=r"diffuse_reflectance|reflectance is 1\.02 in bsdf a"):
        judge(1.02)
    with pytest.raises(
        PixsimError, match=r"50 in bsdf a .*; allowed: up to 1.*In per cent\? Divide by 100: 0\.5"
    ):
        judge(50)


REFERRED = {
    "a table": (
        '<spectrum type="irregular" id="paint"><string name="wavelengths" value="400 700"/>'
        '<string name="values" value="{0} {0}"/></spectrum>'
    ),
    "a number": '<texture type="uniform" id="paint"><float name="value" value="{}"/></texture>',
    "a checkerboard": (
        '<texture type="checkerboard" id="paint"><spectrum name="color1" value="400:{0},'
        ' 700:{0}"/></texture>'
    ),
    "a part of one": (
        '<texture type="uniform" id="part"><float name="value" value="{}"/></texture>'
        '<texture type="checkerboard" id="paint"><ref name="color0" id="part"/></texture>'
    ),
    "an alias": (
        '<texture type="uniform" id="part"><float name="value" value="{}"/></texture><alias'
        ' id="part" as="paint"/>'
    ),
}


@pytest.mark.parametrize("kind", REFERRED)
@pytest.mark.parametrize("before", [True, False])
def test_reflectance_by_reference_is_checked(kind: str, before: bool, tmp_path: Path) -> None:
    shape = (
        '<shape type="sphere"><bsdf type="diffuse"><ref name="reflectance"'
        ' id="paint"/></bsdf></shape>'
    )

    def judge(value: float, used: str = shape) -> None:
        texture = f"\n{REFERRED[kind].format(value)}\n"
        parts = texture + used if before or "<alias" in texture else used + texture
        (tmp_path / "scene.xml").write_text(
            f'<scene version="3.0.0">{parts}</scene>', encoding="utf-8"
        )
        plan(tmp_path / "scene.xml")

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        judge(1.0)
        judge(
            50, '<emitter type="constant"><ref name="radiance" id="paint"/></emitter>'
        )  # light has any number
    with pytest.warns(UserWarning, match=r"reflectance is 1\.02 in bsdf a diffuse"):
        judge(1.02)
    with pytest.raises(
        PixsimError,
        match=r"50 in bsdf a diffuse; allowed: up to 1.*In per cent\? Divide by 100: 0\.5",
    ):
        judge(50)


def test_file_in_per_cent_is_a_share(tmp_path: Path) -> None:
    (tmp_path / "a.spd").write_text("nm;reflectance (%)\n400;50\n700;62,5\n", encoding="utf-8")
    path = scene_of(tmp_path, '<spectrum name="reflectance" filename="a.spd"/>')
    assert 'value="400:0.50, 700:0.625"' in open_scene(path, {}).text


@pytest.mark.parametrize("name", ["reflectance", "color0"])
def test_picture_of_a_reflectance_above_1_5_is_refused(name: str, tmp_path: Path) -> None:
    """A picture has no numbers in the XML: it is judged by what Mitsuba reads."""
    table = '<spectrum name="reflectance" value="360:50, 830:50"/>'
    picture = (
        f'<texture type="bitmap" name="{name}"><string name="filename" value="a.exr"/><boolean'
        ' name="raw" value="true"/></texture>'
    )
    if name == "color0":
        picture = f'<texture type="checkerboard" name="reflectance">{picture}</texture>'
    text = (CASES / "39-xml-reflectance-percent/full.xml").read_text(encoding="utf-8")
    assert table in text
    (tmp_path / "flat.xml").write_text(text.replace(table, picture), encoding="utf-8")
    for value, raises in ((50.0, True), (1.0, False)):
        texels = np.full((2, 2), value, np.float32)
        write_rows(tmp_path / "a.exr", {"Y": lambda rows, texels=texels: texels[rows]}, (2, 2), {})
        with (
            pytest.raises(PixsimError, match=r"diffuse\.reflectance: got 50 in 'a\.exr'")
            if raises
            else nullcontext()
        ):
            pixsim.render(
                pixsim.load_scene(tmp_path / "flat.xml", variant="scalar_spectral").with_resolution(
                    4
                )
            )


@pytest.mark.parametrize("name", ["full", "refl_percent"])
def test_reflectance_in_per_cent_of_a_whole_scene_is_refused(name: str) -> None:
    with pytest.raises(PixsimError, match=r"diffuse\.reflectance: got 50 in bsdf"):
        plan(CASES / f"39-xml-reflectance-percent/{name}.xml")
