"""Pictures of a study: details at 1:1 of the scored pictures, where the errors are large."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.tiny import TINY, WHOLE_CHART, tiny
from PIL import Image

import pixsim
from pixsim.base import cache
from pixsim.base.digits import estimate, pixel_size
from pixsim.base.errors import PixsimError
from pixsim.base.records import checked
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
from pixsim.viewer.merging import merge

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
    seen: set[int] = set()
    for window in windows(shape):
        part = window.of(picture)
        assert part.shape == (side, side)
        seen |= set(part.ravel().tolist())
    assert len(seen) == picture.size


def test_window_at_position() -> None:
    y, x = np.indices((512, 300))
    for centre, corner in {
        (0.0, 0.0): (0, 0),
        (1.0, 1.0): (400, 188),
        (0.5, 0.5): (200, 94),
        (1.0, 0.0): (0, 188),
    }.items():
        window = window_at(centre, (512, 300))
        assert (window.of(y)[0, 0], window.of(x)[0, 0]) == corner
        assert window.of(y).shape == (112, 112)


@pytest.mark.parametrize("dots", [8, 64, 512])
def test_window_of_scales_with_dots(dots: int) -> None:
    y, x = (Window(0.25, 0.5, 0.25, 0.25).of(at) for at in np.indices((dots, dots)) / dots)
    assert (y.min(), x.min()) == (0.25, 0.5)
    assert x.shape == (dots // 4, dots // 4)


@pytest.mark.parametrize("coarse", [(1, 1), (2, 2), (5, 3)])
def test_window_of_coarse_picture_is_not_empty(coarse: tuple[int, int]) -> None:
    """With a dot for each pixel, the largest pixels' picture can be smaller than a detail's share
    of the finest.
    """
    seen: set[int] = set()
    picture = np.arange(coarse[0] * coarse[1]).reshape(coarse)
    for window in [
        *windows((512, 300)),
        *(window_at(at, (512, 512)) for at in ((0.0, 1.0), (1.0, 1.0), (0.5, 0.99))),
    ]:
        part = window.of(picture)
        assert part.size > 0
        seen |= set(part.ravel().tolist())
    assert len(seen) == picture.size
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


@pytest.mark.parametrize("cached", ["kept", "not kept", "of another shape"])
def test_shown_pictures_equal_scored_ones(
    tiny_result: StudyResult, cached: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit; where the cache has a frame, the light on its pixels is not computed. It has
    none of a further sensor.
    """
    curve = tiny_result.curves[0]
    place = curve.technology, float(curve.pitch_um[1])
    count = tiny_result.sensors_at(*place)
    expected = tiny_result.scores(*place, count + 1)
    assert all(score.frame.mean_e.mean() > 0 for score in expected)
    if cached != "kept":
        monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    if cached == "of another shape":
        tiny_result.scores(*place, count)
        (path,) = (tmp_path / "frames").glob("*.npz")
        frames = cache.arrays("frames", path.stem)
        assert frames
        cache.store_arrays(
            "frames",
            path.stem,
            {name: np.zeros((3, 3), array.dtype) for name, array in frames.items()},
        )
    shown = tiny_result.shown_scores(*place, count)
    assert [score.frame.mean_e.mean() == 0 for score in shown] == [cached == "kept"] * count
    np.testing.assert_array_equal(tiny_result.shown_part(*place, WHOLE.of), expected[0].image)
    for found in (shown, tiny_result.shown_scores(*place, count + 1)):
        for one, other in zip(found, expected, strict=False):
            np.testing.assert_array_equal(one.delta_e, other.delta_e)
            np.testing.assert_array_equal(one.frame.dn, other.frame.dn)
            kept = (
                "saturated_fraction",
                "integration_s",
                "fill_factor",
                "full_well_e",
                "max_delta_e",
            )
            assert [one.statistics()[name] for name in kept] == [
                other.statistics()[name] for name in kept
            ]


def test_study_views_one_to_one_large_pixels(tmp_path: Path) -> None:
    """Their pictures have one dot to 17: no window of the finest picture is empty in any."""
    more = {"display": {"raster": "one_to_one"}, "pitch": {"values_um": [20, 40, 400, 900, 2000]}}
    result = pixsim.study(tiny(**more, name="coarse", camera={"die_mm": 2.7136}), tmp_path, jobs=1)
    curve = result.curves[0]
    views = study_views(result, curve)
    assert len(views.tiles) == 6
    assert all(min(item.width, item.height) >= 1 for item in views.tiles)


def test_study_views_reduce_whole_pictures_only(tiny_result: StudyResult) -> None:
    """Each dot is ten by ten here, of which the means of two by two are five by five: whole
    pictures have at most 1024 dots.
    """
    curve = tiny_result.curves[0]
    (score,) = tiny_result.scores(curve.technology, float(curve.pitch_um[best_index(curve)]), 1)
    ideal, image = (np.kron(picture, np.ones((10, 10))) for picture in (score.ideal, score.image))
    large: Any = SimpleNamespace(
        ideal=ideal, image=image, delta_e=score.delta_e, physics=score.physics
    )
    of_result = {
        "study": tiny_result.study,
        "curves": tiny_result.curves,
        "shown_scores": lambda *_: [large],
    }
    result: Any = SimpleNamespace(
        **of_result, shown_part=lambda technology, pitch_um, part: part(image)
    )
    views = study_views(result, curve)
    assert views.factor == 2
    for shown, whole in zip(
        (views.ideal, *views.outputs),
        (score.ideal, *[score.image] * len(views.outputs)),
        strict=True,
    ):
        np.testing.assert_array_equal(
            decoded(shown.png), display_codes(np.kron(whole, np.ones((5, 5))))
        )
    assert {(item.width, item.height) for item in views.tiles} == {(1120, 1120)}, (
        "details stay as they are"
    )


@pytest.mark.parametrize(
    "raster", ["fixed_size", pytest.param("one_to_one", marks=pytest.mark.slow)]
)
def test_study_views_match_scores(raster: str, tmp_path: Path) -> None:
    result = pixsim.study(
        tiny(display={"raster": raster, "dots": 160}, detail=[0.9, 0.9]), tmp_path, jobs=1
    )
    curve = result.curves[0]
    at = best_index(curve)
    scores = [
        result.scores(curve.technology, pitch_um, 1)[0] for pitch_um in curve.pitch_um.tolist()
    ]
    views = study_views(result, curve)
    finest = max((score.ideal for score in scores), key=lambda item: item.size)
    window = window_at((0.9, 0.9), finest.shape)
    shown = [finest, *(score.image for score in scores)]
    for tile, picture in zip(views.tiles, shown, strict=True):
        np.testing.assert_array_equal(decoded(tile.png), display_codes(window.of(picture)))
    for tile, pitch_um, delta_e in zip(views.tiles[1:], curve.pitch_um, curve.delta_e, strict=True):
        assert tile.name == pixel_size(pitch_um)
        assert tile.note == f"mean ΔE {estimate(delta_e.mean())}"
    means = curve.delta_e.mean(axis=1)
    assert means[at] == means.min(), (
        "no other size that was tried is better than the one that is called so"
    )
    assert [tile.best for tile in views.tiles] == [index == at + 1 for index in range(7)]
    np.testing.assert_array_equal(decoded(views.ideal.png), display_codes(finest))
    for output, row, place in zip(views.outputs, views.crops, sorted({0, at, 5}), strict=True):
        message = {0: "smallest", 5: "largest"}.get(place, "least error tried")
        message += ", least error tried" if place == at and place in (0, 5) else ""
        assert output.name == f"{message}, {pixel_size(curve.pitch_um[place])}"
        assert (row[1].name, row[1].note) == (pixel_size(curve.pitch_um[place]), message)
        np.testing.assert_array_equal(decoded(output.png), display_codes(scores[place].image))


def test_best_place_is_smallest_mean(tiny_result: StudyResult) -> None:
    delta_e = np.array([[3.0, 3.0], [1.0, 1.0], [1.2, 1.2], [1.1, 1.1], [2.0, 2.0], [3.0, 3.0]])
    optimum = replace(tiny_result.curves[0].optimum, inside=True, pitch_um=8.4)
    curve = replace(
        tiny_result.curves[0],
        statistics={"mean_delta_e": delta_e},
        fit=replace(tiny_result.curves[0].fit, optimum=optimum),
    )
    assert best_index(curve) == 1
    assert [rank(curve, place) for place in (0, 1, 5)] == [
        "smallest",
        "least error tried",
        "largest",
    ]
    rising = replace(
        curve,
        statistics={"mean_delta_e": np.sort(delta_e, axis=0)},
        fit=replace(curve.fit, optimum=replace(optimum, inside=False)),
    )
    assert [rank(rising, place) for place in (0, 5)] == ["smallest, least error tried", "largest"]


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
    sheet = decoded(pictures.contact_sheet_png("a title", tiles))
    for number, tile in enumerate(tiles):
        x = pictures.SHEET_MARGIN + number % pictures.COLUMNS * (112 + pictures.SHEET_GAP)
        y = (
            pictures.SHEET_MARGIN
            + pictures.TITLE
            + number // pictures.COLUMNS * (112 + 2 * 19 + pictures.SHEET_GAP)
        )
        np.testing.assert_array_equal(sheet[y : y + 112, x : x + 112], tile.codes)
        framed = (sheet[y : y + 112, x - 2] == 0).all()
        assert framed == tile.best
    assert pictures.contact_sheet_png("a title", tiles) == pictures.contact_sheet_png(
        "a title", tiles
    )


@pytest.mark.parametrize("title", ["two\nlines\tand \x1b[31m", "n" * 5000, "\u202e", ""])
def test_contact_sheet_png_long_title_is_bounded(title: str) -> None:
    tiles = [Picture(np.zeros((112, 112), np.uint8), "2 µm", "mean ΔE 1")] * 2
    sheet = decoded(pictures.contact_sheet_png(title, tiles))
    assert sheet.shape[0] == decoded(pictures.contact_sheet_png("plain", tiles)).shape[0]
    assert sheet.shape[1] < 2500


# --- the detail of the study
# --------------------------------------------------------------------------------------------


def test_study_detail_does_not_change_rows(tiny_result: StudyResult, tmp_path: Path) -> None:
    own = merge(
        WHOLE_CHART,
        {"display": {"dots": 120}, "resolution": 512, "paper": True, "detail": [0.1, 0.2]},
    )
    again = pixsim.study(tiny(**own), tmp_path, jobs=1)
    np.testing.assert_array_equal(again.curves[0].delta_e, tiny_result.curves[0].delta_e)
    assert replace(again, study=tiny_result.study).as_dict() == tiny_result.as_dict()
    text = (tmp_path / "results.csv").read_text(encoding="utf-8")
    (tmp_path / "results.csv").unlink()
    pixsim.study(tiny_result.study, tmp_path, jobs=1)
    assert (tmp_path / "results.csv").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    "detail", [[0.5], [0.5, 1.1], [-0.1, 0.5], [0.5, 0.5, 0.5], "middle", [float("nan"), 0.5]]
)
def test_study_detail_outside_picture_raises(detail: object) -> None:
    from pixsim.base.layers import Layer

    with pytest.raises(PixsimError, match="detail"):
        checked(pixsim.Study, [Layer(TINY | {"detail": detail}, "a test")])
