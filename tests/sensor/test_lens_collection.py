"""Pixels with a stack behind a real lens: the traced pupil, against its rays one by one, the
fall-off, and a thin lens.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import camera_with_lens, traced_lens
from pixsim.optics.camera_light import camera_pupil
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.pupil import Directions, Pupil
from pixsim.optics.stack import Stack, collected_shares, spot_integral
from pixsim.optics.thin_lens import thin_lens_pupil
from pixsim.sensor.collection import collection_of, illumination
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from tests.scene.test_real_lens import THIN

NM = np.array([550.0])
BARE: dict[str, Any] = {"height_um": 3.0, "index": 1.5}
STACKS = {
    "bare": BARE,
    "lens": BARE | {"microlens": "square"},
    "shifted": BARE | {"microlens": "square", "shift": "optimal"},
}
PLACES = ((1.1, 0.3), (-0.8, 1.6), (-1.7, -1.7), (0.2, -1.9))  # x, y in mm, in all quadrants


@pytest.fixture(scope="module")
def phone() -> Camera:
    return camera_with_lens(
        Camera(die_mm=4.8, object_distance_m=2.0), CameraOptions(), LensOptions(file="phone")
    )


@cache
def traced(
    camera: Camera, x_mm: float, y_mm: float, count: int = 160
) -> tuple[np.ndarray, float, np.ndarray]:
    """Directions (n, 2) of an even grid from which light reaches a place, traced one by one; their
    area; the chief ray's.
    """
    lens = traced_lens(camera.lens, camera.object_distance_m)  # type: ignore[arg-type]
    field = lens.field_of_height(float(np.hypot(x_mm, y_mm)), lens.primary_nm)
    nm = np.array([lens.primary_nm])
    chief = float(np.sin(np.radians(lens.chief_ray(field, lens.primary_nm).angle_deg)))
    step = 0.5 / count
    across, along = (
        part.ravel() for part in np.meshgrid(*2 * [(np.arange(count) - (count - 1) / 2) * step])
    )
    along = along + chief
    height = np.array([np.hypot(x_mm, y_mm)])
    through = (
        lens._max_relative_height(np.array([field]), height, nm, across[None], along[None])[0] <= 1
    )
    outward = np.array([x_mm, y_mm]) / np.hypot(x_mm, y_mm)
    aside = np.array([outward[1], -outward[0]])
    cosines = along[through, None] * outward + across[through, None] * aside
    return cosines, float(through.sum()) * step**2, chief * outward


def test_traced_pupils_have_the_area_of_the_fall_off_and_the_chief_rays_of_the_lens(
    phone: Camera,
) -> None:
    pupil = camera_pupil(phone)
    x, y = np.array([(0.0, 0.0), *PLACES]).T
    found = pupil.at(1e3 * x, 1e3 * y)
    assert isinstance(found, Directions)
    heights, _, relative = np.array(phone.chief_ray_angle).T
    wanted = np.interp(np.hypot(x, y), heights, relative)
    np.testing.assert_allclose(
        found.weight.sum(axis=-1) / found.weight.sum(axis=-1)[0], wanted, rtol=1e-4
    )
    assert wanted.min() < 0.7
    for index, (x_mm, y_mm) in enumerate(PLACES, 1):
        cosines, area, chief = traced(phone, x_mm, y_mm)
        np.testing.assert_allclose(found.chief_cosines[index], chief, atol=1e-5)
        mean = found.shares[index] @ found.cosines[index]
        np.testing.assert_allclose(mean, cosines.mean(axis=0), atol=1e-3)
        spread = found.shares[index] @ (found.cosines[index] - mean) ** 2
        np.testing.assert_allclose(spread, cosines.var(axis=0), rtol=0.02)
        assert area / traced(phone, 1e-9, 0.0)[1] == pytest.approx(
            wanted[index], rel=0.01
        )  # of cells of a grid


@pytest.mark.parametrize("name", STACKS)
def test_collection_is_the_direct_sum_over_traced_rays(name: str, phone: Camera) -> None:
    """Between the places where pupils are traced, against each ray's landing place; a disc at the
    same angle is elsewhere.
    """
    physics = derive(
        Pixel(pitch_um=3.0, infrared_cut_nm=720.0, fill_factor=0.5, stack=STACKS[name])
    )
    stack = physics.stack
    assert stack is not None
    light = illumination(phone, NM, np.ones(1), np.ones(1))
    shape = (1600, 1600)
    collection = collection_of(physics, light, shape)
    assert collection is not None
    shares = collection.shares
    differences = []
    for x_mm, y_mm in PLACES:
        cosines, _, chief = traced(phone, x_mm, y_mm)
        tangents = cosines / np.sqrt(stack.index**2 - np.square(cosines).sum(axis=1, keepdims=True))
        shift = chief / np.sqrt(stack.index**2 - chief @ chief) if name == "shifted" else 0.0
        x, y = (stack.height_um * (tangents - shift)).T
        side, pitch = stack.photodiode_side_um, stack.pitch_um
        if name == "bare":
            own = [np.maximum(side - np.abs(part), 0) for part in (x, y)]
            wanted = float((own[0] * own[1]).mean()) / pitch**2
        else:
            spot_um = 1e-3 * NM[0] * stack.height_um / (stack.index * pitch)
            own = [
                spot_integral((side / 2 - part) / spot_um)
                - spot_integral((-side / 2 - part) / spot_um)
                for part in (x, y)
            ]
            wanted = float((own[0] * own[1]).mean())
        # Shares are linear between 65 points across the array.
        row, column = ((1e3 * part / (3.0 * 799.5) + 1) * 32 for part in (y_mm, x_mm))
        (top, down), (left, right) = ((int(at), at - int(at)) for at in (row, column))
        corners = shares[top : top + 2, left : left + 2, 2, 2]
        found = float(np.array([1 - down, down]) @ corners @ np.array([1 - right, right]))
        assert found == pytest.approx(wanted, abs=2e-3)
        disc = camera_pupil(phone.model_copy(update={"lens": None})).at(1e3 * x_mm, 1e3 * y_mm)
        differences.append(abs(float(collected_shares(stack, disc, NM)[0, 2, 2]) - wanted))
    assert max(differences) > 5e-3 or name == "shifted"  # all of whose light lands well inside


def test_thin_real_lens_has_the_shares_of_a_thin_lens(tmp_path: Path) -> None:
    file = tmp_path / "thin.toml"
    file.write_text(THIN.replace("value_mm = 0.1", "value_mm = 2.5"), encoding="utf-8")
    camera = Camera(die_mm=4.0, object_distance_m=5.0)
    camera = camera_with_lens(
        camera,
        CameraOptions(),
        LensOptions(file=str(file), focal_length_mm=10.0, refocus="paraxial"),
    )
    stack = Stack(3.0, 1.8, 3.0, 1.5, microlens=True)
    for x_um, y_um in ((0.0, 0.0), (1200.0, -700.0), (-1900.0, 1900.0)):
        found = camera_pupil(camera).at(x_um, y_um)
        tangent = np.hypot(x_um, y_um) / 1e3 / camera.image_distance_mm
        wanted = thin_lens_pupil(
            camera.f_number, tangent, np.degrees(np.arctan2(y_um, x_um)), camera.magnification
        )
        assert isinstance(found, Directions)
        assert isinstance(wanted, Pupil)
        np.testing.assert_allclose(
            collected_shares(stack, found, NM), collected_shares(stack, wanted, NM), atol=1e-4
        )
