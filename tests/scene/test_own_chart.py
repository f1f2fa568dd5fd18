"""A user's picture as a chart: luminance from every format, its border, and the scene that shows
it.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiff import tiff
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import read_channels, write_channels
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.own_chart import GREY, read_luminance, srgb_decoded, with_border
from pixsim.scene.variants import variant

RGB = np.random.default_rng(1).integers(0, 65536, (20, 30, 3))
GREY_16 = RGB[:, :, 0]
WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # Rec. ITU-R BT.709-6


def decoded(codes: np.ndarray, top: int) -> np.ndarray:
    """IEC 61966-2-1, written out."""
    v = codes / top
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def by_mitsuba(path: Path, values: np.ndarray) -> Path:
    mi = import_mitsuba(variant.choose().variant)
    mi.Bitmap(np.ascontiguousarray(values)).write(str(path))
    return path


def written(kind: str, folder: Path) -> tuple[Path, np.ndarray, np.ndarray, float]:
    """A picture file, its luminance as sRGB and as linear numbers, and the error of its format."""
    eight, path = (RGB >> 8).astype(np.uint8), folder / kind.rpartition("-")[2]
    if kind.startswith("grey16"):
        Image.fromarray(GREY_16.astype(np.uint16)).save(path)
        return path, decoded(GREY_16, 65535), GREY_16 / 65535, 0
    if kind.startswith("grey8"):
        Image.fromarray(eight[:, :, 0]).save(path)
        return path, decoded(eight[:, :, 0], 255), eight[:, :, 0] / 255, 0
    if kind.startswith("rgb16"):
        by_mitsuba(path, RGB.astype(np.uint16))
        return path, decoded(RGB, 65535) @ WEIGHTS, RGB / 65535 @ WEIGHTS, 0
    if kind.startswith("rgba"):
        Image.fromarray(np.dstack([eight, np.full((20, 30), 255, np.uint8)])).save(path)
    elif kind.startswith("palette"):
        eight = np.array([[[0, 0, 0], [200, 30, 10]], [[255, 255, 255], [10, 200, 90]]], np.uint8)
        Image.fromarray(eight).convert("P", palette=Image.Palette.ADAPTIVE).save(path)
    elif kind.startswith("light"):
        light = (RGB / 6e4).astype(np.float32)
        if path.suffix == ".exr":
            write_channels(path, {name: light[:, :, index] for index, name in enumerate("RGB")}, {})
            return path, light @ WEIGHTS, light @ WEIGHTS, 0
        by_mitsuba(path, light)
        return (
            path,
            light @ WEIGHTS,
            light @ WEIGHTS,
            float(light.max()) / 128,
        )  # RGBE: 8 bits of the largest
    else:
        Image.fromarray(eight).save(path)
    return path, decoded(eight, 255) @ WEIGHTS, eight / 255 @ WEIGHTS, 0


KINDS = [
    "grey8-a.png",
    "grey16-a.png",
    "rgb8-a.png",
    "rgb16-a.png",
    "rgba-a.png",
    "palette-a.png",
    "grey8-a.tiff",
    "grey16-a.tif",
]


@pytest.mark.parametrize("kind", [*KINDS, "rgb8-a.tiff", "light-a.exr", "light-a.hdr"])
def test_read_luminance_every_format(kind: str, tmp_path: Path) -> None:
    path, expected, linear, error = written(kind, tmp_path)
    assert read_luminance(path) == pytest.approx(expected, rel=1e-6, abs=error + 1e-9)
    assert read_luminance(path, linear=True) == pytest.approx(linear, rel=1e-6, abs=error + 1e-9)


def test_what_is_lost_of_a_picture_is_said(tmp_path: Path) -> None:
    """Pillow reads colours of 16 bits with 8."""
    tiff(tmp_path / "deep.tif", RGB.astype("<u2"), 2)
    with pytest.warns(UserWarning, match="is read with 8 of its 16 bits"):
        read_luminance(tmp_path / "deep.tif")


def test_read_luminance_jpeg_even_grey_and_turned(tmp_path: Path) -> None:
    """JPEG keeps even areas; a camera held upright writes the turn into its metadata (EXIF 6: turn
    right).
    """
    codes = np.full((16, 32), 40, np.uint8)
    codes[:, 16:] = 200
    metadata = Image.Exif()
    metadata[0x0112] = 6
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=100, exif=metadata)
    luminance = read_luminance(tmp_path / "a.jpg")
    assert luminance.shape == (32, 16)
    assert luminance[4, 4] == pytest.approx(decoded(np.array(40), 255), rel=0.02)  # a code is 2 %
    assert luminance[28, 4] == pytest.approx(decoded(np.array(200), 255), rel=0.02)


def test_srgb_decoded_is_continuous_at_its_joint() -> None:
    below, above = srgb_decoded(np.array([0.04045, np.nextafter(0.04045, 1)]))
    assert below == pytest.approx(above, rel=1e-5)  # the standard's constants are rounded


@pytest.mark.parametrize(
    ("aspect", "shape"), [(1.0, (30, 30)), (1.5, (20, 30)), (3.0, (20, 60)), (0.5, (60, 30))]
)
def test_with_border_keeps_aspect_and_states_share(aspect: float, shape: tuple[int, int]) -> None:
    picture = np.ones((20, 30), np.float32)
    texels, share = with_border(picture, aspect)
    assert texels.shape == shape
    assert share == pytest.approx(1 - 600 / texels.size)
    assert (texels == 1).sum() == 600
    assert np.isin(texels, [1, np.float32(GREY)]).all()
    assert np.array_equal(texels, texels[::-1, ::-1]), "centred"


@pytest.mark.parametrize(
    ("name", "content", "wanted"),
    [
        ("a.png", b"no picture", "readable picture"),
        ("a.png", "truncated", "readable picture|damaged"),
        ("a.tiff", "truncated", "readable picture|damaged"),
        ("a.png", "bomb", "exceeds limit"),
        ("a.png", "transparent", "transparent parts"),
        ("a.png", "black", "not all 0"),
        ("a.exr", "nan", "finite luminances"),
        ("a.exr", "channels", "R, G and B, or Y"),
        ("a.exr", b"no picture", "EXR file"),
        ("a.hdr", b"no picture", "Radiance header"),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16000 +X 16000\n", "times its size"),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n", "samples"),
        (
            "a.hdr",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 16\n\x02\x02",
            "Mitsuba cannot|values",
        ),
        ("a.gif", b"GIF89a", "PNG, JPEG, TIFF"),
        ("a.png", "folder", "a folder"),
        ("a.png", "pipe", "a named pipe"),
        ("a.png", None, "does not exist"),
    ],
)
def test_read_luminance_hostile_file_raises(
    name: str, content: bytes | str | None, wanted: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "truncated":
        Image.fromarray(RGB.astype(np.uint8)).save(path)
        path.write_bytes(path.read_bytes()[:-900])
    elif content == "bomb":
        size = struct.pack(
            ">4sIIBBBBB", b"IHDR", 30000, 30000, 1, 0, 0, 0, 0
        )  # the head is enough: nothing is decompressed
        chunks = (
            struct.pack(">I", 13)
            + size
            + struct.pack(">I", zlib.crc32(size))
            + struct.pack(">I4sI", 0, b"IDAT", zlib.crc32(b"IDAT"))
        )
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    elif content == "transparent":
        Image.fromarray(np.zeros((4, 4, 4), np.uint8)).save(path)
    elif content == "black":
        Image.new("L", (4, 4)).save(path)
    elif content in ("nan", "channels"):
        names = "RGB" if content == "nan" else ("depth", "id")
        write_channels(path, dict.fromkeys(names, np.full((4, 4), np.nan, np.float32)), {})
    elif content == "folder":
        path.mkdir()
    elif content == "pipe":
        os.mkfifo(path)
    with pytest.raises(PixsimError, match=wanted):
        read_luminance(path)


# --- In a scene ---

SMALL = (
    "--variant scalar_spectral --resolution 32 -D spp=4 --render-noise 1 --display.dots 64"
    " --pixel.pitch-um 60"
)
LINE = f"run csf {SMALL} --irradiance full"


def white_left(path: Path) -> Path:
    """A picture of 20 × 40: the left half is white, the right one dark."""
    codes = np.full((20, 40), 60, np.uint8)
    codes[:, :20] = 255
    Image.fromarray(codes).save(path)
    return path


def test_run_chart_picture_is_seen_with_its_border(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """White, dark and the grey border in proportion; the picture stands upright in the middle of
    the die.
    """
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "pictures"
    folder.mkdir()
    white_left(folder / "mine.png")
    code, out, err = command(f"{LINE} -D chart=pictures/mine.png --json --out out")
    assert code == 0, err
    score = json.loads(out)
    note = "the picture 'mine.png' keeps its aspect: 50 % of the chart is a grey border"
    assert {"id": "file_as_read", "text": note} in score["notes"]
    assert f"warning: {note}" in err
    light = pixsim.read_exr("out/irradiance.exr")
    assert light.header["parameters"]["chart"] == "mine.png"
    assert str(tmp_path) not in out
    fall_off = pixsim.optics.field_factor(light.shape, light.pitch_um, *_lens(pixsim.Camera()))
    lx = light.illuminance_lx() / fall_off
    white, dark, grey = lx[10:22, 4:12].mean(), lx[10:22, 20:28].mean(), lx[:6].mean()
    assert dark / white == pytest.approx(
        float(decoded(np.array(60), 255)), rel=5e-3
    )  # multijitter at 4 samples: 0.3 %
    assert grey / white == pytest.approx(GREY, rel=5e-3)
    assert lx[26:].mean() == pytest.approx(grey, rel=5e-3)


def _lens(camera: pixsim.Camera) -> tuple[float, float, float]:
    return camera.image_distance_mm, camera.f_number, camera.magnification


@pytest.mark.slow  # test_run_chart_picture_is_seen_with_its_border renders one
def test_chart_command_texture_gives_the_same_light(tmp_path: Path) -> None:
    """By the command, as TOML next to the picture, and by -D."""
    picture, texture = white_left(tmp_path / "mine.png"), tmp_path / "mine.exr"
    code, out, err = command(f"chart {picture} --linear -o {texture} --json")
    assert code == 0, err
    assert {**json.loads(out), "border": 0.5, "kind": "mine.png"} == json.loads(out)
    assert read_channels(texture)[0]["Y"][20, 30] == np.float32(60 / 255)
    (tmp_path / "chart.toml").write_text(
        '[scene]\nchart = "mine.png"\nchart_linear = true\n', encoding="utf-8"
    )
    ways = (
        f"-D chart={texture}",
        f"-D chart={picture} --linear",
        f"--config {tmp_path / 'chart.toml'}",
        f"-D chart={picture}",
    )
    electrons = []
    for way in ways:
        code, out, err = command(f"{LINE} {way} --json --out {tmp_path / 'out'}")
        assert code == 0, err
        electrons.append(json.loads(out)["mean_electrons_e"] / json.loads(out)["integration_s"])
    assert electrons[0] == electrons[1] == electrons[2]
    assert electrons[3] != electrons[0]


def test_scene_hash_of_picture_depends_on_content_only(tmp_path: Path) -> None:
    """Not on its folder, nor on that of the cache."""
    hashes = []
    for number, folder in enumerate(("a", "b", "c")):
        (tmp_path / folder).mkdir()
        path = white_left(tmp_path / folder / "mine.png")
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / f"cache{number}"))
            scene = pixsim.load_scene("csf", chart=path, chart_linear=folder == "c", resolution=32)
            hashes.append(scene.content_hash)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("run csf --linear", ["chart_linear", "without a chart"]),
        ("run csf -D chart=star.exr --linear", ["chart_linear", "star.exr", "linear already"]),
        ("run macbeth --linear", ["chart_linear"]),
        ("run csf -D chart=bad.png", ["bad.png", "readable picture"]),
        ("run csf -D chart=gone.png", ["gone.png", "does not exist"]),
        ("chart mine.png -o out.exr --width 100", ["--width", "mine.png"]),
        ("chart mine.png -o out.png", ["ends in .exr"]),
        ("chart mine.png -o out.exr --aspect 0", ["--aspect"]),
        ("chart csf -o out.exr --linear", ["--linear", "a picture"]),
        ("chart gone.png -o out.exr", ["gone.png", "does not exist"]),
    ],
)
def test_own_chart_wrong_options_raise(
    line: str, wanted: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    white_left(tmp_path / "mine.png")
    (tmp_path / "bad.png").write_bytes(b"no picture")
    assert command("chart siemens_star --width 32 --height 32 -o star.exr")[0] == 0
    assert_refused(*command(line), wanted)
    assert not (tmp_path / "out.exr").exists()
