"""Commented configuration files with every field, its unit, range and default, generated from the
records.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import write_new
from pixsim.base.records import Record
from pixsim.base.toml import packaged
from pixsim.base.units import unit_of
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel_options import DATA_SHEET, NUMBERS
from pixsim.sensor.spread import MAY_BE_UNCERTAIN, Spread
from pixsim.show.document import Document
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run

KINDS: dict[str, type[Record]] = {"sensor": Run, "study": Study}
WIDTH = 110
# Plausible values for fields without a default, by name or by table and name; those of [pixel]
# stand in its record.
_EXAMPLES: dict[str, Any] = Camera().model_dump() | {
    "require": ["delta_e<=1"],
    "name": "my-study",
    "streams": "chen2000",
    "title": "How small should my pixel be?",
    "technologies": ["0.35um", "4t-bsi"],
    "process": {"0.35um": {"dark_current_na_per_cm2": 3.0}},
    "values_um": [4.0, 5.0, 6.0, 8.0, 12.0],
    "pitch_um": 3.75,
    "min_um": 2.0,
    "own_um": 3.75,
    "window_mm": 1.0,
    "registration": [0.0, 0.5],
    "tolerance_delta_e": 0.01,
    "render_noise": 0.2,
    "target_ci_um": 0.1,
    "max_evaluations": 1000,
    "max_seconds": 60.0,
    "resolution": 1024,
    "die_height_mm": 2.4,
    "pixels": [640, 640],
    "die_mm": 2.4,
    "f_number": 2.8,
    "chief_ray_angle": [[0.0, 0.0], [1.0, 16.0], [2.0, 30.0]],
    "integration_s": 0.02,
    "line_time_us": 20.0,
    "flicker_hz": 100.0,
    "flicker_depth": 0.4,
    "flicker_phase_deg": 90.0,
    "velocity_mm_per_s": [10.0, 0.0],
    "image_um_per_s": [50.0, 0.0],
    "pixels_per_s": [20.0, 0.0],
    "distance_m": 1.0,
    "margin_um": 20.0,
    "demosaic": "bilinear",
    "sharpen_radius_px": 1.0,
    "sharpen_radius_cy_per_deg": 4.0,
    "corner_cy_per_mm": 0.4,
    "ground_distance_m": 500e3,
    "solve_for": "contrast",
    "white_cd_per_m2": 1000.0,
    "white_w_per_m2_sr": 2.0,
    "white": "diffuser",
    "lens.file": "phone",
    "focus_nm": 650.0,
    "configuration": 1,
    "veiling_glare": 0.01,
    "veiling_glare_outside": 1.0,
    "relative_illumination": [[0.0, 1.0], [1.0, 0.9], [2.0, 0.7]],
    "vignetting_factors": "use",
    "parameters": {"resolution": 512},
    "scene.file": "csf",
    "detail": [0.8, 0.9],
    "sensors": {"my_sensor.toml": {"pitch_um": 3.75, "technology": "4t-bsi"}},
    "sources": {"pixel.bits": "data sheet, page 3"},
}
# Fields that are not commented out.
_SENSOR_FIELDS = tuple(
    f"pixel.{name}"
    for name in ("pitch_um", *DATA_SHEET, "quantum_efficiency_nm", "bits", "prnu", "dsnu")
)
_STUDY_FIELDS = (
    "name",
    "title",
    "technologies",
    "repeats",
    "pitch.count",
    "pitch.max_um",
    "pitch.min_fill_factor",
    "scene.file",
    "camera.f_number",
    "display.white_cd_per_m2",
)
_SENSOR_HEAD = (
    "A sensor from its data sheet, for `pixsim run csf --config THIS_FILE` and `pixsim datasheet"
    " THIS_FILE`. The numbers below are examples: replace them with yours. Lines with one # show"
    " defaults, or examples of optional values; remove the # to set them. With pitch_um,"
    " full_well_e, read_noise_e, dark_current_e_per_s and quantum_efficiency (or the words of EMVA"
    " 1288 for them) no technology is needed; if one of them is missing, it comes from a"
    " technology, by default 0.35um."
)
_STUDY_HEAD = (
    "A study of pixel sizes, for `pixsim study THIS_FILE`. The numbers below are examples: replace"
    " them with yours. Lines with one # show defaults, or examples of optional values; remove the #"
    " to set them. Optional values of [pixel] come from the technology."
)
_UNCERTAINTY = (
    "how far numbers of the data sheet may be wrong, each by its standard deviation or its range;"
    " frames do not depend on it"
)
_UNCERTAINTY_EXAMPLE = """
##   [pixel.uncertainty]
##   read_noise_e = { sd = 0.2 }
##   full_well_e = { range = [10000, 11000], distribution = "normal" }"""


def template(kind: str) -> str:
    """Return a TOML file with every field of the settings of a sensor or a study. Raises
    PixsimError for another kind.
    """
    schema = record_of(kind).model_json_schema()
    is_sensor = kind == "sensor"
    head = _SENSOR_HEAD if is_sensor else _STUDY_HEAD
    uncommented = _SENSOR_FIELDS if is_sensor else _STUDY_FIELDS
    lines = textwrap.wrap(head, WIDTH, initial_indent="# ", subsequent_indent="# ")

    # Fields above all tables, then the tables; a sensor's file begins with its pixel.
    properties = schema["properties"]
    tables = {name: field for name, field in properties.items() if "$ref" in field}
    top = {name: field for name, field in properties.items() if name not in tables}
    lines += ["", *_fields(top, uncommented, "")]
    names = list(tables)
    if is_sensor:
        names.remove("pixel")
        names.insert(0, "pixel")
    for name in names:
        lines += _table_lines(schema, name, tables[name], uncommented)
        if is_sensor and name == "pixel":
            lines.append(f"## {_UNCERTAINTY}:{_UNCERTAINTY_EXAMPLE}")
    return "\n".join(lines) + "\n"


def _table_lines(
    schema: dict[str, Any], name: str, reference: dict[str, Any], uncommented: tuple[str, ...]
) -> Iterator[str]:
    """Yield the lines of a table and of the tables in it, fields that are not commented out first.

    schema : of the whole file
    reference : to the schema of the table
    """
    properties = _definition(schema, reference)["properties"]
    inner_tables = {key: field for key, field in properties.items() if "$ref" in field}
    first_keys = []
    for dotted in uncommented:
        key = dotted.removeprefix(f"{name}.")
        if key in properties and key != dotted:
            first_keys.append(key)
    fields = {key: properties[key] for key in [*first_keys, *properties] if key not in inner_tables}

    if fields:
        yield from ("", f"[{name}]", *_fields(fields, uncommented, f"{name}."))
    for key, inner_reference in inner_tables.items():
        inner = _definition(schema, inner_reference)["properties"]
        yield from ("", f"[{name}.{key}]", *_fields(inner, uncommented, f"{name}.{key}."))


def _definition(schema: dict[str, Any], reference: dict[str, Any]) -> dict[str, Any]:
    """Return the schema that a reference in another schema names."""
    definition: dict[str, Any] = schema["$defs"][reference["$ref"].rpartition("/")[2]]
    return definition


def template_document(kind: str, of: str | None, output: Path | None) -> Document:
    """Return the answer of `pixsim template`, with the text itself unless it is written to a file.

    kind : sensor or study
    of : name of a packaged study, which is copied

    Raises PixsimError for another kind or study, and if the file exists or cannot be written.
    """
    if of is not None and kind != "study":
        raise invalid(
            "--of", f"'{of}' with {kind}", "a packaged study, with `pixsim template study`"
        )
    text = template(kind) if of is None else _packaged_study(of)
    if output is None:
        return Document("template", "template", kind, {"template": text}, (text.rstrip(),))

    if output.suffix != ".toml":
        raise invalid("--output", f"'{output}'", "a name that ends in .toml")
    write_new(output, text)
    use = f"pixsim run csf --config {output}" if kind == "sensor" else f"pixsim study {output}"
    line = f"{output} written. Replace the numbers, then run: {use}"
    return Document("template", "template", kind, {"file": str(output), "use": use}, (line,))


def _packaged_study(name: str) -> str:
    """Return the TOML file of a packaged study, to be edited. Raises PixsimError for another
    name.
    """
    studies = packaged("data/studies")
    if name not in studies:
        raise invalid("--of", f"'{name}'", ", ".join(studies), did_you_mean(name, studies))
    head = (
        f"# A copy of the packaged study {name}. Change its name with its values: the random"
        " streams depend on the name."
    )
    return f"{head}\n{studies[name].read_text(encoding='utf-8')}"


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a settings file, for editors. Raises PixsimError
    for another kind.
    """
    schema = record_of(kind).model_json_schema()
    if kind == "sensor":  # a file has more than the pixel, which is plain numbers
        schema["$defs"]["Spread"] = Spread.model_json_schema()
        schema["$defs"]["Pixel"]["properties"]["uncertainty"] = {
            "type": "object",
            "description": _UNCERTAINTY,
            "propertyNames": {"enum": list(MAY_BE_UNCERTAIN)},
            "additionalProperties": {"$ref": "#/$defs/Spread"},
        }
        # parameters may stand in [scene] itself
        scene = schema["$defs"]["RunScene"]
        scene["additionalProperties"] = scene["properties"]["parameters"]["additionalProperties"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def record_of(kind: str) -> type[Record]:
    """Return the record of a kind of settings file. Raises PixsimError for another kind."""
    if kind not in KINDS:
        raise invalid("kind", f"'{kind}'", " or ".join(KINDS))
    return KINDS[kind]


def _fields(properties: dict[str, Any], uncommented: tuple[str, ...], table: str) -> Iterator[str]:
    """Yield a comment with description, unit, range and default, then the field itself, for each
    field.
    """
    for name, field in properties.items():
        is_set = table + name in uncommented
        value = field.get("default", {} if field.get("type") == "object" else ...)
        is_required = value is ...
        is_optional = value in (None, "", {})
        default = "optional"
        if is_required:
            default = "required"
        elif not is_optional:
            default = f"default {toml_value(value)}"

        unit = unit_of(name) and f"in {unit_of(name)}"
        parts = [field.get("description", ""), unit, allowed(field), default]
        comment = "; ".join(filter(None, parts))
        yield from textwrap.wrap(comment, WIDTH, initial_indent="## ", subsequent_indent="##   ")

        example = _EXAMPLES.get(table + name, _EXAMPLES.get(name))
        if table == "pixel." and name in NUMBERS:
            example = NUMBERS[name].example
        if example is not None and (is_set or is_optional or is_required):
            value = example
        yield ("" if is_set else "# ") + f"{name} = {toml_value(value)}"


def allowed(field: dict[str, Any]) -> str:
    """Return the range or the choices of a field, in words, from its JSON schema."""
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(filter(None, map(allowed, field["anyOf"]))))
    if "enum" in field or "const" in field:
        return ", ".join(toml_value(value) for value in field.get("enum", [field.get("const")]))

    kind = field.get("type")
    if kind not in ("number", "integer"):
        return {"array": "a list", "boolean": "true or false"}.get(str(kind), "")

    if "minimum" in field:
        start = f"{field['minimum']:.9g}"
    else:
        start = f"above {field['exclusiveMinimum']:.9g}"
    if "maximum" in field:
        end = f"{field['maximum']:.9g}"
    else:
        end = f"below {field['exclusiveMaximum']:.9g}"
    return f"{'integer, ' if kind == 'integer' else ''}{start} to {end}"


def toml_value(value: object) -> str:
    """Return a value in TOML, which differs from JSON for tables only."""
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f"{json.dumps(key)} = {toml_value(inner)}" for key, inner in value.items())
            + " }"
        )
    if isinstance(value, float) and value == int(value) and abs(value) < 1e16:
        return f"{value:.1f}"
    return json.dumps(value, ensure_ascii=False)
