"""Threads of the live page: the order of jobs, drags that overtake themselves, and faults that are
said."""

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from coview.live_jobs import LATE_S, LiveJobs, Refining


class Head:
    """Head of a panel that nobody sees."""

    def __init__(self):
        self.note, self.busy, self.shown = "", "", []

    def say(self, note):
        self.note = note

    def begin(self, what):
        self.busy = what

    def end(self):
        self.busy = ""

    def show_note(self):
        self.shown.append((self.busy, self.note))


@pytest.fixture
def done():
    return []


@pytest.fixture
def head():
    return Head()


@pytest.fixture
def jobs(done, head):
    jobs = LiveJobs(
        head,
        show=lambda answer: done.append(f"show {answer}"),
        redraw=lambda: done.append("redraw"),
        draw_rest=lambda: done.append("rest"),
    )
    yield jobs
    jobs.close()


def run(jobs, refine=lambda: None):
    jobs.start(lambda: None, refine)


def wait_for(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_jobs_are_done_in_order_and_only_the_last_position_of_a_drag(jobs, done):
    jobs.drag(lambda: done.append("drag 1"), last=False)
    jobs.drag(lambda: done.append("drag 2"), last=False)
    jobs.do(lambda: done.append("job"))
    jobs.change(lambda first, second: first + second, 1, 2)
    assert jobs.waiting == 2
    run(jobs)
    wait_for(lambda: len(done) == 3)
    assert done == ["job", "show 3", "drag 2"]
    jobs.close()


def test_the_end_of_a_drag_is_not_left_out(jobs, done):
    jobs.drag(lambda: done.append("position"), last=False)
    jobs.drag(lambda: done.append("end"), last=True)
    run(jobs)
    wait_for(lambda: done)
    assert done == ["end"]


def test_what_is_slow_to_draw_waits_for_jobs_but_not_for_ever(jobs, done):
    jobs.draw_later()
    jobs.do(lambda: done.append("job"))
    run(jobs)
    wait_for(lambda: len(done) == 2)
    assert done == ["job", "rest"]
    jobs.draw_later()
    jobs.do(lambda: time.sleep(2 * LATE_S))
    jobs.do(lambda: done.append("after"))
    wait_for(lambda: "after" in done)
    assert done.index("rest", 2) < done.index("after")


@pytest.mark.parametrize(
    ("error", "note"),
    [
        (ValueError("give another"), "give another"),
        (KeyError("gone"), "by a fault of coview (KeyError: 'gone')"),
    ],
)
def test_a_fault_is_said_and_the_threads_live_on(jobs, head, done, capsys, error, note):
    def fail():
        raise error

    run(jobs)
    jobs.later("comparing", fail)
    wait_for(lambda: "redraw" in done)
    jobs.do(fail)
    wait_for(lambda: done.count("redraw") == 2)
    assert note in head.note
    assert "comparing" in {busy for busy, _ in head.shown}
    wait_for(lambda: not head.busy)
    jobs.do(lambda: done.append("alive"))
    wait_for(lambda: "alive" in done)
    assert [thread.is_alive() for thread in jobs.threads] == [True, False, True]


def test_slow_drawing_that_fails_is_said_and_tried_again_only_after_the_next_job(head, capsys):
    tries = []

    def draw_rest():
        tries.append("rest")
        raise KeyError("map")

    # drawing all again lets slow drawing follow, as on the page
    page_jobs = LiveJobs(
        head, show=lambda answer: None, redraw=lambda: page_jobs.draw_later(), draw_rest=draw_rest
    )
    run(page_jobs)
    page_jobs.do(page_jobs.draw_later)
    wait_for(lambda: head.shown)
    time.sleep(2 * LATE_S)  # it would be tried again and again
    assert tries == ["rest"]
    assert "by a fault of coview (KeyError: 'map')" in head.note
    assert head.shown == [("", head.note)]
    page_jobs.do(page_jobs.draw_later)
    wait_for(lambda: len(head.shown) == 2)
    assert tries == ["rest", "rest"]
    page_jobs.close()


def test_refining_shows_what_is_no_longer_coarse_and_holds_only_its_own_thread(jobs, done):
    refined, asked = threading.Event(), []

    def refine(hold):
        asked.append(hold)
        planner.coarse = False
        refined.set()
        return False

    planner = SimpleNamespace(coarse=True, refine=refine)
    answer: Any = SimpleNamespace(coarse=True)
    refining = Refining(planner, jobs, lambda: answer, lambda: done.append("refined"))
    run(jobs, refining.run)
    assert refined.wait(20)
    wait_for(lambda: "refined" in done)
    jobs.touch()
    assert not asked[0]()  # another thread that casts rays does not wait
