"""Real lenses on the command line, in TOML and in Python: one setting however it is spelt, and one error for what is wrong."""

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import command

from pixsim import load_lens, load_scene
from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged
from pixsim.cli.commands import with_whole_options
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.plan import make_render_plan
from pixsim.sensor.pixel_options import Pixel

# Settings of [lens] and [camera], and what the error names.
WRONG: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"file": "nolens"}, {}, "unknown lens 'nolens'; allowed: cooke_triplet, double_gauss, phone, singlet"),
    ({"file": "missing.zmx"}, {}, "missing.zmx"),
    ({"file": "binary.zmx"}, {}, "a binary file; allowed: a Zemax prescription"),
    ({"file": "mirror.zmx"}, {}, "MIRROR"),
    ({"file": "phone"}, {"focal_length_mm": 4.0}, "camera.focal_length_mm: got a value beside lens.file = 'phone'"),
    ({"file": "phone"}, {"f_number": 1.0}, "camera.f_number: got 1; allowed: at least 3.5, the widest of 'phone'"),
    ({"file": "phone", "refocus": "best"}, {}, "refocus"),
    ({"file": "phone", "ideal": "straight"}, {}, "ideal"),
    ({"file": "phone", "focal_length_mm": -3.0}, {}, "focal_length_mm"),
    ({"refocus": "field"}, {}, "refocus without file"),
    ({"file": "phone", "focus_nm": 850.0}, {}, "lens.focus_nm: wavelength_nm: got 850; allowed: 400 to 750, where the glass"),
    ({"file": "singlet", "focal_length_mm": 2000.0}, {}, "whose image is"),
]
MIRROR = """VERS 1
MODE SEQ
UNIT MM
ENPD 1
WAVM 1 0.55 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.01
  DISZ -10
  GLAS MIRROR 0 0
SURF 2
  DISZ 0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary.zmx").write_bytes(bytes(range(256)) * 8)
    (tmp_path / "mirror.zmx").write_text(MIRROR, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(("lens", "camera", "named"), WRONG, ids=[named[:30] for *_, named in WRONG])
def test_wrong_lenses_are_one_error_in_toml_on_the_command_line_and_in_python(
    folder: Path, lens: dict[str, Any], camera: dict[str, Any], named: str
) -> None:
    tables = [("lens", lens), ("camera", camera)]
    text = "\n".join(f"[{table}]\n" + "".join(f"{key} = {value!r}\n" for key, value in values.items()) for table, values in tables)
    (folder / "run.toml").write_text(text, encoding="utf-8")
    options = [
        word for table, values in tables for key, value in values.items() for word in (f"--{table}.{key.replace('_', '-')}", value)
    ]
    for words in (["--config", "run.toml"], options):
        code, out, err = command("plan csf -D resolution=16", *words)
        assert (code, out) == (2, ""), err
        assert named in re.sub(r"\s+", " ", err)
    with pytest.raises(PixsimError, match=re.escape(named)):
        load_scene("csf", resolution=16).camera(CameraOptions(**camera), LensOptions(**lens))


def test_a_slow_lens_has_one_blur_by_every_route_however_fine_the_film_is(folder: Path) -> None:
    """Its PSFs were once found on film cells, of which a film of 8192 has more than a window holds."""
    lens, camera, pixel = LensOptions(file="phone"), CameraOptions(f_number=100.0), Pixel(pitch_um=26.0, technology="4t-bsi")
    (folder / "run.toml").write_text("[lens]\nfile = 'phone'\n[camera]\nf_number = 100\n", encoding="utf-8")
    said = set()
    for words in (["--config", "run.toml"], ["--lens", "phone", "--camera.f-number", "100"]):
        code, out, err = command("plan csf -D resolution=8192 --pixel.pitch-um 26 --pixel.technology 4t-bsi", *words)
        assert code == 0, err
        said.add(re.sub(r"\s+", " ", out.partition("real lens")[2].partition("oversampling")[0]))
    assert len(said) == 1
    tilings = []
    for resolution in (512, 8192):  # two samples or more across a photodiode
        scene = load_scene("csf", resolution=resolution)
        tilings.append(make_render_plan(scene, scene.camera(camera, lens), pixel).tiling)
    assert tilings[0] == tilings[1]
    assert f"PSFs of {tilings[0].psf_um:.3g} µm" in said.pop()


TOML = packaged("data/lenses")["singlet"].read_text(encoding="utf-8")
GLASS, SURFACE = "GLAS MIRROR 0 0", "SURF 1\n  STOP\n"


def zmx(*changes: tuple[str, str]) -> str:
    """A lens of one surface of glass, with changes."""
    text = MIRROR.replace(GLASS, "GLAS N-BK7 0 0").replace("-10", "10")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def toml(old: str, new: str) -> str:
    """The singlet, with the first match of a pattern replaced."""
    text, count = re.subn(old, new, TOML, count=1)
    assert count
    return text


REFLECTING = zmx(
    (f"{SURFACE}  CURV 0.01\n  DISZ 10", "SURF 1\n  CURV 0\n  DISZ 2"),
    ("SURF 2\n  DISZ 0", "SURF 2\n  CURV -0.1\n  DISZ 1\nSURF 3\n  STOP\n  DISZ 9\nSURF 4\n  DISZ 0"),
    ("ENPD 1", "ENPD 15"),
)
# Files, and what their error names: line and surface where it stands there.
FILES: dict[str, tuple[str, str | bytes, str]] = {
    "zmx too large": (".zmx", "", f"of {100 << 20} bytes"),
    "toml too large": (".toml", "", f"of {100 << 20} bytes"),
    "zmx binary": (".zmx", bytes(range(256)) * 8, "a binary file; allowed: a Zemax prescription, which is text"),
    "toml binary": (".toml", bytes(range(256)) * 8, "allowed: a readable TOML file in UTF-8"),
    "toml in UTF-16": (".toml", TOML.encode("utf-16"), "allowed: a readable TOML file in UTF-8"),
    "zmx in UTF-16": (".zmx", zmx(("N-BK7", "N-BK7_MOLD")).encode("utf-16"), "surface 1 (line 8), line 12: GLAS: got the unknown"),
    "empty zmx": (".zmx", b"", "without a line SURF"),
    "empty toml": (".toml", b"", "lens.toml: aperture: missing; it is required, as in [aperture] with type"),
    "unit": (".zmx", zmx(("UNIT MM", "UNIT FURLONG")), "line 3: got UNIT with a text of 7 characters; allowed: MM, CM, IN"),
    "mirror": (".zmx", zmx(("N-BK7", "MIRROR")), "surface 1 (line 8), line 12: GLAS: got 'MIRROR', a mirror"),
    "mirror in toml": (".toml", toml(r'(?m)^glass = "[^"]+"', 'glass = "MIRROR"'), "surface 1 (line "),
    "gradient": (".zmx", zmx((SURFACE, f"{SURFACE}  TYPE GRINSUR3\n")), "surface 1 (line 8): got the surface type GRINSUR3, a gr"),
    "unsupported": (".zmx", zmx((SURFACE, f"{SURFACE}  TYPE TOROIDAL\n")), "surface 1 (line 8): got the surface type TOROIDAL"),
    "decentred": (".zmx", zmx((SURFACE, f"{SURFACE}  TYPE COORDBRK\n")), "COORDBRK, a tilted or decentred axis"),
    "moulded glass": (".zmx", zmx(("N-BK7", "L-BAL35_MOLD")), "the unknown glass 'L-BAL35_MOLD'"),
    "unknown glass of toml": (".toml", toml(r'(?m)^glass = "[^"]+"', 'glass = "N-BK8"'), "glass: got the unknown glass 'N-BK8'"),
    "no stop": (".zmx", zmx(("  STOP\n", "")), "got no surface; allowed: one of the surfaces 1 to 1"),
    "no thickness": (".toml", toml(r"(?m)^thickness_mm = .*\n", ""), "surface 1 (line 26): thickness_mm: missing; it is required"),
    "no aperture": (".toml", toml(r"(?ms)^\[aperture\]\n.*?(?=^\[)", ""), "aperture: missing; it is required, as in [aper"),
    "rays miss": (".zmx", zmx(("CURV 0.01", "CURV 0.2"), ("ENPD 1", "ENPD 12")), "a marginal ray that misses surface 1"),
    "total reflection": (".zmx", REFLECTING, "a marginal ray that is totally reflected at surface 2"),
}  # fmt: skip


@pytest.mark.parametrize("case", FILES)
def test_what_is_wrong_with_a_file_is_named_by_every_route(folder: Path, case: str) -> None:
    suffix, content, named = FILES[case]
    path = folder / f"lens{suffix}"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    if case.endswith("too large"):
        os.truncate(path, 100 << 20)  # without blocks on the disk
    (folder / "run.toml").write_text(f"[lens]\nfile = '{path.name}'\n", encoding="utf-8")
    for words in (["plan", "csf", "--lens", path.name], ["plan", "csf", "--config", "run.toml"], ["lens", path.name]):
        code, out, err = command(" ".join(words))
        assert (code, out) == (2, ""), err
        assert named in re.sub(r"\s+", " ", err)
    with pytest.raises(PixsimError) as caught:
        load_lens(path)
    assert named in re.sub(r"\s+", " ", str(caught.value))


@pytest.mark.parametrize(("unit", "size_mm"), [("MM", 1.0), ("CM", 10.0), ("IN", 25.4)])
def test_units_are_obeyed_by_every_route(folder: Path, unit: str, size_mm: float) -> None:
    """A plano-convex lens of index 1.5 and radius 10 units has f = R/(n - 1)."""
    text = zmx(
        ("UNIT MM", f"UNIT {unit}"),
        ("CURV 0.01", "CURV 0.1"),
        ("N-BK7 0 0", "___BLANK 1 0 1.5 0"),
        ("SURF 2\n", "SURF 2\n  DISZ 18\nSURF 3\n"),
        ("DISZ 10", "DISZ 3"),
    )
    (folder / "lens.zmx").write_text(text, encoding="utf-8")
    lens = load_lens(folder / "lens.zmx")
    focal_mm = lens.first_order(550.0).focal_length_mm
    assert focal_mm == pytest.approx(20 * size_mm, rel=1e-12)
    camera = load_scene("csf").camera(CameraOptions(), LensOptions(file="lens.zmx", focal_length_mm=focal_mm))
    assert camera.lens is not None
    assert camera.lens.focal_length_mm == focal_mm


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("lens phone --field-deg 85", "field_deg: got 37.1875, where the chief ray misses surface 9"),
        ("lens phone --wavelength-nm 900", "wavelength_nm: got 900; allowed: 400 to 750, where the glass"),
        ("lens cooke_triplet --f-number 2", "allowed: at least 4.99"),
    ],
)
def test_rays_that_a_lens_has_not_are_refused_on_the_command_line(folder: Path, words: str, named: str) -> None:
    code, out, err = command(words)
    assert (code, out) == (2, "")
    assert named in re.sub(r"\s+", " ", err)
    assert not list(folder.glob("pixsim-out/*"))


def test_a_lens_may_be_named_shortly_beside_its_other_options() -> None:
    wanted = ["plan", "csf", "--lens.file", "phone", "--lens.focal-length-mm", "3"]
    assert with_whole_options(["plan", "csf", "--lens", "phone", "--lens.focal-length-mm", "3"]) == wanted
    assert with_whole_options(["--lens=phone", "lens", "phone"]) == ["--lens.file=phone", "lens", "phone"]
    code, _, err = command("plan csf --lens phone --lens.refocus field --camera.f-number 1")
    assert code == 2
    assert "the widest of 'phone'" in err


WILD = Path(__file__).parents[1] / "data" / "lenses" / "wild"
FIXED_NOTE = "lens 'fixed': fixed semi-diameters of 2 surfaces stop no rays, since they are no apertures"


def test_an_option_or_a_later_file_replaces_the_thin_lens_of_a_file(folder: Path) -> None:
    """With a note; in one file, or among the options, it stays a contradiction."""
    (folder / "sheet.toml").write_text(
        "[camera]\nfocal_length_mm = 4.0\n[pixel]\ntechnology = '4t-bsi'\npitch_um = 4\n", encoding="utf-8"
    )
    (folder / "lens.toml").write_text("[lens]\nfile = 'phone'\n", encoding="utf-8")
    plan = "plan csf -D resolution=16 --config sheet.toml"
    plain = command("plan csf -D resolution=16 --pixel.technology 4t-bsi --pixel.pitch-um 4 --lens phone")
    for words in (["--lens", "phone"], ["--config", "lens.toml"]):
        code, out, err = command(plan, *words)
        assert (code, out) == plain[:2], err
        assert "camera.focal_length_mm of sheet.toml is not used: the real lens, lens.file, has its own" in err
    contradiction = "camera.focal_length_mm: got a value beside lens.file = 'phone'"
    (folder / "both.toml").write_text("[camera]\nfocal_length_mm = 4.0\n[lens]\nfile = 'phone'\n", encoding="utf-8")
    for words in (
        ["--config", "both.toml"],
        ["--lens", "phone", "--camera.focal-length-mm", "4"],
        ["--config", "lens.toml", "--camera.focal-length-mm", "4"],
    ):
        code, out, err = command("plan csf -D resolution=16", *words)
        assert (code, out) == (2, "")
        assert contradiction in re.sub(r"\s+", " ", err)


def test_reading_options_reach_the_camera(folder: Path) -> None:
    """By the command line, a file, and Python; catalogues lie beside the file that names them."""
    (folder / "sub").mkdir()
    lines = (
        "NM BK7 2 517642 1.5168 64.2 0 1",
        "CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653",
        "LD .3 2.5",
    )
    (folder / "sub" / "my.agf").write_text("\n".join(lines), encoding="utf-8")
    bk7 = str(WILD / "bk7.zmx")
    (folder / "sub" / "run.toml").write_text(f"[lens]\nfile = {bk7!r}\nglass_catalogues = ['my.agf']\n", encoding="utf-8")
    by_file = command("plan csf -D resolution=16 --pixel.pitch-um 40 --config sub/run.toml")
    by_option = command("plan csf -D resolution=16 --pixel.pitch-um 40", "--lens", bk7, "--lens.glass-catalogues", "sub/my.agf")
    assert by_file[0] == by_option[0] == 0, by_file[2] + by_option[2]
    scene, camera = load_scene("csf", resolution=16), CameraOptions()
    mine = scene.camera(camera, LensOptions(file=bk7, glass_catalogues=("sub/my.agf",)))
    model = scene.camera(camera, LensOptions(file=bk7, unknown_glass="model"))
    air = scene.camera(camera, LensOptions(file=str(WILD / "air.zmx")))
    assert mine.focal_length_mm == pytest.approx(air.focal_length_mm, rel=1e-12)
    assert mine.focal_length_mm != model.focal_length_mm
    assert mine.lens_options.glass_catalogues == ("sub/my.agf",)
    assert "configuration" not in air.lens.model_dump()


def test_notes_of_a_file_are_told_by_every_command(folder: Path) -> None:
    fixed = str(WILD / "fixed.zmx")
    assert FIXED_NOTE in command("plan csf -D resolution=16 --pixel.pitch-um 40", "--lens", fixed)[2]  # large pixels need few PSFs
    code, out, err = command("lens", fixed, "--json", "--out", "out")
    assert code == 0
    assert FIXED_NOTE in err
    assert [note.startswith(FIXED_NOTE) for note in json.loads(out)["notes"]] == [True]
    assert "and 0 from 20° on if they did" in (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_fields_without_light_have_a_dash(folder: Path) -> None:
    """No MTF, no spot, and no warning of another library."""
    code, out, err = command("lens", str(WILD / "fixed.zmx"), "--semi-diameters", "clip", "--out", "out")
    assert code == 0
    assert "warning" not in err
    last = [line.split() for line in out.splitlines() if line.split()[:1] == ["20"]]
    assert [row[4:] for row in last] == [["0.000", "–", "–", "–", "–", "–"]]
    dark = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))["fields"][-1]
    assert (dark["rms_spot_um"], dark["rms_wavefront_waves"], dark["mtf"][0]["tangential"]) == (None, None, None)
    assert "NaN" not in (folder / "out" / "summary.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("--configuration 4", "lens.configuration: got 4; allowed: 1 to 3"),
        ("--configuration two", "configuration: got 'two'"),
        ("--semi-diameters yes", "semi_diameters: got 'yes'; allowed: 'ignore' or 'clip'"),
        ("--glass-catalogues none.agf", "none.agf"),
    ],
)
def test_wrong_reading_options_are_named(folder: Path, words: str, named: str) -> None:
    code, out, err = command("lens", str(WILD / "zoom.zmx"), *words.split())
    assert (code, out) == (2, "")
    assert named in re.sub(r"\s+", " ", err)
