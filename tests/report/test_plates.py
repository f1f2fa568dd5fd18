"""Figures: the drawn values equal their tables, and both are reproducible byte for byte."""

from __future__ import annotations

import csv
import html
import io
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import joblib
import numpy as np
import pytest
from helpers.looks import lines_without_rows
from helpers.tiny import PITCHES_UM, TINY
from scipy.ndimage import gaussian_filter, map_coordinates

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.report.curve import delta_e_against_pitch
from pixsim.report.paper import figure_6
from pixsim.report.pictures import picture_axes
from pixsim.report.score import score_plate
from pixsim.report.study import (
    light_against_detail,
    optimum_against_technology,
    study_drawing,
    study_page,
)
from pixsim.scene.charts import DIE_MM
from pixsim.show.figures import ISO_SMOOTHING_DOTS
from pixsim.show.pages import Plate
from pixsim.show.render import html as page_html
from pixsim.studies.claims import Evidence, size_maps
from pixsim.studies.design import pixel_of
from pixsim.studies.engine import Workers
from pixsim.studies.merit import mpe30_lx_s, scene_to_display_mtf, system_mtf
from pixsim.studies.result import StudyResult
from pixsim.studies.table import COLUMNS, Table


@pytest.fixture(scope="module")
def evidence(tiny_result: StudyResult) -> Evidence:
    return Evidence(tiny_result, {curve.technology: curve for curve in tiny_result.curves})


@pytest.fixture(scope="module")
def plates(evidence: Evidence) -> dict[str, Plate]:
    result, curve = evidence.result, evidence.result.curves[0]
    processes = [
        replace(curve, technology=f"{feature_um:g}um", feature_size_um=feature_um)
        for feature_um in (0.35, 0.18, 0.5, 0.25)
    ]
    score = size_maps(result, 8.0, curve.technology, 2).score
    plates = [
        figure_6(evidence),
        light_against_detail(result, evidence.curves["0.35um"]),
        delta_e_against_pitch([curve]),
        delta_e_against_pitch(result.curves).named("delta_e_against_pitch_all"),
        score_plate(score),
        optimum_against_technology(replace(result, curves=tuple(processes))),
    ]
    return {plate.name: plate for plate in plates}


# --- tables
# -----------------------------------------------------------------------------------------------------------

UNITS = ("_um", "_db", "_mm", "_lx_s", "_lp_per_mm", "_delta_e", "_um2")
# Ratios, names and counts; frequencies in a column's name are with their unit.
WITHOUT_UNIT = re.compile(
    r"technology|row|rows|columns|delta_e_column_\d+|sensor|contrast|fill_factor|"
    r"optimum_features|(delta_e|contrast|[a-z]+_mtf)_at_[\d.]+_lp_per_mm"
)


def test_plate_csv_is_complete_with_units(plates: dict[str, Plate]) -> None:
    """Each number is written to its last digit, and each line that is drawn is there."""
    for name, plate in plates.items():
        assert lines_without_rows(plate) == [], name
        header, *rows = csv.reader(io.StringIO(plate.csv))
        assert header == list(plate.table)
        assert {len(row) for row in rows} == {len(header)}, name
        for column, values in zip(header, zip(*rows, strict=True), strict=True):
            assert column.endswith(UNITS) or WITHOUT_UNIT.fullmatch(column), f"{name}: {column}"
            if column != "technology":
                assert [float(value) for value in values] == list(plate.table[column]), column


def column(plate: Plate, name: str) -> np.ndarray:
    return np.array(plate.table[name])


def test_coarse_table_conserves_mean(plates: dict[str, Plate], evidence: Evidence) -> None:
    """Cells differ by a dot in their sides, so the sum is weighted by their sizes."""
    plate, picture, cells = plates["delta_e"], evidence.sizes[8.0].score.delta_e, (64, 64)
    table = np.stack([column(plate, item) for item in plate.table][1:], axis=1)
    assert table.shape == cells
    sizes = [
        [item.size for item in np.array_split(np.arange(dots), parts)]
        for dots, parts in zip(picture.shape, cells, strict=True)
    ]
    assert (table * np.outer(*sizes)).sum() / picture.size == pytest.approx(
        picture.mean(), rel=1e-12
    )


def test_figure_6_points_lie_on_level(plates: dict[str, Plate], evidence: Evidence) -> None:
    plate = plates["figure_6_iso_delta_e"]
    pitch_um, frequency, contrast = (
        column(plate, name) for name in ("pitch_um", "frequency_lp_per_mm", "contrast")
    )
    assert set(pitch_um) <= {5.3, 6.0, 8.0, 15.0}
    assert len(set(pitch_um)) >= 2
    assert 0.99 <= frequency.min() < frequency.max() <= 33.4
    assert 0.0095 <= contrast.min() < contrast.max() <= 0.952
    cut = (120 - evidence.maps[8.0].shape[0]) / 2
    assert cut == 1, "a border of 15 µm is one dot of 22.6 µm"
    smooth = gaussian_filter(evidence.maps[8.0], ISO_SMOOTHING_DOTS, mode="nearest")
    here = pitch_um == 8.0
    x = np.log(frequency[here]) / np.log(1e3 / 30) * 120 - cut - 0.5
    y = (1 - np.log(contrast[here] / (975 / 1025)) / np.log(0.01)) * 120 - cut - 0.5
    level = map_coordinates(smooth, [y, x], order=1, mode="nearest")
    # The contour is drawn by lines between samples: off by the curvature within one.
    np.testing.assert_allclose(level, TINY["iso_delta_e"], rtol=0.02)


def test_light_against_detail_holds_closed_forms(
    plates: dict[str, Plate], tiny_result: StudyResult
) -> None:
    plate = plates["light_against_detail"]
    pitch_um = np.array(PITCHES_UM)
    mtf50, display_mtf50, mpe30 = (
        column(plate, name) for name in ("mtf50_lp_per_mm", "shown_mtf50_lp_per_mm", "mpe30_lx_s")
    )
    assert column(plate, "pitch_um").tolist() == PITCHES_UM
    assert (np.diff(mtf50) < 0).all()
    assert (np.diff(mpe30) < 0).all()
    # MTF50 is read off lines between frequencies less than 0.01 lp/mm apart: far less than 1e-6 off
    physics = pixsim.derive(pixel_of(tiny_result.study, "0.35um", 7.0))
    for frequency, mtf in ((mtf50[2], system_mtf), (display_mtf50[2], scene_to_display_mtf)):
        assert mtf(tiny_result, physics, np.array(frequency)) == pytest.approx(0.5, abs=1e-6)
    assert mpe30[2] == pytest.approx(mpe30_lx_s(tiny_result, physics), rel=1e-12)

    # The terms at 1000/30 lp/mm; neither the lens nor the dots know the pixel
    terms = {
        name: column(plate, f"{name}_mtf_at_33.3_lp_per_mm")
        for name in ("lens", "photodiode", "interpolation", "dot", "shown")
    }
    product = np.prod([mtf for name, mtf in terms.items() if name != "shown"], axis=0)
    np.testing.assert_allclose(terms["shown"], product, rtol=1e-12)
    np.testing.assert_allclose(terms["interpolation"], np.sinc(pitch_um / 30) ** 2, rtol=1e-12)
    assert np.ptp(terms["lens"]) == np.ptp(terms["dot"]) == 0


def test_curve_table_matches_study(plates: dict[str, Plate], tiny_result: StudyResult) -> None:
    curve = tiny_result.curves[0]
    plate = plates["delta_e_against_pitch"]
    assert column(plate, "pitch_um").tolist() == PITCHES_UM
    np.testing.assert_allclose(
        column(plate, "mean_delta_e"), curve.delta_e.mean(axis=1), rtol=1e-12
    )
    np.testing.assert_allclose(
        column(plate, "p99_delta_e"), curve.statistics["p99_delta_e"].mean(axis=1), rtol=1e-12
    )
    # Six pairs: variances of half their squared distances, pooled in proportion to the mean; t of 6
    # degrees is 2.446912.
    mean, distance = curve.delta_e.mean(axis=1), np.ptp(curve.delta_e, axis=1)
    relative = np.sqrt((distance**2 / 2).sum() / (mean**2).sum())
    np.testing.assert_allclose(
        column(plate, "ci95_delta_e"), 2.446912 * relative * mean / np.sqrt(2), rtol=1e-6
    )


# --- axes


@pytest.mark.parametrize("die_mm", [DIE_MM, 1.0, 5.0])
def test_picture_axes_of_the_chart_are_frequencies_and_contrasts(die_mm: float) -> None:
    """The chart runs from f0 = 1 to f1 = 33.3 lp/mm over its 2.7136 mm, x/width = ln(f/f0)/ln(f1/f0),
    and from a hundredth of its largest contrast of 0.951 at equal ratios.
    """
    light = SpectralImage(
        [550.0], [10.0], 1e3 * die_mm / 64, data=np.ones((64, 64, 1)), header={"scene": "csf.xml"}
    )
    axes = picture_axes(light)
    for ticks, lowest, ratio in (
        (axes.across.ticks, DIE_MM / die_mm, 100 / 3),
        (axes.down.ticks, 975 / 1025 / 100, 100.0),
    ):
        assert len(ticks) >= 3
        values = np.array([float(text) for _, text in ticks])
        places_mm = np.log(values / lowest) / np.log(ratio) * die_mm
        # Labels have three digits
        assert [place for place, _ in ticks] == pytest.approx(places_mm, abs=1e-3 * die_mm)


# --- workers
# ----------------------------------------------------------------------------------------------------------

WORKER = """
import sys
import joblib
from pixsim.report.study import PictureTask, make_pictures
result = joblib.load(sys.argv[1])
for task in (PictureTask("0.35um", 0.0), PictureTask("0.35um", 8.0)):
    make_pictures((0, task), result)
print(*sorted({"matplotlib", "pandas", "mitsuba"} & set(sys.modules)))
"""


def test_workers_that_make_pictures_import_no_matplotlib(
    tiny_result: StudyResult, tmp_path: Path
) -> None:
    joblib.dump(tiny_result, tmp_path / "result")
    command = [sys.executable, "-c", WORKER, str(tmp_path / "result")]
    assert (
        subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=300
        ).stdout.split()
        == []
    )


def test_page_that_is_begun_while_workers_evaluate_is_the_same(tiny_result: StudyResult) -> None:
    result = replace(tiny_result, study=tiny_result.study.model_copy(update={"paper": True}))
    pages = []
    for begins in (False, True):
        with study_drawing() as drawing:
            if begins:
                drawing.begin(replace(result, curves=()))
                drawing.wait()
            pages.append(page_html(study_page(result, Workers(), drawing)))
            assert all(maps.done() and not maps.cancelled() for maps in drawing.sizes.values())
            assert len(drawing.sizes) == 4 * begins
    assert pages[0] == pages[1]


# --- files
# ------------------------------------------------------------------------------------------------------------


def test_figure_in_a_page_is_the_file_drawn(plates: dict[str, Plate]) -> None:
    """As a browser reads the attribute: the same elements with the same values."""
    drawn = plates["delta_e"].drawn()
    attribute = html.unescape(str(drawn.image))
    assert '"' not in attribute
    page, file = (
        [
            (element.tag, {name: value.split() for name, value in element.attrib.items()})
            for element in ElementTree.fromstring(svg).iter()
        ]
        for svg in (unquote(attribute.partition(",")[2]), drawn.svg)
    )
    assert page == file
    assert unquote(html.unescape(str(drawn.data)).partition(",")[2]) == drawn.csv


def test_page_of_a_table_has_means_over_sensors_and_all_rows(tmp_path: Path) -> None:
    """Two cases: two sensors of 5 µm and one of 7.5 µm; one of 5 µm, and two of 7.5 µm, of which
    one has no number.
    """
    columns = {
        "pitch_um": np.array([5.0, 5.0, 7.5, 5.0, 7.5, 7.5]),
        "repeat": np.array([0, 1, 0, 0, 0, 1], np.int32),
        **dict.fromkeys(COLUMNS[4:], np.array([1.0, 3.0, 2.0, 5.0, 7.0, np.nan])),
    }
    cases = {"technology": "a"}, {"technology": "b"}
    table = Table(cases, np.array([0, 0, 0, 1, 1, 1], np.int32), columns)
    page = table.write(tmp_path)
    assert "4 pixels, means over 2 sensors of each" in page.read_text(encoding="utf-8")
    written = (tmp_path / "table.csv").read_text(encoding="utf-8")
    assert written == table.to_csv().replace("\r\n", "\n")
    text = (tmp_path / "figures/metric.csv").read_text(encoding="utf-8")
    rows = [
        (row["technology"], row["pitch_um"], row["mean_delta_e"])
        for row in csv.DictReader(text.splitlines())
    ]
    assert [(name, float(pitch)) for name, pitch, _ in rows] == [
        ("a", 5),
        ("a", 7.5),
        ("b", 5),
        ("b", 7.5),
    ]
    np.testing.assert_array_equal([float(mean) for *_, mean in rows], [2.0, 2.0, 5.0, np.nan])
