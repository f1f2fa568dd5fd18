"""From what a scene contains to the work that it needs: which lamp, which bands, how deep the light paths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pixsim.lamps import LAMP_GRID_NM, Lamp, find_lamp
from pixsim.mitsuba_xml import nodes_of
from pixsim.scene import Scene
from pixsim.spectral import Array

# 10 nm bands integrate a smooth lamp's luminance to 0.03 %. The outer edges keep half a nanometre of flank inside the
# 360-830 nm that Mitsuba samples: a clipped pulse would spoil the stratification of the others.
BAND_WIDTH_NM = 10.0
BAND_CENTRE_NM = np.arange(370.0, 821.0, BAND_WIDTH_NM)
FLANK_NM = 0.5
FLAT_SHAPES = ("rectangle", "disk")
BANDS_PER_PASS = 4  # Mitsuba carries four wavelengths a ray, one for each of 1, 2 or 4 disjoint pulses of equal area


@dataclass(frozen=True)
class Plan:
    """What will be rendered.

    rank_one : the picture is one spectrum times one neutral picture, so one pass gives every band
    lamp : the spectrum that all emitters share, or None (bands are then flat and the lamps stay as they are)
    emissive_chart : a lone flat emitter, whose texel value 1 is the scene's white
    passes : band indices of each pass; empty for rank one
    reasons : why, for people
    """

    rank_one: bool
    lamp: Lamp | None
    emissive_chart: bool
    passes: tuple[tuple[int, ...], ...]
    reasons: tuple[str, ...]


def make_plan(scene: Scene, state: Any, full: bool = False) -> Plan:
    """Decide from the parsed tree. `full` leaves nothing out: every band is rendered, with the scene's own integrator."""
    lamp = find_lamp(state, scene.choice.variant)
    if lamp is None:
        return Plan(False, None, False, band_passes(), ("several or coloured lamp spectra: flat bands, the lamps in place",))
    alone = is_single_emitter(state)
    if full:
        return Plan(False, lamp, alone, band_passes(), ("nothing left out: every band, the scene's own integrator",))
    if alone:
        reason = "one lamp spectrum on a neutral, flat, lone emitter: one pass serves every band, no bounces"
        return Plan(True, lamp, True, (), (reason,))
    return Plan(False, lamp, False, band_passes(), ("one lamp spectrum on coloured objects: lamp-shaped bands",))


def is_single_emitter(state: Any) -> bool:
    """One flat area light and nothing else: nothing that its light could bounce off before it reaches the lens."""
    shapes, emitters = nodes_of(state, "Shape"), nodes_of(state, "Emitter")
    return (
        len(shapes) == 1
        and len(emitters) == 1
        and emitters[0][1].props.plugin_name() == "area"
        and shapes[0][1].props.plugin_name() in FLAT_SHAPES
        and not nodes_of(state, "Medium")
    )


def band_passes(bands: int = BAND_CENTRE_NM.size) -> tuple[tuple[int, ...], ...]:
    """Bands of each pass: four that do not touch. A last, incomplete pass is filled up with repeats, not with fewer."""
    stride = -(-bands // BANDS_PER_PASS)
    return tuple(tuple((start + stride * k) % bands for k in range(BANDS_PER_PASS)) for start in range(stride))


def band_pulse(lamp: Lamp | None, centre_nm: float) -> tuple[Array, Array, float]:
    """A band as a pulse shaped like the lamp: nodes in nm, values of unit area, and the lamp's own integral over it.

    The flanks are 1 nm wide and centred on the band's borders, so that neighbouring bands add up to the lamp.
    """
    half = BAND_WIDTH_NM / 2 + FLANK_NM
    nodes = np.linspace(centre_nm - half, centre_nm + half, round(2 * half) + 1)
    shape = np.ones_like(nodes) if lamp is None else np.interp(nodes, LAMP_GRID_NM, lamp.radiance)
    shape[[0, -1]] = 0.0
    area = float(np.trapezoid(shape, nodes))
    return nodes, shape / area if area else shape, area


def band_means(lamp: Lamp) -> Array:
    """Mean radiance of the lamp over each band, (B,) W m⁻² sr⁻¹ nm⁻¹."""
    return np.array([band_pulse(lamp, centre)[2] for centre in BAND_CENTRE_NM]) / BAND_WIDTH_NM
