"""Notes on a pixel and its light: units, focus, light beyond a table, scales of channels."""

from __future__ import annotations

import math

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
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.spectral_range import CENTRES_NM, EDGES_NM, NOTED_SHARE, OUTSIDE
from pixsim.sensor.unit_slips import unit_slips

_BLURRED_PIXELS = 2.0  # diameter of the blur disc, in pixels, above which there is a note


def pixel_notes(
    physics: PixelPhysics, camera: Camera | None = None, irradiance: SpectralImage | None = None
) -> list[Note]:
    """Return notes on numbers of a pixel that may be in another unit, and on light that its model
    leaves out.

    camera, irradiance : the light on the sensor and the camera in front of it, if they are known
    """
    notes = unit_slips(physics.pixel)
    if camera is None or irradiance is None:
        return notes

    notes += stack_notes(physics, camera, irradiance.wavelength_nm)
    sensitivities = physics.pixel.colour.sensitivities if physics.pixel.colour else None
    if isinstance(sensitivities, str) and not has_common_scale(sensitivities):
        text = (
            f"pixel.colour.sensitivities: each channel of {sensitivities} was scaled to its own"
            " peak; their ratio is unknown, and with it the noise before white balance. Balanced"
            " colours do not depend on it"
        )
        notes.append(Note("assumed", words=text))
    readout = physics.pixel.readout
    collectors = readout.model[0] if readout is not None and physics.layout is not None else ()
    if any(collector.response != 1 for collector in collectors):
        text = (
            "pixel.readout: the small photodiode is taken to respond to colours as the large one"
            " does. Where it does not, colours change at the switch (metamerism)"
        )
        notes.append(Note("assumed", words=text))
    notes += focus_notes(physics.read_pitch_um, camera, irradiance)
    for name, curve in tables_of(physics).items():
        share = share_beyond(curve, irradiance, physics)
        if share > NOTED_SHARE:
            end_nm, last = curve[-1]
            filter_nm = setting("pixel.infrared_cut_nm", end_nm)
            text = (
                f"{name} ends at {end_nm:g} nm with {last:g}, and is 0 beyond: if it stayed at"
                f" that value, {percent(share)} of the electrons would come from there. Extend the"
                f" table, or"
                f" state a filter ({filter_nm})"
            )
            notes.append(Note("spectral_range", words=text))
    return notes


def focus_notes(pitch_um: float, camera: Camera, irradiance: SpectralImage) -> list[Note]:
    """Return a note on a scene of which every visible point is a disc of more than
    `_BLURRED_PIXELS`; none on others.
    """
    depths = irradiance.header.get(DEPTHS)
    if not isinstance(depths, list) or len(depths) != 3:
        return []
    if not all(depth is None or isinstance(depth, float) for depth in depths):
        return []

    nearest_m, sharpest_m, farthest_m = (math.inf if depth is None else depth for depth in depths)
    if not sharpest_m > 0:
        return []
    disc_um = abs(signed_disc_um(camera, sharpest_m))
    if disc_um <= _BLURRED_PIXELS * pitch_um:
        return []

    nearest = _distance_text(nearest_m)
    farthest = _distance_text(farthest_m)
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


def _distance_text(distance_m: float) -> str:
    return f"{rounded(distance_m, 3)} m" if math.isfinite(distance_m) else "infinity"


def tables_of(physics: PixelPhysics) -> dict[str, EfficiencyCurve]:
    """Return the quantum efficiencies that a pixel has as tables, by their names."""
    pixel = physics.pixel
    tables: dict[str, EfficiencyCurve] = {}
    if isinstance(pixel.quantum_efficiency, tuple):
        tables["pixel.quantum_efficiency"] = pixel.quantum_efficiency
    curves = pixel.colour.quantum_efficiencies if pixel.colour is not None else None
    if isinstance(curves, dict):
        for letter, curve in curves.items():
            tables[f"pixel.colour.quantum_efficiencies of {letter}"] = curve
    return tables


def share_beyond(curve: EfficiencyCurve, irradiance: SpectralImage, physics: PixelPhysics) -> float:
    """Return the share of electrons beyond the end of a table, if the efficiency stayed its last
    value there, 0 to 1.

    Where the light says what its lamps have outside the range that is computed, it is the largest
    share of any lamp.
    """
    end_nm, last = curve[-1]
    if not last or physics.infrared_cut_nm <= end_nm:
        return 0.0
    lamps = irradiance.header.get(OUTSIDE)
    if lamps:
        nm = CENTRES_NM
        low_nm = EDGES_NM[:-1]
        high_nm = EDGES_NM[1:]
        light = np.array(lamps, float)
    else:
        nm = irradiance.wavelength_nm
        width_nm = irradiance.band_width_nm
        low_nm = nm - width_nm / 2
        high_nm = nm + width_nm / 2
        light = irradiance.mean_spectrum()[None]
        if high_nm.max() <= end_nm:
            return 0.0

    photons = light * photons_per_joule(nm) * (high_nm - low_nm)
    table_nm, values = np.array(curve).T
    seen = photons @ np.interp(nm, table_nm, values, left=0.0, right=0.0)
    above_end = _share_above(low_nm, high_nm, end_nm)
    above_cut = _share_above(low_nm, high_nm, physics.infrared_cut_nm)
    beyond = photons @ (last * (above_end - above_cut))
    return float((beyond / np.maximum(seen + beyond, np.finfo(float).tiny)).max())


def _share_above(low_nm: Array, high_nm: Array, at_nm: float) -> Array:
    """Return the part of each band that lies above a wavelength, (B,)."""
    return np.asarray(np.clip((high_nm - at_nm) / (high_nm - low_nm), 0.0, 1.0))
