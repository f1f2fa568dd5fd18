"""What a viewer sees of a sensor frame: `Frame` and irradiance in; shown pictures, ΔE map and
statistics out.

What a user states: `display_options`, `develop_options`, and `setting`, all that a frame and its
score depend on, from the files of `settings_file`; these do not import NumPy. `without_effect` says
which of them do nothing. In the order of the flow: `demosaic`, `colour_matrix` and `develop`
(frames with colour filters), `display` (electrons to light on the display's dots), `scielab`
(S-CIELAB), `score` (all of it, from irradiance to mean ΔE), `parts` (what a mean ΔE is made of).
`judges` are other measures of frames and pictures, and `denoising` has the filters of a raw frame.
May import: base, light, optics, sensor.
"""
