"""Every number that a user can set has bounds with a meaning, and what lies outside them is refused
at once.

Subnormal numbers make operations slow, and ratios of tiny or huge ones overflow to infinity and
NaN.
"""

from __future__ import annotations

import importlib
import itertools
import math
import pkgutil
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pytest
from numpy.typing import ArrayLike
from pydantic import Field, TypeAdapter, ValidationError, create_model

import pixsim
from pixsim.base import door
from pixsim.base.bounds import LARGEST, POSITIVE, SMALLEST
from pixsim.base.errors import PixsimError
from pixsim.base.records import Record
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel, PixelOptions
from pixsim.sensor.reading import Readout
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run

# Bounds that do not stand in the field: of curves in `_check_curve`, `_check_channel`, `as_share`,
# `_check_chief_rays` and `as_relative_illumination`; of scenes and axes in `_free_number`; of
# lenses, some of whose numbers may be infinite, in `prescription._checked` and
# `check_coefficients`, which tests/optics/test_lens_bounds.py tests.
CHECKED_ELSEWHERE = {
    "sensitivities", "quantum_efficiencies", "transmittances", "quantum_efficiency", "chief_ray_angle",
    "relative_illumination", "fall_off", "veiling_glare",
    "radius_mm", "object_distance_mm", "values", "parameters", "scene", "without",
}  # fmt: skip
EXTREMES = (
    1e-320, -1e-320, 5e-324, 1e-300, -1e-300, 1e300, -1e300, 1e308, math.inf, -math.inf, math.nan, -0.0, 0.0, 10**400, -(10**400),
)  # fmt: skip
MOST_CPU_S = 5.0


def records() -> list[type[Record]]:
    for module in pkgutil.walk_packages(pixsim.__path__, "pixsim."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found: list[type[Record]] = [Record]
    for kind in found:
        found += [each for each in kind.__subclasses__() if each not in found]
    return [kind for kind in found if kind.__module__.startswith("pixsim.") and kind is not Record]


def schemas_of_numbers(schema: Any) -> Iterator[dict[str, Any]]:
    """Yield the schemas of numbers within a field's, but for those of records inside, which are
    records of their own.
    """
    if isinstance(schema, list | tuple):
        for each in schema:
            yield from schemas_of_numbers(each)
    elif isinstance(schema, dict):
        if schema.get("type") in ("float", "int"):
            yield schema
        elif schema.get("type") != "model":
            for name, each in schema.items():
                if name not in ("metadata", "serialization"):
                    yield from schemas_of_numbers(each)


def numeric_fields() -> list[tuple[type[Record], str, list[dict[str, Any]]]]:
    found = []
    for kind in records():
        for name, field in kind.model_fields.items():
            annotation: Any = (
                Annotated[(field.annotation, *field.metadata)]
                if field.metadata
                else field.annotation
            )
            if numbers := list(schemas_of_numbers(TypeAdapter(annotation).core_schema)):
                found.append((kind, name, numbers))
    return found


FIELDS = numeric_fields()


def test_the_walk_finds_the_fields() -> None:
    names = {(kind.__name__, name) for kind, name, _ in FIELDS}
    assert {
        ("PixelOptions", "read_noise_e"),
        ("Axis", "values"),
        ("Junction", "pb_v"),
        ("StudyScene", "parameters"),
    } <= names
    assert {
        ("Camera", "die_mm"),
        ("Technology", "ranges"),
        ("Spread", "range"),
        ("Study", "process"),
    } <= names
    assert len(names) > 150


def test_every_number_is_bounded_on_both_sides() -> None:
    open_ends = [
        f"{kind.__name__}.{name}"
        for kind, name, numbers in FIELDS
        for number in numbers
        if name not in CHECKED_ELSEWHERE
        and not (
            any(math.isfinite(number.get(low, math.inf)) for low in ("ge", "gt"))
            and any(high in number for high in ("le", "lt"))
        )
    ]
    assert open_ends == []


def checked_as(hint: Any) -> Callable[[Any], Any]:
    """A public function that returns its argument."""

    def value_of(pitch_um: Any) -> Any:
        return pitch_um

    value_of.__annotations__["pitch_um"] = hint
    return door.checked(value_of, "pixsim.value_of")


@pytest.mark.parametrize("bounds", [POSITIVE, Field(gt=0)], ids=["function", "record"])
@pytest.mark.parametrize("value", [1e-320, 5e-324, 9e-31, -1e-320, 0.0])
def test_arguments_above_0_are_not_tiny(bounds: Any, value: float) -> None:
    """Also in arrays; 1e-30 is the smallest."""
    for kind, given in (
        (float, value),
        (ArrayLike, [1.0, value]),
        (tuple[float, float], (1.0, value)),
    ):
        with pytest.raises(
            PixsimError, match=r"pitch_um.*: got .*allowed: .*number.* above 0 \(1e-30 or more\)"
        ):
            checked_as(Annotated[kind, bounds])(given)
        checked_as(Annotated[kind, bounds])(1e-30 if kind is float else (1.0, 1e-30))


@pytest.mark.parametrize("field", [Field(ge=2, le=3), Field(gt=0, lt=3.5), Field(ge=2, lt=3.5)])
def test_functions_share_the_bounds_of_records(field: Any) -> None:
    check = checked_as(Annotated[float, field])
    record = create_model("Shared", __base__=Record, number=(Annotated[float, field], 2.0))

    def refuses(call: Callable[[], object]) -> bool:
        try:
            call()
        except PixsimError:
            return True
        return False

    for value in (0.0, 1.5, 2.0, 2.5, 3.0, 3.5, math.nan):
        assert refuses(partial(check, value)) == refuses(partial(record, number=value)), value


def test_no_lower_bound_lets_tiny_numbers_through() -> None:
    """Above 0 is no bound: 5e-324 is above it. `Record` refuses numbers below 1e-30 where 0 is
    allowed.
    """
    assert [
        f"{kind.__name__}.{name}"
        for kind, name, numbers in FIELDS
        if any(number.get("gt") == 0 for number in numbers)
    ] == []
    assert all(
        bound == 0 or abs(bound) >= SMALLEST
        for _, _, numbers in FIELDS
        for each in numbers
        for bound in [each.get("ge", 0)]
    )
    assert all(
        abs(each.get("le", each.get("lt", 0))) <= 2**63 or each["le"] >= LARGEST
        for _, _, numbers in FIELDS
        for each in numbers
    )


def is_allowed(number: dict[str, Any], value: float) -> bool:
    if not (value == 0 or SMALLEST <= abs(value) <= LARGEST):
        return False
    return number.get("ge", -math.inf) <= value <= number.get(
        "le", math.inf
    ) and value < number.get("lt", math.inf)


@pytest.mark.parametrize(
    ("kind", "name", "numbers"), FIELDS, ids=[f"{kind.__name__}.{name}" for kind, name, _ in FIELDS]
)
def test_extremes_are_refused_or_within_bounds(
    kind: type[Record], name: str, numbers: list[dict[str, Any]]
) -> None:
    """Also in lists and pairs; a value that stays is one that the field's bounds have, without the
    sign of -0.
    """
    alias = kind.model_fields[name].alias or name
    start = time.process_time()
    for value in EXTREMES:
        for given in (
            value,
            str(value)[:20],
            [value],
            [value, value],
            [[400.0, value], [700.0, value]],
            {"a": value},
        ):
            with warnings.catch_warnings(action="error"):
                try:
                    kept = kind.model_validate({alias: given}).__dict__[name]
                except (ValidationError, PixsimError):
                    continue
            for number in numbers_in(kept):
                assert any(is_allowed(each, number) for each in numbers) or kept is None, (
                    value,
                    kept,
                )
                assert math.copysign(1, number) > 0 or number, kept
    assert time.process_time() - start < MOST_CPU_S


def numbers_in(value: Any) -> Iterator[float]:
    if isinstance(value, float | int) and not isinstance(value, bool):
        yield value
    elif isinstance(value, tuple | list):
        yield from itertools.chain.from_iterable(map(numbers_in, value))
    elif type(value) is dict:
        yield from numbers_in(list(value.values()))


SHEET = {
    "pitch_um": 3.45,
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}


def ends_of(record: type[Record]) -> list[tuple[str, float]]:
    """The smallest and the largest value of each plain number of a record, and the smallest one
    beside 0.
    """
    found = []
    for kind, name, numbers in FIELDS:
        if (
            kind is record
            and len(numbers) == 1
            and numbers[0]["type"] == "float"
            and name not in CHECKED_ELSEWHERE
        ):
            low, high = (
                numbers[0]["ge"],
                numbers[0].get("le", math.nextafter(numbers[0].get("lt", 1.0), 0)),
            )
            found += [(name, value) for value in {low or SMALLEST, low, high}]
    return found


@pytest.mark.parametrize(("name", "value"), ends_of(Pixel))
@pytest.mark.parametrize("sheet", [True, False], ids=["sheet", "technology"])
def test_a_pixel_at_a_bound_has_finite_numbers_or_is_refused(
    name: str, value: float, sheet: bool
) -> None:
    base = dict(SHEET) if sheet else {"pitch_um": 6.5}
    with warnings.catch_warnings(action="error"):
        try:
            readout = Readout.of(derive(Pixel(**base | {name: value})))
            numbers = [
                readout.full_well_e,
                readout.dark_current_e_per_s,
                readout.dn_per_e,
                readout.noise_floor_e,
            ]
            numbers.append(readout.adc_range_e)
        except PixsimError:
            return
    assert all(map(math.isfinite, numbers))


@pytest.mark.parametrize(("name", "value"), ends_of(Camera))
def test_a_camera_at_a_bound_has_finite_numbers_or_is_refused(name: str, value: float) -> None:
    with warnings.catch_warnings(action="error"):
        try:
            camera = Camera(**{name: value})
        except PixsimError:
            return
        numbers = [
            camera.magnification,
            camera.image_distance_mm,
            camera.effective_f_number,
            camera.chart_half_width_m,
        ]
    assert all(map(math.isfinite, [*numbers, camera.fov_deg, camera.aperture_radius_m]))


@pytest.mark.parametrize("value", ["1e-320", "1e-300", "1e300", "1e308", "inf", "nan", "1e999"])
@pytest.mark.parametrize("setting", ["axis", "scene", "curve", "process"])
def test_extremes_in_free_tables_of_a_study_are_refused(
    setting: str, value: str, tmp_path: Path
) -> None:
    (tmp_path / "qe.csv").write_text(f"400,{value}\n700,{value}\n", encoding="utf-8")
    number = value if value in ("inf", "nan") else f"{value}"
    text = {
        "axis": f"[[axis]]\nname = 'a'\nset = 'pixel.read_noise_e'\nvalues = [1.0, {number}]",
        "scene": f"[scene.parameters]\nluminance_cd_per_m2 = {number}",
        "curve": "pixel.quantum_efficiency = 'qe.csv'",
        "process": f"process.'0.35um'.prnu = {number}",
    }[setting]
    (tmp_path / "s.toml").write_text(f"name = 'x'\n{text}\n", encoding="utf-8")
    start = time.process_time()
    with pytest.raises(PixsimError):
        prepare(load_study(tmp_path / "s.toml"))
    assert time.process_time() - start < MOST_CPU_S


def test_what_is_usual_is_allowed() -> None:
    PixelOptions(read_noise_e=0, prnu=0.0, offset_fpn=-0.0)
    assert math.copysign(1, PixelOptions(offset_fpn=-0.0).offset_fpn or 0.0) == 1
    Run(seed=2**63 - 1)
    with pytest.raises(PixsimError, match="seed"):
        Run(seed=2**63)
    Study(name="x", target_ci_um=1e-3)
