"""How a pixel is read: gain, subexposures, ADC, black level and binning, with the range, the noise
and the saturation that follow.

`PixelPhysics` is what light and time make of a pixel; a `Readout` is one reading of its charge.
Closed forms of noise, range and codes, and the kernels that draw frames, take a `Readout`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count, NotNegative, Positive
from pixsim.base.door import checked_methods
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.sensor.companding import decode, encode, packaged_knees, steps_dn
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.mismatch import ELECTRON_C, DarkSpread
from pixsim.sensor.noise import constant_e, variance_e2
from pixsim.sensor.pixel import (
    BLACK_SIGMAS,
    PixelPhysics,
    follows_noise,
    read_noises_e,
    reset_noise_e,
    usual_black_level_dn,
)
from pixsim.sensor.quantities import MAX_CODE_BITS, FrameBits, GainDb, Knees
from pixsim.sensor.readout_options import CollectorOptions, ReadingOptions, ReadoutOptions

# The public names; everything else is internal.
__all__ = ["Adc", "Reading", "Readout", "dark_spread_e", "least_black_level_dn"]

_ONE_READING = ReadoutOptions()
_FF_UV = 1e21  # capacitance in fF of a charge in C and its voltage in µV


@dataclass(frozen=True)
class Adc:
    """An analogue-to-digital converter, and how electrons become codes at 0 dB: by a gain, or by
    the charge that the codes span.

    bits : of a code
    black_level_dn : code without a signal
    gain_e_per_dn : electrons per code; without it the codes above the black level span `span_e`
    span_e : signal at the top code, where no gain is stated
    knees : (linear DN, code) of companding, or None; all codes here are linear
    """

    bits: FrameBits
    black_level_dn: NotNegative
    gain_e_per_dn: Positive | None = None
    span_e: Positive | None = None
    knees: Knees | None = None

    def codes_of(self, level_dn: Array) -> NDArray[np.int32]:
        """Return the companded codes of linear levels, (...)."""
        assert self.knees is not None
        return encode(np.clip(level_dn, 0.0, self.top_code_dn), self.knees)

    def levels_of(self, codes: NDArray[Any]) -> NDArray[Any]:
        """Return the linear levels of codes, (...)."""
        return codes if self.knees is None else decode(codes, self.knees)

    def rounding_e2(self, charge_e: Array, dn_per_e: float) -> Array | float:
        """Return the variance by rounding of charges, (...), in electrons, at a gain."""
        if self.knees is None:
            return 1 / 12 / dn_per_e**2
        level_dn = self.black_level_dn + dn_per_e * charge_e
        return steps_dn(level_dn, self.knees) ** 2 / 12 / dn_per_e**2

    @property
    def last_code_dn(self) -> int:
        """Highest code of a file, companded or not."""
        if self.knees is None:
            return self.top_code_dn
        return int(self.codes_of(np.asarray(self.top_code_dn, float)))

    @property
    def top_code_dn(self) -> int:
        """Highest code."""
        return int(2**self.bits - 1)

    @property
    def codes_dn(self) -> float:
        """Codes above the black level."""
        return self.top_code_dn - self.black_level_dn

    @property
    def full_scale_e(self) -> float:
        """Signal at the top code at 0 dB."""
        if self.gain_e_per_dn is not None:
            return self.codes_dn * self.gain_e_per_dn
        assert self.span_e is not None  # as checked
        return self.span_e

    @property
    def dn_per_e(self) -> float:
        """Codes per electron at 0 dB."""
        if self.gain_e_per_dn is not None:
            return 1 / self.gain_e_per_dn
        return self.codes_dn / self.full_scale_e


def _adc_of(physics: PixelPhysics, pixels: int) -> Adc:
    """Return the ADC that reads the sum of some pixels; its range is the sum of their ranges.

    Its black level is that of the settings, or 0.
    """
    pixel = physics.pixel
    black_dn = pixel.black_level_dn or 0.0
    knees = pixel.companding
    if isinstance(knees, str):
        knees = packaged_knees(knees)
    gain_e_per_dn = pixel.stated_gain_e_per_dn
    if gain_e_per_dn is not None:
        summed_e_per_dn = pixels * (physics.growth * gain_e_per_dn)
        return Adc(pixel.bits, black_dn, gain_e_per_dn=summed_e_per_dn, knees=knees)

    span_e = physics.full_well_e
    if pixel.adc_full_scale_e is not None:
        span_e = physics.growth * pixel.adc_full_scale_e
    return Adc(pixel.bits, black_dn, span_e=pixels * span_e, knees=knees)


@checked_methods
@dataclass(frozen=True)
class Readout:
    """How a pixel is read. Currents, charges and noise belong to one pixel, or to the sum of binned
    pixels.

    Charges and noise are stated for one exposure; `saturation_e`, `noise_floor_e`, `offset_e` and
    codes for a frame, which may be the sum of several subexposures. Noise is a standard deviation.

    physics : of a single pixel
    adc : of an exposure, at 0 dB
    read_noise_e : temporal, before the amplifier, without the reset noise
    read_noise_after_gain_e : temporal, after the amplifier, in electrons at 0 dB
    gain_db : amplification before the ADC
    exposures : number of subexposures that are summed to a frame
    bin_side : pixels along a side of those whose charge is read as one
    silent : names of noise sources that are switched off
    readings : of a pixel that is read several times, from the most sensitive one on; then all
        numbers of this record but `saturation_e` belong to the first one
    merge : how the readings become one estimate of electrons

    Raises PixsimError if the codes of a frame have more than 31 bits.
    """

    physics: PixelPhysics
    adc: Adc
    read_noise_e: NotNegative
    read_noise_after_gain_e: NotNegative = 0.0
    gain_db: GainDb = 0.0
    exposures: Count = 1
    bin_side: Count = 1
    silent: tuple[str, ...] = ()
    readings: tuple[Reading, ...] = ()
    merge: ReadoutOptions = _ONE_READING

    def __post_init__(self) -> None:
        """Raise PixsimError if the codes of a frame have more than 31 bits."""
        if self.adc.knees is not None and self.exposures > 1:
            raise invalid(
                "exposure.frames",
                f"{self.exposures} with pixel.companding",
                "1, since sums of companded codes have no meaning",
            )
        if self.code_bits > MAX_CODE_BITS:
            got = (
                f"{self.exposures} exposures of {self.adc.bits} bits, whose sum has"
                f" {self.code_bits}"
            )
            raise invalid(
                "exposure.frames",
                got,
                f"sums of at most {MAX_CODE_BITS} bits",
                "Use fewer exposures or bits.",
            )

    @classmethod
    def of(
        cls,
        physics: PixelPhysics,
        exposure: Exposure | None = None,
        *,
        bin_side: Count | None = None,
    ) -> Readout:
        """Return how the settings of a pixel and of an exposure have it read.

        exposure : None means 0 dB and one exposure
        bin_side : None takes it from the pixel; 1 is for the single pixels of a sensor that bins

        Raises PixsimError if the codes of a frame have more than 31 bits.

        >>> from pixsim.sensor.pixel import derive
        >>> from pixsim.sensor.pixel_options import Pixel
        >>> noise = {"read_noise_e": 1.5, "read_noise_after_gain_e": 4}
        >>> pixel = derive(Pixel(technology="4t-bsi", pitch_um=1.2, **noise))
        >>> readout = Readout.of(pixel)
        >>> amplified = Readout.of(pixel, Exposure(gain_db=20 * math.log10(8)))
        >>> round(readout.adc_range_e / amplified.adc_range_e, 6)
        8.0
        >>> round(amplified.noise_floor_e, 3)  # √(1.5² + (4/8)²)
        1.581
        """
        bin_side = physics.pixel.bin_side if bin_side is None else bin_side
        before_e, after_e = read_noises_e(physics.pixel, physics.technology)
        readout = cls(physics, _adc_of(physics, bin_side**2), before_e, after_e, bin_side=bin_side)
        readout = readout._with_black_level()
        if physics.pixel.has_readings:
            readout = _with_readings(readout, physics.pixel.readout or ReadoutOptions())
        return readout if exposure is None else readout.at(exposure)

    def at(self, exposure: Exposure) -> Readout:
        """Return the reading in an exposure: at its gain, 0 dB of one that is not metered yet, in
        its subexposures. Raises PixsimError as `Readout` does.
        """
        return self.amplified(exposure.least_gain_db).burst(exposure.frames)

    def amplified(self, gain_db: GainDb) -> Readout:
        """Return the reading at another gain. The black level of a data sheet that states none
        follows the noise in codes.
        """
        if gain_db == self.gain_db:
            return self
        return with_all(self, lambda other: replace(other, gain_db=gain_db)._with_black_level())

    def _with_black_level(self) -> Readout:
        """Return the reading with the black level of a data sheet that states none: 6 σ of the dark
        noise without dark charge, at this gain, at most half of the codes.

        A source of noise that is switched off leaves the level as it is.
        """
        if not follows_noise(self.physics.pixel):
            return self
        margin_dn = _dark_margin_dn(self.with_silent(()), 0.0)
        level_dn = usual_black_level_dn(margin_dn, self.adc.top_code_dn)
        return replace(self, adc=replace(self.adc, black_level_dn=float(level_dn)))

    @property
    def following_black_e(self) -> float:
        """Charge below the black level, of an exposure at this gain, if the level follows the gain
        and takes its codes from light; else 0.
        """
        if not follows_noise(self.physics.pixel) or self.adc.gain_e_per_dn is None:
            return 0.0
        return self.adc.black_level_dn / self.dn_per_e

    def burst(self, exposures: Count) -> Readout:
        """Return the reading of frames that are the sum of subexposures. Raises PixsimError as
        `Readout` does.

        exposures : number of subexposures

        >>> from pixsim.sensor.pixel import derive
        >>> from pixsim.sensor.pixel_options import Pixel
        >>> readout = Readout.of(derive(Pixel(technology="4t-bsi", pitch_um=1.2, read_noise_e=1.5)))
        >>> readout.burst(4).noise_floor_e, readout.burst(4).saturation_e / readout.saturation_e
        (3.0, 4.0)
        """
        return self if exposures == self.exposures else replace(self, exposures=exposures)

    def with_physics(self, **numbers: Any) -> Readout:
        """Return the same reading of a pixel with other numbers, fields of `PixelPhysics`; the ADC
        stays.
        """
        return with_all(
            self, lambda other: replace(other, physics=replace(other.physics, **numbers))
        )

    def with_silent(self, names: tuple[str, ...]) -> Readout:
        """Return the same reading of a pixel with some noise sources switched off, and no others.

        names : of these sources
        """
        return with_all(self, lambda other: replace(other, silent=names))

    @property
    def _pixels(self) -> int:
        """Number of pixels whose charge is read as one."""
        return self.bin_side**2

    @property
    def full_well_e(self) -> float:
        """Charge that is held: wells add up. A full pixel of a sum that is not full is not seen."""
        return self._pixels * self.physics.full_well_e

    @property
    def dark_current_e_per_s(self) -> float:
        """Mean dark current; dark currents add up."""
        return self._pixels * self.physics.dark_current_e_per_s

    @property
    def prnu(self) -> float:
        """Spread of the gain, relative to its mean: of the mean of as many pixels."""
        return self.physics.prnu / self.bin_side

    @cached_property
    def dark_spread(self) -> DarkSpread:
        """Dark currents relative to their mean: of ordinary pixels, and of pixels that are hot or,
        after binning, partly hot.
        """
        physics = self.physics
        others = self._pixels - 1
        fraction = physics.hot_pixel_fraction
        median = physics.hot_pixel_median
        if fraction and others:
            fraction = 1 - (1 - fraction) ** self._pixels
            median = (median + others) / self._pixels
        return DarkSpread(physics.dsnu / self.bin_side, fraction, median, physics.hot_pixel_spread)

    @property
    def black_level_dn(self) -> float:
        """DN of a frame without light and dark charge."""
        return self.exposures * self.adc.black_level_dn

    @property
    def top_code_dn(self) -> int:
        """Highest DN of a frame."""
        return self.exposures * self.adc.top_code_dn

    @property
    def code_bits(self) -> int:
        """Bits that hold the DN of a frame, which may be a sum of codes."""
        return self.top_code_dn.bit_length()

    @property
    def rounding_variance_dn2(self) -> float:
        """Variance of a frame by the rounding of each exposure, LSB²/12; of companded codes, in the
        dark.
        """
        if self.adc.knees is not None:
            return float(np.asarray(self.adc.rounding_e2(np.zeros(()), 1.0)))
        return self.exposures / 12

    @property
    def amplification(self) -> float:
        """10^(gain_db/20), a ratio of voltages."""
        return float(10 ** (self.gain_db / 20))

    @property
    def dn_per_e(self) -> float:
        """Gain: codes per electron at 0 dB times the amplification."""
        return self.adc.dn_per_e * self.amplification

    @property
    def adc_range_e(self) -> float:
        """Signal at the ADC's top code: the full scale over the amplification."""
        return self.adc.full_scale_e / self.amplification

    @property
    def saturation_e(self) -> float:
        """Signal that saturates a frame: the lower of the full well and of the ADC's range, in each
        exposure; of several readings, in the last one, over its response.
        """
        if self.readings:
            return self.exposures * self.readings[-1].limit_e / self.readings[-1].response
        return self.exposures * min(self.full_well_e, self.adc_range_e)

    @property
    def read_noise_at_gain_e(self) -> float:
        """Temporal read noise, √(before² + (after/amplification)²), without the reset noise."""
        return math.hypot(self.read_noise_e, self.read_noise_after_gain_e / self.amplification)

    @property
    def noise_floor_e(self) -> float:
        """Temporal dark noise without dark charge: reset, read and row noise."""
        return constant_e(self, is_temporal=True)

    @property
    def offset_e(self) -> float:
        """Spread of all offsets of pixels and columns."""
        return constant_e(self, is_temporal=False)


def dark_spread_e(readout: Readout, integration_s: NotNegative) -> float:
    """Return the standard deviation in e- of a dark signal over frames and over the pixels that are
    not hot.

    The tail of hot pixels is far above the black level: it says nothing about what a clip at 0 DN
    cuts off.
    """
    dark_e = readout.dark_current_e_per_s * integration_s * readout.dark_spread.ordinary_mean
    temporal_e2 = variance_e2(readout, dark_e, is_temporal=True)
    ordinary = readout.with_physics(hot_pixel_fraction=0.0)
    return math.sqrt(variance_e2(ordinary, temporal_e2, dark_e=dark_e, is_temporal=False))


def least_black_level_dn(readout: Readout, integration_s: NotNegative) -> int:
    """Return the lowest black level, a whole code, that keeps `BLACK_SIGMAS` of the dark signal and
    one LSB above 0 DN.

    Without a stated gain a range F spans the codes M - b above the black level b, so that b =
    6σ(M - b)/F, solved for b. For a burst it is the black level of each subexposure.
    """
    return math.ceil(_dark_margin_dn(readout, integration_s)) + 1


def _dark_margin_dn(readout: Readout, integration_s: float) -> float:
    """Return `BLACK_SIGMAS` of the dark signal of an exposure, in codes."""
    exposure_readout = readout.burst(1)
    margin_e = BLACK_SIGMAS * dark_spread_e(exposure_readout, integration_s / readout.exposures)
    if exposure_readout.adc.gain_e_per_dn is not None:
        return margin_e * exposure_readout.amplification / exposure_readout.adc.gain_e_per_dn
    span_e = exposure_readout.adc_range_e + margin_e
    return margin_e * exposure_readout.adc.top_code_dn / span_e


@dataclass(frozen=True)
class Reading:
    """One of several readings of a pixel, in one exposure.

    stated : its settings
    readout : of its collector up to its limit, which is the full well there, with the dark current
        and the noise of this reading
    collector : number of the collector; readings of one collector share its electrons
    photodiode : number of the photodiode; collectors of one share its fixed pattern
    response : light that the collector gets in a frame, over the light of the first one: area, time
        and filter
    capacitor_dark_e_per_s : dark current of the capacitor, if it reads it
    """

    stated: ReadingOptions
    readout: Readout
    collector: int = 0
    photodiode: int = 0
    response: float = 1.0
    capacitor_dark_e_per_s: float = 0.0

    @property
    def name(self) -> str:
        """As in `Frame.readings`."""
        return self.stated.name

    @property
    def limit_e(self) -> float:
        """Largest charge that it can read."""
        return self.readout.saturation_e

    @property
    def noise_e(self) -> float:
        """Temporal noise behind the limit: reset, read and row noise, without rounding."""
        return self.readout.noise_floor_e

    @property
    def gain_spreads(self) -> tuple[float, float]:
        """Standard deviation of its gain over pixels and over columns, which count as PRNU."""
        if "PRNU" in self.readout.silent:
            return 0.0, 0.0
        return self.stated.gain_spread, self.stated.column_gain_spread

    @property
    def spread_e(self) -> float:
        """Standard deviation of a full reading over frames and pixels, without rounding."""
        gain_e = self.limit_e * math.hypot(*self.gain_spreads)
        return math.hypot(self.noise_e, self.readout.offset_e, gain_e)

    def rounding_e2(self, charge_e: Array) -> Array | float:
        """Return the variance by rounding of charges, (...), in electrons."""
        return self.readout.adc.rounding_e2(charge_e, self.readout.dn_per_e)

    def valid_below_e(self, sigmas: float) -> float:
        """Return the charge below which the reading is valid: so many standard deviations of the
        noise behind the limit below it, offsets, gain and rounding included.
        """
        rounding_e = math.sqrt(float(self.rounding_e2(np.asarray(self.limit_e))))
        return self.limit_e - sigmas * math.hypot(self.spread_e, rounding_e)

    def dark_e(self, integration_s: float) -> float:
        """Return the mean dark charge that it reads, of the collector and of the capacitor."""
        return self.readout.dark_current_e_per_s * integration_s + self.capacitor_e(integration_s)

    def capacitor_e(self, integration_s: float) -> float:
        """Return the mean dark charge of the capacitor."""
        return self.capacitor_dark_e_per_s * integration_s


def with_all(readout: Readout, change: Callable[[Readout], Readout]) -> Readout:
    """Return a record and its readings, each changed by a function."""
    readings = tuple(
        replace(reading, readout=change(reading.readout)) for reading in readout.readings
    )
    return replace(change(readout), readings=readings)


def with_merge(readout: Readout) -> Readout:
    """Return a readout that has its readings; of a pixel that is read once, that reading."""
    if readout.readings:
        return readout
    once = Reading(ReadingOptions(name="pixel", collector="pixel"), readout.burst(1))
    return replace(readout, readings=(once,))


def _with_readings(readout: Readout, options: ReadoutOptions) -> Readout:
    """Return a reading of a pixel with all readings of its options, the most sensitive first.

    Charges grow with the area of the photodiode, as in a data sheet.

    readout : what the pixel states itself, at 0 dB
    """
    collectors, readings = options.model
    physics = readout.physics
    # Exposures of one photodiode differ in their start and length alone.
    exposure_fields = {"name", "start_s", "start_share", "length_share"}
    diodes = [collector.model_dump(exclude=exposure_fields) for collector in collectors]

    made: list[Reading] = []
    for number, collector in enumerate(collectors):
        collected = _collected(physics, collector)
        siblings = [reading for reading in readings if reading.collector == collector.name]
        for reading in siblings:
            limit_e = _limit_e(reading, siblings, collector, collected)
            capacitor_dark_e_per_s = physics.growth * collector.capacitor_dark_e_per_s
            made.append(
                Reading(
                    stated=reading,
                    readout=_read(readout, reading, readings[0], limit_e, collected),
                    collector=number,
                    photodiode=diodes.index(diodes[number]),
                    response=collector.response * collector.length_share,
                    capacitor_dark_e_per_s=capacitor_dark_e_per_s * reading.overflow,
                )
            )
    made.sort(key=lambda reading: reading.limit_e / reading.response)
    first = made[0]
    collected = _collected(physics, collectors[first.collector])
    whole = replace(first.readout.physics, full_well_e=collected.full_well_e)
    return replace(first.readout, physics=whole, readings=tuple(made), merge=options)


def _collected(physics: PixelPhysics, collector: CollectorOptions) -> PixelPhysics:
    """Return the pixel with the numbers of a collector, and the dark charge of its exposure."""
    charges = collector.model_dump(include={"full_well_e", "dark_current_e_per_s"})
    numbers = {name: physics.growth * e for name, e in charges.items() if e is not None}
    numbers |= collector.model_dump(include={"prnu", "dsnu"}, exclude_none=True)
    stated = replace(physics, **numbers)
    dark_e_per_s = stated.dark_current_e_per_s * collector.length_share
    return replace(stated, dark_current_e_per_s=dark_e_per_s)


def _limit_e(
    reading: ReadingOptions,
    siblings: Sequence[ReadingOptions],
    collector: CollectorOptions,
    collected: PixelPhysics,
) -> float:
    """Return the largest charge that a reading can read of its collector.

    siblings : all readings of the collector, whose lowest conversion gain has the voltage of the
        full collector
    """
    growth = collected.growth
    full_well_e = collected.full_well_e
    capacity_e = growth * collector.capacity_e
    held_e = full_well_e + capacity_e * reading.overflow
    if reading.limit_e is not None:
        return min(held_e, growth * reading.limit_e)

    # NaN without a conversion gain.
    largest_e = full_well_e + capacity_e * any(other.overflow for other in siblings)
    gains = np.array([other.conversion_gain_uv_per_e for other in siblings], float)
    limit_e = largest_e * gains.min() / gains[siblings.index(reading)]
    return float(np.fmin(held_e, limit_e))


def _read(
    readout: Readout,
    reading: ReadingOptions,
    first: ReadingOptions,
    limit_e: float,
    collected: PixelPhysics,
) -> Readout:
    """Return how one reading reads its collector up to a limit.

    readout : what the pixel states; its gain belongs to the first reading
    """
    stated = reading.model_dump(include={"bits", "black_level_dn"}, exclude_none=True)
    adc = replace(readout.adc, **stated)
    gain_uv_per_e = reading.conversion_gain_uv_per_e
    if adc.gain_e_per_dn is None:
        adc = replace(adc, span_e=readout.bin_side**2 * limit_e)
    elif gain_uv_per_e is not None and first.conversion_gain_uv_per_e is not None:
        ratio = first.conversion_gain_uv_per_e / gain_uv_per_e
        adc = replace(adc, gain_e_per_dn=adc.gain_e_per_dn * ratio)

    reset_e = collected.reset_noise_e
    if reading.resets is not None and gain_uv_per_e is not None:
        capacitance_ff = _FF_UV * ELECTRON_C / gain_uv_per_e
        reset_e = reset_noise_e(capacitance_ff, collected.pixel.temperature_k, reading.resets)
    noise: dict[str, Any] = {}
    if reading.read_noise_e is not None:
        noise = {"read_noise_e": reading.read_noise_e, "read_noise_after_gain_e": 0.0}
    pixel = collected.pixel.model_copy(update=stated)
    physics = replace(collected, pixel=pixel, full_well_e=limit_e, reset_noise_e=reset_e)
    return replace(readout, physics=physics, adc=adc, **noise)._with_black_level()
