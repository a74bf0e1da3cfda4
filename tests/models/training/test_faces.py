"""Training of the second stage on boxes of solid colour: it finds where the points end."""

import numpy as np
import pytest
import torch

from models.network.faces import SORTS, FaceNetworks, face_features, face_offsets, measured
from models.network.voxelnet import VoxelNet
from models.training.faces import (
    FARTHEST_FACE,
    FaceExamples,
    face_examples,
    fit_faces,
    off_at_random,
    with_faces,
)
from models.training.presets import config_for
from toolkit.boxes import iou_3d
from toolkit.objects import VEHICLE, Detections

AREA = (-12.8, -12.8, 12.8, 12.8)


def solid(rng, box, count=400):
    """Points all over a box, on its sides and its top."""
    points = rng.uniform(-0.5, 0.5, (count, 3))
    face = rng.integers(0, 5, count)
    for number, (axis, at) in enumerate([(0, 0.5), (0, -0.5), (1, 0.5), (1, -0.5), (2, 0.5)]):
        points[face == number, axis] = at
    points = points * box[3:6] + rng.normal(0, 0.015, (count, 3))
    cos, sin = np.cos(box[6]), np.sin(box[6])
    return points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + box[:3]


def scene(rng):
    size = rng.uniform([3.0, 1.45, 1.25], [6.0, 2.2, 2.6])
    truth = np.array([[*rng.normal(0, 3, 2), size[2] / 2, *size, rng.uniform(-4, 4)]])
    return solid(rng, truth[0]), off_at_random(truth, rng), truth


def examples(count, seed=0):
    rng = np.random.default_rng(seed)
    seen, offsets = {sort: [] for sort in SORTS}, {sort: [] for sort in SORTS}
    for _ in range(count):
        points, box, truth = scene(rng)
        features = face_features(points, box, np.array([VEHICLE]))
        for number, (sort, offset) in enumerate(zip(SORTS, face_offsets(box, truth), strict=True)):
            seen[sort].append(features[number])
            offsets[sort].append(offset.astype(np.float32))
    return FaceExamples(*({sort: np.concatenate(rows) for sort, rows in each.items()} for each in (seen, offsets)))


def test_it_learns_where_faces_are_whatever_the_size():
    torch.manual_seed(3)
    networks = FaceNetworks()
    figures = fit_faces(networks, examples(300), steps=250)
    assert all(figures[f"{sort} after"] < 0.45 * figures[f"{sort} before"] for sort in SORTS)
    np.testing.assert_allclose(networks.prior, [figures[f"{sort} before"] for sort in SORTS], rtol=1e-6)
    rng = np.random.default_rng(9)
    before, after = [], []
    for _ in range(30):
        points, box, truth = scene(rng)
        found = measured(networks, Detections(box, np.array([0.9])), points, ("vehicle",))
        before.append(iou_3d(box, truth)[0, 0])
        after.append(iou_3d(found.boxes, truth)[0, 0])
    assert np.mean(after) > np.mean(before) + 0.06


def test_training_is_the_same_every_time_and_leaves_the_generator_alone():
    rows = examples(20)
    first, second = FaceNetworks(), FaceNetworks()
    for networks in (first, second):
        torch.rand(5)
        state = torch.get_rng_state()
        fit_faces(networks, rows, steps=5)
        assert torch.equal(torch.get_rng_state(), state)
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_faces_that_are_too_far_off_teach_no_more_than_the_farthest():
    rows = examples(20)
    far = FaceExamples(rows.features, {sort: np.full_like(each, 5.0) for sort, each in rows.offsets.items()})
    assert fit_faces(FaceNetworks(), far, steps=1)["end before"] == pytest.approx(FARTHEST_FACE)


def test_without_examples_it_says_so():
    rows = examples(3)
    with pytest.raises(ValueError, match="no examples of a side"):
        fit_faces(FaceNetworks(), FaceExamples(rows.features, rows.offsets | {"side": np.zeros(0)}), steps=1)


def test_boxes_off_at_random_stay_on_their_floors_and_near():
    rng = np.random.default_rng(0)
    boxes = np.tile([[5.0, 2, 0.9, 4.4, 1.8, 1.6, 0.3], [1, 1, 1.0, 0.6, 0.6, 1.8, 2.0]], (400, 1))
    off = off_at_random(boxes, rng)
    np.testing.assert_allclose(off[:, 2] - off[:, 5] / 2, boxes[:, 2] - boxes[:, 5] / 2)
    deviation = (off - boxes)[::2].std(axis=0)
    np.testing.assert_allclose(deviation[[0, 1, 3, 4, 5]], [0.1, 0.1, 0.264, 0.126, 0.08], rtol=0.12)
    assert (off - boxes)[1::2, :2].std() == pytest.approx(0.1 / 3, rel=0.12)
    assert (np.cos(off[:, 6] - boxes[:, 6]) < 0).mean() == pytest.approx(0.1, abs=0.03)


def test_examples_are_of_the_objects_asked_for(packed):
    vehicles = face_examples(packed, None, ("vehicle",), count=4)
    assert all(len(vehicles.features[sort]) == len(vehicles.offsets[sort]) > 0 for sort in SORTS)
    assert (vehicles.features["end"][:, -4:] == [1, 0, 0, 0]).all()
    both = face_examples(packed, None, ("vehicle", "heavy"), count=4)
    assert {0, 3} == set(both.features["end"][:, -4:].argmax(axis=1).tolist())
    again = face_examples(packed, None, ("vehicle",), count=4)
    np.testing.assert_array_equal(again.features["side"], vehicles.features["side"])
    assert len(face_examples(packed, None, ("vehicle",), count=2).offsets["end"]) < len(vehicles.offsets["end"])


def test_a_network_gets_a_second_stage_and_is_else_what_it_was(packed, monkeypatch):
    monkeypatch.setattr("models.training.faces.fit_faces", lambda networks, rows, seed: {})
    torch.manual_seed(0)
    network = VoxelNet(config_for(AREA, "fast"))
    staged = with_faces(network, packed, ("vehicle",), count=2)
    assert staged.config.faces == ("vehicle",)
    for name, tensor in network.state_dict().items():
        assert torch.equal(staged.state_dict()[name], tensor)
    assert len(staged.state_dict()) == len(network.state_dict()) + 19
