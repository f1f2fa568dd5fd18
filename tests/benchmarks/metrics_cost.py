"""What further metrics add to the cost of an evaluation: processor time over that of ΔE alone, in
turns.

    OMP_NUM_THREADS=1 python tests/benchmarks/metrics_cost.py [--turns 15]

An evaluation is that of a study: pixels of 5.3 µm (512²) on 512 dots, with a registration of its
own, in single precision. With fewer sensors of a size than the registrations that detectability
asks for, 16, each evaluation has several of them. The light without the target is an even field.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from helpers.chains import imaging

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.viewer.chain import make_chain
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import METRIC_OPTIONS
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricRequest
from pixsim.viewer.scene_light import PreparedScene, SceneLight, prepare_scene

RAW = ["delta_e", "detectability", "information", "mtf50"]
ASKED = {
    "ΔE, three raw metrics, 16 sensors": (RAW, 16),
    "ΔE, three raw metrics, 8 sensors": (RAW, 8),
    "three raw metrics without ΔE, 16 sensors": (RAW[1:], 16),
    "ΔE, acutance": (["delta_e", "acutance"], 16),
    "ΔE, visual noise": (["delta_e", "visual_noise"], 16),
    "ΔE, detectability by eye": (["delta_e", "npwe"], 16),
}


def prepared(
    names: list[str], repeats: int, light: SpectralImage, camera: pixsim.Camera
) -> tuple[Imaging, PreparedScene]:
    """What an evaluation begins with: settings, and the light behind the lens."""
    pixel, display = (
        pixsim.Pixel(pitch_um=5.3, black_level_dn=16),
        pixsim.Display(white_cd_per_m2=1000),
    )
    judging = MetricRequest(metrics_named(names), METRIC_OPTIONS, repeats)
    asked = imaging(
        camera, pixel, display=display, metrics=judging, in_float32=True, border_um=20.0
    )
    even = np.broadcast_to(
        light.mean_spectrum().astype(np.float32), (*light.shape[:2], light.wavelength_nm.size)
    )
    without = SpectralImage(
        light.wavelength_nm,
        light.band_width_nm,
        light.pitch_um,
        data=np.ascontiguousarray(even),
        header=light.header,
    )
    scene = prepare_scene(asked, SceneLight(light, without))
    scene.store_integrals()
    return asked, scene


def evaluation_s(asked: Imaging, scene: PreparedScene, repeat: int) -> float:
    """Processor time of one evaluation."""
    start_s = time.process_time()
    chain = make_chain(asked.registered(repeat), scene)
    frame = chain.capture("benchmark", repeat)
    FrameUnderTest.of(chain, frame, repeat, ("benchmark",)).statistics()
    return time.process_time() - start_s


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--turns", type=int, default=15)
    turns = parser.parse_args().turns
    scene = pixsim.load_scene("csf", resolution=1024)
    camera = scene.camera()
    light = pixsim.render(scene, camera)
    alone = prepared(["delta_e"], 16, light, camera)
    print(f"{'metrics':42} times ΔE alone (quartiles)")
    for name, (names, repeats) in ASKED.items():
        asked = prepared(names, repeats, light, camera)
        for each in (alone, asked):
            evaluation_s(*each, 0)  # tables of the pixels
        ratios = [
            evaluation_s(*asked, turn) / evaluation_s(*alone, turn) for turn in range(1, turns + 1)
        ]
        low, middle, high = statistics.quantiles(ratios, n=4)
        print(f"{name:42} {middle:5.2f} ({low:.2f} to {high:.2f})", flush=True)


if __name__ == "__main__":
    main()
