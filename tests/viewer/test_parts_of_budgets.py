"""The mean ΔE by kinds of causes: each part vanishes where its causes do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain

from pixsim.light.spectral import SpectralImage, colour_matching, d65, luminous_weight
from pixsim.optics import irradiance_factor
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import Collection, ColourCollection
from pixsim.sensor.colour import Layout
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.every_pixel import neighbours
from pixsim.viewer.noise_budget import BLUR, COLOUR_ERROR, CROSSTALK, MOSAIC, NOISE, noise_budget

NM = np.arange(402.5, 700.0, 5.0)
CAMERA = Camera(die_mm=0.1)
# Without codes that hide small parts.
DISPLAY = Display(dots=40, bits=16, white_cd_per_m2=1e3)
QUIET: dict[str, Any] = dict.fromkeys(
    (
        "prnu",
        "dsnu",
        "read_noise_e",
        "reset_noise_factor",
        "dark_current_e_per_s",
        "offset_fpn",
        "column_fpn",
    ),
    0,
)
FILTERS = {
    k: [[float(x), float(0.5 * np.exp(-(((x - c) / 45) ** 2)))] for x in range(400, 701, 10)]
    for k, c in zip("RGB", (600, 540, 460), strict=True)
}


def observer_weights() -> dict[str, Any]:
    """Quantum efficiencies that see XYZ."""
    nm = np.arange(400.0, 701.0)
    seen = colour_matching(nm) / nm[:, None]
    return {
        letter: list(zip(nm.tolist(), (0.6 * seen[:, k] / seen.max()).tolist(), strict=True))
        for k, letter in enumerate("RGB")
    }


def parts(colour: dict[str, Any] | None, **fields: Any) -> dict[str, float]:
    white = d65(NM) * 1e3 * float(irradiance_factor(4.0, 0.0, CAMERA.magnification))
    white = white / (luminous_weight(NM, np.full(NM.size, 5.0)) * d65(NM)).sum()
    y, x = np.mgrid[:64, :64]
    reddish, bluish = 0.2 + 0.6 * (NM > 580), 0.2 + 0.6 * (NM < 500)
    pictures = np.array(
        [0.5 + 0.4 * np.sin(x / 4 + y / 9), 0.5 - 0.4 * np.sin(x / 4 + y / 9)], np.float32
    )
    header = {"lamp_w_per_m2_sr_nm": white.tolist()}
    image = SpectralImage(
        NM,
        np.full(NM.size, 5.0),
        100 / 64,
        factors=(np.array([reddish, bluish]) * white, pictures),
        header=header,
    )
    bare = {
        "technology": "4t-bsi",
        "pitch_um": 2.0,
        "stack": {"enabled": False},
        "bits": 16,
        "colour": colour,
    }
    chain = imaging_chain(
        image,
        CAMERA,
        Pixel(**bare | fields),
        display=DISPLAY,
        develop=Develop(matrix="least_squares"),
    )
    budget = noise_budget(chain, image, "parts", 1)
    assert sum(budget.parts.values()) == pytest.approx(budget.mean_delta_e, abs=1e-12)
    return budget.parts


def test_each_part_has_its_cause() -> None:
    noisy = {"read_noise_e": 100.0}
    whole = parts({"quantum_efficiencies": FILTERS}, **noisy)
    assert min(whole[part] for part in (NOISE, MOSAIC, COLOUR_ERROR, BLUR)) > 0.02
    assert whole[CROSSTALK] == 0.0
    # The observer's own channels have no colour error, and the same blur; pixels that know all
    # channels no mosaic.
    exact = parts({"quantum_efficiencies": observer_weights()}, **noisy)
    assert abs(exact[COLOUR_ERROR]) < 2e-3
    assert exact[BLUR] == pytest.approx(whole[BLUR], rel=1e-12)
    layers = parts({"pattern": "stacked", "quantum_efficiencies": FILTERS}, **noisy)
    assert abs(layers[MOSAIC]) < 1e-6
    assert layers[COLOUR_ERROR] == pytest.approx(whole[COLOUR_ERROR], rel=1e-9)
    grey = parts(None, quantum_efficiency=0.5, **noisy)
    assert (grey[MOSAIC], grey[CROSSTALK], grey[COLOUR_ERROR]) == (0.0, 0.0, 0.0)
    assert grey[NOISE] > 0.02


def test_crosstalk_between_colours_is_no_colour_error() -> None:
    """The matrix takes it apart, which sharpens: without it, neighbours of the same light blur
    more. Its noise is not in it.
    """
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    alone, mixed = (
        parts({"quantum_efficiencies": FILTERS}, stack=stack | {"crosstalk": c}, **QUIET)
        for c in (0.0, 0.1)
    )
    assert mixed[COLOUR_ERROR] == pytest.approx(alone[COLOUR_ERROR], rel=0.05)
    assert mixed[MOSAIC] == pytest.approx(alone[MOSAIC], rel=0.1)  # of the same interpolation
    assert abs(alone[CROSSTALK]) < 0.5 * abs(
        mixed[CROSSTALK]
    )  # the stack alone lets little light stray
    assert 0.01 < -mixed[CROSSTALK] < 0.1
    assert mixed[BLUR] > alone[BLUR] + 0.01


@pytest.mark.parametrize(
    "pattern",
    [
        {"pattern": "grbg"},
        {"pattern": "quad_rggb"},
        {"matrix": ["RGB", "GGR"]},
        {"pattern": "stacked"},
    ],
)
def test_neighbours_of_each_channel_are_those_of_the_unit_cell(pattern: dict[str, Any]) -> None:
    """Of even light their shares add up to what the mosaic's pixels collect, channel by channel;
    rounding.
    """
    layout = Layout.unbinned(
        Pixel(technology="4t-bsi", pitch_um=2.0, colour=pattern | {"quantum_efficiencies": FILTERS})
    )
    assert layout is not None
    around = neighbours(layout)
    assert around.sum(axis=1) == pytest.approx(np.ones((3, 5, 5)))
    shares = np.random.default_rng(1).uniform(0, 1, (3, 5, 5))
    collection = ColourCollection(
        layout,
        tuple(Collection(each[None, None], each.sum(), 2.0) for each in shares),
        (1.0, 2.0, 3.0),
        2.0,
    )
    mixing = (around * shares).sum(axis=(2, 3)) * 2.0**2
    assert mixing == pytest.approx(collection.mixing_um2, rel=1e-12)
