"""Distributions of an optimum over sensor types, against closed forms: a synthetic sensor whose optimum is known."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import toml_of
from scipy import stats

from pixsim.base.errors import PixsimError
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.report.uncertainty import uncertainty_blocks
from pixsim.sensor.diffusion import absorption_per_um
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spread import Spread
from pixsim.sensor.technology import Technology, load_technology
from pixsim.studies.indices import total_indices
from pixsim.studies.optimum import fit_curve
from pixsim.studies.pixels import technology_of
from pixsim.studies.study_layers import with_data_sheets
from pixsim.studies.study_settings import Study
from pixsim.studies.uncertainty import (
    SHARED,
    Outcome,
    Probability,
    ResultDistribution,
    UncertaintyResult,
    Unknown,
    distribution_plate,
    few_pitches_um,
    indices_plate,
    input_labels,
    inputs_of,
    quantile_of,
    sample_types,
    settings_of,
    sobol_points,
    summarise,
    unknowns_of_sheet,
    unknowns_of_study,
    unknowns_of_technology,
)
from pixsim.viewer.merging import merge

WIDE_UM = (1e-3, 1e3)
NAMES = ("p05", "p25", "p50", "p75", "p95")
SHARES = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
Z = stats.norm.ppf(SHARES)


Evaluate = Callable[[list[dict[str, float]]], list[Outcome]]  # of the values of each sensor type


def propagate(unknowns: Sequence[Unknown], evaluate: Evaluate, n: int, seed: int = 0) -> UncertaintyResult:
    sample = sample_types(unknowns, n, seed)
    return summarise(sample, evaluate(sample.draws), n, seed)


def sensor(
    optimum_um: Callable[[dict[str, float]], float],
    tried_um: tuple[float, float] = WIDE_UM,
    half_um: float = 0.0,
    noise_um: float = 0.0,
) -> Callable[[list[dict[str, float]]], list[Outcome]]:
    """An `evaluate` of a known optimum, with a known error of it, and its interval; its least ΔE is a tenth of the optimum."""

    def evaluate(draws: list[dict[str, float]]) -> list[Outcome]:
        errors = noise_um * np.random.default_rng(0).standard_normal(len(draws))
        outcomes = []
        for draw, error in zip(draws, errors.tolist(), strict=True):
            best = optimum_um(draw) + error
            shown = min(max(best, tried_um[0]), tried_um[1])
            inside = tried_um[0] < best < tried_um[1]
            interval = (shown - half_um, shown + half_um) if inside else (None, None)
            outcomes.append(Outcome(shown, interval, shown / 10, inside, tried_um, {"smaller than 3 µm": best < 3}))
        return outcomes

    return evaluate


NORMAL = [
    Unknown("read_noise_e", 5.0, Spread(sd=0.5)),
    Unknown("full_well_e", 1e4, Spread(range=(9e3, 11e3), distribution="normal")),
    Unknown("dsnu", 0.3, Spread(sd=0.02)),
]
WELL_SD_E = 1e3 / stats.norm.ppf(0.95)


def linear(draw: dict[str, float]) -> float:
    """A mean of 3.1 µm and standard deviations of 0.3, 0.4 and 0 µm: 0.5 in all."""
    return 3.1 + 0.6 * (draw["read_noise_e"] - 5) - 0.4 / WELL_SD_E * (draw["full_well_e"] - 1e4)


def quantiles(distribution: ResultDistribution) -> np.ndarray:
    assert tuple(distribution.quantiles) == NAMES
    return np.array(list(distribution.quantiles.values()), float)


# --- Closed forms ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
def test_propagate_linear_optimum_of_normal_inputs(seed: int) -> None:
    """Over 40 seeds of 256 draws: mean within 0.0014, sd within 1.3 %, quantiles within 0.09 sd, the share within 0.017."""
    result = propagate(NORMAL, sensor(linear), 256, seed)
    assert result.optimum.mean == pytest.approx(3.1, abs=0.002)
    assert result.optimum.sd == pytest.approx(0.5, rel=0.02)
    np.testing.assert_allclose(quantiles(result.optimum), 3.1 + 0.5 * Z, atol=0.12 * 0.5)
    np.testing.assert_allclose(quantiles(result.least_delta_e), 0.31 + 0.05 * Z, atol=0.12 * 0.05)
    for found in result.first_order.values():
        assert found.q2 > 0.999
        assert [index.share for index in found.indices.values()] == pytest.approx([0.36, 0.64, 0], abs=2e-3)
    verdict = result.verdicts["smaller than 3 µm"]
    assert verdict.probability == pytest.approx(stats.norm.cdf(-0.2), abs=0.02)
    assert verdict.low < stats.norm.cdf(-0.2) < verdict.high


def test_propagate_power_law_of_lognormal_inputs() -> None:
    """optimum = 3 (a/2)^0.5 (b/7)^-0.3 is lognormal: logarithms have deviations 0.5 · 0.2 and 0.3 · 0.3, and no mean."""
    width = stats.norm.ppf(0.95)
    unknowns = [
        Unknown("a_e", 2.0, Spread(range=(2 * math.exp(-0.2 * width), 2 * math.exp(0.2 * width)), distribution="lognormal")),
        Unknown("b_e", 7.0, Spread(range=(7 * math.exp(-0.3 * width), 7 * math.exp(0.3 * width)), distribution="lognormal")),
    ]
    result = propagate(unknowns, sensor(lambda draw: 3 * (draw["a_e"] / 2) ** 0.5 * (draw["b_e"] / 7) ** -0.3), 256)
    variance = 0.1**2 + 0.09**2
    sd = math.sqrt(variance)
    np.testing.assert_allclose(np.log(quantiles(result.optimum) / 3), sd * Z, atol=0.1 * sd)
    assert result.optimum.mean == pytest.approx(3 * math.exp(variance / 2), rel=1e-3)
    assert result.optimum.sd == pytest.approx(3 * math.exp(variance / 2) * math.sqrt(math.expm1(variance)), rel=0.02)
    # Var(E[y|a])/Var(y) of a product: expm1 of each variance over expm1 of their sum.
    found = [index.share for index in result.first_order["optimum_um"].indices.values()]
    assert found == pytest.approx(np.expm1([0.1**2, 0.09**2]) / math.expm1(variance), abs=5e-3)


def test_total_indices_of_sobol_points() -> None:
    """y = z + z' + z z' of standard normal inputs: first-order indices of 1/3, total ones of 2/3.

    With 1024 rows, errors over 20 seeds are up to 0.03, of a standard deviation of 0.011: five of them.
    """
    sample = sobol_points(NORMAL[:2], 1000, seed=1)
    assert sample.quantiles.shape == (1024 * 4, 2)
    z = np.array([[(draw["read_noise_e"] - 5) / 0.5, (draw["full_well_e"] - 1e4) / WELL_SD_E] for draw in sample.draws])
    first, total = total_indices(z.sum(axis=1) + z.prod(axis=1), list(sample.inputs))
    assert [index.share for index in first.values()] == pytest.approx([1 / 3] * 2, abs=0.055)
    assert [index.share for index in total.values()] == pytest.approx([2 / 3] * 2, abs=0.055)


@pytest.mark.parametrize(
    ("spread", "reference"),
    [
        (Spread(sd=0.5), stats.norm(2, 0.5)),
        (Spread(range=(1.0, 4.0)), stats.uniform(1, 3)),
        (Spread(range=(1.0, 4.0), distribution="normal"), stats.norm(2.5, 1.5 / stats.norm.ppf(0.95))),
        (Spread(range=(1.0, 4.0), distribution="lognormal"), stats.lognorm(math.log(2) / stats.norm.ppf(0.95), scale=2)),
        (Spread(sd=0.5, distribution="uniform"), stats.uniform(2 - 0.5 * 3**0.5, 3**0.5)),
        # Of a mean of 2 and a standard deviation of 0.8.
        (Spread(sd=0.8, distribution="lognormal"), stats.lognorm(math.sqrt(math.log(1.16)), scale=2 / math.sqrt(1.16))),
    ],
)
def test_unknown_at_matches_scipy(spread: Spread, reference: Any) -> None:
    unknown = Unknown("x_e", 2.0, spread)
    share = np.linspace(0.001, 0.999, 99)
    np.testing.assert_allclose(unknown.at(share), reference.ppf(share), rtol=1e-9)
    assert unknown.kept == 1
    # Cut at bounds: the rest of the distribution, over its share.
    cut = replace(unknown, allowed=(1.6, 3.5))
    low, high = reference.cdf([1.6, 3.5])
    np.testing.assert_allclose(cut.at(share), reference.ppf(low + share * (high - low)), rtol=1e-9)
    assert cut.kept == pytest.approx(high - low, rel=1e-9)


def test_value_quantile_is_inverse_of_at() -> None:
    """And a value far from the middle of its range is stated, since the base's optimum is then not the median."""
    for spread in (Spread(sd=0.5), Spread(range=(1.9, 4.0)), Spread(range=(1.9, 4.0), distribution="lognormal")):
        unknown = Unknown("dsnu", 2.0, spread, allowed=(1.0, 3.9))
        assert unknown.at(np.array([unknown.value_quantile])) == pytest.approx([2.0], rel=1e-12)
    lines = propagate([replace(unknown, spread=Spread(range=(1.9, 4.0)))], sensor(lambda draw: draw["dsnu"]), 8).statements
    assert any("dsnu (5%)" in line for line in lines)
    assert not any("quantiles:" in line for line in propagate(NORMAL, sensor(linear), 8).statements)


# --- Censoring, and the optimum's own interval -------------------------------------------------------------------------


def test_propagate_censored_optima_are_a_share() -> None:
    """Below 2.6 µm, a standard deviation below the mean, 15.9 % are censored (over 40 seeds, within 1.4 %): p05 is open."""
    whole = propagate(NORMAL, sensor(linear), 256, 1)
    result = propagate(NORMAL, sensor(linear, (2.6, 4.6)), 256, 1)
    distribution = result.optimum
    assert distribution.censored_low == pytest.approx(stats.norm.cdf(-1), abs=0.02)
    assert distribution.censored_high == pytest.approx(stats.norm.cdf(-3), abs=0.005)
    assert distribution.quantiles["p05"] is None
    assert [distribution.quantiles[name] for name in NAMES[1:]] == [whole.optimum.quantiles[name] for name in NAMES[1:]]
    assert any("15.6% of the optima are at or beyond the smallest" in line for line in result.statements)
    # A clipped optimum describes the range of pitches as much as the inputs.
    assert "16% of the optima are at an end" in result.first_order["optimum_um"].withheld
    assert result.first_order["mean_delta_e"].withheld == ""
    few = propagate(NORMAL, sensor(linear, (2.4, 4.6)), 64, 1)  # 8 %
    assert few.first_order["optimum_um"].withheld == ""


def test_propagate_all_optima_censored() -> None:
    result = propagate(NORMAL, sensor(linear, (10.0, 20.0)), 16)
    assert result.optimum.as_dict() == {
        "quantiles": dict.fromkeys(NAMES), "mean": None, "sd": None, "scatter_sd": None, "own_sd": 0.0, "censored_low": 1.0,
        "censored_high": 0.0, "apart": True,
    }  # fmt: skip
    json.dumps(result.as_dict(), allow_nan=False)
    assert "100% of the optima" in indices_plate(result).caption
    assert "beyond the sizes tried" in distribution_plate(result).caption


@pytest.mark.parametrize("noise_um", [0.2, 0.5])
def test_propagate_subtracts_own_interval(noise_um: float) -> None:
    """Errors of a known standard deviation, given with their intervals, leave the inputs' distribution.

    A variance of 0.25 + noise² from 1024 draws, of which the noise's part is known to √(2/1024): five times that.
    """
    result = propagate(NORMAL, sensor(linear, half_um=1.96 * noise_um, noise_um=noise_um), 1024)
    distribution = result.optimum
    assert distribution.own_sd == pytest.approx(noise_um, rel=1e-4)
    assert distribution.scatter_sd == pytest.approx(math.hypot(0.5, noise_um), rel=0.05)
    # Also the inputs' and the noise's product does not vanish exactly: 0.5 · noise/√1024.
    error = 5 * math.hypot(noise_um**2 * math.sqrt(2 / 1024), 2 * 0.5 * noise_um / 32) / (2 * 0.5)
    assert distribution.sd == pytest.approx(0.5, abs=error)
    np.testing.assert_allclose(quantiles(distribution), 3.1 + 0.5 * Z, atol=2 * error)
    assert abs(quantiles(propagate(NORMAL, sensor(linear, noise_um=noise_um), 1024).optimum)[0] - 3.1 + 1.645 * 0.5) > 0.05
    assert any("variances subtracted" in line for line in result.statements)


@pytest.mark.parametrize("half_um", [0.9, 2.0])
def test_own_interval_as_wide_as_scatter_leaves_the_optima_as_they_are(half_um: float) -> None:
    """Types that share their random numbers scatter by less than their intervals say: 0.5 µm here, 0.46 and 1.02 µm of their own.

    Of 64 types, the variance that is left has a standard error of 18 % of theirs.
    """
    result = propagate(NORMAL, sensor(linear, half_um=half_um), 64)
    assert result.optimum.sd == pytest.approx(math.sqrt(max(result.optimum.scatter_sd**2 - (half_um / 1.96) ** 2, 0)), abs=1e-4)
    assert not result.optimum.apart
    # Quantiles of 64 balanced points: those of the inputs to a thirty-second of the distribution.
    np.testing.assert_allclose(quantiles(result.optimum), 3.1 + 0.5 * Z, atol=0.1)
    (line,) = [line for line in result.statements if "do not tell" in line]
    assert f"known to {half_um / 1.96:.3g} µm" in line
    assert f"±{half_um:.2g} µm by its own 95 % interval" in str(uncertainty_blocks([result])[0])


@pytest.mark.parametrize(
    ("optimum_um", "interval_um", "variance_um2", "side"),
    [(3.0, (2.0, 6.0), 1.0412, -1), (1.0, (None, 6.0), 6.5077, -1), (9.0, (2.0, None), 12.755, 1), (1.2, (None, None), None, -1)],
)
def test_outcome_own_variance_and_censored_side(
    optimum_um: float, interval_um: tuple[float | None, float | None], variance_um2: float | None, side: int
) -> None:
    """The half widths over 1.96, squared: 2, 5 and 7 µm."""
    outcome = Outcome(optimum_um, interval_um, 1.0, False, (1.0, 9.0))
    assert outcome.own_variance_um2 == (None if variance_um2 is None else pytest.approx(variance_um2, rel=1e-3))
    assert (outcome.censored, replace(outcome, inside=True).censored) == (side, 0)


def test_quantile_of_matches_numpy() -> None:
    values = np.random.default_rng(0).standard_normal(37)
    for share in (0.001, 0.05, 0.5, 0.77, 0.999):
        assert quantile_of(values, share) == pytest.approx(np.quantile(values, share, method="hazen"), rel=1e-12)
    # Half of four values is between the second and the third: known if both are.
    assert quantile_of(np.array([-np.inf, 1.0, 2.0, np.inf]), 0.5) == 1.5
    assert quantile_of(np.array([-np.inf, -np.inf, 2.0, 3.0]), 0.5) is None


# --- Verdicts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("holds", "draws"), [(0, 64), (1, 64), (32, 64), (64, 64), (250, 256)])
def test_probability_is_jeffreys_interval(holds: int, draws: int) -> None:
    found = Probability.of([True] * holds + [False] * (draws - holds))
    low, high = stats.beta.ppf([0.025, 0.975], holds + 0.5, draws - holds + 0.5)
    expected = (holds / draws, 0.0 if not holds else low, 1.0 if holds == draws else high, draws)
    assert (found.probability, found.low, found.high, found.draws) == pytest.approx(expected, rel=1e-9)


# --- Inputs ------------------------------------------------------------------------------------------------------------


def technologies(*names: str) -> list[Unknown]:
    return [unknown for name in names for unknown in unknowns_of_technology(load_technology(name), name)]


OF_LAYOUT = {"prnu_um", "a_vt_mv_um", "follower_area_um2"}


@pytest.mark.parametrize(
    ("pixel", "left"),
    [
        ({}, OF_LAYOUT),
        ({"prnu": 0.01}, OF_LAYOUT - {"prnu_um"}),
        ({"prnu_percent": 1.0}, OF_LAYOUT - {"prnu_um"}),
        ({"offset_fpn": 0.001}, {"prnu_um"}),
        ({"dsnu_e": 2.0}, {"prnu_um"}),
    ],
)
def test_unknowns_of_study_leave_out_what_the_pixel_states_in_another_word(
    pixel: dict[str, float], left: set[str], tmp_path: Path
) -> None:
    """A technology's mismatch of the layout is known where the pixel gives a plain number in its place."""
    parts = packaged("data/technologies")["0.35um"].read_text(encoding="utf-8").split("\n\n")
    text = "\n\n".join(part for part in parts if not part.startswith(("[prnu]", "[offset_fpn]")))
    for name in sorted(OF_LAYOUT):
        text += f'\n[{name}]\nvalue = 0.05\nrange = [0.04, 0.06]\nconfidence = "D"\nsource = "assumed here"\n'
    path = tmp_path / "layout.toml"
    path.write_text(text, encoding="utf-8")
    unknowns = unknowns_of_study(Study.model_validate({"name": "s", "technologies": [str(path)], "pixel": pixel}))
    assert {unknown.quantity for unknown in unknowns} & OF_LAYOUT == left


def test_shared_quantities_have_one_draw() -> None:
    unknowns = technologies("0.35um", "0.18um", "4t-bsi")
    sample = sample_types(unknowns, 8, seed=3)
    for quantity in ("dark_current_na_per_cm2", "dsnu", "offset_fpn", "column_fpn"):
        assert quantity in SHARED
        assert [unknown.technology for unknown in sample.inputs[quantity]] == ["0.35um", "0.18um", "4t-bsi"]
        places = []
        for unknown in sample.inputs[quantity]:  # all are uniform between the ends of their range
            low, high = unknown.spread.range
            places.append([(draw[unknown.name] - low) / (high - low) for draw in sample.draws])
        np.testing.assert_allclose(places, [places[0]] * 3, rtol=1e-9)
    others = {name for name in sample.inputs if name not in SHARED}
    assert len(others) == sum(unknown.quantity not in SHARED for unknown in unknowns)
    assert sample.draws[0].keys() == {unknown.name for unknown in unknowns}
    apart = sample_types(unknowns, 8, seed=3, shared=())
    assert len(apart.inputs) == len(unknowns)
    assert list(inputs_of(unknowns, ["dsnu"]).items())[-1][1][0].quantity != "dsnu"
    assert "dsnu" in inputs_of(unknowns, ["dsnu"])
    assert "offset_fpn" not in inputs_of(unknowns, ["dsnu"])


def test_inputs_are_independent_and_even() -> None:
    """Each input has one draw in each of n equal parts of its distribution, and no pair is correlated."""
    sample = sample_types(technologies("0.35um", "4t-bsi"), 256, seed=5)
    cells = np.sort((sample.quantiles * 256).astype(int), axis=0)
    np.testing.assert_array_equal(cells, np.tile(np.arange(256)[:, None], sample.quantiles.shape[1]))
    apart = np.corrcoef(sample.quantiles.T) - np.eye(len(sample.inputs))
    assert np.abs(apart).max() < 5 / 16, "five standard errors of 256 independent draws"
    assert ((sample.quantiles > 0) & (sample.quantiles < 1)).all()


@pytest.mark.parametrize("distribution", ["uniform", "normal", "lognormal"])
@pytest.mark.parametrize("name", ["0.35um", "4t-fsi"])
def test_unknowns_of_technology_draw_valid_technologies(name: str, distribution: str) -> None:
    base = load_technology(name)
    kinds = {number: distribution for number, (low, _) in base.ranges.items() if low > 0}
    technology = Technology.model_validate(base.model_dump() | {"distributions": kinds})
    unknowns = unknowns_of_technology(technology, name)
    assert {unknown.quantity for unknown in unknowns} == set(base.ranges)
    assert {unknown.spread.kind for unknown in unknowns} == {distribution}
    assert {unknown.name for unknown in unknowns} == {f"{name} {number}" for number in base.ranges}
    for draw in sample_types(unknowns, 64).draws:
        drawn = technology.with_numbers({unknown.quantity: draw[unknown.name] for unknown in unknowns}, "here")
        assert drawn.numbers != technology.numbers
    fewer = unknowns_of_technology(technology, name, known=["dsnu"])
    assert {unknown.quantity for unknown in fewer} == set(base.ranges) - {"dsnu"}


@pytest.mark.parametrize("swing", [(0.9, 2.2), (0.9, 1.5)])
@pytest.mark.parametrize("reset", [(1.2, 3.0), None])
def test_unknowns_of_technology_keep_their_order(swing: tuple[float, float], reset: tuple[float, float] | None) -> None:
    """A swing above the reset voltage is no pixel: where the ranges meet, they are cut between both values, and that is stated."""
    base = load_technology("0.35um")
    ranges = {"voltage_swing_v": swing} | ({"reset_voltage_v": reset} if reset else {})
    kinds = dict.fromkeys(ranges, "normal")
    technology = Technology.model_validate(base.model_dump() | {"ranges": ranges, "distributions": kinds})
    unknowns = unknowns_of_technology(technology, "mine")
    sample = sample_types(unknowns, 64)
    for draw in sample.draws:
        technology.with_numbers({unknown.quantity: draw[unknown.name] for unknown in unknowns}, "here")
    result = propagate(unknowns, sensor(lambda draw: draw["mine voltage_swing_v"]), 64)
    if swing[1] == 2.2:
        assert any("mine voltage_swing_v" in line and "cut off" in line for line in result.statements)


SHEET = {"pitch_um": 3.75, "full_well_e": 10500.0, "read_noise_e": 2.3, "dark_current_e_per_s": 3.0, "quantum_efficiency": 0.9}


def test_unknowns_of_sheet_draw_valid_pixels() -> None:
    pixel = Pixel(**SHEET)
    spreads = {
        "read_noise_e": Spread(sd=2.0), "dark_current_e_per_s": Spread(sd=2.0, distribution="lognormal"),
        "quantum_efficiency": Spread(sd=0.1), "full_well_e": Spread(range=(8e3, 12e3)),
    }  # fmt: skip
    unknowns = unknowns_of_sheet(pixel, spreads)
    assert [unknown.name for unknown in unknowns] == list(spreads)
    assert [unknown.value for unknown in unknowns] == [2.3, 3.0, 0.9, 10500.0]
    result = propagate(unknowns, sensor(lambda draw: 3 + draw["read_noise_e"] / 10), 64)
    for draw in result.sample.draws:
        Pixel(**SHEET | draw)
    assert any(
        "quantum_efficiency: 15.87% of its normal distribution lies outside 1e-12 to 1" in line for line in result.statements
    )
    assert unknowns_of_sheet(pixel, spreads, "a.toml")[0].name == "a.toml read_noise_e"


def test_unknown_efficiency_of_one_wavelength_stays_below_what_silicon_absorbs() -> None:
    """0.9 at 600 nm: 5 µm of silicon absorb 0.876 of that light, too little for it, and 10 µm 0.985, where draws end."""
    deep = Pixel(**SHEET, quantum_efficiency_nm=600, quantum_efficiency_depth_um=10)
    (unknown,) = unknowns_of_sheet(deep, {"quantum_efficiency": Spread(sd=0.05)})
    highest = float(unknown.at(np.array([1.0]))[0])
    assert highest == pytest.approx(1 - np.exp(-10 * absorption_per_um(600.0)), rel=1e-9)
    physics = derive(deep.model_copy(update={"quantum_efficiency": highest}))
    assert physics.quantum_efficiency(350.0) == pytest.approx(1.0, abs=1e-6)


def test_study_of_a_draw_has_its_numbers(tmp_path) -> None:
    """Technologies, data sheets among them, one with a technology of its own, numbers set by the study, and its own [pixel]."""
    sheet, mixed = tmp_path / "sheet.toml", tmp_path / "mixed.toml"
    of_technology = {"technology": "4t-bsi", "pitch_um": 1.4, "dsnu": 0.2, "prnu_percent": 1}
    for path, pixel in (
        (sheet, SHEET | {"uncertainty": {"full_well_e": {"sd": 500}}}),
        (mixed, of_technology | {"uncertainty": {"dsnu": {"sd": 0.05}}}),
    ):
        path.write_text(f"pixel = {toml_of(pixel)}\n", encoding="utf-8")
    names = ["0.35um", str(sheet), str(mixed)]
    table = {"name": "a", "technologies": names, "process": {"0.35um": {"dsnu": 0.25}}, "pixel": {"read_noise_e": 3.0}}
    study = checked(Study, with_data_sheets([Layer(table)], {}))
    unknowns = unknowns_of_study(study, {"": {"read_noise_e": Spread(sd=0.3)}})
    quantities = {name: {unknown.quantity for unknown in unknowns if unknown.technology == name} for name in ["", *names]}
    assert quantities[""] == {"read_noise_e"}
    assert quantities["0.35um"] == set(load_technology("0.35um").ranges) - {"dsnu"}, "the study sets it"
    assert quantities[str(sheet)] == {"full_well_e"}
    given = {"prnu_um", "read_noise_e", "read_noise_after_gain_e"}  # by the data sheet's PRNU, and by [pixel]
    assert quantities[str(mixed)] == set(load_technology("4t-bsi").ranges) - given, "DSNU by its own uncertainty"
    for stack, known in (({"enabled": False}, {"height_um", "index", "crosstalk"}), ({"height_um": 3.0}, {"height_um"})):
        own = Study(name="b", technologies=["4t-bsi"], pixel={"stack": stack})
        left = set(load_technology("4t-bsi").ranges) - {f"stack_{name}" for name in known}
        assert {unknown.quantity for unknown in unknowns_of_study(own)} == left
    base = study.model_dump(mode="json", exclude_unset=True)
    for draw in sample_types(unknowns, 8).draws:
        drawn = Study.model_validate(merge(base, settings_of(study, unknowns, draw)))
        assert drawn.pixel.read_noise_e == draw["read_noise_e"]
        assert drawn.sensors[str(sheet)].full_well_e == draw[f"{sheet} full_well_e"]
        assert drawn.sensors[str(mixed)].dsnu == draw[f"{mixed} dsnu"]
        for name in ("0.35um", str(mixed)):
            numbers, varied = technology_of(drawn, name).numbers, quantities[name] - {"dsnu"}
            assert {key: numbers[key] for key in varied} == {key: draw[f"{name} {key}"] for key in varied}
        assert technology_of(drawn, "0.35um").numbers["dsnu"] == 0.25
        assert (drawn.name, drawn.technologies) == (study.name, study.technologies), "the random streams depend on them"


# --- Files, figures, repetition ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result() -> UncertaintyResult:
    return propagate(NORMAL, sensor(linear, (2.35, 9.0), half_um=0.1), 60, 7)


def test_propagate_repeats_bit_for_bit(result: UncertaintyResult) -> None:
    again = propagate(NORMAL, sensor(linear, (2.35, 9.0), half_um=0.1), 60, 7)
    assert json.dumps(again.as_dict()) == json.dumps(result.as_dict())
    assert again.to_csv() == result.to_csv()
    other = propagate(NORMAL, sensor(linear, (2.35, 9.0), half_um=0.1), 60, 8)
    assert not set(other.to_csv().splitlines()[1:]) & set(result.to_csv().splitlines()[1:])
    # Outcomes that are known already, as of a continued study, give the same.
    known = summarise(sample_types(NORMAL, 60, 7), result.outcomes, 60, 7)
    assert known.as_dict() == result.as_dict()


def test_as_dict_and_csv(result: UncertaintyResult, tmp_path) -> None:
    summary = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert (summary["draws"], summary["asked"], summary["seed"]) == (64, 60, 7)
    assert "64 sensor types, 60 rounded up to a power of two" in summary["statements"]
    assert summary["inputs"]["full_well_e"] == [
        {"name": "full_well_e", "value": 1e4, "distribution": "normal", "range": [9e3, 11e3]}
    ]
    rows = list(csv.DictReader(io.StringIO(result.to_csv(tmp_path / "draws.csv"))))
    assert (tmp_path / "draws.csv").read_text(encoding="utf-8").splitlines() == result.to_csv().splitlines()
    assert len(rows) == 64
    for row, draw, outcome in zip(rows, result.sample.draws, result.outcomes, strict=True):
        assert {name: float(row[name]) for name in draw} == draw
        assert float(row["optimum_um"]) == outcome.optimum_um
        assert row["interval_low_um"] == ("" if outcome.interval_um[0] is None else str(outcome.interval_um[0]))
        assert row["smaller than 3 µm"] == str(outcome.verdicts["smaller than 3 µm"])


def test_plates_say_what_is_seen(result: UncertaintyResult) -> None:
    shown, shares = distribution_plate(result), indices_plate(result)
    median = result.optimum.quantiles["p50"]
    assert f"Median of the optima: {median:.2f} µm" in shown.caption
    assert f"{result.optimum.censored_low:.1%} at or beyond the smallest" in shown.caption
    assert shown.table["optimum_um"] == [outcome.optimum_um for outcome in result.outcomes]
    hidden = shown.table["optimum_without_own_interval_um"].count("")
    assert hidden == round(64 * result.optimum.censored_low) > 0
    assert shares.table["input"][0] == "full_well_e", "the largest first"
    index = result.first_order["optimum_um"].indices["full_well_e"]
    assert f"full_well_e {index.share:.0%}" in shares.caption
    assert "dsnu" not in shares.caption, "it has no share worth naming"
    row = {name: column[0] for name, column in shares.table.items()}
    assert (row["optimum_um_share"], row["optimum_um_low"], row["optimum_um_high"]) == (index.share, index.low, index.high)
    for plate in (shown, shares):
        assert plate.drawn().svg == plate.drawn().svg
        assert len(plate.csv.splitlines()) == 1 + len(next(iter(plate.table.values())))


def test_input_labels_are_short_and_unique() -> None:
    one = Unknown("read_noise_e", 2.0, Spread(sd=0.1), "/a/b/sensor.toml")
    assert input_labels(sample_types([one, *NORMAL], 8)) == {
        one.name: "sensor read_noise_e", "read_noise_e": "read_noise_e", "full_well_e": "full_well_e", "dsnu": "dsnu",
    }  # fmt: skip
    same = replace(one, technology="/c/sensor.toml")
    assert list(input_labels(sample_types([one, same], 8)).values()) == [one.name, same.name]


# --- The pitches of each type ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("optimum_um", "interval_um", "ends_um"),
    [
        (6.0, (5.8, 6.2), (3.0, 12.0)),  # at least a factor of two
        (6.0, (4.5, 7.0), (6 / (6 / 4.5) ** 3, 6 * (6 / 4.5) ** 3)),  # three times the half interval
        (6.0, (5.8, None), (1.5, 18.0)),  # four times, within the range
        (1.0, (None, 1.1), (1.0, 4.0)),
        (18.0, (17.0, None), (4.5, 18.0)),
    ],
)
def test_few_pitches_um(optimum_um: float, interval_um: tuple[float | None, float | None], ends_um: tuple[float, float]) -> None:
    few = few_pitches_um(optimum_um, interval_um, (1.0, 18.0))
    pitches = np.array(list(few))
    assert set(few.values()) == {2}
    assert sum(few.values()) == 24
    assert (pitches[0], pitches[-1]) == pytest.approx(ends_um, rel=1e-4)
    ratios = pitches[1:] / pitches[:-1]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-4)
    assert sum(few_pitches_um(optimum_um, interval_um, (1.0, 18.0), 13).values()) == 12


@pytest.mark.parametrize("shift", [0.75, 1.0, 1.4])
def test_few_pitches_find_shifted_optimum(shift: float) -> None:
    """Without noise: a type's optimum that is not the base's, on a parabola in the logarithm of the pitch."""
    few = few_pitches_um(6.0, (5.8, 6.2), (1.0, 18.0))
    pitches = np.array(list(few))
    delta_e = 0.5 + np.log(pitches / (6 * shift)) ** 2
    optimum = fit_curve(pitches, np.column_stack([delta_e, delta_e])).optimum
    assert optimum.pitch_um == pytest.approx(6 * shift, rel=1e-3)
    assert optimum.inside


# --- Invalid input -----------------------------------------------------------------------------------------------------

ONE = NORMAL[:1]
OUTCOME = Outcome(3.0, (2.0, 4.0), 1.0, True, (1.0, 9.0))
JUDGED = replace(OUTCOME, verdicts={"a": True})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: propagate([], sensor(linear), 16), r"unknowns: got none; .*\[pixel\.uncertainty\]"),
        (lambda: propagate(ONE + ONE, sensor(linear), 16), "unknowns: got read_noise_e twice"),
        (lambda: propagate(ONE, sensor(linear), 7), "n: got 7; allowed: 8 to 65536 draws"),
        (lambda: propagate(ONE, sensor(linear), 10**9), "n: got 1000000000"),
        (lambda: propagate(ONE, sensor(linear), 16.5), r"n: got 16\.5; allowed: a .*whole number"),
        (lambda: propagate(ONE, sensor(linear), 16, -1), "seed: got -1"),
        (lambda: propagate([3], sensor(linear), 16), r"unknowns\[0\]: got 3; allowed: a Unknown"),
        (lambda: sample_types(ONE, 16, shared=["dnsu"]), "shared: got 'dnsu'; .*Did you mean 'dsnu'"),
        (lambda: sample_types(ONE, 16, shared="dsnu"), "shared: got 'dsnu'; allowed: a list"),
        (lambda: propagate(ONE, lambda draws: [OUTCOME] * 15, 16), "outcomes: got .*allowed: a list of 16 Outcome"),
        (lambda: propagate(ONE, lambda draws: [3.0] * 16, 16), "outcomes: got"),
        (lambda: propagate(ONE, lambda draws: [JUDGED] + [OUTCOME] * 15, 16), "verdicts: got none; .* a"),
        (lambda: Outcome(30.0, (2.0, 4.0), 1.0, True, (1.0, 9.0)), "optimum_um: got 30; allowed: 1 to 9, the pitches tried"),
        (lambda: Outcome(math.nan, (2.0, 4.0), 1.0, True, (1.0, 9.0)), "optimum_um: got nan"),
        (lambda: Outcome(3.0, (2.0, math.inf), 1.0, True, (1.0, 9.0)), r"interval_um\[1\]: got inf"),
        (lambda: Unknown("dsnu", -1.0, Spread(sd=1, distribution="lognormal")), "dsnu: got a lognormal distribution of -1"),
        (lambda: Unknown("dsnu", 0.1, Spread(sd=1), allowed=(0.2, None)), r"dsnu: got a normal .*46% are within 0\.2 to no limit"),
        (lambda: Unknown("dsnu", 0.1, 0.2), "spread: got 0.2; allowed: a Spread"),
        (lambda: unknowns_of_sheet(Pixel(**SHEET), {"dsnu": Spread(sd=1)}), r"inty\.dsnu: got no such number; .*full_well_e"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (4.0, 2.0)), "range_um: got .*0 < low < high"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (4.0, 9.0)), "optimum_um: got 3; allowed: 4 to 9"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (1.0, 9.0), 9), "evaluations: got 9; allowed: at least 10"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (3.0, 3.00001)), "5 different pitches"),
    ],
)  # fmt: skip
def test_invalid_input_raises(call: Callable[[], object], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        call()
