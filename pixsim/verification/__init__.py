"""Error against run time of a scene's results; `stability` holds extreme cases with known answers.

Input: a scene and settings. Output: a survey with its report. In the order of the flow: `reference` (true values), `ladders`
(one setting varied at a time), `orders` (of convergence), `solvers` (of the photodiode), `report`, `result`, `survey`.
May import: base, light, optics, sensor, scene, show, viewer, studies, report.
"""
