"""What a viewer sees of a sensor frame: `Frame` and irradiance in; shown pictures, ΔE map and statistics out.

In the order of the flow: `demosaic`, `colour_matrix` and `develop` (frames with colour filters), `display` (electrons to light on
the display's dots), `scielab` (S-CIELAB), `score` (all of it, from irradiance to
mean ΔE), `parts` (what a mean ΔE is made of).
May import: base, light, optics, sensor, show.
"""
