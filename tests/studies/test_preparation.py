"""What a command decides before its first render: display and chart of a data sheet's sensor, pixel
sizes, windows, cost; and what it refuses: rules across fields of studies, runs, metrics of a user
and sensor types, with the name of the setting and the cause.

Each option of a study acts in a comparison and in a sweep too, is named, or is refused. Rules of axes, comparisons and sweeps: test_refusals.py.
"""

import inspect
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import cache, reduce
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.sheets import sheet
from helpers.study_settings import CHANGES
from helpers.tiny import rows, tiny, toml_of

import pixsim
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.cli.commands import app
from pixsim.report.curve import optimum_line
from pixsim.report.outline import study_outline
from pixsim.scene.renderer import Renderer
from pixsim.sensor.spread import Spread
from pixsim.studies import compare as compare_module, sweep as sweep_module
from pixsim.studies.curve import WIDE_RATIO, Curve
from pixsim.studies.design import BYTES_PER_PIXEL, cases_of, study_pitches_um, technology_of
from pixsim.studies.engine import Workers
from pixsim.studies.files import load_study
from pixsim.studies.optimum import fit_curve
from pixsim.studies.prepare import (
    MAX_FRAME_BYTES,
    UncertaintyRequest,
    check_axes,
    choose_view,
    fitted_range,
    prepare,
    uncertainty_request,
    unknowns_of_study,
)
from pixsim.studies.run import check_raw
from pixsim.studies.settings import SUPPORTED_BY
from pixsim.studies.uncertainty import Unknown, few_pitches_um, sample_types, unknowns_of_sheet
from pixsim.viewer.setting import Run

NUMBERS = {
    "full_well_e": 11000,
    "read_noise_e": 2.2,
    "dark_current_e_per_s": 5,
    "quantum_efficiency": 0.62,
}
SHEET = NUMBERS | {"pitch_um": 3.45}
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
    pitch_um: float, f_number: float, display: dict, scene: dict, expected: dict
) -> None:
    camera = pixsim.Camera(die_mm=8.0, f_number=f_number, focal_length_mm=12.0)
    chart = pixsim.load_scene("csf", resolution=64, **scene)
    assert choose_view(pitch_um, camera, pixsim.Display(**display), chart) == expected


# --- pixel sizes


def sheet_study(die_mm: float, pixel: dict | None = None, **pitch) -> pixsim.Study:
    table = {
        "name": "own",
        "technologies": ["none"],
        "camera": {"die_mm": die_mm},
        "pixel": NUMBERS | {"data_sheet_pitch_um": 3.45} | (pixel or {}),
        "pitch": pitch,
    }
    return pixsim.Study.model_validate(table)


STACK = {"height_um": 5.0, "index": 1.5, "microlens": "square"}
RANGES = {
    "a quarter to four times": (sheet_study(2.0), 2.0, "", 0.8625, 13.8),
    "frame of 1 GiB": (sheet_study(8.5), 8.5, "smallest", 8500 / (MAX_FRAME_BYTES / BYTES_PER_PIXEL) ** 0.5, 13.8),
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
    study: pixsim.Study, die_mm: float, end: str, min_um: float, max_um: float
) -> None:
    with warnings.catch_warnings(record=True, action="always") as caught:
        fitted = fitted_range(study, pixsim.Camera(die_mm=die_mm))
    assert [end in str(warning.message) for warning in caught] == [True] * bool(end)
    assert min_um <= fitted.pitch.min_um < min_um + 1e-4  # rounded up
    assert fitted.pitch.max_um == max_um
    if study.pixel.stack is not None:
        assert study_pitches_um(fitted, "none").max() == 8.8622


def test_prepare_technology_with_too_many_pixels_is_clipped() -> None:
    study = load_study("pixel-size", camera={"die_mm": 30.0})
    with pytest.warns(UserWarning, match="smallest pixel size is"):
        fitted = prepare(study).complete
    smallest_um = [study_pitches_um(each, "4t-bsi")[0] for each in (fitted, study)]
    assert (30e3 / smallest_um[0]) ** 2 <= 2**26 < (30e3 / smallest_um[1]) ** 2


# --- one set of options in TOML, by options and in Python


def test_toml_options_and_python_make_the_same_study(tmp_path: Path) -> None:
    sheet = sheet_toml(tmp_path)
    table = {
        "seed": 3,
        "refine": False,
        "resolution": 64,
        "camera": {"f_number": 2.0},
        "pitch": {"min_um": 2.0, "max_um": 12.0, "count": 5},
    }
    scene = {"scene": {"file": "slanted_edge", "parameters": SMALL}}
    bare, whole = tmp_path / "bare.toml", tmp_path / "own.toml"
    bare.write_text('name = "own"\nrepeats = 2\n', encoding="utf-8")
    lines = [f"{name} = {toml_of(value)}\n" for name, value in (table | scene).items()]
    whole.write_text(bare.read_text() + "".join(lines), encoding="utf-8")
    options = (
        "--seed 3 --no-refine --resolution 64 --scene slanted_edge --camera.f-number 2"
        " --pitch.min-um 2 --pitch.max-um 12 --pitch.count 5"
        " -D resolution=64 -D spp=4 -D luminance_cd_per_m2=50"
    )
    outlines = [
        command(f"study {words} --config {sheet} --dry-run --json")
        for words in (whole, f"{bare} {options}")
    ]
    assert outlines[0] == outlines[1]
    by_python = load_study(bare, config=sheet, scene="slanted_edge", parameters=SMALL, **table)
    by_toml = load_study(whole, config=sheet)
    assert by_toml.model_dump(exclude={"sources"}) == by_python.model_dump(exclude={"sources"})


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


def fields(study: pixsim.Study, *names: str) -> tuple[object, ...]:
    """Fields of a study by their dotted names."""
    return tuple(reduce(getattr, name.split("."), study) for name in names)


RANGE = {"pitch": {"min_um": 6.0, "count": 7}}
LAYERS: dict[str, tuple[Callable, object]] = {
    "files lie next to the study": (
        lambda: [
            technology_of(load_study("study.toml"), name).dsnu for name in ("mine.toml", "0.25um")
        ],
        [0.1, 0.3],
    ),
    "overrides leave out numbers of a technology that they leave out": (
        lambda: fields(load_study("study.toml", quick=True), "technologies", "process"),
        (("0.25um",), {}),
    ),
    "options come over sensors, overrides and the study; its sources go": (
        lambda: fields(
            load_study("bits.toml", "sensor.toml", pixel={"bits": "12"}, quick=True),
            *("pixel.bits", "pixel.prnu", "sources"),
        ),
        (12, 0.02, {}),
    ),
    "an option completes a data sheet": (
        lambda: fields(
            load_study("pixel-size", "sheet.toml", pixel={"read_noise_e": 2.0}),
            *("technologies", "pixel.read_noise_e", "pixel.data_sheet_pitch_um"),
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
    "a range replaces a list": (
        lambda: fields(load_study("list.toml", **RANGE), "pitch.count", "pitch.values_um"),
        (7, None),
    ),
    "a range replaces a list of overrides": (
        lambda: fields(
            load_study("list.toml", quick=True, **RANGE), "pitch.count", "pitch.values_um"
        ),
        (7, None),
    ),
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
    call: Callable, expected, here: Path
) -> None:
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
    statistics = {"mean_delta_e": delta_e}
    fit = fit_curve(pitch_um, delta_e)
    return Curve("none", 0.35, pitch_um, np.ones(pitch_um.size), statistics, fit)


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


def test_fit_beside_a_steep_flank() -> None:
    """The phone's lens in the light of a lamp: the fit is least among the sizes that look alike,
    which its interval contains. Beside a lower corner, the fit swings below all sizes tried, and
    that is said.
    """
    pitch_um = np.array([0.4715, 0.7729, 1.267, 2.0771, 3.4049, 5.5818, 9.1502, 15.0])
    phone = np.array([8.031, 0.957, 0.775, 0.751, 0.750, 0.771, 0.826, 0.958])
    steep = curve_through(pitch_um, phone, 5e-4)
    assert steep.no_difference_um == (1.267, 5.5818)
    low_um, high_um = steep.optimum.interval_um
    assert 0.7729 < low_um < 2.0771 < 3.4049 < high_um < 5.5818
    corner = curve_through(pitch_um, np.array([1.87, 0.80, *phone[2:]]), 5e-4)
    assert [curve.fit_swings for curve in (steep, corner)] == [False, True]
    assert "unknown beside the steep flank" in optimum_line(corner)


# --- dry run and cost


@pytest.mark.parametrize("line", ["run csf", "study chen2000", "run siemens_star"])
def test_dry_run_of_a_chart_renders_and_writes_nothing(
    line: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Renderer, "run", lambda *_, **__: pytest.fail("rendered"))
    _, out, err = command(f"{line} --dry-run --json")
    assert json.loads(out)["estimate"]["seconds"] > 1, err
    assert not list(here.iterdir())


def test_dry_run_of_paths_traces_a_small_part(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An eighth of the picture across, five times; with .0001 ΔE asked, it says what is missing."""
    sizes: list[tuple[int, int]] = []
    run = Renderer.run

    def counted(renderer: Renderer, *arguments: Any) -> Any:
        sizes.append(renderer.size)
        return run(renderer, *arguments)

    monkeypatch.setattr(Renderer, "run", counted)
    _, out, _ = command(
        "run cornell_box --resolution 512 --tolerance-delta-e 0.0001 --dry-run --json"
    )
    assert sizes == [(64, 64)] * 5
    assert json.loads(out)["errors"]["rays_over_limit"] > 10
    assert not list(here.iterdir())


def test_dry_run_leaves_out_the_scene_without_its_target(here: Path) -> None:
    line = "run macbeth --resolution 128 --metrics detectability,delta_e --dry-run --json"
    _, out, err = command(f"{line} --metric.detectability.without flat")
    assert json.loads(out)["errors"]["rays_over_limit"] > 0, err


def test_dry_run_counts_what_the_study_does(tmp_path: Path) -> None:
    """Two sensors of each size are shown on two further displays."""
    small = {"resolution": 48, "window_mm": 0.2, "pitch": {"count": 5}, "refine": False}
    study = load_study("pixel-size", sheet_toml(tmp_path), quick=True, **small)
    outline = study_outline(prepare(study))
    (sensor,) = outline["sensors"]
    result = pixsim.study(study, tmp_path / "out", jobs=1)
    assert result.curves[0].pitch_um.tolist() == sensor["pitch_um"]
    assert result.irradiance.shape == tuple(outline["film"]["samples"])
    dots = [int(row["dots"]) for row in rows(tmp_path / "out")]
    assert (outline["estimate"]["renders"], outline["estimate"]["evaluations"]) == (1, len(dots))
    assert dots.count(outline["display"]["dots"]) == 5 * sensor["sensors"] == len(dots) - 5 * 2 * 2


# --- rules across fields

OLD_RUN = Path(__file__).parents[1] / "data/release_1_0_0/run"
GREY = (np.full((8, 8), 0.5),) * 2
F_NUMBERS = {"name": "lens", "set": "camera.f_number", "values": [2, 3, 4, 5, 6]}
ALONE = {"name": "d", "range_of": "dsnu", "alone": True}


def metric(value=1.0, name: str = "mine", **marks) -> Callable:
    def mine(score):
        return value

    mine.__name__ = name
    vars(mine).update(marks)
    return mine


def conditions(*names: str) -> pixsim.Study:
    short = {"exposure": {"max_integration_s": 0.02}}
    return tiny(condition=[{"name": name, "set": short} for name in names])


def labels(*names: str) -> None:
    values = [{"label": name, "set": {"resolution": 20 + n}} for n, name in enumerate(names)]
    cases_of(tiny(axis=[{"name": "lens", "values": values}]))


RULES: dict[str, tuple[Callable, str]] = {
    # names that a spreadsheet, a terminal or a file system would obey
    "a formula": (lambda: conditions("=1+1"), "reads as a formula"),
    "a formula as a label": (lambda: labels("@SUM(A1)"), "reads as a formula"),
    "a formula as an axis": (lambda: tiny(axis=[F_NUMBERS | {"name": "-x"}]), "formula"),
    "a formula as a technology": (lambda: prepare(tiny(technologies=["+x.toml"])), "formula"),
    "control characters": (lambda: conditions("a\x1b[2J"), "control characters"),
    "a folder above": (lambda: conditions("..", "day"), "folder"),
    "a file of pixsim": (lambda: conditions("Results.csv"), "folder"),
    "one folder": (lambda: conditions("Day", "day"), "folders"),
    "one folder of labels": (lambda: labels("a b", "a:b"), "folders"),
    # metrics of a user
    "a lambda": (
        lambda: pixsim.score_pictures(*GREY, metrics=[lambda score: 1.0]),
        "a named function",
    ),
    "a metric twice": (
        lambda: pixsim.score_pictures(*GREY, metrics=[metric(), metric()]),
        "'mine' twice",
    ),
    "an unknown metric": (
        lambda: pixsim.score_pictures(*GREY, metrics=["sharpness"]),
        "'sharpness'",
    ),
    "a name of pixsim": (
        lambda: pixsim.score_pictures(*GREY, metrics=[metric(name="pitch_um")]),
        "whose name pixsim uses",
    ),
    "a direction": (
        lambda: pixsim.score_pictures(*GREY, metrics=[metric(better="up")]),
        "mine.better",
    ),
    "NaN": (lambda: pixsim.score_pictures(*GREY, metrics=[metric(np.nan)]), "nan of mine"),
    "an array": (lambda: pixsim.score_pictures(*GREY, metrics=[metric(np.ones(2))]), "of mine"),
    "no function": (lambda: pixsim.score_pictures(*GREY, metrics=[3]), "metrics"),
    "an axis of a metric": (
        lambda: prepare(tiny(axis=[F_NUMBERS | {"name": "mean_delta_e"}])),
        "a column of every study",
    ),
    # studies
    **{
        f"a stated size with too many pixels, {name}": (
            lambda pitch=pitch: prepare(sheet_study(8.5, **pitch)),
            r"289 million pixels; allowed: at least 1\.03",
        )
        for name, pitch in (
            ("the smallest", {"min_um": 0.5}),
            ("of a list", {"values_um": (0.5, 3, 4, 5, 6)}),
        )
    },
    "a size without photodiode": (
        lambda: prepare(tiny(pitch={"values_um": [5.0, 6, 7, 8, 9]})),
        r"5\.135 µm",
    ),
    "a size of the die": (
        lambda: prepare(tiny(pitch={"values_um": [6, 7, 8, 9, 1357]})),
        r"1356\.8 µm",
    ),
    "ends of a range": (
        lambda: prepare(tiny(pitch={"values_um": None, "min_um": 20.0})),
        r"pitch\.max_um.*above 20",
    ),
    "a sheet beside a technology": (
        lambda: prepare(
            tiny(
                technologies=("0.35um", "sheet"),
                sensors={"sheet": {"pitch_um": 3.0} | NUMBERS},
                pitch={"values_um": None},
            )
        ),
        r"pitch\.min_um",
    ),
    "more problems than fit a message": (
        lambda: checked(pixsim.Study, [Layer({"name": "a"} | {f"b{n}": 1 for n in range(5000)})]),
        r"(?=(.*\n){10}).*\nand 4990 more problems$",
    ),
    "an unknown technology": (lambda: prepare(tiny(technologies=("0.3um",))), "0.3um"),
    "one technology twice": (
        lambda: prepare(tiny(technologies=("0.35um", "0.35um"))),
        "the same process",
    ),
    "numbers of another technology": (
        lambda: prepare(tiny(process={"0.25um": {"dsnu": 0.1}})),
        "technologies of the study",
    ),
    "an unknown number": (
        lambda: prepare(tiny(process={"0.35um": {"dsn": 0.1}})),
        "Did you mean 'dsnu'",
    ),
    "swing and reset": (
        lambda: prepare(tiny(process={"0.35um": {"voltage_swing_v": 9.0}})),
        "reset_voltage_v",
    ),
    "no photodiode": (
        lambda: prepare(tiny(process={"0.35um": {"fill_factor_zero_pitch_features": 16.0}})),
        "pitch_um",
    ),
    "too few evaluations": (
        lambda: prepare(tiny(target_ci_um=0.01, max_evaluations=11)),
        "at least 12",
    ),
    "numbers of a sheet": (
        lambda: prepare(
            tiny(
                technologies=("none",),
                pixel=NUMBERS | {"data_sheet_pitch_um": 3},
                process={"none": {"dsnu": 0.1}},
            )
        ),
        r"process\.none",
    ),
    "a pitch for a study": (
        lambda: load_study("chen2000", pixel={"pitch_um": 3.0}),
        r"pixel\.pitch_um.*for a study",
    ),
    "options beside a Study": (
        lambda: pixsim.study(tiny(), "out", pixel={"bits": 8}),
        "with a Study",
    ),
    "a low stack": (
        lambda: prepare(tiny(pixel={"stack": STACK})),
        r"under microlenses; allowed: at most 8\.86",
    ),
    "a stack without height": (
        lambda: prepare(tiny(pixel={"stack": {"microlens": "square"}})),
        "height_um",
    ),
    "very many values": (
        lambda: tiny(axis=[F_NUMBERS | {"values": [2 + n / 1000 for n in range(5000)]}]),
        "1000 items",
    ),
    "a range of no number": (
        lambda: prepare(tiny(axis=[ALONE | {"range_of": "dark_current"}])),
        "range_of.*Did you mean 'dark_current_na",
    ),
    "a range and values": (lambda: tiny(axis=[ALONE | {"values": [1]}]), "range_of and values"),
    "a range and settings": (
        lambda: tiny(axis=[ALONE | {"set": "pixel.dsnu"}]),
        "range_of and set",
    ),
    "a range with others": (
        lambda: tiny(axis=[ALONE | {"alone": False}]),
        "range_of without alone",
    ),
    # runs
    "no sensors": (lambda: pixsim.run("csf", repeats=0), "repeats: got 0"),
    "too many sensors": (lambda: pixsim.run("csf", repeats=10_001), "repeats: got 10001"),
    "too many frames": (lambda: pixsim.run("csf", frames=1000), "frames: got 1000"),
    "bits of a picture": (
        lambda: check_raw(
            Run.model_validate({"exposure": {"frames": 64}, "pixel": {"bits": 12}}), [".png"]
        ),
        "--raw",
    ),
    "settings of the scene beside its kept light": (
        lambda: pixsim.run(OLD_RUN / "irradiance.exr", config=OLD_RUN / "settings.toml"),
        r"^--resolution \(resolution\), --window",
    ),
    # sensor types
    "both kinds of types": (lambda: uncertainty_request(8, 8, (), {}), "one of the two"),
    "a size without types": (lambda: uncertainty_request(None, None, (6.0,), {}), "smaller"),
    "too few types": (lambda: UncertaintyRequest(4), "8 to 65536"),
    "nothing unknown": (lambda: sample_types([], 16), "unknowns: got none"),
    "too many axis values": (
        lambda: check_axes(tiny(axis=[F_NUMBERS | {"values": [2, 3, 4, 5, 6, 7]}])),
        "at most 5 values",
    ),
    "two axes": (
        lambda: check_axes(
            tiny(axis=[F_NUMBERS, {"name": "b", "set": "pixel.prnu", "values": [0]}])
        ),
        "at most one axis",
    ),
    "an axis alone": (lambda: check_axes(tiny(axis=[F_NUMBERS | {"alone": True}])), "one axis"),
    "a logarithm of no positive number": (
        lambda: Unknown("dsnu", -1.0, Spread(sd=1, distribution="lognormal")),
        "dsnu.*lognormal",
    ),
    "a spread out of bounds": (
        lambda: Unknown("dsnu", 0.1, Spread(sd=1), allowed=(0.2, np.inf)),
        "46 % are within",
    ),
    "an unknown uncertain number": (
        lambda: unknowns_of_sheet(pixsim.Pixel(pitch_um=3.0, **NUMBERS), {"dsnu": Spread(sd=1)}),
        "no such number",
    ),
    "a number outside its range": (
        lambda: unknowns_of_study(
            tiny(pixel={"read_noise_e": 3.0}), {"": {"read_noise_e": Spread(range=(15, 25))}}
        ),
        "a range that contains 3",
    ),
    "an empty range of sizes": (
        lambda: few_pitches_um(3.0, (2.0, 4.0), (4.0, 2.0)),
        "0 < low < high",
    ),
    "a range of one size": (
        lambda: few_pitches_um(3.0, (2.0, 4.0), (3.0, 3.00001)),
        "5 different pitches",
    ),
}


@pytest.mark.parametrize(("call", "words"), RULES.values(), ids=RULES)
def test_a_rule_across_fields_is_refused(call: Callable, words: str) -> None:
    with pytest.raises(ValueError, match=f"(?s){words}"):
        call()


@pytest.mark.parametrize("name", ["types.csv", "types_information.csv", "results.csv"])
def test_rows_of_another_program_are_refused_before_anything_is_rendered(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text("mine")
    study = tiny(metrics=["delta_e", "information"])
    with pytest.raises(pixsim.PixsimError, match=rf"results: got '.*{name}', not written by"):
        pixsim.study(study, tmp_path, jobs=1, uncertainty=8)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "mine")]


def test_usual_names_are_allowed() -> None:
    names = ("night", "Ä 1", "0.35um", "a-b", "day 2")
    assert [case.condition for case in cases_of(conditions(*names))] == list(names)


# --- options of studies, comparisons and sweeps

LIGHT = pixsim.SpectralImage(
    [450.0, 550.0, 620.0],
    30.0,
    10.0,
    data=1e-3 * (1 + np.random.default_rng(1).random((40, 40, 3))).astype(np.float32),
    header={"diffraction": False, "luminance_cd_per_m2": 3000.0},
)
# Arguments of `study`, each with another value than its default; beside the fields of its settings.
ARGUMENTS = {
    "config": "sensor.toml", "parameters": {"luminance_cd_per_m2": 5.0}, "pixel": {"bits": 8}, "scene": "csf", "quick": True,
    "jobs": 1, "scheduler": "tcp://localhost:8786", "variant": "scalar_spectral", "progress": lambda _: lambda _: None,
    "agreed": True, "uncertainty": 8, "sobol": 8, "smaller_than_um": (3.0,), "metrics": ("delta_e", "acutance"), "light": LIGHT,
    "without": LIGHT,
}  # fmt: skip
NO_NUMBERS = {
    "jobs",
    "scheduler",
    "progress",
    "agreed",
    "variant",
}  # they decide how and where, and change no number
VALUES = {name: value for name, (value, _) in CHANGES.items()} | ARGUMENTS
# In light that is given, axes and conditions vary the sensor and what follows it.
SWEEP_VALUES = {
    "axis": ({"name": "time", "set": "exposure.integration_s", "values": (1e-4, 1e-3)},),
    "condition": ({"name": "dusk", "set": {"exposure": {"integration_s": 1e-4}}},),
}
REFUSED = {
    "compare": {"smaller_than_um", "paper", "light", "without"},
    # A sweep has light that is given: it refuses what `study(…, light=…)` refuses.
    "sweep": {
        "smaller_than_um",
        "paper",
        "noise_budget",
        "scene",
        "parameters",
        "variant",
        "window_mm",
        "tolerance_delta_e",
    },
}
SUBJECTS, FOLDER = {"plan", "settings"}, {"out"}  # of `study`: what it varies, and where it writes


def test_values_are_those_of_all_arguments_and_settings() -> None:
    assert (
        VALUES.keys()
        == (inspect.signature(pixsim.study).parameters.keys() - SUBJECTS - FOLDER)
        | pixsim.Study.model_fields.keys()
    )


def test_options_of_the_command_line_are_those_of_a_study() -> None:
    """All of `pixsim study` are options of `pixsim compare`."""
    study, compare = (
        {
            name
            for argument in app[command].assemble_argument_collection()
            for name in argument.names
        }
        for command in ("study", "compare")
    )
    assert study <= compare


def made_by_compare(options: dict) -> object:
    """What a comparison would make: its cases."""
    small = {"scene": "flat", "resolution": 48, "display": {"dots": 48}}
    job = pixsim.compare(["a.toml", "b.toml"], **small | options)
    cases = [
        (case.settings, case.camera, case.imaging, case.sizes, case.labels, case.header)
        for case in job.cases
    ]
    return repr((cases, job.types, job.study and (job.study.name, job.study.detail)))


def made_by_sweep(options: dict) -> object:
    """What a sweep makes: its rows."""
    pixels = {
        "a": pixsim.Pixel(pitch_um=10.0),
        "b": pixsim.Pixel(technology="4t-bsi", pitch_um=10.0),
    }
    return repr(list(pixsim.sweep(LIGHT, pixels, **{"display": {"dots": 24}} | options)))


MADE = {"compare": made_by_compare, "sweep": made_by_sweep}
# Settings that have an effect only beside others.
BESIDE: dict[str, dict] = {
    "without": {"metrics": ("delta_e", "detectability")},
    "metric": {"metrics": ("delta_e", "information")},
}


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A folder with two sensors of uncertain read noise; comparisons only prepare."""
    folder = tmp_path_factory.mktemp("desk")
    sheet(folder / "a.toml", more="[pixel.uncertainty]\nread_noise_e = { sd = 0.5 }\n")
    sheet(folder / "b.toml", 12.0)
    (folder / "sensor.toml").write_text("[exposure]\nwell_target = 0.5\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(compare_module, "run_prepared", lambda job, **_: job)
        patch.setattr(sweep_module, "workers_for", lambda *_: nullcontext(Workers()))
        yield


SLOW = [("compare", "lens"), ("sweep", "lens"), ("sweep", "sobol")]


@cache
def made_without(form: str, name: str) -> object:
    # Without the light and its metric, there is no detectability.
    return MADE[form](BESIDE.get(name, {}) if name != "without" else {})


@pytest.mark.usefixtures("desk")
@pytest.mark.parametrize(
    ("form", "name"),
    # The light is the first argument of a sweep. A lens and many frames take seconds; the other
    # settings have the claim.
    [
        pytest.param(*pair, marks=[pytest.mark.slow] if pair in SLOW else [])
        for pair in product(MADE, VALUES)
        if pair != ("sweep", "light")
    ],
)
def test_option_of_a_study_acts_is_named_or_is_refused(form: str, name: str) -> None:
    options = {name: (VALUES | SWEEP_VALUES if form == "sweep" else VALUES)[name]}
    if name in REFUSED[form]:
        with pytest.raises(pixsim.PixsimError, match=rf"^{name}: got a value .*; allowed: "):
            MADE[form](options)
        return

    before = made_without(form, name if name in BESIDE else "")
    with warnings.catch_warnings(record=True, action="always") as caught:
        after = MADE[form](BESIDE.get(name, {}) | options)
    texts = [str(warning.message) for warning in caught]
    is_named = any("nothing here" in text and name in text for text in texts)
    if name in NO_NUMBERS:
        assert (before == after, is_named) == (True, False)
    else:
        assert before != after or is_named, texts
        assert form == "compare" or before == after or not is_named, "a row differs nevertheless"


def test_refusals_stand_in_one_table() -> None:
    """Those of a sweep that are not in it are those of every study whose light is given."""
    of_scenes = {"scene", "parameters", "variant", "window_mm", "tolerance_delta_e"}
    assert REFUSED["compare"] | REFUSED["sweep"] - of_scenes == SUPPORTED_BY.keys()
