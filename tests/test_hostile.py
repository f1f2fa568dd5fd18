"""Malicious or damaged input is rejected with a message, in limited time and memory, without
partial files.

Scenes are in test_hostile_scenes.py.
"""

import io
import os
import re
import resource
import signal
import struct
import subprocess
import sys
import time
import warnings
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.commands import command
from helpers.fuzz_targets import CONFIG, ENVI, changed, light, read_picture, rows, seeds
from helpers.hostile import in_time, irregular_files, png_bomb, rejected
from helpers.processes import HANG_S
from hypothesis import HealthCheck, given, settings, strategies as st

import pixsim
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import MAX_FILE_VARIABLE, digest_of
from pixsim.base.schema import KEY, SCHEMA
from pixsim.cli.options import SceneOptions
from pixsim.light.curves import AS_CURVES, as_quantum_efficiency
from pixsim.light.exr import read_channels
from pixsim.measure import datasheet
from pixsim.measure.sfr import read_edge_picture
from pixsim.optics.chief_rays import as_chief_ray_angles
from pixsim.optics.glass import read_catalogue
from pixsim.sensor.technology import load_technology
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
SMALL = "--resolution 32 --display.dots 32"


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
def test_command_irregular_file_does_not_block(here, suffix, line):
    for path in irregular_files(here, suffix):
        assert_command_rejects(line.format(path))
    assert not (here / "pixsim-out").exists()


def test_digest_of_irregular_file_raises(tmp_path):
    """Output folders and scenes name files whose content is hashed."""
    for path in irregular_files(tmp_path, ""):
        with rejected():
            digest_of(path)


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


# --- Damaged files
# ---------------------------------------------------------------------------------------------------


def npy(shape: tuple[int, ...], descr: str = "<f4", content: bytes = b"") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return file.getvalue() + content


def npz(path: Path, packing: int = zipfile.ZIP_DEFLATED, **members: bytes) -> None:
    with zipfile.ZipFile(path, "w", packing) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)


def write_lying_npz(path: Path) -> None:
    """Write 16 MiB of which the archive declares 2 GiB."""
    npz(path, data=npy((1 << 20,), "|u1", bytes(1 << 24)))
    size, declared = (struct.pack("<I", count) for count in ((1 << 24) + 128, 1 << 31))
    assert size in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(size, declared))


WINDOW = struct.pack("<4i", 0, 0, 4, 3)  # of the texels


def write_light(path: Path, header: dict | None = None, side: int | None = None) -> None:
    """Write an EXR of light with other entries of its header, or another size than it has."""
    image = light()
    image.header |= header or {}
    pixsim.write_exr(path, image)
    assert WINDOW in path.read_bytes()
    if side is not None:
        path.write_bytes(path.read_bytes().replace(WINDOW, struct.pack("<4i", 0, 0, side, side)))


def part(channels: dict[str, np.ndarray], name: str = "a", **header: object) -> OpenEXR.Part:
    return OpenEXR.Part({"type": OpenEXR.scanlineimage, **header}, dict(channels), name)


def write_parts(path: Path, parts: list[OpenEXR.Part]) -> None:
    with OpenEXR.File(parts) as file:
        file.write(str(path))


Y = {"Y": np.ones((8, 8), np.float32)}
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
TOML_READERS = (
    lambda path: SceneOptions([path]).settings(),
    load_study,
    lambda path: load_technology(str(path)),
)
ARRAYS = [npy((1 << 40,)), npy((1 << 20, 1 << 20, 3)), npy((-1, 4, 3)), npy((4, 5), "|O", b"x" * 160), npy((0, 5, 3)), npy((4, 5, 3)),
     b"", b"x" * 99, npy((), "<U100000000"), npy((4, 5, 3), "<U1", b"\0" * 240), npy((1,), "|V9", b"x" * 9),
     npy((4, 5, 3), "<c8", b"\0" * 480)]  # fmt: skip
HEADERS = [
    {"camera": 3}, {"camera": {"f_number": "x"}}, {"parameters": None, "scene": "csf.xml"}, {"scene": []},
    {"luminance_cd_per_m2": "x"}, {"luminance_cd_per_m2": -1}, {"lamp_w_per_m2_sr_nm": [1]}, {"lamp_w_per_m2_sr_nm": "x"},
    {"white_lamps": 3}, {"white_lamps": [3]},
]  # fmt: skip
LIGHT = {
    "wavelength_nm": npy((3,), "<f8", np.array([450.0, 550, 650]).tobytes()),
    "units": npy((), "<U1", b"W\0\0\0"),
}


# Name of a file, its content or what writes it, its readers, words of the message.
HOSTILE: list[tuple[str, bytes | Callable[[Path], None], tuple[Callable, ...], str | None]] = [
    *(("a.toml", content, TOML_READERS, r"a\.toml") for content in TOMLS.values()),
    *(("a.npz", partial(npz, data=data, **LIGHT), (read_picture,), r"a\.npz") for data in ARRAYS),
    *(("a.npy", data, (lambda path: pixsim.edge_response(read_edge_picture(path).data),), None) for data in ARRAYS),
    ("a.npz", write_lying_npz, (read_edge_picture,), r"a\.npz"),
    ("a.npz", partial(npz, **{f"{n}": b"" for n in range(5000)}), (read_edge_picture,), "5000 members"),
    # A header of LZMA declares the memory that its decoder takes.
    *(("a.npz", partial(npz, packing=packing, dn=npy((2, 3), "<u2", bytes(12))), (pixsim.read_frame,), "stored or deflated")
      for packing in (zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)),
    *(("a.exr", partial(write_light, side=side), (read_picture, read_channels, read_edge_picture), r"a\.exr") for side in ((1 << 31) - 1, 65535, 99_999, -5)),
    *(("a.exr", partial(write_light, header=header), (read_picture,), r"a\.exr") for header in HEADERS),
    ("a.exr", partial(write_parts, parts=[part(Y, name) for name in "ab"]), (read_channels,), "several parts"),
    ("a.exr", partial(write_parts, parts=[part({f"c{n}": Y["Y"] for n in range(5000)})]), (read_channels,), "5000 channels"),
    *(("a.exr", partial(write_parts, parts=[part(Y, bits=bits)]), (read_edge_picture,), "bits") for bits in ("x", 1e9, -1, float("nan"))),
    *(("a.png", content, (read_edge_picture,), r"a\.png") for content in (png_bomb(), png_bomb(16_000), png_bomb(100)[:60])),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "readers", "words"), HOSTILE)
def test_hostile_file_is_rejected(tmp_path, name, content, readers, words):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)
    for read in readers:
        with rejected(words):
            read(path)


def test_read_exr_in_tiles_but_not_deep(tmp_path):
    path = tmp_path / "a.exr"
    write_parts(path, [part(Y, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())])
    np.testing.assert_array_equal(read_channels(path)[0]["Y"], Y["Y"])
    content = bytearray(path.read_bytes())
    content[5] |= 0x08  # the bit of a deep image
    path.write_bytes(content)
    with rejected("a deep image"):
        read_channels(path)


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
        with rejected(f"{MAX_FILE_VARIABLE}.*a size in GiB"):
            reader(path)


def write_sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.write(npy((1 << 20, 1 << 18)))
        file.truncate((1 << 40) + 128)


ZEROS = partial(
    npz,
    data=npy((1 << 11, 1 << 10, 2), content=bytes(1 << 24)),
    wavelength_nm=npy((2,), content=bytes(8)),
)


@pytest.mark.parametrize(
    ("limit_gib", "name", "write", "read"),
    [
        ("0.01", "a.npz", ZEROS, read_picture),
        ("0.01", "a.npy", write_sparse, read_edge_picture),
        ("4", "a.npy", write_sparse, read_edge_picture),
    ],
)
def test_declared_content_takes_no_memory(tmp_path, monkeypatch, limit_gib, name, write, read):
    """Not the size of the file counts: 17 MB of zeros are 17 kB in a zip, and nothing in a sparse
    file.
    """
    monkeypatch.setenv(MAX_FILE_VARIABLE, limit_gib)
    write(tmp_path / name)
    with rejected(f"{name}.*{MAX_FILE_VARIABLE}"):
        read(tmp_path / name)


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
    with rejected(r"a\."):
        read_picture(tmp_path / "a.hdr")


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


@pytest.mark.parametrize(
    "name",
    # The others are one kind of letters each.
    ["a'b\"c", "n\nl $x$", "caf\udce9"]
    + [pytest.param(name, marks=pytest.mark.slow) for name in ("ünï", "[b] %s{}", "-dash")],
)
def test_command_any_file_name_works_or_is_rejected(here, name):
    (folder := here / name).mkdir()
    seeds_folder = folder if name != "caf\udce9" else here
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
    assert {path.name for path in here.iterdir()} <= {
        name,
        *(path.name for path in seeds_folder.iterdir()),
    }
    assert not list(here.rglob("*.part"))


@pytest.mark.parametrize(
    ("line", "max_bytes"),
    [
        pytest.param(f"run flat {SMALL} --out out", 2000, marks=pytest.mark.slow),
        ("sfr edge.npy --out out", 3000),
        pytest.param("chart csf -o out/a.exr", 9000, marks=pytest.mark.slow),
    ],
)
def test_command_full_disk_leaves_no_partial_file(tmp_path, line, max_bytes):
    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, max_bytes))

    x = np.arange(128) - 60 - np.arange(128)[:, None] * 0.1
    np.save(tmp_path / "edge.npy", 1 / (1 + np.exp(-x)))
    (tmp_path / "out").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", FEW_FRAMES, *line.split()],
        cwd=tmp_path,
        preexec_fn=limit,
        timeout=HANG_S,
        capture_output=True,
        text=True,
        # Truncated bytecode would break later processes.
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
    )
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
    "line",
    ["study study.toml --jobs 1", pytest.param("datasheet 't$<b>$.toml'", marks=pytest.mark.slow)],
)
def test_report_escapes_markup_of_files(line, here, monkeypatch):
    """Title, technology and sources of a study, and the name of a data sheet, are markup and
    mathematics.
    """
    monkeypatch.setattr(datasheet, "make_datasheet", partial(datasheet.make_datasheet, **FEW))
    text = (DATA / "technologies/0.35um.toml").read_text()
    name = next(line for line in text.splitlines() if line.startswith("name"))
    (here / "t$<b>$.toml").write_text(text.replace(name, f"name = '''{MARKUP}$\\frac[bold]'''"))
    (here / "study.toml").write_text(
        f"name = 'x'\ntitle = '''{MARKUP} $\\frac{{$'''\nrepeats = 2\ntechnologies ="
        " ['t$<b>$.toml']\npitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0] }\ndisplay = { dots"
        " = 32, samples_per_deg = 10.0 }\nresolution = 32\ncamera = { die_mm = 0.7 }\nscene ="
        f" {{ file = 'csf' }}\n[sources]\n'camera.f_number' = '''{MARKUP}'''\n"
    )
    code, _, err = run_command(f"{line} --out out")
    assert code == 0, err
    page = (here / "out/report.html").read_text(encoding="utf-8")
    assert "&lt;script&gt;" in page
    for raw in ("<script", "<img src=x", "t$<b>"):
        assert raw not in page
    for path in (here / "out/figures").glob("*.svg"):
        ET.fromstring(path.read_text(encoding="utf-8"))


# --- Random changes
# ---------------------------------------------------------------------------------------------------------

KINDS = [
    "config.toml", "study.toml", "technology.toml", "lens.toml", "lens.zmx", "curve.csv", "scene.xml", "shipped.xml",
    "cube.hdr", "light.exr", "factors.exr", "light.npz", "chart.exr", "edge.npy", "edge.png", "results.csv", "raw.npz",
]  # fmt: skip


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> dict:
    files = seeds(tmp_path_factory.mktemp("seeds"))
    return {name: (path, path.read_bytes(), reader) for name, (path, reader) in files.items()}


TOKENS = [
    b"\0", b"\xff", b"[", b"{", b'"', b"-1", b"1e999", b"nan", b"9" * 40, b"\xff\xff\xff\x7f", b"<", b"$spp", b"null", b"",
]  # fmt: skip
CHANGES = st.lists(
    st.tuples(st.floats(0, 1), st.sampled_from(TOKENS) | st.binary(min_size=1, max_size=4)),
    max_size=6,
)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("contents", "examples"),
    # Changed files get further into a reader than random bytes do.
    [("changed", 30), pytest.param("random", 10, marks=pytest.mark.slow)],
)
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

    try:
        with in_time():
            check()
    finally:
        path.write_bytes(whole)


# --- Long files
# ---------------------------------------------------------------------------------------------------

# Each takes up to 2 s on the machine of development; those that are quadratic took minutes, since
# an expression or a search looked at the rest of the line from every place in it.
MOST_CPU_S = 10.0
LONGEST_MESSAGE = 1500
SCENE = '<scene version="3.0.0">{}</scene>'
LONG_ENVI = """ENVI
samples = 2
lines = 2
bands = 2
file type = ENVI Standard
data type = 4
interleave = bsq
wavelength = {{400, 500}}
wavelength units = {units}
data units = {data}
{more}
"""
ZMX = """MNUM 999999
{head}
SURF 0
SURF 1
  STOP
SURF 2
"""
STUDY = 'name = "x"\n{}\n'
SETTINGS = '"camera.f_number",' * 40_000
READERS: dict[str, tuple[Callable, str]] = {
    "curve": (as_quantum_efficiency, ".csv"),
    "curves": (AS_CURVES["quantum_efficiencies"], ".csv"),
    "chief rays": (as_chief_ray_angles, ".csv"),
    "scene": (pixsim.load_scene, ".xml"),
    "ENVI": (pixsim.read_irradiance, ".hdr"),
    "EXR": (pixsim.read_irradiance, ".exr"),
    "zmx": (lambda path: pixsim.load_lens(path, configuration=2), ".zmx"),
    "catalogue": (lambda path: read_catalogue(Path(path)), ".agf"),
    "study": (load_study, ".toml"),
}
MIB = 1 << 20


@pytest.mark.parametrize(
    ("kind", "text", "more"),
    [
        ("curve", "(" * (MIB - 1), 0),
        ("curve", "( " * (MIB // 2 - 10) + "\n400 1\n500 2\n", 0),
        ("curves", "[" * (MIB - 1), 0),
        ("chief rays", "1\n" * (MIB // 8), 0),
        ("scene", SCENE.format(f'<shape type="${"a" * (MIB - 100)}"/>'), 0),
        ("scene", SCENE.format(f'<shape type="sphere"><float name="radius" value="{"1" * (MIB - 100)}x"/></shape>'), 0),
        ("scene", SCENE.format("<shape " + " ".join(f'a{i}="1"' for i in range(100_000)) + "/>"), 0),
        ("scene", "<a>" * MIB, 0),
        ("scene", f"<{'a' * MIB}/>", 0),
        ("scene", '<a "' + '<" "' * MIB, 0),
        ("ENVI", LONG_ENVI.format(units="([" * (MIB // 2 - 1000), data="W/m^2/nm", more="byte order = 0"), 0),
        ("ENVI", LONG_ENVI.format(units="nm", data="W/" * (MIB // 2 - 1000), more="byte order = 0"), 0),
        ("ENVI", LONG_ENVI.format(units="nm", data="W/m^2/nm", more=(" " * 50 + "\n") * 19_000), 0),
        ("zmx", ZMX.format(head="\n".join(f"YFIE {i} 2 0.5" for i in range(1, 200)) + "\nXXXX 1" * 500_000), 0),
        ("catalogue", f"NM {'a' * (15 * MIB)} 2 0 0 60\n", 0),
        ("study", STUDY.format(f"[[axis]]\nname = 'a'\nset = [{SETTINGS}]\nvalues = [1, 2]"), 0),
        *(
            pytest.param("study", text, 0, marks=pytest.mark.slow)  # more kinds of long TOML, of seconds each
            for text in (
                STUDY.format("\n".join(f"[[condition]]\nname = 'c{i}'\nset.camera.f_number = 2" for i in range(17_000))),
                STUDY.format(f"pitch.values_um = [{'5.0,' * 200_000}]"),
            )
        ),
        ("study", STUDY.format(f"camera.pixels = '{'1x' * 400_000}'"), 0),
        ("study", STUDY.format(f"a = {'[' * 100_000}"), 0),
        # Lines of 20 MB.
        *((kind, "", 20 * MIB) for kind in ("curve", "scene", "zmx", "catalogue", "study")),
        ("EXR", "v/1\x01\x02\0\0\0", 20 * MIB),
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) < 20 else "",
)  # fmt: skip
def test_long_file_is_refused_soon_and_not_quoted(kind, text, more, tmp_path):
    """Of one endless line, or of many tiny ones: time is bounded by size."""
    read, suffix = READERS[kind]
    path = tmp_path / f"x{suffix}"
    path.write_text(text + "a" * more, encoding="latin-1")
    (tmp_path / "x.img").write_bytes(bytes(32))  # of an ENVI header
    start = time.process_time()
    with pytest.raises(ValueError, match=r"allowed:|line \d+") as refused:
        read(str(path))
    assert time.process_time() - start < MOST_CPU_S
    assert len(str(refused.value)) < LONGEST_MESSAGE
