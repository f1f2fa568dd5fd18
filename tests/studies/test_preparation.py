"""What a command decides before its first render: display and chart of a data sheet's sensor, pixel
sizes, windows, cost.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiny import rows, tiny, toml_of

import pixsim
from pixsim.base.toml import packaged
from pixsim.report.curve import optimum_line
from pixsim.report.outline import study_outline
from pixsim.scene.renderer import Renderer
from pixsim.sensor.pixel_options import PixelOptions
from pixsim.studies.curve import WIDE_RATIO, Curve
from pixsim.studies.design import BYTES_PER_PIXEL, study_pitches_um, technology_of
from pixsim.studies.files import load_study
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import MAX_FRAME_BYTES, choose_view, fitted_range, prepare
from pixsim.studies.settings import Study

SHEET = {
    "pitch_um": 3.45,
    "full_well_e": 11000,
    "read_noise_e": 2.2,
    "dark_current_e_per_s": 5,
    "quantum_efficiency": 0.62,
}
SMALL = {"resolution": 64, "spp": 4, "luminance_cd_per_m2": 50.0}
SENSOR, LENS, DISPLAY = (
    f"the {name}"
    for name in ("sensor's Nyquist frequency", "lens's cut-off", "display's Nyquist frequency")
)

# Such as of a shortened range; tests of warnings set their own.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def sheet_toml(folder: Path) -> Path:
    path = folder / "sensor.toml"
    path.write_text(f"pixel = {toml_of(SHEET)}\n", encoding="utf-8")
    return path


# --- display and chart


@pytest.mark.parametrize(
    ("pitch_um", "f_number", "display", "scene", "expected"),
    [
        # A dot for each pixel: the same frequency as the sensor, which is named first.
        (20.0, 4.0, {}, {}, {"dots": 400, "max_lp_per_mm": 25.0, "limited_by": SENSOR}),
        (3.45, 4.0, {}, {}, {"dots": 2048, "max_lp_per_mm": 128.0, "limited_by": DISPLAY}),
        (10.0, 4.0, {"dots": 100}, {}, {"max_lp_per_mm": 6.25, "limited_by": DISPLAY}),
        # Dots are pixels.
        (10.0, 4.0, {"raster": "one_to_one"}, {}, {"max_lp_per_mm": 50.0, "limited_by": SENSOR}),
        # f/16 at 12 mm, of an object far away: 1e6/(550 N) cycles per mm.
        (
            3.45,
            16.0,
            {},
            {},
            {
                "dots": 2048,
                "max_lp_per_mm": pytest.approx(1e6 / 550 / 16, rel=0.02),
                "limited_by": LENS,
            },
        ),
        # The fewest dots that a display has.
        (1500.0, 4.0, {}, {"max_lp_per_mm": 20}, {"dots": 8}),
        (10.0, 4.0, {}, {"max_lp_per_mm": 20}, {"dots": 800}),
        (10.0, 4.0, {}, {"chart": "charts/flat.exr"}, {"dots": 800}),
    ],
)
def test_choose_view_takes_the_least_of_three_limits_and_keeps_settings(
    pitch_um: float,
    f_number: float,
    display: dict[str, Any],
    scene: dict[str, Any],
    expected: dict[str, Any],
) -> None:
    camera = pixsim.Camera(die_mm=8.0, f_number=f_number, focal_length_mm=12.0)
    chart = pixsim.load_scene("csf", resolution=64, **scene)
    assert choose_view(pitch_um, camera, pixsim.Display(**display), chart) == expected


# --- pixel sizes


def sheet_study(die_mm: float, pixel: dict[str, Any] | None = None, **pitch: Any) -> Study:
    sheet = {name: value for name, value in SHEET.items() if name != "pitch_um"}
    table = {"name": "own", "technologies": ["none"], "camera": {"die_mm": die_mm}}
    table |= {"pixel": sheet | {"data_sheet_pitch_um": 3.45} | (pixel or {}), "pitch": pitch}
    return Study.model_validate(table)


MAX_PIXELS = MAX_FRAME_BYTES / BYTES_PER_PIXEL
STACK = {"height_um": 5.0, "index": 1.5, "microlens": "square"}
RANGES = {
    "a quarter to four times": (sheet_study(2.0), 2.0, "", 0.8625, 13.8),
    "frame of 1 GiB": (sheet_study(8.5), 8.5, "smallest", 8500 / MAX_PIXELS**0.5, 13.8),
    "frame of the sheet's own size": (sheet_study(24.0), 24.0, "smallest", 24e3 / 6956, 13.8),
    "16 pixels across the die": (sheet_study(0.1), 0.1, "largest", 0.8625, 6.25),
    # √π times the height; the scored frame is as without a stack
    "widest microlens": (sheet_study(2.0, {"stack": STACK}), 2.0, "largest", 0.8625, 13.8),
    "widest, stated end": (sheet_study(2.0, {"stack": STACK}, max_um=9.0), 2.0, "largest", 0.8625, 9),
}  # fmt: skip


@pytest.mark.parametrize(
    ("study", "die_mm", "end", "min_um", "max_um"), RANGES.values(), ids=RANGES
)
def test_fitted_range_is_quarter_to_four_times_within_a_frame_and_the_die(
    study: Study, die_mm: float, end: str, min_um: float, max_um: float
) -> None:
    with warnings.catch_warnings(record=True, action="always") as caught:
        fitted = fitted_range(study, pixsim.Camera(die_mm=die_mm))
    assert [end in str(warning.message) for warning in caught] == [True] * bool(end)
    assert min_um <= fitted.pitch.min_um < min_um + 1e-4  # rounded up
    assert fitted.pitch.max_um == max_um
    if isinstance(study.pixel, PixelOptions) and study.pixel.stack is not None:
        assert study_pitches_um(fitted, "none").max() == 8.8622


@pytest.mark.parametrize("pitch", [{"min_um": 0.5}, {"values_um": (0.5, 3, 4, 5, 6)}])
def test_prepare_stated_size_with_too_many_pixels_raises(pitch: dict[str, Any]) -> None:
    with pytest.raises(pixsim.PixsimError, match=r"289 million pixels; allowed: at least 1\.03"):
        prepare(sheet_study(8.5, **pitch))


def test_prepare_technology_with_too_many_pixels_is_clipped() -> None:
    study = load_study("pixel-size", camera={"die_mm": 30.0})
    with pytest.warns(UserWarning, match="smallest pixel size is"):
        fitted = prepare(study).complete
    pixels = [(30e3 / study_pitches_um(each, "4t-bsi")[0]) ** 2 for each in (fitted, study)]
    assert pixels[0] <= 2**26 < pixels[1]


# --- one set of options in TOML, by options and in Python


def test_toml_options_and_python_make_the_same_study(tmp_path: Path) -> None:
    sheet = sheet_toml(tmp_path)
    tables = {"camera": {"f_number": 2.0}, "pitch": {"min_um": 2.0, "max_um": 12.0, "count": 5}}
    more = {"seed": 3, "refine": False, "resolution": 64}
    bare, whole = tmp_path / "bare.toml", tmp_path / "own.toml"
    bare.write_text('name = "own"\nrepeats = 2\n', encoding="utf-8")
    table = more | {"scene": {"file": "slanted_edge", "parameters": SMALL}} | tables
    lines = [f"{name} = {toml_of(value)}\n" for name, value in table.items()]
    whole.write_text(bare.read_text() + "".join(lines), encoding="utf-8")
    options = "--seed 3 --no-refine --resolution 64 --scene slanted_edge --camera.f-number 2"
    options += " --pitch.min-um 2 --pitch.max-um 12 --pitch.count 5"
    options += "".join(f" -D {name}={value}" for name, value in SMALL.items())
    outlines = [
        command(f"study {words} --config {sheet} --dry-run --json")
        for words in (whole, f"{bare} {options}")
    ]
    assert outlines[0] == outlines[1]
    over = {"scene": "slanted_edge", "parameters": SMALL} | more | tables
    studies = load_study(whole, config=sheet), load_study(bare, config=sheet, **over)
    tables_of_studies = [study.model_dump(exclude={"sources"}) for study in studies]
    assert tables_of_studies[0] == tables_of_studies[1]


@pytest.mark.parametrize(
    ("words", "texts"),
    [
        ("--pixel.pitch-um 3", ["pixel.pitch_um", "for a study"]),
        ("--pitch.max-um 2000", ["pixel.pitch_um", "border"]),
        ("--window 9", ["window_mm", "width of the die"]),
        ("--scene flat -D max_lp_per_mm=3", ["scene parameter", "max_lp_per_mm"]),
        ("-D chart=charts/flat.exr -D max_lp_per_mm=3", ["scene parameter", "max_lp_per_mm"]),
    ],
)
def test_study_problem_is_found_before_render(
    words: str, texts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Renderer, "run", lambda *_, **__: pytest.fail("rendered"))
    assert_refused(*command(f"study pixel-size --out {tmp_path / 'out'} {words}"), texts)
    assert not (tmp_path / "out").exists()


FILES = {
    "study.toml": 'name = "a"\ntechnologies = ["mine.toml", "0.25um"]\nprocess."mine.toml".dsnu = 0.1\n',
    "study.quick.toml": 'technologies = ["0.25um"]\n',
    "list.toml": 'name = "b"\n[pitch]\nvalues_um = [6, 7, 8, 9, 10]\n',
    "list.quick.toml": "[pitch]\nvalues_um = [6, 8, 9, 10, 11]\n",
    "bits.toml": 'name = "c"\npixel.bits = 8\nsources."pixel.bits" = "x"\nsources."pixel.prnu" = "y"\n',
    "bits.quick.toml": "pixel = { bits = 9 }\n",
    "sensor.toml": "[pixel]\nbits = 11\nprnu = 0.02\n",
    "sheet.toml": f"pixel = {toml_of(SHEET)}\n".replace('"read_noise_e" = 2.2, ', ""),
    "mine.toml": packaged("data/technologies")["0.35um"].read_text(encoding="utf-8"),
}  # fmt: skip


def fields(study: Study, *names: str) -> tuple[Any, ...]:
    """Fields of a study by their dotted names."""
    return tuple(reduce(getattr, name.split("."), study) for name in names)


def dsnu(study: Study) -> list[float]:
    return [technology_of(study, name).dsnu for name in study.technologies]


def size_count(**options: Any) -> int:
    study = load_study("list.toml", pitch={"min_um": 6.0, "count": 7}, **options)
    return study_pitches_um(study, "0.35um").size


BITS = ("pixel.bits", "pixel.prnu", "sources")
COMPLETED = ("technologies", "pixel.read_noise_e", "pixel.data_sheet_pitch_um")
LAYERS: dict[str, tuple[Callable[[], Any], Any]] = {
    "files lie next to the study": (lambda: dsnu(load_study("study.toml")), [0.1, 0.3]),
    "overrides leave out numbers of a technology that they leave out": (
        lambda: fields(load_study("study.toml", quick=True), "technologies", "process"),
        (("0.25um",), {}),
    ),
    "options come over sensors, overrides and the study; its sources go": (
        lambda: fields(
            load_study("bits.toml", "sensor.toml", pixel={"bits": "12"}, quick=True), *BITS
        ),
        (12, 0.02, {}),
    ),
    "an option completes a data sheet": (
        lambda: fields(
            load_study("pixel-size", "sheet.toml", pixel={"read_noise_e": 2.0}), *COMPLETED
        ),
        (("none",), 2.0, 3.45),
    ),
    "an incomplete data sheet takes the rest from the technology": (
        lambda: load_study("pixel-size", "sheet.toml").technologies,
        ("4t-bsi",),
    ),
    "quick": (lambda: load_study("chen2000", quick=True).technologies, ("0.35um",)),
    "quick leaves an option": (
        lambda: fields(
            load_study("chen2000", pixel={"technology": "0.25um"}, quick=True),
            *("technologies", "repeats"),
        ),
        (("0.25um",), 4),
    ),
    "a range replaces a list": (size_count, 7),
    "a range replaces a list of overrides": (lambda: size_count(quick=True), 7),
    "another scene has no parameters of the study's": (
        lambda: load_study("pixel-size", scene="still_life").scene.parameters,
        {},
    ),
    "parameters of the same scene": (
        lambda: load_study("pixel-size", scene="csf", parameters={"spp": 4}).scene.parameters,
        {"spp": 4},
    ),
    "a technology keeps the paper's display and chart": (
        lambda: prepare(load_study("chen2000")).complete,
        load_study("chen2000"),
    ),
}


@pytest.mark.parametrize(("call", "expected"), LAYERS.values(), ids=LAYERS)
def test_settings_of_files_and_options_take_precedence(
    call: Callable[[], Any], expected: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text, encoding="utf-8")
    assert call() == expected


# --- window


def test_window_is_same_lens_on_part_of_the_die(tmp_path: Path) -> None:
    """In a scene whose lens follows from its focal length, a window is a smaller die."""
    sizes = {"pitch": {"values_um": [8, 10, 12, 16, 20]}}
    window, die = (
        pixsim.study(tiny(**sizes, **over), tmp_path / name, jobs=1).curves[0].delta_e
        for name, over in (("window", {"window_mm": 0.9}), ("die", {"camera": {"die_mm": 0.9}}))
    )
    np.testing.assert_array_equal(window, die)


# --- no visible difference


def curve_through(pitch_um: np.ndarray, mean: np.ndarray, scatter: float) -> Curve:
    delta_e = mean[:, None] + scatter * np.array([-1.0, 0.0, 1.0])
    fit = fit_curve(pitch_um, delta_e)
    fill_factor = np.ones(pitch_um.size)
    return Curve("none", 0.35, pitch_um, fill_factor, {"mean_delta_e": delta_e}, fit)


WIDE_UM = np.geomspace(1.0, 16.0, 9)
FLAT = 0.2 + np.array([0.5, 0.2, 0.03, 0.01, 0.0, 0.01, 0.02, 0.2, 0.5])
FLAT_WIDER = np.where(FLAT == 0.23, 0.24, FLAT)
NARROW_UM = np.geomspace(4.0, 8.0, 9)


@pytest.mark.parametrize(
    ("pitch_um", "mean", "scatter", "ends"),
    [
        (WIDE_UM, FLAT, 1e-6, [2, 6]),
        (WIDE_UM, FLAT_WIDER, 1e-6, [2, 6]),
        (WIDE_UM, FLAT_WIDER, 0.02, [3, 6]),
        (WIDE_UM, FLAT, 0.2, None),  # nothing is known to be alike
        (NARROW_UM, 1.0 + 5 * np.log(NARROW_UM / 5.6) ** 2, 1e-6, None),  # below WIDE_RATIO
    ],
)
def test_no_difference_um_is_widest_range_within_a_twentieth(
    pitch_um: np.ndarray, mean: np.ndarray, scatter: float, ends: list[int] | None
) -> None:
    """An uncertainty of 0.01 of each size is √2 of that for a difference: 0.03 + 0.014 is within
    0.05, and 0.04 + 0.014 not.
    """
    curve = curve_through(pitch_um, mean, scatter)
    assert curve.no_difference_um == (None if ends is None else tuple(pitch_um[ends]))
    assert ("no visible difference" in optimum_line(curve)) == (ends is not None)
    assert ends is None or pitch_um[ends[1]] / pitch_um[ends[0]] >= WIDE_RATIO


LENS_UM = np.array([0.4715, 0.7729, 1.267, 2.0771, 3.4049, 5.5818, 9.1502, 15.0])
PHONE = np.array([8.031, 0.957, 0.775, 0.751, 0.750, 0.771, 0.826, 0.958])


def test_fit_beside_a_steep_flank() -> None:
    """The phone's lens in the light of a lamp: the fit is least among the sizes that look alike,
    which its interval contains. Beside a lower corner, the fit swings below all sizes tried, and
    that is said.
    """
    steep = curve_through(LENS_UM, PHONE, 5e-4)
    assert steep.no_difference_um == (1.267, 5.5818)
    low_um, high_um = steep.optimum.interval_um
    assert 0.7729 < low_um < 2.0771 < 3.4049 < high_um < 5.5818
    corner = curve_through(LENS_UM, np.array([1.87, 0.80, *PHONE[2:]]), 5e-4)
    assert [curve.fit_swings for curve in (steep, corner)] == [False, True]
    assert "unknown beside the steep flank" in optimum_line(corner)


# --- dry run and cost


@pytest.mark.parametrize("line", ["run csf", "study chen2000", "run macbeth --window 1"])
def test_dry_run_renders_and_writes_nothing(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Renderer, "run", lambda *_, **__: pytest.fail("rendered"))
    monkeypatch.chdir(tmp_path)
    code, out, err = command(f"{line} --dry-run --json")
    assert code == 0, err
    assert json.loads(out)["estimate"]["seconds"] > 1
    assert not list(tmp_path.iterdir())


def test_dry_run_counts_what_the_study_does(tmp_path: Path) -> None:
    """Two sensors of each size are shown on two further displays."""
    small = {"resolution": 48, "window_mm": 0.2, "pitch": {"count": 5}, "refine": False}
    study = load_study("pixel-size", sheet_toml(tmp_path), quick=True, **small)
    outline = study_outline(prepare(study))
    result = pixsim.study(study, tmp_path / "out", jobs=1)
    (sensor,) = outline["sensors"]
    assert result.curves[0].pitch_um.tolist() == sensor["pitch_um"]
    dots = [int(row["dots"]) for row in rows(tmp_path / "out")]
    assert (outline["estimate"]["renders"], outline["estimate"]["evaluations"]) == (1, len(dots))
    assert dots.count(outline["display"]["dots"]) == 5 * sensor["sensors"] == len(dots) - 5 * 2 * 2
    assert result.irradiance.shape == tuple(outline["film"]["samples"])
