"""Limits on metrics that a user states, such as detectability>=5."""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

_REQUIREMENT = re.compile(
    r"\s*([A-Za-z_]\w{0,59})\s*(>=|<=)\s*([-+]?\d{1,15}(?:\.\d{0,15})?(?:[eE][-+]?\d{1,2})?)\s*"
)


class Requirement(NamedTuple):
    """A limit on a metric.

    metric : its name
    sign : `>=` for a least value, `<=` for a largest one
    limit : in the metric's unit
    """

    metric: str
    sign: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric} {self.sign} {self.limit:g}"

    def is_met(self, value: float) -> bool:
        """Return whether a value keeps the limit; NaN, a value that is not given, does not."""
        return value >= self.limit if self.sign == ">=" else value <= self.limit

    def is_sure(self, low: float, high: float) -> bool:
        """Return whether all values of an interval say the same."""
        return self.is_met(low) == self.is_met(high)


def requirement_of(text: str) -> Requirement:
    """Return the requirement that a text states. ValueError for another text.

    >>> requirement_of("delta_e <= 1")
    Requirement(metric='delta_e', sign='<=', limit=1.0)
    """
    match = _REQUIREMENT.fullmatch(text)
    if match is None:
        raise ValueError(
            f"got {text[:80]!r}; allowed: a metric, >= or <=, and a number, as 'detectability>=5'"
        )
    return Requirement(match[1], match[2], float(match[3]))


def _checked(text: str) -> str:
    return str(requirement_of(text)).replace(" ", "")


# As text, which settings files hold.
RequirementText = Annotated[str, AfterValidator(_checked)]


class RequirementCheck(NamedTuple):
    """Whether a result meets a requirement.

    value : of the metric
    interval : its 95 %, with the errors of the light; both ends are the value where it is unknown
    """

    requirement: Requirement
    value: float
    interval: tuple[float, float]

    @property
    def is_met(self) -> bool:
        """Whether the value keeps the limit."""
        return self.requirement.is_met(self.value)

    @property
    def is_sure(self) -> bool:
        """Whether the limit is outside of the interval."""
        return self.requirement.is_sure(*self.interval)
