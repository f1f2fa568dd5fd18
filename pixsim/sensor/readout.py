"""Mean electrons to digital numbers: exposure, fixed pattern, noise, well and ADC."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

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
from pixsim.base.notes import warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.flicker import row_gains
from pixsim.sensor.infrared import pixel_notes
from pixsim.sensor.integration import (
    array_signal,
    array_size_um,
    check_pixel_count,
    lights_of,
    mean_signal_rate,
    moved_signals,
    pixels_on,
)
from pixsim.sensor.motion import Moving, moving_in, velocity_um_per_s
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.noise import constant_e, variance_e2
from pixsim.sensor.photodiode import (
    full_pixels,
    responds_linearly,
    saturation_level_e,
    stored_signal_e,
)
from pixsim.sensor.pixel import CENTRED, Registration, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.quantities import (
    MAX_CODE_BITS,
    Aspect,
    FrameBits,
    GainDb,
    Pitch,
    SaturatedFraction,
)
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import load_technology

# Far above this mean the variance of NumPy's Poisson is wrong (+3.5 % at 1e15); a rounded normal
# lacks only the skewness 1/√mean, 3e-5 and less.
_POISSON_LIMIT_E = 1e9
BLACK_SIGMAS = (
    6.0  # of the dark signal, below the black level: clipping at 0 DN would bias dark statistics
)
# Of bursts: what is farther from both ends clips 1e-12 of a normal signal, and some electrons more
# of few Poisson counts; and the noise that makes rounding a noise.
CLIP_SIGMAS, FEW_E, MIN_DITHER_DN = 7.0, 10.0, 0.6
BLOCK_PIXELS = 1 << 23  # of larger frames, drawn with a generator of their own
MAX_BLACK = 0.5  # of the codes: a higher black level leaves too few for light


# --- exposure
# ---------------------------------------------------------------------------------------------------------


def lasting(exposure: Exposure, total_s: float) -> Exposure:
    """Return the exposure with a time that its exposures share."""
    return exposure.model_copy(update={"integration_s": total_s, "frame_time": "shared"})


def integration_time_s(
    exposure: Exposure, readout: Readout, brightest_e_per_s: NotNegative
) -> float:
    """Return the manual integration time, or the time that exposes the brightest pixel to the
    target, up to the maximum.

    It is that of all exposures of a frame together. The target is a share of `Readout.saturation_e`
    in the exposure, for the mean charge with dark charge.

    brightest_e_per_s : mean photo-electrons per second of the brightest pixel
    """
    if exposure.integration_s is not None:
        return exposure.times * exposure.integration_s
    brightest = brightest_e_per_s + readout.dark_current_e_per_s
    target_e = exposure.well_target * readout.at(exposure).saturation_e
    longest_s = exposure.times * exposure.max_integration_s
    return longest_s if brightest * longest_s <= target_e else target_e / brightest


def metered_motion(
    still_e_per_s: Array, readout: Readout, exposure: Exposure, um_per_s: tuple[float, float]
) -> tuple[Moving, Exposure]:
    """Return how light moves in a frame that is metered on the picture that stands still, and the
    exposure with its time.

    still_e_per_s : signal of that picture, (rows, columns)
    um_per_s : velocity [x, y] of the image on the sensor
    """
    time_s = integration_time_s(exposure, readout, float(still_e_per_s.max()))
    return moving_in(um_per_s, time_s, exposure), lasting(exposure, time_s)


# --- fixed pattern
# ----------------------------------------------------------------------------------------------------


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
    """

    readout: Readout
    shape: tuple[Count, Count]
    gain: Array | None = field(repr=False)
    dark_gain: Array | None = field(repr=False)
    offset_e: Array | None = field(repr=False)
    column_offset_e: Array | None = field(repr=False)


def sample_sensor(readout: Readout, shape: tuple[Count, Count], rng: np.random.Generator) -> Sensor:
    """Draw the fixed pattern of a sensor of a given `shape` (rows, columns) from `rng`.

    PRNU is normal, clipped at zero. DSNU is gamma-distributed, since a normal distribution would
    have negative currents; hot pixels (`pixsim.sensor.mismatch`) have a stream of their own, so
    that all other maps are those of a sensor without them.
    """
    p, dark_spread = readout.burst(1), readout.dark_spread
    uneven_dark = p.dark_current_e_per_s > 0 and not dark_spread.is_uniform
    pixel_spread_e, column_spread_e = (
        constant_e(p, is_temporal=False, along=along) for along in ("pixel", "column")
    )
    gain, dark_gain, offset_e = (
        np.empty(shape) if uneven else None for uneven in (p.prnu, uneven_dark, pixel_spread_e)
    )

    def draw(block: slice, rng: np.random.Generator) -> None:
        if gain is not None:
            for part in _rows_of(gain[block]):
                _draw_gaussian(p.prnu, part, rng)
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
    return Sensor(readout, shape, gain, dark_gain, offset_e, column_offset_e)


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
    aspect : ratio of the film's width to its height; None means the shape of the camera's die

    Raises PixsimError if the pitch is too small for the technology, larger than the die, or gives
    too many pixels.

    >>> make_sensor(Pixel(pitch_um=5.3), Camera(die_mm=2.7136)).shape  # the die of Chen et al. (2000)
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
# --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frame:
    """The digital numbers of one frame, with the quantities behind them; of a burst, the sums over
    its exposures.

    dn : (rows, columns) int32, 0 … 2^bits - 1
    mean_e : (rows, columns) mean photo-electrons, before non-uniformity, dark charge and noise
    integration_s : integration time, of all exposures together
    dn_per_e : gain, DN per electron
    black_level_dn : DN without light and dark charge
    mean_dark_e : mean dark charge of a pixel in this frame
    pitch_um : centre-to-centre distance of pixels
    bits : of the codes: of the ADC, or of the sum
    gain_db : amplification of the exposure, which `dn_per_e` includes
    saturated_fraction : fraction of pixels whose charge reached `saturation_level_e` (light and
        dark, with shot noise, before reset noise and offsets) or whose DN is the top code, in any
        exposure
    corrected_e : (rows, columns) photo-electrons as the camera's correction estimates them; None
        without one
    layout : which channel each value belongs to; None for a monochrome sensor. A stacked one has
        its planes one below the other
    registration : of its pixels on the die, as of `PixelPhysics`
    exposures : that are summed
    white_level_dn : highest code; None: all bits set
    saturated : (rows, columns) which pixels were full in any exposure: charge at the full well (a
        soft one: at 99 % of it), or the top code. `saturated_fraction` is its mean, but for a soft
        well. None: not known
    dark_noise_e : standard deviation of all temporal noise without light and dark charge, of all
        exposures together
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
        """Rows and columns of what is read: pixels, or their sums with binning."""
        return (
            self.dn.shape[0] // (1 if self.layout is None else self.layout.planes),
            self.dn.shape[1],
        )

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
    def electrons(self) -> Array:
        """The estimate of photo-electrons, (rows, columns), `estimate_e`."""
        return self.estimate_e

    @property
    def estimate_variance_e2(self) -> Array:
        """Estimated variance of `estimate_e` over frames of the same sensor, (rows, columns).

        It is that of the Poisson law at the estimate, if that is above 0, and at the mean dark
        charge, with reset, read and row noise and rounding; valid where nothing clips. Frames of a
        correction add noise of their own, which is not in it.
        """
        variance_e2 = np.maximum(self.estimate_e, 0.0)
        variance_e2 += (
            self.mean_dark_e + self.dark_noise_e**2 + self.exposures / 12 / self.dn_per_e**2
        )
        return variance_e2


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

    The gain is that of the sensor's `readout`, which `capture_from_rates` takes to an exposure
    (`Readout.at`).

    PRNU and dark charge → Poisson → well and conversion (`pixsim.sensor.photodiode`) → reset and
    read noise (one normal) → row noise → fixed offsets → gain → black level → ADC. Closed forms are
    `frame_mean_dn` and `frame_variance_dn2`. Of a burst (`Readout.burst`) mean and time are those
    of all its exposures, and the frame is the sum of their codes.

    Raises PixsimError if `mean_e` has not the shape of the sensor.
    """
    return _expose(mean_e, integration_s, sensor, rng)[0]


def _expose(
    mean_e: Array,
    integration_s: float,
    sensor: Sensor,
    rng: np.random.Generator,
    subexposures_e: Sequence[Array] = (),
) -> tuple[NDArray[np.int32], NDArray[np.bool_], float]:
    """Return the frame of `read_out`, its saturated pixels and their fraction, as `Frame` defines
    them.

    subexposures_e : mean electrons in each exposure of a burst, if they differ; else none

    A few rows at a time, which keeps the work arrays small; all shot noise of a block is drawn
    before its read noise.
    """
    if sensor.readout.exposures > 1:
        return _expose_burst(mean_e, integration_s, sensor, rng, subexposures_e)
    if mean_e.shape != sensor.shape:
        raise invalid(
            "mean_e",
            f"an array of shape {mean_e.shape}",
            f"the pixels of the sensor, {sensor.shape}",
        )
    p, generated, dn = sensor.readout, np.empty(mean_e.shape), np.empty(mean_e.shape, np.int32)
    mean_dark_e = p.dark_current_e_per_s * integration_s
    pixel_sigma_e, row_sigma_e = (
        constant_e(p, is_temporal=True, along=along) for along in ("pixel", "row")
    )
    # Counted before readout: reset noise and negative offsets keep half of the full pixels off the
    # top code.
    full_e, top_dn = saturation_level_e(integration_s, p), p.adc.top_code_dn
    saturated, counts = np.empty(mean_e.shape, bool), list[int]()

    def expose(block: slice, rng: np.random.Generator) -> None:
        within = [
            slice(block.start + rows.start, block.start + rows.stop)
            for rows in strips(block.stop - block.start, dn.shape[1])
        ]
        charge, dark_e = (
            np.empty((max(rows.stop - rows.start for rows in within), dn.shape[1]))
            for _ in range(2)
        )
        for rows in within:
            mean, dark = (work[: rows.stop - rows.start] for work in (charge, dark_e))
            np.multiply(mean_e[rows], 1.0 if sensor.gain is None else sensor.gain[rows], out=mean)
            if mean_dark_e:
                mean += (
                    mean_dark_e
                    if sensor.dark_gain is None
                    else np.multiply(mean_dark_e, sensor.dark_gain[rows], out=dark)
                )
            generated[rows] = _shot_noise(mean, rng)
        for rows in within:
            level, noise = generated[rows], charge[: rows.stop - rows.start]
            saturating, charge_e = level >= full_e, level
            level = stored_signal_e(level, integration_s, p)
            full = full_pixels(charge_e, level, p)
            if pixel_sigma_e:
                _draw_gaussian(pixel_sigma_e, noise, rng)
                level += noise
            if row_sigma_e:
                level += row_sigma_e * rng.standard_normal((level.shape[0], 1))
            for added_e in (
                None if sensor.offset_e is None else sensor.offset_e[rows],
                sensor.column_offset_e,
            ):
                if added_e is not None:
                    level += added_e
            level *= p.dn_per_e
            if p.adc.black_level_dn:
                level += p.adc.black_level_dn
            _quantise(level, p.adc.bits, dn[rows])
            at_top = dn[rows] >= top_dn
            np.logical_or(full, at_top, out=saturated[rows])
            counts.append(int(np.count_nonzero(saturating | at_top)))

    _by_block(expose, mean_e.shape, rng)
    return dn, saturated, sum(counts) / max(dn.size, 1)


def _expose_burst(
    mean_e: Array,
    integration_s: float,
    sensor: Sensor,
    rng: np.random.Generator,
    each_e: Sequence[Array],
) -> tuple[NDArray[np.int32], NDArray[np.bool_], float]:
    """Return `_expose` of a burst, for the mean electrons and the time of all its exposures.

    The sum of the codes of pixels that no exposure clips, and whose noise makes rounding a noise
    (`quantise`), is drawn at once: the sum of Poisson counts is one, that of normals and of all
    roundings but the last is a normal. Of all other pixels each exposure is read out.
    """
    if mean_e.shape != sensor.shape:
        raise invalid(
            "mean_e",
            f"an array of shape {mean_e.shape}",
            f"the pixels of the sensor, {sensor.shape}",
        )
    p, count = sensor.readout.burst(1), sensor.readout.exposures
    time_s, gain, black_dn, top_dn = (
        integration_s / count,
        p.dn_per_e,
        p.adc.black_level_dn,
        p.adc.top_code_dn,
    )
    mean_dark_e, full_e = p.dark_current_e_per_s * time_s, saturation_level_e(time_s, p)
    of_pixels_e, of_rows_e = (
        constant_e(p, is_temporal=True, along=along) for along in ("pixel", "row")
    )
    is_linear, last_roundings_e = responds_linearly(p.physics), math.sqrt((count - 1) / 12) / gain
    dn, saturated, counts = (
        np.empty(mean_e.shape, np.int32),
        np.zeros(mean_e.shape, bool),
        list[int](),
    )

    def expose(block: slice, rng: np.random.Generator) -> None:
        for part in strips(block.stop - block.start, dn.shape[1]):
            rows = slice(block.start + part.start, block.start + part.stop)
            gain_of = 1.0 if sensor.gain is None else sensor.gain[rows]
            dark_e = (
                mean_dark_e
                if sensor.dark_gain is None or not mean_dark_e
                else mean_dark_e * sensor.dark_gain[rows]
            )
            means = [one[rows] * gain_of + dark_e for one in each_e] or [
                mean_e[rows] * (gain_of / count) + dark_e
            ]
            least, most = (
                (means[0], means[0])
                if len(means) == 1
                else (np.minimum.reduce(means), np.maximum.reduce(means))
            )
            offset_e = np.zeros(least.shape)
            for added_e in (
                None if sensor.offset_e is None else sensor.offset_e[rows],
                sensor.column_offset_e,
            ):
                if added_e is not None:
                    offset_e += added_e
            of_row_e = (
                of_rows_e * rng.standard_normal((count, len(least), 1))
                if of_rows_e
                else np.zeros((count, len(least), 1))
            )
            low_dn, high_dn = (
                gain
                * (
                    mean
                    + offset_e
                    + edge_e
                    + sign * (CLIP_SIGMAS * np.sqrt(mean + of_pixels_e**2) + FEW_E)
                )
                + black_dn
                for sign, mean, edge_e in (
                    (-1, least, of_row_e.min(axis=0)),
                    (1, most, of_row_e.max(axis=0)),
                )
            )
            free = (
                (low_dn > 0)
                & (high_dn < top_dn)
                & (gain * np.sqrt(least + of_pixels_e**2) >= MIN_DITHER_DN)
            )
            free &= most + CLIP_SIGMAS * np.sqrt(most) + FEW_E < (full_e if is_linear else 0.0)
            level = np.asarray(
                _shot_noise(np.add.reduce(means) if each_e else count * least, rng), float
            )
            level += math.hypot(
                math.sqrt(count) * of_pixels_e, last_roundings_e
            ) * rng.standard_normal(level.shape)
            level += count * offset_e + of_row_e.sum(axis=0)
            level = np.rint(gain * level + count * black_dn)
            clipped, count_full = np.nonzero(~free), 0
            if clipped[0].size:
                total = np.zeros(clipped[0].size)
                is_full, is_saturating = (np.zeros(clipped[0].size, bool) for _ in range(2))
                for number, row_e in enumerate(of_row_e):
                    generated = np.asarray(
                        _shot_noise(means[number % len(means)][clipped], rng), float
                    )
                    stored = stored_signal_e(generated, time_s, p)
                    is_saturating |= generated >= full_e
                    is_full |= full_pixels(generated, stored, p)
                    one = stored + of_pixels_e * rng.standard_normal(generated.size)
                    one += offset_e[clipped] + row_e[clipped[0], 0]
                    codes = np.clip(np.rint(gain * one + black_dn), 0, top_dn)
                    is_full |= codes >= top_dn
                    is_saturating |= codes >= top_dn
                    total += codes
                level[clipped], saturated[rows][clipped] = total, is_full
                count_full = int(np.count_nonzero(is_saturating))
            np.copyto(dn[rows], level, casting="unsafe")  # whole numbers
            counts.append(count_full)

    _by_block(expose, mean_e.shape, rng)
    return dn, saturated, sum(counts) / max(dn.size, 1)


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
    LSB²/12; valid where `frame_mean_dn` is.
    """
    p, signal_e = readout, np.asarray(mean_e, float)
    dark_e = p.dark_current_e_per_s * integration_s
    temporal_e2 = variance_e2(p, signal_e + dark_e, is_temporal=True)
    if not fixed_pattern:
        return np.asarray(temporal_e2 * p.dn_per_e**2 + p.rounding_variance_dn2)
    total_e2 = variance_e2(p, temporal_e2, light_e=signal_e, dark_e=dark_e, is_temporal=False)
    return np.asarray(total_e2 * p.dn_per_e**2 + p.rounding_variance_dn2)


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

    Without a given gain a range F spans the codes M - b above the black level b, so that b = 6σ(M -
    b)/F, solved for b. Of a burst it is that of each exposure.
    """
    readout, integration_s = readout.burst(1), integration_s / readout.exposures
    adc, spread = readout.adc, BLACK_SIGMAS * dark_spread_e(readout, integration_s)
    if adc.gain_e_per_dn is not None:
        return math.ceil(spread * readout.amplification / adc.gain_e_per_dn) + 1
    return math.ceil(spread * adc.top_code_dn / (readout.adc_range_e + spread)) + 1


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

    each : the rates in each exposure of a burst, whose mean is the signal, if they differ; else
        none

    Raises PixsimError if the shape is not that of the sensor, or if the electrons are too many for
    the numbers of the rates.
    """
    p = sensor.readout.at(exposure)
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
    time_s = integration_time_s(exposure, p, brightest_e_per_s)
    planes = p.physics.planes
    if gains := row_gains(time_s, len(signal_e_per_s) // planes, exposure, rng):
        each = [
            one * np.tile(gain, planes)[:, None]
            for gain, one in zip(gains, each or [signal_e_per_s] * len(gains), strict=True)
        ]
        signal_e_per_s = np.mean(each, axis=0)
        brightest_e_per_s = float(signal_e_per_s.max())
    mean_e = _mean_e(signal_e_per_s, brightest_e_per_s, time_s, p)
    exposed = sensor if p is sensor.readout else replace(sensor, readout=p)
    dn, saturated, fraction = _expose(
        mean_e, time_s, exposed, rng, [one * (time_s / exposure.frames) for one in each]
    )
    return _frame(dn, fraction, mean_e, time_s, p, exposure, saturated)


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
    saturated : likewise, (rows, columns); None: not known

    Raises PixsimError if the electrons are too many for the numbers of the rates.
    """
    brightest_e_per_s = float(signal_e_per_s.max())
    time_s = integration_time_s(exposure, readout, brightest_e_per_s)
    mean_e = _mean_e(signal_e_per_s, brightest_e_per_s, time_s, readout)
    return _frame(dn, saturated_fraction, mean_e, time_s, readout, exposure, saturated)


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


def _frame(
    dn: NDArray[np.int32],
    saturated_fraction: float,
    mean_e: Array,
    time_s: float,
    readout: Readout,
    exposure: Exposure,
    saturated: NDArray[np.bool_] | None,
) -> Frame:
    readout, physics = readout.at(exposure), readout.physics
    dn_per_e = readout.dn_per_e
    if not dn_per_e < math.inf:
        raise invalid(
            "dn_per_e",
            f"{dn_per_e}",
            "a finite number",
            "Take a larger full well, or more electrons per DN.",
        )
    return Frame(
        dn=dn,
        mean_e=mean_e,
        integration_s=time_s,
        dn_per_e=dn_per_e,
        black_level_dn=readout.black_level_dn,
        mean_dark_e=readout.dark_current_e_per_s * time_s,
        pitch_um=physics.read_pitch_um,
        bits=readout.code_bits,
        saturated_fraction=saturated_fraction,
        gain_db=exposure.gain_db,
        layout=physics.layout,
        registration=physics.registration,
        exposures=readout.exposures,
        white_level_dn=None if readout.exposures == 1 else float(readout.top_code_dn),
        saturated=saturated,
        dark_noise_e=readout.noise_floor_e,
    )


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

    camera : that of the irradiance
    sensor : from `make_sensor`, for the same camera
    exposure : None takes the default, automatic exposure
    motion : of the scene; None means that it stands still. Light from beyond the picture is taken
        as reflected at its borders
    rng : for temporal noise only; the sensor has the fixed pattern

    Raises PixsimError if the picture does not fill the sensor, or if the light is negative or not
    finite.

    >>> light = SpectralImage([550.0], 10.0, 169.6, data=np.full((16, 16, 1), 1e-3))  # 10 mW/m² of green
    >>> camera, pixel = Camera(), Pixel(pitch_um=100.0, infrared_cut_nm=700.0)
    >>> frame = capture(light, camera, make_sensor(pixel, camera), rng=np.random.default_rng(0))
    >>> area_m2 = derive(pixel).photodiode_area_um2 * 1e-12
    >>> photons = 1e-3 * 10 * 550e-9 / (6.62607015e-34 * 299792458) * area_m2 * frame.integration_s  # E Δλ λ/hc A t
    >>> round(float(frame.mean_e.mean() / photons / derive(pixel).quantum_efficiency(550.0)), 6)
    1.0
    """
    exposure, physics = exposure or Exposure(), sensor.readout.physics
    if motion is None or not motion.is_on:
        return capture_from_rates(
            mean_signal_rate(irradiance, camera, physics), sensor, exposure, rng
        )
    irradiance.validate()
    lights, size_um = lights_of(irradiance, camera, physics), array_size_um(irradiance, camera)
    still, _ = array_signal(lights, irradiance.pitch_um, physics, size_um)
    moving, exposure = metered_motion(
        still, sensor.readout, exposure, velocity_um_per_s(motion, camera, physics.pitch_um)
    )
    signal, subexposure_rates = moved_signals(
        lights, irradiance.pitch_um, physics, size_um, moving, exposure.frames
    )
    return capture_from_rates(signal, sensor, exposure, rng, subexposure_rates)
