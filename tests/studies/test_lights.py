"""Lights of a study's cases: the film is measured with the most light, and holds with less."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pixsim.studies.design import Case
from pixsim.studies.engine import Workers
from pixsim.studies.film_error import FilmError
from pixsim.studies.lights import Light, render_for, render_lights
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Study
from pixsim.viewer.merging import merge

LUMINANCE = "scene.parameters.luminance_cd_per_m2"
LIGHT = {"name": "light", "set": [LUMINANCE, "display.white_cd_per_m2"], "values": [10.0, 1000.0]}
LENS = {"name": "lens", "set": "camera.f_number", "values": [2.8, 8.0]}
# Cells that are computed, four for each of 64 details and more.
SMALL = {
    "name": "small",
    "resolution": 256,
    "repeats": 2,
    "scene": {"file": "csf"},
    "camera": {"die_mm": 0.7},
    "display": {"dots": 32},
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
}


def lights_of(**over: Any) -> dict[str, tuple[Case[Study], Light]]:
    """The cases of a study and their lights, by the words of the cases."""
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases
    lights = render_lights(cases, lambda _: lambda *_: None, Workers(1), store=lambda image: image)
    return {case.words: (case, light) for case, light in zip(cases, lights, strict=True)}


def test_dimmer_light_is_that_of_its_render_with_the_film_of_the_brightest() -> None:
    """The film is fine enough by far with most light.

    On so few dots the measured error scatters by factors: with a tenth of the tolerance in most
    light it stays within half of it.
    """
    lights = lights_of(axis=[LIGHT], resolution=768)
    _, bright = lights["light 1000"]
    case, dim = lights["light 10"]
    expected = render_for(case)
    assert dim.film == bright.film
    assert dim.image.header == expected.image.header
    np.testing.assert_array_equal(dim.image.planes, expected.image.planes)
    assert expected.film is not None
    assert 0.0 < expected.film.largest_delta_e < 0.5 * min(expected.film.tolerated_delta_e)


@pytest.mark.parametrize(
    ("count", "error_delta_e", "over"),
    [
        (1, 0.0009, {}),
        (2, 0.0011, {}),  # more than a tenth of the tolerated error
        (1, 0.0009, {"axis": [LIGHT | {"set": LUMINANCE}]}),
        # A darker picture on the same display.
        (2, 0.0, {"axis": [LIGHT | {"set": LUMINANCE}], "display": {"white_cd_per_m2": 1e3}}),
        (2, 0.0, {"exposure": {"integration_s": 0.05}}),  # bright light saturates
        (2, 0.0, {"axis": [LIGHT, LENS]}),
        (2, 0.0, {"axis": [LIGHT | {"set": "pixel.read_noise_e", "values": [1.0, 9.0]}]}),
    ],
)
def test_film_is_measured_once_for_cases_that_differ_in_light_alone(
    count: int, error_delta_e: float, over: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    film = FilmError((64, 64), 11.0, (5.3, 7.0, 11.0), (error_delta_e,) * 3, (0.01,) * 3)
    measured = []

    def measure_film(*arguments: Any, **_: Any) -> FilmError:
        measured.append(arguments)
        return film

    monkeypatch.setattr("pixsim.studies.lights.measure_film", measure_film)
    lights_of(**{"axis": [LIGHT], "resolution": 64} | over)
    assert len(measured) == count, f"expected {count} measured films, got {len(measured)}"
