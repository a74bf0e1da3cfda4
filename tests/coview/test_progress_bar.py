"""Long work says where it is when nobody sees a bar."""

import time

import pytest

import coview.progress_bar as progress
from coview.progress_bar import progress_bar


def test_without_a_terminal_lines_say_stage_done_and_time_left(capsys, monkeypatch):
    monkeypatch.setattr(progress, "EVERY_S", 0.02)
    with progress_bar("") as bar:
        bar.stage("poses rendered", 1, 4)
        time.sleep(0.2)
        bar.stage("racing", 0, None)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert any(line.startswith("coview: poses rendered: 1 of 4, about ") and line.endswith(" left") for line in lines)
    assert any(line.startswith("coview: racing: 0, for ") for line in lines)


@pytest.mark.parametrize("hidden", [True, False])
def test_short_or_hidden_work_says_nothing(capsys, monkeypatch, hidden):
    monkeypatch.setattr(progress, "EVERY_S", 0.02 if hidden else 60.0)
    with progress_bar("frame", 3, hidden=hidden) as bar:
        bar.to(1)
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_time_left_goes_by_the_pace_of_the_stage(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with progress_bar("", hidden=True) as bar:
        bar.stage("searching", 5, 10)
        now[0] = 100.0
        bar.stage("judging", 1, 5)
        now[0] = 110.0
        bar.stage("judging", 2, 5)
        assert bar.describe() == "judging: 2 of 5, about 15 s left"
        bar.stage("judging", 0, 5)
        assert bar.describe() == "judging: 0 of 5, for 0 s"
