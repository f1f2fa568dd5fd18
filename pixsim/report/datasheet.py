"""The page of a data sheet: its values beside the true ones, and its figures with their data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import MAX_DIGITS, distinct_texts, exposure_time, number, within_error
from pixsim.base.notes import Note
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.measure.datasheet import DataSheet, Entry
from pixsim.measure.estimators import straight_line
from pixsim.report.panels import LINE, MARKED_LINE, POINTS, Line, LinePanel, draw_panels
from pixsim.sensor.labels import file_label, label_of
from pixsim.sensor.pixel_options import Pixel
from pixsim.show.document import Answer, Document, DocumentTable, Plot, Section, headline, pairs
from pixsim.show.figures import plain_powers
from pixsim.show.pages import Drawing, figure, figure_files
from pixsim.show.presenter import Presenter
from pixsim.show.sentences import setting_value

_BINS = 101
STEPS = {**LINE, "drawstyle": "steps-mid"}
_PHOTONS = "photons per pixel, μ_p"
_SIGNAL = "mean gray value minus dark (DN)"
MAPS = {
    "dsnu": "dark, deviation from the mean (e⁻)",
    "prnu": "response, deviation from the mean (%)",
}
FIGURES = (
    "characteristic_curve",
    "photon_transfer",
    "responsivity",
    "snr",
    "linearity",
    "dark_current",
    "histograms",
    "spectrograms",
    "profiles",
)
FILES = ("report.html", "summary.json", "datasheet.csv", *figure_files(FIGURES))


@figure("photon_transfer", "Photon transfer: the slope is the system gain K.")
def _photon_transfer_plate(sheet: DataSheet) -> Drawing:
    """Draw the temporal variance against the mean signal, both minus the dark."""
    transfer = sheet.transfer
    signal = sheet.signal_dn
    expected, expected_variance = sheet.expected
    table = {
        "photons_p": sheet.light.at,
        "signal_dn": signal,
        "variance_dn2": sheet.light.variance_dn2 - sheet.dark.variance_dn2,
        "expected_signal_dn": expected,
        "expected_variance_dn2": expected_variance,
        "fitted": transfer.fitted.astype(int),
        "gain_times_signal_dn2": transfer.gain_dn_per_e.value * signal,
    }
    lines = (
        Line("signal_dn", "variance_dn2", "measured", POINTS),
        Line("expected_signal_dn", "expected_variance_dn2", "model"),
        Line("signal_dn", "gain_times_signal_dn2", "fit, slope K"),
    )
    marks = {
        "end of the fit": signal[transfer.fitted][-1],
        "saturation": signal[transfer.saturation_index],
    }
    return draw_panels(
        table, [LinePanel(_SIGNAL, "temporal variance minus dark (DN²)", lines, marks)]
    )


@figure(
    "characteristic_curve",
    "Output against light, and the signal-to-noise ratio at the input. The dynamic range lies"
    " between the vertical lines; at a knee of the output a single exposure lies lower.",
)
def _characteristic_plate(sheet: DataSheet) -> Drawing:
    """Draw the characteristic curve and its SNR against photons, on logarithmic axes."""
    curve = sheet.curve
    assert curve is not None
    is_below = curve.photons <= sheet.true_saturation_p
    table = {
        "photons_p": curve.photons,
        "signal": curve.signal,
        "snr_p": curve.snr,
        "snr_total": curve.total_snr,
        "snr_p_model": np.where(is_below, sheet.true_snr(curve.photons), np.nan),
        "snr_total_model": np.where(is_below, sheet.true_snr(curve.photons, total=True), np.nan),
    }
    output = Line("photons_p", "signal", "measured", POINTS)
    ratios = (
        Line("photons_p", "snr_p", "measured, temporal noise", POINTS),
        Line("photons_p", "snr_total", "measured, total noise with fixed pattern", POINTS),
        Line("photons_p", "snr_p_model", "model, temporal noise"),
        Line("photons_p", "snr_total_model", "model, total noise"),
    )
    unit = "e⁻" if sheet.experiment.is_merged else "DN"
    marks = {
        "μ_p.min, where the SNR is 1": curve.threshold_p(curve.snr).value,
        "μ_p.sat": curve.saturation_p.value,
    }
    logarithmic = {"xscale": "log", "yscale": "log"}
    return draw_panels(
        table,
        [
            LinePanel(_PHOTONS, f"mean output minus dark ({unit})", (output,), axes=logarithmic),
            LinePanel(
                _PHOTONS,
                "SNR at the input",
                ratios,
                marks,
                logarithmic | {"ylim": (0.1, None)},
                "lower right",
            ),
        ],
    )


@figure("responsivity", "Responsivity R: the slope of signal over photons.")
def _responsivity_plate(sheet: DataSheet) -> Drawing:
    """Draw the mean signal against photons."""
    transfer = sheet.transfer
    photons = sheet.light.at
    fitted_dn = transfer.responsivity_dn_per_p.value * photons
    table = {"photons_p": photons, "signal_dn": sheet.signal_dn, "fitted_dn": fitted_dn}
    lines = (
        Line("photons_p", "signal_dn", "measured", POINTS),
        Line("photons_p", "fitted_dn", "fit, slope R"),
    )
    marks = {"saturation": transfer.saturation_p.value}
    return draw_panels(table, [LinePanel(_PHOTONS, _SIGNAL, lines, marks)])


@figure("snr", "Signal over noise. The dynamic range lies between the vertical lines.")
def _snr_plate(sheet: DataSheet) -> Drawing:
    """Draw the SNR with temporal and with total noise against photons, on logarithmic axes."""
    transfer = sheet.transfer
    rising = sheet.rising
    signal = rising.mean_dn - sheet.dark.mean_dn
    electrons = transfer.efficiency.value * rising.at
    noise_e2 = transfer.dark_noise_e.value**2 + 1 / 12 / transfer.gain_dn_per_e.value**2 + electrons
    table = {
        "photons_p": rising.at,
        "snr_temporal": signal / np.sqrt(rising.variance_dn2),
        "snr_total": signal / np.sqrt(rising.frame_variance_dn2),
        "snr_model": electrons / np.sqrt(noise_e2),
        "snr_ideal": np.sqrt(electrons),
    }
    lines = (
        Line("photons_p", "snr_temporal", "measured, temporal noise", POINTS),
        Line("photons_p", "snr_total", "measured, total noise with fixed pattern", POINTS),
        Line("photons_p", "snr_model", "model from K, η and σ_d"),
        Line("photons_p", "snr_ideal", "ideal sensor of the same η: √μ_e"),
    )
    marks = {
        "μ_p.min, where the SNR is 1": transfer.threshold_p.value,
        "μ_p.sat": transfer.saturation_p.value,
    }
    axes = {"xscale": "log", "yscale": "log", "ylim": (0.1, None)}
    return draw_panels(
        table,
        [LinePanel(_PHOTONS, "SNR (mean / standard deviation)", lines, marks, axes, "lower right")],
    )


@figure(
    "linearity", "Deviation from a straight line, 5 to 95 % of saturation. Bars: standard error."
)
def _linearity_plate(sheet: DataSheet) -> Drawing:
    """Draw the relative deviation of the mean signal from a straight line, in the range that
    counts.
    """
    linearity = sheet.linearity
    light = sheet.light
    error_percent = 100 * np.sqrt(light.variance_dn2 / (2 * sheet.pixels)) / sheet.signal_dn
    table = {
        "photons_p": light.at,
        "deviation_percent": 100 * linearity.deviation,
        "within": linearity.within.astype(int),
        "counted_percent": np.where(linearity.within, 100 * linearity.deviation, np.nan),
    }
    lines = (Line("photons_p", "counted_percent", style=POINTS),)
    figure, _ = draw_panels(
        table, [LinePanel(_PHOTONS, "deviation from a straight line (%)", lines)]
    )
    figure.axes[0].errorbar(
        light.at, table["counted_percent"], error_percent, fmt="none", lw=1, color="0.5"
    )
    return figure, table


@figure(
    "dark_current", "Dark current: the slopes of mean and variance, and its rise with temperature."
)
def _dark_current_plate(sheet: DataSheet) -> Drawing:
    """Draw mean and variance of dark frames against integration time, and the dark current against
    temperature.
    """
    dark = sheet.dark_series
    gain = sheet.transfer.gain_dn_per_e.value
    temperatures_k, warm_currents = sheet.warm_currents
    table: dict[str, Array] = {
        "integration_s": dark.at,
        "mean_e": dark.mean_dn / gain,
        "variance_e2": dark.variance_dn2 / gain**2,
        "mean_dn": dark.mean_dn,
        "variance_dn2": dark.variance_dn2,
        "temperature_k": temperatures_k,
        "dark_current_e_per_s": np.array([current.value for current in warm_currents]),
    }
    panels = []
    for name, label in (("mean_e", "dark mean (e⁻)"), ("variance_e2", "dark variance (e⁻²)")):
        slope, start = straight_line(dark.at, table[name], np.zeros_like(dark.at))
        table[f"fitted_{name}"] = start.value + slope.value * dark.at
        lines = (
            Line("integration_s", name, "measured", POINTS),
            Line("integration_s", f"fitted_{name}", "fit"),
        )
        panels.append(LinePanel("integration time (s)", label, lines))
    if warm_currents:
        line = Line("temperature_k", "dark_current_e_per_s", style=POINTS)
        panels.append(
            LinePanel("temperature (K)", "dark current (e⁻/s)", (line,), axes={"yscale": "log"})
        )
    figure, _ = draw_panels(table, panels)
    if warm_currents:
        plain_powers(figure.axes[-1].yaxis)
    return figure, table


def deviations(sheet: DataSheet) -> dict[str, Array]:
    """Return the maps of `MAPS`: the mean dark image in electrons and the mean response in per
    cent, each minus its mean.
    """
    dark_dn = sheet.dark_stack.mean_dn
    light = sheet.bright_stack.mean_dn - dark_dn
    return {
        "dsnu": (dark_dn - dark_dn.mean()) / sheet.transfer.gain_dn_per_e.value,
        "prnu": 100 * (light / light.mean() - 1),
    }


@figure("histograms", "Histograms of the mean dark image and response.")
def _histogram_plate(sheet: DataSheet) -> Drawing:
    """Draw logarithmic histograms of the stacks' mean images, with normal distributions of the same
    spread.
    """
    table: dict[str, Array] = {}
    panels = []
    for name, deviation in deviations(sheet).items():
        limit = 1.02 * max(float(np.abs(deviation).max()), 1e-9)
        counts, edges = np.histogram(deviation, np.linspace(-limit, limit, _BINS + 1))
        centres = (edges[1:] + edges[:-1]) / 2
        sigma = max(float(deviation.std()), 1e-12)
        normal = (
            deviation.size
            * np.diff(edges)
            / (sigma * np.sqrt(2 * np.pi))
            * np.exp(-((centres / sigma) ** 2) / 2)
        )
        table |= {f"{name}_bin": centres, f"{name}_pixels": counts, f"{name}_normal": normal}
        lines = (
            Line(
                f"{name}_bin", f"{name}_pixels", f"{name.upper()}: {deviation.size} pixels", STEPS
            ),
            Line(f"{name}_bin", f"{name}_normal", "normal distribution"),
        )
        panels.append(
            LinePanel(
                MAPS[name],
                "pixels per bin",
                lines,
                axes={"yscale": "log", "ylim": (0.5, 3 * counts.max())},
            )
        )
    return draw_panels(table, panels)


def spectrogram(map_: Array, axis: int) -> tuple[Array, Array]:
    """Return frequencies (periods per pixel) and the mean power spectrum along an axis of a map
    (EMVA 1288, section 8.4).
    """
    power = np.abs(np.fft.rfft(map_ - map_.mean(), axis=axis)) ** 2 / map_.shape[axis]
    return np.asarray(np.fft.rfftfreq(map_.shape[axis]), float), np.asarray(
        power.mean(axis=1 - axis)
    )


@figure("spectrograms", "Spectrograms along rows (horizontal) and columns (vertical).")
def _spectrogram_plate(sheet: DataSheet) -> Drawing:
    """Square roots of the power spectra along rows and columns, drawn from the first period on."""
    table: dict[str, Array] = {}
    panels = []
    for name, deviation in deviations(sheet).items():
        lines = []
        for direction, axis in (("horizontal", 1), ("vertical", 0)):
            x = f"{name}_{direction}_frequency"
            y = f"{name}_{direction}_amplitude"
            table[x], power = spectrogram(deviation, axis)
            table[y] = np.sqrt(power)
            lines.append(Line(x, y, f"{name.upper()}, {direction}", MARKED_LINE))
        unit = "e⁻" if name == "dsnu" else "%"
        panels.append(
            LinePanel("frequency (periods per pixel)", f"standard deviation ({unit})", lines)
        )
    figure, _ = draw_panels({column: values[1:] for column, values in table.items()}, panels)
    return figure, table


@figure("profiles", "Means of columns and rows minus the overall mean.")
def _profile_plate(sheet: DataSheet) -> Drawing:
    """Means of the columns and of the rows of the maps."""
    table: dict[str, Array] = {
        "column_or_row": np.arange(float(max(sheet.dark_stack.mean_dn.shape)))
    }
    panels = []
    for name, deviation in deviations(sheet).items():
        table |= {f"{name}_columns": deviation.mean(axis=0), f"{name}_rows": deviation.mean(axis=1)}
        lines = [
            Line(
                "column_or_row",
                f"{name}_{direction}",
                f"{name.upper()}, means of {direction}",
                MARKED_LINE,
            )
            for direction in ("columns", "rows")
        ]
        panels.append(LinePanel("column or row", MAPS[name], lines))
    return draw_panels(table, panels)


# smaller values are roundings of 0 in every unit of the sheet, except dark currents at very low
# temperature
ROUNDING = 1e-8
_HEADLINE = ("K", "η", "σ_d", "μ_e.sat")  # symbols
_MERGED_HEADLINE = ("μ_p.min.SNR_p", "μ_p.sat.general", "DR.SNR_p", "SNR_p.max")


def sheet_name(pixel: Pixel) -> str:
    return f"datasheet-{file_label(label_of(pixel.technology))}-{pixel.pitch_um:g}um"


def _value_text(value: float, digits: int = MAX_DIGITS) -> str:
    """Return a value in significant digits, 0 for the rounding of a 0."""
    return "0" if abs(value) < ROUNDING else number(value, digits)


def _measured_text(entry: Entry) -> str:
    """Return a measured value with the digits that its standard error allows."""
    if math.isfinite(entry.measured) and entry.standard_error > 0:
        return within_error(entry.measured, entry.standard_error)
    return _value_text(entry.measured)


def _datasheet_answer(sheet: DataSheet) -> Answer:
    """Return the most important values, and the pixel and the measurement that they are of."""
    experiment = sheet.experiment
    physics = sheet.experiment.physics
    readout = experiment.readout
    entries = {entry.symbol: entry for entry in sheet.entries}
    values = ", ".join(
        f"{symbol} {_measured_text(entries[symbol])} {entries[symbol].unit}"
        for symbol in (_MERGED_HEADLINE if experiment.is_merged else _HEADLINE)
    )
    filters = f", filters {physics.layout}" if physics.layout else ""
    channel = f" on channel {physics.channel}" if physics.channel else ""
    gain = f", {readout.gain_db:g} dB" if readout.gain_db else ""
    rows, columns = experiment.sensor.shape
    return headline(
        [
            (
                f"{label_of(physics.technology.name)}, {physics.pitch_um:g} µm pixels{filters},"
                f" {readout.adc.bits} bits: {values}"
            ),
            (
                f"black level {readout.adc.black_level_dn:g} DN, {physics.pixel.temperature_k:g} K,"
                f" {columns} × {rows} pixels, {experiment.wavelength_nm:g} nm{channel},"
                f" {exposure_time(experiment.integration_s)}{gain}"
            ),
            physics.pixel.assumption or "",
        ]
    )


COLUMNS = ("quantity", "symbol", "measured", "standard error", "true", "unit")
_TEXT_COLUMNS = (1, 5)  # columns


def _entry_rows(sheet: DataSheet) -> list[tuple[str, ...]]:
    """Return the lines of the sheet in `COLUMNS`, below the name of their standard."""
    rows: list[tuple[str, ...]] = []
    for standard, entries in groupby(sheet.entries, attrgetter("standard")):
        rows.append((standard,))
        for entry in entries:
            error = _value_text(entry.standard_error, 2)
            true = _value_text(entry.true)
            rows.append(
                (entry.quantity, entry.symbol, _measured_text(entry), error, true, entry.unit)
            )
    return rows


def datasheet_notes(sheet: DataSheet) -> list[Note]:
    """Return what limits the measurements: settings that were changed for them, and models that do
    not hold.
    """
    experiment = sheet.experiment
    pixel = experiment.pixel
    readout = experiment.readout
    texts = []
    if experiment.is_merged:
        first, *others = (reading.name for reading in experiment.whole.readout.readings)
        texts.append(
            f"EMVA 1288 General is that of the merge of {first} and {', '.join(others)}, whose few"
            " full readings that pass as valid scatter SNR_p beyond its standard error; all other"
            f" values are those of the reading {first} without errors of its gain and black level"
        )
    if readout.adc.knees is not None:
        texts.append(
            "companded codes are decoded to linear DN, but for EMVA 1288 General; variances contain"
            " their rounding"
        )
    if experiment.stated_black_dn not in (None, pixel.black_level_dn):
        texts.append(
            f"black level raised from {experiment.stated_black_dn:g} to"
            f" {pixel.black_level_dn:g} DN, 6 σ of the dark noise, so that the dark frames are not"
            " clipped at 0 DN"
        )
    if readout.adc_range_e < readout.full_well_e:
        clip_e, well_e = distinct_texts(readout.adc_range_e, readout.full_well_e, 3)
        texts.append(
            f"the ADC clips at {clip_e} e-, before the well of {well_e} e-: the saturation capacity"
            " is that of the ADC"
        )
    if sheet.transfer.limited:
        texts.append(
            f"quantisation-limited: σ²_y.dark = {sheet.dark.variance_dn2:.3g} DN² is below 0.24"
            " DN². σ_d is an upper bound, and K and the values derived from it are wrong by a few"
            f" per cent. Use more than {pixel.bits} bits (pixel.bits)."
        )
    if isinstance(sheet.colour, str):
        texts.append(f"no colour matrix: {sheet.colour}")
    if sheet.full_in_the_dark:
        texts.append(
            f"hot pixels: {100 * sheet.full_in_the_dark:.2g} % of the pixels are full at the"
            " longest exposure of the dark series: the measured dark current is too low"
        )
    if pixel.conversion != "linear":
        texts.append(
            "conversion = 'junction': the gain changes as the well fills, and the linear model of"
            " EMVA 1288 does not hold. K, R and η are means over the fitted range; the true values"
            " refer to the charge."
        )
    return [Note("data_sheet", words=text) for text in texts]


def _measurement_words(sheet: DataSheet) -> str:
    """Return how the values were measured, and of which pixels."""
    physics = sheet.experiment.physics
    side = sheet.experiment.readout.bin_side
    words = (
        "Measured on frames of one simulated device. datasheet.csv has the source of each true"
        " value."
    )
    if physics.layout is not None:
        words += (
            f" Values without a channel are those of {physics.channel}; gain and dark values are"
            " those of all channels."
        )
    if side > 1:
        words += f" A pixel is the sum of {side} × {side} pixels of {physics.pitch_um:g} µm."
    return words


def _datasheet_data(sheet: DataSheet, notes: Sequence[Note]) -> dict[str, Any]:
    """Return summary.json."""
    experiment = sheet.experiment
    content = {
        "pixel": experiment.pixel.model_dump(),
        "assumption": experiment.physics.pixel.assumption,
        **{
            name: getattr(experiment, name)
            for name in ("wavelength_nm", "integration_s", "stack_frames", "seed")
        },
        "gain_db": experiment.readout.gain_db,
        "shape": list(experiment.sensor.shape),
        "exposures": experiment.photons.size,
        "black_level_asked_dn": experiment.stated_black_dn,
        "quantisation_limited": sheet.transfer.limited,
        "entries": [entry.as_dict() for entry in sheet.entries],
    }
    settings = {
        "pixel": experiment.pixel.model_dump(mode="json", exclude_none=True),
        "seed": experiment.seed,
    }
    return result_data(content, settings=settings, notes=notes, table="datasheet.csv")


def _datasheet_csv(sheet: DataSheet) -> str:
    """Return a row for each line of the data sheet as CSV."""
    return rows_csv([entry.as_dict() for entry in sheet.entries])


def datasheet_document(sheet: DataSheet) -> Document:
    """Return the page of a data sheet: the photon transfer, the notes, the values beside the true
    ones, further figures.
    """
    notes = datasheet_notes(sheet)
    plates = _PLATES if sheet.curve is None else (_characteristic_plate, *_PLATES)
    first, *others = (Plot(partial(draw_plate, sheet)) for draw_plate in plates)
    pixel = sheet.experiment.pixel.model_dump(exclude_defaults=True, exclude_none=True)
    settings = pairs("pixel", {name: setting_value(value) for name, value in pixel.items()})
    values = DocumentTable(
        "measured and true values", COLUMNS, _entry_rows(sheet), words=_TEXT_COLUMNS, stacks=True
    )
    return Document(
        command="datasheet",
        kind="data sheet of one simulated sensor",
        title=f"Data sheet of {sheet.experiment.pixel.pitch_um:g} µm pixels",
        data=_datasheet_data(sheet, notes),
        answers=(_datasheet_answer(sheet),),
        lead=(first, *notes),
        sections=(
            Section("values", "Measured and true values", (values,), brief=True),
            Section("figures", "Figures", others),
            Section("made", "How it was made", (_measurement_words(sheet), settings), folded=True),
        ),
        files={"datasheet.csv": _datasheet_csv(sheet)},
    )


_PLATES = (
    _photon_transfer_plate,
    _responsivity_plate,
    _snr_plate,
    _linearity_plate,
    _dark_current_plate,
    _histogram_plate,
    _spectrogram_plate,
    _profile_plate,
)
PRESENTER = Presenter(
    document=datasheet_document, figure=_photon_transfer_plate, csv=_datasheet_csv
)
