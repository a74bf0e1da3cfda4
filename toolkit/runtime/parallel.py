"""One function over many inputs: in this process, in several on this machine, or on a Ray cluster.

The results are the same everywhere. Work that a process or a machine had begun when it died is
repeated."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import socket
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib import import_module
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

Value = Any  # an input or result of a job, or an object of Ray, which has no types
Task = Callable[[Value], Value]
MAX_KEPT_BYTES = 32 << 20  # the C library always takes larger blocks from the system
_MMAP_THRESHOLD = -3  # option of mallopt(3)
_TRIM_THRESHOLD = -1  # option of mallopt(3)
_MAX_TRIM_BYTES = 2**31 - 1  # the largest int, so that the end of the heap is never returned
MALLOC_SETTINGS = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES")
RETRIES = 3  # when work is lost
AHEAD_PER_CORE = 8  # inputs handed out per core: tasks travel farther, and nodes may join
AHEAD_PER_PROCESS = 2  # inputs handed out per process
TICK_S = 0.2  # between two looks at the ticks
IDLE_S = 20.0  # before processes without a job end


class WorkLost(RuntimeError):
    """A worker died, perhaps through no fault of input or code.

    Finished work is kept: start again."""


@lru_cache(maxsize=1)
def keep_freed_memory() -> bool:
    """Let new arrays of up to `MAX_KEPT_BYTES` bytes reuse the memory of old ones; return success.

    The GNU C library returns freed memory at the end of its heap to the system, which clears every
    page before it is used again: a third of the time of a network that allocates and frees maps.
    The process then keeps its peak memory. Nothing changes under another C library, or if the
    environment configures allocation."""
    return tune_allocation(_c_library(), os.environ)


def tune_allocation(library: object, environment: Iterable[str]) -> bool:
    """Let a C library keep freed blocks of up to `MAX_KEPT_BYTES` bytes; return success.

    library: C library, None without one; environment: names of the environment's variables. One of
    `MALLOC_SETTINGS` among them changes allocation already, so nothing is done."""
    mallopt = getattr(library, "mallopt", None)
    if mallopt is None or not set(MALLOC_SETTINGS).isdisjoint(environment):
        return False
    return bool(mallopt(_MMAP_THRESHOLD, MAX_KEPT_BYTES)) and bool(
        mallopt(_TRIM_THRESHOLD, _MAX_TRIM_BYTES)
    )


def return_freed_memory(library: object = None) -> None:
    """Return freed memory to the system, after a job that took much.

    Does nothing under another C library. library: C library, None for that of this process."""
    getattr(library or _c_library(), "malloc_trim", bool)(0)


def _c_library() -> object:
    """C library of this process, None if it cannot be reached."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):  # no handle of the program itself, as on Windows
        return None


def run_on_ray(job: Task, inputs: Iterable[Value], address: str) -> Iterator[Value]:
    """Yield `job(x)` for each of `inputs`, in their order, from a Ray cluster.

    The cluster repeats lost tasks. Raises what the job raises, and WorkLost."""
    ray = _connect(address)
    pending: deque[Value] = deque()
    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_work_on_ray)
        shared_job = ray.put(job)
        remaining = iter(inputs)
        # tasks that are started before the first is awaited
        ahead = AHEAD_PER_CORE * max(1, int(ray.cluster_resources().get("CPU", 1)))
        while True:
            pending.extend(
                task.remote([shared_job], x) for x in islice(remaining, ahead - len(pending))
            )
            if not pending:
                return
            yield ray.get(pending.popleft())
    except ray.exceptions.RayTaskError as error:  # what the job raised
        raise error.cause from None
    except ray.exceptions.RayError as error:
        reason = str(error).partition("\n")[0]
        raise WorkLost(
            f"work was lost on the Ray cluster more than {RETRIES} times ({reason}): see its logs"
        ) from None
    finally:  # also if the caller takes no more results
        for reference in pending:
            ray.cancel(reference, force=True)


_jobs: dict[str, Task] = {}  # last job of a Ray worker, by its reference; its caches stay
_address: str | None = None  # address of the connected cluster


def _work_on_ray(shared: list[Value], x: Value) -> Value:
    """Result of the job for one input, in a Ray worker.

    shared: list with the job's reference, since Ray would replace a bare one by the job."""
    key = shared[0].hex()
    if key not in _jobs:
        _jobs.clear()
        _jobs[key] = import_module("ray").get(shared[0])
    return _jobs[key](x)


def _connect(address: str) -> Value:
    """Return the module `ray`, connected to a cluster until this process ends or changes it.

    address: the cluster for `ray.init`, such as "auto" or "HOST:PORT". Raises ImportError
    without Ray, and ConnectionError if no cluster answers."""
    global _address
    try:
        ray: Value = import_module("ray")
    except ImportError:
        raise ImportError("work on a Ray cluster needs Ray: pip install coview[scale]") from None
    if ray.is_initialized() and _address not in (None, address):
        ray.shutdown()
    if ray.is_initialized():
        return ray
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    local_options = {"include_dashboard": False} if address == "local" else {}
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    try:
        if colon:  # Ray itself takes minutes to find out
            socket.create_connection((host.strip("[]"), int(port)), timeout=5.0).close()
        ray.init(address=address, log_to_driver=False, **local_options)
    except (OSError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        remedy = "start one with `ray start --head`, or ask for 'local'"
        raise ConnectionError(
            f"no Ray cluster answers at {address!r} ({reason}): {remedy}"
        ) from None
    _address = address
    return ray


def spread(
    job: Task,
    inputs: Iterable[Value],
    *,
    workers: int = 1,
    ray: str | None = None,
    progress: Callable[[int], None] | None = None,
    ticks: Callable[[int], None] | None = None,
) -> Iterator[Value]:
    """Yield `job(x)` for each of `inputs`, in their order.

    job: a function of a module, or an object that can be called and pickled; store large constants
    in it, since each process gets it once. Its results must not depend on earlier inputs. workers:
    processes on this machine; a script that uses several must do so under `if __name__ ==
    "__main__":`; ray: address of a Ray cluster to use instead, "auto" for the one of this machine,
    "local" to start one here; coview must be installed on all its machines. progress: called with
    the number of finished results; ticks: called now and then with the number of calls of `tick` in
    processes, repeated work included.

    Raises the errors of `job`; ValueError if workers is less than 1; WorkLost if work was lost more
    than RETRIES times; ImportError without Ray; ConnectionError if no cluster answers."""
    if workers < 1 or workers != int(workers):
        rule = "at least 1" if workers < 1 else "a whole number"
        raise ValueError(f"workers must be {rule}, got {workers}")
    if ray is not None:
        results = run_on_ray(job, inputs, ray)
    elif workers == 1:
        results = map(job, inputs)
    else:
        results = _in_processes(job, inputs, workers, ticks or (lambda count: None))
    return _count_results(results, progress)


def tick() -> None:
    """Count a part of a job as done, to show progress of long jobs. Does nothing on Ray."""
    if _ticks is not None:
        with _ticks.get_lock():
            _ticks.value += 1


def _count_results(
    results: Iterator[Value], progress: Callable[[int], None] | None
) -> Iterator[Value]:
    """Yield results, and call `progress`, unless it is None, with their number so far."""
    for count, result in enumerate(results, 1):
        if progress:
            progress(count)
        yield result


def _is_lost(future: Future[Value] | None) -> bool:
    """True if an input has to be handed out again."""
    return future is None or future.cancelled() or isinstance(future.exception(), BrokenProcessPool)


def _in_processes(
    job: Task, inputs: Iterable[Value], workers: int, ticks: Callable[[int], None]
) -> Iterator[Value]:
    """Yield `job(x)` for each of `inputs`, in their order, from processes of this machine.

    ticks: called with the number of calls of `tick` so far. Work of a process that died is
    repeated; raises WorkLost after more than `RETRIES` deaths without a result in between."""
    pickled_job = pickle.dumps(job)
    remaining = iter(inputs)
    # every input without a result; None while no pool has it
    pending: list[tuple[Value, Future[Value] | None]] = []
    deaths = 0  # since there was a result
    yielded_count = 0
    earlier_results = 0  # when a process died last
    ticks_before = 0  # in pools that died
    while True:
        try:
            with _pool(pickled_job, workers) as pool:
                while True:
                    pending.extend(
                        (x, None)
                        for x in islice(remaining, AHEAD_PER_PROCESS * workers - len(pending))
                    )
                    for k, (x, future) in enumerate(pending):
                        pending[k] = x, future or pool.executor.submit(_work, x)
                    if not pending:
                        return
                    _, future = pending[0]
                    assert future is not None
                    while not wait([future], TICK_S).done:
                        ticks(ticks_before + pool.ticks)
                    result = future.result()
                    ticks(ticks_before + pool.ticks)
                    del pending[0]
                    yielded_count += 1
                    yield result
        except BrokenProcessPool:
            pending = [(x, None if _is_lost(future) else future) for x, future in pending]
            lost_inputs = [x for x, future in pending if future is None]
            results = yielded_count + len(pending) - len(lost_inputs)
            deaths = deaths + 1 if results == earlier_results else 1
            earlier_results = results
            if deaths > RETRIES:
                occurrence = f"{deaths} times in a row, at or near input {str(lost_inputs[0])[:60]}"
                script = 'called from a script without `if __name__ == "__main__":`'
                cause = f"out of memory (use fewer workers), or {script}"
                raise WorkLost(f"a worker process died {occurrence}: {cause}") from None
            ticks_before += pool.ticks


@contextmanager
def _pool(pickled: bytes, workers: int) -> "Iterator[_Pool]":
    """Give the block processes with a pickled job, which end immediately if the block raises.

    The last ones are kept for `IDLE_S` seconds: a search repeats the same job, and a process takes
    seconds to begin."""
    with _lock:
        pool = _kept.pop((pickled, workers), None)
    if pool is None:
        _end_kept()
        pool = _Pool(pickled, workers)
    elif pool.idle:
        pool.idle.cancel()
    pool.counter.get_obj().value = 0
    try:
        yield pool
    except BaseException:
        pool.end(at_once=True)
        raise
    _end_kept()
    with _lock:
        _kept[pickled, workers] = pool
    pool.idle = threading.Timer(IDLE_S, _end_kept)
    pool.idle.daemon = True
    pool.idle.start()


class _Pool:
    """Processes with one job.

    Attributes:
        counter: Number of calls of `tick` in all processes.
        executor: Executor of the processes.
        idle: Timer that ends the processes, while they have no work.
    """

    def __init__(self, pickled: bytes, workers: int) -> None:
        """Prepare the processes, which start with the first work.

        pickled: the job; workers: number of processes."""
        # forking would copy the locks of Open3D's and torch's threads
        context = multiprocessing.get_context("spawn")
        # as an argument, a job larger than a pipe's buffer would block this process for ever if a
        # new one died before it read it: in a script without `if __name__ == "__main__":`
        self._folder = tempfile.TemporaryDirectory(prefix="coview-job-")
        job_path = Path(self._folder.name) / "job"
        job_path.write_bytes(pickled)
        # nothing is sent: processes end when the writing end is closed (`_end_after`)
        self._reader, self._writer = context.Pipe(duplex=False)
        self.counter = context.Value("q")  # an integer of 64 bits, with a lock
        self.executor = ProcessPoolExecutor(
            workers, context, _start_worker, (job_path, self._reader, self.counter)
        )
        self.idle: threading.Timer | None = None

    @property
    def ticks(self) -> int:
        """Number of calls of `tick`."""
        # without the lock, which a process may have been killed with
        return int(self.counter.get_obj().value)

    def end(self, at_once: bool = False) -> None:
        """End the processes, in mid-work if `at_once`."""
        if self.idle:
            self.idle.cancel()
        if at_once:
            self._writer.close()
        self.executor.shutdown(cancel_futures=True)
        self._reader.close()
        self._writer.close()
        self._folder.cleanup()


_kept: dict[tuple[bytes, int], _Pool] = {}  # one at most
_lock = threading.Lock()


def _end_kept() -> None:
    """End the processes that wait for a job."""
    with _lock:
        pools = list(_kept.values())
        _kept.clear()
    for pool in pools:
        pool.end()


_job: Task
_ticks: Value = None  # a number that all workers of a pool count up; None in other processes


def _start_worker(job_path: Path, parent: Connection, ticks: Value) -> None:
    """Prepare a process of a pool: its job, and its end with its parent's.

    job_path: file of the pickled job; parent: pipe that closes when the parent ends; ticks: number
    of calls of `tick`, which the pool's processes share."""
    global _job, _ticks
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_after, args=(parent,), daemon=True).start()
    keep_freed_memory()
    _job = pickle.loads(job_path.read_bytes())
    _ticks = ticks


def _end_after(parent: Connection) -> None:
    """End this process when the other end of the pipe is closed."""
    with suppress(EOFError, OSError):
        # nothing is ever sent: it returns when the other end is closed, or its process killed
        parent.recv()
    os._exit(1)


def _work(x: Value) -> Value:
    """Result of this process's job for one input."""
    return _job(x)
