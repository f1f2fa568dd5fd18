"""Rules across fields of studies, runs, metrics of a user and sensor types; refused with the name of
the setting and the cause. Those of axes, comparisons and sweeps: test_refusals.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import tiny, tiny_toml

import pixsim
from pixsim.base.problems import MAX_PROBLEMS
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spread import Spread
from pixsim.studies.design import cases_of
from pixsim.studies.files import load_study
from pixsim.studies.prepare import (
    UncertaintyRequest,
    check_axes,
    prepare,
    uncertainty_request,
    unknowns_of_study,
)
from pixsim.studies.run import check_raw
from pixsim.studies.uncertainty import Unknown, few_pitches_um, sample_types, unknowns_of_sheet
from pixsim.viewer.setting import Run

FLAT = np.full((8, 8), 0.5)
SHEET = {
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.5,
}
LENS = {"height_um": 5.0, "index": 1.5, "microlens": "square"}
F_NUMBERS = {"name": "lens", "set": "camera.f_number", "values": [2, 3, 4, 5, 6]}
ALONE = {"name": "d", "range_of": "dsnu", "alone": True}


def metric(value: Any = 1.0, name: str = "mine", **marks: Any) -> Callable[[Any], Any]:
    def mine(score: Any) -> Any:
        return value

    mine.__name__ = name
    vars(mine).update(marks)
    return mine


def score(*metrics: Any) -> None:
    pixsim.score_pictures(FLAT, FLAT, metrics=metrics)


def conditions(*names: str) -> pixsim.Study:
    short = {"exposure": {"max_integration_s": 0.02}}
    return tiny(condition=[{"name": name, "set": short} for name in names])


def process(**numbers: float) -> None:
    prepare(tiny(process={"0.35um": numbers}))


def labels(*names: str) -> None:
    values = [
        {"label": name, "set": {"camera": {"f_number": 2.0 + place}}}
        for place, name in enumerate(names)
    ]
    cases_of(tiny(axis=[{"name": "lens", "values": values}]))


RULES: dict[str, tuple[Callable[[], Any], str]] = {
    # names that a spreadsheet, a terminal or a file system would obey
    "a formula": (lambda: conditions("=1+1"), "reads as a formula"),
    "a formula as a label": (lambda: labels("@SUM(A1)"), "reads as a formula"),
    "a formula as an axis": (lambda: tiny(axis=[F_NUMBERS | {"name": "-x"}]), "formula"),
    "a formula as a technology": (lambda: prepare(tiny(technologies=["+x.toml"])), "formula"),
    "control characters": (lambda: conditions("a\x1b[2J"), "control characters"),
    "a folder above": (lambda: conditions("..", "day"), "folder"),
    "a file of pixsim": (lambda: conditions("Results.csv"), "folder"),
    "one folder": (lambda: conditions("Day", "day"), "folders"),
    "one folder of labels": (lambda: labels("a b", "a:b"), "folders"),
    # metrics of a user
    "a lambda": (lambda: score(lambda score: 1.0), "a named function"),
    "a metric twice": (lambda: score(metric(), metric()), "'mine' twice"),
    "an unknown metric": (lambda: score("sharpness"), "'sharpness'"),
    "a name of pixsim": (lambda: score(metric(name="pitch_um")), "whose name pixsim uses"),
    "a direction": (lambda: score(metric(better="up")), "mine.better"),
    "NaN": (lambda: score(metric(np.nan)), "nan of mine"),
    "an array": (lambda: score(metric(np.ones(2))), "of mine"),
    "no function": (lambda: score(3), "metrics"),
    "an axis of a metric": (
        lambda: prepare(tiny(axis=[F_NUMBERS | {"name": "mean_delta_e"}])),
        "a column of every study",
    ),
    # studies
    "a size without photodiode": (
        lambda: prepare(tiny(pitch={"values_um": [5.0, 6, 7, 8, 9]})),
        r"5\.135 µm",
    ),
    "a size of the die": (
        lambda: prepare(tiny(pitch={"values_um": [6, 7, 8, 9, 1357]})),
        r"1356\.8 µm",
    ),
    "ends of a range": (
        lambda: prepare(tiny(pitch={"values_um": None, "min_um": 20.0})),
        r"pitch\.max_um.*above 20",
    ),
    "a sheet beside a technology": (
        lambda: prepare(
            tiny(
                technologies=("0.35um", "sheet"),
                sensors={"sheet": {"pitch_um": 3.0} | SHEET},
                pitch={"values_um": None},
            )
        ),
        r"pitch\.min_um",
    ),
    "an unknown technology": (lambda: prepare(tiny(technologies=("0.3um",))), "0.3um"),
    "one technology twice": (
        lambda: prepare(tiny(technologies=("0.35um", "0.35um"))),
        "the same process",
    ),
    "numbers of another technology": (
        lambda: prepare(tiny(process={"0.25um": {"dsnu": 0.1}})),
        "technologies of the study",
    ),
    "an unknown number": (lambda: process(dsn=0.1), "Did you mean 'dsnu'"),
    "swing and reset": (lambda: process(voltage_swing_v=9.0), "reset_voltage_v"),
    "no photodiode": (lambda: process(fill_factor_zero_pitch_features=16.0), "pitch_um"),
    "too few evaluations": (
        lambda: prepare(tiny(target_ci_um=0.01, max_evaluations=11)),
        "at least 12",
    ),
    "numbers of a sheet": (
        lambda: prepare(
            tiny(
                technologies=("none",),
                pixel=SHEET | {"data_sheet_pitch_um": 3},
                process={"none": {"dsnu": 0.1}},
            )
        ),
        r"process\.none",
    ),
    "a pitch for a study": (
        lambda: load_study("chen2000", pixel={"pitch_um": 3.0}),
        r"pixel\.pitch_um.*for a study",
    ),
    "options beside a Study": (
        lambda: pixsim.study(tiny(), "out", pixel={"bits": 8}),
        "with a Study",
    ),
    "a low stack": (
        lambda: prepare(tiny(pixel={"stack": LENS})),
        r"under microlenses; allowed: at most 8\.86",
    ),
    "a stack without height": (
        lambda: prepare(tiny(pixel={"stack": {"microlens": "square"}})),
        "height_um",
    ),
    "very many values": (
        lambda: tiny(axis=[F_NUMBERS | {"values": [2 + n / 1000 for n in range(5000)]}]),
        "1000 items",
    ),
    "a range of no number": (
        lambda: prepare(tiny(axis=[ALONE | {"range_of": "dark_current"}])),
        "range_of.*Did you mean 'dark_current_na",
    ),
    "a range and values": (lambda: tiny(axis=[ALONE | {"values": [1]}]), "range_of and values"),
    "a range and settings": (
        lambda: tiny(axis=[ALONE | {"set": "pixel.dsnu"}]),
        "range_of and set",
    ),
    "a range with others": (
        lambda: tiny(axis=[ALONE | {"alone": False}]),
        "range_of without alone",
    ),
    # runs
    "no sensors": (lambda: pixsim.run("csf", repeats=0), "repeats: got 0"),
    "too many sensors": (lambda: pixsim.run("csf", repeats=10_001), "repeats: got 10001"),
    "too many frames": (lambda: pixsim.run("csf", frames=1000), "frames: got 1000"),
    "bits of a picture": (
        lambda: check_raw(
            Run.model_validate({"exposure": {"frames": 64}, "pixel": {"bits": 12}}), [".png"]
        ),
        "--raw",
    ),
    # sensor types
    "both kinds of types": (lambda: uncertainty_request(8, 8, (), {}), "one of the two"),
    "a size without types": (lambda: uncertainty_request(None, None, (6.0,), {}), "smaller"),
    "too few types": (lambda: UncertaintyRequest(4), "8 to 65536"),
    "nothing unknown": (lambda: sample_types([], 16), "unknowns: got none"),
    "too many axis values": (
        lambda: check_axes(tiny(axis=[F_NUMBERS | {"values": [2, 3, 4, 5, 6, 7]}])),
        "at most 5 values",
    ),
    "two axes": (
        lambda: check_axes(
            tiny(axis=[F_NUMBERS, {"name": "b", "set": "pixel.prnu", "values": [0]}])
        ),
        "at most one axis",
    ),
    "an axis alone": (lambda: check_axes(tiny(axis=[F_NUMBERS | {"alone": True}])), "one axis"),
    "a logarithm of no positive number": (
        lambda: Unknown("dsnu", -1.0, Spread(sd=1, distribution="lognormal")),
        "dsnu.*lognormal",
    ),
    "a spread out of bounds": (
        lambda: Unknown("dsnu", 0.1, Spread(sd=1), allowed=(0.2, np.inf)),
        "46 % are within",
    ),
    "an unknown uncertain number": (
        lambda: unknowns_of_sheet(Pixel(pitch_um=3.0, **SHEET), {"dsnu": Spread(sd=1)}),
        "no such number",
    ),
    "a number outside its range": (
        lambda: unknowns_of_study(
            tiny(pixel={"read_noise_e": 3.0}), {"": {"read_noise_e": Spread(range=(15, 25))}}
        ),
        "a range that contains 3",
    ),
    "an empty range of sizes": (
        lambda: few_pitches_um(3.0, (2.0, 4.0), (4.0, 2.0)),
        "0 < low < high",
    ),
    "a range of one size": (
        lambda: few_pitches_um(3.0, (2.0, 4.0), (3.0, 3.00001)),
        "5 different pitches",
    ),
}


@pytest.mark.parametrize(("call", "words"), RULES.values(), ids=RULES)
def test_a_rule_across_fields_is_refused(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"(?s){words}"):
        call()


@pytest.mark.parametrize("name", ["types.csv", "types_information.csv", "results.csv"])
def test_rows_of_another_program_are_refused_before_anything_is_rendered(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text("mine")
    study = tiny(metrics=["delta_e", "information"])
    with pytest.raises(pixsim.PixsimError, match=rf"results: got '.*{name}', not written by"):
        pixsim.study(study, tmp_path, jobs=1, uncertainty=8)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "mine")]


def test_a_message_stops_after_ten_problems(tmp_path: Path) -> None:
    unknown = "".join(f"unknown_{n} = 1\n" for n in range(5000))
    (tmp_path / "study.toml").write_text(tiny_toml() + unknown, encoding="utf-8")
    code, out, err = command("study", tmp_path / "study.toml", "--dry-run")
    assert (code, out, len(err.splitlines())) == (2, "", MAX_PROBLEMS + 1)
    assert err.endswith("and 4990 more problems\n")


def test_usual_names_are_allowed() -> None:
    names = ("night", "Ä 1", "0.35um", "a-b", "day 2")
    assert [case.condition for case in cases_of(conditions(*names))] == list(names)
