"""Results are those of a plain loop in processes and on Ray, and lost work is done again."""

import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from toolkit.runtime import parallel as processes
from toolkit.runtime.parallel import (
    MAX_KEPT_BYTES,
    RETRIES,
    WorkLost,
    keep_freed_memory,
    return_freed_memory,
    spread,
    tick,
    tune_allocation,
)


def square(x: int) -> int:
    if x == 13:
        raise ValueError("unlucky")
    return x * x


@dataclass(frozen=True)
class DiesOnce:
    """Squares, but the first process that gets `victim` is killed over it; `big` is what a scene
    would be."""

    folder: Path
    victim: int
    big: bytes = bytes(1_000_000)

    def __call__(self, x: int) -> int:
        mark = self.folder / "killed"
        if x == self.victim and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return x * x


def test_a_loop_is_serial_lazy_and_the_same_in_processes():
    seen: list[int] = []
    results = spread(square, iter(range(1, 5)), progress=seen.append)
    assert next(results) == 1
    assert seen == [1]
    assert list(results) == [4, 9, 16]
    assert seen == [1, 2, 3, 4]
    assert list(spread(square, [])) == []
    seen.clear()
    results = spread(square, iter([3, 1, 2, 5, 4, 6, 7, 13, 8]), workers=2, progress=seen.append)
    assert [next(results) for _ in range(7)] == [9, 1, 4, 25, 16, 36, 49]
    assert seen == list(range(1, 8))
    with pytest.raises(ValueError, match="unlucky"):
        next(results)
    assert list(spread(square, [], workers=2)) == []


@dataclass(frozen=True)
class Ticks:
    """Ticks twice for each input; the first process that gets 2 is killed over it, in between."""

    folder: Path

    def __call__(self, x: int) -> int:
        tick()
        if x == 2 and not (self.folder / "killed").exists():
            (self.folder / "killed").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        tick()
        time.sleep(0.3)
        return x


def test_ticks_are_told_while_work_goes_on_and_over_a_death(tmp_path):
    told: list[int] = []
    assert list(spread(Ticks(tmp_path), range(6), workers=2, ticks=told.append)) == list(range(6))
    assert told == sorted(told)
    assert 12 <= told[-1] <= 20  # what the processes had at hand when one died is done again
    told.clear()
    assert list(spread(Ticks(tmp_path), range(3), workers=2, ticks=told.append)) == list(range(3))
    assert told[-1] == 6
    tick()  # nobody listens


def worker(_: int) -> int:
    return os.getpid()


def test_the_same_job_finds_its_processes_waiting(tmp_path, limits):
    limits(processes, IDLE_S=1.5)
    known = set[int]().union(*(spread(worker, range(8), workers=2) for _ in range(3)))
    assert len(known) <= 2  # new ones each time would be three; either may do all of one job
    assert list(spread(square, [2], workers=2)) == [4]
    for process in known:
        assert ends(process)
    last = set(spread(worker, range(8), workers=2))
    assert all(ends(process) for process in last)  # when nothing came for a while
    os.kill(set(spread(worker, range(8), workers=2)).pop(), signal.SIGKILL)
    assert len(list(spread(worker, range(8), workers=2))) == 8


def ends(process: int) -> bool:
    for _ in range(150):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        stat = Path(f"/proc/{process}/stat")
        if stat.exists() and stat.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.1)
    return False


def test_nobody_is_left_and_lost_work_is_done_again(tmp_path):
    results = spread(time.sleep, [0.0, 36000.0, 36000.0], workers=2)
    next(results)
    assert isinstance(results, Generator)
    results.close()  # which returns at once, or never
    assert list(spread(DiesOnce(tmp_path, 5), range(9), workers=2)) == [x * x for x in range(9)]
    assert (tmp_path / "killed").exists()
    with pytest.raises(
        WorkLost, match=f"died {RETRIES + 1} times in a row, at or near input 7"
    ) as error:
        list(spread(os._exit, [7], workers=2))
    assert "\n" not in str(error.value)
    assert isinstance(error.value, RuntimeError)


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, signal, sys\n"
        "from toolkit.runtime.parallel import spread\n"
        "class Job:\n"
        "    def __call__(self, x):\n"
        "        import os, time\n"
        "        if x: time.sleep(60)\n"
        "        return os.getpid()\n"
        "if __name__ == '__main__':\n"
        "    print(next(spread(Job(), [0, 1, 1], workers=2)), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    root = Path(__file__).parents[3]
    told = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    assert ends(int(told.stdout)), "the worker outlived its parent"


def test_a_large_job_of_a_script_without_a_guard_is_refused(tmp_path):
    """Its processes die while they import the script, before they read their job."""
    script = tmp_path / "unguarded.py"
    script.write_text(
        "from functools import partial\n"
        "from toolkit.runtime.parallel import spread\n"
        "print(list(spread(partial(max, b'x' * 200_000), [b'y'], workers=2)))\n"
    )
    root = Path(__file__).parents[3]
    told = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=100,
        env={**os.environ, "PYTHONPATH": str(root), "TMPDIR": str(tmp_path)},
    )
    assert told.returncode == 1
    assert 'without `if __name__ == "__main__":`' in told.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == [script]


def test_wrong_numbers_and_missing_ray_are_told_in_one_line(without_packages):
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        spread(square, [1], workers=0)
    without_packages("ray")
    with pytest.raises(ImportError, match=r"pip install coview\[scale\]"):
        next(spread(square, [1], ray="auto"))


COUNTS = """
import resource, sys
import numpy as np
from toolkit.runtime.parallel import keep_freed_memory

def faults(count, size):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(count):
        several = [np.ones(size, np.uint8) for _ in range(4)]
        del several
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

kept = keep_freed_memory() if sys.argv[1] == "keep" else None
faults(2, 12 << 20)
print(kept, faults(20, 12 << 20))
"""
OWN = {"MALLOC_TRIM_THRESHOLD_": "131072"}


def counted(how, **environment):
    clean = {
        name: value for name, value in os.environ.items() if name not in processes.MALLOC_SETTINGS
    }
    command = [sys.executable, "-c", COUNTS, how]
    done = subprocess.run(
        command, env=clean | environment, capture_output=True, text=True, check=True, timeout=60
    )
    kept, faults = done.stdout.split()
    return kept, int(faults)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_arrays_come_to_lie_where_others_lay():
    kept, few = counted("keep")
    _, many = counted("leave")
    assert kept == "True"
    assert many > 1000
    assert few < many / 20


def test_the_environment_wins_and_needs_a_cluster():
    assert counted("keep", **OWN)[0] == "False"
    pytest.importorskip("ray")
    with pytest.raises(ConnectionError, match="ray start --head") as error:
        next(spread(square, [1], ray="127.0.0.1:1"))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "library", [None, object(), type("Refuses", (), {"mallopt": staticmethod(lambda *_: 0)}), "c"]
)
def test_freed_memory_is_kept_where_the_library_can(library):
    asked = []

    def mallopt(*what):
        asked.append(what)
        return 1

    there = library == "c"
    library = type("Library", (), {"mallopt": staticmethod(mallopt)}) if there else library
    assert tune_allocation(library, {"HOME": "/"}) == there
    assert asked == [(-3, MAX_KEPT_BYTES), (-1, 2**31 - 1)] * there
    for name in processes.MALLOC_SETTINGS:
        assert not tune_allocation(library, {"HOME": "/", name: "1"})
    assert len(asked) == 2 * there


def test_the_c_library_is_asked_once():
    keep_freed_memory()
    before = keep_freed_memory.cache_info().misses
    keep_freed_memory()
    assert keep_freed_memory.cache_info().misses == before


@dataclass
class Stuck:
    """Squares, noting in a file on which node and in which process each was begun.

    On one node it never ends, and on others not before that one has begun.
    """

    log: Path
    node: str

    def __call__(self, x: int) -> int:
        import ray

        node = ray.get_runtime_context().get_node_id()
        with self.log.open("a") as file:
            file.write(f"{x} {node} {os.getpid()}\n")
        if node == self.node:
            time.sleep(3600)
        while self.node not in self.log.read_text():
            time.sleep(0.01)
        return x * x


@pytest.mark.slow
def test_ray_gives_what_a_loop_gives_also_of_killed_work(two_nodes, tmp_path):
    cluster, _ = two_nodes
    assert list(spread(square, range(12), ray=cluster.address)) == [x * x for x in range(12)]
    with pytest.raises(ValueError, match=r"^unlucky$"):
        list(spread(square, [1, 13, 2], ray=cluster.address))
    cluster, _ = two_nodes
    assert list(spread(DiesOnce(tmp_path, 5), range(9), ray=cluster.address)) == [
        x * x for x in range(9)
    ]
    assert (tmp_path / "killed").exists()


@pytest.mark.slow
def test_ray_goes_on_when_one_of_two_nodes_is_killed_in_mid_run(two_nodes, tmp_path):
    cluster, second = two_nodes
    log = tmp_path / "begun"

    def kill_second() -> None:  # as when the power fails, when it has begun to work
        while not (there := [int(pid) for _, node, pid in begun(log) if node == second.node_id]):
            time.sleep(0.01)
        for pid in (second.all_processes["raylet"][0].process.pid, *there):
            os.kill(pid, signal.SIGKILL)

    threading.Thread(target=kill_second, daemon=True).start()
    assert list(spread(Stuck(log, second.node_id), range(30), ray=cluster.address)) == [
        x * x for x in range(30)
    ]
    numbers = [x for x, _, _ in begun(log)]
    assert len(numbers) > len(set(numbers)) == 30  # something was done again


def begun(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text().splitlines()] if log.exists() else []


@pytest.mark.slow
def test_a_cluster_of_this_machine_alone():
    pytest.importorskip("ray")
    assert list(spread(square, range(5), ray="local")) == [0, 1, 4, 9, 16]


def test_freed_memory_goes_back_where_the_c_library_can():
    asked = []
    for library in (SimpleNamespace(malloc_trim=asked.append), SimpleNamespace(), None):
        return_freed_memory(library)
    assert asked == [0]
