"""Malicious or damaged input is rejected with a message, in limited time and memory, without
partial files.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import resource
import signal
import stat
import struct
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import OpenEXR
import pytest
from helpers.commands import command
from helpers.fuzz_targets import CONFIG, ENVI, SCENE, changed, light, read_picture, rows, seeds
from helpers.processes import HANG_S
from hypothesis import HealthCheck, given, settings, strategies as st

import pixsim
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import MAX_FILE_VARIABLE, digest_of
from pixsim.base.schema import KEY, SCHEMA
from pixsim.cli.options import SceneOptions
from pixsim.light.exr import read_channels
from pixsim.measure import datasheet
from pixsim.measure.sfr import read_edge_picture
from pixsim.scene.scene import load_scene
from pixsim.sensor.technology import load_technology
from pixsim.show import figures
from pixsim.studies.files import load_study
from pixsim.studies.table import CHECK, COLUMNS, Store, check_of

DATA = Path(pixsim.__file__).parent / "data"
FEW = {
    "shape": (60, 60),
    "stack_frames": 8,
}  # size of a data sheet's experiment whose numbers do not matter
FEW_FRAMES = f"""
import functools
from pixsim import cli
from pixsim.measure import datasheet
datasheet.make_datasheet = functools.partial(datasheet.make_datasheet, **{FEW})
cli.main()
"""
MAX_KIB = 256 << 10  # of additional memory
SMALL = "--resolution 32 --display.dots 32"


@contextmanager
def in_time() -> Iterator[None]:
    """Stop a reader that waits for a pipe or for the end of a device."""
    before = signal.signal(signal.SIGALRM, Mock(side_effect=TimeoutError(f"more than {HANG_S} s")))
    signal.alarm(HANG_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@contextmanager
def rejected(*texts: str) -> Iterator[None]:
    """PixsimError with these texts, in limited time and memory."""
    before = peak_kib()
    with in_time(), pytest.raises(PixsimError) as error:
        yield
    assert [text for text in texts if text not in str(error.value)] == [], error.value
    assert peak_kib() - before < MAX_KIB


def run_command(line: str, *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command in this process."""
    with in_time(), warnings.catch_warnings(action="ignore"):
        return command(line, *arguments)


def assert_command_rejects(line: str, *arguments: object) -> None:
    code, out, err = run_command(line, *arguments)
    assert (code, out) == (2, ""), err
    assert "Traceback" not in err
    assert "unexpected" not in err


# --- Not regular files
# ---------------------------------------------------------------------------------------------------


def irregular_files(folder: Path, suffix: str) -> Iterator[Path]:
    os.mkfifo(pipe := folder / f"pipe{suffix}")
    (loop := folder / f"loop{suffix}").symlink_to(loop)
    (device := folder / f"zero{suffix}").symlink_to("/dev/zero")
    (folder / f"folder{suffix}").mkdir()
    (system := folder / f"pagemap{suffix}").symlink_to(
        "/proc/self/pagemap"
    )  # regular, of size 0, and without an end
    os.mknod(socket := folder / f"socket{suffix}", stat.S_IFSOCK | 0o600)
    return iter(
        [
            pipe,
            loop,
            device,
            folder / f"folder{suffix}",
            folder / ("x" * 300 + suffix),
            system,
            socket,
        ]
    )


@pytest.mark.parametrize(
    ("suffix", "line"),
    [
        *((suffix, "run {}") for suffix in (".xml", ".npz", ".hdr")),
        (".png", "sfr {}"),
        (".toml", "run csf --config {}"),
        (".toml", "run csf --pixel.technology {}"),
        (".zmx", "lens {}"),
        (".exr", "plan csf -D chart={}"),
        (".csv", "run csf --pixel.quantum-efficiency {}"),
    ],
)
def test_command_irregular_file_does_not_block(tmp_path, monkeypatch, suffix, line):
    monkeypatch.chdir(tmp_path)
    for path in irregular_files(tmp_path, suffix):
        assert_command_rejects(line.format(path))
    assert not (tmp_path / "pixsim-out").exists()


def test_digest_of_irregular_file_raises(tmp_path):
    """Output folders and scenes name files whose content is hashed."""
    for path in irregular_files(tmp_path, ""):
        with rejected():
            digest_of(path)
    (tmp_path / "a").write_bytes(b"abc")
    assert digest_of(tmp_path / "a") == hashlib.blake2b(b"abc", digest_size=16).hexdigest()


SECRET = b"k3y-of-another-file"


@pytest.mark.parametrize("before", [b"", b"\x93NUMPY\x01\x00\x40\x00", b"ENVI\n", b"<a "])
def test_command_does_not_quote_a_file_of_another_format(tmp_path, before):
    """A study of a stranger may name the user's own files, and the output may go back to the
    stranger.
    """
    for suffix, line in [
        *((suffix, "run {}") for suffix in (".xml", ".exr", ".npz", ".hdr")),
        *((suffix, "sfr {}") for suffix in (".png", ".npy", ".tiff")),
        *((suffix, "plan csf -D chart={}") for suffix in (".exr", ".hdr", ".jpg")),
        (".toml", "run csf --config {}"),
        (".toml", "datasheet {}"),
        *((suffix, "lens {}") for suffix in (".toml", ".zmx")),
        (".csv", "run csf --pixel.quantum-efficiency {}"),
    ]:
        (path := tmp_path / f"a{suffix}").write_bytes(before + SECRET + b"\n" + SECRET)
        code, out, err = run_command(line.format(path))
        assert (code, out) == (2, ""), err
        assert SECRET.decode() not in err


def test_invalid_escapes_control_characters():
    assert str(invalid("x", "\x1b[2J\u202e\0", "y")) == "x: got \\x1b[2J\\u202e\\x00; allowed: y."
    assert len(str(invalid("x", "y" * 10**6, "z"))) < 21_000


# --- TOML
# --------------------------------------------------------------------------------------------------------------

TOMLS = {
    "large": b"#" * ((1 << 20) + 1),
    "lists": b"a = " + b"[" * 200_000,
    "tables": b"a = " + b"{b = " * 100_000,
    "deep": b"[" + b"a." * 40 + b"a]",
    "dots": b"a" + b".b" * 20_000 + b" = 1",
    "spaced dots": b"a" + b' . "b"' * 20_000 + b" = 1",
    "no UTF-8": b"a = '\xff'",
    "NUL": b"a = '\0'",
    "digits": b"seed = " + b"9" * 1_000_000,
    "hexadecimal": b"seed = 0x" + b"f" * 1000,
    "twice": b"seed = 1\nseed = 2",
    "date": b"seed = 1979-05-27",
    "no date": b"seed = 1979-99-99",
    "nothing known": b"a = 1",
    "other types": b"camera = 3\npixel = [1]\nname = {}\n",
}


@pytest.mark.parametrize("content", TOMLS.values(), ids=TOMLS.keys())
def test_read_toml_hostile_file_raises(tmp_path, content):
    (path := tmp_path / "a.toml").write_bytes(content)
    for read in (
        lambda: SceneOptions([path]).settings(),
        lambda: load_study(path),
        lambda: load_technology(str(path)),
    ):
        with rejected("a.toml"):
            read()


# --- XML
# ---------------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a valid scene, below a folder with a file that it must not include."""
    (folder := tmp_path / "scene").mkdir()
    seeds(folder)
    (tmp_path / "outside.xml").write_text('<scene version="3.0.0"/>')
    return folder


def with_more(folder: Path, more: str, before: str = "<shape") -> Path:
    assert before in SCENE
    (folder / "scene.xml").write_text(SCENE.replace(before, more + before, 1), encoding="utf-8")
    return folder / "scene.xml"


def load(path: Path, **parameters: object) -> pixsim.scene.Scene:
    return load_scene(path, variant="scalar_spectral", **parameters)


LAUGHS = "<!DOCTYPE scene [" + "".join(
    f'<!ENTITY l{n} "{f"&l{n - 1};" * 10 if n else "ha"}">' for n in range(10)
)  # fmt: skip
DEFAULTS = "".join(
    f'<default name="p{n}" value="{f"$p{n - 1}" * 10 if n else "ha"}"/>' for n in range(10)
)
TWINS = '<bsdf type="diffuse" id="t0"/>' + "".join(
    f'<bsdf type="twosided" id="t{n}"><ref id="t{n - 1}"/></bsdf>' for n in range(1, 40)
)


@pytest.mark.parametrize(
    ("before", "more", "words"),
    [
        ("<scene", LAUGHS + "]>", "DOCTYPE"),
        ("<scene", '<!DOCTYPE scene [<!ENTITY e SYSTEM "file:///etc/passwd">]>', "DOCTYPE"),
        ("<scene", "<!DOCTYPE scene>", "DOCTYPE"),
        ("<shape", '<bsdf type="twosided">' * 100 + "</bsdf>" * 100, "nested"),
        ("<shape", "<a>" * 200_000, "nested"),
        ("<shape", TWINS, "references nested"),
        ("<shape", '<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>', "circul"),
        ("<shape", '<ref id="ghost"/>', "a reference to 'ghost'"),
        ("<shape", DEFAULTS + '<string name="a" value="$p9"/>', "too many substitutions"),
        ("<shape", "".join(f'<default name="q{n}" value="1"/>' for n in range(600)), "parameters"),
        ("<shape", '<include filename="scene.xml"/>', "includes nested too deep"),
        ("<shape", '<include filename="part.xml"/>' * 65, "more than 64 includes"),
        ("<shape", '<include filename="../outside.xml"/>', "in another folder"),
        ("<shape", '<include filename="link.xml"/>', "in another folder"),
        ("<shape", '<include filename="/etc/passwd"/>', "in another folder"),
        ("<shape", '<default name="f" value="../outside.xml"/><include filename="$f"/>', "in another folder"),
        ("<shape", '<include filename="ghost.xml"/>', "does not exist"),
        ("<shape", '<include filename="pipe.xml"/>', "a named pipe"),
        ("<shape", '<path value="nowhere"/>', "a <path> in line"),
        ("<shape", '<shape type="nosuch"/>', ""),
        ("<shape", '<texture type="bitmap"><string name="filename" value="pipe.xml"/></texture>', "a named pipe"),
        ("<shape", '<bsdf type="diffuse"><spectrum name="reflectance" filename="/dev/zero"/></bsdf>', "in another folder"),
        ("<shape", '<bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" '
                   'value="bomb.png"/></texture></bsdf>', "bomb.png"),
        ("<shape", "<!-- " + "x" * 100, "unclosed token"),
        ("<shape", '<shape type="sphere"><transform name="to_world"><scale x="0"/></transform></shape>', "to_world"),
        ("<shape", '<shape type="sphere"><transform name="to_world"><scale x="nan"/></transform></shape>', "to_world"),
        ("<shape", '<shape type="sphere"><transform name="to_world"><translate x="inf"/></transform></shape>', "to_world"),
        ("<shape", '<shape type="sphere"><string name="to_world" value="x"/></shape>', "to_world"),
    ],
)  # fmt: skip
def test_load_scene_hostile_xml_raises(folder, before, more, words):
    os.mkfifo(folder / "pipe.xml")
    (folder / "link.xml").symlink_to("../outside.xml")
    (folder / "bomb.png").write_bytes(png_bomb())
    with rejected(words):
        scene = load(with_more(folder, more, before))
        pixsim.render(scene, scene.camera(), seed=0)


@pytest.mark.parametrize(
    "content",
    [b"", b"\0", b"<scene version='3.0.0'", b"{}", b"\x7fELF", b"<" * (9 << 20), b"<a " * 10**6],
)
def test_load_scene_not_xml_raises(tmp_path, content):
    (tmp_path / "a.xml").write_bytes(content)
    with rejected("a.xml"):
        load(tmp_path / "a.xml")


def test_load_scene_malformed_comments_are_harmless(folder):
    """Mitsuba's parser accepts them; a comment mark in quotes does not hide an include."""
    load(with_more(folder, '<!-- -- a "quote -- <include filename="ghost.xml"/> --->'))
    with rejected("scene.xml"):
        load(
            with_more(
                folder,
                '<string name="a" value="<!--"/><include filename="../outside.xml"/><string'
                ' name="b" value="-->"/>',
            )
        )


@pytest.mark.parametrize(
    "setting",
    [
        "resolution=1000000000", "resolution=-1", "resolution=0", "resolution=1e9", "spp=1000000000", "spp=-1", "spp=0",
        "chart_half_width=0", "chart_half_width=nan", "emitter_scale=1e300", "emitter_scale=nan", "fov=nan", "fov=$fov",
        "focus_distance=inf", 'chart=a"b$c', "chart='<&", "chart=ünï.exr", "chart=" + "x" * 3000, "chart=../../../etc/passwd",
        "=", "spp",
    ],
)  # fmt: skip
def test_run_hostile_parameter_is_rejected(tmp_path, setting):
    assert_command_rejects(f"run csf {SMALL} --out", tmp_path / "out", "-D", setting)
    assert not (tmp_path / "out").exists()


# --- EXR, npz, ENVI, PNG
# -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sides", [(1 << 31) - 1, 65535, 99_999, -5])
def test_read_exr_oversized_header_raises(tmp_path, sides):
    pixsim.write_exr(tmp_path / "a.exr", light())
    whole, window = (tmp_path / "a.exr").read_bytes(), struct.pack("<4i", 0, 0, 4, 3)
    assert window in whole
    (tmp_path / "a.exr").write_bytes(whole.replace(window, struct.pack("<4i", 0, 0, sides, sides)))
    for read in (read_picture, read_channels, read_edge_picture):
        with rejected("a.exr"):
            read(tmp_path / "a.exr")


EXR_KINDS = {
    "several parts": [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Y": np.ones((8, 8), np.float32)}, name) for name in "ab"],
    "5000 channels": [
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, {f"c{n}": np.ones((1, 1), np.float32) for n in range(5000)}, "a")
    ],
}  # fmt: skip


@pytest.mark.parametrize("words", EXR_KINDS)
def test_read_exr_of_an_unsupported_kind_raises(tmp_path, words):
    with OpenEXR.File(EXR_KINDS[words]) as file:
        file.write(str(tmp_path / "a.exr"))
    with rejected(words):
        read_channels(tmp_path / "a.exr")


def test_read_exr_in_tiles_but_not_deep(tmp_path):
    y = np.ones((8, 8), np.float32)
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    with OpenEXR.File(header, {"Y": y}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr")[0]["Y"], y)
    content = bytearray((tmp_path / "a.exr").read_bytes())
    content[5] |= 0x08  # the bit of a deep image
    (tmp_path / "a.exr").write_bytes(content)
    with rejected("a deep image"):
        read_channels(tmp_path / "a.exr")


@pytest.mark.parametrize("bits", ["x", 1e9, -1, float("nan")])
def test_read_edge_picture_invalid_bits_raises(tmp_path, bits):
    with OpenEXR.File(
        {"type": OpenEXR.scanlineimage, "bits": bits}, {"Y": np.ones((8, 8), np.float32)}
    ) as file:
        file.write(str(tmp_path / "a.exr"))
    with rejected("bits"):
        read_edge_picture(tmp_path / "a.exr")


@pytest.mark.parametrize(
    "header",
    [
        {"camera": 3}, {"camera": {"f_number": "x"}}, {"parameters": None, "scene": "csf.xml"}, {"scene": []},
        {"luminance_cd_per_m2": "x"}, {"luminance_cd_per_m2": -1}, {"lamp_w_per_m2_sr_nm": [1]}, {"lamp_w_per_m2_sr_nm": "x"},
        {"white_lamps": 3}, {"white_lamps": [3]},
    ],
)  # fmt: skip
def test_read_picture_invalid_header_raises(tmp_path, header):
    image = light()
    image.header |= header
    pixsim.write_exr(tmp_path / "a.exr", image)
    with rejected("a.exr"):
        read_picture(tmp_path / "a.exr")


def npy(shape: tuple[int, ...], descr: str = "<f4", content: bytes = b"") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return file.getvalue() + content


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize(
    "data",
    [npy((1 << 40,)), npy((1 << 20, 1 << 20, 3)), npy((-1, 4, 3)), npy((4, 5), "|O", b"x" * 160), npy((0, 5, 3)), npy((4, 5, 3)),
     b"", b"x" * 99, npy((), "<U100000000"), npy((4, 5, 3), "<U1", b"\0" * 240), npy((1,), "|V9", b"x" * 9),
     npy((4, 5, 3), "<c8", b"\0" * 480)],
)  # fmt: skip
def test_read_npz_hostile_array_raises(tmp_path, data):
    nm = npy((3,), "<f8", np.array([450.0, 550, 650]).tobytes())
    path = npz(tmp_path / "a.npz", data=data, wavelength_nm=nm, units=npy((), "<U1", b"W\0\0\0"))
    with rejected("a.npz"):
        read_picture(path)
    (tmp_path / "a.npy").write_bytes(data)
    with rejected():
        pixsim.edge_response(read_edge_picture(tmp_path / "a.npy").data)


def test_read_npz_zip_bomb_raises(tmp_path):
    path = tmp_path / "a.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file,
        file.open("data.npy", "w") as member,
    ):
        member.write(npy((1 << 20,), "|u1"))
        for _ in range(16):
            member.write(b"\0" * (1 << 20))
    path.write_bytes(
        path.read_bytes().replace(struct.pack("<I", (1 << 24) + 128), struct.pack("<I", 1 << 31))
    )
    with rejected("a.npz"):
        read_edge_picture(path)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as file:
        for number in range(5000):
            file.writestr(f"{number}.npy", b"")
    with rejected("5000 members"):
        read_edge_picture(tmp_path / "b.npz")


@pytest.mark.parametrize("packing", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_read_frame_unusual_packing_raises(tmp_path, packing):
    """A header of LZMA declares the memory that its decoder takes."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", packing) as file:
        file.writestr("dn.npy", npy((2, 3), "<u2", bytes(12)))
    with rejected("stored or deflated"):
        pixsim.read_frame(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "kind", ["light.exr", "light.npz", "cube.hdr", "edge.npy", "edge.png", "raw.npz"]
)
def test_reader_has_one_limit_of_size_that_can_be_set(targets, kind, monkeypatch):
    path, _, reader = targets[kind]
    monkeypatch.setenv(MAX_FILE_VARIABLE, "1e-8")  # 10 bytes
    with rejected(MAX_FILE_VARIABLE):
        reader(path)
    monkeypatch.setenv(MAX_FILE_VARIABLE, "1e-5")
    assert reader(path) is not None
    for text in ("x", "-1", "nan", "inf"):
        monkeypatch.setenv(MAX_FILE_VARIABLE, text)
        with rejected(MAX_FILE_VARIABLE, "a size in GiB"):
            reader(path)


def test_read_picture_bomb_takes_no_memory(tmp_path, monkeypatch):
    """Declared content counts, not the size of the file: 17 MB of zeros are 17 kB in a zip, and
    nothing in a sparse file.
    """
    monkeypatch.setenv(MAX_FILE_VARIABLE, "0.01")
    npz(
        tmp_path / "a.npz",
        data=npy((1 << 11, 1 << 10, 2), content=bytes(1 << 24)),
        wavelength_nm=npy((2,), content=bytes(8)),
    )
    with rejected("a.npz", MAX_FILE_VARIABLE):
        read_picture(tmp_path / "a.npz")
    with (tmp_path / "a.npy").open("wb") as file:
        file.write(npy((1 << 20, 1 << 18)))
        file.truncate((1 << 40) + 128)
    with rejected("a.npy", MAX_FILE_VARIABLE):
        read_edge_picture(tmp_path / "a.npy")
    monkeypatch.delenv(MAX_FILE_VARIABLE)
    with rejected("a.npy", MAX_FILE_VARIABLE):
        read_edge_picture(tmp_path / "a.npy")


def png_bomb(side: int = 40_000) -> bytes:
    """A grey picture of 16 bits, all zeros."""
    rows_of_zeros = zlib.compressobj(9)
    line = b"\0" * (2 * side + 1)
    packed = b"".join(rows_of_zeros.compress(line) for _ in range(64)) + rows_of_zeros.flush()

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content))
            + kind
            + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )

    head = struct.pack(">2I5B", side, side, 16, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("side", [40_000, 16_000, 100])
def test_read_png_bomb_raises(tmp_path, side):
    (tmp_path / "a.png").write_bytes(png_bomb(side)[: None if side > 100 else 60])
    with rejected("a.png"):
        read_edge_picture(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("old", "new"),
    [("lines = 4", "lines = 1000000000000"), ("lines = 4", "lines = -4"), ("samples = 5", "samples = {5, 5}"),
     ("bands = 3", "bands = 3e9"), ("header offset = 0", "header offset = 999999999999999999999"), ("ENVI\n", ""), ("450", "x"),
     ("header offset = 0", "header offset = -8"), ("byte order = 0", "byte order = 7"), ("data type = 4", "data type = 99"),
     ("samples = 5", "samples = 6"), ("}", ""), ("fwhm", "\n" * 30_000 + "fwhm"), ("fwhm", "x" * (1 << 20) + " = 3\nfwhm"),
     ("pitch_um = 5", "pitch_um = 1e30"),
     ("pitch_um = 5", "pitch_um = 5\ndata file = /etc/passwd")],
)  # fmt: skip
def test_read_envi_hostile_header_raises(tmp_path, old, new):
    if "/etc/passwd" in new:
        os.mkfifo(tmp_path / "a.img")
    else:
        light().data.transpose(2, 0, 1).tofile(tmp_path / "a.img")
    (tmp_path / "a.hdr").write_text(ENVI.replace(old, new))
    with rejected("a."):
        read_picture(tmp_path / "a.hdr")


# --- Results and cache
# -----------------------------------------------------------------------------------------------------

HEAD = ",".join([*COLUMNS, KEY, CHECK]).encode() + b"\n"
ENDLESS = (  # of a repeat that no study has
    f"key1,0.35um,1.5,1e18{',1.5' * (len(COLUMNS) - 4)},{SCHEMA}"
)


@pytest.mark.parametrize(
    "content",
    [b"\0" * 1000, b"\xff\xfe\n" * 9, HEAD + b"x" * 500_000 + b"\n", b'"' + b"\n" * 1000,
     b"\r" * 99,
     HEAD + f"{ENDLESS},{check_of(ENDLESS, HEAD.decode().strip())}\n".encode()],
)  # fmt: skip
def test_results_file_damaged_rows_are_dropped(tmp_path, content):
    (tmp_path / "results.csv").write_bytes(content)

    def is_needed(row: dict[str, str]) -> bool:
        return row["key"] == "key1" and float(row["pitch_um"]) == float(row["repeat"]) == 1.5

    with in_time():
        assert Store(tmp_path / "results.csv").resume(is_needed) == []
    rows(tmp_path / "results.csv")
    assert list(Store(tmp_path / "results.csv").resume(is_needed)) == ["key1"]


# --- Names and output files
# ----------------------------------------------------------------------------------------

NAMES = ["a'b\"c", "ünï", "n\nl $x$", "[b] %s{}", "-dash", "caf\udce9"]


@pytest.mark.parametrize("name", NAMES)
def test_command_any_file_name_works_or_is_rejected(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (folder := tmp_path / name).mkdir()
    seeds_folder = folder if name != "caf\udce9" else tmp_path
    seeds(seeds_folder)
    (config := folder / "c.toml").write_text(CONFIG)
    for arguments in (
        ("run", seeds_folder / "scene.xml", "--config", config, "--out", folder / "o", "--json"),
        ("chart flat -o", folder / "flat.exr"),
        ("template study -o", folder / "t.toml"),
    ):
        code, out, err = run_command(*arguments)
        assert code in (0, 2), err
        assert "Traceback" not in err + out
    assert {path.name for path in tmp_path.iterdir()} <= {
        name,
        *(path.name for path in seeds_folder.iterdir()),
    }
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize(
    ("line", "max_bytes"),
    [
        (f"run flat {SMALL} --out out", 2000),
        pytest.param("sfr edge.npy --out out", 3000, marks=pytest.mark.slow),
        pytest.param("chart csf -o out/a.exr", 9000, marks=pytest.mark.slow),
    ],
)
def test_command_full_disk_leaves_no_partial_file(tmp_path, line, max_bytes):
    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, max_bytes))

    x = np.arange(128) - 60 - np.arange(128)[:, None] * 0.1
    np.save(tmp_path / "edge.npy", 1 / (1 + np.exp(-x)))
    if "-o " in line:
        (tmp_path / "out").mkdir()
    environment = os.environ | {
        "PYTHONDONTWRITEBYTECODE": "1"
    }  # truncated bytecode would break later processes
    options = {
        "cwd": tmp_path,
        "preexec_fn": limit,
        "timeout": HANG_S,
        "capture_output": True,
        "text": True,
        "env": environment,
    }
    done = subprocess.run([sys.executable, "-c", FEW_FRAMES, *line.split()], **options, check=False)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert "Traceback" not in done.stderr
    files = [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "edge.npy"]
    assert all(path.stat().st_size < max_bytes for path in files), "a truncated file"
    assert not [
        path for path in files if path.suffix == ".part" or path.parent.name.startswith(".")
    ]


# --- Terminal
# ----------------------------------------------------------------------------------------------------------


def test_every_print_is_printable():
    """Nothing in the package prints but through `printable`, save the fixed words of an
    interruption, and JSON, which is ASCII.
    """
    calls = [
        (path.name, line.strip())
        for path in sorted(Path(pixsim.__file__).parent.rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.match(
            r"\s*(print\(|.*\.(stdout|stderr|stream)\.write\(|traceback\.print_|stream\.write\()",
            line,
        )
    ]
    assert len(calls) >= 5
    assert [
        call
        for call in calls
        if not re.search(r"printable\(|interruption\.words|json\.dumps\(", call[1])
    ] == []


# --- Reports
# -----------------------------------------------------------------------------------------------------------

MARKUP = "</h1><script>alert(1)</script>\"'&<img src=x onerror=alert(1)>"


@pytest.mark.parametrize("path", sorted(DATA.glob("*.html.j2")), ids=lambda path: path.name)
def test_templates_escape_markup(path):
    """No template marks a string as safe."""
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"\|\s*safe\b", text)
    assert "autoescape" not in text


@pytest.mark.parametrize(
    "name", [MARKUP, "$x", "$\\frac{$", "a\\b", "$$", "\\$x\\$", "x\x01y", "--->", "[b]"]
)
@figures.pixsim_style()
def test_literal_shows_name_unchanged(name):
    figure = figures.new_figure(12, 4)
    axes = figure.subplots()
    axes.plot([1, 2], label=figures.literal(name))
    axes.legend()
    svg = figures.svg_text(figure)
    ET.fromstring(svg)
    assert "<script" not in svg.replace("<!--", "").partition("<script")[0]


@pytest.mark.parametrize(
    "line",
    ["study study.toml --jobs 1", pytest.param("datasheet 't$<b>$.toml'", marks=pytest.mark.slow)],
)
def test_report_escapes_markup_of_files(line, tmp_path, monkeypatch):
    """Title, technology and sources of a study, and the name of a data sheet, are markup and
    mathematics.
    """
    monkeypatch.setattr(datasheet, "make_datasheet", partial(datasheet.make_datasheet, **FEW))
    monkeypatch.chdir(tmp_path)
    text = (DATA / "technologies/0.35um.toml").read_text()
    name = next(line for line in text.splitlines() if line.startswith("name"))
    (tmp_path / "t$<b>$.toml").write_text(text.replace(name, f"name = '''{MARKUP}$\\frac[bold]'''"))
    (tmp_path / "study.toml").write_text(
        f"name = 'x'\ntitle = '''{MARKUP} $\\frac{{$'''\nrepeats = 2\ntechnologies ="
        " ['t$<b>$.toml']\npitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0] }\ndisplay = { dots"
        " = 32, samples_per_deg = 10.0 }\nresolution = 32\ncamera = { die_mm = 0.7 }\nscene ="
        f" {{ file = 'csf' }}\n[sources]\n'camera.f_number' = '''{MARKUP}'''\n"
    )
    code, _, err = run_command(f"{line} --out out")
    assert code == 0, err
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "&lt;script&gt;" in page
    for raw in ("<script", "<img src=x", "t$<b>"):
        assert raw not in page
    for path in (tmp_path / "out/figures").glob("*.svg"):
        ET.fromstring(path.read_text(encoding="utf-8"))


# --- Random changes
# ---------------------------------------------------------------------------------------------------------

PICTURES = ["light.exr", "factors.exr", "light.npz", "chart.exr", "edge.npy", "raw.npz"]
KINDS = [
    "config.toml",
    "study.toml",
    "technology.toml",
    "lens.toml",
    "lens.zmx",
    "curve.csv",
    "scene.xml",
    "shipped.xml",
]
KINDS += ["cube.hdr", "edge.png", "results.csv", *PICTURES]


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> dict:
    files = seeds(tmp_path_factory.mktemp("seeds"))
    return {name: (path, path.read_bytes(), reader) for name, (path, reader) in files.items()}


TOKENS = [
    b"\0",
    b"\xff",
    b"[",
    b"{",
    b'"',
    b"-1",
    b"1e999",
    b"nan",
    b"9" * 40,
    b"\xff\xff\xff\x7f",
    b"<",
    b"$spp",
    b"null",
    b"",
]
CHANGES = st.lists(
    st.tuples(st.floats(0, 1), st.sampled_from(TOKENS) | st.binary(min_size=1, max_size=4)),
    max_size=6,
)


@contextmanager
def restored(path: Path, whole: bytes) -> Iterator[None]:
    """Restore a file that a test changes."""
    try:
        yield
    finally:
        path.write_bytes(whole)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("contents", "examples"), [("changed", 30), ("random", 10)])
def test_reader_changed_file_is_read_or_rejected(targets, kind, contents, examples):
    path, whole, reader = targets[kind]
    a_change = st.builds(
        partial(changed, whole),
        CHANGES,
        st.just(1.0) | st.floats(0, 1),
        st.sampled_from([0, 0, 0, 2]),
    )

    @settings(
        derandomize=True,
        max_examples=examples,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
    )
    @given(a_change if contents == "changed" else st.binary(max_size=300))
    def check(content: bytes) -> None:
        path.write_bytes(content)
        try:  # the ValueError of a curve becomes a PixsimError in its record
            reader(path)
        except PixsimError:
            pass
        except ValueError:
            assert kind == "curve.csv"

    with in_time(), restored(path, whole):
        check()
