"""What the errors of a study of colour sensors are made of, as a table."""

from __future__ import annotations

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.sensor.pixel import physics_of
from pixsim.show.pages import Column
from pixsim.studies.evaluations import chain_at, light_of, stream_key
from pixsim.studies.result import StudyResult
from pixsim.viewer.parts import delta_e_parts
from pixsim.viewer.score import prepare_scene


def parts_table(result: StudyResult) -> dict[str, Column]:
    """Return what the mean ΔE of each case is made of at its best size, for studies with colour filters; empty for others.

    Of its first sensor and frame, the same for all cases (`pixsim.viewer.parts`).
    """
    cases = result.parts or (result,)
    if not any(part.study.options_of(curve.technology).colour for part in cases for curve in part.curves):
        return {}
    rows: list[dict[str, float | str]] = []
    for part in cases:
        for curve in part.curves:
            pitch_um = float(curve.pitch_um[int(np.argmin(curve.mean()))])
            light = light_of(part.study, part.scenes, curve.technology)
            physics = physics_of(part.study, curve.technology, pitch_um).registered(0, part.study.display)
            if isinstance(light, SpectralImage):
                light = prepare_scene(light, part.camera, physics, part.study.display, border_um=part.study.border_um)
            chain = chain_at(part.study, light, part.camera, curve.technology, pitch_um)
            key = stream_key(part.study, physics.technology.name, pitch_um, 0)
            parts = delta_e_parts(part.irradiance, part.camera, physics, light, chain, *key)
            rows.append({"pixel": curve.label, "pitch_um": pitch_um, **parts.as_dict()})
        part.scenes.clear()
    return {name: [row[name] for row in rows] for name in rows[0]}
