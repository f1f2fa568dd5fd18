"""A pixel, or a picture of an edge, to what EMVA 1288, ISO 15739, ISO 12232 and ISO 12233 report, next to what is true.

In the order of the flow: `experiment` (frames), `estimators` (numbers with their errors), `datasheet`, `datasheet_report`; `sfr`
is the slanted edge.
May import: base, light, optics, sensor, show, viewer.
"""
