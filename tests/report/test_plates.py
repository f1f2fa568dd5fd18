"""Figures: the drawn values equal their tables, and both are reproducible byte for byte."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import joblib
import numpy as np
import pytest
from helpers.chains import imaging
from helpers.looks import grey_look, lines_without_rows
from helpers.tiny import PITCHES_UM, TINY
from matplotlib.axes import Axes
from matplotlib.image import imread
from scipy.ndimage import gaussian_filter, map_coordinates

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.report.curve import delta_e_against_pitch
from pixsim.report.paper import figure_6
from pixsim.report.pictures import MAX_TICKS, picture_axes
from pixsim.report.score import score_plate
from pixsim.report.study import (
    light_against_detail,
    optimum_against_technology,
    study_drawing,
    study_page,
)
from pixsim.scene.charts import DIE_MM
from pixsim.sensor.motion_options import Motion
from pixsim.show.figures import ISO_SMOOTHING_DOTS, label_axes, new_figure, pixsim_style, svg_text
from pixsim.show.pages import Plate
from pixsim.show.render import html as page_html
from pixsim.studies.claims import Evidence, size_maps
from pixsim.studies.design import pixel_of
from pixsim.studies.engine import Workers
from pixsim.studies.merit import (
    detail_terms,
    mpe30_lx_s,
    mtf50_cy_per_mm,
    scene_to_display_mtf,
    system_mtf,
)
from pixsim.studies.optimum import Optimum
from pixsim.studies.result import StudyResult

OPTIMA_UM = {0.5: 8.8, 0.35: 6.5, 0.25: 5.3, 0.18: 3.9}


@pytest.fixture(scope="module")
def evidence(tiny_result: StudyResult) -> Evidence:
    return Evidence(tiny_result, {curve.technology: curve for curve in tiny_result.curves})


def optimum(size_um: float, least: float, inside: bool = True) -> Optimum:
    """A minimum that is known to 2 %, 5 % upwards."""
    interval_um = 0.98 * size_um, 1.05 * size_um if inside else None
    return Optimum(
        size_um,
        interval_um,
        least,
        (0.99 * least, 1.01 * least),
        inside,
        0.2,
        (6.6, 8.4),
        (6.1, None),
    )


def scaled(result: StudyResult) -> StudyResult:
    """Four technologies with known optima, not in their order."""
    first, curves = result.curves[0], []
    for feature_um in (0.35, 0.18, 0.5, 0.25):
        fit = replace(first.fit, optimum=optimum(OPTIMA_UM[feature_um], 0.5))
        curves.append(
            replace(first, technology=f"{feature_um:g}um", feature_size_um=feature_um, fit=fit)
        )
    return replace(result, curves=tuple(curves))


def every_plate(evidence: Evidence) -> dict[str, Plate]:
    result, curve = evidence.result, evidence.result.curves[0]
    score = size_maps(result, 8.0, curve.technology, 2).score
    plates = [
        figure_6(evidence),
        light_against_detail(result, evidence.curves["0.35um"]),
        delta_e_against_pitch([curve]),
        delta_e_against_pitch(result.curves).named("delta_e_against_pitch_all"),
        score_plate(score),
        optimum_against_technology(scaled(result)),
    ]
    return {plate.name: plate for plate in plates}


@pytest.fixture(scope="module")
def plates(evidence: Evidence) -> dict[str, Plate]:
    return every_plate(evidence)


@pytest.fixture(scope="module")
def saved(plates: dict[str, Plate]) -> dict[str, str]:
    """Name -> SVG."""
    return {name: svg_text(plate.figure) for name, plate in plates.items()}


# --- tables
# -----------------------------------------------------------------------------------------------------------

UNITS = ("_um", "_db", "_mm", "_lx_s", "_lp_per_mm", "_delta_e", "_um2")
# Ratios, names and counts; frequencies in a column's name are with their unit.
WITHOUT_UNIT = re.compile(
    r"technology|row|rows|columns|delta_e_column_\d+|sensor|contrast|fill_factor|"
    r"optimum_features|(delta_e|contrast|[a-z]+_mtf)_at_[\d.]+_lp_per_mm"
)


def test_tables_hold_the_lines_drawn(plates: dict[str, Plate]) -> None:
    assert {
        name: lines for name, plate in plates.items() if (lines := lines_without_rows(plate))
    } == {}


def test_plate_csv_is_complete_with_units(plates: dict[str, Plate]) -> None:
    for name, plate in plates.items():
        header, *rows = csv.reader(io.StringIO(plate.csv))
        assert header == list(plate.table)
        assert len(set(header)) == len(header)
        assert rows, name
        assert {len(row) for row in rows} == {len(header)}, name
        for column, values in zip(header, zip(*rows, strict=True), strict=True):
            assert column.endswith(UNITS) or WITHOUT_UNIT.fullmatch(column), (
                f"{name}: {column} has no unit"
            )
            if column != "technology":
                read = [float(value) for value in values]
                assert read == list(plate.table[column]), (
                    f"{name}: {column} is not written to its last digit"
                )
                assert not np.isnan(read).any()


@pixsim_style()
def test_plate_csv_unequal_columns_raise() -> None:
    with pytest.raises(ValueError, match="shorter"):
        _ = Plate("odd", "", new_figure(1, 1), {"a": [1.0, 2.0], "b": [1.0]}).csv


def column(plate: Plate, name: str) -> np.ndarray:
    return np.array(plate.table[name])


def lines(plate: Plate, panel: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """(x, y) of every line of an axes, the first if nothing else is asked for."""
    return [
        (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in plate.figure.axes[panel].lines
    ]


def is_drawn(plate: Plate, x: np.ndarray, y: np.ndarray, panel: int = 0) -> bool:
    return any(
        len(a) == len(x) and np.array_equal(a, x) and np.array_equal(b, y)
        for a, b in lines(plate, panel)
    )


def test_light_against_detail_one_to_one_has_no_display_terms(tiny_result: StudyResult) -> None:
    display = tiny_result.study.display.model_copy(update={"raster": "one_to_one"})
    as_is = replace(tiny_result, study=tiny_result.study.model_copy(update={"display": display}))
    plate = light_against_detail(as_is, tiny_result.curves[0])
    assert not {name for name in plate.table if name.startswith(("interpolation", "dot"))}
    np.testing.assert_allclose(
        column(plate, "shown_mtf50_lp_per_mm"), column(plate, "mtf50_lp_per_mm"), rtol=1e-12
    )


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


def test_light_against_detail_values(plates: dict[str, Plate], tiny_result: StudyResult) -> None:
    plate = plates["light_against_detail"]
    mtf50, mpe30 = column(plate, "mtf50_lp_per_mm"), column(plate, "mpe30_lx_s")
    assert column(plate, "pitch_um").tolist() == PITCHES_UM
    assert (np.diff(mtf50) < 0).all()
    assert (np.diff(mpe30) < 0).all()
    physics = pixsim.derive(pixel_of(tiny_result.study, "0.35um", 7.0))
    assert mtf50[2] == pytest.approx(mtf50_cy_per_mm(tiny_result, physics), rel=1e-12)
    shown50 = column(plate, "shown_mtf50_lp_per_mm")
    # MTF50 is read off lines between frequencies less than 0.01 lp/mm apart: far less than 1e-6
    # off.
    for at, mtf in ((mtf50[2], system_mtf), (shown50[2], scene_to_display_mtf)):
        assert mtf(tiny_result, physics, np.array(at)) == pytest.approx(0.5, abs=1e-6)
    assert (shown50 < mtf50).all()
    for values in (mtf50, shown50):
        assert is_drawn(plate, np.array(PITCHES_UM), values)
    assert mpe30[2] == pytest.approx(mpe30_lx_s(tiny_result, physics), rel=1e-12)


def test_light_against_detail_draws_terms(
    plates: dict[str, Plate], tiny_result: StudyResult
) -> None:
    plate = plates["light_against_detail"]
    terms = [
        column(plate, f"{name}_mtf_at_33.3_lp_per_mm")
        for name in ("lens", "photodiode", "interpolation", "dot")
    ]
    shown = column(plate, "shown_mtf_at_33.3_lp_per_mm")
    np.testing.assert_allclose(shown, np.prod(terms, axis=0), rtol=1e-12)
    for values in (*terms, shown):
        assert is_drawn(plate, np.array(PITCHES_UM), values, panel=1)
    np.testing.assert_allclose(
        terms[2], np.sinc(np.array(PITCHES_UM) / 30) ** 2, rtol=1e-12
    )  # f p at 1000/30 lp/mm
    assert np.ptp(terms[0]) == np.ptp(terms[3]) == 0, "neither the lens nor the dots know the pixel"
    light = tiny_result.irradiance
    header = light.header | {"scene": "mine.xml"}
    mine = SpectralImage(
        light.wavelength_nm,
        light.band_width_nm,
        light.pitch_um,
        factors=light.factors,
        header=header,
    )
    elsewhere = replace(tiny_result, light=replace(tiny_result.light, image=mine))
    curve = tiny_result.curves[0]
    nyquist = 1e3 / (2 * curve.optimum.pitch_um)
    assert (
        f"lens_mtf_at_{nyquist / 2:.3g}_lp_per_mm" in light_against_detail(elsewhere, curve).table
    )


def test_light_against_detail_has_the_path_of_what_moves(tiny_result: StudyResult) -> None:
    """170 µm/s in the time of its exposure, |sinc(f v t)|."""
    motion = Motion(image_um_per_s=(0.0, -170.0))
    moving, curve = (
        replace(tiny_result, study=tiny_result.study.model_copy(update={"motion": motion})),
        tiny_result.curves[0],
    )
    plate = light_against_detail(moving, curve)
    path_mm = 0.17 * curve.mean("integration_s")
    assert path_mm.max() > 5e-4
    along = column(plate, "motion_mtf_at_33.3_lp_per_mm")
    np.testing.assert_allclose(along, np.abs(np.sinc(path_mm * 1e3 / 30)), rtol=1e-12)
    assert is_drawn(plate, np.array(PITCHES_UM), along, panel=1)
    mtf50, physics = (
        column(plate, "mtf50_lp_per_mm")[2],
        pixsim.derive(pixel_of(tiny_result.study, "0.35um", 7.0)),
    )
    left = system_mtf(tiny_result, physics, np.array(mtf50)) * np.sinc(path_mm[2] * mtf50)
    assert left == pytest.approx(0.5, abs=1e-6)
    asked = imaging(moving.camera, physics.pixel, display=moving.study.display)
    *_, sensor_terms, _ = detail_terms(asked, moving.irradiance, 1e3 * path_mm[2])
    assert sensor_terms["motion"] == pytest.approx(along[2], rel=1e-12)


def test_optimum_against_technology_values(plates: dict[str, Plate]) -> None:
    plate = plates["optimum_against_technology"]
    feature_um = column(plate, "feature_size_um")
    assert feature_um.tolist() == sorted(OPTIMA_UM)
    assert column(plate, "optimum_um").tolist() == [OPTIMA_UM[item] for item in feature_um]
    np.testing.assert_allclose(column(plate, "proportional_um"), feature_um * 8.8 / 0.5, rtol=1e-12)
    np.testing.assert_allclose(
        column(plate, "optimum_features"), column(plate, "optimum_um") / feature_um, rtol=1e-12
    )
    assert is_drawn(plate, feature_um, column(plate, "proportional_um"))
    # From 2 % below to 5 % above.
    reach = [
        np.ptp([y for _, y in bar])
        for group in plate.figure.axes[0].collections
        for bar in group.get_segments()
    ]
    sizes = np.array([OPTIMA_UM[item] for item in feature_um])
    np.testing.assert_allclose(sorted(reach), sorted(0.07 * sizes), rtol=1e-9)


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


# --- words
# ------------------------------------------------------------------------------------------------------------


def curve_with(result: StudyResult, mean: Sequence[float], best: Optimum) -> StudyResult:
    curve = result.curves[0]
    own = curve.delta_e.mean(axis=1, keepdims=True)
    statistics = {
        name: values / own * np.array(mean)[:, None] for name, values in curve.statistics.items()
    }
    return replace(
        result,
        curves=(replace(curve, statistics=statistics, fit=replace(curve.fit, optimum=best)),),
    )


def test_delta_e_against_pitch_names_the_optimum(tiny_result: StudyResult) -> None:
    actual = curve_with(tiny_result, [1.0, 0.8, 0.6, 0.6, 0.7, 0.9], optimum(7.5, 0.6))
    (axes,) = delta_e_against_pitch(actual.curves).figure.axes
    assert [item.get_text() for item in axes.get_legend().get_texts()] == [
        "0.35um: 7.50 µm (95 %: 7.35 to 7.88 µm)"
    ]


def test_delta_e_against_pitch_without_optimum_has_no_labels(tiny_result: StudyResult) -> None:
    actual = curve_with(
        tiny_result, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5], optimum(15.0, 0.5, inside=False)
    )
    plate = delta_e_against_pitch(actual.curves)
    assert [item.get_text() for item in plate.figure.axes[0].get_legend().get_texts()] == ["0.35um"]


# --- axes
# -------------------------------------------------------------------------------------------------------------


@pixsim_style()
def axes_for(width: int, height: int, pitch_um: float, header: dict[str, object]) -> Axes:
    irradiance = SpectralImage(
        [550.0], [10.0], pitch_um, data=np.ones((height, width, 1)), header=header
    )
    axes = new_figure(3, 3).subplots()
    label_axes(axes, picture_axes(irradiance))
    return axes


@pytest.mark.parametrize("die_mm", [DIE_MM, 1.0, 5.0])
def test_picture_axes_csf_frequencies(die_mm: float) -> None:
    """The chart runs from f0 = 1 to f1 = 33.3 lp/mm over its 2.7136 mm: x/width =
    ln(f/f0)/ln(f1/f0).
    """
    axes = axes_for(64, 64, 1e3 * die_mm / 64, {"scene": "csf.xml"})
    lowest, highest = DIE_MM / die_mm, DIE_MM / die_mm * 100 / 3
    message = [label.get_text() for label in axes.get_xticklabels()]
    assert message[:: len(message) - 1] == [f"{lowest:.3g}", f"{highest:.3g}"]
    assert len(message) >= 5
    expected = np.log(np.array(message, float) / lowest) / np.log(highest / lowest) * die_mm
    assert axes.get_xticks() == pytest.approx(
        expected, abs=1e-3 * die_mm
    )  # labels have three digits
    assert "lp/mm" in axes.get_xlabel()


def test_picture_axes_csf_contrasts() -> None:
    """A hundredth of the largest contrast on top, 0.951 below, at equal ratios."""
    axes = axes_for(64, 64, 42.4, {"scene": "csf.xml"})
    message = np.array([label.get_text() for label in axes.get_yticklabels()], float)
    expected = (1 + np.log(message / (975 / 1025)) / np.log(100)) * 64 * 0.0424
    assert axes.get_yticks() == pytest.approx(expected, abs=1e-3)
    assert message[-1] == 0.951
    assert axes.get_ylabel() == "contrast, (max − min) / (max + min)"


@pytest.mark.parametrize(
    "header", [{"scene": "flat.xml"}, {"scene": "csf.xml", "parameters": {"chart": "mine.exr"}}, {}]
)
def test_picture_axes_other_scene_shows_position(header: dict[str, object]) -> None:
    axes = axes_for(32, 16, 10.0, header)
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "x on the sensor (mm)",
        "y on the sensor (mm)",
    )


@pytest.mark.parametrize(
    ("die_mm", "texts"),
    [(2.7136, "0 0.5 1 1.5 2 2.5"), (6.0, "0 1 2 3 4 5 6"), (0.0119, "0 0.002 0.004")],
)
def test_picture_axes_ticks_are_round(die_mm, texts):
    axes = picture_axes(SpectralImage([550.0], 10.0, 1e3 * die_mm / 16, data=np.ones((8, 16, 1))))
    ticks = axes.across.ticks
    assert " ".join(text for _, text in ticks).startswith(texts)
    assert all(at == pytest.approx(float(text)) for at, text in ticks)
    assert 3 <= len(ticks) <= MAX_TICKS
    assert max(ticks[-1][0], 2 * axes.down.ticks[-1][0]) <= die_mm * (1 + 1e-6)


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


@pytest.mark.slow
def test_svg_text_is_reproducible(evidence: Evidence, saved: dict[str, str]) -> None:
    assert {name: svg_text(plate.figure) for name, plate in every_plate(evidence).items()} == saved


def test_svg_text_has_its_targets_and_images(saved: dict[str, str]) -> None:
    images = 0
    for name, svg in saved.items():
        targets = re.findall(r'\bid="([^"]+)"', svg)
        assert len(set(targets)) == len(targets), f"{name}: an id stands twice"
        references = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', svg))
        assert {one or other for one, other in references} <= set(targets), name
        assert references, name
        # Matplotlib's own ids end in ten digits of a hash of coordinates.
        assert not re.search(r'id="[^"]*[0-9a-f]{10}"', svg), name
        for kind, data in re.findall(r'href="data:image/(\w+);base64,\s*([^"]+)"', svg):
            picture = imread(
                io.BytesIO(base64.b64decode("".join(data.split()), validate=True)), format=kind
            )
            assert min(picture.shape[:2]) > 1, name
            images += 1
    assert images >= 3  # the ideal image, the sensor's and the ΔE map


def test_figure_in_a_page_is_the_file_drawn(plates: dict[str, Plate]) -> None:
    """As a browser reads the attribute: the same elements, and pictures with the same pixels as
    Matplotlib writes.
    """
    drawn = plates["delta_e"].drawn()
    attribute = html.unescape(str(drawn.image))
    assert '"' not in attribute
    text = unquote(attribute.partition(",")[2])
    page, file = (
        [
            (each.tag, {name: value.split() for name, value in each.attrib.items()})
            for each in ElementTree.fromstring(svg).iter()
        ]
        for svg in (text, drawn.svg)
    )
    assert page == file
    assert unquote(html.unescape(str(drawn.data)).partition(",")[2]) == drawn.csv


def test_plates_lines_differ_in_grey(plates: dict[str, Plate]) -> None:
    """All lines named in a legend differ."""
    compared = 0
    for name, plate in plates.items():
        handles = [
            item
            for axes in plate.figure.axes
            if axes.get_legend()
            for item in axes.get_legend().get_lines()
        ]
        looks = [grey_look(item) for item in handles]
        assert len(set(looks)) == len(looks), name
        compared += len(looks)
    assert compared > 10


def test_plates_axes_have_labels(plates: dict[str, Plate]) -> None:
    for name, plate in plates.items():
        for axes in plate.figure.axes:
            label = axes.get_xlabel() + axes.get_ylabel()
            assert label, name
            assert any(
                unit in label
                for unit in ("µm", "mm", "dB", "ΔE", "lx", " over ", "(%)", "(max", "dots")
            ), f"{name}: {label}"
