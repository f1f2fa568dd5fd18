"""What is right: the chart's own formula where the scene is one of the shipped charts alone, else a much longer render."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.parameters import Camera
from pixsim.base.progress import Progress
from pixsim.light.spectral import SpectralImage
from pixsim.scene.charts import SLANT_DEG, csf_contrast, csf_value
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene, packaged_scenes
from pixsim.studies.budget import Setup

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)
MIN_PARTS = 4096  # across a chart, for those nodes: far smaller than a cycle, exact to 1e-12
REFERENCE_WORK = 64  # times the samples of a default render
REFERENCE_BANDS = 470  # of 1 nm
REFERENCE_SEED = 7919  # beside the user's seed


def cell_means(value: Callable[[Array], Array], count: int) -> Array:
    """Means of a smooth function of [0, 1] over `count` equal cells; large cells are taken in parts."""
    parts = -(-MIN_PARTS // count)
    middle = (np.arange(count * parts) + 0.5) / (count * parts)
    means = (value(middle[:, None] + NODES / (2 * count * parts)) * (WEIGHTS / 2)).sum(axis=1)
    return np.asarray(means.reshape(count, parts).mean(axis=1))


def csf_picture(height: int, width: int) -> Array:
    """Cell means of the CSF chart's formula: a sum of a constant and a product of functions of x and of y."""
    base = float(csf_value(0.0, 0.0))  # the phase is 0 at x = 0: the mean
    wave = cell_means(lambda x: csf_value(x, 1.0) / base - 1, width)
    growth = cell_means(lambda y: csf_contrast(y) / csf_contrast(1.0), height)
    return base * (1 + growth[:, None] * wave[None, :])


def edge_picture(height: int, width: int, dark: float = 0.1) -> Array:
    """Cell means of the slanted edge. A line of a cell is bright right of the edge, which moves along the cell's height at a
    constant rate: the mean of what is covered is a difference of its integral, ∫ clip(u, 0, 1) du."""
    y = np.arange(height + 1) / height
    edge = (0.5 + (0.5 - y) * np.tan(np.radians(SLANT_DEG))) * width
    right = np.arange(1, width + 1)[None, :] - edge[:, None]  # of the edge, at the cells' upper and lower ends
    inside = np.clip(right, 0.0, 1.0)
    cover = np.diff(inside**2 / 2 + np.maximum(right - 1, 0.0), axis=0) / np.diff(right, axis=0)
    return np.asarray(dark + (1 - dark) * cover)


def flat_picture(height: int, width: int) -> Array:
    return np.ones((height, width))


FORMULAS: dict[str, Callable[[int, int], Array]] = {"csf": csf_picture, "flat": flat_picture, "slanted_edge": edge_picture}


def formula_of(scene: Scene, plan: Plan) -> str | None:
    """Name of the shipped chart that a scene shows alone, upright and filling the film; None for any other, and for a file
    of the same name elsewhere, which may show anything."""
    name = scene.path.stem
    shipped = name in FORMULAS and scene.path.resolve() == packaged_scenes()[name].resolve()
    return name if shipped and plan.chart is not None and "chart" not in scene.parameters else None


def analytic_reference(scene: Scene, camera: Camera, setup: Setup, name: str, shape: tuple[int, int]) -> tuple[SpectralImage, str]:
    """The chart's formula as irradiance, and in words: exact cell means, bands of 1 nm, the lens's fall-off at every sample."""
    plan = make_render_plan(scene, camera, setup.pixel, band_count=REFERENCE_BANDS)
    picture = FORMULAS[name](*shape)
    job = Renderer(scene.with_parameters(resolution=shape[1]), camera, plan, 0)
    pictures = [np.repeat(picture[:, :, None], len(light.fit.pulses), axis=2) for light in plan.lights]
    told = f"analytic, the formula of the {name} chart: {shape[1]} × {shape[0]} exact cell means, bands of 1 nm"
    return job.image(pictures, 0), told


def rendered_reference(
    scene: Scene, camera: Camera, setup: Setup, plan: Plan, work: float, told: Progress | None = None
) -> tuple[SpectralImage, str]:
    """A render, and in words: with nothing left out, other seeds, and at least `work` times the samples of the plan's, on a
    film twice as fine where the scene lets its resolution be set."""
    width = Renderer(scene, camera, plan, 0).size[1]
    free = "resolution" in scene.names
    finer = scene.with_parameters(resolution=2 * width) if free else scene
    full = make_render_plan(finer, camera, setup.pixel, full=True)
    cells = 4 if free else 1
    spp = 1 << max(4, math.ceil(math.log2(work * plan.spp * plan.passes / (full.passes * cells))))
    heavy = Renderer(finer, camera, replace(full, spp=spp), setup.seed + REFERENCE_SEED)
    image = heavy.image(*heavy.run(0, told))
    times = full.passes * spp * cells / (plan.spp * plan.passes)
    size = " × ".join(str(n) for n in heavy.size[::-1])
    return image, f"a render of {times:.0f} times the work, other seeds: {size}, {full.passes} passes of {spp}"
