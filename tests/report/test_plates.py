"""Figures: their tables have the drawn values and those of closed forms; captions, colours and
scales; what a figure leaves out.
"""

import csv
import html
import io
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import joblib
import numpy as np
import pytest
from helpers.looks import lines_without_rows
from helpers.tiny import PITCHES_UM, TINY, tiny
from scipy.ndimage import gaussian_filter, map_coordinates

import pixsim
from pixsim.report import maps
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
from pixsim.show.figures import ISO_SMOOTHING_DOTS, pixsim_style
from pixsim.show.pages import Plate
from pixsim.show.render import html as page_html
from pixsim.studies.claims import Evidence, size_maps
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.design import cases_of, pixel_of
from pixsim.studies.engine import Workers
from pixsim.studies.lights import Light
from pixsim.studies.merit import mpe30_lx_s, scene_to_display_mtf, system_mtf
from pixsim.studies.optimum import FittedCurve, fit_curve
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis
from pixsim.studies.table import COLUMNS, Table


@pytest.fixture(scope="module")
def evidence(tiny_result: StudyResult) -> Evidence:
    return Evidence(tiny_result, {curve.technology: curve for curve in tiny_result.curves})


@pytest.fixture(scope="module")
def study_plates(evidence: Evidence) -> dict[str, Plate]:
    result, curve = evidence.result, evidence.result.curves[0]
    processes = [
        replace(curve, technology=f"{feature_um:g}um", feature_size_um=feature_um)
        for feature_um in (0.35, 0.18, 0.5, 0.25)
    ]
    study_plates = [
        figure_6(evidence),
        light_against_detail(result, evidence.curves["0.35um"]),
        delta_e_against_pitch([curve]),
        delta_e_against_pitch(result.curves).named("delta_e_against_pitch_all"),
        score_plate(size_maps(result, 8.0, curve.technology, 2).score),
        optimum_against_technology(replace(result, curves=tuple(processes))),
    ]
    return {plate.name: plate for plate in study_plates}


# --- tables
# -----------------------------------------------------------------------------------------------------------

UNITS = ("_um", "_db", "_mm", "_lx_s", "_lp_per_mm", "_delta_e", "_um2")
# Ratios, names and counts; frequencies in a column's name are with their unit.
WITHOUT_UNIT = re.compile(
    r"technology|row|rows|columns|delta_e_column_\d+|sensor|contrast|fill_factor|"
    r"optimum_features|(delta_e|contrast|[a-z]+_mtf)_at_[\d.]+_lp_per_mm"
)


def test_plate_csv_is_complete_with_units(study_plates: dict[str, Plate]) -> None:
    """Each number is written to its last digit, and each line that is drawn is there."""
    for name, plate in study_plates.items():
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


def test_coarse_table_conserves_mean(study_plates: dict[str, Plate], evidence: Evidence) -> None:
    """Cells differ by a dot in their sides, so the sum is weighted by their sizes."""
    plate, picture, cells = study_plates["delta_e"], evidence.sizes[8.0].score.delta_e, (64, 64)
    table = np.stack([column(plate, item) for item in plate.table][1:], axis=1)
    assert table.shape == cells
    sizes = [
        [item.size for item in np.array_split(np.arange(dots), parts)]
        for dots, parts in zip(picture.shape, cells, strict=True)
    ]
    assert (table * np.outer(*sizes)).sum() / picture.size == pytest.approx(
        picture.mean(), rel=1e-12
    )


def test_figure_6_points_lie_on_level(study_plates: dict[str, Plate], evidence: Evidence) -> None:
    plate = study_plates["figure_6_iso_delta_e"]
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
    study_plates: dict[str, Plate], tiny_result: StudyResult
) -> None:
    plate = study_plates["light_against_detail"]
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


def test_curve_table_matches_study(
    study_plates: dict[str, Plate], tiny_result: StudyResult
) -> None:
    curve = tiny_result.curves[0]
    plate = study_plates["delta_e_against_pitch"]
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
    light = pixsim.SpectralImage(
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


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_figure_in_a_page_is_the_file_drawn(study_plates: dict[str, Plate]) -> None:
    """As a browser reads the attribute: the same elements with the same values."""
    drawn = study_plates["delta_e"].drawn()
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


PITCH_UM = np.geomspace(2.0, 16.0, 7)
LIGHT = pixsim.SpectralImage([550.0], 10.0, 21.2, data=np.ones((8, 8, 1)), header={})
# of ΔE in the square of the logarithm of the pitch, around a least ΔE of 1: no curve is fitted by
# its logarithm
BEND = 0.3
Optima = Callable[[dict, str, str], float]


@cache
def fitted(optimum_um: float, least: float) -> tuple[np.ndarray, FittedCurve]:
    """Mean ΔE = least (1 + BEND ln² (p/optimum)) of two sensors, with a scatter far below the
    gates, and its fit.
    """
    mean = least * (1 + BEND * np.log(PITCH_UM / optimum_um) ** 2)
    delta_e = mean[:, None] * np.array([1 - 1e-4, 1 + 1e-4])
    return delta_e, fit_curve(PITCH_UM, delta_e)


def result_of(optima_um: Optima, least: Optima = lambda *_: 1.0, **study) -> StudyResult:
    """The result of a study whose optima and least mean ΔE are functions of axis values, condition
    and technology.
    """
    plan = tiny(**study)
    parts = []
    for case in cases_of(plan):
        labels = CaseLabels(at=case.at, condition=case.condition, alone=case.one_at_a_time)
        curves = []
        for name in case.settings.technologies:
            place = case.at, case.condition, name
            delta_e, fit = fitted(optima_um(*place), least(*place))
            ones = np.ones(PITCH_UM.size)
            statistics = {"mean_delta_e": delta_e}
            curves.append(Curve(name, 0.35, PITCH_UM, ones, statistics, fit, case=labels))
        parts.append(
            StudyResult(
                case.settings,
                tuple(curves),
                Light(LIGHT, pixsim.Camera(f_number=case.settings.camera.f_number or 4.0)),
            )
        )
    curves = tuple(curve for part in parts for curve in part.curves)
    return CasesResult(plan, curves, parts[0].light, parts=tuple(parts))


LUMINANCE = {
    "name": "luminance",
    "set": ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"],
    **{"from": 1.0, "to": 1000.0, "count": 4, "spacing": "log"},
}
LENS = {"name": "lens", "set": "camera.f_number", "values": [8.0, 2.8, 4.0]}  # not in order
DAY_AND_NIGHT = [
    {"name": name, "set": {"exposure": {"max_integration_s": time_s}}}
    for name, time_s in (("day", 0.01), ("night", 0.03))
]
FIT = 2e-3  # of a pitch: the curve is fitted through 7 sizes and sampled at 801


def optimum_um(at: dict, condition: str, technology: str) -> float:
    """Falls with the light, rises with the f-number, and is larger at night and in 0.5 µm."""
    larger = (1.3 if condition == "night" else 1.0) * (1.2 if technology == "0.5um" else 1.0)
    return larger * 7.0 * at.get("luminance", 1.0) ** -0.1 * (at.get("lens", 4.0) / 4.0) ** 0.4


def least(at: dict, condition: str, technology: str) -> float:
    return 2.0 * at.get("luminance", 1.0) ** -0.2


@pytest.fixture(scope="module")
def two_axes() -> StudyResult:
    return result_of(optimum_um, least, axis=[LUMINANCE, LENS], condition=DAY_AND_NIGHT)


@pytest.fixture(scope="module")
def plates(two_axes: StudyResult) -> dict[str, Plate]:
    return {plate.name: plate for plate in maps.axis_plates(two_axes)}


def rows_of(plate: Plate) -> list[dict]:
    return [
        dict(zip(plate.table, values, strict=True))
        for values in zip(*plate.table.values(), strict=True)
    ]


def expected_um(row: dict) -> float:
    at = {name: row[name] for name in ("luminance", "lens") if name in row}
    return optimum_um(at, row.get("condition", ""), row["technology"])


# --- numbers
# ----------------------------------------------------------------------------------------------------------


def test_tables_hold_closed_form_optima(plates: dict[str, Plate]) -> None:
    for name, plate in plates.items():
        assert lines_without_rows(plate) == [], name
        for row in rows_of(plate):
            assert row["optimum_um"] == pytest.approx(expected_um(row), rel=FIT), name
            assert row["inside"] == "True"
            if name.startswith("optimum"):
                assert row["interval_low_um"] < row["optimum_um"] < row["interval_high_um"]
                assert row["mean_delta_e"] == pytest.approx(least(row, "", ""), rel=1e-3)
                assert row["mean_delta_e_low"] < row["mean_delta_e"] < row["mean_delta_e_high"]


def test_map_holds_closed_form_curve_and_valley(plates: dict[str, Plate]) -> None:
    """ΔE = least (1 + BEND ln²(p/optimum)) is within 1 % of the least where |ln(p/optimum)| <
    √(0.01/BEND).
    """
    within = math.sqrt(0.01 / BEND)
    plate = plates["delta_e_by_pitch_and_luminance"]
    assert len(rows_of(plate)) == 6 * 4 * 41, "two conditions, three lenses"
    for row in rows_of(plate):
        best_um = expected_um(row)
        curve = least(row, "", "") * (1 + BEND * math.log(row["pitch_um"] / best_um) ** 2)
        assert row["mean_delta_e"] == pytest.approx(curve, rel=3e-3)
        # To a step of the fitted curve's 801 places, a factor of 1.0026.
        assert math.log(row["within_1_percent_low_um"] / best_um) == pytest.approx(
            -within, abs=0.006
        )
        assert math.log(row["within_1_percent_high_um"] / best_um) == pytest.approx(
            within, abs=0.006
        )


@pytest.mark.parametrize(
    ("high", "kind"), [(1.0, "Normalize"), (9.0, "Normalize"), (11.0, "LogNorm")]
)
def test_colours_are_logarithmic_over_a_decade(high: float, kind: str) -> None:
    across, up = maps.Scale("x", (1.0, 2.0)), maps.Scale("y", (1.0, 2.0, 3.0))
    values = np.linspace(1.0, high, 6).reshape(3, 2)
    with pixsim_style():
        _, panels = maps.draw_maps([maps.Panel("", ())], across, up, [values], [values], label="")
    norm = panels[0].collections[0].norm
    assert type(norm).__name__ == kind
    assert norm.vmin < norm.vmax
    contours = [item for item in panels[0].collections if hasattr(item, "levels")]
    assert len(contours) == (high > 1.0), "nothing rises in a map of one value"


def test_map_of_two_has_contours_of_the_best_value() -> None:
    """Of least ΔE = light^0.2 over 5 lights, along which alone it varies: contours run along the
    other axis.
    """
    light = LUMINANCE | {"count": 5}
    result = result_of(lambda *_: 6.0, lambda at, *_: at["luminance"] ** 0.2, axis=[light, LENS])
    axes = maps.axis_plates(result)[-1].figure.axes[0]
    (contours,) = (item for item in axes.collections if hasattr(item, "levels"))
    for level, segments in zip(contours.levels, contours.allsegs, strict=True):
        points = np.concatenate(segments)  # a label parts a line
        places = np.interp(level, 10 ** (0.2 * np.linspace(0, 3, 5)), np.arange(5.0))
        np.testing.assert_allclose(points[:, 0], places, atol=2e-2)


LIGHTS = {
    "name": "light",
    "set": "scene.parameters.luminance_cd_per_m2",
    "values": [1.0, 10.0, 100.0],
}


# --- what a figure leaves out
# -------------------------------------------------------------------------------------------


def test_thinning_states_itself(two_axes: StudyResult, plates: dict[str, Plate]) -> None:
    """2 conditions × 4 luminances are 8 lines: the first 6 are drawn."""
    first_six = {*product(["day"], [1.0, 10.0, 100.0, 1000.0]), *product(["night"], [1.0, 10.0])}
    plate = plates["optimum_by_lens"]
    assert plate.figure.get_suptitle() == "6 of 8 lines or panels"
    assert {(row["condition"], row["luminance"]) for row in rows_of(plate)} == first_six
    assert len(plate.figure.legends[0].get_texts()) == maps.MAX_PANELS
    assert not plates["optimum_by_luminance"].figure.get_suptitle(), "6 lines are all"


@pytest.mark.parametrize(
    ("values", "log"),
    [((1.0, 10.0, 100.0), True), ((1.0, 3.0, 10.0, 30.0), True), ((1.0, 6.0, 9.0), False), ((2.8, 4.0, 5.6, 8.0), False),
     ((-1.0, 0.0, 100.0), False), ((0.0, 1.0, 100.0), False), ((4.0,), False), ((100.0, 1.0, 10.0), True)],
)  # fmt: skip
def test_scale_of_listed_values_is_logarithmic_over_a_decade(
    values: tuple[float, ...], log: bool
) -> None:
    scale = maps.Scale.of(Axis(name="x", set=("pixel.dsnu",), values=values))
    assert scale.log == log
    assert scale.values == tuple(sorted(values))
    assert (np.diff(scale.edges) > 0).all()
    assert ((scale.edges[:-1] < scale.places) & (scale.places < scale.edges[1:])).all()
    between = (
        np.sqrt(scale.places[1:] * scale.places[:-1])
        if log
        else (scale.places[1:] + scale.places[:-1]) / 2
    )
    np.testing.assert_allclose(scale.edges[1:-1], between)


# --- optima that are not known
# ------------------------------------------------------------------------------------------


def test_optima_at_an_end_are_hollow_and_hatched() -> None:
    """The optimum of 100 µm at the largest f-number lies beyond the 16 µm tried."""
    optics = LENS | {"values": [2.8, 4.0, 8.0]}
    result = result_of(lambda at, *_: 100.0 if at["lens"] == 8.0 else 6.0, axis=[optics, LIGHTS])
    along, _, _, _, two = maps.axis_plates(result)
    lines = along.figure.axes[0].lines
    arrows = [
        line
        for line in lines
        if line.get_marker() == "^"
        and line.get_zorder() == 5
        and line.get_markerfacecolor() != "white"
    ]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in arrows] == [(8.0, 16.0)] * 3, (
        "one for each light"
    )
    hollow = [line for line in lines if line.get_markerfacecolor() == "white"]
    assert [tuple(line.get_xdata()) for line in hollow] == [(8.0,)] * 3
    rows = rows_of(along)
    ends = {(row["interval_high_um"], row["inside"]) for row in rows if row["lens"] == 8.0}
    assert ends == {("", "False")}
    hatched = {patch.get_xy() for patch in two.figure.axes[0].patches if patch.get_hatch()}
    assert hatched == {(1.5, light - 0.5) for light in range(3)}


# --- names
# --------------------------------------------------------------------------------------------------------------


def test_names_of_columns_and_files_are_unique() -> None:
    """Also of axes that are called as columns are, or as each other but for case, spaces and other
    scripts.
    """
    axes = [
        {"name": "optimum_um", "set": "pixel.prnu", "values": [0.01, 0.02]},
        {"name": "Optimum_um", "set": "camera.f_number", "values": [4.0, 5.0]},
        {"name": "$x$ <b>/..", "set": "pixel.bits", "values": [10, 12]},
    ]
    result = result_of(lambda *_: 6.0, axis=axes)
    plates = maps.axis_plates(result)
    names = [plate.name for plate in plates]
    assert len({name.casefold() for name in names}) == len(names) == 2 * 3 + 3
    assert names == maps.plate_names(result.study)
    assert all(re.fullmatch(r"[\w.\-]+", name, re.ASCII) for name in names)
    for plate in plates:
        assert all(
            np.isfinite(row["optimum_um"]) and row["optimum_um"] > 5.9 for row in rows_of(plate)
        ), "not the axis' value"
        assert {row["optimum_um_2"] for row in rows_of(plate)} <= {0.01, 0.02}


# --- axes moved alone
# ---------------------------------------------------------------------------------------------------

ALONE = [
    {"name": "prnu", "set": "pixel.prnu", "values": [0.005, 0.03], "alone": True},
    {"name": "read noise", "set": "pixel.read_noise_e", "values": [1.0, 5.0, 20.0], "alone": True},
]


def moved_um(at: dict, condition: str, technology: str) -> float:
    moved = {"prnu": {0.005: 0.99, 0.03: 1.05}, "read noise": {1.0: 0.9, 5.0: 1.1, 20.0: 1.4}}
    night = 1.3 if condition == "night" else 1.0
    return (
        5.0
        * night
        * math.prod(moved[name].get(value, 1.0) for name, value in at.items() if name in moved)
    )


def test_alone_plate_has_a_bar_of_each_axis_about_the_base() -> None:
    """The widest first, with the values of the axis at their ends."""
    axes = [*ALONE, LENS | {"values": [4.0]}]
    plate = maps.one_at_a_time_plate(result_of(moved_um, axis=axes, condition=DAY_AND_NIGHT))
    rows = rows_of(plate)
    assert [row["axis"] for row in rows] == 2 * ["base", *["read noise"] * 3, *["prnu"] * 2]
    for row in rows:
        expected_um = moved_um({row["axis"]: row["value"]}, row["condition"], "")
        assert row["optimum_um"] == pytest.approx(expected_um, rel=FIT)

    (panel,) = plate.figure.axes
    bars = [(time, name) for name in ("read noise", "prnu") for time in ("night", "day")]
    for patch, label, bar in zip(panel.patches, panel.get_yticklabels(), bars, strict=True):
        assert label.get_text().removesuffix(" (electrons)") == ", ".join(bar)
        sizes_um = [
            row["optimum_um"]
            for row in rows
            if row["condition"] == bar[0] and row["axis"] in ("base", bar[1])
        ]
        ends_um = patch.get_x(), patch.get_x() + patch.get_width()
        assert ends_um == pytest.approx((min(sizes_um), max(sizes_um)))
    assert {text.get_text() for text in panel.texts} == {"1", "20", "0.005", "0.03"}
