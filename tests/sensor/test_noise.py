"""The sources of noise: each is drawn, and stands in every closed form, from its one line in
`SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.claims import check
from helpers.statistics import check_mean, seeded

import pixsim
from pixsim.sensor.correction import residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.noise import SOURCES, Along, NoiseSource
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import dark_spread_e, frame_variance_dn2, read_out, sample_sensor
from pixsim.viewer.dark_clip import dark_clip

SHEET: dict[str, Any] = {
    "pitch_um": 5.0,
    "full_well_e": 4e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 0.0,
    "quantum_efficiency": 0.5,
    "bits": 14,
    "black_level_dn": 500.0,
    "gain_e_per_dn": 0.5,
}
MANY, FEW = 20_000, 16  # lines that share a value, and pixels of a line
SIGNAL_E = 100.0
KINDS = [(True, "pixel"), (True, "row"), (False, "pixel"), (False, "column")]


def deviations_e(readout: Readout, shape: tuple[int, int] = (MANY, FEW)) -> list[np.ndarray]:
    """Two frames of a sensor, in electrons from their mean."""
    sensor = sample_sensor(readout, shape, seeded(5))
    light_e = np.full(shape, SIGNAL_E)
    frames = [read_out(light_e, 0.01, sensor, seeded(seed)) for seed in (9, 10)]
    black_dn = readout.adc.black_level_dn
    return [(frame - black_dn) / readout.dn_per_e - SIGNAL_E for frame in frames]


def test_no_row_noise_leaves_the_random_numbers_as_they_are() -> None:
    plain = deviations_e(Readout.of(derive(Pixel(**SHEET))))
    zero = deviations_e(Readout.of(derive(Pixel(**SHEET, row_noise_e=0.0))))
    np.testing.assert_array_equal(plain, zero)


def residual_e2(readout: Readout) -> float:
    """Noise but that of light after no correction."""
    residual = residual_variance_e2(0.0, 0.01, readout, Correction())
    return float(residual.temporal + residual.offsets)


CLOSED_FORMS: dict[str, Callable[[Readout], float]] = {
    "noise floor": lambda readout: readout.noise_floor_e**2,
    "offsets": lambda readout: readout.offset_e**2,
    "temporal variance": lambda readout: (
        float(frame_variance_dn2(0.0, 0.01, readout, fixed_pattern=False)) / readout.dn_per_e**2
    ),
    "variance": lambda readout: float(frame_variance_dn2(0.0, 0.01, readout)) / readout.dn_per_e**2,
    "spread in the dark": lambda readout: dark_spread_e(readout, 0.01) ** 2,
    "clip in the dark": lambda readout: dark_clip(readout, 0.01, 1e4)["spread_e"] ** 2,
    "residual of a correction": residual_e2,
}


@pytest.mark.parametrize(("is_temporal", "along"), KINDS)
def test_a_new_source_stands_in_every_closed_form(
    is_temporal: bool, along: Along, monkeypatch: pytest.MonkeyPatch
) -> None:
    readout = Readout.of(derive(Pixel(**SHEET | {"read_noise_e": 0.0})))
    before = {name: variance(readout) for name, variance in CLOSED_FORMS.items()}
    source = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, source))
    lacking = {"offsets"} if is_temporal else {"noise floor", "temporal variance"}
    for name, variance in CLOSED_FORMS.items():
        expected = 0.0 if name in lacking else 900.0
        check(name, variance(readout) - before[name], expected, atol=1e-6, why="rounding")


@pytest.mark.parametrize(("is_temporal", "along"), KINDS)
def test_a_new_source_is_drawn_as_closed_forms_have_it(
    is_temporal: bool, along: Along, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A source of 30 e-, shared along its lines, and the same in another frame if it is fixed."""
    readout = Readout.of(derive(Pixel(**SHEET)))
    other_e2 = float(frame_variance_dn2(SIGNAL_E, 0.01, readout)) / readout.dn_per_e**2
    source = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, source))
    frames = deviations_e(readout, (FEW, MANY) if along == "column" else (MANY, FEW))
    first, second = frames
    if along != "pixel":
        other_e2 /= FEW
        first, second = (frame.mean(axis={"row": 1, "column": 0}[along]) for frame in frames)
    check_mean("variance", first**2, 900.0 + other_e2)
    check_mean("covariance of two frames", first * second, 0.0 if is_temporal else 900.0)


def test_new_number_is_one_field_and_its_use() -> None:
    """Row noise stands in two files of the package."""
    package = Path(pixsim.__file__).parent
    naming = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "row_noise_e" in path.read_text("utf-8")
    }
    assert naming == {"sensor/pixel_options.py", "sensor/noise.py"}
    assert NUMBERS["row_noise_e"].in_technology
