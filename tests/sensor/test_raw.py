"""Raw frames: files read back as the same numbers, also by other programs."""

from __future__ import annotations

import json
import shlex
import struct
import zlib
from pathlib import Path

import numpy as np
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
    read_picture,
    write_frame,
)
from pixsim.sensor.readout import Frame

CODES = np.array([[0, 1, 2, 4095], [64, 1000, 4094, 63], [7, 8, 9, 10]], np.int32)


def frame(dn: np.ndarray = CODES, bits: int = 12) -> Frame:
    return Frame(dn, np.zeros(dn.shape), 1 / 60, 0.37, 64.25, 3.0, 5.3, bits, 1 / 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_write_frame_numbers_read_back(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    pixsim.write_frame(path, frame())
    result = pixsim.read_frame(path)
    np.testing.assert_array_equal(result.dn, CODES)
    assert result.dn.dtype == np.uint16
    assert (result.black_level_dn, result.white_level_dn, result.bits, result.pitch_um) == (
        64.25,
        4095.0,
        12,
        5.3,
    )
    assert (result.dn_per_e, result.integration_s, result.saturated_fraction) == (
        0.37,
        1 / 60,
        1 / 3,
    )
    pixsim.write_frame(tmp_path / f"again{suffix}", result)
    assert (tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()
    assert sorted(item.name for item in tmp_path.iterdir()) == sorted([path.name, f"again{suffix}"])


@pytest.mark.parametrize(
    ("bits", "suffixes"),
    [(8, SUFFIXES), (16, SUFFIXES), (17, (".exr", ".npz")), (24, (".exr", ".npz"))],
)
def test_write_frame_all_codes_read_back(
    bits: int, suffixes: tuple[str, ...], tmp_path: Path
) -> None:
    top = 2**bits - 1
    dn = np.unique(
        np.concatenate([np.arange(300) % (top + 1), top - np.arange(300) % (top + 1)])
    ).astype(np.int32)[None, :]
    for suffix in suffixes:
        pixsim.write_frame(tmp_path / f"raw{suffix}", frame(dn, bits))
        np.testing.assert_array_equal(pixsim.read_frame(tmp_path / f"raw{suffix}").dn, dn)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_write_frame_too_many_bits_raises_and_leaves_no_file(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(
        pixsim.PixsimError, match=r"up to 65536; allowed: 16 bits. Write .exr or .npz"
    ):
        pixsim.write_frame(tmp_path / f"raw{suffix}", frame(np.array([[1, 65536]], np.int32), 17))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("value", [-1, 1.7, np.nan, np.inf, -np.inf, 1e30, 2**32, 70000, 2**24 + 1])
def test_write_frame_keeps_numbers_or_raises(suffix: str, value: float, tmp_path: Path) -> None:
    """No format may hold another number: of 16 bits 70000 would be 4464, and float32 rounds 2²⁴ +
    1.
    """
    dn = np.array([[1, value]])
    if (
        value <= {".npz": 2**32 - 1, ".exr": 2**24}.get(suffix, 2**16 - 1)
        and value >= 0
        and value % 1 == 0
    ):
        pixsim.write_frame(tmp_path / f"raw{suffix}", RawFrame(dn))
        np.testing.assert_array_equal(pixsim.read_frame(tmp_path / f"raw{suffix}").dn, dn)
        return
    with pytest.raises(pixsim.PixsimError, match=r"raw frame .*(whole numbers|up to .* bits)"):
        pixsim.write_frame(tmp_path / f"raw{suffix}", RawFrame(dn))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "dn",
    [
        np.array(3),
        np.ones(3),
        np.ones((0, 3)),
        np.ones((2, 2, 2)),
        np.array([["x"]]),
        np.array([[None]]),
    ],
)
def test_write_frame_no_picture_raises(dn: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(
        pixsim.PixsimError, match=r"whole numbers, \(rows, columns\)|an array of real numbers"
    ):
        pixsim.write_frame(tmp_path / "raw.npz", RawFrame(dn))


def test_write_frame_other_readers_agree(tmp_path: Path) -> None:
    """Pillow, NumPy and OpenEXR read the numbers, and the levels are in DNG's tags."""
    for suffix in (".png", ".tiff", ".npz", ".exr"):
        pixsim.write_frame(tmp_path / f"raw{suffix}", frame())
    for suffix in (".png", ".tiff"):
        with Image.open(tmp_path / f"raw{suffix}") as image:
            np.testing.assert_array_equal(np.asarray(image), CODES)
            assert image.mode == "I;16"
            if suffix == ".png":
                assert (
                    image.text["black_level_dn"],
                    image.text["white_level_dn"],
                    image.text["unit"],
                ) == ("64.25", "4095.0", "DN")
            else:
                assert (image.tag_v2[BLACK_LEVEL_TAG], image.tag_v2[WHITE_LEVEL_TAG]) == (
                    64.25,
                    4095,
                )
                assert json.loads(image.tag_v2[270])["integration_s"] == 1 / 60
    with np.load(tmp_path / "raw.npz") as file:
        np.testing.assert_array_equal(file["dn"], CODES)
        assert str(file["unit"]) == "DN"
    import OpenEXR

    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["DN"].pixels, CODES)
        assert file.header()["unit"] == "DN"


def test_read_frame_without_metadata(tmp_path: Path) -> None:
    """Items that a file of another program does not state are None."""
    Image.fromarray(CODES.astype(np.uint16)).save(tmp_path / "other.png")
    result = pixsim.read_frame(tmp_path / "other.png")
    assert [getattr(result, name) for name in FACTS] == [None] * len(FACTS)
    metadata = PngInfo()
    metadata.add_text("black_level_dn", "many")
    metadata.add_text("bits", "nan")
    Image.fromarray(CODES.astype(np.uint16)).save(tmp_path / "odd.png", pnginfo=metadata)
    result = pixsim.read_frame(tmp_path / "odd.png")
    assert (result.black_level_dn, result.bits) == (None, None)
    np.savez(tmp_path / "one.npz", picture=CODES)
    np.testing.assert_array_equal(pixsim.read_frame(tmp_path / "one.npz").dn, CODES)


def test_raw_frame_foreign_file_has_top_code_fraction(tmp_path: Path) -> None:
    """One pixel of twelve is at 4095; saturated pixels below the top code cannot be counted."""
    path = tmp_path / "raw.npz"
    pixsim.write_frame(path, frame())
    simulated = pixsim.read_frame(path)
    assert (simulated.saturated_fraction, simulated.top_code_fraction) == (1 / 3, 1 / 12)
    assert (
        repr(simulated)
        == "<RawFrame 3 × 4: black_level_dn=64.25, white_level_dn=4095, bits=12, pitch_um=5.3,"
        " dn_per_e=0.37, integration_s=0.0166667, saturated_fraction=0.333333>"
    )
    np.savez(path, dn=CODES, bits=12)
    other = pixsim.read_frame(path)
    assert (other.saturated_fraction, other.top_code_fraction) == (None, 1 / 12)
    np.savez(path, dn=CODES)
    unknown = pixsim.read_frame(path)
    assert (unknown.saturated_fraction, unknown.top_code_fraction) == (None, None)


INVALID = [("a.npz", np.array([[value]]), "whole numbers from 0 to") for value in (0.5, -1, np.nan)]
INVALID += [
    ("a.npz", array, "whole numbers, ")
    for array in (np.array(["a"]), np.zeros((0, 3)), np.zeros((2, 3, 3)))
]
INVALID += [
    ("a.png", np.zeros((4, 4, 3), np.uint8), "mode RGB"),
    ("a.tiff", np.zeros((4, 4), np.uint8), "mode L"),
]


@pytest.mark.parametrize(("name", "array", "message"), INVALID)
def test_read_frame_invalid_values_raise(
    name: str, array: np.ndarray, message: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    np.savez(path, dn=array) if path.suffix == ".npz" else Image.fromarray(array).save(path)
    with pytest.raises(pixsim.PixsimError, match=message):
        pixsim.read_frame(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_read_frame_truncated_file_raises(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    pixsim.write_frame(path, frame(np.arange(4096, dtype=np.int32).reshape(64, 64)))
    whole = path.read_bytes()
    for length in range(0, len(whole) - 40, max(1, len(whole) // 60)):
        path.write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            pixsim.read_frame(path)


def test_write_frame_unknown_ending_raises(tmp_path: Path) -> None:
    for call in (lambda path: pixsim.write_frame(path, frame()), pixsim.read_frame):
        with pytest.raises(pixsim.PixsimError, match=r"\.exr, \.tiff, \.tif, \.png, \.npz"):
            call(tmp_path / "raw.dat")
    with pytest.raises(pixsim.PixsimError, match="does not exist"):
        pixsim.read_frame(tmp_path / "raw.png")


def run(line: str) -> int:
    with pytest.raises(SystemExit) as end:
        cli.main(shlex.split(line))
    return int(end.value.code or 0)


def test_run_writes_frames_of_equal_sfr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    small = (
        "--resolution 192 --display.dots 128 --camera.die-mm 1.0 --pixel.black-level-dn 40"
        " --exposure.well-target 0.7"
    )
    assert run(f"run slanted_edge {small} --raw tiff --raw png --raw npz --out {out}") == 0
    frames = {
        suffix: pixsim.read_frame(out / f"raw{suffix}")
        for suffix in (".exr", ".tiff", ".png", ".npz")
    }
    for result in frames.values():
        np.testing.assert_array_equal(result.dn, frames[".exr"].dn)
        assert (result.black_level_dn, result.white_level_dn, result.bits) == (40.0, 1023.0, 10)
    assert len({pixsim.sfr(out / f"raw{suffix}").to_csv() for suffix in frames}) == 1
    capsys.readouterr()
    assert run(f"run slanted_edge {small} --pixel.bits 20 --raw png --out {tmp_path}/deep") == 2
    assert "--raw: got tiff or png for frames of 20 bits" in capsys.readouterr().err
    assert not (tmp_path / "deep").exists()


def test_write_frame_without_metadata(tmp_path: Path) -> None:
    for suffix in SUFFIXES:
        pixsim.write_frame(tmp_path / f"bare{suffix}", RawFrame(CODES))
        assert pixsim.read_frame(tmp_path / f"bare{suffix}").black_level_dn is None


@pytest.mark.parametrize(
    ("layout", "size", "pattern"),
    [
        ("GR/BG", (2, 2), [1, 0, 2, 1]),
        ("RGB/GGR", (2, 3), [0, 1, 2, 1, 1, 0]),
        ("RC/CB", None, None),
        ("R+G+B", None, None),
    ],
)
def test_tiff_states_its_mosaic_as_other_programs_do(tmp_path, layout, size, pattern):
    """Tags 33421 and 33422 of TIFF/EP: rows and columns, then 0 for red, 1 for green, 2 for blue;
    none for other colours.
    """
    frame = RawFrame(np.arange(36).reshape(6, 6), bits=8, layout=Layout.parse(layout))
    write_frame(tmp_path / "raw.tiff", frame)
    with Image.open(tmp_path / "raw.tiff") as picture:
        tags = picture.tag_v2
    assert tags.get(33421) == size
    assert (list(tags[33422]) if pattern else tags.get(33422)) == pattern
    assert str(pixsim.read_frame(tmp_path / "raw.tiff").layout) == layout


@pytest.mark.parametrize("deflate", [False, True])
def test_mosaic_of_tiff_ep_is_read(deflate: bool, tmp_path: Path) -> None:
    """Photometric interpretation 32803, with its tags; cut off anywhere, it is refused."""
    values = np.arange(8 * 6).reshape(8, 6, 1).astype("<u2")
    tiff(
        tmp_path / "raw.tif",
        values,
        32803,
        deflate=deflate,
        t33421=(3, [2, 2]),
        t33422=(1, [1, 2, 0, 1]),
        t50714=(3, [64] * 4),
    )
    frame = pixsim.read_frame(tmp_path / "raw.tif")
    np.testing.assert_array_equal(frame.dn, values[..., 0])
    assert (str(frame.layout), frame.black_level_dn) == ("GB/RG", 64.0)
    whole = (tmp_path / "raw.tif").read_bytes()
    (directory,) = struct.unpack("<I", whole[4:8])
    for length in range(0, directory + 12 * 10, 7):  # of fourteen entries
        (tmp_path / "raw.tif").write_bytes(whole[:length])
        with pytest.raises(pixsim.PixsimError):
            pixsim.read_frame(tmp_path / "raw.tif")


def test_tags_of_dng_that_are_not_applied_are_named(tmp_path: Path) -> None:
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), 32803, t50829=(3, [1, 2, 7, 6]))
    with pytest.raises(pixsim.PixsimError, match=r"raw\.tif.*got the tags ActiveArea of DNG"):
        pixsim.read_frame(tmp_path / "raw.tif")


@pytest.mark.parametrize("count", [3, 4])
def test_deep_rgb_is_read_to_the_last_bit(count: int, tmp_path: Path) -> None:
    values = np.random.default_rng(1).uniform(0, 65535, (7, 5, count)).astype("<u2")
    extra = {"t338": (3, [2])} if count == 4 else {}
    tiff(tmp_path / "deep.tif", values, 2, **extra)
    picture, _ = read_picture(tmp_path / "deep.tif", "picture", SUFFIXES, in_colour=True)
    np.testing.assert_array_equal(picture, values[..., :3])
    with pytest.raises(pixsim.PixsimError, match="red, green and blue"):
        pixsim.read_frame(tmp_path / "deep.tif")


@pytest.mark.parametrize("count", [3, 4])
def test_png_of_16_bits_in_colour_is_read_to_the_last_bit(count: int, tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 65536, (7, 5, count)).astype(">u2")

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    header = struct.pack(">2I5B", 5, 7, 16, {3: 2, 4: 6}[count], 0, 0, 0)
    rows = zlib.compress(b"".join(b"\0" + row.tobytes() for row in values))
    path = tmp_path / "deep.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )
    found, metadata = read_picture(path, "picture", SUFFIXES, in_colour=True)
    np.testing.assert_array_equal(found, values[..., :3])
    assert ENCODING not in metadata
    chunks = [(b"IHDR", header), (b"sRGB", bytes(1)), (b"IDAT", rows), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*one) for one in chunks))
    assert read_picture(path, "picture", SUFFIXES, in_colour=True)[1][ENCODING] == "srgb"


@pytest.mark.parametrize(
    ("kind", "photometric", "planar"), [("<f4", 2, False), ("<u2", 2, True), ("<u1", 32803, False)]
)
def test_other_tiffs_are_refused(kind: str, photometric: int, planar: bool, tmp_path: Path) -> None:
    values = np.zeros((4, 4, 1 if photometric == 32803 else 3), kind)
    tiff(tmp_path / "a.tif", values, photometric, planar=planar)
    with pytest.raises(
        pixsim.PixsimError, match=r"a\.tif.*(Pillow does not read|a plane for each colour)"
    ):
        read_picture(tmp_path / "a.tif", "picture", SUFFIXES, in_colour=True)


CELL = [[256.0, 257.0], [258.0, 256.0]]
MOSAIC: dict[str, tuple] = {"t33421": (3, [2, 2]), "t33422": (1, [0, 1, 1, 2])}
BLACK: dict[str, tuple] = {"t50713": (3, [2, 2]), "t50714": (3, [256, 257, 258, 256])}


def edge_codes(shape: tuple[int, int] = (160, 120)) -> np.ndarray:
    """A slanted edge between 100 and 1000 codes of green above black, 0.6 of it in red and 0.8 in
    blue, RGGB, with CELL.
    """
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    right = np.clip(
        (columns - shape[1] / 2 + (rows - shape[0] / 2) * np.tan(np.radians(5))) / 1.2 + 0.5, 0, 1
    )
    light = (100 + 900 * right) * np.tile([[0.6, 1.0], [1.0, 0.8]], (shape[0] // 2, shape[1] // 2))
    noise = np.random.default_rng(1).standard_normal(shape) * np.sqrt(light) / 3
    return np.rint(light + noise + np.tile(CELL, (shape[0] // 2, shape[1] // 2))).astype("<u2")


@pytest.mark.parametrize("photometric", [1, 32803])
def test_black_levels_of_each_place_of_the_cell_are_used(photometric: int, tmp_path: Path) -> None:
    """The contrast of every channel is (1000 - 100)/(1000 + 100); with black left in, that of red
    is 0.46.
    """
    tiff(tmp_path / "raw.tif", edge_codes()[..., None], photometric, **MOSAIC, **BLACK)
    levels = pixsim.read_frame(tmp_path / "raw.tif").black_level_dn
    np.testing.assert_array_equal(levels, np.tile(CELL, (80, 60)))
    for channel in "RGB":
        edge = pixsim.sfr(tmp_path / "raw.tif", channel=channel)
        # Noise of 4 codes and less in 600 pixels of each side, and half a code: below 0.002 of the
        # contrast.
        assert edge.contrast == pytest.approx(900 / 1100, abs=0.004)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_black_levels_of_a_cell_are_written(suffix: str, tmp_path: Path) -> None:
    levels = np.tile(CELL, (3, 2))[:5, :3]
    write_frame(
        tmp_path / f"raw{suffix}",
        RawFrame(np.arange(300, 315).reshape(5, 3), black_level_dn=levels),
    )
    back = pixsim.read_frame(tmp_path / f"raw{suffix}")
    np.testing.assert_array_equal(back.black_level_dn, levels)
    assert "black_level_dn=256…258" in repr(back)
    write_frame(tmp_path / f"again{suffix}", back)
    assert (tmp_path / f"again{suffix}").read_bytes() == (tmp_path / f"raw{suffix}").read_bytes()


def test_black_levels_without_a_cell_are_not_written(tmp_path: Path) -> None:
    levels = np.random.default_rng(1).uniform(0, 9, (40, 40))
    with pytest.raises(
        pixsim.PixsimError, match="another one for each pixel; allowed: cells of up to 16 × 16"
    ):
        write_frame(tmp_path / "raw.npz", RawFrame(np.full((40, 40), 9), black_level_dn=levels))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "tags", [{"t50714": (3, [1, 2, 3, 4])}, {"t50713": (3, [2, 3]), "t50714": (3, [1, 2, 3, 4])}]
)
def test_black_levels_that_fit_no_cell_are_named(tags: dict[str, tuple], tmp_path: Path) -> None:
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), 1, **tags)
    with pytest.warns(UserWarning, match="states black levels that fit no cell"):
        assert pixsim.read_frame(tmp_path / "raw.tif").black_level_dn is None


def test_values_that_fall_with_the_light_are_refused(tmp_path: Path) -> None:
    tiff(tmp_path / "raw.tif", np.full((8, 6, 1), 9, "<u2"), 0)
    with pytest.raises(pixsim.PixsimError, match="WhiteIsZero"):
        pixsim.read_frame(tmp_path / "raw.tif")


def test_transfer_function_of_a_tiff_is_an_encoding(tmp_path: Path) -> None:
    level = np.linspace(0, 1, 256)
    for gamma, encoding in ((1.0, None), (2.2, "TransferFunction")):
        curve = np.rint(65535 * level**gamma).astype(int).tolist()
        tiff(tmp_path / "picture.tif", np.full((8, 6, 1), 9, "<u2"), 1, t301=(3, curve))
        assert (
            read_picture(tmp_path / "picture.tif", "picture", SUFFIXES)[1].get(ENCODING) == encoding
        )


PAGES = [Image.fromarray(np.full((8, 6), 100 + number, np.uint16)) for number in range(3)]


@pytest.mark.parametrize("options", [{}, {"big_tiff": True}, {"compression": "tiff_adobe_deflate"}])
def test_pages_of_a_tiff_are_named(options: dict[str, object], tmp_path: Path) -> None:
    PAGES[0].save(tmp_path / "stack.tif", save_all=True, append_images=PAGES[1:], **options)
    with pytest.warns(UserWarning, match=r"stack\.tif' has several pages: the first is read"):
        assert (pixsim.read_frame(tmp_path / "stack.tif").dn == 100).all()


def test_pages_of_a_png_are_named(tmp_path: Path) -> None:
    PAGES[0].save(tmp_path / "moving.png", save_all=True, append_images=PAGES[1:])
    with pytest.warns(UserWarning, match="has several pages"):
        pixsim.read_frame(tmp_path / "moving.png")
