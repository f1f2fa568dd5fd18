"""A contact sheet as one labelled PNG: the same detail from every pixel size at 1:1, for slides and documents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pixsim.labels import one_line
from pixsim.pictures import font, png_bytes

COLUMNS = 6
MARGIN, GAP, FRAME = 16, 14, 3  # px
TITLE, LINE, LABEL_WIDTH = 34, 19, 112
LONGEST_TITLE = 140  # characters
BLACK, WHITE = 0, 255


@dataclass(frozen=True)
class Tile:
    """A detail of a picture, grey codes (H, W), with two lines of words; the best one is framed."""

    codes: NDArray[np.uint8] = field(repr=False)
    name: str
    note: str
    best: bool = False


def contact_sheet_png(title: str, tiles: Sequence[Tile]) -> bytes:
    """Tiles of at most one size in rows of six, each dot of a picture one of the sheet."""
    from PIL import Image, ImageDraw

    title = one_line(title, LONGEST_TITLE)
    side_y, side_x = (max(tile.codes.shape[axis] for tile in tiles) for axis in (0, 1))
    pitch_x, pitch_y = max(side_x, LABEL_WIDTH) + GAP, side_y + 2 * LINE + GAP
    columns = min(COLUMNS, len(tiles))
    width = max(2 * MARGIN + columns * pitch_x - GAP, round(font(16).getlength(title)) + 2 * MARGIN)
    canvas = Image.new("L", (width, 2 * MARGIN + TITLE + -(-len(tiles) // columns) * pitch_y - GAP), WHITE)
    draw = ImageDraw.Draw(canvas)
    draw.text((MARGIN, MARGIN), title, BLACK, font(16), anchor="lt")
    for index, tile in enumerate(tiles):
        x, y = MARGIN + index % columns * pitch_x, MARGIN + TITLE + index // columns * pitch_y
        height, width = tile.codes.shape
        if tile.best:
            draw.rectangle((x - FRAME, y - FRAME, x + width - 1 + FRAME, y + height - 1 + FRAME), fill=BLACK)
        canvas.paste(Image.fromarray(tile.codes), (x, y))
        draw.text((x, y + height + 5), f"best: {tile.name}" if tile.best else tile.name, BLACK, font(14), anchor="lt")
        draw.text((x, y + height + 5 + LINE), tile.note, BLACK, font(14), anchor="lt")
    return png_bytes(np.asarray(canvas))
