"""One pixel for several conditions, against closed forms of parabolas in the logarithm of the
pitch.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pixsim.report.axes import regrets_columns
from pixsim.report.regret import condition_regrets_data, regrets_plate, regrets_tables
from pixsim.report.wording import weighted_answer
from pixsim.show.document import plain_text
from pixsim.show.render import lines
from pixsim.studies.curve import CaseLabels, Curve
from pixsim.studies.optimum import fit_curve, fit_of_metric
from pixsim.studies.regret import (
    Criterion,
    Regrets,
    condition_regrets,
    weighted_criterion,
    weighted_fit,
    weighted_mean,
)
from pixsim.studies.settings import Study
from pixsim.viewer.metric_registry import metrics_named

PITCH_UM = np.geomspace(4.0, 12.0, 9)
NAMES = ("day", "night", "never")
CONDITIONS = [
    {"name": name, "weight": weight, "set": {"resolution": 48}}
    for name, weight in zip(NAMES, (3.0, 1.0, 0.0), strict=True)
]
SHEET = {
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}
STUDY = Study.model_validate(
    {"name": "x", "pixel": SHEET | {"data_sheet_pitch_um": 5.0}, "condition": CONDITIONS}
)


def parabola(best_um: float, least: float, bend: float, pitch_um: Any = PITCH_UM) -> Any:
    return least + bend * np.log(pitch_um / best_um) ** 2


def curve(
    condition: str, mean: np.ndarray, scatter: float, seed: int = 0, sensors: int = 4
) -> Curve:
    noise = np.random.default_rng(seed).standard_normal((PITCH_UM.size, sensors))
    noise -= noise.mean() * (scatter < 1e-3)
    delta_e = mean[:, None] * (1 + scatter * noise)
    fit, statistics = fit_curve(PITCH_UM, delta_e), {"mean_delta_e": delta_e}
    label = f"data sheet, {condition}"
    return Curve(
        "none",
        0.35,
        PITCH_UM,
        np.ones(PITCH_UM.size),
        statistics,
        fit,
        label,
        case=CaseLabels(condition=condition),
    )


def curves_of(*means: np.ndarray, scatter: float = 1e-6, seed: int = 0) -> list[Curve]:
    """Of day, night and never, as far as there are means."""
    return [
        curve(name, mean, scatter, seed + n)
        for n, (name, mean) in enumerate(zip(NAMES, means, strict=False))
    ]


def exact() -> list[Curve]:
    return curves_of(parabola(5.0, 0.3, 0.8), parabola(9.0, 0.9, 0.4), parabola(11.0, 5.0, 9.0))


def weighted(regrets: Regrets) -> Criterion:
    criterion = weighted_criterion(regrets)
    assert criterion is not None
    return criterion


def best_of_both_um(of_day: float, of_night: float) -> float:
    """Return the vertex of the sum of two parabolas, of day at 5 µm and of night at 9 µm, with
    these weights × bends.
    """
    return float(np.exp((of_day * np.log(5.0) + of_night * np.log(9.0)) / (of_day + of_night)))


def test_weighted_mean_of_parabolas_matches_closed_form() -> None:
    """The condition without weight does not count."""
    (regrets,) = condition_regrets(STUDY, exact())
    assert [criterion.name for criterion in regrets.criteria] == [*NAMES, "weighted mean"]
    assert [criterion.weight for criterion in regrets.criteria] == [0.75, 0.25, 0.0, None]
    best, best_um = weighted(regrets).optimum, best_of_both_um(0.75 * 0.8, 0.25 * 0.4)
    assert best.pitch_um == pytest.approx(best_um, rel=0.003)  # of the spline between nine sizes
    least = 0.75 * parabola(5.0, 0.3, 0.8, best_um) + 0.25 * parabola(9.0, 0.9, 0.4, best_um)
    assert best.value == pytest.approx(least, rel=1e-3)


def test_regrets_of_parabolas_match_closed_forms() -> None:
    """A condition's value at the best size of the other one, over its least value, less 1."""
    (regrets,) = condition_regrets(STUDY, exact())
    apart = np.log(9.0 / 5.0) ** 2
    assert regrets.matrix[0, 1] == pytest.approx(
        0.8 * apart / 0.3, rel=0.01
    )  # the spline has an error of 0.3 % of the size
    assert regrets.matrix[1, 0] == pytest.approx(0.4 * apart / 0.9, rel=0.01)
    np.testing.assert_array_equal(np.diag(regrets.matrix), 0.0)


def by_information() -> tuple[Study, list[Curve]]:
    """A study of day and night, whose first metric is one of which more is better."""
    heights = {"day": (5.0, 30.0, -8.0), "night": (9.0, 20.0, -4.0)}
    curves, metrics = [], metrics_named(["information", "delta_e"])
    for own in exact()[:2]:
        noise = np.random.default_rng(1).standard_normal((PITCH_UM.size, 4))
        values = parabola(*heights[own.condition])[:, None] * (1 + 1e-6 * noise)
        fit = fit_of_metric(metrics[0], PITCH_UM, values, np.asarray)
        assert fit is not None
        statistics = {"information": values, "mean_delta_e": own.delta_e}
        curves.append(
            replace(own, fit=fit, fits={"delta_e": own.fit}, metrics=metrics, statistics=statistics)
        )
    return STUDY.model_copy(update={"condition": STUDY.condition[:2]}), curves


def test_regrets_of_a_metric_of_which_more_is_better_match_closed_forms() -> None:
    """The best value over the value, less 1."""
    information, _ = condition_regrets(*by_information())
    fall = np.log(9.0 / 5.0) ** 2
    assert information.matrix[0, 1] == pytest.approx(30.0 / (30.0 - 8.0 * fall) - 1, rel=0.02)
    assert information.matrix[1, 0] == pytest.approx(20.0 / (20.0 - 4.0 * fall) - 1, rel=0.02)
    best = weighted(information).optimum
    best_um = best_of_both_um(0.75 * 8.0, 0.25 * 4.0)
    assert best.pitch_um == pytest.approx(best_um, rel=0.003)
    assert best.value == pytest.approx(
        0.75 * parabola(5.0, 30.0, -8.0, best_um) + 0.25 * parabola(9.0, 20.0, -4.0, best_um),
        rel=1e-3,
    )
    assert "greatest weighted information" in plain_text(weighted_answer(information).head)


def test_regrets_by_a_further_metric_are_those_of_a_study_of_that_metric_alone() -> None:
    study, curves = by_information()
    _, delta_e = condition_regrets(study, curves)
    (alone,) = condition_regrets(study, exact()[:2])
    assert condition_regrets_data(delta_e) == condition_regrets_data(alone)


def test_weighted_mean_of_a_single_condition_is_its_own_optimum() -> None:
    study = STUDY.model_copy(update={"condition": STUDY.condition[:1]})
    (regrets,) = condition_regrets(study, exact()[:1])
    assert weighted(regrets).optimum.pitch_um == pytest.approx(
        regrets.criteria[0].optimum.pitch_um, rel=1e-9
    )
    np.testing.assert_allclose(regrets.matrix, 0.0, atol=1e-5)


DAY_AND_NIGHT = {"day": 0.5, "night": 0.5, "never": 0.0}


def test_weighted_mean_best_at_an_end_is_open() -> None:
    fit = weighted_fit(
        STUDY,
        curves_of(parabola(3.0, 0.3, 0.8), parabola(3.5, 0.9, 0.4), scatter=1e-4),
        DAY_AND_NIGHT,
    )
    assert fit is not None
    assert not fit.optimum.inside
    assert fit.optimum.interval_um[0] is None


def test_weighted_mean_of_few_common_sizes_is_none() -> None:
    day, night = exact()[:2]
    less = PITCH_UM + 0.01
    less[:4] = PITCH_UM[:4]
    other = replace(night, pitch_um=less, fit=fit_curve(less, night.delta_e))
    assert weighted_fit(STUDY, [day, other], DAY_AND_NIGHT) is None


def test_weighted_mean_without_one_of_the_conditions_is_none() -> None:
    """A study may leave out the case of a condition: what suits the others is not what suits
    all.
    """
    day, night = exact()[:2]
    assert weighted_fit(STUDY, [day, night], DAY_AND_NIGHT) is not None
    assert weighted_fit(STUDY, [day], DAY_AND_NIGHT) is None
    (regrets,) = condition_regrets(STUDY, [day])
    assert weighted_criterion(regrets) is None
    assert "too few pixel sizes" in str(weighted_answer(regrets).head)


def test_weighted_mean_pairs_sensors() -> None:
    """A scatter that two conditions share with opposite signs cancels: sensors are added one by
    one.
    """
    noise = np.random.default_rng(1).standard_normal((PITCH_UM.size, 4))
    both = []
    for name, sign in (("day", 1.0), ("night", -1.0)):
        delta_e = 1.0 + 0.1 * sign * noise
        both.append(
            replace(
                exact()[0], statistics={"mean_delta_e": delta_e}, case=CaseLabels(condition=name)
            )
        )
    pitches_um, mean = weighted_mean([(both[0], 0.5), (both[1], 0.5)])
    assert pitches_um.tolist() == PITCH_UM.tolist()
    np.testing.assert_allclose(mean, 1.0, atol=1e-12)


def test_tables_of_regrets_have_all_numbers_in_80_columns() -> None:
    """Of seven criteria with long names and values: six conditions and their weighted mean."""
    (information,) = metrics_named(["information"])
    ends = 1 / 5.42e5, 1 / 5.41e5
    best = replace(
        exact()[0].optimum,
        mean_delta_e=1 / 5.418e5,
        mean_delta_e_interval=ends,
        is_of_reciprocal=True,
    )
    inside = replace(best, pitch_um=10.25, interval_um=(10.11, 10.36), inside=True)
    smallest = replace(best, pitch_um=4.0, interval_um=(None, 4.5), inside=False)
    largest = replace(best, pitch_um=12.0, interval_um=(None, None), inside=False)
    share = np.geomspace(1e-3, 1.0, PITCH_UM.size)
    criteria = [
        Criterion(f"night at the gate {number}", information, optimum, PITCH_UM, share)
        for number, optimum in enumerate([inside, smallest, largest] * 2 + [inside])
    ]
    regrets = Regrets("data sheet", "condition", tuple(criteria))

    sizes, matrix = (list(lines(table, width=80)) for table in regrets_tables(regrets))
    assert max(map(len, sizes + matrix)) <= 80
    for size in ("10.25", "≤ 4.00", "≥ 12.00", "541800 bit/mm²"):
        assert any(size in line for line in sizes), size
    cells = [line.split()[-7:] for line in matrix if "–" in line]
    percent = [[0.0 if cell == "–" else float(cell) for cell in row] for row in cells]
    np.testing.assert_allclose(percent, 100 * regrets.matrix, rtol=0.05)  # two digits


def test_regrets_have_the_same_numbers_in_figure_csv_and_json() -> None:
    (regrets,) = condition_regrets(STUDY, exact())
    plate, table = regrets_plate(regrets, PITCH_UM), regrets_columns([regrets])
    assert plate.table["day regret"] == regrets.criteria[0].regret(PITCH_UM).tolist()
    assert table["best_of"] == [*NAMES, "weighted mean"]
    assert table["weight"] == [0.75, 0.25, 0.0, ""]
    assert table["pitch_um"] == [criterion.optimum.pitch_um for criterion in regrets.criteria]
    assert table["regret_at_night"] == regrets.matrix[:, 1].tolist()
    assert condition_regrets_data(regrets)["regret"] == regrets.matrix.tolist()
