"""Results of runs without a render, for tests of what is said of them."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from pixsim.optics.camera import Camera
from pixsim.studies.film_error import FilmError
from pixsim.studies.run import RunResult
from pixsim.studies.table import Table
from pixsim.viewer.score import Cause
from pixsim.viewer.setting import Run

FRAME = {"pixels": (8, 8), "integration_s": 0.01, "saturated_fraction": 0.0}


def run_result(
    delta_e: Sequence[float],
    header: dict,
    film: FilmError | None = None,
    causes: Sequence[Cause] = (),
    *,
    settings: dict | None = None,
    frame: dict = FRAME,
    pitch_um: float = 5.0,
    border_um: float = 0.0,
    **known,
) -> RunResult:
    """A run of sensors of these mean ΔE, with the errors of its light.

    settings : tables of `Run`
    known : properties in place of what would be computed
    """
    prepared = SimpleNamespace(
        settings=Run.model_validate(settings or {}),
        camera=Camera(),
        view={},
        cases=[SimpleNamespace(picture=True)],
    )
    prepared.stated = prepared.settings
    physics, border = SimpleNamespace(pitch_um=pitch_um), (border_um, border_um)
    score = SimpleNamespace(
        frame=SimpleNamespace(**frame), physics=physics, border_um=border, mean_delta_e=delta_e[0]
    )
    noise = SimpleNamespace(fraction=header.get("render_noise", {}).get("fraction", 0.0), bias={})
    rendered = film and SimpleNamespace(film=film, noise=noise)
    light = SimpleNamespace(header=header)
    chain = SimpleNamespace(colour_chart=None)
    repeats = np.arange(len(delta_e))
    columns = {
        "pitch_um": np.full(repeats.size, pitch_um),
        "repeat": repeats,
        "mean_delta_e": np.array(delta_e),
    }
    table = Table(({"technology": "0.35um"},), np.zeros(repeats.size, np.int32), columns)
    result = RunResult(prepared, light, rendered, chain=chain, score=score, table=table)
    result.__dict__.update({"causes": tuple(causes), "budget": None, **known})
    return result
