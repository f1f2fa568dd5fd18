"""Keys of what a study makes: each stage states the settings that it depends on, once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pixsim.base import cache
from pixsim.base.parameters import Camera, Effort, Run, Study, content_hash, pixel_of
from pixsim.light.spectral import SpectralImage
from pixsim.scene.plan import Plan
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.technology import technology_of
from pixsim.studies.rows import Row
from pixsim.studies.sampling import Sampling, first_sampling
from pixsim.viewer.score import allows_single

REPEATS_PER_TASK = 8  # evaluations after which a worker reports
COMPUTED_BY = ("mitsuba", "drjit", "colour-science")  # their versions are in each key, with pixsim's sources

# The settings that each stage depends on beside those of the stage before it. The sensors decide on the noise and the film of a
# render, and so does a part of the display.
OF_LIGHT = (
    *("scene", "camera", "lens", "seed", "tolerance_e", "render_noise", "resolution", "max_seconds", "window_mm"),
    *("tolerance_delta_e", "pitch", "exposure", "correction", "develop", "pixel", "sensors", "process", "technologies", "display"),
)
OF_FRAME = ("exposure", "correction")  # beside the light, the pixel and the random streams
OF_SCORE = ("display", "develop")
# On which no frame depends: what is said of them, which of them are made, and the cases, whose settings are their own.
OF_WORDS = ("title", "iso_delta_e", "detail", "paper", "sources")
OF_NO_FRAME = (*OF_WORDS, "repeats", "max_repeats", "target_ci_um", "max_evaluations", "refine", "axis", "condition", "quick")


def light_hash(study: Study) -> str:
    """Return the hash of everything that a render depends on."""
    return content_hash(study.model_dump(mode="json", include=set(OF_LIGHT)))


@dataclass(frozen=True)
class Fingerprints:
    """Hashes of everything that the evaluations of a study depend on.

    stored : whether its frames may go into the cache
    """

    study: Study
    camera: Camera
    irradiance: SpectralImage
    stored: bool = True
    _pixels: dict[tuple[str, float], str] = field(default_factory=dict, init=False, repr=False)
    _keys: dict[tuple[str, float], dict[int, str]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def imaging(self) -> str:
        """Hash of the irradiance, camera, exposure, correction and random streams, without pixel and display."""
        study, light = self.study, [self.irradiance.header, self.camera.model_dump()]
        streams = [study.stream_name, study.seed]
        # With pixsim's sources and the versions of the packages that compute, so that no row of another formula is reused.
        return content_hash([*light, study.model_dump(include=set(OF_FRAME)), *streams, cache.version_fingerprint(*COMPUTED_BY)])

    @cached_property
    def display(self) -> str:
        """Hash of the display, of the part of the die that is scored on it, and of the precision."""
        study = self.study
        border_um = study.border_um if study.display.raster == "fixed_size" else 0.0
        of_score = [getattr(study, name).content_hash for name in OF_SCORE]
        return content_hash([*of_score, border_um, allows_single(study.tolerance_delta_e)])

    def scene(self, technology: str) -> str:
        """Return the hash of the light that all pitches of a technology share."""
        process = technology_of(self.study, technology).content
        pixel = self.study.options_of(technology).model_dump(exclude={"technology"})  # a path is no content
        return content_hash([self.imaging, self.display, process, pixel])

    def pixel(self, technology: str, pitch_um: float) -> str:
        """Return the hash of everything that the frames of a pitch depend on."""
        if (technology, pitch_um) not in self._pixels:
            pixel = pixel_of(self.study, technology, pitch_um).model_dump(exclude={"technology"})  # a path is no content
            own = technology_of(self.study, technology).content, pixel, self.study.display.raster  # it decides on registrations
            self._pixels[technology, pitch_um] = content_hash([self.imaging, *own])
        return self._pixels[technology, pitch_um]

    def keys(self, technology: str, pitch_um: float, repeats: Iterable[int]) -> dict[int, str]:
        """Return the key of the row of each repeat."""
        keys, known = {}, self._keys.setdefault((technology, pitch_um), {})
        for repeat in repeats:
            if repeat not in known:
                known[repeat] = content_hash([self.pixel(technology, pitch_um), self.display, repeat])
            keys[repeat] = known[repeat]
        return keys

    def is_expected_row(self, row: Row) -> bool:
        """Return whether a row of results.csv may belong to the study and has the key of its technology, pitch and repeat."""
        technology, pitch_um, repeat = row["technology"], float(row["pitch_um"]), float(row["repeat"])
        if technology not in self.study.technologies or not (repeat >= 0 and repeat.is_integer()):
            return False
        pitches_um = self.first_sampling[technology]
        if not min(pitches_um) <= pitch_um <= max(pitches_um):
            return False
        return self.keys(technology, pitch_um, [int(repeat)])[int(repeat)] == row["key"]

    @cached_property
    def first_sampling(self) -> Sampling:
        return first_sampling(self.study)

    def frames_of_pitch(self, technology: str, pitch_um: float) -> str:
        """Return the cache key of the frames of a pitch; empty if the frames of the study do not fit in the cache."""
        return self.pixel(technology, pitch_um) if self.frames_fit_in_cache else ""

    @cached_property
    def frames_fit_in_cache(self) -> bool:
        """Whether all frames of the study fit in the cache without displacing most of it."""
        if not self.stored:
            return False
        study = self.study
        bits = max(study.options_of(technology).bits for technology in study.technologies)
        code_bytes = np.min_scalar_type(2**bits - 1).itemsize + (4 if study.correction.is_on else 0)
        sensors_per_pitch = study.repeats if study.target_ci_um is None else max(study.repeats, study.max_repeats)
        pitches = [pitch_um for sensors in self.first_sampling.values() for pitch_um in sensors]
        pixels = sum(math.prod(pixels_on(self.camera.die_um, pitch_um)) for pitch_um in pitches)
        return cache.has_room(pixels * code_bytes * sensors_per_pitch)


def block_key(frames_key: str, block: int) -> str:
    """Return the cache key of the frames of one task, which share a file."""
    return frames_key and f"{frames_key}-{block}"


EVALUATED = "evaluated"  # kind of the cache's entries that tell of a study
TELLING = 32  # cases by which a study is known


def evaluated_before(cases: Sequence[Study]) -> bool:
    """Whether the cache has the frames of all cases of a study, for an estimate of its time."""
    return cache.value_of(EVALUATED, _evaluated_key(cases), lambda value: bool(value["frames"])) or False


def remember_evaluated(cases: Sequence[Study]) -> None:
    """Note in the cache, once for a study, that it has the frames of all cases."""
    cache.store_value(EVALUATED, _evaluated_key(cases), {"frames": True})


def _evaluated_key(cases: Sequence[Study]) -> str:
    """Return the key of a study whose frames the cache may have; a frame does not depend on the display.

    The film is left out, which the render chooses. Of many cases some tell which study they are of.
    """
    some, left_out = cases[:: math.ceil(len(cases) / TELLING)], {*OF_SCORE, *OF_WORDS, "resolution"}
    of_frames = [study.model_dump(mode="json", exclude=left_out) for study in some]
    return content_hash([len(cases), of_frames, cache.version_fingerprint(*COMPUTED_BY)])


RENDERED = "rendered"  # kind of the cache's entries that tell of a render


def rendered_across(scene: Scene, camera: Camera, plan: Plan, settings: Run | Study) -> int | None:
    """Return the samples across the film that such a render ended with, if the cache has it; for an estimate of its time.

    plan : the first one of the render
    """
    return cache.value_of(RENDERED, _render_key(scene, camera, plan, settings), lambda value: int(value["across"]))


def remember_rendered(scene: Scene, camera: Camera, plan: Plan, settings: Run | Study, across: int) -> None:
    """Note in the cache that it has a render, on a film of so many samples across."""
    cache.store_value(RENDERED, _render_key(scene, camera, plan, settings), {"across": across})


def _render_key(scene: Scene, camera: Camera, plan: Plan, settings: Run | Study) -> str:
    limits = settings.model_dump(mode="json", include={"seed", *Effort.model_fields})
    of_scene = scene.content_hash, scene.choice.variant, camera.model_dump(mode="json")
    return content_hash([*of_scene, plan.as_dict(), limits, cache.version_fingerprint(*COMPUTED_BY)])
