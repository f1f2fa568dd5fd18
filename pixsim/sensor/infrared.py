"""What a user should know of the light that a pixel sees, and of what it does not say of it: mostly of infrared light."""

from __future__ import annotations

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.notes import warn
from pixsim.light.curves import EfficiencyCurve
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import warn_of_stack_limits
from pixsim.sensor.integration import electrons_per_joule
from pixsim.sensor.outside import CENTRES_NM, EDGES_NM, OUTSIDE, SHOWN_SHARE
from pixsim.sensor.pixel import PixelPhysics

INFRARED_NM = 700.0  # beyond, a channel of a colour sensor sees nothing that the eye does
INFRARED_SHARE = 0.05  # of a channel's signal, of which a note tells


def warn_of_light(physics: PixelPhysics, camera: Camera, irradiance: SpectralImage) -> None:
    """Warn of what a pixel's model does not hold for in a light, and of infrared light in its colours."""
    warn_of_stack_limits(physics, camera, irradiance.wavelength_nm)
    for name, curve in tables_of(physics).items():
        share = share_beyond(curve, irradiance, physics)
        if share > SHOWN_SHARE:
            end_nm, last = curve[-1]
            warn(
                f"{name} ends at {end_nm:g} nm with {last:g}, and is 0 beyond: if it stayed so, {share:.0%} of the electrons would "
                f"come from there. Extend the table, or state a filter ({setting('pixel.infrared_cut_nm', end_nm)})"
            )
    shares = infrared_shares(irradiance, physics)
    if max(shares.values(), default=0.0) > INFRARED_SHARE:
        each = ", ".join(f"{share:.0%} of {letter}" for letter, share in shares.items())
        warn(
            f"infrared beyond {INFRARED_NM:g} nm is {each}, which no eye sees: it is part of the colour error. "
            f"A filter keeps it out ({setting('pixel.infrared_cut_nm', 650.0)})"
        )


def tables_of(physics: PixelPhysics) -> dict[str, EfficiencyCurve]:
    """Return the quantum efficiencies that a pixel has as tables, by their names."""
    pixel, found = physics.pixel, dict[str, EfficiencyCurve]()
    if isinstance(pixel.quantum_efficiency, tuple):
        found["pixel.quantum_efficiency"] = pixel.quantum_efficiency
    curves = pixel.colour.quantum_efficiencies if pixel.colour is not None else None
    if isinstance(curves, dict):
        found |= {f"pixel.colour.quantum_efficiencies of {letter}": curve for letter, curve in curves.items()}
    return found


def share_beyond(curve: EfficiencyCurve, irradiance: SpectralImage, physics: PixelPhysics) -> float:
    """Return the share of electrons beyond the end of a table, if the efficiency stayed its last value there, 0 to 1.

    It is that of the lamp with the most of it, where the light says what its lamps have outside the range that is computed.
    """
    end_nm, last = curve[-1]
    if not last or physics.infrared_cut_nm <= end_nm:
        return 0.0
    if lamps := irradiance.header.get(OUTSIDE):
        nm, low_nm, high_nm, light = CENTRES_NM, EDGES_NM[:-1], EDGES_NM[1:], np.array(lamps, float)
    else:
        nm, width_nm = irradiance.wavelength_nm, irradiance.band_width_nm
        low_nm, high_nm, light = nm - width_nm / 2, nm + width_nm / 2, irradiance.mean_spectrum()[None]
        if high_nm.max() <= end_nm:
            return 0.0
    photons = light * photons_per_joule(nm) * (high_nm - low_nm)
    known_nm, values = np.array(curve).T
    seen = photons @ np.interp(nm, known_nm, values, left=0.0, right=0.0)
    between = _share_above(low_nm, high_nm, end_nm) - _share_above(low_nm, high_nm, physics.infrared_cut_nm)
    beyond = photons @ (last * between)
    return float((beyond / np.maximum(seen + beyond, np.finfo(float).tiny)).max())


def infrared_shares(irradiance: SpectralImage, physics: PixelPhysics) -> dict[str, float]:
    """Return the share of each channel's electrons that light beyond 700 nm gives, 0 to 1; empty for grey sensors."""
    nm, width_nm = irradiance.wavelength_nm, irradiance.band_width_nm
    if physics.layout is None or physics.infrared_cut_nm <= INFRARED_NM or (nm + width_nm / 2).max() <= INFRARED_NM:
        return {}
    light, above = irradiance.mean_spectrum(), _share_above(nm - width_nm / 2, nm + width_nm / 2, INFRARED_NM)
    shares = {}
    for channel in physics.channels:
        electrons = electrons_per_joule(channel, irradiance) * light
        shares[channel.channel] = float((electrons * above).sum() / electrons.sum()) if electrons.any() else 0.0
    return shares


def _share_above(low_nm: Array, high_nm: Array, at_nm: float) -> Array:
    """Return the part of each band that lies above a wavelength, (B,)."""
    return np.asarray(np.clip((high_nm - at_nm) / (high_nm - low_nm), 0.0, 1.0))
