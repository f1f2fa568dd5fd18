"""The report of a study: figures with their data, summary.json, and one self-contained HTML file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pixsim.base.config import SETTINGS_FILE
from pixsim.base.files import check_replaceable, output_folder, publishing, versions, write_json
from pixsim.base.labels import file_label, labels_of
from pixsim.base.parameters import Record, Study
from pixsim.report.paper import PAPER_PLATES, map_plates, scene_plates
from pixsim.report.settings import FILLED, Row, record_rows, scene_rows
from pixsim.report.views import SENSORS_SHOWN, Views, best_place, map_end, study_pictures, study_views
from pixsim.report.wording import blur_words, film_words, no_difference_words, outside_words, study_light_lines, study_view_line
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, draw_terms, new_figure, own_style
from pixsim.show.pages import Column, Drawn, Plate, table_csv, write_figures
from pixsim.show.pictures import scale
from pixsim.show.render import write_page
from pixsim.studies.claims import REFERENCE_TECHNOLOGY, Evidence, Finding, findings, response_note
from pixsim.studies.engine import Workers, results_of
from pixsim.studies.extent import csf_range_lp_per_mm
from pixsim.studies.light_level import LightLevel
from pixsim.studies.merit import detail_frequency_lp_per_mm, mpe30_lx_s, mtf50_cy_per_mm, shown_mtf, study_mtf_terms
from pixsim.studies.parts import parts_table
from pixsim.studies.result import (
    Curve,
    StudyResult,
    alike_words,
    curve_table,
    delta_e_against_pitch,
    interval_columns,
    interval_words,
    viewed_words,
    with_ends,
    within_words,
)
from pixsim.studies.unconverged import study_unconverged_lines

PARTS_FILE = "parts.csv"
LEGEND_HEADROOM = 1.35  # over the highest point, for a legend of three lines


@own_style()
def other_statistics(result: StudyResult, curve: Curve) -> Plate:
    """Plot the mean, percentiles and maximum of ΔE against pitch, each over its minimum."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    for (name, values), look in zip(curve.means.items(), LOOKS, strict=False):
        label = f"{name.removesuffix('_delta_e')}: minimum {values.min():.2f} at {curve.pitch_um[values.argmin()]:.2f} µm"
        axes.plot(curve.pitch_um, values / values.min(), ms=3.5, lw=1, label=label, **look.line)
    axes.set(xlabel="pixel size (µm)", ylabel="ΔE over its minimum", ylim=(0.9, 3.0))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, handlelength=LEGEND_LINE)
    at_um = {name: float(curve.pitch_um[values.argmin()]) for name, values in curve.means.items()}
    low, high = (end(at_um, key=at_um.__getitem__) for end in (min, max))
    words = [f"{at_um[name]:.2f} µm ({name.removesuffix('_delta_e')})" for name in (low, high)]
    same = at_um[low] == at_um[high]
    best = f"at {at_um[low]:.2f} µm by every statistic" if same else f"from {words[0]} to {words[1]}, by the statistic"
    caption = (
        f"Of the sizes tried, the least error is {best}. Statistics of ΔE of the same pictures ({curve.label}), each divided by "
        "its minimum."
    )
    if csf_range_lp_per_mm(result.irradiance):
        caption += (
            " The maximum belongs to single dots in the darkest bars, where S-CIELAB, which blurs colour more widely than "
            "luminance, is most sensitive."
        )
    return Plate("other_statistics", caption, figure, curve_table([curve]))


@own_style()
def optimum_against_technology(result: StudyResult) -> Plate:
    """Plot the optima with their intervals, and the line of an optimum proportional to the feature size."""
    curves = sorted(result.curves, key=lambda curve: curve.feature_size_um)
    feature_um = np.array([curve.feature_size_um for curve in curves])
    size_um = np.array([curve.optimum.pitch_um for curve in curves])
    low_um, high_um = np.array([with_ends(curve.optimum.interval_um, curve) for curve in curves]).T
    figure = new_figure(5.4, 4.0)
    axes = figure.subplots()
    bars = np.maximum([size_um - low_um, high_um - size_um], 0.0)
    axes.errorbar(feature_um, size_um, bars, fmt="o", color=COLOURS[0], lw=2, capsize=4, label="optimum, 95 % interval")
    proportional = size_um[-1] / feature_um[-1] * feature_um
    axes.plot(feature_um, proportional, "--", color="0.4", label="proportional to feature size")
    axes.set(xlabel="feature size (µm)", ylabel="optimal pixel size (µm)", xlim=(0, None), ylim=(0, None))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    table = {
        "technology": [curve.label for curve in curves],
        "feature_size_um": feature_um.tolist(),
        "optimum_um": size_um.tolist(),
        **interval_columns(curves),
        "optimum_features": (size_um / feature_um).tolist(),
        "mean_delta_e": [curve.optimum.mean_delta_e for curve in curves],
        "proportional_um": proportional.tolist(),
    }
    first, last = -1, 0
    features = size_um / feature_um
    caption = (
        f"From {feature_um[first]:g} to {feature_um[last]:g} µm, the optimum goes from {size_um[first]:.2f} to "
        f"{size_um[last]:.2f} µm, "
        f"which is {features[first]:.3g} to {features[last]:.3g} feature sizes. The line goes through the largest process, as if "
        "the "
        "optimum were proportional to the feature size."
    )
    return Plate("optimum_against_technology", caption, figure, table)


@own_style()
def light_against_detail(result: StudyResult, curve: Curve) -> Plate:
    """Plot MTF50 and MPE30 of each pitch, the two sides of the trade-off, and the MTF of each blur term at fine detail."""
    pixels = [result.physics(curve.technology, pitch_um) for pitch_um in curve.pitch_um.tolist()]
    mtf50 = [mtf50_cy_per_mm(result, physics) for physics in pixels]
    shown50 = [mtf50_cy_per_mm(result, physics, shown_mtf) for physics in pixels]
    mpe30 = [mpe30_lx_s(result, physics) for physics in pixels]
    figure = new_figure(6.4, 6.8)
    axes, lower = figure.subplots(2, 1, sharex=True)
    detail = axes.plot(curve.pitch_um, mtf50, "o-", ms=4, color=COLOURS[0], label="MTF50 on the sensor (left axis)")
    detail += axes.plot(curve.pitch_um, shown50, "^:", ms=4, color=COLOURS[0], label="MTF50 on the display (left axis)")
    axes.set_ylabel("MTF50 (lp/mm): detail", color=COLOURS[0])
    axes.set_ylim(0, LEGEND_HEADROOM * max(mtf50))
    other = axes.twinx()
    light = other.semilogy(curve.pitch_um, mpe30, "s--", ms=4, color=COLOURS[1], label="exposure (right axis)")
    other.set_ylabel("exposure for 30 dB (lx·s): light", color=COLOURS[1])
    other.spines["right"].set_visible(True)
    axes.legend(handles=[*detail, *light], frameon=False, loc="upper right", handlelength=LEGEND_LINE)

    frequency, name = detail_frequency_lp_per_mm(result.irradiance, curve.optimum.pitch_um)
    of_pixels = [study_mtf_terms(result, physics, np.array(frequency)) for physics in pixels]
    terms = {term: np.array([float(values[term]) for values in of_pixels]) for term in of_pixels[0]}
    shown = draw_terms(lower, curve.pitch_um, terms, result.study.display.interpolation)
    table: dict[str, Column] = {
        "pitch_um": curve.pitch_um.tolist(), "mtf50_lp_per_mm": mtf50, "shown_mtf50_lp_per_mm": shown50, "mpe30_lx_s": mpe30,
    }  # fmt: skip
    table |= {
        f"{term.replace(' ', '_')}_mtf_at_{frequency:.3g}_lp_per_mm": mtf.tolist()
        for term, mtf in (terms | {"shown": shown}).items()
    }
    lower.set(xlabel="pixel size (µm)", ylabel=f"MTF at {frequency:.3g} lp/mm", ylim=(0, 1.02))
    lower.grid(alpha=0.25)
    ends = [f"{mpe:.3g} lx·s" if np.isfinite(mpe) else "none below saturation" for mpe in (mpe30[0], mpe30[-1])]
    caption = (
        f"From {curve.pitch_um[0]:.3g} to {curve.pitch_um[-1]:.3g} µm, MTF50 on the sensor goes from {mtf50[0]:.3g} to "
        f"{mtf50[-1]:.3g} "
        f"lp/mm, and the exposure for 30 dB from {ends[0]} to {ends[1]}. "
        f"Both sides of the trade-off ({curve.label}). Above: MTF50, the frequency at which the MTF is one half, on the sensor and "
        "on the display (higher is better), and the minimum exposure on the sensor for an SNR of 30 dB (equation 2 at 30 ms; lower "
        f"is better). Below: MTF of each term at {frequency:.3g} lp/mm, {name}, and their product."
    )
    return Plate("light_against_detail", caption, figure, table)


# In the paper, of curves that any study has.
FIGURE_NUMBERS = {"delta_e_against_pitch": 7, "delta_e_against_pitch_all": 8, "optimum_against_technology": 9}
# Headings of the page, and the kinds of sections under them.
HEADINGS = {"curves": ("curves", "more"), "maps": ("pictures",), "paper": ("paper's scene", "paper's maps")}


class Section(NamedTuple):
    """Figures drawn together: curves, pictures (of one technology), more, or those of the paper (its scene, its maps)."""

    number: int
    kind: str
    technology: str = ""

    def __str__(self) -> str:
        return f"figures of {self.technology or self.kind}"


def draw_section(section: Section, result: StudyResult) -> tuple[Section, list[Drawn], Views | None, list[Finding]]:
    """Return a section, its figures, its pictures, and its statements of the paper."""
    by_name = {curve.technology: curve for curve in result.curves}
    first = by_name.get(REFERENCE_TECHNOLOGY, result.curves[0])
    rows: list[Finding] = []
    views = None
    if section.kind == "curves":
        plates = plates_of_curves(result, first)
    elif section.kind == "pictures":
        curve = by_name[section.technology]
        pitch_um = float(curve.pitch_um[best_place(curve)])
        # A data sheet's sensor may have many millions of pixels: no more of them than the study simulated.
        count = SENSORS_SHOWN if result.study.own_um is None else min(SENSORS_SHOWN, result.sensors_at(curve.technology, pitch_um))
        scores = result.shown_scores(curve.technology, pitch_um, count)
        plates = [study_pictures(result, curve, scores[0], [score.delta_e for score in scores], f"pictures_{curve.file_label}")]
        views = study_views(result, curve, scores[0])
    elif section.kind == "more":
        plates = [other_statistics(result, first), light_against_detail(result, first)]
    elif section.kind == "paper's scene":
        plates = scene_plates(result)
    else:
        evidence = Evidence(result, by_name)
        rows, plates = findings(evidence), map_plates(evidence)
    return section, [plate.drawn() for plate in plates], views, rows


def plates_of_curves(result: StudyResult, first: Curve) -> list[Plate]:
    plates = [delta_e_against_pitch(result, [first])]
    if len(result.curves) > 1:
        plates += [delta_e_against_pitch(result, result.curves, "delta_e_against_pitch_all")]
        processes = not any(curve.data_sheet for curve in result.curves)
        if processes and len({curve.feature_size_um for curve in result.curves}) > 1:
            plates.append(optimum_against_technology(result))
    if not result.study.paper:
        return plates
    return [replace(plate, caption=f"Figure {FIGURE_NUMBERS[plate.name]}: {plate.caption}") for plate in plates]


def write_study(
    result: StudyResult,
    folder: str | os.PathLike[str],
    seconds: dict[str, float] | None = None,
    workers: Workers | None = None,
    more: Callable[[Path], None] | None = None,
) -> Path:
    """Write report.html, figures/ (*.svg, *.csv, contact sheets), summary.json and provenance.json.

    Only the wall times in the report and in provenance.json vary: everything else is reproducible byte for byte, and does not
    depend on the workers.

    result : of `study`
    folder : created if missing
    seconds : stage -> wall time in s, for the report
    workers : processes that draw the figures; None means this process
    more : writes further files to the new folder

    Returns the path of report.html. Raises PixsimError if the folder cannot be written, or holds a file of such a name that
    pixsim did not write.
    """
    times_s = {} if seconds is None else seconds
    with output_folder(folder) as path:
        check_replaceable(path, report_files(result.study))
        with publishing(path, "study", {"seconds": times_s}) as unfinished:
            if result.settings_toml:
                (unfinished / SETTINGS_FILE).write_text(result.settings_toml, encoding="utf-8")
            parts = parts_table(result)
            if parts:
                (unfinished / PARTS_FILE).write_text(table_csv(parts), encoding="utf-8")
            write_pages(result, unfinished, times_s, workers or Workers(), parts_rows(parts))
            if more:
                more(unfinished)
        return path / "report.html"


def report_files(study: Study) -> set[str]:
    """Return the names of all files that the report of a study may have."""
    labels = [file_label(label) for label in labels_of(study.technologies)]
    plates = {*FIGURE_NUMBERS, "other_statistics", "light_against_detail", *(f"pictures_{label}" for label in labels)}
    plates |= set(PAPER_PLATES) if study.paper else set()
    figures = {f"{name}.{suffix}" for name in plates for suffix in ("svg", "csv")}
    figures |= {f"contact_sheet_{label}.png" for label in labels}
    return {"report.html", "summary.json", SETTINGS_FILE, PARTS_FILE, *(f"figures/{name}" for name in figures)}


def parts_rows(table: dict[str, Column]) -> list[tuple[float | str, ...]]:
    """Return the rows of a table of columns."""
    return list(zip(*table.values(), strict=True))


def write_pages(
    result: StudyResult,
    folder: Path,
    seconds: dict[str, float],
    workers: Workers,
    error_parts: Sequence[tuple[float | str, ...]] = (),
) -> None:
    """Write report.html, summary.json and figures of a study without axes, or of one of the cases of another, to a new folder.

    error_parts : of `parts_table`, a row for each curve
    """
    study = result.study
    kinds = [("curves", ""), *(("pictures", curve.technology) for curve in result.curves), ("more", "")]
    kinds += [("paper's scene", ""), ("paper's maps", "")] if result.study.paper else []
    longest_first = reversed([Section(number, kind, technology) for number, (kind, technology) in enumerate(kinds)])

    def shared() -> StudyResult:  # one function for all calls, so that workers share the result
        return result

    sections = sorted(results_of(draw_section, [(section, shared) for section in longest_first], workers))
    rows = [row for *_, own in sections for row in own]
    views = [view for _, _, view, _ in sections if view]
    shown = {
        heading: write_figures(folder, [plate for section, drawn, _, _ in sections if section.kind in kinds for plate in drawn])
        for heading, kinds in HEADINGS.items()
    }
    for view in views:
        (folder / "figures" / f"contact_sheet_{view.file_label}.png").write_bytes(view.sheet)
    write_json(folder / "summary.json", result.as_dict() | ({"paper": [asdict(row) for row in rows]} if rows else {}))

    def light_of(curves: Sequence[Curve]) -> LightLevel:
        return LightLevel.of(result.irradiance, study.display, np.concatenate([curve.mean("integration_s") for curve in curves]))

    def blur_of(curve: Curve) -> str:
        physics = result.physics(curve.technology, curve.optimum.pitch_um)
        return blur_words(result.irradiance, result.camera, physics, study.display)

    page = {
        "study": study,
        "interval": interval_words,
        "no_difference": no_difference_words,
        "outside": outside_words,
        "shown": study_view_line(result),
        "within": within_words,
        "viewed": lambda curve: [words for inside in (True, False) if (words := viewed_words(curve, inside))],
        "alike": alike_words,
        "film": film_words(result.film.as_dict()) if result.film else "",
        "unconverged": study_unconverged_lines(result),
        "lens": study_light_lines(result),
        "curves": [(curve, curve.as_dict(), light_of([curve])) for curve in result.curves],
        "blurs": [(curve, blur_of(curve)) for curve in result.curves],
        "plates": shown,
        "views": views,
        "scale_bar": scale(map_end(result)),
        "findings": rows,
        "notes": result.notes,
        "response_note": response_note(study) if study.paper else "",
        "budget": result.budget,
        "error_parts": error_parts,
        "header": result.irradiance.header,
        "settings": settings(result, light_of(result.curves)),
        "filled": FILLED,
        "sheets": any(curve.data_sheet for curve in result.curves),
        "technologies": [technology_rows(result, curve.technology) for curve in result.curves if not curve.data_sheet],
        "provenance": {"versions": versions(), "seconds": seconds},
    }
    write_page(folder / "report.html", "report.html.j2", page)


def settings(result: StudyResult, light: LightLevel) -> list[tuple[str, list[Row]]]:
    """Return the tables of parameters with their meaning and source; unset ones come from the technology."""
    study = result.study
    records: dict[str, Record] = {
        "camera": result.camera,
        "pixel": study.pixel,
        "exposure": study.exposure,
        "correction": study.correction,
        "develop": study.develop,
        "display": study.display,
    }
    coloured = any(study.options_of(technology).colour for technology in study.technologies)
    if not coloured:
        del records["develop"]
    sheets = all(curve.data_sheet for curve in result.curves)
    if all(name in study.sensors for name in study.technologies):
        del records["pixel"]  # each sensor has its own
    tables = [(name, record_rows(name, record, sheets, study.sources, coloured=coloured)) for name, record in records.items()]
    for curve in result.curves:
        if sensor := study.sensors.get(curve.technology):
            tables.append((f"pixel of {curve.label}", record_rows("pixel", sensor, curve.data_sheet, {})))
    return [("scene", scene_rows(result.irradiance, study.scene.parameters, light, study.sources)), *tables]


def technology_rows(result: StudyResult, technology: str) -> tuple[str, list[tuple[str, float | str, str, str]]]:
    """Return a process's name, and the name, value, plausible range and source of each of its numbers."""
    process = result.processes[technology]
    values = process.content | process.numbers
    kinds = {name: f" ({distribution}, 90 %)" for name, distribution in process.distributions.items() if distribution != "uniform"}
    ranges = {name: f"{low:g} to {high:g}{kinds.get(name, '')}" for name, (low, high) in process.ranges.items()}
    return process.name, [(name, values.get(name, ""), ranges.get(name, ""), source) for name, source in process.sources.items()]
