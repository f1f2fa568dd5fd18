"""What there is to know of a number of [pixel] beside its type, its unit and its words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from pixsim.base.problems import Words


@dataclass(frozen=True)
class Number(Words):
    """What there is to know of a field of [pixel] beside its type, its unit (in its name) and its
    words.

    example : plausible value, for templates
    stands_for : fields in whose place it may be given: it is another word for them, of data sheets
        or of the layout
    part_of : words of data sheets for a sum that holds it, and in whose place it may be given
    of_technology : whether a technology may have it, where the pixel does not state it
    otherwise : value of a technology that does not state it; None: the technology's record declares
        it
    scales_with_area : whether a data sheet states it for its own pitch, and that of other pitches
        follows from their area
    is_certain : whether it can have no [pixel.uncertainty], since the user sets it
    """

    example: Any = None
    stands_for: tuple[str, ...] = ()
    part_of: tuple[str, ...] = ()
    of_technology: bool = False
    otherwise: float | None = None
    scales_with_area: bool = False
    is_certain: bool = False


def numbers_of(record: type[BaseModel]) -> dict[str, Number]:
    """Return what is known of the fields of a record that have a `Number`."""
    found = {
        name: [each for each in field.metadata if isinstance(each, Number)]
        for name, field in record.model_fields.items()
    }
    return {name: of_field[0] for name, of_field in found.items() if of_field}
