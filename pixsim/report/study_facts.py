"""What stands below the optima of a study: what they depend on, how sure they are, and notes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pixsim.base.digits import told_apart, with_error
from pixsim.base.notes import Note, few
from pixsim.report.regret import regrets_tables
from pixsim.report.wording import lens_words, thin_lens_words, unconverged, view_words
from pixsim.sensor.pixel import smallest_pitch_um
from pixsim.sensor.stages import stage_words
from pixsim.sensor.technology import with_fill_factor_law
from pixsim.show.document import Block, Fact
from pixsim.studies.curve import Curve
from pixsim.studies.design import largest_lens_um, technology_of
from pixsim.studies.merit import columns_on, moved_view
from pixsim.studies.optimum import told_pitches
from pixsim.studies.regret import metric_regrets
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Study
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.raw_metrics import INFORMATION

MAX_REGRET_TABLES = 8  # before an answer has too many lines; summary.json has all


def study_unconverged(result: StudyResult) -> list[Note]:
    """Return the lines of `unconverged` of a study, each once, for the films at the best pixel sizes."""
    notes = []
    for curve in result.curves:
        part = result.part_of(curve)
        if curve.has_delta_e:
            lines = unconverged(part.irradiance.header, part.film_at_best(curve))
            notes.append([Note("not_converged", words=line) for line in lines])
    return few(notes)


def study_view_words(result: StudyResult) -> list[str]:
    """Return a line on how a study of a data sheet's sensor or of a window is shown; none for other studies."""
    study = result.study
    if study.own_um is None and study.window_mm is None:
        return []
    columns = None if study.own_um is None else columns_on(result.camera, study.own_um)
    words = "; ".join(view_words(study.display, result.irradiance.header, result.view, study.window_mm, columns))
    if others := moved_view(study):
        words += f", except where an axis or a condition sets {' or '.join(others)}"
    own = "" if study.own_um is None else f" (pixels of {study.own_um:g} µm, as on the data sheet)"
    return [f"{words}{own}"] if words else []


def study_light_words(result: StudyResult) -> list[str]:
    """Return a line on the lens of a study, its field, what is display white, and the exposure; in cases, as far as all have it."""
    parts = result.cases
    lenses, whites = [], []
    for part in parts:
        camera = part.camera
        words = lens_words(camera) or thin_lens_words(camera)
        lenses.append("; ".join(filter(None, (words, part.study.camera.assumption(camera).partition(":")[0]))))
        whites.append(part.light_level)
    light = whites[0]._replace(shortest_s=min(w.shortest_s for w in whites), longest_s=max(w.longest_s for w in whites))
    shown = str(light) if len({(each.white, each.unit) for each in whites}) == 1 else f"exposed for {light.exposure}"
    stages = [words for words in stage_words(parts[0].study) if all(words in stage_words(part.study) for part in parts)]
    return ["; ".join([*(lenses[:1] if len(set(lenses)) == 1 else []), shown, *stages])]


def contrast_words(result: StudyResult, curve: Curve) -> list[str]:
    """Return a line on the best size by information at the contrast of a study and at two others; none without such optima."""
    options = result.part_of(curve).study.metric.information
    optimum, fits = curve.optima.get(INFORMATION.name), [curve.fits.get(name) for name in INFORMATION.variants]
    if optimum is None or options.other_contrasts is None:
        return []
    low, high = (None if fit is None else fit.optimum for fit in fits)
    low_contrast, high_contrast = options.other_contrasts
    optima = (low_contrast, low), (options.contrast, optimum), (high_contrast, high)
    sizes = [
        f"{best.pitch_um:.2f} µm{'' if best.inside else ' (an end of the sizes)'} at {contrast:.3g}"
        for contrast, best in optima
        if best is not None
    ]
    return [f"{curve.label}: the best size by information depends on the contrast of the scene: {', '.join(sizes)}"]


def study_facts(result: StudyResult) -> list[Block]:
    """Return what follows the optima of a study: regrets, causes, errors of its light, what it depends on, how it is shown."""
    pairs = pairs_at_best_sizes(result.curves)
    regrets = [metric_regrets(curve) for curve in result.curves[:MAX_REGRET_TABLES]]
    without = [
        f"{curve.label}: {metric.words} tells no best size, since it is 0 or below, or has no number, for too many sizes"
        for curve in result.curves
        for metric in curve.metrics
        if metric.has_optimum and metric.name not in curve.optima
    ]
    contrasts = [words for curve in result.curves for words in contrast_words(result, curve)]
    light, view = study_light_words(result), study_view_words(result)
    words: list[Sequence[str]] = [pairs, without, contrasts, cause_notes(result), study_unconverged(result), light, view]
    tables = [table for metrics_regrets in regrets if metrics_regrets for table in regrets_tables(metrics_regrets)]
    return [*tables, *(Fact(text) for texts in words for text in texts)]


MAX_PAIRS = 12  # of sensors that are named


def pairs_at_best_sizes(curves: Sequence[Curve]) -> list[str]:
    """Return a line for the first sensor of a study and each other one of the same case: which is better at its best size."""
    lines = []
    firsts: dict[str, Curve] = {}
    for curve in curves:
        first = firsts.setdefault(curve.words, curve)
        if first is curve or first.metric != curve.metric:
            continue
        metric, best, other = curve.metric, first.optimum, curve.optimum
        worse_by = float(metric.worse_by(other.value, best.value))
        better, worse = (first, curve) if worse_by >= 0 else (curve, first)
        halves = [(high - low) / 2 for low, high in (best.value_interval, other.value_interval)]
        size = with_error(abs(worse_by), math.hypot(*halves))
        unit = " ΔE" if metric.is_delta_e else f" {metric.unit}".rstrip()
        if abs(worse_by) > math.hypot(*halves):
            lines.append(f"{better.label} is better than {worse.plain_label}, each at its best size, by {size}{unit}")
        else:
            names = f"{first.label} and {curve.plain_label}"
            lines.append(f"{names} cannot be told apart at their best sizes: {better.plain_label} is better by {size}{unit}")
    return lines[:MAX_PAIRS]


# --- notes ----------------------------------------------------------------------------------------------------------------------


def cause_notes(result: StudyResult) -> list[Note]:
    """Return the causes of the mean ΔE of each curve's best size, with what removes them."""
    return few([[cause.note.of([curve.label]) for curve in result.curves for cause in curve.errors.causes]])


def study_notes(result: StudyResult) -> list[Note]:
    """Return what a reader should know besides the optima: warnings, missed targets, a black level that clips dark noise."""
    kinds = target_notes, open_notes, silent_notes, study_dark_notes
    noted = [note for notes in kinds for note in few([*map(notes, result.cases)])]
    return [*cause_notes(result), *sorted(result.warned), *noted]


def target_notes(result: StudyResult) -> list[Note]:
    """Return a note for each optimum that misses the target interval, with the limit that ended the search."""
    study, notes = result.study, []
    evaluations = sum(int(curve.sensors.sum()) for curve in result.curves)
    for curve in result.curves:
        half_um = curve.optimum.half_width_um
        if study.target_ci_um is None or half_um <= study.target_ci_um:
            continue
        if study.max_evaluations is None:
            most = max(study.repeats, study.max_repeats)
            limit = f"{int(curve.sensors.sum())} evaluations, at most {most} per pixel size (max_repeats)"
        else:
            limit = f"{evaluations} of at most {study.max_evaluations} evaluations (max_evaluations)"
        shown_um, target_um = told_apart(half_um, study.target_ci_um)
        width = f"± {shown_um} µm" if math.isfinite(half_um) else "open at an end"
        words = f"{width} after {limit}; the target is ± {target_um} µm (target_ci_um)"
        notes.append(Note("interval", case=curve.label, words=words))
    return notes


def silent_notes(result: StudyResult) -> list[Note]:
    """Return a note for each metric that tells a best size, with the pitches that its fitted curve does not take, and why."""
    notes = []
    for curve in result.curves:
        for metric in (each for each in curve.metrics if each.has_optimum):
            values = curve.statistics[metric.columns[0]]
            known, silent = set(curve.pitch_um.tolist()), set(curve.pitch_um[~told_pitches(metric, values)].tolist())
            reasons = {pitch_um: reason for name, pitch_um, reason in curve.missing if name == metric.name}
            for why, which in (("has no number", reasons.keys()), ("is 0 or below, or beyond such sizes,", known - reasons.keys())):
                if sizes := sorted(silent & which):
                    listed = ", ".join(f"{pitch_um:g}" for pitch_um in sizes)
                    reason = f": {reasons[sizes[0]]}" if reasons.get(sizes[0]) else ""
                    words = f"{metric.words} {why} at {listed} µm, and its fitted curve does without{reason}"
                    note = Note("undefined_metric", words=words)
                    notes.append(note.of([curve.label]) if curve.label else note)
    return notes


LARGER = 1.25  # ratio of a size that is proposed beyond the range


def open_notes(result: StudyResult) -> list[Note]:
    """Return a note for each open end of an optimum's interval: which size would close it, or why none can."""
    study = result.study
    notes: list[Note] = []
    if study.target_ci_um is not None:  # said by `target_notes`
        return notes
    for curve in result.curves:
        low, high = curve.optimum.interval_um
        if (low is None) == (high is None):  # both: no size would help, but more sensors
            continue
        smallest, end = low is None, 0 if low is None else -1
        tried_um, word = curve.fitted_range_um[end], "smallest" if smallest else "largest"
        if tried_um != curve.pitch_um[end]:  # said by `silent_notes`
            continue
        hint = _closing_size(study, curve, tried_um, smallest)
        words = f"open, since the {word} size tried, {tried_um:.4g} µm, may be the best; {hint}"
        notes.append(Note("interval", case=curve.label, words=words))
    return notes


def _closing_size(study: Study, curve: Curve, tried_um: float, smallest: bool) -> str:
    """Return which size beyond the end of a range would close an interval, in words."""
    process = with_fill_factor_law(technology_of(study, curve.technology), study.options_of(curve.technology).fill_factor_law)
    least_um = 0.0 if curve.data_sheet else smallest_pitch_um(process)
    largest_um = largest_lens_um(study, curve.technology)
    size_um = max(tried_um / LARGER, math.sqrt(least_um * tried_um)) if smallest else min(tried_um * LARGER, largest_um)
    size_um = float(f"{size_um:.3g}")
    name = "pitch.values_um" if study.pitch.values_um is not None else "pitch.min_um" if smallest else "pitch.max_um"
    if not (least_um < size_um < tried_um if smallest else tried_um < size_um <= largest_um):
        return "no smaller one is possible" if smallest else "no larger one is possible under its microlenses"
    how = f"{name} with {size_um:g}" if name == "pitch.values_um" else f"{name} = {size_um:g}"
    return f"a size of {size_um:g} µm ({how}) would tell"


def study_dark_notes(result: StudyResult) -> list[Note]:
    """Return a note for each curve whose black level clips dark noise, with the number of pixel sizes and the worst of them."""
    notes: list[Note] = []
    if result.study.correction.removes_dark_level:
        return notes
    for curve in result.curves:
        pixel = result.study.options_of(curve.technology).model_dump()
        table = result.dark(curve)
        clips = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
        clipped = [place for place, clip in enumerate(clips) if clips_dark(clip)]
        if clipped:
            worst = max(clipped, key=lambda place: clips[place]["of_display_white"])
            most = max(clips[place]["least_black_level_dn"] for place in clipped)
            where = f" at {len(clipped)} of {len(clips)} pixel sizes, most at {curve.pitch_um[worst]:.2f} µm"
            notes.append(clip_note(clips[worst] | {"least_black_level_dn": most}, pixel, where).of([curve.label]))
    return notes
