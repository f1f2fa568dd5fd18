"""Studies: mean ΔE for many pixel sizes, technologies and individual sensors; resumable, the same on any number of workers."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.config import checked, packaged, read_toml, resolve_file, study_layers
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import output_folder
from pixsim.base.parameters import Camera, Layer, Study, content_hash
from pixsim.base.progress import Progress, Stage
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.integration import pixels_along
from pixsim.sensor.pixel import physics_of
from pixsim.sensor.technology import technology_of
from pixsim.studies.allocation import next_sensors
from pixsim.studies.engine import Workers, workers_for
from pixsim.studies.evaluations import Evaluations, Sampling, first_sampling, study_pitches_um
from pixsim.studies.result import Curve, StudyResult, curve_of
from pixsim.viewer.display import white_cd_per_m2
from pixsim.viewer.score import Lights

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene
    from pixsim.studies.budget import Settled


def read_study(name: str | os.PathLike[str]) -> Layer:
    """The table of a packaged study by name, or of a TOML file; files that it names may lie beside it."""
    known = packaged("data/studies")
    path = known.get(str(name)) or Path(name)
    if path.suffix != ".toml" and not path.is_file():
        raise invalid("study", f"'{name}'", f"a TOML file, or one of {', '.join(known)}", did_you_mean(str(name), known))
    table = read_toml(path)
    if "name" not in table and isinstance(pixel := table.get("pixel"), dict) and "pitch_um" in pixel:
        mend = f"Give it to a study: pixsim study pixel-size --config {path}"
        raise invalid("study", f"'{path}', the file of a sensor", "the file of a study, which has a name", mend)
    for own in (table, table.get("quick", {})):
        if isinstance(own, dict):
            _name_files(own, path)
    return Layer(table, str(path))


def _name_files(table: dict[str, Any], path: Path) -> None:
    """Technologies, scene and quantum efficiency of a study's table as files beside it, where there are such."""
    if isinstance(names := table.get("technologies"), list):
        table["technologies"] = [resolve_file(path, each) for each in names]
    if isinstance(numbers := table.get("process"), dict):
        table["process"] = {resolve_file(path, each): own for each, own in numbers.items()}
    for room, key in (("scene", "file"), ("pixel", "quantum_efficiency")):
        if isinstance(own := table.get(room), dict) and key in own:
            own[key] = resolve_file(path, own[key])


def load_study(
    name: str | os.PathLike[str],
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
) -> Study:
    """A packaged study by name, or a TOML file. PixsimError with all that is wrong with it.

    config : a TOML file, or several, of a sensor, its camera, exposure and display, as `pixsim run` takes them; later files
        win. The well and the dark current of a data sheet go with the photodiode's area.
    parameters : of the scene, over those of the study
    pixel : fields of the study's pixels, over those of the study and of the files, each in its unit; no pitch, no technology
    """
    paths = [config] if isinstance(config, str | os.PathLike) else config
    own: dict[str, Any] = {"scene": {"parameters": dict(parameters)}} if parameters else {}
    own |= {"pixel": dict(pixel)} if pixel else {}
    return checked_study(study_layers(read_study(name), [Path(each) for each in paths], own))


def checked_study(layers: Sequence[Layer]) -> Study:
    """A study's table, and options over it, as a record; its `quick` table is checked too, whether or not it will be used."""
    study: Study = checked(Study, layers)
    if study.quick:
        bare = [Layer({key: value for key, value in each.table.items() if key != "quick"}, each.source) for each in layers]
        checked(Study, [*bare, *(Layer(each.table["quick"], f"{each.source} [quick]") for each in layers if "quick" in each.table)])
    return study


def next_round(study: Study, curves: Sequence[Curve], sampling: Sampling) -> Sampling:
    """The sampling after another round of additions to each curve whose interval is wider than the target; the same at a limit.

    The choice follows from what is in the curves alone, so that it is the same on any workers and in a study that goes on.
    """
    chosen = dict(sampling)
    for curve in curves:
        sensors = sampling[curve.technology]
        if study.target_ci_um is None or curve.optimum.half_width_um <= study.target_ci_um:
            continue
        more = next_sensors(curve.fit, sensors, max(study.repeats, study.max_repeats))
        own, everything = sum(more.values()), sum(sum(each.values()) for each in (chosen | {curve.technology: more}).values())
        if study.max_evaluations is None:
            within = own <= len(study_pitches_um(study, curve.technology)) * max(study.repeats, study.max_repeats)
        else:
            within = everything <= study.max_evaluations
        if within:
            chosen[curve.technology] = more
    return chosen


def check_pitches(study: Study) -> None:
    """PixsimError for a pitch that a technology cannot have, before any work is done."""
    processes: dict[str, str] = {}
    for name in study.process:
        if name not in study.technologies:
            raise invalid("process", f"'{name}'", f"technologies of the study: {', '.join(study.technologies)}")
    for name in study.technologies:
        content = content_hash(technology_of(study, name).content)
        if content in processes:
            raise invalid("technologies", f"{name} beside {processes[content]}, the same process", "each process once")
        processes[content] = name
    for technology in study.technologies:
        for pitch_um in study_pitches_um(study, technology).tolist():
            physics_of(study, technology, pitch_um)
    begins = sum(sum(sensors.values()) for sensors in first_sampling(study).values())
    if study.max_evaluations is not None and study.max_evaluations < begins:
        allowed = f"at least {begins}, which the study begins with"
        raise invalid("max_evaluations", study.max_evaluations, allowed, "Raise it, or lower repeats or pitch.count.")


def scene_for(study: Study, variant: str | None = None) -> tuple[Scene, Camera]:
    """The study's scene and camera; PixsimError for what cannot be, before any render."""
    from pixsim.scene.scene import load_scene

    parameters: dict[str, Any] = dict(study.scene.parameters)
    scene = load_scene(study.scene.file, variant=variant, **parameters)
    camera = scene.camera(study.camera)
    largest_um = max(study_pitches_um(study, technology).max() for technology in study.technologies)
    pixels_along(1e3 * camera.die_mm, float(largest_um))
    return scene, camera


def render_for(study: Study, variant: str | None = None, progress: Progress | None = None) -> tuple[SpectralImage, Camera]:
    """The study's irradiance, and the camera that it was rendered with.

    Its noise is right for the largest pixel that the study allows, the least noisy one, whatever pitches are asked for: a
    row does not depend on the others.
    """
    from pixsim.scene.convergence import render_until
    from pixsim.scene.plan import make_render_plan

    scene, camera = scene_for(study, variant)
    largest = [physics_of(study, study.technologies[0], study.pitch.max_um)]
    plan = make_render_plan(scene, camera, tolerance_e=study.tolerance_e)
    image, _ = render_until(
        scene,
        camera,
        plan,
        largest,
        study.exposure,
        study.seed,
        render_noise=study.render_noise,
        max_seconds=study.max_seconds,
        progress=progress,
        keep=True,
    )
    return image, camera


def sweep_pitches(
    study: Study,
    irradiance: SpectralImage,
    camera: Camera,
    results: Path,
    workers: Workers,
    progress: Callable[[], Progress | None],
) -> StudyResult:
    """Evaluate what is missing in results.csv, add pitches and sensors until the target interval is met, and fit the optima."""
    white_cd_per_m2(irradiance, study.display)  # refuse an unknown white before any file is made
    lights, sampling = Lights(irradiance, camera, study.display), first_sampling(study)
    evaluations = Evaluations(study, lights, results, workers)
    with evaluations.alone():
        while True:
            rows = evaluations.of(sampling, progress())
            curves = tuple(curve_of(study, technology, rows) for technology in study.technologies)
            more = next_round(study, curves, sampling)
            if more == sampling:
                break
            sampling = more
        evaluations.finish(rows)
    result = StudyResult(study, curves, irradiance, camera)
    result.__dict__["lights"] = lights  # they were dear
    return result


def study(
    plan: Study | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    quick: bool = False,
    jobs: int | None = None,
    scheduler: Any = None,
    variant: str | None = None,
    progress: Stage | None = None,
) -> StudyResult:
    """Run a study, or go on with an interrupted one, and keep its rows in `out`/results.csv.

    plan : a Study, the name of a packaged one, or a TOML file
    out : folder, made if need be
    config : a TOML file, or several, of a sensor, its camera, exposure and display, over a named study; later ones win
    parameters : of the scene, over those of a named study, each in its unit
    pixel : fields of the pixels (`PixelOptions`), as {"response": "scaled"}, over those of a named study, each in its unit
    quick : with the study's `quick` table
    jobs : processes; None takes one a core. The results do not depend on it.
    scheduler : address of a Dask scheduler (tcp://host:8786) or a distributed.Client, whose workers take the place of
        processes here; on one kind of processor their results are the same bits
    variant : Mitsuba's; None takes the fastest that works here
    progress : gives a callback for each named stage

    Raises PixsimError for input that cannot be used.

    >>> import tempfile
    >>> tiny = {"name": "tiny", "repeats": 2, "pitch": {"values_um": [20, 28, 40, 56, 80]}, "display": {"dots": 64}}
    >>> tiny |= {"scene": {"file": "csf", "parameters": {"resolution": 64, "spp": 4}}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = study(Study.model_validate(tiny), folder, jobs=1)
    >>> result.curves[0].delta_e.shape, bool(result.curves[0].delta_e.mean(axis=1).argmin() == 0)  # (pitches, sensors)
    ((5, 2), True)
    """
    if isinstance(plan, Study) and (config or parameters or pixel):
        raise invalid("config, parameters, pixel", "with a Study", "the name or the file of one", "Put them into the Study.")
    chosen = plan if isinstance(plan, Study) else load_study(plan, config, parameters, pixel)
    if quick and not chosen.quick:
        warnings.warn(f"the study {chosen.name} has no [quick] table: it is done in full", stacklevel=2)
    chosen = chosen.quickened if quick else chosen
    check_pitches(chosen)
    stage = progress or (lambda _: lambda *_: None)
    from pixsim.scene.convergence import RenderNoise

    with workers_for(jobs, scheduler) as workers, output_folder(out) as folder:
        settled: Settled | None = None
        if chosen.tolerance_delta_e:
            stage("calibrate")
            from pixsim.studies.budget import settled_study

            chosen, settled = settled_study(chosen, *scene_for(chosen, variant))
        irradiance, camera = render_for(chosen, variant, stage("render"))
        result = sweep_pitches(chosen, irradiance, camera, folder / "results.csv", workers, lambda: stage("evaluate"))
    if settled is None:
        return result
    noise = RenderNoise(**irradiance.header["render_noise"])
    return replace(result, budget=settled.budget(noise, irradiance.header["bound_e"], int(result.curves[0].sensors.min())))
