"""The lens, in closed forms: f-number, field and wavelength in, irradiance factor and optical transfer function out.

`thin_lens` is radiance to irradiance, `diffraction` the blur of a circular pupil, `exchange` light from other programs, as
irradiance on the sensor.
May import: base, light.
"""

from pixsim.optics.diffraction import cutoff_cy_per_mm, diffract, diffract_sum, diffraction_otf, square_aperture_mtf, white_otf
from pixsim.optics.thin_lens import field_factor, irradiance_factor

__all__ = [
    "cutoff_cy_per_mm", "diffract", "diffract_sum", "diffraction_otf", "field_factor", "irradiance_factor",
    "square_aperture_mtf", "white_otf",
]  # fmt: skip
