"""Render a plan in Mitsuba: radiance on an oversampled film, then spectral irradiance on the sensor
plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache, mapped
from pixsim.base.arrays import Array, strips
from pixsim.base.bounds import Whole
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.mapped import release, zeros
from pixsim.base.progress import Progress
from pixsim.base.records import content_hash
from pixsim.base.version import VERSION
from pixsim.light.quantities import LUMINANCE
from pixsim.light.spectral import (
    DIFFUSER,
    DIFFUSER_W,
    RINGS,
    VISIBLE,
    WHOLE,
    Span,
    SpectralImage,
    Spectrum,
)
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import LENS_HEADER, distortion_of, rendered_camera
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
from pixsim.scene.rules import BACKGROUNDS, SAMPLE_COUNTS, irregular_tables
from pixsim.scene.scene import Scene, check_resolution, hash_of_tree, is_packaged, sensor_node
from pixsim.scene.tree import Tree, nodes_of, parse_tree
from pixsim.scene.white_plate import dark_plate


def film(
    responses: list[dict[str, Any]], size: tuple[int, int], top: int, bottom: int
) -> dict[str, Any]:
    """Describe a specfilm for some rows: float32 with a box filter, so that cells are means and
    runs are reproducible.
    """
    height, width = size
    whole = {
        "type": "specfilm",
        "width": width,
        "height": height,
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    crop = {
        "crop_offset_x": 0,
        "crop_offset_y": int(top),
        "crop_width": width,
        "crop_height": int(bottom - top),
    }
    return whole | crop | {f"band{channel}": response for channel, response in enumerate(responses)}


def film_response(pulse: Pulse) -> dict[str, Any]:
    return regular(pulse.low_nm, pulse.high_nm, pulse.values)


def passes_of(fit: Fit, span: Span = VISIBLE) -> Passes | None:
    """Return the passes of a light in a range; None if there is one, or none, which nothing can be
    shared with.
    """
    if len(fit.passes) < 2:
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
    """Return a hash of all that a job's runs depend on (`state`: parsed for the camera); pixel and
    display act by the plan.
    """
    lights = []
    samples = plan.samples
    for light in plan.light.lamps:
        pulses = [
            [pulse.low_nm, pulse.high_nm, pulse.values.tolist()] for pulse in light.fit.pulses
        ]
        lights.append(
            [
                light.lamp.spectrum is None,
                sorted(light.lamp.pictures.items()),
                pulses,
                light.fit.passes,
            ]
        )
    settings: list[Any] = [
        samples.lens,
        samples.integrator,
        samples.spp,
        samples.sampler,
        plan.light.regular_tables,
    ]
    tree, version = hash_of_tree(state), cache.version_fingerprint("mitsuba", "drjit")
    size = scene.film_shape(camera, state)
    margin = plan.film.margin(size, 1e3 * camera.die_mm / size[1])
    settings += [margin, *plan.film.ends] if margin else []
    settings.extend(
        [index, name, table.nodes_nm.tolist(), table.values.tolist()]
        for index, name, table in plan.light.held
    )
    return content_hash(
        [
            tree,
            size,
            scene.sensor_id,
            scene.choice.variant,
            camera.without_veil.model_dump(),
            lights,
            settings,
            seed,
            version,
        ]
    )


class CachedRenders:
    """The cached runs of one job: the first ones, as many as fit into the cache's share of one
    entry.
    """

    def __init__(self, job: str) -> None:
        self.job, self.size_bytes = job, 0

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
        if cache.has_room(self.size_bytes):
            named = {f"light{number}": picture for number, picture in enumerate(pictures)}
            cache.store_arrays(KIND, self._key(index, level), {"spp": np.array(spp), **named})

    def runs_in_time(self, limits: str) -> int | None:
        """Return the number of runs after which time ran out under the same limits, or None; the
        clock is not reproducible.
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
SAMPLES_TOGETHER = 1 << 22
# Memory for their sums, in float32 and float64; fewer samples than 4 in a cell are rare.
_CELLS_PER_KERNEL = 1 << 23
_SCALAR_STRIPS = 16
# Of scalar variants; with fewer, the start of a render takes longer than the samples.
_SAMPLES_PER_STRIP = 1 << 16
# Mitsuba's float32 sums drift by 1e-5 at 65 536; more samples are averaged here in float64
_SPP_PER_RENDER = 4096
_BLACK_HINT = (
    "Check that shapes are in view and face the camera, and that lamps face them: area lights and"
    " most surfaces are one-sided; that the camera is in no shape; that no picture of a lamp is 0;"
    " and that hide_emitters is off."
)
_DEPTH_PLACES = 32  # across and down, at which a scene's depth is looked at
_PICTURES_AT_INFINITY = BACKGROUNDS - {"constant"}  # which is the same in and out of focus
# Odd, so that seeds stay different modulo any power of two: the scalar variants multiply them by
# the number of samples of a strip, modulo 2³². Consecutive runs take consecutive seeds.
_SEED_STRIDE = 2654435761
_LEVEL_STRIDE = 1000003
# Keeps sample counts for which the result is the same bit for bit on any number of threads.
LEVEL_FACTOR = 4


class _FilmRows(NamedTuple):
    """Rows of a film, the pulses whose pictures a trace gives, and the trace of a seed: (rows,
    columns, pulses).
    """

    rows: slice
    pulses: list[int]
    trace: Callable[[int], NDArray[np.float32]]


class Work(NamedTuple):
    """Parts of the pictures of a light, each the average of some renders; `spp`: samples per film
    cell and pass.
    """

    renders: int
    spp: int
    parts: list[_FilmRows]


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
    camera : replaces the camera of the file; None takes that of the file
    seed : of the sampler; equal seeds give bit-identical results, but for the rounding of float32
        sums on a graphics card
    full : leave nothing out (every band, the scene's integrator, a sampled lens)
    plan : from `make_plan`; None makes the default plan
    diffuser : also render what a white plate at the object's distance shows, for
        `Display(white="diffuser")`
    progress : called with the fraction done

    Raises PixsimError if Mitsuba cannot render the scene, or if the picture is black or not finite.

    >>> from pixsim import load_scene
    >>> light = render(load_scene("flat", resolution=17, spp=4, luminance_cd_per_m2=1000), Camera(f_number=4.0))
    >>> m = Camera().magnification
    >>> on_axis_lx = 1000 * np.pi / (1 + 4 * 4.0**2 * (1 + m) ** 2)  # Foote: E = π L sin²α
    >>> round(float(light.illuminance_lx()[8, 8] / on_axis_lx), 4)
    1.0
    """
    camera = camera or scene.camera()
    if diffuser:
        scene = replace(scene, diffuser=True)
        if plan is not None and plan.light.plate is None and not plan.light.chart_white:
            got = "a plan that was made without it"
            raise invalid("diffuser", got, "no plan", "Leave `plan` out, or `diffuser`.")
    job = Renderer(scene, camera, plan or make_render_plan(scene, camera, full=full), seed)
    return job.image(*job.run(0, progress))


class Renderer:
    """Independent renders of one scene, loaded once per lamp spectrum on first use.

    keep : use the cache of renders
    ends_at_s : time of `time.monotonic` at which a trace is given up (`OutOfTimeError`); None waits
        for it
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        plan: Plan,
        seed: int,
        *,
        keep: bool = False,
        ends_at_s: float | None = None,
    ) -> None:
        camera = plan.film.camera_of(camera)
        self.source, self.camera, self.plan, self.seed = scene, camera, plan, seed
        self.seen, self.distortion = rendered_camera(camera), distortion_of(camera)
        text = self.text = scene.text_for_camera(self.seen)
        state = parse_tree(text.text, scene.choice.reading)
        self.size = scene.film_shape(self.seen, state)
        for side in self.size:
            check_resolution(side)
        self.pitch_um = 1e3 * camera.die_mm / self.size[1]
        self.margin = plan.film.margin(self.size, self.pitch_um)
        # Cells that are rendered.
        self.field = (self.size[0] + 2 * self.margin, self.size[1] + 2 * self.margin)
        self.on_axis = (
            float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
            * camera.transmittance
        )
        wide = (
            self.seen.model_copy(update={"die_mm": self.seen.die_mm * self.field[1] / self.size[1]})
            if self.margin
            else self.seen
        )
        lens: dict[str, Any] = {"type": plan.samples.lens, "fov": wide.fov_deg}
        if plan.samples.lens == "thinlens":
            lens |= {
                "aperture_radius": camera.aperture_radius_m,
                "focus_distance": camera.object_distance_m,
            }
        lamps = tuple(
            Lamps(light.lamp.pictures, light.lamp.spectrum is not None)
            for light in plan.light.lamps
        )
        sensor = sensor_node(state, scene.sensor_id)[0]
        equal_steps = irregular_tables(state) if plan.light.regular_tables else {}
        tables = tuple(
            (index, name, regular(float(table.nodes_nm[0]), float(table.nodes_nm[-1]), values))
            for (index, name), (table, values) in equal_steps.items()
        )
        tables += tuple(
            (index, name, irregular(table.nodes_nm, table.values))
            for index, name, table in plan.light.held
        )
        passes = tuple(passes_of(light.fit, plan.light.bands.span) for light in plan.light.lamps)
        files = asset_files(state)
        self.job = TraceJob(
            scene.choice.variant,
            text.text,
            lamps,
            sensor,
            lens,
            plan.samples.integrator,
            tables,
            self.field,
            passes,
            files,
        )
        self.packaged, self.ends_at_s = (
            is_packaged(text, [Path(file.path) for file in files]),
            ends_at_s,
        )
        self.cache = CachedRenders(_hash_of_job(scene, state, camera, plan, seed)) if keep else None
        self.sees_infinity = any(
            node.plugin in _PICTURES_AT_INFINITY for _, node in nodes_of(state, "Emitter")
        )

    @cached_property
    def tracer(self) -> InProcessTracer | ChildTracer:
        """What traces the job: this process if the scene is packaged and has all the time.

        Else it is a child, which can be killed, and which a failing card may end too.
        """
        in_this_process = (
            self.packaged and self.source.choice.processors is None and self.ends_at_s is None
        )
        return (
            InProcessTracer(self.job)
            if in_this_process
            else ChildTracer(self.job, lambda: self.ends_at_s)
        )

    def fall_off(self, rows: slice = WHOLE, columns: slice = WHOLE) -> Array:
        """Return the irradiance relative to that on the axis, at the centre of each rendered cell
        of some rows and columns.
        """
        return camera_factor(self.camera, self.field, self.pitch_um, (rows, columns)) * (
            self.camera.transmittance / self.on_axis
        )

    def run(
        self, index: int, progress: Progress | None = None, level: int = 0
    ) -> tuple[Pictures, int]:
        """Return pictures (H, W, pulses) of each light with their margin, relative to its lamp, and
        the samples per film cell.

        Runs of different index or level are independent. Each level has four times the samples of
        the one before, rounded up to one of `SAMPLE_COUNTS`.
        """
        result = (
            self.cache.find(index, level) if self.cache and not self.plan.samples.exact else None
        )
        if result is None:
            try:
                _ = self.depths_m  # now: behind the renders no time may be left
                result = self._rendered(index, level, progress)
            except PixsimError as error:
                card = self.source.choice.processors is not None and not isinstance(
                    error, OutOfTimeError
                )
                hint = (
                    f" To render without the graphics card: --variant {self.source.choice.reading}."
                    if card
                    else ""
                )
                error.args = (self.text.with_place(str(error)) + hint,)
                raise
            if (
                self.cache and not self.plan.samples.exact
            ):  # which takes no longer than reading a file
                self.cache.store(index, level, *result)
        elif progress:
            progress(1.0)
        return [self.distorted(planes) for planes in result[0]], result[1]

    @cached_property
    def depths_m(self) -> list[float]:
        """Depths of what is in view in m: the nearest, the one least out of focus, and the
        farthest.

        Empty where the plan needs no lens, since all is in focus, and where a depth in view is not
        known.
        """
        if self.plan.samples.lens == "perspective":
            return []
        key = self.cache and f"{self.cache.job}-depths"
        content = cache.arrays(KIND, key) if key else None
        depths_m = self.tracer.depths(_DEPTH_PLACES) if content is None else content["depths_m"]
        if key and content is None:
            cache.store_arrays(KIND, key, {"depths_m": depths_m})

        seen_m = depths_m if self.sees_infinity else depths_m[~np.isinf(depths_m)]
        if not seen_m.size or np.isnan(seen_m).any():
            return []
        defocus = np.abs(1 / seen_m - 1 / self.camera.object_distance_m)
        return [
            float(depth_m)
            for depth_m in (seen_m.min(), seen_m.flat[defocus.argmin()], seen_m.max())
        ]

    def distorted(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return pictures (H, W, pulses) as the chief rays of a real lens show them; as they are
        for a thin lens.
        """
        if self.distortion is None:
            return planes
        widening = self.seen.die_mm / self.camera.die_mm
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
            spp = next((count for count in SAMPLE_COUNTS if count >= spp), spp)
        works = [self._work(scene, spp) for scene in range(len(self.plan.light.lamps))]
        count, number = sum(work.renders * len(work.parts) for work in works), 0
        first = self.seed * _SEED_STRIDE + level * _LEVEL_STRIDE + index * count
        pictures = []
        for light, work in zip(self.plan.light.lamps, works, strict=True):
            planes: NDArray[np.float32] = zeros((*self.field, len(light.fit.pulses)), np.float32)
            for rows, channels, trace in work.parts:
                total = np.zeros((rows.stop - rows.start, self.field[1], len(channels)))
                for _ in range(work.renders):
                    total += _checked(trace((first + number) % 2**32), len(channels)) / work.renders
                    number += 1
                    if progress:
                        progress(number / count)
                planes[rows, :, channels] = total
                release(planes[rows])
            mirror_margins(planes, self.margin, self.plan.film.ends)
            pictures.append(planes)
        return pictures, works[0].spp

    def _work(self, scene: int, requested_spp: int) -> Work:
        """Divide the traces of a light: its passes together, or a pass at a time; strips; averages
        of shorter renders.

        requested_spp : samples per film cell and pass; most samplers round the number up, to
            stratify them
        """
        light, sampler = self.plan.light.lamps[scene], self.plan.samples.sampler
        renders = -(-requested_spp // _SPP_PER_RENDER)
        spp = self.tracer.sample_count(sampler, -(-requested_spp // renders))
        # Scalar variants have no kernels that passes could share.
        together = self.job.passes[scene] is not None and not self.job.variant.startswith("scalar")
        samples, samples_per_kernel = (
            (spp * len(light.fit.passes), SAMPLES_TOGETHER)
            if together
            else (spp, _SAMPLES_PER_KERNEL)
        )
        parts: list[_FilmRows] = []
        film_strips = [
            slice(*borders)
            for borders in pairwise(self._strip_borders(samples, samples_per_kernel))
        ]
        if together:
            pulses = list(range(len(light.fit.pulses)))
            for rows in film_strips:
                trace = partial(
                    self.tracer.trace_together, scene, (rows.start, rows.stop), sampler, spp
                )
                parts.append(_FilmRows(rows, pulses, trace))
            return Work(renders, renders * spp, parts)
        for channels in light.fit.passes:
            responses = [film_response(light.fit.pulses[pulse]) for pulse in channels]
            for rows in film_strips:
                crop = film(responses, self.field, rows.start, rows.stop)
                parts.append(
                    _FilmRows(rows, channels, partial(self.tracer.trace, scene, crop, sampler, spp))
                )
        return Work(renders, renders * spp, parts)

    def _exact(self) -> Pictures:
        """Return the pictures of a chart from its texels. Every pulse has the spectrum of the lamp,
        so they are all alike.
        """
        assert self.plan.film.chart is not None
        picture = (
            replace(self.plan.film.chart, shape=self.field) if self.margin else self.plan.film.chart
        ).picture()
        mirror_margins(picture, self.margin, self.plan.film.ends)
        return [
            np.broadcast_to(picture[:, :, None], (*picture.shape, len(light.fit.pulses)))
            for light in self.plan.light.lamps
        ]

    def _strip_borders(self, spp: int, samples_per_kernel: int) -> list[int]:
        """Return the rows that divide a render into parts, so that Ctrl-C works between them."""
        height, width = self.field
        samples = height * width * spp
        if self.job.variant.startswith("scalar"):
            parts = min(_SCALAR_STRIPS, -(-samples // _SAMPLES_PER_STRIP))
        else:
            parts = max(-(-samples // samples_per_kernel), -(-height * width // _CELLS_PER_KERNEL))
        return np.linspace(0, height, min(parts, height) + 1).astype(int).tolist()

    def image(self, pictures: Sequence[Picture], spp: int, **more: Any) -> SpectralImage:
        """Return the irradiance of mean pictures with `spp` samples per film cell; `more` goes into
        the header.
        """
        if not any(self.has_light(picture) for picture in pictures):
            dark_skies = warnings_of_skies(
                parse_tree(self.text.text, self.source.choice.reading), self.source.choice.reading
            )
            raise invalid(
                "rendered picture",
                "a black picture",
                "some light",
                " ".join(dark_skies) or _BLACK_HINT,
            )
        header = (
            provenance(self.source, self.camera, self.plan, self.seed, spp)
            | {"film": list(self.size)}
            | self.diffuser
            | more
        )
        header |= (
            {DEPTHS: finite_or_none([float(f"{depth_m:.6g}") for depth_m in self.depths_m])}
            if self.depths_m
            else {}
        )
        if self.plan.light.factored:
            planes = [
                picture[:, :, pulse] for picture in pictures for pulse in range(picture.shape[2])
            ]
            stored: NDArray[np.float32] = zeros((len(planes), *self.field), np.float32)
            for rows in strips(*self.field):
                fall_off = self.fall_off(rows)
                for place, plane in zip(stored, planes, strict=True):
                    place[rows] = plane[rows] * fall_off
                    release(place[rows])
                release(*(picture[rows] for picture in pictures))
            return self._image(header, factors=(self.spectra, stored), margin=self.margin)
        bands = self.plan.light.bands.width_nm.size
        if (
            4 * bands * math.prod(self.field) > mapped.MAX_MEMORY_BYTES
        ):  # in a file each band has a place of its own
            data = np.moveaxis(zeros((bands, *self.field), np.float32), 0, 2)
        else:
            data = np.empty((*self.field, bands), np.float32)
        for rows in strips(*self.field):
            for band, values in enumerate(
                self._bands([picture[rows] for picture in pictures], self.fall_off(rows))
            ):
                data[rows, :, band] = values
                release(data[rows, :, band])
            release(*(picture[rows] for picture in pictures))
        return self._image(header, data=data, margin=self.margin)

    @cached_property
    def diffuser(self) -> dict[str, Any]:
        """The entry of a header on a white plate at the object's distance, or on texel value 1 of
        an emissive chart, if asked for.

        Raises PixsimError if no light reaches the plate.
        """
        light, plate = self.plan.light, self.plan.light.plate
        if not self.source.diffuser:
            return {}
        if plate is None:
            return {DIFFUSER: light.chart_white}
        spectrum = _plate_spectrum(plate, keep=self.cache is not None, ends_at_s=self.ends_at_s)
        per_nm = spectrum.cell_means(light.bands.edges_nm)
        return {
            DIFFUSER: {
                "distance_m": float(f"{plate.distance_m:.6g}"),
                DIFFUSER_W: [float(f"{band_w:.9g}") for band_w in per_nm],
            }
        }

    def has_light(self, picture: Picture) -> bool:
        """Return whether there is light in a picture (H, W, pulses)."""
        for rows in strips(*self.field):
            if picture[rows].any():
                return True
            release(picture[rows])
        return False

    def _bands(self, pictures: Sequence[Picture], fall_off: Array) -> Iterator[Array]:
        """Iterate over the irradiance in each band; all bands at once would fill the memory."""
        factor = self.on_axis * fall_off
        for band in range(self.plan.light.bands.width_nm.size):
            total = np.zeros(fall_off.shape)
            for light, planes in zip(self.plan.light.lamps, pictures, strict=True):
                for pulse in np.flatnonzero(light.fit.spectra[:, band]):
                    total += light.fit.spectra[pulse, band] * planes[:, :, pulse]
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
        b = self.plan.light.bands
        return SpectralImage(
            b.wavelength_nm,
            b.width_nm,
            self.pitch_um,
            within=(b.nodes_nm, b.shares),
            header=header,
            **light,
        )


def mirror_margins(planes: Picture, margin: int, ends: tuple[bool, bool]) -> None:
    """Continue pictures (H, W, ...) in place where the scene ends with the film: by their mirror
    image.

    margin : cells at each side beyond the film, at most half of its sides
    ends : as in `Plan`
    """
    if not margin:
        return
    for axis in np.flatnonzero(ends).tolist():
        lines = np.moveaxis(planes, axis, 0)
        lines[:margin] = lines[margin : 2 * margin][::-1]
        lines[-margin:] = lines[-2 * margin : -margin][::-1]


def _checked(values: NDArray[np.float32], channels: int) -> Array:
    """Return the values of a render. Raises PixsimError if one is negative or not finite."""
    if values.shape[2] != channels:
        raise invalid(
            "integrator",
            f"{values.shape[2]} channels per pixel",
            "an integrator for radiance only, such as path",
        )
    if not np.isfinite(values).all() or values.min() < 0:
        hint = "Check the scene's spectra and textures."
        raise invalid(
            "rendered picture",
            "NaN, infinite or negative values",
            "finite values of 0 or more",
            hint,
        )
    return values.astype(float)


def provenance(scene: Scene, camera: Camera, plan: Plan, seed: int, spp: int) -> dict[str, Any]:
    """Return the provenance of an irradiance; equal inputs give equal files."""
    decisions = [
        f"{d.subject}: {'kept' if d.kept else 'left out'}, {d.reason}" for d in plan.decisions
    ]
    variant = scene.choice.variant
    if plan.samples.exact:  # nothing is traced: a graphics card has no part in it
        variant = scene.choice.reading
    header: dict[str, Any] = {
        "scene": scene.path.name,
        "scene_hash": scene.content_hash,
        "parameters": scene.shown_parameters,
    }
    header |= {
        "camera": camera.model_dump(),
        "seed": seed,
        "spp": spp,
        "variant": variant,
        "plan": decisions,
    }
    header |= {
        "bound_e": plan.bound_e if plan.bounded else None,
        "spare_e": plan.spare_e,
        "diffraction": plan.film.diffraction,
        "pixsim": VERSION,
    }
    if plan.film.tiling is not None:
        header |= {LENS_HEADER: asdict(plan.film.tiling), RINGS: True}
    header |= plan.light.white_header(plan.light.bands.edges_nm)
    if scene.white_cd_per_m2:
        return header | {LUMINANCE: float(f"{scene.white_cd_per_m2:.9g}")}
    return header | plan.light.chart_white


def _plate_spectrum(
    plate: WhitePlate, *, keep: bool = False, ends_at_s: float | None = None
) -> Spectrum:
    """Return the radiance of a white plate in a scene, W m⁻² sr⁻¹ nm⁻¹, constant within each band
    of its plan.

    Samples are added until the standard error over the cells of its picture is at most a thousandth
    of it.

    keep, ends_at_s : as of `Renderer`

    Raises PixsimError if no light reaches it.
    """
    job = Renderer(
        plate.scene, plate.camera, plate.plan, white_plate.SEED, keep=keep, ends_at_s=ends_at_s
    )
    job.job = replace(job.job, lens=plate.lens)
    bands, per_nm = plate.plan.light.bands, np.zeros(0)
    for level in range(white_plate.LEVELS):
        pictures, _ = job.run(0, level=level)
        parts = [
            picture.astype(float) @ light.fit.spectra
            for light, picture in zip(plate.plan.light.lamps, pictures, strict=True)
        ]
        cells = np.sum(parts, axis=0).reshape(-1, bands.width_nm.size)
        per_nm, power = cells.mean(axis=0), cells @ bands.width_nm
        if power.std(ddof=1) / math.sqrt(power.size) <= white_plate.NOISE * power.mean():
            break
    if not per_nm @ bands.width_nm > 0:
        raise dark_plate(plate.distance_m)
    edges = bands.edges_nm
    return Spectrum(np.repeat(edges, 2)[1:-1], np.repeat(np.maximum(per_nm, 0.0), 2))
