"""The error of a film from its own picture: it covers the truth, also of pictures that did not set
its numbers, and it asks for a finer film where one is needed; the lights of a study's cases, whose
film is measured with the most light.
"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from itertools import accumulate
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from helpers.chains import imaging as imaging_of
from helpers.film_pictures import CAMERA, PIXEL, cells, covered, delta_e_of, light
from scipy.ndimage import gaussian_filter

import pixsim
from pixsim import Camera, Develop, Display, Exposure, SpectralImage, Study
from pixsim.optics.camera import CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.convergence import Rendered, RenderNoise
from pixsim.scene.film import MAX_ACROSS
from pixsim.scene.plan import make_plan
from pixsim.scene.rules import Chart
from pixsim.sensor.integration import lights_of
from pixsim.studies.design import Case
from pixsim.studies.engine import Workers
from pixsim.studies.film_error import (
    FINER_FILMS,
    BehindLens,
    FilmError,
    coarser,
    film_steps,
    finer_parts,
    has_whole_blocks,
    measure_film,
    measured_regions,
    parts_of,
)
from pixsim.studies.lights import Light, render_for, render_lights, render_on_film
from pixsim.studies.prepare import prepare
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge

COARSE_PIXEL = PIXEL.model_copy(update={"pitch_um": 12.5})


def imaging(pitch_um: float, dots: int, **more) -> Imaging:
    pixel = PIXEL.model_copy(update={"pitch_um": pitch_um})
    return imaging_of(CAMERA, pixel, display=Display(dots=dots), **more)


def block_means(picture: np.ndarray, cells_across: int) -> np.ndarray:
    """Means of a square picture over square cells, so many across."""
    side = picture.shape[0] // cells_across
    return picture.reshape(cells_across, side, cells_across, side).mean(axis=(1, 3))


# --- the stated error against the truth (more pictures: tests/benchmarks/film_error.py) -----------


def zone_plate() -> np.ndarray:
    return covered(
        lambda x, y: 0.5 + 0.45 * np.cos(225 * math.pi * ((x - 0.5) ** 2 + (y - 0.5) ** 2)), 2, 1024
    )


@pytest.mark.parametrize(
    ("picture", "factor", "dots", "least_error", "longest"),
    [
        # Cells of one and of half a sample: no sample cuts through a cell, and coarser films cannot
        # tell.
        (partial(cells, 192, 1152, (0.35, 0.65), 7), 6, 96, 0.01, 20),
        (partial(cells, 384, 1152, (0.35, 0.65), 7), 6, 96, 0.01, 20),
        # Rings that go on beyond the width of a dot, of one sample: the film aliases them, and what
        # is made finer of it shows too little.
        (zone_plate, 8, 128, 0.0, 5),
    ],
    ids=["a cell a sample", "two cells a sample", "a sample a dot"],
)
def test_stated_error_holds_and_is_not_long(
    picture: Callable[[], np.ndarray], factor: int, dots: int, least_error: float, longest: float
) -> None:
    fine = light(picture())
    film = coarser(fine, factor)
    on_film, truth = delta_e_of([film, fine], imaging(12.5, dots))
    stated = measure_film(film, [imaging(12.5, dots)]).largest_delta_e
    assert least_error < abs(on_film - truth) < stated < longest * abs(on_film - truth)


def test_error_of_a_difference_is_measured_on_the_difference() -> None:
    """It holds, and is below the sum of the errors of both sensors, whose changes from film to film
    are alike.
    """
    fine = light(
        covered(lambda x, y: np.where((0.6 * x + 0.8 * y) * 7 % 1 < 0.5, 0.1, 0.9), 4, 1024)
    )
    film = coarser(fine, 4)
    sensors = [imaging(13.0, 128), imaging(19.5, 128)]
    steps, other_steps = (film_steps(film, sensor, None, 19.5) for sensor in sensors)
    error, other_error = np.diff([delta_e_of([film, fine], sensor) for sensor in sensors])[:, 0]
    stated = steps.error_of_difference(other_steps)
    rounding = 3e-4  # to the display's codes and the ADC's
    assert abs(other_error - error) - rounding < stated
    assert stated < 0.75 * (steps.error()[1] + other_steps.error()[1])


# --- films of more samples and of fewer -----------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1])
def test_finer_film_shows_an_edge_within_samples_where_their_means_put_it(axis: int) -> None:
    """A straight edge along the samples, anywhere in one: its means over finer cells are exact."""
    edge = np.where(np.arange(192) < 65, 0.9, 0.2).astype(np.float32)
    fine = np.stack([edge] * 192, axis=axis)
    (part,) = finer_parts(light(block_means(fine, 32)), 1.0, Display(dots=8), None)
    for repeated, averaged in FINER_FILMS:
        expected = block_means(fine, 32 * repeated // averaged)
        np.testing.assert_allclose(
            part.finer(repeated, averaged).factors[1][0], expected, rtol=1e-6
        )


def test_finer_film_keeps_the_means_of_samples() -> None:
    picture = np.random.default_rng(5).random((32, 32)).astype(np.float32)
    (part,) = finer_parts(light(picture), 1.0, Display(dots=8), None)
    same, half_more, twice = (part.finer(*film).factors[1][0] for film in FINER_FILMS)
    np.testing.assert_array_equal(same, picture)
    np.testing.assert_allclose(block_means(twice, 32), picture, atol=1e-6)
    np.testing.assert_allclose(block_means(half_more, 16), block_means(picture, 16), atol=1e-6)
    assert picture.min() <= twice.min() < twice.max() <= picture.max()


def chart_light(chart: Chart) -> SpectralImage:
    """Of a chart that is half as bright at the right end as at the left one."""
    return light(chart.picture() * np.linspace(1, 0.5, chart.shape[1]))


@pytest.mark.parametrize(("shape", "count"), [((96, 96), 1), ((512, 768), 16)])
def test_finer_film_of_a_chart_shows_the_chart(shape: tuple[int, int], count: int) -> None:
    """Its own means over the new samples, whole and in parts, under the light that falls off across
    the picture.
    """
    height, width = shape
    texels = np.random.default_rng(6).uniform(0.0, 1.0, (300, 500))
    chart = Chart(texels, (300 / height, 500 / width), shape)
    parts = finer_parts(chart_light(chart), 4.0, Display(dots=64), chart)
    finer = replace(
        chart, shape=(2 * height, 2 * width), texels_per_sample=(150 / height, 250 / width)
    )
    expected = chart_light(finer).planes[0]
    assert len(parts) == count
    for part in parts:
        rows, columns = (slice(2 * side.start, 2 * side.stop) for side in part.region)
        # The light within an old sample falls off, too.
        np.testing.assert_allclose(part.finer(2).planes[0], expected[rows, columns], rtol=0.006)


@pytest.mark.parametrize(("pitch_um", "count"), [(2.0, 16), (8.0, 6), (12.0, 4), (40.0, 0)])
def test_finer_parts_are_few_where_pixels_are_large(pitch_um: float, count: int) -> None:
    image = light(np.broadcast_to(np.float32(0.5), (4096, 4096)))
    parts = finer_parts(image, pitch_um, Display(dots=512), None)
    assert len(parts) == count
    assert sum(math.prod(part.image.shape) for part in parts) <= 1 << 19


def test_small_picture_is_its_own_part_in_whole_blocks() -> None:
    """A cut picture would be another one."""
    ((part, display),) = parts_of(light(np.ones((65, 67))), 20.0, Display(dots=64))
    assert (part.shape, display.dots) == ((64, 64), 64)
    shapes = [(16, 24), (16, 26), (8, 24)]
    assert [has_whole_blocks(shape, 4) for shape in shapes] == [True, False, False]


RNG = np.random.default_rng(7)
FACTORED = {"factors": (RNG.random((2, 3)), RNG.random((2, 16, 24)))}
FULL = {"data": RNG.random((16, 24, 3))}


@pytest.mark.parametrize("planes", [FACTORED, FULL], ids=["factored", "full"])
@pytest.mark.parametrize("factor", [1, 2, 4])
def test_coarser_film_conserves_light(planes: dict, factor: int) -> None:
    fine = SpectralImage([500, 550, 600], 50, 2.0, header={"source": "a.exr"}, **planes)
    coarse = coarser(fine, factor)
    blocks = fine.data.astype(float).reshape(16 // factor, factor, 24 // factor, factor, 3)
    assert coarse.pitch_um == 2.0 * factor
    assert (coarse.factors is None) == (fine.factors is None)
    assert coarse.header == fine.header
    np.testing.assert_allclose(coarse.data, blocks.mean(axis=(1, 3)), rtol=3e-7)
    np.testing.assert_allclose(coarse.mean_spectrum(), fine.mean_spectrum(), rtol=1e-6)


def test_coarser_film_has_the_light_beyond_the_picture() -> None:
    whole = np.random.default_rng(7).random((24, 24)).astype(np.float32)
    coarse = coarser(light(np.ones((16, 16))).with_planes(whole[None], margin=4), 2)
    assert (coarse.shape, coarse.margin) == ((8, 8), 2)
    np.testing.assert_allclose(coarse.whole.planes[0], block_means(whole, 12), rtol=1e-6)


# --- parts behind a real lens ---------------------------------------------------------------------


def behind_a_lens(smooth_cells: float) -> tuple[SpectralImage, Imaging]:
    """A texture of 384 samples behind a singlet, and what looks at it."""
    options = LensOptions(file="singlet", focal_length_mm=12.0)
    camera = camera_with_lens(Camera(die_mm=2.4, object_distance_m=5.0), CameraOptions(), options)
    image = light(gaussian_filter(cells(96, 384, (0.2, 0.8), 4), smooth_cells), camera)
    image.header.update({LENS_HEADER: asdict(Tiling(300.0, 160.0, 0.0))})
    return image, imaging_of(camera, COARSE_PIXEL, Exposure(), Display(dots=96))


@pytest.mark.parametrize("max_count", [1, None], ids=["parts", "whole"])
def test_parts_behind_a_real_lens_have_the_blur_of_their_place(max_count: int | None) -> None:
    """On coarser films, too. Over a part the blur of this lens changes by up to 9 % of the
    contrast.
    """
    image, behind = behind_a_lens(2.0)
    regions = measured_regions(image, 12.5, behind.display, max_count)
    films = BehindLens.of(image, behind).film_lights(regions, 3)
    whole = lights_of(image, behind.camera, behind.physics)[0].rate_e_per_s_um2
    for factor, lights in zip((1, 2, 4), films, strict=True):
        blurred = block_means(whole, 384 // factor)
        for region, (part,) in zip(regions or [(slice(0, 384),) * 2], lights, strict=True):
            rows, columns = (slice(side.start // factor, side.stop // factor) for side in region)
            expected = blurred[rows, columns]
            assert (part.rate_e_per_s_um2 - expected).std() < 0.1 * expected.std()


def test_part_at_the_edge_of_a_picture_has_the_light_beyond_it() -> None:
    """As a part inside of a larger picture has it; mirrored light would differ by its contrast."""
    image, behind = behind_a_lens(2.0)
    inner = image.with_planes(image.planes, margin=96)
    inside, at_edge = (
        BehindLens.of(picture, behind).film_lights([region], 1)[0][0][0].rate_e_per_s_um2
        for picture, region in ((image, (slice(96, 160),) * 2), (inner, (slice(0, 64),) * 2))
    )
    assert (at_edge - inside).std() < 0.02 * inside.std()


def test_smooth_picture_behind_a_real_lens_loses_nothing_on_a_coarser_film() -> None:
    """No PSF ends elsewhere there; mean ΔE moves by rounding to the codes of display and ADC."""
    image, behind = behind_a_lens(6.0)
    on_film, on_coarse, _ = film_steps(image, behind, None).delta_e.mean(axis=1)
    assert on_coarse == pytest.approx(on_film, abs=3e-4)


# --- the film that is measured --------------------------------------------------------------------


def test_film_measured_in_parts_agrees_with_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a statistically uniform texture, a quarter of the picture, with its own registration of
    pixels and dots.
    """
    image = light(cells(128, 512, (0.2, 0.8), 4))
    whole = measure_film(image, [imaging(9.4, 128)])
    monkeypatch.setattr("pixsim.studies.film_error.MEASURED", 1 << 16)
    parts = measure_film(image, [imaging(9.4, 128)])
    assert parts.tolerated_delta_e != whole.tolerated_delta_e
    assert parts.tolerated_delta_e == pytest.approx(whole.tolerated_delta_e, rel=0.25)
    assert whole.delta_e[0] / 4 < parts.delta_e[0] < 4 * whole.delta_e[0]


def test_film_behind_a_denoiser_that_adapts_is_that_behind_the_linear_bound() -> None:
    image = light(cells(64, 256, (0.2, 0.8), 4))
    denoised, bound, raw = (
        measure_film(image, [imaging(50.0, 32, develop=Develop(denoise=name))])
        for name in ("nlm", "wiener_bound", "none")
    )
    assert denoised == bound
    assert denoised.delta_e != raw.delta_e


def test_films_have_the_noise_of_a_frame() -> None:
    """Of a uniform picture, whose mean ΔE is due to noise alone; over 9000 dots it scatters by 1 %."""
    image = light(np.full((256, 256), 0.5))
    score = pixsim.evaluate(image, CAMERA, COARSE_PIXEL, display=Display(dots=96))
    steps = film_steps(image, imaging(12.5, 96), None)
    assert steps.delta_e[0].mean() == pytest.approx(score.mean_delta_e, rel=0.05)


def test_error_of_a_film_that_is_too_small_is_unknown() -> None:
    film = measure_film(light(np.ones((32, 32))), [imaging(3.75, 32)], tolerance_delta_e=0.5)
    assert film.tolerated_delta_e == (0.5,)
    assert math.isnan(film.largest_delta_e)
    assert not film.within_tolerance
    assert json.loads(json.dumps(film.as_dict(), allow_nan=False))["delta_e"] is None


# --- the film that is taken -----------------------------------------------------------------------


def rendered(*errors: Callable[[int], float], **options) -> tuple[FilmError, list[int]]:
    """The film that is taken of pixels whose errors on a width are known, and all widths that were
    tried.
    """
    scene = pixsim.load_scene("csf", resolution=256)
    widths: list[int] = []

    def render(scene, plan) -> Rendered:
        width = scene.resolution or 256
        widths.append(width)
        uniform = np.ones((1, 1)), np.broadcast_to(np.float32(1), (1, width, width))
        image = SpectralImage([550.0], 20.0, 2400 / width, factors=uniform)
        return Rendered(image, RenderNoise(0.1, 0.1, 0.2, 4, "target"))

    def measure(rendered: Rendered, plan) -> FilmError:
        image = rendered.image
        delta_e = tuple(error(image.shape[1]) for error in errors)
        count = len(errors)
        return FilmError(image.shape, image.pitch_um, (5.0, 0.5)[:count], delta_e, (0.01,) * count)

    light, _ = render_on_film(
        scene,
        CAMERA,
        make_plan(scene, CAMERA, PIXEL),
        render=render,
        plan_of=lambda scene: make_plan(scene, CAMERA, PIXEL),
        measure=measure,
        **options,
    )
    return light.film, widths


@pytest.mark.parametrize(
    ("errors", "options", "films", "limit"),
    [
        ([lambda width: 5 / width], {}, 2, ""),
        # The widest film is expected to be fine enough.
        ([lambda width: 40 / width if width < MAX_ACROSS else 0.02], {}, 5, f"{MAX_ACROSS}"),
        ([lambda width: 1e5 / width**2], {}, 5, ""),  # second order: 0.006 on the widest
        # First order: 100/4096.
        ([lambda width: 100 / width], {}, 2, "about 0.02 ΔE would be left"),
        # None seen, first order at best: 512/4096.
        ([lambda width: 1.0], {}, 2, "about 0.1 ΔE would be left"),
        # Second order at best: 10/256.
        ([lambda width: 10.0], {}, 1, "about 0.04 ΔE would be left"),
        # A pixel that no film is fine enough for keeps none from others: the error of the first
        # falls to 0.005 at 1024, where 10/4 would be left of the other's.
        ([lambda width: 5000 / width**2, lambda width: 10.0], {}, 3, "about 2 ΔE would be left"),
        ([lambda width: 1.0], {"fixed": "resolution"}, 1, "resolution"),
        ([lambda width: 1.0], {"max_seconds": 0.0}, 1, "max_seconds"),
    ],
)
def test_film_is_doubled_until_its_error_is_tolerated_or_no_film_can_be_fine_enough(
    errors: list[Callable[[int], float]], options: dict, films: int, limit: str
) -> None:
    film, widths = rendered(*errors, **options)
    assert widths == [256, 512, 1024, 2048, 4096][:films]
    assert film.within_tolerance == (not limit)
    assert limit in film.limit


@pytest.mark.parametrize(("limit_s", "films"), [(6.0, 1), (6.5, 2), (26.0, 2), (26.5, 3)])
def test_films_share_their_time(
    limit_s: float, films: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each film takes 1.25 s for 256² samples, so that the next one takes four times as long: 1.25
    + 5 and 1.25 + 5 + 20 s.
    """
    clock = accumulate(1.25 * 4 ** (read // 2) * (read % 2) for read in range(100))
    clock_module = SimpleNamespace(perf_counter=lambda: next(clock))
    monkeypatch.setattr("pixsim.studies.lights.time", clock_module)
    _, widths = rendered(lambda width: 40 / width, max_seconds=limit_s)
    assert widths == [256, 512, 1024][:films]


def test_run_takes_a_finer_film_unless_its_resolution_is_set() -> None:
    """The chart's 90 periods need more than 64 samples; the stated errors cover the difference."""
    run = partial(
        pixsim.run,
        "csf",
        parameters={"resolution": 64},
        display={"dots": 64},
        pixel={"pitch_um": 21.2},
    )
    free = run().as_dict()
    fixed = run(resolution=64).as_dict()
    assert (free["film"]["met"], fixed["film"]["met"]) == (True, False)
    assert free["film"]["resolution"] >= 256
    assert fixed["film"]["resolution"] == 64
    errors = fixed["film"]["delta_e"] + free["film"]["delta_e"]
    assert abs(fixed["mean_delta_e"] - free["mean_delta_e"]) < errors


# --- the lights of a study's cases ----------------------------------------------------------------

LUMINANCE = "scene.parameters.luminance_cd_per_m2"
LIGHTS = {"name": "light", "set": [LUMINANCE, "display.white_cd_per_m2"], "values": [10.0, 1000.0]}
LENS = {"name": "lens", "set": "camera.f_number", "values": [2.8, 8.0]}
# Cells that are computed, four for each of 64 details and more.
SMALL = {
    "name": "small",
    "resolution": 256,
    "repeats": 2,
    "scene": {"file": "csf"},
    "camera": {"die_mm": 0.7},
    "display": {"dots": 32},
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
}


def lights_of_cases(**over) -> dict[str, tuple[Case[Study], Light]]:
    """The cases of a study and their lights, by the words of the cases."""
    cases = prepare(Study.model_validate(merge(SMALL, over))).cases
    lights = render_lights(cases, lambda _: lambda *_: None, Workers(1), store=lambda image: image)
    return {case.words: (case, light) for case, light in zip(cases, lights, strict=True)}


def test_dimmer_light_is_that_of_its_render_with_the_film_of_the_brightest() -> None:
    """The film is fine enough by far with most light.

    On so few dots the measured error scatters by factors: with a tenth of the tolerance in most
    light it stays within half of it.
    """
    lights = lights_of_cases(axis=[LIGHTS], resolution=768)
    _, bright = lights["light 1000"]
    case, dim = lights["light 10"]
    expected = render_for(case)
    assert dim.film == bright.film
    assert dim.image.header == expected.image.header
    np.testing.assert_array_equal(dim.image.planes, expected.image.planes)
    assert 0.0 < expected.film.largest_delta_e < 0.5 * min(expected.film.tolerated_delta_e)


@pytest.mark.parametrize(
    ("count", "error_delta_e", "over"),
    [
        (1, 0.0009, {}),
        (2, 0.0011, {}),  # more than a tenth of the tolerated error
        (1, 0.0009, {"axis": [LIGHTS | {"set": LUMINANCE}]}),
        # A darker picture on the same display.
        (2, 0.0, {"axis": [LIGHTS | {"set": LUMINANCE}], "display": {"white_cd_per_m2": 1e3}}),
        (2, 0.0, {"exposure": {"integration_s": 0.05}}),  # bright light saturates
        (2, 0.0, {"axis": [LIGHTS, LENS]}),
        (2, 0.0, {"axis": [LIGHTS | {"set": "pixel.read_noise_e", "values": [1.0, 9.0]}]}),
    ],
)
def test_film_is_measured_once_for_cases_that_differ_in_light_alone(
    count: int, error_delta_e: float, over: dict
) -> None:
    film = FilmError((64, 64), 11.0, (5.3, 7.0, 11.0), (error_delta_e,) * 3, (0.01,) * 3)
    with patch("pixsim.studies.lights.measure_film", return_value=film) as measure:
        lights_of_cases(**{"axis": [LIGHTS], "resolution": 64} | over)
    assert measure.call_count == count
