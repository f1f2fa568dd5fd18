"""The errors of a result's light that are above their limits, in words, and what makes them less."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pixsim.base.caller import setting
from pixsim.base.headline import NOT_CONVERGED
from pixsim.scene.convergence import RENDER_NOISE, what_reaches
from pixsim.studies.result import few
from pixsim.viewer.light_error import LightError

if TYPE_CHECKING:
    from pixsim.studies.result import StudyResult


def unconverged_lines(
    header: Mapping[str, Any], film: Mapping[str, Any] | None, budget: Mapping[str, Any] | None = None, mean_delta_e: float = 0.0
) -> list[str]:
    """Return a line on the errors of a result's light that are above their limits, and what makes them less; none without.

    header : of the irradiance
    film, budget : entries `film` and `error_budget` of score.json; a budget that is met holds all errors
    mean_delta_e : whose largest error is named first
    """
    light = LightError.of(header, film)
    if light.converged or (budget and budget["met"]):
        return []
    found = f"{NOT_CONVERGED}: {'; '.join(reason for _, reason in light.errors(mean_delta_e))}"
    if film is None:
        return [f"{found}. To be surer: a render of its own, with more samples"]
    means, limit = [], film.get("limit", "")
    if not light.film_is_met and "--resolution" in limit:
        means.append(f"leaving out {setting('resolution')}")
    if light.noise is not None and not light.noise_is_met:
        times, seconds = what_reaches(light.noise, light.noise_target)
        by_clock = header["render_noise"].get("ended_by") == "max_seconds"
        longer = f"a longer {setting('max_seconds')}"
        option = longer if by_clock else setting("max_seconds", f"{seconds:.15g}")
        means.append(f"{option} (about {times:.15g} times as many samples)")
    elif light.noise is not None and light.noise > RENDER_NOISE:  # which coarser films show too, so that it counts as their error
        means.append(f"a lower {setting('render_noise')}")
    elif not light.film_is_met and "--max-seconds" in limit:
        means.append(f"a longer {setting('max_seconds')}")
    surer = [" and ".join(means)] * bool(means)
    window = f"a smaller part of the die ({setting('window_mm')}, in mm)"
    return [f"{found}. To be surer: {', or '.join([*surer, window])}"]


def study_unconverged_lines(result: StudyResult) -> list[str]:
    """Return the lines of `unconverged_lines` of a study, each once, for the films at the best pixel sizes."""
    lines = []
    for curve in result.curves:
        part = result.part_of(curve)
        least = float(curve.mean().min())
        lines.append(unconverged_lines(part.irradiance.header, part.film_at_best(curve), part.budget, least))
    return few(lines)
