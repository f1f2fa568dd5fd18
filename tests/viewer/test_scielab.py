"""S-CIELAB: limits, closed forms, conservation. Numbers from outside:
tests/references/test_scielab_judge.py.
"""

from __future__ import annotations

import tracemalloc
import warnings

import numpy as np
import pytest
import scipy.ndimage

import pixsim
from pixsim.base import arrays
from pixsim.base.errors import PixsimError
from pixsim.verification import extreme_cases
from pixsim.verification.case import KnownAnswer
from pixsim.viewer import scielab

D65 = np.array([95.047, 100.0, 108.883])
FILTERS = ["published", "zhang1996"]
FORMULAS = ["1976", "1994", "2000"]
VIEW = {"white_xyz": D65, "samples_per_deg": 23.0}
pytestmark = pytest.mark.filterwarnings("error")


def xyz_from_lab(lab: np.ndarray) -> np.ndarray:
    """The inverse of CIELAB written a second time, from CIE 15, to undo it in tests."""
    fy = (lab[..., 0] + 16) / 116
    f = np.stack([fy + lab[..., 1] / 500, fy, fy - lab[..., 2] / 200], axis=-1)
    return D65 * np.where(f > 6 / 29, f**3, (f - 4 / 29) * 108 / 841)


def bright_image(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.02, 1.2, (*shape, 3)) * D65


def random_image(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(5, 90, (*shape, 3))


# --- The filter of the first public code, 1996, by a second way ---


@pytest.mark.parametrize(
    "shape", [(64, 48), (5, 9)]
)  # larger and smaller than the kernel of 23 taps
def test_filtered_lab_zhang1996_matches_convolution(shape):
    image = random_image(shape)
    opponent = np.einsum("ij,yxj->iyx", scielab.OPPONENT_FROM_XYZ, image)
    for plane, gaussians in zip(opponent, scielab.ZHANG1996_GAUSSIANS, strict=True):
        blurred = np.zeros(shape)
        for weight, width_deg in gaussians:
            kernel = scielab.zhang1996_kernel(width_deg, 23)
            in_y = scipy.ndimage.correlate1d(plane, kernel, axis=0, mode="reflect")
            blurred += weight * scipy.ndimage.correlate1d(in_y, kernel, axis=1, mode="reflect")
        plane[:] = blurred
    expected = np.einsum("ij,jyx->yxi", np.linalg.inv(scielab.OPPONENT_FROM_XYZ), opponent)
    lab = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=23, filters="zhang1996")
    # Two ways to the same sums; xyz_from_lab has CIE's constants, but no sample here is dark enough
    # to use them.
    np.testing.assert_allclose(xyz_from_lab(lab), expected, rtol=0, atol=1e-10)


# --- Grey images ---


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize(
    ("shape", "samples_per_deg"), [((48, 64), 23.0), ((5, 9), 30.0), ((1, 1), 60.0)]
)
@pytest.mark.parametrize("white", [D65, D65 * 3.2, np.array([110.0, 100.0, 35.0])])
def test_filtered_grey_lab_matches_filtered_lab(filters, shape, samples_per_deg, white):
    grey = np.random.default_rng(2).uniform(-0.02, 1.3, shape)
    grey.flat[0] = 0.0
    view = {"white_xyz": white, "samples_per_deg": samples_per_deg, "filters": filters}
    actual = scielab.filtered_grey_lab(grey, **view)
    whole = scielab.filtered_lab(grey[..., None] * white, **view)
    assert actual.shape == (*shape, 3)
    # The same transform, once instead of three times: roundings of Lab's 100, amplified by the
    # slope at black (903).
    np.testing.assert_allclose(actual, whole, rtol=0, atol=1e-10)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize(
    "luminance",
    [
        np.ones(3),
        np.ones((2, 2, 3)),
        np.ones((0, 4)),
        np.array([[1.0, np.nan]]),
        np.array([[np.inf, -np.inf], [0.0, 1.0]]),
    ],
)
def test_filtered_grey_lab_invalid_luminance_raises(luminance, single):
    with pytest.raises(
        PixsimError, match=r"luminance: got .*; allowed: (\(H, W\), not empty|.*numbers from)"
    ):
        pixsim.scielab.filtered_grey_lab(luminance, single=single, **VIEW)


# --- The published filter: closed forms, limits, conservation ---


def test_filter_transfer_is_band_pass_and_low_pass():
    filter_transfer = scielab.filter_transfer(
        scielab.ViewingConditions.of(D65, 60.0, "published"), 1, 4096
    )[:, 0]
    assert filter_transfer[0].argmax() > 0
    assert (
        1.1 < filter_transfer[0].max() < 1.2
    )  # (.921 + .105) / .918 where the wide negative Gaussian is gone: 1.118
    assert np.all(np.diff(filter_transfer[1:], axis=1) <= 0)


@pytest.mark.parametrize("samples_per_deg", [5.0, 23.0, 60.0, 400.0])
def test_filtered_lab_published_conserves_mean(samples_per_deg):
    image = random_image((40, 56))
    lab = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=samples_per_deg)
    np.testing.assert_allclose(
        xyz_from_lab(lab).mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-12
    )


@pytest.mark.parametrize("filters", FILTERS)
def test_delta_e_map_rotates_with_images(filters):
    reference, test = random_image((20, 33), 1), random_image((20, 33), 2)
    actual = scielab.delta_e_map(reference, test, **VIEW, filters=filters)
    turned = scielab.delta_e_map(np.rot90(reference), np.rot90(test), **VIEW, filters=filters)
    np.testing.assert_allclose(turned, np.rot90(actual), rtol=0, atol=1e-10)


@pytest.mark.parametrize("count", [2, 3])
def test_filtered_lab_is_independent_of_threads(count, monkeypatch):
    image = random_image((257, 130))
    monkeypatch.setattr(arrays, "threads", lambda: 1)
    expected = scielab.filtered_lab(image, **VIEW)
    monkeypatch.setattr(arrays, "threads", lambda: count)
    assert np.array_equal(scielab.filtered_lab(image, **VIEW), expected)


# --- Differences ---


def test_delta_e_1994_closed_form():
    # Reference chroma 10 along a*: ΔL 1, ΔC 2, ΔH 0 give √(1 + (2 / 1.45)²); seen from the other, 2
    # / 1.54.
    reference, test = [[50.0, 10.0, 0.0]], [[51.0, 12.0, 0.0]]
    np.testing.assert_allclose(
        scielab.delta_e(reference, test, "1994"), np.hypot(1, 2 / 1.45), rtol=1e-12
    )
    np.testing.assert_allclose(
        scielab.delta_e(test, reference, "1994"), np.hypot(1, 2 / 1.54), rtol=1e-12
    )


def test_delta_e_ignores_colour_domain_scale():
    import colour

    reference, test = [[50.0, 10.0, 0.0]], [[51.0, 12.0, 3.0]]
    expected = scielab.delta_e(reference, test, "2000")
    with colour.domain_range_scale("1"):
        assert np.array_equal(scielab.delta_e(reference, test, "2000"), expected)


# --- Edges of what can be asked ---


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_filtered_lab_accepts_other_dtypes(dtype):
    image = np.round(random_image((8, 9)))
    assert np.array_equal(
        scielab.filtered_lab(image.astype(dtype), **VIEW), scielab.filtered_lab(image, **VIEW)
    )


def test_delta_e_map_keeps_inputs():
    reference, test = random_image((8, 9), 1), random_image((8, 9), 2)
    kept = reference.copy(), test.copy()
    scielab.delta_e_map(reference, test, **VIEW)
    np.testing.assert_array_equal((reference, test), kept)


GOOD = {"reference_xyz": np.ones((4, 5, 3)), "test_xyz": np.ones((4, 5, 3)), **VIEW}
SPOILT = np.ones((4, 5, 3))
SPOILT[2, 3, 1] = np.nan


@pytest.mark.parametrize(
    ("wrong", "parts"),
    [
        (
            {"test_xyz": np.ones((5, 4, 3))},
            ["reference_xyz and test_xyz", "(4, 5, 3)", "(5, 4, 3)"],
        ),
        ({"reference_xyz": np.ones((4, 5))}, ["reference_xyz", "(4, 5)", "(H, W, 3)"]),
        ({"test_xyz": np.ones((3, 4, 5))}, ["test_xyz", "(3, 4, 5)", "(H, W, 3)"]),
        ({"test_xyz": np.ones((0, 5, 3))}, ["test_xyz", "(0, 5, 3)", "empty"]),
        ({"test_xyz": SPOILT}, ["test_xyz", "nan", "[2, 3, 1]"]),
        ({"reference_xyz": np.full((4, 5, 3), np.inf)}, ["reference_xyz", "inf", "[0, 0, 0]"]),
        ({"white_xyz": [95.0, 0.0, 108.0]}, ["white_xyz", "0.0 at [1]", "above 0"]),
        ({"white_xyz": [95.0, np.nan, 108.0]}, ["white_xyz", "nan"]),
        ({"white_xyz": 100.0}, ["white_xyz", "100.0", "three"]),
        ({"samples_per_deg": 0}, ["samples_per_deg", "0", "above 0"]),
        ({"samples_per_deg": -23.0}, ["samples_per_deg", "-23.0"]),
        ({"samples_per_deg": np.inf}, ["samples_per_deg", "inf", "to 1e+30"]),
        ({"samples_per_deg": np.nan}, ["samples_per_deg", "nan", "to 1e+30"]),
        ({"filters": "isetcam"}, ["filters", "'isetcam'", "'published'", "'zhang1996'"]),
        ({"formula": 1976}, ["formula", "1976", "'1976'", "'1994'", "'2000'"]),
    ],
)
def test_delta_e_map_invalid_input_raises(wrong, parts):
    pixsim.delta_e_map(**GOOD)
    with pytest.raises(PixsimError) as error:
        pixsim.delta_e_map(**{**GOOD, **wrong})
    assert isinstance(error.value, ValueError)
    assert [part for part in parts if part not in str(error.value)] == []


def test_delta_e_broadcast_shapes_raise():
    with pytest.raises(PixsimError, match=r"lab_reference and lab_test.*\(1, 3\).*\(2, 3\)"):
        scielab.delta_e(np.zeros((1, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("filters", ["published", "zhang1996"])
def test_grey_delta_e_map_strips_match_whole(monkeypatch, filters):
    """Dark samples and bright ones, in strips of one row: the same as pictures in three channels,
    whole.
    """
    rng = np.random.default_rng(12)
    first, second = rng.uniform(0, 1, (2, 20, 13)) ** 4
    second[:4] -= 0.01
    view = {"white_xyz": D65, "samples_per_deg": 23.0, "filters": filters}
    reference = scielab.filtered_lab(first[..., None] * D65, **view)
    seen = scielab.filtered_lab(second[..., None] * D65, **view)
    expected = np.sqrt(((reference - seen) ** 2).sum(axis=-1))
    monkeypatch.setattr(scielab, "STRIP_DOTS", 13)
    np.testing.assert_array_equal(scielab.filtered_lab(first[..., None] * D65, **view), reference)
    actual = scielab.grey_delta_e_map(reference, second, **view)
    assert (seen[..., 0] < 8).any()  # on CIELAB's straight line
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(scielab.delta_e(reference, seen), expected, rtol=0, atol=1e-12)


def test_grey_delta_e_map_invalid_reference_raises():
    wrong = np.zeros((2, 3, 3))
    with pytest.raises(
        PixsimError, match=r"reference_lab, shape: got \(2, 3, 3\); allowed: \(3, 2, 3\)"
    ):
        pixsim.scielab.grey_delta_e_map(wrong, np.zeros((3, 2)), **VIEW)
    wrong[1, 2, 0] = np.nan
    with pytest.raises(PixsimError, match=r"reference_lab: got nan at \[1, 2, 0\]"):
        pixsim.scielab.grey_delta_e_map(wrong, np.zeros((2, 3)), **VIEW)


# --- Extremes beyond the table of extreme cases, and that its gates can fail ---


@pytest.fixture(autouse=True, scope="module")
def colour_has_been_imported() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what its import warns of is not ours to test
        import colour  # noqa: F401


@pytest.mark.parametrize("samples_per_deg", [1e-3, 0.5, 223.0, 225.0, 2000.0, 1e5, 1e6])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize(("shape", "formula"), [((1, 5), "2000"), ((6, 4), "1994")])
def test_delta_e_map_any_density_is_finite_in_little_memory(
    samples_per_deg, filters, formula, shape
):
    """A kernel spans a degree, 1e6 samples at most: six arrays of it are 48 MB, and what it takes
    does not grow otherwise.
    """
    tracemalloc.start()
    view = {
        "white_xyz": D65,
        "samples_per_deg": samples_per_deg,
        "filters": filters,
        "formula": formula,
    }
    try:
        actual = scielab.delta_e_map(bright_image(shape, 1), bright_image(shape, 2), **view)
        assert tracemalloc.get_traced_memory()[1] < 64e6
    finally:
        tracemalloc.stop()
    assert actual.shape == shape
    assert np.all(np.isfinite(actual))


@pytest.mark.parametrize("samples_per_deg", [1e-30, 1e150, 1e160, 1e308])
def test_filtered_lab_published_extreme_densities(samples_per_deg):
    picture = bright_image((6, 4))
    actual = scielab.filtered_lab(picture, white_xyz=D65, samples_per_deg=samples_per_deg)
    seen = (
        picture
        if samples_per_deg < 1
        else np.broadcast_to(picture.mean(axis=(0, 1)), picture.shape)
    )
    np.testing.assert_allclose(actual, scielab.xyz_to_lab(seen, D65), rtol=0, atol=1e-11)


@pytest.mark.parametrize("samples_per_deg", [1e-30, 1e-7, 1e9, 1e300])
def test_filtered_lab_zhang1996_extreme_density_raises(samples_per_deg):
    with pytest.raises(
        PixsimError, match=r"samples_per_deg: got .*allowed: 1e-06 to 1e\+06 for 'zhang1996'"
    ):
        scielab.filtered_lab(
            bright_image((6, 4)),
            white_xyz=D65,
            samples_per_deg=samples_per_deg,
            filters="zhang1996",
        )


@pytest.mark.parametrize("unit", [2.0**-1060, 2.0**-500, 2.0**500, 2.0**1010])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
def test_delta_e_map_is_independent_of_unit(unit, filters, formula):
    # White at 1e-318 or 1e305 was NaN: 1/white, or the sum over the image, overflowed. Whole
    # numbers, since XYZ have few bits left at 2^-1060.
    first, second = (np.rint(bright_image((5, 7), seed)) for seed in (1, 2))
    white = np.array([95.0, 100.0, 109.0])
    view = {"samples_per_deg": 23.0, "filters": filters, "formula": formula}
    actual = scielab.delta_e_map(first * unit, second * unit, white_xyz=white * unit, **view)
    assert np.array_equal(actual, scielab.delta_e_map(first, second, white_xyz=white, **view))


@pytest.mark.parametrize("unit", [1e-310, 1e-12, 1e12, 1e305])
def test_filtered_grey_lab_is_independent_of_unit(unit):
    grey = np.random.default_rng(0).uniform(0, 1.2, (8, 9))
    actual = scielab.filtered_grey_lab(grey, white_xyz=D65 * unit, samples_per_deg=23.0)
    expected = scielab.filtered_grey_lab(grey, white_xyz=D65, samples_per_deg=23.0)
    # At 1e-310 the white itself has 14 digits left only.
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("amount", [0.0, -1e-3, -1.0, 1e-12, 1e12])
def test_delta_e_map_of_equal_images_is_zero(filters, formula, amount):
    picture = bright_image((6, 9)) * amount
    actual = scielab.delta_e_map(
        picture, picture, white_xyz=D65, samples_per_deg=23.0, filters=filters, formula=formula
    )
    assert np.array_equal(actual, np.zeros((6, 9)))


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("amount", [0.0, 1e-12, 1e12])
def test_delta_e_map_negative_light_is_finite(formula, amount):
    noise = np.random.default_rng(0).normal(0, 1e-3, (16, 16, 3)) * D65
    actual = scielab.delta_e_map(
        noise, noise + amount * D65, white_xyz=D65, samples_per_deg=23.0, formula=formula
    )
    assert np.all(np.isfinite(actual))


def test_filtered_lab_noise_around_black_has_zero_mean():
    # The policy: nothing is clipped, so what is averaged by eye or by arithmetic is the same, and
    # zero.
    noise = np.random.default_rng(0).normal(0, 1e-3, (64, 64, 3)) * D65
    noise -= noise.mean(axis=(0, 1))
    actual = scielab.filtered_lab(noise, white_xyz=D65, samples_per_deg=23.0)
    assert actual[..., 0].min() < -0.1
    assert abs(actual[..., 0].mean()) < 1e-12
    clipped = scielab.filtered_lab(np.maximum(noise, 0), white_xyz=D65, samples_per_deg=23.0)
    assert clipped[..., 0].mean() > 0.3  # 903.3 · 1e-3/√2π


@pytest.mark.parametrize("formula", FORMULAS)
def test_xyz_to_lab_is_continuous_at_threshold(formula):
    threshold = 216 / 24389
    levels = threshold * (1 + np.linspace(-1e-6, 1e-6, 41))
    lab = scielab.xyz_to_lab(levels[:, None] * D65, D65)
    steps = scielab.delta_e(lab[:-1], lab[1:], formula)
    # Equal steps of luminance, 5e-8 of the threshold: 4e-7 in L* each, on both sides and across.
    np.testing.assert_allclose(steps, steps[0], rtol=1e-4)


def test_filtered_lab_zhang1996_step_at_threshold():
    low, high = (
        scielab.filtered_lab(
            np.full((1, 1, 3), t) * D65, white_xyz=D65, samples_per_deg=1.0, filters="zhang1996"
        )[0, 0, 0]
        for t in (0.008855, 0.008857)
    )
    # 903.3 · 0.008856 = 7.99963 and 116 ∛0.008856 - 16 = 7.99972: no more than that (with 1e-6 of
    # slope 903 either side; one sample of its kernel weighs 1.00001).
    assert 0 < high - low < 0.003


@pytest.mark.parametrize("chroma", [1e-9, 1.0, 20.0])
@pytest.mark.parametrize("hue_deg", [0, 30, 77, 90, 180, 275])
def test_delta_e_2000_opposite_hues_is_symmetric(chroma, hue_deg):
    # There its mean hue jumps by 180°: Sharma, Wu & Dalal (2005). It must not jump with the order
    # of the arguments.
    hue = np.radians(hue_deg)
    one = np.array([50.0, chroma * np.cos(hue), chroma * np.sin(hue)])
    other = np.array([50.0, -one[1], -one[2]])
    assert scielab.delta_e(one, other, "2000") == scielab.delta_e(other, one, "2000")
    turned = np.array([50.0, *(-chroma * np.array([np.cos(hue + 1e-9), np.sin(hue + 1e-9)]))])
    jump = abs(scielab.delta_e(one, turned, "2000") - scielab.delta_e(one, other, "2000"))
    # The jump is the formula's own, up to 20 % at a chroma of 20, and fades as the square of the
    # chroma.
    assert jump < {1e-9: 1e-17, 1.0: 0.05, 20.0: 8.0}[chroma]


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("chroma", [0.0, 1e-300, 1e-150, 1e-12])
def test_delta_e_near_grey_is_small(formula, chroma):
    grey, nearly = np.array([50.0, 0.0, 0.0]), np.array([50.0, chroma, -chroma])
    for pair in ((grey, nearly), (nearly, grey), (nearly, nearly)):
        # 1.5 in 2000: its G for low chroma stretches a* by half.
        assert 0 <= scielab.delta_e(*pair, formula) <= 2 * chroma


@pytest.mark.parametrize(
    ("name", "target", "wrong"),
    [
        (
            "clipping below zero",
            "filtered_lab",
            lambda xyz, **view: scielab.filtered_lab(np.maximum(xyz, 0), **view),
        ),
        (
            "single precision",
            "filtered_lab",
            lambda xyz, **view: scielab.filtered_lab(np.float32(xyz), **view),
        ),
        (
            "the other filters",
            "filtered_lab",
            lambda xyz, **view: scielab.filtered_lab(xyz, **{**view, "filters": "zhang1996"}),
        ),
        (
            "a floor below ΔE",
            "delta_e_map",
            lambda a, b, **view: scielab.delta_e_map(a, b, **view) + 1e-300,
        ),
        (
            "rounded constants",
            "xyz_to_lab",
            lambda xyz, w: scielab._lab(np.moveaxis(xyz / w, -1, 0), *scielab.ZHANG1996_LAB),
        ),
    ],
)
def test_extreme_cases_detect_wrong_viewer(monkeypatch, name, target, wrong):
    monkeypatch.setattr(f"pixsim.verification.extreme_cases.{target}", wrong)
    assert not all(KnownAnswer(*row).check().passed for row in extreme_cases.viewer()), name
