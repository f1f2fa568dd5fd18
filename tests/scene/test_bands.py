"""Bands, pulses and passes: lines are conserved, wavelengths are not random, reported errors are the
real ones, and passes that are traced together are each of them.
"""

from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import END, FOLDER, NEEDS_LLVM, VARIANTS, edited

import pixsim
from pixsim.light.spectral import (
    STEPS_NM,
    VISIBLE,
    Spectrum,
    grid_nm,
    photons_per_joule,
    photopic_efficiency,
    tabulated,
)
from pixsim.scene.bands import (
    SHAPE_TOLERANCE,
    Bands,
    Detector,
    Fit,
    Pulse,
    Response,
    band_edges_nm,
    every_band,
    fit,
    passes,
    place_bands,
    window_pulse,
)
from pixsim.scene.guard.in_process import InProcessTracer, _stratified_places
from pixsim.scene.job import TraceJob
from pixsim.scene.mitsuba import import_mitsuba, mitsuba_session, parse
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import Renderer, film, film_response, shared_passes

SPECTRA = FOLDER / "spectra"
STEP_NM = 0.01  # each table is linear over cells of this width, or nearly: 1e-6 of any integral
FINE_NM = np.arange(360 + STEP_NM / 2, 830, STEP_NM)
NONE = np.zeros((0, 471))
TOLERANCE = 2.5e-4  # what the bands may cost in a render: BANDS_SHARE of the default tolerance


def spectrum(nodes, values) -> Spectrum:
    return Spectrum(np.asarray(nodes, float), np.asarray(values, float))


def packaged(name: str) -> Spectrum:
    return spectrum(*np.loadtxt(SPECTRA / f"{name}.spd").T)


def line(centre_nm: float, width_nm: float = 1.0) -> Spectrum:
    """Return a triangle of unit area with a full width at half maximum of `width_nm`."""
    return spectrum([centre_nm - width_nm, centre_nm, centre_nm + width_nm], [0, 1 / width_nm, 0])


def electrons(technology: str) -> Response:
    physics = pixsim.derive(pixsim.Pixel(technology=technology, pitch_um=10.0))
    return lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)


def ramp(nm: np.ndarray) -> np.ndarray:
    return 0.2 + (nm - 360) / 470


def red(nm: np.ndarray) -> np.ndarray:
    return 0.05 + 1 / (1 + np.exp((600 - nm) / 5))


DETECTORS = [
    Detector(response)
    for response in [electrons("0.35um"), electrons("4t-bsi"), photopic_efficiency, ramp, red]
]
# Responses above zero at all wavelengths, so that no line is invisible.
SEEING = [
    ramp,
    lambda nm: 1.1 - (nm - 360) / 470,
    lambda nm: 0.1 + np.exp(-(((nm - 550) / 60) ** 2)),
]
MACBETH = np.array(
    [
        np.interp(grid_nm(), *np.loadtxt(file).T)
        for file in sorted((SPECTRA / "macbeth").glob("*.spd"))
    ]
)


def fine(lamp: Spectrum) -> np.ndarray:
    return np.interp(FINE_NM, lamp.nodes_nm, lamp.values, left=0, right=0)


def exact_integral(lamp: Spectrum, low: float, high: float) -> float:
    """Return the integral as a sum over linear pieces."""
    inside = lamp.nodes_nm[(lamp.nodes_nm > low) & (lamp.nodes_nm < high)]
    cuts = np.concatenate([[low], inside, [high]])
    values = np.interp((cuts[1:] + cuts[:-1]) / 2, lamp.nodes_nm, lamp.values, left=0, right=0)
    return float((values * np.diff(cuts)).sum())


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
def test_cell_means_and_grids_have_the_integral_of_the_table(name: str) -> None:
    lamp = TABLES[name]
    for edges in (np.arange(360.0, 831.0), np.sort(RNG.uniform(355, 835, 40))):
        expected = [exact_integral(lamp, low, high) / (high - low) for low, high in pairwise(edges)]
        # The running sum is rounded at its size: 1e-13 of the largest mean.
        atol = 1e-12 * lamp.values.max()
        np.testing.assert_allclose(lamp.cell_means(edges), expected, rtol=1e-9, atol=atol)

    # Nodes at 555 nm are rounded to 1e-13 nm: 3e-11 of a line 4 pm wide.
    whole = pytest.approx(exact_integral(lamp, 360, 830), rel=1e-10, abs=1e-12)
    assert lamp.integral() == whole
    for step_nm in STEPS_NM:
        assert np.trapezoid(lamp.on_grid(step_nm), dx=step_nm) == whole


# --- Bands ---
@pytest.mark.parametrize(
    "lamp", [packaged("d65"), tabulated(np.ones(471)), TABLES["two nodes"]], ids=str
)
def test_bands_of_a_smooth_lamp_are_uniform(lamp: Spectrum) -> None:
    bands = place_bands([lamp], NONE, DETECTORS, TOLERANCE)
    np.testing.assert_array_equal(bands.edges_nm, [360, *range(365, 826, 10), 830])
    np.testing.assert_array_equal(bands.wavelength_nm, [362.5, *range(370, 821, 10), 827.5])


LINES_NM = [360.0, 360.5, 361.0, 364.5, 365.0, 365.125, 374.99, 375.0, 532.0, 546.07, 632.8]
LINES_NM += [655.0, 824.9, 825.0, 829.5, 830.0, *RNG.uniform(360, 830, 8).round(2).tolist()]
BAND_LAMPS = {f"{nm} nm, {width} nm": line(nm, width) for nm in LINES_NM for width in (1.0, 0.1)}
BAND_LAMPS |= {name: packaged(name) for name in ("fl11", "led_b3", "laser_532nm", "d65", "a")}


@pytest.mark.parametrize("name", BAND_LAMPS)
def test_bands_conserve_energy_and_signals(name: str) -> None:
    """Each response's signal to 1e-3: band centres in place of a line would be 1e-2 off."""
    lamp, light = BAND_LAMPS[name], fine(BAND_LAMPS[name])
    bands = place_bands([lamp], NONE, [Detector(response) for response in SEEING], TOLERANCE)
    every = every_band(lamp, bands)
    energies = every.spectra * bands.width_nm
    # A line's nodes are rounded to 1e-13 nm.
    assert energies.sum() == pytest.approx(exact_integral(lamp, 360, 830), rel=1e-11)
    for response in SEEING:
        expected = (light * response(FINE_NM)).sum() * STEP_NM
        assert (energies @ bands.mean(response)).sum() == pytest.approx(expected, rel=1e-3)

    # The pulses are where the light is, to a quarter of their step; at the ends of what Mitsuba
    # samples flanks of two steps need room.
    energy = energies.sum(axis=1)
    centroids_nm = [pulse.nodes_nm @ pulse.values / pulse.values.sum() for pulse in every.pulses]
    centroid_nm = (light * FINE_NM).sum() / light.sum()
    is_at_end = min(centroid_nm - 360, 830 - centroid_nm) < 4 * lamp.step_nm
    reach_nm = (2.25 if is_at_end else 0.25) * lamp.step_nm
    assert energy @ centroids_nm / energy.sum() == pytest.approx(centroid_nm, abs=reach_nm)


@pytest.mark.parametrize(("tolerance", "least", "most"), [(TOLERANCE, 0, 1.05), (1.0, 2, 1e3)])
def test_bands_are_narrow_where_a_response_is_steep(
    tolerance: float, least: float, most: float
) -> None:
    # Bands of 10 nm, which the second tolerance allows, err by more.
    edge = 1 / (1 + np.exp((600 - grid_nm()) / 2))
    lamp = packaged("d65")
    light = fine(lamp) * np.interp(FINE_NM, grid_nm(), edge)
    bands = place_bands([lamp], edge[None], [Detector(red)], tolerance)
    energy = np.add.reduceat(light, np.searchsorted(FINE_NM, bands.edges_nm[:-1]))
    error = abs((energy * bands.mean(red)).sum() / (light * red(FINE_NM)).sum() - 1)
    assert least * TOLERANCE <= error < most * TOLERANCE


# --- A pulse for each band ---
def check_pulses(pulses: tuple[Pulse, ...]) -> None:
    """Check that pulses have unit area on regular grids that float32 holds, and end at zero."""
    for pulse in pulses:
        assert 360 <= pulse.low_nm < pulse.high_nm <= 830
        assert np.trapezoid(pulse.values, pulse.nodes_nm) == pytest.approx(1, abs=1e-12)
        assert pulse.values.min() >= 0
        assert not pulse.values[[0, 1, -2, -1]].any()
        np.testing.assert_array_equal(np.float32(pulse.nodes_nm), pulse.nodes_nm)


def check_passes(every: Fit) -> None:
    """Check that each pulse has a pass, and no two of a pass share more than a zero."""
    assert {index for group in every.passes for index in group} == set(range(len(every.pulses)))
    for group in every.passes:
        pulses = [every.pulses[index] for index in group]
        spans = sorted({(pulse.low_nm, pulse.high_nm) for pulse in pulses})
        assert all(lower[1] <= upper[0] for lower, upper in pairwise(spans)), spans


@pytest.mark.parametrize("lit", [1, 2, 3, 4, 7, 8, 9, 12, 26, 46])
def test_passes_over_bands_of_10_nm_are_disjoint(lit: int) -> None:
    """Each bright band has a pulse; passes have four from eight pulses on."""
    lamp = spectrum([366, 367, 373 + 10 * (lit - 1), 374 + 10 * (lit - 1)], [0, 1, 1, 0])
    bands = place_bands([lamp], NONE, DETECTORS, 1.0)
    every = every_band(lamp, bands)
    check_pulses(every.pulses)
    check_passes(every)
    assert np.count_nonzero(every.spectra, axis=1).tolist() == [1] * lit
    np.testing.assert_allclose(
        every.spectra.sum(axis=0), lamp.cell_means(bands.edges_nm), rtol=1e-13
    )
    assert len(every.passes) == (-(-lit // 4) if lit >= 8 else lit)


@pytest.mark.parametrize("count", [1, 3, 4, 8, 15, 32])
def test_passes_over_narrow_bands_are_disjoint(count: int) -> None:
    edges = np.array([360, *(500 + 1.25 * np.arange(count + 1)), 830])
    centre = (edges[1:] + edges[:-1]) / 2
    lamp = spectrum([500, 500, edges[-2], edges[-2]], [0, 1, 1, 0])
    every = every_band(lamp, Bands(edges, centre, centre[:, None], np.ones((centre.size, 1))))
    assert len(every.pulses) == count
    check_passes(every)


@pytest.mark.parametrize("lamp", [None, spectrum([360, 830], [1, 5])], ids=["flat", "rising"])
def test_pulses_of_all_bands_add_up_to_the_lamp(lamp: Spectrum | None) -> None:
    """Each wavelength counts once, at a border in two halves; without a lamp they are flat."""
    bands = place_bands([lamp] if lamp else [], NONE, DETECTORS, TOLERANCE)
    np.testing.assert_array_equal(bands.edges_nm, band_edges_nm(VISIBLE))
    every = every_band(lamp, bands)
    check_pulses(every.pulses)
    energies = every.spectra.sum(axis=1) * bands.width_nm

    # Between the ends of the range, where light is moved to make room for flanks.
    nm = np.arange(365.625, 824.5, 1 / 8)
    shapes = np.array([np.interp(nm, pulse.nodes_nm, pulse.values) for pulse in every.pulses])
    expected = lamp.at(nm) if lamp else np.ones(nm.size)
    np.testing.assert_allclose(energies @ shapes, expected, rtol=1e-9)


# --- Few pulses for all bands ---
# Reflectances that turn over within 40 to 110 nm, as those of things do.
WAVES = np.array(
    [
        0.5 + 0.4 * np.sin(grid_nm() / scale + phase)
        for scale in (40, 70, 110)
        for phase in (0, 2, 4)
    ]
)
FITS = [("fl11", WAVES), ("d65", WAVES), ("led_b3", MACBETH), ("laser_532nm", MACBETH)]


def fitted(lamp: Spectrum, surfaces: np.ndarray, tolerance: float) -> tuple[Fit, Bands]:
    bands = place_bands([lamp], surfaces, DETECTORS, tolerance / 4)
    result = fit(lamp, bands, surfaces, DETECTORS, tolerance * 0.8)
    assert result is not None
    return result, bands


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
@pytest.mark.parametrize(("name", "surfaces"), FITS, ids=[name for name, _ in FITS])
def test_reported_error_of_a_fit_is_the_real_one(
    name: str, surfaces: np.ndarray, tolerance: float
) -> None:
    """Signals and bands of each surface, a neutral one first, and of sums of them, against
    integrals in steps of 0.01 nm.
    """
    lamp = packaged(name)
    result, bands = fitted(lamp, surfaces, tolerance)
    check_pulses(result.pulses)
    assert result.error <= tolerance * 0.8
    assert result.spectra.min() < 0 or len(result.pulses) == 1

    factors = np.array([np.interp(FINE_NM, grid_nm(), row) for row in (np.ones(471), *surfaces)])
    light = np.vstack([factors, RNG.dirichlet(np.full(len(factors), 0.3), 30) @ factors])
    pulses = [np.interp(FINE_NM, p.nodes_nm, p.values, left=0, right=0) for p in result.pulses]
    bands_light = light @ np.transpose(pulses) * STEP_NM @ result.spectra
    weights = np.array([detector.response(FINE_NM) for detector in DETECTORS])
    band_weights = [bands.width_nm * bands.mean(detector.response) for detector in DETECTORS]
    expected = light @ (fine(lamp) * weights).T * STEP_NM
    # Two-sided: 5 % for a pulse as Mitsuba integrates it, straight between its nodes.
    worst = np.abs(bands_light @ np.transpose(band_weights) / expected - 1).max(axis=1)
    assert worst[: len(factors)].max() == pytest.approx(result.error, rel=0.05, abs=1e-5)
    assert worst[len(factors) :].max() <= 1.05 * result.error + 1e-5

    first = np.searchsorted(FINE_NM, bands.edges_nm[:-1])
    expected = np.add.reduceat(light * fine(lamp), first, axis=1) * STEP_NM / bands.width_nm
    shape_error = np.abs(bands_light - expected).max(axis=1) / expected.max(axis=1)
    assert shape_error.max() < 1.05 * SHAPE_TOLERANCE
    assert shape_error[0] < 1e-3  # NEUTRAL_WEIGHT


LOW_PASS = np.where(grid_nm() < 504, 1, 0.01)


@pytest.mark.parametrize(
    ("lamp", "surfaces"),
    [
        (spectrum([360, 830], [0, 0]), WAVES),
        # A filter's edge within a lamp that is too narrow for several pulses
        (spectrum([500, 502, 506, 508], [0, 1, 1, 0]), np.array([LOW_PASS, 1.01 - LOW_PASS])),
        # Interference fringes every 3 nm
        (packaged("d65"), np.array([0.5 + 0.5 * np.sin(2 * grid_nm() + at) for at in range(4)])),
    ],
    ids=["dark", "filter", "fringes"],
)
def test_light_that_no_few_pulses_determine_has_no_fit(
    lamp: Spectrum, surfaces: np.ndarray
) -> None:
    bands = place_bands([lamp], surfaces, DETECTORS, TOLERANCE)
    assert fit(lamp, bands, surfaces, DETECTORS, 1e-4) is None


# --- In Mitsuba ---
def furnace(variant: str, pulses: list[Pulse]) -> np.ndarray:
    """Render a uniform emitter of radiance 1 that fills the view, (12, 12, channels)."""
    description = {
        "type": "scene",
        "lamp": {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}},
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "sampler": {"type": "multijitter", "sample_count": 16},
            "film": film([film_response(pulse) for pulse in pulses], (12, 12), 0, 12),
        },
    }
    with mitsuba_session(variant) as mi:
        integrator = mi.load_dict({"type": "path", "max_depth": 1, "block_size": 32})
        picture = mi.render(mi.load_dict(description), integrator=integrator, spp=16, seed=1)
        return np.asarray(picture, float)


@VARIANTS
def test_pulses_of_a_pass_add_no_spectral_noise(variant: str) -> None:
    # Every sample has one wavelength in each pulse, at which lamp over pulse is the same: float32
    # and its sums are left, and those of Mitsuba's inversion of the response. Adjoining pulses of
    # bands would have noise.
    result, bands = fitted(packaged("fl11"), MACBETH, 1e-2)
    picture = furnace(variant, [result.pulses[index] for index in result.passes[-1]])
    np.testing.assert_allclose(picture.mean(axis=(0, 1)), 1, rtol=1e-5)
    assert picture.std(axis=(0, 1)).max() < 1e-5
    adjoining = furnace(variant, list(every_band(packaged("fl11"), bands).pulses[10:15]))
    assert adjoining.std(axis=(0, 1)).max() > 1e-2


LLVM = "llvm_ad_spectral"
LARGE = (
    1000  # operations of a kernel: a path takes 1700 here and more, what surrounds it less than 100
)


def job_of(scene: Path, seed: int = 0) -> Renderer:
    loaded = pixsim.load_scene(scene, variant=LLVM, resolution=8)
    plan = make_render_plan(loaded, pixel=pixsim.Pixel())
    plan = replace(plan, samples=replace(plan.samples, spp=4))
    job = Renderer(loaded, loaded.camera(), plan, seed)
    job.tracer = InProcessTracer(job.job)  # a child has kernels of its own
    return job


def large_kernels(job: Renderer, runs: int, levels: int) -> list[str]:
    """Hashes of the large kernels of some runs, whether they are compiled, or found in memory or on
    the disk.
    """
    dr = pytest.importorskip("drjit")
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for level, index in product(range(levels), range(runs)):
            job.run(index, level=level)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    return [str(kernel["hash"]) for kernel in kernels if kernel["operation_count"] > LARGE]


@pytest.fixture(scope="module")
def import_first() -> None:
    import_mitsuba(LLVM)


SECOND = """<emitter type="point"><point name="position" x="0" y="1" z="0"/>
    <spectrum name="intensity" filename="spectra/led_b3.spd"/></emitter>"""


@NEEDS_LLVM
def test_light_and_level_compile_one_large_kernel(import_first: None, tmp_path: Path) -> None:
    """One launch for all passes of patches under two lamps, whose kernels compile in a moment; a
    second renderer compiles none.
    """
    lamp = '<default name="lamp" value="spectra/d65.spd"/>'
    path = edited(tmp_path, "macbeth", (lamp, lamp.replace("d65", "fl11")), (END, SECOND))
    first = job_of(path)
    assert (len(first.plan.light.lamps), first.plan.light.passes) == (2, 7)
    launched = large_kernels(first, runs=2, levels=2)
    assert (len(launched), len(set(launched))) == (2 * 2 * 2, 2 * 2)
    assert set(large_kernels(job_of(path, seed=1), 1, 2)) <= set(launched)


@NEEDS_LLVM
@pytest.mark.parametrize("plugin", ["path", "prb"])
def test_pulses_are_sampled_as_they_are(plugin: str, import_first: None) -> None:
    """Radiance λ - 360 nm everywhere, seen through pulses of a lamp with a line and a slope."""
    lamp = spectrum([360.0, 545.8, 546.1, 546.4, 830.0], [1.0, 2.0, 40.0, 2.0, 3.0])
    cuts = np.linspace(360, 830, 10)
    pulses = tuple(window_pulse(lamp, low, high, inside=True) for low, high in pairwise(cuts))
    lanes = shared_passes(Fit(pulses, np.eye(9), [*passes(9), [0], [4, 7]]))
    text = """<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant">
        <spectrum name="radiance" value="360:0, 830:470"/></emitter></scene>"""
    (sensor,) = (i for i, node in enumerate(parse(text, LLVM).nodes) if node.type.name == "Sensor")
    lens, integrator = {"type": "perspective", "fov": 20.0}, {"type": plugin, "max_depth": 2}
    job = TraceJob(LLVM, text, (None,), sensor, lens, integrator, (), (40, 40), (lanes,))
    traced = InProcessTracer(job).trace_together(0, (0, 40), "multijitter", 64, 3)

    # The mean wavelength under each pulse is its centroid, whatever its shape, to five standard
    # errors (9 pulses exceed them once in 200 000 times) and float32; a shift by a step of 0.03 to
    # 0.1 nm would be seen.
    light = traced.reshape(1600, -1).astype(float)
    error_nm = light.std(axis=0) / np.sqrt(len(light))
    assert error_nm.max() < 0.02
    centroids_nm = [pulse.mean(grid_nm(pulse.step_nm), pulse.step_nm) for pulse in pulses]
    miss_nm = np.abs(360 + light.mean(axis=0) - centroids_nm)
    np.testing.assert_array_less(miss_nm, 5 * error_nm + 1e-3)


@NEEDS_LLVM
@pytest.mark.parametrize(("spp", "count"), [(4, 12), (16, 5), (15, 3), (7, 2)])
def test_places_are_stratified_in_a_pass_and_over_all(
    spp: int, count: int, import_first: None
) -> None:
    """All passes have one in each row and column together, each pass one in each of fewer, and one
    in each part of the cell.
    """
    mi = import_mitsuba(LLVM)
    numbers = np.meshgrid(range(spp), range(count))
    number, group = (mi.UInt32(part.ravel().astype(np.uint32)) for part in numbers)
    draws = mi.PCG32(spp * count)
    places = _stratified_places(
        mi,
        number=number,
        spp=spp,
        group=group,
        count=count,
        cell=mi.UInt32(5),
        seed=mi.UInt32(1),
        jitter=mi.Point2f(draws.next_float32(), draws.next_float32()),
    )
    x, y = (np.array(axis, float).reshape(count, spp) for axis in places)
    for axis in (x, y):
        assert sorted(np.floor(axis.ravel() * spp * count)) == list(range(spp * count))
        np.testing.assert_array_equal(np.sort(np.floor(axis * spp)), [np.arange(spp)] * count)
    rows = max(rows for rows in range(1, spp) if spp % rows == 0 and rows**2 <= spp)
    parts = np.floor(y * rows) * (spp // rows) + np.floor(x * (spp // rows))
    np.testing.assert_array_equal(np.sort(parts), [np.arange(spp)] * count)
