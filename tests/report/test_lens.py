"""`pixsim lens`: its figures, and its numbers by the command line and in Python."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from helpers.commands import command
from helpers.lenses import triplet
from helpers.looks import lines_without_rows

import pixsim
from pixsim.base.schema import SCHEMA
from pixsim.measure.lens import lens_data
from pixsim.report.lens import lens_document


def test_figures_show_lines_of_their_tables_and_texts_inside() -> None:
    """With labels of three decimals."""
    data = lens_data(pixsim.load_lens("double_gauss").scaled(0.005), [486.1, 656.3])
    for plate in (plot.draw() for plot in lens_document(data).plots):
        assert lines_without_rows(plate) == [], plate.name
        plate.figure.canvas.draw()
        width, height = plate.figure.canvas.get_width_height()
        inside = plate.figure.get_tightbbox().transformed(plate.figure.dpi_scale_trans)
        assert min(inside.x0, inside.y0) >= 0, plate.name
        assert inside.x1 <= width, plate.name
        assert inside.y1 <= height, plate.name


def test_csv_has_a_row_for_each_field() -> None:
    data = triplet()
    rows = list(csv.DictReader(io.StringIO(data.to_csv())))
    fields = data.as_dict()["fields"]
    assert [float(row["rms_spot_um"]) for row in rows] == [field["rms_spot_um"] for field in fields]
    assert [float(row["mtf_sagittal_30_lp_per_mm"]) for row in rows] == [
        field["mtf"][1]["sagittal"] for field in fields
    ]


def test_command_and_python_write_the_same_files(tmp_path: Path) -> None:
    """Byte for byte; JSON without NaN, also for a lens whose only field is the axis."""
    options = "--object-distance-m 1 --field-deg 0 --wavelength-nm 500 --wavelength-nm 600"
    code, out, err = command(f"lens singlet {options} --json --out", tmp_path / "out")
    assert code == 0, err
    assert "NaN" not in out
    data = pixsim.lens(
        "singlet", object_distance_m=1.0, field_deg=0.0, wavelength_nm=[500.0, 600.0]
    )
    content = {"schema": SCHEMA} | json.loads(json.dumps(data.as_dict()))
    assert json.loads(out) == content
    pixsim.write_report(data, tmp_path / "python")
    paths = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert len(paths) > 10
    for path in paths:
        name = path.relative_to(tmp_path / "out")
        if name.name != "pixsim.json":  # it states times
            assert (tmp_path / "python" / name).read_bytes() == path.read_bytes(), name

    # Newton: f²/(s − f) farther from the lens than for an object at infinity
    focal_mm = pixsim.load_lens("singlet").first_order(587.5618).focal_length_mm
    expected_mm = 47.67 + focal_mm**2 / (1000 - focal_mm)
    assert content["image_distance_mm"] == pytest.approx(expected_mm, abs=1.0), "refocused"
