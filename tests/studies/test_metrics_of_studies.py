"""Studies, runs and comparisons that judge by several metrics: columns, optima, regrets, and
resuming.
"""

from __future__ import annotations

import json
import math
import pickle
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from helpers.commands import command
from helpers.tiny import rows, tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.axes import axes_files, axes_page, cases_data, optima_columns, regrets_columns
from pixsim.report.regret import regret_percent, regrets_data, regrets_tables
from pixsim.report.run import run_document, threshold_pitch_words
from pixsim.report.study import study_document
from pixsim.report.study_facts import contrast_words, study_notes
from pixsim.show.document import DocumentTable
from pixsim.show.render import text
from pixsim.studies import sensors
from pixsim.studies.curve import Curve, first_metric_and_ci95
from pixsim.studies.design import photodiode_widths_um
from pixsim.studies.files import load_study, settings_text
from pixsim.studies.merit import study_neq
from pixsim.studies.optimum import fit_curve, fit_of_metric, fittable_pitches
from pixsim.studies.prepare import prepare
from pixsim.studies.regret import condition_regrets, metric_regrets, share_of_best
from pixsim.studies.result import StudyResult
from pixsim.studies.run import MAX_RENDERS, Search, Threshold
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.metric_registry import METRICS, metrics_named
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.settings_file import settings_layer

PITCH_UM = np.array([2.0, 2.4, 2.9, 3.5, 4.2, 5.0, 6.0])
NAMES = ["delta_e", "information", "mtf50"]
VARIANTS = METRICS["information"].variants


def parabola(least_um: float, bend: float = 1.0) -> np.ndarray:
    """Loss of four sensors, of one per cent of scatter, with its least value 1 at a size."""
    mean = 1.0 + bend * np.log(PITCH_UM / least_um) ** 2
    return np.asarray(
        mean[:, None] * (1 + 0.01 * np.random.default_rng(1).normal(size=(PITCH_UM.size, 4)))
    )


def curve(delta_e: np.ndarray, information: np.ndarray) -> Curve:
    metrics = metrics_named(["delta_e", "information"])
    statistics = {"mean_delta_e": delta_e, "information": information} | dict.fromkeys(
        VARIANTS, np.full(information.shape, np.nan)
    )
    fit = fit_of_metric(metrics[1], PITCH_UM, information, np.asarray)
    assert fit is not None
    own = Curve(
        "one", 0.35, PITCH_UM, np.ones(PITCH_UM.size), statistics, fit_curve(PITCH_UM, delta_e)
    )
    return replace(own, metrics=metrics, fits={"information": fit})


def curve_of(best_um: float, most_um: float) -> Curve:
    """Least mean ΔE at one size and most information at another."""
    return curve(parabola(best_um), 50.0 / parabola(most_um))


def test_optimum_of_more_is_that_of_the_reciprocal() -> None:
    loss = parabola(3.0)
    fit = fit_of_metric(METRICS["information"], PITCH_UM, 50.0 / loss, np.asarray)
    assert fit is not None
    of_loss = fit_curve(PITCH_UM, loss / 50.0).optimum
    assert fit.optimum.pitch_um == pytest.approx(of_loss.pitch_um, rel=1e-9)
    assert fit.optimum.interval_um == pytest.approx(of_loss.interval_um, rel=1e-9)
    assert fit.optimum.value == pytest.approx(50.0, rel=0.01)  # the scatter of 28 sensors of 1 %
    low, high = fit.optimum.value_interval
    assert low < fit.optimum.value < high
    np.testing.assert_array_equal(DELTA_E.loss(loss), loss)


@pytest.mark.parametrize(
    ("name", "values"), [("information", [[1.0, 0.0]] * 7), ("mtf50", [[1.0, 1.1]] * 7)]
)
def test_metric_without_an_optimum_has_none(name: str, values: list[list[float]]) -> None:
    assert fit_of_metric(METRICS[name], PITCH_UM, np.array(values), np.asarray) is None


def test_regrets_of_metrics_match_closed_forms() -> None:
    """At a factor of 4.2/2.4 of the best size, a parabola of bend 1 is ln² above its least value 1,
    within its scatter.
    """
    regrets = metric_regrets(curve_of(2.4, 4.2))
    assert [criterion.name for criterion in regrets.criteria] == ["mean ΔE", "information"]
    wanted = np.log(4.2 / 2.4) ** 2
    np.testing.assert_allclose(
        regrets.matrix, [[0.0, wanted], [wanted, 0.0]], atol=0.05
    )  # sizes are known to 2 %
    _, matrix = regrets_tables(regrets)
    assert next(iter(matrix.rows)) == ("1 mean ΔE", "–", regret_percent(regrets.matrix[0, 1]))


def test_nothing_is_left_of_a_best_value_of_zero() -> None:
    own = curve_of(3.0, 3.0)
    least = np.maximum(np.abs(own.fit.pitch_um - PITCH_UM[3]) - 0.1, 0.0)
    share = share_of_best(replace(own.fit, delta_e=least))
    assert share.max() == 1.0
    assert share[0] == 0.0


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("judged")
    return pixsim.study(tiny(metrics=NAMES), folder, jobs=1), folder


def test_study_has_columns_and_optima_of_each_metric(judged: tuple[StudyResult, Path]) -> None:
    result, folder = judged
    found = rows(folder)
    of_information = [
        "information",
        "information_bits_per_deg2",
        "information_low_contrast",
        "information_high_contrast",
    ]
    assert list(found[0])[-7:] == [*of_information, "mtf50_cy_per_mm", "schema", "check"]
    own = result.curves[0]
    assert list(own.optima) == ["delta_e", "information"], "an MTF50 tells no best size"
    assert own.optimum is own.optima["delta_e"]
    summary = result.as_dict()["curves"][0]
    assert summary["optima"]["information"]["value"] == own.optima["information"].value
    assert summary["regrets"] == regrets_data(metric_regrets(own))
    assert summary["metrics"]["mtf50_cy_per_mm"] == own.mean("mtf50_cy_per_mm").tolist()


def test_study_says_the_best_sizes_by_information_at_other_contrasts(
    judged: tuple[StudyResult, Path],
) -> None:
    """A third of 0.15 and three times it: each is the optimum of the curve of its column."""
    result, _ = judged
    own = result.curves[0]
    widths = partial(photodiode_widths_um, result.study, own.technology)
    sizes = []
    for name in METRICS["information"].variants:
        fit = fit_of_metric(METRICS["information"], own.pitch_um, own.statistics[name], widths)
        assert fit is not None
        assert own.fits[name].optimum == fit.optimum
        assert result.as_dict()["curves"][0]["optima"][name] == fit.optimum.of_metric()
        sizes.append(fit.optimum)
    (line,) = contrast_words(result, own)
    stated_um = [float(number) for number in re.findall(r"([0-9.]+) µm", line)]
    assert stated_um == pytest.approx([best.pitch_um for best in sizes], abs=5e-3), "two digits"
    assert re.findall(r"at (0\.\d+)", line) == ["0.05", "0.45"]
    assert line in text(study_document(result))


def test_study_of_the_scene_s_own_spectrum_has_no_other_contrasts(tmp_path: Path) -> None:
    """Its rows are known again all the same."""
    plan = tiny(metrics=["information"], metric={"information": {"spectrum": "scene"}})
    result = pixsim.study(plan, tmp_path, jobs=1)
    (own,) = result.curves
    assert contrast_words(result, own) == []
    assert not [name for name in own.as_dict()["metrics"] if "contrast" in name]
    again = pixsim.study(plan, tmp_path, jobs=1)
    assert not list(tmp_path.glob("results.csv.old*")), "rows that are computed again leave a copy"
    np.testing.assert_array_equal(again.curves[0].delta_e, own.delta_e)


def test_delta_e_of_a_study_does_not_depend_on_other_metrics(
    judged: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    alone = pixsim.study(tiny(), tmp_path, jobs=1)
    np.testing.assert_array_equal(alone.curves[0].delta_e, judged[0].curves[0].delta_e)
    assert "optima" not in alone.as_dict()["curves"][0]


def test_noise_equivalent_quanta_are_those_of_the_best_size_by_information(
    judged: tuple[StudyResult, Path],
) -> None:
    """Up to its Nyquist frequency."""
    own = judged[0].curves[0]
    (quanta,) = study_neq(judged[0]).items()
    assert quanta[0] == own.label
    assert quanta[1].frequency_cy_per_mm[-1] == pytest.approx(
        500 / own.optima["information"].pitch_um, rel=1e-6
    )
    assert quanta[1].neq_per_mm2[0] > quanta[1].neq_per_mm2[-1] > 0


def test_run_says_what_each_metric_finds(tmp_path: Path) -> None:
    line = f"run flat -D resolution=48 --display.dots 32 --metric delta_e --out {tmp_path} --metric"
    code, out, err = command(f"{line} information --repeats 3")
    assert code == 0, err
    (of_metric,) = (each for each in out.splitlines() if each.strip().startswith("information "))
    assert of_metric.strip().endswith("bit/mm², of the raw frame")
    score = json.loads((tmp_path / "score.json").read_text())
    assert score["metrics"] == {"information": pytest.approx(score["information"], rel=0.01)}
    assert 'metrics = [\n    "delta_e",' in (tmp_path / "settings.toml").read_text()
    quanta, page = tmp_path / "figures" / "neq.csv", tmp_path / "report.html"
    assert quanta.is_file()
    assert "Noise-equivalent quanta" in page.read_text()
    code, _, err = command(f"{line} mtf50")
    assert code == 0, err
    assert "Noise-equivalent quanta" not in page.read_text()


def test_study_resumes_rows_of_the_same_metrics_only(
    judged: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    whole = (judged[1] / "results.csv").read_text()
    lines = whole.splitlines(keepends=True)
    (tmp_path / "results.csv").write_text("".join(lines[:6]))
    pixsim.study(tiny(metrics=NAMES), tmp_path, jobs=1)
    assert (tmp_path / "results.csv").read_text() == whole
    more = tiny(metrics=[*NAMES, "niirs"])
    pixsim.study(more, tmp_path, jobs=1)
    found = rows(tmp_path)
    assert {row["key"] for row in found}.isdisjoint(line.split(",")[0] for line in lines[1:])
    assert all(float(row["niirs"]) for row in found)


def test_study_may_judge_by_another_metric_first(tmp_path: Path) -> None:
    result = pixsim.study(tiny(metrics=["information", "acutance", "mtf50"]), tmp_path, jobs=1)
    own = result.curves[0]
    assert not own.has_delta_e
    assert own.as_dict()["optimum"] == own.optimum.of_metric(), "no number of ΔE"
    assert own.optimum.value == pytest.approx(own.mean("information").max(), rel=0.05)
    pixsim.write_report(result, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Noise-equivalent quanta" in page
    assert list(own.optima) == ["information", "acutance"], "an MTF50 tells none"
    assert rows(tmp_path / "figures" / "neq.csv")[0].keys() == {
        "sensor",
        "pitch_um",
        "frequency_cy_per_mm",
        "neq_per_mm2",
    }
    assert (tmp_path / "figures" / "regrets.svg").is_file()


def test_command_line_leaves_the_target_out_by_values_of_parameters(tmp_path: Path) -> None:
    """As a table of a file does: twice the target less one of its contrast is one."""
    words = (
        "run target -D size_um=300 -D luminance_cd_per_m2=100 --resolution 48 --display.dots 32"
        " --metric detectability"
    )
    found = []
    for contrast, without in (
        (0.02, "contrast=0"),
        (0.04, "contrast = 0.02"),
        (0.04, "size_um=100,contrast=0.04"),
    ):
        out = tmp_path / without
        code, _, err = command(
            f"{words} -D contrast={contrast}",
            "--out",
            out,
            "--metric.detectability.without",
            without,
        )
        assert code == 0, err
        found.append(json.loads((out / "score.json").read_text())["detectability"])
    assert found[1] == pytest.approx(found[0], rel=0.02), (
        "a brighter one is noisier by its contrast"
    )
    assert found[2] == pytest.approx(math.sqrt(8 / 9) * 2 * found[0], rel=0.05), (
        "a disc less one of a third of its width"
    )


TARGET: dict[str, Any] = {"size_um": 200.0, "contrast": -0.05, "lux": 50.0}
SMALL: dict[str, Any] = {
    "resolution": 48,
    "display": {"dots": 32},
    "exposure": {"integration_s": 0.01},
    "metrics": ["detectability"],
}


def d_prime_at(name: str, value: float, **more: Any) -> float:
    at = TARGET | {name: value}
    result = pixsim.run(
        "target", parameters=at, metric={"detectability": {"registrations": 2}}, **more, **SMALL
    )
    return float(result.statistics[0]["detectability"])


MOVING: dict[str, Any] = {
    "motion": {"image_um_per_s": (20e3, 0.0)}
}  # by its own length within the exposure


@pytest.mark.parametrize(
    ("name", "threshold", "more"),
    [("size_um", 2.0, {}), ("contrast", 10.0, {}), ("contrast", 10.0, MOVING)],
)
def test_run_finds_the_contrast_and_the_size_at_which_a_target_is_seen(
    name: str, threshold: float, more: dict[str, Any]
) -> None:
    """With the value that it says, d′ is the threshold, of what moves too: a search that ends
    within 1e-3 of the value.
    """
    options = {"detectability": {"solve_for": name, "threshold": threshold, "registrations": 2}}
    found = pixsim.run("target", parameters=TARGET, metric=options, **more, **SMALL)
    assert found.as_dict()["at_threshold"]["value"] == found.threshold.value
    assert d_prime_at(name, found.threshold.value, **more) == pytest.approx(threshold, rel=3e-3)


def test_command_says_at_which_value_a_target_is_seen_or_that_it_is_at_none(tmp_path: Path) -> None:
    """In which light it is, and that it is at no contrast."""
    (tmp_path / "find.toml").write_text(
        '[metric.detectability]\nsolve_for = "lux"\nregistrations = 2\n'
    )
    line = (
        "run target -D size_um=200 -D lux=50 -D contrast=-0.05 --resolution 48 --display.dots 32"
        " --metric detectability"
    )
    line += (
        f" --exposure.integration-s 0.01 --config {tmp_path / 'find.toml'}"
        " --metric.detectability.threshold 10"
    )
    code, out, err = command(f"{line} --out {tmp_path / 'lux'}")
    assert code == 0, err
    value = json.loads((tmp_path / "lux" / "score.json").read_text())["at_threshold"]["value"]
    assert f"10 is reached at lux from {value:.3g} on up to " in out
    assert d_prime_at("lux", value) == pytest.approx(10.0, rel=3e-3)
    sought = {"detectability": {"solve_for": "contrast", "threshold": 1000.0, "registrations": 2}}
    found = pixsim.run("target", parameters=TARGET, metric=sought, **SMALL)
    assert found.threshold.value is None
    said = text(run_document(found))
    assert "1000 is not reached at contrast of -" in said
    assert "contrast" in said.split("1000 is not reached")[1]


WELL_LX = 1500.0


def excess_of_light(lux: float, most: float = 1.0) -> float:
    """Logarithm of a d′ over 5 that rises as the root of the light, through 1 at 12 lx, and falls
    where pixels are full.
    """
    return math.log(max(most * math.sqrt(lux / 12.0) / (1 + (lux / WELL_LX) ** 12), 1e-6))


@pytest.mark.parametrize("start", [1e-3, 1.0, 12.0, 100.0, 1400.0, 1700.0, 3000.0, 1e5, 1e7])
def test_search_finds_both_ends_of_the_light_in_which_a_target_is_seen(start: float) -> None:
    """From the dark, from between and from beyond: 12 lx, and where (1 + (E/1500)¹²)² is E/12,
    1837.4 lx; both within 1e-3.
    """
    upper = scipy.optimize.brentq(excess_of_light, WELL_LX, 3 * WELL_LX)
    calls: list[float] = []

    def function(away: float) -> float:
        calls.append(away)
        return excess_of_light(start * math.exp(away))

    low, high = Search(function, {0.0: excess_of_light(start)}).seen()
    assert low is not None
    assert high is not None
    assert start * math.exp(low) == pytest.approx(12.0, rel=2e-3)
    assert start * math.exp(high) == pytest.approx(upper, rel=2e-3)
    assert len(calls) <= MAX_RENDERS


@pytest.mark.parametrize("start", [1.0, 100.0, 1400.0, 1e5])
def test_search_comes_near_the_maximum_of_what_is_seen_nowhere(start: float) -> None:
    search = Search(
        lambda away: excess_of_light(start * math.exp(away), 0.08),
        {0.0: excess_of_light(start, 0.08)},
    )
    assert search.seen() == (None, None)
    most = max(excess_of_light(lux, 0.08) for lux in np.geomspace(100.0, 3000.0, 1000))
    assert most - 0.1 < search.at[search.best] <= most + 1e-9, "10 % of d′"


def test_words_of_a_threshold_name_the_range_that_was_found() -> None:
    tried = (1.0, 8.0)
    for value, upper_value, words in (
        (12.0, None, "5 is reached at lux from 12 on"),
        (12.0, 1837.0, "5 is reached at lux from 12 on up to 1840"),
        (None, 1837.0, "5 is reached at lux up to 1840"),
        (None, None, "5 is not reached at lux of 1 to 8: d′ is at most 4, at 3"),
    ):
        threshold = Threshold(
            "lux",
            5.0,
            value,
            tried,
            "d′ is at most 4, at 3" if value == upper_value else "",
            upper_value,
        )
        assert threshold_pitch_words(threshold) == words


@pytest.mark.parametrize("lux", [4000.0, 1e5])
def test_run_finds_the_light_from_which_on_a_target_is_seen_where_pixels_are_full(
    lux: float,
) -> None:
    """From 4000 lx, where it is seen, and from 1e5 lx, where all pixels are full: too dark below,
    too bright above.
    """
    options = {"detectability": {"solve_for": "lux", "registrations": 2}}
    found = pixsim.run("target", parameters=TARGET | {"lux": lux}, metric=options, **SMALL)
    for value in (found.threshold.value, found.threshold.upper_value):
        assert d_prime_at("lux", value) == pytest.approx(5.0, rel=3e-2)
    assert 50.0 < found.threshold.value < 200.0
    assert found.threshold.upper_value > 1e4
    assert found.as_dict()["at_threshold"]["upper_value"] == found.threshold.upper_value


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "; 5 is reached at 2.06 times this contrast, where contrasts are small"),
        ({"lux": 5}, "; not seen: a target cannot be darker than black"),
        ({"lux": 1e5}, "d′ 0, of one raw frame; not seen: pixels are full without the target"),
    ],
)
def test_run_says_by_which_factor_of_its_contrast_a_target_is_seen_or_why_it_is_not(
    parameters: dict[str, float], words: str
) -> None:
    metric = {"detectability": {"registrations": 2}}
    result = pixsim.run("target", parameters=TARGET | parameters, metric=metric, **SMALL)
    assert words in text(run_document(result))


def test_search_for_a_threshold_starts_from_a_number() -> None:
    none = (
        r"got 'lux', of which no value is stated; allowed: a parameter of target\.xml with a number"
    )
    for name, message in (
        ("lux", none),
        ("shape", "got 'shape', of which the value disc is stated"),
    ):
        with pytest.raises(PixsimError, match=message):
            pixsim.run(
                "target",
                parameters={"size_um": 200.0},
                metric={"detectability": {"solve_for": name}},
                **SMALL,
            )


def test_study_and_comparison_say_that_only_a_run_searches() -> None:
    message = r"^metric\.detectability\.solve_for.* nothing here"
    sought: dict[str, Any] = {
        "metrics": ["detectability"],
        "metric": {"detectability": {"solve_for": "contrast"}},
    }
    with pytest.warns(UserWarning, match=message):
        prepare(tiny(scene={"file": "target"}, **sought))
    with pytest.warns(UserWarning, match=message):
        sensors.prepare(["0.35um", "4t-bsi"], "target", match="view", repeats=2, options=sought)


def test_metrics_are_checked_before_a_render(tmp_path: Path) -> None:
    without_target = r"'detectability'; allowed: light of the scene without its target"
    for name, message in (
        ("detectability", without_target),
        ("nothing", r"metrics: got 'nothing'"),
    ):
        with pytest.raises(PixsimError, match=message):
            pixsim.study(tiny(metrics=[name]), tmp_path)
    assert not (tmp_path / "results.csv").exists()


def test_comparison_has_scores_and_probabilities_of_each_metric() -> None:
    small: dict[str, Any] = {
        "display": {"dots": 32},
        "resolution": 48,
        "pixel": {"pitch_um": 60.0},
        "camera": {"die_mm": 2.7},
    }
    result = pixsim.compare(
        ["0.35um", "4t-bsi"], repeats=3, jobs=1, metrics=["visual_noise"], **small
    )
    assert isinstance(result, pixsim.studies.comparison.Comparison)
    of_metric = result.as_dict()["metrics"]["visual_noise"]
    low, mean, high = of_metric["scores"]["0.35um"]
    assert low < mean < high
    assert mean == pytest.approx(result.judged["visual_noise"]["0.35um"].mean())
    assert 0 <= of_metric["probability_a_better"]["4t-bsi"] < 0.5, "a quieter pixel"


def test_scene_without_the_target_lies_next_to_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In files of studies and sensors; the settings of a folder have its whole path; a wrong name
    is known before a render.
    """
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "empty.xml").write_text("<scene/>")
    table = '[metric.detectability]\nwithout = "empty.xml"\n'
    (folder / "study.toml").write_text(f'name = "a"\nmetrics = ["detectability"]\n{table}')
    (folder / "sensor.toml").write_text(table)
    monkeypatch.chdir(tmp_path)
    study = load_study(folder / "study.toml")
    assert study.metric.detectability.without == str(folder / "empty.xml")
    assert settings_layer(folder / "sensor.toml").table["metric"]["detectability"][
        "without"
    ] == str(folder / "empty.xml")
    stated = study.model_copy(
        update={"metric": MetricOptions(detectability={"without": "own/empty.xml"})}
    )
    assert f'without = "{folder / "empty.xml"}"' in settings_text(stated, "again")
    with pytest.raises(
        PixsimError,
        match=r"without.*: scene: got 'none.xml', which does not exist; allowed: an XML file",
    ):
        prepare(tiny(metrics=["detectability"], metric={"detectability": {"without": "none.xml"}}))


def test_curve_that_was_sent_to_a_worker_is_judged_by_delta_e() -> None:
    """Figures are drawn in workers, where a metric is a copy."""
    own = pickle.loads(pickle.dumps(curve_of(3.0, 3.0)))
    assert own.judged_by_delta_e
    assert own.has_delta_e
    assert list(own.optima) == ["delta_e", "information"]


def test_size_worth_nothing_or_without_a_number_is_a_point_that_the_curve_does_without() -> None:
    """Beyond a size that is worth nothing, no other counts; one without a number is only left out.
    ΔE takes all sizes.
    """
    values = 50.0 / parabola(3.0)
    values[5, 1] = 0.0
    values[1] = np.nan
    metric = METRICS["information"]
    np.testing.assert_array_equal(
        fittable_pitches(metric, values), [True, False, True, True, True, False, False]
    )
    fit = fit_of_metric(metric, PITCH_UM, values, np.asarray)
    assert fit is not None
    kept = [0, 2, 3, 4]
    alone = fit_curve(PITCH_UM[kept], metric.loss(values[kept]))
    assert fit.optimum.pitch_um == alone.optimum.pitch_um
    own = curve(parabola(3.0), values)
    assert own.fittable.all()
    by_information = own.judged_by("information")
    assert np.isnan(by_information.delta_e[[1, 5, 6]]).all()
    shown, half = first_metric_and_ci95(by_information)
    np.testing.assert_allclose(shown[[0, 5]], values[[0, 5]].mean(axis=1), rtol=1e-3)
    assert np.isnan(half[[1, 5, 6]]).all()
    assert own.judged_by("information").judged_by("delta_e").optimum is own.optimum


def test_nothing_is_left_of_a_metric_at_a_size_where_it_is_zero() -> None:
    """ΔE is best at 6 µm, where the other is 0: all of it is lost there."""
    values = 50.0 / parabola(2.9)
    values[6] = 0.0
    regrets = metric_regrets(curve(parabola(6.0, 3.0), values))
    assert regrets.matrix[1, 0] > 19, "less than 5 % is left"
    infinite = replace(
        regrets.criteria[0], optimum=replace(regrets.criteria[0].optimum, pitch_um=6.0)
    )
    at_zero = replace(regrets, criteria=(infinite, regrets.criteria[1]))
    assert regrets_data(at_zero)["regret"][1][0] is None
    _, matrix = regrets_tables(at_zero)
    assert [*matrix.rows][1] == ("2 information", "∞", "–")


@pytest.mark.parametrize(
    ("integration_s", "bits", "silent", "reason"),
    [
        (0.37, 8, [11.0, 15.0], "detectability d′ leaves out 11, 15 µm"),
        (0.1, 7, [5.3], "leaves out 5.3 µm.*noise of 0.43 DN"),
    ],
    ids=["saturated", "rounded"],
)
def test_size_at_which_the_first_metric_fails_does_not_end_a_study(
    integration_s: float, bits: int, silent: list[float], reason: str, tmp_path: Path
) -> None:
    """The whole target is saturated in large pixels, or the noise of small ones is rounded away;
    again, nothing changes.
    """
    scene = {
        "file": "target",
        "parameters": {"size_um": 40.0, "contrast": 0.02, "luminance_cd_per_m2": 100.0},
    }
    over = {
        "exposure": {"integration_s": integration_s},
        "pixel": {"bits": bits, "black_level_dn": 2},
    }
    asked = tiny(metrics=["detectability", "delta_e"], scene=scene, **over)
    result = pixsim.study(asked, tmp_path, jobs=1)
    own = result.curves[0]
    assert own.pitch_um[~own.fittable].tolist() == silent
    assert own.sensors.tolist() == [2] * own.pitch_um.size
    assert own.optima["delta_e"].pitch_um
    assert any(re.search(reason, note) for note in study_notes(result))
    assert "NaN" not in json.dumps(result.as_dict())
    written = (tmp_path / "results.csv").read_bytes()
    assert pixsim.study(asked, tmp_path, jobs=1).as_dict()["notes"] == [
        note.as_dict() for note in study_notes(result)
    ]
    assert (tmp_path / "results.csv").read_bytes() == written
    assert not list(tmp_path.glob("*.old"))


def test_study_of_conditions_judges_by_any_metric_first(tmp_path: Path) -> None:
    """Its tables have the regrets and the optima by each metric, in its own unit and direction."""
    of_light = {
        name: {"scene": {"parameters": {"luminance_cd_per_m2": each}}}
        for name, each in (("day", 400), ("night", 10))
    }
    light = [{"name": name, "set": own} for name, own in of_light.items()]
    axis = [{"name": "f", "set": "camera.f_number", "values": [2.0, 4.0]}]
    result = pixsim.study(
        tiny(metrics=["information", "delta_e", "mtf50"], axis=axis, condition=light),
        tmp_path,
        jobs=1,
    )
    optima = optima_columns(result)
    assert list(optima["delta_e_optimum_um"]) == [
        each.optima["delta_e"].pitch_um for each in result.curves
    ]
    assert not any(name.startswith("mtf50") for name in optima), "it tells no best size"
    assert list(optima["best_information"]) == [each.optimum.value for each in result.curves]
    assert list(optima["best_delta_e"]) == [each.optima["delta_e"].value for each in result.curves]
    regrets = condition_regrets(result.study, result.curves)
    table = regrets_columns(regrets)
    assert list(table["metric"]) == [
        name for _ in range(2) for name in ("information", "delta_e") for _ in range(3)
    ]
    first = cases_data(result, regrets)["regrets"][0]
    assert first["names"] == ["day", "night", "weighted mean"]
    values = [optimum["value"] for optimum in first["optima"]]
    assert 0.9 * np.mean(values[:2]) < values[2] <= np.mean(values[:2]), (
        "no size is better than each condition's own"
    )
    page = axes_page(result, regrets, [])
    (section,) = (section for section in page.sections if section.id == "regrets")
    tables = [block for block in section.blocks if isinstance(block, DocumentTable)]
    assert len(tables) == 2 * len(regrets) == 8, (
        "best sizes and regrets, at two values of the axis, by two metrics"
    )
    names = {"information_by_pitch_and_f.svg", "optimum_by_f.svg", "regrets_1.svg"}
    assert names <= {Path(name).name for name in axes_files(result.study)}
