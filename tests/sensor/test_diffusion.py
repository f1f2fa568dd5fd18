"""Diffusion of charge: Seib's MTF against the diffusion equation, its spread over pixels against
that MTF, silicon's absorption.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from pixsim.base.errors import PixsimError
from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, diffusion_mtf, spread_shares
from pixsim.sensor.integration import diffusion_of
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

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


def test_absorption_agrees_with_another_measurement():
    nm = np.array(list(SCHINKE_K))
    measured = 4e3 * math.pi * np.array(list(SCHINKE_K.values())) / nm
    ratio = absorption_per_um(nm) / measured
    assert np.abs(ratio - 1).max() < 0.11
    assert abs(ratio.mean() - 1) < 0.04  # not one scale that is wrong


def test_absorption_is_interpolated_and_bounded():
    np.testing.assert_allclose(
        1 / absorption_per_um([550.0, 700.0, 850.0]), [1.565, 5.291, 18.73], rtol=1e-3
    )
    assert absorption_per_um(555.0) == pytest.approx(
        math.sqrt(absorption_per_um(550.0) * absorption_per_um(560.0)), rel=1e-12
    )
    assert np.all(np.diff(absorption_per_um(np.arange(370.0, 1201.0))) < 0)
    for nm in (299.0, 1201.0):
        with pytest.raises(
            PixsimError, match=rf"wavelength_nm: got {nm:g}; allowed: 300 to 1200 nm"
        ):
            absorption_per_um([550.0, nm])


def collected_by_depth(frequency: float, alpha: float, depletion: float, length: float) -> float:
    """∫ α e^(-αz) P(z) dz with P = 1 in the depletion region and e^(-(z - L_D)/L) below, which
    solves n'' = n/L², n(L_D) = 0.
    """
    spread = 1 / math.sqrt(length**-2 + (2e-3 * math.pi * frequency) ** 2)
    below = quad(
        lambda z: alpha * math.exp(-alpha * (depletion + z) - z / spread), 0, np.inf, epsabs=1e-13
    )[0]
    return -math.expm1(-alpha * depletion) + below


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 0.0, 20.0), (0.19, 2.0, 50.0), (2.4, 1.0, 5.0), (0.05, 4.0, 100.0)],
)
def test_diffusion_mtf_is_that_of_the_diffusion_equation(alpha, depletion, length):
    frequency = np.array([0.0, 3.0, 50.0, 200.0, 1000.0])
    wanted = [collected_by_depth(f, alpha, depletion, length) for f in frequency]
    mtf = diffusion_mtf(frequency, alpha, depletion, length)
    np.testing.assert_allclose(mtf, np.array(wanted) / wanted[0], rtol=1e-9)
    assert mtf[0] == 1
    np.testing.assert_allclose(
        diffusion_mtf(-frequency, [[alpha]], depletion, length), [mtf], rtol=1e-15
    )


def test_diffusion_mtf_limits():
    assert diffusion_mtf(100.0, 0.5, 1e3, 20.0) == pytest.approx(
        1, abs=1e-15
    )  # depleted throughout
    assert diffusion_mtf(100.0, 1e6, 0.0, 20.0) == pytest.approx(
        1, abs=1e-6
    )  # absorbed at the surface
    assert diffusion_mtf(100.0, 0.5, 1.0, 1e-9) == pytest.approx(1, abs=1e-8)  # nothing walks
    fixed = 1 - math.exp(-0.5)
    assert diffusion_mtf(1e9, 0.5, 1.0, 20.0) == pytest.approx(
        fixed / (fixed + math.exp(-0.5) * 10 / 11), rel=1e-6
    )
    assert diffusion_mtf(50.0, 1e-12, 1.0, 20.0) == pytest.approx(
        (1.0 + 1 / math.hypot(0.1 * math.pi, 0.05)) / 21.0, rel=1e-9
    )


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 1.0, 4.0), (2.4, 0.0, 2.0), (0.19, 0.5, 1.0), (1e-6, 0.0, 3.0)],
)
def test_diffused_shares_have_the_transform_of_the_mtf(alpha, depletion, length):
    """A line of cells collects a line's light: Σ over rows of the shares, with cells so wide that 5
    hold all of it.

    Its transform is the MTF along x; here the cosine moment of the cells is the sum over aliases of
    MTF · sinc · sinc.
    """
    pitch, side = 12.0, 3.0
    shares = diffused_shares(pitch, side, alpha, depletion, length)
    line = shares.sum(axis=0)
    beyond = 1 - shares.sum()
    assert 0 <= beyond < 0.01
    for phase in (0.11, 0.37, 0.5):
        order = np.arange(-2000, 2001) + phase
        aliases = (
            diffusion_mtf(1e3 * order / pitch, alpha, depletion, length)
            * np.sinc(order)
            * np.sinc(order * side / pitch)
        )
        transform = (line * np.cos(2 * math.pi * phase * np.arange(-2, 3))).sum()
        # Up to 2000 aliases, whose tail is 2e-8, and charge beyond the five cells.
        assert transform == pytest.approx(aliases.sum(), abs=5e-8 + beyond)
        assert transform < 1 - 1e-4 - beyond  # it does spread


def test_diffused_shares_of_a_pixel():
    alpha = np.array([2.4, 0.64, 0.19])
    shares = diffused_shares(2.2, 1.3, alpha, 1.0, 20.0)
    assert shares.shape == (3, 5, 5)
    np.testing.assert_allclose(shares, shares[:, ::-1, ::-1], atol=1e-15)
    np.testing.assert_allclose(shares, np.swapaxes(shares, 1, 2), atol=1e-15)
    assert np.all(np.diff(shares[:, 2, 2]) < 0)  # red light is absorbed deeper
    assert np.all((shares > 0) & (shares < 1))
    still = diffused_shares(2.2, 1.3, alpha, 1.0, 1e-6)
    assert np.abs(still[:, 2, 2] - 1).max() < 1e-6
    shallow = diffused_shares(
        2.2, 1.3, 1e9, 0.0, 20.0
    )  # all absorbed at the surface; a share of 1/α reaches further
    assert shallow[2, 2] == pytest.approx(1, abs=1e-8)
    half = diffused_shares(
        2.2, 4.4, 0.64, 1e3, 20.0
    )  # all depleted: geometry alone, a square of two pixels
    np.testing.assert_allclose(half[2], np.array([0, 0.25, 0.5, 0.25, 0]) * 0.5, atol=1e-6)
    assert diffused_shares(2.2, 1.3, 1e-6, 0.0, 1e-3)[2, 2] == pytest.approx(1, abs=1e-3)


def test_spread_shares_is_a_convolution_that_loses_what_leaves_the_kernel():
    rng = np.random.default_rng(5)
    optical, diffused = rng.uniform(0, 0.04, (3, 5, 5)), rng.uniform(0, 0.04, (5, 5))
    whole = np.zeros((3, 9, 9))
    for row, column in np.ndindex(5, 5):
        whole[:, row : row + 5, column : column + 5] += (
            optical[:, row, column, None, None] * diffused
        )
    np.testing.assert_allclose(spread_shares(optical, diffused), whole[:, 2:7, 2:7], rtol=1e-14)
    one = np.zeros((5, 5))
    one[2, 2] = 1
    np.testing.assert_array_equal(spread_shares(optical, one), optical)
    np.testing.assert_array_equal(spread_shares(one, diffused), diffused)


GREEN_PER_K = [(450.0, 28e-4), (700.0, 37e-4), (850.0, 46e-4), (940.0, 62e-4), (1090.0, 165e-4)]


@pytest.mark.parametrize(("nm", "coefficient_per_k"), GREEN_PER_K)
@pytest.mark.parametrize("kelvin", [260.0, 330.0])
def test_absorption_follows_the_temperature_coefficients_of_green(
    nm: float, coefficient_per_k: float, kelvin: float
) -> None:
    """α(T) = α(300 K) (T/300 K)^b, b = 300 K times the coefficient of Green's table; at 300 K
    nothing changes, bit for bit.
    """
    wanted = (kelvin / 300.0) ** (300.0 * coefficient_per_k)
    assert float(absorption_per_um(nm, kelvin) / absorption_per_um(nm)) == pytest.approx(
        wanted, rel=1e-12
    )
    assert absorption_per_um(nm, 300.0) == absorption_per_um(nm)


def test_temperature_of_a_pixel_acts_on_its_diffusion_alone() -> None:
    """Warm silicon absorbs infrared nearer to its surface, so that less charge strays; 27 °C stands
    for the table's 300 K.
    """
    frequency, nm = np.array([50.0]), 850.0
    stack = {
        "microlens": "none",
        "height_um": 3.0,
        "depletion_um": 1.0,
        "diffusion_length_um": 20.0,
    }
    mtf = []
    for kelvin in (300.15, 330.165):
        physics = derive(
            Pixel(technology="4t-fsi", pitch_um=5.0, temperature_k=kelvin, stack=stack)
        )
        found = diffusion_of(physics)
        assert found is not None
        wanted = diffusion_mtf(frequency, absorption_per_um(nm, kelvin / 1.0005), 1.0, 20.0)
        np.testing.assert_allclose(found(frequency, nm), wanted, rtol=1e-12)
        mtf.append(float(found(frequency, nm)[0]))
    assert mtf[0] == diffusion_mtf(frequency, absorption_per_um(nm), 1.0, 20.0)[0]
    assert 0.005 < mtf[1] - mtf[0] < 0.05
    plain = [
        derive(Pixel(technology="4t-bsi", pitch_um=2.0, temperature_k=kelvin)).charge
        for kelvin in (300.15, 330.0)
    ]
    assert plain[0] is not None
    assert plain[1] is not None
    assert plain[0].content_hash == plain[1].content_hash
