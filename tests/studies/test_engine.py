"""Workers: results do not depend on them, and no finished row is lost or computed twice."""

import contextlib
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock, patch

import numpy as np
import pytest
from helpers.processes import HANG_S, signalled
from helpers.tasks import (
    collects_garbage,
    die_always,
    die_once,
    double,
    fail,
    folder_of,
    nothing,
    warn,
)
from helpers.tiny import tiny_toml

import pixsim
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.notes import MachineWarning, collected_notes
from pixsim.scene.packaged import packaged_scenes
from pixsim.studies import engine
from pixsim.studies.engine import SharedFiles, Workers, results_of, workers_for

PACKAGE = Path(pixsim.__file__).parent
THREADS = Workers(2, are_threads=True)
LIGHTS = {
    "name": "light",
    "set": ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"],
    "values": [50.0, 100.0],
}
TIMES = {"name": "integration", "set": "exposure.max_integration_s", "values": [0.05, 0.1]}
# Few cells and dots, and five sizes.
FEW = {
    "camera": {"die_mm": 0.7},
    "display": {"dots": 32},
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
}


# --- calls ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [Workers(1), Workers(2), THREADS], ids=str)
def test_every_call_is_made_once_with_its_shared_data(workers: Workers) -> None:
    make = Mock(side_effect=lambda size: {"values": np.full(size, 2.0)})
    makes = [partial(make, 3), partial(make, 150_000)]
    results = results_of(double, [(task, makes[task % 2]) for task in range(20)], workers)
    assert sorted(results) == [
        (task, task * (300_000.0 if task % 2 else 6.0)) for task in range(20)
    ]
    assert not workers.are_processes or make.call_count == 2, "shared data are made once"


def test_shared_files_error_is_raised_when_the_file_is_asked_for(tmp_path: Path) -> None:
    broken = partial(int, "none")
    with contextlib.closing(SharedFiles(tmp_path, [int, broken, float])) as files:
        assert files.path(int) == files.path(int)
        with pytest.raises(ValueError, match="none"):
            files.path(broken)


def test_calls_of_a_dead_worker_are_made_again(tmp_path: Path) -> None:
    calls = [(task, lambda: tmp_path) for task in range(12)]
    with pytest.warns(UserWarning, match="a worker process died"):
        assert sorted(results_of(die_once, calls, Workers(2))) == list(range(12))


@pytest.mark.slow  # test_calls_of_a_dead_worker_are_made_again has a call that is fatal once
def test_call_that_ends_its_worker_again_and_again_is_named() -> None:
    finished: list[int] = []
    results = results_of(die_always, [(task, nothing) for task in range(12)], Workers(2))
    with (
        pytest.warns(UserWarning, match="died; retrying the remaining"),
        pytest.raises(pixsim.PixsimError, match=r"even when run alone: 3\..*--jobs 1"),
    ):
        finished.extend(results)
    assert sorted(finished) == [task for task in range(12) if task != 3]


@pytest.mark.parametrize("workers", [Workers(2), THREADS], ids=str)
def test_warnings_of_workers_are_shown_once(workers: Workers) -> None:
    with collected_notes() as notes:
        results = results_of(warn, [(task, nothing) for task in range(6)], workers)
        assert sorted(results) == list(range(6))
    assert notes == ["the moon is out"]


@pytest.mark.parametrize("workers", [Workers(1), THREADS], ids=str)
def test_error_of_a_call_is_not_tried_again(workers: Workers) -> None:
    with pytest.raises(ZeroDivisionError):
        list(results_of(fail, [(task, nothing) for task in (2, 1, 0, 3)], workers))


def test_workers_collect_garbage_and_work_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers stay for the next calls, but not in the folder of the first ones."""
    calls = [(task, dict) for task in range(4)]
    assert list(results_of(collects_garbage, calls, Workers(2))) == [True] * 4
    monkeypatch.chdir(tmp_path)
    assert set(results_of(folder_of, calls, Workers(2))) == {str(tmp_path)}


# --- a study --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study, its technology and its scene, and the study's rows by one process."""
    folder = tmp_path_factory.mktemp("desk")
    shutil.copy(PACKAGE / "data/technologies/0.35um.toml", folder / "mine.toml")
    shutil.copy(packaged_scenes()["csf"], folder / "mine.xml")
    files = {"technologies": ["mine.toml"], "scene": {"file": "mine.xml"}}
    text = tiny_toml(axis=[LIGHTS, TIMES], **FEW | files)
    (folder / "study.toml").write_text(text, encoding="utf-8")
    with contextlib.chdir(folder):
        pixsim.study("study.toml", "whole", jobs=1)
    return folder


@pytest.mark.slow
def test_study_that_was_killed_is_resumed(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in the second sensor of the eighth task, of another light than the first; two
    processes go on, by the rows of both.

    Two of the frames that are counted are of the small light on which settings are tried.
    """
    monkeypatch.chdir(desk)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    out = tmp_path / "out"
    script = [sys.executable, "-c", signalled(signal.SIGKILL, 18), "study", "study.toml"]
    words = ["--out", str(out), "--jobs", "1"]
    done = subprocess.run([*script, *words], capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert {path.name for path in out.iterdir()} - {".pixsim.lock"} == {"results.csv"}
    counts = pixsim.study("study.toml", out, jobs=2).counts
    assert (counts.evaluations_reused, counts.evaluations_made) == (14, 4 * 5 * 2 - 14)
    assert (out / "results.csv").read_bytes() == Path("whole/results.csv").read_bytes()


# --- a cluster ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a Dask scheduler with a worker process, which has another current folder and
    another cache.
    """
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    folder = tmp_path_factory.mktemp("cluster")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        monkeypatch.setenv(FOLDER_VARIABLE, str(folder / "cache"))
        running = distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            protocol="tcp://",
            dashboard_address=None,
            local_directory=folder,
        )
    with running:
        yield running.scheduler_address


@pytest.fixture
def client(cluster: str) -> Iterator:
    from distributed import Client

    with Client(cluster, set_as_default=False) as client:
        yield client


@pytest.mark.slow
def test_study_on_a_cluster_has_the_same_bytes_and_needs_no_file_of_the_user_there(
    client, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither scene nor technology: another file of that name in a worker's folder would be taken
    for the user's. Lights of a batch travel together; here two batches of two.
    """
    monkeypatch.chdir(desk)
    monkeypatch.setattr("pixsim.viewer.scene_light.SCENE_CACHE_BYTES", 150_000)
    there = pixsim.study("study.toml", tmp_path, scheduler=client)
    assert (there.scenes.capacity, client.status) == (2, "running"), "it stays open"
    assert (tmp_path / "results.csv").read_bytes() == Path("whole/results.csv").read_bytes()


def test_cheap_calls_go_to_a_cluster_in_batches(client) -> None:
    """Each comes once, with the data of its `make`.

    The first ones go alone, to measure their pace; the last ones are parts of what is left:
    log(1000)/log(6/5) of them.
    """
    makes = [partial(dict, values=np.full(2, float(number))) for number in range(3)]
    calls = [(task, makes[task % 3]) for task in range(1000)]
    with patch.object(client, "submit", wraps=client.submit) as submit:
        results = sorted(results_of(double, calls, Workers(client=client)))
    sizes = [len(call.args[-1]) for call in submit.call_args_list]
    assert results == [(task, 2.0 * task * (task % 3)) for task in range(1000)]
    assert len(sizes) < 100
    assert max(sizes) > 50


def test_calls_that_were_lost_with_a_connection_are_made_when_it_is_back(
    client, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed.comm import CommClosedError

    def lost(*_: object, **__: object) -> None:
        monkeypatch.undo()
        client.status = "connecting"
        threading.Timer(0.05, setattr, (client, "status", "running")).start()
        raise CommClosedError

    monkeypatch.setattr(client, "scatter", lost)
    calls = [(task, partial(dict, values=np.ones(1))) for task in (1, 2)]
    with pytest.warns(MachineWarning, match="retrying the remaining 2 of 2 tasks"):
        results = sorted(results_of(double, calls, Workers(client=client)))
    assert results == [(1, 1.0), (2, 2.0)]


@pytest.mark.filterwarnings("ignore:a worker process died")
def test_cluster_that_loses_its_workers_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    for name in ("WORKER_SECONDS", "IDLE_SECONDS", "WATCH_SECONDS"):
        monkeypatch.setattr(engine, name, 0.3)
    calls = [(1, partial(dict, values=np.ones(1)))] * 40
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as lost,
        distributed.Client(lost, set_as_default=False) as client,
    ):
        results = results_of(double, calls, Workers(client=client))
        next(results)
        lost.scale(0)
        with pytest.raises(pixsim.PixsimError, match="no worker within"):
            list(results)


# as in docs/safety.md
CERTIFY = "req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=pixsim -keyout key.pem -out cert.pem"


@pytest.mark.skipif(
    shutil.which("openssl") is None, reason="no openssl, which makes the certificate"
)
def test_a_cluster_that_is_known_by_a_certificate_talks_by_tls_alone(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    dask = pytest.importorskip("dask")
    subprocess.run(["openssl", *CERTIFY.split()], cwd=tmp_path, check=True, capture_output=True)
    settings = {"require-encryption": True, "tls.ca-file": str(tmp_path / "cert.pem")}
    for end in ("client", "scheduler", "worker"):
        settings |= {f"tls.{end}.{name}": str(tmp_path / f"{name}.pem") for name in ("cert", "key")}
    with (
        dask.config.set({f"distributed.comm.{name}": value for name, value in settings.items()}),
        distributed.LocalCluster(
            n_workers=1,
            processes=False,
            dashboard_address=None,
            host="tls://127.0.0.1",
            security=distributed.Security(),
        ) as running,
    ):
        calls = [(task, partial(dict, values=np.ones(1))) for task in (1, 2, 3)]
        with workers_for(scheduler=running.scheduler_address) as workers:
            assert sorted(results_of(double, calls, workers)) == [(1, 1.0), (2, 2.0), (3, 3.0)]
        plain = running.scheduler_address.replace("tls", "tcp")
        with pytest.raises(pixsim.PixsimError, match="--scheduler"), workers_for(scheduler=plain):
            pass


def test_a_lost_scheduler_is_named() -> None:
    scheduler = SimpleNamespace(address="tcp://10.0.0.1:8786")
    lost = Mock(side_effect=RuntimeError("ConnectionPool is closed"))
    client = SimpleNamespace(scheduler=scheduler, status="closed", scatter=lost)
    with pytest.raises(pixsim.PixsimError, match=r"--scheduler: got .*10\.0\.0\.1:8786 that ended"):
        list(results_of(double, [(1, nothing)], Workers(client=client)))


# A worker of another version, and one that cannot tell its version.
OTHER_WORKER = Mock(**{"run.return_value": {"tcp://10.0.0.2:1": "pixsim 0.9"}})
STRANGE_WORKER = Mock(**{"run.side_effect": ImportError("no pixsim")})


@pytest.mark.parametrize(
    ("jobs", "scheduler", "pattern"),
    [
        (0, None, "--jobs: got 0"),
        (2, "tcp://127.0.0.1:1", "--jobs: got 2 with a scheduler"),
        (None, "tcp://127.0.0.1:1", r"--scheduler: got 'tcp://127.0.0.1:1'.*a running Dask"),
        (None, "nowhere at all", "--scheduler: got 'nowhere at all'"),
        (None, OTHER_WORKER, r"got pixsim 0\.9 at tcp://10\.0\.0\.2:1"),
        (None, STRANGE_WORKER, "a worker that does not report"),
    ],
)
def test_workers_that_cannot_be_had_are_refused(
    jobs: int | None, scheduler, pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "CONNECT_SECONDS", 0.2)
    with pytest.raises(pixsim.PixsimError, match=pattern), workers_for(jobs, scheduler):
        pass


def test_scheduler_without_dask_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(pixsim.PixsimError, match=r"pip install 'pixsim\[cluster\]'"),
        workers_for(None, "tcp://127.0.0.1:1"),
    ):
        pass
