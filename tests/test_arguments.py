"""Every public function, class and method against arguments that make no sense, generated from the
signatures.

A call raises PixsimError that names the argument, or returns a result without NaN. A value of
another kind than the annotation's must raise.
"""

import inspect
import math
import re
import warnings
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache, partial
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, Union

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.hostile import TooLongError, in_time
from helpers.public_names import PUBLIC
from numpy.typing import ArrayLike
from pydantic import BaseModel
from typing_extensions import TypeAliasType

import pixsim
from pixsim.base import door
from pixsim.base.arrays import Finites
from pixsim.base.bounds import without_bounds
from pixsim.base.result import Result
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.sensor.reading import Readout

# of a call; the slowest takes 0.1 s, the import of Dask 1 s, on a loaded machine many times that
LIMIT_S = 20.0
NM = np.array([450.0, 550.0, 650.0])
JUNK = {
    "None": None, "empty text": "", "text": "x", "-1": -1, "0": 0, "nan": math.nan, "inf": math.inf, "10**30": 10**30,
    "1e-320": 1e-320, "[]": [], "{}": {}, "object()": object(), "a type": int, "missing path": Path("/proc/no/file"),
    "folder": Path("/proc"), "10**400": 10**400, "ragged": [[1.0], [1.0, 2.0], [3.0]],
}  # fmt: skip


CAMERA, PIXEL, DISPLAY, EXPOSURE = (
    pixsim.Camera(),
    pixsim.Pixel(pitch_um=100.0),
    pixsim.Display(dots=8),
    pixsim.Exposure(),
)
LIGHT = pixsim.SpectralImage(
    NM, 10.0, 2713.6 / 8, data=np.full((8, 8, 3), 1e-3), header={"luminance_cd_per_m2": 100.0}
)
PHYSICS = pixsim.derive(PIXEL)
READOUT = Readout.of(PHYSICS)
TECHNOLOGY = pixsim.load_technology("0.35um")
SENSOR = pixsim.make_sensor(PIXEL, CAMERA)
FRAME = pixsim.capture(LIGHT, CAMERA, SENSOR, rng=np.random.default_rng(0))
STUDY = pixsim.Study.model_validate(
    {"name": "x", "repeats": 2, "resolution": 32, "scene": {"file": "csf", "parameters": {"spp": 4}},
     "pitch": {"values_um": [20.0, 30.0, 40.0, 60.0, 90.0]}, "display": {"dots": 8}}
)  # fmt: skip
XYZ = np.full((4, 4, 3), 50.0)
PLANE = np.ones((4, 4))
RATIO_ROUNDING = 1 / (1 + np.exp(30 - np.arange(64) + np.arange(64)[:, None] * 0.1))
EDGES = np.linspace(0.0, 2713.6, 9)


scene = cache(lambda: pixsim.load_scene("flat", resolution=8, spp=4, variant="scalar_spectral"))
plan = cache(lambda: pixsim.make_plan(scene()))
score = cache(lambda: pixsim.evaluate(LIGHT, CAMERA, PIXEL, display=DISPLAY))
sensor_table = cache(lambda: pixsim.sweep(LIGHT, [PIXEL], camera=CAMERA, display=DISPLAY))
edge = cache(lambda: pixsim.edge_response(RATIO_ROUNDING))
# Valid arguments by name; of some functions, by name and argument.
GOOD = {
    "names": ("shot",),
    "message": "x", "path": "a.exr", "name": "0.35um", "wavelength_nm": NM, "band_width_nm": 10.0,
    "pitch_um": 100.0, "data": np.ones((2, 2, 3)), "irradiance": LIGHT, "image": LIGHT, "camera": CAMERA, "pixel": PIXEL,
    "exposure": EXPOSURE, "display": DISPLAY, "sensor": SENSOR, "rng": np.random.default_rng(0), "physics": PHYSICS,
    "readout": READOUT, "imaging": imaging(CAMERA, PIXEL, EXPOSURE, DISPLAY),
    "technology": TECHNOLOGY, "frame": FRAME, "kind": "flat", "texels": np.ones((2, 2), np.float32), "scene": scene,
    "reference_xyz": XYZ, "test_xyz": XYZ, "white_xyz": [95.0, 100.0, 108.0], "samples_per_deg": 23.0, "xyz": XYZ,
    "reference_lab": XYZ, "lab_reference": XYZ, "lab_test": XYZ, "luminance": PLANE, "picture": PLANE.copy,
    "weight": np.ones(3),
    "f_number": 4.0, "tan_field": 0.1, "shape": (4, 4), "image_distance_mm": 4.0, "magnification": 0.1, "side_um": 5.0,
    "frequency_cy_per_mm": np.array([1.0, 2.0, 3.0]), "pictures": lambda: [(PLANE, np.ones(3))], "photocurrent_e_per_s": 100.0,
    "integration_s": 0.01, "total_e_per_s": np.ones(3), "diode": lambda: pixsim.photodiode.diode_of(PIXEL),
    "fill_factor": 0.5, "peak_quantum_efficiency": 0.5, "reading": "silicon", "given": 0.5, "area_um2": 10.0, "study": STUDY,
    "signal_e_per_s": np.full(SENSOR.shape, 10.0), "mean_e": np.full(SENSOR.shape, 10.0), "brightest_e_per_s": 100.0,
    "dn": FRAME.dn, "saturated_fraction": 0.0, "level_dn": PLANE, "bits": 8, "size_um": (2713.6, 2713.6), "border_um": 0.0,
    "length_um": 100.0, "count": 3, "values": PLANE, "low_um": 0.0, "edges_um": (EDGES, EDGES), "degree": 1, "axis": 0,
    "interpolation": "linear", "white_e": 100.0, "relative_luminance": PLANE, "x": 0.5, "y": 0.5, "frequency_lp_per_mm": 3.0,
    "width": 4, "height": 4, "header": {}, "width_mm": 2.0, "content": "x", "make": lambda: lambda: np.ones((2, 2), np.float32),
    "highest_lp_per_mm": 33.0, "die_mm": 2.0, "index": 0, "repeat": 1, "columns": 4, "part": (slice(0, 2), slice(0, 2)),
    "response": lambda: np.ones_like,
    "signal_e": 100.0, "statistic": "mean_delta_e", "resolution": 8, "state": lambda: scene().parse(), "options": CameraOptions(),
    "photodiode_side_um": 50.0, "height_um": 80.0,
    "planes": LIGHT.data.transpose(2, 0, 1), "fov_deg": 40.0, "aperture_radius_m": 5e-4, "focus_distance_m": 1.0, "source": "x",
    "gain_db": 6.0, "frequency_cy_per_px": 0.2, "mosaic": PLANE, "pattern": "rggb", "method": "bilinear", "rgb": XYZ / 100,
    "sensitivities": lambda: pixsim.spectral.colour_matching(np.arange(400.0, 701.0, 10.0)), "illuminant": "D55",
    "file": "cooke_triplet", "field_deg": 10.0, "stop_x": 0.0, "stop_y": 0.0, "x_mm": 1.0, "y_mm": 1.0,
    "difference": PLANE, "variance": PLANE, "signal": 1.0, "noise": 1.0, "folded": 0.0, "level": 1.0, "corner_cy_per_mm": 1.0,
    "power": lambda: lambda y, x: np.exp(-np.hypot(y, x)), "mtf": np.array([1.0, 0.8, 0.5]), "noise_power": np.array(1e-3),
    "mean": 1.0, "rer": 0.4, "ground_m": 0.5, "snr": 50.0, "frequency": np.array([0.0, 1.0, 2.0]), "reflectance": 0.9,
    "frequency_cy_per_deg": np.array([0.0, 1.0, 2.0]), "angle_deg": 5.0, "white_cd_per_m2": 100.0,
    "ideal": PLANE, "light": LIGHT, "pixels": lambda: [PIXEL],
    "exposures": 2, "total_s": 0.1, "quantity": "row_noise_e", "chosen": LensOptions(), "pitches_um": [5.0, 10.0],
    "factor": 2.0, "edges_nm": np.array([400.0, 500.0, 600.0]), "height_mm": 1.0, "azimuth_deg": 30.0,
    "charge_e": 100.0, "contrast": 0.1, "deviation_a_e": 1.0, "deviation_b_e": 1.0,
    "darker": PLANE, "brighter": PLANE,
}  # fmt: skip
OWN = {
    "pixsim.score_pictures.image": PLANE,
    "pixsim.edge_response.picture": lambda: RATIO_ROUNDING, "pixsim.sfr.image": "edge.npy",
    "pixsim.photodiode.charge_from_total_e.integration_s": np.full(3, 0.1),
    "pixsim.read_frame.path": "raw.npz", "pixsim.Technology.with_numbers.values": {"prnu": 0.01},
    "pixsim.Study.options_of.technology": "0.35um", "pixsim.studies.design.pixel_of.technology": "0.35um",
    "pixsim.studies.design.physics_of.technology": "0.35um", "pixsim.studies.design.photodiode_widths_um.technology": "0.35um",
    "pixsim.studies.design.photodiode_widths_um.pitch_um": np.array([5.0, 6.0]), "pixsim.load_scene.scene": "flat",
    "pixsim.load_pixel.file": "imx477", "pixsim.pixel.absorbed_efficiency.quantum_efficiency": 0.5,
    "pixsim.pixel.absorbed_efficiency.at_nm": 525.0, "pixsim.pixel.absorbed_efficiency.depth_um": 5.0,
    "pixsim.load_scene.sensor": None, "pixsim.display.average_axis.edges_um": np.array([0.0, 100.0, 200.0]),
    "pixsim.scielab.grey_delta_e_map.reference_lab": lambda: np.zeros((4, 4, 3)),
    "pixsim.study.plan": STUDY, "pixsim.study.out": "", "pixsim.study.pixel": {}, "pixsim.study.scene": None,
    "pixsim.pixel.response_curve.reading": "silicon", "pixsim.evaluate.irradiance": LIGHT,
    "pixsim.optics.camera.Camera.from_lens_geometry.die_mm": 2.7,
    "pixsim.SpectralImage.factors": None, "pixsim.SpectralImage.pitch_um": 100.0,
    "pixsim.display.picture_size_um.irradiance": LIGHT, "pixsim.optics.stack_collection.index": 1.5,
    "pixsim.Camera.lights_like.other": CAMERA,
    "pixsim.colour_matrix.wavelength_nm": np.arange(400.0, 701.0, 10.0), "pixsim.colour_matrix.method": "least_delta_e",
    **dict.fromkeys((f"pixsim.optics.lens.Lens.{name}.wavelength_nm" for name in (
        "first_order", "field_of_height", "image_circle_mm", "fresnel_transmittance", "ray_points", "ghosts")), 550.0),
    "pixsim.optics.lens.Lens.stopped_down.f_number": 8.0,
    "pixsim.metrics.relative_edge_response.frequency_cy_per_px": np.array([0.0, 0.5, 1.0]),
    **dict.fromkeys((f"pixsim.metrics.{name}.frequency_cy_per_mm" for name in (
        "information_bits_per_mm2", "folded_spectrum")), np.linspace(-50.0, 50.0, 5)),
    **dict.fromkeys((f"pixsim.metrics.{name}.picture" for name in ("edge_mtf", "radial_spectrum")), RATIO_ROUNDING),
    "pixsim.snr_db.reading": None, "pixsim.metrics.contrast_detection_probability.mean_e": 100.0,
    "pixsim.sensor.frame_mean_dn.mean_e": 10.0, "pixsim.sensor.frame_variance_dn2.mean_e": 10.0,
}  # fmt: skip
# Optional arguments that every call has: without them it takes long, or means nothing.
ALWAYS = (
    {"pixsim.SpectralImage": ("data",)}
    | dict.fromkeys(
        (f"pixsim.charts.{chart}" for chart in ("csf", "slanted_edge", "siemens_star")),
        ("width", "height"),
    )
    | dict.fromkeys(("pixsim.evaluate", "pixsim.sweep"), ("display",))
)  # 512 dots are many
INSTANCES: dict[str, Callable] = {
    "Camera": lambda: CAMERA, "CameraOptions": CameraOptions, "Study": lambda: STUDY, "Technology": lambda: TECHNOLOGY,
    "SpectralImage": lambda: LIGHT, "PixelPhysics": lambda: PHYSICS, "Readout": lambda: READOUT,
    "EdgeResponse": edge, "Scene": scene,
    **dict.fromkeys(("Score", "FrameScore"), score), "Table": sensor_table,
    "Exposure": lambda: EXPOSURE, "Motion": lambda: pixsim.Motion(image_um_per_s=(100.0, 0.0)),
    "Plan": plan, "Frame": lambda: FRAME, "Sensor": lambda: SENSOR, "RawFrame": lambda: pixsim.read_frame,
    "Lens": cache(lambda: pixsim.load_lens("cooke_triplet")),
}  # fmt: skip
# Built by pixsim only, from parts that are not public, or called above with a whole study.
MADE_BY_FUNCTIONS = (  # not by users
    "DynamicRange", "EdgeResponse", "Frame", "FrameScore", "Optimum", "Plan", "PixelPhysics", "RawFrame", "Readout", "Score", "Sensor",
)  # fmt: skip
NOT_CALLED = {
    "pixsim.compare": "its own tests", "pixsim.studies.comparison.Comparison": "a whole comparison",
    "pixsim.study": "its own tests below", "pixsim.write_report": "its result is a whole study",
    "pixsim.lens": "its own tests below", "pixsim.measure.lens": "a whole trace",
    "pixsim.accuracy": "its own tests below", "pixsim.verification": "a whole survey",
    "pixsim.datasheet": "its own tests below", "pixsim.measure.datasheet": "a whole measurement",
    "pixsim.explore": "it opens a page", "pixsim.run": "its own tests below", "pixsim.studies.run.RunResult": "a whole run",
    "pixsim.studies.result.StudyResult": "a whole study", "pixsim.studies.curve.Curve": "of a whole study",
    "pixsim.studies.two_results.ResultsComparison": "two folders",
    "pixsim.PixsimError": "takes any text", "pixsim.studies.table.Table": "the rows of a sweep",
}  # fmt: skip
ANY_VALUE = {"object", "Any"}
SMALL_RECORDS: dict[str, dict] = {
    "DarkCurrent": {"e_per_s": 1.0, "at_c": 20.0},
    "Axis": {"name": "lens", "set": "camera.f_number", "values": (2.0, 4.0)},
    "AxisValue": {"label": "f/2", "set": {"camera": {"f_number": 2.0}}},
    "ColourOptions": {
        "transmittances": {
            letter: [[400.0 + 10 * step, 0.5] for step in range(31)] for letter in "RGB"
        }
    },
    "Condition": {"name": "night", "set": {"camera": {"f_number": 2.0}}},
}


def function_of(thing):
    """The function of a class method, whose module has the names of its annotations."""
    return getattr(thing, "__func__", thing)


def is_target(name: str, thing) -> bool:
    """Whether it is a function, class or method that takes arguments."""
    if not callable(function_of(thing)) or any(name.startswith(other) for other in NOT_CALLED):
        return False
    if name.rpartition(".")[2] in MADE_BY_FUNCTIONS or thing is Result.write:  # tested below
        return False
    return bool({*inspect.signature(function_of(thing)).parameters} - {"self", "cls"})


TARGETS = {name: thing for name, thing in PUBLIC.items() if is_target(name, thing)}


def arguments_of(name: str) -> dict[str, inspect.Parameter]:
    variadic = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {
        key: parameter
        for key, parameter in inspect.signature(function_of(TARGETS[name])).parameters.items()
        if key not in ("self", "cls") and parameter.kind not in variadic
    }


def good(name: str, argument: str):
    value = OWN.get(f"{name}.{argument}", GOOD.get(argument, inspect.Parameter.empty))
    assert value is not inspect.Parameter.empty, f"no valid value of {argument} of {name}"
    return value() if callable(value) and not isinstance(value, type) else value


def required(name: str) -> dict:
    """The arguments of a valid call; of a record, the fields of a valid instance."""
    thing = TARGETS[name]
    if inspect.isclass(thing) and issubclass(thing, BaseModel):
        record = {"Study": STUDY, "Technology": TECHNOLOGY, "Junction": TECHNOLOGY.junction}.get(
            thing.__name__
        )
        if record is None:
            return SMALL_RECORDS.get(thing.__name__, {})
        return {key: getattr(record, key) for key in record.model_fields_set}
    if inspect.isclass(thing) and is_dataclass(thing):
        instance = INSTANCES[thing.__name__]()
        return {field.name: getattr(instance, field.name) for field in fields(thing) if field.init}
    return {
        key: good(name, key)
        for key, parameter in arguments_of(name).items()
        if parameter.default is parameter.empty or key in ALWAYS.get(name, ())
    }


def call(name: str, arguments: dict):
    thing = TARGETS[name]
    above, _, method = name.rpartition(".")
    owner = above.rpartition(".")[2]
    if owner[:1].isupper():  # a class
        thing = getattr(
            PUBLIC[above] if isinstance(thing, classmethod) else INSTANCES[owner](), method
        )
    return thing(**arguments)


def is_right(result) -> bool:
    """Whether a result has no NaN."""
    if isinstance(result, np.ndarray):
        return result.dtype.kind not in "fc" or not np.isnan(result).any()
    if isinstance(result, float):
        return not math.isnan(result)
    if isinstance(result, tuple | list):
        return all(map(is_right, result))
    return True


def kind_is_wrong(hint: str, value) -> bool:
    """Whether a value cannot be meant by an annotation, as text."""
    if value is None:
        return "None" not in hint and "typing.Optional" not in hint and hint not in ANY_VALUE
    plain = {"float": (int, float), "int": (int, float), "str": (str,), "bool": (int,)}
    if hint.removesuffix(" | None") in plain:
        return not isinstance(value, plain[hint.removesuffix(" | None")])
    return type(value) is object and hint not in ANY_VALUE


def names(message: str, argument: str, value) -> bool:
    """Whether a message names an argument, or quotes the value: a file, a choice, or a number out
    of range.
    """
    quoted = (
        f"'{value}'" if isinstance(value, str | Path) else "1e+30" if value == 10**30 else argument
    )
    return argument in message or quoted in message


@pytest.fixture
def files(here: Path) -> None:
    """The files of `GOOD` in the working folder."""
    pixsim.write_exr("a.exr", LIGHT)
    np.save("edge.npy", RATIO_ROUNDING)
    pixsim.write_frame("raw.npz", FRAME)


def fault(call: Callable, argument: str, junk, annotation: str = "") -> str:
    """What is wrong with the end of a call whose argument makes no sense; empty if nothing is.

    annotation : of the argument, without bounds. Empty if no value of junk may be taken
    """
    try:
        with in_time(LIMIT_S), warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            result = call()
    except pixsim.PixsimError as error:
        return "" if names(str(error), argument, junk) else f"not named in '{error}'"
    except (Exception, TooLongError) as error:
        return f"{type(error).__name__}: {str(error)[:150]}"
    if not annotation:
        return "taken"
    if not is_right(result):
        return "NaN"
    return f"taken for {annotation}" if kind_is_wrong(annotation, junk) else ""


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("name", TARGETS)
def test_any_argument_gives_a_right_result_or_an_error_that_names_it(name: str) -> None:
    base = required(name)
    assert is_right(call(name, base)), "the valid call"
    faults = []
    for argument, parameter in arguments_of(name).items():
        annotation = without_bounds(str(parameter.annotation), function_of(TARGETS[name]))
        for label, junk in JUNK.items():
            if junk is parameter.default or (argument == "progress" and callable(junk)):
                continue  # the valid call; what a user's function returns is the user's
            words = fault(partial(call, name, base | {argument: junk}), argument, junk, annotation)
            faults += [f"{argument} = {label}: {words}"] if words else []
    assert not faults, "\n".join(faults)


LONG: dict[str, dict] = {
    "study": {"plan": STUDY, "out": "out"}, "datasheet": {}, "accuracy": {"scene": "csf"}, "lens": {"file": "cooke_triplet"},
    "run": {"scene": "csf"},
}  # fmt: skip


TAKEN = {("text", "out"), ("text", "progress"), ("10**30", "scheduler")}


@pytest.mark.parametrize("name", LONG)
def test_any_argument_of_a_long_function_gives_an_error_that_names_it(
    name: str, here: Path
) -> None:
    """All values of a wrong kind; none of them gets as far as a render, or the trace of a lens."""
    function = getattr(pixsim, name)
    faults = []
    for argument, parameter in inspect.signature(function).parameters.items():
        for label in ("-1", "nan", "10**30", "object()", "None", "text"):
            may_be = (label == "None" and parameter.default is None) or (label, argument) in TAKEN
            if may_be or parameter.kind is parameter.VAR_KEYWORD:
                continue
            words = fault(
                partial(function, **(LONG[name] | {argument: JUNK[label]})), argument, JUNK[label]
            )
            faults += [f"{argument} = {label}: {words}"] if words else []
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("argument", "value"), [("folder", 3), ("figures", "png"), ("seconds", 1.5)]
)
def test_write_of_any_result_names_a_wrong_argument(
    argument: str, value: object, tmp_path: Path
) -> None:
    arguments = {"folder": tmp_path / "out"} | {argument: value}
    with pytest.raises(pixsim.PixsimError, match=f"^{argument}: got "):
        score().write(**arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"parameters": {"strength": None}}, "parameters['strength']: got None"),
        ({"parameters": {"list": [1]}}, "parameters['list']: got [1]"),
        ({"parameters": {1: 2}}, "parameters[1]: got 1"),
        ({"config": np.array(1.0)}, "config: got array(1."),
        ({"smaller_than_um": [1.0, "x"]}, "smaller_than_um[1]: got 'x'"),
    ],
)
def test_a_part_at_fault_is_named_by_its_place(arguments: dict, said: str, tmp_path: Path) -> None:
    """Also one whose name begins as pydantic's names of kinds do; an array without axes is no
    list.
    """
    with pytest.raises(pixsim.PixsimError, match=re.escape(said)):
        pixsim.study("chen2000", tmp_path / "out", **arguments)


@pytest.mark.parametrize(
    ("kind", "values", "said"),
    [
        (ArrayLike, True, "got True; allowed: numbers"),
        (ArrayLike, [1.0, [True]], "got [1.0, [True]]; allowed: numbers"),
        (ArrayLike, np.array([True, False]), "got an array of bool, shape (2,); allowed: numbers"),
        (
            Finites,
            [1.0, np.ma.masked],
            "got masked values; allowed: numbers from -1e+30 to 1e+30; fill them",
        ),
        (Finites, [np.ma.array([1.0, 2.0], mask=[True, False])], "got masked values"),
        (Finites, [1.0, 1e31], "got 1e+31 at [1]; allowed: numbers from -1e+30 to 1e+30"),
        (Finites, -1e31, "got -1e+31; allowed: numbers from -1e+30 to 1e+30"),
        (Finites, [1.0, math.nan], "got nan at [1]; allowed: numbers from -1e+30 to 1e+30"),
        (float, -1e31, "got -1e+31; allowed: a number from -1e+30 to 1e+30"),
        (
            float,
            -1e-31,
            "got -1e-31; allowed: a number from -1e+30 to 1e+30, 0 or 1e-30 or more in absolute value",
        ),
        (
            int,
            10**31,
            "got 10000000000000000000000000000000; allowed: a whole number from -1e+30 to 1e+30",
        ),
    ],
)
def test_numbers_that_no_quantity_has_are_refused(kind, values, said: str) -> None:
    def value_of(light):
        return light

    value_of.__annotations__ = {"light": kind}
    with pytest.raises(pixsim.PixsimError, match=f"^light: {re.escape(said)}"):
        door.checked(value_of, "pixsim.value_of")(values)


def test_arrays_are_known_by_their_aliases(monkeypatch: pytest.MonkeyPatch) -> None:
    """From NumPy 2.5 on, `ArrayLike` and `NDArray` are aliases of `type` statements; on Python 3.12
    pip installs it.
    """
    kind = TypeVar("kind", bound=np.generic)
    alias = TypeAliasType("ArrayLike", float | list)
    numbers = np.ndarray[Any, np.dtype[kind]]
    array = TypeAliasType("NDArray", numbers, type_params=(kind,))[np.float64]
    monkeypatch.setattr("numpy.typing.ArrayLike", alias)

    def value_of(light, path=""):
        return light

    for hint in (alias, array, Union[alias, None], Union[array, None], Union[array, float]):  # noqa: UP007
        value_of.__annotations__ = {"light": hint, "path": str | PathLike[str]}
        door._arguments.cache_clear()
        function = door.checked(value_of, "pixsim.value_of")
        assert isinstance(function([1, 2], "x"), np.ndarray)
        for wrong, words in (
            (("bright",), r"light: got 'bright'; allowed: .*number"),
            (([1, 2], 3), "path: got 3; allowed: the path of a file"),
        ):
            with pytest.raises(pixsim.PixsimError, match=words):
                function(*wrong)


def test_every_public_name_is_called() -> None:
    assert len(TARGETS) > 100
    assert all(any(name.startswith(skipped) for name in PUBLIC) for skipped in NOT_CALLED), (
        "a name that is gone"
    )
