"""Prescriptions from files: the same lens from each format, unit and encoding; what is not traced is refused where it stands."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.config import packaged
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


def same(one: pixsim.optics.lens.Lens, other: pixsim.optics.lens.Lens, field: float, gate: float = 1e-7) -> None:
    """Two lenses with the same wavefront."""
    for wavelength in (486.1327, 656.2725):
        assert one.opd_waves(field, wavelength, *POINTS) == pytest.approx(other.opd_waves(field, wavelength, *POINTS), abs=gate)
    assert one.primary_nm == pytest.approx(other.primary_nm, rel=1e-6)


def test_zmx_is_the_lens_of_its_toml() -> None:
    zmx, toml = (pixsim.load_lens(str(DATA / name)) for name in ("US00583336-2-scaled.zmx", "double_gauss_us583336.toml"))
    same(zmx, toml, 24.0, 1e-6)
    assert zmx.max_field_deg == 24.0
    assert zmx.first_order(587.5618).f_number == pytest.approx(4.5, rel=1e-12)
    assert [surface.semi_diameter_mm for surface in zmx.prescription.surfaces if surface.clips] == [
        surface.semi_diameter_mm for surface in toml.prescription.surfaces if surface.clips
    ]


def test_aspheric_zmx_is_the_lens_of_its_toml(tmp_path: Path) -> None:
    """With the moulded glass replaced by the one of the TOML, which its reader does not do by itself."""
    text = (DATA / "US08427765-1.ZMX").read_text().replace("L-TIM28_MOLD", "L-TIM28").replace("RPO HOYA", "RPO HOYA OHARA")
    zmx, toml = load(tmp_path, text), pixsim.load_lens(str(DATA / "asphere_us8427765.toml"))
    same(zmx, toml, 12.0, 1e-6)
    # The file's fields are real image heights, the largest of 13.6 mm.
    assert zmx.chief_ray(zmx.max_field_deg, zmx.primary_nm).height_mm == pytest.approx(13.6, rel=1e-9)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8", "utf-8-sig"])
def test_encodings_of_zmx_are_read(tmp_path: Path, encoding: str) -> None:
    text = UTF16.replace("GLAS BK7", "GLAS N-BK7")
    lens = load(tmp_path, text.encode(encoding))
    same(lens, pixsim.load_lens(str(DATA / "achromat_pair_55278.toml")), 0.0, 1e-6)


def test_old_code_page_may_stand_in_comments(tmp_path: Path) -> None:
    assert load(tmp_path, ZMX.replace("NAME Original", "NAME Größe 5°").encode("latin-1")).prescription.title.startswith("Größe 5°")


@pytest.mark.parametrize(("unit", "size_mm"), [("CM", 10.0), ("IN", 25.4), ("INCHES", 25.4), ("METER", 1000.0)])
def test_unit_of_zmx_is_obeyed(tmp_path: Path, unit: str, size_mm: float) -> None:
    """Also for the asphere's terms, which scale with powers of the unit."""
    text = (DATA / "US08427765-1.ZMX").read_text().replace("L-TIM28_MOLD", "L-TIM28").replace("RPO HOYA", "RPO HOYA OHARA")
    lens, other = load(tmp_path, text), load(tmp_path, text.replace("UNIT MM", f"UNIT {unit}"), "other.zmx")
    scaled = lens.scaled(size_mm)
    assert other.first_order(550.0).focal_length_mm == pytest.approx(size_mm * lens.first_order(550.0).focal_length_mm, rel=1e-12)
    assert other.opd_waves(10.0, 550.0, *POINTS) == pytest.approx(scaled.opd_waves(10.0, 550.0, *POINTS), abs=1e-5)
    assert other.max_field_deg == pytest.approx(lens.max_field_deg, rel=1e-9)


def test_odd_asphere_of_zmx_has_the_powers_of_r(tmp_path: Path) -> None:
    asphere = "TYPE ODDASPHE\n  PARM 2 0.001\n  PARM 3 0.0002\n  PARM 5 1e-6"
    head, _, rest = ZMX.partition("SURF 12")
    lens = load(tmp_path, head + "SURF 12" + rest.replace("TYPE STANDARD", asphere, 1))
    assert lens.prescription.surfaces[11].asphere == ((2, 0.001), (3, 0.0002), (5, 1e-6))
    assert lens.prescription.surfaces[11].paraxial_curvature_per_mm == pytest.approx(-0.0706139886 + 0.002)


def test_lists_of_older_zmx_files_are_read(tmp_path: Path) -> None:
    """WAVL, XFLD and YFLD, without the places that later versions keep free."""
    lines = [line for line in ZMX.splitlines() if line.split()[:1] not in (["WAVM"], ["XFLN"], ["YFLN"], ["FTYP"])]
    head = ["WAVL 4.861327E-1 5.875618E-1 6.562725E-1", "XFLD 0 0 0", "YFLD 0 17 24"]
    same(load(tmp_path, "\n".join([*head, *lines])), pixsim.load_lens(str(DATA / "US00583336-2-scaled.zmx")), 24.0)
    assert load(tmp_path, "\n".join([*head, *lines])).max_field_deg == 24.0


@pytest.mark.parametrize(
    ("aperture", "f_number"), [("ENPD 10.975328", 4.5), ("FNUM 4.5 0", 4.5), ("FLOA", 10.9753 / 2 * 4.5 / 4.215 * 0.8717)]
)
def test_apertures_of_zmx(tmp_path: Path, aperture: str, f_number: float) -> None:
    lens = load(tmp_path, ZMX.replace("FNUM 4.5 0", aperture))
    if aperture == "FLOA":  # the stop's semi-diameter of the file fills an entrance pupil of its paraxial image
        scale, _ = lens._front(lens.primary_nm)
        assert abs(scale) * lens.entrance_pupil_diameter_mm / 2 == pytest.approx(4.215, rel=1e-6)
    else:
        assert lens.first_order(lens.primary_nm).f_number == pytest.approx(f_number, rel=1e-5)


def test_glass_by_abbe_number_or_index(tmp_path: Path) -> None:
    """In both formats the same approximation of n_d and V_d."""
    zmx = load(tmp_path, ZMX.replace("GLAS N-BAK1 0 0 1.572500121386", "GLAS ___BLANK 1 0 1.572500121386"))
    assert "approximation" in zmx.prescription.surfaces[1].glass.source
    inline = TOML.replace('glass = "HIKARI:SK16"', "glass = { n_d = 1.62041, v_d = 60.32 }").replace('"SCHOTT:F2"', "1.62", 1)
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
    text = "\n".join(lines).replace('type = "entrance_pupil_diameter"\nvalue_mm = 10.0', 'type = "f_number"')
    same(load(tmp_path, text, "lens.toml"), pixsim.load_lens("cooke_triplet"), 20.0)


SECOND = "[[surface]]  # 2\n"
WRONG_TOML = {
    'glass = "SCHOTT:F2"|glass = "SCHOTT:F2_MOLD"': r"surface 3 \(line 44\): glass: got the unknown glass 'SCHOTT:F2_MOLD'",
    'glass = "SCHOTT:F2"|glass = "mirror"': r"surface 3 \(line 44\): glass: got 'MIRROR', a mirror; .* no mirrors",
    'glass = "SCHOTT:F2"|glass = 0.5': "got 0.5; allowed: an index from 1 to 10, or a name",
    'glass = "SCHOTT:F2"|glass = {{ n_d = 1.6 }}': "got n_d and v_d; allowed: exactly one of",
    "stop = true|stop = false": None,
    "stop_surface = 4|": None,
    "stop_surface = 4|stop_surface = 9": "stop of .*: got surfaces 4, 9",
    "object_distance_mm = inf|object_distance_mm = 500": "object_distance_mm: got 500; allowed: inf",
    "conic = 0.0|conic = nan": r"surface 1 \(line 26\): conic",
    "conic = 0.0|conics = 0.0": r"surface 1 \(line 26\): \(a name of 6 characters\): unknown name; .*Did you mean 'conic'",
    "conic = 0.0|asphere = {{ A1 = 0.1 }}": "A1 = 0.1; allowed: finite terms A2 to A30.* A term in r is a cone",
    "conic = 0.0|asphere = {{ B4 = 0.1 }}": "a term that is a text of 2 characters",
    "thickness_mm = 3.25896|thickness_mm = -3.259": r"surface 1 \(line 26\): thickness_mm: got -3.259 in the glass",
    "radius_mm = 22.01359|radius_mm = 23.0": "radius_mm: got 23, with curvature_per_mm = .*; allowed: the reciprocal",
    "value_mm = 10.0|value_mm = -1": "aperture.value_mm: got -1",
    "value_mm = 10.0|": "aperture.value_mm: got none",
    'units = "mm"|units = "in"': "units: got a text of 2 characters; allowed: 'mm'",
    "primary = |primary = 0.0 #": "wavelengths.primary",
    "max_deg = 20.0|max_deg = 95.0": "fields.max_deg: got 95",
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
    with pytest.raises(pixsim.PixsimError, match=r"stop of .*: got no surface; allowed: one of the surfaces 1 to 6"):
        load(tmp_path, text, "lens.toml")


WRONG_ZMX = {
    "  STOP\n|": "stop of .*: got no surface",
    "GLAS N-BAK1 0|GLAS MIRROR 0": r"surface 2 \(line 75\), line 82: GLAS: got 'MIRROR', a mirror",
    "GLAS N-BAK1 0|GLAS N-BAK1_MOLD 0": r"surface 2 \(line 75\), line 82: GLAS: got the unknown glass 'N-BAK1_MOLD'",
    "GLAS N-BAK1 0|GLAS J-LAK14 0": r"not in the catalogues that the file names \(SCHOTT\)",
    "GLAS N-BAK1 0 0 1.572500121386|GLAS ___BLANK 1 0 x": "GLAS: got a text of 1 character; allowed: a finite number",
    "TYPE STANDARD\n  CURV 7.0|TYPE GRINSUR1\n  CURV 7.0": r"surface 2 \(line 75\): got .* GRINSUR1, a gradient index",
    "TYPE STANDARD\n  CURV 7.0|TYPE COORDBRK\n  CURV 7.0": "COORDBRK, a tilted or decentred axis",
    "TYPE STANDARD\n  CURV 7.0|TYPE XPOLYNOM\n  CURV 7.0": "the surface type XPOLYNOM",
    "  FLAP 0 6.3 0|  FLAP 1 6.3 0": "FLAP with a hole inside",
    "  FLAP 0 6.3 0|  IGNR 1": "a surface that Zemax ignores",
    "  FLAP 0 6.3 0|  SQAP 6.3 6.3": "SQAP, a rectangular aperture",
    "  FLAP 0 6.3 0|  FLAP 0 6.3 0\n  OBDC 0.5 0": "a decentred aperture",
    "CURV 7.061398863114783100E-002|CURV x": "CURV: got a text of 1 character; allowed: a finite number",
    'CURV 7.061398863114783100E-002 0 0 0 0 ""|CURV': "CURV: got nothing",
    "CURV 7.061398863114783100E-002|CURV 1e999": "CURV: got a text of 5 characters",
    "UNIT MM|UNIT FURLONG": "line 7: got UNIT with a text of 7 characters; allowed: MM, CM, IN",
    "MODE SEQ|MODE NSC": "got MODE with a text of 3 characters; allowed: MODE SEQ",
    "DISZ INFINITY|DISZ 500": r"surface 0 \(line 57\): got an object at 500",
    "FNUM 4.5 0|OBNA 0.1 0": "aperture of .*: got none; allowed: ENPD",
    "FNUM 4.5 0|FNUM 4.5 1": "a working f-number",
    "FTYP 0 0 3 3|FTYP 1 0 3 3": "FTYP 1, fields as object heights",
    "PWAV 2|PWAV 7": "PWAV: got 7; allowed: 1 to 3",
    "SURF 4\n|SURF 5\n": "got SURF 5; allowed: SURF 4",
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
    """Readers of other programs substitute a neighbour, an n_d of 1.5, or a fit."""
    with pytest.raises(pixsim.PixsimError, match=r"surface 3 \(line \d+\), line \d+: GLAS: got the unknown glass 'L-TIM28_MOLD'"):
        pixsim.load_lens(str(DATA / "US08427765-1.ZMX"))
    with pytest.raises(pixsim.PixsimError, match=r"surface 2 \(line \d+\), line \d+: GLAS: got the unknown glass 'BK7'"):
        pixsim.load_lens(str(DATA / "zmax_55278.zmx"))


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
    with pytest.raises(pixsim.PixsimError, match=r"allowed: cooke_triplet, double_gauss, phone, singlet; .*Did you mean 'phone'"):
        pixsim.load_lens("phon")
    with pytest.raises(pixsim.PixsimError, match=r"or the path of a \.toml or \.zmx file"):
        pixsim.load_lens("lens.seq")
    with pytest.raises(pixsim.PixsimError, match="does not exist"):
        pixsim.load_lens(str(tmp_path / "none.zmx"))
    assert {read_prescription(name).name for name in packaged("data/lenses")} == {
        "cooke_triplet",
        "double_gauss",
        "phone",
        "singlet",
    }
