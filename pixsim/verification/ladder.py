"""Mean ΔE of a scene on films of more and more samples: its error against run time, as
`pixsim accuracy` shows it.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pixsim.base.arrays import Array
from pixsim.base.bounds import Whole
from pixsim.base.digits import estimate, number
from pixsim.base.notes import suppressed_warnings
from pixsim.base.progress import Progress, Stage, no_stage
from pixsim.base.result import Result
from pixsim.scene.film import fitting_width, largest_film
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import NO_MOTION
from pixsim.studies.design import Case
from pixsim.studies.files import scene_of_python
from pixsim.studies.film_error import (
    chains_of_film,
    light_error_and_limit,
    measure_film,
    score_with_noise,
    standard_noise_of,
)
from pixsim.studies.lights import LightRequest, light_request, rendered_light
from pixsim.studies.prepare import file_of_scene, loaded_scene, warn_of_default_sensor
from pixsim.verification.case import ExtremeCase
from pixsim.verification.extreme_cases import all_cases
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import NOT_MEASURED, LightError
from pixsim.viewer.screen import white_header
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.without_effect import UserSettings, field_names, warn_of_settings_without_effect

# Samples across the film, relative to those of a run.
EFFORTS = (0.25, 0.5, 1.0)
_QUICK_EFFORTS = (0.5, 1.0)
REFERENCE = 2.0
_REFERENCE_OF_CHART = 4.0
# Largest error of the reference, as a share of the smallest error that is shown.
_REFERENCE_ERROR_SHARE = 1 / 3
_MIN_ACROSS = 16


@dataclass(frozen=True)
class Rung:
    """Mean ΔE of one sensor on one film.

    across : samples of the film
    tolerance_delta_e : of the error by the render's noise; a film of twice the samples across has
        half of it. None where the render has no noise
    seconds : of render and score
    mean_delta_e : of the sensor
    light, light_limit : errors that pixsim states by itself, and their limits
    error_delta_e : difference from the reference; NaN without one
    """

    across: int
    tolerance_delta_e: float | None
    seconds: float
    mean_delta_e: float
    light: LightError = field(repr=False)
    light_limit: LightError = field(default=NOT_MEASURED, repr=False)
    error_delta_e: float = math.nan

    @property
    def stated_delta_e(self) -> float:
        """Sum of the errors by the film and by the noise of the render."""
        errors = self.light.film_delta_e, self.light.noise_delta_e
        return sum(math.nan if error is None else error for error in errors)

    def as_dict(self) -> dict[str, Any]:
        """Return the rung as in summary.json and ladder.csv."""
        values = {
            name: value
            for name, value in vars(self).items()
            if name not in ("light", "light_limit")
        }
        return values | {
            "film_delta_e": self.light.film_delta_e,
            "noise_delta_e": self.light.noise_delta_e,
        }


@dataclass(frozen=True)
class Accuracy(Result):
    """The errors of a scene's mean ΔE against run time, and extreme cases with known answers.

    name : of the scene
    rungs : films of less work than the default settings, and these, which come last
    reference : a film of more samples, or None if its own error is above a third of the smallest
        that is shown
    cases : extreme cases
    header : of the irradiance with the default settings
    settings : as the user states them
    seconds : wall time in s
    """

    name: str
    rungs: tuple[Rung, ...]
    reference: Rung | None
    cases: tuple[ExtremeCase, ...] = field(repr=False)
    header: dict[str, Any] = field(repr=False)
    settings: Run = field(repr=False)
    seconds: float

    def __repr__(self) -> str:
        rung = self.rungs[-1]
        failed = sum(not case.passed for case in self.cases)
        mean = f"mean ΔE {estimate(rung.mean_delta_e)}, error {number(rung.error_delta_e)}"
        return f"<Accuracy of {self.name}: {mean}, {failed} cases fail>"


def accuracy(
    scene: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    camera: Mapping[str, Any] | None = None,
    lens: Mapping[str, Any] | None = None,
    pixel: Mapping[str, Any] | None = None,
    exposure: Mapping[str, Any] | None = None,
    motion: Mapping[str, Any] | None = None,
    correction: Mapping[str, Any] | None = None,
    develop: Mapping[str, Any] | None = None,
    display: Mapping[str, Any] | None = None,
    seed: Whole | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    progress: Stage | None = None,
) -> Accuracy:
    """Measure the error of a scene's mean ΔE against run time, and check numerical stability at
    extreme settings.

    scene : XML file, dictionary as `load_scene` takes it, or name of a packaged scene. None takes
        that of `config`; a scene drops the parameters of one there
    quick : fewer films
    config : one or more TOML files with a sensor, its camera, exposure and display; later ones take
        precedence
    parameters : of the scene, each in its unit
    camera, lens, pixel, exposure, motion, correction, develop, display : fields of these tables,
        each in its unit, which override the files
    seed : of the render. None means the seed in `config`, or 0
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant. None means the fastest that works
    progress : returns a callback for each named stage

    Raises PixsimError for invalid input, and if the scene cannot be rendered or captured.

    >>> result = accuracy("csf", quick=True, camera={"die_mm": 0.4}, display={"dots": 32})
    >>> len(result.rungs), all(case.passed for case in result.cases)
    (2, True)
    """
    tables = {
        "camera": camera,
        "lens": lens,
        "pixel": pixel,
        "exposure": exposure,
        "motion": motion,
    }
    tables |= {
        "correction": correction,
        "develop": develop,
        "display": display,
        "scene": scene_of_python(scene, parameters),
    }
    settings = run_settings(
        config,
        {name: value for name, value in (tables | {"seed": seed}).items() if value is not None},
    )
    return measure_accuracy(
        settings, quick=quick, sensor=sensor, variant=variant, progress=progress or no_stage
    )


# The errors are those of the mean ΔE of a picture that stands still in steady light.
NOT_TAKEN = (
    "metrics",
    "metric",
    "noise_budget",
    "tolerance_delta_e",
    "max_seconds",
    "window_mm",
    "motion",
    "exposure.shutter",
    "exposure.line_time_us",
    *(name for name in field_names("exposure", Exposure) if "flicker" in name),
)


def measure_accuracy(
    settings: Run,
    *,
    quick: bool = False,
    sensor: str | None = None,
    variant: str | None = None,
    progress: Stage,
) -> Accuracy:
    """Return the result of `accuracy`. Raises PixsimError if the scene cannot be rendered or
    captured.
    """
    start = time.perf_counter()
    scene = loaded_scene(
        file_of_scene(settings),
        settings.scene.parameters,
        settings.resolution,
        settings.display,
        variant=variant,
        sensor=sensor,
    )
    camera = scene.camera(settings.camera, settings.lens)
    warn_of_default_sensor(scene, [settings.camera], settings.pixel)
    settings_in_use = UserSettings.from_setting(
        Imaging.of(settings, camera), settings, not_taken=NOT_TAKEN
    )
    warn_of_settings_without_effect({"": [settings_in_use]})
    still: dict[str, Any] = {
        "motion": NO_MOTION,
        "exposure": settings.exposure.steady,
        "metrics": ("delta_e",),
    }
    still |= dict.fromkeys(("tolerance_delta_e", "max_seconds", "window_mm"))
    request = light_request(Case(settings.model_copy(update=still), resolved=(scene, camera)))
    light, _ = rendered_light(request, progress("render"))
    assert light.noise is not None
    request = replace(
        request,
        settings=request.settings.model_copy(
            update={"tolerance_delta_e": light.noise.tolerance_delta_e}
        ),
    )
    rungs, reference = climb(
        request, light.image.shape[1], _QUICK_EFFORTS if quick else EFFORTS, progress("ladder")
    )
    progress("extreme cases")
    return Accuracy(
        name=scene.path.stem,
        rungs=rungs,
        reference=reference,
        cases=tuple(all_cases()),
        header=light.image.header,
        settings=settings,
        seconds=time.perf_counter() - start,
    )


def climb(
    request: LightRequest, across: int, efforts: Sequence[float], progress: Progress
) -> tuple[tuple[Rung, ...], Rung | None]:
    """Return the rungs of a ladder and its reference; the sensor and its noise are the same on all
    films.

    across : samples across the film of the default settings, whose effort is 1
    """
    camera = request.camera
    imaging = request.measured[0]
    ratio = camera.height_mm / camera.die_mm
    max_across = largest_film(ratio, request.plan.light.planes, math.inf)

    # The reference is finer still where the light is the exact mean of a chart.
    reference = REFERENCE
    if request.plan.samples.exact and _REFERENCE_OF_CHART * across <= max_across:
        reference = _REFERENCE_OF_CHART
    rung_efforts = list(efforts)
    if reference * across <= max_across:
        rung_efforts.append(reference)
    widths = {
        effort: fitting_width(ratio, max(_MIN_ACROSS, effort * across), max_across)
        for effort in rung_efforts
    }

    # The first measurement compiles kernels: its time counts for no rung.
    _measure(request, imaging, widths[efforts[0]], 1 / efforts[0], None)
    rungs: list[Rung] = []
    noise: Array | None = None
    for count, (effort, width) in enumerate(widths.items(), 1):
        rung, noise = _measure(request, imaging, width, 1 / effort, noise)
        rungs.append(rung)
        progress(count / len(widths), "")
    if len(rungs) == len(efforts):
        return tuple(rungs), None

    # Errors are differences from the finest film, if its own error is small beside them.
    *rungs, finest = rungs
    errors = [abs(rung.mean_delta_e - finest.mean_delta_e) for rung in rungs]
    if not finest.stated_delta_e < _REFERENCE_ERROR_SHARE * min(errors):
        return tuple(rungs), None
    with_errors = [
        replace(rung, error_delta_e=error) for rung, error in zip(rungs, errors, strict=True)
    ]
    return tuple(with_errors), finest


def _measure(
    request: LightRequest, imaging: Imaging, across: int, noise_factor: float, noise: Array | None
) -> tuple[Rung, Array]:
    """Return a rung, and the standard noise of its frame.

    noise_factor : tolerance of the render's noise, relative to that of the settings
    noise : standard noise of another rung's frame. None draws it
    """
    tolerance_delta_e = request.settings.tolerance_delta_e
    if tolerance_delta_e is not None:
        tolerance_delta_e *= noise_factor
    noisier_settings = request.settings.model_copy(update={"tolerance_delta_e": tolerance_delta_e})
    noisier_request = replace(request, settings=noisier_settings)
    scene = request.scene.with_resolution(across)
    plan = request.plan_of(scene)
    start = time.perf_counter()
    with suppressed_warnings():  # the default render gives them
        rendered = noisier_request.render(scene, plan, use_cache=False)
        image = rendered.image
        image.header |= white_header([(imaging, image)])
        (chain,) = chains_of_film([(image, imaging.display)], [None], imaging)
        if noise is None or noise.shape != chain.signal_e_per_s.shape:
            noise = standard_noise_of(chain, imaging, 0)
        mean_delta_e = score_with_noise(chain, noise).mean_delta_e
        seconds = time.perf_counter() - start
        film = measure_film(image, [imaging], chart=plan.film.chart, halves=rendered.halves)
    light, limit = light_error_and_limit(image.header, film)
    return Rung(across, tolerance_delta_e, seconds, mean_delta_e, light, limit), noise
