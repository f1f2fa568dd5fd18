"""Mean ΔE against pixel size: `Study` in, `result.StudyResult` out, with optima, their intervals
and the errors of their light.

`settings` and `files` have what a user states; `design` makes cases of it, `prepare` checks them,
`lights` renders, `evaluate` fills the `table`. `curve` (with `optimum`), `regret`, `paired`,
`uncertainty` and `claims` are functions of a table. `study`, `run`, `sweep` and `compare` are the
commands. Results are records: report/ plots, writes and shows them. May import: base, light,
optics, sensor, scene, viewer.
"""
