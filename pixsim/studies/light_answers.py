"""The numbers that are asked of a light, mean ΔE and other metrics, as renders of less of it give
them: all renders of a scene are seen with the noise of one frame, so that their numbers differ by
the light alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pixsim.base.arrays import MEASURED, Array, in_threads
from pixsim.base.notes import suppressed_warnings
from pixsim.light.spectral import SpectralImage
from pixsim.scene.convergence import NO_TOLERANCE_DELTA_E, AnswerKey
from pixsim.sensor.motion_options import NO_MOTION
from pixsim.studies.film_error import (
    TOLERATED_DELTA_E,
    TOLERATED_SHARE,
    delta_e_on_films,
    parts_of,
    standard_noise_of,
    with_linear_denoising,
    with_noise,
)
from pixsim.viewer.chain import make_chain
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.frame_under_test import FrameUnderTest, numbers_of
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E, MetricRequest
from pixsim.viewer.scene_light import SceneLight, prepare_scene
from pixsim.viewer.screen import white_header

# Cells, pixels or quarters of dots that are measured of a light, seven times: what noise does to a
# part of a picture of that size scatters less than its bias is unsure.
_MEASURED = MEASURED // 4
_Light = tuple[SpectralImage, SpectralImage | None]  # with and without its target


@dataclass(frozen=True)
class LightAnswers:
    """What some pixels ask of one light (`pixsim.scene.convergence.Answers`).

    measured : the pixels, with one camera
    metrics : that are asked
    tolerance_delta_e : of mean ΔE. None tolerates the larger of 0.01 and 2 %
    are_corrected : whether the results are corrected for the bias by the noise, which is known for
        one pixel size
    """

    measured: Sequence[Imaging]
    metrics: MetricRequest
    tolerance_delta_e: float | None = None
    are_corrected: bool = False

    @property
    def content(self) -> Any:
        """All that the numbers and their tolerances depend on, for a hash."""
        pixels = [
            [
                imaging.pixel.model_dump(mode="json"),
                imaging.technology.content,
                imaging.exposure.model_dump(mode="json"),
                imaging.correction.model_dump(mode="json"),
                imaging.develop.model_dump(mode="json"),
                imaging.display.model_dump(mode="json"),
            ]
            for imaging in self.measured
        ]
        digests = [metric.digest() for metric in self.metrics.chosen]
        return [
            pixels,
            digests,
            self.metrics.options.model_dump(mode="json"),
            self.tolerance_delta_e,
        ]

    def tolerance(self, key: AnswerKey, value: float) -> float:
        """Return the largest error of a number that is tolerated."""
        if self.tolerance_delta_e is not None and self.tolerance_delta_e >= NO_TOLERANCE_DELTA_E:
            return math.inf
        share = TOLERATED_SHARE * abs(value)
        if key[0] != DELTA_E.columns[0]:
            return share
        if self.tolerance_delta_e is not None:
            return self.tolerance_delta_e
        return max(TOLERATED_DELTA_E, share)

    def values(self, lights: Sequence[_Light]) -> list[dict[AnswerKey, Array]]:
        """Return the numbers of several renders of one scene, by metric and pixel pitch: of mean ΔE
        those of parts of the picture, (parts,), of other metrics one, (1,).

        Pixels whose channels cannot be told apart have none, and neither has a metric that is
        undefined.
        """
        values: list[dict[AnswerKey, Array]] = [{} for _ in lights]
        for imaging in self.measured:
            try:
                with suppressed_warnings():  # the run itself warns
                    columns = self._columns(imaging, lights)
            except AlikeChannelsError:
                continue
            for numbers, pixel_numbers in zip(values, columns, strict=True):
                numbers.update(
                    {
                        (name, imaging.pixel.pitch_um): value
                        for name, value in pixel_numbers.items()
                        if np.isfinite(value).all()
                    }
                )
        return values

    def _columns(self, imaging: Imaging, lights: Sequence[_Light]) -> list[dict[str, Array]]:
        """Return the first number of each metric of one pixel, for each light, all shown with the
        white of the first one.
        """
        steady = imaging.changed(border_um=None, motion=NO_MOTION, exposure=imaging.exposure.steady)
        first, _ = lights[0]
        header = first.header | white_header([(steady, first)])
        lights = [
            (image.with_planes(image.whole.planes, header=header, margin=image.margin), background)
            for image, background in lights
        ]
        columns: list[dict[str, Array]] = [{} for _ in lights]
        others = [metric for metric in self.metrics.chosen if not metric.is_delta_e]
        if len(others) < len(self.metrics.chosen):
            images = [image for image, _ in lights]
            for numbers, delta_e in zip(columns, _mean_delta_e(steady, images), strict=True):
                numbers[DELTA_E.columns[0]] = delta_e
        if others:
            request = replace(self.metrics, chosen=tuple(others))
            frames = _frames(steady.changed(metrics=request), lights)
            for numbers, frame in zip(columns, frames, strict=True):
                judged = numbers_of(others, frame, {})
                for metric in others:
                    numbers[metric.columns[0]] = np.array([judged[metric.columns[0]]])
        return columns


def _mean_delta_e(imaging: Imaging, images: Sequence[SpectralImage]) -> list[Array]:
    """Return the mean ΔE of one pixel in each light, in parts of the picture, (parts,)."""
    imaging = with_linear_denoising(imaging)
    means = [np.empty(0)] * len(images)
    noise: list[Array] = []

    def measure(number: int) -> None:
        pitch_um = imaging.physics.read_pitch_um
        parts = list(parts_of(images[number], pitch_um, imaging.display, _MEASURED))
        (means[number],) = delta_e_on_films([parts], [[None] * len(parts)], imaging, noise=noise)

    measure(0)  # its noise is that of all
    size = len(images) * images[0].planes[0].size
    in_threads(measure, range(1, len(images)), size)
    return means


def _frames(imaging: Imaging, lights: Sequence[_Light]) -> list[FrameUnderTest]:
    """Return a frame of one pixel in each light, with the noise of the first one."""
    frames: list[FrameUnderTest] = []
    noise: Array | None = None
    for image, background in lights:
        light = SceneLight(image, background)
        chain = make_chain(imaging, prepare_scene(imaging, light))
        if noise is None:
            noise = standard_noise_of(chain, imaging, 0)
        frame = with_noise(chain, noise)
        frames.append(FrameUnderTest.of(chain, frame, stream=("accuracy", 0)))
    return frames
