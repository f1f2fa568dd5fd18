"""The noise budgets of a study at its best sizes."""

from __future__ import annotations

import numpy as np

from pixsim.studies.result import StudyResult
from pixsim.viewer.chain import make_chain
from pixsim.viewer.noise_budget import NoiseBudget, noise_budget


def noise_budgets(result: StudyResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of each curve of each case by its words, at the best of the sizes tried; empty where nobody asks.

    It is that of the first sensor and its first frame, which are the same for all cases.
    """
    if not result.study.noise_budget:
        return {}
    budgets = {}
    for case in result.cases:
        for curve in case.curves:
            pitch_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
            series = case.series[curve.technology]
            chain = make_chain(series.imaging.at(pitch_um).registered(0), series.light())
            budget = noise_budget(chain, case.irradiance, *series.stream_at(pitch_um), 0)
            budgets[f"{curve.label}, {pitch_um:.3g} µm"] = budget
        case.scenes.clear()
    return budgets
