"""Run a study: mean ΔE for many pixel sizes, technologies and sensors.

An interrupted study can be resumed; its results do not depend on the number of workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import Jobs
from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import output_folder
from pixsim.base.hashes import content_hash
from pixsim.base.layers import listed
from pixsim.base.notes import Note, collected_notes, first_notes, warn
from pixsim.base.progress import Progress, Stage, no_stage
from pixsim.base.toml import SETTINGS_FILE
from pixsim.light.spectral import DIGEST, SpectralImage
from pixsim.light.stored import PictureFile
from pixsim.sensor.labels import label_of
from pixsim.studies.claims import (
    REFERENCE_TECHNOLOGY,
    Evidence,
    Finding,
    reference_rows,
    scaling_rows,
)
from pixsim.studies.curve import Curve, DisplayOptimum, Rounds, curve_of, on_first_display
from pixsim.studies.design import (
    Case,
    Sizes,
    check_number,
    metrics_of,
    single_technology_table,
    study_pitches_um,
    warn_of_reviews,
)
from pixsim.studies.dry_run import workers_of_study
from pixsim.studies.engine import Workers, results_of, workers_for
from pixsim.studies.evaluate import (
    Counts,
    RenderedCase,
    check_ideals,
    evaluate_points,
    ideal_facts,
    rendered_cases,
)
from pixsim.studies.files import (
    load_study,
    scene_table,
    settings_text,
    spreads_of_study,
    tables_of_python,
    uncertainty_of,
)
from pixsim.studies.lights import Light, render_lights
from pixsim.studies.prepare import (
    Job,
    UncertaintyRequest,
    cases_of_sensors,
    check_given_light,
    check_types,
    prepare,
    uncertainty_request,
)
from pixsim.studies.result import CasesResult, StudyResult, causes_of_curve
from pixsim.studies.settings import Study
from pixsim.studies.table import DOTS, Label, Table, check_replaceable_results
from pixsim.studies.uncertainty import (
    FEW_SENSORS,
    MAX_TYPE_EVALUATIONS,
    Sample,
    UncertaintyResult,
    drawn_metrics,
    few_pitches_um,
    sample_of,
    settings_of,
    types_file,
)
from pixsim.viewer.merging import merge
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.score import Score
from pixsim.viewer.screen import allows_float32, warn_of_clipping
from pixsim.viewer.settings_file import scene_options

if TYPE_CHECKING:
    from pixsim.sensor.spread import Uncertainty

MAX_SEARCHED_CASES = 64  # of a study whose curves with an open end get more sizes and sensors


def _repeated_settings(
    job: Job[Study],
    image: SpectralImage,
    spreads: Uncertainty,
    type_request: UncertaintyRequest | None = None,
) -> str:
    """Return the text of settings.toml, from which `pixsim study` makes the same numbers again.

    image : the render of the study
    spreads : [pixel.uncertainty] of the study and its data sheets, as its files state it
    type_request : about its unknown numbers
    """
    from pixsim.scene.convergence import repeatable_settings

    if isinstance(job.source, SpectralImage):
        arguments = "light=…"
        digests = str(image.header[DIGEST])
        background = job.cases[0].background
        if background is not None:
            arguments += ", without=…"
            digests += f" and, without its target, {background.header[DIGEST]}"
        command = (
            f"pixsim.study('{SETTINGS_FILE}', out, {arguments}), of the light of digest {digests}"
        )
        return settings_text(job.complete, command, spreads_of_study(job.complete, spreads))

    scene = job.source
    settings = repeatable_settings(job.complete, image)
    parameters = scene_table(scene.path.parent, settings.scene.parameters)
    camera = scene.camera(settings.camera, settings.lens).options.model_dump(exclude_none=True)

    # A study with both dots and distance has no further displays: one of them stays open if it was.
    left_open = set()
    if any(case.further_displays for case in job.cases):
        has_distance = "samples_per_deg" in job.stated.display.model_fields_set
        left_open.add("dots" if has_distance else "samples_per_deg")
    display = settings.display.model_dump(mode="json", exclude_none=True, exclude=left_open)
    return settings_text(
        settings,
        _repeating_command(job.variant, type_request),
        spreads_of_study(settings, spreads),
        scene=scene_options(settings.scene.file, parameters),
        camera=camera,
        display=display,
    )


def _repeating_command(variant: str | None, type_request: UncertaintyRequest | None = None) -> str:
    """Return the command that repeats a study in the folder of its settings.toml."""
    words = ["pixsim", "study", SETTINGS_FILE]
    if variant:
        words += ["--variant", variant]
    if type_request is not None:
        words += ["--sobol" if type_request.total else "--uncertainty", str(type_request.draws)]
        for size_um in type_request.smaller_than_um:
            words += ["--smaller-than", repr(size_um)]
    return " ".join(words)


def _on_further_displays(study: Study, curve: Curve, table: Table) -> tuple[DisplayOptimum, ...]:
    """Return the optima of a curve on the further displays of its case, from the first sensors of
    each size.
    """
    if DOTS not in table.columns or not curve.judged_by_delta_e:
        return ()
    _, *further_dots = dict.fromkeys(table.columns[DOTS].tolist())
    optima = []
    for dots in further_dots:
        display_curve = curve_of(study, curve.technology, table.where(dots=dots), (DELTA_E,))
        optima.append(DisplayOptimum(dots, display_curve.optimum))
    return tuple(optima)


def _with_films(case_lights: Sequence[tuple[Case[Study], Light]]) -> list[Case[Study]]:
    """Return cases whose settings state the width of the film of their light.

    The cases of a group share their settings.
    """
    settings: dict[object, Study] = {}
    for case, light in case_lights:
        if case.group not in settings:
            film = None if light.film is None else light.image.shape[1]
            settings[case.group] = case.settings.model_copy(update={"resolution": film})
    return [replace(case, settings=settings[case.group]) for case, _ in case_lights]


def _evaluate_cases(
    cases: Sequence[Case[Study]],
    lights: Sequence[Light],
    view: Mapping[str, Any],
    results: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
    on_start: Callable[[StudyResult], None] | None = None,
) -> tuple[list[StudyResult | str], Counts, Table]:
    """Evaluate missing rows of results.csv, add pitches and sensors until the interval is short
    enough, and fit the optima.

    on_start : called once with a study of one case in its light, without curves, when workers have
        made its first evaluations

    Returns the result of each combination, or the reason why too few of its pixel sizes are
    possible, how much was computed, and the table of all points.
    """
    rendered_sensors = rendered_cases(cases, lights)
    by_scene: dict[tuple[str, str], list[RenderedCase]] = {}
    for sensor in rendered_sensors:
        scene = sensor.case.settings.scene.file, sensor.case.condition
        by_scene.setdefault(scene, []).append(sensor)
    for sensors in by_scene.values():
        check_ideals(sensors)

    groups: dict[object, list[int]] = {}
    for number, case in enumerate(cases):
        groups.setdefault(case.group, []).append(number)
    rounds = Rounds(rendered_sensors, len(groups) <= MAX_SEARCHED_CASES)
    counts = Counts(0, 0, 0)

    # A study of one case is shown as soon as its workers have begun.
    pending = [on_start] if on_start is not None and len(groups) == 1 and workers.jobs > 1 else []
    begun_result = StudyResult(
        cases[0].settings, (), lights[0], view=dict(view), prepared_sensors=tuple(rendered_sensors)
    )

    def evaluation_progress() -> Progress:
        report = progress() or no_stage("")

        def evaluated(share: float) -> None:
            if pending:
                start = pending.pop()
                start(begun_result)
            report(share)

        return evaluated

    has_target = any(case.settings.target_ci_um is not None for case in cases)
    table = evaluate_points(
        rendered_sensors,
        results,
        workers,
        evaluation_progress,
        further_sizes=rounds.more,
        on_case_done=rounds.curve,
        counts=counts,
        in_parts=has_target,
    )

    tables = table.by_case()
    curves = [rounds.curve(number, rows) for number, rows in enumerate(tables)]
    _warn_of_left_out(rendered_sensors, curves)
    warn_of_reviews(
        (label_of(sensor.case.sensor), sensor.case, sensor.scenes.light)
        for sensor, curve in zip(rendered_sensors, curves, strict=True)
        if isinstance(curve, Curve)
    )

    combinations: list[StudyResult | str] = []
    for members in groups.values():
        member_curves = [
            (rendered_sensors[number], curves[number], tables[number]) for number in members
        ]
        rows = table.take(np.isin(table.case, members))
        combinations.append(_combination_result(member_curves, lights[members[0]], view, rows))
    return combinations, counts, table


def _combination_result(
    members: Sequence[tuple[RenderedCase, Curve | str, Table]],
    light: Light,
    view: Mapping[str, Any],
    rows: Table,
) -> StudyResult | str:
    """Return the result of one combination of axes and condition, or the reason why a sensor of it
    has no curve.

    members : each sensor in its light, its curve, and the evaluations of the curve
    rows : evaluations of all sensors
    """
    for _, curve, _ in members:
        if isinstance(curve, str):
            return curve
    facts = [ideal_facts(sensor, min(sensor.case.sizes)) for sensor, _, _ in members]
    for (sensor, _, _), fact in zip(members, facts, strict=True):
        warn_of_clipping(fact.beyond_white, light.image.header, sensor.imaging.display)

    complete = []
    for (sensor, curve, table), fact in zip(members, facts, strict=True):
        assert isinstance(curve, Curve)
        case = sensor.case
        causes = causes_of_curve(sensor, curve, fact.lightness, on_first_display(table))
        labels = replace(curve.case, at=case.at, condition=case.condition, alone=case.one_at_a_time)
        errors = replace(curve.errors, causes=causes)
        on_displays = _on_further_displays(case.settings, curve, table)
        complete.append(replace(curve, case=labels, errors=errors, on_displays=on_displays))
    sensors = tuple(sensor for sensor, _, _ in members)
    return StudyResult(
        sensors[0].case.settings,
        tuple(complete),
        light,
        view=dict(view),
        table=rows,
        prepared_sensors=sensors,
    )


def _warn_of_left_out(cases: Sequence[RenderedCase], curves: Sequence[Curve | str]) -> None:
    """Warn of the pixel sizes that a study leaves out of each of its cases."""
    notes = []
    for rendered, curve in zip(cases, curves, strict=True):
        if isinstance(curve, Curve) and curve.left_out:
            reasons = dict(curve.left_out)
            sizes = ", ".join(f"{pitch_um:g}" for pitch_um in sorted(reasons))
            words = f"{rendered.label}: {sizes} µm left out: {reasons[max(reasons)]}"
            notes.append(Note("left_out", words=words))
    for note in first_notes([notes]):
        warn(note)


def _findings_of_cases(
    parts: Sequence[StudyResult], workers: Workers, progress: Progress
) -> tuple[tuple[Finding, ...], ...]:
    """Return the paper's statements compared with each case of a study with axes or conditions.

    A case without the paper's process has none. The rows of that process are computed once for
    cases that differ in other processes only.
    """
    keys = [_reference_key(part) for part in parts]
    first_parts = {key: part for key, part in zip(keys, parts, strict=True) if key}
    # The calls share no data: each makes its own result.
    calls = [
        (key, partial(StudyResult, part.study, part.curves, part.light))
        for key, part in first_parts.items()
    ]
    rows: dict[str, list[Finding]] = {}
    for done, (key, findings) in enumerate(results_of(_reference_task, calls, workers), 1):
        rows[key] = findings
        progress(done / len(calls))
    return tuple(
        (*rows[key], *scaling_rows(part.curves)) if key else ()
        for key, part in zip(keys, parts, strict=True)
    )


def _reference_key(part: StudyResult) -> str:
    """Return a hash of all that the rows of the paper's process depend on; empty without it."""
    if REFERENCE_TECHNOLOGY not in part.study.technologies:
        return ""
    settings = single_technology_table(part.study, REFERENCE_TECHNOLOGY)
    return content_hash([settings, part.sensors[REFERENCE_TECHNOLOGY].frames_hash])


def _reference_task(key: str, result: StudyResult) -> tuple[str, list[Finding]]:
    """Return the key of a case and the rows of the paper's process in it."""
    curves = {curve.technology: curve for curve in result.curves}
    return key, reference_rows(Evidence(result, curves))


def _draw_types(
    result: StudyResult,
    type_request: UncertaintyRequest,
    folder: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
) -> list[UncertaintyResult]:
    """Evaluate the sensor types of a finished study, and return the distribution of each optimum,
    metric by metric.

    Each metric has its own pixel sizes, around its optimum of the base. Warns of metrics without an
    optimum of the base.

    result : of the study, whose optima are the base
    type_request : number of types, and whether they are the points of total indices
    folder : of the study, in which `types_file` keeps the rows, so that an interrupted run goes on

    Raises PixsimError if nothing is unknown, or if a type has no pixel sizes in common with the
    base.
    """
    results = []
    for metric in drawn_metrics(result.study):
        curves = [curve for base in result.cases for curve in base.curves]
        if not all(metric.name in curve.optima for curve in curves):
            reason = "it gives no best size for some of the study's own sensors"
            words = f"sensor types for {metric.words}: nothing is drawn, since {reason}"
            warn(Note("no_effect", words=words))
            continue
        bases = [
            replace(base, curves=tuple(curve.judged_by(metric.name) for curve in base.curves))
            for base in result.cases
        ]
        file = folder / types_file(metric)
        results += _types_by_metric(bases, type_request, file, workers, progress)
    return results


def _types_by_metric(
    bases: Sequence[StudyResult],
    type_request: UncertaintyRequest,
    file: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
) -> list[UncertaintyResult]:
    """Return the distributions of a study's optima by the first metric of its curves.

    bases : cases of the study
    file : for the rows of the types
    """
    study = bases[0].study
    metric = bases[0].curves[0].metric
    sample = type_request.sample(study)

    # By case of the study, then by type, then by technology.
    cases = [
        case for number, base in enumerate(bases) for case in _cases_of_types(number, base, sample)
    ]
    base_lights = [replace(base.light, film=None, noise=None) for base in bases]
    rendered_sensors = rendered_cases(cases, [base_lights[_base_number(case)] for case in cases])
    curves: dict[int, Curve] = {}

    def fit(number: int, table: Table) -> None:
        case = cases[number]
        label = rendered_sensors[number].label
        curves[number] = curve_of(case.settings, case.sensor, table, label=label)

    evaluate_points(rendered_sensors, file, workers, progress, on_case_done=fit)

    results = []
    ordered = (curves[number] for number in range(len(cases)))
    has_one_curve = sum(len(base.curves) for base in bases) == 1
    for base in bases:
        curves_of_types = [tuple(islice(ordered, len(base.curves))) for _ in sample.draws]
        curves_of_technologies = list(zip(*curves_of_types, strict=True))
        for place, curve in enumerate(base.curves):
            table, holds = _results_of_types(curves_of_technologies, place, base, type_request)
            results.append(
                UncertaintyResult(
                    sample=sample if type_request.total else sample_of(sample, curve.technology),
                    table=table,
                    holds=holds,
                    requested_draws=type_request.draws,
                    seed=study.seed,
                    label="" if has_one_curve else curve.label,
                    total=type_request.total,
                    metric=metric,
                )
            )
    return results


def _base_number(case: Case[Study]) -> int:
    """Return the number of the case of the study to which a sensor type belongs."""
    number = case.labels["case"]
    assert isinstance(number, int)
    return number


def _cases_of_types(number: int, base: StudyResult, sample: Sample) -> Iterator[Case[Study]]:
    """Yield each sensor type as cases of its technologies, at few sizes around the base's optima.

    number : of the base among the cases of the study
    """
    metric = base.curves[0].metric
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    settings = base.study.model_dump(
        mode="json", exclude_unset=True, exclude={"axis", "condition", "target_ci_um"}
    )
    settings |= {"metrics": [metric.name], "paper": False, "resolution": base.study.resolution}
    types = [
        Study.model_validate(merge(settings, settings_of(base.study, unknowns, draw)))
        for draw in sample.draws
    ]

    sizes = {curve.technology: _few_pitches_um(types, curve) for curve in base.curves}
    judged_study = base.study.model_copy(update={"metrics": (metric.name,), "repeats": FEW_SENSORS})
    for draw, drawn_study in enumerate(types):
        labels: dict[str, Label] = {"case": number, "draw": draw}
        combination = Case(
            drawn_study,
            labels,
            labels=labels,
            group=(number, draw),
            resolved=(base.irradiance, base.camera),
        )
        for case in cases_of_sensors(combination):
            assert case.imaging is not None
            imaging = case.imaging.changed(
                display=judged_study.display,
                in_float32=allows_float32(judged_study.tolerance_delta_e),
                metrics=metrics_of(judged_study, FEW_SENSORS),
            )
            yield replace(case, imaging=imaging, sizes=sizes[case.sensor], caches_frames=False)


def _few_pitches_um(types: Sequence[Study], curve: Curve) -> Sizes:
    """Return the pixel sizes around the optimum of the base that every sensor type allows."""
    ends_um = [study_pitches_um(drawn_study, curve.technology)[[0, -1]] for drawn_study in types]
    if curve.left_out:
        ends_um.append(curve.pitch_um[[0, -1]])
    range_um = float(max(low for low, _ in ends_um)), float(min(high for _, high in ends_um))
    optimum_um = float(np.clip(curve.optimum.pitch_um, *range_um))
    return few_pitches_um(optimum_um, curve.optimum.interval_um, range_um, MAX_TYPE_EVALUATIONS)


def _results_of_types(
    curves: Sequence[Sequence[Curve]],
    place: int,
    base: StudyResult,
    type_request: UncertaintyRequest,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return `UncertaintyResult.table` and `holds` of one technology.

    curves : of all types, for each technology
    place : of the technology among them
    """
    drawn_curves = curves[place]
    optima = [curve.optimum for curve in drawn_curves]
    value = base.curves[place].metric.columns[0]
    names = (
        "optimum_um",
        "interval_low_um",
        "interval_high_um",
        value,
        f"{value}_low",
        f"{value}_high",
    )
    rows = [
        (optimum.pitch_um, *optimum.interval_um, optimum.value, *optimum.value_interval)
        for optimum in optima
    ]
    table = dict(zip(names, np.array(rows, float).T, strict=True))
    table["inside"] = np.array([optimum.inside for optimum in optima])

    # An optimum at the smallest size tried is there or below; one at the largest size may lie
    # anywhere above it.
    smallest_um, largest_um = np.array([curve.fitted_range_um for curve in drawn_curves]).T
    pitch_um = table["optimum_um"]
    has_upper_bound = table["inside"] | (pitch_um == smallest_um)
    holds = {
        f"the optimum is smaller than {size:g} µm": has_upper_bound & (pitch_um < size)
        for size in type_request.smaller_than_um
    }
    labels = [curve.plain_label for curve in base.curves]
    delta_e = [np.array([curve.optimum.mean_delta_e for curve in drawn]) for drawn in curves]
    for other, name in enumerate(labels):
        if other != place:
            holds[f"{labels[place]} is better than {name}"] = delta_e[place] < delta_e[other]
    table["optimum_um"] = np.clip(pitch_um, smallest_um, largest_um)
    return table, holds


def study(
    plan: Study | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    scene: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    quick: bool = False,
    jobs: Jobs | None = None,
    scheduler: object = None,
    variant: str | None = None,
    progress: Stage | None = None,
    agreed: bool = False,
    uncertainty: int | None = None,
    sobol: int | None = None,
    smaller_than_um: Sequence[float] = (),
    metrics: Sequence[str | Callable[[Score], float]] = (),
    light: SpectralImage | None = None,
    without: SpectralImage | None = None,
    **settings: object,
) -> StudyResult:
    """Run a study, or resume an interrupted one, with its rows in `out`/results.csv.

    plan : a Study, the name of a packaged one, or a TOML file
    out : folder, created if missing
    config : one or more TOML files with settings of a study, or with a sensor, its camera, exposure
        and display, for a named study; later ones take precedence
    parameters : of the scene, each in its unit; they override a named study's
    pixel : fields of the pixels (`PixelOptions`), as {"response": "scaled"}, each in its unit; they
        override a named study's. A data sheet may stand here instead of in a file, with its
        pitch_um
    scene : XML file, dictionary as `load_scene` takes it, or name of a packaged scene, which
        overrides a named study's
    quick : with the name or the file of a study: fewer pixel sizes and sensors, by the file
        NAME.quick.toml next to the study's, or else at most 8 sizes of 4 sensors
    jobs : processes. None means one per core where they are worth their start, or else threads. The
        results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers
        replace local processes; on the same kind of processor their results are bitwise equal
    variant : Mitsuba variant. None means the fastest that works
    progress : returns a callback for each named stage
    agreed : whether a study with axes or sensor types may take more than 100 000 evaluations
    uncertainty : number of sensor types to draw from the ranges of technologies and
        [pixel.uncertainty] of `config`, for the result's `uncertainty`. None means none
    sobol : in its place, number of points for total indices, which take sobol × (inputs + 2) sensor
        types
    smaller_than_um : sizes; the probability that the optimum is smaller is reported
    metrics : names of metrics, as ["delta_e", "detectability"], or functions of a `Score`, each a
        number in its own unit; the first gives `Curve.optimum`, and `Curve.optima` has the optimum
        of each
    light : on the sensor, rendered or of another program (`pixsim.read_irradiance`), in place of a
        scene's. Its camera is the camera in its header, or the default; `camera` overrides it. Axes
        and conditions then vary the sensor and what follows it, and settings.toml repeats the study
        in Python alone, with the same light
    without : such light of the scene without its target, for the metrics detectability and npwe
    settings : other fields of `Study`, which override a named study's; tables as dicts:
        camera={"f_number": 2.8}, pitch={"min_um": 2.0}, exposure={…}, display={…}, seed=3,
        window_mm=1.0, axis=[{"name": "lens", "set": "camera.f_number", "values": [2.0, 4.0]}],
        condition=[…]

    Raises PixsimError for invalid input, before anything is rendered, and if `out` holds a
    results.csv of another program.

    >>> import tempfile
    >>> tiny = {"name": "tiny", "repeats": 2, "display": {"dots": 64}}
    >>> tiny |= {"pitch": {"values_um": [20, 28, 40, 56, 80]}}
    >>> tiny |= {"scene": {"file": "csf", "parameters": {"resolution": 64, "spp": 4}}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = study(Study.model_validate(tiny), folder, jobs=1)
    >>> delta_e = result.curves[0].delta_e  # (pitches, sensors)
    >>> delta_e.shape, int(delta_e.mean(axis=1).argmin())
    ((5, 2), 0)
    """
    settings = tables_of_python(settings, metrics)
    if light is not None:
        check_given_light(scene=scene, parameters=parameters)
    if light is None and without is not None:
        raise invalid(
            "without",
            "a value without light",
            f"light as well; for a scene, {setting('metric.detectability.without')}",
        )
    options = {
        "config": config,
        "parameters": parameters,
        "pixel": pixel,
        "scene": scene,
        "quick": quick,
    } | settings
    if isinstance(plan, Study) and (names := [name for name, value in options.items() if value]):
        hint = "Set these values in the Study instead."
        raise invalid(", ".join(names), "with a Study", "the name or the file of a study", hint)
    with collected_notes():  # also those of the preparation
        spreads: Uncertainty = {}
        if isinstance(plan, Study):
            chosen = plan
        else:
            chosen = load_study(plan, config, parameters, pixel, scene, quick, **settings)
            spreads = uncertainty_of(plan, listed(config), quick)
        type_request = uncertainty_request(uncertainty, sobol, smaller_than_um, spreads)
        job = prepare(chosen, variant, light=light, background=without)
        return run_prepared(
            job,
            out,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
            agreed=agreed,
            spreads=spreads,
            type_request=type_request,
        )


def run_prepared(
    job: Job[Study],
    out: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    agreed: bool = False,
    spreads: Uncertainty | None = None,
    type_request: UncertaintyRequest | None = None,
    on_start: Callable[[StudyResult], None] | None = None,
) -> StudyResult:
    """Run a prepared study. Further arguments are described at `study`.

    spreads : [pixel.uncertainty] of the study and its data sheets, as its files state it
    type_request : sensor types to draw
    on_start : called once with a study of one case in its light, without curves, when workers have
        made its first evaluations
    """
    plan = job.complete
    stage = progress or no_stage
    check_number(len(job.combinations), job.evaluations, agreed)
    file_names = ["results.csv"]
    if type_request is not None:
        studies = [case.settings for case in job.combinations]
        check_types(plan, studies, type_request, agreed)
        file_names += map(types_file, drawn_metrics(plan))
    suitable = partial(
        workers_of_study,
        [(case.settings, case.camera) for case in job.combinations],
        0 if type_request is None else type_request.draws,
    )

    with collected_notes() as notes, ExitStack() as stack:
        for name in file_names:
            check_replaceable_results(Path(out) / name)
        workers = stack.enter_context(workers_for(jobs, scheduler, suitable))
        folder = stack.enter_context(output_folder(out))

        lights = render_lights(job.cases, stage, workers, store=PictureFile(folder).stored)
        reasons = list(dict.fromkeys(light for light in lights if isinstance(light, str)))
        case_lights = [
            (case, light)
            for case, light in zip(job.cases, lights, strict=True)
            if isinstance(light, Light)
        ]
        if not case_lights:
            raise PixsimError(reasons[0])

        evaluated, counts, table = _evaluate_cases(
            _with_films(case_lights),
            [light for _, light in case_lights],
            job.view,
            folder / "results.csv",
            workers,
            lambda: stage("evaluate"),
            on_start,
        )
        reasons += [reason for reason in evaluated if isinstance(reason, str)]
        results = [part for part in evaluated if isinstance(part, StudyResult)]
        if not results:
            raise PixsimError(reasons[0])
        left_out = [Note("left_out", words=f"a case is left out: {reason}") for reason in reasons]
        for note in first_notes([left_out]):
            warn(note)
        findings: tuple[tuple[Finding, ...], ...] = ()
        if plan.has_cases and plan.paper:
            findings = _findings_of_cases(results, workers, stage("paper's statements"))

    first = results[0]
    settings_toml = _repeated_settings(job, first.irradiance, spreads or {}, type_request)
    final = replace(first, warned=tuple(notes), settings_toml=settings_toml)
    if plan.has_cases:
        final = CasesResult(
            plan,
            _by_technology(results),
            first.light,
            view=first.view,
            settings_toml=settings_toml,
            warned=tuple(notes),
            table=table,
            prepared_sensors=first.prepared_sensors,
            parts=tuple(results),
            counts=counts,
            left_out=tuple(reasons),
            findings=findings,
        )
    if type_request is None:
        return final

    with (
        collected_notes(),
        workers_for(jobs, scheduler, suitable) as workers,
        output_folder(out) as folder,
    ):
        distributions = _draw_types(
            final, type_request, folder, workers, lambda: stage("sensor types")
        )
    return replace(final, uncertainty=tuple(distributions))


def _by_technology(results: Sequence[StudyResult]) -> tuple[Curve, ...]:
    """Return the curves of all cases, technology by technology."""
    curves = [curve for part in results for curve in part.curves]
    names = dict.fromkeys(curve.technology for curve in curves)
    return tuple(curve for name in names for curve in curves if curve.technology == name)
