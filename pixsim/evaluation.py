"""Mitsuba's own plugins, asked for their values at each wavelength."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.mitsuba_xml import speaking_mitsuba
from pixsim.spectral import Array
from pixsim.spectrum import grid_nm


def evaluate_spectrum(description: dict[str, Any], variant: str) -> Array:
    """A spectrum plugin at 360 … 830 nm in steps of 1 nm, as Mitsuba returns it."""
    with speaking_mitsuba(variant, Path()) as mi:
        texture = mi.load_dict(description)
        return _at_each_wavelength(mi, variant, texture.eval)


def evaluate_emitter(description: dict[str, Any], variant: str) -> Array:
    """A colour as an emitter takes it (times d65), on the same grid."""
    with speaking_mitsuba(variant, Path()) as mi:
        emitter = mi.load_dict({"type": "constant", "radiance": description})
        return _at_each_wavelength(mi, variant, emitter.eval)


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
