"""Lights of a study's cases: the film is measured with the most light, and holds with less."""

from __future__ import annotations

from typing import Any

import pytest

from pixsim.studies import film_error
from pixsim.studies.design import Case
from pixsim.studies.engine import Workers
from pixsim.studies.lights import Light, render_for, render_lights
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Study
from pixsim.viewer.merging import merge

LIGHT = {
    "name": "light",
    "set": ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"],
    "values": [10.0, 1000.0],
}
LENS = {"name": "lens", "set": "camera.f_number", "values": [2.8, 8.0]}
# Cells that are computed, four for each of 64 details and more.
SMALL = {
    "name": "small",
    "resolution": 256,
    "repeats": 2,
    "scene": {"file": "csf"},
    "camera": {"die_mm": 0.7},
}
SMALL |= {"display": {"dots": 32}, "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]}}


def lights_of(**over: Any) -> dict[str, tuple[Case[Study], Light]]:
    """The cases of a study and their lights, by the words of the cases."""
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases
    lights = render_lights(cases, lambda _: lambda *_: None, Workers(1), store=lambda image: image)
    return {
        case.words: (case, light)
        for case, light in zip(cases, lights, strict=True)
        if isinstance(light, Light)
    }


def test_dimmer_light_is_that_of_a_render_of_its_own_with_the_film_of_the_brightest() -> None:
    """The film is fine enough by far with most light."""
    lights = lights_of(axis=[LIGHT], resolution=1024)
    (_, bright), (case, dim) = lights["light 1000"], lights["light 10"]
    alone = render_for(case)
    assert dim.film == bright.film
    assert dim.image.header == alone.image.header
    assert (dim.image.planes == alone.image.planes).all()
    # On so few dots the measured error scatters by factors: with a tenth of the tolerance in most
    # light it stays within it.
    assert 0.0 < alone.film.largest_delta_e < 0.5 * min(alone.film.tolerated_delta_e)


def test_film_that_is_not_fine_enough_by_far_is_measured_in_each_light() -> None:
    lights = lights_of(axis=[LIGHT])
    (_, bright), (_, dim) = lights["light 1000"], lights["light 10"]
    assert bright.film.largest_delta_e > 0.1 * min(bright.film.tolerated_delta_e)
    assert dim.film != bright.film


@pytest.mark.parametrize(
    ("count", "over"),
    [
        (1, {}),
        (1, {"axis": [LIGHT | {"set": LIGHT["set"][0]}]}),
        # A darker picture on the same display.
        (2, {"axis": [LIGHT | {"set": LIGHT["set"][0]}], "display": {"white_cd_per_m2": 1e3}}),
        (2, {"exposure": {"integration_s": 0.05}}),  # bright light saturates
        (2, {"axis": [LIGHT, LENS]}),  # another lens
        (2, {"axis": [LIGHT | {"set": "pixel.read_noise_e", "values": [1.0, 9.0]}]}),
    ],
)
def test_film_is_measured_once_for_cases_that_differ_in_light_alone(
    count: int, over: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = []
    monkeypatch.setattr(
        "pixsim.studies.lights.measure_film", lambda *given, **more: measured.append(1) or FINE
    )
    lights_of(**{"axis": [LIGHT]} | over)
    assert len(measured) == count


FINE = film_error.FilmError((256, 256), 2.7, (5.3, 7.0, 11.0), (0.001,) * 3, (0.01,) * 3)
