"""The document of a study: its optima, its figures with their data, its pictures, and its files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np

from pixsim.base.schema import result_data
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.curve import (
    closed_range,
    curve_data,
    curve_table,
    delta_e_against_pitch,
    numbers_table,
    optima_data,
    optima_table,
    optimum_answer,
    range_columns,
)
from pixsim.report.neq import NEQ, neq_against_frequency
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.paper import PAPER_PLATES, map_plates, numbered, scene_plates
from pixsim.report.pictures import size_words
from pixsim.report.regret import REGRETS, metrics_against_pitch, regrets_plate
from pixsim.report.settings import UNSTATED, record_rows, scene_rows, settings_blocks, settings_table, settings_tables
from pixsim.report.study_facts import study_facts, study_notes
from pixsim.report.uncertainty import uncertainty_blocks, uncertainty_document
from pixsim.report.views import SENSORS_SHOWN, Views, best_place, map_end, study_pictures, study_views
from pixsim.report.wording import DELTA_E, film_words, rendered_words, weighted_answer
from pixsim.sensor.labels import file_label, labels_of
from pixsim.show.document import (
    Block,
    DeltaEScale,
    Document,
    DocumentTable,
    Fact,
    Pictures,
    Plot,
    Section,
    Slider,
    Tiles,
    VerdictText,
    made_with,
    pairs,
)
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, draw_terms, drawing_thread, fix_margins, literal, new_figure
from pixsim.show.pages import Drawing, Drawn, Figures, Plate, figure, figure_files
from pixsim.show.pictures import scale
from pixsim.show.render import lines
from pixsim.show.sentences import capital
from pixsim.studies.claims import FIGURE_6_PITCHES_UM, REFERENCE_TECHNOLOGY, Evidence, Finding, SizeMaps, findings, size_maps
from pixsim.studies.curve import Curve
from pixsim.studies.design import imaging_of
from pixsim.studies.engine import Workers, results_of
from pixsim.studies.merit import (
    detail_frequency_lp_per_mm,
    detail_terms,
    longest_path_um,
    mpe30_lx_s,
    mtf50_cy_per_mm,
    quanta_of_study,
    shown_mtf,
    study_mtf_terms,
    system_mtf,
)
from pixsim.studies.regret import Regrets, metric_regrets
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Study
from pixsim.studies.table import ROWS_FILE
from pixsim.viewer.display import white_light

if TYPE_CHECKING:
    from pixsim.base.arrays import Array
    from pixsim.viewer.noise_budget import NoiseBudget
    from pixsim.viewer.score import FrameScore

P = ParamSpec("P")
NO_BUDGETS: Mapping[str, NoiseBudget] = MappingProxyType({})
ANSWERS_SHOWN = 12  # optima at the top
ANSWERS_OF_PAGE = 4  # before its figure; a table has all
LEGEND_HEADROOM = 1.35  # over the highest point, for a legend of three lines


@figure("other_statistics", "Statistics of ΔE of the same pictures against pixel size, each divided by its minimum.")
def other_statistics(curve: Curve) -> Drawing:
    """Plot the mean, percentiles and maximum of ΔE against pitch, each over its minimum."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    fix_margins(figure)
    for (name, values), look in zip(curve.means.items(), LOOKS, strict=False):
        axes.plot(curve.pitch_um, values / values.min(), ms=3.5, lw=1, label=name.removesuffix("_delta_e"), **look.line)
    axes.set(xlabel="pixel size (µm)", ylabel="ΔE over its minimum", ylim=(0.9, 3.0))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, handlelength=LEGEND_LINE)
    axes.set_title(literal(curve.label), fontsize=9)
    over_minimum = {f"{name}_over_minimum": values / values.min() for name, values in curve.means.items()}
    return figure, curve_table([curve]) | over_minimum


@figure(
    "optimum_against_technology",
    "Optimal pixel size of each process against its feature size. The line goes through the largest process, as if the optimum "
    "were proportional to the feature size.",
)
def optimum_against_technology(result: StudyResult) -> Drawing:
    """Plot the optima with their intervals, and the line of an optimum proportional to the feature size."""
    sizes_um = {curve.label: curve.feature_size_um for curve in result.curves if curve.feature_size_um is not None}
    curves = sorted((curve for curve in result.curves if curve.label in sizes_um), key=lambda curve: sizes_um[curve.label])
    feature_um = np.array([sizes_um[curve.label] for curve in curves])
    size_um = np.array([curve.optimum.pitch_um for curve in curves])
    low_um, high_um = np.array([closed_range(curve.optimum.interval_um, curve) for curve in curves]).T
    figure = new_figure(5.4, 4.0)
    axes = figure.subplots()
    fix_margins(figure)
    bars = np.maximum([size_um - low_um, high_um - size_um], 0.0)
    axes.errorbar(feature_um, size_um, bars, fmt="o", color=COLOURS[0], lw=2, capsize=4, label="optimum, 95 % interval")
    proportional = size_um[-1] / feature_um[-1] * feature_um
    axes.plot(feature_um, proportional, "--", color="0.4", label="proportional to feature size")
    axes.set(xlabel="feature size (µm)", ylabel="optimal pixel size (µm)", xlim=(0, None), ylim=(0, None))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return figure, {
        "technology": [curve.label for curve in curves],
        "feature_size_um": feature_um,
        "optimum_um": size_um,
        **range_columns("interval", curves),
        "optimum_features": size_um / feature_um,
        "mean_delta_e": [curve.optimum.mean_delta_e for curve in curves],
        "proportional_um": proportional,
    }


@figure(
    "light_against_detail",
    "Detail and light against pixel size, the two sides of the trade-off. Above: MTF50, the frequency at which the MTF is one "
    "half, on the sensor and on the display (higher is better), and the minimum exposure on the sensor for an SNR of 30 dB "
    "(equation 2 at 30 ms; lower is better). Below: MTF of each term at the finest detail of the scene, or at half the Nyquist "
    "frequency of the best pixels, and their product.",
)
def light_against_detail(result: StudyResult, curve: Curve) -> Drawing:
    """Plot MTF50 and MPE30 of each pitch, the two sides of the trade-off, and the MTF of each blur term at fine detail."""
    pixels = [result.physics(curve.technology, pitch_um) for pitch_um in curve.pitch_um.tolist()]
    paths_um = [longest_path_um(result, curve, pitch_um) for pitch_um in curve.pitch_um.tolist()]
    mtf50, shown50 = (
        [mtf50_cy_per_mm(result, physics, mtf, path) for physics, path in zip(pixels, paths_um, strict=True)]
        for mtf in (system_mtf, shown_mtf)
    )
    mpe30 = [mpe30_lx_s(result, physics) for physics in pixels]
    figure = new_figure(6.4, 6.8)
    axes, lower = figure.subplots(2, 1, sharex=True)
    fix_margins(figure, right_in=0.75)
    detail = axes.plot(curve.pitch_um, mtf50, "o-", ms=4, color=COLOURS[0], label="MTF50 on the sensor (left axis)")
    detail += axes.plot(curve.pitch_um, shown50, "^:", ms=4, color=COLOURS[0], label="MTF50 on the display (left axis)")
    axes.set_ylabel("MTF50 (lp/mm): detail", color=COLOURS[0])
    axes.set_ylim(0, LEGEND_HEADROOM * max(mtf50))
    other = axes.twinx()
    light = other.semilogy(curve.pitch_um, mpe30, "s--", ms=4, color=COLOURS[1], label="exposure (right axis)")
    other.set_ylabel("exposure for 30 dB (lx·s): light", color=COLOURS[1])
    other.spines["right"].set_visible(True)
    axes.legend(handles=[*detail, *light], frameon=False, loc="upper right", handlelength=LEGEND_LINE)

    frequency, _ = detail_frequency_lp_per_mm(result.irradiance, curve.optimum.pitch_um)
    of_pixels = [
        study_mtf_terms(result, physics, np.array(frequency), path) for physics, path in zip(pixels, paths_um, strict=True)
    ]
    terms = {term: np.array([float(values[term]) for values in of_pixels]) for term in of_pixels[0]}
    shown = draw_terms(lower, curve.pitch_um, terms, result.study.display.interpolation)
    exposures = {"mtf50_lp_per_mm": mtf50, "shown_mtf50_lp_per_mm": shown50, "mpe30_lx_s": mpe30}
    contrasts = {
        f"{term.replace(' ', '_')}_mtf_at_{frequency:.3g}_lp_per_mm": mtf for term, mtf in (terms | {"shown": shown}).items()
    }
    lower.set(xlabel="pixel size (µm)", ylabel=f"MTF at {frequency:.3g} lp/mm", ylim=(0, 1.02))
    lower.grid(alpha=0.25)
    axes.set_title(literal(curve.label), fontsize=9)
    return figure, {"pitch_um": curve.pitch_um, **exposures, **contrasts}


# In the paper, of curves that any study has.
FIGURE_NUMBERS = {"delta_e_against_pitch": 7, "delta_e_against_pitch_all": 8, "optimum_against_technology": 9}


class PictureTask(NamedTuple):
    """What a worker makes: the pictures of a technology, or the ΔE maps of one of the paper's pixel sizes."""

    number: int
    technology: str
    pitch_um: float | None = None

    def __str__(self) -> str:
        return f"pictures of {self.technology}" if self.pitch_um is None else f"maps of {self.pitch_um:g} µm pixels"


class SensorPictures(NamedTuple):
    """Pictures of the best of the sizes tried of a technology.

    score : of the first sensor
    mean : (H, W) mean ΔE map of `sensors` sensors
    views : details and whole pictures of all sizes
    """

    curve: Curve
    score: FrameScore
    mean: Array
    sensors: int
    views: Views

    def plate(self, result: StudyResult) -> Plate:
        """Return their figure."""
        plate = study_pictures(result, self.curve, self.score, self.mean, self.sensors)
        return plate.named(f"pictures_{self.curve.file_label}")


def make_pictures(task: PictureTask, result: StudyResult) -> tuple[PictureTask, SensorPictures | SizeMaps]:
    """Return what a worker makes, with its task; it imports no Matplotlib."""
    if task.pitch_um is not None:
        return task, size_maps(result, task.pitch_um)
    curve = next(curve for curve in result.curves if curve.technology == task.technology)
    pitch_um = float(curve.pitch_um[best_place(curve)])
    sensors = min(SENSORS_SHOWN, result.sensors_at(curve.technology, pitch_um))
    scores = result.shown_scores(curve.technology, pitch_um, sensors)
    mean = np.mean([score.delta_e for score in scores], axis=0)
    return task, SensorPictures(curve, scores[0], mean, sensors, study_views(result, curve, scores[0]))


@dataclass(frozen=True)
class StudyFigures:
    """The figures and pictures of a study's page, and the statements of the paper that it checks."""

    curves: Sequence[Drawn]
    limits: Sequence[Drawn]
    maps: Sequence[Drawn]
    paper: Sequence[Drawn]
    views: Sequence[Views]
    statements: Sequence[Finding]


def study_figures(result: StudyResult, workers: Workers, figures: Figures) -> StudyFigures:
    """Return the figures of a study's page: a thread of this process draws while workers make pictures and maps."""
    by_name = {curve.technology: curve for curve in result.curves}
    first, paper = by_name.get(REFERENCE_TECHNOLOGY, result.curves[0]), result.study.paper
    kinds: list[tuple[str, float | None]] = [(curve.technology, None) for curve in result.curves if curve.has_delta_e]
    kinds += [(REFERENCE_TECHNOLOGY, pitch_um) for pitch_um in FIGURE_6_PITCHES_UM if paper]
    tasks = [PictureTask(number, *kind) for number, kind in enumerate(kinds)]

    def shared() -> StudyResult:  # one function for all calls, so that workers share the result
        return result

    with drawing_thread() as pool:

        def draw(make: Callable[P, Sequence[Plate]], *args: P.args, **options: P.kwargs) -> Future[list[Drawn]]:
            return pool.submit(lambda: [plate.drawn(figures) for plate in make(*args, **options)])

        curves = draw(plates_of_curves, result, first)
        limits = draw(lambda: [light_against_detail(result, first)])
        scene = draw(scene_plates, result) if paper else None
        if workers.jobs == 1:  # nothing else computes meanwhile
            wait([future for future in (curves, limits, scene) if future])

        made = dict(sorted(results_of(make_pictures, [(task, shared) for task in tasks], workers)))
        pictures = [part for part in made.values() if isinstance(part, SensorPictures)]
        maps = draw(lambda: [part.plate(result) for part in pictures])
        sizes = {task.pitch_um or 0.0: part for task, part in made.items() if isinstance(part, SizeMaps)}
        evidence = Evidence(result, by_name, sizes)
        statements = findings(evidence) if paper else []
        others = draw(map_plates, evidence) if paper else None
        return StudyFigures(
            curves=curves.result(),
            limits=limits.result(),
            maps=maps.result(),
            paper=[drawn for future in (scene, others) if future for drawn in future.result()],
            views=[part.views for part in pictures],
            statements=statements,
        )


def plates_of_curves(result: StudyResult, first: Curve) -> list[Plate]:
    """Return the figures of all curves and of the first one; the first figure answers what was asked."""
    plates = [delta_e_against_pitch([first])]
    if len(result.curves) > 1:
        plates.insert(0, delta_e_against_pitch(result.curves).named("delta_e_against_pitch_all"))
    if regrets := metric_regrets(first):
        plates.append(regrets_plate(regrets, first.pitch_um))
    if len(first.metrics) > 1:
        plates.append(metrics_against_pitch(first))
    if quanta := quanta_of_study(result):
        plates.append(neq_against_frequency(quanta))
    if len(result.curves) > 1:
        processes = not any(curve.data_sheet for curve in result.curves)
        if processes and len({curve.feature_size_um for curve in result.curves}) > 1:
            plates.append(optimum_against_technology(result))
    if first.judged_by_delta_e:
        plates.append(other_statistics(first))
    if not result.study.paper:
        return plates
    numbers = FIGURE_NUMBERS
    return [
        numbered(plate, numbers[plate.name], curve_file(plate.name, True)) if plate.name in numbers else plate for plate in plates
    ]


def curve_file(name: str, paper: bool) -> str:
    """Return the name of a figure of curves as a file's, with its number in the paper if the study compares with that."""
    return f"figure_{FIGURE_NUMBERS[name]}_{name}" if paper else name


def with_files_of_study(page: Document, result: StudyResult) -> Document:
    """Return the document of a study with settings.toml, from which `pixsim study` makes it again, and what is not known."""
    files = {SETTINGS_FILE: result.settings_toml} if result.settings_toml else {}
    unknown = {".": uncertainty_document(result)} if result.uncertainty else {}
    return replace(page, files={**files, **page.files}, parts={**page.parts, **unknown})


def report_files(study: Study) -> set[str]:
    """Return the names of all files that the report of a study may have."""
    labels = [file_label(label) for label in labels_of(study.technologies)]
    curves = (curve_file(name, study.paper) for name in FIGURE_NUMBERS)
    pictures = (f"pictures_{label}" for label in labels)
    plates = {*curves, REGRETS, "metrics", NEQ, "other_statistics", "light_against_detail", *pictures}
    plates |= set(PAPER_PLATES) if study.paper else set()
    plates |= {NAME} if study.noise_budget else set()
    sheets = (f"figures/contact_sheet_{label}.png" for label in labels)
    return {"report.html", "summary.json", SETTINGS_FILE, *figure_files(plates), *sheets}


def study_document(result: StudyResult, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim study`, without the figures and pictures of its page.

    warned : notes that a reader of the terminal has seen
    """
    film = [Fact(film_words(result.film.as_dict()))] if result.film else []
    return document_of(result, study_data(result), [], film, warned)


def document_of(
    result: StudyResult, data: dict[str, Any], regrets: Sequence[Regrets], facts: Sequence[Block], warned: Collection[str]
) -> Document:
    """Return the document of a study, without the figures and pictures of its page.

    regrets : of its conditions
    facts : further ones
    warned : notes that a reader of the terminal has seen
    """
    optima = (optimum_answer(curve) for curve in result.curves if not curve.alone)
    first = result.curves[0].metric.name
    by_first_metric = [found for found in regrets if found.criteria[0].metric.name == first]
    answers = [*map(weighted_answer, by_first_metric), *optima]
    left = len(answers) - ANSWERS_SHOWN
    more = [Fact(f"and {left} more: optima.csv")] if left > 0 else []
    lead = [*more, *study_facts(result), *facts, *uncertainty_blocks(result.uncertainty)]
    known = {*warned, *(line for block in lead for line in lines(block))}
    title = result.study.title or result.study.name
    evaluations = sum(int(curve.sensors.sum()) for curve in result.curves)
    made = f"{title}: {result.study.scene.file}, {evaluations} evaluations, seed {result.study.seed}"
    plot = Plot(lambda: delta_e_against_pitch(result.curves))
    return Document(
        command="study",
        kind="study of pixel sizes",
        title=title,
        cell=(*answers[:ANSWERS_SHOWN], plot, optima_table(result.curves), made),
        data=data | ({"uncertainty": [each.as_dict() for each in result.uncertainty]} if result.uncertainty else {}),
        answers=answers[:ANSWERS_SHOWN],
        lead=(*lead, *(note for note in study_notes(result) if note not in known)),
        sections=[],
    )


def study_data(result: StudyResult) -> dict[str, Any]:
    """Return a study without axes and conditions as in summary.json."""
    entries = {"film": result.film and result.film.as_dict(), "chosen": result.view, "window_mm": result.study.window_mm}
    settings = result.study.model_dump(mode="json")
    content = {name: value for name, value in entries.items() if value} | {
        "study": settings,
        "white_spectrum": white_light(result.irradiance)[1],
        "irradiance": result.irradiance.header,
        "curves": [curve_data(curve) | {"dark": result.dark(curve)} for curve in result.curves],
    }
    optima = [optimum for curve in result.curves for optimum in optima_data(curve)]
    return result_data(content, settings=settings, notes=study_notes(result), table=ROWS_FILE, optima=optima)


ABOUT = (
    "All pixel sizes see the same light on the same die. Small pixels suffer from noise, large ones from blur. The 95 % interval "
    "is that of the size with the smallest expected error. It includes noise and fixed pattern of the sensors, the registration "
    "of pixels with the detail, and the uncertainty of the curve between the sizes tried; not the error of the render and its "
    "film, or the choice of lens, process and display."
)
PAPER = 'Chen, Catrysse, El Gamal and Wandell, "How small should pixel size be?", Proc. SPIE 3965 (2000).'


def study_page(
    result: StudyResult,
    seconds: dict[str, float],
    workers: Workers,
    figures: Figures = "svg",
    budgets: Mapping[str, NoiseBudget] = NO_BUDGETS,
) -> Document:
    """Return the document of a study without axes, or of one of the cases of another, with its page.

    figures : "pdf" draws a PDF beside each SVG
    budgets : of `noise_budgets`
    """
    drawings = study_figures(result, workers, figures)
    first, *curves = map(plot_of, drawings.curves)
    brief, rows = study_document(result), drawings.statements
    numbers = [numbers_table(curve) for curve in result.curves]
    unstated = [UNSTATED] if all(curve.data_sheet for curve in result.curves) else []
    made = [*_about(result), _rendered(result), made_with(pairs("seconds", seconds, 2))]
    return replace(
        brief,
        answers=tuple(brief.answers)[:ANSWERS_OF_PAGE],
        data=study_data(result) | ({"paper": [asdict(row) for row in rows]} if rows else {}),
        lead=(first, *brief.lead),
        sections=(
            Section("optima", "Optima", [optima_table(result.curves)] if len(result.curves) > 1 else ()),
            Section("see", "Pictures", _pictures(result, drawings.views)),
            Section("paper", "Statements of the paper", _paper(rows)),
            Section("curves", "Further curves", curves),
            budgets_section(budgets),
            Section("limits", "What limits these pixels", [limits_table(result), *map(plot_of, drawings.limits)]),
            Section("settings", "Settings", [*settings_blocks(settings(result)), *unstated]),
            *_technologies(result),
            Section("numbers", "Numbers", numbers, folded=True),
            Section("maps", "Whole pictures and maps", map(plot_of, drawings.maps), folded=True),
            Section("figures", "The paper's other figures", map(plot_of, drawings.paper), folded=True),
            Section("made", "How this was computed", made, folded=True),
        ),
        files={f"figures/contact_sheet_{view.file_label}.png": view.sheet for view in drawings.views},
    )


def plot_of(made: Plate | Drawn) -> Plot:
    """Return a figure that is made already."""
    return Plot(lambda: made)


def _about(result: StudyResult) -> Iterator[Block]:
    """Yield what the numbers of a page mean."""
    yield ABOUT
    if any(curve.has_delta_e for curve in result.curves):
        yield DELTA_E
    if result.study.display.raster == "fixed_size":
        yield f"A border of {result.study.border_um:.3g} µm, one and a half of the largest pixels of the study, is not scored."


def _pictures(result: StudyResult, views: Sequence[Views]) -> Iterator[Block]:
    """Yield the pictures of each technology."""
    study = result.study
    if views:
        yield f"Mean ΔE is that of the whole picture over all sensors. {size_words(1, study.display.samples_per_deg)}"
    for number, view in enumerate(views, 1):
        of, label = f"detail in {view.label}", capital(view.label)
        across, down = (f"{100 * share:.0f} %" for share in view.place)
        place = f"Its centre is at {across} of the picture's width and {down} of its height."
        yield Section("", f"{label}: the same detail for every pixel size", [place, Tiles(view.tiles, of)])
        errors = Pictures(view.crops, of), DeltaEScale(scale(map_end(result)))
        yield Section("", f"{label}: errors in that detail", errors, together=True)
        slider = Slider(f"slider-{number}", "Pixel size to compare with the ideal image:", view.ideal, view.outputs)
        smaller = size_words(view.factor, study.display.samples_per_deg) if view.factor > 1 else ""
        yield Section("", f"{label}: whole pictures and the ideal image", [smaller, slider], together=True)


def limits_table(result: StudyResult) -> DocumentTable:
    """Return the contrast that each blur leaves at the optimum of each curve, at a frequency of fine detail."""
    rows: list[dict[str, str]] = []
    for curve in result.curves:
        imaging = imaging_of(result.study, result.camera, curve.technology, curve.optimum.pitch_um)
        path_um = longest_path_um(result, curve, curve.optimum.pitch_um)
        frequency_lp_per_mm, _, sensor_terms, display_terms = detail_terms(imaging, result.irradiance, path_um)
        row = {"pixel": f"{curve.label}, {curve.optimum.pitch_um:.2f} µm", "at (lp/mm)": f"{frequency_lp_per_mm:.3g}"}
        rows.append(row | {term: f"{mtf:.3f}" for term, mtf in (sensor_terms | display_terms).items()})
    head = list(dict.fromkeys(name for row in rows for name in row))
    cells = [tuple(row.get(name, "–") for name in head) for row in rows]
    return DocumentTable("MTF of each blur", head, cells, "MTF of each blur at the optimum")


def _paper(rows: Sequence[Finding]) -> list[Block]:
    """Return the statements of the paper, if they are compared."""
    head = "statement of the paper", "paper", "pixsim", "agrees"
    statements = [(row.statement, row.given, row.found, agrees(row.agrees)) for row in rows]
    return [PAPER, DocumentTable("statements of the paper", head, statements, words=None, stacks=True)] if rows else []


def agrees(whether: bool) -> tuple[VerdictText]:
    """Return whether a result agrees with a statement, for a cell of a table."""
    return (VerdictText("yes" if whether else "does not agree", whether),)


def _technologies(result: StudyResult) -> Iterator[Section]:
    """Yield the numbers of the technologies of the curves."""
    head = "number", "value", "plausible range", "source"
    for curve in result.curves:
        if not curve.data_sheet:
            name, rows = technology_rows(result, curve.technology)
            table = DocumentTable(f"technology {name}", head, rows, words=None)
            yield Section("", f"Numbers of the technology {name}", [table], folded=True)


def _rendered(result: StudyResult) -> str:
    """Return what the light of a study was made from."""
    header = result.irradiance.header
    seed = f", seed {header['seed']}" if "plan" in header else ""
    return f"Irradiance: {rendered_words(header)}{seed}. Study seed {result.study.seed}."


def settings(result: StudyResult) -> list[DocumentTable]:
    """Return the tables of parameters with their meaning and source; unset ones come from the technology."""
    study = result.study
    coloured = any(study.options_of(technology).colour for technology in study.technologies)
    sheets = all(curve.data_sheet for curve in result.curves)
    pixel = None if all(name in study.sensors for name in study.technologies) else study.pixel
    scene = scene_rows(result.irradiance, study.scene.parameters, result.light_level, study.sources)
    return [
        *settings_tables(scene, study, result.camera, pixel, coloured, sheets, study.sources),
        *(
            settings_table(f"pixel of {curve.label}", record_rows("pixel", sensor, curve.data_sheet, {}))
            for curve in result.curves
            if (sensor := study.sensors.get(curve.technology))
        ),
    ]


def technology_rows(result: StudyResult, technology: str) -> tuple[str, list[tuple[str, ...]]]:
    """Return a process's name, and the name, value, plausible range and source of each of its numbers."""
    process = result.processes[technology]
    values = process.content | process.numbers
    kinds = {name: f" ({distribution}, 90 %)" for name, distribution in process.distributions.items() if distribution != "uniform"}
    ranges = {name: f"{low:g} to {high:g}{kinds.get(name, '')}" for name, (low, high) in process.ranges.items()}
    return process.name, [
        (name, str(values.get(name, "")), ranges.get(name, ""), source) for name, source in process.sources.items()
    ]
