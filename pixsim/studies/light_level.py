"""How bright a scored picture is: what is shown as display white, and for how long it was exposed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.show.sentences import span
from pixsim.viewer.display import white_light
from pixsim.viewer.display_options import Display
from pixsim.viewer.screen import HEADER_OF_WHITE, UNITS_OF_WHITE, WHITE_FROM


class LightLevel(NamedTuple):
    """What is shown as display white, its unit, source and spectrum, and the shortest and longest exposure time.

    It is a luminance, or the radiance of light without one.
    """

    white: float
    unit: str
    white_from: str
    white_spectrum: str
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, irradiance: SpectralImage, display: Display, integration_s: Iterable[float]) -> LightLevel:
        """Return the light level of a scored picture; the display's white takes precedence over the scene's."""
        header, times_s = irradiance.header, np.array(list(integration_s), float)
        stated = [name for name in UNITS_OF_WHITE if getattr(display, name)]
        name = stated[0] if stated else next(each for each, entry in HEADER_OF_WHITE.items() if entry in header)
        if stated:
            white, source = getattr(display, name), f"display.{name}"
        else:
            white = header[HEADER_OF_WHITE[name]]
            source = header.get("white_from", "the scene")
            source += ", in the sensor's response" if source == WHITE_FROM else ""
        return cls(
            float(white), UNITS_OF_WHITE[name], source, white_light(irradiance)[1], float(times_s.min()), float(times_s.max())
        )

    @property
    def exposure(self) -> str:
        """Exposure time in ms, or its range."""
        return span(1e3 * self.shortest_s, 1e3 * self.longest_s, ".3g", " ms")

    def __str__(self) -> str:
        return f"display white is {self.white:.4g} {self.unit} in the scene; exposed for {self.exposure}"
