"""A pixel's data sheet: one individual measured as EMVA 1288, ISO 15739 and ISO 12232 do, next to what is true.

The closed forms of `pixsim.sensor` hold 6 σ away from the well. Here the sums are taken over what a photon-transfer
experiment meets at the well: shot noise before it, reset and read noise behind it and below the ADC's top code, and pixels
whose gain and offset differ. In the dark the ADC has no codes below 0.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr

from pixsim.base.arrays import Array
from pixsim.base.parameters import Exposure, Pixel
from pixsim.base.progress import Stage
from pixsim.measure.estimators import (
    NOISE_SPEED_LX_S,
    QUANTISATION_DN2,
    SATURATION_SPEED_LX_S,
    SIGNAL_TO_NOISE,
    Estimate,
    Linearity,
    Pair,
    PhotonTransfer,
    Series,
    Stack,
    dark_current,
    daylight_e_per_lx_s,
    doubling_k,
    dsnu_e,
    exposure_at_snr,
    linearity,
    noise_15739,
    pair,
    parts,
    photon_transfer,
    prnu,
    root,
    saturation_index,
    series,
    signal_at_snr_e,
    stack,
)
from pixsim.measure.experiment import Experiment, make_experiment
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import PixelPhysics
from pixsim.show.pages import plain

GREY_FRAMES = 16  # ISO 15739 asks for 8 at least
GREY_SHARE = 0.13  # of the saturation: the reference level of ISO 15739, section 6.3
SHOT_NODES, GAIN_NODES, OFFSET_NODES = 65, 37, 19
WIDEST = 5.0  # σ, of the nodes


def normal_nodes(count: int, sigma: float) -> tuple[Array, Array]:
    """Equally spaced nodes of a normal law and their weights; one where nothing varies."""
    if sigma == 0:
        return np.zeros(1), np.ones(1)
    nodes = np.linspace(-WIDEST, WIDEST, count)
    weights = np.exp(-(nodes**2) / 2)
    return sigma * nodes, weights / weights.sum()


def clipped_moments(mean: Array, sigma: float, top: float) -> tuple[Array, Array]:
    """E[x] and E[x²] of min(normal, top)."""
    if sigma == 0:
        clipped = np.minimum(mean, top)
        return clipped, clipped**2
    reach = (top - mean) / sigma
    below, density = ndtr(reach), np.exp(-(reach**2) / 2) / math.sqrt(2 * math.pi)
    first = mean * below - sigma * density + top * (1 - below)
    second = (mean**2 + sigma**2) * below - sigma * (mean + top) * density + top**2 * (1 - below)
    return first, second


def expected_moments(mean_e: float, integration_s: float, physics: PixelPhysics) -> tuple[float, float]:
    """Mean (DN) and mean temporal variance (DN²) over the pixels, for mean photo-electrons; the quantiser adds 1/12 DN².

    Shot noise is taken for normal. Levels are counted from the full well, so that no digits are lost there.
    """
    p = physics
    gain, gain_weight = normal_nodes(GAIN_NODES, p.prnu)
    offset, offset_weight = normal_nodes(OFFSET_NODES, math.hypot(p.offset_fpn_e, p.column_fpn_e))
    shot, shot_weight = normal_nodes(SHOT_NODES, 1.0)
    charge = np.maximum(1 + gain, 0.0)[:, None] * mean_e + p.dark_current_e_per_s * integration_s
    generated = np.maximum(charge + np.sqrt(charge) * shot, 0.0)
    level = stored_signal_e(generated, integration_s, p)[:, None, :] + offset[:, None] - p.full_well_e
    first, second = clipped_moments(level, math.hypot(p.reset_noise_e, p.read_noise_e), 0.0)
    first, second = first @ shot_weight, second @ shot_weight
    weight = gain_weight[:, None] * offset_weight
    mean = float(np.sum(weight * first)) + p.full_well_e
    variance = float(np.sum(weight * (second - first**2)))
    return mean * p.dn_per_e + p.pixel.black_level_dn, variance * p.dn_per_e**2 + 1 / 12


def expected_curve(mean_e: Array, integration_s: float, physics: PixelPhysics) -> tuple[Array, Array]:
    """`expected_moments` of each of (n,) lights: (n,) means, (n,) temporal variances."""
    mean, variance = np.array([expected_moments(each, integration_s, physics) for each in mean_e.tolist()]).T
    return mean, variance


def variance_peak_e(physics: PixelPhysics, integration_s: float, brightest_e: float, points: int = 200) -> float:
    """Mean photo-electrons at which the temporal variance is highest: the saturation that EMVA 1288 looks for."""
    coarse = np.linspace(0.3, 1.0, 36) * brightest_e
    best = int(np.argmax(expected_curve(coarse, integration_s, physics)[1]))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, coarse.size - 1)]
    fine = np.linspace(low, high, max(points // 8, 5))
    return float(fine[np.argmax(expected_curve(fine, integration_s, physics)[1])])


def gain_map(experiment: Experiment, bright_photons: float) -> float:
    """√(s²_bright - s²_dark)/signal of the individual's own maps: what PRNU1288 stands for, without any noise.

    It differs from the spread of the gain map by what this map and that of the dark happen to have in common.
    """
    sensor = experiment.sensor
    if sensor.gain is None:
        return 0.0
    dark, light = dark_map_e(experiment), bright_photons * experiment.efficiency * sensor.gain
    return math.sqrt(max((light + dark).var(ddof=1) - dark.var(ddof=1), 0.0)) / float(light.mean())


def dark_map_e(experiment: Experiment) -> Array:
    """(rows, columns) what the individual's pixels show in the dark on average: offsets, columns and dark charge, e-."""
    sensor, map_e = experiment.sensor, np.zeros(experiment.sensor.shape)
    if sensor.dark_gain is not None:
        map_e = map_e + sensor.dark_gain * (experiment.physics.dark_current_e_per_s * experiment.integration_s)
    for offset_e in (sensor.offset_e, sensor.column_offset_e):
        if offset_e is not None:
            map_e = map_e + offset_e
    return map_e


@dataclass(frozen=True)
class DataSheet:
    """All that was measured of one individual, its estimates, and what they should be.

    light : over photons per pixel. dim : the same below the first of them, for S/N. dark : a pair without light.
    dark_series : over seconds. warm : dark series by temperature. dark_stack, bright_stack : at 0 and 50 % of saturation.
    grey : (frames, rows, columns) at 13 % of saturation.
    """

    experiment: Experiment = field(repr=False)
    light: Series = field(repr=False)
    dim: Series = field(repr=False)
    dark: Pair
    dark_series: Series = field(repr=False)
    warm: dict[float, Series] = field(repr=False)
    dark_stack: Stack = field(repr=False)
    bright_stack: Stack = field(repr=False)
    grey: Array = field(repr=False)
    grey_photons: float
    bright_photons: float

    @property
    def pixels(self) -> int:
        return math.prod(self.experiment.sensor.shape)

    @cached_property
    def transfer(self) -> PhotonTransfer:
        return photon_transfer(self.light, self.dark.mean_dn, self.dark.variance_dn2, self.pixels, self.prnu.value)

    @property
    def signal_dn(self) -> Array:
        """(n,) mean signals of the light series, above the dark."""
        return self.light.mean_dn - self.dark.mean_dn

    @property
    def rising(self) -> Series:
        """`dim`, then `light` up to its saturation."""
        end = self.transfer.saturation_index + 1
        return Series(*(np.concatenate([dim, light[:end]]) for dim, light in zip(self.dim, self.light, strict=True)))

    @cached_property
    def linearity(self) -> Linearity:
        return linearity(self.light.at, self.signal_dn, self.transfer.saturation_index)

    @cached_property
    def dsnu_e(self) -> Estimate:
        return dsnu_e(self.dark_stack, self.transfer.gain_dn_per_e)

    @cached_property
    def prnu(self) -> Estimate:
        return prnu(self.dark_stack, self.bright_stack)

    @cached_property
    def dark_currents(self) -> tuple[Estimate, Estimate]:
        """From the mean and from the variance."""
        return dark_current(self.dark_series, self.transfer.gain_dn_per_e, self.pixels)

    @cached_property
    def warm_currents(self) -> tuple[Array, list[Estimate]]:
        """(temperatures in kelvin, dark currents from the mean); without the error of K, which they have in common."""
        gain = Estimate(self.transfer.gain_dn_per_e.value)
        return np.array(list(self.warm)), [dark_current(each, gain, self.pixels)[0] for each in self.warm.values()]

    @property
    def true_dark_noise_e(self) -> float:
        p = self.experiment.physics
        return math.sqrt(p.reset_noise_e**2 + p.read_noise_e**2 + p.dark_current_e_per_s * self.experiment.integration_s)

    @cached_property
    def true_prnu(self) -> float:
        return gain_map(self.experiment, self.bright_photons)

    @cached_property
    def true_linearity(self) -> Linearity:
        e = self.experiment
        mean, _ = expected_curve(e.photons * e.efficiency, e.integration_s, e.physics)
        dark, _ = expected_curve(np.zeros(1), e.integration_s, e.physics)
        return linearity(e.photons, mean - dark, self.transfer.saturation_index)

    @property
    def notes(self) -> list[str]:
        """What a reader has to know: a raised black level, a quantiser that decides, a curve that is not straight."""
        pixel, asked = self.experiment.physics.pixel, self.experiment.asked_black_dn
        told = []
        if pixel.black_level_dn != asked:
            told.append(
                f"black level raised from {asked:g} to {pixel.black_level_dn:g} DN, 6 σ of the dark: a clip at 0 DN would spoil "
                "its statistics. The full well stands for the codes that are left, so K is smaller than without it."
            )
        if self.transfer.limited:
            told.append(
                f"quantisation-limited: σ²_y.dark = {self.dark.variance_dn2:.3g} DN² is below 0.24 DN², so σ_d is an "
                "upper bound, and K and all that is divided by it are off by some per cent: 1/12 DN² no longer holds. "
                f"More bits than {pixel.bits} show them (pixel.bits)."
            )
        if pixel.conversion != "linear":
            told.append(
                "conversion = 'junction': the gain changes as the well fills, so the linear model of EMVA 1288 does not hold. "
                "K, R and η are means over the range of their fits; the true values are those of the charge."
            )
        return told


def make_datasheet(pixel: Pixel, exposure: Exposure | None = None, *, stage: Stage | None = None, **how: Any) -> DataSheet:
    """Run the experiment on one individual of a pixel; keywords as `make_experiment` takes them.

    Raises PixsimError as `make_experiment` does.
    """
    return measure(make_experiment(pixel, exposure, **how), stage)


def measure(experiment: Experiment, stage: Stage | None = None) -> DataSheet:
    """Take every frame. `stage` is told what is being taken."""
    told = stage or (lambda name: lambda done, note="": None)

    def pairs(name: str, photons: Array) -> Series:
        tell, found = told(name), []
        for index, each in enumerate(photons.tolist()):
            found.append(pair(*experiment.frames(2, each, name, index)))
            tell((index + 1) / photons.size)
        return series(photons, found)

    light = pairs("light series", experiment.photons)
    dim = pairs("dim light", experiment.dim_photons)
    told("stacks")
    saturation = float(light.at[saturation_index(light.variance_dn2)])
    bright, grey = saturation / 2, GREY_SHARE * saturation
    count = experiment.stack_frames
    stacks = [stack(experiment.frames(count, each, name)) for each, name in ((0.0, "dark stack"), (bright, "bright stack"))]
    told("dark series")
    return DataSheet(
        experiment,
        light=light,
        dim=dim,
        dark=pair(*experiment.frames(2, 0.0, "dark")),
        dark_series=experiment.dark_series(),
        warm={each: experiment.dark_series(each) for each in experiment.temperatures_k},
        dark_stack=stacks[0],
        bright_stack=stacks[1],
        grey=np.stack([*experiment.frames(GREY_FRAMES, grey, "grey")]).astype(float),
        grey_photons=grey,
        bright_photons=bright,
    )


EMVA, NOISE, SPEED = "EMVA 1288", "ISO 15739", "ISO 12232"
ROUNDING = 1e-9
PARTS = ("of columns", "col"), ("of rows", "row"), ("of single pixels", "pixel")


@dataclass(frozen=True)
class Entry:
    """A line of a data sheet. `measured`, `standard_error` and `true` are in `unit`; NaN where there is none."""

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
        """measured/true - 1; NaN where the true value is none, or 0 but for rounding."""
        return self.measured / self.true - 1 if abs(self.true) > ROUNDING * abs(self.measured) else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON: None for what is not a number."""
        return plain(asdict(self) | {"off": self.off})


def entries(sheet: DataSheet) -> list[Entry]:
    """All of them, in the order of the standards."""
    return [*sensitivity(sheet), *spatial(sheet), *dark(sheet), *noise(sheet), *speed(sheet)]


def sheet_summary(sheet: DataSheet) -> dict[str, Any]:
    """summary.json."""
    e = sheet.experiment
    return {
        "pixel": e.physics.pixel.model_dump(),
        "wavelength_nm": e.wavelength_nm,
        "integration_s": e.integration_s,
        "shape": list(e.sensor.shape),
        "exposures": e.photons.size,
        "stack_frames": e.stack_frames,
        "seed": e.seed,
        "black_level_asked_dn": e.asked_black_dn,
        "quantisation_limited": sheet.transfer.limited,
        "notes": sheet.notes,
        "entries": [each.as_dict() for each in entries(sheet)],
    }


def line(standard: str, quantity: str, symbol: str, unit: str, found: Estimate, true: float, true_is: str, note: str = "") -> Entry:
    return Entry(standard, quantity, symbol, unit, found.value, found.error, true, true_is, note)


def decibel(ratio: Estimate) -> Estimate:
    """20 log₁₀."""
    return Estimate(20 * math.log10(ratio.value), 20 / math.log(10) * ratio.error / ratio.value)


def sensitivity(sheet: DataSheet) -> list[Entry]:
    """Gain, quantum efficiency, dark noise, saturation, SNR, dynamic range and linearity."""
    t, e, p, true = sheet.transfer, sheet.experiment, sheet.experiment.physics, sheet.true_linearity
    eta, dn2 = e.efficiency, p.dn_per_e**2
    saturation_e = variance_peak_e(p, e.integration_s, float(e.photons[-1]) * eta)
    dark_dn2 = sheet.true_dark_noise_e**2 * dn2 + QUANTISATION_DN2
    threshold_e = math.sqrt(dark_dn2 / dn2) + 0.5
    limited = "quantisation-limited: an upper bound" if t.limited else ""
    step = "standard error: one exposure step"
    peak = "peak of the model's own variance"
    straight = p.pixel.conversion == "linear" and p.pixel.well_limit == "swing"
    of_line = "of a straight line" if straight else "the model's own curve"
    return [
        line(EMVA, "overall system gain", "K", "DN/e-", t.gain_dn_per_e, p.dn_per_e, "(2^bits - 1 - black) / full well"),
        line(EMVA, "responsivity", "R", "DN/p", t.responsivity_dn_per_p, p.dn_per_e * eta, "K η"),
        line(EMVA, "quantum efficiency", "η", "%", t.efficiency * 100, 100 * eta, "QE(λ) · fill factor, of the whole pixel"),
        line(EMVA, "temporal dark noise", "σ_d", "e-", t.dark_noise_e, sheet.true_dark_noise_e, "√(reset² + read² + dark)",
             limited),
        line(EMVA, "absolute sensitivity threshold", "μ_p.min", "p", t.threshold_p, threshold_e / eta,
             "(√(σ_d² + σ_q²/K²) + ½) / η", limited),
        line(EMVA, "absolute sensitivity threshold", "μ_e.min", "e-", t.threshold_e, threshold_e, "η μ_p.min", limited),
        line(EMVA, "saturation capacity", "μ_p.sat", "p", t.saturation_p, saturation_e / eta, peak, step),
        line(EMVA, "saturation capacity", "μ_e.sat", "e-", t.saturation_e, saturation_e, peak, step),
        line(EMVA, "maximum signal-to-noise ratio", "SNR_max", "dB", decibel(t.snr_max), 10 * math.log10(saturation_e),
             "√μ_e.sat"),
        line(EMVA, "dynamic range", "DR", "dB", decibel(t.dynamic_range), 20 * math.log10(saturation_e / threshold_e),
             "μ_p.sat / μ_p.min", limited),
        line(EMVA, "linearity error, mean", "LE", "%", linearity_estimate(sheet, "error"), 100 * true.error, of_line),
        line(EMVA, "linearity error, lowest", "LE_min", "%", linearity_estimate(sheet, "lowest"), 100 * true.lowest, of_line),
        line(EMVA, "linearity error, highest", "LE_max", "%", linearity_estimate(sheet, "highest"), 100 * true.highest, of_line)
    ]  # fmt: skip


def linearity_estimate(sheet: DataSheet, name: str) -> Estimate:
    """In per cent; the error is that of the mean signals, on average over the fitted range, or the largest in it."""
    within, light = sheet.linearity.within, sheet.light
    error = np.sqrt(light.variance_dn2[within] / (2 * sheet.pixels)) / sheet.signal_dn[within]
    return Estimate(100 * getattr(sheet.linearity, name), 100 * float(error.mean() if name == "error" else error.max()))


def spatial(sheet: DataSheet) -> list[Entry]:
    """DSNU1288, what of it belongs to columns, rows and single pixels (0 where the variance is not above zero), and PRNU1288."""
    p, map_e, k = sheet.experiment.physics, dark_map_e(sheet.experiment), sheet.transfer.gain_dn_per_e
    dark_e = p.dark_current_e_per_s * sheet.experiment.integration_s
    nominal = math.sqrt(p.offset_fpn_e**2 + p.column_fpn_e**2 + (p.dsnu * dark_e) ** 2)
    dsnu = f"this individual's maps; √(offset² + column² + (σ_DSNU · dark)²) is {nominal:.4g} by the parameters"
    of_gain = f"this individual's maps; {100 * p.prnu:.4g} by the parameters"
    split = zip(PARTS, parts(sheet.dark_stack), parts(Stack(1, map_e, np.zeros_like(map_e))), strict=True)
    return [
        line(EMVA, "dark signal non-uniformity", "DSNU_1288", "e-", sheet.dsnu_e, float(map_e.std(ddof=1)), dsnu),
        *(
            line(EMVA, f"DSNU, {name}", f"DSNU_1288.{short}", "e-", root(found, 0.0) / k, root(true, 0.0).value,
                 "this individual's maps, split alike")
            for (name, short), found, true in split
        ),
        line(EMVA, "photo response non-uniformity", "PRNU_1288", "%", sheet.prnu * 100, 100 * sheet.true_prnu, of_gain)
    ]  # fmt: skip


def dark(sheet: DataSheet) -> list[Entry]:
    """Dark current from mean and variance, and the temperature step that doubles it."""
    p, (from_mean, from_variance) = sheet.experiment.physics, sheet.dark_currents
    current, unit = p.dark_current_e_per_s, "e-/s"
    at = f"at {p.pixel.temperature_k:g} K, mean of the pixels"
    entries = [
        line(EMVA, "dark current, from the mean", "μ_I.mean", unit, from_mean, current, at),
        line(EMVA, "dark current, from the variance", "μ_I.var", unit, from_variance, current, at),
    ]
    temperatures, warm = sheet.warm_currents
    if warm and current:
        doubling = doubling_k(temperatures, np.array([each.value for each in warm]), np.array([each.error for each in warm]))
        name, true_k = "doubling temperature of the dark current", p.technology.dark_doubling_k
        entries.append(line(EMVA, name, "ϑ_d", "K", doubling, true_k, "the technology's"))
    return entries


def noise(sheet: DataSheet) -> list[Entry]:
    """ISO 15739: noise at 13 % of saturation, S/N there, and dynamic range."""
    e, p, k = sheet.experiment, sheet.experiment.physics, sheet.experiment.physics.dn_per_e
    (temporal, fixed, total), signal_e = noise_15739(sheet.grey), sheet.grey_photons * e.efficiency
    pattern_e = dark_map_e(e) + (0.0 if e.sensor.gain is None else signal_e * e.sensor.gain)
    dark_e = p.dark_current_e_per_s * e.integration_s
    temporal_dn2 = k**2 * (signal_e + dark_e + p.reset_noise_e**2 + p.read_noise_e**2) + QUANTISATION_DN2
    fixed_dn2 = k**2 * float(pattern_e.var(ddof=1))
    signal = Estimate(float(sheet.grey.mean()) - sheet.dark.mean_dn, math.sqrt(temporal_dn2 / sheet.pixels))
    dark_dn2 = temporal_dn2 - k**2 * signal_e
    dark_noise = Estimate(
        math.sqrt(sheet.dark_stack.temporal_dn2), math.sqrt(dark_dn2 / 2 / sheet.pixels / (sheet.dark_stack.frames - 1))
    )
    full_dn = Estimate(float(2**p.pixel.bits - 1) - sheet.dark.mean_dn)
    at = "injected, at 13 % of saturation"
    return [
        line(NOISE, "temporal noise", "σ_temp", "DN", temporal, math.sqrt(temporal_dn2), at),
        line(NOISE, "fixed-pattern noise", "σ_fp", "DN", fixed, math.sqrt(fixed_dn2), f"{at}: this individual's maps"),
        line(NOISE, "total noise", "σ_total", "DN", total, math.sqrt(temporal_dn2 + fixed_dn2), at),
        line(NOISE, "signal over total noise at 13 %", "Q", "dB", decibel(signal / total),
             20 * math.log10(k * signal_e / math.sqrt(temporal_dn2 + fixed_dn2)), "of the injected signal and noise"),
        line(NOISE, "dynamic range", "DR_ISO", "dB", decibel(full_dn / dark_noise),
             20 * math.log10(k * (p.full_well_e - dark_e) / math.sqrt(dark_dn2)), "top code over temporal noise of the dark")
    ]  # fmt: skip


def speed(sheet: DataSheet) -> list[Entry]:
    """ISO 12232: saturation-based and noise-based speed, in daylight (CIE D65)."""
    e, rising, p = sheet.experiment, sheet.rising, sheet.experiment.physics
    per_lx_s = daylight_e_per_lx_s(p)
    lx_s_per_photon = e.efficiency / per_lx_s
    top = Estimate(float(2**p.pixel.bits - 1) - sheet.dark.mean_dn)
    filling = top / sheet.transfer.responsivity_dn_per_p * lx_s_per_photon
    dark_e = p.dark_current_e_per_s * e.integration_s
    of_daylight = f"CIE D65, {per_lx_s:.4g} e- per lx·s"
    entries = [
        line(SPEED, "saturation-based speed", "S_sat", "", Estimate(SATURATION_SPEED_LX_S) / filling,
             SATURATION_SPEED_LX_S * per_lx_s / (p.full_well_e - dark_e), f"78 / H_sat; {of_daylight}")
    ]  # fmt: skip
    lx_s, mean = rising.at[:-1] * lx_s_per_photon, rising.mean_dn[:-1] - sheet.dark.mean_dn
    deviation = np.sqrt(rising.frame_variance_dn2[:-1])
    dark_dn2 = float(dark_map_e(e).var(ddof=1)) + sheet.true_dark_noise_e**2 + QUANTISATION_DN2 / p.dn_per_e**2
    for wanted in SIGNAL_TO_NOISE:
        found = exposure_at_snr(lx_s, mean, deviation, wanted, 1 / math.sqrt(2 * sheet.pixels))
        true_e = signal_at_snr_e(wanted, dark_dn2, sheet.true_prnu)
        true = NOISE_SPEED_LX_S * per_lx_s / true_e if true_e < p.full_well_e else math.nan
        note = "" if math.isfinite(found.value) else "not reached below saturation"
        name, speed = f"noise-based speed, S/N {wanted:g}", Estimate(NOISE_SPEED_LX_S) / found
        entries.append(line(SPEED, name, f"S_noise{wanted:g}", "", speed, true, f"10 / H_S/N; {of_daylight}", note))
    return entries
