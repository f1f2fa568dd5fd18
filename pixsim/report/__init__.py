"""Write a score or a `StudyResult` to a folder: JSON, CSV, figures and report.html.

`run` simulates and writes a single picture, `study` writes a study's report. `views` holds its pictures, `paper` the figures
of Chen et al. (2000), `wording` the results as sentences.
May import: base, light, optics, sensor, scene, show, viewer, studies.
"""
