"""Files of settings: a sensor, its camera, exposure and display."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.layers import Layer, listed, plain_tables
from pixsim.base.records import checked
from pixsim.base.toml import packaged, read_toml, resolve_file
from pixsim.light.curves import RESPONSES
from pixsim.optics.lens_options import as_file_names
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spread import without_uncertainty
from pixsim.viewer.merging import without_replaced_scenes
from pixsim.viewer.setting import Run, RunScene

ASSETS = "assets"  # the parameter of a scene that names a folder
# Settings that may name a file, and one that names a folder.
FILES = (
    *(
        ("pixel", "technology"),
        ("pixel", "quantum_efficiency"),
        *(("pixel", "colour", name) for name in RESPONSES),
    ),
    *(
        ("camera", "chief_ray_angle"),
        ("develop", "tone_curve"),
        ("scene", "file"),
        ("scene", "parameters", "chart"),
        ("scene", "parameters", ASSETS),
        ("metric", "detectability", "without"),
    ),
    *(("lens", "file"), ("lens", "veiling_glare"), ("lens", "relative_illumination")),
)


def packaged_sensors() -> Mapping[str, Path]:
    """Return name -> path of the packaged settings files, each a sensor with its camera."""
    return packaged("data/sensors")


def settings_path(name: str | os.PathLike[str]) -> Path:
    """Return the path of a settings file, which may be a packaged sensor by its name.

    Raises PixsimError for the name of neither.
    """
    sensors = packaged_sensors()
    path = Path(name)
    if str(path) in sensors:
        return sensors[str(path)]
    if path.parent == Path() and not path.suffix and not os.path.lexists(path):
        allowed = f"a TOML file, or a packaged sensor: {', '.join(sensors)}"
        raise invalid("settings file", f"'{name}'", allowed, did_you_mean(str(name), sensors))
    return path


def settings_layer(file: str | os.PathLike[str]) -> Layer:
    """Read a settings file, or a packaged one by its name; paths in it are resolved by
    `resolve_file`.

    Parameters of the scene may stand in [scene] itself, or in [scene.parameters].

    Its [pixel.uncertainty] is checked and left out, so that a pixel is plain numbers:
    `sheet_uncertainty` returns it.
    """
    path = settings_path(file)
    table = read_toml(path)
    if isinstance(pixel := table.get("pixel"), dict):
        table["pixel"], _ = without_uncertainty(pixel, str(path))
    if isinstance(scene := table.get("scene"), dict):
        table["scene"] = _with_nested_parameters(scene)
    resolve_files(table, path, FILES)
    lens = table.get("lens", {})
    if isinstance(lens, dict) and isinstance(
        catalogues := as_file_names(lens.get("glass_catalogues")), list
    ):
        lens["glass_catalogues"] = [resolve_file(path, name) for name in catalogues]
    return Layer(table, str(path))


def _with_nested_parameters(scene: dict[str, Any]) -> dict[str, Any]:
    """Return the table [scene] of a file with all parameters in a table of their own."""
    nested = {name: value for name, value in scene.items() if name in RunScene.model_fields}
    parameters = {name: value for name, value in scene.items() if name not in nested}
    stated = nested.get("parameters", {})
    if parameters and isinstance(stated, dict):
        nested["parameters"] = parameters | stated
    return nested


def resolve_files(table: dict[str, Any], path: Path, files: Iterable[Sequence[str]]) -> None:
    """Replace names of files and of the scene's folder in a table of settings by their paths, if
    they lie next to the settings file.

    files : paths of the settings that may name a file
    """
    for *above, name in files:
        node: Any = table
        for key in above:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and name in node:
            node[name] = resolve_file(path, node[name], is_folder=name == ASSETS)


def run_settings(
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], options: Mapping[str, Any]
) -> Run:
    """Return settings from defaults, files and options, in order of precedence. Raises PixsimError
    that lists all problems.

    config : one or more TOML files, or names of packaged sensors; later ones take precedence
    options : tables and fields of `Run`
    """
    files = [settings_layer(path) for path in listed(config)]
    settings: Run = checked(Run, without_replaced_scenes([*files, Layer(plain_tables(options))]))
    return settings


def scene_options(
    file: str | os.PathLike[str] | None, parameters: Mapping[str, object] | None
) -> dict[str, Any]:
    """Return the table of a scene from Python or a command, without what is not stated."""
    table: dict[str, Any] = {} if file is None else {"file": str(file)}
    return table | ({"parameters": dict(parameters)} if parameters else {})


def load_pixel(file: str | os.PathLike[str]) -> Pixel:
    """Return the pixel of a sensor's settings file, or of a packaged sensor by its name: for
    `evaluate` and `sweep`.

    Other tables of the file, such as its camera, are checked and left out.

    Raises PixsimError for the name of neither, and for a file that is damaged or has wrong values.

    >>> load_pixel("imx477").pitch_um
    1.55
    """
    return run_settings(file, {}).pixel
