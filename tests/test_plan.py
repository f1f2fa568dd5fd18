"""The plan: which bands in which pass, pulses that add up to the lamp, and when one pass is enough."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import pixsim
from pixsim.lamps import LAMP_GRID_NM, Lamp
from pixsim.plan import BAND_CENTRE_NM, BAND_WIDTH_NM, band_means, band_passes, band_pulse, is_single_emitter, make_plan
from pixsim.scene import packaged_scenes

LAMPS = {
    "rising": Lamp((LAMP_GRID_NM - 300) / 100, {}),
    "ragged": Lamp(np.random.default_rng(0).uniform(0.2, 2, LAMP_GRID_NM.size), {}),
    "a line": Lamp(np.where(LAMP_GRID_NM == 589, 1.0, 0.0), {}),
}
FINE_NM = np.arange(360.0, 830.001, 0.05)


def pulse_at(lamp: Lamp | None, centre_nm: float) -> tuple[np.ndarray, float]:
    """Light of a band on the fine grid: its pulse times the lamp's integral over it."""
    nodes, values, area = band_pulse(lamp, centre_nm)
    return np.interp(FINE_NM, nodes, values, left=0, right=0) * area, area


# --- Bands and passes ---


@pytest.mark.parametrize("bands", [46, *range(12, 60, 5)])
def test_passes_hold_every_band_in_fours_that_do_not_touch(bands):
    passes = band_passes(bands)
    assert {len(each) for each in passes} == {4}
    assert sorted({band for each in passes for band in each}) == list(range(bands))
    assert len(passes) == -(-bands // 4)
    for each in passes:
        assert np.diff(sorted(each)).min() >= 2  # or the flanks of two would overlap
    # Only the bands that fill up the last passes are there twice.
    assert sum(map(len, passes)) - bands < 4


def test_bands_are_inside_what_mitsuba_samples():
    nodes = [band_pulse(None, centre)[0] for centre in BAND_CENTRE_NM]
    assert np.diff(BAND_CENTRE_NM).tolist() == [BAND_WIDTH_NM] * 45
    assert min(each[0] for each in nodes) >= 360
    assert max(each[-1] for each in nodes) <= 830


def test_pulses_of_one_pass_are_disjoint():
    for each in band_passes():
        spans = sorted((band_pulse(None, BAND_CENTRE_NM[band])[0][[0, -1]] for band in each), key=lambda span: span[0])
        for (_, end), (start, _) in pairwise(spans):
            assert end <= start


# --- Pulses ---


@pytest.mark.parametrize("name", LAMPS)
def test_pulses_have_unit_area(name):
    for centre in BAND_CENTRE_NM:
        nodes, values, area = band_pulse(LAMPS[name], centre)
        assert values.min() >= 0
        assert np.trapezoid(values, nodes) == pytest.approx(1 if area else 0, abs=1e-12)


def test_flat_pulses_add_up_to_one():
    total = sum(pulse_at(None, centre)[0] for centre in BAND_CENTRE_NM)
    inside = (FINE_NM > 365.5) & (FINE_NM < 824.5)
    np.testing.assert_allclose(total[inside], 1, atol=1e-12)
    assert total[(FINE_NM < 364.5) | (FINE_NM > 825.5)].max() < 1e-12
    assert pulse_at(None, 550.0)[1] == pytest.approx(BAND_WIDTH_NM, rel=1e-12)


def test_lamp_shaped_pulses_add_up_to_the_lamp():
    lamp = LAMPS["rising"]
    total = sum(pulse_at(lamp, centre)[0] for centre in BAND_CENTRE_NM)
    inside = (FINE_NM > 365.5) & (FINE_NM < 824.5)
    # A straight lamp is met everywhere: the two flanks at a border are chords of one line.
    np.testing.assert_allclose(total[inside], np.interp(FINE_NM, LAMP_GRID_NM, lamp.radiance)[inside], rtol=1e-12)


@pytest.mark.parametrize("name", LAMPS)
def test_bands_hold_all_of_the_lamp(name):
    lamp = LAMPS[name]
    inside = (LAMP_GRID_NM >= 365) & (LAMP_GRID_NM <= 825)
    expected = np.trapezoid(lamp.radiance[inside], LAMP_GRID_NM[inside])
    assert (band_means(lamp) * BAND_WIDTH_NM).sum() == pytest.approx(expected, rel=1e-12)


def test_a_band_mean_is_the_lamps_mean():
    for lamp in LAMPS.values():
        for centre, mean in zip(BAND_CENTRE_NM, band_means(lamp), strict=True):
            inside = np.abs(LAMP_GRID_NM - centre) <= 5
            expected = np.trapezoid(lamp.radiance[inside], LAMP_GRID_NM[inside]) / 10
            assert mean == pytest.approx(expected, rel=1e-12, abs=1e-15)


# --- What is left out ---

BALL = '<shape type="sphere"><transform name="to_world"><scale value="0.01"/><translate z="0.5"/></transform></shape>'
OTHERS = {
    "a second shape": ("</scene>", f"{BALL}</scene>"),
    "a curved emitter": ('<shape type="rectangle"', '<shape type="cylinder"'),
    "a second emitter": ("</scene>", '<emitter type="constant"><texture type="d65" name="radiance"/></emitter></scene>'),
    "a point lamp": ("</scene>", '<emitter type="point"><texture type="d65" name="intensity"/></emitter></scene>'),
    "fog": (
        "</scene>",
        '<medium type="homogeneous" id="fog"><float name="scale" value="0.1"/></medium></scene>',
    ),
}


def plan_of(path, full: bool = False):
    scene = pixsim.load_scene(path, variant="scalar_spectral")
    state = scene.for_camera(scene.camera())
    return is_single_emitter(state), make_plan(scene, state, full)


@pytest.mark.parametrize("name", packaged_scenes())
def test_a_chart_alone_needs_one_pass(name):
    alone, plan = plan_of(name)
    assert alone
    assert plan.rank_one
    assert plan.passes == ()
    assert plan.lamp is not None
    alone, plan = plan_of(name, full=True)
    assert alone
    assert not plan.rank_one
    assert plan.passes == band_passes()


def test_a_disc_needs_one_pass(tmp_path):
    text = packaged_scenes()["flat"].read_text()
    (tmp_path / "disc.xml").write_text(text.replace('type="rectangle"', 'type="disk"'))
    (tmp_path / "charts").symlink_to(packaged_scenes()["flat"].parent / "charts")
    assert plan_of(tmp_path / "disc.xml")[1].rank_one


@pytest.mark.parametrize("other", OTHERS)
def test_anything_else_needs_every_band(tmp_path, other):
    text = packaged_scenes()["flat"].read_text()
    assert OTHERS[other][0] in text
    (tmp_path / "other.xml").write_text(text.replace(*OTHERS[other]))
    (tmp_path / "charts").symlink_to(packaged_scenes()["flat"].parent / "charts")
    alone, plan = plan_of(tmp_path / "other.xml")
    assert not alone
    assert not plan.rank_one
    assert plan.passes == band_passes()
