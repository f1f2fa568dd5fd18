"""What the errors of a study of colour sensors are made of, as a table."""

from __future__ import annotations

import numpy as np

from pixsim.show.pages import Column
from pixsim.studies.result import StudyResult
from pixsim.viewer.parts import delta_e_parts


def parts_table(result: StudyResult) -> dict[str, Column]:
    """Return what the mean ΔE of each case is made of at its best size, for studies with colour filters; empty for others.

    Of its first sensor and frame, the same for all cases (`pixsim.viewer.parts`).
    """
    if not any(part.study.options_of(curve.technology).colour for part in result.cases for curve in part.curves):
        return {}
    rows: list[dict[str, float | str]] = []
    for part in result.cases:
        for curve in part.curves:
            pitch_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
            series = part.series[curve.technology]
            light, imaging = series.light(), series.imaging.at(pitch_um)
            physics = imaging.registered(0)
            prepared = imaging.prepared(light, physics)
            key = *series.stream_at(pitch_um), 0
            parts = delta_e_parts(part.irradiance, part.camera, physics, prepared, imaging.chain(prepared, physics), *key)
            rows.append({"pixel": curve.label, "pitch_um": pitch_um, **parts.as_dict()})
        part.scenes.clear()
    return {name: [row[name] for row in rows] for name in rows[0]}
