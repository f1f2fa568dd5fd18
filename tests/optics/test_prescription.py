"""Prescriptions from files: the same lens from each format, unit and encoding, and every number
of a file where it belongs. What is refused stands in test_refusals.py.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.claims import check

import pixsim
from pixsim.base.toml import packaged
from pixsim.optics.lens import Lens
from pixsim.optics.prescription import read_prescription

DATA = Path(__file__).parents[1] / "data" / "lenses"
WILD = DATA / "wild"
TOML = packaged("data/lenses")["cooke_triplet"].read_text()
ZMX = (DATA / "US00583336-2-scaled.zmx").read_text()
UTF16 = (DATA / "zmax_55278.zmx").read_bytes().decode("utf-16")
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


def load(folder: Path, text: str | bytes, name: str = "lens.zmx", **options: Any) -> Lens:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return pixsim.load_lens(path, **options)


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
FROM_1 = AIR[AIR.index("SURF 1\n") :]
NULL = (
    "DISZ 5\n  GLAS N-BK7 0 0 1.5168 64.17\n|DISZ 2\n  GLAS N-BK7 0 0 1.5168 64.17\nSURF 2\n"
    "  TYPE COORDBRK\n  PARM 1 0\n  PARM 6 1\n  DISZ 3\n"
)
OLD_LISTS = ["WAVL 4.861327E-1 5.875618E-1 6.562725E-1", "XFLD 0 0 0", "YFLD 0 17 24"]
OLD_LISTS.append(without_lines(ZMX, "WAVM", "XFLN", "YFLN", "FTYP"))
PUPIL = 'type = "entrance_pupil_diameter"\nvalue_mm = 10.0|type = "f_number"'
AIR_TEXTS: dict[str, str | bytes] = {
    "unindented": UNINDENTED,
    "all indented": "\n".join(f"  {line}" for line in AIR.splitlines()),
    "tabs": AIR.replace("  ", "\t"),
    "small letters": edited(AIR, "SURF|Surf", "  CURV|  curv", "TYPE STANDARD|TYPE Standard"),
    "surfaces first": AIR[AIR.index("SURF 0") :] + AIR[: AIR.index("SURF 0")],
    "surfaces first, unindented": (
        UNINDENTED[UNINDENTED.index("SURF 0") :] + "\n" + UNINDENTED[: UNINDENTED.index("SURF 0")]
    ),
    "surfaces in another order": (
        BEFORE[: BEFORE.index("SURF 0")] + FROM_1 + BEFORE[BEFORE.index("SURF 0") :]
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
    "null coordinate break in glass": edited(AIR, "SURF 3|SURF 4", "SURF 2\n|SURF 3\n", NULL),
}
# name: text, name of the file, file of the same lens, field in degrees, gate in waves
SAME: dict[str, tuple[str | bytes, str, str, float, float]] = {
    **{name: (text, "lens.zmx", "wild/air.zmx", 10.0, 1e-9) for name, text in AIR_TEXTS.items()},
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
    "older lists": ("\n".join(OLD_LISTS), "lens.zmx", "US00583336-2-scaled.zmx", 24.0, 1e-7),
    "glasses of the catalogue": (
        TOML[: TOML.index("[glass.")], "lens.toml", "cooke_triplet", 20.0, 1e-7
    ),
    "radii and f-number": (
        edited(without_lines(TOML, "curvature_per_mm"), PUPIL), "lens.toml", "cooke_triplet", 20.0, 1e-7
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
    same(lens, pixsim.load_lens(path if path.exists() else reference), field_deg, waves)


@pytest.mark.parametrize(
    ("unit", "size_mm"), [("CM", 10.0), ("IN", 25.4), ("INCHES", 25.4), ("METER", 1000.0)]
)
def test_unit_scales_all_lengths(tmp_path: Path, unit: str, size_mm: float) -> None:
    """Also the asphere's terms, which scale with powers of the unit."""
    scaled = load(tmp_path, ASPHERE).scaled(size_mm)
    lens = load(tmp_path, edited(ASPHERE, f"UNIT MM|UNIT {unit}"), "other.zmx")
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


def stop_height_mm(lens: Lens) -> float:
    """Return the paraxial height in the stop of a ray from the edge of the entrance pupil."""
    return abs(lens._entrance_pupil_scale(lens.primary_nm)[0]) * lens.entrance_pupil_diameter_mm / 2


def thickness_mm(lens: Lens, surface: int = -1) -> float:
    return lens.prescription.surfaces[surface].thickness_mm


def near(field: str = "0 0 3 1 0 0 0", aperture: str = "FNUM 4 0") -> str:
    """Return the lens with its object at 150 mm; its stop and entrance pupil are in front."""
    changes = ["DISZ INFINITY|DISZ 150", "DISZ 46.5|DISZ 70", f"FNUM 4 0|{aperture}"]
    return edited(AIR, *changes, f"FTYP 0 0 3 1 0 0 0|FTYP {field}")


BEHIND = "GLAS N-BK7 0 0 1.5168 64.17"
ODD = "SURF 12\n  TYPE ODDASPHE\n  PARM 2 0.001\n  PARM 3 0.0002\n  PARM 5 1e-6\n"
ODD_AIR = "TYPE ODDASPHE\n  PARM 3 1e-5\n  PARM 4 2e-7"
XO = "TYPE XOSPHERE\n  XDAT 1 4\n  XDAT 2 0.5\n  XDAT 5 1.25e-6\n  XDAT 6 1.25e-8"
STANDARD = "TYPE STANDARD\n  CURV -0.02|"
FAR = ["DISZ INFINITY|DISZ 1E10", "FTYP 0|FTYP 1", "0 7 10|0 7E8 1E9"]
MANY = f"YFLN 0 7 10 0 0 0 0 0 0 0 0 0|YFLN {' '.join(map(str, range(14)))}"
GLASSES = 'glass = "HIKARI:SK16"|glass = {{ n_d = 1.62041, v_d = 60.32 }}'.replace(
    "{{", "{"
).replace("}}", "}")
# name: text, name of the file, number of the lens, expected, relative tolerance
NUMBERS: dict[str, tuple[str, str, Callable[[Lens], Any], Any, float]] = {
    "focal length": (AIR, ".zmx", focal_mm, FOCAL_MM, 2e-6),
    "largest angle": (ZMX, ".zmx", lambda lens: lens.max_field_deg, 24.0, 1e-15),
    "real image height": (
        ASPHERE, ".zmx", lambda lens: lens.chief_ray(lens.max_field_deg, lens.primary_nm).height_mm, 13.6, 1e-9
    ),
    "entrance pupil": (edited(ZMX, "FNUM 4.5 0|ENPD 10.975328"), ".zmx", f_number, 4.5, 1e-5),
    "f-number": (ZMX, ".zmx", f_number, 4.5, 1e-12),
    "size of the stop": (edited(ZMX, "FNUM 4.5 0|FLOA"), ".zmx", stop_height_mm, 4.215, 1e-6),
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
        edited(AIR, *FAR), ".zmx", lambda lens: math.tan(math.radians(lens.max_field_deg)), 0.1, 1e-9
    ),
    "object distance of TOML": (
        edited(TOML, "object_distance_mm = inf|object_distance_mm = 500"), ".toml", lambda lens: lens.object_distance_mm, 511.512158674, 1e-10
    ),
    "fourteen fields": (
        edited(AIR, "FTYP 0 0 3 1|FTYP 0 0 14 1", MANY), ".zmx", lambda lens: lens.max_field_deg, 13.0, 1e-15
    ),
    "powers of an odd asphere": (
        edited(ZMX.replace("\r\n", "\n"), f"SURF 12\n  TYPE STANDARD\n|{ODD}"), ".zmx",
        lambda lens: lens.prescription.surfaces[11].asphere, [(2, 0.001), (3, 0.0002), (5, 1e-6)], 1e-15
    ),
    "odd asphere": (
        edited(AIR, f"{STANDARD}{ODD_AIR}\n  CURV -0.02"), ".zmx",
        lambda lens: lens.prescription.surfaces[1].asphere, [(3, 1e-5), (4, 2e-7)], 1e-12
    ),
    "extended odd asphere": (
        edited(AIR, f"{STANDARD}{XO}\n  CURV -0.02"), ".zmx",
        lambda lens: lens.prescription.surfaces[1].asphere, [(3, 1e-5), (4, 2e-7)], 1e-12
    ),
    "glass by n_d and V_d": (edited(TOML, GLASSES), ".toml", n_d, 1.62041, 1e-12),
    "glass by index": (
        edited(TOML, 'glass = "SCHOTT:F2"|glass = 1.62'), ".toml", lambda lens: n_d(lens, 2), 1.62, 1e-15
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


def test_packaged_lenses_have_their_names() -> None:
    for name in ("cooke_triplet", "double_gauss", "phone", "singlet"):
        assert read_prescription(name).name == name


# Notes: choices that a file leaves


def notes_of(call: Callable[[], object]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in caught]


F90 = (WILD / "f90.zmx").read_text()
ZOOM = (WILD / "zoom.zmx").read_text()
REAL = [ZMX.replace("FTYP 0 0 3 3", "FTYP 3 0 3 3").replace("1.7E+1 2.4E+1", "17 900")]
APERTURES = re.compile(r"  FLAP .*\n")
FACTORS = APERTURES.sub("", ZMX.replace("\r\n", "\n"))
# name: text, options, words of the note, or "" for none
NOTES: dict[str, tuple[str, dict[str, str], str]] = {
    "60 degrees": (edited(F90, "90.5|60"), {}, ""),
    "90.5 degrees": (F90, {}, "fields to 90.5° are limited to 89°"),
    "an image height of 900 mm": (REAL[0], {}, "limited to 43.4°.*misses surface 9"),
    "three configurations": (ZOOM, {}, "number 1, the active one. lens.configuration = 2"),
    "the second one": (edited(ZOOM, "MNUM 3 1|MNUM 3 2"), {}, "number 2, .* = 3"),
    "a term beyond": (edited(EXTENDED, "XDAT 1 3 |XDAT 1 2 "), {}, "states 2 terms; 1 beyond"),
    "a model": ((WILD / "bk7.zmx").read_text(), {"unknown_glass": "model"}, "models of the n_d"),
    "fixed sizes": ((WILD / "fixed.zmx").read_text(), {}, "semi-diameters of 2 surfaces stop no"),
    "clipping sizes": ((WILD / "fixed.zmx").read_text(), {"semi_diameters": "clip"}, ""),
    "apertures": ((WILD / "same_with_flap.zmx").read_text(), {}, ""),
    "factors": (FACTORS, {}, "its vignetting factors are used"),
    "factors beside apertures": (ZMX, {}, "not used, so that nothing is cut twice"),
    "askew factors": (edited(FACTORS, "XFLN 0 0 0|XFLN 0 0 5"), {}, "the fields 3 are not used"),
}


@pytest.mark.parametrize("name", NOTES)
def test_choices_that_a_file_leaves_are_noted(name: str, tmp_path: Path) -> None:
    text, options, words = NOTES[name]
    notes = notes_of(lambda: load(tmp_path, text, **options))
    assert bool(notes) == bool(words), notes
    assert re.search(words, "\n".join(notes)), notes


def test_field_is_limited_to_the_last_tenth_of_a_degree_with_chief_rays(tmp_path: Path) -> None:
    """Of all wavelengths."""
    with pytest.warns(UserWarning, match=r"fields to 40° are limited to 31.5°"):
        lens = load(tmp_path, edited(TOML, "max_deg = 20.0|max_deg = 40.0"), "lens.toml")
    assert np.isfinite(lens.chief_ray(lens.max_field_deg, [480.0, 550.0, 650.0]).height_mm).all()
    with pytest.raises(pixsim.PixsimError):
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
    with pytest.raises(pixsim.PixsimError, match=rf"GLAS ___BLANK 1 0 {numbers} in its place"):
        pixsim.load_lens(WILD / name)
    text = re.sub(r"GLAS .*", f"GLAS ___BLANK 1 0 {numbers}", (WILD / name).read_text())
    model = pixsim.load_lens(WILD / name, unknown_glass="model")
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
    lens = pixsim.load_lens(WILD / "bk7.zmx", glass_catalogues=[path])
    assert lens.prescription.glasses[0].name == "MINE:BK7"
    check("focal length", focal_mm(lens), FOCAL_MM, atol=1e-4, why="digits")
    other = pixsim.load_lens(WILD / "air.zmx", glass_catalogues=[path])
    assert abs(focal_mm(other) - FOCAL_MM) > 0.05
    with pytest.warns(UserWarning, match="lens.glass_catalogues is not used"):
        pixsim.load_lens("singlet", glass_catalogues=[path])
    path.write_text(bk7 + AGF.format(name="N-BK7", n_d=1.51, b3=0.3))
    with pytest.raises(
        pixsim.PixsimError, match=r"n_d from its formula: got 1.5\d+; allowed: 1.51"
    ):
        pixsim.load_lens(WILD / "bk7.zmx", glass_catalogues=[path])


# Light that is stopped


def test_fixed_semi_diameters_clip_as_apertures_do() -> None:
    fields_deg = [0.0, 10.0, 15.0, 17.5, 20.0]
    clipped = pixsim.load_lens(WILD / "fixed.zmx", semi_diameters="clip")
    wanted = pixsim.load_lens(WILD / "same_with_flap.zmx").relative_illumination(fields_deg)
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
@pytest.mark.parametrize("name", ["along x", "negative"])
def test_vignetting_factors_turn_with_the_field(name: str, tmp_path: Path) -> None:
    text = re.sub(r"YFLN 0 (\S+) (\S+)", r"YFLN 0 -\1 -\2", FACTORS)
    text = re.sub(r"VDYN 0 (\S+) (\S+)", r"VDYN 0 -\1 -\2", text)
    if name == "along x":
        letters = {"XFLN": "YFLN", "VDXN": "VDYN", "VCXN": "VCYN"}
        letters |= {other: letter for letter, other in letters.items()}
        text = re.sub("[XY]FLN|V[DC][XY]N", lambda match: letters[match[0]], FACTORS)
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
SOLVED = edited(AIR, "DISZ 46.5|DISZ 47.3\n  MAZH 0 0") + "MNUM 2 1\nTHIC 1 1 5\nTHIC 1 2 6\n"
ACTIVE = edited(ZOOM, "MNUM 3 1|MNUM 3 2", "DISZ 46.5|DISZ 60.0")
# text, configuration, number of the lens, expected
CONFIGURATIONS = [
    *((ZOOM, number, thickness_mm, mm) for number, mm in ((1, 46.5), (2, 60.0), (3, 80.0))),
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
        SOLVED,
        2,
        lambda lens: thickness_mm(lens) - lens.first_order(550.0).back_focal_length_mm,
        0.0,
    ),
]


@pytest.mark.parametrize(("text", "number", "measure", "expected"), CONFIGURATIONS)
def test_configuration_sets_its_operands(tmp_path, text, number, measure, expected) -> None:
    lens = load(tmp_path, text, configuration=number)
    check("number", measure(lens), expected, rtol=1e-12, atol=1e-10, why="rounding")
