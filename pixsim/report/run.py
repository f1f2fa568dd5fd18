"""One run from scene to score, its output files (all of them, or none), and its report page."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.config import SETTINGS_FILE, scene_table, settings_text
from pixsim.base.errors import invalid
from pixsim.base.files import (
    PROVENANCE,
    are_kept,
    check_replaceable,
    digest_of,
    files_are_finished,
    output_folder,
    publishing,
    write_json,
    write_made_from,
)
from pixsim.base.labels import label_of
from pixsim.base.notes import collected_notes, warn
from pixsim.base.parameters import NO_TECHNOLOGY, Camera, Correction, Develop, Display, Exposure, Record, Run
from pixsim.base.progress import Stage, share_of, watched
from pixsim.light.exr import reduced_to_fit, write_channels, write_exr
from pixsim.light.spectral import SpectralImage
from pixsim.report.kept import digest_of_content
from pixsim.report.pictures import crops, picture_axes
from pixsim.report.settings import FILLED, record_rows, scene_rows
from pixsim.report.wording import (
    blur_words,
    budget_lines,
    film_words,
    focal_length_assumption,
    lens_words,
    light_of,
    map_words,
    mean_words,
    own_notes,
    score_parts,
    unsure_lines,
    view_words,
)
from pixsim.sensor.integration import check_pixel_count, collecting_area_um2, pixels_along, pixels_on
from pixsim.sensor.raw import BITS_OF_PICTURES, write_frame
from pixsim.sensor.unused import Configuration, warn_of_unused_settings
from pixsim.show.pages import compile_page, rounded, write_page
from pixsim.show.pictures import (
    Picture,
    display_codes,
    factor_for,
    reduced,
    save_delta_e_png,
    save_png,
    scale,
    scale_end,
    worst_window,
)
from pixsim.studies.extent import extent
from pixsim.studies.light_level import LightLevel
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.display import dot_edges_um, white_light, white_rate
from pixsim.viewer.score import Score, Seen, dark_clip, make_imaging_chain, white_header

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene
    from pixsim.studies.budget import Settled
    from pixsim.studies.preparation import View


PAGE = "run.html.j2"  # template of report.html
# Files next to the page, with their descriptions.
FILES = {
    "score.json": "all numbers and settings, for programs",
    "irradiance.exr": "light on the sensor, before diffraction",
    "raw.exr": "digital numbers of the sensor",
    "ideal.png": "image of an ideal camera, as shown",
    "image.png": "image of the sensor, as shown",
    "delta_e.exr": "S-CIELAB ΔE map, for programs",
    "delta_e.png": "S-CIELAB ΔE map, with axes",
    "settings.toml": "all settings: `pixsim run SCENE --config settings.toml` makes the same numbers again",
    "provenance.json": "versions and wall times",
}
AFTERWARDS = ("score.json", PROVENANCE)
BEFORE_FRAME = 0.8  # of the work of "sense and score"
MAX_FRAMES = 999  # of a run: the numbers in the names of their files have three digits
MEANINGS = {
    "pitch_um": "pixel size, centre to centre (µm)",
    "fill_factor": "photodiode area over pixel area",
    "full_well_e": "full well (electrons)",
    "integration_s": "exposure time (s)",
    "saturated_fraction": "fraction of saturated pixels: at full well, or at the ADC's top code",
    "mean_electrons_e": "mean photo-electrons per pixel",
    "mean_delta_e": "mean ΔE",
    "median_delta_e": "median ΔE",
    "p90_delta_e": "90th percentile of ΔE over dots",
    "p99_delta_e": "99th percentile of ΔE over dots",
    "max_delta_e": "largest ΔE",
}


IDEALS = {
    True: "in colour: compare with colour sensors only, since that of a monochrome sensor is grey",
    False: "grey, as that of a monochrome sensor: the mean ΔE of both may be compared",
}


def colour_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what the page says of a colour sensor and its picture, (meaning, value) each; none for a monochrome one."""
    if "colour" not in summary:
        return []
    facts = summary["colour"]
    letters = list(facts["white_e"])
    gains = ", ".join(f"{gain:.3g}" for gain in facts["noise_gains"])
    rows = [
        ("channels of a frame: rows of the unit cell, or planes", facts["layout"]),
        ("light of white, for white balance, matrix and ideal image", facts["white_spectrum"]),
        (f"electrons of white in {', '.join(letters)}", ", ".join(rounded(value, 4) for value in facts["white_e"].values())),
        (f"matrix from balanced {', '.join(letters)} to the display's light, row of red", _row(facts, 0)),
        ("the same, row of green", _row(facts, 1)),
        ("the same, row of blue", _row(facts, 2)),
        ("noise gains of the matrix in red, green, blue", gains),
        ("sensitivity metamerism index under this lamp (100: no colour error)", f"{facts['sensitivity_metamerism_index']:.4g}"),
        ("mean ΔE of patches 1-18 of a ColorChecker behind the matrix, without noise", f"{facts['patches_mean_delta_e']:.3g}"),
        ("ideal image", IDEALS[facts["ideal_is_coloured"]]),
        ("dots outside the display's gamut: ideal image", f"{summary['ideal_out_of_gamut_fraction']:.2%}"),
        ("dots outside the display's gamut: the sensor's picture", f"{summary['out_of_gamut_fraction']:.2%}"),
    ]
    return rows


def _row(facts: dict[str, Any], number: int) -> str:
    return ", ".join(f"{value:.4g}" for value in facts["matrix_to_display"][number])


def write_run_page(folder: Path, score: Score, irradiance: SpectralImage, summary: dict[str, Any]) -> None:
    """Write report.html next to the run's other files; it links to them and contains their pictures."""
    window = worst_window([score.delta_e])
    width_mm, height_mm = extent(irradiance)[1:3]
    left_mm, right_mm, bottom_mm, top_mm = extent(irradiance, score.border_um)
    physics, header = score.physics, irradiance.header
    parameters = header.get("parameters")  # may be anything in a file of another program
    camera = Camera.model_validate(summary["camera"])
    display = Display.model_validate(summary["display"])
    light = LightLevel.of(irradiance, display, [summary["integration_s"]])
    sheet = physics.technology.name == NO_TECHNOLOGY
    statistics = {name: summary[name] for name in MEANINGS}
    if sheet and statistics["fill_factor"] > FILLED:
        del statistics["fill_factor"]  # the data sheet states none
    numbers = [(MEANINGS[key], rounded(value, 5)) for key, value in statistics.items()]
    if "render_noise" in summary:
        numbers.append(("noise of the render relative to the sensor's noise", f"{summary['render_noise']['fraction']:.2g}"))
    others = {
        path.name: "the frame of raw.exr, for other programs" for path in sorted(folder.glob("raw.*")) if path.name not in FILES
    }
    others |= {path.name: further_words(path, summary["frames"]) for path in sorted(folder.glob(f"{raw_stem(2)}.*"))}
    exposure = Exposure.model_validate(summary["exposure"])
    correction = Correction.model_validate(summary["correction"])
    records: dict[str, Record] = {"camera": camera, "pixel": physics.pixel, "exposure": exposure, "correction": correction}
    coloured = "develop" in summary
    records |= {"develop": Develop.model_validate(summary["develop"])} if coloured else {}
    records["display"] = display
    page = {
        "scene": Path(str(header.get("scene", header.get("source", "a picture of another program")))).stem,
        "line": "; ".join(filter(None, score_parts(summary))),
        "mean": mean_words(summary),
        "unsure": (unsure := unsure_lines(summary)),
        "view": "; ".join(view_words(summary["display"], summary, summary["pixels"][1])),
        "summary": summary,
        "label": label_of(physics.technology.name),
        "die_mm": (width_mm, height_mm),
        "camera": camera,
        "lens": lens_words(camera),
        "well": float(score.frame.mean_e.max()) / physics.saturation_e,
        "limit": "the full well" if physics.full_well_e <= physics.adc_range_e else "the range of the ADC",
        "ideal": shown_picture(folder / "ideal.png", score.ideal, "ideal image"),
        "image": shown_picture(folder / "image.png", score.image, f"{physics.pitch_um:g} µm pixels"),
        "reduced": factor_for(score.ideal),
        "crops": crops(score, window, "the sensor's picture", scale_end(statistics["p99_delta_e"])),
        "place_mm": (left_mm + window.centre[0] * (right_mm - left_mm), top_mm + window.centre[1] * (bottom_mm - top_mm)),
        "scale_bar": scale(scale_end(statistics["p99_delta_e"])),
        "map": (folder / "delta_e.png").read_bytes(),
        "map_words": map_words("", summary["mean_delta_e"], summary["p99_delta_e"], scale_end(statistics["p99_delta_e"])),
        "statistics": numbers,
        "colour": colour_rows(summary),
        "notes": [note for note in summary["notes"] if note not in unsure],
        "blur": blur_words(irradiance, camera, physics, display),
        "film": film_words(summary["film"]) if "film" in summary else "",
        "budget": budget_lines(summary),
        "light": light,
        "settings": [
            ("scene", scene_rows(irradiance, parameters if isinstance(parameters, dict) else {}, light)),
            *((title, record_rows(title, record, sheet, coloured=coloured)) for title, record in records.items()),
        ],
        "sheet": sheet,
        "header": header,
        "files": {name: words for name, words in FILES.items() if (folder / name).exists() or name in AFTERWARDS} | others,
    }
    write_page(folder / "report.html", PAGE, page)


def raw_stem(number: int) -> str:
    """Return the name, without its suffix, of the file of a frame: raw, raw_002, raw_003, …; sorted names keep their order."""
    return "raw" if number == 1 else f"raw_{number:03d}"


def further_words(second: Path, frames: int) -> str:
    """Return what the page says of the files of further frames beside that of the second one, of one format."""
    last = "" if frames == 2 else f", and so on to {raw_stem(frames)}{second.suffix}"
    return f"frame 2 of the same sensor{last}: the same fixed pattern, temporal noise of its own"


def frames_lines(summary: dict[str, Any]) -> list[str]:
    """Return a line on the frames of a run with several; none for one.

    >>> frames_lines({"frames": 3})
    ['3 frames of this sensor: raw.exr, raw_002.exr and raw_003.exr; the first is scored']
    """
    frames = summary.get("frames", 1)
    between = {2: "", 3: f", {raw_stem(2)}.exr"}.get(frames, f", {raw_stem(2)}.exr, …")
    names = f"raw.exr{between} and {raw_stem(frames)}.exr"
    return [f"{frames} frames of this sensor: {names}; the first is scored"] if frames > 1 else []


def check_raw(settings: Run, raw_suffixes: Sequence[str], frames: int) -> None:
    """Raise PixsimError for raw frames that a run cannot write: of too many bits for their format, or too many."""
    if settings.pixel.bits > BITS_OF_PICTURES and {".tiff", ".png"} & set(raw_suffixes):
        got = f"tiff or png for an ADC of {settings.pixel.bits} bits"
        raise invalid("--raw", got, f"at most {BITS_OF_PICTURES} bits; use npz for more")
    if not 1 <= frames <= MAX_FRAMES:
        raise invalid("--frames", frames, f"1 to {MAX_FRAMES}", "For more, call run with another --seed: another sensor.")


def shown_picture(path: Path, luminance: Array, name: str) -> Picture:
    """Return a whole picture from its file, or the `reduced` one if it is large."""
    if factor_for(luminance) == 1:
        return Picture(display_codes(luminance), name, png=path.read_bytes())
    return Picture(display_codes(reduced(luminance)), name)


Irradiance = Literal["reduced", "full", "factors", "none"]  # what irradiance.exr holds
PICTURE_SUFFIXES = (".exr", ".npz", ".hdr")


def run_and_write(
    source: str,
    settings: Run,
    out: Path,
    *,
    full: bool,
    sensor: str | None,
    variant: str | None,
    units: str | None = None,
    raw_suffixes: Sequence[str] = (),
    frames: int = 1,
    irradiance: Irradiance = "reduced",
    progress: Stage,
) -> dict[str, Any]:
    """Render a scene or read a spectral picture, simulate and score a frame, write all files, and return score.json.

    raw_suffixes : further formats of the frame besides raw.exr
    frames : of the same sensor; the first is scored
    irradiance : what irradiance.exr holds: 'reduced', bands of at most 1024 samples across and 60 MB; 'full', what `read_exr`
        gives back bit for bit; 'factors', an image's factors only; 'none', no such file

    `notes` of the result are the warnings meanwhile, and a black level that clips dark noise.

    Raises PixsimError for invalid input; the folder is then unchanged.
    """
    from pixsim.sensor.pixel import derive

    physics = derive(settings.pixel)
    check_raw(settings, raw_suffixes, frames)
    if settings.tolerance_delta_e and full:
        allowed = "one of the two: a tolerance selects cheaper settings, --full uses none"
        raise invalid("--tolerance-delta-e", "with --full", allowed)
    formats = tuple(dict.fromkeys((".exr", *raw_suffixes)))
    names = {"report.html", *FILES, *(f"{raw_stem(number)}{suffix}" for number in range(1, frames + 1) for suffix in formats)}
    names -= {"irradiance.exr"} if irradiance == "none" else set()
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal clock
        seconds[name], clock = time.perf_counter() - clock, time.perf_counter()

    prepared: Callable[[], Light]
    with collected_notes() as notes:
        if Path(source).suffix.lower() in PICTURE_SUFFIXES:
            only_of_scenes = settings.tolerance_delta_e or settings.resolution or settings.window_mm
            if settings.scene or sensor or variant or only_of_scenes:
                options = "-D, --sensor, --variant, --tolerance-delta-e, --resolution, --window"
                raise invalid(options, f"'{source}', a picture", "a Mitsuba scene, or none of these options")
            check_replaceable(out, names)
            prepared = partial(light_of_picture, source, settings, units)
        else:
            if units:
                raise invalid("--units", f"'{source}', a scene", "a picture (.exr, .npz, .hdr); the units of a render are known")
            with ThreadPoolExecutor(1) as pool:  # files of a run before are read meanwhile
                replaceable = pool.submit(check_replaceable, out, names)
                known = prepared_run(source, settings, sensor, variant)
                replaceable.result()
            prepared = _prepare(source, settings, *known, full=full, progress=progress)
        with output_folder(out) as folder:
            light = prepared()
            image, camera, settings, more = light.irradiance, light.camera, light.settings, light.more
            lap("render" if "plan" in more else "read")
            scored = progress("sense and score")
            image.header |= white_header([Seen(image, camera, physics)], settings.display)
            of_files = full, formats, frames, irradiance, sensor, variant, units
            made_from = digest_of_content(of_files, light, physics.technology)
            if are_kept(folder, "run", made_from):
                files_are_finished()
                return kept_summary(folder, notes)
            given = {"sensor": sensor, "variant": variant, "units": units, "frames": str(frames) if frames > 1 else None}
            command = ["pixsim", "run", light.source, "--config", SETTINGS_FILE, *["--full"] * full]
            command += [word for name, value in given.items() if value for word in (f"--{name}", value)]
            text = settings_text(light.repeated or settings, shlex.join(command))
            with publishing(folder, "run", {"seconds": seconds}, keep=[Path(source)]) as partial_folder:
                with ThreadPoolExecutor(1) as pool:  # the largest file by far is written meanwhile
                    written = pool.submit(write_irradiance, partial_folder, image, irradiance)
                    compiled = pool.submit(compile_page, PAGE)
                    of_sensor = settings.pixel, settings.exposure, settings.display, full, settings.correction, settings.develop
                    with watched(share_of(scored, 0.0, BEFORE_FRAME)):
                        chain = make_imaging_chain(image, camera, *of_sensor)
                    scored(BEFORE_FRAME)
                    score = chain.simulate("evaluate", settings.seed)
                    if "error_budget" in more:  # mean over the sensors of the budget, including the one shown
                        sensors = more["error_budget"]["settings"]["sensors"]
                        others = [chain.simulate("evaluate", settings.seed, number).mean_delta_e for number in range(1, sensors)]
                        more |= {"sensors": sensors, "sensors_mean_delta_e": float(np.mean([score.mean_delta_e, *others]))}
                    lap("sense and score")
                    written_share = progress("write")
                    written.result()
                    compiled.result()
                own = settings.exposure, settings.display, settings.seed, settings.correction
                summary = summary_of(score, image, camera, *own) | more
                if chain.rendition is not None:
                    summary |= {"develop": settings.develop.model_dump(), "colour": chain.colour_facts(score.frame.integration_s)}
                if irradiance == "factors" and not image.factors:
                    warn("the light has no factors (spectrum × picture): irradiance.exr holds its bands in full")
                summary |= {"frames": frames} if frames > 1 else {}
                causes = [str(cause) for cause in light_of(summary).causes]
                summary["notes"] = list(dict.fromkeys([*causes, *notes, *summary["notes"]]))
                (partial_folder / SETTINGS_FILE).write_text(text, encoding="utf-8")
                for number, frame in enumerate(chain.further_frames(frames, "evaluate", settings.seed), 2):
                    for suffix in formats:
                        write_frame(partial_folder / f"{raw_stem(number)}{suffix}", frame)
                    written_share(number / frames)
                write_all(partial_folder, image, score, summary, formats)
                lap("write")
            write_made_from(folder, "run", made_from)
    return summary


def kept_summary(folder: Path, notes: Sequence[str]) -> dict[str, Any]:
    """Return score.json of a folder whose files are kept, and repeat its warnings but those of `notes`, which were given."""
    summary: dict[str, Any] = json.loads((folder / "score.json").read_bytes())  # which is as it was written
    for note in summary["notes"]:
        if note not in notes and note not in own_notes(summary):
            warn(note)
    return summary


def summary_of(
    score: Score, irradiance: SpectralImage, camera: Camera, exposure: Exposure, display: Display, seed: int, correction: Correction
) -> dict[str, Any]:
    """Return score.json: the results, then the settings.

    `pixels` and `scored_dots` are rows and columns; `border_um`, above and to the left, is the border that is not scored.
    """
    physics, time_s = score.physics, score.frame.integration_s
    area_um2 = collecting_area_um2(irradiance, camera, physics)
    white_e = white_rate(irradiance, camera, physics, display) * area_um2 * physics.bin_side**2 * time_s
    causes = causes_of(irradiance.header, physics, white_e, time_s, lightness_range(score.ideal))
    summary = {
        **score.statistics(),
        "pixels": list(score.frame.pixels),
        "scored_dots": list(score.delta_e.shape),
        "border_um": list(score.border_um),
        "pixel": physics.pixel.model_dump(),
        "assumption": physics.pixel.assumption,
        "white_spectrum": white_light(irradiance)[1],
        "irradiance": irradiance.header,
        "dark": dark_clip(physics, time_s, white_e),
        "causes": [cause.as_dict() for cause in causes],
        "camera": camera.model_dump(),
        "exposure": exposure.model_dump(),
        "correction": correction.model_dump(),
        "display": display.model_dump(),
        "seed": seed,
    }
    return summary | {"notes": own_notes(summary)}


class Light(NamedTuple):
    """The light of a run and the settings that follow from it.

    source : the scene or picture, for a command in another folder
    settings : with what pixsim chose
    more : further entries of score.json
    repeated : settings that make the same picture again; None for `settings`
    """

    irradiance: SpectralImage
    camera: Camera
    source: str
    settings: Run
    more: dict[str, Any]
    repeated: Run | None = None


def prepared_run(
    source: str, settings: Run, sensor: str | None = None, variant: str | None = None
) -> tuple[Scene, Camera, Run, View]:
    """Return the scene, the camera of the window, and the settings with what they leave open; nothing is rendered.

    Raises PixsimError for invalid input.
    """
    from pixsim.scene.scene import load_scene
    from pixsim.sensor.pixel import derive
    from pixsim.studies.preparation import View, choose_view

    warn_of_unused_settings({"": [Configuration.of(settings, derive(settings.pixel))]})
    scene = load_scene(source, variant=variant, sensor=sensor, **settings.scene)
    whole = scene.camera(settings.camera, settings.lens)
    camera, pitch_um = whole.window(settings.window_mm), settings.pixel.pitch_um
    sheet = settings.pixel.technology == NO_TECHNOLOGY
    view = choose_view(pitch_um, camera, settings.display, scene) if sheet else View()
    check_pixel_count(pixels_on(camera.die_um, pitch_um), pitch_um)
    dot_edges_um(camera.die_um, pitch_um, settings.display, pitch_um)
    chosen = {"camera": whole.options, "display": view.display(settings.display)}
    scene = scene.with_resolution(settings.resolution) if settings.resolution else scene
    return view.scene(scene), camera, settings.model_copy(update=chosen | {"scene": view.parameters(settings.scene)}), view


def _prepare(
    source: str, asked: Run, scene: Scene, camera: Camera, settings: Run, view: View, *, full: bool, progress: Stage
) -> Callable[[], Light]:
    """Check everything that can be checked before a render, and return the function that renders.

    asked : settings before `prepared_run`, which returns those that follow
    """
    from pixsim.scene.convergence import without_clock
    from pixsim.scene.plan import Plan, make_plan
    from pixsim.scene.scene import packaged_scenes
    from pixsim.sensor.pixel import derive
    from pixsim.studies.oversampling import render_and_measure

    named = source if source in packaged_scenes() else str(scene.path)
    settled: Settled | None = None
    if settings.tolerance_delta_e:
        from pixsim.studies.budget import Setup, settle

        progress("calibrate")
        settled = settle(scene, camera, Setup.of(settings, camera), settings.tolerance_delta_e)
        chosen = {"render_noise": settled.choice.render_noise, "tolerance_e": settled.choice.tolerance_e}
        scene, settings = settled.scene, settings.model_copy(update=chosen | {"resolution": settled.scene.resolution})

    def plan_of(scene: Scene) -> Plan:
        display = None if settled else settings.display
        options: dict[str, Any] = {"display": display, "tolerance_e": settings.tolerance_e, "full": full}
        return make_plan(scene, camera, settings.pixel, exposure=settings.exposure, **options)

    plan = plan_of(scene)
    for note in plan.warnings:
        warn(note)

    def render() -> Light:
        options: dict[str, Any] = {"plan_of": plan_of, "settled": settled, "progress": progress("render")}
        made = render_and_measure(scene, camera, plan, settings, [settings.pixel], [derive(settings.pixel)], **options)
        more: dict[str, Any] = {"render_noise": asdict(made.noise), "plan": made.plan.as_dict(), "film": made.film.as_dict()}
        assumed = settings.pixel.assumption, focal_length_assumption(camera, asked.camera)
        more |= {"assumption": "; ".join(filter(None, assumed))}
        more |= {"chosen": view.as_dict()} | ({"window_mm": settings.window_mm} if settings.window_mm else {})
        repeated = without_clock(asked, settings, made.image)
        # Display and chart, too, may have been chosen; defaults in their place would count as given.
        of_view = {"display": settings.display, "scene": scene_table(scene.path.parent, settings.scene)}
        repeated = repeated.model_copy(update=of_view)
        if settled:
            bound_e = made.plan.bound_e if made.plan.bounded else None
            more["error_budget"] = settled.budget(made.noise, bound_e, settled.choice.sensors)
        return Light(made.image, camera, named, settings, more, repeated)

    return render


def light_of_picture(source: str, settings: Run, units: str | None) -> Light:
    """Return a picture of another program as the light of a run."""
    from pixsim.optics.exchange import read_with_camera
    from pixsim.sensor.pixel import derive
    from pixsim.studies.preparation import View, choose_view

    image, camera = read_with_camera(source, settings.camera, units, settings.lens)
    warn_of_unused_settings({"": [replace(Configuration.of(settings, derive(settings.pixel)), light=image)]})
    pixels_along(camera.die_um[1], settings.pixel.pitch_um)
    sheet = settings.pixel.technology == NO_TECHNOLOGY
    view = choose_view(settings.pixel.pitch_um, camera, settings.display, None) if sheet else View()
    chosen = {"camera": camera.options, "display": view.display(settings.display)}
    return Light(image, camera, str(Path(source).resolve()), settings.model_copy(update=chosen), {"chosen": view.as_dict()})


def write_irradiance(folder: Path, image: SpectralImage, irradiance: Irradiance = "reduced") -> None:
    """Write irradiance.exr of a run to a new folder; the last argument is that of `run_and_write`."""
    if irradiance != "none":
        path = folder / "irradiance.exr"
        write_exr(path, reduced_to_fit(image) if irradiance == "reduced" else image, factors_only=irradiance == "factors")
        digest_of(path, alone=True)  # which the provenance asks for


def write_all(
    folder: Path, image: SpectralImage, score: Score, summary: dict[str, Any], formats: Sequence[str] = (".exr",)
) -> None:
    """Write all files of a run but its provenance, irradiance.exr and further frames to a folder.

    formats : of the raw frame
    """

    def write_numbers() -> None:
        for suffix in formats:
            write_frame(folder / f"{raw_stem(1)}{suffix}", score.frame)
        write_channels(folder / "delta_e.exr", {"delta_e": score.delta_e}, {})

    with ThreadPoolExecutor(1) as pool:
        numbers = pool.submit(write_numbers)
        save_png(folder / "ideal.png", score.ideal)
        save_png(folder / "image.png", score.image)
        end = scale_end(summary["p99_delta_e"])
        save_delta_e_png(folder / "delta_e.png", score.delta_e, picture_axes(image, score.border_um), end)
        numbers.result()
    write_json(folder / "score.json", summary)
    write_run_page(folder, score, image, summary)
