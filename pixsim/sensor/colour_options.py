"""Colour filters of the pixels, and the response of each channel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.records import Record, as_list, restated_by
from pixsim.light.curves import (
    RESPONSES,
    Curves,
    QuantumEfficiencies,
    Sensitivities,
    Transmittances,
)
from pixsim.light.quantities import Fraction


def colour_excluded_by(names: Iterable[str]) -> set[str]:
    """The fields of [pixel.colour] that cannot be given together with some others.

    names : of the other fields
    """
    stated = set(names)
    excluded = restated_by(ColourOptions, stated)
    is_absolute = bool(stated & set(RESPONSES) - {"sensitivities"})
    if is_absolute:
        excluded |= {"peak_quantum_efficiency"} - stated
    return excluded


def efficiencies_of(colour: object) -> set[str]:
    """The name of the quantum efficiency, if [pixel.colour], a table or a record, states the
    efficiencies of all channels.
    """
    fields: dict[str, object] = {}
    if isinstance(colour, dict):
        fields = colour
    elif isinstance(colour, ColourOptions):
        fields = vars(colour)
    if any(fields.get(name) is not None for name in RESPONSES[:2]):
        return {"quantum_efficiency"}
    return set()


# Upper row first.
BAYER = {"rggb": ("RG", "GB"), "grbg": ("GR", "BG"), "gbrg": ("GB", "RG"), "bggr": ("BG", "GR")}
PATTERNS: dict[str, tuple[str, ...]] = {
    **BAYER,
    "quad_rggb": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "rccb": ("RC", "CB"),
    "stacked": ("RGB",),
}
_MAX_CELL = 8  # rows and columns of a unit cell
BIN = 2  # pixels along a side of those whose charge is summed


ALLOWED_CELL = (
    f"rows of equal length, up to {_MAX_CELL} x {_MAX_CELL} capital letters, as ['RG', 'GB']"
)


def is_cell(rows: Sequence[str]) -> bool:
    """Whether rows of letters are a unit cell."""
    widths = {len(row) for row in rows}
    if len(widths) != 1 or len(rows) > _MAX_CELL:
        return False
    if not 1 <= widths.pop() <= _MAX_CELL:
        return False
    return all("A" <= letter <= "Z" for row in rows for letter in row)


def channels_of(cell: Iterable[str]) -> tuple[str, ...]:
    """The letters of a unit cell: R, G and B first, then the others in their order of
    appearance.
    """
    letters = dict.fromkeys("".join(cell))
    return (
        *(letter for letter in "RGB" if letter in letters),
        *(letter for letter in letters if letter not in "RGB"),
    )


def binned_cell(cell: Sequence[str]) -> tuple[str, ...]:
    """The unit cell of sums of 2 x 2 pixels; empty if the pixels of a sum have different
    letters.
    """
    rows = [row[::BIN] for row in cell[::BIN]]
    doubled = ["".join(letter * BIN for letter in row) for row in rows]
    repeated = tuple(row for row in doubled for _ in range(BIN))
    return tuple(rows) if repeated == tuple(cell) else ()


class ColourOptions(Record):
    """Colour filters of the pixels, or layers of photodiodes, and the response of each channel.

    The picture is upright, as the photographer sees it: the first row of the unit cell is the
    uppermost. There is no optical low-pass filter before the pixels.
    """

    ALTERNATIVES: ClassVar = ((("pattern",), ("matrix",)), tuple((name,) for name in RESPONSES))

    pattern: Literal["rggb", "grbg", "gbrg", "bggr", "quad_rggb", "rccb", "stacked"] | None = Field(
        None,
        description=(
            "unit cell of the filters, upper row first: four phases of Bayer's; 'quad_rggb', of 2 x"
            " 2 equal pixels each; 'rccb', clear in place of green; 'stacked', no filters, but R, G"
            " and B one below the other in every pixel (absent: rggb)"
        ),
    )
    matrix: Annotated[tuple[str, ...], BeforeValidator(as_list)] | None = Field(
        None,
        description="in place of pattern: rows of a unit cell, a letter for each pixel, as RG, GB",
    )
    binning: bool = Field(
        False,
        description=(
            "sum the charge of 2 x 2 equal pixels before it is read, as pixels of twice the pitch"
        ),
    )
    sensitivities: Sensitivities | None = Field(
        None,
        description=(
            "relative responses to energy, with peak_quantum_efficiency: a packaged camera, as"
            " Nikon_D5100, or CSV file"
        ),
    )
    quantum_efficiencies: QuantumEfficiencies | None = Field(
        None,
        description=(
            "in place of sensitivities: quantum efficiency of each channel, CSV file or table"
        ),
    )
    transmittances: Transmittances | None = Field(
        None,
        description=(
            "in place of sensitivities: transmittance of each filter, CSV file or table, times the"
            " pixel's own response"
        ),
    )
    peak_quantum_efficiency: Fraction | None = Field(
        None,
        description=(
            "with sensitivities: the largest quantum efficiency of all channels, electrons per"
            " photon"
        ),
    )

    @model_validator(mode="after")
    def _responses_are_complete(self) -> Self:
        responses = [name for name in RESPONSES if getattr(self, name) is not None]
        if not responses:
            others = [name for name in ColourOptions.model_fields if name in self.model_fields_set]
            beside = f" together with {', '.join(others)}" if others else ""
            raise ValueError(
                f"no response of the channels{beside}; allowed: one of {', '.join(RESPONSES)}"
            )
        if self.sensitivities is not None and self.peak_quantum_efficiency is None:
            raise ValueError(
                "sensitivities are relative; give peak_quantum_efficiency too, the largest quantum"
                " efficiency of all channels"
            )
        if self.sensitivities is None and self.peak_quantum_efficiency is not None:
            raise ValueError(
                f"peak_quantum_efficiency together with {responses[0]}, which are absolute; leave"
                f" it out"
            )
        return self

    @model_validator(mode="after")
    def _cell_is_whole(self) -> Self:
        rows = self.matrix
        if rows is not None and not is_cell(rows):
            raise ValueError(f"matrix = {list(rows)}; allowed: {ALLOWED_CELL}")
        if self.binning and not binned_cell(self.unit_cell):
            hint = "allowed: binning of 2 x 2 pixels with the same letter, as in quad_rggb"
            name = "matrix" if self.matrix else "pattern"
            raise ValueError(
                f"binning = true with {name} of the unit cell {', '.join(self.unit_cell)}; {hint}"
            )
        curves = self.curves
        if curves is not None:
            letters = channels_of(self.unit_cell)
            if unknown := next((letter for letter in letters if letter not in curves), ""):
                names = ", ".join(curves)
                raise ValueError(
                    f"the unit cell has {unknown}, of which no response is given; allowed: {names},"
                    " or a response of it"
                )
            if unused := next((letter for letter in curves if letter not in letters), ""):
                raise ValueError(
                    f"channel {unused} has no pixels in {', '.join(self.unit_cell)}; add it to"
                    " matrix, or leave it out"
                )
        return self

    @property
    def unit_cell(self) -> tuple[str, ...]:
        """Rows of the unit cell of the pixels."""
        return self.matrix or PATTERNS[self.pattern or "rggb"]

    @property
    def cell(self) -> tuple[str, ...]:
        """Rows of the unit cell of frames: of the sums with binning; the letters of the layers if
        they are stacked.
        """
        return binned_cell(self.unit_cell) if self.binning else self.unit_cell

    @property
    def is_stacked(self) -> bool:
        """Whether every pixel has all channels, one below the other."""
        return self.pattern == "stacked"

    @property
    def curves(self) -> Curves | None:
        """The responses of the channels, unless the name of a camera stands for them."""
        stated = [getattr(self, name) for name in RESPONSES]
        response = next(value for value in stated if value is not None)
        return None if isinstance(response, str) else response
