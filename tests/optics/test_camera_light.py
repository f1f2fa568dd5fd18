"""Directions and fall-off of a camera: the thin lens's, or those of a table of chief ray angles."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import camera_factor, camera_pupil
from pixsim.optics.exchange import read_irradiance
from pixsim.optics.pupil import numerical_aperture
from pixsim.optics.stack import Stack, collected_shares
from pixsim.optics.thin_lens import field_factor, irradiance_factor

X_UM, Y_UM = (
    np.array([0.0, 900.0, -400.0, 1400.0]) * side for side in (0.8, 0.6)
)  # on a die of 2.8 mm
STACK = Stack(2.2, 1.3, 3.5, 1.5, microlens=True)


def thin_lens_angles(camera: Camera, rows: int = 400) -> list[tuple[float, float]]:
    """The field angles of a thin lens over the die, up to its corner."""
    heights_mm = np.linspace(0, math.hypot(*camera.die_um) / 2e3, rows)
    return [
        (height, math.degrees(math.atan(height / camera.image_distance_mm)))
        for height in heights_mm.tolist()
    ]


@pytest.mark.parametrize("f_number", [1.4, 8.0])
def test_table_of_the_thin_lens_gives_its_shares(f_number: float) -> None:
    """But for the linear course between 400 rows."""
    camera = Camera(die_mm=2.8, f_number=f_number)
    table = camera.model_copy(update={"chief_ray_angle": tuple(thin_lens_angles(camera))})
    thin, own = (camera_pupil(one).at(X_UM, Y_UM) for one in (camera, table))
    np.testing.assert_allclose(own.chief_cosines, thin.chief_cosines, atol=1e-6)
    shares = [collected_shares(STACK, pupil) for pupil in (thin, own)]
    np.testing.assert_allclose(shares[0], shares[1], atol=2e-5)
    assert shares[0][:, 2, 2].min() < 0.6


def test_semi_axes_are_those_of_the_chief_ray_angle() -> None:
    """NA cos CRA across the field and NA cos³CRA along it, around sin CRA, to second order in
    NA.
    """
    errors = []
    for f_number in (4.0, 8.0):
        camera = Camera(
            die_mm=2.8, f_number=f_number, chief_ray_angle=[[0, 0], [1.0, 20.0], [2.0, 30.0]]
        )
        na, chief = numerical_aperture(camera.working_f_number), math.radians(10.0)
        pupil = camera_pupil(camera).at(0.0, -500.0)  # half way to 1 mm, towards the top
        np.testing.assert_allclose(pupil.chief_cosines, [0.0, -math.sin(chief)], atol=1e-15)
        across, along = pupil.boundary(np.linspace(0, 2 * np.pi, 4000))[0].T
        axes = (
            np.ptp(across) / 2,
            np.ptp(along) / 2,
            float(pupil.area) / (math.pi * na * math.cos(chief)),
        )
        wanted = na * math.cos(chief), na * math.cos(chief) ** 3, na * math.cos(chief) ** 3
        errors.append(np.divide(axes, wanted) - 1)
        assert camera.numerical_aperture == pytest.approx(na, rel=1e-15)
    assert np.abs(errors[1]).max() < 1e-3
    np.testing.assert_allclose(errors[0] / errors[1], 4, rtol=0.05)


def test_telecentric_table_gives_the_same_shares_everywhere() -> None:
    camera = Camera(die_mm=2.8, f_number=1.4, chief_ray_angle=[[0, 0], [2, 0]])
    shares = collected_shares(STACK, camera_pupil(camera).at(X_UM, Y_UM))
    np.testing.assert_allclose(shares, np.broadcast_to(shares[0], shares.shape), atol=1e-12)
    thin = collected_shares(STACK, camera_pupil(Camera(die_mm=2.8, f_number=1.4)).at(X_UM, Y_UM))
    assert thin[-1, 2, 2] < shares[0, 2, 2] - 0.1


def test_angles_alone_leave_the_fall_off_as_it_is() -> None:
    plain = Camera()
    angles = plain.model_copy(update={"chief_ray_angle": ((0.0, 0.0), (2.0, 25.0))})
    wanted = field_factor(
        (7, 9), 200.0, plain.image_distance_mm, plain.f_number, plain.magnification
    )
    for camera in (plain, angles):
        np.testing.assert_array_equal(camera_factor(camera, (7, 9), 200.0), wanted)
    assert plain.lights_like(angles)


def test_relative_illumination_replaces_the_fall_off(tmp_path: Path) -> None:
    """Linear between the rows, times Foote's factor on the axis: in the render, and in radiance of
    other programs.
    """
    table = [[0, 0, 1], [1, 20, 0.7], [2, 30, 0.4]]
    camera = Camera(die_mm=2.4, chief_ray_angle=table)
    assert not camera.lights_like(Camera(die_mm=2.4))
    side, pitch_um = 16, 150.0
    at_mm = (np.arange(side) + 0.5 - side / 2) * pitch_um / 1e3
    relative = 1 - 0.3 * np.hypot(at_mm, at_mm[:, None])  # both rows have this slope
    on_axis = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    np.testing.assert_allclose(
        camera_factor(camera, (side, side), pitch_um), on_axis * relative, rtol=1e-12
    )
    part = slice(3, 9), slice(8, 16)
    np.testing.assert_allclose(
        camera_factor(camera, (side, side), pitch_um, part), on_axis * relative[part], rtol=1e-12
    )
    cube = np.full((side, side, 3), 2.0)
    np.savez(
        tmp_path / "light.npz", data=cube, wavelength_nm=[500.0, 550.0, 600.0], units="W/m^2/sr/nm"
    )
    image = read_irradiance(tmp_path / "light.npz", camera)
    np.testing.assert_allclose(image.data[:, :, 1], 2 * on_axis * relative, rtol=1e-6)
    scene = pixsim.load_scene("flat", variant="scalar_spectral", resolution=side)
    lux, thin = (
        pixsim.render(scene, one, seed=0).illuminance_lx() for one in (camera, Camera(die_mm=2.4))
    )
    ratio = camera_factor(camera, (side, side), pitch_um) / camera_factor(
        Camera(die_mm=2.4), (side, side), pitch_um
    )
    np.testing.assert_allclose(lux / thin, ratio, rtol=1e-6)
