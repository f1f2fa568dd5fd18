"""What people see of a study: the same detail from every pixel size, and whole pictures to lay over the ideal image."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pixsim import cache
from pixsim import display as displays
from pixsim.contact_sheet import Tile, contact_sheet_png
from pixsim.details import Picture, Window, crops, factor_for, reduced, window_at, worst_window
from pixsim.evaluations import bench_at, block_key, stream_key
from pixsim.parameters import Exposure
from pixsim.pictures import grey_codes
from pixsim.pixel import physics_of
from pixsim.score import Projection, Score
from pixsim.sensor import frame_of, pixels_along
from pixsim.spectral import Array
from pixsim.study_result import Curve, StudyResult


@dataclass(frozen=True)
class Views:
    """Pictures of one technology.

    tiles : the ideal image's detail, then that of every pitch
    crops : for some pitches, the detail of the ideal image, of the output, and of its ΔE map
    ideal, outputs : whole pictures
    factor : how many dots of the ideal image a side are one of the whole picture
    sheet : the tiles as one labelled PNG
    """

    label: str
    file_label: str
    place: tuple[float, float]
    tiles: tuple[Picture, ...]
    crops: tuple[tuple[Picture, ...], ...]
    ideal: Picture
    factor: int
    outputs: tuple[Picture, ...]
    sheet: bytes = field(repr=False)


def best_place(curve: Curve) -> int:
    """Index of the evaluated pitch with the least mean ΔE."""
    return int(np.argmin(curve.mean()))


def is_best(curve: Curve, place: int) -> bool:
    """Whether a pitch is shown as the best of those evaluated; one at an end of the range is not, without an optimum inside."""
    return place == best_place(curve) and (curve.optimum.inside or 0 < place < curve.pitch_um.size - 1)


def study_views(result: StudyResult, curve: Curve, best: Score) -> Views:
    """The smallest, the best and the largest pixels against the ideal image, and a detail from every pitch.

    best : the first sensor's score at `best_place`
    """
    at, last = best_place(curve), curve.pitch_um.size - 1
    ends = sorted({0, at, last})
    scores = {place: best if place == at else result.scores(curve.technology, float(curve.pitch_um[place]), 1)[0] for place in ends}
    ideal = max((score.ideal for score in scores.values()), key=lambda each: each.size)
    shape = ideal.shape[0], ideal.shape[1]
    where = result.study.detail
    window = window_at(where, shape) if where else worst_window([scores[0].delta_e, scores[last].delta_e])
    tiles = [Tile(grey_codes(window.of(ideal)), "ideal image", "")]
    for place in range(last + 1):
        part = window.of(scores[place].image) if place in scores else detail_at(result, curve, place, window)
        tiles.append(Tile(grey_codes(part), *words(curve, place), is_best(curve, place)))
    named = {place: f"{called(curve, place)}, {words(curve, place)[0]}" for place in ends}
    return Views(
        label=curve.label,
        file_label=curve.file_label,
        place=window.centre,
        tiles=tuple(Picture.of(tile.codes, tile.name, tile.note, tile.best) for tile in tiles),
        crops=tuple(crops(scores[place], window, called(curve, place)) for place in ends),
        ideal=Picture.of(grey_codes(reduced(ideal)), "ideal image"),
        factor=factor_for(ideal),
        outputs=tuple(Picture.of(grey_codes(reduced(scores[place].image)), named[place], words(curve, place)[1]) for place in ends),
        sheet=contact_sheet_png(f"{curve.label}: the same detail from every pixel size, 1:1; framed: the best of these", tiles),
    )


def words(curve: Curve, place: int) -> tuple[str, str]:
    """Pixel size, and mean ΔE over the whole picture and the sensors."""
    return f"{curve.pitch_um[place]:.2f} µm", f"mean ΔE {curve.mean()[place]:.3f}"


def called(curve: Curve, place: int) -> str:
    """A pitch by its part in the story."""
    parts = {"smallest": place == 0, "largest": place == curve.pitch_um.size - 1, "best of these": is_best(curve, place)}
    return ", ".join(part for part, is_so in parts.items() if is_so)


def pixels_of(size_um: tuple[float, float], pitch_um: float) -> tuple[int, ...]:
    return tuple(pixels_along(um, pitch_um) for um in size_um)


def detail_at(result: StudyResult, curve: Curve, place: int, window: Window) -> Array:
    """A part of the first sensor's picture of a pitch, shown luminance: that of `result.scores`, without its ΔE.

    What the cache holds is only shown, in a fifth of the time that the light on the pixels takes.
    """
    study, pitch_um = result.study, float(curve.pitch_um[place])
    light = result.lights.of(curve.technology)
    key = block_key(result.content.frames(curve.technology, pitch_um), 0)
    kept = ((cache.arrays("frames", key) if key else None) or {}).get("0")
    if not isinstance(light, Projection) or kept is None or kept.shape != pixels_of(light.size_um, pitch_um):
        bench = bench_at(study, light, result.camera, curve.technology, pitch_um)
        frame = bench.capture(*stream_key(study, bench.physics.technology.name, pitch_um, 0))
        white_e, size_um, edges_um = bench.white_e_per_s * frame.integration_s, bench.size_um, bench.dot_edges_um
    else:
        physics, time_s = physics_of(study, curve.technology, pitch_um), float(curve.mean("integration_s")[place])
        white_e, size_um = light.white_e_per_s_um2 * physics.photodiode_area_um2 * time_s, light.size_um
        edges_um = light.dot_edges_um
        # Nothing that is shown depends on the saturated fraction or on the mean signal.
        unknown = np.broadcast_to(np.nan, kept.shape)
        frame = frame_of(kept.astype(np.int32), math.nan, unknown, physics, Exposure(integration_s=time_s))
    luminance = displays.frame_luminance(frame, size_um, white_e, study.display, edges_um)
    return displays.shown_luminance(window.of(luminance), study.display)
