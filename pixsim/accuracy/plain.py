"""The picture that plain Mitsuba makes of a scene: what a user would do without pixsim's plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pixsim import optics
from pixsim.bands import Pulse
from pixsim.mitsuba_xml import speaking_mitsuba
from pixsim.parameters import Camera
from pixsim.plan import Plan
from pixsim.renderer import Renderer, film, film_response
from pixsim.scene import Scene
from pixsim.spectral import SpectralImage

BAND_NM = 10.0
CENTRES_NM = np.arange(365.0, 826.0, BAND_NM)


def plain_picture(scene: Scene, camera: Camera, plan: Plan, sampler: str, spp: int) -> Callable[[], Callable[[int], SpectralImage]]:
    """47 bands of 10 nm, all of 360-830 nm, in one specfilm, the scene's own lamps, `path`, a sampled lens: seed -> irradiance."""

    def loaded() -> Callable[[int], SpectralImage]:
        job = Renderer(scene, camera, plan, 0)
        flat = [Pulse(nm - BAND_NM / 2, nm + BAND_NM / 2, np.ones(2)) for nm in CENTRES_NM.tolist()]
        height = job.size[0]
        factor = optics.field_factor(job.size, job.pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification)
        with speaking_mitsuba(scene.choice.variant, scene.path.parent) as mi:
            config = mi.parser.ParserConfig(scene.choice.variant)
            state = scene.for_camera(camera)
            mi.parser.transform_all(config, state)
            built = mi.parser.instantiate(config, state)
            world = next(each for each in (built if isinstance(built, list) else [built]) if isinstance(each, mi.Scene))
            lens: dict[str, Any] = job.sensor | {
                "type": "thinlens",
                "aperture_radius": camera.aperture_radius_m,
                "focus_distance": camera.object_distance_m,
                "sampler": {"type": sampler, "sample_count": spp},
                "film": film([film_response(each) for each in flat], job.size, 0, height),
            }
            sensor, integrator = mi.load_dict(lens), world.integrator() or mi.load_dict({"type": "path"})
        header = {"camera": camera.model_dump()} | (
            {} if plan.white_cd_per_m2 is None else {"luminance_cd_per_m2": plan.white_cd_per_m2}
        )
        lamps = [light.lamp.spectrum for light in plan.lights]
        if len(lamps) == 1 and lamps[0] is not None:
            edges = np.append(CENTRES_NM - BAND_NM / 2, CENTRES_NM[-1] + BAND_NM / 2)
            header["lamp_w_per_m2_sr_nm"] = lamps[0].cell_means(edges).tolist()

        def picture(seed: int) -> SpectralImage:
            with speaking_mitsuba(scene.choice.variant, scene.path.parent) as mi:
                radiance = np.asarray(mi.render(world, sensor=sensor, integrator=integrator, spp=spp, seed=seed), np.float32)
            irradiance = radiance * (factor * camera.transmittance / BAND_NM)[:, :, None].astype(np.float32)
            return SpectralImage(CENTRES_NM, np.full(CENTRES_NM.size, BAND_NM), job.pitch_um, data=irradiance, header=header)

        return picture

    return loaded
