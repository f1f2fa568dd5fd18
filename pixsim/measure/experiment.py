"""The photon-transfer experiment of EMVA 1288: one simulated sensor under uniform monochromatic
light, and in the dark.

The light rises in equal steps from dark to beyond saturation at one integration time, with two
frames a step (Release 4.0 Linear, section 6.5). Stacks of frames in the dark and at half of
saturation give the spatial terms (8), dark pairs at several times (7.1) and temperatures (7.2) the
dark current. The fixed pattern is sampled once. Every frame has its own random stream, so that it
does not depend on which other frames are captured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, stream
from pixsim.base.caller import setting
from pixsim.base.digits import rounded
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import warn
from pixsim.measure.estimators import Frames, PairSeries, pair, series
from pixsim.sensor.collection import collected_fraction, emva_illumination
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import MAX_BLACK_SHARE, PixelPhysics, derive
from pixsim.sensor.pixel_notes import pixel_notes
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout, dark_spread_e, least_black_level_dn, with_all, with_merge
from pixsim.sensor.readout import (
    Sensor,
    frame_variance_dn2,
    read_electrons,
    read_out,
    sample_sensor,
)
from pixsim.sensor.technology import load_technology

SHAPE = 200, 200  # pixels: standard errors of 0.7 % for a variance and 0.2 % for a fitted slope
MIN_SIDE = 3  # pixels, whose variance divides into that of rows, of columns and of single pixels
EXPOSURES = 50  # the minimum of EMVA 1288, section 6.5
# Of the characteristic curve: exposures a decade, up to where steps of the light series are finer.
_PER_DECADE = 16
_FIRST_FINE = 7
_LOWEST_SNR = 0.3
_DIM_EXPOSURES = 12  # more, at equal ratios below the first: ISO 12232 needs the exposure of S/N 10
# Of the light that fills the well, so that the series spans the peak of the variance.
_BEYOND_SATURATION = 1.1
STACK = 64  # frames; the standard requires at least 16
DARK_TIMES = 8  # the standard requires at least 6
# Of the dark series, from the pixel's temperature.
_TEMPERATURE_STEPS_K = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
_MAX_TEMPERATURE_K = 400.0
_USUAL_INTEGRATION_S = 0.030  # of Fig. 2 of Chen et al. (2000)
# Of saturation: limit of the dark charge in the light series, if no integration time is given.
_DARK_SHARE = 0.02
_MAX_DARK_SHARE = 0.2  # of saturation, at the longest time of the dark series
_MAX_DARK_S = 3600.0
_SEARCH_NM = (200.0, 1200.0)  # range of the search for the peak of the response
_FULL_LEVEL = 0.999  # of saturation: a soft one counts as full from here
_MAX_LIGHT = 4.0  # times saturation, of generated charge: end of the search for soft saturation


@dataclass(frozen=True)
class Experiment:
    """The sensor and the exposures of a photon-transfer experiment.

    All pixels of a colour sensor have the filter of its most frequent channel: EMVA 1288 measures
    each channel separately. Of pixels that are read several times, the linear experiment has the
    most sensitive reading.

    sensor : of the linear experiment
    whole : the same device with all its readings
    photons : (n,) per pixel, in rising order, one for each pair of the light series
    dark_times_s, temperatures_k : of the dark series
    general_photons : (n,) of the characteristic curve, rising, the first one 0; None without it
    stated_black_dn : black level in the user's settings, or None if they state none; the level of
        the sensor's ADC is used
    """

    sensor: Sensor = field(repr=False)
    whole: Sensor = field(repr=False)
    wavelength_nm: float
    integration_s: float
    photons: Array = field(repr=False)
    dim_photons: Array = field(repr=False)
    dark_times_s: Array = field(repr=False)
    temperatures_k: tuple[float, ...]
    stated_black_dn: float | None
    stack_frames: int = STACK
    seed: int = 0
    general_photons: Array | None = field(default=None, repr=False)

    @property
    def readout(self) -> Readout:
        """How the device's pixels are read."""
        return self.sensor.readout

    @property
    def physics(self) -> PixelPhysics:
        """Physical properties of a single pixel."""
        return self.readout.physics

    @property
    def pixel(self) -> Pixel:
        """Settings of the pixel, with the black level that is used."""
        return self.physics.pixel.model_copy(
            update={"black_level_dn": self.readout.adc.black_level_dn}
        )

    @cached_property
    def efficiency(self) -> float:
        """Electrons per photon on the whole pixel (η of EMVA 1288): QE(λ) times fill factor."""
        return pixel_efficiency(self.physics, self.wavelength_nm)

    def frame(
        self, photons: float, integration_s: float, *key: object, sensor: Sensor | None = None
    ) -> Frames:
        """One frame of the device, (rows, columns) linear DN; the key names its random stream."""
        exposed = sensor or self.sensor
        mean_e = np.full(exposed.shape, photons * self.efficiency)
        return read_linear(mean_e, integration_s, exposed, stream("datasheet", self.seed, *key))

    def outputs(self, count: int, photons: float, *key: object) -> Iterator[NDArray[Any]]:
        """Frames as the device hands them on, (rows, columns): merged electrons of several
        readings, or codes, companded if its ADC does so.
        """
        sensor = self.whole if self.is_merged else self.sensor
        read: Callable[..., NDArray[Any]] = read_electrons if self.is_merged else read_out
        mean_e = np.full(sensor.shape, photons * self.efficiency)
        for index in range(count):
            rng = stream("datasheet", self.seed, *key, index)
            yield read(mean_e, self.integration_s, sensor, rng)

    @property
    def is_merged(self) -> bool:
        """Whether the device hands on the merge of several readings."""
        return len(self.whole.readout.readings) > 1

    def for_channel(self, letter: str, wavelength_nm: float | None) -> Experiment:
        """The light series of the same device under the filter of another channel, to the same
        electrons.

        wavelength_nm : of the light, by default the peak of the channel's response

        Raises PixsimError for a wavelength without response.
        """
        physics = replace(self.physics, channel=letter)
        nm = peak_wavelength_nm(physics) if wavelength_nm is None else wavelength_nm
        efficiency = _checked_efficiency(physics, nm)
        photons = self.photons * (self.efficiency / efficiency)
        sensor = replace(self.sensor, readout=replace(self.readout, physics=physics))
        return replace(self, sensor=sensor, wavelength_nm=nm, photons=photons)

    def frames(self, count: int, photons: float, *key: object) -> Iterator[Frames]:
        """Frames under the same light at the integration time of the light series."""
        return (self.frame(photons, self.integration_s, *key, index) for index in range(count))

    def dark_series(self, temperature_k: float | None = None) -> PairSeries:
        """Dark pairs at each integration time; at higher temperatures the times are shorter, so
        that the well does not fill.
        """
        key: tuple[object, ...] = ("dark series",)
        sensor = self.sensor
        times_s = self.dark_times_s
        if temperature_k is not None:
            key = ("temperature", round(1e6 * temperature_k))
            sensor = self.warmed(temperature_k)
            ratio = self.readout.dark_current_e_per_s / sensor.readout.dark_current_e_per_s
            times_s = times_s * min(ratio, 1.0)

        pairs = []
        for number, time_s in enumerate(times_s.tolist()):
            first = self.frame(0.0, time_s, *key, number, 0, sensor=sensor)
            second = self.frame(0.0, time_s, *key, number, 1, sensor=sensor)
            pairs.append(pair(first, second))

        return series(times_s, pairs)

    def warmed(self, temperature_k: float) -> Sensor:
        """This device at another temperature: only its dark current changes, not its maps."""
        pixel = Pixel.model_validate(
            self.physics.pixel.model_dump() | {"temperature_k": temperature_k}
        )
        device = self.physics
        warm = replace(
            derive(pixel, device.technology), full_well_e=device.full_well_e, channel=device.channel
        )
        return replace(self.sensor, readout=replace(self.readout, physics=warm))


def read_linear(
    mean_e: Array, integration_s: float, sensor: Sensor, rng: np.random.Generator
) -> Frames:
    """Return the frame of `read_out`, whose companded codes are decoded to whole linear DN."""
    dn = read_out(mean_e, integration_s, sensor, rng)
    adc = sensor.readout.adc
    return dn if adc.knees is None else np.rint(adc.levels_of(dn)).astype(np.int32)


def pixel_efficiency(physics: PixelPhysics, wavelength_nm: float) -> float:
    """Electrons per photon on a whole pixel, fill factor included: η of EMVA 1288."""
    light = emva_illumination(np.array([wavelength_nm]), np.ones(1))
    return float(physics.quantum_efficiency(wavelength_nm)) * collected_fraction(physics, light)


def _checked_efficiency(physics: PixelPhysics, wavelength_nm: float) -> float:
    """`pixel_efficiency`; raises PixsimError at a wavelength without response."""
    efficiency = pixel_efficiency(physics, wavelength_nm) if 0 < wavelength_nm < math.inf else 0.0
    if not efficiency > 0:
        allowed = f"a wavelength with a response, such as {peak_wavelength_nm(physics):g} nm"
        channel_words = f" of channel {physics.channel}" if physics.channel else ""
        raise invalid(setting("wavelength_nm"), f"{wavelength_nm:g}", f"{allowed}{channel_words}")
    return efficiency


def _most_frequent_channel(physics: PixelPhysics) -> PixelPhysics:
    """Return a colour pixel with its most frequent channel, or a monochrome pixel itself."""
    if physics.layout is None:
        return physics
    return physics.channels[int(np.argmax(physics.layout.shares))]


def peak_wavelength_nm(physics: PixelPhysics) -> float:
    """Wavelength of the highest response in whole nanometres; the middle one of a plateau."""
    nm = np.arange(*_SEARCH_NM)
    efficiency = physics.quantum_efficiency(nm)
    highest = nm[efficiency >= efficiency.max() * (1 - 1e-9)]
    return float(highest[highest.size // 2])


# Spread of a dark frame from which rounding adds 1/12 DN², wherever the mean of the frame lies.
_FINE_DN = 0.6
# Above a code, where the first term of the error of 1/12 DN², ∝ cos(2π mean), vanishes.
_MIDWAY_DN = 0.25


def with_black_level(readout: Readout, integration_s: float) -> Readout:
    """The readout with a black level of at least 6 σ of its dark noise; raises PixsimError if its
    ADC has too few codes for it.

    A device whose dark frame spreads over less than `_FINE_DN` has every pixel at the same place
    between two codes, and its measured temporal noise depends on that place (at σ = 0.46 DN by ±4
    %). The level is then set where it does not.
    """
    adc = readout.adc
    min_level_dn = least_black_level_dn(readout, integration_s)
    is_stated = readout.physics.pixel.black_level_dn is not None
    if is_stated and adc.black_level_dn >= min_level_dn:
        return readout
    if min_level_dn > MAX_BLACK_SHARE * adc.top_code_dn:
        room = (
            f"for a black level of 6 σ of the dark noise ({min_level_dn} DN) in the lower half of"
            " the codes"
        )
        # Where the ADC spans a stated charge, more bits would make finer codes only.
        if readout.gain_db:
            hint = "Lower exposure.gain_db, or reduce the dark noise."
            raise invalid(
                "exposure.gain_db", f"{readout.gain_db:g}", f"a gain with room {room}", hint
            )
        raise invalid(
            "pixel.bits",
            adc.bits,
            f"enough bits {room}",
            "Raise pixel.bits, or reduce the dark noise.",
        )

    raised = replace(readout, adc=replace(adc, black_level_dn=float(min_level_dn)))
    if dark_spread_e(raised, integration_s) * raised.dn_per_e >= _FINE_DN:
        return raised
    mean_dn = min_level_dn + raised.dark_current_e_per_s * integration_s * raised.dn_per_e
    level_dn = round(min_level_dn + (_MIDWAY_DN - mean_dn) % 1.0, 2)
    return replace(readout, adc=replace(adc, black_level_dn=level_dn))


def _usual_integration_s(readout: Readout, exposure: Exposure) -> float:
    """The integration time of the exposure; by default 30 ms, or less to keep dark charge below 2 %
    of saturation.

    Raises PixsimError if dark charge would fill half the well.
    """
    dark = readout.dark_current_e_per_s
    integration_s = exposure.integration_s
    if integration_s is None and dark:
        return min(_USUAL_INTEGRATION_S, _DARK_SHARE * readout.saturation_e / dark)
    if integration_s is None:
        return _USUAL_INTEGRATION_S
    if dark * integration_s > readout.saturation_e / 2:
        expected = (
            f"at most {rounded(readout.saturation_e / 2 / dark, 3)} s, which fills half of the well"
        )
        raise invalid(
            "exposure.integration_s",
            f"{integration_s:g} s, which collects {rounded(dark * integration_s, 3)} e- of dark"
            " charge",
            expected,
        )

    return integration_s


def _filling_light_e(readout: Readout, integration_s: float) -> float:
    """Mean photo-electrons that fill the well or reach the ADC's top code, including soft
    saturation.
    """
    dark_e = readout.dark_current_e_per_s * integration_s
    grid = np.linspace(0.01, _MAX_LIGHT, 400) * readout.saturation_e
    level = stored_signal_e(grid, integration_s, readout)
    full = np.flatnonzero(level >= _FULL_LEVEL * readout.saturation_e)
    return float(grid[full[0]] if full.size else grid[-1]) - dark_e


def _general_photons(readout: Readout, integration_s: float, efficiency: float) -> Array:
    """Return the photons of a characteristic curve: 0, equal ratios from below an SNR of 1, and
    equal steps to beyond the saturation of the last reading.
    """
    last = with_merge(readout).readings[-1]
    filling_e = _filling_light_e(last.readout, integration_s) / last.response
    steps_e = _BEYOND_SATURATION * filling_e * np.arange(_FIRST_FINE, EXPOSURES + 1) / EXPOSURES
    dark_dn2 = float(frame_variance_dn2(0.0, integration_s, readout, fixed_pattern=False))
    lowest_e = min(_LOWEST_SNR * math.sqrt(dark_dn2) / readout.dn_per_e, steps_e[0] / 2)
    count = math.ceil(_PER_DECADE * math.log10(steps_e[0] / lowest_e))
    dim_e = np.geomspace(lowest_e, steps_e[0], count, endpoint=False)
    return np.concatenate([[0.0], dim_e, steps_e]) / efficiency


def dark_times_s(readout: Readout, integration_s: float) -> Array:
    """Equally spaced integration times, until dark charge fills a fifth of the well, at most an
    hour.
    """
    dark = readout.dark_current_e_per_s
    longest_s = _MAX_DARK_S
    if dark:
        longest_s = min(_MAX_DARK_SHARE * readout.saturation_e / dark, _MAX_DARK_S)
    return np.linspace(integration_s, max(longest_s, 2 * integration_s), DARK_TIMES)


def temperatures_k(pixel: Pixel) -> tuple[float, ...]:
    """The pixel's temperature and higher ones (lower ones near 400 K); empty if the dark current is
    given as a number.
    """
    if pixel.dark_current_e_per_s is not None:
        return ()
    sign = 1 if pixel.temperature_k + _TEMPERATURE_STEPS_K[-1] <= _MAX_TEMPERATURE_K else -1
    return tuple(pixel.temperature_k + sign * step_k for step_k in _TEMPERATURE_STEPS_K)


def make_experiment(
    pixel: Pixel,
    exposure: Exposure | None = None,
    *,
    wavelength_nm: float | None = None,
    seed: int = 0,
    shape: tuple[int, int] = SHAPE,
    exposures: int = EXPOSURES,
    stack_frames: int = STACK,
    general: bool = False,
) -> Experiment:
    """One simulated device of a pixel, sampled from the seed, and its exposures.

    Parameters
    ----------
    exposure : integration_s of the light series, by default 30 ms, less if the dark current is
        high; gain_db of all frames
    wavelength_nm : of the light; by default the peak of the response
    shape : (rows, columns) pixels
    exposures : light levels, equally spaced from dark to 1.1 times what fills the well
    general : whether the characteristic curve of EMVA 1288 General is measured, too

    Raises PixsimError for a wavelength without response, for too few bits for the black level, for
    too few pixels, and for a pixel of several readings or companded codes without `general`.
    """
    if min(shape) < MIN_SIDE:
        raise invalid(
            "shape", f"{shape[0]} × {shape[1]} pixels", f"at least {MIN_SIDE} × {MIN_SIDE}"
        )

    derived = derive(pixel, load_technology(pixel.technology))
    for note in pixel_notes(derived):
        warn(note)
    exposure = exposure or Exposure()
    physics = _most_frequent_channel(derived)
    if exposure.gain_db == "auto":
        raise invalid("exposure.gain_db", "'auto'", "one gain in dB for all frames of the test")
    stated = Readout.of(physics).amplified(exposure.gain_db)
    readings = stated.readings
    if readings and not general:
        names = ", ".join(reading.name for reading in readings)
        hint = f"Use {setting('general')} for the characteristic curve of EMVA 1288 General."
        got = f"the readings {names}" if len(readings) > 1 else "companded codes"
        raise invalid("pixel", got, "one reading in linear codes", hint)
    time_s = _usual_integration_s(with_merge(stated).readings[0].readout, exposure)
    whole = with_all(stated, lambda reading: with_black_level(reading, time_s))
    readout = with_merge(whole).readings[0].readout
    nm = peak_wavelength_nm(physics) if wavelength_nm is None else wavelength_nm
    efficiency = _checked_efficiency(physics, nm)
    brightest = _BEYOND_SATURATION * _filling_light_e(readout, time_s) / efficiency
    photons = brightest * np.arange(1, exposures + 1) / exposures
    device = sample_sensor(whole, shape, stream("datasheet", seed, "sensor"))
    return Experiment(
        sensor=replace(device, readout=readout, further=()),
        whole=device,
        wavelength_nm=nm,
        integration_s=time_s,
        photons=photons,
        dim_photons=np.geomspace(
            min(1.0 / efficiency, photons[0] / 2), photons[0], _DIM_EXPOSURES, endpoint=False
        ),
        dark_times_s=dark_times_s(readout, time_s),
        temperatures_k=() if readings else temperatures_k(pixel),
        stated_black_dn=pixel.black_level_dn,
        stack_frames=stack_frames,
        seed=seed,
        general_photons=_general_photons(whole, time_s, efficiency) if general else None,
    )
