"""The commands of `pixsim`."""

from __future__ import annotations

import io
import os
import shutil
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pixsim.base.caller import command_line
from pixsim.base.errors import invalid
from pixsim.base.layers import Layer
from pixsim.base.notes import collected_notes
from pixsim.base.progress import Stage
from pixsim.base.records import checked
from pixsim.cli import options as common
from pixsim.cli.options import (
    HELP,
    HELP_ALL,
    Json,
    Out,
    SceneOptions,
    answer,
    app,
    field_option,
    say,
    stages,
    without_none,
    write_answer,
)
from pixsim.cli.process import NOT_MET, interruption
from pixsim.optics.lens_options import LensOptions
from pixsim.report.commands import DEFAULT_OUT
from pixsim.viewer.setting import Run

_RawFormat = Literal["tiff", "png", "npz"]
_SCENE_HELP = (
    "An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, target,"
    " macbeth, line_lamp, still_life, cornell_box, yard."
)
_PICTURE_HELP = f"{_SCENE_HELP} Or a spectral image from another program (.exr, .npz, .hdr)."
_OF_CONFIG = (
    "[default: that of --config, such as settings.toml of a run; a stated one replaces it with its"
    " parameters]"
)


def run_command(tokens: Sequence[str]) -> None:
    """Run a command; the exceptions that end it are reported by `pixsim.cli.main`.

    tokens : its name and arguments
    """
    # PYTHONUNBUFFERED makes it unbuffered: a signal would cut what a pipe delays
    if isinstance(getattr(sys.stdout, "buffer", None), io.FileIO):
        sys.stdout = open(1, "w", encoding=sys.stdout.encoding, closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # file names may not be UTF-8
            stream.reconfigure(errors="backslashreplace")
    _widen_terminal()
    arguments = common.verbosity.parse(tokens)
    _check_current_folder()
    warnings.showwarning = lambda message, *_, **__: common.verbosity.warning(message)
    common.set_cache_folders()
    interruption.begin()
    try:
        # Notes also of the settings, before a result collects its own.
        with command_line(), collected_notes():
            arguments = _with_whole_options(arguments)
            if any(word in HELP for word in arguments) and HELP_ALL not in arguments:
                from pixsim.cli.help import print_help

                say(print_help(app, arguments))
            else:
                app(arguments, exit_on_error=False, print_error=False)
    except Exception as error:
        if interruption.received:  # a library has turned it into another exception
            raise KeyboardInterrupt from error
        raise
    say("")
    interruption.end_or_raise()  # a library may have dropped an interruption


_MIN_WIDTH = 40  # columns, for which help and tables are laid out in a narrower terminal


def _widen_terminal() -> None:
    """Let help and tables have some columns where the terminal, or COLUMNS, states none or very
    few: they would not end.
    """
    stated = os.environ.get("COLUMNS")
    if shutil.get_terminal_size().columns < _MIN_WIDTH:
        os.environ["COLUMNS"] = str(_MIN_WIDTH)
    elif stated is not None and not (stated.isdecimal() and int(stated) >= _MIN_WIDTH):
        del os.environ["COLUMNS"]


_WHOLE_OPTIONS = {"--lens": "--lens.file", "--metric": "--metrics"}


def _with_whole_options(arguments: Sequence[str]) -> list[str]:
    """Write `--lens phone` as `--lens.file phone`: cyclopts takes no `--lens.refocus` beside a
    value of `--lens`.
    """
    completed = []
    for argument in arguments:
        name, equals, value = argument.partition("=")
        completed.append(
            f"{_WHOLE_OPTIONS.get(name, name)}{equals}{value}"
            if argument.startswith("--")
            else argument
        )
    return completed


def _check_current_folder() -> None:
    """Raise PixsimError if the current folder is gone: paths are relative to it, and libraries fail
    to load.
    """
    try:
        os.getcwd()
    except OSError as error:
        got = f"a folder that no longer exists ({error.strerror})"
        raise invalid(
            "current folder", got, "a folder that exists", "Change to another one: cd ~"
        ) from None


Scene = Annotated[
    str | None,
    Parameter(
        help=f"{_SCENE_HELP} {_OF_CONFIG}", show_default=False, completer=common.complete_scene
    ),
]
Units = Annotated[
    str | None,
    Parameter(
        help="Units of an image whose file does not state them, such as W.m^-2.nm^-1.",
        metavar="UNIT",
    ),
]


@app.command(sort_key=0)
def run(
    scene: Annotated[
        str | None,
        Parameter(
            help=f"{_PICTURE_HELP} {_OF_CONFIG}",
            show_default=False,
            completer=common.complete_picture,
        ),
    ] = None,
    *,
    options: SceneOptions = common.NO_OPTIONS,
    display: common.DisplayTable = None,
    score_options: common.ScoreOptions = common.NO_SCORE_OPTIONS,
    seed: common.Seed = None,
    tolerance_e: common.Tolerance = None,
    effort: common.EffortOptions = common.NO_EFFORT,
    full: common.Full = False,
    noise_budget: common.NoiseBudget = None,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    units: Units = None,
    raw: Annotated[
        list[_RawFormat] | None,
        common.SEVERAL,
        Parameter(help="Also write the raw frame in these formats, such as --raw tiff,png."),
    ] = None,
    require: Annotated[
        list[str] | None,
        common.SEVERAL,
        Parameter(
            consume_multiple=True,
            help=(
                'Limits on metrics, such as --require "detectability>=5" "delta_e<=1". The'
                " result says whether it meets each; if not, the exit code is 3."
            ),
        ),
    ] = None,
    repeats: Annotated[
        int,
        Parameter(
            help=(
                "Number of sensors of this kind, each with its own fixed pattern, noise and"
                " position of its pixel grid on the picture. The result is their mean ΔE with its"
                " 95 % interval. Pictures and frames are those of the first sensor,"
                " which is centred. With --tolerance-delta-e this is the minimum."
            )
        ),
    ] = 1,
    frames: Annotated[
        int,
        Parameter(
            help=(
                "Number of raw frames of this sensor, all with its fixed pattern, each with its"
                " own temporal noise. The first, raw.exr, is scored; the others are raw_002.exr,"
                " … (and the formats of --raw)."
            )
        ),
    ] = 1,
    irradiance: Annotated[
        Literal["reduced", "full", "factors", "none"],
        Parameter(
            help=(
                "Content of irradiance.exr: spectral bands averaged over larger samples (at most"
                " 1024 across, 60 MB), all samples (read back bit for bit), only the factors"
                " (spectra × pictures; all bands where an image has none), or no file."
            )
        ),
    ] = "reduced",
    dry_run: common.DryRun = False,
    out: Out = None,
    json: Json = False,
) -> None:
    """Render a scene, simulate the sensor, and score its picture.

    Example: pixsim run csf --pixel.pitch-um 5.6 --camera.f-number 2.8

    Example: pixsim run picture.exr --units W.m^-2.sr^-1.nm^-1

    Example: pixsim run csf --repeats 8

    Writes irradiance.exr, raw.exr (and the formats of --raw), ideal.png, image.png, delta_e.exr,
    delta_e.png, score.json, settings.toml and report.html.
    `pixsim run --config settings.toml` repeats it.
    """
    from pixsim.report.commands.run import run_files

    tables = {
        "scene": scene,
        "display": display,
        "seed": seed,
        "tolerance_e": tolerance_e,
        "noise_budget": noise_budget,
        "require": require,
        **vars(score_options),
    }
    settings = options.settings(effort, **tables)
    with stages() as (stage, seconds):
        document, page = run_files(
            settings,
            out,
            formats=raw or [],
            irradiance=irradiance,
            full=full,
            repeats=repeats,
            frames=frames,
            sensor=sensor,
            variant=variant,
            units=units,
            dry_run=dry_run,
            progress=stage,
            seconds=seconds,
        )
    answer(document, json, page)
    if not all(check["met"] for check in document.data.get("requirements", ())):
        interruption.finish()
        raise SystemExit(NOT_MET)


@app.command(sort_key=3)
def explore(
    scene: Annotated[
        str | None,
        Parameter(
            help=f"{_PICTURE_HELP} [default: that of --config, or csf]",
            show_default=False,
            completer=common.complete_picture,
        ),
    ] = None,
    *,
    options: SceneOptions = common.NO_OPTIONS,
    display: common.DisplayTable = None,
    score_options: common.ScoreOptions = common.NO_SCORE_OPTIONS,
    seed: common.Seed = None,
    tolerance_e: common.Tolerance = None,
    effort: common.EffortOptions = common.NO_EFFORT,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    units: Units = None,
    browser: Annotated[
        bool,
        Parameter(
            help="Do not open a browser; print the file that opens the page.",
            negative="--no-browser",
        ),
    ] = True,
) -> None:
    """See on a page what a sensor makes of a scene.

    Example: pixsim explore csf --config my_sensor.toml

    Several files of sensors (--config, repeated) are starting points to choose from.

    It ends when the page is closed, or by Ctrl-C. It reads no other files than those named here,
    and serves this user alone.
    """
    from pixsim.explorer.exploring import check_installed

    check_installed()
    from pixsim.explorer.server import explore_until_closed
    from pixsim.explorer.session import Session

    tables = options.tables(
        effort, display=display, seed=seed, tolerance_e=tolerance_e, **vars(score_options)
    )
    session_settings = {"sensor": sensor, "variant": variant, "units": units}
    session = Session(scene, options.config or (), tables, session_settings)
    explore_until_closed(session, None if browser else lambda file: say(f"page: {file}\n"))


@app.command(sort_key=4)
def plan(
    scene: Scene = None,
    *,
    options: SceneOptions = common.NO_OPTIONS,
    tolerance_e: common.Tolerance = None,
    full: common.Full = False,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    json: Json = False,
) -> None:
    """Show what a render needs, and what it leaves out.

    Each effect comes with the reason and the bound of its error. Nothing is rendered.

    Example: pixsim plan macbeth --tolerance-e 1e-4
    """
    from pixsim.report.commands.plan import plan_answer

    settings = options.settings(scene=scene, tolerance_e=tolerance_e)
    answer(plan_answer(settings, full=full, sensor=sensor, variant=variant), json)


@app.command(sort_key=1)
def study(
    study: Annotated[
        str,
        Parameter(
            help=(
                "A TOML file, or the name of a packaged study: pixel-size, chen2000,"
                " chen2000-sensitivity, modern, colour, "
                "processing."
            ),
            completer=common.complete_study,
        ),
    ],
    *,
    scene: Annotated[
        str | None,
        Parameter(
            help=f"{_SCENE_HELP} [default: from the study]",
            metavar="NAME|FILE",
            completer=common.complete_scene,
        ),
    ] = None,
    options: common.StudyOptions = common.NO_STUDY_OPTIONS,
) -> None:
    """Find the pixel size with the least visible error.

    Example: pixsim study chen2000 --quick

    Example: pixsim study chen2000 --pixel.response scaled --out scaled

    Example: pixsim study pixel-size --config my_sensor.toml --scene still_life --pitch.min-um 2
    --quick

    Example: pixsim study pixel-size --axis camera.f_number=2,2.8,4 --quick

    Writes results.csv, settings.toml, summary.json, figures (with a contact sheet), pixsim.json and
    report.html. The same command continues an interrupted study; `pixsim study settings.toml`
    repeats it.
    """
    from pixsim.report.commands.study import study_files

    tables = options.scene_options.tables(options.effort, scene=scene, **options.settings)
    with stages() as (stage, seconds):
        document, page = study_files(
            study,
            tables,
            options.out,
            say=common.verbosity.note,
            progress=stage,
            seconds=seconds,
            **options.effort_and_output,
        )
    answer(document, options.json, page)


@app.command(sort_key=2)
def compare(
    *sensors: Annotated[
        str,
        Parameter(
            help=(
                "Two or more sensors: TOML files with a table [pixel], such as data sheets; files"
                " of technologies, or names of packaged ones. The first is the reference. Or two"
                " results, whatever differs between them: folders, or settings files of runs with"
                " their scene, as settings.toml."
            ),
            completer=common.complete_technology,
            metavar="SENSOR",
        ),
    ],
    scene: Annotated[
        str | None,
        Parameter(
            help=f"{_SCENE_HELP} [default: from --study, or csf]",
            metavar="NAME|FILE",
            completer=common.complete_scene,
        ),
    ] = None,
    study: Annotated[
        str | None,
        Parameter(
            help=(
                "A TOML file, or the name of a packaged study: its scene, display, exposure and"
                " conditions hold for all sensors, "
                "its lens for files that state none. Under conditions, their weighted mean is the"
                " answer; axes have one at each value."
            ),
            metavar="NAME|FILE",
            completer=common.complete_study,
        ),
    ] = None,
    match: Annotated[
        Literal["view", "lens", "own"] | None,
        Parameter(
            help=(
                "How the cameras are matched: view, by the field of view, f-number and object"
                " distance of the first; lens, by its focal length; own, each file's own camera."
                " The central field that all share is compared [default: view, and whether lens"
                " changes the answer]."
            )
        ),
    ] = None,
    repeats: Annotated[
        int | None,
        Parameter(
            help="Pairs of frames, with the same seeds [default: 8, with --quick 4].",
            show_default=False,
        ),
    ] = None,
    sensor: common.SensorId = None,
    raw: Annotated[
        list[_RawFormat] | None,
        common.SEVERAL,
        Parameter(
            help="Also write the first raw frame of each sensor, raw/NAME.exr and in these formats."
        ),
    ] = None,
    options: common.StudyOptions = common.NO_STUDY_OPTIONS,
) -> None:
    """Compare sensors in one scene, or two results.

    Example: pixsim compare a.toml b.toml

    Example: pixsim compare 0.35um 4t-bsi --pixel.pitch-um 5 -D luminance_cd_per_m2=10

    Example: pixsim compare a.toml b.toml --study day_and_night.toml

    Example: pixsim compare a.toml b.toml --uncertainty 64

    Example: pixsim compare pixsim-out/first pixsim-out/second

    Options of cameras, pixels, exposures and displays, and --config, hold for all sensors. Writes
    compare.json, pictures, settings.toml, the settings of each sensor, and report.html; of two
    results summary.json, report.html, and a folder for each run of a settings file.
    """
    from pixsim.report.commands.compare import comparison_files

    tables = options.scene_options.tables(options.effort, scene=scene, **options.settings)
    with stages() as (stage, seconds):
        document, page = comparison_files(
            sensors,
            tables,
            options.out,
            study=study,
            match=match,
            repeats=repeats,
            sensor=sensor,
            raw_formats=raw or [],
            progress=stage,
            seconds=seconds,
            **options.effort_and_output,
        )
    answer(document, options.json, page)


@app.command(sort_key=8)
def accuracy(
    scene: Scene = None,
    *,
    quick: Annotated[bool, Parameter(help="Fewer films.")] = False,
    options: SceneOptions = common.NO_OPTIONS,
    display: common.DisplayTable = None,
    seed: common.Seed = None,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    figures: common.FigureFiles = "svg",
    out: Out = None,
    json: Json = False,
) -> None:
    """Measure the error of a mean ΔE against run time.

    Example: pixsim accuracy csf --quick

    Writes ladder.csv, stability.csv, figures/*.svg and *.csv, summary.json and report.html.
    """
    from pixsim.report.accuracy import FILES, accuracy_document
    from pixsim.studies.prepare import file_of_scene
    from pixsim.verification.ladder import Accuracy, measure_accuracy

    settings = options.settings(scene=scene, display=display, seed=seed)
    folder = out or DEFAULT_OUT / f"{Path(file_of_scene(settings)).stem}-accuracy"

    def measure(stage: Stage) -> Accuracy:
        return measure_accuracy(
            settings, quick=quick, sensor=sensor, variant=variant, progress=stage
        )

    write_answer(measure, accuracy_document, folder, FILES, figures, json)


@app.command(sort_key=6)
def datasheet(
    pixel_file: Annotated[
        str | None,
        Parameter(
            name="PIXEL",
            completer=common.complete_technology,
            help=(
                "A technology (0.5um, 0.35um, 0.25um, 0.18um, 4t-bsi, 4t-fsi or the path of its"
                " TOML file), a TOML file with a "
                "table [pixel], or a packaged sensor (imx363, imx477). If left out, the options"
                " define the pixel."
            ),
        ),
    ] = None,
    *,
    config: common.Config = None,
    pixel: common.PixelTable = None,
    exposure: common.ExposureTable = None,
    wavelength_nm: Annotated[
        float | None, Parameter(help="Wavelength of the light [default: peak of the response].")
    ] = None,
    seed: Annotated[
        str | None,
        common.field_option(Run, "seed", help="Seed of the sensor and its noise [default: 0]."),
    ] = None,
    general: Annotated[
        bool,
        Parameter(
            help=(
                "Measure by EMVA 1288 General, too: the characteristic curve, and SNR at its input;"
                " for pixels of several readings and companded codes."
            )
        ),
    ] = False,
    figures: common.FigureFiles = "svg",
    out: Out = None,
    json: Json = False,
) -> None:
    """Measure a pixel by EMVA 1288 and ISO 15739.

    Example: pixsim datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 12

    Example: pixsim datasheet my_sensor.toml

    Example: pixsim datasheet --pixel.technology 4t-bsi --pixel.pitch-um 1.2 --seed 1

    Example: pixsim datasheet ovt_split_2p8um --general

    Simulates a photon-transfer experiment with one sensor of 200 × 200 pixels: 50 pairs of frames
    from dark to beyond saturation, stacks for the spatial terms, dark series over time and
    temperature. A black level below 6 σ of the dark signal is raised. Writes datasheet.csv,
    summary.json, figures/*.svg and *.csv and report.html.
    """
    from pixsim.measure.datasheet import DataSheet, datasheet_settings, make_datasheet
    from pixsim.report.datasheet import FILES, datasheet_document, sheet_name

    tables = without_none({"pixel": pixel, "exposure": exposure})
    settings = datasheet_settings(
        pixel_file, config or [], tables.get("pixel"), tables.get("exposure"), seed
    )

    def measure(stage: Stage) -> DataSheet:
        return make_datasheet(
            settings.pixel,
            settings.exposure,
            stage=stage,
            wavelength_nm=wavelength_nm,
            seed=settings.seed,
            general=general,
        )

    write_answer(
        measure,
        datasheet_document,
        out or DEFAULT_OUT / sheet_name(settings.pixel),
        FILES,
        figures,
        json,
    )


@app.command(sort_key=5)
def lens(
    file: Annotated[
        str,
        Parameter(
            name="FILE",
            help=(
                "A lens: cooke_triplet, double_gauss, phone or singlet; or the path of a .zmx or"
                " .toml file."
            ),
            completer=common.complete_lens,
        ),
    ],
    *,
    focal_length_mm: Annotated[
        float | None,
        Parameter(help="Scale the whole lens to this focal length [default: the file's]."),
    ] = None,
    f_number: Annotated[
        float | None, Parameter(help="Stop the lens down [default: the file's f-number].")
    ] = None,
    field_deg: Annotated[
        float | None, Parameter(help="Largest field angle [default: the file's].")
    ] = None,
    refocus: Annotated[
        Literal["paraxial", "axis", "field"] | None,
        Parameter(
            help=(
                "Move the image plane: to the paraxial focus, to the least rms wavefront on the"
                " axis or over the field "
                "[default: the file's plane, or axis if an object distance or --focus-nm is given]."
            )
        ),
    ] = None,
    focus_nm: Annotated[
        float | None, Parameter(help="Wavelength of that focus [default: the file's wavelengths].")
    ] = None,
    object_distance_m: Annotated[
        float | None,
        Parameter(help="Distance of the object from the entrance pupil [default: infinite]."),
    ] = None,
    wavelength_nm: Annotated[
        list[float] | None,
        common.SEVERAL,
        Parameter(
            help=(
                "Wavelengths of equal weight, such as --wavelength-nm 450,550 [default: the"
                " file's]."
            )
        ),
    ] = None,
    pitch_um: Annotated[
        float | None,
        Parameter(help="Pixel pitch; its Nyquist frequency is added to 10, 30 and 60 lp/mm."),
    ] = None,
    configuration: Annotated[str | None, field_option(LensOptions, "configuration")] = None,
    semi_diameters: Annotated[str | None, field_option(LensOptions, "semi_diameters")] = None,
    vignetting_factors: Annotated[
        str | None, field_option(LensOptions, "vignetting_factors")
    ] = None,
    glass_catalogues: Annotated[
        list[str] | None,
        Parameter(
            help=(
                "A glass catalogue in the format of Zemax, such as my.agf, which is searched"
                " before pixsim's table. Repeatable."
            ),
            metavar="FILE",
        ),
    ] = None,
    unknown_glass: Annotated[str | None, field_option(LensOptions, "unknown_glass")] = None,
    reflectance: Annotated[
        float | None,
        Parameter(
            help=(
                "Reflectance of the coating of surfaces in air, for light that they reflect twice"
                " [default: bare glass]."
            )
        ),
    ] = None,
    figures: common.FigureFiles = "svg",
    out: Out = None,
    json: Json = False,
) -> None:
    """Trace a lens: spots, MTF, distortion, chief rays.

    Example: pixsim lens cooke_triplet

    Example: pixsim lens phone --pitch-um 1.12

    Example: pixsim lens my_lens.zmx --focal-length-mm 4.2 --f-number 2.8 --refocus field

    The lens is as in its file unless the options change it. Writes report.html, summary.json and
    figures/*.svg and *.csv.
    """
    from pixsim.measure.lens import LensData, lens as trace
    from pixsim.report.lens import FILES, lens_document

    stated_options = without_none(
        {
            "configuration": configuration,
            "semi_diameters": semi_diameters,
            "vignetting_factors": vignetting_factors,
            "glass_catalogues": glass_catalogues,
            "unknown_glass": unknown_glass,
        }
    )
    reading_options: LensOptions = checked(LensOptions, [Layer({"file": file, **stated_options})])

    def measure(stage: Stage) -> LensData:
        return trace(
            file,
            focal_length_mm=focal_length_mm,
            f_number=f_number,
            field_deg=field_deg,
            refocus=refocus,
            focus_nm=focus_nm,
            object_distance_m=object_distance_m,
            wavelength_nm=wavelength_nm or (),
            pitch_um=pitch_um,
            reflectance=reflectance,
            progress=stage,
            **{name: getattr(reading_options, name) for name in stated_options},
        )

    write_answer(
        measure, lens_document, out or DEFAULT_OUT / f"lens-{Path(file).stem}", FILES, figures, json
    )


@app.command(sort_key=7)
def sfr(
    image: Annotated[
        Path,
        Parameter(
            help=(
                "A linear picture, grey, RGB or a mosaic: raw.exr of `pixsim run`, another .exr,"
                " .npy, .npz, .png of "
                "16 bits, or .tiff of 16 bits or in floating point."
            )
        ),
    ],
    *,
    pitch_um: Annotated[
        float | None, Parameter(help="Pixel pitch, for cycles/mm [default: from the file].")
    ] = None,
    channel: Annotated[
        str | None,
        Parameter(
            help=(
                "Channel of a colour picture: R, G, B or another letter of its filters,"
                " luminance, or a position in the mosaic such as 0,1 (row,column) [default:"
                " luminance of RGB; a mosaic has none]."
            ),
            metavar="CHANNEL",
        ),
    ] = None,
    layout: Annotated[
        str | None,
        Parameter(
            help=(
                "Colour filters of a mosaic, upper row first, such as RG/GB; R+G+B for planes one"
                " below the other [default: from the file]."
            ),
            metavar="ROWS",
        ),
    ] = None,
    black_level_dn: Annotated[
        float | None,
        Parameter(
            name=["--black", "--black-level-dn"],
            help="Black level, which affects the contrast only [default: from the file, or 0].",
            metavar="DN",
        ),
    ] = None,
    saturation: Annotated[
        float | None,
        Parameter(
            help=(
                "Stored value from which on a pixel counts as saturated [default: the file's"
                " white level or bits]."
            ),
            metavar="DN",
        ),
    ] = None,
    region: Annotated[
        str | None,
        Parameter(
            help=(
                "Region of the edge, x0,y0,x1,y1 in pixels from the upper left; x1 and y1 are"
                " excluded."
            ),
            metavar="X0,Y0,X1,Y1",
        ),
    ] = None,
    figures: common.FigureFiles = "svg",
    out: Out = None,
    json: Json = False,
) -> None:
    """Measure the SFR of a slanted edge by ISO 12233.

    Example: pixsim run slanted_edge

    Example: pixsim sfr pixsim-out/slanted_edge/raw.exr

    Writes report.html, sfr.csv, sfr.svg, edge_spread.csv, edge_spread.svg and summary.json.
    """
    from pixsim.measure.sfr import EdgeResponse, sfr as measure_sfr
    from pixsim.report.sfr import FILES, sfr_document

    def measure(_: Stage) -> EdgeResponse:
        return measure_sfr(
            image,
            pitch_um=pitch_um,
            channel=channel,
            layout=layout,
            black=black_level_dn,
            saturation=saturation,
            region=corners(region),
        )

    write_answer(
        measure, sfr_document, out or DEFAULT_OUT / f"{image.stem}-sfr", FILES, figures, json
    )


def corners(region: str | None) -> tuple[int, int, int, int] | None:
    """Parse `x0,y0,x1,y1`."""
    if region is None:
        return None
    try:
        x0, y0, x1, y1 = (int(number) for number in region.split(","))
    except ValueError:
        raise invalid(
            "--region", f"'{region}'", "x0,y0,x1,y1 in whole pixels, as in --region 100,0,400,512"
        ) from None
    return x0, y0, x1, y1


@app.command(sort_key=9)
def chart(
    kind: Annotated[
        str,
        Parameter(
            help=(
                "csf, flat, siemens_star, slanted_edge, target; or a picture: PNG, JPEG, TIFF, HDR,"
                " EXR."
            )
        ),
    ],
    *,
    output: Annotated[
        Path, Parameter(name=["-o", "--output"], help="Linear float32 EXR; row 0 is the top.")
    ],
    width: Annotated[int | None, Parameter(help="Width in texels.")] = None,
    height: Annotated[int | None, Parameter(help="Height in texels.")] = None,
    die_mm: Annotated[
        float | None,
        Parameter(help="Width of the die that the chart fills (csf, target) [default: 2.7136]."),
    ] = None,
    shape: Annotated[
        Literal["disc", "bar", "edge", "lines"] | None,
        Parameter(help="Shape of a target: disc, bar, edge, or lines with a gap in the middle."),
    ] = None,
    size_um: Annotated[
        float | None,
        Parameter(
            help=(
                "Diameter of a target, or width of bar and lines, on the sensor; the die is square"
                " [default: 77.5]."
            )
        ),
    ] = None,
    length_um: Annotated[
        float | None,
        Parameter(help="Length of a bar [default: 5 widths], or of a gap [default: a width]."),
    ] = None,
    contrast: Annotated[
        float | None,
        Parameter(
            help=(
                "Luminance of a target over that of its background, minus 1 [default: -0.1; a gap"
                " is as bright as what is between the lines]."
            )
        ),
    ] = None,
    line_contrast: Annotated[
        float | None,
        Parameter(help="Luminance of lines over that of what is between, minus 1 [default: -0.5]."),
    ] = None,
    direction: Annotated[
        Literal["vertical", "horizontal"] | None,
        Parameter(
            help="Direction of a target that is a bar, an edge, or lines [default: vertical]."
        ),
    ] = None,
    colour_axis: Annotated[
        Literal["red-green", "blue-yellow"] | None,
        Parameter(
            help=(
                "Write a scene, .xml, whose chart (csf) changes in colour at constant luminance,"
                " with its three slides."
            )
        ),
    ] = None,
    linear: Annotated[bool, Parameter(help="The picture is linear in light, not sRGB.")] = False,
    aspect: Annotated[
        float | None,
        Parameter(
            help=(
                "Width over height of the die for a picture; a grey border fills the rest"
                " [default: 1]."
            )
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Make a chart, also from a picture, as a texture.

    Example: pixsim chart siemens_star -o star.exr

    Example: pixsim chart target --shape bar --size-um 40 --contrast 0.2 -o bar.exr

    Example: pixsim chart picture.png -o picture.exr

    Example: pixsim chart csf --colour-axis red-green -o red_green.xml

    A picture becomes its luminance, linear in light: 0.2126 R + 0.7152 G + 0.0722 B of decoded
    sRGB. -D chart=picture.png does the same.

    A target stands in the middle of an even background of 1.
    `pixsim run target -D shape=bar -D size_um=40` needs no file, and draws it on the cells of the
    film.

    With --colour-axis, one opponent channel of S-CIELAB changes, and the other two are constant.
    `pixsim run red_green.xml` renders the scene.
    """
    from pixsim.report.chart import chart_document

    options = without_none(
        {
            "width": width,
            "height": height,
            "die_mm": die_mm,
            "shape": shape,
            "size_um": size_um,
            "length_um": length_um,
            "contrast": contrast,
            "line_contrast": line_contrast,
            "direction": direction,
            "colour_axis": colour_axis,
            "linear": linear or None,
            "aspect": aspect,
        }
    )
    answer(chart_document(kind, output, options), json)


@app.command(sort_key=11)
def template(
    kind: Annotated[
        str,
        Parameter(
            help=(
                "sensor, for `pixsim run SCENE --config FILE` and `pixsim datasheet FILE`; or"
                " study, for `pixsim study FILE`."
            )
        ),
    ],
    *,
    of: Annotated[
        str | None,
        Parameter(
            help=(
                "For a study: copy a packaged one (pixel-size, chen2000, chen2000-sensitivity,"
                " modern, colour, processing)."
            ),
            metavar="STUDY",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        Parameter(name=["-o", "--output"], help="TOML file [default: to standard output]."),
    ] = None,
    json: Json = False,
) -> None:
    """Write a commented configuration file, or a study.

    Example: pixsim template sensor -o my_sensor.toml

    Example: pixsim template study -o my_study.toml

    Example: pixsim template study --of pixel-size -o my_study.toml
    """
    from pixsim.report.templates import template_document

    answer(template_document(kind, of, output), json)


@app.command(sort_key=12)
def schema(
    kind: Annotated[str, Parameter(help="sensor or study.")] = "sensor", *, json: Json = True
) -> None:
    """Print the JSON schema of a configuration file.

    Example: pixsim schema study > study.schema.json
    """
    from pixsim.report.templates import json_schema
    from pixsim.show.document import Document

    answer(Document("schema", "JSON schema", kind, json_schema(kind)), json)


@app.command(sort_key=14)
def cache(
    *,
    clear: Annotated[bool, Parameter(help="Remove the entries.")] = False,
    kind: Annotated[
        str | None,
        Parameter(
            metavar="KIND", help="Only entries of this kind; `pixsim cache` lists the kinds."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Show or clear the cache.

    Example: pixsim cache --clear

    The key of an entry is the hash of all its inputs, so that entries are never out of date;
    clearing only frees space. Files that pixsim did not write stay. PIXSIM_CACHE_DIR sets the
    folder, PIXSIM_CACHE_GIB its size limit (default 4; 0 disables the cache). The least recently
    used entries are removed first. Mitsuba's kernels and Matplotlib's fonts are in the same folder,
    as kinds of their own.
    """
    from pixsim.report.inventory import cache_document

    answer(cache_document(kind, clear), json)


@app.command(sort_key=10)
def cameras(*, json: Json = False) -> None:
    """List measured cameras and typical filters.

    Example: pixsim cameras

    Measured ones are of whole cameras with their infrared filter. Typical ones stand for sensors of
    a kind, and are marked so.
    """
    from pixsim.report.inventory import cameras_document
    from pixsim.sensor import camera_data

    answer(cameras_document(camera_data.cameras(), camera_data.SOURCES), json)


@app.command(sort_key=15)
def completion(
    shell: Annotated[
        Literal["bash", "zsh", "fish"],
        Parameter(help="bash, zsh (into a folder of $fpath, as _pixsim) or fish."),
    ],
    *,
    json: Json = False,
) -> None:
    """Print the script for shell completion.

    Example: pixsim completion bash > ~/.local/share/bash-completion/completions/pixsim

    Example: pixsim completion fish > ~/.config/fish/completions/pixsim.fish
    """
    from pixsim.show.document import Document

    script = app.generate_completion(prog_name="pixsim", shell=shell)
    answer(
        Document(
            "completion", "shell completion", shell, {"shell": shell, "script": script}, (script,)
        ),
        json,
    )


_PROBLEM_FOUND = 1  # exit code


@app.command(sort_key=13)
def doctor(
    *,
    out: Out = None,
    limit_s: Annotated[
        float | None, Parameter(help="Time limit of the test render, in s [default: 20].")
    ] = None,
    json: Json = False,
) -> None:
    """Check this machine; say how to mend what it lacks.

    A test render is compared with its closed form.

    Example: pixsim doctor

    A line is marked ok, note (renders work nevertheless) or problem. The exit code is 1 if there is
    a problem, else 0.
    """
    from pixsim.cli.doctor import doctor_document, examine

    document = doctor_document(examine(out or DEFAULT_OUT, limit_s))
    answer(document, json)
    if not document.data["ok"]:
        sys.exit(_PROBLEM_FOUND)
