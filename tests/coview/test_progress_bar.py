"""Long work says where it is when nobody sees a bar."""

import time

import pytest

import coview.progress_bar as progress
from coview.progress_bar import progress_bar


def test_without_a_terminal_lines_say_stage_done_and_time_left(capsys, limits):
    limits(progress, EVERY_S=0.02)
    limits(progress, MIN_LEFT_S=0.0)
    with progress_bar("") as bar:
        bar.stage("poses rendered", 1, 4)
        time.sleep(0.2)
        bar.stage("racing", 0, None)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert any(
        line.startswith("coview: poses rendered: 1 of 4, about ") and line.endswith(" left")
        for line in lines
    )
    assert any(line.startswith("coview: racing, for ") for line in lines)


@pytest.mark.parametrize("hidden", [True, False])
def test_short_or_hidden_work_says_nothing(capsys, limits, hidden):
    limits(progress, EVERY_S=0.02 if hidden else 60.0)
    with progress_bar("frame", 3, hidden=hidden) as bar:
        bar.to(1)
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


@pytest.fixture
def now(monkeypatch):
    """Time of the clock (s), in a list that a test may change."""
    time_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: time_s[0])
    return time_s


def test_time_left_goes_by_the_pace_of_the_stage(now):
    with progress_bar("", hidden=True) as bar:
        bar.stage("searching", 5, 10)
        now[0] = 100.0
        bar.stage("judging", 1, 5)
        now[0] = 110.0
        bar.stage("judging", 2, 5)
        assert bar.describe() == "judging: 2 of 5, about 15 s left"
        bar.stage("judging", 0, 5)
        assert bar.describe() == "judging: 0 of 5, for 0 s"


def test_steps_say_which_of_how_many_and_the_time_of_all(now):
    with progress_bar(
        "", hidden=True, steps={"poses rendered": 0.2, "searches": 0.3, "frames judged": 0.5}
    ) as bar:
        assert bar.describe() == "inputs prepared, for 0 s"
        bar.stage("poses rendered", 0, 10)
        assert bar.describe() == "step 1 of 3, poses rendered: 0 of 10, for 0 s"
        bar.stage("poses rendered", 5, 10)
        now[0] = 100.0
        assert (
            bar.describe()
            == "step 1 of 3, about 17 min in all, poses rendered: 5 of 10, about 2 min left"
        )
        now[0] = 200.0
        bar.stage("searches", 3, 3)
        now[0] = 350.0  # of 300 s for the step, also for what follows the count
        assert bar.describe().startswith("step 2 of 3, about 17 min in all, searches: 3 of 3, ")
        bar.stage("sets scored", 4, None)
        now[0] = 440.0
        assert bar.describe().startswith("step 2 of 3, about 17 min in all, sets scored: 4")
        now[0] = 700.0
        assert bar.describe().startswith("step 2 of 3, about 23 min in all, sets scored: 4")
        bar.stage("poses rendered", 1, 10)  # of another drawing: steps do not go back
        assert bar.describe().startswith("step 2 of 3")


def test_no_time_left_is_zero_while_it_goes_on(now):
    with progress_bar("frames", 5, hidden=True) as bar:
        now[0] = 10.0
        bar.stage("frames", 5, 5)
        now[0] = 30.0
        assert bar.describe() == "frames: 5 of 5, finishing for 30 s"
