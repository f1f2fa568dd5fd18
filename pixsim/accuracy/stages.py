"""Where the time of one result goes: parse, compile, render, diffraction, sensor, S-CIELAB, report."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from pixsim import display as displays
from pixsim.accuracy.probe import Setup, unheard
from pixsim.outputs import summary_of, write_all
from pixsim.parameters import Camera, Display, Run
from pixsim.pixel import derive
from pixsim.plan import Plan
from pixsim.renderer import Renderer
from pixsim.scene import Scene, load_scene
from pixsim.scielab import delta_e
from pixsim.score import Score, seen_lab, stream
from pixsim.sensor import capture_rate, diffracted_rate, draw_sensor, integrate_pixels
from pixsim.sensor_plan import make_plan
from pixsim.spectral import SpectralImage

LONG_S = 5.0


@dataclass
class Laps:
    """Wall seconds by stage; a stage that comes again adds up."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def opened(source: str, run: Run, sensor: str | None, variant: str | None, laps: Laps) -> tuple[Scene, Camera, Plan]:
    """The scene, its camera and its plan: what a run parses before it renders."""
    with laps("parse"):
        scene = load_scene(source, variant=variant, sensor=sensor, **run.scene)
        camera = scene.camera(run.camera)
        plan = make_plan(scene, camera, run.pixel, exposure=run.exposure, tolerance_e=run.tolerance_e)
        if plan.resolution:
            scene = scene.with_parameters(resolution=plan.resolution)
    return scene, camera, plan


def first_picture(scene: Scene, camera: Camera, plan: Plan, display: Display, laps: Laps) -> SpectralImage:
    """A render, and what the first one takes longer than the second: loading and compiling."""
    laps.seconds["compile"] = 0.0  # in its place: it comes before
    start = time.perf_counter()
    job = Renderer(scene, camera, plan, 0)
    image = job.image(*job.run(0))
    first = laps.seconds["render"] = time.perf_counter() - start
    if first < LONG_S:  # in a long one, loading and compiling hardly matter
        start = time.perf_counter()
        image = job.image(*job.run(1))
        laps.seconds["render"] = time.perf_counter() - start
        laps.seconds["compile"] = max(first - laps.seconds["render"], 0.0)
    image.header |= displays.white_header(image, camera, display)
    return image


def score_in_stages(image: SpectralImage, setup: Setup, laps: Laps) -> None:
    """One picture sensed, shown, compared and written, as `pixsim run` does it."""
    physics = derive(setup.pixel)
    with laps("diffraction"):
        rate = diffracted_rate(image, setup.camera, physics)
    with laps("sensor"):
        signal = integrate_pixels(rate, image.pitch_um, physics.pitch_um, physics.photodiode_side_um).clip(0.0)
        sensor = draw_sensor(physics, signal.shape, stream("stages", "sensor"))
        frame = capture_rate(signal, sensor, setup.exposure, stream("stages", "frame"))
    with unheard(), laps("S-CIELAB"):
        white_e = (
            displays.white_rate(image, setup.camera, physics, setup.display) * physics.photodiode_area_um2 * frame.integration_s
        )
        size_um = displays.picture_size_um(image)
        edges_um = displays.dot_edges_um(size_um, physics.pitch_um, setup.display, physics.pitch_um)
        ideal_luminance = displays.ideal_luminance(image, setup.camera, physics, setup.display, edges_um)
        ideal = displays.shown_luminance(ideal_luminance, setup.display)
        shown = displays.frame_luminance(frame, size_um, white_e, setup.display, edges_um)
        picture = displays.shown_luminance(shown, setup.display)
        map_ = delta_e(seen_lab(ideal, setup.display), seen_lab(picture, setup.display), setup.display.delta_e)
    score = Score(map_, ideal, picture, frame, physics)
    with tempfile.TemporaryDirectory() as folder, laps("report"):
        told = summary_of(score, image, setup.camera, setup.exposure, setup.display, setup.seed)
        write_all(Path(folder), image, score, told)
