"""Mitsuba XML to spectral irradiance with its noise: `scene.Scene` and `Camera` in, `SpectralImage` out.

In the order of the flow: `files` (the XML as a tree), `plugins` (what a scene may say), `assets` and `meshes` (files that it
names), `judge` (the text for Mitsuba), `illuminance` (lamps scaled to lux), `scene`, `contents` (lamps, surfaces, shapes,
textures), `bands`, `rules` (what can be left out), `plan`, `tracer` (Mitsuba at work; `child` and `worker` do the same in another
process), `renderer`, `convergence`.
`charts` makes the textures of test charts. Only `mitsuba` imports Mitsuba; `variant` chooses a variant that can run.
May import: base, light, optics, sensor.
"""
