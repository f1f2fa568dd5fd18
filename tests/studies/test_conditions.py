"""One pixel for several conditions, against closed forms of parabolas in the logarithm of the pitch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pixsim.report.axes import conditions_plate, conditions_table
from pixsim.report.wording import compromise_answer
from pixsim.show.document import plain_text
from pixsim.studies.conditions import Compromise, Regret, compromise, compromises_of, weighted_mean
from pixsim.studies.optimum import Optimum, fit_curve
from pixsim.studies.result import Curve, fit_of_metric
from pixsim.studies.study_settings import Study
from pixsim.viewer.metric_registry import metrics_named

PITCH_UM = np.geomspace(4.0, 12.0, 9)
NAMES = ("day", "night", "never")
CONDITIONS = [
    {"name": name, "weight": weight, "set": {"resolution": 48}} for name, weight in zip(NAMES, (3.0, 1.0, 0.0), strict=True)
]
SHEET = {"full_well_e": 1e4, "read_noise_e": 2.0, "dark_current_e_per_s": 1.0, "quantum_efficiency": 0.6}
STUDY = Study.model_validate({"name": "x", "pixel": SHEET | {"data_sheet_pitch_um": 5.0}, "condition": CONDITIONS})


def parabola(best_um: float, least: float, bend: float, pitch_um: np.ndarray = PITCH_UM) -> np.ndarray:
    return least + bend * np.log(pitch_um / best_um) ** 2


def curve(condition: str, mean: np.ndarray, scatter: float, seed: int = 0, sensors: int = 4) -> Curve:
    noise = np.random.default_rng(seed).standard_normal((PITCH_UM.size, sensors))
    noise -= noise.mean() * (scatter < 1e-3)
    delta_e = mean[:, None] * (1 + scatter * noise)
    fit, statistics = fit_curve(PITCH_UM, delta_e), {"mean_delta_e": delta_e}
    label = f"data sheet, {condition}"
    return Curve("none", 0.35, PITCH_UM, np.ones(PITCH_UM.size), statistics, fit, label, condition=condition)


def curves_of(*means: np.ndarray, scatter: float = 1e-6, seed: int = 0) -> list[Curve]:
    """Of day, night and never, as far as there are means."""
    return [curve(name, mean, scatter, seed + n) for n, (name, mean) in enumerate(zip(NAMES, means, strict=False))]


def exact() -> list[Curve]:
    return curves_of(parabola(5.0, 0.3, 0.8), parabola(9.0, 0.9, 0.4), parabola(11.0, 5.0, 9.0))


def found_in(found: Compromise) -> tuple[Optimum, Regret]:
    assert found.best is not None
    assert found.regret is not None
    return found.best, found.regret


def of_two_parabolas(found: Compromise, day: tuple[float, float], night: tuple[float, float]) -> None:
    """Check with closed forms: values at the best of 5 and of 9 µm, and bends, of which a negative one is of a maximum.

    Weighted mean: a parabola whose vertex is the mean of the logarithms with weights × bends. Regret: where both are equal,
    √day (u - ln 5) = √night (ln 9 - u).
    """
    best, regret = found_in(found)
    values, bends = np.transpose([day, night])

    def between_um(of_day: float, of_night: float) -> float:
        return float(np.exp((of_day * np.log(5.0) + of_night * np.log(9.0)) / (of_day + of_night)))

    best_um, equal_um = between_um(*(bends * (0.75, 0.25))), between_um(*np.sqrt(np.abs(bends)))
    assert best.pitch_um == pytest.approx(best_um, rel=0.003)  # of the spline between nine sizes
    least = np.dot((0.75, 0.25), values + bends * np.log(best_um / np.array([5.0, 9.0])) ** 2)
    assert best.value == pytest.approx(least, rel=1e-3)
    assert regret.pitch_um == pytest.approx(equal_um, rel=0.003)
    assert regret.delta_e == pytest.approx(abs(bends[0]) * np.log(equal_um / 5.0) ** 2, rel=0.02)
    low_um, high_um = regret.interval_um
    assert low_um is not None
    assert high_um is not None
    assert low_um <= regret.pitch_um <= high_um  # though drawn curves are taken at fewer places than the fitted one
    assert high_um / low_um < 1.02
    regrets = found.regrets_at(equal_um)
    assert regrets["day"] == pytest.approx(regrets["night"], rel=0.02)


def test_compromise_of_parabolas_matches_closed_forms() -> None:
    """The condition without weight does not count."""
    (found,) = compromises_of(STUDY, exact())
    assert found.weights == (0.75, 0.25, 0.0)
    of_two_parabolas(found, (0.3, 0.8), (0.9, 0.4))
    assert found.regrets_at(found_in(found)[1].pitch_um)["never"] > 1.0


def test_compromise_by_a_metric_of_which_more_is_better_matches_closed_forms() -> None:
    heights = {"day": (5.0, 30.0, -8.0), "night": (9.0, 20.0, -4.0)}
    curves, metrics = [], metrics_named(["information", "delta_e"])
    for own in exact()[:2]:
        noise = np.random.default_rng(1).standard_normal((PITCH_UM.size, 4))
        values = parabola(*heights[own.condition])[:, None] * (1 + 1e-6 * noise)
        fit = fit_of_metric(metrics[0], PITCH_UM, values, np.asarray)
        assert fit is not None
        statistics = {"information": values, "mean_delta_e": own.delta_e}
        curves.append(replace(own, fit=fit, fits={"delta_e": own.fit}, metrics=metrics, statistics=statistics))
    study = STUDY.model_copy(update={"condition": STUDY.condition[:2]})
    (found,) = compromises_of(study, curves)
    of_two_parabolas(found, (30.0, -8.0), (20.0, -4.0))
    (alone,) = compromises_of(study, exact()[:2])
    assert found.others["delta_e"].as_dict() == alone.as_dict()
    assert "greatest weighted information" in plain_text(compromise_answer(found).head)
    assert set(conditions_table([found])["metric"]) == {"information", "delta_e"}


def test_compromise_single_condition_is_its_own_optimum() -> None:
    study = STUDY.model_copy(update={"condition": STUDY.condition[:1]})
    (found,) = compromises_of(study, exact()[:1])
    best, regret = found_in(found)
    assert best.pitch_um == pytest.approx(found.curves[0].optimum.pitch_um, rel=1e-9)
    assert regret.pitch_um == pytest.approx(best.pitch_um, rel=2e-3)
    assert regret.delta_e == pytest.approx(0.0, abs=1e-5)
    assert found.as_dict()["conditions"]["day"]["weight"] == 1.0


def test_compromise_best_at_an_end_is_open() -> None:
    curves = curves_of(parabola(3.0, 0.3, 0.8), parabola(3.5, 0.9, 0.4), scatter=1e-4)
    best, regret = found_in(compromise(STUDY, curves, [0.5, 0.5]))
    assert not best.inside
    assert not regret.inside
    assert regret.interval_um[0] is None


def test_compromise_few_common_sizes_is_none() -> None:
    day, night = exact()[:2]
    less = PITCH_UM + 0.01
    less[:4] = PITCH_UM[:4]
    other = replace(night, pitch_um=less, fit=fit_curve(less, night.delta_e))
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
        both.append(replace(exact()[0], statistics={"mean_delta_e": delta_e}, condition=name))
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
        curves = curves_of(parabola(5.0, 0.3, 0.8), parabola(9.0, 0.9, 0.4), scatter=0.05, seed=10 * number)
        regret = compromise(STUDY, curves, [0.5, 0.5]).regret
        assert regret is not None
        low, high = regret.interval_um
        held += (low or 0.0) <= truth <= (high or np.inf)
    assert held >= 0.88 * STUDIES


def test_conditions_plate_and_tables_have_the_numbers() -> None:
    (found,) = compromises_of(STUDY, exact())
    best, regret = found_in(found)
    plate = conditions_plate(found, 1)
    assert plate.name == "conditions_1"
    labels = " ".join(text.get_text() for text in plate.figure.axes[0].get_legend().get_texts())
    for size in (best.pitch_um, regret.pitch_um, found.curves[0].optimum.pitch_um):
        assert f"{size:.2f} µm" in labels
    assert plate.table["condition"] == ["day"] * 9 + ["night"] * 9 + ["never"] * 9
    table = conditions_table([found])
    assert table["pixel_of"] == ["day", "night", "never", "least weighted mean ΔE", "least worst regret"]
    assert table["pitch_um"][3:] == [best.pitch_um, regret.pitch_um]
    assert table["worst_regret_delta_e"][4] == regret.delta_e
    line = "; ".join(map(plain_text, ((answer := compromise_answer(found)).head, *answer.below)))
    assert f"least worst regret {regret.delta_e:.3f} ΔE, in {regret.condition}, at {regret.pitch_um:.2f} µm" in line
