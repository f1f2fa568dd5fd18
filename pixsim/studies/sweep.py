"""Many sensors in one light: the frames are those of `pixsim.evaluate`, computed as the evaluations of a study are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pixsim.base.arguments import Count, Jobs, Whole, checks_arguments
from pixsim.base.errors import invalid, name_fault
from pixsim.base.notes import collected_notes, warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import NO_CORRECTION, Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.infrared import light_notes
from pixsim.sensor.integration import array_size_um
from pixsim.sensor.motion_options import STILL, Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.technology import load_technology
from pixsim.sensor.unit_slips import unit_slips
from pixsim.studies.design import Case, named
from pixsim.studies.engine import workers_here
from pixsim.studies.evaluate import check_ideals, evaluate_points, lit_cases
from pixsim.studies.lights import Light
from pixsim.studies.result import causes_of_frames
from pixsim.studies.table import Table
from pixsim.viewer.develop_options import DEVELOP, Develop, check_develop
from pixsim.viewer.display import dot_edges_um, picture_size_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricContext, MetricRequest
from pixsim.viewer.review import background_notes, camera_notes
from pixsim.viewer.score import Score
from pixsim.viewer.screen import IdealFacts, warn_of_clipping, white_header, with_white
from pixsim.viewer.setting import Run
from pixsim.viewer.without_effect import GivenSettings, warn_of_settings_without_effect

PIXEL = "pixel"


@checks_arguments
def sweep(
    light: SpectralImage,
    pixels: Mapping[str, Pixel] | Sequence[Pixel],
    *,
    camera: Camera,
    exposure: Exposure | None = None,
    display: Display | None = None,
    correction: Correction | None = None,
    motion: Motion | None = None,
    develop: Develop | None = None,
    metrics: Sequence[str | Callable[[Score], float]] = ("delta_e",),
    metric: MetricOptions | None = None,
    without: SpectralImage | None = None,
    repeats: Count = 1,
    seed: Whole = 0,
    jobs: Jobs | None = None,
) -> Table:
    """Evaluate many sensors in one light, rendered or of another program.

    The frames are those of `pixsim.evaluate`, and of `pixsim run --repeats`, with the same seed, bit for bit; equal sensors have
    equal frames. All are shown with one white, and scored on the same dots: the border of the largest pixels is left out. So
    pixels of one size have the numbers of `evaluate`, and smaller ones among larger ones those of fewer dots.

    pixels : of each sensor; a list, or names -> pixels
    camera, exposure, display, correction, develop, motion, metric, without : as of `pixsim.evaluate`
    metrics : names of metrics, or functions of a Score that return a number; each has its columns. One that has no number for a
        frame, as NIIRS for one that is overexposed, is NaN, with a warning that says why
    repeats : sensors of each kind
    seed : of the fixed patterns and the temporal noise
    jobs : processes; None means one per core, where they are worth it. The results do not depend on it

    Raises PixsimError as `evaluate` does, with the pixel's name or its place in the list, from 0.

    >>> light = SpectralImage([550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header={"diffraction": False})
    >>> pixels = [Pixel(pitch_um=pitch_um, prnu=0) for pitch_um in (60.0, 84.8)]
    >>> table = sweep(light, pixels, camera=Camera(), display=Display(white_cd_per_m2=1000, dots=32), jobs=1)
    >>> [(row["pixel"], row["pitch_um"]) for row in table], table[0]["mean_delta_e"] < 1
    ([(0, 60.0), (1, 84.8)], True)
    """
    by_name: Mapping[Any, Pixel] = pixels if isinstance(pixels, Mapping) else dict(enumerate(pixels))
    if not by_name:
        raise invalid("pixels", "none", "at least one Pixel")
    for name in by_name:
        if not isinstance(name, int) and (fault := "is empty" if not name else name_fault(name)):
            raise invalid("pixels", f"a name that {fault}: {name!r:.80}", "names for a column of a table")
    request = MetricRequest(metrics_named(metrics), metric or METRIC_OPTIONS)
    asked: dict[Any, Imaging] = {}
    for name, pixel in by_name.items():
        with named(f"pixel {name}"):
            asked[name] = Imaging(
                camera,
                pixel,
                load_technology(pixel.technology),
                exposure or Exposure(),
                display or Display(),
                correction=correction or NO_CORRECTION,
                develop=develop or DEVELOP,
                motion=motion or STILL,
                metrics=request,
                is_run=True,
            )
    with collected_notes():
        for note in (*background_notes(request.names, without), *camera_notes(camera, light)):
            warn(note)
        check_pixels(asked, light, has_background=without is not None)
        warn_of_settings_without_effect({"": (GivenSettings.of_records(imaging, light) for imaging in asked.values())})

        # All are scored on the dots that the largest pixels leave, with one white.
        border_um = max(imaging.scored_border_um for imaging in asked.values())
        scored = {name: imaging.changed(border_um=border_um) for name, imaging in asked.items()}
        white = white_header([(imaging, light) for imaging in scored.values()])
        scored = {name: imaging.changed(display=with_white(imaging.display, white)) for name, imaging in scored.items()}
        first, *_ = scored.values()
        cases = [
            Case(
                Run(pixel=imaging.pixel, seed=seed),
                sensor=imaging.physics.technology.name,
                labels={PIXEL: name},
                group=0,
                imaging=imaging,
                stream=("evaluate", seed),
                stream_has_pitch=False,
                sizes={imaging.pixel.pitch_um: repeats},
            )
            for name, imaging in scored.items()
        ]
        lit = lit_cases(cases, [Light(light.identified, camera, without=without)] * len(cases))
        check_ideals(lit)
        table = evaluate_points(lit, None, None if jobs is None else workers_here(jobs))
        of_light: dict[object, IdealFacts] = {}
        for one, rows in zip(lit, table.by_case(), strict=True):
            where = f"pixel {one.case.labels[PIXEL]}"
            for reason in dict.fromkeys(rows.reasons.values()):
                warn(f"{where}: {reason}")
            if not len(rows.possible):
                continue
            if one.light_id not in of_light:
                of_light[one.light_id] = one.scenes.ideal_facts(one.light_key, one.imaging)
            for cause in causes_of_frames(light, one.imaging, of_light[one.light_id].lightness, rows.possible):
                if cause.leaves_nothing:
                    warn(f"{where}: {cause}")
        warn_of_clipping(max((facts.beyond_white for facts in of_light.values()), default=0.0), light.header, first.display)
    return table


def check_pixels(asked: Mapping[Any, Imaging], light: SpectralImage, *, has_background: bool) -> None:
    """Raise PixsimError for one of several pixels, by its name, as `check_pixel`; warn of doubtful numbers and stacks."""
    for name, imaging in asked.items():
        with named(f"pixel {name}"):
            check_pixel(imaging, light, has_background=has_background)
        for note in unit_slips(imaging.pixel):
            warn(f"pixel {name}: {note}")
        for note in light_notes(imaging.physics, imaging.camera, light):
            warn(note)


def check_pixel(imaging: Imaging, light: SpectralImage, *, has_background: bool) -> None:
    """Raise PixsimError for a pixel that a metric, its development or the dots of the display do not allow.

    has_background : whether there is light of the scene without its target
    """
    imaging.metrics.check(MetricContext(imaging.pixel.colour is not None, has_background))
    check_develop(imaging.develop, imaging.pixel)
    physics = imaging.physics
    dot_edges_um(
        picture_size_um(light),
        physics.read_pitch_um,
        imaging.display,
        imaging.scored_border_um,
        array_size_um(light, imaging.camera),
        physics.registration,
    )
