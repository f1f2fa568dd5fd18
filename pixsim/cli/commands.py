"""The commands of `pixsim`."""

from __future__ import annotations

import io
import os
import shutil
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from cyclopts import Parameter

from pixsim.base.caller import command_line
from pixsim.base.errors import UnwritableError, invalid
from pixsim.base.files import check_replaceable, output_folder, told_of_finished_files, write_made_from
from pixsim.base.layers import Layer
from pixsim.base.lazy import import_less
from pixsim.base.notes import collected_notes, warn
from pixsim.base.records import checked
from pixsim.cli import options as common
from pixsim.cli.options import DEFAULT_OUT, HELP, HELP_ALL, Json, Out, SceneOptions, answer, app, field_option, given, say, stages
from pixsim.cli.process import interruption
from pixsim.optics.lens_options import LensOptions
from pixsim.studies.settings import study_layers
from pixsim.viewer.setting import Run

RawFormat = Literal["tiff", "png", "npz"]
RAW_FORMATS = get_args(RawFormat)
TWO_FOLDERS = 2  # of results that are compared
SCENE_HELP = (
    "An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, target, macbeth, line_lamp, still_life, "
    "cornell_box, yard."
)


def run_command(tokens: Sequence[str]) -> None:
    """Run a command; the exceptions that end it are reported by `pixsim.cli.main`.

    tokens : its name and arguments
    """
    if isinstance(getattr(sys.stdout, "buffer", None), io.FileIO):  # by PYTHONUNBUFFERED: a signal would cut what a pipe delays
        sys.stdout = open(1, "w", encoding=sys.stdout.encoding, closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # file names may not be UTF-8
            stream.reconfigure(errors="backslashreplace")
    widen_terminal()
    arguments = common.verbosity.parse(tokens)
    check_current_folder()
    warnings.showwarning = lambda message, *_, **__: common.verbosity.warning(message)
    common.set_cache_folders()
    interruption.begin()
    try:
        # Notes also of the settings, before a result collects its own.
        with command_line(), collected_notes(), told_of_finished_files(interruption.end_or_raise):
            arguments = with_whole_options(with_each_format(arguments))
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


LEAST_WIDTH = 40  # columns, for which help and tables are laid out in a narrower terminal


def widen_terminal() -> None:
    """Let help and tables have some columns where the terminal, or COLUMNS, states none or very few: they would not end."""
    stated = os.environ.get("COLUMNS")
    if shutil.get_terminal_size().columns < LEAST_WIDTH:
        os.environ["COLUMNS"] = str(LEAST_WIDTH)
    elif stated is not None and not (stated.isdecimal() and int(stated) >= LEAST_WIDTH):
        del os.environ["COLUMNS"]


def with_each_format(arguments: Sequence[str]) -> list[str]:
    """Write `--raw tiff png` as `--raw tiff --raw png`: a list that takes all that follows would take the scene too."""
    written: list[str] = []
    for argument in arguments:
        in_list = argument in RAW_FORMATS and written[-2:-1] == ["--raw"]
        written += ["--raw", argument] if in_list else [argument]
    return written


WHOLE_OPTIONS = {"--lens": "--lens.file", "--metric": "--metrics"}


def with_whole_options(arguments: Sequence[str]) -> list[str]:
    """Write `--lens phone` as `--lens.file phone`: cyclopts takes no `--lens.refocus` beside a value of `--lens`."""
    written = []
    for argument in arguments:
        name, equals, value = argument.partition("=")
        written.append(f"{WHOLE_OPTIONS.get(name, name)}{equals}{value}" if argument.startswith("--") else argument)
    return written


def check_current_folder() -> None:
    """Raise PixsimError if the current folder is gone: paths are relative to it, and libraries fail to load."""
    try:
        os.getcwd()
    except OSError as error:
        got = f"one that is gone ({error.strerror})"
        raise invalid("current folder", got, "a folder that exists", "Change to another one: cd ~") from None


Units = Annotated[
    str | None, Parameter(help="Units of an image whose file does not state them, such as W.m^-2.nm^-1.", metavar="UNIT")
]


@app.command(sort_key=0)
def run(
    scene: Annotated[
        str,
        Parameter(
            help=f"{SCENE_HELP} Or a spectral image of another program (.exr, .npz, .hdr), as seen by the camera.",
            completer=common.complete_picture,
        ),
    ],
    *,
    options: SceneOptions = common.NO_OPTIONS,
    display: common.DisplayTable = None,
    judges: common.Judges = common.NO_JUDGES,
    seed: common.Seed = None,
    tolerance_e: common.Tolerance = None,
    effort: common.EffortOptions = common.NO_EFFORT,
    full: common.Full = False,
    noise_budget: common.NoiseBudget = None,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    units: Units = None,
    raw: Annotated[
        list[RawFormat] | None, common.SEVERAL, Parameter(help="Also write the raw frame in these formats, as --raw tiff,png.")
    ] = None,
    repeats: Annotated[
        int,
        Parameter(
            help="Number of sensors of this kind, each with a fixed pattern and noise of its own and at another registration with "
            "the picture: the answer is the mean of their ΔE with its 95 % interval. Pictures and frames are of the first, which "
            "is centred. With --tolerance-delta-e, at least so many."
        ),
    ] = 1,
    frames: Annotated[
        int,
        Parameter(
            help="Number of raw frames of this sensor: all have its fixed pattern, each has temporal noise of its own. The first, "
            "raw.exr, is scored; the others are raw_002.exr, … (and the formats of --raw)."
        ),
    ] = 1,
    irradiance: Annotated[
        Literal["reduced", "full", "factors", "none"],
        Parameter(
            help="What irradiance.exr holds: spectral bands as means over larger samples (at most 1024 across, 60 MB), all samples "
            "(read back bit for bit), only the factors (spectra × pictures; bands in full where an image has none), or no file."
        ),
    ] = "reduced",
    dry_run: common.DryRun = False,
    out: Out = None,
    json: Json = False,
) -> None:
    """Render a scene, sense it, and score the picture.

    Example: pixsim run csf --pixel.pitch-um 5.6 --camera.f-number 2.8

    Example: pixsim run picture.exr --units W.m^-2.sr^-1.nm^-1

    Example: pixsim run csf --repeats 8

    Writes irradiance.exr, raw.exr (and the formats of --raw), ideal.png, image.png, delta_e.exr, delta_e.png, score.json,
    settings.toml and report.html, or keeps them where they would be the same. `pixsim run SCENE --config settings.toml` repeats it.
    """
    import_less()
    from pixsim.report.kept import kept_run
    from pixsim.report.run import RunFiles, digest_of_run, run_document, run_page
    from pixsim.show.render import text, write
    from pixsim.studies.run import check_raw, light_run, prepare, score_run

    own = {"seed": seed, "tolerance_e": tolerance_e, "noise_budget": noise_budget}
    chosen = options.settings(effort, display=display, **own, **vars(judges))
    folder, raw_suffixes = out or DEFAULT_OUT / Path(scene).stem, [f".{suffix}" for suffix in raw or []]
    check_raw(chosen, raw_suffixes)
    files = RunFiles(tuple(raw_suffixes), irradiance, chosen.noise_budget)
    if not dry_run:
        check_replaceable(folder, files.names(frames))
    prepared = prepare(scene, chosen, full=full, repeats=repeats, frames=frames, sensor=sensor, variant=variant, units=units)
    if dry_run:
        from pixsim.report.outline import outline_document, run_outline

        answer(outline_document("run", run_outline(prepared), folder), json)
        return
    seconds: dict[str, float] = {}
    with output_folder(folder), stages(seconds) as stage:  # an invalid folder fails before the render
        lit = light_run(prepared, stage)
        made_from = digest_of_run(lit, files)
        if kept := kept_run(folder, made_from):
            document, warned = kept
            for note in warned:
                if note not in lit.warned:  # the others were given now
                    warn(note)
        else:
            result = score_run(lit, stage)
            document = run_page(result, files, stage("write"))
            write(document, folder, {"seconds": seconds})
            document = run_document(result, warned=result.warned)
            stored = [note.as_dict() for note in result.warned]
            said: dict[str, list[Any]] = {"lines": text(document).splitlines(), "warned": stored}
            write_made_from(folder, "run", made_from, said)
    answer(document, json, f"report: {folder / 'report.html'}")


@app.command(sort_key=3)
def explore(
    scene: Annotated[
        str,
        Parameter(
            help=f"{SCENE_HELP} Or a spectral image of another program (.exr, .npz, .hdr).", completer=common.complete_picture
        ),
    ] = "csf",
    *,
    options: SceneOptions = common.NO_OPTIONS,
    display: common.DisplayTable = None,
    judges: common.Judges = common.NO_JUDGES,
    seed: common.Seed = None,
    tolerance_e: common.Tolerance = None,
    effort: common.EffortOptions = common.NO_EFFORT,
    sensor: common.SensorId = None,
    variant: common.Variant = None,
    units: Units = None,
    browser: Annotated[
        bool, Parameter(help="Open no browser: print the file that leads to the page.", negative="--no-browser")
    ] = True,
) -> None:
    """See on a page what a sensor makes of a scene.

    Example: pixsim explore csf --config my_sensor.toml

    It ends when the page is closed, or by Ctrl-C. It reads no other files than those named here, and serves this user alone.
    """
    from pixsim.explorer.exploring import check_installed

    check_installed()
    from pixsim.explorer.server import explore_until_closed
    from pixsim.explorer.session import Session

    tables = options.tables(effort, display=display, seed=seed, tolerance_e=tolerance_e, **vars(judges))
    given_here = {"sensor": sensor, "variant": variant, "units": units}
    session = Session(scene, options.config or (), tables, given_here)
    explore_until_closed(session, None if browser else lambda file: say(f"page: {file}\n"))


@app.command(sort_key=4)
def plan(
    scene: Annotated[str, Parameter(help=SCENE_HELP, completer=common.complete_scene)],
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
    import_less()
    from pixsim.report.outline import plan_document
    from pixsim.studies.lights import plan_of
    from pixsim.studies.prepare import loaded_scene

    chosen = options.settings(tolerance_e=tolerance_e)
    loaded = loaded_scene(scene, chosen.scene, chosen.resolution, chosen.display, variant=variant, sensor=sensor)
    made = plan_of(loaded, loaded.camera(chosen.camera, chosen.lens), chosen, full)
    answer(plan_document(made, scene, chosen), json)


@app.command(sort_key=1)
def study(
    study: Annotated[
        str,
        Parameter(
            help="A TOML file, or the name of a packaged study: pixel-size, chen2000, chen2000-sensitivity, modern, colour, "
            "processing.",
            completer=common.complete_study,
        ),
    ],
    *,
    scene: Annotated[
        str | None,
        Parameter(help=f"{SCENE_HELP} [default: that of the study]", metavar="NAME|FILE", completer=common.complete_scene),
    ] = None,
    options: common.StudyOptions = common.NO_STUDY_OPTIONS,
) -> None:
    """Find the pixel size with the least visible error.

    Example: pixsim study chen2000 --quick

    Example: pixsim study chen2000 --pixel.response scaled --out scaled

    Example: pixsim study pixel-size --config my_sensor.toml --scene still_life --pitch.min-um 2 --quick

    Example: pixsim study pixel-size --axis camera.f_number=2,2.8,4 --quick

    Writes results.csv, settings.toml, summary.json, figures (with a contact sheet), provenance.json and report.html. The same
    command continues an interrupted study, and draws no report again that would show the same; `pixsim study settings.toml`
    repeats it.
    """
    import_less()
    from pixsim.report.axes import axes_document, axes_files, study_report
    from pixsim.report.kept import digest_of_report, keep_or_write
    from pixsim.report.outline import outline_document, study_outline
    from pixsim.report.study import report_files, study_document
    from pixsim.report.uncertainty import uncertainty_files
    from pixsim.show.figures import ready_to_draw
    from pixsim.show.render import write
    from pixsim.studies.design import MANY_CASES, MAX_CASES, check_number, number_of_cases
    from pixsim.studies.dry_run import fitting_jobs
    from pixsim.studies.engine import Workers, workers_here
    from pixsim.studies.files import checked_study, config_layers, read_study, uncertainty_of
    from pixsim.studies.prepare import asked_of, check_types, prepare
    from pixsim.studies.regret import condition_regrets
    from pixsim.studies.result import CasesResult
    from pixsim.studies.study import run_prepared

    stated = read_study(study, options.quick)
    config = options.scene_options.config or []
    jobs, scheduler, figures = options.jobs, options.scheduler, options.figures
    files = config_layers(config)
    tables = options.scene_options.study_tables(scene, options.effort, **options.settings)
    tables |= options.axes([*stated, *files])
    with collected_notes():  # also of what is found before the study begins
        layers = study_layers(stated, files, tables)
        seconds: dict[str, float] = {}
        suffix = "-quick" if options.quick else ""
        plan = checked_study(layers, tables)
        folder = options.out or DEFAULT_OUT / f"{plan.name}{suffix}"
        spreads = uncertainty_of(study, config, options.quick)
        if MANY_CASES < (cases := number_of_cases(plan)) <= MAX_CASES:
            common.verbosity.note(f"{cases} cases are checked, each by itself")
        job = prepare(plan, options.variant)
        asked, types = asked_of(options.uncertainty, options.sobol, options.smaller_than or (), spreads), 0
        if asked is not None:
            types, evaluations = check_types(
                job.complete, [case.settings for case in job.combinations], asked, options.yes or options.dry_run
            )
        if options.dry_run:
            answer(outline_document("study", study_outline(job, jobs, types), folder), options.json)
            return
        check_number(len(job.combinations), job.evaluations, options.yes)
        names = (axes_files if job.complete.has_cases else report_files)(job.complete)
        if asked is not None:
            common.verbosity.note(f"{types} sensor types, at most {evaluations} evaluations")
            names = names | uncertainty_files()
        check_replaceable(folder, names)
        with stages(seconds) as stage:
            with said_what_is_kept(folder):
                result = run_prepared(
                    job,
                    folder,
                    jobs=jobs,
                    scheduler=scheduler,
                    progress=ready_to_draw(stage),
                    agreed=options.yes,
                    spreads=spreads,
                    asked=asked,
                )
                stage("report")
                first = result.cases[0]
                drawing = workers_here(jobs or fitting_jobs(first.study, first.camera)) if scheduler is None else Workers()
                found = condition_regrets(result.study, result.curves)

                def write_report() -> Path:
                    return write(study_report(result, found, seconds, drawing, figures), folder, {"seconds": seconds}, figures)

                report = keep_or_write("study", digest_of_report(result, figures), folder, write_report)
            warned = set(result.warned)  # they are on stderr
            if isinstance(result, CasesResult):
                document = axes_document(result, found, warned)
                common.verbosity.note(str(result.counts))
            else:
                document = study_document(result, warned)
    answer(document, options.json, f"report: {report}")


@contextmanager
def said_what_is_kept(folder: Path) -> Iterator[None]:
    """Add to an interruption, or the error of a full disk, how many evaluations of this study lie in its folder, if any.

    A study rewrites a file of rows when it begins to evaluate, and leaves its own rows only. Those of a file that it has not
    rewritten yet may be of other settings: they are not counted.
    """
    from pixsim.studies.table import Store

    def files() -> dict[Path, int]:
        path = folder / "results.csv"
        return {path: path.stat().st_mtime_ns} if path.is_file() else {}

    before = files()
    try:
        yield
    except (KeyboardInterrupt, UnwritableError) as error:
        kept = sum(len(Store(path).read_keys()) for path, time_ns in files().items() if before.get(path) != time_ns)
        words = [f"{kept} finished evaluations are kept in '{folder}', and the same command continues from them"] if kept else []
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(*words) from None
        raise UnwritableError(" ".join([str(error), *(f"{text}." for text in words)])) from None


@app.command(sort_key=2)
def compare(
    *sensors: Annotated[
        str,
        Parameter(
            help="Two or more sensors: TOML files with a table [pixel], such as data sheets; files of technologies, or names of "
            "packaged ones. The first is the reference. Or two folders of results of the same light, whose frames are paired.",
            completer=common.complete_technology,
            metavar="SENSOR",
        ),
    ],
    scene: Annotated[
        str | None,
        Parameter(help=f"{SCENE_HELP} [default: that of --study, or csf]", metavar="NAME|FILE", completer=common.complete_scene),
    ] = None,
    study: Annotated[
        str | None,
        Parameter(
            help="A TOML file, or the name of a packaged study: its scene, display, exposure and conditions hold for all sensors, "
            "its lens for files that state none. Under conditions, their weighted mean is the answer; axes have one at each value.",
            metavar="NAME|FILE",
            completer=common.complete_study,
        ),
    ] = None,
    match: Annotated[
        Literal["view", "lens", "own"] | None,
        Parameter(
            help="Cameras: the field of view, f-number and object distance of the first file's; its focal length; or each file's "
            "own. The central field that all have in common is compared [default: view, and whether lens turns the answer]."
        ),
    ] = None,
    repeats: Annotated[
        int | None, Parameter(help="Pairs of frames, with the same seeds [default: 8, with --quick 4].", show_default=False)
    ] = None,
    sensor: common.SensorId = None,
    options: common.StudyOptions = common.NO_STUDY_OPTIONS,
) -> None:
    """Compare sensors in one scene, or two results.

    Example: pixsim compare a.toml b.toml

    Example: pixsim compare 0.35um 4t-bsi --pixel.pitch-um 5 -D luminance_cd_per_m2=10

    Example: pixsim compare a.toml b.toml --study day_and_night.toml

    Example: pixsim compare a.toml b.toml --uncertainty 64

    Example: pixsim compare pixsim-out/first pixsim-out/second

    Options of cameras, pixels, exposures and displays, and --config, hold for all sensors. Writes compare.json, pictures,
    settings.toml, the settings of each sensor, and report.html.
    """
    import_less()
    if len(sensors) == TWO_FOLDERS and all(Path(path).is_dir() for path in sensors):
        from pixsim.report.two_results import results_document
        from pixsim.studies.compare import compare_results

        answer(results_document(compare_results(*sensors)), options.json)
        return
    from pixsim.report.compare import check_output, comparison_document, comparison_outline_document, comparison_page
    from pixsim.show.render import write
    from pixsim.studies.compare import run_prepared
    from pixsim.studies.files import config_layers, read_study
    from pixsim.studies.sensors import prepare

    config = options.scene_options.config or []
    tables = options.scene_options.tables(options.effort, **options.settings)
    tables |= options.axes([*([] if study is None else read_study(study, options.quick)), *config_layers(config)])
    with collected_notes() as notes:
        job = prepare(
            sensors,
            scene,
            study=study,
            match=match,
            repeats=repeats,
            config=config,
            options=tables,
            sensor=sensor,
            variant=options.variant,
            uncertainty=options.uncertainty,
            sobol=options.sobol,
            quick=options.quick,
            smaller_than_um=options.smaller_than or (),
        )
        folder = options.out or DEFAULT_OUT / "-".join(job.names)
        if options.dry_run:
            answer(comparison_outline_document(job, folder), options.json)
            return
        check_output(job, folder)
        seconds: dict[str, float] = {}
        with output_folder(folder), stages(seconds) as stage:  # an invalid folder fails before the renders
            result = run_prepared(
                job, jobs=options.jobs, scheduler=options.scheduler, progress=stage, agreed=options.yes, out=folder
            )
            stage("report")
            report = write(comparison_page(result, folder), folder, {"seconds": seconds}, options.figures)
            document = comparison_document(result, notes)  # other notes are on stderr
    answer(document, options.json, f"report: {report}")


@app.command(sort_key=8)
def accuracy(
    scene: Annotated[str, Parameter(help=SCENE_HELP, completer=common.complete_scene)],
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
    import_less()
    from pixsim.report.accuracy import FILES, accuracy_document
    from pixsim.show.render import write
    from pixsim.verification.ladder import measure_accuracy

    settings = options.settings(display=display, seed=seed)
    folder = out or DEFAULT_OUT / f"{Path(scene).stem}-accuracy"
    check_replaceable(folder, FILES)
    with stages() as stage, output_folder(folder):  # an invalid folder fails before the work
        result = measure_accuracy(scene, settings, quick=quick, sensor=sensor, variant=variant, progress=stage)
        stage("report")
        document = accuracy_document(result)
        report = write(document, folder, figures=figures)
    answer(document, json, f"report: {report}")


@app.command(sort_key=6)
def datasheet(
    pixel_file: Annotated[
        str | None,
        Parameter(
            name="PIXEL",
            completer=common.complete_technology,
            help="A technology (0.5um, 0.35um, 0.25um, 0.18um, 4t-bsi, 4t-fsi or the path of its TOML file), a TOML file with a "
            "table [pixel], or a packaged sensor (imx363, imx477). If left out, the options define the pixel.",
        ),
    ] = None,
    *,
    config: common.Config = None,
    pixel: common.PixelTable = None,
    exposure: common.ExposureTable = None,
    wavelength_nm: Annotated[float | None, Parameter(help="Wavelength of the light [default: peak of the response].")] = None,
    seed: Annotated[str | None, common.field_option(Run, "seed", help="Seed of the sensor and its noise [default: 0].")] = None,
    figures: common.FigureFiles = "svg",
    out: Out = None,
    json: Json = False,
) -> None:
    """Measure a pixel by EMVA 1288 and ISO 15739.

    Example: pixsim datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 12

    Example: pixsim datasheet my_sensor.toml

    Example: pixsim datasheet --pixel.technology 4t-bsi --pixel.pitch-um 1.2 --seed 1

    Simulates a photon-transfer experiment with one sensor of 200 × 200 pixels: 50 pairs of frames from dark to beyond
    saturation, stacks for the spatial terms, dark series over time and temperature. A black level below 6 σ of the dark
    signal is raised. Writes datasheet.csv, summary.json, figures/*.svg and *.csv and report.html.
    """
    import_less()
    from pixsim.measure.datasheet import datasheet_settings, make_datasheet
    from pixsim.report.datasheet import FILES, datasheet_document, sheet_name
    from pixsim.show.render import write

    tables = given({"pixel": pixel, "exposure": exposure})
    settings = datasheet_settings(pixel_file, config or [], tables.get("pixel"), tables.get("exposure"), seed)
    folder = out or DEFAULT_OUT / sheet_name(settings.pixel)
    check_replaceable(folder, FILES)
    with output_folder(folder), stages() as stage:  # an invalid folder fails before the measurement
        own = settings.pixel, settings.exposure
        sheet = make_datasheet(*own, stage=stage, wavelength_nm=wavelength_nm, seed=settings.seed)
        stage("report")
        document = datasheet_document(sheet)
        report = write(document, folder, figures=figures)
    answer(document, json, f"report: {report}")


@app.command(sort_key=5)
def lens(
    file: Annotated[
        str,
        Parameter(
            name="FILE",
            help="A lens: cooke_triplet, double_gauss, phone or singlet; or the path of a .zmx or .toml file.",
            completer=common.complete_lens,
        ),
    ],
    *,
    focal_length_mm: Annotated[
        float | None, Parameter(help="Scale the whole lens to this focal length [default: the file's].")
    ] = None,
    f_number: Annotated[float | None, Parameter(help="Stop the lens down [default: the file's f-number].")] = None,
    field_deg: Annotated[float | None, Parameter(help="Largest field angle that is looked at [default: the file's].")] = None,
    refocus: Annotated[
        Literal["paraxial", "axis", "field"] | None,
        Parameter(
            help="Move the image plane: to the paraxial focus, to the least rms wavefront on the axis or over the field "
            "[default: the file's plane, or axis if an object distance or --focus-nm is given]."
        ),
    ] = None,
    focus_nm: Annotated[float | None, Parameter(help="Wavelength of that focus [default: those of the file].")] = None,
    object_distance_m: Annotated[
        float | None, Parameter(help="Distance of the object from the entrance pupil [default: infinite].")
    ] = None,
    wavelength_nm: Annotated[
        list[float] | None,
        common.SEVERAL,
        Parameter(help="Wavelengths of equal weight, as --wavelength-nm 450,550 [default: the file's]."),
    ] = None,
    pitch_um: Annotated[float | None, Parameter(help="Pixel pitch, whose Nyquist frequency joins 10, 30 and 60 lp/mm.")] = None,
    configuration: Annotated[str | None, field_option(LensOptions, "configuration")] = None,
    semi_diameters: Annotated[str | None, field_option(LensOptions, "semi_diameters")] = None,
    vignetting_factors: Annotated[str | None, field_option(LensOptions, "vignetting_factors")] = None,
    glass_catalogues: Annotated[
        list[str] | None,
        Parameter(
            help="A glass catalogue of yours as Zemax has it, as my.agf, before pixsim's table; give it once for each.",
            metavar="FILE",
        ),
    ] = None,
    unknown_glass: Annotated[str | None, field_option(LensOptions, "unknown_glass")] = None,
    reflectance: Annotated[
        float | None,
        Parameter(help="Reflectance of the coating of surfaces in air, for light that they reflect twice [default: bare glass]."),
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
    import_less()
    from pixsim.measure.lens import lens as traced
    from pixsim.report.lens import FILES, lens_document
    from pixsim.show.render import write

    reading = given(
        {
            "configuration": configuration, "semi_diameters": semi_diameters, "vignetting_factors": vignetting_factors,
            "glass_catalogues": glass_catalogues, "unknown_glass": unknown_glass,
        }
    )  # fmt: skip
    how: LensOptions = checked(LensOptions, [Layer({"file": file, **reading})])
    folder = out or DEFAULT_OUT / f"lens-{Path(file).stem}"
    check_replaceable(folder, FILES)
    with stages() as stage:
        data = traced(
            file,
            focal_length_mm=focal_length_mm,
            f_number=f_number,
            field_deg=field_deg,
            refocus=refocus,
            focus_nm=focus_nm,
            object_distance_m=object_distance_m,
            wavelength_nm=wavelength_nm or (),
            pitch_um=pitch_um,
            configuration=how.configuration,
            semi_diameters=how.semi_diameters,
            vignetting_factors=how.vignetting_factors,
            glass_catalogues=how.glass_catalogues,
            unknown_glass=how.unknown_glass,
            reflectance=reflectance,
            progress=stage,
        )
        stage("report")
        document = lens_document(data)
        report = write(document, folder, figures=figures)
    answer(document, json, f"report: {report}")


@app.command(sort_key=7)
def sfr(
    image: Annotated[
        Path,
        Parameter(
            help="A linear picture, grey, RGB or a mosaic: raw.exr of `pixsim run`, another .exr, .npy, .npz, .png of "
            "16 bits, or .tiff of 16 bits or in floating point."
        ),
    ],
    *,
    pitch_um: Annotated[float | None, Parameter(help="Pixel pitch, for cycles/mm [default: from the file].")] = None,
    channel: Annotated[
        str | None,
        Parameter(
            help="Channel of a picture in colour: R, G, B, or another letter of its filters, luminance, or a place of the "
            "mosaic as 0,1 (row,column) [default: luminance of RGB; a mosaic has none].",
            metavar="CHANNEL",
        ),
    ] = None,
    layout: Annotated[
        str | None,
        Parameter(
            help="Colour filters of a mosaic, upper row first, as RG/GB; R+G+B for planes one below the other "
            "[default: from the file].",
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
            help="Value as stored from which a pixel counts as saturated [default: the file's white level or bits].", metavar="DN"
        ),
    ] = None,
    region: Annotated[
        str | None,
        Parameter(
            help="Region of the edge, x0,y0,x1,y1 in pixels from the upper left; x1 and y1 are excluded.", metavar="X0,Y0,X1,Y1"
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
    from pixsim.measure.sfr import sfr as measured
    from pixsim.report.sfr import FILES, sfr_document
    from pixsim.show.render import write

    folder = out or DEFAULT_OUT / f"{image.stem}-sfr"
    check_replaceable(folder, FILES)
    response = measured(
        image,
        pitch_um=pitch_um,
        channel=channel,
        layout=layout,
        black=black_level_dn,
        saturation=saturation,
        region=corners(region),
    )
    document = sfr_document(response)
    answer(document, json, f"report: {write(document, folder, figures=figures)}")


def corners(region: str | None) -> tuple[int, int, int, int] | None:
    """Parse `x0,y0,x1,y1`."""
    if region is None:
        return None
    try:
        x0, y0, x1, y1 = (int(number) for number in region.split(","))
    except ValueError:
        raise invalid("--region", f"'{region}'", "x0,y0,x1,y1 in whole pixels, as in --region 100,0,400,512") from None
    return x0, y0, x1, y1


@app.command(sort_key=9)
def chart(
    kind: Annotated[str, Parameter(help="csf, flat, siemens_star, slanted_edge, target; or a picture: PNG, JPEG, TIFF, HDR, EXR.")],
    *,
    output: Annotated[Path, Parameter(name=["-o", "--output"], help="Linear float32 EXR; row 0 is the top.")],
    width: Annotated[int | None, Parameter(help="Width in texels.")] = None,
    height: Annotated[int | None, Parameter(help="Height in texels.")] = None,
    die_mm: Annotated[
        float | None, Parameter(help="Width of the die that the chart fills (csf, target) [default: 2.7136].")
    ] = None,
    shape: Annotated[
        Literal["disc", "bar", "edge"] | None, Parameter(help="Of a target: disc, bar (5 times as long as wide), or edge.")
    ] = None,
    size_um: Annotated[
        float | None, Parameter(help="Diameter or width of a target on the sensor; the die is square [default: 77.5].")
    ] = None,
    contrast: Annotated[
        float | None, Parameter(help="Luminance of a target over that of its background, minus 1 [default: -0.1].")
    ] = None,
    direction: Annotated[
        Literal["vertical", "horizontal"] | None, Parameter(help="Of a target that is a bar or an edge [default: vertical].")
    ] = None,
    colour_axis: Annotated[
        Literal["red-green", "blue-yellow"] | None,
        Parameter(help="Write a scene, .xml, whose chart (csf) changes in colour at constant luminance, with its three slides."),
    ] = None,
    linear: Annotated[bool, Parameter(help="The picture is linear in light, not sRGB.")] = False,
    aspect: Annotated[
        float | None, Parameter(help="Width over height of the die for a picture; a grey border fills the rest [default: 1].")
    ] = None,
    json: Json = False,
) -> None:
    """Make a chart, also from a picture, as a texture.

    Example: pixsim chart siemens_star -o star.exr

    Example: pixsim chart target --shape bar --size-um 40 --contrast 0.2 -o bar.exr

    Example: pixsim chart picture.png -o picture.exr

    Example: pixsim chart csf --colour-axis red-green -o red_green.xml

    A picture becomes its luminance, linear in light: 0.2126 R + 0.7152 G + 0.0722 B of decoded sRGB. -D chart=picture.png does
    the same.

    A target stands in the middle of an even background of 1. `pixsim run target -D shape=bar -D size_um=40` needs no file, and
    draws it on the cells of the film.

    With --colour-axis, one opponent channel of S-CIELAB changes, and the other two are constant. `pixsim run red_green.xml` renders
    the scene.
    """
    from pixsim.scene import charts, colour_chart, own_chart
    from pixsim.show.document import Document

    of_target = {"shape": shape, "size_um": size_um, "contrast": contrast, "direction": direction}
    of_target = {name: value for name, value in of_target.items() if value is not None}
    if of_target and kind != "target":
        raise invalid("--" + ", --".join(of_target).replace("_", "-"), f"with {kind}", "the chart target")
    if colour_axis is not None:
        if kind != "csf" or linear or aspect is not None:
            raise invalid("--colour-axis", f"with {kind}{', --linear or --aspect' if kind == 'csf' else ''}", "the chart csf")
        result = colour_chart.write_colour_axis(colour_axis, output, width, height, die_mm)
        contrasts = ", ".join(f"{name} {value:+.3f}" for name, value in result["contrasts"].items())
        line = f"{output} with slides {', '.join(result['slides'])}; contrasts up to {contrasts}"
        line += f"; opponent channel ±{result['opponent_amplitude']:.3f} of white's luminance channel"
        answer(Document("chart", "chart in colour", str(output), result, (line,)), json)
        return
    share = 0.0
    if Path(kind).suffix.lower() in own_chart.SUFFIXES:
        if not (width is height is die_mm is None):
            got = f"with the picture '{kind}'"
            raise invalid("--width, --height, --die-mm", got, "the charts of pixsim; pictures keep their size")
        if aspect is not None and not 1e-3 <= aspect <= 1e3:
            raise invalid("--aspect", f"{aspect:g}", "0.001 to 1000")
        texels, share = own_chart.with_border(own_chart.read_luminance(kind, linear), 1.0 if aspect is None else aspect)
    elif linear or aspect is not None:
        raise invalid("--linear, --aspect", f"with the chart {kind}", "a picture")
    else:
        texels = charts.make_chart(kind, width, height, die_mm, **of_target)
    charts.write_chart(output, texels)
    result = {"file": str(output), "kind": Path(kind).name, "width": texels.shape[1], "height": texels.shape[0], "border": share}
    border = f", {100 * share:.3g} % of them a grey border that keeps the picture's aspect" if share else ""
    line = f"{result['width']} × {result['height']} texels in {output}{border}"
    answer(Document("chart", "chart", str(output), result, (line,)), json)


@app.command(sort_key=11)
def template(
    kind: Annotated[
        str,
        Parameter(
            help="sensor, for `pixsim run SCENE --config FILE` and `pixsim datasheet FILE`; or study, for `pixsim study FILE`."
        ),
    ],
    *,
    of: Annotated[
        str | None,
        Parameter(
            help="For a study: copy a packaged one (pixel-size, chen2000, chen2000-sensitivity, modern, colour, processing).",
            metavar="STUDY",
        ),
    ] = None,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"], help="TOML file [default: to standard output].")] = None,
    json: Json = False,
) -> None:
    """Write a commented configuration file, or a study.

    Example: pixsim template sensor -o my_sensor.toml

    Example: pixsim template study -o my_study.toml

    Example: pixsim template study --of pixel-size -o my_study.toml
    """
    from pixsim.base.files import write_new
    from pixsim.cli import templates
    from pixsim.show.document import Document

    if of is not None and kind != "study":
        raise invalid("--of", f"'{of}' with {kind}", "a packaged study, with `pixsim template study`")
    text = templates.template(kind) if of is None else templates.packaged_study(of)
    if output is None:
        answer(Document("template", "template", kind, {"template": text}, (text.rstrip(),)), json)
        return
    if output.suffix != ".toml":
        raise invalid("--output", f"'{output}'", "a name that ends in .toml")
    write_new(output, text)
    use = f"pixsim run csf --config {output}" if kind == "sensor" else f"pixsim study {output}"
    line = f"{output} written. Replace the numbers, then run: {use}"
    answer(Document("template", "template", kind, {"file": str(output), "use": use}, (line,)), json)


@app.command(sort_key=12)
def schema(kind: Annotated[str, Parameter(help="sensor or study.")] = "sensor", *, json: Json = True) -> None:
    """Print the JSON schema of a configuration file.

    Example: pixsim schema study > study.schema.json
    """
    from pixsim.cli import templates
    from pixsim.show.document import Document

    answer(Document("schema", "JSON schema", kind, templates.json_schema(kind)), json)


@app.command(sort_key=14)
def cache(
    *,
    clear: Annotated[bool, Parameter(help="Remove the entries.")] = False,
    kind: Annotated[
        str | None, Parameter(metavar="KIND", help="Only entries of this kind; `pixsim cache` lists the kinds.")
    ] = None,
    json: Json = False,
) -> None:
    """Show or clear the cache.

    Example: pixsim cache --clear

    The key of an entry is the hash of all its inputs, so that entries are never out of date; clearing only frees space.
    Files that pixsim did not write stay. PIXSIM_CACHE_DIR sets the folder, PIXSIM_CACHE_GIB its size limit (default 4; 0 disables
    the cache). The least recently used entries are removed first. Mitsuba's kernels and Matplotlib's fonts are in the same folder,
    as kinds of their own.
    """
    from pixsim.base import cache as entry_cache
    from pixsim.report.inventory import cache_document

    kinds = cache_summary()["kinds"]
    if kind is not None and kind not in kinds:
        raise invalid("--kind", f"'{kind}'", ", ".join(kinds) or "none, since the cache is empty")
    freed = entry_cache.clear(kind) if clear else None
    answer(cache_document(cache_summary(kind), freed), json)


def cache_summary(kind: str | None = None) -> dict[str, Any]:
    """Folder and size limit of the cache, and the entries and bytes of each kind, or of one."""
    from pixsim.base import cache as entry_cache

    kinds: dict[str, dict[str, int]] = {}
    for name in [kind] if kind else [None, *entry_cache.HELPERS]:
        for entry in entry_cache.entries(name):
            total = kinds.setdefault(entry.kind, {"entries": 0, "size_bytes": 0})
            total["entries"] += 1
            total["size_bytes"] += entry.size_bytes
    size_bytes, limit_bytes = sum(total["size_bytes"] for total in kinds.values()), entry_cache.limit_bytes()
    found = {"folder": str(entry_cache.folder()), "limit_bytes": limit_bytes, "size_bytes": size_bytes}
    return {**found, "kinds": dict(sorted(kinds.items())), "foreign_bytes": entry_cache.foreign_bytes()}


@app.command(sort_key=10)
def cameras(*, json: Json = False) -> None:
    """List measured cameras and typical filters.

    Example: pixsim cameras

    Measured ones are of whole cameras with their infrared filter. Typical ones stand for sensors of a kind, and are marked so.
    """
    from pixsim.report.inventory import cameras_document
    from pixsim.sensor import camera_data

    answer(cameras_document(camera_data.cameras(), camera_data.SOURCES), json)


@app.command(sort_key=15)
def completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], Parameter(help="bash, zsh (into a folder of $fpath, as _pixsim) or fish.")],
    *,
    json: Json = False,
) -> None:
    """Print the script for shell completion.

    Example: pixsim completion bash > ~/.local/share/bash-completion/completions/pixsim

    Example: pixsim completion fish > ~/.config/fish/completions/pixsim.fish
    """
    from pixsim.show.document import Document

    script = app.generate_completion(prog_name="pixsim", shell=shell)
    answer(Document("completion", "shell completion", shell, {"shell": shell, "script": script}, (script,)), json)


PROBLEM_FOUND = 1  # exit code


@app.command(sort_key=13)
def doctor(
    *,
    out: Out = None,
    limit_s: Annotated[float | None, Parameter(help="Time limit of the test render, in s [default: 20].")] = None,
    json: Json = False,
) -> None:
    """Check this machine; say how to mend what it lacks.

    A test render is compared with its closed form.

    Example: pixsim doctor

    A line is marked ok, note (renders work nevertheless) or problem. The exit code is 1 if there is a problem, else 0.
    """
    from pixsim.cli.doctor import doctor_document, examine

    document = doctor_document(examine(out or DEFAULT_OUT, limit_s))
    answer(document, json)
    if not document.data["ok"]:
        sys.exit(PROBLEM_FOUND)
