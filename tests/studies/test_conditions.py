"""One pixel for several conditions, against closed forms of parabolas in the logarithm of the pitch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pixsim.report.axes import conditions_plate, conditions_table
from pixsim.report.wording import compromise_answer
from pixsim.show.document import plain_text
from pixsim.studies.conditions import compromise, compromises_of, weighted_mean
from pixsim.studies.optimum import fit_curve
from pixsim.studies.result import Curve, fit_of_metric
from pixsim.studies.study_settings import Study
from pixsim.viewer.metric_registry import metrics_named

PITCH_UM = np.geomspace(4.0, 12.0, 9)
CONDITIONS = [
    {"name": name, "weight": weight, "set": {"resolution": 48}} for name, weight in (("day", 3.0), ("night", 1.0), ("never", 0.0))
]
SHEET = {
    "data_sheet_pitch_um": 5.0,
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}
STUDY = Study.model_validate({"name": "x", "pixel": SHEET, "condition": CONDITIONS})


def parabola(best_um: float, least: float, bend: float, pitch_um: np.ndarray = PITCH_UM) -> np.ndarray:
    return least + bend * np.log(pitch_um / best_um) ** 2


def curve(condition: str, mean: np.ndarray, scatter: float, seed: int = 0, sensors: int = 4) -> Curve:
    noise = np.random.default_rng(seed).standard_normal((PITCH_UM.size, sensors))
    noise -= noise.mean() * (scatter < 1e-3)
    delta_e = mean[:, None] * (1 + scatter * noise)
    fit = fit_curve(PITCH_UM, delta_e)
    return Curve(
        "none",
        0.35,
        PITCH_UM,
        np.ones(PITCH_UM.size),
        {"mean_delta_e": delta_e},
        fit,
        f"data sheet, {condition}",
        condition=condition,
    )


def exact(scatter: float = 1e-6) -> list[Curve]:
    means = parabola(5.0, 0.3, 0.8), parabola(9.0, 0.9, 0.4), parabola(11.0, 5.0, 9.0)
    return [
        curve(name, mean, scatter, seed) for seed, (name, mean) in enumerate(zip(("day", "night", "never"), means, strict=True))
    ]


def test_compromise_of_parabolas_matches_closed_forms() -> None:
    """Weighted mean: a parabola whose vertex is the mean of the logarithms with weights × bends. Regret: where both are equal."""
    (found,) = compromises_of(STUDY, exact())
    assert found.weights == (0.75, 0.25, 0.0)
    assert found.best is not None
    assert found.regret is not None
    day, night = 0.75 * 0.8, 0.25 * 0.4
    expected_um = np.exp((day * np.log(5.0) + night * np.log(9.0)) / (day + night))
    assert found.best.pitch_um == pytest.approx(expected_um, rel=0.003)  # of the spline between nine sizes
    least = float(0.75 * parabola(5.0, 0.3, 0.8, expected_um) + 0.25 * parabola(9.0, 0.9, 0.4, expected_um))
    assert found.best.mean_delta_e == pytest.approx(least, rel=1e-3)
    # √.8 (u - ln 5) = √.4 (ln 9 - u); the condition without weight does not count.
    a, b = np.sqrt(0.8), np.sqrt(0.4)
    equal_um = np.exp((a * np.log(5.0) + b * np.log(9.0)) / (a + b))
    assert found.regret.pitch_um == pytest.approx(equal_um, rel=0.003)
    assert found.regret.delta_e == pytest.approx(0.8 * np.log(equal_um / 5.0) ** 2, rel=0.02)
    low_um, high_um = found.regret.interval_um
    assert low_um <= found.regret.pitch_um <= high_um  # though drawn curves are taken at fewer places than the fitted one
    assert high_um / low_um < 1.02
    regrets = found.regrets_at(equal_um)
    assert regrets["day"] == pytest.approx(regrets["night"], rel=0.02)
    assert regrets["never"] > 1.0


def test_compromise_by_a_metric_of_which_more_is_better_matches_closed_forms() -> None:
    """Of values: the weighted mean of two parabolas, and the size at which both are as far below their best."""
    heights = {"day": (5.0, 30.0, 8.0), "night": (9.0, 20.0, 4.0)}
    curves = []
    for own in exact()[:2]:
        best_um, most, bend = heights[own.condition]
        values = parabola(best_um, most, -bend)[:, None] * (1 + 1e-6 * np.random.default_rng(1).standard_normal((PITCH_UM.size, 4)))
        metrics = metrics_named(["information", "delta_e"])
        fit = fit_of_metric(metrics[0], PITCH_UM, values, np.asarray)
        assert fit is not None
        statistics = {"information": values, "mean_delta_e": own.delta_e}
        curves.append(replace(own, fit=fit, fits={"delta_e": own.fit}, metrics=metrics, statistics=statistics))
    study = STUDY.model_copy(update={"condition": STUDY.condition[:2]})
    (found,) = compromises_of(study, curves)
    assert found.best is not None
    assert found.regret is not None
    day, night = 0.75 * 8.0, 0.25 * 4.0
    expected_um = np.exp((day * np.log(5.0) + night * np.log(9.0)) / (day + night))
    assert found.best.pitch_um == pytest.approx(expected_um, rel=0.003)
    most = float(0.75 * parabola(5.0, 30.0, -8.0, expected_um) + 0.25 * parabola(9.0, 20.0, -4.0, expected_um))
    assert found.best.value == pytest.approx(most, rel=1e-3)
    a, b = np.sqrt(8.0), np.sqrt(4.0)
    equal_um = np.exp((a * np.log(5.0) + b * np.log(9.0)) / (a + b))
    assert found.regret.pitch_um == pytest.approx(equal_um, rel=0.003)
    assert found.regret.delta_e == pytest.approx(8.0 * np.log(equal_um / 5.0) ** 2, rel=0.02)
    low_um, high_um = found.regret.interval_um
    assert low_um is not None
    assert high_um is not None
    assert low_um <= found.regret.pitch_um <= high_um
    (alone,) = compromises_of(study, exact()[:2])
    assert found.others["delta_e"].as_dict() == alone.as_dict()
    assert "greatest weighted information" in plain_text(compromise_answer(found).head)
    assert set(conditions_table([found])["metric"]) == {"information", "delta_e"}


def test_compromise_single_condition_is_its_own_optimum() -> None:
    study = STUDY.model_copy(update={"condition": STUDY.condition[:1]})
    (found,) = compromises_of(study, exact()[:1])
    assert found.best is not None
    assert found.regret is not None
    assert found.best.pitch_um == pytest.approx(found.curves[0].optimum.pitch_um, rel=1e-9)
    assert found.regret.pitch_um == pytest.approx(found.best.pitch_um, rel=2e-3)
    assert found.regret.delta_e == pytest.approx(0.0, abs=1e-5)
    assert found.as_dict()["conditions"]["day"]["weight"] == 1.0


def test_compromise_best_at_an_end_is_open() -> None:
    means = [parabola(3.0, 0.3, 0.8), parabola(3.5, 0.9, 0.4)]
    curves = [curve(name, mean, 1e-4, seed) for seed, (name, mean) in enumerate(zip(("day", "night"), means, strict=True))]
    found = compromise(STUDY, curves, [0.5, 0.5])
    assert found.best is not None
    assert found.regret is not None
    assert not found.best.inside
    assert not found.regret.inside
    assert found.regret.interval_um[0] is None


def test_compromise_few_common_sizes_is_none() -> None:
    day, night = exact()[:2]
    less = PITCH_UM + 0.01
    less[:4] = PITCH_UM[:4]
    other = Curve(
        "none", 0.35, less, night.fill_factor, night.statistics, fit_curve(less, night.delta_e), night.label, condition="night"
    )
    found = compromise(STUDY, [day, other], [0.5, 0.5])
    assert (found.best, found.regret) == (None, None)


def test_compromise_without_one_of_the_conditions_is_none() -> None:
    """A study may leave out the case of a condition: what suits the others is not what suits all."""
    (day, night), weights = exact()[:2], [0.5, 0.5]
    assert compromise(STUDY, [day, night], weights).best is not None
    alone = compromise(STUDY, [day], weights[:1])
    assert (alone.best, alone.regret) == (None, None)


def test_weighted_mean_pairs_sensors() -> None:
    """A scatter that two conditions share with opposite signs cancels: sensors are added one by one."""
    noise = np.random.default_rng(1).standard_normal((PITCH_UM.size, 4))
    both = []
    for name, sign in (("day", 1.0), ("night", -1.0)):
        delta_e = 1.0 + 0.1 * sign * noise
        statistics, fit = {"mean_delta_e": delta_e}, exact()[0].fit
        both.append(Curve("none", 0.35, PITCH_UM, np.ones(PITCH_UM.size), statistics, fit, condition=name))
    pitches_um, mean = weighted_mean([(both[0], 0.5), (both[1], 0.5)])
    assert pitches_um.tolist() == PITCH_UM.tolist()
    np.testing.assert_allclose(mean, 1.0, atol=1e-12)


STUDIES = 60


@pytest.mark.slow
def test_regret_interval_coverage() -> None:
    """In at least 88 % of the studies: 95 % intervals of 60 miss that with a probability of 1 % (binomial)."""
    truth = np.exp((np.sqrt(0.8) * np.log(5.0) + np.sqrt(0.4) * np.log(9.0)) / (np.sqrt(0.8) + np.sqrt(0.4)))
    held = 0
    for number in range(STUDIES):
        means = parabola(5.0, 0.3, 0.8), parabola(9.0, 0.9, 0.4)
        curves = [
            curve(name, mean, 0.05, 10 * number + n) for n, (name, mean) in enumerate(zip(("day", "night"), means, strict=True))
        ]
        regret = compromise(STUDY, curves, [0.5, 0.5]).regret
        assert regret is not None
        low, high = regret.interval_um
        held += (low or 0.0) <= truth <= (high or np.inf)
    assert held >= 0.88 * STUDIES


def test_conditions_plate_and_tables_have_the_numbers() -> None:
    (found,) = compromises_of(STUDY, exact())
    assert found.best is not None
    assert found.regret is not None
    plate = conditions_plate(found, 1)
    assert plate.name == "conditions_1"
    assert plate.caption.startswith("Data sheet: least weighted mean ΔE ")
    for size in (found.best.pitch_um, found.regret.pitch_um, found.curves[0].optimum.pitch_um):
        assert f"{size:.2f} µm" in plate.caption
    assert plate.table["condition"] == ["day"] * 9 + ["night"] * 9 + ["never"] * 9
    table = conditions_table([found])
    assert table["pixel_of"] == ["day", "night", "never", "least weighted mean ΔE", "least worst regret"]
    assert table["pitch_um"][3:] == [found.best.pitch_um, found.regret.pitch_um]
    assert table["worst_regret_delta_e"][4] == found.regret.delta_e
    line = "; ".join(map(plain_text, ((answer := compromise_answer(found)).head, *answer.below)))
    assert (
        f"least worst regret {found.regret.delta_e:.3f} ΔE, in {found.regret.condition}, at {found.regret.pitch_um:.2f} µm" in line
    )
