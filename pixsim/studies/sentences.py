"""Sentences about results: the optimum, how sure a mean ΔE is, and the light, the film and the display behind it.

Each fact has one wording, of which a terminal, a page, a notebook and a caption take what they have room for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.caller import setting
from pixsim.base.digits import interval, rounded, told_apart, with_ends, with_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import Note, few
from pixsim.optics.camera import Camera
from pixsim.scene.convergence import RENDER_NOISE, what_reaches
from pixsim.sensor.stages import stage_words
from pixsim.show.document import Block, DocumentTable, Fact, Strong, Text, has_room, headline, joined, plain_text
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.merit import columns_on, moved_view, stated_end_lp_per_mm
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.regret import Regrets, metric_regrets
from pixsim.viewer.display_options import Display
from pixsim.viewer.raw_metrics import INFORMATION
from pixsim.viewer.score import converged, mean_words, shown_mean, unmet
from pixsim.viewer.screen import rounded_up

if TYPE_CHECKING:
    from pixsim.studies.curve import Curve
    from pixsim.studies.result import StudyResult

FILLED = 0.9995  # larger fill factors are shown as 100 %: data sheets give the numbers of the whole pixel
MAX_REGRET_TABLES = 8  # before an answer has too many lines; summary.json has all
LEAST_RISE = 0.1  # per cent, of a curve to an end of its range: a fit says no more

# --- the optimum of a curve ------------------------------------------------------------------------------------------------------


def optimum_parts(curve: Curve) -> list[Text]:
    """Return the optimum of a curve with its interval and the sizes within 1 % of its error.

    Where a wide range of sizes shows no visible difference, that range comes first. What the optimum is on other displays follows.
    The parts are those of a `headline`.
    """
    first, *others = _optimum_parts(curve)
    parts: list[Text] = [joined([f"{curve.label}: ", first], ""), curve.developed, *others, displays_words(curve)]
    return [part for part in parts if part]


def optimum_line(curve: Curve) -> str:
    """Return `optimum_parts` as one text."""
    return plain_text(joined(optimum_parts(curve)))


def optimum_words(curves: Sequence[Curve]) -> str:
    """Return the headline of a curve as text, or the first part of that of each of several."""
    if len(curves) == 1:
        return plain_text(headline(optimum_parts(curves[0])).head)
    return plain_text(joined(optimum_parts(curve)[0] for curve in curves))


def _optimum_parts(curve: Curve) -> list[Text]:
    """Return `optimum_parts` on the chosen display, without the label."""
    if not curve.judged_by_delta_e:
        metric, best = curve.metrics[0], curve.optimum
        value = f"{metric.title} {metric.shown(best.value)}"
        if best.inside:
            stated = f"95 %: {interval_words(curve)}; {100 * best.between_sizes_share:.0f} % between sizes"
            return [("optimal pixel size ", Strong(f"{best.pitch_um:.2f} µm"), f" ({stated}), {value}")]
        ends = f"no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm"
        return [ends, f"the best is {best.pitch_um:.2f} µm, the end of the range (95 %: {interval_words(curve)}), {value}"]
    best, interval = curve.optimum, f"95 %: {interval_words(curve)}"
    within = f"within 1 % of it: {within_words(best.within_1_percent_um, curve)}"
    if words := no_difference_words(curve):
        if outside := fit_outside_words(curve):
            return [(Strong(words),), *outside]
        size = "" if best.inside else ", the end of the range"
        mean = mean_words(best.mean_delta_e, curve.light, curve.light_limit, curve.causes)
        least = f"least {mean} at {best.pitch_um:.2f} µm{size} ({interval})"
        unsure = "" if converged(curve.light, curve.light_limit) else f", {NOT_CONVERGED}"
        return [(Strong(words),), f"mean ΔE is {least}{unsure}", within]
    size_um, mean = f"{best.pitch_um:.2f} µm", f"mean ΔE {shown_mean_of(curve, best.mean_delta_e)}"
    if best.inside:
        first = "optimal pixel size ", Strong(size_um)
        whole = (*first, f" ({interval}), {mean}")
        if has_room([joined([f"{curve.label}: ", whole], "")]):
            return [whole, within]
        return [first, mean, interval, within]  # a headline rather names the cause of a mean ΔE than the interval
    ends = f"no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm"
    return [ends, f"the error is smallest at {size_um}, the end of the range ({interval}), {mean}", within]


def optima_table(curves: Sequence[Curve]) -> DocumentTable:
    """Return the optimum of each curve, as a page and a notebook list them."""
    rows, partly = [], any(map(is_partly_filled, curves))
    by_delta_e = all(curve.judged_by_delta_e for curve in curves)
    for curve in curves:
        best = curve.optimum
        size = f"{best.pitch_um:.2f}" if best.inside else f"none; least at {best.pitch_um:.2f}, the end of the sizes"
        sure = converged(curve.light, curve.light_limit) and not curve.causes
        within = (within_words(ends, curve) for ends in (best.within_1_percent_um, best.within_2_percent_um))
        rows.append(
            (
                curve.label,
                size,
                interval_words(curve),
                f"{100 * best.between_sizes_share:.0f}",
                _least_words(curve, ".3f" if by_delta_e else ".4g", sure or not by_delta_e),
                *within,
                *([f"{100 * curve.optimum_fill_factor:.0f}"] * partly),
            )
        )
    value = "mean ΔE" if by_delta_e else curves[0].metrics[0].label
    head = ("pixel", "optimum (µm)", "95 % interval", "between sizes (%)", f"{value} (95 %)", "within 1 % of it", "within 2 %")
    return DocumentTable("optima", (*head, *["fill factor (%)"] * partly), rows, words=None)


def _least_words(curve: Curve, form: str, is_sure: bool) -> str:
    """Return the best value of a curve, with its interval if the light is sure enough for one."""
    best = curve.optimum
    return with_ends(best.value, best.value_interval, form) if is_sure else shown_mean_of(curve, best.mean_delta_e)


def shown_mean_of(curve: Curve, mean_delta_e: float) -> str:
    """Return a mean ΔE of a curve as text, with the errors of its light and its largest cause."""
    return shown_mean(mean_delta_e, curve.light, curve.light_limit, curve.causes)


def is_partly_filled(curve: Curve) -> bool:
    """Return whether the photodiode leaves out a part of a pixel."""
    return bool(curve.fill_factor.min() <= FILLED)


def no_difference_words(curve: Curve) -> str:
    """Return the range of sizes that look alike, as text; empty if it is narrow."""
    if curve.no_difference_um is None:
        return ""
    low, high = curve.no_difference_um
    whole = ", all sizes tried" if (low, high) == (curve.pitch_um[0], curve.pitch_um[-1]) else ""
    return f"no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE) between sizes from {low:.3g} to {high:.3g} µm{whole}"


def fit_outside_words(curve: Curve) -> list[str]:
    """Return where the fitted curve is least, in parts, if that is outside the sizes that look alike; empty otherwise.

    The best size tried is among those.
    """
    if not curve.fit_swings:
        return []
    best, mean = curve.optimum, curve.mean()
    least = f"{shown_mean_of(curve, float(mean.min()))} at {curve.pitch_um[mean.argmin()]:.2f} µm"
    fitted = f"the fitted curve has its minimum outside them, at {best.pitch_um:.2f} µm"
    return [f"least mean ΔE of the sizes tried {least}", f"{fitted}, which more pixel sizes there would confirm or not"]


def interval_words(curve: Curve) -> str:
    """Return the 95 % interval of a curve's optimum as text, naming an open end; none where the fit swings."""
    if curve.fit_swings:
        return "unknown beside the steep flank"
    low, high = curve.optimum.interval_um
    first, last = curve.fitted_range_um
    if (low is None) == (high is None):
        return interval((low, high))
    if low is None and high is not None:
        if high <= first:
            return "at or below the smallest size tried"
        size = "smallest possible size" if curve.from_smallest else "smallest size tried"
        return f"{interval((low, high))}, {flat_words(curve, 0, size) or 'no lower limit among the sizes tried'}"
    if low is not None and low >= last:
        return "at or above the largest size tried"
    return f"{interval((low, high))}, {flat_words(curve, -1, 'largest size tried') or 'no upper limit among the sizes tried'}"


def flat_words(curve: Curve, end: int, size: str) -> str:
    """Return how little the fitted curve rises from a minimum inside the range to one of its ends; empty if it is at an end.

    end : 0 or -1
    size : that of this end, in words
    """
    best = curve.optimum
    if not best.inside or not best.mean_delta_e > 0:
        return ""
    percent = 100 * (float(curve.fit.delta_e[end]) / best.mean_delta_e - 1)
    return f"flat to the {size}: within {rounded_up(max(percent, LEAST_RISE), 2):g} %"


def within_words(ends: tuple[float | None, float | None], curve: Curve) -> str:
    """Return a range of pitches as text, naming an end at the smallest or the largest pitch tried."""
    (low, high), (smallest, largest) = ends, curve.fitted_range_um
    first = f"≤ {smallest:.2f} µm (smallest tried)" if low is None else f"{low:.2f}"
    last = f"≥ {largest:.2f} µm (largest tried)" if high is None else f"{high:.2f} µm"
    return f"{first} to {last}"


def displays_words(curve: Curve) -> str:
    """Return the optima on other displays as text; empty without any."""
    words = [
        f"{each.optimum.pitch_um:.2g} µm on {each.dots} dots{'' if each.optimum.inside else ' (an end of the range of sizes)'}"
        for each in curve.on_displays
    ]
    low, high = (end if end is not None else limit for end, limit in zip(curve.optimum.interval_um, (0.0, math.inf), strict=True))
    depends = any(not low <= each.optimum.pitch_um <= high for each in curve.on_displays)
    found = "the best size depends on the display: it is" if depends else "the best size is"
    return f"{found} {', '.join(words)}" if words else ""


# --- how sure a mean ΔE is -------------------------------------------------------------------------------------------------------


def unconverged(header: Mapping[str, Any], film: FilmError | None) -> list[str]:
    """Return a line on the errors of a result's light that are above their limits, and what makes them less; none without.

    header : of the irradiance
    film : None if its error was not measured
    """
    error, limit = light_error_and_limit(header, film)
    if converged(error, limit):
        return []
    first = f"{NOT_CONVERGED}: {'; '.join(words for _, words in unmet(error, limit))}"
    if film is None:
        return [f"{first}. To be surer: a render of its own, with more samples"]

    means, noise = [], header.get("render_noise", {})
    if not film.met and "--resolution" in film.limit:
        means.append(f"leaving out {setting('resolution')}")
    if not converged(replace(error, film_delta_e=None), limit):
        delta_e, most_delta_e = error.noise_delta_e or math.nan, limit.noise_delta_e or math.nan
        is_known = math.isfinite(delta_e)
        times, seconds = what_reaches(delta_e, most_delta_e) if is_known else what_reaches(noise["fraction"], noise["target"])
        by_clock = noise.get("ended_by") == "max_seconds"
        longer = f"a longer {setting('max_seconds')}"
        option = longer if by_clock else setting("max_seconds", f"{seconds:.15g}")
        means.append(f"{option} (about {times:.15g} times as many samples)")
    elif noise.get("fraction", 0.0) > RENDER_NOISE:
        # Coarser films show it too, so that it counts as their error.
        means.append(f"a lower {setting('render_noise')}")
    elif not film.met and "--max-seconds" in film.limit:
        means.append(f"a longer {setting('max_seconds')}")
    surer = [" and ".join(means)] * bool(means)
    window = f"a smaller part of the die ({setting('window_mm')}, in mm)"
    return [f"{first}. To be surer: {', or '.join([*surer, window])}"]


def study_unconverged(result: StudyResult) -> list[Note]:
    """Return the lines of `unconverged` of a study, each once, for the films at the best pixel sizes."""
    notes = []
    for curve in result.curves:
        part = result.part_of(curve)
        if curve.has_delta_e:
            lines = unconverged(part.irradiance.header, part.film_at_best(curve))
            notes.append([Note("not_converged", words=line) for line in lines])
    return few(notes)


# --- what it belongs to ----------------------------------------------------------------------------------------------------------


def lens_words(camera: Camera) -> str:
    """Return the real lens of a camera, the focal length to which it is scaled, and its field; empty for a thin lens."""
    if camera.lens is None:
        return ""
    lens, name = camera.lens, Path(camera.lens.file).stem
    return f"lens {name} scaled to {lens.focal_length_mm:.4g} mm, f/{lens.f_number:.3g}, a field of {camera.field_words}"


def thin_lens_words(camera: Camera) -> str:
    """Return the lens of a camera without a real one, and its field."""
    return f"lens of {camera.lens_words}, a field of {camera.field_words}"


def film_words(film: dict[str, Any]) -> str:
    """Return the film of a result, the largest error of mean ΔE that it may cause, and why it is not finer if that is too large."""
    height, width = film["shape"]
    words = f"film of {width} × {height} samples, its error"
    if film["met"]:
        return f"{words} at most {film['delta_e']:.1g} ΔE"
    tolerated = min(film["tolerated_delta_e"])
    if film["delta_e"] is None:
        return f"{words} unknown, {tolerated:.2g} tolerated: {film['limit']}"
    error, most = told_apart(film["delta_e"], tolerated, 1)
    return f"{words} at most {error} ΔE, more than the {most} tolerated: {film['limit']}"


def view_words(
    display: Display, header: Mapping[str, Any], chosen: Mapping[str, Any], window_mm: float | None, columns: float | None = None
) -> list[str]:
    """Return how a sensor is shown: its pixels a dot, the window, and the end of a chart whose frequencies are not the paper's.

    header : of the irradiance
    chosen : of `choose_view`
    columns : of its pixels
    """
    words = []
    if display.raster == "fixed_size":
        dots = f"shown on {display.dots} dots" + (" (from the sensor's pixels)" if "dots" in chosen else "")
        a_dot = "" if columns is None else f"{columns / display.dots:.2g}"
        words.append(f"{dots}, {a_dot} pixel{'s' * (a_dot != '1')} a dot" if a_dot else dots)
    if (end := stated_end_lp_per_mm(header)) is not None:
        limit = f", {chosen['limited_by']}" if "limited_by" in chosen else ""
        words.append(f"chart to {end:.3g} lp/mm{limit}")
    if window_mm:
        words.append(f"only the central {window_mm:g} mm of the die are shown and scored")
    return words


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
    optimum, fits = curve.optima.get(INFORMATION.name), [curve.variant_fits.get(name) for name in INFORMATION.variants]
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
    words: list[Sequence[str]] = [pairs, without, contrasts, result.cause_notes, study_unconverged(result), light, view]
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


def regrets_tables(regrets: Regrets) -> tuple[DocumentTable, DocumentTable]:
    """Return the best sizes of the numbered criteria, and their regrets at the best size of each number."""
    head = (f"{regrets.kind}\n", "best size\n(µm)", "95 %\ninterval", "between\nsizes (%)", "value\n")
    matrix_head = ("regret in % at the best size of", *(str(number) for number, _ in enumerate(regrets.criteria, 1)))

    rows, matrix_rows = [], []
    for place, (criterion, of_criterion) in enumerate(zip(regrets.criteria, regrets.matrix.tolist(), strict=True)):
        name = f"{place + 1} {criterion.name}"
        best = criterion.optimum
        between = f"{100 * best.between_sizes_share:.0f}"
        rows.append((name, criterion.best_size(), interval(best.interval_um), between, criterion.metric.shown(best.value)))
        matrix_rows.append((name, *("–" if column == place else percent(regret) for column, regret in enumerate(of_criterion))))

    sizes = DocumentTable(f"best sizes of {regrets.label}", head, rows, f"{regrets.label}: best sizes", words=(0, 1, 2))
    return sizes, DocumentTable(f"regrets of {regrets.label}", matrix_head, matrix_rows, f"{regrets.label}: regrets")


def percent(regret: float) -> str:
    """Return a regret in per cent, to two digits.

    >>> percent(0.0123), percent(float("inf"))
    ('1.2', '∞')
    """
    return rounded(100 * regret) if np.isfinite(regret) else "∞"
