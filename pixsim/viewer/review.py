"""Review of settings and their light: notes on inputs that make a score doubtful."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pixsim.base.notes import Note, first_notes, warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel_notes import pixel_notes
from pixsim.sensor.unit_slips import unit_slips
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import SceneLight


def review(imaging: Imaging, light: SceneLight | None = None) -> list[Note]:
    """Return notes on a camera and its pixels in their light.

    Numbers that are rather in another unit, light for which a model does not hold, and
    light of another camera.

    light : None before it is rendered: only what the settings tell
    """
    if light is None:
        return unit_slips(imaging.camera, "camera") + pixel_notes(imaging.physics)
    notes = unit_slips(imaging.camera, "camera") + _camera_notes(imaging.camera, light.irradiance)
    return notes + pixel_notes(imaging.physics, imaging.camera, light.irradiance)


def warn_of_review(sensors: Mapping[str, Iterable[tuple[Imaging, SceneLight | None]]]) -> None:
    """Warn of each note of the review of several sensors, with the names of the sensors unless all
    have it.

    sensors : name -> the settings of each of its cases, with their light
    """
    names_by_note: dict[Note, list[str]] = {}
    for name, cases in sensors.items():
        notes = (note for imaging, light in cases for note in review(imaging, light))
        for note in dict.fromkeys(notes):
            names_by_note.setdefault(note, []).append(name)

    named_notes = [
        note if len(names) == len(sensors) else note.of(names)
        for note, names in names_by_note.items()
    ]
    for note in first_notes([named_notes]):
        warn(note)


def _camera_notes(camera: Camera, irradiance: SpectralImage) -> list[Note]:
    """Return a note if light was rendered with another camera."""
    stated = irradiance.header.get("camera")
    if stated is None:
        return []
    rendered = Camera.model_validate(stated)
    if rendered.lights_like(camera):
        return []
    other = [name for name, value in camera if value != getattr(rendered, name)]
    return [Note("other_camera", names=", ".join(other))]
