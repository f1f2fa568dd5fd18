"""Decide from the scene's tree what a render can leave out: bounces, lens samples, texture samples,
diffraction.

A chart that fills the film is the picture itself, so that its texels tell what diffraction changes
before rendering.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.arrays import Array, in_threads, strips
from pixsim.base.digits import percent
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.mapped import release, zeros
from pixsim.light.spectral import HIGH_NM, WHOLE, Spectrum, regular_values
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import diffract
from pixsim.scene.contents import (
    FLAT,
    LAMBERTIAN,
    Body,
    emitted_picture,
    face_one_way,
    greatest_blur_um,
    parsed_table,
)
from pixsim.scene.tree import Tree, children, nodes_of
from pixsim.sensor.pixel import PixelPhysics

if TYPE_CHECKING:
    from scipy.sparse import csr_array

TEXTURE_SAMPLES = "texture samples"  # subject of a decision
TOLERANCE_E = 1e-3  # relative error of the mean electrons
# Of the tolerance, for leaving out blur and diffraction
BLUR_SHARE = 0.1
_DIFFRACTION_SHARE = 0.1
# A blur disc of diameter c moves 2c/(3π) of the light across an edge, which is at the centre of a
# pixel on average.
BLURRED_EDGE = 2 / (3 * math.pi)
_AIRY_DIAMETER = 2.44  # first dark ring over λN (Goodman)

# Sample counts, besides 1 and 2, for which pictures are the same bit for bit on any number of
# threads.
SAMPLE_COUNTS = (4, 16, 64, 256, 1024)
_ROUNDED_DOWN = 1.5  # to a sample count that is smaller by this factor at most
# Fewest samples on a film finer than the scene's. Those of a chart are stratified, and have an
# eighth of the noise of a single one; those of a path are independent, so that one in each of four
# cells is as good as four in one.
MIN_CHART_SPP = 2
MIN_PATH_SPP = 1
# With 4 samples, multijitter correlates the dimensions of a path (still_life: 0.8 % too dark).
MIN_MULTIJITTER_SPP = 16
_UNLIMITED = -1  # number of bounces or surfaces

# Charts
TRIED_SIDE = 512  # samples of a part of the film, in which diffraction is tried first
BORDER = 64  # samples of a part that reflection at its sides may change
RESOLVED = 0.999  # of the variance of a chart, in the frequencies that a film has to resolve
_SPECTRUM_LINES = 128  # of a texture, whose spectrum is computed
_DARKEST = 0.01  # of the brightest cell; errors of darker cells are relative to this
_ALIGNED = 1e-6  # of a chart's half width: tolerance for its position, rotation and size
# Of a chart's half width: where files round its size or the camera's angle, it still ends with the
# film.
ENDS = 1e-4

# Emitters that look the same from every point of the lens, or cannot be seen.
_DIFFUSE_EMITTERS = ("area", "constant", "point", "spot", "directional", "projector")
BACKGROUNDS = frozenset(("constant", "envmap", "sunsky", "sky"))  # seen beyond all shapes


@dataclass(frozen=True)
class Chart:
    """A chart that fills the film, as Mitsuba takes it: linear between the centres of its texels,
    or uniform over each of them.

    texels : (rows, columns), as the film shows them: from the top left
    texels_per_sample : (vertical, horizontal) texels per sample of the film
    shape : (H, W) of the film
    beyond : what continues the texels beyond their sides, a mode of `np.pad`, or None if it is not
        known how Mitsuba takes them
    source : what tells its texels from other charts', if that is known, such as a hash of
        their file
    nearest : whether each texel is uniform
    """

    texels: Array = field(repr=False)
    texels_per_sample: tuple[float, float]
    shape: tuple[int, int]
    beyond: Literal["edge", "wrap", "symmetric"] | None = "edge"
    source: str = ""
    nearest: bool = False

    def picture(self, part: tuple[slice, slice] = (WHOLE, WHOLE)) -> Array:
        """Return the exact mean of each film cell, (H, W), or of a part of the film.

        It shows the middle of a larger chart; beyond the end of a smaller one is nothing.
        """
        (down, rows), (across, columns) = (
            self._visible_texels(
                _cell_weights(count, n, per_sample, cells, nearest=self.nearest), n
            )
            for count, n, per_sample, cells in zip(
                self.shape, self.texels.shape, self.texels_per_sample, part, strict=True
            )
        )
        texels = self.texels[np.ix_(rows, columns)]
        picture: Array = zeros((down.shape[0], across.shape[0]))

        def compute(strip: slice) -> None:
            picture[strip] = (across @ (down[strip] @ texels).T).T
            release(picture[strip])

        # The matrices are sparse; strips save memory.
        in_threads(compute, strips(*picture.shape), picture.size)
        return picture

    def _visible_texels(self, weights: csr_array, n: int) -> tuple[csr_array, NDArray[np.intp]]:
        """Return the weights of the texels along an axis that cells show, and their indices.

        weights : (cells, n + 2), the first and the last of the texels beyond the sides
        n : texels along the axis
        """
        first = 0
        last = 0
        if weights.nnz:
            first = weights.indices.min()
            last = weights.indices.max()
        texels = np.arange(first, last + 1) - 1

        # Texels beyond the sides repeat the chart or its border.
        inside = texels % n if self.beyond == "wrap" else np.clip(texels, 0, n - 1)
        return weights[:, first : last + 1], inside

    @cached_property
    def digest(self) -> bytes:
        """Hash of its content."""
        geometry = repr(
            (self.texels.shape, self.texels_per_sample, self.shape, self.beyond, self.nearest)
        ).encode()
        if self.source:  # texels of 32 MB take 40 ms, in each plan of a study with many lights
            return self.source.encode() + geometry
        texels = np.ascontiguousarray(self.texels).data
        return hashlib.blake2b(texels, digest_size=16).digest() + geometry

    @property
    def details(self) -> float:
        """Half periods of the chart's finest detail across the film: frequencies up to it have
        `RESOLVED` of the variance.

        The steps between uniform texels have all frequencies.
        """
        if self.nearest and not self.uniform:
            return math.inf
        return _finest_detail(self)

    @property
    def uniform(self) -> bool:
        return float(np.ptp(self.texels)) == 0.0


def _by_content(function: Callable[..., float]) -> Callable[..., float]:
    """Keep the results of a function of a chart and numbers in the cache, by the content of the
    chart.
    """

    @wraps(function)
    def call(chart: Chart, *numbers: float) -> float:
        key = content_hash(
            [cache.version_fingerprint(), function.__name__, repr(chart.digest), numbers]
        )
        return cache.load_or_compute(
            "charts",
            key,
            lambda entry: float(entry["result"]),
            lambda: function(chart, *numbers),
            lambda result: {"result": result},
        )

    return call


@_by_content
def _finest_detail(chart: Chart) -> float:
    """Return the half periods of a chart's finest detail across the film, as in
    `Chart.details`.
    """
    if chart.uniform:
        return 1.0

    details = []
    for axis, n in enumerate(chart.texels.shape):
        lines = np.moveaxis(chart.texels, axis, 1)
        lines = lines[:: max(1, len(lines) // _SPECTRUM_LINES)]
        # Mirrored, so that the ends meet; the frequency of index k is k/2 periods per length.
        mirrored = np.concatenate([lines, lines[:, ::-1]], axis=1)
        power = (np.abs(np.fft.rfft(mirrored)) ** 2).sum(axis=0)[1:]
        if not power.sum() > 0:
            continue

        half_periods = 1 + int(np.searchsorted(np.cumsum(power) / power.sum(), RESOLVED))
        samples = n / chart.texels_per_sample[axis]  # that the whole texture would cover
        details.append(half_periods / samples * chart.shape[1])
    return max(details, default=1.0)


def _cell_weights(
    count: int, n: int, texels_per_sample: float, cells: slice, *, nearest: bool = False
) -> csr_array:
    """Return the weights of texels in the means of film cells along one axis, a sparse matrix
    (cells, n + 2).

    Between the centres of texels, the chart is linear: a texel's value is weighted with the
    integral of a tent of unit area. For a uniform texel it is the integral of a box.

    count, n : of cells and texels; column 0 and the last are the texels beyond the sides
    cells : cells to return
    """
    from scipy.sparse import csr_array  # imported here, since it takes time

    covered = texels_per_sample * count
    if covered <= n * (1 + _ALIGNED):
        covered = min(covered, n)

    # Edges of the cells in texels, where the centre of texel i is at i + 1. The chart ends half a
    # texel beyond the outermost centres.
    first, stop, _ = cells.indices(count)
    edges = (n - covered) / 2 + covered * np.arange(first, stop + 1) / count + 0.5
    edges = np.clip(edges, 0.5, n + 0.5)
    low = edges[:-1, None]
    high = edges[1:, None]
    texels = np.floor(low).astype(int) + np.arange(math.ceil(covered / count) + 2)

    def area_below(edge: Array) -> Array:
        """Area of each tent or box below an edge."""
        if nearest:
            return np.clip(edge - texels, -0.5, 0.5)
        side = np.clip(edge - texels, -1.0, 1.0)
        return np.where(side < 0, (1 + side) ** 2, 2 - (1 - side) ** 2) / 2

    weights = (area_below(high) - area_below(low)) * (count / covered)
    inside = (weights != 0) & (texels < n + 2)
    rows = np.broadcast_to(np.arange(stop - first)[:, None], weights.shape)
    return csr_array((weights[inside], (rows[inside], texels[inside])), shape=(stop - first, n + 2))


@_by_content
def diffraction_effect(
    chart: Chart,
    pitch_um: float,
    wavelength_nm: float,
    f_number: float,
    threshold: float = math.inf,
) -> float:
    """Return the largest relative change of any sample by diffraction, at the full resolution of
    the film.

    On a film larger than `TRIED_SIDE` a part around the chart's steepest texels is tested first. If
    its change exceeds `threshold`, it is the result.
    """
    if chart.uniform:
        return 0.0

    def largest_change(part: tuple[slice, slice], border: int) -> float:
        picture = chart.picture(part)
        blurred = diffract(picture, pitch_um, np.array([wavelength_nm]), np.ones(1), f_number)
        change = np.abs(blurred - picture) / np.maximum(picture, _DARKEST * picture.max())
        inner = tuple(
            slice(border, -border) if n > 2 * border > 0 else WHOLE for n in picture.shape
        )
        return float(change[inner].max())

    if max(chart.shape) > TRIED_SIDE and threshold < math.inf:
        effect = largest_change(_steepest_part(chart), BORDER)
        if effect > threshold:
            return effect
    return largest_change((WHOLE, WHOLE), 0)


def _steepest_part(chart: Chart) -> tuple[slice, slice]:
    """Return a part of the film, at most `TRIED_SIDE` samples a side, around the largest step
    between texels.
    """
    steps = [np.abs(np.diff(chart.texels, axis=axis)) for axis in (0, 1)]
    steepest = max((step for step in steps if step.size), key=lambda step: float(step.max()))
    texel = np.unravel_index(int(steepest.argmax()), steepest.shape)

    part = []
    for index, n, texels_per_sample, samples in zip(
        texel, chart.texels.shape, chart.texels_per_sample, chart.shape, strict=True
    ):
        middle = round((index + 1 - (n - texels_per_sample * samples) / 2) / texels_per_sample)
        first = min(max(middle - TRIED_SIDE // 2, 0), max(samples - TRIED_SIDE, 0))
        part.append(slice(first, min(first + TRIED_SIDE, samples)))
    return part[0], part[1]


@dataclass(frozen=True)
class Decision:
    """One decision of the plan; `bound_e` bounds the relative error of mean electrons that it
    causes, if `bounded`.
    """

    subject: str
    kept: bool
    reason: str
    saved: str = ""
    bound_e: float = 0.0
    bounded: bool = True


def decide_bounces(
    state: Tree, bodies: list[Body], full: bool
) -> tuple[dict[str, Any] | None, int, Decision]:
    """Return an integrator in place of the scene's, the number of surfaces that light can meet, and
    the decision.

    A flat emitter alone needs depth 1. Light meets one surface at most if the scene sets that
    depth, or if flat, diffuse, one-sided surfaces face the same way: `direct` then samples as
    `path` does, in less time.
    """
    integrators = [node for _, node in nodes_of(state, "Integrator")]
    max_depth = _UNLIMITED
    if integrators:
        max_depth = int(integrators[0].get("max_depth", _UNLIMITED))
    max_surfaces = _UNLIMITED if max_depth < 0 else max(max_depth - 1, 0)
    allowed = "any number" if max_depth < 0 else str(max_surfaces)

    # The scene's integrator
    if full:
        return None, max_surfaces, Decision("bounces", True, f"as set in the scene: {allowed}")
    names = [node.plugin for node in integrators] or ["path"]
    if names != ["path"] or max_depth in (0, 1) or nodes_of(state, "Medium"):
        decision = Decision("bounces", True, f"the scene's integrator, '{names[0]}'")
        return None, 1 if names == ["direct"] else max_surfaces, decision

    # A flat emitter alone
    options: dict[str, Any] = {}
    if integrators and integrators[0].get("hide_emitters", False):
        options = {"hide_emitters": True}
    emitters = {index for index, _ in nodes_of(state, "Emitter")}
    shining = {
        index
        for index, node in nodes_of(state, "Shape")
        if emitters & set(children(node, state).values())
    }
    is_alone = len(bodies) == 1 and len(emitters) == 1 and bodies[0].node in shining
    if is_alone and bodies[0].normal is not None:
        reason = "a flat emitter alone: its light goes straight to the lens"
        decision = Decision("bounces", False, reason, f"all of {allowed}")
        return {"type": "path", "max_depth": 1, **options}, 0, decision

    # One surface at most
    direct = {"type": "direct", **options}
    if max_depth == 2:
        reason = "one, as set in the scene: no loop over bounces"
        return direct, 1, Decision("bounces", False, reason, "a third of the time")
    is_matt = all(node.plugin == "diffuse" for _, node in nodes_of(state, "BSDF"))
    if is_matt and not shining and bodies and face_one_way(bodies):
        reason = "flat, one-sided, diffuse surfaces that face the same way do not light each other"
        return direct, 1, Decision("bounces", False, reason, f"all but 1 of {allowed}")

    reason = f"surfaces may light each other; as set in the scene: {allowed}"
    return None, max_surfaces, Decision("bounces", True, reason)


def irregular_tables(state: Tree) -> dict[tuple[int, str], tuple[Spectrum, Array]]:
    """Return (node, property) -> (table, values at equal steps) of the surface tables that allow
    equal steps.
    """
    tables = {}
    for index, node in enumerate(state.nodes):
        if node.kind not in ("BSDF", "Texture"):
            continue

        for name in node:
            if node.kind_of(name) != "Spectrum" or node[name].uniform:
                continue
            table = parsed_table(node[name])
            regular = regular_values(table)
            if regular is not None:
                tables[index, name] = table, regular
    return tables


def decide_tables(state: Tree, full: bool) -> tuple[bool, Decision]:
    """Decide whether tables with equal steps are looked up by index; Mitsuba searches tables of
    pairs.
    """
    count = len(irregular_tables(state))
    if full or not count:
        reason = "unchanged" if full else "none with equal steps"
        return False, Decision("spectrum tables", True, reason)
    reason = f"{count} with equal steps: looked up by index"
    return True, Decision("spectrum tables", False, reason, "the searches")


def decide_lens(
    state: Tree,
    camera: Camera,
    bodies: list[Body],
    aspect: float,
    pixel: PixelPhysics | None,
    tolerance_e: float,
    full: bool,
) -> tuple[Literal["thinlens", "perspective"], Decision]:
    """Replace the lens by a pinhole if everything in view is in focus and looks the same from every
    point of the lens.
    """
    visible = [body for body in bodies if body.in_view(camera, aspect)]
    blur_um = max((greatest_blur_um(camera, body) for body in visible), default=0.0)
    blur = "shapes of unknown size or at the lens"
    if math.isfinite(blur_um):
        blur = f"blur up to {blur_um:.3g} µm"

    side_um = pixel.aperture_side_um if pixel else 1.0
    error = BLURRED_EDGE * blur_um / side_um
    glossy = [node.plugin for _, node in nodes_of(state, "BSDF") if node.plugin not in LAMBERTIAN]
    emitters = {node.plugin for _, node in nodes_of(state, "Emitter")}
    if full:
        reason = f"nothing left out ({blur})"
    elif nodes_of(state, "Medium"):
        reason = "a medium"
    elif glossy:
        reason = f"'{glossy[0]}' looks different across the lens; {blur}"
    elif not emitters <= set(_DIFFUSE_EMITTERS):
        reason = "a picture at infinity, or an emitter that is not diffuse"
    elif error > tolerance_e * BLUR_SHARE:
        reason = f"not all in focus: {blur}; more samples reduce the noise"
    else:
        reason = f"everything in view is diffuse and in focus ({blur})"
        return "perspective", Decision("lens samples", False, reason, "2 of 5 dimensions", error)
    return "thinlens", Decision("lens samples", True, reason)


def lone_chart(
    state: Tree, camera: Camera, bodies: list[Body], shape: tuple[int, int]
) -> Chart | None:
    """Return the chart if the scene is one flat emitter that faces the lens upright, centred, and
    fills the film.
    """
    emitters = nodes_of(state, "Emitter")
    if len(bodies) != 1 or len(emitters) != 1 or emitters[0][1].plugin != "area":
        return None

    # Geometry
    body = bodies[0]
    half_m = _facing_half_m(state, body)
    if half_m is None:
        return None
    view_m = _half_view_m(camera, body, shape)
    if view_m[0] > half_m[0] * (1 + _ALIGNED) or view_m[1] > half_m[1] * (1 + _ALIGNED):
        return None

    # Texels. Rows of a film run down, columns to the right; y of the camera's frame points up, x to
    # the left.
    picture = emitted_picture(state, emitters[0][1])
    if picture is None:
        return None
    assert body.corners is not None
    assert body.normal is not None
    up = body.corners[1] - body.corners[0]
    across = body.corners[2] - body.corners[0]
    row_step = -1 if up[1] * picture.along_v > 0 else 1
    column_step = -1 if across[0] * picture.along_u > 0 else 1
    texels = picture.texels[::row_step, ::column_step]
    rows_per_sample, columns_per_sample = (
        view / half * n / samples
        for view, half, n, samples in zip(view_m, half_m, texels.shape, shape, strict=True)
    )

    # A chart that is not seen has no known picture beyond its sides.
    hides_emitters = any(
        node.get("hide_emitters", False) for _, node in nodes_of(state, "Integrator")
    )
    is_seen = body.normal[2] < 0 and not hides_emitters
    return Chart(
        texels=np.ascontiguousarray(texels),
        texels_per_sample=(rows_per_sample, columns_per_sample),
        shape=shape,
        beyond=picture.beyond if is_seen else None,
        source=f"{picture.source} {(row_step, column_step)}" if picture.source else "",
        nearest=picture.nearest,
    )


def _facing_half_m(state: Tree, body: Body) -> tuple[float, float] | None:
    """Return half the height and width of a rectangle that faces the lens upright and centred, m,
    or None for other shapes.
    """
    if state.nodes[body.node].plugin != FLAT[0] or body.corners is None or body.normal is None:
        return None

    half_m = float(np.ptp(body.corners[:, 1])) / 2, float(np.ptp(body.corners[:, 0])) / 2
    tolerance_m = _ALIGNED * min(half_m)
    middle = body.corners.mean(axis=0)
    up = body.corners[1] - body.corners[0]
    across = body.corners[2] - body.corners[0]

    is_upright = max(abs(up[0]), abs(across[1])) <= tolerance_m
    is_centred = max(abs(middle[0]), abs(middle[1])) <= tolerance_m
    faces_lens = abs(body.normal[2]) > 1 - 1e-9
    return half_m if is_upright and is_centred and faces_lens else None


def _half_view_m(camera: Camera, body: Body, shape: tuple[int, int]) -> tuple[float, float]:
    """Return half the height and width of the view at the middle of a shape, m.

    shape : (H, W) of the film
    """
    assert body.corners is not None
    tangent = camera.die_mm / (2 * camera.image_distance_mm)
    depth_m = float(body.corners[:, 2].mean())
    return tangent * depth_m * shape[0] / shape[1], tangent * depth_m


def ends_with_film(
    state: Tree, camera: Camera, bodies: list[Body], shape: tuple[int, int]
) -> tuple[bool, bool]:
    """Return whether a scene ends where the film ends, above and below, and at the left and the
    right.

    It does so if it is one rectangle, as large as the view, with nothing behind it. Such a
    rectangle is the picture, whose author does not mean a black world beyond it.
    """
    emitters = {node.plugin for _, node in nodes_of(state, "Emitter")}
    if len(bodies) != 1 or emitters & BACKGROUNDS:
        return False, False
    half_m = _facing_half_m(state, bodies[0])
    if half_m is None:
        return False, False

    view_m = _half_view_m(camera, bodies[0], shape)
    return abs(view_m[0] / half_m[0] - 1) <= ENDS, abs(view_m[1] / half_m[1] - 1) <= ENDS


def decide_samples(
    chart: Chart | None,
    scene_spp: int,
    passes: int,
    full: bool,
    is_stated: bool,
    finer: float = 1.0,
) -> tuple[int, str, Decision]:
    """Return the samples per film cell and pass, the sampler, and the decision.

    A film finer than the scene's divides the same samples among more cells: what counts is the
    noise of a pixel or a dot.

    scene_spp : samples per film cell in the scene
    is_stated : whether an option sets them
    finer : film cells for each cell of the film in the scene's file
    """
    spp = scene_spp
    if full or is_stated:
        reason = f"as set in the {'scene' if full else 'options'}"
    elif chart is None:
        spp = _path_spp(scene_spp, passes, finer)
        reason = "the scene's edges and depth are unknown before rendering"
    elif finer > 1:
        needed_spp = min(scene_spp / finer / _ROUNDED_DOWN, scene_spp)
        spp = next(
            count for count in (MIN_CHART_SPP, *SAMPLE_COUNTS, scene_spp) if count >= needed_spp
        )
        reason = f"those of the scene are shared by the {finer:.3g} cells of this finer film"
    elif chart.uniform:
        spp = min(SAMPLE_COUNTS[0], scene_spp)
        reason = "the chart is uniform"
    else:
        reason = "as set in the scene"

    sampler = "multijitter"
    if chart is None and not full and spp < MIN_MULTIJITTER_SPP and spp <= scene_spp:
        sampler = "independent"
        reason += "; of so few, multijitter would be biased"

    is_unchanged = spp >= scene_spp
    saved = "" if is_unchanged else f"{spp} of {scene_spp} samples per pass"
    reason = f"{spp} per film cell and pass: {reason}"
    return spp, sampler, Decision(TEXTURE_SAMPLES, is_unchanged, reason, saved)


def _path_spp(scene_spp: int, passes: int, finer: float) -> int:
    """Return the samples per film cell and pass of a scene in which paths are traced.

    Passes have different seeds, and the sum over bands averages their noise. More samples are added
    where the noise asks for them.
    """
    min_spp = MIN_MULTIJITTER_SPP if finer <= 1 else MIN_PATH_SPP
    needed_spp = max(scene_spp / passes, min_spp) if finer <= 1 else min_spp
    if needed_spp >= scene_spp:
        return max(scene_spp, min_spp)
    counts = (MIN_PATH_SPP, *SAMPLE_COUNTS)
    return min(next((count for count in counts if count >= needed_spp), scene_spp), scene_spp)


def decide_diffraction(
    chart: Chart | None,
    camera: Camera,
    pitch_um: float,
    tolerance_e: float,
    full: bool,
    longest_nm: float = HIGH_NM,
) -> Decision:
    """Leave out diffraction if it changes no sample of a chart by more than its share, at the
    longest wavelength.
    """
    disc_um = _AIRY_DIAMETER * longest_nm / 1e3 * camera.effective_f_number
    reason = f"Airy disc up to {disc_um:.3g} µm"
    if full:
        return Decision("diffraction", True, reason)
    if chart is None:
        return Decision("diffraction", True, f"{reason}; its effect is unknown before rendering")

    allowed = tolerance_e * _DIFFRACTION_SHARE
    effect = diffraction_effect(chart, pitch_um, longest_nm, camera.effective_f_number, allowed)
    if effect > allowed:
        reason += f"; changes a sample of this chart by {percent(effect, 1)}"
        return Decision("diffraction", True, reason)
    reason += f"; changes no sample of this chart by more than {effect:.1e}"
    return Decision("diffraction", False, reason, "2 transforms", effect)
