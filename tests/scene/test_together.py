"""Passes that are traced together: against closed forms and against each pass by itself, and how
many kernels they compile.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import END, NEEDS_LLVM, edited
from scipy.stats import t as student

import pixsim
from pixsim.light.spectral import Spectrum, grid_nm
from pixsim.scene import renderer
from pixsim.scene.bands import Fit, passes, window_pulse
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.job import TraceJob
from pixsim.scene.mitsuba import import_mitsuba, parse
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import Renderer, shared_passes

pytestmark = NEEDS_LLVM
LLVM = "llvm_ad_spectral"
SIDE = 8
LARGE = (
    1000  # operations of a kernel: a path takes 1700 here and more, what surrounds it less than 100
)


def job_of(scene: Path | str, seed: int = 0, spp: int = 4, **parameters: Any) -> Renderer:
    loaded = pixsim.load_scene(scene, variant=LLVM, resolution=SIDE, **parameters)
    plan = make_render_plan(loaded, pixel=pixsim.Pixel())
    job = Renderer(
        loaded, loaded.camera(), replace(plan, samples=replace(plan.samples, spp=spp)), seed
    )
    job.tracer = InProcessTracer(job.job)  # a child has kernels of its own
    return job


def large_kernels(job: Renderer, runs: int, levels: int) -> list[str]:
    """Hashes of the large kernels of some runs, whether they are compiled, or found in memory or on
    the disk.
    """
    dr = pytest.importorskip("drjit")
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for level in range(levels):
            for index in range(runs):
                job.run(index, level=level)
        return [
            str(kernel["hash"])
            for kernel in dr.kernel_history([dr.KernelType.JIT])
            if kernel["operation_count"] > LARGE
        ]


@pytest.fixture(scope="module")
def import_first() -> None:
    import_mitsuba(LLVM)


SECOND = """<emitter type="point"><point name="position" x="0" y="1" z="0"/>
    <spectrum name="intensity" filename="spectra/led_b3.spd"/></emitter>"""


@pytest.fixture
def two_lights(tmp_path: Path) -> Path:
    """Patches under two lamps, whose kernels compile in a moment."""
    lamp = '<default name="lamp" value="spectra/d65.spd"/>'
    return edited(tmp_path, "macbeth", (lamp, lamp.replace("d65", "fl11")), (END, SECOND))


def test_light_and_level_compile_one_large_kernel(import_first, two_lights):
    first = job_of(two_lights)
    lights, levels, runs = len(first.plan.light.lamps), 2, 2
    assert (lights, first.plan.light.passes) == (2, 7)
    launched = large_kernels(first, runs, levels)
    assert len(launched) == lights * levels * runs, "one launch for all passes"
    assert len(set(launched)) == lights * levels
    assert set(large_kernels(job_of(two_lights, seed=1), 1, levels)) <= set(launched), (
        "a second renderer compiles none"
    )


def test_strips_of_a_film_share_a_kernel(import_first, monkeypatch):
    whole = job_of("still_life")
    launched = large_kernels(whole, 1, 1)
    picture = whole.run(0)[0][0]
    monkeypatch.setattr(renderer, "SAMPLES_TOGETHER", whole.plan.light.passes * 4 * SIDE * 3)
    strips = job_of("still_life")
    assert large_kernels(strips, 1, 1) == 3 * launched
    # Strips have seeds of their own, but the first has that of the whole.
    np.testing.assert_array_equal(strips.run(0)[0][0][:2], picture[:2])


@cache
def tracer_of(
    scale: float, offset: float, sizes: tuple[int, int], plugin: str = "path"
) -> tuple[InProcessTracer, Fit]:
    """Radiance offset + scale · (λ - 360 nm) everywhere, seen through pulses of a lamp with a line
    and a slope.
    """
    lamp = Spectrum(
        np.array([360.0, 545.8, 546.1, 546.4, 830.0]), np.array([1.0, 2.0, 40.0, 2.0, 3.0])
    )
    cuts = np.linspace(360, 830, 10)
    pulses = tuple(window_pulse(lamp, low, high, inside=True) for low, high in pairwise(cuts))
    fit = Fit(pulses, np.eye(9), [*passes(9), [0], [4, 7]])
    text = f"""<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"><spectrum name="radiance"
        value="360:{offset}, 830:{offset + 470 * scale}"/></emitter></scene>"""
    sensor = next(
        index for index, node in enumerate(parse(text, LLVM).nodes) if node.type.name == "Sensor"
    )
    lens, integrator = {"type": "perspective", "fov": 20.0}, {"type": plugin, "max_depth": 2}
    return (
        InProcessTracer(
            TraceJob(
                LLVM, text, (None,), sensor, lens, integrator, (), sizes, (shared_passes(fit),)
            )
        ),
        fit,
    )


@pytest.mark.parametrize("plugin", ["path", "prb"])
def test_pulses_are_sampled_as_they_are(import_first, plugin):
    """The mean wavelength under each pulse is its centroid, whatever its shape; 32 samples a cell
    are stratified.
    """
    traced, fit = tracer_of(1.0, 0.0, (40, 40), plugin)
    seen = traced.trace_together(0, (0, 40), "multijitter", 64, 3).reshape(1600, -1).astype(float)
    at_nm = 360 + seen.mean(axis=0)
    error_nm = seen.std(axis=0) / np.sqrt(len(seen))
    expected_nm = np.array(
        [pulse.mean(grid_nm(pulse.step_nm), pulse.step_nm) for pulse in fit.pulses]
    )
    assert error_nm.max() < 0.02  # so a shift by a step of 0.03 to 0.1 nm would be seen
    # Five standard errors: 9 pulses exceed them once in 200 000 times. Mitsuba's spectra are in
    # float32.
    assert (np.abs(at_nm - expected_nm) < 5 * error_nm + 1e-3).all()


def test_grey_light_has_no_noise(import_first):
    traced, _ = tracer_of(0.0, 1.0, (6, 5))
    np.testing.assert_allclose(
        traced.trace_together(0, (1, 5), "independent", 5, 1), np.ones((4, 5, 9)), rtol=1e-6
    )


def test_places_are_stratified_in_a_pass_and_over_all(import_first):
    mi = import_mitsuba(LLVM)
    import drjit as dr

    from pixsim.scene.guard.in_process import _stratified_places

    for spp, count in ((4, 12), (16, 5), (15, 3), (7, 2)):
        number, group = (
            mi.UInt32(part.ravel().astype(np.uint32))
            for part in np.meshgrid(range(spp), range(count))
        )
        draws = mi.PCG32(spp * count)
        jitter = mi.Point2f(draws.next_float32(), draws.next_float32())
        places = _stratified_places(
            mi,
            number=number,
            spp=spp,
            group=group,
            count=count,
            cell=mi.UInt32(5),
            seed=mi.UInt32(1),
            jitter=jitter,
        )
        dr.eval(places)
        x, y = (np.array(axis, float).reshape(count, spp) for axis in places)
        for axis in (x, y):
            assert sorted(np.floor(axis.ravel() * spp * count)) == list(range(spp * count)), (
                "all passes: one a row"
            )
            assert (np.sort(np.floor(axis * spp), axis=1) == np.arange(spp)).all(), (
                "each pass: one a row"
            )
        rows = max(divisor for divisor in range(1, spp) if spp % divisor == 0 and divisor**2 <= spp)
        parts = np.floor(y * rows) * (spp // rows) + np.floor(x * (spp // rows))
        assert (np.sort(parts, axis=1) == np.arange(spp)).all(), (
            "each pass: one in each part of the cell"
        )


def test_child_traces_passes_as_this_process(import_first, two_lights):
    job = job_of(two_lights)
    np.testing.assert_array_equal(
        ChildTracer(job.job).trace_together(1, (2, 5), "multijitter", 4, 7),
        job.tracer.trace_together(1, (2, 5), "multijitter", 4, 7),
    )


# --- Against each pass by itself, as before passes were traced together: slow, the claim without
# the comparison is above ---

LAMPS = ("d65", "a", "fl11", "led_b3")
SCENES = [
    *((f"macbeth {lamp}", "macbeth", {"lamp": f"spectra/{lamp}.spd"}) for lamp in LAMPS),
    ("still_life", "still_life", {}),
]
SCENES += [("two lights", None, {}), ("dark room", "still_life", {"room_scale": 1e-5})]
SAMPLING = (("multijitter", 16), ("independent", 4), ("stratified", 9))
COMPARED = [(*scene, *sampling) for scene in SCENES for sampling in SAMPLING]
RUNS, FALSE_ALARMS = 12, 1e-3  # of all comparisons together


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "parameters", "sampler", "spp"),
    [each[1:] for each in COMPARED],
    ids=[f"{each[0]}-{each[3]}-{each[4]}" for each in COMPARED],
)
def test_pictures_agree_with_those_of_single_passes(
    import_first, two_lights, scene, parameters, sampler, spp
):
    """Means over independent runs: of each pulse, and of their sum in each quarter of the film."""
    scene = scene or two_lights
    together = job_of(scene, **parameters)
    together.plan = replace(
        together.plan, samples=replace(together.plan.samples, spp=spp, sampler=sampler)
    )
    single = job_of(scene, seed=1, **parameters)
    single.plan = together.plan
    single.job = replace(single.job, passes=(None,) * len(single.plan.light.lamps))
    means = []
    for job in (together, single):
        runs = [
            np.concatenate([planes.astype(float) for planes in job.run(index)[0]], axis=2)
            for index in range(RUNS)
        ]
        half = SIDE // 2
        quarters = [[run.sum(axis=2)[rows, columns].mean() for rows in (slice(half), slice(half, None))
                     for columns in (slice(half), slice(half, None))] for run in runs]  # fmt: skip
        means.append(np.hstack([np.array(runs).mean(axis=(1, 2)), quarters]))
    difference = means[0].mean(axis=0) - means[1].mean(axis=0)
    error = np.sqrt(sum(mean.var(axis=0, ddof=1) for mean in means) / RUNS)
    lit = error > 0
    t = np.abs(difference[lit] / error[lit])
    comparisons = len(COMPARED) * t.size
    # The degrees of freedom are at least those of one side (Welch).
    assert t.max() < student.isf(FALSE_ALARMS / comparisons / 2, RUNS - 1)
    assert t.mean() > 0.4, "0.8 where only noise differs: the errors are not too large"


def test_infrared_passes_are_traced_together(tmp_path: Path) -> None:
    """A black body on a wall that is steep, to 1100 nm: its bands are those of ρ L, relative to the
    first bright one.
    """
    plane = (
        '<transform name="to_world"><scale value="3"/><lookat origin="0,0,1" target="0,0,0"'
        ' up="0,1,0"/></transform>'
    )
    values = {300: 0.05, 600: 0.1, 620: 0.9, 700: 0.2, 720: 0.8, 900: 0.1, 920: 0.9, 1100: 0.3}
    table = ", ".join(f"{nm}:{value}" for nm, value in values.items())
    (tmp_path / "wall.xml").write_text(
        '<scene version="3.0.0"><integrator type="path"/><emitter type="constant"><spectrum'
        f' name="radiance" value="300:1, 1100:1"/></emitter><shape type="rectangle">{plane}<bsdf'
        f' type="diffuse"><spectrum name="reflectance" value="{table}"/></bsdf></shape><sensor'
        ' type="thinlens"><float name="fov" value="38"/><float name="aperture_radius"'
        ' value="0.0005"/><float name="focus_distance" value="1"/><transform'
        ' name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform><film'
        ' type="hdrfilm"><integer name="width" value="8"/><integer name="height"'
        ' value="8"/></film></sensor></scene>'
    )
    pixel = pixsim.Pixel(
        technology="4t-bsi",
        pitch_um=10.0,
        quantum_efficiency=[[300, 0.5], [1100, 0.5]],
        stack={"enabled": False},
    )
    loaded = pixsim.load_scene(tmp_path / "wall.xml", variant=LLVM).with_resolution(SIDE)
    plan = make_render_plan(loaded, pixel=pixel, full=True)
    plan = replace(plan, samples=replace(plan.samples, spp=256))
    assert plan.light.passes > 1
    image = pixsim.render(loaded, plan=plan)
    assert image.wavelength_nm[-1] > 1090
    spectrum, edges = (
        image.mean_spectrum(),
        np.concatenate([[300.0], 300 + np.cumsum(image.band_width_nm)]),
    )
    fine = np.linspace(300, 1100, 80_001)
    means = [
        np.interp(fine, [*values], [*values.values()])[(fine >= a) & (fine <= b)].mean()
        for a, b in pairwise(edges)
    ]
    photons = image.wavelength_nm * image.band_width_nm
    for low_nm, high_nm in ((300, 1100), (830, 1100), (300, 830)):
        part = (image.wavelength_nm > low_nm) & (image.wavelength_nm < high_nm)
        ratio = (spectrum * photons)[part].sum() / (np.array(means) * photons)[part].sum()
        whole = (spectrum * photons).sum() / (np.array(means) * photons).sum()
        assert ratio == pytest.approx(whole, rel=5e-3)
