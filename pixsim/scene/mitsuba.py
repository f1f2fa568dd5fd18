"""The one place that imports Mitsuba: its errors in one line, its parser's tree, and its plugins' values at each wavelength."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.light.spectral import grid_nm


def import_mitsuba(variant: str) -> Any:
    """Import Mitsuba with its variant set; `pixsim.scene.variant.choose` must have run before."""
    import drjit as dr
    import mitsuba as mi

    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            reason = " ".join(str(error).split())
            raise invalid("variant", f"'{variant}' ({reason})", "one that runs here", "Leave out --variant.") from None
    if dr.thread_count() < 2:
        dr.set_thread_count(2)  # Mitsuba 3.9 waits for ever for an EXR texture in a pool of one
    return mi


@contextmanager
def speaking_mitsuba(variant: str, folder: Path) -> Iterator[Any]:
    """Mitsuba with the scene's folder on its search path for the while, and its errors told in one line."""
    mi = import_mitsuba(variant)
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield mi
    except RuntimeError as error:
        if _is_interrupt(error):
            raise KeyboardInterrupt from None
        text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", str(error).strip())
        raise PixsimError("Mitsuba refuses the scene: " + " ".join(text.split())) from None
    finally:
        mi.set_file_resolver(before)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether it is Ctrl-C, which Dr.Jit wraps into an error of its own while a kernel runs."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def parse(path: Path, variant: str, parameters: dict[str, str]) -> Any:
    """Mitsuba's parser state: the tree of nodes, before anything is built."""
    with speaking_mitsuba(variant, path.parent) as mi:
        return mi.parser.parse_file(mi.parser.ParserConfig(variant), str(path), **parameters)


def children(node: Any, state: Any) -> dict[str, int]:
    """Property -> index of the node it refers to. PixsimError for one that is not there."""
    found = {}
    for key in node.props.keys():  # noqa: SIM118  (Properties is no dict)
        kind = node.props.type(key).name
        if kind == "ResolvedReference":
            found[key] = node.props[key].index()
        elif kind == "Reference":
            name = node.props[key].id()
            if name not in state.id_to_index:
                raise invalid("scene", f"a reference to '{name}', which does not exist", "ids of the scene's nodes")
            found[key] = state.id_to_index[name]
    return found


def plain(node: Any, numbers_only: bool = True) -> Iterator[tuple[str, Any]]:
    """The properties of a node that are values, not other nodes."""
    for key in node.props.keys():  # noqa: SIM118
        if node.props.type(key).name not in ("ResolvedReference", "Reference", "Object"):
            try:
                yield key, node.props[key]
            except RuntimeError:  # an <rgb> has no Python value
                if not numbers_only:
                    yield key, node.props.as_string(key)


def nodes_of(state: Any, kind: str) -> list[tuple[int, Any]]:
    return [(index, node) for index, node in enumerate(state.nodes) if node.type.name == kind]


def evaluate_spectrum(description: dict[str, Any], variant: str) -> Array:
    """A spectrum plugin, or an emitter, at 360 … 830 nm in steps of 1 nm, as Mitsuba returns it."""
    with speaking_mitsuba(variant, Path()) as mi:
        return _at_each_wavelength(mi, variant, mi.load_dict(description).eval)


def evaluate_reflection(description: dict[str, Any], cosine: float, variant: str) -> Array:
    """What a smooth conductor reflects of light at an angle to its normal, on the same grid."""
    with speaking_mitsuba(variant, Path()) as mi:
        bsdf, context = mi.load_dict(description), mi.BSDFContext()
        towards = [math.sqrt(1 - cosine**2), 0.0, cosine]

        def reflected(interaction: Any) -> Any:
            interaction.wi = towards if variant.startswith("scalar") else mi.Vector3f(*towards)
            return bsdf.sample(context, interaction, 0.5, mi.Point2f(0.5, 0.5))[1]

        return _at_each_wavelength(mi, variant, reflected)


def spectrum_dict(table: Any) -> dict[str, Any]:
    """A spectrum that the parser keeps, as a plugin."""
    if table.is_uniform():
        return {"type": "uniform", "value": float(table.values[0])}
    columns = {name: ", ".join(repr(float(each)) for each in getattr(table, name)) for name in ("wavelengths", "values")}
    return {"type": "irregular", **columns}


def _at_each_wavelength(mi: Any, variant: str, value: Callable[[Any], Any]) -> Array:
    """`value` of surface interactions that differ in wavelength only, (471,)."""
    import drjit as dr

    wavelengths = grid_nm()
    rows = np.resize(wavelengths, (-(-wavelengths.size // 4), 4))  # Mitsuba carries four wavelengths a ray
    if variant.startswith("scalar"):
        values = []
        for row in rows:
            one = dr.zeros(mi.SurfaceInteraction3f)
            one.wavelengths = row.tolist()
            values.append(np.asarray(value(one), float).ravel())
    else:
        many = dr.zeros(mi.SurfaceInteraction3f, len(rows))
        many.wavelengths = mi.Spectrum(np.ascontiguousarray(rows.T, np.float32))
        values = [np.asarray(value(many), float).T.ravel()]
    return np.concatenate(values)[: wavelengths.size]
