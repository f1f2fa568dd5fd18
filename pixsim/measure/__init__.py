"""Measurements by EMVA 1288, ISO 15739, ISO 12232 and ISO 12233 on simulated frames, next to the true values.

Input: a pixel, or a picture of an edge. Output: a data sheet, or an e-SFR. In the order of the flow: `experiment` (frames),
`estimators` (values with standard errors), `datasheet`, `datasheet_report`; `sfr` is the slanted edge.
May import: base, light, optics, sensor, show, viewer.
"""
