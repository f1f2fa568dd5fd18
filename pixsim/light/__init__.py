"""Spectral irradiance on the sensor plane, W m⁻² nm⁻¹: the value that flows from the renderer to the sensor.

In: arrays, or a file of pixsim's own (`exr`) or of another program (`foreign`). Out: `spectral.SpectralImage`.
May import: base.
"""
