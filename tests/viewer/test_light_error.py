"""A mean ΔE has converged if no error of its light is above its limit; results state errors that
are.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.runs import run_result

import pixsim
from pixsim.base.caller import command_line
from pixsim.base.digits import with_error
from pixsim.report.run import shown_mean_of
from pixsim.report.wording import unconverged
from pixsim.studies.film_error import FilmError
from pixsim.viewer.score import LightError, converged, exceeded, noise_error_and_limit

NOISY = {"fraction": 2.4, "target": 0.2, "ended_by": "samples", "delta_e": 0.36}
QUIET = NOISY | {"fraction": 0.2, "ended_by": "target"}
TOLERATED = NOISY | {"tolerance_delta_e": 0.1}  # in place of the target
COARSE = FilmError((64, 64), 10.0, (5.0, 20.0), (0.6, 0.2), (0.02, 0.02), "the limit of 64")
FINE = replace(COARSE, delta_e=(0.02, 0.02), limit="")
UNKNOWN = replace(COARSE, delta_e=(math.nan, math.nan))
# Error and limit.
ABOVE = [(0.6, 0.02), (math.nan, 0.02), (math.nan, math.nan)]
BELOW = [(0.02, 0.02), (0.6, None), (math.nan, None), (None, 0.02), (0.0, 0.0)]


@pytest.mark.parametrize("film", [*ABOVE, *BELOW])
@pytest.mark.parametrize("noise", [*ABOVE, *BELOW])
def test_light_has_converged_if_no_error_is_above_its_limit(film: Any, noise: Any) -> None:
    """An unknown error is above any limit; one that is not measured, or has no limit, is not."""
    error, limit = (LightError(*pair) for pair in zip(film, noise, strict=True))
    count = sum(pair in ABOVE for pair in (film, noise))
    assert converged(error, limit) == (count == 0)
    assert len(exceeded(error, limit)) == count


def test_largest_error_comes_first() -> None:
    """An unknown one is infinite."""
    limit = LightError(0.02, 0.01)
    assert list(exceeded(LightError(0.6, 2.8), limit)) == ["noise_delta_e", "film_delta_e"]
    assert list(exceeded(LightError(math.nan, 2.8), limit)) == ["film_delta_e", "noise_delta_e"]


@pytest.mark.parametrize("fraction", [0.0, 0.05, 0.2, 2.4])
@pytest.mark.parametrize("delta_e", [0.36, None])
def test_error_of_a_render_falls_with_its_noise(fraction: float, delta_e: float | None) -> None:
    """The limit is the error that as much less noise leaves: δ · target/fraction."""
    stated = {"fraction": fraction, "target": 0.2, "delta_e": delta_e}
    error, limit = noise_error_and_limit({"render_noise": stated})
    assert converged(error, limit) == (fraction <= 0.2)
    if delta_e is not None and fraction:
        assert error.noise_delta_e == delta_e
        assert limit.noise_delta_e == pytest.approx(delta_e * 0.2 / fraction, rel=1e-12)


@pytest.mark.parametrize("stated", ["loud", 1.0, [], {}, {"fraction": "a lot", "target": 0.2}])
def test_header_of_another_program_may_hold_anything(stated: Any) -> None:
    error, limit = noise_error_and_limit({"render_noise": stated})
    assert error.noise_delta_e is None
    assert converged(error, limit)


@pytest.mark.parametrize(
    ("noise", "film", "mean", "remedies"),
    [
        (QUIET, FINE, "0.973", []),
        (None, None, "0.973", []),
        (TOLERATED | {"delta_e": 0.1}, FINE, "0.973", []),
        (NOISY, FINE, "0.973, not converged", ["--max-seconds"]),
        (NOISY | {"delta_e": None}, FINE, "0.973, not converged", ["--max-seconds"]),
        (TOLERATED, FINE, "0.973, not converged", ["--max-seconds"]),
        (QUIET, COARSE, "1.0 ± 0.6 (film), not converged", ["--resolution"]),
        (QUIET, UNKNOWN, "0.973 ± an unknown error (film), not converged", ["--resolution"]),
        (NOISY, COARSE, "1.0 ± 0.6 (film), not converged", ["--resolution", "--max-seconds"]),
    ],
)
def test_mean_of_a_run_states_its_error_and_what_reduces_it(
    noise: Any, film: FilmError | None, mean: str, remedies: list[str]
) -> None:
    header = {"render_noise": noise} if noise else {}
    result = run_result([0.9731], header, film and film.at(5.0))
    assert shown_mean_of(result) == mean
    with command_line():
        lines = unconverged(header, result.rendered and result.rendered.film)
    options = [name for name in ("--resolution", "--max-seconds") if name in "".join(lines)]
    assert options == remedies


@pytest.mark.parametrize(("noise", "is_converged"), [(NOISY, False), (QUIET, True)])
def test_score_of_a_picture_says_whether_its_light_has_converged(
    noise: dict[str, Any], is_converged: bool
) -> None:
    header = {"diffraction": False, "render_noise": noise}
    data = np.full((32, 32, 1), 1e-3)
    image = pixsim.SpectralImage([550.0], 10.0, 84.8, data=data, header=header)
    pixel = pixsim.Pixel(pitch_um=84.8, prnu=0, infrared_cut_nm=700)
    display = pixsim.Display(white_cd_per_m2=1000, dots=32)
    score = pixsim.evaluate(image, pixsim.Camera(), pixel, display=display)
    assert ("not converged" not in repr(score)) == is_converged


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (0.9731, 0.0, "0.9731 ± 0.0000"),
        (0.9731, 0.00012, "0.9731 ± 0.0001"),
        (0.9731, 0.096, "1.0 ± 0.1"),
        (21.7, 14.2, "22 ± 14"),
    ],
)
def test_digits_follow_the_error(value: float, error: float, words: str) -> None:
    assert with_error(value, error) == words
