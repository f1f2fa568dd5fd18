"""What the commands share: the app, options that several have, settings from files and options, and how results are shown."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, is_dataclass, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import App, Parameter

from pixsim.base import progress
from pixsim.base.config import checked, is_data_sheet, settings_layer
from pixsim.base.errors import PixsimError
from pixsim.base.files import cache_folder
from pixsim.base.parameters import NO_TECHNOLOGY, CameraOptions, Display, Exposure, Layer, Pixel, Record, Run
from pixsim.base.progress import Stage
from pixsim.base.version import VERSION

DEFAULT_OUT = Path("pixsim-out")
QUIET, VERBOSE = ("-q", "--quiet"), ("-v", "--verbose")
FILE_WIDTH = 160  # columns of a table that does not go to a terminal
app = App(
    name="pixsim",
    version=VERSION,
    help="From a Mitsuba 3 scene to the pixel size with the least visible error.",
    default_parameter=Parameter(negative=()),
    help_epilogue=(
        "Every command takes --quiet (no progress, no warnings), --verbose (times of the stages; where an error arose) "
        "and --json (the result for programs)."
    ),
    suppress_keyboard_interrupt=False,  # main() tells what is kept
)


class Manner:
    """How much a command says on stderr; results on stdout stay as they are."""

    def __init__(self) -> None:
        self.quiet = self.verbose = False

    def take(self, words: Sequence[str]) -> list[str]:
        """The words without --quiet and --verbose, which may stand anywhere."""
        self.quiet = any(each in words for each in QUIET)
        self.verbose = not self.quiet and any(each in words for each in VERBOSE)
        return [each for each in words if each not in (*QUIET, *VERBOSE)]

    def note(self, text: str) -> None:
        if not self.quiet:
            print(text, file=sys.stderr)


manner = Manner()


def keep_helpers_files_together() -> None:
    """Mitsuba's kernels and Matplotlib's fonts are kept in pixsim's cache folder, unless their own variables say where."""
    for variable, name in (("DRJIT_CACHE_DIR", "kernels"), ("MPLCONFIGDIR", "matplotlib")):
        folder = cache_folder() / name
        with suppress(OSError):  # then they find places of their own
            if variable not in os.environ:
                folder.mkdir(parents=True, exist_ok=True)
                os.environ[variable] = str(folder)


@contextmanager
def stages(seconds: dict[str, float] | None = None) -> Iterator[Stage]:
    """`pixsim.base.progress.stages` in the manner asked for."""
    clock = {} if seconds is None else seconds
    with progress.stages(clock, quiet=manner.quiet) as stage:
        yield stage
    if manner.verbose:
        manner.note("\n".join(f"{name}: {taken:.2f} s" for name, taken in clock.items()))


def described(name: str) -> str:
    """A field of the run's settings, in help's words."""
    field = Run.model_fields[name]
    return f"{field.description}" + ("" if field.default is None else f" [default: {field.default:g}]")


Config = Annotated[list[Path] | None, Parameter(help="TOML with tables [camera], [pixel], …; later files win.")]
Define = Annotated[
    list[str] | None, Parameter(name=["-D", "--define"], help="Set a scene parameter: name=value.", consume_multiple=False)
]
Tolerance = Annotated[str | None, Parameter(help=described("tolerance_e"))]
Full = Annotated[bool, Parameter(help="Leave nothing out.")]
SensorId = Annotated[str | None, Parameter(help="Id of the sensor, where the scene has several.")]
Seed = Annotated[str | None, Parameter(help="Of the render, the sensor and its noise [default: 0].")]
Json = Annotated[bool, Parameter(help="Print the result as JSON.")]
Out = Annotated[Path | None, Parameter(help="Output folder [default: pixsim-out/NAME].")]
Variant = Annotated[str | None, Parameter(help="Mitsuba variant; by default the fastest that works here.")]


def option_table(record: type[Record], name: str) -> Any:
    """The fields of a record as dotted options, None where none of them is given.

    They stay text: the record itself checks them, in one place.
    """
    fields = []
    for key, info in record.model_fields.items():
        default = "" if info.is_required() or info.default is None else f" [default: {info.default}]"
        how = Parameter(help=f"{info.description or ''}{default}".strip(), allow_leading_hyphen=True, show_default=False)
        fields.append((key, Annotated[str | None, how], field(default=None)))
    table = make_dataclass(f"{record.__name__}Table", fields, frozen=True)
    table.__module__ = __name__  # without it cyclopts takes the class for a builtin
    return Annotated[table | None, Parameter(name=name, group=f"--{name}.…", show_default=False)]


if TYPE_CHECKING:
    CameraTable: TypeAlias = Any
    PixelTable: TypeAlias = Any
    ExposureTable: TypeAlias = Any
    DisplayTable: TypeAlias = Any
else:
    CameraTable = option_table(CameraOptions, "camera")
    PixelTable = option_table(Pixel, "pixel")
    ExposureTable = option_table(Exposure, "exposure")
    DisplayTable = option_table(Display, "display")


@Parameter(name="*")
@dataclass(frozen=True)
class SceneOptions:
    """What run, plan and accuracy share: files of settings, and what lies over them."""

    config: Config = None
    define: Define = None
    camera: CameraTable = None
    pixel: PixelTable = None
    exposure: ExposureTable = None

    def settings(self, **others: Any) -> Run:
        """Defaults ← files ← options, these and others, checked once. PixsimError with all that is wrong."""
        values = {**vars(self), **others}
        files = [settings_layer(path) for path in values.pop("config") or []]
        options = given({"scene": definitions(values.pop("define")), **values})
        settings: Run = checked(Run, [*files, Layer(options)])  # names and values first, then what a data sheet lacks
        if is_data_sheet(files, options):
            settings = checked(Run, [Layer({"pixel": {"technology": NO_TECHNOLOGY}}), *files, Layer(options)])
        return settings


@Parameter(name="*")
@dataclass(frozen=True)
class Effort:
    """What run and study share: how good, and how long. Text, as in the tables."""

    tolerance_delta_e: Annotated[str | None, Parameter(help=described("tolerance_delta_e"))] = None
    render_noise: Annotated[str | None, Parameter(help=described("render_noise"))] = None
    max_seconds: Annotated[str | None, Parameter(help=described("max_seconds"))] = None


NO_OPTIONS, NO_EFFORT = SceneOptions(), Effort()


def given(options: dict[str, Any]) -> dict[str, Any]:
    """Those that were on the command line, tables as dicts."""
    return {name: given(vars(own)) if is_dataclass(own) else own for name, own in options.items() if own is not None}


def definitions(pairs: list[str] | None) -> dict[str, str] | None:
    """name=value pairs as a table, None without any."""
    table = {}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise PixsimError(f"-D: got '{pair}'; allowed: name=value. Write -D resolution=512.")
        table[name.strip()] = value
    return table or None


def show(result: dict[str, Any], as_json: bool, text: str) -> None:
    if as_json:
        import json

        text = json.dumps(result, indent=2, sort_keys=True, ensure_ascii=False)
    print(text)
