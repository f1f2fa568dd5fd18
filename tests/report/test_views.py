"""Pictures of a study: details at 1:1 of the scored pictures, where the errors are large."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pixsim.base.digits import estimate, pixel_size
from pixsim.report.pictures import crops
from pixsim.report.views import best_index, rank, study_views
from pixsim.show import pictures
from pixsim.show.pictures import (
    DETAIL_DOTS,
    Picture,
    Window,
    delta_e_colours,
    display_codes,
    window_at,
    windows,
    worst_window,
)
from pixsim.studies.result import StudyResult

WHOLE = Window(0.0, 0.0, 1.0, 1.0)


def decoded(png: bytes) -> np.ndarray:
    picture = Image.open(io.BytesIO(png))
    return np.asarray(picture.convert("RGB") if picture.mode == "P" else picture)


# --- windows
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(512, 512), (300, 200), (112, 500), (40, 64), (1, 9)])
def test_windows_are_square_and_cover(shape: tuple[int, int]) -> None:
    side = min(DETAIL_DOTS, *shape)
    picture = np.arange(np.prod(shape)).reshape(shape)
    parts = [window.of(picture) for window in windows(shape)]
    assert {part.shape for part in parts} == {(side, side)}
    assert len(np.unique(parts)) == picture.size


@pytest.mark.parametrize(
    ("centre", "corner"),
    [((0.0, 0.0), (0, 0)), ((1.0, 1.0), (400, 188)), ((0.5, 0.5), (200, 94)), ((1.0, 0.0), (0, 188))],
)  # fmt: skip
def test_window_at_position(centre: tuple[float, float], corner: tuple[int, int]) -> None:
    part = window_at(centre, (512, 300)).of(np.indices((512, 300)).transpose(1, 2, 0))
    assert part.shape == (112, 112, 2)
    assert tuple(part[0, 0]) == corner


@pytest.mark.parametrize("coarse", [(1, 1), (2, 2), (5, 3)])
def test_window_of_coarse_picture_is_not_empty(coarse: tuple[int, int]) -> None:
    """With a dot for each pixel, the largest pixels' picture can be smaller than a detail's share
    of the finest.
    """
    picture = np.arange(coarse[0] * coarse[1]).reshape(coarse)
    corners = [window_at(at, (512, 512)) for at in ((0.0, 1.0), (1.0, 1.0), (0.5, 0.99))]
    parts = [window.of(picture).ravel() for window in (*windows((512, 300)), *corners)]
    assert min(map(len, parts)) > 0
    assert len(np.unique(np.concatenate(parts))) == picture.size
    assert worst_window([np.ones((512, 300)), np.zeros(coarse)]) in windows((512, 300))


def test_worst_window_is_bad_in_all_maps() -> None:
    noise, blur = np.ones((512, 512)), np.ones((512, 512))
    noise[:112, :112] = 100.0
    noise[300:412, 300:412], blur[300:412, 300:412] = 3.0, 4.0
    across, down = worst_window([noise, blur]).centre
    assert (across, down) == pytest.approx((356 / 512, 356 / 512), abs=14 / 512)  # to half a step
    assert worst_window([noise]).centre == pytest.approx((56 / 512, 56 / 512))
    # Another number of dots is another display, not another place.
    assert worst_window([noise, blur[::2, ::2]]).centre == (across, down)


# --- pictures
# ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_cached", [True, False])
def test_pictures_of_a_page_equal_scored_ones(
    tiny_result: StudyResult, is_cached: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit; where the cache has a frame, the light on its pixels is not computed."""
    curve = tiny_result.curves[0]
    place = curve.technology, float(curve.pitch_um[1])
    count = tiny_result.sensors_at(*place)
    expected = tiny_result.scores(*place, count)
    if not is_cached:
        monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))

    scores = tiny_result.shown_scores(*place, count)
    assert [score.frame.mean_e.mean() == 0 for score in scores] == [is_cached] * count
    np.testing.assert_array_equal(tiny_result.shown_part(*place, WHOLE.of), expected[0].image)
    for score, other in zip(scores, expected, strict=True):
        np.testing.assert_array_equal(score.delta_e, other.delta_e)
        np.testing.assert_array_equal(score.frame.dn, other.frame.dn)
        assert score.statistics()["integration_s"] == other.statistics()["integration_s"]


def test_study_views_match_scores(tiny_result: StudyResult) -> None:
    """Tiles, crops and whole pictures are those of the scores, and none tried is better than the
    one that is called so.
    """
    result = replace(tiny_result, study=tiny_result.study.model_copy(update={"detail": (0.9, 0.9)}))
    curve = result.curves[0]
    best = best_index(curve)
    scores = [result.scores(curve.technology, float(pitch), 1)[0] for pitch in curve.pitch_um]
    views = study_views(result, curve)
    finest = max((score.ideal for score in scores), key=np.size)
    window = window_at((0.9, 0.9), finest.shape)
    for tile, picture in zip(
        views.tiles, [finest, *(score.image for score in scores)], strict=True
    ):
        np.testing.assert_array_equal(decoded(tile.png), display_codes(window.of(picture)))
    assert best == np.argmin(curve.delta_e.mean(axis=1))
    assert [tile.best for tile in views.tiles] == [index == best + 1 for index in range(7)]

    np.testing.assert_array_equal(decoded(views.ideal.png), display_codes(finest))
    for output, row, place in zip(views.outputs, views.crops, sorted({0, best, 5}), strict=True):
        assert output.name == f"{rank(curve, place)}, {pixel_size(curve.pitch_um[place])}"
        assert row[1].note == rank(curve, place)
        np.testing.assert_array_equal(decoded(output.png), display_codes(scores[place].image))


@pytest.mark.parametrize(
    ("least", "names"),
    [
        ([3.0, 1.0, 1.2, 1.1, 2.0, 3.0], ["smallest", "least error tried", "largest"]),
        ([1.0, 1.1, 1.2, 2.0, 3.0, 3.0], ["smallest, least error tried", "largest"]),
    ],
)
def test_best_place_is_smallest_mean(
    least: list[float], names: list[str], tiny_result: StudyResult
) -> None:
    """Whatever size the fitted curve has as its optimum."""
    delta_e = np.repeat(least, 2).reshape(6, 2)
    curve = replace(tiny_result.curves[0], statistics={"mean_delta_e": delta_e})
    best = best_index(curve)
    assert best == np.argmin(least)
    assert [rank(curve, place) for place in sorted({0, best, 5})] == names


def test_crops_show_the_same_part(tiny_result: StudyResult) -> None:
    (score,) = tiny_result.scores("0.35um", 8.5, 1)
    window = window_at((0.3, 0.8), score.ideal.shape)
    ideal, output, map_ = crops(score, window, "sensor", 5.0)
    np.testing.assert_array_equal(decoded(ideal.png), display_codes(window.of(score.ideal)))
    np.testing.assert_array_equal(decoded(output.png), display_codes(window.of(score.image)))
    np.testing.assert_array_equal(decoded(map_.png), delta_e_colours(window.of(score.delta_e), 5.0))
    assert f"mean here {estimate(window.of(score.delta_e).mean(), 2)}" in map_.note


@pytest.mark.parametrize("end", [1.0, 10.0])
def test_scale_matches_map_colours(end: float) -> None:
    bar = decoded(pictures.scale(end).png)
    expected = delta_e_colours((np.arange(bar.shape[1]) / bar.shape[1] * end)[None], end)[0]
    np.testing.assert_array_equal(bar[0], expected)


# --- the sheet as a file
# ----------------------------------------------------------------------------------------------


def test_contact_sheet_png_holds_tiles() -> None:
    rng = np.random.default_rng(1)
    tiles = [
        Picture(rng.integers(0, 255, (112, 112)).astype(np.uint8), f"{n} µm", "mean ΔE 1", n == 3)
        for n in range(pictures.COLUMNS + 2)
    ]
    sheet = decoded(pictures.contact_sheet_png("n" * 5000, tiles))
    assert sheet.shape[1] < 2500, "whatever the title"
    across_px = 112 + pictures.SHEET_GAP
    down_px = 112 + 2 * 19 + pictures.SHEET_GAP
    for number, tile in enumerate(tiles):
        row, column = divmod(number, pictures.COLUMNS)
        x = pictures.SHEET_MARGIN + column * across_px
        y = pictures.SHEET_MARGIN + pictures.TITLE + row * down_px
        np.testing.assert_array_equal(sheet[y : y + 112, x : x + 112], tile.codes)
        assert (sheet[y : y + 112, x - 2] == 0).all() == tile.best, "a frame around the best"
