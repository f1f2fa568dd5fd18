"""Error against run time: a scene and settings in, a survey with its page out; `stability` has extremes with known answers.

In the order of the flow: `reference` (what is right), `ladders` (one setting moved at a time), `solvers` (of the photodiode),
`result`, `survey`, `report`.
May import: base, light, optics, sensor, scene, show, viewer, studies, report.
"""
