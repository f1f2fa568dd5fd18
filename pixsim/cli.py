"""The `pixsim` command: options in, messages and files out. The only place that prints or exits.

Results go to stdout, everything else to stderr. Exit codes: 0 done, 2 input that cannot be used, 130 interrupted.
"""

from __future__ import annotations

import signal
import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError
from pydantic import ValidationError

import pixsim
from pixsim.config import merge, read_toml
from pixsim.errors import PixsimError
from pixsim.messages import explain
from pixsim.options import (
    NO_CAMERA,
    NO_DISPLAY,
    NO_EXPOSURE,
    NO_PIXEL,
    CameraTable,
    DisplayTable,
    ExposureTable,
    PixelTable,
)
from pixsim.parameters import Run
from pixsim.progress import stages
from pixsim.wording import found_line, plan_table, sensitivity_lines

OK, UNUSABLE_INPUT, INTERRUPTED, TERMINATED = 0, 2, 130, 143
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
    return f"{field.description} [default: {field.default:g}]"


Config = Annotated[list[Path] | None, Parameter(help="TOML with tables [camera], [pixel], …; later files win.")]
Tolerance = Annotated[str | None, Parameter(help=described("tolerance_e"))]
Full = Annotated[bool, Parameter(help="Leave nothing out.")]
SensorId = Annotated[str | None, Parameter(help="Id of the sensor, where the scene has several.")]
Define = Annotated[list[str], Parameter(name=["-D", "--define"], help="Set a scene parameter: name=value.", consume_multiple=False)]
Seed = Annotated[str | None, Parameter(help="Of the render, the sensor and its noise [default: 0].")]
Json = Annotated[bool, Parameter(help="Print the result as JSON.")]
Out = Annotated[Path | None, Parameter(help="Output folder [default: pixsim-out/NAME].")]
Variant = Annotated[str | None, Parameter(help="Mitsuba variant; by default the fastest that works here.")]


@app.command
def run(
    scene: str,
    *,
    config: Config = None,
    define: Define | None = None,
    camera: CameraTable = NO_CAMERA,
    pixel: PixelTable = NO_PIXEL,
    exposure: ExposureTable = NO_EXPOSURE,
    display: DisplayTable = NO_DISPLAY,
    seed: Seed = None,
    tolerance_e: Tolerance = None,
    render_noise: Annotated[str | None, Parameter(help=described("render_noise"))] = None,
    max_seconds: Annotated[str | None, Parameter(help=described("max_seconds"))] = None,
    full: Full = False,
    sensor: SensorId = None,
    variant: Variant = None,
    units: Annotated[str | None, Parameter(help="Of a picture whose file does not tell them, as W.m^-2.nm^-1.")] = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Render a scene, take its picture with one sensor and score it.

    Examples:
    pixsim run csf --pixel.pitch-um 5.6 --camera.f-number 2.8
    pixsim run picture.exr --units W.m^-2.sr^-1.nm^-1

    Writes irradiance.exr, raw.exr, ideal.png, image.png, delta_e.exr, delta_e.png, score.json.

    Parameters
    ----------
    scene
        An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, macbeth, line_lamp, still_life.
        Or a spectral picture made elsewhere (.exr, .npz, .hdr), in the camera's geometry.
    """
    from pixsim.outputs import run_and_write

    tables = {"camera": camera, "pixel": pixel, "exposure": exposure, "display": display}
    values = {"seed": seed, "tolerance_e": tolerance_e, "render_noise": render_noise, "max_seconds": max_seconds}
    chosen = settings_of(config, tables, define, values)
    folder = out or DEFAULT_OUT / Path(scene).stem
    with stages() as stage:
        result = run_and_write(scene, chosen, folder, full=full, sensor=sensor, variant=variant, units=units, progress=stage)
    noise = result.get("render_noise")
    show(
        result,
        json,
        f"mean ΔE {result['mean_delta_e']:.3f} with {result['pitch_um']:g} µm pixels, "
        f"{1e3 * result['integration_s']:.3g} ms"
        + (f"; noise of the render {noise['fraction']:.2g} of the sensor's" if noise else "")
        + f"; pictures in {folder}",
    )


@app.command
def plan(
    scene: str,
    *,
    config: Config = None,
    define: Define | None = None,
    camera: CameraTable = NO_CAMERA,
    pixel: PixelTable = NO_PIXEL,
    tolerance_e: Tolerance = None,
    full: Full = False,
    sensor: SensorId = None,
    variant: Variant = None,
    json: Json = False,
) -> None:
    """What a scene needs, what is left out, why, and what leaving it out can cost at most; nothing is rendered.

    Example: pixsim plan macbeth --tolerance-e 1e-4

    Parameters
    ----------
    scene
        An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, macbeth, line_lamp, still_life.
    """
    from pixsim.scene import load_scene
    from pixsim.sensor_plan import make_plan

    chosen = settings_of(config, {"camera": camera, "pixel": pixel}, define, {"tolerance_e": tolerance_e})
    loaded = load_scene(scene, variant=variant, sensor=sensor, **chosen.scene)
    made = make_plan(loaded, loaded.camera(chosen.camera), chosen.pixel, tolerance_e=chosen.tolerance_e, full=full)
    if json:
        show(made.as_dict(), True, "")
    else:
        print(plan_table(made, None if sys.stdout.isatty() else FILE_WIDTH))


def settings_of(config: list[Path] | None, tables: dict[str, Any], define: list[str] | None, values: dict[str, str | None]) -> Run:
    """Defaults ← files ← options, checked once."""
    layers = [read_toml(path) for path in config or []]
    layers.append({name: own for name, table in tables.items() if (own := given(table))})
    layers.append({"scene": definitions(define or [])} | {name: value for name, value in values.items() if value is not None})
    settings: dict[str, Any] = {}
    for layer in layers:
        settings = merge(settings, layer)
    return Run.model_validate(settings)


@app.command
def study(
    study: str,
    *,
    quick: Annotated[bool, Parameter(help="Fewer pitches and sensors, as the study's [quick] table says.")] = False,
    jobs: Annotated[int | None, Parameter(help="Processes; one a core by default. Results do not depend on it.")] = None,
    variant: Variant = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Sweep the pixel size and find the one with the least visible error.

    Example: pixsim study chen2000 --quick

    Writes results.csv, summary.json, figures/*.svg, provenance.json, report.html; an interrupted study goes on where it
    stopped when the same command is given again.

    Parameters
    ----------
    study
        A TOML file, or the name of a packaged study: chen2000, chen2000-sensitivity, modern.
    """
    from pixsim import sweep

    if jobs is not None and jobs < 1:
        raise PixsimError(f"--jobs: got {jobs}; allowed: 1 or more.")
    table = sweep.read_study(study)
    seconds: dict[str, float] = {}
    how: dict[str, Any] = {"quick": quick, "jobs": jobs, "variant": variant}
    with stages(seconds) as stage:
        if "vary" in table:
            from pixsim.sensitivity import Sensitivity, run_sensitivity
            from pixsim.sensitivity_report import write_sensitivity_report

            moved = Sensitivity.model_validate(table)
            folder = study_folder(out, moved.name, quick)
            outcome = run_sensitivity(moved, folder, progress=stage, **how)
            stage("report")
            report = write_sensitivity_report(outcome, folder, seconds)
            found, lines = outcome.as_dict(), sensitivity_lines(outcome)
        else:
            from pixsim.report import write_report

            plan = sweep.checked_study(table)
            folder = study_folder(out, plan.name, quick)
            result = sweep.study(plan, folder, progress=stage, **how)
            stage("report")
            report = write_report(result, folder, seconds)
            found, lines = result.as_dict(), [found_line(curve) for curve in result.curves]
    show(found, json, "\n".join([*lines, f"report: {report}"]))


def study_folder(out: Path | None, name: str, quick: bool) -> Path:
    return out or DEFAULT_OUT / (name + ("-quick" if quick else ""))


@app.command
def chart(
    kind: str,
    *,
    output: Annotated[Path, Parameter(name=["-o", "--output"], help="Linear float32 EXR, row 0 on top.")],
    width: Annotated[int | None, Parameter(help="Texels across.")] = None,
    height: Annotated[int | None, Parameter(help="Texels down.")] = None,
    die_mm: Annotated[float | None, Parameter(help="Width of the die that the chart fills (csf) [default: 2.7136].")] = None,
) -> None:
    """Make a chart texture for -D chart=FILE.

    Example: pixsim chart siemens_star -o star.exr

    Parameters
    ----------
    kind
        csf, flat, siemens_star or slanted_edge.
    """
    from pixsim import charts

    texels = charts.make_chart(kind, width, height, die_mm)
    charts.write_chart(output, texels)
    print(f"{texels.shape[1]} × {texels.shape[0]} texels in {output}")


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


def main() -> None:
    """Run the command; one message and an exit code for whatever the user can mend."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # else worker processes are orphaned
    warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}", file=sys.stderr)
    try:
        app(exit_on_error=False, print_error=False)
    except (PixsimError, ValidationError) as error:
        print(f"pixsim: {explain(error)}", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except CycloptsError as error:
        print(f"pixsim: {error}\nTry 'pixsim --help'.", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except BrokenPipeError:  # the reader, as head, has seen enough
        sys.stderr.close()
        sys.exit(OK)
    except OSError as error:
        print(f"pixsim: {error.filename or 'system'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(UNUSABLE_INPUT)
    except KeyboardInterrupt:
        print("pixsim: interrupted; what was finished is kept, and the same command goes on from there", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(OK)
