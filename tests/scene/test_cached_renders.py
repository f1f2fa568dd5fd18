"""Cached renders: results are the same bytes with and without the cache, and only equal light
shares an entry.
"""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import VARIANT, load

import pixsim
from pixsim.base import cache
from pixsim.base.cache import LIMIT_VARIABLE
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.progress import no_stage
from pixsim.scene import convergence
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import KIND, CachedRenders, Renderer
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
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The indices of the renders that no cache holds."""
    indices: list[int] = []
    render = Renderer._rendered

    def counted(self: Renderer, index: int, *arguments: Any) -> Any:
        indices.append(index)
        return render(self, index, *arguments)

    monkeypatch.setattr(Renderer, "_rendered", counted)
    return indices


def run(out: Path) -> dict[str, bytes]:
    """Return the bytes of all files of a run, without its times."""
    code, _, err = command(RUN, out)
    assert code == 0, err
    return {path.name: path.read_bytes() for path in out.iterdir() if path.name != "pixsim.json"}


def test_render_cache_empty_warm_or_off_gives_equal_bytes(
    tmp_path: Path, rendered: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    cold = run(tmp_path / "out")
    assert len(rendered) == len(cache.entries(KIND)) == 2
    assert run(tmp_path / "out") == cold
    assert len(rendered) == 2
    monkeypatch.setenv(LIMIT_VARIABLE, "0")
    assert run(tmp_path / "out") == cold
    assert len(rendered) == 4


def light(full: bool = False, **settings: Any) -> tuple[bytes, str]:
    """Return the light of a run, bit for bit, and its header."""
    run_settings = Run.model_validate(merge(TABLES, settings))
    with warnings.catch_warnings(action="ignore"):
        prepared = prepare("csf", run_settings, full=full, variant=VARIANT)
        image = render_run(prepared, no_stage).irradiance
    return image.planes.tobytes(), repr(image.header)


def test_render_damaged_cache_gives_equal_bytes(folder: Path, rendered: list[int]) -> None:
    cold = light()
    path = sorted(folder.glob("render/*.npz"))[1]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert light() == light() == cold
    assert rendered == [0, 1, 1]


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
        ({"scene": {"spp": 64}}, 2),
        ({"scene": {"emitter_scale": 0.02}}, 2),
        ({"full": True}, 2),
        ({"render_noise": 2}, 4),  # those before are extended
        ({"pixel": {"pitch_um": 60}}, 0),
        ({"pixel": {"well_limit": "swing"}, "exposure": {"integration_s": 0.01}}, 0),
        ({"display": {"gamma": 1.8, "white_cd_per_m2": 800}}, 0),
    ],
    ids=str,
)
def test_light_is_rendered_anew_for_the_settings_that_change_it(
    settings: dict[str, Any], renders: int, folder: Path, first_cache: Path, rendered: list[int]
) -> None:
    shutil.copytree(first_cache, folder)
    light(**settings)
    assert bool(rendered) == bool(renders)
    assert renders != 4 or rendered[0] == 2


@pytest.mark.parametrize("package", ["pixsim", "mitsuba", "drjit"])
def test_light_of_another_version_is_rendered_anew(
    package: str,
    folder: Path,
    first_cache: Path,
    rendered: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(first_cache, folder)
    version = cache.version_fingerprint

    def other_version(*names: str) -> str:
        return version(*names).replace(f"{package} ", f"{package} 99.")

    monkeypatch.setattr(cache, "version_fingerprint", other_version)
    light()
    assert rendered == [0, 1]


def test_render_function_keeps_nothing(rendered: list[int], folder: Path) -> None:
    scene = load("flat", resolution=8)
    for _ in range(2):
        pixsim.render(scene)
    assert rendered == [0, 0]
    assert not list(folder.rglob("*.npz"))


def test_size_of_a_jobs_renders_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Entries from an earlier run count as much as new ones."""
    monkeypatch.setenv(LIMIT_VARIABLE, str(16 / 1024))  # 16 MiB: 4 for one job
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
    scene = load("csf", resolution=32)
    camera = scene.camera()
    job = (scene, camera, make_render_plan(scene, camera), [pixsim.Pixel(pitch_um=84.8)])

    def renders(max_seconds: float) -> tuple[int, bytes]:
        options: dict[str, Any] = {"render_noise": 1e-6, "max_seconds": max_seconds}
        with pytest.warns(UserWarning, match="ended at its time limit"):
            image, noise = render_until(*job, pixsim.Exposure(), use_cache=True, **options)
        return noise.runs, image.planes.tobytes()

    first = renders(4.0)
    count = len(rendered)
    assert [renders(4.0) for _ in range(3)] == [first] * 3
    assert len(rendered) == count >= 2
    assert renders(5.0)[0] > first[0]
