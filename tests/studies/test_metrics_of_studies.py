"""Studies, runs and comparisons that judge by several metrics: columns, best sizes, thresholds, and
rows that are resumed.
"""

import json
import math
import pickle
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
from helpers.commands import output_of
from helpers.tiny import rows, tiny

import pixsim
from pixsim.report.axes import optima_columns
from pixsim.report.regret import regrets_data
from pixsim.report.run import run_document
from pixsim.report.study_facts import contrast_words, study_notes
from pixsim.show.render import text
from pixsim.studies.design import photodiode_widths_um
from pixsim.studies.merit import run_neq, study_neq
from pixsim.studies.optimum import fit_of_metric
from pixsim.studies.regret import condition_regrets, metric_regrets
from pixsim.studies.result import StudyResult
from pixsim.studies.run import MAX_RENDERS, Search
from pixsim.viewer.metric_registry import METRICS

NAMES = ["delta_e", "information", "mtf50"]


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("judged")
    return pixsim.study(tiny(metrics=NAMES), folder, jobs=1), folder


def test_study_has_columns_and_best_sizes_of_each_metric(judged: tuple[StudyResult, Path]) -> None:
    result, folder = judged
    curve = result.curves[0]
    summary = result.as_dict()["curves"][0]
    columns = ["information", "information_bits_per_deg2", *METRICS["information"].variants]
    assert list(rows(folder)[0])[-7:] == [*columns, "mtf50_cy_per_mm", "schema", "check"]
    assert list(curve.optima) == ["delta_e", "information"], "an MTF50 tells no best size"
    assert summary["optima"]["information"]["value"] == curve.optima["information"].value
    assert summary["regrets"] == regrets_data(metric_regrets(curve))
    assert summary["metrics"]["mtf50_cy_per_mm"] == curve.mean("mtf50_cy_per_mm").tolist()


def test_figure_of_metrics_has_the_means_of_their_sensors(
    judged: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    result, _ = judged
    result.write(tmp_path)
    for column in ("mean_delta_e", "information"):
        means = [float(row[column]) for row in rows(tmp_path / "figures/metrics.csv")]
        np.testing.assert_allclose(
            means, result.curves[0].statistics[column].mean(axis=1), rtol=1e-6
        )


def test_best_sizes_by_information_at_other_contrasts_are_those_of_their_columns(
    judged: tuple[StudyResult, Path],
) -> None:
    result, _ = judged
    curve = result.curves[0]
    widths_um = partial(photodiode_widths_um, result.study, curve.technology)
    information = METRICS["information"]
    for name in information.variants:
        fit = fit_of_metric(information, curve.pitch_um, curve.statistics[name], widths_um)
        assert curve.fits[name].optimum == fit.optimum
        assert result.as_dict()["curves"][0]["optima"][name] == fit.optimum.of_metric()
    assert len(contrast_words(result, curve)) == 1


def test_study_of_the_spectrum_of_the_scene_has_no_other_contrasts_and_is_resumed(
    tmp_path: Path,
) -> None:
    settings = tiny(metrics=["information"], metric={"information": {"spectrum": "scene"}})
    result = pixsim.study(settings, tmp_path, jobs=1)
    pixsim.study(settings, tmp_path, jobs=1)
    assert contrast_words(result, result.curves[0]) == []
    assert not list(tmp_path.glob("results.csv.old*")), "rows that are computed again leave a copy"


def test_delta_e_of_a_study_does_not_depend_on_other_metrics(
    judged: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    only_delta_e = pixsim.study(tiny(), tmp_path, jobs=1).curves[0]
    np.testing.assert_array_equal(only_delta_e.delta_e, judged[0].curves[0].delta_e)


def test_noise_equivalent_quanta_are_those_of_the_best_size_up_to_its_nyquist_frequency(
    judged: tuple[StudyResult, Path],
) -> None:
    curve = judged[0].curves[0]
    ((label, quanta),) = study_neq(judged[0]).items()
    nyquist = 500 / curve.optima["information"].pitch_um
    assert label == curve.label
    assert quanta.frequency_cy_per_mm[-1] == pytest.approx(nyquist, rel=1e-6)
    assert quanta.neq_per_mm2[0] > quanta.neq_per_mm2[-1] > 0


@pytest.mark.parametrize("metric", ["information", "mtf50"])
def test_run_has_noise_equivalent_quanta_with_the_metric_information(metric: str) -> None:
    run = pixsim.run("flat", resolution=48, display={"dots": 32}, metrics=[metric])
    pitches_um = [quanta.pitch_um for quanta in run_neq(run).values()]
    assert pitches_um == ([run.settings.pixel.pitch_um] if metric == "information" else [])


def test_study_may_judge_by_another_metric_first(tmp_path: Path) -> None:
    result = pixsim.study(tiny(metrics=["information", "acutance", "mtf50"]), tmp_path, jobs=1)
    curve = result.curves[0]
    assert not curve.has_delta_e
    assert curve.as_dict()["optimum"] == curve.optimum.of_metric(), "no number of ΔE"
    assert curve.optimum.value == pytest.approx(curve.mean("information").max(), rel=0.05)
    assert list(curve.optima) == ["information", "acutance"]


def test_study_of_conditions_has_regrets_and_best_sizes_by_each_metric(tmp_path: Path) -> None:
    conditions = [
        {"name": name, "set": {"scene": {"parameters": {"luminance_cd_per_m2": value}}}}
        for name, value in (("day", 400), ("night", 10))
    ]
    study = tiny(metrics=["information", "delta_e", "mtf50"], condition=conditions)
    result = pixsim.study(study, tmp_path, jobs=1)
    columns = optima_columns(result)
    optima = [(curve.optimum, curve.optima["delta_e"]) for curve in result.curves]
    assert list(columns["best_information"]) == [information.value for information, _ in optima]
    assert list(columns["best_delta_e"]) == [delta_e.value for _, delta_e in optima]
    assert list(columns["delta_e_optimum_um"]) == [delta_e.pitch_um for _, delta_e in optima]
    assert not any(name.startswith("mtf50") for name in columns), "it tells no best size"

    regrets = condition_regrets(result.study, result.curves)
    assert [regret.criteria[0].metric.name for regret in regrets] == ["information", "delta_e"]


def test_comparison_has_scores_and_probabilities_of_each_metric() -> None:
    result = pixsim.compare(
        ["0.35um", "4t-bsi"],
        repeats=3,
        jobs=1,
        metrics=["visual_noise"],
        camera={"die_mm": 2.7},
        display={"dots": 32},
        resolution=48,
        pixel={"pitch_um": 60.0},
    )
    entry = result.as_dict()["metrics"]["visual_noise"]
    low, mean, high = entry["scores"]["0.35um"]
    assert low < mean < high
    assert mean == pytest.approx(result.judged["visual_noise"]["0.35um"].mean())
    assert 0 <= entry["probability_a_better"]["4t-bsi"] < 0.5, "a quieter pixel"


def test_curve_that_was_sent_to_a_worker_is_judged_by_delta_e(
    judged: tuple[StudyResult, Path],
) -> None:
    """Figures are drawn in workers, where a metric is a copy."""
    curve = pickle.loads(pickle.dumps(judged[0].curves[0]))
    assert curve.judged_by_delta_e
    assert curve.has_delta_e


@pytest.mark.parametrize(
    ("integration_s", "bits", "silent_um", "reason"),
    [
        (0.37, 8, [11.0, 15.0], "detectability d′ leaves out 11, 15 µm"),
        (0.1, 7, [5.3], "leaves out 5.3 µm.*noise of 0.43 DN"),
    ],
    ids=["saturated", "rounded"],
)
def test_size_at_which_the_first_metric_fails_does_not_end_a_study(
    integration_s: float, bits: int, silent_um: list[float], reason: str, tmp_path: Path
) -> None:
    """Large pixels are full, or the noise of small ones is rounded away; resumed, nothing changes."""
    target = {"size_um": 40.0, "contrast": 0.02, "luminance_cd_per_m2": 100.0}
    study = tiny(
        metrics=["detectability", "delta_e"],
        scene={"file": "target", "parameters": target},
        exposure={"integration_s": integration_s},
        pixel={"bits": bits, "black_level_dn": 2},
    )
    result = pixsim.study(study, tmp_path, jobs=1)
    curve = result.curves[0]
    assert curve.pitch_um[~curve.fittable].tolist() == silent_um
    assert curve.sensors.tolist() == [2] * curve.pitch_um.size
    assert any(re.search(reason, note) for note in study_notes(result))
    json.dumps(result.as_dict(), allow_nan=False)
    written = (tmp_path / "results.csv").read_bytes()
    assert pixsim.study(study, tmp_path, jobs=1).as_dict()["notes"] == result.as_dict()["notes"]
    assert (tmp_path / "results.csv").read_bytes() == written


# --- a target, and the threshold at which it is seen ----------------------------------------------

TARGET = {"size_um": 200.0, "contrast": -0.05, "lux": 50.0}
SMALL = {
    "resolution": 48,
    "display": {"dots": 32},
    "exposure": {"integration_s": 0.01},
    "metrics": ["detectability"],
}
# By its own length within the exposure.
MOVING = {"motion": {"image_um_per_s": (20e3, 0.0)}}


def run_of_target(more: dict, detectability=(), **parameters: float):
    return pixsim.run(
        "target",
        parameters=TARGET | parameters,
        metric={"detectability": {"registrations": 1} | dict(detectability)},
        **more,
        **SMALL,
    )


def d_prime(more: dict, **parameters: float) -> float:
    return float(run_of_target(more, **parameters).statistics[0]["detectability"])


@pytest.mark.parametrize(
    ("name", "threshold", "more"),
    [("size_um", 2.0, {}), ("contrast", 10.0, MOVING)],
    ids=["size", "moving"],
)
def test_d_prime_at_the_value_that_a_run_finds_is_the_threshold(
    name: str, threshold: float, more: dict
) -> None:
    """A search ends within 1e-3 of the value."""
    result = run_of_target(more, {"solve_for": name, "threshold": threshold})
    assert result.as_dict()["at_threshold"]["value"] == result.threshold.value
    assert d_prime(more, **{name: result.threshold.value}) == pytest.approx(threshold, rel=3e-3)


def test_target_is_seen_from_the_light_that_is_too_dark_to_the_light_that_fills_pixels() -> None:
    """From 1e5 lx, where all pixels are full."""
    threshold = run_of_target({}, {"solve_for": "lux"}, lux=1e5).threshold
    assert 50.0 < threshold.value < 200.0
    assert threshold.upper_value > 1e4
    for lux in (threshold.value, threshold.upper_value):
        assert d_prime({}, lux=lux) == pytest.approx(5.0, rel=3e-2)


@pytest.mark.parametrize(
    ("lux", "detectability", "words"),
    [
        (
            50.0,
            {},
            [
                "not seen: detectability",
                "50 lx of visible light (CIE D65) on a part of reflectance 1",
                "at 2.06 times this contrast",
            ],
        ),
        (50.0, {"threshold": 2.0}, ["seen: detectability"]),
        (50.0, {"solve_for": "lux", "threshold": 2.0}, ["on a part of reflectance 1"]),
        (5.0, {}, ["darker than black"]),
        (1e5, {}, ["pixels are full"]),
        (50.0, {"solve_for": "contrast", "threshold": 100.0}, ["100 is not reached at contrast"]),
    ],
)
def test_run_says_by_which_factor_of_its_contrast_a_target_is_seen_or_why_it_is_not(
    lux: float, detectability: dict, words: list[str]
) -> None:
    page = text(run_document(run_of_target({}, detectability, lux=lux)))
    assert [line for line in words if line not in page] == []


WELL_LX = 1500.0


def excess_of_light(lux: float, peak: float = 1.0) -> float:
    """Logarithm of a d′ over 5 that rises as the root of the light, through 1 at 12 lx, and falls
    where pixels are full.
    """
    return math.log(max(peak * math.sqrt(lux / 12.0) / (1 + (lux / WELL_LX) ** 12), 1e-6))


def search_from(start_lx: float, peak: float = 1.0) -> Search:
    return Search(
        lambda log_ratio: excess_of_light(start_lx * math.exp(log_ratio), peak),
        {0.0: excess_of_light(start_lx, peak)},
    )


@pytest.mark.parametrize("start_lx", [1e-3, 12.0, 1400.0, 1700.0, 1e7])
def test_search_finds_both_ends_of_the_light_in_which_a_target_is_seen(start_lx: float) -> None:
    """From the dark, from between and from beyond: 12 lx, and where (1 + (E/1500)¹²)² is E/12; both
    within 1e-3.
    """
    upper_lx = scipy.optimize.brentq(excess_of_light, WELL_LX, 3 * WELL_LX)
    search = search_from(start_lx)
    ends_lx = start_lx * np.exp(np.array(search.positive_range(), float))
    np.testing.assert_allclose(ends_lx, [12.0, upper_lx], rtol=2e-3)
    assert len(search.tried) <= 1 + MAX_RENDERS


@pytest.mark.parametrize("start_lx", [1.0, 100.0, 1400.0, 1e5])
def test_search_comes_within_10_percent_of_the_maximum_of_what_is_seen_nowhere(
    start_lx: float,
) -> None:
    search = search_from(start_lx, 0.08)
    maximum = max(excess_of_light(lux, 0.08) for lux in np.geomspace(100.0, 3000.0, 1000))
    assert search.positive_range() == (None, None)
    assert maximum - 0.1 < search.values[search.best] <= maximum + 1e-9


def test_command_line_leaves_the_target_out_by_values_of_parameters(tmp_path: Path) -> None:
    """d′ of a disc of 0.04 less one of a third of its width, over d′ of one of 0.02 less none."""
    line = (
        "run target -D size_um=300 -D luminance_cd_per_m2=100 --resolution 48 --display.dots 32"
        " --metric detectability"
    )
    scores = []
    for contrast, without in ((0.02, "contrast=0"), (0.04, "size_um=100, contrast = 0.04")):
        words = ("--metric.detectability.without", without, "--json", "--out", tmp_path)
        scores.append(
            json.loads(output_of(f"{line} -D contrast={contrast}", *words))["detectability"]
        )
    assert scores[1] / scores[0] == pytest.approx(2 * math.sqrt(8 / 9), rel=0.05)
