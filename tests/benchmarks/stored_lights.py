"""Render the stored lights of tests/data/lights again: `python tests/benchmarks/stored_lights.py`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.lights import FOLDER

import pixsim

# Scene, samples across the film that is rendered, and across the one that is stored.
LIGHTS = {
    "chart": ("csf", 256, 256),
    "patches": ("macbeth", 192, 96),
    "natural": ("still_life", 192, 96),
}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, (scene_name, columns, stored_columns) in LIGHTS.items():
        parameters = {"luminance_cd_per_m2": 100.0} if scene_name == "csf" else {}
        scene = pixsim.load_scene(scene_name, **parameters)
        light = pixsim.render(scene.with_resolution(columns), scene.camera(), seed=62)
        pixsim.write_exr(
            FOLDER / f"{name}.exr", light.box_reduced(stored_columns), factors_only=True
        )


if __name__ == "__main__":
    main()
