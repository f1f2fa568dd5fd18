"""Spectra, bands and pulses: lines are conserved, wavelengths are not random, and reported errors
are the real ones.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers.edits import FOLDER, VARIANTS

from pixsim.light.spectral import (
    STEPS_NM,
    VISIBLE,
    Spectrum,
    grid_nm,
    photons_per_joule,
    photopic_efficiency,
    tabulated,
)
from pixsim.scene import bands as spectral_bands
from pixsim.scene.bands import (
    SHAPE_TOLERANCE,
    Bands,
    Detector,
    Pulse,
    band_edges_nm,
    every_band,
    fit,
    passes,
    place_bands,
)
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.renderer import film, film_response
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

SPECTRA = FOLDER / "spectra"
FINE_STEP_NM = (
    0.01  # each table here is linear over cells of this width, or nearly: 1e-6 of any integral
)
FINE_NM = np.arange(360 + FINE_STEP_NM / 2, 830, FINE_STEP_NM)
NONE = np.zeros((0, 471))
TOLERANCE = 2.5e-4  # what the bands may cost in a render: BANDS_SHARE of the default tolerance


def spectrum(nodes: Any, values: Any) -> Spectrum:
    return Spectrum(np.asarray(nodes, float), np.asarray(values, float))


def shipped(name: str) -> Spectrum:
    return spectrum(*np.loadtxt(SPECTRA / f"{name}.spd").T)


def line(centre_nm: float, width_nm: float = 1.0) -> Spectrum:
    """Return a triangle of unit area with a full width at half maximum of `width_nm`."""
    return spectrum([centre_nm - width_nm, centre_nm, centre_nm + width_nm], [0, 1 / width_nm, 0])


def macbeth() -> np.ndarray:
    files = sorted((SPECTRA / "macbeth").glob("*.spd"))
    assert len(files) == 24
    return np.array([np.interp(grid_nm(), *np.loadtxt(file).T) for file in files])


def electrons(technology: str) -> spectral_bands.Response:
    physics = derive(Pixel(technology=technology, pitch_um=10.0))
    return lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)


RESPONSES = {
    "0.35um": electrons("0.35um"),
    "4t-bsi": electrons("4t-bsi"),
    "eye": photopic_efficiency,
    "ramp": lambda nm: 0.2 + (nm - 360) / 470,
    "red": lambda nm: 0.05 + 1 / (1 + np.exp((600 - nm) / 5)),
}
DETECTORS = [Detector(response) for response in RESPONSES.values()]
# The response of every one of these is above zero at all wavelengths, so that no line is invisible.
SEEING = {
    "ramp": RESPONSES["ramp"],
    "blue": lambda nm: 1.1 - (nm - 360) / 470,
    "green": lambda nm: 0.1 + np.exp(-(((nm - 550) / 60) ** 2)),
}


def fine(lamp: Spectrum) -> np.ndarray:
    return np.interp(FINE_NM, lamp.nodes_nm, lamp.values, left=0, right=0)


def exact_integral(lamp: Spectrum, low: float, high: float) -> float:
    """Return the integral as a sum over linear pieces."""
    inside = lamp.nodes_nm[(lamp.nodes_nm > low) & (lamp.nodes_nm < high)]
    cuts = np.concatenate([[low], inside, [high]])
    middle = (cuts[1:] + cuts[:-1]) / 2
    return float(
        (np.interp(middle, lamp.nodes_nm, lamp.values, left=0, right=0) * np.diff(cuts)).sum()
    )


# --- Tables ---

RNG = np.random.default_rng(1)
TABLES = {
    "ragged": spectrum(np.sort(RNG.uniform(340, 850, 60)), RNG.uniform(0, 3, 60)),  # ends outside
    "steps at its ends": spectrum([400.3, 500.7], [2, 5]),
    "a step inside": spectrum([400, 500, 500, 600.5], [1, 1, 3, 0]),
    "a line within a cell": line(555.03, 0.004),
    "a line on a border": line(450.0, 0.3),
    "two nodes": spectrum([360, 830], [0, 470]),
    "elsewhere": spectrum([900, 1000], [1, 1]),
}


@pytest.mark.parametrize("name", TABLES)
def test_cell_means_are_exact(name):
    lamp, rng = TABLES[name], np.random.default_rng(3)
    for edges in (
        np.arange(360.0, 831.0),
        np.sort(rng.uniform(355, 835, 40)),
        np.array([360.0, 830.0]),
    ):
        expected = [exact_integral(lamp, low, high) / (high - low) for low, high in pairwise(edges)]
        # The running sum is rounded at its own size: 1e-13 of the largest mean.
        np.testing.assert_allclose(
            lamp.cell_means(edges), expected, rtol=1e-9, atol=1e-12 * lamp.values.max()
        )
    # Nodes at 555 nm are rounded to 1e-13 nm: 3e-11 of a line 4 pm wide.
    assert lamp.integral() == pytest.approx(exact_integral(lamp, 360, 830), rel=1e-10, abs=1e-15)
    assert lamp.integral(480.5, 555.03) == pytest.approx(
        exact_integral(lamp, 480.5, 555.03), rel=1e-9, abs=1e-12
    )


def test_integral_matches_hand_calculation():
    assert TABLES["two nodes"].integral() == 470**2 / 2
    assert TABLES["steps at its ends"].integral() == pytest.approx(100.4 * 3.5, rel=1e-13)
    assert TABLES["a step inside"].integral() == pytest.approx(100 + 150.75, rel=1e-13)
    assert TABLES["a line within a cell"].integral() == pytest.approx(1, rel=1e-10)
    assert TABLES["elsewhere"].integral() == 0
    assert (TABLES["two nodes"] * 2.5).integral() == 2.5 * 470**2 / 2
    np.testing.assert_array_equal(
        TABLES["steps at its ends"].at(np.array([400.2, 400.3, 450.5, 500.7, 500.8])),
        [0, 2, 3.5, 5, 0],
    )


@pytest.mark.parametrize("step_nm", STEPS_NM)
@pytest.mark.parametrize("name", TABLES)
def test_on_grid_trapezoids_equal_integral(name, step_nm):
    values = TABLES[name].on_grid(step_nm)
    assert values.size == round(470 / step_nm) + 1
    assert np.trapezoid(values, dx=step_nm) == pytest.approx(
        TABLES[name].integral(), rel=1e-10, abs=1e-12
    )


RESOLVING = {
    1.0: ([380, 385, 390], [531, 532, 533], [400, 500, 500, 600]),  # the last is a step
    1 / 8: ([631.8, 632.8, 633.8], [400, 400.2, 401]),
    1 / 32: ([400, 400.19, 401], [532.0, 532.01, 532.02], [400, 450.5, 450.5, 600]),
}


@pytest.mark.parametrize("step_nm", RESOLVING)
def test_step_nm_is_coarsest_that_resolves_table(step_nm):
    assert [spectrum(nodes, np.ones(len(nodes))).step_nm for nodes in RESOLVING[step_nm]] == [
        step_nm
    ] * len(RESOLVING[step_nm])
    # In binary, so that Mitsuba's float32 has the same nodes.
    assert np.array_equal(grid_nm(step_nm).astype(np.float32), grid_nm(step_nm))


# --- Bands ---

SMOOTH = {
    "d65": shipped("d65"),
    "a": shipped("a"),
    "flat": tabulated(np.ones(471)),
    "ramp": TABLES["two nodes"],
}


@pytest.mark.parametrize("name", SMOOTH)
def test_place_bands_smooth_lamp_is_uniform(name):
    result = place_bands([SMOOTH[name]], NONE, DETECTORS, TOLERANCE)
    np.testing.assert_array_equal(result.edges_nm, [360, *range(365, 826, 10), 830])
    np.testing.assert_array_equal(result.wavelength_nm, [362.5, *range(370, 821, 10), 827.5])
    np.testing.assert_array_equal(result.width_nm, [5, *[10] * 46, 5])


@pytest.mark.parametrize("seed", range(3))
def test_place_bands_shares_follow_light(seed):
    rng = np.random.default_rng(seed)
    lamp = spectrum(np.arange(360, 831), rng.uniform(0, 1, 471) ** 8)
    result = place_bands([lamp], NONE, DETECTORS, TOLERANCE)
    np.testing.assert_allclose(result.shares.sum(axis=1), 1, rtol=1e-13)
    assert np.all(
        (result.nodes_nm >= result.edges_nm[:-1, None])
        & (result.nodes_nm <= result.edges_nm[1:, None])
    )
    # Ten parts at their own centroids hold the first moment of the light exactly: so linear
    # responses are exact.
    light, first = fine(lamp), np.searchsorted(FINE_NM, result.edges_nm[:-1])
    centroid = np.add.reduceat(light * FINE_NM, first) / np.add.reduceat(light, first)
    # Lamps are taken in 1/8 nm cells: 1/8 nm squared over 12 is the error of the second moment,
    # less of the first.
    np.testing.assert_allclose(result.mean(lambda nm: nm), centroid, rtol=0, atol=0.01)
    near = np.abs(centroid - (result.edges_nm[:-1] + result.edges_nm[1:]) / 2) < 1
    assert 0 < near.sum() < near.size  # both cases occur
    np.testing.assert_allclose(result.wavelength_nm[~near], centroid[~near], rtol=0, atol=0.01)
    assert np.abs(result.wavelength_nm - centroid).max() < 1.01


def test_bands_integrals_match_direct_sums():
    edges = np.array([360, 361.25, 362.5, 500, 829.375, 830])
    result = Bands(edges, edges[:-1], edges[:-1, None], edges[:-1, None])
    cells = np.diff((grid_nm() - 360) ** 2)  # of 2(λ - 360)
    energy = result.integrals(np.stack([cells, 0 * cells + 1]), 1.0)
    np.testing.assert_allclose(energy[1], np.diff(edges), rtol=1e-12)
    # Within a cell of 1 nm energy is taken as even: 0.25 · 0.75 at a fraction of 0.25, for this
    # slope.
    even = np.interp(edges - 360, grid_nm() - 360, (grid_nm() - 360) ** 2)
    np.testing.assert_allclose(energy[0], np.diff(even), rtol=1e-12)
    assert energy[0].sum() == pytest.approx(470**2, rel=1e-13)


LINES_NM = [
    360.0,
    360.5,
    361.0,
    362.0,
    364.5,
    365.0,
    365.125,
    370.0,
    374.99,
    375.0,
    532.0,
    546.07,
    632.8,
    655.0,
    824.9,
    825.0,
]
LINES_NM += [
    828.0,
    829.0,
    829.5,
    830.0,
    *np.random.default_rng(4).uniform(360, 830, 40).round(2).tolist(),
]


def band_energies(lamp: Spectrum, bands: Bands) -> tuple[np.ndarray, float, float]:
    """Return the energy of each band, the total, and the mean wavelength of the pulses."""
    every = every_band(lamp, bands)
    energy = every.spectra * bands.width_nm
    at = [
        float((pulse.nodes_nm * pulse.values).sum() / pulse.values.sum()) for pulse in every.pulses
    ]
    return (
        energy.sum(axis=0),
        float(energy.sum()),
        float((energy.sum(axis=1) * at).sum() / energy.sum()),
    )


def assert_seen(
    lamp: Spectrum, bands: Bands, energy: np.ndarray, responses: dict[str, Any] = RESPONSES
) -> None:
    """Check each response's signal to 1e-3. Band centres in place of a line would be 1e-2 off."""
    for response in responses.values():
        truth = (fine(lamp) * response(FINE_NM)).sum() * FINE_STEP_NM
        assert (energy * bands.mean(response)).sum() == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize("width_nm", [1.0, 0.1])
@pytest.mark.parametrize("centre_nm", LINES_NM)
def test_place_bands_lines_are_conserved(centre_nm, width_nm):
    lamp = line(centre_nm, width_nm)
    result = place_bands([lamp], NONE, list(map(Detector, SEEING.values())), TOLERANCE)
    energy, total, at_nm = band_energies(lamp, result)
    # Its nodes are rounded to 1e-13 nm.
    assert total == pytest.approx(exact_integral(lamp, 360, 830), rel=1e-12 / width_nm)
    assert_seen(lamp, result, energy, SEEING)
    light = fine(lamp)
    # Its pulses look where it is, to a quarter of their grid's step; at the ends of what Mitsuba
    # samples flanks of two steps need room.
    reach = 2.25 if min(centre_nm - 360, 830 - centre_nm) < 4 * lamp.step_nm else 0.25
    assert abs(at_nm - (light * FINE_NM).sum() / light.sum()) < reach * lamp.step_nm


@pytest.mark.parametrize("name", ["fl11", "led_b3", "laser_532nm", "d65", "a"])
def test_place_bands_packaged_lamp_energies(name):
    lamp = shipped(name)
    result = place_bands([lamp], NONE, DETECTORS, TOLERANCE)
    energy, total, at_nm = band_energies(lamp, result)
    assert total == pytest.approx(exact_integral(lamp, 360, 830), rel=1e-12)
    assert_seen(lamp, result, energy)
    light = fine(lamp)
    # Pulses are bands with the nodes at both their edges: half a nanometre too much at either side,
    # which nearly cancels.
    assert at_nm == pytest.approx((light * FINE_NM).sum() / light.sum(), abs=0.25)


@pytest.mark.parametrize(
    ("one_nm", "other_nm"),
    [(541, 544), (535, 545), (435.8, 444.0), (601.25, 604.0), (650.03, 654.97)],
)
def test_place_bands_two_line_lamps_are_split(one_nm, other_nm):
    lamps = [line(one_nm), line(other_nm, 0.5)]
    result = place_bands(lamps, NONE, DETECTORS, TOLERANCE)
    assert result.width_nm.min() < 10  # bands of 10 nm do not separate them
    assert np.array_equal(result.edges_nm[[0, -1]], [360, 830])
    assert np.all(result.width_nm >= 1)
    for lamp in lamps:
        energy, total, _ = band_energies(lamp, result)
        assert total == pytest.approx(1, rel=1e-12)
        assert_seen(lamp, result, energy)


def test_place_bands_lamps_have_equal_weight():
    # However bright each is: a dim lamp's lines count as much.
    result = place_bands(
        [line(541), line(544) * 1000.0, spectrum([900, 1000], [1, 1])], NONE, DETECTORS, 10.0
    )
    band = int(np.searchsorted(result.edges_nm, 541)) - 1
    assert result.width_nm[band] == 10
    assert result.wavelength_nm[band] == pytest.approx(542.5, abs=1e-9)
    assert result.mean(lambda nm: (nm - 542.5) ** 2)[band] == pytest.approx(
        1.5**2, abs=0.2
    )  # less what is within 1 nm parts
    assert result.wavelength_nm[band + 1] == 550  # dark: at its centre


def test_place_bands_narrow_at_steep_response():
    edge = 1 / (1 + np.exp((600 - grid_nm()) / 2))
    lamp = SMOOTH["d65"]
    result = place_bands([lamp], edge[None], [Detector(RESPONSES["red"])], TOLERANCE)
    assert np.all(result.width_nm[np.abs(result.wavelength_nm - 480) < 80] == 10)
    assert result.width_nm[np.abs(result.wavelength_nm - 600) < 10].max() < 10
    first = np.searchsorted(FINE_NM, result.edges_nm[:-1])
    light = fine(lamp) * np.interp(FINE_NM, grid_nm(), edge)
    energy = np.add.reduceat(light, first)
    truth = (light * RESPONSES["red"](FINE_NM)).sum()
    assert (energy * result.mean(RESPONSES["red"])).sum() == pytest.approx(
        truth, rel=1.05 * TOLERANCE
    )
    # 10 nm bands would err by more: the halving is needed.
    coarse = place_bands([lamp], edge[None], [Detector(RESPONSES["red"])], 1.0)
    energy = np.add.reduceat(light, np.searchsorted(FINE_NM, coarse.edges_nm[:-1]))
    assert abs((energy * coarse.mean(RESPONSES["red"])).sum() / truth - 1) > 2 * TOLERANCE


def test_place_bands_slack_allows_larger_error():
    edge = 1 / (1 + np.exp((600 - grid_nm()) / 2))
    detectors = [
        Detector(RESPONSES["red"], tolerance_factor) for tolerance_factor in (0.2, 1.0, 5.0, 100.0)
    ]
    counts = [
        place_bands([SMOOTH["d65"]], edge[None], [detector], TOLERANCE).width_nm.size
        for detector in detectors
    ]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1] == 48


# --- A pulse for each band ---


def is_sound(pulse: Pulse) -> bool:
    flanks = np.concatenate([pulse.values[:2], pulse.values[-2:]])
    area = np.trapezoid(pulse.values, pulse.nodes_nm)
    steps = np.diff(pulse.nodes_nm)
    return bool(
        360 <= pulse.low_nm < pulse.high_nm <= 830
        and abs(area - 1) < 1e-12
        and not flanks.any()
        and pulse.values.min() >= 0
        and np.all(steps == steps[0])
        and np.array_equal(np.float32(pulse.nodes_nm), pulse.nodes_nm)
    )


def apart(pulses: list[Pulse]) -> bool:
    """Return whether no two pulses share more than a zero at their ends."""
    spans = sorted({(pulse.low_nm, pulse.high_nm) for pulse in pulses})
    return all(one[1] <= other[0] for one, other in pairwise(spans))


@pytest.mark.parametrize("lit", [*range(1, 27), 33, 46])
def test_every_band_passes_are_disjoint(lit):
    edges = [366, 367, 373 + 10 * (lit - 1), 374 + 10 * (lit - 1)]
    lamp = spectrum(edges, [0, 1, 1, 0])
    result = place_bands([lamp], NONE, DETECTORS, 1.0)
    every = every_band(lamp, result)
    assert len(every.pulses) == lit
    assert all(is_sound(pulse) for pulse in every.pulses)
    # Each pulse stands for a band of its own, which has light.
    assert np.count_nonzero(every.spectra, axis=1).tolist() == [1] * lit
    np.testing.assert_array_equal(np.flatnonzero(every.spectra.any(axis=0)), np.arange(1, 1 + lit))
    np.testing.assert_allclose(
        every.spectra.sum(axis=0), lamp.cell_means(result.edges_nm), rtol=1e-13
    )
    # 1, 2 or 4 channels a pass, the last filled up with one of its own.
    assert {len(group) for group in every.passes} == ({4} if lit >= 8 else {1})
    assert len(every.passes) == (-(-lit // 4) if lit >= 8 else lit)
    assert sorted(index for each in every.passes for index in set(each)) == list(range(lit))
    assert all(apart([every.pulses[index] for index in item]) for item in every.passes)


@pytest.mark.parametrize("count", range(1, 33))
def test_every_band_narrow_bands_are_disjoint(count):
    edges = np.concatenate([[360, 500], 500 + 1.25 * np.arange(1, count + 1), [830]])
    centre = (edges[1:] + edges[:-1]) / 2
    lamp = spectrum([500, 500, edges[-2], edges[-2]], [0, 1, 1, 0])
    every = every_band(lamp, Bands(edges, centre, centre[:, None], np.ones((centre.size, 1))))
    assert len(every.pulses) == count
    assert sorted({index for item in every.passes for index in item}) == list(range(count))
    assert all(apart([every.pulses[index] for index in group]) for group in every.passes)


def test_every_band_dark_bands_are_skipped():
    lamp = spectrum([365, 366, 367], [0, 1, 0])  # touches the border of a band, from above
    every = every_band(lamp, place_bands([lamp], NONE, DETECTORS, TOLERANCE))
    assert (len(every.pulses), every.passes) == (1, [[0]])
    dark = spectrum([900, 1000], [1, 1])
    every = every_band(dark, place_bands([dark], NONE, DETECTORS, TOLERANCE))
    assert (every.pulses, every.passes) == ((), [])


def test_every_band_without_lamp_is_flat():
    result = place_bands([], NONE, DETECTORS, TOLERANCE)
    every = every_band(None, result)
    np.testing.assert_array_equal(every.spectra, np.eye(48))
    assert all(is_sound(pulse) for pulse in every.pulses)
    assert len(every.passes) == 12
    for low, high, pulse in zip(
        *(band_edges_nm(VISIBLE)[part] for part in (slice(-1), slice(1, None))),
        every.pulses,
        strict=True,
    ):
        at = (pulse.nodes_nm * pulse.values).sum() / pulse.values.sum()
        # In the middle of its band; the first and last need room for their flanks.
        assert at == pytest.approx((low + high) / 2, abs=1e-9 if 360 < low < 825 else 0.6)


@pytest.mark.parametrize("lamp", [None, "rising"])
def test_every_band_pulses_add_up_to_lamp(lamp):
    """Each wavelength counts once, at a border in two halves: lines are neither lost nor counted
    twice.
    """
    nm = np.arange(361.0, 829.001, 1 / 8)  # between the folded ends of the range
    light = None if lamp is None else Spectrum(np.array([360.0, 830.0]), np.array([1.0, 5.0]))
    result = place_bands([light] if light else [], NONE, DETECTORS, TOLERANCE)
    every = every_band(light, result)
    mean = np.ones(48) if light is None else light.cell_means(result.edges_nm)
    total = sum(
        np.interp(nm, pulse.nodes_nm, pulse.values, left=0, right=0) * width * level
        for pulse, width, level in zip(every.pulses, result.width_nm, mean, strict=True)
    )
    expected = np.ones(nm.size) if light is None else light.at(nm)
    inside = (nm > 365.5) & (nm < 824.5)
    # The sum of trapezoids and the integral over a band differ in float only; the outermost bands
    # end half a nm early.
    np.testing.assert_allclose(total[inside], expected[inside], rtol=1e-9)


@pytest.mark.parametrize("count", range(1, 33))
def test_passes_span_spectrum(count):
    order = passes(count)
    assert {len(item) for item in order} <= {1, 2, 4}
    assert {index for each in order for index in each} == set(range(count))
    # What is there twice fills an incomplete four, and only there.
    assert sum(map(len, order)) - count == (-count % 4 if count > 3 else 0)
    assert len(order) == (-(-count // 4) if count > 3 else (1, 1, 2)[count - 1])


# --- Few pulses for all bands ---

# Reflectances that turn over within 40 to 110 nm, as those of things do.
SURFACES = np.array(
    [
        0.5 + 0.4 * np.sin(grid_nm() / scale + phase)
        for scale in (40, 70, 110)
        for phase in (0, 2, 4)
    ]
)
FAMILIES = {"waves": SURFACES, "macbeth": macbeth()}
FITS = [
    ("fl11", "waves"),
    ("d65", "waves"),
    *((lamp, "macbeth") for lamp in ("fl11", "led_b3", "d65", "laser_532nm")),
]


def answers(
    fitted: Any,
    placed: Bands,
    response: spectral_bands.Response,
    factors: np.ndarray,
    nm: np.ndarray = FINE_NM,
):
    """Return the signals of light from surfaces (n, fine), computed from pulses."""
    pulses = np.array(
        [np.interp(nm, pulse.nodes_nm, pulse.values, left=0, right=0) for pulse in fitted.pulses]
    )
    return (
        factors
        @ pulses.T
        * (nm[1] - nm[0])
        @ fitted.spectra
        @ (placed.width_nm * placed.mean(response))
    )


def errors_of(fitted: Any, placed: Bands, lamp: Spectrum, factors: np.ndarray) -> np.ndarray:
    """Return relative errors (detectors, n) against integrals in steps of 0.01 nm."""
    result = []
    for detector in DETECTORS:
        truth = factors @ (fine(lamp) * detector.response(FINE_NM)) * FINE_STEP_NM
        result.append(
            (answers(fitted, placed, detector.response, factors) / truth - 1)
            / detector.tolerance_factor
        )
    return np.array(result)


def made(lamp: Spectrum, surfaces: np.ndarray, tolerance: float) -> tuple[Any, Bands]:
    placed = place_bands([lamp], surfaces, DETECTORS, tolerance / 4)
    return fit(lamp, placed, surfaces, DETECTORS, tolerance * 0.8), placed


@pytest.mark.parametrize("name", ["fl11", "led_b3", "laser_532nm", "d65", "a"])
def test_fit_neutral_surface_needs_one_pulse(name):
    lamp = shipped(name)
    result, placed = made(lamp, NONE, 1e-3)
    assert len(result.pulses) == 1
    assert is_sound(result.pulses[0])
    # The lamp itself, and its bands are its means.
    np.testing.assert_allclose(
        result.spectra[0],
        lamp.cell_means(placed.edges_nm),
        rtol=1e-9,
        atol=1e-12 * lamp.values.max(),
    )
    assert result.error < TOLERANCE


@pytest.mark.parametrize(("name", "family"), FITS)
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_fit_error_equals_reported_error(name, family, tolerance):
    lamp, surfaces = shipped(name), FAMILIES[family]
    result, placed = made(lamp, surfaces, tolerance)
    assert all(is_sound(pulse) for pulse in result.pulses)
    assert all(one.high_nm <= other.low_nm for one, other in pairwise(result.pulses))
    factors = np.array([np.interp(FINE_NM, grid_nm(), item) for item in (np.ones(471), *surfaces)])
    worst = np.abs(errors_of(result, placed, lamp, factors)).max()
    assert result.error <= tolerance * 0.8
    # Two-sided: 5 % for a pulse as Mitsuba integrates it, straight between its nodes, and 1e-6 for
    # what 0.01 nm cells do.
    assert worst == pytest.approx(
        result.error, rel=0.05, abs=1e-6 if name != "laser_532nm" else 1e-5
    )


@pytest.mark.parametrize(("name", "family"), FITS)
@pytest.mark.parametrize("seed", [0, 1])
def test_fit_mixtures_are_within_bound(name, family, seed):
    lamp, surfaces = shipped(name), FAMILIES[family]
    result, placed = made(lamp, surfaces, 3e-3)
    rng = np.random.default_rng(seed)
    families = np.array([np.interp(FINE_NM, grid_nm(), item) for item in (np.ones(471), *surfaces)])
    convex = rng.dirichlet(np.full(len(families), 0.3), 30)
    positive = (
        rng.exponential(1, (30, len(families))) * (rng.random((30, len(families))) < 0.2) + 1e-9
    )
    errors = errors_of(result, placed, lamp, np.vstack([convex, positive]) @ families)
    # A positive sum's relative error is no greater than that of its worst part; roundings as above.
    assert np.abs(errors).max() <= 1.05 * result.error + 1e-5


@pytest.mark.parametrize(("name", "family"), FITS)
def test_fit_tighter_tolerance_needs_more_pulses(name, family):
    lamp, surfaces = shipped(name), FAMILIES[family]
    placed = place_bands([lamp], surfaces, DETECTORS, 1e-4)
    fits = [
        fit(lamp, placed, surfaces, DETECTORS, tolerance)
        for tolerance in (0.3, 0.03, 0.01, 3e-3, 1e-3, 3e-4)
    ]
    counts = [len(item.pulses) for item in fits if item]
    assert counts == sorted(counts)
    assert len(counts) > 3
    assert set(counts) == {1} if name == "laser_532nm" else counts[-1] > counts[0]


@pytest.mark.parametrize(("name", "family"), FITS)
def test_fit_bands_are_right_with_negative_weights(name, family):
    lamp, surfaces = shipped(name), FAMILIES[family]
    result, placed = made(lamp, surfaces, 1e-3)
    assert result.spectra.min() < 0 or len(result.pulses) == 1
    factors = np.array([np.interp(FINE_NM, grid_nm(), item) for item in (np.ones(471), *surfaces)])
    pulses = np.array(
        [
            np.interp(FINE_NM, pulse.nodes_nm, pulse.values, left=0, right=0)
            for pulse in result.pulses
        ]
    )
    bands_told = factors @ pulses.T * FINE_STEP_NM @ result.spectra
    first = np.searchsorted(FINE_NM, placed.edges_nm[:-1])
    bands_true = (
        np.add.reduceat(factors * fine(lamp), first, axis=1) * FINE_STEP_NM / placed.width_nm
    )
    wrong = np.abs(bands_told - bands_true).max(axis=1) / bands_true.max(axis=1)
    assert wrong.max() < SHAPE_TOLERANCE * 1.05
    # A neutral surface comes out as the lamp: NEUTRAL_WEIGHT holds it to 1e-4.
    assert wrong[0] < 1e-3


def test_fit_bands_are_within_shape_tolerance():
    # A response that is the same at all wavelengths needs one pulse of the shape of the lamp, which
    # does not determine the bands.
    even, lamp = [Detector(np.ones_like)], shipped("fl11")
    placed = place_bands([lamp], SURFACES, even, 1e-3)
    result = fit(lamp, placed, SURFACES, even, 1e-3)
    assert len(result.pulses) > 1
    assert result.error < 1e-3


@pytest.mark.parametrize("centre_nm", [360.5, 400.0, 532.0, 632.8, 655.0, 829.5])
@pytest.mark.parametrize("tolerance", [1e-2, 2e-3])
def test_fit_laser_needs_one_pulse(centre_nm, tolerance):
    lamp = line(centre_nm, 0.1 if centre_nm % 1 else 1.0)
    surfaces = np.vstack([SURFACES, macbeth()])
    placed = place_bands([lamp], surfaces, [Detector(SEEING["ramp"])], tolerance / 4)
    result = fit(lamp, placed, surfaces, [Detector(SEEING["ramp"])], tolerance)
    assert len(result.pulses) == 1
    # A common part of 0.1 nm and 1/32 nm: tables and pulses are straight within each cell.
    nm = np.arange(360 + 1 / 1280, 830, 1 / 640)
    nm = nm[np.abs(nm - centre_nm) < 5]
    factors = np.array([np.interp(nm, grid_nm(), surface) for surface in surfaces])
    light = np.interp(nm, lamp.nodes_nm, lamp.values, left=0, right=0)
    truth = factors @ (light * SEEING["ramp"](nm)) / 640
    wrong = np.abs(answers(result, placed, SEEING["ramp"], factors, nm) / truth - 1).max()
    assert wrong <= tolerance
    # What is told may be a neutral surface's, which is not among these.
    assert wrong <= 1.05 * result.error + 1e-5


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
def test_fit_packaged_laser_needs_one_pulse(tolerance):
    result, placed = made(shipped("laser_532nm"), macbeth(), tolerance)
    assert len(result.pulses) == 1
    assert (placed.width_nm.min() < 2) == (
        tolerance == 1e-4
    )  # its triangle is then cut within a nanometre


def test_fit_too_few_pulses_returns_none():
    dark = spectrum([360, 830], [0, 0])
    placed = place_bands([dark], SURFACES, DETECTORS, TOLERANCE)
    assert placed.width_nm.size == 48
    assert fit(dark, placed, SURFACES, DETECTORS, 1e-3) is None
    # A filter's edge within a narrow lamp, too narrow for several pulses.
    narrow = spectrum([500, 502, 506, 508], [0, 1, 1, 0])
    edges = np.array([np.where(grid_nm() < 504, 1, 0.01), np.where(grid_nm() < 504, 0.01, 1)])
    placed = place_bands([narrow], edges, DETECTORS, 1e-4)
    assert fit(narrow, placed, edges, DETECTORS, 1e-4) is None
    # Interference fringes every 3 nm.
    fringes = np.array([0.5 + 0.5 * np.sin(2 * grid_nm() + phase) for phase in (0, 1, 2, 3)])
    placed = place_bands([SMOOTH["d65"]], fringes, DETECTORS, TOLERANCE)
    assert fit(SMOOTH["d65"], placed, fringes, DETECTORS, 1e-4) is None


# --- In Mitsuba ---


def furnace(mi: Any, responses: list[dict[str, Any]], spp: int = 16) -> np.ndarray:
    """Render a uniform emitter of radiance 1 that fills the view, (12, 12, channels)."""
    size = (12, 12)
    lamp = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
    sampler = {"type": "multijitter", "sample_count": spp}
    sensor = {
        "type": "perspective",
        "fov": 20,
        "sampler": sampler,
        "film": film(responses, size, 0, size[0]),
    }
    described = {"type": "scene", "lamp": lamp, "sensor": sensor}
    integrator = mi.load_dict({"type": "path", "max_depth": 1, "block_size": 32})
    return np.asarray(
        mi.render(mi.load_dict(described), integrator=integrator, spp=spp, seed=1), float
    )


@pytest.mark.parametrize(
    "name",
    [
        "fl11",
        pytest.param("laser_532nm", marks=pytest.mark.slow),
        "a band and its repeat",
        "fine lines",
    ],
)
@VARIANTS  # the slowest to change: Mitsuba loads itself again
def test_render_pulses_add_no_spectral_noise(name, variant):
    if name == "a band and its repeat":
        lamp = spectrum(
            [366, 367, 443 + 10, 444 + 10], [0, 1, 1, 0]
        )  # nine bands: the last pass has three
        every = every_band(lamp, place_bands([lamp], NONE, DETECTORS, TOLERANCE))
        assert len(set(every.passes[-1])) == 3
        pulses = [every.pulses[index] for index in every.passes[-1]]
    elif name == "fine lines":
        lamps = [line(centre, 0.1) for centre in (435.83, 546.07, 579.07, 632.8)]
        pulses = [
            every_band(lamp, place_bands([lamp], NONE, DETECTORS, TOLERANCE)).pulses[0]
            for lamp in lamps
        ]
    else:
        result, _ = made(shipped(name), macbeth(), 1e-2)
        pulses = [result.pulses[index] for index in passes(len(result.pulses))[-1]]
    with mitsuba_session(variant) as mi:
        seen = furnace(mi, [film_response(pulse) for pulse in pulses])
    assert seen.shape[2] == len(pulses)
    # Every sample has one wavelength in each pulse, at which lamp over pulse is the same: float32
    # and its sums are left.
    assert seen.std(axis=(0, 1)).max() < 1e-5
    # Area 1 of radiance 1. Mitsuba's own inversion of the combined response is in float32 too.
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), 1, rtol=1e-5)


@VARIANTS
def test_render_adjoining_pulses_add_noise(variant):
    every = every_band(shipped("fl11"), place_bands([shipped("fl11")], NONE, DETECTORS, TOLERANCE))
    with mitsuba_session(variant) as mi:
        seen = furnace(mi, [film_response(pulse) for pulse in every.pulses[10:15]])
    assert seen.std(axis=(0, 1)).max() > 1e-2  # so the gate above means something
