"""Numbers at the ends of their range, or far beyond, in functions, curves and free tables.

Fields of records are in tests/test_refusals.py. Subnormal numbers make operations slow, and ratios
of tiny or huge ones overflow to infinity and NaN.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pytest
from numpy.typing import ArrayLike
from pydantic import Field, create_model

from pixsim.base import door
from pixsim.base.bounds import POSITIVE
from pixsim.base.errors import PixsimError
from pixsim.base.records import Record
from pixsim.sensor.pixel_options import PixelOptions
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare

MAX_CPU_S = 5.0


def checked_as(hint: Any) -> Callable[[Any], Any]:
    """A public function that returns its argument."""

    def value_of(pitch_um: Any) -> Any:
        return pitch_um

    value_of.__annotations__["pitch_um"] = hint
    return door.checked(value_of, "pixsim.value_of")


@pytest.mark.parametrize("bounds", [POSITIVE, Field(gt=0)], ids=["function", "record"])
@pytest.mark.parametrize("value", [5e-324, 9e-31, -1e-320, 0.0])
def test_arguments_above_0_are_not_tiny(bounds: Any, value: float) -> None:
    """Also in arrays; 1e-30 is the smallest."""
    words = r"pitch_um.*: got .*allowed: .*number.* above 0 \(1e-30 or more\)"
    for kind, argument in (
        (float, value),
        (ArrayLike, [1.0, value]),
        (tuple[float, float], (1.0, value)),
    ):
        with pytest.raises(PixsimError, match=words):
            checked_as(Annotated[kind, bounds])(argument)
        checked_as(Annotated[kind, bounds])(1e-30 if kind is float else (1.0, 1e-30))


def is_refused(call: Callable[[], object]) -> bool:
    try:
        call()
    except PixsimError:
        return True
    return False


@pytest.mark.parametrize("field", [Field(ge=2, le=3), Field(gt=0, lt=3.5), Field(ge=2, lt=3.5)])
def test_functions_share_the_bounds_of_records(field: Any) -> None:
    function = checked_as(Annotated[float, field])
    record = create_model("Shared", __base__=Record, number=(Annotated[float, field], 2.0))
    values = [0.0, 1.5, 2.0, 2.5, 3.0, 3.5, float("nan")]
    of_function = [is_refused(partial(function, value)) for value in values]
    assert of_function == [is_refused(partial(record, number=value)) for value in values]


FREE_TABLES = {
    "axis": "[[axis]]\nname = 'a'\nset = 'pixel.read_noise_e'\nvalues = [1.0, {}]",
    "scene": "[scene.parameters]\nluminance_cd_per_m2 = {}",
    "curve": "pixel.quantum_efficiency = 'qe.csv'",
    "process": "process.'0.35um'.prnu = {}",
}


@pytest.mark.parametrize("value", ["1e-320", "1e308", "inf", "nan"])
@pytest.mark.parametrize("table", FREE_TABLES)
def test_extremes_in_free_tables_of_a_study_are_refused(
    table: str, value: str, tmp_path: Path
) -> None:
    (tmp_path / "qe.csv").write_text(f"400,{value}\n700,{value}\n", encoding="utf-8")
    text = f"name = 'x'\n{FREE_TABLES[table].format(value)}\n"
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    start = time.process_time()
    with pytest.raises(PixsimError):
        prepare(load_study(tmp_path / "s.toml"))
    assert time.process_time() - start < MAX_CPU_S


def test_a_zero_has_no_sign() -> None:
    assert repr(PixelOptions(offset_fpn=-0.0).offset_fpn) == "0.0"
