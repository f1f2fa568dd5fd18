"""Light from beyond the picture, which a real lens's blur brings into it: against a larger picture
of the same scene.
"""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixsim import load_scene, render
from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.light.exr import read_channels, read_exr, write_channels, write_exr
from pixsim.light.spectral import SpectralImage
from pixsim.light.stored import PictureFile
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import Tiling, traced_lens
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
CHART = """
<scene version="3.0.0">
    <default name="resolution" value="96"/>
    <default name="spp" value="256"/>
    <integrator type="path"/>
    <sensor type="thinlens" id="camera">
        <float name="fov" value="5"/>
        <float name="aperture_radius" value="0.001"/>
        <float name="focus_distance" value="1"/>
        <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="pixel_format" value="rgb"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale value="HALF"/><rotate y="1" angle="180"/><translate z="1"/></transform>
        <emitter type="area">
            <texture type="bitmap" name="radiance">
                <string name="filename" value="chart.exr"/><boolean name="raw" value="true"/>
            </texture>
        </emitter>
    </shape>
    MORE
</scene>
"""
CELLS, LARGER, DIE_MM = 48, 96, 0.48  # cells of the picture and of a larger one, of the same pitch
TILING = Tiling(120.0, 210.0, 0.0)


def scene_beyond(folder: Path, half_m: float, more: str = "", **parameters: object) -> Scene:
    """A chart of random squares, much larger than the picture."""
    squares = np.kron(np.random.default_rng(2).uniform(0.1, 1.0, (40, 40)), np.ones((8, 8)))
    write_channels(folder / "chart.exr", {"Y": squares}, {})
    (folder / "scene.xml").write_text(
        CHART.replace("HALF", f"{half_m}").replace("MORE", more), encoding="utf-8"
    )
    return load_scene(folder / "scene.xml", **parameters)


def seen(
    scene: Scene, cells: int, lens: str = "singlet", **options: object
) -> tuple[SpectralImage, Camera, Plan]:
    """The light of a die of so many cells of 10 µm behind a lens of 12 mm."""
    scene = scene.with_resolution(cells)
    given = LensOptions(file=lens, focal_length_mm=12.0)
    camera = scene.camera(
        CameraOptions(die_mm=DIE_MM * cells / CELLS, object_distance_m=1.0), given
    )
    plan = make_render_plan(scene, camera, PIXEL, **options)
    plan = replace(plan, film=replace(plan.film, tiling=TILING))
    return render(scene, camera, plan=plan), camera, plan


@pytest.fixture
def some_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: TILING)


BALL = """
<shape type="sphere"><point name="center" x="0.2" y="0" z="0.9"/><float name="radius" value="0.001"/></shape>
<emitter type="constant"><spectrum name="radiance" value="0.1"/></emitter>
"""


@pytest.mark.usefixtures("some_tiles")
@pytest.mark.parametrize("more", ["", BALL], ids=["exact cells of a chart", "samples"])
def test_border_is_that_of_a_larger_picture(tmp_path: Path, more: str) -> None:
    """Blurred with all that lies beyond it, the larger picture is brute force for the smaller one,
    up to its border.
    """
    scene, physics = scene_beyond(tmp_path, 0.1, more, spp=64), derive(PIXEL)
    image, camera, plan = seen(scene, CELLS, exact=not more)
    assert (plan.film.chart is None) == bool(more)
    larger, wide, _ = seen(scene, LARGER, exact=not more)
    assert image.shape == (CELLS, CELLS)
    assert image.margin >= TILING.cells(image.pitch_um)[1] // 2
    middle = slice((LARGER - CELLS) // 2, (LARGER + CELLS) // 2)
    right = diffracted_rate(larger, wide, physics)[middle, middle]
    found = diffracted_rate(image, camera, physics)
    reflected = diffracted_rate(image.with_planes(np.array(image.planes)), camera, physics)
    border = np.ones(right.shape, bool)
    border[6:-6, 6:-6] = False
    error, without = (
        np.sqrt(np.mean((rate - right)[border] ** 2)) / right.std() for rate in (found, reflected)
    )
    assert error < 0.02  # each film has its own widening
    assert without > 5 * error
    np.testing.assert_allclose(
        image.planes, larger.planes[:, middle, middle], atol=0.25 * float(image.planes.max())
    )


def ring(rate: Array, cells: int = 6) -> Array:
    border = np.ones(rate.shape, bool)
    border[cells:-cells, cells:-cells] = False
    return rate[border]


def border_rates(scene: Scene) -> tuple[Array, float, float]:
    """Rates near the border from texels, and rms noise and rms error of those of sampled pictures,
    over the contrast.
    """
    image, camera, plan = seen(scene, CELLS, exact=True)
    assert plan.samples.exact
    assert image.margin == 12  # the reach of 21 cells, in blocks of 4
    exact, physics = diffracted_rate(image, camera, derive(PIXEL)), derive(PIXEL)
    plan = replace(plan, samples=replace(plan.samples, exact=False, spp=256))
    one, other = (
        diffracted_rate(
            render(scene.with_resolution(CELLS), camera, seed, plan=plan), camera, physics
        )
        for seed in (0, 1)
    )
    noise = np.sqrt(np.mean(ring(one - other) ** 2) / 2)
    error = np.sqrt(np.mean([ring(rate - exact) ** 2 for rate in (one, other)]))
    return exact, noise / exact.std(), error / exact.std()


@pytest.mark.usefixtures("some_tiles")
def test_a_chart_that_ends_with_the_film_goes_on_as_its_mirror_image() -> None:
    """By texels as by samples. A chart is the picture: its end is no edge of the scene, and does
    not darken the border.
    """
    scene = load_scene("csf")
    _, noise, error = border_rates(scene)
    assert noise < 2e-3
    assert error == pytest.approx(noise, rel=0.15)  # 1000 cells
    camera = seen(scene, CELLS)[1]
    for options in ({}, {"exact": True}, {"full": True}):
        assert make_render_plan(scene, camera, PIXEL, **options).film.ends == (True, True)
    image, camera, _ = seen(load_scene("flat"), CELLS, exact=True)
    even = diffracted_rate(image, camera, derive(PIXEL))[CELLS // 2]
    assert even[:3].mean() / even[8:11].mean() == pytest.approx(
        1, abs=0.02
    )  # the fall-off of the lens


@pytest.mark.usefixtures("some_tiles")
def test_a_chart_that_ends_beyond_the_film_is_black_there(tmp_path: Path) -> None:
    """By texels as by samples, where its rectangle ends in a render with a margin."""
    endless, camera, plan = seen(scene_beyond(tmp_path, 0.1), CELLS, exact=True)
    assert plan.film.ends == (False, False)
    far = diffracted_rate(endless, camera, derive(PIXEL))
    half_m = camera.die_mm / (2 * camera.image_distance_mm)  # of the view at 1 m
    exact, noise, error = border_rates(scene_beyond(tmp_path, 1.1 * half_m))
    assert noise < 5e-3
    assert error == pytest.approx(noise, rel=0.15)
    assert ring(exact, 1).mean() / exact.mean() < 0.97 * ring(far, 1).mean() / far.mean()


@pytest.mark.parametrize("larger", [1.0, 1.25, 2.0])
def test_cells_beyond_a_chart_have_the_share_of_its_light(larger: float) -> None:
    """An even chart of 30 × 40 texels on 12 × 16 cells, and on a film that is larger."""
    chart = Chart(np.ones((30, 40)), (2.5, 2.5), (12, 16))
    shape = round(12 * larger), round(16 * larger)
    picture = replace(chart, shape=shape).picture()
    assert picture.sum() == pytest.approx(12 * 16, rel=1e-12)
    inside = picture[
        (shape[0] - 12) // 2 + 1 : (shape[0] + 12) // 2 - 1,
        (shape[1] - 16) // 2 + 1 : (shape[1] + 16) // 2 - 1,
    ]
    np.testing.assert_allclose(inside, 1, rtol=1e-12)
    assert (picture[0, 0] == 0) == (larger > 1.1)


@pytest.mark.usefixtures("some_tiles")
def test_sides_at_which_a_scene_ends_are_found_one_by_one(tmp_path: Path) -> None:
    scene = load_scene("slanted_edge", resolution=CELLS)  # its chart is a square
    lens = LensOptions(file="singlet", focal_length_mm=12.0)
    ends = [
        make_render_plan(
            scene, scene.camera(CameraOptions(die_mm=DIE_MM, die_height_mm=height), lens), PIXEL
        ).film.ends
        for height in (None, 0.32)
    ]
    assert ends == [(True, True), (False, True)]
    camera = scene.camera(CameraOptions(die_mm=DIE_MM), lens)
    thin = make_render_plan(scene, scene.camera(), PIXEL)
    assert thin.film.margin((CELLS, CELLS), 10.0) == 0
    beyond = make_render_plan(
        scene_beyond(tmp_path, 0.1, BALL).with_resolution(CELLS), camera, PIXEL
    )
    assert beyond.film.ends == (False, False)
    assert beyond.film.margin((16, 16), 10.0) == 8  # no more than half of the picture
    assert traced_lens(camera.lens, 1.0).prescription.name  # type: ignore[arg-type]


def test_margins_are_mirrored_where_a_scene_ends() -> None:
    rng = np.random.default_rng(0)
    whole = rng.random((12, 10, 2))
    for ends in ((True, True), (False, True), (True, False), (False, False)):
        found = whole.copy()
        mirror_margins(found, 3, ends)
        rows, columns = (slice(3, -3) if end else slice(None) for end in ends)
        pad = [(3, 3) if end else (0, 0) for end in (*ends, False)]
        np.testing.assert_array_equal(found, np.pad(whole[rows, columns], pad, "symmetric"))


def light(margin: int, factored: bool) -> SpectralImage:
    pictures = np.random.default_rng(4).random((2, 24, 32)).astype(np.float32)
    spectra = np.array([[1.0, 2.0, 0.5], [0.2, 0.1, 0.3]])
    content = (
        {"factors": (spectra, pictures)}
        if factored
        else {"data": np.moveaxis(pictures, 0, 2) @ spectra}
    )
    return SpectralImage(
        [450.0, 550.0, 650.0], 100.0, 5.0, margin=margin, header={"scene": "x"}, **content
    )


@pytest.mark.parametrize("factored", [True, False])
def test_margins_are_beside_the_picture_and_survive_files_and_copies(
    factored: bool, tmp_path: Path
) -> None:
    image, whole = light(4, factored), light(0, factored)
    assert image.shape == (16, 24)
    assert image.whole.shape == whole.shape == (24, 32)
    np.testing.assert_array_equal(image.data, whole.data[4:-4, 4:-4])
    np.testing.assert_array_equal(image.whole.data, whole.data)
    np.testing.assert_array_equal(image.illuminance_lx(), whole.illuminance_lx()[4:-4, 4:-4])
    write_exr(tmp_path / "light.exr", image)
    copies = [read_exr(tmp_path / "light.exr"), pickle.loads(pickle.dumps(image))]
    stored = PictureFile(tmp_path).stored(image)
    for copy in (*copies, stored, stored.in_memory()):
        assert (copy.margin, copy.shape) == (4, (16, 24))
        np.testing.assert_array_equal(copy.data, image.data)
        np.testing.assert_array_equal(copy.whole.data, whole.data)
    channels, header = read_channels(tmp_path / "light.exr")
    assert [tuple(int(n) for n in corner) for corner in header["displayWindow"]] == [
        (0, 0),
        (23, 15),
    ]
    assert [tuple(int(n) for n in corner) for corner in header["dataWindow"]] == [
        (-4, -4),
        (27, 19),
    ]
    assert {plane.shape for plane in channels.values()} == {(24, 32)}
    coarse = coarser(
        SpectralImage(
            [550.0], 10.0, 5.0, data=np.random.default_rng(1).random((40, 40, 1)), margin=4
        ),
        2,
    )
    assert (coarse.margin, coarse.shape) == (2, (16, 16))
    np.testing.assert_allclose(coarse.whole.data.mean(), coarse.whole.data.astype(float).mean())


def test_a_picture_without_a_margin_is_written_as_before(tmp_path: Path) -> None:
    write_exr(tmp_path / "light.exr", light(0, True))
    _, header = read_channels(tmp_path / "light.exr")
    assert "margin" not in json.loads(header["pixsim"])
    assert light(0, True).whole.shape == (24, 32)


def test_a_margin_that_leaves_no_picture_is_refused() -> None:
    for margin in (12, -1):
        with pytest.raises(
            PixsimError, match=r"margin: got -?\d+; allowed: 0 or more, and less than half"
        ):
            light(margin, True)
