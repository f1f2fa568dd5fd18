"""What a user can turn: controls from the declarations of fields, presets, and the words of a
command with the same settings.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

from pixsim.base.errors import invalid
from pixsim.base.layers import nested
from pixsim.base.toml import packaged
from pixsim.base.units import UNITS, unit_of
from pixsim.light.quantities import EMITTER_SCALE, ILLUMINANCE, LUMINANCE
from pixsim.sensor.camera_data import camera_names
from pixsim.sensor.pixel_options import NUMBERS
from pixsim.viewer.merging import merge
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import packaged_sensors, settings_layer

# Settings that a designer turns; what this version does not have is left out.
PITCH = "pixel.pitch_um"
CONTROLLED_FIELDS = (
    PITCH,
    "pixel.read_noise_e",
    "camera.f_number",
    "exposure.integration_s",
    "exposure.max_integration_s",
    "exposure.gain_db",
    "develop.denoise",
    "develop.denoise_strength",
    "motion.image_um_per_s",
    "display.samples_per_deg",
)
# Tables that two sensors share, so that both see and show the same.
_SHARED_TABLES = ("scene", "camera", "lens", "display")
LENS = "lens.file"
NO_LENS = "thin lens"
# Labels of fields whose names are not a designer's words.
_LABELS = {
    "pitch": "pixel size",
    "f number": "f-number",
    "image": "motion of the image",
    "integration": "exposure time",
    "max integration": "longest exposure time",
    "": "viewing distance, as dots",
}


@dataclass(frozen=True)
class Control:
    """A field that can be turned, by its dotted name, with its bounds or choices; of a `pair` of
    numbers, the first is turned.
    """

    path: str
    label: str
    unit: str = ""
    help: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    pair: bool = False

    @property
    def is_shared(self) -> bool:
        """Whether two sensors have the same value."""
        return self.path.partition(".")[0] in _SHARED_TABLES

    def value(self, sent: object) -> object:
        """Return the value of the field for a value that a page sent.

        Raises PixsimError for a value that is no number, or none of the choices.
        """
        if self.choices:
            if sent not in self.choices:
                raise invalid(self.path, repr(sent)[:80], ", ".join(self.choices))
            return None if sent == NO_LENS else sent
        if isinstance(sent, bool) or not isinstance(sent, int | float):
            raise invalid(self.path, repr(sent)[:80], "a number")
        return [float(sent), 0.0] if self.pair else float(sent)

    def page_value(self, value: object) -> object:
        """Return the value that a page shows for a value of the field; none for a word in place of
        a number.
        """
        if self.minimum is not None and isinstance(value, str):
            return None
        return value[0] if self.pair and isinstance(value, list | tuple) else value


def controls_of(parameters: Collection[str], lenses: Sequence[str]) -> list[Control]:
    """Return the controls of a scene with these parameters, and of the lenses; light in memory has
    neither.
    """
    schema = Run.model_json_schema()
    controls = [
        control
        for path in CONTROLLED_FIELDS
        if (control := _field_control(schema, path)) is not None
    ]
    if lenses:
        words = "real lens in place of the thin one, whose f-number is then not used"
        controls.insert(3, Control(LENS, "lens", help=words, choices=tuple(lenses)))
    if ILLUMINANCE in parameters:
        controls.insert(
            2,
            Control(
                f"scene.parameters.{ILLUMINANCE}",
                "illuminance",
                "lx",
                "on the scene's part or place, where white (reflectance 1) has lux/π cd/m²",
                1e-9,
                1e9,
            ),
        )
    elif EMITTER_SCALE in parameters:
        words = "of the chart's white; the display's white follows it, unless it is set"
        path = f"scene.parameters.{LUMINANCE}"
        controls.insert(2, Control(path, "luminance", unit_of(LUMINANCE), words, 1e-12, 1e15))
    return controls


def _field_control(schema: Mapping[str, Any], path: str) -> Control | None:
    """Return the control of a field of `Run` from its JSON schema, or None for an unknown field."""
    table, _, name = path.partition(".")
    record_name = schema["properties"].get(table, {}).get("$ref", "").rpartition("/")[2]
    declared = schema["$defs"].get(record_name, {}).get("properties", {}).get(name)
    if declared is None:
        return None

    # The alternatives of the field without null, and the numbers of a pair one by one.
    kinds = [kind for kind in declared.get("anyOf", [declared]) if kind.get("type") != "null"]
    choices: list[str] = []
    numbers: list[Mapping[str, Any]] = []
    is_pair = any(kind.get("type") == "array" for kind in kinds)
    for kind in kinds:
        choices += kind.get("enum", ())
        choices += [kind["const"]] if "const" in kind else []
        numbers += kind.get("prefixItems", [kind]) if is_pair else [kind]

    has_range = any("minimum" in number for number in numbers)
    unit = unit_of(name)
    ending = next((end for end in UNITS if name.endswith(end)), "") if unit else ""
    label = name.removesuffix(ending).replace("_", " ")
    return Control(
        path=path,
        label=_LABELS.get(label, label),
        unit=unit,
        help=declared.get("description", ""),
        minimum=next((number["minimum"] for number in numbers if "minimum" in number), None),
        maximum=next((number["maximum"] for number in numbers if "maximum" in number), None),
        choices=() if has_range else tuple(choices),
        pair=is_pair,
    )


class Preset(NamedTuple):
    """Settings to start from: files, and options over them.

    group, name : labels, for a list of presets
    """

    group: str
    name: str
    config: tuple[Path, ...]
    tables: Mapping[str, Any]


def presets_of(
    config: Sequence[Path], tables: Mapping[str, Any], scene: Mapping[str, Any]
) -> list[Preset]:
    """Return the presets: first the files and options of the user, then what pixsim packages.

    Of several files with a sensor's [pixel], each is a preset; the other files hold for all.

    scene : of the user's files and options together, which all presets see
    """
    sensors = [path for path in config if "pixel" in settings_layer(path).table]
    presets = [Preset("start", "as given", tuple(config), tables)]
    tables = {**tables, "scene": scene}
    if len(sensors) > 1:
        presets = [
            Preset(
                "files",
                sensor.name,
                tuple(path for path in config if path == sensor or path not in sensors),
                tables,
            )
            for sensor in sensors
        ]
    # A run with a data sheet alone would be shown on the dots of its pixels: all have one display,
    # and a picture comes soon.
    options = {name: table for name, table in tables.items() if name != "pixel"}
    others = merge({"display": {"dots": Run().display.dots}}, options)
    pixels = [
        ("technologies", name, {"technology": name}) for name in packaged("data/technologies")
    ]
    pixels += [
        ("sensors", name, settings_layer(name).table["pixel"]) for name in packaged_sensors()
    ]
    colours = {name: NUMBERS["colour"].example | {"sensitivities": name} for name in camera_names()}
    pixels += [
        ("colours of cameras", name.replace("_", " "), {"colour": colour})
        for name, colour in colours.items()
    ]
    return presets + [
        Preset(group, name, (), {**others, "pixel": pixel}) for group, name, pixel in pixels
    ]


def with_values(tables: Mapping[str, Any], values: Mapping[str, object]) -> dict[str, Any]:
    """Return tables with the values of dotted fields over them; a value of None changes nothing."""
    overrides = (
        nested(path.split("."), value) for path, value in values.items() if value is not None
    )
    return reduce(merge, overrides, dict(tables))


def command_words(
    config: Sequence[Path], tables: Mapping[str, Any], repeats: int, flags: Sequence[str]
) -> str:
    """Return the command `pixsim run` with these settings files, options and further words, for a
    shell.

    tables : which state the scene, unless a file does
    """
    file = tables.get("scene", {}).get("file")
    words = ["pixsim", "run", *([] if file is None else [str(file)])]
    for path in config:
        words += ["--config", str(path)]
    words += [*flags, *_options(tables)]
    if repeats > 1:
        words += ["--repeats", str(repeats)]
    return shlex.join(words)


def _options(tables: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the options of a command that set tables of settings.

    above : names of the tables that contain these
    """
    for name, value in tables.items():
        path = (*above, name)
        if path == ("scene", "file"):
            continue  # SCENE of the command
        if isinstance(value, Mapping) and path != ("scene", "parameters"):
            yield from _options(value, path)
        elif isinstance(value, Mapping):
            yield from (
                word for parameter, text in value.items() for word in ("-D", f"{parameter}={text}")
            )
        elif path == ("metrics",):
            yield from (word for metric in value for word in ("--metrics", metric))
        else:
            option = "window" if path == ("window_mm",) else ".".join(path).replace("_", "-")
            text = ",".join(map(str, value)) if isinstance(value, list | tuple) else value
            yield f"--{option}={text}"
