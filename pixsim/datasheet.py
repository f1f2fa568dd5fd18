"""A pixel's data sheet: one individual measured as EMVA 1288, ISO 15739 and ISO 12232 do, and what is estimated from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from pixsim.datasheet_experiment import Experiment, make_experiment
from pixsim.datasheet_series import Measured, measure
from pixsim.datasheet_truth import Truth, truth
from pixsim.parameters import Exposure, Pixel
from pixsim.photon_transfer import (
    DarkCurrent,
    Estimate,
    Linearity,
    NonUniformity,
    PhotonTransfer,
    dark_current,
    linearity,
    non_uniformity,
    of_pixel_type,
    photon_transfer,
    prnu,
)
from pixsim.progress import Stage
from pixsim.spectral import Array


@dataclass(frozen=True)
class DataSheet:
    """What was measured of one individual, and its estimates."""

    experiment: Experiment = field(repr=False)
    measured: Measured = field(repr=False)

    @property
    def pixels(self) -> int:
        return math.prod(self.experiment.sensor.shape)

    @cached_property
    def transfer(self) -> PhotonTransfer:
        dark = self.measured.dark
        found = photon_transfer(self.measured.light, dark.mean_dn, dark.variance_dn2, self.pixels)
        return of_pixel_type(found, prnu(self.measured.dark_stack, self.measured.bright_stack).value, self.pixels)

    @property
    def signal_dn(self) -> Array:
        """(n,) mean signals of the light series, above the dark."""
        return self.measured.light.mean_dn - self.measured.dark.mean_dn

    @cached_property
    def linearity(self) -> Linearity:
        return linearity(self.measured.light.at, self.signal_dn, self.transfer.saturation_index)

    @cached_property
    def spatial(self) -> NonUniformity:
        return non_uniformity(self.measured.dark_stack, self.measured.bright_stack, self.transfer.gain_dn_per_e)

    @cached_property
    def dark_current(self) -> DarkCurrent:
        return dark_current(self.measured.dark_series, self.transfer.gain_dn_per_e, self.pixels)

    @cached_property
    def warm_currents(self) -> tuple[Array, list[Estimate]]:
        """(temperatures in kelvin, dark currents from the mean); without the error of K, which they have in common."""
        gain = Estimate(self.transfer.gain_dn_per_e.value)
        found = [dark_current(each, gain, self.pixels).from_mean_e_per_s for each in self.measured.warm.values()]
        return np.array(list(self.measured.warm)), found

    @cached_property
    def truth(self) -> Truth:
        return truth(self.experiment, self.measured.bright_photons, self.transfer.saturation_index)

    @property
    def notes(self) -> list[str]:
        """What a reader has to know: a raised black level, a quantiser that decides, a curve that is not straight."""
        pixel, asked = self.experiment.physics.pixel, self.experiment.asked_black_dn
        told = []
        if pixel.black_level_dn != asked:
            told.append(
                f"black level raised from {asked:g} to {pixel.black_level_dn:g} DN, 6 σ of the dark: a clip at 0 DN would spoil "
                "its statistics. The full well stands for the codes that are left, so K is smaller than without it."
            )
        if self.transfer.limited:
            told.append(
                f"quantisation-limited: σ²_y.dark = {self.measured.dark.variance_dn2:.3g} DN² is below 0.24 DN², so σ_d is an "
                "upper bound, and K and all that is divided by it are off by some per cent: 1/12 DN² no longer holds. "
                f"More bits than {pixel.bits} show them (pixel.bits)."
            )
        if pixel.conversion != "linear":
            told.append(
                "conversion = 'junction': the gain changes as the well fills, so the linear model of EMVA 1288 does not hold. "
                "K, R and η are means over the range of their fits; the true values are those of the charge."
            )
        return told


def make_datasheet(pixel: Pixel, exposure: Exposure | None = None, *, stage: Stage | None = None, **how: Any) -> DataSheet:
    """Run the experiment on one individual of a pixel; keywords as `make_experiment` takes them.

    Raises PixsimError as `make_experiment` does.
    """
    experiment = make_experiment(pixel, exposure, **how)
    return DataSheet(experiment, measure(experiment, stage))
