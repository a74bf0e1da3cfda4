"""Pieces of a foreground, in which order they are sent, and how many fit."""

import numpy as np
import pytest

from toolkit.detection.sharing.foreground_groups import KNOWN, MISSED, SPECK, fitting, foreground_groups, ranked
from toolkit.detection.sharing.requests import Request
from toolkit.objects import Detections

SHAPE = (4, 10)
PIXELS = np.array([0, 1, 2, 5, 6, 9, 11, 15, 16, 25, 26])
BOXES = np.array([[0.0, 0.0, 0.5, 2.2, 2.0, 1.0, 0.0], [5.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.0]])
NONE = Request(0, np.zeros((0, 3)), np.zeros(0))


def points():
    """Three in the first box, one a little beside it, six that are connected, one alone."""
    xyz = np.zeros((len(PIXELS), 3), np.float32)
    xyz[:3] = [[0, 0, 0.5], [1, 0, 0.5], [1.3, 0, 0.5]]  # 0.2 m beyond the box
    xyz[3:5] = xyz[7:] = [20.0, 4.0, 0.5]
    xyz[5] = [-30.0, 0.0, 0.5]
    xyz[6] = [0.5, 0.5, 0.5]
    return xyz


def split():
    return foreground_groups(PIXELS, points(), SHAPE, BOXES)


def test_boxes_own_their_pixels_and_the_rest_is_connected():
    groups = split()
    assert groups.sizes.tolist() == [4, 6, 1]
    assert groups.box.tolist() == [0, -1, -1]
    assert groups.of.tolist() == [0, 0, 0, 1, 1, 2, 0, 1, 1, 1, 1]
    np.testing.assert_allclose(groups.centres, [[0.7, 0.125], [20, 4], [-30, 0]], atol=1e-6)


def test_a_box_itself_goes_before_the_margin_of_another():
    beside = np.array([[0.0, 0.0, 0.5, 2.0, 2.0, 1.0, 0.0], [2.0, 0.0, 0.5, 1.6, 2.0, 1.0, 0.0]])
    xyz = np.array([[1.2, 0, 0.5], [1.1, 0, 0.5]], np.float32)
    assert foreground_groups(np.array([0, 1]), xyz, (1, 2), beside).box[0] == 0
    xyz[0, 0] = 1.25
    assert foreground_groups(np.array([0, 1]), xyz, (1, 2), beside).box.tolist() == [0, 1]


def test_unasked_the_unexplained_go_first_and_specks_last():
    ranks = ranked(split(), NONE, Detections(BOXES, np.array([0.9, 0.5])))
    assert ranks.order.tolist() == [1, 0, 2]
    np.testing.assert_allclose(ranks.worth, [KNOWN + 0.025, MISSED, SPECK])


def test_what_is_asked_for_goes_first_in_the_order_of_the_request():
    asked = Request(0, np.array([[20.0, 5.5, 1.0], [0.0, 0.0, 2.0]]), np.array([0.5, 1.5]))
    ranks = ranked(split(), asked, Detections(BOXES, np.array([0.9, 0.5])))
    assert ranks.order.tolist() == [1, 0, 2]
    np.testing.assert_allclose(ranks.worth, [1.5, 0.5, SPECK])
    turned = Request(0, asked.places[::-1], asked.gains[::-1])
    assert ranked(split(), turned, Detections(BOXES, np.array([0.9, 0.5]))).order.tolist() == [0, 1, 2]
    beyond = Request(0, np.array([[20.0, 5.6, 1.0]]), np.array([0.5]))  # 1.6 m off, more than 1.0 and the reach
    assert ranked(split(), beyond, Detections(BOXES, np.array([0.9, 0.5]))).worth[1] == MISSED


def test_pieces_of_one_place_share_its_gain_by_their_pixels():
    asked = Request(0, np.array([[0.0, 0.0, 40.0]]), np.array([1.0]))
    worth = ranked(split(), asked, Detections(BOXES, np.array([0.9, 0.5]))).worth
    np.testing.assert_allclose(worth, [0.4, 0.6, SPECK])  # specks are never asked for


def encoded(taken):
    return bytes(40 + 2 * int(np.array([30, 10, 20])[taken].sum()))


@pytest.mark.parametrize(
    ("most", "taken"),
    [(160, [1, 1, 1]), (159, [1, 1, 0]), (120, [1, 1, 0]), (119, [1, 0, 0]), (99, [0, 1, 0]),
     (60, [0, 1, 0]), (59, None)],
)  # fmt: skip
def test_as_many_as_fit_one_after_another(most, taken):
    order, sizes = np.arange(3), np.array([30, 10, 20])
    found = fitting(order, sizes, encoded, 8 * most)
    if taken is None:
        assert found is None
        return
    assert found is not None
    message, chosen = found
    assert len(message) <= most
    assert chosen.tolist() == [bool(each) for each in taken]


def test_without_pieces_there_is_no_message():
    assert fitting(np.zeros(0, int), np.zeros(0, int), lambda taken: bytes(10), 1000) is None
