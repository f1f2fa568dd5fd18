"""Closed forms as rows of a table: a call, its expected value, a tolerance and its reason.

    CLAIMS = [
        Claim(
            "shot noise is the root of the charge",
            lambda: shot_noise_e(10_000.0),
            100.0,
            rtol=1e-12,
            why="rounding",
        ),
    ]

    @pytest.mark.parametrize("claim", CLAIMS, ids=str)
    def test_closed_forms(claim: Claim) -> None:
        claim.check()

A claim that fails says what the physics expects, what came, and by how much it missed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Claim:
    """A call whose value is known from elsewhere.

    name : the claim, as a sentence
    call : returns a number or array
    expected : number or array of the same shape
    rtol, atol : what |got − expected| may be: atol + rtol·|expected|
    why : the reason of the tolerance: rounding, a published digit, sampling …
    """

    name: str
    call: Callable[[], ArrayLike]
    expected: ArrayLike
    rtol: float = 0.0
    atol: float = 0.0
    why: str = "rounding"

    def __str__(self) -> str:
        return self.name

    def check(self) -> None:
        check(self.name, self.call(), self.expected, rtol=self.rtol, atol=self.atol, why=self.why)


def check(name: str, value, expected, *, rtol: float = 0.0, atol: float = 0.0, why: str) -> None:
    """Raises AssertionError with the expected value, the value and the worst miss in units of the
    tolerance.
    """
    got, wanted = np.asarray(value), np.asarray(expected)
    assert got.shape == wanted.shape, f"{name}: expected shape {wanted.shape}, got {got.shape}"
    with np.errstate(divide="ignore", invalid="ignore"):
        miss = np.abs(got - wanted)
        tolerance = atol + rtol * np.abs(wanted)
        # NaN misses, equal infinities do not; any number is within a share of infinity.
        missed = ~((miss <= tolerance) & np.isfinite(wanted) | (got == wanted))
        if not missed.any():
            return

        ratio = np.nan_to_num(np.where(missed, miss / tolerance, 0.0), nan=np.inf)
    worst = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    place = f" at {tuple(map(int, worst))}" if wanted.ndim else ""
    share = f"; {missed.sum()} of {missed.size} values miss" if wanted.ndim else ""
    raise AssertionError(
        f"{name}: expected {wanted[worst]:.10g}{place}, got {got[worst]:.10g}, off by "
        f"{miss[worst]:.3g}: {ratio[worst]:.3g} times the tolerance ({why}){share}"
    )
