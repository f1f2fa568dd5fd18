"""Rendering until answers are known: the reported noise is that of independent renders.

Cached renders: only equal light shares an entry, and the bytes are those of new renders.
"""

import math
import os
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import VARIANT, load

import pixsim
from pixsim.base import cache, mapped
from pixsim.base.files import FOLDER_VARIABLE, version_of
from pixsim.base.progress import no_stage
from pixsim.scene import convergence, film
from pixsim.scene.guard import child
from pixsim.scene.job import OutOfTimeError
from pixsim.scene.renderer import KIND, LEVEL_FACTOR, CachedRenders, Renderer
from pixsim.sensor.integration import ideal_rate, integrate_pixels
from pixsim.sensor.reading import Readout
from pixsim.studies.run import prepare, render_run
from pixsim.viewer.merging import merge
from pixsim.viewer.setting import Run

PIXEL = pixsim.Pixel(pitch_um=42.4)  # 64 across
LOOSE = 1e9  # the first group is enough
SHORT = pixsim.Exposure(integration_s=2e-3)


@lru_cache
def prepared(name: str) -> tuple[object, ...]:
    scene = load(name, resolution=32, spp=4)
    camera = scene.camera()
    return scene, camera, pixsim.make_plan(scene, camera, PIXEL)


def until(
    target: float,
    seed: int = 0,
    name: str = "csf",
    exposure: pixsim.Exposure = SHORT,
    pixels: Sequence[pixsim.Pixel] = (PIXEL,),
    max_seconds: float | None = None,
    **options,
) -> tuple[pixsim.SpectralImage, convergence.RenderNoise]:
    options |= {"render_noise": target, "max_seconds": max_seconds}
    rendered = convergence.render_until(*prepared(name), pixels, exposure, seed, **options)
    return rendered.image, rendered.noise


def electrons_e(
    image: pixsim.SpectralImage, pixel: pixsim.Pixel, exposure: pixsim.Exposure
) -> np.ndarray:
    physics = pixsim.derive(pixel)
    sides_um = image.pitch_um, physics.pitch_um, physics.photodiode_side_um
    return exposure.integration_s * integrate_pixels(ideal_rate(image, physics), *sides_um)


def sensor_variance_e2(mean_e: np.ndarray, pixel: pixsim.Pixel, exposure: pixsim.Exposure):
    """Return shot, dark, kTC, read and quantisation noise, squared."""
    readout = Readout.of(pixsim.derive(pixel))
    dark_e = readout.dark_current_e_per_s * exposure.integration_s
    floor_e2 = readout.physics.reset_noise_e**2 + readout.read_noise_e**2
    return mean_e + dark_e + floor_e2 + 1 / (12 * readout.dn_per_e**2)


class Noisy:
    """Replacement for renders: a grey picture with noise of 10 % in a sample.

    stuck : run that the time limit finds unfinished
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.levels: list[int] = []
        self.stuck = -1
        monkeypatch.setattr(Renderer, "run", self.run)

    def run(self, index: int, progress: Callable[[float], None] | None = None, level: int = 0):
        if index == self.stuck:
            raise OutOfTimeError("unfinished")
        spp = int(4 * LEVEL_FACTOR ** max(0, level))
        self.levels.append(level)
        rng = np.random.default_rng([index, max(0, level)])
        return [0.5 * (1 + rng.standard_normal((32, 32, 1)) * 0.1 / np.sqrt(spp))], spp


# --- The reported noise is the real one ---


def test_render_until_noise_matches_independent_renders() -> None:
    # The RMS over 12 seeds; each side scatters by 3 to 5 % from set to set of noisy cells.
    renders = [until(LOOSE, seed) for seed in range(12)]
    electrons = np.array([electrons_e(image, PIXEL, SHORT) for image, _ in renders])
    mean_e = electrons.mean(axis=0)
    variance_e2 = electrons.var(axis=0, ddof=1)
    noise = math.sqrt((variance_e2 / sensor_variance_e2(mean_e, PIXEL, SHORT)).mean())
    relative = math.sqrt(variance_e2.mean() / (mean_e**2).mean())
    reported = np.array([[result.fraction, result.relative] for _, result in renders])
    assert np.sqrt((reported**2).mean(axis=0)) == pytest.approx([noise, relative], rel=0.2)


@pytest.mark.parametrize("target", [LOOSE, 5e-2])
def test_noise_of_known_noise_is_unbiased(target: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # White noise with one pixel per cell: its fraction of sensor noise is σ_e/√(N V).
    renders = Noisy(monkeypatch)
    pixel = pixsim.Pixel(pitch_um=2713.6 / 32, fill_factor=1.0, full_well_e=1e6)
    exposure = pixsim.Exposure(integration_s=1e-4)
    image, noise = until(target, pixels=[pixel], exposure=exposure)
    mean_e = electrons_e(image, pixel, exposure)
    relative = 0.1 / math.sqrt(image.header["spp"])
    power = (mean_e**2 / sensor_variance_e2(mean_e, pixel, exposure)).mean()
    # 1024 cells: 2.2 % of noise, 5σ.
    expected = pytest.approx([relative * math.sqrt(power), relative], rel=0.11)
    assert ([noise.fraction, noise.relative], max(renders.levels) > 1) == (expected, target < LOOSE)


def test_render_until_worst_pixel_counts() -> None:
    pixels = [pixsim.Pixel(pitch_um=10.6), pixsim.derive(PIXEL)]
    fractions = [until(LOOSE, pixels=[pixel])[1].fraction for pixel in pixels]
    assert until(LOOSE, pixels=pixels)[1].fraction == max(fractions) > 1.05 * min(fractions)


@pytest.mark.parametrize("shape", [(300, 300), (200, 301)])
def test_measured_parts_are_a_sample_of_the_pixels(shape: tuple[int, int]) -> None:
    assert convergence.measured_parts(shape, 1.0) == [(slice(0, shape[0]), slice(0, shape[1]))]
    covered = np.zeros(shape)
    for part in convergence.measured_parts(shape, 20.0):
        covered[part] += 1
    assert covered.max() == 1
    assert covered.sum() * 20**2 == pytest.approx(convergence._MEASURED, rel=0.2)


# --- When rendering ends ---


@pytest.mark.parametrize("factor", [0.99, 3, 10, 40])
def test_render_until_lower_target_renders_more(
    factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Not much more than needed: noise² goes with 1/samples, and a group at most doubles them.
    renders = Noisy(monkeypatch)
    first = until(LOOSE)[1].fraction
    renders.levels.clear()
    image, noise = until(first / factor)
    assert noise.target is not None
    assert (noise.fraction <= noise.target, noise.ended_by) == (True, "target")
    assert renders.levels[::4] == renders.levels[3::4]
    spent = sum(4 * LEVEL_FACTOR**level for level in renders.levels)
    assert image.header["spp"] == spent < 2.2 * 16 * max(factor, 1) ** 2


@dataclass
class Roughness:
    """An answer that noise raises: 1 and 100 times the relative variance of the picture about the
    one without noise.
    """

    are_corrected: bool
    tolerated: float
    content = "roughness"

    def values(self, lights: Sequence) -> list[dict]:
        flat = Renderer(*prepared("csf"), 0).image([np.full((32, 32, 1), 0.5)], 4).planes[0]
        pictures = [light.planes[0] / flat - 1 for light, _ in lights]
        return [{("mean_delta_e", 5.0): 1 + 100 * np.mean(noise**2, axis=0)} for noise in pictures]

    def tolerance(self, key, value: float) -> float:
        return self.tolerated


@pytest.mark.parametrize("tolerated", [1.0, 0.03, 0.003])
@pytest.mark.parametrize("are_corrected", [True, False])
def test_render_until_ends_where_the_error_of_the_answer_is_tolerated(
    are_corrected: bool, tolerated: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """White noise of σ² = .01 in a sample makes a bias of 100 σ²/spp."""
    Noisy(monkeypatch)
    answers = Roughness(are_corrected, tolerated)
    rendered = convergence.render_until(*prepared("csf"), [PIXEL], SHORT, answers=answers)
    image, noise = rendered.image, rendered.noise
    bias = 1 / image.header["spp"]
    assert (noise.ended_by, noise.tolerance_delta_e) == ("target", tolerated)
    assert noise.delta_e is not None
    assert noise.delta_e <= tolerated
    answer = answers.values([(image, None)])[0]["mean_delta_e", 5.0].mean()
    if are_corrected:
        # 1024 cells: the variance scatters by 4.4 %; that of the extrapolation by twice as much.
        assert noise.bias["mean_delta_e"] == pytest.approx(bias, rel=0.4)
        answer -= noise.bias["mean_delta_e"]
    else:
        assert noise.delta_e >= 0.6 * bias
    assert abs(answer - 1) <= noise.delta_e


def test_bias_of_any_order_is_taken_off() -> None:
    """s(n) = 1 + c n^-p: at n = 1, 1/2 and 1/4."""
    for order, bias in [(1.0, 0.3), (0.5, 0.3), (0.7, -0.2)]:
        value, half, quarter = (np.full(3, 1 + bias * n**order) for n in (1, 2, 4))
        error = convergence.AnswerError.of(value, np.array([half] * 2), np.array([quarter] * 4))
        assert error.bias == pytest.approx(bias, rel=1e-9)
        assert error.deviation == pytest.approx(0, abs=1e-15)
        assert error.bias_error == pytest.approx(0, abs=1e-12) or order < 1


def test_pilot_tells_the_samples_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a quarter of 64 × 64 cells, 16 samples each, with a bias b of 1/16.

    An error is |b| + 2 b², for the bend of √(1 - 2 b²), and 3.18 deviations, of 4.4 % of 4 b in each
    of four quarters, over the root of four parts. It is known to about 20 %, from four quarters.
    """
    Noisy(monkeypatch)
    tolerated = 0.003
    pilot = convergence.pilot_render(
        *prepared("csf"), [PIXEL], SHORT, Roughness(False, tolerated), share=0.25
    )
    bias = 1 / 16
    scatter = 3.18 * 0.044 * 4 * bias / math.sqrt(4) / math.sqrt(4)
    systematic = bias + 2 * bias**2
    root = (scatter + math.sqrt(scatter**2 + 4 * tolerated * systematic)) / (2 * tolerated)
    assert pilot.samples == pytest.approx(64 * 64 * 16 * root**2, rel=0.25)


@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_noise_is_taken_off_a_distance_as_squares_add(noise: float) -> None:
    """A part is √(a + b v); one of places whose noise differs fourfold bends, within its error."""
    detail = np.array([0.2, 1.0, 3.0])[:, None]
    for variances in ([noise], [0.5 * noise, 2 * noise]):
        value, half, quarter = (
            np.sqrt(detail**2 + factor * np.array(variances)).mean(axis=1) for factor in (1, 2, 4)
        )
        error = convergence.AnswerError.of_distance(
            value, np.array([half] * 2), np.array([quarter] * 4)
        )
        missed = error.bias - (value - detail[:, 0]).mean()
        assert abs(missed) <= (error.bias_error if len(variances) > 1 else 1e-12)
        assert error.bias_error <= 0.2 * error.bias


def test_sample_limit_ends_renders_whatever_the_clock_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a quarter 4 · 4 + 16 samples a cell: another 16 do not fit into 35."""
    renders = Noisy(monkeypatch)
    monkeypatch.setattr(film, "CHART_SAMPLES", 140 * 32 * 32)
    monkeypatch.setattr(convergence.time, "monotonic", lambda: 1e9 * len(renders.levels))
    with pytest.warns(UserWarning, match=r"limit of 140000 samples"):
        noise = until(1e-6)[1]
    assert renders.levels == [0] * 16 + [1] * 4
    assert (noise.runs, noise.ended_by) == (20, "samples")


def test_time_limit_ends_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second goes by from each look at the clock to the next; one more look at most."""
    Noisy(monkeypatch)
    clock = iter(range(10**6))
    monkeypatch.setattr(convergence.time, "monotonic", lambda: float(next(clock)))
    with pytest.warns(UserWarning, match=r"time limit of 20 s.*--max-seconds or --render-noise"):
        image, noise = until(1e-6, max_seconds=20)
    assert noise.ended_by == image.header["render_noise"]["ended_by"] == "max_seconds"
    assert next(clock) <= 24


@pytest.mark.parametrize("stuck", [4, 6])
def test_group_without_time_is_left_out(stuck: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the time limit finds unfinished leaves the picture of the groups before it, also
    where half of a group is done.
    """
    renders = Noisy(monkeypatch)
    expected, first_noise = until(LOOSE, max_seconds=9)
    renders.stuck = stuck
    with pytest.warns(UserWarning, match="its time limit of 9 s"):
        image, noise = until(1e-6, max_seconds=9)
    np.testing.assert_array_equal(image.planes, expected.planes)
    assert (noise.runs, noise.fraction, noise.ended_by) == (4, first_noise.fraction, "max_seconds")


def test_time_for_no_picture_raises() -> None:
    """A packaged scene ends with its time, too: its child does not answer here."""
    scene, camera, plan = prepared("csf")
    tracer = Renderer(scene, camera, plan, 0, ends_at_s=math.inf).tracer
    tracer.sample_count(plan.samples.sampler, plan.samples.spp)
    os.kill(child._child.process.pid, signal.SIGSTOP)
    start_s = time.monotonic()
    with pytest.raises(OutOfTimeError, match="max_seconds"):
        convergence.render_until(scene, camera, plan, [PIXEL], pixsim.Exposure(), max_seconds=1e-3)
    assert time.monotonic() - start_s < 10  # 1.5 s for the first pair, and the end of the process


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1e-6])
def test_renders_that_are_no_light_raise(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    import mitsuba

    def broken(*_, sensor, **__) -> np.ndarray:
        return np.full((*sensor.film().crop_size(), 1), wrong)

    monkeypatch.setattr(mitsuba, "render", broken)
    with pytest.raises(pixsim.PixsimError, match="NaN, infinite or negative"):
        until(0.2)


def test_progress_rises_and_says_the_noise() -> None:
    """Over groups and levels; nothing is known during the first group."""
    target = until(LOOSE)[1].fraction / 6
    reports: list[tuple[float, str]] = []
    until(target, progress=lambda *report: reports.append(report))
    shares = [share for share, _ in reports]
    assert shares == sorted(shares)
    assert 0.5 < shares[-1] <= 1
    assert reports[0][1] == ""
    assert float(reports[-1][1].split()[3]) > target


# --- The picture ---


def test_picture_of_a_group_is_the_mean_of_four_renders() -> None:
    renderer = Renderer(*prepared("csf"), 0)
    images = [renderer.image(*renderer.run(index)) for index in range(4)]
    expected = sum(image.planes.astype(float) for image in images) / 4
    np.testing.assert_allclose(until(LOOSE)[0].planes, expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["csf", "macbeth"])
def test_pictures_in_files_are_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Where sums and pictures lie changes no bit of the light and its noise.
    in_memory, noise = until(LOOSE, name=name)
    monkeypatch.setattr(mapped, "MAX_MEMORY_BYTES", 0)
    in_file, noise_in_file = until(LOOSE, name=name)
    assert mapped.is_mapped(in_file.planes) > mapped.is_mapped(in_memory.planes)
    np.testing.assert_array_equal(in_file.planes, in_memory.planes)
    assert noise_in_file == noise


@pytest.mark.parametrize(
    ("ended_by", "more"),
    [
        ("target", {}),
        # Or rounding could ask for one more render.
        (
            "max_seconds",
            {
                "render_noise": 0.5 * (1 + convergence.ROUNDING),
                "tolerance_delta_e": convergence.NO_TOLERANCE_DELTA_E,
            },
        ),
    ],
)
def test_repeatable_settings_state_what_the_limit_led_to(ended_by: str, more: dict) -> None:
    header = {"render_noise": {"fraction": 0.5, "ended_by": ended_by}}
    image = pixsim.SpectralImage([550.0], 10.0, 5.0, data=np.ones((2, 3, 1)), header=header)
    settings = Run(seed=4, max_seconds=7.0, tolerance_delta_e=0.1)
    expected = settings.model_copy(
        update={"max_seconds": convergence.NO_TIME_LIMIT_S, "resolution": 3} | more
    )
    assert convergence.repeatable_settings(settings, image) == expected
    assert convergence.repeatable_settings(Run(seed=4), image) == Run(seed=4)


# --- Cached renders ---


# Four renders are enough.
TABLES = {
    "tolerance_delta_e": 100.0,
    "render_noise": 100.0,
    "resolution": 32,
    "pixel": {"pitch_um": 84.8},
    "display": {"dots": 32},
    "scene": {"file": "csf", "parameters": {"spp": 4}},
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def rendered(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The indices of the renders that no cache holds."""
    indices: list[int] = []
    render = Renderer._rendered

    def counted(self: Renderer, index: int, *arguments):
        indices.append(index)
        return render(self, index, *arguments)

    monkeypatch.setattr(Renderer, "_rendered", counted)
    return indices


def light(**settings) -> tuple[bytes, str]:
    """Return the light of a run, bit for bit, and its header."""
    run_settings = Run.model_validate(merge(TABLES, settings))
    with warnings.catch_warnings(action="ignore"):
        image = render_run(prepare(run_settings, variant=VARIANT), no_stage).irradiance
    return image.planes.tobytes(), repr(image.header)


def test_light_is_equal_without_and_with_a_cache_and_a_damaged_one(
    folder: Path, rendered: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    cold = light()
    path = sorted(folder.glob("render/*.npz"))[1]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert light() == light() == cold
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    assert light() == cold
    assert rendered == [0, 1, 2, 3, rendered[4], 0, 1, 2, 3]


@pytest.fixture(scope="module")
def first_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache after a run."""
    folder = tmp_path_factory.mktemp("first") / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(folder))
        light()
    return folder


@pytest.mark.parametrize(
    ("settings", "renders"),
    [
        ({"seed": 1}, 2),
        ({"camera": {"f_number": 8}}, 2),
        ({"scene": {"parameters": {"spp": 64}}}, 2),
        ({"scene": {"parameters": {"emitter_scale": 0.02}}}, 2),
        ({"render_noise": 2}, 4),  # those before are extended
        (
            {
                "pixel": {"pitch_um": 60, "well_limit": "swing"},
                "exposure": {"integration_s": 0.01},
                "display": {"gamma": 1.8, "white_cd_per_m2": 800},
            },
            0,
        ),
    ],
    ids=str,
)
def test_light_is_rendered_anew_for_the_settings_that_change_it(
    settings: dict, renders: int, folder: Path, first_cache: Path, rendered: list[int]
) -> None:
    shutil.copytree(first_cache, folder)
    light(**settings)
    assert bool(rendered) == bool(renders)
    assert renders != 4 or rendered[0] == 4


def test_light_is_rendered_anew_by_another_version(
    folder: Path, first_cache: Path, rendered: list[int], monkeypatch
) -> None:
    """That of each package is in the fingerprint, as test_cache has it."""
    shutil.copytree(first_cache, folder)
    monkeypatch.setattr(
        cache, "version_of", lambda name: "0" * (name == "drjit") or version_of(name)
    )
    monkeypatch.setattr(cache, "version_fingerprint", cache.version_fingerprint.__wrapped__)
    light()
    assert rendered == [0, 1, 2, 3]


@pytest.mark.usefixtures("folder")
def test_size_of_a_jobs_renders_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Entries from an earlier run count as much as new ones."""
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(16 / 1024))  # 16 MiB: 4 for one job
    for _ in range(2):
        job = CachedRenders("job")
        for index in range(6):
            if job.find(index, 0) is None:
                job.store(index, 0, [np.zeros((512, 512, 1), np.float32)], 16)
        assert len(cache.entries(KIND)) == 4


def test_time_limit_is_reproduced(rendered: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Cached renders take no time, so a clock would let each repetition render more. A new render
    takes a second here.
    """
    monkeypatch.setattr(convergence.time, "monotonic", lambda: float(len(rendered)))

    def renders(max_seconds: float) -> tuple[int, bytes, int]:
        with pytest.warns(UserWarning, match="ended at its time limit"):
            image, noise = until(1e-6, max_seconds=max_seconds, use_cache=True)
        return noise.runs, image.planes.tobytes(), len(rendered)

    first, again, last, longer = (renders(seconds) for seconds in (4.0, 4.0, 4.0, 6.0))
    assert first == again == last
    assert first[2] >= 4
    assert longer[0] > first[0]
