"""Arithmetic of the score, and memory of everything after the render."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from helpers.chains import imaging

from pixsim import optics
from pixsim.base import arrays
from pixsim.light.spectral import SpectralImage, d65
from pixsim.optics.camera import Camera
from pixsim.scene.charts import csf_value
from pixsim.sensor import integration
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import diffracted_rate, ideal_rate, integrate_pixels
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer import display as displays, evaluate as evaluating
from pixsim.viewer.chain import make_chain
from pixsim.viewer.delta_e_statistics import percentiles
from pixsim.viewer.display_options import Display
from pixsim.viewer.scene_light import SceneLight, prepare_scene
from pixsim.viewer.scielab import delta_e, filtered_lab
from pixsim.viewer.screen import white_header

NM = np.arange(400.0, 721.0, 10)
CAMERA = Camera(die_mm=2.7136)
COLOUR = {"pattern": "rggb", "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}


def chart(n: int, header: bool = True) -> SpectralImage:
    """The CSF chart under D65, at 1000 cd/m² behind f/4 or so."""
    at = (np.arange(n, dtype=np.float32) + 0.5) / n
    picture = csf_value(at, at[:, None]).astype(np.float32)
    message = {"luminance_cd_per_m2": 1000.0} if header else {}
    return SpectralImage(
        NM, 10.0, 2713.6 / n, factors=(6e-6 * d65(NM), picture[None]), header=message
    )


# --- What calls share ---


def test_evaluate_keeps_what_calls_share_and_sees_changed_light(monkeypatch):
    prepared = []
    chain_of = evaluating.make_chain
    monkeypatch.setattr(
        evaluating, "make_chain", lambda *given: prepared.append(given) or chain_of(*given)
    )
    evaluating._recent_chains.clear()
    light, pixel = chart(96), Pixel(pitch_um=28.0)
    settings = CAMERA, pixel, Exposure(), Display(dots=96)
    first = evaluating.evaluate(light, *settings, seed=1)
    first.ideal[:] = 0.0  # of the caller
    again, other = (
        evaluating.evaluate(chart(96), *settings, seed=1),
        evaluating.evaluate(light, *settings, seed=2),
    )
    assert len(prepared) == 1, "equal light in another object is the same light"
    assert again.mean_delta_e == first.mean_delta_e != other.mean_delta_e
    assert again.ideal.max() > 0.5
    light.factors[1][:] = light.factors[1][:, ::-1]  # in place: the same values elsewhere
    flipped = evaluating.evaluate(light, *settings, seed=1)
    assert len(prepared) == 2
    evaluating._recent_chains.clear()
    assert (
        evaluating.evaluate(light, *settings, seed=1).mean_delta_e
        == flipped.mean_delta_e
        != first.mean_delta_e
    )
    for number in range(2 * evaluating.MAX_CHAINS):
        evaluating.evaluate(
            light, CAMERA, pixel, Exposure(max_integration_s=0.01 * (number + 1)), Display(dots=96)
        )
    assert len(evaluating._recent_chains) == evaluating.MAX_CHAINS


# --- Percentiles ---


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(1).gamma(2, 1, (64, 47)),
        np.append(np.random.default_rng(2).uniform(0, 1, 5000), 1e9),  # all others in one bin
        np.repeat([0.0, 1.0, 2.0], [60, 35, 7]),
        np.zeros((5, 5)),
        np.array([[3.0]]),
        np.array([1e-300, 0.0]),
        np.array([1e308, 3.0, 1e307]),
    ],
)
def test_percentiles_match_numpy(values):
    percent = (0, 1.7, 50, 90, 99, 100)
    found = percentiles(values, percent)
    np.testing.assert_allclose(found, np.percentile(values, percent), rtol=1e-14)
    assert percentiles(values, percent, largest=float(values.max())) == found
    if values.max() < 1e30:
        single = values.astype(np.float32)
        np.testing.assert_allclose(
            percentiles(single, percent), np.percentile(single.astype(float), percent), rtol=1e-14
        )


# --- One way and another ---


def test_evaluate_matches_filtered_colour_images():
    """Computed through XYZ in three channels and two complete CIELAB pictures."""
    display = Display(dots=128)
    actual = evaluating.evaluate(chart(256), CAMERA, Pixel(pitch_um=15.0), display=display, seed=1)
    view = {"white_xyz": displays.WHITE_XYZ, "samples_per_deg": display.samples_per_deg}
    ideal, image = (
        filtered_lab(displays.to_xyz(item), **view) for item in (actual.ideal, actual.image)
    )
    np.testing.assert_allclose(
        actual.delta_e, np.sqrt(((ideal - image) ** 2).sum(axis=2)), rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(actual.delta_e, delta_e(ideal, image), rtol=0, atol=1e-10)


def test_prepare_scene_without_running_integral_is_equal(monkeypatch):
    asked = imaging(CAMERA, Pixel(pitch_um=15.0), display=Display(dots=128))
    light = prepare_scene(asked, SceneLight(chart(256)))
    kept = make_chain(asked, light).signal_e_per_s
    assert light.lights[0].running_integral is not None
    monkeypatch.setattr(integration, "MAX_STORED_SAMPLES", 256**2 - 1)
    light = prepare_scene(asked, SceneLight(chart(256)))
    assert light.lights[0].running_integral is None
    # 256² sums in another order.
    np.testing.assert_allclose(make_chain(asked, light).signal_e_per_s, kept, rtol=2e-12)


@pytest.mark.parametrize("bands", [0, 5])
def test_weighted_strips_match_whole(monkeypatch, bands):
    image = chart(40)
    if bands:
        image = SpectralImage(
            NM[:bands], 10.0, 1.0, data=np.random.default_rng(3).uniform(0, 1, (40, 30, bands))
        )
    monkeypatch.setattr("pixsim.light.spectral.STRIP_VALUES", 100)
    weight = np.random.default_rng(4).normal(size=image.wavelength_nm.size)
    exact = np.einsum("yxb,b->yx", image.data.astype(float), weight)
    actual = image.weighted(weight)
    # The bands of a factored image are rounded to float32 where they are asked for.
    np.testing.assert_allclose(
        actual, exact, rtol=0, atol=(1e-6 if not bands else 1e-14) * np.abs(exact).max()
    )


# --- Memory ---


def peak_planes(work, samples: int) -> float:
    """Memory that work takes at its peak, what it returns included, over that of a float64
    picture.
    """
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / (8 * samples)
    finally:
        tracemalloc.stop()


def test_memory_of_large_film_is_bounded(monkeypatch):
    """2048² and more must not need 2.5 planes besides the float32 picture; the result counts as one
    of them, or less.

    On one thread: each other one works on a strip of its own.
    """
    monkeypatch.setattr(arrays, "threads", lambda: 1)
    n, asked = 1536, imaging(CAMERA, Pixel(pitch_um=5.3), display=Display(dots=256))
    image, silent, physics = chart(n), chart(n, header=False), asked.physics
    light = prepare_scene(asked, SceneLight(image))
    rate = light.rate_e_per_s_um2
    grid, edges_um = (light.sample_pitch_um, 5.3, 3.0), light.screen.dot_edges_um
    works = {
        "project": (lambda: prepare_scene(asked, SceneLight(image)), 1.1, 1.6),
        "ideal_rate": (lambda: ideal_rate(image, physics), 1.0, 1.5),
        "diffraction": (lambda: diffracted_rate(image, CAMERA, physics), 1.0, 1.3),
        "pixels": (lambda: integrate_pixels(rate, *grid), 0.4, 0.8),
        "ideal image": (lambda: displays.ideal_luminance(asked, image, edges_um), 1.0, 1.6),
        "white": (lambda: white_header([(asked, silent)]), 1.0, 1.6),
        "fall-off": (lambda: optics.field_factor((n, n), 1.0, 4.0, 4.0, 0.0), 1.0, 1.3),
    }
    with pytest.warns(UserWarning, match="does not define its white"):
        actual = {name: peak_planes(work, n * n) for name, (work, _, _) in works.items()}
    wrong = {
        name: item for name, item in actual.items() if not works[name][1] <= item <= works[name][2]
    }
    assert not wrong, actual


def test_memory_of_many_bands_is_two_planes():
    n = 512
    data = np.ones((n, n, 7), np.float32)
    image = SpectralImage(NM[:7], 10.0, 2.65, data=data)
    physics = derive(Pixel())
    # Two planes, tables of 32768 frequencies and strips of an eighth of this plane.
    diffracted_rate(
        image, CAMERA, physics
    )  # fills the caches, whose tables count beside planes of this size
    assert 2.0 < peak_planes(lambda: diffracted_rate(image, CAMERA, physics), n * n) < 3.0
