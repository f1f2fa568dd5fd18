"""The document of a run, and its files: all of them, or none."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pixsim.base.arrays import Array
from pixsim.base.digits import rounded, span
from pixsim.base.files import digest_of
from pixsim.base.notes import warn
from pixsim.base.progress import Progress
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.kept import digest_of_content
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.pictures import crops, picture_axes, size_words
from pixsim.report.settings import scene_rows, settings_tables
from pixsim.report.wording import DELTA_E, blur_words, map_words, rendered_words
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.show.document import (
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Link,
    Listed,
    Map,
    Note,
    Pictures,
    Plot,
    Section,
    Slider,
    Text,
)
from pixsim.show.pages import figure_files
from pixsim.show.pictures import Picture, delta_e_png, display_codes, factor_for, light_png, reduced, scale, scale_end, worst_window
from pixsim.show.render import PAGE
from pixsim.studies.files import settings_text
from pixsim.studies.merit import NEQ, LightLevel, extent, neq_against_frequency, quanta_of_run
from pixsim.studies.run import Irradiance, LitRun, RunResult, repeating_settings, whole_source, write_irradiance, write_numbers
from pixsim.studies.sentences import FILLED, judged_lines, leads_other, lens_words, run_answers, thin_lens_words, unsure_words

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.studies.prepare import Job
    from pixsim.viewer.noise_budget import NoiseBudget
    from pixsim.viewer.setting import Run

# Files next to the page, with their descriptions.
ROWS_FILE = "results.csv"
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
        ("dots outside the display's gamut: ideal image", f"{out_of_gamut[0]:.2%}"),
        ("dots outside the display's gamut: the sensor's picture", f"{out_of_gamut[1]:.2%}"),
    ]


def _row(facts: Mapping[str, Any], number: int) -> str:
    return ", ".join(f"{value:.4g}" for value in facts["matrix_to_display"][number])


COLOUR = (
    "Both pictures are in colour: black level and dark charge are subtracted, white is balanced, the channels are interpolated to "
    "each pixel, and one matrix, fitted to a ColorChecker under the scene's lamp, leads to the light of the display's primaries. "
    "The larger its noise gains, the more of the sensor's noise is seen as colour."
)


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
    unsure = unsure_words(result)
    return Document(
        command="run",
        kind="picture of one sensor",
        title=f"{scene} with {pitch_um:g} µm pixels",
        data=result.as_dict(),
        answers=tuple(run_answers(result)),
        lead=(*several_facts(result), *(Note(note) for note in result.notes if note not in {*unsure, *warned})),
        about=(DELTA_E, camera_words(result), blur_words(result.chain.imaging, result.irradiance, result.chain.moving.longest_um)),
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
        warn("the light has no factors (spectrum × picture): irradiance.exr holds its bands in full")

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
        sections = *document.sections, *_sections(result, pictures, files)
        return replace(document, sections=sections, files={**pictures, **settings, ROWS_FILE: result.results_csv})

    document = run_document(result)
    return replace(document, writers=(write_light, write_frames), finish=finish)  # the largest file by far first


def several_facts(result: RunResult) -> Iterator[Fact]:
    """Yield what is known of the sensors of a run of several, and of several frames."""
    frames, repeats = result.prepared.frames, result.prepared.repeats
    yield from map(Fact, judged_lines(result)[leads_other(result) :])
    if repeats > 1 and result.interval_delta_e is not None:
        each = span(result.delta_e.min(), result.delta_e.max(), ".4f")
        where = "" if result.is_spread else " of this registration"
        words = f"{repeats} sensors: ΔE of {each}, 95 % interval of their mean{where} {span(*result.interval_delta_e, '.4f')}"
        yield Fact(f"{words}; pictures and frames are of the first")
    if frames > 1:
        between = {2: "", 3: f", {raw_stem(2)}.exr"}.get(frames, f", {raw_stem(2)}.exr, …")
        yield Fact(f"{frames} frames of this sensor: raw.exr{between} and {raw_stem(frames)}.exr; the first is scored")


def camera_words(result: RunResult) -> str:
    """Return the pixels of a run, its lens and its light, as the page has them below the answer."""
    score, camera, physics, readout = result.score, result.camera, result.score.physics, result.score.readout
    rows, columns = score.frame.pixels
    width_mm, height_mm = extent(result.irradiance)[1:3]
    filters = f", filters {result.colour['layout']}" if result.colour is not None else ""
    lens = lens_words(camera) or thin_lens_words(camera)
    light = LightLevel.of(result.irradiance, result.settings.display, [score.frame.integration_s])
    limit = "the full well" if readout.full_well_e <= readout.adc_range_e else "the range of the ADC"
    well, saturated = float(score.frame.mean_e.max()) / readout.saturation_e, score.frame.saturated_fraction
    pixels = f"{columns} × {rows} pixels of {physics.pitch_um:g} µm ({label_of(physics.technology.name)}{filters})"
    parts = [f"{pixels} on {width_mm:.4g} × {height_mm:.4g} mm", lens, *filter(None, (result.assumption,))]
    brightest = f"the brightest pixel's mean at {100 * well:.0f} % of {limit}, {100 * saturated:.2g} % of the pixels saturated."
    return f"{'; '.join(parts)}; {light}, {brightest}"


def _sections(result: RunResult, pictures: Mapping[str, bytes], files: RunFiles) -> tuple[Section, ...]:
    """Return the sections of the page.

    pictures : name -> PNG
    """
    score, settings, header, quanta = result.score, result.settings, result.irradiance.header, quanta_of_run(result)
    colour = colour_rows(result.colour, score.out_of_gamut)
    left_mm, right_mm, bottom_mm, top_mm = extent(result.irradiance, score.border_um)
    window = worst_window([score.delta_e])
    x_mm, y_mm = left_mm + window.centre[0] * (right_mm - left_mm), top_mm + window.centre[1] * (bottom_mm - top_mm)
    p99 = result.statistics[0]["p99_delta_e"]
    end = scale_end(p99)
    rows, columns = score.delta_e.shape
    border = (
        f"a border of at least one pixel, {score.border_um[1]:.3g} µm, is not scored, where whole pixels do not fill the die or "
        "have no neighbour."
    )
    fixed = settings.display.raster == "fixed_size"
    sheet = score.physics.technology.name == NO_TECHNOLOGY
    rest = (
        "Noise and non-uniformities that the data sheet does not state are zero."
        if sheet
        else "All other parameters come from the technology."
    )
    source = rendered_words(header)
    slider = Slider(
        *("slider", "The whole picture and the ideal image"),
        shown_picture(pictures["ideal.png"], score.ideal, "ideal image"),
        (shown_picture(pictures["image.png"], score.image, f"{score.physics.pitch_um:g} µm pixels"),),
    )
    sizes = size_words(factor_for(score.ideal), settings.display.samples_per_deg)
    return (
        Section(
            *("pictures", "Pictures"),
            (f"The display shows and scores {columns} × {rows} dots: {border if fixed else 'one for each pixel.'} {sizes}", slider),
            together=True,
        ),
        Section(
            *("detail", "The largest errors, 1:1"),
            (
                f"The detail with the largest mean ΔE. Its centre is at x = {x_mm:.3g} mm, y = {y_mm:.3g} mm on the sensor, from "
                "the upper left.",
                Pictures((crops(score, window, "the sensor's picture", end),), "the detail with the largest errors"),
                DeltaEScale(scale(end)),
            ),
            together=True,
        ),
        Section(
            *("map", "Map of the errors"),
            (Map(pictures["delta_e.png"], map_words("", score.mean_delta_e, p99, end)),),
            together=True,
        ),
        Section("numbers", "Numbers", (DocumentTable("numbers of this picture", (), _numbers(result)),)),
        Section("neq", "Noise-equivalent quanta", (Plot(lambda: neq_against_frequency(quanta)),) if quanta else ()),
        Section("colour", "Colour", (COLOUR, DocumentTable("numbers of the colours", (), colour)) if colour else ()),
        Section("settings", "Settings", (*_settings(result, sheet), f"{rest} Seed {settings.seed}.")),
        Section("files", "Files in this folder", (Listed(_files(files, result.prepared.frames)), f"Irradiance: {source}.")),
    )


def budgets_of(result: RunResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of a run by the words of its pixel; none where nobody asks."""
    budget = result.noise_budget
    return {} if budget is None else {f"{result.score.physics.pitch_um:g} µm": budget}


def _numbers(result: RunResult) -> tuple[tuple[str, str], ...]:
    """Return the meaning and the value of each statistic."""
    statistics = {name: result.statistics[0][name] for name in MEANINGS}
    if result.score.physics.technology.name == NO_TECHNOLOGY and statistics["fill_factor"] > FILLED:
        del statistics["fill_factor"]  # the data sheet states none
    rows = [(MEANINGS[key], rounded(value, 5)) for key, value in statistics.items()]
    if result.rendered and result.rendered.noise:
        rows.append(("noise of the render relative to the sensor's noise", f"{result.rendered.noise.fraction:.2g}"))
    return tuple(rows)


def _settings(result: RunResult, sheet: bool) -> list[DocumentTable]:
    """Return the settings of a run, with their meaning and source.

    sheet : whether they are those of a data sheet
    """
    settings, irradiance = result.settings, result.irradiance
    light = LightLevel.of(irradiance, settings.display, [result.score.frame.integration_s])
    scene = scene_rows(irradiance, settings.scene, light)
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
