"""Words that several pages share: on ΔE, weighted means, the light, the lens and the display."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pixsim.base.caller import setting
from pixsim.base.digits import counted, f_stop, interval, pixel_size, within_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.light.quantities import ILLUMINANCE, INCIDENCE, IRRADIANCE, LAMP
from pixsim.light.spectral import PART
from pixsim.optics.camera import Camera
from pixsim.report.score import exceeded_words
from pixsim.scene.film import GREEN_NM
from pixsim.show.document import Answer, Strong
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.merit import stated_end_lp_per_mm
from pixsim.studies.regret import Regrets, weighted_criterion
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import exceeded

DELTA_E = (
    "ΔE is the visible difference between a sensor's picture and that of an ideal camera: the"
    " CIELAB colour difference after the blur of the eye (S-CIELAB). A ΔE of 1 is about the"
    " smallest difference noticeable under ideal conditions."
)


def rendered_words(header: Mapping[str, Any]) -> str:
    """Return the scene that light was rendered from, and how; or the file of another program that
    it was read from.
    """
    if "scene_hash" not in header:
        return f"read from {header['source']}" if "source" in header else "given, not rendered"
    if header["spp"]:
        rays = f"{header['spp']} rays for each sample of the film"
    else:
        rays = "computed from the chart"
    return f"{header['scene']} (hash {header['scene_hash']}), {rays}, {header['variant']}"


def weighted_answer(regrets: Regrets) -> Answer:
    """Return the pixel size with the best weighted mean over conditions; that there is none where
    they share too few sizes.
    """
    weighted = weighted_criterion(regrets)
    if weighted is None:
        return Answer(
            f"{regrets.label}: the conditions have too few pixel sizes in common to find one that"
            " suits all"
        )
    best = weighted.optimum
    metric = weighted.metric
    low, high = best.value_interval
    value = f"{within_error(best.value, (high - low) / 2)} {metric.unit}".rstrip()
    first, _, words = metric.best.partition(" ")
    label = f"{regrets.label}: {first} weighted {words} {value} at "
    return Answer(
        (label, Strong(pixel_size(best.pitch_um)), f" (95 %: {interval(best.interval_um)})")
    )


# --- the light, the film and the display behind a result


LUX_MEANING = "illuminance in lx: white has lux/π cd/m², and a part of reflectance ρ has ρ lux/π"


def reflectance_words(header: Mapping[str, Any]) -> str:
    """Return the reflectance of what an illuminance falls on: of a target's part, else of white."""
    part = header.get(PART)
    return (
        f"on a part of reflectance {part['reflectance']:g}" if part else "on white (reflectance 1)"
    )


def part_words(header: Mapping[str, Any]) -> str:
    """Return the light that falls on the part of a target: how much, visible or not, of which lamp
    and from where; empty for other scenes.

    header : of the irradiance
    """
    part = header.get(PART)
    if not part:
        return ""
    names = [part[LAMP]] if LAMP in part else []
    surface = reflectance_words(header)
    if INCIDENCE in part:
        surface += f", at {part[INCIDENCE]:.3g}° to its normal"
    if ILLUMINANCE in part:
        amount = f"{part[ILLUMINANCE]:.4g} lx of visible light"
        surface += f", which has {part['reflectance'] * part[ILLUMINANCE] / math.pi:.4g} cd/m²"
    else:
        kind = "infrared" if part["centroid_nm"] > GREEN_NM else "ultraviolet"
        amount = f"{part[IRRADIANCE]:.4g} W/m² of {kind} light"
        names.append(f"{part['centroid_nm']:.4g} nm")
    lamp = f" ({', '.join(names)})" if names else ""
    return f"{amount}{lamp} {surface}"


def unconverged(header: Mapping[str, Any], film: FilmError | None) -> list[str]:
    """Return a line on the errors of a result's light that are above their limits, and what makes
    them less; none without.

    header : of the irradiance
    film : None if its error was not measured
    """
    error, limit = light_error_and_limit(header, film)
    exceeded_errors = exceeded(error, limit)
    if not exceeded_errors:
        return []
    first = f"{NOT_CONVERGED}: {'; '.join(exceeded_words(error, limit))}"
    if film is None:
        return [f"{first}. For more certainty: render it again, with more samples"]

    remedies = []
    if "film_delta_e" in exceeded_errors:
        remedies.append(f"a finer film ({setting('resolution')})")
    if "noise_delta_e" in exceeded_errors:
        remedies.append(f"a longer {setting('max_seconds')}")
    remedies.append(f"or a smaller part of the die ({setting('window_mm')}, in mm)")
    return [f"{first}. For more certainty: {', '.join(remedies)}"]


def lens_words(camera: Camera) -> str:
    """Return the real lens of a camera, the focal length to which it is scaled, and its field;
    empty for a thin lens.
    """
    if camera.lens is None:
        return ""
    lens = camera.lens
    name = Path(camera.lens.file).stem
    return (
        f"lens {name} scaled to {lens.focal_length_mm:.4g} mm, {f_stop(lens.f_number)}, a field of"
        f" {camera.field_words}"
    )


def thin_lens_words(camera: Camera) -> str:
    """Return the lens of a camera without a real one, and its field."""
    return f"lens of {camera.lens_words}, a field of {camera.field_words}"


def film_words(film: dict[str, Any]) -> str:
    """Return the film of a result, and its error; why it is not finer, where the error is too
    large.
    """
    height, width = film["shape"]
    words = f"film of {width} × {height} samples"
    if film["met"]:
        return f"{words}, its error at most {film['delta_e']:.1g} ΔE"
    # Settings are named as the caller writes them
    limit = re.sub(r"\b(resolution|max_seconds)\b", lambda name: setting(name[0]), film["limit"])
    return f"{words} ({limit})"


def view_words(
    display: Display,
    header: Mapping[str, Any],
    chosen: Mapping[str, Any],
    window_mm: float | None,
    columns: float | None = None,
) -> list[str]:
    """Return how a sensor is shown: its pixels a dot, the window, and the end of a chart whose
    frequencies are not the paper's.

    header : of the irradiance
    chosen : of `choose_view`
    columns : of its pixels
    """
    words = []
    if display.raster == "fixed_size":
        chosen_dots = " (from the sensor's pixels)" if "dots" in chosen else ""
        ratio = ""
        if columns is not None:
            ratio = f", {counted(f'{columns / display.dots:.2g}', 'pixel')} per dot"
        words.append(f"shown on {display.dots} dots{chosen_dots}{ratio}")
    if (end := stated_end_lp_per_mm(header)) is not None:
        limit = f", {chosen['limited_by']}" if "limited_by" in chosen else ""
        words.append(f"chart to {end:.3g} lp/mm{limit}")
    if window_mm:
        words.append(f"only the central {window_mm:g} mm of the die are shown and scored")
    return words
