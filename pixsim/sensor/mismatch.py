"""Differences between pixels from the geometry of their parts: photodiodes, source followers, and
hot pixels.

Small devices differ more than large ones: the area over which chance is averaged is smaller.
Spreads are standard deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import NotNegative, Positive

ELECTRON_C = 1.602176634e-19  # SI 2019, exact
E_PER_FC = 1e-15 / ELECTRON_C
_A_PER_CM2_TO_E_PER_S_UM2 = 1e-8 / ELECTRON_C  # 1 cm² = 1e8 µm²
_UM_PER_CM = 1e4


def prnu_of_area(prnu_um: NotNegative, area_um2: Positive) -> float:
    """Return the PRNU of photodiodes, k/√area, relative to the mean gain.

    Edges and layers vary at random, with an area law as in Pelgrom et al. (1989).

    prnu_um : k, the PRNU of a photodiode of 1 µm², in µm
    area_um2 : of the photodiode

    Raises PixsimError if k is negative or the area is not positive.
    """
    return prnu_um / math.sqrt(area_um2)


def follower_offset_e(
    threshold_mv_um: NotNegative, follower_area_um2: Positive, node_capacitance_ff: Positive
) -> float:
    """Return the spread of offsets that source followers cause, σ(V_t) C/q in electrons with σ(V_t)
    = A_Vt/√(W L).

    M. J. M. Pelgrom, A. C. J. Duinmaijer and A. P. G. Welbers, IEEE J. Solid-State Circuits 24
    (1989) 1433. Their A_Vt is for the difference in a pair; σ of one transistor is 1/√2 of
    it, and its A_Vt is meant here. True correlated double sampling removes these offsets.

    threshold_mv_um : A_Vt of one transistor, in mV µm
    follower_area_um2 : W L of the source follower's gate
    node_capacitance_ff : of the sense node, over which the electrons are read

    Raises PixsimError if A_Vt is negative, or another number is not positive.
    """
    return 1e-3 * threshold_mv_um / math.sqrt(follower_area_um2) * node_capacitance_ff * E_PER_FC


def dark_current_of_geometry_e_per_s(
    area_na_per_cm2: NotNegative,
    perimeter_na_per_cm: NotNegative,
    area_um2: Positive,
    perimeter_um: NotNegative,
) -> float:
    """Return the dark current of a photodiode in e-/s: generation under its area and along its
    isolation.

    The perimeter's part grows with the reciprocal of the side, so that small pixels have more dark
    current per area.

    area_na_per_cm2, perimeter_na_per_cm : current densities at the reference temperature
    area_um2, perimeter_um : of the photodiode

    Raises PixsimError if a density or the perimeter is negative, or the area is not positive.
    """
    area_e_per_s = area_na_per_cm2 * 1e-9 * _A_PER_CM2_TO_E_PER_S_UM2 * area_um2
    return (
        area_e_per_s
        + perimeter_na_per_cm * _UM_PER_CM * 1e-9 * _A_PER_CM2_TO_E_PER_S_UM2 * perimeter_um
    )


@dataclass(frozen=True)
class DarkSpread:
    """Dark currents of pixels relative to their mean: gamma-distributed ones, and a tail of hot
    pixels with a log-normal law.

    dsnu : spread of the ordinary pixels, relative to their mean
    hot_fraction : of all pixels
    hot_median : of hot pixels, relative to the mean of ordinary ones
    hot_spread : standard deviation of the natural logarithm of hot pixels' currents

    The mean over all pixels is 1: the stated dark current holds hot pixels too, and ordinary ones
    have less.
    """

    dsnu: float
    hot_fraction: float = 0.0
    hot_median: float = 1.0
    hot_spread: float = 0.0

    @property
    def ordinary_mean(self) -> float:
        """Mean of ordinary pixels, relative to the mean of all: 1/(1 - φ + φ m), with the hot
        pixels' mean m = median · e^(s²/2).
        """
        hot_mean = self.hot_median * math.exp(self.hot_spread**2 / 2)
        total = 1 - self.hot_fraction + self.hot_fraction * hot_mean
        return 1 / total if total else math.inf

    @property
    def variance(self) -> float:
        """Variance over all pixels, relative to the mean squared: c²[(1 - φ)(1 + dsnu²) + φ median²
        e^(2s²)] - 1.
        """
        ordinary = (1 - self.hot_fraction) * (1 + self.dsnu**2)
        hot = self.hot_fraction * self.hot_median**2 * math.exp(2 * self.hot_spread**2)
        return self.ordinary_mean**2 * (ordinary + hot) - 1

    @property
    def deviation(self) -> float:
        """Standard deviation over all pixels, relative to the mean: √variance, or `dsnu` without
        hot pixels.
        """
        return math.sqrt(max(self.variance, 0.0)) if self.hot_fraction else self.dsnu

    @property
    def is_uniform(self) -> bool:
        """Whether all pixels have the same current, to rounding: 1/dsnu² of smaller spreads would
        overflow.
        """
        return bool(self.dsnu <= np.finfo(float).eps) and not self.hot_fraction

    def sample(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draw relative dark currents of a shape (...) from `rng`, their mean 1.

        Hot pixels have a stream of their own, so that `rng` goes on as without them.
        """
        if self.dsnu > np.finfo(float).eps:
            factors = rng.gamma(self.dsnu**-2, self.dsnu**2, shape)
        else:
            factors = np.ones(shape)

        if self.hot_fraction:
            hot_rng = rng.spawn(1)[0]
            hot = hot_rng.random(shape) < self.hot_fraction
            normal = hot_rng.standard_normal(int(np.count_nonzero(hot)))
            factors[hot] = self.hot_median * np.exp(self.hot_spread * normal)
            factors *= self.ordinary_mean
        return factors
