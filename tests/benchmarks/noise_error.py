"""Whether the stated ± of a lit scene's answer holds the answer of a render 64 times as long.

Eight scenes, three parts of the die, five seeds: 120 renders on films of 24 samples across,
each against the longer render of its scene. Prints a row for each scene and part: the answer of the
longer render, of each seed the difference from it over the stated error, and the samples.

    python tests/benchmarks/noise_error.py [scene ...]
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

from pixsim.scene.renderer import LEVEL_FACTOR, Renderer
from pixsim.studies.run import prepare
from pixsim.viewer.setting import Run

LONGER = 64
SEEDS = range(1, 6)
# Of mean ΔE where the default would take minutes
TOLERANCES_DELTA_E = {
    "cornell_box": 0.3,
    "still_life": 0.3,
    "sphere": 0.2,
    "metal": 0.2,
    "glass": 0.2,
    "yard": 1.0,
}
WINDOWS_MM = (None, 1.0, 0.5)
PACKAGED = ("cornell_box", "still_life", "macbeth", "yard", "line_lamp")
_SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="6"/></integrator>
<sensor type="thinlens"><float name="fov" value="25"/><float name="aperture_radius" value="0.002"/>
<float name="focus_distance" value="1.6"/>
<transform name="to_world"><lookat origin="0, -1.6, 0.4" target="0, 0, 0.1" up="0, 0, 1"/></transform>
<sampler type="independent"><integer name="sample_count" value="64"/></sampler>
<film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="48"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform>
<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><float name="color0" value="0.2"/>
<float name="color1" value="0.7"/><transform name="to_uv"><scale value="20"/></transform></texture></bsdf></shape>
{}</scene>"""
STRANGERS = {
    "sphere": """<shape type="sphere"><point name="center" x="0" y="0" z="0.15"/><float name="radius" value="0.15"/>
<bsdf type="plastic"/></shape><shape type="rectangle"><transform name="to_world"><scale value="0.3"/>
<lookat origin="0.8, -0.8, 1.2" target="0, 0, 0" up="0, 0, 1"/></transform>
<emitter type="area"><spectrum name="radiance" value="300"/></emitter></shape>""",
    "metal": """<shape type="cube"><transform name="to_world"><scale value="0.12"/><rotate z="1" angle="30"/>
<translate z="0.12"/></transform><bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf></shape>
<shape type="sphere"><point name="center" x="0.5" y="-0.6" z="0.9"/><float name="radius" value="0.05"/>
<emitter type="area"><spectrum name="radiance" value="5000"/></emitter></shape>""",
    "glass": """<shape type="sphere"><point name="center" x="0" y="0" z="0.15"/><float name="radius" value="0.15"/>
<bsdf type="dielectric"/></shape><emitter type="constant"><spectrum name="radiance" value="20"/></emitter>""",
}


def answers(name: str, scene: str, window_mm: float | None) -> None:
    """Print the row of a scene and a part of the die."""
    settings = {
        "resolution": 24,
        "tolerance_delta_e": TOLERANCES_DELTA_E.get(name),
        "display": {"dots": 64},
        "pixel": {"pitch_um": 1e3 * (window_mm or 2.7136) / 32},
    }
    if window_mm:
        settings["window_mm"] = window_mm
    rows = []
    for seed in SEEDS:
        job = prepare(Run(seed=seed, scene={"file": scene}, **settings))
        request = job.request
        rendered = request.render(request.first, request.plan)
        (key,) = request.answers.values([(rendered.image, None)])[0]
        rows.append((request, rendered, key))

    # One longer render for all seeds.
    request, _, key = rows[0]
    spp = float(np.mean([rendered.image.header["spp"] for _, rendered, _ in rows]))
    renderer = Renderer(request.first, request.camera, request.plan, 99)
    level = 0
    while request.plan.samples.spp * LEVEL_FACTOR ** (level + 1) <= 1024:
        level += 1
    count = max(1, round(LONGER * spp / (request.plan.samples.spp * LEVEL_FACTOR**level)))
    total: list[np.ndarray] = []
    for run in range(count):
        pictures, _ = renderer.run(run, None, level)
        total = [a + b for a, b in zip(total, pictures, strict=True)] if total else [*pictures]
    image = renderer.image([picture / count for picture in total], round(LONGER * spp))

    ratios = []
    for request, rendered, _ in rows:
        (value,), (truth,) = (
            [float(parts.mean()) for parts in numbers.values()]
            for numbers in request.answers.values([(rendered.image, None), (image, None)])
        )
        answer = value - rendered.noise.bias["mean_delta_e"]
        ratios.append((answer - truth) / rendered.noise.delta_e)
    noise = [rendered.noise for _, rendered, _ in rows]
    print(
        f"{name:12s} {window_mm or 2.7136:6.3g} mm  ΔE {truth:7.4f}  ±"
        f" {np.mean([one.delta_e for one in noise]):.4f} of {noise[0].tolerance_delta_e:.4f}"
        f"  off by {' '.join(f'{ratio:+.2f}' for ratio in ratios)}  bias"
        f" {np.mean([one.bias['mean_delta_e'] for one in noise]):+.4f}  spp"
        f" {[rendered.image.header['spp'] for _, rendered, _ in rows]}, noise"
        f" {np.mean([one.fraction for one in noise]):.2g}  {noise[0].ended_by}",
        flush=True,
    )
    results.extend(ratios)


results: list[float] = []

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    chosen = sys.argv[1:] or [*PACKAGED, *STRANGERS]
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen:
            scene = name
            if name in STRANGERS:
                scene = str(Path(folder) / f"{name}.xml")
                Path(scene).write_text(_SCENE.format(STRANGERS[name]))
            for window_mm in WINDOWS_MM:
                answers(name, scene, window_mm)
    within = sum(abs(ratio) <= 1 for ratio in results)
    print(f"{within} of {len(results)} answers within their stated error")
