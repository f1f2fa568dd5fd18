"""Run the plan in Mitsuba: radiance at an oversampled resolution, then spectral irradiance on the sensor plane."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pixsim
from pixsim import optics
from pixsim.errors import refuse
from pixsim.mitsuba_xml import nodes_of, plain, speaking_mitsuba
from pixsim.parameters import Camera
from pixsim.plan import BAND_CENTRE_NM, BAND_WIDTH_NM, Plan, band_means, band_pulse, make_plan
from pixsim.scene import Scene, film_size, sample_count, sensor_node
from pixsim.spectral import Array, SpectralImage

Progress = Callable[[float], None]

# A kernel of so many samples runs about 1.5 s on two cores; between kernels Ctrl-C is heard and progress is told.
SAMPLES_PER_KERNEL = 1 << 25
SCALAR_STRIPS = 16
SCALAR_BLOCK = 32  # fixed: left to itself Mitsuba makes blocks, and with them seeds, by the number of threads
SPP_PER_RENDER = 4096  # Mitsuba's float32 sums drift by 1e-5 at 65 536; longer averages are ours, in float64
ALLOWED_SPP = (1, 1 << 20)
ALLOWED_RESOLUTION = (1, 16384)


def render(
    scene: Scene,
    camera: Camera | None = None,
    seed: int = 0,
    *,
    full: bool = False,
    progress: Progress | None = None,
) -> SpectralImage:
    """Spectral irradiance on the sensor plane before diffraction, W m⁻² nm⁻¹, mean over each sample and band.

    Parameters
    ----------
    scene : from `load_scene`; its film and sampler give the resolution and the samples per pixel
    camera : its numbers replace the file's; None takes what the file says
    seed : of the sampler; same seed, same bits
    full : leave nothing out (every band, the scene's own integrator)
    progress : called with the fraction done

    Raises PixsimError where Mitsuba refuses the scene, or the picture is black or not finite.
    """
    camera = camera or scene.camera()
    state = scene.for_camera(camera)
    plan = make_plan(scene, state, full)
    if plan.lamp is not None and not (np.isfinite(plan.lamp.radiance).all() and plan.lamp.radiance.min() >= 0):
        raise refuse("emitter", f"radiance {plan.lamp.radiance.min():g}", "finite and not negative")
    sensor = sensor_node(state, scene.sensor_id)[1]
    height, width = film_size(state, sensor)
    spp = sample_count(state, sensor)
    for name, value, (low, high) in (("resolution", max(height, width), ALLOWED_RESOLUTION), ("spp", spp, ALLOWED_SPP)):
        if not low <= value <= high:
            raise refuse(name, value, f"{low} to {high}")
    pitch_um = 1e3 * camera.die_mm / width
    with speaking_mitsuba(scene.choice.variant, scene.path.parent) as mi:
        job = _Job(mi, scene, state, plan, camera, (height, width), spp, seed, progress)
        radiance = job.render([neutral_pulse()]) if plan.rank_one else _render_bands(job, plan)
    factor = optics.field_factor((height, width), pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification)
    header = provenance(scene, camera, plan, seed, job.runs * job.spp)
    bands = BAND_CENTRE_NM, BAND_WIDTH_NM, pitch_um
    if plan.rank_one:
        assert plan.lamp is not None
        on_axis = float(optics.irradiance_factor(camera.f_number, 0.0, camera.magnification)) * camera.transmittance
        relative = checked(radiance[:, :, 0] * (factor * camera.transmittance / on_axis))
        return SpectralImage(*bands, factors=([band_means(plan.lamp) * on_axis], relative[None]), header=header)
    return SpectralImage(*bands, data=checked(radiance * (camera.transmittance * factor[:, :, None])), header=header)


def provenance(scene: Scene, camera: Camera, plan: Plan, seed: int, spp: int) -> dict[str, Any]:
    """What made an irradiance; it depends on content only, so that equal inputs give equal files."""
    header = {
        "scene": scene.path.name,
        "scene_hash": scene.content_hash,
        "parameters": dict(scene.parameters),
        "camera": camera.model_dump(),
        "seed": seed,
        "spp": spp,
        "variant": scene.choice.variant,
        "plan": list(plan.reasons),
        "pixsim": pixsim.__version__,
    }
    if plan.lamp is not None:
        header["lamp_w_per_m2_sr_nm"] = band_means(plan.lamp).tolist()
    if plan.lamp is not None and plan.emissive_chart:
        header["luminance_cd_per_m2"] = float(f"{plan.lamp.luminance_cd_per_m2:.9g}")
    return header


def checked(values: Array) -> NDArray[np.float32]:
    """float32 for storage; PixsimError where the picture is not finite, negative or all black."""
    if not np.isfinite(values).all() or values.min() < 0:
        raise refuse(
            "rendered picture",
            "NaN, infinite or negative values",
            "finite light",
            "Check the scene's spectra and textures.",
        )
    if not values.any():
        raise refuse(
            "rendered picture",
            "black everywhere",
            "some light",
            "Lamps and charts shine to one side only: is the "
            "chart turned away, behind the camera, hidden by hide_emitters, or unlit?",
        )
    return values.astype(np.float32)


def neutral_pulse() -> dict[str, Any]:
    """One flat pulse: what a neutral picture needs."""
    return {"type": "regular", "wavelength_min": 540.0, "wavelength_max": 560.0, "values": "1, 1", "area": 20.0}


def _render_bands(job: _Job, plan: Plan) -> Array:
    radiance = np.zeros((*job.size, BAND_CENTRE_NM.size))
    for number, bands in enumerate(plan.passes):
        pulses = [band_pulse(plan.lamp, BAND_CENTRE_NM[band]) for band in bands]
        lit = [area > 0 for _, _, area in pulses]
        if all(lit):
            picture = job.render([_srf(nodes, values) for nodes, values, _ in pulses], number, len(plan.passes))
            for channel, (band, (_, _, area)) in enumerate(zip(bands, pulses, strict=True)):
                radiance[:, :, band] = picture[:, :, channel] * (area / BAND_WIDTH_NM)
        else:  # a lamp without light in some bands: the others one by one, since 3 pulses do not stratify
            for band, (nodes, values, area) in zip(bands, pulses, strict=True):
                if area > 0:
                    picture = job.render([_srf(nodes, values)], number, len(plan.passes))
                    radiance[:, :, band] = picture[:, :, 0] * (area / BAND_WIDTH_NM)
    return radiance


def _srf(nodes_nm: Array, values: Array) -> dict[str, Any]:
    text = ", ".join(repr(float(value)) for value in values)
    return {
        "type": "regular",
        "wavelength_min": float(nodes_nm[0]),
        "wavelength_max": float(nodes_nm[-1]),
        "values": text,
        "area": 1.0,
    }


class _Job:
    """One instantiated scene and what every pass over it shares."""

    def __init__(
        self,
        mi: Any,
        scene: Scene,
        state: Any,
        plan: Plan,
        camera: Camera,
        size: tuple[int, int],
        spp: int,
        seed: int,
        progress: Progress | None,
    ) -> None:
        self.mi, self.size, self.seed, self.progress = mi, size, seed, progress
        # Long renders are averages of shorter ones; multijitter rounds their samples up to what it can stratify.
        self.runs = -(-spp // SPP_PER_RENDER)
        self.spp = mi.load_dict({"type": "multijitter", "sample_count": -(-spp // self.runs)}).sample_count()
        self.scalar = scene.choice.variant.startswith("scalar")
        sensor = sensor_node(state, scene.sensor_id)[1]
        self.sensor = {key: value for key, value in plain(sensor) if key not in ("focal_length", "fov_axis")}
        self.sensor |= {
            "type": "thinlens",
            "fov": camera.fov_deg,
            "aperture_radius": camera.aperture_radius_m,
            "focus_distance": camera.object_distance_m,
            "sampler": {"type": "multijitter", "sample_count": self.spp},
        }
        if plan.lamp is not None:
            _take_out_lamp(mi, state, plan)
        for _, node in nodes_of(state, "Integrator"):
            if self.scalar and "block_size" not in node.props:
                node.props["block_size"] = SCALAR_BLOCK
        config = mi.parser.ParserConfig(scene.choice.variant)
        mi.parser.transform_all(config, state)
        built = mi.parser.instantiate(config, state)
        self.scene = next(each for each in built if isinstance(each, mi.Scene)) if isinstance(built, list) else built
        own = self.scene.integrator()
        # An emitter alone is seen at depth 1; a scene without an integrator gets unlimited paths.
        self.integrator = mi.load_dict({"type": "path", "max_depth": 1, "block_size": SCALAR_BLOCK}) if plan.rank_one else own
        if self.integrator is None:
            self.integrator = mi.load_dict({"type": "path", "block_size": SCALAR_BLOCK})

    def render(self, responses: list[dict[str, Any]], number: int = 0, of: int = 1) -> Array:
        """Radiance through each response over its area, (H, W, channels) float64: strips of rows, runs of samples."""
        height, width = self.size
        strips = SCALAR_STRIPS if self.scalar else -(-height * width * self.spp // SAMPLES_PER_KERNEL)
        rows = np.linspace(0, height, min(strips, height) + 1).astype(int)
        total = np.zeros((height, width, len(responses)))
        areas = np.array([response["area"] for response in responses])
        count = self.runs * (len(rows) - 1)
        for index in range(count):
            top, bottom = rows[index // self.runs], rows[index // self.runs + 1]
            sensor = self.mi.load_dict(self.sensor | self._film(responses, top, bottom))
            # Small consecutive seeds: the scalar variants multiply them by the number of pixels, modulo 2³².
            seed = (self.seed * of + number) * count + index
            strip = self.mi.render(self.scene, sensor=sensor, integrator=self.integrator, spp=self.spp, seed=seed % 2**32)
            values = np.asarray(strip, float)
            if values.shape[2] != len(responses):
                raise refuse("integrator", f"{values.shape[2]} channels a pixel", "one that gives radiance alone, as path")
            total[top:bottom] += values / self.runs
            if self.progress:
                self.progress((number + (index + 1) / count) / of)
        return total / areas

    def _film(self, responses: list[dict[str, Any]], top: int, bottom: int) -> dict[str, Any]:
        height, width = self.size
        film = {
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
            film[f"band{channel}"] = {key: value for key, value in response.items() if key != "area"}
        return {"film": film}


def _take_out_lamp(mi: Any, state: Any, plan: Plan) -> None:
    """Leave each emitter its neutral picture or relative power; the spectrum is in the bands."""
    assert plan.lamp is not None
    for index, (name, picture) in plan.lamp.pictures.items():
        props = state.nodes[index].props
        if isinstance(picture, int):
            props[name] = mi.Properties.ResolvedReference(picture)
        else:
            props[name] = mi.load_dict({"type": "uniform", "value": picture})  # a plain number would be a d65
