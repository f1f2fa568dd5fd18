"""The metric flip, by the package of its authors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pixsim import Display, PixsimError, score_pictures
from pixsim.viewer import shown_metrics
from pixsim.viewer.display import shown_luminance

DISPLAY = Display(gamma=1.0, bits=16, samples_per_deg=31.0)


def pair(*channels: int) -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    ideal = 0.2 + 0.5 * rng.random((40, 60, *channels))
    return [ideal, ideal + 0.05 * rng.standard_normal(ideal.shape)]


@pytest.mark.parametrize("channels", [(), (3,)])
def test_flip_is_that_of_the_package_for_srgb_codes(channels: tuple[int, ...]) -> None:
    """float32 of the codes: 1e-5 of the mean."""
    flip = pytest.importorskip("flip_evaluator")
    pictures = pair(*channels)
    codes = []
    for picture in pictures:
        light = shown_luminance(picture, DISPLAY)
        curved = 1.055 * light ** (1 / 2.4) - 0.055
        code = np.where(light <= 0.0031308, 12.92 * light, curved).astype(np.float32)
        codes.append(code if channels else np.repeat(code[..., None], 3, axis=2))
    _, mean, _ = flip.evaluate(*codes, "LDR", applyMagma=False, parameters={"ppd": 31.0})
    score = score_pictures(*pictures, DISPLAY, metrics=["flip"])
    assert score.metrics["flip"] == pytest.approx(mean, rel=1e-5)
    assert mean > 0.01


def test_flip_without_its_package_says_what_to_install(monkeypatch: Any) -> None:
    monkeypatch.setattr(shown_metrics, "find_spec", lambda name: None)
    with pytest.raises(PixsimError, match=r"pip install 'pixsim\[flip\]'"):
        score_pictures(*pair(), metrics=["flip"])
