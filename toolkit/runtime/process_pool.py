"""Processes of this machine that wait for jobs and keep what jobs have in common.

A process gets a job once, and an object that is `SentOnce` once for all jobs that refer to it."""

import io
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from toolkit.runtime.allocation import keep_freed_memory
from toolkit.runtime.sent_once import SentOnce

Value = Any  # an input or result of a job
Task = Callable[[Value], Value]
IDLE_S = 20.0  # before processes without a job end


class ProcessPool:
    """Processes that work on one job after another.

    Attributes:
        counter: Number of calls of `tick` in all processes.
        idle: Timer that ends the processes, while they have no work.
    """

    def __init__(self, workers: int) -> None:
        """Prepare the processes, which start with the first work.

        workers: number of processes."""
        # forking would copy the locks of Open3D's and torch's threads
        context = multiprocessing.get_context("spawn")
        # as an argument, a job larger than a pipe's buffer would block this process for ever if a
        # new one died before it read it: in a script without `if __name__ == "__main__":`
        self._folder = tempfile.TemporaryDirectory(prefix="coview-job-")
        folder = Path(self._folder.name)
        self._objects = _SentObjects(folder)
        self._job_path = folder / "job"
        self._job_bytes = b""
        self._job_number = 0
        # nothing is sent: processes end when the writing end is closed (`_end_after`)
        self._reader, self._writer = context.Pipe(duplex=False)
        self.counter = context.Value("q")  # an integer of 64 bits, with a lock
        threads = max(1, (os.cpu_count() or 1) // workers)
        arguments = (folder, self._reader, self.counter, threads)
        # one process each, so that an input can go to the process that keeps what it needs
        self._executors = [
            ProcessPoolExecutor(1, context, _start_worker, arguments) for _ in range(workers)
        ]
        # unfinished inputs without a home, by process
        self._futures: list[list[Future[Value]]] = [[] for _ in range(workers)]
        self.idle: threading.Timer | None = None

    @property
    def ticks(self) -> int:
        """Number of calls of `tick`."""
        # without the lock, which a process may have been killed with
        return int(self.counter.get_obj().value)

    def take_job(self, job: Task) -> None:
        """Let the processes work on a job, which must be pickled; no other may be in work."""
        job_bytes = self._objects.dump(job)
        if job_bytes != self._job_bytes:
            self._job_number += 1
            self._job_bytes = job_bytes
            self._job_path.write_bytes(pickle.dumps(self._objects.live_numbers) + job_bytes)
        self.counter.get_obj().value = 0

    def submit(self, x: Value, home: int | None = None) -> Future[Value]:
        """Begin to compute the job's result for an input.

        home: number of the process that computes it, counted on from the first after the last;
        None for that with the least work."""
        if home is not None:
            return self._executors[home % len(self._executors)].submit(_work, self._job_number, x)
        number = min(range(len(self._executors)), key=self._count_unfinished)
        future = self._executors[number].submit(_work, self._job_number, x)
        self._futures[number].append(future)
        return future

    def _count_unfinished(self, number: int) -> int:
        """Inputs that a process works on or waits for, by its number; finished ones are dropped."""
        self._futures[number] = [future for future in self._futures[number] if not future.done()]
        return len(self._futures[number])

    def end(self, at_once: bool = False) -> None:
        """End the processes, in mid-work if `at_once`."""
        if self.idle:
            self.idle.cancel()
        if at_once:
            self._writer.close()
        for executor in self._executors:
            executor.shutdown(cancel_futures=True)
        self._reader.close()
        self._writer.close()
        self._folder.cleanup()


class _Surroundings(NamedTuple):
    """Settings that processes take over from this one when they start.

    Attributes:
        workers: Number of processes.
        folder: Working folder, empty if it is gone.
        module_folders: `sys.path`.
        environment: Variables of the environment."""

    workers: int
    folder: str
    module_folders: tuple[str, ...]
    environment: frozenset[tuple[str, str]]

    @staticmethod
    def find(workers: int) -> "_Surroundings":
        """Surroundings of processes that start now."""
        folder = ""
        with suppress(FileNotFoundError):
            folder = os.getcwd()
        return _Surroundings(workers, folder, tuple(sys.path), frozenset(os.environ.items()))


_kept: dict[_Surroundings, ProcessPool] = {}  # pool that waits for a job, one at most
_lock = threading.Lock()


@contextmanager
def borrow_pool(job: Task, workers: int) -> Iterator[ProcessPool]:
    """Give the block processes with a job, which end immediately if the block raises.

    The last ones are kept for `IDLE_S` seconds, since a process takes seconds to begin. They are
    used again if new ones would have the same surroundings."""
    surroundings = _Surroundings.find(workers)
    with _lock:
        pool = _kept.pop(surroundings, None)
    if pool is None:
        end_kept()
        pool = ProcessPool(workers)
    elif pool.idle:
        pool.idle.cancel()
    try:
        pool.take_job(job)
        yield pool
    except BaseException:
        pool.end(at_once=True)
        raise
    end_kept()
    with _lock:
        _kept[surroundings] = pool
    pool.idle = threading.Timer(IDLE_S, end_kept)
    pool.idle.daemon = True
    pool.idle.start()


def is_waiting(workers: int) -> bool:
    """True if processes wait for a job, as many as `workers`."""
    return _Surroundings.find(workers) in _kept


def end_kept() -> None:
    """End the processes that wait for a job."""
    with _lock:
        pools = list(_kept.values())
        _kept.clear()
    for pool in pools:
        pool.end()


def tick() -> None:
    """Count a part of a job as done, to show progress of long jobs. Does nothing on Ray."""
    if _ticks is not None:
        with _ticks.get_lock():
            _ticks.value += 1


class _SentObjects:
    """Files of the objects that processes get once, each pickled when a job first refers to it.

    An object's file is removed when the object is gone."""

    def __init__(self, folder: Path) -> None:
        """Begin without objects. folder: folder of their files."""
        self._process = os.getpid()
        self._folder = folder
        self._numbers: dict[int, int] = {}  # by `id` of the object
        self._references: dict[int, weakref.ref[SentOnce]] = {}  # by number
        self._count = 0

    @property
    def live_numbers(self) -> set[int]:
        """Numbers of the objects that are not gone."""
        return set(self._references)

    def dump(self, root: object) -> bytes:
        """Pickle an object, in which others that are `SentOnce` are replaced by their numbers."""
        buffer = io.BytesIO()
        _ReferencePickler(buffer, root, self._number).dump(root)
        return buffer.getvalue()

    def _number(self, sent: SentOnce) -> int:
        """Number of an object, whose file is written if it is new."""
        key = id(sent)
        if key not in self._numbers:
            number = self._count
            self._count += 1
            self._numbers[key] = number
            # called when the object is gone, before another can have its `id`
            self._references[number] = weakref.ref(sent, partial(self._forget, key))
            _object_path(self._folder, number).write_bytes(self.dump(sent))
        return self._numbers[key]

    def _forget(self, key: int, reference: object) -> None:
        """Remove what belongs to an object that is gone. key: its `id`; reference: to nothing."""
        if os.getpid() != self._process:
            return  # in a copy of the process that writes the files
        number = self._numbers.pop(key)
        del self._references[number]
        _object_path(self._folder, number).unlink(missing_ok=True)


class _ReferencePickler(pickle.Pickler):
    """Pickler that writes numbers in the place of objects that are `SentOnce`."""

    def __init__(
        self, file: io.BytesIO, root: object, find_number: Callable[[SentOnce], int]
    ) -> None:
        """Prepare to pickle one object.

        root: the object itself, never replaced; find_number: gives the number of another."""
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._root = root
        self._find_number = find_number

    def persistent_id(self, obj: object) -> int | None:
        if isinstance(obj, SentOnce) and obj is not self._root:
            return self._find_number(obj)
        return None


def _object_path(folder: Path, number: int) -> Path:
    """File of an object that is sent once."""
    return folder / f"object{number}"


class _ReceivedJob:
    """Job of this process, which is one of a pool, and the objects that it was sent once.

    Attributes:
        number: Number of the job that is loaded, 0 for none.
        job: The job."""

    def __init__(self, folder: Path, threads: int) -> None:
        """Begin without a job.

        folder: folder of the pool's files; threads: number of threads of torch."""
        self._folder = folder
        self._threads = threads
        self._objects: dict[int, object] = {}  # by number
        self.number = 0
        self.job: Task = bool

    def load(self, number: int) -> None:
        """Load the job that the pool works on; objects that are gone in its parent go."""
        self.job = bool  # the last one goes before the next is loaded
        with (self._folder / "job").open("rb") as file:
            live_numbers = pickle.load(file)
            self._objects = {n: known for n, known in self._objects.items() if n in live_numbers}
            self.job = self._unpickle(file)
        self.number = number
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(self._threads)

    def _unpickle(self, file: io.BufferedReader) -> Value:
        """Next pickled object of a file, with those that it refers to."""
        unpickler = pickle.Unpickler(file)
        unpickler.persistent_load = self._find_object  # type: ignore[method-assign]
        return unpickler.load()

    def _find_object(self, number: int) -> object:
        """Object that is sent once, loaded when a job first refers to it."""
        if number not in self._objects:
            with _object_path(self._folder, number).open("rb") as file:
                self._objects[number] = self._unpickle(file)
        return self._objects[number]


_received: _ReceivedJob
_ticks: Value = None  # a number that all workers of a pool count up; None in other processes


def _start_worker(folder: Path, parent: Connection, ticks: Value, threads: int) -> None:
    """Prepare a process of a pool: its jobs, and its end with its parent's.

    folder: folder of the pool's files; parent: pipe that closes when the parent ends; ticks: number
    of calls of `tick`, which all processes share; threads: number of threads of libraries."""
    global _received, _ticks
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_after, args=(parent,), daemon=True).start()
    keep_freed_memory()
    # libraries that are not loaded yet read these
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, str(threads))
    _received = _ReceivedJob(folder, threads)
    _ticks = ticks


def _end_after(parent: Connection) -> None:
    """End this process when the other end of the pipe is closed."""
    with suppress(EOFError, OSError):
        # nothing is ever sent: it returns when the other end is closed, or its process killed
        parent.recv()
    os._exit(1)


def _work(number: int, x: Value) -> Value:
    """Compute the result of the job with a number for one input."""
    if _received.number != number:
        _received.load(number)
    return _received.job(x)
