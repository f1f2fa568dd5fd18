"""Noise that a viewer sees, and the light that a camera needs to keep it low."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from pixsim import PixsimError, metrics

WHITE = np.array([95.047, 100.0, 108.883])
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def csf(frequency: float) -> float:
    return 75 * frequency**0.8 * math.exp(-0.2 * frequency) / 34.05


def wave(order: int, size: int = 64) -> np.ndarray:
    """A cosine that reflection at the borders continues: order half-waves along x."""
    return np.broadcast_to(np.cos(np.pi * order * (np.arange(size) + 0.5) / size), (size, size))


@pytest.mark.parametrize("order", [4, 17, 40])
def test_visual_noise_of_a_grey_wave(order):
    """The CSF times dL*/dY times a/√2, at order/2 cycles in 64/40 degrees; a small wave, 1e-5 of
    white.
    """
    grey, amplitude = 0.2, 1e-5
    expected = 116 / 3 * grey ** (-2 / 3) * amplitude / math.sqrt(2) * csf(order / 2 / 64 * 40.0)
    assert metrics.visual_noise(grey + amplitude * wave(order), 40.0) == pytest.approx(
        expected, rel=1e-6
    )


def test_visual_noise_of_white_noise():
    """dL*/dY times the root of the integral of σ² CSF² over the Nyquist square.

    1e-2 is 4 standard errors: about 10 000 of 512² frequencies carry what passes; 6e-5 of seeds
    would fail.
    """
    grey, sigma, samples_per_deg = 0.2, 1e-4, 40.0
    noise = np.random.default_rng(44).normal(0.0, sigma, (512, 512))
    passed = (
        4
        * dblquad(
            lambda y, x: csf(math.hypot(x, y)) ** 2, 0, samples_per_deg / 2, 0, samples_per_deg / 2
        )[0]
    )
    expected = 116 / 3 * grey ** (-2 / 3) * sigma * math.sqrt(passed) / samples_per_deg
    assert metrics.visual_noise(grey + noise, samples_per_deg) == pytest.approx(expected, rel=1e-2)


def test_visual_noise_of_grey_is_the_same_in_colour():
    picture = 0.2 + np.random.default_rng(44).normal(0.0, 0.01, (32, 48))
    grey = metrics.visual_noise(picture, 30.0)
    assert metrics.visual_noise(picture[..., None] * WHITE, 30.0) == pytest.approx(grey, rel=1e-9)
    assert metrics.visual_noise(
        picture[..., None] * np.ones(3), 30.0, white_xyz=np.ones(3)
    ) == pytest.approx(grey, rel=1e-9)


@pytest.mark.parametrize(("channel", "filter_"), [
    (0, lambda f: (109.1413 * math.exp(-0.00038 * f**3.4244) + 93.5971 * math.exp(-0.00367 * f**2.1677)) / 202.7384),
    (2, lambda f: (7.0328 * math.exp(-4e-6 * f**4.2582) + 40.691 * math.exp(-0.10391 * f**1.6487)) / 40.691),
])  # fmt: skip
def test_visual_noise_of_a_coloured_wave(channel, filter_):
    """X or Z of the adapted observer alone is C₁ or C₂ alone: its filter times the noise of an
    unfiltered wave.

    That one is in the uniform part of CIELUV's chroma: weights times 13 L* du′ and dv′ to first
    order.
    """
    grey, amplitude, order = 0.2, 1e-6, 17
    adapt = np.linalg.inv(BRADFORD) @ np.diag(BRADFORD.sum(axis=1) / (BRADFORD @ WHITE)) @ BRADFORD
    step = np.linalg.inv(adapt)[:, channel] * amplitude
    at, total = grey * WHITE, grey * WHITE @ [1.0, 15.0, 3.0]
    change = step @ [1.0, 15.0, 3.0]
    lightness = 116 * np.cbrt(grey) - 16
    du, dv = (
        factor * (step[one] / total - at[one] * change / total**2)
        for one, factor in ((0, 4.0), (1, 9.0))
    )
    dl = 116 / 3 * grey ** (-2 / 3) * step[1] / WHITE[1]
    seen = abs(dl) + 13 * lightness * (0.852 * abs(du) + 0.323 * abs(dv))
    expected = seen / math.sqrt(2) * filter_(order / 2 / 64 * 40.0)
    found = metrics.visual_noise(at + wave(order)[..., None] * step, 40.0)
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("picture", "white", "message"), [
    (np.ones(4), None, r"picture: got an array of shape \(4,\)"),
    (np.ones((4, 4, 2)), None, "picture: got an array of shape"),
    (np.full((4, 4), np.nan), None, "picture: got nan"),
    (np.ones((4, 4, 3)), [1.0, 0.0, 1.0], "white_xyz: got"),
])  # fmt: skip
def test_visual_noise_invalid_arguments_raise(picture, white, message):
    with pytest.raises(PixsimError, match=message):
        metrics.visual_noise(picture, 30.0, white_xyz=white)


def test_snr10_of_shot_noise_alone():
    """100 electrons: of 1000 cd/m² that give 4000, 25; a wall of 18 % then has 25 π/0.18 lx."""
    found = metrics.snr10_lx(4000.0, 1000.0, reflectance=0.18)
    assert found == pytest.approx(25 * math.pi / 0.18, rel=1e-12)
    assert metrics.snr10_lx(4000.0, 1000.0, reflectance=0.18, pixels_per_dot=4.0) == pytest.approx(
        found / 4, rel=1e-12
    )
    assert (
        metrics.snr10_lx(4000.0, 1000.0, reflectance=0.18, pixels_per_dot=0.25) == found
    )  # a pixel's noise on 4 dots


def test_snr10_in_its_light_is_10():
    dark, prnu, pixels = 80.0, 0.02, 2.5
    lux = metrics.snr10_lx(
        4000.0, 1000.0, reflectance=0.9, dark_variance_e2=dark, prnu=prnu, pixels_per_dot=pixels
    )
    electrons = lux * 0.9 / math.pi * 4000.0 / 1000.0
    assert math.sqrt(pixels) * electrons / math.sqrt(
        electrons + dark + (prnu * electrons) ** 2
    ) == pytest.approx(10.0, rel=1e-12)


def test_snr10_that_no_light_reaches_is_none():
    """PRNU of 10 % keeps SNR below 10, unless dots average several pixels; a pixel of 99 e- is full
    before.
    """
    assert metrics.snr10_lx(4000.0, 1000.0, reflectance=0.9, prnu=0.1) is None
    assert (
        metrics.snr10_lx(4000.0, 1000.0, reflectance=0.9, prnu=0.1, pixels_per_dot=4.0) is not None
    )
    assert metrics.snr10_lx(4000.0, 1000.0, reflectance=0.9, saturation_e=99.0) is None
    assert metrics.snr10_lx(4000.0, 1000.0, reflectance=0.9, saturation_e=101.0) is not None
