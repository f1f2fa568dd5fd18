"""Irradiance to digital numbers: `SpectralImage`, `Camera`, `Pixel` and a seed in, `Frame` out.

What a user states: `pixel_options` (with `number`, `quantities`, `stack_options`, `colour_options`,
`spread`), `exposure` and `correction_options`; these do not import NumPy. In the order of the flow:
`technology` (CMOS process), `pixel` (areas, well, QE, dark current), `reading` (gain, ADC, range
and noise of a pixel as it is read), `integration` (light to mean electrons), `photodiode`
(electrons to the signal level), `readout` (noise, well and ADC), `raw` (files of frames). May
import: base, light, optics.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pixsim.sensor.reading import (
        Readout as Readout,
        dark_spread_e as dark_spread_e,
        least_black_level_dn as least_black_level_dn,
    )
    from pixsim.sensor.readout import (
        Frame as Frame,
        Sensor as Sensor,
        capture as capture,
        capture_from_rates as capture_from_rates,
        frame_mean_dn as frame_mean_dn,
        frame_variance_dn2 as frame_variance_dn2,
        integration_time_s as integration_time_s,
        make_frame as make_frame,
        make_sensor as make_sensor,
        quantise as quantise,
        read_out as read_out,
        sample_sensor as sample_sensor,
        shot_noise as shot_noise,
    )

__all__ = [
    "Frame",
    "Readout",
    "Sensor",
    "capture",
    "capture_from_rates",
    "dark_spread_e",
    "frame_mean_dn",
    "frame_variance_dn2",
    "integration_time_s",
    "least_black_level_dn",
    "make_frame",
    "make_sensor",
    "quantise",
    "read_out",
    "sample_sensor",
    "shot_noise",
]


def __getattr__(name: str) -> object:
    """Import what needs NumPy on first use: settings, and with them `--help`, do not."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from pixsim.base.door import public
    from pixsim.sensor import reading, readout

    module = reading if name in reading.__all__ else readout
    return public(getattr(module, name), f"pixsim.sensor.{name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
