"""Error against run time of a scene's mean ΔE; `extreme_cases` is a table of cases with known
answers.

Input: a scene and settings. Output: an `Accuracy` (`ladder`).
May import: base, light, optics, sensor, scene, viewer, studies.
"""
