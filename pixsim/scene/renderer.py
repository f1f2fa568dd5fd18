"""Render a plan in Mitsuba: radiance on an oversampled film, then spectral irradiance on the sensor
plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.arrays import Array, strips
from pixsim.base.bounds import Whole
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.mapped import release, zeros
from pixsim.base.progress import Progress
from pixsim.base.version import VERSION
from pixsim.light.quantities import (
    EMITTER_SCALE,
    ILLUMINANCE,
    INCIDENCE,
    IRRADIANCE,
    LAMP,
    LUMINANCE,
)
from pixsim.light.spectral import (
    DIFFUSER,
    DIFFUSER_W,
    PART,
    RINGS,
    VISIBLE,
    WHOLE,
    Span,
    SpectralImage,
    Spectrum,
)
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import LENS_HEADER, camera_distortion, rendered_camera
from pixsim.optics.camera_light import camera_factor
from pixsim.optics.lens_defocus import DEPTHS, finite_or_none
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.scene import white_plate
from pixsim.scene.bands import Fit, Pulse
from pixsim.scene.contents import asset_files, warnings_of_skies
from pixsim.scene.guard.child import ChildTracer
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.job import Lamps, OutOfTimeError, Passes, TraceJob, irregular, regular
from pixsim.scene.plan import Plan, WhitePlate, make_render_plan
from pixsim.scene.rules import (
    BACKGROUNDS,
    MIN_MULTIJITTER_SPP,
    MIN_PATH_SPP,
    SAMPLE_COUNTS,
    irregular_tables,
)
from pixsim.scene.scene import Scene, check_resolution, hash_of_tree, is_packaged, sensor_node
from pixsim.scene.tree import Tree, nodes_of, parse_tree
from pixsim.scene.white_plate import dark_plate_error


def film(
    responses: list[dict[str, Any]], size: tuple[int, int], top: int, bottom: int
) -> dict[str, Any]:
    """Describe a specfilm for some rows: float32 with a box filter, so that cells are means and
    runs are reproducible.

    responses : spectral response of each channel
    size : (H, W) of the whole film
    top, bottom : first row, and the row after the last
    """
    height, width = size
    description: dict[str, Any] = {
        "type": "specfilm",
        "width": width,
        "height": height,
        "component_format": "float32",
        "rfilter": {"type": "box"},
        "crop_offset_x": 0,
        "crop_offset_y": int(top),
        "crop_width": width,
        "crop_height": int(bottom - top),
    }
    for channel, response in enumerate(responses):
        description[f"band{channel}"] = response
    return description


def film_response(pulse: Pulse) -> dict[str, Any]:
    """Describe a pulse as the spectral response of a film's channel."""
    return regular(pulse.low_nm, pulse.high_nm, pulse.values)


def shared_passes(fit: Fit, span: Span = VISIBLE, fewest: int = 2) -> Passes | None:
    """Return the passes of a light that are traced together, or None if there are too few."""
    if len(fit.passes) < fewest:
        return None
    step_nm = fit.pulses[0].step_nm
    pulses = tuple(
        (round((pulse.low_nm - span.low_nm) / step_nm), tuple(pulse.values.tolist()))
        for pulse in fit.pulses
    )
    return Passes(step_nm, pulses, tuple(map(tuple, fit.passes)), span)


Pictures = list[NDArray[np.float32]]
KIND = "render"


def _hash_of_job(scene: Scene, state: Tree, camera: Camera, plan: Plan, seed: int) -> str:
    """Return a hash of all that a job's runs depend on; pixel and display act by the plan.

    state : parsed for the camera
    """
    lights = []
    for light in plan.light.lamps:
        pulses = [
            [pulse.low_nm, pulse.high_nm, pulse.values.tolist()] for pulse in light.fit.pulses
        ]
        is_unknown = light.lamp.spectrum is None
        pictures = sorted(light.lamp.pictures.items())
        lights.append([is_unknown, pictures, pulses, light.fit.passes])

    samples = plan.samples
    settings: list[Any] = [
        samples.lens,
        samples.integrator,
        samples.spp,
        samples.sampler,
        plan.light.regular_tables,
    ]
    shape = scene.film_shape(camera, state)
    margin = plan.film.margin(shape, 1e3 * camera.die_mm / shape[1])
    if margin:
        settings += [margin, *plan.film.ends]
    for index, name, table in plan.light.held:
        settings.append([index, name, table.nodes_nm.tolist(), table.values.tolist()])
    return content_hash(
        [
            hash_of_tree(state),
            shape,
            scene.sensor_id,
            scene.choice.variant,
            camera.without_veil.model_dump(),
            lights,
            settings,
            seed,
            cache.version_fingerprint("mitsuba", "drjit"),
        ]
    )


class CachedRenders:
    """The cached runs of one job: the first ones, as many as fit into the cache's share of one
    entry.

    job : hash of all that its runs depend on
    """

    def __init__(self, job: str) -> None:
        self.job = job
        self.size_bytes = 0

    def find(self, index: int, level: int) -> tuple[Pictures, int] | None:
        """Return the pictures of a run and its samples per film cell, or None."""
        content = cache.arrays(KIND, self._key(index, level))
        if content is None:
            return None
        pictures = [content[f"light{number}"] for number in range(len(content) - 1)]
        self.size_bytes += sum(picture.nbytes for picture in pictures)
        return pictures, int(content["spp"])

    def store(self, index: int, level: int, pictures: Pictures, spp: int) -> None:
        self.size_bytes += sum(picture.nbytes for picture in pictures)
        if not cache.has_room(self.size_bytes):
            return
        content: dict[str, NDArray[Any]] = {"spp": np.array(spp)}
        for number, picture in enumerate(pictures):
            content[f"light{number}"] = picture
        cache.store_arrays(KIND, self._key(index, level), content)

    def runs_in_time(self, limits: str) -> int | None:
        """Return the number of runs after which time ran out under the same limits, or None; the
        clock is not reproducible.

        limits : hash of them
        """
        content = cache.arrays(KIND, f"{self.job}-{limits}")
        return None if content is None else int(content["runs"])

    def store_runs_in_time(self, limits: str, runs: int) -> None:
        cache.store_arrays(KIND, f"{self.job}-{limits}", {"runs": np.array(runs)})

    def _key(self, index: int, level: int) -> str:
        return f"{self.job}-{level}-{index}"


Picture = NDArray[np.float32] | Array
# Samples per kernel, about 1.5 s on two cores; Ctrl-C and progress are handled between kernels.
_SAMPLES_PER_KERNEL = 1 << 25
# Of passes in one kernel: their light takes 16 bytes a sample, and a path more time than a chart.
_SAMPLES_TOGETHER = 1 << 22
# The samples of so many cells down and across are stratified together, where a cell has few.
_BLOCK_CELLS = 4
# Limits the memory of the sums, in float32 and float64; fewer samples than 4 in a cell are rare.
_CELLS_PER_KERNEL = 1 << 23
_SCALAR_STRIPS = 16
# Of scalar variants; with fewer, the start of a render takes longer than the samples.
_SAMPLES_PER_STRIP = 1 << 16
# Mitsuba's float32 sums drift by 1e-5 at 65 536; more samples are averaged here in float64.
_SPP_PER_RENDER = 4096
_BLACK_HINT = (
    "Check that shapes are in view and face the camera, and that lamps face them: area lights and"
    " most surfaces are one-sided; that the camera is in no shape; that no picture of a lamp is 0;"
    " and that hide_emitters is off."
)
_CENTROID_POINTS = 4097  # of a lamp's spectrum
_DEPTH_PLACES = 32  # across and down the film, at which depths are measured
_PICTURES_AT_INFINITY = BACKGROUNDS - {"constant"}  # which is the same in and out of focus
# Odd, so that seeds stay different modulo any power of two: the scalar variants multiply them by
# the number of samples of a strip, modulo 2³². Consecutive runs take consecutive seeds.
_SEED_STRIDE = 2654435761
_LEVEL_STRIDE = 1000003
# Keeps sample counts for which the result is the same bit for bit on any number of threads.
LEVEL_FACTOR = 4


class _RowTrace(NamedTuple):
    """The trace of some rows of a film.

    rows : of the film
    pulses : whose pictures it gives, of one light
    trace : returns the pictures of a seed, (rows, columns, pulses)
    """

    rows: slice
    pulses: slice | list[int]
    trace: Callable[[int], NDArray[np.float32]]


class _LightTraces(NamedTuple):
    """The traces that give the pictures of a light.

    renders : whose average each picture is
    spp : samples per film cell and pass, of all renders together
    rows : traces of the rows of the film
    """

    renders: int
    spp: int
    rows: list[_RowTrace]


def render(
    scene: Scene,
    camera: Camera | None = None,
    seed: Whole = 0,
    *,
    full: bool = False,
    plan: Plan | None = None,
    diffuser: bool = False,
    progress: Progress | None = None,
) -> SpectralImage:
    """Render the spectral irradiance on the sensor plane before diffraction, W m⁻² nm⁻¹, mean over
    each sample and band.

    Each call renders, since only the commands cache renders: keep the result, or store it with
    `write_exr`.

    Parameters
    ----------
    scene : from `load_scene`; its film and sampler give the resolution and the samples per pixel
    camera : replaces the camera of the file. None takes the file's
    seed : of the sampler; equal seeds give bit-identical results, but for the rounding of float32
        sums on a graphics card
    full : leave nothing out (every band, the scene's integrator, a sampled lens)
    plan : from `make_plan`. None makes the default plan
    diffuser : also render what a white plate at the object's distance shows, for
        `Display(white="diffuser")`
    progress : called with the fraction done

    Raises PixsimError if Mitsuba cannot render the scene, or if the picture is black or not finite.

    >>> from pixsim import load_scene
    >>> scene = load_scene("flat", resolution=17, spp=4, luminance_cd_per_m2=1000)
    >>> light = render(scene, Camera(f_number=4.0))
    >>> m = Camera().magnification
    >>> on_axis_lx = 1000 * np.pi / (1 + 4 * 4.0**2 * (1 + m) ** 2)  # Foote: E = π L sin²α
    >>> round(float(light.illuminance_lx()[8, 8] / on_axis_lx), 4)
    1.0
    """
    camera = camera or scene.camera()
    if diffuser:
        scene = replace(scene, diffuser=True)
        if plan is not None and plan.light.plate is None and not plan.light.chart_white:
            got = "a plan that was made without the diffuser"
            raise invalid("diffuser", got, "no plan", "Leave out `plan` or `diffuser`.")
    renderer = Renderer(scene, camera, plan or make_render_plan(scene, camera, full=full), seed)
    return renderer.image(*renderer.run(0, progress))


class Renderer:
    """Independent renders of one scene, loaded once per lamp spectrum on first use.

    use_cache : whether cached renders are used, and new ones stored
    ends_at_s : time of `time.monotonic` at which a trace is given up (`OutOfTimeError`). None waits
        for it
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        plan: Plan,
        seed: int,
        *,
        use_cache: bool = False,
        ends_at_s: float | None = None,
    ) -> None:
        camera = plan.film.camera_of(camera)
        self.scene = scene
        self.camera = camera
        self.plan = plan
        self.seed = seed
        self.ends_at_s = ends_at_s
        self.film_camera = rendered_camera(camera)
        self.distortion = camera_distortion(camera)

        # Film: the picture, and the cells around it that are rendered too.
        self.text = scene.text_for_camera(self.film_camera)
        state = parse_tree(self.text.text, scene.choice.reading)
        self.size = scene.film_shape(self.film_camera, state)
        for side in self.size:
            check_resolution(side)
        self.pitch_um = 1e3 * camera.die_mm / self.size[1]
        self.margin = plan.film.margin(self.size, self.pitch_um)
        self.rendered_size = (self.size[0] + 2 * self.margin, self.size[1] + 2 * self.margin)

        # Irradiance on the axis per radiance
        factor = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
        self.on_axis = factor * camera.transmittance

        # What is traced
        self.job = self._trace_job(state)
        files = [Path(file.path) for file in self.job.files]
        self.packaged = is_packaged(self.text, files)
        self.sees_infinity = any(
            node.plugin in _PICTURES_AT_INFINITY for _, node in nodes_of(state, "Emitter")
        )
        self.cache: CachedRenders | None = None
        if use_cache:
            self.cache = CachedRenders(_hash_of_job(scene, state, camera, plan, seed))

    def _trace_job(self, state: Tree) -> TraceJob:
        """Return the job of the tracer, as plain numbers and texts.

        state : the scene, parsed for the camera
        """
        plan = self.plan
        scene = self.scene
        camera = self.camera

        # The lens sees the margin too.
        wide_camera = self.film_camera
        if self.margin:
            wide_mm = self.film_camera.die_mm * self.rendered_size[1] / self.size[1]
            wide_camera = self.film_camera.model_copy(update={"die_mm": wide_mm})
        lens: dict[str, Any] = {"type": plan.samples.lens, "fov": wide_camera.fov_deg}
        if plan.samples.lens == "thinlens":
            lens["aperture_radius"] = camera.aperture_radius_m
            lens["focus_distance"] = camera.object_distance_m

        # Spectra of surfaces in place of those in the scene
        equal_steps = irregular_tables(state) if plan.light.regular_tables else {}
        regular_tables = [
            (index, name, regular(float(table.nodes_nm[0]), float(table.nodes_nm[-1]), values))
            for (index, name), (table, values) in equal_steps.items()
        ]
        held_tables = [
            (index, name, irregular(table.nodes_nm, table.values))
            for index, name, table in plan.light.held
        ]
        return TraceJob(
            variant=scene.choice.variant,
            text=self.text.text,
            lamps=tuple(
                Lamps(light.lamp.pictures, neutral=light.lamp.spectrum is not None)
                for light in plan.light.lamps
            ),
            sensor=sensor_node(state, scene.sensor_id)[0],
            lens=lens,
            integrator=plan.samples.integrator,
            tables=(*regular_tables, *held_tables),
            size=self.rendered_size,
            passes=tuple(
                shared_passes(light.fit, plan.light.bands.span, fewest=2 if plan.film.chart else 1)
                for light in plan.light.lamps
            ),
            files=asset_files(state),
        )

    @cached_property
    def tracer(self) -> InProcessTracer | ChildTracer:
        """What traces the job: this process if the scene is packaged and has all the time.

        Else it is a child, which can be killed, and which a failing card may end too.
        """
        uses_card = self.scene.choice.processors is not None
        if self.packaged and not uses_card and self.ends_at_s is None:
            return InProcessTracer(self.job)
        return ChildTracer(self.job, lambda: self.ends_at_s)

    def fall_off(self, rows: slice = WHOLE, columns: slice = WHOLE) -> Array:
        """Return the irradiance relative to the irradiance on the axis, at the centre of each
        rendered cell of some rows and columns.
        """
        factor = camera_factor(self.camera, self.rendered_size, self.pitch_um, (rows, columns))
        return factor * (self.camera.transmittance / self.on_axis)

    def run(
        self, index: int, progress: Progress | None = None, level: int = 0
    ) -> tuple[Pictures, int]:
        """Return pictures (H, W, pulses) of each light with their margin, relative to its lamp, and
        the samples per film cell.

        Runs of different index or level are independent. Each level has four times the samples of
        the one before, rounded up to one of `SAMPLE_COUNTS`.
        """
        # An exact picture takes no longer than reading a file.
        cached = None if self.plan.samples.exact else self.cache
        result = cached.find(index, level) if cached else None
        if result is not None:
            if progress:
                progress(1.0)
        else:
            try:
                _ = self.depths_m  # now: behind the renders no time may be left
                result = self._rendered(index, level, progress)
            except PixsimError as error:
                error.args = (self._explained(error),)
                raise
            if cached:
                cached.store(index, level, *result)

        pictures, spp = result
        return [self.distorted(planes) for planes in pictures], spp

    def _explained(self, error: PixsimError) -> str:
        """Return the message of an error with places in the user's files, and how to do without a
        graphics card if one was used.
        """
        message = self.text.with_place(str(error))
        if self.scene.choice.processors is None or isinstance(error, OutOfTimeError):
            return message
        reading = self.scene.choice.reading
        return f"{message} To render without the graphics card: --variant {reading}."

    @cached_property
    def depths_m(self) -> list[float]:
        """Depths of the things in view in m: the nearest, the one least out of focus, and the
        farthest.

        Empty where the plan needs no lens, since all is in focus, and where a depth in view is not
        known.
        """
        if self.plan.samples.lens == "perspective":
            return []

        key = self.cache and f"{self.cache.job}-depths"
        content = cache.arrays(KIND, key) if key else None
        if content is None:
            depths_m = self.tracer.depths(_DEPTH_PLACES)
            if key:
                cache.store_arrays(KIND, key, {"depths_m": depths_m})
        else:
            depths_m = content["depths_m"]

        if not self.sees_infinity:
            depths_m = depths_m[~np.isinf(depths_m)]
        if not depths_m.size or np.isnan(depths_m).any():
            return []
        defocus = np.abs(1 / depths_m - 1 / self.camera.object_distance_m)
        sharpest_m = depths_m.flat[defocus.argmin()]
        return [float(depths_m.min()), float(sharpest_m), float(depths_m.max())]

    def distorted(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return pictures (H, W, pulses) as the chief rays of a real lens show them; as they are
        for a thin lens.
        """
        if self.distortion is None:
            return planes

        widening = self.film_camera.die_mm / self.camera.die_mm
        result: NDArray[np.float32] = zeros(planes.shape, np.float32)
        for pulse in range(planes.shape[2]):
            result[:, :, pulse] = self.distortion.applied(
                planes[:, :, pulse], self.pitch_um, widening
            )
            release(planes, result)
        return result

    def _rendered(self, index: int, level: int, progress: Progress | None) -> tuple[Pictures, int]:
        """Render each strip as an average of renders in float64, with consecutive seeds."""
        if self.plan.samples.exact:
            return self._exact(), 0

        spp = self.plan.samples.spp * LEVEL_FACTOR**level
        if level:
            counts = (
                (MIN_PATH_SPP, *SAMPLE_COUNTS) if self.plan.film.chart is None else SAMPLE_COUNTS
            )
            spp = next((count for count in counts if count >= spp), spp)
        lights = [self._light_traces(light, spp) for light in range(len(self.plan.light.lamps))]

        count = sum(traces.renders * len(traces.rows) for traces in lights)
        first_seed = self.seed * _SEED_STRIDE + level * _LEVEL_STRIDE + index * count
        number = 0
        pictures = []
        for light, traces in zip(self.plan.light.lamps, lights, strict=True):
            planes: NDArray[np.float32] = zeros(
                (*self.rendered_size, len(light.fit.pulses)), np.float32
            )
            for rows, pulses, trace in traces.rows:
                total = np.zeros(planes[rows, :, pulses].shape)
                for _ in range(traces.renders):
                    picture = _checked(trace((first_seed + number) % 2**32))
                    total += picture / traces.renders
                    number += 1
                    if progress:
                        progress(number / count)
                planes[rows, :, pulses] = total
                release(planes[rows])
            mirror_margins(planes, self.margin, self.plan.film.ends)
            pictures.append(planes)
        return pictures, lights[0].spp

    def _light_traces(self, scene: int, requested_spp: int) -> _LightTraces:
        """Divide the render of a light: its passes together, or a pass at a time; strips; averages
        of shorter renders.

        scene : of the job, one for each light
        requested_spp : samples per film cell and pass; most samplers round the number up, to
            stratify them
        """
        light = self.plan.light.lamps[scene]
        sampler = self.plan.samples.sampler
        renders = -(-requested_spp // _SPP_PER_RENDER)

        # All passes in one kernel. Scalar variants have no kernels that passes could share.
        spp = -(-requested_spp // renders)
        passes = None if self.job.variant.startswith("scalar") else self.job.passes[scene]
        in_blocks = False
        if sampler == "independent":  # by the plan, for a few samples of paths
            has_few = spp < MIN_MULTIJITTER_SPP
            in_blocks = has_few and passes is not None
            sampler = "multijitter" if in_blocks or not has_few else sampler
        if not in_blocks:
            spp = self.tracer.sample_count(sampler, spp)
        rows: list[_RowTrace] = []
        if passes is not None and (in_blocks or len(passes.groups) > 1):
            all_pulses = slice(None)
            for strip in self._film_strips(spp * len(light.fit.passes), _SAMPLES_TOGETHER):
                trace = partial(
                    self.tracer.trace_together,
                    scene,
                    (strip.start, strip.stop),
                    sampler,
                    spp,
                    block_cells=_BLOCK_CELLS if in_blocks else 1,
                )
                rows.append(_RowTrace(strip, all_pulses, trace))
            return _LightTraces(renders, renders * spp, rows)

        # One pass at a time, whose pulses are the channels of a film
        film_strips = self._film_strips(spp, _SAMPLES_PER_KERNEL)
        for pulses in light.fit.passes:
            responses = [film_response(light.fit.pulses[pulse]) for pulse in pulses]
            for strip in film_strips:
                crop = film(responses, self.rendered_size, strip.start, strip.stop)
                trace = partial(self.tracer.trace, scene, crop, sampler, spp)
                rows.append(_RowTrace(strip, pulses, trace))
        return _LightTraces(renders, renders * spp, rows)

    def _exact(self) -> Pictures:
        """Return the pictures of a chart from its texels. Every pulse has the spectrum of the lamp,
        so they are all the same.
        """
        chart = self.plan.film.chart
        assert chart is not None
        if self.margin:
            chart = replace(chart, shape=self.rendered_size)
        picture = chart.picture()
        mirror_margins(picture, self.margin, self.plan.film.ends)
        return [
            np.broadcast_to(picture[:, :, None], (*picture.shape, len(light.fit.pulses)))
            for light in self.plan.light.lamps
        ]

    def _film_strips(self, spp: int, samples_per_kernel: int) -> list[slice]:
        """Return the rows of the parts of a render, so that Ctrl-C works between them.

        spp : samples per film cell of all passes in a kernel
        """
        height, width = self.rendered_size
        samples = height * width * spp
        if self.job.variant.startswith("scalar"):
            count = min(_SCALAR_STRIPS, -(-samples // _SAMPLES_PER_STRIP))
        else:
            count = max(-(-samples // samples_per_kernel), -(-height * width // _CELLS_PER_KERNEL))
        borders = np.linspace(0, height, min(count, height) + 1).astype(int).tolist()
        return [slice(first, stop) for first, stop in pairwise(borders)]

    def image(self, pictures: Sequence[Picture], spp: int, **entries: Any) -> SpectralImage:
        """Return the irradiance of mean pictures with `spp` samples per film cell.

        entries : of the header, beside those that pixsim always writes
        """
        if not any(self.has_light(picture) for picture in pictures):
            reading = self.scene.choice.reading
            dark_skies = warnings_of_skies(parse_tree(self.text.text, reading), reading)
            hint = " ".join(dark_skies) or _BLACK_HINT
            raise invalid("rendered picture", "a black picture", "some light", hint)

        header = provenance(self.scene, self.camera, self.plan, self.seed, spp)
        header["film"] = list(self.size)
        header |= self.diffuser | entries
        if self.depths_m:
            rounded_m = [float(f"{depth_m:.6g}") for depth_m in self.depths_m]
            header[DEPTHS] = finite_or_none(rounded_m)

        if self.plan.light.factored:
            factors = self.spectra, self._pulse_planes(pictures)
            return self._image(header, factors=factors, margin=self.margin)
        return self._image(header, data=self._band_planes(pictures), margin=self.margin)

    def _pulse_planes(self, pictures: Sequence[Picture]) -> NDArray[np.float32]:
        """Return the pictures of all pulses with the fall-off of the lens, (pulses, H, W)."""
        planes = [picture[:, :, pulse] for picture in pictures for pulse in range(picture.shape[2])]
        result: NDArray[np.float32] = zeros((len(planes), *self.rendered_size), np.float32)
        for rows in strips(*self.rendered_size):
            fall_off = self.fall_off(rows)
            for target, plane in zip(result, planes, strict=True):
                target[rows] = plane[rows] * fall_off
                release(target[rows])
            release(*(picture[rows] for picture in pictures))
        return result

    def _band_planes(self, pictures: Sequence[Picture]) -> NDArray[np.float32]:
        """Return the irradiance in all bands, (H, W, B)."""
        count = self.plan.light.bands.width_nm.size
        planes: NDArray[np.float32] = zeros((count, *self.rendered_size), np.float32)
        for rows in strips(*self.rendered_size):
            row_pictures = [picture[rows] for picture in pictures]
            bands = self._bands(row_pictures, self.fall_off(rows))
            for plane, irradiance in zip(planes, bands, strict=True):
                plane[rows] = irradiance
                release(plane[rows])
            release(*row_pictures)
        return np.moveaxis(planes, 0, 2)

    @cached_property
    def diffuser(self) -> dict[str, Any]:
        """The entry of a header on a white plate at the object's distance, or on texel value 1 of
        an emissive chart, if the scene asks for one.

        Raises PixsimError if no light reaches the plate.
        """
        light = self.plan.light
        plate = self.plan.light.plate
        if not self.scene.diffuser:
            return {}
        if plate is None:
            return {DIFFUSER: light.chart_white}

        spectrum = _plate_spectrum(
            plate, use_cache=self.cache is not None, ends_at_s=self.ends_at_s
        )
        per_nm = spectrum.cell_means(light.bands.edges_nm)
        entry = {
            "distance_m": float(f"{plate.distance_m:.6g}"),
            DIFFUSER_W: [float(f"{band_w:.9g}") for band_w in per_nm],
        }
        return {DIFFUSER: entry}

    def has_light(self, picture: Picture) -> bool:
        """Return whether there is light in a picture (H, W, pulses)."""
        for rows in strips(*self.rendered_size):
            if picture[rows].any():
                return True
            release(picture[rows])
        return False

    def _bands(self, pictures: Sequence[Picture], fall_off: Array) -> Iterator[Array]:
        """Iterate over the irradiance in each band; all bands together would fill the memory."""
        factor = self.on_axis * fall_off
        lights = [np.ascontiguousarray(np.moveaxis(planes, 2, 0)) for planes in pictures]
        for band in range(self.plan.light.bands.width_nm.size):
            total = np.zeros(fall_off.shape)
            for light, planes in zip(self.plan.light.lamps, lights, strict=True):
                for pulse in np.flatnonzero(light.fit.spectra[:, band]):
                    total += light.fit.spectra[pulse, band] * planes[pulse]
            yield total * factor

    @property
    def spectra(self) -> Array:
        """Irradiance on the axis, (pulses, B) W m⁻² nm⁻¹, per unit of a pulse's picture."""
        return np.vstack([light.fit.spectra for light in self.plan.light.lamps]) * self.on_axis

    @property
    def units(self) -> SpectralImage:
        """An image with one sample per pulse: the irradiance on the axis of a unit of its
        picture.
        """
        return self._image({}, factors=(self.spectra, np.eye(len(self.spectra))[:, None, :]))

    def _image(self, header: dict[str, Any], **light: Any) -> SpectralImage:
        bands = self.plan.light.bands
        return SpectralImage(
            bands.wavelength_nm,
            bands.width_nm,
            self.pitch_um,
            within=(bands.nodes_nm, bands.shares),
            header=header,
            **light,
        )


def mirror_margins(planes: Picture, margin: int, ends: tuple[bool, bool]) -> None:
    """Continue pictures (H, W, ...) in place where the scene ends with the film: by their mirror
    image.

    margin : cells at each side beyond the film, at most half of its sides
    ends : whether the scene ends with the film, above and below, and at the left and the right
    """
    if not margin:
        return
    for axis in np.flatnonzero(ends).tolist():
        lines = np.moveaxis(planes, axis, 0)
        lines[:margin] = lines[margin : 2 * margin][::-1]
        lines[-margin:] = lines[-2 * margin : -margin][::-1]


def _checked(values: NDArray[np.float32]) -> Array:
    """Return the values of a render. Raises PixsimError if one is negative or not finite."""
    if not np.isfinite(values).all() or values.min() < 0:
        raise invalid(
            "rendered picture",
            "NaN, infinite or negative values",
            "finite values of 0 or more",
            "Check the scene's spectra and textures.",
        )
    return values.astype(float)


def provenance(scene: Scene, camera: Camera, plan: Plan, seed: int, spp: int) -> dict[str, Any]:
    """Return the provenance of an irradiance; equal inputs give equal files."""
    decisions = [
        f"{decision.subject}: {'kept' if decision.kept else 'left out'}, {decision.reason}"
        for decision in plan.decisions
    ]
    variant = scene.choice.variant
    if plan.samples.exact:  # nothing is traced: a graphics card has no part in it
        variant = scene.choice.reading
    header: dict[str, Any] = {
        "scene": scene.path.name,
        "scene_hash": scene.content_hash,
        "parameters": scene.shown_parameters,
        "camera": camera.model_dump(),
        "seed": seed,
        "spp": spp,
        "variant": variant,
        "plan": decisions,
        "bound_e": plan.bound_e if plan.bounded else None,
        "spare_e": plan.spare_e,
        "diffraction": plan.film.diffraction,
        "pixsim": VERSION,
    }
    if plan.film.tiling is not None:
        header[LENS_HEADER] = asdict(plan.film.tiling)
        header[RINGS] = True

    header |= plan.light.white_header(plan.light.bands.edges_nm)
    if scene.shows_target:
        header[PART] = _light_on_part(scene, plan)
    if scene.white_cd_per_m2:
        header[LUMINANCE] = float(f"{scene.white_cd_per_m2:.9g}")
        return header
    return header | plan.light.chart_white


def _light_on_part(scene: Scene, plan: Plan) -> dict[str, Any]:
    """Return what an irradiance says of the part of a target: its reflectance, `lux` of visible or
    `irradiance_w_per_m2` and `centroid_nm` of invisible light, and its lamp.

    A lamp of its own irradiance has an angle to the normal, `incidence_deg`.
    """
    entry: dict[str, Any] = {"reflectance": scene.target.reflectance}
    ((name, of_white),) = plan.light.chart_white.items()
    on_part = float(f"{math.pi * of_white:.6g}")
    if name == LUMINANCE:
        entry[ILLUMINANCE] = on_part
    else:
        spectrum = plan.light.lamps[0].lamp.spectrum
        assert spectrum is not None
        nm = np.linspace(spectrum.nodes_nm[0], spectrum.nodes_nm[-1], _CENTROID_POINTS)
        weight = spectrum.at(nm)
        entry |= {IRRADIANCE: on_part, "centroid_nm": round(float(nm @ weight / weight.sum()), 1)}

    if scene.lamp_factor is not None:
        entry[LAMP] = Path(scene.parameters[LAMP]).stem
        if scene.strength is None:
            entry[INCIDENCE] = round(math.degrees(math.acos(math.pi * scene.lamp_factor)), 6)
    elif EMITTER_SCALE in scene.names:
        entry[LAMP] = "CIE D65"
    return entry


def _plate_spectrum(
    plate: WhitePlate, *, use_cache: bool = False, ends_at_s: float | None = None
) -> Spectrum:
    """Return the radiance of a white plate in a scene, W m⁻² sr⁻¹ nm⁻¹, constant within each band
    of its plan.

    Samples are added until the standard error over the cells of its picture is at most a thousandth
    of it.

    use_cache, ends_at_s : see `Renderer`

    Raises PixsimError if no light reaches it.
    """
    renderer = Renderer(
        plate.scene,
        plate.camera,
        plate.plan,
        white_plate.SEED,
        use_cache=use_cache,
        ends_at_s=ends_at_s,
    )
    renderer.job = replace(renderer.job, lens=plate.lens)
    bands = plate.plan.light.bands
    per_nm = np.zeros(0)
    for level in range(white_plate.LEVELS):
        pictures, _ = renderer.run(0, level=level)
        radiances = [
            picture.astype(float) @ light.fit.spectra
            for light, picture in zip(plate.plan.light.lamps, pictures, strict=True)
        ]
        cells = np.sum(radiances, axis=0).reshape(-1, bands.width_nm.size)
        per_nm = cells.mean(axis=0)

        power = cells @ bands.width_nm
        standard_error = power.std(ddof=1) / math.sqrt(power.size)
        if standard_error <= white_plate.NOISE * power.mean():
            break
    if not per_nm @ bands.width_nm > 0:
        raise dark_plate_error(plate.distance_m)

    nodes_nm = np.repeat(bands.edges_nm, 2)[1:-1]
    return Spectrum(nodes_nm, np.repeat(np.maximum(per_nm, 0.0), 2))
