"""The sources of noise: each is drawn, and stands in every closed form, from its one line in
`SOURCES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.measure.datasheet import make_datasheet
from pixsim.measure.experiment import SHAPE
from pixsim.sensor.correction import residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.noise import SOURCES, NoiseSource
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import dark_spread_e, frame_variance_dn2, read_out, sample_sensor
from pixsim.viewer.dark_clip import dark_clip

SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 4e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 0.0,
    "quantum_efficiency": 0.5,
}
SHEET |= {"bits": 14, "black_level_dn": 500.0, "gain_e_per_dn": 0.5}
ROWS, COLUMNS = 40_000, 16


def frames(readout: Readout, count: int, mean_e: float = 100.0) -> np.ndarray:
    """Frames of one sensor in electrons above the black level, (count, rows, columns)."""
    sensor = sample_sensor(readout, (ROWS, COLUMNS), np.random.default_rng(5))
    shots = [
        read_out(np.full(sensor.shape, mean_e), 0.01, sensor, np.random.default_rng(9 + number))
        for number in range(count)
    ]
    return (np.stack(shots) - readout.adc.black_level_dn) / readout.dn_per_e


def within(values: np.ndarray, expected: float) -> bool:
    """Whether the mean of independent values is within 5 standard errors of the expected one: 6e-7
    false alarms.
    """
    error = values.std(ddof=1) / math.sqrt(values.size)
    return bool(abs(values.mean() - expected) < 5 * error)


@pytest.mark.parametrize("row_noise_e", [0.7, 6.0])
def test_row_noise_is_shared_along_rows_and_new_in_each_frame(row_noise_e: float) -> None:
    readout = Readout.of(derive(Pixel(**SHEET, row_noise_e=row_noise_e)))
    first, second = frames(readout, 2)
    of_pixel_e2 = 100.0 + 2.0**2 + 0.5**2 / 12
    # Rows are independent: the mean over a row keeps the row's own value, and so does the product
    # of two of its pixels.
    assert within((first - 100.0).mean(axis=1) ** 2, row_noise_e**2 + of_pixel_e2 / COLUMNS)
    assert within((first[:, 0] - 100.0) * (first[:, 1] - 100.0), row_noise_e**2)
    assert within((first - 100.0).mean(axis=1) * (second - 100.0).mean(axis=1), 0.0), (
        "nothing of it is fixed"
    )
    whole = float(frame_variance_dn2(100.0, 0.01, readout)) / readout.dn_per_e**2
    assert whole == pytest.approx(100.0 + 2.0**2 + row_noise_e**2 + 0.5**2 / 12, rel=1e-12)
    assert within(((first - 100.0) ** 2).mean(axis=1), whole)


def test_no_row_noise_leaves_the_random_numbers_as_they_are() -> None:
    without, zero = (
        Readout.of(derive(Pixel(**SHEET, **more))) for more in ({}, {"row_noise_e": 0.0})
    )
    np.testing.assert_array_equal(frames(without, 1), frames(zero, 1))


def test_sum_that_holds_row_noise_takes_its_place() -> None:
    own = {name: value for name, value in SHEET.items() if name != "read_noise_e"}
    assert Readout.of(derive(Pixel(**own, temporal_dark_noise_e=3.0))).noise_floor_e == 3.0
    with pytest.raises(
        ValueError, match="temporal_dark_noise_e and row_noise_e state the same quantity"
    ):
        Pixel(**own, temporal_dark_noise_e=3.0, row_noise_e=1.0)


CONSTANT = [source for source in SOURCES if not source.grows_with]


@pytest.mark.parametrize(
    ("is_temporal", "along"), [(True, "pixel"), (True, "row"), (False, "pixel"), (False, "column")]
)
def test_a_new_source_stands_in_every_closed_form(
    is_temporal: bool, along: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A source of 30 e- beside none: what states a variance, a spread or a list has it."""
    readout = Readout.of(derive(Pixel(**SHEET | {"read_noise_e": 0.0})))
    new = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    before = {name: number(readout) for name, number in CLOSED_FORMS.items()}
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, new))
    added = {name: number(readout) - before[name] for name, number in CLOSED_FORMS.items()}
    temporal_only = {"noise floor", "temporal variance"}
    expected = {
        name: 900.0 if is_temporal or name not in temporal_only else 0.0 for name in CLOSED_FORMS
    }
    expected["offsets"] = 0.0 if is_temporal else 900.0
    assert added == {name: pytest.approx(value, rel=1e-9) for name, value in expected.items()}


@pytest.mark.parametrize(
    ("is_temporal", "along"), [(True, "pixel"), (True, "row"), (False, "pixel"), (False, "column")]
)
def test_a_new_source_is_drawn_as_closed_forms_have_it(
    is_temporal: bool, along: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A source of 30 e-, shared along its lines, and the same in another frame if it is fixed."""
    readout = Readout.of(derive(Pixel(**SHEET)))
    alone_e2 = float(frame_variance_dn2(100.0, 0.01, readout)) / readout.dn_per_e**2
    new = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, new))
    assert float(frame_variance_dn2(100.0, 0.01, readout)) / readout.dn_per_e**2 == pytest.approx(
        alone_e2 + 900.0, rel=1e-12
    )
    sensor = sample_sensor(
        readout, (COLUMNS, ROWS) if along == "column" else (ROWS, COLUMNS), np.random.default_rng(5)
    )
    frames = [
        read_out(np.full(sensor.shape, 100.0), 0.01, sensor, np.random.default_rng(seed))
        for seed in (9, 10)
    ]
    noise_e = [(frame - readout.adc.black_level_dn) / readout.dn_per_e - 100.0 for frame in frames]
    first, second = (
        each.mean(axis={"row": 1, "column": 0}[along]) if along != "pixel" else each.ravel()
        for each in noise_e
    )
    assert within(first**2, 900.0 + alone_e2 / (1 if along == "pixel" else COLUMNS))
    assert within(first * second, 0.0 if is_temporal else 900.0)


def residual_e2(readout: Readout) -> float:
    """What a camera without correction leaves of all noise but that of light."""
    found = residual_variance_e2(0.0, 0.01, readout, Correction())
    return float(found.temporal + found.offsets)


CLOSED_FORMS: dict[str, Callable[[Readout], float]] = {
    "noise floor": lambda p: p.noise_floor_e**2,
    "offsets": lambda p: p.offset_e**2,
    "temporal variance": lambda p: (
        float(frame_variance_dn2(0.0, 0.01, p, fixed_pattern=False)) / p.dn_per_e**2
    ),
    "variance": lambda p: float(frame_variance_dn2(0.0, 0.01, p)) / p.dn_per_e**2,
    "spread in the dark": lambda p: dark_spread_e(p, 0.01) ** 2,
    "clip in the dark": lambda p: dark_clip(p, 0.01, 1e4)["spread_e"] ** 2,
    "residual of a correction": residual_e2,
}


def test_new_number_is_one_field_and_its_use() -> None:
    """Row noise stands in two files of the package beside its closed forms' one source."""
    package = Path(pixsim.__file__).parent
    naming = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "row_noise_e" in path.read_text("utf-8")
    }
    assert naming == {"sensor/pixel_options.py", "sensor/noise.py"}
    assert NUMBERS["row_noise_e"].in_technology


def test_standard_errors_of_a_data_sheet_cover_row_noise() -> None:
    """Of 3 seeds × 5 numbers that temporal noise in the dark enters, deviations over standard
    errors have an RMS near 1.

    With 15 values the RMS of normal deviations is below 1.73 in all but 1e-5 of cases, and above
    0.4 likewise. As many columns as usual, since the noise of rows weighs by their number, and a
    quarter of the rows, on whose number no deviation depends.
    """
    names = ("σ_d", "μ_I.var", "DSNU_1288.row", "σ_temp", "K")
    scores = []
    for seed in range(3):
        pixel = Pixel(**SHEET | {"dark_current_e_per_s": 20.0, "row_noise_e": 4.0})
        sheet = make_datasheet(pixel, shape=(SHAPE[0] // 4, SHAPE[1]), seed=seed)
        entries = {entry.symbol: entry for entry in sheet.entries}
        scores += [
            (entries[name].measured - entries[name].true) / entries[name].standard_error
            for name in names
        ]
    assert 0.4 < math.sqrt(float(np.mean(np.square(scores)))) < 1.73, scores
