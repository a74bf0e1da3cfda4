"""How a portfolio divides its time, on evaluators that take as long as they are said to."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.analysis.case_figures import CaseFigures
from placement_env.search.portfolio.schedule import Schedule, TimedEvaluator
from toolkit.runtime.run import Run

SETS = np.eye(3, dtype=bool)


class Slow:
    """AP of a set: its number, and how many frames it was evaluated on. seconds: for a frame that
    is new."""

    name, frames = "slow", 40

    def __init__(self, seconds=0.0):
        self.seconds, self.known, self.asked = seconds, set(), []

    def count_objects(self, frames):
        return 3 * len(frames)

    def evaluate(self, sets, frames, progress=None):
        new = set(frames.tolist()) - self.known
        time.sleep(self.seconds * len(new))
        self.known |= new
        self.asked.append(frames.tolist())
        ap = sets.argmax(axis=1) + len(frames) / 100
        return CaseFigures.from_ap(ap, 0.0, np.repeat(ap[:, None], 4, axis=1))


def test_an_evaluator_goes_on_until_time_is_up():
    slow = Slow(0.02)
    timed = TimedEvaluator(slow, time.monotonic() + 0.15)
    assert timed.frames == 40
    done = []
    found = timed.evaluate(SETS, np.arange(40)[::-1], done.append)
    assert found.used is not None
    assert 1 <= found.used <= 8
    assert done == list(range(1, found.used + 1))
    assert found.ap == pytest.approx(np.arange(3) + found.used / 100)
    assert slow.known == set(range(40 - found.used, 40))
    again = timed.evaluate(SETS[:1], np.arange(40)[::-1])  # time is up, what was done stays
    assert again.used == found.used
    assert len(slow.known) == found.used


def test_without_time_one_part_is_done():
    slow = Slow()
    timed = TimedEvaluator(slow, time.monotonic() - 1, frames_between_looks=4)
    assert timed.evaluate(SETS, np.arange(10)).used == 4
    assert slow.asked == [[0, 1, 2, 3], [0, 1, 2, 3]]
    assert (
        TimedEvaluator(Slow(), time.monotonic() - 1, min_frames=7)
        .evaluate(SETS, np.arange(10))
        .used
        == 7
    )


def test_frames_are_evaluated_a_few_at_once():
    slow = Slow()
    timed = TimedEvaluator(slow, time.monotonic() + 60, frames_between_looks=3)
    assert timed.evaluate(SETS, np.arange(4)).used is None
    assert timed.evaluate(SETS, np.arange(8)).used is None
    assert slow.asked == [[0, 1, 2], [3], [0, 1, 2, 3], [4, 5, 6], [7], list(range(8))]
    assert timed.evaluate(SETS, np.arange(4)).used is None
    assert slow.asked[-1] == [0, 1, 2, 3]


def test_less_time_is_fewer_frames():
    assert [
        Schedule(seconds).limit_frames(96)
        for seconds in (None, 500.0, 120.0, 60.0, 33.0, 20.0, 1.0)
    ] == [96, 96, 96, 48, 24, 16, 8]
    assert Schedule(1.0).limit_frames(6) == 6
    cluster = SimpleNamespace(ray="local", has_one_process=False, count=1)
    runs = (Run(), Run(workers=4), cluster)
    assert [Schedule.from_processes(9.0, run).frames_between_looks for run in runs] == [1, 8, 16]


def test_searches_races_and_judgement_share_the_time():
    whole, slow = Schedule(100.0), Slow()
    assert whole.search_seconds(5) == pytest.approx(6.0)
    now, least = time.monotonic(), []
    for each, seconds in (
        *(
            (whole.limit(slow, 1 / 2, 1), 50),
            (whole.limit(slow, 1 / 4, 1), 25),
            (whole.limit(slow), 100),
        ),
    ):
        assert isinstance(each, TimedEvaluator)
        assert each.end_s - now == pytest.approx(seconds, abs=1)
        least.append(each.min_frames)
    assert least == [1, 1, 8]
    free = Schedule()
    assert (free.search_seconds(5), free.remaining_s) == (None, np.inf)
    assert vars(free.limit(slow)) is vars(slow)


def test_from_two_minutes_on_all_frames_are_simulated():
    assert [Schedule(seconds).limit_frames(97) for seconds in (120.0, 119.0)] == [97, 96]
    assert (
        Schedule(9.0).frames_between_looks,
        TimedEvaluator(Slow(), 0.0).frames_between_looks,
    ) == (1, 1)
