"""What light a sensor can be shown: finite, and not negative."""

from __future__ import annotations

import math

import numpy as np

from pixsim.errors import refuse
from pixsim.spectral import SpectralImage

LARGEST = float(np.finfo(np.float32).max)


def refuse_impossible_light(irradiance: SpectralImage) -> None:
    """PixsimError for light that is not finite, or negative where it is not one of several factors that add up."""
    picture = irradiance.factors[1] if irradiance.factors else irradiance.data
    spectra = irradiance.factors[0] if irradiance.factors else np.ones((1, 1))
    low, high = (float(picture.min()), float(picture.max())) if picture.size else (math.nan, math.nan)  # NaN comes through both
    beside = irradiance.pitch_um, irradiance.wavelength_nm, irradiance.band_width_nm, *irradiance.within, spectra
    if not all(np.abs(each).max() <= LARGEST for each in (low, high, *beside)):
        raise refuse(
            "irradiance",
            f"a picture from {low:g} to {high:g}, or what goes with it",
            f"light, spectra and bands that are finite, at most {LARGEST:.4g}",
        )
    if len(spectra) == 1 and min(low, float(spectra.min())) < 0:
        raise refuse("irradiance", f"values from {low:g} to {high:g}", "0 and more", "Take what is below zero for darkness first.")
