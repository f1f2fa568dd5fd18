"""What a study says to a comparison of sensors: the scene, the display and the exposure of all, and its conditions.

The sensors are those of the comparison: a study's own pixels, technologies and pixel sizes are not used.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pixsim.base.errors import invalid
from pixsim.base.notes import warn
from pixsim.base.parameters import Condition, Layer, Study, owner_of, paths_of
from pixsim.studies.study_file import checked_study, read_study

SHARED = (  # as `Run` has them
    *("exposure", "correction", "develop", "display", "seed"),
    *("tolerance_e", "render_noise", "resolution", "window_mm"),
)
DIE = ("die_mm", "die_height_mm", "pixels")  # of the camera: each sensor has its own
SIZE = ("pitch_um", "data_sheet_pitch_um")  # of the pixel, likewise
LABELS = ("name", "streams", "title", "sources", "paper", "condition", "quick")  # of a study, that say nothing of a sensor


@dataclass(frozen=True)
class Circumstances:
    """A study as a comparison takes it.

    plan : the study
    source : its file, or empty
    scene : file, or name of a packaged scene
    lens : [camera] without its die, and [lens], for files that state none of them
    shared : settings that take precedence over the sensors' files
    not_used : its settings that are not used, by their dotted names
    """

    plan: Study
    source: str
    scene: str
    lens: Layer
    shared: Layer
    not_used: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.plan.name

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions of the study."""
        return self.plan.condition

    def warn_of_unused(self, options: Mapping[str, Any]) -> None:
        """Warn of options, as tables of `Run`, that every condition overrides."""
        for path in paths_of(options):
            in_study = ("scene", "parameters", *path[1:]) if path[0] == "scene" else path
            if owner := owner_of(self.plan, in_study):
                warn(f"{'.'.join(path)} is not used: {owner} sets it")

    def layer_of(self, condition: Condition) -> Layer:
        """Return a condition's settings as tables of `Run`. Raises PixsimError for a setting that a comparison does not have."""
        source = f"{self.source}: condition {condition.name}" if self.source else f"condition {condition.name}"
        table = dict(condition.set)
        allowed = ("scene", "camera", "lens", "pixel", *(name for name in SHARED if name != "seed"))
        if others := [name for name in table if name not in allowed]:
            hint = "The sensors of a comparison have their numbers from their own files."
            raise invalid(source, f"set.{others[0]}", ", ".join(f"set.{name}" for name in allowed), hint)
        camera = table.get("camera")
        if isinstance(camera, Mapping) and (die := [name for name in DIE if name in camera]):
            raise invalid(source, f"set.camera.{die[0]}", "settings of the lens: each sensor has its own die")
        pixel = table.get("pixel")
        if isinstance(pixel, Mapping) and (own := [name for name in SIZE if name in pixel]):
            raise invalid(source, f"set.pixel.{own[0]}", "settings that leave each sensor its own pixel size")
        scene = table.pop("scene", {})
        if not isinstance(scene, Mapping):
            raise invalid(source, f"set.scene = {scene!r}", "set.scene.file, set.scene.parameters.<name>")
        if unknown := [name for name in scene if name not in ("file", "parameters")]:
            raise invalid(source, f"set.scene.{unknown[0]}", "set.scene.file, set.scene.parameters.<name>")
        return Layer(table | ({"scene": scene["parameters"]} if "parameters" in scene else {}), source)

    def scene_of(self, condition: Condition) -> str:
        """Return the scene's file in a condition."""
        scene = condition.set.get("scene")
        return str(scene.get("file", self.scene)) if isinstance(scene, Mapping) else self.scene


def study_of(study: Study | str | os.PathLike[str]) -> tuple[Layer, Study]:
    """Return a study as its file states it, and checked. Raises PixsimError for an invalid one."""
    layer = Layer(study.model_dump(mode="json", exclude_unset=True)) if isinstance(study, Study) else read_study(study)
    return layer, checked_study([layer])


def circumstances_of(study: Study | str | os.PathLike[str], scene: str | os.PathLike[str] | None = None) -> Circumstances:
    """Return what a study without axes says to a comparison.

    study : name of a packaged study, a TOML file, or a Study
    scene : in place of the study's, whose parameters are not used then

    Raises PixsimError for an invalid study.
    """
    layer, plan = study_of(study)
    table = layer.table
    lens = {key: value for key, value in table.get("camera", {}).items() if key not in DIE}
    shared = {key: table[key] for key in SHARED if key in table}
    if scene is None and plan.scene.parameters:
        shared["scene"] = table["scene"]["parameters"]
    not_used = [key for key in table if key not in (*SHARED, *LABELS, "scene", "camera", "lens")]
    not_used += [f"camera.{key}" for key in DIE if key in table.get("camera", {})]
    not_used += ["scene"] if scene is not None and "scene" in table else []
    file = plan.scene.file if scene is None else str(scene)
    of_lens = ({"camera": lens} if lens else {}) | {key: table[key] for key in ("lens",) if key in table}
    parts = Layer(of_lens, layer.source), Layer(shared, layer.source)
    return Circumstances(plan, layer.source, file, *parts, tuple(not_used))
