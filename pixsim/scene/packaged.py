"""The folder of scenes that comes with pixsim, with the charts and spectra that they name."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path


@cache
def packaged_folder() -> Path:
    """Return the folder, in the wheel or in a checkout. A scene elsewhere may name its files:
    `spectra/led_850nm.spd`.
    """
    root = Path(str(resources.files("pixsim")))
    packaged = root / "data/scenes"
    return packaged if packaged.is_dir() else root.parent / "scenes"


def packaged_scenes() -> dict[str, Path]:
    """Return name -> path of the packaged scenes."""
    return {path.stem: path for path in sorted(packaged_folder().glob("*.xml"))}
