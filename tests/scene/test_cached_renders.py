"""Cached renders: results are the same bytes with and without the cache, and only equal light shares an entry."""

from __future__ import annotations

import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import edited

import pixsim
from pixsim.base import cache
from pixsim.base.cache import LIMIT_VARIABLE
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.scene import convergence, renderer
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import CachedRenders, Renderer

RUN = "run {scene} --variant scalar_spectral --resolution 32 -D spp=4 --display.dots 32 --config {out}.toml --out {out}"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "kept"))
    return tmp_path / "kept"


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the real renders."""
    result: list[int] = []
    real = Renderer._rendered

    def counted(self, index, level, progress):
        result.append(index)
        return real(self, index, level, progress)

    monkeypatch.setattr(Renderer, "_rendered", counted)
    return result


def run(out: Path, options: str = "", scene: str | Path = "csf") -> dict[str, bytes]:
    """Return the bytes of all files of a run, without its times."""
    out.with_suffix(".toml").write_text("render_noise = 100\npixel.pitch_um = 84.8", encoding="utf-8")  # two renders are enough
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code, _, err = command(f"{RUN.format(scene=scene, out=out)} {options}")
    assert code == 0, err
    return {path.name: path.read_bytes() for path in out.iterdir() if path.name != "provenance.json"}


def test_render_cache_empty_warm_or_off_gives_equal_bytes(tmp_path, rendered, monkeypatch):
    cold = run(tmp_path / "out")
    assert len(rendered) == len(cache.entries("render")) == 2
    monkeypatch.setattr(Renderer, "tracer", property(lambda _: pytest.fail("a Mitsuba scene was built")))
    assert run(tmp_path / "out") == cold
    assert len(rendered) == 2
    monkeypatch.undo()
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "kept"))
    monkeypatch.setenv(LIMIT_VARIABLE, "0")
    assert run(tmp_path / "out") == cold
    assert len(cold) == 9


def test_render_damaged_cache_gives_equal_bytes(tmp_path, folder, rendered):
    cold = run(tmp_path / "out")
    path = sorted(folder.glob("render/*.npz"))[1]
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    assert run(tmp_path / "out") == cold
    assert rendered == [0, 1, 1]
    assert run(tmp_path / "out") == cold
    assert rendered == [0, 1, 1]


def test_cached_renders_several_lights_are_restored(tmp_path, rendered):
    first = run(tmp_path / "out", scene="macbeth")
    count = len(rendered)
    assert run(tmp_path / "out", scene="macbeth") == first
    assert len(rendered) == count > 0


AGAIN = ["--seed 1", "--camera.f-number 8", "-D spp=64", "-D emitter_scale=0.02", "--full"]
UNRELATED = ["--pixel.pitch-um 60", "--pixel.well-limit swing --exposure.integration-s 0.01"]
UNRELATED += ["--display.gamma 1.8 --display.white-cd-per-m2 800"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache after a run."""
    folder = tmp_path_factory.mktemp("first")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(folder / "kept"))
        run(folder / "out")
    return folder / "kept"


@pytest.mark.parametrize(
    "option", [*AGAIN[:2], *(pytest.param(option, marks=pytest.mark.slow) for option in AGAIN[2:]), *UNRELATED]
)
def test_render_cache_ignores_unrelated_settings(option, tmp_path, folder, kept, rendered):
    shutil.copytree(kept, folder)
    run(tmp_path / "other", option)
    assert bool(rendered) == (option in AGAIN)


def test_render_cache_lower_noise_extends_runs(tmp_path, rendered):
    run(tmp_path / "out", "-D spp=4")
    run(tmp_path / "out", "-D spp=4 --render-noise 2")
    assert rendered == list(range(len(rendered)))
    assert len(rendered) > 2


def test_render_cache_edited_texture_renders_again(tmp_path, rendered):
    pixsim.write_chart(tmp_path / "mine.exr", np.full((4, 4), 0.5, np.float32))
    path = edited(tmp_path, "flat")
    option = f"-D chart={tmp_path / 'mine.exr'}"
    first = run(tmp_path / "out", option, path)
    pixsim.write_chart(tmp_path / "mine.exr", np.full((4, 4), np.nextafter(np.float32(0.5), 1), np.float32))
    count = len(rendered)
    assert run(tmp_path / "out", option, path) != first
    assert len(rendered) == 2 * count
    pixsim.write_chart(tmp_path / "mine.exr", np.full((4, 4), 0.5, np.float32))
    assert run(tmp_path / "out", option, path) == first
    assert len(rendered) == 2 * count


def test_render_cache_edited_scene_renders_again(tmp_path, rendered):
    path = edited(tmp_path, "csf")
    run(tmp_path / "out", scene=path)
    count = len(rendered)
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub('<rotate y="1" angle="180"/>', '<rotate y="1" angle="180.0001"/>', text), encoding="utf-8")
    run(tmp_path / "out", scene=path)
    assert len(rendered) == 2 * count


@pytest.mark.parametrize("package", ["pixsim", "mitsuba", "drjit"])
def test_render_cache_other_version_renders_again(package, tmp_path, folder, kept, rendered, monkeypatch):
    shutil.copytree(kept, folder)
    real = cache.version_fingerprint
    monkeypatch.setattr(cache, "version_fingerprint", lambda *names: real(*names).replace(f"{package} ", f"{package} 99."))
    run(tmp_path / "out")
    assert rendered == [0, 1]


def test_render_cache_is_shared_by_studies(tmp_path, rendered):
    from pixsim.studies.lights import render_for
    from pixsim.studies.preparation import prepare
    from pixsim.studies.study_file import load_study

    plan = load_study("chen2000")
    # Samples that are asked for: else the cells of the chart are computed.
    scene = plan.scene.model_copy(update={"parameters": {**plan.scene.parameters, "spp": 16}})
    small = plan.model_copy(update={"render_noise": 10.0, "resolution": 32, "scene": scene})
    first = render_for(prepare(small, "scalar_spectral").cases[0]).image
    count = len(rendered)
    again = render_for(prepare(small.model_copy(update={"repeats": 3}), "scalar_spectral").cases[0]).image
    assert len(rendered) == count > 0
    assert np.array_equal(first.factors[1], again.factors[1])
    assert first.header == again.header


def test_render_cache_is_unused_by_measurements(rendered, folder):
    scene = pixsim.load_scene("flat", resolution=8, variant="scalar_spectral")
    for _ in range(2):
        pixsim.render(scene)
    assert rendered == [0, 0]
    assert not list(folder.rglob("*.npz"))


def test_cached_renders_size_is_limited(monkeypatch):
    """Entries from an earlier run count as much as new ones."""
    monkeypatch.setenv(LIMIT_VARIABLE, str(16 / 1024))  # 16 MiB: 4 for one job
    picture = np.zeros((512, 512, 1), np.float32)  # 1 MiB
    for _ in range(2):
        job = CachedRenders("job")
        for index in range(6):
            if job.find(index, 0) is None:
                job.store(index, 0, [picture], 16)
        assert len(cache.entries(renderer.KIND)) == 4


def test_render_cache_time_limit_is_reproduced(rendered, monkeypatch):
    """Cached renders take no time, so a clock would let each repetition render more. A new render takes a second here."""
    monkeypatch.setattr(convergence.time, "perf_counter", lambda: float(len(rendered)))
    scene = pixsim.load_scene("csf", variant="scalar_spectral", resolution=32)
    pixel = pixsim.Pixel(pitch_um=84.8)

    def once(max_seconds: float) -> tuple[int, str]:
        camera = scene.camera()
        plan = make_render_plan(scene, camera)
        how = {"render_noise": 1e-6, "max_seconds": max_seconds, "keep": True}
        with pytest.warns(UserWarning, match="leaves no time for the next step"):
            image, noise = render_until(scene, camera, plan, [pixel], pixsim.Exposure(), **how)
        return noise.runs, image.factors[1].tobytes()

    first = once(4.0)
    assert first[0] >= 2
    made = len(rendered)
    assert [once(4.0) for _ in range(3)] == [first] * 3
    assert len(rendered) == made, "all of them were kept"
    assert once(5.0)[0] > first[0]
