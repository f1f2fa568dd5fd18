"""`pixsim lens`: its figures, and its numbers by the command line and in Python."""

from __future__ import annotations

import csv
import io
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.lenses import triplet
from helpers.looks import lines_without_rows

import pixsim
from pixsim.base.schema import SCHEMA
from pixsim.measure.lens import lens_data
from pixsim.report.lens import lens_document


def test_tables_hold_the_lines_drawn() -> None:
    data = lens_data(pixsim.load_lens("double_gauss"), [486.1, 656.3])
    drawn = [plot.draw() for plot in lens_document(data).plots]
    assert {plate.name: lines for plate in drawn if (lines := lines_without_rows(plate))} == {}


@pytest.mark.parametrize(("name", "scale"), [("singlet", 1.0), ("double_gauss", 0.005)])
def test_texts_of_figures_lie_inside_and_apart(name: str, scale: float) -> None:
    """With labels of three digits and a sign, and of three decimals."""
    data = lens_data(pixsim.load_lens(name).scaled(scale), [486.1, 656.3])
    for plate in (plot.draw() for plot in lens_document(data).plots):
        plate.figure.canvas.draw()
        width, height = plate.figure.canvas.get_width_height()
        inside = plate.figure.get_tightbbox().transformed(plate.figure.dpi_scale_trans)
        assert min(inside.x0, inside.y0) >= 0, plate.name
        assert inside.x1 <= width, plate.name
        assert inside.y1 <= height, plate.name
        labels = []
        for axes in plate.figure.axes:
            view = axes.get_window_extent().padded(1)
            for axis, side in ((axes.xaxis, "intervalx"), (axes.yaxis, "intervaly")):
                boxes = [
                    label.get_window_extent()
                    for label in axis.get_ticklabels()
                    if label.get_text() and label.get_visible()
                ]
                (low, high), middles = (
                    getattr(view, side),
                    [np.mean(getattr(box, side)) for box in boxes],
                )
                labels += [
                    box for box, middle in zip(boxes, middles, strict=True) if low <= middle <= high
                ]  # the others are not drawn
        assert len(labels) > 3
        for one, other in itertools.combinations(labels, 2):
            assert not one.overlaps(other), (plate.name, one, other)


def test_mtf50_is_where_the_lower_mtf_falls_below_one_half() -> None:
    data = triplet()
    for lower, end_lp_per_mm in zip(data.mtf.min(axis=1), data.mtf50_lp_per_mm, strict=True):
        place = data.frequency_lp_per_mm.tolist().index(end_lp_per_mm)
        assert (lower[:place] >= 0.5).all()
        assert lower[place] < 0.5


def test_csv_has_a_row_for_each_field() -> None:
    data = triplet()
    rows = list(csv.DictReader(io.StringIO(data.to_csv())))
    fields = data.as_dict()["fields"]
    assert [float(row["rms_spot_um"]) for row in rows] == [field["rms_spot_um"] for field in fields]
    assert [float(row["mtf_sagittal_30_lp_per_mm"]) for row in rows] == [
        field["mtf"][1]["sagittal"] for field in fields
    ]


def test_json_has_no_nan_and_options_change_the_lens(tmp_path: Path) -> None:
    """Also for a lens whose only field is the axis."""
    line = (
        "lens singlet --object-distance-m 1 --field-deg 0 --wavelength-nm 500 --wavelength-nm 600"
        " --json --out"
    )
    code, out, err = command(line, tmp_path / "out")
    assert code == 0, err

    def refuse(constant: str) -> Any:
        raise AssertionError(constant)

    content = json.loads(out, parse_constant=refuse)
    assert content["object_distance_mm"] == 1000.0
    assert [each["field_deg"] for each in content["fields"]] == [0.0]
    assert [each["wavelength_nm"] for each in content["first_order"]] == [500.0, 600.0]
    made = pixsim.lens(
        "singlet", object_distance_m=1.0, field_deg=0.0, wavelength_nm=[500.0, 600.0]
    )
    assert content == {"schema": SCHEMA} | json.loads(json.dumps(made.as_dict()))
    assert pixsim.write_report(made, tmp_path / "python") == tmp_path / "python/report.html"
    names = {
        path.relative_to(tmp_path / "out")
        for path in (tmp_path / "out").rglob("*")
        if path.is_file()
    }
    names -= {Path("pixsim.json")}  # it states times
    assert len(names) > 10
    assert all(
        (tmp_path / "python" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
        for name in names
    )
    focal = pixsim.load_lens("singlet").first_order(587.5618).focal_length_mm
    assert content["image_distance_mm"] == pytest.approx(
        47.67 + focal**2 / (1000 - focal), abs=1.0
    ), "refocused"
