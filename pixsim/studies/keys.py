"""Keys of what a study makes: each stage states the settings that it depends on, once."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base import cache
from pixsim.base.records import content_hash
from pixsim.optics.camera import Camera
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.settings import Study
from pixsim.studies.sizes import first_sampling
from pixsim.studies.store import Row
from pixsim.viewer.metric_options import has_target

if TYPE_CHECKING:
    from pixsim.studies.evaluate import LitCase

REPEATS_PER_TASK = 8  # after which a worker reports
MOST_REPEATS = 10_000  # of a pitch
CHECKED_REPEATS = 2  # whose frames are shown on further displays, too: enough to see whether an answer depends on the display
COMPUTED_BY = ("mitsuba", "drjit", "colour-science")  # their versions are in each key, with pixsim's sources

# The settings that each stage depends on beside those of the stage before it. The sensors decide on the noise and the film of a
# render, and so does a part of the display.
OF_LIGHT = (
    *("scene", "camera", "lens", "seed", "tolerance_e", "render_noise", "resolution", "max_seconds", "window_mm"),
    *(
        "tolerance_delta_e",
        "pitch",
        "exposure",
        "motion",
        "correction",
        "develop",
        "pixel",
        "sensors",
        "process",
        "technologies",
        "display",
    ),
)
OF_FRAME = ("exposure", "motion", "correction")  # beside the light, the pixel and the random streams


def light_hash(study: Study) -> str:
    """Return the hash of everything that a render depends on."""
    settings = [study.model_dump(mode="json", include=set(OF_LIGHT))]
    if has_target(study.metrics):
        settings.append(study.metric.detectability.model_dump(mode="json", include={"without"}))
    return content_hash(settings)


@dataclass(frozen=True)
class Fingerprints:
    """Hashes of everything that the evaluations of a case depend on."""

    lit: LitCase
    _pixels: dict[float, str] = field(default_factory=dict, init=False, repr=False)
    _keys: dict[float, list[str]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def imaging(self) -> str:
        """Hash of the light, camera, exposure, correction and random streams, without pixel and display."""
        settings = [getattr(self.lit.imaging, name).model_dump() for name in OF_FRAME]
        # With pixsim's sources and the versions of the packages that compute, so that no row of another formula is reused.
        return content_hash([self.lit.scenes.content, settings, *self.lit.case.stream, cache.version_fingerprint(*COMPUTED_BY)])

    @cached_property
    def shown(self) -> list[str]:
        """Hash of each display, of the part of the die that is scored on it, of the development, and of the precision."""
        imaging = self.lit.imaging
        border_um = imaging.border_um if imaging.display.raster == "fixed_size" else 0.0
        own = imaging.develop.content_hash, border_um, imaging.single, imaging.metrics.content
        return [content_hash([display.content_hash, *own]) for display in self.lit.displays]

    @cached_property
    def light(self) -> str:
        """Hash of the light behind the lens, and of the pixel but its size."""
        return content_hash([self.imaging, self.shown, *self._of_pixel(self.lit.imaging.pixel, "pitch_um")])

    def _of_pixel(self, pixel: Pixel, *but: str) -> tuple[object, ...]:
        return self.lit.imaging.physics.technology.content, pixel.model_dump(exclude={"technology", *but})  # a path is no content

    def pixel(self, pitch_um: float) -> str:
        """Return the hash of everything that the frames of a pitch depend on."""
        if pitch_um not in self._pixels:
            at_pitch = self.lit.imaging.at(pitch_um)
            # The raster decides on registrations.
            self._pixels[pitch_um] = content_hash([self.imaging, *self._of_pixel(at_pitch.pixel), at_pitch.display.raster])
        return self._pixels[pitch_um]

    def keys(self, pitch_um: float, count: int) -> Sequence[str]:
        """Return the key of each evaluation of a pitch: of `count` repeats, of the first ones on each display."""
        return self._known(pitch_um, count)[: point_count(count, len(self.shown))]

    def _known(self, pitch_um: float, count: int) -> list[str]:
        """Return the keys of a pitch of `count` repeats or more, not to be written to."""
        known, displays = self._keys.setdefault(pitch_um, []), len(self.shown)
        for number in range(len(known), point_count(count, displays)):
            repeat, display = point_at(number, displays)
            known.append(content_hash([self.pixel(pitch_um), self.shown[display], repeat]))
        return known

    def is_expected_row(self, row: Row, pitches_um: Collection[float]) -> bool:
        """Return whether a row of results.csv may belong to the case and has the key of its pitch and repeat.

        pitches_um : with which the case starts
        """
        pitch_um, repeat = float(row["pitch_um"]), float(row["repeat"])
        if row["technology"] != self.lit.case.sensor or not (0 <= repeat < MOST_REPEATS and repeat.is_integer()):
            return False
        if not min(pitches_um) <= pitch_um <= max(pitches_um):
            return False
        first, end = (point_count(count, len(self.shown)) for count in (int(repeat), int(repeat) + 1))
        return row["key"] in self._known(pitch_um, int(repeat) + 1)[first:end]

    def frames_of_pitch(self, pitch_um: float) -> str:
        """Return the cache key of the frames of a pitch; empty if the frames of the case are not cached."""
        return self.pixel(pitch_um) if self.lit.case.caches_frames else ""


def frames_fit_in_cache(study: Study, camera: Camera) -> bool:
    """Return whether all frames of a study fit in the cache without displacing most of it."""
    bits = max(study.options_of(technology).bits for technology in study.technologies)
    code_bytes = np.min_scalar_type(study.exposure.frames * (2**bits - 1)).itemsize + (4 if study.correction.is_on else 0)
    sensors_per_pitch = study.repeats if study.target_ci_um is None else max(study.repeats, study.max_repeats)
    pitches = [pitch_um for sensors in first_sampling(study).values() for pitch_um in sensors]
    pixels = sum(math.prod(pixels_on(camera.die_um, pitch_um)) for pitch_um in pitches)
    return cache.has_room(pixels * code_bytes * sensors_per_pitch)


def point_count(repeats: int, displays: int) -> int:
    """Return the number of evaluations of a pixel size: only the first repeats are shown on all displays."""
    return repeats + min(repeats, CHECKED_REPEATS) * (displays - 1)


def point_at(number: int, displays: int) -> tuple[int, int]:
    """Return the repeat and the display of the evaluation of a number, as `point_count` counts them."""
    checked = CHECKED_REPEATS * displays
    return divmod(number, displays) if number < checked else (CHECKED_REPEATS + number - checked, 0)


def block_key(frames_key: str, block: int) -> str:
    """Return the cache key of the frames of one task, which share a file."""
    return frames_key and f"{frames_key}-{block}"
