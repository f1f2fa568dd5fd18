"""Regrets, weighted means, best sizes by a metric, errors of films, and shares of variance, against
closed forms.
"""

import math
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from helpers.claims import Claim
from helpers.film_pictures import light
from scipy import stats
from scipy.special import ndtri

from pixsim import Display, Study, load_technology
from pixsim.base.arrays import MEASURED
from pixsim.report.axes import regrets_columns
from pixsim.report.regret import condition_regrets_data, regrets_data, regrets_plate
from pixsim.studies.curve import CaseLabels, Curve, first_metric_and_ci95
from pixsim.studies.film_error import FilmError, FilmSteps, film_error, measured_regions, reflected
from pixsim.studies.optimum import fit_curve, fit_of_metric, fittable_pitches
from pixsim.studies.paired import mean_interval, probability_above_zero
from pixsim.studies.regret import (
    Regrets,
    condition_regrets,
    metric_regrets,
    share_of_best,
    weighted_fit,
    weighted_mean,
)
from pixsim.studies.settings import Axis
from pixsim.studies.uncertainty import (
    Probability,
    few_pitches_um,
    first_order,
    ratio_of_means,
    saltelli,
    total_indices,
    unknowns_of_technology,
)
from pixsim.viewer.metric_registry import METRICS, metrics_named

PITCH_UM = np.geomspace(4.0, 12.0, 9)
SHEET = {
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
    "data_sheet_pitch_um": 5.0,
}
WEIGHTS = {"day": 3.0, "night": 1.0, "never": 0.0}
CONDITIONS = [
    {"name": name, "weight": weight, "set": {"resolution": 48}} for name, weight in WEIGHTS.items()
]
HALVES = {"day": 0.5, "night": 0.5, "never": 0.0}


def study_of(conditions: int) -> Study:
    return Study(name="x", pixel=SHEET, condition=CONDITIONS[:conditions])


def parabola(best_um: float, best: float, bend: float, pitch_um=PITCH_UM):
    return best + bend * np.log(pitch_um / best_um) ** 2


def curve(condition: str = "", scatter: float = 1e-6, **means) -> Curve:
    """A curve of metrics whose means at the sizes are known, with the scatter of four sensors."""
    sensors = np.random.default_rng(1).standard_normal((PITCH_UM.size, 4))
    metrics = metrics_named(list(means))
    statistics = {
        metric.columns[0]: means[metric.name][:, None] * (1 + scatter * sensors)
        for metric in metrics
    }
    fits = {
        metric.name: fit_of_metric(metric, PITCH_UM, statistics[metric.columns[0]], np.asarray)
        for metric in metrics
    }
    return Curve(
        "none",
        0.35,
        PITCH_UM,
        np.ones(PITCH_UM.size),
        statistics,
        fits.pop(metrics[0].name),
        metrics=metrics,
        fits=fits,
        case=CaseLabels(condition=condition),
    )


def delta_e_curves() -> list[Curve]:
    return [
        curve("day", delta_e=parabola(5.0, 0.3, 0.8)),
        curve("night", delta_e=parabola(9.0, 0.9, 0.4)),
        curve("never", delta_e=parabola(11.0, 5.0, 9.0)),
    ]


@cache
def by_delta_e() -> Regrets:
    (regrets,) = condition_regrets(study_of(3), delta_e_curves())
    return regrets


@cache
def by_two_metrics() -> list[Regrets]:
    """By information, of which more is better, and by ΔE, of day and night."""
    day, night, _ = delta_e_curves()
    curves = [
        curve("day", information=parabola(5.0, 30.0, -8.0), delta_e=day.mean()),
        curve("night", information=parabola(9.0, 20.0, -4.0), delta_e=night.mean()),
    ]
    return condition_regrets(study_of(2), curves)


def vertex_um(day: float, night: float) -> float:
    """Return where the sum of parabolas about 5 and 9 µm with these weights × bends is best."""
    return float(np.exp((day * np.log(5.0) + night * np.log(9.0)) / (day + night)))


def weighted_best(regrets: Regrets) -> list[float]:
    optimum = regrets.criteria[-1].optimum
    return [optimum.pitch_um, optimum.value]


def fit_numbers(fit) -> list[float]:
    return [fit.optimum.pitch_um, *fit.optimum.interval_um]


def predicted(before: float | None, error: float = 0.4) -> tuple[float, ...]:
    """Return the error that is expected on 1024 samples from the errors on 256 and on 512."""
    fine = FilmError((512, 512), 1.0, (5.0,), (error,), (0.01,))
    coarse = None if before is None else replace(fine, shape=(256, 256), delta_e=(before,))
    return fine.predicted_on(1024, coarse)


def steps(delta_e, finer=([0.0],) * 3, blur_error: float = 0.0) -> FilmSteps:
    """Return mean ΔE in parts of a picture on a film, on two coarser and on finer ones."""
    return FilmSteps(np.array(delta_e), np.array(finer), np.inf, blur_error)


def measured_cells() -> int:
    """Return the cells that are measured of a picture of 16 times as many as are measured at most."""
    image = light(np.broadcast_to(np.float32(0.5), (4 * int(np.sqrt(MEASURED)),) * 2))
    regions = measured_regions(image, 5.0, Display(dots=512))
    return sum((rows.stop - rows.start) * (side.stop - side.start) for rows, side in regions)


def values_of_axis(table: dict) -> list[float]:
    axis = Axis.model_validate({"name": "a", "set": "pixel.read_noise_e"} | table)
    return [float(point.value) for point in axis.points]


DIFFERENCES = np.random.default_rng(1).normal(0.5, 1.0, 9)
T_INTERVAL = stats.t.interval(0.95, 8, DIFFERENCES.mean(), stats.sem(DIFFERENCES))
T_TEST = stats.ttest_1samp(DIFFERENCES, 0, alternative="greater")
FALL = np.log(9.0 / 5.0) ** 2
DELTA_E_UM = vertex_um(0.75 * 0.8, 0.25 * 0.4)
INFORMATION_UM = vertex_um(0.75 * 8.0, 0.25 * 4.0)
LOSS = parabola(7.0, 1.0, 1.0)[:, None] * [[0.99, 1.0, 1.01]]
METRIC_CURVE = partial(
    curve, delta_e=parabola(5.0, 1.0, 1.0), information=50.0 / parabola(9.0, 1.0, 1.0)
)
SPLINE = "the spline between nine sizes has an error of 0.3 % of the size"

TO_THE_SMALLEST = [
    curve("day", 1e-4, delta_e=parabola(3.0, 0.3, 0.8)),
    curve("night", 1e-4, delta_e=parabola(3.5, 0.9, 0.4)),
]
VOLTAGES = {"voltage_swing_v": (0.9, 2.2), "reset_voltage_v": (1.2, 3.0)}
CLAIMS = [
    Claim(
        "weights of conditions are shares of their sum",
        lambda: [criterion.weight for criterion in by_delta_e().criteria[:3]],
        [0.75, 0.25, 0.0],
    ),
    Claim(
        "a weighted mean of parabolas is one about the weighted vertex",
        lambda: weighted_best(by_delta_e()),
        [
            DELTA_E_UM,
            0.75 * parabola(5.0, 0.3, 0.8, DELTA_E_UM) + 0.25 * parabola(9.0, 0.9, 0.4, DELTA_E_UM),
        ],
        rtol=0.003,
        why=SPLINE,
    ),
    Claim(
        "a regret is the value at the other's best size over the least value, less 1",
        lambda: by_delta_e().matrix[:2, :2],
        [[0.0, 0.8 * FALL / 0.3], [0.4 * FALL / 0.9, 0.0]],
        rtol=0.01,
        why=SPLINE,
    ),
    Claim(
        "where more is better, a weighted mean is greatest at the weighted vertex",
        lambda: weighted_best(by_two_metrics()[0]),
        [
            INFORMATION_UM,
            0.75 * parabola(5.0, 30.0, -8.0, INFORMATION_UM)
            + 0.25 * parabola(9.0, 20.0, -4.0, INFORMATION_UM),
        ],
        rtol=0.003,
        why=SPLINE,
    ),
    Claim(
        "where more is better, a regret is the greatest value over the value, less 1",
        lambda: by_two_metrics()[0].matrix[:2, :2],
        [[0.0, 30.0 / (30.0 - 8.0 * FALL) - 1], [20.0 / (20.0 - 4.0 * FALL) - 1, 0.0]],
        rtol=0.02,
        why=SPLINE,
    ),
    Claim(
        "regrets by a further metric are those of a study of that metric",
        lambda: np.subtract(
            by_two_metrics()[1].matrix,
            condition_regrets(study_of(2), delta_e_curves()[:2])[0].matrix,
        ),
        np.zeros((3, 3)),
        atol=1e-4,
    ),
    Claim(
        "a weighted mean of one condition is that condition",
        lambda: condition_regrets(study_of(1), delta_e_curves()[:1])[0].matrix,
        np.zeros((2, 2)),
        atol=1e-5,
    ),
    Claim(
        "sensors are paired, so that opposite scatter cancels",
        lambda: weighted_mean(
            [
                (curve(scatter=0.1, delta_e=np.ones(9)), 0.5),
                (curve(scatter=-0.1, delta_e=np.ones(9)), 0.5),
            ]
        )[1],
        np.ones((9, 4)),
        atol=1e-12,
    ),
    Claim(
        "regrets of two metrics are the rise of each from its best size to the other's",
        lambda: metric_regrets(METRIC_CURVE()).matrix,
        [[0.0, FALL], [FALL, 0.0]],
        rtol=0.02,
        why=SPLINE,
    ),
    Claim(
        "the best size where more is better is that of the reciprocal",
        lambda: fit_numbers(
            fit_of_metric(METRICS["information"], PITCH_UM, 50.0 / LOSS, np.asarray)
        ),
        fit_numbers(fit_curve(PITCH_UM, LOSS / 50.0)),
        rtol=1e-9,
    ),
    Claim(
        "an interval of a mean is Student's",
        lambda: mean_interval(DIFFERENCES),
        [T_INTERVAL[0], DIFFERENCES.mean(), T_INTERVAL[1]],
        rtol=1e-12,
    ),
    Claim(
        "so is the probability that a mean is above 0",
        lambda: [probability_above_zero(sign * DIFFERENCES) for sign in (1, -1)],
        [1 - T_TEST.pvalue, T_TEST.pvalue],
        rtol=1e-9,
    ),
    Claim(
        "equal numbers are surely above or below 0, and zeros as likely either",
        lambda: [probability_above_zero(np.full(4, value)) for value in (-1.0, 0.0, 2.0)],
        [0.0, 0.5, 1.0],
    ),
    Claim(
        "an axis of ratios has equal steps of its logarithm, and its ends",
        lambda: np.log10(values_of_axis({"from": 1.0, "to": 1000.0, "count": 7, "spacing": "log"})),
        np.linspace(0.0, 3.0, 7),
        atol=2e-6,
        why="six digits of a value",
    ),
    Claim(
        "an axis of steps may fall, and may begin at 0",
        lambda: values_of_axis({"from": 4.0, "to": 0.0, "count": 5}),
        [4.0, 3.0, 2.0, 1.0, 0.0],
    ),
    Claim("a film without a change has no error", lambda: film_error(0.0, 0.0), 0.0),
    Claim("a fifth of the last change is left", lambda: film_error(0.01, 0.0), 0.002, rtol=1e-12),
    Claim("6 % of the change before", lambda: film_error(0.0, 0.1), 0.006, rtol=1e-12),
    Claim("2.5 times a finer one's", lambda: film_error(0.0, 0.0, finer=0.1), 0.25, rtol=1e-12),
    Claim(
        "2.7 samples a dot do not alias", lambda: film_error(0.01, 0.0, 0.0, 3.0), 0.002, rtol=1e-12
    ),
    Claim(
        "a sample a dot may hide half as much again",
        lambda: film_error(0.01, 0.0, 0.0, 1.0),
        0.015,
        rtol=1e-12,
    ),
    Claim(
        "half a sample a dot hides four times that, and a fifth of mean ΔE",
        lambda: film_error(0.01, 0.0, 2.0, 0.5),
        0.06 + 0.4,
        rtol=1e-12,
    ),
    Claim(
        "a known chart's finer films do not alias",
        lambda: film_error(0.01, 0.0, 0.0, 0.5, is_chart=True),
        0.002,
        rtol=1e-12,
    ),
    Claim(
        "the error of a film grows with that of the blur of a real lens",
        lambda: steps([[2.0], [2.1], [2.4]], blur_error=0.004).error(),
        [2.0, 0.2 * 0.1 + 1.5 * 0.004 * 2.0],
        rtol=1e-9,
    ),
    Claim(
        "the error of a difference is that of the differences",
        lambda: steps([[2.0], [2.1], [2.4]], blur_error=0.004).error_of_difference(
            steps([[3.0], [3.2], [3.6]])
        ),
        0.2 * 0.1 + 1.5 * 0.004 * 1.0,
        rtol=1e-9,
    ),
    Claim(
        "equal sensors have no error of their difference",
        lambda: steps([[2.0], [2.1], [2.4]]).error_of_difference(steps([[2.0], [2.1], [2.4]])),
        0.0,
    ),
    Claim(
        "changes on finer films count with three standard errors of their mean over parts",
        lambda: steps([[1.0] * 2] * 3, [[1.0, 1.0], [1.1, 1.3], [1.0, 1.0]]).error(),
        [1.0, 2.5 * (0.2 + 3 * 0.1)],
        rtol=1e-9,
    ),
    Claim(
        "light goes on as in a mirror beyond what there is",
        lambda: reflected(slice(0, 2), 2, -1, 3),
        [-1, -1, 0, 1, 2, 2],
    ),
    Claim(
        "of a large picture as many cells are measured as memory holds",
        measured_cells,
        MEASURED,
        rtol=0.02,
        why="parts are whole blocks of four cells",
    ),
    Claim("one film: second order", lambda: predicted(None), [0.1], rtol=1e-12),
    Claim("two films: the order between them", lambda: predicted(1.2), [0.4 / 3], rtol=1e-12),
    Claim("two films: at least first order", lambda: predicted(0.4), [0.2], rtol=1e-12),
    Claim("an error of 0 before: second order", lambda: predicted(0.0), [0.1], rtol=1e-12),
    Claim("two films: at most second order", lambda: predicted(9.0), [0.1], rtol=1e-12),
]


# --- shares of variance of functions whose shares are known ---------------------------------------

ABC = ["a", "b", "c"]


def points(count: int, inputs: int, seed: int = 0) -> np.ndarray:
    return stats.qmc.Sobol(inputs, seed=np.random.default_rng(seed)).random(count) + 2.0**-31


def ishigami(quantile: np.ndarray) -> np.ndarray:
    a, b, c = np.pi * (2 * quantile.T - 1)
    return np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


def linear(x: np.ndarray) -> np.ndarray:
    return 2 * x[:, 0] + x[:, 1] + 5


def share_numbers(shares) -> list[float]:
    return [share.share for share in shares.values()]


def indices(result: np.ndarray) -> list[list[float]]:
    """First-order and total shares of three inputs."""
    shares = total_indices(result, ABC)
    return [[shares[name][kind].share for name in ABC] for kind in ("first", "total")]


# T. Ishigami and T. Homma (1990), with a = 7 and b = 0.1; the shares in closed form.
def estimates(count: int, seed: int, share: float) -> np.ndarray:
    """(2, count): estimates and standard errors of the share of a normal input, from 128 draws."""
    draws = np.random.default_rng(seed).standard_normal((count, 2, 128))
    shares = [
        first_order(x[:, None], math.sqrt(share) * x + math.sqrt(1 - share) * noise, ["x"])["x"]
        for x, noise in draws
    ]
    return np.array([(item.share, item.standard_error) for item in shares]).T


def ratio_errors() -> float:
    """Return the stated error of ratios of means of 64 draws over their scatter in 400 sets."""
    deviation, part = np.random.default_rng(0).standard_normal((2, 400, 64))
    ratios = [ratio_of_means(0.3 + 0.1 * p, d**2) for p, d in zip(part, deviation, strict=True)]
    return np.mean([ratio.standard_error for ratio in ratios]) / np.std(
        [ratio.share for ratio in ratios], ddof=1
    )


ISHIGAMI = [[0.3139, 0.4424, 0.0], [0.5576, 0.4424, 0.2437]]
NORMAL = ndtri(points(256, 2))
VARIANCES = np.expm1([0.1**2, 0.09**2])
SHARES = [
    Claim(
        "the error of a ratio of means is its scatter",
        ratio_errors,
        1.0,
        atol=0.175,
        why="400 sets tell it to 3.5 %: five times that",
    ),
    # R² of 3 terms without effect has a standard deviation of √(2·3/(124 · 129)); estimates above 0
    # add up to a quarter to it. They are 0 where χ² of 3 degrees of freedom is below its mean.
    Claim(
        "stated error of shares without effect",
        lambda: estimates(200, 2, 0.0)[1].mean(),
        1.15 * math.sqrt(6 / (124 * 129)),
        rtol=0.15,
        why="up to a quarter of it",
    ),
    Claim(
        "and how many of them are 0",
        lambda: np.mean(estimates(200, 2, 0.0)[0] == 0),
        stats.chi2(3).cdf(3),
        atol=5 * math.sqrt(0.25 / 200),
        why="five standard deviations of 200 sets",
    ),
    *(
        Claim(
            f"Ishigami's function, seed {seed}",
            lambda seed=seed: indices(ishigami(saltelli(points(512, 6, seed)))),
            ISHIGAMI,
            atol=0.15,
            why="three standard errors of 512 points; beyond them is 1 % of 200 seeds",
        )
        for seed in range(3)
    ),
    Claim(
        "2 a + b, of which c has nothing: total shares are first-order ones",
        lambda: indices(linear(ndtri(saltelli(points(256, 6))))),
        [[0.8, 0.2, 0.0]] * 2,
        atol=0.1,
        why="three standard errors of 256 points",
    ),
    Claim(
        "a product of two lognormal inputs",
        lambda: share_numbers(first_order(NORMAL, np.exp(NORMAL @ [0.1, 0.09]), ABC[:2])),
        VARIANCES / math.expm1(0.1**2 + 0.09**2),
        atol=0.03,
        why="three standard errors of 256 points",
    ),
    Claim(
        "a cubic does not see Ishigami's second input, which turns three times over its range",
        lambda: share_numbers(first_order(points(256, 3), ishigami(points(256, 3)), ABC))[:2],
        [0.3139, 0.02],
        atol=0.1,
        why="three standard errors of 256 points",
    ),
    Claim(
        "a weighted mean that is best at the smallest size has an open interval",
        lambda: [
            value
            for optimum in [weighted_fit(study_of(3), TO_THE_SMALLEST, HALVES).optimum]
            for value in (optimum.inside, optimum.interval_um[0] is None)
        ],
        [0, 1],
    ),
    Claim(
        "nothing is left where the best value is zero",
        lambda: [
            value
            for fit in [curve(delta_e=parabola(6.0, 1.0, 1.0)).fit]
            for loss in [np.maximum(np.abs(fit.pitch_um - PITCH_UM[3]) - 0.1, 0.0)]
            for share in [share_of_best(replace(fit, delta_e=loss))]
            for value in (share.max(), share[0])
        ],
        [1.0, 0.0],
    ),
    *(
        Claim(
            f"Jeffreys' interval of {holds} of {draws} draws",
            lambda holds=holds, draws=draws: [
                getattr(Probability.of(np.arange(draws) < holds), name)
                for name in ("probability", "low", "high")
            ],
            [
                holds / draws,
                stats.beta.ppf(0.025, holds + 0.5, draws - holds + 0.5) if holds else 0.0,
                stats.beta.ppf(0.975, holds + 0.5, draws - holds + 0.5) if holds < draws else 1.0,
            ],
            rtol=1e-9,
        )
        for holds, draws in ((0, 64), (1, 64), (64, 64), (250, 256))
    ),
    *(
        Claim(
            f"two sensors at twelve sizes around {interval_um}",
            lambda optimum_um=optimum_um, interval_um=interval_um: [
                *few_pitches_um(optimum_um, interval_um, (1.0, 18.0)).items()
            ],
            np.stack([np.geomspace(*ends_um, 12), np.full(12, 2)], axis=1),
            rtol=1e-4,
            why="stated digits",
        )
        for optimum_um, interval_um, ends_um in (
            (6.0, (5.8, 6.2), (3.0, 12.0)),  # at least a factor of two
            (6.0, (4.5, 7.0), (6 * 0.75**3, 6 / 0.75**3)),  # three times the half interval
            (6.0, (5.8, None), (1.5, 18.0)),  # four times, within the range
            (1.0, (None, 1.1), (1.0, 4.0)),
            (18.0, (17.0, None), (4.5, 18.0)),
        )
    ),
    Claim(
        "a swing above the reset voltage is no pixel: ranges end in the middle between both values",
        lambda: np.diag(
            [
                unknown.allowed[::-1]
                for unknown in unknowns_of_technology(
                    load_technology("0.35um").model_copy(update={"ranges": VOLTAGES}), "mine"
                )
            ]
        ),
        [(1.2 + 2.2) / 2] * 2,
    ),
    Claim(
        "nothing that varies: all shares are unknown",
        lambda: (
            np.isnan(indices(np.full(16, 3.0))).sum(axis=1)
            + np.isnan(share_numbers(first_order(points(16, 3), np.full(16, 3.0), ABC))).sum()
        ),
        [6, 6],
    ),
    Claim(
        "4 draws are too few for 3 terms and a mean, 8 are not",
        lambda: [
            np.isnan(
                share_numbers(first_order(points(count, 2), points(count, 2)[:, 0], ABC[:2]))
            ).sum()
            for count in (4, 8)
        ],
        [2, 0],
    ),
    Claim(
        "a column that changes nothing has exactly nothing",
        lambda: [
            (share.share, share.standard_error)
            for share in total_indices(linear(ndtri(saltelli(points(256, 6)))), ABC)["c"].values()
        ],
        [[0.0, 0.0]] * 2,
    ),
]


@pytest.mark.parametrize("claim", [*CLAIMS, *SHARES], ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_regrets_are_the_same_in_the_figure_the_csv_and_the_json() -> None:
    regrets = by_delta_e()
    plate = regrets_plate(regrets, PITCH_UM)
    table = regrets_columns([regrets])
    assert plate.table["day regret"] == regrets.criteria[0].regret(PITCH_UM).tolist()
    assert table["pitch_um"] == [criterion.optimum.pitch_um for criterion in regrets.criteria]
    assert table["regret_at_night"] == regrets.matrix[:, 1].tolist()
    assert condition_regrets_data(regrets)["regret"] == regrets.matrix.tolist()


@pytest.mark.parametrize("curves", [1, 2], ids=["one condition", "four common sizes"])
def test_no_weighted_mean_without_a_condition_or_with_few_common_sizes(curves: int) -> None:
    day, night, _ = delta_e_curves()
    assert weighted_fit(study_of(3), [day, night], HALVES) is not None
    other_um = PITCH_UM + 0.01
    other_um[:4] = PITCH_UM[:4]
    moved = replace(night, pitch_um=other_um, fit=fit_curve(other_um, night.delta_e))
    assert weighted_fit(study_of(3), [day, moved][:curves], HALVES) is None


@pytest.mark.parametrize(("name", "value"), [("information", 0.0), ("mtf50", 1.1)])
def test_metric_that_is_worth_nothing_or_has_no_best_size_has_no_fit(
    name: str, value: float
) -> None:
    values = np.array([[1.0, value]] * PITCH_UM.size)
    assert fit_of_metric(METRICS[name], PITCH_UM, values, np.asarray) is None


def test_size_worth_nothing_ends_a_curve_and_one_without_a_number_is_left_out() -> None:
    metric = METRICS["information"]
    values = 50.0 / (parabola(6.0, 1.0, 1.0)[:, None] * [[0.99, 1.01]])
    values[7, 1] = 0.0
    values[1] = np.nan
    fittable = np.array([True, False, True, True, True, True, True, False, False])
    np.testing.assert_array_equal(fittable_pitches(metric, values), fittable)

    fit = fit_of_metric(metric, PITCH_UM, values, np.asarray)
    expected = fit_curve(PITCH_UM[fittable], metric.loss(values[fittable]))
    assert fit.optimum.pitch_um == expected.optimum.pitch_um

    by_delta_e = METRIC_CURVE()
    statistics = {"mean_delta_e": by_delta_e.delta_e[:, :2], "information": values}
    both = replace(by_delta_e, statistics=statistics, fits={"information": fit})
    by_information = both.judged_by("information")
    assert both.fittable.all(), "ΔE takes all sizes"
    assert np.isnan(by_information.delta_e[~fittable]).all()
    means, half_widths = first_metric_and_ci95(by_information)
    np.testing.assert_allclose(means[[0, 7]], values[[0, 7]].mean(axis=1), rtol=1e-3)
    assert np.isnan(half_widths[~fittable]).all()
    assert by_information.judged_by("delta_e").optimum is both.optimum


def test_regret_where_nothing_is_left_is_infinite_and_null_in_json() -> None:
    """Information is 0 at the largest size, which is best by ΔE."""
    values = parabola(6.0, 50.0, -5.0)
    values[-1] = 0.0
    regrets = metric_regrets(curve(delta_e=parabola(12.0, 1.0, 1.0), information=values))
    by_delta_e, by_information = regrets.criteria
    at_end = replace(by_delta_e, optimum=replace(by_delta_e.optimum, pitch_um=12.0))
    at_zero = replace(regrets, criteria=(at_end, by_information))
    assert at_zero.matrix[1, 0] == np.inf
    assert regrets_data(at_zero)["regret"][1][0] is None


@pytest.mark.parametrize("count", [64, 256, 512])
def test_first_order_of_linear_model(count: int) -> None:
    """y = 0.6 a + 0.4 b + 0.4 of noise: variances of 0.36, 0.16 and 0.16, and none of c.

    Of 500 sets of each count none has a share beyond 3 standard errors (the largest is 2.4 away): a
    sound program has one in less than 0.6 % of sets (95 % confidence). The mean error of 25 sets
    tells a bias: for independent draws its standard deviation would be a fifth of a standard error.
    """
    errors = []
    for seed in range(25):
        x = ndtri(points(count, 3, seed))
        noise = np.random.default_rng(seed).standard_normal(count)
        shares = first_order(x, x @ [0.6, 0.4, 0.0] + 0.4 * noise + 100, ABC)
        scale = [share.standard_error for share in shares.values()]
        errors.append(np.subtract(share_numbers(shares), [0.36 / 0.68, 0.16 / 0.68, 0.0]) / scale)
    np.testing.assert_array_less(np.abs(errors), 3)
    np.testing.assert_array_less(np.abs(np.mean(errors, axis=0)), 3 / 5)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.9])
def test_first_order_standard_error_is_that_of_r_squared(share: float) -> None:
    """The scatter of estimates from independent draws, over 400 sets of 128, which tell it to 3.5
    %: within five times that.

    Of normal inputs it is 2ρ(1 - ρ²)/√n, with ρ² the share, and (1 - ρ²)√(2p/((n - 1 - p)(n + 1)))
    for the chance of p terms.
    """
    shares, errors = estimates(400, 1, share)
    scatter = shares.std(ddof=1)
    chance = (1 - share) ** 2 * 2 * 3 / (124 * 129)
    expected = math.sqrt(4 * share * (1 - share) ** 2 / 128 + chance)
    assert shares.mean() == pytest.approx(share, abs=5 * scatter / 20)
    assert scatter == pytest.approx(expected, rel=5 * 0.035)
    assert errors.mean() == pytest.approx(expected, rel=0.1)
