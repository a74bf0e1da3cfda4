"""Anchors and residuals: a box encoded and decoded is itself."""

import math

import numpy as np
import torch
from hypothesis import given, settings, strategies as st

from models.config import VoxelNetConfig, road_users
from models.network.grid import anchors, decode, encode_residuals, faces_back, per_anchor

ANCHOR = torch.tensor([1.0, 2.0, 0.8, 3.9, 1.6, 1.5, math.pi / 2], dtype=torch.float64)
sizes, yaws = st.floats(0.2, 20), st.floats(-7, 7)


@settings(deadline=None)
@given(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3), sizes, sizes, sizes, yaws))
def test_a_box_encoded_and_decoded_is_itself(box):
    box = torch.tensor(box, dtype=torch.float64)
    torch.testing.assert_close(decode(encode_residuals(box, ANCHOR, doubled=False), ANCHOR), box)
    doubled = decode(encode_residuals(box, ANCHOR), ANCHOR, faces_back(box, ANCHOR))
    torch.testing.assert_close(doubled[:6], box[:6])
    if abs(math.cos(box[6] - ANCHOR[6])) > 1e-6:  # at right angles both directions are as good
        turns = float(doubled[6] - box[6]) / (2 * math.pi)
        assert abs(turns - round(turns)) < 1e-6


@settings(deadline=None)
@given(yaws)
def test_a_box_and_its_half_turn_have_the_same_residuals_and_opposite_bits(yaw):
    box = torch.tensor([0, 0, 0, 4, 2, 1, yaw], dtype=torch.float64)
    turned = box + torch.tensor([0, 0, 0, 0, 0, 0, math.pi])
    torch.testing.assert_close(
        encode_residuals(box, ANCHOR), encode_residuals(turned, ANCHOR), atol=1e-6, rtol=0
    )
    if abs(math.cos(yaw - ANCHOR[6])) > 1e-6:
        assert faces_back(box, ANCHOR) != faces_back(turned, ANCHOR)


def test_anchors_of_classes_stand_in_the_middle_of_their_cells():
    box = torch.tensor([2.0, 3.0, 1.0, 4.0, 2.0, 1.5, 0.1], dtype=torch.float64)
    x, y, z, length, width, height, yaw = ANCHOR.tolist()
    diagonal = math.hypot(length, width)
    expected = [(2 - x) / diagonal, (3 - y) / diagonal, (1 - z) / height]
    expected += [math.log(4 / length), math.log(2 / width), math.log(1.5 / height), 0.1 - yaw]
    np.testing.assert_allclose(encode_residuals(box, ANCHOR, doubled=False), expected)
    config = VoxelNetConfig.from_paper("roundabout")
    boxes = anchors(config)
    assert boxes.shape == (*config.map_shape, 2, 7) == (120, 120, 2, 7)
    np.testing.assert_allclose(boxes[0, 1, 0, :6], [-47.6, -46.8, 1.6, 3.9, 1.56, 1.6], rtol=1e-6)
    np.testing.assert_allclose(boxes[119, 119, :, 0], 47.6, rtol=1e-6)
    np.testing.assert_allclose(boxes[5, 5, :, 6], [0, math.pi / 2], rtol=1e-6)
    by_anchor = per_anchor(torch.arange(14.0)[None, :, None, None].expand(1, 14, 3, 2), 2)
    assert by_anchor.shape == (1, 3, 2, 2, 7)
    assert by_anchor[0, 2, 1, 1].tolist() == list(range(7, 14))
    config = VoxelNetConfig.light((-8, -8, 8, 8), **road_users())
    boxes = anchors(config)
    assert boxes.shape == (40, 40, 7, 7)
    turn = math.pi / 2
    expected = [
        *(
            [0.8, 3.9, 1.56, 1.6, 0],
            [0.8, 3.9, 1.56, 1.6, turn],
            [1.6, 9.0, 2.5, 3.2, 0],
            [1.6, 9.0, 2.5, 3.2, turn],
        ),
        *([0.85, 1.8, 0.65, 1.65, 0], [0.85, 1.8, 0.65, 1.65, turn], [0.85, 0.65, 0.6, 1.7, 0]),
    ]
    torch.testing.assert_close(boxes[3, 5, :, 2:], torch.tensor(expected))
    torch.testing.assert_close(
        boxes[:, :, 6, :2], anchors(VoxelNetConfig.light((-8, -8, 8, 8)))[:, :, 0, :2]
    )
    torch.testing.assert_close(boxes[:, :, :2], anchors(VoxelNetConfig.light((-8, -8, 8, 8))))
