"""Whoever does the work, and whoever dies over it, the results are those of a plain loop."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import pytest

from toolkit.runtime import parallel as processes
from toolkit.runtime.parallel import spread, tick


def square(x: int) -> int:
    if x == 13:
        raise ValueError("unlucky")
    return x * x


@dataclass(frozen=True)
class DiesOnce:
    """Squares, but the first process that gets `victim` is killed over it; `big` is what a scene would be."""

    folder: Path
    victim: int
    big: bytes = bytes(1_000_000)

    def __call__(self, x: int) -> int:
        mark = self.folder / "killed"
        if x == self.victim and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return x * x


def test_serial_is_lazy_and_in_order():
    seen: list[int] = []
    results = spread(square, iter(range(1, 5)), progress=seen.append)
    assert next(results) == 1
    assert seen == [1]
    assert list(results) == [4, 9, 16]
    assert seen == [1, 2, 3, 4]
    assert list(spread(square, [])) == []


def test_processes_give_what_a_loop_gives():
    seen: list[int] = []
    results = spread(square, iter([3, 1, 2, 5, 4, 6, 7, 13, 8]), workers=2, progress=seen.append)
    assert [next(results) for _ in range(7)] == [9, 1, 4, 25, 16, 36, 49]
    assert seen == list(range(1, 8))
    with pytest.raises(ValueError, match="unlucky"):
        next(results)
    assert list(spread(square, [], workers=2)) == []


def test_work_of_a_process_that_is_killed_is_done_again(tmp_path):
    assert list(spread(DiesOnce(tmp_path, 5), range(9), workers=2)) == [x * x for x in range(9)]
    assert (tmp_path / "killed").exists()


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


def test_the_same_job_finds_its_processes_waiting(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "IDLE_S", 1.5)
    known = set[int]().union(*(spread(worker, range(8), workers=2) for _ in range(3)))
    assert len(known) <= 2  # new ones each time would be three; either may do all of one job
    assert list(spread(square, [2], workers=2)) == [4]
    for process in known:
        assert ends(process)
    last = set(spread(worker, range(8), workers=2))
    assert all(ends(process) for process in last)  # when nothing came for a while
    waiting = set(spread(worker, range(8), workers=2))
    os.kill(waiting.pop(), signal.SIGKILL)
    assert len(list(spread(worker, range(8), workers=2))) == 8


def ends(process: int) -> bool:
    for _ in range(150):
        if not is_running(process):
            return True
        time.sleep(0.1)
    return False


def test_nobody_is_left_when_the_rest_is_not_wanted(tmp_path):
    results = spread(time.sleep, [0.0, 36000.0, 36000.0], workers=2)
    next(results)
    assert isinstance(results, Generator)
    results.close()  # which returns at once, or never


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
        [sys.executable, str(script)], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(root)}
    )
    assert ends(int(told.stdout)), "the worker outlived its parent"


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{process}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"


def test_wrong_numbers_and_missing_ray_are_told_in_one_line(monkeypatch):
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        spread(square, [1], workers=0)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install coview\[scale\]"):
        next(spread(square, [1], ray="auto"))
