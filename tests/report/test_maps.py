"""Figures of a study's axes: numbers of closed-form optima, what captions say, and what a figure
leaves out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.looks import lines_without_rows
from helpers.tiny import tiny

import pixsim
from pixsim.report import maps
from pixsim.show.figures import pixsim_style
from pixsim.show.pages import Plate
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.design import cases_of
from pixsim.studies.lights import Light
from pixsim.studies.optimum import FittedCurve, fit_curve
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis

PITCH_UM = np.geomspace(2.0, 16.0, 7)
LIGHT = pixsim.SpectralImage([550.0], 10.0, 21.2, data=np.ones((8, 8, 1)), header={})
# of ΔE in the square of the logarithm of the pitch, around a least ΔE of 1: no curve is fitted by
# its logarithm
BEND = 0.3
Optima = Callable[[dict[str, Any], str, str], float]


@cache
def fitted(optimum_um: float, least: float) -> tuple[np.ndarray, FittedCurve]:
    """Mean ΔE = least (1 + BEND ln² (p/optimum)) of two sensors, with a scatter far below the
    gates, and its fit.
    """
    mean = least * (1 + BEND * np.log(PITCH_UM / optimum_um) ** 2)
    delta_e = mean[:, None] * np.array([1 - 1e-4, 1 + 1e-4])
    return delta_e, fit_curve(PITCH_UM, delta_e)


def result_of(optima_um: Optima, least: Optima = lambda *_: 1.0, **study: Any) -> StudyResult:
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


def optimum_um(at: dict[str, Any], condition: str, technology: str) -> float:
    """Falls with the light, rises with the f-number, and is larger at night and in 0.5 µm."""
    larger = (1.3 if condition == "night" else 1.0) * (1.2 if technology == "0.5um" else 1.0)
    return larger * 7.0 * at.get("luminance", 1.0) ** -0.1 * (at.get("lens", 4.0) / 4.0) ** 0.4


def least(at: dict[str, Any], condition: str, technology: str) -> float:
    return 2.0 * at.get("luminance", 1.0) ** -0.2


@pytest.fixture(scope="module")
def two_axes() -> StudyResult:
    return result_of(optimum_um, least, axis=[LUMINANCE, LENS], condition=DAY_AND_NIGHT)


@pytest.fixture(scope="module")
def plates(two_axes: StudyResult) -> dict[str, Plate]:
    return {plate.name: plate for plate in maps.axis_plates(two_axes)}


def rows_of(plate: Plate) -> list[dict[str, Any]]:
    return [
        dict(zip(plate.table, values, strict=True))
        for values in zip(*plate.table.values(), strict=True)
    ]


def expected_um(row: dict[str, Any]) -> float:
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
    result = result_of(optimum_um, lambda at, *_: at["luminance"] ** 0.2, axis=[light, LENS])
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


def moved_um(at: dict[str, Any], condition: str, technology: str) -> float:
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
