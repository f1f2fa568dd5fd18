"""`pixsim chart`: textures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pixsim.cli.base import Json, app, show


@app.command
def chart(
    kind: str,
    *,
    output: Annotated[Path, Parameter(name=["-o", "--output"], help="Linear float32 EXR, row 0 on top.")],
    width: Annotated[int | None, Parameter(help="Texels across.")] = None,
    height: Annotated[int | None, Parameter(help="Texels down.")] = None,
    die_mm: Annotated[float | None, Parameter(help="Width of the die that the chart fills (csf) [default: 2.7136].")] = None,
    json: Json = False,
) -> None:
    """Make a chart texture for -D chart=FILE.

    Example: pixsim chart siemens_star -o star.exr

    Parameters
    ----------
    kind
        csf, flat, siemens_star or slanted_edge.
    """
    from pixsim import charts

    texels = charts.make_chart(kind, width, height, die_mm)
    charts.write_chart(output, texels)
    height_texels, width_texels = texels.shape
    found = {"file": str(output), "kind": kind, "width": width_texels, "height": height_texels}
    show(found, json, f"{width_texels} × {height_texels} texels in {output}")
