"""The page of a score: pictures as shown, the ΔE map, statistics."""

from __future__ import annotations

import numpy as np

from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.schema import result_data
from pixsim.base.tables import rows_csv
from pixsim.show.document import Answer, Document, Plot, Section, pairs
from pixsim.show.figures import new_figure
from pixsim.show.pages import Drawing, coarse_table, figure
from pixsim.show.pictures import VIEWING_GAMMA, light_png, scale_end
from pixsim.show.presenter import Presenter
from pixsim.show.sentences import sentence, settings_line
from pixsim.viewer.delta_e_statistics import percentiles
from pixsim.viewer.score import FrameScore, Score, shown_mean, unmet

PANEL_IN = 3.1  # width of each picture of the figure


@figure("delta_e", "The ideal image, the sensor's image, and their difference. The table holds block means of the map.")
def score_plate(score: Score) -> Drawing:
    """Draw the ideal image, the sensor's image and the ΔE map with its scale."""
    figure = new_figure(3 * PANEL_IN + 0.6, PANEL_IN + 0.3)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for panel, picture, title in zip(axes, (score.ideal, score.image), ("ideal", "sensor"), strict=False):
        panel.imshow(np.clip(picture, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        panel.set_title(title)

    end = scale_end(*percentiles(score.delta_e, (99,)))
    delta_e_map = axes[2].imshow(score.delta_e, cmap="viridis", vmin=0, vmax=end, interpolation="nearest")
    axes[2].set_title(f"S-CIELAB ΔE, mean {score.mean_delta_e:.3f}")
    figure.colorbar(delta_e_map, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
    for panel in axes:
        panel.set_xlabel("display dots")

    return figure, coarse_table(score.delta_e, "delta_e")


def score_csv(score: Score) -> str:
    """Return the statistics of a score as CSV."""
    return rows_csv([score.statistics()])


def score_document(score: Score) -> Document:
    """Return the page of a score: its mean ΔE, its pictures, its statistics."""
    statistics = score.statistics()
    files = {"ideal.png": light_png(score.ideal), "image.png": light_png(score.image)}
    return Document(
        command="score",
        kind="score of one picture",
        title="Score",
        data=result_data(statistics, settings={"display": score.display.model_dump(mode="json", exclude_none=True)}, notes=[]),
        answers=(Answer(_headline(score)),),
        lead=(Plot(lambda: score_plate(score)), *_sentences(score)),
        sections=(Section("statistics", "Statistics", (pairs("statistics", statistics),), brief=True),),
        files=files,
        data_file="score.json",
    )


def _headline(score: Score) -> str:
    if not isinstance(score, FrameScore):
        return f"mean ΔE {score.mean_delta_e:.3f}"
    mean = shown_mean(score.mean_delta_e, score.light, score.light_limit, score.causes)
    return f"{score.physics.pitch_um:g} µm pixels, mean ΔE {mean}"


def _sentences(score: Score) -> list[str]:
    """Return what a reader should know of the score of a frame; nothing of other pictures."""
    if not isinstance(score, FrameScore):
        return []
    settings = score.physics.pixel.model_dump(exclude_unset=True, exclude_none=True)
    texts = [
        "one frame of one sensor: how much others differ is told by pixsim.study, whose means have 95 % intervals",
        "the errors of a scene's light, by its film and by render noise, are measured by pixsim.run and pixsim.study",
        f"pixel: {settings_line(settings)}; all else is the default",
        *map(str, score.causes),
        *(f"{NOT_CONVERGED}: {words}" for _, words in unmet(score.light, score.light_limit)),
    ]
    return [sentence(text) for text in texts]


PRESENTER = Presenter(document=score_document, figure=score_plate, csv=score_csv)
