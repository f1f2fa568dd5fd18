"""Largest memory, largest use of the disk and processor time of each stage of a run with a large film.

    python tests/benchmarks/large_film.py SCENE N [--spp 4]

N is the number of samples across. The stages are those of `pixsim run`, without its files. Memory is the largest resident set of
the process during a stage, with the pages of mapped files that are in use; Linux counts it anew after a write to
/proc/self/clear_refs. The disk is that of the temporary files, which other programs should leave alone meanwhile. Pictures are
not cached.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pixsim
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_plan
from pixsim.sensor.pixel import derive
from pixsim.studies.oversampling import measure_film
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import chain_at_pitch, ideal_on_dots, lights_of, prepare_scene

EVERY_S = 0.1  # between two looks at the disk


class Watch:
    """Prints the memory, the disk and the processor time of functions."""

    def __init__(self) -> None:
        self._most_used = self._used_before = 0
        threading.Thread(target=self._look, daemon=True).start()

    def _look(self) -> None:
        while True:
            self._most_used = max(self._most_used, shutil.disk_usage(tempfile.gettempdir()).used)
            time.sleep(EVERY_S)

    def __call__(self, name: str, work: Callable[[], Any]) -> Any:
        Path("/proc/self/clear_refs").write_text("5")
        self._used_before = self._used_before or shutil.disk_usage(tempfile.gettempdir()).used
        self._most_used, start_s = 0, time.process_time()
        result = work()
        seconds = time.process_time() - start_s
        (kib,) = re.findall(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
        disk = max(self._most_used - self._used_before, 0) / (1 << 30)
        print(f"{name:28} {int(kib) / (1 << 20):6.2f} GiB {disk:6.1f} GiB of disk {seconds:8.1f} s", flush=True)
        return result


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("across", type=int, metavar="N")
    parser.add_argument("--spp", type=int, default=4, help="samples per cell")
    options = parser.parse_args()
    scene = pixsim.load_scene(options.scene, resolution=options.across, spp=options.spp)
    camera, pixel, exposure, display = scene.camera(), pixsim.Pixel(), pixsim.Exposure(), pixsim.Display()
    physics, watch = derive(pixel), Watch()
    plan = watch("plan", lambda: make_plan(scene, camera, pixel, exposure=exposure, display=display))
    image, _ = watch("renders and their noise", lambda: render_until(scene, camera, plan, [pixel], exposure, render_noise=1e3))
    watch("error of the film", lambda: measure_film(image, [Imaging(camera, pixel, exposure, display)], chart=plan.chart))
    watch("ideal picture on the dots", lambda: ideal_on_dots(image, camera, physics, display, physics.read_pitch_um, None))
    watch("diffraction", lambda: lights_of(image, camera, physics))
    light = prepare_scene(image, camera, physics, display)
    chain = watch("integration over the pixels", lambda: chain_at_pitch(light, physics, exposure))
    watch("frame, S-CIELAB", lambda: chain.simulate("large film").statistics())


if __name__ == "__main__":
    main()
