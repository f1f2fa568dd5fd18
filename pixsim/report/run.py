"""The document of a run, and its files: all of them, or none."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from pixsim.base.arrays import Array
from pixsim.base.digits import exposure_time, percent, rounded, span, with_error, within_error
from pixsim.base.files import digest_of
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import Note, warn
from pixsim.base.progress import Progress
from pixsim.base.schema import result_data
from pixsim.base.tables import plain
from pixsim.base.toml import SETTINGS_FILE
from pixsim.light.exr import reduced_to_fit, write_channels, write_exr
from pixsim.optics.lens_defocus import depth_of_field_m, finite_or_none
from pixsim.report.kept import digest_of_content
from pixsim.report.neq import NEQ, neq_against_frequency
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.score import score_plate, shown_mean
from pixsim.report.settings import UNSTATED, scene_rows, settings_blocks, settings_tables
from pixsim.report.wording import (
    DELTA_E as DELTA_E_WORDS,
    FILLED,
    film_words,
    lens_words,
    rendered_words,
    thin_lens_words,
    unconverged,
    view_words,
)
from pixsim.scene.convergence import without_clock
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.raw import write_frame
from pixsim.sensor.stages import stage_words
from pixsim.show.document import (
    Answer,
    Block,
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Link,
    Listed,
    Map,
    Pictures,
    Plot,
    Section,
    Slider,
    Strong,
    Text,
    has_room,
    headline,
    joined,
    pairs,
    plain_text,
)
from pixsim.show.pages import Plate, figure_files
from pixsim.show.pictures import Picture, delta_e_png, display_codes, factor_for, light_png, reduced, scale, scale_end, worst_window
from pixsim.show.presenter import PageOptions, Presenter
from pixsim.show.render import PAGE
from pixsim.studies.files import scene_table, settings_text
from pixsim.studies.merit import detail_terms, extent, quanta_of_run
from pixsim.studies.run import LitRun, RunResult, Threshold
from pixsim.studies.table import ROWS_FILE, Store
from pixsim.viewer.causes import SATURATED_SHOWN
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.display import white_light
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.raw_metrics import DETECTABILITY, contrast_factor
from pixsim.viewer.score import exceeded
from pixsim.viewer.screen import LightLevel

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.studies.prepare import Job
    from pixsim.viewer.noise_budget import NoiseBudget
    from pixsim.viewer.setting import Run

# Files next to the page, with their descriptions.
FILES = {
    "score.json": "all numbers and settings, for programs",
    ROWS_FILE: "numbers of the first frame of each sensor",
    "irradiance.exr": "light on the sensor, before diffraction",
    "raw.exr": "digital numbers of the sensor",
    "ideal.png": "image of an ideal camera, as shown",
    "image.png": "image of the sensor, as shown",
    "delta_e.exr": "S-CIELAB ΔE map, for programs",
    "delta_e.png": "S-CIELAB ΔE map, with axes",
    "settings.toml": "all settings: `pixsim run SCENE --config settings.toml` makes the same numbers again",
    "provenance.json": "versions and wall times",
}
MEANINGS = {
    "pitch_um": "pixel size, centre to centre (µm)",
    "fill_factor": "photodiode area over pixel area",
    "full_well_e": "full well (electrons)",
    "integration_s": "exposure time (s)",
    "saturated_fraction": "fraction of saturated pixels: at full well, or at the ADC's top code",
    "mean_electrons_e": "mean photo-electrons per pixel",
    "mean_delta_e": "mean ΔE",
    "median_delta_e": "median ΔE",
    "p90_delta_e": "90th percentile of ΔE over dots",
    "p99_delta_e": "99th percentile of ΔE over dots",
    "max_delta_e": "largest ΔE",
}
IDEALS = {
    True: "in colour: compare with colour sensors only, since that of a monochrome sensor is grey",
    False: "grey, as that of a monochrome sensor: the mean ΔE of both may be compared",
}


def colour_rows(facts: Mapping[str, Any] | None, out_of_gamut: tuple[float, float] | None) -> list[tuple[str, str]]:
    """Return what the page says of a colour sensor and its picture, (meaning, value) each; none for a monochrome one.

    facts : `ImagingChain.colour_facts`
    out_of_gamut : of its score
    """
    if facts is None or out_of_gamut is None:
        return []
    letters = list(facts["white_e"])
    gains = ", ".join(f"{gain:.3g}" for gain in facts["noise_gains"])
    return [
        ("channels of a frame: rows of the unit cell, or planes", facts["layout"]),
        ("light of white, for white balance, matrix and ideal image", facts["white_spectrum"]),
        (f"electrons of white in {', '.join(letters)}", ", ".join(rounded(value, 4) for value in facts["white_e"].values())),
        (f"matrix from balanced {', '.join(letters)} to the display's light, row of red", _row(facts, 0)),
        ("the same, row of green", _row(facts, 1)),
        ("the same, row of blue", _row(facts, 2)),
        ("noise gains of the matrix in red, green, blue", gains),
        ("sensitivity metamerism index under this lamp (100: no colour error)", f"{facts['sensitivity_metamerism_index']:.4g}"),
        ("mean ΔE of patches 1-18 of a ColorChecker behind the matrix, without noise", f"{facts['patches_mean_delta_e']:.3g}"),
        ("ideal image", IDEALS[facts["ideal_is_coloured"]]),
        ("dots outside the display's gamut: ideal image", percent(out_of_gamut[0], 2)),
        ("dots outside the display's gamut: the sensor's picture", percent(out_of_gamut[1], 2)),
    ]


def _row(facts: Mapping[str, Any], number: int) -> str:
    return ", ".join(f"{value:.4g}" for value in facts["matrix_to_display"][number])


COLOUR = (
    "Both pictures are in colour: black level and dark charge are subtracted, white is balanced, the channels are interpolated to "
    "each pixel, and one matrix, fitted to a ColorChecker under the scene's lamp, leads to the light of the display's primaries. "
    "The larger its noise gains, the more of the sensor's noise is seen as colour."
)


Irradiance = Literal["reduced", "full", "factors", "none"]  # what irradiance.exr holds


class RunFiles(NamedTuple):
    """What is written of a run beside numbers, pictures and the page.

    raw_suffixes : further formats of the frames besides .exr
    irradiance : what irradiance.exr holds: 'reduced', bands of at most 1024 samples across and 60 MB; 'full', what `read_exr`
        gives back bit for bit; 'factors', an image's factors only; 'none', no such file
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
        raw = {f"{raw_stem(number)}{suffix}" for number in range(1, frames + 1) for suffix in self.formats}
        figures = figure_files([NEQ, *[NAME] * self.noise_budget])
        return {PAGE, *FILES, *raw, *figures} - ({"irradiance.exr"} if self.irradiance == "none" else set())


USUAL = RunFiles()


def run_document(result: RunResult, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim run`, without the sections of its page and other files.

    warned : notes that a reader of the terminal has seen
    """
    header, pitch_um = result.irradiance.header, result.score.physics.pitch_um
    scene = Path(str(header.get("scene", header.get("source", "a picture of another program")))).stem
    content = data(result)
    answer = run_answer(result)
    stated = {*unsure_words(result), *warned} if judged_by_delta_e(result) else {*warned}
    lead = (*facts(result), *(note for note in notes(result) if note not in stated))
    numbers = pairs("statistics", {name: result.statistics[0][name] for name in shown_statistics(result)})
    return Document(
        command="run",
        kind="picture of one sensor",
        title=f"{scene} with {pitch_um:g} µm pixels",
        data=content,
        cell=(answer, Plot(lambda: score_plate(result.score)), numbers, *lead),
        answers=(answer,),
        lead=lead,
        about=(DELTA_E_WORDS,) if judged_by_delta_e(result) else (),
        sections=(budgets_section(budgets_of(result)),),
        data_file="score.json",
        sources=[Path(result.prepared.file)],
    )


def run_page(result: RunResult, files: RunFiles = USUAL, progress: Progress | None = None) -> Document:
    """Return the document of a run with its page and all other files.

    progress : of the frames
    """
    score, irradiance, frames = result.score, result.irradiance, result.prepared.frames
    if files.irradiance == "factors" and not irradiance.factors:
        words = "the light has no factors (spectrum × picture): irradiance.exr holds its bands in full"
        warn(Note("file_as_read", words=words))

    def write_light(folder: Path) -> None:
        if files.irradiance != "none":
            write_irradiance(folder / "irradiance.exr", irradiance, files.irradiance)
            digest_of(folder / "irradiance.exr", alone=True)  # which the provenance asks for

    def write_frames(folder: Path) -> None:
        write_numbers(result, folder, raw_stem, files.formats, lambda number: progress and progress(number / frames))

    def finish() -> Document:
        end = scale_end(result.statistics[0]["p99_delta_e"])
        pictures = {"ideal.png": light_png(score.ideal), "image.png": light_png(score.image)}
        pictures["delta_e.png"] = delta_e_png(score.delta_e, picture_axes(irradiance, score.border_um), end)
        settings = {SETTINGS_FILE: run_settings_text(result.prepared, irradiance)}
        return replace(
            document,
            lead=(_slider(result, pictures), *document.lead),
            sections=(*_sections(result, pictures, files), *document.sections),
            files={**pictures, **settings, ROWS_FILE: run_csv(result)},
        )

    document = run_document(result)
    return replace(document, writers=(write_light, write_frames), finish=finish)  # the largest file by far first


def run_plate(result: RunResult) -> Plate:
    """Return the figure of the ideal image, the sensor's image and the ΔE map with its scale."""
    return score_plate(result.score)


def run_csv(result: RunResult) -> str:
    """Return results.csv: a row for each sensor, with the hash of all that it depends on."""
    store = Store(None, (), result.table.metrics)
    names = ("technology", "pitch_um", "repeat", *store.numbers)
    return store.text((key, *(row[name] for name in names)) for key, row in zip(result.keys, result.table, strict=True))


# --- numbers for programs ---------------------------------------------------------------------------------------------------------


def data(result: RunResult) -> dict[str, Any]:
    """Return score.json: the results of the first sensor, then the settings, and what is known of further sensors.

    `pixels` and `scored_dots` are rows and columns; `border_um`, above and to the left, is the border that is not scored.
    `in_focus_m` are the nearest and the farthest depth with a blur disc of a pixel at most, the farthest null if infinite.
    """
    prepared, settings, score = result.prepared, result.settings, result.score
    more: dict[str, Any] = {"chosen": {**prepared.view}}
    if result.rendered and result.rendered.noise and result.plan:
        more |= {"render_noise": asdict(result.rendered.noise), "plan": result.plan.as_dict(), "film": result.film}
        more |= {"window_mm": settings.window_mm} if settings.window_mm else {}
    if prepared.repeats > 1 and result.interval_delta_e is not None:
        more |= {"repeats": result.delta_e.size, "delta_e": result.delta_e.tolist(), "sensors_mean_delta_e": result.mean_delta_e}
        more |= {"interval_delta_e": list(result.interval_delta_e)}
    if result.judged:
        more["metrics"] = plain({name: float(values.mean()) for name, values in result.judged.items()})
    if result.threshold is not None:
        more["at_threshold"] = threshold_data(result.threshold)
    if (colour := result.colour) is not None:
        more |= {"develop": settings.develop.model_dump(), "colour": colour}
    elif settings.develop.words:
        more |= {"develop": settings.develop.model_dump()}
    if settings.develop.sharpens:
        more["sharpening_noise_gain"] = result.chain.development.sharpening_noise_gain
    more |= {"frames": prepared.frames} if prepared.frames > 1 else {}
    more |= {"noise_budget": result.noise_budget.as_dict()} if result.noise_budget else {}
    values = {metric.name: float(result.table.columns[metric.columns[0]].mean()) for metric in metrics_named(settings.metrics)}
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
        "in_focus_m": finite_or_none(depth_of_field_m(result.camera, score.physics.read_pitch_um)),
        "exposure": settings.exposure.model_dump(),
        "correction": settings.correction.model_dump(),
        **({"motion": settings.motion.model_dump()} if settings.motion.is_on else {}),
        "display": settings.display.model_dump(),
        "seed": settings.seed,
        **more,
    }
    return result_data(
        content,
        settings=settings.model_dump(mode="json", exclude_none=True),
        notes=notes(result),
        cases=[{"at": {}, "sensor": prepared.cases[0].sensor, "values": plain(values)}],
        table=ROWS_FILE,
    )


def threshold_data(threshold: Threshold) -> dict[str, Any]:
    """Return where a target is just seen, as in score.json."""
    return {
        "parameter": threshold.parameter,
        "detectability": threshold.threshold,
        "value": threshold.value,
        "upper_value": threshold.upper_value,
        "why_not": threshold.reason,
    }


# --- notes ------------------------------------------------------------------------------------------------------------------------


def notes(result: RunResult) -> list[Note]:
    """Return what a reader should know besides the score: its causes, warnings, a black level that clips dark noise."""
    sized = [(cause.delta_e, cause.note) for cause in result.causes]
    sized += [(result.dark["lightness"], note) for note in dark_notes(result)]
    of_score = [note for _, note in sorted(sized, key=lambda pair: -pair[0])]
    return list(dict.fromkeys([*(cause.note for cause in result.causes), *result.warned, *of_score]))


def dark_notes(result: RunResult) -> list[Note]:
    """Return a note on the clipping of dark pixels at 0 DN; none if it is not visible, or a correction removes its mean."""
    if result.settings.correction.removes_dark_level or not clips_dark(result.dark):
        return []
    return [clip_note(result.dark, result.settings.pixel.model_dump())]


def assumption(result: RunResult) -> str:
    """Return what was assumed of the technology and the lens, which nobody stated; empty for nothing."""
    of_lens = "" if result.prepared.cases[0].picture else result.prepared.asked.camera.assumption(result.camera)
    return "; ".join(filter(None, (result.settings.pixel.assumption, of_lens)))


# --- words ------------------------------------------------------------------------------------------------------------------------


def judged_by_delta_e(result: RunResult) -> bool:
    """Return whether ΔE was asked for."""
    return DELTA_E.name in result.settings.metrics


def run_answer(result: RunResult) -> Answer:
    """Return the answer of a run: the number of its first metric, and below it what makes it unsure and what it is of."""
    first = metrics_named(result.settings.metrics)[0]
    setup = setup_parts(result)
    if first is DELTA_E:
        answer = headline(score_parts(result))
        return Answer(answer.head, (*unsure_words(result), *answer.below))
    return Answer(metric_text(result, first), tuple(setup))


def facts(result: RunResult) -> Iterator[Block]:
    """Yield what the other metrics say, with what makes mean ΔE unsure, and what is known of several sensors and frames."""
    for metric in metrics_named(result.settings.metrics)[1:]:
        if metric is DELTA_E:
            yield Fact(joined([("mean ΔE ", shown_mean_of(result)), *unsure_words(result)]))
        else:
            yield Fact(plain_text(metric_text(result, metric)))
    frames, repeats = result.prepared.frames, result.prepared.repeats
    if repeats > 1 and result.interval_delta_e is not None:
        words = f"{repeats} sensors"
        if judged_by_delta_e(result):
            sensors_delta_e = span(result.delta_e.min(), result.delta_e.max(), ".3f")
            where = "" if result.is_spread else " of this registration"
            low, high = result.interval_delta_e
            ends = span(*(within_error(end, (high - low) / 2) for end in (low, high)))
            words += f": ΔE of {sensors_delta_e}, 95 % interval of their mean{where} {ends}"
        yield Fact(f"{words}; pictures and frames are of the first")
    if frames > 1:
        between = {2: "", 3: f", {raw_stem(2)}.exr"}.get(frames, f", {raw_stem(2)}.exr, …")
        yield Fact(f"{frames} frames of this sensor: raw.exr{between} and {raw_stem(frames)}.exr; the first is scored")


def metric_text(result: RunResult, metric: Metric) -> Text:
    """Return what a metric beside ΔE says of a run, with half of the 95 % interval of several sensors; else that it is of one."""
    values = result.judged[metric.name]
    mean = float(values.mean())
    if math.isnan(mean):  # a note says why
        return f"{metric.words} is not given"
    low, high = result.interval(values, metric.columns[0]) or (mean, mean)
    value = with_error(mean, (high - low) / 2) if high > low else rounded(mean, 3)
    judged = f"one {metric.judges}" if values.size == 1 else f"the {metric.judges}"
    seen = threshold_words(result, mean) if metric is DETECTABILITY else ""
    return f"{metric.words} ", Strong(f"{value} {metric.unit}".rstrip()), f", of {judged}{seen}"


def threshold_words(result: RunResult, d_prime: float) -> str:
    """Return where a target is seen as well as the threshold asks: at a value of the scene, or at a part of its contrast."""
    if result.threshold is not None:
        return f"; {found_threshold_words(result.threshold)}"
    options = result.settings.metric.detectability
    threshold = options.threshold
    factor, reason = contrast_factor(result.chain.expected(result.score.frame.integration_s), d_prime)
    if not reason:
        return f"; {threshold:g} is reached at {factor:.3g} times this contrast, where contrasts are small"
    is_seen = d_prime >= threshold
    return f"; no factor of its contrast leads to {threshold:g}: {reason}" if is_seen else f"; not seen: {reason}"


def found_threshold_words(threshold: Threshold) -> str:
    """Return at which values of the scene's parameter a target is seen."""
    reached = f"{threshold.threshold:g} is reached at {threshold.parameter}"
    match threshold.value, threshold.upper_value:
        case float(low), float(high):
            return f"{reached} of {low:.4g} to {high:.4g}"
        case float(low), None:
            return f"{reached} = {low:.4g}"
        case None, float(high):
            return f"{reached} up to {high:.4g}"
    tried = span(min(threshold.tried), max(threshold.tried), ".4g")
    reason = f": {threshold.reason}" if threshold.reason else ""
    return f"{threshold.threshold:g} is not reached at {threshold.parameter} of {tried}{reason}"


def shown_mean_of(result: RunResult) -> str:
    """Return mean ΔE over all sensors as text, with its interval and the error of its light."""
    mean = result.mean_delta_e
    half = 0.0 if result.interval_delta_e is None else result.interval_delta_e[1] - mean
    return shown_mean(mean, result.light, result.light_limit, result.causes, half)


def unsure_words(result: RunResult) -> list[str]:
    """Return the lines that follow a run's mean ΔE: its causes and the errors of its light, the largest first.

    A black level that clips dark noise is among them where it makes more than another one.
    """
    lines = unconverged(result.irradiance.header, result.rendered.film if result.rendered else None)
    sized = list(zip(exceeded(result.light, result.light_limit).values(), lines, strict=False))
    sized += [(cause.delta_e, str(cause)) for cause in result.causes]
    least = min((size for size, _ in sized), default=math.inf)
    sized += [(size, note) for note in dark_notes(result) if (size := result.dark["lightness"]) > least]
    return [line for _, line in sorted(sized, key=lambda pair: -pair[0])]


def score_parts(result: RunResult) -> list[Text]:
    """Return the mean ΔE of a run, its pixels and its exposure, and how it is shown and rendered, as parts of a `headline`."""
    mean = shown_mean_of(result)
    delta_e = ("mean ΔE ", Strong(mean))
    pixels, exposed, *others = setup_parts(result)
    first = (*delta_e, f"{',' * (NOT_CONVERGED in mean)} with {pixels}")
    whole = (*first, f", {exposed}")
    if has_room([whole]):
        return [whole, *others]
    return [first, exposed, *others] if has_room([first]) else [delta_e, pixels, exposed, *others]


def setup_parts(result: RunResult) -> list[str]:
    """Return the pixels of a run, its exposure, its development where there is one, and how it is shown and rendered."""
    frame, settings = result.score.frame, result.settings
    rows, columns = frame.pixels
    border_um = result.score.border_um[1] if settings.display.raster == "fixed_size" else 0.0
    border = f"{border_um:.3g} µm on each side not scored" if border_um else ""

    exposure, time_s, saturated = settings.exposure, frame.integration_s, frame.saturated_fraction
    is_longest = exposure.integration_s is None and time_s >= exposure.times * exposure.max_integration_s
    longest = " (the maximum)" if is_longest else ""
    full = f", {percent(saturated)} of them saturated" if saturated > SATURATED_SHOWN else ""
    exposed = ", ".join([f"exposed for {exposure_time(time_s)}{longest}{full}", *stage_words(settings)])

    view = view_words(settings.display, result.irradiance.header, result.prepared.view, settings.window_mm, columns)
    shown = ", ".join(filter(None, (border, *view)))
    film = film_words(result.film) if result.film else unmeasured_words(result)
    noise = noise_words(result.rendered.noise.fraction) if result.rendered and result.rendered.noise else ""
    light = film, noise
    if not judged_by_delta_e(result):  # errors of the light are in ΔE
        light = "", ""
    developed = developed_words(settings.develop, [settings.pixel])
    rest = "; ".join(filter(None, (shown, light[0], lens_words(result.camera), assumption(result), light[1])))
    pixels = f"{columns} × {rows} pixels of {result.score.physics.pitch_um:g} µm"
    return [pixels, exposed, *filter(None, (developed, rest))]


def noise_words(fraction: float) -> str:
    """Return the noise of a render as a fraction of the sensor's noise, in words."""
    return f"render noise {fraction:.2g} of the sensor's noise" if fraction else "no render noise"


def unmeasured_words(result: RunResult) -> str:
    """Return what was not measured of light that pixsim rendered; empty for nothing, and for light of another program."""
    light = result.light
    parts = ["the film's error"] * (light.film_delta_e is None) + ["render noise"] * (light.noise_delta_e is None)
    return f"{' and '.join(parts)} not measured" if "scene_hash" in result.irradiance.header and parts else ""


# --- the page ---------------------------------------------------------------------------------------------------------------------


def _slider(result: RunResult, pictures: Mapping[str, bytes]) -> Slider:
    """Return the sensor's picture beside the ideal image.

    pictures : name -> PNG
    """
    score = result.score
    return Slider(
        id="slider",
        heading="",
        left=shown_picture(pictures["ideal.png"], score.ideal, "ideal image"),
        others=(shown_picture(pictures["image.png"], score.image, f"{score.physics.pitch_um:g} µm pixels"),),
    )


def _sections(result: RunResult, pictures: Mapping[str, bytes], files: RunFiles) -> Iterator[Section]:
    """Yield the sections of the page.

    pictures : name -> PNG
    """
    if judged_by_delta_e(result):
        yield Section("errors", "Where the errors are", _errors(result, pictures), together=True)
    quanta = quanta_of_run(result)
    yield Section("numbers", "Numbers", (DocumentTable("numbers of this picture", (), _numbers(result), words=None),))
    yield Section("neq", "Noise-equivalent quanta", (Plot(lambda: neq_against_frequency(quanta)),) if quanta else ())
    colour = colour_rows(result.colour, result.score.out_of_gamut)
    yield Section("colour", "Colour", (COLOUR, DocumentTable("numbers of the colours", (), colour)) if colour else ())
    rest = [UNSTATED] if result.score.physics.technology.name == NO_TECHNOLOGY else []
    yield Section("settings", "Settings", [*settings_blocks(_settings(result)), *rest])
    yield Section("files", "Files in this folder", (Listed(_files(files, result.prepared.frames)),), folded=True)


def _errors(result: RunResult, pictures: Mapping[str, bytes]) -> Iterator[Block]:
    """Yield the map of the errors, and the detail with the largest ones.

    pictures : name -> PNG
    """
    score = result.score
    p99 = result.statistics[0]["p99_delta_e"]
    end = scale_end(p99)
    yield Map(pictures["delta_e.png"], f"S-CIELAB ΔE. One dot in a hundred has more than {p99:.3g}.")
    left_mm, right_mm, bottom_mm, top_mm = extent(result.irradiance, score.border_um)
    window = worst_window([score.delta_e])
    x_mm = left_mm + window.centre[0] * (right_mm - left_mm)
    y_mm = top_mm + window.centre[1] * (bottom_mm - top_mm)
    yield f"The largest errors, around x = {x_mm:.3g} mm, y = {y_mm:.3g} mm from the upper left, dot for dot:"
    yield Pictures((crops(score, window, "the sensor's picture", end),), "the detail with the largest errors")
    yield DeltaEScale(scale(end))
    yield size_words(factor_for(score.ideal), result.settings.display.samples_per_deg)


def shown_statistics(result: RunResult) -> list[str]:
    """Return the names of the statistics that are printed; those of ΔE where it was asked for."""
    judged = judged_by_delta_e(result)
    return [name for name in result.statistics[0] if judged or not name.endswith("_delta_e")]


def _numbers(result: RunResult) -> Iterator[tuple[str, str]]:
    """Yield the meaning and the value of each number of the page: of the pixels, the light, the picture and its blur."""
    score, physics, readout = result.score, result.score.physics, result.score.readout
    rows, columns = score.frame.pixels
    width_mm, height_mm = extent(result.irradiance)[1:3]
    filters = f", filters {result.colour['layout']}" if result.colour is not None else ""
    of_technology = f"{label_of(physics.technology.name)}{filters}"
    yield "pixels", f"{columns} × {rows} of {physics.pitch_um:g} µm ({of_technology}) on {width_mm:.4g} × {height_mm:.4g} mm"
    yield "lens", "; ".join(filter(None, (lens_words(result.camera) or thin_lens_words(result.camera), assumption(result))))
    yield "light", str(LightLevel.of(result.irradiance, result.settings.display, [score.frame.integration_s]))
    yield "irradiance", rendered_words(result.irradiance.header)
    limit = "the full well" if readout.full_well_e <= readout.adc_range_e else "the range of the ADC"
    yield "brightest pixel", f"its mean is {rounded(100 * float(score.frame.mean_e.max()) / readout.saturation_e)} % of {limit}"

    statistics = result.statistics[0]
    for name in shown_statistics(result):
        is_filled = name == "fill_factor" and physics.technology.name == NO_TECHNOLOGY and statistics[name] > FILLED
        if name in MEANINGS and not is_filled:  # of a data sheet, which states none
            yield MEANINGS[name], rounded(statistics[name], 4)
    if result.rendered and result.rendered.noise:
        yield "noise of the render relative to the sensor's noise", f"{result.rendered.noise.fraction:.2g}"

    imaging, path_um = result.chain.imaging, result.chain.moving.longest_um
    frequency_lp_per_mm, name, sensor_terms, display_terms = detail_terms(imaging, result.irradiance, path_um)
    for term, mtf in {**sensor_terms, **display_terms}.items():
        yield f"MTF at {frequency_lp_per_mm:.3g} lp/mm, {name}: {term}", f"{mtf:.3f}"


def budgets_of(result: RunResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of a run by the words of its pixel; none where nobody asks."""
    budget = result.noise_budget
    return {} if budget is None else {f"{result.score.physics.pitch_um:g} µm": budget}


def _settings(result: RunResult) -> list[DocumentTable]:
    """Return the settings of a run, with their meaning and source."""
    sheet = result.score.physics.technology.name == NO_TECHNOLOGY
    settings, irradiance = result.settings, result.irradiance
    light = LightLevel.of(irradiance, settings.display, [result.score.frame.integration_s])
    scene = scene_rows(irradiance, settings.scene, light)
    scene.append(("seed", settings.seed, "of all random numbers", "set" if settings.seed else "default"))
    return settings_tables(scene, settings, result.camera, result.score.physics.pixel, result.colour is not None, sheet)


def _files(files: RunFiles, frames: int) -> tuple[Text, ...]:
    """Return the other files of a run of so many frames with their descriptions."""
    names = files.names(frames)
    listed = {name: words for name, words in FILES.items() if name in names}
    listed |= {f"raw{suffix}": "the frame of raw.exr, for other programs" for suffix in sorted(files.formats) if suffix != ".exr"}
    listed |= {f"{raw_stem(2)}{suffix}": further_words(suffix, frames) for suffix in sorted(files.formats) if frames > 1}
    return tuple((Link(name, name), f": {words}") for name, words in listed.items())


def raw_stem(number: int) -> str:
    """Return the name, without its suffix, of the file of a frame: raw, raw_002, raw_003, …; sorted names keep their order."""
    return "raw" if number == 1 else f"raw_{number:03d}"


def further_words(suffix: str, frames: int) -> str:
    """Return what the page says of the files of further frames beside that of the second one, of one format."""
    last = "" if frames == 2 else f", and so on to {raw_stem(frames)}{suffix}"
    return f"frame 2 of the same sensor{last}: the same fixed pattern, temporal noise of its own"


def shown_picture(png: bytes, luminance: Array, name: str) -> Picture:
    """Return a whole picture with its PNG, or the `reduced` one if it is large."""
    if factor_for(luminance) == 1:
        return Picture(display_codes(luminance), name, png=png)
    return Picture(display_codes(reduced(luminance)), name)


def run_settings_text(prepared: Job[Run], irradiance: SpectralImage) -> str:
    """Return the text of settings.toml, from which `pixsim run` makes the same numbers again."""
    imaging = prepared.cases[0].imaging
    assert imaging is not None
    given = {"sensor": prepared.sensor, "variant": prepared.variant, "units": prepared.units}
    given |= {name: str(value) for name, value in (("repeats", prepared.repeats), ("frames", prepared.frames)) if value > 1}
    command = ["pixsim", "run", whole_source(prepared), "--config", SETTINGS_FILE, *["--full"] * imaging.full]
    command += [word for name, value in given.items() if value for word in (f"--{name}", value)]
    return settings_text(repeating_settings(prepared, irradiance), shlex.join(command))


def digest_of_run(lit: LitRun, files: RunFiles = USUAL) -> str:
    """Hash of everything that the files of a run are made from, but the wall times."""
    prepared, light = lit.prepared, lit.irradiance
    film = lit.rendered.film.as_dict() if lit.rendered and lit.rendered.film else None
    of_case = prepared.settings, prepared.camera
    own = *of_case, prepared.asked.camera, prepared.repeats, prepared.frames
    imaging, without = prepared.cases[0].imaging, prepared.cases[0].without
    assert imaging is not None
    return digest_of_content(files, run_settings_text(prepared, light), light, film, imaging.technology, own, without)


def repeating_settings(job: Job[Run], irradiance: SpectralImage) -> Run:
    """Return the settings with which `pixsim run` makes the same numbers again.

    irradiance : of this run
    """
    if job.cases[0].picture:
        return job.complete
    # Display and chart, too, may have been chosen; defaults in their place would count as given.
    of_view = {"display": job.complete.display, "scene": scene_table(job.cases[0].scene.path.parent, job.complete.scene)}
    return without_clock(job.asked, irradiance).model_copy(update=of_view)


def whole_source(job: Job[Run]) -> str:
    """Return the scene or picture of a run, for a command in another folder."""
    if job.cases[0].picture:
        return str(Path(job.file).resolve())
    return job.file if job.file in packaged_scenes() else str(job.cases[0].scene.path)


def write_irradiance(path: Path, image: SpectralImage, irradiance: Irradiance) -> None:
    """Write the light of a run as EXR: whole, its factors only, or bands of at most 1024 samples across and 60 MB."""
    write_exr(path, reduced_to_fit(image) if irradiance == "reduced" else image, factors_only=irradiance == "factors")


def write_numbers(
    result: RunResult, folder: Path, name_of: Callable[[int], str], suffixes: Sequence[str], frame_done: Callable[[int], object]
) -> None:
    """Write delta_e.exr and the raw frames of a run.

    name_of : returns the name of a frame's file, without its suffix
    suffixes : of the formats
    frame_done : called with the number of frames written so far
    """
    write_channels(folder / "delta_e.exr", {"delta_e": result.score.delta_e}, {})
    for number, frame in enumerate(chain([result.score.frame], result.further_frames()), 1):
        for suffix in suffixes:
            write_frame(folder / f"{name_of(number)}{suffix}", frame)
        frame_done(number)


def _page(result: RunResult, options: PageOptions) -> Document:
    return run_page(result)


PRESENTER = Presenter(document=run_document, figure=run_plate, csv=run_csv, page=_page, has_figures=False)
