"""Error against run time, and what a result's error is made of: `pixsim accuracy` and `--tolerance-delta-e`.

`probe` says what a picture gives (electrons, mean ΔE, optimal pitch); `reference` what is right; `ladders` moves one
setting at a time; `fits` finds orders of convergence and the Pareto front; `budget` splits a result's error by its source;
`choice` picks settings for a tolerance; `plots` and `page` show it.
"""
