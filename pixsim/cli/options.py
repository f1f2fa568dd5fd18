"""Shared parts of the commands: the app, common options, settings from files and options, and
printing of results.
"""

from __future__ import annotations

import gc
import inspect
import os
import re
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, is_dataclass, make_dataclass
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin

from cyclopts import App, Parameter, Token, convert

from pixsim.base import progress
from pixsim.base.errors import PixsimError, printable
from pixsim.base.files import check_replaceable, output_folder, private_folder
from pixsim.base.notes import note_of
from pixsim.base.progress import Stage
from pixsim.base.records import Record, as_list
from pixsim.base.toml import packaged
from pixsim.base.version import VERSION
from pixsim.cli.process import interruption
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, NUMBERS, Pixel
from pixsim.studies.settings import PitchRange
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.metric_options import Detectability, MetricOptions
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings, scene_options

QUIET = ("-q", "--quiet")
_VERBOSE = ("-v", "--verbose")
HELP = ("--help", "-h")
HELP_ALL = "--help-all"
app = App(
    name="pixsim",
    version=VERSION,
    help="From a Mitsuba 3 scene to the pixel size with the least visible error.",
    help_flags=[*HELP, HELP_ALL],
    help_format="plaintext",  # Markdown would import a parser, and color the code in backticks only
    default_parameter=Parameter(negative=()),
    help_epilogue=(
        "Every command takes --quiet (no progress, and only warnings about doubtful numbers),"
        " --verbose (stage times and tracebacks of errors) and --json (results as JSON). --help"
        " shows its common options, --help-all every option."
    ),
    suppress_keyboard_interrupt=False,  # main() reports it
)


class Verbosity:
    """How much a command prints to stderr; results on stdout do not depend on it."""

    quiet = verbose = False

    def parse(self, arguments: Sequence[str]) -> list[str]:
        """Set the verbosity and return the arguments without --quiet and --verbose, which may stand
        anywhere.
        """
        self.quiet = any(name in arguments for name in QUIET)
        self.verbose = not self.quiet and any(name in arguments for name in _VERBOSE)
        return [argument for argument in arguments if argument not in (*QUIET, *_VERBOSE)]

    def note(self, text: str) -> None:
        if not self.quiet:
            self._say(text)

    def warning(self, message: Warning | str) -> None:
        """Print a warning. With --quiet, only a note that puts a number in doubt."""
        if not self.quiet or (isinstance(message, UserWarning) and note_of(message).doubts):
            self._say(f"warning: {message}")

    def _say(self, text: str) -> None:
        progress.writer_to(sys.stderr)(text)


verbosity = Verbosity()


def set_cache_folders() -> None:
    """Let Mitsuba (kernels) and Matplotlib (fonts) use pixsim's cache folder, unless their own
    variables are set.
    """
    for variable, name in (("DRJIT_CACHE_DIR", "kernels"), ("MPLCONFIGDIR", "matplotlib")):
        with suppress(OSError, PixsimError):  # then they use their default folders
            if variable not in os.environ:
                os.environ[variable] = str(private_folder(name, quiet=name != "kernels"))


@contextmanager
def stages() -> Iterator[tuple[Stage, dict[str, float]]]:
    """`pixsim.base.progress.stages` with the verbosity of the command, and the wall times that it
    collects.
    """
    gc.freeze()  # what was imported stays; looking at it takes 0.1 s of `pixsim run`
    gc.enable()
    seconds: dict[str, float] = {}
    with progress.stages(seconds, quiet=verbosity.quiet) as stage:
        yield stage, seconds
    if verbosity.verbose and seconds:
        verbosity.note(
            "\n".join(f"{name}: {duration_s:.2f} s" for name, duration_s in seconds.items())
        )


_FROM_TECHNOLOGY = "from the technology"
NAMES = {float: "FLOAT", int: "INT", bool: "BOOL", str: "TEXT"}


def _value_name(annotation: object) -> str:
    """Return the name of the values of a field in the help: FLOAT, INT, TEXT, or the choices, as
    mosis|paper.

    A table of pairs is given as a FILE, a pair of numbers as INTxINT.
    """
    origin = get_origin(annotation)
    inner = get_args(annotation)
    if origin is Annotated:
        return _value_name(inner[0])
    if origin is Literal:
        return "|".join(map(str, inner))
    if origin in (Union, UnionType):
        # Values that are no text, such as records, can be given in Python only.
        text_kinds = [kind for kind in inner if kind is not type(None) and not is_dataclass(kind)]
        return "|".join(dict.fromkeys(map(_value_name, text_kinds)))
    if origin is dict:
        return "FILE"
    if origin is tuple:
        return "FILE" if inner[-1] is Ellipsis else "x".join(map(_value_name, inner))
    return NAMES.get(annotation, "TEXT") if isinstance(annotation, type) else "TEXT"


def _choices_of(annotation: object) -> tuple[str, ...]:
    """The texts that a field allows, if they are a list."""
    if get_origin(annotation) is Literal:
        return tuple(map(str, get_args(annotation)))
    return tuple(
        choice
        for inner in get_args(annotation)
        if get_origin(inner)
        for choice in _choices_of(inner)
    )


def field_option(record: type[Record], name: str, /, **parameters: Any) -> Parameter:
    """Return how the help and the completion show an option that is text, and that a field of a
    record validates.

    parameters : of cyclopts, over those that follow from the field
    """
    info = record.model_fields[name]
    description = info.description or ""
    default: Any = None if info.is_required() else info.default
    if default is None and not info.is_required() and "absent" not in description:
        default = _origin_of_default(record, name)

    default_text = ""
    if isinstance(default, float):
        default_text = f" [default: {default:g}]"
    elif default is not None:
        default_text = f" [default: {default}]"
    options = {
        "help": f"{description}{default_text}".strip(),
        "metavar": _value_name(info.annotation),
        "show_default": False,
    }
    choices = _choices_of(info.annotation)
    if choices:
        options["completer"] = lambda _: choices
    return Parameter(**{**options, **parameters})


def _origin_of_default(record: type[Record], name: str) -> str:
    """Return where the value of a field without a default comes from, for the help."""
    if record is CameraOptions and name in Camera.model_fields:
        return "the scene's"
    if name in NUMBERS and NUMBERS[name].in_technology:
        return _FROM_TECHNOLOGY
    return "none"


_NEXT_ASSIGNMENT = re.compile(r",(?=\s*[A-Za-z_][\w.+]*\s*[<>]?=)")


def _converted_values(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert the texts of an option that may be repeated, each of which holds values separated by
    commas or blanks.

    Assignments are separated by a comma before the next NAME=: other commas belong to their values.
    """
    values: list[Token] = []
    for token in tokens:
        parts: Any = (
            _NEXT_ASSIGNMENT.split(token.value) if "=" in token.value else as_list(token.value)
        )
        values += [token.evolve(value=part) for part in parts]
    return convert(kind, values)


# For options of several values, except names of files
SEVERAL = Parameter(converter=_converted_values, consume_multiple=False)


def _packaged_or_files(
    names: Callable[[], Iterable[str]], *suffixes: str
) -> Callable[[Any], list[str]]:
    """A completer that offers packaged names, and the files and folders that a path may go on to.

    names : returns the packaged names; it is called when a shell asks
    """

    def complete(context: Any) -> list[str]:
        started = str(context.incomplete)
        folder, separator, start = started.rpartition("/")
        directory = Path(folder or separator or ".")
        entries = sorted(directory.iterdir()) if directory.is_dir() else []
        paths = [
            f"{folder}{separator}{path.name}{'/' * path.is_dir()}"
            for path in entries
            if path.name.startswith(start)
        ]
        return [
            *names(),
            *(
                path
                for path in paths
                if path.endswith(("/", *suffixes)) and not path.startswith(".")
            ),
        ]

    return complete


def _scene_names() -> Iterable[str]:
    from pixsim.scene.packaged import packaged_scenes

    return packaged_scenes()


def _variant_names() -> Iterable[str]:
    from pixsim.scene.variants.variant import VARIANTS

    return VARIANTS


complete_scene = _packaged_or_files(_scene_names, ".xml")
complete_picture = _packaged_or_files(_scene_names, ".xml", ".exr", ".npz", ".hdr")
complete_study = _packaged_or_files(lambda: packaged("data/studies"), ".toml")
complete_lens = _packaged_or_files(lambda: packaged("data/lenses"), ".toml", ".zmx")
complete_technology = _packaged_or_files(
    lambda: [*packaged("data/technologies"), *packaged("data/sensors")], ".toml"
)
_complete_sensor = _packaged_or_files(
    lambda: [*packaged("data/technologies"), NO_TECHNOLOGY], ".toml"
)
_complete_settings = _packaged_or_files(lambda: packaged("data/sensors"), ".toml")


Config = Annotated[
    list[Path] | None,
    Parameter(
        completer=_complete_settings,
        metavar="FILE",
        help=(
            "TOML file with tables [camera], [pixel], …, or a packaged sensor: imx363, imx477."
            " Repeatable: later files take precedence."
        ),
    ),
]
_Define = Annotated[
    list[str] | None,
    SEVERAL,
    Parameter(
        name=["-D", "--define"],
        help=(
            "Set a scene parameter: name=value. Every scene takes resolution and spp: the film's"
            " samples across, and the samples for each of its cells."
        ),
        metavar="NAME=VALUE",
    ),
]
Metrics = Annotated[
    list[str] | None,
    SEVERAL,
    Parameter(
        name=("--metrics", "--metric"),
        help=(
            "Score by this metric: delta_e, detectability, npwe, information, acutance,"
            " contrast_detection_probability,"
            " visual_noise, mtf50, snr10_lx, niirs, flip. Several as delta_e,information; the"
            " headline has the first one [default: delta_e]."
        ),
        metavar="NAME",
    ),
]
Linear = Annotated[
    bool,
    Parameter(
        help="The picture of -D chart=FILE is linear in light, not sRGB (scene.chart_linear)."
    ),
]
_Assets = Annotated[
    str | None,
    Parameter(
        help="Let the scene use files in this folder, as well as those in its own (scene.assets).",
        metavar="FOLDER",
    ),
]
Tolerance = Annotated[str | None, field_option(Run, "tolerance_e")]
NoiseBudget = Annotated[
    bool | None, Parameter(help=Run.model_fields["noise_budget"].description, negative="")
]
Full = Annotated[bool, Parameter(help="Render without simplifications.")]
SensorId = Annotated[
    str | None, Parameter(help="Id of the sensor, if the scene has several.", metavar="ID")
]
Seed = Annotated[str | None, field_option(Run, "seed")]
Json = Annotated[bool, Parameter(help="Print the result as JSON.")]
DryRun = Annotated[
    bool,
    Parameter(
        help=(
            "Show what would be computed, with its memory and approximate time; nothing is"
            " written, and of a lit scene only a small part is rendered."
        )
    ),
]
FigureFiles = Annotated[
    Literal["svg", "pdf"],
    Parameter(help="Format of the figures: svg, or pdf for a PDF next to each SVG."),
]
Out = Annotated[Path | None, Parameter(help="Output folder [default: pixsim-out/NAME].")]
Variant = Annotated[
    str | None,
    Parameter(
        help=(
            "Mitsuba variant: cuda_ad_spectral (NVIDIA card), llvm_ad_spectral, scalar_spectral"
            " [default: the first that works]."
        ),
        metavar="NAME",
        completer=lambda _: _variant_names(),
    ),
]


def _option_table(record: type[Record], name: str, inside: str = "") -> object:
    """Return the fields of a record as dotted options, as text that the record validates, or None
    if no option is given.

    name : of the options, which is the name of the field for a record in another one
    inside : name of the options of that other record
    """
    fields: list[tuple[str, Any, Any]] = []
    for key, info in record.model_fields.items():
        records = [
            kind
            for kind in (info.annotation, *get_args(info.annotation))
            if inspect.isclass(kind) and issubclass(kind, Record)
        ]
        option: Any
        if records:
            option = _option_table(records[0], key.replace("_", "-"), name)
        else:
            parameters = _parameters_of(record, key)
            parameter = field_option(record, key, allow_leading_hyphen=True, **parameters)
            option = Annotated[str | None, parameter]
        fields.append((key, option, field(default=None)))

    table = make_dataclass(f"{record.__name__}Table", fields, frozen=True)
    table.__module__ = __name__  # otherwise cyclopts treats the class as a builtin
    group = f"--{inside or name}.…"
    return Annotated[table | None, Parameter(name=name, group=group, show_default=False)]


def _parameters_of(record: type[Record], key: str) -> dict[str, Any]:
    """Return what the options of some fields have beside the usual: names, completion of files."""
    if key == "technology":
        return {"completer": _complete_sensor, "metavar": "NAME|FILE"}
    if record is LensOptions and key == "file":
        names = ("--lens.file", "--lens")
        return {"name": names, "completer": complete_lens, "metavar": "NAME|FILE"}
    if record is Detectability and key == "without":
        return {"completer": complete_picture, "metavar": "NAME=VALUE,…|SCENE|FILE"}
    return {}


if TYPE_CHECKING:
    from pixsim.base.result import Result
    from pixsim.show.document import Document
    from pixsim.show.pages import Figures

    CameraTable: TypeAlias = object
    LensTable: TypeAlias = object
    PixelTable: TypeAlias = object
    ExposureTable: TypeAlias = object
    MotionTable: TypeAlias = object
    CorrectionTable: TypeAlias = object
    DevelopTable: TypeAlias = object
    DisplayTable: TypeAlias = object
    MetricTable: TypeAlias = object
    PitchTable: TypeAlias = object
else:
    CameraTable = _option_table(CameraOptions, "camera")
    LensTable = _option_table(LensOptions, "lens")
    PixelTable = _option_table(Pixel, "pixel")
    ExposureTable = _option_table(Exposure, "exposure")
    MotionTable = _option_table(Motion, "motion")
    CorrectionTable = _option_table(Correction, "correction")
    DevelopTable = _option_table(Develop, "develop")
    DisplayTable = _option_table(Display, "display")
    MetricTable = _option_table(MetricOptions, "metric")
    PitchTable = _option_table(PitchRange, "pitch")


@Parameter(name="*")
@dataclass(frozen=True)
class SceneOptions:
    """Options of run, plan, study, compare and accuracy: settings files, and options that override
    them.
    """

    config: Config = None
    define: _Define = None
    linear: Linear = False
    assets: _Assets = None
    camera: CameraTable = None
    lens: LensTable = None
    pixel: PixelTable = None
    exposure: ExposureTable = None
    motion: MotionTable = None
    correction: CorrectionTable = None
    develop: DevelopTable = None

    def settings(
        self, effort: EffortOptions | None = None, *, scene: str | None = None, **others: object
    ) -> Run:
        """Settings from defaults, files and options, in order of precedence. Raises PixsimError
        that lists all problems.
        """
        return run_settings(self.config or [], self.tables(effort, scene=scene, **others))

    def tables(
        self, effort: EffortOptions | None = None, *, scene: str | None = None, **others: object
    ) -> dict[str, Any]:
        """Return the options without the files, as tables of `Run` or of a study.

        scene : file or name of the scene
        others : further tables and fields
        """
        values = {**vars(self), **others, **(vars(effort) if effort else {})}
        del values["config"]
        parameters = definitions(values.pop("define"), values.pop("linear"), values.pop("assets"))
        return without_none({"scene": scene_options(scene, parameters) or None, **values})


@Parameter(name="*")
@dataclass(frozen=True)
class EffortOptions:
    """Options of run and study: error tolerances, film, time limit and window, as text that the
    record validates.
    """

    tolerance_delta_e: Annotated[str | None, field_option(Run, "tolerance_delta_e")] = None
    render_noise: Annotated[str | None, field_option(Run, "render_noise")] = None
    resolution: Annotated[str | None, field_option(Run, "resolution")] = None
    max_seconds: Annotated[str | None, field_option(Run, "max_seconds")] = None
    window_mm: Annotated[str | None, field_option(Run, "window_mm"), Parameter(name="--window")] = (
        None
    )


@Parameter(name="*")
@dataclass(frozen=True)
class ScoreOptions:
    """Options of run, study and compare: the metrics that judge each frame, and their settings."""

    metrics: Metrics = None
    metric: MetricTable = None


@Parameter(name="*")
@dataclass(frozen=True)
class StudyOptions:
    """Options of study and compare: metrics, axes, random sensors, effort and output."""

    scene_options: SceneOptions = SceneOptions()
    display: DisplayTable = None
    score_options: ScoreOptions = ScoreOptions()
    pitch: PitchTable = None
    seed: Seed = None
    tolerance_e: Tolerance = None
    refine: Annotated[
        bool | None,
        Parameter(
            help=(
                "Add sizes and sensors where an interval is open or too long [default: the"
                " study's]."
            ),
            negative="--no-refine",
        ),
    ] = None
    quick: Annotated[
        bool,
        Parameter(
            help=(
                "Fewer pitches and sensors, as in NAME.quick.toml next to the study's file, or"
                " at most 8 and 4."
            )
        ),
    ] = False
    jobs: Annotated[
        int | None,
        Parameter(
            help=(
                "Number of processes [default: one per core where they are worth their start,"
                " or else threads]; results do not depend on it."
            )
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        Parameter(
            help="Address of a Dask scheduler (tcp://host:8786); its workers replace --jobs.",
            metavar="ADDRESS",
        ),
    ] = None
    axis: Annotated[
        list[str] | None,
        SEVERAL,
        Parameter(
            help=(
                "Vary a setting as well as the pixel size: NAME=v1,v2,… or"
                " NAME=from:to:count[:log]. NAME is an axis of the study or a dotted setting,"
                " such as camera.f_number; settings joined by + change together. Choose labelled"
                " values by their labels. Repeatable."
            ),
            metavar="NAME=VALUES",
        ),
    ] = None
    uncertainty: Annotated[
        int | None,
        Parameter(
            help=(
                "Draw this many sensor types from the ranges of the technologies and"
                " [pixel.uncertainty] of data sheets, and report the distribution of the answer,"
                " probabilities, and which numbers matter."
            ),
            metavar="N",
        ),
    ] = None
    sobol: Annotated[
        int | None,
        Parameter(
            help=(
                "In place of --uncertainty: total indices, which take N × (inputs + 2) sensor"
                " types."
            ),
            metavar="N",
        ),
    ] = None
    smaller_than: Annotated[
        list[float] | None,
        SEVERAL,
        Parameter(
            help=(
                "Report the probability that the optimum of a study is smaller than this pixel size"
                " in µm. Several as 2,3.45."
            ),
            metavar="UM",
        ),
    ] = None
    noise_budget: NoiseBudget = None
    yes: Annotated[
        bool, Parameter(help="Run several cases with more than 100 000 evaluations.", negative="")
    ] = False
    effort: EffortOptions = EffortOptions()
    variant: Variant = None
    dry_run: DryRun = False
    figures: FigureFiles = "svg"
    out: Out = None
    json: Json = False

    @property
    def effort_and_output(self) -> dict[str, Any]:
        """The options that are no settings, by the names that `report.commands` has for them."""
        names = (
            "quick",
            "jobs",
            "scheduler",
            "uncertainty",
            "sobol",
            "variant",
            "dry_run",
            "figures",
        )
        return {name: getattr(self, name) for name in names} | {
            "config": self.scene_options.config or [],
            "axes": self.axis or [],
            "smaller_than_um": self.smaller_than or (),
            "agreed": self.yes,
        }

    @property
    def settings(self) -> dict[str, Any]:
        """The options that are tables and fields of a study, without `SceneOptions`."""
        names = "display", "pitch", "seed", "refine", "tolerance_e", "noise_budget"
        return {name: getattr(self, name) for name in names} | vars(self.score_options)


NO_OPTIONS = SceneOptions()
NO_EFFORT = EffortOptions()
NO_SCORE_OPTIONS = ScoreOptions()
NO_STUDY_OPTIONS = StudyOptions()


def without_none(options: dict[str, Any]) -> dict[str, Any]:
    """The options that were given; tables become dicts."""
    return {
        name: without_none(vars(value)) if is_dataclass(value) else value
        for name, value in options.items()
        if value is not None
    }


def definitions(
    pairs: list[str] | None, linear: bool = False, assets: str | None = None
) -> dict[str, str] | None:
    """Return the table of scene parameters from name=value pairs, --linear and --assets, or None if
    there are none.
    """
    table = {"chart_linear": "1"} if linear else {}
    table |= {"assets": assets} if assets is not None else {}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise PixsimError(f"-D: got '{pair}'; allowed: name=value, such as -D spp=64.")
        table[name.strip()] = value
    return table or None


def answer(document: Document, as_json: bool, page: Path | None = None) -> None:
    """Print a document as text as wide as the terminal, with the path of its page below it, or as
    JSON.
    """
    from pixsim.show.render import WIDTH, json, text

    width = shutil.get_terminal_size((WIDTH, 0)).columns
    lines = [] if page is None else [f"report: {page}"]
    interruption.end_or_raise()
    say((json(document) if as_json else "\n".join([text(document, width), *lines])) + "\n", as_json)


def write_answer(
    measure: Callable[[Stage], Result],
    document_of: Callable[[Any], Document],
    folder: Path,
    files: Collection[str],
    figures: Figures,
    as_json: bool,
) -> None:
    """Measure something, write its files, and print it.

    files : names of all that may be written; one that pixsim did not write is refused before
        anything is measured
    """
    from pixsim.show.render import write

    check_replaceable(folder, files)
    with stages() as (stage, _), output_folder(folder):
        result = measure(stage)
        stage("report")
        document = document_of(result)
        page = write(document, folder, figures=figures)
    answer(document, as_json, page)


def say(text: str, as_json: bool = False) -> None:
    """Print to stdout, and flush it. Raises PixsimError if that fails, but for a pipe that is
    closed.
    """
    try:
        print(printable(text, as_json), end="", flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise PixsimError(
            f"standard output cannot be written ({error.strerror}); the files of the command were"
            " written."
        ) from None
