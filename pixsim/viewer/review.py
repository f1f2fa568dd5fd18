"""What a user should know of settings and their light before a score is believed: the notes of one review."""

from __future__ import annotations

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.infrared import light_notes
from pixsim.sensor.unit_slips import unit_slips
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import OF_TARGETS, has_target
from pixsim.viewer.scene_light import SceneLight


def review(imaging: Imaging, light: SceneLight) -> list[str]:
    """Return what should be said of a pixel in its light, a sentence each.

    Numbers of the pixel that are rather in another unit, light for which a model does not hold, light of another camera, and light
    that no metric asks for.
    """
    notes = [*camera_notes(imaging.camera, light.irradiance), *unit_slips(imaging.pixel)]
    notes += light_notes(imaging.physics, imaging.camera, light.irradiance)
    return notes + background_notes(imaging.metrics.names, light.background)


def camera_notes(camera: Camera, irradiance: SpectralImage) -> list[str]:
    """Return a note if light was rendered with another camera than the one that is given."""
    stated = irradiance.header.get("camera")
    if stated is None:
        return []
    rendered = Camera.model_validate(stated)
    if rendered.lights_like(camera):
        return []
    other = [name for name, value in camera if value != getattr(rendered, name)]
    return [f"the irradiance was rendered with another camera than the one given, of another {', '.join(other)}"]


def background_notes(metrics: tuple[str, ...], background: SpectralImage | None) -> list[str]:
    """Return a note if light without a target is given, and no metric, by its name, asks for it."""
    if background is None or has_target(metrics):
        return []
    return [f"without is not used: neither {' nor '.join(OF_TARGETS)} is among the metrics"]
