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
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.arrays import Array, in_threads, strips
from pixsim.base.digits import percent
from pixsim.base.mapped import release, zeros
from pixsim.base.records import content_hash
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

# Sample counts, besides 1 and 2, for which pictures are the same bit for bit on any number of
# threads.
SAMPLE_COUNTS = (4, 16, 64, 256, 1024)
_ROUNDED_DOWN = 1.5  # to a sample count that is smaller by this factor at most
TRIED_SIDE = 512  # samples of a part of the film, where a chart that diffraction changes shows it
BORDER = 64  # samples of a part that reflection at its sides may change
RESOLVED = 0.999  # of the variance of a chart, in the frequencies that a film has to resolve
_SPECTRUM_LINES = 128  # of a texture, whose spectrum is computed
_DARKEST = 0.01  # of the brightest cell; errors of darker cells are relative to this


@dataclass(frozen=True)
class Chart:
    """A chart that fills the film, linear between the centres of its texels or even over each of
    them, as Mitsuba takes it.

    texels : (rows, columns), as the film shows them: from the top left
    texels_per_sample : (vertical, horizontal) texels per sample of the film
    shape : (H, W) of the film
    beyond : what continues the texels beyond their sides, a mode of `np.pad`; None if it is not
        known how Mitsuba takes them
    source : what tells its texels from those of other charts, if that is known, such as a hash of
        their file
    nearest : whether each texel is even
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
            self._shown(_cell_weights(count, n, per_sample, which, self.nearest), n)
            for count, n, per_sample, which in zip(
                self.shape, self.texels.shape, self.texels_per_sample, part, strict=True
            )
        )
        texels = self.texels[np.ix_(rows, columns)]
        picture: Array = zeros((down.shape[0], across.shape[0]))

        def compute(rows: slice) -> None:
            picture[rows] = (across @ (down[rows] @ texels).T).T
            release(picture[rows])

        in_threads(
            compute, strips(*picture.shape), picture.size
        )  # the matrices are sparse; strips save memory
        return picture

    def _shown(self, weights: csr_array, n: int) -> tuple[csr_array, NDArray[np.intp]]:
        """Return the weights of those of n texels along an axis that cells show, and their numbers.

        weights : (cells, n + 2), the first and the last of the texels beyond the sides
        """
        first, last = (weights.indices.min(), weights.indices.max()) if weights.nnz else (0, 0)
        numbers = np.arange(first, last + 1) - 1
        return weights[:, first : last + 1], numbers % n if self.beyond == "wrap" else np.clip(
            numbers, 0, n - 1
        )

    @cached_property
    def digest(self) -> bytes:
        """Hash of its content."""
        geometry = repr(
            (self.texels.shape, self.texels_per_sample, self.shape, self.beyond, self.nearest)
        ).encode()
        if self.source:  # texels of 32 MB take 40 ms, in each plan of a study with many lights
            return self.source.encode() + geometry
        return (
            hashlib.blake2b(np.ascontiguousarray(self.texels).data, digest_size=16).digest()
            + geometry
        )

    @property
    def details(self) -> float:
        """Half periods of the chart's finest detail across the film: frequencies up to it have
        `RESOLVED` of the variance.

        The steps between even texels have all frequencies.
        """
        return math.inf if self.nearest and not self.uniform else finest_detail(self)

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
def finest_detail(chart: Chart) -> float:
    """Return `Chart.details`."""
    if chart.uniform:
        return 1.0
    details = []
    for axis, n in enumerate(chart.texels.shape):
        lines = np.moveaxis(chart.texels, axis, 1)
        lines = lines[:: max(1, len(lines) // _SPECTRUM_LINES)]
        # Mirrored, so that the ends meet; the frequency of index k is k/2 periods per length.
        power = (np.abs(np.fft.rfft(np.concatenate([lines, lines[:, ::-1]], axis=1))) ** 2).sum(
            axis=0
        )[1:]
        if not power.sum() > 0:
            continue
        halves = 1 + int(np.searchsorted(np.cumsum(power) / power.sum(), RESOLVED))
        samples = n / chart.texels_per_sample[axis]  # that the whole texture would cover
        details.append(halves / samples * chart.shape[1])
    return max(details, default=1.0)


def _cell_weights(
    count: int, n: int, texels_per_sample: float, which: slice, nearest: bool = False
) -> csr_array:
    """Return the weights of texels in the means of film cells along one axis, a sparse matrix
    (cells, n + 2).

    Between the centres of texels, the chart is linear: a texel's value is weighted with the
    integral of a tent of unit area. Of an even one it is that of a box.

    count, n : of cells and texels; column 0 and the last are the texels beyond the sides
    which : cells to return
    """
    from scipy.sparse import csr_array  # imported here, since it takes time

    covered = texels_per_sample * count
    if covered <= n * (1 + _ALIGNED):
        covered = min(covered, n)
    first, stop, _ = which.indices(count)
    edges = (
        (n - covered) / 2 + covered * np.arange(first, stop + 1) / count + 0.5
    )  # the centre of texel i is at i + 1
    edges = np.clip(edges, 0.5, n + 0.5)  # where the chart ends
    low, high = edges[:-1, None], edges[1:, None]
    touched = np.floor(low).astype(int) + np.arange(math.ceil(covered / count) + 2)

    def below(edge: Array) -> Array:
        """Area of each tent or box below an edge."""
        if nearest:
            return np.clip(edge - touched, -0.5, 0.5)
        side = np.clip(edge - touched, -1.0, 1.0)
        return np.where(side < 0, (1 + side) ** 2, 2 - (1 - side) ** 2) / 2

    weights = (below(high) - below(low)) * (count / covered)
    inside = (weights != 0) & (touched < n + 2)
    rows = np.broadcast_to(np.arange(stop - first)[:, None], weights.shape)
    return csr_array(
        (weights[inside], (rows[inside], touched[inside])), shape=(stop - first, n + 2)
    )


@_by_content
def diffraction_effect(
    chart: Chart, pitch_um: float, wavelength_nm: float, f_number: float, enough: float = math.inf
) -> float:
    """Return the largest relative change of any sample by diffraction, at the full resolution of
    the film.

    On a film larger than `TRIED_SIDE` a part around the chart's steepest texels is tested first. If
    its change exceeds `enough`, that is the result.
    """
    if chart.uniform:
        return 0.0

    def change(part: tuple[slice, slice], border: int) -> float:
        picture = chart.picture(part)
        blurred = diffract(picture, pitch_um, np.array([wavelength_nm]), np.ones(1), f_number)
        inner = tuple(
            slice(border, -border) if n > 2 * border > 0 else WHOLE for n in picture.shape
        )
        return float(
            (np.abs(blurred - picture) / np.maximum(picture, _DARKEST * picture.max()))[inner].max()
        )

    if (
        max(chart.shape) > TRIED_SIDE
        and enough < math.inf
        and (effect := change(_steepest(chart), BORDER)) > enough
    ):
        return effect
    return change((WHOLE, WHOLE), 0)


def _steepest(chart: Chart) -> tuple[slice, slice]:
    """Return a part of the film, at most `TRIED_SIDE` samples a side, around the largest step
    between texels.
    """
    steps = [np.abs(np.diff(chart.texels, axis=axis)) for axis in (0, 1)]
    place = max((step for step in steps if step.size), key=lambda step: float(step.max()))
    at = np.unravel_index(int(place.argmax()), place.shape)
    part = []
    for index, n, covered, film in zip(
        at, chart.texels.shape, chart.texels_per_sample, chart.shape, strict=True
    ):
        middle = round((index + 1 - (n - covered * film) / 2) / covered)
        first = min(max(middle - TRIED_SIDE // 2, 0), max(film - TRIED_SIDE, 0))
        part.append(slice(first, min(first + TRIED_SIDE, film)))
    return part[0], part[1]


TEXTURE_SAMPLES = "texture samples"  # subject of a decision
TOLERANCE_E = 1e-3  # relative error of the mean electrons
BLUR_SHARE, DIFFRACTION_SHARE = 0.1, 0.1  # of the tolerance, for leaving out blur and diffraction
# A blur disc of diameter c moves 2c/(3π) of the light across an edge, which is at the centre of a
# pixel on average.
BLURRED_EDGE = 2 / (3 * math.pi)
_AIRY_DIAMETER = 2.44  # first dark ring over λN (Goodman)
_UNLIMITED = -1
# On a film finer than the scene's: of a chart, stratified, with an eighth of the noise of one; of a
# path, independent.
MIN_CHART_SPP, MIN_PATH_SPP = 2, 4
# samples; with 4, multijitter correlates the dimensions of a path (still_life: 0.8 % too dark)
_MIN_MULTIJITTER_SPP = 16
# of a chart's half width: where files round its size or the camera's angle, it still ends with the
# film
ENDS = 1e-4
_ALIGNED = 1e-6  # of a chart's half width: tolerance for its position, rotation and size
# Emitters that look the same from every point of the lens, or cannot be seen.
ALIKE = ("area", "constant", "point", "spot", "directional", "projector")
BACKGROUNDS = frozenset(("constant", "envmap", "sunsky", "sky"))  # seen beyond all shapes


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
    max_depth = next(
        (int(node.get("max_depth", _UNLIMITED)) for _, node in nodes_of(state, "Integrator")),
        _UNLIMITED,
    )
    allowed = "any number" if max_depth < 0 else f"{max(max_depth - 1, 0)}"
    max_surfaces = _UNLIMITED if max_depth < 0 else max(max_depth - 1, 0)
    if full:
        return None, max_surfaces, Decision("bounces", True, f"as set in the scene: {allowed}")
    paths = [node for _, node in nodes_of(state, "Integrator")]
    names = [node.plugin for node in paths] or ["path"]
    if names != ["path"] or max_depth in (0, 1) or nodes_of(state, "Medium"):
        return (
            None,
            1 if names == ["direct"] else max_surfaces,
            Decision("bounces", True, f"the scene's integrator, '{names[0]}'"),
        )
    hidden = {"hide_emitters": True} if paths and paths[0].get("hide_emitters", False) else {}
    emitters = {index for index, _ in nodes_of(state, "Emitter")}
    shining = {
        index
        for index, node in nodes_of(state, "Shape")
        if emitters & set(children(node, state).values())
    }
    alone = len(bodies) == 1 and len(emitters) == 1 and bodies[0].node in shining
    if alone and bodies[0].normal is not None:
        reason = "a flat emitter alone: its light goes straight to the lens"
        return (
            {"type": "path", "max_depth": 1, **hidden},
            0,
            Decision("bounces", False, reason, f"all of {allowed}"),
        )
    direct = {"type": "direct", **hidden}
    if max_depth == 2:
        return (
            direct,
            1,
            Decision(
                "bounces",
                False,
                "one, as set in the scene: no loop over bounces",
                "a third of the time",
            ),
        )
    matt = all(node.plugin == "diffuse" for _, node in nodes_of(state, "BSDF")) and not shining
    if matt and bodies and face_one_way(bodies):
        reason = "flat, one-sided, diffuse surfaces that face the same way do not light each other"
        return direct, 1, Decision("bounces", False, reason, f"all but 1 of {allowed}")
    return (
        None,
        max_surfaces,
        Decision("bounces", True, f"surfaces may light each other; as set in the scene: {allowed}"),
    )


def irregular_tables(state: Tree) -> dict[tuple[int, str], tuple[Spectrum, Array]]:
    """Return (node, property) -> (table, values at equal steps) of the surface tables that allow
    equal steps.
    """
    tables = {}
    for index, node in enumerate(state.nodes):
        if node.kind not in ("BSDF", "Texture"):
            continue
        for name in node:
            if node.kind_of(name) == "Spectrum" and not node[name].uniform:
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
        return False, Decision(
            "spectrum tables", True, "unchanged" if full else "none with equal steps"
        )
    return True, Decision(
        "spectrum tables", False, f"{count} with equal steps: looked up by index", "the searches"
    )


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
    blur = max((greatest_blur_um(camera, body) for body in visible), default=0.0)
    side_um = pixel.aperture_side_um if pixel else 1.0
    blur_text = (
        f"blur up to {blur:.3g} µm"
        if math.isfinite(blur)
        else "shapes of unknown size or at the lens"
    )
    if full:
        return "thinlens", Decision("lens samples", True, f"nothing left out ({blur_text})")
    if nodes_of(state, "Medium"):
        return "thinlens", Decision("lens samples", True, "a medium")
    coloured = [node.plugin for _, node in nodes_of(state, "BSDF") if node.plugin not in LAMBERTIAN]
    distant = [node.plugin for _, node in nodes_of(state, "Emitter")]
    if coloured:
        return "thinlens", Decision(
            "lens samples", True, f"'{coloured[0]}' looks different across the lens; {blur_text}"
        )
    if not set(distant) <= set(ALIKE):
        return "thinlens", Decision(
            "lens samples", True, "a picture at infinity, or an emitter that is not diffuse"
        )
    error = BLURRED_EDGE * blur / side_um
    if error > tolerance_e * BLUR_SHARE:
        return "thinlens", Decision(
            "lens samples", True, f"not all in focus: {blur_text}; more samples reduce the noise"
        )
    reason = f"everything in view is diffuse and in focus ({blur_text})"
    return "perspective", Decision("lens samples", False, reason, "2 of 5 dimensions", error)


def lone_chart(
    state: Tree, camera: Camera, bodies: list[Body], shape: tuple[int, int]
) -> Chart | None:
    """Return the chart if the scene is one flat emitter that faces the lens upright, centred, and
    fills the film.
    """
    emitters = nodes_of(state, "Emitter")
    if len(bodies) != 1 or len(emitters) != 1 or emitters[0][1].plugin != "area":
        return None
    body = bodies[0]
    if (half := _facing_half(state, body)) is None:
        return None
    view = _view(camera, body, shape)
    if not all(v <= h * (1 + _ALIGNED) for v, h in zip(view, half, strict=True)):
        return None
    picture = emitted_picture(state, emitters[0][1])
    if picture is None:
        return None
    assert body.corners is not None
    assert body.normal is not None
    up, across = body.corners[1] - body.corners[0], body.corners[2] - body.corners[0]
    # Rows of a film run down, columns to the right; y of the camera's frame points up, x to the
    # left.
    turns = -1 if up[1] * picture.along_v > 0 else 1, -1 if across[0] * picture.along_u > 0 else 1
    texels = picture.texels[:: turns[0], :: turns[1]]
    per_sample = tuple(
        v / h * n / film for v, h, n, film in zip(view, half, texels.shape, shape, strict=True)
    )
    seen = body.normal[2] < 0 and not any(
        n.get("hide_emitters", False) for _, n in nodes_of(state, "Integrator")
    )
    source = f"{picture.source} {turns}" if picture.source else ""
    beyond = picture.beyond if seen else None
    return Chart(
        np.ascontiguousarray(texels),
        (per_sample[0], per_sample[1]),
        shape,
        beyond,
        source,
        picture.nearest,
    )


def _facing_half(state: Tree, body: Body) -> tuple[float, float] | None:
    """Return half the height and width, m, of a rectangle that faces the lens upright and centred;
    None for other shapes.
    """
    if state.nodes[body.node].plugin != FLAT[0] or body.corners is None or body.normal is None:
        return None
    half = float(np.ptp(body.corners[:, 1])) / 2, float(np.ptp(body.corners[:, 0])) / 2
    middle = body.corners.mean(axis=0)
    up, across = body.corners[1] - body.corners[0], body.corners[2] - body.corners[0]
    upright = max(abs(up[0]), abs(across[1])) <= _ALIGNED * min(half)
    centred = max(abs(middle[0]), abs(middle[1])) <= _ALIGNED * min(half)
    return half if upright and centred and abs(body.normal[2]) > 1 - 1e-9 else None


def _view(camera: Camera, body: Body, shape: tuple[int, int]) -> tuple[float, float]:
    """Return half the height and width of the view at the middle of a shape, m."""
    assert body.corners is not None
    tangent, depth = (
        camera.die_mm / (2 * camera.image_distance_mm),
        float(body.corners[:, 2].mean()),
    )
    return tangent * depth * shape[0] / shape[1], tangent * depth


def ends_with_film(
    state: Tree, camera: Camera, bodies: list[Body], shape: tuple[int, int]
) -> tuple[bool, bool]:
    """Return whether a scene ends where the film ends, above and below, and at the left and the
    right.

    It does so if it is one rectangle, as large as the view, with nothing behind it. Such a
    rectangle is the picture: that the world is black beyond it is not what anybody means.
    """
    names = [node.plugin for _, node in nodes_of(state, "Emitter")]
    if (
        len(bodies) != 1
        or set(names) & BACKGROUNDS
        or (half := _facing_half(state, bodies[0])) is None
    ):
        return False, False
    above, beside = (
        abs(v / h - 1) <= ENDS for v, h in zip(_view(camera, bodies[0], shape), half, strict=True)
    )
    return above, beside


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

    scene_spp : samples in the scene
    finer : film cells for each cell of the scene's own film
    """
    if full or is_stated:
        spp = scene_spp
        reason = f"as set in the {'scene' if full else 'options'}"
    elif chart is None:
        # Passes have different seeds, and the sum over bands averages their noise. More are added
        # where the noise asks for them.
        lowest_spp = _MIN_MULTIJITTER_SPP if finer <= 1 else MIN_PATH_SPP
        min_spp = max(scene_spp / passes, lowest_spp) if finer <= 1 else lowest_spp
        spp = (
            min(next((count for count in SAMPLE_COUNTS if count >= min_spp), scene_spp), scene_spp)
            if min_spp < scene_spp
            else max(scene_spp, lowest_spp)
        )
        reason = "the scene's edges and depth are unknown before rendering"
    elif finer > 1:
        min_spp = min(scene_spp / finer / _ROUNDED_DOWN, scene_spp)
        spp = next(
            count for count in (MIN_CHART_SPP, *SAMPLE_COUNTS, scene_spp) if count >= min_spp
        )
        reason = f"those of the scene are shared by the {finer:.3g} cells of this finer film"
    else:
        spp = min(SAMPLE_COUNTS[0], scene_spp) if chart.uniform else scene_spp
        reason = "the chart is uniform" if chart.uniform else "as set in the scene"

    sampler = "multijitter"
    if chart is None and not full and spp < _MIN_MULTIJITTER_SPP and spp <= scene_spp:
        sampler = "independent"
        reason += "; of so few, multijitter would be biased"
    saved = f"{spp} of {scene_spp} samples per pass" if spp < scene_spp else ""
    return (
        spp,
        sampler,
        Decision(
            TEXTURE_SAMPLES, spp >= scene_spp, f"{spp} per film cell and pass: {reason}", saved
        ),
    )


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
    if chart is None or full:
        return Decision(
            "diffraction",
            True,
            f"{reason}; its effect is unknown before rendering" if not full else reason,
        )
    allowed = tolerance_e * DIFFRACTION_SHARE
    effect = diffraction_effect(chart, pitch_um, longest_nm, camera.effective_f_number, allowed)
    if effect > allowed:
        return Decision(
            "diffraction", True, f"{reason}; changes a sample of this chart by {percent(effect, 1)}"
        )
    reason += f"; changes no sample of this chart by more than {effect:.1e}"
    return Decision("diffraction", False, reason, "2 transforms", effect)
