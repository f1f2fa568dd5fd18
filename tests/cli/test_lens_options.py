"""Real lenses on the command line, in TOML and in Python: one setting however it is spelt, and one
error for what is wrong. tests/optics has all kinds of faults.
"""

import re
from pathlib import Path

import pytest
from helpers.commands import command

from pixsim import load_lens, load_scene
from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions

WILD = Path(__file__).parents[1] / "data" / "lenses" / "wild"
FIXED = str(WILD / "fixed.zmx")
PLAN = "plan csf --pixel.technology 4t-bsi --pixel.pitch-um 26 --camera.f-number"
SLOW = (
    f"{PLAN} 100 -D resolution"  # with one lens, of one tiling, which the cache has after the first
)
# Settings of [lens] and [camera], and what the error names; tests/optics has what else may be wrong
# with them, and with files.
WRONG: list[tuple[dict, dict, str]] = [
    (
        {"file": "phone"},
        {"focal_length_mm": 4.0},
        "camera.focal_length_mm: got a value together with lens.file = 'phone'",
    ),
    (
        {"file": "phone"},
        {"f_number": 1.0},
        "camera.f_number: got 1; allowed: at least 3.5, the widest of 'phone'",
    ),
    ({"file": "phone", "refocus": "best"}, {}, "refocus: got 'best'"),
    (
        {"file": "phone", "focus_nm": 850.0},
        {},
        "lens.focus_nm: wavelength_nm: got 850; allowed: 400 to 750, where the glass",
    ),
    ({"file": "singlet", "focal_length_mm": 2000.0}, {}, "whose image is"),
]
ZMX = """VERS 1
MODE SEQ
UNIT MM
ENPD 15
WAVM 1 0.55 1
SURF 0
  DISZ INFINITY
SURF 1
  CURV 0
  DISZ 2
  GLAS N-BK7 0 0
SURF 2
  CURV -0.1
  DISZ 1
SURF 3
  STOP
  DISZ 9
SURF 4
  DISZ 0
"""
BK7 = """NM BK7 2 517642 1.5168 64.2 0 1
CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
LD .3 2.5
"""
SINGLET = packaged("data/lenses")["singlet"].read_text(encoding="utf-8")
# Files, and what their error names: line and surface where it stands there.
FILES: dict[str, tuple[str, bytes, str]] = {
    "toml in UTF-16": (".toml", SINGLET.encode("utf-16"), "allowed: a readable TOML file in UTF-8"),
    "zmx in UTF-16": (
        ".zmx",
        ZMX.replace("BK7", "BK8").encode("utf-16"),
        "surface 1 (line 8), line 11: GLAS: got the unknown",
    ),
    "empty toml": (
        ".toml",
        b"",
        "lens.toml: aperture: missing; it is required, as in [aperture] with type",
    ),
    "no thickness": (
        *(".toml", re.sub(r"(?m)^thickness_mm = .*\n", "", SINGLET, count=1).encode()),
        "surface 1 (line 26): thickness_mm: missing; it is required",
    ),
    "total reflection": (
        ".zmx",
        ZMX.encode(),
        "a marginal ray that is totally reflected at surface 2",
    ),
}


@pytest.fixture
def folder(here: Path) -> Path:
    return here


def assert_named(named: str, line: str, *words: str) -> None:
    """A command is refused with a message that has this text."""
    code, out, err = command(line, *words)
    assert (code, out) == (2, ""), err
    assert named in " ".join(err.split())


@pytest.mark.parametrize(
    ("lens", "camera", "named"), WRONG, ids=[named[:30] for *_, named in WRONG]
)
def test_wrong_lenses_are_one_error_in_toml_on_the_command_line_and_in_python(
    folder: Path, lens: dict, camera: dict, named: str
) -> None:
    tables = {"lens": lens, "camera": camera}
    text = "".join(
        f"[{table}]\n" + "".join(f"{key} = {value!r}\n" for key, value in tables[table].items())
        for table in tables
    )
    (folder / "run.toml").write_text(text, encoding="utf-8")
    options = [
        word
        for table, values in tables.items()
        for key, value in values.items()
        for word in (f"--{table}.{key.replace('_', '-')}", str(value))
    ]
    for words in (["--config", "run.toml"], options):
        assert_named(named, "plan csf -D resolution=16", *words)
    with pytest.raises(PixsimError, match=re.escape(named)):
        load_scene("csf", resolution=16).camera(CameraOptions(**camera), LensOptions(**lens))


@pytest.mark.parametrize("case", FILES)
def test_what_is_wrong_with_a_file_is_named_by_every_route(folder: Path, case: str) -> None:
    suffix, content, named = FILES[case]
    path = folder / f"lens{suffix}"
    path.write_bytes(content)
    (folder / "run.toml").write_text(f"[lens]\nfile = '{path.name}'\n", encoding="utf-8")
    for line in (f"plan csf --lens {path.name}", "plan csf --config run.toml", f"lens {path.name}"):
        assert_named(named, line)
    with pytest.raises(PixsimError) as caught:
        load_lens(path)
    assert named in " ".join(str(caught.value).split())


def test_an_option_or_a_later_file_replaces_the_thin_lens_of_a_file(folder: Path) -> None:
    """In one file, or among the options, it stays a contradiction."""
    (folder / "thin.toml").write_text("[camera]\nfocal_length_mm = 4.0\n", encoding="utf-8")
    (folder / "lens.toml").write_text(f"[lens]\nfile = {FIXED!r}\n", encoding="utf-8")
    option = "--camera.focal-length-mm 4"
    replaced = "camera.f_number: got 1; allowed: at least"
    contradicts = "camera.focal_length_mm: got a value together with lens.file = '"
    for named, f_number, words in (
        (replaced, 1, f"--config thin.toml --lens {FIXED}"),
        (replaced, 1, "--config thin.toml --config lens.toml"),
        (contradicts, 8, f"--lens phone {option}"),
        (contradicts, 8, f"--config lens.toml {option}"),
    ):
        assert_named(named, f"{PLAN} {f_number} {words}")


def test_reading_options_reach_the_camera(folder: Path) -> None:
    """By the command line, a file, and Python; catalogues lie beside the file that names them."""
    (folder / "sub").mkdir()
    (folder / "sub" / "my.agf").write_text(BK7, encoding="utf-8")
    bk7 = str(WILD / "bk7.zmx")
    (folder / "sub" / "run.toml").write_text(
        f"[lens]\nfile = {bk7!r}\nglass_catalogues = ['my.agf']\n", encoding="utf-8"
    )
    for words in (
        ["--config", "sub/run.toml"],
        ["--lens", bk7, "--lens.glass-catalogues", "sub/my.agf"],
    ):
        # Past its unknown glass, and before it takes long.
        assert_named("camera.f_number: got 1; allowed: at least 4, the widest", f"{PLAN} 1", *words)
    scene, camera = load_scene("csf", resolution=16), CameraOptions()
    mine = scene.camera(camera, LensOptions(file=bk7, glass_catalogues=("sub/my.agf",)))
    model = scene.camera(camera, LensOptions(file=bk7, unknown_glass="model"))
    air = scene.camera(camera, LensOptions(file=str(WILD / "air.zmx")))
    assert mine.focal_length_mm == pytest.approx(air.focal_length_mm, rel=1e-12)
    assert mine.focal_length_mm != model.focal_length_mm
    assert mine.lens_options.glass_catalogues == ("sub/my.agf",)
    assert "configuration" not in air.lens.model_dump()
