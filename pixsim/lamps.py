"""What lights a scene: the one spectrum behind its emitters, where there is one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.mitsuba_xml import children, nodes_of, plain, speaking_mitsuba
from pixsim.spectral import Array, luminous_weight

# What the stock emitters call their spectrum.
EMISSION = {
    "area": "radiance",
    "constant": "radiance",
    "point": "intensity",
    "spot": "intensity",
    "directional": "irradiance",
}
LAMP_GRID_NM = np.arange(360.0, 831.0)


@dataclass(frozen=True)
class Lamp:
    """The one spectrum that all emitters share, and what each emitter is without it.

    radiance : (471,) W m⁻² sr⁻¹ nm⁻¹ at 360 … 830 nm, of texel value 1 (or of the first emitter)
    pictures : emitter node -> (property, node of its neutral picture, or its power relative to `radiance`)
    """

    radiance: Array = field(repr=False)
    pictures: dict[int, tuple[str, int | float]]

    @property
    def luminance_cd_per_m2(self) -> float:
        return float((self.radiance * luminous_weight(LAMP_GRID_NM, 1.0)).sum())


def find_lamp(state: Any, variant: str) -> Lamp | None:
    """The one spectrum behind all emitters, where there is one and what multiplies it is neutral; else None."""
    emitters = nodes_of(state, "Emitter")
    parts = [_emission(state, node) for _, node in emitters]
    if not parts or any(part is None for part in parts):
        return None
    known = [part for part in parts if part is not None]
    if len({part.spectrum for part in known}) > 1 or (
        len({part.scale for part in known}) > 1 and any(part.picture is not None for part in known)
    ):
        return None
    first = known[0].scale
    radiance = first * evaluate_spectrum(dict(known[0].spectrum), variant)
    pictures: dict[int, tuple[str, int | float]] = {
        index: (part.name, part.picture if part.picture is not None else (part.scale / first if first else 1.0))
        for (index, _), part in zip(emitters, known, strict=True)
    }
    return Lamp(radiance, pictures)


@dataclass(frozen=True)
class _Emission:
    """An emitter's spectrum (plugin and its values, hashable) × scale × neutral picture (a texture node)."""

    name: str
    spectrum: tuple[tuple[str, Any], ...]
    scale: float
    picture: int | None


def _emission(state: Any, emitter: Any) -> _Emission | None:
    name = EMISSION.get(emitter.props.plugin_name())
    if name is None or name not in emitter.props:
        return None
    kind = emitter.props.type(name).name
    if kind == "Spectrum":
        value = emitter.props[name]
        if value.is_uniform():
            return _Emission(name, (("type", "uniform"), ("value", 1.0)), float(value.values[0]), None)
        pairs = [",".join(map(repr, each)) for each in (value.wavelengths, value.values)]
        return _Emission(name, (("type", "irregular"), ("wavelengths", pairs[0]), ("values", pairs[1])), 1.0, None)
    if kind not in ("ResolvedReference", "Reference"):
        return None
    index = children(emitter, state)[name]
    node = state.nodes[index]
    plugin = node.props.plugin_name()
    if plugin == "bitmap" and is_neutral(node):
        return _Emission(name, (("type", "uniform"), ("value", 1.0)), 1.0, index)
    if plugin not in ("d65", "uniform", "regular", "irregular", "blackbody"):
        return None
    nested = list(children(node, state).values())
    if len(nested) > 1 or (nested and not is_neutral(state.nodes[nested[0]])):
        return None
    values = {key: value for key, value in plain(node) if isinstance(value, (int, float, str))}
    scale = float(values.pop("scale", 1.0)) if plugin == "d65" else 1.0
    return _Emission(name, (("type", plugin), *sorted(values.items())), scale, nested[0] if nested else None)


def is_neutral(texture: Any) -> bool:
    """A raw bitmap multiplies all wavelengths alike."""
    return texture.props.plugin_name() == "bitmap" and bool(texture.props.get("raw", False))


def evaluate_spectrum(description: dict[str, Any], variant: str) -> Array:
    """A spectrum plugin at 360 … 830 nm in steps of 1 nm, as Mitsuba returns it."""
    with speaking_mitsuba(variant, Path()) as mi:
        import drjit as dr

        texture = mi.load_dict(description)
        rows = np.resize(LAMP_GRID_NM, (-(-LAMP_GRID_NM.size // 4), 4))  # Mitsuba carries four wavelengths a ray
        if variant.startswith("scalar"):
            values = [_evaluate_four(mi, dr, texture, row.tolist()) for row in rows]
        else:
            interaction = dr.zeros(mi.SurfaceInteraction3f, len(rows))
            interaction.wavelengths = mi.Spectrum(np.ascontiguousarray(rows.T, np.float32))
            values = [np.asarray(texture.eval(interaction), float).T.ravel()]
        return np.concatenate(values)[: LAMP_GRID_NM.size]


def _evaluate_four(mi: Any, dr: Any, texture: Any, wavelengths_nm: list[float]) -> Array:
    interaction = dr.zeros(mi.SurfaceInteraction3f)
    interaction.wavelengths = wavelengths_nm
    return np.asarray(texture.eval(interaction), float).ravel()
