"""Scores of pictures from other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pixsim.base.arrays import Array, Finites
from pixsim.base.digits import percent
from pixsim.base.errors import invalid
from pixsim.base.notes import Note, warn
from pixsim.viewer.display import shown_luminance
from pixsim.viewer.display_options import Display
from pixsim.viewer.evaluate import with_numbers
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricContext, MetricRequest
from pixsim.viewer.score import Score
from pixsim.viewer.screen import CLIPPED_WARNING, Screen, fraction_beyond_white, perceived_lab


def score_pictures(
    ideal: Finites,
    image: Finites,
    display: Display | None = None,
    *,
    metrics: Sequence[str | Callable[[Score], float]] = ("delta_e",),
) -> Score:
    """Show two pictures on a display, and compare them by S-CIELAB: pictures that somebody else
    processed or made.

    Both are rounded to the codes of the display and clipped to its range, as the pictures of
    `pixsim.evaluate` are. The pictures of a score of `evaluate` are shown already, and codes of
    codes are the same: its pictures give its ΔE again, bit for bit.

    ideal, image : light of the dots, linear, 1 for white: (H, W), or (H, W, 3) of the display's
        primaries, which are the primaries of sRGB
    display : its codes (gamma, bits), its viewer (samples_per_deg), filters and delta_e; a value is
        a dot, so that raster, dots and white are not used. None means the default
    metrics : names of metrics of the shown picture that need no sensor, or functions of the Score
        that return a number; theirs are the score's `metrics`

    Raises PixsimError for pictures of other shapes, for values that are not finite or are codes,
    and for a metric that needs a sensor's frame.

    >>> grey = np.full((64, 64), 0.5)
    >>> score_pictures(grey, grey).mean_delta_e
    0.0
    >>> def mean_error(score):
    ...     return abs(float((score.image - score.ideal).mean()))
    >>> display = Display(gamma=1.0, bits=16)
    >>> score = score_pictures(grey, 0.25 * grey, display, metrics=["delta_e", mean_error])
    >>> {name: round(value, 3) for name, value in score.metrics.items()}
    {'delta_e': 34.069, 'mean_error': 0.375}
    """
    display = display or Display()
    request = MetricRequest(metrics_named(metrics))
    ideal = np.asarray(ideal)
    image = np.asarray(image)
    _check_picture("ideal", ideal)
    _check_picture("image", image)
    if ideal.shape != image.shape:
        got = f"arrays of shapes {ideal.shape} and {image.shape}"
        hint = "Resample one to the dots of the other."
        if ideal.ndim != image.ndim:
            hint = (
                "Grey light is that of three equal primaries: np.repeat(grey[..., None], 3,"
                " axis=2)."
            )
        raise invalid("ideal and image", got, "equal shapes", hint)
    request.check(MetricContext(is_colour=ideal.ndim == 3, has_background=False, has_frame=False))

    ideal = ideal.astype(float)
    image = image.astype(float)
    beyond_white = fraction_beyond_white(ideal if ideal.ndim == 2 else np.moveaxis(ideal, 2, 0))
    if beyond_white > CLIPPED_WARNING:
        warn(Note("white_clipped", share=percent(beyond_white), hint="white is 1"))
    ideal = shown_luminance(ideal, display)
    image = shown_luminance(image, display)

    # A dot is a unit of length.
    rows, columns = ideal.shape[:2]
    screen = Screen(
        display,
        size_um=(float(rows), float(columns)),
        dot_edges_um=(np.arange(rows + 1.0), np.arange(columns + 1.0)),
        ideal=ideal,
        ideal_lab=perceived_lab(ideal, display),
    )
    score = Score(screen.delta_e_map(image), ideal, image, display)
    return with_numbers(score, request.chosen, score)


def _check_picture(name: str, picture: Array) -> None:
    """Raise PixsimError for a picture of another shape, or of codes in place of light."""
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)) or not picture.size:
        allowed = "(H, W), or (H, W, 3) of the display's primaries, not empty"
        raise invalid(name, f"an array of shape {picture.shape}", allowed)
    if picture.dtype.kind in "iu" and picture.max() > 1:
        got = f"whole numbers up to {picture.max()}, which are codes"
        hint = "Codes of sRGB become light by colour.eotf(codes / 255, 'sRGB'), of colour-science."
        raise invalid(name, got, "linear light, 1 for white", hint)
