"""Commented configuration files with every field, its unit, default and allowed range; made from the records themselves."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from pixsim.base.errors import invalid
from pixsim.base.parameters import DATA_SHEET, Record, Run, Study

KINDS: dict[str, type[Record]] = {"sensor": Run, "study": Study}
WIDTH = 110
# By the end of a name, the longest first.
UNITS = {
    "_cd_per_m2": "cd/m²",
    "_e_per_s": "electrons per second",
    "samples_per_deg": "display dots per degree",
    "_delta_e": "ΔE",
    "_seconds": "s",
    "_ci_um": "µm",
    "_dn": "DN",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_m": "m",
    "_s": "s",
    "_k": "kelvin",
    "_e": "electrons",
}
NO_UNIT = ("tolerance_e", "delta_e")  # a relative error, and the name of a formula
# Fields that are open unless said otherwise need a value to show; these are plausible ones.
EXAMPLES: dict[str, Any] = {
    "name": "my-study",
    "title": "How small should my pixel be?",
    "technologies": ["0.35um", "4t-bsi"],
    "process": {"0.35um": {"dark_current_na_per_cm2": 3.0}},
    "values_um": [4.0, 5.0, 6.0, 8.0, 12.0],
    "tolerance_delta_e": 0.01,
    "target_ci_um": 0.1,
    "max_evaluations": 1000,
    "focal_length_mm": 3.86,
    "f_number": 2.8,
    "die_mm": 2.7136,
    "object_distance_m": 1.0,
    "transmittance": 0.95,
    "pitch_um": 3.75,
    "data_sheet_pitch_um": 3.75,
    "min_um": 2.0,
    "full_well_e": 10500.0,
    "read_noise_e": 2.3,
    "dark_current_e_per_s": 3.0,
    "quantum_efficiency": 0.62,
    "bits": 12,
    "prnu": 0.005,
    "dsnu": 0.2,
    "infrared_cut_nm": 650.0,
    "fill_factor": 0.8,
    "reset_noise_factor": 0.0,
    "offset_fpn": 0.0002,
    "column_fpn": 0.0001,
    "integration_s": 0.02,
    "white_cd_per_m2": 1000.0,
    "parameters": {"resolution": 512},
    "scene": {"resolution": 512},
    "detail": [0.8, 0.9],
    "sources": {"pixel.bits": "data sheet, page 3"},
    "quick": {"repeats": 4},
}
# What is not commented out: what a sensor or a study is about.
SENSOR_SHOWN = tuple(f"pixel.{name}" for name in ("pitch_um", *DATA_SHEET, "bits", "prnu", "dsnu"))
STUDY_SHOWN = (
    *("name", "title", "technologies", "repeats"),
    *("pitch.count", "pitch.max_um", "pitch.min_fill_factor", "scene.file", "camera.f_number", "display.white_cd_per_m2"),
)
SENSOR_HEAD = """
A sensor from its data sheet, for `pixsim run csf --config THIS_FILE` and `pixsim datasheet THIS_FILE`. The numbers below are
examples: replace them with yours. Lines with one # are at their defaults, or open; remove the # to set them.
Without a technology nothing is derived: the first lines of [pixel] are then all needed.
"""
STUDY_HEAD = """
A study of pixel sizes, for `pixsim study THIS_FILE`. The numbers below are examples: replace them with yours. Lines with one
# are at their defaults, or open; remove the # to set them.
"""


def template(kind: str) -> str:
    """A TOML file with every field of a sensor's or a study's settings. PixsimError for another kind."""
    schema = json_schema(kind)
    head, shown = (SENSOR_HEAD, SENSOR_SHOWN) if kind == "sensor" else (STUDY_HEAD, STUDY_SHOWN)
    lines = [f"# {line}" for line in head.strip().splitlines()]
    tables = {name: each for name, each in schema["properties"].items() if "$ref" in each}
    rooms = ["pixel", *(name for name in tables if name != "pixel")] if kind == "sensor" else list(tables)
    top = {name: each for name, each in schema["properties"].items() if name not in tables}
    lines += ["", *_fields(top, shown, "")]
    for name in rooms:
        record = schema["$defs"][tables[name]["$ref"].rpartition("/")[2]]
        dotted = [f"{name}.{key}" for key in record["properties"]]
        order = [key for key in shown if key in dotted] + [key for key in dotted if key not in shown]
        own = {key.partition(".")[2]: record["properties"][key.partition(".")[2]] for key in order}
        lines += ["", f"[{name}]", *_fields(own, shown, f"{name}.")]
    return "\n".join(lines) + "\n"


def json_schema(kind: str) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of such a file, for editors. PixsimError for another kind."""
    if kind not in KINDS:
        raise invalid("kind", f"'{kind}'", " or ".join(KINDS))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **KINDS[kind].model_json_schema()}


def _fields(properties: dict[str, Any], shown: tuple[str, ...], table: str) -> Iterator[str]:
    for name, each in properties.items():
        set_here = table + name in shown
        value = each.get("default", {} if each.get("type") == "object" else ...)
        is_open = value in (None, "", {})
        default = "needed" if value is ... else "open" if is_open else f"default {toml_value(value)}"
        told = [each.get("description", ""), unit_of(name), allowed(each), default]
        yield from textwrap.wrap("; ".join(part for part in told if part), WIDTH, initial_indent="## ", subsequent_indent="##   ")
        if name in EXAMPLES and (set_here or is_open or value is ...):
            value = EXAMPLES[name]
        yield ("" if set_here else "# ") + f"{name} = {toml_value(value)}"


def unit_of(name: str) -> str:
    """The unit that a name ends in, in words."""
    return "" if name in NO_UNIT else next((f"in {unit}" for end, unit in UNITS.items() if name.endswith(end)), "")


def allowed(each: dict[str, Any]) -> str:
    """A field's range or choices, in words, from its JSON schema."""
    if "anyOf" in each:
        return " or ".join(dict.fromkeys(filter(None, map(allowed, each["anyOf"]))))
    if "enum" in each or "const" in each:
        return ", ".join(toml_value(value) for value in each.get("enum", [each.get("const")]))
    kind = each.get("type")
    if kind in ("number", "integer"):
        low, above = each.get("minimum"), each.get("exclusiveMinimum")
        high, below = each.get("maximum"), each.get("exclusiveMaximum")
        start = f"{number(low)} " if low is not None else f"above {number(above)} " if above is not None else ""
        end = f"to {number(high)}" if high is not None else f"to below {number(below)}" if below is not None else "and more"
        return f"{'whole numbers, ' if kind == 'integer' else ''}{start}{end}"
    return {"array": "a list", "boolean": "true or false"}.get(str(kind), "")


def number(value: float) -> str:
    """Whole numbers in full, as long as they can be read."""
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else f"{value:g}"


def toml_value(value: Any) -> str:
    """A value as TOML writes it; JSON's text is the same but for tables."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, float) and value == int(value) and abs(value) < 1e16:
        return f"{value:.1f}"
    return json.dumps(value, ensure_ascii=False)
