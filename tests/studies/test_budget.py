"""An error budget adds up, and what is chosen from it keeps to the tolerance."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.wording import budget_section
from pixsim.show.render import lines as lines_of
from pixsim.studies.budget import (
    FINEST_NOISE,
    MAX_SENSORS,
    SOURCES,
    Calibration,
    Effect,
    Probe,
    ProbeDesign,
    brighter,
    choose,
    difference_of,
    effects,
    film_errors,
    interpolation_effect,
    options_of,
    pitches_around_least_um,
    probe,
    rounded_down,
    total,
    widths_of,
)
from pixsim.studies.film_error import MAX_ORDER, MIN_ORDER, coarser, merges
from pixsim.viewer.display import interpolation_mtf
from pixsim.viewer.imaging import Imaging

NO_OPTIMUM = math.nan


def calibration(**changes) -> Calibration:
    values = {
        "width": 512, "cells": 512 * 512, "noise": 0.1, "random": Effect(2e-4, 1e-3), "bias": Effect(1e-4, 1e-3),
        "per_e": Effect(0.5, 2.0), "films": (Effect(0.1, 0.5), Effect(0.02, 0.1), Effect(0.004, 0.02)), "order": 2.0,
        "sensor": Effect(0.003, 0.05), "raster": Effect(0.01, 0.02), "interpolation": Effect(0.03, 0.04),
        "work": 8.4e6, "planes": 1, "dots": 512,
    }  # fmt: skip
    return Calibration(**values | changes)


BLIND, NONE, UNKNOWN = Effect(0.02, NO_OPTIMUM), Effect(0.0, 0.0), Effect(math.nan, math.nan)
CALIBRATIONS = {
    "usual": calibration(),
    "no optimum": calibration(random=BLIND, sensor=BLIND, raster=UNKNOWN, interpolation=BLIND),
    "no noise": calibration(noise=0.0, random=NONE, bias=NONE),
    "nothing errs": calibration(noise=0.0, random=NONE, bias=NONE, per_e=NONE, sensor=NONE, films=(NONE,)),
    "noisy": calibration(noise=4.0, random=Effect(0.1, 0.5), bias=Effect(1.0, 0.5)),
    "spectral": calibration(per_e=Effect(100.0, 1.0)),
    "many planes": calibration(planes=40),
    "odd width": calibration(width=301, cells=301 * 200, films=(Effect(0.004, 0.02),)),
}
TOLERANCES = (1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 1.0, 10.0)


def work_of(actual: Calibration, tolerance: float, free: bool = True) -> float:
    """Return the work of the choice among the options."""
    choice = choose(actual, tolerance, film_is_free=free)
    options = [e for w in widths_of(actual) for e in options_of(actual, w, tolerance - actual.film(w).delta_e)]
    return min(item.work for item in options if replace(item, met=True) == choice)


# --- Films ---


def made(*delta_e: float, optimum: bool = True) -> Probe:
    pitch = np.geomspace(4, 8, 6)
    sweep = (np.log(pitch / 5.5) ** 2)[:, None] + delta_e[0]
    return Probe(np.zeros((1, 1)), np.array(delta_e), pitch if optimum else np.zeros(0), sweep if optimum else np.zeros((0, 1)))


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5, 2.0, 3.0, 6.0])
def test_film_errors_of_power_law(order):
    """Of films that err by 0.01 steps^order. The limits of the formula: test_film_error.py."""
    own, half, quarter = (made(1 + 0.01 * step**order) for step in (1, 2, 4))
    films, actual = film_errors(own, [half, quarter])
    assert actual == pytest.approx(min(max(order, MIN_ORDER), MAX_ORDER))
    for got, step in zip(films, (4, 2, 1), strict=True):
        true = 0.01 * step**order
        # An upper limit, by a quarter of the film's error; at and beyond the bounds of the order, the factor is 3 or more.
        assert true <= got.delta_e * (1 + 1e-9)
        assert got.delta_e <= true + 2.01 * 0.01 or order > MAX_ORDER
    if order == 1.5:
        assert films[-1].delta_e == pytest.approx(1.25 * 0.01)


def test_film_errors_zero_or_changing_sign():
    same = made(1.0)
    films, order = film_errors(same, [same, same])
    assert [item.delta_e for item in films] == [0, 0, 0]
    assert math.isfinite(order)
    back, order = film_errors(made(1.0), [made(1.1), made(1.1)])  # the coarsest film is as good: nothing is known
    assert (back[-1].delta_e, order) == (pytest.approx(0.3), MIN_ORDER)
    none, _ = film_errors(same, [])
    assert math.isnan(none[0].delta_e)
    one, order = film_errors(made(1.0), [made(1.1)])
    assert (len(one), order) == (2, MIN_ORDER)


def test_difference_of_counts_every_pitch():
    one, other = made(1.0), made(1.0)
    other = replace(other, sweep_delta_e=other.sweep_delta_e + 0.1)
    assert difference_of(one, other).delta_e == pytest.approx(0.1 * math.sqrt(6 / 7))
    alone = difference_of(made(1.0, optimum=False), made(1.2, optimum=False))
    assert alone.delta_e == pytest.approx(0.2)
    assert math.isnan(alone.optimum_um)


def image(factored: bool, height: int = 16, width: int = 24) -> pixsim.SpectralImage:
    rng = np.random.default_rng(7)
    light = {"factors": (rng.random((2, 3)), rng.random((2, height, width)))}
    if not factored:
        light = {"data": rng.random((height, width, 3))}
    return pixsim.SpectralImage([500, 550, 600], 50, 2.0, header={"who": "me"}, **light)


@pytest.mark.parametrize("factored", [True, False])
def test_coarser_and_brighter_conserve_light(factored):
    fine = image(factored)
    got = brighter(fine, 1.01)
    np.testing.assert_allclose(got.data, 1.01 * fine.data.astype(float), rtol=3e-7)
    assert got.header == fine.header
    for factor in (1, 2, 4):
        got = coarser(fine, factor)
        assert got.shape == (16 // factor, 24 // factor)
        assert got.pitch_um == 2.0 * factor
        assert (got.factors is not None) == factored
        expected = fine.data.astype(float).reshape(16 // factor, factor, 24 // factor, factor, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(got.data, expected, rtol=3e-7)
        np.testing.assert_allclose(got.mean_spectrum(), fine.mean_spectrum(), rtol=1e-6)
        assert got.header == fine.header
        np.testing.assert_array_equal(got.within[0], fine.within[0])


def test_merges_requires_whole_blocks():
    assert merges((16, 24), 4)
    assert not merges((16, 26), 4)  # a cut picture would be another one
    assert not merges((8, 24), 4)
    with pytest.raises(pixsim.PixsimError, match="got \\(16, 26\\)"):
        coarser(image(True, 16, 26), 4)


# --- Budgets and choices ---


def test_effects_scale_with_settings():
    actual = calibration()
    one = effects(actual, 512, 0.1, 1e-3, 1)
    assert tuple(one) == SOURCES
    other = effects(actual, 256, 0.2, 2e-3, 4)
    assert one["render noise"].delta_e == pytest.approx(1.96 * 2e-4 + 1e-4)
    assert other["render noise"].delta_e == pytest.approx(2 * 1.96 * 2e-4 + 4 * 1e-4)
    assert other["spectral quadrature"].delta_e == pytest.approx(2 * one["spectral quadrature"].delta_e)
    assert other["seeds"].optimum_um == pytest.approx(one["seeds"].optimum_um / 2)
    assert other["oversampling"].delta_e == 0.02
    assert effects(actual, 2048, 0.1, 1e-3, 1)["oversampling"].delta_e == pytest.approx(0.004 / 16)
    assert (one["display raster"], one["display interpolation"]) == (actual.raster, actual.interpolation)
    of_computing = [item for name, item in one.items() if not name.startswith("display")]
    assert len(of_computing) == 4
    assert total(one).delta_e == pytest.approx(sum(item.delta_e for item in of_computing))


def test_interpolation_effect_uses_next_order():
    """A grating without noise: the changes of ΔE are in the ratio of the changes of its contrast."""
    x = (np.arange(256) + 0.5) / 256
    light = np.tile(1 + 0.5 * np.sin(2 * np.pi * 12 * x), (32, 1))
    nm = np.arange(400.0, 701.0, 20.0)
    # 12 cycles on 1 mm through pixels of 20 µm: a quarter of a cycle each.
    grating = pixsim.SpectralImage(nm, 20.0, 1e3 / 256, factors=(np.full((1, nm.size), 1e-3), light[None]))
    camera = pixsim.Camera(die_mm=1.0)
    pixel = pixsim.Pixel(pitch_um=20.0, fill_factor=0.25, prnu=0, reset_noise_factor=0, read_noise_e=0, bits=14)
    white = float(np.quantile(grating.illuminance_lx(), 0.9)) * 65 / np.pi

    def changed_by(**display) -> Effect:
        shown = pixsim.Display(dots=100, bits=16, white_cd_per_m2=2 * white, **display)
        design = ProbeDesign(Imaging(camera, pixel, pixsim.Exposure(), shown))
        return interpolation_effect(grating, design, probe(grating, design))

    nearest, linear, cubic = (changed_by(interpolation=item).delta_e for item in ("nearest", "linear", "cubic"))
    left = {item: float(interpolation_mtf(12.0, 20.0, item)) for item in ("linear", "cubic", "quintic")}
    gained = (left["cubic"] - left["linear"]) / (left["quintic"] - left["cubic"])
    # So small a ΔE goes with the contrast that is lost, but for the images (0.5 %) and the eye's cube root.
    assert linear / cubic == pytest.approx(gained, rel=0.15)  # 15.2
    # Cells that stay flat lose less contrast than lines do, and show images instead: the two nearly cancel.
    assert 0 < nearest < linear
    assert math.isnan(changed_by(raster="one_to_one").delta_e)


@pytest.mark.parametrize("name", CALIBRATIONS)
@pytest.mark.parametrize("free", [True, False])
def test_choose_meets_tolerance_or_reports_not_met(name, free):
    actual = CALIBRATIONS[name]
    for tolerance in TOLERANCES:
        choice = choose(actual, tolerance, film_is_free=free)
        assert choice == choose(actual, tolerance, film_is_free=free)
        message = total(effects(actual, choice.width, choice.render_noise, choice.tolerance_e, choice.sensors)).delta_e
        assert choice.expected_delta_e == message
        assert choice.met == (message <= tolerance)
        assert choice.width in widths_of(actual)
        assert free or choice.width == actual.width
        assert FINEST_NOISE <= choice.render_noise <= 1
        assert 1 <= choice.sensors <= MAX_SENSORS
    assert choose(actual, 10.0, film_is_free=free).met


@pytest.mark.parametrize("name", CALIBRATIONS)
@pytest.mark.parametrize("free", [True, False])
def test_choose_looser_tolerance_is_not_more_work(name, free):
    actual = CALIBRATIONS[name]
    tolerances = [t for t in np.geomspace(1e-4, 3, 24) if choose(actual, t, film_is_free=free).met]
    work = [work_of(actual, tolerance, free) for tolerance in tolerances]
    assert all(later <= earlier * (1 + 1e-12) for earlier, later in pairwise(work))
    assert [choose(actual, t, film_is_free=free).met for t in (tolerances[0], 3.0)] == [True, True]


def test_choose_film_error_is_not_compensated():
    """The film errs by 0.004 and is fixed: the rest keeps to the tolerance of 0.002, and no more is spent."""
    actual = calibration()
    stuck, open_ = (choose(actual, 0.002, film_is_free=free) for free in (False, True))
    assert not stuck.met
    assert open_.met
    assert stuck.expected_delta_e <= 0.004 + 0.002
    assert stuck.render_noise > 10 * FINEST_NOISE
    unknown = choose(calibration(films=(UNKNOWN,)), 0.01, film_is_free=False)
    assert not unknown.met
    assert math.isnan(unknown.expected_delta_e)


def test_choose_limits_sensors():
    choice = choose(calibration(sensor=Effect(1.0, 1.0)), 1e-3, film_is_free=True)
    assert (choice.sensors, choice.met) == (MAX_SENSORS, False)


def test_widths_of_stay_within_memory():
    """The scene's own width is always allowed."""
    assert [max(widths_of(calibration(planes=planes))) for planes in (1, 40, 10_000)] == [4096, 1024, 512]


def test_rounded_down_to_three_digits():
    for value in np.geomspace(1e-5, 2, 300):
        assert 0 <= value - rounded_down(value) < 0.011 * value
        assert float(f"{rounded_down(value):.3g}") == rounded_down(value)


def test_budget_lines_are_aligned():
    budget = effects(calibration(), 512, 0.1, 1e-3, 1)
    sources = {name: {"delta_e": item.delta_e, "optimum_um": None} for name, item in budget.items()}
    message = {"tolerance_delta_e": 0.01, "met": True, "bounded": True, "settings": {"sensors": 2}, "sources": sources}
    _, words, *lines = lines_of(budget_section(message | {"total": {"delta_e": 0.5, "optimum_um": None}}))
    assert words == "error budget for 0.01 ΔE (met), with sensors 2:"
    largest_first = sorted(SOURCES, key=lambda name: -(math.inf if math.isnan(budget[name].delta_e) else budget[name].delta_e))
    assert [line[2:23].rstrip() for line in lines] == [*largest_first, "total without display"]
    assert lines[0][23:] == f"  {max(item.delta_e for item in budget.values()):.1e} ΔE"
    assert {line[23:25] for line in lines} == {"  "}


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_calibration_round_trips_json(name):
    actual = CALIBRATIONS[name]
    back = Calibration.from_dict(json.loads(json.dumps(asdict(actual))))
    assert repr(back) == repr(actual)  # NaN is not equal to itself
    assert isinstance(back.films, tuple)


@pytest.mark.parametrize("change", [{"width": None}, {"films": 3}, {"films": [1.0]}, {"random": {"delta_e": 1}}, {"noise": "low"}])
def test_calibration_from_invalid_dict_raises(change):
    values = json.loads(json.dumps(asdict(calibration()))) | change
    for wrong in (values, {}):
        with pytest.raises(ValueError, match="validation error"):
            Calibration.from_dict(wrong)


def test_pitches_whose_colours_cannot_be_taken_apart_are_left_out_of_the_scan():
    """Below 2 µm the channels mix here; of a monochrome pixel, and of the largest size, an error is an error."""

    def delta_e(pitch_um: float) -> float:
        if pitch_um < 2:
            raise PixsimError("noise gains")
        return pitch_um

    sizes_um = np.geomspace(0.5, 15.0, 9).tolist()
    assert 2 <= pitches_around_least_um(sizes_um, delta_e, 4, coloured=True)[0] < 3
    for scanned_um, coloured in ((sizes_um, False), (sizes_um[:2], True)):
        with pytest.raises(PixsimError):
            pitches_around_least_um(scanned_um, delta_e, 4, coloured=coloured)
