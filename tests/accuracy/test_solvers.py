"""The photodiode's quadrature against solvers of the differential equation, and the curves that show it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pixsim.accuracy.solvers import dn_against_light, response_plate, solve_ode, solvers
from pixsim.base.parameters import Pixel
from pixsim.sensor.photodiode import collected_charge_e, default_diode, diode_of


@pytest.mark.parametrize("reset_v", [1e-3, 0.02, 0.3])
def test_shallow_resets_agree_with_the_implicit_solver(reset_v):
    # Down to a 26th of V_T, where the diode takes its part from the first moment on.
    diode = replace(default_diode(), reset_voltage_v=reset_v)
    for current, time_s in ((0.0, 1.0), (1e4, 0.1), (1e7, 1e-3), (1e7, 1e-6)):
        expected, _, failure = solve_ode(diode, current, time_s, "Radau")
        assert not failure
        assert collected_charge_e(current, time_s, diode) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("temperature_k", [77.0, 400.0])
def test_the_implicit_solver_agrees_and_the_explicit_one_fails(temperature_k):
    diode = diode_of(Pixel(temperature_k=temperature_k))
    quadrature, implicit, explicit = solvers(diode, 1e13, 1.0, most=12_000)
    assert quadrature.charge_e == collected_charge_e(1e13, 1.0, diode)
    assert not implicit.failure
    assert math.isnan(explicit.relative_error)
    assert implicit.relative_error < 1e-9
    assert "12000 evaluations" in explicit.failure
    assert explicit.evaluations == 12_000


def test_the_explicit_solver_does_well_where_nothing_is_stiff():
    rows = solvers(default_diode(), 1e6, 0.03)
    assert not any(row.failure for row in rows)
    assert max(row.relative_error for row in rows) < 1e-8


def test_digital_numbers_against_light():
    found = {(each.well_limit, each.conversion): each for each in dn_against_light(Pixel())}
    assert len(found) == 4
    assert all(np.diff(each.dn).min() >= 0 and each.dn[-1] == 1023 for each in found.values())
    worst = {key: np.abs(each.deviation_percent).max() for key, each in found.items()}
    assert worst["swing", "linear"] < 1e-9
    assert worst["swing", "junction"] == pytest.approx(1.75, abs=0.02)
    assert 0.5 < worst["diode", "linear"] < 1.5
    # Soft: short of the straight line at the corner, where the swing's clip is sharp.
    soft = found["diode", "linear"]
    assert soft.generated_e[soft.deviation_percent.argmin()] == pytest.approx(soft.full_well_e, rel=0.01)


def test_the_figure_has_its_table():
    plate = response_plate(Pixel())
    assert {len(column) for column in plate.table.values()} == {601}
    assert len(plate.csv.splitlines()) == 602
    assert "1.8 %" in plate.caption
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in plate.figure.axes)
