"""Sentences about results, for documents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.headline import MOST_WORDS, NOT_CONVERGED
from pixsim.base.notes import told_apart
from pixsim.base.parameters import Camera, Display
from pixsim.show.document import Answer, Listed, Text, headline
from pixsim.show.sentences import interval
from pixsim.studies.conditions import Compromise
from pixsim.studies.extent import columns_on, moved_view, stated_end_lp_per_mm
from pixsim.studies.light_level import LightLevel
from pixsim.studies.merit import LENSES, detail_frequency_lp_per_mm, mtf_terms, of_sensor
from pixsim.studies.result import NO_VISIBLE_DELTA_E, Curve, StudyResult, alike_words, interval_words, viewed_words, within_words
from pixsim.studies.run import RunResult
from pixsim.studies.unconverged import study_unconverged_lines, unconverged_lines

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.sensor.pixel import PixelPhysics

SATURATED_SHOWN = 0.01
DELTA_E = (
    "ΔE is the visible difference between a sensor's picture and that of an ideal camera: the CIELAB colour difference after the "
    "blur of the eye (S-CIELAB). A ΔE of 1 is about the smallest difference noticeable under ideal conditions."
)


def optimum_parts(curve: Curve) -> list[str]:
    """Return the optimum of a curve with its interval and the sizes within 1 % of its error, if the film can tell sizes apart.

    Where a wide range of sizes shows no visible difference, that range comes first. What the optimum is on other displays follows.
    The parts are those of `with_headline`.
    """
    first, *others = _optimum_parts(curve)
    return [f"{curve.label}: {first}", *others, *filter(None, (viewed_words(curve, inside) for inside in (True, False)))]


def optimum_line(curve: Curve) -> str:
    """Return `optimum_parts` as one text."""
    return "; ".join(optimum_parts(curve))


def _optimum_parts(curve: Curve) -> list[str]:
    """Return `optimum_parts` on the chosen display."""
    if curve.alike_um:
        return [alike_words(curve), f"least mean ΔE {curve.light.shown(curve.mean().min())}"]
    best, interval = curve.optimum, f"95 %: {interval_words(curve)}"
    within = f"within 1 % of it: {within_words(best.within_1_percent_um, curve)}"
    if words := no_difference_words(curve):
        if outside := outside_words(curve):
            return [words, *outside]
        size = "" if best.inside else ", the end of the range"
        least = f"least {curve.light.number(best.mean_delta_e)} at {best.pitch_um:.2f} µm{size} ({interval})"
        unsure = "" if curve.light.converged else f", {NOT_CONVERGED}"
        return [words, f"mean ΔE is {least}{unsure}", within]
    size, mean = f"optimal pixel size {best.pitch_um:.2f} µm", f"mean ΔE {curve.light.shown(best.mean_delta_e)}"
    if best.inside:
        first = f"{size} ({interval}), {mean}"
        if len(f"{curve.label}: {first}".split()) <= MOST_WORDS:
            return [first, within]
        return [size, mean, interval, within]  # a headline rather names the cause of a mean ΔE than the interval
    ends = f"no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm"
    return [ends, f"the error is smallest at {best.pitch_um:.2f} µm, the end of the range ({interval}), {mean}", within]


def map_words(start: str, mean: float, p99: float, end: float) -> str:
    """Return the caption of a ΔE map from its mean and 99th percentile; the colour scale ends at `end`."""
    return (
        f"{start}{'the' if start else 'The'} mean ΔE is {mean:.3f}, and one dot in a hundred has more than {p99:.3g}."
        f" The colours go from 0 to {end:g}; larger errors have the last one. Compare maps of the same scale."
    )


def compromise_answer(found: Compromise) -> Answer:
    """Return the pixel sizes that suit all conditions, with their intervals; none where the conditions share too few sizes."""
    if found.best is None or found.regret is None:
        return Answer(f"{found.label}: the conditions share too few pixel sizes for one that suits all")
    best, regret = found.best, found.regret
    weighted = f"least weighted mean ΔE {best.mean_delta_e:.3f} at {best.pitch_um:.2f} µm (95 %: {interval(best.interval_um)})"
    worst = f"least worst regret {regret.delta_e:.3f} ΔE, in {regret.condition}, at {regret.pitch_um:.2f} µm"
    return headline([f"{found.label}: {weighted}", f"{worst} (95 %: {interval(regret.interval_um)})"])


def no_difference_words(curve: Curve) -> str:
    """Return the range of sizes that look alike, as text; empty if it is narrow."""
    if curve.no_difference_um is None:
        return ""
    low, high = curve.no_difference_um
    whole = ", all sizes tried" if (low, high) == (curve.pitch_um[0], curve.pitch_um[-1]) else ""
    return f"no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE) between sizes from {low:.3g} to {high:.3g} µm{whole}"


def outside_words(curve: Curve) -> list[str]:
    """Return where the fitted curve is least, in parts, if that is outside the sizes that look alike; empty otherwise.

    The best size tried is among those.
    """
    if not curve.fit_swings:
        return []
    best, mean = curve.optimum, curve.mean()
    least = f"{curve.light.shown(mean.min())} at {curve.pitch_um[mean.argmin()]:.2f} µm"
    fitted = f"the fitted curve has its minimum outside them, at {best.pitch_um:.2f} µm"
    return [f"least mean ΔE of the sizes tried {least}", f"{fitted}, which more pixel sizes there would confirm or not"]


def score_parts(result: RunResult) -> list[str]:
    """Return the mean ΔE of a run, its pixels and its exposure, and how it is shown and rendered, as parts of `with_headline`.

    With a tolerance it is the mean over sensors and its error. The last part, which may be empty, is how it is shown and rendered.
    """
    frame, settings, delta_e = result.score.frame, result.settings, f"mean ΔE {result.shown_mean}"
    rows, columns = frame.pixels
    border_um = result.score.border_um[1] if settings.display.raster == "fixed_size" else 0.0
    border = f"{border_um:.3g} µm on each side not scored" if border_um else ""
    exposure, time_s, saturated = settings.exposure, frame.integration_s, frame.saturated_fraction
    longest = " (the maximum)" if exposure.integration_s is None and time_s >= exposure.max_integration_s else ""
    full = f", {saturated:.0%} of them saturated" if saturated > SATURATED_SHOWN else ""
    pixels = f"{columns} × {rows} pixels of {result.score.physics.pitch_um:g} µm"
    exposed = f"exposed for {1e3 * time_s:.3g} ms{longest}{full}"
    first = f"{delta_e}{',' * (NOT_CONVERGED in delta_e)} with {pixels}"
    parts = [first] if len(first.split()) <= MOST_WORDS else [delta_e, pixels]
    if len(f"{first}, {exposed}".split()) <= MOST_WORDS:
        parts = [f"{first}, {exposed}"]
    else:
        parts.append(exposed)
    shown = ", ".join(filter(None, (border, *run_view_words(result))))
    film = film_words(result.film) if result.film else result.light.unmeasured
    return [*parts, "; ".join(filter(None, (shown, film, lens_words(result.camera), result.assumption)))]


def run_view_words(result: RunResult) -> list[str]:
    """Return `view_words` of a run."""
    settings, chosen = result.settings, result.prepared.view
    return view_words(settings.display, result.irradiance.header, chosen, settings.window_mm, result.score.frame.pixels[1])


def unsure_lines(result: RunResult) -> list[str]:
    """Return the lines that follow a run's mean ΔE: its causes and the errors of its light, the largest first.

    A black level that clips dark noise is among them where it makes more than another one.
    """
    mean = result.score.mean_delta_e
    lines = unconverged_lines(result.irradiance.header, result.film, result.budget, mean)
    sized = [(size, line) for (size, _), line in zip(result.light.errors(mean), lines, strict=False)]
    sized += [(cause.delta_e, str(cause)) for cause in result.causes]
    least = min((size for size, _ in sized), default=math.inf)
    sized += [(size, note) for note in result.dark_notes if (size := result.dark["lightness"]) > least]
    return [line for _, line in sorted(sized, key=lambda one: -one[0])]


def lens_words(camera: Camera) -> str:
    """Return the real lens of a camera, the focal length to which it is scaled, and its field; empty for a thin lens."""
    if camera.lens is None:
        return ""
    lens, name = camera.lens, Path(camera.lens.file).stem
    return f"lens {name} scaled to {lens.focal_length_mm:.4g} mm, f/{lens.f_number:.3g}, a field of {camera.field_words}"


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
        words = (
            lens_words(camera)
            or f"lens of {camera.focal_length_mm:.4g} mm f/{camera.f_number:.3g}, a field of {camera.field_words}"
        )
        lenses.append("; ".join(filter(None, (words, part.study.camera.assumption(camera).partition(":")[0]))))
        times_s = np.concatenate([curve.mean("integration_s") for curve in part.curves])
        whites.append(LightLevel.of(part.irradiance, part.study.display, times_s))
    light = whites[0]._replace(shortest_s=min(w.shortest_s for w in whites), longest_s=max(w.longest_s for w in whites))
    shown = str(light) if len({each.white_cd_per_m2 for each in whites}) == 1 else f"exposed for {light.exposure}"
    return ["; ".join([*(lenses[:1] if len(set(lenses)) == 1 else []), shown])]


def study_words(result: StudyResult) -> list[str]:
    """Return what follows the optima of a study: causes, errors of its light, what it depends on, how its sensors are shown."""
    return [*result.cause_notes, *study_unconverged_lines(result), *study_light_words(result), *study_view_words(result)]


def budget_blocks(budget: dict[str, Any] | None) -> tuple[Text | Listed, ...]:
    """Return an error budget, the largest source first; nothing without a tolerance."""
    if budget is None:
        return ()

    def text(effect: dict[str, float | None]) -> str:
        size = "unknown" if effect["delta_e"] is None else f"{effect['delta_e']:.1e}"
        return f"{size} ΔE" + ("" if effect["optimum_um"] is None else f", {effect['optimum_um']:.1e} µm of the optimum")

    chosen = ", ".join(f"{name} {value:g}" for name, value in budget["settings"].items())
    sizes = {name: math.inf if effect["delta_e"] is None else effect["delta_e"] for name, effect in budget["sources"].items()}
    largest_first = sorted(budget["sources"].items(), key=lambda source: -sizes[source[0]])
    items = [f"{name:21} {text(effect)}" for name, effect in largest_first]
    if not budget["bounded"]:
        items.append("spectral quadrature: the requested tolerance, not a bound, since the plan does not know all surfaces")
    items.append(f"{'total without display':21} {text(budget['total'])}")
    verdict = "met" if budget["met"] else "NOT met"
    return f"error budget for {budget['tolerance_delta_e']:g} ΔE ({verdict}), with {chosen}:", Listed(tuple(items))


def blur_words(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display) -> str:
    """Return sentences on the contrast left by each term at `detail_frequency_lp_per_mm`."""
    frequency, name = detail_frequency_lp_per_mm(irradiance, physics.pitch_um)
    terms = {term: float(mtf) for term, mtf in mtf_terms(irradiance, camera, physics, display, np.array(frequency)).items()}
    left, *others = (f"{term} {'is ' * (term in LENSES)}{terms[term]:.3f}" for term in of_sensor(terms))
    *some, last = (f"that of the {words}" for words in others)
    words = f"At {frequency:.3g} lp/mm, {name}, the MTF of the {', '.join([left, *some])} and {last}: "
    sensor = math.prod(of_sensor(terms).values())
    words += f"together they reduce the contrast by {100 * (1 - sensor):.0f} %. "
    if "dot" not in terms:
        return words + "The display shows each pixel as one dot and reduces it no further."
    of_display = terms["interpolation"] * terms["dot"]
    return words + (
        f"On the display, the MTF of the {display.interpolation} interpolation is {terms['interpolation']:.3f} and that of the "
        f"dots {terms['dot']:.3f}: they reduce the recorded contrast by another {100 * (1 - of_display):.0f} %."
    )
