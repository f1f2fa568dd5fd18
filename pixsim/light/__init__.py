"""Spectral irradiance on the sensor plane, W m⁻² nm⁻¹: what the renderer gives to the sensor.

In: arrays, or a file of pixsim (`exr`) or of another program (`foreign`). Out:
`spectral.SpectralImage`. What a user states against wavelength: `curves`, from files that `tables`
reads, with the bounds of `quantities`; these do not import NumPy. May import: base.
"""
