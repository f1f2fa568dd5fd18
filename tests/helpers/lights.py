"""Three stored lights for all tests that are not of scenes: a chart, patches, a natural scene.

`python tests/benchmarks/stored_lights.py` renders them again: the packaged scenes `csf`, `macbeth`
and `still_life`, each with its own camera, from seed 62, on films that are reduced.
"""

from functools import cache
from pathlib import Path

import pixsim

FOLDER = Path(__file__).resolve().parents[1] / "data/lights"


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
