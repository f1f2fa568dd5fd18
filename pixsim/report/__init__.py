"""Write the result of a run, a study or a comparison to a folder: JSON, CSV, figures and report.html.

`run` writes the files and the page of a single picture, `study` the report of a study, `compare` that of a comparison. `views`
holds a study's pictures, `paper` the figures of Chen et al. (2000), `wording` the results as sentences, `lens` the page of a lens.
May import: base, show, studies, measure, and settings of other packages.
"""
