"""The document of a study: its optima, its figures with their data, its pictures, and its files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.schema import result_data
from pixsim.base.toml import SETTINGS_FILE
from pixsim.report.curve import (
    closed_range,
    curve_data,
    delta_e_against_pitch,
    optima_data,
    optima_table,
    optimum_answer,
    range_columns,
)
from pixsim.report.neq import NEQ, neq_against_frequency
from pixsim.report.noise_budget import NAME, budgets_section
from pixsim.report.paper import figure_6
from pixsim.report.pictures import size_words
from pixsim.report.regret import REGRETS, metrics_against_pitch, regrets_plate
from pixsim.report.settings import (
    UNSTATED_NOISE,
    record_rows,
    scene_rows,
    settings_blocks,
    settings_table,
    settings_tables,
)
from pixsim.report.study_facts import study_facts, study_notes
from pixsim.report.uncertainty import uncertainty_blocks, uncertainty_csv, uncertainty_sections
from pixsim.report.views import Views, map_end, study_views
from pixsim.report.wording import DELTA_E, film_words, rendered_words, weighted_answer
from pixsim.scene.guard.dictionary import stated_file
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
    Strong,
    Text,
    Tiles,
)
from pixsim.show.figures import (
    COLOURS,
    LEGEND_LINE,
    draw_terms,
    drawing_thread,
    fix_margins,
    literal,
    new_figure,
    prepare_to_draw,
)
from pixsim.show.pages import Drawing, DrawnFigure, Figures, Plate, figure, figure_files
from pixsim.show.pictures import scale
from pixsim.show.render import html
from pixsim.show.sentences import capital
from pixsim.studies.claims import (
    FIGURE_6_PITCHES_UM,
    REFERENCE_TECHNOLOGY,
    SENSORS,
    Evidence,
    Finding,
    SizeMaps,
    findings,
    size_maps,
)
from pixsim.studies.curve import Curve
from pixsim.studies.engine import Workers, results_of
from pixsim.studies.files import scene_copy
from pixsim.studies.merit import (
    detail_frequency_lp_per_mm,
    longest_path_um,
    mpe30_lx_s,
    mtf50_cy_per_mm,
    scene_to_display_mtf,
    study_mtf_terms,
    study_neq,
    system_mtf,
)
from pixsim.studies.regret import Regrets, metric_regrets
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Study
from pixsim.studies.table import ROWS_FILE
from pixsim.viewer.display import white_light

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pixsim.viewer.noise_budget import NoiseBudget

P = ParamSpec("P")
_NO_BUDGETS: Mapping[str, NoiseBudget] = MappingProxyType({})
_MAX_ANSWERS = 12  # optima at the top
ANSWERS_OF_PAGE = 4  # before its figure; a table has all
_LEGEND_HEADROOM = 1.35  # over the highest point, for a legend of three lines


@figure(
    "optimum_against_technology",
    "Optimal pixel size of each process against its feature size. The line goes through the largest"
    " process, as if the optimum were proportional to the feature size.",
)
def optimum_against_technology(result: StudyResult) -> Drawing:
    """Plot the optima with their intervals, and the line of an optimum proportional to the feature
    size.
    """
    sizes_um = {
        curve.label: curve.feature_size_um
        for curve in result.curves
        if curve.feature_size_um is not None
    }
    curves = [curve for curve in result.curves if curve.label in sizes_um]
    curves.sort(key=lambda curve: sizes_um[curve.label])
    feature_um = np.array([sizes_um[curve.label] for curve in curves])
    optimum_um = np.array([curve.optimum.pitch_um for curve in curves])
    ranges_um = [closed_range(curve.optimum.interval_um, curve) for curve in curves]
    low_um, high_um = np.array(ranges_um).T

    figure = new_figure(5.4, 4.0)
    axes = figure.subplots()
    fix_margins(figure)
    axes.errorbar(
        feature_um,
        optimum_um,
        np.maximum([optimum_um - low_um, high_um - optimum_um], 0.0),
        fmt="o",
        color=COLOURS[0],
        lw=2,
        capsize=4,
        label="optimum, 95 % interval",
    )
    proportional_um = optimum_um[-1] / feature_um[-1] * feature_um
    axes.plot(feature_um, proportional_um, "--", color="0.4", label="proportional to feature size")
    axes.set(
        xlabel="feature size (µm)", ylabel="optimal pixel size (µm)", xlim=(0, None), ylim=(0, None)
    )
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return figure, {
        "technology": [curve.label for curve in curves],
        "feature_size_um": feature_um,
        "optimum_um": optimum_um,
        **range_columns("interval", curves),
        "optimum_features": optimum_um / feature_um,
        "mean_delta_e": [curve.optimum.mean_delta_e for curve in curves],
        "proportional_um": proportional_um,
    }


@figure(
    "light_against_detail",
    "Detail and light against pixel size, the two sides of the trade-off. Above: MTF50, the"
    " frequency at which the MTF is one half, on the sensor and on the display (higher is better),"
    " and the minimum exposure on the sensor for an SNR of 30 dB (equation 2 at 30 ms; lower is"
    " better). Below: MTF of each term at the finest detail of the scene, or at half the Nyquist"
    " frequency of the best pixels, and their product.",
)
def light_against_detail(result: StudyResult, curve: Curve) -> Drawing:
    """Plot MTF50 and MPE30 of each pitch, the two sides of the trade-off, and the MTF of each blur
    term at fine detail.
    """
    figure = new_figure(6.4, 6.8)
    upper_axes, lower_axes = figure.subplots(2, 1, sharex=True)
    fix_margins(figure, right_in=0.75)
    upper_axes.set_title(literal(curve.label), fontsize=9)
    columns = _draw_detail_and_light(upper_axes, result, curve)
    contrasts = _draw_mtf_terms(lower_axes, result, curve)
    return figure, {"pitch_um": curve.pitch_um, **columns, **contrasts}


def _draw_detail_and_light(axes: Axes, result: StudyResult, curve: Curve) -> dict[str, list[float]]:
    """Draw MTF50 (left) and MPE30 (right) against pixel size, and return them as columns."""
    mtf50: list[float] = []
    display_mtf50: list[float] = []
    mpe30: list[float] = []
    for pitch_um in curve.pitch_um.tolist():
        physics = result.physics(curve.technology, pitch_um)
        path_um = longest_path_um(result, curve, pitch_um)
        mtf50.append(mtf50_cy_per_mm(result, physics, system_mtf, path_um))
        display_mtf50.append(mtf50_cy_per_mm(result, physics, scene_to_display_mtf, path_um))
        mpe30.append(mpe30_lx_s(result, physics))

    blue, orange = COLOURS[:2]
    lines = axes.plot(
        curve.pitch_um, mtf50, "o-", ms=4, color=blue, label="MTF50 on the sensor (left axis)"
    )
    lines += axes.plot(
        curve.pitch_um,
        display_mtf50,
        "^:",
        ms=4,
        color=blue,
        label="MTF50 on the display (left axis)",
    )
    axes.set_ylabel("MTF50 (lp/mm): detail", color=blue)
    axes.set_ylim(0, _LEGEND_HEADROOM * max(mtf50))

    light_axes = axes.twinx()
    lines += light_axes.semilogy(
        curve.pitch_um, mpe30, "s--", ms=4, color=orange, label="exposure (right axis)"
    )
    light_axes.set_ylabel("exposure for 30 dB (lx·s): light", color=orange)
    light_axes.spines["right"].set_visible(True)
    axes.legend(handles=lines, frameon=False, loc="upper right", handlelength=LEGEND_LINE)
    return {"mtf50_lp_per_mm": mtf50, "shown_mtf50_lp_per_mm": display_mtf50, "mpe30_lx_s": mpe30}


def _draw_mtf_terms(axes: Axes, result: StudyResult, curve: Curve) -> dict[str, Array]:
    """Draw the MTF of each blur term at fine detail against pixel size, and return the MTFs as
    columns.
    """
    frequency, _ = detail_frequency_lp_per_mm(result.irradiance, curve.optimum.pitch_um)
    pixel_terms = []
    for pitch_um in curve.pitch_um.tolist():
        physics = result.physics(curve.technology, pitch_um)
        path_um = longest_path_um(result, curve, pitch_um)
        pixel_terms.append(study_mtf_terms(result, physics, np.array(frequency), path_um))
    terms = {
        term: np.array([float(values[term]) for values in pixel_terms]) for term in pixel_terms[0]
    }

    product = draw_terms(axes, curve.pitch_um, terms, result.study.display.interpolation)
    axes.set(xlabel="pixel size (µm)", ylabel=f"MTF at {frequency:.3g} lp/mm", ylim=(0, 1.02))
    axes.grid(alpha=0.25)
    return {
        f"{term.replace(' ', '_')}_mtf_at_{frequency:.3g}_lp_per_mm": mtf
        for term, mtf in (terms | {"shown": product}).items()
    }


class PictureTask(NamedTuple):
    """Task of a worker: maps of one of the paper's pixel sizes, or pictures of all sizes.

    pitch_um : of the maps; 0 for pictures
    """

    technology: str
    pitch_um: float

    def __str__(self) -> str:
        if self.pitch_um:
            return f"maps of {self.pitch_um:g} µm pixels"
        return f"pictures of {self.technology}"


def make_pictures(
    call: tuple[int, PictureTask], result: StudyResult
) -> tuple[int, Views | SizeMaps]:
    """Return the pictures or maps of a task, with its number. Nothing here imports Matplotlib."""
    number, task = call
    if task.pitch_um:
        return number, size_maps(result, task.pitch_um, task.technology, SENSORS)
    return number, study_views(
        result, next(curve for curve in result.curves if curve.technology == task.technology)
    )


class StudyDrawing:
    """A thread that draws the figures of a study: those that follow from its light alone while
    workers evaluate.

    figures : "pdf" draws a PDF beside each SVG
    sizes : pitch -> maps of the paper's pixel sizes, if they are begun
    """

    def __init__(self, thread: ThreadPoolExecutor, figures: Figures) -> None:
        self._thread = thread
        self.figures = figures
        self.sizes: dict[float, Future[SizeMaps]] = {}

    def begin(self, study: StudyResult) -> None:
        """Begin to draw the figures that follow from the light alone.

        study : in its light, without curves
        """
        self._thread.submit(prepare_to_draw)
        self._thread.submit(html, Document("study", "", "", {}))  # which compiles the templates
        if study.study.paper:
            self.sizes = {
                pitch_um: self._thread.submit(size_maps, study, pitch_um)
                for pitch_um in FIGURE_6_PITCHES_UM
            }

    def plot(self, draw: Callable[P, Plate], *args: P.args, **options: P.kwargs) -> Plot:
        """Return a figure that is drawn after those that wait."""
        return Plot(self._thread.submit(lambda: draw(*args, **options).drawn(self.figures)).result)

    def begun_sizes(self) -> dict[float, Future[SizeMaps]]:
        """Return the maps of sizes that are made or being made; workers make the others faster."""
        return {pitch_um: maps for pitch_um, maps in self.sizes.items() if not maps.cancel()}

    def wait(self) -> None:
        """Wait for all figures."""
        self._thread.submit(lambda: None).result()


@contextmanager
def study_drawing(figures: Figures = "svg") -> Iterator[StudyDrawing]:
    """Provide the drawing of a study; figures that wait are given up when the block ends."""
    with drawing_thread() as thread:
        yield StudyDrawing(thread, figures)


def _pictures_of_workers(
    result: StudyResult, workers: Workers, sizes_um: Sequence[float]
) -> tuple[list[Views], dict[float, SizeMaps]]:
    """Return pictures of each technology judged by ΔE, and maps of pixel sizes of the paper's."""
    tasks = [PictureTask(curve.technology, 0.0) for curve in result.curves if curve.has_delta_e]
    tasks += [PictureTask(REFERENCE_TECHNOLOGY, pitch_um) for pitch_um in sizes_um]

    def shared_result() -> (
        StudyResult
    ):  # one function for all calls, so that workers share the result
        return result

    results = dict(
        results_of(
            make_pictures,
            [((number, task), shared_result) for number, task in enumerate(tasks)],
            workers,
        )
    )
    parts = [results[number] for number in range(len(tasks))]
    views = [part for part in parts if isinstance(part, Views)]
    return views, {
        part.score.physics.pitch_um: part for part in parts if isinstance(part, SizeMaps)
    }


def curve_figures(result: StudyResult, first: Curve) -> list[Callable[[], Plate]]:
    """Return functions that draw the figures of all curves and of the first one. The first figure
    answers the question of the study.
    """
    draw: list[Callable[[], Plate]] = [lambda: delta_e_against_pitch([first])]
    if len(result.curves) > 1:
        draw.insert(
            0, lambda: delta_e_against_pitch(result.curves).named("delta_e_against_pitch_all")
        )
    if regrets := metric_regrets(first):
        draw.append(lambda: regrets_plate(regrets, first.pitch_um))
    if len(first.metrics) > 1:
        draw.append(lambda: metrics_against_pitch(first))
    if quanta := study_neq(result):
        draw.append(lambda: neq_against_frequency(quanta))
    if len({curve.feature_size_um for curve in result.curves} - {None}) > 1:
        draw.append(lambda: optimum_against_technology(result))
    return draw


def with_files_of_study(page: Document, result: StudyResult) -> Document:
    """Return the document of a study with settings.toml, from which `pixsim study` makes it again,
    and its sensor types.
    """
    files = {SETTINGS_FILE: result.settings_toml} if result.settings_toml else {}
    files |= scene_copy(result.study.scene.file)
    types = uncertainty_csv(result.uncertainty)
    sections = *uncertainty_sections(result.uncertainty), *page.sections
    return replace(page, files={**files, **types, **page.files}, sections=sections)


def report_files(study: Study) -> set[str]:
    """Return the names of all files that the report of a study may have."""
    labels = [file_label(label) for label in labels_of(study.technologies)]
    plates = {
        "delta_e_against_pitch",
        "delta_e_against_pitch_all",
        "optimum_against_technology",
        "light_against_detail",
    }
    plates |= {REGRETS, "metrics", NEQ}
    plates |= {"figure_6_iso_delta_e"} if study.paper else set()
    plates |= {NAME} if study.noise_budget else set()
    sheets = (f"figures/contact_sheet_{label}.png" for label in labels)
    return {"report.html", "summary.json", SETTINGS_FILE, *figure_files(plates), *sheets}


def study_document(result: StudyResult, warned: Collection[str] = ()) -> Document:
    """Return the answer of `pixsim study`, without the figures and pictures of its page.

    warned : notes that a reader of the terminal has seen
    """
    film = [Fact(film_words(result.film.as_dict()))] if result.film else []
    content = {
        "film": result.film and result.film.as_dict(),
        "window_mm": result.study.window_mm,
        "white_spectrum": white_light(result.irradiance)[1],
        "irradiance": result.irradiance.header,
    }
    return document_of(result, study_data(result, content), [], film, warned)


def document_of(
    result: StudyResult,
    data: dict[str, Any],
    regrets: Sequence[Regrets],
    facts: Sequence[Block],
    warned: Collection[str],
) -> Document:
    """Return the document of a study, without the figures and pictures of its page.

    regrets : of its conditions
    facts : further ones
    warned : notes that a reader of the terminal has seen
    """
    first = result.curves[0].metric.name
    weighted = [
        weighted_answer(condition_regrets)
        for condition_regrets in regrets
        if condition_regrets.criteria[0].metric.name == first
    ]
    answers = [*weighted, *(optimum_answer(curve) for curve in result.curves if not curve.alone)]
    left_out_count = len(answers) - _MAX_ANSWERS
    left_out = [Fact(f"and {left_out_count} more: optima.csv")] if left_out_count > 0 else []
    notes = [note for note in study_notes(result) if note not in warned]
    return Document(
        command="study",
        kind="study of pixel sizes",
        title=result.study.title or result.study.name,
        data=data,
        answers=answers[:_MAX_ANSWERS],
        lead=(
            Plot(lambda: delta_e_against_pitch(result.curves)),
            *(
                *left_out,
                *study_facts(result),
                *facts,
                *uncertainty_blocks(result.uncertainty),
                *notes,
            ),
        ),
    )


def study_data(result: StudyResult, content: Mapping[str, Any], **shared: Any) -> dict[str, Any]:
    """Return a study as in summary.json.

    content : further entries, of which empty ones are left out
    shared : further entries that the JSON of all commands has
    """
    settings = result.study.model_dump(mode="json")
    settings["scene"]["file"] = stated_file(result.study.scene.file)
    uncertainty = [distribution.as_dict() for distribution in result.uncertainty]
    further = {"chosen": result.view, **content, "uncertainty": uncertainty}
    entries = {
        "study": settings,
        "curves": [
            curve_data(curve) | {"dark": result.part_of(curve).dark(curve)}
            for curve in result.curves
        ],
        **{name: value for name, value in further.items() if value},
    }
    optima = [optimum for curve in result.curves for optimum in optima_data(curve)]
    return result_data(
        entries,
        settings=settings,
        notes=study_notes(result),
        table=ROWS_FILE,
        optima=optima,
        **shared,
    )


_STUDY_EXPLAINED = (
    "All pixel sizes see the same light on the same die. Small pixels suffer from noise, large ones"
    " from blur. The 95 % interval is that of the size with the smallest expected error. It"
    " includes noise and fixed pattern of the sensors, the registration of pixels with the detail,"
    " and the uncertainty of the curve between the sizes tried; not the error of the render and its"
    " film, or the choice of lens, process and display."
)
PAPER = (
    'Chen, Catrysse, El Gamal and Wandell, "How small should pixel size be?", Proc. SPIE 3965'
    " (2000)."
)


def study_page(
    result: StudyResult,
    workers: Workers,
    drawing: StudyDrawing,
    budgets: Mapping[str, NoiseBudget] = _NO_BUDGETS,
) -> Document:
    """Return the document, with its page, of a study without axes or of a case of one with axes.

    budgets : of `noise_budgets`
    """
    curves = {curve.technology: curve for curve in result.curves}
    reference = curves.get(REFERENCE_TECHNOLOGY, result.curves[0])
    begun_sizes = drawing.begun_sizes()
    first_plot, *further_plots = [drawing.plot(draw) for draw in curve_figures(result, reference)]
    limits = drawing.plot(light_against_detail, result, reference)
    if workers.jobs == 1:  # nothing else computes meanwhile
        drawing.wait()

    # Pictures, and the maps of the paper's sizes that the drawing has not begun.
    has_paper = result.study.paper
    sizes_um = []
    if has_paper:
        sizes_um = [pitch_um for pitch_um in FIGURE_6_PITCHES_UM if pitch_um not in begun_sizes]
    views, sizes = _pictures_of_workers(result, workers, sizes_um)
    sizes |= {pitch_um: maps.result() for pitch_um, maps in begun_sizes.items()}
    evidence = Evidence(result, curves, sizes)
    statements = findings(evidence) if has_paper else []
    paper = _paper(statements)
    if has_paper:
        paper.append(drawing.plot(figure_6, evidence))

    document = study_document(result)
    data = dict(document.data)
    if statements:
        data["paper"] = [asdict(statement) for statement in statements]
    optima = [optima_table(result.curves)] if len(result.curves) > 1 else ()
    setting_blocks = settings_blocks(settings(result))
    if all(curve.data_sheet for curve in result.curves):
        setting_blocks.append(UNSTATED_NOISE)
    computation = [*_about(result), _rendered(result)]
    return replace(
        document,
        answers=tuple(document.answers)[:ANSWERS_OF_PAGE],
        data=data,
        lead=(first_plot, *tuple(document.lead)[1:]),
        sections=(
            Section("optima", "Optima", optima),
            Section("see", "Pictures", _pictures(result, views)),
            Section("paper", "Statements of the paper", paper),
            Section("curves", "Further curves", further_plots),
            budgets_section(budgets),
            Section("limits", "What limits these pixels", [limits]),
            Section("settings", "Settings", setting_blocks),
            Section("made", "How this was computed", computation, folded=True),
        ),
        files={f"figures/contact_sheet_{view.file_label}.png": view.sheet for view in views},
    )


def plot_of(plate: Plate | DrawnFigure) -> Plot:
    """Return a figure that is made already."""
    return Plot(lambda: plate)


def _about(result: StudyResult) -> Iterator[Block]:
    """Yield explanations of the numbers of a page."""
    yield _STUDY_EXPLAINED
    if any(curve.has_delta_e for curve in result.curves):
        yield DELTA_E
    if result.study.display.raster == "fixed_size":
        yield (
            f"A border of {result.study.border_um:.3g} µm, one and a half of the largest pixels of"
            " the study, is not scored."
        )


def _pictures(result: StudyResult, views: Sequence[Views]) -> Iterator[Block]:
    """Yield the pictures of each technology."""
    study = result.study
    for number, view in enumerate(views, 1):
        caption = f"detail in {view.label}"
        label = capital(view.label)
        yield Section(
            "", f"{label}: the same detail for every pixel size", [Tiles(view.tiles, caption)]
        )
        errors = Pictures(view.crops, caption), DeltaEScale(scale(map_end(result)))
        yield Section("", f"{label}: errors in that detail", errors, together=True)
        slider = Slider(
            f"slider-{number}",
            "Pixel size to compare with the ideal image:",
            view.ideal,
            view.outputs,
        )
        size = size_words(view.factor, study.display.samples_per_deg)
        yield Section(
            "", f"{label}: whole pictures and the ideal image", [size, slider], together=True
        )


def _paper(rows: Sequence[Finding]) -> list[Block]:
    """Return the statements of the paper, if they are compared."""
    head = "statement of the paper", "paper", "pixsim", "agrees"
    statements = [(row.statement, row.given, row.found, agrees(row.agrees)) for row in rows]
    if rows:
        return [
            PAPER,
            DocumentTable("statements of the paper", head, statements, words=None, stacks=True),
        ]
    return []


def agrees(is_agreed: bool) -> Text:
    """Return whether a result agrees with a statement, for a cell of a table."""
    return "yes" if is_agreed else (Strong("does not agree"),)


def _rendered(result: StudyResult) -> str:
    """Return the source of a study's light, and the seeds, as a sentence."""
    header = result.irradiance.header
    seed = f", seed {header['seed']}" if "plan" in header else ""
    return f"Irradiance: {rendered_words(header)}{seed}. Study seed {result.study.seed}."


def settings(result: StudyResult) -> list[DocumentTable]:
    """Return the tables of parameters with their meaning and source; unset ones come from the
    technology.
    """
    study = result.study
    coloured = any(study.options_of(technology).colour for technology in study.technologies)
    sheets = all(curve.data_sheet for curve in result.curves)
    pixel = None if all(name in study.sensors for name in study.technologies) else study.pixel
    scene = scene_rows(result.irradiance, study.scene.parameters, result.light_level, study.sources)
    return [
        *settings_tables(scene, study, result.camera, pixel, coloured, sheets, study.sources),
        *(
            settings_table(
                f"pixel of {curve.label}", record_rows("pixel", sensor, curve.data_sheet, {})
            )
            for curve in result.curves
            if (sensor := study.sensors.get(curve.technology))
        ),
    ]
