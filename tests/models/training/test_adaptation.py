"""Detections joined over time, and a network that is fitted to them."""

import copy

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.network.voxelnet import VoxelNet
from models.training import adaptation
from models.training.adaptation import adapt_network, join_detections
from models.training.loop import Machine
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections

TIMES = np.arange(12) * 0.5


def car(x, y=0.0, score=0.9, label=VEHICLE):
    return [x, y, 0.8, 4.2, 1.8, 1.6, 0.1], score, label


def frames(*objects):
    """Detections of each frame; an object is a list with an entry per frame, None where it is not
    found."""
    found = []
    for each in zip(*objects, strict=True):
        there = [one for one in each if one is not None]
        boxes, scores, labels = zip(*there, strict=True) if there else ((), (), ())
        found.append(
            Detections(np.array(boxes).reshape(-1, 7), np.array(scores), np.array(labels, int))
        )
    return found


def test_what_is_found_before_and_after_is_there_in_between_if_it_went_hardly_on():
    walking = [car(0.6 * k, label=PEDESTRIAN) for k in range(12)]
    passing = [car(-20 + 4.0 * k, 9.0) for k in range(12)]
    waiting = [car(3.0, -9.0, score=0.7) for _ in range(12)]
    for each in (walking, passing, waiting):
        each[5] = each[6] = None
    waiting[3:9] = [None] * 6  # traffic passes before it, for too long to say that it stayed
    joined = join_detections(frames(walking, passing, waiting), TIMES)
    assert [len(each) for each in joined] == [3, 3, 3, 2, 2, 1, 1, 2, 2, 3, 3, 3]
    for k, there in enumerate(joined):
        np.testing.assert_allclose(there.boxes[there.labels == PEDESTRIAN, 0], [0.6 * k], atol=1e-9)
    assert len({*joined[0].ids, *joined[11].ids}) == 3


def test_a_slow_cyclist_is_there_in_between_and_a_faster_one_is_not():
    for step, there in ((0.3, 1), (0.6, 0)):
        riding = [car(step * k, label=CYCLIST) for k in range(12)]
        riding[5] = riding[6] = None
        assert [len(each) for each in join_detections(frames(riding), TIMES)][5:7] == [there, there]


def test_one_that_never_moves_needs_higher_scores_and_chance_finds_none():
    passing = [car(-20 + 4.0 * k, score=0.55) for k in range(12)]
    bush = [car(3.0, 9.0, score=0.55) for _ in range(12)]
    once = [None] * 7 + [car(-9.0, -9.0, score=0.95)] + [None] * 4
    joined = join_detections(frames(passing, bush, once), TIMES)
    assert [each.boxes[:, 0].tolist() for each in joined] == [[-20 + 4.0 * k] for k in range(12)]


def test_a_track_has_one_class_and_neighbours_stay_apart():
    rider = [car(-10 + 2.0 * k, label=CYCLIST if k % 3 else PEDESTRIAN) for k in range(12)]
    other = [car(-10 + 0.6 * k, 3.0, label=PEDESTRIAN) for k in range(12)]
    joined = join_detections(frames(rider, other), TIMES)
    assert {tuple(each.labels) for each in joined} == {(CYCLIST, PEDESTRIAN)}
    assert {tuple(each.ids) for each in joined} == {(0, 1)}
    fast = [car(-10 + 2.0 * k, label=PEDESTRIAN) for k in range(12)]
    assert {tuple(each.labels) for each in join_detections(frames(fast), TIMES)} == {(CYCLIST,)}
    assert join_detections([], []) == []
    assert [len(each) for each in join_detections(frames([None, None]), TIMES[:2])] == [0, 0]


def test_boxes_are_of_the_class_of_their_track_and_head_where_it_goes():
    def rider(k):
        if k % 3:
            return [2.0 * k - 10, 0.0, 0.9, 1.8, 0.6, 1.8, 3.2], 0.9, CYCLIST  # backwards
        return [2.0 * k - 10, 0.0, 0.8, 0.7, 0.6, 1.6, 1.2], 0.9, PEDESTRIAN

    for there in join_detections(frames([rider(k) for k in range(12)]), TIMES):
        np.testing.assert_allclose(there.boxes[0, 2:6], [0.9, 1.8, 0.6, 1.8])
        assert np.cos(there.boxes[0, 6]) > 0.99
    way = np.radians(100.0)
    ridden = [
        ([k * np.cos(way), k * np.sin(way), 0.9, 1.8, 0.6, 1.8, way + 3.2], 0.9, CYCLIST)
        for k in range(12)
    ]
    for there in join_detections(frames(ridden), TIMES):
        assert np.cos(there.boxes[0, 6] - way) > 0.99
    waiting = [
        ([0.0, 0.0, 0.9, 1.8, 0.6, 1.8, 3.2], 0.9, CYCLIST if k else PEDESTRIAN) for k in range(12)
    ]
    assert {float(there.boxes[0, 6]) for there in join_detections(frames(waiting), TIMES)} == {3.2}


def test_one_object_found_as_two_is_the_surer_or_the_lorry():
    rider = [car(1.0 * k - 10, score=0.9, label=CYCLIST) for k in range(12)]
    walker = [car(1.0 * k - 9.9, score=0.6, label=PEDESTRIAN) for k in range(12)]
    lorry = [([1.0 * k - 20, 20.0, 1.6, 9.0, 2.5, 3.2, 0.0], 0.7, HEAVY) for k in range(12)]
    cab = [car(1.0 * k - 17, 20.0, score=0.9) for k in range(12)]
    beside = [car(1.0 * k - 17, 23.5, score=0.9) for k in range(12)]
    for objects in ((rider, walker, cab, lorry, beside), (beside, lorry, cab, walker, rider)):
        joined = join_detections(frames(*objects), TIMES)
        assert {tuple(sorted(each.labels)) for each in joined} == {(VEHICLE, CYCLIST, HEAVY)}


@pytest.mark.parametrize("trained", [0.5, 0.6])
def test_the_old_weights_stay_where_the_new_are_not_better(
    trained, packed, packed_file, tmp_path, monkeypatch, same_weights
):
    torch.manual_seed(0)
    before, asked = VoxelNet(VoxelNetConfig.light(packed.rig(0).area, **road_users())).eval(), []
    kept = copy.deepcopy(before)

    def label(of, held_out):
        asked.append((of is before, held_out))
        return packed_file

    figures = [0.5, 0.5, trained, 0.5]
    monkeypatch.setattr(
        adaptation, "compute_recording_ap", lambda *_: {"a": figures.pop(0), "b": float("nan")}
    )
    after, old, new = adapt_network(before, label, tmp_path, Machine(seconds=0.5))
    assert (old, new) == (0.5, max(0.5, (trained + 0.5) / 2))
    assert same_weights(after, kept) == (trained == 0.5)
    assert same_weights(before, kept)
    assert after.config.area == before.config.area
    assert asked == [(True, False), (True, True), (False, True)]


def test_the_new_weights_are_half_way_to_those_that_were_trained(
    packed_file, tmp_path, monkeypatch
):
    torch.manual_seed(0)
    before = VoxelNet(VoxelNetConfig.light((-8, -8, 8, 8), **road_users())).eval()

    def train_further(network, *_, **__):
        trained = copy.deepcopy(network)
        with torch.no_grad():
            for value in trained.parameters():
                value += 1.0
        return trained

    monkeypatch.setattr(adaptation, "train_further", train_further)
    figures = [0.5, 0.5, 0.6, 0.6]
    monkeypatch.setattr(adaptation, "compute_recording_ap", lambda *_: {"a": figures.pop(0)})
    after, *_ = adapt_network(before, lambda *_: packed_file, tmp_path, Machine(seconds=0.5))
    for old, new in zip(before.parameters(), after.parameters(), strict=True):
        torch.testing.assert_close(new, old + 0.5)
