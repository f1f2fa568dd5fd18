"""One run from scene to score, and the files it leaves: all of them, or none."""

from __future__ import annotations

import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.display import white_header, white_rate
from pixsim.errors import refuse
from pixsim.expected_frames import dark_clip
from pixsim.files import output_folder, versions, write_json
from pixsim.parameters import Camera, Display, Exposure, Run
from pixsim.pictures import save_delta_e_png, save_png
from pixsim.raw import BITS_OF_PICTURES, write_frame
from pixsim.run_page import write_run_page
from pixsim.score import Bench, Score, describe, make_bench
from pixsim.sensor import pixels_along
from pixsim.spectral import SpectralImage, write_channels, write_exr

if TYPE_CHECKING:
    from pixsim.accuracy.settle import Settled

Stage = Callable[[str], Callable[..., None]]
OPTIONAL = ("irradiance.exr", "raw.tiff", "raw.png", "raw.npz")  # files that a run may write or not
PICTURE_SUFFIXES = (".exr", ".npz", ".hdr")


def run_and_write(
    source: str,
    settings: Run,
    out: Path,
    *,
    full: bool,
    sensor: str | None,
    variant: str | None,
    units: str | None = None,
    raw_suffixes: Sequence[str] = (),
    irradiance_too: bool = True,
    progress: Stage,
) -> dict[str, Any]:
    """Render a scene (or read a spectral picture), sense, score and write; returns what stands in score.json.

    raw_suffixes : of formats in which the frame is written beside raw.exr
    irradiance_too : whether irradiance.exr, the largest file, is written

    Raises PixsimError for unusable input; the folder then holds what it held before.
    """
    from pixsim.pixel import derive

    derive(settings.pixel)
    if settings.pixel.bits > BITS_OF_PICTURES and {".tiff", ".png"} & set(raw_suffixes):
        raise refuse("--raw", f"tiff or png for an ADC of {settings.pixel.bits} bits", f"{BITS_OF_PICTURES} bits; npz for more")
    if settings.tolerance_delta_e and full:
        raise refuse("--tolerance-delta-e", "with --full", "one of them: the first leaves out what it can, the second nothing")
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal clock
        seconds[name], clock = time.perf_counter() - clock, time.perf_counter()

    if Path(source).suffix.lower() in PICTURE_SUFFIXES:
        if settings.scene or sensor or variant or settings.tolerance_delta_e:
            options = "-D, --sensor, --variant, --tolerance-delta-e"
            raise refuse(options, f"'{source}', a picture", "a Mitsuba scene for these options")
        prepared: Callable[[], tuple[SpectralImage, Camera, dict[str, Any]]] = partial(_read, source, settings, units)
    else:
        if units:
            raise refuse("--units", f"'{source}', a scene", "a picture (.exr, .npz, .hdr): a render's units are known")
        prepared = _prepare(source, settings, full, sensor, variant, progress)
    with output_folder(out) as folder:
        irradiance, camera, more = prepared()
        lap("read" if not more else "render")
        progress("sense and score")
        irradiance.header |= white_header(irradiance, camera, settings.display)
        bench = make_bench(irradiance, camera, settings.pixel, settings.exposure, settings.display, full)
        score = bench.score("evaluate", settings.seed)
        more |= sensors_mean(bench, score, settings.seed, more)
        lap("sense and score")
        progress("write")
        summary = summary_of(score, irradiance, camera, settings.exposure, settings.display, settings.seed) | more
        written = write_all(folder, irradiance, score, summary, raw_suffixes, irradiance_too)
        # Of an earlier run, whose pictures are gone.
        for stale in (folder / name for name in OPTIONAL if name not in written):
            if stale.is_file() and not (Path(source).exists() and stale.samefile(source)):
                stale.unlink()
        lap("write")
        write_json(folder / "provenance.json", {"versions": versions(), "seconds": seconds})
    return summary


def summary_of(
    score: Score, irradiance: SpectralImage, camera: Camera, exposure: Exposure, display: Display, seed: int
) -> dict[str, Any]:
    """score.json: what was found, and all that it was found with."""
    records = {"camera": camera, "exposure": exposure, "display": display}
    physics, time_s = score.physics, score.frame.integration_s
    white_e = white_rate(irradiance, camera, physics, display) * physics.photodiode_area_um2 * time_s
    dark = {"dark": dark_clip(physics, time_s, white_e)}
    return describe(score, irradiance) | dark | {name: each.model_dump() for name, each in records.items()} | {"seed": seed}


def sensors_mean(bench: Bench, score: Score, seed: int, more: dict[str, Any]) -> dict[str, Any]:
    """Mean ΔE over as many sensors as the error budget asks for, the pictured one among them."""
    if "error_budget" not in more:
        return {}
    sensors = more["error_budget"]["settings"]["sensors"]
    others = [bench.score("evaluate", seed, number).mean_delta_e for number in range(1, sensors)]
    return {"sensors": sensors, "sensors_mean_delta_e": float(np.mean([score.mean_delta_e, *others]))}


def _prepare(
    source: str, settings: Run, full: bool, sensor: str | None, variant: str | None, progress: Stage
) -> Callable[[], tuple[SpectralImage, Camera, dict[str, Any]]]:
    """Everything that can be refused before a render, and the render."""
    from pixsim.convergence import render_until
    from pixsim.scene import load_scene
    from pixsim.sensor_plan import make_plan

    scene = load_scene(source, variant=variant, sensor=sensor, **settings.scene)
    camera = scene.camera(settings.camera)
    pixels_along(1e3 * camera.die_mm, settings.pixel.pitch_um)
    settled: Settled | None = None
    if settings.tolerance_delta_e:
        from pixsim.accuracy.probe import Setup  # with scipy.stats they take 0.2 s to load
        from pixsim.accuracy.settle import settle

        progress("calibrate")
        settled = settle(scene, camera, Setup.of(settings, camera), settings.tolerance_delta_e)
        chosen = {"render_noise": settled.choice.render_noise, "tolerance_e": settled.choice.tolerance_e}
        scene, settings = settled.scene, settings.model_copy(update=chosen)
    plan = make_plan(scene, camera, settings.pixel, exposure=settings.exposure, tolerance_e=settings.tolerance_e, full=full)
    for note in plan.warnings:
        warnings.warn(note, stacklevel=2)
    if plan.resolution:
        scene = scene.with_parameters(resolution=plan.resolution)

    def render() -> tuple[SpectralImage, Camera, dict[str, Any]]:
        image, noise = render_until(
            scene,
            camera,
            plan,
            [settings.pixel],
            settings.exposure,
            settings.seed,
            render_noise=settings.render_noise,
            max_seconds=settings.max_seconds,
            progress=progress("render"),
            keep=True,
        )
        more: dict[str, Any] = {"render_noise": asdict(noise), "plan": plan.as_dict()}
        if settled:
            more["error_budget"] = settled.budget(noise, plan.bound_e if plan.bounded else None, settled.choice.sensors)
        return image, camera, more

    return render


def _read(source: str, settings: Run, units: str | None) -> tuple[SpectralImage, Camera, dict[str, Any]]:
    """A picture made elsewhere, and the camera that it is taken with."""
    from pixsim.exchange import read_with_camera

    image, camera = read_with_camera(source, settings.camera, units)
    pixels_along(1e3 * camera.die_mm, settings.pixel.pitch_um)
    return image, camera, {}


def write_all(
    folder: Path,
    irradiance: SpectralImage,
    score: Score,
    summary: dict[str, Any],
    raw_suffixes: Sequence[str] = (),
    irradiance_too: bool = True,
) -> set[str]:
    """Write into a folder beside the target's files, then move them over: an interruption leaves no half file. Returns names."""
    partial = Path(tempfile.mkdtemp(prefix=".pixsim-", dir=folder))
    try:
        if irradiance_too:
            write_exr(partial / "irradiance.exr", irradiance)
        for suffix in dict.fromkeys((".exr", *raw_suffixes)):
            write_frame(partial / f"raw{suffix}", score.frame)
        write_channels(partial / "delta_e.exr", {"delta_e": score.delta_e}, {})
        save_png(partial / "ideal.png", score.ideal)
        save_png(partial / "image.png", score.image)
        save_delta_e_png(partial / "delta_e.png", score.delta_e, irradiance, score.border_um)
        write_json(partial / "score.json", summary)
        write_run_page(partial, score, irradiance, summary)
        made = sorted(partial.iterdir())
        for path in made:
            path.replace(folder / path.name)
        return {path.name for path in made}
    finally:
        shutil.rmtree(partial, ignore_errors=True)
