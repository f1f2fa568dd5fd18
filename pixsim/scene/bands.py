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
        """Return the energy in each band, (..., B).

        energy : (..., cells) between the nodes of the grid of the bands' range
        step_nm : of that grid
        """
        nothing = np.zeros_like(energy[..., :1])
        running = np.concatenate([nothing, np.cumsum(energy, axis=-1)], axis=-1)

        # The running sum is linear within a cell.
        position = (self.edges_nm - self.span.low_nm) / step_nm
        cell = np.minimum(position.astype(int), energy.shape[-1] - 1)
        below = running[..., cell] + (position - cell) * energy[..., cell]
        return np.diff(below, axis=-1)


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
        # Integrals of products of two tents: 1/6, 2/3 and 1/6 of a step.
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
    edges_nm = band_edges_nm(span)
    lights = [resolved(lamp, surfaces, span) for lamp in lamps]
    while True:
        bands = _weighted_bands(edges_nm, lamps)
        errors = [band_errors(bands, light, detectors) for light in lights]
        largest = max((float(np.abs(error.sum(axis=2)).max()) for error in errors), default=0.0)
        if largest <= tolerance or edges_nm.size > MAX_BANDS:
            return bands

        # The worst bands are halved, but for those that are as narrow as allowed.
        band_error = np.max([np.abs(error).max(axis=(0, 1)) for error in errors], axis=0)
        band_error[np.diff(edges_nm) < 2 * NARROWEST_BAND_NM] = 0.0
        if not band_error.any():
            return bands
        worst = np.flatnonzero(band_error > band_error.max() / 2)
        middles_nm = (edges_nm[worst] + edges_nm[worst + 1]) / 2
        edges_nm = np.sort(np.concatenate([edges_nm, middles_nm]))


def band_errors(bands: Bands, lamp: tuple[Array, Array, Array], detectors: list[Detector]) -> Array:
    """Return each band's contribution to the error of each detector's signal, (detectors, 1 + n
    surfaces, B).

    It is relative to the whole signal and to the detector's tolerance factor.

    lamp : from `resolved`
    """
    light, centres_nm, reflectances = lamp
    first = np.searchsorted(centres_nm, bands.edges_nm[:-1])
    energy = np.add.reduceat(reflectances * light, first, axis=1)

    errors = []
    for detector in detectors:
        response = light * detector.response(centres_nm)
        signal = np.add.reduceat(reflectances * response, first, axis=1)
        total = signal.sum(axis=1, keepdims=True)
        total = np.maximum(total, detector.min_share_of_neutral * total[:1])
        error = bands.mean(detector.response) * energy - signal
        allowed = total * detector.tolerance_factor
        errors.append(np.divide(error, allowed, out=np.zeros_like(error), where=total > 0))
    return np.array(errors)


def resolved(lamp: Spectrum, surfaces: Array, span: Span = VISIBLE) -> tuple[Array, Array, Array]:
    """Return a lamp's energy in fine cells, the cell centres, and the surfaces (a neutral one
    first) at the centres.

    surfaces : (n, G) on the range's grid of 1 nm
    """
    step_nm = min(lamp.step_nm, STEPS_NM[1])
    edges_nm = grid_nm(step_nm, span)
    centres_nm = edges_nm[:-1] + step_nm / 2
    reflectances = _with_neutral(surfaces, centres_nm, span)
    return lamp.cell_means(edges_nm) * step_nm, centres_nm, reflectances


def _with_neutral(surfaces: Array, nm: Array, span: Span) -> Array:
    """Return a neutral surface and surfaces (n, G), at other wavelengths, (1 + n, wavelengths)."""
    surfaces_nm = grid_nm(span=span)
    neutral = np.ones(surfaces_nm.size)
    return np.array([np.interp(nm, surfaces_nm, surface) for surface in (neutral, *surfaces)])


def _weighted_bands(edges_nm: Array, lamps: list[Spectrum]) -> Bands:
    """Return bands with the light of all lamps, at equal energy each, in ten parts at their
    centroids.
    """
    parts_nm = np.concatenate(
        [np.linspace(a, b, PARTS_OF_A_BAND, endpoint=False) for a, b in pairwise(edges_nm)]
    )
    parts = Bands(np.append(parts_nm, edges_nm[-1]), parts_nm, parts_nm[:, None], parts_nm[:, None])
    centres_nm = (parts.edges_nm[:-1] + parts.edges_nm[1:]) / 2

    # Energy and first moment in each part
    energy = np.zeros(centres_nm.size)
    moment = np.zeros(centres_nm.size)
    span = parts.span
    for lamp in lamps:
        step_nm = min(lamp.step_nm, STEPS_NM[1])
        total = lamp.integral(span.low_nm, span.high_nm)
        nodes_nm = grid_nm(step_nm, span)
        cells = lamp.cell_means(nodes_nm) * (step_nm / (total if total > 0 else 1.0))
        energy += parts.integrals(cells, step_nm)
        moment += parts.integrals(cells * (nodes_nm[:-1] + step_nm / 2), step_nm)

    # Centroids of the parts; of a dark part the centre.
    centroids_nm = np.divide(moment, energy, out=centres_nm.copy(), where=energy > 0)
    centroids_nm = np.clip(centroids_nm, parts.edges_nm[:-1], parts.edges_nm[1:])
    centroids_nm = centroids_nm.reshape(-1, PARTS_OF_A_BAND)

    # Shares of the parts; in a dark band they are equal.
    energy = energy.reshape(centroids_nm.shape)
    energy[energy.sum(axis=1) <= 0] = 1.0
    shares = energy / energy.sum(axis=1, keepdims=True)

    band_centre_nm = (edges_nm[:-1] + edges_nm[1:]) / 2
    band_centroid_nm = (shares * centroids_nm).sum(axis=1)
    is_near = np.abs(band_centroid_nm - band_centre_nm) < _MIN_SHIFT_NM
    wavelength_nm = np.where(is_near, band_centre_nm, band_centroid_nm)
    return Bands(edges_nm, wavelength_nm, centroids_nm, shares)


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

    inside : whether the flanks lie inside the window, since the next one adjoins in the same pass;
        else they lie outside
    band : whether the pulses of adjoining windows add up to the lamp
    """
    step_nm = lamp.step_nm if lamp else 1.0
    if band:  # fine enough for every border of a band to be a node
        step_nm = min(step_nm, STEPS_NM[1])
    first, last, last_node = (
        round((nm - span.low_nm) / step_nm) for nm in (low_nm, high_nm, span.high_nm)
    )
    flank = 0 if inside else _FLANK_STEPS
    start = max(min(first - flank, last_node - 2 * _FLANK_STEPS), 0)
    stop = min(max(last + flank, 2 * _FLANK_STEPS), last_node)
    nodes = np.arange(start, stop + 1)

    values = lamp.on_grid(step_nm, span)[nodes] if lamp else np.ones(nodes.size)
    values[(nodes < first) | (nodes > last)] = 0.0
    if band:
        # Half at its borders: neighbours add up to the lamp, and the area is that of the band.
        values[(nodes == first) | (nodes == last)] /= 2
    if not inside:
        # Flanks must stay within the range: light at the ends is moved two steps inwards.
        inner = np.clip(nodes - start, _FLANK_STEPS, stop - start - _FLANK_STEPS)
        values = np.bincount(inner, values, nodes.size).astype(float)
    values[:_FLANK_STEPS] = values[-_FLANK_STEPS:] = 0.0

    area = values.sum() * step_nm
    if not area > 0:
        return None
    return Pulse(span.low_nm + step_nm * start, span.low_nm + step_nm * stop, values / area)


def every_band(lamp: Spectrum | None, bands: Bands) -> Fit:
    """Return a pulse for each band with light, in passes of four disjoint ones; needs no knowledge
    of the surfaces.
    """
    edges_nm = bands.edges_nm
    # Without a lamp spectrum the pulses are flat and have unit area: they measure the mean over a
    # band.
    mean = lamp.cell_means(edges_nm) if lamp else np.ones(edges_nm.size - 1)
    pulses = []
    bright_bands = []
    for band in np.flatnonzero(mean).tolist():
        pulse = window_pulse(lamp, edges_nm[band], edges_nm[band + 1], band=True, span=bands.span)
        if pulse:
            pulses.append(pulse)
            bright_bands.append(band)

    # Flanks may overlap neighbours: then each pulse has a pass of its own.
    groups = passes(len(pulses))
    if len(pulses) < 2 * _PULSES_PER_PASS or any(_overlap(pulses, group) for group in groups):
        groups = [[index] for index in range(len(pulses))]
    return Fit(tuple(pulses), np.diag(mean)[bright_bands], groups)


def _overlap(pulses: list[Pulse], group: list[int]) -> bool:
    """Return whether different pulses of a pass overlap."""
    ranges = sorted({(pulses[index].low_nm, pulses[index].high_nm) for index in group})
    return any(lower[1] > upper[0] for lower, upper in pairwise(ranges))


def passes(count: int) -> list[list[int]]:
    """Group pulses into passes of four (or two, or one) that span the spectrum, so that paths
    sample most of the signal.

    An incomplete group repeats one of its pulses, so that the film response still has four equal
    parts.
    """
    if count <= 3:
        return [[], [[0]], [[0, 1]], [[0, 1], [2]]][count]

    stride = -(-count // _PULSES_PER_PASS)
    groups = []
    for start in range(stride):
        group = [start + stride * lane for lane in range(_PULSES_PER_PASS)]
        groups.append([index if index < count else start for index in group])
    return groups


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
    step_nm = lamp.step_nm
    span = bands.span
    nodes_nm = grid_nm(step_nm, span)
    light = lamp.on_grid(step_nm, span)
    bright_nm = nodes_nm[light > 0]
    if bright_nm.size == 0:
        return None
    reflectances = _with_neutral(surfaces, nodes_nm, span)

    # The light from each surface in the bands, and the signal of each detector
    fine_light, centres_nm, fine_reflectances = resolved(lamp, surfaces, span)
    fine_energy = fine_reflectances * fine_light
    first = np.searchsorted(centres_nm, bands.edges_nm[:-1])
    band_means = np.add.reduceat(fine_energy, first, axis=1) / bands.width_nm
    brightest = np.maximum(band_means.max(axis=1), np.finfo(float).tiny)
    signals = np.array(
        [
            (fine_reflectances * (fine_light * detector.response(centres_nm))).sum(axis=1)
            for detector in detectors
        ]
    )
    min_shares = np.array([[detector.min_share_of_neutral] for detector in detectors])
    reference = np.maximum(signals, min_shares * signals[:, :1])
    allowed = reference * np.array([[detector.tolerance_factor] for detector in detectors])
    responses = np.array([bands.mean(detector.response) * bands.width_nm for detector in detectors])

    for count in _PULSE_COUNTS:
        borders_nm = np.linspace(bright_nm[0], bright_nm[-1], count + 1)
        windows = [
            window_pulse(lamp, low_nm, high_nm, inside=count > 1, span=span)
            for low_nm, high_nm in pairwise(borders_nm)
        ]
        pulses = [pulse for pulse in windows if pulse is not None]
        if not pulses:  # the windows are narrower than their flanks
            return None

        # The light in the bands that the pulses tell
        weights = _fit_weights(reflectances, pulses, light, step_nm, stiffness, span)
        fine_weights = np.array([np.interp(centres_nm, nodes_nm, weight) for weight in weights])
        spectra = np.add.reduceat(fine_weights * fine_light, first, axis=1) / bands.width_nm
        measured = np.stack([pulse.mean(reflectances, step_nm, span) for pulse in pulses], axis=1)
        fitted = measured @ spectra

        # Its errors in the signals, and in each band
        error = np.abs(responses @ fitted.T - signals)
        signal_error = np.divide(error, allowed, out=np.zeros_like(error), where=reference > 0)
        shape_error = np.abs(fitted - band_means).max(axis=1) / brightest
        if signal_error.max() <= tolerance and shape_error.max() <= SHAPE_TOLERANCE:
            return Fit(tuple(pulses), spectra, passes(len(pulses)), float(signal_error.max()))
    return None


def _fit_weights(
    reflectances: Array,
    pulses: list[Pulse],
    light: Array,
    step_nm: float,
    stiffness: float,
    span: Span,
) -> Array:
    """Return functions (pulses, G) whose sum, weighted by pulse means, fits the reflectances; near
    linear interpolation.

    reflectances : (1 + n, G) of a neutral surface and others
    light : (G,) of the lamp
    """
    nodes_nm = grid_nm(step_nm, span)

    # Surfaces count the same, whatever they reflect of the lamp, but for the neutral one.
    power = np.trapezoid(reflectances * light, dx=step_nm, axis=-1)
    power = np.maximum(power, np.finfo(float).tiny)
    scaled = reflectances * (np.trapezoid(light, dx=step_nm) / power)[:, None]
    scaled[0] *= NEUTRAL_WEIGHT

    # Linear interpolation between the centroids of the pulses
    centroids_nm = [
        float((pulse.nodes_nm * pulse.values).sum() / pulse.values.sum()) for pulse in pulses
    ]
    linear = np.array([np.interp(nodes_nm, centroids_nm, row) for row in np.eye(len(pulses))])

    # Least squares with a penalty for the difference from it
    measured = np.stack([pulse.mean(scaled, step_nm, span) for pulse in pulses], axis=1)
    normal_matrix = measured.T @ measured / len(scaled) + stiffness * np.eye(len(pulses))
    right_side = measured.T @ scaled / len(scaled) + stiffness * linear
    return np.asarray(np.linalg.solve(normal_matrix, right_side))
