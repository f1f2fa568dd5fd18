"""Gain and time of a frame."""

from __future__ import annotations

from pydantic import Field

from pixsim.base.records import Record
from pixsim.light.quantities import Fraction
from pixsim.sensor.quantities import GainDb, Seconds


class Exposure(Record):
    """Gain and time: manual if `integration_s` is given, else such that the brightest pixel reaches `well_target` of saturation."""

    integration_s: Seconds | None = Field(None, description="exposure time (absent: automatic exposure)")
    max_integration_s: Seconds = Field(0.1, description="longest exposure time of the automatic exposure")
    well_target: Fraction = Field(
        0.95,
        description="automatic exposure: mean signal of the brightest pixel, as a fraction of saturation (the lower of the full "
        "well and the range of the ADC at gain_db)",
    )
    gain_db: GainDb = Field(
        0.0,
        description="amplification before the ADC; at 0 dB the codes above the black level span the full well, unless pixel gives "
        "gain_e_per_dn, dn_per_e or adc_full_scale_e",
    )
