"""Templates and schemas agree with the records."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from helpers.commands import command
from pydantic import BaseModel

import pixsim
from pixsim.base.records import restated_by
from pixsim.base.toml import packaged, read_toml
from pixsim.base.units import UNITS, unit_of
from pixsim.cli import options
from pixsim.report.templates import allowed, json_schema, template
from pixsim.sensor.motion_options import VELOCITIES
from pixsim.sensor.pixel_options import DATA_SHEET, STANDS_FOR, excluded_by
from pixsim.sensor.spread import sheet_uncertainty
from pixsim.studies.settings import Study
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.setting import Run

RECORDS = {"sensor": Run, "study": Study}


def uncommented(text: str) -> dict[str, Any]:
    """The table of a template with all commented fields set."""
    return tomllib.loads(re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE))


def stated_once(table: dict[str, Any], words: bool) -> dict[str, Any]:
    """A table whose [pixel] has either other words, the first of those for a quantity, or the
    fields that they stand for.

    Of the fields of [develop], [motion] and [display] that exclude each other it has the first or
    the last.
    """
    motion = {name: value for name, value in table["motion"].items() if name not in VELOCITIES}
    velocity = VELOCITIES[-1 if words else 0]
    motion[velocity] = table["motion"][velocity]
    white = "white_cd_per_m2" if words else "white"
    display = {
        name: value
        for name, value in table["display"].items()
        if name not in restated_by(Display, [white])
    }
    develop: dict[str, Any] = {}
    for name in sorted(table["develop"], reverse=words):
        if not restated_by(Develop, [name]) & develop.keys():
            develop[name] = table["develop"][name]
    kept: dict[str, Any] = {}
    for name in sorted(table["pixel"], key=lambda name: (name in STANDS_FOR) != words):
        if not excluded_by([name]) & kept.keys():
            kept[name] = table["pixel"][name]
    return table | {"pixel": kept, "develop": develop, "motion": motion, "display": display}


def dotted(table: dict[str, Any], record: type[BaseModel], path: str = "") -> set[str]:
    """Dotted names of the fields of a table; all fields of an inner record if the table does not
    list them.
    """
    names = set()
    for name, value in table.items():
        kind = record.model_fields[name].annotation
        inner = isinstance(kind, type) and issubclass(kind, BaseModel)
        names |= (
            dotted(value if isinstance(value, dict) else kind.model_fields, kind, f"{path}{name}.")
            if inner
            else {path + name}
        )
    return names


@pytest.mark.parametrize("kind", RECORDS)
def test_template_has_every_field_and_is_valid(kind: str) -> None:
    text = template(kind)
    record = RECORDS[kind]
    assert dotted(uncommented(text), record) == dotted(record.model_fields, record)
    record.model_validate(tomllib.loads(text))
    everything = uncommented(text)
    for words in (False, True):
        record.model_validate(stated_once(everything, words))
    with pytest.raises(
        ValueError, match=r"saturation_capacity_e and full_well_e state the same quantity"
    ):
        record.model_validate(everything)


@pytest.mark.parametrize("kind", RECORDS)
def test_template_describes_every_field(kind: str) -> None:
    lines = template(kind).splitlines()
    for number, line in enumerate(lines):
        if re.match(r"(# )?\w+ = ", line):
            assert lines[number - 1].startswith("##"), line
    text = template(kind).replace("\n##   ", " ")  # comments of several lines as one
    assert "## standard deviation of the gain over its mean (PRNU); 0 to 0.3; optional\n" in text
    assert "## dark current of one pixel; in electrons per second; 0 to 1e+18; optional\n" in text
    assert (
        'a voltage swing of 1 V; "mosis", "paper"; default "mosis"\n# capacitance = "mosis"\n'
        in text
    )


def test_template_shows_defaults_of_record() -> None:
    """A commented field shows the default of its record."""
    text = template("study")
    shown = re.sub(r"^(\w+ = )", r"# \1", text, flags=re.MULTILINE).replace("# ", "")
    assert shown != text
    for line in ("# repeats", "# count"):
        assert line not in text, "commented out"
    table = uncommented(text)
    defaults = Study(name="x").model_dump(mode="json")
    for path in (
        "seed",
        "max_repeats",
        "iso_delta_e",
        "paper",
        "display.gamma",
        "display.dots",
        "exposure.well_target",
    ):
        value, default = table, defaults
        for part in path.split("."):
            value, default = value[part], default[part]
        assert value == default, path


def test_template_sensor_is_data_sheet(tmp_path: Path) -> None:
    path = tmp_path / "my_sensor.toml"
    command("template sensor -o", path)
    settings = options.SceneOptions([path]).settings()
    assert settings.pixel.technology == "none"
    assert all(getattr(settings.pixel, name) is not None for name in DATA_SHEET)
    physics = pixsim.derive(settings.pixel)
    assert (physics.reset_noise_e, physics.offset_fpn_e, physics.fill_factor) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", RECORDS)
def test_json_schema_agrees_with_record(kind: str) -> None:
    schema = json_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    everything = uncommented(template(kind))
    assert not list(check.iter_errors(everything))
    wrong: dict[str, Any] = {
        "pixel": {"bits": 99},
        "display": {"gama": 2.2},
        "camera": {"f_number": -1.0},
    }
    for table, values in wrong.items():
        assert list(check.iter_errors(everything | {table: everything[table] | values})), table
    assert set(schema["properties"]) - {"base"} == set(
        RECORDS[kind].model_fields
    )  # a base is read with the file


def test_uncertainty_of_sensor_is_a_table_of_the_file(tmp_path: Path) -> None:
    """The template's example and the schema agree with what is read."""
    text = (
        template("sensor")
        .replace("\n##   [pixel.u", "\n[pixel.u")
        .replace("\n##   read", "\nread")
        .replace("\n##   full", "\nfull")
    )
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    assert {
        name: spread.kind for name, spread in sheet_uncertainty(tmp_path / "mine.toml").items()
    } == dict.fromkeys(("read_noise_e", "full_well_e"), "normal")
    check = jsonschema.Draft202012Validator(json_schema("sensor"))
    table = tomllib.loads(text)
    assert not list(check.iter_errors(table))
    for wrong in (
        {"bits": {"sd": 1}},
        {"prnu": {"sdd": 1}},
        {"prnu": {"sd": -1}},
        {"prnu": 0.1},
        {"prnu": {"range": [1]}},
    ):
        assert list(
            check.iter_errors(table | {"pixel": table["pixel"] | {"uncertainty": wrong}})
        ), wrong


def test_json_schema_accepts_packaged_studies() -> None:
    check = jsonschema.Draft202012Validator(json_schema("study"))
    for name, path in packaged("data/studies").items():
        assert not list(check.iter_errors(read_toml(path))), name


def test_unit_of_follows_name() -> None:
    assert unit_of("dark_current_e_per_s") == "electrons per second"
    assert unit_of("full_well_e") == "electrons"
    assert unit_of("white_cd_per_m2") == "cd/m²"
    assert unit_of("max_seconds") == "s"
    assert unit_of("tolerance_e") == unit_of("delta_e") == unit_of("bits") == ""
    names = {
        path.rpartition(".")[2]
        for record in RECORDS.values()
        for path in dotted(record.model_fields, record)
    }
    with_unit = {
        name
        for name in names
        if re.search(r"_(um|mm|nm|m|s|e|k|dn|cd_per_m2|e_per_s|per_deg|seconds)$", name)
    }
    assert {name for name in with_unit if not unit_of(name)} == {"tolerance_e", "delta_e"}
    assert UNITS["_e"] == "electrons"


def test_allowed_states_range() -> None:
    properties = json_schema("sensor")["$defs"]["Pixel"]["properties"]
    assert allowed(properties["bits"]) == "integer, 1 to 24"
    assert allowed(properties["prnu"]) == "0 to 0.3"
    assert allowed(properties["fill_factor"]) == "1e-12 to 1"
    assert allowed(properties["well_limit"]) == '"swing", "diode"'


def test_template_command_writes_template(tmp_path: Path) -> None:
    assert command("template study") == (0, template("study"), "")
    assert json.loads(command("schema study")[1]) == json_schema("study")
    code, out, _ = command("template study --json -o", tmp_path / "my study.toml")
    assert (code, json.loads(out)["file"]) == (0, str(tmp_path / "my study.toml"))
