"""Rules across settings, and files that are refused: each before anything is rendered, with the
name of the argument and the cause.

Single fields out of range or of another type: tests/test_refusals.py.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.sheets import sheet
from helpers.tiny import tiny
from pydantic import ValidationError

import pixsim
from pixsim.studies.design import cases_of, check_number
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Axis, axes_of

LUMINANCE = "scene.parameters.luminance_cd_per_m2"
LENS = {"name": "lens", "set": "camera.f_number", "values": [2.8, 8.0]}
PRNU = {"name": "PRNU", "set": "pixel.prnu", "values": [0.01, 0.03], "alone": True}
DAY = {"name": "day", "set": {"scene": {"parameters": {"luminance_cd_per_m2": 300.0}}}}
LABELS = {"name": "a", "values": [{"label": "b", "set": {"resolution": n}} for n in (20, 30)]}
COLOUR = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
NM = [450.0, 550.0, 620.0]
LIGHT = pixsim.SpectralImage(NM, 30.0, 2700 / 64, data=np.full((64, 64, 3), 1e-3, np.float32))


def axis(**over):
    table = {"name": "a", "set": "camera.f_number"} | over
    return Axis.model_validate({name: value for name, value in table.items() if value is not None})


def condition(table: dict) -> list[dict]:
    return [{"name": "x", "set": table}]


def value(setting: str, setting_value):
    return cases_of(tiny(axis=[{"name": "a", "set": setting, "values": [setting_value]}]))


given = partial(pixsim.study, "tiny.toml", "out", light=LIGHT)
sweep = partial(pixsim.sweep, LIGHT, camera=pixsim.Camera(die_mm=2.7), display=pixsim.Display())


def compare(*files: str, **options):
    return pixsim.compare(files, progress=pytest.fail, **options)


def compare_in(table: dict):
    settings = {"name": "x", "condition": condition(table)}
    return compare("a.toml", "b.toml", study=pixsim.Study.model_validate(settings))


MANY = [
    {"name": name, "set": f"pixel.{name}", "from": 0.0, "to": 0.1, "count": 101}
    for name in ("prnu", "dsnu")
]
SMALL_SIZES = {"pitch": {"values_um": [4.0, 5.0, 7.0, 8.0, 9.0]}}
LARGE_DIE = {"camera": {"die_mm": 60.0, "focal_length_mm": 90.0}}
STACK = {"stack": {"height_um": 5.0, "index": 1.5, "shift_um": [5.5, 0.0]}}
TECHNOLOGY = {"name": "t", "set": "pixel.technology", "values": ["0.5um"]}
TARGET = {"metrics": ["detectability"]}
SEARCH = {"solve_for": "lux", "without": "light.exr"}

REFUSALS: dict[str, tuple[Callable, tuple[str, ...]]] = {
    # An axis
    "axis without values": (axis, ("missing: from", "values")),
    "axis with an empty list": (partial(axis, values=[]), ("empty list",)),
    "axis with a value twice": (partial(axis, values=[2, 2]), ("2 occurs twice",)),
    "axis with two labels alike": (partial(axis, set=None, **LABELS), ("b occurs twice",)),
    "axis with values and an end": (partial(axis, values=[2], to=3.0), ("values and to",)),
    "axis with values and a spacing": (
        partial(axis, values=[2], spacing="log"),
        ("values and spacing",),
    ),
    "axis of ratios from 0": (
        partial(axis, count=3, spacing="log", **{"from": 0.0, "to": 3.0}),
        ("above 0",),
    ),
    "axis with an empty text": (partial(axis, values=[""]), ("a number, a name",)),
    "axis with a name that is a formula": (partial(axis, values=["=1"]), ("begins with =",)),
    "axis of a setting with =": (partial(axis, set="camera.f=1", values=[2]), ("dotted",)),
    "axis of steps that are too small": (
        partial(axis, count=900, **{"from": 2.0, "to": 2.1}),
        ("occurs twice",),
    ),
    "axis of pixel sizes": (partial(axis, set="pitch.min_um", values=[2]), ("pixel sizes",)),
    "axis of technologies": (partial(axis, set="technologies", values=["a"]), ("technology",)),
    "axis without a setting": (partial(axis, set=None, values=[2, 3]), ("set: missing",)),
    "axis of a setting that is not dotted": (
        partial(axis, set="camera..f", values=[2]),
        ("dotted",),
    ),
    "axis with labels and a setting": (partial(axis, values=LABELS["values"]), ("set",)),
    "axis of a column's name": (partial(axis, name="pitch_um", values=[2]), ("column",)),
    "axis with = in its name": (partial(axis, name="a=b", values=[2]), ("a name without =",)),
    "axis that sets nothing": (
        partial(axis, set=None, values=[{"label": "b", "set": {"pixel": {"prnu": None}}}]),
        ("pixel.prnu = None",),
    ),
    "axis of a process without quotes": (
        partial(axis, set="process.0.35um.prnu", values=[0.1]),
        ("process.'0.35um'.prnu",),
    ),
    # A study with axes and conditions
    "two axes alike": (partial(tiny, axis=[LENS, LENS]), ("'lens' occurs twice",)),
    "two axes of one setting": (
        partial(tiny, axis=[LENS, LENS | {"name": "N"}]),
        ("camera.f_number", "'lens'", "'N'"),
    ),
    "an axis and a condition of one setting": (
        partial(tiny, axis=[{"name": "light", "set": LUMINANCE, "values": [3]}], condition=[DAY]),
        ("condition 'day'", "'light'"),
    ),
    "a single axis and a condition of one setting": (
        partial(tiny, axis=[PRNU], condition=condition({"pixel": {"prnu_percent": 1.0}})),
        ("pixel.prnu_percent", "'PRNU'"),
    ),
    "the paper's statements on another scene": (
        partial(tiny, paper=True, scene={"file": "flat"}),
        ("scene.file = 'csf'", "'0.35um'"),
    ),
    "conditions without weight": (
        partial(tiny, condition=[DAY | {"weight": 0.0}]),
        ("all weights are 0",),
    ),
    "two conditions alike": (partial(tiny, condition=[DAY, DAY]), ("'day' occurs twice",)),
    "a condition of another technology": (
        partial(tiny, condition=condition({"pixel": {"technology": "0.5um"}})),
        ("cannot be changed by a condition",),
    ),
    "technologies beside their axis": (
        partial(tiny, technologies=["0.35um"], axis=[TECHNOLOGY]),
        ("leave technologies out",),
    ),
    "technologies beside their axis of tables": (
        partial(
            tiny,
            technologies=["0.35um"],
            axis=[
                {
                    "name": "t",
                    "values": [{"label": "b", "set": {"pixel": {"technology": "4t-bsi"}}}],
                }
            ],
        ),
        ("leave technologies out",),
    ),
    "an axis of a setting of the whole study": (
        partial(tiny, axis=[{"name": "a", "set": "seed", "values": [2]}]),
        ("seed cannot be changed by an axis",),
    ),
    "values of a setting of the whole study": (
        partial(tiny, axis=[{"name": "a", "values": [{"label": "b", "set": {"repeats": 2}}]}]),
        ("repeats cannot be changed by an axis",),
    ),
    "a condition of a setting of the whole study": (
        partial(tiny, condition=condition({"pitch": {"min_um": 2}})),
        ("pitch.min_um cannot be changed",),
    ),
    # Cases
    "a value of an unknown setting": (
        partial(value, "camera.f_nmber", 2.0),
        ("axis a, value 2", "f_number"),
    ),
    "a value out of range": (
        partial(value, "camera.f_number", -2.0),
        ("axis a, value -2: camera.f_number",),
    ),
    "a value of a field elsewhere": (partial(value, "f_number", 2.0), ("[camera]",)),
    "a value in place of a table": (partial(value, "camera", 2.0), ("camera: got 2.0",)),
    "very many cases": (lambda: cases_of(tiny(axis=MANY)), ("10201 cases", "10000")),
    "very many evaluations": (
        partial(check_number, 2, 100_001, agreed=False),
        ("100001 evaluations in 2 cases", "--yes"),
    ),
    "a size that no case can have": (lambda: prepare(tiny(**SMALL_SIZES)), ("pixel.pitch_um",)),
    "very many pixels of the smaller of two": (
        lambda: prepare(pixsim.Study(name="x", technologies=["4t-bsi", "0.35um"], **LARGE_DIE)),
        ("pitch.min_fill_factor", "--window"),
    ),
    "a shift beyond the pixel": (lambda: prepare(tiny(pixel=STACK)), ("half of pitch_um",)),
    "an axis of the name of a result": (
        lambda: prepare(tiny(axis=[PRNU | {"name": "fill_factor"}])),
        ("name = 'fill_factor'",),
    ),
    "an unknown metric": (lambda: prepare(tiny(metrics=["nothing"])), ("metrics", "'nothing'")),
    "a target without its scene": (
        lambda: prepare(tiny(**TARGET)),
        ("'detectability'", "without its target"),
    ),
    "a scene without the target that is not there": (
        lambda: prepare(tiny(metric={"detectability": {"without": "none.xml"}}, **TARGET)),
        ("without", "none.xml"),
    ),
    "a search from a text": (
        lambda: pixsim.run(
            "target",
            parameters={"size_um": 200.0},
            metric={"detectability": {"solve_for": "shape"}},
            **TARGET,
        ),
        ("'shape'", "disc"),
    ),
    "a search from no value": (
        lambda: pixsim.run(
            "target",
            parameters={"size_um": 200.0},
            metric={"detectability": {"solve_for": "lux"}},
            **TARGET,
        ),
        ("'lux'", "no value"),
    ),
    # Axes of the command line
    "an axis without =": (partial(axes_of, ["light"], []), ("NAME=v1,v2",)),
    "an axis twice": (partial(axes_of, ["a=1", "a=2"], []), ("'a' twice",)),
    "a comma too many": (partial(axes_of, ["a=1,,2"], []), ("on both sides",)),
    "a count with a fraction": (partial(axes_of, ["a=1:2:2.5"], []), ("numbers in",)),
    "an unknown spacing": (partial(axes_of, ["a=1:2:3:cubic"], []), ("log or linear",)),
    "a range of labels": (partial(axes_of, ["a=1:2:3"], [LABELS]), ("labels",)),
    "a label that is not there": (partial(axes_of, ["a=c"], [LABELS]), ("got c", "b")),
    "axes of a file that are no list": (partial(axes_of, ["a=1"], {"name": "a"}), ("a list",)),
    # Light that is given
    "a scene beside light": (partial(given, scene="csf"), ("scene", "light")),
    "light without the target alone": (
        lambda: pixsim.study("tiny.toml", "out", without=LIGHT),
        ("without", "light as well"),
    ),
    "a search in light": (
        lambda: pixsim.run("light.exr", metric={"detectability": SEARCH}, **TARGET),
        ("solve_for", "a parameter of a scene"),
    ),
    "parameters beside light": (partial(given, parameters={"resolution": 64}), ("parameters",)),
    "an axis of the lens beside light": (partial(given, axis=[LENS]), ("camera.f_number",)),
    "a condition of the scene beside light": (
        partial(given, condition=condition({"scene": {"file": "csf"}})),
        ("scene.file", "light is given"),
    ),
    "a window beside light": (partial(given, window_mm=1.0), ("window_mm", "light is given")),
    "a tolerance beside light": (partial(given, tolerance_delta_e=0.1), ("tolerance_delta_e",)),
    "a variant beside light": (partial(given, variant="scalar_spectral"), ("variant",)),
    "another die than that of the light": (partial(given, camera={"die_mm": 5.0}), ("pitch of",)),
    "a target in light without its background": (
        partial(given, **TARGET),
        ("'detectability'", "without its target"),
    ),
    "a metric without a best size alone": (
        partial(given, metrics=["contrast_detection_probability", "delta_e"]),
        ("first, which has no best pixel size", "as delta_e"),
    ),
    "ground resolution without a distance": (
        partial(given, metrics=["niirs"]),
        ("'niirs'", "object_distance_m"),
    ),
    "a picture in place of a scene": (
        lambda: pixsim.study("tiny.toml", "out", scene="mine.exr"),
        ("'mine.exr'", "read_irradiance"),
    ),
    # Many sensors in one light
    "no sensor": (partial(sweep, []), ("pixels", "none")),
    "a name that is a formula": (
        lambda: pixsim.sweep(LIGHT, {"=1+1": pixsim.Pixel()}),
        ("pixels", "begins with ="),
    ),
    "a name in place of a pixel": (partial(sweep, ["imx477"]), ("pixels[0]", "a Pixel")),
    "a pixel larger than the die": (
        partial(sweep, [pixsim.Pixel(), pixsim.Pixel(pitch_um=2e3)]),
        ("pixel 1",),
    ),
    "acutance in colour": (
        partial(sweep, [pixsim.Pixel(), pixsim.Pixel(colour=COLOUR)], metrics=["acutance"]),
        ("pixel 1", "'acutance'"),
    ),
    "monochrome and colour in a coloured light": (
        lambda: pixsim.sweep(
            LIGHT.with_planes(LIGHT.planes * np.linspace(1, 2, 3)[:, None, None]),
            [pixsim.Pixel(pitch_um=60.0), pixsim.Pixel(pitch_um=60.0, colour=COLOUR)],
            camera=pixsim.Camera(die_mm=2.7),
            display=pixsim.Display(dots=32),
        ),
        ("one ideal image for all",),
    ),
    # Sensors that are compared
    "one sensor": (partial(compare, "a.toml"), ("sensors", "2 to 8")),
    "nine sensors": (partial(compare, *["a.toml"] * 9), ("sensors", "2 to 8")),
    "a sensor twice": (partial(compare, "a.toml", "./a.toml"), ("'./a.toml' twice",)),
    "a sensor that is not there": (partial(compare, "a.toml", "none.toml"), ("none.toml",)),
    "a technology with a slip": (partial(compare, "a.toml", "0.36um"), ("'0.35um'",)),
    "a folder": (partial(compare, "a.toml", "."), ("sensor", "'.'", "a TOML file")),
    "a file without a pixel": (partial(compare, "a.toml", "scene.toml"), ("no table [pixel]",)),
    "a file with a slip": (partial(compare, "a.toml", "slip.toml"), ("slip.toml", "full_well_e")),
    "a picture for sensors of several lenses": (
        partial(compare, "a.toml", "b.toml", scene="picture.exr"),
        ("--scene", "picture.exr"),
    ),
    "a display of pixels": (
        partial(compare, "a.toml", "b.toml", display={"raster": "one_to_one"}),
        ("display.raster", "fixed_size"),
    ),
    "a window wider than the die": (
        partial(compare, "a.toml", "b.toml", window_mm=50.0),
        ("window_mm", "at most"),
    ),
    "a window of a pixel": (partial(compare, "a.toml", "b.toml", window_mm=0.02), ("a: pixel",)),
    "a die of too few pixels": (
        partial(compare, "a.toml", "small.toml", match="lens"),
        ("pixel.pitch_um", "at most"),
    ),
    "a lens without a real image": (
        partial(compare, "a.toml", "b.toml", camera={"focal_length_mm": 2000.0}),
        ("focal_length_mm", "no real image"),
    ),
    "a chart too coarse for its parts": (
        partial(compare, "a.toml", "b.toml", parameters={"max_lp_per_mm": 0.1}),
        ("max_lp_per_mm", "at least"),
    ),
    "a study with a slip": (
        partial(compare, "a.toml", "b.toml", study="pixel-siz"),
        ("study", "'pixel-size'"),
    ),
    "a study that is no file": (partial(compare, "a.toml", "b.toml", study="."), ("study", "'.'")),
    "a condition of the die": (partial(compare_in, {"camera": {"die_mm": 2}}), ("condition x",)),
    "a condition of a process": (
        partial(compare_in, {"process": {"0.35um": {"prnu": 0}}}),
        ("condition x", "set.process"),
    ),
    "a condition of the pixel size": (
        partial(compare_in, {"pixel": {"pitch_um": 3.0}}),
        ("condition x", "set.pixel.pitch_um"),
    ),
    "a condition of another field of the scene": (
        partial(compare_in, {"scene": {"xml": 1}}),
        ("condition x", "allowed: file, parameters"),
    ),
    "a pair of one frame": (
        partial(compare, "a.toml", "b.toml", repeats=1),
        ("repeats", "2 to 10000"),
    ),
    "a condition of no scene": (
        partial(compare_in, {"scene": 3}),
        ("condition x", "a table of file"),
    ),
    "a condition of an unknown parameter": (
        partial(compare_in, {"scene": {"parameters": {"lumi": 1}}}),
        ("condition x", "lumi"),
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("refused")
    (path / "tiny.toml").write_text('name = "s"\npitch.values_um = [20, 28, 40, 56, 80]\n')
    sheet(path / "a.toml")
    sheet(path / "b.toml")
    pixsim.write_exr(path / "light.exr", LIGHT)
    sheet(path / "small.toml", pitch_um=0.5, pixels="[30, 30]")
    (path / "scene.toml").write_text("[scene]\nspp = 4\n")
    (path / "slip.toml").write_text("[pixel]\nfull_wel_e = 4\n")
    return path


@pytest.mark.parametrize("name", REFUSALS)
def test_refused_with_the_argument_and_the_cause(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call, words = REFUSALS[name]
    monkeypatch.chdir(folder)
    monkeypatch.setattr("pixsim.scene.renderer.Renderer.image", lambda *_: pytest.fail("a render"))
    with pytest.raises((pixsim.PixsimError, ValidationError)) as error:
        call()
    assert not [text for text in words if text not in str(error.value)], str(error.value)
