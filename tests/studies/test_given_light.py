"""A study of light that is given, rendered or of another program, in place of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import COARSE, rows

from pixsim import Camera, PixsimError, SpectralImage, study

SMALL = """name = "small"
repeats = 2
pitch.values_um = [20, 28, 40, 56, 80]
display.dots = 48
"""
SCENE = (
    f'resolution = {COARSE}\nscene = {{file = "csf", parameters = {{luminance_cd_per_m2 ='
    " 100.0}}\n"
)
BRIGHT: dict[str, Any] = {"display": {"white_cd_per_m2": 5000.0}, "jobs": 1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("given")
    (path / "small.toml").write_text(SMALL)
    (path / "scene.toml").write_text(SMALL + SCENE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PIXSIM_CACHE_DIR", str(path / "cache"))
        yield path


def other_light(seed: int = 1) -> SpectralImage:
    """Of another program, 2.7 mm wide, without a camera or a white in its header."""
    data = 1e-3 * (1 + np.random.default_rng(seed).random((64, 64, 3)))
    header = {"source": "other.exr"}
    nm = [450.0, 550.0, 620.0]
    return SpectralImage(nm, 30.0, 2700 / 64, data=data.astype(np.float32), header=header)


def rows_in(folder: Path) -> list[dict[str, str]]:
    """The rows of results.csv, without their keys."""
    return [
        {name: value for name, value in row.items() if name not in ("key", "check")}
        for row in rows(folder)
    ]


def test_the_light_of_a_study_gives_its_rows_again_bit_for_bit(folder: Path) -> None:
    """The error of the film is not known."""
    rendered = study(folder / "scene.toml", folder / "rendered", jobs=1)
    given = study(folder / "small.toml", folder / "given", light=rendered.irradiance, jobs=1)
    assert rows_in(folder / "given") == rows_in(folder / "rendered")
    assert given.camera == rendered.camera
    assert given.film is None


def test_settings_of_a_study_of_given_light_make_its_rows_again(folder: Path) -> None:
    """Rows of one light are not taken for those of another, whose header says the same."""
    camera = Camera(die_mm=2.7, f_number=5.6)
    first = study(folder / "small.toml", folder / "a", light=other_light(), camera=camera, **BRIGHT)
    settings = folder / "settings.toml"
    settings.write_text(first.settings_toml)
    study(settings, folder / "again", light=other_light(), jobs=1)
    assert first.camera.f_number == 5.6
    assert rows_in(folder / "again") == rows_in(folder / "a")
    with pytest.raises(PixsimError, match=r"scene\.file: got light that was given"):
        study(settings, folder / "none")

    study(settings, folder / "again", light=other_light(2), jobs=1)
    assert rows_in(folder / "again") != rows_in(folder / "a")


def test_a_target_in_given_light_is_judged_as_in_the_light_of_its_scene(
    folder: Path, tmp_path: Path
) -> None:
    """Its rows, bit for bit; those of another light without the target, whose header says the same,
    are others.
    """
    metrics: dict[str, Any] = {"metrics": ["detectability", "npwe"], "jobs": 1}
    target = {"size_um": 300.0, "contrast": 0.1, "luminance_cd_per_m2": 100.0}
    file = folder / "small.toml"
    scene: dict[str, Any] = {"scene": "target", "parameters": target, "resolution": COARSE}
    rendered = study(file, tmp_path / "rendered", **scene, **metrics)
    background = rendered.light.background
    options = {"light": rendered.irradiance} | metrics
    given = study(file, tmp_path / "given", without=background, **options)
    assert rows_in(tmp_path / "given") == rows_in(tmp_path / "rendered")
    worst = given.curves[0].statistics["least_detectability"].min(axis=1)
    assert given.curves[0].as_dict()["metrics"]["least_detectability"] == worst.tolist()

    brighter = background.with_planes(1.02 * background.planes)
    study(file, tmp_path / "given", without=brighter, **options)
    assert rows_in(tmp_path / "given") != rows_in(tmp_path / "rendered")
