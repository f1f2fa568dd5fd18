"""A row of the table of extreme cases, and its outcome."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array

_Quantity = ArrayLike | Callable[..., ArrayLike]
# In place of an expected value: each call's last argument, which `call` does not get, is expected.
ANSWERS = None


@dataclass(frozen=True)
class ExtremeCase:
    """The outcome of an extreme case.

    expected, got : of the element with the largest error
    error : |got - expected| of that element over the scale of the case; NaN never passes
    allowed : limit of the error, with its reason in `source`
    source : of the expected value
    warned : warnings of NumPy or Python, which make the case fail
    """

    room: str
    name: str
    expected: float
    got: float
    error: float
    allowed: float
    source: str
    warned: str = ""

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed and not self.warned

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"passed": self.passed}


@dataclass(frozen=True)
class KnownAnswer:
    """A row of the table: a kernel called with each of its inputs, and what it must return.

    name : of the case
    call : returns a number or an array
    expected : a number, or a function of the arguments of `call`; it broadcasts to what `call`
        returns. None takes the last of the arguments, which `call` does not get
    tolerance : largest error, relative to `scale`
    source : of the expected value, and the reason of the tolerance
    inputs : the arguments of each call; a value that is not a tuple is the only argument
    scale : as `expected`. None is the expected value, and zeros must match exactly
    """

    name: str
    call: Callable[..., ArrayLike]
    expected: _Quantity | None
    tolerance: float
    source: str
    inputs: Iterable[Any] = ((),)
    scale: _Quantity | None = None

    def check(self, room: str = "") -> ExtremeCase:
        """Return the worst element of all calls, with the warnings that they raised."""
        inputs = [
            arguments if isinstance(arguments, tuple) else (arguments,) for arguments in self.inputs
        ]
        answer_index = -1 if self.expected is ANSWERS else None
        with (
            warnings.catch_warnings(record=True) as caught,
            np.errstate(all="warn", under="ignore"),
        ):
            warnings.simplefilter("always")
            results = [
                np.asarray(self.call(*arguments[:answer_index]), float) for arguments in inputs
            ]
        got = np.concatenate([result.ravel() for result in results])
        expected = _elements(self.expected, inputs, results)
        scale = np.abs(expected) if self.scale is None else _elements(self.scale, inputs, results)

        difference = np.abs(got - expected)
        exact = np.where(difference == 0, 0.0, np.inf)
        error = np.divide(difference, scale, out=exact, where=(scale > 0) | np.isnan(difference))
        worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
        warned = "; ".join(sorted({str(warning.message) for warning in caught}))
        answers = float(expected[worst]), float(got[worst]), float(error[worst])
        return ExtremeCase(room, self.name, *answers, self.tolerance, self.source, warned)


def _elements(
    quantity: _Quantity | None, inputs: Sequence[tuple[Any, ...]], results: Sequence[Array]
) -> Array:
    """Return a quantity for each element of the results, (n,)."""
    elements = []
    for arguments, result in zip(inputs, results, strict=True):
        if callable(quantity):
            value = quantity(*arguments)
        elif quantity is ANSWERS:
            value = arguments[-1]
        else:
            value = quantity
        elements.append(np.broadcast_to(value, result.shape).ravel())
    return np.concatenate(elements)
