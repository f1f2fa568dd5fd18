"""`pixsim sfr`: how sharp a picture of a slanted edge is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pixsim.cli.base import DEFAULT_OUT, Json, Out, app, show
from pixsim.errors import PixsimError, refuse


@app.command
def sfr(
    image: Path,
    *,
    pitch_um: Annotated[float | None, Parameter(help="Of the pixels, where the file does not tell it; gives cycles/mm.")] = None,
    black_level_dn: Annotated[float | None, Parameter(help="Where the file does not tell it [default: 0]; contrast only.")] = None,
    region: Annotated[str | None, Parameter(help="x0,y0,x1,y1 in pixels from the upper left, ends not included.")] = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Spatial frequency response of a slanted edge, as ISO 12233 measures it.

    Example: pixsim run slanted_edge

    Example: pixsim sfr pixsim-out/slanted_edge/raw.exr

    Writes sfr.csv, sfr.svg, edge_spread.csv, edge_spread.svg, summary.json.

    Parameters
    ----------
    image
        A linear grey picture: raw.exr of `pixsim run`, another EXR of one channel, .npy, .npz, or a .png or .tiff of 16 bits.
    """
    from pixsim.sfr import edge_response
    from pixsim.sfr_report import read_edge_picture, sfr_line, summary, write_sfr

    if pitch_um is not None and not 0 < pitch_um < float("inf"):
        raise refuse("--pitch-um", f"{pitch_um:g}", "a number above 0")
    picture = read_edge_picture(image)
    pitch = picture.pitch_um if pitch_um is None else pitch_um
    black = (picture.black_level_dn or 0.0) if black_level_dn is None else black_level_dn
    saturation = None if picture.top is None else picture.top - black
    found = edge_response(picture.data.astype(float) - black, region=corners(region), saturation=saturation)
    result = summary(found, pitch)
    folder = out or DEFAULT_OUT / f"{image.stem}-sfr"
    write_sfr(folder, found, pitch, result)
    show(result, json, f"{sfr_line(result)}; curves in {folder}")


def corners(region: str | None) -> tuple[int, int, int, int] | None:
    """Four whole numbers."""
    if region is None:
        return None
    try:
        x0, y0, x1, y1 = (int(each) for each in region.split(","))
    except ValueError:
        raise PixsimError(f"--region: got '{region}'; allowed: x0,y0,x1,y1, whole numbers. Write --region 100,0,400,512.") from None
    return x0, y0, x1, y1
