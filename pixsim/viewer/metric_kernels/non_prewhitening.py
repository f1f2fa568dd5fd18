"""The non-prewhitening observer with an eye filter (NPWE): a human viewer of a target in a shown
picture.

Unlike the ideal observer it does not undo the colour of the noise: it compares the picture with the
target as the eye's filter leaves it. A. E. Burgess, "Statistically defined backgrounds: performance
of a modified nonprewhitening observer model", J. Opt. Soc. Am. A 11 (1994) 1237.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import FINITE, NOT_NEGATIVE, Axes, Positive
from pixsim.base.errors import invalid

_EYE_POWER = 1.3
_EYE_PEAK_CY_PER_DEG = 4.0
_EYE_DECAY = _EYE_POWER / (2 * _EYE_PEAK_CY_PER_DEG**2)  # E = f^1.3 e^(-c f²) is highest there

Difference = Annotated[Array, FINITE, Axes(2)]


def _eye_filter(shape: tuple[int, ...], samples_per_deg: float) -> Array:
    """Return Burgess's eye filter f^1.3 e^(-c f²), relative, at the frequencies of a picture's DFT,
    (H, W).
    """
    along_y, along_x = (np.fft.fftfreq(count, 1 / samples_per_deg) for count in shape)
    frequency = np.hypot(along_y[:, None], along_x)
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(frequency**_EYE_POWER * np.exp(-_EYE_DECAY * frequency**2))


def npwe_template(difference: Difference, samples_per_deg: Positive) -> Array:
    """Return what the observer multiplies a picture with and sums, (H, W) relative: the difference,
    twice through the eye's filter.

    Burgess (1994). With it d′ is known in any noise, such as the noise of simulated frames: the sum
    of template times difference over the standard deviation of the sum of template times noise.

    difference : (H, W) expected picture with the target less that without it, in relative
        luminance; it ends at the borders
    samples_per_deg : of the display
    """
    gain = _eye_filter(difference.shape, samples_per_deg) ** 2
    return np.asarray(np.fft.ifft2(np.fft.fft2(difference) * gain).real)


def npwe(
    difference: Difference, noise_power: Annotated[Array, NOT_NEGATIVE], samples_per_deg: Positive
) -> float:
    """Return d′, the ratio of signal to noise of the NPWE observer, for noise that is the same all
    over the picture.

        d′² = (∬ |ΔS|² E²)²/∬ |ΔS|² E⁴ N,  E = f^1.3 e^(-c f²), highest at 4 cy/deg

    Burgess (1994). His internal noise is left out. 0 where the eye sees nothing of the target; inf
    where it sees no noise.

    difference : (H, W) expected picture with the target less that without it, in relative
        luminance; it ends at the borders
    noise_power : (H, W) at the frequencies of `np.fft.fftfreq`, in relative luminance² deg²; or a
        number, of white noise: the variance of a dot over samples_per_deg²
    samples_per_deg : of the display

    Raises PixsimError if the shapes differ.
    """
    if noise_power.shape not in ((), difference.shape):
        raise invalid(
            "noise_power",
            f"an array of shape {noise_power.shape}",
            f"the shape of difference, {difference.shape}, or a number",
        )
    eye = _eye_filter(difference.shape, samples_per_deg)
    largest_difference = float(np.abs(difference).max())
    largest_gain = float(eye.max())
    largest_power = float(noise_power.max())
    if not largest_difference or not largest_gain:
        return 0.0
    if not largest_power:
        return math.inf

    # All in units of their largest value; a unit cell of frequency is samples_per_deg²/(H W).
    eye /= largest_gain
    seen = np.abs(np.fft.fft2(difference / largest_difference) * eye) ** 2
    signal = float(seen.sum()) / difference.size / samples_per_deg**2
    seen_noise = seen * eye**2 * (noise_power / largest_power)
    noise = float(seen_noise.sum()) / difference.size / samples_per_deg**2
    if not noise:
        return math.inf if signal else 0.0
    return largest_difference / math.sqrt(largest_power) * signal / math.sqrt(noise)
