"""`pixsim chart`: a chart or a picture of the user as a texture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pixsim.base.errors import invalid
from pixsim.scene.charts import make_chart, write_chart
from pixsim.scene.colour_chart import write_colour_axis
from pixsim.scene.own_chart import SUFFIXES, read_luminance, with_border
from pixsim.show.document import Document

PICTURE, TARGET, CSF = "a picture", "the chart target", "the chart csf"
_CHART_OF_OPTION = {  # option -> what takes it alone
    **dict.fromkeys(("linear", "aspect"), PICTURE),
    **dict.fromkeys(("shape", "size_um", "contrast", "direction"), TARGET),
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
    chart = PICTURE if is_picture else f"the chart {kind}"
    chart_of_option = {
        **dict.fromkeys(
            ("width", "height", "die_mm"), "a chart of pixsim: pictures keep their size"
        ),
        **_CHART_OF_OPTION,
    }
    for option in options:
        is_allowed = (
            chart == _CHART_OF_OPTION[option] if option in _CHART_OF_OPTION else not is_picture
        )
        if not is_allowed:
            others = [name for name in options if chart_of_option[name] == chart_of_option[option]]
            names = ", ".join(f"--{name.replace('_', '-')}" for name in others)
            raise invalid(names, f"with {kind}", chart_of_option[option])

    if "colour_axis" in options:
        size = (options.get(name) for name in ("width", "height", "die_mm"))
        result = write_colour_axis(options["colour_axis"], output, *size)
        contrasts = ", ".join(f"{name} {value:+.3f}" for name, value in result["contrasts"].items())
        line = f"{output} with slides {', '.join(result['slides'])}; contrasts up to {contrasts}"
        line += (
            f"; opponent channel ±{result['opponent_amplitude']:.3f} of white's luminance channel"
        )
        return Document("chart", "chart in colour", str(output), result, (line,))

    border = 0.0
    if is_picture:
        aspect = options.get("aspect", 1.0)
        if not _ASPECTS[0] <= aspect <= _ASPECTS[1]:
            raise invalid("--aspect", f"{aspect:g}", "0.001 to 1000")
        texels, border = with_border(read_luminance(kind, options.get("linear", False)), aspect)
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
