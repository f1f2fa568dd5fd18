"""The settings of a result as a TOML file, from which a command makes the same numbers again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pixsim.base.layers import Layer, nested
from pixsim.base.records import Record
from pixsim.base.toml import settings_table_text, whole_path
from pixsim.light.curves import AS_CURVES, as_quantum_efficiency, as_share
from pixsim.optics.chief_rays import as_chief_ray_angles, as_relative_illumination
from pixsim.sensor.spread import Uncertainty
from pixsim.studies.varied import is_case_name, setting_path
from pixsim.viewer.develop_options import as_tone_curve
from pixsim.viewer.merging import merge, merged

# Settings that name files: those whose values can stand in their place, and others.
FILES_OF_VALUES: dict[tuple[str, ...], Callable[[Any], Any]] = {
    ("pixel", "quantum_efficiency"): as_quantum_efficiency,
    ("camera", "chief_ray_angle"): as_chief_ray_angles,
    ("develop", "tone_curve"): as_tone_curve,
    ("lens", "veiling_glare"): as_share,
    ("lens", "relative_illumination"): as_relative_illumination,
    **{("pixel", "colour", name): as_curves for name, as_curves in AS_CURVES.items()},
}
WITHOUT_TARGET = ("metric", "detectability", "without")
FILES = (
    *(("scene", "file"), ("lens", "file"), ("scene", "parameters", "chart"), ("pixel", "technology"), WITHOUT_TARGET),
    *FILES_OF_VALUES,
)


def settings_text(record: Record, command: str, uncertainty: Uncertainty | None = None, **changes: object) -> str:
    """TOML file of all settings of a result, from which a command makes the same numbers again, bit for bit.

    command : that makes them, in the file's folder
    uncertainty : of `spreads_of_study`
    changes : tables and fields in place of the record's

    Values stand in it, not files; a technology or a scene with a file of its own is named by its whole path.
    """
    table = record.model_dump(mode="json", exclude_none=True) | changes
    for name, spreads in (uncertainty or {}).items():
        pixel = table.get("sensors", {}).get(name) if name else table.get("pixel")
        kept = {number: spread.model_dump(exclude_none=True) for number, spread in spreads.items() if spread.holds(pixel, number)}
        if isinstance(pixel, dict) and kept:
            pixel["uncertainty"] = kept
    if "axis" in table:
        table["axis"] = [_without_files_of_axis(axis) for axis in table["axis"]]
    for condition in table.get("condition", ()):
        condition["set"] = _without_files(condition["set"])
    if isinstance(without := table.get("metric", {}).get("detectability", {}).get("without"), str):
        table["metric"]["detectability"]["without"] = whole_path(without)
    if "file" in table.get("lens", {}):
        table["lens"]["file"] = whole_path(table["lens"]["file"])
        if catalogues := table["lens"].get("glass_catalogues"):
            table["lens"]["glass_catalogues"] = [whole_path(name) for name in catalogues]
    if "technologies" in table:
        table["technologies"] = [whole_path(name) for name in table["technologies"]]
    for by_name in ("process", "sensors"):
        if by_name in table:
            table[by_name] = {whole_path(name): values for name, values in table[by_name].items()}
    for pixel in (table.get("pixel", {}), *table.get("sensors", {}).values()):
        if "technology" in pixel:
            pixel["technology"] = whole_path(pixel["technology"])
    return settings_table_text(table, command)


def _without_files(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with values in place of the files that hold them, and the whole paths of other files."""
    for path in FILES:
        *above, name = path
        node: Any = settings
        for key in above:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(name), str):
            settings = merge(settings, nested(path, FILES_OF_VALUES.get(path, whole_path)(node[name])))
    return settings


def _without_files_of_axis(axis: dict[str, Any]) -> dict[str, Any]:
    """An axis without files as `_without_files` has it; files that are its plain values remain its labels.

    Names that cannot be labels stay as they are.
    """
    values, paths = axis.get("values", ()), [setting_path(dotted) for dotted in axis.get("set", ())]
    if any(path in FILES for path in paths) and all(isinstance(value, str) and is_case_name(value) for value in values):
        tables = [{"label": value, "set": merged(Layer(nested(path, value)) for path in paths)} for value in values]
        axis = {name: value for name, value in axis.items() if name != "set"} | {"values": tables}
    shown = [each | {"set": _without_files(each["set"])} if isinstance(each, dict) else each for each in axis.get("values", ())]
    return axis | ({"values": shown} if shown else {})


def scene_table(folder: Path, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a scene for a settings file: numbers as such, and files of the working directory by their whole paths.

    folder : of the scene, in which its own files lie
    """
    return {name: _scene_value(folder, value) for name, value in parameters.items()}


def _scene_value(folder: Path, value: object) -> object:
    if not isinstance(value, str):
        return value
    for kind in (int, float):
        try:
            if str(kind(value)) == value:
                return kind(value)
        except ValueError:
            pass  # not a number of this kind
    return value if not value or (folder / value).exists() else whole_path(value)
