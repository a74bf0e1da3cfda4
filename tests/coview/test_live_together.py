"""Two people at one live page, by script and without a browser: whatever one does, the page lives
on and says so.

`COVIEW_TOGETHER=600 pytest -m slow tests/coview/test_live_together.py` lets them work for ten
minutes."""

import json
import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from coview.live_cameras import CameraAim
from coview.live_page import LivePage
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile, export_variant
from toolkit.viewing.scene import viser_server

MAX_WAITING = 20  # jobs of a page
LONG_S = float(os.environ.get("COVIEW_TOGETHER", "600"))


@pytest.fixture(scope="module")
def engine():
    return LivePlanner("tjunction", frames=6)


@pytest.fixture
def page(engine, tmp_path):
    engine.listen(lambda dragging: None)
    engine.restore({"A": engine.yard.place(engine.yard.site.sensors)}, "A", [])
    with viser_server(18931, "together") as server:
        project = ProjectFile(tmp_path / "a.live.json", engine)
        page = LivePage(server, engine, project, tmp_path)
        # as if a browser had come
        page.cameras.aims[0] = CameraAim(page.cameras.slant, 1.5, False, page.cameras.middle)
        wait_for(lambda: page.has_begun and page.sensors.names)
        yield page
        page.close()
        project.close()


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def settle(page):
    """Wait until everything that was asked is done."""
    done = threading.Event()
    page.do(done.set)
    assert done.wait(120)


def spot(x=0.0, y=0.0):
    return np.array([x, y, 0.0])


def check_alive(page):
    settle(page)
    assert all(thread.is_alive() for thread in page.jobs.threads)
    before = page.planner.variant
    page.change(page.planner.lock, before.sensors[0].name, not before.sensors[0].locked)
    settle(page)
    assert page.planner.variant != before


def drag(page, job):
    page.jobs.drag(lambda: job(last=False), last=False)
    settle(page)
    page.jobs.drag(lambda: job(last=True), last=True)
    settle(page)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("move", ["turn", "carry", "lift"])
def test_a_sensor_that_is_dragged_may_be_removed_by_another(page, move):
    where = 5.0 if move == "lift" else spot(3.0, 4.0)
    page.change(page.planner.remove, "d0")
    settle(page)
    drag(page, lambda last: getattr(page.drags, move)("d0", where, last=last))
    assert "there is no sensor 'd0'" in page.head.note
    assert "there is no sensor &#x27;d0&#x27;" in page.head.note_content
    check_alive(page)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("move", ["turn", "carry", "lift"])
def test_a_step_may_be_undone_during_a_drag(page, move):
    page.change(page.planner.add, "post05") if "post05" in page.planner.yard.mounts else None
    settle(page)
    name = page.planner.sensors[-1].name
    where = 5.0 if move == "lift" else spot(30.0, 4.0)
    page.jobs.drag(lambda: getattr(page.drags, move)(name, where, last=False), last=False)
    settle(page)
    while page.planner.past_steps:
        page.change(page.planner.undo)
        settle(page)
    drag(page, lambda last: getattr(page.drags, move)(name, where, last=last))
    check_alive(page)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("pole", ["moon", None, 7, ""])
def test_an_unknown_pole_in_a_message_is_said(page, pole):
    page.panel.sensor.pole = SimpleNamespace(value=pole)
    page.change(page.panel.sensor.add)
    settle(page)
    assert f"there is no pole {str(pole)!r}" in page.head.note_content.replace("&#x27;", "'")
    check_alive(page)


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "typed", [("95", 20.0, 5.0), (10.0, 95.0, 5.0), ("NW", 20.0, 5.0), (0.0, [], None)]
)
def test_what_is_typed_wrong_is_said(page, typed):
    before = page.planner.variant.find("d0")
    page.change(page.panel.sensor.move_as_typed, "d0", *typed)
    settle(page)
    if typed[0] == "95":
        assert page.planner.variant.find("d0") != before
    else:
        assert page.head.note
        assert page.planner.variant.find("d0") == before


def test_a_fault_in_a_control_a_drawing_or_the_refining_is_said_and_not_the_end(page, fail, capsys):
    def lose(*_):
        raise KeyError("gone")

    page.change(lose)
    settle(page)
    assert "that did not work, by a fault of coview (KeyError: 'gone')" in page.head.note
    assert "KeyError" in capsys.readouterr().err
    faults = [fail(page.areas, "draw", KeyError("gone"))]
    faults.append(fail(page.planner, "refine", KeyError("gone")))
    page.jobs._used_at_s = 0.0
    page.change(page.planner.lock, "d0")
    settle(page)
    time.sleep(0.5)
    for fault in faults:
        fault.undo()
    page.jobs.later("comparing", lose)
    wait_for(lambda: not page.head.busy)
    check_alive(page)


def play(page, number, seconds):
    rng, end = np.random.default_rng(number), time.monotonic() + seconds
    while time.monotonic() < end:
        do_something(page, rng)
        time.sleep(float(rng.uniform(0.0, 0.05)))
        while (
            page.jobs.waiting > MAX_WAITING and time.monotonic() < end
        ):  # people wait for the page too
            time.sleep(0.05)


def do_something(page, rng):
    """Do what a person does, at random, through the ways that browsers take."""
    planner, sensors = page.planner, page.planner.sensors
    poles = list(planner.yard.mounts)
    name = sensors[int(rng.integers(len(sensors)))].name if sensors else "nobody"
    place, last = spot(*rng.uniform(-40, 40, 2)), bool(rng.random() < 0.3)
    variant, pole = f"V{rng.integers(4)}", poles[int(rng.integers(len(poles)))]
    deeds = (
        lambda: page.jobs.drag(lambda: page.drags.turn(name, place, last=last), last=last),
        lambda: page.jobs.drag(lambda: page.drags.carry(name, place, last=last), last=last),
        lambda: page.jobs.drag(
            lambda: page.drags.lift(name, float(place[0]), last=last), last=last
        ),
        lambda: (
            page.change(planner.remove, name)
            if len(sensors) > 2
            else page.change(planner.add, pole)
        ),
        lambda: page.change(planner.add, pole),
        lambda: page.change(planner.undo),
        lambda: page.change(planner.redo),
        lambda: page.change(planner.duplicate, name),
        lambda: page.change(planner.fail, name),
        lambda: page.change(planner.show, variant),
        lambda: page.change(lambda: planner.show(variant, copy=True)),
        lambda: page.choose(name),
        lambda: page.change(page.panel.sensor.move_as_typed, name, "370", 5.0, 5.0),
        lambda: page.jobs.later("exporting", lambda: page.tasks.write(export_variant, page.folder)),
    )
    deeds[int(rng.integers(len(deeds) - 1)) if rng.random() < 0.98 else -1]()


def work_together(page, seconds):
    people = [threading.Thread(target=play, args=(page, number, seconds)) for number in range(2)]
    for person in people:
        person.start()
    for person in people:
        person.join(seconds + 60)
    wait_for(lambda: not page.head.busy, 120)
    check_alive(page)
    page.project.save()
    kept = json.loads(page.project.path.read_text())
    assert kept["variants"][kept["current"]] == page.planner.variant.as_dict()
    assert "fault of coview" not in page.head.note


def test_two_people_work_at_one_page(page, capfd):
    work_together(page, 2.0)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.slow
def test_two_people_work_at_one_page_for_ten_minutes(page, capfd):
    work_together(page, LONG_S)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.slow
def test_sigterm_saves_what_is_open(tmp_path):
    command = (
        sys.executable,
        "-m",
        "coview",
        "live",
        "tjunction",
        "--frames",
        "4",
        "--out",
        str(tmp_path),
    )
    server = subprocess.Popen(
        [*command, "--cache", "None", "--no-browser", "--json", "--port", "18970"],
        stdout=subprocess.PIPE,
        text=True,
    )
    json.loads(server.stdout.readline())
    wait_for((tmp_path / "tjunction.live.json").exists, 60)
    time.sleep(2)
    server.terminate()
    assert server.wait(30) == 0
    assert json.loads((tmp_path / "tjunction.live.json").read_text())["current"] == "A"
