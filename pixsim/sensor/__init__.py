"""Irradiance to digital numbers: `SpectralImage`, `Camera`, `Pixel` and a seed in, `Frame` out.

In the order of the flow: `technology` (CMOS process), `pixel` (areas, well, QE, dark current), `integration` (light to mean
electrons), `photodiode` (electrons to the signal level), `readout` (noise, well and ADC), `raw` (files of frames).
May import: base, light, optics.
"""

from pixsim.sensor.readout import (
    Frame,
    Sensor,
    capture,
    capture_from_rates,
    dark_spread_e,
    frame_mean_dn,
    frame_variance_dn2,
    integration_time_s,
    least_black_level_dn,
    make_frame,
    make_sensor,
    quantise,
    read_out,
    sample_sensor,
    shot_noise,
)

__all__ = [
    "Frame", "Sensor", "capture", "capture_from_rates", "dark_spread_e", "frame_mean_dn", "frame_variance_dn2",
    "integration_time_s", "least_black_level_dn", "make_frame", "make_sensor", "quantise", "read_out", "sample_sensor",
    "shot_noise",
]  # fmt: skip
