"""Chief ray angles and fall-off of a thin lens: from files, rows and TOML, as values in hashes and
settings; directions and light that follow from them; cameras that are refused.
"""

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.tiny import tiny_toml

from pixsim import PixsimError, Study, optics, read_irradiance
from pixsim.base.records import checked
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_light import camera_factor, camera_pupil
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.stack import Stack, collected_shares
from pixsim.studies.files import load_study, settings_text
from pixsim.studies.sensors import matched_cameras
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
        ("image_height_mm deg\n0 0\n1 12\n2 21,5\n", ROWS),
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


def test_file_is_found_next_to_the_file_that_names_it_and_stored_as_values(here: Path) -> None:
    """In a settings file, a study, and the values of its axis; an edit of the table changes the
    hash of the settings.
    """
    folder = here / "lens"
    folder.mkdir()
    axis = '[[axis]]\nname = "angles"\nset = "camera.chief_ray_angle"\nvalues = ["cra.csv", "flat.csv"]'
    for name, text in {
        "cra.csv": CRA,
        "flat.csv": "image_height_mm,deg\n0,0\n2,0\n",
        "camera.toml": '[camera]\nchief_ray_angle = "cra.csv"\n',
        "study.toml": f"{tiny_toml()}{axis}\n",
    }.items():
        (folder / name).write_text(text)
    settings: Run = checked(Run, [settings_layer(folder / "camera.toml")])
    table = tomllib.loads(settings_text(settings, "command"))["camera"]["chief_ray_angle"]
    assert table == [list(row) for row in ROWS]
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
    view, lens = (matched_cameras([reference, larger], same)[1] for same in ("view", "lens"))
    assert view.chief_ray_angle == tuple((2 * height, angle) for height, angle in ROWS)
    assert lens.chief_ray_angle == ROWS
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
        camera = Camera(
            die_mm=2.8, f_number=f_number, chief_ray_angle=[[0, 0, 1], [1, 20, 0.7], [2, 30, 0.4]]
        )
        na = 1 / math.hypot(1, 2 * camera.working_f_number)
        for part in (camera, camera_pupil(camera)):
            check("aperture", part.numerical_aperture, na, rtol=1e-15, why="rounding")
        pupil = camera_pupil(camera).at(0.0, -500.0)
        check("centre", pupil.chief_cosines, [0.0, -math.sin(chief)], atol=1e-15, why="rounding")
        across, along = pupil.boundary(np.linspace(0, 2 * np.pi, 4000))[0].T
        area = float(pupil.area) / (math.pi * na * math.cos(chief))
        axes = np.array([np.ptp(across) / 2, np.ptp(along) / 2, area])
        errors.append(axes / (na * np.cos(chief) ** np.array([1, 3, 3])) - 1)
    assert np.abs(errors[1]).max() < 1e-3
    check("order", errors[0] / errors[1], np.full(3, 4.0), rtol=0.05, why="NA⁴")


# Fall-off


def test_angles_alone_leave_the_fall_off() -> None:
    plain = Camera()
    angles = plain.model_copy(update={"chief_ray_angle": ((0.0, 0.0), (2.0, 25.0))})
    geometry = plain.image_distance_mm, plain.f_number, plain.magnification
    wanted = optics.field_factor((7, 9), 200.0, *geometry)
    for camera in (plain, angles):
        check("factor", camera_factor(camera, (7, 9), 200.0), wanted, why="the same bits")
    assert plain.lights_like(angles)


def test_relative_illumination_replaces_the_fall_off(tmp_path: Path) -> None:
    """Linear between the rows, times Foote's factor on the axis; both rows have one slope."""
    camera = Camera(die_mm=2.4, chief_ray_angle=[[0, 0, 1], [1, 20, 0.7], [2, 30, 0.4]])
    assert not camera.lights_like(Camera(die_mm=2.4))
    at_mm = (np.arange(16) - 7.5) * 0.15
    on_axis = float(optics.irradiance_factor(camera.f_number, 0.0, camera.magnification))
    wanted = on_axis * (1 - 0.3 * np.hypot(at_mm, at_mm[:, None]))
    check("factor", camera_factor(camera, (16, 16), 150.0), wanted, rtol=1e-12, why="rounding")
    part = camera_factor(camera, (16, 16), 150.0, np.s_[3:9, 8:16])
    check("part", part, wanted[3:9, 8:16], rtol=1e-12, why="rounding")
    arrays = {"wavelength_nm": [500.0, 550.0, 600.0], "units": "W/m^2/sr/nm"}
    np.savez(tmp_path / "light.npz", data=np.full((16, 16, 3), 2.0), **arrays)
    image = read_irradiance(tmp_path / "light.npz", camera)
    check("radiance of a file", image.data[:, :, 1], 2 * wanted, rtol=1e-6, why="float32")


# What is refused

ANGLES = "image_height_mm,deg\n"
BOTH = "image_height_mm,deg,relative_illumination\n"
FALL_OFF = "image_height_mm,relative_illumination\n"
TABLES = [
    ("chief_ray_angle", "", "without these columns"),
    ("chief_ray_angle", "0,0\n1,12\n2,21\n", "first line of"),
    ("chief_ray_angle", ANGLES, "of 0 rows"),
    ("chief_ray_angle", f"{ANGLES}0,0\n1\n", "in line 3"),
    ("chief_ray_angle", f"{ANGLES}0,0\n2,x\n", "in line 3"),
    ("chief_ray_angle", f"{ANGLES}0,0\n2,nan\n", "in row 2.*finite"),
    ("chief_ray_angle", f"{ANGLES}-1,0\n2,3\n", "begins with -1 mm"),
    ("chief_ray_angle", f"{ANGLES}0,1\n2,3\n", "0 mm and 1 degrees"),
    ("chief_ray_angle", f"{ANGLES}0,0\n2,3\n1,2\n", "2 mm followed by 1 mm"),
    ("chief_ray_angle", f"{ANGLES}0,0\n2,90\n", "90 degrees in row 2"),
    ("chief_ray_angle", f"{ANGLES}0,0\n1e-9,1\n2,2\n", "with 1e-09 mm"),
    ("chief_ray_angle", f"{ANGLES}0,0\n1.5,20\n", "up to the corner.*1.9189 mm"),
    ("chief_ray_angle", f"{ANGLES}0,0\n1.9,62\n2,5\n", "62 degrees at 1.9 mm.*horizon"),
    (
        "chief_ray_angle",
        f"{ANGLES}0,0\n1.418805,40\n2.418805,56\n",
        "48 degrees at 1.919 mm.*horizon",
    ),
    ("chief_ray_angle", f"{BOTH}0,0,100\n2,3,80\n", "100 in row 1.*percentages"),
    ("chief_ray_angle", f"{BOTH}0,0,.8\n2,3,.7\n", "0.8 on the axis"),
    ("chief_ray_angle", f"{BOTH}0,0,1\n2,3,-.1\n", "-0.1 in row 2"),
    (
        "chief_ray_angle",
        ANGLES + "".join(f"{row / 500},0\n" for row in range(1001)),
        "of 1001 rows",
    ),
    ("chief_ray_angle", ANGLES + "0,0\n" * 300_000, "of 1200020 bytes"),
    ("fall_off", f"{FALL_OFF}0,1\n", "of the axis only"),
    ("fall_off", f"{FALL_OFF}", "of 0 rows"),
    ("fall_off", f"{FALL_OFF}0,.8\n2,.7\n", "0.8 on the axis"),
    ("fall_off", f"{FALL_OFF}0,1\n2,3\n", "of 3 in row 2"),
    ("fall_off", f"{FALL_OFF}1,.9\n1,.8\n", "1 mm followed by 1 mm"),
    ("fall_off", f"{FALL_OFF}1,.9\n", "up to the corner"),
    ("fall_off", f"{ANGLES}0,0\n2,3\n", "without these columns"),
]


@pytest.mark.parametrize(("field", "text", "words"), TABLES)
def test_tables_of_a_lens(field: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(PixsimError, match=f"(chief_ray_angle|fall_off|illumination).*{words}"):
        Camera(f_number=1.4, **{field: tmp_path / "table.csv"})


REFUSED: list[tuple[str, Callable[[], object], str]] = [
    ("focus", lambda: Camera(focal_length_mm=50.0, object_distance_m=0.05), "focal_length_mm = 50 is not shorter"),
    ("magnified", lambda: Camera(focal_length_mm=50.0, object_distance_m=0.05000000001), "magnifies"),
    ("working f-number", lambda: Camera(f_number=0.45), "f_number = 0.45 is too small"),
    ("two fall-offs", lambda: Camera(fall_off=((0.0, 1.0), (3.0, 0.5)), chief_ray_angle=[(*row, 1.0) for row in ROWS]), "one of them"),
    ("window", lambda: Camera(die_mm=2.0).window(3.0), "window_mm: got 3"),
    ("no pitch", lambda: CameraOptions(pixels=(20, 10)).over(Camera()), "camera.pixels: got"),
    ("larger die", lambda: CameraOptions(chief_ray_angle=ROWS, die_mm=3.0).over(Camera()), "2.1214 mm"),
    *(
        (f"{value!r}", lambda value=value: Camera(chief_ray_angle=value), f"chief_ray_angle.*{words}")
        for value, words in (
            ("missing.csv", "does not exist"),
            (3.0, "neither a file nor"),
            ([[0, 0], [2, "x"]], "neither a file nor"),
            ([[0, 0], [2, 3, 1]], "in every row"),
            ([["0", "0"], "12"], "of 1 rows"),
            (True, "got True"),
            ([[0, 0], [1e400, 3]], "finite"),
        )
    ),
    *(
        (f"glare of {curve}", lambda curve=curve: LensOptions(veiling_glare=curve), words)
        for curve, words in (
            ([[400, 0.1], [500, 0.1], [2001, 0.1]], "100 to 2000 nm"),
            ([[99, 0.1], [500, 0.1]], "100 to 2000 nm"),
            ([[500, 0.1]], "of 1 points"),
            ([[400, 0.1], [500, 1.0]], "a share of 1;.*In per cent"),
        )
    ),
    ("options without a file", lambda: LensOptions(refocus="field"), "refocus without file"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call", "words"), REFUSED)
def test_cameras_that_cannot_be_are_refused(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises((PixsimError, ValueError), match=words):
        call()
