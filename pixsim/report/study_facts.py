"""What stands below the optima of a study: what they depend on, how sure they are, and notes."""

from __future__ import annotations

import math

from pixsim.base.digits import distinct_texts
from pixsim.base.notes import Note, first_notes
from pixsim.light.spectral import PART
from pixsim.report.regret import regrets_tables
from pixsim.report.wording import (
    lens_words,
    part_words,
    reflectance_words,
    thin_lens_words,
    unconverged,
    view_words,
)
from pixsim.show.document import Block, Fact
from pixsim.studies.curve import FILL_COLUMNS, Curve
from pixsim.studies.merit import columns_on, varied_view_settings
from pixsim.studies.optimum import fittable_pitches
from pixsim.studies.regret import metric_regrets
from pixsim.studies.result import StudyResult, fill_notes
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.raw_metrics import INFORMATION
from pixsim.viewer.setting import stage_words

_MAX_REGRET_TABLES = 3  # before an answer has too many lines; summary.json has all


def _study_unconverged(result: StudyResult) -> list[Note]:
    """Return the lines of `unconverged` of a study, each once, for the films at the best pixel
    sizes.
    """
    notes = []
    for curve in result.curves:
        part = result.part_of(curve)
        if curve.has_delta_e:
            lines = unconverged(part.irradiance.header, part.film_at_best(curve))
            notes.append([Note("not_converged", words=line) for line in lines])
    return first_notes(notes)


def _study_view_words(result: StudyResult) -> list[str]:
    """Return a line on how a study of a data sheet's sensor or of a window is shown; empty for
    other studies.
    """
    study = result.study
    if (study.own_um is None and study.window_mm is None) or varied_view_settings(study):
        return []
    columns = None if study.own_um is None else columns_on(result.camera, study.own_um)
    words = view_words(
        study.display, result.irradiance.header, result.view, study.window_mm, columns
    )
    return ["; ".join(words)] if words else []


def _study_light_words(result: StudyResult) -> list[str]:
    """Return a line on the lens of a study, its field, the display's white and the exposure; no
    line where its cases differ.
    """
    lines = []
    for part in result.cases:
        camera = part.camera
        lens = lens_words(camera) or thin_lens_words(camera)
        assumption = part.study.camera.assumption(camera).partition(":")[0]
        light = part_words(part.irradiance.header), str(part.light_level)
        lines.append("; ".join(filter(None, (lens, assumption, *light, *stage_words(part.study)))))
    if len(set(lines)) == 1:
        return lines[:1]

    # The exposures or the light differ: the light, or what it falls on, may not.
    headers = [part.irradiance.header for part in result.cases if PART in part.irradiance.header]
    lights = {part_words(header) for header in headers}
    if len(lights) > 1:
        lights = {f"light {reflectance_words(header)}" for header in headers}
    return list(lights) if len(lights) == 1 else []


def contrast_words(result: StudyResult, curve: Curve) -> list[str]:
    """Return a line on the best sizes by information at contrasts other than the study's; no line
    without such optima.
    """
    contrasts = result.part_of(curve).study.metric.information.other_contrasts or ()
    sizes = [
        f"{curve.fits[name].optimum.pitch_um:.2f} µm at {contrast:.3g}"
        for name, contrast in zip(INFORMATION.variants, contrasts, strict=False)
        if name in curve.fits
    ]
    if sizes:
        return [
            f"{curve.label}: best size by information at other contrasts of the scene:"
            f" {', '.join(sizes)}"
        ]
    return []


def study_facts(result: StudyResult) -> list[Block]:
    """Return the blocks below the optima of a study: regrets, errors of its light, lens and
    display.
    """
    regrets = filter(None, map(metric_regrets, result.curves[:_MAX_REGRET_TABLES]))
    contrasts = [line for curve in result.curves for line in contrast_words(result, curve)]
    lines = [
        *contrasts,
        *_study_unconverged(result),
        *_study_light_words(result),
        *_study_view_words(result),
    ]
    return [
        *(table for curve_regrets in regrets for table in regrets_tables(curve_regrets)),
        *map(Fact, lines),
    ]


# --- notes


def cause_notes(result: StudyResult) -> list[Note]:
    """Return the causes of the mean ΔE of each curve's best size, with what removes them."""
    return first_notes(
        [[cause.note.of([curve.label]) for curve in result.curves for cause in curve.errors.causes]]
    )


def study_notes(result: StudyResult) -> list[Note]:
    """Return the notes of a study: causes of its ΔE, warnings, missed targets, and a black level
    that clips dark noise.
    """
    kinds = target_notes, _open_notes, _undefined_notes, _study_dark_notes
    curve_notes = [note for notes in kinds for note in first_notes([*map(notes, result.cases)])]
    exposed = [
        (part.study.exposure, {name: curve.mean(name) for name in FILL_COLUMNS})
        for part in result.cases
        for curve in part.curves
    ]
    return [*cause_notes(result), *sorted(result.warned), *fill_notes(exposed), *curve_notes]


def target_notes(result: StudyResult) -> list[Note]:
    """Return a note for each optimum that misses the target interval, with the limit that ended the
    search.
    """
    study = result.study
    if study.target_ci_um is None:
        return []
    evaluations = sum(int(curve.sensors.sum()) for curve in result.curves)
    limit = "max_repeats" if study.max_evaluations is None else "max_evaluations"
    notes = []
    for curve in result.curves:
        half_um = curve.optimum.half_width_um
        if half_um > study.target_ci_um:
            half, target = distinct_texts(half_um, study.target_ci_um)
            width = f"± {half} µm" if math.isfinite(half_um) else "open at an end"
            words = (
                f"{width} after {evaluations} evaluations ({limit}); the target is ± {target} µm"
                " (target_ci_um)"
            )
            notes.append(Note("interval", case=curve.label, words=words))
    return notes


def _undefined_notes(result: StudyResult) -> list[Note]:
    """Return a note for each metric that tells a best size, with the pitches that its fitted curve
    does not take, and why.
    """
    notes = []
    for curve in result.curves:
        for metric in (metric for metric in curve.metrics if metric.has_optimum):
            is_left_out = ~fittable_pitches(metric, curve.statistics[metric.columns[0]])
            if is_left_out.any():
                sizes = ", ".join(f"{pitch_um:g}" for pitch_um in curve.pitch_um[is_left_out])
                reason = next(
                    (f": {reason}" for name, _, reason in curve.missing if name == metric.name), ""
                )
                where = "where it is undefined, or 0 or below, or beyond such sizes"
                words = f"the fitted curve of {metric.words} leaves out {sizes} µm, {where}{reason}"
                note = Note("undefined_metric", words=words)
                notes.append(note.of([curve.label]) if curve.label else note)
    return notes


def _open_notes(result: StudyResult) -> list[Note]:
    """Return a note for each optimum whose interval is open at one end, which a size beyond those
    tried may close.
    """
    if result.study.target_ci_um is not None:  # said by `target_notes`
        return []
    notes = []
    for curve in result.curves:
        low, high = curve.optimum.interval_um
        end = 0 if low is None else -1
        tried_um = curve.fitted_range_um[end]
        # Both open: no size would help, but more sensors. A range that does not reach the end: said
        # by `_undefined_notes`.
        if (low is None) != (high is None) and tried_um == curve.pitch_um[end]:
            end_word, comparative, limit = (
                ("smallest", "smaller", "min") if low is None else ("largest", "larger", "max")
            )
            hint = (
                f"a {comparative} one would tell, where that is possible (pitch.{limit}_um or"
                " pitch.values_um)"
            )
            words = (
                f"open, since the {end_word} size tried, {tried_um:.4g} µm, may be the best; {hint}"
            )
            notes.append(Note("interval", case=curve.label, words=words))
    return notes


def _study_dark_notes(result: StudyResult) -> list[Note]:
    """Return a note for each curve whose black level clips dark noise, of the worst of its pixel
    sizes.
    """
    if result.study.correction.removes_dark_level:
        return []
    notes = []
    for curve in result.curves:
        table = result.dark(curve)
        clips = [
            dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)
        ]
        clipped = [place for place, clip in enumerate(clips) if clips_dark(clip)]
        if clipped:
            worst = max(clipped, key=lambda place: clips[place]["of_display_white"])
            clip = clips[worst] | {"least_black_level_dn": max(table["least_black_level_dn"])}
            pixel = result.study.options_of(curve.technology).model_dump()
            notes.append(
                clip_note(clip, pixel, f", most at {curve.pitch_um[worst]:.2f} µm").of(
                    [curve.label]
                )
            )
    return notes
