"""Results are those of a plain loop in processes and on Ray, and lost work is done again."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from toolkit.runtime import process_pool
from toolkit.runtime.parallel import RETRIES, WorkLost, spread
from toolkit.runtime.process_pool import tick
from toolkit.runtime.run import Processes
from toolkit.runtime.sent_once import SentOnce


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


def list_processes(workers: int) -> list[int]:
    """Ids of the processes that do as many jobs, one each."""
    return list(spread(worker, range(workers), workers=workers, home=lambda x: x))


def test_jobs_find_the_processes_of_the_last_one_waiting(limits):
    first = list_processes(2)
    assert len(set(first)) == 2
    assert list(spread(square, [2], workers=2)) == [4]
    assert list_processes(2) == first
    limits(process_pool, IDLE_S=1.5)
    last = list_processes(3)
    assert len({*first, *last}) == 5
    assert all(ends(process) for process in first)  # only the last ones wait
    assert all(ends(process) for process in last)  # when nothing came for a while


def test_a_killed_process_that_waited_is_replaced():
    os.kill(list_processes(2)[0], signal.SIGKILL)
    assert len(set(list_processes(2))) == 2


@pytest.mark.parametrize("change", ["folder", "module folder", "environment"])
def test_processes_with_other_surroundings_are_new(change, tmp_path, monkeypatch):
    first = list_processes(2)
    if change == "folder":
        monkeypatch.chdir(tmp_path)
    elif change == "module folder":
        monkeypatch.syspath_prepend(tmp_path)
    else:
        monkeypatch.setenv("COVIEW_TEST", "1")
    assert not set(list_processes(2)) & set(first)


def test_processes_wait_after_a_caller_that_took_the_last_result_only():
    results = spread(worker, range(2), workers=2, home=lambda x: x)
    first = [next(results), next(results)]
    assert list_processes(2) == first
    assert list(results) == []


def test_quick_work_starts_no_processes():
    run = Processes(workers=2)
    process_pool.end_kept()
    assert set(run.map(worker, range(3), is_quick=True)) == {os.getpid()}
    started = list_processes(2)
    assert set(run.map(worker, range(8), is_quick=True)) <= set(started)


def test_inputs_with_the_same_home_are_of_one_process():
    processes = list(spread(worker, range(12), workers=2, home=lambda x: x // 3))
    by_home = [set(processes[home * 3 : home * 3 + 3]) for home in range(4)]
    assert [len(same) for same in by_home] == [1, 1, 1, 1]
    assert by_home[0] == by_home[2] != by_home[1] == by_home[3]


class Counter(SentOnce):
    """Counts how often it was called in a process; `inner` is sent once too."""

    def __init__(self, inner: "Counter | None" = None) -> None:
        self.calls = 0
        self.inner = inner

    def __call__(self) -> int:
        self.calls += 1
        return self.calls


def count_calls(counter: Counter, step: int, x: int) -> int:
    return step * counter()


def count_inner(counter: Counter, x: int) -> int:
    assert counter.inner is not None
    return counter.inner()


def test_what_jobs_share_stays_in_their_processes():
    inner = Counter()
    outer = Counter(inner)
    homes = {"workers": 2, "home": lambda x: 0}
    assert list(spread(partial(count_calls, inner, 1), range(3), **homes)) == [1, 2, 3]
    assert list(spread(partial(count_calls, inner, 10), range(2), **homes)) == [40, 50]
    assert list(spread(partial(count_inner, outer), range(2), **homes)) == [6, 7]
    assert list(spread(partial(count_calls, Counter(), 1), range(2), **homes)) == [1, 2]
    assert inner.calls == 0


def live_objects(count: int, x: int) -> int:
    return len(process_pool._received._objects)


def test_what_is_gone_goes_in_processes_too():
    inner = Counter()
    assert list(spread(partial(count_inner, Counter(inner)), [0], workers=2)) == [1]
    (pool,) = process_pool._kept.values()
    assert list(spread(partial(live_objects, 0), [0], workers=2, home=lambda x: 0)) == [1]
    del inner
    assert pool._objects.live_numbers == set()
    assert list(spread(partial(live_objects, 1), [0], workers=2, home=lambda x: 0)) == [0]
    assert not list(Path(pool._folder.name).glob("object*"))


def threads(x: int) -> tuple[str, int]:
    import torch

    return os.environ["OMP_NUM_THREADS"], torch.get_num_threads()


def test_processes_share_the_cores(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    process_pool.end_kept()
    expected = max(1, (os.cpu_count() or 1) // 2)
    assert list(spread(threads, [0], workers=2)) == [(str(expected), expected)]
    process_pool.end_kept()


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


def test_a_cluster_that_does_not_answer_is_told_in_one_line_and_soon(spy):
    pytest.importorskip("ray")
    connections = spy("socket", "create_connection")
    with pytest.raises(ConnectionError, match="ray start --head") as error:
        next(spread(square, [1], ray="127.0.0.1:1"))
    assert "\n" not in str(error.value)
    (connection,) = connections
    assert connection.args == (("127.0.0.1", 1),)
    assert 0 < connection.named["timeout"] <= 10  # s; an address may also be silent


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
