"""Light of 300 to 1100 nm: the range follows lamps and response, electrons are those of the closed
form, and what ends within the range is said.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import NEEDS_LLVM, VARIANT, lens_xml, scene_file, sensor_xml
from PIL import Image

import pixsim
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import camera_factor
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.scene.contents import planck
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import ideal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

CASES = Path(__file__).parents[1] / "data/cases"
CAMERA = Camera(f_number=4.0)
FLAT = Pixel(
    technology="4t-bsi",
    pitch_um=10.0,
    quantum_efficiency=[[300, 0.5], [1100, 0.5]],
    stack={"enabled": False},
)
PLANE = (
    '<transform name="to_world"><scale value="3"/><lookat origin="0,0,1" target="0,0,0"'
    ' up="0,1,0"/></transform>'
)
BLACK_BODY = (
    '<spectrum type="blackbody" name="radiance"><float name="temperature" value="2856"/></spectrum>'
)
UNIFORM = '<spectrum name="radiance" value="300:1, 1100:1"/>'
NM = np.linspace(300, 1100, 80_001)


def lamp(spectrum: str) -> str:
    return f'<shape type="rectangle">{PLANE}<emitter type="area">{spectrum}</emitter></shape>'


def wall(inside: str, spectrum: str = UNIFORM, plugin: str = "diffuse") -> str:
    bsdf = f'<bsdf type="{plugin}" id="paint">{inside}</bsdf>'
    shape = f'<shape type="rectangle">{PLANE}{bsdf}</shape>'
    return f'<emitter type="constant">{spectrum}</emitter>{shape}'


def scene_of(folder: Path, body: str, variant: str = VARIANT, **parameters: Any) -> Scene:
    # A wall has noise, from directions of the light; a lamp has none.
    spp = 1024 if "constant" in body else 16
    sensor = sensor_xml(lens_xml(38, focus_m=1), spp=spp)
    path = scene_file(folder, '<integrator type="path"/>', sensor, body)
    return pixsim.load_scene(path, variant=variant, **parameters)


def rendered(scene: Scene, pixel: Pixel = FLAT, full: bool = False) -> tuple[Plan, SpectralImage]:
    plan = make_render_plan(scene, CAMERA, pixel, full=full)
    return plan, pixsim.render(scene, CAMERA, plan=plan)


def electrons(nm: np.ndarray, radiance: np.ndarray, image: SpectralImage) -> float:
    """Electrons s⁻¹ µm⁻² of an efficiency of 0.5 in the sample beside the axis."""
    tangent = np.hypot(0.5, 0.5) * image.pitch_um / 1e3 / CAMERA.image_distance_mm
    factor = float(irradiance_factor(CAMERA.f_number, tangent, CAMERA.magnification))
    return float(0.5e-12 * factor * np.trapezoid(radiance * photons_per_joule(nm), nm))


@pytest.mark.parametrize("at_nm", [310.0, 700.0, 829.9, 835.0, 940.0, 1090.0])
def test_lines_have_the_electrons_of_the_closed_form(at_nm: float, tmp_path: Path) -> None:
    line = f'<spectrum name="radiance" value="{at_nm - 1}:0, {at_nm}:1, {at_nm + 1}:0"/>'
    plan, image = rendered(scene_of(tmp_path, lamp(line)))
    nm = np.linspace(at_nm - 1, at_nm + 1, 4001)
    expected = electrons(nm, 1 - np.abs(nm - at_nm), image)
    assert ideal_rate(image, derive(FLAT))[4, 4] == pytest.approx(expected, rel=1e-4)
    ends_nm = (300 if at_nm < 360 else 360, 1100 if at_nm + 1 > 830 else 830)
    assert tuple(plan.light.bands.edges_nm[[0, -1]]) == ends_nm


def test_black_body_has_no_step_at_830_nm(tmp_path: Path) -> None:
    # As Planck has it; the curvature of its logarithm changes by 2e-4 at 600 nm, and a step of 0.03
    # % would change it by as much.
    _, image = rendered(scene_of(tmp_path, lamp(BLACK_BODY)))
    nm = image.wavelength_nm
    power = image.mean_spectrum() * image.band_width_nm
    edges_nm = 300 + np.concatenate([[0.0], np.cumsum(image.band_width_nm)])
    beyond = np.clip((edges_nm[1:] - 830) / image.band_width_nm, 0, 1)
    light = planck(NM, 2856)
    expected = light[NM > 830].sum() / light.sum()
    assert (power * beyond).sum() / power.sum() == pytest.approx(expected, abs=2e-4)
    spectrum = image.mean_spectrum()[(nm > 600) & (nm < 1090)]
    assert np.abs(np.diff(np.log(spectrum), 3)).max() < 3e-4


@pytest.mark.parametrize(
    ("variant", "full"),
    [(VARIANT, False), pytest.param("llvm_ad_spectral", True, marks=NEEDS_LLVM)],
)
def test_surfaces_of_many_passes_have_the_electrons_of_the_closed_form(
    variant: str, full: bool, tmp_path: Path
) -> None:
    # A reflectance that rises steeply, against ∫ρ L λ/hc: the plan's tolerance is 1e-3, and the
    # noise of 64 cells 3e-4. Passes are traced together, or one by one.
    steps = {300: 0.05, 600: 0.1, 620: 0.9, 700: 0.2, 720: 0.8, 900: 0.1, 920: 0.9, 1100: 0.3}
    table = ", ".join(f"{nm}:{value}" for nm, value in steps.items())
    body = wall(f'<spectrum name="reflectance" value="{table}"/>')
    plan, image = rendered(scene_of(tmp_path, body, variant), full=full)
    assert (plan.light.passes < plan.light.full_passes) != full
    fall_off = camera_factor(CAMERA, image.shape, image.pitch_um)
    rate = (ideal_rate(image, derive(FLAT)) / fall_off).mean() * fall_off[4, 4]
    expected = electrons(NM, np.interp(NM, [*steps], [*steps.values()]), image)
    assert rate == pytest.approx(expected, rel=2e-3)


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
    body = wall(reflectance)
    with pytest.raises(pixsim.PixsimError, match=r"'paint'.*beyond_tables.*infrared_cut_nm"):
        rendered(scene_of(tmp_path, body))
    spectra = []
    for beyond in ("hold", "zero"):
        plan, image = rendered(scene_of(tmp_path, body, beyond_tables=beyond))
        assert not plan.warnings
        spectrum = image.mean_spectrum()
        spectra.append(np.interp([790.0, 900.0, 1090.0], image.wavelength_nm, spectrum))
    assert spectra[0][1:] == pytest.approx(spectra[0][0], rel=0.05)
    assert np.abs(spectra[1][1:]).max() < 0.02 * spectra[0][0]

    # A filter, and a lamp that begins where the table does
    cut = FLAT.model_copy(update={"infrared_cut_nm": 830.0})
    visible = wall(reflectance, '<spectrum name="radiance" value="360:1, 1100:1"/>')
    plan, _ = rendered(scene_of(tmp_path, visible), cut)
    assert plan.light.bands.edges_nm[-1] == 830


# --- Light that ends ---


def warnings_of(
    scene: Scene, *table: tuple[float, float], cut_nm: float | None = None
) -> list[str]:
    """Return the warnings of a plan for a pixel of this quantum efficiency."""
    efficiency = {"quantum_efficiency": [list(point) for point in table], "infrared_cut_nm": cut_nm}
    plan = make_render_plan(scene, pixel=Pixel.model_validate(FLAT.model_dump() | efficiency))
    return [str(note) for note in plan.warnings]


def percent_in(warning: str, before: str) -> float:
    return float(warning.partition(before)[2].partition("%")[0])


@pytest.mark.parametrize(("end_nm", "percent"), [(830.0, 24.6), (1100.0, 49.5)])
def test_light_that_a_sky_lacks_is_said_with_its_share(end_nm: float, percent: float) -> None:
    # Of a black body of 5772 K beyond 720 nm, in an equal response from 360 nm on; cells of 10 nm
    # move it by .1 %. A filter keeps it out.
    scene = pixsim.load_scene(CASES / "4-03-sunsky-ends-at-720/sky.xml", variant=VARIANT)
    (warning,) = warnings_of(scene, (360, 0.5), (end_nm, 0.5))
    assert percent_in(warning, "K), ") == pytest.approx(percent, abs=0.15)
    assert not warnings_of(scene, (300, 0.5), (end_nm, 0.5), cut_nm=700.0)


SQUARES = 830**2 - 360**2
LAMPS = {
    "420:1, 640:1": {"begins at 420": 420**2 - 360**2, "ends at 640": 830**2 - 640**2},
    "360:1, 830:1": {},
    "420:0, 430:1, 640:1, 650:0": {},
    "540:1, 560:1": {},  # a line
}


@pytest.mark.parametrize("table", LAMPS)
def test_lamps_that_end_in_the_visible_are_said_with_their_share(
    table: str, tmp_path: Path
) -> None:
    """Held at its last values in an even response, a lamp has photons in proportion to the
    difference of squared ends.
    """
    spectrum = f'<spectrum name="radiance" value="{table}"/>'
    warnings = warnings_of(scene_of(tmp_path, wall("", spectrum)), (300, 0.5), (1100, 0.5))
    assert len(warnings) == len(LAMPS[table])
    for warning, (words, share) in zip(warnings, LAMPS[table].items(), strict=True):
        assert words in warning
        assert percent_in(warning, "so, ") == pytest.approx(100 * share / SQUARES, abs=1.0)


def test_a_picture_of_light_beside_a_lamp_that_goes_on_is_said(tmp_path: Path) -> None:
    """An RGB picture has no light beyond 830 nm, to which a black body takes the range."""
    Image.fromarray(np.full((4, 8, 3), 100, np.uint8)).save(tmp_path / "sky.png")
    sky = '<emitter type="envmap"><string name="filename" value="sky.png"/></emitter>'
    assert not warnings_of(scene_of(tmp_path, sky), (300, 0.5), (1100, 0.5))
    warnings = warnings_of(scene_of(tmp_path, sky + lamp(BLACK_BODY)), (300, 0.5), (1100, 0.5))
    assert any("'envmap'" in warning for warning in warnings)


def test_a_metal_that_ends_is_what_mitsuba_makes_of_it(tmp_path: Path) -> None:
    body = wall("", plugin="conductor")
    with pytest.raises(pixsim.PixsimError, match="the metal of 'paint'"):
        rendered(scene_of(tmp_path, body))
    plan, _ = rendered(scene_of(tmp_path, body, beyond_tables="hold"))
    assert any("the metal of 'paint'" in note for note in plan.warnings)
