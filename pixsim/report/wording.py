"""Parts of several pages: captions, what suits several conditions, and the contrast that blur leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pixsim.base.digits import interval
from pixsim.show.document import Answer, Strong, joined
from pixsim.studies.merit import detail_terms
from pixsim.studies.regret import Regrets, weighted_criterion

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.viewer.imaging import Imaging

DELTA_E = (
    "ΔE is the visible difference between a sensor's picture and that of an ideal camera: the CIELAB colour difference after the "
    "blur of the eye (S-CIELAB). A ΔE of 1 is about the smallest difference noticeable under ideal conditions."
)


def map_words(start: str, mean: float, p99: float, end: float) -> str:
    """Return the caption of a ΔE map from its mean and 99th percentile; the colour scale ends at `end`."""
    return (
        f"{start}{'the' if start else 'The'} mean ΔE is {mean:.3f}, and one dot in a hundred has more than {p99:.3g}."
        f" The colours go from 0 to {end:g}; larger errors have the last one. Compare maps of the same scale."
    )


def rendered_words(header: Mapping[str, Any]) -> str:
    """Return the scene that light was rendered from, and how; or the file of another program that it was read from."""
    if "scene_hash" not in header:
        return f"read from {header['source']}" if "source" in header else "given, not rendered"
    rays = f"{header['spp']} rays for each sample of the film" if header["spp"] else "computed from the chart"
    return f"{header['scene']} (hash {header['scene_hash']}), {rays}, {header['variant']}"


def weighted_answer(regrets: Regrets) -> Answer:
    """Return the pixel size with the best weighted mean over conditions; that there is none where they share too few sizes."""
    weighted = weighted_criterion(regrets)
    if weighted is None:
        return Answer(f"{regrets.label}: the conditions share too few pixel sizes for one that suits all")
    best, metric = weighted.optimum, weighted.metric
    value = f"{best.value:.3f}" if metric.is_delta_e else metric.shown(best.value)
    first, _, words = metric.best.partition(" ")
    label = f"{regrets.label}: {first} weighted {words} {value} at "
    return Answer(joined([label, (Strong(f"{best.pitch_um:.2f} µm"), f" (95 %: {interval(best.interval_um)})")], ""))


def blur_words(imaging: Imaging, irradiance: SpectralImage, path_um: float = 0.0) -> str:
    """Return sentences on the contrast left by each term at `detail_frequency_lp_per_mm`.

    path_um : of light that moves in an exposure
    """
    frequency, name, terms, of_display = detail_terms(imaging, irradiance, path_um)
    left, *others = (f"{term} {'is ' * ('lens' in term.split())}{mtf:.3f}" for term, mtf in terms.items())
    *some, last = (f"that of the {words}" for words in others)
    words = f"At {frequency:.3g} lp/mm, {name}, the MTF of the {', '.join([left, *some])} and {last}: "
    words += f"together they reduce the contrast by {100 * (1 - math.prod(terms.values())):.0f} %. "
    if not of_display:
        return words + "The display shows each pixel as one dot and reduces it no further."
    lost = 1 - math.prod(of_display.values())
    return words + (
        f"On the display, the MTF of the {imaging.display.interpolation} interpolation is {of_display['interpolation']:.3f} and "
        f"that of the dots {of_display['dot']:.3f}: they reduce the recorded contrast by another {100 * lost:.0f} %."
    )
