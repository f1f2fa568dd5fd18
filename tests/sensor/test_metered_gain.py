"""Automatic gain: it fills the range of the ADC where the longest exposure does not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.claims import check

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import capture_from_rates, sample_sensor, with_metered_gain

PIXEL = pixsim.Pixel(
    technology="4t-bsi", pitch_um=3.0, bits=12, black_level_dn=64.0, read_noise_after_gain_e=4.0
)
READOUT = Readout.of(pixsim.derive(PIXEL))
SEEDS = {"sensor": 1, "frame": 2}


def frame_at(exposure: pixsim.Exposure, rate_e_per_s: float) -> Any:
    sensor = sample_sensor(READOUT, (16, 16), np.random.default_rng(SEEDS["sensor"]))
    rates = np.full((16, 16), rate_e_per_s)
    return capture_from_rates(rates, sensor, exposure, np.random.default_rng(SEEDS["frame"]))


@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("well_target", [0.5, 0.95])
def test_brightest_pixel_reaches_the_target_of_the_range(frames: int, well_target: float) -> None:
    """At a gain of g the range of the ADC is its range at 0 dB over 10^(g/20)."""
    exposure = pixsim.Exposure(
        gain_db="auto", max_gain_db=60.0, frames=frames, well_target=well_target
    )
    metered = with_metered_gain(exposure, READOUT, 1e4)
    charge_e = (1e4 + READOUT.dark_current_e_per_s) * exposure.max_integration_s
    check(
        "charge over the saturation at the metered gain",
        charge_e / READOUT.at(metered).saturation_e,
        well_target,
        rtol=1e-12,
        why="rounding",
    )


@pytest.mark.parametrize(("rate_e_per_s", "gain_db"), [(1e6, 0.0), (0.1, 24.0)])
def test_gain_stays_between_0_db_and_the_largest(rate_e_per_s: float, gain_db: float) -> None:
    assert frame_at(pixsim.Exposure(gain_db="auto"), rate_e_per_s).gain_db == gain_db


@pytest.mark.parametrize("time", [{}, {"integration_s": 0.02}])
def test_frame_is_that_of_the_stated_gain(time: dict[str, float]) -> None:
    metered = frame_at(pixsim.Exposure(gain_db="auto", **time), 2e5)
    stated = frame_at(pixsim.Exposure(gain_db=metered.gain_db, **time), 2e5)
    assert 0 < metered.gain_db < 24.0
    np.testing.assert_array_equal(metered.dn, stated.dn)
    assert math.isclose(metered.integration_s, stated.integration_s, rel_tol=1e-12)


def test_evaluation_is_that_of_the_stated_gain() -> None:
    """Metrics, development and the error of the film take the metered gain too."""
    light = pixsim.SpectralImage(
        [550.0], 10.0, 50.0, data=np.geomspace(1e-7, 1e-6, 256).reshape(16, 16, 1),
        header={"luminance_cd_per_m2": 0.1},
    )  # fmt: skip
    camera = pixsim.Camera(die_mm=0.8)
    scores = []
    gain_db: float | str = "auto"
    for _ in range(2):
        exposure = pixsim.Exposure(gain_db=gain_db)
        score = pixsim.evaluate(
            light, camera, PIXEL, exposure, pixsim.Display(dots=32), metrics=["information"]
        )
        scores.append(score)
        gain_db = score.frame.gain_db
    assert 0 < scores[0].frame.gain_db <= 24.0
    assert scores[0].metrics == scores[1].metrics


def test_data_sheet_needs_a_stated_gain() -> None:
    with pytest.raises(PixsimError, match="gain_db"):
        pixsim.datasheet("4t-bsi", pixel={"pitch_um": 3.0}, exposure={"gain_db": "auto"})
