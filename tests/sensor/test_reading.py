"""How pixels are read: one record of gain, exposures, ADC, black level and binning, against closed
forms.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Adc, Readout
from pixsim.sensor.readout import make_sensor, sample_sensor

SHEET = {
    "technology": "none", "pitch_um": 2.0, "full_well_e": 8000.0, "read_noise_e": 1.5, "read_noise_after_gain_e": 4.0,
    "dark_current_e_per_s": 50.0, "quantum_efficiency": 0.5, "bits": 12, "black_level_dn": 95.0, "prnu": 0.02, "dsnu": 0.3,
}  # fmt: skip


def binned(**more: float) -> PixelPhysics:
    """Return a pixel of a sensor that sums the charge of 2 × 2 pixels."""
    sheet = {name: value for name, value in SHEET.items() if name != "quantum_efficiency"}
    colour = {
        "pattern": "quad_rggb",
        "binning": True,
        "sensitivities": "Nikon_D5100",
        "peak_quantum_efficiency": 0.5,
    }
    return derive(Pixel.model_validate(sheet | {"colour": colour} | more))


def test_codes_of_an_adc_follow_its_gain_or_its_span() -> None:
    """A span of 8000 e- over the 4000 codes above 95 DN, and the gain of 2 e-/DN, are one ADC."""
    by_gain, by_span = Adc(12, 95.0, gain_e_per_dn=2.0), Adc(12, 95.0, span_e=8000.0)
    assert by_gain.codes_dn == by_span.codes_dn == 4000.0
    assert by_gain.full_scale_e == by_span.full_scale_e == 8000.0
    assert by_gain.dn_per_e == by_span.dn_per_e == 0.5


def test_readout_of_an_exposure_is_that_of_the_pixel_taken_to_it() -> None:
    """20 dB: a tenth of the range, ten times the gain, and √(1.5² + 0.4²) of read noise; of 4
    exposures their sum.
    """
    exposure = Exposure(gain_db=20.0, frames=4)
    readout = Readout.of(derive(Pixel(**SHEET)), exposure)
    assert readout == Readout.of(readout.physics).at(exposure)
    assert (readout.adc_range_e, readout.dn_per_e) == pytest.approx((800.0, 5.0), rel=1e-12)
    assert readout.noise_floor_e == pytest.approx(2 * math.hypot(1.5, 0.4), rel=1e-12)
    assert (readout.saturation_e, readout.black_level_dn, readout.top_code_dn) == pytest.approx(
        (3200.0, 380.0, 4 * 4095), rel=1e-12
    )


@pytest.mark.parametrize("adc", [{}, {"gain_e_per_dn": 2.0}, {"adc_full_scale_e": 8000.0}])
def test_binned_charge_adds_up_and_is_read_once(adc: dict[str, float]) -> None:
    """Wells, dark currents and the ADC's range are four times as large, gains and dark currents
    vary half as much.
    """
    physics = binned(**adc)
    single, summed = Readout.of(physics, bin_side=1), Readout.of(physics)
    assert (single.bin_side, summed.bin_side) == (1, 2)
    for name in ("full_well_e", "dark_current_e_per_s", "adc_range_e", "saturation_e"):
        assert getattr(summed, name) == 4 * getattr(single, name)
    assert (summed.dn_per_e, summed.prnu, summed.dark_spread.dsnu) == (
        single.dn_per_e / 4,
        0.01,
        0.15,
    )
    assert summed.noise_floor_e == single.noise_floor_e


def test_binned_hot_pixels_are_those_with_a_hot_one_among_them() -> None:
    """1 - (1 - φ)⁴ of the sums; the mean of the rest of a hot sum is that of three ordinary
    pixels.
    """
    summed = Readout.of(
        binned(hot_pixel_fraction=0.01, hot_pixel_median=41.0, hot_pixel_spread=0.5)
    ).dark_spread
    assert summed.hot_fraction == pytest.approx(1 - 0.99**4, rel=1e-14)
    assert (summed.hot_median, summed.hot_spread) == (11.0, 0.5)


def test_sensor_has_the_readout_of_its_pixels_settings() -> None:
    """At 0 dB and in one exposure: those of a capture are the exposure's."""
    pixel = Pixel(pitch_um=84.8, black_level_dn=40.0)
    sensor = make_sensor(pixel, Camera())
    assert sensor.readout == Readout.of(derive(pixel))
    again = sample_sensor(sensor.readout, sensor.shape, np.random.default_rng(0))
    np.testing.assert_array_equal(sensor.gain, again.gain)
