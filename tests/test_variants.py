"""Mitsuba's variants give one image, and so do pruned and full: pixel by pixel, as Mitsuba tests its own renders.

The test of src/render/tests/test_renders.py (Mitsuba 3): p-values of each pixel's difference, a significance of 0.01 with
Šidák's correction for the number of pixels, and 99.75 % of the pixels must pass. Variances are estimated on both sides, so
that the p-values are those of Welch's t.
"""

from __future__ import annotations

import ctypes.util
from functools import cache

import numpy as np
import pytest
from edits import VARIANT
from scipy.stats import ttest_ind_from_stats

import pixsim
from pixsim.pixel import derive
from pixsim.renderer import Renderer
from pixsim.sensor import ideal_rate
from pixsim.sensor_plan import make_plan
from pixsim.variant import find_llvm

SIGNIFICANCE, PASSING = 0.01, 0.9975
FLOAT32 = 1e-5  # of the mean electrons: rounding, where there is no noise
RENDERS = 16
PIXELS = [pixsim.Pixel(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.8)]
LLVM = pytest.param(
    "llvm_ad_spectral", marks=pytest.mark.skipif(find_llvm()[0] is None, reason="no LLVM 17 or newer here: scalar_spectral only")
)
CUDA = pytest.param(
    "cuda_ad_spectral",
    marks=pytest.mark.skipif(ctypes.util.find_library("cuda") is None, reason="no libcuda here: no NVIDIA driver, so no GPU"),
)
# Samples, and an error of the whole picture that the test must notice: 7 standard errors of a pixel.
SCENES = {"csf": (16, 0.03), "macbeth": (4, 0.01), "still_life": (16, 0.2)}
SIZE = 24


@cache
def renders(name: str, variant: str, full: bool = False, seed: int = 1) -> np.ndarray:
    """Mean electrons of independent renders, (renders, pixels of the picture × sensors)."""
    few = full and name != "still_life"  # its paths need 16
    scene = pixsim.load_scene(name, variant=variant, resolution=SIZE, spp=4 if few else SCENES[name][0])
    job = Renderer(scene, scene.camera(), make_plan(scene, full=full), seed)
    return np.array([
        np.concatenate([ideal_rate(image, derive(pixel)).ravel() for pixel in PIXELS])
        for image in (job.image(*job.run(index)) for index in range(RENDERS))
    ])  # fmt: skip


def passing(one: np.ndarray, other: np.ndarray, bound: float = 0.0) -> float:
    """Fraction of pixels whose difference, beyond a bound, is not significant."""
    means, deviations = zip(*((each.mean(axis=0), each.std(axis=0, ddof=1)) for each in (one, other)), strict=True)
    beyond = np.maximum(np.abs(means[0] - means[1]) - bound * means[1], 0.0)
    least = FLOAT32 * means[1] * len(one) ** 0.5
    p_value = ttest_ind_from_stats(
        beyond, np.maximum(deviations[0], least), len(one), 0.0, np.maximum(deviations[1], least), len(other), equal_var=False
    ).pvalue
    alpha = 1 - (1 - SIGNIFICANCE) ** (1 / one.shape[1])
    return float(np.mean(p_value > alpha))


def assert_one_image(name: str, one: np.ndarray, other: np.ndarray, bound: float = 0.0) -> None:
    assert passing(one, other, bound) >= PASSING
    for wrong in (1 + SCENES[name][1], 1 - SCENES[name][1]):
        assert passing(one * wrong, other, bound) < PASSING, "an error of the whole picture would not be noticed"


@pytest.mark.parametrize("variant", [LLVM, CUDA])
@pytest.mark.parametrize("name", [pytest.param(each, marks=pytest.mark.slow) if each == "still_life" else each for each in SCENES])
def test_variants_give_one_image(name, variant):
    if variant.startswith("cuda"):
        try:
            pixsim.load_scene(name, variant=variant).parse()
        except pixsim.PixsimError as error:
            pytest.skip(f"no GPU that Mitsuba can use: {error}")
    assert_one_image(name, renders(name, variant, seed=2), renders(name, VARIANT))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_pruned_and_full_give_one_image(name):
    bound = make_plan(pixsim.load_scene(name, variant=VARIANT)).bound_e
    assert_one_image(name, renders(name, VARIANT), renders(name, VARIANT, full=True, seed=2), bound)


def test_other_images_fail():
    """A shift by one pixel, and two scenes of the same mean."""
    csf = renders("csf", VARIANT)
    shifted = np.roll(csf.reshape(RENDERS, -1, SIZE), 1, axis=2).reshape(csf.shape)
    assert passing(shifted, csf) < 0.9
    assert passing(csf.mean(axis=1, keepdims=True) * np.random.default_rng(0).normal(1, 1e-3, csf.shape), csf) < 0.9


def test_independent_renders_of_one_scene_pass():
    for name in ("csf", "macbeth"):
        assert passing(renders(name, VARIANT, seed=3), renders(name, VARIANT)) >= PASSING
