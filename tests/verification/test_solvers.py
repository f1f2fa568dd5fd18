"""The photodiode's quadrature against solvers of the differential equation, and the curves that show it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pixsim.sensor.photodiode import collected_charge_e, default_diode, diode_of
from pixsim.sensor.pixel_options import Pixel
from pixsim.verification.solvers import dn_against_light, response_plate, solve_ode, solvers


@pytest.mark.parametrize("reset_v", [1e-3, 0.02, 0.3])
def test_collected_charge_shallow_reset_matches_radau(reset_v):
    # Down to V_T/26, where the diode conducts from the start.
    diode = replace(default_diode(), reset_voltage_v=reset_v)
    for current, time_s in ((0.0, 1.0), (1e4, 0.1), (1e7, 1e-3), (1e7, 1e-6)):
        expected, _, failure = solve_ode(diode, current, time_s, "Radau")
        assert not failure
        assert collected_charge_e(current, time_s, diode) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("temperature_k", [pytest.param(77.0, marks=pytest.mark.slow), 400.0])
def test_solvers_saturated_only_explicit_fails(temperature_k):
    diode = diode_of(Pixel(temperature_k=temperature_k))
    quadrature, implicit, explicit = solvers(diode, 1e13, 1.0, most=12_000)
    assert quadrature.charge_e == collected_charge_e(1e13, 1.0, diode)
    assert not implicit.failure
    assert math.isnan(explicit.relative_error)
    assert implicit.relative_error < 1e-9
    assert "12000 evaluations" in explicit.failure
    assert explicit.evaluations == 12_000


def test_solvers_unsaturated_all_agree():
    rows = solvers(default_diode(), 1e6, 0.03)
    assert not any(row.failure for row in rows)
    assert max(row.relative_error for row in rows) < 1e-8


def test_dn_against_light_deviations():
    responses = {(response.well_limit, response.conversion): response for response in dn_against_light(Pixel())}
    assert len(responses) == 4
    assert all(np.diff(response.dn).min() >= 0 and response.dn[-1] == 1023 for response in responses.values())
    worst = {key: np.abs(response.deviation_percent).max() for key, response in responses.items()}
    assert worst["swing", "linear"] < 1e-9
    assert worst["swing", "junction"] == pytest.approx(1.75, abs=0.02)
    assert 0.5 < worst["diode", "linear"] < 1.5
    # Soft saturation deviates most from the straight line at the corner.
    soft = responses["diode", "linear"]
    assert soft.generated_e[soft.deviation_percent.argmin()] == pytest.approx(soft.full_well_e, rel=0.01)


def test_response_plate_has_table():
    plate = response_plate(Pixel())
    assert {len(column) for column in plate.table.values()} == {601}
    assert len(plate.csv.splitlines()) == 602
    assert "1.8 %" in plate.caption
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in plate.figure.axes)
