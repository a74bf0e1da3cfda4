"""Views of the stock: poles in the middle first, each pose once, and the best that fit."""

from copy import copy
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from placement_env.candidates.candidates import pool
from placement_env.live.stock_views import VIEW_COLUMNS, StockViews, join_views
from toolkit.sites.files import load_site

SITE = load_site("tjunction")
STOCK = pool(SITE, mounts=load_site("tjunction").mounts[:6])
MIDDLE = (SITE.area[:2] + SITE.area[2:]) / 2


@dataclass(frozen=True, eq=False)
class Seen:
    """Stands for a view: a row of each column for each pose."""

    points: object = None
    distance: object = None
    sent: object = None
    far: object = None


class Live:
    """Notes what is looked at."""

    def __init__(self):
        self.looked = []

    def see(self, candidates, reach):
        assert reach == "own"
        self.looked.append(candidates)
        rows = np.arange(len(candidates), dtype=float)[:, None]
        return Seen(**dict.fromkeys(VIEW_COLUMNS, rows))


def views(live="given"):
    setting = SimpleNamespace(pool=STOCK, place=SITE)
    made = Live() if live == "given" else live
    return StockViews(SimpleNamespace(setting=setting, live=made)), made


def places(candidates):
    return {(int(mount), int(height)) for mount, height in candidates.factors[:, :2]}


def test_every_pose_is_looked_at_once_the_middle_height_and_poles_first():
    stock, live = views()
    steps = 0
    while stock.look_further():
        steps += 1
    looked = [places(each) for each in live.looked]
    assert all(len(each) == 1 for each in looked)
    order = [next(iter(each)) for each in looked]
    assert len(set(order)) == len(order) == steps
    assert stock.known == len(STOCK) == sum(map(len, live.looked))
    heights = [height for _, height in order]
    assert heights[: len(order) // 3] == [1] * (len(order) // 3)
    away = [float(np.hypot(*(STOCK.mounts[mount].position[:2] - MIDDLE))) for mount, _ in order]
    for height in set(heights):
        here = [
            distance for distance, (_, other) in zip(away, order, strict=True) if other == height
        ]
        assert here == sorted(here)
    assert not stock.look_further()
    assert stock.known == len(STOCK)


def test_one_height_of_every_free_pole_is_looked_at_first():
    stock, live = views()
    free = np.array([True, False, True, True, False, True])
    assert stock.view_free_poles(np.inf, free) is False
    seen = [next(iter(places(each))) for each in live.looked]
    assert sorted(mount for mount, _ in seen) == np.flatnonzero(free).tolist()
    assert {height for _, height in seen} == {1}
    assert stock.view_free_poles(np.inf, free) is False
    assert len(live.looked) == free.sum()
    assert stock.view_free_poles(-1.0, np.ones(6, bool)) is True  # patience ends after one pole
    assert len(live.looked) == free.sum() + 1


def test_without_panoramas_nothing_is_looked_up():
    stock, _ = views(None)
    assert not stock.look_further()
    assert stock.known == 0
    assert stock.rank(STOCK.select([]), Seen(), np.zeros(0, bool), None) == []


def test_views_that_are_joined_have_a_row_for_each_sensor():
    unseen = Seen()
    same: object = join_views(unseen, [])
    assert same is unseen
    rows = [tuple(np.full(3, 10 * k + column) for column in range(4)) for k in range(2)]
    joined = join_views(unseen, rows)
    for column, name in enumerate(VIEW_COLUMNS):
        assert getattr(joined, name).tolist() == [[column] * 3, [10 + column] * 3]


class Scored:
    """Objective whose reward is that of the added pose, and which bars some of them."""

    def __init__(self, rewards, barred, asked):
        self.rewards, self.barred, self.asked = rewards, barred, asked

    def feasible(self, sets):
        added = sets[:, -len(self.rewards) :].argmax(axis=1)
        return ~np.isin(added, self.barred)

    def scores(self, sets):
        self.asked.append(sets.copy())
        added = sets[:, -len(self.rewards) :].argmax(axis=1)
        return SimpleNamespace(reward=np.asarray(self.rewards)[added])


def test_poses_are_ranked_by_what_they_add_to_those_that_work():
    stock, live = views()
    stock.look_further()
    (first,) = live.looked
    rewards = np.linspace(0.1, 0.9, len(first))
    rng = np.random.default_rng(0)
    rng.shuffle(rewards)
    barred, asked, made = [int(rewards.argmax())], [], []
    base = STOCK.select(
        [int(np.flatnonzero(STOCK.mount == 5)[0]), int(np.flatnonzero(STOCK.mount == 4)[0])]
    )
    base = replace(
        base, sensors=(base.sensors[0], replace(base.sensors[1], name=first.sensors[0].name))
    )
    seen = Seen(**dict.fromkeys(VIEW_COLUMNS, np.zeros((len(base), 1))))

    def objective(candidates, view):
        made.append((candidates, view))
        return Scored(rewards, barred, asked)

    ranked = stock.rank(base, seen, np.array([True, False]), objective)
    known = [STOCK.sensors.index(sensor) for sensor in first.sensors]
    expected = [known[k] for k in np.argsort(-rewards) if k not in barred]
    assert ranked == expected
    ((candidates, view),) = made
    assert len(candidates) == len(base) + len(first)
    assert candidates.sensors[2].name == f"{first.sensors[0].name} of the stock"
    assert [sensor.name for sensor in candidates.sensors[3:]] == [
        sensor.name for sensor in first.sensors[1:]
    ]
    assert candidates.mount.tolist() == [*base.mount.tolist(), *first.mount.tolist()]
    assert len(view.points) == len(candidates)
    (sets,) = asked
    assert sets[:, :2].tolist() == [[True, False]] * len(first)  # what has failed adds nothing
    assert sets[:, 2:].tolist() == np.eye(len(first), dtype=bool).tolist()


def test_a_copy_goes_on_without_the_original():
    stock, live = views()
    stock.look_further()
    twin = copy(stock)
    known = stock.known
    assert twin.look_further()
    assert stock.known == known < twin.known
    assert stock.look_further()
    assert places(live.looked[1]) == places(live.looked[2])


def test_what_two_threads_ask_for_is_kept_once():
    stock, live = views()
    see = live.see

    def see_twice(candidates, reach):
        """Another thread asks for the same poses before the first has them."""
        live.see = see
        stock.look_further()
        return see(candidates, reach)

    live.see = see_twice
    assert stock.look_further()
    assert places(live.looked[0]) == places(live.looked[1])
    assert stock.known == len(live.looked[0])
