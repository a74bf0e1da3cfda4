"""Corners: pedestrians walk round a house that their way leads through."""

import numpy as np
import pytest
import shapely

from toolkit.boxes import footprints
from toolkit.objects import PEDESTRIAN
from toolkit.sites.site import Site, Solid
from toolkit.traffic.corners import walk_round
from toolkit.traffic.course import Course
from toolkit.traffic.obstacles import Obstacles
from toolkit.traffic.occupancy import Occupancy, size_boxes
from toolkit.traffic.right_of_way import give_way

AREA = np.array([-40.0, -20, 40, 20])
PERSON = np.array([0.5, 0.6, 1.75])
LAST = 900
GAP_M = 0.14  # to parked vehicles


def block(house_y):
    """Occupancy with a house between two y (m), and its outline."""
    low, high = house_y
    house = Solid(np.array([[10, low], [16, low], [16, high], [10, high]]), 0.0, 8.0)
    site = Site("corner", AREA, solids=(house,))
    occupancy = Occupancy(AREA, Obstacles(site), np.zeros((0, 7)), LAST)
    return occupancy, shapely.Polygon(house.footprint)


def walk():
    """A pedestrian who walks along x through the area."""
    steps = np.arange(700)
    zeros = np.zeros(len(steps))
    poses = np.column_stack([-45 + 0.14 * steps, zeros, zeros])
    return Course(0, poses, PERSON, PEDESTRIAN)


@pytest.mark.parametrize("house_y", [(-12, 1.8), (-1.8, 12)], ids=["left", "right"])
def test_a_pedestrian_walks_round_a_house_on_the_shorter_side(house_y):
    occupancy, outline = block(house_y)
    poses = give_way(walk(), occupancy)
    assert poses is not None
    boxes = footprints(size_boxes(poses, PERSON))
    assert not shapely.intersects(shapely.polygons(boxes), outline).any()
    side = 1 if house_y[0] < -10 else -1
    assert 1.8 < (side * poses[:, 1]).max() < 3.0
    steps = np.diff(poses[:, :2], axis=0)
    assert np.hypot(*steps.T).max() < 0.2  # no leaps
    assert np.hypot(*np.diff(steps, axis=0).T).max() / 0.01 < 5  # m/s²
    assert poses[-1, 0] > 50
    assert abs(poses[-1, 1]) < 1e-6
    facing = np.arctan2(steps[:, 1], steps[:, 0])
    assert np.abs(poses[1:, 2] - facing).max() < 0.4


def test_a_house_too_wide_to_walk_round_refuses():
    occupancy, _ = block((-5.0, 5.0))
    assert walk_round(walk(), occupancy, gap=GAP_M) is None
    assert give_way(walk(), occupancy) is None


def test_a_free_course_stays():
    occupancy, _ = block((5.0, 12.0))
    course = walk()
    detour = walk_round(course, occupancy, gap=GAP_M)
    assert detour is not None
    np.testing.assert_allclose(detour.poses, course.poses, atol=1e-9)
