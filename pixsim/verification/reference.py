"""Reference irradiance: the formula of a packaged chart, or a much longer render of any other scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.progress import Progress
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.charts import MAX_LP_PER_MM, SLANT_DEG, csf_contrast, csf_value
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import CHART, Scene
from pixsim.studies.budget import ProbeDesign

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)
MIN_PARTS = 4096  # across a chart: parts much smaller than a cycle, for which the quadrature is exact to 1e-12
REFERENCE_WORK = 64  # relative to the samples of a default render
REFERENCE_BANDS = 470  # of 1 nm
REFERENCE_SEED = 7919  # added to the user's seed


def cell_means(value: Callable[[Array], Array], count: int) -> Array:
    """Means of a smooth function on [0, 1] over `count` equal cells, by Gauss-Legendre quadrature in small parts."""
    parts = -(-MIN_PARTS // count)
    middle = (np.arange(count * parts) + 0.5) / (count * parts)
    means = (value(middle[:, None] + NODES / (2 * count * parts)) * (WEIGHTS / 2)).sum(axis=1)
    return np.asarray(means.reshape(count, parts).mean(axis=1))


def csf_picture(height: int, width: int) -> Array:
    """Cell means of the CSF chart's formula, a constant plus a product of functions of x and y."""
    base = float(csf_value(0.0, 0.0))  # the mean, as the phase is 0 at x = 0
    wave = cell_means(lambda x: csf_value(x, 1.0) / base - 1, width)
    growth = cell_means(lambda y: csf_contrast(y) / csf_contrast(1.0), height)
    return base * (1 + growth[:, None] * wave[None, :])


def edge_picture(height: int, width: int, dark: float = 0.1) -> Array:
    """Cell means of the slanted edge, bright on the right."""
    y = np.arange(height + 1) / height
    edge = (0.5 + (0.5 - y) * np.tan(np.radians(SLANT_DEG))) * width
    right = np.arange(1, width + 1)[None, :] - edge[:, None]  # from the edge to a cell's right side, at its top and bottom
    inside = np.clip(right, 0.0, 1.0)
    # Along the height of a cell the edge moves at a constant rate: the mean cover is a difference of ∫ clip(u, 0, 1) du.
    cover = np.diff(inside**2 / 2 + np.maximum(right - 1, 0.0), axis=0) / np.diff(right, axis=0)
    return np.asarray(dark + (1 - dark) * cover)


def flat_picture(height: int, width: int) -> Array:
    return np.ones((height, width))


FORMULAS: dict[str, Callable[[int, int], Array]] = {"csf": csf_picture, "flat": flat_picture, "slanted_edge": edge_picture}


def formula_of(scene: Scene, plan: Plan) -> str | None:
    """Name of the packaged chart that fills a scene's film; None for other scenes, and for files elsewhere of the same name."""
    name = scene.path.stem
    shipped = name in FORMULAS and scene.path.resolve() == packaged_scenes()[name].resolve()
    changed = scene.parameters.keys() & {CHART, MAX_LP_PER_MM}
    return name if shipped and plan.chart is not None and not changed else None


def analytic_reference(
    scene: Scene, camera: Camera, design: ProbeDesign, name: str, shape: tuple[int, int]
) -> tuple[SpectralImage, str]:
    """Irradiance of the chart's formula, and its description: exact cell means, bands of 1 nm, the lens's fall-off."""
    plan = make_render_plan(scene, camera, design.imaging.pixel, band_count=REFERENCE_BANDS)
    picture = FORMULAS[name](*shape)
    job = Renderer(scene.with_resolution(shape[1]), camera, plan, 0)
    pictures = [np.repeat(picture[:, :, None], len(light.fit.pulses), axis=2) for light in plan.lights]
    description = f"analytic, the formula of the {name} chart: {shape[1]} × {shape[0]} exact cell means, bands of 1 nm"
    return job.image(pictures, 0), description


def rendered_reference(
    scene: Scene, camera: Camera, design: ProbeDesign, plan: Plan, work: float, progress: Progress | None = None
) -> tuple[SpectralImage, str]:
    """A render with other seeds, no pruning, at least `work` times the samples and, if possible, a finer film; its description."""
    width = Renderer(scene, camera, plan, 0).size[1]
    free = "resolution" in scene.names
    finer = scene.with_resolution(2 * width) if free else scene
    full = make_render_plan(finer, camera, design.imaging.pixel, full=True)
    cells = 4 if free else 1
    spp = 1 << max(4, math.ceil(math.log2(work * plan.spp * plan.passes / (full.passes * cells))))
    renderer = Renderer(finer, camera, replace(full, spp=spp), design.seed + REFERENCE_SEED)
    image = renderer.image(*renderer.run(0, progress))
    times = full.passes * spp * cells / (plan.spp * plan.passes)
    size = " × ".join(str(n) for n in renderer.size[::-1])
    return image, f"a render of {times:.0f} times the work, other seeds: {size}, {full.passes} passes of {spp}"
