"""Prescriptions from files: the same lens from each format, unit and encoding, and every number
of a file where it belongs, or refused by its cause; names and catalogues of glasses.
"""

import math
import os
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check

from pixsim import PixsimError, load_lens
from pixsim.base.toml import packaged
from pixsim.optics.glass import find_glass, read_catalogue
from pixsim.optics.lens import Lens
from pixsim.optics.prescription import read_prescription

DATA = Path(__file__).parents[1] / "data" / "lenses"
WILD = DATA / "wild"
TOML = packaged("data/lenses")["cooke_triplet"].read_text()
ZMX = (DATA / "US00583336-2-scaled.zmx").read_text()
UTF16 = (DATA / "zmax_55278.zmx").read_text("utf-16")
AIR = (WILD / "air.zmx").read_text()
EXTENDED = (WILD / "xas.zmx").read_text()
POINTS = np.array([0.0, 0.3, -0.8]), np.array([0.9, -0.5, 0.1])
FOCAL_MM = 49.0514


def edited(text: str, *changes: str) -> str:
    """Return a text with changes `old|new`; each must be there."""
    for change in changes:
        old, _, new = change.partition("|")
        assert old in text, old
        text = text.replace(old, new)
    return text


def load(folder: Path, text: str | bytes, name: str = "lens.zmx", **options) -> Lens:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_lens(path, **options)


loaded = cache(load_lens)


def same(lens: Lens, other: Lens, field_deg: float, waves: float) -> None:
    """Check that two lenses have the same wavefront and primary wavelength."""
    for nm in (486.1327, 656.2725):
        wanted = other.opd_waves(field_deg, nm, *POINTS)
        check(f"OPD at {nm} nm", lens.opd_waves(field_deg, nm, *POINTS), wanted, atol=waves, why="")
    assert lens.primary_nm == pytest.approx(other.primary_nm, rel=1e-6)


# Texts of one lens


def without_lines(text: str, *keywords: str) -> str:
    return "\n".join(
        line for line in text.splitlines() if line.split()[:1] not in [[w] for w in keywords]
    )


ASPHERE = edited(
    (DATA / "US08427765-1.ZMX").read_text(), "L-TIM28_MOLD|L-TIM28", "RPO HOYA|RPO HOYA OHARA"
)
UNINDENTED = "\n".join(line.strip() for line in AIR.splitlines())
BEFORE = AIR[: AIR.index("SURF 1\n")]
OLD_LISTS = "WAVL 4.861327E-1 5.875618E-1 6.562725E-1\nXFLD 0 0 0\nYFLD 0 17 24\n"
# name: text, name of the file, file of the same lens, field in degrees, gate in waves
SAME: dict[str, tuple[str | bytes, str, str, float, float]] = {
    **{name: (text, "lens.zmx", "wild/air.zmx", 10.0, 1e-9) for name, text in {
    "unindented": UNINDENTED,
    "all indented": "\n".join(f"  {line}" for line in AIR.splitlines()),
    "tabs": AIR.replace("  ", "\t"),
    "small letters": edited(AIR, "SURF|Surf", "  CURV|  curv", "TYPE STANDARD|TYPE Standard"),
    "surfaces first": AIR[AIR.index("SURF 0") :] + AIR[: AIR.index("SURF 0")],
    "surfaces first, unindented": (
        UNINDENTED[UNINDENTED.index("SURF 0") :] + "\n" + UNINDENTED[: UNINDENTED.index("SURF 0")]
    ),
    "surfaces in another order": (
        BEFORE[: BEFORE.index("SURF 0")]
        + AIR[AIR.index("SURF 1\n") :]
        + BEFORE[BEFORE.index("SURF 0") :]
    ),
    "without MODE": edited(AIR, "MODE SEQ\n|"),
    "other order of wavelengths": edited(AIR, "WAVM 1 5.5E-1 1|WAVM 2 .65 1\nWAVM 1 5.5E-1 1"),
    "lines of old Macs": AIR.replace("\n", "\r"),
    "end of DOS": AIR + "\x1a\x1a",
    "filled up": AIR + "\0" * 300,
    "air by its name": edited(AIR, "DISZ 46.5|DISZ 46.5\n  GLAS AIR 0 0 1 0"),
    "working f-number": edited(AIR, "FNUM 4 0|FNUM 4 1"),
    "object far away": edited(AIR, "DISZ INFINITY|DISZ 1E10"),
    "0x85 in a comment": edited(AIR, "  STOP\n|  COMM a\x85CURV 1\n  STOP\n").encode("latin-1"),
    "half a character": AIR.encode("utf-16") + b"\n",
    "half a character, little": AIR.encode("utf-16-le") + b"\n",
    "half a character, big": AIR.encode("utf-16-be") + b"\n",
    "of the collection": (WILD / "flat.zmx").read_text(),
    "null coordinate break": (WILD / "cb.zmx").read_text(),
    "null coordinate break in glass": edited(
        AIR,
        "SURF 3|SURF 4",
        "SURF 2\n|SURF 3\n",
        "DISZ 5\n  GLAS N-BK7 0 0 1.5168 64.17\n|DISZ 2\n  GLAS N-BK7 0 0 1.5168 64.17\nSURF 2\n"
        "  TYPE COORDBRK\n  PARM 1 0\n  PARM 6 1\n  DISZ 3\n",
    ),
}.items()},
    **{
        encoding: (
            edited(UTF16, "GLAS BK7|GLAS N-BK7").encode(encoding),
            "lens.zmx",
            "achromat_pair_55278.toml",
            0.0,
            1e-6,
        )
        for encoding in ("utf-16", "utf-16-le", "utf-16-be", "utf-8", "utf-8-sig")
    },
    "TOML": (ZMX, "lens.zmx", "double_gauss_us583336.toml", 24.0, 1e-6),
    "TOML with aspheres": (ASPHERE, "lens.zmx", "asphere_us8427765.toml", 12.0, 1e-6),
    "older lists": (
        OLD_LISTS + without_lines(ZMX, "WAVM", "XFLN", "YFLN", "FTYP"),
        "lens.zmx",
        "US00583336-2-scaled.zmx",
        24.0,
        1e-7,
    ),
    "glasses of the catalogue": (
        TOML[: TOML.index("[glass.")], "lens.toml", "cooke_triplet", 20.0, 1e-7
    ),
    "radii and f-number": (
        edited(
            without_lines(TOML, "curvature_per_mm"),
            'type = "entrance_pupil_diameter"\nvalue_mm = 10.0|type = "f_number"',
        ),
        "lens.toml", "cooke_triplet", 20.0, 1e-7
    ),
    "asphere of the smallest term": (
        edited(TOML, "conic = 0.0|conic = 0.0\nasphere = { A4 = 1.1e-39 }"), "lens.toml", "cooke_triplet", 20.0, 1e-7
    ),
    "asphere of zeros": (
        edited(TOML, "conic = 0.0|conic = 0.0\nasphere = { A4 = 0.0 }"), "lens.toml", "cooke_triplet", 20.0, 1e-7
    ),
    "neither tilted nor decentred": (
        edited(
            ZMX, "  FLAP 0 6.3 0|  FLAP 0 6.3 0\n  SCBD 0 0 0\n  OBDC 0\n  IGNR 0 0", "MODE SEQ|MODE SEQ 0"
        ), "lens.zmx", "US00583336-2-scaled.zmx", 24.0, 1e-9
    ),
    "stop by its surface": (
        edited(TOML, "stop_surface = 4|"), "lens.toml", "cooke_triplet", 14.0, 1e-7
    ),
    "stop by its number": (
        edited(TOML, "stop = true|stop = false"), "lens.toml", "cooke_triplet", 14.0, 1e-7
    ),
    "extended asphere": (EXTENDED, "lens.zmx", "wild/equivalent_evenasph.zmx", 10.0, 1e-9),
    "extended asphere over 2": (
        edited(
            EXTENDED, "XDAT 2 1 |XDAT 2 2 ", "XDAT 4 2.5E-06|XDAT 4 4.0E-05", "XDAT 5 1.0E-09|XDAT 5 6.4E-08"
        ),
        "lens.zmx",
        "wild/equivalent_evenasph.zmx",
        10.0,
        1e-9,
    ),
    "extended asphere of nothing": (
        edited(EXTENDED, "XDAT 2 1 |XDAT 2 1e200 "), "lens.zmx", "wild/air.zmx", 10.0, 1e-7
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_lens_does_not_depend_on_how_its_file_is_written(name: str, tmp_path: Path) -> None:
    text, file, reference, field_deg, waves = SAME[name]
    path = DATA / reference
    lens = load(tmp_path, text, file)
    same(lens, loaded(path if path.exists() else reference), field_deg, waves)


@pytest.fixture(scope="module")
def asphere(tmp_path_factory: pytest.TempPathFactory) -> Lens:
    return load(tmp_path_factory.mktemp("asphere"), ASPHERE)


@pytest.mark.parametrize(
    ("unit", "size_mm"), [("CM", 10.0), ("IN", 25.4), ("INCHES", 25.4), ("METER", 1000.0)]
)
def test_unit_scales_all_lengths(asphere: Lens, tmp_path: Path, unit: str, size_mm: float) -> None:
    """Also the asphere's terms, which scale with powers of the unit."""
    scaled = asphere.scaled(size_mm)
    lens = load(tmp_path, edited(ASPHERE, f"UNIT MM|UNIT {unit}"))
    check("focal length", focal_mm(lens), focal_mm(scaled), rtol=1e-12, why="rounding")
    opd = scaled.opd_waves(10.0, 550.0, *POINTS)
    check("wavefront", lens.opd_waves(10.0, 550.0, *POINTS), opd, atol=1e-5, why="of a metre")
    assert lens.max_field_deg == pytest.approx(scaled.max_field_deg, rel=1e-9)


# Numbers of a file


def focal_mm(lens: Lens) -> float:
    return lens.first_order(lens.primary_nm).focal_length_mm


def f_number(lens: Lens) -> float:
    return lens.first_order(lens.primary_nm).f_number


def n_d(lens: Lens, surface: int = 0) -> float:
    return float(lens.prescription.surfaces[surface].glass.index(587.5618))


def thickness_mm(lens: Lens, surface: int = -1) -> float:
    return lens.prescription.surfaces[surface].thickness_mm


def near(field: str = "0 0 3 1 0 0 0", aperture: str = "FNUM 4 0") -> str:
    """Return the lens with its object at 150 mm; its stop and entrance pupil are in front."""
    changes = ["DISZ INFINITY|DISZ 150", "DISZ 46.5|DISZ 70", f"FNUM 4 0|{aperture}"]
    return edited(AIR, *changes, f"FTYP 0 0 3 1 0 0 0|FTYP {field}")


BEHIND = "GLAS N-BK7 0 0 1.5168 64.17"
FACTORS = re.sub(r"  FLAP .*\n", "", ZMX)
STANDARD = "TYPE STANDARD\n  CURV -0.02|"
GLASSES = 'glass = "HIKARI:SK16"|glass = { n_d = 1.62041, v_d = 60.32 }'
# name: text, name of the file, number of the lens, expected, relative tolerance
NUMBERS: dict[str, tuple[str, str, Callable, object, float]] = {
    "focal length": (AIR, ".zmx", focal_mm, FOCAL_MM, 2e-6),
    "largest angle": (ZMX, ".zmx", lambda lens: lens.max_field_deg, 24.0, 1e-15),
    "real image height": (
        ASPHERE, ".zmx", lambda lens: lens.chief_ray(lens.max_field_deg, lens.primary_nm).height_mm, 13.6, 1e-9
    ),
    "entrance pupil": (edited(ZMX, "FNUM 4.5 0|ENPD 10.975328"), ".zmx", f_number, 4.5, 1e-5),
    "f-number": (ZMX, ".zmx", f_number, 4.5, 1e-12),
    # Twice the paraxial height in the stop of a ray from the edge of the entrance pupil.
    "size of the stop": (
        edited(ZMX, "FNUM 4.5 0|FLOA"), ".zmx",
        lambda lens: abs(lens._entrance_pupil_scale(lens.primary_nm)[0]) * lens.entrance_pupil_diameter_mm, 8.43, 1e-6
    ),
    "working f-number": (
        near(aperture="FNUM 8 1"), ".zmx", lambda lens: lens.working_f_number, 8.0, 1e-12
    ),
    "numerical aperture": (
        near(aperture="OBNA 0.05 0"), ".zmx", lambda lens: lens.entrance_pupil_diameter_mm / 300, math.tan(math.asin(0.05)), 1e-12
    ),
    "object height": (
        near("1 0 3 1 0 0 0"), ".zmx", lambda lens: math.tan(math.radians(lens.max_field_deg)), 10 / 150, 1e-12
    ),
    "object distance": (
        near("1 0 3 1 0 0 0"), ".zmx", lambda lens: lens.object_distance_mm, 150.0, 1e-12
    ),
    "heights of a far object": (
        edited(AIR, "DISZ INFINITY|DISZ 1E10", "FTYP 0|FTYP 1", "0 7 10|0 7E8 1E9"), ".zmx", lambda lens: math.tan(math.radians(lens.max_field_deg)), 0.1, 1e-9
    ),
    "object distance of TOML": (
        edited(TOML, "object_distance_mm = inf|object_distance_mm = 500"), ".toml", lambda lens: lens.object_distance_mm, 511.512158674, 1e-10
    ),
    "fourteen fields": (
        edited(
            AIR, "FTYP 0 0 3 1|FTYP 0 0 14 1", "YFLN 0 7 10 0 0 0 0 0 0 0 0 0|YFLN 0 1 2 3 4 5 6 7 8 9 10 11 12 13"
        ), ".zmx", lambda lens: lens.max_field_deg, 13.0, 1e-15
    ),
    "fields that are not in use": (
        edited(AIR, "FTYP 0 0 3 1|FTYP 0 0 2 1"), ".zmx", lambda lens: lens.max_field_deg, 7.0, 1e-15
    ),
    "powers of an odd asphere": (
        edited(
            ZMX, "SURF 12\n  TYPE STANDARD\n|SURF 12\n  TYPE ODDASPHE\n  PARM 2 0.001\n  PARM 3 0.0002\n  PARM 5 1e-6\n"
        ), ".zmx",
        lambda lens: lens.prescription.surfaces[11].asphere, [(2, 0.001), (3, 0.0002), (5, 1e-6)], 1e-15
    ),
    "odd asphere": (
        edited(AIR, f"{STANDARD}TYPE ODDASPHE\n  PARM 3 1e-5\n  PARM 4 2e-7\n  CURV -0.02"), ".zmx",
        lambda lens: lens.prescription.surfaces[1].asphere, [(3, 1e-5), (4, 2e-7)], 1e-12
    ),
    "extended odd asphere": (
        edited(
            AIR, f"{STANDARD}TYPE XOSPHERE\n  XDAT 1 4\n  XDAT 2 0.5\n  XDAT 5 1.25e-6\n  XDAT 6 1.25e-8\n  CURV -0.02"
        ), ".zmx",
        lambda lens: lens.prescription.surfaces[1].asphere, [(3, 1e-5), (4, 2e-7)], 1e-12
    ),
    "glass by n_d and V_d": (edited(TOML, GLASSES), ".toml", n_d, 1.62041, 1e-12),
    "glass by index": (
        edited(TOML, 'glass = "SCHOTT:F2"|glass = 1.62'), ".toml", lambda lens: n_d(lens, 2), 1.62, 1e-15
    ),
    "glass by index of its table": (
        edited(TOML, 'glass = "SCHOTT:F2"|glass = { n = 1.62 }'), ".toml", lambda lens: n_d(lens, 2), 1.62, 1e-15
    ),
    "six digits of TOML": (
        edited(TOML, 'glass = "SCHOTT:F2"|glass = "517642"'), ".toml", lambda lens: n_d(lens, 2), 1.517, 1e-12
    ),
    "paraxial image height": (
        edited(AIR, "FTYP 0|FTYP 2"), ".zmx", lambda lens: focal_mm(lens) * math.tan(math.radians(lens.max_field_deg)), 10.0, 1e-9
    ),
    "fields of 0 of any kind": (
        edited(AIR, "FTYP 0|FTYP 9", "0 7 10|0 0 0"), ".zmx", lambda lens: lens.max_field_deg + 1, 1.0, 1e-15
    ),
    "factors without a field on the axis": (
        edited(FACTORS, "YFLN 0 1.7E+1|YFLN 5 1.7E+1"), ".zmx", lambda lens: 1 + lens.vignetting[0][0], 1.0, 1e-15
    ),
    "wavelengths in use": (
        edited(AIR, "WAVM 1 5.5E-1 1|WAVM 1 .55 1\nWAVM 2 .65 1"), ".zmx", lambda lens: lens.prescription.wavelengths_nm, [550.0], 1e-15
    ),
    "decentred disc of an oblique field": (
        edited(
            FACTORS, "XFLN 0 0 0|XFLN 0 0 24", "VDXN 0 0 0|VDXN 0 0 5.473246586901E-2", "3.64762539196E-1|2.0477435112E-3"
        ), ".zmx",
        lambda lens: lens.vignetting[-1][1] / math.copysign(lens.stop_semi_diameter_mm, lens._entrance_pupil_scale(588.0)[0]), 0.05473246586901 * math.sqrt(2), 1e-12
    ),
    "ellipse of the last field": (
        FACTORS, ".zmx", lambda lens: np.abs(lens.vignetting[-1]) / [1, *[lens.stop_semi_diameter_mm] * 3], [24.0, 5.473246586901e-2, 1 - 2.0477435112e-3, 1 - 3.64762539196e-1], 1e-12
    ),
    "blank glass": (
        edited(ZMX, "GLAS N-BAK1 0 0 1.572500121386|GLAS ___BLANK 1 0 1.572500121386"), ".zmx", lambda lens: n_d(lens, 1), 1.572500121386, 1e-11
    ),
    "constant glass": (
        edited(AIR, f"{BEHIND}|GLAS ___BLANK 1 0 1.5 0"), ".zmx", lambda lens: lens.prescription.surfaces[0].glass.index([300.0, 900.0]), [1.5, 1.5], 1e-15
    ),
    "six digits": (edited(AIR, f"{BEHIND}|GLAS 517642 0 0 1.5 40"), ".zmx", n_d, 1.517, 1e-12),
    "shift of a melt": (
        edited(AIR, f"{BEHIND}|GLAS N-BK7 4 0 1.5168 64.17 0 0 0 0 0.001 0"), ".zmx", n_d, 1.517800034501, 1e-11
    ),
    "glasses that print alike": (
        edited(edited(TOML, GLASSES), 'glass = "SCHOTT:F2"|glass = { n_d = 1.620410001, v_d = 60.32 }'), ".toml",
        lambda lens: n_d(lens, 2) - n_d(lens), 1e-9, 1e-5
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_a_file(name: str, tmp_path: Path) -> None:
    text, suffix, number, expected, rtol = NUMBERS[name]
    lens = load(tmp_path, text, f"lens{suffix}")
    check(name, number(lens), expected, rtol=rtol, why="digits of the file, or rounding")


def test_title_in_an_old_code_page(tmp_path: Path) -> None:
    text = edited(ZMX, "NAME Original|NAME Größe 5°").encode("latin-1")
    assert load(tmp_path, text).prescription.title.startswith("Größe 5°")


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "phone", "singlet"])
def test_packaged_lenses_have_their_names(name: str) -> None:
    assert read_prescription(name).name == name


# Notes: choices that a file leaves


F90 = (WILD / "f90.zmx").read_text()
ZOOM = (WILD / "zoom.zmx").read_text()
# name: text, options, words of the note, or "" for none
NOTES: dict[str, tuple[str, dict[str, str], str]] = {
    "60 degrees": (edited(F90, "90.5|60"), {}, ""),
    "90.5 degrees": (F90, {}, "fields to 90.5° are limited to 89°"),
    "an image height of 900 mm": (
        edited(ZMX, "FTYP 0 0 3 3|FTYP 3 0 3 3", "1.7E+1 2.4E+1|17 900"),
        {},
        "limited to 43.4°.*misses surface 9",
    ),
    "three configurations": (ZOOM, {}, "number 1, the active one. lens.configuration = 2"),
    "the second one": (edited(ZOOM, "MNUM 3 1|MNUM 3 2"), {}, "number 2, .* = 3"),
    "a term beyond": (edited(EXTENDED, "XDAT 1 3 |XDAT 1 2 "), {}, "states 2 terms; 1 beyond"),
    "a model": ((WILD / "bk7.zmx").read_text(), {"unknown_glass": "model"}, "models of the n_d"),
    "fixed sizes": ((WILD / "fixed.zmx").read_text(), {}, "semi-diameters of 2 surfaces stop no"),
    "clipping sizes": ((WILD / "fixed.zmx").read_text(), {"semi_diameters": "clip"}, ""),
    "apertures": ((WILD / "same_with_flap.zmx").read_text(), {}, ""),
    "factors": (FACTORS, {}, "its vignetting factors are used"),
    "factors beside apertures": (ZMX, {}, "not used, so that nothing is cut twice"),
    "an ellipse turned by 30°": (
        edited(FACTORS, "VANN 0 0 0|VANN 0 0 30"),
        {},
        "the fields 3 are not",
    ),
    "a turned disc": (
        edited(FACTORS, "3.64762539196E-1|2.0477435112E-3", "VANN 0 0 0|VANN 0 0 30"),
        {},
        r"\A(?![\s\S]*not used: they)[\s\S]*are used",
    ),
    "askew factors": (edited(FACTORS, "XFLN 0 0 0|XFLN 0 0 5"), {}, "the fields 3 are not used"),
}


@pytest.mark.parametrize("name", NOTES)
def test_choices_that_a_file_leaves_are_noted(name: str, tmp_path: Path) -> None:
    text, options, words = NOTES[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(tmp_path, text, **options)
    notes = [str(warning.message) for warning in caught]
    assert bool(notes) == bool(words), notes
    assert re.search(words, "\n".join(notes)), notes


def test_field_is_limited_to_the_last_tenth_of_a_degree_with_chief_rays(tmp_path: Path) -> None:
    """Of all wavelengths."""
    with pytest.warns(UserWarning, match=r"40° are limited to 31.5°, .* does not reach the stop"):
        lens = load(tmp_path, edited(TOML, "max_deg = 20.0|max_deg = 40.0"), "lens.toml")
    assert np.isfinite(lens.chief_ray(lens.max_field_deg, [480.0, 550.0, 650.0]).height_mm).all()
    with pytest.raises(PixsimError):
        lens.chief_ray([lens.max_field_deg + 0.1] * 3, [480.0, 550.0, 650.0])


# Glasses that no catalogue has


@pytest.mark.parametrize(
    ("name", "numbers"), [("bk7.zmx", "1.5168 64.2"), ("sk16_schott.zmx", "1.62041 60.3")]
)
@pytest.mark.filterwarnings("ignore:.*models of the n_d")
def test_unknown_glass_offers_the_numbers_of_its_line(
    tmp_path: Path, name: str, numbers: str
) -> None:
    """The line to write gives the lens that lens.unknown_glass = "model" gives too."""
    with pytest.raises(PixsimError, match=rf"GLAS ___BLANK 1 0 {numbers} in its place"):
        load_lens(WILD / name)
    text = re.sub(r"GLAS .*", f"GLAS ___BLANK 1 0 {numbers}", (WILD / name).read_text())
    model = load_lens(WILD / name, unknown_glass="model")
    same(load(tmp_path, text), model, 10.0, 1e-12)
    assert n_d(model) == pytest.approx(float(numbers.split()[0]), rel=1e-12)


AGF = (
    "NM {name} 2 517642 {n_d} 64.2 0 1\nCD 1.03961212 0.00600069867 0.231792344 0.0200179144 {b3}"
    " 103.560653\nLD 0.3 2.5\n"
)


def test_catalogue_of_the_user_takes_precedence(tmp_path: Path) -> None:
    path = tmp_path / "mine.agf"
    bk7 = AGF.format(name="BK7", n_d=1.5168, b3=1.01046945)
    path.write_text(bk7 + AGF.format(name="N-BK7", n_d=0, b3=0.3))
    lens = load_lens(WILD / "bk7.zmx", glass_catalogues=[path])
    assert lens.prescription.glasses[0].name == "MINE:BK7"
    check("focal length", focal_mm(lens), FOCAL_MM, atol=1e-4, why="digits")
    assert abs(focal_mm(load_lens(WILD / "air.zmx", glass_catalogues=[path])) - FOCAL_MM) > 0.05
    with pytest.warns(UserWarning, match="lens.glass_catalogues is not used"):
        load_lens("singlet", glass_catalogues=[path])
    path.write_text(bk7 + AGF.format(name="N-BK7", n_d=1.51, b3=0.3))
    with pytest.raises(PixsimError, match=r"n_d from its formula: got 1.5\d+; allowed: 1.51"):
        load_lens(WILD / "bk7.zmx", glass_catalogues=[path])


# Light that is stopped


def test_fixed_semi_diameters_clip_as_apertures_do() -> None:
    fields_deg = [0.0, 10.0, 15.0, 17.5, 20.0]
    clipped = load_lens(WILD / "fixed.zmx", semi_diameters="clip")
    wanted = load_lens(WILD / "same_with_flap.zmx").relative_illumination(fields_deg)
    got = clipped.relative_illumination(fields_deg)
    check("illumination", got, wanted, atol=1e-12, why="the same discs")
    assert wanted[3] == pytest.approx(0.082, abs=5e-4)  # .639 without


@pytest.mark.parametrize(
    ("changes", "clipping"),
    [
        (["DIAM 5.5 1|DIAM 5.5 2"], [0, 1]),  # picked up
        (["DIAM 5.5 1|DIAM 5.5 0"], []),  # automatic
        (["SURF 3\n  STOP|SURF 3\n  DIAM 1 1\n  STOP"], [0, 1]),  # the stop
        (
            [
                "SURF 4|SURF 5",
                "SURF 3\n  STOP|SURF 4\n  STOP",
                'DISZ 12\n  DIAM 5.5 1 0 0 1 ""\n|DISZ 6\n  DIAM 5.5 1\nSURF 3\n  DIAM 1 1\n'
                "  DISZ 6\n",
            ],
            [0, 1],
        ),  # a plane in air
    ],
)
def test_semi_diameters_that_clip(tmp_path: Path, changes: list[str], clipping: list[int]) -> None:
    text = edited((WILD / "fixed.zmx").read_text(), *changes)
    surfaces = load(tmp_path, text, semi_diameters="clip").prescription.surfaces
    assert [index for index, surface in enumerate(surfaces) if surface.clips] == clipping


@pytest.mark.filterwarnings("ignore:.*vignetting factors")
def test_vignetting_factors_stand_for_the_apertures_that_they_were_made_of(tmp_path: Path) -> None:
    """OpticStudio made those of the file from its clear apertures: an ellipse in the pupil for an
    intersection of discs.
    """
    factors = load(tmp_path, FACTORS)
    fields_deg = [0.0, 17.0, 24.0]
    wanted = load(tmp_path, ZMX, "apertures.zmx").relative_illumination(fields_deg)
    got = factors.relative_illumination(fields_deg)
    check("illumination", got, wanted, atol=0.03, why="an ellipse for discs")
    ignored = load(tmp_path, FACTORS, vignetting_factors="ignore")
    assert ignored.relative_illumination(24.0) > got[2] + 0.2
    assert load(tmp_path, ZMX, vignetting_factors="use").vignetting
    # The edges of the ellipse are those of the pupil: VDY ± (1 - VCY) along the field.
    edges = 0.0547324659 + (1 - 0.364762539) * np.array([-1.002, -0.998, 0.998, 1.002])
    for side in (1, -1):
        passed = factors.wavefront(side * 24.0, 587.5618, [0.0] * 4, side * edges).passed[0]
        assert passed.tolist() == [False, True, True, False]
    # Stopped down, the edges of lenses stay where they are; enlarged, they grow.
    stopped = factors.stopped_down(9.0).wavefront(24.0, 587.5618, [0.0] * 2, [-0.99, 0.99])
    assert stopped.passed.all()
    larger = float(factors.scaled(3.0).relative_illumination(24.0))
    check("of a larger lens", larger, float(got[2]), rtol=1e-6, why="the same angles")


@pytest.mark.filterwarnings("ignore:.*vignetting factors")
@pytest.mark.parametrize(
    "text",
    [
        re.sub("[XY](?=FLN)|(?<=V[DC])[XY](?=N)", lambda axis: "YX"["XY".index(axis[0])], FACTORS),
        re.sub(r"((?:YFL|VDY)N 0) (\S+) (\S+)", r"\1 -\2 -\3", FACTORS),
        # Heights of objects, with the decentres of their images.
        edited(
            re.sub(r"VDYN 0 (\S+) (\S+)", r"VDYN 0 -\1 -\2", FACTORS),
            "FTYP 0|FTYP 1",
            "DISZ INFINITY|DISZ 1E10",
            *(
                f"{angle}|{1e10 * math.tan(math.radians(float(angle)))!r}"
                for angle in ("1.7E+1", "2.4E+1")
            ),
        ),
    ],
    ids=["along x", "negative", "object heights"],
)
def test_vignetting_factors_turn_with_the_field(text: str, tmp_path: Path) -> None:
    wanted = load(tmp_path, FACTORS).vignetting
    check("ellipses", load(tmp_path, text).vignetting, wanted, rtol=1e-12, why="rounding")


# Configurations

OPERANDS = """MNUM 2 1
MOFF 0 1 "" 0 0 0
MOFF 0 2 "" 0 0 0
APER 0 1 4 0 0
APER 0 2 5.6 0 0
XFIE 1 1 0 0 0
XFIE 1 2 9 0 0
YFIE 3 1 10 0 0
YFIE 3 2 12 0 0
WAVE 1 1 0.55 0 0
WAVE 1 2 0.55 0 0
THIC 0 1 1E10 0 0
THIC 0 2 1E10 0 0
THIC 1 1 5 0 0
THIC 1 2 6 0 0
FLWT 1 1 1 0 0
FLWT 1 2 0 0 0
"""
TWO = AIR + "MNUM 2 1\nTHIC 1 1 5\nTHIC 1 2 6\nYFIE 3 1 10\nYFIE 3 2 12\n"
ACTIVE = edited(ZOOM, "MNUM 3 1|MNUM 3 2", "DISZ 46.5|DISZ 60.0")
# text, configuration, number of the lens, expected
CONFIGURATIONS = [
    *((ZOOM, number, thickness_mm, mm) for number, mm in ((1, 46.5), (2, 60.0), (3, 80.0))),
    (TWO.replace("  DISZ 5\n", ""), 2, lambda lens: thickness_mm(lens, 0), 6.0),
    (ACTIVE, 1, thickness_mm, 46.5),
    (ACTIVE, 2, thickness_mm, 60.0),
    *(
        (text + OPERANDS, configuration, number, expected)
        for text in (AIR, UNINDENTED + "\n")
        for configuration, number, expected in (
            (1, f_number, 4.0),
            (2, f_number, 5.6),
            (2, lambda lens: lens.max_field_deg, 12.0),
            (2, lambda lens: thickness_mm(lens, 0), 6.0),
        )
    ),
    (
        edited(AIR, "DISZ 46.5|DISZ 47.3\n  MAZH 0 0") + "MNUM 2 1\nTHIC 1 1 5\nTHIC 1 2 6\n",
        2,
        lambda lens: thickness_mm(lens) - lens.first_order(550.0).back_focal_length_mm,
        0.0,
    ),
]


@pytest.mark.parametrize(("text", "number", "measure", "expected"), CONFIGURATIONS)
def test_configuration_sets_its_operands(tmp_path, text, number, measure, expected) -> None:
    lens = load(tmp_path, text, configuration=number)
    check("number", measure(lens), expected, rtol=1e-12, atol=1e-10, why="rounding")


# Files that are refused

F2 = 'glass = "SCHOTT:F2"|glass = '
GLAS = "GLAS N-BAK1 0 0 1.572500121386"
CURV = "CURV 7.061398863114783100E-002"
DISTANCE = "DISZ INFINITY|DISZ 150"
# name of the file, text, options, words
REFUSED: list[tuple[str, str, dict, str]] = [
    *(
        ("lens.toml", edited(TOML, change), {}, words)
        for change, words in [
            (f'{F2}"SCHOTT:F2_MOLD"', r"surface 3 \(line 44\): glass: .*'SCHOTT:F2_MOLD'"),
            (f'{F2}"mirror"', "'MIRROR', a mirror"),
            (f"{F2}0.5", "glass: got 0.5"),
            (f"{F2}{{ n_d = 1.6 }}", "exactly one of"),
            (f"{F2}{{ n = 1.6, n_d = 1.6, v_d = 60 }}", "exactly one of"),
            (f"{F2}{{ formula = 1, coefficients = [0.0] }}", "coefficients of glass"),
            (f"{F2}{{ formula = 1, coefficients = [0.0, 1e-320, 0.01] }}", "coefficients"),
            (f"{F2}{{ formula = 1, coefficients = [0.0, 1e300, 0.01] }}", "surface 3"),
            (f"{F2}{{ formula = 4, coefficients = [0.0, 0, 1.0] }}", "coefficients of glass"),
            (
                f"{F2}{{ formula = 1, coefficients = [0, 1, 1], range_um = [2, 1] }}",
                "range_um of glass",
            ),
            ("stop_surface = 4|stop_surface = 9", "stop of .*: got surfaces 4, 9"),
            ("object_distance_mm = inf|object_distance_mm = -500", "object of .*: got -500 mm"),
            ("conic = 0.0|conic = nan", r"surface 1 \(line 26\): conic"),
            ("conic = 0.0|conics = 0.0", r"surface 1 \(line 26\): .*unknown name; .*'conic'"),
            ("conic = 0.0|asphere = { A1 = 0.1 }", "A1 = 0.1; .*cone"),
            ("conic = 0.0|asphere = { A4 = 9e-40 }", "asphere: got A4 = 9e-40"),
            ("conic = 0.0|asphere = { A4 = 1e-300 }", "asphere: got A4 = 1e-300"),
            ("conic = 0.0|asphere = { B4 = 0.1 }", "asphere: got a term"),
            (
                "thickness_mm = 3.25896|thickness_mm = -3.259",
                "thickness_mm: got -3.259 in the glass",
            ),
            ("radius_mm = 22.01359|radius_mm = 23.0", "radius_mm: got 23, with curvature_per_mm"),
            ("radius_mm = 22.01359|radius_mm = 1e-9", "radius_mm: got 1e-09"),
            ("value_mm = 10.0|", "aperture.value_mm: got none"),
            ('units = "mm"|units = "in"', "units: got"),
            ("values = [0.48, 0.55, 0.5875618, 0.65]|values = []", "wavelengths"),
            (
                "curvature_per_mm = 0.045426484276303865\nradius_mm = 22.01359|",
                "curvature_per_mm and radius_mm: got neither",
            ),
            ("max_deg = 20.0|max_deg = 195.0", "fields.max_deg: got 195"),
        ]
    ),
    *(
        ("lens.zmx", edited(ZMX, change), {}, words)
        for change, words in [
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
    ),
    *(
        ("lens.zmx", edited(text, change), {}, words)
        for text, change, words in [
            (
                AIR,
                "DISZ INFINITY|GLAS SEAWATER 0 0 1.334 55.8\n  DISZ INFINITY",
                "medium 'SEAWATER'",
            ),
            ((WILD / "water.zmx").read_text(), "|", "medium n_d 1.334, V_d 55.8"),
            (AIR, "CURV 0.02|CURV -0.03", "no real image: virtual"),
            (AIR, DISTANCE.replace("150", "30"), "no real image: a back focal length of -"),
            ((WILD / "hang.zmx").read_text(), "|", "no real image: afocal"),
            ((WILD / "kepler_140.9.zmx").read_text(), "|", r"afocal, .* at f/1\.1e\+04"),
            (edited(AIR, DISTANCE), "FTYP 0 0 3 1|FTYP 1 1 3 1", "telecentric object space"),
            (AIR, "N-BK7 0 0 1.5168 64.17|517000 0", "unknown glass '517000'"),
            (
                AIR,
                "N-BK7 0 0 1.5168 64.17|SCHOTT:N-BK7 4 0 0 0 0 0 0 0 0 -64.1673362374998",
                "shift of glass 'SCHOTT:N-BK7'",
            ),
            (edited(AIR, '  DIAM 1.0E+1 0 0 0 1 ""\n|'), "FNUM 4 0|FLOA", "FLOA, but no DIAM"),
            (AIR, "DISZ INFINITY|DISZ 1e-40", "object of .*: got 1e-40"),
            (AIR, "FNUM 4 0|FNUM 1e-40 1", "aperture of .*: got 1e-40"),
            (edited(AIR, DISTANCE), "FNUM 4 0|OBNA 1e-40 0", "aperture of .*: got 1e-40"),
            (AIR, "YFLN|VCYN -1e300\nYFLN", "vignetting factors of field 1"),
            *(
                (AIR, f"DISZ 46.5|DISZ 46.5\n  {kind} {value}", "semi_diameter_mm: got")
                for kind in ("DIAM",)
                for value in ("1e-40", "1e300")
            ),
            (AIR, f"{BEHIND}|GLAS N-BK7 4 0 0 0 0 0 0 0 -0.52 0", "shift of glass .*above 1"),
            (EXTENDED.replace("XDAT", "XDUT"), "|", "XASPHERE without XDAT"),
            (EXTENDED, "  XDAT 1 3|  PARM 2 2.5E-06\n  XDAT 1 3", "in both PARM and XDAT"),
            (EXTENDED, "XDAT 2 1 |XDAT 2 0 ", "normalisation radius: got 0"),
            (EXTENDED, "XDAT 2 1 |XDAT 2 1e-200 ", "A4 = inf"),
        ]
    ),
    *(
        ("lens.zmx", edited(text, change), {"configuration": number}, words)
        for text, change, number, words in [
            (AIR, "|", 2, r"lens\.configuration: got 2; allowed: 1"),
            (TWO, "|", 3, r"lens\.configuration: got 3; allowed: 1 to 2"),
            (
                TWO + "CRVT 2 1 1\nCRVT 2 2 3\nPRES 0 1 1\nPRES 0 2 1\n",
                "|",
                2,
                r"got CRVT 2 \(line \d+\);",
            ),
            (TWO, "THIC 1 2|THIC 9 2", 2, "THIC: got surface 9"),
            (TWO, "YFIE 3 2|YFIE 999 2", 2, "YFIE: got field 999"),
            (TWO, "YFIE 3 2 12|YFIE 3 2 x", 2, "YFIE: got .* a finite number"),
            *(
                (TWO, f"DISZ 46.5|DISZ 46.5\n  {solve}", 2, f"the solve {solve} of a thickness")
                for solve in ("MAZH 0 0.7", "TCOM 1 51.5", "TOLE 1 51.5")
            ),
            (
                edited(TWO + "APER 0 1 4\nAPER 0 2 5\n", "FNUM 4 0|FLOA\n"),
                "DISZ 5\n|DISZ 5\n  DIAM 3\n",
                2,
                "APER: got",
            ),
        ]
    ),
    # Unknown glasses, with the numbers of their lines, and surfaces that are not traced: all at once.
    *(
        (name, text, {}, words)
        for name, text, words in [
            (
                "lens.zmx",
                edited(ZMX, "GLAS N-BAK1 0|GLAS OLD1 0", "GLAS N-BALF4 0|GLAS OLD2 0"),
                r"'OLD1'.*GLAS ___BLANK 1 0 1\.5\d+(.*\n)+.*'OLD2'",
            ),
            (
                "lens.toml",
                edited(TOML, 'glass = "HIKARI:SK16"|glass = "OLD1"', f'{F2}"OLD2"'),
                r"'OLD1'(.*\n)+.*'OLD2'",
            ),
            (
                "lens.zmx",
                edited(
                    AIR,
                    "  STOP\n  TYPE STANDARD|  STOP\n  TYPE TOROIDAL",
                    "GLAS N-BK7|GLAS MIRROR",
                    "CURV -0.02|CURV 0",
                    "SURF 2\n  TYPE STANDARD|SURF 2\n  TYPE COORDBRK\n  PARM 1 .5",
                ),
                r"TOROIDAL.*\n.*MIRROR.*\n.*decentre x 0.5",
            ),
        ]
    ),
    ("lens.zmx", "a text that says nothing\n", {}, "SURF"),
    ("lens.toml", "a text that says nothing\n", {}, "TOML"),
    ("lens.zmx", BEFORE, {}, "1 surfaces"),
    ("lens.zmx", BEFORE + "".join(f"SURF {number}\n" for number in range(1, 210)), {}, "more surf"),
    ("lens.zos", "", {}, "File, Save As"),
    ("lens.zar", "", {}, "an archive"),
    ("lens.seq", "", {}, "CODE V"),
    ("lens.LEN", "", {}, "CODE V or OSLO"),
    ("lens.agf", "", {}, "lens.glass_catalogues"),
    # Other programs take a neighbour, an n_d of 1.5, or a fit; these lines state no numbers.
    ("lens.zmx", (DATA / "US08427765-1.ZMX").read_text(), {}, "unknown glass 'L-TIM28_MOLD'"),
    *(
        (
            "lens.zmx",
            UTF16,
            {"unknown_glass": unknown},
            r"surface 2.*'BK7'.*no n_d and V_d(.*\n)+.*surface 4",
        )
        for unknown in ("error", "model")
    ),
]


@pytest.mark.parametrize(("name", "text", "options", "words"), REFUSED)
@pytest.mark.filterwarnings("ignore")
def test_files_are_refused_by_their_cause(name, text, options, words, tmp_path: Path) -> None:
    with pytest.raises(PixsimError, match=words):
        load(tmp_path, text, name, **options)


@pytest.mark.parametrize("name", ["lens.zmx", "lens.toml"])
def test_files_that_are_no_prescription(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with pytest.raises(PixsimError, match="does not exist"):
        load_lens(path)
    path.write_bytes(np.random.default_rng(0).bytes(4096))
    with pytest.raises(PixsimError, match=r"binary|UTF-8"):
        load_lens(path)
    os.truncate(path, 100 << 20)
    with pytest.raises(PixsimError, match="of 104857600 bytes"):
        load_lens(path)


# Bounds of numbers with a meaning: operations on denormal numbers take very long

USUAL = {
    "enpd": "10",
    "yfln": "5",
    "um": "0.55",
    "curvature": "0.01",
    "conic": "0",
    "thickness": "5",
    "back": "90",
    "v_d": "64.17",
}
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


@pytest.mark.parametrize("name", USUAL)
def test_numbers_without_a_meaning(name: str, tmp_path: Path) -> None:
    for tiny in ("1e-320", "1e-40", "1e300"):
        with pytest.raises(PixsimError, match=r"allowed: .*([0-9]|finite)"):
            load(tmp_path, TEMPLATE.format(**USUAL | {name: tiny}))
    assert focal_mm(load(tmp_path, TEMPLATE.format(**USUAL))) > 0


# Catalogues of glasses


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
    text = "CC a catalogue\nNM GLASS1 2 0 1.5162 64.2\nCD 1.04 0.006 0.23 0.02 1 103\nLD 0.35 2\n"
    (tmp_path / "mine.agf").write_text(edited(text, change))
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
    """Of n_d 1.8830 and V_d 40.76, to 5e-4 and 1 %."""
    with pytest.warns(UserWarning, match=r"'S-LAH58' is taken from OHARA:S-LAH58; .*\(MINE\)"):
        glass = find_glass("S-LAH58", "x", makers=["MINE"], numbers=(1.8834, 41.1))
    assert glass.name == "OHARA:S-LAH58"
    for numbers in ((1.8836, 40.8), (1.883, 40.3)):
        with pytest.raises(PixsimError, match=r"catalogues that the file names \(MINE\)"):
            find_glass("S-LAH58", "x", makers=["MINE"], numbers=numbers)
