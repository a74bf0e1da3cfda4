"""One function over many inputs: in this process, in several on this machine, or on a Ray cluster.

The results are the same everywhere. Work that a process or a machine had begun when it died is
repeated."""

import os
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from itertools import islice

from toolkit.runtime.process_pool import Task, Value, borrow_pool

RETRIES = 3  # when work is lost
AHEAD_PER_CORE = 8  # inputs handed out per core: tasks travel farther, and nodes may join
AHEAD_PER_PROCESS = 4  # inputs handed out per process
TICK_S = 0.2  # between two looks at the ticks


class WorkLost(RuntimeError):
    """A worker died, perhaps through no fault of input or code.

    Finished work is kept: start again."""


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
    home: Callable[[Value], int] | None = None,
    progress: Callable[[int], None] | None = None,
    ticks: Callable[[int], None] | None = None,
) -> Iterator[Value]:
    """Yield `job(x)` for each of `inputs`, in their order.

    job: a function of a module, or an object that can be called and pickled; store large constants
    in it, since each process gets it once. Its results must not depend on earlier inputs. workers:
    processes on this machine; a script that uses several must do so under `if __name__ ==
    "__main__":`; ray: address of a Ray cluster to use instead, "auto" for the one of this machine,
    "local" to start one here; coview must be installed on all its machines. home: from an input
    to a number; a process of this machine gets the inputs with the same number, as it may have kept
    what they need; None to hand out each to the process with the least work. progress: called with
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
        results = _in_processes(job, inputs, workers, home, ticks or (lambda count: None))
    return _count_results(results, progress)


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
    job: Task,
    inputs: Iterable[Value],
    workers: int,
    home: Callable[[Value], int] | None,
    ticks: Callable[[int], None],
) -> Iterator[Value]:
    """Yield `job(x)` for each of `inputs`, in their order, from processes of this machine.

    home: from an input to the number of its process, None if it does not matter; ticks: called with
    the number of calls of `tick` so far. Work of a process that died is
    repeated; raises WorkLost after more than `RETRIES` deaths without a result in between."""
    remaining = iter(inputs)
    # every input without a result; None while no pool has it
    pending: list[tuple[Value, Future[Value] | None]] = [(x, None) for x in islice(remaining, 1)]
    deaths = 0  # since there was a result
    yielded_count = 0
    earlier_results = 0  # when a process died last
    ticks_before = 0  # in pools that died
    while pending:
        try:
            with borrow_pool(job, workers) as pool:
                while True:
                    pending.extend(
                        (x, None)
                        for x in islice(remaining, AHEAD_PER_PROCESS * workers - len(pending))
                    )
                    for k, (x, future) in enumerate(pending):
                        pending[k] = x, future or pool.submit(x, home and home(x))
                    _, future = pending[0]
                    assert future is not None
                    while not wait([future], TICK_S).done:
                        ticks(ticks_before + pool.ticks)
                    result = future.result()
                    ticks(ticks_before + pool.ticks)
                    del pending[0]
                    yielded_count += 1
                    pending.extend((x, None) for x in islice(remaining, 0 if pending else 1))
                    if not pending:
                        break  # the pool is free before a caller who takes no more can end it
                    yield result
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
