"""The metrics that settings may name: pixsim's own, and metrics of installed packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import metadata

from pixsim.base.errors import did_you_mean, invalid, one_line
from pixsim.base.schema import KEY
from pixsim.viewer.metrics import DELTA_E, ROW_COLUMNS, Metric, columns_of_metrics, user_metric
from pixsim.viewer.raw_metrics import (
    CONTRAST_DETECTION,
    DETECTABILITY,
    INFORMATION,
    MTF50,
    NIIRS,
    SNR10_LX,
)
from pixsim.viewer.score import Score
from pixsim.viewer.shown_metrics import ACUTANCE, FLIP, NPWE, VISUAL_NOISE

_NameOrFunction = str | Callable[[Score], float]
_GROUP = "pixsim.metrics"  # of entry points, each of which is a function of a Score
_FRAME_METRICS = DETECTABILITY, INFORMATION, MTF50, NIIRS, CONTRAST_DETECTION
PICTURE_METRICS = ACUTANCE, VISUAL_NOISE, NPWE, FLIP, SNR10_LX
METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (DELTA_E, *_FRAME_METRICS, *PICTURE_METRICS)
}


# No metric of a user's may have the name of a column, or of a metric.
_RESERVED_NAMES = {
    KEY,
    *ROW_COLUMNS,
    "condition",
    "pair",
    "pixel",
    *METRICS,
    *columns_of_metrics(tuple(METRICS.values())),
}

_functions: dict[str, Metric] = {}  # of the user's, that a call of this process named last


def _installed_metrics() -> dict[str, metadata.EntryPoint]:
    """Return the metrics of installed packages, by the names of their entry points in the group
    `pixsim.metrics`.
    """
    return {
        entry.name: entry
        for entry in metadata.entry_points(group=_GROUP)
        if entry.name not in METRICS
    }


@cache
def installed_metric(entry: metadata.EntryPoint) -> Metric:
    """Return the metric of an entry point. Raises PixsimError if its package fails."""
    try:
        return user_metric(entry.load(), entry.name)
    except Exception as error:  # whatever its package raises
        package = entry.dist.name if entry.dist else entry.module
        got = (
            f"'{entry.name}' of the package {package}, which fails ({type(error).__name__}:"
            f" {one_line(str(error), 200)})"
        )
        raise invalid("metrics", got, "an entry point that names a function of a Score") from None


def metrics_named(names: Sequence[_NameOrFunction]) -> tuple[Metric, ...]:
    """Return the metrics of names and functions. Raises PixsimError for an unknown name, or one
    that is there twice.

    names : of metrics, or functions of a `pixsim.Score`
    """
    metrics: dict[str, Metric] = {}
    for name in names:
        if not isinstance(name, str):
            metric = user_metric(name)
        elif name in METRICS:
            metric = METRICS[name]
        elif name in _functions:
            metric = _functions[name]
        elif name in (installed := _installed_metrics()):
            metric = installed_metric(installed[name])
        else:
            function_hint = "Give your own function in Python: metrics=[…, my_metric]."
            hint = f"{did_you_mean(name, [*METRICS, *installed])} {function_hint}".strip()
            raise invalid(
                "metrics", f"'{name}'", f"any of {', '.join([*METRICS, *installed])}", hint
            )
        if metric.code and metric.name in _RESERVED_NAMES:
            raise invalid(
                "metrics",
                f"a function '{metric.name}', whose name pixsim uses itself",
                "another name for the function",
            )
        if metric.name in metrics:
            raise invalid("metrics", f"'{metric.name}' twice", "metrics with different names")
        metrics[metric.name] = metric
    if not metrics:
        raise invalid("metrics", "none", f"at least one of {', '.join(METRICS)}")
    _functions.update(
        {name: metric for name, metric in metrics.items() if metric.code and name not in names}
    )
    return tuple(metrics.values())


def metric_names(metrics: Sequence[_NameOrFunction]) -> tuple[str, ...]:
    """Return the names of metrics for settings, and register the functions among them in this
    process.

    metrics : as in `metrics_named`
    """
    return tuple(metric.name for metric in metrics_named(metrics))
