"""What the errors of a study are made of at its best sizes: parts of colour sensors as a table, and noise budgets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel import PixelPhysics
from pixsim.show.pages import Column
from pixsim.studies.result import Curve, StudyResult
from pixsim.viewer.noise_budget import NoiseBudget, noise_budget
from pixsim.viewer.parts import delta_e_parts
from pixsim.viewer.score import ImagingChain, PreparedScene


def parts_table(result: StudyResult) -> dict[str, Column]:
    """Return what the mean ΔE of each case is made of at its best size, for studies with colour filters; empty for others.

    Of its first sensor and frame, the same for all cases (`pixsim.viewer.parts`).
    """
    if not any(part.study.options_of(curve.technology).colour for part in result.cases for curve in part.curves):
        return {}
    rows: list[dict[str, float | str]] = [
        {"pixel": best.curve.label, "pitch_um": best.pitch_um, **delta_e_parts(*best.of_pixel, *best.key).as_dict()}
        for best in best_frames(result)
    ]
    return {name: [row[name] for row in rows] for name in rows[0]}


def noise_budgets(result: StudyResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of each case at its best size, of its first sensor and frame; none where nobody asks."""
    if not result.study.noise_budget:
        return {}
    return {f"{best.curve.label}, {best.pitch_um:.3g} µm": noise_budget(*best.of_pixel, *best.key) for best in best_frames(result)}


class BestFrame(NamedTuple):
    """The first sensor and frame of the best of the sizes tried of a curve.

    of_pixel : light, camera, pixel, prepared light and chain
    key : of the sensor and the frame
    """

    curve: Curve
    pitch_um: float
    of_pixel: tuple[SpectralImage, Camera, PixelPhysics, PreparedScene, ImagingChain]
    key: tuple[object, ...]


def best_frames(result: StudyResult) -> Iterator[BestFrame]:
    """Yield that of each curve of each case."""
    for part in result.cases:
        for curve in part.curves:
            pitch_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
            series = part.series[curve.technology]
            light, imaging = series.light(), series.imaging.at(pitch_um)
            physics = imaging.registered(0)
            prepared = imaging.prepared(light, physics)
            of_pixel = part.irradiance, part.camera, physics, prepared, imaging.chain(prepared, physics)
            yield BestFrame(curve, pitch_um, of_pixel, (*series.stream_at(pitch_um), 0))
        part.scenes.clear()
