"""Workers: results do not depend on them, and no finished row is lost or computed twice."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import joblib
import numpy as np
import pytest
from helpers.forks import Forked
from helpers.processes import HANG_S, signalled
from helpers.tasks import (
    collects_garbage,
    die_always,
    die_once,
    die_once_at_7_um,
    double,
    fail,
    folder_of,
    keep,
    nothing,
    warn,
)
from helpers.tiny import tiny, tiny_toml

import pixsim
from pixsim.base import cache
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.notes import MachineWarning, collected_notes
from pixsim.scene.packaged import packaged_scenes
from pixsim.studies import engine, evaluate
from pixsim.studies.engine import SharedFiles, Workers, results_of, workers_for

AXES = [
    {
        "name": "light",
        "set": ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"],
        "values": [50.0, 100.0],
    },
    {"name": "integration", "set": "exposure.max_integration_s", "values": [0.05, 0.1]},
]
ROWS = 4 * 5 * 2


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of four lights on few cells, each of five sizes with two sensors."""
    path = tmp_path_factory.mktemp("study") / "axes.toml"
    over: dict[str, Any] = {
        "camera": {"die_mm": 0.7},
        "display": {"dots": 32},
        "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
    }
    path.write_text(tiny_toml(axis=AXES, **over), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def expected(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """results.csv of one process without a cache."""
    out = tmp_path_factory.mktemp("one")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(cache.LIMIT_VARIABLE, "0")
        pixsim.study(toml, out, jobs=1)
    return (out / "results.csv").read_bytes()


# --- calls
# -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_of_yields_every_call_once(jobs: int) -> None:
    made: list[int] = []
    shared = np.full(3, 2.0), np.ones(300_000)
    makes = [
        partial(lambda values: made.append(values.size) or {"values": values}, values)
        for values in shared
    ]
    actual = sorted(
        results_of(double, [(task, makes[task % 2]) for task in range(20)], Workers(jobs))
    )
    assert jobs == 1 or sorted(made) == [3, 300_000], "what is shared is made once"
    assert actual == [(task, task * (300_000.0 if task % 2 else 6.0)) for task in range(20)]


@pytest.mark.parametrize(("room_bytes", "most"), [(1, 3), (1 << 20, 4)])
def test_shared_files_are_made_ahead_as_far_as_there_is_room(
    room_bytes: int, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In little room one file waits. Each is made once, in order, whether it was asked for or
    not.
    """
    monkeypatch.setattr(engine, "AHEAD_BYTES", room_bytes)
    made: list[int] = []
    makes = [
        partial(lambda number: made.append(number) or np.full(9, number), number)
        for number in range(4)
    ]
    with contextlib.closing(SharedFiles(tmp_path, makes)) as files:
        for number in range(most - 1):
            deadline = time.monotonic() + HANG_S
            while number + 1 not in made and time.monotonic() < deadline:
                files.path(makes[min(number, 1)])
        assert joblib.load(files.path(makes[1]))[0] == 1
    assert made == list(range(most))
    files.drop(makes[1])
    assert len(list(tmp_path.iterdir())) == most - 1


def test_shared_files_error_is_raised_when_the_file_is_asked_for(tmp_path: Path) -> None:
    with contextlib.closing(
        SharedFiles(tmp_path, [int, broken := partial(int, "none"), float])
    ) as files:
        files.path(int), files.path(int)
        with pytest.raises(ValueError, match="none"):
            files.path(broken)


def test_results_of_dead_worker_is_retried(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="a worker process died"):
        actual = sorted(
            results_of(die_once, [(task, lambda: tmp_path) for task in range(12)], Workers(2))
        )
    assert actual == list(range(12))


@pytest.mark.slow
def test_results_of_deadly_task_is_named() -> None:
    actual: list[int] = []
    results = results_of(die_always, [(task, nothing) for task in range(12)], Workers(2))
    named = r"2 processes.*ended its process, even when run alone: 3\..*--jobs 1"
    with (
        pytest.warns(UserWarning, match="died; retrying the remaining"),
        pytest.raises(pixsim.PixsimError, match=named),
    ):
        actual.extend(results)
    assert sorted(actual) == [task for task in range(12) if task != 3]


def test_results_of_shows_worker_warnings_once() -> None:
    with collected_notes() as notes:
        assert sorted(results_of(warn, [(task, nothing) for task in range(6)], Workers(2))) == list(
            range(6)
        )
    assert notes == ["the moon is out"]


@pytest.mark.slow
def test_results_of_replaced_workers_are_no_note() -> None:
    """A worker that grows is replaced by loky: results and notes are those of any other."""
    pytest.importorskip("psutil", reason="loky looks at a worker's memory with psutil")
    with collected_notes() as notes:
        assert sorted(
            results_of(keep, [(task, nothing) for task in range(12)], Workers(2))
        ) == list(range(12))
    assert notes == []


@pytest.mark.parametrize(
    "jobs", [1, pytest.param(2, marks=pytest.mark.slow)]
)  # it ends its workers
def test_results_of_task_error_is_not_retried(jobs: int) -> None:
    with pytest.raises(ZeroDivisionError):
        list(results_of(fail, [(task, nothing) for task in (2, 1, 0, 3)], Workers(jobs)))


def library_threads(_: int, __: object) -> int:
    """Threads that NumPy's and SciPy's libraries have started, after an evaluation of a picture
    large enough for them.
    """
    from helpers.chains import imaging_chain

    picture = np.random.default_rng(0).random((1, 768, 768)).astype(np.float32)
    image = pixsim.SpectralImage(np.array([550.0]), 10.0, 2.65, factors=(np.ones((1, 1)), picture))
    image.header["luminance_cd_per_m2"] = 1000.0
    imaging_chain(
        image, pixsim.Camera(), pixsim.Pixel(), pixsim.Exposure(), pixsim.Display()
    ).simulate("threads")
    all_threads = {int(task.name) for task in Path("/proc/self/task").iterdir()}
    return len(all_threads - {thread.native_id for thread in threading.enumerate()})


@pytest.mark.filterwarnings("ignore:.*brighter than display white")
@pytest.mark.parametrize(
    ("function", "found"),
    [
        # The libraries keep the threads that they start: without any, a worker runs in its own
        # thread alone.
        pytest.param(
            library_threads,
            0,
            marks=pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="no /proc"),
        ),
        (collects_garbage, True),  # a worker leaves it while it imports
    ],
)
def test_results_of_worker_uses_one_core_and_collects_garbage(
    function: Callable[[int, object], object], found: object
) -> None:
    assert (
        list(results_of(function, [(task, nothing) for task in range(4)], Workers(2)))
        == [found] * 4
    )


@pytest.mark.parametrize(
    ("jobs", "scheduler", "pattern"),
    [
        (0, None, "--jobs: got 0; allowed: 1 or more"),
        (2, "tcp://127.0.0.1:1", "--jobs: got 2 with a scheduler"),
        (
            None,
            "tcp://127.0.0.1:1",
            (
                r"--scheduler: got 'tcp://127.0.0.1:1'.*allowed: the address of a running Dask"
                r" scheduler"
            ),
        ),
        (None, "nowhere at all", "--scheduler: got 'nowhere at all'"),
    ],
)
def test_workers_for_invalid_input_raises(
    jobs: int | None, scheduler: str | None, pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "CONNECT_SECONDS", 1.0)
    with pytest.raises(pixsim.PixsimError, match=pattern), workers_for(jobs, scheduler):
        pass


def test_workers_for_without_dask_names_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(pixsim.PixsimError, match=r"pip install 'pixsim\[cluster\]'"),
        workers_for(None, "tcp://127.0.0.1:1"),
    ):
        pass


# --- a study
# -----------------------------------------------------------------------------------------------------------


def test_study_two_workers_same_bytes(
    toml: Path, expected: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a cache; the next has one."""
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    pixsim.study(toml, tmp_path, jobs=2)
    assert (tmp_path / "results.csv").read_bytes() == expected


def test_study_killed_process_is_resumed(
    toml: Path, expected: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in the second sensor of the eighth task, of another light than the first; two
    processes go on, by the rows of both.

    Two of the frames that are counted are of the small light on which settings are tried.
    """
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    out = tmp_path / "out"
    words = ["study", str(toml), "--out", str(out), "--jobs", "1"]
    ended = Forked(signalled(signal.SIGKILL, 18), words, tmp_path, dict(os.environ))
    _, err = ended.communicate()
    assert ended.wait() == -signal.SIGKILL, err
    finished = (out / "results.csv").read_bytes().splitlines()[1:]
    assert len(finished) == 14
    assert set(finished) < set(expected.splitlines())
    assert [path.name for path in out.iterdir() if path.name != ".pixsim.lock"] == ["results.csv"]
    counts = pixsim.study(toml, out, jobs=2).counts
    assert counts is not None
    assert (counts.evaluations_reused, counts.evaluations_made) == (14, ROWS - 14)
    assert (out / "results.csv").read_bytes() == expected


def test_results_of_are_computed_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers stay for the next calls, and kept the folder of the first ones."""
    for folder in (Path.cwd(), tmp_path):
        monkeypatch.chdir(folder)
        assert set(results_of(folder_of, [(task, dict) for task in range(8)], Workers(2))) == {
            str(folder)
        }


# most of two studies; test_hostile has a full disk for a run, test_interruptions for rows
@pytest.mark.slow
def test_study_full_disk_keeps_finished_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit of a file's size stands for the disk's: the write fails in the same place."""
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    pixsim.study(tiny(), tmp_path / "whole", jobs=1)
    expected, results = (tmp_path / "whole/results.csv").read_bytes(), tmp_path / "out/results.csv"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    words = r"results.csv' cannot be written \(No space left on device\)\. Finished rows are kept"
    with contextlib.ExitStack() as stack:
        stack.callback(signal.signal, signal.SIGXFSZ, signal.signal(signal.SIGXFSZ, signal.SIG_IGN))
        stack.callback(resource.setrlimit, resource.RLIMIT_FSIZE, limits)
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(expected) // 2, limits[1]))
        with pytest.raises(pixsim.PixsimError, match=words):
            pixsim.study(tiny(), tmp_path / "out", jobs=1)
    finished = results.read_bytes().splitlines()[1:]
    assert finished
    assert set(finished) < set(expected.splitlines()), "half a row"
    assert [path.name for path in (tmp_path / "out").rglob("*")] == ["results.csv"]
    pixsim.study(tiny(), tmp_path / "out", jobs=2)
    assert results.read_bytes() == expected


# --- a cluster
# ---------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def running_cluster(folder: Path) -> Iterator[str]:
    """Address of a Dask scheduler that answers and has its two workers.

    They are processes of their own, as on other machines, each worker with its own cache. All of
    them find the modules of the tests first, since the scheduler reads the calls as well.
    """
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed (pip install 'pixsim[cluster]')"
    )
    paths = os.pathsep.join(
        [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    with (folder / "log").open("wb") as log, contextlib.ExitStack() as stack:

        def start(kind: str, *more: str, **own: str) -> None:
            command = [
                sys.executable,
                "-m",
                f"distributed.cli.dask_{kind}",
                *more,
                "--no-dashboard",
                "--host",
                "127.0.0.1",
            ]
            process = subprocess.Popen(
                command,
                stdout=log,
                stderr=log,
                env=os.environ | {"PYTHONPATH": paths} | own,
                cwd=folder,
            )
            stack.callback(process.wait, HANG_S)
            stack.callback(process.kill)

        # The scheduler chooses its port: one that was free a moment ago may be another test's by
        # now.
        written = folder / "scheduler.json"
        start("scheduler", "--port", "0", "--scheduler-file", str(written))
        address, until = "", time.monotonic() + HANG_S
        while not address and time.monotonic() < until:
            time.sleep(0.05)
            with contextlib.suppress(
                FileNotFoundError, json.JSONDecodeError
            ):  # not there, or half of it
                address = json.loads(written.read_text(encoding="utf-8"))["address"]
        assert address, f"no scheduler after {HANG_S} s"
        for number in range(2):
            own = str(folder / f"worker-{number}")
            words = ["--nthreads", "1", "--no-nanny", "--local-directory", own]
            start("worker", address, *words, **{FOLDER_VARIABLE: own + "-cache"})
        with distributed.Client(address, timeout=HANG_S, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=HANG_S)
        yield address


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with running_cluster(tmp_path_factory.mktemp("cluster")) as running:
        yield running


@pytest.fixture(scope="module")
def cluster_here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a scheduler with two workers in threads of this process: what they get still
    travels as bytes, by TCP.
    """
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed (pip install 'pixsim[cluster]')"
    )
    own = {
        "n_workers": 2,
        "threads_per_worker": 1,
        "processes": False,
        "protocol": "tcp://",
        "dashboard_address": None,
    }
    with distributed.LocalCluster(
        **own, local_directory=tmp_path_factory.mktemp("workers")
    ) as running:
        yield running.scheduler_address


def test_comparison_on_cluster_of_a_client_is_the_same(cluster_here: str) -> None:
    from distributed import Client

    options: dict[str, Any] = {
        "repeats": 2,
        "camera": {"die_mm": 2.7},
        "display": {"dots": 32},
        "resolution": 48,
    }
    options |= {"pixel": {"pitch_um": 60.0}}
    own = pixsim.compare(["0.35um", "4t-bsi"], jobs=1, **options)
    with Client(cluster_here) as client:
        assert (
            pixsim.compare(["0.35um", "4t-bsi"], scheduler=client, **options).as_dict()
            == own.as_dict()
        )
        assert client.status == "running", "it stays open"
        assert len(client.scheduler_info()["workers"]) == 2


def test_study_on_cluster_same_bytes(
    cluster_here: str, toml: Path, expected: bytes, tmp_path: Path, monkeypatch
) -> None:
    """Lights of a batch travel together; here two batches of two."""
    monkeypatch.setattr("pixsim.viewer.scene_light.SCENE_CACHE_BYTES", 150_000)
    assert pixsim.study(toml, tmp_path, scheduler=cluster_here).scenes.capacity == 2
    assert (tmp_path / "results.csv").read_bytes() == expected


def test_results_of_cluster_batches_cheap_calls(
    cluster_here: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each comes once, with the data of its own `make`, and an error is that of its call."""
    from distributed import Client

    sent: list[int] = []
    submit = Client.submit

    def counted(self: Client, function: Any, *given: Any, **options: Any) -> Any:
        sent.append(len(given[1]))
        return submit(self, function, *given, **options)

    monkeypatch.setattr(Client, "submit", counted)
    makes = [lambda number=number: {"values": np.full(2, float(number))} for number in range(3)]
    with Client(cluster_here, set_as_default=False) as client:
        actual = sorted(
            results_of(
                double, [(task, makes[task % 3]) for task in range(1000)], Workers(client=client)
            )
        )
        with pytest.raises(ZeroDivisionError):
            list(
                results_of(
                    fail, [(task, nothing) for task in range(300, -1, -1)], Workers(client=client)
                )
            )
    assert actual == [(task, 2.0 * task * (task % 3)) for task in range(1000)]
    # The first ones go alone, to measure their pace; the last ones are parts of what is left:
    # log(1000)/log(6/5) of them.
    assert len(sent) < 100
    assert max(sent) > 50


@pytest.mark.slow
def test_study_on_cluster_sends_technology(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers need not have its file in a study of one light, and one that is edited counts at
    once.
    """
    process = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
    monkeypatch.chdir(tmp_path)
    study, actual = tiny(technologies=["mine.toml"]), []
    for noise in ("3.5", "35.5"):
        text = process.read_text(encoding="utf-8")
        Path("mine.toml").write_text(
            re.sub(r"(\[read_noise_e\]\nvalue = )[\d.]+", rf"\g<1>{noise}", text), encoding="utf-8"
        )
        pixsim.study(study, tmp_path / f"cluster{noise}", scheduler=cluster)
        pixsim.study(study, tmp_path / f"here{noise}", jobs=1)
        there, here = (
            (tmp_path / f"{where}{noise}/results.csv").read_bytes() for where in ("cluster", "here")
        )
        assert there == here
        actual.append(here)
    assert actual[0] != actual[1]


def test_study_of_several_lights_on_cluster_needs_no_file_there(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither scene nor technology: another file of that name in a worker's folder would be taken
    for the user's.
    """
    monkeypatch.chdir(tmp_path)
    shutil.copy(Path(pixsim.__file__).parent / "data/technologies/0.35um.toml", "mine.toml")
    shutil.copy(packaged_scenes()["csf"], "own.xml")
    axis = [
        {"name": "light", "set": "scene.parameters.luminance_cd_per_m2", "values": [100.0, 50.0]}
    ]
    study = tiny(technologies=["mine.toml"], scene={"file": "own.xml"}, axis=axis)
    pixsim.study(study, tmp_path / "cluster", scheduler=cluster)
    pixsim.study(study, tmp_path / "here", jobs=1)
    assert (tmp_path / "cluster/results.csv").read_bytes() == (
        tmp_path / "here/results.csv"
    ).read_bytes()


@pytest.mark.parametrize(
    ("answer", "pattern"),
    [
        (
            lambda: "pixsim 0.9",
            (
                r"got pixsim 0\.9 at tcp://10\.0\.0\.2:1; allowed: .*, as here, so that all rows"
                r" are comparable"
            ),
        ),
        (
            partial(__import__, "no_pixsim"),
            r"got a worker that does not report its pixsim version \(No module named 'no_pixsim'\)",
        ),
    ],
)
def test_workers_for_other_version_raises(answer: Callable[[], str], pattern: str) -> None:
    """That of other sources is another one: tests/base/test_cache.py."""
    client = SimpleNamespace(
        wait_for_workers=lambda *_, **__: None, run=lambda _: {"tcp://10.0.0.2:1": answer()}
    )
    with (
        pytest.raises(pixsim.PixsimError, match="--scheduler: " + pattern),
        workers_for(None, client),
    ):
        pass


def test_a_lost_scheduler_is_named() -> None:
    """Whatever Dask raises then: here what a study met whose scheduler was killed."""

    def lost(*_: object, **__: object) -> None:
        raise RuntimeError("ConnectionPool is closed")

    client: Any = SimpleNamespace(
        scheduler=SimpleNamespace(address="tcp://10.0.0.1:8786"), status="closed", scatter=lost
    )
    pattern = (
        "--scheduler: got a scheduler at tcp://10.0.0.1:8786 that ended before the study.*run the"
        " same command"
    )
    with pytest.raises(pixsim.PixsimError, match=pattern):
        list(results_of(double, [(1, nothing)], Workers(client=client)))


def test_a_scheduler_that_answers_again_goes_on(
    cluster_here: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Calls lost with the connection run again, here when it is back after a moment."""
    from distributed import Client
    from distributed.comm import CommClosedError

    shared = partial(dict, values=np.ones(1))
    with Client(cluster_here, set_as_default=False) as client:

        def lost(*_: object, **__: object) -> None:
            monkeypatch.undo()
            client.status = "connecting"
            threading.Timer(0.05, setattr, (client, "status", "running")).start()
            raise CommClosedError

        monkeypatch.setattr(client, "scatter", lost)
        with pytest.warns(MachineWarning, match="retrying the remaining 2 of 2 tasks"):
            assert sorted(
                results_of(double, [(1, shared), (2, shared)], Workers(client=client))
            ) == [(1, 1.0), (2, 2.0)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a worker process died")
@pytest.mark.parametrize(
    ("lost", "pattern"),
    [("scheduler", "that ended before the study"), ("workers", "no worker within 3 s")],
)
def test_study_that_loses_its_cluster_keeps_rows(
    lost: str, pattern: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scheduler, or all workers, killed in the middle: an error, and the rows that were
    finished go on here.
    """
    import distributed

    toml, results = tmp_path / "tiny.toml", tmp_path / "out/results.csv"
    toml.write_text(tiny_toml(repeats=100), encoding="utf-8")

    def end_cluster(address: str) -> None:
        while not (results.is_file() and results.stat().st_size > 1 << 12):
            time.sleep(0.05)
        with (
            contextlib.suppress(Exception),
            distributed.Client(address, timeout=HANG_S, set_as_default=False) as client,
        ):
            (client.run_on_scheduler if lost == "scheduler" else client.run)(os._exit, 1)

    with running_cluster(tmp_path) as address:
        for name, seconds in (
            ("CONNECT_SECONDS", 3.0),
            ("WORKER_SECONDS", 3.0),
            ("IDLE_SECONDS", 3.0),
            ("WATCH_SECONDS", 0.5),
        ):
            monkeypatch.setattr(engine, name, seconds)
        thread = threading.Thread(target=end_cluster, args=[address], daemon=True)
        thread.start()
        with pytest.raises(pixsim.PixsimError, match=pattern):
            pixsim.study(toml, tmp_path / "out", scheduler=address)
        # The thread is not waited for: a worker that has ended does not answer it.
    kept = results.read_bytes().splitlines()[1:]
    assert kept
    pixsim.study(toml, tmp_path / "out", jobs=1)
    assert set(kept) <= set(results.read_bytes().splitlines())


# Either Dask itself tries the lost task again, without a word, or pixsim does: who notices first.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a worker process died")
def test_study_killed_cluster_worker_is_replaced(
    cluster: str, toml, expected, tmp_path: Path, monkeypatch
) -> None:
    """The last test of the cluster: one of its two workers is gone afterwards."""
    monkeypatch.setattr(
        evaluate, "evaluate_task", partial(die_once_at_7_um, mark=tmp_path / "killed")
    )
    pixsim.study(toml, tmp_path / "out", scheduler=cluster)
    assert (tmp_path / "killed").exists()
    assert (tmp_path / "out/results.csv").read_bytes() == expected
