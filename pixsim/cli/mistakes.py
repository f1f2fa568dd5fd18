"""The message of a command line that Cyclopts refuses: which word nothing takes, and how to write what was meant."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from cyclopts import Argument, CycloptsError, MissingArgumentError, UnknownOptionError, UnusedCliTokensError

from pixsim.base.problems import names_meant
from pixsim.base.toml import packaged
from pixsim.cli.options import app, scene_names
from pixsim.viewer.setting import Run

OF_FILES_TO_WRITE = (".toml", ".exr", ".xml")  # which commands with -o write


def refusal(error: CycloptsError) -> str:
    """Return the message for a command line with a word or an option that its command does not take, or another fault."""
    command, text = " ".join(error.command_chain or ()), str(error)
    words, options = names_of(command) if command else ([], set())
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        first, *others = error.unused_tokens
        got = f"the further words '{first}' and {len(others)} more" if others else f"the further word '{first}'"
        allowed, hint = f"{' and '.join([*words, 'options'])}", hint_of_word(first, options)
        text = f"{command}: got {got}; allowed: {allowed}.{hint and ' '}{hint}"
    elif isinstance(error, MissingArgumentError) and error.argument and error.argument.index is not None:
        text = f"{command}: got no {word_of(error.argument)}; allowed: {error.argument.parameter.help}"
    elif hint := hint_of_folder(error.root_input_tokens or [], options):  # before a missing -o, which --out was to be
        text = f"{command}: got --out, which is for folders; allowed: {', '.join(sorted(options))}. {hint}"
    elif isinstance(error, UnknownOptionError) and error.token.keyword:
        name = error.token.keyword.partition("=")[0]
        if hint := hint_of_option(name, options) or ("" if has_near_option(name, text) else hint_of_parameter(name, options)):
            text = f"Unknown option: {name}. {hint}"
    return f"{text}\nTry 'pixsim{command and ' '}{command} --help'."


def names_of(command: str) -> tuple[list[str], set[str]]:
    """Return the names of what a command takes without an option, as SCENE, and of its options."""
    arguments = [argument for argument in app[command].assemble_argument_collection() if argument.parse]
    words = [word_of(argument) for argument in arguments if argument.index is not None]
    return words, {name for argument in arguments if argument.index is None for name in argument.names}


def word_of(argument: Argument) -> str:
    return argument.name.lstrip("-").upper()


def hint_of_word(word: str, options: set[str]) -> str:
    """Return where a word belongs that is no argument of a command; empty if nothing is known.

    options : names of those of the command
    """
    name, equals, value = word.partition("=")
    suffix, option = Path(word).suffix.lower(), f"--{name.lower().replace('_', '-')}"
    if option in options:
        return f"Did you mean {option}{equals}{shlex.quote(value) if value else ''}?"
    if name and equals and "-D" in options:
        return f"Each parameter of the scene goes after a -D of its own: -D {shlex.quote(word)}"
    kinds = [
        ("a file of settings", "--config", suffix == ".toml" or word in packaged("data/sensors")),
        ("a file to write", "-o", suffix in OF_FILES_TO_WRITE),
        ("a scene", "--scene", suffix == ".xml" or word in scene_names()),
        ("a lens", "--lens", suffix == ".zmx" or word in packaged("data/lenses")),
        ("a technology", "--pixel.technology", word in packaged("data/technologies")),
    ]
    for kind, option, fits in kinds:
        if fits and option in options:
            return f"{kind[0].upper()}{kind[1:]} goes after {option}: {option} {shlex.quote(word)}"
    if not word.replace(".", "").isdecimal():
        return ""
    return "An option takes one word: a pair of numbers is written as 1936x1216, and a list of them as 2.4,3.45 without blanks."


def hint_of_option(name: str, options: set[str]) -> str:
    """Return the options of a command that an unknown one, such as --camera.resolution, means; empty if there are none."""
    *above, last = name.lstrip("-").replace("-", "_").split(".")
    meant = ["--" + ".".join(path).replace("_", "-") for path in names_meant(Run.__name__, above, last)]
    meant += ["--out"] * (name == "-o")
    begun = sorted(option for option in options if option.startswith(f"{name}-"))
    known = [option for option in meant if option in options] or begun
    return f"Did you mean {' or '.join(known)}?" if known else ""


def has_near_option(name: str, text: str) -> bool:
    """Whether the option that Cyclopts proposes in its message is similar without the dashes, which it compares too."""
    proposed = re.search(r"Did you mean (--[\w.-]+)", text)
    return bool(proposed and difflib.get_close_matches(name.lstrip("-"), [proposed[1].lstrip("-")]))


def hint_of_folder(words: Sequence[str], options: set[str]) -> str:
    """Return how the file of --out is written, for a command that writes a single file; empty for other command lines."""
    at = next((at for at, word in enumerate(words) if word.partition("=")[0] == "--out"), None)
    if at is None or "-o" not in options or "--out" in options:
        return ""
    file = words[at].partition("=")[2] or next(iter(words[at + 1 :]), "FILE")
    return f"A file to write goes after -o: -o {shlex.quote(file)}"


def hint_of_parameter(name: str, options: set[str]) -> str:
    """Return how a parameter of the scene is set, for an unknown option that may be one."""
    parameter = name.lstrip("-").replace("-", "_")
    return (
        f"A parameter of the scene goes after -D: -D {parameter}=VALUE"
        if "-D" in options and name.startswith("--") and "." not in name
        else ""
    )
