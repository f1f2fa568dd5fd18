"""Error against run time of a scene's mean ΔE; `extreme_cases` is a table of cases with known answers.

Input: a scene and settings. Output: an `Accuracy` (`ladder`) with its document (`report`).
May import: base, light, optics, sensor, scene, show, viewer, studies, report.
"""
