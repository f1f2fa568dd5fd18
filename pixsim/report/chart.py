"""`pixsim chart`: a chart or a picture of the user as a texture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pixsim.base.errors import invalid
from pixsim.scene.charts import make_chart, write_chart
from pixsim.scene.colour_chart import write_colour_axis
from pixsim.scene.own_chart import SUFFIXES, read_luminance, with_border
from pixsim.show.document import Document

PICTURE = "a picture"
TARGET = "the chart target"
CSF = "the chart csf"
_CHART_OF_OPTION = {  # option -> what takes it alone
    **dict.fromkeys(("linear", "aspect"), PICTURE),
    **dict.fromkeys(
        ("shape", "size_um", "length_um", "contrast", "line_contrast", "direction"), TARGET
    ),
    "colour_axis": CSF,
}
_ASPECTS = (1e-3, 1e3)


def chart_document(kind: str, output: Path, options: Mapping[str, Any]) -> Document:
    """Write a chart to a file, and return the answer of `pixsim chart`.

    kind : name of a chart, or path of a picture
    options : those that were given, by their names

    Raises PixsimError for another kind, for an option that it does not take, and if the file cannot
    be written.
    """
    is_picture = Path(kind).suffix.lower() in SUFFIXES
    _check_options(kind, is_picture, options)
    if "colour_axis" in options:
        return _colour_axis_document(output, options)

    border = 0.0
    if is_picture:
        aspect = options.get("aspect", 1.0)
        if not _ASPECTS[0] <= aspect <= _ASPECTS[1]:
            raise invalid("--aspect", f"{aspect:g}", "0.001 to 1000")
        luminance = read_luminance(kind, options.get("linear", False))
        texels, border = with_border(luminance, aspect)
    else:
        texels = make_chart(kind, **options)
    write_chart(output, texels)

    height, width = texels.shape
    line = f"{width} × {height} texels in {output}"
    if border:
        line += f", {100 * border:.3g} % of them a grey border that keeps the picture's aspect"
    data = {
        "file": str(output),
        "kind": Path(kind).name,
        "width": width,
        "height": height,
        "border": border,
    }
    return Document("chart", "chart", str(output), data, (line,))


def _check_options(kind: str, is_picture: bool, options: Iterable[str]) -> None:
    """Raise PixsimError for an option that a chart or picture does not take, with all others of its
    kind.
    """
    chart = PICTURE if is_picture else f"the chart {kind}"
    pixsim_chart = "a chart of pixsim: pictures keep their size"
    chart_of_option = {
        **dict.fromkeys(("width", "height", "die_mm"), pixsim_chart),
        **_CHART_OF_OPTION,
    }
    for option in options:
        if option in _CHART_OF_OPTION:
            is_allowed = chart == _CHART_OF_OPTION[option]
        else:
            is_allowed = not is_picture
        if not is_allowed:
            allowed = chart_of_option[option]
            others = [name for name in options if chart_of_option[name] == allowed]
            names = ", ".join(f"--{name.replace('_', '-')}" for name in others)
            raise invalid(names, f"with {kind}", allowed)


def _colour_axis_document(output: Path, options: Mapping[str, Any]) -> Document:
    """Write a scene whose chart changes along a colour axis, and return the answer."""
    size = (options.get(name) for name in ("width", "height", "die_mm"))
    result = write_colour_axis(options["colour_axis"], output, *size)
    contrasts = ", ".join(f"{name} {value:+.3f}" for name, value in result["contrasts"].items())
    line = (
        f"{output} with slides {', '.join(result['slides'])}; contrasts up to {contrasts}; opponent"
        f" channel ±{result['opponent_amplitude']:.3f} of white's luminance channel"
    )
    return Document("chart", "chart in colour", str(output), result, (line,))
