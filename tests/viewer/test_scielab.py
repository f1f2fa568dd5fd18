"""S-CIELAB: filters by a second way, invariants and limits. Closed forms stand in
test_closed_forms.py, the authors' maps in tests/references/test_scielab_judge.py.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import scipy.ndimage
from hypothesis import example, given, settings, strategies as st

from pixsim.base import arrays
from pixsim.viewer import scielab

D65 = np.array([95.047, 100.0, 108.883])
FILTERS = ["published", "zhang1996"]
FORMULAS = ["1976", "1994", "2000"]
VIEW = {"white_xyz": D65, "samples_per_deg": 23.0}
pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(autouse=True, scope="module")
def colour_is_imported() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its import
        import colour  # noqa: F401


def picture(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    """Return XYZ (H, W, 3) of 2 to 120 % of white, whole numbers."""
    return np.rint(np.random.default_rng(seed).uniform(0.02, 1.2, (*shape, 3)) * D65)


def xyz_of_lab(lab: np.ndarray) -> np.ndarray:
    """Return the inverse of CIELAB (CIE 15)."""
    fy = (lab[..., 0] + 16) / 116
    f = np.stack([fy + lab[..., 1] / 500, fy, fy - lab[..., 2] / 200], axis=-1)
    return D65 * np.where(f > 6 / 29, f**3, (f - 4 / 29) * 108 / 841)


@pytest.mark.parametrize("shape", [(64, 48), (5, 9)])  # larger and smaller than 23 taps
def test_filters_of_1996_are_convolutions(shape: tuple[int, int]) -> None:
    xyz = picture(shape)
    opponent = np.einsum("ij,yxj->iyx", scielab.OPPONENT_FROM_XYZ, xyz)
    for plane, gaussians in zip(opponent, scielab.ZHANG1996_GAUSSIANS, strict=True):
        blurred = np.zeros(shape)
        for weight, width_deg in gaussians:
            kernel = scielab.zhang1996_kernel(width_deg, 23)
            along_y = scipy.ndimage.correlate1d(plane, kernel, axis=0, mode="reflect")
            along_x = scipy.ndimage.correlate1d(along_y, kernel, axis=1, mode="reflect")
            blurred += weight * along_x
        plane[:] = blurred
    expected = np.einsum("ij,jyx->yxi", np.linalg.inv(scielab.OPPONENT_FROM_XYZ), opponent)
    lab = scielab.filtered_lab(xyz, **VIEW, filters="zhang1996")
    np.testing.assert_allclose(xyz_of_lab(lab), expected, rtol=0, atol=1e-10)


def test_opponent_filters_are_band_pass_and_low_pass() -> None:
    """Light and dark peak at (0.921 + 0.105)/0.918 = 1.118, where the wide negative Gaussian is
    gone.
    """
    view = scielab.ViewingConditions.of(D65, 60.0, "published")
    transfer = scielab.filter_transfer(view, 1, 4096)[:, 0]
    assert transfer[0].max() == pytest.approx(1.118, abs=0.01)
    np.testing.assert_allclose(transfer[:, 0], 1.0, rtol=1e-12)
    assert np.all(np.diff(transfer[1:], axis=1) <= 0), "colours fall with frequency"


@pytest.mark.parametrize("filters", FILTERS)
def test_maps_in_strips_are_the_difference_of_whole_pictures(
    monkeypatch: pytest.MonkeyPatch, filters: Any
) -> None:
    """Dark and negative light too, in strips of one row; to rounding."""
    first, second = np.random.default_rng(12).uniform(0, 1, (2, 20, 13)) ** 4
    second[:4] -= 0.01
    view = VIEW | {"filters": filters}
    reference = scielab.filtered_lab(first[..., None] * D65, **view)
    test = scielab.filtered_lab(second[..., None] * D65, **view)
    expected = np.sqrt(((reference - test) ** 2).sum(axis=-1))
    monkeypatch.setattr(scielab, "STRIP_DOTS", 13)
    grey = scielab.grey_delta_e_map(reference, second, **view)
    np.testing.assert_allclose(grey, expected, rtol=0, atol=1e-10)
    coloured = scielab.colour_delta_e_map(reference, second[..., None] * D65, **view)
    np.testing.assert_allclose(coloured, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(scielab.delta_e(reference, test), expected, rtol=0, atol=1e-12)


# --- invariants


REPEATABLE = settings(derandomize=True, database=None, deadline=None, max_examples=15)


@REPEATABLE
@example(seed=0, exponent=-1060, filters="published", formula="1976")
@example(seed=0, exponent=1010, filters="published", formula="1976")
@given(
    seed=st.integers(0, 99),
    exponent=st.integers(-1060, 1010),
    filters=st.sampled_from(FILTERS),
    formula=st.sampled_from(FORMULAS),
)
def test_delta_e_does_not_depend_on_the_unit(
    seed: int, exponent: int, filters: Any, formula: Any
) -> None:
    """Bit for bit, from the least to the largest numbers."""
    pair = picture((5, 7), seed), picture((5, 7), seed + 1)
    white = np.array([95.0, 100.0, 109.0])
    view = {"samples_per_deg": 23.0, "filters": filters, "formula": formula}
    unit = 2.0**exponent
    scaled = scielab.delta_e_map(*(unit * xyz for xyz in pair), white_xyz=unit * white, **view)
    np.testing.assert_array_equal(scaled, scielab.delta_e_map(*pair, white_xyz=white, **view))


@REPEATABLE
@given(seed=st.integers(0, 99), filters=st.sampled_from(FILTERS), turns=st.integers(1, 3))
def test_maps_turn_with_the_pictures(seed: int, filters: Any, turns: int) -> None:
    pair = picture((20, 33), seed), picture((20, 33), seed + 1)
    upright = scielab.delta_e_map(*pair, **VIEW, filters=filters)
    turned = scielab.delta_e_map(*(np.rot90(xyz, turns) for xyz in pair), **VIEW, filters=filters)
    np.testing.assert_allclose(turned, np.rot90(upright, turns), rtol=0, atol=1e-10)


@REPEATABLE
@given(seed=st.integers(0, 99), samples_per_deg=st.floats(0.5, 400))
def test_the_eye_conserves_the_mean(seed: int, samples_per_deg: float) -> None:
    """XYZ in the mean over a picture, before and behind the published filters."""
    xyz = picture((24, 17), seed) + 5
    lab = scielab.filtered_lab(xyz, white_xyz=D65, samples_per_deg=samples_per_deg)
    behind = xyz_of_lab(lab).mean(axis=(0, 1))
    np.testing.assert_allclose(behind, xyz.mean(axis=(0, 1)), rtol=1e-12)


def test_noise_around_black_has_zero_mean() -> None:
    """Nothing is clipped: clipping at 0 would add 903.3 · 1e-3/√2π = 0.36 to L*."""
    noise = np.random.default_rng(0).normal(0, 1e-3, (64, 64, 3)) * D65
    noise -= noise.mean(axis=(0, 1))
    lightness = scielab.filtered_lab(noise, **VIEW)[..., 0]
    assert lightness.min() < -0.1
    assert lightness.mean() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_threads_change_no_bit(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    xyz = picture((257, 130))
    monkeypatch.setattr(arrays, "threads", lambda: 1)
    expected = scielab.filtered_lab(xyz, **VIEW)
    monkeypatch.setattr(arrays, "threads", lambda: count)
    np.testing.assert_array_equal(scielab.filtered_lab(xyz, **VIEW), expected)


# --- limits


@pytest.mark.parametrize("formula", FORMULAS)
def test_cielab_is_continuous_at_its_threshold(formula: Any) -> None:
    """Equal steps of luminance, 5e-8 of the threshold, make equal steps of L* across it."""
    levels = 216 / 24389 * (1 + np.linspace(-1e-6, 1e-6, 41))
    lab = scielab.xyz_to_lab(levels[:, None] * D65, D65)
    steps = scielab.delta_e(lab[:-1], lab[1:], formula)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-4)


@pytest.mark.parametrize("chroma", [1e-9, 1.0, 20.0])
def test_ciede2000_of_opposite_hues_is_symmetric(chroma: float) -> None:
    """There the mean hue jumps by 180° (Sharma, Wu & Dalal 2005), whatever the order. Near grey it
    is at most 1.5 times the distance.
    """
    first = np.array([50.0, 0.6 * chroma, 0.8 * chroma])
    second = first * [1, -1, -1]
    delta_e = scielab.delta_e(first, second, "2000")
    assert delta_e == scielab.delta_e(second, first, "2000")
    assert 0 < delta_e <= 2 * 1.5 * chroma
