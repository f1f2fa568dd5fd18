"""Time of a study's evaluations with a stack of the pixel, over that without: python tests/benchmarks/stack_cost.py

A study prepares the light once and takes each pitch with 8 sensors, as here. Seconds are of the processor, the least of
five rounds over all cases, since other programs slow the processor down for a while. A stack is to cost at most 1.15 times,
one whose shares vary much over the field (microlenses without a shift) at most 1.6 times.
"""

from __future__ import annotations

import time
import warnings

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor import collection
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import chain_at_pitch, prepare_scene

CASES = {
    "no stack": None,
    "bare": {"height_um": 8.0, "index": 1.5},
    "microlens, optimal shift": {"height_um": 8.0, "index": 1.5, "microlens": "square", "shift": "optimal"},
    "microlens, no shift": {"height_um": 8.0, "index": 1.5, "microlens": "square"},
    "microlens, fixed shift": {"height_um": 8.0, "index": 1.5, "microlens": "square", "shift_um": [0.2, 0.2]},
}
LIMITS = {"no stack": 1.0, "bare": 1.15, "microlens, optimal shift": 1.15}
FIELD_DEPENDENT = 1.6
PITCHES_UM = np.geomspace(5.5, 13.0, 6)
REPEATS, SIDE, ROUNDS = 8, 1024, 5
CAMERA = Camera()


def seconds_of(stack: dict[str, object] | None, image: SpectralImage) -> float:
    """Seconds of all evaluations, after the light has been prepared."""
    pixels = [Pixel(pitch_um=pitch_um, infrared_cut_nm=720.0, stack=stack) for pitch_um in PITCHES_UM.tolist()]
    light = prepare_scene(image, CAMERA, derive(pixels[0]), Display(white_cd_per_m2=300.0), border_um=15.0)
    _ = [channel.running_integral for channel in light.lights]
    collection._collection.cache_clear()
    start = time.process_time()
    for pixel in pixels:
        chain = chain_at_pitch(light, derive(pixel), Exposure())
        for repeat in range(REPEATS):
            chain.simulate("cost", repeat)
    return time.process_time() - start


def main() -> None:
    rng = np.random.default_rng(0)
    spectrum, picture = rng.uniform(0.5, 1, (1, 31)), rng.uniform(1e-4, 1e-3, (1, SIDE, SIDE))
    image = SpectralImage(np.arange(400.0, 701.0, 10.0), 10.0, 2713.6 / SIDE, factors=(spectrum, picture))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rounds = [{name: seconds_of(stack, image) for name, stack in CASES.items()} for _ in range(ROUNDS)]
    least = {name: min(each[name] for each in rounds) for name in CASES}
    for name, seconds in least.items():
        limit = LIMITS.get(name, FIELD_DEPENDENT)
        print(f"{name:26} {seconds:6.2f} s  {seconds / least['no stack']:5.2f} times, at most {limit:g}")


if __name__ == "__main__":
    main()
