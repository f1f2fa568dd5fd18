"""What lights a scene: the spectra behind its emitters, and which emitters share one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pixsim.errors import refuse
from pixsim.evaluation import evaluate_emitter, evaluate_spectrum
from pixsim.mitsuba_xml import children, nodes_of, plain
from pixsim.spectral import LUMINOUS_EFFICACY_LM_PER_W as LM_PER_W
from pixsim.spectral import photopic_efficiency
from pixsim.spectrum import Spectrum, grid_nm, tabulated

# What the stock emitters call their spectrum.
EMISSION = {
    "area": "radiance",
    "constant": "radiance",
    "point": "intensity",
    "spot": "intensity",
    "directional": "irradiance",
    "directionalarea": "radiance",
}
LUMINANCE_STEP_NM = 1 / 8


@dataclass(frozen=True)
class Lamp:
    """Emitters that share one spectrum, and what each is without it; or emitters whose colours stay in place.

    spectrum : of texel value 1 (or of the first emitter), W m⁻² sr⁻¹ nm⁻¹; None where colour and picture are not apart
    pictures : emitter node -> (property, node of its neutral picture, or its power relative to `spectrum`)
    """

    spectrum: Spectrum | None
    pictures: dict[int, tuple[str, int | float]]

    @property
    def luminance_cd_per_m2(self) -> float:
        """Of texel value 1: 683.002 ∫ ȳ L dλ."""
        if self.spectrum is None:
            return 0.0
        edges = grid_nm(LUMINANCE_STEP_NM)
        at = (edges[:-1] + edges[1:]) / 2
        return float(LM_PER_W * LUMINANCE_STEP_NM * (self.spectrum.cell_means(edges) * photopic_efficiency(at)).sum())


@dataclass(frozen=True)
class _Emission:
    """An emitter's spectrum (a hashable key) × scale × neutral picture (a texture node)."""

    name: str
    key: tuple[Any, ...]
    scale: float
    picture: int | None


def find_lamps(state: Any, variant: str) -> list[Lamp]:
    """Emitters by spectrum, in the order of the scene; those whose colour varies over them come last, together."""
    groups: dict[tuple[Any, ...], list[tuple[int, _Emission]]] = {}
    coloured: dict[int, tuple[str, int | float]] = {}
    for index, node in nodes_of(state, "Emitter"):
        part = _emission(state, node)
        if part is None:
            coloured[index] = (EMISSION.get(node.props.plugin_name(), ""), 1.0)
        else:
            # Pictures cannot be scaled in place: emitters with one share a group only at the same power.
            groups.setdefault((part.key, part.scale if part.picture is not None else None), []).append((index, part))
    for key, scale in list(groups):
        if scale is None and (host := next((each for each in groups if each[0] == key and each[1] is not None), None)):
            groups[host] += groups.pop((key, None))  # those without a picture can have any power
    lamps = []
    for (key, scale), parts in groups.items():
        first = max(part.scale for _, part in parts) if scale is None else scale
        spectrum = evaluate(key, variant) * first
        pictures: dict[int, tuple[str, int | float]] = {
            index: (part.name, part.picture if part.picture is not None else (part.scale / first if first else 1.0))
            for index, part in parts
        }
        lamps.append(Lamp(spectrum, pictures))
    return [*lamps, Lamp(None, coloured)] if coloured else lamps


def find_lamp(state: Any, variant: str) -> Lamp | None:
    """The one spectrum behind all emitters, where there is one and what multiplies it is neutral; else None."""
    lamps = find_lamps(state, variant)
    return lamps[0] if len(lamps) == 1 and lamps[0].spectrum is not None else None


def _emission(state: Any, emitter: Any) -> _Emission | None:
    name = EMISSION.get(emitter.props.plugin_name())
    if name is None:
        return None
    if name not in emitter.props:  # Mitsuba's default: a d65 of scale 1
        return _Emission(name, ("d65",), 1.0, None)
    beside = [index for key, index in children(emitter, state).items() if key != name]
    if any(not is_neutral(state.nodes[index]) for index in beside if state.nodes[index].type.name == "Texture"):
        return None  # the slide of a spot
    kind = emitter.props.type(name).name
    if kind == "Float":  # a plain number is a d65 of that scale
        return _Emission(name, ("d65",), float(emitter.props[name]), None)
    if kind == "Color":
        return _Emission(name, ("rgb", emitter.props.as_string(name)), 1.0, None)
    if kind == "Spectrum":
        value = emitter.props[name]
        if value.is_uniform():
            return _Emission(name, ("uniform",), float(value.values[0]), None)
        return _Emission(name, ("table", tuple(map(float, value.wavelengths)), tuple(map(float, value.values))), 1.0, None)
    if kind not in ("ResolvedReference", "Reference"):
        return None
    index = children(emitter, state)[name]
    node = state.nodes[index]
    plugin = node.props.plugin_name()
    if plugin == "bitmap" and is_neutral(node):
        return _Emission(name, ("uniform",), 1.0, index)
    nested = list(children(node, state).values())
    if len(nested) > 1 or (nested and not is_neutral(state.nodes[nested[0]])):
        return None
    picture = nested[0] if nested else None
    values = {key: value for key, value in plain(node) if isinstance(value, (int, float, str))}
    if plugin == "uniform":
        return _Emission(name, ("uniform",), float(values.get("value", 1.0)), picture)
    if plugin == "d65":
        return _Emission(name, ("d65",), float(values.get("scale", 1.0)), picture) if "color" not in node.props else None
    table = table_of(node)
    if table is not None:
        return _Emission(name, ("table", tuple(table.nodes_nm.tolist()), tuple(table.values.tolist())), 1.0, picture)
    if plugin == "blackbody":
        return _Emission(name, (plugin, *sorted(values.items())), 1.0, picture)
    return None


def is_neutral(texture: Any) -> bool:
    """A raw bitmap multiplies all wavelengths alike."""
    return texture.props.plugin_name() == "bitmap" and bool(texture.props.get("raw", False))


def numbers(text: object) -> list[float]:
    """Those in a property: "1 2 3", "1, 2, 3", "[1, 2, 3]"."""
    return [float(each) for each in str(text).strip("[]").replace(",", " ").split()]


def parsed_table(value: Any) -> Spectrum:
    """A spectrum that the parser keeps as a table."""
    return Spectrum(np.array(value.wavelengths, float), np.array(value.values, float))


def table_of(node: Any) -> Spectrum | None:
    """The table of a `regular` or `irregular` spectrum that is written out."""
    props, plugin = node.props, node.props.plugin_name()
    try:
        if plugin == "irregular":
            return Spectrum(np.array(numbers(props["wavelengths"])), np.array(numbers(props["values"])))
        if plugin == "regular":
            values = np.array(numbers(props["values"]))
            if "wavelength_min" in props:
                low, high = float(props["wavelength_min"]), float(props["wavelength_max"])
            else:
                low, high = numbers(props["range"])
            return Spectrum(np.linspace(low, high, values.size), values)
    except (KeyError, ValueError):
        return None
    return None


def evaluate(key: tuple[Any, ...], variant: str) -> Spectrum:
    """The spectrum behind an emission's key."""
    if key[0] == "table":
        return Spectrum(np.array(key[1]), np.array(key[2]))
    if key[0] == "uniform":
        return tabulated(np.ones(grid_nm().size))
    if key[0] == "rgb":
        return tabulated(evaluate_emitter({"type": "rgb", "value": numbers(key[1])}, variant))
    return tabulated(evaluate_spectrum({"type": key[0], **dict(key[1:])}, variant))


def checked_lamps(lamps: list[Lamp]) -> list[Lamp]:
    """Lamps that shine; PixsimError for one that is negative or not finite."""
    for lamp in lamps:
        values = lamp.spectrum.values if lamp.spectrum else np.zeros(1)
        if not np.isfinite(values).all() or values.min() < 0:
            raise refuse("emitter", f"radiance {values.min():g}", "finite and not negative")
    return [lamp for lamp in lamps if lamp.spectrum is None or lamp.spectrum.integral() > 0]
