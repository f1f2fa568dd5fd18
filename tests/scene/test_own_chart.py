"""A user's picture as a chart: luminance from every format, its border, and the scene that shows
it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import load
from helpers.tiff import tiff
from PIL import Image

import pixsim
from pixsim.light.exr import write_channels
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.own_chart import GREY, read_luminance, with_border
from pixsim.scene.variants import variant

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
    """Pillow reads colours of 16 bits with 8."""
    tiff(tmp_path / "deep.tif", RGB.astype("<u2"), 2)
    with pytest.warns(UserWarning, match="is read with 8 of its 16 bits"):
        read_luminance(tmp_path / "deep.tif")


def test_a_turned_jpeg_is_upright(tmp_path: Path) -> None:
    """JPEG keeps uniform areas to a code, 2 %; a camera held upright writes the turn into its
    metadata (EXIF 6: turn right).
    """
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


# --- In a scene ---


def write_picture(path: Path) -> Path:
    """A picture of 20 × 40: the left half is white, the right one dark."""
    codes = np.full((20, 40), 60, np.uint8)
    codes[:, :20] = 255
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(codes).save(path)
    return path


def test_picture_is_seen_with_its_border(tmp_path: Path) -> None:
    """White, dark and the grey border in proportion; the picture stands upright in the middle of
    the die. Multijitter at 4 samples: 0.3 %.
    """
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
