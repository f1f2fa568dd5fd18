"""Cached renders: results are the same bytes with and without the cache, and only equal light
shares an entry.
"""

from __future__ import annotations

import re
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import VARIANT, edited

import pixsim
from pixsim.base import cache
from pixsim.base.cache import LIMIT_VARIABLE
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.progress import no_stage
from pixsim.scene import convergence, renderer
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import CachedRenders, Renderer
from pixsim.studies import prepare as preparation
from pixsim.studies.files import load_study
from pixsim.studies.lights import render_for
from pixsim.studies.run import prepare, render_run
from pixsim.viewer.merging import merge
from pixsim.viewer.setting import Run

# Two renders are enough.
TABLES = {
    "render_noise": 100.0,
    "resolution": 32,
    "pixel": {"pitch_um": 84.8},
    "display": {"dots": 32},
    "scene": {"spp": 4},
}
RUN = (
    f"run csf --variant {VARIANT} --resolution 32 -D spp=4 --display.dots 32 --render-noise 100"
    " --pixel.pitch-um 84.8 --out"
)


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


def run(out: Path) -> dict[str, bytes]:
    """Return the bytes of all files of a run, without its times."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code, _, err = command(RUN, out)
    assert code == 0, err
    return {path.name: path.read_bytes() for path in out.iterdir() if path.name != "pixsim.json"}


def test_render_cache_empty_warm_or_off_gives_equal_bytes(tmp_path, rendered, monkeypatch):
    cold = run(tmp_path / "out")
    assert len(rendered) == len(cache.entries("render")) == 2
    monkeypatch.setattr(
        Renderer, "tracer", property(lambda _: pytest.fail("a Mitsuba scene was built"))
    )
    assert run(tmp_path / "out") == cold
    assert len(rendered) == 2
    monkeypatch.undo()
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "kept"))
    monkeypatch.setenv(LIMIT_VARIABLE, "0")
    assert run(tmp_path / "out") == cold
    assert len(cold) == 10


def lit(path: str | Path = "csf", full: bool = False, **more: Any) -> tuple[bytes, str]:
    """Return the light of a run, bit for bit, and its header."""
    settings = Run.model_validate(merge(TABLES, more))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        light = render_run(
            prepare(str(path), settings, full=full, variant=VARIANT), no_stage
        ).irradiance
    return light.planes.tobytes(), repr(light.header)


def test_render_damaged_cache_gives_equal_bytes(folder, rendered):
    cold = lit()
    path = sorted(folder.glob("render/*.npz"))[1]
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    for _ in range(2):
        assert lit() == cold
        assert rendered == [0, 1, 1]


def test_cached_renders_several_lights_are_restored(rendered):
    first = lit("macbeth")
    count = len(rendered)
    assert lit("macbeth") == first
    assert len(rendered) == count > 0


AGAIN: list[dict[str, Any]] = [{"seed": 1}, {"camera": {"f_number": 8}}]
AGAIN += [{"scene": {"spp": 64}}, {"scene": {"emitter_scale": 0.02}}, {"full": True}]
UNRELATED = [
    {"pixel": {"pitch_um": 60}},
    {"pixel": {"well_limit": "swing"}, "exposure": {"integration_s": 0.01}},
]
UNRELATED += [{"display": {"gamma": 1.8, "white_cd_per_m2": 800}}]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache after a run."""
    folder = tmp_path_factory.mktemp("first")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(folder / "kept"))
        lit()
    return folder / "kept"


@pytest.mark.parametrize(
    "option",
    [
        *AGAIN[:2],
        *(pytest.param(option, marks=pytest.mark.slow) for option in AGAIN[2:]),
        *UNRELATED,
    ],
    ids=str,
)
def test_render_cache_ignores_unrelated_settings(option, folder, kept, rendered):
    shutil.copytree(kept, folder)
    lit(**option)
    assert bool(rendered) == (option in AGAIN)


def test_render_cache_lower_noise_extends_runs(rendered):
    lit()
    lit(render_noise=2)
    assert rendered == list(range(len(rendered)))
    assert len(rendered) > 2


def test_render_cache_edited_texture_renders_again(tmp_path, rendered):
    pixsim.write_chart(tmp_path / "mine.exr", np.full((4, 4), 0.5, np.float32))
    path, chart = edited(tmp_path, "flat"), {"chart": str(tmp_path / "mine.exr")}
    first = lit(path, scene=chart)
    pixsim.write_chart(
        tmp_path / "mine.exr", np.full((4, 4), np.nextafter(np.float32(0.5), 1), np.float32)
    )
    count = len(rendered)
    assert lit(path, scene=chart) != first
    assert len(rendered) == 2 * count
    pixsim.write_chart(tmp_path / "mine.exr", np.full((4, 4), 0.5, np.float32))
    assert lit(path, scene=chart) == first
    assert len(rendered) == 2 * count


def test_render_cache_edited_scene_renders_again(tmp_path, rendered):
    path = edited(tmp_path, "csf")
    lit(path)
    count = len(rendered)
    text = path.read_text(encoding="utf-8")
    path.write_text(
        re.sub('<rotate y="1" angle="180"/>', '<rotate y="1" angle="180.0001"/>', text),
        encoding="utf-8",
    )
    lit(path)
    assert len(rendered) == 2 * count


@pytest.mark.parametrize("package", ["pixsim", "mitsuba", "drjit"])
def test_render_cache_other_version_renders_again(package, folder, kept, rendered, monkeypatch):
    shutil.copytree(kept, folder)
    real = cache.version_fingerprint
    monkeypatch.setattr(
        cache,
        "version_fingerprint",
        lambda *names: real(*names).replace(f"{package} ", f"{package} 99."),
    )
    lit()
    assert rendered == [0, 1]


def test_render_cache_is_shared_by_studies(rendered):
    plan = load_study("chen2000")
    # Samples that are asked for: else the cells of the chart are computed.
    scene = plan.scene.model_copy(update={"parameters": {**plan.scene.parameters, "spp": 16}})
    small = plan.model_copy(update={"render_noise": 10.0, "resolution": 32, "scene": scene})
    first = render_for(preparation.prepare(small, VARIANT).cases[0]).image
    count = len(rendered)
    again = render_for(
        preparation.prepare(small.model_copy(update={"repeats": 3}), VARIANT).cases[0]
    ).image
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
    """Cached renders take no time, so a clock would let each repetition render more. A new render
    takes a second here.
    """
    monkeypatch.setattr(convergence.time, "monotonic", lambda: float(len(rendered)))
    scene = pixsim.load_scene("csf", variant="scalar_spectral", resolution=32)
    pixel = pixsim.Pixel(pitch_um=84.8)

    def once(max_seconds: float) -> tuple[int, str]:
        camera = scene.camera()
        plan = make_render_plan(scene, camera)
        how = {"render_noise": 1e-6, "max_seconds": max_seconds, "use_cache": True}
        with pytest.warns(UserWarning, match="ended at its time limit"):
            image, noise = render_until(scene, camera, plan, [pixel], pixsim.Exposure(), **how)
        return noise.runs, image.factors[1].tobytes()

    first = once(4.0)
    assert first[0] >= 2
    made = len(rendered)
    assert [once(4.0) for _ in range(3)] == [first] * 3
    assert len(rendered) == made, "all of them were kept"
    assert once(5.0)[0] > first[0]
