"""Lines of sight end at walls, and not at what they lead to."""

import numpy as np
import pytest

from toolkit.mesh import box, merge
from toolkit.rendering.sight_lines import GRAZE, SightLines
from toolkit.sensors.model import NEAR

WALL = box((0.2, 4.0, 3.0), (5.0, 0.0, 1.5))


def test_a_wall_hides_what_the_lines_through_it_lead_to():
    rng = np.random.default_rng(3)
    start, ends = np.array([0.0, 0.3, 2.0]), rng.uniform((6, -9, 0), (20, 9, 4), (4000, 3))
    share = (4.9 - start[0]) / (ends[:, 0] - start[0])  # of the way to the face, and to the back
    hidden = np.zeros(len(ends), bool)
    for s in (share, (5.1 - start[0]) / (ends[:, 0] - start[0])):
        _, y, z = (start + s[:, None] * (ends - start)).T
        hidden |= (np.abs(y) < 2) & (z > 0) & (z < 3)
    y0, y1 = ((start + s[:, None] * (ends - start))[:, 1] for s in (share, 5.1 / ends[:, 0]))
    sure = (np.minimum(abs(y0), abs(y1)) > 2) == (np.maximum(abs(y0), abs(y1)) > 2)  # not through a narrow end
    assert 0.1 < hidden.mean() < 0.9
    assert np.array_equal(SightLines(WALL, threads=1).clear(start, ends)[sure], ~hidden[sure])


@pytest.mark.parametrize(("distance", "seen"), [(0.0, False), (NEAR - 0.01, False), (NEAR + 0.01, True), (4.0, True)])
def test_nothing_nearer_than_a_sensor_measures_is_seen(distance, seen):
    assert SightLines(WALL).clear(np.zeros(3), np.array([[distance, 0.0, 0.0]])).tolist() == [seen]


def test_what_stands_nearer_than_a_sensor_measures_hides_nothing():
    own_post = box((0.1, 0.1, 6.0), (0.1, 0.0, 0.0))
    ends = np.array([[4.0, 0.0, 1.0], [9.0, 0.0, 1.0]])
    assert SightLines(merge([own_post, WALL])).clear(np.array([0.0, 0, 1]), ends).tolist() == [True, False]


def test_a_surface_does_not_hide_its_own_points():
    face = np.array([[4.9, 0.0, 1.0], [4.9 + GRAZE / 2, 0, 1], [4.9 + 3 * GRAZE, 0, 1]])
    assert SightLines(WALL).clear(np.array([0.0, 0, 1]), face).tolist() == [True, True, False]
