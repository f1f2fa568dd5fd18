"""What lenses and their light refuse, by its cause: files, and values that do not fit each other."""

from __future__ import annotations

import math
import os
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest
from helpers.foreign_light import (
    NM,
    UNIT,
    light,
    stokes,
    write_envi,
    write_exr,
    write_light,
    write_npz,
)

import pixsim
from pixsim import optics
from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged
from pixsim.light.foreign import parse_light_unit
from pixsim.light.spectral import SpectralImage, bands_last_hint
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.diffraction import diffract
from pixsim.optics.exchange import read_irradiance
from pixsim.optics.glass import Glass, catalogue, constant_glass, find_glass, read_catalogue
from pixsim.optics.lens import Lens, lens_from_prescription
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.prescription import Prescription, Surface
from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack
from pixsim.optics.thin_lens import thin_lens_pupil

DATA = Path(__file__).parents[1] / "data" / "lenses"
WILD = DATA / "wild"
TOML = packaged("data/lenses")["cooke_triplet"].read_text()
ZMX = (DATA / "US00583336-2-scaled.zmx").read_text().replace("\r\n", "\n")
AIR = (WILD / "air.zmx").read_text()
EXTENDED = (WILD / "xas.zmx").read_text()
OPERANDS = "MNUM 2 1\nTHIC 1 1 5\nTHIC 1 2 6\nYFIE 3 1 10\nYFIE 3 2 12\n"
TWO = AIR + OPERANDS


def edited(text: str, change: str) -> str:
    old, _, new = change.partition("|")
    assert old in text, old
    return text.replace(old, new, 1)


# Prescriptions: text, change, words

F2 = 'glass = "SCHOTT:F2"|glass = '
WRONG_TOML = [
    (f'{F2}"SCHOTT:F2_MOLD"', r"surface 3 \(line 44\): glass: .*'SCHOTT:F2_MOLD'"),
    (f'{F2}"mirror"', "'MIRROR', a mirror"),
    (f"{F2}0.5", "glass: got 0.5"),
    (f"{F2}{{ n_d = 1.6 }}", "exactly one of"),
    (f"{F2}{{ n = 1.6, n_d = 1.6, v_d = 60 }}", "exactly one of"),
    (f"{F2}{{ formula = 1, coefficients = [0.0] }}", "coefficients of glass"),
    (f"{F2}{{ formula = 1, coefficients = [0.0, 1e-320, 0.01] }}", "coefficients"),
    (f"{F2}{{ formula = 1, coefficients = [0.0, 1e300, 0.01] }}", "surface 3"),
    (f"{F2}{{ formula = 4, coefficients = [0.0, 0, 1.0] }}", "coefficients of glass"),
    (f"{F2}{{ formula = 1, coefficients = [0, 1, 1], range_um = [2, 1] }}", "range_um of glass"),
    ("stop_surface = 4|stop_surface = 9", "stop of .*: got surfaces 4, 9"),
    ("object_distance_mm = inf|object_distance_mm = -500", "object of .*: got -500 mm"),
    ("conic = 0.0|conic = nan", r"surface 1 \(line 26\): conic"),
    ("conic = 0.0|conics = 0.0", r"surface 1 \(line 26\): .*unknown name; .*'conic'"),
    ("conic = 0.0|asphere = { A1 = 0.1 }", "A1 = 0.1; .*cone"),
    ("conic = 0.0|asphere = { A4 = 1e-300 }", "asphere: got A4 = 1e-300"),
    ("conic = 0.0|asphere = { B4 = 0.1 }", "asphere: got a term"),
    ("thickness_mm = 3.25896|thickness_mm = -3.259", "thickness_mm: got -3.259 in the glass"),
    ("radius_mm = 22.01359|radius_mm = 23.0", "radius_mm: got 23, with curvature_per_mm"),
    ("radius_mm = 22.01359|radius_mm = 1e-9", "radius_mm: got 1e-09"),
    ("value_mm = 10.0|", "aperture.value_mm: got none"),
    ('units = "mm"|units = "in"', "units: got"),
    ("max_deg = 20.0|max_deg = 195.0", "fields.max_deg: got 195"),
]
GLAS = "GLAS N-BAK1 0 0 1.572500121386"
CURV = "CURV 7.061398863114783100E-002"
WRONG_ZMX = [
    ("  STOP\n|", "stop of .*: got no surface"),
    ("GLAS N-BAK1 0|GLAS MIRROR 0", r"surface 2 \(line 75\), line 82: GLAS: .* a mirror"),
    ("GLAS N-BAK1 0|GLAS N-BAK1_MOLD 0", "unknown glass 'N-BAK1_MOLD'"),
    ("GLAS N-BAK1 0|GLAS J-LAK14 0", r"catalogues that the file names \(SCHOTT\)"),
    (f"{GLAS}|GLAS ___BLANK 1 0 x", "GLAS: got .* a finite number"),
    (f"{GLAS}|GLAS ___BLANK 1 0 0.9", "n_d = 0.9"),
    ("TYPE STANDARD\n  CURV 7.0|TYPE GRINSUR1\n  CURV 7.0", "GRINSUR1, a gradient index"),
    ("TYPE STANDARD\n  CURV 7.0|TYPE COORDBRK\n  CURV 7.0", "curvature, with a glass"),
    ("TYPE STANDARD\n  CURV 7.0|TYPE XPOLYNOM\n  CURV 7.0", "surface type XPOLYNOM"),
    ("SURF 0\n  TYPE STANDARD|SURF 0\n  TYPE EVENASPH", "an object of the type EVENASPH"),
    ("SURF 0\n|SURF 0\n  CURV 0.1\n", "an object .* that is curved"),
    ("SURF 1\n  TYPE STANDARD|SURF 1\n  TYPE COORDBRK\n  PARM 3 2.5", "tilt x 2.5"),
    ("  FLAP 0 6.3 0|  FLAP 1 6.3 0", "FLAP with a hole inside"),
    ("  FLAP 0 6.3 0|  IGNR 1", "IGNR"),
    ("  FLAP 0 6.3 0|  SCBD 0 1 0", "SCBD"),
    ("  FLAP 0 6.3 0|  SQAP 6.3 6.3", "SQAP"),
    ("  FLAP 0 6.3 0|  FLAP 0 6.3 0\n  OBDC 0.5 0", "a decentred aperture"),
    (f"{CURV}|CURV x", "CURV: got .* a finite number"),
    (f'{CURV} 0 0 0 0 ""|CURV', "CURV: got nothing"),
    (f"{CURV}|CURV 1e999", "CURV: got .* a finite number"),
    (f"{CURV}|CURV 7,0613E-002", "CURV: .* decimal point"),
    ("UNIT MM|UNIT FURLONG", "line 7: got UNIT"),
    ("MODE SEQ|MODE NSC", "got MODE"),
    ("DISZ INFINITY|DISZ -500", "an object at -500"),
    ("FNUM 4.5 0|OBNA 0.1 0", "numerical aperture of 0.1, with the object at inf"),
    ("FNUM 4.5 0|OBNA 0.1 1", "OBNA with an angle"),
    ("FNUM 4.5 0|XNUM 4.5 0", "aperture of .*: got none"),
    ("FTYP 0 0 3 3|FTYP 1 0 3 3", "object heights for an object at infinity"),
    ("FTYP 0 0 3 3|FTYP 4 0 3 3", "FTYP: got 4"),
    ("PWAV 2|PWAV 7", "PWAV: got 7"),
    ("SURF 4\n|SURF 5\n", "a second SURF 5"),
    ("SURF 13\n|SURF 99\n", "SURF 13 is missing"),
    ("SURF 4\n|SURF x\n", "SURF without a number"),
    ("3.64762539196E-1|1.2", "vignetting factors of field 3"),
]
DISTANCE = "DISZ INFINITY|DISZ 150"
SHIFT = f"SCHOTT:N-BK7 4 0 0 0 0 0 0 0 0 {-64.1673362374998}"
WRONG_AIR = [
    (AIR, "DISZ INFINITY|GLAS SEAWATER 0 0 1.334 55.8\n  DISZ INFINITY", "medium 'SEAWATER'"),
    ((WILD / "water.zmx").read_text(), "|", "medium n_d 1.334, V_d 55.8"),
    (AIR, "CURV 0.02|CURV -0.03", "no real image: virtual"),
    (AIR, DISTANCE.replace("150", "30"), "no real image: a back focal length of -"),
    ((WILD / "hang.zmx").read_text(), "|", "no real image: afocal"),
    ((WILD / "kepler_140.9.zmx").read_text(), "|", r"afocal, .* at f/1\.1e\+04"),
    (edited(AIR, DISTANCE), "FTYP 0 0 3 1|FTYP 1 1 3 1", "telecentric object space"),
    (AIR, "N-BK7 0 0 1.5168 64.17|517000 0", "unknown glass '517000'"),
    (AIR, f"N-BK7 0 0 1.5168 64.17|{SHIFT}", "shift of glass 'SCHOTT:N-BK7'"),
    (AIR, "DISZ INFINITY|DISZ 1e-40", "object of .*: got 1e-40"),
    (AIR, "FNUM 4 0|FNUM 1e-40 1", "aperture of .*: got 1e-40"),
    (edited(AIR, DISTANCE), "FNUM 4 0|OBNA 1e-40 0", "aperture of .*: got 1e-40"),
    (AIR, "YFLN|VCYN -1e300\nYFLN", "vignetting factors of field 1"),
    *(
        (AIR, f"DISZ 46.5|DISZ 46.5\n  {kind} {value}", "semi_diameter_mm: got")
        for kind in ("DIAM",)
        for value in ("1e-40", "1e300")
    ),
    (EXTENDED.replace("XDAT", "XDUT"), "|", "XASPHERE without XDAT"),
    (EXTENDED, "  XDAT 1 3|  PARM 2 2.5E-06\n  XDAT 1 3", "in both PARM and XDAT"),
    (EXTENDED, "XDAT 2 1 |XDAT 2 0 ", "normalisation radius: got 0"),
    (EXTENDED, "XDAT 2 1 |XDAT 2 1e-200 ", "A4 = inf"),
]
PRESCRIPTIONS = [
    *(("lens.toml", TOML, change, words) for change, words in WRONG_TOML),
    *(("lens.zmx", ZMX, change, words) for change, words in WRONG_ZMX),
    *(("lens.zmx", text, change, words) for text, change, words in WRONG_AIR),
    ("lens.zmx", "a text that says nothing\n", "|", "SURF"),
    ("lens.toml", "a text that says nothing\n", "|", "TOML"),
    *(("lens.zmx", "".join(AIR.partition("SURF 1")[:1]), "|", "1 surfaces") for _ in (1,)),
    ("lens.zos", "", "|", "File, Save As"),
    ("lens.zar", "", "|", "an archive"),
    ("lens.seq", "", "|", "CODE V"),
    ("lens.LEN", "", "|", "CODE V or OSLO"),
    ("lens.agf", "", "|", "lens.glass_catalogues"),
]


@pytest.mark.parametrize(("name", "text", "change", "words"), PRESCRIPTIONS)
@pytest.mark.filterwarnings("ignore")
def test_prescriptions(name: str, text: str, change: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(edited(text, change))
    with pytest.raises(PixsimError, match=words):
        pixsim.load_lens(tmp_path / name)


CONFIGURATIONS = [
    (AIR, "|", 2, r"lens\.configuration: got 2; allowed: 1"),
    (TWO, "|", 3, r"lens\.configuration: got 3; allowed: 1 to 2"),
    (TWO + "CRVT 2 1 1\nCRVT 2 2 3\nPRES 0 1 1\nPRES 0 2 1\n", "|", 2, r"got CRVT 2 \(line \d+\);"),
    (TWO, "THIC 1 2|THIC 9 2", 2, "THIC: got surface 9"),
    (TWO, "YFIE 3 2|YFIE 999 2", 2, "YFIE: got field 999"),
    (TWO, "YFIE 3 2 12|YFIE 3 2 x", 2, "YFIE: got .* a finite number"),
    *(
        (TWO, f"DISZ 46.5|DISZ 46.5\n  {solve}", 2, f"the solve {solve} of a thickness")
        for solve in ("MAZH 0 0.7", "TCOM 1 51.5", "TOLE 1 51.5")
    ),
    (edited(TWO + "APER 0 1 4\nAPER 0 2 5\n", "FNUM 4 0|FLOA\n"), "DISZ 5\n|DISZ 5\n  DIAM 3\n", 2, "APER: got"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "change", "number", "words"), CONFIGURATIONS)
def test_configurations(text, change, number, words, tmp_path: Path) -> None:
    (tmp_path / "lens.zmx").write_text(edited(text, change))
    with pytest.raises(PixsimError, match=words):
        pixsim.load_lens(tmp_path / "lens.zmx", configuration=number)


@pytest.mark.parametrize("name", ["lens.zmx", "lens.toml"])
def test_files_that_are_no_prescription(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with pytest.raises(PixsimError, match="does not exist"):
        pixsim.load_lens(path)
    path.write_bytes(np.random.default_rng(0).bytes(4096))
    with pytest.raises(PixsimError, match=r"binary|UTF-8"):
        pixsim.load_lens(path)
    os.truncate(path, 100 << 20)
    with pytest.raises(PixsimError, match="of 104857600 bytes"):
        pixsim.load_lens(path)


def test_all_that_is_wrong_is_named_at_once(tmp_path: Path) -> None:
    """Unknown glasses, with the numbers of their lines; surfaces that are not traced."""
    text = ZMX.replace("GLAS N-BAK1 0", "GLAS OLD1 0").replace("GLAS N-BALF4 0", "GLAS OLD2 0")
    toml = TOML.replace('glass = "HIKARI:SK16"', 'glass = "OLD1"')
    toml = toml.replace('glass = "SCHOTT:F2"', 'glass = "OLD2"')
    surfaces = edited(AIR, "  STOP\n  TYPE STANDARD|  STOP\n  TYPE TOROIDAL")
    surfaces = edited(surfaces, "GLAS N-BK7|GLAS MIRROR").replace("CURV -0.02", "CURV 0")
    surfaces = edited(surfaces, "SURF 2\n  TYPE STANDARD|SURF 2\n  TYPE COORDBRK\n  PARM 1 .5")
    for name, content, words in (
        ("lens.zmx", text, r"'OLD1'.*GLAS ___BLANK 1 0 1\.5\d+(.*\n)+.*'OLD2'"),
        ("lens.toml", toml, r"'OLD1'(.*\n)+.*'OLD2'"),
        ("lens.zmx", surfaces, r"TOROIDAL.*\n.*MIRROR.*\n.*decentre x 0.5"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(PixsimError, match=words):
            pixsim.load_lens(tmp_path / name)


@pytest.mark.parametrize("unknown", ["error", "model"])
def test_glasses_of_original_files_that_no_catalogue_has(unknown: str) -> None:
    """Other programs take a neighbour, an n_d of 1.5, or a fit; these lines state no numbers."""
    with pytest.raises(PixsimError, match="unknown glass 'L-TIM28_MOLD'"):
        pixsim.load_lens(DATA / "US08427765-1.ZMX")
    with pytest.raises(PixsimError, match=r"surface 2.*'BK7'.*no n_d and V_d(.*\n)+.*surface 4"):
        pixsim.load_lens(DATA / "zmax_55278.zmx", unknown_glass=unknown)


# Bounds of numbers with a meaning: operations on denormal numbers take very long

NUMBERS = {"enpd": "10", "yfln": "5", "um": "0.55", "curvature": "0.01", "conic": "0"}
NUMBERS |= {"thickness": "5", "back": "90", "v_d": "64.17"}
TEMPLATE = """UNIT MM
ENPD {enpd}
FTYP 0 0 1 1
YFLN {yfln}
WAVM 1 {um} 1
GCAT SCHOTT
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV {curvature}
  CONI {conic}
  DISZ {thickness}
  GLAS ___BLANK 1 0 1.5168 {v_d}
SURF 2
  DISZ {back}
SURF 3
  DISZ 0
"""


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_without_a_meaning(name: str, tmp_path: Path) -> None:
    path = tmp_path / "lens.zmx"
    for tiny in ("1e-320", "1e-40", "1e300"):
        path.write_text(TEMPLATE.format(**NUMBERS | {name: tiny}))
        with pytest.raises(PixsimError, match=r"allowed: .*([0-9]|finite)"):
            pixsim.load_lens(path)
    path.write_text(TEMPLATE.format(**NUMBERS))
    assert pixsim.load_lens(path).first_order(550.0).focal_length_mm > 0


SECRET = "correct_horse=battery/staple:0123456789"
LINES = ["SURF {}", "  GLAS {} 0", "  TYPE {}", "  CURV {}", "  DIAM {}", "UNIT {}", "MODE {}"]
LINES += ["MNUM {}", "  PARM 1 {}", "  MAZH {}", "FTYP {}", "GCAT {}\n  GLAS N-BK7 0"]
CATALOGUES = [f"NM {SECRET}", f"NM A 2 0 1.5 60\nCD {SECRET}", f"NM {SECRET} 99 0 1.5 60"]


@pytest.mark.parametrize(
    ("line", "agf"), [*((line, "") for line in LINES), *(("", agf) for agf in CATALOGUES)]
)
def test_no_message_quotes_a_file(line: str, agf: str, tmp_path: Path) -> None:
    text = TEMPLATE.format(**NUMBERS)
    if line:
        text = text.replace("  GLAS ___BLANK 1 0 1.5168 64.17", line.format(SECRET))
    (tmp_path / "lens.zmx").write_text(text)
    (tmp_path / "mine.agf").write_text(agf)
    catalogues = [tmp_path / "mine.agf"] if agf else []
    message = ""
    with catch_warnings(record=True) as caught:
        simplefilter("always")
        try:
            pixsim.load_lens(tmp_path / "lens.zmx", glass_catalogues=catalogues)
        except PixsimError as error:
            message = str(error)
    assert "staple" not in message + " ".join(str(warning.message) for warning in caught)
    assert message or line


# Catalogues of glasses

CATALOGUE = "CC a catalogue\nNM GLASS1 2 0 1.5162 64.2\nCD 1.04 0.006 0.23 0.02 1 103\nLD 0.35 2\n"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("GLASS1 2|GLASS1 14", r"'GLASS1' \(line 2\): formula: got 14"),
        ("CC a catalogue|NM GLASS0 14 0 1.5 60", r"'GLASS0' \(line 1\): formula: got 14"),
        ("LD 0.35 2|LD 2 0.35", "LD: got"),
        ("LD 0.35|LE 0.35", "LD: got none"),
        ("CD 1.04|CD 1.14", "n_d from its formula: got 1.5"),
        ("CD 1.04|CD x", "line 3: got CD"),
        ("CD 1.04|CD 1e-320", "CD: got"),
        ("NM GLASS1|NX GLASS1", "without a glass"),
        ("a catalogue|a \x01", "a binary file"),
    ],
)
def test_catalogues(change: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "mine.agf").write_text(edited(CATALOGUE, change))
    with pytest.raises(PixsimError, match=words):
        read_catalogue(tmp_path / "mine.agf")


@pytest.mark.parametrize(
    ("name", "makers", "words"),
    [
        ("BK7", (), "unknown glass 'BK7'"),
        ("SK16", (), "a name that several makers gave; allowed: HIKARI:SK16"),
        ("SK16", ("SCHOTT",), r"catalogues that the file names \(SCHOTT\)"),
        ("SK16", ("OLD_SCHO", "MINE"), r"catalogues that the file names \(OLD_SCHO, MINE\)"),
        ("L-TIM28_MOLD", ("OHARA",), "unknown glass 'L-TIM28_MOLD'"),
        ("F2", (), "which several makers offer; allowed: SCHOTT:F2, HIKARI:F2, CDGM:F2"),
        ("SCHOTT:J-LAK14", (), "unknown glass 'SCHOTT:J-LAK14'"),
        ("", (), "unknown glass nothing"),
    ],
)
def test_names_of_glasses(name: str, makers: tuple[str, ...], words: str) -> None:
    with pytest.raises(PixsimError, match=f"surface 2: .*{words}"):
        find_glass(name, "surface 2", makers)


@pytest.mark.parametrize(
    ("name", "makers", "full_name"),
    [
        ("n-bk7", (), "SCHOTT:N-BK7"),
        ("HIKARI:F2", (), "HIKARI:F2"),
        ("F2", ("OHARA", "HIKARI", "SCHOTT"), "HIKARI:F2"),  # in the order of the file
        *(
            ("N-BK7", ("MISC", maker), "SCHOTT:N-BK7")
            for maker in ("SCHOTT", "SCHOTT_2017", "SCHOTT-JAN-2020", "OLD_SCHO", "schott")
        ),
    ],
)
def test_names_that_are_found(name: str, makers: tuple[str, ...], full_name: str) -> None:
    assert find_glass(name, "x", makers).name == full_name


def test_glass_of_an_absent_catalogue_needs_its_numbers() -> None:
    with pytest.warns(UserWarning, match=r"'S-LAH58' is taken from OHARA:S-LAH58; .*\(MINE\)"):
        glass = find_glass("S-LAH58", "x", makers=["MINE"], numbers=(1.883, 40.8))
    assert glass.name == "OHARA:S-LAH58"
    for numbers in ((1.8, 40.8), (1.883, 39.0)):
        with pytest.raises(PixsimError, match=r"catalogues that the file names \(MINE\)"):
            find_glass("S-LAH58", "x", makers=["MINE"], numbers=numbers)


# Chief ray angles and fall-off of a thin lens

CRA = "image_height_mm,deg\n"
LIT = "image_height_mm,deg,relative_illumination\n"
FALL_OFF = "image_height_mm,relative_illumination\n"
TABLES = [
    ("", "without these columns"),
    ("0,0\n1,12\n2,21\n", "first line of"),
    (CRA, "of 0 rows"),
    (f"{CRA}0,0\n1\n", "in line 3"),
    (f"{CRA}0,0\n2,x\n", "in line 3"),
    (f"{CRA}0,0\n2,nan\n", "in row 2.*finite"),
    (f"{CRA}-1,0\n2,3\n", "begins with -1 mm"),
    (f"{CRA}0,1\n2,3\n", "0 mm and 1 degrees"),
    (f"{CRA}0,0\n2,3\n1,2\n", "2 mm followed by 1 mm"),
    (f"{CRA}0,0\n2,90\n", "90 degrees in row 2"),
    (f"{CRA}0,0\n1e-9,1\n2,2\n", "with 1e-09 mm"),
    (f"{CRA}0,0\n1.5,20\n", "up to the corner.*1.9189 mm"),
    (f"{CRA}0,0\n1.9,62\n2,5\n", "62 degrees at 1.9 mm.*horizon"),
    (f"{LIT}0,0,100\n2,3,80\n", "100 in row 1.*percentages"),
    (f"{LIT}0,0,.8\n2,3,.7\n", "0.8 on the axis"),
    (f"{LIT}0,0,1\n2,3,-.1\n", "-0.1 in row 2"),
    (CRA + "".join(f"{row / 500},0\n" for row in range(1001)), "of 1001 rows"),
    (CRA + "0,0\n" * 300_000, "of 1200020 bytes"),
]
FALL_OFFS = [
    (f"{FALL_OFF}0,1\n", "of the axis only"),
    (f"{FALL_OFF}", "of 0 rows"),
    (f"{FALL_OFF}0,.8\n2,.7\n", "0.8 on the axis"),
    (f"{FALL_OFF}0,1\n2,3\n", "of 3 in row 2"),
    (f"{FALL_OFF}1,.9\n1,.8\n", "1 mm followed by 1 mm"),
    (f"{FALL_OFF}1,.9\n", "up to the corner"),
    (f"{CRA}0,0\n2,3\n", "without these columns"),
]


@pytest.mark.parametrize(
    ("field", "text", "words"),
    [*(("chief_ray_angle", *row) for row in TABLES), *(("fall_off", *row) for row in FALL_OFFS)],
)
def test_tables_of_a_lens(field: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(PixsimError, match=f"(chief_ray_angle|fall_off|illumination).*{words}"):
        Camera(f_number=1.4, **{field: tmp_path / "table.csv"})


# Values that do not fit each other

GLASS = constant_glass("n = 1.5", 1.5)
GOOD = {"pitch_um": 2.2, "photodiode_side_um": 1.3, "height_um": 3.5, "index": 1.5, "f_number": 2.0}
ROWS = ((0.0, 0.0), (1.0, 12.0), (2.0, 21.5))
FALLS = ((0.0, 1.0), (3.0, 0.5))
IRRADIANCE = SpectralImage([550.0], 10.0, 5.0, data=np.ones((8, 8, 1)))


def lens_of(*surfaces: Surface, diameter_mm: float = 20.0, stop: int = 0) -> Lens:
    kinds = "entrance_pupil_diameter", diameter_mm, "angle_deg", 0.0
    return lens_from_prescription(
        Prescription("test", "", "", surfaces, stop, *kinds, (550.0,), 550.0)
    )


def wide(lens: Lens, diameter_mm: float, stop_y: float) -> object:
    larger = replace(lens, entrance_pupil_diameter_mm=diameter_mm)
    return larger.opd_waves(0.0, 550.0, 0.0, stop_y)


def stack(**numbers: object) -> object:
    return optics.stack_collection(**GOOD | numbers)


PHONE = pixsim.load_lens("phone")
BALL = Surface(0.0, 1.0), Surface(1 / 5, 8.0, GLASS), Surface(0.0, 5.0)
HALF = Surface(0.0, 2.0, GLASS), Surface(-1 / 10, 20.0)
RIM = Surface(1 / 5, 8.0, GLASS), Surface(0.0, 5.0)
BK7 = catalogue()["SCHOTT:N-BK7"]
CALLS: list[tuple[str, Callable[[], object], str]] = [
    ("an unknown lens", lambda: pixsim.load_lens("phon"), "cooke_triplet, .*'phone'"),
    ("no chief ray", lambda: PHONE.chief_ray(85.0, 550.0), r"misses surface \d+ \(550 nm\)"),
    ("height", lambda: PHONE.field_of_height(1e3, 550.0), "height_mm: .*image circle"),
    ("sideways", lambda: PHONE.chief_ray(90.0, 550.0), "field_deg: got 90"),
    ("nothing", lambda: PHONE.chief_ray([], 550.0), "field_deg: got an empty array"),
    ("no number", lambda: PHONE.chief_ray(np.nan, 550.0), "field_deg: got nan"),
    ("infrared", lambda: PHONE.opd_waves(0.0, 900.0, 0.0, 0.0), "wavelength_nm: got 900"),
    ("spokes", lambda: PHONE.outline(0.0, 550.0, 6), "spokes: got 6"),
    ("rings", lambda: PHONE.directions(0.0, 550.0, 0.0, rings=0), "rings: got 0"),
    ("a wider stop", lambda: PHONE.stopped_down(1.0), "f_number: got 1; .*'phone'"),
    ("no image", lambda: PHONE.refocused("axis", 1.0), "object_distance_mm: got 1"),
    ("a rim", lambda: wide(lens_of(*BALL, diameter_mm=6.0), 10.6, 0.99), "misses surface 2"),
    ("reflection", lambda: wide(lens_of(*HALF, diameter_mm=4.0), 15.0, 0.95), "totally reflected"),
    ("marginal ray", lambda: lens_of(*RIM, diameter_mm=10.6, stop=1), "marginal ray .* surface 1"),
    ("virtual", lambda: lens_of(Surface(-0.02, 3.0, GLASS), Surface(0.0, 5.0)), "positive focal"),
    *(
        (f"{nm} nm", lambda nm=nm: BK7.index([550.0, nm]), "wavelength_nm: got .*'SCHOTT:N-BK7'")
        for nm in (299.0, 2501.0, 0.0, np.nan, np.inf)
    ),
    ("no index", lambda: Glass("x", 3, (-1.0,)).index(550.0), "index of glass 'x': got nan"),
    ("formula", lambda: Glass("x", 6, (1.0,)), "formula of glass 'x': got 6"),
    ("an even number", lambda: Glass("x", 2, (1.0, 2.0)), "got 2 numbers"),
    ("few numbers", lambda: Glass("x", 4, (1.0,)), "got 1 numbers"),
    ("not six", lambda: Glass("x", 7, (1.0,)), "got 1 numbers"),
    ("infinite", lambda: Glass("x", 3, (np.inf,)), "infinity or NaN"),
    ("faster than f/0.5", lambda: optics.irradiance_factor(0.4, 0.0), "f_number: got"),
    ("no tangent", lambda: optics.irradiance_factor(4.0, [0, np.nan]), "tan_field: got nan"),
    ("horizon", lambda: thin_lens_pupil(4.0, np.inf), "tan_field and azimuth_deg: got"),
    ("steep pupil", lambda: disc_pupil(0.5, [0.0, 30.001]), "pupil: .*horizon"),
    ("90°", lambda: disc_pupil(0.1, 90.0), "chief_ray_deg: got 90"),
    ("dark weights", lambda: diffract(np.ones((2, 2)), 1.0, np.ones(1), np.zeros(1), 4.0), "weight: got a sum of 0"),
    ("weights", lambda: diffract(np.ones((2, 2)), 1.0, np.ones(1), np.ones(2), 4.0), "1 and 2 values"),
    ("photodiode", lambda: stack(photodiode_side_um=2.3), "photodiode_side_um: got 2.3"),
    ("étendue", lambda: stack(height_um=1.2), "height_um: got 1.2; .* 1.24122"),
    ("shift", lambda: stack(shift_um=(1.2, 0.0)), r"shift_um: got \(1\.2, 0\.0\)"),
    ("cone", lambda: stack(f_number=0.9, chief_ray_deg=32.0), "pupil: .*1.016"),
    ("light beside", lambda: optics.stack.aperture_mtf(Stack(6.5, 3.5, 8.0, 1.5, False), disc_pupil(1e-9, 53.0), 1.0), "does not reach"),
    ("focus", lambda: Camera(focal_length_mm=50.0, object_distance_m=0.05), "focal_length_mm = 50 is not shorter"),
    ("magnified", lambda: Camera(focal_length_mm=50.0, object_distance_m=0.05000000001), "magnifies"),
    ("configuration", lambda: pixsim.load_lens(DATA / "telephoto.toml", configuration=2), "like every .toml file"),
    ("working f-number", lambda: Camera(f_number=0.45), "f_number = 0.45 is too small"),
    ("two fall-offs", lambda: Camera(fall_off=FALLS, chief_ray_angle=[(*row, 1.0) for row in ROWS]), "one of them"),
    ("window", lambda: Camera(die_mm=2.0).window(3.0), "window_mm: got 3"),
    ("no pitch", lambda: CameraOptions(pixels=(20, 10)).over(Camera()), "camera.pixels: got"),
    ("larger die", lambda: CameraOptions(chief_ray_angle=ROWS, die_mm=3.0).over(Camera()), "2.1214 mm"),
    *(
        (f"{value!r}", lambda value=value: Camera(chief_ray_angle=value), f"chief_ray_angle.*{words}")
        for value, words in (
            ("missing.csv", "does not exist"),
            (3.0, "neither a file nor"),
            ([[0, 0], [2, "x"]], "neither a file nor"),
            ([[0, 0], [2, 3, 1]], "in every row"),
            ([["0", "0"], "12"], "of 1 rows"),
            (True, "got True"),
            ([[0, 0], [1e400, 3]], "finite"),
        )
    ),
    ("nowhere", lambda: pixsim.write_npz("/nowhere/a.npz", IRRADIANCE), "output file: got"),
    ("options without a file", lambda: LensOptions(refocus="field"), "refocus without file"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "words"), [row[1:] for row in CALLS], ids=[row[0] for row in CALLS]
)
def test_values(call: Callable[[], object], words: str) -> None:
    with pytest.raises((PixsimError, ValueError), match=words):
        call()


def test_pupils_up_to_the_horizon_are_allowed() -> None:
    for chief_deg in (0.0, 5.0, -30.0):
        disc_pupil((1 - math.sin(math.radians(abs(chief_deg)))) * (1 - 1e-6), chief_deg, 10.0)


# Light of other programs

WRONG_UNITS = (
    "lx,DN,Reflectance,uW/cm2*nm*sr,W/m2 nm,W//m^2,W/(m^2 nm,W/m^2 nm),W.m^-2.Hz^-1,J.m^-2"
)
WRONG_UNITS += ",W^2.m^-6,W.m^-4,W.m^-3.sr,W.m^9999999999999999999,W.m^-2.nm^-1 twice,3 W.m^-3"


@pytest.mark.parametrize(
    "text", [*WRONG_UNITS.split(","), "(" * 5000, "W" * 5000, "W.m^" + "5" * 5000]
)
def test_units(text: str) -> None:
    with pytest.raises(PixsimError, match=rf"units: got .*{len(text)} characters.*State them"):
        parse_light_unit(text, typed=False)


def value_at(value: float) -> np.ndarray:
    data = light().astype(float)
    data[2, 3, 1] = value
    return data


def huge_npz(path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name, shape in (("data", (1 << 20, 1 << 20, 3)), ("wavelength_nm", (3,))):
            with file.open(f"{name}.npy", "w") as member:
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, header)
    return path


def own(path: Path, data: np.ndarray | None = None, spectra: object = None) -> Path:
    content = {"data": data}
    if spectra is not None:
        content = {"factors": (spectra, np.ones((2, 4, 5)))}
    pixsim.write_exr(path, SpectralImage(NM, 10.0, 1.0, **content))
    return path


def envi_text(path: Path, change: str) -> Path:
    write_envi(path)
    path.write_text(edited(path.read_text(), change))
    return path


START, END, FAR = (np.array(corner, np.int32) for corner in ([0, 0], [4, 3], [9, 3]))
CROP = {"dataWindow": (START, END), "displayWindow": (START, FAR)}
DARK = np.zeros((4, 5), np.float32)
CAMERA = Camera(die_mm=0.05)
FREE = {"pitch_um": None}
# name, writer of a file with this ending, options of the reader, words
LIGHT = [
    *((kind, f".{kind}", lambda path, kind=kind: write_light(kind, path.with_suffix(""), light(), None), {}, "none in the file") for kind in ("exr", "npz", "hdr")),
    ("other units", ".npz", lambda path: write_npz(path, units="mW/m2/nm"), {"units": UNIT}, "the same unit"),
    ("other kind", ".npz", lambda path: write_npz(path, units="mW/m2/nm"), {"units": "W/m2/sr/nm", "camera": CAMERA}, "the same unit"),
    ("per area", ".npz", lambda path: write_npz(path, units="W.m^-2.sr^-1"), {}, "not per wavelength"),
    ("flux", ".exr", lambda path: write_exr(path, stokes(light()), emissiveUnits="W.m^-2"), {}, "not per wavelength"),
    ("radiance", ".npz", lambda path: write_npz(path, units="W/m2/sr/nm"), {}, "without a camera"),
    ("own units", ".exr", lambda path: own(path, light()), {"units": "W.m^-2.um^-1", **FREE}, "the same unit"),
    ("own pitch", ".exr", lambda path: own(path, light()), {}, "1 µm by the file, 2.5 µm by pitch_um"),
    ("own black", ".exr", lambda path: own(path, 0 * light()), FREE, "a black picture"),
    ("own NaN", ".exr", lambda path: own(path, value_at(np.nan)), FREE, "nan at row 2, column 3 of the band at 510 nm"),
    ("own factors", ".exr", lambda path: own(path, spectra=[[1.0, 1.0, 1.0], [0.0, -2.0, 0.0]]), FREE, "mean of -1 W/m²/nm in the band at 510 nm"),
    ("twice", ".exr", lambda path: write_exr(path, stokes(light(), ("S0.0,55um", "S0.550,0nm")), emissiveUnits=UNIT), {}, "550.0, 550.0 nm for 2 bands"),
    ("polarised", ".exr", lambda path: write_exr(path, stokes(light()) | {"S2.500nm": DARK - 1}, emissiveUnits=UNIT), {}, "polarised light"),
    ("reflectance", ".exr", lambda path: write_exr(path, {"T.500nm": DARK + 1}, emissiveUnits=UNIT), {}, "reflectances"),
    ("RGB", ".exr", lambda path: write_exr(path, dict.fromkeys("RGB", DARK + 1)), {}, "RGB is not a spectrum"),
    ("layers", ".exr", lambda path: write_exr(path, {f"layer.{index:02}": DARK for index in range(40)}), {}, "layer.11 …"),
    ("crop", ".exr", lambda path: write_exr(path, stokes(light()), **CROP), {}, "a crop"),
    ("oblong", ".exr", lambda path: write_exr(path, stokes(light()), pixelAspectRatio=2.0), {}, "non-square pixels"),
    *((f"{nm} nm", ".npz", lambda path, nm=nm: write_npz(path, wavelength_nm=nm), {}, "nm for 3 bands")
      for nm in ([500, 510], [520, 500, 510], [500, 500, 510], [299, 510, 520], [500, 510, 1201], [500, 510, np.nan])),
    ("micrometres", ".npz", lambda path: write_npz(path, wavelength_nm=[0.5, 0.51, 0.52]), {}, "seem to be in µm"),
    ("nanometres", ".hdr", lambda path: write_envi(path, wavelength_units="Micrometers"), {}, "in nm, though the header says µm"),
    ("one band", ".npz", lambda path: write_npz(path, data=light((4, 5, 1)), wavelength_nm=[633.0]), {}, "none, for a single band"),
    *((f"widths {widths}", ".npz", lambda path, widths=widths: write_npz(path, band_width_nm=widths), {}, "band widths")
      for widths in ([1.0, 2.0], [1.0, 2.0, 0.0], [1.0, np.nan, 1.0], ["a", "b", "c"], [1.0, np.inf, 1.0])),
    ("no pitch", ".npz", lambda path: write_npz(path, pitch_um=None), FREE, "none in the file"),
    ("two pitches", ".npz", lambda path: write_npz(path, pitch_um=None), {"pitch_um": 7.0, "camera": CAMERA}, "10 µm by camera.die_mm / 5 columns, 7 µm"),
    *((f"pitch {pitch}", ".npz", lambda path, pitch=pitch: write_npz(path, pitch_um=pitch), FREE, "pitch_um of")
      for pitch in (0.0, -1.0, np.nan, "wide", [1.0, 2.0])),
    ("white", ".npz", lambda path: write_npz(path, white_cd_per_m2=-1.0), {}, "white_cd_per_m2 of"),
    *((f"value {value}", ".npz", lambda path, value=value: write_npz(path, data=value_at(value)), {}, rf"got {re.escape(str(value))} at row 2, column 3")
      for value in (np.nan, np.inf, -np.inf, -1e-30, 1e300)),
    ("black", ".npz", lambda path: write_npz(path, data=np.zeros((4, 5, 3))), {}, "a black picture"),
    *((f"array {index}", ".npz", lambda path, arrays=arrays: write_npz(path, **arrays), {}, "real numbers")
      for index, arrays in enumerate(({"data": np.ones((4, 5))}, {"data": np.ones((4, 5, 3), complex)}, {"data": np.full((4, 5, 3), "a")}, {"wavelength_nm": 500.0}))),
    ("no data", ".npz", lambda path: write_npz(path, data=None), {}, "got wavelength_nm, units, pitch_um"),
    ("another name", ".npz", lambda path: write_npz(path, pitch_mm=1.0), {}, "pitch_mm"),
    ("pickle", ".npz", lambda path: write_npz(path, units=np.array({}, object)), {}, "without pickled objects"),
    ("bands first", ".npz", lambda path: write_npz(path, data=np.ones((3, 8, 9))), {}, r"np\.moveaxis\(data, 0, 2\)"),
    ("bands in the middle", ".npz", lambda path: write_npz(path, data=np.ones((8, 3, 9))), {}, r"np\.moveaxis\(data, 1, 2\)"),
    ("huge npz", ".npz", huge_npz, {}, "more memory than is available"),
    ("huge ENVI", ".hdr", lambda path: envi_text(path, "lines = 4|lines = 1000000000"), {}, "1000000000 × 5 × 3 values"),
    ("empty ENVI", ".hdr", lambda path: envi_text(path, "lines = 4|lines = 0"), {}, "0 × 5 × 3 values"),
    ("a PNG", ".png", lambda path: path, {}, "a name that ends in"),
    *((f"no {suffix}", suffix, lambda path: path, {}, "does not exist") for suffix in (".npz", ".hdr", ".exr")),
    *((f"{name} {value}", ".hdr", lambda path, name=name, value=value: write_envi(path, **{name: value}), {}, words)
      for name, value, words in (
          ("data_gain_values", [1, 2, 1], "'data gain values'"),
          ("data_offset_values", [0, 0, 0.5], "'data offset values'"),
          ("reflectance_scale_factor", 10000, "'reflectance scale factor'"),
          ("calibration_scale_factor", 0.1, "'calibration scale factor'"),
          ("bbl", [1, 0, 1], "'bbl'"),
          ("data_ignore_value", float(light()[1, 2, 0]), "no data .*row 1, column 2, band 0"),
          ("wavelength_units", "Unknown", "wavelength units .*Unknown"),
          ("wavelength_units", None, "wavelength units .*none"),
          ("wavelength", None, "without wavelength"),
          ("wavelength", ["a", "b", "c"], "ENVI header"),
          ("data_units", "Reflectance", "got .*11 characters"),
      )),
    *((change, ".hdr", lambda path, change=change: envi_text(path, change), {}, words)
      for change, words in (
          ("ENVI\n|#?RADIANCE\n", "an ENVI header"),
          ("interleave = bil|interleave = tiles", "interleave = tiles"),
          ("byte order = 0|byte order = 2", "byte order = 2"),
          ("data type = 4|data type = 6", "real numbers"),
          ("data type = 4|data type = 99", "an ENVI header"),
          ("lines = 4|lines = four", "an ENVI header"),
          ("bands = 3|", '"bands"'),
          ("lines = 4|lines = 40", "240 bytes in"),
      )),
]  # fmt: skip


@pytest.mark.parametrize(
    ("suffix", "write", "options", "words"),
    [row[1:] for row in LIGHT],
    ids=[str(row[0]) for row in LIGHT],
)
def test_light(suffix: str, write, options: dict[str, object], words: str, tmp_path: Path) -> None:
    path = write(tmp_path / f"a{suffix}")
    with pytest.raises(PixsimError, match=words) as caught:
        read_irradiance(path, **{"pitch_um": 2.5} | options)
    assert path.name in str(caught.value)


@pytest.mark.parametrize("kind", ["exr", "npz", "raw"])
def test_truncated_light(kind: str, tmp_path: Path) -> None:
    path = write_light(kind, tmp_path / "a", light((32, 32, 3)), UNIT)
    torn = path.with_suffix(f".{kind}")
    whole = torn.read_bytes()
    for share in (0.0, 0.1, 0.5, 0.9, 0.99):
        torn.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(PixsimError, match=path.name):
            read_irradiance(path, pitch_um=2.5)


def test_envi_without_its_raw_file_or_reader(tmp_path: Path, monkeypatch) -> None:
    path = write_envi(tmp_path / "a.hdr")
    (tmp_path / "a.raw").unlink()
    with pytest.raises(PixsimError, match="raw file in the same folder"):
        read_irradiance(path)
    monkeypatch.setitem(__import__("sys").modules, "spectral", None)
    with pytest.raises(PixsimError, match="SPy is not installed"):
        read_irradiance(path)


def test_no_axis_has_the_bands() -> None:
    assert bands_last_hint((4, 5, 6), 2) == ""
    assert bands_last_hint((2, 5, 2), 2) == "", "the last axis fits"
