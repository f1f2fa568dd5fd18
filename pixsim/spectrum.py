"""Tabulated functions of wavelength: lamps, reflectances and responses on one grid."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pixsim.errors import refuse
from pixsim.spectral import Array

LOW_NM, HIGH_NM = 360.0, 830.0  # what Mitsuba samples
# Steps of the grids on which a lamp is handled: the coarsest that resolves it. Powers of two, so that nodes, widths and
# Steps of the grids on which a lamp is handled: the coarsest that resolves it. Powers of two, so that nodes, widths and
# their ratios are exact in Mitsuba's float32 and its combined response has its nodes where ours are.
STEPS_NM = (1.0, 1 / 8, 1 / 32)
MOST = 1e30  # of any unit
FINEST_REGULAR_NM, MOST_REGULAR_VALUES = 0.1, 8192
COARSE_SPACING_NM = 0.199  # of a table's nodes: 0.2 nm but for rounding; closer ones get the finest step


def grid_nm(step_nm: float = 1.0) -> Array:
    return np.arange(LOW_NM, HIGH_NM + step_nm / 2, step_nm)


@dataclass(frozen=True)
class Spectrum:
    """A piecewise linear function of wavelength, zero outside its nodes."""

    nodes_nm: Array = field(repr=False)
    values: Array = field(repr=False)

    def __post_init__(self) -> None:
        x = self.nodes_nm
        if x.size < 2 or x.shape != self.values.shape or not np.all(np.diff(x) >= 0):
            raise refuse("spectrum", f"{x.size} wavelengths, {self.values.size} values", "two nodes or more, in rising order")
        if not (np.isfinite(x).all() and np.isfinite(self.values).all()):
            raise refuse("spectrum", "nan or infinity among its wavelengths or values", "finite numbers")
        if self.values.max() > MOST or self.values.min() < -MOST:
            raise refuse("spectrum", f"values up to {np.abs(self.values).max():.3g}", f"up to {MOST:g}, which float32 holds")

    def at(self, wavelength_nm: Array) -> Array:
        return np.interp(wavelength_nm, self.nodes_nm, self.values, left=0.0, right=0.0)

    @property
    def step_nm(self) -> float:
        """Of the grid that resolves it: 1 nm for tables at whole nanometres, finer for lines between them."""
        if np.all(self.nodes_nm == np.rint(self.nodes_nm)):
            return STEPS_NM[0]
        return STEPS_NM[1] if np.diff(self.nodes_nm).min(initial=1.0) >= COARSE_SPACING_NM else STEPS_NM[2]

    def cell_means(self, edges_nm: Array) -> Array:
        """Means over the cells between rising edges, exact: no line falls between two points."""
        x, y = self.nodes_nm, self.values
        running = np.concatenate([[0.0], np.cumsum(np.diff(x) * (y[1:] + y[:-1]) / 2)])
        at = np.clip(edges_nm, x[0], x[-1])
        index = np.clip(np.searchsorted(x, at, side="right") - 1, 0, x.size - 2)
        over = at - x[index]
        width = np.maximum(x[index + 1] - x[index], np.finfo(float).tiny)
        integral = running[index] + over * (y[index] + over / width * (y[index + 1] - y[index]) / 2)
        return np.diff(integral) / np.diff(edges_nm)

    def integral(self, low_nm: float = LOW_NM, high_nm: float = HIGH_NM) -> float:
        """∫ over a range, exact."""
        return float(self.cell_means(np.array([low_nm, high_nm]))[0] * (high_nm - low_nm))

    def on_grid(self, step_nm: float) -> Array:
        """Means over the cells around the nodes of `grid_nm`: trapezoids over them add up to the integral."""
        nodes = grid_nm(step_nm)
        return self.cell_means(np.concatenate([nodes[:1], nodes[:-1] + step_nm / 2, nodes[-1:]]))

    def __mul__(self, factor: float) -> Spectrum:
        return Spectrum(self.nodes_nm, self.values * factor)


def tabulated(values: Array) -> Spectrum:
    """A smooth spectrum from its values at 360 … 830 nm, every nanometre."""
    return Spectrum(grid_nm(), np.asarray(values, float))


def regular_values(table: Spectrum) -> Array | None:
    """Values at equal steps between the first and the last node that mean the same table; None where no step fits."""
    distances = np.diff(table.nodes_nm) / FINEST_REGULAR_NM
    whole = np.rint(distances).astype(int)
    if not np.allclose(distances, whole, rtol=0, atol=1e-6) or not np.all(whole > 0):
        return None
    count = int(whole.sum()) // int(np.gcd.reduce(whole)) + 1
    if count > MOST_REGULAR_VALUES:
        return None
    return table.at(np.linspace(table.nodes_nm[0], table.nodes_nm[-1], count))
