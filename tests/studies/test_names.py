"""Names that a spreadsheet, a terminal or a file system would obey are refused when they are read;
and time is bounded by size.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.commands import command
from helpers.tiny import tiny, tiny_toml

import pixsim
from pixsim.base.errors import PixsimError, name_fault
from pixsim.base.problems import MAX_PROBLEMS
from pixsim.studies.design import cases_of
from pixsim.studies.prepare import check_technologies

BAD = (
    "=1+1",
    "+x",
    "-x",
    "@SUM(A1)",
    "\uff1dx",
    "a\x1b[2J",
    "a\u202eb",
    "a\u009bb",
    "a\tb",
    "a\nb",
    "\x7f",
)
GOOD = ("-0.5", "+3", "night", "f/2.8", "Ä 1", "0.35um", "a-b", "1e-3")
SETTING = {"exposure": {"max_integration_s": 0.02}}


def with_condition(*names: str) -> pixsim.Study:
    return tiny(condition=[{"name": name, "set": SETTING} for name in names])


@pytest.mark.parametrize("name", BAD)
def test_names_that_others_would_obey_are_refused(name: str, tmp_path: Path) -> None:
    axis = {"name": "lens", "set": "camera.f_number", "values": [2.0]}
    labelled = {"name": "lens", "values": [{"label": name, "set": {"camera": {"f_number": 2.0}}}]}
    file = str(tmp_path / f"{name}.toml")
    for read in (
        lambda: with_condition(name),
        lambda: tiny(axis=[axis | {"name": name}]),
        lambda: tiny(axis=[labelled]),
        lambda: check_technologies(tiny(technologies=[f"{name}.toml"])),
        lambda: pixsim.load_technology(file),
        lambda: pixsim.compare([file, "0.35um"]),
    ):
        with pytest.raises(ValueError, match=r"(reads as a formula|control characters)"):
            read()


@pytest.mark.parametrize("name", GOOD)
def test_usual_names_and_numbers_are_allowed(name: str) -> None:
    assert not name_fault(name)


NAMES = [
    ["..", "day"],
    ["."],
    [".pixsim.lock"],
    ["settings.toml"],
    ["Results.csv"],
    ["figures"],
    ["a b", "a_b"],
    ["Day", "day"],
]


@pytest.mark.parametrize("names", NAMES)
def test_conditions_whose_folder_could_not_be_made_are_refused_when_the_study_is_read(
    names: list[str],
) -> None:
    with pytest.raises(ValueError, match=r"the folders? of '"):
        with_condition(*names)


def test_folders_of_cases_differ() -> None:
    values = [
        {"label": label, "set": {"camera": {"f_number": stop}}}
        for label, stop in (("a b", 2), ("a:b", 4))
    ]
    with pytest.raises(PixsimError, match="the folders of 'a b' and 'a:b' would both be 'a_b'"):
        cases_of(tiny(axis=[{"name": "lens", "values": values}]))
    assert len(cases_of(with_condition("day", "night", "day 2"))) == 3


def test_a_message_stops_after_ten_problems(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        tiny_toml() + "".join(f"unknown_{n} = 1\n" for n in range(5000)), encoding="utf-8"
    )
    code, out, err = command("study", tmp_path / "study.toml", "--dry-run")
    assert (code, out, len(err.splitlines())) == (2, "", MAX_PROBLEMS + 1)
    assert err.endswith("and 4990 more problems\n")


def test_an_axis_of_very_many_values_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match=r"axis\.0\.values\n.*at most 1000 items"):
        tiny(
            axis=[
                {
                    "name": "lens",
                    "set": "camera.f_number",
                    "values": [2 + n / 1000 for n in range(5000)],
                }
            ]
        )
