"""Build an inspected scene in Mitsuba and trace it: what a render does inside Mitsuba, in this
process or in a child of it.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.lazy import cached_property
from pixsim.scene.job import MESHES, WAVELENGTHS, Lamps, Passes, TraceJob
from pixsim.scene.mitsuba import drjit, mitsuba_session, parse
from pixsim.scene.textures import is_exr
from pixsim.scene.tree import REFERENCES, Tree, children, nodes_of, tree_of

if TYPE_CHECKING:
    from mitsuba import (
        Float,
        Point2f,
        RayDifferential3f,
        Sampler,
        SamplingIntegrator,
        Scene,
        Sensor,
        Spectrum,
        UInt32,
        Vector2f,
    )
    from mitsuba.parser import ParserConfig, ParserState

# Fixed, since Mitsuba would choose blocks, and with them seeds, by the number of threads.
_SCALAR_BLOCK = 32
# Properties that the camera states.
OF_THE_LENS = ("focal_length", "fov_axis", "aperture_radius", "focus_distance")


# Scenes and integrators of the last job, and what they depend on
_loaded: tuple[tuple[object, ...], list[tuple[Scene, SamplingIntegrator]]] | None = None


class InProcessTracer:
    """Traces in this process."""

    def __init__(self, job: TraceJob) -> None:
        self.job = job
        # The last sensor, and what describes it
        self._sensor: tuple[Sensor, object] | None = None
        # Tables in Mitsuba, of the passes of each scene
        self._tables: dict[int, tuple[UInt32, Float, Float, Float]] = {}

    @property
    def _scalar(self) -> bool:
        return self.job.variant.startswith("scalar")

    @property
    def loaded(self) -> list[tuple[Scene, SamplingIntegrator]]:
        """Mitsuba's scene and integrator for each group of lamps, taken from the last job in this
        process where it has the same.

        A kernel holds what all scenes in memory are made of, so that others beside them would make
        it larger and another one.
        """
        global _loaded
        if _loaded is None or _loaded[0] != self.job.scenes_key:
            _loaded = None
            with mitsuba_session(self.job.variant) as mi:
                scenes = [self._build(mi, lamps) for lamps in self.job.lamps]
                pairs = [(scene, self._integrator(mi, scene)) for scene in scenes]
                _loaded = self.job.scenes_key, pairs
        return _loaded[1]

    @cached_property
    def _lens(self) -> dict[str, Any]:
        """The scene's sensor with the lens of the job, without sampler and film."""
        props = parse(self.job.text, self.job.variant).nodes[self.job.sensor].props
        names = [
            key
            for key in props.keys()  # noqa: SIM118
            if key not in OF_THE_LENS and props.type(key).name not in REFERENCES
        ]
        return {key: props[key] for key in names} | self.job.lens

    def _build(self, mi: ModuleType, lamps: Lamps | None) -> Scene:
        """Build the scene, with some emitters only, each as its neutral picture or power.

        lamps : that shine. None leaves all as they are
        """
        state = parse(self.job.text, self.job.variant)
        tree = tree_of(state)
        if lamps:
            _keep_lamps(mi, state, tree, lamps)
        for index, node in nodes_of(tree, "Integrator"):
            if self._scalar and "block_size" not in node:
                state.nodes[index].props["block_size"] = _SCALAR_BLOCK
        for index, name, table in self.job.tables:
            state.nodes[index].props[name] = mi.load_dict(table)

        config = mi.parser.ParserConfig(self.job.variant)
        mi.parser.transform_all(config, state)
        built = _instantiated(mi, config, state)
        if isinstance(built, list):
            return next(item for item in built if isinstance(item, mi.Scene))
        return built

    def _integrator(self, mi: ModuleType, scene: Scene) -> SamplingIntegrator:
        scene_integrator: Any = None if self.job.integrator else scene.integrator()
        if scene_integrator:
            return scene_integrator
        default = {"type": "path", "block_size": _SCALAR_BLOCK}
        return mi.load_dict(default | (self.job.integrator or {}))

    def sample_count(self, sampler: str, samples: int) -> int:
        """Return the samples that a sampler takes where a render needs `samples`."""
        with mitsuba_session(self.job.variant) as mi:
            return int(mi.load_dict({"type": sampler, "sample_count": samples}).sample_count())

    def trace(
        self, scene: int, film: dict[str, Any], sampler: str, spp: int, seed: int
    ) -> NDArray[np.float32]:
        """Return a picture (rows, columns, channels) of a scene of the job; `film` describes the
        plugin.
        """
        with mitsuba_session(self.job.variant) as mi:
            sensor = self._sensor_with(mi, film, sampler, spp)
            world, integrator = self.loaded[scene]
            picture = mi.render(world, sensor=sensor, integrator=integrator, spp=spp, seed=seed)
            return np.array(picture, np.float32)

    def _sensor_with(self, mi: ModuleType, film: dict[str, Any], sampler: str, spp: int) -> Sensor:
        description = film, sampler, spp
        if self._sensor is None or self._sensor[1] != description:
            parts = {"sampler": {"type": sampler, "sample_count": spp}, "film": film}
            self._sensor = mi.load_dict(self._lens | parts), description
        return self._sensor[0]

    def _whole_film(self) -> dict[str, Any]:
        """Describe the film of passes that are traced together."""
        height, width = self.job.size
        return {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}

    def trace_together(
        self,
        scene: int,
        rows: tuple[int, int],
        sampler: str,
        spp: int,
        seed: int,
        block_cells: int = 1,
    ) -> NDArray[np.float32]:
        """Return rows of the pictures of all pulses of a scene's `Passes`, (rows, columns, pulses);
        `spp` of each pass.

        Pulses, passes, rows and seed are data of one kernel: other values compile nothing.

        block_cells : side of the blocks of cells whose samples the sampler stratifies together, of
            all passes: a pixel and an eye see the mean of several cells, which then has less noise.
            1 stratifies the samples of each pass of a cell
        """
        passes, (height, width) = self.job.passes[scene], self.job.size
        assert passes is not None
        with mitsuba_session(self.job.variant) as mi:
            dr = drjit()
            pass_count = len(passes.groups)
            block_samples = block_cells**2 * pass_count * spp
            stratified = block_samples if block_cells > 1 else spp
            sensor = self._sensor_with(mi, self._whole_film(), sampler, stratified)
            world, integrator = self.loaded[scene]
            if scene not in self._tables:
                self._tables[scene] = _tables(mi, passes)
            lanes, shifts, density, share = self._tables[scene]

            # Samples: spp of each pass of each cell, block by block. A sampler may take a few more,
            # which are traced and left out.
            down, across = (-(-cells // block_cells) for cells in (rows[1] - rows[0], width))
            random = sensor.sampler().clone()
            strata = random.sample_count()
            count = down * across * block_samples // stratified * strata
            random.set_samples_per_wavefront(strata)
            random.seed(dr.opaque(mi.UInt32, seed), count)
            index = dr.arange(mi.UInt32, count)
            stratum = index // strata
            sample = stratum * stratified + dr.minimum(index - stratum * strata, stratified - 1)
            sequence = sample // spp
            place = sequence // pass_count
            group = sequence - place * pass_count

            # Their cells; those beyond the film are left out, too.
            block = place // block_cells**2
            in_block = place - block * block_cells**2
            block_row = block // across
            row_in_block = in_block // block_cells
            row = block_row * block_cells + row_in_block
            column = (block - block_row * across) * block_cells + (
                in_block - row_in_block * block_cells
            )
            cell = row * width + column

            # Rays, whose random numbers are drawn in the order of Mitsuba's own integrators.
            corner = mi.Vector2f(column, row + dr.opaque(mi.UInt32, rows[0]))
            offset = _stratified_places(
                mi,
                number=sample - sequence * spp,
                spp=spp,
                group=group,
                count=pass_count,
                cell=cell,
                seed=dr.opaque(mi.UInt32, seed),
                jitter=random.next_2d(),
            )
            on_film = (corner + offset) * mi.ScalarVector2f(1 / width, 1 / height)
            aperture = random.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
            time_s = mi.Float(sensor.shutter_open())
            if sensor.shutter_open_time() > 0:
                time_s += random.next_1d() * sensor.shutter_open_time()
            area = random.next_1d()
            ray, _ = sensor.sample_ray(time_s, mi.Float(0.5), on_film, aperture)

            # Wavelengths: each of the four has a share of the area of its pulse below it.
            wavelengths_nm = []
            for lane in range(WAVELENGTHS):
                pulse = dr.gather(mi.UInt32, lanes, group * WAVELENGTHS + lane)
                shifted = area + dr.gather(mi.Float, shifts, group * WAVELENGTHS + lane)
                below = shifted - dr.floor(shifted)
                wavelengths_nm.append(_wavelength_below(mi, density, share, pulse, below, passes))
            ray.wavelengths = mi.Spectrum(*wavelengths_nm)

            light = _radiance(mi, integrator, world, random, mi.RayDifferential3f(ray))
            dr.eval(light)
            lane_values = [
                np.array(light[lane]).reshape(-1, strata)[:, :stratified].ravel()
                for lane in range(WAVELENGTHS)
            ]
            blocks = passes.means(lane_values, spp).reshape(
                down, across, block_cells, block_cells, -1
            )
            whole = blocks.transpose(0, 2, 1, 3, 4).reshape(
                down * block_cells, across * block_cells, -1
            )
            return whole[: rows[1] - rows[0], :width]

    def depths(self, side: int) -> NDArray[np.float32]:
        """Return depths along the optical axis in m at (side, side, 1) places of the film, seen
        from the middle of the lens.

        They are infinite beyond all shapes, and NaN where a surface shows something at another
        depth: behind it, or in a mirror.
        """
        middles = (np.arange(side) + 0.5) / side
        x, y = (middle.ravel().astype(np.float32) for middle in np.meshgrid(middles, middles))
        with mitsuba_session(self.job.variant) as mi:
            sensor = self._sensor_with(mi, self._whole_film(), "independent", 1)
            world, _ = self.loaded[0]
            if self._scalar:
                places = zip(x.tolist(), y.tolist(), strict=True)
                depth_list = [_depth(mi, world, sensor, mi.Point2f(*place)) for place in places]
                depths_m = np.array(depth_list, np.float32)
            else:
                all_places = mi.Point2f(mi.Float(x), mi.Float(y))
                depths_m = np.array(_depth(mi, world, sensor, all_places), np.float32)
            return depths_m.reshape(side, side, 1)


def _keep_lamps(mi: ModuleType, state: ParserState, tree: Tree, lamps: Lamps) -> None:
    """Remove all emitters but the lamps from a parser state, in place, and put neutral pictures or
    powers in the place of their spectra.

    tree : of the same state
    """
    emitters = [index for index, _ in nodes_of(tree, "Emitter")]
    dark = set(emitters) - lamps.pictures.keys()
    for parser_node, node in zip(state.nodes, tree.nodes, strict=True) if dark else ():
        for name, child in children(node, tree).items():
            if child in dark:
                del parser_node.props[name]
    if not lamps.neutral:
        return

    for index in emitters:
        if index not in lamps.pictures:
            continue
        props = state.nodes[index].props
        name, picture = lamps.pictures[index]
        if isinstance(picture, int):
            props[name] = mi.Properties.ResolvedReference(picture)
        else:  # a plain number would be a d65
            props[name] = mi.load_dict({"type": "uniform", "value": picture})


def _instantiated(mi: ModuleType, config: ParserConfig, state: ParserState) -> Any:
    """Return the objects of a scene's nodes, the same bit for bit each time.

    Mitsuba adds up the normals of a mesh without any in float32 on all threads, in an order that
    varies. So scenes with meshes are built on one thread. There Mitsuba 3.9 would wait for ever for
    an EXR, so these are read before.
    """
    if config.variant.startswith("scalar") or not any(
        node.props.plugin_name() in MESHES for node in state.nodes
    ):
        return mi.parser.instantiate(config, state)

    _read_exrs(mi, state)
    dr = drjit()
    threads = dr.thread_count()
    config.parallel = False
    dr.set_thread_count(1)
    try:
        return mi.parser.instantiate(config, state)
    finally:
        dr.set_thread_count(threads)


def _read_exrs(mi: ModuleType, state: ParserState) -> None:
    """Put the objects of EXR textures, and the pictures of EXR environments, in the place of their
    nodes and files.
    """
    textures: dict[int, object] = {}
    for index, node in enumerate(state.nodes):
        props = node.props
        if props.plugin_name() == "bitmap" and is_exr(props["filename"]):
            textures[index] = mi.load_dict(
                {"type": "bitmap"} | {name: props[name] for name in props.keys()}  # noqa: SIM118
            )
        elif props.plugin_name() == "envmap" and is_exr(props["filename"]):
            props["bitmap"] = mi.Bitmap(props["filename"])
            del props["filename"]

    for node in state.nodes:
        props = node.props
        for name in list(props.keys()):
            if props.type(name).name == "ResolvedReference" and props[name].index() in textures:
                props[name] = textures[props[name].index()]


def _depth(mi: ModuleType, world: Scene, sensor: Sensor, place: Point2f) -> Float:
    """Return the depth at places of the film, 0 to 1, as `InProcessTracer.depths` has it."""
    dr = drjit()
    ray, _ = sensor.sample_ray(
        mi.Float(sensor.shutter_open()), mi.Float(0.5), place, mi.Point2f(0.5)
    )
    hit = world.ray_intersect(mi.Ray3f(ray))
    is_hit = hit.is_valid()
    if mi.variant().startswith("scalar") and not is_hit:  # there is no surface to ask
        return mi.Float(math.inf)

    # A surface that scatters light, and lets none through, is seen where it is.
    kinds = mi.BSDFFlags
    flags = hit.bsdf().flags()
    scatters = mi.has_flag(flags, kinds.Diffuse) | mi.has_flag(flags, kinds.GlossyReflection)
    transmits = mi.has_flag(flags, kinds.Null) | mi.has_flag(flags, kinds.DeltaTransmission)
    transmits |= mi.has_flag(flags, kinds.GlossyTransmission)

    in_camera = sensor.world_transform().inverse() @ hit.p
    depth = dr.select(scatters, dr.select(transmits, math.nan, in_camera.z), math.nan)
    return dr.select(is_hit, depth, math.inf)


def _stratified_places(
    mi: ModuleType,
    *,
    number: UInt32,
    spp: int,
    group: UInt32,
    count: int,
    cell: UInt32,
    seed: UInt32,
    jitter: Point2f,
) -> Vector2f:
    """Return places in film cells, (x, y) from 0 to 1, that are stratified in each pass and over
    all passes together.

    As in Kensler's correlated multi-jittered sampling (Pixar technical memo 13-01), the `spp`
    samples of a pass have one in each part of a cell, and one in each of `spp` rows and columns.
    The `count` passes share out each of these rows and columns.

    number : of a sample in its pass
    group : number of the pass
    """
    # Parts of the cell
    rows = max(divisor for divisor in range(1, math.isqrt(spp) + 1) if spp % divisor == 0)
    columns = spp // rows
    row = number // columns
    column = number - row * columns

    # Rows and columns within the parts, which differ by cell and pass
    shifts = mi.sample_tea_32(cell, seed)
    beside = (row + group + shifts[0]) % rows
    above = (column + group + shifts[1]) % columns
    shares = [
        mi.sample_tea_32(cell * spp + column * rows + beside, shifts[0])[0],
        mi.sample_tea_32(cell * spp + row * columns + above, shifts[1])[0],
    ]
    x, y = (
        (mi.Float((group + share) % count) + offset) / count
        for share, offset in zip(shares, jitter, strict=True)
    )
    return mi.Vector2f(
        (column + (beside + x) / rows) / columns, (row + (above + y) / columns) / rows
    )


def _tables(mi: ModuleType, passes: Passes) -> tuple[UInt32, Float, Float, Float]:
    """Return lanes, shifts, densities and the share of each pulse's area up to each node, as flat
    arrays of Dr.Jit.
    """
    density = passes.densities
    area = np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)
    whole = area[:, -1:]
    share = np.concatenate([np.zeros((len(density), 1)), area / whole], axis=1)

    lanes = mi.UInt32(np.ascontiguousarray(passes.lanes.ravel(), np.uint32))
    shifts, density_of_area, share_of_area = (
        mi.Float(np.ascontiguousarray(array.ravel(), np.float32))
        for array in (passes.shifts, density / whole, share)
    )
    return lanes, shifts, density_of_area, share_of_area


def _wavelength_below(
    mi: ModuleType, density: Float, share: Float, pulse: UInt32, below: Float, passes: Passes
) -> Float:
    """Return the wavelength below which a pulse, linear between its nodes, has a share of its area,
    in nm.

    density : of all pulses, per step: a share of the area, so that it is `share` in a step of
        constant density
    share : of the area below each node
    below : the share to find, 0 to 1
    """
    dr = drjit()
    nodes = passes.nodes
    first = pulse * nodes
    above = dr.binary_search(
        1, nodes - 1, lambda node: dr.gather(mi.Float, share, first + node) <= below
    )
    before = first + above - 1
    left = dr.gather(mi.Float, density, before)
    right = dr.gather(mi.Float, density, before + 1)
    missing = dr.maximum(below - dr.gather(mi.Float, share, before), 0.0)

    # The root of left·x + (right - left)·x²/2 = missing, in the form without cancellation; 0/0
    # where nothing is missing.
    root = left + dr.safe_sqrt(dr.square(left) + 2 * (right - left) * missing)
    inside = dr.select(root > 0, dr.minimum(2 * missing / root, 1.0), 0.0)
    return passes.span.low_nm + passes.step_nm * (mi.Float(above) - 1 + inside)


def _radiance(
    mi: ModuleType,
    integrator: SamplingIntegrator,
    world: Scene,
    sampler: Sampler,
    ray: RayDifferential3f,
) -> Spectrum:
    """Return the radiance at the wavelengths of rays, as the integrator's own render estimates
    it.
    """
    if not isinstance(integrator, mi.ad.integrators.common.ADIntegrator):
        return integrator.sample(world, sampler, ray)[0]
    dr = drjit()
    # Written in Python, for derivatives; they are not asked for.
    nothing = {
        "depth": mi.UInt32(0),
        "δL": None,
        "δaovs": None,
        "state_in": None,
        "active": mi.Bool(True),
    }
    return integrator.sample(
        mode=dr.ADMode.Primal, scene=world, sampler=sampler, ray=ray, **nothing
    )[0]
