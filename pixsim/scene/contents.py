"""The contents of a scene: lamps, surfaces, shapes in front of the lens, and texture files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations_with_replacement, product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, did_you_mean, invalid, names_in
from pixsim.base.files import digest_of
from pixsim.light import spectral
from pixsim.light.exr import read_channels
from pixsim.light.spectral import (
    HIGH_NM,
    LOW_NM,
    VISIBLE,
    WHITE_LAMPS,
    Span,
    Spectrum,
    grid_nm,
    tabulated,
)
from pixsim.optics.camera import Camera
from pixsim.scene.job import AssetFile, irregular
from pixsim.scene.mitsuba import evaluate_reflection, evaluate_spectrum, plugin_warnings
from pixsim.scene.textures import EIGHT_BIT, METAL_BY_NAME, check_share, check_texels
from pixsim.scene.tree import Node, SpectrumTable, Tree, children, nodes_of, numbers, plain_values

# The property with the spectrum of each stock emitter.
EMISSION = dict.fromkeys(("area", "constant", "directionalarea"), "radiance")
EMISSION |= {"point": "intensity", "spot": "intensity", "directional": "irradiance"}
_LUMINANCE_STEP_NM = 1 / 8
_BLACK_BODY_NM = (300.0, 1111.0)  # of its spectrum, every nanometre
_SECOND_RADIATION_NM_K = 1.438776877e7  # hc/k, SI 2019


@dataclass(frozen=True)
class Lamp:
    """Emitters that share one spectrum, or emitters whose spectrum varies over them.

    spectrum : of texel value 1 (or of the strongest emitter), W m⁻² sr⁻¹ nm⁻¹, or None if it
        cannot be separated from a picture
    pictures : emitter node -> (property, node of its neutral picture, or its power relative to
        `spectrum`)
    """

    spectrum: Spectrum | None
    pictures: dict[int, tuple[str, int | float]]

    @property
    def luminance_cd_per_m2(self) -> float:
        """Luminance of texel value 1: 683.002 ∫ ȳ L dλ."""
        if self.spectrum is None:
            return 0.0
        edges = grid_nm(_LUMINANCE_STEP_NM)
        at = (edges[:-1] + edges[1:]) / 2
        luminous = self.spectrum.cell_means(edges) * spectral.photopic_efficiency(at)
        return float(spectral.LUMINOUS_EFFICACY_LM_PER_W * _LUMINANCE_STEP_NM * luminous.sum())

    @property
    def radiance_w_per_m2_sr(self) -> float:
        """Radiance of texel value 1, of all wavelengths."""
        if self.spectrum is None:
            return 0.0
        return self.spectrum.integral(*self.spectrum.nodes_nm[[0, -1]].tolist())

    @property
    def has_luminance(self) -> bool:
        """Whether a luminance can state how much light there is."""
        return self.luminance_cd_per_m2 > spectral.MIN_LM_PER_W * self.radiance_w_per_m2_sr


def find_lamps(state: Tree, variant: str) -> list[Lamp]:
    """Group the emitters by spectrum, in scene order; those whose spectrum varies over them are the
    last group.
    """
    # Pictures cannot be scaled, so emitters with pictures share a group only at the same power.
    # Key of a group: key of the spectrum, and the power of its pictures; None without a picture.
    groups: dict[tuple[Any, ...], list[tuple[int, str, float, int | None]]] = {}
    coloured: dict[int, tuple[str, int | float]] = {}
    for index, node in nodes_of(state, "Emitter"):
        name = EMISSION.get(node.plugin, "")
        emission = _emission(state, node)
        if emission is None:
            coloured[index] = name, 1.0
            continue
        key, power, picture = emission
        group = key, None if picture is None else power
        groups.setdefault(group, []).append((index, name, power, picture))

    # Emitters without a picture may have any power: they join the first group with pictures of
    # their spectrum.
    picture_groups: dict[tuple[Any, ...], tuple[Any, ...]] = {}
    for key, power in groups:
        if power is not None:
            picture_groups.setdefault(key, (key, power))
    for key, group in picture_groups.items():
        groups[group] += groups.pop((key, None), [])

    lamps = []
    for (key, picture_power), emitters in groups.items():
        group_power = picture_power
        if picture_power is None:
            group_power = max(power for _, _, power, _ in emitters)
        pictures: dict[int, tuple[str, int | float]] = {}
        for index, name, power, picture in emitters:
            relative_power = power / group_power if group_power else 1.0
            pictures[index] = name, relative_power if picture is None else picture
        lamps.append(Lamp(evaluate(key, variant) * group_power, pictures))
    return [*lamps, Lamp(None, coloured)] if coloured else lamps


def find_lamp(state: Tree, variant: str) -> Lamp | None:
    """Return the lamp of all emitters if they share one spectrum, else None."""
    lamps = find_lamps(state, variant)
    return lamps[0] if len(lamps) == 1 and lamps[0].spectrum is not None else None


def _emission(state: Tree, emitter: Node) -> tuple[tuple[Any, ...], float, int | None] | None:
    """Return an emitter's spectrum (a hashable key), power and neutral picture (a node), or None if
    they cannot be separated.
    """
    name = EMISSION.get(emitter.plugin)
    if name is None:
        return None
    if name not in emitter:  # Mitsuba's default: a d65 of scale 1
        return ("d65",), 1.0, None

    # The texture of a spot is beside its spectrum.
    for key, index in children(emitter, state).items():
        node = state.nodes[index]
        if key != name and node.kind == "Texture" and not is_neutral(node):
            return None

    match emitter.kind_of(name):
        case "Float" | "Integer":  # a plain number is a d65 of that scale
            return ("d65",), float(emitter[name]), None
        case "Color":
            return ("rgb", emitter.text_of(name)), 1.0, None
        case "Spectrum":
            value = emitter[name]
            if value.uniform:
                return ("uniform",), float(value.values[0]), None
            return _table_key(parsed_table(value)), 1.0, None
        case "ResolvedReference" | "Reference":
            return _texture_emission(state, children(emitter, state)[name])
    return None


def _texture_emission(state: Tree, index: int) -> tuple[tuple[Any, ...], float, int | None] | None:
    """Return spectrum, power and neutral picture of light that a texture describes, or None if they
    cannot be separated.

    index : node of the texture
    """
    node = state.nodes[index]
    if node.plugin == "bitmap" and is_neutral(node):
        return ("uniform",), 1.0, index

    # A spectrum may hold a neutral picture.
    nested = list(children(node, state).values())
    if len(nested) > 1 or (nested and not is_neutral(state.nodes[nested[0]])):
        return None
    picture = nested[0] if nested else None

    values = {
        key: value for key, value in plain_values(node) if isinstance(value, (int, float, str))
    }
    table = _table_of(node)
    if node.plugin == "uniform":
        return ("uniform",), float(values.get("value", 1.0)), picture
    if node.plugin == "d65" and "color" not in node:
        return ("d65",), float(values.get("scale", 1.0)), picture
    if table is not None:
        return _table_key(table), 1.0, picture
    if node.plugin == "blackbody":
        return ("blackbody", *sorted(values.items())), 1.0, picture
    return None


def _table_key(table: Spectrum) -> tuple[Any, ...]:
    """Return the key of a spectrum that is a table, for `evaluate`."""
    return "table", tuple(table.nodes_nm.tolist()), tuple(table.values.tolist())


def is_neutral(texture: Node) -> bool:
    """Return whether a texture multiplies all wavelengths alike: a raw bitmap does."""
    return texture.plugin == "bitmap" and bool(texture.get("raw", False))


def parsed_table(value: SpectrumTable) -> Spectrum:
    """Return a spectrum that the parser stores as a table."""
    return Spectrum(np.array(value.wavelengths, float), np.array(value.values, float))


def _table_of(node: Node) -> Spectrum | None:
    """Return the table of a `regular` or `irregular` spectrum whose values are in the XML, else
    None.
    """
    if node.plugin not in ("regular", "irregular"):
        return None

    with suppress(KeyError, ValueError):
        values = np.array(numbers(node["values"]))
        if node.plugin == "irregular":
            return Spectrum(np.array(numbers(node["wavelengths"])), values)
        if "wavelength_min" in node:
            low = float(node["wavelength_min"])
            high = float(node["wavelength_max"])
        else:
            low, high = numbers(node["range"])
        return Spectrum(np.linspace(low, high, values.size), values)
    return None


def evaluate(key: tuple[Any, ...], variant: str) -> Spectrum:
    """Return the spectrum of a key from `_emission`."""
    plugin = key[0]
    if plugin == "table":
        return Spectrum(np.array(key[1]), np.array(key[2]))
    if plugin == "uniform":
        return tabulated(np.ones(grid_nm().size))
    if plugin == "rgb":  # an emitter multiplies it by D65
        colour = {"type": "rgb", "value": numbers(key[1])}
        return tabulated(evaluate_spectrum({"type": "constant", "radiance": colour}, variant))

    properties = dict(key[1:])
    values = evaluate_spectrum({"type": plugin, **properties}, variant)
    if plugin == "blackbody" and not {"wavelength_min", "wavelength_max"} & properties.keys():
        return _extended_black_body(values, properties["temperature"])
    return tabulated(values)


def _extended_black_body(visible: Array, temperature_k: float) -> Spectrum:
    """Return a black body's spectrum beyond 360-830 nm, where Mitsuba's ends: what a sensor misses
    there follows from Planck's law.

    visible : (G,) its spectrum on the grid of 360-830 nm, in any unit
    """
    nm = np.arange(*_BLACK_BODY_NM)
    end_nm = np.array([LOW_NM, HIGH_NM])
    nearest_end = np.where(nm < LOW_NM, 0, 1)
    with np.errstate(invalid="ignore"):  # 0/0 where it is too cold to shine
        shape = planck(nm, temperature_k) / planck(end_nm, temperature_k)[nearest_end]

    values = shape * np.where(nm < LOW_NM, visible[0], visible[-1])
    values[(nm >= LOW_NM) & (nm <= HIGH_NM)] = visible
    return Spectrum(nm, values)


def planck(wavelength_nm: Array, temperature_k: float) -> Array:
    """Return the spectrum of a black body in any unit, (...) as the wavelengths."""
    with np.errstate(over="ignore", divide="ignore"):
        return np.asarray(
            wavelength_nm**-5.0 / np.expm1(_SECOND_RADIATION_NM_K / (wavelength_nm * temperature_k))
        )


def warnings_of_skies(state: Tree, variant: str) -> list[str]:
    """Return Mitsuba's warnings of the skies of a scene, such as that the sun is below the
    horizon.
    """
    warnings = []
    for _, node in nodes_of(state, "Emitter"):
        if node.plugin != "sunsky":
            continue
        description: dict[str, Any] = {"type": node.plugin}
        for name, value in plain_values(node):
            if isinstance(value, int | float | list):
                description[name] = value
        warnings += [f"{node.plugin}: {text}" for text in plugin_warnings(description, variant)]
    return warnings


def lamps_in_range(lamps: list[Lamp], span: Span = VISIBLE) -> list[Lamp]:
    """Return the lamps that emit light in a range. Raises PixsimError if a radiance is negative or
    not finite.
    """
    for lamp in lamps:
        values = lamp.spectrum.values if lamp.spectrum else np.zeros(1)
        if not np.isfinite(values).all() or values.min() < 0:
            raise invalid("emitter", f"radiance {values.min():g}", "finite values of 0 or more")
    return [
        lamp
        for lamp in lamps
        if lamp.spectrum is None or lamp.spectrum.integral(span.low_nm, span.high_nm) > 0
    ]


def white_spectra(state: Tree, lamps: list[Lamp], names: Sequence[str]) -> tuple[Spectrum, ...]:
    """Return the spectra that add up to the light of the scene's white, in one unit; none if that
    is unknown.

    lamps : of `find_lamps`
    names : ids of the emitters that shine on the white together, each with a picture of 1; none:
        all, if they share a spectrum

    Raises PixsimError for the id of no emitter, of emitters whose spectra have no common unit, and
    of dark ones.
    """
    if not names:
        lamp_spectra = [lamp.spectrum for lamp in lamps if lamp.spectrum is not None]
        return (lamp_spectra[0],) if len(lamps) == len(lamp_spectra) == 1 else ()

    emitters = {node.id: (index, node.plugin) for index, node in nodes_of(state, "Emitter")}
    unknown = [name for name in names if name not in emitters]
    if unknown:
        allowed = f"ids of emitters of the scene: {', '.join(emitters)}"
        raise invalid(WHITE_LAMPS, f"'{unknown[0]}'", allowed, did_you_mean(unknown[0], emitters))

    quantities = dict.fromkeys(str(EMISSION.get(emitters[name][1])) for name in names)
    quoted_names = f"'{', '.join(names)}'"
    if len(quantities) > 1:
        got = f"{quoted_names}, whose spectra are {' and '.join(quantities)}"
        raise invalid(WHITE_LAMPS, got, "emitters with one unit")

    spectra = []
    for name in names:
        index = emitters[name][0]
        lamp = next(lamp for lamp in lamps if index in lamp.pictures)
        if lamp.spectrum is None:
            got = f"'{name}', whose spectrum varies over it"
            raise invalid(WHITE_LAMPS, got, "emitters with one spectrum each")
        power = lamp.pictures[index][1]
        spectra.append(lamp.spectrum * (power if isinstance(power, float) else 1.0))
    if not sum(float(spectrum.values.max()) for spectrum in spectra) > 0:
        raise invalid(WHITE_LAMPS, f"{quoted_names}, which are dark", "emitters with light")
    return tuple(spectra)


# The spectral properties of the stock BSDFs.
LAMBERTIAN = ("diffuse", "twosided")
_METALS = ("conductor", "roughconductor")
INSIDE = ("plastic", "roughplastic")  # multiple reflections under a coat: ρ/(1 - F ρ)
SPECTRA: dict[str, tuple[str, ...]] = {
    "diffuse": ("reflectance",),
    **dict.fromkeys(INSIDE, ("diffuse_reflectance", "specular_reflectance")),
    **dict.fromkeys(_METALS, ("specular_reflectance",)),
    **dict.fromkeys(
        ("dielectric", "roughdielectric", "thindielectric"),
        ("specular_reflectance", "specular_transmittance"),
    ),
    **dict.fromkeys(("twosided", "blendbsdf", "mask", "bumpmap", "normalmap", "null"), ()),
}
_INTERNAL_REFLECTION = 0.6  # F of a coat of index 1.49, from inside
_METAL_COSINES = (1.0, 0.7, 0.3)
MAX_POWER = 3  # of a reflectance, for interreflections of similar surfaces; higher orders are weak
_TO_AND_FRO = (0.5, 0.8, 0.95)
_MAX_PRODUCTS = 160
# Of surfaces; more take longer to plan than a pass for every band takes to render.
_MAX_SPECTRA = 256
_NEUTRAL_SPREAD = 1e-6


Beyond = Literal["hold", "zero"]


@dataclass
class Surfaces:
    """The spectra of a scene's surfaces.

    spectra : (n, G) of single surfaces on the range's grid of 1 nm, without neutral ones, or None
        if they are unknown
    unknown : why they are unknown
    span : range that is computed
    beyond : how spectra go on that end within the range, or None where the user does not state it
    short : ranges of tables that end inside 360-830 nm; Mitsuba takes 0 outside
    ending : surfaces whose spectra end within the range, for messages
    held : (node, property) -> table in place of the scene's, which goes on to the ends of the
        range, or ends in 0
    """

    spectra: Array | None = field(default=None, repr=False)
    unknown: str = ""
    span: Span = VISIBLE
    beyond: Beyond | None = None
    short: set[str] = field(default_factory=set)
    ending: list[str] = field(default_factory=list)
    held: dict[tuple[int, str], Spectrum] = field(default_factory=dict, repr=False)

    def products(self, bounces: int) -> Array:
        """Return the spectra of light after up to `bounces` surfaces (-1: any number), relative to
        the lamp, (m, G).
        """
        if self.spectra is None:
            return np.zeros((0, grid_nm(span=self.span).size))
        single = self.spectra
        if bounces == 1 or not len(single):
            return single

        max_power = MAX_POWER if bounces < 0 else min(bounces, MAX_POWER)
        powers = [single**power for power in range(2, max_power + 1)]

        # Light after many interreflections, with a small or large probability a of each:
        # ρ/(1 - aρ).
        shares = _TO_AND_FRO if bounces < 0 else ()
        series = [single / (1 - share * np.minimum(single, 1.0)) for share in shares]

        pairs = [
            single[i] * single[j]
            for i, j in combinations_with_replacement(range(len(single)), 2)
            if i != j
        ]
        spread = np.linspace(0, len(pairs) - 1, min(len(pairs), _MAX_PRODUCTS)).astype(int)
        spread_pairs = [pairs[index] for index in spread]
        return np.vstack([single, *powers, *series, *(spread_pairs or [single[:0]])])

    def on_grid(self, table: Spectrum, index: int, name: str, label: str) -> Array:
        """Return a spectrum of a node's property on the grid of the range, (G,).

        label : of the surface, in messages
        """
        low = float(table.nodes_nm[0])
        high = float(table.nodes_nm[-1])
        ends_before = bool(low > self.span.low_nm and table.values[0] > 0)
        ends_after = bool(high < self.span.high_nm and table.values[-1] > 0)

        if self.beyond is None:
            begins_visibly = low > LOW_NM and table.values[0] > 0
            ends_visibly = high < HIGH_NM and table.values[-1] > 0
            if begins_visibly or ends_visibly:
                self.short.add(f"{low:g}-{high:g} nm")
            is_unknown_before = ends_before and self.span.low_nm < LOW_NM
            is_unknown_after = ends_after and self.span.high_nm > HIGH_NM
            if is_unknown_before or is_unknown_after:
                self.ending.append(f"{label}, {low:g}-{high:g} nm")
        elif ends_before or ends_after:
            if self.beyond == "hold":
                table = self._held_to_ends(table, ends_before, ends_after)
            # Mitsuba's colours go on beyond their ends, so zeros too are stated.
            self.held[index, name] = table
        return table.at(grid_nm(span=self.span))

    def _held_to_ends(self, table: Spectrum, ends_before: bool, ends_after: bool) -> Spectrum:
        """Return a table that goes on with its first or last value to the ends of the range."""
        nodes_nm = list(table.nodes_nm)
        values = list(table.values)
        if ends_before:
            nodes_nm.insert(0, self.span.low_nm)
            values.insert(0, values[0])
        if ends_after:
            nodes_nm.append(self.span.high_nm)
            values.append(values[-1])
        return Spectrum(np.array(nodes_nm), np.array(values))


class _UnknownError(Exception):
    """A surface has spectra that nothing in the scene states."""


def find_surfaces(
    state: Tree, variant: str, span: Span = VISIBLE, beyond: Beyond | None = None
) -> Surfaces:
    """Return the spectra that BSDFs multiply light with, from the parsed tree.

    span : range that is computed
    beyond : whether spectra that end within the range hold their last value or are zero there, or
        None where the user does not state it
    """
    surfaces = Surfaces(span=span, beyond=beyond)
    try:
        spectra = _single_surfaces(state, variant, surfaces)
    except _UnknownError as error:
        surfaces.unknown = str(error)
        if span != VISIBLE:
            surfaces.ending.append(surfaces.unknown)
        return surfaces

    coloured = [rho for rho in spectra if np.ptp(rho) > _NEUTRAL_SPREAD * max(rho.max(), 1.0)]
    unique = {rho.round(9).tobytes(): rho for rho in coloured}
    surfaces.spectra = np.array(list(unique.values())).reshape(-1, grid_nm(span=span).size)
    return surfaces


def _single_surfaces(state: Tree, variant: str, surfaces: Surfaces) -> list[Array]:
    """Return the spectra of all BSDFs, neutral ones too. Raises _UnknownError."""
    if nodes_of(state, "Medium"):
        raise _UnknownError("a medium with unknown spectra")

    spectra: list[Array] = []
    for index, node in nodes_of(state, "BSDF"):
        plugin = node.plugin
        if len(spectra) > _MAX_SPECTRA:
            raise _UnknownError(f"more than {_MAX_SPECTRA} spectra of surfaces")
        if plugin not in SPECTRA:
            raise _UnknownError(f"a BSDF '{plugin}' with unknown spectra")

        fresnel: list[Array] = []
        if plugin in _METALS:
            try:
                fresnel = _metal_reflectances(state, node, variant, surfaces.span)
            except PixsimError as error:
                # Mitsuba names no element in a description that pixsim makes.
                raise PixsimError(f"the index of {_node_label(node)}: {error}") from None
            if surfaces.span != VISIBLE:
                surfaces.ending.append(f"the metal of {_node_label(node)}")
        spectra += fresnel

        for name in SPECTRA[plugin]:
            if name not in node:
                continue
            label = f"{name} of {_node_label(node)}"
            colours = _property(state, index, name, variant, surfaces, label)
            spectra += colours
            if plugin in INSIDE:
                spectra += [rho / (1 - _INTERNAL_REFLECTION * rho) for rho in colours]
            spectra += [rho * metal for rho in colours for metal in fresnel]
    return spectra


def _property(
    state: Tree, index: int, name: str, variant: str, surfaces: Surfaces, label: str
) -> list[Array]:
    """Return the spectra that a property of a node may have; none if it is neutral. Raises
    _UnknownError.
    """
    node = state.nodes[index]
    kind = node.kind_of(name)
    if kind in ("Float", "Integer"):
        return []
    if kind == "Color":
        value = numbers(node.text_of(name))
        if not np.ptp(value):
            return []
        colour = tabulated(evaluate_spectrum({"type": "rgb", "value": value}, variant))
        return [surfaces.on_grid(colour, index, name, f"{label}, an RGB colour")]
    if kind == "Spectrum":
        value = node[name]
        return [] if value.uniform else [surfaces.on_grid(parsed_table(value), index, name, label)]

    child = children(node, state).get(name)
    if child is None:
        raise _UnknownError(f"an unknown texture in {label}")
    texture = state.nodes[child]
    if texture.plugin == "uniform" or is_neutral(texture):
        return []
    table = _table_of(texture)
    if table is not None:
        return [surfaces.on_grid(table, index, name, label)]
    if texture.plugin == "checkerboard":
        spectra: list[Array] = []
        for colour_name in ("color0", "color1"):
            if colour_name in texture:
                spectra += _property(state, child, colour_name, variant, surfaces, label)
        return spectra
    raise _UnknownError(f"an unknown texture in {label}")


def _metal_reflectances(state: Tree, node: Node, variant: str, span: Span) -> list[Array]:
    """Return the Fresnel reflectances of a conductor at several angles, from Mitsuba. Raises
    _UnknownError.
    """
    description: dict[str, Any] = {"type": "conductor"}
    textures = children(node, state)
    for name in ("material", "eta", "k"):
        if name in textures:
            texture = state.nodes[textures[name]]
            if texture.plugin not in ("uniform", "regular", "irregular"):
                raise _UnknownError(f"an unknown refractive index of {_node_label(node)}")
            description[name] = {"type": texture.plugin, **dict(plain_values(texture))}
        elif name in node:
            value = node[name]
            if isinstance(value, SpectrumTable) and value.uniform:
                value = {"type": "uniform", "value": float(value.values[0])}
            elif isinstance(value, SpectrumTable):
                value = irregular(value.wavelengths, value.values)
            description[name] = value

    # Beyond its tables, where a metal renders as a mirror, its reflectance along the normal is 0/0.
    return [
        np.nan_to_num(evaluate_reflection(description, cosine, variant, span), nan=1.0)
        for cosine in _METAL_COSINES
    ]


FLAT = ("rectangle", "disk")
_PARALLEL = 1e-6  # sine of the largest angle between the normals of parallel planes
_IN_FRONT_M = 1e-9


@dataclass(frozen=True)
class Body:
    """A shape in the camera's frame: x to the left of the picture, y up, z along the axis, m.

    corners : (n, 3) of a bounding box, or None if the XML does not state the size
    normal : (3,) of the front side of a flat shape
    node : index of the shape
    """

    node: int
    corners: Array | None = field(repr=False)
    normal: Array | None

    @property
    def depths_m(self) -> tuple[float, float]:
        assert self.corners is not None
        return float(self.corners[:, 2].min()), float(self.corners[:, 2].max())

    def in_view(self, camera: Camera, aspect: float) -> bool:
        """Return whether the shape may be in the picture, blur included: not all of it is beyond
        one side.

        aspect : width of the film over its height
        """
        if self.corners is None:
            return True

        x, y, z = self.corners.T
        focus_m = camera.object_distance_m
        tangent_x = camera.die_mm / (2 * camera.image_distance_mm)
        for coordinate, tangent in ((x, tangent_x), (y, tangent_x / aspect)):
            # The edge rays of the outermost sample start at the far rim of the lens and cross in
            # the plane in focus.
            half_field_m = tangent * focus_m
            edges_m = [
                np.abs(rim_m + (half_field_m - rim_m) * z / focus_m)
                for rim_m in (camera.aperture_radius_m, -camera.aperture_radius_m)
            ]
            edge_m = np.maximum(*edges_m)
            if np.all(coordinate > edge_m) or np.all(coordinate < -edge_m):
                return False
        return bool(np.any(z > _IN_FRONT_M))


def transform_matrix(node: Node, name: str = "to_world") -> Array:
    return np.array(node[name]) if name in node else np.eye(4)


def find_bodies(state: Tree, sensor: Node) -> list[Body]:
    """Return every shape that may be in view; the members of a shape group are placed at its
    instances.
    """
    to_camera = np.asarray(np.linalg.inv(transform_matrix(sensor)), float)
    shapes = nodes_of(state, "Shape")
    group_of_member = {
        member: index
        for index, node in shapes
        if node.plugin == "shapegroup"
        for member in children(node, state).values()
    }

    bodies = []
    for index, node in shapes:
        if index in group_of_member or node.plugin == "shapegroup":
            continue
        if node.plugin == "instance":
            group = next(iter(children(node, state).values()), None)
            members = [
                state.nodes[member] for member, owner in group_of_member.items() if owner == group
            ]
            box = _group_box(members)
            to_frame = to_camera @ transform_matrix(node)
            normal = None
        else:
            box = _box(node)
            to_frame = to_camera
            normal = _facing(to_camera, node)
        corners = None if box is None else _transformed(to_frame, box)
        bodies.append(Body(node=index, corners=corners, normal=normal))
    return bodies


def _group_box(members: Sequence[Node]) -> Array | None:
    """Return the corners of the bounding boxes of a shape group, or None if one is unknown."""
    boxes = [_box(member) for member in members if member.kind == "Shape"]
    stated_boxes = [box for box in boxes if box is not None]
    if not boxes or len(stated_boxes) < len(boxes):
        return None
    return np.vstack(stated_boxes)


def _box(node: Node) -> Array | None:
    """Return the corners of a bounding box of a stock shape in world coordinates, or None."""
    cube = np.array(list(product((-1.0, 1.0), repeat=3)))
    if node.plugin in FLAT:
        corners = np.array([[x, y, 0.0] for x, y in product((-1.0, 1.0), repeat=2)])
    elif node.plugin == "cube":
        corners = cube
    elif node.plugin == "sphere":
        centre = np.array(node.get("center", [0.0, 0.0, 0.0]), float).ravel()
        corners = centre + float(node.get("radius", 1.0)) * cube
    elif node.plugin == "cylinder":
        radius = float(node.get("radius", 1.0))
        ends = [np.array(node.get(f"p{end}", [0.0, 0, end]), float).ravel() for end in (0, 1)]
        corners = np.vstack([end + radius * cube for end in ends])
    else:
        return None
    return _transformed(transform_matrix(node), corners)


def _facing(to_camera: Array, node: Node) -> Array | None:
    """Return the unit normal of the front side of a flat shape in the camera's frame, else None."""
    if node.plugin not in FLAT:
        return None
    # Normals transform by the inverse transpose, so that a mirrored shape keeps its front side.
    normal = np.linalg.inv((to_camera @ transform_matrix(node))[:3, :3])[2]
    if node.get("flip_normals", False):
        normal = -normal
    return np.asarray(normal / np.linalg.norm(normal))


def _transformed(matrix: Array, points: Array) -> Array:
    homogeneous = np.c_[points, np.ones(len(points))] @ matrix.T
    return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:])


def blur_um(camera: Camera, depth_m: float) -> float:
    """Return the diameter on the sensor of the blur disc of a point at a depth; infinite at and
    behind the lens.
    """
    if depth_m <= 0:
        return np.inf

    # The disc is 2a |d - u|/d in the plane in focus, times the magnification of that plane.
    focus_m = camera.object_distance_m
    disc_m = 2 * camera.aperture_radius_m * abs(depth_m - focus_m) / depth_m
    return float(disc_m * camera.image_distance_mm * 1e3 / focus_m)


def greatest_blur_um(camera: Camera, body: Body) -> float:
    if body.corners is None:
        return np.inf
    return max(blur_um(camera, depth_m) for depth_m in body.depths_m)


def face_one_way(bodies: list[Body]) -> bool:
    """Return whether all shapes are flat, parallel and face the same way, so that they do not light
    each other.
    """
    normals = [body.normal for body in bodies if body.normal is not None]
    if len(normals) < len(bodies) or not normals:
        return False
    first = normals[0]
    return all(
        float(first @ normal) > 0 and float(np.linalg.norm(np.cross(first, normal))) < _PARALLEL
        for normal in normals
    )


_PLAIN_SPECTRA = ("uniform", "d65", "blackbody", "regular", "irregular", "srgb")
# Maps that are neither light nor reflectance may have any values and channels.
MAPS = ("normalmap", "bumpmap", "mask", "blendbsdf")
_NUMBERS_OF_TEXTURES = ("value", "values", "color0", "color1")
_MAP_NAMES = (
    "alpha",
    "alpha_u",
    "alpha_v",
    "roughness",
    "metallic",
    "anisotropic",
    "weight",
    "opacity",
)


def files_of_scene(state: Tree) -> list[Path]:
    """Return the files of all nodes: pictures, meshes and volumes."""
    return [_file_of(node) for node in state.nodes if "filename" in node]


def _file_of(node: Node) -> Path:
    return Path(str(node["filename"]))


def asset_files(state: Tree) -> tuple[AssetFile, ...]:
    """Return the files of all nodes, with what they must be for what they are used."""
    maps: set[int] = set()
    light_textures: set[int] = set()
    shares: dict[int, str] = {}
    for node in state.nodes:
        for name, index in children(node, state).items():
            textures = maps if _takes_map(node, name) else light_textures
            textures.add(index)
            if _is_share(node, name):
                # The texture, and those within a checkerboard.
                for texture in (index, *children(state.nodes[index], state).values()):
                    shares[texture] = f"{node.plugin}.{name}"

    files = []
    for index, node in enumerate(state.nodes):
        if "filename" not in node:
            continue
        path = _file_of(node)
        files.append(
            AssetFile(
                path=str(path),
                digest=digest_of(path),
                plugin=node.plugin,
                shape_index=int(node.get("shape_index", 0)),
                has_light=node.kind != "Shape" and index not in maps - light_textures,
                share=shares.get(index, ""),
            )
        )
    return tuple(files)


def _is_share(node: Node, name: str) -> bool:
    """Return whether a property of a node is a share of the light that a surface sends back."""
    return node.kind == "BSDF" and (
        name.endswith(("reflectance", "transmittance")) or name == "base_color"
    )


def check_shares(state: Tree) -> None:
    """Warn of reflectances above 1, and raise PixsimError above 1.5, where the XML has their
    numbers.
    """
    for node in state.nodes:
        for name in node:
            if _is_share(node, name):
                highest = max(_numbers_of(state, node, name), default=0.0)
                check_share(highest, f"{node.plugin}.{name}", f"bsdf {_node_label(node)}")


def _numbers_of(state: Tree, node: Node, name: str) -> list[float]:
    """Return the numbers of a property and of the textures within it."""
    index = children(node, state).get(name)
    if index is not None:
        texture = state.nodes[index]
        values: list[float] = []
        for texture_name in _NUMBERS_OF_TEXTURES:
            if texture_name in texture:
                values += _numbers_of(state, texture, texture_name)
        return values

    match node.kind_of(name):
        case "Spectrum":
            return list(node[name].values)
        case "Color":
            return numbers(node.text_of(name))
        case "Float" | "Integer" | "String":
            with suppress(ValueError):  # Mitsuba says it
                return numbers(node[name])
    return []


def _node_label(node: Node) -> str:
    """Return the id of a node that has one, or its plugin, for messages."""
    return f"'{node.id}'" if node.id and not node.id.startswith("_") else f"a {node.plugin}"


def _takes_map(node: Node, name: str) -> bool:
    """Return whether a property of a node takes any numbers, such as normals and roughness, not
    light or reflectance.
    """
    return node.plugin in MAPS or name in _MAP_NAMES


@lru_cache(maxsize=2)  # of two sensors that are compared
def _texels_of(path: Path, digest: str) -> NDArray[np.float32]:
    """Return the texels of a neutral EXR, shared by several calls, which must not change them.

    digest : of the file, so that a changed file is read anew

    Raises PixsimError if it has several channels, or texels that are no light.
    """
    channels = read_channels(path)[0]
    if len(channels) > 1:
        got = f"channels {', '.join(names_in(channels))} with raw = true"
        raise invalid(f"texture '{path}'", got, "one channel, Y")
    texels = next(iter(channels.values()))
    check_texels(path, texels)
    return texels


RAW = 'Write <boolean name="raw" value="true"/> in its <bitmap>.'


def check_textures(state: Tree) -> None:
    """Raise PixsimError for textures that Mitsuba would take for colours where numbers are needed,
    or the reverse.
    """
    for node in state.nodes:
        for name, index in children(node, state).items():
            _check_texture(node, name, state.nodes[index])


def _check_texture(node: Node, name: str, texture: Node) -> None:
    """Raise PixsimError for a texture of the wrong kind in a property of a node."""
    is_raw = is_neutral(texture)
    is_colour_bitmap = texture.plugin == "bitmap" and not is_raw
    if is_colour_bitmap and node.plugin == "normalmap":
        raise invalid(
            f"normalmap '{_file_of(texture).name}'",
            "a picture without raw = true",
            "the numbers of the file, unconverted",
            RAW,
        )

    is_index = node.plugin in _METALS and name in ("eta", "k")
    if is_index and (texture.plugin == "srgb" or is_colour_bitmap):
        raise invalid(
            f"{node.plugin}.{name}",
            f"a colour, from a texture {texture.plugin}",
            "a number, a spectrum, or a bitmap with raw = true",
            METAL_BY_NAME,
        )

    if is_raw and not _takes_map(node, name) and _file_of(texture).suffix.lower() in EIGHT_BIT:
        raise invalid(
            f"texture '{_file_of(texture)}'",
            f"{_file_of(texture).suffix} with raw = true",
            "a linear float32 EXR with one channel, as written by pixsim chart",
        )


BEYOND: dict[str, Literal["edge", "wrap", "symmetric"]] = {
    "clamp": "edge",
    "repeat": "wrap",
    "mirror": "symmetric",
}
_KNOWN_OF_BITMAPS = {"filename", "raw", "wrap_mode", "filter_type", "to_uv"}


@dataclass(frozen=True)
class _EmittedPicture:
    """The picture of an emitter.

    texels : (rows, columns), as in the file
    along_u, along_v : 1, or -1 if columns or rows run against the shape's u or v
    beyond : what continues the texels beyond their sides, a mode of `np.pad`, or None if it is not
        known how they are interpolated
    source : hash of its file
    nearest : whether each texel is uniform, not interpolated linearly
    """

    texels: Array = field(repr=False)
    along_u: float = 1.0
    along_v: float = 1.0
    beyond: Literal["edge", "wrap", "symmetric"] | None = "edge"
    source: str = ""
    nearest: bool = False


def emitted_picture(state: Tree, emitter: Node) -> _EmittedPicture | None:
    """Return an emitter's neutral EXR, or one texel of value 1 if it has no picture.

    Returns None if the picture is of another kind, rotated, repeated or not centred.
    """
    # The picture may lie within a spectrum.
    texture = children(emitter, state).get(EMISSION.get(emitter.plugin, ""))
    while texture is not None and not is_neutral(state.nodes[texture]):
        nested = list(children(state.nodes[texture], state).values())
        if not nested and state.nodes[texture].plugin not in _PLAIN_SPECTRA:
            return None
        texture = nested[0] if nested else None
    if texture is None:
        return _EmittedPicture(np.ones((1, 1)))

    node = state.nodes[texture]
    if "filename" not in node:
        return None
    path = _file_of(node)
    to_uv = transform_matrix(node, "to_uv")
    is_upright = np.allclose(np.abs(to_uv[:2, :2]), np.eye(2))
    is_centred = np.allclose(to_uv[:2, :2].sum(axis=1) / 2 + to_uv[:2, 3], 0.5)
    if path.suffix.lower() != ".exr" or not is_upright or not is_centred:
        return None

    # Other properties could change how Mitsuba continues the texels.
    beyond = None
    if set(node) <= _KNOWN_OF_BITMAPS:
        beyond = BEYOND.get(str(node.get("wrap_mode", "repeat")))
    source = digest_of(path)
    return _EmittedPicture(
        texels=_texels_of(path, source).astype(float),
        along_u=float(np.sign(to_uv[0, 0])),
        along_v=float(np.sign(to_uv[1, 1])),
        beyond=beyond,
        source=source,
        nearest=node.get("filter_type", "bilinear") == "nearest",
    )
