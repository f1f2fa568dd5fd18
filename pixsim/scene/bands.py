"""Wavelength bands and the spectral pulses that a render measures.

A ray of Mitsuba carries four wavelengths. The film response has 1, 2 or 4 disjoint pulses of equal
area, so that each pulse gets its share of the wavelengths. A pulse has the shape of the lamp
spectrum, so that no line is missed. Surface spectra are smooth and known, so a few pulses determine
all bands; `fit` finds their spectra and bounds the error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import STEPS_NM, VISIBLE, Span, Spectrum, grid_nm

Response = Callable[[Array], Array]  # of a sensor or an eye, at wavelengths in nm; any unit
NARROWEST_BAND_NM = 1.0
MAX_BANDS = 256
PARTS_OF_A_BAND = 10
_MIN_SHIFT_NM = 1.0  # shift of the centroid from the band centre below which the centre is reported
_PULSES_PER_PASS = 4
SHAPE_TOLERANCE = 0.1  # error of any band, relative to the brightest band of the same light
_PULSE_COUNTS = (1, 4, 8, 12, 16, 20, 24, 28, 32)
# Zeros at either end of a pulse, so that the film's combined table has no other nodes.
_FLANK_STEPS = 2
# regularisation towards linear interpolation between pulses, which limits noise amplification
STIFFNESS = 1e-4
# where XYZ must be right: a third of the error with as many pulses, and 3 to 25 % more noise
COLOUR_STIFFNESS = 1e-5
NEUTRAL_WEIGHT = 1e2  # weight of a neutral surface in the fit, which makes it exact


def band_edges_nm(span: Span) -> Array:
    """Return the edges of bands of 10 nm about whole tens, and the rest of a range at either
    end.
    """
    return np.concatenate(
        [[span.low_nm], np.arange(span.low_nm + 5, span.high_nm - 4, 10.0), [span.high_nm]]
    )


@dataclass(frozen=True)
class Detector:
    """A spectral response whose signal the bands must reproduce.

    response : of a channel of a sensor, or of an observer
    tolerance_factor : the error may be this many times the tolerance
    min_share_of_neutral : the error is relative to the signal, or to this share of the signal of a
        neutral surface where that is larger
    """

    response: Response
    tolerance_factor: float = 1.0
    min_share_of_neutral: float = 0.0


@dataclass(frozen=True)
class Bands:
    """Adjoining bands; a value is the mean over its band.

    edges_nm : (B + 1,)
    wavelength_nm : (B,) the centre, or the centroid of the light where lines put it elsewhere
    nodes_nm, shares : (B, n) distribution of the light within each band; shares add up to 1
    """

    edges_nm: Array = field(repr=False)
    wavelength_nm: Array = field(repr=False)
    nodes_nm: Array = field(repr=False)
    shares: Array = field(repr=False)

    @property
    def width_nm(self) -> Array:
        return np.diff(self.edges_nm)

    @property
    def span(self) -> Span:
        """The range that they cover."""
        return Span(float(self.edges_nm[0]), float(self.edges_nm[-1]))

    def mean(self, response: Response) -> Array:
        """Return the mean of a response over each band (B,), weighted by the light in it."""
        return (self.shares * response(self.nodes_nm)).sum(axis=1)

    def integrals(self, energy: Array, step_nm: float) -> Array:
        """Return the energy in each band, (..., B), from that in the cells between the nodes of
        their range's grid.
        """
        running = np.concatenate(
            [np.zeros_like(energy[..., :1]), np.cumsum(energy, axis=-1)], axis=-1
        )
        at = (self.edges_nm - self.span.low_nm) / step_nm
        index = np.minimum(at.astype(int), energy.shape[-1] - 1)
        return np.diff(running[..., index] + (at - index) * energy[..., index], axis=-1)


@dataclass(frozen=True)
class Pulse:
    """A spectral response of unit area on a regular grid, zero at both ends; values (n,) nm⁻¹."""

    low_nm: float
    high_nm: float
    values: Array = field(repr=False)

    @property
    def step_nm(self) -> float:
        return (self.high_nm - self.low_nm) / (self.values.size - 1)

    @property
    def nodes_nm(self) -> Array:
        return np.linspace(self.low_nm, self.high_nm, self.values.size)

    def mean(self, functions: Array, step_nm: float, span: Span = VISIBLE) -> Array:
        """Return ∫ pulse × function for functions on `grid_nm(step_nm, span)`, both piecewise
        linear.
        """
        first = round((self.low_nm - span.low_nm) / step_nm)
        weights = np.convolve(self.values, (1 / 6, 2 / 3, 1 / 6), mode="same") * step_nm
        return (functions[..., first : first + self.values.size] * weights).sum(axis=-1)


@dataclass(frozen=True)
class Fit:
    """Pulses, and the spectrum that the picture of each is multiplied with.

    spectra : (pulses, B) W m⁻² sr⁻¹ nm⁻¹ in each band per unit of a pulse's picture
    passes : indices of the pulses that are rendered together
    error : largest relative error of any response to the light from any surface
    """

    pulses: tuple[Pulse, ...] = field(repr=False)
    spectra: Array = field(repr=False)
    passes: list[list[int]]
    error: float = 0.0


def place_bands(
    lamps: list[Spectrum],
    surfaces: Array,
    detectors: list[Detector],
    tolerance: float,
    span: Span = VISIBLE,
) -> Bands:
    """Return bands of 10 nm, halved where a response would otherwise be wrong by more than
    `tolerance`.

    Halving is needed where lamps have lines at different places in a band, or where a surface and a
    response both vary in it.

    Parameters
    ----------
    surfaces : (n, G) reflectance products on the range's grid of 1 nm; a neutral one is always
        added
    span : range that the bands cover
    """
    edges = band_edges_nm(span)
    lights = [resolved(lamp, surfaces, span) for lamp in lamps]
    while True:
        bands = _shaped(edges, lamps)
        errors = [band_errors(bands, light, detectors) for light in lights]
        worst = max((float(np.abs(error.sum(axis=2)).max()) for error in errors), default=0.0)
        if worst <= tolerance or edges.size > MAX_BANDS:
            return bands
        band_error = np.max([np.abs(error).max(axis=(0, 1)) for error in errors], axis=0)
        band_error[np.diff(edges) < 2 * NARROWEST_BAND_NM] = 0.0
        if not band_error.any():
            return bands
        halved = np.flatnonzero(band_error > band_error.max() / 2)
        edges = np.sort(np.concatenate([edges, (edges[halved] + edges[halved + 1]) / 2]))


def band_errors(bands: Bands, lamp: tuple[Array, Array, Array], detectors: list[Detector]) -> Array:
    """Return each band's contribution to the error of each detector's signal, (detectors, 1 + n
    surfaces, B).

    It is relative to the whole signal and to the detector's slack. `lamp` is `resolved`.
    """
    light, at, families = lamp
    first = np.searchsorted(at, bands.edges_nm[:-1])
    energy = np.add.reduceat(families * light, first, axis=1)
    errors = []
    for detector in detectors:
        truth = np.add.reduceat(families * (light * detector.response(at)), first, axis=1)
        total = truth.sum(axis=1, keepdims=True)
        total = np.maximum(total, detector.min_share_of_neutral * total[:1])
        wrong = bands.mean(detector.response) * energy - truth
        errors.append(
            np.divide(
                wrong, total * detector.tolerance_factor, out=np.zeros_like(wrong), where=total > 0
            )
        )
    return np.array(errors)


def resolved(lamp: Spectrum, surfaces: Array, span: Span = VISIBLE) -> tuple[Array, Array, Array]:
    """Return a lamp's energy in fine cells, the cell centres, and the surfaces (a neutral one
    first) at the centres.
    """
    step, whole = min(lamp.step_nm, STEPS_NM[1]), grid_nm(span=span)
    edges = grid_nm(step, span)
    at = edges[:-1] + step / 2
    families = np.array(
        [np.interp(at, whole, surface) for surface in (np.ones(whole.size), *surfaces)]
    )
    return lamp.cell_means(edges) * step, at, families


def _shaped(edges_nm: Array, lamps: list[Spectrum]) -> Bands:
    """Return bands with the light of all lamps, at equal energy each, in ten parts at their
    centroids.
    """
    parts_nm = np.concatenate(
        [np.linspace(a, b, PARTS_OF_A_BAND, endpoint=False) for a, b in pairwise(edges_nm)]
    )
    parts = Bands(np.append(parts_nm, edges_nm[-1]), parts_nm, parts_nm[:, None], parts_nm[:, None])
    centres = (parts.edges_nm[:-1] + parts.edges_nm[1:]) / 2
    energy, moment, span = np.zeros(centres.size), np.zeros(centres.size), parts.span
    for lamp in lamps:
        step, total = min(lamp.step_nm, STEPS_NM[1]), lamp.integral(span.low_nm, span.high_nm)
        grid = grid_nm(step, span)
        cells = lamp.cell_means(grid) * (step / (total if total > 0 else 1.0))
        energy += parts.integrals(cells, step)
        moment += parts.integrals(cells * (grid[:-1] + step / 2), step)
    nodes = np.divide(moment, energy, out=centres.copy(), where=energy > 0)
    nodes = np.clip(nodes, parts.edges_nm[:-1], parts.edges_nm[1:]).reshape(-1, PARTS_OF_A_BAND)
    energy = energy.reshape(nodes.shape)
    dark = energy.sum(axis=1) <= 0
    energy[dark] = 1.0
    shares = energy / energy.sum(axis=1, keepdims=True)
    centre = (edges_nm[:-1] + edges_nm[1:]) / 2
    centroid = (shares * nodes).sum(axis=1)
    near = np.abs(centroid - centre) < _MIN_SHIFT_NM
    return Bands(edges_nm, np.where(near, centre, centroid), nodes, shares)


def window_pulse(
    lamp: Spectrum | None,
    low_nm: float,
    high_nm: float,
    *,
    inside: bool = False,
    band: bool = False,
    span: Span = VISIBLE,
) -> Pulse | None:
    """Return the lamp between two wavelengths as a pulse, or None if it is dark there; without a
    lamp the pulse is flat.

    The flanks lie outside the window, or `inside` it if the next window adjoins in the same pass.
    The pulses of adjoining windows with `band` add up to the lamp.
    """
    step = lamp.step_nm if lamp else 1.0
    if band:  # fine enough for every border of a band to be a node
        step = min(step, STEPS_NM[1])
    first, last, last_node = (
        round((nm - span.low_nm) / step) for nm in (low_nm, high_nm, span.high_nm)
    )
    flank = 0 if inside else _FLANK_STEPS
    start = max(min(first - flank, last_node - 2 * _FLANK_STEPS), 0)
    stop = min(max(last + flank, 2 * _FLANK_STEPS), last_node)
    index = np.arange(start, stop + 1)
    values = lamp.on_grid(step, span)[index] if lamp else np.ones(index.size)
    values[(index < first) | (index > last)] = 0.0
    if band:  # half at its borders: neighbours add up to the lamp, and the area is that of the band
        values[(index == first) | (index == last)] /= 2
    if (
        not inside
    ):  # flanks must stay within the range: light at the ends is moved two steps inwards
        values = np.bincount(
            np.clip(index - start, _FLANK_STEPS, stop - start - _FLANK_STEPS), values, index.size
        ).astype(float)
    values[:_FLANK_STEPS] = values[-_FLANK_STEPS:] = 0.0
    area = values.sum() * step
    return (
        Pulse(span.low_nm + step * start, span.low_nm + step * stop, values / area)
        if area > 0
        else None
    )


def every_band(lamp: Spectrum | None, bands: Bands) -> Fit:
    """Return a pulse for each band with light, in passes of four disjoint ones; needs no knowledge
    of the surfaces.
    """
    edges = bands.edges_nm
    # Without a lamp spectrum the pulses are flat and have unit area: they measure the mean over a
    # band.
    mean = lamp.cell_means(edges) if lamp else np.ones(edges.size - 1)
    options: dict[str, Any] = {"band": True, "span": bands.span}
    band_pulse = {
        band: window_pulse(lamp, edges[band], edges[band + 1], **options)
        for band in np.flatnonzero(mean).tolist()
    }
    bright_bands, pulses = (
        [band for band, pulse in band_pulse.items() if pulse],
        tuple(pulse for pulse in band_pulse.values() if pulse),
    )
    fours = passes(len(pulses))
    # Flanks may overlap neighbours: then each pulse has its own pass.
    spans = [
        sorted({(pulses[index].low_nm, pulses[index].high_nm) for index in group})
        for group in fours
    ]
    are_disjoint = (
        all(low[1] <= high[0] for span in spans for low, high in pairwise(span))
        and len(pulses) >= 2 * _PULSES_PER_PASS
    )
    return Fit(
        pulses,
        np.diag(mean)[bright_bands],
        fours if are_disjoint else [[index] for index in range(len(pulses))],
    )


def passes(count: int) -> list[list[int]]:
    """Group pulses into passes of four (or two, or one) that span the spectrum, so that paths
    sample most of the signal.

    An incomplete group repeats one of its pulses, so that the film response still has four equal
    parts.
    """
    if count <= 3:
        return [[], [[0]], [[0, 1]], [[0, 1], [2]]][count]
    stride = -(-count // _PULSES_PER_PASS)
    fours = [[start + stride * k for k in range(_PULSES_PER_PASS)] for start in range(stride)]
    return [[index if index < count else group[0] for index in group] for group in fours]


def fit(
    lamp: Spectrum,
    bands: Bands,
    surfaces: Array,
    detectors: list[Detector],
    tolerance: float,
    stiffness: float = STIFFNESS,
) -> Fit | None:
    """Return the fewest pulses that determine all bands of a lamp's light from any surface to
    within `tolerance`.

    `surfaces` as in `place_bands`, `stiffness` as `STIFFNESS`. Returns None if 32 pulses are too
    few, or if the lamp is dark. The error bounds light from these surfaces and sums of it; light
    from other surfaces may have a larger error.
    """
    step, span = lamp.step_nm, bands.span
    whole, grid, light = grid_nm(span=span), grid_nm(step, span), lamp.on_grid(step, span)
    bright_nm = grid[light > 0]
    if bright_nm.size == 0:
        return None
    families = np.array(
        [np.interp(grid, whole, surface) for surface in (np.ones(whole.size), *surfaces)]
    )
    fine_light, at, fine = resolved(lamp, surfaces, span)
    truth = np.array(
        [(fine * (fine_light * detector.response(at))).sum(axis=1) for detector in detectors]
    )
    first = np.searchsorted(at, bands.edges_nm[:-1])
    band_means = np.add.reduceat(fine * fine_light, first, axis=1) / bands.width_nm
    signals = np.array([bands.mean(detector.response) * bands.width_nm for detector in detectors])
    tolerance_factor = np.array([[detector.tolerance_factor] for detector in detectors])
    reference = np.maximum(
        truth, np.array([[detector.min_share_of_neutral] for detector in detectors]) * truth[:, :1]
    )
    for count in _PULSE_COUNTS:
        cuts = np.linspace(bright_nm[0], bright_nm[-1], count + 1)
        pulses = [window_pulse(lamp, a, b, inside=count > 1, span=span) for a, b in pairwise(cuts)]
        pulses_lit = [pulse for pulse in pulses if pulse is not None]
        if not pulses_lit:  # the windows are narrower than their flanks
            return None
        weights = _fit_weights(families, pulses_lit, light, step, stiffness, span)
        description_of = np.array([np.interp(at, grid, weight) for weight in weights])
        spectra = np.add.reduceat(description_of * fine_light, first, axis=1) / bands.width_nm
        measured = np.stack([pulse.mean(families, step, span) for pulse in pulses_lit], axis=1)
        fitted = measured @ spectra
        wrong = np.abs(signals @ fitted.T - truth)
        errors = np.divide(
            wrong, reference * tolerance_factor, out=np.zeros_like(wrong), where=reference > 0
        )
        shape = np.abs(fitted - band_means).max(axis=1) / np.maximum(
            band_means.max(axis=1), np.finfo(float).tiny
        )
        if errors.max() <= tolerance and shape.max() <= SHAPE_TOLERANCE:
            return Fit(tuple(pulses_lit), spectra, passes(len(pulses_lit)), float(errors.max()))
    return None


def _fit_weights(
    families: Array, pulses: list[Pulse], light: Array, step_nm: float, stiffness: float, span: Span
) -> Array:
    """Return functions (pulses, G) whose sum, weighted by pulse means, fits the families; near
    linear interpolation.
    """
    grid = grid_nm(step_nm, span)
    power = np.maximum(np.trapezoid(families * light, dx=step_nm, axis=-1), np.finfo(float).tiny)
    scaled = families * (np.trapezoid(light, dx=step_nm) / power)[:, None]
    scaled[0] *= NEUTRAL_WEIGHT
    measured = np.stack([pulse.mean(scaled, step_nm, span) for pulse in pulses], axis=1)
    centroids = [
        float((pulse.nodes_nm * pulse.values).sum() / pulse.values.sum()) for pulse in pulses
    ]
    plain = np.array([np.interp(grid, centroids, row) for row in np.eye(len(pulses))])
    normal_matrix = measured.T @ measured / len(scaled) + stiffness * np.eye(len(pulses))
    return np.asarray(
        np.linalg.solve(normal_matrix, measured.T @ scaled / len(scaled) + stiffness * plain)
    )
