"""Lamps known in closed form, by tables and constants outside the code under test."""

import numpy as np

from pixsim.light import spectral

# cd/m² of Mitsuba's d65 at scale 1: 683.002 ∫ȳL of what the plugin returns, measured outside pixsim
D65_LUMINANCE = 72904.0


def d65_radiance(wavelength_nm: np.ndarray, luminance_cd_per_m2: float) -> np.ndarray:
    """D65 of a luminance, W m⁻² sr⁻¹ nm⁻¹, from CIE's tables."""
    nm = np.arange(360.0, 831.0)
    lumens = (
        spectral.LUMINOUS_EFFICACY_LM_PER_W
        * (spectral.photopic_efficiency(nm) * spectral.d65(nm)).sum()
    )
    return spectral.d65(wavelength_nm) * luminance_cd_per_m2 / lumens
