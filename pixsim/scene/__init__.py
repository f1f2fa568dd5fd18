"""Mitsuba XML to spectral irradiance with its noise: `scene.Scene` and `Camera` in, `SpectralImage`
out.

In the order of the flow:
- reading: `variants` (which variant of Mitsuba runs here, with the `trial` render), `guard` (what a
  scene may say and name; where
  it is traced), `illuminance` (lamps scaled to lux), `tree` (the parsed scene), `scene`
- inspection: `contents` (lamps, surfaces, shapes, textures), `inspection`
- plan: `bands`, `film`, `rules` and `real_lens` (what can be left out), `white_plate`, `plan`
- render: `job` (the work of a tracer, as plain numbers and texts), `renderer`, `convergence`

`charts` makes the textures of test charts. Only `mitsuba` imports Mitsuba.
May import: base, light, optics, sensor, and settings of viewer.
"""
