"""The metric flip, by the package of its authors."""

import numpy as np
import pytest

from pixsim import (
    Camera,
    Display,
    Pixel,
    PixsimError,
    SpectralImage,
    evaluate,
    score_pictures,
    study,
)
from pixsim.viewer import shown_metrics
from pixsim.viewer.display import shown_luminance

DISPLAY = Display(gamma=1.0, bits=16, samples_per_deg=31.0)


def pair(*channels):
    rng = np.random.default_rng(4)
    ideal = 0.2 + 0.5 * rng.random((40, 60, *channels))
    return ideal, ideal + 0.05 * rng.standard_normal(ideal.shape)


def srgb(light):
    """Codes of light, 0 to 1; IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055).astype(
        np.float32
    )


@pytest.mark.parametrize("channels", [(), (3,)])
def test_flip_of_shown_pictures_is_that_of_the_package_for_their_srgb_codes(channels):
    """Single precision of the codes: 1e-5 of the mean."""
    flip = pytest.importorskip(
        "flip_evaluator", reason="flip-evaluator is not installed (pip install 'pixsim[flip]')"
    )
    ideal, image = pair(*channels)
    score = score_pictures(ideal, image, DISPLAY, metrics=["flip", "delta_e"])
    codes = [srgb(shown_luminance(light, DISPLAY)) for light in (ideal, image)]
    codes = codes if channels else [np.repeat(each[..., None], 3, axis=2) for each in codes]
    _, mean, used = flip.evaluate(*codes, "LDR", applyMagma=False, parameters={"ppd": 31.0})
    assert used["ppd"] == 31.0
    assert score.metrics["flip"] == pytest.approx(mean, rel=1e-5)
    assert score.further["mean_flip"] == score.metrics["flip"] > 0.01


def test_flip_of_a_frame_is_that_of_its_pictures():
    pytest.importorskip(
        "flip_evaluator", reason="flip-evaluator is not installed (pip install 'pixsim[flip]')"
    )
    light = SpectralImage(
        [550.0], 10.0, 10.0, data=np.full((48, 48, 1), 1e-3), header={"diffraction": False}
    )
    score = evaluate(
        light,
        Camera(die_mm=0.48),
        Pixel(),
        display=Display(dots=48, white_cd_per_m2=1000),
        metrics=["flip"],
    )
    assert (
        score_pictures(score.ideal, score.image, score.display, metrics=["flip"]).metrics
        == score.metrics
    )


def test_flip_without_its_package_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(shown_metrics, "find_spec", lambda name: None)
    message = r"'flip'; allowed: the package of its authors: pip install 'pixsim\[flip\]'"
    with pytest.raises(PixsimError, match=message):
        score_pictures(*pair(), metrics=["delta_e", "flip"])
    with pytest.raises(PixsimError, match=message):
        study("pixel-size", tmp_path, metrics=["flip"])
