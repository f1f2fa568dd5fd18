"""The error of a film from its own picture: it covers the truth, also of pictures that did not set
its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.chains import imaging as imaging_record
from helpers.film_judges import Picture, delta_e_of, other_sensor, pictures
from helpers.film_pictures import (
    CAMERA,
    JUDGES,
    PIXEL,
    SCENES,
    SET_CELLS,
    WIDTH,
    cells,
    covered,
    light,
)

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.rules import Chart
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.film_error import (
    FINER_FILMS,
    FilmSteps,
    coarser,
    film_error,
    film_steps,
    finer_parts,
    has_whole_blocks,
    measure_film,
    parts_of,
)
from pixsim.viewer.display_options import Display

ROUNDING = 3e-4  # by which rounding to the display's codes and the ADC's moves mean ΔE


def stated_and_true(
    fine: SpectralImage, times: Sequence[int], camera: Camera, pixel: Pixel, display: Display
) -> list[tuple[float, float]]:
    """The stated error of each film, and that against a film of `times` as many samples across."""
    imaging = imaging_record(camera, pixel, Exposure(), display)
    films = [coarser(fine, each) for each in times]
    *delta_e, truth = delta_e_of([*films, fine], imaging)
    return [
        (measure_film(film, [imaging]).largest_delta_e, abs(own - truth))
        for film, own in zip(films, delta_e, strict=True)
    ]


@dataclass(frozen=True)
class Judged:
    """Stated and true error of a picture, and of the difference to another sensor."""

    name: str
    stated: float
    true: float
    of_difference: float
    true_difference: float


def judged(picture: Picture) -> Judged:
    fine = picture.fine()
    film = coarser(fine, picture.times)
    steps: list[FilmSteps] = []
    delta_e = []
    for imaging in (picture.imaging, other_sensor(picture.imaging)):
        steps.append(film_steps(film, imaging, None, 1.5 * picture.imaging.pixel.pitch_um))
        delta_e.append(delta_e_of([film, fine], imaging))
    (own, truth), (other, other_truth) = delta_e
    between = steps[0].error_of_difference(steps[1])
    return Judged(
        picture.name,
        steps[0].error()[1],
        abs(own - truth),
        between,
        abs((other - own) - (other_truth - truth)),
    )


def missed(cases: dict[str, tuple[float, float]], usual: float) -> dict[str, tuple[float, float]]:
    """Those of the stated and true errors whose true one is larger. In the median, stated ones are
    below `usual` times the true.
    """
    ratios = [stated / max(true, 1e-3) for stated, true in cases.values()]
    too_small = {name: case for name, case in cases.items() if case[1] > case[0] + ROUNDING}
    print(
        f"stated over true: {np.percentile(ratios, [0, 25, 50, 75, 100]).round(1)}, missed:"
        f" {too_small}"
    )
    assert np.median(ratios) < usual
    return too_small


@pytest.mark.longest
@pytest.mark.slow
def test_stated_error_holds_for_pictures_that_set_it() -> None:
    """Ten scenes on films of 256, 512 and 1024, and textures.

    One is missed: of the cloth, a film of half a sample a dot shows almost nothing of threads as
    wide as a dot.
    """
    cases, widths = {}, (256, 512, 1024)
    for scene in SCENES:
        found = stated_and_true(
            light(scene()), [WIDTH // width for width in widths], CAMERA, PIXEL, Display(dots=512)
        )
        cases |= {
            f"{scene.__name__}, {width}": case for width, case in zip(widths, found, strict=True)
        }
    assert len(missed(cases, 20.0)) <= 1
    textures = {
        f"{across} cells, {film}": stated_and_true(
            light(cells(across, film * times, (0.1, 0.9), seed)),
            [times],
            CAMERA,
            PIXEL,
            Display(dots=512),
        )[0]
        for seed, (film, across, times) in enumerate(SET_CELLS)
    }
    assert not missed(textures, 10.0)


@pytest.mark.longest
@pytest.mark.slow
def test_stated_error_holds_for_28_of_30_pictures_that_did_not_set_it() -> None:
    """A limit that holds in 95 % of pictures misses more than two of 30 with a probability of 19 %,
    one of 80 % with 96 %.

    The two are cells as wide as a sample and in step with it, and cells of a third of a sample.
    """
    cases = {
        judge.name: stated_and_true(
            light(judge.picture(judge.film * judge.times), judge.camera),
            [judge.times],
            judge.camera,
            judge.pixel,
            judge.display,
        )[0]
        for judge in JUDGES
    }
    assert len(cases) == 30
    assert len(missed(cases, 10.0)) <= 2


@pytest.mark.parametrize("across", [192, 96, 64, 384])
def test_stated_error_holds_where_cells_are_in_step_with_samples(across: int) -> None:
    """Cells of one, two, three and half a sample: no sample cuts through a cell, and coarser films
    cannot tell.
    """
    fine, pixel = (
        light(cells(across, 1152, (0.35, 0.65), 7)),
        PIXEL.model_copy(update={"pitch_um": 12.5}),
    )
    ((stated, true),) = stated_and_true(fine, [6], CAMERA, pixel, Display(dots=96))
    assert true > 0.01
    assert true < stated < 20 * true


@pytest.mark.parametrize("times", [8, 16])
def test_stated_error_holds_for_a_zone_plate_on_one_sample_a_dot_and_on_half_of_one(
    times: int,
) -> None:
    """Its rings go on beyond the width of a dot, and the film aliases them: what is made finer of
    it shows too little.
    """
    rings = covered(
        lambda x, y: 0.5 + 0.45 * np.cos(225 * math.pi * ((x - 0.5) ** 2 + (y - 0.5) ** 2)), 2, 1024
    )
    fine, pixel, display = (
        light(rings),
        PIXEL.model_copy(update={"pitch_um": 12.5}),
        Display(dots=128),
    )
    ((stated, true),) = stated_and_true(fine, [times], CAMERA, pixel, display)
    assert true < stated < 5 * true

    imaging = imaging_record(CAMERA, pixel, Exposure(), display)
    on_films = film_steps(coarser(fine, times), imaging, None).finer_delta_e.mean(axis=1)
    assert film_error(0.0, 0.0, finer=float(np.abs(on_films[1:] - on_films[0]).max())) < 0.5 * true


GATE = 38  # of 40
CLEAR = 5e-3  # ΔE, from which a true error tells a limit that is too wide


@pytest.mark.longest
@pytest.mark.slow  # test_stated_error_holds_where_cells_are_in_step_with_samples has it of a few
def test_stated_error_holds_for_38_of_40_grey_and_coloured_pictures() -> None:
    """Zone plates, wires, natural pictures, edges, also behind a real lens, and cells of .7 to 3
    samples; and their differences.

    It is at most five times the true error in 17 of the 32 pictures that have a clear one. Of an
    error of random sign a limit that holds in 95 % is more than five times as large in 30 % of
    pictures, even if its standard deviation is known.
    """
    errors = [judged(picture) for picture in pictures()]
    assert len(errors) == 40
    assert sum(error.true <= error.stated + ROUNDING for error in errors) >= GATE
    assert sum(error.true_difference <= error.of_difference + ROUNDING for error in errors) >= GATE

    clear = [error for error in errors if error.true > CLEAR]
    assert sum(error.stated <= 5 * error.true for error in clear) >= len(clear) / 2


@pytest.mark.parametrize("number", [11, 20])
def test_error_of_a_difference_is_measured_on_the_difference(number: int) -> None:
    """It holds, and is below the sum of the errors of both sensors, whose changes from film to film
    are alike.
    """
    picture = list(pictures())[number]
    error = judged(picture)
    film = coarser(picture.fine(), picture.times)
    both = [
        film_steps(film, imaging, None).error()[1]
        for imaging in (picture.imaging, other_sensor(picture.imaging))
    ]
    assert error.true_difference - ROUNDING < error.of_difference < 0.75 * sum(both)


# --- The formula ---


def test_film_error_limits() -> None:
    assert film_error(0.0, 0.0) == 0
    assert film_error(0.01, 0.005) == pytest.approx(
        0.002
    )  # at second order 1/3 is left, at third order 1/7
    assert film_error(0.0, 0.1) == pytest.approx(0.006)  # a last step that is small by chance
    assert film_error(0.01, 0.005, finer=0.1) == pytest.approx(
        0.25
    )  # all coarser films are alike by chance
    assert film_error(0.01, 0.005, dot_samples=3.0) == film_error(
        0.01, 0.005
    )  # 2.7 samples a dot, or more
    assert film_error(0.01, 0.005, dot_samples=1.0) == pytest.approx(
        0.015
    )  # a sample may hide as much again
    assert film_error(0.01, 0.005, dot_samples=0.5) == pytest.approx(0.06)
    assert film_error(0.01, 0.005, dot_samples=0.5, is_chart=True) == film_error(
        0.01, 0.005
    )  # its finer films do not alias
    assert film_error(0.0, 0.0, 2.0, dot_samples=1.0) == 0
    assert film_error(0.0, 0.0, 2.0, dot_samples=0.5) == pytest.approx(
        0.2 * 2.0
    )  # all detail is gone


# --- Finer films ---


def test_finer_film_shows_an_edge_within_samples_where_their_means_put_it() -> None:
    """A straight edge along the samples, anywhere in one: its means over finer cells are exact."""
    across = (np.arange(192) + 0.5) / 192
    fine = np.broadcast_to(np.where(across < 0.3411, 0.9, 0.2), (192, 192)).astype(np.float32)
    for turned in (fine, fine.T):
        film = turned.reshape(32, 6, 32, 6).mean(axis=(1, 3))
        (part,) = finer_parts(light(film), 1.0, Display(dots=8), None)
        for repeated, averaged in FINER_FILMS:
            cells = 32 * repeated // averaged
            means = turned.reshape(cells, 192 // cells, cells, 192 // cells).mean(axis=(1, 3))
            np.testing.assert_allclose(
                part.finer(repeated, averaged).factors[1][0], means, rtol=1e-6
            )


def test_finer_film_keeps_the_means_of_samples() -> None:
    picture = np.random.default_rng(5).random((32, 32)).astype(np.float32)
    (part,) = finer_parts(light(picture), 1.0, Display(dots=8), None)
    same, half_more, twice = (part.finer(*film).factors[1][0] for film in FINER_FILMS)
    np.testing.assert_array_equal(same, picture)
    np.testing.assert_allclose(twice.reshape(32, 2, 32, 2).mean(axis=(1, 3)), picture, atol=1e-6)
    pairs = picture.reshape(16, 2, 16, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(half_more.reshape(16, 3, 16, 3).mean(axis=(1, 3)), pairs, atol=1e-6)
    assert twice.min() >= picture.min()
    assert twice.max() <= picture.max()


def test_finer_film_of_cells_as_wide_as_two_samples_is_the_film() -> None:
    picture = (
        np.random.default_rng(5)
        .choice([0.1, 0.4, 0.9], (16, 16))
        .astype(np.float32)
        .repeat(2, axis=0)
        .repeat(2, axis=1)
    )
    (part,) = finer_parts(light(picture), 1.0, Display(dots=8), None)
    np.testing.assert_array_equal(
        part.finer(2).factors[1][0], picture.repeat(2, axis=0).repeat(2, axis=1)
    )


def chart_light(chart: Chart) -> SpectralImage:
    """Of a chart that is half as bright at the right end as at the left one."""
    return light(chart.picture() * np.linspace(1, 0.5, chart.shape[1]))


@pytest.mark.parametrize("shape", [(96, 96), (512, 768)])
def test_finer_film_of_chart_shows_the_chart(shape: tuple[int, int]) -> None:
    """Its own means over the new samples, whole and in parts, under the light that falls off across
    the picture.
    """
    texels = np.random.default_rng(6).uniform(0.0, 1.0, (300, 500))
    chart = Chart(texels, (300 / shape[0], 500 / shape[1]), shape)
    parts = finer_parts(chart_light(chart), 4.0, Display(dots=64), chart)
    fine = chart_light(
        replace(
            chart,
            shape=(2 * shape[0], 2 * shape[1]),
            texels_per_sample=(150 / shape[0], 250 / shape[1]),
        )
    )
    assert len(parts) == (16 if shape[0] == 512 else 1)
    for part in parts:
        rows, columns = (slice(2 * side.start, 2 * side.stop) for side in part.region)
        np.testing.assert_allclose(
            part.finer(2).planes[0], fine.planes[0][rows, columns], rtol=0.006
        )  # the light's fall-off


def test_finer_films_of_chart_find_its_error_closer_than_even_samples() -> None:
    """Its texels are as wide as samples, but it is linear between them: the light within a sample
    is not even.
    """
    texels = np.random.default_rng(8).choice([0.3, 0.7], (192, 192))
    chart, pixel, display = (
        Chart(texels, (1.0, 1.0), (192, 192)),
        PIXEL.model_copy(update={"pitch_um": 12.5}),
        Display(dots=96),
    )
    film, imaging = light(chart.picture()), imaging_record(CAMERA, pixel, Exposure(), display)
    fine = light(replace(chart, shape=(1152, 1152), texels_per_sample=(1 / 6, 1 / 6)).picture())
    on_film, truth = delta_e_of([film, fine], imaging)
    true = abs(on_film - truth)
    own, even = (
        float(np.abs(np.diff(film_steps(film, imaging, shown).finer_delta_e[[1, 0, 2], 0])).max())
        for shown in (chart, None)
    )
    assert true > ROUNDING
    assert true < film_error(0.0, 0.0, finer=own) < 10 * true
    assert own < even / 2


def test_finer_parts_are_few_where_pixels_are_large() -> None:
    image = light(np.broadcast_to(np.float32(0.5), (4096, 4096)))
    display = Display(dots=512)
    sizes = [
        [part.image.shape for part in finer_parts(image, pitch_um, display, None)]
        for pitch_um in (2.0, 8.0, 12.0, 40.0)
    ]
    assert [len(size) for size in sizes] == [16, 6, 4, 0]
    assert all(sum(math.prod(shape) for shape in size) <= 1 << 19 for size in sizes)


# --- Parts of large pictures ---


@pytest.mark.parametrize("factored", [True, False])
def test_parts_of_large_picture_are_whole_blocks_at_one_scale(factored):
    fine = light(np.random.default_rng(1).random((1536, 2048)).astype(np.float32))
    if not factored:
        fine = SpectralImage(
            fine.wavelength_nm[:2],
            20.0,
            fine.pitch_um,
            data=fine.factors[1][0][:, :, None].repeat(2, axis=2),
            header=fine.header | {"lamp_w_per_m2_sr_nm": fine.header["lamp_w_per_m2_sr_nm"][:2]},
        )
    parts = list(parts_of(fine, 0.5, Display(dots=2048)))
    assert len(parts) == 16
    for part, display in parts:
        assert not any(side % 4 for side in part.shape)
        assert display.dots / part.shape[1] == pytest.approx(2048 / 2048, rel=0.02)
        assert (part.factors is not None) == factored
    assert sum(math.prod(part.shape) for part, _ in parts) < 0.5 * math.prod(fine.shape)


def test_parts_of_small_picture_is_whole():
    ((part, display),) = parts_of(light(np.ones((65, 67))), 20.0, Display(dots=64))
    assert part.shape == (64, 64)
    assert display.dots == 64


def small_image(factored: bool, height: int = 16, width: int = 24) -> SpectralImage:
    rng = np.random.default_rng(7)
    own: dict[str, object] = {"factors": (rng.random((2, 3)), rng.random((2, height, width)))}
    if not factored:
        own = {"data": rng.random((height, width, 3))}
    return SpectralImage([500, 550, 600], 50, 2.0, header={"who": "me"}, **own)


@pytest.mark.parametrize("factored", [True, False])
def test_coarser_film_conserves_light(factored: bool) -> None:
    fine = small_image(factored)
    for factor in (1, 2, 4):
        coarse = coarser(fine, factor)
        assert coarse.shape == (16 // factor, 24 // factor)
        assert coarse.pitch_um == 2.0 * factor
        assert (coarse.factors is not None) == factored
        expected = (
            fine.data.astype(float)
            .reshape(16 // factor, factor, 24 // factor, factor, 3)
            .mean(axis=(1, 3))
        )
        np.testing.assert_allclose(coarse.data, expected, rtol=3e-7)
        np.testing.assert_allclose(coarse.mean_spectrum(), fine.mean_spectrum(), rtol=1e-6)
        assert coarse.header == fine.header
        np.testing.assert_array_equal(coarse.within[0], fine.within[0])


def test_coarser_film_has_whole_blocks() -> None:
    assert has_whole_blocks((16, 24), 4)
    assert not has_whole_blocks((16, 26), 4)  # a cut picture would be another one
    assert not has_whole_blocks((8, 24), 4)
    with pytest.raises(PixsimError, match="got \\(16, 26\\)"):
        coarser(small_image(True, 16, 26), 4)
