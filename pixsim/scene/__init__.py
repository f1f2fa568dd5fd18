"""Mitsuba XML to spectral irradiance with its noise: `scene.Scene` and `Camera` in, `SpectralImage` out.

In the order of the flow: `variants` (which variant of Mitsuba can run here), `guard` (what a scene
may say and name, inspected; and where it is traced), `illuminance` (lamps scaled to
lux), `tree` (the parsed scene), `scene`, `contents` (lamps, surfaces, shapes, textures), `bands`, `rules` (what can be left out),
`plan`, `renderer`, `convergence`.
`charts` makes the textures of test charts. Only `mitsuba` imports Mitsuba.
May import: base, light, optics, sensor, and settings of viewer.
"""
