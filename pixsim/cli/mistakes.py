"""The message of a command line that Cyclopts refuses: which word nothing takes, and how to write
what was meant.
"""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path

from cyclopts import (
    Argument,
    CycloptsError,
    MissingArgumentError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from pixsim.base.problems import names_meant, replacement_words
from pixsim.cli.options import app
from pixsim.viewer.setting import Run

# What takes a file of this suffix, where a command has it.
_OPTIONS_OF_SUFFIX = {
    ".toml": ("--config", "-o"),
    ".xml": ("--scene", "-o"),
    ".exr": ("-o",),
    ".zmx": ("--lens",),
}
_OTHER_NAME = {"-o": "--out", "--out": "-o"}  # a folder, or a single file


def refusal(error: CycloptsError) -> str:
    """Return the message for a command line with a word or an option that its command does not
    take, or another fault.
    """
    command = " ".join(error.command_chain or ())
    text = str(error)
    words, options = names_of(command) if command else ((), frozenset())
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        first, *others = error.unused_tokens
        got = f"the extra word '{first}'"
        if others:
            got = f"the extra words '{first}' and {len(others)} more"
        text = (
            f"{command}: got {got}; allowed: {' and '.join([*words, 'options'])}."
            f" {_hint_of_word(first, options)}".rstrip()
        )
    elif (
        isinstance(error, MissingArgumentError)
        and error.argument
        and error.argument.index is not None
    ):
        name = _word_of(error.argument)
        allowed = error.argument.parameter.help
        text = f"{command}: got no {name}; allowed: {allowed}"
    elif isinstance(error, UnknownOptionError):
        # After a list of files, as of `compare`, Cyclopts has the option as a value.
        name = (error.token.keyword or error.token.value).partition("=")[0]
        if hint := _hint_of_option(name, options, proposed="Did you mean" in text):
            text = f"Unknown option: {name}. {hint}"
    return f"{text}\nTry 'pixsim{command and ' '}{command} --help'."


@cache
def names_of(command: str) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the names of what a command takes without an option, as SCENE, and of its options."""
    arguments = [
        argument for argument in app[command].assemble_argument_collection() if argument.parse
    ]
    words = tuple(_word_of(argument) for argument in arguments if argument.index is not None)
    return words, frozenset(
        name for argument in arguments if argument.index is None for name in argument.names
    )


def _word_of(argument: Argument) -> str:
    return argument.name.lstrip("-").upper()


def _hint_of_word(word: str, options: frozenset[str]) -> str:
    """Return where a word belongs that is no argument of a command with these options; empty if
    that is not plain.
    """
    name, equals, value = word.partition("=")
    option = f"--{name.lower().replace('_', '-')}"
    if option in options:
        return f"Did you mean {option}{equals}{shlex.quote(value) if value else ''}?"
    if name and equals and "-D" in options:
        return f"Each scene parameter needs its own -D: -D {shlex.quote(word)}"
    for option in _OPTIONS_OF_SUFFIX.get(Path(word).suffix.lower(), ()):
        if option in options:
            return f"Such a file goes after {option}: {option} {shlex.quote(word)}"
    if word.replace(".", "").isdecimal():
        return (
            "An option takes one word: write a pair of numbers as 1936x1216, and a list as"
            " 2.4,3.45, without spaces."
        )
    return ""


def _hint_of_option(name: str, options: frozenset[str], proposed: bool) -> str:
    """Return what an unknown option, such as --camera.resolution, means for a command with these
    options.

    proposed : whether Cyclopts proposes another one

    Empty if nothing better is known.
    """
    *tables, last = name.lstrip("-").replace("-", "_").lower().split(".")
    meant_paths = names_meant(Run.__name__, tables, last)
    candidates = ["--" + ".".join(path).replace("_", "-") for path in meant_paths]
    replacement = ""
    if meant_paths and (tables or len(meant_paths) == 1):
        replacement = replacement_words(Run.__name__, meant_paths[0], last)
    candidates += [option for option in sorted(options) if option.startswith(f"{name}-")]
    candidates += [_OTHER_NAME[name]] if name in _OTHER_NAME else []
    if candidates := [option for option in dict.fromkeys(candidates) if option in options]:
        return f"Did you mean {' or '.join(candidates)}? {replacement}".rstrip()
    if commands := _commands_with(name):
        return f"Commands with this option: {', '.join(commands)}."
    if "-D" in options and not (proposed or tables) and name.startswith("--"):
        return f"A parameter of the scene goes after -D: -D {last}=VALUE"
    return ""


def _commands_with(option: str) -> list[str]:
    """Return the names of the commands that have an option."""
    return [command for command in app if command[0] != "-" and option in names_of(command)[1]]
