"""Every option of a command has its Python form: an argument of the same name of the function of
the command's name.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

import pytest
from pydantic import BaseModel

import pixsim
from pixsim.base.caller import OPTIONS
from pixsim.base.result import Result
from pixsim.cli.commands import app
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run

# Command -> its function, and the record whose fields it takes as further keywords.
FUNCTIONS: dict[str, tuple[Callable[..., Any], type[BaseModel] | None]] = {
    "run": (pixsim.run, Run),
    "study": (pixsim.study, Study),
    "compare": (pixsim.compare, Study),
    "datasheet": (pixsim.datasheet, None),
    "accuracy": (pixsim.accuracy, None),
    "sfr": (pixsim.sfr, None),
    "lens": (pixsim.lens, None),
}
# Options whose argument has another name: -D name=value and --linear are entries of `parameters`.
RENAMED = {option.replace("-", "_"): name for name, option in OPTIONS.items()}
RENAMED |= {"define": "parameters", "linear": "parameters", "assets": "parameters", "yes": "agreed"}
FOR_THE_TERMINAL = {
    "json": "the result has `as_dict`",
    "out": "the result is written where one likes, by `write`; tested below",
    "raw": "`pixsim.write_frame` writes the frame of `result.score` in any of its formats",
    "irradiance": (
        "`pixsim.write_exr` writes `result.irradiance`, or what its `box_reduced` returns"
    ),
    "figures": "an argument of `write`",
    "dry_run": "tells a person what a command would take, before it begins",
}


def options_of(command: str) -> set[str]:
    """Names of the options of a command, of tables that of the table, as arguments of a function
    have them.
    """
    arguments = [
        argument
        for argument in app[command].assemble_argument_collection()
        if argument.field_info.kind is inspect.Parameter.KEYWORD_ONLY
    ]
    words = (
        next(
            (word for word in argument.names if word.startswith("--") and word[:8] != "--empty-"),
            "",
        )
        for argument in arguments
    )
    return {word.removeprefix("--").partition(".")[0].replace("-", "_") for word in words if word}


@pytest.mark.parametrize("command", FUNCTIONS)
def test_every_option_has_an_argument_of_its_name(command: str) -> None:
    function, record = FUNCTIONS[command]
    names = {*inspect.signature(function).parameters, *(record.model_fields if record else ())}
    options = options_of(command)
    assert len(options) > 5
    missing = {
        option for option in options - names if RENAMED.get(option) not in names
    } - FOR_THE_TERMINAL.keys()
    assert not missing


@pytest.mark.parametrize("command", FUNCTIONS)
def test_every_result_can_be_shown_and_written(command: str) -> None:
    function = inspect.unwrap(FUNCTIONS[command][0])
    for name in function.__annotations__["return"].split(" | "):
        kind = vars(sys.modules[function.__module__])[name]
        assert issubclass(kind, Result)
        assert kind.__name__ in pixsim.PRESENTERS


def test_exceptions_are_needed() -> None:
    options = set().union(*map(options_of, FUNCTIONS))
    assert {*RENAMED, *FOR_THE_TERMINAL} <= options
