"""Mean electrons to digital numbers: exposure, fixed pattern, noise, well and ADC."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import (
    Array,
    NotNegativeArray,
    NotNegativePicture,
    NumberArray,
    in_threads,
    strips,
)
from pixsim.base.bounds import Count, NotNegative, Positive, Whole
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.flicker import row_gains
from pixsim.sensor.integration import (
    array_signal,
    array_size_um,
    check_pixel_count,
    lights_of,
    mean_signal_rate,
    moved_signals,
    pixels_on,
)
from pixsim.sensor.merge import covariances_e2, merged, merged_variance_e2, weighted_e2
from pixsim.sensor.motion import ImageMotion, motion_in_frame, velocity_um_per_s
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.noise import constant_e, variance_e2
from pixsim.sensor.photodiode import (
    full_pixels,
    responds_linearly,
    saturation_level_e,
    stored_signal_e,
)
from pixsim.sensor.pixel import CENTRED, Registration, derive
from pixsim.sensor.pixel_notes import pixel_notes
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.quantities import (
    MAX_CODE_BITS,
    Aspect,
    FrameBits,
    GainDb,
    Pitch,
    SaturatedFraction,
)
from pixsim.sensor.reading import Reading, Readout, with_merge
from pixsim.sensor.technology import load_technology

# Far above this mean the variance of NumPy's Poisson is wrong (+3.5 % at 1e15); a rounded normal
# lacks only the skewness 1/√mean, 3e-5 and less.
_POISSON_LIMIT_E = 1e9
# A level that is farther from both ends of the codes is clipped in 1e-12 of normal signals; few
# Poisson counts need some electrons more.
_CLIP_SIGMAS = 7.0
POISSON_MARGIN_E = 10.0
_MIN_DITHER_DN = 0.6  # noise from which rounding is a noise, too
BLOCK_PIXELS = 1 << 23  # of larger frames, drawn with a generator of their own


# --- exposure


def with_shared_time(exposure: Exposure, total_s: float) -> Exposure:
    """Return the exposure with another time, which its subexposures share."""
    return exposure.model_copy(update={"integration_s": total_s, "frame_time": "shared"})


def integration_time_s(
    exposure: Exposure, readout: Readout, brightest_e_per_s: NotNegative
) -> float:
    """Return the manual integration time, or the time that exposes the brightest pixel to the
    target, up to the maximum.

    All subexposures of a frame share it. The target is a share of `Readout.saturation_e` in the
    exposure, for the mean charge with dark charge.

    brightest_e_per_s : mean photo-electrons per second of the brightest pixel
    """
    if exposure.integration_s is not None:
        return exposure.times * exposure.integration_s
    brightest = brightest_e_per_s + readout.dark_current_e_per_s
    target_e = exposure.well_target * readout.at(exposure).saturation_e
    longest_s = exposure.times * exposure.max_integration_s
    return longest_s if brightest * longest_s <= target_e else target_e / brightest


def with_metered_gain(
    exposure: Exposure, readout: Readout, brightest_e_per_s: NotNegative
) -> Exposure:
    """Return the exposure with the gain that brings the brightest pixel to the target, where its
    time alone does not; an exposure of a stated gain as it is.

    The gain is that by which the range of the ADC at 0 dB, times `well_target`, exceeds the charge.
    A black level that follows the gain takes its part of the codes.

    brightest_e_per_s : mean photo-electrons per second of the brightest pixel
    """
    if exposure.gain_db != "auto":
        return exposure
    time_s = integration_time_s(exposure, readout, brightest_e_per_s)
    charge_e = (brightest_e_per_s + readout.dark_current_e_per_s) * time_s
    at_0_db = readout.at(exposure)
    target_e = exposure.well_target * at_0_db.exposures * at_0_db.adc_range_e
    black_e = exposure.well_target * at_0_db.exposures * at_0_db.following_black_e
    target_e += black_e
    charge_e += black_e
    gain_db = exposure.max_gain_db
    if charge_e * 10 ** (gain_db / 20) > target_e:
        gain_db = max(0.0, 20 * math.log10(target_e / charge_e))
    return exposure.model_copy(update={"gain_db": gain_db})


def metered_motion(
    still_e_per_s: Array, readout: Readout, exposure: Exposure, um_per_s: tuple[float, float]
) -> tuple[ImageMotion, Exposure]:
    """Return how light moves in a frame that is metered on the picture that stands still, and the
    exposure with its time.

    still_e_per_s : signal of that picture, (rows, columns)
    um_per_s : velocity [x, y] of the image on the sensor

    Raises PixsimError for exposures of several times, of which each would see another picture.
    """
    _check_exposed_at_once(readout, "moves")
    exposure = with_metered_gain(exposure, readout, float(still_e_per_s.max()))
    time_s = integration_time_s(exposure, readout, float(still_e_per_s.max()))
    return motion_in_frame(um_per_s, time_s, exposure), with_shared_time(exposure, time_s)


def _check_exposed_at_once(readout: Readout, change: str) -> None:
    """Raise PixsimError if collectors have exposures of their own, in light that moves, or that
    flickers.
    """
    if any(
        collector.start_share or collector.start_s or collector.length_share != 1
        for collector in readout.merge.model[0]
    ):
        hint = "Exposures of kind = 'split' are at one time."
        got = f"exposures of several times in light that {change}"
        raise invalid("pixel.readout", got, "light that does not change", hint)


# --- fixed pattern


@dataclass(frozen=True)
class Sensor:
    """One sensor with its fixed pattern, the same in every frame. A map is None if its standard
    deviation is zero.

    readout : how its pixels are read
    shape : (rows, columns)
    gain : (rows, columns) relative to the mean pixel, mean 1
    dark_gain : (rows, columns) dark current relative to the mean pixel, positive, mean 1
    offset_e : (rows, columns)
    column_offset_e : (1, columns)
    gain_errors : (rows, columns), relative, of each reading whose gain scatters, by its name
    further : the sensors of further photodiodes of each pixel, if it has several; without their
        own
    """

    readout: Readout
    shape: tuple[Count, Count]
    gain: Array | None = field(repr=False)
    dark_gain: Array | None = field(repr=False)
    offset_e: Array | None = field(repr=False)
    column_offset_e: Array | None = field(repr=False)
    gain_errors: dict[str, Array] = field(default_factory=dict, repr=False)
    further: tuple[Sensor, ...] = field(default=(), repr=False)

    @property
    def diodes(self) -> tuple[Sensor, ...]:
        """The sensors of all photodiodes of each pixel, by their numbers."""
        return (self, *self.further)


def sample_sensor(readout: Readout, shape: tuple[Count, Count], rng: np.random.Generator) -> Sensor:
    """Draw the fixed pattern of a sensor of a given `shape` (rows, columns) from `rng`.

    PRNU is normal, clipped at zero. DSNU is gamma-distributed, since a normal distribution would
    have negative currents; hot pixels (`pixsim.sensor.mismatch`) have a stream of their own, so
    that all other maps are the same as without them.
    """
    exposure_readout = readout.burst(1)
    dark_spread = readout.dark_spread
    dark_differs = exposure_readout.dark_current_e_per_s > 0 and not dark_spread.is_uniform
    pixel_spread_e = constant_e(exposure_readout, is_temporal=False, along="pixel")
    column_spread_e = constant_e(exposure_readout, is_temporal=False, along="column")
    gain = np.empty(shape) if exposure_readout.prnu else None
    dark_gain = np.empty(shape) if dark_differs else None
    offset_e = np.empty(shape) if pixel_spread_e else None

    def draw(block: slice, rng: np.random.Generator) -> None:
        if gain is not None:
            for part in _rows_of(gain[block]):
                _draw_gaussian(exposure_readout.prnu, part, rng)
                part += 1.0
                np.maximum(part, 0.0, out=part)
        if dark_gain is not None:
            dark_gain[block] = dark_spread.sample(dark_gain[block].shape, rng)
        if offset_e is not None:
            for part in _rows_of(offset_e[block]):
                _draw_gaussian(pixel_spread_e, part, rng)

    _by_block(draw, shape, rng)
    column_offset_e = np.empty((1, shape[1])) if column_spread_e else None
    if column_offset_e is not None:
        _draw_gaussian(column_spread_e, column_offset_e, rng)
    diodes = {reading.photodiode: reading.readout for reading in reversed(readout.readings)}
    further = tuple(sample_sensor(diodes[number], shape, rng) for number in sorted(diodes)[1:])
    gain_errors = {}
    for reading in readout.readings:
        pixel_spread, column_spread = reading.gain_spreads
        if pixel_spread or column_spread:
            columns = column_spread * rng.standard_normal(shape[1])
            gain_errors[reading.name] = columns + pixel_spread * rng.standard_normal(shape)
    return Sensor(readout, shape, gain, dark_gain, offset_e, column_offset_e, gain_errors, further)


def _rows_of(picture: Array) -> Iterator[Array]:
    """Yield views of a few rows of a picture (rows, columns) at a time, which stay in a core's
    cache.
    """
    return (picture[rows] for rows in strips(*picture.shape))


def _draw_gaussian(spread: float, out: Array, rng: np.random.Generator) -> None:
    """Draw normal values of mean 0 into `out`."""
    rng.standard_normal(out=out)
    out *= spread


def make_sensor(
    pixel: Pixel, camera: Camera, seed: Whole = 0, *, aspect: Aspect | None = None
) -> Sensor:
    """Make a sensor that fills the camera's die, with its fixed pattern drawn from the seed.

    seed : 0 or more; equal seeds give equal sensors
    aspect : ratio of the film's width to its height, or None for the shape of the camera's die

    Raises PixsimError if the pitch is too small for the technology, larger than the die, or gives
    too many pixels.

    The sensor of Chen et al. (2000):

    >>> make_sensor(Pixel(pitch_um=5.3), Camera(die_mm=2.7136)).shape
    (512, 512)
    """
    physics = derive(pixel, load_technology(pixel.technology))
    for note in pixel_notes(physics):
        warn(note)
    aspect = camera.die_mm / camera.height_mm if aspect is None else aspect
    width_um = camera.die_um[1]
    shape = pixels_on((width_um / aspect, width_um), physics.read_pitch_um, physics.registration)
    check_pixel_count(shape, pixel.pitch_um)
    return sample_sensor(
        Readout.of(physics), (shape[0] * physics.planes, shape[1]), np.random.default_rng(seed)
    )


# --- noise, in the order of the charge


@dataclass(frozen=True)
class Frame:
    """The digital numbers of one frame, with the quantities behind them; of a burst, the sums over
    its subexposures.

    dn : (rows, columns) int32, 0 … 2^bits - 1
    mean_e : (rows, columns) mean photo-electrons, before non-uniformity, dark charge and noise
    integration_s : integration time, of all subexposures together
    dn_per_e : gain, DN per electron
    black_level_dn : DN without light and dark charge
    mean_dark_e : mean dark charge of a pixel in this frame
    pitch_um : centre-to-centre distance of pixels
    bits : of the codes: of the ADC, or of the sum
    gain_db : amplification of the exposure, which `dn_per_e` includes
    saturated_fraction : fraction of pixels whose charge reached `saturation_level_e` (light and
        dark, with shot noise, before reset noise and offsets) or whose DN is the top code, in any
        subexposure
    corrected_e : (rows, columns) photo-electrons as the camera's correction estimates them, if
        there is one
    layout : which channel each value belongs to, or None for a monochrome sensor. A stacked sensor
        has its planes one below the other
    registration : of its pixels on the die, as in `PixelPhysics`
    exposures : number of subexposures that are summed
    white_level_dn : highest code, or None for all bits set
    saturated : (rows, columns) which pixels were full in any exposure: charge at the full well (a
        soft one: at 99 % of it), or the top code. `saturated_fraction` is its mean, but for a soft
        well. None: not known
    dark_noise_e : standard deviation of all temporal noise without light and dark charge, of all
        subexposures together
    """

    dn: NDArray[np.int32] = field(repr=False)
    mean_e: NotNegativeArray = field(repr=False)
    integration_s: NotNegative
    dn_per_e: Positive
    black_level_dn: NotNegative
    mean_dark_e: NotNegative
    pitch_um: Pitch
    bits: FrameBits
    saturated_fraction: SaturatedFraction
    corrected_e: NDArray[np.float32] | None = field(default=None, repr=False)
    gain_db: GainDb = 0.0
    layout: Layout | None = None
    registration: Registration = CENTRED
    exposures: Count = 1
    white_level_dn: float | None = None
    saturated: NDArray[np.bool_] | None = field(default=None, repr=False)
    dark_noise_e: NotNegative = 0.0

    @property
    def pixels(self) -> tuple[int, int]:
        """Rows and columns of pixels, or of their sums with binning."""
        return (self.shape[0] // (1 if self.layout is None else self.layout.planes), self.shape[1])

    @property
    def estimate_e(self) -> Array:
        """Estimated photo-electrons, (rows, columns): corrected as the camera does, or less black
        level and expected dark charge.

        The response is taken as linear. With `conversion = "junction"` the error is up to 1.8 % of
        the swing of a 0.35 µm pixel, at every level; in soft saturation the estimate is too low.
        """
        if self.corrected_e is not None:
            return self.corrected_e.astype(float)
        electrons = np.empty(self.dn.shape)
        for rows in strips(*self.dn.shape):
            part = electrons[rows]
            np.subtract(self.dn[rows], self.black_level_dn, out=part)
            part /= self.dn_per_e
            part -= self.mean_dark_e
        return electrons

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of values."""
        return self.mean_e.shape[0], self.mean_e.shape[1]

    @property
    def electrons(self) -> Array:
        """The estimate of photo-electrons, (rows, columns), `estimate_e`."""
        return self.estimate_e

    @property
    def estimate_variance_e2(self) -> Array:
        """Estimated variance of `estimate_e` over frames of the same sensor, (rows, columns).

        It is the variance of Poisson counts at the estimate, if it is above 0, and at the mean dark
        charge, with reset, read and row noise and rounding; valid where nothing clips. Frames of a
        correction add noise of their own, which is not in it.
        """
        variance_e2 = np.maximum(self.estimate_e, 0.0)
        variance_e2 += (
            self.mean_dark_e + self.dark_noise_e**2 + self.exposures / 12 / self.dn_per_e**2
        )
        return variance_e2


@dataclass(frozen=True, kw_only=True)
class MergedFrame(Frame):
    """A frame of pixels that are read several times. `corrected_e` has the merged photo-electrons;
    gain, black level and bits belong to the most sensitive reading.

    readings : codes of each reading, (rows, columns) int32, by its name; of a burst, sums
    readout : how the pixels are read
    """

    dn: NDArray[np.int32] = field(init=False, repr=False, compare=False)
    readings: dict[str, NDArray[np.int32]] = field(repr=False)
    readout: Readout = field(repr=False)

    def __getattr__(self, name: str) -> Any:
        """Raise PixsimError for `dn`: the codes belong to several readings."""
        if name != "dn":
            raise AttributeError(name)
        names = ", ".join(f"readings['{reading}']" for reading in self.readings)
        raise invalid(
            "frame.dn",
            "a frame of several readings, which has no codes of its own",
            names,
            "Its merged electrons are frame.estimate_e.",
        )

    @property
    def estimate_variance_e2(self) -> Array:
        """Estimated variance of `estimate_e` over frames of the same sensor, (rows, columns).

        It is the variance of the weighted readings at the estimate, if it is above 0: of shot
        noise, dark charge, read noise and rounding. It takes the weights as stated, not as chosen
        by noise.
        """
        count = self.exposures
        level_e = np.maximum(self.estimate_e, 0.0) / count
        covariance = covariances_e2(self.readout, level_e.ravel(), self.integration_s / count)
        weights = np.stack([weight.ravel() for weight in self.reading_weights.values()])
        return count * weighted_e2(weights, covariance).reshape(level_e.shape)

    @cached_property
    def reading_weights(self) -> dict[str, Array]:
        """Share of each reading in the estimate, (rows, columns), by its name; of a burst, at the
        mean of its codes.
        """
        codes = [code / self.exposures for code in self.readings.values()]
        one_for_each = np.eye(len(codes))[..., None]
        time_s = self.integration_s / self.exposures
        weights = merged(self.readout, codes, time_s, one_for_each)
        return dict(zip(self.readings, weights, strict=True))


def shot_noise(mean_e: NotNegativeArray, rng: np.random.Generator) -> Array:
    """Draw Poisson counts (...) of mean `mean_e` from `rng`, in electrons; above 1e9 they are
    rounded normal values.

    The variance of NumPy's Poisson is 3.5 % too large at 1e15.
    """
    return np.asarray(_shot_noise(mean_e, rng), float)


def _shot_noise(mean_e: Array, rng: np.random.Generator) -> NDArray[Any]:
    """Return `shot_noise` as whole numbers or float64."""
    if mean_e.max(initial=0.0) < _POISSON_LIMIT_E:
        return rng.poisson(mean_e)
    counts = np.asarray(rng.poisson(np.minimum(mean_e, _POISSON_LIMIT_E)), float)
    normal = np.rint(mean_e + np.sqrt(mean_e) * rng.standard_normal(mean_e.shape))
    return np.where(mean_e < _POISSON_LIMIT_E, counts, normal)


def quantise(level_dn: NumberArray, bits: FrameBits) -> NDArray[np.int32]:
    """Round half to even and clip to 0 … 2^bits - 1, (...). This adds a variance of 1/12 DN²
    (within 0.3 %) if σ exceeds 0.6 DN.

    Raises PixsimError for more than 31 bits.

    >>> quantise(np.array([-3.0, 0.5, 1.5, 300.0]), bits=8).tolist()
    [0, 0, 2, 255]
    """
    if bits > MAX_CODE_BITS:
        raise invalid(
            "bits", bits, f"1 to {MAX_CODE_BITS}", "Codes are stored in 32 bits with a sign."
        )
    codes = np.empty(level_dn.shape, np.int32)
    _quantise(np.array(level_dn), bits, codes)
    return codes


def _quantise(level_dn: Array, bits: int, out: NDArray[np.int32]) -> None:
    """Write the codes of `quantise` to `out`, and as float64 to `level_dn`."""
    np.clip(np.rint(level_dn, out=level_dn), 0, 2**bits - 1, out=level_dn)
    np.copyto(out, level_dn, casting="unsafe")  # whole numbers


def read_out(
    mean_e: NotNegativeArray, integration_s: NotNegative, sensor: Sensor, rng: np.random.Generator
) -> NDArray[np.int32]:
    """Return one frame, (rows, columns) int32 DN, from the mean photo-electrons of each pixel;
    temporal noise is from `rng`.

    The gain is in the sensor's `readout`, which `capture_from_rates` takes to an exposure
    (`Readout.at`).

    PRNU and dark charge → Poisson → well and conversion (`pixsim.sensor.photodiode`) → reset and
    read noise (one normal) → row noise → fixed offsets → gain → black level → ADC. Closed forms are
    `frame_mean_dn` and `frame_variance_dn2`. Of a burst (`Readout.burst`) mean and time belong to
    all its subexposures together, and the frame is the sum of their codes.

    Raises PixsimError if `mean_e` has not the shape of the sensor, or if its pixels are read
    several times.
    """
    if sensor.readout.readings:
        names = ", ".join(reading.name for reading in sensor.readout.readings)
        hint = "Leave pixel.readout out, or give one of its readings as a pixel."
        raise invalid("pixel.readout", f"the readings {names}", "one reading", hint)
    return _expose(mean_e, integration_s, sensor, rng).dn[0]


def read_electrons(
    mean_e: Array, integration_s: float, sensor: Sensor, rng: np.random.Generator
) -> Array:
    """Return the merged photo-electrons of one frame of a sensor of several readings, (rows,
    columns).
    """
    estimate_e = _expose(mean_e, integration_s, sensor, rng).estimate_e
    assert estimate_e is not None  # of several readings
    return estimate_e.astype(float)


class _Exposed(NamedTuple):
    """What a frame is made of; of a burst, sums over its subexposures.

    dn : codes of all readings, (K, rows, columns)
    saturated : which pixels are full in the last reading, (rows, columns), in any subexposure
    saturated_fraction : as `Frame` defines it
    estimate_e : merged photo-electrons of several readings, (rows, columns), or None
    """

    dn: NDArray[np.int32]
    saturated: NDArray[np.bool_]
    saturated_fraction: float
    estimate_e: NDArray[np.float32] | None = None


def _expose(
    mean_e: Array,
    integration_s: float,
    sensor: Sensor,
    rng: np.random.Generator,
    subexposures_e: Sequence[Array] = (),
) -> _Exposed:
    """Expose a frame of mean photo-electrons, (rows, columns).

    subexposures_e : mean electrons in each subexposure of a burst, if they differ; else none
    """
    _check_shape(mean_e, sensor)
    readout = sensor.readout
    count = readout.exposures
    if not readout.readings and count > 1:
        return _expose_burst(mean_e, integration_s, sensor, rng, subexposures_e)
    if not readout.readings:
        return _expose_once(mean_e, integration_s, sensor, rng)

    time_s = integration_s / count
    total_dn = np.zeros((len(readout.readings), *mean_e.shape), np.int32)
    estimate_e = np.zeros(mean_e.shape, np.float32)
    saturated = np.zeros(mean_e.shape, bool)
    # Neighbours of a row belong to the merge of maximum likelihood.
    parts = [slice(None)]
    if readout.merge.merge != "max_likelihood":
        parts = [*strips(*mean_e.shape)]
    for photo_e in subexposures_e or [mean_e if count == 1 else mean_e / count] * count:
        exposed = _expose_once(photo_e, time_s, sensor, rng)
        total_dn += exposed.dn
        saturated |= exposed.saturated
        for rows in parts:
            estimate_e[rows] += merged(readout, [*exposed.dn[:, rows]], time_s)
    return _Exposed(total_dn, saturated, float(saturated.mean()), estimate_e)


def _expose_once(
    mean_e: Array, integration_s: float, sensor: Sensor, rng: np.random.Generator
) -> _Exposed:
    """Expose all readings once.

    A few rows at a time, which keeps the work arrays small. The charge of a collector is drawn
    once; of a pixel that is read once, all shot noise of a block is drawn before its read noise.
    """
    readings = with_merge(sensor.readout).readings
    columns = sensor.shape[1]
    firsts = {reading.collector: reading for reading in reversed(readings)}
    generated_e = {collector: np.empty(mean_e.shape) for collector in firsts}
    dn = np.empty((len(readings), *mean_e.shape), np.int32)
    saturated, saturating = np.empty((2, *mean_e.shape), bool)

    def expose(block: slice, rng: np.random.Generator) -> None:
        parts = [
            slice(block.start + rows.start, block.start + rows.stop)
            for rows in strips(block.stop - block.start, columns)
        ]
        work = np.empty((2, max(rows.stop - rows.start for rows in parts), columns))
        for group in [parts] if len(readings) == 1 else [[rows] for rows in parts]:
            capacitors_e: dict[int, NDArray[Any]] = {}
            for reading, codes in zip(readings, dn, strict=True):
                collector_e = generated_e[reading.collector]
                for rows in group if reading is firsts[reading.collector] else ():
                    mean = _mean_charge_e(mean_e[rows], integration_s, reading, sensor, rows, work)
                    collector_e[rows] = _shot_noise(mean, rng)

                for rows in group:
                    charge_e = collector_e[rows]
                    if reading.capacitor_dark_e_per_s:
                        if reading.collector not in capacitors_e:
                            dark_e = np.full(charge_e.shape, reading.capacitor_e(integration_s))
                            capacitors_e[reading.collector] = _shot_noise(dark_e, rng)
                        charge_e = charge_e + capacitors_e[reading.collector]
                    gain: Array | float = 1 + reading.stated.gain_error
                    if reading.name in sensor.gain_errors:
                        gain = gain + sensor.gain_errors[reading.name][rows]
                    offsets_e = _offset_maps_e(sensor.diodes[reading.photodiode], rows)
                    saturated[rows], saturating[rows] = _read_level(
                        charge_e, integration_s, reading, offsets_e, rng, codes[rows], gain=gain
                    )

    _by_block(expose, mean_e.shape, rng)
    return _Exposed(dn, saturated, np.count_nonzero(saturating) / max(saturated.size, 1))


def _mean_charge_e(
    mean_e: Array, integration_s: float, reading: Reading, sensor: Sensor, rows: slice, work: Array
) -> Array:
    """Return the mean charge of light and dark that a reading has in some rows, with their fixed
    pattern.

    mean_e : mean photo-electrons of these rows, of the first collector
    work : two work arrays, of as many rows or more; the first holds the result
    """
    count = rows.stop - rows.start
    diode = sensor.diodes[reading.photodiode]
    mean_dark_e = reading.readout.dark_current_e_per_s * integration_s
    charge_e = work[0, :count]
    gain = 1.0 if diode.gain is None else diode.gain[rows]
    light_e = mean_e if reading.response == 1 else reading.response * mean_e
    np.multiply(light_e, gain, out=charge_e)
    if mean_dark_e and diode.dark_gain is not None:
        charge_e += np.multiply(mean_dark_e, diode.dark_gain[rows], out=work[1, :count])
    elif mean_dark_e:
        charge_e += mean_dark_e
    return charge_e


def _read_level(
    charge_e: Array,
    integration_s: float,
    reading: Reading,
    offsets_e: Sequence[Array],
    rng: np.random.Generator,
    dn: NDArray[np.int32],
    *,
    row_e: Array | None = None,
    gain: Array | float = 1.0,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Write the codes of some pixels to `dn`; return which are full, and which saturate.

    charge_e : generated charge of these pixels
    offsets_e : fixed offsets
    row_e : noise of their rows, or None to draw it
    gain : relative to the stated one
    """
    readout = reading.readout
    pixel_sigma_e = constant_e(readout, is_temporal=True, along="pixel")
    row_sigma_e = constant_e(readout, is_temporal=True, along="row")
    level = stored_signal_e(charge_e, integration_s, readout)
    # Counted before readout: reset noise and negative offsets keep half of the full pixels off the
    # top code.
    is_saturating = charge_e >= saturation_level_e(integration_s, readout)
    is_full = full_pixels(charge_e, level, readout)

    if pixel_sigma_e:
        noise = np.empty(level.shape)
        _draw_gaussian(pixel_sigma_e, noise, rng)
        level += noise
    if row_e is not None:
        level += row_e
    elif row_sigma_e:
        level += row_sigma_e * rng.standard_normal((level.shape[0], 1))
    for offset_e in offsets_e:
        level += offset_e

    level *= readout.dn_per_e * gain
    black_level_dn = readout.adc.black_level_dn + reading.stated.black_error_dn
    if black_level_dn:
        level += black_level_dn
    if readout.adc.knees is None:
        _quantise(level, readout.adc.bits, dn)
    else:
        dn[...] = readout.adc.codes_of(level)
    at_top = dn >= readout.adc.last_code_dn
    return is_full | at_top, is_saturating | at_top


def _check_shape(mean_e: Array, sensor: Sensor) -> None:
    """Raise PixsimError if a picture has not the shape of the sensor."""
    if mean_e.shape != sensor.shape:
        raise invalid(
            "mean_e",
            f"an array of shape {mean_e.shape}",
            f"the pixels of the sensor, {sensor.shape}",
        )


def _offset_maps_e(sensor: Sensor, rows: slice) -> list[Array]:
    """Return the fixed offsets of some rows: of pixels, (rows, columns), and of columns, (1,
    columns), where the sensor has them.
    """
    pixel_e = None if sensor.offset_e is None else sensor.offset_e[rows]
    return [offset_e for offset_e in (pixel_e, sensor.column_offset_e) if offset_e is not None]


def _expose_burst(
    mean_e: Array,
    integration_s: float,
    sensor: Sensor,
    rng: np.random.Generator,
    subexposures_e: Sequence[Array],
) -> _Exposed:
    """Expose a burst of a pixel that is read once, for the mean electrons and the time of all its
    subexposures.

    The sum of the codes of pixels that no subexposure clips, and whose noise makes rounding a noise
    (`quantise`), is drawn at once. Of all other pixels each subexposure is read out.
    """
    count = sensor.readout.exposures
    (reading,) = with_merge(sensor.readout).readings
    time_s = integration_s / count
    row_sigma_e = constant_e(reading.readout, is_temporal=True, along="row")
    photos_e = subexposures_e or [mean_e / count]

    columns = sensor.shape[1]
    dn = np.empty(mean_e.shape, np.int32)
    saturated = np.zeros(mean_e.shape, bool)
    saturated_counts: list[int] = []

    def expose(block: slice, rng: np.random.Generator) -> None:
        for part in strips(block.stop - block.start, columns):
            rows = slice(block.start + part.start, block.start + part.stop)
            shape = 2, rows.stop - rows.start, columns
            charges_e = [
                _mean_charge_e(photo_e[rows], time_s, reading, sensor, rows, np.empty(shape))
                for photo_e in photos_e
            ]
            offset_e = np.zeros(charges_e[0].shape)
            for map_e in _offset_maps_e(sensor, rows):
                offset_e += map_e
            row_noise = np.zeros((count, len(offset_e), 1))
            if row_sigma_e:
                row_noise = row_sigma_e * rng.standard_normal(row_noise.shape)

            codes = _draw_summed_codes(charges_e, offset_e, row_noise, reading.readout, rng)
            is_safe = _never_clips(charges_e, offset_e, row_noise, reading.readout, time_s)
            clipped = np.nonzero(~is_safe)
            clipped_e = [charge_e[clipped] for charge_e in charges_e]
            clipped_offset_e = offset_e[clipped]
            total_dn, single_dn = np.zeros((2, clipped[0].size), np.int32)
            is_full, is_saturating = np.zeros((2, clipped[0].size), bool)
            for number, row_e in enumerate(row_noise[:, clipped[0], 0]):
                charge_e = clipped_e[number % len(clipped_e)]
                is_now_full, saturates = _read_level(
                    np.asarray(_shot_noise(charge_e, rng), float),
                    time_s,
                    reading,
                    [clipped_offset_e],
                    rng,
                    single_dn,
                    row_e=row_e,
                )
                total_dn += single_dn
                is_full |= is_now_full
                is_saturating |= saturates
            codes[clipped] = total_dn
            saturated[rows][clipped] = is_full

            np.copyto(dn[rows], codes, casting="unsafe")  # whole numbers
            saturated_counts.append(int(np.count_nonzero(is_saturating)))

    _by_block(expose, mean_e.shape, rng)
    return _Exposed(dn[None], saturated, sum(saturated_counts) / max(dn.size, 1))


def _never_clips(
    charges_e: Sequence[Array], offset_e: Array, row_noise: Array, readout: Readout, time_s: float
) -> NDArray[np.bool_]:
    """Return which pixels no subexposure clips, and whose noise makes rounding a noise, (rows,
    columns).

    charges_e : mean charges of the subexposures; a single one if all are the same
    offset_e : fixed offsets, (rows, columns)
    row_noise : (subexposures, rows, 1) electrons
    readout : of one subexposure
    """
    darkest_e = np.minimum.reduce(charges_e)
    brightest_e = np.maximum.reduce(charges_e)
    pixel_sigma_e = constant_e(readout, is_temporal=True, along="pixel")

    def extreme_dn(charge_e: Array, row_e: Array, sign: int) -> Array:
        """Level that a subexposure exceeds by chance as good as never, down (-1) or up (1)."""
        spread_e = _CLIP_SIGMAS * np.sqrt(charge_e + pixel_sigma_e**2) + POISSON_MARGIN_E
        return np.asarray(
            readout.dn_per_e * (charge_e + offset_e + row_e + sign * spread_e)
            + readout.adc.black_level_dn
        )

    above_zero = extreme_dn(darkest_e, row_noise.min(axis=0), -1) > 0
    below_top = extreme_dn(brightest_e, row_noise.max(axis=0), 1) < readout.adc.top_code_dn
    is_dithered = readout.dn_per_e * np.sqrt(darkest_e + pixel_sigma_e**2) >= _MIN_DITHER_DN

    limit_e = saturation_level_e(time_s, readout) if responds_linearly(readout.physics) else 0.0
    below_full = brightest_e + _CLIP_SIGMAS * np.sqrt(brightest_e) + POISSON_MARGIN_E < limit_e
    return np.asarray(above_zero & below_top & is_dithered & below_full)


def _draw_summed_codes(
    charges_e: Sequence[Array],
    offset_e: Array,
    row_noise: Array,
    readout: Readout,
    rng: np.random.Generator,
) -> Array:
    """Draw the sum of the codes of all subexposures at once, (rows, columns), without clipping.

    A sum of Poisson counts is a Poisson count; a sum of normal values, with all roundings but the
    last, is a normal value.

    charges_e, offset_e, row_noise, readout : as in `_never_clips`
    """
    count = len(row_noise)
    total_e = count * charges_e[0] if len(charges_e) == 1 else np.add.reduce(charges_e)
    level_e = np.asarray(_shot_noise(total_e, rng), float)

    pixel_sigma_e = constant_e(readout, is_temporal=True, along="pixel")
    rounding_sigma_e = math.sqrt((count - 1) / 12) / readout.dn_per_e
    sigma_e = math.hypot(math.sqrt(count) * pixel_sigma_e, rounding_sigma_e)
    level_e += sigma_e * rng.standard_normal(level_e.shape)
    level_e += count * offset_e + row_noise.sum(axis=0)
    return np.rint(readout.dn_per_e * level_e + count * readout.adc.black_level_dn)


def _by_block(
    draw: Callable[[slice, np.random.Generator], None],
    shape: tuple[int, int],
    rng: np.random.Generator,
) -> None:
    """Call a function for each block of rows, with a generator of its own: large frames take
    several threads.

    A frame of one block draws from `rng` itself.
    """
    blocks = list(strips(*shape, BLOCK_PIXELS))
    generators = [rng] if len(blocks) < 2 else rng.spawn(len(blocks))
    in_threads(lambda pair: draw(*pair), zip(blocks, generators, strict=True), math.prod(shape))


def frame_mean_dn(
    mean_e: NotNegativeArray | NotNegative, integration_s: NotNegative, readout: Readout
) -> Array:
    """Return the expected DN over sensors and frames, in the shape (...) of `mean_e`.

    It is valid at least 6σ away from 0, the well and the top code, for a linear response: with
    `well_limit = "diode"` below `linear_limit_e`, and not with `conversion = "junction"`.
    """
    dark_e = readout.dark_current_e_per_s * integration_s
    return (np.asarray(mean_e, float) + dark_e) * readout.dn_per_e + readout.black_level_dn


def frame_variance_dn2(
    mean_e: NotNegativeArray | NotNegative,
    integration_s: NotNegative,
    readout: Readout,
    fixed_pattern: bool = True,
) -> Array:
    """Return the variance of a pixel's DN over frames and, with `fixed_pattern`, over sensors, in
    the shape (...) of `mean_e`.

    It is the noise of eq. (2) of Chen et al. (2000) with read noise, fixed pattern and the ADC's
    LSB²/12; valid where `frame_mean_dn` is. Of several readings it is the variance of the merged
    electrons, in codes of the most sensitive one.
    """
    signal_e = np.asarray(mean_e, float)
    if readout.readings:
        merged_e2 = merged_variance_e2(
            readout, signal_e, integration_s, fixed_pattern=fixed_pattern
        )
        return np.asarray(merged_e2 * readout.dn_per_e**2)
    dark_e = readout.dark_current_e_per_s * integration_s
    temporal_e2 = variance_e2(readout, signal_e + dark_e, is_temporal=True)
    if not fixed_pattern:
        return np.asarray(temporal_e2 * readout.dn_per_e**2 + readout.rounding_variance_dn2)
    total_e2 = variance_e2(readout, temporal_e2, light_e=signal_e, dark_e=dark_e, is_temporal=False)
    return np.asarray(total_e2 * readout.dn_per_e**2 + readout.rounding_variance_dn2)


def capture_from_rates(
    signal_e_per_s: NotNegativePicture,
    sensor: Sensor,
    exposure: Exposure,
    rng: np.random.Generator,
    each: Sequence[Array] = (),
) -> Frame:
    """Return a frame from mean photo-electron rates (rows, columns), at the gain of the exposure,
    with temporal noise from `rng`.

    Light that flickers has these rates in its mean, on which the automatic exposure is metered.

    each : (rows, columns) rates in each subexposure of a burst, whose mean is the signal; empty if
        all are the same

    Raises PixsimError if the shape differs from the sensor's, if the electrons are too many for the
    numbers of the rates, and for exposures of several times in light that flickers.
    """
    if exposure.flickers:
        _check_exposed_at_once(sensor.readout, "flickers")
    exposure = with_metered_gain(exposure, sensor.readout, float(signal_e_per_s.max()))
    readout = sensor.readout.at(exposure)
    if signal_e_per_s.shape != sensor.shape:
        hint = (
            "Make the sensor with the camera and aspect of the irradiance: make_sensor(pixel,"
            " camera, aspect=…)."
        )
        raise invalid(
            "sensor",
            f"{sensor.shape} pixels for a picture of {signal_e_per_s.shape}",
            "the same shape",
            hint,
        )
    brightest_e_per_s = float(signal_e_per_s.max())
    time_s = integration_time_s(exposure, readout, brightest_e_per_s)
    subexposure_rates = list(each)
    planes = readout.physics.planes
    if gains := row_gains(time_s, len(signal_e_per_s) // planes, exposure, rng):
        steady_rates = subexposure_rates or [signal_e_per_s] * len(gains)
        subexposure_rates = [
            rate * np.tile(gain, planes)[:, None]
            for gain, rate in zip(gains, steady_rates, strict=True)
        ]
        signal_e_per_s = np.mean(subexposure_rates, axis=0)
        brightest_e_per_s = float(signal_e_per_s.max())
    mean_e = _mean_e(signal_e_per_s, brightest_e_per_s, time_s, readout)
    exposed = sensor if readout is sensor.readout else replace(sensor, readout=readout)
    subexposures_e = [rate * (time_s / exposure.frames) for rate in subexposure_rates]
    dn, saturated, fraction, estimate_e = _expose(mean_e, time_s, exposed, rng, subexposures_e)
    fields = _frame_fields(mean_e, time_s, readout, fraction, saturated)
    if not readout.readings:
        return Frame(dn=dn[0], **fields)
    codes = {reading.name: code for reading, code in zip(readout.readings, dn, strict=True)}
    return MergedFrame(**fields, corrected_e=estimate_e, readings=codes, readout=readout)


def make_frame(
    dn: NDArray[np.int32],
    saturated_fraction: SaturatedFraction,
    signal_e_per_s: NotNegativePicture,
    readout: Readout,
    exposure: Exposure,
    saturated: NDArray[np.bool_] | None = None,
) -> Frame:
    """Return a `Frame` of digital numbers and the mean photo-electron rates behind them, both
    (rows, columns).

    exposure : with which the numbers were read out

    saturated_fraction : as `Frame` defines it; it cannot be counted from the digital numbers
    saturated : likewise, (rows, columns). None: not known

    Raises PixsimError if the electrons are too many for the numbers of the rates.
    """
    brightest_e_per_s = float(signal_e_per_s.max())
    time_s = integration_time_s(exposure, readout, brightest_e_per_s)
    mean_e = _mean_e(signal_e_per_s, brightest_e_per_s, time_s, readout)
    readout = readout.at(exposure)
    return Frame(dn=dn, **_frame_fields(mean_e, time_s, readout, saturated_fraction, saturated))


def _mean_e(
    signal_e_per_s: Array, brightest_e_per_s: float, time_s: float, readout: Readout
) -> Array:
    """Return the mean photo-electrons of an exposure. Raises PixsimError if they, or the dark
    charge, would be infinite.
    """
    brightest_e = (brightest_e_per_s + readout.dark_current_e_per_s) * time_s
    if not brightest_e <= float(
        np.finfo(np.result_type(signal_e_per_s, 1.0)).max
    ):  # single precision stays that
        raise invalid(
            "mean_e",
            f"{brightest_e_per_s:.3g} e-/s for {time_s:.3g} s",
            "a finite number of electrons",
        )
    return signal_e_per_s * time_s


def _frame_fields(
    mean_e: Array,
    time_s: float,
    readout: Readout,
    saturated_fraction: float,
    saturated: NDArray[np.bool_] | None,
) -> dict[str, Any]:
    """Return the fields of a frame beside its codes.

    readout : in the exposure of the frame
    """
    physics = readout.physics
    return {
        "mean_e": mean_e,
        "integration_s": time_s,
        "dn_per_e": readout.dn_per_e,
        "black_level_dn": readout.black_level_dn,
        "mean_dark_e": readout.dark_current_e_per_s * time_s,
        "pitch_um": physics.read_pitch_um,
        "bits": readout.code_bits,
        "saturated_fraction": saturated_fraction,
        "gain_db": readout.gain_db,
        "layout": physics.layout,
        "registration": physics.registration,
        "exposures": readout.exposures,
        "white_level_dn": None if readout.exposures == 1 else float(readout.top_code_dn),
        "saturated": saturated,
        "dark_noise_e": readout.noise_floor_e,
    }


def capture(
    irradiance: SpectralImage,
    camera: Camera,
    sensor: Sensor,
    exposure: Exposure | None = None,
    *,
    motion: Motion | None = None,
    rng: np.random.Generator,
) -> Frame:
    """Take one picture: diffraction, pixel integration, exposure, temporal noise from `rng`, ADC.

    camera : of the irradiance
    sensor : from `make_sensor`, for the same camera
    exposure : None takes the default, automatic exposure
    motion : of the scene, if it moves. Light from beyond the picture is taken as
        reflected at its borders
    rng : for temporal noise only; the sensor has the fixed pattern

    Raises PixsimError if the picture does not fill the sensor, or if the light is negative or not
    finite.

    10 mW/m² of green light make E Δλ λ/hc A t photons, each of which frees QE electrons:

    >>> light = SpectralImage([550.0], 10.0, 169.6, data=np.full((16, 16, 1), 1e-3))
    >>> camera, pixel = Camera(), Pixel(pitch_um=100.0, infrared_cut_nm=700.0)
    >>> frame = capture(light, camera, make_sensor(pixel, camera), rng=np.random.default_rng(0))
    >>> area_m2 = derive(pixel).photodiode_area_um2 * 1e-12
    >>> photons_per_joule = 550e-9 / (6.62607015e-34 * 299792458)
    >>> photons = 1e-3 * 10 * photons_per_joule * area_m2 * frame.integration_s
    >>> round(float(frame.mean_e.mean() / photons / derive(pixel).quantum_efficiency(550.0)), 6)
    1.0
    """
    exposure = exposure or Exposure()
    physics = sensor.readout.physics
    if motion is None or not motion.is_on:
        signal = mean_signal_rate(irradiance, camera, physics)
        return capture_from_rates(signal, sensor, exposure, rng)

    irradiance.validate()
    lights = lights_of(irradiance, camera, physics)
    size_um = array_size_um(irradiance, camera)
    still, _ = array_signal(lights, irradiance.pitch_um, physics, size_um)
    um_per_s = velocity_um_per_s(motion, camera, physics.pitch_um)
    image_motion, exposure = metered_motion(still, sensor.readout, exposure, um_per_s)
    signal, subexposure_rates = moved_signals(
        lights, irradiance.pitch_um, physics, size_um, image_motion, exposure.frames
    )
    return capture_from_rates(signal, sensor, exposure, rng, subexposure_rates)
