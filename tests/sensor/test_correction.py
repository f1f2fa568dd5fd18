"""Correction of frames by dark frames, flat frames, dark rows and neighbours: residuals against
their closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import tiny
from pydantic import ValidationError

import pixsim
from pixsim.base.arrays import Array, stream
from pixsim.base.errors import PixsimError
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.sensor.correction import (
    correct,
    flat_light_e,
    outliers,
    residual_variance_e2,
    without_defects,
)
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, Sensor, capture_from_rates, sample_sensor

SHAPE = (200, 250)
TIME_S = 0.02
# A clean pixel in which each kind of noise is visible, in a linear range: no clipping at 0 DN, no
# saturation.
NOISY: dict[str, Any] = {
    "pitch_um": 6.0, "full_well_e": 20000.0, "read_noise_e": 20.0, "dark_current_e_per_s": 5e4, "quantum_efficiency": 0.5,
    "prnu": 0.02, "dsnu": 0.05, "offset_fpn": 0.003, "column_fpn": 0.002, "bits": 14, "black_level_dn": 800.0,
}  # fmt: skip


def pixel(**over: float) -> Readout:
    return Readout.of(derive(Pixel(**NOISY | over)))


def sensor_of(readout: Readout, shape: tuple[int, int] = SHAPE, seed: int = 0) -> Sensor:
    return sample_sensor(readout, shape, np.random.default_rng(seed))


def picture(sensor: Sensor, signal_e: float, correction: Correction, key: object = 0) -> Frame:
    """An even picture, corrected."""
    rate = np.full(sensor.shape, signal_e / TIME_S)
    frame = capture_from_rates(rate, sensor, Exposure(integration_s=TIME_S), stream("picture", key))
    return correct(frame, sensor, correction, stream("correction", key))


def residual(frame: Frame, signal_e: float) -> Array:
    return frame.estimate_e - signal_e


CORRECTIONS: dict[str, dict[str, Any]] = {
    "dark": {"dark_frames": 4},
    "one dark": {"dark_frames": 1},
    "flat": {"flat_frames": 8, "flat_level": 0.6},
    "dark and flat": {"dark_frames": 4, "flat_frames": 4},
    "rows": {"column_clamp": 16},
    "rows, dark": {"column_clamp": 8, "dark_frames": 4},
    "all": {"column_clamp": 8, "dark_frames": 4, "flat_frames": 8},
}


@pytest.mark.parametrize("signal_e", [0.0, 8000.0, 15000.0])
@pytest.mark.parametrize("name", CORRECTIONS)
def test_correct_leaves_the_closed_form(name: str, signal_e: float) -> None:
    """Variance over pixels. Its relative standard error is √(2/50 000) = 0.63 %; with 250 columns,
    that of a column's share 9 %.

    Gate 4.5 standard errors, false alarm 7e-6 each. The closed form is of first order: PRNU² and
    1/L beside 1 are 4e-4.
    """
    readout, correction = pixel(), Correction(**CORRECTIONS[name])
    found = residual(picture(sensor_of(readout), signal_e, correction, name), signal_e)
    expected = residual_variance_e2(signal_e, TIME_S, readout, correction).total
    # What all pixels of a column share has 250 values only.
    rows = correction.column_clamp
    dark_e = readout.dark_current_e_per_s * TIME_S
    shared = (
        (readout.physics.column_fpn_e**2 if not rows else 0.0)
        if not correction.dark_frames
        else 0.0
    )
    dark_pixel = (
        readout.physics.reset_noise_e**2
        + readout.read_noise_e**2
        + dark_e
        + readout.physics.offset_fpn_e**2
        + (readout.physics.dsnu * dark_e) ** 2
    )
    shared += dark_pixel / rows if rows else 0.0
    error = np.hypot(expected * np.sqrt(2 / found.size), shared * np.sqrt(2 / SHAPE[1]))
    assert found.var() == pytest.approx(expected, abs=4.5 * error + 2e-3 * expected)


@pytest.mark.parametrize("name", ["dark", "flat", "dark and flat"])
def test_correct_at_gain_leaves_the_closed_form(name: str) -> None:
    """Dark and flat frames have the gain of the picture, whatever that of the sensor; the read
    noise behind it is a tenth.

    Gate as above. At 0 dB the read noise would be 300 e-, and the flat level beyond the ADC's
    range.
    """
    own = pixel(dark_current_e_per_s=2e3, read_noise_after_gain_e=300.0, column_fpn=0.0)
    correction, signal_e, exposure = (
        Correction(**CORRECTIONS[name]),
        700.0,
        Exposure(integration_s=TIME_S, gain_db=20.0),
    )
    sensor, amplified, found = sensor_of(own), own.at(exposure), []
    frame = capture_from_rates(np.full(SHAPE, signal_e / TIME_S), sensor, exposure, stream("gain"))
    for each in (sensor, replace(sensor, readout=amplified)):
        found.append(
            residual(correct(frame, each, correction, stream("correction of gain")), signal_e)
        )
    np.testing.assert_array_equal(*found)
    expected = residual_variance_e2(signal_e, TIME_S, amplified, correction).total
    assert found[0].var() == pytest.approx(expected, rel=4.5 * np.sqrt(2 / found[0].size) + 4e-3)
    assert residual_variance_e2(
        0.0, TIME_S, amplified, Correction(dark_frames=1)
    ).total == pytest.approx(
        2
        * (
            20.0**2 + 30.0**2 + own.physics.reset_noise_e**2 + 40.0 + 1 / 12 / amplified.dn_per_e**2
        ),
        rel=1e-12,
    )


def test_correct_removes_what_it_claims() -> None:
    """More frames than pixels have noise leave the temporal noise of the picture alone, within
    1 %.
    """
    readout, correction = pixel(), Correction(dark_frames=200, flat_frames=200)
    signal_e = 8000.0
    found = residual(picture(sensor_of(readout, (60, 80)), signal_e, correction), signal_e)
    alone = residual_variance_e2(
        signal_e, TIME_S, pixel(prnu=0, dsnu=0, offset_fpn=0, column_fpn=0), Correction()
    ).total
    uncorrected = residual_variance_e2(signal_e, TIME_S, readout, Correction()).total
    assert uncorrected > 3 * alone
    assert found.var() == pytest.approx(alone, rel=0.01 + 4.5 * np.sqrt(2 / found.size))


def test_dark_frames_remove_a_clipped_dark_level() -> None:
    """Without a black level half of the dark noise is clipped, which brightens black; dark frames
    have the same mean.

    The mean of 50 000 differences of two pixels' clipped noise: standard error below 0.3 e-; gate
    4.5 of them.
    """
    readout = pixel(black_level_dn=0.0, dark_current_e_per_s=0.0, offset_fpn=0.01)
    sensor = sensor_of(readout)
    plain = capture_from_rates(
        np.zeros(SHAPE), sensor, Exposure(integration_s=TIME_S), stream("p")
    ).estimate_e.mean()
    found = residual(picture(sensor, 0.0, Correction(dark_frames=4)), 0.0)
    assert plain > 40.0
    assert abs(found.mean()) < 4.5 * found.std() / np.sqrt(found.size)


def test_flat_frames_keep_the_mean_and_the_scene() -> None:
    """The mean response is 1, so that a picture's mean is its light; a scene with a gradient stays
    one.
    """
    readout = pixel()
    sensor = sensor_of(readout)
    ramp = np.linspace(2000.0, 12000.0, SHAPE[1]) * np.ones((SHAPE[0], 1))
    frame = capture_from_rates(
        ramp / TIME_S, sensor, Exposure(integration_s=TIME_S), stream("ramp")
    )
    found = correct(
        frame, sensor, Correction(dark_frames=16, flat_frames=16), stream("c")
    ).estimate_e
    spread = np.sqrt(
        residual_variance_e2(
            12000.0, TIME_S, readout, Correction(dark_frames=16, flat_frames=16)
        ).total
    )
    assert (
        np.abs(found.mean(axis=0) - ramp[0]).max() < 5 * spread / np.sqrt(SHAPE[0]) + 2e-3 * 12000
    )  # the mean of 50 000 gains


def test_correct_kinds_have_streams_of_their_own() -> None:
    """Dark rows do not change the noise of the dark frames: with noiseless rows the results are
    equal.
    """
    readout, off = (
        pixel(),
        {"dsnu": 0, "offset_fpn": 0, "read_noise_e": 0, "dark_current_e_per_s": 0, "column_fpn": 0},
    )
    quiet = pixel(**off, black_level_dn=100)
    sensor = sensor_of(quiet, (20, 30))
    one = picture(sensor, 5000.0, Correction(flat_frames=2)).estimate_e
    other = picture(sensor, 5000.0, Correction(flat_frames=2, column_clamp=3)).estimate_e
    np.testing.assert_allclose(one, other, rtol=1e-6)
    again = picture(sensor_of(readout), 100.0, Correction(dark_frames=2)).estimate_e
    np.testing.assert_array_equal(
        again, picture(sensor_of(readout), 100.0, Correction(dark_frames=2)).estimate_e
    )


# --- defects
# ----------------------------------------------------------------------------------------------------------


def test_defects_take_the_mean_of_sound_neighbours() -> None:
    values = np.arange(30.0).reshape(5, 6)
    defects = np.zeros(values.shape, bool)
    defects[2, 2] = defects[0, 0] = True
    found = without_defects(np.where(defects, 1e6, values), defects)
    assert found[2, 2] == pytest.approx((values[1:4, 1:4].sum() - values[2, 2]) / 8)
    assert found[0, 0] == pytest.approx((1 + 6 + 7) / 3)
    np.testing.assert_array_equal(found[~defects], values[~defects])
    defects[1:4, 1:4] = True  # the middle one has sound pixels two away only
    assert without_defects(np.where(defects, 1e6, values), defects)[2, 2] == pytest.approx(
        np.mean(values[:, :5][~defects[:, :5]])
    )


def test_defects_are_found_in_dark_and_flat_frames() -> None:
    """A hot pixel in dark frames, a dead one in flat frames; sound pixels are outliers with a
    probability of 2e-9.
    """
    readout = pixel(dsnu=0.0)
    sensor = sensor_of(readout)
    assert sensor.gain is not None
    gain, hot = sensor.gain.copy(), np.zeros(SHAPE)
    gain[10, 10] = 0.0
    hot[50, 60] = 3000.0
    assert sensor.offset_e is not None
    broken = replace(sensor, gain=gain, offset_e=sensor.offset_e + hot)
    correction = {"dark_frames": 4, "flat_frames": 4}
    kept = residual(picture(broken, 5000.0, Correction(**correction)), 5000.0)
    mended = residual(picture(broken, 5000.0, Correction(**correction, defects=True)), 5000.0)
    assert kept[10, 10] < -4000
    assert abs(mended[10, 10]) < 500
    others = np.ones(SHAPE, bool)
    others[10, 10] = others[50, 60] = False
    np.testing.assert_array_equal(mended[others], kept[others])


def test_outliers_of_equal_values_are_none() -> None:
    assert not outliers(np.full((4, 4), 3.0), 0.1).any()
    assert outliers(np.array([0.0] * 9 + [1.0]), 0.1).tolist() == [False] * 9 + [True]


# --- its place in pixsim
# ----------------------------------------------------------------------------------------------


def test_flat_level_below_dark_charge_raises() -> None:
    readout = pixel(dark_current_e_per_s=9e5)
    with pytest.raises(
        PixsimError, match=r"correction.flat_level: got 0.5, with 18000 e- of dark charge"
    ):
        flat_light_e(readout, Correction(flat_frames=1), TIME_S)


@pytest.mark.parametrize(
    "wrong",
    [
        {"defects": True},
        {"dark_frames": -1},
        {"flat_level": 0},
        {"column_clamp": 1.5},
        {"darks": 2},
    ],
)
def test_correction_invalid_raises(wrong: dict[str, Any]) -> None:
    with pytest.raises((ValidationError, PixsimError), match=next(iter(wrong))):
        Correction(**wrong)


def test_evaluate_off_is_as_before_and_on_is_better() -> None:
    """Offsets of 1 % of the well on an even field: corrected, most of the error is gone; off, the
    frame is the same.
    """
    light = pixsim.SpectralImage(
        [550.0], 10.0, 20.0, data=np.full((40, 40, 1), 1e-3), header={"diffraction": False}
    )
    camera, display = pixsim.Camera(die_mm=0.8), pixsim.Display(white_cd_per_m2=1000, dots=32)
    noisy = pixsim.Pixel(pitch_um=20.0, offset_fpn=0.01, black_level_dn=200)
    plain = pixsim.evaluate(light, camera, noisy, display=display)
    off = pixsim.evaluate(light, camera, noisy, display=display, correction=Correction())
    on = pixsim.evaluate(
        light, camera, noisy, display=display, correction=Correction(dark_frames=16)
    )
    np.testing.assert_array_equal(plain.delta_e, off.delta_e)
    np.testing.assert_array_equal(plain.frame.dn, on.frame.dn)
    assert on.mean_delta_e < 0.6 * plain.mean_delta_e


def test_study_with_correction_continues_from_its_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cached frames keep their corrected electrons: another display gets the numbers of a study
    without cache.
    """
    over: dict[str, Any] = {
        "correction": {"dark_frames": 2, "column_clamp": 4},
        "resolution": 48,
        "camera": {"die_mm": 0.7},
    }
    first = pixsim.study(tiny(**over), tmp_path / "a", jobs=1)
    again = pixsim.study(tiny(**over, display={"gamma": 2.0}), tmp_path / "b", jobs=1)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "empty"))
    fresh = pixsim.study(tiny(**over, display={"gamma": 2.0}), tmp_path / "fresh", jobs=1)
    np.testing.assert_array_equal(again.curves[0].delta_e, fresh.curves[0].delta_e)
    plain = pixsim.study(tiny(**over | {"correction": {}}), tmp_path / "c", jobs=1)
    assert (first.curves[0].delta_e != plain.curves[0].delta_e).all()


def test_run_with_correction_states_it() -> None:
    result = pixsim.run("csf", resolution=48, correction={"dark_frames": 2}, display={"dots": 32})
    assert result.as_dict()["correction"]["dark_frames"] == 2
    assert not [note for note in result.as_dict()["notes"] if note["id"] == "black_level"]
    with pytest.raises(PixsimError, match="dark_frames or flat_frames above 0"):
        pixsim.run("csf", correction={"defects": True})
