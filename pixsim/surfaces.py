"""What the surfaces of a scene may do to the spectrum of light: the factors it can meet on its way to the lens."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from pixsim.evaluation import evaluate_reflection, evaluate_spectrum, spectrum_dict
from pixsim.lamps import is_neutral, numbers, parsed_table, table_of
from pixsim.mitsuba_xml import children, nodes_of, plain
from pixsim.spectral import Array
from pixsim.spectrum import HIGH_NM, LOW_NM, Spectrum, grid_nm

# The spectra of the stock BSDFs by name. What is not named here leaves the spectrum as it is.
SPECTRA = {
    "diffuse": ("reflectance",),
    "plastic": ("diffuse_reflectance", "specular_reflectance"),
    "roughplastic": ("diffuse_reflectance", "specular_reflectance"),
    "conductor": ("specular_reflectance",),
    "roughconductor": ("specular_reflectance",),
    "dielectric": ("specular_reflectance", "specular_transmittance"),
    "roughdielectric": ("specular_reflectance", "specular_transmittance"),
    "thindielectric": ("specular_reflectance", "specular_transmittance"),
    "twosided": (),
    "blendbsdf": (),
    "mask": (),
    "bumpmap": (),
    "normalmap": (),
    "null": (),
}
LAMBERTIAN = ("diffuse", "twosided")
METALS = ("conductor", "roughconductor")
INSIDE = ("plastic", "roughplastic")  # light that goes to and fro under a coat: ρ/(1 - F ρ)
INTERNAL_REFLECTION = 0.6  # of a coat of index 1.49, from inside
METAL_COSINES = (1.0, 0.7, 0.3)
HIGHEST_POWER = 3  # of a reflectance, for light that goes to and fro between like surfaces; what goes on longer is little
TO_AND_FRO = (0.5, 0.8, 0.95)
MOST_PRODUCTS = 160
NEUTRAL_SPREAD = 1e-6


@dataclass(frozen=True)
class Surfaces:
    """The spectra of a scene's surfaces.

    spectra : (n, 471) of single surfaces at 360 … 830 nm, neutral ones left out; None where they are not known
    unknown : why they are not known
    short : ranges of tables that end inside 360-830 nm, beyond which Mitsuba takes 0
    """

    spectra: Array | None = field(repr=False)
    unknown: str = ""
    short: tuple[str, ...] = ()

    def products(self, bounces: int) -> Array:
        """What light may have met after up to so many surfaces (-1: any number), (m, 471)."""
        if self.spectra is None:
            return np.zeros((0, grid_nm().size))
        single = self.spectra
        if bounces == 1 or not len(single):
            return single
        # Light that goes to and fro for long, a little or most of it: ρ/(1 - aρ).
        series = [single / (1 - part * np.minimum(single, 1.0)) for part in (TO_AND_FRO if bounces < 0 else ())]
        powers = [single**power for power in range(2, HIGHEST_POWER + 1 if bounces < 0 else min(bounces, HIGHEST_POWER) + 1)]
        pairs = [single[i] * single[j] for i, j in combinations_with_replacement(range(len(single)), 2) if i != j]
        spread = np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_PRODUCTS)).astype(int)
        return np.vstack([single, *powers, *series, *([pairs[index] for index in spread] or [single[:0]])])


def find_surfaces(state: Any, variant: str) -> Surfaces:
    """Every spectrum that a BSDF multiplies light with, from the parsed tree."""
    found: list[Array] = []
    short: set[str] = set()
    if nodes_of(state, "Medium"):
        return Surfaces(None, "a medium, whose spectra pixsim does not know")
    for _, node in nodes_of(state, "BSDF"):
        plugin = node.props.plugin_name()
        if plugin not in SPECTRA:
            return Surfaces(None, f"a BSDF '{plugin}', whose spectra pixsim does not know")
        metal = _metal(state, node, variant) if plugin in METALS else []
        if metal is None:
            return Surfaces(None, f"the index of {plugin}")
        found += metal
        for name in SPECTRA[plugin]:
            if name in node.props:
                own = _property(state, node, name, variant, short)
                if own is None:
                    return Surfaces(None, f"the texture of {plugin}.{name}")
                found += [*own, *(each / (1 - INTERNAL_REFLECTION * each) for each in own if plugin in INSIDE)]
                found += [each * fresnel for each in own for fresnel in metal]
    coloured = [each for each in found if np.ptp(each) > NEUTRAL_SPREAD * max(each.max(), 1.0)]
    unique = {each.round(9).tobytes(): each for each in coloured}
    return Surfaces(np.array(list(unique.values())).reshape(-1, grid_nm().size), "", tuple(sorted(short)))


def _property(state: Any, node: Any, name: str, variant: str, short: set[str]) -> list[Array] | None:
    """The spectra that a property of a node may have; empty where it is neutral, None where that is not known."""
    kind = node.props.type(name).name
    if kind in ("Float", "Integer"):
        return []
    if kind == "Color":
        value = numbers(node.props.as_string(name))
        return [evaluate_spectrum({"type": "rgb", "value": value}, variant)] if np.ptp(value) else []
    if kind == "Spectrum":
        value = node.props[name]
        if value.is_uniform():
            return []
        return [_table(parsed_table(value), short)]
    if kind not in ("Reference", "ResolvedReference"):
        return None
    texture = state.nodes[children(node, state)[name]]
    plugin = texture.props.plugin_name()
    if plugin == "uniform" or is_neutral(texture):
        return []
    table = table_of(texture)
    if table is not None:
        return [_table(table, short)]
    if plugin == "checkerboard":
        parts = [_property(state, texture, each, variant, short) for each in ("color0", "color1") if each in texture.props]
        return None if any(part is None for part in parts) else [each for part in parts for each in part or []]
    return None


def _table(table: Spectrum, short: set[str]) -> Array:
    low, high = float(table.nodes_nm[0]), float(table.nodes_nm[-1])
    if (low > LOW_NM and table.values[0] > 0) or (high < HIGH_NM and table.values[-1] > 0):
        short.add(f"{low:g}-{high:g} nm")
    return table.at(grid_nm())


def _metal(state: Any, node: Any, variant: str) -> list[Array] | None:
    """Fresnel reflectances of a conductor at several angles, from Mitsuba's own smooth one; None where not known."""
    described: dict[str, Any] = {"type": "conductor"}
    values, textures = dict(plain(node)), children(node, state)
    for key in ("material", "eta", "k"):
        if key in values:
            described[key] = spectrum_dict(values[key]) if hasattr(values[key], "wavelengths") else values[key]
        elif key in textures:
            texture = state.nodes[textures[key]]
            if texture.props.plugin_name() not in ("uniform", "regular", "irregular"):
                return None
            described[key] = {"type": texture.props.plugin_name(), **dict(plain(texture))}
    return [evaluate_reflection(described, cosine, variant) for cosine in METAL_COSINES]
