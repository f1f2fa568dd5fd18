"""Light of 300 to 1100 nm: the range follows lamps and response, electrons are those of the closed
form, and nothing is guessed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics import irradiance_factor
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import camera_factor
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.sensor.integration import diffracted_rates, ideal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

CAMERA = Camera(f_number=4.0)
FLAT = Pixel(
    technology="4t-bsi",
    pitch_um=10.0,
    quantum_efficiency=[[300, 0.5], [1100, 0.5]],
    stack={"enabled": False},
)
CUT = FLAT.model_copy(update={"infrared_cut_nm": 830.0})
SCENE = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="thinlens"><float name="fov" value="38"/><float name="aperture_radius" value="0.0005"/>
<float name="focus_distance" value="1"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform>
<sampler type="multijitter"><integer name="sample_count" value="SPP"/></sampler>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
BODY</scene>"""
PLANE = (
    '<transform name="to_world"><scale value="3"/><lookat origin="0,0,1" target="0,0,0"'
    ' up="0,1,0"/></transform>'
)
BLACK_BODY = (
    '<spectrum type="blackbody" name="radiance"><float name="temperature" value="2856"/></spectrum>'
)
FROM_360 = '<spectrum name="radiance" value="360:1, 1100:1"/>'
EVEN = '<spectrum name="radiance" value="300:1, 1100:1"/>'


def lamp(spectrum: str) -> str:
    return f'<shape type="rectangle">{PLANE}<emitter type="area">{spectrum}</emitter></shape>'


def wall(reflectance: str, spectrum: str = EVEN) -> str:
    bsdf = f'<bsdf type="diffuse" id="paint">{reflectance}</bsdf>'
    return (
        f'<emitter type="constant">{spectrum}</emitter><shape'
        f' type="rectangle">{PLANE}{bsdf}</shape>'
    )


def rendered(
    folder: Path, body: str, pixel: Pixel = FLAT, variant: str = "scalar_spectral", **more: Any
) -> tuple[Plan, SpectralImage]:
    # A wall has noise, from directions of the light; a lamp has none.
    text = SCENE.replace("BODY", body).replace("SPP", "1024" if "constant" in body else "16")
    (folder / "scene.xml").write_text(text, encoding="utf-8")
    scene = pixsim.load_scene(folder / "scene.xml", variant=variant, **more)
    plan = make_render_plan(scene, CAMERA, pixel)
    return plan, pixsim.render(scene, CAMERA, plan=plan)


def electrons(nm: np.ndarray, radiance: np.ndarray, image: SpectralImage) -> float:
    """Electrons s⁻¹ µm⁻² of an efficiency of 0.5 in the sample beside the axis."""
    off_mm = float(np.hypot(0.5, 0.5)) * image.pitch_um / 1e3
    factor = float(
        irradiance_factor(CAMERA.f_number, off_mm / CAMERA.image_distance_mm, CAMERA.magnification)
    )
    return float(0.5e-12 * factor * np.trapezoid(radiance * photons_per_joule(nm), nm))


@pytest.mark.parametrize("at_nm", [310.0, 700.0, 825.0, 829.9, 835.0, 850.0, 940.0, 1090.0])
def test_lines_have_the_electrons_of_the_closed_form(at_nm: float, tmp_path: Path) -> None:
    line = f'<spectrum name="radiance" value="{at_nm - 1}:0, {at_nm}:1, {at_nm + 1}:0"/>'
    plan, image = rendered(tmp_path, lamp(line))
    nm = np.linspace(at_nm - 1, at_nm + 1, 4001)
    assert ideal_rate(image, derive(FLAT))[4, 4] == pytest.approx(
        electrons(nm, 1 - np.abs(nm - at_nm), image), rel=1e-4
    )
    edges_nm = plan.light.bands.edges_nm
    assert (edges_nm[0], edges_nm[-1]) == (
        300 if at_nm < 360 else 360,
        1100 if at_nm + 1 > 830 else 830,
    )


def test_black_body_has_no_step_at_830_nm(tmp_path: Path) -> None:
    """At 2856 K, 56.0 % of the power and 64.4 % of the photons between 300 and 1100 nm lie beyond
    830 nm, as Planck has them.
    """
    _, image = rendered(tmp_path, lamp(BLACK_BODY))
    nm, spectrum, width = image.wavelength_nm, image.mean_spectrum(), image.band_width_nm
    edges = 300 + np.concatenate([[0.0], np.cumsum(width)])
    beyond = np.clip((edges[1:] - 830) / width, 0, 1)
    power, photons = spectrum * width, spectrum * width * photons_per_joule(nm)
    at = np.linspace(300, 1100, 80_001)
    planck = at**-5 / np.expm1(1.438776877e7 / (at * 2856))
    for found, right in ((power, planck), (photons, planck * at)):
        assert (found * beyond).sum() / found.sum() == pytest.approx(
            right[at > 830].sum() / right.sum(), abs=2e-4
        )
    assert planck[at > 830].sum() / planck.sum() == pytest.approx(0.560, abs=1e-3)
    curvature = np.diff(np.log(spectrum[(nm > 600) & (nm < 1090)]), 2)
    assert (
        np.abs(np.diff(curvature)).max() < 3e-4
    )  # 2e-4 at 600 nm, and a step of 0.03 % would be as much


def test_surfaces_of_many_passes_have_the_electrons_of_the_closed_form(tmp_path: Path) -> None:
    """A reflectance that rises steeply, against ∫ρ L λ/hc: the plan's tolerance is 1e-3, and the
    noise of 64 cells 3e-4.
    """
    steps = {300: 0.05, 600: 0.1, 620: 0.9, 700: 0.2, 720: 0.8, 900: 0.1, 920: 0.9, 1100: 0.3}
    table = ", ".join(f"{nm}:{value}" for nm, value in steps.items())
    few, image = rendered(tmp_path, wall(f'<spectrum name="reflectance" value="{table}"/>'))
    assert few.light.passes < few.light.full_passes
    nm = np.linspace(300, 1100, 80_001)
    expected = electrons(nm, np.interp(nm, [*steps], [*steps.values()]), image)
    fall_off = camera_factor(CAMERA, image.shape, image.pitch_um)
    assert float((ideal_rate(image, derive(FLAT)) / fall_off).mean()) * fall_off[
        4, 4
    ] == pytest.approx(expected, rel=2e-3)


def test_diffraction_ends_at_its_cut_off_in_the_infrared() -> None:
    """Of detail of 940 nm behind f/8: none beyond 1/(λ N)."""
    side, pitch_um, camera = 256, 1.0, Camera(f_number=8.0, object_distance_m=1e6)
    limit = 1 / (0.94 * camera.effective_f_number)  # cycles/µm
    contrasts = []
    for cycles in (round(side * limit * share) for share in (0.5, 1.02)):
        wave = 1 + 0.5 * np.cos(np.pi * 2 * cycles * (np.arange(side) + 0.5) / side)
        image = SpectralImage(
            [940.0], 10.0, pitch_um, data=np.tile(wave[:, None, None], (1, 16, 1))
        )
        rate = diffracted_rates(image, camera, [derive(FLAT)])[0][:, 8]
        contrasts.append(np.ptp(rate) / rate.mean())
    assert contrasts[0] == pytest.approx(
        2 / np.pi * (np.arccos(0.5) - 0.5 * np.sqrt(0.75)), rel=0.02
    )
    assert contrasts[1] < 1e-6


@pytest.mark.parametrize(
    "reflectance",
    [
        '<spectrum name="reflectance" value="350:0.3, 800:0.3"/>',
        '<rgb name="reflectance" value=".5, .2, .1"/>',
    ],
)
def test_surfaces_that_end_are_refused_or_what_the_user_says(
    reflectance: str, tmp_path: Path
) -> None:
    refused = r"reflectance of 'paint'.*-8[03]0 nm, under a lamp.*beyond_tables.*infrared_cut_nm"
    with pytest.raises(pixsim.PixsimError, match=refused):
        rendered(tmp_path, wall(reflectance))
    held, image = rendered(tmp_path, wall(reflectance), beyond_tables="hold")
    _, dark = rendered(tmp_path, wall(reflectance), beyond_tables="zero")
    spectra = {"h": image.mean_spectrum(), "z": dark.mean_spectrum()}
    held_nm, dark_nm = image.wavelength_nm, dark.wavelength_nm
    at_800 = float(np.interp(790.0, held_nm, spectra["h"]))
    assert np.interp([900.0, 1090.0], held_nm, spectra["h"]) == pytest.approx(
        [at_800] * 2, rel=0.05
    )
    assert np.abs(np.interp([900.0, 1090.0], dark_nm, spectra["z"])).max() < 0.02 * at_800
    assert not held.warnings
    cut, visible = rendered(tmp_path, wall(reflectance, FROM_360), CUT)
    assert cut.light.bands.edges_nm[-1] == 830
    assert visible.wavelength_nm[-1] < 830


def test_what_nobody_can_say_is_told_where_the_user_goes_on(tmp_path: Path) -> None:
    body = wall("").replace(
        '<bsdf type="diffuse" id="paint"></bsdf>', '<bsdf type="conductor" id="mirror"/>'
    )
    with pytest.raises(pixsim.PixsimError, match="the metal of 'mirror'"):
        rendered(tmp_path, body)
    plan, _ = rendered(tmp_path, body, beyond_tables="hold")
    assert any(
        "what Mitsuba makes of them: the metal of 'mirror'" in note for note in plan.warnings
    )
    mixed = wall('<spectrum name="reflectance" value="0.5"/>', BLACK_BODY) + lamp(
        '<rgb name="radiance" value="1, 1, 1"/>'
    )
    plan, _ = rendered(tmp_path, mixed)
    assert any("ends at 830 nm, where it is not 0" in note for note in plan.warnings)
    with pytest.raises(
        pixsim.PixsimError, match=r"scene\.beyond_tables: got 'keep'; allowed: 'hold' or 'zero'"
    ):
        rendered(tmp_path, body, beyond_tables="keep")
