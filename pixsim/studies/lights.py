"""The light that pixels ask for, on a film that is fine enough; and the lights of a study: one for
all cases that see the same.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from pixsim.base.digits import counted
from pixsim.base.hashes import content_hash
from pixsim.base.notes import warn
from pixsim.base.progress import Progress, Stage, share_of
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import rendered_camera
from pixsim.scene.convergence import Rendered, RenderNoise, render_until
from pixsim.scene.film import fitting_width, largest_film
from pixsim.scene.plan import Plan, decide_oversampling, make_plan, make_render_plan
from pixsim.scene.scene import RESOLUTION, Scene
from pixsim.sensor.collection import check_efficiency
from pixsim.sensor.labels import label_in
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.design import (
    LIGHT_SETTINGS,
    Case,
    imaging_of,
    largest_pixel_um,
    light_hash,
    metrics_of,
    physics_of,
    pixel_of,
    study_pitches_um,
)
from pixsim.studies.engine import Workers, results_of, workers_here
from pixsim.studies.film_error import FilmError, measure_film
from pixsim.studies.light_answers import LightAnswers
from pixsim.studies.settings import Study
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import has_target
from pixsim.viewer.screen import white_header
from pixsim.viewer.setting import Run, Setting

_WORTH_WIDENING = 1.2
# Where a tolerance of ΔE bounds the film's error, the first film has so many times fewer samples
# across than planned, but not fewer than these.
_FIRST_COARSENING = 4
_MIN_SAMPLES_ACROSS = 64
# The render's share of the work on a film; the rest measures its error.
_RENDER_SHARE = 0.9
_CHART_RENDER_SHARE = 0.3


Render = Callable[[Scene, Plan], Rendered]


@dataclass(frozen=True)
class Light:
    """The irradiance on a sensor, rendered on the film chosen for it, or given by the user.

    camera : of the render
    film : the error of its film, or None for given light
    noise : of its render, or None for given light
    background : irradiance of the scene without its target, if a metric asks for it
    halves : independent ones of the render, of which the light is the mean; none without noise
    """

    image: SpectralImage
    camera: Camera
    film: FilmError | None = None
    noise: RenderNoise | None = None
    background: SpectralImage | None = None
    halves: tuple[SpectralImage, ...] = field(default=(), repr=False)

    @classmethod
    def rendered(cls, rendered: Rendered, camera: Camera, film: FilmError) -> Light:
        """Return the light of a render with the error of its film."""
        return cls(
            rendered.image, camera, film, rendered.noise, rendered.background, rendered.halves
        )


@dataclass(frozen=True)
class LightRequest:
    """What some pixels ask of one light.

    scene, plan : of the first film, as for `render_on_film`
    plan_of : returns the plan of the scene on another film
    settings : with the limits of the render, and its seed
    pixel : the least noisy pixel; the render noise is compared with its noise
    measured : pixels for which the error of the film is measured, with the camera
    """

    scene: Scene
    plan: Plan = field(repr=False)
    plan_of: Callable[[Scene], Plan] = field(repr=False)
    settings: Setting
    pixel: Pixel | PixelPhysics
    measured: Sequence[Imaging]

    @property
    def camera(self) -> Camera:
        """The camera, with its lens."""
        return self.measured[0].camera

    @property
    def first(self) -> Scene:
        """The scene on the first film."""
        resolution = self.plan.film.resolution
        return self.scene.with_resolution(resolution) if resolution else self.scene

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the first film in samples."""
        return self.first.film_shape(self.camera, self.first.for_camera(self.camera))

    @property
    def answers(self) -> LightAnswers:
        """The numbers whose errors end the render."""
        settings = self.settings
        return LightAnswers(
            self.measured,
            metrics_of(settings),
            settings.tolerance_delta_e,
            are_corrected=isinstance(settings, Run),
        )

    def render(
        self, scene: Scene, plan: Plan, *, use_cache: bool = True, progress: Progress | None = None
    ) -> Rendered:
        """Return the picture of a film, and its noise, within the limits of the settings; where a
        metric asks for it, also the picture of the scene without its target.

        The samples of both are the same: where both show the same, so is their noise.

        use_cache : use the cache of renders
        """
        render = partial(
            render_until,
            camera=self.camera,
            pixels=[self.pixel],
            exposure=self.measured[0].exposure,
            seed=self.settings.seed,
            use_cache=use_cache,
            render_noise=self.settings.render_noise,
            max_seconds=self.settings.max_seconds,
            progress=progress,
        )
        background = None
        if has_target(self.settings.metrics):
            _, width = scene.film_shape(self.camera, scene.for_camera(self.camera))
            bare = self._without_target(scene, width)
            background = bare, self.plan_of(bare)
            if background[1].samples.exact != plan.samples.exact:
                # One of both has no noise.
                rendered = render(scene, plan=plan)
                return replace(rendered, background=render(bare, plan=background[1]).image)
        # Without noise there is nothing to ask: workers do not know functions of the user's.
        answers = None if plan.samples.exact else self.answers
        return render(scene, plan=plan, answers=answers, background=background)

    def _without_target(self, scene: Scene, across: int) -> Scene:
        """Return a scene without its target, on a film of so many samples across."""
        stated = self.settings.metric.detectability.without
        if isinstance(stated, str):
            from pixsim.scene.scene import load_scene

            return load_scene(stated, variant=scene.choice.variant).with_resolution(across)

        return scene.with_parameters(**stated).with_resolution(across)

    def film_error(
        self, rendered: Rendered, plan: Plan, *, progress: Progress | None = None
    ) -> FilmError:
        """Return the error of a film, measured in its picture."""
        return measure_film(
            rendered.image,
            self.measured,
            halves=rendered.halves,
            chart=plan.film.chart,
            tolerance_delta_e=self.settings.tolerance_delta_e,
            use_cache=True,
            progress=progress,
        )


def rendered_light(request: LightRequest, progress: Progress | None = None) -> tuple[Light, Plan]:
    """Return the light that pixels ask for, within the limits of a command, and the plan of its
    film.

    Warns of what the plan warns of. Raises AlikeChannelsError if the colours of none of the pixels
    can be told apart.
    """
    scene = request.scene
    plan = request.plan
    settings = request.settings
    for note in plan.warnings:
        warn(note)
    render_share = _CHART_RENDER_SHARE if plan.samples.exact else _RENDER_SHARE

    def measure(rendered: Rendered, plan: Plan) -> FilmError:
        words = f", the error of a film of {rendered.image.shape[1]} samples across"
        part = share_of(progress, render_share, 1.0, words)
        return request.film_error(rendered, plan, progress=part)

    fixed = "set by resolution" if settings.resolution else ""
    is_free = not fixed and RESOLUTION not in scene.parameters
    bounds_error = settings.tolerance_delta_e is not None
    light, plan = render_on_film(
        scene,
        request.camera,
        plan,
        render=partial(request.render, progress=share_of(progress, 0.0, render_share)),
        plan_of=request.plan_of,
        measure=measure,
        fixed=fixed,
        max_seconds=settings.max_seconds,
        coarsening=_FIRST_COARSENING if is_free and bounds_error else 1,
    )
    return light, plan


def render_on_film(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    *,
    render: Render,
    plan_of: Callable[[Scene], Plan],
    measure: Callable[[Rendered, Plan], FilmError],
    fixed: str = "",
    max_seconds: float | None = None,
    coarsening: int = 1,
) -> tuple[Light, Plan]:
    """Render a scene on the film of its plan, and again on a film of twice the samples across while
    the error is too large.

    It stops where the order of convergence so far predicts that the widest film would not be fine
    enough either, for any of the pixels whose error is too large.

    The film depends on the settings only, not on the machine or the time, unless `max_seconds` is
    given.

    plan : for `scene`, with `resolution` if its film is not the scene's
    plan_of : returns the plan of the scene on another film
    measure : returns the film's error
    fixed : what sets the film, if it is not free
    coarsening : samples across the planned film over samples across the first film
    max_seconds : of all renders; a film that would take longer than the remaining time is not
        tried. None means a limit of the samples, `Plan.most_samples`.
    """
    if plan.film.resolution:
        scene = scene.with_resolution(plan.film.resolution)
    if coarsening > 1:
        height, width = scene.film_shape(camera, scene.for_camera(camera))
        first_width = max(_MIN_SAMPLES_ACROSS, width // coarsening)
        scene = scene.with_resolution(fitting_width(height / width, first_width, width))
        plan = plan_of(scene)

    ratio = camera.height_mm / camera.die_mm
    rendered_s = 0.0
    coarser_film: FilmError | None = None
    while True:
        start = time.perf_counter()
        rendered = render(scene, plan)
        seconds = time.perf_counter() - start
        rendered_s += seconds
        film = measure(rendered, plan)
        if film.within_tolerance:
            return Light.rendered(rendered, camera, film), plan

        width = rendered.image.shape[1]
        cells_in_time = plan.cells_in_time if max_seconds is None else math.inf
        max_across = largest_film(ratio, plan.light.planes, cells_in_time)
        wider = fitting_width(ratio, 2 * width, max_across)
        pictures = counted(plan.light.planes, "picture")
        sample_limit = f"the limit of {max_across} samples across for {pictures}"
        predicted = film.predicted_on(max_across, coarser_film)

        if fixed:
            limit = fixed
        elif wider < _WORTH_WIDENING * width:
            limit = sample_limit
        elif _is_out_of_reach(film, predicted):
            limit = f"about {max(predicted):.1g} ΔE would be left at {sample_limit}"
        elif max_seconds is not None and rendered_s + seconds * (wider / width) ** 2 > max_seconds:
            limit = "as max_seconds allows"
        else:
            coarser_film = film
            scene = scene.with_resolution(wider)
            plan = plan_of(scene)
            continue
        return Light.rendered(rendered, camera, replace(film, limit=limit)), plan


def _is_out_of_reach(film: FilmError, predicted: Sequence[float]) -> bool:
    """Return whether the widest film would not be fine enough for any pixel whose error is too
    large.

    predicted : error of the widest film for each pixel; comparisons with an unknown one are false
    """
    pixels = zip(film.delta_e, predicted, film.tolerated_delta_e, strict=True)
    return all(error <= tolerated or last > tolerated for error, last, tolerated in pixels)


def _finest_pixel(study: Study) -> PixelPhysics:
    """Return the pixel with the smallest photodiode of a study. Raises PixsimError if a stack
    passes less light than it detects.
    """
    smallest = [
        physics_of(study, name, float(study_pitches_um(study, name).min()))
        for name in study.technologies
    ]
    for physics in smallest:
        check_efficiency(physics)
    return min(smallest, key=lambda physics: physics.aperture_side_um)


def plan_of(scene: Scene, camera: Camera, settings: Run, full: bool = False) -> Plan:
    """Return the plan of the render of one frame."""
    return make_plan(
        scene,
        camera,
        settings.pixel,
        exposure=settings.exposure,
        display=settings.display,
        tolerance_e=settings.tolerance_e,
        full=full,
    )


def _study_plan(scene: Scene, camera: Camera, study: Study) -> Plan:
    """Return the plan of a study's render."""
    coloured = [name for name in study.technologies if study.options_of(name).colour is not None]
    pixels = [pixel_of(study, name, study.pitch.largest_um) for name in coloured]
    aperture_um = None if camera.lens is None else _finest_pixel(study).aperture_side_um
    return make_render_plan(
        scene, camera, pixels, aperture_um=aperture_um, tolerance_e=study.tolerance_e, exact=True
    )


def _first_film(study: Study, scene: Scene, camera: Camera) -> tuple[Scene, Plan]:
    """Return the scene on the film of its first render, which is fine enough for the study's
    smallest photodiode, and its plan.
    """
    # The film does not depend on a real lens's blur.
    plan = _study_plan(scene, rendered_camera(camera), study)
    resolution, _ = decide_oversampling(
        scene, plan, camera, _finest_pixel(study), study.display, full=False
    )
    if resolution is None and camera.lens is None:
        return scene, plan
    if resolution is not None:
        scene = scene.with_resolution(resolution)
    return scene, _study_plan(scene, camera, study)


def light_request(case: Case[Any]) -> LightRequest:
    """Return what the pixels of a case ask of its light.

    The noise is adequate for the largest pixel that a study allows, the least noisy one, and the
    film for the smallest photodiode. Neither depends on the pitches that are added, so a row does
    not depend on the others.
    """
    scene = case.scene
    camera = case.camera
    study = case.settings
    if isinstance(study, Run):
        full = case.imaging is not None and case.imaging.without_shortcuts
        run_plan = partial(plan_of, camera=camera, settings=study, full=full)
        return LightRequest(
            scene,
            run_plan(scene),
            run_plan,
            settings=study,
            pixel=study.pixel,
            measured=[Imaging.of(study, camera)],
        )

    scene, plan = _first_film(study, scene, camera)
    technology = study.technologies[0]
    return LightRequest(
        scene,
        plan,
        partial(_study_plan, camera=camera, study=study),
        settings=study,
        pixel=physics_of(study, technology, largest_pixel_um(study, technology)),
        measured=_measured_pixels(study, camera),
    )


def render_for(
    case: Case[Study], progress: Progress | None = None, film: FilmError | None = None
) -> Light:
    """Return the light of a case of a study.

    film : measured with more light. None measures the film of this light
    """
    study = case.settings
    request = light_request(case)
    try:
        if film is None:
            light, _ = rendered_light(request, progress)
        else:
            scene = request.scene.with_resolution(film.shape[1])
            rendered = request.render(scene, request.plan_of(scene), progress=progress)
            light = Light.rendered(rendered, request.camera, film)
    except AlikeChannelsError as error:
        label = label_in(study.technologies[0], case.words)
        raise AlikeChannelsError(f"{label}: none of its pixel sizes is possible. {error}") from None
    light.image.header.update(white_header(_smallest_pixels(study, light.image, light.camera)))
    return light


def _given_light(case: Case[Study], picture: SpectralImage) -> Light:
    """Return the light of a case whose light is given, with the white that it is shown with."""
    study = case.settings
    image = copy(picture)
    image.header = image.header | white_header(_smallest_pixels(study, image, case.camera))
    return Light(image, case.camera, background=case.background)


def _smallest_pixels(
    study: Study, image: SpectralImage, camera: Camera
) -> list[tuple[Imaging, SpectralImage]]:
    """Return the smallest pixels of each technology of a study, each with a picture, for the white
    that all of them share.
    """
    smallest_um = {name: float(study_pitches_um(study, name).min()) for name in study.technologies}
    return [
        (imaging_of(study, camera, name, pitch_um), image) for name, pitch_um in smallest_um.items()
    ]


def _measured_pixels(study: Study, camera: Camera) -> list[Imaging]:
    """Return the pixels for which the error of the film is measured: the smallest, a middle and the
    largest of the study.
    """
    technology = study.technologies[0]
    pitches_um = study_pitches_um(study, technology)
    measured_um = pitches_um[[0, pitches_um.size // 2, -1]].tolist()
    return [imaging_of(study, camera, technology, pitch_um) for pitch_um in measured_um]


def render_lights(
    cases: Sequence[Case[Study]],
    stage: Stage,
    workers: Workers,
    *,
    store: Callable[[SpectralImage], SpectralImage],
) -> list[Light | str]:
    """Return the light of each case, or the reason why none of its pixel sizes is possible; cases
    share a light if they differ in nothing that it depends on.

    Where Mitsuba traces no rays, which would take all processors by itself, processes of this
    machine make the lights.

    store : returns an image that need not stay in memory, where there are several lights
    """
    first_cases = {case.group: case for case in reversed(cases)}
    if cases[0].picture is not None:
        given_lights = {
            group: _given_light(case, case.picture)
            for group, case in first_cases.items()
            if case.picture is not None
        }
        return [given_lights[case.group] for case in cases]

    keys: dict[object, str] = {}
    different: dict[str, Case[Study]] = {}  # one case of each light, by the light's key
    for case in cases:
        if case.group not in keys:
            key = light_hash(first_cases[case.group].settings)
            keys[case.group] = key
            different.setdefault(key, first_cases[case.group])

    lights: dict[str, Light | str] = {}
    if len(different) == 1:
        lights = {key: _light_or_reason(case, stage("render")) for key, case in different.items()}
    elif light_request(cases[0]).plan.samples.exact:
        # A worker of a cluster may lack files of the user's, or have others of the same name.
        local_workers = workers if workers.client is None else workers_here()
        if workers.are_threads:  # which the kernels of a film have themselves
            local_workers = Workers()
        lights = _computed_lights(different, stage("render"), local_workers, store)
    else:
        for number, (key, case) in enumerate(different.items(), 1):
            progress = stage(f"render {number} of {len(different)}")
            lights[key] = _stored(_light_or_reason(case, progress), store)
    return [lights[keys[case.group]] for case in cases]


def _computed_lights(
    cases: Mapping[str, Case[Study]],
    progress: Progress,
    workers: Workers,
    store: Callable[[SpectralImage], SpectralImage],
) -> dict[str, Light | str]:
    """Return the lights of charts whose film cells are computed.

    Of cases that differ in the amount of light alone, the film of the brightest is measured. Where
    it is fine enough by far, the others have it too: with less light, noise hides more of the
    detail that a film may miss.
    """
    shared_keys = {key: _key_without_luminance(case) for key, case in cases.items()}
    brightest: dict[str, str] = {}
    for key in sorted(cases, key=lambda key: -_luminance(cases[key].settings)):
        brightest.setdefault(shared_keys[key] or key, key)
    measured_keys = list(brightest.values())
    further_keys = [key for key in cases if key not in measured_keys]

    films: dict[str, FilmError] = {}
    lights: dict[str, Light | str] = {}
    for keys in (measured_keys, further_keys):
        tasks = [((key, cases[key], films.get(shared_keys[key])), _nothing) for key in keys]
        for key, light in results_of(_render_task, tasks, workers):
            lights[key] = _stored(light, store)
            if isinstance(light, Light) and light.film and _is_well_within_tolerance(light.film):
                films.setdefault(shared_keys[key], light.film)
            progress(len(lights) / len(cases))
    return lights


def _is_well_within_tolerance(film: FilmError) -> bool:
    """Return whether the error of a film is far below the tolerated error."""
    return film.largest_delta_e <= _WELL_WITHIN * min(film.tolerated_delta_e)


LUMINANCE = "luminance_cd_per_m2"  # the parameter of a scene
_WELL_WITHIN = 0.1  # of the tolerated error


def _luminance(study: Study) -> float:
    """Return the luminance that a study sets; 0 without one."""
    stated = study.scene.parameters.get(LUMINANCE, 0.0)
    return float(stated) if isinstance(stated, float | int) else 0.0


def _key_without_luminance(case: Case[Study]) -> str:
    """Return a key that is equal for cases that differ in the amount of light alone; empty where a
    film holds for one case only.

    The display is as much brighter as the scene. In a time that is set, bright light saturates
    pixels, which hides detail.
    """
    study = case.settings
    luminance = _luminance(case.settings)
    if not luminance or study.exposure.integration_s is not None or has_target(study.metrics):
        return ""
    table = study.model_dump(mode="json", include=set(LIGHT_SETTINGS))
    table["scene"]["parameters"].pop(LUMINANCE)
    white = study.display.white_cd_per_m2
    if white is not None:
        table["display"]["white_cd_per_m2"] = float(f"{white / luminance:.9g}")
    return content_hash(table)


def _nothing() -> None:
    """Return what render tasks share."""


# The key of a light, its case, and the measured film of a brighter light, if there is one.
_LightTask = tuple[str, Case[Study], FilmError | None]


def _render_task(task: _LightTask, _: None) -> tuple[str, Light | str]:
    """Return the key of a task, and its light or the reason why there is none."""
    key, case, film = task
    return key, _light_or_reason(case, film=film)


def _light_or_reason(
    case: Case[Study], progress: Progress | None = None, film: FilmError | None = None
) -> Light | str:
    """Return the light of a case, or the reason why none of its pixel sizes is possible."""
    try:
        return render_for(case, progress, film)
    except AlikeChannelsError as error:
        return str(error)


def _stored(light: Light | str, store: Callable[[SpectralImage], SpectralImage]) -> Light | str:
    """Return a light whose image need not stay in memory; a reason as it is."""
    if isinstance(light, str):
        return light
    background = None if light.background is None else store(light.background)
    return replace(
        light,
        image=store(light.image),
        background=background,
        halves=tuple(map(store, light.halves)),
    )
