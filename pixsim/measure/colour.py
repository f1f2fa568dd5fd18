"""A colour sensor under CIE D55: its patches, colour matrix and noise, measured on frames of its
mosaic, next to closed forms.

Uniform fields of the chromatic patches of ISO 17321-1, of a perfect white and of 18 % grey fill
frames of one device. White is at 72 % of saturation in the channel that it fills most, so that grey
is at 13 % (ISO 15739). The mean of each channel over its mean in white is the balanced response, to
which the matrix is fitted as in `pixsim.viewer.colour_matrix`. Temporal noise is measured in the
difference of two frames of grey, as luminance Y and as R - Y and B - Y of the display's linear
light, of single samples without interpolation between pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pixsim.base.arrays import Array, stream
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.light.spectral import photons_per_joule
from pixsim.light.standard import CHROMATIC_PATCHES, illuminant
from pixsim.measure.estimators import Estimate, Frames
from pixsim.measure.experiment import Experiment, read_linear
from pixsim.sensor.collection import ColourCollection, collections_of, emva_illumination
from pixsim.sensor.colour import Layout, channel_map
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2, sample_sensor
from pixsim.viewer.colour_matrix import STANDARD_NM, chart_responses, chart_xyz, metamerism_index
from pixsim.viewer.develop import ColourChart, check_separable, product
from pixsim.viewer.develop_options import DEVELOP
from pixsim.viewer.display import XYZ_FROM_RGB

LAMP = "D55"  # the default of ISO 17321-1
_WHITE_SHARE = 0.13 / 0.18  # of saturation
GREY = 0.18  # reflectance
PAIRS = 2  # frames of each field
# Standard errors of a channel's white: with fewer, its balance is not known.
_MIN_WHITE_SIGMAS = 5.0
_ROUNDING_DN = 0.01  # of a mean, where there is no noise to see
# Of the measured means within their standard errors; they give standard errors to 15 %.
_REDRAWS = 24


@dataclass(frozen=True)
class _ColourTruth:
    """The chart under the lamp as the channels record it by their parameters, crosstalk included.

    colour_chart : the chromatic patches
    white_e : (C,) electrons of white in a value of each channel
    """

    colour_chart: ColourChart
    white_e: Array


@dataclass(frozen=True)
class Colour:
    """Statistics of the fields of a device. Signals are minus the dark.

    readout : how the pixels are read, without a channel
    patches_dn, patches_error_dn : (18, C) means and their standard errors
    white_dn, white_error_dn : (C,)
    gain_error : (C,) relative, of the mean gain of the device's pixels in each channel, for devices
        of one type
    grey_dn : (C,)
    grey_noise_dn : (n, C) temporal noise of single samples
    seed : of the redraws
    """

    readout: Readout
    integration_s: float
    truth: _ColourTruth
    patches_dn: Array = field(repr=False)
    patches_error_dn: Array = field(repr=False)
    white_dn: Array = field(repr=False)
    white_error_dn: Array = field(repr=False)
    gain_error: Array = field(repr=False)
    grey_dn: Array = field(repr=False)
    grey_noise_dn: Array = field(repr=False)
    seed: int = 0

    @property
    def channels(self) -> tuple[str, ...]:
        layout = self.readout.physics.layout
        assert layout is not None
        return layout.channels

    @cached_property
    def measured(self) -> ColourChart:
        """The chart as the frames have it, with XYZ from the tables."""
        return replace(
            self.truth.colour_chart, responses=np.maximum(self.patches_dn / self.white_dn, 0.0)
        )

    @cached_property
    def redrawn(self) -> list[ColourChart]:
        """The measured chart, with the means of patches and white redrawn within their errors."""
        rng = stream("datasheet", self.seed, "colour errors")
        draws = []
        for _ in range(_REDRAWS):
            patch_deviation = rng.standard_normal(self.patches_dn.shape)
            white_deviation = rng.standard_normal(self.white_dn.shape)
            patches = self.patches_dn + self.patches_error_dn * patch_deviation
            white = self.white_dn + self.white_error_dn * white_deviation
            draws.append(replace(self.measured, responses=np.maximum(patches / white, 0.0)))
        return draws

    def estimate(self, quantity: Callable[[ColourChart], float]) -> Estimate:
        """Return a quantity of the measured chart, with the spread of its redraws as standard
        error.
        """
        redrawn = [quantity(colour_chart) for colour_chart in self.redrawn]
        return Estimate(quantity(self.measured), float(np.std(redrawn, ddof=1)))

    @cached_property
    def white_balance(self) -> list[Estimate]:
        """Gain of each channel that makes white equal in all, relative to the channel that white
        fills most, (C,).
        """
        brightest = int(np.argmax(self.truth.white_e))
        errors = np.hypot(self.white_error_dn, self.white_dn * self.gain_error)
        signals = [
            Estimate(*pair) for pair in zip(self.white_dn.tolist(), errors.tolist(), strict=True)
        ]
        return [
            Estimate(1.0) if number == brightest else signals[brightest] / signal
            for number, signal in enumerate(signals)
        ]

    @property
    def true_white_balance(self) -> Array:
        return np.asarray(self.truth.white_e.max() / self.truth.white_e)

    def snr(self) -> tuple[Estimate, Estimate]:
        """Mean luminance of grey over the noise of luminance, and over the noise of R - Y and B - Y
        together.
        """
        opponent = _opponents(self.measured)
        luminance = float((opponent[0] * self.grey_dn / self.white_dn).sum())
        noise = (opponent[:, None, :] * (self.grey_noise_dn / self.white_dn)).sum(axis=2)  # (3, n)
        variances = noise.var(axis=1)
        count = noise.shape[1]
        together = variances[1] + variances[2]

        # Of a sum of two variances, with their covariance; normal noise.
        covariance = float(np.mean(noise[1] * noise[2]))
        spread = math.sqrt(2 * (variances[1] ** 2 + variances[2] ** 2 + 2 * covariance**2) / count)
        if not min(variances[0], together) > 0:  # below the rounding of the ADC
            return Estimate(math.nan, math.nan), Estimate(math.nan, math.nan)
        snr_luminance = luminance / math.sqrt(variances[0])
        snr_chrominance = luminance / math.sqrt(together)
        return (
            Estimate(snr_luminance, snr_luminance / math.sqrt(2 * count)),
            Estimate(snr_chrominance, snr_chrominance * spread / together / 2),
        )

    def true_snr(self) -> tuple[float, float]:
        """The ratios of `snr` by the parameters, with the mean temporal variance of the pixels."""
        p = self.readout
        opponent = _opponents(self.truth.colour_chart)
        variance = frame_variance_dn2(
            GREY * self.truth.white_e, self.integration_s, p, fixed_pattern=False
        )
        relative_variance = variance / (self.truth.white_e * p.dn_per_e) ** 2
        luminance, *chrominance = (opponent**2 * relative_variance).sum(axis=1)

        # The matrix need not keep white.
        mean = GREY * float(opponent[0].sum())
        return mean / math.sqrt(luminance), mean / math.sqrt(sum(chrominance))


def matrix_to_display(colour_chart: ColourChart) -> Array:
    """Return the matrix from balanced channels to the display's primaries, (3, C); noise of a
    measurement may raise its gains.
    """
    return product(colour_chart.to_display, colour_chart.fit_matrix(DEVELOP.matrix))


def smi(colour_chart: ColourChart) -> float:
    """Return the sensitivity metamerism index of a chart."""
    return metamerism_index(colour_chart.errors(matrix_to_display(colour_chart)))


def noise_gain(colour_chart: ColourChart, primary: int) -> float:
    """Return the gain of the matrix for equal noise of the balanced channels, in a primary of the
    display.
    """
    return float(np.sqrt(np.square(matrix_to_display(colour_chart)[primary]).sum()))


def _opponents(colour_chart: ColourChart) -> Array:
    """Return the matrix from balanced channels to Y, R - Y and B - Y of the display's linear light,
    (3, C).
    """
    red, green, blue = matrix_to_display(colour_chart)
    weights = XYZ_FROM_RGB[1] / XYZ_FROM_RGB[1].sum()
    luminance = weights[0] * red + weights[1] * green + weights[2] * blue
    return np.stack([luminance, red - luminance, blue - luminance])


def colour_truth(readout: Readout, integration_s: float) -> _ColourTruth:
    """Return chart and white as a colour pixel records them by its parameters.

    Raises PixsimError if the channels do not tell the patches' colours apart, or if the matrix
    amplifies noise too much.
    """
    physics = readout.physics
    power = illuminant(LAMP, STANDARD_NM)
    photons = photons_per_joule(STANDARD_NM)
    curves = [channel.quantum_efficiency(STANDARD_NM) * photons for channel in physics.channels]
    responses = np.stack(curves, axis=1)
    xyz, white_xyz = chart_xyz(STANDARD_NM, power)
    patch_responses = chart_responses(STANDARD_NM, responses, power)[CHROMATIC_PATCHES]
    rates = (power[:, None] * responses).sum(axis=0)
    colour_chart = ColourChart(patch_responses, xyz[CHROMATIC_PATCHES], white_xyz, "bradford", LAMP)
    layout = Layout.unbinned(physics.pixel)
    assert layout is not None
    lights = [emva_illumination(STANDARD_NM, power * curve) for curve in responses.T]
    collections = collections_of(physics, lights, (1, 1))
    white = rates
    if collections:
        collection = ColourCollection(
            layout, tuple(collections), tuple(rates.tolist()), physics.pitch_um, readout.bin_side
        )
        colour_chart = colour_chart.mixed_by(collection.mixing_um2, rates)
        white = collection.white_e_per_s

    check_separable(colour_chart.responses, LAMP)
    colour_chart.matrix(DEVELOP)
    largest_e = readout.saturation_e - readout.dark_current_e_per_s * integration_s
    return _ColourTruth(colour_chart, white * (_WHITE_SHARE * largest_e / white.max()))


def measure_colour(experiment: Experiment, gain_spread: float = 0.0) -> Colour:
    """Capture the fields of a colour sensor in the exposure of an experiment, and return their
    statistics.

    gain_spread : PRNU, which is part of the standard error of the white balance

    Raises PixsimError as `colour_truth` does, for a frame without pixels of every channel, and for
    a channel that white hardly fills.
    """
    readout = experiment.readout.with_physics(channel="")
    time_s = experiment.integration_s
    truth = colour_truth(readout, time_s)
    layout = readout.physics.layout
    assert layout is not None
    rows, columns = experiment.sensor.shape
    shape = rows * layout.planes, columns
    sensor = sample_sensor(readout, shape, stream("datasheet", experiment.seed, "colour sensor"))

    numbers = layout.numbers(shape)
    counts = np.bincount(numbers.ravel(), minlength=len(layout.channels))
    if not counts.all():
        missing = layout.channels[int(np.argmin(counts))]
        got = f"{rows} × {columns} pixels, none of channel {missing}"
        raise invalid("shape", got, "at least one unit cell")

    def capture(name: str, signals_e: Array) -> list[Frames]:
        mean_e = channel_map(signals_e, layout, shape)
        return [
            read_linear(mean_e, time_s, sensor, stream("datasheet", experiment.seed, name, index))
            for index in range(PAIRS)
        ]

    def means(frames: list[Frames]) -> tuple[Array, Array]:
        """Means of the channels, and their variances."""
        total = np.sum(frames, axis=0, dtype=float)
        squares = np.square((frames[0] - frames[1]).astype(float))
        mean = np.bincount(numbers.ravel(), total.ravel()) / counts / PAIRS
        variance = np.bincount(numbers.ravel(), squares.ravel()) / counts / 2
        return mean, variance / counts / PAIRS

    dark, dark_variance = means(capture("colour dark", np.zeros(len(layout.channels))))
    fields = [
        means(capture(f"patch {index}", truth.white_e * response))
        for index, response in enumerate(truth.colour_chart.responses)
    ]
    white, white_variance = means(capture("white", truth.white_e))
    signal = white - dark
    error = np.sqrt(white_variance + dark_variance)
    faint = np.flatnonzero(signal <= _MIN_WHITE_SIGMAS * np.maximum(error, _ROUNDING_DN))
    if faint.size:
        first = int(faint[0])
        got = (
            f"white of {signal[first]:.3g} DN with a standard error of {error[first]:.2g} DN in"
            f" channel {layout.channels[first]}"
        )
        hint = (
            "Its filter or quantum efficiency passes too little of D55. Otherwise use more pixels,"
            " bits or gain."
        )
        raise invalid(
            "colour", got, f"more than {_MIN_WHITE_SIGMAS:g} standard errors in each channel", hint
        )

    grey = capture("grey field", GREY * truth.white_e)
    difference = (grey[0] - grey[1]) / math.sqrt(2)
    min_count = int(counts.min())
    return Colour(
        readout,
        time_s,
        truth,
        patches_dn=np.array([mean - dark for mean, _ in fields]),
        patches_error_dn=np.sqrt([variance + dark_variance for _, variance in fields]),
        white_dn=signal,
        white_error_dn=error,
        gain_error=gain_spread / np.sqrt(counts),
        grey_dn=means(grey)[0] - dark,
        grey_noise_dn=np.stack(
            [difference[numbers == number][:min_count] for number in range(len(counts))], axis=1
        ),
        seed=experiment.seed,
    )
