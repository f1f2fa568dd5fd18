"""Distributions of an optimum over sensor types, against closed forms: a synthetic sensor whose
optimum is known.
"""

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
from helpers.claims import check
from helpers.tiny import toml_of
from scipy import stats

from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.report.uncertainty import shares_table
from pixsim.sensor.diffusion import absorption_per_um
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spread import Spread
from pixsim.sensor.technology import Technology, load_technology
from pixsim.studies.design import technology_of
from pixsim.studies.prepare import unknowns_of_study
from pixsim.studies.settings import Study, with_data_sheets
from pixsim.studies.uncertainty import (
    NORMAL_95,
    SCATTER,
    Probability,
    UncertaintyResult,
    Unknown,
    few_pitches_um,
    sample_types,
    settings_of,
    sobol_points,
    unknowns_of_sheet,
    unknowns_of_technology,
)
from pixsim.viewer.merging import merge

WIDE_UM = (1e-3, 1e3)
Z = stats.norm.ppf([0.05, 0.5, 0.95])
BELOW_3 = "smaller than 3 µm"


def propagate(
    unknowns: Sequence[Unknown],
    optimum_um: Callable[[dict[str, float]], float],
    n: int,
    seed: int = 0,
    *,
    tried_um: tuple[float, float] = WIDE_UM,
    scatter_um: float = 0.0,
    total: bool = False,
) -> UncertaintyResult:
    """Sensor types of a known optimum, with a known error of it, and its interval; the least ΔE is
    a tenth of the optimum.
    """
    sample = (sobol_points if total else sample_types)(unknowns, n, seed)
    errors_um = scatter_um * np.random.default_rng(seed).standard_normal(len(sample.draws))
    best_um = np.array([optimum_um(draw) for draw in sample.draws]) + errors_um
    clipped_um = np.clip(best_um, *tried_um)
    inside = best_um == clipped_um
    half_um = np.where(inside, NORMAL_95 * scatter_um, np.nan)
    table = {
        "optimum_um": clipped_um,
        "interval_low_um": clipped_um - half_um,
        "interval_high_um": clipped_um + half_um,
        "inside": inside,
    }
    table |= dict.fromkeys(("mean_delta_e", "mean_delta_e_low", "mean_delta_e_high"), best_um / 10)
    return UncertaintyResult(sample, table, {BELOW_3: best_um < 3}, n, seed, total=total)


NORMAL = [
    Unknown("read_noise_e", 5.0, Spread(sd=0.5)),
    Unknown("full_well_e", 1e4, Spread(range=(9e3, 11e3), distribution="normal")),
    Unknown("dsnu", 0.3, Spread(sd=0.02)),
]
WELL_SD_E = 1e3 / stats.norm.ppf(0.95)


def linear(draw: dict[str, float]) -> float:
    """A mean of 3.1 µm and standard deviations of 0.3, 0.4 and 0 µm: 0.5 in all."""
    return 3.1 + 0.6 * (draw["read_noise_e"] - 5) - 0.4 / WELL_SD_E * (draw["full_well_e"] - 1e4)


def product(draw: dict[str, float]) -> float:
    """z + z' + z z' of standard normal inputs."""
    first = (draw["read_noise_e"] - 5) / 0.5
    second = (draw["full_well_e"] - 1e4) / WELL_SD_E
    return 100 + first + second + first * second


def check_shares(result: UncertaintyResult, kind: str, expected: dict[str, float]) -> None:
    """The shares of the optimum, within 3 of their standard errors."""
    for name, share in expected.items():
        estimate = result.shares["optimum_um"][name][kind]
        limit = 3 * estimate.standard_error
        check(f"{kind} share of {name}", estimate.share, share, atol=limit, why="3 standard errors")


# --- closed forms


@pytest.mark.parametrize("seed", range(2))
def test_linear_optimum_of_normal_inputs(seed: int) -> None:
    """Over 40 seeds of 256 draws the quantiles are within 0.09 sd."""
    result = propagate(NORMAL, linear, 256, seed)
    quantiles_um = list(result.optimum.quantiles.values())
    np.testing.assert_allclose(quantiles_um, 3.1 + 0.5 * Z, atol=0.12 * 0.5)
    verdict = result.verdicts[BELOW_3]
    assert verdict.probability == pytest.approx(stats.norm.cdf(-0.2), abs=0.02)
    assert verdict.low < stats.norm.cdf(-0.2) < verdict.high


@pytest.mark.parametrize(("draws", "seed"), [(64, 0), (64, 1), (512, 0)])
def test_shares_of_linear_optimum_with_scatter(draws: int, seed: int) -> None:
    """Variances of 0.09 and 0.16 of the inputs and 0.09 of the evaluations; of 500 seeds none is
    beyond 3 standard errors.
    """
    result = propagate(NORMAL, linear, draws, seed, scatter_um=0.3)
    parts = {"read_noise_e": 0.09, "full_well_e": 0.16, "dsnu": 0.0, SCATTER: 0.09}
    check_shares(result, "first", {name: part / 0.34 for name, part in parts.items()})


@pytest.mark.parametrize(("kind", "share"), [("first", 1 / 3), ("total", 2 / 3)])
def test_shares_of_sobol_points(kind: str, share: float) -> None:
    """Of 100 seeds, none of the shares is further away than 2.9 standard errors."""
    result = propagate(NORMAL[:2], product, 500, total=True)
    assert result.draws == 512 * (2 + 2)
    check_shares(result, kind, dict.fromkeys(("read_noise_e", "full_well_e"), share))


@pytest.mark.parametrize(
    ("spread", "reference"),
    [
        (Spread(sd=0.5), stats.norm(2, 0.5)),
        (Spread(range=(1.0, 4.0)), stats.uniform(1, 3)),
        (Spread(range=(1.0, 4.0), distribution="normal"), stats.norm(2.5, 1.5 / Z[2])),
        (
            Spread(range=(1.0, 4.0), distribution="lognormal"),
            stats.lognorm(math.log(2) / Z[2], scale=2),
        ),
        (Spread(sd=0.5, distribution="uniform"), stats.uniform(2 - 0.5 * 3**0.5, 3**0.5)),
        # Of a mean of 2 and a standard deviation of 0.8.
        (
            Spread(sd=0.8, distribution="lognormal"),
            stats.lognorm(math.sqrt(math.log(1.16)), scale=2 / math.sqrt(1.16)),
        ),
    ],
)
def test_unknown_at_matches_scipy(spread: Spread, reference: Any) -> None:
    """Whole, and cut at bounds: the rest of the distribution, over its share. Values are a linear
    or exponential function of the coordinate, as a regression of few powers needs.
    """
    whole = Unknown("x_e", 2.0, spread)
    share = np.linspace(0.001, 0.999, 99)
    np.testing.assert_allclose(whole.at(share), reference.ppf(share), rtol=1e-9)
    cut = replace(whole, allowed=(1.6, 3.5))
    low, high = reference.cdf([1.6, 3.5])
    values = cut.at(share)
    np.testing.assert_allclose(values, reference.ppf(low + share * (high - low)), rtol=1e-9)
    plain = np.log(values) if spread.kind == "lognormal" else values
    slopes = np.diff(plain) / np.diff(cut.coordinate(share))
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-8)


def test_optima_at_an_end_count_as_that_size() -> None:
    """Below 2.6 µm, a standard deviation below the mean, are 15.9 % (over 40 seeds, within 1.4 %);
    their p05 is the end.
    """
    result = propagate(NORMAL, linear, 256, 1, tried_um=(2.6, 40.0))
    assert result.share_at_ends == pytest.approx(stats.norm.cdf(-1), abs=0.02)
    assert result.optimum.quantiles["p05"] == 2.6


def test_shares_of_optima_that_are_all_at_an_end_are_unknown() -> None:
    result = propagate(NORMAL, linear, 16, tried_um=(10.0, 20.0))
    expected = {"quantiles": dict.fromkeys(("p05", "p50", "p95"), 10.0), "share_at_ends": 1.0}
    assert result.as_dict()["optimum_um"] == expected
    assert {row[1] for row in shares_table(result).rows} == {"unknown"}


@pytest.mark.parametrize(("holds", "draws"), [(0, 64), (1, 64), (64, 64), (250, 256)])
def test_probability_is_jeffreys_interval(holds: int, draws: int) -> None:
    result = Probability.of([True] * holds + [False] * (draws - holds))
    low, high = stats.beta.ppf([0.025, 0.975], holds + 0.5, draws - holds + 0.5)
    expected = (holds / draws, low if holds else 0.0, high if holds < draws else 1.0)
    assert (result.probability, result.low, result.high) == pytest.approx(expected, rel=1e-9)


# --- inputs


def unknowns_of(*names: str) -> list[Unknown]:
    return [
        unknown for name in names for unknown in unknowns_of_technology(load_technology(name), name)
    ]


LAYOUT = {"prnu_um", "a_vt_mv_um", "follower_area_um2"}


@pytest.mark.parametrize(
    ("pixel", "left"),
    [
        ({}, LAYOUT),
        ({"prnu_percent": 1.0}, LAYOUT - {"prnu_um"}),
        ({"offset_fpn": 0.001}, {"prnu_um"}),
        ({"dsnu_e": 2.0}, {"prnu_um"}),
    ],
)
def test_unknowns_of_study_leave_out_what_the_pixel_replaces(
    pixel: dict[str, float], left: set[str], tmp_path: Path
) -> None:
    """A technology's mismatch of the layout is known where the pixel gives a plain number in its
    place.
    """
    parts = packaged("data/technologies")["0.35um"].read_text(encoding="utf-8").split("\n\n")
    parts = [part for part in parts if not part.startswith(("[prnu]", "[offset_fpn]"))]
    entry = 'value = 0.05\nrange = [0.04, 0.06]\nconfidence = "D"\nsource = "here"\n'
    parts += [f"[{name}]\n{entry}" for name in sorted(LAYOUT)]
    path = tmp_path / "layout.toml"
    path.write_text("\n\n".join(parts), encoding="utf-8")
    study = Study.model_validate({"name": "s", "technologies": [str(path)], "pixel": pixel})
    assert {unknown.quantity for unknown in unknowns_of_study(study)} & LAYOUT == left


@pytest.mark.parametrize(
    "quantity", ["dark_current_na_per_cm2", "dsnu", "offset_fpn", "column_fpn"]
)
def test_shared_quantities_have_one_draw(quantity: str) -> None:
    """All are uniform between the ends of their range, at one place in it."""
    names = ["0.35um", "0.18um", "4t-bsi"]
    sample = sample_types(unknowns_of(*names), 8, seed=3)
    members = sample.inputs[quantity]
    assert [unknown.technology for unknown in members] == names
    ends = np.array([unknown.spread.range for unknown in members])
    values = np.array([[draw[unknown.name] for unknown in members] for draw in sample.draws])
    places = (values - ends[:, 0]) / np.ptp(ends, axis=1)
    np.testing.assert_allclose(places, places[:, :1] * np.ones(3), rtol=1e-9)


def test_inputs_are_independent_and_even() -> None:
    """Each input has one draw in each of n equal parts of its distribution, and no pair is
    correlated.
    """
    sample = sample_types(unknowns_of("0.35um", "4t-bsi"), 256, seed=5)
    cells = np.sort((sample.quantiles * 256).astype(int), axis=0)
    np.testing.assert_array_equal(cells, np.arange(256)[:, None] * np.ones_like(cells[0]))
    correlations = np.corrcoef(sample.quantiles.T) - np.eye(len(sample.inputs))
    assert np.abs(correlations).max() < 5 / 16, "five standard errors of 256 independent draws"


@pytest.mark.parametrize("distribution", ["uniform", "normal", "lognormal"])
@pytest.mark.parametrize("name", ["0.35um", "4t-fsi"])
def test_unknowns_of_technology_draw_valid_technologies(name: str, distribution: str) -> None:
    base = load_technology(name)
    kinds = {number: distribution for number, (low, _) in base.ranges.items() if low > 0}
    technology = Technology.model_validate(base.model_dump() | {"distributions": kinds})
    unknowns = unknowns_of_technology(technology, name)
    assert {unknown.name for unknown in unknowns} == {f"{name} {number}" for number in base.ranges}
    for draw in sample_types(unknowns, 32).draws:
        numbers = {unknown.quantity: draw[unknown.name] for unknown in unknowns}
        assert technology.with_numbers(numbers, "here").numbers != technology.numbers


@pytest.mark.parametrize("swing_v", [(0.9, 2.2), (0.9, 1.5)])
@pytest.mark.parametrize("reset_v", [(1.2, 3.0), None])
def test_unknowns_of_technology_keep_their_order(
    swing_v: tuple[float, float], reset_v: tuple[float, float] | None
) -> None:
    """A swing above the reset voltage is no pixel: ranges that meet are cut at the middle between
    both values.
    """
    ranges = {"voltage_swing_v": swing_v} | ({"reset_voltage_v": reset_v} if reset_v else {})
    changes = {"ranges": ranges, "distributions": dict.fromkeys(ranges, "normal")}
    technology = Technology.model_validate(load_technology("0.35um").model_dump() | changes)
    unknowns = unknowns_of_technology(technology, "mine")
    for draw in sample_types(unknowns, 64).draws:
        numbers = {unknown.quantity: draw[unknown.name] for unknown in unknowns}
        technology.with_numbers(numbers, "here")
    if reset_v is not None:
        swing, reset = (unknown.allowed for unknown in unknowns)
        assert swing[1] == reset[0] == (1.2 + 2.2) / 2


SHEET = {
    "pitch_um": 3.75,
    "full_well_e": 10500.0,
    "read_noise_e": 2.3,
    "dark_current_e_per_s": 3.0,
    "quantum_efficiency": 0.9,
}


def test_unknown_efficiency_of_one_wavelength_stays_below_what_silicon_absorbs() -> None:
    """0.9 at 600 nm: 5 µm of silicon absorb 0.876 of that light, too little for it, and 10 µm
    0.985, where draws end.
    """
    deep = Pixel(**SHEET, quantum_efficiency_nm=600, quantum_efficiency_depth_um=10)
    (unknown,) = unknowns_of_sheet(deep, {"quantum_efficiency": Spread(sd=0.05)})
    highest = float(unknown.at(np.array([1.0]))[0])
    assert highest == pytest.approx(1 - np.exp(-10 * absorption_per_um(600.0)), rel=1e-9)
    physics = derive(deep.model_copy(update={"quantum_efficiency": highest}))
    assert physics.quantum_efficiency(350.0) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("stack", "stated"),
    [
        ({"enabled": False}, {"height_um", "index", "crosstalk"}),
        ({"height_um": 3.0}, {"height_um"}),
    ],
)
def test_stated_numbers_of_a_stack_are_known(stack: dict[str, Any], stated: set[str]) -> None:
    study = Study(name="b", technologies=["4t-bsi"], pixel={"stack": stack})
    left = set(load_technology("4t-bsi").ranges) - {f"stack_{name}" for name in stated}
    assert {unknown.quantity for unknown in unknowns_of_study(study)} == left


def test_study_of_a_draw_has_its_numbers(tmp_path: Path) -> None:
    """Technologies, data sheets among them, one with a technology of its own, numbers set by the
    study, and its own [pixel]. Its random streams depend on the name and the technologies.
    """
    sheet, mixed = str(tmp_path / "sheet.toml"), str(tmp_path / "mixed.toml")
    pixel = {"technology": "4t-bsi", "pitch_um": 1.4, "dsnu": 0.2, "prnu_percent": 1}
    for path, table in (
        (sheet, SHEET | {"uncertainty": {"full_well_e": {"sd": 500}}}),
        (mixed, pixel | {"uncertainty": {"dsnu": {"sd": 0.05}}}),
    ):
        Path(path).write_text(f"pixel = {toml_of(table)}\n", encoding="utf-8")
    settings = {"name": "a", "technologies": ["0.35um", sheet, mixed]}
    settings |= {"process": {"0.35um": {"dsnu": 0.25}}, "pixel": {"read_noise_e": 3.0}}
    study = checked(Study, with_data_sheets([Layer(settings)], {}))
    unknowns = unknowns_of_study(study, {"": {"read_noise_e": Spread(sd=0.3)}})
    # By the data sheet's PRNU, and by [pixel].
    stated = {"prnu_um", "read_noise_e", "read_noise_after_gain_e"}
    expected = {"read_noise_e", f"{sheet} full_well_e", f"{mixed} dsnu"}
    expected |= {f"0.35um {name}" for name in load_technology("0.35um").ranges if name != "dsnu"}
    expected |= {f"{mixed} {name}" for name in load_technology("4t-bsi").ranges.keys() - stated}
    assert {unknown.name for unknown in unknowns} == expected

    draw = sample_types(unknowns, 8).draws[3]
    base = study.model_dump(mode="json", exclude_unset=True)
    drawn = Study.model_validate(merge(base, settings_of(study, unknowns, draw)))
    for unknown in unknowns:
        sensor = drawn.options_of(unknown.technology)
        numbers = technology_of(drawn, unknown.technology or "0.35um").numbers
        value = getattr(sensor, unknown.quantity, None) or numbers[unknown.quantity]
        assert value == draw[unknown.name], unknown.name
    assert technology_of(drawn, "0.35um").numbers["dsnu"] == 0.25
    assert (drawn.name, drawn.technologies) == (study.name, study.technologies)


# --- files and repetition


def result_of(seed: int) -> UncertaintyResult:
    return propagate(NORMAL, linear, 60, seed, tried_um=(2.35, 9.0), scatter_um=0.05)


def test_results_repeat_bit_for_bit() -> None:
    texts = [result_of(seed).to_csv() for seed in (7, 7, 8)]
    assert texts[0] == texts[1]
    assert not set(texts[1].splitlines()[1:]) & set(texts[2].splitlines()[1:])


def test_as_dict_and_csv() -> None:
    result = result_of(7)
    summary = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert (summary["draws"], summary["asked"], summary["seed"]) == (64, 60, 7)
    share = summary["shares"]["optimum_um"]["full_well_e"]["first"]["share"]
    expected = result.shares["optimum_um"]["full_well_e"]["first"].share
    assert share == pytest.approx(expected, abs=5e-5)
    rows = list(csv.DictReader(io.StringIO(result.to_csv())))
    for name, values in (result.table | result.holds).items():
        cells = ["" if value != value else str(value) for value in values.tolist()]
        assert [row[name] for row in rows] == cells


# --- the pitches of each type


@pytest.mark.parametrize(
    ("optimum_um", "interval_um", "ends_um"),
    [
        (6.0, (5.8, 6.2), (3.0, 12.0)),  # at least a factor of two
        (6.0, (4.5, 7.0), (6 * 0.75**3, 6 / 0.75**3)),  # three times the half interval
        (6.0, (5.8, None), (1.5, 18.0)),  # four times, within the range
        (1.0, (None, 1.1), (1.0, 4.0)),
        (18.0, (17.0, None), (4.5, 18.0)),
    ],
)
def test_few_pitches_um(
    optimum_um: float, interval_um: tuple[float | None, float | None], ends_um: tuple[float, float]
) -> None:
    sensors = few_pitches_um(optimum_um, interval_um, (1.0, 18.0))
    assert list(sensors.values()) == [2] * 12
    np.testing.assert_allclose(list(sensors), np.geomspace(*ends_um, 12), rtol=1e-4)
