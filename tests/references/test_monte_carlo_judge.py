"""Renders by different Mitsuba variants, and pruned and full ones, agree pixel by pixel in
Mitsuba's own test.

Source: the test of src/render/tests/test_renders.py (Mitsuba 3), which Eradiate uses too: p-values
of each pixel's difference, a significance of 0.01 with Šidák's correction for the number of pixels,
and 99.75 % of the pixels must pass. Variances are estimated on both sides, so the p-values are
those of Welch's t: a z-test with variances from 16 renders would reject too many. The test compares
pixsim's mean electrons of two sensors.

Gates:
* 99.75 to 100 % accepted, as in the source. Without a difference all pixels should be accepted
  (Šidák: one test in a hundred
  rejects one pixel of 1152).
* 1 to 12 % of the pixels at p < 0.05 without correction, where 5 % are expected. Fewer mean that
  the two are more alike than
  independent renders can be (one seed for both, or noise overestimated), more that many pixels
  differ a little. Two sensors
  share one render, and glints have heavy-tailed noise, so that the fraction scatters: 3 to 8 % over
  48 pairs of seeds.
* Each picture can fail: the test detects a scaling by 7 standard errors of a pixel, up or down (3 %
  for the chart, 1 % for the
  ColorChecker, 20 % for the still life, whose paths are noisy).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from tempfile import TemporaryDirectory
from warnings import catch_warnings

import numpy as np
import pytest
from helpers.edits import NEEDS_CARD, NEEDS_LLVM, VARIANT
from helpers.tiny import TINY
from references.gates import not_met, row
from scipy.stats import ttest_ind_from_stats

import pixsim
from pixsim.scene.plan import make_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.variants.variant import find_llvm
from pixsim.sensor.integration import ideal_rate
from pixsim.sensor.pixel import derive

SIGNIFICANCE, PASSING = 0.01, 0.9975
LIKELY = (0.01, 0.12)  # of the pixels at p < 0.05, where 0.05 is expected
FLOAT32 = 1e-5  # of the mean electrons: rounding in noiseless pixels
RENDERS, STUDIES = 16, 6
PIXELS = [pixsim.Pixel(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.8)]
HAS_LLVM = find_llvm()[0] is not None
# Samples, and a scaling that the test must detect: 7 standard errors of a pixel.
SCENES = {"csf": (16, 0.03), "macbeth": (4, 0.01), "still_life": (16, 0.2)}
LONG = {"still_life"}  # to compare between variants
LONG_IN_FULL = {"macbeth", "still_life"}  # to render without pruning
SIZE = 24


@cache
def renders(
    name: str, variant: str, full: bool = False, seed: int = 1, stops: float = 1.0
) -> np.ndarray:
    """Mean electrons of independent renders, (renders, pixels of the picture × sensors); stops: a
    factor on the f-number.
    """
    few = full and name != "still_life"  # its paths need 16
    scene = pixsim.load_scene(
        name, variant=variant, resolution=SIZE, spp=4 if few else SCENES[name][0]
    )
    camera = scene.camera()
    lens = camera.model_copy(update={"f_number": stops * camera.f_number})
    job = Renderer(scene, lens, make_plan(scene, full=full), seed)
    return np.array([
        np.concatenate([ideal_rate(image, derive(pixel)).ravel() for pixel in PIXELS])
        for image in (job.image(*job.run(index)) for index in range(RENDERS))
    ])  # fmt: skip


def p_values(one: np.ndarray, other: np.ndarray, bound: float = 0.0) -> np.ndarray:
    """p-values of each pixel's difference beyond a bound, by Welch's t-test."""
    means, deviations = zip(
        *((images.mean(axis=0), images.std(axis=0, ddof=1)) for images in (one, other)), strict=True
    )
    beyond = np.maximum(np.abs(means[0] - means[1]) - bound * means[1], 0.0)
    least = FLOAT32 * means[1] * len(one) ** 0.5
    return ttest_ind_from_stats(
        beyond,
        np.maximum(deviations[0], least),
        len(one),
        0.0,
        np.maximum(deviations[1], least),
        len(other),
        equal_var=False,
    ).pvalue


def passing(one: np.ndarray, other: np.ndarray, bound: float = 0.0) -> float:
    """Fraction of pixels whose difference, beyond a bound, is not significant."""
    alpha = 1 - (1 - SIGNIFICANCE) ** (1 / one.shape[1])
    return float(np.mean(p_values(one, other, bound) > alpha))


def unlikely(one: np.ndarray, other: np.ndarray) -> float:
    """Fraction of pixels at p < 0.05: 0.05 for independent renders of one picture."""
    return float(np.mean(p_values(one, other) < 0.05))


def assert_one_image(one: np.ndarray, other: np.ndarray) -> None:
    assert passing(one, other) >= PASSING
    assert LIKELY[0] <= unlikely(one, other) <= LIKELY[1]


def bound_of(name: str) -> float:
    """The plan's bound on the pruning error, relative to the mean electrons."""
    return make_plan(pixsim.load_scene(name, variant=VARIANT)).bound_e


def rows(full: bool = False, names: Iterable[str] = tuple(SCENES)) -> list[dict[str, object]]:
    table = []

    def compare(judge: str, one: np.ndarray, other: np.ndarray, bound: float = 0.0) -> None:
        form, test = "{:.4f}", "z-test per pixel, Šidák (Mitsuba 3)"
        table.append(row(f"{judge}: accepted", test, PASSING, 1, passing(one, other, bound), form))
        table.append(row(f"{judge}: at p < 0.05", test, *LIKELY, unlikely(one, other), form))

    for name in names:
        if HAS_LLVM and (full or name not in LONG):
            compare(
                f"`{name}`, LLVM and scalar",
                renders(name, "llvm_ad_spectral", seed=2),
                renders(name, VARIANT),
            )
        if full or name not in LONG_IN_FULL:
            whole = renders(name, VARIANT, full=True, seed=2)
            compare(f"`{name}`, pruned and full", renders(name, VARIANT), whole, bound_of(name))
    return table


def test_rows_of_chart_pass():
    assert not_met(rows(names=["csf"])) == []


@pytest.mark.parametrize(
    "full",
    [
        pytest.param(False, marks=pytest.mark.slow),
        pytest.param(True, marks=pytest.mark.judges_full),
    ],
)
def test_rows_pass(full):
    assert not_met(rows(full)) == []


def scenes(long: set[str]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        "name", [pytest.param(n, marks=pytest.mark.judges_full) if n in long else n for n in SCENES]
    )


@NEEDS_CARD
@scenes(LONG)
def test_cuda_variant_matches_scalar(name):
    """A card that cannot trace fails here: `pixsim doctor` says why."""
    assert_one_image(renders(name, "cuda_ad_spectral", seed=2), renders(name, VARIANT))


@cache
def studies(variant: str, first_seed: int) -> np.ndarray:
    """Mean ΔE of independent studies of a ColorChecker, (studies, pitches): renders, sensors and
    noise have own seeds.
    """
    table = {**TINY, "scene": {"file": "macbeth", "parameters": {"spp": 4}}, "resolution": 64}
    found = []
    for seed in range(first_seed, first_seed + STUDIES):
        with (
            TemporaryDirectory() as folder,
            catch_warnings(action="ignore"),
        ):  # its small film and few samples
            study = pixsim.study(
                pixsim.Study.model_validate(table | {"seed": seed}),
                f"{folder}/out",
                variant=variant,
                jobs=1,
            )
        found.append(study.curves[0].delta_e.mean(axis=1))
    return np.array(found)


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param("llvm_ad_spectral", marks=[NEEDS_LLVM, pytest.mark.judges_full]),
        pytest.param("cuda_ad_spectral", marks=NEEDS_CARD),
    ],
)
def test_study_matches_scalar(variant):
    """No size of pixels differs, by the test of the pictures; a sixth more error or less does at
    some size.
    """
    one, other = studies(variant, 1), studies(VARIANT, 1 + STUDIES)
    assert passing(one, other) == 1
    for wrong in (5 / 6, 7 / 6):
        assert passing(wrong * one, other) < 1


@scenes(LONG_IN_FULL)
def test_scaled_picture_fails(name):
    one, other, bound = (
        renders(name, VARIANT),
        renders(name, VARIANT, full=True, seed=2),
        bound_of(name),
    )
    for wrong in (1 + SCENES[name][1], 1 - SCENES[name][1]):
        assert passing(one * wrong, other, bound) < PASSING


def test_shifted_or_uniform_picture_fails():
    """A shift by one pixel, and a uniform picture of the same mean."""
    csf = renders("csf", VARIANT)
    shifted = np.roll(csf.reshape(RENDERS, -1, SIZE), 1, axis=2).reshape(csf.shape)
    assert passing(shifted, csf) < 0.9
    assert (
        passing(
            csf.mean(axis=1, keepdims=True) * np.random.default_rng(0).normal(1, 1e-3, csf.shape),
            csf,
        )
        < 0.9
    )


def test_other_f_number_fails():
    """f/4.1 gives 5 % less light than f/4."""
    for stops in (4.1 / 4, 3.9 / 4):
        assert passing(renders("csf", VARIANT, seed=2, stops=stops), renders("csf", VARIANT)) < 0.1


def test_same_seed_fails():
    csf = renders("csf", VARIANT)
    assert passing(csf, csf) == 1  # the first gate alone does not reject it
    assert unlikely(csf, csf) < LIKELY[0]


@pytest.mark.parametrize("name", ["csf", pytest.param("macbeth", marks=pytest.mark.slow)])
def test_independent_renders_pass(name):
    assert_one_image(renders(name, VARIANT, seed=3), renders(name, VARIANT))
