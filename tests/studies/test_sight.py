"""Films of cases that see the same: the clearest is measured, and the others share its error where it is surely low enough."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pixsim.studies import lights as rendering
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
PRNU = {"name": "PRNU", "set": "pixel.prnu", "values": [0.02, 0.0]}


def lights_of(patch: pytest.MonkeyPatch, **over: Any) -> tuple[list[Case], list[Light], list[str]]:
    """The cases of a study, their lights, and the words of those whose films were measured."""
    measured: list[str] = []
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases

    def counted(case: Case[Study], *more: Any) -> Light:
        measured.append(case.words)
        return render_for(case, *more)

    patch.setattr(rendering, "render_for", counted)
    return list(cases), lights_of_cases(cases, None, lambda _: lambda *_: None, Workers(1), store=lambda image: image), measured


def test_film_is_measured_for_the_brightest_light_and_the_sharpest_lens(monkeypatch: pytest.MonkeyPatch) -> None:
    cases, lights, measured = lights_of(monkeypatch, axis=[LIGHT, LENS], resolution=512)
    assert measured == ["light 1000, lens 2.8"]
    stated = (SURELY * TOLERATED_DELTA_E,) * 3
    assert [light.film.delta_e == stated for light in lights] == [True, True, False, True]
    for case, light in zip(cases, lights, strict=True):
        if case.words in measured:
            continue
        image, film, found = light.image, light.film, render_for(case)
        alone, own = found.image, found.film
        assert image.header == alone.header
        assert (image.planes == alone.planes).all()
        # What is stated in place of a measurement. On so few dots the measured error scatters by a factor of two.
        assert own.largest_delta_e < 2 * film.largest_delta_e < 0.5 * TOLERATED_DELTA_E
        assert (np.array(film.tolerated_delta_e) <= own.tolerated_delta_e).all()


@pytest.mark.parametrize(
    ("axis", "least"),
    [
        (PRNU, "PRNU 0"),
        ({"name": "after", "set": "pixel.read_noise_after_gain_e", "values": [90.0, 0.0]}, "after 0"),
        ({"name": "hot", "set": "pixel.hot_pixel_fraction", "values": [0.01, 0.0]}, "hot 0"),
    ],
)
def test_film_of_the_least_noise_is_measured(axis: dict[str, Any], least: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.studies.oversampling.SURELY", 1.0)
    hot = {"hot_pixel_median": 30.0, "hot_pixel_spread": 1.0} if axis["name"] == "hot" else {}
    assert lights_of(monkeypatch, axis=[axis], pixel=hot)[2] == [least]


@pytest.mark.parametrize(
    ("is_same", "over"),
    [
        (True, {}),
        (False, {"resolution": 64}),  # fewer than two samples for each detail
        (False, {"exposure": {"integration_s": 0.05}}),  # bright light saturates
        (
            False,
            {"axis": [LIGHT | {"set": LIGHT["set"][0]}], "display": {"white_cd_per_m2": 1e3}},
        ),  # a darker picture on the same display
        (False, {"axis": [LIGHT | {"set": "display.samples_per_deg", "values": [10.0, 12.0]}]}),
        (False, {"axis": [LIGHT | {"set": "pixel.fill_factor", "values": [0.2, 0.3]}]}),
        (True, {"axis": [LENS]}),
        (False, {"axis": [LENS], "pixel": {"stack": {"height_um": 3.0, "index": 1.5}}}),  # which sees the angles of the light
        (False, {"axis": [LENS], "camera": {"chief_ray_angle": [[0.0, 0.0], [0.5, 9.0]]}}),  # not a thin lens
        (False, {"axis": [LENS | {"set": "camera.focal_length_mm", "values": [3.8, 4.0]}]}),
    ],
)
def test_film_of_another_sight_is_measured(is_same: bool, over: dict[str, Any]) -> None:
    """Which films are measured is asked here, not their errors."""
    cases = prepare(Study.model_validate(merge(SMALL, {"axis": [LIGHT]} | over))).cases
    found = dict(rendering._see_task((case.words, case, None), None) for case in cases)
    measured_in = {name: name for name in found} | clearest({name: seen[3] for name, seen in found.items() if seen})
    assert len(set(measured_in.values())) == (1 if is_same else 2)


def test_film_that_is_not_surely_fine_is_measured_in_each_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.studies.oversampling.SURELY", 0.0)
    assert lights_of(monkeypatch, axis=[LIGHT])[2] == ["light 1000", "light 10"]


def test_clearest_has_most_light_and_least_noise() -> None:
    def sight(white: float, noise: float, what: str = "a", f_number: float = 2.0) -> Sight:
        return Sight(what, f_number, (white, 2 * white), ((noise, 1.0), (noise, 2.0)))

    sights = {
        "dim": sight(1, 1),
        "bright": sight(9, 1),
        "brightest": sight(10, 3),
        "other": sight(99, 0, "b"),
        "noisy": sight(2, 5),
        "blurred": sight(10, 3, f_number=4.0),
        "blurred, but brighter": sight(11, 3, f_number=4.0),
    }
    assert clearest(sights) == {
        "dim": "bright",
        "bright": "bright",
        "brightest": "brightest",
        "other": "other",
        "noisy": "brightest",
        "blurred": "brightest",
        "blurred, but brighter": "blurred, but brighter",
    }
