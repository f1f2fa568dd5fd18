"""A mean ΔE states the errors of its light wherever it is shown, if they are above their limits."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.runs import run_result
from helpers.tiny import tiny

import pixsim
from pixsim.base.caller import command_line
from pixsim.show.document import plain_text
from pixsim.show.sentences import with_error
from pixsim.studies.film_error import FilmError
from pixsim.studies.result import StudyResult
from pixsim.studies.run import RunResult
from pixsim.studies.sentences import optimum_line, score_parts, study_light_words, study_unconverged, unconverged
from pixsim.viewer.light_error import LightError

NOISY = {"fraction": 2.4, "target": 0.2, "ended_by": "samples"}
QUIET = NOISY | {"fraction": 0.2, "ended_by": "target"}  # at its target
TOLERATED = NOISY | {"tolerance_delta_e": 0.1}  # in ΔE, in place of the target
COARSE = FilmError((64, 64), 10.0, (5.0, 20.0), (0.6, 0.2), (0.02, 0.02), "the limit of 64 samples across for 20 pictures")
FINE = replace(COARSE, delta_e=(0.02, 0.02), limit="")  # at what is tolerated
UNKNOWN = replace(COARSE, delta_e=(math.nan, math.nan))


@pytest.fixture(scope="module")
def study_result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    return pixsim.study(tiny(), tmp_path_factory.mktemp("tiny"), jobs=1)


def of_run(noise: dict[str, Any] | None, film: FilmError | None, sensors: int = 1, **known: Any) -> RunResult:
    """A run of a mean ΔE of 0.9731."""
    header = {"render_noise": noise} if noise else {}
    return run_result([0.9731] * sensors, header, film and film.at(5.0).as_dict(), **known)


@pytest.mark.parametrize(
    ("noise", "film", "shown", "reasons"),
    [
        (QUIET, FINE, "0.973", []),
        (None, None, "0.973", []),  # of another program's light nothing is known
        (NOISY, FINE, "0.973, not converged", ["render noise is 2.4 of the sensor's noise, target 0.2"]),
        (QUIET, COARSE, "1.0 ± 0.6 (film), not converged", ["the film's error is up to 0.6 ΔE, 0.02 tolerated"]),
        (QUIET, UNKNOWN, "0.973 ± an unknown error (film), not converged", ["the film's error is unknown, 0.02 tolerated"]),
        (NOISY, COARSE, "1.0 ± 0.6 (film), not converged", ["up to 0.6 ΔE", "2.4 of the sensor's"]),
        (TOLERATED | {"delta_e": 0.2}, FINE, "0.973, not converged", ["render noise makes up to 0.2 ΔE, 0.1 tolerated"]),
        (TOLERATED | {"delta_e": 0.1}, FINE, "0.973", []),
    ],
)
def test_mean_of_a_run_is_as_sure_as_it_looks(noise, film, shown, reasons):
    result = of_run(noise, film)
    assert result.shown_mean == shown
    lines = unconverged(result.irradiance.header, result.film)
    assert len(lines) == bool(reasons)
    assert all(reason in line for line in lines for reason in reasons)
    assert plain_text(score_parts(result)[0]).startswith(f"mean ΔE {shown}{',' * bool(reasons)} with 8 × 8 pixels")


@pytest.mark.parametrize(
    ("noise", "limit", "means", "others"),
    [
        # 12² times the samples, in twice the 30 s that the limit of samples takes on two cores
        (NOISY, "", ["--max-seconds 8000 (about 140 times"], ["--resolution"]),
        (NOISY | {"ended_by": "max_seconds"}, "", ["a longer --max-seconds (about 140 times"], ["9000"]),
        (QUIET, "set by --resolution", ["leaving out --resolution"], ["--max-seconds"]),
        (QUIET, "as --max-seconds allows", ["a longer --max-seconds"], ["--resolution", "times"]),
        (QUIET | {"fraction": 2.4, "target": 3.0}, "", ["a lower --render-noise, or"], ["--max-seconds"]),
        # the film's error does not fall with noise alone, nor the noise with the film
        (NOISY, "set by --resolution", ["leaving out --resolution and --max-seconds 8000 (about 140 times", "), or a"], []),
        (QUIET, "the limit of 64 samples across", ["To be surer: a smaller part of the die"], ["--resolution", "--max-seconds"]),
    ],
)
def test_unconverged_result_says_what_makes_it_surer(noise, limit, means, others):
    result = of_run(noise, replace(COARSE, limit=limit))
    with command_line():
        (line,) = unconverged(result.irradiance.header, result.film)
    assert all(words in line for words in [*means, "(--window, in mm)"])
    assert not any(words in line for words in others)


def test_picture_of_a_render_is_not_made_surer_by_options():
    """A run of an irradiance.exr: neither the time limit nor the window changes what was rendered."""
    (line,) = unconverged({"render_noise": NOISY}, None)
    assert line.endswith("To be surer: a render of its own, with more samples")


@pytest.mark.parametrize("found", ["loud", 1.0, [], {}, {"fraction": "a lot", "target": 0.2}, {"fraction": 3.0}])
def test_header_of_another_program_may_hold_anything(found):
    light = LightError.of({"render_noise": found})
    assert (light.noise_delta_e, light.converged, light.unmeasured) == (None, True, "")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"render_noise": NOISY, "scene_hash": "a"}, ", not converged, 84.8 µm"),
        ({"scene_hash": "a"}, "; the film's error and render noise not measured>"),
        ({"render_noise": QUIET, "scene_hash": "a"}, "; the film's error not measured>"),
        ({}, " ms>"),
    ],
)
def test_score_of_a_picture_says_what_is_known_of_its_light(header, words):
    image = pixsim.SpectralImage([550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header={"diffraction": False, **header})
    pixel = pixsim.Pixel(pitch_um=84.8, prnu=0, infrared_cut_nm=700)
    score = pixsim.evaluate(image, pixsim.Camera(), pixel, display=pixsim.Display(white_cd_per_m2=1000, dots=32))
    assert words in repr(score)
    cell = score._repr_html_()
    assert ("Not converged: render noise is 2.4" in cell) == ("not converged" in words)
    assert ("pixsim.study measure" in cell) == ("not measured" in repr(score))


def test_study_shows_the_errors_of_its_light(study_result: StudyResult):
    """The film counts at the best pixel size: its error is interpolated in log pitch between those measured."""
    (curve,) = study_result.curves[:1]
    best_um = float(curve.pitch_um[np.argmin(curve.mean())])
    header = study_result.irradiance.header | {"render_noise": NOISY}
    quiet = study_result.irradiance.with_planes(study_result.irradiance.planes, header=header | {"render_noise": QUIET})
    ends_um = best_um / 4, best_um * 4
    film = replace(COARSE, pitch_um=ends_um, limit="set by --resolution")  # 0.4 in the middle of 0.6 and 0.2
    for error, of_error in ((film, "± 0.4 (film), not converged"), (replace(FINE, pitch_um=ends_um), None)):
        shown = replace(study_result, irradiance=quiet, curves=(curve,), film=error)
        lines = study_unconverged(shown)
        found = [optimum_line(shown.curves[0]), shown._repr_html_(), repr(shown)]
        assert len(lines) == bool(of_error)
        assert all((of_error or "not converged") in words for words in found) == bool(of_error)
    noisy = replace(shown, irradiance=quiet.with_planes(quiet.planes, header=header))
    assert all("not converged" in words for words in (repr(noisy), optimum_line(noisy.curves[0]), *study_unconverged(noisy)))


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
        (0.9731, 0.096, "0.97 ± 0.10"),
        (21.7, 14.2, "21.7 ± 14.2"),
    ],
)
def test_digits_follow_the_error(value, error, shown):
    assert with_error(value, error) == shown
