"""Light that is given, rendered or of another program, in place of a scene: in a study, and on many
sensors, whose frames are those of `pixsim.evaluate`.
"""

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import COARSE, rows

from pixsim import (
    Camera,
    Display,
    Exposure,
    Pixel,
    PixsimError,
    SpectralImage,
    evaluate,
    study as study_of,
    sweep as sweep_of,
)
from pixsim.sensor.technology import load_technology
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.run import prepare, run_prepared
from pixsim.viewer.score import FrameScore
from pixsim.viewer.setting import Run

DIE_UM = 2700.0
study = partial(study_of, jobs=1)


def light_of(seed: int = 1, width_um: float = 640.0) -> SpectralImage:
    """Return light of another program, without a camera or a white in its header."""
    data = 1e-3 * (1 + np.random.default_rng(seed).random((64, 64, 3))).astype(np.float32)
    return SpectralImage(
        [450.0, 550.0, 620.0], 30.0, width_um / 64, data=data, header={"diffraction": False}
    )


def without(table, *labels: str) -> list[dict]:
    return [{name: value for name, value in row.items() if name not in labels} for row in table]


# --- a study --------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    text = (
        'name = "small"\nrepeats = 2\npitch.values_um = [20, 28, 40, 56, 80]\ndisplay.dots = 48\n'
    )
    (tmp_path / "small.toml").write_text(text)
    return tmp_path


def rows_in(folder: Path) -> list[dict]:
    """The rows of results.csv, without their keys."""
    return without(rows(folder), "key", "check")


def test_the_light_of_a_study_gives_its_rows_again_bit_for_bit(folder: Path) -> None:
    scene = {"scene": "csf", "parameters": {"luminance_cd_per_m2": 100.0}, "resolution": COARSE}
    rendered = study(folder / "small.toml", folder / "rendered", **scene)
    again = study(folder / "small.toml", folder / "again", light=rendered.irradiance)
    assert rows_in(folder / "again") == rows_in(folder / "rendered")
    assert again.camera == rendered.camera
    assert again.film is None, "its error is not known"


def test_settings_of_a_study_of_given_light_make_its_rows_again(folder: Path) -> None:
    """Rows of one light are not taken for those of another, whose header says the same."""
    light, other_light = (light_of(seed, DIE_UM) for seed in (1, 2))
    first = study(
        folder / "small.toml",
        folder / "a",
        light=light,
        camera=Camera(die_mm=1e-3 * DIE_UM, f_number=5.6),
        display={"white_cd_per_m2": 5000.0},
    )
    settings = folder / "settings.toml"
    settings.write_text(first.settings_toml)
    study(settings, folder / "again", light=light)
    assert first.camera.f_number == 5.6
    assert rows_in(folder / "again") == rows_in(folder / "a")
    with pytest.raises(PixsimError, match=r"scene\.file: got light that was given"):
        study(settings, folder / "none")

    study(settings, folder / "again", light=other_light)
    assert rows_in(folder / "again") != rows_in(folder / "a")


def test_a_target_in_given_light_is_judged_as_in_the_light_of_its_scene(folder: Path) -> None:
    """Its rows, bit for bit; those of another light without the target, whose header says the same,
    are others.
    """
    target = {"size_um": 300.0, "contrast": 0.1, "luminance_cd_per_m2": 100.0}
    judge = partial(study, folder / "small.toml", metrics=["detectability", "npwe"])
    rendered = judge(folder / "rendered", scene="target", parameters=target, resolution=COARSE)
    background = rendered.light.background
    again = judge(folder / "again", light=rendered.irradiance, without=background)
    assert rows_in(folder / "again") == rows_in(folder / "rendered")
    worst = again.curves[0].statistics["least_detectability"].min(axis=1)
    assert again.curves[0].as_dict()["metrics"]["least_detectability"] == worst.tolist()

    brighter = background.with_planes(1.02 * background.planes)
    judge(folder / "again", light=rendered.irradiance, without=brighter)
    assert rows_in(folder / "again") != rows_in(folder / "rendered")


# --- many sensors ---------------------------------------------------------------------------------

CAMERA = Camera(die_mm=0.64)
DISPLAY = Display(dots=48, white_cd_per_m2=3000.0)
OLD = Pixel(pitch_um=10.0)
PIXELS = {"old": OLD, "phone": Pixel(technology="4t-bsi", pitch_um=10.0)}
LIGHT = light_of()
sweep = partial(sweep_of, camera=CAMERA, jobs=1)
sweep_light = partial(sweep, LIGHT, display=DISPLAY)


def mean_image(score: FrameScore) -> float:
    return float(score.image.mean())


@pytest.mark.parametrize(
    "display",
    [DISPLAY, Display(raster="one_to_one", white_cd_per_m2=3000.0)],
    ids=["dots", "pixels"],
)
def test_numbers_of_pixels_of_one_size_are_those_of_evaluate_bit_for_bit(display: Display) -> None:
    metrics = ["delta_e", "visual_noise", "information", "detectability", mean_image]
    target = LIGHT.with_planes(0.99 * LIGHT.planes)
    options: dict = {"display": display, "metrics": metrics, "seed": 5, "without": target}
    for row, pixel in zip(sweep(LIGHT, PIXELS, **options), PIXELS.values(), strict=True):
        score = evaluate(LIGHT, CAMERA, pixel, **options)
        assert {name: row[name] for name in score.statistics()} == score.statistics()


def test_repeats_are_the_sensors_of_a_run() -> None:
    table = sweep_light([OLD], repeats=3, seed=2)
    settings = Run(
        camera={"die_mm": 0.64},
        pixel={"pitch_um": 10.0},
        display={"dots": 48, "white_cd_per_m2": 3000.0},
        seed=2,
    )
    run = run_prepared(prepare(settings, light=LIGHT, repeats=3))
    for row, expected in zip(table, run.statistics, strict=True):
        assert {name: row[name] for name in expected} == expected


def test_pixels_of_several_sizes_are_scored_on_the_same_dots() -> None:
    """Dots of 13.3 µm: the border of pixels of 30 µm is four of them wide, that of pixels of 6 µm
    one.
    """
    pixels = [Pixel(pitch_um=6.0), Pixel(pitch_um=30.0)]
    small, large = sweep_light(pixels, metrics=["delta_e", mean_image])
    expected = [evaluate(LIGHT, CAMERA, pixel, display=DISPLAY) for pixel in pixels]
    assert [score.image.shape for score in expected] == [(46, 46), (40, 40)]
    assert large["mean_delta_e"] == expected[1].mean_delta_e
    assert small["mean_image"] == pytest.approx(expected[0].image[3:-3, 3:-3].mean(), rel=1e-12)


def test_automatic_exposure_that_fills_all_alike_is_noted() -> None:
    """Dark charge of 1 % of the well counts as light does. In the time of the brighter pixel the
    other one has a third of its light.
    """
    sheet = {"full_well_e": 1e4, "read_noise_e": 3.0, "dark_current_e_per_s": 0.0, "prnu": 0.0}
    pixels = [Pixel(pitch_um=20.0, quantum_efficiency=part, **sheet) for part in (0.3, 0.9)]
    with pytest.warns(UserWarning, match="brightest pixel to 95 % of the full well.*For equal"):
        filled = sweep_light(pixels)
    assert [row["share_of_full_well"] for row in filled] == pytest.approx([0.95] * 2, rel=1e-12)

    time_s = filled[1]["integration_s"]
    dark = [pixel.model_copy(update={"dark_current_e_per_s": 100 / time_s}) for pixel in pixels]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "automatic exposure fills")
        exposed = sweep_light(dark, exposure=Exposure(integration_s=time_s))
    expected = [0.95 / 3 + 0.01, 0.95 + 0.01]
    assert [row["share_of_full_well"] for row in exposed] == pytest.approx(expected, rel=1e-9)


def test_metric_without_a_number_for_a_sensor_is_nan() -> None:
    """In a second all pixels are full, and their noise is hidden."""
    with pytest.warns(UserWarning, match="pixel old: the metric visual_noise"):
        table = sweep_light(PIXELS, exposure=Exposure(integration_s=1.0), metrics=["visual_noise"])
    assert np.isnan(table[0]["visual_noise"])


@pytest.mark.slow
def test_processes_change_no_number_and_another_light_does() -> None:
    """Two lights whose headers say the same, in the workers of one another: their chains are not
    mixed up.
    """
    options: dict = {"display": DISPLAY, "metrics": ["delta_e", mean_image], "repeats": 2}
    lights = [light_of(seed) for seed in (1, 2)]
    one_process, two_processes = (
        [list(sweep(light, PIXELS, **options | {"jobs": jobs})) for light in lights]
        for jobs in (1, 2)
    )
    assert one_process == two_processes
    assert one_process[0][0]["mean_delta_e"] != one_process[1][0]["mean_delta_e"]


def test_white_that_nobody_states_is_one_for_all() -> None:
    """That of the sensor which sees the picture brightest: on it, the other's picture is darker.
    Metrics that nobody asks for have no columns.
    """
    light = light_of(9)
    display = Display(dots=48)
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        table = sweep(light, PIXELS, metrics=[mean_image], display=display)
    with pytest.warns(UserWarning, match="the scene does not define its white"):
        scores = [evaluate(light, CAMERA, pixel, display=display) for pixel in PIXELS.values()]
    ratios = [
        row["mean_image"] / mean_image(score) for row, score in zip(table, scores, strict=True)
    ]
    assert min(ratios) < max(ratios) == 1.0
    assert "mean_delta_e" not in table[0]


def test_rows_of_axes_and_conditions_are_those_of_sweeps_with_their_settings() -> None:
    axis = {"name": "bits", "set": "pixel.bits", "values": [6, 10]}
    condition = {"name": "short", "set": {"exposure": {"integration_s": 1e-4}}}
    table = sweep_light(PIXELS, axis=[axis], condition=[condition], seed=3)
    short = Exposure(integration_s=1e-4)
    for bits in (6, 10):
        rows_of_bits = [row for row in table if row["bits"] == bits]
        expected = sweep_light(PIXELS, pixel={"bits": bits}, exposure=short, seed=3)
        assert without(rows_of_bits, "bits", "condition") == list(expected)


def test_sensor_types_are_further_rows_within_the_ranges_of_the_technology() -> None:
    technology = load_technology("0.35um")
    numbers = [f"old {name}" for name in technology.ranges]
    as_is, *types = sweep_light({"old": OLD}, uncertainty=8, seed=3)
    assert without([as_is], "draw", *numbers) == list(sweep_light({"old": OLD}, seed=3))
    assert [row["draw"] for row in (as_is, *types)] == ["base", *range(8)]
    for name, (low, high) in technology.ranges.items():
        drawn = [row[f"old {name}"] for row in types]
        assert as_is[f"old {name}"] == technology.numbers[name]
        assert low <= min(drawn) < max(drawn) <= high
    assert len({row["mean_delta_e"] for row in types}) == 8


def test_interrupted_sweep_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = list(sweep_light(PIXELS, out=tmp_path / "rows"))
    monkeypatch.setattr(evaluate_module, "evaluate_task", lambda *_: pytest.fail("a frame"))
    assert list(sweep_light(PIXELS, out=tmp_path / "rows")) == table
