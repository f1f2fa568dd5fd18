"""The help of options that are text, lists of formats, completion, and folders that are missing."""

import inspect
import re
import sys
from collections.abc import Callable
from copy import copy
from functools import cache
from pathlib import Path

import pytest
from cyclopts import Argument, CoercionError, Token
from helpers.commands import assert_refused, command, output_of
from pydantic import BaseModel
from rich.console import Console

import pixsim
from pixsim.base.caller import OPTIONS
from pixsim.base.layers import Layer
from pixsim.base.records import Record, as_list, checked
from pixsim.base.result import Result
from pixsim.base.toml import packaged
from pixsim.cli.commands import app
from pixsim.cli.help import COMMON, MIN_SHORTENED
from pixsim.scene.packaged import packaged_scenes
from pixsim.viewer.metric_options import Niirs
from pixsim.viewer.setting import Run

NAMES = sorted(name for name in app if not name.startswith("-"))


@cache
def shown_help(name: str, option: str = "--help-all") -> str:
    """The help of a command, which takes long for those with many options."""
    with pytest.MonkeyPatch.context() as patch:
        # Cyclopts keeps the console of its first help, with the width that the terminal had then.
        patch.setattr(app, "_console", Console(width=300))
        return output_of(f"{name} {option}")


OPTION = re.compile(r"^│[* ]*(?:[A-Z]+ )?(--[\w.-]+)", re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_common_options_and_how_to_see_all(name: str) -> None:
    """A command with many options shows a part of them, in their order, and says so."""
    text, part = shown_help(name), shown_help(name, "-h")
    assert "Usage: pixsim" in text
    short, full = OPTION.findall(part), OPTION.findall(text)
    # SENSORS has no name
    line = f"`pixsim {name} --help-all` shows all {len(full) + (name == 'compare')} options.\n"
    assert part.endswith(line) == (len(full) > MIN_SHORTENED)
    assert short == [option for option in full if option in short]
    assert short == full or {*short} - COMMON <= {"--PIXEL"}, "words without an option, too"


def test_common_options_are_options() -> None:
    """`--help` is the same help as `-h`."""
    assert {option for name in NAMES for option in OPTION.findall(shown_help(name))} >= COMMON
    assert shown_help("lens", "--help") == shown_help("lens", "-h")


def test_options_match_fields_of_files() -> None:
    """An option --table.name-of-field has the name table.name_of_field in a file."""
    options = re.findall(r"--((?:camera|pixel|exposure|display)\.[a-z0-9-]+)", shown_help("run"))
    assert {option.replace("-", "_") for option in options} == {
        f"{table}.{name}"
        for table in ("camera", "pixel", "exposure", "display")
        for name in Run.model_fields[table].annotation.model_fields
    }


@pytest.mark.parametrize(
    ("option", "record", "name"),
    [
        ("20000,-5", pixsim.Motion, "velocity_mm_per_s"),
        ("20000,-5", pixsim.Motion, "image_um_per_s"),
        ("20000 -5", pixsim.Motion, "pixels_per_s"),
        ("0.25,0.5", pixsim.Pixel, "registration"),
        ("0.1,0.5", Niirs, "reflectances"),
    ],
)
def test_pairs_of_numbers_are_texts_of_options(
    option: str, record: type[Record], name: str
) -> None:
    """As `pixsim explore` copies them into a command, too."""
    numbers = getattr(record.model_validate({name: option}), name)
    assert numbers == tuple(map(float, option.replace(",", " ").split()))


def test_one_number_of_a_pair_is_refused_where_it_was_typed() -> None:
    """The file has both numbers; the option replaces them, and lacks one."""
    file = Layer({"velocity_mm_per_s": [300, 0]}, "belt.toml")
    with pytest.raises(
        pixsim.PixsimError, match=r"^velocity_mm_per_s: got a list of 1; .* at least 2"
    ):
        checked(pixsim.Motion, [file, Layer({"velocity_mm_per_s": "300"})])


def converted(argument: Argument, *texts: str) -> list:
    """What a command gets of an option that is given once for each text."""
    fresh = copy(argument)  # an argument keeps its first result
    fresh.tokens = [
        Token(keyword=argument.names[0], value=text, source="cli", index=index)
        for index, text in enumerate(texts)
    ]
    return list(fresh.convert())


# Two values that an option takes, by the name of its values.
TWO_VALUES = {
    "NAME=VALUES": ("a.b=1,2", "c=x"),
    "NAME=VALUE": ("a.b=1,2", "c=x"),
    "UM": ("450", "0.5"),
}
TWO_OF_NAME = {"--raw": ("tiff", "png"), "--wavelength-nm": ("450", "0.5")}


@pytest.mark.parametrize("name", NAMES)
def test_options_of_several_values_take_commas_but_in_names_of_files(name: str) -> None:
    """Every option of a command that may be repeated."""
    for argument in app[name].assemble_argument_collection():
        if argument.parse and argument.index is None and argument.token_count()[1]:
            assert_takes_commas(argument)


def assert_takes_commas(argument: Argument) -> None:
    if "Path" in str(argument.hint) or argument.parameter.metavar == "FILE":
        files = converted(argument, "a, b.toml", "c.toml")
        assert list(map(str, files)) == ["a, b.toml", "c.toml"], argument.names
        return
    metavar = str(argument.parameter.metavar)
    first, second = TWO_OF_NAME.get(argument.names[0]) or TWO_VALUES.get(metavar, ("delta_e", "x"))
    one, other = converted(argument, first, second)
    assert converted(argument, f"{first},{second}") == [one, other]
    assert converted(argument, f"{first},{second}", first) == [one, other, one]
    if "=" in first:
        return  # a comma that stands alone is one of the value
    for text in (f"{first},,{second}", f"{first},", ""):
        with pytest.raises(CoercionError, match="a value on both sides of every comma"):
            converted(argument, text)


@pytest.mark.parametrize("text", ["0.25,,0.5", "0.25,0.5,", ",0.25", "", ","])
def test_list_without_a_value_beside_a_comma_is_refused(text: str) -> None:
    """The text reached a record as if the comma were a blank."""
    with pytest.raises(ValueError, match="a value on both sides of every comma"):
        as_list(text)


# --- Command lines that are refused ---


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            "run csf my.toml",
            (
                "extra word 'my.toml'; allowed: SCENE and options. Such a file goes after"
                " --config: --config my.toml"
            ),
        ),
        ("study pixel-size 'a b.toml'", "goes after --config: --config 'a b.toml'"),
        ("template sensor my.toml", "goes after -o: -o my.toml"),
        ("template sensor --out my.toml", "Unknown option: --out. Did you mean -o?"),
        ("study pixel-size my.xml", "goes after --scene: --scene my.xml"),
        ("run csf flat", "extra word 'flat'; allowed: SCENE and options."),  # it takes one
        ("run csf my.zmx", "goes after --lens: --lens my.zmx"),
        ("run csf -D spp=64 luminance_cd_per_m2=10", "needs its own -D: -D luminance_cd_per_m2=10"),
        ("run csf camera.f_number=4", "Did you mean --camera.f-number=4?"),
        ("run csf --camera.pixels 1936 1216", "write a pair of numbers as 1936x1216"),
        ("cache clear", "allowed: options. Did you mean --clear?"),
        ("run csf a b c", "extra words 'a' and 2 more"),
        ("run --seed 3", "scene: got none; allowed: an XML file, one of cornell_box, csf,"),
        ("run csf --spp 64", "A parameter of the scene goes after -D: -D spp=VALUE"),
        ("run csf --camera.resolution 640x480", "Did you mean --camera.pixels?"),
        (
            "run csf --bits=8",
            "Unknown option: --bits. Did you mean --pixel.bits or --display.bits?",
        ),
        ("run csf --pixel-size 3", "Did you mean --pixel.pitch-um?"),
        ("run csf -o there", "Unknown option: -o. Did you mean --out?"),
        ("run csf --linaer", "Did you mean --linear?"),  # by Cyclopts
        (
            "study chen2000 --axis technology=0.35um,0.18um",
            'Several are stated by technologies = ["0.35um", "0.18um"]',
        ),
        ("compare a.toml b.toml --exposure.gain 4", "gain_db is 20 log10 of a gain: 12.04 for 4."),
        ("run csf --exposure.ISO 800", "Did you mean --exposure.gain-db? gain_db is 20 log10 of"),
        ("run csf --exposure.hdr", "pixel.readout.kind = 'staggered'"),
        ("explore --dry-run", "Commands with this option: run, study, compare."),
        ("run csf --quick", "Commands with this option: "),  # not --require
        ("lens phone --spp 4", "Unknown option: --spp.\nTry 'pixsim lens --help'"),
        ("run csf --pixel.prnu 0.5", "In per cent? Write prnu = 0.005."),
        ("study pixel-size --pitch.values-um 2.4 3.45", "and a list as 2.4,3.45, without spaces."),
        (
            "study pixel-size --scene star.png",
            "A picture is the chart of a scene: csf with -D chart=star.png.",
        ),
        (
            "run csf --camera.pixels 640",
            "camera.pixels: got '640'; allowed: columns and rows, as 1936x1216.",
        ),
        (
            "run csf -D f_number=4",
            "The setting with this name is camera.f_number, not a parameter of the scene.",
        ),
    ],
)
def test_refused_command_line_says_where_its_word_belongs(line: str, words: str) -> None:
    assert_refused(*command(line), [words])


# --- Completion ---


STUDIES, TECHNOLOGIES, SENSORS = (
    set(packaged(f"data/{kind}")) for kind in ("studies", "technologies", "sensors")
)
INTERPOLATIONS = {"linear", "nearest", "cubic"}


@pytest.mark.parametrize(
    ("words", "offered", "others"),
    [
        ("run", {*packaged_scenes(), "mine.xml", "folder/"}, {"mine.toml"}),
        ("study", STUDIES | {"mine.toml", "folder/"}, {"mine.xml"}),
        ("study folder/", {"folder/other.toml"}, {"mine.toml"}),
        ("study gone/", STUDIES, {"mine.toml"}),
        ("datasheet", TECHNOLOGIES | SENSORS | {"mine.toml"}, {"mine.xml"}),
        ("run csf --config", SENSORS | {"mine.toml"}, {"mine.xml"}),
        ("lens", {*packaged("data/lenses"), "mine.toml"}, {"mine.xml"}),
        ("run csf --pixel.technology", TECHNOLOGIES | {"none"}, {"mine.xml"}),
        ("run csf --display.interpolation", INTERPOLATIONS, {"mine.toml", "mine.xml", "folder/"}),
    ],
)
def test_completion_knows_files_and_choices(
    words: str, offered: set[str], others: set[str], here: Path
) -> None:
    """At the last word, which may have begun."""
    (here / "folder").mkdir()
    for name in ("mine.xml", "mine.toml", "folder/other.toml"):
        (here / name).touch()
    out = output_of("__complete", *words.split(), *([] if words.endswith("/") else [""]))
    answers = {line.split("\t")[0] for line in out.split("\x1fbegin\n", 1)[1].splitlines()}
    assert answers & (offered | others) == offered


# --- Missing folders ---


@pytest.mark.parametrize(
    ("line", "folder"),
    [
        ("run csf --config gone/far/a.toml", "gone"),
        ("run gone/scene.xml", "gone"),
        ("run gone/picture.exr", "gone"),
        ("run gone/picture.npz", "gone"),
        ("run csf -D chart=gone/a.png", "gone"),
        ("run csf --pixel.technology gone/a.toml", "gone"),
        ("run csf --pixel.quantum-efficiency gone/qe.csv", "gone"),
        ("study gone/a.toml", "gone"),
        ("study pixel-size --config here/gone/a.toml", "here/gone"),
        ("sfr gone/raw.exr", "gone"),
        ("datasheet gone/a.toml", "gone"),
        ("chart csf --width 16 --height 16 -o gone/a.exr", "gone"),
        ("chart gone/a.png -o a.exr", "gone"),
        ("template sensor -o gone/far/a.toml", "gone"),
    ],
)
def test_command_missing_folder_is_named(line: str, folder: str, here: Path) -> None:
    (here / "here").mkdir()
    assert_refused(*command(line), [f"folder '{folder}' does not exist"])


# --- Every option of a command has its Python form: an argument of the same name of the function of
# the command's name
# ---------------------------------------------------------------------------------------------------

# Command -> its function, and the record whose fields it takes as further keywords.
FUNCTIONS: dict[str, tuple[Callable, type[BaseModel] | None]] = {
    "run": (pixsim.run, Run),
    "study": (pixsim.study, pixsim.Study),
    "compare": (pixsim.compare, pixsim.Study),
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
    missing = {
        option for option in options_of(command) - names if RENAMED.get(option) not in names
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
    assert {*RENAMED, *FOR_THE_TERMINAL} <= set().union(*map(options_of, FUNCTIONS))
