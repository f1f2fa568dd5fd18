"""Run a study: mean ΔE for many pixel sizes, technologies and sensors; resumable, and independent of the number of workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.arguments import Jobs, checks_arguments
from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import output_folder
from pixsim.base.layers import listed
from pixsim.base.notes import collected_notes, warn
from pixsim.base.progress import Progress, Stage, no_stage
from pixsim.base.records import content_hash
from pixsim.base.toml import SETTINGS_FILE
from pixsim.light.spectral import DIGEST, SpectralImage
from pixsim.light.stored import PictureFile
from pixsim.optics.camera import Camera
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.labels import label_in
from pixsim.show.sentences import few
from pixsim.studies.allocation import next_near_best, next_sensors, next_where_open
from pixsim.studies.cases import Case, check_number
from pixsim.studies.cost import jobs_in_memory, largest_frame_bytes
from pixsim.studies.elsewhere import curves_on_displays
from pixsim.studies.engine import Workers, workers_for
from pixsim.studies.evaluations import Counts, Evaluations, TooFewSizesError, check_ideals, ideal_facts, warn_of_stacks
from pixsim.studies.lights import GivenLight, Light, lights_of_cases
from pixsim.studies.preparation import StudyJob, prepare
from pixsim.studies.result import CasesResult, Curve, StudyResult, causes_of_curve, curve_of
from pixsim.studies.results_file import ResultsFile
from pixsim.studies.rows import NO_ROWS
from pixsim.studies.sampling import Sampling, Sizes, first_sampling, study_pitches_um
from pixsim.studies.series import Series, metrics_of, most_channels, scenes_of, series_of
from pixsim.studies.settings_text import scene_table, settings_text
from pixsim.studies.study_file import load_study, spreads_of_study, uncertainty_of
from pixsim.studies.study_settings import Study
from pixsim.viewer.metric_registry import names_of
from pixsim.viewer.scene_light import SceneCache
from pixsim.viewer.score import Score
from pixsim.viewer.screen import warn_of_clipping

if TYPE_CHECKING:
    from pixsim.studies.sensor_types import Asked

FEW_CASES = 64  # of a study whose curves with an open end get more sizes and sensors


def repeated_settings(job: StudyJob, image: SpectralImage, asked: Asked | None = None) -> str:
    """Return the text of settings.toml, from which `pixsim study` makes the same numbers again.

    image : the render of the study
    asked : about its unknown numbers
    """
    from pixsim.scene.convergence import without_clock

    if isinstance(job.source, SpectralImage):
        without = job.cases[0].without
        more = "" if without is None else f" and, without its target, {without.header[DIGEST]}"
        names = "light=…" if without is None else "light=…, without=…"
        command = f"pixsim.study('{SETTINGS_FILE}', out, {names}), of the light of digest {image.header[DIGEST]}{more}"
        return settings_text(job.study, command, spreads_of_study(job.study, job.uncertainty))
    scene, kept = job.source, without_clock(job.study, image)
    file = kept.scene.file
    of_scene = {
        "file": file if file in packaged_scenes() else str(scene.path),
        "parameters": scene_table(scene.path.parent, kept.scene.parameters),
    }
    camera = scene.camera(kept.camera, kept.lens).options.model_dump(exclude_none=True)
    spreads = spreads_of_study(kept, job.uncertainty)
    return settings_text(kept, repeating_command(job.variant, asked), spreads, scene=of_scene, camera=camera)


def repeating_command(variant: str | None, asked: Asked | None = None) -> str:
    """Return the command that repeats a study in the folder of its settings.toml."""
    words = f"pixsim study {SETTINGS_FILE}" + (f" --variant {variant}" if variant else "")
    if asked is None:
        return words
    sizes = "".join(f" --smaller-than {size!r}" for size in asked.smaller_than_um)
    return f"{words} --{'sobol' if asked.total else 'uncertainty'} {asked.draws}{sizes}"


def next_round(study: Study, curves: Sequence[Curve], sampling: Sampling, refine: bool = True) -> Sampling:
    """Return the sampling after a round of additions to each curve; unchanged at a limit.

    A curve whose interval misses `target_ci_um` gets sizes and sensors where they narrow it most. Without a target, so does one
    whose interval has an open end (`next_where_open`), and one whose interval is long for want of sizes near the best
    (`next_near_best`), unless the sizes are a list of the user's.

    refine : whether curves without a target may have additions

    The choice depends on the curves alone, so it is the same on any workers and in a resumed study.
    """
    chosen = dict(sampling)
    for curve in curves:
        sensors = sampling[curve.technology]
        told = {um: sensors[um] for um in curve.pitch_um[curve.told].tolist() if um in sensors}
        sizes, most = len(study_pitches_um(study, curve.technology)), max(study.repeats, study.max_repeats)
        if study.target_ci_um is None:
            if not (refine and study.refine) or study.pitch.values_um is not None:
                continue
            more = next_where_open(curve.fit, told, sizes * study.repeats, most)
            more = next_near_best(curve.fit, told, sizes) if more == told else more
        elif curve.optimum.half_width_um <= study.target_ci_um:
            continue
        else:
            more = next_sensors(curve.fit, told, most)
        more = more if len(told) == len(sensors) else dict(sorted((sensors | more).items()))
        if study.max_evaluations is None:
            within = sum(more.values()) <= sizes * most
        else:
            evaluations = sum(sum(counts.values()) for counts in (chosen | {curve.technology: more}).values())
            within = evaluations <= study.max_evaluations
        if within:
            chosen[curve.technology] = more
    return chosen


def evaluate_cases(
    cases: Sequence[Case[Study]],
    lights: Sequence[Light | GivenLight],
    view: Mapping[str, Any],
    results: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
) -> tuple[list[StudyResult | str], Counts]:
    """Evaluate missing rows of results.csv, add pitches and sensors until the target interval is met, and fit the optima.

    Returns the result of each case, or the reason why too few of its pixel sizes are possible, and how much was computed.
    """
    caches: dict[str, SceneCache] = {}
    lit: list[SceneCache] = []
    series: list[Series] = []
    members: list[range] = []  # of each case, the numbers of its series
    for case, light in zip(cases, lights, strict=True):
        irradiance, camera = light.image, light.camera
        # The header states everything that a render depends on, so that cases of other pixels may have equal ones.
        of_light = [irradiance.header, irradiance.shape, irradiance.pitch_um, camera.model_dump()]
        metrics = metrics_of(case.settings, case.settings.repeats)
        of_light.append(None if light.without is None else light.without.header)
        key = content_hash([*of_light, case.settings.display.content_hash, metrics.content, case.settings.develop.tone])
        scenes = caches.setdefault(key, scenes_of(case.settings, irradiance, camera, without=light.without))
        scenes.channels = max(scenes.channels, most_channels(case.settings))
        lit.append(scenes)
        of_case = series_of(case.settings, scenes, case.columns, case.words)
        members.append(range(len(series), len(series) + len(of_case)))
        series += of_case
    under: dict[tuple[str, str], list[Series]] = {}  # of one scene and condition
    for case, numbers in zip(cases, members, strict=True):
        under.setdefault((case.settings.scene.file, case.condition), []).extend(series[number] for number in numbers)
    for together in under.values():
        check_ideals(together)
    evaluations = Evaluations(series, results, workers, len(cases))
    case_of = [place for place, numbers in enumerate(members) for _ in numbers]
    samplings = [sizes for case in cases for sizes in first_sampling(case.settings).values()]
    smallest_um = [min(sizes) for sizes in samplings]
    rows = [NO_ROWS for _ in series]
    curves: dict[int, Curve] = {}
    fitted: list[Sizes] = [{} for _ in series]  # of these curves
    left_out: list[dict[float, str]] = [{} for _ in series]
    lacking: list[dict[tuple[str, float], str]] = [{} for _ in series]
    impossible: dict[int, str] = {}
    rounds = any(case.settings.target_ci_um is not None for case in cases)
    with evaluations.resumed(samplings):
        for group in evaluations.groups(members) if rounds else [range(len(cases))]:
            changed = set(group)
            while changed:
                # Cases that have met their target stay, so that their lights are not prepared again.
                wanted = [sizes if case_of[number] in changed else {} for number, sizes in enumerate(samplings)]
                missing = {number: len(members[number]) for number in changed}
                changed = set()
                with closing(evaluations.rows(wanted, progress())) as found_rows:
                    for number, rows[number] in found_rows:  # the workers go on while a curve is fitted
                        place = case_of[number]
                        missing[place] -= 1
                        left_out[number] |= evaluations.left_out(number, samplings[number])
                        lacking[number] |= evaluations.lacking(number, samplings[number])
                        try:
                            samplings[number] = evaluations.possible(number, samplings[number])
                            if fitted[number] != samplings[number]:
                                curves[number] = curve_of(
                                    cases[place].settings, series[number].name, rows[number], series[number].imaging.metrics.chosen
                                )
                            fitted[number] = samplings[number]
                        except TooFewSizesError as error:
                            impossible[number] = " ".join([str(error), *lacking[number].values()][:2])
                        if missing[place] or not impossible.keys().isdisjoint(members[place]):
                            continue
                        technologies = {series[own].name: own for own in members[place]}
                        more = next_round(
                            cases[place].settings,
                            [curves[own] for own in technologies.values()],
                            {name: samplings[own] for name, own in technologies.items()},
                            len(cases) <= FEW_CASES,
                        )
                        for name, own in technologies.items():
                            if more[name] != samplings[own]:
                                changed.add(place)
                            samplings[own] = more[name]
            evaluations.end_group()
        evaluations.finish(rows)
    found: list[StudyResult | str] = []
    left_of_cases = [{series[number].name: left_out[number] for number in numbers if left_out[number]} for numbers in members]
    reasons = [next((impossible[number] for number in numbers if number in impossible), "") for numbers in members]
    warn_of_left_out(cases, [{} if reason else left for left, reason in zip(left_of_cases, reasons, strict=True)])
    for case, numbers, reason, scenes, light in zip(cases, members, reasons, lit, lights, strict=True):
        if reason:
            found.append(reason)
            continue
        facts = {number: ideal_facts(series[number], smallest_um[number]) for number in numbers}
        for number in numbers:
            warn_of_clipping(facts[number].beyond_white, scenes.irradiance.header, series[number].imaging.display)
        for number in numbers:
            warn_of_stacks(series[number], smallest_um[number])
        complete = tuple(
            replace(
                curves[number],
                at=case.at,
                condition=case.condition,
                alone=case.alone,
                left_out=tuple(left_out[number].items()),
                lacking=tuple((*which, reason) for which, reason in lacking[number].items()),
                causes=causes_of_curve(series[number], curves[number], facts[number].lightness, rows[number]),
            )
            for number in numbers
        )
        known = case.settings, complete, light.image, light.camera, light.film
        found.append(StudyResult(*known, view=dict(view), lights=scenes, without=light.without))
    return found, evaluations.counts


def warn_of_left_out(cases: Sequence[Case[Study]], left_out: Sequence[Mapping[str, Mapping[float, str]]]) -> None:
    """Warn of the pixel sizes that a study leaves out of each of its cases."""
    notes = []
    for case, own in zip(cases, left_out, strict=True):
        for name, sizes in own.items():
            which = label_in(name, case.words)
            listed = ", ".join(f"{pitch_um:g}" for pitch_um in sorted(sizes))
            notes.append(f"{which}: {listed} µm left out: {sizes[max(sizes)]}")
    for note in few([notes]):
        warn(note)


def warn_of_idle_axes(study: Study, found: Sequence[StudyResult]) -> None:
    """Warn of each axis whose values all give the same numbers, bit for bit: something else decides on its setting.

    All cases have the same random numbers, so that equal settings give equal numbers.
    """
    curves = [curve for result in found for curve in result.curves]
    for axis in study.axis:
        groups: dict[tuple[object, ...], list[bytes]] = {}
        for curve in curves:
            is_base = axis.alone and not curve.alone
            if curve.alone == (axis.name if axis.alone else "") or is_base:
                others = () if axis.alone else [(name, value) for name, value in curve.at.items() if name != axis.name]
                judged = (curve.statistics[metric.columns[0]] for metric in curve.metrics)
                content = b"".join(each.tobytes() for each in (curve.pitch_um, *judged))
                groups.setdefault((curve.technology, curve.condition, *others), []).append(content)
        if any(len(group) > 1 for group in groups.values()) and all(len(set(group)) == 1 for group in groups.values()):
            settings = ", ".join(dict.fromkeys(".".join(path) for path in axis.paths))
            why = f"its values are the study's own, or other settings or a data sheet decide in place of {settings}"
            warn(f"the axis {axis.name} changes nothing: {why}")


@checks_arguments
def study(
    plan: Study | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    scene: str | os.PathLike[str] | None = None,
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
    config : one or more TOML files with settings of a study, or with a sensor, its camera, exposure and display, for a named
        study; later ones take precedence
    parameters : of the scene, each in its unit; they override those of a named study
    pixel : fields of the pixels (`PixelOptions`), as {"response": "scaled"}, each in its unit; they override a named study's. A
        data sheet may stand here instead of in a file, with its pitch_um
    scene : XML file or name of a packaged scene, which overrides a named study's
    quick : with the name or the file of a study: fewer pixel sizes and sensors, by the file NAME.quick.toml next to the study's,
        or else at most 8 sizes of 4 sensors
    jobs : processes; None means one per core. The results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers replace local processes;
        on the same kind of processor their results are bitwise equal
    variant : Mitsuba variant; None means the fastest that works
    progress : returns a callback for each named stage
    agreed : whether a study with axes or sensor types may take more than 100 000 evaluations
    uncertainty : number of sensor types to draw from the ranges of technologies and [pixel.uncertainty] of `config`, for the
        result's `uncertainty`; None means none
    sobol : in its place, number of points for total indices, which take sobol × (inputs + 2) sensor types
    smaller_than_um : sizes; the probability that the optimum is smaller is reported
    metrics : names of metrics, as ["delta_e", "detectability"], or functions of a `Score`, each a number in its own unit; the first
        is that of `Curve.optimum`, and each has its own in `Curve.optima`
    light : on the sensor, rendered or of another program (`pixsim.read_irradiance`), in place of a scene's. Its camera is that of
        its header, or the default, with `camera` over it. Axes and conditions then vary the sensor and what follows it, and
        settings.toml repeats the study in Python alone, with the same light
    without : such light of the scene without its target, for the metrics detectability and npwe
    settings : other fields of `Study`, which override a named study's; tables as dicts: camera={"f_number": 2.8},
        pitch={"min_um": 2.0}, exposure={…}, display={…}, seed=3, window_mm=1.0, axis=[{"name": "lens", "set":
        "camera.f_number", "values": [2.0, 4.0]}], condition=[…]

    Raises PixsimError for invalid input, before anything is rendered, and if `out` holds a results.csv of another program.

    >>> import tempfile
    >>> tiny = {"name": "tiny", "repeats": 2, "pitch": {"values_um": [20, 28, 40, 56, 80]}, "display": {"dots": 64}}
    >>> tiny |= {"scene": {"file": "csf", "parameters": {"resolution": 64, "spp": 4}}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = study(Study.model_validate(tiny), folder, jobs=1)
    >>> result.curves[0].delta_e.shape, bool(result.curves[0].delta_e.mean(axis=1).argmin() == 0)  # (pitches, sensors)
    ((5, 2), True)
    """
    if metrics:
        settings["metrics"] = names_of(metrics)
    if isinstance(own := settings.get("camera"), Camera):
        settings["camera"] = own.options.model_dump(exclude_none=True)
    if light is not None and (names := [name for name, value in (("scene", scene), ("parameters", parameters)) if value]):
        raise invalid(names[0], "a value beside light", "one of the two")
    if light is None and without is not None:
        raise invalid("without", "a value without light", f"light beside it; of a scene, {setting('metric.detectability.without')}")
    given = {"config": config, "parameters": parameters, "pixel": pixel, "scene": scene, "quick": quick} | settings
    if isinstance(plan, Study) and (names := [name for name, value in given.items() if value]):
        hint = "Set these values in the Study instead."
        raise invalid(", ".join(names), "with a Study", "the name or the file of a study", hint)
    with collected_notes():  # also of what is found before the study begins
        chosen = plan if isinstance(plan, Study) else load_study(plan, config, parameters, pixel, scene, quick, **settings)
        spreads = uncertainty_of(plan, listed(config), quick) if isinstance(plan, str | os.PathLike) else {}
        from pixsim.studies.sensor_types import asked_of

        asked = asked_of(uncertainty, sobol, smaller_than_um, spreads)
        job = replace(prepare(chosen, variant, light=light, without=without), uncertainty=spreads)
        return run_prepared(job, out, jobs=jobs, scheduler=scheduler, progress=progress, agreed=agreed, asked=asked)


def run_prepared(
    job: StudyJob,
    out: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: object = None,
    progress: Stage | None = None,
    agreed: bool = False,
    asked: Asked | None = None,
) -> StudyResult:
    """Run a prepared study; the other arguments are those of `study`.

    asked : about its unknown numbers
    """
    check_number(len(job.cases), job.evaluations, agreed)
    if asked is not None:
        from pixsim.studies.sensor_types import check_types

        check_types(job.study, [case.settings for case in job.cases], asked, agreed)

    stage = progress or no_stage
    if jobs is None and scheduler is None:
        jobs = jobs_in_memory(largest_frame_bytes([(case.settings, case.camera) for case in job.cases]))
    with collected_notes() as notes, ExitStack() as stack:
        ResultsFile(Path(out) / "results.csv").check_replaceable()
        workers, folder = stack.enter_context(workers_for(jobs, scheduler)), stack.enter_context(output_folder(out))
        chosen = job.study
        lights = lights_of_cases(job.cases, stage, workers, store=PictureFile(folder).stored)
        reasons = [light for light in lights if isinstance(light, str)]
        lit = [(case, light) for case, light in zip(job.cases, lights, strict=True) if not isinstance(light, str)]
        found: list[StudyResult] = []
        if lit:
            films = [light.image.shape[1] if isinstance(light, Light) else None for _, light in lit]
            on_films = [case.settings.model_copy(update={"resolution": film}) for (case, _), film in zip(lit, films, strict=True)]
            cases = [replace(case, settings=settings) for (case, _), settings in zip(lit, on_films, strict=True)]
            of_cases = cases, [light for _, light in lit], job.view, folder / "results.csv", workers
            made, counts = evaluate_cases(*of_cases, lambda: stage("evaluate"))
            reasons += [each for each in made if isinstance(each, str)]
            found = [each for each in made if isinstance(each, StudyResult)]
        if not found:
            raise PixsimError(reasons[0])
        for note in few([[f"a case is left out: {reason}" for reason in reasons]]):
            warn(note)
        warn_of_idle_axes(chosen, found)
        curves = found[0].curves
        if not job.study.has_cases and chosen.own_um is not None and chosen.display.raster == "fixed_size":
            curves = curves_on_displays(found[0], workers, stage("on other displays"))
        findings: tuple[tuple[Any, ...], ...] = ()
        if job.study.has_cases and chosen.paper:
            from pixsim.studies.claims import findings_of_cases

            findings = findings_of_cases(found, workers, stage("paper's statements"))
    first = found[0]
    irradiance = first.irradiance
    settings_toml = repeated_settings(job, irradiance, asked)
    final = replace(first, warned=tuple(notes), curves=curves, settings_toml=settings_toml)
    if job.study.has_cases:
        names = dict.fromkeys(curve.technology for part in found for curve in part.curves)
        final = CasesResult(
            chosen,
            tuple(curve for name in names for part in found for curve in part.curves if curve.technology == name),
            irradiance,
            first.camera,
            film=first.film,
            view=first.view,
            settings_toml=settings_toml,
            warned=tuple(notes),
            lights=first.lights,
            parts=tuple(found),
            counts=counts,
            left_out=tuple(reasons),
            findings=findings,
        )
    if asked is None:
        return final
    from pixsim.studies.sensor_types import draw_types

    with collected_notes(), workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        unknown = draw_types(final, asked, folder, workers, lambda: stage("sensor types"))
    return replace(final, uncertainty=tuple(unknown))
