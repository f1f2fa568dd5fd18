"""The help of options that are text, lists of formats, completion, and folders that are missing."""

from __future__ import annotations

import re
from copy import copy
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import pytest
from cyclopts import Argument, CoercionError, Token
from helpers.commands import assert_refused, command
from pydantic import TypeAdapter, ValidationError
from rich.console import Console

from pixsim.base.errors import PixsimError
from pixsim.base.layers import Layer
from pixsim.base.records import Record, as_list, checked
from pixsim.base.toml import packaged
from pixsim.cli.commands import app
from pixsim.cli.help import COMMON, MIN_SHORTENED
from pixsim.cli.options import choices_of, complete_study, value_name
from pixsim.optics.camera import CameraOptions
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.settings import PitchRange
from pixsim.viewer.display_options import Display
from pixsim.viewer.metric_options import Niirs
from pixsim.viewer.setting import Effort, Run

NAMES = sorted(name for name in app if not name.startswith("-"))


@cache
def shown_help(name: str, option: str = "--help-all") -> str:
    """The help of a command, which takes long for those with many options."""
    with pytest.MonkeyPatch.context() as patch:
        # Cyclopts keeps the console of its first help, with the width that the terminal had then.
        patch.setattr(app, "_console", Console(width=300))
        code, out, err = command(f"{name} {option}")
    assert code == 0, err
    return out


TABLES: list[tuple[str, type[Record]]] = [
    ("camera", CameraOptions),
    ("pixel", Pixel),
    ("exposure", Exposure),
    ("display", Display),
]


def test_run_help_shows_type_choices_and_default_of_every_field() -> None:
    text = shown_help("run")
    fields = [
        (f"{table}.{name}", info)
        for table, record in TABLES
        for name, info in record.model_fields.items()
    ]
    options = [(f"--{name.replace('_', '-')}", info) for name, info in fields]
    names = {"window_mm": "window"} | {
        name: name for name in (*Effort.model_fields, "seed") if name != "window_mm"
    }
    options += [
        (f"--{option.replace('_', '-')}", Run.model_fields[name]) for name, option in names.items()
    ]
    lines = [line for line in text.splitlines() if line.startswith("│")]
    for option, info in options:
        if any(
            isinstance(kind, type) and issubclass(kind, Record)
            for kind in get_args(info.annotation)
        ):
            assert any(line.startswith(f"│ {option}.") for line in lines), (
                "a table of options of its own"
            )
            continue
        (line,) = (line for line in lines if re.match(rf"│\*? *{re.escape(option)} ", line))
        kind = line.split(option, 1)[1].split()[0]
        assert kind == (
            "NAME|FILE" if option == "--pixel.technology" else value_name(info.annotation)
        ), option
        assert not re.match(r"STR|CHOICE", kind), option
        described = " ".join(
            part.strip("│ ") for part in text[text.index(line) :].split("│ --")[:2]
        )
        assert "[default: " in described or "absent" in described, option
        for choice in choices_of(info.annotation):
            assert choice in kind.split("|")


OPTION = re.compile(r"^│[* ]*(?:[A-Z]+ )?(--[\w.-]+)", re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_usage_common_options_and_how_to_see_all(name: str) -> None:
    """A command with many options shows a part of them, in their order, and says so; another one
    has the same help twice.

    STR says nothing of the value; every one has a name or a list of choices.
    """
    text, part = shown_help(name), shown_help(name, "-h")
    assert "Usage: pixsim" in text
    assert "--json" in text
    assert re.search(rf"pixsim {name} \S|Example", text)
    assert [line for line in text.splitlines() if re.search(r"-[\w.-]+ STR\b", line)] == []
    short, full = OPTION.findall(part), OPTION.findall(text)
    # SENSORS has no name
    line = f"`pixsim {name} --help-all` shows all {len(full) + (name == 'compare')} options.\n"
    if len(full) <= MIN_SHORTENED:
        assert short == full
        assert line not in part
        return
    assert part.endswith(line)
    assert short == [option for option in full if option in short]
    assert 8 < len(short) < MIN_SHORTENED
    assert {*short} - COMMON <= {"--PIXEL"}, "words without an option are shown, too"


def test_common_options_are_options() -> None:
    """`--help` is the same help as `-h`."""
    assert {option for name in NAMES for option in OPTION.findall(shown_help(name))} >= COMMON
    assert shown_help("lens", "--help") == shown_help("lens", "-h")


def test_options_match_fields_of_files() -> None:
    """An option --table.name-of-field has the name table.name_of_field in a file."""
    text = shown_help("run")
    options = {
        name.replace("-", "_")
        for name in re.findall(r"--((?:camera|pixel|exposure|display)\.[a-z0-9-]+)", text)
    }
    tables = {
        table: Run.model_fields[table].annotation
        for table in ("camera", "pixel", "exposure", "display")
    }
    assert options == {
        f"{table}.{name}" for table, record in tables.items() for name in record.model_fields
    }


@pytest.mark.parametrize(
    ("option", "record", "name"),
    [
        ("20000,-5", Motion, "velocity_mm_per_s"),
        ("20000,-5", Motion, "image_um_per_s"),
        ("20000 -5", Motion, "pixels_per_s"),
        ("0.25,0.5", Pixel, "registration"),
        ("0.1,0.5", Niirs, "reflectances"),
    ],
)
def test_pairs_of_numbers_are_texts_of_options(
    option: str, record: type[Record], name: str
) -> None:
    """As `pixsim explore` copies them into a command, too."""
    found = getattr(record.model_validate({name: option}), name)
    assert found == tuple(map(float, option.replace(",", " ").split()))


def test_one_number_of_a_pair_is_refused_where_it_was_typed() -> None:
    """The file has both numbers; the option replaces them, and lacks one."""
    layers = [
        Layer({"velocity_mm_per_s": [300, 0]}, "belt.toml"),
        Layer({"velocity_mm_per_s": "300"}),
    ]
    with pytest.raises(PixsimError) as error:
        checked(Motion, layers)
    wanted = (
        "velocity_mm_per_s: got a list of 1; allowed: a list of at least 2: velocity [x, y] of the"
        " objects, in a plane"
    )
    assert str(error.value).startswith(wanted)


@pytest.mark.parametrize(
    ("annotation", "name"),
    [
        (float, "FLOAT"),
        (int | None, "INT"),
        (Annotated[float, "above 0"] | None, "FLOAT"),
        (Literal["a", "b"] | None, "a|b"),
        (Annotated[float, 1] | tuple[tuple[float, float], ...], "FLOAT|FILE"),
        (tuple[int, int] | None, "INTxINT"),
        (str, "TEXT"),
    ],
)
def test_value_name_of_annotation(annotation: object, name: str) -> None:
    assert value_name(annotation) == name


def options_of_several_values() -> list[tuple[str, Argument]]:
    """Every option of every command that may be repeated, with the name of the command."""
    return [
        (name, argument)
        for name in NAMES
        for argument in app[name].assemble_argument_collection()
        if argument.parse and argument.index is None and argument.token_count()[1]
    ]


SEVERAL = options_of_several_values()
OPTION_IDS = [f"{name} {argument.names[0]}" for name, argument in SEVERAL]


def kind_of_values(argument: Argument) -> Any:
    """T of list[T] | None."""
    (kind,) = (
        get_args(part)[0]
        for part in (argument.hint, *get_args(argument.hint))
        if get_origin(part) is list
    )
    return kind


def two_values(argument: Argument) -> tuple[str, str]:
    """Texts of two values that an option takes."""
    kind = kind_of_values(argument)
    if get_origin(kind) is Literal:
        return get_args(kind)[:2]
    if kind in (int, float):
        return "450", "0.5"
    metavar = str(argument.parameter.metavar)
    return ("a.b=1,2", "c=x") if "=" in metavar else ("delta_e", "user_metric")


def converted(argument: Argument, *texts: str) -> list[Any]:
    """What a command gets of an option that is given once for each text."""
    fresh = copy(argument)  # an argument keeps its first result
    fresh.tokens = [
        Token(keyword=argument.names[0], value=text, source="cli", index=index)
        for index, text in enumerate(texts)
    ]
    return list(fresh.convert())


def takes_files(argument: Argument) -> bool:
    return kind_of_values(argument) is Path or argument.parameter.metavar == "FILE"


@pytest.mark.parametrize(("name", "argument"), SEVERAL, ids=OPTION_IDS)
def test_option_of_several_values_takes_commas_but_in_names_of_files(
    name: str, argument: Argument
) -> None:
    if takes_files(argument):
        assert list(map(str, converted(argument, "a, b.toml", "c.toml"))) == [
            "a, b.toml",
            "c.toml",
        ], name
        return
    first, second = two_values(argument)
    repeated = converted(argument, first, second)
    assert len(repeated) == 2
    assert converted(argument, f"{first},{second}") == repeated
    assert [str(value).strip() for value in converted(argument, f"{first}, {second}")] == list(
        map(str, repeated)
    )
    assert converted(argument, f"{first},{second}", first) == [*repeated, repeated[0]]
    if "=" in first:
        return  # a comma that stands alone is one of the value
    for text in (f"{first},,{second}", f"{first},", f",{first}", "", ","):
        with pytest.raises(
            CoercionError,
            match=re.escape(f"got '{text}'; allowed: a value on both sides of every comma"),
        ):
            converted(argument, text)


def test_options_of_several_values_are_all_there() -> None:
    """The generated list is not empty for another reason."""
    names = {argument.names[0] for _, argument in SEVERAL}
    assert names >= {
        "--metrics",
        "--raw",
        "--axis",
        "--smaller-than",
        "--wavelength-nm",
        "-D",
        "--config",
        "--glass-catalogues",
    }


def fields_of_several_values(record: type[Record], path: str) -> list[tuple[str, Any]]:
    """Dotted names and types of the fields that hold several plain values: tuples of numbers or of
    texts.
    """
    fields: list[tuple[str, Any]] = []
    for name, info in record.model_fields.items():
        kinds = [
            kind
            for kind in (info.annotation, *get_args(info.annotation))
            if isinstance(kind, type) and issubclass(kind, Record)
        ]
        for kind in kinds:
            fields += fields_of_several_values(kind, f"{path}.{name}")
        whole = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
        if (
            not kinds
            and "tuple[" in str(whole)
            and "tuple[tuple" not in str(whole)
            and "dict[" not in str(whole)
        ):
            fields.append((f"{path}.{name}".lstrip("."), whole))
    return fields


FIELDS = [
    (name, kind)
    for name, kind in [
        *fields_of_several_values(Run, ""),
        *fields_of_several_values(PitchRange, "pitch"),
    ]
    if name != "metrics"
]  # of which --metrics is an option of its own
VALUES = (["0.25", "0.5"], ["640", "480"], ["1.5", "1", "2"], ["a.agf", "b.agf"])


@pytest.mark.parametrize(("name", "kind"), FIELDS, ids=[name for name, _ in FIELDS])
def test_dotted_option_of_several_values_takes_commas(name: str, kind: Any) -> None:
    """An option is the text that its field validates."""
    field = TypeAdapter(kind)
    values = next(values for values in VALUES if is_valid(field, values))
    assert field.validate_python(",".join(values)) == field.validate_python(values)
    assert field.validate_python(", ".join(values)) == field.validate_python(values)


def is_valid(field: TypeAdapter[Any], value: object) -> bool:
    try:
        field.validate_python(value)
    except ValidationError:
        return False
    return True


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
        (
            "run --seed 3",
            "run: got no SCENE; allowed: An XML file, or the name of a packaged scene: csf,",
        ),
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
        ("run csf -D f_number=4", "The setting of this name is camera.f_number, beside the scene."),
    ],
)
def test_refused_command_line_says_where_its_word_belongs(line: str, words: str) -> None:
    assert_refused(*command(line), [words])


# --- Completion ---


def completed(*words: str) -> set[str]:
    """What the shell's script is told at the last word."""
    code, out, err = command("__complete", *words)
    assert code == 0, err
    return {line.split("\t")[0] for line in out.split("\x1fbegin\n", 1)[1].splitlines()}


def test_completion_knows_scenes_studies_technologies_and_choices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.xml").touch()
    (tmp_path / "mine.toml").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/other.toml").touch()
    scenes, studies, technologies = (
        set(packaged_scenes()),
        set(packaged("data/studies")),
        set(packaged("data/technologies")),
    )
    for name in ("run", "plan", "accuracy"):
        assert scenes | {"mine.xml", "folder/"} <= completed(name, "")
        assert "mine.toml" not in completed(name, "")
    assert studies | {"mine.toml", "folder/"} <= completed("study", "")
    assert "folder/other.toml" in completed("study", "folder/")
    sensors = set(packaged("data/sensors"))
    assert technologies | sensors | {"mine.toml"} <= completed("datasheet", "")
    assert sensors | {"mine.toml"} <= completed("run", "csf", "--config", "")
    assert {*packaged("data/lenses"), "mine.toml"} <= completed("lens", "")
    assert technologies | {"none"} <= completed("run", "csf", "--pixel.technology", "")
    assert completed("run", "csf", "--display.interpolation", "") == {"linear", "nearest", "cubic"}


def test_complete_study_hidden_and_missing_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Context:
        incomplete = "gone/"

    monkeypatch.chdir(tmp_path)
    assert set(complete_study(Context())) == set(packaged("data/studies"))


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
def test_command_missing_folder_is_named(
    line: str, folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    assert_refused(*command(line), [f"folder '{folder}' does not exist"])
