"""Mitsuba XML to spectral irradiance with its noise: `scene.Scene` and `Camera` in, `SpectralImage` out.

In the order of the flow: `files` (what may be read), `scene`, `contents` (lamps, surfaces, shapes, textures), `bands`, `rules`
(what can be left out), `plan`, `renderer`, `convergence`; `charts` makes the textures of test charts. `mitsuba` is the only file
that imports Mitsuba, `variant` decides which of its variants can run.
May import: base, light, optics, sensor.
"""
