"""Strips of frame after frame are those of each frame by itself, to the last bit, and fewer are cast."""

from typing import Any

import numpy as np
import pytest

from toolkit.bodies.body import centred
from toolkit.mesh import box
from toolkit.objects import VEHICLE, Objects
from toolkit.points import Crop
from toolkit.rendering import successive
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.strips import Counted, sectors_of, strips_in, strips_of
from toolkit.rendering.successive import SuccessiveStrips, may_hide, touching
from toolkit.sites.site import Site, Solid
from toolkit.traffic.snapshots import Snapshot

CAR = centred("car", VEHICLE, *box((4.0, 2.0, 1.5)))
TRUCK = centred("truck", VEHICLE, *box((9.0, 2.5, 3.5)))
WALL = Solid(np.array([[4.0, -6], [4.4, -6], [4.4, -3], [4, -3]]), 0.0, 4.0)
SITE = Site("walled", np.array([-20.0, -20, 20, 20]), solids=(WALL,))
COUNTED = Counted(Crop.of(SITE), 12.0)
EYES = np.array([[0.0, 0.0, 5.0], [-8.0, -3.0, 6.0]])  # the second one above `BELOW`
RENDERER = Renderer(SITE, (CAR, TRUCK), (), threads=1)

NEAR, FAR = (8.0, 4.0, 1.0), (13.0, 6.5, 0.3)  # x y yaw; from the first eye, one may hide the other
BESIDE, BELOW, AWAY = (8.0, -4.0, 0.3), (-8.0, -3.0, -2.0), (-15.0, 9.0, 0.0)


def moment_of(places, bodies=None):
    """Cars there, or other bodies."""
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
def cast(monkeypatch):
    """Viewpoint and object of what is cast, frame after frame."""
    found: list[set[tuple[int, int]]] = []

    def noted(renderer: Any, moment: Any, viewpoints: Any, counted: Any, sectors: Any) -> Any:
        found.append(set(zip(sectors.viewpoint.tolist(), sectors.item.tolist(), strict=True)))
        return strips_in(renderer, moment, viewpoints, counted, sectors)

    monkeypatch.setattr(successive, "strips_in", noted)
    return found


def test_each_frame_has_its_strips_and_what_nothing_changes_is_not_cast(cast):
    frames: list[tuple[list[Any], set[tuple[int, int]]]] = [
        ([NEAR, FAR, BESIDE], {(v, n) for v in (0, 1) for n in range(3)}),
        ([BESIDE, NEAR, FAR], set()),  # all of them stand, in another order
        ([BESIDE, FAR, AWAY], {(0, 1), (0, 2), (1, 1), (1, 2)}),  # what hid the far one is gone; one has come
        ([FAR, NEAR, BESIDE], {(0, 0), (0, 1), (1, 0), (1, 1)}),  # there again
        ([FAR, (8.1, 4.0, 1.0), BESIDE], {(0, 0), (0, 1), (1, 0), (1, 1)}),  # moves
        ([FAR, (8.1, 4.0, 1.0), AWAY], {(0, 2), (1, 2)}),  # neither is hidden by what has come or gone
    ]
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for places, expected in frames:
        moment, fine = moment_of(places), np.ones(len(places), bool)
        assert_same(strips.of(moment, fine), strips_of(RENDERER, moment, EYES, COUNTED, fine))
        assert cast[-1] == expected
    assert len(strips_of(RENDERER, moment_of([NEAR]), EYES, COUNTED, np.ones(1, bool)).item) > 50


def test_another_body_or_grid_is_another_object(cast):
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for bodies, fine, count in (([0, 0], True, 4), ([0, 1], True, 2), ([0, 1], False, 4), ([0, 1], False, 0)):
        moment, looked = moment_of([BESIDE, AWAY], bodies), np.full(2, fine)
        assert_same(strips.of(moment, looked), strips_of(RENDERER, moment, EYES, COUNTED, looked))
        assert len(cast[-1]) == count


def test_random_frames_are_the_same():
    rng, strips = np.random.default_rng(0), SuccessiveStrips(RENDERER, EYES, COUNTED)
    places = np.column_stack([rng.uniform(-18, 18, (14, 2)), rng.uniform(-3, 3, 14)])
    for _ in range(6):
        shown = np.sort(rng.choice(14, 11, replace=False))
        places[rng.integers(14), 0] += 1.0
        moment, fine = moment_of(places[shown], (shown % 3 == 0).astype(np.int64)), shown % 2 == 0
        assert_same(strips.of(moment, fine), strips_of(RENDERER, moment, EYES, COUNTED, fine))


def test_one_in_the_other_and_nothing_at_all():
    strips = SuccessiveStrips(RENDERER, EYES, COUNTED)
    for places in ([BESIDE, BESIDE], [BESIDE], [BESIDE, BESIDE], [], [NEAR], [NEAR, AWAY]):
        moment, fine = moment_of(places), np.ones(len(places), bool)
        assert_same(strips.of(moment, fine), strips_of(RENDERER, moment, EYES, COUNTED, fine))
    nowhere = SuccessiveStrips(RENDERER, np.zeros((0, 3)), COUNTED)
    assert [len(nowhere.of(moment_of([NEAR]), np.ones(1, bool)).item) for _ in range(2)] == [0, 0]


def test_what_may_hide_what(monkeypatch):
    ground = moment_of([NEAR, FAR, BESIDE, BELOW]).ground
    fine = np.ones(4, bool)
    found = may_hide(ground, EYES, sectors_of(ground, EYES, fine))
    assert np.argwhere(found[0]).tolist() == [[1, 0]]  # far ones are hidden by near ones alone
    assert not found[:, 2].any()
    assert not found[1, 3].any()  # right below: nothing begins nearer
    monkeypatch.setattr(successive, "PAIRS_AT_ONCE", 1)
    np.testing.assert_array_equal(may_hide(ground, EYES, sectors_of(ground, EYES, fine)), found)


def test_one_may_be_seen_over_another():
    ground = moment_of([(10.0, 0.0, 0.0), (25.0, 0.0, 0.0), (14.5, 0.0, 0.0)]).ground
    for height, expected in ((12.0, [[2, 0]]), (1.0, [[1, 0], [1, 2], [2, 0]])):
        eye = np.array([[0.0, 0.0, height]])
        found = may_hide(ground, eye, sectors_of(ground, eye, np.ones(3, bool)))
        assert np.argwhere(found[0]).tolist() == expected


def test_what_touches_what():
    places = [
        (0.0, 0.0, 0.0),
        (0.0, 2.1, 0.0),
        (0.0, -1.9, 0.0),
        (4.3, 2.2, np.pi / 4),
        (9.0, 0.0, 0.0),
        (13.0, 0.0, 0.5),
    ]
    assert touching(moment_of(places).ground).tolist() == [True, False, True, False, True, True]
    assert touching(moment_of(places[1:2]).ground).tolist() == [False]
    assert touching(moment_of([]).ground).tolist() == []
