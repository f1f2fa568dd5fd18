"""Compare image sensors in one scene: mean ΔE of each, the differences from the first, and how sure
these are.

All sensors see the same field, on one display, in the same light. The first sensor and each other
one are compared as if no third one were there. Both frames of a pair have the random seeds of its
number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count, Jobs
from pixsim.base.files import output_folder
from pixsim.base.layers import listed
from pixsim.base.notes import Note, collected_notes, suppressed_warnings, warn
from pixsim.base.progress import Progress, Stage, no_stage, share_of
from pixsim.light.spectral import SpectralImage
from pixsim.scene.plan import Plan
from pixsim.sensor.pixel_options import BORDER_PIXELS
from pixsim.studies.comparison import ComparedSensor, Comparison
from pixsim.studies.design import Case, check_number, named, warn_of_reviews
from pixsim.studies.engine import Workers, workers_for
from pixsim.studies.evaluate import RenderedCase, check_ideals, evaluate_points, rendered_cases
from pixsim.studies.files import scene_of_python, tables_of_python
from pixsim.studies.film_error import cached_film_steps
from pixsim.studies.lights import Light, rendered_light
from pixsim.studies.prepare import SensorTypes
from pixsim.studies.sensors import PAIR, ComparisonJob, Match, SensorGroup, prepare
from pixsim.studies.settings import Study, check_supported
from pixsim.studies.table import ROWS_FILE, check_replaceable_results
from pixsim.studies.uncertainty import FEW_SENSORS, TYPES_FILE, PairUncertainty, sample_of
from pixsim.viewer.chain import make_chain
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.noise_budget import noise_budget
from pixsim.viewer.scene_light import PreparedScene
from pixsim.viewer.score import Score
from pixsim.viewer.screen import warn_of_clipping, white_header


def compare(
    files: Sequence[str | os.PathLike[str]],
    scene: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match | None = None,
    repeats: Count | None = None,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    quick: bool = False,
    jobs: Jobs | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    agreed: bool = False,
    out: str | os.PathLike[str] | None = None,
    uncertainty: int | None = None,
    sobol: int | None = None,
    smaller_than_um: Sequence[float] = (),
    light: SpectralImage | None = None,
    without: SpectralImage | None = None,
    axis: Sequence[Mapping[str, Any]] = (),
    condition: Sequence[Mapping[str, Any]] = (),
    metrics: Sequence[str | Callable[[Score], float]] = (),
    **settings: object,
) -> Comparison:
    """Compare two or more sensors in one scene, by the mean ΔE of their pictures on one display.

    files : of the sensors: TOML files with a table [pixel], such as data sheets; files of
        technologies, or names of packaged ones. The first is the reference
    scene : XML file, dictionary as `load_scene` takes it, or name of a packaged scene. None means
        the scene of the study, or csf
    study : a Study, the name of a packaged one, or a TOML file. Its scene, display, exposure and
        conditions hold for all sensors, and its lens for files that state none. Under conditions,
        the result holds for the weighted mean over them, and has `conditions`. With axes, the
        result has a comparison at each of their values as `cases`. Its pixels, technologies and
        pixel sizes are not used
    match : 'view': the field of view, f-number and object distance of the first file's camera for
        all; 'lens': the same focal length; 'own': each file's own camera. Only the central field
        that all have in common is compared. None means 'view', and says whether 'lens' turns the
        answer
    repeats : pairs of frames; frames of one number have the same seeds. None means 8, with `quick`
        4
    config : one or more TOML files with settings of all sensors, or of a study, which take
        precedence over the sensors' own files
    parameters : of the scene, each in its unit
    pixel : fields of all pixels, as {"bits": 12}
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant. None means the fastest that works
    quick : fewer pairs of frames, and the overrides of `study`, the file NAME.quick.toml next to
        its own
    jobs : processes. None means one per core where they are worth their start, or else threads. The
        results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers
        replace local processes
    progress : returns a callback for each named stage
    agreed : whether a comparison with axes or sensor types may take more than 100 000 evaluations
    out : folder whose results.csv keeps the numbers of each frame, so that an interrupted
        comparison goes on. None keeps nothing
    uncertainty : sensor types to draw from the ranges of technologies and [pixel.uncertainty] of
        data sheets, for the result's `uncertainty`; rounded up to a power of two. None means none
    sobol : in its place, number of points for total indices, which take sobol × (inputs + 2) sensor
        types
    smaller_than_um, light, without : of a study; a comparison refuses them
    axis, condition : tables of a study, in place of the tables of `study`: axis=[{"name": "lens",
        "set": "camera.f_number", "values": [2.0, 4.0]}]
    metrics : names of further metrics, or functions of a `Score`, each a number in its own unit;
        the verdict is by ΔE
    settings : tables and fields of `Study` for all sensors: camera={"f_number": 2.8}, exposure={…},
        display={…}, seed=3. They take precedence over the study, but not over its conditions. Those
        for pixel sizes change nothing

    Raises PixsimError for invalid input, before anything is rendered.

    >>> small = {"display": {"dots": 32}, "resolution": 64, "pixel": {"pitch_um": 60.0}}
    >>> result = compare(["0.35um", "4t-bsi"], repeats=2, jobs=1, camera={"die_mm": 2.7}, **small)
    >>> sorted(result.scores), result.difference["4t-bsi"] < 0  # a quieter pixel
    (['0.35um', '4t-bsi'], True)
    """
    check_supported("comparison", light=light, without=without)
    options = tables_of_python(settings, metrics)
    options |= {"scene": table} if (table := scene_of_python(scene, parameters)) else {}
    options |= {"pixel": dict(pixel)} if pixel else {}
    options |= {
        name: list(tables) for name, tables in (("axis", axis), ("condition", condition)) if tables
    }
    with collected_notes():  # the preparation warns, too
        job = prepare(
            files,
            study=study,
            match=match,
            repeats=repeats,
            config=listed(config),
            options=options,
            sensor=sensor,
            variant=variant,
            uncertainty=uncertainty,
            sobol=sobol,
            quick=quick,
            smaller_than_um=smaller_than_um,
        )
        return run_prepared(
            job, jobs=jobs, scheduler=scheduler, progress=progress, agreed=agreed, out=out
        )


def run_prepared(
    job: ComparisonJob,
    *,
    jobs: int | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    agreed: bool = False,
    out: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Run a prepared comparison. Further arguments are described at `compare`."""
    types = 1 if job.types is None else len(job.types.sample.quantiles)
    check_number(max(len(job.combinations), types), job.evaluations, agreed)
    stage = progress or no_stage
    with collected_notes() as notes, ExitStack() as stack:
        rows_file: Path | None = None
        types_file: Path | None = None
        if out is not None:
            folder = stack.enter_context(output_folder(out))
            rows_file = folder / ROWS_FILE
            types_file = folder / TYPES_FILE
            check_replaceable_results(rows_file)
            check_replaceable_results(types_file)
        workers: Workers | None = None
        if jobs is not None or scheduler is not None:
            workers = stack.enter_context(workers_for(jobs, scheduler))

        groups, lights = _render_groups(job, stage)
        cases = [case for group in groups for case in group.cases]
        rendered_sensors = rendered_cases(cases, [light for light, _ in lights])
        _check_sensors(groups, rendered_sensors)
        table = evaluate_points(
            rendered_sensors, rows_file, workers, lambda: stage("sense and score")
        )
        for case, rows in zip(cases, table.by_case(), strict=True):
            names = [name for name in (case.sensor, case.condition) if name]
            for reason in dict.fromkeys(rows.reasons.values()):
                warn(Note("undefined_metric", words=reason).of(names))

        compared = _compared_sensors(groups, rendered_sensors, lights, stage("error of the film"))
        result = Comparison(
            job=replace(job, groups=tuple(groups), cases=tuple(cases)),
            table=table,
            compared=tuple(compared),
        )
        if job.types is not None:
            distributions = _differences_of_types(
                job.types, result, rendered_sensors, types_file, workers, stage("sensor types")
            )
            result = replace(result, uncertainty=tuple(distributions))
    return replace(result, warned=tuple(notes))


def _check_sensors(groups: Sequence[SensorGroup], rendered_sensors: Sequence[RenderedCase]) -> None:
    """Raise PixsimError for sensors whose ideal images differ.

    Warns of what the display clips, and of what a review of the settings says.
    """
    for group in groups:
        members = [sensor for sensor in rendered_sensors if sensor.case.group == group.first.group]
        with named(group.words):
            check_ideals(members)
        for sensor in members:
            header = sensor.scenes.irradiance.header
            with named(sensor.case.sensor):
                prepared = sensor.light()
                assert isinstance(prepared, PreparedScene)
                warn_of_clipping(prepared.beyond_white, header, sensor.imaging.display)
    warn_of_reviews(
        (sensor.case.sensor, sensor.case, sensor.scenes.light) for sensor in rendered_sensors
    )


def _render_groups(
    job: ComparisonJob, stage: Stage
) -> tuple[list[SensorGroup], list[tuple[Light, Plan]]]:
    """Return the groups that differ, and the light of each of their sensors with the plan of its
    film.

    A pair that sees the same alone as among all sensors is not rendered again.
    """
    groups: list[SensorGroup] = []
    lights: list[tuple[Light, Plan]] = []
    rendered_widths: list[int] = []  # of the films of the groups
    for number, group in enumerate(job.groups):
        pair = str(group.first.labels.get(PAIR, ""))
        if pair and any(
            # The film may be finer than planned, for another sensor.
            width == other.film_width and _is_pair_among(group, pair, other)
            for other, width in zip(groups, rendered_widths, strict=True)
        ):
            continue

        # Pairs and further cases would repeat the warnings of the first groups.
        place = [group.words] if group.words else []
        if pair:
            place = [f"{pair} alone", *place]
        with ExitStack() as stack:
            if pair or number >= len(job.condition_groups()):
                stack.enter_context(suppressed_warnings())
            stack.enter_context(named(", ".join(place)))
            group_stage = partial(_stage_of_group, stage, (pair, group.words))
            group_lights = _lights_on_one_film(group, group_stage)
        groups.append(group)
        lights += group_lights
        rendered_widths.append(group_lights[0][0].image.shape[1])
    return groups, lights


def _is_pair_among(group: SensorGroup, pair: str, other: SensorGroup) -> bool:
    """Return whether a pair of sensors alone sees the same as in another group of its case.

    pair : label of the pair
    """
    if pair in other.first.labels.values():
        return False
    place = group.first.at, group.first.condition, group.match
    other_place = other.first.at, other.first.condition, other.match
    return other_place == place and group.sees_the_same(other)


def _stage_of_group(stage: Stage, words: tuple[str, ...], name: str) -> Progress:
    """Return the callback of a stage whose name begins with the pair and the case of a group."""
    return stage(": ".join(filter(None, (*words, name))))


def _lights_on_one_film(group: SensorGroup, stage: Stage) -> list[tuple[Light, Plan]]:
    """Return the light of every sensor with the plan of its film, all on one film that is fine
    enough for each.
    """
    width = group.film_width
    lights: list[tuple[Light, Plan]] = []
    while len(lights) < len(group.cases):
        case = group.cases[len(lights)]
        with named(case.sensor):
            lights.append(
                rendered_light(group.request(case, width), stage(f"render {case.sensor}"))
            )
        rendered_width = lights[-1][0].image.shape[1]
        if rendered_width > width:
            # The film of this sensor had to be finer: all are rendered on that one.
            width = rendered_width
            lights = []

    imagings = [
        Imaging.of(case.settings, case.camera).changed(
            display=group.display, border_um=group.border_um(case.camera)
        )
        for case in group.cases
    ]
    images = [light.image for light, _ in lights]
    # A plate's lights state their own white: one that ends at 830 nm has less of an infrared lamp.
    has_plate = bool(group.display.white)
    common_white = {} if has_plate else white_header(list(zip(imagings, images, strict=True)))
    for imaging, image in zip(imagings, images, strict=True):
        image.header |= white_header([(imaging, image)]) if has_plate else common_white
    return lights


def _compared_sensors(
    groups: Sequence[SensorGroup],
    rendered_sensors: Sequence[RenderedCase],
    lights: Sequence[tuple[Light, Plan]],
    progress: Progress,
) -> list[ComparedSensor]:
    """Return the sensors of a comparison with their light, first frame and errors of the film.

    lights : of each sensor, with the plan of its film
    """
    groups_by_number = {group.first.group: group for group in groups}
    count = len(rendered_sensors)
    compared = []
    for number, (sensor, (light, plan)) in enumerate(zip(rendered_sensors, lights, strict=True)):
        group = groups_by_number[sensor.case.group]
        sensor_progress = share_of(progress, number / count, (number + 1) / count)
        compared.append(_compared_sensor(group, sensor, light, plan, sensor_progress))
    progress(1.0)
    return compared


def _compared_sensor(
    group: SensorGroup,
    rendered: RenderedCase,
    light: Light,
    plan: Plan,
    progress: Progress | None = None,
) -> ComparedSensor:
    """Return a sensor of a comparison with its light, first frame and errors of the film.

    progress : of the measurement of the film's errors
    """
    case = rendered.case
    chain = make_chain(rendered.imaging.registered(0), rendered.light())
    score = chain.simulate(*case.stream, 0)
    is_pictured = not case.labels.get(PAIR) and group.weight > 0
    budget = None
    if case.settings.noise_budget and is_pictured:
        budget = noise_budget(chain, light.image, *case.stream, 0)

    time_s = score.frame.integration_s
    white_e = chain.white_e_per_s * time_s
    with suppressed_warnings():  # the result itself warns
        run_imaging = Imaging.of(case.settings, case.camera)
        largest_um = group.border_um(case.camera) / BORDER_PIXELS
        steps = cached_film_steps(
            light.image, run_imaging, plan.film.chart, largest_um, progress, halves=light.halves
        )
    return ComparedSensor(
        case=case,
        light=light,
        score=score,
        dark=dark_clip(score.readout, time_s, white_e),
        white_e=white_e,
        steps=steps,
        colour=None if chain.colour_chart is None else chain.development.colour_facts(time_s),
        budget=budget,
    )


def _differences_of_types(
    types: SensorTypes,
    result: Comparison,
    rendered_sensors: Sequence[RenderedCase],
    file: Path | None,
    workers: Workers | None,
    progress: Progress,
) -> list[PairUncertainty]:
    """Evaluate the sensor types of both sensors of each pair under all conditions, and return the
    differences of each pair.

    For each pair, the differences of ΔE come first, then the differences of further metrics. Warns
    of pairs without an unknown number.

    result : with the sensors as they are
    rendered_sensors : the cases of the comparison in their light
    file : as `results` of `evaluate_points`
    """
    first = result.names[0]
    uncertain: dict[str, list[SensorGroup]] = {}
    for other in result.names[1:]:
        if sample_of(types.sample, first, other).inputs:
            uncertain[other] = result.groups_of_pair(other)
        else:
            words = (
                f"{first} and {other}: nothing is drawn, since these two have no unknown numbers"
            )
            warn(Note("no_effect", words=words))
    base: dict[tuple[object, str], RenderedCase] = {}
    for other, groups in uncertain.items():
        numbers = [group.first.group for group in groups]
        for number, sensor in product(numbers, rendered_sensors):
            if sensor.case.group == number and sensor.case.sensor in (first, other):
                base[number, sensor.case.sensor] = sensor
    sensor_types = _rendered_types(types, list(base.values()))
    table = evaluate_points(sensor_types, file, workers, lambda: progress)

    uncertainties = []
    for (other, groups), metric in product(uncertain.items(), table.metrics):
        blocks = table.columns[metric.columns[0]].reshape(len(base), -1, FEW_SENSORS)
        values = dict(zip(base, blocks, strict=True))
        change = np.zeros(len(types.sample.quantiles))
        scatter = np.zeros((change.size, FEW_SENSORS))
        for group in groups:
            if group.weight:
                a = values[group.first.group, first]
                b = values[group.first.group, other]
                change += group.weight * (b.mean(axis=1) - a.mean(axis=1))
                scatter += group.weight * (b - a)

        # The types have few frames: they tell the change from the sensors as they are.
        differences = result.pairs(other, metric).differences
        as_is = float(differences[:FEW_SENSORS].mean())
        drawn_differences = float(differences.mean()) + (change - as_is)
        uncertainties.append(
            PairUncertainty(
                names=(first, other),
                drawn=types.sample,
                requested_draws=types.requested_draws,
                total=types.total,
                differences=drawn_differences,
                scatter_variances=scatter_variances(scatter),
                metric=metric,
            )
        )
    return uncertainties


def _rendered_types(types: SensorTypes, base: Sequence[RenderedCase]) -> list[RenderedCase]:
    """Return the sensor types of sensors in their light, all types of a sensor together."""
    cases: list[Case[Any]] = []
    lights: list[Light] = []
    for number, sensor in enumerate(base):
        case = sensor.case
        assert case.imaging is not None
        light = Light(
            sensor.scenes.irradiance, case.camera, background=sensor.scenes.light.background
        )
        for draw, imaging in enumerate(types.imagings(case.sensor, case.imaging)):
            cases.append(
                replace(
                    case,
                    imaging=imaging,
                    further_displays=(),
                    labels=case.labels | {"draw": draw},
                    group=(number, draw),
                    sizes={imaging.pixel.pitch_um: FEW_SENSORS},
                )
            )
            lights.append(light)
    return rendered_cases(cases, lights)


def scatter_variances(differences: Array) -> Array:
    """Return the variance of the mean of each type's frames that their common noise leaves,
    (types,).

    differences : (types, frames), in which all types have the same random numbers. What is left
        beside the means of types and of frames is the interaction of a two-way analysis of
        variance.
    """
    types, frames = differences.shape
    interaction = (
        differences
        - differences.mean(axis=1, keepdims=True)
        - differences.mean(axis=0)
        + differences.mean()
    )
    freedom = (frames - 1) * (types - 1) / types
    return np.asarray((interaction**2).sum(axis=1) / (freedom * frames))
