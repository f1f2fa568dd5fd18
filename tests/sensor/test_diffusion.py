"""Diffusion of charge: Seib's MTF against the diffusion equation, its spread over pixels against
that MTF, and silicon's absorption against another measurement.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, diffusion_mtf, spread_shares

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


def test_spread_shares_is_a_convolution_that_loses_what_leaves_the_kernel() -> None:
    rng = np.random.default_rng(5)
    optical = rng.uniform(0, 0.04, (3, 5, 5))
    diffused = rng.uniform(0, 0.04, (5, 5))
    whole = np.zeros((3, 9, 9))
    for row, column in np.ndindex(5, 5):
        light = optical[:, row, column, None, None]
        whole[:, row : row + 5, column : column + 5] += light * diffused
    np.testing.assert_allclose(spread_shares(optical, diffused), whole[:, 2:7, 2:7], rtol=1e-14)
