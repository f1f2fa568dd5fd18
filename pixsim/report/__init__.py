"""Plot results, write them to a folder and show them: JSON, CSV, figures and report.html.

A module for each type of result has its `PRESENTER`, which `pixsim.PRESENTERS` names: `run`, `axes`
and `study`, `curve`, `compare`, `two_results`, `table`, `score`, `sfr`, `datasheet`, `lens`,
`accuracy`. `write` writes the report of any of them. The others have figures, tables and sentences
that several of these share. May import: base, light, optics, sensor, viewer, scene, studies,
measure, verification, show.
"""
