"""Write a score or a `StudyResult` to a folder: JSON, CSV, figures and report.html.

`run` simulates and writes a single picture, `study` writes a study's report, `compare` that of a comparison. `views` holds a
study's pictures, `paper` the figures of Chen et al. (2000), `wording` the results as sentences, `lens` the page of a lens.
May import: base, show, studies, measure; `run`, and so a part of `outline`, `wording` and `compare`, still computes.
"""
