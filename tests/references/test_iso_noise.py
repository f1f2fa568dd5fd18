"""ISO 15739 and ISO 12232 on frames with known noise, and photometry by an independent program.

Source: ISO 15739:2023, section 6.2.3 (temporal, fixed-pattern and total noise from n ≥ 8 frames)
and ISO 12232:2019 (S_sat = 78/H_sat, S_noise = 10/H at S/N 40 and 10); the pixel's parameters and
maps, and colour-science 0.4 for CIE D65 and V(λ).

Gates, two-sided:

- temporal, fixed-pattern and total noise within 0.5 % of the parameters, from 16 frames of 400 ×
  400 pixels: the statistical
  error of temporal noise is 1/√(2·160 000·15) = 0.05 %, that of fixed-pattern noise, against the
  device's maps, at most 0.2 %
  (with more frames if temporal noise exceeds the pattern);
- electrons per lx·s within 0.2 % of colour-science: the same tables at 1 nm, another quadrature;
- S_sat within 0.2 % and S_noise within 2 % of the closed forms: an S/N from two frames of 40 000
  pixels has an error of 0.4 %,
  and the S/N rises at most half as fast as the exposure at S/N 40.

The gates fail for 2 % more noise, and for an illuminant other than D65.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from references.gates import not_met, verdict

from pixsim.measure.datasheet import NOISE, SPEED, dark_map_e, make_datasheet
from pixsim.measure.estimators import daylight_e_per_lx_s, noise_15739
from pixsim.measure.experiment import Experiment, make_experiment
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

NOISE_GATE, LIGHT_GATE, SATURATION_GATE, SPEED_GATE = 0.005, 0.002, 0.002, 0.02
SIDE = 400
WELL_SHARES = 0.02, 0.13, 0.6
Case = tuple[str, float, int, int]  # technology, pitch in µm, bits, frames
CASES: tuple[Case, ...] = (
    ("0.35um", 5.3, 12, 16),
    ("0.35um", 15.0, 14, 16),
    ("4t-bsi", 1.4, 12, 64),
)
MORE_CASES: tuple[Case, ...] = (("0.35um", 6.5, 12, 16), ("0.5um", 9.0, 12, 16), ("0.25um", 5.0, 12, 16),
                                ("0.18um", 3.0, 12, 16), ("4t-fsi", 2.2, 12, 128))  # fmt: skip


def pixel_of(case: Case) -> Pixel:
    """Without a stack, so that the light on the photodiode is what these formulas have."""
    return Pixel(technology=case[0], pitch_um=case[1], bits=case[2], stack={"enabled": False})


def injected_dn(experiment: Experiment, signal_e: float) -> tuple[float, float]:
    """Temporal and fixed-pattern noise of a device in DN, from its parameters and maps."""
    p = experiment.readout
    dark_e = p.dark_current_e_per_s * experiment.integration_s
    temporal_e2 = (
        signal_e
        + dark_e
        + p.physics.reset_noise_e**2
        + p.read_noise_e**2
        + p.read_noise_after_gain_e**2
    )
    assert experiment.sensor.gain is not None
    pattern_e = dark_map_e(experiment) + signal_e * experiment.sensor.gain
    return math.sqrt(temporal_e2 * p.dn_per_e**2 + 1 / 12), float(pattern_e.std() * p.dn_per_e)


@lru_cache(maxsize=16)
def noise_offs(case: Case) -> list[tuple[str, float]]:
    """(name, measured/true - 1) at each light level."""
    experiment = make_experiment(pixel_of(case), shape=(SIDE, SIDE))
    deviations = []
    for share in WELL_SHARES:
        signal_e = share * experiment.readout.full_well_e
        frames = np.stack(
            [*experiment.frames(case[3], signal_e / experiment.efficiency, "iso", share)]
        )
        injected = injected_dn(experiment, signal_e)
        names = "temporal", "fixed-pattern", "total"
        for name, got, true in zip(
            names, noise_15739(frames), (*injected, math.hypot(*injected)), strict=True
        ):
            deviations.append(
                (f"{name} noise at {100 * share:g} % of the well", got.value / true - 1)
            )
    return deviations


def light_off(case: Case) -> float:
    """Electrons per lx·s of D65 over those from colour-science, minus 1; infrared cut as its D65
    ends at 780 nm.
    """
    physics = derive(pixel_of(case).model_copy(update={"infrared_cut_nm": 702.0}))
    nm = np.arange(360.0, 703.0, 1.0)
    colour = pytest.importorskip("colour")
    everything = np.arange(360.0, 781.0, 1.0)
    shape = colour.SpectralShape(300, 780, 1)
    illuminant = (
        colour.SDS_ILLUMINANTS["D65"]
        .copy()
        .interpolate(shape, interpolator=colour.LinearInterpolator)
    )
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    power = np.array([illuminant[wavelength] for wavelength in nm])
    photons = nm * 1e-9 / (6.62607015e-34 * 299792458.0)
    electrons = (
        np.trapezoid(power * photons * physics.quantum_efficiency(nm), nm)
        * physics.photodiode_area_um2
        * 1e-12
    )
    lux = 683.002 * np.trapezoid(
        [illuminant[wavelength] * observer[wavelength][1] for wavelength in everything], everything
    )
    return daylight_e_per_lx_s(physics) / float(electrons / lux) - 1


@lru_cache(maxsize=16)
def speed_offs(case: Case) -> list[tuple[str, float]]:
    sheet = make_datasheet(pixel_of(case))
    return [
        (entry.symbol, entry.off)
        for entry in sheet.entries
        if entry.standard == SPEED and math.isfinite(entry.off)
    ]


def rows(cases: tuple[Case, ...] = CASES) -> list[dict[str, object]]:
    """A row for each pixel and quantity."""
    table = []
    for case in cases:
        deviations = [(NOISE, quantity, NOISE_GATE, off) for quantity, off in noise_offs(case)]
        deviations.append(
            (SPEED, "electrons per lx·s of D65 by colour-science", LIGHT_GATE, light_off(case))
        )
        for symbol, off in speed_offs(case):
            deviations.append(
                (SPEED, symbol, SATURATION_GATE if symbol == "S_sat" else SPEED_GATE, off)
            )
        for standard, quantity, gate, off in deviations:
            judge, limit = (
                f"{quantity}: {case[0]}, {case[1]:g} µm",
                f"within {100 * gate:g} % of the parameters",
            )
            table.append(verdict(standard, judge, limit, f"{100 * off:+.2f} %", abs(off) <= gate))
    return table


@pytest.mark.parametrize(
    "case",
    [
        CASES[0],
        *(
            pytest.param(case, marks=pytest.mark.slow) for case in CASES[1:]
        ),  # test_emva1288 has another process
        *(pytest.param(case, marks=pytest.mark.judges_full) for case in MORE_CASES),
    ],
)
def test_noise_and_speed_match_parameters(case: Case) -> None:
    table = rows((case,))
    assert len(table) >= 11
    assert not not_met(table)


def test_two_percent_more_noise_fails() -> None:
    experiment = make_experiment(pixel_of(CASES[0]), shape=(200, 200))
    frames = np.stack([*experiment.frames(8, 0.0, "iso", "more")])
    noisier = frames.mean(axis=0) + 1.02 * (frames - frames.mean(axis=0))
    temporal, fixed = injected_dn(experiment, 0.0)
    right, wrong = (abs(noise_15739(stack)[0].value / temporal - 1) for stack in (frames, noisier))
    assert right < NOISE_GATE < wrong
    assert abs(noise_15739(frames + 0.02 * frames.mean(axis=0))[1].value / fixed - 1) > NOISE_GATE


def test_other_illuminant_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.measure.estimators.d65", lambda nm: np.ones_like(nm))
    assert abs(light_off(CASES[0])) > LIGHT_GATE
