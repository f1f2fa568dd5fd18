"""The base of all settings: frozen, validated records with a content hash."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import reduce
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from pixsim.base.bounds import LARGEST, SMALLEST, is_bool, parts_of, value_text
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import is_utf8
from pixsim.base.hashes import content_hash
from pixsim.base.layers import Layer, merge_tables
from pixsim.base.lazy import cached_property
from pixsim.base.problems import MAX_VALUE, RECORDS, explain

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # it has no public name


class _RecordType(ModelMetaclass):
    """Calls of a record's class raise PixsimError; pydantic's own methods, such as
    `model_validate`, its ValidationError.
    """

    def __call__(cls, *args: Any, **fields: Any) -> Any:
        if args:
            hint = (
                "Of a file: tomllib.loads(Path('sensor.toml').read_text())['pixel'], after ** in"
                " the brackets."
            )
            raise invalid(
                cls.__name__,
                repr(args[0])[:MAX_VALUE],
                "fields by name, such as pitch_um=3.45",
                hint,
            )
        try:
            return super().__call__(*args, **fields)
        except ValidationError as error:
            raise PixsimError(explain(error)) from None


def _not_tiny(value: object) -> object:
    """A value with 0 in place of -0, also in lists. ValueError if a number in it is below
    `SMALLEST`, and not 0.
    """
    if isinstance(value, float):
        if 0 < abs(value) < SMALLEST:
            raise ValueError(
                f"got {value:g}; allowed: 0, or at least {SMALLEST:g} in absolute value"
            )
        return value + 0.0  # -0.0 + 0.0 is 0.0
    if isinstance(value, tuple):
        if any(isinstance(part, float | tuple) for part in value):
            return tuple(map(_not_tiny, value))
        return value
    # numbers of a table belong to a scene, a technology or a lens, and have other bounds
    return value


class Record(BaseModel, metaclass=_RecordType):
    """Frozen, validated parameters. Invalid values and unknown names raise PixsimError, a
    ValueError.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, ignored_types=(cached_property,)
    )

    @field_validator("*", mode="before")
    @classmethod
    def _reject_wrong_kinds(cls, value: object, info: ValidationInfo) -> object:
        """Pydantic converts true to 1, also within lists: `bits = true` would be a sensor of one
        bit. It cannot read names of files that are not UTF-8.
        """
        takes_bool = cls.model_fields[info.field_name or ""].annotation is bool
        for part in parts_of(value):
            if isinstance(part, str) and not is_utf8(part):
                raise ValueError(
                    f"got {value_text(part)}; allowed: text in UTF-8. Rename the file or its folder"
                )
            if is_bool(part) and not takes_bool:
                raise ValueError(f"got {value_text(part)}; allowed: a number or a name")
        return value

    @field_validator("*", mode="after")
    @classmethod
    def _no_tiny_numbers(cls, value: object) -> object:
        """A fixed rule beside the bounds of a field: 0, without a sign, or a number that a
        processor divides by in usual time.
        """
        return _not_tiny(value)

    # Groups of fields that state one quantity in several words: of each group one alternative, of
    # one or more fields, may be given.
    ALTERNATIVES: ClassVar[tuple[tuple[tuple[str, ...], ...], ...]] = ()

    @model_validator(mode="after")
    def _states_each_quantity_once(self) -> Self:
        for group in self.ALTERNATIVES:
            stated = [
                ", ".join(name for name in names if getattr(self, name) is not None)
                for names in group
            ]
            words = [names for names in stated if names]
            if len(words) > 1:
                raise ValueError(f"{' and '.join(words)} state the same quantity; give one of them")
        return self

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        RECORDS.setdefault(cls.__name__, cls)

    @classmethod
    def _merged(cls, layers: Iterable[Layer]) -> dict[str, Any]:
        """Merge the tables of all layers; later layers take precedence."""
        return reduce(merge_tables, (layer.table for layer in layers), {})

    @property
    def content_hash(self) -> str:
        """Hash of all fields, 16 hexadecimal digits."""
        return content_hash(self.model_dump(mode="json"))


def restated_by(record: type[Record], names: Iterable[str]) -> set[str]:
    """Return the fields that cannot be given together with the fields `names`, since they state the
    same quantity.
    """
    stated = set(names)
    restated = set[str]()
    for group in record.ALTERNATIVES:
        others = [words for words in group if not stated.intersection(words)]
        if len(others) < len(group):
            restated.update(*others)
    return restated


# A number whose bounds are checked where it is used
AnyNumber = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]


def _free_number(value: object) -> object:
    if isinstance(value, int | float) and not abs(value) <= LARGEST:
        raise ValueError(
            f"got {value_text(value)}; allowed: a number from {-LARGEST:g} to {LARGEST:g}, or a"
            " text"
        )
    return _not_tiny(value)


# Of a scene or an axis: a number of any quantity, or a text.
NumberOrText = Annotated[float | int | str, BeforeValidator(_free_number)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]


def as_float(value: Any) -> float:
    """Convert to float; integers beyond its range become infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def as_list(value: object) -> object:
    """Split the text of an option at commas and blanks, as 1.4,2.0,2.8. ValueError if there is no
    value beside a comma.
    """
    if not isinstance(value, str):
        return value
    if not all(part.strip() for part in value.split(",")):
        raise ValueError(f"got '{value}'; allowed: a value on both sides of every comma")
    return value.replace(",", " ").split()


_Model = TypeVar("_Model", bound=Record)


def checked(record: type[_Model], layers: Sequence[Layer]) -> _Model:
    """Merge layers and validate the record. Raises PixsimError that lists every problem with the
    file that it comes from.
    """
    try:
        return record.model_validate(record._merged(layers))
    except ValidationError as error:
        raise PixsimError(explain(error, layers)) from None
