"""Measurements by EMVA 1288, ISO 15739, ISO 12232 and ISO 12233 on simulated frames, next to the
true values; and of a lens.

Input: a pixel, a picture of an edge, or a lens. Output: a data sheet, an e-SFR, or spots, PSFs and
MTFs. In the order of the flow: `experiment` (frames), `estimators` (values with standard errors),
`datasheet`; `sfr` is the slanted edge, `lens` traces. May import: base, light, optics, sensor,
viewer.
"""
