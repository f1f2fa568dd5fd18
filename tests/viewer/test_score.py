"""Scores: what calls share, statistics, one way and another, and the memory of large films."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain
from hypothesis import given, settings, strategies as st

import pixsim
from pixsim import Camera, Display, Exposure, Motion, Pixel, PixsimError, SpectralImage
from pixsim.base import arrays
from pixsim.light.spectral import d65
from pixsim.scene.charts import csf_value
from pixsim.sensor.integration import diffracted_rate, ideal_rate, integrate_pixels
from pixsim.viewer import display as displays, evaluate as evaluating
from pixsim.viewer.delta_e_statistics import percentiles
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.scene_light import RecentScenes, SceneCache, SceneLight, prepare_scene
from pixsim.viewer.scielab import delta_e, filtered_lab

NM = np.arange(400.0, 721.0, 10)
CAMERA = Camera(die_mm=2.7136)
DISPLAY = Display(dots=96)
COLOUR = {"pattern": "rggb", "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}


def chart(count: int, **header: Any) -> SpectralImage:
    """Return the CSF chart under D65, at 1000 cd/m² behind f/4 or so."""
    place = (np.arange(count, dtype=np.float32) + 0.5) / count
    picture = csf_value(place, place[:, None]).astype(np.float32)
    factors = 6e-6 * d65(NM), picture[None]
    header = header or {"luminance_cd_per_m2": 1000.0}
    return SpectralImage(NM, 10.0, 2713.6 / count, factors=factors, header=header)


# --- what calls share


def test_evaluate_shares_light_and_sees_changes_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal light in another object is the same light; a caller's changes of a score or a light
    reach no other call.
    """
    chains = []
    make_chain = evaluating.make_chain
    monkeypatch.setattr(
        evaluating, "make_chain", lambda *args: chains.append(args) or make_chain(*args)
    )
    evaluating._recent_chains.clear()
    image = chart(96)
    call = {"camera": CAMERA, "pixel": Pixel(pitch_um=28.0), "display": DISPLAY}
    first = evaluating.evaluate(image, **call, seed=1)
    first.ideal[:] = 0.0
    again = evaluating.evaluate(chart(96), **call, seed=1)
    other = evaluating.evaluate(image, **call, seed=2)
    assert len(chains) == 1
    assert again.mean_delta_e == first.mean_delta_e != other.mean_delta_e
    assert again.ideal.max() > 0.5
    assert image.factors is not None
    image.factors[1][:] = image.factors[1][:, ::-1]
    flipped = evaluating.evaluate(image, **call, seed=1)
    assert len(chains) == 2
    assert flipped.mean_delta_e != first.mean_delta_e
    for number in range(evaluating.MAX_CHAINS + 1):
        exposure = Exposure(max_integration_s=0.01 * (number + 1))
        evaluating.evaluate(image, **call, exposure=exposure)
    assert len(evaluating._recent_chains) == evaluating.MAX_CHAINS


def test_caches_of_scenes_return_what_is_prepared() -> None:
    """A cache per light and one of recent scenes; displays that differ in the viewer alone share an
    ideal picture.
    """
    settings = imaging(CAMERA, Pixel(pitch_um=28.0), display=DISPLAY)
    light = SceneLight(chart(96))
    farther = DISPLAY.model_copy(update={"samples_per_deg": 46.0})
    cache = SceneCache(settings, light, others=[farther])
    scene = cache.get("pixel", settings)
    assert cache.get("pixel", settings) is scene
    near, far = scene.screens
    assert far.ideal is near.ideal
    expected = prepare_scene(settings.changed(display=farther), light).screen.ideal_lab
    np.testing.assert_array_equal(far.ideal_lab, expected)
    assert cache.ideal_facts("pixel", settings) == cache.ideal_facts("other", settings)
    # Two planes of light and spline, and four of the ideal picture and its CIELAB, of 8 bytes.
    assert cache.capacity == 2**28 // (8 * (2 * 96**2 + 4 * 2 * 96**2))

    recent = RecentScenes()
    scenes = [recent(settings, light) for _ in range(2)]
    assert scenes[0] is scenes[1]
    other = recent(settings.changed(display=farther), light)
    assert other is not scenes[0]
    assert other.lights is scenes[0].lights
    recent.drop_all_but([])
    assert recent(settings, light) is not scenes[0]


# --- statistics


@settings(derandomize=True, database=None, deadline=None, max_examples=25)
@given(
    values=st.lists(st.floats(0, 1e30, allow_subnormal=False), min_size=1, max_size=50),
    count=st.sampled_from([1, 100]),
)
def test_percentiles_are_those_of_numpy(values: list[float], count: int) -> None:
    """Also of many equal values, and of one that is far above all others."""
    array = np.repeat(np.array(values), count)
    percent = (0, 1.7, 50, 90, 99, 100)
    np.testing.assert_allclose(percentiles(array, percent), np.percentile(array, percent), 1e-14)


# --- one way and another


@pytest.mark.parametrize("formula", ["1976", "2000"])
@pytest.mark.parametrize("colour", [None, COLOUR])
def test_score_is_the_difference_of_two_cielab_pictures(formula: Any, colour: Any) -> None:
    """Through XYZ in three channels; without shortcuts the score is the same to rounding."""
    display = DISPLAY.model_copy(update={"delta_e": formula})
    call = {"camera": CAMERA, "pixel": Pixel(pitch_um=28.0, colour=colour), "display": display}
    score = evaluating.evaluate(chart(96), **call)
    view = {"white_xyz": displays.WHITE_XYZ, "samples_per_deg": display.samples_per_deg}
    to_xyz = displays.to_xyz if colour is None else displays.rgb_to_xyz
    labs = [filtered_lab(to_xyz(picture), **view) for picture in (score.ideal, score.image)]
    np.testing.assert_allclose(score.delta_e, delta_e(*labs, formula), atol=1e-9)
    full = evaluating.evaluate(chart(96), **call, full=True)
    np.testing.assert_allclose(full.delta_e, score.delta_e, atol=1e-9)


@pytest.mark.parametrize(
    ("colour", "fields"),
    [(None, {}), (None, {"raster": "one_to_one", "filters": "zhang1996"}), (COLOUR, {"bits": 3})],
)
def test_pictures_of_a_score_have_its_difference_bit_for_bit(colour: Any, fields: Any) -> None:
    """Codes of codes are the same."""
    display = DISPLAY.model_copy(update=fields)
    score = evaluating.evaluate(
        chart(96), CAMERA, Pixel(pitch_um=28.0, colour=colour), display=display
    )
    again = pixsim.score_pictures(score.ideal, score.image, score.display)
    np.testing.assert_array_equal(again.delta_e, score.delta_e)
    np.testing.assert_array_equal(again.image, score.image)
    columns = DELTA_E.columns
    assert again.statistics() == {name: score.statistics()[name] for name in columns}


def test_pictures_are_rounded_and_clipped_to_the_display() -> None:
    """2 bits at γ = 1: light of 0, 1/3, 2/3 and 1; grey differs as equal primaries do."""
    picture = np.repeat([[-0.5, 0.1, 0.4, 0.6, 0.995, 1.004]], 4, axis=0)
    display = Display(bits=2, gamma=1.0)
    with pytest.warns(UserWarning, match="17 % of the ideal image is brighter than display white"):
        score = pixsim.score_pictures(picture, picture[:, ::-1], display)
    np.testing.assert_allclose(score.ideal[0], [0, 0, 1 / 3, 2 / 3, 1, 1], atol=1e-15)
    pair = [np.repeat(grey[..., None], 3, axis=2) for grey in (score.ideal, score.image)]
    coloured = pixsim.score_pictures(*pair, display)
    np.testing.assert_allclose(coloured.delta_e, score.delta_e, atol=1e-9)


@pytest.mark.parametrize(("share", "is_refused"), [(0.999, False), (1.001, True)])
@pytest.mark.parametrize("axis", [0, 1])
def test_motion_takes_the_margin_on_both_sides(axis: int, share: float, is_refused: bool) -> None:
    """The longest path is twice the room between the scored dots and the border of the pixels."""
    call = {"pixel": Pixel(pitch_um=28.0), "exposure": Exposure(integration_s=0.01)}
    still = imaging_chain(chart(96), CAMERA, display=DISPLAY, border_um=100.0, **call)
    room_um = float(still.screen.dot_edges_um[axis][0]) - still.readout.physics.border_um
    speed = 2 * room_um * share / 0.01
    velocity = (0.0, speed) if axis == 0 else (speed, 0.0)
    moving = {"border_um": 100.0, "motion": Motion(image_um_per_s=velocity)}
    with pytest.raises(PixsimError, match="motion: got") if is_refused else nullcontext():
        imaging_chain(chart(96), CAMERA, display=DISPLAY, **call, **moving)


# --- memory


def peak_planes(work: Callable[[], object], samples: int) -> float:
    """Return the peak of memory, with the result, over that of a float64 picture."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / (8 * samples)
    finally:
        tracemalloc.stop()


def test_memory_of_a_large_film_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 1.7 planes besides the float32 picture, on one thread; of many bands two and tables."""
    monkeypatch.setattr(arrays, "threads", lambda: 1)
    count = 1536
    settings = imaging(CAMERA, Pixel(pitch_um=5.3), display=Display(dots=256))
    image = chart(count)
    light = prepare_scene(settings, SceneLight(image))
    rate = light.rate_e_per_s_um2
    edges_um = light.screen.dot_edges_um
    works: dict[str, tuple[Callable[[], object], float]] = {
        "scene": (lambda: prepare_scene(settings, SceneLight(image)), 1.7),
        "ideal rate": (lambda: ideal_rate(image, settings.physics), 1.5),
        "diffraction": (lambda: diffracted_rate(image, CAMERA, settings.physics), 1.4),
        "pixels": (lambda: integrate_pixels(rate, light.sample_pitch_um, 5.3, 3.0), 0.9),
        "ideal": (lambda: displays.ideal_luminance(settings, image, edges_um), 1.7),
    }
    peaks = {name: peak_planes(work, count**2) for name, (work, _) in works.items()}
    too_large = {name: peak for name, peak in peaks.items() if peak > works[name][1]}
    assert not too_large, peaks
