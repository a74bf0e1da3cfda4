"""The live planner's engine: figures equal to the objective's, every kind of change, undo and
suggestions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env import Cases, LivePlanner
from placement_env.analysis.intervals import block_draws
from placement_env.fidelity.surrogate import compute_expected_ap, resample_ap
from placement_env.live.suggestions import Suggestion
from placement_env.live.variant import Variant, free_name
from placement_env.setting import Setting

FRAMES = 8


@pytest.fixture(scope="module")
def shared():
    return LivePlanner("tjunction", frames=FRAMES, seed=3)


@pytest.fixture
def planner(shared):
    shared.restore({"A": shared.yard.place(shared.yard.site.sensors)}, "A", [])
    return shared


def test_figures_are_those_of_the_objective(planner) -> None:
    """Within .005 of its score of the same set on the same frames, wherever the sensors are turned
    and raised."""
    rng = np.random.default_rng(0)
    for sensor in planner.sensors:
        planner.move(sensor.name, rng.uniform(-3, 3), rng.uniform(0, 0.6), rng.uniform(3, 8))
    answer, score = planner.finish(), planner.score()
    assert answer.ap == pytest.approx(score.ap, abs=0.005)
    assert answer.recall == pytest.approx(score.recall, abs=0.005)
    assert answer.kbit == pytest.approx(score.kbit, rel=0.02)
    assert answer.price == score.price == len(planner.sensors)
    assert not answer.coarse
    (vehicles,) = answer.classes
    assert vehicles.ap == pytest.approx(answer.ap, abs=1e-6)
    assert sum(row.objects for row in answer.approaches) == answer.objects == vehicles.objects
    found = sum(row.recall * row.objects for row in answer.approaches) / answer.objects
    assert found == pytest.approx(answer.recall, abs=1e-3)


@pytest.mark.slow
def test_an_interval_needs_five_blocks_and_holds_the_figure() -> None:
    planner = LivePlanner("tjunction", frames=40, seed=3)
    answer = planner.answer()
    assert answer.low <= answer.ap <= answer.high <= 1
    assert answer.high - answer.low > 0.001
    before = planner.sensors[0].name
    moved = planner.move(before, heading=planner.sensors[0].heading + np.pi)
    assert moved.change == pytest.approx(moved.ap - answer.ap)
    assert moved.change_low <= moved.change <= moved.change_high
    few = LivePlanner("tjunction", frames=8, seed=3).answer()
    assert np.isnan(few.low)


def test_poles_carry_what_hangs_there_and_a_first_suggestion_looks_where_there_is_room() -> None:
    """The roundabout's own posts carry two sensors each, more than one of its pool may."""
    planner = LivePlanner("roundabout", frames=4)
    assert not planner.finish().problems
    (found,) = planner.suggest("add", count=1, patience=0.0)
    assert found.sensor.mount not in {sensor.mount for sensor in planner.sensors}
    assert found.considered <= 2 * 24  # of two poles at most
    most = planner.yard.find_mount(planner.variant, planner.sensors[0].mount).max_sensors
    assert most == sum(each.mount == planner.sensors[0].mount for each in planner.sensors) == 2


def test_a_lift_makes_no_panorama_and_refining_waits_while_somebody_moves() -> None:
    """A first view is taken from the next height known; whoever casts rays goes on before the
    rest."""
    planner = LivePlanner("tjunction", frames=4)
    planner.finish()
    live, height = planner.preparation.live, planner.sensors[0].height
    assert live is not None
    known = len(live.surrounds)
    up = planner.move("d0", height=height - 1.2)
    assert up.coarse
    assert len(live.surrounds) == known
    again = planner.answer()
    assert (again.coarse, again.ap) == (True, up.ap)
    asked: list[bool] = []

    def hold() -> bool:
        asked.append(len(asked) < 3)
        return asked[-1]

    assert planner.refine(hold)
    assert asked[:4] == [True, True, True, False]
    assert len(live.surrounds) == known + 1
    assert not planner.finish().coarse
    assert planner.finish().ap == pytest.approx(planner.score().ap, abs=0.005)
    live.hold, live._waiting = (lambda: True), [None]  # another waits for rays
    assert list(live._iterate_frames()) == [0, 1, 2, 3]


@pytest.mark.slow
def test_figures_of_few_frames_are_coarse_until_those_of_all_follow(planner) -> None:
    """They say their number, are followed whatever is done meanwhile, and no change is counted
    between them."""
    quick = LivePlanner("tjunction", frames=FRAMES, seed=3, first_frames=4)
    first = quick.answer()
    assert (first.frames, first.coarse, quick.frames) == (4, True, 4)
    moved = quick.move("d0", heading=1.0)
    assert moved.change == pytest.approx(moved.ap - first.ap)
    quick.show("B", copy=True)
    whole = quick.finish()
    assert (whole.frames, whole.coarse, whole.change) == (FRAMES, False, 0.0)
    assert whole.objects == planner.answer().objects > first.objects
    planner.move("d0", heading=1.0)
    assert whole.ap == planner.finish().ap
    assert quick.undo().what == "undo"
    assert not quick.answer().coarse
    assert LivePlanner("tjunction", frames=4, first_frames=8).answer().frames == 4
    asked = LivePlanner("tjunction", frames=FRAMES, seed=3, first_frames=4)
    asked.ask(classes=("cyclist", "pedestrian"))
    assert asked.suggest("remove", count=1)[0].answer.frames == FRAMES


def test_the_worst_failure_is_that_of_the_sensor_whose_failure_leaves_least(planner) -> None:
    whole = planner.finish()
    left = {}
    for sensor in planner.sensors:
        left[sensor.name] = planner.fail(sensor.name).ap
        planner.undo()
    assert whole.worst == pytest.approx(min(left.values()), abs=1e-6)
    assert left[whole.worst_sensor] == min(left.values())


def test_a_failed_sensor_is_paid_but_sees_and_sends_nothing(planner) -> None:
    name, whole = planner.sensors[0].name, planner.finish()
    failed = planner.fail(name)
    assert failed.price == whole.price
    assert failed.kbit < whole.kbit
    gone = planner.remove(name)
    assert (gone.ap, gone.kbit) == (pytest.approx(failed.ap), pytest.approx(failed.kbit))
    assert gone.price == whole.price - 1


def test_everything_can_be_undone_and_done_again(planner) -> None:
    steps = [
        lambda: planner.move("d0", heading=1.0),
        lambda: planner.move("d1", position="pole03"),
        lambda: planner.add("pole07", 0.5, 0.2),
        lambda: planner.duplicate("d2"),
        lambda: planner.fail("d3"),
        lambda: planner.lock("d4"),
        lambda: planner.remove("d5"),
    ]
    states, figures = [planner.variant], [planner.answer().ap]
    for step in steps:
        figures.append(step().ap)
        states.append(planner.variant)
    for k in reversed(range(len(steps))):
        assert planner.undo().ap == figures[k]
        assert planner.variant == states[k]
    with pytest.raises(ValueError, match="nothing to undo"):
        planner.undo()
    for k in range(len(steps)):
        assert planner.redo().ap == figures[k + 1]
        assert planner.variant == states[k + 1]
    with pytest.raises(ValueError, match="nothing to redo"):
        planner.redo()


def test_a_drag_is_one_step(planner) -> None:
    before = planner.variant
    for heading in (0.1, 0.2, 0.3):
        planner.move("d0", heading=heading, dragging=True)
    planner.move("d1", heading=0.3, dragging=True)
    planner.undo()
    planner.undo()
    assert planner.variant == before


def test_a_new_change_forgets_what_was_undone(planner) -> None:
    planner.move("d0", heading=1.0)
    planner.undo()
    planner.move("d0", heading=2.0)
    with pytest.raises(ValueError, match="nothing to redo"):
        planner.redo()


def test_locked_sensors_stay(planner) -> None:
    planner.lock("d0")
    for change in (lambda: planner.move("d0", heading=1.0), lambda: planner.remove("d0")):
        with pytest.raises(ValueError, match="d0 is locked"):
            change()
    planner.lock("d0", locked=False)
    planner.move("d0", heading=1.0)


def test_a_pole_stands_on_free_ground_alone(planner) -> None:
    site = planner.yard.site
    lane = np.mean(site.lanes[0], axis=0)
    spots = {"on a lane": lane, "more than 100 m": (500.0, 0.0)}
    wall = next(solid for solid in site.solids if solid.kind == "building")
    spots["something stands there"] = np.mean(wall.footprint, axis=0)
    for said, spot in spots.items():
        with pytest.raises(ValueError, match=said):
            planner.move("d0", position=tuple(spot))
    xmin, ymin, xmax, ymax = site.area
    grid = ((x, y) for x in np.arange(xmin, xmax, 3.0) for y in np.arange(ymin, ymax, 3.0))
    feet = np.array([mount.position[:2] for mount in site.mounts])
    free = next(
        s for s in grid if not planner.yard.refusal_reason(s) and np.hypot(*(feet - s).T).min() > 3
    )
    planner.move("d0", position=free)
    assert planner.sensors[0].mount == "own pole 1"
    assert (planner.sensors[0].x, planner.sensors[0].y) == free
    assert not planner.finish().coarse
    planner.move("d0", position="pole05")
    assert not planner.variant.poles


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p.move("nobody", heading=0.0), "there is no sensor 'nobody'"),
        (lambda p: p.move("d0", position="nowhere"), "there is no pole 'nowhere'"),
        (lambda p: p.move("d0", position="post01"), "carries all the sensors"),
        (lambda p: p.move("d0", heading=float("nan")), "heading must be a finite number"),
        (lambda p: p.add("post00"), "carries all the sensors"),
        (lambda p: p.add("pole01", model="telescope"), "there is no model 'telescope'"),
        (lambda p: p.add("pole01", name="d0"), "there is a sensor 'd0' already"),
        (lambda p: p.add("pole01", name="two\nlines"), "one line"),
        (lambda p: p.show("B"), "'B' is unknown"),
        (lambda p: p.show("A", copy=True), "'A' is taken"),
        (lambda p: p.suggest("dance"), "kind must be"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(planner, change, said) -> None:
    before = planner.variant
    with pytest.raises(ValueError, match=said):
        change(planner)
    assert planner.variant == before


def test_variants_stand_side_by_side(planner) -> None:
    first = planner.finish()
    copied = planner.show("B", copy=True)
    assert copied.ap == first.ap
    planner.remove("d0")
    assert len(planner.show("A").classes) == 1
    assert [len(each.sensors) for each in planner.variants.values()] == [6, 5]
    assert planner.estimate(planner.variants["B"]).sensors == 5


@pytest.mark.slow
def test_a_suggestion_keeps_what_it_promises(planner) -> None:
    for name in ("d1", "d3", "d4", "d5"):
        planner.remove(name)
    before = planner.finish()
    best = planner.suggest()[0]
    assert best.answer.ap > before.ap
    after = planner.accept(best)
    assert planner.finish().ap == pytest.approx(best.answer.ap, abs=0.005)
    assert after.sensors == 3
    added = planner.sensors[-1]
    planner.move(added.name, heading=added.heading + np.pi)
    turned_away = planner.finish().ap
    place = planner.suggest("move", added.name)[0]
    assert planner.accept(place).ap >= turned_away
    least = planner.suggest("remove")
    assert least[0].answer.ap == max(each.answer.ap for each in least)
    planner.accept(least[0])
    assert len(planner.sensors) == 2
    with pytest.raises(ValueError, match="carries all"):
        planner.accept(Suggestion("add", replace(planner.sensors[0], name="c"), before, 0))


def test_a_search_from_here_never_gets_worse_and_leaves_locked_sensors(planner) -> None:
    for name in ("d2", "d3", "d4", "d5"):
        planner.remove(name)
    planner.lock("d0")
    before, kept = planner.finish().ap, planner.sensors[0]
    aps = [answer.ap for answer in planner.search()]
    assert all(b >= a - 0.005 for a, b in zip([before, *aps], aps, strict=False))
    assert planner.sensors[0] == kept


def test_a_setting_brings_its_own_stock() -> None:
    planner = LivePlanner(
        Setting("tjunction", candidates="pool", classes=("vehicle", "pedestrian")), frames=8
    )
    answer = planner.answer()
    assert [row.name for row in answer.classes] == ["vehicle", "pedestrian"]
    assert answer.ap == pytest.approx(np.mean([row.ap for row in answer.classes]), abs=1e-6)
    with pytest.raises(ValueError, match="surrogate"):
        LivePlanner(Setting("tjunction", cases=Cases(iou=0.33)), frames=8)


def test_short_sighted_sensors_are_cast_ray_by_ray() -> None:
    setting = Setting("tjunction", rendering="full")
    planner = LivePlanner(setting, frames=4)
    answer = planner.move(planner.sensors[0].name, heading=1.0)
    assert not answer.coarse
    assert answer.ap == pytest.approx(planner.score().ap, abs=1e-6)
    assert planner.suggest("add") == ()


def test_resampled_ap_of_every_object_once_is_the_expected_ap() -> None:
    rng = np.random.default_rng(1)
    probability = rng.uniform(size=80)
    ap, _ = compute_expected_ap(np.sort(probability)[None, ::-1], 0.3)
    block = np.arange(80) // 8
    once = resample_ap(probability, 0.3, np.ones((1, 10), np.float32), block)
    assert once == pytest.approx(ap)
    counts = block_draws(10, block=1, resamples=300)
    drawn = resample_ap(probability, 0.3, counts.astype(np.float32), block)
    repeated = [
        compute_expected_ap(np.sort(np.repeat(probability, row[block]))[None, ::-1], 0.3)[0]
        for row in counts
    ]
    assert drawn == pytest.approx(np.ravel(repeated), abs=0.01)


def test_a_detector_of_a_plan_that_is_not_loaded_is_refused_by_name(planner, monkeypatch) -> None:
    monkeypatch.setattr(planner, "plan", SimpleNamespace(own_detector="mine:Bricks"))
    with pytest.raises(
        ValueError, match="the plan's detector is mine:Bricks, which is not loaded: "
    ):
        planner.measure()


def test_names_are_free() -> None:
    planner = Variant()
    assert free_name(planner, "camera 1") == "camera 1"


def test_keep_out_areas_bar_poles_and_can_be_undone(planner) -> None:
    sensor, free = planner.sensors[0], next(iter(planner.yard.mounts.values()))
    x, y = free.position[:2]
    corners = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    with pytest.raises(ValueError, match="three corners or more"):
        planner.set_keep_out([corners[:2]])
    planner.set_keep_out([corners])
    for where in (free.name, (float(x), float(y))):
        with pytest.raises(ValueError, match="keep-out area"):
            planner.add(where)
    assert all(each.sensor.mount != free.name for each in planner.suggest())
    again = Variant.from_dict(planner.variant.as_dict())
    assert again == planner.variant
    around = ((sensor.x - 1, sensor.y - 1), (sensor.x + 1, sensor.y - 1), (sensor.x, sensor.y + 2))
    assert any(
        "hangs in a keep-out area" in said for said in planner.set_keep_out([around]).problems
    )
    planner.undo()
    planner.undo()
    assert not planner.variant.keep_out


@pytest.mark.slow
def test_another_question_is_answered_on_the_same_traffic(planner) -> None:
    before, traffic = planner.finish(), planner.preparation.traffic
    strict = planner.ask(cases=Cases(iou=0.8))
    assert strict.ap < before.ap
    assert strict.objects == before.objects
    small = planner.ask(classes=("cyclist", "pedestrian"), cases=Cases(), most_price=5)
    assert [each.name for each in small.classes] == ["cyclist", "pedestrian"]
    assert small.budget == 5
    assert any("more than 5" in said for said in small.problems)
    assert planner.preparation.traffic is traffic
    assert planner.finish().ap == pytest.approx(planner.score().ap, abs=0.005)
    with pytest.raises(ValueError):
        planner.ask(classes=("vehicle",), cases=Cases(iou=0.33))
    planner.ask(classes=("vehicle",), most_price=float("inf"))
    again = planner.finish()
    assert again.ap == pytest.approx(before.ap, abs=1e-9)
    assert again.worst == pytest.approx(before.worst)
    assert sum(level.objects for level in again.levels) == again.objects
