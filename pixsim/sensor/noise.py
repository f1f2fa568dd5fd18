"""The sources of noise of a pixel, each once: how large it is, what it grows with, and which pixels
share its values.

What draws noise, what states its variance and what lists it goes through `SOURCES`. A new source is
one line there if it is as large in light as in the dark; a fixed pattern that grows with charge
needs a map of its own beside its line. Shot noise is none of them: it is the Poisson law of light
and dark charge, and the only temporal noise that grows with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, Self, TypeVar

from pixsim.base.arrays import Array
from pixsim.sensor.mismatch import DarkSpread
from pixsim.sensor.pixel import PixelPhysics

Along = Literal["pixel", "row", "column"]


class _NoisyReadout(Protocol):
    """What the sources need of a `pixsim.sensor.reading.Readout`, whose noise floor is their
    sum.
    """

    @property
    def exposures(self) -> int: ...

    @property
    def silent(self) -> tuple[str, ...]: ...

    @property
    def physics(self) -> PixelPhysics: ...

    @property
    def read_noise_at_gain_e(self) -> float: ...

    @property
    def prnu(self) -> float: ...

    @property
    def dark_spread(self) -> DarkSpread: ...

    def with_physics(self, **numbers: Any) -> Self: ...

    def with_silent(self, names: tuple[str, ...]) -> Self: ...


_AnyReadout = TypeVar("_AnyReadout", bound=_NoisyReadout)


@dataclass(frozen=True)
class NoiseSource:
    """A source of noise beside shot noise.

    name : as plans list it
    deviation : its standard deviation for a pixel as it is read, in electrons, or relative to what
        it grows with
    is_temporal : whether it is another one in each frame; else it is a fixed pattern
    along : pixels that share a value: none; a row, for temporal noise; or a column, for a fixed
        pattern
    grows_with : 'light' or 'dark' charge; empty: with neither
    is_rare : whether few sensors have it, so that lists leave it out where it is 0
    silence : for a pattern that grows with charge: changes a readout so that `sample_sensor` draws
        no map of it
    """

    name: str
    deviation: Callable[[_NoisyReadout], float]
    is_temporal: bool = False
    along: Along = "pixel"
    grows_with: Literal["", "light", "dark"] = ""
    is_rare: bool = False
    silence: Callable[[Any], Any] | None = field(default=None, compare=False)

    def frame_deviation(self, readout: _NoisyReadout) -> float:
        """Return the deviation in a frame, which may be the sum of subexposures.

        Values that differ between subexposures add up by squares, equal values linearly; a value
        that grows with charge does so with the charge of all together.
        """
        deviation = self.deviation(readout)
        count = readout.exposures
        if count == 1 or self.grows_with:
            return deviation

        return deviation * (math.sqrt(count) if self.is_temporal else count)


SOURCES = (
    NoiseSource("reset noise", lambda r: r.physics.reset_noise_e, is_temporal=True),
    NoiseSource("read noise", lambda r: r.read_noise_at_gain_e, is_temporal=True),
    NoiseSource(
        "row noise",
        lambda r: r.physics.number("row_noise_e"),
        is_temporal=True,
        along="row",
        is_rare=True,
    ),
    NoiseSource(
        "PRNU", lambda r: r.prnu, grows_with="light", silence=lambda r: r.with_physics(prnu=0.0)
    ),
    NoiseSource(
        "DSNU",
        lambda r: r.dark_spread.deviation,
        grows_with="dark",
        silence=lambda r: r.with_physics(dsnu=0.0, hot_pixel_fraction=0.0),
    ),
    NoiseSource("offset FPN", lambda r: r.physics.offset_fpn_e),
    NoiseSource("column FPN", lambda r: r.physics.column_fpn_e, along="column"),
)


def _selected_sources(
    readout: _NoisyReadout, is_temporal: bool | None, along: Along | None
) -> list[NoiseSource]:
    """Return the sources of a readout, all of them or a selection.

    is_temporal : whether they are temporal or fixed, or None for both
    along : the pixels that share a value, or None for any
    """
    sources = [source for source in SOURCES if source.name not in readout.silent]
    if is_temporal is not None:
        sources = [source for source in sources if source.is_temporal == is_temporal]
    if along is not None:
        sources = [source for source in sources if source.along == along]
    return sources


def constant_e(
    readout: _NoisyReadout, *, is_temporal: bool | None = None, along: Along | None = None
) -> float:
    """Return the standard deviation of all sources together that grow neither with light nor with
    dark charge, in electrons.

    is_temporal, along : select sources, as in `_selected_sources`

    >>> from pixsim.sensor.pixel import derive
    >>> from pixsim.sensor.pixel_options import Pixel
    >>> from pixsim.sensor.reading import Readout
    >>> pixel = derive(Pixel(technology="4t-bsi", pitch_um=1.2, temporal_dark_noise_e=2.0))
    >>> constant_e(Readout.of(pixel), is_temporal=True)
    2.0
    """
    return math.hypot(
        *(
            source.frame_deviation(readout)
            for source in _selected_sources(readout, is_temporal, along)
            if not source.grows_with
        )
    )


def variance_e2(
    readout: _NoisyReadout,
    variance: Array | float = 0.0,
    *,
    light_e: Array | float = 0.0,
    dark_e: Array | float = 0.0,
    is_temporal: bool | None = None,
    along: Along | None = None,
) -> Array | float:
    """Return the variance of sources together, in electrons squared, in the shape (...) of the
    charges.

    variance : to which theirs is added, such as the variance of shot noise
    light_e, dark_e : mean charge of light and of the dark, with which some sources grow
    is_temporal, along : select sources, as in `_selected_sources`
    """
    charge = {"": 1.0, "light": light_e, "dark": dark_e}
    for source in _selected_sources(readout, is_temporal, along):
        variance = variance + (source.frame_deviation(readout) * charge[source.grows_with]) ** 2
    return variance


def variances_e2(
    readout: _NoisyReadout, *, light_e: Array | float = 0.0, dark_e: float = 0.0
) -> dict[str, Array | float]:
    """Return the terms of `variance_e2` by the names of their sources."""
    variances: dict[str, Array | float] = {}
    for source in _selected_sources(readout, None, None):
        others = tuple(other.name for other in SOURCES if other is not source)
        alone = readout.with_silent(others)
        variances[source.name] = variance_e2(alone, light_e=light_e, dark_e=dark_e)
    return variances


def without_source(readout: _AnyReadout, name: str) -> _AnyReadout:
    """Return a readout without one of the `SOURCES`, by its name; all others are drawn as before,
    but for their random numbers.
    """
    source = next(source for source in SOURCES if source.name == name)
    silent = readout.with_silent((*readout.silent, name))
    if source.silence is None:
        return silent

    without_map: _AnyReadout = source.silence(silent)
    return without_map


def signal_at_snr_e(snr: float, dark_variance_e2: float, gain_spread: float) -> float:
    """Mean electrons μ that solve μ/√(μ + σ² + (PRNU μ)²) = snr; NaN if PRNU limits the SNR to
    less.
    """
    square = snr**-2 - gain_spread**2
    if square <= 0:
        return math.nan
    return (1 + math.sqrt(1 + 4 * square * dark_variance_e2)) / (2 * square)
