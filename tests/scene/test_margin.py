"""Light from beyond the picture, which a real lens's blur brings into it: against a larger picture
of the same scene.
"""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import lens_xml, scene_file, sensor_xml

from pixsim import load_scene, render
from pixsim.base.arrays import Array
from pixsim.light.exr import read_channels, read_exr, write_channels, write_exr
from pixsim.light.spectral import SpectralImage
from pixsim.light.stored import PictureFile
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import Tiling
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import mirror_margins
from pixsim.scene.rules import Chart
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import diffracted_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.film_error import coarser

PIXEL = Pixel(pitch_um=6.5)
CHART = """<integrator type="path"/><shape type="rectangle">
    <transform name="to_world"><scale value="HALF"/><rotate y="1" angle="180"/><translate z="1"/></transform>
    <emitter type="area"><texture type="bitmap" name="radiance">
        <string name="filename" value="chart.exr"/><boolean name="raw" value="true"/>
    </texture></emitter></shape>"""
BALL = """<shape type="sphere"><point name="center" x="0.2" y="0" z="0.9"/><float name="radius" value="0.001"/></shape>
    <emitter type="constant"><spectrum name="radiance" value="0.1"/></emitter>"""
CELLS, LARGER, DIE_MM = 48, 96, 0.48  # cells of the picture and of a larger one, of the same pitch
TILING = Tiling(120.0, 210.0, 0.0)
LENS = LensOptions(file="singlet", focal_length_mm=12.0)


@pytest.fixture(autouse=True)
def few_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: TILING)


def chart_scene(folder: Path, half_m: float, more: str = "") -> Scene:
    """A chart of random squares, much larger than the picture."""
    squares = np.kron(np.random.default_rng(2).uniform(0.1, 1.0, (40, 40)), np.ones((8, 8)))
    write_channels(folder / "chart.exr", {"Y": squares}, {})
    sensor = sensor_xml(lens_xml(5, 0.001, 1), size=(96, 96), spp=64)
    return load_scene(scene_file(folder, sensor, CHART.replace("HALF", f"{half_m}"), more))


def rendered(scene: Scene, cells: int, **options: Any) -> tuple[SpectralImage, Camera, Plan]:
    """The light of a die of so many cells of 10 µm behind a lens of 12 mm."""
    scene = scene.with_resolution(cells)
    die = CameraOptions(die_mm=DIE_MM * cells / CELLS, object_distance_m=1.0)
    camera = scene.camera(die, LENS)
    plan = make_render_plan(scene, camera, PIXEL, **options)
    return render(scene, camera, plan=plan), camera, plan


def ring(rate: Array, cells: int = 6) -> Array:
    """Return the values within some cells of the border."""
    border = np.ones(rate.shape, bool)
    border[cells:-cells, cells:-cells] = False
    return rate[border]


@pytest.mark.parametrize("more", ["", BALL], ids=["exact cells of a chart", "samples"])
def test_border_is_that_of_a_larger_picture(tmp_path: Path, more: str) -> None:
    """Blurred with all that lies beyond it, the larger picture is brute force for the smaller one,
    up to its border; each film has its widening.
    """
    scene = chart_scene(tmp_path, 0.1, more)
    physics = derive(PIXEL)
    image, camera, plan = rendered(scene, CELLS, exact=not more)
    larger, wide, _ = rendered(scene, LARGER, exact=not more)
    assert plan.film.ends == (False, False)
    assert image.margin >= TILING.cells(image.pitch_um)[1] // 2

    middle = slice((LARGER - CELLS) // 2, (LARGER + CELLS) // 2)
    expected = diffracted_rate(larger, wide, physics)[middle, middle]
    reflected = image.with_planes(np.array(image.planes))
    errors = [
        np.sqrt(np.mean(ring(diffracted_rate(light, camera, physics) - expected) ** 2))
        for light in (image, reflected)
    ]
    assert errors[0] < 0.02 * expected.std()
    assert errors[1] > 5 * errors[0]


def border_rates(scene: Scene) -> tuple[Array, float, float]:
    """Rates near the border from texels, and rms noise and rms error of those of sampled pictures,
    over the contrast.
    """
    image, camera, plan = rendered(scene, CELLS, exact=True)
    assert image.margin == 12  # the reach of 21 cells, in blocks of 4
    exact = diffracted_rate(image, camera, derive(PIXEL))
    plan = replace(plan, samples=replace(plan.samples, exact=False, spp=256))
    images = [render(scene.with_resolution(CELLS), camera, seed, plan=plan) for seed in (0, 1)]
    rates = [diffracted_rate(sampled, camera, derive(PIXEL)) for sampled in images]
    noise = np.sqrt(np.mean(ring(rates[0] - rates[1]) ** 2) / 2)
    error = np.sqrt(np.mean([ring(rate - exact) ** 2 for rate in rates]))
    return exact, noise / exact.std(), error / exact.std()


def test_a_chart_that_ends_with_the_film_goes_on_as_its_mirror_image() -> None:
    """By texels as by samples, 1000 cells. A chart is the picture: its end is no edge of the scene,
    and does not darken the border.
    """
    _, noise, error = border_rates(load_scene("csf"))
    assert noise < 2e-3
    assert error == pytest.approx(noise, rel=0.15)
    image, camera, plan = rendered(load_scene("flat"), CELLS, exact=True)
    assert plan.film.ends == (True, True)
    row = diffracted_rate(image, camera, derive(PIXEL))[CELLS // 2]
    assert row[:3].mean() / row[8:11].mean() == pytest.approx(1, abs=0.02)  # the lens's fall-off


def test_a_chart_that_ends_beyond_the_film_is_black_there(tmp_path: Path) -> None:
    """By texels as by samples, where its rectangle ends in a render with a margin."""
    image, camera, _ = rendered(chart_scene(tmp_path, 0.1), CELLS, exact=True)
    endless = diffracted_rate(image, camera, derive(PIXEL))
    half_m = camera.die_mm / (2 * camera.image_distance_mm)  # of the view at 1 m
    exact, noise, error = border_rates(chart_scene(tmp_path, 1.1 * half_m))
    assert noise < 5e-3
    assert error == pytest.approx(noise, rel=0.15)
    shares = [ring(rate, 1).mean() / rate.mean() for rate in (exact, endless)]
    assert shares[0] < 0.97 * shares[1]


@pytest.mark.parametrize("larger", [1.0, 1.25, 2.0])
def test_cells_beyond_a_chart_have_the_share_of_its_light(larger: float) -> None:
    """A uniform chart of 30 × 40 texels on 12 × 16 cells, and on a film that is larger."""
    chart = Chart(np.ones((30, 40)), (2.5, 2.5), (12, 16))
    picture = replace(chart, shape=(round(12 * larger), round(16 * larger))).picture()
    assert picture.sum() == pytest.approx(12 * 16, rel=1e-12)
    assert picture.max() == pytest.approx(1, rel=1e-12)
    assert (picture[0, 0] == 0) == (larger > 1.1)


def test_sides_at_which_a_scene_ends_are_found_one_by_one() -> None:
    """The chart of the slanted edge is a square; a thin lens needs no margin."""
    scene = load_scene("slanted_edge", resolution=CELLS)
    for height_mm, ends in ((None, (True, True)), (0.32, (False, True))):
        camera = scene.camera(CameraOptions(die_mm=DIE_MM, die_height_mm=height_mm), LENS)
        film = make_render_plan(scene, camera, PIXEL).film
        assert film.ends == ends
        assert film.margin((16, 16), 10.0) == 8  # no more than half of the picture
    assert make_render_plan(scene, scene.camera(), PIXEL).film.margin((CELLS, CELLS), 10.0) == 0


@pytest.mark.parametrize("ends", [(True, True), (False, True), (True, False), (False, False)])
def test_margins_are_mirrored_where_a_scene_ends(ends: tuple[bool, bool]) -> None:
    picture = np.random.default_rng(0).random((12, 10, 2))
    rows, columns = (slice(3, -3) if end else slice(None) for end in ends)
    padding = [(3 * end, 3 * end) for end in (*ends, False)]
    expected = np.pad(picture[rows, columns], padding, "symmetric")
    mirror_margins(picture, 3, ends)
    np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize("factored", [True, False])
def test_margins_are_beside_the_picture_and_survive_files_and_copies(
    factored: bool, tmp_path: Path
) -> None:
    pictures = np.random.default_rng(4).random((2, 24, 32)).astype(np.float32)
    spectra = np.array([[1.0, 2.0, 0.5], [0.2, 0.1, 0.3]])
    data = np.moveaxis(pictures, 0, 2) @ spectra
    light: dict[str, Any] = {"factors": (spectra, pictures)} if factored else {"data": data}
    image = SpectralImage([450.0, 550.0, 650.0], 100.0, 5.0, margin=4, **light)
    write_exr(tmp_path / "light.exr", image)
    stored = PictureFile(tmp_path).stored(image)
    copies = [image, read_exr(tmp_path / "light.exr"), pickle.loads(pickle.dumps(image))]
    for copy in (*copies, stored, stored.in_memory()):
        assert (copy.margin, copy.shape) == (4, (16, 24))
        np.testing.assert_allclose(copy.data, data[4:-4, 4:-4], rtol=1e-6)
        np.testing.assert_allclose(copy.whole.data, data, rtol=1e-6)

    channels, header = read_channels(tmp_path / "light.exr")
    windows = [np.ravel(header[name]).tolist() for name in ("displayWindow", "dataWindow")]
    assert windows == [[0, 0, 23, 15], [-4, -4, 27, 19]]
    assert {plane.shape for plane in channels.values()} == {(24, 32)}


def test_margins_of_a_coarser_picture_are_its_cells() -> None:
    picture = np.random.default_rng(1).random((40, 40, 1))
    coarse = coarser(SpectralImage([550.0], 10.0, 5.0, data=picture, margin=4), 2)
    assert (coarse.margin, coarse.shape) == (2, (16, 16))
    expected = picture.reshape(20, 2, 20, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.whole.data[:, :, 0], expected, rtol=1e-6)
