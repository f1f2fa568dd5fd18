"""Series: one sensor in one case. Every evaluation is one of a series, a pitch, a repeat and a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout
from pixsim.sensor.colour_options import channels_of
from pixsim.sensor.integration import electrons_per_joule
from pixsim.sensor.labels import label_in
from pixsim.studies.keys import Fingerprints, frames_fit_in_cache
from pixsim.studies.sampling import imaging_of, study_pitches_um
from pixsim.studies.study_settings import Study
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricRequest
from pixsim.viewer.scene_light import PreparedScene, SceneCache, SceneLight, SharedLight
from pixsim.viewer.screen import allows_single
from pixsim.viewer.setting import Setting


@dataclass(frozen=True)
class Series:
    """One sensor in one case: its pixels of any size, in one light, whose frames are shown on one display or on several.

    name : of its technology or data sheet, as in rows
    imaging : at its largest pitch, on the first display
    scenes : the light behind the lens, which series of the same light share
    stream : how the keys of its random streams begin; then follow the pitch, if `stream_has_pitch`, and the repeat
    columns : that tell its rows from those of other cases
    words : of its case, for messages
    stored : whether its frames may go into the cache
    """

    name: str
    imaging: Imaging
    scenes: SceneCache = field(repr=False)
    stream: tuple[object, ...]
    stream_has_pitch: bool = True
    columns: Mapping[str, str] = field(default_factory=dict)
    words: str = ""
    stored: bool = True

    @property
    def label(self) -> str:
        """Sensor and case, for messages."""
        return label_in(self.name, self.words)

    @property
    def displays(self) -> tuple[Display, ...]:
        """The displays on which each frame is shown."""
        return self.imaging.display, *self.scenes.others

    def stream_at(self, pitch_um: float) -> tuple[object, ...]:
        """Return the key of its random streams at a pitch, without the repeat."""
        return (*self.stream, pitch_um) if self.stream_has_pitch else self.stream

    @cached_property
    def light_key(self) -> tuple[bytes, float, str]:
        """What the light behind the lens depends on, beside the irradiance, the camera and the displays of `scenes`."""
        physics = self.imaging.physics
        charge = physics.charge.content_hash if physics.charge else ""  # diffusion is in the light behind the lens
        electrons = b"".join(electrons_per_joule(channel, self.scenes.irradiance).tobytes() for channel in physics.channels)
        return electrons, self.border_um, f"{charge} {Layout.of_pixels(physics.pixel) or ''}"

    @property
    def light_id(self) -> tuple[int, tuple[bytes, float, str]]:
        """What tells its light from those of other renders, too."""
        return id(self.scenes), self.light_key

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored."""
        border_um = self.imaging.border_um
        assert border_um is not None
        return border_um

    def light(self) -> SharedLight:
        """Return the light that all its pitches share, and other series of the same response."""
        light = self.scenes.get(self.light_key, self.imaging)
        if isinstance(light, PreparedScene):
            light.store_integrals()
        return light

    @cached_property
    def fingerprints(self) -> Fingerprints:
        """Keys of its frames and rows."""
        return Fingerprints(self)


def series_of(
    study: Study, scenes: SceneCache, columns: Mapping[str, str] | None = None, words: str = "", *, stored: bool = True
) -> list[Series]:
    """Return the series of a study without axes, one for each of its technologies.

    scenes : of its light
    columns, words : of its case
    stored : whether its frames may go into the cache, if they fit
    """
    stored = stored and frames_fit_in_cache(study, scenes.camera)
    made = []
    for name in study.technologies:
        largest_um = float(study_pitches_um(study, name)[-1])
        shared = {"single": scenes.imaging.single, "metrics": scenes.imaging.metrics}
        imaging = imaging_of(study, scenes.camera, name, largest_um).changed(**shared)
        # The name of the technology, not its path, which is no part of a result.
        stream = study.stream_name, study.seed, imaging.physics.technology.name
        made.append(Series(name, imaging, scenes, stream, True, columns or {}, words, stored))
    return made


def scenes_of(
    study: Study, irradiance: SpectralImage, camera: Camera, others: Sequence[Display] = (), without: SpectralImage | None = None
) -> SceneCache:
    """Return the cache of the lights behind the lens of a study.

    others : displays on which its frames are shown, too
    without : irradiance of the scene without its target
    """
    first = study.technologies[0]
    imaging = imaging_of(study, camera, first, float(study_pitches_um(study, first)[-1])).changed(
        single=allows_single(study.tolerance_delta_e), metrics=metrics_of(study, study.repeats)
    )
    return SceneCache(imaging, SceneLight(irradiance, without), most_channels(study), others)


def metrics_of(settings: Setting, repeats: int = 1) -> MetricRequest:
    """Return which metrics judge frames, so many of which share the registrations of a pixel size."""
    return MetricRequest(metrics_named(settings.metrics), settings.metric, repeats)


def most_channels(study: Study) -> int:
    """Return the largest number of channels among a study's sensors, 1 for monochrome ones."""
    colours = [study.options_of(technology).colour for technology in study.technologies]
    return max(1 if colour is None else len(channels_of(colour.cell)) for colour in colours)
