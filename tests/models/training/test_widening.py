"""Networks that go on as others: what is shared is taken over channel by channel."""

from dataclasses import replace

import pytest
import torch

from models.config import ROAD_USERS, VoxelNetConfig, kinds_of, road_users
from models.network.anchors import per_anchor
from models.network.voxelnet import VoxelNet
from models.network.voxels import voxelise
from models.training.widening import rebuilt, widened

AREA = (-8, -8, 8, 8)
VEHICLES, ALL = VoxelNetConfig.light(AREA), VoxelNetConfig.light(AREA, **road_users())


def network(config, seed=0):
    torch.manual_seed(seed)
    made = VoxelNet(config).eval()
    torch.nn.init.normal_(made.head.classes.bias, 0.0, 0.5)
    return made


def maps(made):
    points = torch.rand(200, 3, generator=torch.Generator().manual_seed(1)) * 6
    with torch.no_grad():
        answer = made.eval()(voxelise(points, made.config))
    return [per_anchor(each, len(made.config.anchor_labels)) for each in answer]


def test_a_network_of_more_classes_says_of_vehicles_what_it_said():
    old = network(VEHICLES)
    wide = widened(old, ALL)
    assert wide.config.labels == ("vehicle", "heavy", "cyclist", "pedestrian")
    for before, after in zip(maps(old), maps(wide), strict=True):
        torch.testing.assert_close(after[:, :, :, :2], before)
        assert not torch.equal(after[:, :, :, 2:4], before)


def test_classes_keep_their_anchors_wherever_they_stand():
    order = kinds_of(["pedestrian", "cyclist", "vehicle"])
    old, fewer = network(ALL), VoxelNetConfig.light(AREA, **road_users(order))
    after = maps(widened(old, fewer))
    for before, now in zip(maps(old), after, strict=True):
        torch.testing.assert_close(now, before[:, :, :, [6, 4, 5, 0, 1]])


def test_other_yaws_begin_anew():
    kinds = (replace(ROAD_USERS[0], yaws=(0.0,)), *ROAD_USERS[1:])
    before, after = maps(network(ALL)), maps(widened(network(ALL), VoxelNetConfig.light(AREA, **road_users(kinds[:2]))))
    torch.testing.assert_close(after[0][..., 1:, :], before[0][..., 2:4, :])
    assert not torch.allclose(after[0][..., 0, :], before[0][..., 0, :])


def test_the_same_classes_are_the_same_network():
    made = network(ALL)
    assert widened(made, ALL) is made
    staged = widened(rebuilt(made, faces=("vehicle",)), ALL)
    assert (staged.config, len(staged.state_dict())) == (ALL, len(made.state_dict()))


def test_what_is_new_begins_the_same_every_time_and_the_generator_stays():
    old = network(VEHICLES)
    first, state = widened(old, ALL), torch.get_rng_state()
    torch.rand(5)
    changed = torch.get_rng_state()
    second = widened(old, ALL)
    assert torch.equal(torch.get_rng_state(), changed)
    assert not torch.equal(state, changed)
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("training", [True, False])
def test_a_rebuilt_network_has_the_weights_and_the_changes(training):
    made = network(ALL).train(training)
    other = rebuilt(made, faces=("heavy",), score_threshold=0.3)
    assert (other.config.faces, other.config.score_threshold, other.training) == (("heavy",), 0.3, training)
    for name, tensor in made.state_dict().items():
        assert torch.equal(other.state_dict()[name], tensor)
    assert made.config.faces == ()
