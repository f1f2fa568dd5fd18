"""The light that a camera needs: the illuminance of a white wall at which a dot of the display has
a given SNR.
"""

from __future__ import annotations

import math
from typing import Annotated

from pixsim.base.bounds import POSITIVE_OR_INFINITE, SMALLEST, Bounds, NotNegative, Positive
from pixsim.sensor.noise import signal_at_snr_e

Reflectance = Annotated[float, Bounds(SMALLEST, 1)]
Saturation = Annotated[float, POSITIVE_OR_INFINITE]


def snr10_lx(
    white_e: Positive,
    white_cd_per_m2: Positive,
    *,
    reflectance: Reflectance,
    dark_variance_e2: NotNegative = 0.0,
    prnu: NotNegative = 0.0,
    pixels_per_dot: Positive = 1.0,
    snr: Positive = 10.0,
    saturation_e: Saturation = math.inf,
) -> float | None:
    """Return the illuminance in lx of a matt wall, π L/reflectance, at which SNR per display dot is
    10, or None if there is none.

    A dot shows the mean of n pixels of μ electrons: its SNR is √n μ/√(μ + σ_d² + (PRNU μ)²), solved
    for μ. PRNU alone may keep it below 10 in any light, or a pixel be full before. J. Alakarhu,
    "Image sensors and image quality in mobile phones", International Image Sensor Workshop (2007),
    has it for one pixel.

    white_e : mean electrons of a pixel, in the exposure time, of a surface of `white_cd_per_m2`
    reflectance : of the wall, 0 to 1
    dark_variance_e2 : of a pixel without light: dark charge, its spread, read and reset noise,
        offsets, quantisation
    prnu : of a pixel, relative
    pixels_per_dot : ratio of their areas, at least 1: a pixel of several dots gives each its own
        noise
    snr : wanted ratio
    saturation_e : electrons of a full pixel

    Raises PixsimError if a number is out of its range.
    """
    signal_e = signal_at_snr_e(snr / math.sqrt(max(pixels_per_dot, 1.0)), dark_variance_e2, prnu)
    if not signal_e <= saturation_e:
        return None
    return math.pi * white_cd_per_m2 * signal_e / white_e / reflectance
