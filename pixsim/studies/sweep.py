"""Evaluate many sensors in one light: the frames of `pixsim.evaluate`, computed by the workers of a
study.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from pixsim.base.bounds import Count, Jobs, Whole
from pixsim.base.errors import invalid, name_fault
from pixsim.base.files import output_folder
from pixsim.base.layers import Layer
from pixsim.base.notes import Note, collected_notes, warn
from pixsim.base.progress import Stage, no_stage
from pixsim.base.records import checked
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import camera_with_lens
from pixsim.optics.exchange import camera_of_light
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import array_size_um
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.design import (
    BASE,
    Case,
    check_number,
    metrics_of,
    named,
    warn_of_reviews,
    with_range_ends,
)
from pixsim.studies.engine import Workers, workers_for
from pixsim.studies.evaluate import RenderedCase, check_ideals, evaluate_points, rendered_cases
from pixsim.studies.files import checked_study, config_layers, tables_of_python
from pixsim.studies.lights import Light
from pixsim.studies.prepare import (
    SensorTypes,
    UncertaintyRequest,
    check_axis_names,
    check_given_light,
    check_metrics,
    uncertainty_request,
    with_given_light,
)
from pixsim.studies.result import causes_of_frames, fill_notes
from pixsim.studies.sensors import case_overrides
from pixsim.studies.settings import (
    IGNORED_ELSEWHERE,
    Study,
    check_supported,
    parts_of_study,
    unused_settings,
)
from pixsim.studies.table import Table, check_replaceable_results
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import dot_edges_um, picture_size_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.scene_light import SceneLight
from pixsim.viewer.score import Score
from pixsim.viewer.screen import IdealFacts, warn_of_clipping, white_header, with_white
from pixsim.viewer.setting import Run
from pixsim.viewer.without_effect import SOLVE_FOR, UserSettings, warn_of_settings_without_effect

# Labels before the labels of axes and conditions.
PIXEL = "pixel"
_DRAW = "draw"
USUAL_REPEATS = 1
# Settings of a render, which have no effect on light that is given.
_RENDER_SETTINGS = ("tolerance_e", "render_noise", "resolution", "max_seconds")
# Settings of a study without effect in a sweep.
NOT_TAKEN = (*IGNORED_ELSEWHERE, "detail", "noise_budget", "quick", "resolution")
_SCENE_SETTINGS = ("window_mm", "tolerance_delta_e")
# Arguments that may be tables.
RECORDS = ("exposure", "display", "correction", "motion", "develop", "metric", "camera")


def sweep(
    light: SpectralImage,
    pixels: Mapping[str, Pixel] | Sequence[Pixel],
    *,
    camera: Camera | Mapping[str, Any] | None = None,
    exposure: Exposure | Mapping[str, Any] | None = None,
    display: Display | Mapping[str, Any] | None = None,
    correction: Correction | Mapping[str, Any] | None = None,
    motion: Motion | Mapping[str, Any] | None = None,
    develop: Develop | Mapping[str, Any] | None = None,
    metrics: Sequence[str | Callable[[Score], float]] = (),
    metric: MetricOptions | Mapping[str, Any] | None = None,
    without: SpectralImage | None = None,
    repeats: Count | None = None,
    seed: Whole | None = None,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    pixel: Mapping[str, Any] | None = None,
    quick: bool = False,
    jobs: Jobs | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    agreed: bool = False,
    out: str | os.PathLike[str] | None = None,
    uncertainty: int | None = None,
    sobol: int | None = None,
    smaller_than_um: Sequence[float] = (),
    axis: Sequence[Mapping[str, Any]] = (),
    condition: Sequence[Mapping[str, Any]] = (),
    scene: str | os.PathLike[str] | None = None,
    parameters: Mapping[str, float | int | str] | None = None,
    variant: str | None = None,
    **settings: object,
) -> Table:
    """Evaluate many sensors in one light, rendered or of another program.

    The frames equal the frames of `pixsim.evaluate`, and of `pixsim run --repeats`, with the same
    seed, bit for bit. Equal sensors have equal frames. All are shown with one white, and scored on
    the same dots: the border of the largest pixels is left out. So pixels of one size have the
    numbers of `evaluate`, and smaller pixels among larger ones have numbers of fewer dots.

    pixels : of each sensor; a list, or names -> pixels
    camera : of all. None means the camera in the light's header, or the default; a table overrides
        it
    exposure, display, correction, develop, motion, metric, without : of `pixsim.evaluate`, or
        tables of `pixsim.study`
    metrics : names of metrics, or functions of a Score that return a number; each has its columns.
        One that has no number for a frame, as NIIRS for one that is overexposed, is NaN, with a
        warning that says why. None means ΔE
    repeats : sensors of each kind; 1 by default
    seed : of the fixed patterns and the temporal noise; 0 by default
    config : one or more TOML files with settings of all sensors, which take precedence over the
        numbers of `pixels`
    pixel : fields of all pixels, as {"bits": 12}
    jobs : processes. None means one per core where they are worth their start, or else threads. The
        results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers
        replace local processes
    progress : returns a callback for each named stage
    agreed : whether a sweep with axes or sensor types may take more than 100 000 evaluations
    out : folder whose results.csv keeps the numbers of each frame, so that an interrupted sweep
        goes on. None keeps nothing
    uncertainty : sensor types to draw of each pixel from the ranges of its technology; rounded up
        to a power of two. The column `draw` has their number, and `base` for the pixels as stated;
        further columns have the drawn numbers
    sobol : in its place, number of points for total indices, which take sobol × (inputs + 2) sensor
        types
    axis, condition : tables of a study, whose values are columns: axis=[{"name": "light", "set":
        "exposure.integration_s", "values": [0.01, 0.1]}]. Pixels of one combination share white and
        dots
    scene, parameters, variant, smaller_than_um : of `pixsim.study`, each in its unit; they have no
        meaning in light that is given, or in a sweep, and are refused
    quick, settings : of `pixsim.study`; a warning names those without effect in a sweep

    Raises PixsimError as `evaluate` does, with the pixel's name or its place in the list, from 0.

    >>> import numpy as np
    >>> header = {"diffraction": False}
    >>> light = SpectralImage(
    ...     [550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header=header
    ... )
    >>> pixels = [Pixel(pitch_um=pitch_um, prnu=0) for pitch_um in (60.0, 84.8)]
    >>> display = Display(white_cd_per_m2=1000, dots=32)
    >>> table = sweep(light, pixels, camera=Camera(), display=display, jobs=1)
    >>> [(row["pixel"], row["pitch_um"]) for row in table], table[0]["mean_delta_e"] < 1
    ([(0, 60.0), (1, 84.8)], True)
    """
    pixels_by_name = _pixels_by_name(pixels)
    check_supported(
        "sweep",
        smaller_than_um=smaller_than_um,
        paper=settings.get("paper"),
        noise_budget=settings.get("noise_budget"),
    )
    check_given_light(scene=scene, parameters=parameters)
    records = (exposure, display, correction, motion, develop, metric, camera)
    tables: dict[str, Any] = dict(zip(RECORDS, records, strict=True))
    tables |= {"pixel": pixel, "seed": seed, "axis": list(axis), "condition": list(condition)}
    tables |= settings
    stated = {name: value for name, value in tables.items() if value is not None and value != []}
    layers = [*config_layers(config), Layer(tables_of_python(stated, metrics))]

    # All cases share the identity of the light, which is computed once.
    light = light.identified
    background = None if without is None else without.identified

    with collected_notes():
        plan, sensor_layers = _sweep_plan(layers, variant)
        unused = unused_settings(layers, NOT_TAKEN) + ["quick"] * quick
        cases = _prepare_cases(
            light, pixels_by_name, camera, plan, sensor_layers, background, unused
        )
        cases = _with_repeats(cases, repeats or USUAL_REPEATS)
        type_request = uncertainty_request(uncertainty, sobol, (), {})
        if type_request is not None:
            cases = _with_types(cases, type_request)
        _check_evaluations(cases, agreed)

        with ExitStack() as stack:
            results = None
            if out is not None:
                results = stack.enter_context(output_folder(out)) / "results.csv"
                check_replaceable_results(results)
            workers: Workers | None = None
            if jobs is not None or scheduler is not None:
                workers = stack.enter_context(workers_for(jobs, scheduler))
            return _evaluated(cases, light, results, workers, progress or no_stage)


def _with_repeats(cases: Sequence[Case[Run]], repeats: int) -> list[Case[Run]]:
    """Return cases with a number of sensors of each kind."""
    return [replace(case, sizes={case.settings.pixel.pitch_um: repeats}) for case in cases]


def _check_evaluations(cases: Sequence[Case[Run]], agreed: bool) -> None:
    """Raise PixsimError for very many evaluations, unless the user has agreed."""
    groups = {case.group for case in cases}
    evaluations = sum(sum(case.sizes.values()) for case in cases)
    check_number(len(groups), evaluations, agreed)


def _evaluated(
    cases: Sequence[Case[Run]],
    light: SpectralImage,
    results: Path | None,
    workers: Workers | None,
    stage: Stage,
) -> Table:
    """Evaluate prepared cases, and warn of frames without information and of clipped light.

    results : file that keeps the rows. None keeps nothing
    workers : None means local processes, if there is enough work for them
    stage : returns a callback for a named stage
    """
    lights = [Light(light, case.camera, background=case.background) for case in cases]
    sensors = rendered_cases(cases, lights)
    check_ideals(sensors)
    table = evaluate_points(sensors, results, workers, lambda: stage("evaluate"))
    _warn_of_frames(sensors, table, light)
    return table


def _pixels_by_name(pixels: Mapping[str, Pixel] | Sequence[Pixel]) -> Mapping[Any, Pixel]:
    """Return pixels by their names, or by their places in a list.

    Raises PixsimError without a pixel, and for a name that a table cannot hold.
    """
    by_name = pixels if isinstance(pixels, Mapping) else dict(enumerate(pixels))
    if not by_name:
        raise invalid("pixels", "none", "at least one Pixel")
    for name in by_name:
        if isinstance(name, int):
            continue
        fault = name_fault(name) if name else "is empty"
        if fault:
            got = f"a name that {fault}: {name!r:.80}"
            raise invalid("pixels", got, "names that are valid as table columns")
    return by_name


def _sweep_plan(layers: Sequence[Layer], variant: str | None) -> tuple[Study, list[Layer]]:
    """Return a study with the axes and conditions of a sweep, and the settings of all of its
    sensors as tables of `Run`.

    layers : settings of files and of Python

    Raises PixsimError for what only light of a scene has.
    """
    parts = [parts_of_study(layer) for layer in layers]
    sensor_layers = [run_layer for run_layer, _ in parts]
    scene_settings = {
        name: value
        for layer in sensor_layers
        for name, value in layer.table.items()
        if name in _SCENE_SETTINGS
    }
    study_layers = [study_layer for _, study_layer in parts]
    plan = checked_study([Layer({"name": "sweep"} | scene_settings), *study_layers])
    return with_range_ends(with_given_light(plan, variant)), sensor_layers


def _prepare_cases(
    light: SpectralImage,
    pixels: Mapping[Any, Pixel],
    camera: Camera | Mapping[str, Any] | None,
    plan: Study,
    sensor_layers: Sequence[Layer],
    given_background: SpectralImage | None,
    unused: Sequence[str],
) -> list[Case[Run]]:
    """Return each pixel at each combination of the axes and under each condition, checked, with
    white and border in common.

    camera : argument of `sweep`
    plan, sensor_layers : of `_sweep_plan`
    unused : names of settings without effect in a sweep

    Raises PixsimError with the name of the pixel.
    """
    cases: list[Case[Run]] = []
    stated_settings: list[UserSettings] = []
    has_background = given_background is not None
    for overrides in chain.from_iterable(case_overrides(plan)):
        labels = {
            name: ", ".join(filter(None, (f"pixel {name}", overrides.words))) for name in pixels
        }
        override_layers = [overrides.layer] if overrides.layer else []
        group: list[Case[Run]] = []
        for name, pixel in pixels.items():
            with named(labels[name]):
                table = Layer({"pixel": pixel.model_dump(exclude_unset=True)})
                run: Run = checked(Run, [table, *sensor_layers, *override_layers])
                case = _prepared_case(run, light, camera)
                group.append(overrides.labelled(case, **{PIXEL: name}))
            stated_settings.append(
                _user_settings(group[-1], light, unused, has_background=has_background)
            )

        background = check_metrics(
            group[0].settings,
            [case.settings.pixel for case in group],
            light,
            given_background,
            names=list(labels.values()),
        )
        for case in _with_one_screen(group, light, len(cases)):
            cases.append(replace(case, background=background))
    check_axis_names(plan, metrics_of(cases[0].settings).chosen, PIXEL, _DRAW)
    warn_of_reviews(
        (f"pixel {case.labels[PIXEL]}", case, SceneLight(light, given_background)) for case in cases
    )
    warn_of_settings_without_effect({"": stated_settings})
    return cases


def _user_settings(
    case: Case[Run], light: SpectralImage, unused: Sequence[str], *, has_background: bool
) -> UserSettings:
    """Return the settings of a sensor, of which some may have no effect.

    unused : names of settings without effect in a sweep
    has_background : whether light without the target is given, so that a file of it does not count
    """
    run = case.settings
    settings = UserSettings.from_records(_imaging_of_case(case), light)
    render_settings = [name for name in _RENDER_SETTINGS if name in run.model_fields_set]
    return replace(
        settings,
        names=tuple(dict.fromkeys((*settings.names, *unused, *render_settings))),
        settings=None if has_background else run,
        picture=light,
        not_taken=(*NOT_TAKEN, SOLVE_FOR),
    )


def _prepared_case(
    run: Run, light: SpectralImage, camera: Camera | Mapping[str, Any] | None
) -> Case[Run]:
    """Return a sensor in light that is given. Raises PixsimError if the display has too few dots
    for it.
    """
    if not isinstance(camera, Camera):
        camera = camera_of_light(light, run.camera, run.lens)
    elif run.lens.model_fields_set:
        camera = camera_with_lens(camera, run.camera, run.lens)
    imaging = Imaging.of(run, camera).changed(metrics=metrics_of(run), is_run=True)

    # Raises an error if not one dot is left within the border.
    physics = imaging.physics
    dot_edges_um(
        picture_size_um(light),
        physics.read_pitch_um,
        imaging.display,
        imaging.scored_border_um,
        array_size_um(light, camera),
        physics.registration,
    )
    return Case(
        run,
        sensor=imaging.technology.name,
        resolved=(light, camera),
        imaging=imaging,
        stream=("evaluate", run.seed),
        stream_has_pitch=False,
        sizes={run.pixel.pitch_um: USUAL_REPEATS},
    )


def _imaging_of_case(case: Case[Run]) -> Imaging:
    """Return the imaging of a case, which is prepared."""
    assert case.imaging is not None
    return case.imaging


def _with_one_screen(
    cases: Sequence[Case[Run]], light: SpectralImage, group: int
) -> Iterator[Case[Run]]:
    """Yield cases with one white, scored on the same dots: without the border of the largest
    pixels.
    """
    border_um = max(_imaging_of_case(case).scored_border_um for case in cases)
    imagings = [_imaging_of_case(case).changed(border_um=border_um) for case in cases]
    white = white_header([(imaging, light) for imaging in imagings])
    for case, imaging in zip(cases, imagings, strict=True):
        yield replace(
            case, group=group, imaging=imaging.changed(display=with_white(imaging.display, white))
        )


def _with_types(cases: Sequence[Case[Run]], type_request: UncertaintyRequest) -> list[Case[Run]]:
    """Return cases and their sensor types, labelled with the draw and the drawn numbers.

    Raises PixsimError if no number is unknown.
    """
    first = [
        replace(case, sensor=str(case.labels[PIXEL]))
        for case in cases
        if case.group == cases[0].group
    ]
    types = SensorTypes.of(type_request, first)
    unknowns = [unknown for members in types.sample.inputs.values() for unknown in members]
    base_labels = {_DRAW: BASE} | {unknown.name: unknown.value for unknown in unknowns}
    typed = [replace(case, labels=case.labels | base_labels) for case in cases]
    for number, case in enumerate(cases):
        imagings = types.imagings(str(case.labels[PIXEL]), _imaging_of_case(case))
        for draw, imaging in enumerate(imagings):
            labels = case.labels | {_DRAW: draw} | types.sample.draws[draw]
            typed.append(replace(case, labels=labels, group=(number, draw), imaging=imaging))
    return typed


def _warn_of_frames(cases: Sequence[RenderedCase], table: Table, light: SpectralImage) -> None:
    """Warn of metrics without a number, of frames without information, of automatic exposure that
    fills all alike, and of light that the display clips.
    """
    facts_by_light: dict[object, IdealFacts] = {}
    exposed: list[tuple[Exposure, Mapping[str, Any]]] = []
    for sensor, rows in zip(cases, table.by_case(), strict=True):
        label = ", ".join(filter(None, (f"pixel {sensor.case.labels[PIXEL]}", sensor.case.words)))
        for reason in dict.fromkeys(rows.reasons.values()):
            warn(Note("undefined_metric", words=reason).of([label]))
        if not len(rows.possible):
            continue

        exposed.append((sensor.imaging.exposure, rows.possible.columns))
        if sensor.light_id not in facts_by_light:
            facts = sensor.scenes.ideal_facts(sensor.light_key, sensor.imaging)
            facts_by_light[sensor.light_id] = facts
        lightness = facts_by_light[sensor.light_id].lightness
        for cause in causes_of_frames(light, sensor.imaging, lightness, rows.possible):
            if cause.is_uninformative:
                warn(cause.note.of([label]))
    for note in fill_notes(exposed):
        warn(note)
    brightest = max((facts.beyond_white for facts in facts_by_light.values()), default=0.0)
    warn_of_clipping(brightest, light.header, cases[0].imaging.display)
