"""The document of a run, and its files: all of them, or none."""

from __future__ import annotations

import math
import shlex
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from pixsim.base.digits import (
    ROUNDING,
    estimate,
    exposure_time,
    percent,
    pixel_size,
    rounded,
    span,
    with_error,
)
from pixsim.base.files import KNEES_SUFFIX
from pixsim.base.notes import Note, warn
from pixsim.base.progress import Progress
from pixsim.base.schema import result_data
from pixsim.base.tables import plain
from pixsim.base.toml import SETTINGS_FILE
from pixsim.light.exr import reduced_to_fit, write_channels, write_exr
from pixsim.light.quantities import ILLUMINANCE, IRRADIANCE
from pixsim.optics.lens_defocus import depth_of_field_m, finite_or_none
from pixsim.report.neq import NEQ, neq_against_frequency
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words, whole_picture
from pixsim.report.score import judged_by_delta_e, score_plate, shown_mean
from pixsim.report.settings import UNSTATED_NOISE, scene_rows, settings_blocks, settings_tables
from pixsim.report.snr import SNR, snr_section
from pixsim.report.target import enlarged, marked, place_of
from pixsim.report.wording import (
    DELTA_E as DELTA_E_WORDS,
    film_words,
    lens_words,
    part_words,
    reflectance_words,
    rendered_words,
    thin_lens_words,
    unconverged,
    view_words,
)
from pixsim.scene.convergence import repeatable_settings
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.raw import write_frame
from pixsim.show.document import (
    Answer,
    Block,
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Map,
    Pictures,
    Plot,
    Section,
    Slider,
    Strong,
    Text,
    plain_text,
)
from pixsim.show.pages import Plate, figure_files
from pixsim.show.pictures import delta_e_png, factor_for, light_png, scale, scale_end, worst_window
from pixsim.show.presenter import Presenter
from pixsim.show.render import PAGE
from pixsim.studies.files import scene_copy, scene_table, settings_text, stated_settings
from pixsim.studies.merit import detail_terms, extent, run_neq, run_snr
from pixsim.studies.run import RunResult, Threshold
from pixsim.studies.table import ROWS_FILE, Store
from pixsim.viewer.causes import SATURATED_SHOWN
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.display import white_light
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.raw_metrics import DETECTABILITY, SNR10_LX, contrast_factor
from pixsim.viewer.requirements import RequirementCheck
from pixsim.viewer.screen import LightLevel
from pixsim.viewer.setting import stage_words
from pixsim.viewer.settings_file import scene_options

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.studies.prepare import Job
    from pixsim.viewer.noise_budget import NoiseBudget
    from pixsim.viewer.setting import Run

_BESIDE_TARGET = 30  # % of the width, where the border between two pictures hides no target
FILES = (  # next to the page
    "score.json",
    ROWS_FILE,
    "irradiance.exr",
    "raw.exr",
    "ideal.png",
    "image.png",
    "delta_e.exr",
    "delta_e.png",
    SETTINGS_FILE,
    "pixsim.json",
)
STATISTICS_WORDS = {
    "pitch_um": "pixel size, centre to centre (µm)",
    "fill_factor": "photodiode area over pixel area",
    "full_well_e": "full well (electrons)",
    "integration_s": "exposure time (s)",
    "saturated_fraction": "fraction of saturated pixels: at full well, or at the ADC's top code",
    "share_of_full_well": "mean charge of the brightest pixel over the full well",
    "mean_electrons_e": "mean photo-electrons per pixel",
    "mean_delta_e": "mean ΔE",
    "median_delta_e": "median ΔE",
    "p90_delta_e": "90th percentile of ΔE over dots",
    "p99_delta_e": "99th percentile of ΔE over dots",
    "max_delta_e": "largest ΔE",
}


def colour_rows(
    facts: Mapping[str, Any] | None, out_of_gamut: tuple[float, float] | None
) -> list[tuple[str, str]]:
    """Return the rows of a colour sensor and its picture, (meaning, value) each; empty for a
    monochrome sensor.

    facts : `ImagingChain.colour_facts`
    out_of_gamut : of its score
    """
    if facts is None or out_of_gamut is None:
        return []
    ideal_share, sensor_share = out_of_gamut
    return [
        ("channels of a frame: rows of the unit cell, or planes", str(facts["layout"])),
        ("light of white, for white balance, matrix and ideal image", str(facts["white_spectrum"])),
        (
            "noise gains of the matrix in red, green, blue",
            ", ".join(rounded(gain, 4) for gain in facts["noise_gains"]),
        ),
        (
            "sensitivity metamerism index under this lamp (100: no colour error)",
            rounded(facts["sensitivity_metamerism_index"], 4),
        ),
        (
            "mean ΔE of patches 1-18 of a ColorChecker behind the matrix, without noise",
            rounded(facts["patches_mean_delta_e"], 4),
        ),
        ("dots outside the display's gamut: the ideal image", percent(ideal_share, 2)),
        ("dots outside the display's gamut: the sensor's picture", percent(sensor_share, 2)),
    ]


COLOUR = (
    "Both pictures are in colour: black level and dark charge are subtracted, white is balanced,"
    " the channels are interpolated to each pixel, and one matrix, fitted to a ColorChecker under"
    " the scene's lamp, converts them to the light of the display's primaries. The larger its"
    " noise gains, the more of the sensor's noise is seen as colour."
)


Irradiance = Literal["reduced", "full", "factors", "none"]  # what irradiance.exr holds


class RunFiles(NamedTuple):
    """What is written of a run beside numbers, pictures and the page.

    raw_suffixes : further formats of the frames besides .exr
    irradiance : what irradiance.exr holds: 'reduced', bands of at most 1024 samples across and 60
        MB; 'full', what `read_exr` gives back bit for bit; 'factors', an image's factors only;
        'none', no such file
    noise_budget : whether there is one
    """

    raw_suffixes: tuple[str, ...] = ()
    irradiance: Irradiance = "reduced"
    noise_budget: bool = False

    @property
    def formats(self) -> tuple[str, ...]:
        """Suffixes of all files of a frame."""
        return tuple(dict.fromkeys((".exr", *self.raw_suffixes)))

    def names(self, frames: int) -> set[str]:
        """Return the names of all files of a run of so many frames."""
        raw = {
            f"{_raw_stem(number)}{suffix}"
            for number in range(1, frames + 1)
            for suffix in (*self.formats, KNEES_SUFFIX)
        }
        figures = figure_files([NEQ, SNR, *[NAME] * self.noise_budget])
        return {PAGE, *FILES, *raw, *figures} - (
            {"irradiance.exr"} if self.irradiance == "none" else set()
        )


_DEFAULT_FILES = RunFiles()


def run_document(result: RunResult, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim run`, without the sections of its page and other files.

    warned : notes that a reader of the terminal has seen
    """
    header = result.irradiance.header
    has_delta_e = judged_by_delta_e(result.settings)
    scene = Path(
        str(header.get("scene", header.get("source", "a picture of another program")))
    ).stem
    answer = run_answer(result)
    new_notes = [note for note in notes(result) if note not in {*answer.below, *warned}]
    return Document(
        command="run",
        kind="picture of one sensor",
        title=f"{scene} with {result.score.physics.pitch_um:g} µm pixels",
        data=data(result),
        answers=(answer,),
        lead=(Plot(lambda: score_plate(result.score)), *facts(result), *new_notes),
        about=(DELTA_E_WORDS,) if has_delta_e else (),
        sections=(snr_section(run_snr(result)), budgets_section(_budgets_of(result))),
        data_file="score.json",
    )


def run_page(
    result: RunResult, files: RunFiles = _DEFAULT_FILES, progress: Progress | None = None
) -> Document:
    """Return the document of a run with its page and all other files.

    progress : of the frames
    """
    score = result.score
    irradiance = result.irradiance
    if files.irradiance == "factors" and not irradiance.factors:
        words = (
            "the light has no factors (spectrum × picture): irradiance.exr holds its bands in full"
        )
        warn(Note("file_as_read", words=words))

    def write_light(folder: Path) -> None:
        if files.irradiance != "none":
            light = reduced_to_fit(irradiance) if files.irradiance == "reduced" else irradiance
            write_exr(folder / "irradiance.exr", light, factors_only=files.irradiance == "factors")

    def write_arrays(folder: Path) -> None:
        write_channels(folder / "delta_e.exr", {"delta_e": score.delta_e}, {})
        for number, frame in enumerate(chain([score.frame], result.further_frames()), 1):
            for suffix in files.formats:
                write_frame(folder / f"{_raw_stem(number)}{suffix}", frame)
            if progress is not None:
                progress(number / result.prepared.frames)

    document = run_document(result)
    end = scale_end(result.statistics[0]["p99_delta_e"])
    delta_e = delta_e_png(score.delta_e, picture_axes(irradiance, score.border_um), end)
    ideal = whole_picture(score.ideal, "ideal image")
    sensor = whole_picture(score.image, f"{pixel_size(score.physics.pitch_um)} pixels")
    pictures: list[Block] = [Slider("slider", "", ideal, (sensor,))]
    place = place_of(result)
    if place is not None:
        ideal, sensor = (marked(picture, result, place) for picture in (ideal, sensor))
        heading = "The frame in the middle marks the target"
        pictures = [
            Slider("slider", heading, ideal, (sensor,), at=_BESIDE_TARGET),
            *enlarged(result, place),
        ]
    return replace(
        document,
        lead=(*pictures, *tuple(document.lead)[1:]),
        sections=(*_sections(result, delta_e), *document.sections),
        writers=(write_light, write_arrays),  # the largest file by far first
        files={
            "ideal.png": light_png(score.ideal),
            "image.png": light_png(score.image),
            "delta_e.png": delta_e,
            SETTINGS_FILE: partial(run_settings_text, result.prepared, irradiance),
            ROWS_FILE: _run_csv(result),
            **scene_copy(result.prepared.file),
        },
    )


def _run_plate(result: RunResult) -> Plate:
    """Return the figure of the ideal image, the sensor's image and the ΔE map with its scale."""
    return score_plate(result.score)


def _run_csv(result: RunResult) -> str:
    """Return results.csv: a row for each sensor, with the hash of all that it depends on."""
    store = Store(None, (), result.table.metrics)
    names = ("technology", "pitch_um", "repeat", *store.numbers)
    return store.text(
        (key, *(row[name] for name in names))
        for key, row in zip(result.keys, result.table, strict=True)
    )


# --- numbers for programs


def data(result: RunResult) -> dict[str, Any]:
    """Return score.json: the results of the first sensor, then the settings, and the numbers of
    further sensors.

    `pixels` and `scored_dots` are rows and columns; `border_um`, above and to the left, is the
    border that is not scored. `in_focus_m` are the nearest and the farthest depth with a blur disc
    of a pixel at most, the farthest null if infinite.
    """
    settings = result.settings
    score = result.score
    in_focus_m = depth_of_field_m(result.camera, score.physics.read_pitch_um)
    content = {
        **plain(result.statistics[0]),
        "pixels": list(score.frame.pixels),
        "scored_dots": list(score.delta_e.shape),
        "border_um": list(score.border_um),
        "pixel": score.physics.pixel.model_dump(),
        "assumption": assumption(result),
        "white_spectrum": white_light(result.irradiance)[1],
        "irradiance": result.irradiance.header,
        "dark": result.dark,
        "causes": [cause.as_dict() for cause in result.causes],
        "camera": result.camera.model_dump(),
        "in_focus_m": finite_or_none(in_focus_m),
        "exposure": settings.exposure.model_dump(),
        "correction": settings.correction.model_dump(),
        "display": settings.display.model_dump(),
        "seed": settings.seed,
        "chosen": {**result.prepared.view},
        **_render_data(result),
        **_metrics_data(result),
        **_optional_settings_data(result),
    }
    if result.requirement_checks:
        content["requirements"] = [
            {
                "requirement": str(check.requirement),
                "value": check.value,
                "interval": list(check.interval),
                "met": check.is_met,
                "sure": check.is_sure,
            }
            for check in result.requirement_checks
        ]
    if result.noise_budget:
        content["noise_budget"] = result.noise_budget.as_dict()

    columns = result.table.columns
    values = {
        metric.name: float(columns[metric.columns[0]].mean())
        for metric in metrics_named(settings.metrics)
    }
    case = {"at": {}, "sensor": result.prepared.cases[0].sensor, "values": plain(values)}
    return result_data(
        content,
        settings=stated_settings(settings),
        notes=notes(result),
        cases=[case],
        table=ROWS_FILE,
    )


def _render_data(result: RunResult) -> dict[str, Any]:
    """Return the entries of score.json about the render; empty for light from a file."""
    rendered = result.rendered
    if not (rendered and rendered.noise and result.plan):
        return {}

    entries: dict[str, Any] = {
        "render_noise": asdict(rendered.noise),
        "plan": result.plan.as_dict(),
        "film": result.film,
    }
    if result.settings.window_mm:
        entries["window_mm"] = result.settings.window_mm
    return entries


def _metrics_data(result: RunResult) -> dict[str, Any]:
    """Return the entries of score.json about several sensors, metrics beside ΔE, and a threshold of
    detectability.
    """
    entries: dict[str, Any] = {}
    if result.interval_delta_e is not None:
        entries |= {
            "repeats": result.delta_e.size,
            "delta_e": result.delta_e.tolist(),
            "sensors_mean_delta_e": result.mean_delta_e,
            "interval_delta_e": list(result.interval_delta_e),
        }
    if result.judged:
        means = {name: float(values.mean()) for name, values in result.judged.items()}
        entries["metrics"] = plain(means)
        if result.delta_e.size > 1:
            intervals = {
                metric.name: result.interval(result.judged[metric.name], metric.columns[0])
                for metric in metrics_named(list(result.judged))
            }
            entries["metric_intervals"] = intervals
    if (threshold := result.threshold) is not None:
        entries["at_threshold"] = {
            "parameter": threshold.parameter,
            "detectability": threshold.threshold,
            "value": threshold.value,
            "upper_value": threshold.upper_value,
            "why_not": threshold.reason,
        }
    return entries


def _optional_settings_data(result: RunResult) -> dict[str, Any]:
    """Return the entries of score.json about colour, development, motion and frames, where a run
    has them.
    """
    settings = result.settings
    entries: dict[str, Any] = {}
    if result.colour is not None or settings.develop.words:
        entries["develop"] = settings.develop.model_dump()
    if result.colour is not None:
        entries["colour"] = result.colour
    if settings.develop.sharpens:
        entries["sharpening_noise_gain"] = result.chain.development.sharpening_noise_gain
    if settings.motion.is_on:
        entries["motion"] = settings.motion.model_dump()
    if result.prepared.frames > 1:
        entries["frames"] = result.prepared.frames
    return entries


# --- notes


def notes(result: RunResult) -> list[Note]:
    """Return the notes of a run: causes of its ΔE, warnings, and a black level that clips dark
    noise.
    """
    return list(
        dict.fromkeys(
            [*(cause.note for cause in result.causes), *result.warned, *dark_notes(result)]
        )
    )


def dark_notes(result: RunResult) -> list[Note]:
    """Return a note on the clipping of dark pixels at 0 DN; empty if it is not visible, or a
    correction removes its mean.
    """
    if result.settings.correction.removes_dark_level or not clips_dark(result.dark):
        return []
    return [clip_note(result.dark, result.settings.pixel.model_dump())]


def assumption(result: RunResult) -> str:
    """Return the assumptions about technology and lens, where no setting states them, as text."""
    if result.prepared.cases[0].picture:
        lens_assumption = ""
    else:
        lens_assumption = result.prepared.stated.camera.assumption(result.camera)
    return "; ".join(filter(None, (result.settings.pixel.assumption, lens_assumption)))


# --- words


def run_answer(result: RunResult) -> Answer:
    """Return the answer of a run: the value of its first metric, and below it what makes its ΔE
    uncertain.
    """
    first, *_ = metrics_named(result.settings.metrics)
    return Answer(
        _metric_text(result, first),
        _uncertain_metrics_words(result) if judged_by_delta_e(result.settings) else (),
    )


def facts(result: RunResult) -> Iterator[Block]:
    """Yield the checks of requirements, the values of the other metrics, the numbers of sensors and
    frames, and the set-up.
    """
    yield from (Fact(_requirement_text(check)) for check in result.requirement_checks)
    for metric in metrics_named(result.settings.metrics)[1:]:
        yield Fact(plain_text(_metric_text(result, metric)))
    if result.interval_delta_e is not None:
        words = f"{result.delta_e.size} sensors{'' if result.is_spread else ' at one registration'}"
        if judged_by_delta_e(result.settings):
            words += (
                ", with a mean ΔE of"
                f" {span(estimate(result.delta_e.min()), estimate(result.delta_e.max()))}"
            )
        yield Fact(f"{words}; pictures and frames are those of the first")
    if (frames := result.prepared.frames) > 1:
        yield Fact(
            f"{frames} frames of this sensor: raw.exr to {_raw_stem(frames)}.exr; the first is"
            " scored"
        )
    yield from map(Fact, _setup_words(result))


def _requirement_text(check: RequirementCheck) -> Text:
    """Return whether a requirement is met, and that this is not sure where the limit lies within
    the interval.
    """
    low, high = check.interval
    half = (high - low) / 2
    value = with_error(check.value, half) if 0 < half < math.inf else estimate(check.value)
    met_words = "met" if check.is_met else "not met"
    unsure_words = "" if check.is_sure else "; not sure, the limit is within the 95 % interval"
    return f"required {check.requirement}: ", Strong(met_words), f" ({value}){unsure_words}"


def _metric_text(result: RunResult, metric: Metric) -> Text:
    """Return the value of a metric in words, with half of its 95 % interval over several sensors;
    for a metric other than ΔE also the picture or frame that it judges.
    """
    if metric is DELTA_E:
        return "mean ΔE ", Strong(shown_mean_of(result))
    values = result.judged[metric.name]
    mean = float(values.mean())
    if math.isnan(mean):  # a note says why
        unseen = "not known whether it is seen: " if metric is DETECTABILITY else ""
        return f"{unseen}{metric.words} is not given"
    low, high = result.interval(values, metric.columns[0]) or (mean, mean)
    half = (high - low) / 2
    value = with_error(mean, half) if half > ROUNDING * abs(mean) else estimate(mean)
    judged_words = f"one {metric.judges}" if values.size == 1 else f"the {metric.judges}"
    text: Text = (
        f"{metric.words} ",
        Strong(f"{value} {metric.unit}".rstrip()),
        f", of {judged_words}",
    )
    if metric is DETECTABILITY:
        threshold = result.settings.metric.detectability.threshold
        verdict = Strong("seen" if mean >= threshold else "not seen")
        is_sure = not low <= threshold <= high or low == high
        unsure = "" if is_sure else f" (not sure: {threshold:g} is within the 95 % interval)"
        return (verdict, f"{unsure}: ", *text, f"; {_threshold_words(result, mean)}")
    if metric is SNR10_LX:
        wall = result.settings.metric.snr10_lx.reflectance
        return (*text, f", on a wall of reflectance {wall:g}")
    return text


def _threshold_words(result: RunResult, d_prime: float) -> str:
    """Return where a target is seen as well as the threshold asks: at a value of the scene, or at a
    part of its contrast.
    """
    if result.threshold is not None:
        return _threshold_pitch_words(result.threshold, result.irradiance.header)
    threshold = result.settings.metric.detectability.threshold
    factor, reason = contrast_factor(
        result.chain.expected(result.score.frame.integration_s), d_prime
    )
    if not reason:
        return (
            f"{threshold:g} is reached at {rounded(factor, 3)} times this contrast, where contrasts"
            " are small"
        )
    return f"no multiple of its contrast reaches {threshold:g}: {reason}"


def _threshold_pitch_words(threshold: Threshold, header: Mapping[str, Any]) -> str:
    """Return at which values of the scene's parameter a target is seen.

    header : of the irradiance
    """
    is_light = threshold.parameter in (ILLUMINANCE, IRRADIANCE)
    surface = f", {reflectance_words(header)}" if is_light else ""
    lower = threshold.value
    upper = threshold.upper_value
    if lower is None and upper is None:
        tried = span(min(threshold.tried), max(threshold.tried), ".4g")
        reason = f": {threshold.reason}" if threshold.reason else ""
        where = f"{threshold.parameter} of {tried}{surface}"
        return f"{threshold.threshold:g} is not reached at {where}{reason}"
    lower_words = "" if lower is None else f" from {rounded(lower, 3)} on"
    upper_words = "" if upper is None else f" up to {rounded(upper, 3)}"
    where = f"{threshold.parameter}{lower_words}{upper_words}{surface}"
    return f"{threshold.threshold:g} is reached at {where}"


def shown_mean_of(result: RunResult) -> str:
    """Return mean ΔE over all sensors as text, with its interval and the error of its light."""
    mean = result.mean_delta_e
    half = 0.0 if result.interval_delta_e is None else result.interval_delta_e[1] - mean
    return shown_mean(mean, result.light, result.light_limit, result.causes, half)


def _uncertain_metrics_words(result: RunResult) -> list[str]:
    """Return the lines that follow a run's mean ΔE: its causes, and the errors of its light."""
    film = result.rendered.film if result.rendered else None
    return [*map(str, result.causes), *unconverged(result.irradiance.header, film)]


def _setup_words(result: RunResult) -> list[str]:
    """Return the lines on pixels and exposure, on development, and on display and render."""
    settings = result.settings
    rows, columns = result.score.frame.pixels
    pixels = f"{columns} × {rows} pixels of {result.score.physics.pitch_um:g} µm"
    exposure_line = ", ".join([f"{pixels}, {_exposure_words(result)}", *stage_words(settings)])

    view = view_words(
        settings.display,
        result.irradiance.header,
        result.prepared.view,
        settings.window_mm,
        columns,
    )
    light = _light_words(result) if judged_by_delta_e(settings) else []
    part = part_words(result.irradiance.header)
    view_parts = (part, *view, lens_words(result.camera), assumption(result), *light)
    view_line = "; ".join(filter(None, view_parts))

    developed = developed_words(settings.develop, [settings.pixel])
    return list(filter(None, (exposure_line, developed, view_line)))


def _exposure_words(result: RunResult) -> str:
    """Return the exposure time, whether it is the longest that is allowed, and the share of
    saturated pixels if that is visible.
    """
    frame = result.score.frame
    exposure = result.settings.exposure
    words = f"exposed for {exposure_time(frame.integration_s)}"
    longest_s = exposure.times * exposure.max_integration_s
    if exposure.integration_s is None and frame.integration_s >= longest_s:
        words += " (the maximum)"
    if exposure.gain_db == "auto":
        words += f" at {frame.gain_db:.3g} dB"
    if frame.saturated_fraction > SATURATED_SHOWN:
        words += f", {percent(frame.saturated_fraction)} of them saturated"
    return words


_SHOWN_BIAS_DELTA_E = 0.01


def _light_words(result: RunResult) -> list[str]:
    """Return the words on the film and the render noise of a run, and on errors that were not
    measured.
    """
    noise = result.rendered.noise if result.rendered else None
    words = []
    if result.film:
        words.append(film_words(result.film))
    if noise:
        noise_words = "no render noise"
        if noise.fraction:
            noise_words = f"render noise {noise.fraction:.2g} of the sensor's noise"
            bias_delta_e = noise.bias.get(DELTA_E.columns[0], 0.0)
            if abs(bias_delta_e) >= _SHOWN_BIAS_DELTA_E:
                noise_words += f", whose {bias_delta_e:.2g} ΔE are taken off"
        words.append(noise_words)
    if "scene_hash" in result.irradiance.header:
        unmeasured = {
            "the film's error": result.light.film_delta_e,
            "render noise": result.light.noise_delta_e,
        }
        words += [f"{name} not measured" for name, delta_e in unmeasured.items() if delta_e is None]
    return words


# --- the page


def _sections(result: RunResult, delta_e: bytes) -> Iterator[Section]:
    """Yield the sections of the page.

    delta_e : the map of the errors, as PNG
    """
    if judged_by_delta_e(result.settings):
        yield Section("errors", "Where the errors are", _errors(result, delta_e), together=True)
    quanta = run_neq(result)
    yield Section(
        "numbers",
        "Numbers",
        (DocumentTable("numbers of this picture", (), _numbers(result), words=None),),
    )
    yield Section(
        "neq",
        "Noise-equivalent quanta",
        (Plot(lambda: neq_against_frequency(quanta)),) if quanta else (),
    )
    colour = colour_rows(result.colour, result.score.out_of_gamut)
    yield Section(
        "colour",
        "Colour",
        (COLOUR, DocumentTable("numbers of the colours", (), colour)) if colour else (),
    )
    unstated = [UNSTATED_NOISE] if result.score.physics.technology.name == NO_TECHNOLOGY else []
    yield Section("settings", "Settings", [*settings_blocks(_settings(result)), *unstated])


def _errors(result: RunResult, delta_e: bytes) -> Iterator[Block]:
    """Yield the map of the errors, as PNG, and the detail with the largest ones."""
    score = result.score
    p99 = result.statistics[0]["p99_delta_e"]
    end = scale_end(p99)
    yield Map(delta_e, f"S-CIELAB ΔE. One dot in a hundred has more than {estimate(p99)}.")
    window = worst_window([score.delta_e])
    yield "The detail with the largest errors, dot for dot:"
    yield Pictures(
        (crops(score, window, "the sensor's picture", end),), "the detail with the largest errors"
    )
    yield DeltaEScale(scale(end))
    yield size_words(factor_for(score.ideal), result.settings.display.samples_per_deg)


def _shown_statistics(result: RunResult) -> list[str]:
    """Return the names of the statistics that are printed, by ΔE only where it is a metric."""
    has_delta_e = judged_by_delta_e(result.settings)
    return [name for name in result.statistics[0] if has_delta_e or not name.endswith("_delta_e")]


def _numbers(result: RunResult) -> Iterator[tuple[str, str]]:
    """Yield the meaning and the value of each number of the page: of the pixels, the light, the
    picture and its blur.
    """
    physics = result.score.physics
    width_mm, height_mm = extent(result.irradiance)[1:3]
    yield "die", f"{width_mm:.4g} × {height_mm:.4g} mm, {label_of(physics.technology.name)}"
    yield "lens", lens_words(result.camera) or thin_lens_words(result.camera)
    yield "irradiance", rendered_words(result.irradiance.header)

    statistics = result.statistics[0]
    for name in _shown_statistics(result):
        if name in STATISTICS_WORDS:
            if name.endswith("_delta_e"):
                value = estimate(statistics[name])
            else:
                value = rounded(statistics[name], 4)
            # A data sheet gives the numbers of the whole pixel
            if name != "fill_factor" or value != "1":
                yield STATISTICS_WORDS[name], value

    imaging = result.chain.imaging
    longest_path_um = result.chain.image_motion.longest_um
    frequency_lp_per_mm, name, sensor_terms, display_terms = detail_terms(
        imaging, result.irradiance, longest_path_um
    )
    for term, mtf in {**sensor_terms, **display_terms}.items():
        yield f"MTF at {frequency_lp_per_mm:.3g} lp/mm, {name}: {term}", estimate(mtf)


def _budgets_of(result: RunResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of a run by the words of its pixel; empty without the option."""
    budget = result.noise_budget
    return {} if budget is None else {f"{result.score.physics.pitch_um:g} µm": budget}


def _settings(result: RunResult) -> list[DocumentTable]:
    """Return the settings of a run, with their meaning and source."""
    from_data_sheet = result.score.physics.technology.name == NO_TECHNOLOGY
    settings = result.settings
    irradiance = result.irradiance
    light = LightLevel.of(irradiance, settings.display, [result.score.frame.integration_s])
    scene = scene_rows(irradiance, settings.scene.parameters, light)
    scene.append(
        ("seed", settings.seed, "of all random numbers", "set" if settings.seed else "default")
    )
    return settings_tables(
        scene,
        settings,
        result.camera,
        result.score.physics.pixel,
        result.colour is not None,
        from_data_sheet,
    )


def _raw_stem(number: int) -> str:
    """Return the name, without its suffix, of the file of a frame: raw, raw_002, raw_003, …; sorted
    names keep their order.
    """
    return "raw" if number == 1 else f"raw_{number:03d}"


def run_settings_text(
    prepared: Job[Run], irradiance: SpectralImage, folder: Path | None = None
) -> str:
    """Return the text of settings.toml, from which `pixsim run` makes the same numbers again.

    folder : of the file, from which paths in it begin; None states whole paths
    """
    imaging = prepared.cases[0].imaging
    assert imaging is not None
    options = {"sensor": prepared.sensor, "variant": prepared.variant, "units": prepared.units}
    options |= {
        name: str(value)
        for name, value in (("repeats", prepared.repeats), ("frames", prepared.frames))
        if value > 1
    }
    command = ["pixsim", "run", "--config", SETTINGS_FILE, *["--full"] * imaging.without_shortcuts]
    command += [word for name, value in options.items() if value for word in (f"--{name}", value)]
    settings = prepared.complete
    parameters: dict[str, Any] = {}
    if not prepared.cases[0].picture:
        # Display and chart, too, may have been chosen; defaults in their place would count as
        # given.
        settings = repeatable_settings(prepared.stated, irradiance).model_copy(
            update={"display": settings.display}
        )
        scene_folder = prepared.cases[0].scene.path.parent
        parameters = scene_table(scene_folder, prepared.complete.scene.parameters, folder)
    scene = scene_options(prepared.file, parameters)
    return settings_text(settings, shlex.join(command), folder=folder, scene=scene)


PRESENTER = Presenter(
    document=run_document,
    figure=_run_plate,
    csv=_run_csv,
    page=lambda result, _: run_page(result),
    has_figures=False,
)
