"""Scores: what calls share, statistics, one way and another, errors and limits, and the memory of
large films.
"""

import math
import tracemalloc
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain
from helpers.commands import command
from helpers.runs import run_result
from hypothesis import given, settings, strategies as st

from pixsim import (
    Camera,
    Display,
    Exposure,
    Motion,
    Pixel,
    PixsimError,
    SpectralImage,
    evaluate,
    score_pictures,
)
from pixsim.base import arrays
from pixsim.base.caller import command_line
from pixsim.light.spectral import d65
from pixsim.report.run import shown_mean_of
from pixsim.report.wording import unconverged
from pixsim.scene.charts import csf_value
from pixsim.sensor.integration import diffracted_rate, ideal_rate, integrate_pixels
from pixsim.studies.film_error import FilmError
from pixsim.viewer import display as displays, evaluate as evaluating
from pixsim.viewer.delta_e_statistics import percentiles
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.requirements import RequirementCheck, requirement_of
from pixsim.viewer.scene_light import RecentScenes, SceneCache, SceneLight, prepare_scene
from pixsim.viewer.scielab import delta_e, filtered_lab
from pixsim.viewer.score import LightError, converged, exceeded, noise_error_and_limit

NM = np.arange(400.0, 721.0, 10)
CAMERA = Camera(die_mm=2.7136)
DISPLAY = Display(dots=96)
COLOUR = {"pattern": "rggb", "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}


def chart(count: int, **header) -> SpectralImage:
    """Return the CSF chart under D65, at 1000 cd/m² behind f/4 or so."""
    place = (np.arange(count, dtype=np.float32) + 0.5) / count
    factors = 6e-6 * d65(NM), csf_value(place, place[:, None]).astype(np.float32)[None]
    header = {"luminance_cd_per_m2": 1000.0} | header
    return SpectralImage(NM, 10.0, 2713.6 / count, factors=factors, header=header)


# --- what calls share


def test_evaluate_shares_light_and_sees_changes_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal light in another object is the same light; a caller's changes of a score or a light
    reach no other call.
    """
    make_chain = Mock(wraps=evaluating.make_chain)
    monkeypatch.setattr(evaluating, "make_chain", make_chain)
    evaluating._recent_chains.clear()
    image = chart(96)
    call = {"camera": CAMERA, "pixel": Pixel(pitch_um=28.0), "display": DISPLAY}
    first = evaluating.evaluate(image, **call, seed=1)
    first.ideal[:] = 0.0
    again = evaluating.evaluate(chart(96), **call, seed=1)
    other = evaluating.evaluate(image, **call, seed=2)
    assert make_chain.call_count == 1
    assert again.mean_delta_e == first.mean_delta_e != other.mean_delta_e
    assert again.ideal.max() > 0.5
    image.factors[1][:] = image.factors[1][:, ::-1]
    assert evaluating.evaluate(image, **call, seed=1).mean_delta_e != first.mean_delta_e
    assert make_chain.call_count == 2
    for number in range(evaluating.MAX_CHAINS + 1):
        evaluating.evaluate(image, **call, exposure=Exposure(max_integration_s=0.01 * (number + 1)))
    assert len(evaluating._recent_chains) == evaluating.MAX_CHAINS


def test_caches_of_scenes_return_what_is_prepared() -> None:
    """A cache per light and one of recent scenes; displays that differ in the viewer alone share an
    ideal picture.
    """
    settings = imaging(CAMERA, Pixel(pitch_um=28.0), display=DISPLAY)
    light = SceneLight(chart(96))
    farther = DISPLAY.model_copy(update={"samples_per_deg": 46.0})
    cache = SceneCache(settings, light, others=[farther])
    scene = cache.get("pixel", settings)
    assert cache.get("pixel", settings) is scene
    near, far = scene.screens
    assert far.ideal is near.ideal
    np.testing.assert_array_equal(
        far.ideal_lab, prepare_scene(settings.changed(display=farther), light).screen.ideal_lab
    )
    assert cache.ideal_facts("pixel", settings) == cache.ideal_facts("other", settings)
    # Two planes of light and spline, and four of the ideal picture and its CIELAB, of 8 bytes.
    assert cache.capacity == 2**28 // (8 * (2 * 96**2 + 4 * 2 * 96**2))

    recent = RecentScenes()
    scenes = [recent(settings, light) for _ in range(2)]
    assert scenes[0] is scenes[1]
    other = recent(settings.changed(display=farther), light)
    assert other is not scenes[0]
    assert other.lights is scenes[0].lights
    recent.drop_all_but([])
    assert recent(settings, light) is not scenes[0]


# --- statistics


@settings(derandomize=True, database=None, deadline=None, max_examples=25)
@given(
    values=st.lists(st.floats(0, 1e30, allow_subnormal=False), min_size=1, max_size=50),
    count=st.sampled_from([1, 100]),
)
def test_percentiles_are_those_of_numpy(values: list[float], count: int) -> None:
    """Also of many equal values, and of one that is far above all others."""
    array = np.repeat(np.array(values), count)
    percent = (0, 1.7, 50, 90, 99, 100)
    np.testing.assert_allclose(percentiles(array, percent), np.percentile(array, percent), 1e-14)


# --- one way and another


@pytest.mark.parametrize("formula", ["1976", "2000"])
@pytest.mark.parametrize("colour", [None, COLOUR])
def test_score_is_the_difference_of_two_cielab_pictures(formula, colour) -> None:
    """Through XYZ in three channels; without shortcuts the score is the same to rounding."""
    display = DISPLAY.model_copy(update={"delta_e": formula})
    call = {"camera": CAMERA, "pixel": Pixel(pitch_um=28.0, colour=colour), "display": display}
    score = evaluating.evaluate(chart(96), **call)
    view = {"white_xyz": displays.WHITE_XYZ, "samples_per_deg": display.samples_per_deg}
    to_xyz = displays.to_xyz if colour is None else displays.rgb_to_xyz
    labs = [filtered_lab(to_xyz(picture), **view) for picture in (score.ideal, score.image)]
    np.testing.assert_allclose(score.delta_e, delta_e(*labs, formula), atol=1e-9)
    np.testing.assert_allclose(
        evaluating.evaluate(chart(96), **call, full=True).delta_e, score.delta_e, atol=1e-9
    )


@pytest.mark.parametrize(
    ("colour", "fields"),
    [(None, {}), (None, {"raster": "one_to_one", "filters": "zhang1996"}), (COLOUR, {"bits": 3})],
)
def test_pictures_of_a_score_have_its_difference_bit_for_bit(colour, fields) -> None:
    """Codes of codes are the same."""
    score = evaluating.evaluate(
        chart(96),
        CAMERA,
        Pixel(pitch_um=28.0, colour=colour),
        display=DISPLAY.model_copy(update=fields),
    )
    again = score_pictures(score.ideal, score.image, score.display)
    np.testing.assert_array_equal(again.delta_e, score.delta_e)
    np.testing.assert_array_equal(again.image, score.image)
    assert again.statistics() == {name: score.statistics()[name] for name in DELTA_E.columns}


def test_pictures_are_rounded_and_clipped_to_the_display() -> None:
    """2 bits at γ = 1: light of 0, 1/3, 2/3 and 1; grey differs as equal primaries do."""
    picture = np.repeat([[-0.5, 0.1, 0.4, 0.6, 0.995, 1.004]], 4, axis=0)
    display = Display(bits=2, gamma=1.0)
    with pytest.warns(UserWarning, match="17 % of the ideal image is brighter than display white"):
        score = score_pictures(picture, picture[:, ::-1], display)
    np.testing.assert_allclose(score.ideal[0], [0, 0, 1 / 3, 2 / 3, 1, 1], atol=1e-15)
    pair = [np.repeat(grey[..., None], 3, axis=2) for grey in (score.ideal, score.image)]
    np.testing.assert_allclose(score_pictures(*pair, display).delta_e, score.delta_e, atol=1e-9)


@pytest.mark.parametrize(("share", "is_refused"), [(0.999, False), (1.0, False), (1.001, True)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("lines_s", [0.0, 0.02])
@pytest.mark.parametrize(
    ("display", "registration"), [(DISPLAY, None), (Display(raster="one_to_one"), (0.25, 0.25))]
)
def test_motion_takes_the_margin_on_both_sides(
    axis: int, lines_s: float, share: float, is_refused: bool, display: Display, registration
) -> None:
    """The longest path, of a row and until the last one is read, is twice the room between the
    scored dots and the border of the pixels; of registered pixels there is less on one side.
    """
    lines = {"shutter": "rolling", "line_time_us": 1e6 * lines_s * 28.0 / 2713.6} if lines_s else {}
    call = {
        "pixel": Pixel(pitch_um=28.0, registration=registration),
        "exposure": Exposure(integration_s=0.01, **lines),
        "display": display,
        "border_um": 100.0,
    }
    still = imaging_chain(chart(96), CAMERA, **call)
    room_um = (
        2713.6 / 2 - 28.0 * (48 + 0.25)
        if registration
        else float(still.screen.dot_edges_um[axis][0]) - still.readout.physics.border_um
    )
    speed = 2 * room_um * share / (0.01 + lines_s)
    with pytest.raises(PixsimError, match="motion: got") if is_refused else nullcontext():
        imaging_chain(
            chart(96),
            CAMERA,
            **call,
            motion=Motion(image_um_per_s=(0.0, speed) if axis == 0 else (speed, 0.0)),
        )


# --- memory


def test_memory_of_a_large_film_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 1.7 planes of float64 besides the float32 picture, with the result, on one thread; of
    many bands two and tables.
    """
    monkeypatch.setattr(arrays, "threads", lambda: 1)
    settings = imaging(CAMERA, Pixel(pitch_um=5.3), display=Display(dots=256))
    image = chart(1536)
    light = prepare_scene(settings, SceneLight(image))
    works: dict[str, tuple[Callable[[], object], float]] = {
        "scene": (lambda: prepare_scene(settings, SceneLight(image)), 1.7),
        "ideal rate": (lambda: ideal_rate(image, settings.physics), 1.5),
        "diffraction": (lambda: diffracted_rate(image, CAMERA, settings.physics), 1.4),
        "pixels": (
            lambda: integrate_pixels(light.rate_e_per_s_um2, light.sample_pitch_um, 5.3, 3.0),
            0.9,
        ),
        "ideal": (
            lambda: displays.ideal_luminance(settings, image, light.screen.dot_edges_um),
            1.7,
        ),
    }
    for name, (work, most_planes) in works.items():
        tracemalloc.start()
        work()
        peak_planes = tracemalloc.get_traced_memory()[1] / (8 * 1536**2)
        tracemalloc.stop()
        assert peak_planes < most_planes, name


# --- errors of the light


NOISY_LIGHT = {"ended_by": "samples", "delta_e": 0.36, "tolerance_delta_e": 0.02}
QUIET = NOISY_LIGHT | {"ended_by": "target", "delta_e": 0.02}
COARSE = FilmError((64, 64), 10.0, (5.0, 20.0), (0.6, 0.2), (0.02, 0.02), "the limit of 64")
FINE = replace(COARSE, delta_e=(0.02, 0.02), limit="")
# Error and limit.
ABOVE = [(0.6, 0.02), (math.nan, 0.02), (math.nan, math.nan)]
BELOW = [(0.02, 0.02), (0.6, None), (math.nan, None), (None, 0.02), (0.0, 0.0)]


@pytest.mark.parametrize("film", [*ABOVE, *BELOW])
@pytest.mark.parametrize("noise", [*ABOVE, *BELOW])
def test_light_has_converged_if_no_error_is_above_its_limit(film, noise) -> None:
    """An unknown error is above any limit; one that is not measured, or has no limit, is not."""
    error, limit = (LightError(*pair) for pair in zip(film, noise, strict=True))
    count = sum(pair in ABOVE for pair in (film, noise))
    assert (converged(error, limit), len(exceeded(error, limit))) == (count == 0, count)


@pytest.mark.parametrize(("film", "first"), [(0.6, "noise_delta_e"), (math.nan, "film_delta_e")])
def test_largest_error_comes_first(film: float, first: str) -> None:
    """An unknown one is infinite."""
    assert next(iter(exceeded(LightError(film, 2.8), LightError(0.02, 0.01)))) == first


@pytest.mark.parametrize("stated", ["loud", 1.0, [], {}, {"fraction": "a lot", "target": 0.2}])
def test_header_of_another_program_may_hold_anything(stated) -> None:
    error, limit = noise_error_and_limit({"render_noise": stated})
    assert (error.noise_delta_e, converged(error, limit)) == (None, True)


@pytest.mark.parametrize(
    ("noise", "film", "mean", "remedies"),
    [
        (QUIET, FINE, "0.973", []),
        (None, None, "0.973", []),
        (NOISY_LIGHT | {"tolerance_delta_e": None}, FINE, "0.973", []),
        (NOISY_LIGHT, FINE, "1.0 ± 0.4 (render noise), not converged", ["--max-seconds"]),
        (QUIET, COARSE, "1.0 ± 0.6 (film), not converged", ["--resolution"]),
        (
            QUIET,
            replace(COARSE, delta_e=(math.nan, math.nan)),
            "0.973 ± an unknown error (film), not converged",
            ["--resolution"],
        ),
        (
            NOISY_LIGHT,
            COARSE,
            "1 ± 1 (film and render noise), not converged",
            ["--resolution", "--max-seconds"],
        ),
    ],
)
def test_mean_of_a_run_states_its_error_and_what_reduces_it(
    noise, film: FilmError | None, mean: str, remedies: list[str]
) -> None:
    header = {"render_noise": noise} if noise else {}
    result = run_result([0.9731], header, film and film.at(5.0))
    assert shown_mean_of(result) == mean
    with command_line():
        lines = unconverged(header, result.rendered and result.rendered.film)
    assert [
        name for name in ("--resolution", "--max-seconds") if name in "".join(lines)
    ] == remedies


@pytest.mark.parametrize(("noise", "is_converged"), [(NOISY_LIGHT, False), (QUIET, True)])
def test_score_of_a_picture_says_whether_its_light_has_converged(
    noise: dict, is_converged: bool
) -> None:
    score = evaluate(chart(96, render_noise=noise), CAMERA, Pixel(pitch_um=28.0), display=DISPLAY)
    assert ("not converged" not in repr(score)) == is_converged


# --- limits


@pytest.mark.parametrize(
    ("text", "value", "interval", "is_met", "is_sure"),
    [
        ("detectability>=5", 5.0, (5.0, 5.0), True, True),
        ("detectability >= 5", 4.99, (4.9, 5.1), False, False),
        ("delta_e<=1e0", 1.0, (0.9, 1.1), True, False),
        ("delta_e<=1", 0.8, (-math.inf, math.inf), True, False),
        ("delta_e<=-0.5", 0.8, (0.7, 0.9), False, True),
        ("delta_e<=1", math.nan, (math.nan, math.nan), False, True),
    ],
)
def test_value_decides_and_its_interval_says_how_surely(
    text: str, value: float, interval: tuple[float, float], is_met: bool, is_sure: bool
) -> None:
    check = RequirementCheck(requirement_of(text), value, interval)
    assert (check.is_met, check.is_sure) == (is_met, is_sure)


@pytest.mark.parametrize("text", ["delta_e<1", "delta_e<=", "<=1", "delta_e<=1 or 2", "a<=1e999"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="allowed: a metric"):
        requirement_of(text)


def test_command_ends_with_3_where_a_limit_is_not_met(tmp_path: Path) -> None:
    """And with 0, as any other, if all are."""
    settings = "--resolution 64 --pixel.pitch-um 42.4 --display.dots 32 --require delta_e<=100"
    code, answer, _ = command(f"run csf {settings} --require delta_e<=0.001 --out {tmp_path}/out")
    assert (code, ": met" in answer, ": not met" in answer) == (3, True, True)


# --- FLIP


@pytest.mark.parametrize("channels", [(), (3,)])
def test_flip_is_that_of_the_package_for_srgb_codes(channels: tuple[int, ...]) -> None:
    """float32 of the codes: 1e-5 of the mean."""
    flip = pytest.importorskip("flip_evaluator")
    display = Display(gamma=1.0, bits=16, samples_per_deg=31.0)
    rng = np.random.default_rng(4)
    ideal = 0.2 + 0.5 * rng.random((40, 60, *channels))
    pictures = ideal, ideal + 0.05 * rng.standard_normal(ideal.shape)
    codes = []
    for picture in pictures:
        light = displays.shown_luminance(picture, display)
        code = np.where(
            light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055
        ).astype(np.float32)
        codes.append(code if channels else np.repeat(code[..., None], 3, axis=2))
    _, mean, _ = flip.evaluate(*codes, "LDR", applyMagma=False, parameters={"ppd": 31.0})
    score = score_pictures(*pictures, display, metrics=["flip"])
    assert score.metrics["flip"] == pytest.approx(mean, rel=1e-5)
    assert mean > 0.01
