"""Three stored lights for all tests that are not of scenes: a chart, patches, a natural scene.

`python tests/helpers/lights.py` renders them again: the packaged scenes `csf`, `macbeth` and
`still_life`, each with its own camera, from seed 62, on films that are reduced.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pixsim

FOLDER = Path(__file__).resolve().parents[1] / "data/lights"
# Scene, samples across the film that is rendered, and across the one that is stored.
LIGHTS = {
    "chart": ("csf", 256, 256),
    "patches": ("macbeth", 192, 96),
    "natural": ("still_life", 192, 96),
}


def chart() -> pixsim.SpectralImage:
    """Return the contrast-sensitivity chart: 256×256 samples of 10.6 µm, one spectrum, 100 cd/m²."""
    return _stored("chart")


def patches() -> pixsim.SpectralImage:
    """Return a colour chart of 24 patches: 96×96 samples of 28.3 µm."""
    return _stored("patches")


def natural() -> pixsim.SpectralImage:
    """Return fruit on a table in the light of a window: 96×96 samples of 28.3 µm."""
    return _stored("natural")


def camera(light: pixsim.SpectralImage) -> pixsim.Camera:
    """Return the camera that a light was rendered with."""
    return pixsim.Camera(**light.header["camera"])


@cache
def _stored(name: str) -> pixsim.SpectralImage:
    return pixsim.read_exr(FOLDER / f"{name}.exr")


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
