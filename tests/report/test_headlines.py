"""The first line of every answer is read at a glance: at most 30 words, whatever the result is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.runs import run_result

import pixsim
from pixsim.base.headline import MAX_HEADLINE_WORDS
from pixsim.report.curve import optimum_answer
from pixsim.report.run import run_answer, run_document, shown_mean_of
from pixsim.sensor.spectral_range import outside_share_text
from pixsim.show.document import plain_text
from pixsim.show.render import text
from pixsim.studies.curve import CaseLabels, CurveErrors
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.score import Cause, converged

FILM = FilmError(
    (256, 256), 10.0, (7.5,), (0.6,), (0.02,), "the limit of 4096 samples across for 20 pictures"
)
FILMS = [None, FILM, replace(FILM, delta_e=(math.nan,)), replace(FILM, delta_e=(0.01,), limit="")]
NOISE = {"fraction": 2.4, "target": 0.2, "ended_by": "samples"}
NOISES = [{}, {"render_noise": NOISE}]
CAUSES = [  # the longest words of each kind
    Cause("only 3.1 codes of the ADC between black and display white", 64.0, "more bits"),
    Cause("the ideal image has no contrast, L* 0.0 to 0.9", 50.0, "a scene with detail"),
    Cause(outside_share_text(0.3), 20.0, "a filter"),
    Cause("the lightest dot is 0.99 of a step of the ADC above black", 1.0, "more bits"),
]
NAMED = [[], CAUSES[:1], CAUSES[2:3], CAUSES[3:], CAUSES[2:]]
FRAME = {"pixels": (4170, 4170), "integration_s": 0.1, "saturated_fraction": 0.25}


@pytest.mark.parametrize("longest_s", [0.1, 1.0])
@pytest.mark.parametrize("delta_e", [[76.54], [76.1234, 76.5432, 76.9]])
def test_headlines_of_runs_are_short_and_name_the_largest_cause(
    delta_e: list[float], longest_s: float
) -> None:
    """Of runs whose errors are known in all the ways there are."""
    settings = {"exposure": {"max_integration_s": longest_s}, "display": {"dots": 512}}
    sizes: Any = {"settings": settings, "frame": FRAME, "pitch_um": 5.857, "border_um": 10.6}
    for film, header, causes in product(FILMS, NOISES, NAMED):
        result = run_result(delta_e, header, film, causes, **sizes)
        head = plain_text(run_answer(result).head)
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        assert head == f"mean ΔE {shown_mean_of(result)}"
        warnings = [cause.words in head for cause in causes] + ["not converged" in head]
        is_unsure = bool(causes) or not converged(result.light, result.light_limit)
        assert sum(warnings) == is_unsure, "one warning at most"


@pytest.mark.parametrize(
    ("metrics", "first", "other"),
    [
        (["detectability", "delta_e"], "detectability d′", "mean ΔE"),
        (["delta_e", "detectability"], "mean ΔE", "detectability d′"),
    ],
)
def test_headline_of_a_run_is_that_of_its_first_metric(
    metrics: list[str], first: str, other: str
) -> None:
    options: Any = {"camera": {"die_mm": 0.2}, "pixel": {"bits": 12}, "metrics": metrics}
    result = pixsim.run("target", resolution=64, **options)
    head, *lines = text(run_document(result)).splitlines()
    assert head.startswith(first)
    assert any(line.strip().startswith(other) for line in lines)


INTERVALS_UM = [(7.35, 7.88), (None, None), (None, 7.88), (16.0, None)]
NO_DIFFERENCES_UM = [None, (1.25, 12.74)]


@pytest.mark.parametrize("is_inside", [True, False])
@pytest.mark.parametrize("fit_swings", [True, False])
def test_headlines_of_studies_are_short(is_inside: bool, fit_swings: bool) -> None:
    """The answer and its interval, unless a range of sizes shows no difference, with one warning at
    most.
    """
    value = {"value": 76.5, "value_interval": (75.2, 77.8)}
    value |= {"mean_delta_e": 76.5, "mean_delta_e_interval": (75.2, 77.8)}
    within: Any = {"within_1_percent_um": (None, None)}
    for interval_um, no_difference_um, film, header, causes in product(
        INTERVALS_UM, NO_DIFFERENCES_UM, FILMS, NOISES, NAMED
    ):
        best = SimpleNamespace(
            pitch_um=7.5, inside=is_inside, interval_um=interval_um, **value, **within
        )
        curve: Any = SimpleNamespace(
            label="data sheet",
            optimum=best,
            pitch_um=np.geomspace(0.47, 15.0, 8),
            errors=CurveErrors(*light_error_and_limit(header, film), causes),
            fit_swings=fit_swings,
            no_difference_um=no_difference_um,
            on_displays=[SimpleNamespace(dots=1024, optimum=best)],
            judged_by_delta_e=True,
            metrics=(DELTA_E,),
            case=CaseLabels(),
        )
        head = plain_text(optimum_answer(curve).head)
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        if no_difference_um is None:
            size = "optimal pixel size 7.50 µm" if is_inside else "no optimum between 0.47 µm and"
            assert head.startswith(f"data sheet: {size}")
        warnings = [cause.words in head for cause in causes] + ["not converged" in head]
        assert sum(warnings) <= 1
