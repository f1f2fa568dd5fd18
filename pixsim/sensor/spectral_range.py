"""Light of lamps outside the range that is computed, 360-830 nm or more, that a sensor would see.

The range grows to 300-1100 nm where lamps have light there that a sensor sees (`span_of`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.light.spectral import (
    HIGH_NM,
    LOW_NM,
    VISIBLE,
    WIDEST,
    Span,
    Spectrum,
    photons_per_joule,
)
from pixsim.sensor.pixel import PixelPhysics

# entry of an irradiance's header: mean power in each cell, for each lamp with light outside
OUTSIDE = "lamps_300_to_1110_nm_in_10"
# From where lenses transmit to where silicon ends: its gap of 1.12 eV is 1107 nm. 360 and 830 nm
# are edges.
EDGES_NM = np.arange(300.0, 1111.0, 10.0)
CENTRES_NM = (EDGES_NM[1:] + EDGES_NM[:-1]) / 2
# entry of an irradiance's header: the range that is computed, where it is not 360-830 nm
_COMPUTED = "computed_nm"
# Of a lamp's electrons: with less of them outside 360-830 nm, the range does not grow.
_MIN_SHARE_BEYOND = 1e-4
NOTED_SHARE = 0.01  # of a lamp's light in the sensor's response
DIGITS = 6


def cells_in(span: Span) -> NDArray[np.bool_]:
    """Return which cells lie in a range, (cells,)."""
    return np.asarray((span.low_nm < CENTRES_NM) & (span.high_nm > CENTRES_NM))


def span_of(lamps: Sequence[Spectrum], pixels: Sequence[PixelPhysics]) -> Span:
    """Return the range to compute: 360-830 nm, and on either side what lamps emit there and one of
    the pixels sees.
    """
    low_nm = VISIBLE.low_nm
    high_nm = VISIBLE.high_nm
    channels = [channel for physics in pixels for channel in physics.channels]
    for lamp in lamps:
        power = lamp.cell_means(EDGES_NM)
        if not power[~cells_in(VISIBLE)].any():
            continue

        for channel in channels:
            electrons = power * _response(channel)
            min_electrons = _MIN_SHARE_BEYOND * float(electrons.sum())
            if electrons[CENTRES_NM < LOW_NM].sum() > min_electrons:
                low_nm = WIDEST.low_nm
            if electrons[CENTRES_NM > HIGH_NM].sum() > min_electrons:
                high_nm = WIDEST.high_nm
    return Span(low_nm, high_nm)


def outside_header(lamps: Sequence[Spectrum], span: Span = VISIBLE) -> dict[str, Any]:
    """Return entries of an irradiance's header on lamps with light outside the range that is
    computed; none if there are none.
    """
    header: dict[str, Any] = {}
    if span != VISIBLE:
        header[_COMPUTED] = [span.low_nm, span.high_nm]

    outside: list[list[float]] = []
    for lamp in lamps:
        power = lamp.cell_means(EDGES_NM)
        if power[~cells_in(span)].any():
            outside.append([float(f"{value:.{DIGITS}g}") for value in power])
    if outside:
        header[OUTSIDE] = outside
    return header


def _computed_span(header: Mapping[str, Any]) -> Span:
    """Return the range that an irradiance's header states as computed; the header of another
    program may hold anything.
    """
    ends = header.get(_COMPUTED)
    if isinstance(ends, list) and len(ends) == 2 and all(isinstance(end, float) for end in ends):
        return Span(*ends)
    return VISIBLE


def outside_share(header: Mapping[str, Any], physics: PixelPhysics) -> float:
    """Return the largest share of a lamp's electrons in a pixel that come from outside the computed
    range, 0 to 1.

    header : of an irradiance; the header of another program may hold anything
    """
    lamps = header.get(OUTSIDE)
    cells = CENTRES_NM.size
    if not isinstance(lamps, list) or not all(
        isinstance(lamp, list) and len(lamp) == cells for lamp in lamps
    ):
        return 0.0
    electrons = np.array(lamps, float).reshape(-1, cells) * _response(physics)
    total = electrons.sum(axis=1)
    outside = electrons[:, ~cells_in(_computed_span(header))].sum(axis=1)
    shares = outside / np.where(total > 0, total, 1.0)
    return float(shares.max(initial=0.0))


def _response(physics: PixelPhysics) -> Array:
    return physics.quantum_efficiency(CENTRES_NM) * photons_per_joule(CENTRES_NM)


def outside_share_text(share: float, span: Span = VISIBLE) -> str:
    """Return in words the share of light that a range leaves out."""
    percent = f"{100 * share:.0f}" if share < 0.995 else f"{100 * share:.3g}"
    return f"without {percent} % of a lamp's light in the sensor's response, outside {span.words}"


def outside_hint() -> str:
    """Return how to keep such light from the sensor, in the caller's words."""
    return (
        f"an infrared filter before the sensor ({setting('pixel.infrared_cut_nm', HIGH_NM)} or"
        " less), or a lamp within that range"
    )
