"""Matplotlib figures: reproducible byte for byte, with ΔE maps on one fixed scale."""

from __future__ import annotations

import base64
import io
import os
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import setting_text
from pixsim.base.errors import invalid
from pixsim.base.lazy import RC_FILE
from pixsim.base.shared_block import SharedBlock
from pixsim.show.pictures import PictureAxes, smallest_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LineStyle:
    """Style of one line: its colour and, for a grey print, its dashes and marker."""

    colour: str
    dashes: str | tuple[int, tuple[int, ...]]
    marker: str

    @property
    def stroke(self) -> dict[str, Any]:
        """Matplotlib keywords of a line without markers."""
        return {"color": self.colour, "ls": self.dashes}

    @property
    def line(self) -> dict[str, Any]:
        return self.stroke | {"marker": self.marker}


LEGEND_LINE = 3.5  # long enough to show the dashes
# Okabe and Ito (2008). The order keeps the first four at least 19 apart (CIEDE2000) for every kind
# of colour blindness, and distinct in lightness when printed grey; the later ones need their
# markers.
LINE_STYLES = (
    LineStyle("#0072B2", "-", "o"),
    LineStyle("#D55E00", (0, (5, 2)), "s"),
    LineStyle("#000000", (0, (6, 2, 1, 2)), "^"),
    LineStyle("#56B4E9", (0, (1, 1)), "D"),
    LineStyle("#009E73", (0, (3, 1, 1, 1, 1, 1)), "v"),
    LineStyle("#E69F00", (0, (8, 2)), "P"),
    LineStyle("#CC79A7", (0, (2, 3)), "X"),
    LineStyle("#777777", (0, (8, 2, 1, 2, 1, 2)), "<"),
    LineStyle("#0072B2", (0, (3, 1)), ">"),
    LineStyle("#D55E00", (0, (1, 3)), "p"),
)
COLOURS = tuple(line_style.colour for line_style in LINE_STYLES)
# Blur terms look the same in every figure, and differ from the first looks, which show pixel sizes.
_TERMS = {
    "lens": ("lens (diffraction)", LINE_STYLES[4]),
    "real lens": ("real lens, rms over the die", LINE_STYLES[4]),
    "motion": ("motion in an exposure", LINE_STYLES[2]),
    "photodiode": ("photodiode", LINE_STYLES[5]),
    "microlens": ("microlens, as wide as the pixel", LINE_STYLES[5]),
    "opening": ("opening over the photodiode", LINE_STYLES[5]),
    "crosstalk": ("crosstalk", LINE_STYLES[8]),
    "diffusion": ("diffusion of charge", LINE_STYLES[9]),
    "interpolation": ("{} interpolation on the display", LINE_STYLES[6]),
    "dot": ("display dot", LINE_STYLES[7]),
}
_MANY_POINTS = 50  # a line with more points gets a marker at every fifth of its length
# about one cycle at the middle frequencies, since ΔE peaks in each dark bar
ISO_SMOOTHING_DOTS = 8.0


def plain_powers(axis: Axis) -> None:
    """Label a short logarithmic axis with plain numbers at 1, 2 and 5."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: setting_text(value)))
    axis.set_minor_formatter(NullFormatter())


_PIXSIM_SETTINGS = {
    "svg.hashsalt": "pixsim",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,  # TrueType: text can be searched, and publishers take it
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def _style() -> AbstractContextManager[None]:
    import matplotlib

    defaults: dict[Any, Any] = {
        name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"
    }
    return matplotlib.rc_context(defaults | _PIXSIM_SETTINGS)


_style_block = SharedBlock(_style)


@contextmanager
def pixsim_style() -> Iterator[None]:
    """Matplotlib's defaults and `_PIXSIM_SETTINGS` within a block or a function, and the user's
    settings again after it.

    Whatever a matplotlibrc says, a figure is the same. Blocks may overlap, also in several threads.

    Raises PixsimError if the import of Matplotlib would wait for a pipe or a device.
    """
    if "matplotlib" not in sys.modules and os.path.lexists(RC_FILE) and not os.path.isfile(RC_FILE):
        raise invalid(
            RC_FILE,
            "a broken link, a pipe or a device in the current folder",
            "a file, or none",
            "Move it away.",
        )
    with _style_block:
        yield


@pixsim_style()
def prepare_to_draw() -> None:
    """Import Matplotlib, and draw an empty figure: that takes longer than those that follow.

    In the process of a command, whose user does not read Matplotlib's docstrings.
    """
    from matplotlib.artist import Artist

    # Those of `set` of all artists take a third of the import.
    Artist._update_set_signature_and_docstring = lambda: None  # type: ignore[attr-defined]
    figure = new_figure(1.0, 1.0)
    figure.subplots().set(xlabel="x", ylabel="y", title="title")
    svg_text(figure)


@contextmanager
def drawing_thread() -> Iterator[ThreadPoolExecutor]:
    """Provide one thread that draws figures one after the other; those that wait are given up if
    the block fails.
    """
    pool = ThreadPoolExecutor(1, "pixsim figures")
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return a figure that needs no display and is saved to the same bytes every time. Call and
    fill it in `pixsim_style`.
    """
    assert _style_block.is_running, "a figure takes its style from the settings while it is filled"
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def fix_margins(
    figure: Figure,
    left_in: float = 0.65,
    right_in: float = 0.15,
    bottom_in: float = 0.5,
    top_in: float = 0.3,
    between_in: float = 0.2,
) -> None:
    """Set the margins of a figure's panels, where their labels are known to have room: computing
    them takes half of a drawing.

    between_in : between panels side by side or above one another
    """
    width_in, height_in = figure.get_size_inches()
    figure.set_layout_engine(None)
    subplot = figure.axes[0].get_subplotspec()
    rows, columns = subplot.get_gridspec().get_geometry() if subplot else (1, 1)
    panel_in = (
        (width_in - left_in - right_in + between_in) / columns,
        (height_in - bottom_in - top_in + between_in) / rows,
    )
    figure.subplots_adjust(
        left=left_in / width_in,
        right=1 - right_in / width_in,
        bottom=bottom_in / height_in,
        top=1 - top_in / height_in,
        wspace=between_in / (panel_in[0] - between_in),
        hspace=between_in / (panel_in[1] - between_in),
    )


def literal(text: str) -> str:
    """Return text that Matplotlib draws literally: between dollar signs it would be read as
    mathematics.

    A character that the font does not have is drawn as one that is missing, without a warning for
    each figure.
    """
    characters = _font_characters()
    printable = "".join(
        character if character.isprintable() and ord(character) in characters else "\ufffd"
        for character in text
    )
    return printable.replace("$", r"\$")


@cache
@pixsim_style()
def _font_characters() -> frozenset[int]:
    """Return the characters of the figures' font."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties())).get_charmap())


@pixsim_style()
def svg_text(figure: Figure) -> str:
    """Return a figure as SVG with numbered ids: Matplotlib's hash coordinates whose last digit
    varies.
    """
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine(None)  # else savefig draws everything once more for the layout
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": "pixsim"})
    numbers: dict[str, str] = {}
    numbered = re.sub(
        r'(id="|url\(#|href="#)([a-zA-Z]+[0-9a-f]{10})(?=["\)])',
        lambda match: match[1] + numbers.setdefault(match[2], f"id{len(numbers)}"),
        text.getvalue(),
    )
    return re.sub(
        r"(?<=data:image/png;base64,)([^\"]+)", lambda match: _reduced_png(match[1]), numbered
    )


@pixsim_style()
def pdf_bytes(figure: Figure) -> bytes:
    """Return a figure as PDF, by Matplotlib's own writer and without a date: the same bytes every
    time.
    """
    content = io.BytesIO()
    figure.savefig(content, format="pdf", metadata={"CreationDate": None, "Creator": "pixsim"})
    return content.getvalue()


def _reduced_png(encoded: str) -> str:
    """Return a picture that Matplotlib wrote, in base64, with the same pixels in fewer bytes; as it
    is, if any is transparent.
    """
    from PIL import Image

    codes = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGBA"))
    if (codes[:, :, 3] == 255).all():
        return base64.b64encode(smallest_png(codes[:, :, :3])).decode()
    return encoded


def finish(
    axes: Axes,
    x: str,
    y: str,
    legend: Literal["best", "lower right"] | None = "best",
    handlelength: float | None = None,
) -> None:
    """Label axes, draw their grid, and put a legend of their named lines into them.

    handlelength : of a line in the legend, in font sizes. None leaves it to Matplotlib
    """
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8, loc=legend, handlelength=handlelength)


def label_axes(axes: Axes, where: PictureAxes) -> None:
    """Label the sides of a picture and hide its frame."""
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set(xlabel=where.across.label, ylabel=where.down.label)
    if where.fixed:
        axes.set_xticks(*zip(*where.across.ticks, strict=True))
        axes.set_yticks(*zip(*where.down.ticks, strict=True))


def draw_terms(axes: Axes, x: Array, terms: dict[str, Array], interpolation: str) -> Array:
    """Draw the terms of `mtf.mtf_terms` against x, with a legend, and their product, which is
    returned.
    """
    for term, mtf in terms.items():
        name, line_style = _TERMS[term]
        axes.plot(
            x,
            mtf,
            markevery=1 if x.size < _MANY_POINTS else x.size // 5,
            ms=4,
            label=name.format(interpolation),
            **line_style.line,
        )
    product = np.prod(list(terms.values()), axis=0)
    axes.plot(x, product, lw=2.5, color="black", label="product of all")
    # Their additional lines leave less room at a fixed place
    has_extra_terms = bool({"microlens", "opening", "motion"} & terms.keys())
    axes.legend(
        frameon=False,
        fontsize=8,
        loc="best" if has_extra_terms else "lower left",
        handlelength=LEGEND_LINE,
    )
    return product
