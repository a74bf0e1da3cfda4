"""Searches that are killed and go on: the same answer as without the kill, and states that are not
believed."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from placement_env.search import cmaes, greedy, swap
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.checkpoint_folder import NOWHERE, open_checkpoint
from placement_env.search.portfolio.entrants import Effort, find_entrants
from placement_env.search.progress import Limits, Progress
from placement_env.setting import Weights


class Killed(BaseException):
    """Stands for SIGKILL."""


class Mortal(Checkpoint):
    def __init__(self, folder, lives):
        super().__init__(folder, every=0.0)
        self.lives = lives

    def offer(self, state):
        super().offer(state)
        self.lives -= 1
        if self.lives == 0:
            raise Killed


def answer(found):
    rows = (found.best, found.certificate, found.evaluations, found.front, found.sensors)
    return *rows, found.history.reward.tolist(), found.history.evaluations.tolist()


def killed_each(way, folder, lives):
    for kills in range(1000):
        try:
            return way(checkpoint=Mortal(folder, lives)), kills
        except Killed:
            continue
    raise AssertionError("it never ends")


def posed(way, make, **settings):
    """A continuous search from a set, towards poses that are known."""
    start, any_score = make(4, 1).candidates.select([0, 2]), make(3, 1).score([0])

    def place(sets):
        off = [
            np.abs(np.array([cmaes.angles(s) for s in chosen]) - [6.0, 0.4, 0.3]).sum()
            for chosen in sets
        ]
        return [replace(any_score, ap=float(np.exp(-o)), reward=float(np.exp(-o))) for o in off]

    return partial(way, place, start, seed=4, **settings)


@pytest.mark.parametrize("name", ["swap", "cmaes"])
def test_killed_again_and_again_it_gives_the_same_answer(make, tmp_path, name):
    if name == "cmaes":
        pytest.importorskip("cma")
        way = posed(cmaes.improve, make, evaluations=200)
    else:
        way = partial(
            swap.search,
            make(8, 3, views=2, most=0.3, weights=Weights(price=0.01)),
            4,
            seed=2,
            starts=6,
        )
    whole = way()
    found, kills = killed_each(way, tmp_path, 4)
    assert kills > 2
    assert answer(found) == answer(whole)


def test_the_incumbent_is_known_again(make):
    objective = make(4, 2)
    progress, again = (Progress(objective, 2, None, None) for _ in range(2))
    progress.rewards(np.eye(8, dtype=bool))
    again.resume(progress.state())
    assert (again.reward, again.best.tolist()) == (progress.reward, progress.best.tolist())
    assert again.result("x", again.unknown("")).best.cache_hit


def test_values_come_back(tmp_path):
    checkpoint = Checkpoint(tmp_path, depends_on=b"q")
    assert checkpoint.load() is None
    state = {
        "a": [1, {"b": -np.inf}],
        "rng": np.random.default_rng(1).bit_generator.state,
        "x": np.eye(2, dtype=bool),
    }
    checkpoint.save(state)
    back = checkpoint.load()
    assert back is not None
    assert (back["a"], back["rng"]) == (state["a"], state["rng"])
    assert back["x"].dtype == bool
    assert np.array_equal(back["x"], np.eye(2))
    back["x"][0, 0] = False  # it is ours
    assert checkpoint.part("other").load() is None
    assert Checkpoint(tmp_path, depends_on=b"another").load() is None


def test_states_are_saved_as_often_as_asked(tmp_path):
    checkpoint = Checkpoint(tmp_path, every=60.0)
    checkpoint.offer(lambda: pytest.fail("too early"))
    checkpoint.every = 0.0
    checkpoint.offer(lambda: {"a": 1})
    assert checkpoint.load() == {"a": 1}
    checkpoint.every = 60.0
    checkpoint.offer(lambda: pytest.fail("too early"))


def test_nothing_is_kept_nowhere():
    NOWHERE.offer(lambda: pytest.fail("nowhere"))
    NOWHERE.save({"a": 1})
    assert NOWHERE.load() is None


def test_limits_resume_count_time_and_rows():
    limits = Limits(100.0, 50)
    limits.resume({"count": 20, "elapsed": 60.0, "rows": [[3, 1.5, 0.25]]})
    assert limits.count == 20
    assert limits.elapsed >= 60.0
    assert limits.rows == [(3, 1.5, 0.25)]


def test_a_state_of_another_folder_is_not_believed(tmp_path):
    for name in "ab":
        Checkpoint(tmp_path / name).save({"a": name})
    (tmp_path / "a" / "search.state").replace(tmp_path / "b" / "search.state")
    assert Checkpoint(tmp_path / "b").load() is None


DAMAGES = [lambda b: b[:-1], lambda b: b"", lambda b: b[:20] + b"\x00" + b[21:], lambda b: b * 2]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_state_is_not_believed(tmp_path, damage):
    checkpoint = Checkpoint(tmp_path)
    checkpoint.save({"a": 1, "x": np.arange(50.0)})
    path = tmp_path / "search.state"
    path.write_bytes(damage(path.read_bytes()))
    assert checkpoint.load() is None


def left_unfinished(folder, question):
    try:
        with open_checkpoint(folder, question) as checkpoint:
            checkpoint.save({"a": 1})
            checkpoint.place("own").mkdir()
            raise Killed
    except Killed:
        pass


def test_unfinished_searches_go_when_they_end_or_another_is_asked(tmp_path):
    folder = tmp_path / "out.parts"
    left_unfinished(folder, {"seed": 1, "most": np.inf})
    with open_checkpoint(folder, {"seed": 1, "most": np.inf}) as checkpoint:
        assert checkpoint.load() == {"a": 1}
        with pytest.raises(FileExistsError, match="another run is writing"):
            left_unfinished(folder, {"seed": 1})
    assert not folder.exists()
    folder = tmp_path / "out.parts"
    left_unfinished(folder, {"seed": 1})
    with pytest.raises(FileExistsError, match="made from seed 1 instead of 2"):
        left_unfinished(folder, {"seed": 2})
    with open_checkpoint(folder, {"seed": 2}, overwrite=True) as checkpoint:
        assert checkpoint.load() is None


def test_the_searches_of_a_portfolio_are_not_run_twice(street, tmp_path, monkeypatch):
    ran = []
    for module in (greedy, swap):
        search = module.search

        def counted(*args, search=search, name=module.__name__, **kwargs):
            ran.append(name)
            if len(ran) == 4:
                raise Killed
            return search(*args, **kwargs)

        monkeypatch.setattr(module, "search", counted)
    effort = Effort((1, 2, 3))
    with pytest.raises(Killed):
        find_entrants(street.objective, effort, checkpoint=Checkpoint(tmp_path))
    before = list(ran)
    again = find_entrants(street.objective, effort, checkpoint=Checkpoint(tmp_path))
    after = ran[len(before) :]
    whole = find_entrants(street.objective, effort)
    assert before[:3] + after == ran[len(before) + len(after) :]
    assert np.array_equal(again.sets, whole.sets)
    assert (again.searches, again.considered) == (whole.searches, whole.considered)
    assert again.predicted.tolist() == whole.predicted.tolist()


SCRIPT = """
import sys
from functools import partial
from pathlib import Path
sys.path.insert(0, "tests/placement_env")
from conftest import random_objective
from placement_env.search import swap
from placement_env.search.checkpoint import Checkpoint
checkpoint = Checkpoint(Path(sys.argv[1]), every=0.0)
print("ready", flush=True)
found = swap.search(random_objective(8, 3, views=2), 3, seed=1, evaluations=3000, checkpoint=checkpoint)
print(found.best.subset, found.evaluations, found.history.reward.tolist())
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL here")
def test_killed_by_the_system_in_the_middle(make, tmp_path):
    def start():
        return subprocess.Popen(
            [sys.executable, "-c", SCRIPT, str(tmp_path)], stdout=subprocess.PIPE, text=True
        )

    killed = start()
    assert killed.stdout.readline() == "ready\n"
    state = tmp_path / "search.state"
    while not state.exists() or state.stat().st_size == 0:
        assert killed.poll() is None
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    out, _ = start().communicate(timeout=120)
    whole = swap.search(make(8, 3, views=2), 3, seed=1, evaluations=3000)
    assert (
        out == f"ready\n{whole.best.subset} {whole.evaluations} {whole.history.reward.tolist()}\n"
    )
