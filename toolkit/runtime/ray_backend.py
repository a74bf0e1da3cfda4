"""One function over many inputs on a Ray cluster; `toolkit.runtime.parallel.spread` is the way in."""

from __future__ import annotations

import os
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any

from toolkit.runtime.lost import WorkLost

RETRIES = 3  # how often work that was lost is done again
AHEAD_PER_CORE = 8  # inputs handed out per core: tasks travel farther, and nodes may join


def on_ray(job: Callable[[Any], Any], inputs: Iterable[Any], address: str) -> Iterator[Any]:
    """Ray's scheduler gives tasks to nodes, and gives them again when a worker or a node is lost."""
    ray = _connected(address)
    pending: deque[Any] = deque()
    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_work_on_ray)
        shared, remaining = ray.put(job), iter(inputs)
        ahead = AHEAD_PER_CORE * max(1, int(ray.cluster_resources().get("CPU", 1)))
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
