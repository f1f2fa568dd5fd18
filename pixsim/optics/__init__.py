"""Lenses: f-number, field and wavelength in, irradiance factor, optical transfer function and wavefronts out.

`thin_lens` turns radiance into irradiance, `diffraction` blurs by a circular pupil, `exchange` reads the light of other
programs as irradiance on the sensor. `pupil` has the directions of the light at a point of the sensor, `stack` the photodiodes
that it reaches through microlenses or openings. A real lens is read by `prescription`, with the media of `glass`; `lens` traces
it with the rays of `ray_trace`, and `lens_waves` hands its wavefronts to `field_blur`, which makes PSFs of them.
May import: base, light.
"""

from pixsim.optics.diffraction import cutoff_cy_per_mm, diffract, diffract_sum, diffraction_otf, square_aperture_mtf, white_otf
from pixsim.optics.stack import stack_collection
from pixsim.optics.thin_lens import field_factor, irradiance_factor

__all__ = [
    "cutoff_cy_per_mm", "diffract", "diffract_sum", "diffraction_otf", "field_factor", "irradiance_factor",
    "square_aperture_mtf", "stack_collection", "white_otf",
]  # fmt: skip
