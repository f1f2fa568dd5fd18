"""The experiment's frames reduced to what the estimators take: series of means and variances, and stacks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pixsim.datasheet_experiment import Experiment
from pixsim.frame_statistics import Pair, Series, Stack, series, stack
from pixsim.photon_transfer import saturation_index
from pixsim.progress import Stage
from pixsim.spectral import Array

GREY_FRAMES = 16  # ISO 15739 asks for 8 at least
GREY_SHARE = 0.13  # of the saturation: the reference level of ISO 15739, section 6.3


@dataclass(frozen=True)
class Measured:
    """All that was measured of one individual.

    light : over photons per pixel. dim : the same below the first of them, for S/N. dark : a pair without light.
    dark_series : over seconds. warm : dark series by temperature. dark_stack, bright_stack : at 0 and 50 % of saturation.
    grey : (frames, rows, columns) at 13 % of saturation.
    """

    light: Series
    dim: Series
    dark: Pair
    dark_series: Series
    warm: dict[float, Series]
    dark_stack: Stack = field(repr=False)
    bright_stack: Stack = field(repr=False)
    grey: Array = field(repr=False)
    grey_photons: float
    bright_photons: float


def measure(experiment: Experiment, stage: Stage | None = None) -> Measured:
    """Take every frame. `stage` is told what is being taken."""
    told = stage or (lambda name: lambda done, note="": None)

    def pairs(name: str, photons: Array) -> Series:
        tell, found = told(name), []
        for index, each in enumerate(photons.tolist()):
            found.append(experiment.pair(each, name, index))
            tell((index + 1) / photons.size)
        return series(photons, found)

    light = pairs("light series", experiment.photons)
    dim = pairs("dim light", experiment.dim_photons)
    told("stacks")
    saturation = float(light.at[saturation_index(light.variance_dn2)])
    bright, grey = saturation / 2, GREY_SHARE * saturation
    count = experiment.stack_frames
    stacks = [stack(experiment.frames(count, each, name)) for each, name in ((0.0, "dark stack"), (bright, "bright stack"))]
    told("dark series")
    return Measured(
        light=light,
        dim=dim,
        dark=experiment.pair(0.0, "dark"),
        dark_series=dark_series(experiment),
        warm={each: warm_series(experiment, each) for each in experiment.temperatures_k},
        dark_stack=stacks[0],
        bright_stack=stacks[1],
        grey=np.stack([*experiment.frames(GREY_FRAMES, grey, "grey")]).astype(float),
        grey_photons=grey,
        bright_photons=bright,
    )


def dark_series(experiment: Experiment) -> Series:
    """Dark pairs at each time, at the pixel's own temperature."""
    times = experiment.dark_times_s
    return series(times, [experiment.dark_pair(each, "dark series", index) for index, each in enumerate(times.tolist())])


def warm_series(experiment: Experiment, temperature_k: float) -> Series:
    """Dark pairs of the same individual at another temperature, over times in which its well does not fill."""
    sensor = experiment.warmed(temperature_k)
    gain = experiment.physics.dark_current_e_per_s / sensor.physics.dark_current_e_per_s
    times = experiment.dark_times_s * min(gain, 1.0)
    key = "temperature", round(1e6 * temperature_k)
    pairs = [experiment.dark_pair(each, *key, index, sensor=sensor) for index, each in enumerate(times.tolist())]
    return series(times, pairs)
