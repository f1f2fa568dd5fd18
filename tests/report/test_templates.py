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
from pixsim.base.toml import packaged, read_toml
from pixsim.cli import options
from pixsim.report.templates import json_schema, template
from pixsim.sensor.pixel_options import DATA_SHEET
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run

RECORDS = {"sensor": Run, "study": Study}


def uncommented(text: str) -> dict[str, Any]:
    """The table of a template with all commented fields set."""
    return tomllib.loads(re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE))


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


def test_template_shows_defaults_of_record() -> None:
    """A commented field shows the default of its record."""
    table = uncommented(template("study"))
    defaults = Study(name="x").model_dump(mode="json")
    for name in ("seed", "max_repeats", "iso_delta_e", "paper"):
        assert table[name] == defaults[name], name
    for name in ("gamma", "dots"):
        assert table["display"][name] == defaults["display"][name], name


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
    check = jsonschema.Draft202012Validator(schema)
    everything = uncommented(template(kind))
    assert not list(check.iter_errors(everything))
    for table, values in (
        ("pixel", {"bits": 99}),
        ("pixel", {"uncertainty": {"prnu": {"sd": -1}}}),
        ("display", {"gama": 2.2}),
        ("camera", {"f_number": -1.0}),
    ):
        assert list(check.iter_errors(everything | {table: everything[table] | values})), values
    # A base is read with the file
    assert set(schema["properties"]) - {"base"} == set(RECORDS[kind].model_fields)


@pytest.mark.parametrize("path", packaged("data/studies").values(), ids=lambda path: path.stem)
def test_json_schema_accepts_packaged_studies(path: Path) -> None:
    jsonschema.Draft202012Validator(json_schema("study")).validate(read_toml(path))


@pytest.mark.parametrize("kind", ["sensor", "study"])
def test_commands_write_template_and_schema(kind: str) -> None:
    assert command(f"template {kind}") == (0, template(kind), "")
    assert json.loads(command(f"schema {kind}")[1]) == json_schema(kind)
