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

import pixsim
from pixsim.light.spectral import Spectrum, grid_nm
from pixsim.scene.bands import Fit, passes, window_pulse
from pixsim.scene.guard.in_process import InProcessTracer, _stratified_places
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


def test_light_and_level_compile_one_large_kernel(import_first: None, two_lights: Path) -> None:
    """One launch for all passes; a second renderer compiles none."""
    first = job_of(two_lights)
    assert (len(first.plan.light.lamps), first.plan.light.passes) == (2, 7)
    launched = large_kernels(first, runs=2, levels=2)
    assert (len(launched), len(set(launched))) == (2 * 2 * 2, 2 * 2)
    assert set(large_kernels(job_of(two_lights, seed=1), 1, 2)) <= set(launched)


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
def test_pulses_are_sampled_as_they_are(plugin: str, import_first: None) -> None:
    # The mean wavelength under each pulse is its centroid, whatever its shape, to five standard
    # errors (9 pulses exceed them once in 200 000 times) and float32; a shift by a step of 0.03 to
    # 0.1 nm would be seen.
    traced, fit = tracer_of(1.0, 0.0, (40, 40), plugin)
    light = traced.trace_together(0, (0, 40), "multijitter", 64, 3).reshape(1600, -1).astype(float)
    error_nm = light.std(axis=0) / np.sqrt(len(light))
    assert error_nm.max() < 0.02
    grids = [grid_nm(pulse.step_nm) for pulse in fit.pulses]
    centroids_nm = [
        pulse.mean(nm, pulse.step_nm) for pulse, nm in zip(fit.pulses, grids, strict=True)
    ]
    miss_nm = np.abs(360 + light.mean(axis=0) - centroids_nm)
    np.testing.assert_array_less(miss_nm, 5 * error_nm + 1e-3)


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
