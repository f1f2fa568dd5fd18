"""What a data sheet's estimators should find: from the parameters and from the individual's own maps. None of them knows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pixsim.datasheet_experiment import Experiment
from pixsim.expected_frames import expected_curve, variance_peak_e
from pixsim.photon_transfer import Linearity, linearity
from pixsim.spectral import Array


@dataclass(frozen=True)
class Truth:
    """What the estimators should find, from the parameters and from the individual's maps."""

    dark_noise_e: float
    dark_map_e: float
    gain_map: float
    saturation_e: float
    linearity: Linearity


def truth(e: Experiment, bright_photons: float, saturated: int) -> Truth:
    """Of the individual that an experiment exposes; `bright_photons` of its bright stack, `saturated`: index of its peak."""
    p = e.physics
    mean, _ = expected_curve(e.photons * e.efficiency, e.integration_s, p)
    dark, _ = expected_curve(np.zeros(1), e.integration_s, p)
    return Truth(
        dark_noise_e=math.sqrt(p.reset_noise_e**2 + p.read_noise_e**2 + p.dark_current_e_per_s * e.integration_s),
        dark_map_e=float(dark_map_e(e).std(ddof=1)),
        gain_map=gain_map(e, bright_photons),
        saturation_e=variance_peak_e(p, e.integration_s, float(e.photons[-1]) * e.efficiency),
        linearity=linearity(e.photons, mean - dark, saturated),
    )


def gain_map(experiment: Experiment, bright_photons: float) -> float:
    """√(s²_bright - s²_dark)/signal of the individual's own maps: what PRNU1288 stands for, without any noise.

    It differs from the spread of the gain map by what this map and that of the dark happen to have in common.
    """
    sensor = experiment.sensor
    if sensor.gain is None:
        return 0.0
    dark, light = dark_map_e(experiment), bright_photons * experiment.efficiency * sensor.gain
    return math.sqrt(max((light + dark).var(ddof=1) - dark.var(ddof=1), 0.0)) / float(light.mean())


def dark_map_e(experiment: Experiment) -> Array:
    """(rows, columns) what the individual's pixels show in the dark on average: offsets, columns and dark charge, e-."""
    sensor, map_e = experiment.sensor, np.zeros(experiment.sensor.shape)
    if sensor.dark_gain is not None:
        map_e = map_e + sensor.dark_gain * (experiment.physics.dark_current_e_per_s * experiment.integration_s)
    for offset_e in (sensor.offset_e, sensor.column_offset_e):
        if offset_e is not None:
            map_e = map_e + offset_e
    return map_e
