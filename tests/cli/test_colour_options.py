"""Invalid colour filters by a file and by options: one message before any light.
tests/sensor/test_colour.py has all kinds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiny import toml_of

import pixsim
from pixsim.light.spectral import SpectralImage

NM = np.arange(400.0, 701.0, 10.0)
DIE_MM = 0.1
GOOD = {"quantum_efficiencies": "good.csv"}


def write_table(name: str, peaks_nm: tuple[float, ...], scale: float = 1.0) -> None:
    """A CSV file of quantum efficiencies of R, G, B; `scale` multiplies that of G."""
    curves = 0.5 * np.exp(-(((NM[:, None] - peaks_nm) / 40) ** 2)) * [1.0, scale, 1.0]
    rows = (",".join(f"{value:.6g}" for value in row) for row in np.column_stack([NM, curves]))
    Path(name).write_text("\n".join(["nm,R,G,B", *rows]), encoding="utf-8")


@pytest.mark.parametrize(
    ("scene", "colour", "develop", "texts"),
    [
        (
            "macbeth",
            {"quantum_efficiencies": "none.csv"},
            {},
            ["quantum_efficiencies", "'none.csv', which does not exist"],
        ),
        (
            *("macbeth", {"quantum_efficiencies": "large.csv"}, {}),
            ["channel G with 1.1682 at 520 nm", "0 to 1", "Divide percentages by 100"],
        ),
        (
            "macbeth",
            {"transmittances": "nan.csv"},
            {},
            ["transmittances", "channel G with nan at 400 nm"],
        ),
        ("macbeth", GOOD | {"matrix": ["RG", "gB"]}, {}, ["gB", "capital letters"]),
        (
            *("macbeth", GOOD | {"matrix": ["RG", "BG"]}, {"demosaic": "malvar2004"}),
            [
                "develop.demosaic",
                "'malvar2004' for the unit cell RG, BG",
                "'interpolate' for any other",
            ],
        ),
        (
            "light.exr",
            {"quantum_efficiencies": "same.csv"},
            {},
            ["colour under the scene's lamp", "rank 1", "other filters"],
        ),
    ],
    ids=lambda value: str(value)[:60],
)
def test_invalid_filters_are_refused(
    scene: str,
    colour: dict[str, Any],
    develop: dict[str, Any],
    texts: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_table("good.csv", (600, 540, 460))
    write_table("large.csv", (600, 540, 460), 3.0)
    write_table("nan.csv", (600, 540, 460), np.nan)
    write_table("same.csv", (540, 540, 540))
    header = {"diffraction": False, "lamp_w_per_m2_sr_nm": np.ones(NM.size).tolist()}
    light = SpectralImage(
        NM, np.full(NM.size, 10.0), 5.0, data=np.full((20, 20, NM.size), 1e-4), header=header
    )
    pixsim.write_exr("light.exr", light)
    settings = {
        "pixel": {"technology": "4t-bsi", "pitch_um": 20.0, "colour": colour},
        "develop": develop,
        "camera": {"die_mm": DIE_MM},
        "display": {"white_cd_per_m2": 1e4, "raster": "one_to_one"},
    }
    text = "".join(f"{name} = {toml_of(value)}\n" for name, value in settings.items())
    Path("sensor.toml").write_text(text, encoding="utf-8")
    assert_refused(*command(f"run {scene} --out out --config sensor.toml"), texts)
    assert not Path("out").exists()
