"""Every extreme case meets its known answer without a warning; wrong results fail."""

import math

import numpy as np
import pytest

from pixsim.verification import stability
from pixsim.verification.stability import ExtremeCase, compare


@pytest.fixture(scope="module", params=stability.ROOMS)
def cases(request: pytest.FixtureRequest) -> list[ExtremeCase]:
    return list(stability.cases_of(request.param))


def test_cases_of_each_module_pass(cases: list[ExtremeCase]) -> None:
    wrong = [case for case in cases if not case.passed]
    assert cases
    assert not wrong, "\n".join(
        f"{c.name}: expected {c.expected:.9g}, got {c.got:.9g}, {c.error:.2g} > {c.allowed:.2g} {c.warned}" for c in wrong
    )


def test_compare_wrong_or_nan_fails() -> None:
    assert compare("right", [1.0, 2.0], [1.0, 2.0 + 1e-9], 1e-8, "").passed
    worst = compare("wrong", [1.0, 2.0], [1.0, 2.1], 1e-2, "")
    assert (worst.passed, worst.expected, worst.got) == (False, 2.0, 2.1)
    assert not compare("nan", [1.0, 1.0], [1.0, math.nan], 1.0, "").passed
    assert not compare("not zero", [0.0], [1e-300], 1.0, "").passed
    assert compare("of a scale", [0.0], [1e-3], 1e-2, "", scale=1.0).passed
    assert not compare("infinite", [1.0], [np.inf], 1e9, "").passed
