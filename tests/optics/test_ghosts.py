"""Light that two surfaces reflect: shares against the sum of all reflections, and foci against
closed forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pixsim
from pixsim.optics.ghosts import find_ghosts, reflectances, unfolded_path
from pixsim.optics.glass import constant_glass
from pixsim.optics.prescription import Surface
from pixsim.optics.ray_trace import paraxial

INDEX = 1.7
GLASS = constant_glass("glass", INDEX)


def through(reflectance: np.ndarray) -> float:
    """Share of the light that a stack of surfaces lets through by all its reflections, one more
    surface at a time.
    """
    transmitted = reflected_behind = 0.0
    for number, r in enumerate(reflectance.tolist()):
        if not number:
            transmitted, reflected_behind = 1 - r, r
            continue
        rounds = 1 / (1 - reflected_behind * r)
        transmitted, reflected_behind = (
            transmitted * (1 - r) * rounds,
            r + (1 - r) ** 2 * reflected_behind * rounds,
        )
    return transmitted


@pytest.mark.parametrize("coated", [None, 0.002])
def test_shares_add_up_to_the_light_of_all_reflections(coated: float | None) -> None:
    """But for light that is reflected four times or more, by the fourth power of the
    reflectance.
    """
    indices = [1.0, INDEX, 1.5, 1.0, INDEX, 1.0]
    r = reflectances(indices, coated)
    assert r[1] == pytest.approx((0.2 / 3.2) ** 2, rel=1e-12)  # a cemented surface has no coating
    assert r[0] == (coated or pytest.approx((0.7 / 2.7) ** 2))
    surfaces = [Surface(0.1, 1.0, constant_glass("a", n)) for n in indices[1:]]
    total = sum(ghost.share for ghost in find_ghosts(surfaces, indices, r, 1.0, 0.0))
    assert total == pytest.approx(through(r) / np.prod(1 - r) - 1, rel=30 * float(r.max()) ** 2)


@pytest.mark.parametrize("bending", [-1.0, 0.0, 0.5])
def test_ghost_of_a_thin_lens_is_at_its_closed_form(bending: float) -> None:
    """(n - 1) f/(3 n - 1) behind it, whatever its shape."""
    focal, thin = 50.0, 1e-9
    curvature = 1 / (focal * (INDEX - 1))
    front = curvature * (1 + bending) / 2
    lens = [Surface(front, thin, GLASS), Surface(front - curvature, focal)]
    indices = [1.0, INDEX, 1.0]
    (ghost,) = find_ghosts(lens, indices, reflectances(indices), 2.0, 0.0)
    at = (INDEX - 1) * focal / (3 * INDEX - 1)
    assert ghost.focus_from_image_mm + focal == pytest.approx(at, rel=1e-6)
    assert ghost.blur_mm == pytest.approx(2 * 2.0 * (focal / at - 1), rel=1e-6)


def test_light_crosses_a_plate_three_times() -> None:
    """A point in front of a plane plate: the reduced thickness three times, in place of once."""
    plate = [Surface(0.0, 3.0, GLASS), Surface(0.0, 10.0)]
    indices = [1.0, INDEX, 1.0]
    (ghost,) = find_ghosts(plate, indices, reflectances(indices), 0.5, 0.05)
    assert ghost.blur_mm == pytest.approx(2 * (0.5 + 0.05 * (3 * 3.0 / INDEX + 10.0)), rel=1e-12)


def test_ghosts_of_a_lens_are_in_the_image_of_its_object() -> None:
    """The packaged singlet: the light that crosses it straight makes a point, and its ghost is that
    of the unfolded trace.
    """
    lens = pixsim.load_lens("singlet").refocused("paraxial", 400.0)
    (ghost,) = lens.ghosts(lens.primary_nm)
    entrance_mm = lens.first_order(lens.primary_nm).entrance_pupil_from_first_vertex_mm
    slope = lens.entrance_pupil_diameter_mm / 2 / lens.object_distance_mm
    height = lens.entrance_pupil_diameter_mm / 2 - slope * entrance_mm
    surfaces = lens.prescription.surfaces
    indices = [1.0, float(surfaces[0].glass.index(np.array([lens.primary_nm]))[0]), 1.0]
    direct = paraxial(surfaces, indices, np.array([height]), np.array([slope]))
    assert float((direct[0] + surfaces[-1].thickness_mm * direct[1])[0]) == pytest.approx(
        0, abs=1e-9
    )
    path, around = unfolded_path(surfaces, indices, 0, 1)
    assert [one.thickness_mm for one in path[:3]] == [
        surfaces[0].thickness_mm,
        -surfaces[0].thickness_mm,
        surfaces[0].thickness_mm,
    ]
    assert around == [1.0, indices[1], -indices[1], indices[1], 1.0]
    assert ghost.blur_mm > 1
    assert ghost.surfaces == (1, 2)
    assert replace(lens).ghosts(lens.primary_nm, 0.01)[0].share == pytest.approx(1e-4, rel=1e-12)
    assert lens.ghosts(lens.primary_nm, 0.0) == []
