import numpy as np
import pytest

from toolkit.detection.samples.label_mistakes import (
    LABEL_MISTAKES,
    YAW_SIGN,
    boxes_through,
    degrees_of_turns,
    undone_in,
)
from toolkit.geometry import invert, pose

BOX = np.array([[3.0, 5.0, 1.0, 4.0, 2.0, 1.5, 0.4]])
OWN_INVERSE = ("mirrored", "y of the positions", "x and y swapped", "length and width", "yaw counted")


@pytest.mark.parametrize("mistake", LABEL_MISTAKES, ids=lambda mistake: mistake.name[:12])
def test_a_mistake_changes_boxes_and_some_undo_themselves(mistake):
    assert not np.allclose(mistake.undo(BOX), BOX)
    again = mistake.undo(mistake.undo(BOX))
    again[:, 6] = np.angle(np.exp(1j * again[:, 6]))
    assert np.allclose(again, BOX) is mistake.name.startswith(OWN_INVERSE)
    assert mistake.axes is (mistake.name.startswith(("mirrored", "y of", "x and y", "yaw counted", "yaw in radians")))


@pytest.mark.parametrize(
    ("place", "undone"),
    [
        (0, [3, -5, 1, 4, 2, 1.5, -0.4]),
        (1, [-3, 5, 1, 4, 2, 1.5, np.pi - 0.4]),
        (2, [3, -5, 1, 4, 2, 1.5, 0.4]),
        (3, [5, 3, 1, 4, 2, 1.5, np.pi / 2 - 0.4]),
        (4, [3, 5, 1, 8, 4, 3, 0.4]),
        (5, [3, 5, 1, 2, 1, 0.75, 0.4]),
        (6, [3, 5, 1, 2, 4, 1.5, 0.4]),
        (7, [3, 5, 1, 4, 2, 1.5, -0.4]),
        (8, [3, 5, 1, 4, 2, 1.5, np.rad2deg(0.4)]),
    ],
)
def test_what_undoes_each(place, undone):
    np.testing.assert_allclose(LABEL_MISTAKES[place].undo(BOX)[0], undone)


def test_a_mistake_made_in_a_map_is_undone_there():
    world_SE3_map = invert(pose(600.0, 1600.0, 30.0, yaw=0.7))
    in_map = boxes_through(BOX, invert(world_SE3_map))
    mirrored = LABEL_MISTAKES[0].undo(in_map)
    assert np.abs(boxes_through(mirrored, world_SE3_map)[0, :2]).max() > 1000
    back = undone_in(LABEL_MISTAKES[0], boxes_through(mirrored, world_SE3_map), invert(world_SE3_map))
    np.testing.assert_allclose(back, BOX, atol=1e-9)
    np.testing.assert_array_equal(undone_in(YAW_SIGN, BOX, np.eye(4)), YAW_SIGN.undo(BOX))


@pytest.mark.parametrize("yaw", np.linspace(-1.5, 1.5, 7))
def test_the_true_heading_is_among_those_that_degrees_leave_open(yaw):
    stored = np.angle(np.exp(1j * np.rad2deg(yaw)))
    headings = degrees_of_turns(np.array([stored]))
    assert np.abs(headings - yaw).min() < 1e-9
    assert len(headings) == 31
