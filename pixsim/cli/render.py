"""`pixsim run` and `plan`: one scene, one picture."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from pixsim.cli.base import (
    DEFAULT_OUT,
    FILE_WIDTH,
    Config,
    Define,
    Full,
    Json,
    Out,
    Seed,
    SensorId,
    Tolerance,
    Variant,
    app,
    described,
    settings_of,
    show,
    stages,
)
from pixsim.cli.tables import (
    NO_CAMERA,
    NO_DISPLAY,
    NO_EXPOSURE,
    NO_PIXEL,
    CameraTable,
    DisplayTable,
    ExposureTable,
    PixelTable,
)
from pixsim.wording import budget_lines, dark_note, plan_table, score_line


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
    tolerance_delta_e: Annotated[str | None, Parameter(help=described("tolerance_delta_e"))] = None,
    render_noise: Annotated[str | None, Parameter(help=described("render_noise"))] = None,
    max_seconds: Annotated[str | None, Parameter(help=described("max_seconds"))] = None,
    full: Full = False,
    sensor: SensorId = None,
    variant: Variant = None,
    units: Annotated[str | None, Parameter(help="Of a picture whose file does not tell them, as W.m^-2.nm^-1.")] = None,
    raw: Annotated[
        list[Literal["tiff", "png", "npz"]] | None,
        Parameter(help="Write the raw frame in this format too, beside raw.exr.", consume_multiple=False),
    ] = None,
    no_irradiance: Annotated[bool, Parameter(help="Leave out irradiance.exr, the largest file.")] = False,
    out: Out = None,
    json: Json = False,
) -> None:
    """Render a scene, take its picture with one sensor and score it.

    Example: pixsim run csf --pixel.pitch-um 5.6 --camera.f-number 2.8

    Example: pixsim run picture.exr --units W.m^-2.sr^-1.nm^-1

    Writes irradiance.exr, raw.exr (for --raw in other formats too), ideal.png, image.png, delta_e.exr, delta_e.png,
    score.json, and report.html, which shows them.

    Parameters
    ----------
    scene
        An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, macbeth, line_lamp, still_life.
        Or a spectral picture made elsewhere (.exr, .npz, .hdr), in the camera's geometry.
    """
    from pixsim.outputs import run_and_write

    tables = {"camera": camera, "pixel": pixel, "exposure": exposure, "display": display}
    values = {
        "seed": seed,
        "tolerance_e": tolerance_e,
        "tolerance_delta_e": tolerance_delta_e,
        "render_noise": render_noise,
        "max_seconds": max_seconds,
    }
    chosen = settings_of(config, tables, define, values)
    folder = out or DEFAULT_OUT / Path(scene).stem
    with stages() as stage:
        result = run_and_write(
            scene,
            chosen,
            folder,
            full=full,
            sensor=sensor,
            variant=variant,
            units=units,
            raw_suffixes=[f".{each}" for each in raw or []],
            irradiance_too=not no_irradiance,
            progress=stage,
        )
    noise = result.get("render_noise")
    show(
        result,
        json,
        score_line(result)
        + (f"; noise of the render {noise['fraction']:.2g} of the sensor's" if noise else "")
        + f"; report: {folder / 'report.html'}"
        + "".join(f"\n{line}" for line in [*dark_note(result), *budget_lines(result)]),
    )


@app.command
def plan(
    scene: str,
    *,
    config: Config = None,
    define: Define | None = None,
    camera: CameraTable = NO_CAMERA,
    pixel: PixelTable = NO_PIXEL,
    exposure: ExposureTable = NO_EXPOSURE,
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

    tables = {"camera": camera, "pixel": pixel, "exposure": exposure}
    chosen = settings_of(config, tables, define, {"tolerance_e": tolerance_e})
    loaded = load_scene(scene, variant=variant, sensor=sensor, **chosen.scene)
    how: dict[str, Any] = {"exposure": chosen.exposure, "tolerance_e": chosen.tolerance_e, "full": full}
    made = make_plan(loaded, loaded.camera(chosen.camera), chosen.pixel, **how)
    if json:
        show(made.as_dict(), True, "")
    else:
        print(plan_table(made, None if sys.stdout.isatty() or "COLUMNS" in os.environ else FILE_WIDTH))
