"""What the commands share: the app, options that several have, settings from files and options, and how results are shown."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

import pixsim
from pixsim.config import merge, read_toml
from pixsim.errors import PixsimError
from pixsim.parameters import Run

DEFAULT_OUT = Path("pixsim-out")
FILE_WIDTH = 160  # columns of a table that does not go to a terminal

app = App(
    name="pixsim",
    version=pixsim.__version__,
    help="From a Mitsuba 3 scene to the pixel size with the least visible error.",
    default_parameter=Parameter(negative=()),
    suppress_keyboard_interrupt=False,  # main() tells what is kept
)


def described(name: str) -> str:
    """A field of the run's settings, in help's words."""
    field = Run.model_fields[name]
    return f"{field.description}" + ("" if field.default is None else f" [default: {field.default:g}]")


Config = Annotated[list[Path] | None, Parameter(help="TOML with tables [camera], [pixel], …; later files win.")]
Tolerance = Annotated[str | None, Parameter(help=described("tolerance_e"))]
Full = Annotated[bool, Parameter(help="Leave nothing out.")]
SensorId = Annotated[str | None, Parameter(help="Id of the sensor, where the scene has several.")]
Define = Annotated[list[str], Parameter(name=["-D", "--define"], help="Set a scene parameter: name=value.", consume_multiple=False)]
Seed = Annotated[str | None, Parameter(help="Of the render, the sensor and its noise [default: 0].")]
Json = Annotated[bool, Parameter(help="Print the result as JSON.")]
Out = Annotated[Path | None, Parameter(help="Output folder [default: pixsim-out/NAME].")]
Variant = Annotated[str | None, Parameter(help="Mitsuba variant; by default the fastest that works here.")]


def settings_of(config: list[Path] | None, tables: dict[str, Any], define: list[str] | None, values: dict[str, str | None]) -> Run:
    """Defaults ← files ← options, checked once."""
    layers = [read_toml(path) for path in config or []]
    layers.append({name: own for name, table in tables.items() if (own := given(table))})
    layers.append({"scene": definitions(define or [])} | {name: value for name, value in values.items() if value is not None})
    settings: dict[str, Any] = {}
    for layer in layers:
        settings = merge(settings, layer)
    return Run.model_validate(settings)


def given(table: Any) -> dict[str, str]:
    """Options that were on the command line."""
    return {name: value for name, value in vars(table).items() if value is not None}


def definitions(pairs: list[str]) -> dict[str, str]:
    """name=value pairs as a table."""
    table = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise PixsimError(f"-D: got '{pair}'; allowed: name=value. Write -D resolution=512.")
        table[name.strip()] = value
    return table


def show(result: dict[str, Any], as_json: bool, text: str) -> None:
    if as_json:
        import json

        text = json.dumps(result, indent=2, sort_keys=True, ensure_ascii=False)
    print(text)
