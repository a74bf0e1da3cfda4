"""One function over many inputs: in this process, in several on this machine, or on a Ray cluster; the same results.

What a process or a machine had begun when it died is done again.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection
from typing import Any

from toolkit.runtime.lost import WorkLost
from toolkit.runtime.memory import keep_freed_memory
from toolkit.runtime.ray_backend import RETRIES, on_ray

AHEAD = 2  # inputs handed out per process
TICK_S = 0.2  # between two looks at the ticks
IDLE_S = 20.0  # that processes wait for more of the same job


def spread(
    job: Callable[[Any], Any],
    inputs: Iterable[Any],
    *,
    workers: int = 1,
    ray: str | None = None,
    progress: Callable[[int], None] | None = None,
    ticks: Callable[[int], None] | None = None,
) -> Iterator[Any]:
    """`job(x)` for each of `inputs`, in their order, as `map` would give it; what `job` raises is raised.

    job: a function of a module, or an object that can be called and pickled; large things that stay the same belong
    into it, since each process gets it once. Its results must not depend on what it did before.
    workers: processes on this machine, a script that asks for several must do so under `if __name__ == "__main__":`;
    ray: instead of them the cores of a Ray cluster, by its address; "auto" for the one this machine is part of, "local"
    for one started here for the time being; coview must be installed on all its machines. progress: told how many
    results are done; ticks: told now and then how often jobs in processes called `tick`, in work
    that is done again too.

    Raises ValueError where workers is less than 1; WorkLost where work was lost more than RETRIES times;
    ImportError without Ray; ConnectionError where no cluster answers.
    """
    if workers < 1 or workers != int(workers):
        rule = "at least 1" if workers < 1 else "a whole number"
        raise ValueError(f"workers must be {rule}, got {workers}")
    if ray is not None:
        results = on_ray(job, inputs, ray)
    elif workers == 1:
        results = map(job, inputs)
    else:
        results = _in_processes(job, inputs, workers, ticks or _ignore)
    return _counted(results, progress)


def tick() -> None:
    """Say, in a job, that a part of it is done, so that long jobs show that they go on. Does nothing on Ray."""
    if _ticks is not None:
        with _ticks.get_lock():
            _ticks.value += 1


def _ignore(_: int) -> None:
    pass


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


def _in_processes(
    job: Callable[[Any], Any], inputs: Iterable[Any], workers: int, ticks: Callable[[int], None]
) -> Iterator[Any]:
    pickled, remaining = pickle.dumps(job), iter(inputs)
    pending: deque[_Task] = deque()
    deaths = given = given_before = 0  # deaths since there was a result
    ticked = 0  # in pools that died

    def tell(count: int) -> None:
        ticks(ticked + count)

    while True:
        try:
            with _pool(pickled, workers) as pool:
                for result in _results(pool, pending, remaining, tell):
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
            ticked += pool.ticks


def _results(
    pool: _Pool, pending: deque[_Task], remaining: Iterator[Any], ticks: Callable[[int], None]
) -> Iterator[Any]:
    """Results in order. What is in `pending` and has no future is handed out first; after a BrokenProcessPool it still
    holds every input whose result was not given."""
    while True:
        pending.extend(_Task(x) for x in islice(remaining, AHEAD * pool.workers - len(pending)))
        for task in pending:
            task.future = task.future or pool.submit(task.input)
        if not pending:
            return
        future = pending[0].future
        assert future is not None
        while not wait([future], TICK_S).done:
            ticks(pool.ticks)
        result = future.result()
        ticks(pool.ticks)
        pending.popleft()
        yield result


@contextmanager
def _pool(pickled: bytes, workers: int) -> Iterator[_Pool]:
    """Processes that end with this one, and at once where the block raises or is left early. The last ones are kept for
    `IDLE_S` seconds: a search asks for the same job time and again, and a process takes seconds to begin."""
    with _lock:
        pool = _kept.pop((pickled, workers), None)
    if pool is None:
        _end_kept()
        pool = _Pool(pickled, workers)
    pool.ticks = 0
    try:
        yield pool
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
        self.workers = workers
        self._reader, self._writer = context.Pipe(duplex=False)
        self._ticks = context.Value("q")
        self._executor = ProcessPoolExecutor(workers, context, _start_worker, (pickled, self._reader, self._ticks))
        self._idle: threading.Timer | None = None

    @property
    def ticks(self) -> int:
        """How often the job called `tick` since this was set to 0."""
        return int(self._ticks.get_obj().value)  # without the lock, which a process may have been killed with

    @ticks.setter
    def ticks(self, count: int) -> None:
        self._ticks.get_obj().value = count

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
_ticks: Any = None  # a number that all workers of a pool count up; None in other processes


def _start_worker(pickled: bytes, parent: Connection, ticks: Any) -> None:
    global _job, _ticks
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    keep_freed_memory()
    _job, _ticks = pickle.loads(pickled), ticks


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
