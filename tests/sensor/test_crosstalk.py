"""Crosstalk: shares of the neighbours over an array, and diffusion of charge against the diffusion
equation and another measurement of silicon.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.claims import Claim
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.signal import convolve

from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack, collected_shares
from pixsim.sensor.collection import bin_pixels, collected_signal
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours, shares_sum
from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, diffusion_mtf, spread_shares

KERNEL = np.random.default_rng(1).uniform(0, 0.04, (5, 5))
FIELD = np.random.default_rng(2).uniform(0, 0.04, (3, 2, 5, 5))


SIGNAL = np.random.default_rng(3).uniform(0, 1, (9, 5))
OPTICAL = np.random.default_rng(5).uniform(0, 0.04, (3, 5, 5))
SHARES = [
    Claim(
        "light of one pixel lands as the shares",
        lambda: share_with_neighbours(np.pad([[3.0]], 5), KERNEL),
        np.pad(3 * KERNEL, 3),
        rtol=1e-15,
    ),
    *(
        Claim(
            f"a flat field of {shape} stays flat",
            lambda shape=shape: share_with_neighbours(np.full(shape, 7.0), KERNEL),
            np.full(shape, 7 * KERNEL.sum()),
            rtol=1e-14,
        )
        for shape in ((1, 1), (2, 3), (12, 7))
    ),
    *(
        Claim(
            f"shares are linear between points of the field, at {place}",
            lambda place=place: share_with_neighbours(SIGNAL, FIELD)[place],
            share_with_neighbours(SIGNAL, kernel)[place],
            rtol=1e-13,
        )
        for place, kernel in (
            ((0, 0), FIELD[0, 0]),
            ((8, 4), FIELD[2, 1]),
            ((2, 1), (3 * (FIELD[0, 0] + FIELD[1, 0]) + FIELD[0, 1] + FIELD[1, 1]) / 8),
        )
    ),
    Claim(
        "sums of shares are linear too",
        lambda: shares_sum(FIELD, (9, 5))[4],
        np.linspace(FIELD[1, 0].sum(), FIELD[1, 1].sum(), 5),
        rtol=1e-14,
    ),
    Claim(
        "and of one pixel those of the middle",
        lambda: shares_sum(FIELD, (1, 1)),
        [[FIELD[1].mean(axis=0).sum()]],
        rtol=1e-14,
    ),
    Claim(
        "charge of light that lands: a convolution that loses what leaves the kernel",
        lambda: spread_shares(OPTICAL, KERNEL),
        [convolve(light, KERNEL, mode="same") for light in OPTICAL],
        rtol=1e-13,
    ),
    Claim(
        "binned values are sums of whole squares",
        lambda: bin_pixels(np.arange(15.0).reshape(3, 5), 2),
        [[0 + 1 + 5 + 6, 2 + 3 + 7 + 8]],
    ),
]


@pytest.mark.parametrize("claim", SHARES, ids=str)
def test_shares(claim: Claim) -> None:
    claim.check()


@pytest.mark.parametrize("order", [1, 5, 12, 23])
def test_grating_is_scaled_by_the_transform_of_the_kernel(order: int) -> None:
    """A reflected cosine through the symmetric kernel of a microlens with diffraction."""
    shares = collected_shares(Stack(1.4, 0.8, 2.5, 1.5), disc_pupil(0.25), 600.0)[0]
    assert 0.02 < 1 - shares[2, 2] / shares.sum() < 0.3
    cosine = np.cos(math.pi * order * (np.arange(24) + 0.5) / 24) * np.ones((6, 1))
    transform = (shares.sum(axis=0) * np.cos(math.pi * order / 24 * np.arange(-2, 3))).sum()
    collected = share_with_neighbours(1 + cosine, shares)
    np.testing.assert_allclose(collected, shares.sum() + transform * cosine, atol=1e-12)


# In the last one rows with equal filters around them do not lie at equal distances.
CELLS = [("GR", "BG"), ("RGB", "GGR"), (*["RG"] * 7, "BG")]


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), cell=st.sampled_from(CELLS))
def test_neighbours_get_what_a_pixel_loses(seed: int, cell: tuple[str, ...]) -> None:
    """Light that stays within the array is collected once, whatever the shares of each channel;
    channels add up, and a stacked sensor has each by itself.
    """
    rng = np.random.default_rng(seed)
    light = np.zeros((18, 21))
    light[3:-3, 3:-3] = rng.random((12, 15))
    shares = rng.random((3, 5, 5))
    shares /= shares.sum(axis=(1, 2), keepdims=True)
    layout = Layout(cell)
    whole = collected_signal(light, list(shares), layout)
    assert whole.sum() == pytest.approx(light.sum(), rel=1e-12)
    parts = [
        collected_signal(light * (layout.numbers(light.shape) == channel), list(shares), layout)
        for channel in range(3)
    ]
    np.testing.assert_allclose(sum(parts), whole, atol=1e-14)
    stacked = collected_signal(light, list(shares), Layout(("RGB",), True))
    planes = np.split(light, 3)
    alone = [share_with_neighbours(*pair) for pair in zip(planes, shares, strict=True)]
    np.testing.assert_allclose(stacked, np.concatenate(alone), rtol=1e-14)


# --- Diffusion of charge

# k of silicon at 295 K by C. Schinke et al., AIP Advances 5 (2015) 067168, as in
# refractiveindex.info (CC0); 11 % at 600 nm.
SCHINKE_K = {
    450: 0.095362,
    500: 0.048542,
    550: 0.028038,
    600: 0.018521,
    650: 0.014447,
    700: 0.010623,
    750: 0.0076156,
}


def test_absorption_agrees_with_another_measurement() -> None:
    nm = np.array(list(SCHINKE_K))
    ratio = absorption_per_um(nm) * nm / (4e3 * math.pi * np.array(list(SCHINKE_K.values())))
    np.testing.assert_allclose(ratio, 1.0, rtol=0.11)
    assert ratio.mean() == pytest.approx(1.0, abs=0.04)  # not one scale that is wrong
    assert np.diff(absorption_per_um(np.arange(370.0, 1201.0))).max() < 0


def collected_by_depth(frequency: float, alpha: float, depletion: float, length: float) -> float:
    """∫ α e^(-αz) P(z) dz with P = 1 in the depletion region and e^(-(z - L_D)/L) below, which
    solves n'' = n/L², n(L_D) = 0.
    """
    spread = 1 / math.sqrt(length**-2 + (2e-3 * math.pi * frequency) ** 2)
    below = quad(
        lambda z: alpha * math.exp(-alpha * (depletion + z) - z / spread), 0, np.inf, epsabs=1e-13
    )[0]
    return float(below - math.expm1(-alpha * depletion))


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 0.0, 20.0), (0.19, 2.0, 50.0), (2.4, 1.0, 5.0), (0.05, 4.0, 100.0)],
)
def test_diffusion_mtf_solves_the_diffusion_equation(
    alpha: float, depletion: float, length: float
) -> None:
    frequency = np.array([0.0, 3.0, 50.0, 200.0, 1000.0])
    collected = np.array([collected_by_depth(f, alpha, depletion, length) for f in frequency])
    mtf = diffusion_mtf(frequency, alpha, depletion, length)
    np.testing.assert_allclose(mtf, collected / collected[0], rtol=1e-9)
    mirrored = diffusion_mtf(-frequency, [[alpha]], depletion, length)
    np.testing.assert_allclose(mirrored, [mtf], rtol=1e-15)


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 1.0, 4.0), (2.4, 0.0, 2.0), (0.19, 0.5, 1.0), (1e-6, 0.0, 3.0)],
)
@pytest.mark.parametrize("phase", [0.11, 0.5])
def test_diffused_shares_have_the_transform_of_the_mtf(
    alpha: float, depletion: float, length: float, phase: float
) -> None:
    """The cosine moment of a row of cells, so wide that 5 hold all charge, is the sum over aliases
    of MTF · sinc · sinc.
    """
    pitch = 12.0
    side = 3.0
    shares = diffused_shares(pitch, side, alpha, depletion, length)
    beyond = 1 - shares.sum()
    assert 0 <= beyond < 0.01
    order = np.arange(-2000, 2001) + phase
    mtf = diffusion_mtf(1e3 * order / pitch, alpha, depletion, length)
    aliases = mtf * np.sinc(order) * np.sinc(order * side / pitch)
    transform = (shares.sum(axis=0) * np.cos(2 * math.pi * phase * np.arange(-2, 3))).sum()
    # The tail of the aliases is 2e-8, and there is charge beyond the five cells.
    assert transform == pytest.approx(aliases.sum(), abs=5e-8 + beyond)
    assert transform < 1 - 1e-4 - beyond  # it does spread


def test_diffused_shares_are_symmetric_and_wider_in_red() -> None:
    shares = diffused_shares(2.2, 1.3, np.array([2.4, 0.64, 0.19]), 1.0, 20.0)
    np.testing.assert_allclose(shares, shares[:, ::-1, ::-1], atol=1e-15)
    np.testing.assert_allclose(shares, np.swapaxes(shares, 1, 2), atol=1e-15)
    assert np.diff(shares[:, 2, 2]).max() < 0
    assert shares.min() > 0
