"""Error against run time of a scene's results; `stability` holds extreme cases with known answers.

Input: a scene and settings. Output: a survey with its report. In the order of the flow: `reference` (true values), `ladders`
(one setting varied at a time), `solvers` (of the photodiode), `result`, `survey`, `report`.
May import: base, light, optics, sensor, scene, show, viewer, studies, report.
"""
