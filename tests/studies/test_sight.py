"""Films of cases that see the same: the clearest is measured, and the others share its error where it is surely low enough."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pixsim.studies import lights as lights_module
from pixsim.studies.cases import Case
from pixsim.studies.engine import Workers
from pixsim.studies.lights import lights_of_cases, render_for
from pixsim.studies.oversampling import SURELY, TOLERATED_DELTA_E, Light
from pixsim.studies.preparation import prepare
from pixsim.studies.sight import Sight, clearest
from pixsim.studies.study_settings import Study
from pixsim.viewer.merging import merge

LIGHT = {"name": "light", "set": ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"], "values": [10.0, 1000.0]}
LENS = {"name": "lens", "set": "camera.f_number", "values": [2.8, 8.0]}
# Cells that are computed, four for each of 64 details and more.
SMALL = {"name": "small", "resolution": 256, "repeats": 2, "scene": {"file": "csf"}, "camera": {"die_mm": 0.7}}
SMALL |= {"display": {"dots": 32}, "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]}}


STATED = (SURELY * TOLERATED_DELTA_E,) * 3  # in place of a measurement


def lights_of(**over: Any) -> dict[str, tuple[Case, Light]]:
    """The cases of a study and their lights, by the words of the cases."""
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases
    lights = lights_of_cases(cases, lambda _: lambda *_: None, Workers(1), store=lambda image: image)
    return {case.words: (case, light) for case, light in zip(cases, lights, strict=True)}


def test_film_is_measured_for_the_brightest_light_and_the_sharpest_lens() -> None:
    found = lights_of(axis=[LIGHT, LENS], resolution=512)
    assert [words for words, (_, light) in found.items() if light.film.delta_e != STATED] == ["light 1000, lens 2.8"]
    case, light = found["light 10, lens 8"]
    alone = render_for(case)
    assert light.image.header == alone.image.header
    assert (light.image.planes == alone.image.planes).all()
    # On so few dots the measured error scatters by a factor of two.
    assert alone.film.largest_delta_e < 2 * light.film.largest_delta_e < 0.5 * TOLERATED_DELTA_E
    assert (np.array(light.film.tolerated_delta_e) <= alone.film.tolerated_delta_e).all()


def test_film_that_is_not_surely_fine_is_measured_in_each_case() -> None:
    found = lights_of(axis=[LIGHT])
    assert len(found) == 2
    for _, light in found.values():
        assert not light.film.surely_met
        assert light.film.delta_e != STATED


def measured_cases(**over: Any) -> list[str]:
    """Words of the cases whose films are measured, before any is."""
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases
    found = dict(lights_module._see_task((case.words, case), None) for case in cases)
    measured_in = {name: name for name in found} | clearest({name: seen[3] for name, seen in found.items() if seen})
    return list(dict.fromkeys(measured_in.values()))


@pytest.mark.parametrize(
    ("name", "setting", "value"),
    [("PRNU", "prnu", 0.02), ("after", "read_noise_after_gain_e", 90.0), ("hot", "hot_pixel_fraction", 0.01)],
)
def test_film_of_the_least_noise_is_measured(name: str, setting: str, value: float) -> None:
    hot = {"hot_pixel_median": 30.0, "hot_pixel_spread": 1.0} if name == "hot" else {}
    axis = {"name": name, "set": f"pixel.{setting}", "values": [value, 0.0]}
    assert measured_cases(axis=[axis], pixel=hot) == [f"{name} 0"]


@pytest.mark.parametrize(
    ("count", "over"),
    [
        (1, {}),
        (2, {"resolution": 64}),  # fewer than two samples for each detail
        (2, {"exposure": {"integration_s": 0.05}}),  # bright light saturates
        # A darker picture on the same display.
        (2, {"axis": [LIGHT | {"set": LIGHT["set"][0]}], "display": {"white_cd_per_m2": 1e3}}),
        (2, {"axis": [LIGHT | {"set": "display.samples_per_deg", "values": [10.0, 12.0]}]}),
        (2, {"axis": [LIGHT | {"set": "pixel.fill_factor", "values": [0.2, 0.3]}]}),
        (1, {"axis": [LENS]}),
        (2, {"axis": [LENS], "pixel": {"stack": {"height_um": 3.0, "index": 1.5}}}),  # which sees the angles of the light
        (2, {"axis": [LENS], "camera": {"chief_ray_angle": [[0.0, 0.0], [0.5, 9.0]]}}),  # not a thin lens
        (2, {"axis": [LENS | {"set": "camera.focal_length_mm", "values": [3.8, 4.0]}]}),
    ],
)
def test_film_of_another_sight_is_measured(count: int, over: dict[str, Any]) -> None:
    assert len(measured_cases(**{"axis": [LIGHT]} | over)) == count


def test_clearest_has_most_light_and_least_noise() -> None:
    def sight(white: float, noise: float, what: str = "a", f_number: float = 2.0) -> Sight:
        return Sight(what, f_number, (white, 2 * white), ((noise, 1.0), (noise, 2.0)))

    sights = {
        "dim": sight(1, 1), "bright": sight(9, 1), "brightest": sight(10, 3), "other": sight(99, 0, "b"), "noisy": sight(2, 5),
        "blurred": sight(10, 3, f_number=4.0), "blurred, but brighter": sight(11, 3, f_number=4.0),
    }  # fmt: skip
    itself = ("bright", "brightest", "other", "blurred, but brighter")
    expected = {name: name for name in itself} | {"dim": "bright", "noisy": "brightest", "blurred": "brightest"}
    assert clearest(sights) == expected
