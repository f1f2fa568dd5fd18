"""What a user should know of a pixel and of the light that it sees: units, focus, light beyond a table or infrared, scales."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.digits import percent, rounded, setting_text
from pixsim.base.notes import Note
from pixsim.light.curves import EfficiencyCurve
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.optics.lens_defocus import DEPTHS, signed_disc_um
from pixsim.sensor.camera_data import has_common_scale
from pixsim.sensor.collection import stack_notes
from pixsim.sensor.colour_options import efficiencies_of
from pixsim.sensor.integration import electrons_per_joule
from pixsim.sensor.outside import CENTRES_NM, EDGES_NM, OUTSIDE, SHOWN_SHARE
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.unit_slips import unit_slips

BLURRED_PIXELS = 2.0  # disc of a point in pixels, of which a note tells
INFRARED_NM = 700.0  # beyond, a channel of a colour sensor sees nothing that the eye does
USUAL_NM = 525.0  # at which data sheets state a quantum efficiency
FLAT_CHANGE = 0.25  # of the electrons, by the curve of silicon in place of one number, of which a note tells
INFRARED_SHARE = 0.05  # of a channel's signal, of which a note tells


def pixel_notes(physics: PixelPhysics, camera: Camera | None = None, irradiance: SpectralImage | None = None) -> list[Note]:
    """Return notes on a pixel's numbers, which may be in another unit, and on what its model leaves out of its light.

    camera, irradiance : the light on the sensor and the camera in front of it; None: it is not known yet
    """
    notes = unit_slips(physics.pixel)
    if camera is None or irradiance is None:
        return notes

    notes += stack_notes(physics, camera, irradiance.wavelength_nm)
    sensitivities = physics.pixel.colour.sensitivities if physics.pixel.colour else None
    if isinstance(sensitivities, str) and not has_common_scale(sensitivities):
        words = (
            f"pixel.colour.sensitivities: each channel of {sensitivities} was scaled to its own peak; their ratio is unknown, and "
            "with it the noise before white balance. Balanced colours do not depend on it"
        )
        notes.append(Note("assumed", words=words))
    notes += focus_notes(physics.read_pitch_um, camera, irradiance)
    for name, curve in tables_of(physics).items():
        share = share_beyond(curve, irradiance, physics)
        if share > SHOWN_SHARE:
            end_nm, last = curve[-1]
            filter_nm = setting("pixel.infrared_cut_nm", end_nm)
            words = (
                f"{name} ends at {end_nm:g} nm with {last:g}, and is 0 beyond: if it stayed so, {percent(share)} of the electrons "
                f"would come from there. Extend the table, or state a filter ({filter_nm})"
            )
            notes.append(Note("spectral_range", words=words))
    change = flat_efficiency_change(irradiance, physics)
    if abs(change) > FLAT_CHANGE:
        stated = setting("pixel.quantum_efficiency_nm", USUAL_NM)
        more = "more" if change > 0 else "fewer"
        words = (
            f"pixel.quantum_efficiency = {physics.pixel.quantum_efficiency:g} holds at every wavelength; if it was measured at "
            f"{USUAL_NM:g} nm, the absorption of silicon would make {percent(abs(change))} {more} electrons of this light. State "
            f"its wavelength ({stated}), or a table"
        )
        notes.append(Note("spectral_range", words=words))
    shares = infrared_shares(irradiance, physics)
    if max(shares.values(), default=0.0) > INFRARED_SHARE:
        channels = ", ".join(f"{percent(share)} of {letter}" for letter, share in shares.items())
        filter_nm = setting("pixel.infrared_cut_nm", 650.0)
        words = f"infrared beyond {INFRARED_NM:g} nm is {channels}, which no eye sees: it is part of the colour error"
        notes.append(Note("spectral_range", words=f"{words}. A filter keeps it out ({filter_nm})"))
    return notes


def focus_notes(pitch_um: float, camera: Camera, irradiance: SpectralImage) -> list[Note]:
    """Return a note on a scene of which every visible point is a disc of more than `BLURRED_PIXELS`; none on others."""
    depths = irradiance.header.get(DEPTHS)
    if not isinstance(depths, list) or len(depths) != 3 or not all(depth is None or isinstance(depth, float) for depth in depths):
        return []
    nearest_m, sharpest_m, farthest_m = (math.inf if depth is None else depth for depth in depths)
    if not sharpest_m > 0:
        return []
    disc_um = abs(signed_disc_um(camera, sharpest_m))
    if disc_um <= BLURRED_PIXELS * pitch_um:
        return []

    nearest, farthest = (
        f"{rounded(depth_m, 3)} m" if math.isfinite(depth_m) else "infinity" for depth_m in (nearest_m, farthest_m)
    )
    place = nearest if nearest == farthest else f"{nearest} to {farthest}"
    note = Note(
        "focus",
        focus_m=setting_text(camera.object_distance_m),
        place=place,
        disc_um=rounded(disc_um, 3),
        disc_px=rounded(disc_um / pitch_um, 3),
        pitch_um=pitch_um,
        setting=setting("camera.object_distance_m"),
    )
    return [note]


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


def flat_efficiency_change(irradiance: SpectralImage, physics: PixelPhysics) -> float:
    """Return how much silicon's curve would change the electrons of a number that holds at every wavelength, relative to them.

    The curve is that of `absorbed_efficiency`, for a number of `USUAL_NM` and the usual depth. 0 for a pixel whose efficiency is
    no such number, and without electrons.
    """
    pixel = physics.pixel
    flat = isinstance(pixel.quantum_efficiency, float) and pixel.quantum_efficiency_nm is None
    if not flat or efficiencies_of(pixel.colour):
        return 0.0

    def electrons(**efficiency: float | None) -> float:
        sensor = replace(physics, pixel=pixel.model_copy(update=efficiency))
        return float(electrons_per_joule(sensor, irradiance) @ irradiance.mean_spectrum())

    # A half, which the usual depth allows: only the ratio counts.
    flat_e = electrons(quantum_efficiency=0.5)
    curved_e = electrons(quantum_efficiency=0.5, quantum_efficiency_nm=USUAL_NM, quantum_efficiency_depth_um=None)
    return curved_e / flat_e - 1 if flat_e else 0.0


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
