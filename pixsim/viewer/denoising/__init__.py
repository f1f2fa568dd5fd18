"""Denoising of planes of electrons: pure functions of arrays, without sensor settings.

`anscombe` makes the noise of a sensor white and of variance 1, and leads back, and `variance_table`
noise of any variance; `filters` has the filters between the two; `wiener` has the linear,
shift-invariant filter that no other such filter beats.
"""
