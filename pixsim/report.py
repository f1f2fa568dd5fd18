"""The report of a study: figures with their data, summary.json, and one HTML file that opens offline."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pixsim.assumed import FILLED, Light, Row, only_sheets, record_rows, scene_rows
from pixsim.curve_plates import delta_e_against_pitch, light_against_detail, optimum_against_technology, other_statistics
from pixsim.details import scale
from pixsim.engine import Workers, results_of
from pixsim.files import output_folder, replacing, versions, write_json
from pixsim.merit import blur_words
from pixsim.pages import text_uri, write_page
from pixsim.paper import REFERENCE_TECHNOLOGY, Evidence, Finding, findings, response_note
from pixsim.paper_figures import map_plates, scene_plates
from pixsim.parameters import Record
from pixsim.pixel import physics_of
from pixsim.pixel_record import NO_TECHNOLOGY
from pixsim.plates import SENSORS_SHOWN, Drawn, Plate, pictures
from pixsim.study_result import Curve, StudyResult
from pixsim.technology import Technology, technology_of
from pixsim.views import Views, best_place, study_views
from pixsim.wording import interval_words, study_dark_notes, target_notes, within_words

# Of the paper, for the curves that any study has.
FIGURE_NUMBERS = {
    "delta_e_against_pitch": "Figure 7. ",
    "delta_e_against_pitch_all": "Figure 8. ",
    "optimum_against_technology": "Figure 9. ",
}
# Of the page, and the sections whose figures stand under them.
HEADINGS = {"curves": ("curves", "more"), "maps": ("pictures",), "paper": ("paper's scene", "paper's maps")}


@dataclass(frozen=True)
class Section:
    """Figures that are drawn together: curves, pictures (of one technology), more, or those of the paper (its scene, its maps)."""

    number: int
    kind: str
    technology: str = ""

    def __str__(self) -> str:
        return f"figures of {self.technology or self.kind}"


def sections_of(result: StudyResult) -> list[Section]:
    """The figures of a study, in the report's order."""
    kinds = [("curves", ""), *(("pictures", curve.technology) for curve in result.curves), ("more", "")]
    kinds += [("paper's scene", ""), ("paper's maps", "")] if result.study.paper else []
    return [Section(number, kind, technology) for number, (kind, technology) in enumerate(kinds)]


@dataclass(frozen=True)
class Made:
    """What a section came to: its figures, the pictures that people see, and what it found."""

    section: Section
    drawn: list[Drawn]
    views: Views | None = None
    rows: tuple[Finding, ...] = ()


def draw_section(section: Section, result: StudyResult) -> Made:
    by_name = {curve.technology: curve for curve in result.curves}
    first = by_name.get(REFERENCE_TECHNOLOGY, result.curves[0])
    rows: list[Finding] = []
    views = None
    if section.kind == "curves":
        plates = plates_of_curves(result, first)
    elif section.kind == "pictures":
        curve = by_name[section.technology]
        scores = result.scores(curve.technology, float(curve.pitch_um[best_place(curve)]), SENSORS_SHOWN)
        maps = [score.delta_e for score in scores]
        plates = [pictures(result, curve, scores[0], maps, f"pictures_{curve.file_label}")]
        views = study_views(result, curve, scores[0])
    elif section.kind == "more":
        plates = [other_statistics(result, first), light_against_detail(result, first)]
    elif section.kind == "paper's scene":
        plates = scene_plates(result)
    else:
        evidence = Evidence(result, by_name)
        rows, plates = findings(evidence), map_plates(evidence)
    return Made(section, [Drawn.of(plate) for plate in plates], views, tuple(rows))


def plates_of_curves(result: StudyResult, first: Curve) -> list[Plate]:
    plates = [delta_e_against_pitch(result, [first])]
    if len(result.curves) > 1:
        plates += [delta_e_against_pitch(result, result.curves, "delta_e_against_pitch_all")]
        processes = all(curve.technology != NO_TECHNOLOGY for curve in result.curves)
        if processes and len({curve.feature_size_um for curve in result.curves}) > 1:
            plates.append(optimum_against_technology(result))
    if not result.study.paper:
        return plates
    return [replace(plate, caption=FIGURE_NUMBERS[plate.name] + plate.caption) for plate in plates]


def write_report(
    result: StudyResult,
    folder: str | os.PathLike[str],
    seconds: dict[str, float] | None = None,
    workers: Workers | None = None,
) -> Path:
    """Write report.html and what it shows: figures/ (*.svg, *.csv, contact sheets), summary.json and provenance.json.

    Wall times stand in the report and in provenance.json only: everything else is the same bytes each time, and does not
    depend on the workers that draw the figures.

    Parameters
    ----------
    result : of `study`
    folder : made if need be
    seconds : stage -> s that it took, to be told
    workers : processes that draw; None draws here

    Returns the path of report.html. Raises PixsimError for a folder that cannot be written to.
    """
    with output_folder(folder) as made:
        return _write(result, made, seconds or {}, workers or Workers())


def _write(result: StudyResult, folder: Path, seconds: dict[str, float], workers: Workers) -> Path:
    longest_first = reversed(sections_of(result))

    def itself() -> StudyResult:
        return result

    calls = [(section, itself) for section in longest_first]
    made = sorted(results_of(draw_section, calls, workers), key=lambda each: each.section.number)
    rows = [row for each in made for row in each.rows]
    views = [each.views for each in made if each.views]
    shown = {
        heading: write_drawn(folder, [drawn for each in made if each.section.kind in kinds for drawn in each.drawn])
        for heading, kinds in HEADINGS.items()
    }
    for each in views:
        with replacing(folder / "figures" / f"contact_sheet_{each.file_label}.png") as partial:
            partial.write_bytes(each.sheet)
    paper_table = {"paper": [row.as_dict() for row in rows]} if rows else {}
    write_json(folder / "summary.json", result.as_dict() | paper_table)
    provenance = {"versions": versions(), "seconds": seconds}
    write_json(folder / "provenance.json", provenance)

    def light_of(curves: Sequence[Curve]) -> Light:
        times_s = np.concatenate([curve.mean("integration_s") for curve in curves])
        return Light.of(result.irradiance, result.study.display, times_s)

    def blur_of(curve: Curve) -> str:
        physics = physics_of(result.study, curve.technology, curve.optimum.pitch_um)
        return blur_words(result.irradiance, result.camera, physics, result.study.display)

    light = light_of(result.curves)
    page = {
        "study": result.study,
        "interval": interval_words,
        "within": within_words,
        "curves": [(curve, curve.as_dict(), light_of([curve])) for curve in result.curves],
        "blurs": [(curve, blur_of(curve)) for curve in result.curves],
        "plates": shown,
        "views": views,
        "scale_bar": scale(),
        "findings": rows,
        "notes": [each.removeprefix("note: ") for each in (*target_notes(result), *study_dark_notes(result))],
        "response_note": response_note(result.study) if result.study.paper else "",
        "budget": result.budget,
        "header": result.irradiance.header,
        "settings": settings(result, light),
        "filled": FILLED,
        "sheets": NO_TECHNOLOGY in result.study.technologies,
        "technologies": [
            (process.name, technology_rows(process))
            for process in (technology_of(result.study, name) for name in result.study.technologies if name != NO_TECHNOLOGY)
        ],
        "provenance": provenance,
    }
    return write_page(folder / "report.html", "report.html.j2", page)


def write_plates(folder: Path, plates: Sequence[Plate]) -> list[tuple[Drawn, str, str]]:
    """`write_drawn` of figures that are still to be drawn."""
    return write_drawn(folder, [Drawn.of(plate) for plate in plates])


def write_drawn(folder: Path, drawn: Sequence[Drawn]) -> list[tuple[Drawn, str, str]]:
    """Write figures/*.svg and their data, figures/*.csv; each with both as data URIs, for a page that opens offline."""
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    shown = []
    for each in drawn:
        for suffix, text in (("svg", each.svg), ("csv", each.csv)):
            with replacing(figures / f"{each.name}.{suffix}") as partial:
                partial.write_text(text, encoding="utf-8", newline="")
        shown.append((each, text_uri("image/svg+xml", each.svg), text_uri("text/csv", each.csv)))
    return shown


def settings(result: StudyResult, light: Light) -> list[tuple[str, list[Row]]]:
    """The parameters with their meaning and source, as the report's tables show them; unset ones come from the technology."""
    study = result.study
    records: dict[str, Record] = {
        "camera": result.camera, "pixel": study.pixel, "exposure": study.exposure, "display": study.display,
    }  # fmt: skip
    sheets = only_sheets(study.technologies)
    tables = [(name, record_rows(name, record, sheets, study.sources)) for name, record in records.items()]
    return [("scene", scene_rows(result.irradiance, study.scene.parameters, light, study.sources)), *tables]


def technology_rows(process: Technology) -> list[tuple[str, float | str, str, str]]:
    """Name, value, plausible range and source of each number of a process, for the report's table."""
    values = process.content | process.numbers
    ranges = {name: f"{low:g} to {high:g}" for name, (low, high) in process.ranges.items()}
    return [(name, values.get(name, ""), ranges.get(name, ""), source) for name, source in process.sources.items()]
