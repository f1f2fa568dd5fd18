"""The metrics that settings may name: pixsim's, and those of installed packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING

from pixsim.base.errors import invalid
from pixsim.viewer.metrics import DELTA_E, Metric, own_metric
from pixsim.viewer.raw_metrics import DETECTABILITY, INFORMATION, MTF50, NIIRS, SNR10_LX
from pixsim.viewer.shown_metrics import ACUTANCE, FLIP, VISUAL_NOISE

if TYPE_CHECKING:
    from pixsim.viewer.score import Score

    NamedOrOwn = str | Callable[[Score], float]

GROUP = "pixsim.metrics"  # of entry points, each of which is a function of a Score
METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (DELTA_E, DETECTABILITY, INFORMATION, ACUTANCE, VISUAL_NOISE, MTF50, SNR10_LX, NIIRS, FLIP)
}


_functions: dict[str, Metric] = {}  # of the user's, that a call of this process named last


@cache
def installed_metrics() -> dict[str, Metric]:
    """Return the metrics of installed packages, by the names of their entry points in the group `pixsim.metrics`."""
    return {entry.name: own_metric(entry.load()) for entry in metadata.entry_points(group=GROUP) if entry.name not in METRICS}


def metrics_named(names: Sequence[NamedOrOwn]) -> tuple[Metric, ...]:
    """Return metrics by their names, and those of functions. Raises PixsimError for an unknown name, or one that is there twice.

    names : of metrics, or functions of a `pixsim.Score`
    """
    found: dict[str, Metric] = {}
    for name in names:
        if not isinstance(name, str):
            metric = _functions[name.__name__] = own_metric(name)
        elif name in _functions:
            metric = _functions[name]
        elif name in METRICS:
            metric = METRICS[name]
        elif name in installed_metrics():
            metric = installed_metrics()[name]
        else:
            hint = "A function of your own is given in Python: metrics=[…, my_metric]."
            raise invalid("metrics", f"'{name}'", f"any of {', '.join([*METRICS, *installed_metrics()])}", hint)
        if metric.name in found or (metric.name in METRICS and metric is not METRICS[metric.name]):
            raise invalid("metrics", f"'{metric.name}' twice", "metrics of different names")
        found[metric.name] = metric
    if not found:
        raise invalid("metrics", "none", f"at least one of {', '.join(METRICS)}")
    return tuple(found.values())
