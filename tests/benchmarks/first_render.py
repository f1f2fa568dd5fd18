"""What a first render costs: kernels and seconds of processors, in new processes with an empty cache and with its kernels.

    python tests/benchmarks/first_render.py [SCENE ...] [--resolution 32] [--spp 4] [--against PATH]

Seconds are those of all threads of a process, imports included, which other programs change little. With --against the same renders
run in turns with the pixsim of another checkout.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parents[2]
SCENES = (
    "csf",
    "slanted_edge",
    "siemens_star",
    "flat",
    "macbeth",
    "line_lamp",
    "still_life",
    str(HERE / "tests/data/desk/desk.xml"),
)
LARGE = 2000  # operations of a kernel

RENDER = """
import json, sys
import pixsim
from pixsim.scene.renderer import Renderer
from pixsim.scene.guard.own_tracer import OwnTracer
Renderer.traced = lambda self, job: OwnTracer(job)  # here, where kernels are counted
scene = pixsim.load_scene(sys.argv[1], resolution=int(sys.argv[2]), spp=int(sys.argv[3]))
import drjit as dr
dr.set_flag(dr.JitFlag.KernelHistory, True)
mean_lx = float(pixsim.render(scene).illuminance_lx().mean())
kernels = dr.kernel_history([dr.KernelType.JIT])
compiled = [one for one in kernels if not one["cache_hit"] and not one["cache_disk"]]
large = sum(one["operation_count"] > int(sys.argv[4]) for one in compiled)
print(json.dumps([len(kernels), len(compiled), large, mean_lx]))
"""


def cost(checkout: Path, cache: str, *words: str) -> tuple[list[float], float]:
    """Launches, compiled kernels, large ones among them and mean illuminance; and the seconds of a process."""
    kernels = f"{cache}/kernels"
    os.makedirs(kernels, exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(checkout), "PIXSIM_CACHE_DIR": cache, "DRJIT_CACHE_DIR": kernels}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", RENDER, *words], env=environment, capture_output=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return json.loads(done.stdout), after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--resolution", type=int, default=32)
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    for scene in options.scenes or SCENES:
        for checkout in (HERE, options.against) if options.against else (HERE,):
            with tempfile.TemporaryDirectory() as cache:
                words = scene, str(options.resolution), str(options.spp), str(LARGE)
                (launches, compiled, large, mean_lx), first_s = cost(checkout, cache, *words)
                _, known_s = cost(checkout, cache, *words)
            counts = f"{launches:3} launches, {compiled:2} kernels compiled, {large:2} of them large"
            seconds = f"processors {first_s:5.2f} s first, {known_s:5.2f} s with kernels"
            print(f"{Path(scene).stem:14} {checkout.name:10} {counts}; {seconds}; {mean_lx:.4g} lx", flush=True)


if __name__ == "__main__":
    main()
