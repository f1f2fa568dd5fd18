"""Lenses that several tests measure."""

from functools import cache

import pixsim
from pixsim.measure.lens import LensData, lens_data


@cache
def triplet() -> LensData:
    return lens_data(pixsim.load_lens("cooke_triplet"), [550.0], 4.0)
