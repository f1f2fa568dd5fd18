"""Mean ΔE against pixel size: `Study` in, `result.StudyResult` out, with optima, their intervals and the errors of their light.

What a user states: `study_settings` (with `axis`, `condition`, `pitch_range`), from the layers of `study_layers`, without NumPy.
`study` runs a study: `cases` of its axes and conditions, `evaluations` on the workers of `engine`; `optimum` fits the curve,
`allocation` chooses further evaluations. `film_error` measures the error of a film, `claims` checks the paper's statements in each
case. `uncertainty` draws all unknown numbers together, and `indices` says which of them matter. `compare` compares sensors, as they
are, in one field of view; `run` scores one picture of one sensor. What pages show beside the curves: `merit` (MTF of each
blur term), `parts` (what errors of colour sensors are made of), `extent`, `light_level`, `unconverged`; `outline` is what a
study would do.
May import: base, light, optics, sensor, scene, viewer.
"""
