"""A mean ΔE has converged if no error of its light is above its limit, and states them wherever it
is shown if not.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.runs import run_result
from helpers.tiny import tiny

import pixsim
from pixsim.base.caller import command_line
from pixsim.base.digits import with_error
from pixsim.report.curve import optimum_line
from pixsim.report.run import run_answer, shown_mean_of
from pixsim.report.study_facts import study_light_words, study_unconverged
from pixsim.report.wording import unconverged
from pixsim.show.document import plain_text
from pixsim.studies.film_error import FilmError
from pixsim.studies.result import StudyResult
from pixsim.studies.run import RunResult
from pixsim.viewer.score import LightError, converged, exceeded, noise_error_and_limit

NOISY = {
    "fraction": 2.4,
    "target": 0.2,
    "ended_by": "samples",
    "delta_e": 0.36,
}  # of which 0.03 is left at the target
QUIET = NOISY | {"fraction": 0.2, "ended_by": "target"}  # at its target
TOLERATED = NOISY | {"tolerance_delta_e": 0.1}  # in place of the target
COARSE = FilmError(
    (64, 64),
    10.0,
    (5.0, 20.0),
    (0.6, 0.2),
    (0.02, 0.02),
    "the limit of 64 samples across for 20 pictures",
)
FINE = replace(COARSE, delta_e=(0.02, 0.02), limit="")  # at what is tolerated
UNKNOWN = replace(COARSE, delta_e=(math.nan, math.nan))


@pytest.fixture(scope="module")
def study_result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    return pixsim.study(tiny(), tmp_path_factory.mktemp("tiny"), jobs=1)


def of_run(
    noise: dict[str, Any] | None, film: FilmError | None, sensors: int = 1, **known: Any
) -> RunResult:
    """A run of a mean ΔE of 0.9731."""
    header = {"render_noise": noise} if noise else {}
    return run_result([0.9731] * sensors, header, film and film.at(5.0), **known)


ABOVE = [(0.6, 0.02), (math.nan, 0.02), (math.nan, math.nan)]  # error and limit
BELOW = [(0.02, 0.02), (0.01, 0.02), (0.6, None), (math.nan, None), (None, 0.02), (0.0, 0.0)]


@pytest.mark.parametrize("film", [*ABOVE, *BELOW])
@pytest.mark.parametrize("noise", [*ABOVE, *BELOW])
def test_light_has_converged_if_no_error_is_above_its_limit(film, noise):
    """An unknown error is above any limit; without a measurement or a limit there is nothing to be
    above.
    """
    error, limit = (
        LightError(of_film, of_noise) for of_film, of_noise in zip(film, noise, strict=True)
    )
    is_above = [pair in ABOVE for pair in (film, noise)]
    assert converged(error, limit) == (not any(is_above))
    assert len(exceeded(error, limit)) == sum(is_above)


@pytest.mark.parametrize("fraction", [0.05, 0.2, 0.2 * (1 + 1e-9), 2.4])
@pytest.mark.parametrize("delta_e", [1e-4, 0.36, None])
def test_noise_is_above_its_limit_if_its_fraction_is_above_the_target(fraction, delta_e):
    """Also where its ΔE is unknown. The limit in ΔE is what is left of the error with as much less
    noise.
    """
    error, limit = noise_error_and_limit(
        {"render_noise": {"fraction": fraction, "target": 0.2, "delta_e": delta_e}}
    )
    assert converged(error, limit) == (fraction <= 0.2)
    if delta_e is not None:
        assert error.noise_delta_e == delta_e
        assert limit.noise_delta_e == pytest.approx(delta_e * 0.2 / fraction, rel=1e-12)


def test_noise_without_samples_has_converged():
    """The light of a chart is computed."""
    error, limit = noise_error_and_limit(
        {"render_noise": {"fraction": 0.0, "target": 0.2, "delta_e": 0.0}}
    )
    assert error == LightError(noise_delta_e=0.0)
    assert converged(error, limit)


@pytest.mark.parametrize(
    ("noise", "film", "shown", "reasons"),
    [
        (QUIET, FINE, "0.973", []),
        (None, None, "0.973", []),  # of another program's light nothing is known
        (
            NOISY,
            FINE,
            "0.973, not converged",
            ["the error by render noise is up to 0.4 ΔE, 0.03 tolerated"],
        ),
        (
            NOISY | {"delta_e": None},
            FINE,
            "0.973, not converged",
            ["the error by render noise is unknown, its limit exceeded"],
        ),
        (
            QUIET,
            COARSE,
            "1.0 ± 0.6 (film), not converged",
            ["the film's error is up to 0.6 ΔE, 0.02 tolerated"],
        ),
        (
            QUIET,
            UNKNOWN,
            "0.973 ± an unknown error (film), not converged",
            ["the film's error is unknown, 0.02 tolerated"],
        ),
        (NOISY, COARSE, "1.0 ± 0.6 (film), not converged", ["up to 0.6 ΔE", "up to 0.4 ΔE"]),
        (
            TOLERATED | {"delta_e": 0.2},
            FINE,
            "0.973, not converged",
            ["the error by render noise is up to 0.2 ΔE, 0.1 tolerated"],
        ),
        (TOLERATED | {"delta_e": 0.1}, FINE, "0.973", []),
    ],
)
def test_mean_of_a_run_is_as_sure_as_it_looks(noise, film, shown, reasons):
    result = of_run(noise, film)
    assert shown_mean_of(result) == shown
    lines = unconverged(result.irradiance.header, result.rendered and result.rendered.film)
    assert len(lines) == bool(reasons)
    assert all(reason in line for line in lines for reason in reasons)
    assert plain_text(run_answer(result).head) == f"mean ΔE {shown}"


@pytest.mark.parametrize(
    ("noise", "film", "means", "others"),
    [
        (NOISY, FINE, ["a longer --max-seconds"], ["--resolution"]),
        (NOISY | {"delta_e": None}, FINE, ["a longer --max-seconds"], ["--resolution"]),
        (TOLERATED, FINE, ["a longer --max-seconds"], ["--resolution"]),
        (QUIET, COARSE, ["a finer film (--resolution)"], ["--max-seconds"]),
        # the film's error does not fall with noise alone, nor the noise with the film
        (NOISY, COARSE, ["a finer film (--resolution), a longer --max-seconds, or a"], []),
    ],
)
def test_unconverged_result_says_what_makes_it_surer(noise, film, means, others):
    result = of_run(noise, film)
    with command_line():
        (line,) = unconverged(result.irradiance.header, result.rendered.film)
    assert all(words in line for words in [*means, "(--window, in mm)"])
    assert not any(words in line for words in others)


def test_picture_of_a_render_is_not_made_surer_by_options():
    """A run of an irradiance.exr: neither the time limit nor the window changes what was
    rendered.
    """
    (line,) = unconverged({"render_noise": NOISY}, None)
    assert line.endswith("For more certainty: render it again, with more samples")


@pytest.mark.parametrize(
    "found", ["loud", 1.0, [], {}, {"fraction": "a lot", "target": 0.2}, {"fraction": 3.0}]
)
def test_header_of_another_program_may_hold_anything(found):
    light, limit = noise_error_and_limit({"render_noise": found})
    assert light.noise_delta_e is None
    assert converged(light, limit)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"render_noise": NOISY}, ", not converged, 84.8 µm"),
        ({"render_noise": QUIET}, " ms>"),
        ({}, " ms>"),
    ],
)
def test_score_of_a_picture_says_whether_its_light_has_converged(header, words):
    image = pixsim.SpectralImage(
        [550.0],
        10.0,
        84.8,
        data=np.full((32, 32, 1), 1e-3),
        header={"diffraction": False, **header},
    )
    pixel = pixsim.Pixel(pitch_um=84.8, prnu=0, infrared_cut_nm=700)
    score = pixsim.evaluate(
        image, pixsim.Camera(), pixel, display=pixsim.Display(white_cd_per_m2=1000, dots=32)
    )
    assert words in repr(score)
    cell = score._repr_html_()
    assert (
        "Not converged: the error by render noise is up to 0.4 ΔE, 0.03 tolerated." in cell
    ) == ("not converged" in words)


def test_study_shows_the_errors_of_its_light(study_result: StudyResult):
    """The film counts at the best pixel size: its error is interpolated in log pitch between those
    measured.
    """
    (curve,) = study_result.curves[:1]
    best_um = float(curve.pitch_um[np.argmin(curve.mean())])
    header = study_result.irradiance.header | {"render_noise": NOISY}
    quiet = study_result.irradiance.with_planes(
        study_result.irradiance.planes, header=header | {"render_noise": QUIET}
    )
    ends_um = best_um / 4, best_um * 4
    film = replace(
        COARSE, pitch_um=ends_um, limit="set by --resolution"
    )  # 0.4 in the middle of 0.6 and 0.2
    for error, of_error in (
        (film, "± 0.4 (film), not converged"),
        (replace(FINE, pitch_um=ends_um), None),
    ):
        shown = replace(
            study_result,
            light=replace(study_result.light, image=quiet, film=error),
            curves=(curve,),
        )
        lines = study_unconverged(shown)
        found = [optimum_line(shown.curves[0]), shown._repr_html_()]
        assert len(lines) == bool(of_error)
        assert all((of_error or "not converged") in words for words in found) == bool(of_error)
    noisy = replace(
        shown, light=replace(shown.light, image=quiet.with_planes(quiet.planes, header=header))
    )
    assert all(
        "not converged" in words
        for words in (optimum_line(noisy.curves[0]), *study_unconverged(noisy))
    )


def test_study_states_its_field_and_exposure(study_result: StudyResult):
    (line,) = study_light_words(study_result)
    times_ms = 1e3 * np.concatenate([curve.mean("integration_s") for curve in study_result.curves])
    ends = dict.fromkeys(f"{time_ms:.3g}" for time_ms in (times_ms.min(), times_ms.max()))
    assert line.endswith(f"exposed for {' to '.join(ends)} ms")
    assert f"a field of {study_result.camera.fov_deg:.3g}°" in line


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.9731, 0.0, "0.9731 ± 0.0000"),
        (0.9731, 0.00012, "0.9731 ± 0.0001"),
        (0.9731, 0.096, "1.0 ± 0.1"),
        (21.7, 14.2, "22 ± 14"),
    ],
)
def test_digits_follow_the_error(value, error, shown):
    assert with_error(value, error) == shown
