"""Prescriptions from files: the same lens from each format, unit and encoding; what is not traced
is refused where it stands.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.base.toml import packaged
from pixsim.optics.prescription import read_prescription

DATA = Path(__file__).parents[1] / "data" / "lenses"
TOML = packaged("data/lenses")["cooke_triplet"].read_text()
ZMX = (DATA / "US00583336-2-scaled.zmx").read_text()
UTF16 = (DATA / "zmax_55278.zmx").read_bytes().decode("utf-16")
POINTS = np.array([0.0, 0.3, -0.8]), np.array([0.9, -0.5, 0.1])


def load(tmp_path: Path, text: str | bytes, name: str = "lens.zmx") -> pixsim.optics.lens.Lens:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return pixsim.load_lens(path)


def same(
    one: pixsim.optics.lens.Lens, other: pixsim.optics.lens.Lens, field: float, gate: float = 1e-7
) -> None:
    """Two lenses with the same wavefront."""
    for wavelength in (486.1327, 656.2725):
        assert one.opd_waves(field, wavelength, *POINTS) == pytest.approx(
            other.opd_waves(field, wavelength, *POINTS), abs=gate
        )
    assert one.primary_nm == pytest.approx(other.primary_nm, rel=1e-6)


def test_zmx_is_the_lens_of_its_toml() -> None:
    zmx, toml = (
        pixsim.load_lens(str(DATA / name))
        for name in ("US00583336-2-scaled.zmx", "double_gauss_us583336.toml")
    )
    same(zmx, toml, 24.0, 1e-6)
    assert zmx.max_field_deg == 24.0
    assert zmx.first_order(587.5618).f_number == pytest.approx(4.5, rel=1e-12)
    assert [surface.semi_diameter_mm for surface in zmx.prescription.surfaces if surface.clips] == [
        surface.semi_diameter_mm for surface in toml.prescription.surfaces if surface.clips
    ]


def test_aspheric_zmx_is_the_lens_of_its_toml(tmp_path: Path) -> None:
    """With the moulded glass replaced by the one of the TOML, which its reader does not do by
    itself.
    """
    text = (
        (DATA / "US08427765-1.ZMX")
        .read_text()
        .replace("L-TIM28_MOLD", "L-TIM28")
        .replace("RPO HOYA", "RPO HOYA OHARA")
    )
    zmx, toml = load(tmp_path, text), pixsim.load_lens(str(DATA / "asphere_us8427765.toml"))
    same(zmx, toml, 12.0, 1e-6)
    # The file's fields are real image heights, the largest of 13.6 mm.
    assert zmx.chief_ray(zmx.max_field_deg, zmx.primary_nm).height_mm == pytest.approx(
        13.6, rel=1e-9
    )


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8", "utf-8-sig"])
def test_encodings_of_zmx_are_read(tmp_path: Path, encoding: str) -> None:
    text = UTF16.replace("GLAS BK7", "GLAS N-BK7")
    lens = load(tmp_path, text.encode(encoding))
    same(lens, pixsim.load_lens(str(DATA / "achromat_pair_55278.toml")), 0.0, 1e-6)


def test_old_code_page_may_stand_in_comments(tmp_path: Path) -> None:
    assert load(
        tmp_path, ZMX.replace("NAME Original", "NAME Größe 5°").encode("latin-1")
    ).prescription.title.startswith("Größe 5°")


@pytest.mark.parametrize(
    ("unit", "size_mm"), [("CM", 10.0), ("IN", 25.4), ("INCHES", 25.4), ("METER", 1000.0)]
)
def test_unit_of_zmx_is_obeyed(tmp_path: Path, unit: str, size_mm: float) -> None:
    """Also for the asphere's terms, which scale with powers of the unit."""
    text = (
        (DATA / "US08427765-1.ZMX")
        .read_text()
        .replace("L-TIM28_MOLD", "L-TIM28")
        .replace("RPO HOYA", "RPO HOYA OHARA")
    )
    lens, other = (
        load(tmp_path, text),
        load(tmp_path, text.replace("UNIT MM", f"UNIT {unit}"), "other.zmx"),
    )
    scaled = lens.scaled(size_mm)
    assert other.first_order(550.0).focal_length_mm == pytest.approx(
        size_mm * lens.first_order(550.0).focal_length_mm, rel=1e-12
    )
    assert other.opd_waves(10.0, 550.0, *POINTS) == pytest.approx(
        scaled.opd_waves(10.0, 550.0, *POINTS), abs=1e-5
    )
    assert other.max_field_deg == pytest.approx(lens.max_field_deg, rel=1e-9)


def test_odd_asphere_of_zmx_has_the_powers_of_r(tmp_path: Path) -> None:
    asphere = "TYPE ODDASPHE\n  PARM 2 0.001\n  PARM 3 0.0002\n  PARM 5 1e-6"
    head, _, rest = ZMX.partition("SURF 12")
    lens = load(tmp_path, head + "SURF 12" + rest.replace("TYPE STANDARD", asphere, 1))
    assert lens.prescription.surfaces[11].asphere == ((2, 0.001), (3, 0.0002), (5, 1e-6))
    assert lens.prescription.surfaces[11].paraxial_curvature_per_mm == pytest.approx(
        -0.0706139886 + 0.002
    )


def test_lists_of_older_zmx_files_are_read(tmp_path: Path) -> None:
    """WAVL, XFLD and YFLD, without the places that later versions keep free."""
    lines = [
        line
        for line in ZMX.splitlines()
        if line.split()[:1] not in (["WAVM"], ["XFLN"], ["YFLN"], ["FTYP"])
    ]
    head = ["WAVL 4.861327E-1 5.875618E-1 6.562725E-1", "XFLD 0 0 0", "YFLD 0 17 24"]
    same(
        load(tmp_path, "\n".join([*head, *lines])),
        pixsim.load_lens(str(DATA / "US00583336-2-scaled.zmx")),
        24.0,
    )
    assert load(tmp_path, "\n".join([*head, *lines])).max_field_deg == 24.0


@pytest.mark.parametrize(
    ("aperture", "f_number"),
    [("ENPD 10.975328", 4.5), ("FNUM 4.5 0", 4.5), ("FLOA", 10.9753 / 2 * 4.5 / 4.215 * 0.8717)],
)
def test_apertures_of_zmx(tmp_path: Path, aperture: str, f_number: float) -> None:
    lens = load(tmp_path, ZMX.replace("FNUM 4.5 0", aperture))
    if (
        aperture == "FLOA"
    ):  # the stop's semi-diameter of the file fills an entrance pupil of its paraxial image
        scale, _ = lens._entrance_pupil_scale(lens.primary_nm)
        assert abs(scale) * lens.entrance_pupil_diameter_mm / 2 == pytest.approx(4.215, rel=1e-6)
    else:
        assert lens.first_order(lens.primary_nm).f_number == pytest.approx(f_number, rel=1e-5)


def test_glass_by_abbe_number_or_index(tmp_path: Path) -> None:
    """In both formats the same approximation of n_d and V_d."""
    zmx = load(
        tmp_path, ZMX.replace("GLAS N-BAK1 0 0 1.572500121386", "GLAS ___BLANK 1 0 1.572500121386")
    )
    assert "approximation" in zmx.prescription.surfaces[1].glass.source
    inline = TOML.replace(
        'glass = "HIKARI:SK16"', "glass = { n_d = 1.62041, v_d = 60.32 }"
    ).replace('"SCHOTT:F2"', "1.62", 1)
    toml = load(tmp_path, inline, "lens.toml")
    assert toml.prescription.surfaces[0].glass.index(587.5618) == pytest.approx(1.62041, rel=1e-12)
    assert any(surface.glass.index(500.0) == 1.62 for surface in toml.prescription.surfaces)


def test_glasses_without_names_are_kept_apart(tmp_path: Path) -> None:
    """Two that print alike are two glasses."""
    inline = TOML.replace('glass = "HIKARI:SK16"', "glass = { n_d = 1.62041, v_d = 60.32 }", 1)
    inline = inline.replace('glass = "SCHOTT:F2"', "glass = { n_d = 1.620410001, v_d = 60.32 }", 1)
    glasses = load(tmp_path, inline, "lens.toml").prescription.glasses
    assert [glass.name for glass in glasses] == ["n_d 1.62041, V_d 60.32"] * 2 + ["HIKARI:SK16"]
    assert glasses[1].index(587.5618) - glasses[0].index(587.5618) == pytest.approx(1e-9, rel=1e-5)
    lens = load(tmp_path, inline, "lens.toml")
    indices = lens._indices(np.array([587.5618]))
    assert indices[3] - indices[1] == pytest.approx(1e-9, rel=1e-5)


def test_toml_may_use_the_packaged_glasses(tmp_path: Path) -> None:
    """Without its own tables of coefficients, which are those of the catalogue."""
    bare = TOML[: TOML.index("[glass.")]
    same(load(tmp_path, bare, "lens.toml"), pixsim.load_lens("cooke_triplet"), 20.0)


def test_toml_may_use_radii_and_f_number(tmp_path: Path) -> None:
    lines = [line for line in TOML.splitlines() if not line.startswith("curvature_per_mm")]
    text = "\n".join(lines).replace(
        'type = "entrance_pupil_diameter"\nvalue_mm = 10.0', 'type = "f_number"'
    )
    same(load(tmp_path, text, "lens.toml"), pixsim.load_lens("cooke_triplet"), 20.0)


WRONG_TOML = {
    'glass = "SCHOTT:F2"|glass = "SCHOTT:F2_MOLD"': (
        r"surface 3 \(line 44\): glass: got the unknown glass 'SCHOTT:F2_MOLD'"
    ),
    'glass = "SCHOTT:F2"|glass = "mirror"': (
        r"surface 3 \(line 44\): glass: got 'MIRROR', a mirror; .* no mirrors"
    ),
    'glass = "SCHOTT:F2"|glass = 0.5': "got 0.5; allowed: an index from 1 to 10, or a name",
    'glass = "SCHOTT:F2"|glass = {{ n_d = 1.6 }}': "got n_d and v_d; allowed: exactly one of",
    "stop = true|stop = false": None,
    "stop_surface = 4|": None,
    "stop_surface = 4|stop_surface = 9": "stop of .*: got surfaces 4, 9",
    "object_distance_mm = inf|object_distance_mm = -500": (
        "object of .*: got -500 mm in front of the lens; .* or at infinity"
    ),
    "conic = 0.0|conic = nan": r"surface 1 \(line 26\): conic",
    "conic = 0.0|conics = 0.0": (
        r"surface 1 \(line 26\): \(a name of 6 characters\): unknown name; .*Did you mean 'conic'"
    ),
    "conic = 0.0|asphere = {{ A1 = 0.1 }}": (
        "A1 = 0.1; allowed: finite terms A2 to A60.* A term in r is a cone"
    ),
    "conic = 0.0|asphere = {{ B4 = 0.1 }}": "a term that is a text of 2 characters",
    "thickness_mm = 3.25896|thickness_mm = -3.259": (
        r"surface 1 \(line 26\): thickness_mm: got -3.259 in the glass"
    ),
    "radius_mm = 22.01359|radius_mm = 23.0": (
        "radius_mm: got 23, with curvature_per_mm = .*; allowed: the reciprocal"
    ),
    "value_mm = 10.0|value_mm = -1": "aperture.value_mm: got -1",
    "value_mm = 10.0|": "aperture.value_mm: got none",
    'units = "mm"|units = "in"': "units: got a text of 2 characters; allowed: 'mm'",
    "primary = |primary = 0.0 #": "wavelengths.primary",
    "max_deg = 20.0|max_deg = 195.0": "fields.max_deg: got 195",
}


@pytest.mark.parametrize("change", WRONG_TOML)
def test_wrong_toml_names_what_where(tmp_path: Path, change: str) -> None:
    old, _, new = change.replace("{{", "{").replace("}}", "}").partition("|")
    assert old in TOML
    text = TOML.replace(old, new, 1)
    if WRONG_TOML[change] is None:  # stated twice: one of the two is enough
        same(load(tmp_path, text, "lens.toml"), pixsim.load_lens("cooke_triplet"), 14.0)
        return
    with pytest.raises(pixsim.PixsimError, match=WRONG_TOML[change]):
        load(tmp_path, text, "lens.toml")


def test_missing_stop_of_toml_is_named(tmp_path: Path) -> None:
    text = TOML.replace("stop = true", "").replace("stop_surface = 4", "")
    with pytest.raises(
        pixsim.PixsimError, match=r"stop of .*: got no surface; allowed: one of the surfaces 1 to 6"
    ):
        load(tmp_path, text, "lens.toml")


WRONG_ZMX = {
    "  STOP\n|": "stop of .*: got no surface",
    "GLAS N-BAK1 0|GLAS MIRROR 0": r"surface 2 \(line 75\), line 82: GLAS: got 'MIRROR', a mirror",
    "GLAS N-BAK1 0|GLAS N-BAK1_MOLD 0": (
        r"surface 2 \(line 75\), line 82: GLAS: got the unknown glass 'N-BAK1_MOLD'"
    ),
    "GLAS N-BAK1 0|GLAS J-LAK14 0": r"not in the catalogues that the file names \(SCHOTT\)",
    "GLAS N-BAK1 0 0 1.572500121386|GLAS ___BLANK 1 0 x": (
        "GLAS: got a text of 1 character; allowed: a finite number"
    ),
    "TYPE STANDARD\n  CURV 7.0|TYPE GRINSUR1\n  CURV 7.0": (
        r"surface 2 \(line 75\): got .* GRINSUR1, a gradient index"
    ),
    "TYPE STANDARD\n  CURV 7.0|TYPE COORDBRK\n  CURV 7.0": (
        r"COORDBRK, a tilted or decentred axis \(with a curvature, with a glass"
    ),
    "SURF 0\n  TYPE STANDARD|SURF 0\n  TYPE EVENASPH": (
        "surface 0 .*: got an object of the type EVENASPH"
    ),
    "SURF 1\n  TYPE STANDARD|SURF 1\n  TYPE COORDBRK\n  PARM 3 2.5": (
        r"COORDBRK, a tilted or decentred axis \(tilt x 2.5\)"
    ),
    "TYPE STANDARD\n  CURV 7.0|TYPE XPOLYNOM\n  CURV 7.0": "the surface type XPOLYNOM",
    "  FLAP 0 6.3 0|  FLAP 1 6.3 0": "FLAP with a hole inside",
    "  FLAP 0 6.3 0|  IGNR 1": "a surface that Zemax ignores",
    "  FLAP 0 6.3 0|  SQAP 6.3 6.3": "SQAP, a rectangular aperture",
    "  FLAP 0 6.3 0|  FLAP 0 6.3 0\n  OBDC 0.5 0": "a decentred aperture",
    "CURV 7.061398863114783100E-002|CURV x": (
        "CURV: got a text of 1 character; allowed: a finite number"
    ),
    'CURV 7.061398863114783100E-002 0 0 0 0 ""|CURV': "CURV: got nothing",
    "CURV 7.061398863114783100E-002|CURV 1e999": "CURV: got a text of 5 characters",
    "UNIT MM|UNIT FURLONG": "line 7: got UNIT with a text of 7 characters; allowed: MM, CM, IN",
    "MODE SEQ|MODE NSC": "got MODE with a text of 3 characters; allowed: MODE SEQ",
    "DISZ INFINITY|DISZ -500": (
        r"surface 0 \(line 57\): got an object at -500; allowed: a real object"
    ),
    "FNUM 4.5 0|OBNA 0.1 0": "got a numerical aperture of 0.1, with the object at inf mm",
    "FNUM 4.5 0|XNUM 4.5 0": "aperture of .*: got none; allowed: ENPD",
    "FTYP 0 0 3 3|FTYP 1 0 3 3": "got object heights of an object at infinity; allowed: angles",
    "FTYP 0 0 3 3|FTYP 4 0 3 3": "FTYP: got 4; allowed: 0 .angles.",
    "CURV 7.061398863114783100E-002|CURV 7,0613E-002": (
        "CURV: got a text of 11 characters; .* with a decimal point"
    ),
    "PWAV 2|PWAV 7": "PWAV: got 7; allowed: 1 to 3",
    "SURF 4\n|SURF 5\n": "got SURF 5 a second time",
    "SURF 13\n|SURF 99\n": "SURF 0 to SURF 13, without a gap: SURF 13 is missing",
    "SURF 4\n|SURF x\n": "got SURF without a number; allowed: SURF with the number of each surface",
    "DISZ 0\n  DIAM 2.26|DISZ 0\n  CURV 0.1\n  DIAM 2.26": None,
}


@pytest.mark.parametrize("change", WRONG_ZMX)
def test_wrong_zmx_names_line_and_surface(tmp_path: Path, change: str) -> None:
    old, _, new = change.partition("|")
    text = ZMX.replace("\r\n", "\n")
    assert old in text
    if WRONG_ZMX[change] is None:
        head, _, image = text.rpartition("CURV 0.0")
        with pytest.raises(pixsim.PixsimError, match=r"an image of curvature 0.1"):
            load(tmp_path, head + "CURV 0.1" + image)
        return
    with pytest.raises(pixsim.PixsimError, match=WRONG_ZMX[change]):
        load(tmp_path, text.replace(old, new, 1))


def test_unknown_glasses_of_the_originals_are_named() -> None:
    """Readers of other programs substitute a neighbour, an n_d of 1.5, or a fit. The lines state no
    numbers, or a placeholder.
    """
    with pytest.raises(
        pixsim.PixsimError,
        match=r"surface 3 \(line \d+\), line \d+: GLAS: got the unknown glass 'L-TIM28_MOLD'",
    ):
        pixsim.load_lens(str(DATA / "US08427765-1.ZMX"))
    for unknown in ("error", "model"):
        with pytest.raises(pixsim.PixsimError) as raised:
            pixsim.load_lens(str(DATA / "zmax_55278.zmx"), unknown_glass=unknown)
        *lines, catalogue = str(raised.value).splitlines()
        assert [re.findall(r"surface \d", line)[0] for line in lines] == ["surface 2", "surface 4"]
        assert all(
            re.search(r"unknown glass 'BK7'; .* Its line states no n_d and V_d\.", line)
            for line in lines
        )
        assert "lens.glass_catalogues" in catalogue


def test_files_that_are_no_prescription_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name in ("lens.zmx", "lens.toml"):
        with pytest.raises(pixsim.PixsimError, match=r"binary|UTF-8"):
            load(tmp_path, rng.bytes(4096), name)
        with pytest.raises(pixsim.PixsimError, match=r"SURF|missing|empty|TOML"):
            load(tmp_path, "a text that says nothing\n", name)
        path = tmp_path / f"large-{name}"
        path.touch()
        os.truncate(path, 100 << 20)
        with pytest.raises(pixsim.PixsimError, match="of 104857600 bytes"):
            pixsim.load_lens(str(path))
    with pytest.raises(
        pixsim.PixsimError,
        match=r"allowed: cooke_triplet, double_gauss, phone, singlet; .*Did you mean 'phone'",
    ):
        pixsim.load_lens("phon")
    with pytest.raises(pixsim.PixsimError, match="does not exist"):
        pixsim.load_lens(str(tmp_path / "none.zmx"))
    assert {read_prescription(name).name for name in packaged("data/lenses")} == {
        "cooke_triplet",
        "double_gauss",
        "phone",
        "singlet",
    }


# Files as people have them
# -----------------------------------------------------------------------------------------------------

WILD = DATA / "wild"
AIR = (WILD / "air.zmx").read_text()
FOCAL_MM = 49.0514


def wild(name: str, **options: Any) -> pixsim.optics.lens.Lens:
    return pixsim.load_lens(WILD / name, **options)


def focal_mm(lens: pixsim.optics.lens.Lens, wavelength_nm: float | None = None) -> float:
    return lens.first_order(wavelength_nm or lens.primary_nm).focal_length_mm


def notes_of(call: Callable[[], object]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in caught]


UNINDENTED = "\n".join(line.strip() for line in AIR.splitlines())
BEFORE, FROM_1 = AIR[: AIR.index("SURF 1\n")], AIR[AIR.index("SURF 1\n") :]
LAID_OUT = {
    "unindented": UNINDENTED,
    "all indented": "\n".join(f"  {line}" for line in AIR.splitlines()),
    "tabs": AIR.replace("  ", "\t"),
    "small letters": (
        AIR.replace("SURF", "Surf")
        .replace("  CURV", "  curv")
        .replace("TYPE STANDARD", "TYPE Standard")
    ),
    "surfaces first": AIR[AIR.index("SURF 0") :] + AIR[: AIR.index("SURF 0")],
    "surfaces first, unindented": (
        UNINDENTED[UNINDENTED.index("SURF 0") :] + "\n" + UNINDENTED[: UNINDENTED.index("SURF 0")]
    ),
    "surfaces in another order": (
        BEFORE[: BEFORE.index("SURF 0")] + FROM_1 + BEFORE[BEFORE.index("SURF 0") :]
    ),
    "without MODE": AIR.replace("MODE SEQ\n", ""),
    "wavelengths in another order": AIR.replace("WAVM 1 5.5E-1 1", "WAVM 2 .65 1\nWAVM 1 5.5E-1 1"),
    "lines of old Macs": AIR.replace("\n", "\r"),
    "end of DOS": AIR + "\x1a\x1a",
    "filled up": AIR + "\0" * 300,
    "air by its name": AIR.replace("DISZ 46.5", "DISZ 46.5\n  GLAS AIR 0 0 1 0"),
    "working f-number": AIR.replace("FNUM 4 0", "FNUM 4 1"),
    "object far away": AIR.replace("DISZ INFINITY", "DISZ 1E10"),
}


@pytest.mark.parametrize("how", LAID_OUT)
def test_layout_of_a_file_means_nothing(tmp_path: Path, how: str) -> None:
    lens = load(tmp_path, LAID_OUT[how])
    same(lens, wild("air.zmx"), 10.0, 1e-9)
    assert focal_mm(lens) == pytest.approx(FOCAL_MM, abs=1e-4)


def test_unindented_file_of_the_collection_is_read() -> None:
    same(wild("flat.zmx"), wild("air.zmx"), 10.0, 1e-12)


def test_comment_of_another_code_page_ends_no_line(tmp_path: Path) -> None:
    """The character 0x85 is `…` there, and the end of a line in Unicode."""
    text = AIR.replace("  STOP\n", "  COMM a\x85CURV 1\n  STOP\n").encode("latin-1")
    same(load(tmp_path, text), wild("air.zmx"), 10.0, 1e-12)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_byte_too_much_of_an_encoding_is_left_out(tmp_path: Path, encoding: str) -> None:
    same(load(tmp_path, AIR.encode(encoding) + b"\n"), wild("air.zmx"), 10.0, 1e-12)


def test_medium_of_the_object_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(
        pixsim.PixsimError,
        match=(
            r"surface 0 .*GLAS: got an object in the medium n_d 1.334, V_d 55.8; allowed: .* in air"
        ),
    ):
        wild("water.zmx")
    with pytest.raises(pixsim.PixsimError, match="an object in the medium 'SEAWATER'"):
        load(
            tmp_path,
            AIR.replace("  DISZ INFINITY", "  GLAS SEAWATER 0 0 1.334 55.8\n  DISZ INFINITY"),
        )


@pytest.mark.parametrize(
    ("suffix", "hint"),
    [
        (".zos", r"save it as \.zmx \(File, Save As\)"),
        (".zar", r"an archive .* save the lens as \.zmx"),
        (".seq", r"a file of CODE V.* save it as \.zmx"),
        (".LEN", r"a file of CODE V or OSLO"),
        (".agf", r"name it in lens\.glass_catalogues"),
    ],
)
def test_other_formats_say_how_to_export(tmp_path: Path, suffix: str, hint: str) -> None:
    path = tmp_path / f"lens{suffix}"
    path.write_bytes(b"PK\3\4")
    with pytest.raises(
        pixsim.PixsimError, match=rf"or the path of a \.toml or \.zmx file\. .*{hint}"
    ):
        pixsim.load_lens(path)


# Glass


@pytest.mark.parametrize(
    ("name", "numbers"), [("bk7.zmx", "1.5168 64.2"), ("sk16_schott.zmx", "1.62041 60.3")]
)
def test_unknown_glass_offers_the_numbers_of_its_line(
    tmp_path: Path, name: str, numbers: str
) -> None:
    """As a line to write, which gives the lens that lens.unknown_glass = "model" gives too."""
    with pytest.raises(
        pixsim.PixsimError, match=rf"write GLAS ___BLANK 1 0 {numbers} in its place"
    ) as raised:
        wild(name)
    assert "N-BK7" not in str(raised.value)
    ready = re.search(r"write (GLAS .*?) in its place", str(raised.value))
    assert ready
    written = load(tmp_path, re.sub(r"GLAS .*", ready[1], (WILD / name).read_text()))
    with pytest.warns(
        UserWarning, match=r"models of the n_d and V_d in their lines: (BK7|SK16) \(surface 1\)"
    ):
        model = wild(name, unknown_glass="model")
    same(written, model, 10.0, 1e-12)
    assert model.prescription.surfaces[0].glass.index(587.5618) == pytest.approx(
        float(numbers.split()[0]), rel=1e-12
    )


def test_all_unknown_glasses_are_named_at_once(tmp_path: Path) -> None:
    text = ZMX.replace("GLAS N-BAK1 0", "GLAS OLD1 0").replace("GLAS N-BALF4 0", "GLAS OLD2 0")
    with pytest.raises(pixsim.PixsimError) as raised:
        load(tmp_path, text)
    lines = str(raised.value).splitlines()
    found = [
        re.findall(r"unknown glass '(\w+)'.*write GLAS ___BLANK 1 0 1\.5\d+", line)
        for line in lines[:-1]
    ]
    assert found == [["OLD1"], ["OLD1"], ["OLD2"]]
    inline = TOML.replace('glass = "HIKARI:SK16"', 'glass = "OLD1"').replace(
        'glass = "SCHOTT:F2"', 'glass = "OLD2"'
    )
    with pytest.raises(pixsim.PixsimError) as raised:
        load(tmp_path, inline, "lens.toml")
    assert {"OLD1", "OLD2"} <= set(re.findall(r"'(OLD\d)'", str(raised.value)))


def test_six_digit_glass_is_read(tmp_path: Path) -> None:
    glass = (
        load(tmp_path, AIR.replace("GLAS N-BK7 0 0 1.5168 64.17", "GLAS 517642 0 0 1.5 40"))
        .prescription.surfaces[0]
        .glass
    )
    assert glass.index(587.5618) == pytest.approx(1.517, rel=1e-12)
    assert "six digits" in glass.name


def test_shift_of_a_glass_is_applied(tmp_path: Path) -> None:
    """Mode 4 of a line: its last numbers are what the melt has more of n_d and V_d."""
    line = "GLAS N-BK7 4 0 1.5168 64.17 0 0 0 0 0.001 0"
    glass = (
        load(tmp_path, AIR.replace("GLAS N-BK7 0 0 1.5168 64.17", line))
        .prescription.surfaces[0]
        .glass
    )
    assert glass.index(587.5618) == pytest.approx(1.516800034501 + 1e-3, abs=1e-11)
    assert glass.name == "SCHOTT:N-BK7, n_d +0.001, V_d +0"


AGF = (
    "NM {name} 2 517642 {n_d} 64.2 0 1\nCD 1.03961212 0.00600069867 0.231792344 0.0200179144 {b3}"
    " 103.560653\nLD 0.3 2.5\n"
)


def test_catalogue_of_the_user_goes_first(tmp_path: Path) -> None:
    (tmp_path / "mine.agf").write_text(
        AGF.format(name="BK7", n_d=1.5168, b3=1.01046945)
        + AGF.format(name="N-BK7", n_d=1.51, b3=0.3)
    )
    with pytest.raises(
        pixsim.PixsimError, match=r"n_d of its formula: got 1.5\d+; allowed: 1.51, as"
    ):
        wild("bk7.zmx", glass_catalogues=[tmp_path / "mine.agf"])
    (tmp_path / "mine.agf").write_text(
        AGF.format(name="BK7", n_d=1.5168, b3=1.01046945) + AGF.format(name="N-BK7", n_d=0, b3=0.3)
    )
    lens = wild("bk7.zmx", glass_catalogues=[tmp_path / "mine.agf"])
    assert focal_mm(lens) == pytest.approx(FOCAL_MM, abs=1e-4)
    assert (lens.prescription.glasses[0].name, lens.prescription.glasses[0].source) == (
        "MINE:BK7",
        "file 'mine.agf'",
    )
    other = wild("air.zmx", glass_catalogues=[tmp_path / "mine.agf"])
    assert abs(focal_mm(other) - FOCAL_MM) > 0.05
    with pytest.warns(UserWarning, match="lens.glass_catalogues is not used"):
        pixsim.load_lens("singlet", glass_catalogues=[tmp_path / "mine.agf"])
    with pytest.raises(pixsim.PixsimError, match=r"lens\.glass_catalogues: .*none\.agf"):
        wild("air.zmx", glass_catalogues=[tmp_path / "none.agf"])


# Surfaces


def test_null_coordinate_break_changes_nothing(tmp_path: Path) -> None:
    same(wild("cb.zmx"), wild("air.zmx"), 10.0, 1e-9)
    # In the glass, with a part of its thickness.
    inside = (
        "DISZ 2\n  GLAS N-BK7 0 0 1.5168 64.17\nSURF 2\n  TYPE COORDBRK\n  PARM 1 0\n  PARM 6 1\n "
        " DISZ 3\n"
    )
    text = (
        AIR.replace("DISZ 5\n  GLAS N-BK7 0 0 1.5168 64.17\n", inside)
        .replace("SURF 3", "SURF 4")
        .replace("SURF 2\n  TYPE S", "SURF 3\n  TYPE S")
    )
    same(load(tmp_path, text), wild("air.zmx"), 10.0, 1e-9)


def test_all_surfaces_that_are_not_traced_are_named_at_once(tmp_path: Path) -> None:
    text = AIR.replace("  STOP\n  TYPE STANDARD", "  STOP\n  TYPE TOROIDAL").replace(
        "GLAS N-BK7", "GLAS MIRROR"
    )
    text = text.replace(
        "SURF 2\n  TYPE STANDARD", "SURF 2\n  TYPE COORDBRK\n  PARM 1 .5\n  PARM 4 -2"
    ).replace("CURV -0.02", "CURV 0")
    with pytest.raises(pixsim.PixsimError) as raised:
        load(tmp_path, text)
    assert re.search(
        r"surface 1 .*TOROIDAL.*\n.*surface 1 .*MIRROR.*\n.*surface 2 .*decentre x 0.5, tilt y -2",
        str(raised.value),
    )


def test_extended_asphere_is_the_even_one(tmp_path: Path) -> None:
    same(wild("xas.zmx"), wild("equivalent_evenasph.zmx"), 10.0, 1e-9)
    # With another radius that r is taken over: the terms are those of (r/2)⁴ and (r/2)⁶.
    text = (WILD / "xas.zmx").read_text().replace("XDAT 2 1 ", "XDAT 2 2 ")
    text = text.replace("XDAT 4 2.5E-06", "XDAT 4 4.0E-05").replace(
        "XDAT 5 1.0E-09", "XDAT 5 6.4E-08"
    )
    same(load(tmp_path, text), wild("equivalent_evenasph.zmx"), 10.0, 1e-9)
    with pytest.warns(
        UserWarning, match=r"surface 2 \(line \d+\): XDAT 1 states 2 terms; 1 beyond are not used"
    ):
        short = load(tmp_path, text.replace("XDAT 1 3 ", "XDAT 1 2 "))
    assert short.prescription.surfaces[1].asphere == ((4, 2.5e-6),)


def test_extended_odd_asphere_is_the_odd_one(tmp_path: Path) -> None:
    odd = AIR.replace(
        "TYPE STANDARD\n  CURV -0.02", "TYPE ODDASPHE\n  PARM 3 1e-5\n  PARM 4 2e-7\n  CURV -0.02"
    )
    terms = "XDAT 1 4\n  XDAT 2 0.5\n  XDAT 5 1.25e-6\n  XDAT 6 1.25e-8"
    extended = AIR.replace("TYPE STANDARD\n  CURV -0.02", f"TYPE XOSPHERE\n  {terms}\n  CURV -0.02")
    same(load(tmp_path, extended), load(tmp_path, odd, "odd.zmx"), 10.0, 1e-9)
    with pytest.raises(pixsim.PixsimError, match="A term in r is a cone"):
        load(tmp_path, extended.replace("XDAT 5", "XDAT 3"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("XDAT|XDUT", "XASPHERE without XDAT, which programs read in several ways"),
        ("  XDAT 1 3|  PARM 2 2.5E-06\n  XDAT 1 3", "XASPHERE with terms in both PARM and XDAT"),
        ("XDAT 2 1 |XDAT 2 0 ", "XDAT 2, the normalisation radius: got 0"),
        ("XDAT 2 1 |XDAT 2 1e-200 ", "A4 = inf; allowed: finite terms"),
        ("XDAT 2 1 |XDAT 2 1e200 ", None),
    ],
)
def test_extended_asphere_that_programs_read_in_several_ways_is_refused(
    tmp_path: Path, change: str, message: str | None
) -> None:
    old, _, new = change.partition("|")
    if message is None:  # terms that are nothing
        same(
            load(tmp_path, (WILD / "xas.zmx").read_text().replace(old, new)), wild("air.zmx"), 10.0
        )
        return
    with pytest.raises(pixsim.PixsimError, match=message):
        load(tmp_path, (WILD / "xas.zmx").read_text().replace(old, new))


# Light that is stopped


def test_fixed_semi_diameters_clip_if_asked_to() -> None:
    fields = [0.0, 10.0, 15.0, 17.5, 20.0]
    with pytest.warns(UserWarning, match="fixed semi-diameters of 2 surfaces stop no rays"):
        open_ = wild("fixed.zmx")
    clipped, flaps = wild("fixed.zmx", semi_diameters="clip"), wild("same_with_flap.zmx")
    assert clipped.relative_illumination(fields) == pytest.approx(
        flaps.relative_illumination(fields), abs=1e-12
    )
    assert [round(float(lens.relative_illumination(17.5)), 3) for lens in (open_, clipped)] == [
        0.639,
        0.082,
    ]
    assert not notes_of(
        lambda: (wild("fixed.zmx", semi_diameters="clip"), wild("same_with_flap.zmx"))
    )


@pytest.mark.parametrize(
    ("change", "clipping"),
    [
        ("DIAM 5.5 1|DIAM 5.5 2", [0, 1]),  # picked up
        ("DIAM 5.5 1|DIAM 5.5 0", []),  # automatic
        ("SURF 3\n  STOP|SURF 3\n  DIAM 1 1\n  STOP", [0, 1]),  # the stop
        (
            'DISZ 12\n  DIAM 5.5 1 0 0 1 ""\n|DISZ 6\n  DIAM 5.5 1\nSURF 3\n  DIAM 1 1\n  DISZ 6\n',
            [0, 1],
        ),  # a plane in air
    ],
)
def test_semi_diameters_that_clip(tmp_path: Path, change: str, clipping: list[int]) -> None:
    old, _, new = change.partition("|")
    text = (WILD / "fixed.zmx").read_text()
    assert old in text
    text = text.replace(old, new)
    if "SURF 3\n  DIAM" in new and "STOP" not in new:
        text = text.replace("SURF 4", "SURF 5").replace("SURF 3\n  STOP", "SURF 4\n  STOP")
    (tmp_path / "lens.zmx").write_text(text)
    lens = pixsim.load_lens(tmp_path / "lens.zmx", semi_diameters="clip")
    assert [
        index for index, surface in enumerate(lens.prescription.surfaces) if surface.clips
    ] == clipping


def without_apertures(text: str) -> str:
    return re.sub(r"  FLAP .*\n", "", text.replace("\r\n", "\n"))


def test_vignetting_factors_stand_for_the_apertures_that_they_were_made_of(tmp_path: Path) -> None:
    """OpticStudio made those of the file from its clear apertures: an ellipse in the pupil for an
    intersection of discs.
    """
    apertures = pixsim.load_lens(DATA / "US00583336-2-scaled.zmx")
    with pytest.warns(UserWarning, match="its vignetting factors are used"):
        factors = load(tmp_path, without_apertures(ZMX))
    fields = [0.0, 17.0, 24.0]
    assert factors.relative_illumination(fields) == pytest.approx(
        apertures.relative_illumination(fields), abs=0.03
    )
    ignored = pixsim.load_lens(tmp_path / "lens.zmx", vignetting_factors="ignore")
    assert ignored.relative_illumination(24.0) > factors.relative_illumination(24.0) + 0.2
    # The edges of the ellipse are those of the pupil: VDY ± (1 - VCY) along the field, and 1 - VCX
    # across it.
    low, high = 0.0547324659 - (1 - 0.364762539), 0.0547324659 + (1 - 0.364762539)
    inside = factors.wavefront(
        24.0, 587.5618, [0.0] * 4, [low - 1e-3, low + 1e-3, high - 1e-3, high + 1e-3]
    ).passed[0]
    assert inside.tolist() == [False, True, True, False]
    assert factors.wavefront(-24.0, 587.5618, [0.0], [-(low - 1e-3)]).passed.tolist() == [[False]]
    # Stopped down, the edges of lenses stay where they are; enlarged, they grow.
    stopped = factors.stopped_down(9.0)
    assert stopped.wavefront(24.0, 587.5618, [0.0] * 2, [-0.99, 0.99]).passed.tolist() == [
        [True, True]
    ]
    assert factors.scaled(3.0).relative_illumination(24.0) == pytest.approx(
        float(factors.relative_illumination(24.0)), rel=1e-6
    )


def test_vignetting_factors_beside_apertures_are_not_used_unless_asked_for() -> None:
    name = DATA / "US00583336-2-scaled.zmx"
    with pytest.warns(UserWarning, match="not used, so that nothing is cut twice"):
        plain = pixsim.load_lens(name)
    assert not plain.vignetting
    assert pixsim.load_lens(name, vignetting_factors="use").vignetting


def test_vignetting_factors_of_other_fields(tmp_path: Path) -> None:
    """Those along x are the same turned; an ellipse that is askew to its field is named and left
    out.
    """
    text = without_apertures(ZMX)
    turned = text.replace("XFLN 0 0 0", "XFLN 0 1.7E+1 2.4E+1").replace(
        "YFLN 0 1.7E+1 2.4E+1", "YFLN 0 0 0"
    )
    for one, other in (("VDXN", "VDYN"), ("VCXN", "VCYN")):
        turned = turned.replace(one, "_").replace(other, one).replace("_", other)
    assert np.array(load(tmp_path, turned, "x.zmx").vignetting) == pytest.approx(
        np.array(load(tmp_path, text).vignetting)
    )
    negative = re.sub(
        r"YFLN 0 (\S+) (\S+)",
        r"YFLN 0 -\1 -\2",
        re.sub(r"VDYN 0 (\S+) (\S+)", r"VDYN 0 -\1 -\2", text),
    )
    assert np.array(load(tmp_path, negative, "negative.zmx").vignetting) == pytest.approx(
        np.array(load(tmp_path, text).vignetting)
    )
    with pytest.warns(
        UserWarning, match="vignetting factors of the fields 3 are not used: they are not symmetric"
    ):
        load(tmp_path, text.replace("XFLN 0 0 0", "XFLN 0 0 5"), "askew.zmx")
    with pytest.raises(
        pixsim.PixsimError,
        match=r"vignetting factors of field 3: got .* and 1.2; allowed: decentres below 1",
    ):
        load(tmp_path, text.replace("3.64762539196E-1", "1.2"), "none.zmx")


# Configurations


def test_configurations_are_told_and_chosen() -> None:
    with pytest.warns(
        UserWarning,
        match=(
            r"the file has 3 configurations; read is number 1, the active one. lens.configuration ="
            r" 2 reads"
        ),
    ):
        active = wild("zoom.zmx")
    for number, distance_mm in ((1, 46.5), (2, 60.0), (3, 80.0)):
        lens = wild("zoom.zmx", configuration=number)
        assert lens.prescription.surfaces[-1].thickness_mm == distance_mm
        assert focal_mm(lens) == pytest.approx(focal_mm(active), rel=1e-12)
    assert not notes_of(lambda: wild("zoom.zmx", configuration=1))
    for number, message in ((4, "got 4; allowed: 1 to 3"), (0, "configuration: got 0")):
        with pytest.raises(pixsim.PixsimError, match=message):
            wild("zoom.zmx", configuration=number)
    for name in ("air.zmx", "../telephoto.toml"):
        with pytest.raises(pixsim.PixsimError, match=r"lens\.configuration: got 2; allowed: 1"):
            wild(name, configuration=2)


def test_active_configuration_is_what_the_surfaces_show(tmp_path: Path) -> None:
    text = (
        (WILD / "zoom.zmx")
        .read_text()
        .replace("MNUM 3 1", "MNUM 3 2")
        .replace("DISZ 46.5", "DISZ 60.0")
    )
    with pytest.warns(
        UserWarning, match="read is number 2, the active one. lens.configuration = 3 reads another"
    ):
        lens = load(tmp_path, text)
    assert lens.prescription.surfaces[-1].thickness_mm == 60.0
    assert (
        pixsim.load_lens(tmp_path / "lens.zmx", configuration=1)
        .prescription.surfaces[-1]
        .thickness_mm
        == 46.5
    )


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


@pytest.mark.parametrize("indented", [True, False])
def test_operands_of_a_configuration_are_applied(tmp_path: Path, indented: bool) -> None:
    (tmp_path / "lens.zmx").write_text((AIR if indented else UNINDENTED + "\n") + OPERANDS)
    lens = pixsim.load_lens(tmp_path / "lens.zmx", configuration=2)
    assert (lens.prescription.surfaces[0].thickness_mm, lens.max_field_deg) == (6.0, 12.0)
    assert lens.first_order(550.0).f_number == pytest.approx(5.6, rel=1e-12)
    assert (
        notes_of(
            lambda: same(
                pixsim.load_lens(tmp_path / "lens.zmx", configuration=1),
                wild("air.zmx"),
                10.0,
                1e-12,
            )
        )
        == []
    )


def test_other_operands_are_named(tmp_path: Path) -> None:
    more = (
        "CRVT 2 1 1 0 0\nCRVT 2 2 3 0 0\nTEMP 0 1 20 0 0\nTEMP 0 2 40 0 0\nPRES 0 1 1 0 0\nPRES 0 2"
        " 1 0 0\n"
    )
    (tmp_path / "lens.zmx").write_text(AIR + OPERANDS + more)
    with pytest.raises(
        pixsim.PixsimError,
        match=(
            r"configuration 2: got CRVT 2 \(line \d+\), TEMP 0 \(line \d+\); allowed: operands APER"
        ),
    ):
        pixsim.load_lens(tmp_path / "lens.zmx", configuration=2)
    for change, message in (("THIC 1 2|THIC 9 2", "THIC: got surface 9"), ("YFIE 3 2|YFIE 999 2", "YFIE: got field 999"),
                            ("YFIE 3 2 12|YFIE 3 2 x", "YFIE: got a text of 1 character; allowed: a finite number")):  # fmt: skip
        old, _, new = change.partition("|")
        (tmp_path / "lens.zmx").write_text(AIR + OPERANDS.replace(old, new))
        with pytest.raises(pixsim.PixsimError, match=message):
            pixsim.load_lens(tmp_path / "lens.zmx", configuration=2)


def test_solved_thicknesses_follow_the_configuration(tmp_path: Path) -> None:
    """The paraxial focus; other solves are refused by their names."""
    moved = "MNUM 2 1\nTHIC 1 1 5\nTHIC 1 2 6\n"
    (tmp_path / "lens.zmx").write_text(AIR.replace("DISZ 46.5", "DISZ 47.3\n  MAZH 0 0") + moved)
    lens = pixsim.load_lens(tmp_path / "lens.zmx", configuration=2)
    assert lens.prescription.surfaces[-1].thickness_mm == pytest.approx(
        lens.first_order(550.0).back_focal_length_mm, rel=1e-12
    )
    for solve in ("MAZH 0 0.7", "TCOM 1 51.5", "TOLE 1 51.5"):
        (tmp_path / "lens.zmx").write_text(
            AIR.replace("DISZ 46.5", f"DISZ 46.5\n  {solve}") + moved
        )
        with pytest.raises(
            pixsim.PixsimError,
            match=rf"surface 2 \(line \d+\), line \d+: got the solve {solve} of a thickness",
        ):
            pixsim.load_lens(tmp_path / "lens.zmx", configuration=2)


# Objects, fields and images


def finite(
    field: str = "FTYP 0 0 3 1 0 0 0", aperture: str = "FNUM 4 0", distance: str = "150"
) -> str:
    text = (
        AIR.replace("DISZ INFINITY", f"DISZ {distance}")
        .replace("FTYP 0 0 3 1 0 0 0", field)
        .replace("FNUM 4 0", aperture)
    )
    return text.replace("DISZ 46.5", "DISZ 70")


def test_more_than_twelve_fields_are_read(tmp_path: Path) -> None:
    many = AIR.replace("FTYP 0 0 3 1", "FTYP 0 0 14 1").replace(
        "YFLN 0 7 10 0 0 0 0 0 0 0 0 0", f"YFLN {' '.join(map(str, range(14)))}"
    )
    assert load(tmp_path, many).max_field_deg == 13.0


def test_object_heights_are_read(tmp_path: Path) -> None:
    """The stop is at the first surface, where the entrance pupil is: a height of 10 mm at 150
    mm.
    """
    lens = load(tmp_path, finite("FTYP 1 0 3 1 0 0 0"))
    assert lens.object_distance_mm == pytest.approx(150.0, rel=1e-12)
    assert np.tan(np.radians(lens.max_field_deg)) == pytest.approx(10 / 150, rel=1e-12)
    assert focal_mm(lens) == pytest.approx(FOCAL_MM, abs=1e-4)
    far = load(
        tmp_path,
        AIR.replace("DISZ INFINITY", "DISZ 1E10")
        .replace("FTYP 0", "FTYP 1")
        .replace("0 7 10", "0 7E8 1E9"),
        "far.zmx",
    )
    assert np.tan(np.radians(far.max_field_deg)) == pytest.approx(0.1, rel=1e-9)
    with pytest.raises(pixsim.PixsimError, match="telecentric object space"):
        load(tmp_path, finite("FTYP 1 1 3 1 0 0 0"))


def test_apertures_of_a_near_object(tmp_path: Path) -> None:
    """Lagrange's invariant: the slope in the image is that at the object over the magnification,
    h'/h = height per tangent / u.
    """
    working = load(tmp_path, finite(aperture="FNUM 8 1"))
    assert working.paraxial_height_mm / working.entrance_pupil_diameter_mm == pytest.approx(
        8.0, rel=1e-12
    )
    numerical = load(tmp_path, finite(aperture="OBNA 0.05 0"))
    assert np.sin(np.arctan(numerical.entrance_pupil_diameter_mm / 2 / 150)) == pytest.approx(
        0.05, rel=1e-12
    )
    toml = load(
        tmp_path, TOML.replace("object_distance_mm = inf", "object_distance_mm = 500"), "near.toml"
    )
    assert toml.object_distance_mm == pytest.approx(500 + 11.512158674, abs=1e-8)


@pytest.mark.parametrize(("field_deg", "limit_deg"), [("90.5", 89.0), ("60", 60.0), ("170", 89.0)])
def test_field_beyond_what_is_traced_is_limited(
    tmp_path: Path, field_deg: str, limit_deg: float
) -> None:
    text = (WILD / "f90.zmx").read_text().replace("90.5", field_deg)
    notes = notes_of(lambda: load(tmp_path, text))
    lens = load(tmp_path, text)
    assert lens.max_field_deg == limit_deg
    stated = max(float(field_deg), 60.0)
    assert notes == (
        [
            f"lens 'lens': fields to {stated:g}° are limited to 89°, since fields are traced"
            " below 89°"
        ]
        if stated > 89
        else []
    )


def test_field_without_a_chief_ray_is_limited(tmp_path: Path) -> None:
    """To the last tenth of a degree whose chief rays of all wavelengths get through."""
    with pytest.warns(
        UserWarning, match=r"fields to 40° are limited to 31.5°, since beyond, the chief ray"
    ):
        lens = load(tmp_path, TOML.replace("max_deg = 20.0", "max_deg = 40.0"), "lens.toml")
    assert np.isfinite(lens.chief_ray(lens.max_field_deg, [480.0, 550.0, 650.0]).height_mm).all()
    with pytest.raises(pixsim.PixsimError):
        lens.chief_ray([lens.max_field_deg + 0.1] * 3, [480.0, 550.0, 650.0])
    with pytest.warns(
        UserWarning,
        match=(
            r"fields to 900 mm are limited to 43\.4°, since beyond, the chief ray misses surface 9"
        ),
    ):
        load(
            tmp_path, ZMX.replace("FTYP 0 0 3 3", "FTYP 3 0 3 3").replace("1.7E+1 2.4E+1", "17 900")
        )


VIRTUAL = {
    "hang.zmx": r"no real image: afocal, with a focal length of 5\.289e\+08 mm",
    "kepler_140.9.zmx": (
        r"no real image: afocal, with a focal length of 5\.5e\+04 mm at f/1\.1e\+04"
    ),
    "CURV 0.02|CURV -0.03": "no real image: virtual, with a focal length of -",
    "DISZ INFINITY|DISZ 30": "no real image: a back focal length of -",
}


@pytest.mark.parametrize("case", VIRTUAL)
def test_lens_without_a_real_image_is_refused_at_once(tmp_path: Path, case: str) -> None:
    old, _, new = case.partition("|")
    text = AIR.replace(old, new) if new else (WILD / case).read_text()
    with pytest.raises(pixsim.PixsimError, match=VIRTUAL[case]):
        load(tmp_path, text)
