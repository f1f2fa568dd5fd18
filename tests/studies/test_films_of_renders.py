"""The error that a film causes: it covers the truth, it asks for a finer film where one is needed,
and it is said.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import accumulate
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.chains import imaging as imaging_record
from helpers.film_pictures import CAMERA, PIXEL, light
from scipy.ndimage import gaussian_filter

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.report.wording import film_words
from pixsim.scene.convergence import RenderNoise
from pixsim.scene.film import MAX_ACROSS
from pixsim.scene.plan import make_plan
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import lights_of
from pixsim.studies.film_error import (
    BehindLens,
    FilmError,
    film_steps,
    measure_film,
    measured_regions,
)
from pixsim.studies.lights import render_on_film
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging

# --- Parts of large pictures ---


def texture(across: int, repeated: int) -> np.ndarray:
    """Even cells of two levels, each of some samples across."""
    return (
        np.random.default_rng(4)
        .choice([0.2, 0.8], (across, across))
        .repeat(repeated, axis=0)
        .repeat(repeated, axis=1)
    )


def behind_a_lens(smooth_cells: float) -> tuple[SpectralImage, Imaging]:
    """A texture of 384 samples behind a singlet, and what looks at it."""
    options = LensOptions(file="singlet", focal_length_mm=12.0)
    camera = camera_with_lens(Camera(die_mm=2.4, object_distance_m=5.0), CameraOptions(), options)
    image = light(gaussian_filter(texture(96, 4), smooth_cells), camera)
    image.header.update({LENS_HEADER: asdict(Tiling(300.0, 160.0, 0.0))})
    return image, imaging_record(
        camera, PIXEL.model_copy(update={"pitch_um": 12.5}), Exposure(), Display(dots=96)
    )


@pytest.mark.parametrize("most", [1, None], ids=["parts", "whole"])
def test_parts_behind_a_real_lens_have_the_blur_of_their_place(most: int | None) -> None:
    """That of their middle, on coarser films too; on the axis, a corner would be sharper.

    Over a part the blur of this lens changes by up to 9 % of the contrast.
    """
    image, imaging = behind_a_lens(2.0)
    places = measured_regions(image, 12.5, imaging.display, most)
    films = BehindLens.of(image, imaging).film_lights(places, 3)
    right = lights_of(image, imaging.camera, imaging.physics)[0].rate_e_per_s_um2
    for factor, lights in zip((1, 2, 4), films, strict=True):
        blurred = right.reshape(384 // factor, factor, 384 // factor, factor).mean(axis=(1, 3))
        for place, (found,) in zip(places or [(slice(0, 384), slice(0, 384))], lights, strict=True):
            rows, columns = (slice(side.start // factor, side.stop // factor) for side in place)
            wrong = found.rate_e_per_s_um2 - blurred[rows, columns]
            assert wrong.std() < 0.1 * blurred[rows, columns].std()
    if most:
        corner = image.with_planes(image.planes[:, places[0][0], places[0][1]])
        centred = lights_of(corner, imaging.camera, imaging.physics)[0].rate_e_per_s_um2
        assert films[0][0][0].rate_e_per_s_um2.std() < 0.9 * centred.std()


def test_films_of_a_part_behind_a_real_lens_have_one_psf() -> None:
    """A smooth picture loses nothing on a coarser film: no PSF ends elsewhere there."""
    image, imaging = behind_a_lens(6.0)
    films = BehindLens.of(image, imaging).film_lights(
        measured_regions(image, 12.5, imaging.display, 1), 2
    )
    fine, coarse = (lights[5][0].rate_e_per_s_um2 for lights in films)
    means = fine.reshape(coarse.shape[0], 2, coarse.shape[1], 2).mean(axis=(1, 3))
    assert (coarse - means).std() < 1e-3 * means.std()  # 4e-5 of it
    assert coarse.mean() == pytest.approx(means.mean(), rel=1e-6)
    on_film, on_coarse, _ = film_steps(image, imaging, None).delta_e.mean(axis=1)
    assert on_coarse == pytest.approx(
        on_film, abs=3e-4
    )  # rounding to the codes of the display and the ADC


def test_measure_film_parts_agree_with_whole(monkeypatch):
    """Of a statistically uniform texture, within the stated error of the mean over parts."""
    image = light(texture(128, 4))
    imaging = imaging_record(
        CAMERA, PIXEL.model_copy(update={"pitch_um": 9.4}), Exposure(), Display(dots=128)
    )
    whole = measure_film(image, [imaging])
    monkeypatch.setattr("pixsim.studies.film_error.MEASURED", 1 << 16)
    parts = measure_film(image, [imaging])
    assert parts.tolerated_delta_e != whole.tolerated_delta_e
    # A quarter of the picture, with its own registration of pixels and dots.
    assert parts.tolerated_delta_e[0] == pytest.approx(whole.tolerated_delta_e[0], rel=0.25)
    assert whole.delta_e[0] / 4 < parts.delta_e[0] < 4 * whole.delta_e[0]


def test_measure_film_at_gain_is_that_of_the_amplified_pixel():
    """Without noise behind the amplifier, 40 dB is a pixel with so many fewer electrons a code."""
    own, g = pixsim.derive(PIXEL.model_copy(update={"pitch_um": 18.8})), 10**2
    amplified = own.pixel.model_copy(
        update={"gain_e_per_dn": own.full_well_e / own.pixel.codes_dn / g}
    )
    cases = (own.pixel, 40.0), (amplified, 0.0), (own.pixel, 0.0)
    at_gain, same, plain = (
        measure_film(
            light(texture(64, 4)),
            [imaging_record(CAMERA, pixel, Exposure(gain_db=gain_db), Display(dots=64))],
        )
        for pixel, gain_db in cases
    )
    assert at_gain.tolerated_delta_e == pytest.approx(same.tolerated_delta_e, rel=1e-6)
    assert at_gain.delta_e == pytest.approx(same.delta_e, rel=1e-6)
    assert at_gain.delta_e[0] != pytest.approx(plain.delta_e[0], rel=1e-4)


def test_film_error_behind_a_denoiser_that_adapts_is_that_behind_the_linear_bound():
    image, pixel = light(texture(64, 4)), PIXEL.model_copy(update={"pitch_um": 50.0})
    denoised, bound, raw = (
        measure_film(
            image,
            [
                imaging_record(
                    CAMERA, pixel, Exposure(), Display(dots=32), develop=Develop(denoise=name)
                )
            ],
        )
        for name in ("nlm", "wiener_bound", "none")
    )
    assert denoised == bound
    assert denoised.delta_e != raw.delta_e


def test_measure_film_too_small_is_unknown():
    film = measure_film(
        light(np.ones((32, 32))), [imaging_record(CAMERA, PIXEL, Exposure(), Display(dots=32))]
    )
    assert math.isnan(film.largest_delta_e)
    assert not film.within_tolerance
    assert film.as_dict()["delta_e"] is None
    assert json.dumps(film.as_dict(), allow_nan=False)


# --- The film that is taken ---


def of(
    width: int, error: float, tolerated: float = 0.01, pitches: tuple[float, ...] = (5.0,)
) -> FilmError:
    return FilmError(
        (width, width), 2400 / width, pitches, (error,) * len(pitches), (tolerated,) * len(pitches)
    )


def rendered(
    error_at: Callable[[int], float], beside: float = 0.0, **options: object
) -> tuple[FilmError, list[int]]:
    scene, tried = pixsim.load_scene("csf", resolution=256), []

    def render(scene: pixsim.scene.scene.Scene, plan: object) -> tuple[SpectralImage, RenderNoise]:
        width = scene.resolution or 256
        tried.append(width)
        even = np.ones((1, 1)), np.broadcast_to(np.float32(1), (1, width, width))
        return SpectralImage([550.0], 20.0, 2400 / width, factors=even), RenderNoise(
            0.1, 0.1, 0.2, 2, "target"
        )

    def measure(image: SpectralImage, plan: object) -> FilmError:
        width = image.shape[1]
        own = of(width, error_at(width), pitches=(5.0, 0.5) if beside else (5.0,))
        return replace(own, delta_e=(own.delta_e[0], *([beside] if beside else [])))

    made, _ = render_on_film(
        scene, CAMERA, make_plan(scene, CAMERA, PIXEL), render=render, plan_of=lambda scene: make_plan(scene, CAMERA, PIXEL),
        measure=measure, **options,
    )  # fmt: skip
    return made.film, tried


def test_a_pixel_that_no_film_is_fine_enough_for_keeps_none_from_others():
    """Two pixels: the error of one falls as 1/N² and is met at 1024, while that of the other
    stays.
    """
    film, tried = rendered(lambda width: 5000 / width**2, beside=10.0)
    assert (tried, film.within_tolerance) == ([256, 512, 1024], False)
    assert film.delta_e[0] < film.tolerated_delta_e[0]
    assert film.limit.startswith("about 2 ΔE would be left")  # first order from there on: 10 / 4


@pytest.mark.parametrize(
    ("error_at", "films", "limit"),
    [
        (lambda width: 5 / width, 2, ""),
        (
            lambda width: 40 / width if width < MAX_ACROSS else 0.02,
            5,
            f"{MAX_ACROSS}",
        ),  # the widest film is expected to meet it
        (lambda width: 1e5 / width**2, 5, ""),  # second order: 0.006 on the widest
        (lambda width: 100 / width, 2, "about 0.02 ΔE would be left"),  # first order: 100/4096
        (
            lambda width: 1.0,
            2,
            "about 0.1 ΔE would be left",
        ),  # none seen, first order at best: 512/4096
        (lambda width: 10.0, 1, "about 0.04 ΔE would be left"),  # second order at best: 10/256
    ],
)
def test_render_on_film_doubles_until_error_is_tolerated_or_no_film_can_be_fine_enough(
    error_at: Callable[[int], float], films: int, limit: str
) -> None:
    film, tried = rendered(error_at)
    assert tried == [256, 512, 1024, 2048, 4096][:films]
    assert film.within_tolerance == (not limit)
    assert limit in film.limit if limit else not film.limit
    assert (
        limit.startswith("about")
        or film.within_tolerance
        or f"({film.limit})" in film_words(film.as_dict())
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [({"fixed": "set by resolution"}, "resolution"), ({"max_seconds": 0.0}, "max_seconds")],
)
def test_render_on_film_fixed_or_out_of_time_keeps_film(options, words):
    film, tried = rendered(lambda width: 1.0, **options)
    assert (tried, film.within_tolerance) == ([256], False)
    assert words in film.limit


@pytest.mark.parametrize(("limit_s", "films"), [(6.0, 1), (6.5, 2), (26.0, 2), (26.5, 3)])
def test_render_on_film_shares_its_time(
    limit_s: float, films: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each film takes 1.25 s for 256² samples, so that the next one takes four times as long: 1.25
    + 5 and 1.25 + 5 + 20 s.
    """
    clock = iter(accumulate(1.25 * 4 ** (read // 2) * (read % 2) for read in range(100)))
    monkeypatch.setattr(
        "pixsim.studies.lights.time", SimpleNamespace(perf_counter=lambda: next(clock))
    )
    film, tried = rendered(lambda width: 40 / width, max_seconds=limit_s)
    assert tried == [256, 512, 1024][:films]
    assert "max_seconds" in film.limit


def test_run_resolution_is_judged_and_default_is_finer():
    """The chart's 90 periods need more than 64 samples; a run finds this, and a fixed film is
    reported.
    """
    given = {"parameters": {"resolution": 64}, "display": {"dots": 64}, "pixel": {"pitch_um": 21.2}}
    free, fixed = (
        pixsim.run("csf", **given, **more).as_dict() for more in ({}, {"resolution": 64})
    )
    assert free["film"]["met"]
    assert free["film"]["resolution"] >= 256
    assert not fixed["film"]["met"]
    assert (fixed["film"]["resolution"], fixed["irradiance"]["film"]) == (64, [64, 64])
    truth = free["mean_delta_e"]
    assert abs(fixed["mean_delta_e"] - truth) < fixed["film"]["delta_e"] + free["film"]["delta_e"]
