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
from helpers.tiny import toml_of
from scipy import stats

from pixsim.base.errors import PixsimError
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.report.uncertainty import (
    distribution_plate,
    input_labels,
    shares_table,
    uncertainty_blocks,
)
from pixsim.sensor.diffusion import absorption_per_um
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spread import Spread
from pixsim.sensor.technology import Technology, load_technology
from pixsim.studies.design import technology_of
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import unknowns_of_study
from pixsim.studies.settings import Study, with_data_sheets
from pixsim.studies.uncertainty import (
    NORMAL_95,
    SCATTER,
    SHARED,
    Probability,
    ResultDistribution,
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
    inside = (tried_um[0] < best_um) & (best_um < tried_um[1])
    clipped_um = np.clip(best_um, *tried_um)
    half_um = np.where(inside, NORMAL_95 * scatter_um, np.nan)
    table = {
        "optimum_um": clipped_um,
        "interval_low_um": clipped_um - half_um,
        "interval_high_um": clipped_um + half_um,
    }
    table |= {
        "mean_delta_e": clipped_um / 10,
        "mean_delta_e_low": clipped_um / 10,
        "mean_delta_e_high": clipped_um / 10,
    }
    return UncertaintyResult(
        sample, table | {"inside": inside}, {"smaller than 3 µm": best_um < 3}, n, seed, total=total
    )


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
    assert tuple(distribution.quantiles) == ("p05", "p50", "p95")
    return np.array(list(distribution.quantiles.values()))


def errors_of_shares(result: UncertaintyResult, kind: str, known: dict[str, float]) -> np.ndarray:
    """Errors of the shares of the optimum in their standard errors."""
    shares = {name: kinds[kind] for name, kinds in result.shares["optimum_um"].items()}
    return np.array(
        [
            (shares[name].share - value) / shares[name].standard_error
            for name, value in known.items()
        ]
    )


# --- Closed forms
# ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
def test_linear_optimum_of_normal_inputs(seed: int) -> None:
    """Over 40 seeds of 256 draws the quantiles are within 0.09 sd."""
    result = propagate(NORMAL, linear, 256, seed)
    np.testing.assert_allclose(quantiles(result.optimum), 3.1 + 0.5 * Z, atol=0.12 * 0.5)
    np.testing.assert_allclose(quantiles(result.least_delta_e), 0.31 + 0.05 * Z, atol=0.12 * 0.05)
    verdict = result.verdicts["smaller than 3 µm"]
    assert verdict.probability == pytest.approx(stats.norm.cdf(-0.2), abs=0.02)
    assert verdict.low < stats.norm.cdf(-0.2) < verdict.high


@pytest.mark.parametrize(("draws", "seed"), [(64, 0), (64, 1), (256, 0), (512, 0)])
def test_shares_of_linear_optimum_with_scatter(draws: int, seed: int) -> None:
    """Variances of 0.09 and 0.16 of the inputs and 0.09 of the evaluations; of 500 seeds none is
    beyond 3 standard errors.
    """
    result = propagate(NORMAL, linear, draws, seed, scatter_um=0.3)
    known = {
        "read_noise_e": 0.09 / 0.34,
        "full_well_e": 0.16 / 0.34,
        "dsnu": 0.0,
        SCATTER: 0.09 / 0.34,
    }
    assert np.abs(errors_of_shares(result, "first", known)).max() < 3
    assert set(result.shares["mean_delta_e"]) == set(known)


def test_total_shares_of_sobol_points() -> None:
    """y = z + z' + z z' of standard normal inputs: first-order shares of 1/3, total ones of 2/3,
    within 3 standard errors.

    Of 100 seeds, none of the shares is further away than 2.9.
    """

    def product(draw: dict[str, float]) -> float:
        one, two = (draw["read_noise_e"] - 5) / 0.5, (draw["full_well_e"] - 1e4) / WELL_SD_E
        return 100 + one + two + one * two

    result = propagate(NORMAL[:2], product, 500, total=True)
    assert result.draws == 512 * (2 + 2)
    for kind, known in (("first", 1 / 3), ("total", 2 / 3)):
        assert (
            np.abs(
                errors_of_shares(
                    result, kind, dict.fromkeys(("read_noise_e", "full_well_e"), known)
                )
            ).max()
            < 3
        )


@pytest.mark.parametrize(
    ("spread", "reference"),
    [
        (Spread(sd=0.5), stats.norm(2, 0.5)),
        (Spread(range=(1.0, 4.0)), stats.uniform(1, 3)),
        (
            Spread(range=(1.0, 4.0), distribution="normal"),
            stats.norm(2.5, 1.5 / stats.norm.ppf(0.95)),
        ),
        (
            Spread(range=(1.0, 4.0), distribution="lognormal"),
            stats.lognorm(math.log(2) / stats.norm.ppf(0.95), scale=2),
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
    unknown = Unknown("x_e", 2.0, spread)
    share = np.linspace(0.001, 0.999, 99)
    np.testing.assert_allclose(unknown.at(share), reference.ppf(share), rtol=1e-9)
    assert unknown.cut == (0.0, 1.0)
    # Cut at bounds: the rest of the distribution, over its share.
    cut = replace(unknown, allowed=(1.6, 3.5))
    low, high = reference.cdf([1.6, 3.5])
    np.testing.assert_allclose(cut.at(share), reference.ppf(low + share * (high - low)), rtol=1e-9)
    assert cut.cut == pytest.approx((low, high), rel=1e-9)


@pytest.mark.parametrize(
    "spread",
    [Spread(sd=0.5), Spread(range=(1.9, 4.0)), Spread(range=(1.9, 4.0), distribution="lognormal")],
)
def test_coordinate_of_unknown_is_uniform_or_normal(spread: Spread) -> None:
    """Over all quantiles, values are a linear or exponential function of the coordinate, as a
    regression of few powers needs.
    """
    unknown = Unknown("dsnu", 2.0, spread, allowed=(1.0, 3.9))
    quantile = np.linspace(0.01, 0.9, 50)
    values = unknown.at(quantile)
    plain = np.log(values) if spread.kind == "lognormal" else values
    slopes = np.diff(plain) / np.diff(unknown.coordinate(quantile))
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-9)


# --- Ends of the sizes tried
# -------------------------------------------------------------------------------------------


def test_optima_at_an_end_count_as_that_size() -> None:
    """Below 2.6 µm, a standard deviation below the mean, are 15.9 % (over 40 seeds, within 1.4 %);
    their p05 is the end.
    """
    whole = propagate(NORMAL, linear, 256, 1)
    result = propagate(NORMAL, linear, 256, 1, tried_um=(2.6, 40.0))
    assert result.share_at_ends == pytest.approx(stats.norm.cdf(-1), abs=0.02)
    assert result.optimum.quantiles == whole.optimum.quantiles | {"p05": 2.6}
    assert "16 % at an end of the sizes tried" in str(uncertainty_blocks([result])[0])
    assert "at an end" not in str(uncertainty_blocks([whole])[0])


def test_all_optima_at_an_end() -> None:
    """Then their shares are unknown, and those of the least ΔE too."""
    result = propagate(NORMAL, linear, 16, tried_um=(10.0, 20.0))
    assert result.as_dict()["optimum_um"] == {
        "quantiles": dict.fromkeys(("p05", "p50", "p95"), 10.0),
        "share_at_ends": 1.0,
    }
    json.dumps(result.as_dict(), allow_nan=False)
    assert {cell for row in shares_table(result).rows for cell in row[1:]} == {"unknown"}
    distribution_plate(result).drawn()


def test_quantiles_match_numpy() -> None:
    values = np.random.default_rng(0).standard_normal(37)
    expected = np.quantile(values, [0.05, 0.5, 0.95], method="hazen")
    assert list(ResultDistribution(values).quantiles.values()) == pytest.approx(expected, rel=1e-12)


# --- Verdicts
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("holds", "draws"), [(0, 64), (1, 64), (32, 64), (64, 64), (250, 256)])
def test_probability_is_jeffreys_interval(holds: int, draws: int) -> None:
    found = Probability.of([True] * holds + [False] * (draws - holds))
    low, high = stats.beta.ppf([0.025, 0.975], holds + 0.5, draws - holds + 0.5)
    expected = (holds / draws, 0.0 if not holds else low, 1.0 if holds == draws else high, draws)
    assert (found.probability, found.low, found.high, found.draws) == pytest.approx(
        expected, rel=1e-9
    )


# --- Inputs
# ------------------------------------------------------------------------------------------------------------


def technologies(*names: str) -> list[Unknown]:
    return [
        unknown for name in names for unknown in unknowns_of_technology(load_technology(name), name)
    ]


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
    """A technology's mismatch of the layout is known where the pixel gives a plain number in its
    place.
    """
    parts = packaged("data/technologies")["0.35um"].read_text(encoding="utf-8").split("\n\n")
    text = "\n\n".join(part for part in parts if not part.startswith(("[prnu]", "[offset_fpn]")))
    for name in sorted(OF_LAYOUT):
        text += (
            f'\n[{name}]\nvalue = 0.05\nrange = [0.04, 0.06]\nconfidence = "D"\nsource = "assumed'
            ' here"\n'
        )
    path = tmp_path / "layout.toml"
    path.write_text(text, encoding="utf-8")
    unknowns = unknowns_of_study(
        Study.model_validate({"name": "s", "technologies": [str(path)], "pixel": pixel})
    )
    assert {unknown.quantity for unknown in unknowns} & OF_LAYOUT == left


def test_shared_quantities_have_one_draw() -> None:
    unknowns = technologies("0.35um", "0.18um", "4t-bsi")
    sample = sample_types(unknowns, 8, seed=3)
    for quantity in ("dark_current_na_per_cm2", "dsnu", "offset_fpn", "column_fpn"):
        assert quantity in SHARED
        assert [unknown.technology for unknown in sample.inputs[quantity]] == [
            "0.35um",
            "0.18um",
            "4t-bsi",
        ]
        places = []
        for unknown in sample.inputs[quantity]:  # all are uniform between the ends of their range
            low, high = unknown.spread.range
            places.append([(draw[unknown.name] - low) / (high - low) for draw in sample.draws])
        np.testing.assert_allclose(places, [places[0]] * 3, rtol=1e-9)
    others = {name for name in sample.inputs if name not in SHARED}
    assert len(others) == sum(unknown.quantity not in SHARED for unknown in unknowns)
    assert sample.draws[0].keys() == {unknown.name for unknown in unknowns}


def test_inputs_are_independent_and_even() -> None:
    """Each input has one draw in each of n equal parts of its distribution, and no pair is
    correlated.
    """
    sample = sample_types(technologies("0.35um", "4t-bsi"), 256, seed=5)
    cells = np.sort((sample.quantiles * 256).astype(int), axis=0)
    np.testing.assert_array_equal(
        cells, np.tile(np.arange(256)[:, None], sample.quantiles.shape[1])
    )
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
        drawn = technology.with_numbers(
            {unknown.quantity: draw[unknown.name] for unknown in unknowns}, "here"
        )
        assert drawn.numbers != technology.numbers
    fewer = unknowns_of_technology(technology, name, excluded=["dsnu"])
    assert {unknown.quantity for unknown in fewer} == set(base.ranges) - {"dsnu"}


@pytest.mark.parametrize("swing", [(0.9, 2.2), (0.9, 1.5)])
@pytest.mark.parametrize("reset", [(1.2, 3.0), None])
def test_unknowns_of_technology_keep_their_order(
    swing: tuple[float, float], reset: tuple[float, float] | None
) -> None:
    """A swing above the reset voltage is no pixel: ranges that meet are cut at the middle between
    both values.
    """
    base = load_technology("0.35um")
    ranges = {"voltage_swing_v": swing} | ({"reset_voltage_v": reset} if reset else {})
    kinds = dict.fromkeys(ranges, "normal")
    technology = Technology.model_validate(
        base.model_dump() | {"ranges": ranges, "distributions": kinds}
    )
    unknowns = unknowns_of_technology(technology, "mine")
    sample = sample_types(unknowns, 64)
    for draw in sample.draws:
        technology.with_numbers(
            {unknown.quantity: draw[unknown.name] for unknown in unknowns}, "here"
        )
    if reset is not None:
        swing_and_reset = [unknown.allowed for unknown in unknowns]
        assert swing_and_reset[0][1] == swing_and_reset[1][0] == (1.2 + 2.2) / 2, (
            "the middle between both values"
        )
        assert len(sobol_points(unknowns, 8).quantiles) == 8 * (2 + 2), "two inputs"


SHEET = {
    "pitch_um": 3.75,
    "full_well_e": 10500.0,
    "read_noise_e": 2.3,
    "dark_current_e_per_s": 3.0,
    "quantum_efficiency": 0.9,
}


def test_unknowns_of_sheet_draw_valid_pixels() -> None:
    pixel = Pixel(**SHEET)
    spreads = {
        "read_noise_e": Spread(sd=2.0), "dark_current_e_per_s": Spread(sd=2.0, distribution="lognormal"),
        "quantum_efficiency": Spread(sd=0.1), "full_well_e": Spread(range=(8e3, 12e3)),
    }  # fmt: skip
    unknowns = unknowns_of_sheet(pixel, spreads)
    assert [unknown.name for unknown in unknowns] == list(spreads)
    assert [unknown.value for unknown in unknowns] == [2.3, 3.0, 0.9, 10500.0]
    for draw in sample_types(unknowns, 64).draws:
        Pixel(**SHEET | draw)
    assert unknowns_of_sheet(pixel, spreads, "a.toml")[0].name == "a.toml read_noise_e"


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


def test_study_of_a_draw_has_its_numbers(tmp_path) -> None:
    """Technologies, data sheets among them, one with a technology of its own, numbers set by the
    study, and its own [pixel].
    """
    sheet, mixed = tmp_path / "sheet.toml", tmp_path / "mixed.toml"
    of_technology = {"technology": "4t-bsi", "pitch_um": 1.4, "dsnu": 0.2, "prnu_percent": 1}
    for path, pixel in (
        (sheet, SHEET | {"uncertainty": {"full_well_e": {"sd": 500}}}),
        (mixed, of_technology | {"uncertainty": {"dsnu": {"sd": 0.05}}}),
    ):
        path.write_text(f"pixel = {toml_of(pixel)}\n", encoding="utf-8")
    names = ["0.35um", str(sheet), str(mixed)]
    table = {
        "name": "a",
        "technologies": names,
        "process": {"0.35um": {"dsnu": 0.25}},
        "pixel": {"read_noise_e": 3.0},
    }
    study = checked(Study, with_data_sheets([Layer(table)], {}))
    unknowns = unknowns_of_study(study, {"": {"read_noise_e": Spread(sd=0.3)}})
    quantities = {
        name: {unknown.quantity for unknown in unknowns if unknown.technology == name}
        for name in ["", *names]
    }
    assert quantities[""] == {"read_noise_e"}
    assert quantities["0.35um"] == set(load_technology("0.35um").ranges) - {"dsnu"}, (
        "the study sets it"
    )
    assert quantities[str(sheet)] == {"full_well_e"}
    given = {
        "prnu_um",
        "read_noise_e",
        "read_noise_after_gain_e",
    }  # by the data sheet's PRNU, and by [pixel]
    assert quantities[str(mixed)] == set(load_technology("4t-bsi").ranges) - given, (
        "DSNU by its own uncertainty"
    )
    for stack, known in (
        ({"enabled": False}, {"height_um", "index", "crosstalk"}),
        ({"height_um": 3.0}, {"height_um"}),
    ):
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
            assert {key: numbers[key] for key in varied} == {
                key: draw[f"{name} {key}"] for key in varied
            }
        assert technology_of(drawn, "0.35um").numbers["dsnu"] == 0.25
        assert (drawn.name, drawn.technologies) == (study.name, study.technologies), (
            "the random streams depend on them"
        )


# --- Files, figures, repetition
# ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result() -> UncertaintyResult:
    return propagate(NORMAL, linear, 60, 7, tried_um=(2.35, 9.0), scatter_um=0.05)


def test_results_repeat_bit_for_bit(result: UncertaintyResult) -> None:
    again = propagate(NORMAL, linear, 60, 7, tried_um=(2.35, 9.0), scatter_um=0.05)
    assert json.dumps(again.as_dict()) == json.dumps(result.as_dict())
    assert again.to_csv() == result.to_csv()
    other = propagate(NORMAL, linear, 60, 8, tried_um=(2.35, 9.0), scatter_um=0.05)
    assert not set(other.to_csv().splitlines()[1:]) & set(result.to_csv().splitlines()[1:])


def test_as_dict_and_csv(result: UncertaintyResult) -> None:
    summary = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert (summary["draws"], summary["asked"], summary["seed"]) == (64, 60, 7)
    assert summary["inputs"]["full_well_e"] == [
        {"name": "full_well_e", "value": 1e4, "distribution": "normal", "range": [9e3, 11e3]}
    ]
    share = result.shares["optimum_um"]["full_well_e"]["first"]
    assert summary["shares"]["optimum_um"]["full_well_e"]["first"]["share"] == pytest.approx(
        share.share, abs=5e-5
    )
    rows = list(csv.DictReader(io.StringIO(result.to_csv())))
    assert [int(row["draw"]) for row in rows] == list(range(1, 65))
    assert any(row["interval_low_um"] == "" for row in rows), "an optimum at the smallest size"
    for number, (row, draw) in enumerate(zip(rows, result.sample.draws, strict=True)):
        assert {name: float(row[name]) for name in draw} == draw
        assert float(row["optimum_um"]) == result.table["optimum_um"][number]
        low_um = float(result.table["interval_low_um"][number])
        assert row["interval_low_um"] == ("" if math.isnan(low_um) else str(low_um))
        assert row["smaller than 3 µm"] == str(result.holds["smaller than 3 µm"][number])


def test_figure_and_table_have_the_numbers(result: UncertaintyResult) -> None:
    plate = distribution_plate(result)
    assert plate.table["optimum_um"] == result.table["optimum_um"].tolist()
    assert plate.drawn().svg == plate.drawn().svg
    assert len(plate.csv.splitlines()) == 1 + 64
    rows = list(shares_table(result).rows)
    assert [row[0] for row in rows] == ["read_noise_e", "full_well_e", "dsnu", SCATTER]
    shares = [
        result.shares[output]["full_well_e"]["first"] for output in ("optimum_um", "mean_delta_e")
    ]
    assert rows[1][1:] == tuple(
        f"{share.share:.2f} ± {share.standard_error:.2f}" for share in shares
    )


def test_input_labels_are_short_and_unique() -> None:
    one = Unknown("read_noise_e", 2.0, Spread(sd=0.1), "/a/b/sensor.toml")
    assert input_labels(sample_types([one, *NORMAL], 8)) == {
        one.name: "sensor read_noise_e", "read_noise_e": "read_noise_e", "full_well_e": "full_well_e", "dsnu": "dsnu",
    }  # fmt: skip
    same = replace(one, technology="/c/sensor.toml")
    assert list(input_labels(sample_types([one, same], 8)).values()) == [one.name, same.name]


# --- The pitches of each type
# ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("optimum_um", "interval_um", "ends_um"),
    [
        (6.0, (5.8, 6.2), (3.0, 12.0)),  # at least a factor of two
        (
            6.0,
            (4.5, 7.0),
            (6 / (6 / 4.5) ** 3, 6 * (6 / 4.5) ** 3),
        ),  # three times the half interval
        (6.0, (5.8, None), (1.5, 18.0)),  # four times, within the range
        (1.0, (None, 1.1), (1.0, 4.0)),
        (18.0, (17.0, None), (4.5, 18.0)),
    ],
)
def test_few_pitches_um(
    optimum_um: float, interval_um: tuple[float | None, float | None], ends_um: tuple[float, float]
) -> None:
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
    """Without noise: a type's optimum that is not the base's, on a parabola in the logarithm of the
    pitch.
    """
    few = few_pitches_um(6.0, (5.8, 6.2), (1.0, 18.0))
    pitches = np.array(list(few))
    delta_e = 0.5 + np.log(pitches / (6 * shift)) ** 2
    optimum = fit_curve(pitches, np.column_stack([delta_e, delta_e])).optimum
    assert optimum.pitch_um == pytest.approx(6 * shift, rel=1e-3)
    assert optimum.inside


# --- Invalid input
# -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sample_types([], 16), r"unknowns: got none; .*\[pixel\.uncertainty\]"),
        (lambda: Unknown("dsnu", -1.0, Spread(sd=1, distribution="lognormal")), "dsnu: got a lognormal distribution of -1"),
        (lambda: Unknown("dsnu", 0.1, Spread(sd=1), allowed=(0.2, math.inf)), r"dsnu: got a normal .*46 % are within 0\.2 to inf"),
        (lambda: unknowns_of_sheet(Pixel(**SHEET), {"dsnu": Spread(sd=1)}), r"inty\.dsnu: got no such number; .*full_well_e"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (4.0, 2.0)), "range_um: got .*0 < low < high"),
        (lambda: few_pitches_um(3.0, (2.0, 4.0), (3.0, 3.00001)), "5 different pitches"),
    ],
)  # fmt: skip
def test_invalid_input_raises(call: Callable[[], object], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        call()
