"""Pictures of a study: details from every pixel size, whole pictures, ΔE maps and curves of equal
ΔE.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pixsim.base.digits import estimate, pixel_size
from pixsim.report.pictures import crops, whole_picture
from pixsim.show.pictures import (
    Picture,
    contact_sheet_png,
    display_codes,
    factor_for,
    scale_end,
    window_at,
    worst_window,
)
from pixsim.studies.curve import Curve
from pixsim.studies.result import StudyResult

_LOWEST_ERROR = "least error tried"  # "best" is the optimum, which may lie between the sizes tried


@dataclass(frozen=True)
class Views:
    """Pictures of one technology.

    tiles : the detail of the ideal image, then of every pitch
    crops : for some pitches, the detail of the ideal image, of the output and of its ΔE map
    ideal, outputs : whole pictures
    factor : dots per side of the ideal image averaged into one of the whole picture
    sheet : the tiles as one labelled PNG
    """

    label: str
    file_label: str
    tiles: tuple[Picture, ...]
    crops: tuple[tuple[Picture, ...], ...]
    ideal: Picture
    factor: int
    outputs: tuple[Picture, ...]
    sheet: bytes = field(repr=False)


def best_index(curve: Curve) -> int:
    """Return the index of the evaluated pitch with the smallest mean ΔE."""
    return int(np.nanargmin(curve.mean()))


def map_end(result: StudyResult) -> float:
    """Return the end of the colour scale of a study's ΔE maps, from the maps of its smallest, best
    and largest pixels.
    """
    largest_p99 = [
        curve.mean("p99_delta_e")[[0, best_index(curve), -1]].max() for curve in result.curves
    ]
    return scale_end(float(max(largest_p99)))


def study_views(result: StudyResult, curve: Curve) -> Views:
    """Return whole pictures of the smallest, best and largest pixels, and a detail from every
    pitch.
    """
    best = best_index(curve)
    last = curve.pitch_um.size - 1
    scores = {
        index: result.shown_scores(curve.technology, float(curve.pitch_um[index]), 1)[0]
        for index in sorted({0, best, last})
    }

    # The detail that is chosen in the settings, or where small and large pixels both err.
    ideal = max((score.ideal for score in scores.values()), key=np.size)
    rows, columns = ideal.shape[:2]
    if result.study.detail:
        window = window_at(result.study.detail, (rows, columns))
    else:
        window = worst_window([scores[0].delta_e, scores[last].delta_e])

    tiles = [Picture(display_codes(window.of(ideal)), "ideal image")]
    for index, pitch_um in enumerate(curve.pitch_um.tolist()):
        if index in scores:
            detail = window.of(scores[index].image)
        else:
            detail = result.shown_part(curve.technology, pitch_um, window.of)
        size, mean = labels(curve, index)
        tiles.append(Picture(display_codes(detail), size, mean, best=index == best))

    end = map_end(result)
    outputs = []
    details = []
    for index, score in scores.items():
        size, mean = labels(curve, index)
        name = rank(curve, index)
        outputs.append(replace(whole_picture(score.image, f"{name}, {size}"), note=mean))
        details.append(crops(score, window, name, end))

    title = f"{curve.label}: the same detail for every pixel size, 1:1; framed: the {_LOWEST_ERROR}"
    return Views(
        label=curve.label,
        file_label=curve.file_label,
        tiles=tuple(tiles),
        crops=tuple(details),
        ideal=whole_picture(ideal, "ideal image"),
        factor=factor_for(ideal),
        outputs=tuple(outputs),
        sheet=contact_sheet_png(title, tiles),
    )


def labels(curve: Curve, index: int) -> tuple[str, str]:
    """Return the pixel size, and the mean ΔE over the whole picture and all sensors, as text."""
    size = pixel_size(float(curve.pitch_um[index]))
    mean_delta_e = float(curve.mean("mean_delta_e")[index])
    return size, f"mean ΔE {estimate(mean_delta_e)}"


def rank(curve: Curve, index: int) -> str:
    """Return whether a pitch is the smallest, the largest, or has the least error tried, as
    text.
    """
    words = []
    if index == curve.pitch_um.size - 1:
        words.append("largest")
    elif index == 0:
        words.append("smallest")
    if index == best_index(curve):
        words.append(_LOWEST_ERROR)
    return ", ".join(words)
