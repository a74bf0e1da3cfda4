"""One function over many inputs: in this process, in several on this machine, or on a Ray cluster; the same results.

What a process or a machine had begun when it died is done again.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection
from typing import Any

from toolkit.runtime.lost import WorkLost

RETRIES = 3  # how often work that was lost is done again
AHEAD = 2  # inputs handed out per process
IDLE_S = 20.0  # that processes wait for more of the same job
AHEAD_ON_RAY = 8  # inputs handed out per core: tasks travel farther, and nodes may join


def spread(
    job: Callable[[Any], Any],
    inputs: Iterable[Any],
    *,
    workers: int = 1,
    ray: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Any]:
    """`job(x)` for each of `inputs`, in their order, as `map` would give it; what `job` raises is raised.

    job: a function of a module, or an object that can be called and pickled; large things that stay the same belong
    into it, since each process gets it once. Its results must not depend on what it did before.
    workers: processes on this machine, a script that asks for several must do so under `if __name__ == "__main__":`;
    ray: instead of them the cores of a Ray cluster, by its address; "auto" for the one this machine is part of, "local"
    for one started here for the time being; coview must be installed on all its machines. progress: told how many
    results are done.

    Raises ValueError where workers is less than 1; WorkLost where work was lost more than RETRIES times;
    ImportError without Ray; ConnectionError where no cluster answers.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if ray is not None:
        results = _on_ray(job, inputs, ray)
    elif workers == 1:
        results = map(job, inputs)
    else:
        results = _in_processes(job, inputs, workers)
    return _counted(results, progress)


def _counted(results: Iterator[Any], progress: Callable[[int], None] | None) -> Iterator[Any]:
    for done, result in enumerate(results, 1):
        if progress:
            progress(done)
        yield result


@dataclass
class _Task:
    """An input, and its result to come: None while no pool has it."""

    input: Any
    future: Future[Any] | None = None

    @property
    def lost(self) -> bool:
        future = self.future
        return future is None or future.cancelled() or isinstance(future.exception(), BrokenProcessPool)


def _in_processes(job: Callable[[Any], Any], inputs: Iterable[Any], workers: int) -> Iterator[Any]:
    pickled, remaining = pickle.dumps(job), iter(inputs)
    pending: deque[_Task] = deque()
    deaths = given = given_before = 0  # deaths since there was a result
    while True:
        try:
            with _pool(pickled, workers) as submit:
                for result in _results(submit, pending, remaining, AHEAD * workers):
                    given += 1
                    yield result
            return
        except BrokenProcessPool:
            lost = [task for task in pending if task.lost]
            known = given + len(pending) - len(lost)
            deaths, given_before = deaths + 1 if known == given_before else 1, known
            if deaths > RETRIES:
                raise WorkLost(_died(deaths, str(lost[0].input))) from None
            for task in lost:
                task.future = None


def _results(
    submit: Callable[[Any], Future[Any]], pending: deque[_Task], remaining: Iterator[Any], ahead: int
) -> Iterator[Any]:
    """Results in order. What is in `pending` and has no future is handed out first; after a BrokenProcessPool it still
    holds every input whose result was not given."""
    while True:
        pending.extend(_Task(x) for x in islice(remaining, ahead - len(pending)))
        for task in pending:
            task.future = task.future or submit(task.input)
        if not pending:
            return
        result = pending[0].future.result()  # type: ignore[union-attr]
        pending.popleft()
        yield result


@contextmanager
def _pool(pickled: bytes, workers: int) -> Iterator[Callable[[Any], Future[Any]]]:
    """Processes that end with this one, and at once where the block raises or is left early. The last ones are kept for
    `IDLE_S` seconds: a search asks for the same job time and again, and a process takes seconds to begin."""
    with _lock:
        pool = _kept.pop((pickled, workers), None)
    if pool is None:
        _end_kept()
        pool = _Pool(pickled, workers)
    try:
        yield pool.submit
    except BaseException:
        pool.end(at_once=True)
        raise
    _end_kept()
    with _lock:
        _kept[pickled, workers] = pool
    pool.end_when_idle()


class _Pool:
    """Worker processes that have a job."""

    def __init__(self, pickled: bytes, workers: int) -> None:
        context = multiprocessing.get_context("spawn")  # forking would copy the locks of Open3D's and torch's threads
        self._reader, self._writer = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(workers, context, _start_worker, (pickled, self._reader))
        self._idle: threading.Timer | None = None

    def submit(self, x: Any) -> Future[Any]:
        """Have the job done on an input."""
        if self._idle:
            self._idle.cancel()
        return self._executor.submit(_work, x)

    def end_when_idle(self) -> None:
        """End the processes unless there is work for them again soon."""
        self._idle = threading.Timer(IDLE_S, _end_kept)
        self._idle.daemon = True
        self._idle.start()

    def end(self, at_once: bool = False) -> None:
        """End the processes, in the midst of their work if need be."""
        if self._idle:
            self._idle.cancel()
        if at_once:
            self._writer.close()
        self._executor.shutdown(cancel_futures=True)
        self._reader.close()
        self._writer.close()


_kept: dict[tuple[bytes, int], _Pool] = {}  # one at most
_lock = threading.Lock()


def _end_kept() -> None:
    with _lock:
        pools = list(_kept.values())
        _kept.clear()
    for pool in pools:
        pool.end()


_job: Callable[[Any], Any]


def _start_worker(pickled: bytes, parent: Connection) -> None:
    global _job
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _job = pickle.loads(pickled)


def _end_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv()  # nothing is ever sent: it returns when the other end is closed, or its process killed
    os._exit(1)


def _work(x: Any) -> Any:
    return _job(x)


def _died(times: int, x: str) -> str:
    return (
        f"a worker process died {times} times in a row, at or near input {x[:60]}: out of memory (use fewer workers), "
        'or called from a script without `if __name__ == "__main__":`'
    )


def _on_ray(job: Callable[[Any], Any], inputs: Iterable[Any], address: str) -> Iterator[Any]:
    """Ray's scheduler gives tasks to nodes, and gives them again when a worker or a node is lost."""
    ray = _connected(address)
    pending: deque[Any] = deque()
    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_work_on_ray)
        shared, remaining = ray.put(job), iter(inputs)
        ahead = AHEAD_ON_RAY * max(1, int(ray.cluster_resources().get("CPU", 1)))
        while True:
            pending.extend(task.remote([shared], x) for x in islice(remaining, ahead - len(pending)))
            if not pending:
                return
            yield _got(ray, pending.popleft())
    finally:
        for reference in pending:
            ray.cancel(reference, force=True)


def _got(ray: Any, reference: Any) -> Any:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # what the job raised
        raise error.cause from None
    except ray.exceptions.RayError as error:
        reason = str(error).partition("\n")[0]
        raise WorkLost(f"work was lost on the Ray cluster more than {RETRIES} times ({reason}): see its logs") from None


_jobs: dict[str, Callable[[Any], Any]] = {}  # of a Ray worker: the last it was given, so that what it keeps is kept


def _work_on_ray(shared: list[Any], x: Any) -> Any:
    key = shared[0].hex()
    if key not in _jobs:
        _jobs.clear()
        _jobs[key] = _ray().get(shared[0])
    return _jobs[key](x)


_address: str | None = None  # of the cluster that we are connected to


def _connected(address: str) -> Any:
    """Ray, connected until this process ends or asks for another cluster; a connection of the caller's own stays."""
    global _address
    ray = _ray()
    if ray.is_initialized() and _address not in (None, address):
        ray.shutdown()
    if not ray.is_initialized():
        _connect(ray, address)
        _address = address
    return ray


def _connect(ray: Any, address: str) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    here = {"include_dashboard": False} if address == "local" else {}
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    try:
        if colon:  # Ray itself takes minutes to find out
            socket.create_connection((host.strip("[]"), int(port)), timeout=5.0).close()
        ray.init(address=address, log_to_driver=False, **here)
    except (OSError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise ConnectionError(
            f"no Ray cluster answers at {address!r} ({reason}): start one with `ray start --head`, or ask for 'local'"
        ) from None


def _ray() -> Any:
    try:
        import ray
    except ImportError:
        raise ImportError("work on a Ray cluster needs Ray: pip install coview[scale]") from None
    return ray
