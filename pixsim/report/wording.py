"""Parts of several pages: captions, what suits several conditions, and the light behind a result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.caller import setting
from pixsim.base.digits import f_stop, interval, told_apart
from pixsim.base.headline import NOT_CONVERGED
from pixsim.optics.camera import Camera
from pixsim.report.score import unmet
from pixsim.scene.convergence import RENDER_NOISE, what_reaches
from pixsim.show.document import Answer, Strong, joined
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.merit import stated_end_lp_per_mm
from pixsim.studies.regret import Regrets, weighted_criterion
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import converged

if TYPE_CHECKING:
    from pixsim.studies.curve import Curve

DELTA_E = (
    "ΔE is the visible difference between a sensor's picture and that of an ideal camera: the CIELAB colour difference after the "
    "blur of the eye (S-CIELAB). A ΔE of 1 is about the smallest difference noticeable under ideal conditions."
)


def rendered_words(header: Mapping[str, Any]) -> str:
    """Return the scene that light was rendered from, and how; or the file of another program that it was read from."""
    if "scene_hash" not in header:
        return f"read from {header['source']}" if "source" in header else "given, not rendered"
    rays = f"{header['spp']} rays for each sample of the film" if header["spp"] else "computed from the chart"
    return f"{header['scene']} (hash {header['scene_hash']}), {rays}, {header['variant']}"


def weighted_answer(regrets: Regrets) -> Answer:
    """Return the pixel size with the best weighted mean over conditions; that there is none where they share too few sizes."""
    weighted = weighted_criterion(regrets)
    if weighted is None:
        return Answer(f"{regrets.label}: the conditions share too few pixel sizes for one that suits all")
    best, metric = weighted.optimum, weighted.metric
    value = f"{best.value:.3f}" if metric.is_delta_e else metric.shown(best.value)
    first, _, words = metric.best.partition(" ")
    label = f"{regrets.label}: {first} weighted {words} {value} at "
    return Answer(joined([label, (Strong(f"{best.pitch_um:.2f} µm"), f" (95 %: {interval(best.interval_um)})")], ""))


FILLED = 0.9995  # larger fill factors are shown as 100 %: data sheets give the numbers of the whole pixel


def is_partly_filled(curve: Curve) -> bool:
    """Return whether the photodiode leaves out a part of a pixel."""
    return bool(curve.fill_factor.min() <= FILLED)


# --- the light, the film and the display behind a result --------------------------------------------------------------------------


def unconverged(header: Mapping[str, Any], film: FilmError | None) -> list[str]:
    """Return a line on the errors of a result's light that are above their limits, and what makes them less; none without.

    header : of the irradiance
    film : None if its error was not measured
    """
    error, limit = light_error_and_limit(header, film)
    if converged(error, limit):
        return []
    first = f"{NOT_CONVERGED}: {'; '.join(words for words in unmet(error, limit))}"
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


def lens_words(camera: Camera) -> str:
    """Return the real lens of a camera, the focal length to which it is scaled, and its field; empty for a thin lens."""
    if camera.lens is None:
        return ""
    lens, name = camera.lens, Path(camera.lens.file).stem
    return f"lens {name} scaled to {lens.focal_length_mm:.4g} mm, {f_stop(lens.f_number)}, a field of {camera.field_words}"


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
