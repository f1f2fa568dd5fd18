"""The page of one picture: it tells what score.json holds, shows the files beside it, and opens alone."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, assert_sliders_move, needs_browser
from helpers.commands import command
from helpers.looks import text_of

from pixsim.light.exr import read_channels
from pixsim.report.run import FILES, shown_picture
from pixsim.show.pictures import MOST_PICTURE_DOTS as MOST_DOTS
from pixsim.show.pictures import Picture, factor_for, grey_codes, reduced

LINE = "run csf --variant scalar_spectral -D resolution=128 --display.dots 200 --pixel.pitch-um 10.6 --raw png --out"


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ran") / "out"
    code, told, err = command(f"{LINE} {out}")
    assert code == 0, err
    assert told.splitlines()[0].endswith(f"report: {out / 'report.html'}")
    return out


def test_it_tells_what_score_json_holds(ran: Path) -> None:
    score = json.loads((ran / "score.json").read_text(encoding="utf-8"))
    page = " ".join(text_of(ran).split())
    assert f"<b>{score['mean_delta_e']:.3f}</b>" in page
    for name in ("full_well_e", "integration_s", "saturated_fraction", "mean_electrons_e", "p99_delta_e", "max_delta_e"):
        assert f"<td>{score[name]:.5g}</td>" in page, name
    assert "256 × 256 pixels of 10.6 µm (0.35um) on 2.714 × 2.714 mm" in page
    assert "3.86 mm at f/4" in page
    assert f"exposed for {1e3 * score['integration_s']:.3g} ms" in page
    assert "at 95 % of the full well" in page  # as the automatic exposure is asked to
    assert "<p>At 33.3 lp/mm, the highest frequency of the chart, the lens leaves 0.9" in page  # tests/studies/test_paper.py


def light_file(path: Path, steps: np.ndarray, pitch_um: float) -> Path:
    """Irradiance as another program wrote it: a picture of ones and twos, these about half as bright as white."""
    nm = np.arange(400.0, 701.0, 20.0)
    data = 5e-5 * steps[:, :, None] * np.ones(nm.size)
    np.savez(path, data=data, wavelength_nm=nm, units="W m^-2 nm^-1", pitch_um=pitch_um, white_cd_per_m2=300.0)
    return path


def test_it_tells_where_the_largest_errors_are(tmp_path: Path) -> None:
    """The detail of 112 dots a side with the largest mean, on the map beside the page; fine stripes are up on the right."""
    y, x = np.indices((128, 128))
    light = light_file(tmp_path / "stripes.npz", 1 + ((x // 2) % 2) * (x > 80) * (y < 40), 10.0)
    camera = "--camera.die-mm 1.28 --display.dots 256 --pixel.pitch-um 15"
    code, _, err = command(f"run {light} {camera} --out {tmp_path / 'out'}")
    assert code == 0, err
    delta_e = read_channels(tmp_path / "out/delta_e.exr")[0]["delta_e"]
    assert delta_e.shape == (250, 250)  # a pixel of 15 µm is three dots of 5 µm
    starts = sorted({*range(0, 250 - 112 + 1, 28), 250 - 112})
    means = {(left, top): delta_e[top : top + 112, left : left + 112].mean() for left in starts for top in starts}
    left, top = max(means, key=means.__getitem__)
    assert top < 40 < 100 < left
    x_mm, y_mm = ((3 + at + 56) / 256 * 1.28 for at in (left, top))
    page = text_of(tmp_path / "out")
    assert f"its centre is at x = {x_mm:.3g} mm, y = {y_mm:.3g} mm on the sensor, from the upper left" in page


def test_it_tells_how_to_look_at_it(ran: Path) -> None:
    page = " ".join(text_of(ran).split())
    distance_mm = 23 * 25.4 / 96 / np.tan(np.radians(1))  # 23 dots a degree, 96 an inch
    assert f"look at 100 % zoom, from where 23 dots span a degree ({distance_mm:.0f} mm away where a screen has 96 dots" in page
    # `assert_sliders_move` meets the pictures on those sides.
    assert "Left of the border the ideal image, right of it the sensor's picture." in page
    assert 'alt="The sensor\'s picture (10.6 µm pixels)"' in page


def test_it_tells_how_bright_the_scene_was(ran: Path) -> None:
    page = " ".join(text_of(ran).split())
    assert "display white is 1000 cd/m² in the scene; exposed for" in page
    told = "<td>white_cd_per_m2</td><td>1000</td><td>scene luminance shown as display white</td><td>the scene</td>"
    assert told in page
    assert "<td>resolution</td><td>128</td>" in page


SHEET = "--pixel.full-well-e 8000 --pixel.read-noise-e 5 --pixel.dark-current-e-per-s 10 --pixel.quantum-efficiency 0.6"


def test_a_picture_from_elsewhere_and_a_sensor_of_a_data_sheet(tmp_path: Path) -> None:
    """The page names the file, and lists no setting of a process, nor a fill factor that nobody told."""
    y, x = np.indices((6, 3000))
    light_file(tmp_path / "mine.npz", 1 + (x // 50 + y) % 2, 1.5)
    sensor = f"--pixel.technology none {SHEET} --pixel.pitch-um 1.5 --display.dots 4096"
    code, _, err = command(f"run {tmp_path / 'mine.npz'} {sensor} --camera.die-mm 4.5 --out {tmp_path / 'out'}")
    assert code == 0, err
    page = " ".join(text_of(tmp_path / "out").split())
    assert "<h1>mine with 1.5 µm pixels</h1>" in page
    assert "Irradiance: read from mine.npz." in page
    assert str(tmp_path) not in page
    assert "(data sheet)" in page
    assert "What the data sheet does not tell is taken as none." in page
    assert "comes from the technology" not in page
    rows = set(re.findall(r"<tr><td>([^<]+)</td>", page))
    assert {"full_well_e", "technology"} <= rows
    assert not {"capacitance", "well_limit", "conversion", "response", "fill_factor_law", "photodiode area over pixel area"} & rows
    assert "Each dot of the whole pictures is the mean of 4 × 4 dots of the display." in page


def test_a_picture_of_few_dots_is_enlarged_by_a_whole_number(tmp_path: Path) -> None:
    line = f"run csf --variant scalar_spectral -D resolution=64 --display.dots 40 --pixel.pitch-um 42.4 --out {tmp_path}"
    assert command(line)[0] == 0
    page = text_of(tmp_path)
    assert "--dots: 228px" in page  # 38 of 40 dots are shown
    assert "(each dot enlarged 6 ×)" in page


def test_its_pictures_are_the_files_beside_it(ran: Path) -> None:
    embedded = {base64.b64decode(each) for each in re.findall(r'src="data:image/png;base64,([^"]+)"', text_of(ran))}
    for name in ("ideal.png", "image.png", "delta_e.png"):
        assert (ran / name).read_bytes() in embedded


def test_it_links_to_every_file_and_fetches_none(ran: Path) -> None:
    page = text_of(ran)
    links = set(re.findall(r'href="([^"]+)"', page))
    assert links == {path.name for path in ran.iterdir()} - {"report.html"}
    assert links == {*FILES, "raw.png"}
    assert all(each.startswith("data:") for each in re.findall(r'src="([^"]+)"', page))
    assert "<script" not in page
    assert str(ran.parent) not in page


def test_it_is_the_same_bytes_each_time(ran: Path, tmp_path: Path) -> None:
    assert command(f"{LINE} {tmp_path}")[0] == 0
    assert (tmp_path / "report.html").read_bytes() == (ran / "report.html").read_bytes()


@pytest.mark.parametrize(("shape", "small"), [((2, 4096), (1, 1024)), ((4096, 1), (1024, 1)), ((2, 3000), (1, 1000))])
def test_a_long_thin_picture_is_shown_whole_along_its_short_side(shape: tuple[int, int], small: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    whole = rng.random(shape)
    shown = reduced(whole)
    assert shown.shape == small
    down, across = (n // m for n, m in zip(shape, small, strict=True))
    assert shown[-1, -1] == pytest.approx(whole[-down:, -across:].mean())


@pytest.mark.parametrize(("shape", "factor"), [((1024, 1024), 1), ((1025, 8), 2), ((700, 3000), 3)])
def test_large_pictures_are_shown_in_means_of_dots(shape: tuple[int, int], factor: int, tmp_path: Path) -> None:
    assert factor_for(np.zeros(shape)) == factor
    rng = np.random.default_rng(2)
    small = rng.random([n // factor for n in shape])
    (tmp_path / "own.png").write_bytes(b"the file's own bytes")
    whole = np.zeros(shape)
    inner = np.kron(small, np.ones((factor, factor)))
    whole[: inner.shape[0], : inner.shape[1]] = inner
    shown = shown_picture(tmp_path / "own.png", whole, "a name")
    if factor == 1:
        assert shown.png == b"the file's own bytes"
    else:
        assert shown == Picture(grey_codes(small), "a name")
    assert (shown.height, shown.width) == small.shape
    assert max(small.shape) <= MOST_DOTS


@needs_browser
def test_a_browser_shows_it_on_a_telephone_and_on_a_desk(ran: Path, tmp_path: Path) -> None:
    found = assert_fits(ran / "report.html", tmp_path)
    assert_sliders_move(found, pictures=1)
    for seen in found:
        assert len(seen.tiles) == 3
        assert {tuple(tile) for tile in seen.tiles} == {(112,) * 4}


@needs_browser
def test_it_prints(ran: Path, tmp_path: Path) -> None:
    headings = re.findall(r"<h2>(.*?)</h2>", text_of(ran))
    assert len(headings) == 6
    score = json.loads((ran / "score.json").read_text(encoding="utf-8"))
    told = [f"Mean ΔE {score['mean_delta_e']:.3f}", "score.json", "10.6 µm pixels"]
    assert_prints(ran / "report.html", tmp_path, range(3, 6), told, headings, headings[:3])
