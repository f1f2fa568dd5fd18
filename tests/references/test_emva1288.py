"""The package `emva1288` 1.0.2 on pixsim's frames, as a judge of the simulated sensor and of
pixsim's estimators.

Source: the reference implementation of EMVA 1288, https://github.com/EMVA1288/emva1288 (GPL; in the
tests only). From the frames of `pixsim.measure.experiment` it estimates K, QE, σ_d, DSNU1288,
PRNU1288 and saturation.

Gates, two-sided, with the statistical error of one sensor of 480 × 480 pixels:

- K and QE within 0.5 % of the parameters: the variance from a pair has an error of √(2/230 400) =
  0.3 %, a fit of about 30
  pairs 0.09 %. QE is QE(λ)·FF of the whole pixel.
- σ_d within 0.5 %, with enough bits for σ_d ≥ 1 DN: error 0.18 % from one dark pair (0.15 %) and K.
- DSNU and PRNU within 0.5 % of this device's maps of offset, column offset, dark charge and gain:
  error 0.15 % from the
  residual temporal noise of the stacks (0.12 %) and K.
- saturation within one exposure step of the peak of the model's expected variance
  (`pixsim.measure.datasheet`).
- pixsim's estimators within 1e-4 of the package's on the same frames: the formulas are the same.

The gates fail for another gain, a new fixed pattern in each frame, and a clipped dark.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pytest
from references.gates import not_met, verdict
from scipy.constants import e as electron

from pixsim.base.arrays import stream
from pixsim.measure.datasheet import dark_map_e, measure, variance_peak_e
from pixsim.measure.estimators import Frames, saturation_index
from pixsim.measure.experiment import Experiment, make_experiment, pixel_efficiency
from pixsim.sensor.correction import correct, residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Reading
from pixsim.sensor.readout import MergedFrame, capture_from_rates, make_frame, sample_sensor

process = pytest.importorskip("emva1288.process")
from emva1288.process import routines  # noqa: E402

STANDARD = "EMVA 1288 R4.0 (emva1288 1.0.2)"
GATE = 0.005
SIDE, EXPOSURES = 480, 40
# (technology, pitch in µm, bits for σ_d ≥ 1 DN, frames of a stack: more if temporal noise exceeds
# the fixed pattern)
CASES = (
    ("0.35um", 5.3, 12, 16),
    ("0.35um", 6.5, 12, 16),
    ("0.35um", 15.0, 14, 16),
    ("4t-bsi", 1.2, 12, 64),
)
MORE_CASES = (("0.5um", 9.0, 12, 16), ("0.25um", 5.0, 12, 16), ("0.18um", 3.0, 12, 16), ("4t-fsi", 2.2, 12, 100),
              ("4t-bsi", 0.7, 12, 400))  # fmt: skip
Case = tuple[str, float, int, int]


class Images:
    """Lazily captured frames with the interface that the package uses: length and iteration."""

    def __init__(self, experiment: Experiment, count: int, photons: float, *key: object) -> None:
        self.arguments = experiment, count, photons, key

    def __len__(self) -> int:
        return self.arguments[1]

    def __iter__(self) -> Iterator[Frames]:
        experiment, count, photons, key = self.arguments
        return experiment.frames(count, photons, *key)


def experiment_of(case: Case, side: int = SIDE, seed: int = 0) -> Experiment:
    technology, pitch_um, bits, frames = case
    pixel = Pixel(technology=technology, pitch_um=pitch_um, bits=bits)
    return make_experiment(
        pixel, seed=seed, shape=(side, side), exposures=EXPOSURES, stack_frames=frames
    )


def package_results(experiment: Experiment) -> dict[str, float]:
    """Results of the package, from frames reduced by its `get_int_imgs`, as in its file loader."""
    e, (height, width) = experiment, experiment.sensor.shape

    def temporal(photons: float, *key: object) -> dict[str, Any]:
        sums = routines.get_int_imgs(Images(e, 2, photons, *key))
        return {"sum": sums["sum"].sum(), "pvar": sums["pvar"].sum(), "dmean": sums["dmean"]}

    pairs = {
        photons: temporal(photons, "light series", index)
        for index, photons in enumerate(e.photons.tolist())
    }
    saturation = e.photons[
        saturation_index(np.array([images["pvar"] for images in pairs.values()], float))
    ]
    lights = {0.0: "dark stack", float(saturation) / 2: "bright stack"}
    stacks = {
        photons: routines.get_int_imgs(Images(e, e.stack_frames, photons, name))
        for photons, name in lights.items()
    }
    series = {0.0: temporal(0.0, "dark"), **pairs}
    data = {
        "height": height,
        "width": width,
        "temporal": {e.integration_s: series},
        "spatial": {e.integration_s: stacks},
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            np, "asfarray", lambda a: np.asarray(a, float), raising=False
        )  # removed in NumPy 2
        results = process.Results1288(process.Data1288(data, loglevel=40).data, loglevel=40)
        names = (
            "K",
            "R",
            "QE",
            "sigma_d",
            "sigma_y_dark",
            "DSNU1288",
            "PRNU1288",
            "u_p_sat",
            "u_p_min",
        )
        return {name: float(getattr(results, name)) for name in names}


def truths(experiment: Experiment) -> dict[str, float]:
    """The true values."""
    e, p = experiment, experiment.readout
    dark_e = p.dark_current_e_per_s * e.integration_s
    assert e.sensor.gain is not None
    return {
        "K": p.dn_per_e,
        "QE": 100 * e.efficiency,
        "sigma_d": math.sqrt(p.noise_floor_e**2 + dark_e),
        "DSNU1288": float(dark_map_e(e).std()),
        "PRNU1288": 100 * float(e.sensor.gain.std() / e.sensor.gain.mean()),
    }


@lru_cache(maxsize=16)
def judged(case: Case) -> tuple[Experiment, dict[str, float]]:
    experiment = experiment_of(case)
    return experiment, package_results(experiment)


def rows(cases: tuple[Case, ...] = CASES) -> list[dict[str, object]]:
    """A row for each pixel and quantity, and for each reading of pixels that have several."""
    table = reading_rows() if cases is CASES else []
    for case in cases:
        e, results = judged(case)
        name = f"{case[0]}, {case[1]:g} µm, {case[2]} bits"
        for quantity, true in truths(e).items():
            off = results[quantity] / true - 1
            text, met = f"{100 * off:+.2f} %", abs(off) <= GATE
            table.append(
                verdict(
                    STANDARD, f"{quantity}: {name}", "within 0.5 % of the parameters", text, met
                )
            )
        step = float(e.photons[1] - e.photons[0])
        peak = (
            variance_peak_e(e.readout, e.integration_s, float(e.photons[-1]) * e.efficiency)
            / e.efficiency
        )
        off = (results["u_p_sat"] - peak) / step
        table.append(
            verdict(
                STANDARD,
                f"saturation: {name}",
                "within one exposure step",
                f"{off:+.2f} steps",
                abs(off) <= 1,
            )
        )
    return table


def reading_rows() -> list[dict[str, object]]:
    """A row for each reading and quantity."""
    table = []
    for readout, number in itertools.product(READOUTS, (0, 1)):
        experiment = of_reading(readout, number)
        results = package_results(experiment)
        for quantity, true in truths(experiment).items():
            off = results[quantity] / true - 1
            gate = f"within {100 * GATES[quantity]:g} % of the parameters"
            judge = f"{quantity} of a reading: {readout['kind']}, {number}"
            measured = f"{100 * off:+.2f} %"
            table.append(verdict(STANDARD, judge, gate, measured, abs(off) <= GATES[quantity]))
    return table


OTHER_SIZES = CASES[1:3]  # of the first case's process


@pytest.mark.parametrize(
    "case",
    [
        *(pytest.param(c, marks=pytest.mark.slow) if c in OTHER_SIZES else c for c in CASES),
        *(pytest.param(case, marks=pytest.mark.judges_full) for case in MORE_CASES),
    ],
)
def test_package_results_match_parameters(case: Case) -> None:
    experiment, results = judged(case)
    assert case in MORE_CASES or results["sigma_y_dark"] > 1, "too few bits for the gate on σ_d"
    assert experiment.readout.adc.black_level_dn > 6 * results["sigma_y_dark"]
    assert not not_met(rows((case,)))


def deviations(experiment: Experiment) -> dict[str, float]:
    """measured/true - 1 of each quantity."""
    results = package_results(experiment)
    return {name: results[name] / true - 1 for name, true in truths(experiment).items()}


@pytest.mark.judges_full
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def test_package_results_six_seeds_match_parameters(case: Case) -> None:
    """For six devices the mean deviation is below half of the gate, each deviation below 1.5 times
    the gate.
    """
    offs = [list(deviations(experiment_of(case, seed=seed)).values()) for seed in range(1, 7)]
    assert np.all(np.abs(np.mean(offs, axis=0)) < GATE / 2)
    assert np.all(np.abs(offs) < 1.5 * GATE)


def test_estimators_match_package() -> None:
    experiment = experiment_of(CASES[0], side=120)
    results, sheet = package_results(experiment), measure(experiment)
    curve = sheet.transfer
    estimates = {
        "K": curve.gain_dn_per_e, "R": curve.responsivity_dn_per_p, "QE": curve.efficiency * 100, "sigma_d": curve.dark_noise_e,
        "u_p_sat": curve.saturation_p, "u_p_min": curve.threshold_p, "DSNU1288": sheet.dsnu_e, "PRNU1288": sheet.prnu * 100
    }  # fmt: skip
    for name, estimate in estimates.items():
        assert estimate.value == pytest.approx(results[name], rel=1e-4), name


# --- Gain, and mismatch that follows from the layout ---

# 240 × 240 pixels, half the side: twice the errors above, 0.2 % of K and QE, 0.3 % of σ_d, and of
# DSNU and PRNU 0.3 % from the stacks and 0.3 % (1/√(2 · 57 600)) from drawing this device; standard
# deviations of 8 seeds are 0.18, 0.25 and 0.4 %. Gates of 5 of these errors: 6e-7 false alarms
# each, with another seed.
SMALL = 240
GATES = {"K": 0.01, "QE": 0.01, "sigma_d": 0.015, "DSNU1288": 0.02, "PRNU1288": 0.02}
READ_E, AFTER_E, FULL_E, BITS = 3.0, 40.0, 20_000.0, 14
SPLIT = {
    "pitch_um": 4.0, "full_well_e": FULL_E, "read_noise_e": READ_E, "read_noise_after_gain_e": AFTER_E, "bits": BITS,
    "dark_current_e_per_s": 0.0, "quantum_efficiency": 0.6, "prnu": 0.01, "black_level_dn": 600.0
}  # fmt: skip


def outside(results: dict[str, float], expected: dict[str, float]) -> dict[str, float]:
    """The quantities that are farther than their gate from the expected ones, and how far."""
    off = {name: results[name] / value - 1 for name, value in expected.items()}
    return {name: value for name, value in off.items() if not abs(value) <= GATES[name]}


@pytest.mark.parametrize(
    ("gain_db", "full_scale_e"),
    [
        (0, None),
        *(pytest.param(gain_db, None, marks=pytest.mark.slow) for gain_db in (6, 12)),
        (24, None),
        (12, 30_000.0),
    ],
)
def test_package_measures_gain_and_read_noise_before_and_after_it(
    gain_db: float, full_scale_e: float | None
) -> None:
    """K = codes/range · g; σ_d² = before² + (after/g)², in electrons; saturation at the lower of
    the well and the range over g.
    """
    g, full_e = 10 ** (gain_db / 20), full_scale_e or FULL_E
    pixel = Pixel.model_validate(SPLIT | {"adc_full_scale_e": full_scale_e})
    experiment = make_experiment(
        pixel, Exposure(gain_db=gain_db), shape=(SMALL, SMALL), exposures=EXPOSURES, stack_frames=16
    )
    assert experiment.readout.adc.black_level_dn == 600, "room for 6 σ of the dark at every gain"
    results = package_results(experiment)
    k = (2**BITS - 1 - 600) / full_e * g
    expected = {"K": k, "QE": 60.0, "sigma_d": math.hypot(READ_E, AFTER_E / g)}
    assert not outside(results, expected)
    others = [math.hypot(READ_E, AFTER_E), AFTER_E / g, READ_E] if gain_db else [READ_E]
    for wrong in (
        others
    ):  # the gate tells the split from either part alone, and from noise that the gain leaves
        assert outside(results, {"sigma_d": wrong}) or wrong == pytest.approx(
            expected["sigma_d"], rel=0.02
        )
    step = float(experiment.photons[1] - experiment.photons[0])
    clip_p = min(FULL_E, full_e / g) / 0.6
    assert 0.9 * clip_p - step < results["u_p_sat"] < clip_p + step


@pytest.mark.parametrize(("pitch_um", "gate_um2"), [(5.5, 0.5), (9.0, 2.0)])
def test_package_measures_mismatch_of_the_layout(pitch_um: float, gate_um2: float) -> None:
    """PRNU = k/√(photodiode area) and DSNU = A_Vt/√(W L) · C/q at two geometries, where each
    differs by 2 and more.
    """
    layout = {"prnu_um": 0.06, "a_vt_mv_um": 8.0, "follower_area_um2": gate_um2}
    pixel = Pixel.model_validate(
        {"pitch_um": pitch_um, "bits": BITS, "dsnu": 0.0, "column_fpn": 0.0} | layout
    )
    physics, plain = derive(pixel), derive(Pixel(pitch_um=pitch_um))
    experiment = make_experiment(pixel, shape=(SMALL, SMALL), exposures=EXPOSURES, stack_frames=16)
    assert plain.capacitance_ff is not None
    offset_e = 8e-3 / math.sqrt(gate_um2) * plain.capacitance_ff * 1e-15 / electron
    expected = {"PRNU1288": 100 * 0.06 / math.sqrt(plain.photodiode_area_um2), "DSNU1288": offset_e}
    assert not outside(package_results(experiment), expected)
    assert physics.photodiode_area_um2 == plain.photodiode_area_um2


# --- Each reading of a pixel that is read several times ---


@dataclass(frozen=True)
class OfReading(Experiment):
    """The codes of one reading in frames of the whole sensor."""

    number: int = 0

    @property
    def reading(self) -> Reading:
        return self.whole.readout.readings[self.number]

    @cached_property
    def efficiency(self) -> float:
        return pixel_efficiency(self.physics, self.wavelength_nm) * self.reading.response

    def frame(
        self, photons: float, integration_s: float, *key: object, sensor: Any = None
    ) -> Frames:
        light_e = photons * self.efficiency / self.reading.response
        rates = np.full(self.sensor.shape, light_e / integration_s)
        exposure = Exposure(integration_s=integration_s)
        frame = capture_from_rates(rates, self.whole, exposure, stream("reading", *key))
        assert isinstance(frame, MergedFrame)
        return frame.readings[self.reading.name]


def of_reading(readout: dict[str, Any], number: int) -> OfReading:
    sheet = SPLIT | {"read_noise_after_gain_e": None, "dsnu_e": 6.0, "readout": readout}
    made = make_experiment(
        Pixel.model_validate(sheet),
        general=True,
        shape=(SMALL, SMALL),
        exposures=EXPOSURES,
        stack_frames=16,
    )
    reading = made.whole.readout.readings[number]
    diode = made.whole.further[reading.photodiode - 1] if reading.photodiode else made.whole
    sensor = replace(diode, readout=reading.readout, further=())
    wider = reading.limit_e / reading.response / made.readout.saturation_e
    parts = vars(made) | {"sensor": sensor, "photons": made.photons * wider}
    return OfReading(**parts, number=number)


READOUTS = [
    {"kind": "dual_gain", "conversion_gain_uv_per_e": [160, 40], "read_noise_e": [3, 9]},
    {"kind": "split", "response": [1, 0.02], "full_well_e": [20_000, 9000], "read_noise_e": [3, 5]},
    {"kind": "staggered", "ratio": 8.0},
    {
        "kind": "overflow",
        "conversion_gain_uv_per_e": [160, 20],
        "capacity_e": 60_000,
        "read_noise_e": [3, 10],
    },
]


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("readout", READOUTS, ids=lambda readout: readout["kind"])
def test_package_measures_each_reading(readout: dict[str, Any], number: int) -> None:
    """K, QE, σ_d, DSNU and PRNU are those of the reading and its photodiode; saturation is its
    limit.
    """
    experiment = of_reading(readout, number)
    results = package_results(experiment)
    assert not outside(results, truths(experiment))
    limit_p = experiment.reading.limit_e / experiment.efficiency
    step = float(experiment.photons[1] - experiment.photons[0])
    assert 0.9 * limit_p - step < results["u_p_sat"] < limit_p + step


# --- What a camera's correction leaves ---

# 160 × 160 pixels: 0.44 % from drawing the noise of dark and flat frames (1/√(2 · 25 600)), 0.5 %
# from K in 16 exposures; eight devices scatter by 0.8 %. A gate of 5 of that.
CORRECTED, CORRECTED_GATE = 160, 0.04


class Corrected(Experiment):
    """Frames as a camera hands them on: corrected by the same dark and flat frames, in codes above
    the black level.
    """

    correction = Correction(dark_frames=8, flat_frames=2)

    def frame(
        self, photons: float, integration_s: float, *key: object, sensor: Any = None
    ) -> Frames:
        p, dn = self.readout, super().frame(photons, integration_s, *key, sensor=sensor)
        light = np.full(dn.shape, photons * self.efficiency / integration_s)
        frame = make_frame(
            dn, 0.0, light, p, Exposure(integration_s=integration_s, gain_db=p.gain_db)
        )
        corrected = correct(frame, self.sensor, self.correction, stream("masters"))
        return np.rint(corrected.estimate_e * p.dn_per_e + p.adc.black_level_dn).astype(np.int32)


def test_package_measures_what_correction_leaves() -> None:
    """DSNU² = T/n_d; PRNU² s² = [(1 - s/L)² - 1] T/n_d + (s/L)² (L + T)/n_f at the bright stack;
    much less than without.
    """
    pixel = Pixel.model_validate(
        SPLIT | {"read_noise_e": 20.0, "offset_fpn": 0.01, "prnu": 0.02, "column_fpn": 0.005}
    )
    options: dict[str, Any] = {"shape": (CORRECTED, CORRECTED), "exposures": 16, "stack_frames": 24}
    plain = make_experiment(pixel, **options)
    made, p = Corrected(**vars(plain)), plain.readout
    results = package_results(made)
    dark_e2 = p.physics.reset_noise_e**2 + p.read_noise_at_gain_e**2 + 1 / 12 / p.dn_per_e**2
    left = residual_variance_e2(0.0, made.integration_s, p, Corrected.correction)
    assert left.offsets == pytest.approx(dark_e2 / 8 * (1 - 0) ** 2, rel=1e-12)
    bright_e = results["u_p_sat"] / 2 * made.efficiency  # of the bright stack
    light = residual_variance_e2(bright_e, made.integration_s, p, Corrected.correction)
    prnu = math.sqrt(light.offsets + light.flat - left.offsets) / bright_e
    expected = {"DSNU1288": math.sqrt(left.offsets), "PRNU1288": 100 * prnu, "K": p.dn_per_e}
    for name, value in expected.items():
        assert results[name] == pytest.approx(value, rel=CORRECTED_GATE), name
    assert p.physics.offset_fpn_e > 5 * expected["DSNU1288"]
    assert 100 * p.prnu > 2 * expected["PRNU1288"]


class Resampled(Experiment):
    """Another fixed pattern in each frame."""

    def frame(
        self, photons: float, integration_s: float, *key: object, sensor: Any = None
    ) -> Frames:
        other = sample_sensor(self.readout, self.sensor.shape, stream("another", *key))
        return super().frame(photons, integration_s, *key, sensor=other)


def test_resampled_pattern_fails() -> None:
    off = deviations(Resampled(**vars(experiment_of(CASES[0], side=120))))
    assert min(abs(off[name]) for name in ("K", "sigma_d", "DSNU1288", "PRNU1288")) > 10 * GATE


def test_clipped_dark_fails() -> None:
    right = experiment_of(CASES[0], side=120)
    clipped = replace(right.readout, adc=replace(right.readout.adc, black_level_dn=0.0))
    off = deviations(replace(right, sensor=replace(right.sensor, readout=clipped)))
    assert min(abs(off["sigma_d"]), abs(off["DSNU1288"])) > 10 * GATE


@pytest.mark.parametrize("quantity", ["K", "QE", "sigma_d", "DSNU1288", "PRNU1288"])
def test_parameter_off_by_one_percent_fails(quantity: str) -> None:
    experiment, results = judged(CASES[0])
    assert abs(results[quantity] / (1.01 * truths(experiment)[quantity]) - 1) > GATE
