"""S-CIELAB: limits, closed forms, conservation. Numbers from outside: tests/judges/test_scielab_judge.py."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import scipy.ndimage

from pixsim.base.errors import PixsimError
from pixsim.viewer import scielab
from pixsim.viewer import scielab as eye_filters

D65 = np.array([95.047, 100.0, 108.883])
FILTERS = ["published", "zhang1996"]
FORMULAS = ["1976", "1994", "2000"]


def xyz_from_lab(lab: np.ndarray) -> np.ndarray:
    """The inverse of CIELAB written a second time, from CIE 15, to undo it in tests."""
    fy = (lab[..., 0] + 16) / 116
    f = np.stack([fy + lab[..., 1] / 500, fy, fy - lab[..., 2] / 200], axis=-1)
    return D65 * np.where(f > 6 / 29, f**3, (f - 4 / 29) * 108 / 841)


def random_image(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(5, 90, (*shape, 3))


# --- The filter of the first public code, 1996, by a second way ---


@pytest.mark.parametrize("shape", [(64, 48), (5, 9)])  # larger and smaller than the kernel of 23 taps
def test_the_1996_filter_is_a_convolution_with_reflected_edges(shape):
    image = random_image(shape)
    opponent = np.einsum("ij,yxj->iyx", scielab.OPPONENT_FROM_XYZ, image)
    for plane, gaussians in zip(opponent, eye_filters.ZHANG1996_GAUSSIANS, strict=True):
        blurred = np.zeros(shape)
        for weight, width_deg in gaussians:
            kernel = eye_filters.zhang1996_kernel(width_deg, 23)
            in_y = scipy.ndimage.correlate1d(plane, kernel, axis=0, mode="reflect")
            blurred += weight * scipy.ndimage.correlate1d(in_y, kernel, axis=1, mode="reflect")
        plane[:] = blurred
    expected = np.einsum("ij,jyx->yxi", np.linalg.inv(scielab.OPPONENT_FROM_XYZ), opponent)
    lab = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=23, filters="zhang1996")
    # Two ways to the same sums; xyz_from_lab has CIE's constants, but no sample here is dark enough to use them.
    np.testing.assert_allclose(xyz_from_lab(lab), expected, rtol=0, atol=1e-10)


# --- Grey images ---


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize(("shape", "samples_per_deg"), [((48, 64), 23.0), ((5, 9), 30.0), ((1, 1), 60.0)])
@pytest.mark.parametrize("white", [D65, D65 * 3.2, np.array([110.0, 100.0, 35.0])])
def test_a_grey_image_is_an_image_of_greys(filters, shape, samples_per_deg, white):
    grey = np.random.default_rng(2).uniform(-0.02, 1.3, shape)
    grey.flat[0] = 0.0
    view = {"white_xyz": white, "samples_per_deg": samples_per_deg, "filters": filters}
    found = scielab.filtered_grey_lab(grey, **view)
    whole = scielab.filtered_lab(grey[..., None] * white, **view)
    assert found.shape == (*shape, 3)
    # The same transform, once instead of three times: roundings of Lab's 100, amplified by the slope at black (903).
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-10)


def test_a_flat_grey_is_the_luminance_it_has():
    lab = scielab.filtered_grey_lab(np.full((6, 7), 0.184187), white_xyz=D65, samples_per_deg=23)
    # L* 50 is Y/Yn = ((50 + 16)/116)³ = .184187.
    np.testing.assert_allclose(lab, np.broadcast_to([50, 0, 0], (6, 7, 3)), atol=1e-4)


@pytest.mark.parametrize("luminance", [np.ones(3), np.ones((2, 2, 3)), np.ones((0, 4)), np.array([[1.0, np.nan]])])
def test_what_is_no_grey_image_is_refused(luminance):
    with pytest.raises(PixsimError, match=r"luminance: got shape .*; allowed: \(H, W\), finite, not empty"):
        scielab.filtered_grey_lab(luminance, white_xyz=D65, samples_per_deg=23)


# --- The published filter: closed forms, limits, conservation ---


# The widest image is 22° wide, so that the Gaussian of 4.3° counts too.
@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize(("height", "width", "samples_per_deg"), [(48, 64, 60.0), (33, 20, 23.0), (8, 512, 23.0)])
@pytest.mark.parametrize(("ky", "kx"), [(0, 3), (5, 0), (7, 11)])
def test_a_cosine_is_scaled_by_the_closed_form(channel, height, width, samples_per_deg, ky, kx):
    y, x = np.mgrid[:height, :width] + 0.5
    wave = np.cos(np.pi * ky * y / height) * np.cos(np.pi * kx * x / width)
    opponent = np.array([80.0, -5.0, 4.0]) + 3.0 * wave[..., np.newaxis] * np.eye(3)[channel]
    image = np.einsum("ij,yxj->yxi", np.linalg.inv(scielab.OPPONENT_FROM_XYZ), opponent)
    lab = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=samples_per_deg)
    seen = np.einsum("ij,yxj->yxi", scielab.OPPONENT_FROM_XYZ, xyz_from_lab(lab))[..., channel]
    scale = ((seen - opponent[..., channel].mean()) * wave).sum() / (3.0 * (wave**2).sum())

    f2 = (ky / (2 * height) * samples_per_deg) ** 2 + (kx / (2 * width) * samples_per_deg) ** 2
    weights, spreads_deg = np.array(
        [
            [(0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)],
            [(0.531, 0.0392), (0.330, 0.494), (0, 1)],
            [(0.488, 0.0536), (0.371, 0.386), (0, 1)],
        ][channel]
    ).T
    expected = (weights * np.exp(-(np.pi**2) * spreads_deg**2 * f2)).sum() / weights.sum()
    assert abs(scale - expected) < 1e-12  # rounding of 80 over an amplitude of 3, averaged over the image
    residue = seen - opponent[..., channel].mean() - 3.0 * expected * wave
    assert np.abs(residue).max() < 1e-11  # and nothing else has appeared


def test_the_eye_is_a_band_pass_in_luminance_and_a_low_pass_in_colour():
    transfer = eye_filters.transfer(eye_filters.ViewingConditions.of(D65, 60.0, "published"), 1, 4096)[:, 0]
    assert transfer[0].argmax() > 0
    assert 1.1 < transfer[0].max() < 1.2  # (.921 + .105) / .918 where the wide negative Gaussian is gone: 1.118
    assert np.all(np.diff(transfer[1:], axis=1) <= 0)


@pytest.mark.parametrize("samples_per_deg", [5.0, 23.0, 60.0, 400.0])
def test_the_published_filter_conserves_the_mean(samples_per_deg):
    image = random_image((40, 56))
    lab = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=samples_per_deg)
    np.testing.assert_allclose(xyz_from_lab(lab).mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-12)


def test_a_viewer_nearby_sees_every_sample_and_one_far_away_only_the_mean():
    image = random_image((32, 32))
    plain = scielab.xyz_to_lab(image, D65)
    nearby = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=1e-3)
    assert np.abs(nearby - plain).max() < 1e-2  # the widest Gaussian, 4.3°, is 0.004 samples: transfer 1 - 2e-5
    far = scielab.filtered_lab(image, white_xyz=D65, samples_per_deg=1e6)
    mean = scielab.xyz_to_lab(image.mean(axis=(0, 1)), D65)
    assert np.abs(far - mean).max() < 1e-9  # even the narrowest, .0283°, is 900 images wide


@pytest.mark.parametrize("filters", FILTERS)
def test_the_map_turns_with_the_images(filters):
    reference, test = random_image((20, 33), 1), random_image((20, 33), 2)
    view = {"white_xyz": D65, "samples_per_deg": 23, "filters": filters}
    found = scielab.delta_e_map(reference, test, **view)
    turned = scielab.delta_e_map(np.rot90(reference), np.rot90(test), **view)
    np.testing.assert_allclose(turned, np.rot90(found), rtol=0, atol=1e-10)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
def test_identical_images_differ_by_exactly_nothing(filters, formula):
    image = random_image((24, 40))
    found = scielab.delta_e_map(image, image.copy(), white_xyz=D65, samples_per_deg=23, filters=filters, formula=formula)
    assert np.array_equal(found, np.zeros((24, 40)))


@pytest.mark.parametrize("scale", [1e-12, 1e12])
@pytest.mark.parametrize("filters", FILTERS)
def test_the_unit_of_xyz_does_not_matter(scale, filters):
    reference, test = random_image((24, 40), 1), random_image((24, 40), 2)
    view = {"samples_per_deg": 23, "filters": filters}
    expected = scielab.delta_e_map(reference, test, white_xyz=D65, **view)
    found = scielab.delta_e_map(reference * scale, test * scale, white_xyz=D65 * scale, **view)
    assert expected.min() > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_filtering_once_gives_the_same_map():
    reference, test = random_image((24, 40), 1), random_image((24, 40), 2)
    view = {"white_xyz": D65, "samples_per_deg": 23}
    seen_reference, seen_test = (scielab.filtered_lab(image, **view) for image in (reference, test))
    assert np.array_equal(scielab.delta_e(seen_reference, seen_test), scielab.delta_e_map(reference, test, **view))


@pytest.mark.parametrize("workers", [2, 3])
def test_the_number_of_threads_changes_no_bit(workers):
    image = random_image((127, 65))
    view = {"white_xyz": D65, "samples_per_deg": 23}
    found = scielab.filtered_lab(image, **view, workers=workers)
    assert np.array_equal(found, scielab.filtered_lab(image, **view, workers=1))


# --- Differences ---


def test_1976_is_the_distance():
    assert scielab.delta_e([[50, 2, -3]], [[52, 5, 3]])[0] == 7  # √(2² + 3² + 6²)


def test_1994_in_closed_form():
    # Reference chroma 10 along a*: ΔL 1, ΔC 2, ΔH 0 give √(1 + (2 / 1.45)²); seen from the other, 2 / 1.54.
    reference, test = [[50.0, 10.0, 0.0]], [[51.0, 12.0, 0.0]]
    np.testing.assert_allclose(scielab.delta_e(reference, test, "1994"), np.hypot(1, 2 / 1.45), rtol=1e-12)
    np.testing.assert_allclose(scielab.delta_e(test, reference, "1994"), np.hypot(1, 2 / 1.54), rtol=1e-12)


def test_a_global_setting_of_colour_science_changes_nothing():
    import colour

    reference, test = [[50.0, 10.0, 0.0]], [[51.0, 12.0, 3.0]]
    expected = scielab.delta_e(reference, test, "2000")
    with colour.domain_range_scale("1"):
        assert np.array_equal(scielab.delta_e(reference, test, "2000"), expected)


# --- Edges of what can be asked ---


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 1), (3, 5)])
def test_images_smaller_than_the_kernel(filters, shape):
    reference, test = random_image(shape, 1), random_image(shape, 2)
    found = scielab.delta_e_map(reference, test, white_xyz=D65, samples_per_deg=60, filters=filters)
    assert found.shape == shape
    assert np.all(found > 0)
    if filters == "published" and shape == (1, 1):  # one sample and its reflections are a uniform image
        plain = scielab.delta_e(scielab.xyz_to_lab(reference, D65), scielab.xyz_to_lab(test, D65))
        np.testing.assert_allclose(found, plain, rtol=1e-9)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
def test_dark_and_negative_light_gives_numbers_without_warnings(filters, formula):
    dark = np.zeros((16, 16, 3))
    noisy = np.random.default_rng(0).normal(0, 1, dark.shape)
    import colour  # noqa: F401  its import may warn, which is not ours to test

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scielab.delta_e_map(dark, noisy, white_xyz=D65, samples_per_deg=23, filters=filters, formula=formula)
    assert np.all(np.isfinite(found))
    assert found.max() > 0


def test_cielab_is_linear_through_zero():
    step = D65 * 1e-4
    below, zero, above = scielab.xyz_to_lab(np.stack([-step, 0 * step, step]), D65)
    assert np.array_equal(zero, [0, 0, 0])
    np.testing.assert_allclose(above, [24389 / 27 * 1e-4, 0, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(below, -above, rtol=0, atol=1e-12)


def test_cielab_has_no_step_where_its_branches_meet():
    t = 216 / 24389 * (1 + np.array([-1e-9, 1e-9]))
    lab = scielab.xyz_to_lab(t[:, np.newaxis] * D65, D65)
    # Slope 903.3 times the interval of 1.8e-11; the constants rounded in 1976, .008856 and 903.3, leave a step of 1e-4.
    assert 0 < lab[1, 0] - lab[0, 0] < 3e-8


def test_single_precision_and_integers_are_taken_as_they_are():
    image = np.round(random_image((8, 9)))
    view = {"white_xyz": D65, "samples_per_deg": 23}
    expected = scielab.filtered_lab(image, **view)
    for dtype in (np.float32, np.uint8):
        assert np.array_equal(scielab.filtered_lab(image.astype(dtype), **view), expected)


def test_the_inputs_are_left_alone():
    reference, test = random_image((8, 9), 1), random_image((8, 9), 2)
    kept = reference.copy(), test.copy()
    scielab.delta_e_map(reference, test, white_xyz=D65, samples_per_deg=23)
    assert np.array_equal(reference, kept[0])
    assert np.array_equal(test, kept[1])


GOOD = {
    "reference_xyz": np.ones((4, 5, 3)),
    "test_xyz": np.ones((4, 5, 3)),
    "white_xyz": D65,
    "samples_per_deg": 23.0,
}
SPOILT = np.ones((4, 5, 3))
SPOILT[2, 3, 1] = np.nan


@pytest.mark.parametrize(
    ("wrong", "parts"),
    [
        ({"test_xyz": np.ones((5, 4, 3))}, ["reference_xyz and test_xyz", "(4, 5, 3)", "(5, 4, 3)"]),
        ({"reference_xyz": np.ones((4, 5))}, ["reference_xyz", "(4, 5)", "(H, W, 3)"]),
        ({"test_xyz": np.ones((3, 4, 5))}, ["test_xyz", "(3, 4, 5)", "(H, W, 3)"]),
        ({"test_xyz": np.ones((0, 5, 3))}, ["test_xyz", "(0, 5, 3)", "empty"]),
        ({"test_xyz": SPOILT}, ["test_xyz", "nan", "[2, 3, 1]", "1 such of 60"]),
        ({"reference_xyz": np.full((4, 5, 3), np.inf)}, ["reference_xyz", "inf", "60 such"]),
        ({"white_xyz": [95.0, 0.0, 108.0]}, ["white_xyz", "[95.0, 0.0, 108.0]", "above 0"]),
        ({"white_xyz": [95.0, np.nan, 108.0]}, ["white_xyz", "nan"]),
        ({"white_xyz": 100.0}, ["white_xyz", "100.0", "three"]),
        ({"samples_per_deg": 0}, ["samples_per_deg", "0", "above 0"]),
        ({"samples_per_deg": -23.0}, ["samples_per_deg", "-23.0"]),
        ({"samples_per_deg": np.inf}, ["samples_per_deg", "inf", "finite"]),
        ({"samples_per_deg": np.nan}, ["samples_per_deg", "nan", "finite"]),
        ({"filters": "isetcam"}, ["filters", "'isetcam'", "'published', 'zhang1996'"]),
        ({"formula": 1976}, ["formula", "1976", "'1976', '1994', '2000'"]),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_way_out(wrong, parts):
    scielab.delta_e_map(**GOOD)
    with pytest.raises(PixsimError) as error:
        scielab.delta_e_map(**{**GOOD, **wrong})
    assert isinstance(error.value, ValueError)
    for part in parts:
        assert part in str(error.value)


def test_differences_refuse_what_would_broadcast():
    with pytest.raises(PixsimError, match=r"lab_reference and lab_test.*\(1, 3\).*\(2, 3\)"):
        scielab.delta_e(np.zeros((1, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("filters", ["published", "zhang1996"])
def test_strips_and_the_fused_difference_are_the_whole(monkeypatch, filters):
    """Dark samples and bright ones, in strips of one row: the same as pictures in three channels, whole."""
    rng = np.random.default_rng(12)
    first, second = rng.uniform(0, 1, (2, 20, 13)) ** 4
    second[:4] -= 0.01
    view = {"white_xyz": D65, "samples_per_deg": 23.0, "filters": filters}
    reference = scielab.filtered_lab(first[..., None] * D65, **view)
    seen = scielab.filtered_lab(second[..., None] * D65, **view)
    expected = np.sqrt(((reference - seen) ** 2).sum(axis=-1))
    monkeypatch.setattr("pixsim.base.arrays.STRIP_SAMPLES", 13)
    np.testing.assert_array_equal(scielab.filtered_lab(first[..., None] * D65, **view), reference)
    found = scielab.grey_delta_e_map(reference, second, **view)
    assert (seen[..., 0] < 8).any()  # on CIELAB's straight line
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(scielab.delta_e(reference, seen), expected, rtol=0, atol=1e-12)


def test_a_picture_of_another_shape_is_refused():
    with pytest.raises(PixsimError, match=r"reference_lab, shape: got \(2, 3, 3\); allowed: \(3, 2, 3\)"):
        scielab.grey_delta_e_map(np.zeros((2, 3, 3)), np.zeros((3, 2)), white_xyz=D65, samples_per_deg=23.0)


def test_a_reference_that_is_not_finite_is_refused():
    reference = np.zeros((2, 3, 3))
    reference[1, 2, 0] = np.nan
    with pytest.raises(PixsimError, match=r"reference_lab: got nan at \[1, 2, 0\]"):
        scielab.grey_delta_e_map(reference, np.zeros((2, 3)), white_xyz=D65, samples_per_deg=23.0)
