"""A pixel's data sheet: one simulated device measured as in EMVA 1288, ISO 15739 and ISO 12232,
next to the true values.

The closed forms of `pixsim.sensor` hold up to 6 σ below the full well. Close to the full well this
module integrates numerically over shot noise, reset and read noise, and the spread of gain and
offset between pixels.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.bounds import Positive, Whole
from pixsim.base.caller import setting
from pixsim.base.digits import rounded
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.layers import listed
from pixsim.base.lazy import cached_property
from pixsim.base.progress import Stage, no_stage
from pixsim.base.result import Result
from pixsim.base.tables import plain
from pixsim.base.toml import read_toml
from pixsim.measure import colour as colours, estimators
from pixsim.measure.colour import Colour, measure_colour
from pixsim.measure.estimators import (
    QUANTISATION_DN2,
    CharacteristicCurve,
    Estimate,
    FrameStack,
    Linearity,
    Pair,
    PairSeries,
    PhotonTransfer,
    RowNoise,
    root,
)
from pixsim.measure.experiment import Experiment, make_experiment
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.noise import constant_e, signal_at_snr_e, variance_e2
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.reading import Readout, with_merge
from pixsim.sensor.readout import frame_variance_dn2
from pixsim.sensor.saturation import level_moments, peak_e
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import packaged_sensors, run_settings
from pixsim.viewer.without_effect import (
    TABLES,
    UserSettings,
    field_names,
    warn_of_settings_without_effect,
)

# Of light at saturation: below it, most frames of uniform light have one code and no noise.
_MIN_NOISE_DN = 0.1
_GREY_FRAMES = 16  # ISO 15739 requires at least 8
_GREY_SHARE = 0.13  # of saturation: the reference level of ISO 15739, section 6.3


def expected_moments(mean_e: float, integration_s: float, readout: Readout) -> tuple[float, float]:
    """Return mean (DN) and mean temporal variance (DN²) over the pixels at `mean_e`
    photo-electrons, with 1/12 DN² of the quantiser.

    Shot noise is approximated by a normal distribution, as in `pixsim.sensor.saturation`.
    """
    p = readout
    mean, variance = level_moments(
        mean_e,
        p.dark_current_e_per_s * integration_s,
        p.adc_range_e,
        lambda generated: stored_signal_e(generated, integration_s, p),
        noise_e=p.noise_floor_e,
        gain_spread=p.prnu,
        offset_spread_e=p.offset_e,
    )
    return mean * p.dn_per_e + p.adc.black_level_dn, variance * p.dn_per_e**2 + 1 / 12


def _expected_curve(mean_e: Array, integration_s: float, readout: Readout) -> tuple[Array, Array]:
    """`expected_moments` at (n,) signals: (n,) means (DN) and (n,) temporal variances (DN²)."""
    mean, variance = np.array(
        [expected_moments(electrons, integration_s, readout) for electrons in mean_e.tolist()]
    ).T
    return mean, variance


def variance_peak_e(readout: Readout, integration_s: float, brightest_e: float) -> float:
    """Mean photo-electrons at which the temporal variance peaks: the saturation of EMVA 1288."""
    return peak_e(
        lambda electrons: expected_moments(electrons, integration_s, readout)[1], brightest_e
    )


def _row_noise(experiment: Experiment) -> RowNoise:
    """Temporal noise that the pixels of a row of the device share, by the pixel's parameters."""
    readout = experiment.readout
    return RowNoise(
        (readout.dn_per_e * constant_e(readout, is_temporal=True, along="row")) ** 2,
        experiment.sensor.shape[0],
    )


def dark_map_e(experiment: Experiment) -> Array:
    """(rows, columns) mean dark signal of the device's pixels: pixel offsets, column offsets and
    dark charge, e-.
    """
    sensor = experiment.sensor
    map_e = np.zeros(sensor.shape)
    if sensor.dark_gain is not None:
        dark_e = experiment.readout.dark_current_e_per_s * experiment.integration_s
        map_e = map_e + sensor.dark_gain * dark_e
    for offset_e in (sensor.offset_e, sensor.column_offset_e):
        if offset_e is not None:
            map_e = map_e + offset_e
    return map_e


@dataclass(frozen=True)
class DataSheet(Result):
    """The frames' statistics of one device, the estimates from them, and the true values.

    experiment : the device and its exposures
    light : series over photons per pixel
    dim : the same below its first exposure, for S/N
    dark : a pair without light
    dark_series : over seconds
    warm : dark series by temperature in K
    dark_stack, bright_stack : at 0 and 50 % of saturation
    grey : (frames, rows, columns) at 13 % of saturation, DN
    grey_photons, bright_photons : per pixel, of `grey` and `bright_stack`
    channels : of a colour sensor, the light series of its other channels
    output : of the characteristic curve, over photons per pixel, the first pair dark; or None
    colour : fields of a chart on a colour sensor; its problem in words if their colours cannot be
        told apart, or None if monochrome
    """

    experiment: Experiment = field(repr=False)
    light: PairSeries = field(repr=False)
    dim: PairSeries = field(repr=False)
    dark: Pair
    dark_series: PairSeries = field(repr=False)
    warm: dict[float, PairSeries] = field(repr=False)
    dark_stack: FrameStack = field(repr=False)
    bright_stack: FrameStack = field(repr=False)
    grey: Array = field(repr=False)
    grey_photons: float
    bright_photons: float
    channels: dict[str, tuple[Experiment, PhotonTransfer]] = field(default_factory=dict, repr=False)
    colour: Colour | str | None = None
    output: PairSeries | None = field(default=None, repr=False)

    @property
    def pixels(self) -> int:
        """Number of pixels of the device."""
        return math.prod(self.experiment.sensor.shape)

    @cached_property
    def transfer(self) -> PhotonTransfer:
        """Gain, responsivity, dark noise and saturation from the light series."""
        # NaN: too small to be seen.
        spread = 0.0 if math.isnan(self.prnu.value) else self.prnu.value
        return estimators.photon_transfer(
            self.light,
            self.dark.mean_dn,
            self.dark.variance_dn2,
            self.pixels,
            spread,
            _row_noise(self.experiment),
        )

    @property
    def signal_dn(self) -> Array:
        """(n,) mean signals of the light series minus the dark, DN."""
        return self.light.mean_dn - self.dark.mean_dn

    @property
    def rising(self) -> PairSeries:
        """`dim`, followed by `light` up to saturation."""
        end = self.transfer.saturation_index + 1
        return PairSeries(
            *(
                np.concatenate([dim, light[:end]])
                for dim, light in zip(self.dim, self.light, strict=True)
            )
        )

    @cached_property
    def linearity(self) -> Linearity:
        """Deviation of the light series from a straight line."""
        return estimators.linearity(self.light.at, self.signal_dn, self.transfer.saturation_index)

    @cached_property
    def dsnu_e(self) -> Estimate:
        """Dark signal non-uniformity of EMVA 1288."""
        return estimators.dsnu_e(self.dark_stack, self.transfer.gain_dn_per_e)

    @cached_property
    def prnu(self) -> Estimate:
        """Photo response non-uniformity of EMVA 1288, a fraction of the signal."""
        return estimators.prnu(self.dark_stack, self.bright_stack)

    @cached_property
    def dark_currents(self) -> tuple[Estimate, Estimate]:
        """Dark current from the mean and from the variance, e-/s."""
        return estimators.dark_current(
            self.dark_series, self.transfer.gain_dn_per_e, self.pixels, _row_noise(self.experiment)
        )

    @cached_property
    def warm_currents(self) -> tuple[Array, list[Estimate]]:
        """(temperatures in K, dark currents from the mean); their errors exclude the error of K,
        which they share.
        """
        gain = Estimate(self.transfer.gain_dn_per_e.value)
        currents = [
            estimators.dark_current(warm, gain, self.pixels, _row_noise(self.experiment))[0]
            for warm in self.warm.values()
        ]
        return np.array(list(self.warm)), currents

    @property
    def true_dark_noise_e(self) -> float:
        """Temporal dark noise by the pixel's parameters."""
        p = self.experiment.readout
        return math.sqrt(
            variance_e2(p, is_temporal=True)
            + p.dark_current_e_per_s * self.experiment.integration_s
        )

    @cached_property
    def true_prnu(self) -> float:
        """PRNU1288 of the device's maps, a fraction of the signal.

        It differs from the spread of the gain by its correlation with the dark map.
        """
        if self.experiment.sensor.gain is None:
            return 0.0
        dark = dark_map_e(self.experiment)
        light = self.bright_photons * self.experiment.efficiency * self.experiment.sensor.gain
        variance_e2 = max((light + dark).var(ddof=1) - dark.var(ddof=1), 0.0)
        return math.sqrt(variance_e2) / float(light.mean())

    @cached_property
    def expected(self) -> tuple[Array, Array]:
        """(n,) signals (DN) and (n,) temporal variances (DN²) of the light series by the model,
        minus those in the dark.
        """
        e = self.experiment
        mean, variance = _expected_curve(e.photons * e.efficiency, e.integration_s, e.readout)
        dark_mean, dark_variance = _expected_curve(np.zeros(1), e.integration_s, e.readout)
        return mean - dark_mean, variance - dark_variance

    @cached_property
    def true_linearity(self) -> Linearity:
        """Deviation of the model's mean signals from a straight line."""
        return estimators.linearity(
            self.experiment.photons, self.expected[0], self.transfer.saturation_index
        )

    @cached_property
    def curve(self) -> CharacteristicCurve | None:
        """The characteristic curve of EMVA 1288 General, if it was measured."""
        if self.output is None:
            return None
        row_noise = _row_noise(self.experiment)
        if self.experiment.is_merged:
            row_noise = row_noise.in_electrons(self.experiment.readout.dn_per_e)
        return estimators.characteristic_curve(self.output, self.pixels, row_noise)

    def true_snr(self, photons: Array, *, total: bool = False) -> Array:
        """Return the signal-to-noise ratio by the closed form of all readings at photons per pixel,
        (n,), which holds below saturation.

        total : with the fixed pattern
        """
        e = self.experiment
        readout = e.whole.readout
        signal_e = photons * e.efficiency
        variance_dn2 = frame_variance_dn2(signal_e, e.integration_s, readout, total)
        return np.asarray(signal_e * readout.dn_per_e / np.sqrt(variance_dn2))

    @cached_property
    def true_saturation_p(self) -> float:
        """Number of photons per pixel at which the expected variance of the last reading peaks."""
        e = self.experiment
        assert self.output is not None
        last = with_merge(e.whole.readout).readings[-1]
        e_per_photon = last.response * e.efficiency
        brightest_e = e_per_photon * float(self.output.at[-1])
        return variance_peak_e(last.readout, e.integration_s, brightest_e) / e_per_photon

    @property
    def full_in_the_dark(self) -> float:
        """The fraction of hot pixels whose dark charge alone saturates them at the longest time of
        the dark series.
        """
        e = self.experiment
        p = self.experiment.readout
        if e.sensor.dark_gain is None or not e.physics.hot_pixel_fraction:
            return 0.0
        charge_e = e.sensor.dark_gain * (p.dark_current_e_per_s * float(self.dark_series.at[-1]))
        return float(np.mean(charge_e > p.saturation_e))

    @cached_property
    def entries(self) -> list[Entry]:
        """All lines of the data sheet, grouped by standard."""
        return [
            *_sensitivity_entries(self),
            *_channel_entries(self),
            *_spatial_entries(self),
            *_dark_entries(self),
            *_noise_entries(self),
            *_speed_entries(self),
            *_colour_entries(self),
            *_general_entries(self),
        ]

    def __repr__(self) -> str:
        physics = self.experiment.physics
        t = self.transfer
        values = (
            f"K {t.gain_dn_per_e.value:.3g} DN/e-, η {100 * t.efficiency.value:.3g} %, σ_d"
            f" {t.dark_noise_e.value:.3g} e-"
        )
        return (
            f"<DataSheet of {physics.pitch_um:g} µm pixels: {values}, μ_e.sat"
            f" {rounded(t.saturation_e.value, 4)} e->"
        )


def datasheet(
    file: str | os.PathLike[str] | None = None,
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    pixel: Pixel | Mapping[str, Any] | None = None,
    exposure: Exposure | Mapping[str, Any] | None = None,
    wavelength_nm: Positive | None = None,
    seed: Whole | None = None,
    general: bool = False,
    progress: Stage | None = None,
) -> DataSheet:
    """Measure one simulated sensor of a pixel by EMVA 1288, ISO 15739 and ISO 12232, beside the
    true values.

    file : a TOML file with a table [pixel], such as a data sheet; the file of a technology, or the
        name of a packaged one
    config : one or more TOML files with [pixel] and [exposure]; later ones take precedence
    pixel : a Pixel, or fields of one, each in its unit, which override the files
    exposure : integration time of the light series and gain of all frames, as an Exposure or its
        fields; by default 30 ms, or less where the dark current is high
    wavelength_nm : of the light; by default the peak of the response
    seed : of the sensor and its noise, by default as in `config`, or 0
    general : whether to measure by EMVA 1288 General, too: the characteristic curve, and SNR at
        its input. Pixels of several readings and companded codes need it
    progress : returns a callback for each named stage

    Raises PixsimError for invalid input, and if the pixel's codes are so coarse that no frame shows
    noise.

    >>> sheet = datasheet("0.35um", pixel={"pitch_um": 6.5, "bits": 12})
    >>> gain = next(entry for entry in sheet.entries if entry.symbol == "K")
    >>> abs(gain.measured - gain.true) < 4 * gain.standard_error
    True
    """
    settings = datasheet_settings(file, config, pixel, exposure, seed)
    return make_datasheet(
        settings.pixel,
        settings.exposure,
        stage=progress,
        wavelength_nm=wavelength_nm,
        seed=settings.seed,
        general=general,
    )


# A data sheet is measured on single raw exposures of uniform light. Camera and lens stand in a
# sensor's file for other commands.
UNUSED_SETTINGS = (
    *(name for name in Run.model_fields if name not in (*TABLES, "seed")),
    *field_names("exposure", Exposure, "integration_s", "gain_db"),
    *(
        "lens.veiling_glare",
        "lens.veiling_glare_outside",
        "motion",
        "correction",
        "develop",
        "display",
        "pixel.registration",
    ),
)


def datasheet_settings(
    file: str | os.PathLike[str] | None,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    pixel: Pixel | Mapping[str, Any] | None,
    exposure: Exposure | Mapping[str, Any] | None,
    seed: int | str | None,
) -> Run:
    """Return the settings of `datasheet`, whose arguments these are. Raises PixsimError that lists
    all problems.

    Warns of settings that a data sheet does not take.
    """
    files = listed(config)
    if isinstance(pixel, Pixel) and (
        given_files := [name for name, value in (("file", file), ("config", files)) if value]
    ):
        raise invalid(
            ", ".join(given_files),
            "with a Pixel",
            "fields of a pixel together with a file",
            "Set these values in the Pixel instead.",
        )

    name = None if file is None else os.fspath(file)
    if name is not None and (
        name in packaged_sensors() or (name.endswith(".toml") and "pixel" in read_toml(Path(name)))
    ):
        files.insert(0, name)
    elif name is not None:
        fields = dict(pixel or {})
        if "technology" in fields:
            raise PixsimError(
                f"pixel: got '{name}' and {setting('pixel.technology', fields['technology'])}; give"
                " only one of them."
            )
        pixel = fields | {"technology": name}

    options = {"pixel": pixel or None, "exposure": exposure, "seed": seed}
    settings = run_settings(
        files, {name: value for name, value in options.items() if value is not None}
    )
    imaging = Imaging.of(settings, Camera())
    stated = UserSettings.from_setting(
        imaging, settings, not_taken=UNUSED_SETTINGS, makes_frames=False
    )
    warn_of_settings_without_effect({"": [stated]})
    return settings


def make_datasheet(
    pixel: Pixel, exposure: Exposure | None = None, *, stage: Stage | None = None, **options: Any
) -> DataSheet:
    """Measure one simulated device of a pixel.

    options : keywords of `make_experiment`, which raises PixsimError
    """
    return measure(make_experiment(pixel, exposure, **options), stage, options.get("wavelength_nm"))


def measure(
    experiment: Experiment, stage: Stage | None = None, wavelength_nm: float | None = None
) -> DataSheet:
    """Capture every frame of the experiment and return its data sheet; `stage` receives the
    progress.

    wavelength_nm : of the light on the other channels of a colour sensor, by default the peak of
        each

    Raises PixsimError if codes are so coarse that no frame shows noise.
    """
    report_progress = stage or no_stage
    p = experiment.readout
    largest_dn2 = (
        float(frame_variance_dn2(p.saturation_e, experiment.integration_s, p, fixed_pattern=False))
        - QUANTISATION_DN2
    )
    if largest_dn2 < _MIN_NOISE_DN**2:
        got = (
            f"{p.adc.bits}: a code is {1 / p.dn_per_e:.3g} e-, and hides the noise of light, from"
            " which K is measured"
        )
        allowed = (
            f"codes of at most {1 / _MIN_NOISE_DN:g} standard deviations of the temporal noise at"
            " saturation"
        )
        raise invalid("pixel.bits", got, allowed, "Use more bits, or a smaller full well.")

    def pairs(
        name: str, photons: Array, frames: Callable[..., Iterator[NDArray[Any]]] = experiment.frames
    ) -> PairSeries:
        report_fraction = report_progress(name)
        measured = []
        for index, level in enumerate(photons.tolist()):
            first, second = frames(2, level, name, index)
            measured.append(estimators.pair(first, second))
            report_fraction((index + 1) / photons.size)
        return estimators.series(photons, measured)

    light = pairs("light series", experiment.photons)
    dim = pairs("dim light", experiment.dim_photons)

    report_progress("stacks")
    saturation = float(light.at[estimators.saturation_index(light.variance_dn2)])
    bright = saturation / 2
    grey = _GREY_SHARE * saturation
    count = experiment.stack_frames
    dark_stack = estimators.stack(experiment.frames(count, 0.0, "dark stack"))
    bright_stack = estimators.stack(experiment.frames(count, bright, "bright stack"))

    pixels = math.prod(experiment.sensor.shape)
    measured_prnu = estimators.prnu(dark_stack, bright_stack).value
    spread = 0.0 if math.isnan(measured_prnu) else measured_prnu
    dark = estimators.pair(*experiment.frames(2, 0.0, "dark"))
    layout = experiment.physics.layout
    letters = [] if layout is None else list(layout.channels)
    channels: dict[str, tuple[Experiment, PhotonTransfer]] = {}
    for letter in letters:
        if letter == experiment.physics.channel:
            continue
        channel_experiment = experiment.for_channel(letter, wavelength_nm)
        channel_light = pairs(
            f"channel {letter}", channel_experiment.photons, channel_experiment.frames
        )
        row_noise = _row_noise(channel_experiment)
        transfer = estimators.photon_transfer(
            channel_light, dark.mean_dn, dark.variance_dn2, pixels, spread, row_noise
        )
        channels[letter] = channel_experiment, transfer

    output = None
    if experiment.general_photons is not None:
        output = pairs("characteristic", experiment.general_photons, experiment.outputs)

    report_progress("dark series")
    return DataSheet(
        experiment,
        light=light,
        dim=dim,
        dark=dark,
        dark_series=experiment.dark_series(),
        warm={
            temperature_k: experiment.dark_series(temperature_k)
            for temperature_k in experiment.temperatures_k
        },
        dark_stack=dark_stack,
        bright_stack=bright_stack,
        grey=np.stack([*experiment.frames(_GREY_FRAMES, grey, "grey")]).astype(float),
        grey_photons=grey,
        bright_photons=bright,
        channels=channels,
        colour=_colour(experiment, spread),
        output=output,
    )


def _colour(experiment: Experiment, gain_spread: float) -> Colour | str | None:
    """Measure the colour of a sensor; return a sentence if its filters do not distinguish colours,
    None if it has none.
    """
    if experiment.physics.layout is None:
        return None
    try:
        return measure_colour(experiment, gain_spread)
    except PixsimError as error:
        return str(error)


EMVA = "EMVA 1288"
GENERAL = "EMVA 1288 General"
NOISE = "ISO 15739"
SPEED = "ISO 12232"
COLOUR = f"ISO 17321-1 and noise in colour, illuminant {colours.LAMP}"
_ROUNDING = 1e-9
_PRIMARIES = "red", "green", "blue"
_SPLIT_SOURCE = "from this device's maps, split in the same way"
_SPATIAL_PARTS = ("of columns", "col"), ("of rows", "row"), ("of single pixels", "pixel")


@dataclass(frozen=True)
class Entry:
    """A line of a data sheet.

    standard, quantity, symbol, unit : as in summary.json; the unit is empty for a ratio
    measured : on the frames; NaN if it is not available, and so are the next two
    standard_error : of it
    true : by the pixel's parameters, or by the device's maps
    true_is : the source of the true value
    note : limits of the measured value
    """

    standard: str
    quantity: str
    symbol: str
    unit: str
    measured: float
    standard_error: float
    true: float
    true_is: str
    note: str = ""

    @property
    def off(self) -> float:
        """Relative deviation, measured/true - 1; NaN if there is no true value or it is 0 within
        rounding.
        """
        has_true = abs(self.true) > _ROUNDING * abs(self.measured)
        return self.measured / self.true - 1 if has_true else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Return the line for JSON, with None for NaN and infinity."""
        return plain(asdict(self) | {"off": self.off})


def _entry(
    standard: str,
    name: str,
    symbol: str,
    unit: str,
    measured: Estimate,
    true: float,
    source: str,
    note: str = "",
) -> Entry:
    """Return an entry of a measured value beside the true one, whose source is stated in words."""
    return Entry(standard, name, symbol, unit, measured.value, measured.error, true, source, note)


_emva_entry = partial(_entry, EMVA)
_general_entry = partial(_entry, GENERAL)
_noise_entry = partial(_entry, NOISE)
_speed_entry = partial(_entry, SPEED)
_colour_entry = partial(_entry, COLOUR)


def _decibel(ratio: Estimate) -> Estimate:
    """20 log₁₀ of a ratio, dB."""
    return Estimate(20 * math.log10(ratio.value), 20 / math.log(10) * ratio.error / ratio.value)


def _sensitivity_entries(sheet: DataSheet) -> list[Entry]:
    """Gain, quantum efficiency, dark noise, saturation, SNR, dynamic range and linearity."""
    t = sheet.transfer
    e = sheet.experiment
    p = e.readout
    true = sheet.true_linearity
    eta = e.efficiency
    dn2 = p.dn_per_e**2
    saturation_e = variance_peak_e(p, e.integration_s, float(e.photons[-1]) * eta)
    dark_dn2 = sheet.true_dark_noise_e**2 * dn2 + QUANTISATION_DN2
    threshold_e = math.sqrt(dark_dn2 / dn2) + 0.5
    limited = "quantisation-limited: an upper bound" if t.limited else ""
    step = "standard error: one exposure step"
    peak = "peak of the model's expected variance"
    straight = e.pixel.conversion == "linear" and e.pixel.well_limit == "swing"
    span = "full well" if e.pixel.adc_full_scale_e is None else "adc_full_scale_e"
    gain_source = (
        f"(2^bits - 1 - black) / {span}" if p.adc.gain_e_per_dn is None else "1 / gain_e_per_dn"
    )
    gain_source += f" · 10^({p.gain_db:g} dB / 20)" if p.gain_db else ""
    line_source = "straight line" if straight else "the model's expected curve"
    return [
        _emva_entry("overall system gain", "K", "DN/e-", t.gain_dn_per_e, p.dn_per_e, gain_source),
        _emva_entry("responsivity", "R", "DN/p", t.responsivity_dn_per_p, p.dn_per_e * eta, "K η"),
        _emva_entry(
            "quantum efficiency",
            "η",
            "%",
            t.efficiency * 100,
            100 * eta,
            "QE(λ) · fill factor, for the whole pixel",
        ),
        _emva_entry(
            "temporal dark noise",
            "σ_d",
            "e-",
            t.dark_noise_e,
            sheet.true_dark_noise_e,
            "√(reset² + read² + dark)",
            limited,
        ),
        _emva_entry(
            "absolute sensitivity threshold",
            "μ_p.min",
            "p",
            t.threshold_p,
            threshold_e / eta,
            "(√(σ_d² + σ_q²/K²) + ½) / η",
            limited,
        ),
        _emva_entry(
            "absolute sensitivity threshold",
            "μ_e.min",
            "e-",
            t.threshold_e,
            threshold_e,
            "η μ_p.min",
            limited,
        ),
        _emva_entry(
            "saturation capacity", "μ_p.sat", "p", t.saturation_p, saturation_e / eta, peak, step
        ),
        _emva_entry(
            "saturation capacity", "μ_e.sat", "e-", t.saturation_e, saturation_e, peak, step
        ),
        _emva_entry(
            "maximum signal-to-noise ratio",
            "SNR_max",
            "dB",
            _decibel(t.snr_max),
            10 * math.log10(saturation_e),
            "√μ_e.sat",
        ),
        _emva_entry(
            "dynamic range",
            "DR",
            "dB",
            _decibel(t.dynamic_range),
            20 * math.log10(saturation_e / threshold_e),
            "μ_p.sat / μ_p.min",
            limited,
        ),
        _emva_entry(
            "linearity error, mean",
            "LE",
            "%",
            _linearity_estimate(sheet, "error"),
            100 * true.error,
            line_source,
        ),
        _emva_entry(
            "linearity error, lowest",
            "LE_min",
            "%",
            _linearity_estimate(sheet, "lowest"),
            100 * true.lowest,
            line_source,
        ),
        _emva_entry(
            "linearity error, highest",
            "LE_max",
            "%",
            _linearity_estimate(sheet, "highest"),
            100 * true.highest,
            line_source,
        ),
    ]


def _channel_entries(sheet: DataSheet) -> list[Entry]:
    """Responsivity, quantum efficiency, threshold and saturation of the other channels of a colour
    sensor.
    """
    lines = []
    for letter, (e, t) in sheet.channels.items():
        k = e.readout.dn_per_e
        eta = e.efficiency
        channel_words = f"channel {letter}, {e.wavelength_nm:g} nm"
        dark_e = math.sqrt(sheet.true_dark_noise_e**2 + QUANTISATION_DN2 / k**2)
        saturation_e = variance_peak_e(e.readout, e.integration_s, float(e.photons[-1]) * eta)
        lines += [
            _emva_entry(
                f"responsivity, {channel_words}",
                f"R_{letter}",
                "DN/p",
                t.responsivity_dn_per_p,
                k * eta,
                "K η",
            ),
            _emva_entry(
                f"quantum efficiency, {channel_words}",
                f"η_{letter}",
                "%",
                t.efficiency * 100,
                100 * eta,
                "QE(λ) · fill factor, for the whole pixel",
            ),
            _emva_entry(
                f"sensitivity threshold, {channel_words}",
                f"μ_p.min.{letter}",
                "p",
                t.threshold_p,
                (dark_e + 0.5) / eta,
                "(√(σ_d² + σ_q²/K²) + ½) / η",
                "quantisation-limited: an upper bound" if t.limited else "",
            ),
            _emva_entry(
                f"saturation capacity, {channel_words}",
                f"μ_p.sat.{letter}",
                "p",
                t.saturation_p,
                saturation_e / eta,
                "peak of the model's expected variance",
                "standard error: one exposure step",
            ),
        ]
    return lines


def _colour_entries(sheet: DataSheet) -> list[Entry]:
    """SMI, noise gains of the colour matrix, white balance, and SNR of luminance and chrominance of
    a colour sensor.
    """
    c = sheet.colour
    if not isinstance(c, Colour):
        return []
    true = c.truth.colour_chart
    row = "norm of the row of the matrix from balanced channels to the display's linear light"
    gains = [
        (name, partial(colours.noise_gain, primary=index)) for index, name in enumerate(_PRIMARIES)
    ]
    balance = zip(c.channels, c.white_balance, c.true_white_balance.tolist(), strict=True)
    grey = "from the parameters: 18 % grey with white at 72 % of saturation"
    lines = [
        _colour_entry(
            "sensitivity metamerism index",
            "SMI",
            "",
            c.estimate(colours.smi),
            colours.smi(true),
            "100 - 5.5 · mean ΔE*ab of patches 1-18, least mean ΔE",
        ),
        *(
            _colour_entry(
                f"noise gain of {name}",
                f"G_{name[0].upper()}",
                "",
                c.estimate(gain),
                gain(true),
                row,
            )
            for name, gain in gains
        ),
        *(
            _colour_entry(
                f"white balance, channel {letter}",
                f"WB_{letter}",
                "",
                gain,
                true_gain,
                "largest signal of white over it",
            )
            for letter, gain, true_gain in balance
        ),
    ]
    names = (
        ("signal over noise of luminance", "SNR_Y", "Y"),
        ("signal over noise of chrominance", "SNR_C", "R - Y and B - Y together"),
    )
    for (name, symbol, noise), measured, expected in zip(names, c.snr(), c.true_snr(), strict=True):
        lines.append(
            _colour_entry(
                name,
                symbol,
                "dB",
                _decibel(measured),
                20 * math.log10(expected),
                f"{grey}; temporal noise of {noise}",
            )
        )

    return lines


def _linearity_estimate(sheet: DataSheet, name: str) -> Estimate:
    """A linearity error in per cent; its standard error is the mean (LE) or largest one of the
    fitted signals.
    """
    within = sheet.linearity.within
    variance_dn2 = sheet.light.variance_dn2[within]
    errors = np.sqrt(variance_dn2 / (2 * sheet.pixels)) / sheet.signal_dn[within]
    error = float(errors.mean() if name == "error" else errors.max())
    return Estimate(100 * getattr(sheet.linearity, name), 100 * error)


def _spatial_entries(sheet: DataSheet) -> list[Entry]:
    """DSNU1288, its parts from columns, rows and single pixels (0 if the variance estimate is not
    positive), and PRNU1288.
    """
    p = sheet.experiment.readout
    map_e = dark_map_e(sheet.experiment)
    k = sheet.transfer.gain_dn_per_e
    dark_e = p.dark_current_e_per_s * sheet.experiment.integration_s
    nominal = math.sqrt(variance_e2(p, dark_e=dark_e, is_temporal=False))
    dsnu = (
        "from this device's maps; the parameters give √(offset² + column² + (σ_DSNU · dark)²) ="
        f" {nominal:.4g}"
    )
    gain_source = f"from this device's maps; the parameters give {100 * p.prnu:.4g}"
    true_parts = estimators.spatial_parts(FrameStack(1, map_e, np.zeros_like(map_e)))

    # A mean of frames keeps a part of their row noise, which EMVA 1288 takes for a fixed pattern.
    left_e2 = constant_e(p, is_temporal=True, along="row") ** 2 / sheet.dark_stack.frames
    true_e2 = [
        replace(part, value=part.value + left_e2 * (name == "of rows"))
        for part, (name, _) in zip(true_parts, _SPATIAL_PARTS, strict=True)
    ]
    measured = estimators.spatial_parts(sheet.dark_stack, _row_noise(sheet.experiment))
    split = zip(_SPATIAL_PARTS, measured, true_e2, strict=True)
    row_source = f"{_SPLIT_SOURCE}, and the row noise that {sheet.dark_stack.frames} frames leave"
    return [
        _emva_entry(
            "dark signal non-uniformity",
            "DSNU_1288",
            "e-",
            sheet.dsnu_e,
            float(map_e.std(ddof=1)),
            dsnu,
        ),
        *(
            _emva_entry(
                f"DSNU, {name}",
                f"DSNU_1288.{short}",
                "e-",
                root(variance, 0.0) / k,
                root(true, 0.0).value,
                row_source if left_e2 and name == "of rows" else _SPLIT_SOURCE,
            )
            for (name, short), variance, true in split
        ),
        _emva_entry(
            "photo response non-uniformity",
            "PRNU_1288",
            "%",
            sheet.prnu * 100,
            100 * sheet.true_prnu,
            gain_source,
        ),
    ]


def _doubling_from(physics: PixelPhysics) -> str:
    if physics.pixel.dark_current and physics.pixel.dark_current.doubling_k:
        return "pixel.dark_current.doubling_k"
    if physics.technology.name == NO_TECHNOLOGY:
        return "assumed, as for silicon"
    return "from the technology file"


def _dark_entries(sheet: DataSheet) -> list[Entry]:
    """Dark current from the mean and from the variance, and its doubling temperature."""
    p = sheet.experiment.physics
    from_mean, from_variance = sheet.dark_currents
    current = sheet.experiment.readout.dark_current_e_per_s
    gain = sheet.experiment.sensor.dark_gain
    unit = "e-/s"
    source = f"mean of the pixels at {p.pixel.temperature_k:g} K"
    if p.hot_pixel_fraction and gain is not None:
        # Few pixels have much of it: the mean of a device differs from the stated one.
        source = (
            f"mean of this device's pixels at {p.pixel.temperature_k:g} K; the parameters give"
            f" {current:.4g}"
        )
        current *= float(gain.mean())

    entries = [
        _emva_entry("dark current, from the mean", "μ_I.mean", unit, from_mean, current, source),
        _emva_entry(
            "dark current, from the variance", "μ_I.var", unit, from_variance, current, source
        ),
    ]
    temperatures, warm = sheet.warm_currents
    if warm and current:
        values, errors = np.array([(current.value, current.error) for current in warm]).T
        doubling = estimators.doubling_k(temperatures, values, errors)
        name = "doubling temperature of the dark current"
        true_k = p.dark_doubling_k
        entries.append(_emva_entry(name, "ϑ_d", "K", doubling, true_k, _doubling_from(p)))

    return entries


def mean_offset_e(experiment: Experiment) -> float:
    """Mean offset of the device's pixels; with few columns it need not be 0."""
    offsets = experiment.sensor.offset_e, experiment.sensor.column_offset_e
    return float(sum(offset.mean() for offset in offsets if offset is not None))


def _highest_dn(experiment: Experiment) -> float:
    """Full scale of the device in DN: the ADC's top code, or the level of a full well below it."""
    p = experiment.readout
    full_e = p.full_well_e + mean_offset_e(experiment)
    if p.adc_range_e <= full_e:
        return float(p.adc.top_code_dn)
    return p.adc.black_level_dn + full_e * p.dn_per_e


def _largest_light_e(experiment: Experiment) -> float:
    """Mean photo-electrons at the full scale of the device: well or ADC range, less its mean dark
    charge and offset.
    """
    p = experiment.readout
    gain = experiment.sensor.dark_gain
    mean_gain = 1.0 if gain is None else float(gain.mean())
    dark_e = p.dark_current_e_per_s * experiment.integration_s * mean_gain
    return min(p.full_well_e, p.adc_range_e - mean_offset_e(experiment)) - dark_e


def _noise_entries(sheet: DataSheet) -> list[Entry]:
    """ISO 15739: noise and S/N at 13 % of saturation, and dynamic range."""
    e = sheet.experiment
    p = e.readout
    k = p.dn_per_e
    row_noise = _row_noise(e)
    temporal, fixed, total = estimators.noise_15739(sheet.grey, row_noise)

    # The same by the parameters, and by the maps of the device.
    signal_e = sheet.grey_photons * e.efficiency
    pattern_e = dark_map_e(e) + (0.0 if e.sensor.gain is None else signal_e * e.sensor.gain)
    dark_e = p.dark_current_e_per_s * e.integration_s
    temporal_dn2 = (
        k**2 * float(variance_e2(p, signal_e + dark_e, is_temporal=True)) + QUANTISATION_DN2
    )
    fixed_dn2 = k**2 * float(pattern_e.var(ddof=1))

    row_dn2 = row_noise.variance_dn2
    rows = row_noise.rows
    mean_error_dn = math.sqrt((temporal_dn2 - row_dn2) / sheet.pixels + row_dn2 / rows)
    signal = Estimate(float(sheet.grey.mean()) - sheet.dark.mean_dn, mean_error_dn)
    dark_dn2 = temporal_dn2 - k**2 * signal_e
    independent_frames = sheet.dark_stack.frames - 1
    variance_error_dn2 = float(
        estimators.variance_error(
            dark_dn2, sheet.pixels * independent_frames, row_noise.in_frames(independent_frames)
        )
    )
    dark_noise = Estimate(
        math.sqrt(sheet.dark_stack.temporal_dn2), variance_error_dn2 / (2 * math.sqrt(dark_dn2))
    )
    full_dn = Estimate(_highest_dn(e) - sheet.dark.mean_dn)
    source = "from the parameters, at 13 % of saturation"
    return [
        _noise_entry("temporal noise", "σ_temp", "DN", temporal, math.sqrt(temporal_dn2), source),
        _noise_entry(
            "fixed-pattern noise",
            "σ_fp",
            "DN",
            fixed,
            math.sqrt(fixed_dn2),
            "from this device's maps, at 13 %",
        ),
        _noise_entry(
            "total noise", "σ_total", "DN", total, math.sqrt(temporal_dn2 + fixed_dn2), source
        ),
        _noise_entry(
            "signal over total noise at 13 %",
            "Q",
            "dB",
            _decibel(signal / total),
            20 * math.log10(k * signal_e / math.sqrt(temporal_dn2 + fixed_dn2)),
            "from the parameters and this device's maps",
        ),
        _noise_entry(
            "dynamic range",
            "DR_ISO",
            "dB",
            _decibel(full_dn / dark_noise),
            20 * math.log10(k * _largest_light_e(e) / math.sqrt(dark_dn2)),
            "full scale over temporal dark noise",
            "quantisation-limited: the codes hide the noise" if sheet.transfer.limited else "",
        ),
    ]


def _speed_entries(sheet: DataSheet) -> list[Entry]:
    """ISO 12232: saturation-based and noise-based speed in daylight (CIE D65)."""
    e = sheet.experiment
    p = e.readout
    rising = sheet.rising
    per_lx_s = estimators.daylight_e_per_lx_s(e.physics)
    lx_s_per_photon = e.efficiency / per_lx_s
    top = Estimate(_highest_dn(e) - sheet.dark.mean_dn)
    filling = top / sheet.transfer.responsivity_dn_per_p * lx_s_per_photon
    daylight = f"CIE D65, {per_lx_s:.4g} e- per lx·s"
    entries = [
        _speed_entry(
            "saturation-based speed",
            "S_sat",
            "",
            Estimate(estimators.SATURATION_SPEED_LX_S) / filling,
            estimators.SATURATION_SPEED_LX_S * per_lx_s / _largest_light_e(e),
            f"78 / H_sat; {daylight}",
        )
    ]

    lx_s = rising.at[:-1] * lx_s_per_photon
    mean = rising.mean_dn[:-1] - sheet.dark.mean_dn
    deviation = np.sqrt(rising.frame_variance_dn2[:-1])
    dark_dn2 = (
        float(dark_map_e(e).var(ddof=1))
        + sheet.true_dark_noise_e**2
        + QUANTISATION_DN2 / p.dn_per_e**2
    )
    for snr in estimators.SIGNAL_TO_NOISE:
        exposure = estimators.exposure_at_snr(
            lx_s, mean, deviation, snr, 1 / math.sqrt(2 * sheet.pixels)
        )
        true_e = signal_at_snr_e(snr, dark_dn2, sheet.true_prnu)
        true = math.nan
        if true_e < p.saturation_e:
            true = estimators.NOISE_SPEED_LX_S * per_lx_s / true_e
        note = "" if math.isfinite(exposure.value) else "not reached below saturation"
        name = f"noise-based speed, S/N {snr:g}"
        speed = Estimate(estimators.NOISE_SPEED_LX_S) / exposure
        entries.append(
            _speed_entry(name, f"S_noise{snr:g}", "", speed, true, f"10 / H_S/N; {daylight}", note)
        )

    return entries


def _general_entries(sheet: DataSheet) -> list[Entry]:
    """EMVA 1288 General: range and largest values of the signal-to-noise ratio at the input."""
    curve = sheet.curve
    if curve is None:
        return []
    true_curve = replace(
        curve,
        snr=sheet.true_snr(curve.photons),
        total_snr=sheet.true_snr(curve.photons, total=True),
    )
    names = {"snr": ("SNR_p", "temporal noise"), "total_snr": ("SNR_total", "total noise")}
    saturation_p = curve.saturation_p
    limited = "quantisation-limited: codes hide the noise" if sheet.transfer.limited else ""
    passing = (
        "the standard error leaves out the few full readings that pass as valid"
        if sheet.experiment.is_merged
        else ""
    )
    entries = [
        _general_entry(
            "saturation",
            "μ_p.sat.general",
            "p",
            saturation_p,
            sheet.true_saturation_p,
            "peak of the model's expected variance of the last reading",
            "standard error: one exposure step",
        )
    ]
    for field_name, (symbol, noise) in names.items():
        snr = getattr(curve, field_name)
        true_snr = getattr(true_curve, field_name)
        threshold_p = curve.threshold_p(snr)
        true_p = true_curve.threshold_p(true_snr).value
        entries += [
            _general_entry(
                f"threshold, {noise}",
                f"μ_p.min.{symbol}",
                "p",
                threshold_p,
                true_p,
                f"{symbol} of the parameters is 1",
                limited,
            ),
            _general_entry(
                f"dynamic range, {noise}",
                f"DR.{symbol}",
                "dB",
                _decibel(saturation_p / threshold_p),
                20 * math.log10(sheet.true_saturation_p / true_p),
                "saturation / threshold",
                limited,
            ),
            _general_entry(
                f"maximum signal-to-noise ratio, {noise}",
                f"{symbol}.max",
                "dB",
                _decibel(curve.largest(snr)),
                _decibel(true_curve.largest(true_snr)).value,
                "largest by the parameters up to saturation",
                passing,
            ),
        ]
    return entries
