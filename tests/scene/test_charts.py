"""Charts against their definitions: the packaged ones, a user's picture, and the CSF chart in
colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import colour
import numpy as np
import pytest
from helpers.edits import load
from helpers.tiff import tiff
from PIL import Image

import pixsim
from pixsim.light.exr import read_channels, write_channels
from pixsim.light.spectral import colour_matching, photopic_efficiency
from pixsim.optics.camera_light import camera_factor
from pixsim.scene import charts
from pixsim.scene.colour_chart import (
    MEAN,
    PRIMARIES,
    PROJECTOR_M,
    modulation,
    primaries,
    primaries_xyz,
    slide,
    write_colour_chart,
)
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.own_chart import GREY, read_luminance, with_border
from pixsim.scene.variants import variant
from pixsim.viewer.develop import xyz_weights
from pixsim.viewer.scielab import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT

SHIPPED = Path(__file__).parents[2] / "scenes" / "charts"


# --- Packaged charts ---


@pytest.mark.parametrize("die_mm", [2.7136, 5.0])
def test_csf_value_phase_derivative_is_frequency(die_mm):
    x = np.linspace(0, 1, 400_001)
    wave = charts.csf_value(x, 1.0, die_mm) - 0.5125
    before = np.flatnonzero(np.diff(np.sign(wave[1:]))) + 1
    zeros = x[before] + np.diff(x)[before] * wave[before] / (wave[before] - wave[before + 1])
    # Half a cycle between neighbouring zeros.
    result = 0.5 / (np.diff(zeros) * die_mm)
    middle = (zeros[1:] + zeros[:-1]) / 2
    # f(middle) is the mean of an exponential but for (3.5 Δx)²/24, 1.2 % in the first half cycle,
    # 1e-5 in the last.
    bound = (np.log(1000 / 30) * np.diff(zeros)) ** 2 / 24 + 1e-5
    assert result.size > 48 * die_mm / 2.7136
    assert np.all(np.abs(result / charts.csf_frequency_lp_per_mm(middle) - 1) < 1.1 * bound)


def test_csf_contrast_and_luminance_match_paper():
    top, bottom = (charts.csf_value(np.linspace(0, 1, 200_001), y) * 1000 for y in (0.0, 1.0))
    # 25 to 1000 cd/m², mean 512.5, largest Michelson contrast 975/1025; 1 % of it on top.
    assert (bottom.min(), bottom.max()) == pytest.approx((25, 1000), abs=1e-4)
    assert (top.min() + top.max()) / 2 == pytest.approx(512.5, abs=1e-4)
    assert np.ptp(bottom) / (bottom.max() + bottom.min()) == pytest.approx(0.951, abs=5e-4)
    assert np.ptp(top) / np.ptp(bottom) == pytest.approx(0.01, rel=1e-6)
    assert charts.csf_contrast(0.5) == pytest.approx(0.1 * 975 / 1025, rel=1e-12)


@pytest.mark.parametrize(("highest_lp_per_mm", "die_mm"), [(100.0, 5.0), (20.0, 36.0)])
def test_csf_file_begins_at_2_7_cycles_and_ends_at_its_frequency(
    highest_lp_per_mm, die_mm, tmp_path, monkeypatch
):
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    path = charts.csf_file(highest_lp_per_mm, die_mm)
    assert charts.csf_file(highest_lp_per_mm, die_mm) == path, "the same content has the same file"
    assert list(tmp_path.rglob("*.exr")) == [path]
    texels = next(iter(read_channels(path)[0].values())).astype(float)
    width = texels.shape[1]
    assert 8192 <= width <= 32768
    assert width >= min(32 * highest_lp_per_mm * die_mm, 32768) - 1
    wave = texels[-1] - 0.5125
    before = np.flatnonzero(np.diff(np.sign(wave)))
    zeros = (before + 0.5 + wave[before] / (wave[before] - wave[before + 1])) / width
    x, frequency = (zeros[1:] + zeros[:-1]) / 2, 0.5 / np.diff(zeros) / die_mm
    header = {"scene": "csf.xml", "parameters": {"max_lp_per_mm": repr(highest_lp_per_mm)}}
    expected = charts.csf_frequency_on_sensor(header, die_mm)
    assert expected([0.0, 1.0]) == pytest.approx([2.7136 / die_mm, highest_lp_per_mm], rel=1e-12)
    # Half cycles from linear zeros of texels: 1 % where a cycle has 26 of them, and of curvature in
    # the long first ones.
    assert np.abs(frequency[3:] / expected(x[3:]) - 1).max() < 0.01


def test_slanted_edge_is_5_degrees():
    texels = charts.slanted_edge(400, 400)
    # Where the edge crosses each row, from the row's dark area; coverage is counted in 8 × 8
    # points: 1/16 texel.
    crossing = 400 * (1 - (texels.astype(float) - 0.1).mean(axis=1) / 0.9)
    slope, _ = np.polyfit(np.arange(400), crossing, 1)
    assert np.degrees(np.arctan(-slope)) == pytest.approx(5.0, abs=0.01)
    assert crossing.mean() == pytest.approx(200, abs=0.1)
    assert (texels[200, 0], texels[200, -1]) == pytest.approx((0.1, 1.0))
    # One edge only: every row rises all the way.
    assert np.diff(texels, axis=1).min() >= 0


def test_siemens_star_has_72_cycles():
    texels = read_channels(SHIPPED / "siemens_star.exr")[0]["Y"]
    angle = np.radians(np.arange(0, 360, 0.05) + 0.02)
    row, column = (
        np.floor(512 - 400 * np.sin(angle)).astype(int),
        np.floor(512 + 400 * np.cos(angle)).astype(int),
    )
    bright = texels[row, column] > 0.5125
    assert np.count_nonzero(bright != np.roll(bright, 1)) == 2 * 72
    # The first sector above the positive x axis is bright.
    assert texels[511 - 10, 512 + 400] == 1.0
    assert texels[512 + 10, 512 + 400] == pytest.approx(0.025)


SLOW_CHARTS = {"siemens_star": pytest.mark.slow}  # 64 points for each of a million texels


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=SLOW_CHARTS.get(kind, ())) for kind in charts.CHARTS]
)
def test_packaged_textures_equal_make_chart(kind):
    channels, _ = read_channels(SHIPPED / f"{kind}.exr")
    assert list(channels) == ["Y"]
    np.testing.assert_array_equal(channels["Y"], charts.make_chart(kind))


def test_texture_without_a_cache_is_temporary(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIXSIM_CACHE_DIR", "/dev/null/there")
    path = charts.texture_file(["flat"], charts.flat)
    np.testing.assert_array_equal(read_channels(path)[0]["Y"], charts.flat())


# --- A picture of the user ---


RGB = np.random.default_rng(1).integers(0, 65536, (20, 30, 3)).astype(np.uint16)
EIGHT = (RGB >> 8).astype(np.uint8)
OPAQUE = np.dstack([EIGHT, np.full((20, 30), 255, np.uint8)])
LIGHT = (RGB / 6e4).astype(np.float32)
PALETTE = np.array([[[0, 0, 0], [200, 30, 10]], [[255, 255, 255], [10, 200, 90]]], np.uint8)
WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # Rec. ITU-R BT.709-6


def decoded(values: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def by_pillow(path: Path, values: np.ndarray) -> None:
    Image.fromarray(values).save(path)


def by_palette(path: Path, values: np.ndarray) -> None:
    Image.fromarray(values).convert("P", palette=Image.Palette.ADAPTIVE).save(path)


def by_mitsuba(path: Path, values: np.ndarray) -> None:
    mi = import_mitsuba(variant.choose().variant)
    mi.Bitmap(np.ascontiguousarray(values)).write(str(path))


def by_pixsim(path: Path, values: np.ndarray) -> None:
    write_channels(path, {name: values[:, :, index] for index, name in enumerate("RGB")}, {})


def grey_by_pixsim(path: Path, values: np.ndarray) -> None:
    write_channels(path, {"Y": values, "depth": values}, {})


# suffix, writer, what it writes, and the error of the format: RGBE has 8 bits of the largest
FORMATS: list[tuple[str, Callable[[Path, np.ndarray], None], np.ndarray, float]] = [
    ("png", by_pillow, EIGHT[:, :, 0], 0),
    ("png", by_pillow, RGB[:, :, 0], 0),
    ("png", by_pillow, EIGHT, 0),
    ("png", by_mitsuba, RGB, 0),
    ("png", by_pillow, OPAQUE, 0),
    ("png", by_palette, PALETTE, 0),
    ("tiff", by_pillow, EIGHT, 0),
    ("tif", by_pillow, RGB[:, :, 0], 0),
    ("exr", by_pixsim, LIGHT, 0),
    ("exr", grey_by_pixsim, LIGHT[:, :, 0], 0),
    ("hdr", by_mitsuba, LIGHT, float(LIGHT.max()) / 128),
]


@pytest.mark.parametrize(("suffix", "write", "values", "error"), FORMATS)
def test_luminance_of_every_format(
    suffix: str,
    write: Callable[[Path, np.ndarray], None],
    values: np.ndarray,
    error: float,
    tmp_path: Path,
) -> None:
    path = tmp_path / f"a.{suffix}"
    write(path, values)
    scale = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
    for is_linear in (False, True):
        light = values / scale
        if not is_linear and values.dtype.kind == "u":
            light = decoded(light)
        expected = light if light.ndim == 2 else light[:, :, :3] @ WEIGHTS
        luminance = read_luminance(path, linear=is_linear)
        np.testing.assert_allclose(luminance, expected, rtol=1e-6, atol=error + 1e-9)


def test_what_is_lost_of_a_picture_is_said(tmp_path: Path) -> None:
    tiff(tmp_path / "deep.tif", RGB.astype("<u2"), 2)
    with pytest.warns(UserWarning, match="is read with 8 of its 16 bits"):
        read_luminance(tmp_path / "deep.tif")


def test_a_turned_jpeg_is_upright(tmp_path: Path) -> None:
    # JPEG keeps uniform areas to a code, 2 %; a camera held upright writes the turn into its
    # metadata (EXIF 6: turn right).
    codes = np.full((16, 32), 40, np.uint8)
    codes[:, 16:] = 200
    metadata = Image.Exif()
    metadata[0x0112] = 6
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=100, exif=metadata)
    luminance = read_luminance(tmp_path / "a.jpg")
    assert luminance.shape == (32, 16)
    expected = decoded(np.array([40, 200]) / 255)
    np.testing.assert_allclose(luminance[[4, 28], 4], expected, rtol=0.02)


@pytest.mark.parametrize(
    ("aspect", "shape"), [(1.0, (30, 30)), (1.5, (20, 30)), (3.0, (20, 60)), (0.5, (60, 30))]
)
def test_border_keeps_the_aspect_and_states_its_share(
    aspect: float, shape: tuple[int, int]
) -> None:
    texels, share = with_border(np.ones((20, 30), np.float32), aspect)
    assert texels.shape == shape
    assert share == pytest.approx(1 - 600 / texels.size)
    assert ((texels == 1).sum(), (texels == np.float32(GREY)).sum()) == (600, texels.size - 600)
    np.testing.assert_array_equal(texels, texels[::-1, ::-1])  # centred


def write_picture(path: Path) -> Path:
    """A picture of 20 × 40: the left half is white, the right one dark."""
    codes = np.full((20, 40), 60, np.uint8)
    codes[:, :20] = 255
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(codes).save(path)
    return path


def test_picture_is_seen_with_its_border(tmp_path: Path) -> None:
    # White, dark and the grey border in proportion; the picture stands upright in the middle of the
    # die. Multijitter at 4 samples: 0.3 %.
    scene = load("csf", chart=write_picture(tmp_path / "mine.png"), resolution=32, spp=4)
    with pytest.warns(UserWarning, match=r"'mine\.png' keeps its aspect: 50 % of the chart"):
        light = pixsim.render(scene)
    assert light.header["parameters"]["chart"] == "mine.png"
    camera = scene.camera()
    lens = (camera.image_distance_mm, camera.f_number, camera.magnification)
    lx = light.illuminance_lx() / pixsim.optics.field_factor(light.shape, light.pitch_um, *lens)
    white = lx[10:22, 4:12].mean()
    parts = [lx[10:22, 20:28].mean(), lx[:6].mean(), lx[26:].mean()]
    dark = float(decoded(np.array(60 / 255)))
    np.testing.assert_allclose(parts / white, [dark, GREY, GREY], rtol=5e-3)


def test_scene_hash_of_a_picture_depends_on_its_content_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not on its folder, nor on that of the cache."""
    hashes = []
    for folder in ("a", "b", "c"):
        path = write_picture(tmp_path / folder / "mine.png")
        monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / folder / "cache"))
        scene = load("csf", chart=path, chart_linear=folder == "c", resolution=32)
        hashes.append(scene.content_hash)
    assert hashes[0] == hashes[1] != hashes[2]


# --- The CSF chart in colour ---


RED_GREEN, BLUE_YELLOW = modulation(-XYZ_FROM_OPPONENT[:, 1]), modulation(XYZ_FROM_OPPONENT[:, 2])


def test_primaries_are_a_display_whose_white_is_d65() -> None:
    """1000 cd/m² of D65 within the 5 nm table, and chromaticities by colour-science."""
    nm, radiance = primaries()
    assert 683.002 * 5 * (photopic_efficiency(nm) @ radiance).sum() == pytest.approx(1000, rel=2e-3)
    xyz = primaries_xyz()
    white = xyz.sum(axis=1)
    assert white[:2] / white.sum() == pytest.approx([0.3127, 0.3290], abs=1e-4)
    expected = colour.MSDS_DISPLAY_PRIMARIES["Apple Studio Display"]
    expected_xyz = colour_matching(expected.wavelengths).T @ expected.values
    chromaticities = [values[:2] / values.sum(axis=0) for values in (xyz, expected_xyz)]
    np.testing.assert_allclose(*chromaticities, atol=2e-3)


@pytest.mark.parametrize(("change", "channel", "first"), [(RED_GREEN, 1, 0), (BLUE_YELLOW, 2, 2)])
def test_slides_change_one_opponent_channel_within_the_gamut(
    change: np.ndarray, channel: int, first: int
) -> None:
    # The two others are constant to the float32 of the slides, and one slide has the contrast of
    # the grey chart.
    grey = charts.csf(256, 32)
    slides = np.stack([slide(share, grey) for share in change.tolist()])
    assert 0 <= slides.min() < slides.max() <= 1
    np.testing.assert_allclose(slides[first], grey, atol=1e-7)
    opponent = np.einsum("ij,jyx->iyx", OPPONENT_FROM_XYZ @ primaries_xyz(), slides.astype(float))
    others = np.delete(opponent, channel, axis=0)
    np.testing.assert_allclose(others - others[:, :1, :1], 0, atol=1e-6)
    correlation = np.corrcoef(opponent[channel].ravel(), grey.ravel())[0, 1]
    assert abs(correlation) == pytest.approx(1, abs=1e-6)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red-green chart of few cycles, which 64 samples resolve; its name would be markup."""
    path = tmp_path_factory.mktemp("charts") / "a & 'b'.xml"
    slides = write_colour_chart(path, RED_GREEN, "red-green", width=256, height=64, die_mm=0.2)
    assert [file.name for file in slides] == [f"a & 'b'_{name}.exr" for name in PRIMARIES]
    return path


@pytest.mark.parametrize("die_height_mm", [None, 1.3568])
def test_scene_gives_three_spectra_times_three_slides(
    written: Path, die_height_mm: float | None
) -> None:
    # Upright, on dies of two shapes, to 1 % of the mean: the texture between its texels, and the
    # noise of 16 samples. A picture that is mirrored or upside down errs by half.
    camera = pixsim.Camera(die_height_mm=die_height_mm)
    image = pixsim.render(load(written, resolution=64), camera)
    rows = 64 if die_height_mm is None else 32
    assert image.factors is not None
    spectra, pictures = image.factors
    lens = camera_factor(camera, image.shape, image.pitch_um) * camera.transmittance
    nm, radiance = primaries()
    full = 683.002 * 5 * photopic_efficiency(nm) @ radiance
    lights = pictures * (spectra @ image.luminous_weight() / full)[:, None, None] / lens
    for light, name in zip(lights, PRIMARIES, strict=True):
        texels = read_channels(written.with_name(f"{written.stem}_{name}.exr"))[0]["Y"]
        expected = texels.reshape(rows, -1, 64, 4).mean(axis=(1, 3))
        np.testing.assert_allclose(light, expected, atol=0.01 * MEAN)


def test_white_of_the_chart_is_that_of_its_lamps(written: Path) -> None:
    # 1000 cd/m² with the chromaticity of D65, to the 6 digits of the scene and CIE's steps of 5 nm.
    image = pixsim.render(load(written, resolution=16), pixsim.Camera(die_mm=0.2))
    assert image.header["white_lamps"] == list(PRIMARIES)
    # Of a screen, by a lamp of intensity 1 through a slide of 1
    xyz = 683.002 * xyz_weights(image) @ image.white_spectrum / (math.pi * PROJECTOR_M**2)
    np.testing.assert_allclose(xyz, 1000 / 0.3290 * np.array([0.3127, 0.3290, 0.3583]), rtol=1e-3)
