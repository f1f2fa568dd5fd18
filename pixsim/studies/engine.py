"""Calls on worker processes: of this machine by loky, of many by Dask, both through joblib; what a dead worker had is retried."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pixsim.base import cache
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.machine import processors

Task = TypeVar("Task")
Shared = TypeVar("Shared")
Result = TypeVar("Result")
Function = Callable[[Task, Shared], Result]
Call = tuple[Task, Callable[[], Shared]]  # a task, and what makes that which it shares with others
Calls = dict[int, Call[Task, Shared]]  # by their number
Told = tuple[int, Result, list[str]]  # a call's number, its result, and what it warns of
NAMED_TASKS = 4  # in a message
SUSPECTS = 2  # calls a job that are under way or wait in its queue
CONNECT_SECONDS = 10.0
WORKER_SECONDS = 30.0  # until a cluster has one


@dataclass(frozen=True)
class Workers:
    """Where calls run: in this process (1 job), in processes of this machine, or on a Dask cluster.

    client : a connected distributed.Client, or None
    """

    jobs: int = 1
    client: Any = None

    def __str__(self) -> str:
        return f"the cluster at {self.client.scheduler.address}" if self.client else f"{self.jobs} processes"


def workers_here(jobs: int | None = None) -> Workers:
    """Processes of this machine: as many as asked for, or one for each core that this process may use."""
    return Workers(jobs or processors().usable)


@contextmanager
def workers_for(jobs: int | None = None, scheduler: Any = None) -> Iterator[Workers]:
    """The workers asked for.

    jobs : processes of this machine; None takes one a core
    scheduler : address of a Dask scheduler, as tcp://host:8786, or a distributed.Client, which stays open

    Raises PixsimError for both, fewer than one job, a cluster that is not there, has no worker, or runs another pixsim.
    """
    if jobs is not None and (jobs < 1 or scheduler is not None):
        got = f"{jobs} with a scheduler" if scheduler is not None else jobs
        raise invalid("--jobs", got, "1 or more processes of this machine, or a --scheduler, which knows its workers")
    if scheduler is None:
        yield workers_here(jobs)
    elif isinstance(scheduler, str):
        try:
            import distributed
        except ImportError:
            raise invalid("--scheduler", f"'{scheduler}', but Dask is not installed", "pip install 'pixsim[cluster]'") from None
        try:
            client = distributed.Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            mend = "Start one with `dask scheduler`, and workers with `dask worker ADDRESS`."
            got = f"'{scheduler}' ({' '.join(str(error).split()) or type(error).__name__})"
            raise invalid("--scheduler", got, "the address of a running Dask scheduler, as tcp://host:8786", mend) from None
        with closing(client):
            yield _checked(client)
    else:
        yield _checked(scheduler)


def _checked(client: Any) -> Workers:
    """PixsimError where a worker would compute something else."""
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
        theirs = client.run(cache.version_fingerprint)
    except TimeoutError:
        mend = "Start some with `dask worker ADDRESS`."
        raise invalid("--scheduler", f"no worker within {WORKER_SECONDS:g} s", "a cluster with a worker", mend) from None
    except Exception as error:  # whatever happens there: Dask tells it as a plain Exception
        got = f"a worker that cannot tell which pixsim it has ({error})"
        raise invalid("--scheduler", got, f"{cache.version_fingerprint()} on all of them") from None
    ours = cache.version_fingerprint()
    for address, other in theirs.items():
        if other != ours:
            raise invalid("--scheduler", f"{other} at {address}", f"{ours}, as here, so that all rows are alike")
    return Workers(client=client)


def results_of(function: Function[Task, Shared, Result], calls: Sequence[Call[Task, Shared]], workers: Workers) -> Iterator[Result]:
    """`function(task, make())` of each call (task, make), in the order in which they come.

    Calls with the same `make` share what it makes: one copy of it a worker, made while others are already at work. Where a
    worker dies, what is left is tried again, what was under way last.

    Raises PixsimError that names those which end their worker even when nothing else runs beside them.
    """
    left: Calls[Task, Shared] = dict(enumerate(calls))
    deadly: Calls[Task, Shared] = {}
    workers = Workers() if len(calls) == 1 and not workers.client else workers  # not worth a process

    def attempt(some: Calls[Task, Shared]) -> Iterator[Result]:
        """Results of some calls, which are taken away from them; a worker's death ends it."""
        try:
            for index, result in _once(function, some, workers):
                del some[index]
                yield result
        except Exception as error:
            if not is_death(error):
                raise

    while left:
        before = len(left)
        yield from attempt(left)
        if not left:
            break
        warnings.warn(f"a worker died; what is left, {len(left)} of {len(calls)} tasks, is tried again", stacklevel=2)
        indices = list(left)
        if len(left) < before:  # those that were begun first may be what kills: the others go before them
            half = len(indices) // 2
            left = {index: left[index] for index in [*indices[half:], *indices[:half]]}
            continue
        for index in indices[: SUSPECTS * workers.jobs]:  # one of those that were begun first: each with no other beside it
            alone = {index: left.pop(index)}
            yield from attempt(alone)
            deadly |= alone
    if deadly:
        tasks = [str(task) for task, _ in deadly.values()]
        named = ", ".join(tasks[:NAMED_TASKS]) + (f" and {len(tasks) - NAMED_TASKS} more" if len(tasks) > NAMED_TASKS else "")
        raise PixsimError(
            f"workers ({workers}): each of these ended its process, even alone: {named}. Often it is the system that is out of "
            "memory. What is finished is kept, and the same command goes on from there; --jobs 1 shows the error."
        )


def is_death(error: BaseException) -> bool:
    """Whether an error is that of a worker or a cluster, and not of the work; told by name, since neither need be installed."""
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"BrokenProcessPool", "KilledWorker", "CommClosedError", "FutureCancelledError", "CancelledError"})


def _once(function: Function[Task, Shared, Result], calls: Calls[Task, Shared], workers: Workers) -> Iterator[tuple[int, Result]]:
    """Each call's number and result, as they come."""
    if not workers.client and workers.jobs == 1:
        yield from ((index, function(task, make())) for index, (task, make) in list(calls.items()))
        return
    if workers.client:
        results = _on_cluster(function, calls, workers.client)
    else:
        # At least two: what is left after a worker's death may be what killed it, and must not come to this process.
        results = _on_processes(function, calls, max(2, min(workers.jobs, len(calls))))
    told: set[str] = set()
    for index, result, notes in results:
        for note in notes:
            if note not in told:
                warnings.warn(note, stacklevel=4)
                told.add(note)
        yield index, result


def _on_cluster(function: Function[Task, Shared, Result], calls: Calls[Task, Shared], client: Any) -> Iterator[Told[Result]]:
    from joblib import Parallel, delayed, parallel_config

    shared = {id(make): make() for _, make in calls.values()}
    if sum(client.ncores().values()) == 1:  # joblib would compute here; one thread does them in this order
        there = {name: client.scatter(each, hash=False) for name, each in shared.items()}
        futures = [
            client.submit(_numbered, function, index, task, there[id(make)], pure=False)
            for index, (task, make) in list(calls.items())
        ]
        yield from (future.result() for future in futures)
        return
    with parallel_config("dask", client=client, scatter=list(shared.values())):
        parallel = Parallel(n_jobs=-1, return_as="generator_unordered")
        yield from parallel(
            delayed(_numbered)(function, index, task, shared[id(make)]) for index, (task, make) in list(calls.items())
        )


def _numbered(function: Function[Task, Shared, Result], index: int, task: Task, shared: Shared) -> Told[Result]:
    """A call's number, its result, and what it warns of: the process that asked tells it, once."""
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        result = function(task, shared)
    return index, result, [str(note.message) for note in notes if issubclass(note.category, UserWarning)]


def _on_processes(function: Function[Task, Shared, Result], calls: Calls[Task, Shared], jobs: int) -> Iterator[Told[Result]]:
    """What is shared lies in files that the workers map into their memory: one copy for all of them.

    (joblib would do so by itself, but waits a second at the end for workers to let go.)
    """
    from joblib import Parallel, delayed, dump, parallel_config

    with tempfile.TemporaryDirectory(prefix="pixsim-", ignore_cleanup_errors=True) as folder:
        paths: dict[int, str] = {}

        def numbered() -> Iterator[Any]:
            for index, (task, make) in list(calls.items()):
                if id(make) not in paths:
                    paths[id(make)] = str(Path(folder) / f"{len(paths)}.joblib")
                    dump(make(), paths[id(make)])
                yield delayed(_numbered_from)(function, index, task, paths[id(make)])

        with parallel_config("loky", inner_max_num_threads=1):
            yield from Parallel(n_jobs=jobs, return_as="generator_unordered", max_nbytes=None)(numbered())


@lru_cache(maxsize=1)
def _mapped(path: str) -> Any:
    from joblib import load

    return load(path, mmap_mode="r")


def _numbered_from(function: Function[Task, Any, Result], index: int, task: Task, path: str) -> Told[Result]:
    return _numbered(function, index, task, _mapped(path))
