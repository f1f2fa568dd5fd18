"""Sensor types: distributions of an optimum against closed forms, of a synthetic sensor whose optimum
is known; and in studies and comparisons, where each type has the rows of its own numbers.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.commands import command
from helpers.sheets import sheet as noisy_sheet
from helpers.tiny import COARSE, TINY, rows, toml_of
from scipy import stats

import pixsim
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.base.toml import SETTINGS_FILE, packaged
from pixsim.report.uncertainty import shares_table
from pixsim.sensor.diffusion import absorption_per_um
from pixsim.sensor.spread import Spread
from pixsim.studies.compare import scatter_variances
from pixsim.studies.design import technology_of
from pixsim.studies.files import load_study, uncertainty_of
from pixsim.studies.prepare import UncertaintyRequest, unknowns_of_study
from pixsim.studies.settings import Study, with_data_sheets
from pixsim.studies.uncertainty import (
    MAX_TYPE_EVALUATIONS,
    NORMAL_95,
    SCATTER,
    TYPES_FILE,
    UncertaintyResult,
    Unknown,
    sample_of,
    sample_types,
    settings_of,
    sobol_points,
    unknowns_of_sheet,
    unknowns_of_technology,
)
from pixsim.viewer.merging import merge

# A sensor that is described by its numbers.
SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}
Z = stats.norm.ppf([0.05, 0.5, 0.95])
BELOW_3 = "smaller than 3 µm"


def propagate(
    unknowns: Sequence[Unknown],
    optimum_um: Callable[[dict[str, float]], float],
    n: int,
    seed: int = 0,
    *,
    tried_um: tuple[float, float] = (1e-3, 1e3),
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
        **dict.fromkeys(("mean_delta_e", "mean_delta_e_low", "mean_delta_e_high"), best_um / 10),
    }
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
    """z + z' + z z' of standard normal inputs, and 100."""
    return 99 + (draw["read_noise_e"] - 4.5) / 0.5 * (1 + (draw["full_well_e"] - 1e4) / WELL_SD_E)


# --- closed forms


@pytest.mark.parametrize("seed", range(2))
def test_linear_optimum_of_normal_inputs(seed: int) -> None:
    """Over 40 seeds of 256 draws the quantiles are within 0.09 sd."""
    result = propagate(NORMAL, linear, 256, seed)
    np.testing.assert_allclose([*result.optimum.quantiles.values()], 3.1 + 0.5 * Z, atol=0.12 * 0.5)
    verdict = result.verdicts[BELOW_3]
    assert verdict.probability == pytest.approx(stats.norm.cdf(-0.2), abs=0.02)
    assert verdict.low < stats.norm.cdf(-0.2) < verdict.high


# Variances of 0.09 and 0.16 of the inputs and 0.09 of the evaluations.
LINEAR_SHARES = {
    "read_noise_e": 0.09 / 0.34,
    "full_well_e": 0.16 / 0.34,
    "dsnu": 0.0,
    SCATTER: 0.09 / 0.34,
}


@pytest.mark.parametrize(
    ("kind", "sample", "options", "expected"),
    [
        ("first", (NORMAL, linear, 64, 0), {"scatter_um": 0.3}, LINEAR_SHARES),
        ("first", (NORMAL, linear, 64, 1), {"scatter_um": 0.3}, LINEAR_SHARES),
        ("first", (NORMAL, linear, 512, 0), {"scatter_um": 0.3}, LINEAR_SHARES),
        (
            "first",
            (NORMAL[:2], product, 500),
            {"total": True},
            {"read_noise_e": 1 / 3, "full_well_e": 1 / 3},
        ),
        (
            "total",
            (NORMAL[:2], product, 500),
            {"total": True},
            {"read_noise_e": 2 / 3, "full_well_e": 2 / 3},
        ),
    ],
    ids=["64", "64, other seed", "512", "Sobol' first", "Sobol' total"],
)
def test_shares_of_the_inputs(
    kind: str, sample: tuple[object, ...], options: dict, expected: dict[str, float]
) -> None:
    """Within 3 of their standard errors: of 500 seeds none of a linear optimum is beyond, and of 100
    seeds none of Sobol' points is beyond 2.9.
    """
    shares = propagate(*sample, **options).shares["optimum_um"]
    for name, share in expected.items():
        estimate = shares[name][kind]
        limit = 3 * estimate.standard_error
        check(f"{kind} share of {name}", estimate.share, share, atol=limit, why="3 standard errors")


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
@pytest.mark.parametrize("allowed", [(-np.inf, np.inf), (1.6, 3.5)], ids=["whole", "cut"])
def test_unknown_at_matches_scipy(spread: Spread, reference, allowed: tuple[float, float]) -> None:
    """Cut at bounds: the rest of the distribution, over its share. Values are a linear or
    exponential function of the coordinate, as a regression of few powers needs.
    """
    unknown = Unknown("x_e", 2.0, spread, allowed=allowed)
    share = np.linspace(0.001, 0.999, 99)
    low, high = reference.cdf(allowed)
    values = unknown.at(share)
    np.testing.assert_allclose(values, reference.ppf(low + share * (high - low)), rtol=1e-9)
    plain = np.log(values) if spread.kind == "lognormal" else values
    slopes = np.diff(plain) / np.diff(unknown.coordinate(share))
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-8)


@pytest.mark.parametrize(
    ("tried_um", "share"), [((2.6, 40.0), stats.norm.cdf(-1)), ((10.0, 20.0), 1.0)]
)
def test_optima_at_an_end_count_as_that_size(tried_um: tuple[float, float], share: float) -> None:
    """Below 2.6 µm, a standard deviation below the mean, are 15.9 % (over 40 seeds, within 1.4 %);
    their p05 is the end. Where all are at an end, the shares of the inputs are unknown.
    """
    result = propagate(NORMAL, linear, 256, 1, tried_um=tried_um)
    assert result.share_at_ends == pytest.approx(share, abs=0.02)
    assert result.optimum.quantiles["p05"] == tried_um[0]
    assert ({row[1] for row in shares_table(result).rows} == {"unknown"}) == (share == 1.0)


# --- inputs


def unknowns_of(*names: str) -> list[Unknown]:
    return [
        unknown
        for name in names
        for unknown in unknowns_of_technology(pixsim.load_technology(name), name)
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
    text = packaged("data/technologies")["0.35um"].read_text(encoding="utf-8")
    parts = [part for part in text.split("\n\n") if not part.startswith(("[prnu]", "[offset_fpn]"))]
    entry = 'value = 0.05\nrange = [0.04, 0.06]\nconfidence = "D"\nsource = "here"\n'
    parts += [f"[{name}]\n{entry}" for name in sorted(LAYOUT)]
    path = tmp_path / "layout.toml"
    path.write_text("\n\n".join(parts), encoding="utf-8")
    study = Study(name="s", technologies=[str(path)], pixel=pixel)
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
    low, high = np.transpose([unknown.spread.range for unknown in members])
    values = np.array([[draw[unknown.name] for unknown in members] for draw in sample.draws])
    places = (values - low) / (high - low)
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


VOLTAGES = {"voltage_swing_v": (0.9, 2.2), "reset_voltage_v": (1.2, 3.0)}


@pytest.mark.parametrize("distribution", ["uniform", "normal", "lognormal"])
@pytest.mark.parametrize(
    ("name", "ranges"),
    [
        ("0.35um", {}),
        ("4t-fsi", {}),
        ("0.35um", VOLTAGES),
        ("0.35um", {"voltage_swing_v": (0.9, 1.5)}),
    ],
)
def test_unknowns_of_technology_draw_valid_technologies(
    name: str, ranges: dict[str, tuple[float, float]], distribution: str
) -> None:
    base = pixsim.load_technology(name)
    ranges = ranges or base.ranges
    kinds = {number: distribution for number, (low, _) in ranges.items() if low > 0}
    changes = {"ranges": ranges, "distributions": kinds}
    technology = pixsim.Technology.model_validate(base.model_dump() | changes)
    unknowns = unknowns_of_technology(technology, name)
    assert {unknown.name for unknown in unknowns} == {f"{name} {number}" for number in ranges}
    for draw in sample_types(unknowns, 64).draws:
        numbers = {unknown.quantity: draw[unknown.name] for unknown in unknowns}
        assert technology.with_numbers(numbers, "here").numbers != technology.numbers


def test_unknown_efficiency_of_one_wavelength_stays_below_what_silicon_absorbs() -> None:
    """0.9 at 600 nm: 5 µm of silicon absorb 0.876 of that light, too little for it, and 10 µm
    0.985, where draws end.
    """
    efficiency = {"quantum_efficiency": 0.9, "quantum_efficiency_nm": 600}
    deep = pixsim.Pixel(**SHEET | efficiency, quantum_efficiency_depth_um=10)
    (unknown,) = unknowns_of_sheet(deep, {"quantum_efficiency": Spread(sd=0.05)})
    highest = float(unknown.at(np.array([1.0]))[0])
    assert highest == pytest.approx(1 - np.exp(-10 * absorption_per_um(600.0)), rel=1e-9)
    physics = pixsim.derive(deep.model_copy(update={"quantum_efficiency": highest}))
    assert physics.quantum_efficiency(350.0) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("stack", "stated"),
    [
        ({"enabled": False}, {"height_um", "index", "crosstalk"}),
        ({"height_um": 3.0}, {"height_um"}),
    ],
)
def test_stated_numbers_of_a_stack_are_known(stack: dict, stated: set[str]) -> None:
    study = Study(name="b", technologies=["4t-bsi"], pixel={"stack": stack})
    left = set(pixsim.load_technology("4t-bsi").ranges) - {f"stack_{name}" for name in stated}
    assert {unknown.quantity for unknown in unknowns_of_study(study)} == left


def test_study_of_a_draw_has_its_numbers(tmp_path: Path) -> None:
    """Technologies, data sheets among them, one with a technology of its own, numbers set by the
    study, and its own [pixel]. Its random streams depend on the name and the technologies.
    """
    pixel = {"technology": "4t-bsi", "pitch_um": 1.4, "dsnu": 0.2, "prnu_percent": 1}
    plain = str(sheet(tmp_path / "sheet.toml", uncertainty={"full_well_e": {"sd": 500}}))
    mixed = str(sheet(tmp_path / "mixed.toml", pixel, uncertainty={"dsnu": {"sd": 0.05}}))
    settings = {
        "name": "a",
        "technologies": ["0.35um", plain, mixed],
        "process": {"0.35um": {"dsnu": 0.25}},
        "pixel": {"read_noise_e": 3.0},
    }
    study = checked(Study, with_data_sheets([Layer(settings)], {}))
    unknowns = unknowns_of_study(study, {"": {"read_noise_e": Spread(sd=0.3)}})
    # By the data sheet's PRNU, and by [pixel].
    stated = {"prnu_um", "read_noise_e", "read_noise_after_gain_e"}
    expected = {"read_noise_e", f"{plain} full_well_e", f"{mixed} dsnu"}.union(
        (f"0.35um {name}" for name in pixsim.load_technology("0.35um").ranges if name != "dsnu"),
        (f"{mixed} {name}" for name in pixsim.load_technology("4t-bsi").ranges.keys() - stated),
    )
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


def test_results_repeat_bit_for_bit_and_are_written() -> None:
    results = [
        propagate(NORMAL, linear, 60, seed, tried_um=(2.35, 9.0), scatter_um=0.05)
        for seed in (7, 7, 8)
    ]
    texts = [result.to_csv() for result in results]
    assert texts[0] == texts[1]
    assert not set(texts[1].splitlines()[1:]) & set(texts[2].splitlines()[1:])
    summary = json.loads(json.dumps(results[0].as_dict(), allow_nan=False))
    assert (summary["draws"], summary["asked"], summary["seed"]) == (64, 60, 7)
    share = summary["shares"]["optimum_um"]["full_well_e"]["first"]["share"]
    expected = results[0].shares["optimum_um"]["full_well_e"]["first"].share
    assert share == pytest.approx(expected, abs=5e-5)
    table = list(csv.DictReader(io.StringIO(texts[0])))
    for name, values in (results[0].table | results[0].holds).items():
        cells = ["" if value != value else str(value) for value in values.tolist()]
        assert [row[name] for row in table] == cells


# --- the pitches of each type


NAMES = ["0.35um", "0.25um"]
SMALL = TINY | {
    "technologies": NAMES,
    "camera": {"die_mm": 0.2},
    "display": {"dots": 16},
    "pitch": {"min_fill_factor": 0.05, "count": 5, "max_um": 12.0},
}


def written(**over) -> str:
    return "".join(f"{name} = {toml_of(value)}\n" for name, value in merge(SMALL, over).items())


def sheet(path: Path, table: dict | None = None, **more) -> Path:
    path.write_text(f"pixel = {toml_of((table or SHEET) | more)}\n", encoding="utf-8")
    return path


# --- of a study

# One column, and so one fit of a type.
BY_VISUAL_NOISE = {"metrics": ["visual_noise"]}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[object, Path]:
    """The types of both technologies by visual noise."""
    folder = tmp_path_factory.mktemp("types")
    study = Study.model_validate(SMALL | BY_VISUAL_NOISE)
    return pixsim.study(study, folder, jobs=1, uncertainty=8, smaller_than_um=(1.0,)), folder


def test_rows_of_a_type_are_those_of_a_study_with_its_numbers(
    done: tuple[object, Path], tmp_path: Path
) -> None:
    """With the same random streams, around the optimum of the metric."""
    result, folder = done
    sample = UncertaintyRequest(8).sample(result.study)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    table = rows(folder / "types_visual_noise.csv")
    drawn = [row for row in table if (row["draw"], row["technology"]) == ("3", "0.25um")]
    assert 5 <= len(drawn) <= MAX_TYPE_EVALUATIONS

    pitches_um = [float(row["pitch_um"]) for row in drawn]
    over = {
        "technologies": ["0.25um"],
        "process": {"0.25um": settings_of(result.study, unknowns, sample.draws[3])["process"]["0.25um"]},
        "pitch": {"values_um": [*sorted(set(pitches_um)), 12.0]},
    }  # fmt: skip
    curve = pixsim.study(
        Study.model_validate(merge(SMALL | BY_VISUAL_NOISE, over)), tmp_path, jobs=1
    ).curves[0]
    values = curve.statistics["visual_noise"][np.searchsorted(curve.pitch_um, pitches_um)]
    expected = [each[int(row["repeat"])] for each, row in zip(values, drawn, strict=True)]
    np.testing.assert_allclose([float(row["visual_noise"]) for row in drawn], expected, rtol=1e-9)


def test_verdicts_are_shares_of_the_types(done: tuple[object, Path]) -> None:
    """By visual noise less is better; both technologies together have 1."""
    first, second = done[0].uncertainty
    share = np.mean(first.table["visual_noise"] < second.table["visual_noise"])
    assert first.verdicts["0.35um is better than 0.25um"].probability == share
    assert second.verdicts["0.25um is better than 0.35um"].probability == 1 - share
    assert first.verdicts["the optimum is smaller than 1 µm"].probability == 0.0


def test_page_has_the_distribution_of_each_optimum(
    done: tuple[object, Path], tmp_path: Path
) -> None:
    result, _ = done
    page = result.write(tmp_path).read_text(encoding="utf-8")
    for number, types in enumerate(result.uncertainty, 1):
        low, median, high = types.optimum.quantiles.values()
        words = f"median {median:.2f} µm, nine tenths from {low:.2f} µm to {high:.2f} µm"
        assert f"optimum by visual noise of 8 sensor types: {words}" in page
        text = (tmp_path / f"sensor_types_{number}.csv").read_text(encoding="utf-8")
        assert text.splitlines() == types.to_csv().splitlines()


@pytest.fixture
def sheets(tmp_path: Path) -> tuple[Path, list[str]]:
    """A study of two sheets and two technologies, whose [pixel] has an uncertain PRNU."""
    spreads = {"dsnu": {"sd": 0.02}, "read_noise_e": {"range": [15.0, 25.0]}}
    changes = {"a": {"dsnu": 0.2}, "b": {"dsnu": 0.2, "prnu": 0.02, "read_noise_e": 18.0}}
    files = [
        str(sheet(tmp_path / f"{name}.toml", uncertainty=spreads, **more))
        for name, more in changes.items()
    ]
    pixel = {"prnu": 0.01, "uncertainty": {"prnu": {"sd": 0.001}}}
    text = written(technologies=[*files, *NAMES], resolution=COARSE, pixel=pixel)
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    return tmp_path / "s.toml", files


def test_sheets_have_separate_draws(sheets: tuple[Path, list[str]]) -> None:
    """Also of quantities with one draw in all technologies: each sensor was measured on its own."""
    path, files = sheets
    sample = UncertaintyRequest(512, uncertainty=uncertainty_of(path)).sample(load_study(path))
    names = [f"{file} {number}" for file in files for number in ("dsnu", "read_noise_e")]
    assert len(sample.inputs["dsnu"]) == 2, "of both technologies"
    drawn = np.array([[draw[name] for name in names] for draw in sample.draws])
    # Independent normals correlate by 1/√512; Sobol' points by less.
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 3 / np.sqrt(512)
    inputs = sample_of(sample, files[1]).inputs
    assert inputs.keys() == {"prnu", *names[2:]}, "of one sheet, and of [pixel]"


def test_settings_keep_the_uncertainty_of_sheets_that_change(
    sheets: tuple[Path, list[str]], tmp_path: Path
) -> None:
    path, files = sheets
    over = {"technologies": files, "pitch": {"values_um": [4, 5, 6, 7, 8]}}
    result = pixsim.study(path, tmp_path / "out", jobs=1, **over)
    settings = tmp_path / "settings.toml"
    settings.write_text(result.settings_toml, encoding="utf-8")
    sheet(Path(files[0]), uncertainty={"full_well_e": {"sd": 3.0}})
    spreads = {"dsnu": Spread(sd=0.02), "read_noise_e": Spread(range=(15.0, 25.0))}
    expected = {"": {"prnu": Spread(sd=0.001)}} | dict.fromkeys(files, spreads)
    assert uncertainty_of(settings) == expected
    assert load_study(settings).sensors == result.study.sensors


def test_dry_run_counts_the_time_of_sensor_types(tmp_path: Path) -> None:
    """64 types take eight times as long as 8, beside the study itself."""
    (tmp_path / "s.toml").write_text(written(technologies=["0.35um"]), encoding="utf-8")
    line = f"study {tmp_path / 's.toml'} --dry-run --json"
    seconds = [
        json.loads(command(f"{line}{more}")[1])["estimate"]["seconds"]
        for more in ("", " --uncertainty 8", " --uncertainty 64")
    ]
    assert seconds[2] - seconds[0] == pytest.approx(8 * (seconds[1] - seconds[0]), rel=1e-9)
    assert seconds[1] > seconds[0]


# --- of a comparison

PAIR = {
    "scene": "slanted_edge",
    "display": {"dots": 32},
    "resolution": COARSE,
    "repeats": 3,
    "jobs": 1,
    "parameters": {"luminance_cd_per_m2": 0.05},  # so that read noise decides
}


def unsure(path: Path, low_e: float, high_e: float) -> Path:
    """A data sheet with a uniform range of its read noise."""
    spread = f"read_noise_e = {{ range = [{low_e}, {high_e}], distribution = 'uniform' }}"
    return noisy_sheet(path, (low_e + high_e) / 2, more=f"[pixel.uncertainty]\n{spread}\n")


def test_probability_is_that_of_less_read_noise(tmp_path: Path) -> None:
    """With equal random numbers, mean ΔE grows with read noise: a is better where its read noise is
    smaller, with a probability of 7/8. The share of 64 draws is within two standard errors.
    """
    files = [unsure(tmp_path / "a.toml", 10.0, 30.0), unsure(tmp_path / "b.toml", 20.0, 40.0)]
    (result,) = pixsim.compare(files, uncertainty=64, **PAIR).uncertainty
    noise_e = np.array([list(draw.values()) for draw in result.sample.draws])
    np.testing.assert_array_equal(result.differences > 0, noise_e[:, 0] < noise_e[:, 1])
    better = result.probability_a_better
    assert better.probability == np.mean(noise_e[:, 0] < noise_e[:, 1])
    assert better.probability == pytest.approx(0.875, abs=2 * np.sqrt(0.875 / 8 / 64))
    assert better.low <= 0.875 <= better.high
    # Differences are nearly linear in both numbers: all shares together are the variance.
    total = sum(share["first"].share for share in result.shares.values())
    assert total == pytest.approx(1.0, abs=0.1)


def test_scatter_variances_are_those_of_noise_that_types_do_not_share() -> None:
    """Of 2000 types in two frames: a noise of 0.3 leaves a variance of 0.045 in their mean, which
    2000 squares tell to 3.2 %.

    What differs between types, or between frames by the same amount for all types, is not scatter.
    """
    rng = np.random.default_rng(0)
    shared = rng.normal(5.0, 2.0, (2000, 1)) + np.array([1.0, -3.0])
    noise = 0.3 * rng.standard_normal((2000, 2))
    assert scatter_variances(shared + noise).mean() == pytest.approx(0.045, rel=4 * 0.032)
    np.testing.assert_allclose(scatter_variances(shared), np.zeros(2000), atol=1e-24)


def test_conditions_average_the_types_of_a_pair(tmp_path: Path) -> None:
    """Differences are weighted means; under a condition that states the uncertain number, these two
    sensors are alike.
    """
    files = [noisy_sheet(tmp_path / "a.toml", 25.0), unsure(tmp_path / "b.toml", 10.0, 30.0)]
    long, short = ({"exposure": {"max_integration_s": limit_s}} for limit_s in (0.1, 0.02))
    conditions = [
        {"name": "long", "weight": 3.0, "set": long},
        {"name": "short", "weight": 1.0, "set": short},
        {"name": "set", "weight": 4.0, "set": {"pixel": {"read_noise_e": 5.0}}},
    ]
    study = Study.model_validate({"name": "three", "condition": conditions})
    differences = [
        pixsim.compare(files, uncertainty=8, **PAIR | over).uncertainty[0].differences
        for over in ({"study": study}, long, short)
    ]
    expected = 0.375 * differences[1] + 0.125 * differences[2]
    np.testing.assert_allclose(differences[0], expected, rtol=1e-9)


def test_a_pair_without_an_unknown_number_has_no_types(tmp_path: Path) -> None:
    exact = [noisy_sheet(tmp_path / f"{name}.toml", 25.0) for name in ("a", "c")]
    files = [exact[0], unsure(tmp_path / "b.toml", 10.0, 30.0), exact[1]]
    result = pixsim.compare(files, uncertainty=8, **PAIR)
    assert [pair.names for pair in result.uncertainty] == [("a", "b")]
    assert [note.id for note in result.notes if "a and c" in note] == ["no_effect"]


def test_types_are_judged_by_each_metric(tmp_path: Path) -> None:
    """In its own direction: the sensor with less read noise has more information, and sees a target
    better.
    """
    files = [unsure(tmp_path / "a.toml", 10.0, 20.0), unsure(tmp_path / "b.toml", 25.0, 35.0)]
    target = {"size_um": 100.0, "contrast": -0.1, "luminance_cd_per_m2": 0.5}
    options = PAIR | {"scene": "target", "parameters": target, "uncertainty": 8}
    result = pixsim.compare(files, metrics=["information", "detectability"], **options)
    assert {pair.metric.name for pair in result.uncertainty} >= {"information", "detectability"}
    for pair in result.uncertainty:
        assert pair.metric.is_delta_e or pair.probability_a_better.probability == 1.0


def test_sensors_of_one_technology_share_its_numbers(tmp_path: Path) -> None:
    """What is not known of a process moves two equal sensors alike: they stay equal in every
    type.
    """
    files = [sheet(tmp_path / f"{name}.toml", {"pitch_um": 10.0}) for name in ("a", "b")]
    (result,) = pixsim.compare(
        files, uncertainty=8, **(PAIR | {"camera": {"die_mm": 0.5}})
    ).uncertainty
    members = list(result.sample.inputs.values())
    assert {tuple(unknown.technology for unknown in each) for each in members} == {("a", "b")}
    np.testing.assert_array_equal(result.differences, np.zeros(8))
    assert result.probability_a_better.probability == 0.5


def test_an_interrupted_comparison_of_types_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, evaluations: list[pixsim.Frame]
) -> None:
    """The line of settings.toml takes up a table of types that was cut off, and finds the same."""
    monkeypatch.chdir(tmp_path)
    unsure(Path("a.toml"), 10.0, 30.0)
    noisy_sheet(Path("b.toml"), 25.0)
    small = f"--display.dots 32 --resolution {COARSE} --repeats 2 --scene slanted_edge"
    command(f"compare a.toml b.toml --uncertainty 8 --jobs 1 {small} --out first")
    monkeypatch.chdir("first")
    first = json.loads(Path("compare.json").read_bytes())["uncertainty"]
    whole = Path(TYPES_FILE).read_bytes()
    lines = whole.splitlines(keepends=True)
    Path(TYPES_FILE).write_bytes(b"".join(lines[:9]))
    evaluations.clear()
    repeat = re.search("# pixsim (compare .*)", Path(SETTINGS_FILE).read_text(encoding="utf-8"))
    command(f"{repeat[1]} --jobs 1 --out .")
    assert len(evaluations) < len(lines) - 1, "not all again"
    assert Path(TYPES_FILE).read_bytes() == whole
    assert json.loads(Path("compare.json").read_bytes())["uncertainty"] == first
