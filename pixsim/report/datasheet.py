"""The page of a data sheet: its values beside the true ones, and its figures with their data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import exposure_time, number, rounded, with_error, within_error
from pixsim.base.notes import Note
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.measure.datasheet import DataSheet, Entry
from pixsim.measure.estimators import LINEARITY_SHARES, SENSITIVITY_SHARE, straight_line
from pixsim.sensor.labels import file_label, label_of
from pixsim.sensor.pixel_options import Pixel
from pixsim.show.document import Answer, Document, DocumentTable, Plot, Section, headline, made_with, pairs
from pixsim.show.figures import COLOURS, LOOKS, Look, finish, new_figure, plain_powers
from pixsim.show.pages import Drawing, figure, figure_files
from pixsim.show.presenter import Presenter
from pixsim.show.sentences import setting_value

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE = COLOURS[:2]
DARK, LIGHT = LOOKS[2:4]  # distinct in greyscale, for overlapping lines
MARKED = 12  # markers along a line of many points, which identify it in greyscale
BINS = 101


FIGURES = ("photon_transfer", "responsivity", "snr", "linearity", "dark_current", "histograms", "spectrograms", "profiles")
FILES = ("report.html", "summary.json", "datasheet.csv", *figure_files(FIGURES))


def photon_axis(sheet: DataSheet) -> str:
    return f"photons per pixel, μ_p ({sheet.experiment.wavelength_nm:g} nm)"


@figure(
    "photon_transfer",
    "Photon transfer: the slope between 0 and 70 % of saturation is the system gain K; saturation is the peak of the variance.",
)
def photon_transfer_plate(sheet: DataSheet) -> Drawing:
    """Temporal variance against mean signal, both minus the dark."""
    t, light, (expected, expected_variance) = sheet.transfer, sheet.light, sheet.expected
    signal, variance = sheet.signal_dn, light.variance_dn2 - sheet.dark.variance_dn2
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    axes.plot(expected, expected_variance, color="0.6", lw=1, label="model")
    axes.plot(signal, variance, "o", ms=3.5, mfc="none", color=BLUE, label="measured")
    axes.plot(signal[t.fitted], variance[t.fitted], "o", ms=3.5, color=BLUE, label=f"fitted, up to {100 * SENSITIVITY_SHARE:.0f} %")
    reach = np.array([0.0, signal[t.saturation_index]])
    k = t.gain_dn_per_e
    axes.plot(reach, k.value * reach, "--", color=ORANGE, lw=1.2, label=f"K = {with_error(k.value, k.error)} DN/e⁻")
    axes.plot(signal[t.saturation_index], variance[t.saturation_index], "v", ms=9, mfc="white", mec=ORANGE, mew=1.5,
              label="saturation")  # fmt: skip
    finish(axes, "mean gray value minus dark, μ_y − μ_y.dark (DN)", "temporal variance, σ²_y − σ²_y.dark (DN²)")
    table = {"photons_p": light.at, "signal_dn": signal, "variance_dn2": variance, "expected_signal_dn": expected,
             "expected_variance_dn2": expected_variance, "fitted": t.fitted.astype(int)}  # fmt: skip
    return figure, table


@figure("responsivity", "Mean signal against photons: the slope is the responsivity R, and η = R/K.")
def responsivity_plate(sheet: DataSheet) -> Drawing:
    """Mean signal against photons."""
    t, light, signal = sheet.transfer, sheet.light, sheet.signal_dn
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    axes.plot(light.at, signal, "o", ms=3.5, mfc="none", color=BLUE, label="measured")
    axes.plot(light.at[t.fitted], signal[t.fitted], "o", ms=3.5, color=BLUE, label=f"fitted, up to {100 * SENSITIVITY_SHARE:.0f} %")
    r, reach = t.responsivity_dn_per_p, np.array([0.0, light.at[-1]])
    axes.plot(reach, r.value * reach, "--", color=ORANGE, lw=1.2, label=f"R = {r.value:.5g} DN/photon")
    axes.axvline(t.saturation_p.value, color="0.5", lw=1, ls=":", label="saturation")
    axes.set_ylim(top=1.15 * signal.max())
    finish(axes, photon_axis(sheet), "mean gray value minus dark (DN)")
    return figure, {"photons_p": light.at, "signal_dn": signal}


@figure("snr", "SNR against photons. The dynamic range lies between the two vertical lines; PRNU limits the total SNR.")
def snr_plate(sheet: DataSheet) -> Drawing:
    """SNR with temporal noise and with total noise against photons, log-log."""
    t, rising = sheet.transfer, sheet.rising
    photons, signal = rising.at, rising.mean_dn - sheet.dark.mean_dn
    snr_temporal, snr_total = signal / np.sqrt(rising.variance_dn2), signal / np.sqrt(rising.frame_variance_dn2)
    positive = signal > 0
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    electrons = t.efficiency.value * photons
    model = electrons / np.sqrt(t.dark_noise_e.value**2 + 1 / 12 / t.gain_dn_per_e.value**2 + electrons)
    ideal = np.sqrt(electrons)
    axes.loglog(photons, ideal, ":", color="0.4", lw=1, label="ideal sensor of the same η: √μ_e")
    axes.loglog(photons, model, "-", color=BLUE, lw=1, label="model from K, η and σ_d")
    axes.loglog(photons[positive], snr_temporal[positive], "o", ms=3.5, color=BLUE, label="measured, temporal noise")
    axes.loglog(photons[positive], snr_total[positive], "s", ms=3.5, color=ORANGE, label="measured, total noise with fixed pattern")
    axes.axvline(t.threshold_p.value, color="0.5", lw=1, ls="--", label="μ_p.min, where the SNR is 1")
    axes.axvline(t.saturation_p.value, color="0.5", lw=1, ls="-.", label="μ_p.sat")
    axes.set_ylim(bottom=0.1)
    finish(axes, photon_axis(sheet), "SNR (mean / standard deviation)", "lower right")
    measured = {"snr_temporal": snr_temporal, "snr_total": snr_total}
    return figure, {"photons_p": photons, **measured, "snr_model": model, "snr_ideal": ideal}


@figure("linearity", "Linearity: deviation of the mean signal from a straight line. Bars: standard error.")
def linearity_plate(sheet: DataSheet) -> Drawing:
    """Relative deviation of the mean signal from a straight line."""
    result, light = sheet.linearity, sheet.light
    percent, inside = 100 * result.deviation, result.within
    error = 100 * np.sqrt(light.variance_dn2 / (2 * sheet.pixels)) / sheet.signal_dn
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    axes.axhline(0.0, color="0.5", lw=0.8)
    reach = f"{100 * LINEARITY_SHARES[0]:.0f} to {100 * LINEARITY_SHARES[1]:.0f} %"
    shown = np.arange(light.at.size) <= np.flatnonzero(inside)[-1] + 1
    axes.errorbar(light.at[inside], percent[inside], error[inside], fmt="o", ms=3.5, lw=1, color=BLUE,
                  label=f"{reach} of saturation: LE = {100 * result.error:.2g} %")  # fmt: skip
    outside = shown & np.logical_not(inside)
    axes.plot(light.at[outside], percent[outside], "o", ms=3.5, mfc="none", color=BLUE, label="outside the range")
    widest = 1.3 * float((np.abs(percent) + error)[inside].max())
    axes.set_ylim(-widest, widest)
    finish(axes, photon_axis(sheet), "deviation from a straight line (%)")
    table = {"photons_p": light.at, "deviation_percent": percent, "within": inside.astype(int)}
    return figure, table


@figure(
    "dark_current",
    "Dark current: the slopes of mean and variance, which agree if only dark charge adds noise; and against temperature.",
)
def dark_current_plate(sheet: DataSheet) -> Drawing:
    """Mean and variance of dark frames against integration time, and dark current against temperature."""
    dark, k = sheet.dark_series, sheet.transfer.gain_dn_per_e.value
    (from_mean, from_variance), (temperatures, warm) = sheet.dark_currents, sheet.warm_currents
    figure = new_figure(9.6 if warm else 6.4, 3.6)
    panels = np.atleast_1d(figure.subplots(1, 3 if warm else 2))
    table: dict[str, Array] = {"integration_s": dark.at}
    quantities = (
        ("mean_e", dark.mean_dn / k, "mean, with black level (e⁻)", "μ_I.mean", from_mean),
        ("variance_e2", dark.variance_dn2 / k**2, "variance (e⁻²)", "μ_I.var", from_variance),
    )
    for axes, (name, values, label, symbol, current) in zip(panels, quantities, strict=False):
        slope, start = straight_line(dark.at, values, np.zeros_like(values))
        line = start.value + slope.value * dark.at
        axes.plot(dark.at, values, "o", ms=4, color=BLUE)
        axes.plot(dark.at, line, color=ORANGE, lw=1, label=f"{symbol} = {current.value:.4g} e⁻/s")
        finish(axes, "integration time (s)", f"dark {label}")
        table |= {name: values, f"fitted_{name}": line}
    if warm:
        currents, errors = zip(*((current.value, current.error) for current in warm), strict=True)
        panels[2].errorbar(temperatures, currents, errors, fmt="o", ms=4, color=BLUE)
        panels[2].set_yscale("log")
        plain_powers(panels[2].yaxis)
        finish(panels[2], "temperature (K)", "dark current (e⁻/s)")
    currents_e_per_s = np.array([current.value for current in warm])
    measured = {"mean_dn": dark.mean_dn, "variance_dn2": dark.variance_dn2}
    return figure, table | measured | {"temperature_k": temperatures, "dark_current_e_per_s": currents_e_per_s}


def deviations(sheet: DataSheet) -> list[tuple[str, str, Array]]:
    """(name, label, map): the mean dark image in electrons and the mean response in per cent, each minus its mean."""
    dark_dn = sheet.dark_stack.mean_dn
    dark = (dark_dn - dark_dn.mean()) / sheet.transfer.gain_dn_per_e.value
    light = sheet.bright_stack.mean_dn - dark_dn
    return [
        ("DSNU", "dark, deviation from the mean (e⁻)", dark),
        ("PRNU", "response, deviation from the mean (%)", 100 * (light / light.mean() - 1)),
    ]


@figure("histograms", "Histograms of the mean dark image and mean response. Pixels outside the normal distribution are defective.")
def histogram_plate(sheet: DataSheet) -> Drawing:
    """Logarithmic histograms of the stacks' mean images, with normal distributions of the same spread."""
    figure = new_figure(8.6, 3.6)
    table: dict[str, Array] = {}
    for axes, (name, label, map_), colour in zip(figure.subplots(1, 2), deviations(sheet), COLOURS, strict=False):
        reach = 1.02 * max(float(np.abs(map_).max()), 1e-9)
        counts, edges = np.histogram(map_, np.linspace(-reach, reach, BINS + 1))
        centres, sigma = (edges[1:] + edges[:-1]) / 2, max(float(map_.std()), 1e-12)
        normal = map_.size * np.diff(edges) / (sigma * np.sqrt(2 * np.pi)) * np.exp(-((centres / sigma) ** 2) / 2)
        axes.step(centres, counts, where="mid", color=colour, lw=1, label=f"{name}: {map_.size} pixels")
        axes.plot(centres, normal, "--", color="0.4", lw=1, label="normal distribution of the same spread")
        axes.set_yscale("log")
        axes.set_ylim(0.5, 3 * counts.max())
        finish(axes, label, "pixels per bin")
        short = name.lower()
        table |= {f"{short}_bin": centres, f"{short}_pixels": counts, f"{short}_normal": normal}
    return figure, table


def draw_many(axes: Axes, x: Array, y: Array, look: Look, size: int, **more: Any) -> None:
    """Draw a thin line through many points, with MARKED markers per `size` points."""
    axes.plot(x, y, lw=0.9, ms=4, **look.line | {"ls": "-", "markevery": max(1, size // MARKED)}, **more)


def spectrogram(map_: Array, axis: int) -> tuple[Array, Array]:
    """Frequencies (periods per pixel) and mean power spectrum along an axis of a map (EMVA 1288, section 8.4)."""
    power = np.abs(np.fft.rfft(map_ - map_.mean(), axis=axis)) ** 2 / map_.shape[axis]
    return np.asarray(np.fft.rfftfreq(map_.shape[axis]), float), np.asarray(power.mean(axis=1 - axis))


@figure(
    "spectrograms",
    "Spectrograms along rows (horizontal) and columns (vertical). White noise is flat; column offsets raise the horizontal one.",
)
def spectrogram_plate(sheet: DataSheet) -> Drawing:
    """Square roots of the power spectra along rows and columns."""
    figure = new_figure(8.6, 3.6)
    table: dict[str, Array] = {}
    for axes, (name, _, map_) in zip(figure.subplots(1, 2), deviations(sheet), strict=True):
        for label, axis, look in (("horizontal", 1, DARK), ("vertical", 0, LIGHT)):
            frequency, power = spectrogram(map_, axis)
            draw_many(axes, frequency[1:], np.sqrt(power[1:]), look, power.size, label=f"{name}, {label}")
            table |= {f"{name.lower()}_{label}_frequency": frequency, f"{name.lower()}_{label}_amplitude": np.sqrt(power)}
        axes.axhline(float(map_.std()), color="0.5", lw=0.8, ls=":")
        axes.set_ylim(0.0, 1.35 * axes.get_ylim()[1])
        finish(axes, "frequency (periods per pixel)", "standard deviation (" + ("e⁻)" if name == "DSNU" else "%)"))
    return figure, table


@figure("profiles", "Profiles: means of columns and rows minus the overall mean.")
def profile_plate(sheet: DataSheet) -> Drawing:
    """Means of the columns and of the rows of the maps."""
    figure = new_figure(8.6, 3.6)
    table: dict[str, Array] = {"column_or_row": np.arange(float(max(sheet.dark_stack.mean_dn.shape)))}
    for axes, (name, label, map_) in zip(figure.subplots(1, 2), deviations(sheet), strict=True):
        for lines, axis, look in (("columns", 0, DARK), ("rows", 1, LIGHT)):
            mean = map_.mean(axis=axis)
            draw_many(axes, np.arange(mean.size), mean, look, mean.size, label=f"{name}, means of {lines}", zorder=2 + axis)
            table[f"{name.lower()}_{lines}"] = mean
        finish(axes, "column or row", label.replace(", deviation from the mean", ""))
    return figure, table


ROUNDING = 1e-8  # smaller values are roundings of 0 in every unit of the sheet, except dark currents at very low temperature


def sheet_name(pixel: Pixel) -> str:
    return f"datasheet-{file_label(label_of(pixel.technology))}-{pixel.pitch_um:g}um"


def off(entry: Entry) -> str:
    """Return measured/true - 1 in per cent; empty if undefined or 1000 % and more."""
    return f"{100 * entry.off:+z.2f} %" if math.isfinite(entry.off) and abs(entry.off) < 10 else ""


def described(sheet: DataSheet) -> Answer:
    """Return the most important values, and the pixel and the measurement that they are of."""
    experiment, physics, transfer = sheet.experiment, sheet.experiment.physics, sheet.transfer
    readout = experiment.readout
    filters = f", filters {physics.layout}" if physics.layout else ""
    channel = f" on channel {physics.channel}" if physics.channel else ""
    gain = f", {readout.gain_db:g} dB" if readout.gain_db else ""
    rows, columns = experiment.sensor.shape
    return headline(
        [
            f"{label_of(physics.technology.name)}, {physics.pitch_um:g} µm pixels{filters}, {readout.adc.bits} bits: "
            f"K {transfer.gain_dn_per_e.value:.3g} DN/e-, η {100 * transfer.efficiency.value:.3g} %, "
            f"σ_d {transfer.dark_noise_e.value:.3g} e-, μ_e.sat {rounded(transfer.saturation_e.value)} e-",
            f"black level {readout.adc.black_level_dn:g} DN, {physics.pixel.temperature_k:g} K, {columns} × {rows} pixels, "
            f"{experiment.wavelength_nm:g} nm{channel}, {exposure_time(experiment.integration_s)}{gain}",
            physics.pixel.assumption or "",
        ]
    )


COLUMNS = ("quantity", "symbol", "measured", "standard error", "true", "unit", "deviation", "limits")
WORDS = (1, 5, 7)  # columns


def entry_rows(sheet: DataSheet) -> list[tuple[str, ...]]:
    """Return the lines of the sheet in `COLUMNS`, below the name of their standard."""
    rows: list[tuple[str, ...]] = []
    for standard, entries in groupby(sheet.entries, attrgetter("standard")):
        rows.append((standard,))
        for entry in entries:
            standard_error, true = number(entry.standard_error, 2, ROUNDING), number(entry.true, 5, ROUNDING)
            measured = number(entry.measured, 5, ROUNDING)
            if entry.measured is not None and entry.standard_error:
                measured = within_error(entry.measured, entry.standard_error)
            rows.append((entry.quantity, entry.symbol, measured, standard_error, true, entry.unit, off(entry), entry.note))
    return rows


def datasheet_notes(sheet: DataSheet) -> list[Note]:
    """Return notes for the reader: a raised black level, a quantisation limit, a non-linear conversion."""
    experiment = sheet.experiment
    pixel, physics, readout = experiment.pixel, experiment.physics, experiment.readout
    notes = []
    if pixel.black_level_dn != experiment.asked_black_dn:
        span = "full well" if pixel.adc_full_scale_e is None else "full scale"
        left = f"The {span} spans the remaining codes, which reduces K."
        if readout.adc.gain_e_per_dn is not None:
            left = f"The ADC's range is {readout.adc_range_e:.4g} e- above it."
        notes.append(
            f"black level raised from {experiment.asked_black_dn:g} to {pixel.black_level_dn:g} DN, 6 σ of the dark noise, so that "
            f"the dark frames are not clipped at 0 DN. {left}"
        )
    if readout.adc_range_e < readout.full_well_e:
        notes.append(
            f"the ADC clips before the well: its top code is at {readout.adc_range_e:.4g} e-, the full well at "
            f"{readout.full_well_e:.4g} e-. The saturation capacity is that of the ADC."
        )
    if sheet.transfer.limited:
        notes.append(
            f"quantisation-limited: σ²_y.dark = {sheet.dark.variance_dn2:.3g} DN² is below 0.24 DN². σ_d is an upper bound, "
            "DR_ISO says nothing of the sensor, and K and all values derived from it are wrong by some per cent, because the "
            f"quantisation noise is no longer 1/12 DN². Use more than {pixel.bits} bits (pixel.bits)."
        )
    if physics.layout is not None:
        notes.append(
            f"colour filters {physics.layout}: EMVA 1288, ISO 15739 and ISO 12232 take each channel for itself. Values without "
            f"the name of a channel are those of {physics.channel}, in light of {experiment.wavelength_nm:g} nm; gain, dark noise "
            "and dark current are those of all channels."
        )
    if readout.bin_side > 1:
        notes.append(
            f"binning: a pixel of this sheet is the sum of {readout.bin_side} × {readout.bin_side} pixels of "
            f"{physics.pitch_um:g} µm."
        )
    if isinstance(sheet.colour, str):
        notes.append(f"no colour matrix: {sheet.colour}")
    if sheet.full_in_the_dark:
        notes.append(
            f"hot pixels: {100 * sheet.full_in_the_dark:.2g} % of the pixels are full in the last exposure of the dark series, "
            "so that the measured dark current is too low."
        )
    if pixel.conversion != "linear":
        notes.append(
            "conversion = 'junction': the gain changes as the well fills, so the linear model of EMVA 1288 does not hold. "
            "The measured K, R and η are means over the fitted range; the true values refer to the charge."
        )
    return [Note("data_sheet", words=text) for text in notes]


def datasheet_data(sheet: DataSheet, notes: Sequence[Note]) -> dict[str, Any]:
    """Return summary.json."""
    experiment = sheet.experiment
    content = {
        "pixel": experiment.pixel.model_dump(),
        "assumption": experiment.physics.pixel.assumption,
        "wavelength_nm": experiment.wavelength_nm,
        "integration_s": experiment.integration_s,
        "gain_db": experiment.readout.gain_db,
        "shape": list(experiment.sensor.shape),
        "exposures": experiment.photons.size,
        "stack_frames": experiment.stack_frames,
        "seed": experiment.seed,
        "black_level_asked_dn": experiment.asked_black_dn,
        "quantisation_limited": sheet.transfer.limited,
        "entries": [entry.as_dict() for entry in sheet.entries],
    }
    settings = {"pixel": experiment.pixel.model_dump(mode="json", exclude_none=True), "seed": experiment.seed}
    return result_data(content, settings=settings, notes=notes, table="datasheet.csv")


def datasheet_csv(sheet: DataSheet) -> str:
    """Return a row for each line of the data sheet as CSV."""
    return rows_csv([entry.as_dict() for entry in sheet.entries])


def datasheet_document(sheet: DataSheet) -> Document:
    """Return the page of a data sheet: the photon transfer, the notes, the values beside the true ones, further figures."""
    notes = datasheet_notes(sheet)
    values = DocumentTable("measured and true values", COLUMNS, entry_rows(sheet), words=WORDS, stacks=True, wide=1)
    transfer, *others = (Plot(partial(draw, sheet)) for draw in PLATES)
    pixel = sheet.experiment.pixel.model_dump(exclude_defaults=True, exclude_none=True)
    settings = pairs("pixel", {name: setting_value(value) for name, value in pixel.items()})
    return Document(
        command="datasheet",
        kind="data sheet of one simulated sensor",
        title=f"Data sheet of {sheet.experiment.pixel.pitch_um:g} µm pixels",
        data=datasheet_data(sheet, notes),
        answers=(described(sheet),),
        lead=(transfer, *notes),
        sections=(
            Section("values", "Measured and true values", (values,), brief=True),
            Section("figures", "Figures", others),
            Section(
                "made",
                "How it was made",
                (
                    "Measured on frames of one simulated device: the estimators do not know the pixel's parameters. datasheet.csv "
                    "has the source of each true value.",
                    made_with(settings),
                ),
                folded=True,
            ),
        ),
        files={"datasheet.csv": datasheet_csv(sheet)},
    )


PLATES = (
    *(photon_transfer_plate, responsivity_plate, snr_plate, linearity_plate),
    *(dark_current_plate, histogram_plate, spectrogram_plate, profile_plate),
)
PRESENTER = Presenter(document=datasheet_document, figure=photon_transfer_plate, csv=datasheet_csv)
