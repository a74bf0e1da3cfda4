import numpy as np
import pytest

from toolkit.sites.site import Site, Solid
from toolkit.traffic.collisions import GAP, Obstacles, overlaps, separate

AREA = np.array([-50.0, -50, 50, 50])
FREE = Obstacles(Site("free", AREA))
CAR = np.array([0.0, 0, 0.75, 4, 2, 1.5, 0])


def wall(x0, y0, x1, y1, base=0.0, top=2.0, kind="wall"):
    return Solid(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float), base, top, kind)


def cars(*offsets):
    return CAR + [[x, y, 0, 0, 0, 0, yaw] for x, y, yaw in offsets]


def test_what_is_apart_stays_as_it_is():
    boxes = cars((0, 0, 0), (0, 2.0 + 2 * GAP, 0), (10, 0, 1))
    settled, kept, repaired = separate(boxes, FREE)
    assert settled is boxes
    assert kept.all()
    assert repaired == 0


def test_the_later_row_steps_aside():
    boxes = cars((0, 0, 0), (0, 1.8, 0))
    settled, kept, repaired = separate(boxes, FREE)
    assert kept.all()
    assert repaired == 1
    assert np.array_equal(settled[0], boxes[0])
    assert settled[1, 1] == pytest.approx(2.3)
    assert not overlaps(settled).any()


def test_what_finds_no_room_is_dropped():
    settled, kept, repaired = separate(cars((0, 0, 0), (0, 4.2, 0), (0, 2.1, 0)), FREE)
    assert kept.tolist() == [True, True, False]
    assert repaired == 1
    assert not overlaps(settled[kept]).any()


def test_a_dropped_row_is_in_nobodys_way():
    boxes = cars((0, 0, 0), (0.5, 0, np.pi / 2), (0.5, 3.2, 0))  # the third touches only the second
    _, kept, _ = separate(boxes, FREE)
    assert kept.tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("solid", "moves"),
    [
        (wall(-5, 0.9, 5, 1.2), True),
        (wall(-5, 0.9, 5, 1.2, top=0.12, kind="kerb"), False),
        (wall(-5, 0.9, 5, 1.2, base=1.0, top=4.0, kind="tree"), True),
        (wall(-5, 0.9, 5, 1.2, base=2.5, top=4.0, kind="tree"), False),
        (wall(-5, 0.9, 5, 1.2, base=-1.5, top=-0.5, kind="pond"), False),
    ],
)
def test_obstacles(solid, moves):
    _, kept, repaired = separate(cars((0, 0, 0)), Obstacles(Site("walled", AREA, solids=(solid,))))
    assert kept.all()
    assert repaired == moves


def test_nothing():
    boxes = np.zeros((0, 7))
    settled, kept, repaired = separate(boxes, FREE)
    assert settled.shape == (0, 7)
    assert kept.shape == (0,)
    assert repaired == 0
    assert overlaps(boxes).shape == (0, 0)


def test_random_heaps_end_apart():
    rng = np.random.default_rng(0)
    obstacles = Obstacles(Site("walled", AREA, solids=(wall(-3, -3, 3, -2), wall(4, -9, 5, 9))))
    for _ in range(50):
        boxes = cars(*rng.uniform([-12, -12, -4], [12, 12, 4], (25, 3)))
        settled, kept, _ = separate(boxes, obstacles)
        assert not overlaps(settled[kept]).any()
        assert not obstacles.hit(settled[kept]).any()
        assert kept[0] or obstacles.hit(boxes[:1]).any()
