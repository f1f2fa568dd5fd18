"""Rendering to a noise target: the reported noise is that of independent renders."""

from __future__ import annotations

import json
import math
import os
import signal
import time
import tracemalloc
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import load

import pixsim
from pixsim.base import mapped
from pixsim.scene import convergence, film
from pixsim.scene.convergence import (
    MAX_SPP,
    NO_TIME_LIMIT_S,
    RENDER_NOISE,
    RenderNoise,
    measured_parts,
    render_until,
    repeatable_settings,
)
from pixsim.scene.guard import child
from pixsim.scene.job import OutOfTimeError
from pixsim.scene.plan import make_plan
from pixsim.scene.renderer import LEVEL_FACTOR, Renderer
from pixsim.sensor.integration import ideal_rate, integrate_pixels
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.viewer.setting import Run

PIXEL = pixsim.Pixel(pitch_um=42.4)  # 64 across
LOOSE = 1e9  # the first pair is enough


@cache
def prepared(name: str = "csf", **parameters):
    scene = load(name, **{"resolution": 32, "spp": 4, **parameters})
    camera = scene.camera()
    return scene, camera, make_plan(scene, camera, PIXEL)


NOISE_FIELDS = {
    "fraction",
    "relative",
    "target",
    "runs",
    "ended_by",
    "delta_e",
    "tolerance_delta_e",
}


def until(
    target: float, seed: int = 0, name: str = "csf", exposure=None, **options
) -> tuple[pixsim.SpectralImage, RenderNoise]:
    scene, camera, plan = prepared(name)
    pixels = options.pop("pixels", [PIXEL])
    options = {"max_seconds": None} | options
    return render_until(
        scene,
        camera,
        plan,
        pixels,
        exposure or pixsim.Exposure(),
        seed,
        render_noise=target,
        **options,
    )


def electrons_per_s(image: pixsim.SpectralImage, pixel: pixsim.Pixel = PIXEL) -> np.ndarray:
    p = derive(pixel)
    return integrate_pixels(ideal_rate(image, p), image.pitch_um, p.pitch_um, p.photodiode_side_um)


def true_noise(
    images: list[pixsim.SpectralImage], exposure: pixsim.Exposure, pixel: pixsim.Pixel = PIXEL
) -> float:
    """Return the RMS over pixels of the standard deviation of pictures over the temporal noise of
    the sensor.
    """
    p = Readout.of(derive(pixel))
    signal_e = (
        np.array([electrons_per_s(image, pixel) for image in images]) * exposure.integration_s
    )
    dark_e = p.dark_current_e_per_s * exposure.integration_s
    mean_e = signal_e.mean(axis=0)
    variance_e2 = (
        mean_e + dark_e + p.physics.reset_noise_e**2 + p.read_noise_e**2 + 1 / (12 * p.dn_per_e**2)
    )
    return float(np.sqrt((signal_e.var(axis=0, ddof=1) / variance_e2).mean()))


# --- The reported noise is the real one ---


@pytest.mark.parametrize(
    ("name", "integration_s"),
    [
        ("csf", 2e-3),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("csf", 2e-5), ("macbeth", 2e-3))
        ),
    ],
)
def test_render_until_noise_matches_independent_renders(name, integration_s):
    exposure = pixsim.Exposure(integration_s=integration_s)
    result = [until(LOOSE, seed, name, exposure) for seed in range(12)]
    reported = np.sqrt(np.mean([noise.fraction**2 for _, noise in result]))
    true = true_noise([image for image, _ in result], exposure)
    # 12 pictures of hundreds of noisy cells: each side scatters by 3 to 5 % from set to set.
    assert reported == pytest.approx(true, rel=0.2)
    assert true > 0
    relative = np.sqrt(np.mean([noise.relative**2 for _, noise in result]))
    pictures = np.array([electrons_per_s(image) for image, _ in result])
    expected = math.sqrt(pictures.var(axis=0, ddof=1).mean() / (pictures.mean(axis=0) ** 2).mean())
    assert relative == pytest.approx(expected, rel=0.2)


def test_render_until_noise_holds_over_levels():
    exposure = pixsim.Exposure(integration_s=2e-3)
    target = until(LOOSE, exposure=exposure)[1].fraction / 12
    result = [until(target, seed, exposure=exposure) for seed in range(6)]
    assert min(noise.runs for _, noise in result) >= 4
    reported = np.sqrt(np.mean([noise.fraction**2 for _, noise in result]))
    assert reported <= target
    # It ends where its estimate is low: a few per cent to one side, of a noise that has itself 5 %.
    assert true_noise([image for image, _ in result], exposure) == pytest.approx(reported, rel=0.25)


@pytest.mark.parametrize("name", ["csf", "macbeth"])
def test_pictures_in_files_are_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where sums and pictures lie changes no bit of the light and its noise."""
    in_memory, noise = until(LOOSE, name=name)
    monkeypatch.setattr(mapped, "MAX_MEMORY_BYTES", 0)
    in_file, same = until(LOOSE, name=name)
    assert mapped.is_mapped(in_file.planes) > mapped.is_mapped(in_memory.planes)
    np.testing.assert_array_equal(in_file.planes, in_memory.planes)
    assert same == noise


class Noisy:
    """Replacement for renders: a grey picture with noise whose variance is proportional to
    1/samples.

    stuck : run that the time limit finds unfinished
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, relative: float) -> None:
        self.levels: list[int] = []
        self.stuck = -1
        monkeypatch.setattr(Renderer, "run", self.run)
        self.relative = relative

    def run(self, index: int, progress: Callable[[float], None] | None = None, level: int = 0):
        if index == self.stuck:
            raise OutOfTimeError("unfinished")
        spp = int(4 * LEVEL_FACTOR ** max(0, level))
        self.levels.append(level)
        rng = np.random.default_rng([index, max(0, level)])
        noise = rng.standard_normal((32, 32, 1)) * self.relative / np.sqrt(spp)
        return [0.5 * (1 + noise)], spp


def test_noise_of_known_noise_is_unbiased(monkeypatch):
    """White noise with one pixel per cell: its fraction of sensor noise is σ_e/√(N V)."""
    renders = Noisy(monkeypatch, 0.1)
    pixel = pixsim.Pixel(pitch_um=2713.6 / 32, fill_factor=1.0, full_well_e=1e6)
    exposure = pixsim.Exposure(integration_s=1e-4)
    for target in (LOOSE, 2e-2):
        image, noise = until(target, pixels=[pixel], exposure=exposure)
        p = Readout.of(derive(pixel))
        mean_e = electrons_per_s(image, pixel) * 1e-4
        variance_e2 = (
            mean_e
            + p.dark_current_e_per_s * 1e-4
            + p.physics.reset_noise_e**2
            + 1 / (12 * p.dn_per_e**2)
        )
        samples = image.header["spp"]
        expected = 0.1 / math.sqrt(samples) * math.sqrt((mean_e**2 / variance_e2).mean())
        # 1024 cells: 2.2 % of noise, 5σ.
        assert noise.fraction == pytest.approx(expected, rel=0.11)
        assert noise.relative == pytest.approx(0.1 / math.sqrt(samples), rel=0.11)
    assert max(renders.levels) > 1


# --- When rendering ends ---


def test_render_until_lower_target_renders_more(monkeypatch):
    renders = Noisy(monkeypatch, 0.1)
    first = until(LOOSE)[1].fraction
    spent = []
    for target in (first * 1.001, first / 3, first / 10, first / 40):
        renders.levels.clear()
        image, noise = until(target)
        assert noise.fraction <= target == noise.target
        assert noise.ended_by == "target"
        assert noise.runs == len(renders.levels)
        assert image.header["spp"] == sum(4 * LEVEL_FACTOR**level for level in renders.levels)
        spent.append(image.header["spp"])
        # Not much more than needed: noise² goes with 1/samples, and the last pair is at most four
        # times those before.
        assert image.header["spp"] < 8 * max(4, 2 * LEVEL_FACTOR) * (first / target) ** 2
    assert spent == sorted(set(spent))


@pytest.mark.slow
def test_render_until_pairs_grow_far_from_target(monkeypatch):
    renders = Noisy(monkeypatch, 0.1)
    first = until(LOOSE)[1].fraction
    renders.levels.clear()
    until(first / 1.2)
    assert set(renders.levels) == {0}
    renders.levels.clear()
    until(first / 400)
    assert renders.levels[::2] == renders.levels[1::2]  # in pairs
    assert all(later - earlier in (0, 1) for earlier, later in pairwise(renders.levels))
    assert 4 * LEVEL_FACTOR ** max(renders.levels) == MAX_SPP


@pytest.mark.slow
def test_render_until_memory_is_constant(monkeypatch):
    renders = Noisy(monkeypatch, 0.1)
    first = until(LOOSE)[1].fraction

    def peak(target: float) -> int:
        renders.levels.clear()
        tracemalloc.start()
        until(target)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(first / 2)  # what is loaded once
    few, many = peak(first / 2), peak(first / 200)
    assert len(renders.levels) > 16
    assert many < 1.1 * few + 32 * 32 * 8


def test_render_until_worst_pixel_counts():
    exposure = pixsim.Exposure(integration_s=2e-3)
    small, large = pixsim.Pixel(pitch_um=10.6), PIXEL
    single = [
        until(LOOSE, pixels=[pixel], exposure=exposure)[1].fraction for pixel in (small, large)
    ]
    both = until(LOOSE, pixels=[small, large], exposure=exposure)[1].fraction
    assert both == max(single)
    assert max(single) > 1.05 * min(single)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1e-6])
def test_render_until_black_scene_raises(monkeypatch, wrong):
    import mitsuba

    monkeypatch.setattr(
        mitsuba, "render", lambda *_, sensor, **__: np.full((*sensor.film().crop_size(), 1), wrong)
    )
    with pytest.raises(pixsim.PixsimError, match="rendered picture: got NaN, infinite or negative"):
        until(0.2)


def test_render_until_max_runs_ends(monkeypatch):
    Noisy(monkeypatch, 0.1)
    monkeypatch.setattr(convergence, "MAX_RUNS", 6)
    with pytest.warns(UserWarning, match=r"limit of 6 renders.*Raise --max-seconds"):
        noise = until(1e-9)[1]
    assert (noise.runs, noise.ended_by) == (6, "runs")


def test_render_until_time_limit_warns(monkeypatch):
    Noisy(monkeypatch, 0.1)
    now = iter(range(10**6))
    monkeypatch.setattr(
        convergence.time, "monotonic", lambda: float(next(now))
    )  # a second from each look to the next
    with pytest.warns(UserWarning, match="ended at its time limit of 20 s") as caught:
        image, noise = until(1e-6, max_seconds=20)
    assert noise.ended_by == "max_seconds"
    assert image.header["render_noise"]["ended_by"] == "max_seconds"
    assert next(now) <= 24  # one more look at most
    (warning,) = caught
    noisy = f"render noise is {noise.fraction:.2g} of the sensor noise"
    for text in (noisy, "target 1e-06", "--max-seconds", "--render-noise"):
        assert text in str(warning.message)


@pytest.mark.parametrize("stuck", [2, 3])
def test_render_until_pair_without_time_is_left_out(monkeypatch, stuck):
    """What the time limit finds unfinished leaves the picture of the pairs before it, also where
    half of a pair is done.
    """
    renders = Noisy(monkeypatch, 0.1)
    expected, of_pair = until(LOOSE, max_seconds=9)
    renders.stuck = stuck
    with pytest.warns(UserWarning, match="its time limit of 9 s"):
        image, noise = until(1e-6, max_seconds=9)
    np.testing.assert_array_equal(image.factors[1], expected.factors[1])
    assert (noise.runs, noise.fraction, noise.ended_by) == (2, of_pair.fraction, "max_seconds")


def test_render_until_time_for_no_picture_raises():
    """A packaged scene ends with its time, too; without a picture that is an error. Its child does
    not answer here.
    """
    scene, camera, plan = prepared()
    Renderer(scene, camera, plan, 0, ends_at_s=math.inf).tracer.sample_count(
        plan.samples.sampler, plan.samples.spp
    )
    os.kill(child._child.process.pid, signal.SIGSTOP)
    start = time.monotonic()
    with pytest.raises(
        OutOfTimeError, match=r"max_seconds: got a limit in which Mitsuba does not finish.*Raise it"
    ):
        render_until(scene, camera, plan, [PIXEL], pixsim.Exposure(), max_seconds=1e-3)
    assert (
        time.monotonic() - start < 10
    )  # the limit, 1.5 s for the first pair, and the end of the process


# --- Header and score ---


def test_render_until_equal_seeds_are_bit_identical():
    target = until(LOOSE)[1].fraction / 3
    (first, noise), (again, same), (other, _) = (until(target, seed) for seed in (5, 5, 6))
    assert np.array_equal(first.factors[1], again.factors[1])
    assert noise == same
    assert not np.array_equal(first.factors[1], other.factors[1])


def test_render_until_picture_is_mean_of_renders():
    """The picture of one pair is the mean of two single renders."""
    scene, camera, plan = prepared()
    job = Renderer(scene, camera, plan, 0)
    both = [job.image(*job.run(index)).factors[1].astype(float) for index in (0, 1)]
    np.testing.assert_allclose(until(LOOSE)[0].factors[1], (both[0] + both[1]) / 2, rtol=1e-6)


@pytest.mark.parametrize("full", [False, True])
def test_rate_of_pulses_equals_ideal_rate(full):
    """The rate from pulses equals that from the image, with factors or with all bands of
    macbeth.
    """
    scene, camera, _ = prepared("macbeth")
    job = Renderer(scene, camera, make_plan(scene, camera, PIXEL, full=full), 0)
    pictures, spp = job.run(0)
    image = job.image(pictures, spp)
    assert (image.factors is None) == full
    rate = convergence._rate(job, pictures, derive(PIXEL), (slice(0, 32), slice(0, 32)))
    whole = ideal_rate(image, derive(PIXEL))
    np.testing.assert_allclose(rate, whole, rtol=1e-6)
    part = convergence._rate(job, pictures, derive(PIXEL), (slice(8, 24), slice(4, 30)))
    assert part.shape == (16, 26)
    np.testing.assert_allclose(part, whole[8:24, 4:30], rtol=1e-6)


def test_render_until_noiseless_scene():
    image, noise = until(1e-3, name="flat")
    assert 0 <= noise.fraction < 1e-4  # float32
    assert 0 <= noise.relative < 1e-6
    assert (noise.runs, noise.ended_by) == (2, "target")
    assert image.header["render_noise"]["fraction"] < 1e-4


def test_render_until_progress_goes_on_to_the_end():
    """The share that is done never goes back, over pairs and levels, and the note has the noise so
    far.
    """
    target = until(LOOSE)[1].fraction / 6
    message: list[tuple[float, str]] = []
    noise = until(target, progress=lambda done, note: message.append((done, note)))[1]
    shares = [done for done, _ in message]
    assert shares == sorted(shares)
    assert shares[0] < 0.2
    assert 0.5 < shares[-1] <= 1
    notes = list(dict.fromkeys(note for _, note in message))
    assert len(notes) == noise.runs // 2 > 1
    assert notes[0] == ""  # nothing is known yet
    errors = [
        float(note.removeprefix(", render noise ").removesuffix(" of sensor noise"))
        for note in notes[1:]
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] > target


def test_render_until_header_has_noise_and_plan(tmp_path):
    small = (
        "--variant scalar_spectral --resolution 32 -D spp=64 --display.dots 32 --pixel.pitch-um"
        " 42.4 --exposure.integration-s 1e-3"
    )
    run = f"run csf {small} --json --out {tmp_path}"
    code, out, err = command(run)
    assert (code, err) == (0, "")
    message = json.loads(out)
    assert (
        0
        < message["render_noise"]["fraction"]
        <= RENDER_NOISE
        == message["render_noise"]["target"]
        == 0.2
    )
    assert message["render_noise"]["ended_by"] == "target"
    assert message["plan"]["decisions"][0]["subject"] == "wavelength bands"
    header = pixsim.read_exr(tmp_path / "irradiance.exr").header
    assert header["render_noise"].keys() == message["render_noise"].keys() == NOISE_FIELDS
    for name, value in message["render_noise"].items():
        assert header["render_noise"][name] == (
            pytest.approx(value, rel=1e-5) if isinstance(value, float) else value
        )
    assert len(header["plan"]) == len(message["plan"]["decisions"])
    target = 20 * message["render_noise"]["fraction"]  # not a lower one, which takes longer
    code, out, _ = command(f"{run} --render-noise {target} -D spp=4")
    looser = json.loads(out)
    assert code == 0
    assert (
        message["render_noise"]["fraction"]
        < looser["render_noise"]["fraction"]
        <= target
        == looser["render_noise"]["target"]
    )
    assert looser["irradiance"]["spp"] < message["irradiance"]["spp"]


@pytest.mark.parametrize("option", ["--render-noise", "--max-seconds"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "much"])
def test_render_until_invalid_target_raises(option, value):
    code, out, err = command(f"run csf {option} {value}")
    assert (code, out) == (2, "")
    assert option[2:].replace("-", "_") in err
    assert value in err


# --- Limit of samples ---


def test_render_until_sample_limit_ends(monkeypatch):
    """Without a time limit the samples are limited, whatever the clock says."""
    renders = Noisy(monkeypatch, 0.1)
    monkeypatch.setattr(film, "CHART_SAMPLES", 100 * 32 * 32)
    monkeypatch.setattr(convergence.time, "monotonic", lambda: 1e9 * len(renders.levels))
    with pytest.warns(
        UserWarning, match=r"limit of 100000 samples.*times as many samples.*--max-seconds"
    ):
        image, noise = until(1e-6, max_seconds=None)
    # In one half 4 + 4 + 16 + 16 samples a cell; a third pair of 16 would exceed 50.
    assert renders.levels == [0, 0, 0, 0, 1, 1, 1, 1]
    assert (noise.runs, noise.ended_by) == (8, "samples")
    assert image.header["render_noise"]["ended_by"] == "samples"


def test_render_until_time_limit_replaces_sample_limit(monkeypatch):
    Noisy(monkeypatch, 0.1)
    monkeypatch.setattr(film, "CHART_SAMPLES", 1)
    monkeypatch.setattr(convergence, "MAX_RUNS", 6)
    with pytest.warns(UserWarning, match="limit of 6 renders"):
        assert until(1e-9, max_seconds=1e3)[1].runs == 6


@pytest.mark.parametrize("shape", [(300, 300), (200, 301)])
def test_measured_parts_cover_sample_of_pixels(shape):
    assert measured_parts(shape, 1.0) == [(slice(0, shape[0]), slice(0, shape[1]))]
    parts = measured_parts(shape, 20.0)
    assert len(parts) == 16
    pixels = (
        sum((rows.stop - rows.start) * (columns.stop - columns.start) for rows, columns in parts)
        * 20**2
    )
    assert 0.8 * convergence.MEASURED < pixels < 1.2 * convergence.MEASURED
    for axis, count in enumerate(shape):
        assert min(part[axis].start for part in parts) >= 0
        assert max(part[axis].stop for part in parts) <= count


def test_noise_of_parts_equals_that_of_whole(monkeypatch):
    """Noise that is alike all over the picture is the same on a quarter of it, within the scatter
    of a few hundred pixels.
    """
    whole = until(LOOSE)[1]
    monkeypatch.setattr(convergence, "MEASURED", 64 * 64 // 4)
    parts = until(LOOSE)[1]
    assert parts.fraction != whole.fraction
    assert parts.fraction == pytest.approx(whole.fraction, rel=0.5)


@pytest.mark.parametrize("tolerance_delta_e", [10.0, 1.0, 0.1, None])
def test_render_until_ends_where_half_of_the_delta_e_between_halves_is_tolerated(
    tolerance_delta_e: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """White noise of σ in each of N samples makes σ √(2/πN) of mean |difference|, and halves differ
    by twice that.
    """
    Noisy(monkeypatch, 0.1)

    def delta_e_between(image: pixsim.SpectralImage, other: pixsim.SpectralImage) -> float:
        return 100 * float(np.abs(image.planes - other.planes).mean() / image.planes.mean())

    image, noise = until(
        LOOSE, tolerance_delta_e=tolerance_delta_e, delta_e_between=delta_e_between
    )
    assert noise.ended_by == "target"
    assert noise.delta_e is not None
    assert noise.delta_e <= (tolerance_delta_e or math.inf)
    assert noise.delta_e == pytest.approx(
        10 * math.sqrt(2 / math.pi / image.header["spp"]), rel=0.11
    )  # 1024 cells, 5σ
    assert image.header["render_noise"]["delta_e"] == pytest.approx(noise.delta_e, rel=1e-5)


@pytest.mark.parametrize(
    ("ended_by", "tolerance", "changed"),
    [
        ("target", None, {}),
        ("target", 0.1, {}),
        ("max_seconds", None, {"render_noise": pytest.approx(0.5, rel=2e-5)}),
        ("max_seconds", 0.1, {"render_noise": pytest.approx(0.5, rel=2e-5)}),
    ],
)
def test_repeatable_settings_state_what_the_limit_led_to(ended_by, tolerance, changed):
    header = {"render_noise": {"fraction": 0.5, "ended_by": ended_by}}
    image = pixsim.SpectralImage([550.0], 10.0, 5.0, data=np.ones((2, 3, 1)), header=header)
    asked = Run(seed=4, max_seconds=7.0, tolerance_delta_e=tolerance)
    by_clock = ended_by == "max_seconds"
    expected = asked.model_dump() | {"max_seconds": NO_TIME_LIMIT_S, "resolution": 3} | changed
    expected |= {"tolerance_delta_e": None} if by_clock else {}
    got = repeatable_settings(asked, image)
    assert got.model_dump() == expected
    assert not by_clock or got.render_noise > 0.5, "or rounding could ask for one more render"
    free = Run(seed=4)
    assert repeatable_settings(free, image) == free
