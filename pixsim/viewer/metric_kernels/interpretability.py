"""Interpretability of a picture from above: NIIRS by the General Image Quality Equation, version 5
(NGA, 16 September 2015).
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from pixsim.base.arrays import NotNegativeArray
from pixsim.base.bounds import SMALLEST, Bounds, Positive
from pixsim.viewer.metric_kernels.sharpness import Frequencies, curve_from_0

_M_PER_INCH = 0.0254
_MAX_RER = 10.0  # far above any: sharpened pictures of the fit reach 1.3

EdgeResponse = Annotated[float, Bounds(SMALLEST, _MAX_RER)]


def niirs(rer: EdgeResponse, ground_m: Positive, snr: Positive) -> float:
    """Return the National Imagery Interpretability Rating of a picture taken straight down, a
    number on its scale of 0 to 9.

        9.57 - 3.32 lg GSD + 3.32 (1 - e^(-1.9/SNR)) lg RER - 2 lg⁴ RER - 1.8/SNR

    with GSD in inches; GIQE-5, NGA (2015). It was fitted to pictures of RER 0.2 to 1.3, and beyond
    1 the term lg⁴ turns round.

    rer : relative edge response, a ratio: the rise of a unit edge from half a pixel before to half
        a pixel behind it (`relative_edge_response`); of two directions (max · min²)^(1/3)
    ground_m : ground sample distance, the pitch on the ground
    snr : ratio of the difference of the signals of reflectances 15 % and 7 % to the noise at the
        brighter one

    >>> round(niirs(0.35, 0.52832, 50.0), 3)  # the example of the NGA: 20.8 inches, level 5
    5.015
    """
    log_rer = math.log10(rer)
    edge_term = 3.32 * -math.expm1(-1.9 / snr) * log_rer - 2 * log_rer**4
    return 9.57 - 3.32 * math.log10(ground_m / _M_PER_INCH) + edge_term - 1.8 / snr


def relative_edge_response(frequency_cy_per_px: Frequencies, mtf: NotNegativeArray) -> float:
    """Return the rise of a unit edge within half a pixel on either side of it, 2 ∫ MTF(f) sinc(f)
    df, a number, 1 for no blur.

    NGA (2015). The MTF is straight between the frequencies, and 0 beyond the last.

    frequency_cy_per_px : (n,) rising
    mtf : (n,) along the axis across the edge, 1 at frequency 0

    Raises PixsimError if the frequencies do not rise, or the shapes differ.
    """
    frequency, mtf = curve_from_0("frequency_cy_per_px", frequency_cy_per_px, mtf)
    return float(2 * np.trapezoid(mtf * np.sinc(frequency), frequency))
