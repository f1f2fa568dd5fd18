"""The page of a score: pictures as shown, the ΔE map, statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pixsim.base.digits import distinct_texts, estimate, pixel_size, with_error, within_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.show.document import Answer, Document, Fact, Plot, Section, pairs
from pixsim.show.figures import new_figure
from pixsim.show.pages import Drawing, coarse_table, figure
from pixsim.show.pictures import display_codes, light_png, scale_end
from pixsim.show.presenter import Presenter
from pixsim.show.sentences import settings_line
from pixsim.viewer.delta_e_statistics import percentiles
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.score import Cause, FrameScore, LightError, Score, exceeded
from pixsim.viewer.setting import Setting

_SHORT_ERROR_WORDS = {"film_delta_e": "film", "noise_delta_e": "render noise"}
_ERROR_WORDS = {"film_delta_e": "the film's error", "noise_delta_e": "the error by render noise"}
_PANEL_IN = 3.1  # width of each picture of the figure


@figure(
    "delta_e",
    "The ideal image, the sensor's image, and their difference. The table holds block means of the"
    " map.",
)
def score_plate(score: Score) -> Drawing:
    """Draw the ideal image, the sensor's image and the ΔE map with its scale."""
    figure = new_figure(3 * _PANEL_IN + 0.6, _PANEL_IN + 0.3)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for panel, picture, title in zip(
        axes, (score.ideal, score.image), ("ideal", "sensor"), strict=False
    ):
        panel.imshow(display_codes(picture), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        panel.set_title(title)

    end = scale_end(*percentiles(score.delta_e, (99,)))
    delta_e_map = axes[2].imshow(
        score.delta_e, cmap="viridis", vmin=0, vmax=end, interpolation="nearest"
    )
    axes[2].set_title(f"S-CIELAB ΔE, mean {estimate(score.mean_delta_e)}")
    figure.colorbar(delta_e_map, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
    for panel in axes:
        panel.set_xlabel("display dots")

    return figure, coarse_table(score.delta_e, "delta_e")


def _score_csv(score: Score) -> str:
    """Return the statistics of a score as CSV."""
    return rows_csv([score.statistics()])


def _score_document(score: Score) -> Document:
    """Return the page of a score: its mean ΔE, its pictures, its statistics."""
    statistics = score.statistics()
    files = {"ideal.png": light_png(score.ideal), "image.png": light_png(score.image)}
    return Document(
        command="score",
        kind="score of one picture",
        title="Score",
        data=result_data(
            statistics,
            settings={"display": score.display.model_dump(mode="json", exclude_none=True)},
            notes=[],
        ),
        answers=(Answer(_headline(score)),),
        lead=(Plot(lambda: score_plate(score)), *_facts(score)),
        sections=(
            Section("statistics", "Statistics", (pairs("statistics", statistics),), brief=True),
        ),
        files=files,
        data_file="score.json",
    )


def _headline(score: Score) -> str:
    if not isinstance(score, FrameScore):
        return f"mean ΔE {estimate(score.mean_delta_e)}"
    mean = shown_mean(score.mean_delta_e, score.light, score.light_limit, score.causes)
    return f"{pixel_size(score.physics.pitch_um)} pixels, mean ΔE {mean}"


def _facts(score: Score) -> list[Fact]:
    """Return what a reader should know of the score of a frame; nothing of other pictures."""
    if not isinstance(score, FrameScore):
        return []
    settings = score.physics.pixel.model_dump(exclude_unset=True, exclude_none=True)
    texts = [
        f"pixel: {settings_line(settings)}; all else is the default",
        *map(str, score.causes),
        *(f"{NOT_CONVERGED}: {words}" for words in exceeded_words(score.light, score.light_limit)),
    ]
    return [Fact(text) for text in texts]


def judged_by_delta_e(settings: Setting) -> bool:
    """Return whether ΔE was asked for."""
    return DELTA_E.name in settings.metrics


def exceeded_words(error: LightError, limit: LightError) -> list[str]:
    """Return the errors above their limits in words, the largest first."""
    texts = []
    for name in exceeded(error, limit):
        size, limit_text = distinct_texts(getattr(error, name), getattr(limit, name), 1)
        size = "unknown" if math.isnan(getattr(error, name)) else f"up to {size} ΔE"
        limit_text = (
            "its limit exceeded" if math.isnan(getattr(limit, name)) else f"{limit_text} tolerated"
        )
        texts.append(f"{_ERROR_WORDS[name]} is {size}, {limit_text}")
    return texts


def shown_mean(
    mean_delta_e: float,
    error: LightError,
    limit: LightError,
    causes: Sequence[Cause] = (),
    half_delta_e: float = 0.0,
    scatter_delta_e: float = 0.0,
) -> str:
    """Return a mean ΔE as text, with the errors of its light that are above their limits, and with
    one warning.

    The warning is the largest cause; or that the light has not converged, where an error of it is
    known to be larger.

    half_delta_e : half of its 95 % interval, of several sensors
    scatter_delta_e : likewise, of an estimate whose interval is not stated: it has no more digits
        than that allows

    >>> shown_mean(0.97312, LightError(), LightError(), half_delta_e=0.0021)
    '0.9731 ± 0.0021 (95 %)'
    >>> shown_mean(0.9731, LightError(0.6), LightError(0.02), half_delta_e=0.0021)
    '1.0 ± 0.6 (95 % and film), not converged'
    >>> few_codes = (Cause("all codes are equal", 100.0, "more bits"),)
    >>> shown_mean(76.54, LightError(3.6), LightError(0.02), few_codes)
    '76.5 (all codes are equal) ± 3.6 (film)'
    """
    exceeded_errors = exceeded(error, limit)
    light_delta_e = sum(exceeded_errors.values())

    uncertainty = ""
    value = (
        within_error(mean_delta_e, scatter_delta_e) if scatter_delta_e else estimate(mean_delta_e)
    )
    names = [_SHORT_ERROR_WORDS[name] for name in exceeded_errors]
    if math.isinf(light_delta_e):
        uncertainty = f" ± an unknown error ({' and '.join(names)})"
    elif light_delta_e or half_delta_e:
        value, _, uncertainty = with_error(mean_delta_e, half_delta_e + light_delta_e).partition(
            " "
        )
        parts = ["95 %"] * (half_delta_e > 0) + names
        uncertainty = f" {uncertainty} ({' and '.join(parts)})"

    largest_finite_delta_e = max(filter(math.isfinite, exceeded_errors.values()), default=0.0)
    if causes and causes[0].delta_e >= largest_finite_delta_e:
        return f"{value} ({causes[0].words}){uncertainty}"
    return f"{value}{uncertainty}, {NOT_CONVERGED}" if exceeded_errors else f"{value}{uncertainty}"


PRESENTER = Presenter(document=_score_document, figure=score_plate, csv=_score_csv)
