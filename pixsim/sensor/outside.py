"""Light of lamps outside 360-830 nm, the range that is computed: how much of what a sensor would see is left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.light.spectral import HIGH_NM, LOW_NM, Spectrum, photons_per_joule
from pixsim.sensor.pixel import PixelPhysics

OUTSIDE = "lamps_300_to_1110_nm_in_10"  # entry of an irradiance's header: mean power in each cell, for each lamp with light outside
# From where lenses transmit to where silicon ends: its gap of 1.12 eV is 1107 nm. 360 and 830 nm are edges.
EDGES_NM = np.arange(300.0, 1111.0, 10.0)
CENTRES_NM = (EDGES_NM[1:] + EDGES_NM[:-1]) / 2
INSIDE = (CENTRES_NM > LOW_NM) & (CENTRES_NM < HIGH_NM)
SHOWN_SHARE = 0.01  # of a lamp's light in the sensor's response
DIGITS = 6


def outside_header(lamps: Sequence[Spectrum]) -> dict[str, Any]:
    """Return the entry of an irradiance's header on lamps with light outside 360-830 nm; none if there are none."""
    cells = [lamp.cell_means(EDGES_NM) for lamp in lamps]
    beyond = [[float(f"{value:.{DIGITS}g}") for value in each] for each in cells if each[~INSIDE].any()]
    return {OUTSIDE: beyond} if beyond else {}


def outside_share(header: Mapping[str, Any], physics: PixelPhysics) -> float:
    """Return the share of a lamp's electrons in a pixel that come from outside 360-830 nm, 0 to 1: that of the lamp with the most.

    header : of an irradiance; that of a file of another program may hold anything
    """
    lamps, cells = header.get(OUTSIDE), CENTRES_NM.size
    if not isinstance(lamps, list) or not all(isinstance(lamp, list) and len(lamp) == cells for lamp in lamps):
        return 0.0
    electrons = np.array(lamps, float).reshape(-1, cells) * _response(physics)
    whole = electrons.sum(axis=1)
    return float((electrons[:, ~INSIDE].sum(axis=1) / np.where(whole > 0, whole, 1.0)).max(initial=0.0))


def _response(physics: PixelPhysics) -> Array:
    return physics.quantum_efficiency(CENTRES_NM) * photons_per_joule(CENTRES_NM)


def outside_words(share: float) -> str:
    """Return what is left out, in words."""
    percent = f"{100 * share:.0f}" if share < 0.995 else f"{100 * share:.3g}"
    return f"without {percent} % of a lamp's light in the sensor's response, outside {LOW_NM:g}-{HIGH_NM:g} nm"


def outside_hint() -> str:
    """Return what keeps such light from the sensor, in the caller's words."""
    return (
        f"an infrared filter before the sensor ({setting('pixel.infrared_cut_nm', HIGH_NM)} or less), or a lamp within that range"
    )
