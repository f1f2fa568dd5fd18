"""Chief ray angles of a camera: from files, rows and TOML, as values in hashes and settings, and
what is refused.
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import command
from helpers.tiny import tiny_toml

from pixsim.base.errors import PixsimError
from pixsim.base.records import checked
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.report.settings import record_rows
from pixsim.studies.files import load_study, settings_text
from pixsim.studies.sensors import matched_cameras
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import settings_layer

CRA = "image_height_mm,deg\n0,0\n1,12\n2,21.5\n"
ROWS = ((0.0, 0.0), (1.0, 12.0), (2.0, 21.5))
LIT = ((0.0, 0.0, 1.0), (1.0, 12.0, 0.9), (2.0, 21.5, 0.7))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a folder `lens` of a table and a settings file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lens").mkdir()
    (tmp_path / "lens/cra.csv").write_text(CRA, encoding="utf-8")
    (tmp_path / "lens/camera.toml").write_text(
        '[camera]\nchief_ray_angle = "cra.csv"\n', encoding="utf-8"
    )
    return tmp_path


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        (CRA, ROWS),
        (f"# f/1.8\n\n{CRA.upper()}\n", ROWS),
        ("deg;image_height_mm\n0;0\n12;1\n21,5;2\n", ROWS),
        ("relative_illumination\timage_height_mm\tdeg\n1\t0\t0\n0.9\t1\t12\n0.7\t2\t21.5\n", LIT),
    ],
)
def test_table_is_read_by_the_names_of_its_columns(text: str, rows: object, tmp_path: Path) -> None:
    file = tmp_path / "cra.csv"
    file.write_text(text, encoding="utf-8")
    camera = Camera(chief_ray_angle=file)
    assert camera.chief_ray_angle == rows == Camera(chief_ray_angle=str(file)).chief_ray_angle
    assert Camera(chief_ray_angle=[list(row) for row in rows]) == camera
    assert (camera.relative_illumination is None) == (rows is ROWS)
    assert Camera.model_validate(json.loads(camera.model_dump_json())) == camera


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "without these columns; allowed: a CSV file with the columns image_height_mm, deg"),
        ("0,0\n1,12\n2,21\n", "Make the first line of 'cra.csv' image_height_mm,deg"),
        ("image_height_mm,deg,relative_ilumination\n0,0,1\n2,3,1\n", "without these columns"),
        ("image_height_mm,deg\n", "'cra.csv' of 0 rows; allowed: 2 to 1000 rows"),
        ("image_height_mm,deg\n0,0\n1\n", "no 2 numbers in line 3"),
        ("image_height_mm,deg\n0,0\n2,x\n", "no 2 numbers in line 3"),
        ("image_height_mm,deg\n0,0\n2,nan\n", "nan.* in row 2; allowed: finite"),
        ("image_height_mm,deg\n0,0\ninf,3\n", "inf.* in row 2; allowed: finite"),
        (
            "image_height_mm,deg\n-1,0\n2,3\n",
            "begins with -1 mm and 0 degrees; allowed: 0 mm and 0 degrees",
        ),
        ("image_height_mm,deg\n0,1\n2,3\n", "begins with 0 mm and 1 degrees"),
        (
            "image_height_mm,deg\n0,0\n2,3\n1,2\n",
            "2 mm followed by 1 mm; allowed: image heights that increase",
        ),
        (
            "image_height_mm,deg\n0,0\n2,90\n",
            "90 degrees in row 2; allowed: above -90 and below 90",
        ),
        (
            "image_height_mm,deg\n0,0\n1.5,20\n",
            "ends at an image height of 1.5 mm; allowed: up to the corner.*1.9189 mm",
        ),
        (
            "image_height_mm,deg\n0,0\n1.9,62\n2,5\n",
            "62 degrees at 1.9 mm.*horizon.*Give smaller angles or a larger f_number",
        ),
        (
            "image_height_mm,deg,relative_illumination\n0,0,100\n2,3,80\n",
            "of 100 in row 1.*Divide percentages by 100",
        ),
        (
            "image_height_mm,deg,relative_illumination\n0,0,.8\n2,3,.7\n",
            "0.8 on the axis; allowed: 1 there. Divide all values by",
        ),
        (
            "image_height_mm,deg,relative_illumination\n0,0,1\n2,3,-.1\n",
            "of -0.1 in row 2; allowed: 0 to 2",
        ),
        (
            "image_height_mm,deg\n" + "".join(f"{row / 500},0\n" for row in range(1001)),
            "of 1001 rows; allowed: 2 to 1000 rows",
        ),
        ("image_height_mm,deg\n" + "0,0\n" * 300_000, "of 1200020 bytes.*of up to 1048576 bytes"),
        ("\x00\x01", "without these columns|not text"),
    ],
)
def test_table_that_is_none_is_refused_with_its_file(text: str, message: str, folder: Path) -> None:
    """The message names the setting and the mend, in Python, by the option, and with the TOML file
    that names the table.
    """
    (folder / "cra.csv").write_text(text, encoding="utf-8")
    (folder / "lens/cra.csv").write_text(text, encoding="utf-8")
    with pytest.raises(
        PixsimError, match=f"chief_ray_angle.*({message.replace('cra.csv', '(lens/)?cra.csv')})"
    ):
        Camera(f_number=1.4, chief_ray_angle="cra.csv")
    (folder / "lens/camera.toml").write_text(
        '[camera]\nf_number = 1.4\nchief_ray_angle = "cra.csv"\n', encoding="utf-8"
    )
    with pytest.raises(PixsimError, match="chief_ray_angle"):
        checked(Run, [settings_layer(folder / "lens/camera.toml")]).camera.over(Camera())


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("missing.csv", "'missing.csv', which does not exist"),
        (3.0, "neither a file nor a list of rows"),
        ([[0, 0], [2, "x"]], "neither a file nor a list of rows"),
        ([[0, 0], [2, 3, 1]], "all alike"),
        ([["0", "0"], "12"], "of 1 rows"),
        ([], "of 0 rows"),
        (True, "got True"),
        ([[0, 0], [1e400, 3]], "finite"),
    ],
)
def test_values_that_are_no_table_are_refused(value: Any, message: str) -> None:
    for record in (Camera, CameraOptions):
        with pytest.raises(PixsimError, match=f"chief_ray_angle.*{message}"):
            record(chief_ray_angle=value)


def test_die_of_the_scene_and_of_the_options_decides_what_the_table_must_reach() -> None:
    options = CameraOptions(chief_ray_angle=ROWS, die_mm=3.0)
    with pytest.raises(PixsimError, match=r"die of 3 × 3 mm, 2\.1214 mm"):
        options.over(Camera())
    low = CameraOptions(chief_ray_angle=ROWS, die_mm=3.0, die_height_mm=2.0).over(Camera())
    assert low.window(1.0).chief_ray_angle == ROWS
    steep = ((0.0, 0.0), (2.0, 30.0), (4.0, 89.0))  # beyond the corner the angle does not matter
    assert Camera(chief_ray_angle=steep).chief_ray_angle == steep


def test_file_is_found_next_to_the_file_that_names_it_and_stored_as_values(folder: Path) -> None:
    """In a settings file, a study, and the values of its axis; an edit of the table changes the
    hash of the settings.
    """
    layer = settings_layer(folder / "lens/camera.toml")
    settings: Run = checked(Run, [layer])
    assert settings.camera.chief_ray_angle == ROWS
    kept = tomllib.loads(settings_text(settings, "command"))
    assert kept["camera"]["chief_ray_angle"] == [list(row) for row in ROWS]
    axis = (
        '[[axis]]\nname = "angles"\nset = "camera.chief_ray_angle"\nvalues = ["cra.csv",'
        ' "flat.csv"]\n'
    )
    (folder / "lens/flat.csv").write_text("image_height_mm,deg\n0,0\n2,0\n", encoding="utf-8")
    (folder / "lens/study.toml").write_text(tiny_toml() + axis, encoding="utf-8")
    study = load_study("lens/study.toml")  # in its working directory, so that the labels are short
    values = tomllib.loads(settings_text(study, "command"))["axis"][0]["values"]
    assert [value["set"]["camera"]["chief_ray_angle"][-1] for value in values] == [
        [2.0, 21.5],
        [2.0, 0.0],
    ]
    again = Study.model_validate({"name": "again", "axis": [{"name": "angles", "values": values}]})
    assert [point.label for point in again.axis[0].points] == ["lens/cra.csv", "lens/flat.csv"]
    (folder / "lens/cra.csv").write_text(CRA.replace("21.5", "22"), encoding="utf-8")
    other: Run = checked(Run, [settings_layer(folder / "lens/camera.toml")])
    assert other.camera.content_hash != settings.camera.content_hash


def test_option_takes_a_file(folder: Path) -> None:
    """In a plan, which needs no render; relative to the working directory."""
    stack = (
        "--pixel.stack.height-um 8 --pixel.stack.index 1.5 --pixel.stack.microlens square"
        " --pixel.fill-factor 0.3"
    )
    options = "", "--camera.chief-ray-angle lens/cra.csv"
    plans = [
        command(f"plan flat --variant scalar_spectral --json {stack} {more}")[1] for more in options
    ]
    shares = [re.search(r"on axis, (\d+) % in the corner", plan) for plan in plans]
    # Microlenses above photodiodes collect more in the corner of rays of 21.5° than of a thin lens.
    assert [match and match[1] for match in shares] == ["28", "71"]
    code, _, err = command("plan flat --variant scalar_spectral --camera.chief-ray-angle cra.csv")
    assert code != 0
    assert "camera.chief_ray_angle: got 'cra.csv', which does not exist" in err


def test_cameras_of_a_comparison_share_the_lens_and_its_table() -> None:
    """The lens for another die is the same one made larger, whose image heights grow with it; a
    cropped die has them as is.
    """
    reference = Camera(die_mm=2.0, die_height_mm=1.5, chief_ray_angle=ROWS)
    larger = Camera(die_mm=4.0, die_height_mm=4.0)
    _, seen = matched_cameras([reference, larger], "view")
    assert seen.chief_ray_angle == tuple((2 * height, angle) for height, angle in ROWS)
    _, seen = matched_cameras([reference, larger], "lens")
    assert seen.chief_ray_angle == ROWS


def test_pages_show_the_range_of_a_table_in_its_unit() -> None:
    rows = {
        name: value
        for name, value, *_ in record_rows(
            "camera", CameraOptions(chief_ray_angle=ROWS), from_data_sheet=False
        )
    }
    assert rows["chief_ray_angle"] == "curve of 3 points, 0 to 2 mm"
