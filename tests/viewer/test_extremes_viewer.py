"""S-CIELAB at its extremes, beyond the stability table; and that the table's gates can fail."""

from __future__ import annotations

import tracemalloc
import warnings

import numpy as np
import pytest

from pixsim.accuracy import stability
from pixsim.base.errors import PixsimError
from pixsim.viewer import scielab
from pixsim.viewer.scielab import delta_e, delta_e_map, filtered_grey_lab, filtered_lab

WHITE = np.array([95.047, 100.0, 108.883])
FILTERS = ("published", "zhang1996")
FORMULAS = ("1976", "1994", "2000")
pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(autouse=True, scope="module")
def colour_has_been_imported() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what its import warns of is not ours to test
        import colour  # noqa: F401


def image(shape: tuple[int, int], seed: int = 0, low: float = 0.02) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, 1.2, (*shape, 3)) * WHITE


@pytest.mark.parametrize("samples_per_deg", [1e-3, 0.5, 223.0, 225.0, 2000.0, 1e5, 1e6])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 4)])
def test_any_density_gives_numbers_in_little_memory(samples_per_deg, filters, formula, shape):
    """A kernel spans a degree, 1e6 samples at most: six arrays of it are 48 MB, and what it takes does not grow otherwise."""
    tracemalloc.start()
    view = {"white_xyz": WHITE, "samples_per_deg": samples_per_deg, "filters": filters, "formula": formula}
    try:
        found = delta_e_map(image(shape, 1), image(shape, 2), **view)
        assert tracemalloc.get_traced_memory()[1] < 64e6
    finally:
        tracemalloc.stop()
    assert found.shape == shape
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize("samples_per_deg", [1e-320, 1e150, 1e160, 1e308])
def test_the_published_filters_have_no_ends(samples_per_deg):
    picture = image((6, 4))
    found = filtered_lab(picture, white_xyz=WHITE, samples_per_deg=samples_per_deg)
    seen = picture if samples_per_deg < 1 else np.broadcast_to(picture.mean(axis=(0, 1)), picture.shape)
    np.testing.assert_allclose(found, scielab.xyz_to_lab(seen, WHITE), rtol=0, atol=1e-11)


@pytest.mark.parametrize("samples_per_deg", [1e-320, 1e-300, 1e9, 1e300])
def test_kernels_of_a_degree_are_refused_where_they_have_no_size(samples_per_deg):
    # 1e-320 was an OverflowError, 1e9 asked for 16 GB.
    with pytest.raises(PixsimError, match=r"samples_per_deg: got .*allowed: 1e-06 to 1e\+06 for 'zhang1996'"):
        filtered_lab(image((6, 4)), white_xyz=WHITE, samples_per_deg=samples_per_deg, filters="zhang1996")


@pytest.mark.parametrize("unit", [2.0**-1060, 2.0**-500, 2.0**500, 2.0**1010])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
def test_the_unit_of_light_changes_no_bit(unit, filters, formula):
    # White at 1e-318 or 1e305 was NaN: 1/white, or the sum over the image, overflowed. Whole numbers, since XYZ have few bits
    # left at 2^-1060.
    first, second = (np.rint(image((5, 7), seed)) for seed in (1, 2))
    white = np.array([95.0, 100.0, 109.0])
    view = {"samples_per_deg": 23.0, "filters": filters, "formula": formula}
    found = delta_e_map(first * unit, second * unit, white_xyz=white * unit, **view)
    assert np.array_equal(found, delta_e_map(first, second, white_xyz=white, **view))


@pytest.mark.parametrize("unit", [1e-310, 1e-12, 1e12, 1e305])
def test_the_unit_of_a_grey_images_white_does_not_matter(unit):
    grey = np.random.default_rng(0).uniform(0, 1.2, (8, 9))
    found = filtered_grey_lab(grey, white_xyz=WHITE * unit, samples_per_deg=23.0)
    expected = filtered_grey_lab(grey, white_xyz=WHITE, samples_per_deg=23.0)
    # At 1e-310 the white itself has 14 digits left only.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("amount", [0.0, -1e-3, -1.0, 1e-12, 1e12])
def test_an_image_and_itself_differ_by_exactly_nothing(filters, formula, amount):
    picture = image((6, 9)) * amount
    found = delta_e_map(picture, picture, white_xyz=WHITE, samples_per_deg=23.0, filters=filters, formula=formula)
    assert np.array_equal(found, np.zeros((6, 9)))


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("amount", [0.0, 1e-12, 1e12])
def test_slightly_negative_light_is_kept_and_gives_numbers(formula, amount):
    noise = np.random.default_rng(0).normal(0, 1e-3, (16, 16, 3)) * WHITE
    found = delta_e_map(noise, noise + amount * WHITE, white_xyz=WHITE, samples_per_deg=23.0, formula=formula)
    assert np.all(np.isfinite(found))


def test_noise_around_black_is_black_on_average():
    # The policy: nothing is clipped, so what is averaged by eye or by arithmetic is the same, and zero.
    noise = np.random.default_rng(0).normal(0, 1e-3, (64, 64, 3)) * WHITE
    noise -= noise.mean(axis=(0, 1))
    found = filtered_lab(noise, white_xyz=WHITE, samples_per_deg=23.0)
    assert found[..., 0].min() < -0.1
    assert abs(found[..., 0].mean()) < 1e-12
    clipped = filtered_lab(np.maximum(noise, 0), white_xyz=WHITE, samples_per_deg=23.0)
    assert clipped[..., 0].mean() > 0.3  # 903.3 · 1e-3/√2π


@pytest.mark.parametrize("formula", FORMULAS)
def test_differences_are_continuous_across_the_threshold(formula):
    threshold = 216 / 24389
    levels = threshold * (1 + np.linspace(-1e-6, 1e-6, 41))
    lab = scielab.xyz_to_lab(levels[:, None] * WHITE, WHITE)
    steps = delta_e(lab[:-1], lab[1:], formula)
    # Equal steps of luminance, 5e-8 of the threshold: 4e-7 in L* each, on both sides and across.
    np.testing.assert_allclose(steps, steps[0], rtol=1e-4)


def test_the_threshold_of_1996_has_the_step_that_its_rounded_numbers_make():
    low, high = (
        filtered_lab(np.full((1, 1, 3), t) * WHITE, white_xyz=WHITE, samples_per_deg=1.0, filters="zhang1996")[0, 0, 0]
        for t in (0.008855, 0.008857)
    )
    # 903.3 · 0.008856 = 7.99963 and 116 ∛0.008856 - 16 = 7.99972: no more than that (with 1e-6 of slope 903 either side;
    # one sample of its kernel weighs 1.00001).
    assert 0 < high - low < 0.003


@pytest.mark.parametrize("chroma", [1e-9, 1.0, 20.0])
@pytest.mark.parametrize("hue_deg", [0, 30, 77, 90, 180, 275])
def test_2000_is_symmetric_at_opposite_hues_too(chroma, hue_deg):
    # There its mean hue jumps by 180°: Sharma, Wu & Dalal (2005). It must not jump with the order of the arguments.
    hue = np.radians(hue_deg)
    one = np.array([50.0, chroma * np.cos(hue), chroma * np.sin(hue)])
    other = np.array([50.0, -one[1], -one[2]])
    assert delta_e(one, other, "2000") == delta_e(other, one, "2000")
    turned = np.array([50.0, *(-chroma * np.array([np.cos(hue + 1e-9), np.sin(hue + 1e-9)]))])
    jump = abs(delta_e(one, turned, "2000") - delta_e(one, other, "2000"))
    # The jump is the formula's own, up to 20 % at a chroma of 20, and fades as the square of the chroma.
    assert jump < {1e-9: 1e-17, 1.0: 0.05, 20.0: 8.0}[chroma]


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("chroma", [0.0, 1e-300, 1e-150, 1e-12])
def test_grey_has_no_hue_to_trip_over(formula, chroma):
    grey, nearly = np.array([50.0, 0.0, 0.0]), np.array([50.0, chroma, -chroma])
    for pair in ((grey, nearly), (nearly, grey), (nearly, nearly)):
        # 1.5 in 2000: its G for low chroma stretches a* by half.
        assert 0 <= delta_e(*pair, formula) <= 2 * chroma


@pytest.mark.parametrize(
    ("name", "target", "wrong"),
    [
        ("clipping below zero", "filtered_lab", lambda xyz, **view: filtered_lab(np.maximum(xyz, 0), **view)),
        ("single precision", "filtered_lab", lambda xyz, **view: filtered_lab(np.float32(xyz), **view)),
        (
            "the other filters",
            "filtered_lab",
            lambda xyz, **view: filtered_lab(xyz, **{**view, "filters": "zhang1996"}),
        ),
        ("a floor below ΔE", "delta_e_map", lambda a, b, **view: delta_e_map(a, b, **view) + 1e-300),
        ("rounded constants", "xyz_to_lab", lambda xyz, white: _lab_of_1996(xyz, white)),
    ],
)
def test_a_wrong_viewer_fails(monkeypatch, name, target, wrong):
    monkeypatch.setattr(f"pixsim.accuracy.stability.viewer.{target}", wrong)
    assert not all(case.passed for case in stability.cases_of("viewer")), name


def _lab_of_1996(xyz, white):
    return scielab._lab(np.moveaxis(xyz / white, -1, 0), *scielab.ZHANG1996_LAB)
