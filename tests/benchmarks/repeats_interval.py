"""How often the interval of `pixsim run --repeats` holds the mean over all registrations, and how
long it is.

    OMP_NUM_THREADS=1 python tests/benchmarks/repeats_interval.py [--trials 200]

Each trial adds a random shift to the sequence of registrations, and has its own sensors. Its
interval is that of a run: `spread_interval` of 4 or of 8 repeats, and of four sensors at the
registration of the first one. The truth is the mean of 64 registrations. A line has the share of
the intervals that hold it, and the median half length over the 95 % quantile of the errors of the
stated mean: at least 93 %, and at most 4. An interval of just 95 % is 1 long; Student's t of the
repeats alone, as of independent ones, is in the last column.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace

import numpy as np

import pixsim
from pixsim.base.arrays import Array
from pixsim.sensor.pixel import spread_registration
from pixsim.studies.paired import NOISE_SENSORS, mean_interval, spread_interval
from pixsim.studies.run import RunResult
from pixsim.viewer.chain import make_chain

SIZES_UM, REPEATS, TRUTH = (2.2, 3.0, 6.0), (4, 8), 64


class Trials:
    """Sensors of a run at any registration."""

    def __init__(self, result: RunResult) -> None:
        assert result.chain.scene is not None
        self.scene, self.imaging = result.chain.scene, result.chain.imaging

    def delta_e(self, registrations: list[tuple[float, float]], *key: object) -> Array:
        """Mean ΔE of sensors at these registrations, (sensors,)."""
        values = []
        for number, registration in enumerate(registrations):
            pixel = self.imaging.pixel.model_copy(update={"registration": registration})
            chain = make_chain(replace(self.imaging, pixel=pixel), self.scene)
            values.append(chain.simulate(*key, number).mean_delta_e)
        return np.array(values)


def shifted(count: int, shift: Array) -> list[tuple[float, float]]:
    """The first registrations of the sequence, shifted by a fraction of a pixel in x and y."""
    points = (np.array([spread_registration(number) for number in range(count)]) + shift) % 1.0
    return [(float(x), float(y)) for x, y in points]


def small_run(pitch_um: float) -> RunResult:
    """A chart on a small die, where the registration of pixels of 6 µm changes mean ΔE by several
    per cent.
    """
    table = {"technology": "4t-bsi", "pitch_um": pitch_um}
    return pixsim.run("csf", pixel=table, camera={"die_mm": 0.6}, display={"dots": 128})


def intervals(result: RunResult, trials: int) -> tuple[float, dict[int, list[tuple[Array, Array]]]]:
    """Return the mean over registrations, and of each number of repeats the values of each trial:
    repeats, and at the first.
    """
    sensors, rng = Trials(result), np.random.default_rng(1)
    truth = float(sensors.delta_e(shifted(TRUTH, np.zeros(2)), "truth").mean())
    values: dict[int, list[tuple[Array, Array]]] = {count: [] for count in REPEATS}
    for trial in range(trials):
        shift = rng.random(2)
        repeats = sensors.delta_e(shifted(max(REPEATS), shift), "trial", trial)
        others = sensors.delta_e(shifted(1, shift) * (NOISE_SENSORS - 1), "at the first", trial)
        at_first = np.array([repeats[0], *others])
        for count in REPEATS:
            values[count].append((repeats[:count], at_first))
    return truth, values


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=200)
    trials = parser.parse_args().trials
    warnings.simplefilter("ignore")
    print("size (µm)  repeats  held    half length  Student's t")
    for pitch_um in SIZES_UM:
        truth, values = intervals(small_run(pitch_um), trials)
        for count, of_trials in values.items():
            errors = np.array([abs(repeats.mean() - truth) for repeats, _ in of_trials])
            lows, means, highs = np.array([spread_interval(*pair) for pair in of_trials]).T
            students = np.array([mean_interval(repeats) for repeats, _ in of_trials])
            held = np.mean((lows <= truth) & (truth <= highs))
            error = np.quantile(errors, 0.95)
            half, student = (
                np.median(highs - means) / error,
                np.median(students[:, 2] - students[:, 1]) / error,
            )
            print(
                f"{pitch_um:9g}  {count:7}  {held:5.1%}  {half:11.2f}  {student:11.2f}", flush=True
            )


if __name__ == "__main__":
    main()
