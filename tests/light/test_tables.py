"""Tables against wavelength in the forms that people have: read to the same numbers, or refused
with the likely cause.
"""

from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check

from pixsim import Pixel
from pixsim.light.curves import as_curves, as_quantum_efficiency, read_curve
from pixsim.light.tables import read_table, unit_hint
from pixsim.scene.guard.assets import spectrum_value

CASES = Path(__file__).parents[1] / "data/cases"
QE = ((400.0, 0.3), (500.0, 0.4), (600.0, 0.25))
PLAIN = "nm,QE\n400,0.3\n500,0.4\n600,0.25\n"
# Each holds QE; a string is written in UTF-8.
FORMS: dict[str, str | bytes] = {
    "commas": PLAIN,
    "no title": "400,0.3\n500,0.4\n600,0.25",
    "a comma and a blank": PLAIN.replace(",", ", "),
    "semicolons and decimal commas": "nm;QE\n400,0;0,3\n500;0.4\n600;0,25\n",
    "tabs": PLAIN.replace(",", "\t"),
    "blanks": PLAIN.replace(",", "   "),
    "blanks, decimal commas and whole numbers": "400 0,3\n500 0,4\n600 0,25\n",
    "blanks and decimal commas": "400 0,3\n500,0 0,4\n600 2,5E-1\n",
    "blanks, tabs and what follows": "# nm value\n400 0.3\n 500\t0.4 x\n600 .25\n",
    "quotes": '"nm","QE"\n"400","0.3"\n"500","0.4"\n"600","0.25"\n',
    "a comma at the end": PLAIN.replace("\n", ",\n"),
    "other ends of lines": PLAIN.replace("\n", "\r\n"),
    "blank lines and comments": f"# a; comment, with marks\n\n{PLAIN}\n\n# the end\n",
    "byte order mark": "\ufeff" + PLAIN,
    "Latin-1": "Wellenlänge [nm];QE für 25 °C\n400;0,3\n500;0,4\n600;0,25".encode("latin-1"),
    "UTF-16 of a spreadsheet": PLAIN.replace(",", "\t").encode("utf-16"),
    "UTF-16 of numbers alone": "400\t0.3\n500\t0.4\n600\t0.25".encode("utf-16"),
    "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
    "UTF-16 without a mark, with other letters": f"# {20 * 'Ω'}\n{PLAIN}".encode("utf-16-le"),
    "a comment among the numbers": "x,y\nnm,QE\n400,0.3\n# nm,QE (%)\n500,0.4\n600,0.25\n",
    "a comment that may be of other columns": (
        "# wave length (nm) quantum efficiency (%)\n400 0.3\n500 0.4\n600 0.25\n"
    ),
    "UTF-16, the other order": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "rows of header": (
        "Monochromator 3\nMeasured,2024-05-01\nWavelength,Value\nnm,-\n" + PLAIN.partition("\n")[2]
    ),
    "descending": "600,0.25\n500,0.4\n400,0.3\n",
    "µm in the title": "wavelength (µm),QE\n0.4,0.3\n0.5,0.4\n0.6,0.25\n",
    "µm as Latin-1": "wavelength [µm]\tQE\n0,4\t0,3\n0,5\t0,4\n0,6\t0,25\n".encode("latin-1"),
    "µm by name": "Wavelength_um QE\n.4 .3\n.5 .4\n.6 .25\n",
    "Å in the title": "λ (Å);QE\n4000;0,3\n5000;0,4\n6000;0,25\n",
    "A in brackets": "Lambda (A)  QE\n4000 0.3\n5000 0.4\n6000 0.25\n",
    "a unit without a factor": "Wavelength (nm),QE (e/photon)\n400,0.3\n500,0.4\n600,0.25\n",
    "per cent in the title": "Wavelength (nm),QE (%)\n400,30\n500,40\n600,25\n",
    "per cent by name": "nm;qe_percent\n400;30\n500;40\n600;25\n",
    "per cent below the title": "Wavelength;QE\n[nm];[%]\n400;30\n500;40\n600;25\n",
    "per cent in the cells": "nm,QE\n400,30%\n500,40 %\n600,25%\n",
    "per cent in title and cells": "nm;QE (%)\n400;30 %\n500;40 %\n600;25 %\n",
    "a commented title, as NumPy writes it": (
        "# wavelength_um,QE (%)\n4.0e-01,30\n5.0e-01,40\n6.0e-01,25\n"
    ),
    "a title with blanks": "Wavelength (nm)  Quantum efficiency (%)\n400 30\n500 40\n600 25\n",
}


def written(folder: Path, content: str | bytes, name: str = "table.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_table_has_the_same_numbers(form: str, tmp_path: Path) -> None:
    """In a quantum efficiency and in a spectrum of a scene, whose numbers are decimal: none is
    moved by its unit.
    """
    path = written(tmp_path, FORMS[form])
    assert read_curve(path) == QE
    assert [
        tuple(map(float, pair.split(":"))) for pair in spectrum_value(path).split(", ")
    ] == list(QE)


@pytest.mark.parametrize(
    ("name", "digit"),
    [
        ("28-csv-qe/plain.csv", 0.0),
        ("28-csv-qe/space.spd", 0.0),
        # η = R h c / (q λ): made from the same curve, with four digits; half of one at 400 nm.
        ("38-qe-responsivity/responsivity.csv", 0.5e-4 * 1239.84 / 400),
    ],
)
def test_quantum_efficiency_of_an_instrument(name: str, digit: float) -> None:
    curve = dict(read_curve(CASES / name))
    values = [len(curve), curve[400], curve[550], curve[700]]
    check("efficiency", values, [31, 0.2311, 0.7, 0.2311], atol=digit, why="half a digit")
    plain = read_curve(CASES / "28-csv-qe/plain.csv")
    check("curve", list(curve.items()), np.array(plain), atol=digit, why="half a digit")
    check("falling", as_quantum_efficiency(plain[::-1]), np.array(plain), why="the same pairs")


@pytest.mark.parametrize(
    ("title", "name", "expected"),
    [
        ("nm;R (%);G (%);B (%)", "quantum_efficiencies", [0.5, 0.4, 0.3]),
        ("nm;red [A/W];green [A/W];blue [A/W]", "sensitivities", [50, 40, 30]),
        ("nm;red [µA/W];green [μA/W];blue [uA/W]", "sensitivities", [50e-6, 40e-6, 30e-6]),
        ("Wavelength;Red;Green;Blue\nnm;%;%;%", "transmittances", [0.5, 0.4, 0.3]),
    ],
)
def test_units_of_channels(title: str, name: str, expected: list[float], tmp_path: Path) -> None:
    rows = "\n".join(f"{nm};50;40;30" for nm in range(700, 399, -20))
    colour: dict = {name: written(tmp_path, f"{title}\n{rows}\n")}
    if name == "sensitivities":
        colour["peak_quantum_efficiency"] = 0.6
    curves = getattr(Pixel(colour=colour).colour, name)
    assert [curve[0] for curve in curves.values()] == [(400.0, value) for value in expected]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("400,0.3\n350,0.4\n500,0.4", "400 nm followed by 350 nm"),
        (
            "0.4,0.3\n0.5,0.4\n",
            "Multiply wavelengths in µm by 1000, or state the unit in the title",
        ),
        ("4000,0.3\n5000,0.4\n", "These seem to be in Å"),
        ("400000,0.3\n500000,0.4\n", "These seem to be in pm"),
        (
            "wavelength (µm),QE\n400,0.3\n500,0.4\n",
            "These seem to be in nm, though the title says µm",
        ),
        ("400,30\n500,40\n", "In per cent? Divide percentages by 100"),
        ("nm,mA/W\n400,310000\n500,200\n", "In mA/W? Or relative values?"),
        ("energy (eV),QE\n2.1,0.3\n2.5,0.4\n", "in eV, according to its title"),
        ("400,0,3\n500,0,4\n", "commas between columns and within numbers"),
        ("nm;R (%);G;B\n400;30;.4;.5\n700;30;.4;.5\n", "some columns in per cent and others not"),
        ("400,-0.1\n500,0.4\n", "-0.1 at 400 nm"),
        ("400,nan\n500,0.4\n", "nan at 400 nm"),
        ("400,1e999\n500,1", "inf at 400 nm"),
        ("400,0\n500,0\n", "0 at every wavelength"),
        ("400,0.3\n", "of 1 points"),
        ("", "of 0 points"),
        ("400,0.3\nfive hundred,0.4\n", "no two numbers in line 2"),
        ("400;0.3\n500;much\n", "line 2"),
        ("400\n500\n", "no two numbers in line 1"),
        ("1.400,0;0,3\n", "no two numbers in line 1"),
        ("0.3,400\n30,500\n", "0.3 nm followed by 30 nm"),
        ("\0", "which is no text"),
        ("a,b\n1", "line 2"),
        ("400,1\n" * 2, "400 nm followed by 400 nm"),
        ('400,"' + "x" * 200_000, "field larger"),
        ("4" * 10**6 + ",1", "file with wavelength in nm"),
    ],
)
def test_what_cannot_be_a_curve_is_refused_with_the_likely_cause(
    text: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="allowed") as error:
        (as_curves("transmittances", 1.0) if text.startswith("nm;") else read_curve)(
            written(tmp_path, text)
        )
    assert message in str(error.value)


def test_stated_per_cent_are_obeyed_and_small_ones_are_noted(tmp_path: Path) -> None:
    path = written(tmp_path, "nm,QE (%)\n400,0.3\n500,0.4\n")
    with pytest.warns(UserWarning, match=r"states per cent, and no value is above 0\.4 %"):
        assert read_curve(path) == ((400.0, 0.003), (500.0, 0.004))


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("λ;R;G\nnm;A/W;A/W\n400;1;2\n", [("R", "A/W"), ("G", "A/W")]),
        ("λ;S1;S2\nnm;R;A/W\n400;1;2\n", [("R", ""), ("A/W", "A/W")]),
    ],
)
def test_title_of_units_alone_leaves_the_names(text: str, columns, tmp_path: Path) -> None:
    table = read_table(written(tmp_path, text), "curve", "a table", 2, 1000)
    assert [(column.title, column.unit) for column in table.columns] == columns


@pytest.mark.parametrize(
    ("wavelengths", "stated", "hint"),
    [
        ([400.0, 700.0], "", ""),
        ([5.0, 7.0], "", ""),
        ([], "", ""),
        ([0.4, 0.7], "", "in µm. Multiply wavelengths in µm by 1000"),
        ([4e-7, 7e-7], "", "in m."),
        ([4e5, 7e5], "µm", "in nm, though the header says µm"),
    ],
)
def test_unit_that_wavelengths_seem_to_have(
    wavelengths: list[float], stated: str, hint: str
) -> None:
    text = unit_hint(wavelengths, (300.0, 1200.0), stated, "the header")
    assert (hint in text) if hint else (text == "")
