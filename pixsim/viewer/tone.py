"""Tone curves: light, 1 for the scene's white → light that the display shows, 1 for its white.

A curve of values ('gamma', 'srgb', a table) is what a camera does: it hands a value to the display,
which shows value^γ. The display's law then sets the light, so that 'none' stands for the inverse of
this law. A global operator ('reinhard') makes light of light. A curve of values holds for each
primary, the operator for the luminance, whose factor all primaries have.

sRGB: IEC 61966-2-1. Operator: E. Reinhard, M. Stark, P. Shirley & J. Ferwerda, "Photographic tone
reproduction for digital images", ACM Trans. Graph. 21 (2002) 267, equation 4.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pixsim.base.arrays import Array, Numbers, mixed
from pixsim.base.bounds import Positive
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import WHITE_XYZ, XYZ_FROM_RGB
from pixsim.viewer.display_options import Display

_SRGB_LINEAR_TO = 0.0031308
_SRGB_SLOPE = 12.92
_SRGB_SCALE = 1.055
_SRGB_OFFSET = 0.055
_SRGB_GAMMA = 2.4


def _srgb_value(light: Numbers) -> Array:
    """Return the value of sRGB (IEC 61966-2-1), 0 to 1, (...) as the light, which is clipped to 0 …
    1.

    >>> _srgb_value(0.214).round(4).item()
    0.5
    """
    inside = np.clip(light, 0.0, 1.0)
    curved = _SRGB_SCALE * inside ** (1 / _SRGB_GAMMA) - _SRGB_OFFSET
    return np.asarray(np.where(inside <= _SRGB_LINEAR_TO, _SRGB_SLOPE * inside, curved))


def reinhard(luminance: Numbers, white: Positive) -> Array:
    """Return the displayed luminance L(1 + L/w²)/(1 + L), (...) as the luminance L: 1 at w. Values
    below 0 are unchanged.

    Reinhard et al. (2002), equation 4.

    luminance : (...) 1 for the scene's white
    white : w, the luminance that is shown as white

    >>> reinhard([0.0, 1.0, 4.0], 4.0).tolist()
    [0.0, 0.53125, 1.0]
    """
    values = np.asarray(luminance)
    return np.asarray(values * _factor(values, white))


def _factor(luminance: Array, white: float) -> Array:
    above = np.maximum(luminance, 0.0)
    return np.asarray((1 + above / white**2) / (1 + above))


def luminance_of(light: Array) -> Array:
    """Return the luminance, (H, W), 1 for white, of light of the dots, (H, W) or of the display's
    primaries (3, H, W).
    """
    return light if light.ndim == 2 else mixed(XYZ_FROM_RGB[1:2] / WHITE_XYZ[1], list(light))[0]


def toned(light: Array, develop: Develop, display: Display) -> Array:
    """Return light behind the tone curve, in the shape (H, W) or (3, H, W) and the precision of the
    light.
    """
    if not develop.tone:
        return light
    curve = develop.tone_curve
    if curve == "reinhard":
        return np.asarray(light * _factor(luminance_of(light), develop.tone_white), light.dtype)
    values: Callable[[Array], Array]
    if curve == "gamma":
        values = lambda inside: inside ** (1 / develop.tone_gamma)  # noqa: E731
    elif curve == "srgb":
        values = _srgb_value
    else:
        assert not isinstance(curve, str)
        table_light, table_value = np.array(curve).T
        return np.asarray(np.interp(light, table_light, table_value) ** display.gamma, light.dtype)
    return np.asarray(values(np.clip(light, 0.0, 1.0)) ** display.gamma, light.dtype)
