"""Results in the words of a terminal."""

from __future__ import annotations

import math
from typing import Any

from pixsim.studies.result import interval_words, within_words

SATURATED_SHOWN = 0.01
HIDDEN_DN = 0.05  # a shift of the dark's mean that is hidden: a sixth of the rounding error, 1/√12 DN
TAIL_SIGMAS = 0.01  # of the dark's spread: what a black level of 1.9 σ cuts off


def sensitivity_lines(outcome: Any) -> list[str]:
    """The base, then each assumption with the range that it gives, widest first."""
    base = outcome.base_case.reference
    lines = ["base: " + optimum_line(base)]
    for name, cases in outcome.by_variation().items():
        optima = [base.optimum, *(case.reference.optimum for case in cases)]
        sizes, best = ([getattr(each, number) for each in optima] for number in ("pitch_um", "mean_delta_e"))
        end = "" if all(each.inside for each in optima[1:]) else " (the largest or smallest size tried)"
        lines.append(f"{name}: {min(sizes):.2f} to {max(sizes):.2f} µm{end}, best mean ΔE {min(best):.3f} to {max(best):.3f}")
    return lines


def optimum_line(curve: Any) -> str:
    """The optimum of a curve with its interval, and how flat the minimum is."""
    best, interval = curve.optimum, f"(95 %: {interval_words(curve)})"
    found = f"optimal pixel size {best.pitch_um:.2f} µm {interval}"
    if not best.inside:
        found = (
            f"no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm; "
            f"the error is least at {best.pitch_um:.2f} µm, the end of the range {interval}"
        )
    within = within_words(best.within_1_percent_um, curve)
    return f"{curve.label}: {found}, mean ΔE {best.mean_delta_e:.3f}; within 1 % of it: {within}"


def target_notes(result: Any) -> list[str]:
    """Which optima miss the target interval of a study, and what ended the search."""
    study, notes = result.study, []
    evaluations = sum(int(curve.sensors.sum()) for curve in result.curves)
    for curve in result.curves:
        half_um = curve.optimum.half_width_um
        if study.target_ci_um is None or half_um <= study.target_ci_um:
            continue
        if study.max_evaluations is None:
            most = max(study.repeats, study.max_repeats)
            done = f"{int(curve.sensors.sum())} evaluations, with at most {most} at a size (max_repeats)"
        else:
            done = f"{evaluations} of at most {study.max_evaluations} evaluations in all (max_evaluations)"
        found = f"± {half_um:.2g} µm" if math.isfinite(half_um) else "open at an end"
        notes.append(f"note: {curve.label}: the interval is {found} after {done}, not ± {study.target_ci_um:g} µm (target_ci_um)")
    return notes


def score_line(result: dict[str, Any]) -> str:
    """Mean ΔE of a run (over sensors, where it was asked for to a tolerance, with its error), its pixels, and its exposure."""
    found = f"mean ΔE {result['mean_delta_e']:.3f}"
    if "error_budget" in result:
        error, sensors = result["error_budget"]["total"]["delta_e"], result["sensors"]
        within = "error not known" if error is None else f"± {error:.1g}"
        found = f"mean ΔE {result['sensors_mean_delta_e']:.4f} {within} over {sensors} sensor{'s' * (sensors > 1)}"
    rows, columns = result["pixels"]
    border_um = result["border_um"][1] if result["display"]["raster"] == "fixed_size" else 0.0
    border = f" ({border_um:.3g} µm at each side not scored)" if border_um else ""
    exposure, time_s, saturated = result["exposure"], result["integration_s"], result["saturated_fraction"]
    longest = " (the longest allowed)" if exposure["integration_s"] is None and time_s >= exposure["max_integration_s"] else ""
    full = f", {saturated:.0%} of them saturated" if saturated > SATURATED_SHOWN else ""
    pixels = f"{columns} × {rows} pixels of {result['pitch_um']:g} µm{border}"
    return f"{found} with {pixels}, exposed for {1e3 * time_s:.3g} ms{longest}{full}"


def dark_note(result: dict[str, Any]) -> list[str]:
    """What the clip at 0 DN does to the dark of a run's frame; nothing where its effect is not seen."""
    return [f"note: {clip_words(result['dark'], result['pixel'])}"] if clips_dark(result["dark"]) else []


def study_dark_notes(result: Any) -> list[str]:
    """A line for each curve whose black level cuts off dark noise: at how many pixel sizes, and the worst of them."""
    pixel, notes = result.study.pixel.model_dump(), []
    for curve in result.curves:
        table = result.dark(curve)
        clips = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
        cut = [place for place, clip in enumerate(clips) if clips_dark(clip)]
        if cut:
            worst = max(cut, key=lambda place: clips[place]["of_display_white"])
            most = max(clips[place]["least_black_level_dn"] for place in cut)
            where = f" at {len(cut)} of {len(clips)} pixel sizes, most at {curve.pitch_um[worst]:.2f} µm"
            notes.append(f"note: {curve.label}: {clip_words(clips[worst] | {'least_black_level_dn': most}, pixel, where)}")
    return notes


def clips_dark(dark: dict[str, float]) -> bool:
    """Whether a `dark_clip` shows: beyond what rounding to codes hides, and beyond the tail of the noise."""
    clipped_e, spread_e = dark["too_bright_e"], dark["spread_e"]
    return clipped_e * dark["spread_dn"] > HIDDEN_DN * spread_e and clipped_e > TAIL_SIGMAS * spread_e


def clip_words(dark: dict[str, float], pixel: dict[str, Any], where: str = "") -> str:
    from pixsim.sensor.readout import MAX_BLACK

    black, kept = pixel["black_level_dn"], dark["least_black_level_dn"]
    room = kept <= MAX_BLACK * (2 ** pixel["bits"] - 1)
    mend = f"pixel.black_level_dn = {kept} keeps it" if room else "to keep it takes more bits (pixel.bits)"
    return (
        f"a black level of {black:g} DN cuts off dark noise{where}: {100 * dark['at_zero_fraction']:.0f} % of dark pixels "
        f"stand at 0 DN and darkness reads {rounded(dark['too_bright_e'])} e- too bright "
        f"(ΔE {rounded(dark['lightness'])} on even black, less on grey); {mend}"
    )


def rounded(value: float) -> str:
    """Two digits, large numbers without an exponent."""
    return f"{float(f'{value:.2g}'):.15g}"


def budget_lines(result: dict[str, Any]) -> list[str]:
    """The error budget of a result that was asked for one."""
    budget = result.get("error_budget")
    if budget is None:
        return []

    def told(each: dict[str, float | None]) -> str:
        size = "not known" if each["delta_e"] is None else f"{each['delta_e']:.1e}"
        return f"{size} ΔE" + ("" if each["optimum_um"] is None else f", {each['optimum_um']:.1e} µm of the optimum")

    chosen = ", ".join(f"{name} {value:g}" for name, value in budget["settings"].items())
    lines = [f"  {name:21} {told(each)}" for name, each in budget["sources"].items()]
    if not budget["bounded"]:
        lines.append("  for surfaces that the plan cannot know, the spectral quadrature is what it was asked for, not a bound")
    verdict = "met" if budget["met"] else "NOT met"
    return [
        f"error budget for {budget['tolerance_delta_e']:g} ΔE ({verdict}), with {chosen}:",
        *lines,
        f"  {'all but the display':21} {told(budget['total'])}",
    ]
