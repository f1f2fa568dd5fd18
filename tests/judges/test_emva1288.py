"""The package `emva1288` 1.0.2 measures pixsim's sensor from its frames, and judges pixsim's own estimators on them.

Source: the reference implementation of EMVA 1288, https://github.com/EMVA1288/emva1288 (GPL; in the tests only). It is given the
frames of `pixsim.measure.experiment` and finds K, QE, σ_d, DSNU1288, PRNU1288 and the saturation by itself.

Gates, two-sided, with the statistical error of one sensor of 480 × 480 pixels:

- K and QE within 0.5 % of the parameters: a pair tells a variance to √(2/230 400) = 0.3 %, and some 30 are fitted: 0.09 %.
  QE is QE(λ)·FF, monochromatic, of the whole pixel.
- σ_d within 0.5 %, with bits that make it 1 DN and more: one dark pair (0.15 %) and K: 0.18 %.
- DSNU and PRNU within 0.5 % of the realised maps: offset, column and dark charge of this individual, √(offset² + column² +
  (σ_DSNU·dark)²), and its gains. Enough frames in the stacks that temporal noise leaves 0.12 %, and K: 0.15 %.
- the saturation within one exposure step of the peak of the model's own variance (`pixsim.measure.datasheet`).
- pixsim's estimators within 1e-4 of the package's on the same frames: the formulas are the same, whatever the noise.

What would not be met is tried too: another gain, another pattern in each frame, a dark that is clipped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from judges.gates import not_met, verdict

from pixsim.base.arrays import stream
from pixsim.base.parameters import Pixel
from pixsim.measure.datasheet import dark_map_e, measure, variance_peak_e
from pixsim.measure.estimators import Frames, saturation_index
from pixsim.measure.experiment import Experiment, make_experiment
from pixsim.sensor.readout import sample_sensor

process = pytest.importorskip("emva1288.process")
from emva1288.process import routines  # noqa: E402

STANDARD = "EMVA 1288 R4.0 (emva1288 1.0.2)"
GATE = 0.005
SIDE, EXPOSURES = 480, 40
# (technology, pitch in µm, bits with σ_d of 1 DN and more, frames of a stack: more where temporal noise exceeds the pattern)
CASES = (("0.35um", 5.3, 12, 16), ("0.35um", 6.5, 12, 16), ("0.35um", 15.0, 14, 16), ("4t-bsi", 1.2, 12, 64))
MORE_CASES = (
    ("0.5um", 9.0, 12, 16),
    ("0.25um", 5.0, 12, 16),
    ("0.18um", 3.0, 12, 16),
    ("4t-fsi", 2.2, 12, 100),
    ("4t-bsi", 0.7, 12, 400),
)
Case = tuple[str, float, int, int]


class Images:
    """Frames that are taken when they are looked at, as the package looks at them: their number and a loop."""

    def __init__(self, experiment: Experiment, count: int, photons: float, *key: object) -> None:
        self.taken = experiment, count, photons, key

    def __len__(self) -> int:
        return self.taken[1]

    def __iter__(self) -> Iterator[Frames]:
        experiment, count, photons, key = self.taken
        return experiment.frames(count, photons, *key)


def experiment_of(case: Case, side: int = SIDE, seed: int = 0) -> Experiment:
    technology, pitch_um, bits, frames = case
    pixel = Pixel(technology=technology, pitch_um=pitch_um, bits=bits)
    return make_experiment(pixel, seed=seed, shape=(side, side), exposures=EXPOSURES, stack_frames=frames)


def package_results(experiment: Experiment) -> dict[str, float]:
    """What the package finds: the frames reduced by its `get_int_imgs`, as its loader does with files."""
    e, rows_columns = experiment, experiment.sensor.shape

    def temporal(photons: float, *key: object) -> dict[str, Any]:
        found = routines.get_int_imgs(Images(e, 2, photons, *key))
        return {"sum": found["sum"].sum(), "pvar": found["pvar"].sum(), "dmean": found["dmean"]}

    pairs = {photons: temporal(photons, "light series", index) for index, photons in enumerate(e.photons.tolist())}
    saturation = e.photons[saturation_index(np.array([each["pvar"] for each in pairs.values()], float))]
    lights = {0.0: "dark stack", float(saturation) / 2: "bright stack"}
    stacks = {photons: routines.get_int_imgs(Images(e, e.stack_frames, photons, name)) for photons, name in lights.items()}
    data = {
        "height": rows_columns[0],
        "width": rows_columns[1],
        "temporal": {e.integration_s: {0.0: temporal(0.0, "dark"), **pairs}},
        "spatial": {e.integration_s: stacks},
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np, "asfarray", lambda a: np.asarray(a, float), raising=False)  # gone from NumPy 2
        results = process.Results1288(process.Data1288(data, loglevel=40).data, loglevel=40)
        names = "K", "R", "QE", "sigma_d", "sigma_y_dark", "DSNU1288", "PRNU1288", "u_p_sat", "u_p_min"
        return {name: float(getattr(results, name)) for name in names}


def truths(experiment: Experiment) -> dict[str, float]:
    """What it should find."""
    e, p = experiment, experiment.physics
    dark_e = p.dark_current_e_per_s * e.integration_s
    assert e.sensor.gain is not None
    return {
        "K": p.dn_per_e,
        "QE": 100 * e.efficiency,
        "sigma_d": math.sqrt(p.reset_noise_e**2 + p.read_noise_e**2 + dark_e),
        "DSNU1288": float(dark_map_e(e).std()),
        "PRNU1288": 100 * float(e.sensor.gain.std() / e.sensor.gain.mean()),
    }


@lru_cache(maxsize=16)
def judged(case: Case) -> tuple[Experiment, dict[str, float]]:
    experiment = experiment_of(case)
    return experiment, package_results(experiment)


def rows(cases: tuple[Case, ...] = CASES) -> list[dict[str, object]]:
    """A row for each pixel and quantity, for tables."""
    table = []
    for case in cases:
        e, found = judged(case)
        name = f"{case[0]}, {case[1]:g} µm, {case[2]} bits"
        for quantity, true in truths(e).items():
            off = found[quantity] / true - 1
            told, met = f"{100 * off:+.2f} %", abs(off) <= GATE
            table.append(verdict(STANDARD, f"{quantity}: {name}", "within 0.5 % of the parameters", told, met))
        step = float(e.photons[1] - e.photons[0])
        peak = variance_peak_e(e.physics, e.integration_s, float(e.photons[-1]) * e.efficiency) / e.efficiency
        off = (found["u_p_sat"] - peak) / step
        table.append(verdict(STANDARD, f"saturation: {name}", "within one exposure step", f"{off:+.2f} steps", abs(off) <= 1))
    return table


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def test_the_package_finds_the_parameters(case: Case) -> None:
    experiment, found = judged(case)
    assert found["sigma_y_dark"] > 1, "too few bits for the gate on σ_d"
    assert experiment.physics.pixel.black_level_dn > 6 * found["sigma_y_dark"]
    assert not not_met(rows((case,)))


@pytest.mark.judges_full
@pytest.mark.parametrize("case", MORE_CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def test_the_package_finds_the_parameters_of_other_pixels(case: Case) -> None:
    assert not not_met(rows((case,)))


@pytest.mark.judges_full
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def test_no_seed_was_chosen(case: Case) -> None:
    """Over six individuals the mean is off by less than the gate, and each by less than three times its error."""
    offs = []
    for seed in range(1, 7):
        experiment = experiment_of(case, seed=seed)
        found = package_results(experiment)
        offs.append([found[name] / true - 1 for name, true in truths(experiment).items()])
    assert np.all(np.abs(np.mean(offs, axis=0)) < GATE / 2)
    assert np.all(np.abs(offs) < 1.5 * GATE)


def test_pixsims_estimators_are_the_packages() -> None:
    experiment = experiment_of(CASES[0], side=120)
    found, sheet = package_results(experiment), measure(experiment)
    own = {
        "K": sheet.transfer.gain_dn_per_e,
        "R": sheet.transfer.responsivity_dn_per_p,
        "QE": sheet.transfer.efficiency * 100,
        "sigma_d": sheet.transfer.dark_noise_e,
        "DSNU1288": sheet.dsnu_e,
        "PRNU1288": sheet.prnu * 100,
        "u_p_sat": sheet.transfer.saturation_p,
        "u_p_min": sheet.transfer.threshold_p,
    }
    for name, estimate in own.items():
        assert estimate.value == pytest.approx(found[name], rel=1e-4), name


# --- it can fail ---


class Redrawn(Experiment):
    """Another individual in each frame."""

    def frame(self, photons: float, integration_s: float, *key: object, sensor: Any = None) -> Frames:
        other = sample_sensor(self.physics, self.sensor.shape, stream("another", *key))
        return super().frame(photons, integration_s, *key, sensor=other)


def off_of(experiment: Experiment) -> dict[str, float]:
    found = package_results(experiment)
    return {name: abs(found[name] / true - 1) for name, true in truths(experiment).items()}


def test_a_pattern_that_is_drawn_for_each_frame_is_found_out() -> None:
    right = experiment_of(CASES[0], side=120)
    off = off_of(Redrawn(**vars(right)))
    assert min(off["K"], off["sigma_d"], off["DSNU1288"], off["PRNU1288"]) > 10 * GATE


def test_a_dark_that_is_clipped_is_found_out() -> None:
    right = experiment_of(CASES[0], side=120)
    pixel = right.physics.pixel.model_copy(update={"black_level_dn": 0.0})
    off = off_of(replace(right, sensor=replace(right.sensor, physics=replace(right.physics, pixel=pixel))))
    assert min(off["sigma_d"], off["DSNU1288"]) > 10 * GATE


@pytest.mark.parametrize("quantity", ["K", "QE", "sigma_d", "DSNU1288", "PRNU1288"])
def test_a_parameter_off_by_one_per_cent_is_found_out(quantity: str) -> None:
    experiment, found = judged(CASES[0])
    assert abs(found[quantity] / (1.01 * truths(experiment)[quantity]) - 1) > GATE
