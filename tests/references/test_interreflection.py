"""Light that walls throw on each other: an integrating sphere, whose radiance is known in closed
form.

Source: Ulbricht's sphere, a conservation law. Every patch of a sphere lights all others alike, so
that a lamp of radiance L_e that fills a cap of the share f of the sphere gives π f L_e everywhere;
walls of reflectance ρ with a black lamp raise it to π f L_e/(1 - ρ (1 - f)), and have ρ/π of that
as their radiance. A flat disc in the mouth of the cap has the cap's radiance.

Gates, two-sided, of renders through the whole path, from D65 by bands to irradiance:

- luminance within 0.6 % for walls of 0.5 and 0.9, 2.0 and 8.3 times what the lamp alone makes of
  them: 256 pixels of 1024 paths
  have 0.13 % of noise in the mean at 0.9, and so 4.5 standard errors (7e-6 false alarms, with
  another seed);
- every band within 1.2 % where the walls reflect 0.9 below 550 nm and 0.3 above, 4.5 of the 0.26 %
  of noise that a band has there.
  Every band is rendered (`full`): four pulses, from which all bands follow by default, tell so
  steep a spectrum less well.

The gates fail for paths of 8 reflections, which lose 43 % of 0.9^8, and for walls that do not light
each other.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from helpers.lamps import D65_LUMINANCE, d65_radiance
from references.gates import not_met, row

import pixsim
from pixsim.base.arrays import Array
from pixsim.optics.camera_light import camera_factor
from pixsim.scene.plan import make_plan
from pixsim.scene.scene import Scene

ULBRICHT = "integrating sphere, closed form"
RIM = 0.3  # radius of the lamp's disc over that of the sphere
CAP = (1 - (1 - RIM**2) ** 0.5) / 2  # the share f of the sphere
SCALE = 0.01  # of d65
SIDE, SPP, SPECTRAL_SPP = 16, 1024, 256
STEP_NM, BELOW, ABOVE = 550.0, 0.9, 0.3
STEP = f"360:{BELOW}, {STEP_NM - 1}:{BELOW}, {STEP_NM + 1}:{ABOVE}, 830:{ABOVE}"
SEEN_NM = (400.0, 700.0)  # bands that are judged: beyond, the lamp and the noise are small
GATE, BAND_GATE = 0.006, 0.012


def write_sphere(path: Path, reflectance: str, spp: int, depth: int = -1) -> Scene:
    """A camera in a sphere of 1 m, with a lamp behind it."""
    text = f"""<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="thinlens"><float name="fov" value="38.594975"/><float name="aperture_radius" value="0.0004825"/>
        <float name="focus_distance" value="1"/>
        <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIDE}"/><integer name="height" value="{SIDE}"/></film>
        <sampler type="multijitter"><integer name="sample_count" value="{spp}"/></sampler></sensor>
    <shape type="sphere"><boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><spectrum name="reflectance" value="{reflectance}"/></bsdf></shape>
    <shape type="disk"><transform name="to_world"><scale value="{RIM}"/><translate z="{-((1 - RIM**2) ** 0.5)}"/></transform>
        <bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>
        <emitter type="area"><texture type="d65" name="radiance"><float name="scale" value="{SCALE}"/></texture></emitter></shape>
    </scene>"""
    path.write_text(text, encoding="utf-8")
    return pixsim.load_scene(path)


def gain(reflectance: float) -> float:
    """Radiance of the wall over that of the lamp."""
    return reflectance * CAP / (1 - reflectance * (1 - CAP))


def luminance_off(path: Path, reflectance: float, depth: int = -1) -> float:
    """Rendered over expected luminance, minus 1."""
    scene = write_sphere(path, f"{reflectance}", SPP, depth)
    camera = scene.camera()
    light = pixsim.render(scene, camera, seed=1)
    seen = light.illuminance_lx() / camera_factor(camera, light.shape, light.pitch_um)
    return float(seen.mean()) / (D65_LUMINANCE * SCALE * gain(reflectance)) - 1


def band_offs(path: Path) -> Array:
    """The same of each band, for walls whose reflectance has a step."""
    scene = write_sphere(path, STEP, SPECTRAL_SPP)
    camera = scene.camera()
    light = pixsim.render(scene, camera, plan=make_plan(scene, full=True), seed=1)
    nm, half_nm = light.wavelength_nm, light.band_width_nm / 2
    judged = (np.abs(nm - STEP_NM) > half_nm + 1) & (nm > SEEN_NM[0]) & (nm < SEEN_NM[1])
    within = nm + half_nm * np.linspace(-1, 1, 41)[:, None]  # the lamp's table bends inside a band
    lamp = d65_radiance(within, D65_LUMINANCE * SCALE).mean(axis=0)
    expected = lamp * np.where(nm < STEP_NM, gain(BELOW), gain(ABOVE))
    factor_sr = float(camera_factor(camera, light.shape, light.pitch_um).mean())
    return np.asarray((light.data.mean(axis=(0, 1)) / factor_sr / expected - 1)[judged])


def luminance_row(path: Path, reflectance: float, depth: int = -1) -> dict[str, object]:
    name = (
        f"luminance in an integrating sphere of reflectance {reflectance}, rendered / closed"
        " form - 1"
    )
    return row(name, ULBRICHT, -GATE, GATE, luminance_off(path, reflectance, depth), "{:.4f}")


def band_row(path: Path) -> dict[str, object]:
    offs = band_offs(path)
    name = f"… of {BELOW} below {STEP_NM:.0f} nm and {ABOVE} above, {offs.size} bands"
    return row(name, ULBRICHT, -BAND_GATE, BAND_GATE, offs, "{:.4f}")


def rows() -> list[dict[str, object]]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sphere.xml"
        return [luminance_row(path, 0.5), luminance_row(path, 0.9), band_row(path)]


@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_integrating_sphere_has_the_luminance_of_all_reflections(
    reflectance: float, tmp_path: Path
) -> None:
    assert not not_met([luminance_row(tmp_path / "sphere.xml", reflectance)])


def test_integrating_sphere_has_the_spectrum_of_all_reflections(tmp_path: Path) -> None:
    assert not not_met([band_row(tmp_path / "sphere.xml")])


def test_eight_reflections_fail(tmp_path: Path) -> None:
    assert not_met([luminance_row(tmp_path / "sphere.xml", 0.9, 8)])
