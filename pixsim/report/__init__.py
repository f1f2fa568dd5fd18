"""A score or a `StudyResult` to a folder: JSON, CSV, figures and report.html.

`run` makes a picture and its folder, `study` a study's; `views` are the pictures in it, `paper` the figures of the paper,
`wording` results as sentences.
May import: base, light, optics, sensor, scene, show, viewer, studies.
"""
