"""Many sensors in one light: the frames of `pixsim.evaluate`, through the evaluations of a
study.
"""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim import Camera, Display, Exposure, Pixel, SpectralImage, evaluate
from pixsim.sensor.technology import load_technology
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.run import prepare, run_prepared
from pixsim.viewer.setting import Run

CAMERA = Camera(die_mm=0.64)
DISPLAY = Display(dots=48, white_cd_per_m2=3000.0)
OLD = Pixel(pitch_um=10.0)
PIXELS = {"old": OLD, "phone": Pixel(technology="4t-bsi", pitch_um=10.0)}
sweep = partial(pixsim.sweep, camera=CAMERA, jobs=1)


def light_of(seed: int = 1) -> SpectralImage:
    data = 1e-3 * (1 + np.random.default_rng(seed).random((64, 64, 3))).astype(np.float32)
    return SpectralImage(
        [450.0, 550.0, 620.0], 30.0, 10.0, data=data, header={"diffraction": False}
    )


LIGHT = light_of()


def mean_image(score: pixsim.FrameScore) -> float:
    return float(score.image.mean())


def without(rows: Any, *labels: str) -> list[dict[str, Any]]:
    return [{name: value for name, value in row.items() if name not in labels} for row in rows]


@pytest.mark.parametrize(
    "display",
    [DISPLAY, Display(raster="one_to_one", white_cd_per_m2=3000.0)],
    ids=["dots", "pixels"],
)
def test_numbers_of_pixels_of_one_size_are_those_of_evaluate_bit_for_bit(display: Display) -> None:
    metrics = ["delta_e", "visual_noise", "information", "detectability", mean_image]
    target = LIGHT.with_planes(0.99 * LIGHT.planes)
    options: dict[str, Any] = {"display": display, "metrics": metrics, "seed": 5, "without": target}
    for row, pixel in zip(sweep(LIGHT, PIXELS, **options), PIXELS.values(), strict=True):
        score = evaluate(LIGHT, CAMERA, pixel, **options)
        assert {name: row[name] for name in score.statistics()} == score.statistics()


def test_repeats_are_the_sensors_of_a_run() -> None:
    """Each at its registration."""
    table = sweep(LIGHT, [OLD], display=DISPLAY, repeats=3, seed=2)
    tables = {"camera": CAMERA, "pixel": OLD, "display": DISPLAY}
    stated = {name: record.model_dump(exclude_unset=True) for name, record in tables.items()}
    settings = Run.model_validate(stated | {"seed": 2})
    run = run_prepared(prepare(LIGHT, settings, repeats=3))
    for row, expected in zip(table, run.statistics, strict=True):
        assert {name: row[name] for name in expected} == expected


def test_pixels_of_several_sizes_are_scored_on_the_same_dots() -> None:
    """Dots of 13.3 µm: the border of pixels of 30 µm is four of them wide, that of pixels of 6 µm
    one.
    """
    pixels = [Pixel(pitch_um=6.0), Pixel(pitch_um=30.0)]
    small, large = sweep(LIGHT, pixels, display=DISPLAY, metrics=["delta_e", mean_image])
    expected = [evaluate(LIGHT, CAMERA, pixel, display=DISPLAY) for pixel in pixels]
    assert [score.image.shape for score in expected] == [(46, 46), (40, 40)]
    assert large["mean_delta_e"] == expected[1].mean_delta_e
    assert small["mean_image"] == pytest.approx(expected[0].image[3:-3, 3:-3].mean(), rel=1e-12)


def test_metric_without_a_number_for_a_sensor_is_nan() -> None:
    """In a second all pixels are full, and their noise is hidden."""
    exposure = Exposure(integration_s=1.0)
    with pytest.warns(UserWarning, match="pixel old: the metric visual_noise"):
        table = sweep(LIGHT, PIXELS, display=DISPLAY, exposure=exposure, metrics=["visual_noise"])
    assert np.isnan(table[0]["visual_noise"])


def test_processes_change_no_number_and_another_light_does() -> None:
    """Two lights whose headers say the same, in the workers of one another: their chains are not
    mixed up.
    """
    options: dict[str, Any] = {"display": DISPLAY, "metrics": ["delta_e", mean_image], "repeats": 2}
    one_process, two_processes = (
        [list(sweep(light, PIXELS, **options | {"jobs": jobs})) for light in (LIGHT, light_of(2))]
        for jobs in (1, 2)
    )
    assert one_process == two_processes
    assert one_process[0][0]["mean_delta_e"] != one_process[1][0]["mean_delta_e"]


def test_white_that_nobody_states_is_one_for_all() -> None:
    """That of the sensor which sees the picture brightest: on it, the other's picture is darker."""
    options: dict[str, Any] = {"display": Display(dots=48)}
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        table = sweep(light_of(9), PIXELS, metrics=[mean_image], **options)
    with pytest.warns(UserWarning, match="the scene does not define its white"):
        scores = [evaluate(light_of(9), CAMERA, pixel, **options) for pixel in PIXELS.values()]
    ratios = [
        row["mean_image"] / mean_image(score) for row, score in zip(table, scores, strict=True)
    ]
    assert max(ratios) == 1.0
    assert min(ratios) < 1.0


def test_table_is_written_as_csv(tmp_path: Path) -> None:
    table = sweep(LIGHT, {"007": OLD}, display=DISPLAY, metrics=[mean_image], repeats=2)
    text = table.to_csv(tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text() == text.replace("\r\n", "\n")
    expected = [{name: str(value) for name, value in row.items()} for row in table]
    assert list(csv.DictReader(text.splitlines())) == expected
    assert "mean_delta_e" not in table[0], "which nobody asks for"


def test_rows_of_axes_and_conditions_are_those_of_sweeps_with_their_settings() -> None:
    options: dict[str, Any] = {"display": DISPLAY, "seed": 3}
    axis = {"name": "bits", "set": "pixel.bits", "values": [6, 10]}
    condition = {"name": "short", "set": {"exposure": {"integration_s": 1e-4}}}
    table = sweep(LIGHT, PIXELS, axis=[axis], condition=[condition], **options)
    short = Exposure(integration_s=1e-4)
    for bits in (6, 10):
        rows = [row for row in table if row["bits"] == bits]
        expected = sweep(LIGHT, PIXELS, pixel={"bits": bits}, exposure=short, **options)
        assert without(rows, "bits", "condition") == list(expected)


def test_sensor_types_are_further_rows_within_the_ranges_of_the_technology() -> None:
    options: dict[str, Any] = {"display": DISPLAY, "seed": 3}
    technology = load_technology("0.35um")
    numbers = [f"old {name}" for name in technology.ranges]
    as_is, *types = sweep(LIGHT, {"old": OLD}, uncertainty=8, **options)
    assert without([as_is], "draw", *numbers) == list(sweep(LIGHT, {"old": OLD}, **options))
    assert [row["draw"] for row in (as_is, *types)] == ["base", *range(8)]
    for name, (low, high) in technology.ranges.items():
        drawn = [row[f"old {name}"] for row in types]
        assert as_is[f"old {name}"] == technology.numbers[name]
        assert low <= min(drawn) < max(drawn) <= high
    assert len({row["mean_delta_e"] for row in types}) == 8


def test_interrupted_sweep_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a results.csv of all rows no frame is made."""
    options: dict[str, Any] = {"display": DISPLAY, "out": tmp_path / "rows"}
    table = list(sweep(LIGHT, PIXELS, **options))
    monkeypatch.setattr(evaluate_module, "evaluate_task", lambda *_: pytest.fail("a frame"))
    assert list(sweep(LIGHT, PIXELS, **options)) == table
