"""Quantities of light, with their bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

MIN_FRACTION = 1e-12  # smaller fractions of the light leave no signal
Fraction = Annotated[float, Field(ge=MIN_FRACTION, le=1)]
Wavelength = Annotated[float, Field(ge=1, le=1e6)]  # soft X-rays ... 1 mm
FilmSamples = Annotated[int, Field(ge=1, le=16384)]  # across the die
# Parameters that state the light of a scene, of which a user sets one: the luminance of white, and
# what falls on a part. Then what stands for the first in the XML of a chart, and the spectrum of
# what falls on it, with the angle to its normal.
LUMINANCE = "luminance_cd_per_m2"
ILLUMINANCE = "lux"
IRRADIANCE = "irradiance_w_per_m2"
EMITTER_SCALE = "emitter_scale"
LAMP = "lamp"
INCIDENCE = "incidence_deg"
