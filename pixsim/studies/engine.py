"""Parallel calls: on threads, on processes of this machine by joblib, on a cluster by Dask. Lost
calls are retried.
"""

from __future__ import annotations

import errno
import gc
import os
import secrets
import signal
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from pixsim.base import cache
from pixsim.base.children import safe_variables
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import disk_faults_named
from pixsim.base.lazy import ignore_matplotlibrc
from pixsim.base.locks import temporary_folder
from pixsim.base.machine import memory, processors
from pixsim.base.notes import Note, note_of, warn
from pixsim.base.shared_block import SharedBlock

if TYPE_CHECKING:
    from distributed import Client

    from pixsim.studies.design import FrameCost

Task = TypeVar("Task")
Shared = TypeVar("Shared")
Result = TypeVar("Result")
Function = Callable[[Task, Shared], Result]
Call = tuple[Task, Callable[[], Shared]]  # a task, and the function that makes its shared data
Calls = dict[int, Call[Task, Shared]]  # by number
_Reply = tuple[int, Result, list[Note]]  # a call's number, its result and its warnings
_NAMED_TASKS = 4  # named in an error message
_SUSPECTS = 2  # calls per job that are running or queued
_SIGNAL_S = 0.1  # until a signal that ended workers has ended this process, too
CONNECT_SECONDS = 10.0
WORKER_SECONDS = 30.0  # to wait for a cluster's first worker
# For a client that has lost its scheduler, which gives up after `CONNECT_SECONDS`; between two
# looks at it.
_RECONNECT_SECONDS = 60.0
_LOOK_SECONDS = 0.1
BATCH_SECONDS, MAX_CALLS = 0.5, 1 << 8  # of the calls of one task of a cluster
_BATCHES_A_THREAD = 3  # of a cluster: one runs, the others wait
# For workers to come back after all are lost; between two looks.
IDLE_SECONDS = 300.0
WATCH_SECONDS = 5.0
# Of all evaluations on one thread: where they take less, threads of this process end sooner than
# processes, which take a second to start.
_PROCESS_SECONDS = 8.0
BASE_BYTES = 3.0e8  # of a process: the program and its libraries
_AHEAD_BYTES = 1 << 28  # of shared data that is made before its first call is due


@dataclass(frozen=True)
class Workers:
    """Where calls run: in this process (1 job, or threads), in processes of this machine, or on a
    Dask cluster.

    jobs : calls at the same time
    client : a connected distributed.Client, or None
    are_threads : whether jobs are threads of this process
    """

    jobs: int = 1
    client: Client | None = None
    are_threads: bool = False

    def __str__(self) -> str:
        if self.client:
            return f"the cluster at {self.client.scheduler.address}"
        return f"{self.jobs} {'threads' if self.are_threads else 'processes'}"

    @property
    def are_processes(self) -> bool:
        """Whether several processes of this machine run the calls."""
        return self.jobs > 1 and not self.client and not self.are_threads


def workers_here(jobs: int | None = None) -> Workers:
    """Return local workers: `jobs` processes, or one per core that this process may use."""
    return Workers(jobs or processors().usable)


def suitable_workers(evaluations: Iterable[tuple[int, FrameCost]]) -> Workers:
    """Return processes of this machine where they are worth their start, or else threads, of which
    each has a core and memory for the largest frame.

    evaluations : numbers of evaluations, and the cost of one
    """
    seconds = 0.0
    largest_bytes = 0.0
    for count, cost in evaluations:
        seconds += count * cost.seconds
        largest_bytes = max(largest_bytes, cost.memory_bytes)
    jobs = workers_here().jobs
    usable_bytes = memory().usable
    if usable_bytes is not None:
        jobs = max(1, min(jobs, int(usable_bytes // (BASE_BYTES + largest_bytes))))
    return Workers(jobs, are_threads=seconds < _PROCESS_SECONDS)


@contextmanager
def workers_for(
    jobs: int | None = None,
    scheduler: object = None,
    suitable: Callable[[], Workers] = workers_here,
) -> Iterator[Workers]:
    """Provide local or cluster workers.

    jobs : local processes
    scheduler : address of a Dask scheduler, such as tcp://host:8786, or a distributed.Client, which
        stays open
    suitable : returns the local workers where neither is given

    Raises PixsimError if both are given, jobs is below 1, or the cluster is unreachable, has no
    worker or runs another pixsim.
    """
    if jobs is not None and (jobs < 1 or scheduler is not None):
        got = f"{jobs} with a scheduler" if scheduler is not None else jobs
        raise invalid("--jobs", got, "1 or more local processes, or a --scheduler without --jobs")
    if scheduler is None:
        yield suitable() if jobs is None else workers_here(jobs)
    elif isinstance(scheduler, str):
        try:
            import distributed
        except ImportError:
            raise invalid(
                "--scheduler",
                f"'{scheduler}', but Dask is not installed",
                "pip install 'pixsim[cluster]'",
            ) from None

        class Client(distributed.Client):  # type: ignore[misc]
            def __del__(self) -> None:
                # After a failed connection this fails too; the error has been reported by then.
                with suppress(Exception):
                    super().__del__()

        try:
            client = Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            # RuntimeError: encryption is required, or TLS has no certificate.
            hint = "Start one with `dask scheduler`, and workers with `dask worker ADDRESS`."
            got = f"'{scheduler}' ({' '.join(str(error).split()) or type(error).__name__})"
            raise invalid(
                "--scheduler",
                got,
                "the address of a running Dask scheduler, such as tcp://host:8786",
                hint,
            ) from None
        with closing(client):
            yield _checked_workers(client)
    else:
        yield _checked_workers(cast("Client", scheduler))


def _checked_workers(client: Client) -> Workers:
    """Return the workers of a cluster. Raises PixsimError if it has none, or one runs another
    version.
    """
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
        worker_versions = client.run(cache.version_fingerprint)
    except TimeoutError:
        hint = "Start workers with `dask worker ADDRESS`."
        raise invalid(
            "--scheduler", f"no worker within {WORKER_SECONDS:g} s", "a cluster with a worker", hint
        ) from None
    except Exception as error:  # Dask reports any failure on a worker as a plain Exception
        got = f"a worker that does not report its pixsim version ({error})"
        raise invalid("--scheduler", got, f"{cache.version_fingerprint()} on all workers") from None
    version = cache.version_fingerprint()
    for address, worker_version in worker_versions.items():
        if worker_version != version:
            raise invalid(
                "--scheduler",
                f"{worker_version} at {address}",
                f"{version}, the version here, so that all rows are comparable",
            )
    return Workers(client=client)


def results_of(
    function: Function[Task, Shared, Result], calls: Sequence[Call[Task, Shared]], workers: Workers
) -> Iterator[Result]:
    """Yield `function(task, make())` of each call (task, make), in order of completion.

    Calls with the same `make` share its result, one copy per worker, made while other calls already
    run. If a worker dies, unfinished calls are retried, those that were running last.

    Raises PixsimError naming the tasks that end their worker even when they run alone, or if the
    cluster's scheduler is lost.
    """
    unfinished: Calls[Task, Shared] = dict(enumerate(calls))
    fatal: Calls[Task, Shared] = {}
    # Read at the beginning, since a closed client has no address.
    address = workers.client.scheduler.address if workers.client else ""
    if not workers.client and (len(calls) == 1 or (workers.are_processes and not processes_work())):
        workers = Workers()  # one call needs no other thread or process

    def attempt(batch: Calls[Task, Shared]) -> Iterator[Result]:
        """Yield results, and remove finished calls from the batch; stop when a worker dies."""
        try:
            for index, result in _run_calls(function, batch, workers):
                del batch[index]
                yield result
        except Exception as error:
            if workers.client:
                _check_scheduler(workers.client, address)
            if not _is_lost_worker(error):
                raise

    while unfinished:
        count_before = len(unfinished)
        yield from attempt(unfinished)
        if not unfinished:
            break
        # A signal to the whole group ends workers before this process: the command ends here then,
        # not with a word of lost workers.
        time.sleep(_SIGNAL_S)
        words = (
            f"a worker process died; retrying the remaining {len(unfinished)} of {len(calls)} tasks"
        )
        warn(Note("machine", words=words))
        indices = list(unfinished)
        if len(unfinished) < count_before:
            # The calls started first may be the cause: the others go before them.
            half = len(indices) // 2
            unfinished = {index: unfinished[index] for index in [*indices[half:], *indices[:half]]}
            continue
        # One of the calls started first is the cause: run each alone.
        for index in indices[: _SUSPECTS * workers.jobs]:
            single_call = {index: unfinished.pop(index)}
            yield from attempt(single_call)
            fatal |= single_call
    if fatal:
        tasks = [str(task) for task, _ in fatal.values()]
        names = ", ".join(tasks[:_NAMED_TASKS])
        if len(tasks) > _NAMED_TASKS:
            names += f" and {len(tasks) - _NAMED_TASKS} more"
        raise PixsimError(
            f"workers ({workers}): each of these tasks ended its process, even when run alone:"
            f" {names}. Often the system is out of memory. Finished rows are kept, and the same"
            " command continues from them; --jobs 1 shows the error."
        )


@lru_cache
def processes_work() -> bool:
    """Return whether this machine can have workers, with a warning if it cannot: their locks are
    files of /dev/shm.
    """
    import _multiprocessing  # type: ignore[import-not-found]

    try:
        _multiprocessing.SemLock(0, 0, 1, f"/pixsim-{secrets.token_hex(8)}", True)
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            raise
        hint = "mount /dev/shm (docker run --shm-size 64m), or give --jobs 1"
        words = (
            f"no worker processes, since /dev/shm cannot be written ({error.strerror}): one process"
            f" does all; {hint}"
        )
        warn(Note("machine", words=words))
        return False
    return True


def _check_scheduler(client: Client, address: str) -> None:
    """Raise PixsimError if a client has lost its scheduler and does not find it again, or finds it
    without workers.
    """
    deadline = time.monotonic() + _RECONNECT_SECONDS
    while client.status == "connecting" and time.monotonic() < deadline:
        time.sleep(_LOOK_SECONDS)
    if client.status != "running":
        hint = (
            "Start a cluster again, and run the same command: finished rows are kept, and it"
            " continues from them."
        )
        raise invalid(
            "--scheduler",
            f"a scheduler at {address} that ended before the study",
            "a scheduler that runs until the study has ended",
            hint,
        )
    _checked_workers(client)


def _is_lost_worker(error: BaseException) -> bool:
    """Return whether an error means a lost worker or cluster.

    Its classes are compared by name, since neither joblib nor Dask need be installed.
    """
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(
        names
        & {
            "BrokenProcessPool",
            "KilledWorker",
            "CommClosedError",
            "FutureCancelledError",
            "CancelledError",
        }
    )


def _run_calls(
    function: Function[Task, Shared, Result], calls: Calls[Task, Shared], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Yield each call's number and result, in order of completion, without retrying."""
    if not workers.client and workers.jobs == 1:
        yield from ((index, function(task, make())) for index, (task, make) in list(calls.items()))
        return
    if workers.are_threads:
        yield from _on_threads(function, calls, workers.jobs)
        return
    if workers.client:
        results = _on_cluster(function, calls, workers.client)
    else:
        # At least two: after a worker's death, joblib must not run the remaining calls in this
        # process.
        results = _on_processes(function, calls, max(2, min(workers.jobs, len(calls))))
    warned: set[Note] = set()
    for index, result, notes in results:
        for note in notes:
            if note not in warned:
                warn(note)
                warned.add(note)
        yield index, result


def _on_threads(
    function: Function[Task, Shared, Result], calls: Calls[Task, Shared], jobs: int
) -> Iterator[tuple[int, Result]]:
    """Yield each call's number and result from threads of this process.

    An error, or Ctrl-C, ends them when the running calls end.
    """
    waiting_calls = iter(list(calls.items()))
    running: dict[Future[Result], int] = {}
    with ThreadPoolExecutor(jobs, "pixsim calls") as pool:
        try:
            while True:
                # Shared data are made here, for one call ahead of those that run.
                for index, (task, make) in islice(waiting_calls, jobs + 1 - len(running)):
                    running[pool.submit(function, task, make())] = index
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _on_cluster(
    function: Function[Task, Shared, Result], calls: Calls[Task, Shared], client: Client
) -> Iterator[_Reply[Result]]:
    makes = {id(make): make for _, make in calls.values()}
    # On all workers: what only a lost one had could not be made again. (Equal data, as None, would
    # be one object by its content.)
    remote = dict(
        zip(
            makes,
            client.scatter([make() for make in makes.values()], broadcast=True, hash=False),
            strict=True,
        )
    )
    with _given_up_without_workers(client):
        yield from _replies(function, calls, remote, client)


@contextmanager
def _given_up_without_workers(client: Client) -> Iterator[None]:
    """Cancel the calls of this context if a cluster has no worker for `IDLE_SECONDS`: Dask would
    wait for ever.
    """
    from distributed import Future as Promise

    before = set(client.futures)
    ended = threading.Event()

    def watch() -> None:
        seen = time.monotonic()
        while not ended.wait(WATCH_SECONDS):
            with suppress(Exception):  # the scheduler is gone, which ends the calls by itself
                if client.nthreads():
                    seen = time.monotonic()
                elif time.monotonic() - seen > IDLE_SECONDS:
                    client.cancel(
                        [Promise(key, client) for key in set(client.futures) - before], force=True
                    )

    thread = threading.Thread(target=watch, name="pixsim cluster", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()


def _replies(
    function: Function[Task, Shared, Result],
    calls: Calls[Task, Shared],
    remote: dict[int, Any],
    client: Client,
) -> Iterator[_Reply[Result]]:
    """Yield the replies of a cluster, whose tasks are batches of calls: Dask spends about 10 ms of
    processor time on each task.

    A batch is the next calls, as many as take `BATCH_SECONDS` at the pace of the last batch, and at
    most a part of the calls that are left.

    remote : id of the function that makes shared data -> these data on the workers
    """
    from distributed import as_completed

    waiting_calls = iter(list(calls.items()))
    batch_size = 1
    unsent = len(calls)
    sent = as_completed(loop=client.loop)

    def send() -> None:
        """Send batches until each thread of the cluster has some."""
        nonlocal unsent
        threads = max(1, sum(client.nthreads().values()))
        while unsent and sent.count() < _BATCHES_A_THREAD * threads:
            max_batch = -(-unsent // (_BATCHES_A_THREAD * threads))
            batch = [
                (index, task, remote[id(make)])
                for index, (task, make) in islice(waiting_calls, max(1, min(batch_size, max_batch)))
            ]
            unsent -= len(batch)
            sent.add(client.submit(_batch, function, batch, pure=False))

    try:
        send()
        for future in sent:
            replies, seconds = future.result()
            batch_size = min(
                MAX_CALLS, max(1, round(BATCH_SECONDS * len(replies) / max(seconds, 1e-9)))
            )
            send()
            yield from replies
    finally:
        with suppress(Exception):  # the scheduler is gone, and the batches with it
            client.cancel(list(sent.futures))


def _batch(
    function: Function[Task, Shared, Result], calls: list[tuple[int, Task, Shared]]
) -> tuple[list[_Reply[Result]], float]:
    """Return the replies of some calls, and the processor time that they took in seconds, since
    workers may share a processor.
    """
    start = time.thread_time()
    replies = [_reply_of_call(function, index, task, shared) for index, task, shared in calls]
    return replies, time.thread_time() - start


def _reply_of_call(
    function: Function[Task, Shared, Result], index: int, task: Task, shared: Shared
) -> _Reply[Result]:
    """Return a call's number, its result and its warnings, which the parent process shows once."""
    with warnings.catch_warnings(record=True) as recorded:
        warnings.simplefilter("always")
        result = function(task, shared)
    notes = [
        note_of(warning.message)
        for warning in recorded
        if issubclass(warning.category, UserWarning)
    ]
    return index, result, notes


# loky replaces a worker whose memory grows by 300 MB, as the light behind a lens makes it, and
# warns of that. No result depends on it.
_WORKER_REPLACED_WARNING = "A worker stopped while some jobs were given to the executor"


def _on_processes(
    function: Function[Task, Shared, Result], calls: Calls[Task, Shared], jobs: int
) -> Iterator[_Reply[Result]]:
    """Run calls on local processes, with shared data in memory-mapped files: one copy for all.

    (joblib would do so by itself, but waits a second at the end for workers to release them.)
    """
    from joblib import Parallel, delayed, parallel_config

    with (
        _safe_children(),
        temporary_folder() as folder,
        closing(SharedFiles(folder, [make for _, make in calls.values()])) as files,
    ):
        makers = {index: make for index, (_, make) in calls.items()}
        unfinished_counts = Counter(map(id, makers.values()))

        def delayed_calls(
            ctrl_c_allowed: Callable[[], AbstractContextManager[None]],
        ) -> Iterator[Any]:
            for index, (task, make) in list(calls.items()):
                with ctrl_c_allowed():
                    path = files.path(make)
                yield delayed(_reply_of_stored_call)(function, index, task, path)

        @contextmanager
        def running_replies() -> Iterator[Iterator[_Reply[Result]]]:
            """Give the replies of running calls.

            It is entered and left as a whole, since joblib ends only workers that it has
            registered.
            """
            parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", max_nbytes=None)
            with _ctrl_c_blocked() as ctrl_c_allowed:
                results = parallel(delayed_calls(ctrl_c_allowed))
            try:
                yield results
            finally:
                # Python would close them itself, with a warning of the calls that are given up.
                with warnings.catch_warnings(action="ignore"):
                    results.close()

        # Workers of other arguments are not used again: those of another current folder would take
        # a relative path from there.
        worker_arguments: dict[str, Any] = {
            "initializer": _begin_worker,
            "initargs": (os.getpid(), _current_folder()),
        }
        with parallel_config("loky", inner_max_num_threads=1, **worker_arguments):
            warnings.filterwarnings("ignore", _WORKER_REPLACED_WARNING, UserWarning)
            with running_replies() as replies:
                for reply in replies:
                    yield reply
                    make = makers[reply[0]]
                    unfinished_counts[id(make)] -= 1
                    if not unfinished_counts[id(make)]:
                        files.drop(make)


class SharedFiles:
    """Files of shared data, each made once: the first when it is asked for, the next ones in the
    background until then.

    Those that wait have `_AHEAD_BYTES` together, or are one.

    makes : the functions that make them, in the order of their first calls
    """

    def __init__(self, folder: Path, makes: Sequence[Callable[[], Any]]) -> None:
        self._folder = folder
        self._next = {id(make): make for make in makes}
        self._paths: dict[int, Path] = {}
        self._ahead: dict[int, Future[Path]] = {}
        self._thread = ThreadPoolExecutor(1, "pixsim ahead")

    def path(self, make: Callable[[], Any]) -> str:
        """Return the path of the file that holds what a function makes."""
        if id(make) not in self._paths:
            if id(make) in self._ahead:
                self._paths[id(make)] = self._ahead.pop(id(make)).result()
            else:
                self._paths[id(make)] = self._made(self._next.pop(id(make)))
        self._make_ahead()
        return str(self._paths[id(make)])

    def _make_ahead(self) -> None:
        """Begin with the next file, if none is being made and those that wait leave room."""
        waiting = self._ahead.values()
        if not self._next or not all(
            future.done() and not future.exception() for future in waiting
        ):
            return
        if sum(future.result().stat().st_size for future in waiting) < _AHEAD_BYTES:
            first = next(iter(self._next))
            self._ahead[first] = self._thread.submit(self._made, self._next.pop(first))

    def _made(self, make: Callable[[], Any]) -> Path:
        from joblib import dump

        path = self._folder / f"{id(make)}.joblib"
        content = make()
        with disk_faults_named(
            self._folder, self._folder, "TMPDIR sets another folder for temporary files."
        ):
            dump(content, path)
        return path

    def drop(self, make: Callable[[], Any]) -> None:
        """Delete a file that no call needs any more."""
        with suppress(OSError):
            self._paths[id(make)].unlink()

    def close(self) -> None:
        """Wait for the file that is being made."""
        self._thread.shutdown(cancel_futures=True)


_WATCH_S = 1.0  # between two looks at the parent


def _current_folder() -> str:
    """Return the current folder, or an empty text if it was deleted."""
    try:
        return os.getcwd()
    except OSError:
        return ""


def _begin_worker(parent: int, _: str) -> None:
    """Prepare this worker process.

    parent : process that started it
    """
    gc.disable()  # a sixth of the time of the imports; the first call enables it
    ignore_matplotlibrc()
    _watch_parent(parent)


def _watch_parent(parent: int) -> None:
    """End this worker when its parent has ended: loky's workers would wait 300 s for it, and keep
    its pipes open.

    (A death signal of the system would not do: it comes when the thread ends that started the
    worker.)
    """

    def run() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=run, name="pixsim parent", daemon=True).start()


@contextmanager
def _safe_environment() -> Iterator[None]:
    """Put `safe_variables` into the environment of this process, and restore it."""
    before = {name: os.environ.get(name) for name in safe_variables()}
    os.environ |= safe_variables()
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ |= {} if value is None else {name: value}


_safe = SharedBlock(_safe_environment)


@contextmanager
def _safe_children() -> Iterator[None]:
    """Give `safe_variables` to all processes that are started meanwhile, also by joblib's threads
    and its trackers.

    Blocks of several threads may overlap. A user's own modules reach the workers with the path of
    this process.
    """
    with _safe:
        yield


@contextmanager
def _ctrl_c_blocked() -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Block Ctrl-C in this thread, for the processes that it starts: they inherit this, and their
    parent ends them.

    Gives a context manager in which Ctrl-C is taken as before.
    """
    import multiprocessing.resource_tracker

    # it would unblock Ctrl-C when the first worker starts
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])

    @contextmanager
    def ctrl_c_allowed() -> Iterator[None]:
        blocked = signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

    try:
        yield ctrl_c_allowed
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@lru_cache(maxsize=1)
def _load_mapped(path: str) -> object:
    from joblib import load

    return load(path, mmap_mode="r")


def _reply_of_stored_call(
    function: Function[Task, Any, Result], index: int, task: Task, path: str
) -> _Reply[Result]:
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    return _reply_of_call(function, index, task, _load_mapped(path))
