"""Single steps of the live planner, each in a tenth of a second, on six frames."""

import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from placement_env import LivePlanner
from placement_env.live.history import MAX_UNDO_STEPS
from placement_env.live.suggestions import Suggester, Suggestion
from placement_env.live.variant import TILT_SPAN_RAD, Variant
from placement_env.live.views import VariantView
from placement_env.report.planning.question import Stock
from placement_env.setting import Setting
from toolkit.runtime.run import Run

FRAMES = 6


@pytest.fixture(scope="module")
def made():
    return LivePlanner("tjunction", frames=FRAMES, seed=3)


@pytest.fixture
def planner(made):
    made.listen(lambda dragging: None)
    made.restore({"A": made.yard.place(made.yard.site.sensors)}, "A", [])
    return made


@pytest.fixture
def told(planner):
    """What listeners are told, in order."""
    heard = []
    planner.listen(heard.append)
    return heard


def free_mounts(planner):
    used = {sensor.mount for sensor in planner.sensors}
    return [mount for mount in planner.yard.stock.mounts if mount.name not in used]


def test_as_many_first_frames_as_all_are_no_first_look():
    for first in (None, FRAMES, FRAMES + 1):
        planner = LivePlanner("tjunction", frames=FRAMES, seed=3, first_frames=first)
        assert not planner.scorer.all_frames.are_awaited
    quick = LivePlanner("tjunction", frames=FRAMES, seed=3, first_frames=FRAMES - 1)
    assert quick.scorer.all_frames.are_awaited
    assert quick.frames == FRAMES - 1
    assert quick.answer().coarse
    given = LivePlanner("tjunction", run=Run(frames=4, seed=9))
    assert (given.frames, given.preparation.run.seed) == (4, 9)


def test_every_change_is_told_once_and_drags_as_drags(planner, told):
    pole = free_mounts(planner)[0].name
    planner.move("d0", heading=1.0)
    planner.move("d0", heading=1.1, dragging=True)
    planner.move("d0", heading=1.2, dragging=True)
    planner.end_drag()
    planner.add(pole)
    planner.undo()
    planner.redo()
    planner.show("B", copy=True)
    planner.lay(None)
    assert told == [False, False, True, False, False, False, False, False, False]


def test_a_drag_of_one_sensor_is_one_step_and_another_begins_anew(planner):
    start = planner.variant
    for heading in (0.1, 0.2):
        planner.move("d0", heading=heading, dragging=True)
    assert [variant for _, variant in planner.past_steps] == [start]
    planner.end_drag()
    planner.move("d0", heading=0.3, dragging=True)
    assert len(planner.past_steps) == 2
    planner.move("d1", heading=0.3, dragging=True)
    assert len(planner.past_steps) == 3
    planner.move("d1", heading=0.4)
    assert len(planner.past_steps) == 4
    planner.move("d1", heading=0.5, dragging=True)
    assert len(planner.past_steps) == 5


def test_a_change_that_changes_nothing_is_no_step(planner):
    before = planner.variant
    sensor = planner.sensors[0]
    planner.move(sensor.name, sensor.heading, sensor.tilt, sensor.height)
    assert planner.variant is before or planner.variant == before
    assert planner.past_steps == ()
    planner.move(sensor.name, heading=1.0)
    planner.undo()
    planner.lock(sensor.name, False)
    assert len(planner.history.future) == 1


def test_steps_to_undo_are_bounded(planner):
    start = planner.variant
    planner.history.restore({"A": start}, "A", [("A", start)] * MAX_UNDO_STEPS)
    planner.lock("d0")
    assert len(planner.past_steps) == MAX_UNDO_STEPS
    assert not planner.past_steps[-1][1].find("d0").locked


def test_headings_turn_round_and_tilts_and_heights_are_held(planner):
    mount = planner.yard.find_mount(planner.variant, planner.variant.find("d0").mount)
    planner.move("d0", heading=2 * np.pi + 0.5, tilt=1.57, height=99.0)
    sensor = planner.variant.find("d0")
    assert sensor.heading == pytest.approx(0.5)
    assert sensor.tilt == TILT_SPAN_RAD[1]
    assert sensor.height == max(
        mount.max_height, planner.yard.place(planner.yard.site.sensors).find("d0").height
    )
    planner.move("d0", tilt=-1.0, height=-5.0)
    sensor = planner.variant.find("d0")
    assert (sensor.tilt, sensor.height) == (TILT_SPAN_RAD[0], min(mount.min_height, sensor.height))
    for tilt in (1.6, -1.6, float("nan")):
        with pytest.raises(ValueError, match="tilt must"):
            planner.move("d0", tilt=tilt)
        with pytest.raises(ValueError, match="tilt must"):
            planner.add(free_mounts(planner)[0].name, tilt=tilt)
    for name in ("heading", "height"):
        with pytest.raises(ValueError, match=f"{name} must be a finite number, got inf"):
            planner.move("d0", **{name: float("inf")})


def test_a_sensor_that_is_carried_takes_place_and_heights_of_its_pole(planner):
    low, high = free_mounts(planner)[:2]
    planner.move("d0", position=low.name, height=50.0)
    sensor = planner.variant.find("d0")
    assert (sensor.mount, sensor.x, sensor.y) == (low.name, *low.position[:2].tolist())
    assert sensor.height == low.max_height
    planner.move("d0", position=low.name)
    assert planner.variant.find("d0").mount == low.name  # its own place counts as free
    planner.move("d1", position=high.name)
    with pytest.raises(
        ValueError, match=f"{high.name} carries all the sensors that it may: take another pole"
    ):
        planner.move("d0", position=high.name)


def test_a_new_sensor_has_a_name_a_model_and_the_highest_place(planner):
    mount, other, third = free_mounts(planner)[:3]
    planner.add(mount.name)
    sensor = planner.sensors[-1]
    assert (sensor.name, sensor.model, sensor.height) == (
        mount.name,
        "depth-camera",
        mount.max_height,
    )
    assert (sensor.heading, sensor.tilt) == (0.0, 0.26)
    planner.add(other.name, 1.0, 0.1, other.min_height, name="gate")
    sensor = planner.sensors[-1]
    assert (sensor.name, sensor.heading, sensor.tilt, sensor.height) == (
        "gate",
        1.0,
        0.1,
        other.min_height,
    )
    with pytest.raises(ValueError, match="there is a sensor 'gate' already: give another name"):
        planner.add(third.name, name="gate")
    with pytest.raises(ValueError, match="there is no model 'eye'"):
        planner.add(third.name, model="eye")
    with pytest.raises(ValueError, match="one line"):
        planner.add(third.name, name="a\nb")
    with pytest.raises(ValueError, match=f"{mount.name} carries all"):
        planner.add(mount.name)


def test_a_copy_goes_to_the_nearest_pole_with_room(planner):
    sensor = planner.variant.find("d0")
    free = free_mounts(planner)
    away = [float(np.hypot(*(mount.position[:2] - (sensor.x, sensor.y)))) for mount in free]
    planner.duplicate("d0")
    copy, nearest = planner.sensors[-1], free[int(np.argmin(away))]
    assert copy.mount == nearest.name
    assert (copy.heading, copy.tilt) == (sensor.heading, sensor.tilt)
    assert copy.height == pytest.approx(
        np.clip(sensor.height, nearest.min_height, nearest.max_height)
    )
    crowded = tuple(
        replace(sensor, name=f"x{k}", mount=mount.name)
        for k, mount in enumerate(planner.yard.stock.mounts)
    )
    planner.variants["A"] = Variant(crowded)
    with pytest.raises(ValueError, match="no pole has room for another sensor"):
        planner.duplicate("x0")


def test_variants_are_shown_and_copied_by_name(planner):
    start = planner.variant
    planner.show("B", copy=True)
    planner.move("d0", heading=1.0)
    assert planner.variants["A"] == start
    assert planner.current == "B"
    answer = planner.show("A")
    assert answer.what == "variant A"
    assert answer.change == pytest.approx(
        planner.estimate(start).ap - planner.estimate(planner.variants["B"]).ap
    )
    with pytest.raises(ValueError, match="'C' is unknown: the variants are A, B"):
        planner.show("C")
    with pytest.raises(ValueError, match="'B' is taken: the variants are A, B"):
        planner.show("B", copy=True)
    with pytest.raises(ValueError, match="the shown variant 'C' must be one of A"):
        planner.restore({"A": start}, "C", [])
    planner.undo()  # of what was done to B
    assert planner.current == "B"


def test_nothing_is_undone_or_done_again_where_nothing_was(planner):
    with pytest.raises(ValueError, match="there is nothing to undo"):
        planner.undo()
    with pytest.raises(ValueError, match="there is nothing to redo"):
        planner.redo()
    planner.fail("d1")
    assert planner.undo().what == "undo"
    assert planner.redo().what == "redo"
    assert planner.variant.find("d1").failed
    planner.undo()
    planner.lock("d1")
    with pytest.raises(ValueError, match="there is nothing to redo"):
        planner.redo()


def test_poles_that_nobody_uses_are_forgotten(planner):
    spots = ((x, y) for x in np.arange(-60, 60, 2.0) for y in np.arange(-60, 60, 2.0))
    feet = np.array([mount.position[:2] for mount in planner.yard.stock.mounts])
    spot = next(
        s for s in spots if not planner.yard.refusal_reason(s) and np.hypot(*(feet - s).T).min() > 3
    )
    planner.move("d0", position=spot)
    (pole,) = planner.variant.poles
    assert pole.position[:2] == pytest.approx(spot)
    planner.move("d0", position=free_mounts(planner)[0].name)
    assert planner.variant.poles == ()


def test_more_sensors_than_the_plan_allows_and_keep_out_areas_are_problems():
    planner = LivePlanner("tjunction", frames=FRAMES, seed=3, most_sensors=6)
    assert planner.answer().problems == ()
    planner.add(free_mounts(planner)[0].name)
    assert "it has 7 sensors, more than the 6 of its plan" in planner.answer().problems
    sensor = planner.sensors[-1]
    corners = tuple((sensor.x + x, sensor.y + y) for x, y in ((-1, -1), (1, -1), (0, 1)))
    assert f"{sensor.name} hangs in a keep-out area" in planner.set_keep_out([corners]).problems


def test_price_and_budget_are_those_of_the_setting(planner):
    setting = Setting("tjunction", candidates=Stock(candidates="paper"), most_price=5.0)
    dear = LivePlanner(setting, frames=FRAMES, seed=3)
    answer = dear.answer()
    assert (answer.price, answer.budget) == (6.0, 5.0)
    assert "it costs 6, more than 5" in answer.problems
    assert answer.as_dict()["budget"] == 5.0
    dear.remove("d0")
    assert not any("it costs" in said for said in dear.answer().problems)
    assert "budget" not in planner.answer().as_dict()
    assert {"resamples", "probability", "hidden"}.isdisjoint(planner.answer().as_dict())
    assert dear.question == {}
    dear.ask(most_price=7.0, scheme="late")
    assert dear.question == {"scheme": "late", "most_price": 7.0}


def test_figures_of_a_set_without_sensors_are_nothing(planner):
    for sensor in planner.sensors:
        planner.remove(sensor.name)
    answer = planner.answer()
    assert (answer.sensors, answer.recall, answer.kbit, answer.price) == (0, 0.0, 0.0, 0.0)
    assert (answer.worst, answer.worst_sensor, answer.spread) == (0.0, "", 0.0)
    assert answer.unseen == answer.objects == len(answer.hidden)
    assert answer.links == ()


def test_links_are_those_of_the_poles_that_carry_sensors(planner):
    answer = planner.answer()
    variant = planner.variant
    assert sorted(link.pole for link in answer.links) == sorted(
        {sensor.mount for sensor in variant.sensors}
    )
    assert sum(link.mbit_s for link in answer.links) == pytest.approx(
        answer.kbit * 10 / 1000, rel=1e-6
    )
    for link in answer.links:
        assert link.peak_mbit_s >= link.mbit_s > 0
        capacity = planner.yard.find_mount(variant, link.pole).capacity
        assert link.capacity_mbit_s == pytest.approx(capacity * 10 / 1000)
    silent = planner.fail("d0")
    own = {link.pole: link for link in silent.links}[variant.find("d0").mount]
    assert own.mbit_s == own.peak_mbit_s == 0.0
    assert silent.kbit == pytest.approx(
        answer.kbit - 100 * {k.pole: k for k in answer.links}[own.pole].mbit_s
    )


def test_a_copy_by_pickle_goes_on_by_itself(planner, told):
    planner.show("B", copy=True)
    planner.move("d0", heading=1.0)
    again = pickle.loads(pickle.dumps(planner))
    before = len(told)
    again.remove("d1")
    again.undo()
    again.undo()
    assert len(told) == before
    assert list(again.variants) == ["A", "B"]
    assert planner.variant.find("d0").heading == 1.0
    assert len(planner.past_steps) == 1


def test_a_copy_shares_nothing_that_changes(planner):
    planner.answer()
    state = planner.__getstate__()
    scorer, copied = planner.scorer, state["scorer"]
    for part, part_copied, names in (
        (planner.history, state["history"], ("variants", "_past", "_future")),
        (scorer, copied, ("_answers",)),
        (scorer.views, copied.views, ("_rows",)),
    ):
        for name in names:
            assert getattr(part_copied, name) == getattr(part, name)
            assert getattr(part_copied, name) is not getattr(part, name), name
    assert copied.all_frames.fetching is not scorer.all_frames.fetching


def test_another_question_is_no_change_of_ap(planner):
    planner.finish()
    planner.move("d0", heading=1.0)
    assert planner.ask(scheme="late").change == 0.0
    assert planner.ask(scheme="early").change == 0.0


def test_a_search_can_be_stopped_and_a_suggestion_needs_a_kind_and_room(planner):
    assert list(planner.search(lambda: True)) == []
    for kind, name in (("turn", None), ("move", None)):
        with pytest.raises(
            ValueError, match="kind must be add, remove, or move with the name of a sensor"
        ):
            planner.suggest(kind, name)
    planner.lock("d1")
    with pytest.raises(ValueError, match="d1 is locked: unlock it first"):
        planner.suggest("move", "d1")
    missed = planner.suggest("remove", count=2)
    aps = {}
    for sensor in planner.sensors:
        if not sensor.locked:
            left = tuple(each for each in planner.sensors if each is not sensor)
            aps[sensor.name] = planner.estimate(replace(planner.variant, sensors=left)).ap
    best = sorted(aps, key=lambda name: -aps[name])[:2]
    assert [each.sensor.name for each in missed] == best
    assert {each.considered for each in missed} == {0}
    assert planner.accept(missed[0]).what == f"{best[0]} removed"
    assert best[0] not in {sensor.name for sensor in planner.sensors}


def always(value):
    """Property, or function of nothing, that is always the same."""
    return property(lambda *_: value)


def test_refining_looks_from_other_heights_the_nearest_first_unless_memory_is_full(
    planner, monkeypatch
):
    planner.finish()
    looked, further = [], []

    def look(live, every, k, sensor):
        looked.append((k, float(sensor.position[2] - every.sensors[k].position[2])))
        return bool(further[2:])

    def look_further():
        further.append(True)
        return True

    monkeypatch.setattr("placement_env.live.views.make_table_ahead", lambda *_, **__: False)
    monkeypatch.setattr("placement_env.live.views.make_view", look)
    monkeypatch.setattr(planner.scorer.views.stock, "look_further", look_further)
    live, count = planner.preparation.live, len(planner.sensors)
    for full in (True, False):
        monkeypatch.setattr(type(live), "full", always(full))
        looked.clear()
        assert planner.refine(always(full).fget)
        assert live.hold() is full
        assert looked[:count] == [(k, 0.0) for k in range(count)]
        away = [abs(up) for _, up in looked[count:]]
        assert away == sorted(away)
        assert bool(away) is not full
    assert {k for k, _ in looked} == set(range(count))
    assert len(further) == 2
    further.append(True)  # now views are made
    assert planner.refine()
    assert len(further) == 3  # what is shown comes first


def test_suggestions_are_of_different_poles_with_room(planner):
    stock, free = planner.yard.stock, free_mounts(planner)
    on = {
        mount.name: [k for k, m in enumerate(stock.mount) if stock.mounts[m].name == mount.name]
        for mount in stock.mounts
    }
    used = next(sensor.mount for sensor in planner.sensors if on.get(sensor.mount))
    first, second, third = (
        on[mount.name] for mount in [each for each in free if len(on[each.name]) > 1][:3]
    )
    ranked = [first[0], first[1], on[used][0], second[0], third[0], third[1]]
    asked = []

    class Noting(Suggester):
        """Suggester that notes what it is to improve."""

        def improve(self, kind, base, sensor):
            asked.append((kind, sensor.mount, len(base.sensors)))
            return Suggestion(kind, sensor, replace(planner.answer(), ap=len(asked) / 10), 0)

    stock_views = SimpleNamespace(view_free_poles=lambda *_: False, rank=lambda *_: ranked)
    views = SimpleNamespace(see=planner.scorer.views.see, stock=stock_views)
    suggester = Noting(planner.yard, SimpleNamespace(objective=None), views, planner.estimate)

    def suggest(kind, name, count):
        return suggester.suggest(planner.variant, kind, name, count=count, patience=1.0)

    found = suggest("add", None, 2)
    mounts = [stock.mounts[stock.mount[k]].name for k in (first[0], second[0], third[0])]
    assert [mount for _, mount, _ in asked] == mounts[:2]
    assert [each.answer.ap for each in found] == [0.2, 0.1]  # the best first
    asked.clear()
    assert len(suggest("add", None, 9)) == 3
    assert [mount for _, mount, _ in asked] == mounts
    assert {(kind, count) for kind, _, count in asked} == {("add", 6)}
    asked.clear()
    name = next(sensor.name for sensor in planner.sensors if sensor.mount == used)
    suggest("move", name, 9)
    assert used in {mount for _, mount, _ in asked}  # its own pole has room for it
    assert {(kind, count) for kind, _, count in asked} == {("move", 5)}


@pytest.mark.parametrize(("gain", "yields"), [(None, 0), (-0.1, 0), (5e-5, 0), (0.1, 1)])
def test_a_search_goes_on_only_where_a_move_helps(planner, monkeypatch, gain, yields):
    before = planner.finish()
    asked = []

    def suggest(kind, name, count):
        asked.append((kind, name, count))
        if gain is None or len(asked) > 1:
            return ()
        sensor = replace(planner.variant.find(name), heading=1.0)
        return (Suggestion(kind, sensor, replace(before, ap=before.ap + gain), 9),)

    monkeypatch.setattr(planner, "suggest", suggest)
    assert len(list(planner.search())) == yields
    names = [sensor.name for sensor in planner.sensors]
    assert [name for _, name, _ in asked[:1]] == names[:1]
    assert {name for _, name, _ in asked} == set(names)
    assert len(asked) == len(names)  # after a gain all but the moved one are tried again
    assert {(kind, count) for kind, _, count in asked} == {("move", 1)}


def make_suggester(planner, judge):
    """Suggester that judges variants in place of views, and whose answers are variants."""
    see = lambda variant: VariantView(variant, None, None, False)  # noqa: E731
    views = SimpleNamespace(see=see, stock=SimpleNamespace(known=0))
    meter = SimpleNamespace(measure_ap=judge)
    estimate: Any = lambda variant: variant  # noqa: E731
    return Suggester(planner.yard, meter, views, estimate)


@pytest.mark.parametrize(
    ("turn", "down", "steps"),
    [
        (0.4, 0.0, (0.4, 0.0)),
        (-0.4, 0.0, (-0.4, 0.0)),
        (0.0, 0.18, (0.0, 0.18)),
        (0.2, -0.09, (0.2, -0.09)),
    ],
)
def test_a_suggestion_is_turned_and_tilted_to_the_best_direction(planner, turn, down, steps):
    start = replace(planner.sensors[0], heading=0.5, tilt=0.4)

    def judge(variant, *_):
        sensor = variant.sensors[-1]
        assert variant.sensors[:-1] == planner.variant.sensors
        return 0.9 - abs(sensor.heading - 0.5 - turn) - abs(sensor.tilt - 0.4 - down), 0

    suggester = make_suggester(planner, judge)
    found = suggester.improve("add", planner.variant, start)
    assert (found.sensor.heading, found.sensor.tilt) == pytest.approx(
        (0.5 + steps[0], 0.4 + steps[1])
    )
    assert found.answer.sensors == (*planner.variant.sensors, found.sensor)


@pytest.mark.parametrize(
    ("gain", "problems", "turned"), [(0.1, 0, True), (5e-5, 0, False), (0.1, 1, False)]
)
def test_a_suggestion_is_turned_only_for_a_gain_without_problems(planner, gain, problems, turned):
    start = replace(planner.sensors[0], heading=0.5, tilt=TILT_SPAN_RAD[1])

    def judge(variant, *_):
        sensor = variant.sensors[-1]
        assert sensor.tilt <= TILT_SPAN_RAD[1]
        return (0.5 + gain, problems) if sensor.heading > 0.6 else (0.5, 0)

    suggester = make_suggester(planner, judge)
    assert suggester.improve("move", planner.variant, start).sensor.heading == pytest.approx(
        0.7 if turned else 0.5
    )
