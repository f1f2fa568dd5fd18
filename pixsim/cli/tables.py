"""The records' fields as dotted command-line options."""

from __future__ import annotations

from dataclasses import field, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import Parameter

from pixsim.parameters import CameraOptions, Display, Exposure, Pixel, Record


def option_table(record: type[Record], name: str) -> tuple[Any, Any]:
    """The fields of a record as dotted options, and the table with none given.

    They stay text: the record itself checks them, in one place.
    """
    fields = []
    for key, info in record.model_fields.items():
        default = "" if info.is_required() or info.default is None else f" [default: {info.default}]"
        help_text = f"{info.description or ''}{default}".strip()
        fields.append(
            (
                key,
                Annotated[str | None, Parameter(help=help_text, allow_leading_hyphen=True, show_default=False)],
                field(default=None),
            )
        )
    table = make_dataclass(f"{record.__name__}Table", fields, frozen=True)
    table.__module__ = __name__  # without it cyclopts takes the class for a builtin
    return Annotated[table, Parameter(name=name, group=f"--{name}.…", show_default=False)], table()


if TYPE_CHECKING:
    CameraTable: TypeAlias = Any
    PixelTable: TypeAlias = Any
    ExposureTable: TypeAlias = Any
    DisplayTable: TypeAlias = Any
    NO_CAMERA = NO_PIXEL = NO_EXPOSURE = NO_DISPLAY = None
else:
    CameraTable, NO_CAMERA = option_table(CameraOptions, "camera")
    PixelTable, NO_PIXEL = option_table(Pixel, "pixel")
    ExposureTable, NO_EXPOSURE = option_table(Exposure, "exposure")
    DisplayTable, NO_DISPLAY = option_table(Display, "display")
