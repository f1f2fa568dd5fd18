"""What the pixels of a case ask of their light; and the lights of a study: one for all of its cases that see the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial

from pixsim.base.progress import Progress, Stage
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.convergence import RenderNoise, render_until
from pixsim.sensor.labels import label_in
from pixsim.studies.cases import Case
from pixsim.studies.engine import Workers, results_of, workers_here
from pixsim.studies.keys import light_hash
from pixsim.studies.oversampling import Demand, GivenLight, Light, rendered_light
from pixsim.studies.pixels import physics_of
from pixsim.studies.preparation import first_film, plan_of, smallest_pixels, study_plan
from pixsim.studies.sampling import border_on_um, imaging_of, largest_pixel_um, study_pitches_um
from pixsim.studies.sight import Sight, clearest
from pixsim.studies.study_settings import Study
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.raw_metrics import has_target
from pixsim.viewer.score import SeenPicture, white_header
from pixsim.viewer.setting import Run


def demand_of(case: Case[Run] | Case[Study], *, full: bool = False) -> Demand:
    """Return what the pixels of a case ask of its light.

    The noise is adequate for the largest pixel that a study allows, the least noisy one, and the film for the smallest photodiode.
    Neither depends on the pitches that are added, so a row does not depend on the others.

    full : whether no effect is left out of the light of a run
    """
    scene, camera, study, settled = case.scene, case.camera, case.settings, case.settled
    if isinstance(study, Run):
        planned = partial(plan_of, camera=camera, settings=study, full=full, film_is_known=settled is not None)
        return Demand(scene, planned(scene), planned, study, study.pixel, [Imaging.of(study, camera)], settled=settled)
    first = study.technologies[0]
    scene, plan = first_film(study, scene, camera)
    pitches_um = study_pitches_um(study, first).tolist() if study.options_of(first).colour is not None else []
    larger = [imaging_of(study, camera, first, pitch_um) for pitch_um in pitches_um]
    largest, of_film = physics_of(study, first, largest_pixel_um(study, first)), partial(study_plan, camera=camera, study=study)
    return Demand(scene, plan, of_film, study, largest, measured_pixels(study, camera), larger, settled)


def render_for(case: Case[Study], progress: Progress | None = None) -> Light:
    """Return the light of a case of a study."""
    study, demand = case.settings, demand_of(case)
    try:
        light, _ = rendered_light(demand, progress)
    except AlikeChannelsError as error:
        label = label_in(study.technologies[0], case.words)
        raise AlikeChannelsError(f"{label}: none of its pixel sizes is possible. {error}") from None
    light.image.header.update(white_header(seen_by_all(study, light.image, light.camera), study.display))
    return light


def given_light(case: Case[Study], picture: SpectralImage) -> GivenLight:
    """Return the light of a case whose light is given, with the white that it is shown with."""
    study, image = case.settings, copy(picture)
    image.header = image.header | white_header(seen_by_all(study, image, case.camera), study.display)
    return GivenLight(image, case.camera, without=case.without)


def seen_by_all(study: Study, image: SpectralImage, camera: Camera) -> list[SeenPicture]:
    """Return a picture as the smallest pixels of each technology of a study see it, for the white that all of them share."""
    return [SeenPicture(image, camera, physics, border_on_um(study, camera)) for physics in smallest_pixels(study)]


def measured_pixels(study: Study, camera: Camera) -> list[Imaging]:
    """Return the pixels for which the error of the film is measured: the smallest, a middle and the largest of the study."""
    first = study.technologies[0]
    pitches_um = study_pitches_um(study, first)
    return [imaging_of(study, camera, first, float(pitches_um[place])) for place in (0, pitches_um.size // 2, -1)]


def lights_of_cases(
    cases: Sequence[Case[Study]], stage: Stage, workers: Workers, *, store: Callable[[SpectralImage], SpectralImage]
) -> list[Light | GivenLight | str]:
    """Return the light of each case; cases that differ in nothing that it depends on share one.

    In its place stands the reason why none of a case's pixel sizes is possible.
    Where Mitsuba traces no rays, which would take all processors by itself, processes of this machine make them.

    store : returns an image that need not stay in memory, where there are several lights
    """
    if cases[0].picture is not None:
        return [given_light(case, case.picture) for case in cases if case.picture is not None]
    keys = [light_hash(case.settings) for case in cases]
    different: dict[str, Case[Study]] = {}
    for key, case in zip(keys, cases, strict=True):
        different.setdefault(key, case)
    lights: dict[str, Light | str] = {}
    if len(different) == 1:
        lights = {keys[0]: _light_or_reason(cases[0], stage("render"))}
    elif demand_of(cases[0]).plan.exact:
        # A worker of a cluster may lack files of the user's, or have others of the same name.
        here = workers if workers.client is None else workers_here()
        lights = _computed_lights(different, stage("render"), here, store)
    else:
        for key, case in different.items():
            lights[key] = _stored(_light_or_reason(case, stage(f"render {len(lights) + 1} of {len(different)}")), store)
    return [lights[key] for key in keys]


def _computed_lights(
    cases: Mapping[str, Case[Study]], progress: Progress, workers: Workers, store: Callable[[SpectralImage], SpectralImage]
) -> dict[str, Light | str]:
    """Return the lights of charts whose film cells are computed.

    Of the films that show the same, the clearest is measured; if it is surely fine enough, so are the others.
    """
    seen: dict[str, tuple[SpectralImage, Camera, RenderNoise]] = {}
    sights: dict[str, Sight] = {}
    for done, (key, found) in enumerate(results_of(_see_task, [(task, _nothing) for task in cases.items()], workers), 1):
        if found is not None:
            image, camera, noise, sights[key] = found
            seen[key] = store(image), camera, noise
        progress(done / (2 * len(cases)))
    measured_in = {key: key for key in cases} | clearest(sights)
    lights: dict[str, Light | str] = {}
    left = [key for key in cases if measured_in[key] == key]
    while left:
        for key, light in results_of(_render_task, [((key, cases[key]), _nothing) for key in left], workers):
            lights[key] = _stored(light, store)
            progress((len(cases) + len(lights)) / (2 * len(cases)))
        for key, of in measured_in.items():
            measured = lights[of]
            if key not in lights and not isinstance(measured, str) and measured.film.surely_met:
                image, camera, noise = seen[key]
                lights[key] = Light(image, camera, measured.film.for_other_noise, noise)
        left = [key for key in cases if key not in lights]
    return lights


def _nothing() -> None:
    """Return what render tasks share."""


LightTask = tuple[str, Case[Study]]  # its key


def _see_task(task: LightTask, _: None) -> tuple[str, tuple[SpectralImage, Camera, RenderNoise, Sight] | None]:
    """Return the key of a task, and its light on the first film of `render_for`, and what pixels see of it.

    None in place of the light if it takes samples, or if the film may be too coarse.
    """
    key, case = task
    study, demand = case.settings, demand_of(case)
    if not demand.plan.exact or has_target(study.metrics):  # which takes another light beside it
        return key, None
    camera, plan = demand.camera, demand.plan
    image, noise = render_until(demand.scene, camera, plan, [], study.exposure, study.seed, render_noise=study.render_noise)
    image.header.update(white_header(seen_by_all(study, image, camera), study.display))
    sight = Sight.of(image, demand.measured, plan.chart)
    return key, (image, camera, noise, sight) if sight else None


def _render_task(task: LightTask, _: None) -> tuple[str, Light | str]:
    """Return the key of a task, and its light or the reason why there is none."""
    key, case = task
    return key, _light_or_reason(case)


def _light_or_reason(case: Case[Study], progress: Progress | None = None) -> Light | str:
    """Return `render_for`, or the reason why none of the study's pixel sizes is possible."""
    try:
        return render_for(case, progress)
    except AlikeChannelsError as error:
        return str(error)


def _stored(light: Light | str, store: Callable[[SpectralImage], SpectralImage]) -> Light | str:
    """Return a light whose image need not stay in memory; a reason as it is."""
    if isinstance(light, str):
        return light
    return replace(light, image=store(light.image), without=light.without and store(light.without))
