"""Visual noise of an even patch, as ISO 15739:2013, annex B, has it: what the eye leaves of noise,
in CIELUV.

XYZ adapted to equal energy (Bradford) → opponent channels A = Y, C₁ = X - Y, C₂ = 0.4 (Y - Z) → the
eye's contrast sensitivity for each, which keeps their means → back → CIELUV → standard deviations,
weighted. The patch is reflected at its edges (DCT), where the standard's FFT repeats it.

[ISO] ISO 15739:2013, annex B. Its edition of 2023 has other sensitivities, and CIELAB; numbers of
    the two do not compare.
[BCEP] D. Baxter, F. Cao, H. Eliasson & J. Phillips, "Development of the I3A CPIQ spatial metrics",
    Proc. SPIE 8293 (2012) 829302.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array, Positives, dct, empty_planes, inverse_dct, mixed
from pixsim.base.bounds import FINITE, Positive
from pixsim.base.errors import invalid
from pixsim.viewer.display import WHITE_XYZ
from pixsim.viewer.metric_kernels.sharpness import luminance_csf
from pixsim.viewer.scielab import CIE_LAB, checked_white

WEIGHTS = (1.0, 0.852, 0.323)  # of the deviations of L*, u* and v* [ISO]
OPPONENT = np.array([[0.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.4, -0.4]])
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
# (weight, decay, power) of the terms w e^(-d ν^p) of C₁ and C₂, and what they are divided by
# [BCEP].
_CHROMA = (
    (((109.1413, 0.00038, 3.4244), (93.5971, 0.00367, 2.1677)), 202.7384),
    (((7.0328, 0.000004, 4.2582), (40.6910, 0.10391, 1.6487)), 40.6910),
)


def visual_noise(
    picture: Annotated[Array, FINITE], samples_per_deg: Positive, white_xyz: Positives | None = None
) -> float:
    """Return σ(L*) + 0.852 σ(u*) + 0.323 σ(v*) of a uniform patch behind the eye's filters, a
    number in units of CIELUV. [ISO]

    The filters keep the mean, and amplify noise near 4 cy/deg threefold. Below 0 filtered XYZ is
    taken as 0.

    picture : (H, W) relative luminance of a grey patch, 1 for white, or (H, W, 3) XYZ in the unit
        of the white
    samples_per_deg : of the display
    white_xyz : (3,) XYZ of white. None means the white of D65 with Y = 100

    Raises PixsimError for another shape, or a white that is not positive.

    >>> visual_noise(np.full((8, 8), 0.5), 30.0)
    0.0
    """
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)) or not picture.size:
        raise invalid(
            "picture",
            f"an array of shape {picture.shape}",
            "(H, W), or (H, W, 3) for XYZ, not empty",
        )
    white = checked_white(WHITE_XYZ if white_xyz is None else white_xyz)
    if picture.ndim == 2:
        luminance = _filtered(np.asarray(picture, float)[None], samples_per_deg)[0]
        return float(_lightness(luminance).std())

    # XYZ adapted to equal energy → opponent channels → the eye's filters → XYZ.
    cone_ratios = _BRADFORD.sum(axis=1) / (_BRADFORD @ white)
    adaptation = np.linalg.inv(_BRADFORD) @ np.diag(cone_ratios) @ _BRADFORD
    to_opponent = OPPONENT @ adaptation
    planes = [np.ascontiguousarray(picture[..., channel], float) for channel in range(3)]
    filtered = _filtered(mixed(to_opponent, planes), samples_per_deg)
    x, y, z = np.maximum(mixed(np.linalg.inv(to_opponent), list(filtered)), 0.0)

    # CIELUV: u* and v* are 13 L* times the differences of u′ and v′ from those of the white.
    lightness = _lightness(y / white[1])
    denominator = x + 15 * y + 3 * z
    white_denominator = white[0] + 15 * white[1] + 3 * white[2]
    has_light = denominator > 0
    deviations = [lightness.std()]
    for plane, factor, white_component in ((x, 4.0, white[0]), (y, 9.0, white[1])):
        white_chromaticity = white_component / white_denominator
        chromaticity = np.divide(
            plane, denominator, out=np.full(y.shape, white_chromaticity), where=has_light
        )
        difference = 13 * lightness * factor * (chromaticity - white_chromaticity)
        deviations.append(difference.std())
    return float(
        sum(weight * deviation for weight, deviation in zip(WEIGHTS, deviations, strict=True))
    )


def _lightness(relative: Array) -> Array:
    """Return L* (CIE 15) of Y/Yn; 0 below 0."""
    threshold, _, dark_slope = CIE_LAB
    light = np.maximum(relative, 0.0)
    return np.where(light > threshold, 116 * np.cbrt(light) - 16, dark_slope * light)


def _filtered(channels: Array, samples_per_deg: float) -> Array:
    """Return the opponent channels (1 or 3, H, W) as the eye's filters leave them."""
    count, height, width = channels.shape
    planes = empty_planes(count, height, width)
    planes[...] = channels
    coefficients = dct(planes)

    along_y = np.arange(height) / (2 * height) * samples_per_deg
    along_x = np.arange(width) / (2 * width) * samples_per_deg
    frequency = np.hypot(along_y[:, None], along_x)
    gains = [luminance_csf(frequency)]
    for terms, scale in _CHROMA[: count - 1]:
        gain = np.zeros(())
        for weight, decay, power in terms:
            gain = gain + weight * np.exp(-decay * frequency**power)
        gains.append(gain / scale)

    for plane, gain in zip(coefficients, gains, strict=True):
        gain[0, 0] = 1.0
        plane *= gain
    return inverse_dct(coefficients)
