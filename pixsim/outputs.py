"""One run from scene to score, and the files it leaves: all of them, or none."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pixsim.figures import save_delta_e_png, save_png
from pixsim.files import output_folder
from pixsim.parameters import Run
from pixsim.report import versions, write_json
from pixsim.score import Score, describe, evaluate
from pixsim.sensor import pixels_along
from pixsim.spectral import SpectralImage, write_channels, write_exr

Stage = Callable[[str], Callable[[float], None]]


def run_and_write(
    scene_file: str,
    settings: Run,
    out: Path,
    *,
    full: bool,
    sensor: str | None,
    variant: str | None,
    progress: Stage,
) -> dict[str, Any]:
    """Render, sense, score and write; returns what stands in score.json.

    Raises PixsimError for unusable input; the folder then holds what it held before.
    """
    from pixsim.pixel import derive
    from pixsim.renderer import render
    from pixsim.scene import load_scene

    derive(settings.pixel)
    scene = load_scene(scene_file, variant=variant, sensor=sensor, **settings.scene)
    camera = scene.camera(settings.camera)
    pixels_along(1e3 * camera.die_mm, settings.pixel.pitch_um)  # refuse too large a pitch before the render
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal clock
        seconds[name], clock = time.perf_counter() - clock, time.perf_counter()

    with output_folder(out) as folder:
        irradiance = render(scene, camera, settings.seed, full=full, progress=progress("render"))
        lap("render")
        progress("sense and score")
        score = evaluate(irradiance, camera, settings.pixel, settings.exposure, settings.display, seed=settings.seed)
        lap("sense and score")
        progress("write")
        summary = describe(score, irradiance) | {
            "exposure": settings.exposure.model_dump(),
            "display": settings.display.model_dump(),
            "seed": settings.seed,
        }
        write_all(folder, irradiance, score, summary)
        lap("write")
        write_json(folder / "provenance.json", {"versions": versions(), "seconds": seconds})
    return summary


def write_all(folder: Path, irradiance: SpectralImage, score: Score, summary: dict[str, Any]) -> None:
    """Write into a folder beside the target's files, then move them over: an interruption leaves no half file."""
    partial = Path(tempfile.mkdtemp(prefix=".pixsim-", dir=folder))
    try:
        write_exr(partial / "irradiance.exr", irradiance)
        frame = score.frame
        write_channels(
            partial / "raw.exr",
            {"DN": frame.dn},
            {
                "unit": "DN",
                "bits": frame.bits,
                "black_level_dn": float(frame.black_level_dn),
                "pitch_um": float(frame.pitch_um),
                "dn_per_e": float(frame.dn_per_e),
                "integration_s": float(frame.integration_s),
            },
        )
        write_channels(partial / "delta_e.exr", {"delta_e": score.delta_e}, {})
        save_png(partial / "ideal.png", score.ideal)
        save_png(partial / "image.png", score.image)
        save_delta_e_png(partial / "delta_e.png", score.delta_e, irradiance)
        write_json(partial / "score.json", summary)
        for path in sorted(partial.iterdir()):
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
