"""What is computed for the page: only for its last settings, first the picture, then its errors,
then a curve over pixel sizes.
"""

from __future__ import annotations

import base64
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pixsim.base.digits import estimate
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.layers import Layer
from pixsim.base.notes import collected_notes
from pixsim.base.progress import Progress
from pixsim.base.toml import SETTINGS_FILE, packaged
from pixsim.explorer.controls import (
    LENS,
    NO_LENS,
    PITCH,
    Preset,
    command_words,
    controls_of,
    presets_of,
    with_values,
)
from pixsim.light.quantities import LUMINANCE
from pixsim.light.spectral import SpectralImage
from pixsim.report.run import run_document, run_settings_text
from pixsim.show.pictures import delta_e_colours, display_codes, png_bytes, scale_end
from pixsim.show.render import text
from pixsim.studies.design import metrics_of
from pixsim.studies.prepare import Job
from pixsim.studies.run import RenderedRun, RunResult, prepare, render_run, score_run
from pixsim.viewer.merging import merge, merged, without_replaced_scenes
from pixsim.viewer.metric_registry import METRICS
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.scene_light import RecentScenes
from pixsim.viewer.score import converged
from pixsim.viewer.screen import HEADER_OF_WHITE
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings, scene_options, settings_layer

MAX_LIGHTS = 3  # in memory
MAX_SENSORS = 2  # side by side
REPEATS = 4  # sensors of each kind, for the 95 % interval of their mean
_CURVE_STEPS = 4  # sizes on each side of the pixel's
_SIZES_PER_DECADE = 12  # from one pixel size to ten times it
_PROGRESS_INTERVAL_S = 0.2  # between two words on what is being done
_MAX_COLUMNS = 10_000  # of a line of text: the page breaks lines itself
_LIGHT_SETTINGS: Any = {"display": {"white"}} | dict.fromkeys(
    ("scene", "lens", "window_mm", "seed", "resolution", "tolerance_e"), True
)


class _SupersededError(BaseException):
    """Other settings came, or the page was closed: the answer in progress is no longer needed."""


class PageRequest(NamedTuple):
    """Request of a page: a preset and values of controls for each sensor, metrics beside ΔE, and
    whether curves are drawn.
    """

    number: int
    sensors: tuple[tuple[int, Mapping[str, Any]], ...]
    metrics: tuple[str, ...] = ()
    curve: bool = False

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> PageRequest:
        """Return a request from JSON. Raises PixsimError for another message."""
        try:
            sensors = tuple(
                (int(sensor["preset"]), dict(sensor["set"])) for sensor in message["sensors"]
            )
            request = cls(
                int(message["number"]), sensors, tuple(message["metrics"]), bool(message["curve"])
            )
            has_metrics = all(name in METRICS for name in request.metrics)
            if 1 <= len(sensors) <= MAX_SENSORS and has_metrics:
                return request
        except (KeyError, TypeError, ValueError, OverflowError):
            pass  # no request
        raise invalid(
            "page", "a message that is not a request", "a request from this version's page"
        )


@dataclass
class Session:
    """Computes the answers to one page's requests.

    It does so in the thread of `serve`; `ask` and `end` may be called from any thread.

    source : scene, or picture of another program; or light in memory. None takes the scene of
        `config`, or csf
    config, tables : settings files and options of the user
    prepare_arguments : further arguments of `prepare`
    send : takes each message for the page
    """

    source: str | SpectralImage | None
    config: Sequence[Path] = ()
    tables: Mapping[str, Any] = field(default_factory=dict)
    prepare_arguments: Mapping[str, Any] = field(default_factory=dict)
    send: Callable[[dict[str, Any]], None] = lambda message: None

    def __post_init__(self) -> None:
        self._wake = threading.Event()
        self._ended = False
        self._progress_sent_s = 0.0
        self._request: PageRequest | None = None
        self._lights: dict[str, RenderedRun] = {}  # the last one last
        self._scenes = RecentScenes()
        self._points: dict[str, list[float]] = {}
        self.light = self.source if isinstance(self.source, SpectralImage) else None
        file = self.source if isinstance(self.source, str) else None
        layers = [settings_layer(path) for path in self.config]
        if self.source is None and not any(layer.sets(("scene", "file")) for layer in layers):
            file = "csf"
        tables = merge(dict(self.tables), {"scene": scene_options(file, {})})
        scene = merged(without_replaced_scenes([*layers, Layer(tables)])).get("scene", {})
        self.presets = presets_of(self.config, tables, scene)
        self.controls = controls_of((), ())
        first = self._job(PageRequest(0, ((0, {}),)), 0)  # bad input is refused before a page opens
        self.title = first.file if self.light is None else "light in memory"
        if first.cases[0].picture is None:
            scene = first.cases[0].scene
            lenses = dict.fromkeys([first.stated.lens.file or NO_LENS, *packaged("data/lenses")])
            self.controls = controls_of({*scene.names, *scene.text().defaults}, tuple(lenses))

    def hello(self) -> dict[str, Any]:
        """Return what a page is made of."""
        presets = [{"group": preset.group, "name": preset.name} for preset in self.presets]
        others = {
            name: f"{metric.words} ({metric.judges})"
            for name, metric in METRICS.items()
            if metric is not DELTA_E
        }
        controls = [asdict(control) | {"is_shared": control.is_shared} for control in self.controls]
        return {
            "hello": {
                "title": self.title,
                "presets": presets,
                "metrics": others,
                "controls": controls,
                "sensors": REPEATS,
            }
        }

    def ask(self, request: PageRequest) -> None:
        """Drop the current request, and compute this one."""
        self._request = request
        self._wake.set()

    def end(self) -> None:
        """End `serve`."""
        self._ended = True
        self._wake.set()

    def serve(self) -> None:
        """Compute the requests until `end` is called."""
        answered = None
        while not self._ended:
            self._wake.wait(0.5)  # not for ever at once: some systems would then take no Ctrl-C
            self._wake.clear()
            if (request := self._request) is None or request is answered:
                continue
            answered = request
            try:
                with warnings.catch_warnings():
                    warnings.showwarning = lambda *_, **__: None  # the page has them as notes
                    self.answer(request)
            except _SupersededError:
                pass  # what came is next
            except (PixsimError, MemoryError) as error:
                words = (
                    str(error) or "out of memory: use larger pixels, or a smaller part of the die"
                )
                self.send({"number": request.number, "error": words})
            except Exception as error:  # the other requests of the page still have an answer
                words = f"unexpected {type(error).__name__}: {error}. This is a bug in pixsim"
                self.send({"number": request.number, "error": words})

    def answer(self, request: PageRequest) -> None:
        """Send the pictures of a request as soon as they are known, then with their errors, then
        curves.
        """
        # First pictures come from a cached light, without its errors.
        jobs: list[Job[Run]] = []
        first_results: list[RunResult | None] = []
        for number in range(len(request.sensors)):
            first: RunResult | None = None
            with collected_notes(alone=True):
                job = self._job(request, number)
                first_run = self._first_run(job)
                if first_run is not None:
                    first = score_run(first_run, self._stage(request), self._scenes)
            jobs.append(job)
            first_results.append(first)
            if first is not None:
                self.send(self._message(request, number, first, has_errors=False))

        runs = []
        for number, (job, first) in enumerate(zip(jobs, first_results, strict=True)):
            with collected_notes(alone=True):
                rendered_run = self._store_light(render_run(job, self._stage(request)))
                result = score_run(rendered_run, self._stage(request), self._scenes)
                has_pictures = first is not None and np.array_equal(
                    first.score.image, result.score.image
                )
                message = self._message(
                    request, number, result, has_errors=True, has_pictures=has_pictures
                )
                self.send(message)
            runs.append(rendered_run)

        for number, rendered_run in enumerate(runs if request.curve else []):
            for point in self._curve(request, number, rendered_run):
                self.send({"number": request.number, "sensor": number, "point": point})
        self.send({"number": request.number, "done": True})

    def _settings(self, request: PageRequest, number: int) -> tuple[Preset, dict[str, Any]]:
        """Return the preset of a sensor, and its options. Raises PixsimError for what this page
        does not have.
        """
        place, values = request.sensors[number]
        controls = {control.path: control for control in self.controls}
        if unknown := [path for path in values if path not in controls]:
            raise invalid("page", f"'{unknown[0]}'"[:80], "a control of this page")
        if not 0 <= place < len(self.presets):
            raise invalid("page", f"preset {place}", "a preset of this page")
        shared = {
            path: value
            for path, value in request.sensors[0][1].items()
            if path in controls and controls[path].is_shared
        }
        sensor_values = {
            path: value for path, value in values.items() if not controls[path].is_shared
        }
        fields = {
            path: controls[path].value(value) for path, value in (shared | sensor_values).items()
        }
        preset = self.presets[place]
        tables = with_values(preset.tables, fields)
        if request.metrics:
            tables["metrics"] = (DELTA_E.name, *request.metrics)
        return preset, tables

    def _job(self, request: PageRequest, number: int) -> Job[Run]:
        """Return the prepared run of a sensor."""
        preset, tables = self._settings(request, number)
        light = copy(self.light)
        if light is not None:  # a run writes the white into the header of its light
            light.header = dict(light.header)
        return prepare(
            run_settings(preset.config, tables),
            light=light,
            repeats=REPEATS,
            warns_of_unused_settings=False,
            **self.prepare_arguments,
        )

    def _stage(self, request: PageRequest) -> Callable[[str], Progress]:
        """Return stages that send their progress to the page, and end when other settings come."""

        def stage(name: str) -> Progress:
            def progress(done: float = 0.0, note: str = "") -> None:
                if self._request not in (None, request) or self._ended:
                    raise _SupersededError
                if time.monotonic() - self._progress_sent_s > _PROGRESS_INTERVAL_S:
                    self._progress_sent_s = time.monotonic()
                    self.send(
                        {"number": request.number, "busy": f"{name}: {100 * done:.0f} %{note}"}
                    )

            progress()
            return progress

        return stage

    def _light_key(self, job: Job[Run]) -> str:
        """Return a hash of all that lights for a first picture have in common.

        The accuracy that each pixel needs is not part of it.
        """
        bands = [] if job.cases[0].picture else job.request.plan.light.bands.edges_nm.tolist()
        return content_hash(
            [
                job.settings.model_dump(mode="json", include=_LIGHT_SETTINGS),
                job.camera.model_dump(mode="json"),
                bands,
            ]
        )

    def _first_run(self, job: Job[Run]) -> RenderedRun | None:
        """Return a run for the first picture, by ΔE alone, in a light that is cached or exact.

        Returns None if the light must be rendered.
        """
        case = job.cases[0]
        key = self._light_key(job)
        if key not in self._lights:
            if case.picture is not None:
                self._store_light(RenderedRun(job, case.picture))
            elif job.request.plan.samples.exact:
                plan = job.request.plan
                image = job.request.render(job.request.first, plan).image
                self._store_light(RenderedRun(job, image, None, plan))
            else:
                return None

        settings = case.settings.model_copy(update={"metrics": (DELTA_E.name,)})
        assert case.imaging is not None
        imaging = case.imaging.changed(metrics=metrics_of(settings))
        case = replace(case, settings=settings, imaging=imaging, sizes=dict.fromkeys(case.sizes, 1))
        first = replace(job, cases=(case,))
        return RenderedRun(first, self._lights[key].irradiance, None, self._lights[key].plan)

    def _store_light(self, rendered_run: RenderedRun) -> RenderedRun:
        """Cache the light of a run. Returns the run, with the cached light if that is the same."""
        key = self._light_key(rendered_run.prepared)
        image = rendered_run.irradiance
        if key in self._lights:
            cached = self._lights.pop(key).irradiance
            headers = [_without_estimated_white(light.header) for light in (cached, image)]
            if cached.shape == image.shape and headers[0] == headers[1]:
                cached.header = image.header  # with the white
                rendered_run = replace(rendered_run, irradiance=cached)
        while len(self._lights) >= MAX_LIGHTS:
            del self._lights[next(iter(self._lights))]
        self._lights[key] = rendered_run
        self._scenes.drop_all_but([run.irradiance for run in self._lights.values()])
        return rendered_run

    def _message(
        self,
        request: PageRequest,
        number: int,
        result: RunResult,
        *,
        has_errors: bool,
        has_pictures: bool = False,
    ) -> dict[str, Any]:
        """Return the message that shows a sensor on the page.

        has_errors : whether the errors of the light are measured
        has_pictures : whether the page has these pictures already
        """
        score = result.score
        job = result.prepared
        content: dict[str, Any] = {
            "number": request.number,
            "sensor": number,
            "sure": has_errors,
            "values": self._values(result),
        }
        if not has_pictures:
            end = scale_end(result.statistics[0]["p99_delta_e"])
            codes = {"ideal": display_codes(score.ideal), "image": display_codes(score.image)}
            codes["delta_e"] = delta_e_colours(score.delta_e, end)
            uris = {
                name: "data:image/png;base64," + base64.b64encode(png_bytes(picture)).decode()
                for name, picture in codes.items()
            }
            content |= {"pictures": uris, "end": end, "dots": score.image.shape[:2]}
        if not has_errors:
            words = (
                f"mean ΔE {estimate(result.mean_delta_e)} of one sensor, with errors that are being"
                " measured"
            )
            return content | {"lines": [words], "unsure": "errors not measured yet"}
        preset, tables = self._settings(request, number)
        flags = []
        for name in ("sensor", "variant", "units"):
            value = getattr(job, name)
            flags += [f"--{name}", value] if value else []
        if self.light is None:
            command = command_words(preset.config, tables, REPEATS, flags)
        else:
            command = command_words((Path(SETTINGS_FILE),), {}, REPEATS, flags)
        is_sure = converged(result.light, result.light_limit)
        content |= {
            "lines": text(run_document(result), _MAX_COLUMNS).splitlines(),
            "unsure": "" if is_sure else NOT_CONVERGED,
        }
        return content | {"command": command, "settings": run_settings_text(job, result.irradiance)}

    def _values(self, result: RunResult) -> dict[str, object]:
        """Return the values of the controls in effect, by their paths, as they are shown."""
        settings = result.settings
        score = result.score
        values: dict[str, object] = {}
        for control in self.controls:
            table, _, name = control.path.partition(".")
            if control.path == LENS:
                values[LENS] = settings.lens.file or NO_LENS
            elif table == "scene":
                value = self._scene_value(result, name.rpartition(".")[2])
                values[control.path] = control.page_value(value)
            else:
                records = (
                    getattr(settings, table),
                    result.camera,
                    score.physics,
                    score.readout,
                    score.readout.adc,
                    score.frame,
                )
                stated = (getattr(record, name, None) for record in records)
                value = next((value for value in stated if value is not None), None)
                values[control.path] = control.page_value(value)
        return values

    def _scene_value(self, result: RunResult, name: str) -> object:
        """Return the value of a scene parameter, or the luminance of a chart without one."""
        default = result.prepared.cases[0].scene.text().defaults.get(name)
        value = result.settings.scene.parameters.get(name, default)
        if value is None and result.plan:
            return result.plan.light.chart_white.get(LUMINANCE)
        return value

    def _curve(
        self, request: PageRequest, number: int, rendered_run: RenderedRun
    ) -> Iterator[list[float]]:
        """Yield pixel size, mean ΔE and half of its 95 % interval for sizes around the pixel's, the
        nearest first, in one light.
        """
        middle = round(_SIZES_PER_DECADE * np.log10(rendered_run.prepared.settings.pixel.pitch_um))
        for step in sorted(range(-_CURVE_STEPS, _CURVE_STEPS + 1), key=abs):
            pitch_um = float(f"{10 ** ((middle + step) / _SIZES_PER_DECADE):.3g}")
            preset, values = request.sensors[number]
            sensors = list(request.sensors)
            sensors[number] = preset, {**values, PITCH: pitch_um}
            try:
                with collected_notes(alone=True):
                    job = self._job(request._replace(sensors=tuple(sensors), metrics=()), number)
                    image = rendered_run.irradiance
                    key = content_hash([job.settings.model_dump(mode="json"), image.header])
                    if key not in self._points:
                        run = RenderedRun(job, image, None, rendered_run.plan)
                        result = score_run(run, self._stage(request), self._scenes)
                        low, high = result.interval_delta_e or (0.0, 0.0)
                        self._points[key] = [pitch_um, result.mean_delta_e, (high - low) / 2]
            except PixsimError:
                continue  # there are no such pixels: the curve ends here
            yield self._points[key]


def _without_estimated_white(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header without the white that was estimated for a pixel."""
    estimated = (*HEADER_OF_WHITE.values(), "white_from") if "white_from" in header else ()
    return {name: value for name, value in header.items() if name not in estimated}
