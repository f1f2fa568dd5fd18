"""Scores of pictures that were processed or made elsewhere."""

import numpy as np
import pytest

from pixsim import Camera, Display, Pixel, PixsimError, SpectralImage, evaluate, score_pictures
from pixsim.viewer.metrics import DELTA_E

COLOUR = {"pattern": "rggb", "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
HEADER = {"diffraction": False, "luminance_cd_per_m2": 2000.0}


@pytest.fixture(scope="module")
def light():
    data = 1e-3 * (1 + np.random.default_rng(1).random((96, 96, 3)))
    return SpectralImage(
        [450.0, 550.0, 620.0], 30.0, 5.0, data=data.astype(np.float32), header=HEADER
    )


def mean_image(score):
    return float(score.image.mean())


@pytest.mark.parametrize(
    ("colour", "display"),
    [
        (None, Display(dots=64)),
        (
            None,
            Display(
                raster="one_to_one",
                delta_e="2000",
                bits=10,
                filters="zhang1996",
                samples_per_deg=40,
            ),
        ),
        (COLOUR, Display(dots=64)),
        (COLOUR, Display(dots=64, delta_e="1994", bits=3, gamma=1.0)),
    ],
)
def test_pictures_of_a_score_have_its_difference_bit_for_bit(light, colour, display):
    score = evaluate(
        light,
        Camera(die_mm=0.48),
        Pixel(pitch_um=8.0, colour=colour),
        display=display,
        metrics=["delta_e", mean_image],
    )
    again = score_pictures(score.ideal, score.image, score.display, metrics=["delta_e", mean_image])
    assert np.array_equal(again.delta_e, score.delta_e)
    assert again.metrics == score.metrics
    own = again.statistics()
    assert own == {name: score.statistics()[name] for name in (*DELTA_E.columns, "mean_image")}
    for name in ("ideal", "image"):
        assert np.array_equal(getattr(again, name), getattr(score, name))


def test_pictures_are_rounded_to_the_codes_of_the_display_and_clipped_to_its_range():
    """2 bits at γ = 1: light of 0, 1/3, 2/3 and 1."""
    picture = np.repeat([[-0.5, 0.1, 0.4, 0.6, 0.995, 1.004]], 4, axis=0)
    with pytest.warns(UserWarning, match="17 % of the ideal image is brighter than display white"):
        score = score_pictures(picture, picture, Display(bits=2, gamma=1.0))
    assert score.image[0] == pytest.approx([0, 0, 1 / 3, 2 / 3, 1, 1], abs=1e-15)
    assert score.mean_delta_e == 0.0


def test_grey_pictures_differ_as_colours_of_equal_primaries():
    """Their filters are the same; the two ways round differently."""
    rng = np.random.default_rng(2)
    pair = [rng.random((32, 48)) for _ in range(2)]
    grey, colour = (
        score_pictures(*pair),
        score_pictures(*[np.repeat(each[..., None], 3, axis=2) for each in pair]),
    )
    assert colour.delta_e == pytest.approx(grey.delta_e, abs=1e-9)
    assert grey.mean_delta_e > 1


EVEN = np.full((4, 6), 0.5)


@pytest.mark.parametrize(
    ("ideal", "image", "more", "message"),
    [
        (EVEN, EVEN[:3], {}, r"shapes \(4, 6\) and \(3, 6\); allowed: equal shapes"),
        (
            EVEN,
            np.repeat(EVEN[..., None], 3, axis=2),
            {},
            r"equal shapes. Grey light is that of three equal primaries",
        ),
        (EVEN[0], EVEN[0], {}, r"ideal: got an array of shape \(6,\)"),
        (EVEN[..., None], EVEN[..., None], {}, r"ideal: got an array of shape \(4, 6, 1\)"),
        (EVEN, EVEN[..., None] * np.ones(4), {}, r"image: got an array of shape \(4, 6, 4\)"),
        (EVEN[:0], EVEN[:0], {}, "not empty"),
        (EVEN, np.where(EVEN > 0, np.nan, 0), {}, r"image: got nan at \[0, 0\]"),
        (
            EVEN,
            np.full((4, 6), 128, np.uint8),
            {},
            "image: got whole numbers up to 128, which are codes; allowed: linear light",
        ),
        (
            EVEN,
            EVEN,
            {"metrics": ["delta_e", "visual_noise"]},
            "'visual_noise'; allowed: the frame of a sensor.* as delta_e",
        ),
        (EVEN, EVEN, {"metrics": ["acutance"]}, "'acutance'; allowed: the frame of a sensor"),
        (EVEN, EVEN, {"metrics": ["sharpness"]}, "'sharpness'; allowed: any of delta_e"),
        (EVEN, EVEN, {"metrics": [mean_image, mean_image]}, "'mean_image' twice"),
    ],
)
def test_what_cannot_be_scored_says_why(ideal, image, more, message):
    with pytest.raises(PixsimError, match=message):
        score_pictures(ideal, image, **more)
