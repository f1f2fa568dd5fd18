"""Renders against closed forms: exposure, charts, furnaces, orientation, seeds and threads, on both
CPU variants; and light of 300 to 1100 nm, whose range follows lamps and response.
"""

import os
import re
import subprocess
import sys
import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import output_of
from helpers.edits import (
    NEEDS_LLVM,
    VARIANT,
    VARIANTS,
    lens_sr,
    lens_xml,
    load,
    scene_file,
    sensor_xml,
)
from helpers.lamps import D65_LUMINANCE, d65_radiance
from helpers.processes import HANG_S
from PIL import Image

import pixsim
from pixsim.base import arrays
from pixsim.light import spectral
from pixsim.light.exr import read_channels
from pixsim.optics.camera_light import camera_factor
from pixsim.scene import charts, renderer
from pixsim.scene.contents import planck
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import ideal_rate

# --- Exposure: a flat field behind a lens ---


@pytest.mark.parametrize(
    ("variant", "f_number"),
    [pytest.param("llvm_ad_spectral", 4.0, marks=NEEDS_LLVM), (VARIANT, 8.0)],
)
def test_render_illuminance_follows_lens(variant: str, f_number: float) -> None:
    """100 cd/m² of D65, f = 6 mm at 1.2 m, on a die whose corner is 35° off axis."""
    lens = {"focal_length_mm": 6.0, "f_number": f_number, "object_distance_m": 1.2}
    corner_mm = pixsim.Camera(**lens).image_distance_mm * np.tan(np.radians(35))
    camera = pixsim.Camera(**lens, die_mm=2**0.5 * corner_mm)
    parameters = {"resolution": 65, "spp": 4, "luminance_cd_per_m2": 100}
    image = pixsim.render(pixsim.load_scene("flat", variant=variant, **parameters), camera)

    # 10 nm bands cost 0.003 % of this lamp's luminance (0.03 % of others'), the lens nothing; N
    # instead of N(1+m) is 1 % off.
    x_mm = (np.arange(65) - 32) * image.pitch_um * 1e-3
    tan_field = np.hypot(x_mm, x_mm[:, None]) / camera.image_distance_mm
    assert np.degrees(np.arctan(tan_field.max())) == pytest.approx(35, abs=0.5)
    expected_lx = 100 * pixsim.optics.irradiance_factor(f_number, tan_field, camera.magnification)
    on_axis_lx = 100 * np.pi / (1 + 4 * f_number**2 * (1 + camera.magnification) ** 2)  # π sin²α
    assert expected_lx[32, 32] == pytest.approx(on_axis_lx, rel=1e-9)
    np.testing.assert_allclose(image.illuminance_lx(), expected_lx, rtol=5e-4)


# --- Charts ---


@pytest.mark.parametrize(
    ("variant", "lens", "highest_lp_per_mm"),
    [
        pytest.param("llvm_ad_spectral", {}, 1e3 / 30, marks=NEEDS_LLVM),
        (VARIANT, {"focal_length_mm": 6, "object_distance_m": 2.5}, 25.0),
    ],
)
def test_render_csf_matches_chart(
    variant: str, lens: dict[str, float], highest_lp_per_mm: float
) -> None:
    """Its means over samples, by 4 Gauss points per axis; its frequencies hold on the sensor behind
    any lens.
    """
    node, weight = np.polynomial.legendre.leggauss(4)
    at = (np.arange(256)[:, None] + 0.5 + node / 2) / 256
    mean = charts.csf_value(0.0, 0.0)
    sine = (charts.csf_value(at, 1.0, charts.DIE_MM, highest_lp_per_mm) - mean) @ weight / 2
    contrast = charts.csf_contrast(at) @ weight / 2 / charts.csf_contrast(1.0)
    means = 1000 * (mean + contrast[:, None] * sine)

    scene = pixsim.load_scene("csf", variant=variant, max_lp_per_mm=highest_lp_per_mm)
    camera = pixsim.Camera(**lens)
    image = pixsim.render(scene.with_resolution(256), camera)
    # 16 samples of multijitter leave 0.11 %; the lowest half row of texels, whose contrast is 0.9 %
    # short, raises the whole to 0.13 %. A chart 0.2 % too large fails.
    error = image.illuminance_lx() / (means * lens_sr(image, camera)) - 1
    assert np.sqrt(np.mean(error**2)) < 2e-3
    assert np.sqrt(np.mean(error[:254] ** 2)) < 1.5e-3
    assert abs(error.mean()) < 1e-4


# --- Orientation ---


def test_render_top_left_is_kept_in_files(tmp_path: Path) -> None:
    """The fourth corner stays dark; pictures are shown without a border of two dots."""
    texels = np.full((8, 8), 0.05, np.float32)
    texels[:2, :2], texels[:2, 6:], texels[6:, :2] = 1.0, 0.6, 0.3
    pixsim.write_chart(tmp_path / "corners.exr", texels)
    out = tmp_path / "out"
    settings = "--resolution 64 --pixel.pitch-um 42.4 --display.dots 64 --irradiance full --out"
    output_of(f"run flat -D chart={tmp_path / 'corners.exr'} {settings}", out)
    pictures = {
        "irradiance.exr": pixsim.read_exr(out / "irradiance.exr").illuminance_lx(),
        "raw.exr": read_channels(out / "raw.exr")[0]["Y"],
        "ideal.png": np.asarray(Image.open(out / "ideal.png").convert("L"), float),
        "image.png": np.asarray(Image.open(out / "image.png").convert("L"), float),
    }
    for name, picture in pictures.items():
        assert picture.shape == ((60, 60) if name.endswith("png") else (64, 64)), name
        corners = [
            picture[rows, columns].mean()
            for rows in np.s_[2:12, -12:-2]
            for columns in np.s_[2:12, -12:-2]
        ]
        assert all(first > 1.2 * second for first, second in pairwise(corners)), name


# --- Seeds and threads ---


@VARIANTS
def test_render_equal_seeds_are_bit_identical(variant: str) -> None:
    # Other seeds differ by noise, measured .5 %, not by another picture: the mean is within 4
    # standard errors (false alarm 6e-5).
    scene = pixsim.load_scene("csf", variant=variant, resolution=64)
    first, again, other = (
        pixsim.render(scene, seed=seed).planes[0].astype(float) for seed in (3, 3, 5)
    )
    np.testing.assert_array_equal(first, again)
    assert 1e-4 < (first / other - 1).std() < 1e-2
    difference = (first - other).ravel()
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(difference.size)


THREADS = """
import hashlib, os, sys
all_cores = os.sched_getaffinity(0)
os.sched_setaffinity(0, {min(all_cores)})
import pixsim
scene = pixsim.load_scene("csf", variant=sys.argv[1], resolution=96, spp=16)
import drjit  # not before pixsim has chosen its LLVM
for threads in (None, 2, 3):
    if threads:
        os.sched_setaffinity(0, all_cores)
        drjit.set_thread_count(threads)
    print(hashlib.sha256(pixsim.render(scene, seed=1).factors[1].tobytes()).hexdigest())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
@NEEDS_LLVM
def test_render_threads_are_bit_identical() -> None:
    """On one core, with the threads that are started there, and then with more on all cores."""
    # Mitsuba 3.9.1 alone waits for ever for a texture where there is only one core, hence the
    # limit.
    line = [sys.executable, "-c", THREADS, "llvm_ad_spectral"]
    hashes = subprocess.run(
        line, capture_output=True, text=True, check=True, timeout=HANG_S
    ).stdout.split()
    assert (len(hashes), len(set(hashes))) == (3, 1)


# --- A general scene: a white plane that reflects ---
STEP_NM = 550.0
DARK, BRIGHT = 0.2, 0.8
REFLECTANCE = (
    f'<spectrum name="reflectance" value="360:{DARK}, 549.999:{DARK}, 550.001:{BRIGHT},'
    f' 830:{BRIGHT}"/>'
)
SKY = (
    '<emitter type="constant"><texture type="d65" name="radiance"><float name="scale"'
    ' value="0.01"/></texture></emitter>'
)
# Sampling the lobe alone, each path brings the sky times the reflectance: no noise.
EXACT = (
    '<integrator type="direct"><integer name="emitter_samples" value="0"/><integer'
    ' name="bsdf_samples" value="1"/></integrator>'
)


def plane_scene(folder: Path, body: str, integrator: str = EXACT, spp: int = 64) -> Path:
    """A Lambertian plane that fills the view of an f/2, 8 mm lens, 0.5 m away; die 2.7136 mm."""
    camera = pixsim.Camera(focal_length_mm=8, f_number=2, object_distance_m=0.5)
    lens = lens_xml(camera.fov_deg, camera.aperture_radius_m, 0.5)
    turned = (
        '<transform name="to_world"><rotate y="1" angle="180"/><translate z="0.5"/></transform>'
    )
    plane = f'<shape type="rectangle">{turned}<bsdf type="diffuse">{REFLECTANCE}</bsdf></shape>'
    return scene_file(folder, integrator, sensor_xml(lens, size=(24, 16), spp=spp), plane, body)


def reflectance_of_band(centre_nm: np.ndarray) -> np.ndarray:
    return np.where(
        centre_nm < STEP_NM, DARK, np.where(centre_nm > STEP_NM, BRIGHT, (DARK + BRIGHT) / 2)
    )


@VARIANTS
def test_render_plane_under_uniform_sky(variant: str, tmp_path: Path) -> None:
    # In a furnace a convex body's radiance is its reflectance times the sky. Nothing is random but
    # the wavelength: the pulse with the step counts how many of its 24 576 fall on either side,
    # which moves the bands below it by 0.3 %; D65's 5 nm table has corners that bands do not see:
    # 0.05 %.
    scene = pixsim.load_scene(plane_scene(tmp_path, SKY), variant=variant)
    image = pixsim.render(scene)
    assert image.factors is not None  # one surface under one lamp: four pulses determine all bands
    nm = image.wavelength_nm
    fine_nm = nm[:, None] + image.band_width_nm[:, None] * np.linspace(-0.5, 0.5, 1001)
    sky = d65_radiance(fine_nm, 0.01 * D65_LUMINANCE).mean(axis=1)
    radiance = (image.data / lens_sr(image, scene.camera())[:, :, None]).mean(axis=(0, 1))
    ratio = radiance / (reflectance_of_band(nm) * sky)
    np.testing.assert_allclose(ratio[np.abs(nm - STEP_NM) > 5], 1, rtol=1e-2)
    np.testing.assert_allclose(ratio[nm > 600], 1, rtol=2e-3)


@NEEDS_LLVM
def test_samples_of_blocks_lower_the_noise_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a film of 30 × 22 cells, which no block divides: the picture is that of samples of single
    cells, with less noise in what a pixel of some cells sees.

    Over 40 renders a cell's standard error is known to 11 %: of 660 cells one is beyond 6 with a
    probability of 4e-5. The ratio of the noise of 35 blocks scatters by 2.7 %: 0.86 is
    missed with a probability of 0.3 %, and a ratio of 1 passes with 0.5 %.
    """
    scene = pixsim.load_scene("cornell_box", variant="llvm_ad_spectral", resolution=30, spp=4)
    camera = scene.camera().model_copy(update={"die_height_mm": 2.0}).window(0.3)
    pictures = {}
    for block_cells in (1, 4):
        monkeypatch.setattr(renderer, "_BLOCK_CELLS", block_cells)
        traced = Renderer(scene, camera, make_render_plan(scene, camera), 0)
        assert traced.plan.samples.sampler == "independent"
        pictures[block_cells] = np.array(
            [traced.run(index)[0][0].sum(axis=2, dtype=float) for index in range(40)]
        )
    alone, together = pictures[1], pictures[4]
    np.testing.assert_array_less(
        np.abs(alone.mean(axis=0) - together.mean(axis=0)),
        6 * np.sqrt((alone.var(axis=0) + together.var(axis=0)) / 40),
    )

    def noise(runs: np.ndarray) -> float:
        blocks = runs[:, :20, :28].reshape(40, 5, 4, 7, 4).mean(axis=(2, 4))
        return float(np.sqrt(blocks.var(axis=0, ddof=1).mean()))

    assert noise(together) / noise(alone) == pytest.approx(0.86, abs=0.07)


def test_render_two_lamp_spectra_add(tmp_path: Path) -> None:
    # Each lamp in bands of its shape: D65's corners within a band .4 %, and 5 standard errors
    # (false alarm 3e-5 over 45 bands).
    sun = """<emitter type="directional"><vector name="direction" value="0, 0.6, 0.8"/>
        <spectrum name="irradiance" value="360:0, 830:4.7"/></emitter>"""
    path = '<integrator type="path"><integer name="max_depth" value="2"/></integrator>'
    scene = pixsim.load_scene(plane_scene(tmp_path, SKY + sun, path, 256))
    image = pixsim.render(scene)
    nm = image.wavelength_nm
    light = d65_radiance(nm, 0.01 * D65_LUMINANCE) + 0.01 * (nm - 360) * 0.8 / np.pi
    expected = reflectance_of_band(nm) * light * lens_sr(image, scene.camera())[:, :, None]
    error = (image.data / expected - 1)[:, :, np.abs(nm - STEP_NM) > 5]
    noise = error.std(axis=(0, 1)) / np.sqrt(error[:, :, 0].size)
    assert np.all(np.abs(error.mean(axis=(0, 1))) < 4e-3 + 5 * noise)
    assert noise.max() < 4e-3  # so that the gate means something


def test_memory_of_a_render_is_independent_of_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1024 × 1024 grey cells, a few rows at a time."""
    import mitsuba

    scene = load("csf", resolution=1024, spp=4)
    renderer = Renderer(scene, scene.camera(), make_render_plan(scene), 0)
    assert renderer.tracer.loaded
    grey = np.full((1024, 1024, 1), 0.5, np.float32)
    monkeypatch.setattr(arrays, "STRIP_SAMPLES", 1 << 13)
    monkeypatch.setattr(
        mitsuba, "render", lambda *_, sensor, **__: grey[: sensor.film().crop_size()[1]].copy()
    )
    peaks = []
    for level in (0, 6):
        tracemalloc.start()
        renderer.run(0, level=level)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert 1 < peaks[0] / grey.nbytes < 1.5
    assert peaks[1] < 1.05 * peaks[0]


CAMERA = pixsim.Camera(f_number=4.0)
FLAT = pixsim.Pixel(
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
NM = np.linspace(300, 1100, 80_001)


def lamp(spectrum: str) -> str:
    return f'<shape type="rectangle">{PLANE}<emitter type="area">{spectrum}</emitter></shape>'


def wall(
    inside: str,
    spectrum: str = '<spectrum name="radiance" value="300:1, 1100:1"/>',
    plugin: str = "diffuse",
) -> str:
    bsdf = f'<bsdf type="{plugin}" id="paint">{inside}</bsdf>'
    shape = f'<shape type="rectangle">{PLANE}{bsdf}</shape>'
    return f'<emitter type="constant">{spectrum}</emitter>{shape}'


def scene_of(folder: Path, body: str, variant: str = VARIANT, **parameters) -> Scene:
    # A wall has noise, from directions of the light; a lamp has none.
    sensor = sensor_xml(lens_xml(38, focus_m=1), spp=(1024 if "constant" in body else 16))
    path = scene_file(folder, '<integrator type="path"/>', sensor, body)
    return pixsim.load_scene(path, variant=variant, **parameters)


def rendered(
    scene: Scene, pixel: pixsim.Pixel = FLAT, full: bool = False
) -> tuple[Plan, spectral.SpectralImage]:
    plan = make_render_plan(scene, CAMERA, pixel, full=full)
    return plan, pixsim.render(scene, CAMERA, plan=plan)


def electrons(nm: np.ndarray, radiance: np.ndarray, image: spectral.SpectralImage) -> float:
    """Electrons s⁻¹ µm⁻² of an efficiency of 0.5 in the sample beside the axis."""
    tangent = np.hypot(0.5, 0.5) * image.pitch_um / 1e3 / CAMERA.image_distance_mm
    factor = float(pixsim.optics.irradiance_factor(CAMERA.f_number, tangent, CAMERA.magnification))
    return float(0.5e-12 * factor * np.trapezoid(radiance * spectral.photons_per_joule(nm), nm))


@pytest.mark.parametrize("at_nm", [310.0, 700.0, 829.9, 835.0, 940.0, 1090.0])
def test_lines_have_the_electrons_of_the_closed_form(at_nm: float, tmp_path: Path) -> None:
    line = f'<spectrum name="radiance" value="{at_nm - 1}:0, {at_nm}:1, {at_nm + 1}:0"/>'
    plan, image = rendered(scene_of(tmp_path, lamp(line)))
    nm = np.linspace(at_nm - 1, at_nm + 1, 4001)
    expected = electrons(nm, 1 - np.abs(nm - at_nm), image)
    assert ideal_rate(image, pixsim.derive(FLAT))[4, 4] == pytest.approx(expected, rel=1e-4)
    ends_nm = (300 if at_nm < 360 else 360, 1100 if at_nm + 1 > 830 else 830)
    assert tuple(plan.light.bands.edges_nm[[0, -1]]) == ends_nm


def test_black_body_has_no_step_at_830_nm(tmp_path: Path) -> None:
    # As Planck has it; the curvature of its logarithm changes by 2e-4 at 600 nm, and a step of 0.03
    # % would change it by as much.
    _, image = rendered(scene_of(tmp_path, lamp(BLACK_BODY)))
    power = image.mean_spectrum() * image.band_width_nm
    ends_nm = 300 + np.cumsum(image.band_width_nm)
    beyond = np.clip((ends_nm - 830) / image.band_width_nm, 0, 1)
    light = planck(NM, 2856)
    expected = light[NM > 830].sum() / light.sum()
    assert (power * beyond).sum() / power.sum() == pytest.approx(expected, abs=2e-4)
    inside = (image.wavelength_nm > 600) & (image.wavelength_nm < 1090)
    assert np.abs(np.diff(np.log(image.mean_spectrum()[inside]), 3)).max() < 3e-4


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
    rate = (ideal_rate(image, pixsim.derive(FLAT)) / fall_off).mean() * fall_off[4, 4]
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
    for beyond, share, atol in (("hold", 1, 0.05), ("zero", 0, 0.02)):
        plan, image = rendered(scene_of(tmp_path, body, beyond_tables=beyond))
        assert not plan.warnings
        light = np.interp([790.0, 900.0, 1090.0], image.wavelength_nm, image.mean_spectrum())
        assert light[1:] / light[0] == pytest.approx(share, abs=atol)

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
    pixel = pixsim.Pixel.model_validate(FLAT.model_dump() | efficiency)
    return [str(note) for note in make_render_plan(scene, pixel=pixel).warnings]


def percent_in(warning: str) -> float:
    return float(re.search(r"([\d.]+) ?%", warning)[1])


@pytest.mark.parametrize(("end_nm", "percent"), [(830.0, 24.6), (1100.0, 49.5)])
def test_light_that_a_sky_lacks_is_said_with_its_share(end_nm: float, percent: float) -> None:
    # Of a black body of 5772 K beyond 720 nm, in an equal response from 360 nm on; cells of 10 nm
    # move it by .1 %. A filter keeps it out.
    scene = load(Path(__file__).parents[1] / "data/cases/4-03-sunsky-ends-at-720/sky.xml")
    (warning,) = warnings_of(scene, (360, 0.5), (end_nm, 0.5))
    assert percent_in(warning) == pytest.approx(percent, abs=0.15)
    assert not warnings_of(scene, (300, 0.5), (end_nm, 0.5), cut_nm=700.0)


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
    notes = warnings_of(scene_of(tmp_path, wall("", spectrum)), (300, 0.5), (1100, 0.5))
    for note, (words, share) in zip(notes, LAMPS[table].items(), strict=True):
        assert words in note
        assert percent_in(note) == pytest.approx(100 * share / (830**2 - 360**2), abs=1.0)


@pytest.mark.parametrize("more", ["", lamp(BLACK_BODY)])
def test_a_picture_of_light_beside_a_lamp_that_goes_on_is_said(more: str, tmp_path: Path) -> None:
    """An RGB picture has no light beyond 830 nm, to which a black body takes the range."""
    Image.fromarray(np.full((4, 8, 3), 100, np.uint8)).save(tmp_path / "sky.png")
    sky = '<emitter type="envmap"><string name="filename" value="sky.png"/></emitter>'
    notes = warnings_of(scene_of(tmp_path, sky + more), (300, 0.5), (1100, 0.5))
    assert any("'envmap'" in note for note in notes) == bool(more)


def test_a_metal_that_ends_is_what_mitsuba_makes_of_it(tmp_path: Path) -> None:
    body = wall("", plugin="conductor")
    with pytest.raises(pixsim.PixsimError, match="the metal of 'paint'"):
        rendered(scene_of(tmp_path, body))
    plan, _ = rendered(scene_of(tmp_path, body, beyond_tables="hold"))
    assert any("the metal of 'paint'" in note for note in plan.warnings)
