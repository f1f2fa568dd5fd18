"""Mean ΔE against pixel size: `Study` in, `result.StudyResult` out, with optima, their intervals and an error budget.

`study` runs one: `evaluations` on the workers of `engine`, `allocation` says where more of them help, `optimum` fits the curve.
`budget` is what a result's error is made of, `claims` what the paper says, `sensitivity` one assumption moved at a time.
May import: base, light, optics, sensor, scene, show, viewer.
"""
