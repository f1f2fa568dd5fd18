"""Renders against closed forms: exposure, charts, furnaces, orientation, seeds and threads, on both
CPU variants.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import END, NEEDS_LLVM, VARIANT, VARIANTS, edited, lens_sr
from helpers.lamps import D65_LUMINANCE, d65_radiance
from helpers.processes import HANG_S

import pixsim
from pixsim import optics
from pixsim.base import arrays
from pixsim.base.errors import PixsimError
from pixsim.cli.commands import run
from pixsim.cli.options import EffortOptions, SceneOptions
from pixsim.light import spectral
from pixsim.light.exr import write_channels
from pixsim.scene import charts
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor import readout as sensor
from pixsim.sensor.integration import pixel_count
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout


def on_axis_sr(f_number: float, magnification: float) -> float:
    """Return E/L of a thin lens on its axis, π sin²α."""
    return np.pi / (1 + 4 * f_number**2 * (1 + magnification) ** 2)


def z_of_mean(values: np.ndarray) -> float:
    """Return the mean of independent values in units of its standard error."""
    return float(values.mean() / (values.std() / np.sqrt(values.size)))


# --- Exposure: a flat field behind a lens ---


def flat(variant: str, f_number: float) -> tuple[pixsim.SpectralImage, pixsim.Camera]:
    """100 cd/m² of D65, f = 6 mm at 1.2 m, on a die whose corner is 35° off axis."""
    lens = {"focal_length_mm": 6.0, "f_number": f_number, "object_distance_m": 1.2}
    corner_mm = pixsim.Camera(**lens).image_distance_mm * np.tan(np.radians(35))
    camera = pixsim.Camera(**lens, die_mm=2**0.5 * corner_mm)
    scene = pixsim.load_scene(
        "flat", variant=variant, resolution=65, spp=4, luminance_cd_per_m2=100
    )
    return pixsim.render(scene, camera), camera


# 10 nm bands cost 0.003 % of this lamp's luminance (0.03 % of others'), the lens nothing; N instead
# of N(1+m) is 1 % off.
GATE = 5e-4


@pytest.mark.parametrize(
    ("variant", "f_number"),
    [pytest.param("llvm_ad_spectral", 4.0, marks=NEEDS_LLVM), (VARIANT, 8.0)],
)
def test_render_illuminance_follows_lens(variant, f_number):
    image, camera = flat(variant, f_number)
    x_mm = (np.arange(65) - 32) * image.pitch_um * 1e-3
    tan_field = np.hypot(x_mm, x_mm[:, None]) / camera.image_distance_mm
    assert np.degrees(np.arctan(tan_field.max())) == pytest.approx(35, abs=0.5)
    expected = 100 * optics.irradiance_factor(f_number, tan_field, camera.magnification)
    assert expected[32, 32] == pytest.approx(
        100 * on_axis_sr(f_number, camera.magnification), rel=1e-9
    )
    assert f_number == 8 or expected[32, 32] == pytest.approx(4.7857, rel=1e-5)
    assert np.abs(image.illuminance_lx() / expected - 1).max() < GATE
    assert 0.44 < expected.min() / expected.max() < 0.48  # cos⁴ 35° = .45


def test_render_flat_field_electrons():
    scene = pixsim.load_scene("flat", resolution=65, spp=4, luminance_cd_per_m2=200)
    camera = pixsim.Camera(
        die_mm=0.325
    )  # 65 pixels of 5 µm: one on the axis, and hardly any fall-off
    image = pixsim.render(scene, camera)
    pixel = pixsim.Pixel(pitch_um=5, fill_factor=0.3, quantum_efficiency=0.5)
    sensor_of_pixel, exposure = (
        pixsim.make_sensor(pixel, camera),
        pixsim.Exposure(integration_s=0.02),
    )
    frame = pixsim.capture(image, camera, sensor_of_pixel, exposure, rng=np.random.default_rng(0))
    h, c = 6.62607015e-34, 299792458.0
    nm = np.arange(360.0, 830.5, 0.5)
    irradiance = d65_radiance(nm, 200) * on_axis_sr(4, camera.magnification)
    expected = np.trapezoid(irradiance * 0.5 * nm * 1e-9 / (h * c), nm) * 0.3 * 25e-12 * 0.02
    # Band means and a 0.5 nm grid differ by 4e-6; the table has D65 rounded to 6 digits.
    assert frame.mean_e[32, 32] == pytest.approx(expected, rel=1e-4)


# --- Charts ---


def csf_sample_means(n: int) -> np.ndarray:
    """Return means of the CSF chart over n × n samples, by 4 Gauss points per axis."""
    node, weight = np.polynomial.legendre.leggauss(4)
    at = (np.arange(n)[:, None] + 0.5 + node / 2) / n
    mean = charts.csf_value(0.0, 0.0)
    sine = (charts.csf_value(at, 1.0) - mean) @ weight / 2
    contrast = charts.csf_contrast(at) @ weight / 2 / charts.csf_contrast(1.0)
    return mean + contrast[:, None] * sine


@pytest.mark.parametrize(
    ("variant", "size"),
    [
        pytest.param("llvm_ad_spectral", {"resolution": 256}, marks=NEEDS_LLVM),
        ("scalar_spectral", {"resolution": 256}),
    ],
)
def test_render_csf_matches_chart(variant, size):
    scene = pixsim.load_scene("csf", variant=variant, **size)
    camera, image = scene.camera(), pixsim.render(scene)
    n = image.shape[0]
    assert n == size.get("resolution", 1024)
    expected_lx = 1000 * csf_sample_means(n) * lens_sr(image, camera)
    error = image.illuminance_lx() / expected_lx - 1
    # 16 samples of multijitter leave 0.03 % at 1024 and 0.11 % at 256; the lowest half row of
    # texels, whose contrast is 0.9 % short (and 12 % of the light in the darkest troughs), raises
    # the whole to 0.11 and 0.13 %. A chart 0.2 % too large fails.
    assert np.sqrt(np.mean(error**2)) < 2e-3
    assert np.sqrt(np.mean(error[: n * 127 // 128] ** 2)) < 1.5e-3
    assert abs(error.mean()) < 1e-4


GRATING_ROWS = 16


@cache
def grating(
    camera: pixsim.Camera, frequency_lp_per_mm: float, folder: Path
) -> pixsim.SpectralImage:
    """Render 16 of 1024 rows of the packaged scene with a sinusoid."""
    x = (
        np.arange(16384) + 0.5
    ) / 16384  # 100 texels a cycle: bilinear interpolation keeps 0.03 % of 60 lp/mm
    texels = (0.5 * (1 + 0.9 * np.sin(2 * np.pi * frequency_lp_per_mm * charts.DIE_MM * x))).astype(
        np.float32
    )
    pixsim.write_chart(folder / "sine.exr", np.tile(texels, (2, 1)))
    height = '<integer name="height" value="{}"/>'
    text = packaged_scenes()["csf"].read_text()
    (folder / "strip.xml").write_text(
        text.replace(height.format("$resolution"), height.format(GRATING_ROWS))
    )
    scene = pixsim.load_scene(folder / "strip.xml", chart=str(folder / "sine.exr"), resolution=1024)
    image = pixsim.render(scene, camera)
    assert image.shape == (GRATING_ROWS, 1024)
    return image


@pytest.fixture(scope="module")
def grating_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gratings")


def mean_electrons(image, camera, pixel) -> np.ndarray:
    """`Frame.mean_e` of one row of a strip."""
    readout = Readout.of(derive(pixel))
    count = tuple(pixel_count(n * image.pitch_um, pixel.pitch_um) for n in image.shape)
    rng = np.random.default_rng(0)
    frame = pixsim.capture(image, camera, sensor.sample_sensor(readout, count, rng), rng=rng)
    return frame.mean_e.mean(axis=0) / frame.integration_s


# A coarse and a fine one through each lens, the last of which is at |m| = 0.24.
@pytest.mark.parametrize("pitch_um", [5.3, 8.0, 15.0])
@pytest.mark.parametrize(
    ("f_number", "distance_m", "frequency_lp_per_mm"),
    [
        (2.8, 1.0, 20.0),
        (2.8, 1.0, 60.0),
        (8.0, 1.0, 5.0),
        (8.0, 1.0, 60.0),
        (4.0, 0.02, 20.0),
        (4.0, 0.02, 60.0),
    ],
)
def test_capture_contrast_is_diffraction_times_photodiode(
    f_number, distance_m, frequency_lp_per_mm, pitch_um, grating_folder
):
    camera = pixsim.Camera(f_number=f_number, object_distance_m=distance_m)
    image = grating(camera, frequency_lp_per_mm, grating_folder)
    plain = image.with_planes(0.5 * lens_sr(image, camera)[None].astype(np.float32))
    pixel = pixsim.Pixel(pitch_um=pitch_um)
    signal = mean_electrons(image, camera, pixel) / mean_electrons(
        plain, camera, pixel
    )  # without the fall-off
    # At 15 µm 60 lp/mm is beyond Nyquist: the true frequency at the pixel centres is the alias.
    x_mm = charts.DIE_MM / 2 + (np.arange(signal.size) - (signal.size - 1) / 2) * pitch_um * 1e-3
    inside = (
        np.abs(x_mm / charts.DIE_MM - 0.5) < 0.45
    )  # the picture's reflection at its borders is no sinusoid
    phase = 2 * np.pi * frequency_lp_per_mm * x_mm
    basis = np.stack([np.ones_like(phase), np.sin(phase), np.cos(phase)], axis=1)[inside]
    mean, in_phase, quadrature = np.linalg.lstsq(basis, signal[inside], rcond=None)[0]

    physics, nm = derive(pixel), image.wavelength_nm
    electrons = physics.quantum_efficiency(nm) * nm * image.factors[0][0]
    sin_alpha = np.sin(np.arctan(1 / (2 * f_number * (1 + 3.86 / (1e3 * distance_m - 3.86)))))
    half_angle = np.arccos(np.minimum(frequency_lp_per_mm * nm * 1e-6 / (2 * sin_alpha), 1))
    otf = (electrons * (2 * half_angle - np.sin(2 * half_angle)) / np.pi).sum() / electrons.sum()
    aperture = np.sinc(frequency_lp_per_mm * physics.photodiode_side_um * 1e-3)
    expected = 0.9 * otf * aperture
    # Measured 0.07 % at 60 lp/mm (texture and spline), 0.01 % at the others. At 60 lp/mm the green
    # OTF instead of the white one is .8 % off at f/2.8 and 2.8 % at f/8; the full pixel instead of
    # its photodiode 15 to 60 %.
    assert in_phase / mean == pytest.approx(expected, rel=2e-3)
    # A tenth of a render sample to one side would turn 60 lp/mm by 0.1 radian.
    assert abs(quadrature / mean) < 2e-3 * expected


# --- Fewer passes ---


@pytest.mark.slow
@VARIANTS
def test_render_one_pass_gives_all_bands(variant):
    scene = pixsim.load_scene("flat", variant=variant, resolution=16)
    quick, full = pixsim.render(scene), pixsim.render(scene, full=True)
    assert quick.factors is not None
    assert full.factors is None
    # No noise on a flat field whose bands have the lamp's shape: what is left is float32.
    assert np.abs(full.data / quick.data - 1).max() < 1e-6


@pytest.mark.slow
def test_render_chart_one_pass_gives_all_bands():
    scene = pixsim.load_scene("csf", resolution=64, spp=64)
    quick, full, other = (
        pixsim.render(scene),
        pixsim.render(scene, full=True),
        pixsim.render(scene, full=True, seed=1),
    )
    ratio = full.data.mean(axis=(0, 1), dtype=float) / quick.data.mean(axis=(0, 1), dtype=float)
    # A quarter of a million samples each; from 8 seeds the noise of a band's mean is 4e-6.
    assert np.abs(ratio - 1).max() < 1e-4
    noise = (full.data - other.data).reshape(-1, full.data.shape[2]).astype(float) / full.data.mean(
        axis=(0, 1), dtype=float
    )
    passes = make_render_plan(scene, full=True).light.lamps[0].fit.passes
    assert (
        np.corrcoef(noise[:, passes[4][0]], noise[:, passes[4][1]])[0, 1] > 0.9
    )  # of one pass: the same rays
    # Passes share out a film cell, so that their mean has less noise than that of as many
    # independent passes, whose ratio here would be 1 ± 0.05; one pass for all bands would give √12.
    # Three other pairs of seeds gave 0.326 to 0.333.
    each = noise[:, [bands[0] for bands in passes]]
    ratio_of_mean = each.mean(axis=1).std() * np.sqrt(len(passes)) / each.std(axis=0).mean()
    assert 0.2 < ratio_of_mean < 0.5


# --- Orientation ---


def test_render_top_left_is_kept_in_files(tmp_path):
    import matplotlib.image
    import OpenEXR

    texels = np.full((8, 8), 0.05, np.float32)
    texels[:2, :2], texels[:2, 6:], texels[6:, :2] = 1.0, 0.6, 0.3  # the fourth corner stays dark
    pixsim.write_chart(tmp_path / "corners.exr", texels)
    (tmp_path / "options.toml").write_text("pixel.pitch_um = 42.4\ndisplay.dots = 64")
    out = tmp_path / "out"
    define = [f"chart={tmp_path / 'corners.exr'}", "resolution=64"]
    effort = EffortOptions(resolution="64")
    run(
        "flat",
        options=SceneOptions(define=define, config=[tmp_path / "options.toml"]),
        effort=effort,
        out=out,
    )

    def stored(name: str, channel: str) -> np.ndarray:
        with OpenEXR.File(str(out / name), separate_channels=True) as file:
            return file.channels()[channel].pixels

    scene = pixsim.load_scene("flat", chart=str(tmp_path / "corners.exr"), resolution=64)
    camera, image = scene.camera(), pixsim.render(scene)
    rng = np.random.default_rng(0)
    frame = pixsim.capture(
        image, camera, pixsim.make_sensor(pixsim.Pixel(pitch_um=42.4), camera), rng=rng
    )
    pictures = {
        "irradiance": image.illuminance_lx(),
        "frame": frame.dn,
        "irradiance.exr": stored("irradiance.exr", "S0.550,000000nm"),
        "raw.exr": stored("raw.exr", "DN"),
        "ideal.png": np.atleast_3d(matplotlib.image.imread(out / "ideal.png"))[:, :, 0],
        "image.png": np.atleast_3d(matplotlib.image.imread(out / "image.png"))[:, :, 0],
    }
    for name, picture in pictures.items():
        assert picture.shape == ((60, 60) if name.endswith("png") else (64, 64)), (
            name
        )  # shown without a border of two dots
        corners = [
            picture[rows, columns].mean()
            for rows in np.s_[2:12, -12:-2]
            for columns in np.s_[2:12, -12:-2]
        ]
        top_left, top_right, bottom_left, bottom_right = corners
        assert top_left > 1.2 * top_right > 1.2**2 * bottom_left > 1.2**3 * bottom_right, name


# --- Seeds and threads ---


@VARIANTS
def test_render_equal_seeds_are_bit_identical(variant):
    scene = pixsim.load_scene("csf", variant=variant, resolution=64)
    first, again, other = (
        pixsim.render(scene, seed=seed).data[:, :, 20].astype(float) for seed in (3, 3, 5)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    relative = first / other - 1
    assert 1e-4 < relative.std() < 1e-2  # measured .5 %: noise, not another picture
    assert abs(z_of_mean((first - other).ravel())) < 4  # false alarm 6e-5


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
@pytest.mark.parametrize(
    "variant",
    [
        pytest.param("llvm_ad_spectral", marks=NEEDS_LLVM),
        pytest.param("scalar_spectral", marks=pytest.mark.slow),
    ],
)
def test_render_threads_are_bit_identical(variant):
    """On one core, with the threads that are started there, and then with more on all cores."""
    # Mitsuba 3.9.1 alone waits for ever for a texture where there is only one core, hence the
    # limit.
    line = [sys.executable, "-c", THREADS, variant]
    hashes = subprocess.run(
        line, capture_output=True, text=True, check=True, timeout=HANG_S
    ).stdout.split()
    assert len(hashes) == 3
    assert len(set(hashes)) == 1


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
    path = folder / "plane.xml"
    path.write_text(f"""<scene version="3.0.0">
    {integrator}
    <sensor type="thinlens">
        <float name="fov" value="{camera.fov_deg!r}"/>
        <float name="aperture_radius" value="{camera.aperture_radius_m!r}"/>
        <float name="focus_distance" value="0.5"/>
        <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="{spp}"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="180"/><translate z="0.5"/></transform>
        <bsdf type="diffuse">{REFLECTANCE}</bsdf>
    </shape>
    {body}
</scene>""")
    return path


def spectrum_over_lens(image: pixsim.SpectralImage, camera: pixsim.Camera) -> np.ndarray:
    """Return the mean radiance of a picture (B,) from its irradiance."""
    return (image.data / lens_sr(image, camera)[:, :, None]).mean(axis=(0, 1))


def reflectance_of_band(centre_nm: np.ndarray) -> np.ndarray:
    return np.where(
        centre_nm < STEP_NM, DARK, np.where(centre_nm > STEP_NM, BRIGHT, (DARK + BRIGHT) / 2)
    )


@VARIANTS
def test_render_plane_under_uniform_sky(variant, tmp_path):
    scene = pixsim.load_scene(plane_scene(tmp_path, SKY), variant=variant)
    image, camera = pixsim.render(scene), scene.camera()
    assert image.factors is not None  # one surface under one lamp: four pulses determine all bands
    assert camera.f_number == pytest.approx(2, rel=1e-5)
    # In a furnace a convex body's radiance is its reflectance times the sky; band means of D65 on a
    # fine grid.
    centre_nm = image.wavelength_nm
    fine_nm = centre_nm[:, None] + image.band_width_nm[:, None] * np.linspace(-0.5, 0.5, 1001)
    sky = d65_radiance(fine_nm, 0.01 * D65_LUMINANCE).mean(axis=1)
    ratio = spectrum_over_lens(image, camera) / (reflectance_of_band(centre_nm) * sky)
    smooth = np.abs(centre_nm - STEP_NM) > 5
    # Nothing is random but the wavelength: the pulse with the step counts how many of its 24 576
    # fall on either side, which moves the bands below it by 0.3 %; D65's 5 nm table has corners
    # that a 0.01 nm grid sees and bands do not: 0.05 %.
    assert np.abs(ratio - 1)[smooth].max() < 1e-2
    assert np.abs(ratio - 1)[centre_nm > 600].max() < 2e-3
    # Reflectances are tabulated at 1 nm: the step takes 2 nm of the 5 nm bands beside it, and they
    # share its light.
    assert np.abs(ratio - 1)[~smooth].max() < 0.2
    share = reflectance_of_band(centre_nm[~smooth])
    assert ratio[~smooth] @ share == pytest.approx(share.sum(), rel=1e-2)
    nm = np.arange(360.0, 831.0)
    light = (
        reflectance_of_band(nm)
        * d65_radiance(nm, 0.01 * D65_LUMINANCE)
        * spectral.photopic_efficiency(nm)
    )
    luminance = spectrum_over_lens(image, camera) @ image.luminous_weight()
    # The step again: 0.16 %, of half of the light.
    assert luminance == pytest.approx(spectral.LUMINOUS_EFFICACY_LM_PER_W * light.sum(), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
@VARIANTS
def test_render_lamp_without_texture(variant, full, tmp_path):
    lamp = '<emitter type="area"><spectrum name="radiance" value="360:0, 830:4.7"/></emitter>'
    path = plane_scene(tmp_path, "")
    path.write_text(path.read_text().replace("</bsdf>", f"</bsdf>{lamp}"))
    scene = pixsim.load_scene(path, variant=variant)
    image = pixsim.render(scene, full=full, seed=3)
    assert (image.factors is None) == full
    # A straight lamp: its band means are its values at the centres. Nothing is random: float32. But
    # one wavelength in a million falls on the end of a pulse, where the film sees nothing: 4e-5 of
    # a band, at a quarter of the seeds; not at this.
    radiance = spectrum_over_lens(image, scene.camera())
    np.testing.assert_allclose(radiance, 0.01 * (image.wavelength_nm - 360), rtol=1e-6)


def test_render_two_lamp_spectra_add(tmp_path):
    sun = """<emitter type="directional">
        <vector name="direction" value="0, 0.6, 0.8"/>
        <spectrum name="irradiance" value="360:0, 830:4.7"/>
    </emitter>"""
    path = plane_scene(
        tmp_path,
        SKY + sun,
        '<integrator type="path"><integer name="max_depth" value="2"/></integrator>',
        256,
    )
    scene = pixsim.load_scene(path)
    assert len(make_render_plan(scene).light.lamps) == 2
    image = pixsim.render(scene)
    nm = image.wavelength_nm
    light = d65_radiance(nm, 0.01 * D65_LUMINANCE) + 0.01 * (nm - 360) * 0.8 / np.pi
    relative = (
        image.data / (reflectance_of_band(nm) * light * lens_sr(image, scene.camera())[:, :, None])
        - 1
    )
    smooth = relative[:, :, np.abs(nm - STEP_NM) > 5]
    noise = smooth.std(axis=(0, 1)) / np.sqrt(smooth[:, :, 0].size)
    # Each lamp in bands of its own shape: D65's corners within a band .4 %, and 5 standard errors
    # (false alarm 3e-5 over 45 bands).
    assert np.all(np.abs(smooth.mean(axis=(0, 1))) < 4e-3 + 5 * noise)
    assert noise.max() < 4e-3  # so that the gate means something


def test_render_fitted_and_coloured_lamps_add(tmp_path):
    """The weights of a fit have both signs: bands may be slightly below zero, pictures never."""
    rgb = np.random.default_rng(0).uniform(0, 1, (3, 4, 4))
    write_channels(tmp_path / "sky.exr", dict(zip("RGB", rgb, strict=True)), {})
    sky = (
        '<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale"'
        ' value="1e-6"/></emitter>'
    )
    scene = pixsim.load_scene(
        edited(tmp_path, "macbeth", (END, sky)),
        lamp="spectra/fl11.spd",
        resolution=32,
        variant="scalar_spectral",
    )
    plan = make_render_plan(scene)
    assert [bool(light.fit.spectra.min() < 0) for light in plan.light.lamps] == [True, False]
    image = pixsim.render(scene, plan=plan)
    assert image.data.min() < 0 <= image.factors[1].min()
    pixsim.write_exr(tmp_path / "image.exr", image)
    np.testing.assert_array_equal(pixsim.read_irradiance(tmp_path / "image.exr").data, image.data)


def test_render_black_picture_raises(tmp_path):
    pixsim.write_chart(tmp_path / "black.exr", np.zeros((4, 4), np.float32))
    scene = pixsim.load_scene("flat", chart=str(tmp_path / "black.exr"), resolution=8)
    with pytest.raises(PixsimError, match=r"a black picture.*that no picture of a lamp is 0"):
        pixsim.render(scene)


@pytest.mark.parametrize(
    ("name", "value"), [("resolution", 0), ("resolution", 16385), ("spp", 0), ("spp", 2**20 + 1)]
)
def test_render_size_out_of_range_raises(name, value):
    with pytest.raises(PixsimError, match=rf"{name}: got {value}; allowed: 1 to"):
        pixsim.render(pixsim.load_scene("flat", **{"resolution": 8, name: value}))


# --- Memory ---

TEXTURE_BYTES = 3 << 20  # whose hash goes into the header


def traced(work):
    """Return the result of a call and its peak of additional memory."""
    tracemalloc.start()
    result = work()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return result, most


@pytest.fixture
def large(monkeypatch):
    """Return a job of 1024 × 1024 samples with grey renders that works on a few rows at a time."""
    import mitsuba

    def grey(*_, sensor, spp, **__):
        width, height = sensor.film().crop_size()
        return np.full((height, width, 1), 0.5, np.float32)

    scene = pixsim.load_scene("csf", variant="scalar_spectral", resolution=1024, spp=4)
    job = Renderer(scene, scene.camera(), make_render_plan(scene), 0)
    assert job.tracer.loaded
    monkeypatch.setattr(arrays, "STRIP_SAMPLES", 1 << 13)
    monkeypatch.setattr(mitsuba, "render", grey)
    return job


def test_render_memory_is_independent_of_samples(large):
    (pictures, _), few = traced(lambda: large.run(0))
    size = pictures[0].nbytes
    assert size == 1024 * 1024 * 4
    _, many = traced(lambda: large.run(0, level=6))
    assert size < few < 1.5 * size
    assert many < 1.05 * few


def test_renderer_image_memory_is_bounded(large):
    pictures = [np.full((1024, 1024, 1), 0.5)]
    image, most = traced(lambda: large.image(pictures, 4))
    assert most < 1.2 * image.factors[1].nbytes + TEXTURE_BYTES
    small = large.scene.with_parameters(resolution=256)
    full = Renderer(small, large.camera, make_render_plan(small, full=True), 0)
    pulses = [
        np.full((256, 256, len(light.fit.pulses)), 0.5, np.float32)
        for light in full.plan.light.lamps
    ]
    image, most = traced(lambda: full.image(pulses, 4))
    assert most < 1.1 * image.data.nbytes + TEXTURE_BYTES


def test_fall_off_part_equals_whole(large):
    whole = large.fall_off()
    assert np.array_equal(large.fall_off(slice(100, 130), slice(7, 9)), whole[100:130, 7:9])
    assert 0.6 < whole.min() < whole.max() == pytest.approx(1, abs=1e-5)


def test_render_progress_rises_to_one():
    message: list[float] = []
    pixsim.render(
        pixsim.load_scene("flat", resolution=8, variant="scalar_spectral"), progress=message.append
    )
    assert message == sorted(message)
    assert message[-1] == 1
