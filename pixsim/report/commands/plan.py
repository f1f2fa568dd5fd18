"""`pixsim plan`: what a render needs."""

from __future__ import annotations

from pixsim.report.outline import plan_document
from pixsim.show.document import Document
from pixsim.studies.lights import plan_of
from pixsim.studies.prepare import file_of_scene, loaded_scene, warn_of_default_sensor
from pixsim.viewer.setting import Run


def plan_answer(settings: Run, *, full: bool, sensor: str | None, variant: str | None) -> Document:
    """Return the answer of `pixsim plan`; nothing is rendered. `pixsim.run` describes the
    arguments.

    Raises PixsimError for invalid input.
    """
    file = file_of_scene(settings)
    loaded = loaded_scene(
        file,
        settings.scene.parameters,
        settings.resolution,
        settings.display,
        variant=variant,
        sensor=sensor,
    )
    warn_of_default_sensor(loaded, [settings.camera], settings.pixel)
    plan = plan_of(loaded, loaded.camera(settings.camera, settings.lens), settings, full)
    return plan_document(plan, file, settings)
