"""Comparisons over sensor types: the probability that one sensor is better, against closed forms
and comparisons of the types.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.sheets import sheet
from helpers.tiny import COARSE

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.uncertainty import pair_words
from pixsim.sensor.readout import Frame
from pixsim.studies.compare import scatter_variances
from pixsim.studies.settings import Study
from pixsim.studies.uncertainty import TYPES_FILE

SMALL: dict[str, Any] = {"display": {"dots": 32}, "resolution": COARSE, "repeats": 3, "jobs": 1}
DIM = {"luminance_cd_per_m2": 0.05}  # so that read noise decides
DRAWS = 64


def unsure(path: Path, read_noise_e: float, low: float, high: float) -> Path:
    """A data sheet with a uniform range of its read noise."""
    spread = f"read_noise_e = {{ range = [{low}, {high}], distribution = 'uniform' }}"
    return sheet(path, read_noise_e, more=f"[pixel.uncertainty]\n{spread}\n")


def of(*files: Path, draws: int = DRAWS, **options: Any) -> Any:
    return pixsim.compare(files, parameters=DIM, uncertainty=draws, **(SMALL | options))


@pytest.mark.parametrize(
    ("range_a", "range_b", "expected"),
    [
        (
            (10.0, 30.0),
            (20.0, 40.0),
            0.875,
        ),  # 1 - 10² / (2 · 20²): the triangle in which b has less noise
        ((25.0, 35.0), (10.0, 20.0), 0.0),
    ],
)
def test_probability_is_that_of_less_read_noise(
    range_a: tuple[float, float], range_b: tuple[float, float], expected: float, tmp_path: Path
) -> None:
    """With equal random numbers, mean ΔE grows with read noise: a is better where its read noise is
    smaller.
    """
    files = [
        unsure(tmp_path / f"{name}.toml", sum(ends) / 2, *ends)
        for name, ends in (("a", range_a), ("b", range_b))
    ]
    (found,) = of(*files).uncertainty
    better = found.probability_a_better
    assert better.low <= expected <= better.high
    assert better.probability == pytest.approx(
        expected, abs=2 * np.sqrt(expected * (1 - expected) / DRAWS)
    )
    noise = {
        name: np.array([draw[f"{name} read_noise_e"] for draw in found.sample.draws])
        for name in "ab"
    }
    assert np.array_equal(found.differences > 0, noise["a"] < noise["b"])
    # Differences are nearly linear in both numbers: all shares together are the variance.
    assert sum(share["first"].share for share in found.shares.values()) == pytest.approx(
        1.0, abs=0.1
    )
    assert found.difference.quantiles["p50"] == pytest.approx(
        np.median(found.differences), rel=1e-9
    )


def test_scatter_variances_are_those_of_noise_that_types_do_not_share() -> None:
    """Of 2000 types in two frames: a noise of 0.3 leaves a variance of 0.045 in their mean, which
    2000 squares tell to 3.2 %.

    What differs between types, or between frames by the same amount for all types, is not scatter.
    """
    rng = np.random.default_rng(0)
    differences = (
        rng.normal(5.0, 2.0, (2000, 1))
        + np.array([1.0, -3.0])
        + 0.3 * rng.standard_normal((2000, 2))
    )
    assert scatter_variances(differences).mean() == pytest.approx(0.3**2 / 2, rel=4 * 0.032)
    np.testing.assert_allclose(
        scatter_variances(np.add.outer(np.arange(8.0), [1.0, -3.0])), np.zeros(8), atol=1e-24
    )


def test_types_are_judged_by_each_metric(tmp_path: Path) -> None:
    """In its own direction: the sensor with less read noise has more information, and sees a target
    better; ΔE stays as alone.
    """
    files = [
        unsure(tmp_path / f"{name}.toml", middle, middle - 10.0, middle + 10.0)
        for name, middle in (("a", 20.0), ("b", 30.0))
    ]
    target = {"size_um": 100.0, "contrast": -0.1, "luminance_cd_per_m2": 0.5}
    scene = {"scene": "target", "parameters": target, "uncertainty": 8, **SMALL}
    result = pixsim.compare(files, metrics=["information", "detectability"], **scene)
    assert [each.metric.name for each in result.uncertainty] == [
        "delta_e",
        "information",
        "detectability",
    ]
    of_delta_e = pixsim.compare(files, **scene)
    (alone,) = of_delta_e.uncertainty
    assert of_delta_e.difference == result.difference
    np.testing.assert_array_equal(result.uncertainty[0].differences, alone.differences)
    noise = {
        name: np.array([draw[f"{name} read_noise_e"] for draw in alone.sample.draws])
        for name in "ab"
    }
    for found in result.uncertainty[1:]:
        assert np.array_equal(found.differences < 0, noise["a"] < noise["b"]), "b - a: a has more"
        assert found.probability_a_better.probability == np.mean(noise["a"] < noise["b"])
        of_pair = result.as_dict()["uncertainty"]["b"]
        assert of_pair["metrics"][found.metric.name] == found.as_dict()
        assert pair_words(found).startswith(
            f"{found.metric.words}: over 8 sensor types a is better than b with probability "
        )
    pixsim.write_report(result, tmp_path / "out")


def test_type_has_the_difference_of_a_comparison_with_its_numbers(tmp_path: Path) -> None:
    """Its change from the sensors as they are is that of comparisons of two frames with its
    numbers, on one film.
    """
    files = [
        unsure(tmp_path / "a.toml", 20.0, 10.0, 30.0),
        unsure(tmp_path / "b.toml", 25.0, 20.0, 40.0),
    ]
    result = of(*files, draws=8)
    (found,) = result.uncertainty
    draw = found.sample.draws[3]
    for name in "ab":
        sheet(tmp_path / f"{name}.toml", draw[f"{name} read_noise_e"])
    alone = pixsim.compare(files, parameters=DIM, **(SMALL | {"repeats": 2}))
    as_is = result.differences["b"][:2].mean()
    assert found.differences[3] == pytest.approx(
        result.difference["b"] + alone.difference["b"] - as_is, rel=1e-9
    )


def test_sensors_of_one_technology_share_its_numbers(tmp_path: Path) -> None:
    """What is unknown of the process alone moves two equal sensors alike: they stay equal in every
    type.
    """
    files = [tmp_path / "a.toml", tmp_path / "b.toml"]
    for file in files:
        file.write_text(
            "[camera]\ndie_mm = 0.5\n[pixel]\ntechnology = '0.35um'\npitch_um = 10.0\n",
            encoding="utf-8",
        )
    (found,) = of(*files, draws=8).uncertainty
    assert found.sample.inputs
    assert all(
        {unknown.technology for unknown in members} == {"a", "b"}
        for members in found.sample.inputs.values()
    )
    assert np.array_equal(found.differences, np.zeros(8))
    assert found.probability_a_better.probability == 0.5
    assert "does not vary" in pair_words(found)


def test_third_sensor_and_conditions_change_no_type_of_a_pair(tmp_path: Path) -> None:
    """Types of a pair see what the pair sees, and a pair without an unknown number has none.

    Under conditions, their differences are weighted means; numbers that one sets are known in it:
    there, these two are alike.
    """
    files = [sheet(tmp_path / "a.toml", 25.0), unsure(tmp_path / "b.toml", 20.0, 10.0, 30.0)]
    pair = of(*files, draws=8).uncertainty[0]
    among = of(*files, sheet(tmp_path / "c.toml", 9.0, 15.0, "[40, 40]"), draws=8)
    assert [found.names for found in among.uncertainty] == [("a", "b")]
    assert "a and c: nothing is drawn, since no number of these two is unknown" in among.notes
    np.testing.assert_allclose(among.uncertainty[0].differences, pair.differences, rtol=1e-12)
    short = {"exposure": {"max_integration_s": 0.02}}
    conditions = [
        {"name": "long", "weight": 3.0, "set": {"exposure": {"max_integration_s": 0.1}}},
        {"name": "short", "set": short},
        {"name": "set", "weight": 4.0, "set": {"pixel": {"read_noise_e": 5.0}}},
    ]
    (all_three,) = of(
        *files, draws=8, study=Study.model_validate({"name": "three", "condition": conditions})
    ).uncertainty
    (alone,) = of(*files, draws=8, **short).uncertainty
    np.testing.assert_allclose(
        all_three.differences, 0.375 * pair.differences + 0.125 * alone.differences, rtol=1e-9
    )


def test_settings_repeat_the_types_and_an_interrupted_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, evaluations: list[Frame]
) -> None:
    """The line of settings.toml takes up a table of types that was cut off, and finds the same."""
    monkeypatch.chdir(tmp_path)
    unsure(Path("a.toml"), 20.0, 10.0, 30.0), sheet(Path("b.toml"), 25.0)
    small = f"--display.dots 32 --resolution {COARSE} --repeats 2 --jobs 1 -D luminance_cd_per_m2=1"
    _, out, _ = command(f"compare a.toml b.toml --uncertainty 8 {small} --out first")
    monkeypatch.chdir("first")
    first = json.loads(Path("compare.json").read_text(encoding="utf-8"))["uncertainty"]
    (words,) = [
        line
        for line in out.splitlines()
        if "over 8 sensor types a is better than b with probability" in line
    ]
    assert "a read_noise_e" in words or "not told" in words
    assert first["b"]["draws"] == 8

    lines = Path(TYPES_FILE).read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + 2 * 8 * 2
    Path(TYPES_FILE).write_text("".join(lines[:9]), encoding="utf-8")
    (repeat,) = [
        line
        for line in Path(SETTINGS_FILE).read_text(encoding="utf-8").splitlines()
        if "pixsim compare" in line
    ]
    evaluations.clear()
    command(repeat.removeprefix("# pixsim ") + " --jobs 1 --out .")
    keys = [line.partition(",")[0] for line in lines[1:]]
    assert len(evaluations) - 2 == len(set(keys[8:]) - set(keys[:8])) > 0, (
        "and one of each sensor for the page"
    )
    assert json.loads(Path("compare.json").read_text(encoding="utf-8"))["uncertainty"] == first


def test_dry_run_says_what_is_drawn(tmp_path: Path) -> None:
    files = unsure(tmp_path / "a.toml", 20.0, 10.0, 30.0), sheet(tmp_path / "b.toml", 25.0)
    assert (
        "16 sensor types, over a read_noise_e"
        in command("compare --uncertainty 9 --dry-run", *files)[1]
    )


def test_nothing_unknown_is_refused(tmp_path: Path) -> None:
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", 5.0)]
    with pytest.raises(PixsimError, match="at least one number with a range or an uncertainty"):
        of(*files)
    assert_refused(
        *command("compare --uncertainty 3", *files), ["--uncertainty", "8 to 65536 sensor types"]
    )
