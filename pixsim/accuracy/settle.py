"""`--tolerance-delta-e`: settings for a tolerance before the work, and the error budget after it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

from pixsim.accuracy.budget import Calibration, Effect, calibrate, effects, total
from pixsim.accuracy.choice import Choice, choose
from pixsim.accuracy.probe import Setup
from pixsim.convergence import RenderNoise
from pixsim.evaluations import pixel_of
from pixsim.parameters import Camera, Study
from pixsim.plan import make_render_plan
from pixsim.scene import Scene
from pixsim.technology import technology_of

FEWEST_REPEATS = 2  # of a study: fewer tell no interval


@dataclass(frozen=True)
class Settled:
    """A scene with the film that the tolerance asks for, the other settings, and what they were chosen from."""

    scene: Scene
    tolerance_delta_e: float
    calibration: Calibration
    choice: Choice

    def budget(self, noise: RenderNoise, bound_e: float | None, sensors: int) -> dict[str, Any]:
        """What stands in score.json and summary.json: the error of each source, with what came out.

        bound_e : None where the plan cannot bound all of it; then what it was asked for
        """
        width, spectral_e = self.choice.width, self.choice.tolerance_e if bound_e is None else bound_e
        found = effects(self.calibration, width, noise.fraction, spectral_e, sensors)
        whole = total(found)
        rows = {name: _finite(each) for name, each in found.items()}
        return {
            "tolerance_delta_e": self.tolerance_delta_e,
            "total": _finite(whole),
            "met": whole.delta_e <= self.tolerance_delta_e,
            "bounded": bound_e is not None,
            "settings": {
                "resolution": width,
                "render_noise": self.choice.render_noise,
                "tolerance_e": self.choice.tolerance_e,
                "sensors": sensors,
            },
            "sources": rows,
        }


def _finite(each: Effect) -> dict[str, float | None]:
    """To three digits; None where there is no such number (JSON knows no NaN)."""
    pairs = {"delta_e": each.delta_e, "optimum_um": each.optimum_um}
    return {name: float(f"{value:.3g}") if value == value else None for name, value in pairs.items()}


def settle(scene: Scene, camera: Camera, setup: Setup, tolerance_delta_e: float) -> Settled:
    """Calibrate (or take the cached calibration) and choose. Warns where no settings meet the tolerance."""
    plan = make_render_plan(scene, camera, setup.pixel)
    found = calibrate(scene, camera, plan, setup)
    free = "resolution" in scene.names and "resolution" not in scene.parameters
    choice = choose(found, tolerance_delta_e, film_is_free=free)
    if not choice.met:
        hint = "" if free else "; the film's resolution is set, leave it open"
        warnings.warn(
            f"no settings meet --tolerance-delta-e {tolerance_delta_e:g}: the finest leave {choice.expected_delta_e:.2g}{hint}",
            stacklevel=3,
        )
    chosen = scene.with_parameters(resolution=choice.width) if free else scene
    return Settled(chosen, tolerance_delta_e, found, choice)


def settled_study(study: Study, scene: Scene, camera: Camera) -> tuple[Study, Settled]:
    """The study with the settings of least work for its tolerance, calibrated around the optimum of its first technology."""
    assert study.tolerance_delta_e
    pixel = pixel_of(study, study.technologies[0], study.pitch.max_um)
    setup = Setup(
        camera,
        pixel,
        study.exposure,
        study.display,
        study.seed,
        at_optimum=True,
        border_um=study.pitch.largest_um,
        process=technology_of(study, study.technologies[0]),
    )
    settled = settle(scene, camera, setup, study.tolerance_delta_e)
    choice, parameters = settled.choice, dict(study.scene.parameters)
    if "resolution" in settled.scene.parameters:
        parameters["resolution"] = int(settled.scene.parameters["resolution"])
    own = {
        "render_noise": choice.render_noise,
        "tolerance_e": choice.tolerance_e,
        "repeats": min(max(FEWEST_REPEATS, choice.sensors), max(FEWEST_REPEATS, study.max_repeats)),
        "scene": study.scene.model_copy(update={"parameters": parameters}),
    }
    return study.model_copy(update=own), settled
