"""Causes of a mean ΔE other than the sensor's noise and blur, which make it meaningless.

They are light that is not computed, an ideal image without contrast, an ADC with too few codes for
the picture, and full pixels. A frame is uninformative if all pixels are full, or if light changes
no code.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.digits import percent
from pixsim.sensor.code_moments import moments_of_codes
from pixsim.sensor.flicker import burst_modulation, clipped_light
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.reading import Readout
from pixsim.sensor.spectral_range import (
    NOTED_SHARE,
    outside_hint,
    outside_share,
    outside_share_text,
)
from pixsim.viewer.display import setting_of_white
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scielab import xyz_to_lab
from pixsim.viewer.score import NOTHING, Cause

_MIN_CODES = 8.0  # between black and display white; with fewer, the ADC makes the picture
_SEEN_LIGHTNESS = 1.0  # of L*: the smallest difference that is noticeable
_BLACK_TO_WHITE_DELTA_E = 100.0  # ΔE from black to white
SATURATED_SHOWN = 0.01  # of the pixels; the tail of shot noise fills fewer
_LINEAR_BELOW = 8.0  # of L*, which is linear in luminance there (CIE 15)
ROUNDING = 1e-9  # of a number of codes
_MIN_SNR = 1e-3  # of the lightest dot in a pixel; a million pixels have 1 together
_ALL_SATURATED = 1.0 - 1e-6  # of the pixels
NO_NOISE_DN = 1e-9  # σ used in place of 0


def causes_of(
    imaging: Imaging,
    header: Mapping[str, Any],
    *,
    white_e: float,
    integration_s: float,
    lightness: tuple[float, float],
    saturated_fraction: float = 0.0,
) -> tuple[Cause, ...]:
    """Return the causes of a score, the largest first.

    header : of the irradiance
    white_e : mean electrons of the scene's white on axis, in this time
    lightness : L* of the darkest and the lightest dot of the ideal image (`lightness_range`)
    saturated_fraction : of the pixels of a frame
    """
    readout = imaging.readout
    darkest, lightest = lightness
    modulation = burst_modulation(imaging.exposure, integration_s)

    # Of the sensor there is one cause: too few codes explain more than full pixels do.
    sensor_cause = _code_cause(readout, white_e, integration_s, lightest)
    if sensor_cause is None:
        range_e = _range_e(readout, integration_s)
        sensor_cause = _saturation_cause(range_e, white_e, lightest, saturated_fraction, modulation)
    if is_uninformative(readout, white_e, integration_s, lightest, saturated_fraction):
        sensor_cause = _uninformative_cause(sensor_cause, saturated_fraction)

    contrast = _contrast_cause(darkest, lightest, setting_of_white(header, imaging.display))
    light = _outside_light_cause(outside_share(header, imaging.physics))
    causes = [contrast, sensor_cause, light]
    return tuple(sorted(filter(None, causes), key=lambda cause: -cause.delta_e))


def lightness_range(ideal: Array) -> tuple[float, float]:
    """Return the L* of the darkest and the lightest dot of an ideal image, as shown.

    In colour they are of the primary that differs most: a change of colour is contrast too.

    ideal : (H, W) luminance, or (H, W, 3) light of the display's primaries, 1 for white
    """
    planes = ideal.reshape(-1, ideal.shape[2] if ideal.ndim == 3 else 1)
    ends = _lightness_of(np.stack([planes.min(axis=0), planes.max(axis=0)]).astype(float))
    low, high = ends[:, np.ptp(ends, axis=0).argmax()]
    return float(low), float(high)


def _lightness_of(luminance: Array) -> Array:
    """Return CIE L* of a luminance relative to white, (...)."""
    return np.asarray(xyz_to_lab(luminance[..., None] * np.ones(3), np.ones(3))[..., 0])


def _luminance_of_lightness(lightness: float) -> float:
    """Return the luminance relative to white of a CIE L*, the inverse of `_lightness_of`.

    >>> [round(_luminance_of_lightness(lightness), 6) for lightness in (0.0, 50.0, 100.0)]
    [0.0, 0.184187, 1.0]
    """
    return float(
        ((lightness + 16) / 116) ** 3 if lightness > _LINEAR_BELOW else lightness * 27 / 24389
    )


def _codes_to_white(readout: Readout, white_e: float, integration_s: float) -> float:
    """Return the codes of the ADC between black and display white, as far as the well and the ADC
    reach.

    readout : how the pixels are read
    white_e : mean electrons of the scene's white on axis, in this time
    """
    return max(0.0, min(white_e, _range_e(readout, integration_s))) * readout.dn_per_e


def _range_e(readout: Readout, integration_s: float) -> float:
    return readout.saturation_e - readout.dark_current_e_per_s * integration_s


def is_uninformative(
    readout: Readout,
    white_e: float,
    integration_s: float,
    lightest: float,
    saturated_fraction: float,
) -> bool:
    """Return whether a frame is the same in any light: all pixels are full, or the lightest dot
    moves no code out of its noise.

    The codes of a pixel are compared with its codes in the dark: the difference of their means, as
    the well, the ADC and code 0 clip them, over the standard deviation in the dark. In a burst that
    is a part of its frame's.

    readout : how the pixels are read
    white_e, integration_s, saturated_fraction : of `causes_of`
    lightest : L* of the ideal image's lightest dot
    """
    if saturated_fraction >= _ALL_SATURATED:
        return True
    if lightest < _SEEN_LIGHTNESS:  # the picture is black, whatever the sensor
        return False
    # Of a burst each part is read by itself.
    exposure = readout.burst(1)
    time_s = integration_s / readout.exposures
    signal_e = white_e * _luminance_of_lightness(lightest) / readout.exposures
    dark_e = exposure.dark_current_e_per_s * time_s
    charge_e = np.minimum(np.array([0.0, signal_e]) + dark_e, exposure.saturation_e)
    level_dn = np.minimum(
        exposure.black_level_dn + exposure.dn_per_e * charge_e, exposure.top_code_dn
    )
    sigma_dn = exposure.dn_per_e * np.sqrt(
        variance_e2(exposure, charge_e, light_e=charge_e - dark_e, dark_e=dark_e)
    )
    mean_dn, variance_dn2, _ = moments_of_codes(level_dn, np.maximum(sigma_dn, NO_NOISE_DN))
    return bool(mean_dn[1] - mean_dn[0] <= _MIN_SNR * math.sqrt(max(variance_dn2[0], 0.0)))


def _uninformative_cause(cause: Cause | None, saturated_fraction: float) -> Cause:
    """Return the cause of an uninformative frame: the sensor's cause, else full pixels or noise."""
    if cause is None and saturated_fraction >= _ALL_SATURATED:
        cause = Cause("all pixels are saturated", _BLACK_TO_WHITE_DELTA_E, _less_light())
    elif cause is None:
        remedy = (
            f"more light or time ({setting('exposure.integration_s')},"
            f" {setting('exposure.max_integration_s')})"
        )
        cause = Cause(
            "its light is lost in the noise", _BLACK_TO_WHITE_DELTA_E, f"{remedy}, or less noise"
        )
    return Cause(f"{NOTHING}: {cause.words}", _BLACK_TO_WHITE_DELTA_E, cause.hint)


def _less_light() -> str:
    return (
        f"less time ({setting('exposure.integration_s')}) or gain ({setting('exposure.gain_db')}),"
        " or a larger full well"
    )


def _code_cause(
    readout: Readout, white_e: float, integration_s: float, lightest: float
) -> Cause | None:
    range_e = _range_e(readout, integration_s)
    codes = _codes_to_white(readout, white_e, integration_s)
    lightest_e = white_e * _luminance_of_lightness(lightest)
    lightest_codes = _codes_to_white(readout, lightest_e, integration_s)
    has_step = lightest_codes >= 1 or lightest < _SEEN_LIGHTNESS  # black has no contrast
    if codes >= _MIN_CODES * (1 - ROUNDING) and has_step:
        return None
    brighter = f"light, time or gain ({setting('exposure.gain_db')})"
    hint = (
        f"more bits ({setting('pixel.bits')}), {brighter}, a smaller full well, or a lower black"
        " level"
    )
    if codes >= _MIN_CODES:
        return Cause(
            f"the lightest dot is {lightest_codes:.2g} of a step of the ADC above black",
            lightest,
            hint,
        )
    words = f"only {codes:.2g} codes of the ADC between black and display white"
    if range_e <= 0:
        words = "dark charge leaves no code of the ADC for light"
        hint = f"a shorter exposure ({setting('exposure.max_integration_s')}), or a cooler sensor"
    elif white_e > range_e:
        words = f"only {codes:.2g} codes of the ADC between black and its end"
    # A step beside black; below one step, all codes may be equal.
    return Cause(words, float(_lightness_of(np.array(1 / max(codes, 1.0)))), hint)


def _contrast_cause(low: float, high: float, white: str) -> Cause | None:
    if high - low >= _SEEN_LIGHTNESS:
        return None
    hint = "its mean ΔE comes from noise and offsets alone; judge a sensor by a scene with detail"
    if high < _SEEN_LIGHTNESS:
        hint = f"it is entirely black: lower {white}, or choose a brighter part of the scene"
    elif low > _BLACK_TO_WHITE_DELTA_E - _SEEN_LIGHTNESS:
        hint = (
            f"it is entirely display white: choose a scene with detail, or raise {white} if it"
            f" clips"
        )
    return Cause(
        f"the ideal image has no contrast, L* {low:.1f} to {high:.1f}",
        _BLACK_TO_WHITE_DELTA_E,
        hint,
    )


def _saturation_cause(
    range_e: float, white_e: float, lightest: float, share: float, modulation: float
) -> Cause | None:
    """Return full pixels as a cause of ΔE.

    modulation : of the light of the exposures of a burst, each of which clips by itself
    """
    # Where display white clips too, full pixels cost nothing.
    if share <= SATURATED_SHOWN or range_e >= white_e * (1 + modulation):
        return None
    lost = lightest - float(
        _lightness_of(np.array(clipped_light(max(range_e, 0.0) / white_e, modulation)))
    )
    if lost < _SEEN_LIGHTNESS:
        return None
    return Cause(f"{percent(share)} of the pixels are saturated", lost, _less_light())


def _outside_light_cause(share: float) -> Cause | None:
    if share <= NOTED_SHARE:
        return None
    return Cause(
        outside_share_text(share),
        _BLACK_TO_WHITE_DELTA_E - float(_lightness_of(np.array(1 - share))),
        outside_hint(),
    )
