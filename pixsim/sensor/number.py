"""Metadata of the fields of [pixel]: example, synonyms in data sheets, scaling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from pixsim.base.problems import Words


@dataclass(frozen=True)
class Number(Words):
    """Metadata of a field of [pixel] beside its type, unit (in its name) and description.

    example : plausible value, for templates
    stands_for : fields in whose place it may be given: it is another word for them, of data sheets
        or of the layout
    part_of : words of data sheets for a sum that holds it, and in whose place it may be given
    in_technology : whether a technology may state it, where the pixel does not
    technology_default : value of a technology that does not state it, unless the technology's
        record declares it
    scales_with_area : whether a data sheet states it for its pitch, from which the value at other
        pitches follows by their area
    is_certain : whether it can have no [pixel.uncertainty], since the user sets it
    """

    example: Any = None
    stands_for: tuple[str, ...] = ()
    part_of: tuple[str, ...] = ()
    in_technology: bool = False
    technology_default: float | None = None
    scales_with_area: bool = False
    is_certain: bool = False


def numbers_of(record: type[BaseModel]) -> dict[str, Number]:
    """Return the `Number` of each field of a record that has one, by the name of the field."""
    numbers: dict[str, Number] = {}
    for name, field in record.model_fields.items():
        for annotation in reversed(field.metadata):
            if isinstance(annotation, Number):
                numbers[name] = annotation

    return numbers
