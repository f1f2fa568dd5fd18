"""Numbers of renders of one scene, which differ by the light alone."""

import numpy as np
import pytest
from helpers import lights

import pixsim
from pixsim.studies.light_answers import LightAnswers
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricRequest
from pixsim.viewer.setting import Run

NAMES = ["delta_e", "information", "mtf50"]


def test_answers_are_the_numbers_of_frames_and_equal_in_equal_light() -> None:
    """A noisy light has other numbers. Frames of another noise have a mean ΔE within 5 %, of 1000
    pixels with a scatter of half of it: three standard errors.
    """
    light = lights.natural()
    settings = Run(metrics=NAMES, pixel={"pitch_um": 84.8}, display={"dots": 32})
    request = MetricRequest(metrics_named(NAMES), MetricOptions())
    answers = LightAnswers([Imaging.of(settings, lights.camera(light))], request)
    noise = np.random.default_rng(64).normal(1, 0.3, light.planes.shape).astype(np.float32)
    noisy = light.with_planes(light.planes * np.maximum(noise, 0))
    first, second, other = answers.values([(light, None), (light, None), (noisy, None)])
    assert len(first) == len(NAMES)
    for key, numbers in first.items():
        np.testing.assert_array_equal(second[key], numbers)
        assert (other[key] != numbers).all()
        assert answers.tolerance(key, 100.0) == pytest.approx(2.0)

    score = pixsim.evaluate(light, lights.camera(light), settings.pixel, display=settings.display)
    assert first["mean_delta_e", 84.8].mean() == pytest.approx(score.mean_delta_e, rel=0.05)
