"""How far the numbers of a data sheet may be wrong: [pixel.uncertainty]."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from pixsim.base.bounds import SMALLEST
from pixsim.base.errors import PixsimError, did_you_mean, invalid, quoted
from pixsim.base.problems import explain
from pixsim.base.records import AnyNumber, Record
from pixsim.base.toml import kind_of_value, read_toml
from pixsim.sensor.pixel_options import NUMBERS, PixelOptions

Distribution = Literal["uniform", "normal", "lognormal"]


class Spread(Record):
    """How far a number may be wrong: a distribution by its standard deviation or its range.

    The standard deviation is about the stated value, which is the distribution's mean. A range
    holds a uniform distribution from end to end, or the central 90 % of a normal or lognormal
    one, whose middle then need not be the stated value.
    """

    sd: Annotated[float, Field(ge=SMALLEST, le=1e18)] | None = Field(
        None, description="standard deviation, in the unit of the number"
    )
    range: tuple[AnyNumber, AnyNumber] | None = Field(
        None, description="smallest and largest plausible value, in place of sd"
    )
    distribution: Distribution | None = Field(
        None, description="distribution (absent: normal for sd, uniform for range)"
    )

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        if (self.sd is None) == (self.range is None):
            got = "both sd and range" if self.range else "neither sd nor range"
            raise ValueError(f"got {got}; give one of them")
        if self.range and not self.range[0] < self.range[1]:
            raise ValueError(f"range = [{self.range[0]:g}, {self.range[1]:g}]; allowed: low < high")
        if self.kind == "lognormal" and self.range and self.range[0] <= 0:
            raise ValueError(
                f"range = [{self.range[0]:g}, {self.range[1]:g}] of a lognormal distribution;"
                " allowed: low > 0"
            )
        return self

    def holds(self, pixel: Mapping[str, Any] | None, number: str) -> bool:
        """Whether this can be the spread of a number of a pixel: it is given, and within the
        range.
        """
        value = None if pixel is None else pixel.get(number)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        low, high = self.range or (value, value)
        return low <= value <= high

    @property
    def kind(self) -> Distribution:
        """The distribution, stated or not."""
        return self.distribution or ("uniform" if self.sd is None else "normal")


MAY_BE_UNCERTAIN = tuple(
    name
    for name, field in PixelOptions.model_fields.items()
    if "float" in str(field.annotation) and not (name in NUMBERS and NUMBERS[name].is_certain)
)


def sheet_uncertainty(path: Path) -> dict[str, Spread]:
    """Return [pixel.uncertainty] of a data sheet: field of [pixel] -> how far its number may be
    wrong.

    Raises PixsimError for a name that is not a number of [pixel], a number that the file does not
    give, and an invalid spread.
    """
    pixel = read_toml(path).get("pixel")
    return without_uncertainty(pixel, str(path))[1] if isinstance(pixel, dict) else {}


# Sensor of a study, '' for the [pixel] of the study -> number -> spread.
Uncertainty = Mapping[str, Mapping[str, Spread]]


def without_uncertainty(
    pixel: dict[str, Any], source: str
) -> tuple[dict[str, Any], dict[str, Spread]]:
    """Return a table [pixel] without its table `uncertainty`, and that table. Raises PixsimError as
    `sheet_uncertainty` does.

    source : of the table, for messages
    """
    if "uncertainty" not in pixel:
        return pixel, {}
    plain = {name: value for name, value in pixel.items() if name != "uncertainty"}
    table = pixel["uncertainty"]
    where = f"{source}: pixel.uncertainty"
    if not isinstance(table, dict):
        raise invalid(
            where,
            kind_of_value(table),
            "a table",
            "Write read_noise_e = { sd = 0.2 } under [pixel.uncertainty].",
        )
    spreads = {}
    for name, entry in table.items():
        if name not in MAY_BE_UNCERTAIN:
            raise invalid(
                where,
                quoted(name),
                ", ".join(MAY_BE_UNCERTAIN),
                did_you_mean(name, MAY_BE_UNCERTAIN),
            )
        spreads[name] = _spread(entry, plain.get(name), f"{where}.{name}", name)
    return plain, spreads


def _spread(entry: object, value: object, where: str, name: str) -> Spread:
    """Return the spread of a number of [pixel]. Raises PixsimError if it is invalid, or does not
    hold the number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = "A curve cannot be uncertain; give a number." if value is not None else ""
        raise invalid(
            where,
            "a spread without its number",
            f"a number {name} in [pixel] of the same file",
            hint,
        )
    if not isinstance(entry, dict):
        raise invalid(
            where,
            kind_of_value(entry),
            "a table",
            f"Write {name} = {{ sd = 0.2 }} or {{ range = [low, high] }}.",
        )
    try:
        spread = Spread.model_validate(entry)
        for end in spread.range or ():
            PixelOptions.model_validate({name: end})  # the ends have the bounds of the number
    except ValidationError as error:
        lines = [f"{where}: {line}" for line in explain(error).splitlines()]
        raise PixsimError("\n".join(lines)) from None
    low, high = spread.range or (value, value)
    if not low <= value <= high:
        raise invalid(
            where, f"range = [{low:g}, {high:g}]", f"low <= {value:g} (the number) <= high"
        )
    if spread.kind == "lognormal" and value <= 0:
        raise invalid(where, f"a lognormal distribution for {value:g}", "a number above 0")
    return spread
