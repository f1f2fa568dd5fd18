"""Chief ray angles and fall-off of a thin lens: from files, rows and TOML, as values in hashes and
settings; directions and light that follow from them. What is refused stands in test_refusals.py.
"""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.tiny import tiny_toml

from pixsim.base.records import checked
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_light import camera_factor, camera_pupil
from pixsim.optics.exchange import read_irradiance
from pixsim.optics.stack import Stack, collected_shares
from pixsim.optics.thin_lens import field_factor, irradiance_factor
from pixsim.studies.files import load_study, settings_text
from pixsim.studies.sensors import matched_cameras
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import settings_layer

CRA = "image_height_mm,deg\n0,0\n1,12\n2,21.5\n"
ROWS = ((0.0, 0.0), (1.0, 12.0), (2.0, 21.5))
LIT = ((0.0, 0.0, 1.0), (1.0, 12.0, 0.9), (2.0, 21.5, 0.7))


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        (CRA, ROWS),
        (f"# f/1.8\n\n{CRA.upper()}\n", ROWS),
        ("image_height_mm,deg\n2,21.5\n1,12\n0,0\n", ROWS),
        ("deg;image_height_mm\n0;0\n12;1\n21,5;2\n", ROWS),
        ("relative_illumination\timage_height_mm\tdeg\n1\t0\t0\n0.9\t1\t12\n0.7\t2\t21.5\n", LIT),
        ("Image height (mm);CRA (°);Relative illumination (%)\n0;0;100\n1;12;90\n2;21,5;70\n", LIT),
    ],
)
def test_table_is_read_by_the_names_of_its_columns(text: str, rows: object, tmp_path: Path) -> None:
    (tmp_path / "cra.csv").write_text(text, encoding="utf-8")
    camera = Camera(chief_ray_angle=tmp_path / "cra.csv")
    assert camera.chief_ray_angle == rows
    assert Camera(chief_ray_angle=[list(row) for row in rows]) == camera
    assert (camera.relative_illumination is None) == (rows is ROWS)
    assert Camera.model_validate(json.loads(camera.model_dump_json())) == camera


def test_fall_off_of_a_table_begins_on_the_axis(tmp_path: Path) -> None:
    (tmp_path / "fall.csv").write_text("image_height_mm,relative_illumination (%)\n1,90\n3,40\n")
    camera = Camera(fall_off=tmp_path / "fall.csv")
    assert camera.relative_illumination == ((0.0, 1.0, 3.0), (1.0, 0.9, 0.4))


def test_file_is_found_next_to_the_file_that_names_it_and_stored_as_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a settings file, a study, and the values of its axis; an edit of the table changes the
    hash of the settings.
    """
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "lens"
    folder.mkdir()
    (folder / "cra.csv").write_text(CRA)
    (folder / "flat.csv").write_text("image_height_mm,deg\n0,0\n2,0\n")
    (folder / "camera.toml").write_text('[camera]\nchief_ray_angle = "cra.csv"\n')
    settings: Run = checked(Run, [settings_layer(folder / "camera.toml")])
    table = tomllib.loads(settings_text(settings, "command"))["camera"]["chief_ray_angle"]
    assert table == [list(row) for row in ROWS]
    axis = '[[axis]]\nname = "angles"\nset = "camera.chief_ray_angle"\nvalues = ["cra.csv", "flat.csv"]'
    (folder / "study.toml").write_text(f"{tiny_toml()}{axis}\n")
    study = load_study("lens/study.toml")
    values = tomllib.loads(settings_text(study, "command"))["axis"][0]["values"]
    ends = [value["set"]["camera"]["chief_ray_angle"][-1] for value in values]
    assert ends == [[2.0, 21.5], [2.0, 0.0]]
    again = Study.model_validate({"name": "again", "axis": [{"name": "angles", "values": values}]})
    assert [point.label for point in again.axis[0].points] == ["lens/cra.csv", "lens/flat.csv"]
    (folder / "cra.csv").write_text(CRA.replace("21.5", "22"))
    changed: Run = checked(Run, [settings_layer(folder / "camera.toml")])
    assert changed.camera.content_hash != settings.camera.content_hash


def test_cameras_of_a_comparison_share_the_lens_and_its_table() -> None:
    """Made larger for another die, its image heights grow; a cropped die has them as they are."""
    reference = Camera(die_mm=2.0, die_height_mm=1.5, chief_ray_angle=ROWS)
    larger = Camera(die_mm=4.0, die_height_mm=4.0)
    _, camera = matched_cameras([reference, larger], "view")
    assert camera.chief_ray_angle == tuple((2 * height, angle) for height, angle in ROWS)
    _, camera = matched_cameras([reference, larger], "lens")
    assert camera.chief_ray_angle == ROWS
    cropped = CameraOptions(chief_ray_angle=ROWS, die_mm=3.0, die_height_mm=2.0).over(Camera())
    assert cropped.window(1.0).chief_ray_angle == ROWS


# Directions

X_UM, Y_UM = (np.array([0.0, 900.0, -400.0, 1400.0]) * side for side in (0.8, 0.6))
STACK = Stack(2.2, 1.3, 3.5, 1.5, microlens=True)


@pytest.mark.parametrize("f_number", [1.4, 8.0])
def test_table_of_the_thin_lens_has_its_shares(f_number: float) -> None:
    """But for straight lines between 400 rows."""
    camera = Camera(die_mm=2.8, f_number=f_number)
    heights_mm = np.linspace(0, math.hypot(*camera.die_um) / 2e3, 400)
    angles_deg = np.degrees(np.arctan(heights_mm / camera.image_distance_mm))
    rows = tuple(zip(heights_mm.tolist(), angles_deg.tolist(), strict=True))
    thin = camera_pupil(camera).at(X_UM, Y_UM)
    pupil = camera_pupil(camera.model_copy(update={"chief_ray_angle": rows})).at(X_UM, Y_UM)
    check("chief rays", pupil.chief_cosines, thin.chief_cosines, atol=1e-6, why="400 rows")
    shares = collected_shares(STACK, thin)
    check("shares", collected_shares(STACK, pupil), shares, atol=2e-5, why="400 rows")
    assert shares[:, 2, 2].min() < 0.6


def test_semi_axes_are_those_of_the_chief_ray_angle() -> None:
    """NA cos CRA across the field and NA cos³CRA along it, around sin CRA, to second order in
    NA: half way to 1 mm, towards the top.
    """
    chief = math.radians(10.0)
    errors = []
    for f_number in (4.0, 8.0):
        rows = [[0, 0], [1.0, 20.0], [2.0, 30.0]]
        camera = Camera(die_mm=2.8, f_number=f_number, chief_ray_angle=rows)
        na = 1 / math.hypot(1, 2 * camera.working_f_number)
        check("aperture", camera.numerical_aperture, na, rtol=1e-15, why="rounding")
        pupil = camera_pupil(camera).at(0.0, -500.0)
        check("centre", pupil.chief_cosines, [0.0, -math.sin(chief)], atol=1e-15, why="rounding")
        across, along = pupil.boundary(np.linspace(0, 2 * np.pi, 4000))[0].T
        area = float(pupil.area) / (math.pi * na * math.cos(chief))
        axes = np.array([np.ptp(across) / 2, np.ptp(along) / 2, area])
        errors.append(axes / (na * np.cos(chief) ** np.array([1, 3, 3])) - 1)
    assert np.abs(errors[1]).max() < 1e-3
    check("order", errors[0] / errors[1], np.full(3, 4.0), rtol=0.05, why="NA⁴")


def test_telecentric_table_has_the_same_shares_everywhere() -> None:
    camera = Camera(die_mm=2.8, f_number=1.4, chief_ray_angle=[[0, 0], [2, 0]])
    shares = collected_shares(STACK, camera_pupil(camera).at(X_UM, Y_UM))
    check("shares", shares, np.broadcast_to(shares[0], shares.shape), atol=1e-12, why="rounding")
    thin = collected_shares(STACK, camera_pupil(Camera(die_mm=2.8, f_number=1.4)).at(X_UM, Y_UM))
    assert thin[-1, 2, 2] < shares[0, 2, 2] - 0.1


# Fall-off


def test_angles_alone_leave_the_fall_off() -> None:
    plain = Camera()
    angles = plain.model_copy(update={"chief_ray_angle": ((0.0, 0.0), (2.0, 25.0))})
    geometry = plain.image_distance_mm, plain.f_number, plain.magnification
    wanted = field_factor((7, 9), 200.0, *geometry)
    for camera in (plain, angles):
        check("factor", camera_factor(camera, (7, 9), 200.0), wanted, why="the same bits")
    assert plain.lights_like(angles)


def test_relative_illumination_replaces_the_fall_off(tmp_path: Path) -> None:
    """Linear between the rows, times Foote's factor on the axis; both rows have one slope."""
    camera = Camera(die_mm=2.4, chief_ray_angle=[[0, 0, 1], [1, 20, 0.7], [2, 30, 0.4]])
    assert not camera.lights_like(Camera(die_mm=2.4))
    at_mm = (np.arange(16) - 7.5) * 0.15
    on_axis = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    wanted = on_axis * (1 - 0.3 * np.hypot(at_mm, at_mm[:, None]))
    check("factor", camera_factor(camera, (16, 16), 150.0), wanted, rtol=1e-12, why="rounding")
    part = camera_factor(camera, (16, 16), 150.0, np.s_[3:9, 8:16])
    check("part", part, wanted[3:9, 8:16], rtol=1e-12, why="rounding")
    arrays = {"wavelength_nm": [500.0, 550.0, 600.0], "units": "W/m^2/sr/nm"}
    np.savez(tmp_path / "light.npz", data=np.full((16, 16, 3), 2.0), **arrays)
    image = read_irradiance(tmp_path / "light.npz", camera)
    check("radiance of a file", image.data[:, :, 1], 2 * wanted, rtol=1e-6, why="float32")
