"""The cheapest settings whose errors, as a calibration tells them, keep to a tolerance of mean ΔE."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pixsim.accuracy.budget import NORMAL_95, STUDENT_95, Calibration, effects, total

MOST_WIDTH = 8192
MOST_SENSORS = 1024  # a minute of them
MOST_VALUES = 1 << 27  # of a film in all bands or pulses: 0.5 GB in the image, four times that while it is rendered
# Work in film samples, as `pixsim accuracy csf` measures it (45 ns each): per film cell, of the lens and the ideal image;
# per dot, of one sensor's frame and its ΔE.
CELL_WORK, DOT_WORK = 6.0, 8.0
COARSEST_NOISE, FINEST_NOISE = 1.0, 1e-3  # of the sensor's
LOOSEST_TOLERANCE_E, TIGHTEST_TOLERANCE_E = 2e-2, 1e-5
SENSOR_SHARES, NOISE_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8), (0.25, 0.5, 0.75)  # of the tolerance; of the rest


@dataclass(frozen=True)
class Choice:
    """Settings, and the error that they are expected to leave."""

    width: int
    render_noise: float
    tolerance_e: float
    sensors: int
    expected_delta_e: float
    met: bool


def choose(found: Calibration, tolerance_delta_e: float, *, film_is_free: bool) -> Choice:
    """The settings of least work whose errors add up to no more than the tolerance; work is counted, not timed, so that the
    choice comes out the same every time. Where none does, the finest film, and other sources that keep to the tolerance: a
    render of any length would not mend what the film leaves."""
    widths = [each for each in widths_of(found) if film_is_free or each == found.width]
    options = [each for width in widths for each in options_of(found, width, tolerance_delta_e - found.film(width).delta_e)]
    met = [each for each in options if each.choice.expected_delta_e <= tolerance_delta_e]
    if met:
        return replace(min(met, key=lambda each: each.work).choice, met=True)
    rest = options_of(found, widths[-1], tolerance_delta_e)
    return min(rest, key=lambda each: (max(each.others_delta_e, tolerance_delta_e), each.work)).choice


def widths_of(found: Calibration) -> list[int]:
    """Films by powers of two, from the coarsest that was looked at to what fits into memory."""
    widths = [int(found.width * 2.0**k) for k in range(1 - len(found.films), 4)]
    most = min(MOST_WIDTH, math.sqrt(MOST_VALUES / (found.planes * found.cells)) * found.width)
    return [each for each in widths if each <= max(most, found.width)]


@dataclass(frozen=True)
class Option:
    """Settings with their work in samples, and the error of all that is not the film."""

    work: float
    others_delta_e: float
    choice: Choice


def options_of(found: Calibration, width: int, left_delta_e: float) -> list[Option]:
    """Ways to share what a film leaves of the tolerance among sensors, render noise and spectral quadrature."""
    if not left_delta_e > 0:
        return []
    shares = [(sensors, (1 - sensors) * noise) for sensors in SENSOR_SHARES for noise in NOISE_SHARES]
    return [
        option(found, width, *(left_delta_e * each for each in (noise, 1 - sensors - noise, sensors))) for sensors, noise in shares
    ]


def option(found: Calibration, width: int, noise_de: float, spectral_de: float, seeds_de: float) -> Option:
    """The settings that leave so much of ΔE to each source, as far as they reach."""
    random, bias = NORMAL_95 * found.random.delta_e, found.bias.delta_e
    root = math.sqrt(random**2 + 4 * bias * noise_de)
    part = 2 * noise_de / (random + root) if random + root else math.inf
    noise = rounded_down(min(max(found.noise * part, FINEST_NOISE), COARSEST_NOISE)) if found.noise else COARSEST_NOISE
    wanted = spectral_de / found.per_e.delta_e if found.per_e.delta_e else math.inf
    tolerance_e = rounded_down(min(max(wanted, TIGHTEST_TOLERANCE_E), LOOSEST_TOLERANCE_E))
    sensors = min(max(1, math.ceil((STUDENT_95 * found.sensor.delta_e / seeds_de) ** 2)), MOST_SENSORS)
    budget = effects(found, width, noise, tolerance_e, sensors)
    others = total({name: each for name, each in budget.items() if name != "oversampling"}).delta_e
    choice = Choice(width, noise, tolerance_e, sensors, total(budget).delta_e, False)
    larger = (width / found.width) ** 2
    render = found.work * max(larger, (found.noise / noise) ** 2)
    return Option(render + CELL_WORK * found.cells * larger + DOT_WORK * sensors * found.dots**2, others, choice)


def rounded_down(value: float) -> float:
    """To three digits, never above the value."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return min(float(f"{math.floor(value / unit) * unit:.3g}"), value)
