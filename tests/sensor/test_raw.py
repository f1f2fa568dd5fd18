"""Raw frames: files read back as the same numbers, also by other programs."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from helpers.tiff import tiff
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import pixsim
from pixsim import cli
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import (
    BLACK_LEVEL_TAG,
    ENCODING,
    FACTS,
    SUFFIXES,
    WHITE_LEVEL_TAG,
    RawFrame,
    read_frame,
    read_picture,
    write_frame,
)
from pixsim.sensor.readout import Frame

CODES = np.array([[0, 1, 2, 4095], [64, 1000, 4094, 63], [7, 8, 9, 10]], np.int32)
VALUES = (64.25, 4095.0, 12, 5.3, 0.37, 1 / 60, 1 / 3)  # of FACTS
CELL = [[256.0, 257.0], [258.0, 256.0]]


def frame(dn: np.ndarray = CODES, bits: int = 12) -> Frame:
    return Frame(dn, np.zeros(dn.shape), 1 / 60, 0.37, 64.25, 3.0, 5.3, bits, 1 / 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("written", "facts"),
    [
        (frame(), VALUES),
        (RawFrame(CODES), (None,) * 7),
        (RawFrame(CODES[:, :3], black_level_dn=np.tile(CELL, (2, 2))[:3, :3]), None),
    ],
)
def test_numbers_and_facts_are_read_back(
    suffix: str, written: Any, facts: Any, tmp_path: Path
) -> None:
    """And written again, they make the same file."""
    path = tmp_path / f"raw{suffix}"
    write_frame(path, written)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, written.dn)
    assert stored.dn.dtype == np.min_scalar_type(written.dn.max())
    if facts is None:
        np.testing.assert_array_equal(stored.black_level_dn, written.black_level_dn)
        assert "black_level_dn=256…258" in repr(stored)
    else:
        assert tuple(getattr(stored, name) for name in FACTS) == facts
    write_frame(tmp_path / f"again{suffix}", stored)
    assert (tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()


def test_the_smallest_cell_of_black_levels_is_stored(tmp_path: Path) -> None:
    levels = np.tile(CELL, (2, 2))[:3, :3]
    write_frame(tmp_path / "raw.npz", RawFrame(CODES[:, :3], black_level_dn=levels))
    with np.load(tmp_path / "raw.npz") as file:
        np.testing.assert_array_equal(file["black_level_dn"], CELL)


LARGEST = {".npz": 2**32 - 1, ".exr": 2**24 - 1}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "value", [0, 2**16 - 1, 2**16, 2**24, 2**24 + 1, 2**32, -1, 1.7, np.nan, np.inf, 1e30]
)
def test_no_format_holds_another_number(suffix: str, value: float, tmp_path: Path) -> None:
    """Of 16 bits 70000 would be 4464, and float32 rounds 2²⁴ + 1: refused, without a file."""
    path = tmp_path / f"raw{suffix}"
    dn = np.array([[1, value]])
    is_held = 0 <= value <= LARGEST.get(suffix, 2**16 - 1) and value % 1 == 0
    if not is_held:
        with pytest.raises(pixsim.PixsimError, match=r"whole numbers|up to .* bits"):
            write_frame(path, RawFrame(dn))
        assert not list(tmp_path.iterdir())
        return
    write_frame(path, RawFrame(dn))
    np.testing.assert_array_equal(read_frame(path).dn, dn)


def save(path: Path, array: np.ndarray) -> None:
    if path.suffix == ".npz":
        np.savez(path, dn=array)
    else:
        Image.fromarray(array).save(path)


NO_CELL = np.random.default_rng(1).uniform(0, 9, (40, 40))
UNWRITABLE = [
    ("a.npz", RawFrame(np.ones(3)), r"\(rows, columns\)"),
    ("a.npz", RawFrame(np.ones((0, 3))), r"\(rows, columns\)"),
    ("a.npz", RawFrame(CODES, white_level_dn=np.inf), "white_level_dn"),
    ("a.npz", RawFrame(np.full((40, 40), 9), black_level_dn=NO_CELL), "16 × 16"),
    ("a.dat", RawFrame(CODES), r"\.exr, \.tiff, \.tif, \.png, \.npz"),
]


@pytest.mark.parametrize(("name", "written", "words"), UNWRITABLE)
def test_frames_that_cannot_be_written_leave_no_file(
    name: str, written: RawFrame, words: str, tmp_path: Path
) -> None:
    with pytest.raises(pixsim.PixsimError, match=words):
        write_frame(tmp_path / name, written)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a.npz", np.array([[0.5]]), "whole numbers from 0 to"),
        ("a.npz", np.array(["a"]), "whole numbers, "),
        ("a.npz", np.zeros((2, 3, 3)), "red, green and blue"),
        ("a.png", np.zeros((4, 4, 3), np.uint8), "mode RGB"),
        ("a.tiff", np.zeros((4, 4), np.uint8), "mode L"),
        ("a.dat", None, r"\.npz"),
        ("a.png", None, "does not exist"),
    ],
)
def test_files_that_are_no_frames_are_refused(
    name: str, array: np.ndarray | None, words: str, tmp_path: Path
) -> None:
    if array is not None:
        save(tmp_path / name, array)
    with pytest.raises(pixsim.PixsimError, match=words):
        read_frame(tmp_path / name)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_truncated_file_is_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    write_frame(path, frame(np.arange(4096, dtype=np.int32).reshape(64, 64)))
    whole = path.read_bytes()
    for length in range(0, len(whole) - 40, len(whole) // 20):
        path.write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            read_frame(path)


def test_other_programs_read_the_numbers_and_the_facts(tmp_path: Path) -> None:
    for suffix in SUFFIXES:
        write_frame(tmp_path / f"raw{suffix}", frame())
    with Image.open(tmp_path / "raw.png") as image:
        np.testing.assert_array_equal(np.asarray(image), CODES)
        texts = [image.text[name] for name in ("black_level_dn", "white_level_dn", "unit")]
        assert texts == ["64.25", "4095.0", "DN"]
    with Image.open(tmp_path / "raw.tiff") as image:
        np.testing.assert_array_equal(np.asarray(image), CODES)
        levels = [image.tag_v2[tag] for tag in (BLACK_LEVEL_TAG, WHITE_LEVEL_TAG)]
        assert levels == [64.25, 4095]
        assert json.loads(image.tag_v2[270])["integration_s"] == 1 / 60
    with np.load(tmp_path / "raw.npz") as file:
        np.testing.assert_array_equal(file["dn"], CODES)
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, CODES)
        assert file.header()["unit"] == "DN"


def test_facts_of_other_programs_may_be_anything(tmp_path: Path) -> None:
    metadata = PngInfo()
    metadata.add_text("black_level_dn", "many")
    metadata.add_text("bits", "nan")
    path = tmp_path / "odd.png"
    Image.fromarray(CODES.astype(np.uint16)).save(path, pnginfo=metadata)
    assert [getattr(read_frame(path), name) for name in FACTS] == [None] * 7
    np.savez(tmp_path / "one.npz", picture=CODES)
    np.testing.assert_array_equal(read_frame(tmp_path / "one.npz").dn, CODES)


@pytest.mark.parametrize(
    ("facts", "saturated", "at_top"),
    [
        ({"bits": 12}, None, 1 / 12),
        ({"white_level_dn": 4000.0}, None, 2 / 12),
        ({"saturated_fraction": 0.5}, 0.5, None),
    ],
)
def test_fraction_at_the_top_code_is_counted(
    facts: dict[str, float], saturated: float | None, at_top: float | None, tmp_path: Path
) -> None:
    np.savez(tmp_path / "raw.npz", dn=CODES, **facts)
    stored = read_frame(tmp_path / "raw.npz")
    assert (stored.saturated_fraction, stored.top_code_fraction) == (saturated, at_top)


def test_formats_of_16_bits_are_refused_for_frames_of_more(tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit):
        cli.main(["run", "csf", "--pixel.bits", "20", "--raw", "png", "--out", f"{tmp_path}/deep"])
    assert "--raw: got tiff or png for frames of 20 bits" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# --- TIFF/EP, DNG and PNG of other programs


@pytest.mark.parametrize(
    ("layout", "size", "pattern"),
    [
        ("GR/BG", (2, 2), (1, 0, 2, 1)),
        ("RGB/GGR", (2, 3), (0, 1, 2, 1, 1, 0)),
        ("RC/CB", None, None),
        ("R+G+B", None, None),
    ],
)
def test_tiff_states_its_mosaic_as_other_programs_do(
    layout: str, size: Any, pattern: Any, tmp_path: Path
) -> None:
    """Tags 33421 and 33422 of TIFF/EP: rows and columns, then 0 for red, 1 for green, 2 for blue;
    none for other colours.
    """
    mosaic = RawFrame(np.arange(36).reshape(6, 6), bits=8, layout=Layout.parse(layout))
    write_frame(tmp_path / "raw.tiff", mosaic)
    with Image.open(tmp_path / "raw.tiff") as picture:
        tags = picture.tag_v2
    stated = tags.get(33422)
    assert tags.get(33421) == size
    assert (stated if stated is None else tuple(stated)) == pattern
    assert str(read_frame(tmp_path / "raw.tiff").layout) == layout


@pytest.mark.parametrize("deflate", [False, True])
def test_mosaic_of_tiff_ep_is_read(deflate: bool, tmp_path: Path) -> None:
    """Photometric interpretation 32803, with its tags; cut off anywhere, it is refused."""
    path = tmp_path / "raw.tif"
    values = np.arange(8 * 6).reshape(8, 6, 1).astype("<u2")
    tags = {"t33421": (3, [2, 2]), "t33422": (1, [1, 2, 0, 1]), "t50714": (3, [64] * 4)}
    tiff(path, values, 32803, deflate=deflate, **tags)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, values[..., 0])
    assert (str(stored.layout), stored.black_level_dn) == ("GB/RG", 64.0)
    whole = path.read_bytes()
    (directory,) = struct.unpack("<I", whole[4:8])
    for length in range(0, directory + 12 * 10, 21):  # of fourteen entries
        path.write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            read_frame(path)


BLACK = {"t50713": (3, [2, 2]), "t50714": (3, [256, 257, 258, 256])}


@pytest.mark.parametrize("photometric", [1, 32803])
def test_black_levels_of_each_place_of_the_cell_are_read(photometric: int, tmp_path: Path) -> None:
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 300, "<u2"), photometric, **BLACK)
    levels = read_frame(tmp_path / "raw.tif").black_level_dn
    np.testing.assert_array_equal(levels, np.tile(CELL, (4, 3)))


@pytest.mark.parametrize("size", [{}, {"t50713": (3, [2, 3])}])
def test_black_levels_that_fit_no_cell_are_named(size: dict[str, Any], tmp_path: Path) -> None:
    tags = {"t50714": (3, [1, 2, 3, 4])} | size
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), 1, **tags)
    with pytest.warns(UserWarning, match="black levels whose cell"):
        assert read_frame(tmp_path / "raw.tif").black_level_dn is None


@pytest.mark.parametrize(
    ("photometric", "tags", "words"),
    [(32803, {"t50829": (3, [1, 2, 7, 6])}, "ActiveArea"), (0, {}, "WhiteIsZero")],
)
def test_tags_that_change_the_numbers_are_refused(
    photometric: int, tags: dict[str, Any], words: str, tmp_path: Path
) -> None:
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), photometric, **tags)
    with pytest.raises(pixsim.PixsimError, match=words):
        read_frame(tmp_path / "raw.tif")


@pytest.mark.parametrize(("gamma", "encoding"), [(1.0, None), (2.2, "TransferFunction")])
def test_transfer_function_of_a_tiff_is_an_encoding(
    gamma: float, encoding: str | None, tmp_path: Path
) -> None:
    curve = np.rint(65535 * np.linspace(0, 1, 256) ** gamma).astype(int).tolist()
    tiff(tmp_path / "picture.tif", np.full((8, 6, 1), 9, "<u2"), 1, t301=(3, curve))
    _, metadata = read_picture(tmp_path / "picture.tif", "picture", SUFFIXES)
    assert metadata.get(ENCODING) == encoding


DEEP = np.random.default_rng(1).integers(0, 65536, (7, 5, 4))


@pytest.mark.parametrize("count", [3, 4])
def test_deep_rgb_of_a_tiff_is_read_to_the_last_bit(count: int, tmp_path: Path) -> None:
    path = tmp_path / "deep.tif"
    tiff(path, DEEP[..., :count].astype("<u2"), 2, **({"t338": (3, [2])} if count == 4 else {}))
    values, _ = read_picture(path, "picture", SUFFIXES, in_colour=True)
    np.testing.assert_array_equal(values, DEEP[..., :3])
    with pytest.raises(pixsim.PixsimError, match="red, green and blue"):
        read_frame(path)


def png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


@pytest.mark.parametrize(("count", "colour_type"), [(3, 2), (4, 6)])
@pytest.mark.parametrize("encoding", [None, "srgb"])
def test_deep_rgb_of_a_png_is_read_to_the_last_bit(
    count: int, colour_type: int, encoding: str | None, tmp_path: Path
) -> None:
    header = struct.pack(">2I5B", 5, 7, 16, colour_type, 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in DEEP[..., :count].astype(">u2"))
    chunks = [
        (b"IHDR", header),
        (b"sRGB", bytes(1)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    if encoding is None:
        del chunks[1]
    body = b"".join(png_chunk(*chunk) for chunk in chunks)
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    values, metadata = read_picture(tmp_path / "deep.png", "picture", SUFFIXES, in_colour=True)
    np.testing.assert_array_equal(values, DEEP[..., :3])
    assert metadata.get(ENCODING) == encoding


@pytest.mark.parametrize(
    ("kind", "photometric", "planar"), [("<f4", 2, False), ("<u2", 2, True), ("<u1", 32803, False)]
)
def test_other_tiffs_are_refused(kind: str, photometric: int, planar: bool, tmp_path: Path) -> None:
    values = np.zeros((4, 4, 1 if photometric == 32803 else 3), kind)
    tiff(tmp_path / "a.tif", values, photometric, planar=planar)
    with pytest.raises(pixsim.PixsimError, match=r"Pillow does not read|a plane for each colour"):
        read_picture(tmp_path / "a.tif", "picture", SUFFIXES, in_colour=True)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.tif", {}),
        ("a.tif", {"big_tiff": True}),
        ("a.tif", {"compression": "tiff_adobe_deflate"}),
        ("a.png", {}),
    ],
)
def test_the_first_of_several_pages_is_read(
    name: str, options: dict[str, Any], tmp_path: Path
) -> None:
    pages = [Image.fromarray(np.full((8, 6), 100 + page, np.uint16)) for page in range(3)]
    pages[0].save(tmp_path / name, save_all=True, append_images=pages[1:], **options)
    with pytest.warns(UserWarning, match="several pages"):
        assert (read_frame(tmp_path / name).dn == 100).all()
