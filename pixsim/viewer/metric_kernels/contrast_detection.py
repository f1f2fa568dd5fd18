"""Contrast detection probability of IEEE P2020: how surely two pixels show a contrast."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from pixsim.base.arrays import Array, Finites, NotNegatives, Positives
from pixsim.base.bounds import Positive, check_broadcast
from pixsim.base.errors import invalid


def contrast_detection_probability(
    mean_e: Positives,
    contrast: Positive,
    deviation_a_e: NotNegatives,
    deviation_b_e: NotNegatives,
    tolerance: Positive = 0.5,
) -> Array:
    """Return the probability that the Weber contrast of two pixels is within a share of the true
    one, (...) as the means.

    With means a and b = a (1 + c) and normal noise s_a, s_b, the contrast K of two pixels is below
    k with the probability Φ(((1 + k) a - b)/√(s_b² + (1 + k)² s_a²)) (Geary, J. R. Stat. Soc. 93
    (1930) 442). This holds where a ≥ 4 s_a; below, pixels without signal have a probability of
    Φ(-a/s_a), 3e-5 there, and no contrast.

    mean_e : a, of the darker patch
    contrast : c
    deviation_a_e, deviation_b_e : s_a and s_b, of single pixels of the darker and the brighter one
    tolerance : d, a share of c: contrasts from c (1 - d) to c (1 + d) count

    Raises PixsimError if the arrays cannot be broadcast together.

    Read noise of 2 e- and a contrast of 10 %:

    >>> a = np.array([100.0, 1000.0, 10_000.0])
    >>> contrast_detection_probability(a, 0.1, np.sqrt(a + 4), np.sqrt(1.1 * a + 4)).round(4)
    array([0.2533, 0.7009, 0.999 ])
    """
    a_e = np.asarray(mean_e, float)
    s_a = np.asarray(deviation_a_e, float)
    s_b = np.asarray(deviation_b_e, float)
    check_broadcast(mean_e=a_e.shape, deviation_a_e=s_a.shape, deviation_b_e=s_b.shape)
    if not np.any(s_a) and not np.any(s_b):
        raise invalid("deviation_a_e and deviation_b_e", "0 everywhere", "noise in some patch")

    return detection_probability((a_e, (1 + contrast) * a_e), (s_a, s_b), contrast, tolerance)


def detection_probability(
    means: tuple[Array, Array], deviations: tuple[Array, Array], contrast: float, tolerance: float
) -> Array:
    """Return `contrast_detection_probability` of a darker and a brighter pixel whose means need not
    have the contrast, (...): where one of them is full they have less.
    """

    def below(factor: float) -> Array:
        """Probability of a contrast below `factor` times the true one."""
        ratio = 1 + factor * contrast
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (ratio * means[0] - means[1]) / np.hypot(deviations[1], ratio * deviations[0])
        return np.asarray(ndtr(z))

    return np.asarray(below(1 + tolerance) - below(1 - tolerance))


def contrast_detection_share(
    darker: Finites, brighter: Finites, contrast: Positive, tolerance: Positive = 0.5
) -> float:
    """Return the share of pairs of a darker and a brighter pixel whose Weber contrast is within a
    share of the true one: `contrast_detection_probability`, from frames of two uniform patches.

    darker, brighter : signals of pixels without black level, such as `Frame.estimate_e`, (...)
        each; pairs with a darker pixel of 0 or less count as not detected
    contrast : true Weber contrast
    tolerance : a share of it: contrasts that differ by more do not count

    Raises PixsimError without pixels.

    >>> contrast_detection_share(np.array([100.0, 0.0]), np.array([108.0, 110.0, 116.0]), 0.1)
    0.3333333333333333
    """
    a = np.ravel(darker)
    b = np.sort(brighter, axis=None)
    if not a.size or not b.size:
        raise invalid("darker and brighter", f"{a.size} and {b.size} pixels", "one at least")

    ends = [1 + (1 - tolerance) * contrast, 1 + (1 + tolerance) * contrast]
    low, high = (np.searchsorted(b, end * a[a > 0]) for end in ends)
    return float((high - low).sum() / (a.size * b.size))
