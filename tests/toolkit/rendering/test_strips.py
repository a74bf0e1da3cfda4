"""Strips show what rays show; strips of successive frames are those of each frame alone."""

from typing import Any

import numpy as np
import pytest

from toolkit.bodies.body import make_body
from toolkit.mesh import box
from toolkit.objects import VEHICLE, Objects
from toolkit.points import Crop, is_inside
from toolkit.rendering import strips as module
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.strips import (
    BEYOND,
    OUTSIDE,
    WITHIN,
    Counted,
    Strips,
    SuccessiveStrips,
    cast_strips,
    concatenate_strips,
    counting,
    find_sectors,
    find_touching,
    may_hide,
)
from toolkit.sites.site import Site, Solid
from toolkit.traffic.snapshots import Snapshot

CAR = make_body("car", VEHICLE, *box((4.0, 2.0, 1.5)))
WALL = Solid(np.array([[4.0, -6], [4.4, -6], [4.4, -3], [4, -3]]), 0.0, 4.0)
SITE = Site("walled", np.array([-20.0, -20, 20, 20]), solids=(WALL,))
COUNTED = Counted(Crop.from_place(SITE), 12.0)
BOXES = np.array(
    [
        *(
            [8.0, -4, 0.75, 4, 2, 1.5, 0.3],
            [8.0, 4, 0.75, 4, 2, 1.5, 1.0],
            [12.0, 4.5, 0.75, 4, 2, 1.5, 0.0],
        ),
        *([-20.0, 3.0, 0.75, 4, 2, 1.5, 0.0], [-8.0, -3.0, 0.75, 4, 2, 1.5, -2.0]),
    ]
)
EYES = np.array([[0.0, 0.0, 5.0], [-8.0, -3.0, 6.0]])  # the second one above a car


def find_strips(renderer, moment, viewpoints, counted, fine):
    return cast_strips(
        renderer, moment, viewpoints, counted, find_sectors(moment.ground, viewpoints, fine)
    )


@pytest.fixture(scope="module")
def scene():
    renderer = Renderer(SITE, (CAR,), (), threads=1)
    snapshot = Snapshot(Objects(BOXES, np.full(5, VEHICLE)), np.zeros(5, np.int64))
    return renderer, renderer.moment(snapshot)


@pytest.fixture(scope="module")
def strips(scene):
    return find_strips(scene[0], scene[1], EYES, COUNTED, np.ones(5, bool))


def shown(scene, eye, azimuth, elevation):
    """The object that each direction shows and what of it, by casting one ray."""
    renderer, moment = scene
    flat = np.cos(elevation)
    way = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    lines = np.concatenate([np.broadcast_to(eye, way.shape), way], axis=1).astype(np.float32)
    met, length = moment.met(lines)
    length = np.where(renderer.cast_still(lines) > length, length, np.inf)
    seen = np.isfinite(length)
    points = eye + way * np.where(seen, length, 0)[:, None]
    kind = np.where(is_inside(points, SITE.area, 4.0), WITHIN, OUTSIDE)
    kind[(kind == WITHIN) & (np.linalg.norm((points - eye)[:, :2], axis=1) > 12.0)] = BEYOND
    return np.where(seen, met, -1), np.where(seen, kind, 0)


@pytest.mark.parametrize("v", [0, 1])
def test_a_direction_lies_in_the_strip_of_what_it_shows(scene, strips, v):
    rng = np.random.default_rng(v)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 20_000), rng.uniform(-1.5, 0.0, 20_000)
    met, kind = shown(scene, EYES[v], azimuth, elevation)
    own = Strips(*(each[strips.viewpoint == v] for each in strips))
    within = np.zeros((20_000, len(own.item)), bool)
    for turn in (-2 * np.pi, 0, 2 * np.pi):
        across = (own.left <= azimuth[:, None] + turn) & (azimuth[:, None] + turn < own.right)
        within |= across & (own.bottom <= elevation[:, None]) & (elevation[:, None] < own.top)
    assert within.sum(axis=1).max() <= 2  # two objects may share a sliver at their common edge
    first = within.argmax(axis=1)
    some = within.any(axis=1)
    said = (
        np.where(some, own.item[first] if len(own.item) else -1, -1),
        np.where(some, own.shows[first], 0),
    )
    assert ((said[0] == met) & (said[1] == kind)).mean() > 0.994
    assert (met >= 0).sum() > 500


def test_strips_show_each_kind_and_walls_hide(strips, scene):
    first = strips.viewpoint == 0
    assert set(strips.shows[first & (strips.item == 3)]) == {
        BEYOND,
        OUTSIDE,
    }  # across the edge of the area
    assert set(strips.shows[first & (strips.item == 1)]) == {WITHIN}
    assert set(strips.item[first]) == {0, 1, 2, 3, 4}
    coarse = find_strips(
        scene[0], scene[1], EYES, COUNTED, np.array([True, False, True, True, True])
    )
    assert 2 * (coarse.item == 1).sum() < (strips.item == 1).sum()
    assert (coarse.item == 0).sum() == (strips.item == 0).sum()
    open_site = Renderer(Site("open", SITE.area), (CAR,), (), threads=1)
    free = find_strips(open_site, scene[1], EYES, COUNTED, np.ones(5, bool))

    def extent(some):
        own = (some.viewpoint == 0) & (some.item == 0)
        return float(((some.right - some.left) * (some.top - some.bottom))[own].sum())

    assert 0.05 < extent(strips) / extent(free) < 0.9


def test_boxes_have_their_solid_angle_and_nothing_none(scene):
    """A plate of 4 m by 1.5 m across the view, 20 m off, its middle at the height of the eye."""
    plate = make_body("plate", VEHICLE, *box((0.01, 4.0, 1.5)))
    renderer = Renderer(Site("open", SITE.area), (plate,), (), threads=1)
    boxes = np.array([[20.0, 0, 0.75, 0.01, 4, 1.5, 0.0]])
    moment = renderer.moment(Snapshot(Objects(boxes, np.array([VEHICLE])), np.zeros(1, np.int64)))
    for fine, within in ((True, 0.003), (False, 0.02)):
        s = find_strips(renderer, moment, np.array([[0.0, 0, 0.75]]), COUNTED, np.array([fine]))
        assert s.left.min() == pytest.approx(-np.arctan(2 / 19.995), abs=1e-5)
        assert s.right.max() == pytest.approx(np.arctan(2 / 19.995), abs=1e-5)
        angle = ((np.sin(s.top) - np.sin(s.bottom)) * (s.right - s.left)).sum()
        a, b, d = 2.0, 0.75, 19.995
        exact = 4 * np.arcsin(a * b / np.sqrt((a * a + d * d) * (b * b + d * d)))
        assert angle == pytest.approx(exact, rel=within)
    empty = scene[0].moment(
        Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64))
    )
    for some in (
        find_strips(scene[0], empty, EYES, COUNTED, np.zeros(0, bool)),
        concatenate_strips([]),
    ):
        assert [len(each) for each in some] == [0] * 7
    assert (
        len(find_strips(scene[0], scene[1], np.zeros((0, 3)), COUNTED, np.ones(5, bool)).item) == 0
    )
    assert counting(np.array([1, 0, 2])).tolist() == [0, 0, 1]


def test_portions_make_no_difference(scene, strips, limits):
    limits(module, RAYS_AT_ONCE=500)
    for one, other in zip(
        find_strips(scene[0], scene[1], EYES, COUNTED, np.ones(5, bool)), strips, strict=True
    ):
        np.testing.assert_array_equal(one, other)


TRUCK = make_body("truck", VEHICLE, *box((9.0, 2.5, 3.5)))
RENDERER = Renderer(SITE, (CAR, TRUCK), (), threads=1)

NEAR, FAR = (8.0, 4.0, 1.0), (13.0, 6.5, 0.3)  # x y yaw; from the first eye, one may hide the other
BESIDE, BELOW, AWAY = (8.0, -4.0, 0.3), (-8.0, -3.0, -2.0), (-15.0, 9.0, 0.0)


def moment_of(places, bodies=None):
    bodies = np.zeros(len(places), np.int64) if bodies is None else np.array(bodies)
    sizes = np.array([(CAR, TRUCK)[body].size for body in bodies]).reshape(-1, 3)
    xyw = np.array(places).reshape(-1, 3)
    boxes = np.column_stack([xyw[:, :2], sizes[:, 2] / 2, sizes, xyw[:, 2]])
    return RENDERER.moment(Snapshot(Objects(boxes, np.full(len(boxes), VEHICLE)), bodies))


def assert_same(one, other):
    for mine, theirs in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert mine.dtype == theirs.dtype


@pytest.fixture
def last_cast(spy):
    """Viewpoints and objects of what was cast last."""
    calls = spy(module, "cast_strips")

    def find_pairs():
        _, named = calls[-1]
        sectors = named["windows"]
        return set(zip(sectors.viewpoint.tolist(), sectors.item.tolist(), strict=True))

    return find_pairs


def test_strips_of_frames_bodies_and_grids(last_cast):
    frames: list[tuple[list[Any], set[tuple[int, int]]]] = [
        ([NEAR, FAR, BESIDE], {(v, n) for v in (0, 1) for n in range(3)}),
        ([BESIDE, NEAR, FAR], set()),  # all of them stand, in another order
        (
            [BESIDE, FAR, AWAY],
            {(0, 1), (0, 2), (1, 1), (1, 2)},
        ),  # what hid the far one is gone; one has come
        ([FAR, NEAR, BESIDE], {(0, 0), (0, 1), (1, 0), (1, 1)}),  # there again
        ([FAR, (8.1, 4.0, 1.0), BESIDE], {(0, 0), (0, 1), (1, 0), (1, 1)}),  # moves
        (
            [FAR, (8.1, 4.0, 1.0), AWAY],
            {(0, 2), (1, 2)},
        ),  # neither is hidden by what has come or gone
    ]
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for places, expected in frames:
        moment, all_fine = moment_of(places), np.ones(len(places), bool)
        made = strips.find_next(moment, all_fine)
        assert last_cast() == expected
        assert_same(made, find_strips(RENDERER, moment, EYES, COUNTED, all_fine))
    assert len(find_strips(RENDERER, moment_of([NEAR]), EYES, COUNTED, np.ones(1, bool)).item) > 50
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for bodies, fine, count in (
        ([0, 0], True, 4),
        ([0, 1], True, 2),
        ([0, 1], False, 4),
        ([0, 1], False, 0),
    ):
        moment, looked = moment_of([BESIDE, AWAY], bodies), np.full(2, fine)
        made = strips.find_next(moment, looked)
        assert len(last_cast()) == count
        assert_same(made, find_strips(RENDERER, moment, EYES, COUNTED, looked))


def test_random_frames_are_the_same_and_touch_what_they_change():
    rng, strips = np.random.default_rng(0), SuccessiveStrips(RENDERER, EYES, COUNTED)
    places = np.column_stack([rng.uniform(-18, 18, (14, 2)), rng.uniform(-3, 3, 14)])
    for _ in range(6):
        shown = np.sort(rng.choice(14, 11, replace=False))
        places[rng.integers(14), 0] += 1.0
        moment, fine = moment_of(places[shown], (shown % 3 == 0).astype(np.int64)), shown % 2 == 0
        assert_same(
            strips.find_next(moment, fine), find_strips(RENDERER, moment, EYES, COUNTED, fine)
        )
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for few in ([BESIDE, BESIDE], [BESIDE], [BESIDE, BESIDE], [], [NEAR], [NEAR, AWAY]):
        moment, fine = moment_of(few), np.ones(len(few), bool)
        assert_same(
            strips.find_next(moment, fine), find_strips(RENDERER, moment, EYES, COUNTED, fine)
        )
    nowhere = SuccessiveStrips(RENDERER, np.zeros((0, 3)), COUNTED)
    assert [len(nowhere.find_next(moment_of([NEAR]), np.ones(1, bool)).item) for _ in range(2)] == [
        0,
        0,
    ]
    ground = moment_of([(10.0, 0.0, 0.0), (25.0, 0.0, 0.0), (14.5, 0.0, 0.0)]).ground
    for height, expected in ((12.0, [[2, 0]]), (1.0, [[1, 0], [1, 2], [2, 0]])):
        eye = np.array([[0.0, 0.0, height]])
        found = may_hide(ground, eye, find_sectors(ground, eye, np.ones(3, bool)))
        assert np.argwhere(found[0]).tolist() == expected
    touching = [
        *(
            (0.0, 0.0, 0.0),
            (0.0, 2.1, 0.0),
            (0.0, -1.9, 0.0),
            (4.3, 2.2, np.pi / 4),
            (9.0, 0.0, 0.0),
            (13.0, 0.0, 0.5),
        )
    ]
    assert find_touching(moment_of(touching).ground).tolist() == [
        True,
        False,
        True,
        False,
        True,
        True,
    ]
    assert find_touching(moment_of(places[1:2]).ground).tolist() == [False]
    assert find_touching(moment_of([]).ground).tolist() == []


def test_what_may_hide_what(limits):
    ground = moment_of([NEAR, FAR, BESIDE, BELOW]).ground
    fine = np.ones(4, bool)
    found = may_hide(ground, EYES, find_sectors(ground, EYES, fine))
    assert np.argwhere(found[0]).tolist() == [[1, 0]]  # far ones are hidden by near ones alone
    assert not found[:, 2].any()
    assert not found[1, 3].any()  # right below: nothing begins nearer
    limits(module, PAIRS_AT_ONCE=1)
    np.testing.assert_array_equal(may_hide(ground, EYES, find_sectors(ground, EYES, fine)), found)
