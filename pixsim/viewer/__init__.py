"""From a sensor frame to its score: `Frame` and irradiance in; displayed pictures, ΔE map and
metrics out.

Settings of users: `display_options`, `develop_options`, `metric_options`, and `setting`, all that a
frame and its score depend on, read from files by `settings_file`; these do not import NumPy.
`without_effect` finds those that do nothing. `imaging` lists the modules in the order of the light.
`demosaic`, `denoising`, `colour_matrix`, `sharpening` and `tone` are the kernels of development,
`display` and `scielab` those of the viewer, `metric_kernels` those of the other metrics.
`noise_budget` and `causes` explain a mean ΔE. May import: base, light, optics, sensor.
"""
