"""How bright a scored picture is: what is shown as display white, and for how long it was exposed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.show.sentences import span
from pixsim.viewer.display import white_light
from pixsim.viewer.display_options import Display


class LightLevel(NamedTuple):
    """Luminance that is shown as display white, its source and spectrum, and the shortest and longest exposure time."""

    white_cd_per_m2: float
    white_from: str
    white_spectrum: str
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, irradiance: SpectralImage, display: Display, integration_s: Iterable[float]) -> LightLevel:
        """Return the light level of a scored picture; the display's white takes precedence over the scene's."""
        header, times_s = irradiance.header, np.array(list(integration_s), float)
        if display.white_cd_per_m2:
            white, source = display.white_cd_per_m2, "display.white_cd_per_m2"
        else:
            white = header["luminance_cd_per_m2"]
            source = f"{header['white_from']}, in the sensor's response" if "white_from" in header else "the scene"
        return cls(float(white), source, white_light(irradiance)[1], float(times_s.min()), float(times_s.max()))

    @property
    def exposure(self) -> str:
        """Exposure time in ms, or its range."""
        return span(1e3 * self.shortest_s, 1e3 * self.longest_s, ".3g", " ms")

    def __str__(self) -> str:
        return f"display white is {self.white_cd_per_m2:.4g} cd/m² in the scene; exposed for {self.exposure}"
