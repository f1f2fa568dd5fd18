"""The first line of every answer is read at a glance: at most 30 words, whatever the result is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.runs import run_result

import pixsim
from pixsim.base.headline import MAX_HEADLINE_WORDS
from pixsim.report.curve import interval_words, optimum_answer, optimum_line
from pixsim.report.run import run_answer, run_document, run_page, shown_mean_of
from pixsim.report.sfr import sfr_parts
from pixsim.report.uncertainty import uncertainty_blocks
from pixsim.report.wording import weighted_answer
from pixsim.sensor.spectral_range import outside_share_text
from pixsim.show.document import Answer, Text, headline, plain_text
from pixsim.show.render import html, text
from pixsim.studies.curve import CaseLabels, CurveErrors
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.run import RunResult
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


def runs() -> Iterator[RunResult]:
    """Runs whose errors are known in all the ways there are."""
    for film, header, causes, longest in product(FILMS, NOISES, NAMED, (0.1, 1.0)):
        settings = {"exposure": {"max_integration_s": longest}, "display": {"dots": 512}}
        of_sensor: dict[str, Any] = {
            "settings": settings,
            "frame": FRAME,
            "pitch_um": 5.857,
            "border_um": 10.6,
        }
        for delta_e in ([76.54], [76.1234, 76.5432, 76.9]):
            yield run_result(delta_e, header, film, causes, **of_sensor)


def curves() -> Iterator[Any]:
    """Curves of studies, in all the ways in which their optimum can be known."""
    pitch_um = np.geomspace(0.47, 15.0, 8)
    intervals = [(7.35, 7.88), (None, None), (None, 7.88), (7.35, None), (None, 0.4), (16.0, None)]
    chosen = product(
        intervals,
        (True, False),
        (None, (1.25, 12.74), (0.47, 15.0)),
        (False, True),
        FILMS,
        NOISES,
        NAMED,
    )
    for interval, inside, alike, swings, film, header, causes in chosen:
        within = {"within_1_percent_um": (None, None), "within_2_percent_um": (None, None)}
        value = {
            "mean_delta_e": 76.5,
            "mean_delta_e_interval": (75.2, 77.8),
            "value": 76.5,
            "value_interval": (75.2, 77.8),
        }
        best = SimpleNamespace(pitch_um=7.5, inside=inside, interval_um=interval, **value, **within)
        other = SimpleNamespace(dots=1024, optimum=best)
        light, limit = light_error_and_limit(header, film)
        yield SimpleNamespace(
            label="data sheet", optimum=best, pitch_um=pitch_um, errors=CurveErrors(light, limit, causes), fit_swings=swings,
            no_difference_um=alike, mean=lambda: np.full(8, 76.5), on_displays=[other, other],
            fit=SimpleNamespace(delta_e=np.full(8, 77.0)), judged_by_delta_e=True, metrics=(DELTA_E,),
            fitted_range_um=(0.47, 15.0), case=CaseLabels(),
        )  # fmt: skip


def check(parts: Sequence[Text]) -> str:
    """Return the headline of parts: short, and nothing is lost below it."""
    answer = headline(parts)
    head, *rest = map(plain_text, (answer.head, *answer.below))
    assert len(head.split()) <= MAX_HEADLINE_WORDS, head
    assert all(plain_text(part) in "; ".join([head, *rest]) for part in parts)
    return head


def test_headlines_of_runs_are_short_and_name_the_largest_cause() -> None:
    for result in runs():
        head = plain_text(run_answer(result).head)
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        assert head == f"mean ΔE {shown_mean_of(result)}"
        warnings = [cause.words in head for cause in result.causes] + ["not converged" in head]
        is_unsure = bool(result.causes) or not converged(result.light, result.light_limit)
        assert sum(warnings) == is_unsure, "one warning at most"


def test_headline_of_a_run_is_that_of_its_first_metric() -> None:
    """The others follow in their order; ΔE is in the text and in the page where it was asked
    for.
    """
    for metrics, first, others in (
        (["detectability"], "detectability d′", []),
        (["detectability", "delta_e"], "detectability d′", ["mean ΔE"]),
        (["delta_e", "detectability"], "mean ΔE", ["detectability d′"]),
    ):
        result = pixsim.run(
            "target", camera={"die_mm": 0.2}, resolution=64, pixel={"bits": 12}, metrics=metrics
        )
        answer = run_answer(result)
        assert plain_text(answer.head).startswith(first)
        printed = text(run_document(result))
        assert [words in printed for words in others] == [True] * len(others)
        assert ("ΔE" in " ".join([plain_text(answer.head), *map(str, answer.below)])) == (
            "delta_e" in metrics
        )
        assert ("mean ΔE" in html(run_page(result))) == ("delta_e" in metrics)


def test_headlines_of_studies_are_short() -> None:
    """The answer and its interval, unless that range shows no difference, with one warning at
    most.
    """
    count = 0
    for curve in curves():
        answer = optimum_answer(curve)
        head, *below = map(plain_text, (answer.head, *answer.below))
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        assert "; ".join([head, *below]) == optimum_line(curve)
        if curve.optimum.inside and curve.no_difference_um is None:
            assert head.startswith(
                f"data sheet: optimal pixel size 7.50 µm (95 %: {interval_words(curve)})"
            )
        causes = sum(cause.words in head for cause in curve.errors.causes)
        assert causes + ("not converged" in head) <= 1
        count += 1
    assert count > 1000


def test_headlines_of_weighted_means_are_short() -> None:
    for interval in ((2.3, 2.9), (None, 2.9), (2.3, None), (None, None)):
        best = SimpleNamespace(
            value=0.615, value_interval=(0.613, 0.617), pitch_um=2.45, interval_um=interval
        )
        weighted = SimpleNamespace(optimum=best, metric=DELTA_E, weight=None)
        answer = weighted_answer(SimpleNamespace(label="data sheet", criteria=(weighted,)))  # type: ignore[arg-type]
        assert len(plain_text(answer.head).split()) <= MAX_HEADLINE_WORDS
        assert str(plain_text(answer.head)).startswith(
            "data sheet: least weighted mean ΔE 0.6150 at 2.45 µm"
        )


@pytest.mark.parametrize("share_at_ends", [0.0, 0.123])
def test_headlines_of_sensor_types_are_short(share_at_ends: float) -> None:
    optimum = SimpleNamespace(quantiles=dict.fromkeys(("p05", "p50", "p95"), 7.5))
    result = SimpleNamespace(
        label="data sheet, night",
        by="",
        draws=200,
        optimum=optimum,
        share_at_ends=share_at_ends,
        verdicts={},
    )
    answer, *_ = uncertainty_blocks([result])  # type: ignore[list-item]
    assert isinstance(answer, Answer)
    assert len(plain_text(answer.head).split()) <= MAX_HEADLINE_WORDS


def test_headlines_of_edges_are_short() -> None:
    for mtf50, channel, pitch_um, own in product(
        (None, 0.312), (None, "luminance", "G"), (None, 3.45), (0.5, 0.354)
    ):
        result = {
            "highest_frequency_cy_per_px": 1.0,
            "mtf50_interval_cy_per_px": [0.3, None],
            "mtf50_cy_per_px": mtf50,
        }
        result |= {
            "pitch_um": pitch_um,
            "mtf50_cy_per_mm": 90.4,
            "sfr_at_nyquist": 0.2,
            "sfr_at_nyquist_interval": [0.1, 0.3],
        }
        result |= {
            "channel": channel,
            "channel_nyquist_cy_per_px": own,
            "sfr_at_channel_nyquist": 0.4,
            "angle_deg": 5.0,
        }
        result |= {
            "half_window_px": 32.0,
            "rows_used": 512,
            "contrast": 0.8,
            "interval_coverage": 0.95,
        }
        for degree in (1, 5):
            check(sfr_parts(result | {"edge_degree": degree, "edge_sagitta_px": 1.42}))
